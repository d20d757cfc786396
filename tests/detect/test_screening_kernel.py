"""The screening kernels: the same sums of squares as numpy's least squares, whatever samples do not count."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lags import DELAYS, POLES, N, left, signals

from workbench.detect.lags import LANES
from workbench.detect.stem import stem_test
from workbench.detect.stem_kernel import plant, screen, settle, stems_abreast
from workbench.detect.whitening import noise, whiten
from workbench.model.valve import Choudhury, Stenman
from workbench.simulate.coefficients import valve_law
from workbench.simulate.kernel import STAIRS, TWO_PARAMETER
from workbench.simulate.run import valve_response


def stems(seed: int) -> tuple[np.ndarray, list[tuple[Stenman | Choudhury, float]]]:
    """An output and valves of either kind, more than there are lanes, with where they rest: OP less stem."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(size=N))
    valves: list[tuple[Stenman | Choudhury, float]] = []
    for _ in range(LANES + 3):
        width = float(rng.uniform(0.2, 4.0))
        valves.append((Stenman(width), float(rng.uniform(-1.0, 1.0)) * width))
        valves.append((Choudhury(width, float(rng.uniform(0.0, 1.5)) * width), 0.0))
    return u, valves


def rows_of(valves: list[tuple[Stenman | Choudhury, float]]) -> np.ndarray:
    return np.array([(valve_law(v).band, valve_law(v).offset, rest) for v, rest in valves])


@pytest.mark.parametrize("kind", [STAIRS, TWO_PARAMETER])
def test_stems_side_by_side_move_as_each_alone(kind: int) -> None:
    u, valves = stems(11)
    some = [(v, rest) for v, rest in valves if isinstance(v, Stenman) == (kind == STAIRS)][: LANES - 2]
    x, room = np.empty(N * LANES), np.empty(5 * LANES)
    stems_abreast(kind, u, rows_of(some), room, x)
    for j in range(LANES):
        valve, rest = some[min(j, len(some) - 1)]
        alone = valve_response(valve, u, float(u[0]), float(u[0]) - rest)
        assert (x[j::LANES] == alone - alone[0]).all()
        assert np.ptp(alone) > 0.0


@pytest.mark.parametrize("first", [0, 5, 8])
@pytest.mark.parametrize("sign", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("held", [slice(0, 0), slice(60, 75)])
@pytest.mark.parametrize("kind", [STAIRS, TWO_PARAMETER])
def test_the_best_plant_of_each_stem_is_that_of_least_squares(kind: int, held: slice, sign: float, first: int) -> None:
    live = np.ones(N, dtype=bool)
    live[held] = False
    counted = live & (np.arange(N) >= first)
    u, valves = stems(12)
    some = [(v, rest) for v, rest in valves if isinstance(v, Stenman) == (kind == STAIRS)]
    paths = [valve_response(v, u, float(u[0]), float(u[0]) - rest) for v, rest in some]
    rng = np.random.default_rng(13)
    y = np.convolve(paths[2], 0.2 * 0.8 ** np.arange(20))[:N] + 0.3 * rng.normal(size=N)
    a = np.array([1.0, -0.4, 0.1, 0.0, -0.05])
    best = np.empty(len(some))
    screen(kind, u, rows_of(some), a, y, live, POLES, first, DELAYS, sign, best)
    for path, found in zip(paths, best.tolist(), strict=True):
        drive = np.convolve(a, path - path[0])[:N]
        costs = [left(drive, y, p, d, counted, sign) for d in DELAYS.tolist() for p in POLES.tolist()]
        assert found == pytest.approx(min(costs), rel=1e-7)
    assert best[2] < 0.5 * best.max() or sign < 0.0


def two_taps(moves: np.ndarray, y: np.ndarray, tau: float, delay: int, counted: np.ndarray) -> np.ndarray:
    """What is left of y at the samples that count beside two neighbouring dead times, one where they part in sign."""
    z = np.zeros(N)
    for k in range(N - 1):
        z[k + 1] = math.exp(-1.0 / tau) * z[k] + (1.0 - math.exp(-1.0 / tau)) * moves[k]
    near = np.concatenate([np.zeros(delay), z[: N - delay]])
    far = np.concatenate([np.zeros(delay + 1), z[: N - delay - 1]])
    first = float(np.flatnonzero(counted)[0])
    columns = np.column_stack([np.ones(N), np.exp(-(np.arange(N) - first) / tau), near, far])[counted]
    terms, *_ = np.linalg.lstsq(columns, y[counted], rcond=1e-12)
    if terms[2] * terms[3] < 0.0:
        columns = columns[:, :3]
        terms, *_ = np.linalg.lstsq(columns, y[counted], rcond=1e-12)
    return y[counted] - columns @ terms


@pytest.mark.parametrize("first", [5, 8])
@pytest.mark.parametrize("held", [slice(0, 0), slice(60, 75)])
def test_a_plant_is_least_squares_and_none_beside_it_is_better(held: slice, first: int) -> None:
    live = np.ones(N, dtype=bool)
    live[held] = False
    counted = live & (np.arange(N) >= first)
    drive, y = signals(3)
    taus, longest = np.geomspace(0.5, 300.0, 20), 10.0 * N
    residual, white = np.empty(N), np.array([1.0, 0.0, 0.0])
    cost, tau, delay = plant(y, drive, white, live, first, taus, DELAYS, 0.0, longest, residual)
    best = two_taps(drive - drive[0], y, tau, delay, counted)
    assert cost == pytest.approx(float(best @ best), rel=1e-8)
    for factor in (1.0 / 1.03, 1.0, 1.03):
        for late in (max(delay - 1, 0), delay, delay + 1):
            other = two_taps(drive - drive[0], y, tau * factor, late, counted)
            assert cost <= float(other @ other) * (1.0 + 1e-9)
    assert 3.0 < tau < 8.0
    # What the plant leaves of PV still holds the constant and the transient, and no more than that.
    rest = np.column_stack([np.ones(N), np.exp(-np.arange(N) / tau)])[counted]
    terms, *_ = np.linalg.lstsq(rest, residual[counted], rcond=1e-12)
    assert residual[counted] - rest @ terms == pytest.approx(best, abs=1e-9)


def test_a_gain_of_the_wrong_sign_is_none() -> None:
    drive, y = signals(4)
    live, white, residual = np.ones(N, dtype=bool), np.array([1.0]), np.empty(N)
    taus = np.geomspace(0.5, 300.0, 8)
    cost, _, _ = plant(-y, drive, white, live, 4, taus, DELAYS, 1.0, 1000.0, residual)
    right, _, _ = plant(-y, drive, white, live, 4, taus, DELAYS, -1.0, 1000.0, residual)
    assert right < 0.7 * cost
    assert np.abs(residual + y).max() > 0.1 * np.abs(y).max()


def test_a_dead_time_far_from_the_grid_s_is_reached_and_the_measure_is_the_filter_s() -> None:
    drive = signals(6)[0]
    delays = np.array([0, 1, 12], dtype=np.int64)
    late = np.concatenate([np.zeros(7), drive[: N - 7]])
    y = np.convolve(late - late[0], np.concatenate([[0.0], 0.2 * 0.8 ** np.arange(60)]))[:N]
    live, residual, taus = np.ones(N, dtype=bool), np.empty(N), np.geomspace(0.5, 300.0, 20)
    cost, tau, delay = plant(y, drive, np.array([1.0, -0.5]), live, 4, taus, delays, 0.0, 1600.0, residual)
    assert delay in (6, 7)
    assert tau == pytest.approx(-1.0 / math.log(0.8), rel=0.03)
    filtered = np.convolve([1.0, -0.5], residual)[4:N]
    columns = np.column_stack([np.ones(N - 4), np.exp(-np.arange(N - 4) / tau)])
    terms, *_ = np.linalg.lstsq(columns, filtered, rcond=1e-12)
    assert float(((filtered - columns @ terms) ** 2).sum()) == pytest.approx(cost, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("order", [0, 1, 6])
def test_whitening_is_the_filter_from_rest(order: int) -> None:
    rng = np.random.default_rng(order)
    a = np.concatenate([[1.0], rng.normal(size=order)])
    row = rng.normal(size=700)
    out = np.empty_like(row)
    whiten(a, row, out)
    assert out == pytest.approx(np.convolve(a, row)[:700], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("held", [slice(0, 0), slice(60, 75)])
def test_a_residual_s_noise_is_least_squares_of_its_past(held: slice, smooth: bool) -> None:
    order, pole = 6, 0.93
    live = np.ones(N, dtype=bool)
    live[held] = False
    e = np.cumsum(np.random.default_rng(8).normal(size=N))
    if smooth:
        # A sinusoid and a parabola: the normal equations have no more rank than five.
        e = np.sin(0.3 * np.arange(N)) + 1e-4 * np.arange(N) ** 2.0
    lags = [e[order - 1 - i : N - 1 - i] for i in range(order)]
    columns = np.column_stack([*lags, np.ones(N - order), pole ** np.arange(N - order)])[live[order:]]
    wanted = e[order:][live[order:]]
    terms, *_ = np.linalg.lstsq(columns, wanted, rcond=1e-12)
    a = np.empty(order + 1)
    variance = noise(e, live, order, pole, a)
    expected = float(((wanted - columns @ terms) ** 2).mean())
    assert variance == pytest.approx(expected, rel=1e-9, abs=1e-12 * float(e.var()))
    if not smooth:
        assert a == pytest.approx(np.concatenate([[1.0], -terms[:order]]), rel=1e-7)


def test_a_rival_settles_on_the_best_of_its_rounds() -> None:
    drive, y = signals(9)
    y = y + np.cumsum(np.random.default_rng(10).normal(size=N)) * 0.2
    live, order, taus, longest = np.ones(N, dtype=bool), 4, np.geomspace(0.5, 300.0, 20), 10.0 * N
    filters, residuals = np.empty((3, order + 1)), np.empty((3, N))
    a = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    found = settle(y, drive, a, live, order, taus, DELAYS, 0.0, longest, 3, filters, residuals)
    rounds = []
    for i in range(3):
        residual, following = np.empty(N), np.empty(order + 1)
        _, tau, delay = plant(y, drive, a, live, order, taus, DELAYS, 0.0, longest, residual)
        rounds.append((noise(residual, live, order, math.exp(-1.0 / tau), following), tau, delay))
        assert (residuals[i] == residual).all()
        assert (filters[i] == following).all()
        a = following
    assert found[1:] == min(rounds)
    assert rounds[found[0]] == min(rounds)
    assert len({variance for variance, _, _ in rounds}) > 1


def test_a_thinned_record_or_one_that_may_only_be_read_asks_for_no_kernel_of_its_own() -> None:
    op = 3.0 * np.sin(np.arange(3600) * 2.0 * np.pi / 250.0)
    stem = valve_response(Stenman(1.0), op)
    pv, fitted = np.cumsum(stem) / 50.0, (Stenman(1.0), stem)

    def compiled() -> list[int]:
        return [len(one.signatures) for one in (settle, plant, screen)]  # type: ignore[attr-defined]

    assert stem_test(pv, op, None, 1.0, 90.0, 0.0, fitted=fitted).samples > 3000
    before = compiled()
    assert stem_test(pv, op, None, 1.0, 250.0, 0.0, fitted=fitted).samples <= 1800
    assert compiled() == before
    stem.setflags(write=False)
    stem_test(pv, op, None, 1.0, 90.0, 0.0, fitted=fitted)
    assert compiled() == before
