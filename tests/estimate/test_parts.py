"""Sums of a lag's response in parts of the record side by side: the same as sample after sample."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from workbench.estimate.kernels.output_error import FIT, cost_at, plant_terms, posed
from workbench.estimate.kernels.parts import (
    AFTER,
    PARTS,
    SS,
    SY,
    WEIGHTED_S,
    S,
    in_parts,
    parted,
    sum_fading,
    sum_parts,
)


@pytest.mark.parametrize("n", [400, 403, 1111])
@pytest.mark.parametrize(
    ("integrating", "tau", "theta"),
    [(False, 0.05, 0.0), (False, 4.0, 3.6), (False, 900.0, 9.25), (True, 1.0, 0.0), (True, 1.0, 5.3)],
)
def test_sums_in_parts_are_those_of_the_whole(n: int, integrating: bool, tau: float, theta: float) -> None:
    rng = np.random.default_rng(n)
    y, drive, begin, s = rng.normal(size=n), np.cumsum(rng.normal(size=n)), 23, 0.7
    pole, c0, c1, m = plant_terms(integrating, tau, theta)
    parts = in_parts(y, begin, 10)
    assert parts.size == (n - begin) // PARTS
    parted(drive, parts)
    sum_parts(parts, m, (pole, c0, c1), integrating, s)
    k = np.arange(begin, begin + PARTS * parts.size)
    moves = c0 * drive[k - m] + c1 * drive[k - m - 1]
    answered, _ = lfilter([1.0], [1.0, -pole], moves, zi=[pole * s])
    response = np.concatenate([[s], answered[:-1]])
    at = np.arange(k.size, dtype=float)
    weights = at if integrating else pole**at
    sums = parts.sums
    assert sums[S] == pytest.approx(response.sum(), rel=1e-10)
    assert sums[SS] == pytest.approx(response @ response, rel=1e-10)
    assert sums[SY] == pytest.approx(response @ y[k], rel=1e-9)
    assert sums[WEIGHTED_S] == pytest.approx(weights @ response, rel=1e-9)
    assert sums[AFTER] == pytest.approx(answered[-1], rel=1e-10)


@pytest.mark.parametrize(("begin", "stop"), [(3, 3), (0, 5), (2, 18), (7, 200)])
@pytest.mark.parametrize("pole", [1e-9, 0.3, 0.999, 1.0])
def test_sums_by_fading_weights(begin: int, stop: int, pole: float) -> None:
    y, at = np.random.default_rng(1).normal(size=200), np.arange(stop - begin, dtype=float)
    total, weighted, weight = sum_fading(y, begin, stop, pole, pole == 1.0)
    weights = at if pole == 1.0 else pole**at
    assert total == pytest.approx(y[begin:stop].sum(), rel=1e-12, abs=1e-13)
    assert weighted == pytest.approx(weights @ y[begin:stop], rel=1e-12, abs=1e-13)
    assert weight == pytest.approx(at.size if pole == 1.0 else pole**at.size, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("integrating", [False, True])
def test_dead_times_beyond_what_was_said_cost_what_they_cost(integrating: bool) -> None:
    rng = np.random.default_rng(2)
    y, drive, out = rng.normal(size=900), np.cumsum(rng.normal(size=900)), np.empty(FIT)
    bounds, white = (-math.inf, math.inf, 0.0), np.ones(1)
    near, far = (posed(y, drive, 0, bounds, integrating, white, 0, longest) for longest in (2, 70))
    for theta in (0.0, 2.3, 15.0, 16.0, 40.7, 69.9):
        assert cost_at(near, 6.0, theta, out) == pytest.approx(cost_at(far, 6.0, theta, out), rel=1e-10)
