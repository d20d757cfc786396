"""Load steps beside which a stem is found: another has steps of its own, and fits as well where it is given them."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import Limits, grown
from workbench.estimate.loads.settled import led_to
from workbench.estimate.ranges.freed import Loaded, freed
from workbench.estimate.search.bands import Bands, Found
from workbench.estimate.search.two_parameter import Band, band_stem, best_start, fit_band
from workbench.model.loads import LoadStep

BAND, GAIN, LATE, NOISE = 5.0, 0.009, 7.0, 0.022
LOOP = wb.Loop(wb.Integrating(GAIN, LATE), wb.Deadband(BAND), wb.PID(Kc=3.4, Ti=130.0), 1.0)


def record_of(seed: int, noise: float = NOISE) -> wb.Record:
    """A level whose dead band shows beside one load step, which with another band would have had another size."""
    setpoint, load = [wb.Step(0.8), wb.Step(-1.2, 650.0)], wb.Step(2.2, 715.0)
    run = wb.simulate(LOOP, wb.Experiment(1000.0, setpoint=setpoint, load=load, noise=wb.Noise(noise, seed)))
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


def left_by_hand(data: Centred, band: Band, steps: list[float]) -> float:
    """Least squares of a level's PV on its stem's integral, a constant, a ramp and steps of load of any time nearby."""
    x, _ = band_stem(data.u, band.S, band.J, band.first, band.sense)
    first, n = max(band.first, 0), data.samples
    x = np.where(np.arange(n) < first, 0.0, x)
    before = np.where(np.arange(n) < first, 1.0, 0.0)
    k = np.arange(n, dtype=float)

    def integral(signal: np.ndarray, ahead: float) -> np.ndarray:
        # A dead time between samples lets part of a sample's input act in the next.
        whole = math.floor(band.fit.theta)
        part = band.fit.theta - whole
        late = [np.concatenate([np.full(lag, ahead), signal])[:n] for lag in (whole, whole + 1)]
        rate = (1.0 - part) * late[0] + part * late[1]
        return np.concatenate([[0.0], np.cumsum(rate)[:-1]])

    loads = [np.maximum(k - at - moved, 0.0) for at in steps for moved in (-1.0, 0.0, 1.0)]
    columns = np.column_stack([np.ones(n), k, integral(x, 0.0), integral(before, 1.0), *loads])
    terms, *_ = np.linalg.lstsq(columns, data.y, rcond=None)
    return float(np.mean((data.y - columns @ terms) ** 2))


@pytest.fixture(scope="module")
def held() -> tuple[Centred, Bands, Bands, Limits]:
    """A record with its load, a dead band that fits, alone, and what is alike with it beside free steps."""
    data = centre(record_of(1), "integrating")
    load = 2.2 * GAIN * np.maximum(np.arange(1000.0) - 722.0, 0.0)
    limits = Limits((0.05, 1000.0), (0.0, 30.0))
    bare = data.less(load, load[None, :])
    best = fit_band(bare, BAND, 0.0, (0, 1.0), limits, (1.0, LATE))
    alone = Bands(best, (best,), (1.0,), (BAND, BAND), (0.0, 0.0))
    steps = (LoadStep(722.0, 2.2, (2.0, 2.4)),)
    return data, alone, freed(bare, data, alone, 0.0, limits, steps), limits


def test_alike_are_those_that_fit_as_well_beside_steps_of_their_own(held) -> None:
    data, alone, found, limits = held
    assert found.S[0] < BAND < found.S[1]
    assert found.S[1] - found.S[0] < 0.1 * BAND
    assert found.alike == alone.alike
    left = [left_by_hand(data, band, [722.0]) for band in found.beside]
    least = min(left)
    assert least == pytest.approx(NOISE**2, rel=0.1)
    # A chi square of one degree of freedom, at 95 %, from as many samples as are there at most.
    assert max(left) < least * math.exp(3.841 / (0.5 * data.samples))
    assert [band.fit.sse / data.samples for band in found.beside] == pytest.approx(left, rel=1e-6)
    # Further out they fit worse, whatever their plant.
    loaded = Loaded(data, np.array([721, 722, 723]), 0, limits)
    for S in (0.95 * found.S[0], 1.05 * found.S[1]):
        out = [loaded.band(S, 0.0, start, found.best.fit) for start in ((-1, 0.0), (0, 1.0), (0, -1.0))]
        assert min(left_by_hand(data, band, [722.0]) for band in out) > max(left)
    assert alone.best is found.best


def test_without_steps_nothing_is_freed(held) -> None:
    data, alone, _, limits = held
    assert freed(data, data, alone, 0.0, limits, ()) is alone


@pytest.mark.slow
def test_ranges_hold_the_truth_beside_a_load_step() -> None:
    """Without this neither the range of S, nor of the gain or the dead time, held it."""
    # The refinement knows the steps of the best alone: the plants of the others stay in its ranges.
    found = wb.estimate(record_of(1), plant="integrating", method="joint")
    assert found.verdict == "stiction"
    assert len(found.load_steps) == 1
    ranges = found.intervals
    for truth, (low, high) in ((BAND, ranges.S), (GAIN, ranges.gain), (LATE, ranges.dead_time)):
        assert low <= truth <= high


def test_the_gains_range_holds_jumps_with_steps_of_their_own() -> None:
    """Slips pin S, but not J: beside the step of the best the gain's range ended 0.2 % short of the truth."""
    loop = wb.Loop(
        wb.FOPDT(-0.2547, 11.74, 2.2), wb.Choudhury(0.894, 0.782), wb.PID(2.844, 14.86, action="direct"), 1.0
    )
    load, noise = wb.Step(-0.234, 1387.0), wb.Noise(0.0024, 4)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=wb.Step(-0.3), load=load, noise=noise))
    record = wb.Record(run.pv[1000:] + 50.0, run.op[1000:] + 40.0, 1.0, sp=run.sp[1000:] + 50.0)
    found = wb.estimate(record, plant="fopdt")
    assert found.identifiable
    assert [step.at for step in found.load_steps] == [pytest.approx(389.2, abs=0.5)]
    low, high = found.intervals.gain
    assert low <= -0.2547 <= high
    assert high - low < 0.06 * 0.2547


def test_a_step_that_leaves_white_noise_is_white_enough(monkeypatch) -> None:
    """Its part of PV was so small that what it left had little colour to lose: the gain was told 13 % too high."""
    loop = wb.Loop(wb.FOPDT(1.66386, 4.34266, 0.022966), wb.Stenman(0.774092), wb.PID(Kc=0.403312, Ti=6.47798), 1.0)
    setpoint, load = [wb.Step(3.08996), wb.Step(-4.63494, 659.0)], wb.Step(-0.318138, 666.0)
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=setpoint, load=load, noise=wb.Noise(0.119562, 649522422)))
    record = wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)
    found = wb.estimate(record)
    assert [step.at for step in found.load_steps] == [pytest.approx(666.0, abs=2.0)]
    assert found.plant.gain == pytest.approx(1.66386, rel=0.02)
    low, high = found.intervals.gain
    assert low <= 1.66386 <= high
    loads = importlib.import_module("workbench.estimate.loads.steps")
    monkeypatch.setattr(loads, "NOISE", 0.0)
    assert not wb.estimate(record).load_steps


def test_a_slip_jump_that_is_hardly_likelier_than_none_leaves_the_dead_band_in_the_ranges() -> None:
    loop = wb.Loop(wb.FOPDT(0.674881, 21.3368, 4.55789), wb.Deadband(4.81975), wb.PID(Kc=0.642898, Ti=12.4367), 1.0)
    setpoint, load = [wb.Step(6.81583), wb.Step(-10.2238, 376.0)], wb.Step(0.54121, 449.0)
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=setpoint, load=load, noise=wb.Noise(0.2194, 2018511134)))
    found = wb.estimate(wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0))
    assert isinstance(found.valve, wb.Choudhury)
    dead = next(one for one in found.candidates if isinstance(one.valve, wb.Deadband))
    own = next(one for one in found.candidates if isinstance(one.valve, wb.Choudhury))
    assert 0.0 <= dead.bic - own.bic < 2.0
    low, high = found.intervals.S
    assert low <= 4.81975 <= high
    assert found.intervals.J[0] == 0.0
    assert any("does not tell this valve from a dead band of" in reason for reason in found.reasons)


def test_a_stem_found_beside_steps_stays_where_it_needs_none() -> None:
    """Steps were made of a search's wrong stem; the right one, found beside them, went with them."""
    loop = wb.Loop(wb.FOPDT(1.5, 12.0, 3.0), wb.Choudhury(3.0, 1.0), wb.PID(Kc=0.6, Ti=15.0), 1.0)
    run = wb.simulate(
        loop, wb.Experiment(800.0, setpoint=[wb.Step(5.0), wb.Step(-6.0, 400.0)], noise=wb.Noise(0.05, 1))
    )
    data = centre(wb.Record(run.pv, run.op, 1.0), "fopdt")
    limits = Limits((0.05, 800.0), (0.0, 30.0))
    right, wrong = (
        fit_band(data, *band, best_start(data, band, (12.0, 3.0))[1:], limits, (12.0, 3.0))
        for band in ((3.0, 1.0), (1.4, 1.9))
    )
    assert right.fit.sse < 0.1 * wrong.fit.sse
    first, now = (Found(one, data, (one,), np.empty((0, 4)), data, None) for one in (wrong, right))
    step = 0.1 * np.maximum(np.arange(800.0) - 300.0, 0.0)
    bare = data.less(step, step[None, :])
    there = fit_band(bare, 3.0, 1.0, (right.first, right.sense), limits, (12.0, 3.0))
    led = led_to(data, {"choudhury": first, "deadband": first}, {"choudhury": replace(now, best=there)}, limits)
    assert (led["choudhury"].best.S, led["choudhury"].best.J) == (3.0, 1.0)
    # In the record as it is, not in that without the steps that it was found beside.
    assert led["choudhury"].best.fit.sse == pytest.approx(right.fit.sse, rel=1e-3)
    assert led["choudhury"].met[1:] == first.met
    assert led["deadband"] is first
    # One that leaves more does not.
    assert led_to(data, {"choudhury": now}, {"choudhury": first}, limits)["choudhury"] is now


def test_an_exponent_is_held_to_what_a_number_holds() -> None:
    """A simplex whose time constant nothing held back ended an estimate with an overflow."""
    assert math.isfinite(grown(1e6))
    assert grown(1e6) > 1e300
    assert grown(0.5) == math.exp(0.5)
    assert grown(-1e6) == 0.0
