"""The colour of a disturbance beside a stem: its kernel is least squares, and the plant beside it is the true one."""

from __future__ import annotations

import math

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, fit_path, predict
from workbench.estimate.kernels.coloured import HELD, colour_left, lagged, products_of
from workbench.estimate.kernels.output_error import oe_columns, plant_terms
from workbench.estimate.loads.coloured import SHARED, Beside, colour_beside
from workbench.model.record import Record

MOST_LAGS = SHARED[-1]


@pytest.mark.parametrize("plant", ["fopdt", "integrating"])
@pytest.mark.parametrize(("first", "skip"), [(0, 0), (9, 5)])
@pytest.mark.parametrize("tau", [6.5, 0.8, 60.0])  # start and transient die out within the record, at once, and not
@pytest.mark.parametrize("lags", [1, 4, MOST_LAGS])
@pytest.mark.parametrize("moves", [False, True])
def test_what_an_autoregression_leaves_is_numpys_least_squares(
    plant: str, first: int, skip: int, tau: float, lags: int, *, moves: bool
) -> None:
    rng = np.random.default_rng(2)
    u = np.cumsum(rng.normal(size=240))
    data = centre(Record(np.cumsum(rng.normal(size=240)), u, 1.0), plant)
    gain, theta, size = 0.7, 2.3, MOST_LAGS + 1
    products = np.empty((2 * size + HELD, 2 * size + HELD))
    begin = skip + MOST_LAGS + moves
    own, y = np.empty((size, size)), np.diff(data.y, prepend=0.0) if moves else data.y
    lagged(y, y, begin, size, own)
    rows = products_of(y, own, data.u, first, data.integrating, tau, theta, begin, moves, products)
    terms = lags + rows - 2 * size
    room = np.empty((terms + 1, terms))
    left = colour_left(products, rows, size, gain, lags, room)

    columns = predict(data, data.u, first, Fit(0.0, tau, theta, 1.0, 0.0, 0.0, 0.0))[1]
    if moves:
        columns = np.diff(columns, axis=1, prepend=0.0)
    rest = y - gain * columns[1]
    held = [column for column in columns[[0, 2, 3], begin:] if column.any()]
    assert rows == 2 * size + len(held)
    matrix = np.column_stack([*(rest[begin - i : 240 - i] for i in range(1, lags + 1)), *held])
    matrix /= (scale := np.linalg.norm(matrix, axis=0))
    solved, *_ = np.linalg.lstsq(matrix, rest[begin:], rcond=None)
    assert left == pytest.approx(float(((rest[begin:] - matrix @ solved) ** 2).sum()), rel=1e-8)
    np.testing.assert_allclose(room[terms, :lags], (solved / scale)[:lags], rtol=1e-6, atol=1e-9)


def test_what_dies_out_over_a_long_record_ends_at_nothing() -> None:
    columns, lag = np.empty((4, 20_000)), False
    pole, c0, c1, m = plant_terms(lag, 6.0, 2.5)
    oe_columns(np.ones(20_000), 10, pole, m, c0, c1, lag, columns)
    assert (columns[2:, -1] == 0.0).all()
    assert columns[3, 3000] == pytest.approx(pole**3000, rel=1e-9)


def test_the_colour_beside_the_true_stem_is_the_disturbances() -> None:
    rng = np.random.default_rng(5)
    n, x, drift = 3000, np.repeat(rng.normal(size=100), 30), np.zeros(3000)
    kicks = rng.normal(0.0, 0.1, n)
    for k in range(1, n):
        drift[k] = 0.9 * drift[k - 1] + kicks[k]
    data = centre(Record(np.convolve(np.roll(x, 4), 0.15 * 0.85 ** np.arange(60))[:n] + drift, x, 1.0), "fopdt")
    fit = Fit(0.0, 4.0, 3.0, 0.8, 0.0, 0.0, 0.0)
    a = colour_beside(data, data.u, 0, fit, Limits((LEAST_TAU, float(n)), (0.0, 30.0)), 0)[0].a
    assert a[0] == 1.0
    assert a[1] == pytest.approx(-0.9, abs=0.06)
    assert np.abs(a[2:]).max(initial=0.0) < 0.08


def _drifting(rng: np.random.Generator, n: int, pole: float) -> np.ndarray:
    """A first-order drift of unit variance."""
    drift, kicks = np.empty(n), rng.normal(0.0, np.sqrt(1.0 - pole * pole), n)
    value = 0.0
    for k in range(n):
        value = pole * value + kicks[k]
        drift[k] = value
    return drift


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("law", [SHARED, SHARED[:7], (1, 2, 3)])
def test_lags_that_share_a_coefficient_are_summed_in_least_squares(law: tuple[int, ...], *, moves: bool) -> None:
    rng = np.random.default_rng(4)
    n, plant = 300, (0.7, 6.5, 2.3)
    data = centre(Record(np.cumsum(rng.normal(size=n)), np.cumsum(rng.normal(size=n)), 1.0), "fopdt")
    y, begin = np.diff(data.y, prepend=data.y[0]) if moves else data.y, MOST_LAGS + moves
    own = np.empty((MOST_LAGS + 1, MOST_LAGS + 1))
    lagged(y, y, begin, MOST_LAGS + 1, own)
    beside = Beside(data, y, own, data.u, 0, plant, begin, moves)

    columns = predict(data, data.u, 0, Fit(0.0, *plant[1:], 1.0, 0.0, 0.0, 0.0))[1]
    if moves:
        columns = np.diff(columns, axis=1, prepend=0.0)
    rest = y - plant[0] * columns[1]
    groups = [range(first + 1, last + 1) for first, last in zip((0, *law), law, strict=False)]
    past = [sum(rest[begin - lag : n - lag] for lag in group) for group in groups]
    matrix = np.column_stack([*past, *(column for column in columns[[0, 2, 3], begin:] if column.any())])
    solved, *_ = np.linalg.lstsq(matrix / (scale := np.linalg.norm(matrix, axis=0)), rest[begin:], rcond=None)
    left = rest[begin:] - matrix @ (solved / scale)
    assert beside.level(law) == pytest.approx((n - begin) * math.log(float(np.mean(left**2))), rel=1e-9)
    terms = [-solved[i] / scale[i] for i, group in enumerate(groups) for _ in group]
    np.testing.assert_allclose(beside.filter_of(law), [1.0, *terms], rtol=1e-6, atol=1e-9)


def test_noise_upon_a_load_that_drifts_is_remembered_for_long_by_few_coefficients() -> None:
    few, gains = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        n, x = 3000, np.repeat(rng.choice([-1.0, 1.0], size=60), 50)
        answer = np.convolve(np.roll(x, 3), 0.1 * 0.9 ** np.arange(80))[:n]
        data = centre(Record(answer + 0.5 * _drifting(rng, n, 0.99) + rng.normal(0.0, 0.3, n), x, 1.0), "fopdt")
        limits, fit = Limits((LEAST_TAU, float(n)), (0.0, 30.0)), Fit(0.0, 8.0, 3.0, 0.9, 0.0, 0.0, 0.0)
        (a, shared), (_, theta) = colour_beside(data, data.u, 0, fit, limits, 0)
        there = data.whitened(a, 0, shared)
        few.append(there.terms < a.size - 1)
        assert there.terms == (len(shared) or a.size - 1)
        gains.append(fit_path(there, data.u, 0, (-math.inf, math.inf), limits, theta).gain)
    assert sum(few) >= 4
    assert np.abs(np.array(gains) - 1.0).max() < 0.1


def test_what_a_level_sums_up_of_a_load_is_coloured_in_its_changes() -> None:
    rng = np.random.default_rng(8)
    n, x = 3000, np.repeat(rng.choice([-1.0, 1.0], size=100), 30)
    summed = np.cumsum(0.02 * (np.roll(x, 3) + _drifting(rng, n, 0.9)))
    data = centre(Record(np.concatenate([[0.0], summed[:-1]]), x, 1.0), "integrating")
    limits, fit = Limits((LEAST_TAU, float(n)), (0.0, 30.0)), Fit(0.0, 1.0, 5.0, 0.012, 0.0, 0.0, 0.0)
    (a, _), (_, theta) = colour_beside(data, data.u, 0, fit, limits, 0, moves=True)
    # How the level changes is a drift of the pole 0.9, which takes a constant away altogether.
    assert a[:3] == pytest.approx([1.0, -1.9, 0.9], abs=0.15)
    assert float(a.sum()) == pytest.approx(0.0, abs=1e-12)
    found = fit_path(data.whitened(a, 0), data.u, 0, (-math.inf, math.inf), limits, theta)
    assert (found.gain, found.theta) == (pytest.approx(0.02, rel=0.03), pytest.approx(3.0, abs=0.1))
    assert found.bias == 0.0  # nothing of it is seen in that measure, not even its rounding


@pytest.mark.parametrize(("seed", "plant"), [(1, "integrating"), (6, "auto")])
def test_a_level_under_a_slow_load_tells_its_valve_and_gain(seed: int, plant: str) -> None:
    # What it sums up of the load, in PV itself, hides the slips that are right: d came out up to 40 % off, the gain to
    # half of it or twice.
    n, d = 700, 3.0
    load = 0.25 * d * _drifting(np.random.default_rng(seed), n, 0.99)
    loop = wb.Loop(wb.Integrating(0.02, 4.0), wb.Stenman(d), wb.PID(Kc=2.0, Ti=80.0), sample_time=1.0)
    noise = wb.Noise(0.05, seed)
    run = wb.simulate(loop, wb.Experiment(float(n), None, wb.Series(load.tolist()), noise))
    found = wb.estimate(wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0), plant=plant)
    assert found.verdict == "stiction"
    assert isinstance(found.plant, wb.Integrating)
    assert found.valve.stick_band == pytest.approx(d, rel=0.02)
    assert found.plant.gain == pytest.approx(0.02, rel=0.15)
    low, high = found.intervals.gain
    assert low <= 0.02 <= high
