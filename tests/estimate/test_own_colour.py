"""Stems of other jumps with plants and colours of their own: the true one is the likeliest, and ranges hold it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

import workbench as wb
from workbench.estimate.fits.data import WHITE, Centred, centre
from workbench.estimate.fits.fit import INTEGRATED, LEAST_TAU, Fit, Limits, grounded, predict
from workbench.estimate.fits.sureness import NORMAL, standard_errors
from workbench.estimate.loads.coloured import colour_beside
from workbench.estimate.loads.own_colour import as_it_is, of_jump, other_jumps, own_akaike, own_colour
from workbench.estimate.loads.steps import Stem
from workbench.estimate.ranges.recoloured import recoloured
from workbench.estimate.search.bands import Bands
from workbench.estimate.search.two_parameter import Band, best_start, fit_band

PLANT, VALVE, PID = wb.FOPDT(0.6, 4.0, 2.3), wb.Choudhury(4.4, 4.0), wb.PID(1.3, 4.0)
N, LIMITS = 1200, Limits((LEAST_TAU, 1200.0), (0.0, 30.0))


def record_of(seed: int, moves: bool = False) -> wb.Record:
    """A cycle under a load that drifts; moves: a setpoint moves it, so that the jump is known."""
    rng = np.random.default_rng(seed)
    load = lfilter([1.0], [1.0, -0.99], 0.14 * rng.normal(size=N))
    setpoint = wb.Step(8.0, at=500.0) if moves else None
    experiment = wb.Experiment(float(N), setpoint, wb.Series(load.tolist()), wb.Noise(0.05, seed))
    run = wb.simulate(wb.Loop(PLANT, VALVE, PID, 1.0), experiment)
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


def band_in(data: Centred, J: float) -> tuple[Centred, Band]:
    """The stem of the true band and a jump, in the measure of what it leaves itself."""
    _, first, sense = best_start(data, (VALVE.S, J), (PLANT.time_constant, PLANT.dead_time))
    plant = PLANT.time_constant, PLANT.dead_time
    white = fit_band(data, VALVE.S, J, (first, sense), LIMITS, plant)
    (a, shared), near = colour_beside(data, white.stem(data.u), white.begin, white.fit, LIMITS, 0)
    there = data.whitened(a, 0, shared)
    return there, fit_band(there, VALVE.S, J, (first, sense), LIMITS, near)


def stem_of(data: Centred, b: Band) -> Stem:
    near = partial(b.stem, data.u)
    return Stem(near(1.0), b.begin, b.fit, near, valve=(b.S, b.J, b.first, b.sense))


@pytest.mark.parametrize("seed", range(1, 4))
def test_the_likeliest_jump_is_the_true_one_in_the_measure_of_another(seed: int) -> None:
    data, wrong = band_in(centre(record_of(seed), "fopdt"), 2.2 * VALVE.J)
    own = own_colour(data, LIMITS)
    met = list(other_jumps(own, stem_of(data, wrong)))
    likely = min(met, key=partial(own_akaike, own))
    assert likely.valve[1] == pytest.approx(VALVE.J, rel=0.35)
    assert likely.fit.gain == pytest.approx(PLANT.gain, rel=0.35)
    assert own_akaike(own, likely) < as_it_is(own, stem_of(data, wrong)) - 2.0
    assert own_akaike(own, met[0]) <= as_it_is(own, stem_of(data, wrong)) + 1e-9
    # One by one outwards, each way from the stem itself.
    jumps = [one.valve[1] for one in met]
    assert jumps[0] == wrong.J
    assert min(jumps) < 0.5 * wrong.J < wrong.J < max(jumps)


def test_the_plant_beside_a_free_colour_is_where_its_likelihood_is_least() -> None:
    data, b = band_in(centre(record_of(0), "fopdt"), VALVE.J)
    own = own_colour(data, LIMITS)
    stem = replace(stem_of(data, b), fit=own.fit(b.stem(data.u), b.begin, b.fit))
    for change in ({"gain": 1.02}, {"gain": 0.98}, {"tau": 1.03}, {"tau": 0.97}, {"theta": 1.02}, {"theta": 0.98}):
        ((name, times),) = change.items()
        other = replace(stem, fit=replace(stem.fit, **{name: times * getattr(stem.fit, name)}))
        assert as_it_is(own, other) > as_it_is(own, stem) - 1e-6
    assert own_akaike(own, stem) == pytest.approx(as_it_is(own, stem), abs=1e-6)


def test_a_levels_filter_of_changes_is_known_as_one() -> None:
    data = centre(record_of(0), "integrating")
    for a, moves in ((np.array([1.0, -0.8]), False), (np.convolve(INTEGRATED, [1.0, -0.5]), True), (INTEGRATED, True)):
        own = own_colour(data.whitened(a, 0), LIMITS)
        assert own.moves is moves
        assert own.law == (1,)


def test_neither_stenmans_jump_is_free_nor_that_of_op_itself() -> None:
    data, b = band_in(centre(record_of(0), "fopdt"), VALVE.J)
    own, stem = own_colour(data, LIMITS), stem_of(data, b)
    stenman = replace(stem, valve=(VALVE.S, math.nan, b.first, b.sense))
    assert len(list(other_jumps(own, stenman))) == 1
    assert len(list(other_jumps(own, replace(stem, valve=None)))) == 1
    assert of_jump(own, replace(stem, valve=None), 3.0, stem).valve is None


def test_the_ranges_hold_jumps_that_are_as_likely_with_a_colour_of_their_own() -> None:
    wider = 0
    for seed in range(1, 5):
        data, b = band_in(centre(record_of(seed), "fopdt"), 1.15 * VALVE.J)
        alone = Bands(b, (b,), (1.0,), (b.S, b.S), (b.J, b.J))
        found = recoloured(data, alone, None, LIMITS)
        assert found.J[0] <= b.J <= found.J[1]
        assert all(low <= one.J <= high for one in found.beside for low, high in [found.J])
        assert len(found.beside) == len(found.spare_beside)
        assert all(0.0 <= spare <= 1.0 for spare in found.spare_beside)
        gains = [one.fit.gain for one in found.beside]
        error = NORMAL * standard_errors(data, b.stem(data.u), b.begin, b.fit, clamped=False)[0]
        assert min(gains) - error <= PLANT.gain <= max(gains) + error
        wider += max(gains) - min(gains) > 0.02 * b.fit.gain
    assert wider >= 3


def test_ranges_stay_where_the_jump_is_not_free_or_what_is_left_is_white() -> None:
    data, b = band_in(centre(record_of(0), "fopdt"), VALVE.J)
    alone = Bands(b, (b,), (1.0,), (b.S, b.S), (b.J, b.J))
    assert recoloured(data.whitened(WHITE, 0), alone, None, LIMITS) is alone
    assert recoloured(data, alone, 0.0, LIMITS) is alone
    none = replace(alone, best=replace(b, fit=replace(b.fit, gain=0.0)))
    assert recoloured(data, none, None, LIMITS) is none


def test_errors_in_a_measure_of_shared_lags_are_those_of_the_same_filter_with_each_its_own_or_less() -> None:
    data, b = band_in(centre(record_of(1), "fopdt"), VALVE.J)
    x, shared = b.stem(data.u), (1, 2, 3, 4, 6, 9, 13)
    left = data.y - predict(data, x, b.begin, grounded(data, x, b.begin, b.fit))[0]
    past = np.array(
        [sum(np.roll(left, lag) for lag in range(i + 1, j + 1)) for i, j in zip((0, *shared), shared, strict=False)]
    )
    terms = np.linalg.lstsq(past[:, 20:].T, left[20:], rcond=None)[0]
    a = np.concatenate([[1.0], np.repeat(-terms, np.diff(shared, prepend=0))])
    fit: Fit = b.fit
    few = standard_errors(data.whitened(a, 0, shared), x, b.begin, fit, clamped=False)
    many = standard_errors(data.whitened(a, 0), x, b.begin, fit, clamped=False)
    assert all(0.5 * m < f <= 1.02 * m for f, m in zip(few, many, strict=True))


def test_the_gain_of_a_cycle_under_a_slow_load_is_held() -> None:
    # It came out at two thirds, and its range below it, before other jumps were tried with colours of their own.
    found = wb.estimate(record_of(4), plant="fopdt", valve="choudhury")
    assert found.verdict == "stiction"
    assert found.valve.stick_band == pytest.approx(VALVE.S, rel=0.03)
    low, high = found.intervals.gain
    assert low <= PLANT.gain <= high
    assert found.plant.gain == pytest.approx(PLANT.gain, rel=0.3)
