"""The search behind `wb.tune`: scans, branch programs, complementarity starts, the worst case, the digits to type in.

Everything goes into a `Found` as it comes, so that a stop at any moment has something to return.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from workbench.model.record import FloatArray
from workbench.model.results import Restart, SolveStatus, agreeing
from workbench.tune.budget import STOPPED, OutOfBudget, Progress, stopper
from workbench.tune.complementarity import seeds as complementary_seeds
from workbench.tune.limits import WORN
from workbench.tune.problem import Problem
from workbench.tune.refine import Refined, Refiner, usable
from workbench.tune.scan import evolve, sized, spread
from workbench.tune.verify import Choice, choose
from workbench.tune.worst import least_worst

__all__ = ["Found", "quick", "searched"]

# Sizes of the searches up to 1,000 samples; longer runs get fewer.
SCAN_MEMBERS, SCAN_GENERATIONS = 200, 200
NOMINAL_MEMBERS, NOMINAL_GENERATIONS = 400, 400
# Branch programs over all restarts, up to `FEW` samples; a program's time grows with N, and longer runs get fewer. The
# least J lies at the end of a walk across many decisions, the least worst case within the digits seldom does.
SOLVES, NOMINAL_SOLVES, FEW = 24, 64, 300
# Where J itself is minimised, and no more than half of the searches have met the least, so many more are made at most,
# so many times larger and without branch programs; not where fewer than so many are asked for: for a quick answer.
MORE, LARGER, ASKED = 4, 2, 3
# Samples that a scan may simulate at most: some seconds.
SCAN_SAMPLES = 100_000_000
# What a scan hands on, and how far apart it is at least in the unit cube: to refinement, and to the worst case, whose
# valleys often lie away from the best tunings.
KEPT, GAP = 40, 3e-3
WIDE, WIDE_GAP = 150, 1e-2
# Samples that the choice of the digits may simulate at most: some seconds.
CHOICE_SAMPLES = 150_000_000


@dataclass
class Found:
    """What the search has so far: all tunings worth keeping, and the counts."""

    tunings: list[FloatArray] = field(default_factory=list)
    costs: list[FloatArray] = field(default_factory=list)
    restarts: list[Restart] = field(default_factory=list)
    accepted: int = 0
    solves: int = 0
    joint: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    bound: float = -math.inf

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


def searched(
    problem: Problem,
    found: Found,
    seed: int,
    restarts: int,
    guard: float,
    complementarity: int,
    check: Callable[[], None],
    tell: Progress,
) -> tuple[Choice, SolveStatus, str]:
    """Search, and choose the digits: the tuning, how that ended, and a note on what ended it early, "" if nothing did.

    Everything goes into `found` as it comes; `check` is asked now and then, and ends all by `OutOfBudget`.
    """
    try:
        _search(problem, found, seed, restarts, guard, complementarity, check, tell)
        tell("choosing the digits", 0.9)
        most = problem.work.simulated + CHOICE_SAMPLES
        chosen = choose(problem, _candidates(problem, found), stop=stopper(problem, most, check))
    except KeyboardInterrupt:
        return quick(problem, found), SolveStatus.INTERRUPTED, STOPPED
    except OutOfBudget as limit:
        return quick(problem, found), limit.status, f"stopped at {limit}; the best so far"
    return chosen, SolveStatus.SOLVED, ""


def _candidates(problem: Problem, found: Found) -> FloatArray:
    """The tunings among which the digits are chosen."""
    if problem.free.size == 0:
        return problem.low[None, :].copy()
    return np.concatenate([found.joint, found.best(8)])


def quick(problem: Problem, found: Found) -> Choice:
    """Return the best rounded tuning of an unfinished search, by exact simulation, without a further search."""
    tunings = np.concatenate([found.joint, found.best(40)]) if found.costs else problem.guesses()
    rounded = np.unique(problem.rounded(tunings), axis=0)
    worst = problem.worst_below(rounded, np.full(rounded.shape[0], np.inf))
    best = rounded[int(np.argmin(worst))]
    return Choice(best, float(problem.exact(best[None, :])[0]), float(worst.min()))


def _search(
    problem: Problem,
    found: Found,
    seed: int,
    restarts: int,
    guard: float,
    complementarity: int,
    check: Callable[[], None],
    tell: Progress,
) -> None:
    """Scan, refine, and search the worst case."""
    guesses = problem.guesses()
    found.add(guesses, problem.values(guesses))
    if problem.free.size == 0:
        return
    check()
    scale = min(math.sqrt(1000.0 / problem.samples), 1.0)
    refiner: Refiner | None = None
    solves = NOMINAL_SOLVES if problem.nominal else SOLVES
    budget = max(1, round(solves * min(1.0, FEW / problem.samples) / restarts))
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
    more = 0
    while problem.nominal and restarts >= ASKED and more < MORE and 0 < 2 * agreeing(found.restarts) <= restarts + more:
        tell(f"global scan {restarts + more + 1}, as few have met the least J", 0.5)
        before = problem.work.evaluations
        tunings, costs, pool = _scan(problem, np.random.default_rng([seed, restarts + 3, more]), scale, check, LARGER)
        found.add(tunings, costs)
        pools.append(pool)
        end = float(costs.min(initial=math.inf))
        end = end if end < WORN else math.inf
        found.restarts.append(Restart(restarts + more, end, end, problem.work.evaluations - before, 0, 0))
        more += 1
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
    phase = "the digits to type in" if problem.nominal else "worst case within the digits"
    tell(phase, 0.55)
    worst = least_worst(
        problem, pools, [seed, restarts], scale, restarts, check, lambda share: tell(phase, 0.55 + 0.25 * share)
    )
    found.joint, found.bound = worst.tunings, worst.bound
    if problem.low[2] == 0.0 and 2 in problem.free and problem.free.size > 1:
        # In three dimensions a search seldom ends with no derivative at all, where often the best tuning lies.
        tell("without derivative", 0.8)
        _search_face(
            problem,
            found,
            pools,
            [seed, restarts + 1],
            scale,
            restarts,
            check,
            lambda share: tell("without derivative", 0.8 + 0.1 * share),
        )


def _search_face(
    problem: Problem,
    found: Found,
    pools: list[FloatArray],
    seed: list[int],
    scale: float,
    restarts: int,
    check: Callable[[], None],
    tell: Callable[[float], None],
) -> None:
    """Scan and search the worst case where Td = 0, the face of the bounds, as if that had been asked for."""
    face = problem.without_derivative()
    tunings, costs, pool = _scan(face, np.random.default_rng([*seed, 0]), scale, check)
    found.add(tunings, costs)
    flat = [some * np.array([1.0, 1.0, 0.0]) for some in pools]
    before = problem.rounded(found.joint)
    ceiling = math.inf if problem.nominal else float(problem.spread(before, np.full(before.shape[0], np.inf)).min())
    worst = least_worst(face, [pool, *flat], [*seed, 1], scale, restarts, check, tell, ceiling)
    found.joint = np.concatenate([found.joint, worst.tunings])


def _scan(
    problem: Problem, rng: np.random.Generator, scale: float, check: Callable[[], None], larger: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One global search for the least J: its best tunings, with their J, and more tunings, further apart.

    larger: times as many members, and generations.
    """
    points: list[FloatArray] = []
    values: list[FloatArray] = []

    def keep(some: FloatArray, costs: FloatArray) -> None:
        points.append(some)
        values.append(costs)

    members = larger * sized(NOMINAL_MEMBERS if problem.nominal else SCAN_MEMBERS, scale)
    start = rng.random((members, problem.free.size))
    if problem.low[2] == 0.0 and 2 in problem.free:
        # PI controllers are always among them.
        start[: members // 8, -1] = 0.0
    evolve(
        lambda x, ceilings: problem.below(problem.tunings(x), ceilings),
        np.concatenate([problem.cube(problem.guesses()), start]),
        larger * sized(NOMINAL_GENERATIONS if problem.nominal else SCAN_GENERATIONS, scale),
        rng,
        stop=stopper(problem, problem.work.simulated + larger * SCAN_SAMPLES, check),
        keep=keep,
    )
    all_points, all_values = np.concatenate(points), np.concatenate(values)
    tunings = problem.tunings(all_points[spread(all_points, all_values, KEPT, GAP)])
    pool = problem.tunings(all_points[spread(all_points, all_values, sized(WIDE, scale), WIDE_GAP)])
    return tunings, problem.values(tunings), pool
