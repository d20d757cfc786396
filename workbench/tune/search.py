"""The search behind `wb.tune`: scans, branch programs, complementarity starts, then the worst case within the digits.

Everything goes into a `Found` as it comes, so that a stop at any moment has something to return.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from workbench.model.record import FloatArray
from workbench.model.results import Restart
from workbench.tune.complementarity import seeds as complementary_seeds
from workbench.tune.limits import WORN
from workbench.tune.problem import Problem
from workbench.tune.refine import Refined, Refiner, usable
from workbench.tune.scan import Population, evolve, spread

__all__ = ["Found", "Progress", "search", "stopper"]

# Sizes of the searches up to 1,000 samples; longer runs get fewer.
SCAN_MEMBERS, SCAN_GENERATIONS = 200, 200
NOMINAL_MEMBERS, NOMINAL_GENERATIONS = 400, 400
ISLAND_FRESH, ISLAND_GENERATIONS = 20, 60
# Members and generations in three dimensions, and in one or two, where there is time for more.
JOINT, JOINT_FLAT = (80, 200), (200, 400)
DENSE_MEMBERS, DENSE_GENERATIONS, DENSE_GAP = 60, 100, 2e-4
ROUNDS, ROUNDS_FLAT, VALLEYS = 2, 4, 24
# Branch programs over all restarts, at few samples; a program's time grows with N. The least J lies at the end of a
# walk across many decisions, the least worst case within the digits seldom does.
SOLVES, NOMINAL_SOLVES = 24, 64
# Samples that each search may simulate at most: some seconds.
SCAN_SAMPLES, JOINT_SAMPLES = 100_000_000, 150_000_000
# What a scan hands on, and how far apart it is at least in the unit cube: to refinement, and to the worst case, whose
# valleys often lie away from the best tunings.
KEPT, GAP = 40, 3e-3
WIDE, WIDE_GAP = 150, 1e-2
Progress = Callable[[str, float], None]


@dataclass
class Found:
    """What the search has so far: all tunings worth keeping, and the counts."""

    tunings: list[FloatArray] = field(default_factory=list)
    costs: list[FloatArray] = field(default_factory=list)
    restarts: list[Restart] = field(default_factory=list)
    accepted: int = 0
    solves: int = 0
    joint: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def add(self, tunings: FloatArray, costs: FloatArray) -> None:
        """Keep tunings, shape (M, 3), and their values, shape (M,)."""
        self.tunings.append(tunings)
        self.costs.append(costs)

    def best(self, count: int) -> FloatArray:
        """Return the tunings of least value, the best first, at most `count`."""
        tunings, costs = np.concatenate(self.tunings), np.concatenate(self.costs)
        return tunings[np.argsort(costs, kind="stable")[:count]]

    def least(self) -> float:
        """Return the least value, inf where there is none yet."""
        return float(min((costs.min(initial=math.inf) for costs in self.costs), default=math.inf))


def stopper(problem: Problem, most: int, check: Callable[[], None]) -> Callable[[], bool]:
    """Return the question whether more than `most` samples have been simulated; it also looks at the time."""

    def stop() -> bool:
        check()
        return problem.work.simulated > most

    return stop


def search(
    problem: Problem,
    found: Found,
    seed: int,
    restarts: int,
    guard: float,
    complementarity: int,
    check: Callable[[], None],
    tell: Progress,
) -> None:
    """Scan, refine, and search the worst case; everything goes into `found` as it comes."""
    guesses = problem.guesses()
    found.add(guesses, problem.values(guesses))
    if problem.free.size == 0:
        return
    check()
    scale = min(math.sqrt(1000.0 / problem.samples), 1.0)
    refiner: Refiner | None = None
    solves = NOMINAL_SOLVES if problem.nominal else SOLVES
    budget = max(1, round(solves / (1.0 + problem.samples / 1000.0) / restarts))
    seeds = [np.random.default_rng([seed, k]) for k in range(restarts)]
    pools: list[FloatArray] = []
    for k, rng in enumerate(seeds):
        tell(f"global scan {k + 1} of {restarts}", 0.5 * k / restarts)
        before = problem.work.evaluations
        tunings, costs, pool = _scan(problem, rng, scale, check)
        found.add(tunings, costs)
        scanned = float(costs.min(initial=math.inf))
        refined = Refined(np.zeros((0, 3)), np.zeros(0), 0, 0, 0)
        evaluations = problem.work.evaluations - before
        if usable(problem) and math.isfinite(scanned):
            check()
            tell(f"refinement {k + 1} of {restarts}", 0.5 * (k + 0.5) / restarts)
            refiner = refiner or Refiner(problem, guard, max(scanned, 1e-12))
            refined = refiner.refine(tunings, costs, budget)
            found.add(refined.tunings, refined.costs)
            found.accepted += refined.accepted
        pools.append(np.concatenate([pool, refined.tunings]))
        best = min(scanned, float(refined.costs.min(initial=math.inf)))
        scanned, best = (v if v < WORN else math.inf for v in (scanned, best))
        found.restarts.append(Restart(k, scanned, best, evaluations, refined.solves, refined.iterations))
    if complementarity:
        tell("complementarity program", 0.5)
        check()
        starts = problem.tunings(
            np.random.default_rng([seed, restarts + 2]).random((complementarity, problem.free.size))
        )
        refiner = refiner or Refiner(problem, guard, max(found.least(), 1e-12))
        given = complementary_seeds(problem, starts, max(found.least(), 1e-12))
        refined = refiner.refine(np.zeros((0, 3)), np.zeros(0), max(budget, complementarity), given)
        found.add(refined.tunings, refined.costs)
        found.accepted += refined.accepted
        found.solves += refined.solves
        pools.append(refined.tunings)
    tell("the digits to type in" if problem.nominal else "worst case within the digits", 0.55)
    found.joint = _joint(problem, pools, [seed, restarts], scale, check)
    if problem.low[2] == 0.0 and 2 in problem.free and problem.free.size > 1:
        # In three dimensions a search seldom ends with no derivative at all, where often the best tuning lies.
        tell("without derivative", 0.8)
        _search_face(problem, found, pools, [seed, restarts + 1], scale, check)


def _search_face(
    problem: Problem,
    found: Found,
    pools: list[FloatArray],
    seed: list[int],
    scale: float,
    check: Callable[[], None],
) -> None:
    """Scan and search the worst case where Td = 0, the face of the bounds, as if that had been asked for."""
    face = problem.without_derivative()
    tunings, costs, pool = _scan(face, np.random.default_rng([*seed, 0]), scale, check)
    found.add(tunings, costs)
    flat = [some * np.array([1.0, 1.0, 0.0]) for some in pools]
    found.joint = np.concatenate([found.joint, _joint(face, [pool, *flat], [*seed, 1], scale, check)])


def _scan(
    problem: Problem, rng: np.random.Generator, scale: float, check: Callable[[], None]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One global search for the least J: its best tunings, with their J, and more tunings, further apart."""
    points: list[FloatArray] = []
    values: list[FloatArray] = []

    def keep(some: FloatArray, costs: FloatArray) -> None:
        points.append(some)
        values.append(costs)

    members = _sized(NOMINAL_MEMBERS if problem.nominal else SCAN_MEMBERS, scale)
    start = rng.random((members, problem.free.size))
    if problem.low[2] == 0.0 and 2 in problem.free:
        # PI controllers are always among them.
        start[: members // 8, -1] = 0.0
    evolve(
        lambda x, ceilings: problem.below(problem.tunings(x), ceilings),
        np.concatenate([problem.cube(problem.guesses()), start]),
        _sized(NOMINAL_GENERATIONS if problem.nominal else SCAN_GENERATIONS, scale),
        rng,
        stop=stopper(problem, problem.work.simulated + SCAN_SAMPLES, check),
        keep=keep,
    )
    all_points, all_values = np.concatenate(points), np.concatenate(values)
    tunings = problem.tunings(all_points[spread(all_points, all_values, KEPT, GAP)])
    pool = problem.tunings(all_points[spread(all_points, all_values, _sized(WIDE, scale), WIDE_GAP)])
    return tunings, problem.values(tunings), pool


def _joint(
    problem: Problem, pools: list[FloatArray], seed: list[int], scale: float, check: Callable[[], None]
) -> FloatArray:
    """Search for the least worst case, from the pools of all restarts, at the digits to type in.

    The landscape of worst cases has many valleys: each pool is searched by itself, then the best of all together, and
    all of that some times, each from other members of the pools. So far with few points of each neighbourhood; from the
    best at last with many. Returns the last population's tunings, then the best of the valleys.
    """
    points: list[FloatArray] = []
    values: list[FloatArray] = []

    def keep(some: FloatArray, costs: FloatArray) -> None:
        points.append(some)
        values.append(costs)

    def towards(start: FloatArray, generations: int, rng: np.random.Generator, *, dense: bool = False) -> Population:
        return evolve(
            lambda x, ceilings: problem.worst_below(problem.rounded(problem.tunings(x)), ceilings, dense=dense),
            start,
            _sized(generations, scale),
            rng,
            stop=stopper(problem, problem.work.simulated + JOINT_SAMPLES, check),
            keep=keep if not dense else None,
        )

    flat = problem.free.size <= 2
    members, generations = JOINT_FLAT if flat else JOINT
    rounds = ROUNDS_FLAT if flat else ROUNDS
    for k in range(rounds):
        rng = np.random.default_rng([*seed, k])
        first = len(points)
        for pool in [problem.guesses(), *pools]:
            fresh = rng.random((ISLAND_FRESH, problem.free.size))
            towards(np.concatenate([problem.cube(pool[k::rounds]), fresh]), ISLAND_GENERATIONS, rng)
        own, costs = np.concatenate(points[first:]), np.concatenate(values[first:])
        best = spread(own, costs, _sized(members, scale), GAP)
        if best.size:
            towards(own[best], generations, rng)
    best = spread(np.concatenate(points), np.concatenate(values), _sized(DENSE_MEMBERS, scale), DENSE_GAP)
    if not best.size:
        return problem.rounded(np.concatenate(pools))
    population = towards(np.concatenate(points)[best], DENSE_GENERATIONS, rng, dense=True)
    valleys = spread(np.concatenate(points), np.concatenate(values), VALLEYS, GAP)
    return problem.tunings(np.concatenate([population.points, np.concatenate(points)[valleys]]))


def _sized(count: int, scale: float) -> int:
    return max(40, round(count * scale))
