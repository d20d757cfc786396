"""A plane of tunings, searched without a gap: a run in every neighbourhood that a tuning may have.

The worst J of a tuning is at least J anywhere in its neighbourhood. On a grid as wide as neighbourhoods every one of
them holds a point; where J there is above the least worst case known, no tuning around that point does better. Most
runs are given up within some dozen samples, and of the points seldom one in a thousand is left: around those a finer
grid is asked in the same way. A run whose valve travels further than is allowed is as good as one above; points about
which no tuning keeps the margins that are asked for are left out. Three dimensions have too many neighbourhoods: there
a coarser grid of runs finds the valleys that populations miss.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from workbench.model.ensemble import Constraints
from workbench.model.record import FloatArray
from workbench.model.results import ASKED_FROM
from workbench.simulate.batch import FIRST_LOOK
from workbench.tune.problem import NAMES, Problem
from workbench.tune.region import Region
from workbench.tune.scan import spread

__all__ = ["Sieved", "sieve"]

Possible = Callable[[Sequence[NDArray[np.int64]]], NDArray[np.bool_]]

# Each pass has the points between those of the one before: the first good tunings spare the others most of their runs,
# and what the first passes cost tells early whether the whole plane is within the budget.
STRIDES, STRIDES_3 = (16, 8, 4, 2, 1), (64, 32, 16)
# Early passes cost more per point, as less is known: so many times the budget may they predict.
DEAR = {64: 2.0}, {16: 2.0, 8: 1.2}
# Kc and Td may start at 0, where a relative neighbourhood has no width: then from `ASKED_FROM` of the upper bound, or
# this share of the best tuning known.
LEAST_KNOWN = 0.1
# Neighbourhoods along one axis at most: a plane of more is beyond any budget.
FINEST = 20_000
# Points of one call, and samples of plain runs that they may take, after which one that is to stop is asked; and points
# whose finer grids are asked in one call.
POINTS, PART_SAMPLES, LOOK = 100_000, 100_000_000, 200
# The finer grid's steps in a half-width, and so the points of it that every neighbourhood holds in each direction.
FINE, HELD = 2, 4
# Tunings whose own worst case is looked at after each call: what they reach is the next ceiling.
TRIED, APART = 4, 1e-4
TIE = 1e-9  # of J: what is no further below the best is no better
# So many of the best are kept; the others are no better, so that `Sieved.least` still holds.
KEPT = 5_000


class Sieved:
    """What is left of a plane: tunings, shape (M, 3), and what their worst J is at least, shape (M,), the least first.

    whole: whether every neighbourhood was asked; if so, none has a worst J below `least`.
    """

    def __init__(self, tuning: FloatArray, ceiling: float) -> None:
        self.ceiling, self.whole = ceiling, False
        self.tunings, self.bounds = tuning[None, :], np.array([ceiling])

    @property
    def asked(self) -> float:
        """What a neighbourhood must have a J below to be kept: where all do alike, none is better than the best."""
        return self.ceiling * (1.0 - TIE)

    @property
    def least(self) -> float:
        """What no worst J of the plane is below."""
        return min(self.asked, float(self.bounds.min(initial=math.inf)))

    def add(self, problem: Problem, tunings: FloatArray, bounds: FloatArray, region: Region | None) -> None:
        """Keep tunings that may be better, and lower the ceiling to what the best of them reach."""
        likely = bounds
        if region is not None:
            near = region.near(tunings)
            tunings, bounds = tunings[near], bounds[near]
            likely = np.where(region.missed(tunings) <= 0.0, bounds, np.inf)
        likely = np.concatenate([self.bounds, likely])
        self.tunings, self.bounds = np.concatenate([self.tunings, tunings]), np.concatenate([self.bounds, bounds])
        self.reach(problem, self.tunings[spread(problem.cube(self.tunings), likely, TRIED, APART)])

    def reach(self, problem: Problem, tunings: FloatArray) -> None:
        """Lower the ceiling to the worst J of any of these tunings, shape (K, 3), and drop what cannot be below it."""
        reached = problem.spread(problem.rounded(tunings), np.full(tunings.shape[0], self.ceiling))
        self.ceiling = min(self.ceiling, float(reached.min(initial=math.inf)))
        keep = np.flatnonzero(self.bounds <= self.ceiling)
        keep = keep[np.argsort(self.bounds[keep], kind="stable")[:KEPT]]
        self.tunings, self.bounds = self.tunings[keep], self.bounds[keep]


def sieve(
    problem: Problem,
    tuning: FloatArray,
    ceiling: float,
    improved: Callable[[FloatArray], FloatArray],
    most: float,
    stop: Callable[[], bool],
    tell: Callable[[float], None] = lambda _: None,
) -> Sieved:
    """Ask every neighbourhood of the plane of one or two free parameters whether its worst J is below a ceiling.

    Of three free parameters, every 16th value of each is asked for J alone, and nothing is proved.
    tuning: shape (3,), the best known; ceiling: the worst J that is to be beaten, of one that keeps all constraints;
    those that do not keep them are left out. improved: makes better tunings, shape (K, 3), of the best of some, between
    the passes. most: samples of plain runs (`Problem.price`) that all of it may cost; given up as soon as it is likely
    to cost more. `stop` is asked between parts of the grid, and `tell` told the share of its points that are done.
    """
    left = Sieved(tuning, ceiling)
    axes = [_axis(problem, tuning, k) for k in problem.free.tolist()]
    if any(axis.size > FINEST for axis in axes) or not math.isfinite(left.ceiling):
        return left
    whole, done, price = _count(axes, 1 if len(axes) <= 2 else STRIDES_3[-1]), 0, float(FIRST_LOOK)
    passed = 0
    began, flat = problem.work.simulated, len(axes) <= 2
    asked = problem.constraints
    region = None
    if asked is not None and asked != Constraints(valve_travel=asked.valve_travel):
        region = Region(problem, axes if flat else [axis[:: STRIDES_3[-1]] for axis in axes])

    def spent() -> float:
        return problem.price * (problem.work.simulated - began)

    for before, stride in itertools.pairwise((0, *(STRIDES if flat else STRIDES_3))):
        if spent() + problem.price * price * (whole - done) > most * DEAR[flat].get(stride, 1.0):
            return left
        first = problem.work.simulated
        count = min(POINTS, PART_SAMPLES / problem.samples / problem.price)
        for part in _parts(axes, stride, before, count, None if region is None else region.possible):
            for points, costs in _survivors(problem, part, left.asked):
                if stop():
                    return left
                left.add(problem, *(_windows(problem, points, left.asked) if flat else (points, costs)), region)
            passed += part.shape[0]
            tell(passed / whole)
        # Of few values on each axis a finer stride adds none.
        price = (problem.work.simulated - first) / max(_count(axes, stride) - done, 1)
        left.reach(problem, improved(left.tunings))
        done = passed = _count(axes, stride)
    left.whole = flat
    return left


def _axis(problem: Problem, tuning: FloatArray, k: int) -> FloatArray:
    """The values of one parameter, each a neighbourhood's width above the last."""
    low, high = getattr(problem.bounds, NAMES[k])
    share = min(ASKED_FROM * high, LEAST_KNOWN * float(tuning[k])) or ASKED_FROM * high
    at = low if low > 0.0 else share
    values: list[float] = []
    while at < high and len(values) <= FINEST:
        values.append(at)
        at += 2.0 * float(problem.radius(np.full((1, 3), at))[0, k])
    return np.array([*values, high])


def _count(axes: list[FloatArray], stride: int) -> int:
    """How many points the grid has at a stride."""
    return math.prod(-(-axis.size // stride) for axis in axes)


def _parts(
    axes: list[FloatArray], stride: int, before: int, count: float, possible: Possible | None = None
) -> Iterator[FloatArray]:
    """The points of one stride that those of the one before (0: none) have not, shape (M, parameters), in parts.

    count: about how many points a part has, new ones or not. possible: which of them are not left out, by their places
    on the axes, in three dimensions by those of the last stride.
    """
    every = 1 if len(axes) <= 2 else STRIDES_3[-1]
    rows = max(1, int(count) // math.prod(-(-axis.size // stride) for axis in axes[1:]))
    first = np.arange(0, axes[0].size, stride)
    for begin in range(0, first.size, rows):
        along = (first[begin : begin + rows], *(np.arange(0, axis.size, stride) for axis in axes[1:]))
        index = np.meshgrid(*along, indexing="ij")
        new: NDArray[np.bool_] = np.any([some % before if before else some >= 0 for some in index], axis=0)
        if possible is not None:
            new &= possible([some // every for some in index])
        yield np.stack([axis[some[new]] for axis, some in zip(axes, index, strict=True)], axis=1)


def _survivors(problem: Problem, part: FloatArray, ceiling: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The tunings, shape (L, 3), of a part of the grid whose J is below the ceiling; at least once, if of none."""
    grid = np.tile(problem.low, (part.shape[0], 1))
    grid[:, problem.free] = part
    costs = problem.least_below(grid, np.full(grid.shape[0], ceiling))
    left = np.flatnonzero(np.isfinite(costs))
    for begin in range(0, max(left.size, 1), LOOK):
        some = left[begin : begin + LOOK]
        yield grid[some], costs[some]


def _windows(problem: Problem, points: FloatArray, ceiling: float) -> tuple[FloatArray, FloatArray]:
    """Return tunings, shape (M, 3), around which a finer grid has no J above the ceiling, and the largest J there.

    points: shape (L, 3), of the grid. Every neighbourhood that holds one of them holds a window of the finer grid, and
    its tuning lies at most half a step of that from the window's middle.
    """
    free = problem.free
    steps = np.arange(-2 * FINE, 2 * FINE + 1) / FINE
    offsets = np.array(list(itertools.product(steps, repeat=free.size)))
    # The least half-width within reach: at a power of ten that of a last digit changes.
    radius = problem.radius(points - 2.0 * problem.radius(points))[:, None, free]
    fine = np.repeat(points[:, None, :], offsets.shape[0], axis=1)
    fine[:, :, free] = np.clip(fine[:, :, free] + offsets * radius, problem.low[free], problem.high[free])
    costs = problem.least_below(fine.reshape(-1, 3), np.full(fine.shape[0] * fine.shape[1], ceiling))
    over = sliding_window_view(
        costs.reshape(points.shape[0], *[steps.size] * free.size),
        [HELD] * free.size,
        axis=tuple(range(1, free.size + 1)),
    )
    largest = over.max(axis=tuple(range(-free.size, 0)))
    which = np.argwhere(np.isfinite(largest))
    middle = points[which[:, 0]]
    middle[:, free] += (steps[which[:, 1:]] + (HELD - 1) / 2.0 / FINE) * radius[which[:, 0], 0]
    return np.clip(middle, problem.low, problem.high), largest[np.isfinite(largest)]
