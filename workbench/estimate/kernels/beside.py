"""What a model leaves of PV beside a load that no stem makes, steps or a sinusoid, whose sizes are free."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.output_error import oe_columns, plant_terms, solve
from workbench.simulate.compiled import compiled

__all__ = ["left_beside", "left_swinging"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@compiled
def left_beside(
    y: Floats, x: Floats, first: int, integrating: bool, tau: float, theta: float, times: Ints, skip: int
) -> float:
    """Mean square that the model beside steps whose answers begin at some samples leaves of PV from `skip` on.

    x, first: the stem path, shape (N,), and its first slip; tau, theta: samples. Every column's size is free.
    """
    n = y.size
    columns = np.zeros((4 + times.size, n))
    pole, c0, c1, m = plant_terms(integrating, tau, theta)
    oe_columns(x, first, pole, m, c0, c1, integrating, columns[:4])
    for q in range(times.size):
        rest = 1.0
        for k in range(times[q], n):
            columns[4 + q, k] = k - times[q] if integrating else 1.0 - rest
            rest *= pole
    return _left(y, columns, skip) / (n - skip)


@compiled
def left_swinging(y: Floats, x: Floats, first: int, integrating: bool, tau: float, theta: float, angle: float) -> float:
    """Sum of squares that the model beside a sinusoid leaves of PV; angle: rad a sample, the rest as `left_beside`."""
    n = y.size
    columns = np.empty((6, n))
    pole, c0, c1, m = plant_terms(integrating, tau, theta)
    oe_columns(x, first, pole, m, c0, c1, integrating, columns[:4])
    turn, across = math.cos(angle), math.sin(angle)
    cosine, sine = 1.0, 0.0
    for k in range(n):
        columns[4, k], columns[5, k] = cosine, sine
        cosine, sine = turn * cosine - across * sine, across * cosine + turn * sine
    return _left(y, columns, 0)


@compiled
def _left(y: Floats, columns: Floats, skip: int) -> float:
    """Sum of squares that columns, shape (m, N), leave of y from `skip` on, by least squares."""
    size = columns.shape[0]
    g = np.empty((size + 1, size))
    for i in range(size):
        for j in range(i, size):
            g[i, j] = np.dot(columns[i, skip:], columns[j, skip:])
        g[size, i] = np.dot(columns[i, skip:], y[skip:])
    solve(g, size)
    left = 0.0
    for k in range(skip, y.size):
        error = y[k]
        for i in range(size):
            error -= g[size, i] * columns[i, k]
        left += error * error
    return left
