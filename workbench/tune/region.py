"""Where on a grid of tunings the margins that constraints ask for are kept.

Margins change smoothly, and cost more than a run that is given up early: the border between the tunings that keep them
and those that do not is followed from a coarse grid to the finest, and nothing else is asked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from workbench.model.record import FloatArray
from workbench.tune.limits import beyond, more_than_sensitivity
from workbench.tune.problem import Problem

__all__ = ["Region"]

# The coarsest grid's step, a power of 2, and how many points it has along an axis at least; the largest miss, a
# logarithm, and that of an unstable loop; and by how much of one a tuning between grid points may seem to miss a
# sensitivity that it keeps.
COARSEST, FEWEST, LOST, NEARLY = 16, 12, 1.0, 0.01


class Region:
    """Which points of a grid have a tuning about them that keeps the margins, and by how much a tuning misses them.

    axes: of the free parameters, each rising.
    """

    def __init__(self, problem: Problem, axes: Sequence[FloatArray]) -> None:
        self._problem, self._axes = problem, axes
        steps = [COARSEST >> max(math.ceil(math.log2(COARSEST * FEWEST / axis.size)), 0) or 1 for axis in axes]
        missed = self._asked(
            np.meshgrid(*(axis[::step] for axis, step in zip(axes, steps, strict=True)), indexing="ij")
        )
        while max(steps) > 1:
            missed, steps = self._finer(missed, steps), [max(step // 2, 1) for step in steps]
        self._missed = missed
        # Between a point and its neighbours a tuning may be what none of them is only if they differ.
        self._possible: NDArray[np.bool_] = maximum_filter(missed <= 0.0, 3)

    def possible(self, index: Sequence[NDArray[np.int64]]) -> NDArray[np.bool_]:
        """Return whether a tuning that keeps the margins may lie as near to a point as to its neighbours."""
        which: NDArray[np.bool_] = self._possible[tuple(index)]
        return which

    def missed(self, tunings: FloatArray) -> FloatArray:
        """Return by how much of a logarithm tunings, shape (M, 3), miss a margin, below 0 where they keep it, (M,)."""
        between: FloatArray = map_coordinates(self._missed, self._at(tunings), order=1, mode="nearest")
        return between

    def near(self, tunings: FloatArray) -> NDArray[np.bool_]:
        """Return whether tunings, shape (M, 3), may keep the margins for all that is known of the grid about them."""
        asked = self._problem.constraints
        if asked is not None and more_than_sensitivity(asked):
            # Where another crossing becomes the nearest, a gain or phase margin jumps.
            at = np.minimum(np.rint(self._at(tunings)).astype(np.int64), np.array([self._missed.shape]).T - 1)
            return self.possible(list(at))
        near: NDArray[np.bool_] = self.missed(tunings) <= NEARLY
        return near

    def _at(self, tunings: FloatArray) -> FloatArray:
        """Where tunings lie between the points of the axes, shape (parameters, M)."""
        free = self._problem.free
        at = [np.interp(tunings[:, k], axis, np.arange(axis.size)) for k, axis in zip(free, self._axes, strict=True)]
        return np.array(at)

    def _finer(self, missed: FloatArray, steps: Sequence[int]) -> FloatArray:
        """The grid of half the steps: the old points, points near the border, and elsewhere what is next to them."""
        kept = missed <= 0.0
        border = maximum_filter(kept, 3) != minimum_filter(kept, 3)
        index = [np.arange(0, axis.size, max(step // 2, 1)) for axis, step in zip(self._axes, steps, strict=True)]
        old = zip(index, steps, missed.shape, strict=True)
        nearest = np.ix_(*(np.minimum((i + step // 2) // step, n - 1) for i, step, n in old))
        finer = missed[nearest].copy()
        grids = np.meshgrid(*index, indexing="ij")
        new = border[nearest] & np.any([grid % step != 0 for grid, step in zip(grids, steps, strict=True)], axis=0)
        finer[new] = self._asked([axis[grid[new]] for axis, grid in zip(self._axes, grids, strict=True)])
        return finer

    def _asked(self, values: Sequence[FloatArray]) -> FloatArray:
        """By how much tunings of such values of the free parameters miss the margins; of the values' shape."""
        problem, asked = self._problem, self._problem.constraints
        if asked is None or not values[0].size:
            return np.zeros(values[0].shape)
        tunings = np.tile(problem.low, (values[0].size, 1))
        tunings[:, problem.free] = np.stack([value.ravel() for value in values], axis=1)
        margins, stable = problem.margins(tunings, all_three=more_than_sensitivity(asked))
        missed: FloatArray = np.where(stable, np.clip(beyond(asked, margins), -LOST, LOST), LOST)
        return missed.reshape(values[0].shape)
