"""The estimation's kernels: the same stem law as the simulation, exact enumeration, least squares as numpy does it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import lfilter

import workbench as wb
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import Fit, predict
from workbench.estimate.kernels import walk as walk_kernel
from workbench.estimate.kernels.fit import oe_fit
from workbench.estimate.kernels.output_error import FIT, GAIN, START, TAU, THETA, drive_of, oe_columns, oe_cost
from workbench.estimate.kernels.path import stem_slips
from workbench.estimate.kernels.walk import COST, D_HIGH, D_LOW, DELAY, ROW, SLIPS, at_delays, walk
from workbench.estimate.search.stems import path_of
from workbench.model.plant import FOPDT, Integrating
from workbench.model.record import Record
from workbench.model.valve import Stenman
from workbench.simulate.coefficients import discretise
from workbench.simulate.run import valve_response

FREE = (-np.inf, np.inf)
WHITE = (np.ones(1), 0)  # no filter, every sample counts

outputs = arrays(np.float64, st.integers(3, 60), elements=st.integers(-40, 40).map(lambda i: i / 8.0))


@settings(deadline=None, max_examples=100)
@given(op=outputs, d=st.floats(0.01, 6.0), x0=st.floats(-6.0, 6.0))
def test_the_stem_path_is_the_simulations(op: np.ndarray, d: float, x0: float) -> None:
    """From its first slip on, the path of the estimation equals `valve_response` with any start that leads to it."""
    x = valve_response(Stenman(d), op, x0)
    moved = np.flatnonzero(np.diff(x, prepend=x0))
    if moved.size == 0:
        return
    first = int(moved[0])
    path, slips = path_of(op, d, first)
    assert np.array_equal(path[first:], x[first:])
    assert slips == moved.size
    assert not path[:first].any()


@settings(deadline=None, max_examples=60)
@given(op=outputs)
def test_walking_meets_every_path_once_and_says_how_long_each_holds(op: np.ndarray) -> None:
    if np.ptp(op) == 0.0:
        return
    y = np.arange(op.size, dtype=np.float64) % 3 - 1.0
    data = centre(Record(np.resize(y, 40), np.resize(op, 40), 1.0), "fopdt")
    rows = np.empty((400, ROW))
    n = walk(
        data.sums,
        data.squares,
        data.products,
        data.u,
        0,
        0.01,
        100.0,
        0.0,
        at_delays(data.sums, np.arange(3)),
        math.nan,
        0.0,
        rows,
    )
    found = rows[:n]
    assert (found[1:, D_LOW] >= found[:-1, D_HIGH]).all()
    bands = np.linspace(0.011, float(np.ptp(op)) * 1.01, 60)
    for d in bands:
        row = found[(found[:, D_LOW] <= d) & (d < found[:, D_HIGH])]
        if not len(row):
            continue  # a path to which no plant could be fitted
        assert len(row) == 1
        assert np.array_equal(path_of(data.u, float(d), 0)[0], path_of(data.u, float(row[0, D_LOW]), 0)[0])


def test_a_walk_that_drops_more_links_than_its_heap_holds_meets_the_same_paths(monkeypatch) -> None:
    """A smooth cycle re-routes nearly all of its slips at each breakpoint; each row is that of a path routed anew."""
    op = 3.0 * np.sin(0.13 * np.arange(300)) + 0.2 * np.sin(0.029 * np.arange(300))
    pv = np.convolve(op, [0.0, 0.2, 0.3, 0.1])[:300] + np.random.default_rng(1).normal(0, 0.1, 300)
    data = centre(Record(pv, op, 1.0), "fopdt")
    shifted, refilled = at_delays(data.sums, np.arange(3)), []
    refill = walk_kernel._refill
    monkeypatch.setattr(walk_kernel, "_refill", lambda *given: refilled.append(1) or refill(*given))

    def rows_of(d_from: float, d_to: float, walking=walk) -> np.ndarray:
        rows = np.empty((2500, ROW))
        signals = data.sums, data.squares, data.products, data.u
        return rows[: walking(*signals, 0, d_from, d_to, 0.0, shifted, math.nan, 0.0, rows)]

    found = rows_of(0.01, 8.0, walk.py_func)
    assert len(found) > 300
    assert refilled
    for row in found[::7]:
        (anew,) = rows_of(row[D_LOW], math.nextafter(row[D_LOW], math.inf))
        assert anew[SLIPS] == row[SLIPS]
        assert anew[COST] == pytest.approx(row[COST], rel=1e-9)
    np.testing.assert_array_equal(found[1:, D_LOW], found[:-1, D_HIGH])
    np.testing.assert_allclose(rows_of(0.01, 8.0), found, rtol=1e-9)


@pytest.mark.parametrize("delays", [[2], list(range(1, 20)), [0, 2, 5, 9, 40]])
@pytest.mark.parametrize("first", [0, 7, 30])
@pytest.mark.parametrize("integrating", [False, True])
def test_the_one_step_cost_is_numpys_least_squares(first: int, integrating: bool, delays: list[int]) -> None:
    rng = np.random.default_rng(3)
    op = np.cumsum(rng.normal(0, 0.5, 200))
    pv = np.convolve(op, [0.0, 0.2, 0.3, 0.1])[:200] + rng.normal(0, 0.3, 200)
    data = centre(Record(pv, op, 1.0), "fopdt")
    rows = np.empty((1, ROW))
    shifted = at_delays(data.sums, np.array(delays))
    pole = 1.0 if integrating else math.nan
    signals = data.sums, data.squares, data.products, data.u
    assert walk(*signals, first, 0.8, 0.8001, 0.0, shifted, pole, 0.0, rows) == 1
    x, _ = path_of(data.u, 0.8, first)
    k = np.arange(199)
    target = data.y[1:] - data.y[:-1] if integrating else data.y[1:]
    least = {}
    for delay in delays:
        answered = np.where(k - delay >= 0, x[np.maximum(k - delay, 0)], 0.0)
        regressors = [answered, np.ones(199), (k < first + delay).astype(float)]
        if not integrating:
            regressors.append(data.y[:-1])
        matrix = np.column_stack(regressors)
        terms = np.linalg.lstsq(matrix, target, rcond=None)[0]
        least[delay] = float(((matrix @ terms - target) ** 2).sum())
    assert rows[0, DELAY] == min(least, key=lambda delay: least[delay])
    assert rows[0, COST] == pytest.approx(min(least.values()), rel=1e-9)


@pytest.mark.parametrize("plant", [FOPDT(2.0, 5.0, 1.7), FOPDT(-0.5, 0.4, 0.0), Integrating(0.3, 2.25)])
def test_the_output_error_model_is_the_simulations_plant(plant: FOPDT | Integrating) -> None:
    """Columns and cost reproduce the exact plant driven by a known stem."""
    rng = np.random.default_rng(1)
    op = np.cumsum(rng.normal(0, 0.6, 300))
    x = valve_response(Stenman(1.0), op, 0.4)
    first = int(np.flatnonzero(np.diff(x, prepend=0.4))[0])
    law = discretise(plant, 1.0)
    y = np.zeros(300)
    for k in range(299):
        near = x[k - law.delay] if k >= law.delay else 0.4
        far = x[k - law.delay - 1] if k > law.delay else 0.4
        y[k + 1] = law.pole * y[k] + law.gain * (law.c0 * near + law.c1 * far)
    integrating = isinstance(plant, Integrating)
    data = centre(Record(y + 50.0, op + 30.0, 1.0), "integrating" if integrating else "fopdt")
    path, _ = path_of(data.u, 1.0, first)
    out = np.empty(FIT)
    tau = 1.0 if integrating else plant.time_constant
    cost = oe_cost(
        data.y, path, first, *FREE, float(np.sign(plant.gain)), integrating, tau, plant.dead_time, *WHITE, out
    )
    assert cost <= 1e-12 * float(data.y @ data.y)
    assert out[GAIN] == pytest.approx(plant.gain, rel=1e-6)
    fitted, _ = predict(data, path, first, Fit(*(float(v) for v in out)))
    assert np.abs(fitted - data.y).max() < 1e-5 * np.std(data.y)


def test_a_gain_of_the_wrong_sign_is_not_fitted() -> None:
    rng = np.random.default_rng(2)
    op = np.cumsum(rng.normal(0, 0.6, 200))
    data = centre(Record(-op + 5.0, op, 1.0), "fopdt")
    out = np.empty(FIT)
    free = oe_cost(data.y, data.u, 0, -np.inf, np.inf, 0.0, False, 0.05, 0.0, *WHITE, out)
    assert out[GAIN] < 0.0
    held = oe_cost(data.y, data.u, 0, -np.inf, np.inf, 1.0, False, 0.05, 0.0, *WHITE, out)
    assert out[GAIN] == 0.0
    assert held > 4.0 * free


def test_the_start_is_held_within_its_range() -> None:
    rng = np.random.default_rng(5)
    op = np.cumsum(rng.normal(0, 0.6, 200))
    data = centre(Record(np.roll(op, 3), op, 1.0), "fopdt")
    first = 12
    path, _ = path_of(data.u, 1.0, first)
    out = np.empty(FIT)
    free = oe_cost(data.y, path, first, -np.inf, np.inf, 0.0, False, 2.0, 2.0, *WHITE, out)
    wanted = out[START] / out[GAIN]
    held = oe_cost(data.y, path, first, wanted + 1.0, wanted + 2.0, 0.0, False, 2.0, 2.0, *WHITE, out)
    assert out[START] / out[GAIN] == pytest.approx(wanted + 1.0)
    assert held > free


def test_the_simplex_finds_time_constant_and_dead_time() -> None:
    rng = np.random.default_rng(8)
    op = np.repeat(rng.normal(0, 2, 30), 10)
    out = np.empty(FIT)
    columns = np.empty((4, 300))
    pole = math.exp(-1.0 / 6.0)
    oe_columns(op, 0, pole, 3, 1 - pole**0.6, pole**0.6 - pole, False, columns)
    y = 1.5 * columns[1]
    white = np.ones(1)
    cost = oe_fit(
        y, op, 0, -np.inf, np.inf, 0.0, False, 3.0, 2.0, (0.05, 300.0), (0.0, 30.0), 0.15, 400, 1e-14, white, 0, out
    )
    assert cost < 1e-8 * float(y @ y)
    assert (out[TAU], out[THETA], out[GAIN]) == pytest.approx((6.0, 3.4, 1.5), rel=1e-3)


@pytest.mark.parametrize("start", [0.0, 0.1, 0.3, 1.0, 2.0])
def test_the_simplex_leaves_a_limit_that_it_has_met(start: float) -> None:
    """From all points on a dead time of 0 it never would, and a fraction of a sample be found from some starts only."""
    rng = np.random.default_rng(5)
    loop = wb.Loop(wb.FOPDT(1.0, 6.0, 0.15), Stenman(2.2), wb.PID(Kc=0.6, Ti=6.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=wb.Step(4.0)))
    pv = run.pv + 0.04 * rng.normal(size=run.pv.size)
    out = np.empty(FIT)
    cost = oe_fit(
        pv - pv.mean(),
        run.valve,
        0,
        -np.inf,
        np.inf,
        0.0,
        False,
        12.0,
        start,
        (0.05, 1000.0),
        (0.0, 30.0),
        0.3,
        400,
        1e-12,
        np.ones(1),
        0,
        out,
    )
    assert cost < 1.05 * 0.04**2 * pv.size
    assert out[THETA] == pytest.approx(0.15, abs=0.04)
    assert out[TAU] == pytest.approx(6.0, rel=0.02)


@pytest.mark.parametrize("n", [200, 900])  # one by one, and in parts side by side
@pytest.mark.parametrize("integrating", [False, True])
@pytest.mark.parametrize("bounds", [FREE, (1.0, 2.0)])
@pytest.mark.parametrize(
    ("coefficients", "skip", "first"),
    [
        ((1.0,), 0, 3),
        ((1.0,), 5, 0),
        ((1.0, -1.2, 0.4), 2, 0),
        ((1.0, -1.2, 0.4), 7, 3),
        ((1.0, -0.6, 0.0, -0.3), 4, 90),
    ],
)
def test_the_cost_is_least_squares_of_the_filtered_columns(
    n: int, integrating: bool, bounds: tuple[float, float], coefficients: tuple[float, ...], skip: int, first: int
) -> None:
    """Filtering the drive once is filtering each column: the lag and the filter may change places."""
    rng = np.random.default_rng(4)
    op, y = np.cumsum(rng.normal(0, 0.5, n)), rng.normal(size=n)
    a, theta = np.array(coefficients), 2.3
    pole = 1.0 if integrating else math.exp(-1.0 / 6.0)
    part = 0.7 if integrating else 1.0 - pole**0.7
    columns = np.empty((4, n))
    oe_columns(op, first, pole, 2, part, 1.0 - pole - part if not integrating else 0.3, integrating, columns)
    filtered, target = lfilter(a, [1.0], columns, axis=1)[:, skip:], lfilter(a, [1.0], y)
    free, *_ = np.linalg.lstsq(filtered.T, target[skip:], rcond=None)
    if np.isfinite(bounds[0]):
        x0 = float(np.clip(free[2] / free[1], *bounds))
        held = np.array([filtered[0], filtered[1] + x0 * filtered[2], filtered[3]])
        left = target[skip:] - np.linalg.lstsq(held.T, target[skip:], rcond=None)[0] @ held
    else:
        left = target[skip:] - free @ filtered
    out = np.empty(FIT)
    drive = np.empty(n)
    drive_of(op, first, a, drive)
    cost = oe_cost(target, drive, first, *bounds, 0.0, integrating, 6.0, theta, a, skip, out)
    assert cost == pytest.approx(float(left @ left), rel=1e-9)


def test_compiled_and_python_agree() -> None:
    rng = np.random.default_rng(11)
    op = np.cumsum(rng.normal(0, 0.5, 60))
    for d in (0.3, 1.1):
        at, again = np.empty(60, np.int64), np.empty(60, np.int64)
        assert stem_slips(op, d, 2, at) == stem_slips.py_func(op, d, 2, again)  # type: ignore[attr-defined]


def test_first_slips_are_where_op_leaves_all_it_was() -> None:
    op = np.tile([1.0, 1.0, 2.0, 1.5, 0.5, 2.0, 3.0, 0.5, 0.0], 4)
    starts = centre(Record(np.arange(36.0), op, 1.0), "fopdt").starts
    assert starts.firsts.tolist() == [0, 2, 4, 6, 8]
    assert starts.ranged.tolist() == [0.0, 0.0, 1.0, 1.5, 2.5]
    assert starts.senses[1:].tolist() == [1.0, -1.0, 1.0, -1.0]
