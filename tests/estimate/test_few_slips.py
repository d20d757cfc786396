"""Ranges of the plant where fewer than ten slips pin the stem: later slips and a shorter dead time look the same."""

from __future__ import annotations

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import LEAST_TAU, Limits
from workbench.estimate.ranges.few import widened
from workbench.estimate.ranges.scale import band_of
from workbench.estimate.search.bands import Found, alike
from workbench.estimate.search.two_parameter import band_stem, best_start, fit_band

# Cycles of a valve with S and J, late, without a setpoint move: six slips in 1,000 samples.
FLOW = wb.Loop(wb.FOPDT(1.93, 43.6, 17.1), wb.Choudhury(19.9, 6.61), wb.PID(Kc=0.531, Ti=28.0), 1.0)
LEVEL = wb.Loop(wb.Integrating(0.0111, 7.95), wb.Choudhury(1.73, 0.898), wb.PID(Kc=2.24, Ti=310.0), 1.0)


def holds(pair: tuple[float, float] | None, value: float) -> bool:
    return pair is not None and pair[0] <= value <= pair[1]


def cycles(loop: wb.Loop, seed: int) -> wb.Record:
    size, sd = (57.8, 0.0361) if loop is FLOW else (0.333, 0.00205)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=wb.Step(size), noise=wb.Noise(sd, seed)))
    return wb.Record(run.pv[1000:], run.op[1000:], 1.0, sp=run.sp[1000:])


@pytest.mark.slow
def test_ranges_of_few_slips_hold_stems_that_slip_earlier_and_later() -> None:
    found = wb.estimate(cycles(FLOW, 2), plant="fopdt")
    assert found.verdict == "stiction"
    assert found.slips == 6
    assert found.intervals.S is None
    assert not found.identifiable
    # Nor does a load step make up for slips at other times.
    assert found.load_steps == ()
    # The stem first met slips a sample or two too late or too early, with 4 % of the gain and a sample of dead time.
    assert holds(found.intervals.gain, FLOW.plant.gain)
    assert holds(found.intervals.dead_time, FLOW.plant.dead_time)
    assert found.plant.gain == pytest.approx(FLOW.plant.gain, rel=0.01)
    low, high = found.intervals.dead_time
    assert high - low < 4.0


def slips_of(data: Centred, S: float, J: float, start: tuple[int, float]) -> np.ndarray:
    moves = np.diff(band_stem(data.u, S, J, *start)[0], prepend=0.0) != 0.0
    return np.flatnonzero(moves[1:] & ~moves[:-1]) + 1


@pytest.mark.parametrize("later", [-1, 1])
@pytest.mark.parametrize(("loop", "seed"), [(FLOW, 14), (LEVEL, 3)])
def test_from_a_stem_that_slips_a_sample_aside_the_right_one_is_met_and_the_ranges_hold_both(
    loop: wb.Loop, seed: int, later: int
) -> None:
    record = cycles(loop, seed)
    data = centre(record, "fopdt" if loop is FLOW else "integrating", sent=True)
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, 100.0))
    tau, dead_time = loop.plant.time_constant if loop is FLOW else 1.0, loop.plant.dead_time
    S, J = loop.valve.S, loop.valve.J
    start = best_start(data, (S, J), (tau, dead_time))[1:]
    right = fit_band(data, S, J, start, limits, (tau, dead_time), 200)
    # OP ramps before each slip: a band wider by a sample's ramp lets it come a sample later.
    slips = slips_of(data, S, J, start)[1:]
    wider = S + later * float(np.median(np.abs(data.u[slips] - data.u[slips - 1])))
    aside = fit_band(data, wider, J, start, limits, (tau, dead_time - later), 200)
    assert aside.slips == right.slips
    assert np.median(slips_of(data, wider, J, start)[1:] - slips) == later
    # Far behind, yet where a search may end: on the way to the right one some slips have moved and others not.
    assert aside.fit.sse > 1.1 * right.fit.sse
    met = alike(data, Found(aside, data, (aside,), np.empty((0, 4)), data, None), limits)
    found = widened(data, met, None, limits)
    assert found.best.fit.sse < 1.002 * right.fit.sse
    ranges = band_of(data, found, "two-parameter", limits).intervals
    for fit in (right.fit, aside.fit):
        assert holds(ranges.dead_time, fit.theta)
        assert holds(ranges.gain, fit.gain)
    assert holds(ranges.gain, loop.plant.gain)
    assert holds(ranges.dead_time, dead_time)
    assert ranges.dead_time[1] - ranges.dead_time[0] > 0.5
