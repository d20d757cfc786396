"""Loops whose valve does not stick, under load steps that nobody recorded: steps and plant found, valve acquitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.estimate import linear_loop
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, fit_linear
from workbench.estimate.loads import settled
from workbench.estimate.loads import steps as loads
from workbench.estimate.loads.settled import _stands, calm_linear, colour_of, coloured_linear
from workbench.estimate.loads.steps import CLEAR, _beside, _needed
from workbench.model.loads import LoadStep


def stepped(
    plant: wb.FOPDT | wb.Integrating,
    controller: wb.PID,
    load: list[tuple[float, float]],
    noise: float,
    moves: tuple[wb.Step, ...] = (),
    valve: wb.Ideal | wb.Deadband | None = None,
    samples: int = 1000,
) -> wb.Record:
    """So many s of a loop under load steps, each (size, time), from rest."""
    loop = wb.Loop(plant, valve or wb.Ideal(), controller, 1.0)
    steps = [wb.Step(size, at) for size, at in load]
    run = wb.simulate(loop, wb.Experiment(float(samples), list(moves), steps, wb.Noise(noise, 2)))
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


LAG, LAG_PI = wb.FOPDT(1.4, 18.0, 4.0), wb.PID(0.5, 20.0)
LEVEL, LEVEL_PI = wb.Integrating(0.012, 5.0), wb.PID(4.0, 90.0)
UP_DOWN = (wb.Step(4.0), wb.Step(-6.0, at=500.0))


def same(found: tuple[LoadStep, ...], load: list[tuple[float, float]], delay: float) -> bool:
    """Whether the steps that were found are the loop's: PV answers each after the dead time."""
    return len(found) == len(load) and all(
        abs(one.at - at - delay) <= 4.0 and abs(one.size / size - 1.0) <= 0.1
        for one, (size, at) in zip(found, load, strict=True)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "controller", "load", "valve"),
    [
        (LAG, LAG_PI, [(-4.0, 150.0), (3.0, 720.0)], "stenman"),
        (LEVEL, LEVEL_PI, [(1.5, 260.0), (-2.5, 300.0), (1.0, 780.0), (2.0, 830.0)], "linear"),
    ],
)
def test_a_healthy_loop_under_load_steps_is_acquitted_and_its_plant_known(
    plant: wb.FOPDT | wb.Integrating, controller: wb.PID, load: list[tuple[float, float]], valve: str
) -> None:
    record = stepped(plant, controller, load, 0.05, UP_DOWN)
    found = wb.estimate(record, plant="fopdt" if isinstance(plant, wb.FOPDT) else "integrating", valve=valve)
    assert found.verdict == "no_stiction"
    assert same(found.load_steps, load, plant.dead_time)
    assert f"beside {len(load)} load step" in found.reasons[0]
    assert found.plant.gain == pytest.approx(plant.gain, rel=0.02)
    assert found.plant.dead_time == pytest.approx(plant.dead_time, abs=0.5)
    assert found.intervals.gain is not None
    assert found.intervals.gain[0] <= plant.gain <= found.intervals.gain[1]
    assert np.mean((record.pv - found.prediction) ** 2) == pytest.approx(0.05**2, rel=0.1)


def test_steps_as_the_setpoint_moves_may_be_the_valves_and_acquit_nobody() -> None:
    # What happens while PV is on its way to a new setpoint may be a stem's work: the loop is told, the verdict is open.
    load = [(3.0, 12.0), (-3.0, 520.0)]
    found = wb.estimate(stepped(LEVEL, LEVEL_PI, load, 0.02, UP_DOWN), plant="integrating", valve="stenman")
    assert found.verdict == "undecided"
    assert isinstance(found.valve, wb.Ideal)
    assert "a linear loop explains all of PV but noise" in found.reasons[0]
    assert found.plant.gain == pytest.approx(LEVEL.gain, rel=0.02)


def test_a_stem_of_few_slips_that_load_steps_explain_better_accuses_nobody() -> None:
    plant, moves = wb.FOPDT(0.596, 15.52, 0.3), (wb.Step(1.683), wb.Step(-2.525, at=360.0))
    record = stepped(plant, wb.PID(0.651, 25.1), [(-2.17, 429.0), (1.134, 614.0), (0.582, 787.0)], 0.05, moves)
    # By itself either accuses: a stem of two slips stands for the first step.
    assert wb.detect(record).verdict == "stiction"
    found = wb.estimate(record, plant="fopdt", valve="stenman")
    assert found.verdict == "undecided"
    assert "a linear loop explains all of PV but noise" in found.reasons[0]
    assert isinstance(found.valve, wb.Ideal)
    assert found.plant.gain == pytest.approx(plant.gain, rel=0.05)


def test_a_dead_band_under_a_load_step_is_not_acquitted() -> None:
    record = stepped(LAG, wb.PID(1.5, 20.0), [(2.0, 250.0)], 0.02, UP_DOWN[:1], wb.Deadband(2.0), 500)
    found = wb.estimate(record, plant="fopdt", valve="deadband")
    assert found.verdict != "no_stiction"
    assert found.valve.stick_band == pytest.approx(2.0, rel=0.05)
    assert found.plant.gain == pytest.approx(LAG.gain, rel=0.05)


def test_steps_that_explain_less_than_they_cost_are_left_out() -> None:
    data = centre(stepped(LAG, LAG_PI, [(3.0, 300.0), (-2.0, 700.0)], 0.05), "fopdt")
    # Beside no steps its fit is far off.
    line = replace(fit_linear(data, 60.0), tau=18.0, theta=4.0, gain=1.4)
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, 60.0))
    many = _beside(data, data.u, 0, line, limits, 0, [150, 303, 500, 703])
    kept = _needed(data, many, limits, 0)
    assert kept.times == (303, 703)
    assert kept.bic < many.bic - CLEAR
    assert _needed(data, kept, limits, 0) is kept
    assert [round(step.at) for step in coloured_linear(data, line, 60.0, (150, 303, 500, 703))[2]] == [303, 703]


def test_a_linear_loop_beside_steps_is_told_where_these_leave_noise_and_given_up_where_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    load = [(-4.0, 150.0), (3.0, 720.0)]
    record = stepped(LAG, LAG_PI, load, 0.05, UP_DOWN)
    data = centre(record, "fopdt")
    near = Fit(0.0, LAG.time_constant, LAG.dead_time, LAG.gain, 0.0, 0.0, 0.0)
    times = tuple(round(at + LAG.dead_time) for _, at in load)
    found = calm_linear(data, near, 60.0, times)
    assert found is not None
    still, fit, steps = found
    assert still.a.size == 1
    assert fit.gain == pytest.approx(LAG.gain, rel=0.03)
    assert same(steps, load, LAG.dead_time)
    assert [step.at for step in steps] == [step.at for step in coloured_linear(data, near, 60.0, times)[2]]
    # A slow load beside them is no noise, and its measure is not looked for.
    wander = np.convolve(np.random.default_rng(3).normal(size=1100), np.exp(-np.arange(101) / 25.0), "valid")
    slow = centre(replace(record, pv=record.pv + 0.3 * wander), "fopdt")
    assert coloured_linear(slow, near, 60.0, times)[0].a.size > 1
    monkeypatch.setattr(settled, "colour_of", None)
    assert calm_linear(slow, near, 60.0, times) is None


def test_a_measure_that_is_as_likely_as_another_stands() -> None:
    rng = np.random.default_rng(0)
    left, u = np.zeros(1000), np.repeat(rng.normal(size=50), 20)
    for k, e in enumerate(rng.normal(size=1000)):
        left[k] = 0.7 * left[k - 1] + e
    pv = np.concatenate([np.zeros(3), 2.0 * u[:-3]])
    data = centre(wb.Record(pv + left, u, 1.0), "fopdt")
    limits = Limits((LEAST_TAU, 1000.0), (0.0, 30.0))
    lead = loads.Stem(data.u, 0, Fit(1000.0, 0.1, 2.0, 2.0, 0.0, 0.0, 0.0))
    (a, _), level = colour_of(data, left, lead, limits, 0)
    assert a[1] == pytest.approx(-0.7, abs=0.05)

    def stands(*filtered: float) -> bool:
        return _stands(data.whitened(np.array([1.0, *filtered]), 0), lead, limits, level)

    assert stands(*a[1:])
    assert stands(-0.69)
    assert not stands(-0.5)
    assert not stands()


def test_a_step_that_is_taken_for_another_does_not_come_and_go_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    # Two steps explain more than one; less what they leave of it one is enough, which is then the first again.
    loop = wb.Loop(wb.FOPDT(1.31582595, 19.2161064, 0.98934292), wb.Ideal(), wb.PID(0.86129384, 33.1811409), 1.0)
    load = [wb.Step(-0.97113378, at=42.0), wb.Step(1.03958492, at=320.0), wb.Step(1.63022948, at=760.0)]
    noise = wb.Noise(0.02584106, 362971259)
    experiment = wb.Experiment(1000.0, setpoint=[wb.Step(2.58410604)], load=load, noise=noise)
    run = wb.simulate(loop, experiment)
    times: list[tuple[int, ...]] = []
    once = loads._refined

    def refined(data: Centred, stem: loads.Stem, model: loads._Model, *rest: object) -> loads._Model:
        times.append(model.times)
        assert len(times) < 20
        return once(data, stem, model, *rest)

    monkeypatch.setattr(loads, "_refined", refined)
    found = linear_loop(wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0), "fopdt")
    # It is come to again, whichever sample that is.
    assert len(times) > len(set(times))
    assert found.plant.gain == pytest.approx(1.316, rel=0.02)
