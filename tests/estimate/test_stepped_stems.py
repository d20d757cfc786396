"""Stems found together with a load step, and a disturbance's colour found together with a plant."""

from __future__ import annotations

import math

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import Limits, disturbance, fit_path, grounded, predict
from workbench.estimate.fits.sureness import standard_errors
from workbench.estimate.kernels.beside import left_beside
from workbench.estimate.kernels.output_error import oe_columns, plant_terms
from workbench.estimate.kernels.stepped import LANES, STRIDE, screen_stepped
from workbench.estimate.loads.coloured import colour_beside
from workbench.estimate.loads.stepped import stepped_stems
from workbench.estimate.search.stems import path_of
from workbench.estimate.search.two_parameter import band_stem
from workbench.model.record import FloatArray

LIMITS, FREE = Limits((0.05, 1000.0), (0.0, 30.0)), (-math.inf, math.inf)


def least(
    y: FloatArray, x: FloatArray, first: int, plant: tuple[float, float], integrating: bool, skip: int, at: int
) -> float:
    """Sum of squares beside a step at one sample, by least squares on all columns."""
    tau, theta = plant
    a, n = 1.0 if integrating else math.exp(-1.0 / tau), y.size
    m, f = int(theta), theta - int(theta)
    c0 = 1.0 - f if integrating else 1.0 - a ** (1.0 - f)
    c1 = f if integrating else a ** (1.0 - f) - a
    columns = np.empty((4, n))
    oe_columns(x, max(first, 0), a, m, c0, c1, integrating, columns)
    k = np.arange(n - at, dtype=float)
    step = np.zeros(n)
    step[at:] = k if integrating else 1.0 - np.exp(-k / tau)
    matrix = np.vstack([columns, step])[:, skip:]
    matrix /= np.maximum(np.sqrt((matrix**2).sum(axis=1)), 1e-300)[:, None]
    terms, *_ = np.linalg.lstsq(matrix.T, y[skip:], rcond=1e-9)
    return float(((y[skip:] - terms @ matrix) ** 2).sum())


def test_stems_of_a_finer_op_are_averaged_over_what_a_sample_of_pv_spans() -> None:
    rng = np.random.default_rng(5)
    n, many = 120, 3
    u = 4.0 * np.sin(np.arange(n * many) / 17.0) + 0.2 * rng.normal(size=n * many)
    y = np.cumsum(rng.normal(size=n))
    stems = np.array(
        [(2.0, 0.7, -1.0, 0.0), (1.5, math.nan, 0.0, 0.0), (2.0, 0.7, 7.0, 1.0), (2.5, math.nan, 31.0, 0.0)]
    )
    found = np.empty((len(stems), 1, 2))
    screen_stepped(y, u, stems, np.array([(6.0, 1.3)]), False, 0.0, 4, 9, n - 6, 1, found)
    for i, (S, J, first, sense) in enumerate(stems.tolist()):
        x = path_of(u, S, int(first))[0] if math.isnan(J) else band_stem(u, S, J, int(first), sense)[0]
        means, begin = x.reshape(n, many).mean(axis=1), int(first) // many
        if first < 0:
            # Before the record such a stem stood where it stands at its first sample.
            means, begin = means + 0.0, 0
        costs = [least(y, means, begin, (6.0, 1.3), False, 4, at) for at in range(9, n - 6)]
        assert found[i, 0, 0] == pytest.approx(min(costs), rel=1e-6)


@pytest.mark.parametrize("integrating", [False, True])
@pytest.mark.parametrize("skip", [0, 9])
def test_the_best_step_beside_a_stem_is_that_of_least_squares_at_every_sample(integrating: bool, skip: int) -> None:
    rng = np.random.default_rng(3)
    n = 90
    u = 4.0 * np.sin(np.arange(n) / 5.0) + 0.3 * rng.normal(size=n)
    y = np.cumsum(rng.normal(size=n))
    stems = np.array([(2.0, 0.7, 0.0, 1.0), (1.5, math.nan, 0.0, 0.0), (2.0, 0.7, 2.0, 1.0), (3.0, math.nan, 3.0, 0.0)])
    plants = np.array([(6.0, 1.3), (6.0, 4.0), (20.0, 0.0)])
    found = np.empty((len(stems), len(plants), 2))
    begin, end = skip + 5, n - 6
    screen_stepped(y, u, stems, plants, integrating, 0.0, skip, begin, end, 1, found)
    for i, (S, J, first, sense) in enumerate(stems.tolist()):
        x = path_of(u, S, int(first))[0] if math.isnan(J) else band_stem(u, S, J, int(first), sense)[0]
        for j, plant in enumerate(plants.tolist()):
            costs = [least(y, x, int(first), tuple(plant), integrating, skip, at) for at in range(begin, end)]
            assert found[i, j, 0] == pytest.approx(min(costs), rel=1e-6)
            assert costs[int(found[i, j, 1]) - begin] == pytest.approx(min(costs), rel=1e-6)


def test_steps_tried_roughly_and_more_stems_than_lanes() -> None:
    rng = np.random.default_rng(4)
    n, begin, end = 120, 11, 109
    u, y = 4.0 * np.sin(np.arange(n) / 6.0) + 0.3 * rng.normal(size=n), np.cumsum(rng.normal(size=n))
    widths = np.linspace(1.0, 3.0, 2 * LANES + 3)
    stems = np.array([(S, 0.3 * S, first, 1.0) for first in (-1.0, 0.0) for S in widths])
    found = np.empty((len(stems), 1, 2))
    screen_stepped(y, u, stems, np.array([(5.0, 2.4)]), False, 0.0, 0, begin, end, STRIDE, found)
    for (S, J, first, sense), (cost, at) in zip(stems.tolist(), found[:, 0].tolist(), strict=True):
        x = band_stem(u, S, J, int(first), sense)[0]
        # A stem that rests first is known before the record too.
        costs = [left_beside(y, x, 0, False, 5.0, 2.4, np.array([k]), 0) for k in range(begin, end, STRIDE)]
        if first < 0:
            whole = np.concatenate([np.full(9, x[0]), x])
            costs = [
                left_beside(np.concatenate([np.zeros(9), y]), whole, 0, False, 5.0, 2.4, np.array([k + 9]), 9)
                for k in range(begin, end, STRIDE)
            ]
        assert cost / n == pytest.approx(min(costs), rel=1e-6)
        assert int(at) == begin + STRIDE * int(np.argmin(costs))


@pytest.mark.parametrize("integrating", [False, True])
def test_what_is_left_beside_two_steps_is_that_of_least_squares(integrating: bool) -> None:
    rng = np.random.default_rng(5)
    x, n, skip = np.repeat(rng.normal(size=40), 5), 200, 7
    y = np.cumsum(x) + rng.normal(size=n)
    columns = np.empty((4, n))
    plant = plant_terms(integrating, 8.0, 2.3)
    oe_columns(x, 3, plant[0], plant[3], plant[1], plant[2], integrating, columns)
    k = np.arange(n, dtype=float)
    steps = [np.where(k >= at, (k - at) if integrating else 1.0 - np.exp(-(k - at) / 8.0), 0.0) for at in (60, 130)]
    matrix = np.vstack([columns, steps])[:, skip:]
    terms, *_ = np.linalg.lstsq(matrix.T, y[skip:], rcond=1e-12)
    expected = float(np.mean((y[skip:] - terms @ matrix) ** 2))
    left = left_beside(y, x, 3, integrating, 8.0, 2.3, np.array([60, 130]), skip)
    assert left == pytest.approx(expected, rel=1e-9)


def test_a_gain_of_the_wrong_sign_is_none() -> None:
    u = 4.0 * np.sin(np.arange(200) / 7.0)
    x = band_stem(u, 2.0, 0.7, 0, 1.0)[0]
    y = np.cumsum(x - x.mean())
    stems, plants, found = np.array([(2.0, 0.7, 0.0, 1.0)]), np.array([(1.0, 1.0)]), np.empty((2, 1, 1, 2))
    for sign, out in zip((1.0, -1.0), found, strict=True):
        screen_stepped(y, u, stems, plants, True, sign, 0, 20, 180, 1, out)
    assert math.isfinite(found[0, 0, 0, 0])
    assert math.isinf(found[1, 0, 0, 0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "valve", [wb.Choudhury(2.4, 0.9), wb.Stenman(2.0), wb.Deadband(1.4)], ids=["choudhury", "stenman", "deadband"]
)
def test_a_stem_is_found_beside_the_step_that_hides_it(valve: wb.Valve) -> None:
    loop = wb.Loop(wb.Integrating(0.02, 4.5), valve, wb.PID(Kc=2.0, Ti=70.0), 1.0)
    moves = [wb.Step(3.0), wb.Step(-4.5, 560.0)]
    experiment = wb.Experiment(1000.0, setpoint=moves, load=wb.Step(-1.0, 430.0), noise=wb.Noise(0.05, 2))
    run = wb.simulate(loop, experiment)
    data = centre(wb.Record(run.pv, run.op, 1.0, sp=run.sp), "integrating")
    best = stepped_stems(data, LIMITS, 0, (20, 980))[0]
    assert best.times[0] == pytest.approx(434.5, abs=6.0)
    assert best.fit.theta == pytest.approx(4.5, abs=0.8)
    assert best.fit.sse / data.samples == pytest.approx(0.05**2, rel=0.15)
    true = run.valve - run.valve.mean()
    kept = slice(max(best.first, 30), None)
    apart = (best.x - best.x[kept].mean() - true + true[kept].mean())[kept]
    assert np.std(apart) < 0.15 * np.std(true)


def loaded_level(seed: int) -> tuple[wb.Record, FloatArray]:
    """A level under a slow load at its valve, and its true stem."""
    rng = np.random.default_rng(seed)
    load = np.zeros(1000)
    for k in range(1, 1000):
        load[k] = 0.98 * load[k - 1] + 0.1 * rng.normal()
    loop = wb.Loop(wb.Integrating(0.05, 3.0), wb.Deadband(2.0), wb.PID(Kc=0.8, Ti=60.0), 1.0)
    moves = [wb.Step(3.0, 40.0), wb.Step(-4.0, 550.0)]
    series = wb.Series(tuple(load.tolist()))
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=moves, load=series, noise=wb.Noise(0.03, seed)))
    return wb.Record(run.pv, run.op, 1.0, sp=run.sp), run.valve - 0.5 * (run.op.max() + run.op.min())


def test_a_plant_found_beside_the_colour_of_its_load_is_the_true_one() -> None:
    alternating, beside, held = [], [], []
    for seed in range(8):
        record, stem = loaded_level(seed)
        data = centre(record, "integrating")
        white = fit_path(data, stem, 0, FREE, LIMITS, 3.0)
        left = data.y - predict(data, stem, 0, white)[0]
        for filtered, gains in (
            (disturbance(left, data.floor), alternating),
            (colour_beside(data, stem, 0, white, LIMITS, 0)[0].a, beside),
        ):
            measured = data.whitened(filtered, 0)
            fits = [fit_path(measured, stem, 0, FREE, LIMITS, theta) for theta in (0.0, 3.0, white.theta)]
            fit = min(fits, key=lambda one: one.sse)
            gains.append(fit.gain / 0.05 - 1.0)
        error = standard_errors(measured, stem, 0, fit, clamped=False)[0]
        held.append(abs(fit.gain - 0.05) <= 1.96 * error)
    # As if the load were white the plant takes part of it for its own work, and its colour with it.
    assert np.mean(alternating) < -0.05
    assert abs(np.mean(beside)) < 0.04
    assert np.std(beside) < 0.1
    assert sum(held) >= 7


def test_a_plant_without_a_gain_has_no_colour_beside_it() -> None:
    record, stem = loaded_level(0)
    data = centre(record, "integrating")
    fit = fit_path(data, stem, 0, FREE, LIMITS, 3.0)
    none = grounded(data, stem, 0, type(fit)(fit.sse, fit.tau, fit.theta, 0.0, 0.0, 0.0, 0.0))
    assert colour_beside(data, stem, 0, none, LIMITS, 0)[0].a.tolist() == [1.0]


def test_a_load_step_that_was_found_makes_the_gain_less_sure() -> None:
    record, stem = loaded_level(1)
    data = centre(record, "integrating")
    ramp = np.maximum(np.arange(1000.0) - 400.0, 0.0)
    fit = fit_path(data, stem, 0, FREE, LIMITS, 3.0)
    without = data.less(np.zeros(1000), np.empty((0, 1000)))
    beside = data.less(np.zeros(1000), np.vstack([ramp, np.diff(ramp, prepend=0.0)]))
    assert beside.answers.shape == (2, 1000)
    sure, unsure = (standard_errors(one, stem, 0, fit, clamped=False)[0] for one in (without, beside))
    assert unsure > 1.02 * sure
