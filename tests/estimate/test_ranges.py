"""Ranges of sticking valves in cycles without a setpoint move: they hold the truth, and the search meets it."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.ranges.scale import joined
from workbench.model.results import Intervals

# `wb.estimate`, the function, hides the folder of its name from a plain import.
module = importlib.import_module("workbench.estimate.record_fits")


def cycle(loop: wb.Loop, size: float, sd: float, seed: int, samples: int, quantum: float = 0.0) -> wb.Record:
    """Samples of a cycle long after its setpoint move."""
    experiment = wb.Experiment(1000.0 + samples, setpoint=wb.Step(size), noise=wb.Noise(sd, seed))
    run = wb.simulate(loop, experiment)
    pv = np.round(run.pv / quantum) * quantum if quantum > 0.0 else run.pv
    return wb.Record(pv[1000:], run.op[1000:], 1.0, sp=run.sp[1000:])


def holds(pair: tuple[float, float] | None, value: float) -> bool:
    return pair is not None and pair[0] <= value <= pair[1]


@pytest.mark.parametrize("seed", [0, 2])
def test_gain_of_a_dead_band_is_as_open_as_its_width(seed: int) -> None:
    # In a level loop a wider band, a higher gain and a later answer make up for each other.
    loop = wb.Loop(wb.Integrating(0.0035, 4.0), wb.Deadband(4.4), wb.PID(Kc=8.0, Ti=120.0), 1.0)
    found = wb.estimate(cycle(loop, 1.5, 0.05, seed, 1000), plant="integrating")
    assert isinstance(found.valve, wb.Deadband)
    assert found.intervals.gain is not None
    assert holds(found.intervals.gain, 0.0035)
    assert found.intervals.gain[1] - found.intervals.gain[0] < 0.5 * 0.0035


@pytest.mark.parametrize(("seed", "method"), [(0, "profile"), (0, "joint")])
def test_ranges_hold_another_valve_that_fits_as_well(seed: int, method: str) -> None:
    # Ten moves in a quantised PV: a stem that sticks again after every slip does as well as the true one.
    loop = wb.Loop(wb.FOPDT(1.35, 4.4, 0.0), wb.Choudhury(0.63, 0.67), wb.PID(Kc=0.29, Ti=8.0), 1.0)
    record = cycle(loop, 1.2, 0.0046, seed, 300, 0.0046)
    found = wb.estimate(record, plant="fopdt", method=method)
    assert isinstance(found.valve, wb.Stenman)
    assert abs(found.plant.gain / 1.35 - 1.0) > 0.05
    assert holds(found.intervals.gain, 1.35)
    assert any("does not tell this valve from one with stick band" in reason for reason in found.reasons)
    # Who asks for the one valve is told of that alone.
    alone = wb.estimate(record, plant="fopdt", valve="stenman", method=method)
    assert not any("does not tell" in reason for reason in alone.reasons)
    assert not holds(alone.intervals.gain, 1.35)


@pytest.mark.parametrize("method", ["profile", "joint"])
def test_ranges_hold_what_a_part_of_the_record_says(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = module.repeated

    def apart(*given: object) -> object:
        bands = whole(*given)
        return replace(bands, parts=(replace(bands.best.fit, gain=1.5 * bands.best.fit.gain),))

    monkeypatch.setattr(module, "repeated", apart)
    loop = wb.Loop(wb.FOPDT(1.35, 4.4, 0.5), wb.Deadband(1.5), wb.PID(Kc=0.5, Ti=8.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(300.0, [wb.Step(3.0), wb.Step(-4.0, 150.0)], noise=wb.Noise(0.02, 1)))
    found = wb.estimate(wb.Record(run.pv, run.op, 1.0), plant="fopdt", valve="deadband", method=method)
    assert found.plant.gain < 1.5
    assert found.intervals.gain is not None
    assert found.intervals.gain[1] > 1.9
    assert not found.identifiable


def test_a_long_records_stem_begins_as_suits_the_whole() -> None:
    # A stem that rests in the middle of its band at the record's start never moves again: OP hardly exceeds S.
    loop = wb.Loop(wb.FOPDT(0.71, 5.4, 0.45), wb.Choudhury(3.02, 2.51), wb.PID(Kc=0.935, Ti=3.63), 1.0)
    found = wb.estimate(cycle(loop, 3.63, 0.02, 1, 1600), plant="fopdt")
    assert isinstance(found.valve, wb.Choudhury)
    assert found.valve.stick_band == pytest.approx(3.02, rel=0.01)
    assert found.plant.gain == pytest.approx(0.71, rel=0.02)


def test_stems_that_slip_a_sample_earlier_or_later_are_met() -> None:
    # OP goes on by 3.5 % of S in a sample: between the sequences that slip one sample apart lie only worse ones.
    loop = wb.Loop(wb.FOPDT(0.823, 5.36, 7.93), wb.Choudhury(3.48, 2.354), wb.PID(Kc=0.3336, Ti=3.72), 1.0)
    found = wb.estimate(cycle(loop, 2.97, 0.029, 3, 600), plant="fopdt")
    assert isinstance(found.valve, wb.Choudhury)
    assert found.valve.stick_band == pytest.approx(3.48, rel=0.005)
    assert found.plant.gain == pytest.approx(0.823, rel=0.08)
    assert holds(found.intervals.gain, 0.823)


@pytest.mark.parametrize(("Ti", "told"), [(25.0, False), (15.0, True)])
def test_what_is_called_identified_holds_the_truth(Ti: float, told: bool) -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 8.0, 4.0), wb.Choudhury(4.0, 2.2), wb.PID(0.5, Ti), 1.0)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=wb.Step(3.0), noise=wb.Noise(0.1, 5)))
    found = wb.estimate(wb.Record(run.pv[500:], run.op[500:], 1.0, sp=run.sp[500:]), plant="fopdt")
    # Ten slips and fewer leave the gain to a tenth either way, or somewhat less.
    assert found.verdict == "stiction"
    assert found.identifiable or found.slips < 13
    assert found.identifiable or not told
    assert found.intervals.S is None or holds(found.intervals.S, 4.0)
    assert holds(found.intervals.gain, 1.0)


def test_joined_ranges_are_hulls_of_what_the_first_has() -> None:
    one = Intervals(d=(1.0, 1.1), gain=(2.0, 2.1), dead_time=(0.5, 0.7))
    other = Intervals(S=(0.9, 1.05), J=(0.2, 0.3), gain=(2.05, 2.4), time_constant=(3.0, 4.0), dead_time=(0.4, 0.6))
    both = joined(one, other)
    assert both == Intervals(d=(0.9, 1.1), gain=(2.0, 2.4), dead_time=(0.4, 0.7))
    assert joined(other, one).S == (0.9, 1.1)
