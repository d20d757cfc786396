"""A stem followed from a window outwards: it comes right where slips are added, or is given up."""

from __future__ import annotations

from dataclasses import replace

import pytest

import workbench as wb
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import LEAST_TAU, Limits
from workbench.estimate.fits.windows import EXACT
from workbench.estimate.search.outwards import LOST, outwards
from workbench.estimate.search.two_parameter import Band, best_start, fit_band

WINDOW = 6000, 6000 + EXACT


def slow_record(samples: int = 20_000) -> wb.Record:
    """A temperature whose valve slips twice in a window."""
    loop = wb.Loop(wb.FOPDT(1.2, 60.0, 20.0), wb.Choudhury(3.0, 1.0), wb.PID(Kc=0.7, Ti=60.0), 1.0)
    moves = [wb.Step(8.0), wb.Step(-6.0, at=0.6 * samples)]
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint=moves, noise=wb.Noise(0.1, 1)))
    return wb.Record(run.pv, run.op, 1.0)


def seed_of(data: Centred, S: float, J: float) -> Band:
    part = data.part(*WINDOW)
    start = best_start(part, (S, J), (60.0, 20.0))[1:]
    return fit_band(part, S, J, start, limits_of(part), (60.0, 20.0))


def limits_of(data: Centred) -> Limits:
    return Limits((LEAST_TAU, float(data.samples)), (0.0, 60.0))


@pytest.mark.parametrize("S", [2.9, 3.1])
def test_a_stem_some_hundredths_off_in_a_window_comes_right_in_all_of_the_record(S: float) -> None:
    data = centre(slow_record(), "fopdt")
    seed = seed_of(data, S, 1.0)
    assert seed.slips < 5
    met, right = outwards(data, WINDOW, seed, None, limits_of(data))
    best = min(met, key=lambda b: b.fit.sse)
    assert right
    assert pytest.approx(3.0, rel=2e-3) == best.S
    assert pytest.approx(1.0, abs=0.02) == best.J
    assert best.fit.sse / data.samples == pytest.approx(0.01, rel=0.03)
    # In all of the record the seed itself is wrong in most of its slips.
    assert seed_on_all(data, seed).fit.sse > 3.0 * best.fit.sse


def seed_on_all(data: Centred, seed: Band) -> Band:
    plant = seed.fit.tau, seed.fit.theta
    return fit_band(data, seed.S, seed.J, best_start(data, (seed.S, seed.J), plant)[1:], limits_of(data), plant)


def test_a_stem_that_soon_leaves_more_than_in_its_window_is_given_up() -> None:
    data = centre(slow_record(), "fopdt")
    seed = seed_of(data, 1.2, 0.0)
    # As if the window had shown it to be a good one.
    good = replace(seed, fit=replace(seed.fit, sse=0.01 * EXACT / LOST))
    assert outwards(data, WINDOW, good, 0.0, limits_of(data)) == ([], False)


@pytest.mark.slow
def test_a_slow_loops_valve_is_found_in_all_of_a_long_record() -> None:
    found = wb.estimate(slow_record(), plant="fopdt", valve="choudhury")
    assert found.verdict == "stiction"
    assert found.identifiable
    assert found.valve.stick_band == pytest.approx(3.0, rel=2e-3)
    assert found.plant.gain == pytest.approx(1.2, rel=0.01)
    low, high = found.intervals.S
    assert low <= 3.0 <= high


def test_the_stem_that_a_window_leads_to_starts_where_it_suits_all_of_the_record() -> None:
    loop = wb.Loop(wb.Integrating(0.01, 49.913), wb.Choudhury(1.01, 0.547), wb.PID(Kc=0.6626, Ti=482.9), 1.0)
    moves = [wb.Step(0.2111, at=100.0), wb.Step(-0.3167, at=5400.0)]
    sd = 0.05265
    run = wb.simulate(loop, wb.Experiment(12_000.0, setpoint=moves, noise=wb.Noise(sd, 208_854)))
    found = wb.estimate(wb.Record(run.pv, run.op, 1.0), plant="integrating", valve="choudhury")
    # A first slip that is another leaves a fiftieth more, which reads as a load.
    assert found.residual_variance < 1.02 * sd**2
    assert found.load_steps == ()
    assert found.plant.gain == pytest.approx(0.01, rel=0.005)
