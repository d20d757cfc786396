"""The sums of a run that its figures and objectives are made of, and the objective that weighs them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.kpi.kpis import STILL
from workbench.simulate.compiled import compiled

__all__ = ["FEW_SUMS", "SUMS", "WEIGHTS", "add_sums", "weigh", "weigh_all"]

Floats = NDArray[np.float64]

# Columns of a run's sums over e_k = r_k - y_k (measured), u_k and x_k: squares of e_1..e_N, of u, of e_N, of moves of u
# and of e_0..e_{N-1}; |moves of x|; where all are asked for, |e|, e, u, |moves of u|, x, x^2, stem reversals, y, y^2.
ERROR2, OP2, FINAL2, MOVES2, WINDOW2, TRAVEL, IAE, ERROR, OP, OP_TRAVEL, STEM, STEM2, REVERSALS, PV, PV2 = range(15)
FEW_SUMS, SUMS = 6, 15
# Weights of an objective: of the first four sums, which is eq. (2), then of WINDOW2, TRAVEL, IAE, OP_TRAVEL, REVERSALS,
# of the variances of e, u and x, and of the standard deviation of y.
WEIGHTS = 13


@compiled
def add_sums(
    sums: Floats, last: Floats, every: bool, r: Floats, noise: Floats, y: Floats, u: Floats, x: Floats
) -> None:
    """Add a stretch of a run to its sums (SUMS values; the first FEW_SUMS unless `every`).

    r, noise, y: one value more than u and x; last: u, x and the direction of the last stem move before the stretch, and
    after it.
    """
    u_last, x_last, direction = last[0], last[1], last[2]
    squares, outputs, moves, window, travel = sums[ERROR2], sums[OP2], sums[MOVES2], sums[WINDOW2], sums[TRAVEL]
    e = r[0] - (y[0] + noise[0])
    for k in range(u.size):
        window += e * e
        out, stem = u[k], x[k]
        if every:
            measured = y[k] + noise[k]
            sums[IAE] += abs(e)
            sums[ERROR] += e
            sums[OP] += out
            sums[OP_TRAVEL] += abs(out - u_last)
            sums[STEM] += stem
            sums[STEM2] += stem * stem
            sums[PV] += measured
            sums[PV2] += measured * measured
            if abs(stem - x_last) > STILL:
                way = 1.0 if stem > x_last else -1.0
                if direction != 0.0 and way != direction:
                    sums[REVERSALS] += 1.0
                direction = way
        e = r[k + 1] - (y[k + 1] + noise[k + 1])
        squares += e * e
        outputs += out * out
        moves += (out - u_last) * (out - u_last)
        travel += abs(stem - x_last)
        u_last = out
        x_last = stem
    sums[ERROR2], sums[OP2], sums[MOVES2], sums[WINDOW2], sums[TRAVEL] = squares, outputs, moves, window, travel
    sums[FINAL2] = e * e
    last[0], last[1], last[2] = u_last, x_last, direction


@compiled
def weigh(sums: Floats, weights: Floats, count: int, n: int) -> float:
    """J of the first `count` of n samples (see WEIGHTS); it never falls as samples are added.

    e_N counts once `count` is n. A weight of 0 leaves its sum out, whatever it is.
    """
    cost = 0.0
    for j in range(4):
        if weights[j] > 0.0 and (j != FINAL2 or count == n):
            cost += weights[j] * sums[j]
    for j, column in ((4, WINDOW2), (5, TRAVEL), (6, IAE), (7, OP_TRAVEL), (8, REVERSALS)):
        if weights[j] > 0.0:
            cost += weights[j] * sums[column]
    for j, mean, square in ((9, ERROR, WINDOW2), (10, OP, OP2), (11, STEM, STEM2), (12, PV, PV2)):
        if weights[j] > 0.0:
            # The sum of squares about the mean so far; max would pass over a nan.
            spread = (sums[square] - sums[mean] * sums[mean] / count) / n
            spread = 0.0 if spread < 0.0 else spread
            cost += weights[j] * (np.sqrt(spread) if j == 12 else spread)
    return cost


@compiled
def weigh_all(sums: Floats, weights: Floats, n: int, costs: Floats) -> None:
    """J of whole runs of n samples from their sums, a row each; inf where a run overflowed."""
    for i in range(costs.size):
        cost = weigh(sums[i], weights, n, n)
        costs[i] = cost if np.isfinite(cost) else np.inf
