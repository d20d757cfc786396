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
