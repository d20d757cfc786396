"""The search for the least worst case within the digits, from the best tunings that the searches for J have passed.

The landscape of worst cases has many valleys, and more so the longer the run and the more noise is in it. A plane of
one or two free parameters is searched without a gap where that is affordable (`sieve`), and otherwise, as three
dimensions are, from many starts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from workbench.model.record import FloatArray
from workbench.tune.budget import stopper
from workbench.tune.limits import WORN
from workbench.tune.problem import Problem
from workbench.tune.scan import Population, evolve, sized, spread
from workbench.tune.sieve import Sieved, sieve

__all__ = ["Worst", "least_worst"]

ISLAND_FRESH, ISLAND_GENERATIONS = 20, 60
# Members and generations in three dimensions, and in one or two, where there is time for more.
JOINT, JOINT_FLAT = (80, 200), (200, 400)
DENSE_MEMBERS, DENSE_GENERATIONS, DENSE_GAP = 60, 100, 2e-4
ROUNDS, ROUNDS_FLAT, VALLEYS, GAP = 2, 4, 24, 3e-3
# And so many of the best that are hardly apart: which of them thin cliffs spare is told by the last word alone.
NEXT_BEST = 600
# Tunings of an unfinished sieve that make a pool of their own.
SIEVED = 60
# Samples that each population may simulate at most: some seconds.
SAMPLES = 150_000_000
# Samples that a sieve may take for each restart, some seconds; fewer than so many restarts ask for a quick answer.
SIEVE_SAMPLES, SIEVE_RESTARTS = 1_900_000_000, 3
# A least worst case as near to what the sieve proves needs no other search.
SETTLED = 0.85
# Where J itself is asked: half-widths of boxes in the unit cube, ever smaller, how many of the best tunings have one
# about them, and a box's members and generations.
BOXES, BOX_MEMBERS, BOX_GENERATIONS = ((1e-1, 24), (1e-2, 16), (1e-3, 8)), 40, 40
# Members and generations between the passes of a sieve, the most of its tunings that they start from, and how many
# they hand back.
QUICK_MEMBERS, QUICK_GENERATIONS, QUICK_OF, QUICK_ENDS = 60, 40, 2_000, 4
# Of the progress told: where a sieve ends, and where the last word on the best begins.
SIEVING, LAST_WORD = 0.5, 0.9
# Powers of ten of how far a start's surroundings reach, in the unit cube.
AROUND = (-4.0, -1.5)


@dataclass(frozen=True, eq=False)
class Worst:
    """Tunings among which the one of least worst case is, shape (M, 3), and what no worst J of the plane is below.

    bound: -inf where the search was not of every neighbourhood.
    """

    tunings: FloatArray
    bound: float = -math.inf


@dataclass(eq=False)
class _Search:
    """Populations on one problem, and every improvement that they have passed."""

    problem: Problem
    scale: float
    check: Callable[[], None]
    points: list[FloatArray] = field(default_factory=list)
    values: list[FloatArray] = field(default_factory=list)

    def keep(self, points: FloatArray, values: FloatArray) -> None:
        self.points.append(points)
        self.values.append(values)

    def evolve(
        self, start: FloatArray, generations: int, rng: np.random.Generator, *, dense: bool = False
    ) -> Population:
        """A population of points of the unit cube, shape (M, D), for the sparsely or densely sampled worst case."""
        problem = self.problem
        return evolve(
            lambda x, ceilings: problem.worst_below(problem.rounded(problem.tunings(x)), ceilings, dense=dense),
            start,
            sized(generations, self.scale),
            rng,
            stop=stopper(problem, problem.work.simulated + SAMPLES, self.check),
            keep=self.keep if not dense else None,
        )

    def best(self, count: int, gap: float, first: int = 0) -> FloatArray:
        """The best points passed since the `first` call of `keep`, apart from each other, shape (M, D)."""
        points, values = np.concatenate(self.points[first:]), np.concatenate(self.values[first:])
        return points[spread(points, values, count, gap)]

    def quick(self, tunings: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Better tunings than the best of some, shape (M, 3) -> (QUICK_ENDS, 3), at the digits to type in."""
        some = self.problem.rounded(tunings[:QUICK_OF])
        start = self.problem.cube(some)
        least = self.problem.worst_below(some, np.full(some.shape[0], np.inf))
        start = start[spread(start, least, QUICK_MEMBERS, DENSE_GAP)]
        if not start.shape[0]:
            return some[:1]
        # Few starts are surrounded, nearer and further, so that a population can move at all.
        fill = rng.integers(start.shape[0], size=QUICK_MEMBERS - start.shape[0])
        around = rng.normal(size=(fill.size, start.shape[1])) * 10.0 ** rng.uniform(*AROUND, (fill.size, 1))
        start = np.concatenate([start, np.clip(start[fill] + around, 0.0, 1.0)])
        end = self.evolve(start, QUICK_GENERATIONS, rng).points[:QUICK_ENDS]
        return self.problem.rounded(self.problem.tunings(end))


def least_worst(
    problem: Problem,
    pools: list[FloatArray],
    seed: list[int],
    scale: float,
    restarts: int,
    check: Callable[[], None],
    tell: Callable[[float], None],
    ceiling: float = math.inf,
) -> Worst:
    """Search for the least worst case, from the pools of all restarts, at the digits to type in.

    Each pool is searched by itself, then the best of all together, and all of that some times, each from other members
    of the pools; a sieved plane that leaves little open needs none of that. So far with few points of each
    neighbourhood; from the best at last with many. In a nominal problem boxes about the best stand for that. tell:
    called with the share done. ceiling: a worst J known from elsewhere, above which a tuning of the plane is of no
    interest.
    """
    search = _Search(problem, scale, check)
    bound = -math.inf
    sure = restarts >= SIEVE_RESTARTS and not problem.nominal
    left = _sieved(search, pools, seed, SIEVE_SAMPLES * restarts, tell, ceiling) if sure else None
    if left is not None and left.whole:
        bound = left.least
        start = problem.rounded(left.tunings)
        search.keep(problem.cube(start), problem.worst_below(start, np.full(start.shape[0], np.inf)))
        _together(search, np.random.default_rng([*seed, 0]), 0)
    if bound < SETTLED * min((float(values.min()) for values in search.values), default=math.inf):
        # Not sieved, or what the sieve leaves may still hold a better one.
        if left is not None:
            some = spread(problem.cube(left.tunings), left.bounds, SIEVED, GAP)
            pools = [*pools, left.tunings[some]]
        (_boxes if problem.nominal else _islands)(search, pools, seed, tell)
    tell(LAST_WORD)
    rng = np.random.default_rng([*seed, ROUNDS_FLAT])
    best = search.best(sized(DENSE_MEMBERS, scale), DENSE_GAP)
    if not best.size:
        return Worst(problem.rounded(np.concatenate(pools)))
    population = search.evolve(best, DENSE_GENERATIONS, rng, dense=True)
    next_best = search.best(VALLEYS, GAP), search.best(NEXT_BEST, DENSE_GAP)
    tunings = problem.tunings(np.concatenate([population.points, *next_best]))
    return Worst(tunings, bound)


def _islands(search: _Search, pools: list[FloatArray], seed: list[int], tell: Callable[[float], None]) -> None:
    """Search each pool by itself, then the best of all together; each round from other members of the pools."""
    problem = search.problem
    rounds = ROUNDS_FLAT if problem.free.size <= 2 else ROUNDS
    for k in range(rounds):
        tell(SIEVING + (LAST_WORD - SIEVING) * k / rounds)
        rng = np.random.default_rng([*seed, k])
        first = len(search.points)
        for pool in [problem.guesses(), *pools]:
            fresh = rng.random((ISLAND_FRESH, problem.free.size))
            search.evolve(np.concatenate([problem.cube(pool[k::rounds]), fresh]), ISLAND_GENERATIONS, rng)
        _together(search, rng, first)


def _boxes(search: _Search, pools: list[FloatArray], seed: list[int], tell: Callable[[float], None]) -> None:
    """Search the best of all pools together, then about each of the best by itself, ever nearer.

    J itself is rough at every scale, under noise above all: one population ends in one of its many pits, and the best
    of them are seldom next to each other.
    """
    problem, rng = search.problem, np.random.default_rng([*seed, 0])
    start = np.unique(np.concatenate([problem.guesses(), *pools]), axis=0)
    search.keep(problem.cube(start), problem.values(start))
    _together(search, rng, 0)
    for k, (half, count) in enumerate(BOXES):
        tell(SIEVING + (LAST_WORD - SIEVING) * k / len(BOXES))
        for centre in search.best(count, half):
            low = np.clip(centre - half, 0.0, 1.0)
            width = np.clip(centre + half, 0.0, 1.0) - low
            around = low + rng.random((BOX_MEMBERS, centre.size)) * width
            search.evolve(np.concatenate([centre[None, :], around]), BOX_GENERATIONS, rng)


def _together(search: _Search, rng: np.random.Generator, first: int) -> None:
    """Search from the best of what has been passed since the `first` call of `_Search.keep`."""
    members, generations = JOINT_FLAT if search.problem.free.size <= 2 else JOINT
    best = search.best(sized(members, search.scale), GAP, first)
    if best.size:
        search.evolve(best, generations, rng)


def _sieved(
    search: _Search,
    pools: list[FloatArray],
    seed: list[int],
    most: float,
    tell: Callable[[float], None],
    ceiling: float,
) -> Sieved | None:
    """The plane, or the space, sieved under the best that one quick population makes of the pools.

    None where that keeps not all constraints.
    """
    problem, rng = search.problem, np.random.default_rng([*seed, ROUNDS_FLAT + 1])
    start = search.quick(np.concatenate([problem.guesses(), *pools]), rng)
    worst = problem.spread(start, np.full(start.shape[0], np.inf))
    best = start[int(np.argmin(worst))]
    if not float(worst.min()) < WORN:
        return None
    stop = stopper(problem, 2**62, search.check)
    improved, told = partial(search.quick, rng=rng), lambda share: tell(SIEVING * share)
    return sieve(problem, best, min(float(worst.min()), ceiling), improved, most, stop, told)
