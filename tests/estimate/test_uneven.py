"""Valves that do not stick alike at every slip, and slips that the rounding of OP hides."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, fit_path
from workbench.estimate.kernels.output_error import plant_terms
from workbench.estimate.kernels.uneven import uneven_path
from workbench.estimate.record_fits import Fits, unevenly
from workbench.estimate.search.candidates import again
from workbench.estimate.search.uneven import _turn, uneven_stems, words_of_uneven

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from uneven_valves import cycled

GAIN, TAU, THETA, BAND = 1.5, 8.0, 3, 2.0
PLANT = wb.FOPDT(GAIN, TAU, float(THETA))


@cache
def cycle(
    spread: float,
    samples: int = 1000,
    jump: float | None = None,
    seed: int = 3,
    noise: float = 0.02,
    memory: float = 0.0,
) -> tuple[wb.Record, tuple[float, ...]]:
    """A loop in its cycle, and its stem, whose bands have a standard deviation of `spread`, % of travel.

    jump: of a stem that is led on (S = BAND); without one it sticks again at once, as Stenman's does.
    """
    valve = wb.Stenman(BAND) if jump is None else wb.Choudhury(BAND, jump)
    rng = np.random.default_rng(seed)
    record, stem = cycled(PLANT, valve, (0.5 / GAIN, 6.0), spread, samples, noise * BAND * GAIN, rng, memory)
    return record, tuple(stem)


def holds(pair: tuple[float, float] | None, value: float) -> bool:
    return pair is not None and pair[0] <= value <= pair[1]


def test_along_the_plant_the_likeliest_stem_is_the_valves() -> None:
    record, stem = cycle(0.06, noise=0.005)
    data = centre(record, "fopdt")
    x, senses, slips = np.empty(1000), np.empty(1000), np.empty((1000, 3))
    true = np.array(stem) - data.op_middle
    # PV at OP's middle: the bias of a model whose stem is counted from there.
    bias = 50.0 + GAIN * (data.op_middle - 40.0) - data.pv_mean
    terms = np.array([GAIN, bias, data.y[0] - bias, 0.0])
    valve, starts = np.array([BAND, BAND, 0.06]), np.array([[true[0], 1.0], [true[0] + 0.5, 1.0]])
    price, count = uneven_path(
        data.y,
        data.u,
        plant_terms(False, TAU, float(THETA)),
        terms,
        True,
        valve,
        (0.005 * BAND * GAIN) ** 2,
        starts,
        data.a,
        0,
        x,
        senses,
        slips,
    )
    # The first slips answer to what was before the record.
    assert np.abs(x - true)[50:].max() < 1e-9
    assert count == np.count_nonzero(np.diff(true))
    assert price > 0.0
    held, gone = slips[: count - 1, 1], slips[: count - 1, 2]
    assert (held < gone).all()
    assert np.mean(0.5 * (held + gone)) == pytest.approx(BAND, rel=0.02)


@pytest.mark.parametrize("jump", [None, 1.0], ids=["Stenman", "two parameters"])
def test_bands_that_differ_by_some_per_cent_hide_neither_valve_nor_plant(jump: float | None) -> None:
    record, stem = cycle(0.06, samples=1000 if jump is None else 1400, jump=jump)
    found = wb.estimate(record, plant="fopdt")
    assert found.verdict == "stiction"
    assert isinstance(found.valve, wb.Stenman if jump is None else wb.Choudhury)
    assert found.valve.stick_band == pytest.approx(BAND, rel=0.03)
    assert found.plant.gain == pytest.approx(GAIN, rel=0.03)
    assert found.identifiable
    assert holds(found.intervals.gain, GAIN)
    assert holds(found.intervals.d or found.intervals.S, BAND)
    assert any("does not stick alike at every slip" in reason for reason in found.reasons)
    assert np.mean(np.abs(found.valve_position[50:] - np.array(stem)[50:]) > 0.1 * BAND) < 0.03
    # One number for each kind of valve stands beside it, the price of its slips paid.
    told = next(model for model in found.candidates if type(model.valve) is type(found.valve))
    assert told.valve == found.valve
    assert min(model.bic for model in found.candidates) == told.bic


def test_a_valve_that_sticks_alike_is_told_so() -> None:
    found = wb.estimate(cycle(0.0)[0], plant="fopdt")
    assert found.valve.stick_band == pytest.approx(BAND, rel=0.01)
    assert not any("every slip" in reason or "each slip" in reason for reason in found.reasons)


def test_bands_far_apart_leave_the_stick_band_open() -> None:
    found = wb.estimate(cycle(0.3, samples=1500, seed=5)[0], plant="fopdt")
    assert found.verdict == "stiction"
    assert not found.identifiable
    assert found.plant.gain == pytest.approx(GAIN, rel=0.05)
    low, high = found.intervals.d
    assert low < BAND - 0.3 < BAND + 0.3 < high
    assert any("the stick band S is not identified" in reason for reason in found.reasons)


@pytest.mark.parametrize("method", ["profile", "joint"])
def test_slips_that_ops_rounding_hides_are_told_by_pv(method: str) -> None:
    loop = wb.Loop(wb.FOPDT(2.0, 6.0, 3.0), wb.Stenman(1.2), wb.PID(Kc=0.3, Ti=10.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1377.0, setpoint=wb.Step(3.0), noise=wb.Noise(0.05, 1)))
    pv, op, sp = (signal[777:] for signal in (run.pv + 50.0, run.op + 40.0, run.sp + 50.0))
    found = wb.estimate(wb.Record(np.round(pv, 1), np.round(op, 1), 1.0, sp=sp), plant="fopdt", method=method)
    assert found.verdict == "stiction"
    assert found.plant.gain == pytest.approx(2.0, rel=0.03)
    assert holds(found.intervals.d, 1.2)
    assert holds(found.intervals.gain, 2.0)
    assert any("OP was recorded in steps, PV tells when" in reason for reason in found.reasons)
    assert not any("no ranges are given" in reason for reason in found.reasons)


def test_a_valve_that_was_asked_for_is_the_one_told() -> None:
    record = cycle(0.06, jump=1.0, samples=900)[0]
    assert isinstance(wb.estimate(record, plant="fopdt", valve="stenman").valve, wb.Stenman)
    assert isinstance(wb.estimate(record, plant="fopdt", valve="deadband").valve, wb.Deadband)


def test_without_slips_there_is_no_such_stem() -> None:
    data = centre(cycle(0.06)[0], "fopdt")
    limits = Limits((LEAST_TAU, 1000.0), (0.0, 30.0))
    nothing = Fit(1.0, TAU, float(THETA), 0.0, 0.0, 0.0, 0.0)
    wide = replace(nothing, gain=GAIN)
    assert uneven_stems(data, [], limits, {True}) == []
    assert uneven_stems(data, [(True, BAND, BAND, nothing), (True, 50.0, 50.0, wide)], limits, {True}) == []


def test_stems_about_one_that_is_far_behind_are_sought_once(monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("workbench.estimate.search.uneven")
    data, about, looked = centre(cycle(0.06)[0], "fopdt"), module._about, []

    def noted(*given: object) -> object:
        looked.append(1)
        return about(*given)

    monkeypatch.setattr(module, "_about", noted)
    limits = Limits((LEAST_TAU, 1000.0), (0.0, 30.0))
    wrong = Fit(50.0, 2.0 * TAU, float(THETA) + 2.0, 0.5 * GAIN, 0.0, 0.0, 0.0)
    seeds = [(True, 1.2 * BAND, 1.2 * BAND, wrong)]
    (first, *_), once = uneven_stems(data, seeds, limits, {True}, far=-np.inf), len(looked)
    (best, *_), often = uneven_stems(data, seeds, limits, {True}), len(looked) - once
    assert once == 1 < often
    assert best.level <= first.level


def test_words_tell_what_differs() -> None:
    data = centre(cycle(0.06)[0], "fopdt")
    limits = Limits((LEAST_TAU, 1000.0), (0.0, 30.0))
    fit = Fit(50.0, TAU, float(THETA), GAIN, 0.0, 0.0, 0.0)
    best = uneven_stems(data, [(True, BAND, BAND, fit)], limits, {True})[0]
    assert pytest.approx(BAND, rel=0.03) == best.S
    assert best.spread == pytest.approx(0.06, rel=0.7)
    assert "most of them from 1." in words_of_uneven(best, 0.0)[0]
    alike = replace(best, spread=best.step / 4.0)
    assert words_of_uneven(alike, 0.0)[0].endswith("the rest of PV tells when")
    assert words_of_uneven(alike, 0.05)[0].endswith("OP was recorded in steps, PV tells when")


def test_a_stem_that_would_turn_without_any_band_is_none() -> None:
    data = centre(cycle(0.06)[0], "fopdt")
    limits, fit = Limits((LEAST_TAU, 1000.0), (0.0, 30.0)), Fit(50.0, TAU, float(THETA), GAIN, 0.0, 0.0, 0.0)
    assert _turn(data, False, 1.0, 2.0 * BAND, fit, 0.2, limits) is not None
    assert _turn(data, False, -0.5, 2.0 * BAND, fit, 0.2, limits) is None


def test_beside_coloured_noise_every_model_is_fitted_in_its_measure(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = []

    def kept(first: Fits, found: Fits, valve: str) -> Fits:
        fits.append((first, unevenly(first, found, valve)))
        return fits[-1][1]

    monkeypatch.setattr(importlib.import_module("workbench.estimate.answer"), "unevenly", kept)
    record, _ = cycle(0.12, noise=0.01, memory=0.9)
    found = wb.estimate(record, plant="fopdt")
    assert found.valve.stick_band == pytest.approx(BAND, rel=0.02)
    assert found.plant.gain == pytest.approx(GAIN, rel=0.02)
    ((first, told),) = fits
    assert told.uneven
    assert told.data.a.size > 1
    white, free = first.linear, (-np.inf, np.inf)
    as_it_was = fit_path(told.data, told.data.u, 0, free, told.limits, white.theta, tau=white.tau, evaluations=3)
    assert told.linear.sse < 0.99 * as_it_was.sse
    assert told.found is not None
    best = told.found.best
    (there,) = again(told.data, (best,), told.limits)
    assert best.fit.sse == pytest.approx(there.fit.sse, rel=1e-3)
