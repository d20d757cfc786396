"""The global scan: differential evolution over the unit cube, a whole generation in one call of the kernel.

Every trial has its parent's value as the ceiling, so that most runs stop early. Method: R. Tanabe, A. Fukunaga,
"Improving the search performance of SHADE using linear population size reduction", IEEE CEC 2014, 1658-1665.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray

__all__ = ["Population", "evolve", "sized", "spread"]

# (points, ceilings) -> values, inf where a value exceeds its ceiling.
Evaluate = Callable[[FloatArray, FloatArray], FloatArray]
LEAST = 8  # members of the last generation
MEMORY = 5
ARCHIVE = 1.4
BEST_SHARE = 0.15
# A population whose values agree to this (relative) has nothing left to find.
AGREED = 1e-9


@dataclass(frozen=True, eq=False)
class Population:
    """Points of the unit cube, shape (M, D), and their values, shape (M,), the best first."""

    points: FloatArray
    values: FloatArray


def evolve(
    evaluate: Evaluate,
    start: FloatArray,
    generations: int,
    rng: np.random.Generator,
    *,
    stop: Callable[[], bool] = lambda: False,
    keep: Callable[[FloatArray, FloatArray], None] | None = None,
) -> Population:
    """Minimise over the unit cube from a start population, shape (M, D), which shrinks linearly to `LEAST` members.

    `stop` is asked before each generation. `keep` is told of every improvement (points, values), for a caller that
    collects more than the last population. Ends early where all members agree.
    """
    points = np.clip(start, 0.0, 1.0)
    count, dims = points.shape
    values = evaluate(points, np.full(count, np.inf))
    if keep is not None:
        keep(points, values)
    archive = np.zeros((0, dims))
    scale, cross = np.full(MEMORY, 0.5), np.full(MEMORY, 0.8)
    slot = 0
    for generation in range(generations):
        if stop():
            break
        order = np.argsort(values, kind="stable")
        if values[order[-1]] <= values[order[0]] + AGREED * abs(values[order[0]]) and np.isfinite(values[order[0]]):
            break
        wanted = max(LEAST, round(count + (LEAST - count) * generation / max(generations, 1)))
        order = order[:wanted]
        points, values = points[order], values[order]
        m = values.size
        pick = rng.integers(MEMORY, size=m)
        F = np.minimum(np.maximum(scale[pick] + 0.1 * np.tan(np.pi * (rng.random(m) - 0.5)), 0.05), 1.0)
        CR = np.minimum(np.maximum(rng.normal(cross[pick], 0.1), 0.0), 1.0)
        best = rng.integers(max(2, round(BEST_SHARE * m)), size=m)
        first = rng.integers(m, size=m)
        pool = np.concatenate([points, archive])
        second = rng.integers(pool.shape[0], size=m)
        mutant = points + F[:, None] * (points[best] - points + points[first] - pool[second])
        # Half way back to the parent keeps a trial inside; now and then the bound itself is tried, where a PI lies.
        edge = np.minimum(np.maximum(mutant, 0.0), 1.0)
        half = np.where(mutant < 0.0, points / 2.0, np.where(mutant > 1.0, (points + 1.0) / 2.0, mutant))
        mutant = np.where(rng.random(m)[:, None] < 0.3, edge, half)
        swap = rng.random(m * dims).reshape(m, dims) < CR[:, None]
        swap[np.arange(m), rng.integers(dims, size=m)] = True
        trial = np.where(swap, mutant, points)
        found = evaluate(trial, values)
        better = found < values
        equal = found <= values
        if better.any():
            weight = _weights(values[better], found[better])
            squares = float((weight * F[better] ** 2).sum())
            scale[slot] = squares / max(float((weight * F[better]).sum()), 1e-12)
            cross[slot] = float((weight * CR[better]).sum())
            slot = (slot + 1) % MEMORY
            archive = np.concatenate([archive, points[better]])
            limit = int(ARCHIVE * m)
            if archive.shape[0] > limit:
                archive = archive[rng.permutation(archive.shape[0])[:limit]]
        points = np.where(equal[:, None], trial, points)
        values = np.where(equal, found, values)
        if keep is not None and better.any():
            keep(points[better], values[better])
    order = np.argsort(values, kind="stable")
    return Population(points[order], values[order])


def _weights(before: FloatArray, after: FloatArray) -> FloatArray:
    """Shares of each success in the adaptation, by its gain; a success over an infinite value counts by what it has."""
    gain = np.where(np.isfinite(before), before - after, after)
    gain = np.maximum(gain / max(float(gain.max()), 1e-300), 1e-12)
    shares: FloatArray = gain / gain.sum()
    return shares


def spread(points: FloatArray, values: FloatArray, count: int, gap: float) -> NDArray[np.int64]:
    """Return the indices of up to `count` of the best points of which no two are nearer than `gap` in every direction.

    points: shape (M, D); values: shape (M,); those that are not finite are left out.
    """
    order = np.argsort(values, kind="stable")
    left = order[np.isfinite(values[order])]
    chosen: list[int] = []
    while left.size and len(chosen) < count:
        chosen.append(int(left[0]))
        left = left[(np.abs(points[left] - points[left[0]]) > gap).any(axis=1)]
    return np.array(chosen, dtype=np.int64)


def sized(count: int, scale: float) -> int:
    """Return a size of a search for longer runs, which get less: scale in (0, 1]."""
    return max(40, round(count * scale))
