"""Slips of a level's valve seen as kinks of PV: where they are, whose stem makes them, and which loops show none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import LEAST_TAU, Limits
from workbench.estimate.search.bands import noise_beside
from workbench.estimate.search.kinks import about_kinks, between_steps, kinks_of, seen_as_kinks, sums_up
from workbench.estimate.search.reach import searched
from workbench.estimate.search.stems import silent
from workbench.estimate.search.two_parameter import MOST_STARTS, best_of, best_start, fit_band

NOISE = 0.14
THETA = 20.0


@cache
def level(gain: float = 0.01, slip_jump: float = 4.2) -> tuple[wb.Record, wb.SimulationResult]:
    """A slow level of 20,000 samples, whose windows of 1,500 hold a few slips each."""
    action = "reverse" if gain > 0.0 else "direct"
    controller = wb.PID(Kc=0.66, Ti=480.0, action=action)
    loop = wb.Loop(wb.Integrating(gain, THETA), wb.Choudhury(3.85, slip_jump), controller, 1.0)
    moves = [wb.Step(4.0, at=100.0), wb.Step(-6.0, at=9000.0)]
    run = wb.simulate(loop, wb.Experiment(20_000.0, setpoint=moves, noise=wb.Noise(NOISE, 3)))
    return wb.Record(run.pv, run.op, 1.0), run


def slips_of(run: wb.SimulationResult) -> np.ndarray:
    """The samples at which the stem sets off."""
    moves = np.diff(run.valve) != 0.0
    return np.flatnonzero(moves[1:] & ~moves[:-1]) + 2


def limits_of(data: Centred) -> Limits:
    return Limits((LEAST_TAU, float(data.samples)), (0.0, 60.0))


def test_the_slope_is_seen_to_change_where_it_does_and_which_way() -> None:
    rng = np.random.default_rng(1)
    at = np.cumsum(rng.integers(150, 400, 24))
    slopes = np.zeros(at[-1] + 300)
    slopes[at] = 0.05 * (-1.0) ** np.arange(at.size)
    kinks = kinks_of(np.cumsum(np.cumsum(slopes)) + rng.normal(0.0, 0.1, slopes.size))
    assert kinks is not None
    assert kinks.at.size == at.size
    assert np.abs(kinks.at - at).max() <= 5
    assert (kinks.senses == np.sign(slopes[at])).all()


def test_noise_a_sinusoid_and_a_few_kinks_are_none() -> None:
    rng, k = np.random.default_rng(2), np.arange(20_000)
    few = np.cumsum(np.cumsum(np.where(np.isin(k, [4000, 9000, 15_000]), 0.05, 0.0)))
    for pv in (0.0 * k, np.sin(0.01 * k), few):
        assert kinks_of(pv + rng.normal(0.0, 0.1, k.size)) is None


def test_nearly_all_slips_of_a_level_are_kinks_a_dead_time_later() -> None:
    record, run = level()
    kinks, slips = kinks_of(record.pv), slips_of(run)
    assert kinks is not None
    assert abs(kinks.at.size - slips.size) <= 1
    late = kinks.at[:, None] - slips[None, :] - THETA
    assert np.median(np.abs(late).min(axis=1)) <= 4


@pytest.mark.parametrize(("gain", "slip_jump"), [(0.01, 4.2), (-0.01, 4.2), (0.01, 1.5)])
def test_the_stem_that_makes_the_kinks_is_the_valve_s(gain: float, slip_jump: float) -> None:
    record, run = level(gain, slip_jump)
    data = centre(record, "integrating")
    S, _, _, theta = seen_as_kinks(data, 60.0)[0]
    assert pytest.approx(3.85, rel=0.02) == S
    assert theta == pytest.approx(THETA, abs=6.0)
    best = best_of(about_kinks(data, limits_of(data)))
    assert pytest.approx(3.85, rel=2e-3) == best.S
    assert pytest.approx(slip_jump, rel=5e-3) == best.J
    assert best.fit.gain == pytest.approx(gain, rel=0.01)
    assert best.slips == slips_of(run).size
    assert noise_beside(data, best)


def test_kinks_tell_the_stem_where_the_gain_s_sign_is_not_known() -> None:
    data = replace(centre(level()[0], "integrating"), sign=0.0)
    assert seen_as_kinks(data, 60.0)[0][0] == pytest.approx(3.85, rel=0.02)


@cache
def lag() -> Centred:
    """A slow lag, whose PV steps, of 6,000 samples."""
    loop = wb.Loop(wb.FOPDT(1.2, 11.0, 71.0), wb.Choudhury(3.555, 4.1), wb.PID(Kc=0.059, Ti=11.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(6000.0, setpoint=wb.Step(8.5, at=100.0), noise=wb.Noise(0.235, 1)))
    return centre(wb.Record(run.pv, run.op, 1.0), "fopdt")


def test_a_level_is_told_by_its_kinks_and_a_lag_is_not() -> None:
    assert sums_up(centre(level()[0], "fopdt"), 60.0)
    assert kinks_of(lag().y) is not None
    assert not sums_up(lag(), 60.0)
    assert seen_as_kinks(replace(lag(), integrating=True), 60.0) == ()
    assert seen_as_kinks(centre(level()[0], "fopdt"), 60.0) == ()


def test_a_lag_s_steps_are_apart_by_half_a_cycle_and_a_level_has_none() -> None:
    assert between_steps(lag()) == pytest.approx(400.0, rel=0.1)
    assert between_steps(centre(level()[0], "fopdt")) == 0.0


def test_dead_times_up_to_half_of_the_time_between_a_lag_s_steps_are_searched() -> None:
    # With up to 60 samples a stem of 1.5 times the band explains PV after a fashion.
    found = searched(lag(), 30.0, lag().samples / 4.0, silent)
    assert found is not None
    assert found.limits.theta[1] == pytest.approx(0.5 * between_steps(lag()))


def test_the_stem_that_makes_a_lag_s_steps_is_the_valve_s_whose_dead_time_is_long() -> None:
    # Of another S and dead time a stem leaves 1.08 times the noise in such a cycle.
    S, slip_jump, plant = 3.52, 2.56, wb.FOPDT(2.4, 17.6, 104.5)
    loop = wb.Loop(plant, wb.Choudhury(S, slip_jump), wb.PID(Kc=0.0324, Ti=17.6), 1.0)
    run = wb.simulate(loop, wb.Experiment(16_000.0, setpoint=wb.Step(16.9, at=100.0), noise=wb.Noise(0.42, 7)))
    data = centre(wb.Record(run.pv, run.op, 1.0), "fopdt")
    limits = Limits((LEAST_TAU, 16_000.0), (0.0, 300.0))
    best = best_of(about_kinks(data, limits))
    assert pytest.approx(S, rel=3e-3) == best.S
    assert pytest.approx(slip_jump, rel=0.02) == best.J
    assert best.fit.theta == pytest.approx(plant.dead_time, abs=1.0)
    assert noise_beside(data, best)


@pytest.mark.parametrize("step", [0.0, 0.05])
def test_pv_without_noise_or_in_steps_has_kinks_where_it_is_seen_to_turn_alone(step: float) -> None:
    slopes = np.zeros(8000)
    slopes[300:7800:300] = 0.02 * (-1.0) ** np.arange(25)
    pv = np.cumsum(np.cumsum(slopes))
    kinks = kinks_of(np.round(pv / step) * step if step else pv)
    assert kinks is not None
    away = np.abs(kinks.at[:, None] - np.arange(300, 7800, 300)[None, :]).min(axis=1)
    assert kinks.at.size == 25
    assert away.max() <= 5


def test_a_record_without_kinks_shows_no_stem() -> None:
    rng = np.random.default_rng(4)
    data = centre(wb.Record(rng.normal(0.0, 1.0, 12_000), rng.normal(0.0, 1.0, 12_000), 1.0), "integrating")
    assert seen_as_kinks(data, 60.0) == ()
    assert about_kinks(data, limits_of(data)) == []


def test_of_few_starts_that_suit_none_is_passed_over_where_all_are_tried() -> None:
    record, run = level()
    data, plant = centre(record, "integrating"), (20_000.0, THETA)
    cost, first, sense = best_start(data, (3.85, 4.2), plant, MOST_STARTS)
    known = fit_band(data, 3.85, 4.2, (first, sense), limits_of(data), plant)
    assert known.slips == slips_of(run).size
    assert cost == pytest.approx(NOISE**2 * data.samples, rel=0.05)
    assert best_start(data, (3.85, 4.2), plant, 4)[0] > 2.0 * cost
