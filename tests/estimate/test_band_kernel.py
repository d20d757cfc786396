"""The grid that two-parameter stems are screened over: the sums of squares of numpy's least squares."""

from __future__ import annotations

import numpy as np
import pytest
from lags import DELAYS, POLES, N, left, signals

from workbench.estimate.kernels.bands import screen_drive, sums_of


@pytest.mark.parametrize(("skip", "known"), [(0, 0), (9, 0), (0, 30), (9, 30), (60, 30)])
def test_a_drive_known_from_some_sample_on_is_judged_by_what_answers_to_that(skip: int, known: int) -> None:
    drive, y = signals(5)
    room = np.zeros((13, N + 1))
    own = sums_of(y, POLES, DELAYS, skip)
    for j, pole in enumerate(POLES.tolist()):
        for d, delay in enumerate(DELAYS.tolist()):
            best = np.array([np.inf, 0.0, 0.0])
            within = (j, j + 1, d, d + 1)
            screen_drive(drive, y, POLES, DELAYS, within, 0.0, skip, known, True, own, room, best)
            counted = np.arange(N) >= (max(skip, known + delay + 1) if known else skip)
            expected = left(drive, y, pole, delay, counted, 0.0)
            assert best[0] * counted.sum() / N == pytest.approx(expected, rel=1e-7)
            assert best[1:].tolist() == [j, d]


@pytest.mark.parametrize(("skip", "known"), [(0, 0), (9, 30)])
@pytest.mark.parametrize(
    ("poles", "delays"), [(slice(None), slice(None)), (slice(1, 3), slice(2, None)), (slice(1), slice(1))]
)
def test_of_a_grid_the_best_is_told(skip: int, known: int, poles: slice, delays: slice) -> None:
    drive, y = signals(5)
    many = np.concatenate([POLES, np.linspace(0.1, 0.95, 14)])  # several of four side by side
    which = np.arange(many.size)[poles] if poles.stop else np.arange(many.size)
    at = np.arange(DELAYS.size)[delays]
    own, room, best = sums_of(y, many, DELAYS, skip), np.zeros((13, N + 1)), np.array([np.inf, 0.0, 0.0])
    within = (int(which[0]), int(which[-1]) + 1, int(at[0]), int(at[-1]) + 1)
    screen_drive(drive, y, many, DELAYS, within, 0.0, skip, known, True, own, room, best)
    costs = {}
    for j in which.tolist():
        for d in at.tolist():
            counted = np.arange(N) >= (max(skip, known + DELAYS[d] + 1) if known else skip)
            costs[j, d] = left(drive, y, many[j], DELAYS[d], counted, 0.0) * N / counted.sum()
    assert best[0] == pytest.approx(min(costs.values()), rel=1e-7)
    assert tuple(best[1:]) == min(costs, key=costs.__getitem__)
