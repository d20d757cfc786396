"""The screening kernels: the same sums of squares as numpy's least squares, whatever samples do not count."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.detect import kernel

N = 160
POLES = np.array([0.05, 0.5, 0.9, 0.97, 0.9995, 0.3, 0.8])
DELAYS = np.array([0, 1, 3, 7], dtype=np.int64)


def signals(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.normal(size=N // 8), 8)
    drive -= drive[0]
    return drive, np.convolve(drive, 0.2 * 0.8 ** np.arange(20))[:N] + 0.3 * rng.normal(size=N)


def left(drive: np.ndarray, y: np.ndarray, pole: float, delay: int, counted: np.ndarray, sign: float) -> float:
    """What a constant, a transient and the delayed lag leave of y at the samples that count."""
    z = np.zeros(N)
    for k in range(N - 1):
        z[k + 1] = pole * z[k] + (1.0 - pole) * drive[k]
    answer = np.concatenate([np.zeros(delay), z[: N - delay]])
    first = int(np.flatnonzero(counted)[0])
    columns = np.column_stack([np.ones(N), pole ** (np.arange(N) - float(first)), answer])[counted]
    terms, *_ = np.linalg.lstsq(columns, y[counted], rcond=1e-9)
    if terms[2] * sign < 0.0:
        columns = columns[:, :2]
        terms, *_ = np.linalg.lstsq(columns, y[counted], rcond=1e-9)
    return float(((y[counted] - columns @ terms) ** 2).sum())


@pytest.mark.parametrize("sign", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("held", [slice(0, 0), slice(60, 75)])
def test_the_best_plant_of_each_drive_is_that_of_least_squares(sign: float, held: slice) -> None:
    first = 5
    live = np.ones(N, dtype=bool)
    live[held] = False
    drives = np.array([signals(1)[0], signals(2)[0], -signals(1)[0]])
    y = signals(1)[1]
    best, pole_at, delay_at = np.empty(3), np.zeros(3, np.int64), np.zeros(3, np.int64)
    kernel.screen(y, live, drives, POLES, first, DELAYS, sign, best, pole_at, delay_at)
    counted = live & (np.arange(N) >= first)
    for i, drive in enumerate(drives):
        costs = np.array([[left(drive, y, p, d, counted, sign) for d in DELAYS.tolist()] for p in POLES.tolist()])
        assert best[i] == pytest.approx(costs.min(), rel=1e-7)
        if costs.min() < 0.9 * np.median(costs):
            assert costs[pole_at[i], delay_at[i]] == pytest.approx(costs.min(), rel=1e-7)
    assert best[0] < 0.5 * float(np.var(y[counted]) * counted.sum()) or sign < 0.0


@pytest.mark.parametrize("held", [slice(0, 0), slice(60, 75)])
def test_two_dead_times_share_a_gain_as_least_squares_shares_it(held: slice) -> None:
    first, pole = 5, 0.8
    live = np.ones(N, dtype=bool)
    live[held] = False
    counted = live & (np.arange(N) >= first)
    drive, y = signals(3)
    z = np.empty(N)
    kernel.lagged(drive, pole, z)
    costs, gains = np.empty(4), np.zeros((4, 2))
    kernel.taps(y, live, drive, pole, first, (0, 3), 0.0, costs, gains)
    for delay in range(4):
        near = np.concatenate([np.zeros(delay), z[: N - delay]])
        far = np.concatenate([np.zeros(delay + 1), z[: N - delay - 1]])
        columns = np.column_stack([np.ones(N), pole ** np.arange(N, dtype=float), near, far])[counted]
        terms, *_ = np.linalg.lstsq(columns, y[counted], rcond=1e-12)
        if terms[2] * terms[3] < 0.0:
            columns = columns[:, :3]
            terms = np.append(np.linalg.lstsq(columns, y[counted], rcond=1e-12)[0], 0.0)
            rest = y[counted] - columns @ terms[:3]
        else:
            rest = y[counted] - columns @ terms
        assert costs[delay] == pytest.approx(float(rest @ rest), rel=1e-8)
        assert gains[delay] == pytest.approx(terms[2:], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("order", [0, 1, 6])
def test_whitening_is_the_filter_from_rest(order: int) -> None:
    rng = np.random.default_rng(order)
    a = np.concatenate([[1.0], rng.normal(size=order)])
    rows = rng.normal(size=(3, 40))
    out = np.empty_like(rows)
    kernel.whiten(a, rows, out)
    for row, found in zip(rows, out, strict=True):
        assert found == pytest.approx(np.convolve(a, row)[:40], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("held", [slice(0, 0), slice(60, 75)])
def test_an_autoregression_s_normal_equations_are_those_of_its_columns(held: slice) -> None:
    order, pole = 6, 0.93
    live = np.ones(N, dtype=bool)
    live[held] = False
    e = np.cumsum(np.random.default_rng(7).normal(size=N))
    gram, side = np.empty((order + 2, order + 2)), np.empty(order + 2)
    kernel.own_products(e, live, order, pole, gram, side)
    lags = [e[order - 1 - i : N - 1 - i] for i in range(order)]
    columns = np.column_stack([*lags, np.ones(N - order), pole ** np.arange(N - order)])[live[order:]]
    assert gram == pytest.approx(columns.T @ columns, rel=1e-10)
    assert side == pytest.approx(columns.T @ e[order:][live[order:]], rel=1e-10)


@pytest.mark.parametrize(("skip", "known"), [(0, 0), (9, 0), (0, 30), (9, 30), (60, 30)])
def test_a_drive_known_from_some_sample_on_is_judged_by_what_answers_to_that(skip: int, known: int) -> None:
    drive, y = signals(5)
    room, sums = np.empty((4, N)), np.zeros((3, 4, N + 1))
    given = kernel.sums_of(y, POLES, DELAYS, skip)
    for j, pole in enumerate(POLES.tolist()):
        for d, delay in enumerate(DELAYS.tolist()):
            best = np.array([np.inf, 0.0, 0.0])
            within = (j, j + 1, d, d + 1)
            kernel.screen_drive(drive, y, POLES, DELAYS, within, 0.0, skip, known, True, *given, room, sums, best)
            counted = np.arange(N) >= (max(skip, known + delay + 1) if known else skip)
            expected = left(drive, y, pole, delay, counted, 0.0)
            assert best[0] * counted.sum() / N == pytest.approx(expected, rel=1e-7)
            assert best[1:].tolist() == [j, d]
