"""Heavy searches for the best values in `tuning_problems.json`: the least J known, nominal and worst case.

Run by hand: `python benchmarks/tuning_reference.py [--seconds 120] [--problems A200 R03] [--criteria nominal worst]`.
The time is CPU time for each problem and criterion. What the file has is kept, improved where a search ends lower, and
written after every search: stop it when you like, run it again to add further searches.

Independent searches from their own seeds, one after the other, none of them with the schedule of `wb.tune`:

- lshade: L-SHADE with a large population over the whole box;
- de: scipy's differential_evolution, vectorised on the kernel, large populations, three strategies by turns;
- branch: a scan, then branch programs from its best distinct sequences of decisions and across their active guards,
  without a margin; for the worst case with one, and pool from there;
- pool (worst case only): L-SHADE for the least J itself, then L-SHADE for the worst case from several hundred of the
  best distinct points that it passed.

Each ends with the same polish: ever smaller boxes around its best few distinct points. `ends` holds J where each
search ended; the share of them within 0.1 % of the best tells how hard a problem is. A best value counts whoever found
it: `--also tuning_results.jsonl` takes over what the methods of `tuning.py` have found below it.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tuning_problems
from scipy.optimize import differential_evolution
from tuning import measured
from tuning_problems import HOLD, MARGIN, Stated

from workbench.model.record import FloatArray
from workbench.tune.problem import Problem
from workbench.tune.refine import Refiner, usable
from workbench.tune.scan import evolve, spread

STRATEGIES = ("best1bin", "currenttobest1bin", "rand1bin")
Cost = Callable[[FloatArray, FloatArray], FloatArray]


class Keeper:
    """Collects every improvement of a search."""

    def __init__(self) -> None:
        self.points: list[FloatArray] = []
        self.values: list[FloatArray] = []

    def __call__(self, points: FloatArray, values: FloatArray) -> None:
        self.points.append(points.copy())
        self.values.append(values.copy())

    def best(self, count: int, gap: float) -> FloatArray:
        points, values = np.concatenate(self.points), np.concatenate(self.values)
        return points[spread(points, values, count, gap)]


def boxed(cost: Cost, centre: FloatArray, half: float, members: int, generations: int, rng: np.random.Generator):
    """L-SHADE in a box around a point of the unit cube; the box keeps within the cube. The end's points and values."""
    low = np.clip(centre - half, 0.0, 1.0)
    width = np.clip(centre + half, 0.0, 1.0) - low
    start = rng.random((members, centre.size))
    start[0] = (centre - low) / width
    # The bounds themselves are worth a try, above all Td = 0.
    start[1 : 1 + members // 6, -1] = 0.0
    end = evolve(lambda x, ceilings: cost(low + x * width, ceilings), start, generations, rng)
    return low + end.points * width, end.values


def polished(
    cost: Cost, points: FloatArray, rng: np.random.Generator, boxes: tuple[tuple[float, int], ...]
) -> FloatArray:
    """The best point that ever smaller boxes lead to: half-widths in the cube, and how many points go on from each."""
    for half, count in boxes:
        ends = [boxed(cost, centre, half, 60, 100, rng) for centre in points]
        found = np.concatenate([np.concatenate([e[0][:5] for e in ends]), points])
        values = cost(found, np.full(found.shape[0], np.inf))
        points = found[spread(found, values, count, half / 10.0)]
    return points[0]


def start_points(problem: Problem, members: int, rng: np.random.Generator) -> FloatArray:
    """Random points of the cube, some of them without derivative."""
    start = rng.random((members, problem.free.size))
    if problem.low[2] == 0.0 and 2 in problem.free:
        start[: members // 6, -1] = 0.0
    return start


def lshade(problem: Problem, cost: Cost, seed: int, keeper: Keeper, members: int, generations: int) -> None:
    rng = np.random.default_rng([101, seed])
    evolve(cost, start_points(problem, members, rng), generations, rng, keep=keeper)


def de(problem: Problem, cost: Cost, seed: int, keeper: Keeper, members: int, generations: int) -> None:
    rng = np.random.default_rng([102, seed])

    def vector(x: FloatArray) -> FloatArray:
        points = np.clip(np.ascontiguousarray(x.T), 0.0, 1.0)
        values = cost(points, np.full(points.shape[0], np.inf))
        keeper(points[np.isfinite(values)], values[np.isfinite(values)])
        # scipy squares what it is given.
        return np.minimum(values, 1e100)

    differential_evolution(
        vector,
        [(0.0, 1.0)] * problem.free.size,
        strategy=STRATEGIES[seed % 3],
        init=start_points(problem, members, rng),
        maxiter=generations,
        tol=1e-7,
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=rng,
    )


def own_cost(problem: Problem) -> Cost:
    """J itself of points of the cube, below ceilings."""
    return lambda points, ceilings: problem.below(problem.tunings(points), ceilings)


def branch(problem: Problem, seed: int, keeper: Keeper, members: int, generations: int, guard: float = 0.0) -> None:
    scan = Keeper()
    rng = np.random.default_rng([103, seed])
    evolve(own_cost(problem), start_points(problem, members, rng), generations, rng, keep=scan)
    points = scan.best(40, 3e-3)
    tunings = problem.tunings(points)
    costs = problem.exact(tunings)
    keeper(points[:8], costs[:8])
    refiner = Refiner(problem, guard, max(float(costs.min()), 1e-12))
    refined = refiner.refine(tunings, costs, max(8, round(12_000 / problem.samples)))
    keeper(problem.cube(refined.tunings), refined.costs)


def pool(
    problem: Problem, cost: Cost, seed: int, keeper: Keeper, members: int, generations: int, branched: bool
) -> None:
    passed = Keeper()
    rng = np.random.default_rng([106, seed])
    evolve(own_cost(problem), start_points(problem, members, rng), generations, rng, keep=passed)
    start = [passed.best(members, 3e-3), passed.best(members // 4, 3e-4)]
    if branched:
        refined = Keeper()
        branch(problem, seed, refined, members, generations, 0.01)
        near = np.concatenate(refined.points)
        # Close ones too: where J is least its neighbourhood is worst, and a little aside it may be all right.
        start += [near, *(np.clip(near + rng.normal(0.0, size, near.shape), 0.0, 1.0) for size in (1e-3, 1e-3, 1e-2))]
    evolve(cost, np.concatenate(start), generations, rng, keep=keeper)


def nominal(stated: Stated, method: str, seed: int) -> FloatArray:
    """One search for the least J: the tuning where it ends."""
    problem = stated.problem()
    keeper = Keeper()
    cost = own_cost(problem)
    members = 200 * problem.free.size
    if method == "lshade":
        lshade(problem, cost, seed, keeper, members, 400)
    elif method == "de":
        de(problem, cost, seed, keeper, members // 2, 400)
    else:
        branch(problem, seed, keeper, members // 2, 200)
    rng = np.random.default_rng([104, seed])
    point = polished(cost, keeper.best(12, 3e-3), rng, ((1e-2, 8), (1e-3, 4), (1e-5, 2), (1e-7, 1)))
    return settled(stated, "nominal", point, rng)


def worst(stated: Stated, method: str, seed: int) -> FloatArray:
    """One search for the least worst case: the tuning where it ends."""
    problem = stated.problem()
    keeper = Keeper()

    def sparse(points: FloatArray, ceilings: FloatArray) -> FloatArray:
        return problem.worst_below(problem.tunings(points), ceilings)

    def dense(points: FloatArray, ceilings: FloatArray) -> FloatArray:
        return problem.worst_below(problem.tunings(points), ceilings, dense=True)

    if method == "lshade":
        lshade(problem, sparse, seed, keeper, 100 * problem.free.size, 250)
    elif method in ("pool", "branch"):
        pool(problem, sparse, seed, keeper, 100 * problem.free.size, 250, method == "branch")
    else:
        de(problem, sparse, seed, keeper, 30 * problem.free.size, 150)
    rng = np.random.default_rng([105, seed])
    points = np.stack([polished(sparse, p[None, :], rng, ((1e-2, 1),)) for p in keeper.best(6, 2e-3)])
    values = dense(points, np.full(points.shape[0], np.inf))
    point = polished(dense, points[spread(points, values, 2, 1e-4)], rng, ((1e-3, 1), (1e-5, 1)))
    return settled(stated, "worst", point, rng)


def settled(stated: Stated, criterion: str, point: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A tuning near a point of the cube that lies just off the cliffs that optima lie on."""
    problem = stated.problem()
    tuning = problem.tunings(point[None, :])[0]
    for slack in (1e-7, 1e-6, 1e-5, 1e-4):
        # Judged in a neighbourhood a little larger than the criterion's own as well.
        wider = stated.problem(HOLD if criterion == "nominal" else MARGIN * (1.0 + slack))

        def cost(points: FloatArray, ceilings: FloatArray, wider: Problem = wider) -> FloatArray:
            tunings = problem.tunings(points)
            values = wider.worst_below(tunings, ceilings, dense=True)
            if criterion == "worst":
                values = np.maximum(values, problem.worst_below(tunings, ceilings, dense=True))
            return values

        end = polished(cost, point[None, :], rng, ((100.0 * MARGIN * slack, 2), (1e-9, 1)))
        tuning = problem.tunings(end[None, :])[0]
        if stated.holds(criterion, tuning):
            break
    return tuning


SEARCHES = {"nominal": (nominal, ("lshade", "de", "branch")), "worst": (worst, ("branch", "pool", "lshade", "de"))}


def improved(stated: Stated, criterion: str, best: dict, seconds: float, save: Callable[[dict], None]) -> None:
    """Search for `seconds` of CPU time; `save` gets the entry after each search."""
    search, methods = SEARCHES[criterion]
    if not usable(stated.problem()):
        methods = tuple(m for m in methods if m != "branch")
    ends: dict[str, list[float]] = {m: list(best.get("ends", {}).get(m, [])) for m in methods}
    began = time.process_time()
    while time.process_time() - began < seconds:
        # The method that has had the fewest searches is next.
        method = min(methods, key=lambda m: len(ends[m]))
        seed = len(ends[method])
        before = time.process_time()
        tuning = search(stated, method, seed)
        value = stated.value(criterion, tuning)
        ends[method].append(float(f"{stated.held(criterion, tuning):.9g}"))
        news = ""
        if value < (1.0 - 1e-10) * best.get("J", math.inf) and stated.holds(criterion, tuning):
            best = best | {"J": value, "tuning": tuning.tolist(), "found_by": f"{method}, seed {seed}"}
            news = " best"
        used = time.process_time() - before
        best = best | {"ends": ends, "cpu_s": round(best.get("cpu_s", 0.0) + used, 1)}
        save(best)
        print(f"{stated.name:10s} {criterion:8s} {method:7s} {seed:3d} {value:14.8g} {used:6.1f} s{news}", flush=True)


def taken_over(stated: Stated, criterion: str, best: dict, rows: list[dict], save: Callable[[dict], None]) -> None:
    """Take over results of `tuning.py` that are below the best value, a little off their cliffs."""
    for row in rows:
        if (row["problem"], row["criterion"]) != (stated.name, criterion):
            continue
        if row["value"] < (1.0 - 1e-9) * best.get("J", math.inf):
            point = stated.problem().cube(np.array([row["tuning"]]))[0]
            tuning = settled(stated, criterion, point, np.random.default_rng(107))
            value = stated.value(criterion, tuning)
            if value < best.get("J", math.inf) and stated.holds(criterion, tuning):
                best = best | {
                    "J": value,
                    "tuning": tuning.tolist(),
                    "found_by": f"{row['method']}, not among the ends",
                }
                save(best)
                print(f"{stated.name:10s} {criterion:8s} {value:14.8g} found by {row['method']}", flush=True)


def main() -> None:
    """Search, problem after problem."""
    parser = argparse.ArgumentParser(description="Heavy searches for the best values in tuning_problems.json.")
    parser.add_argument("--seconds", type=float, default=120.0, help="CPU time for each problem and criterion")
    parser.add_argument("--problems", nargs="*", help="names; all by default")
    parser.add_argument("--criteria", nargs="*", choices=tuple(SEARCHES), default=list(SEARCHES))
    parser.add_argument("--also", type=Path, help="results of tuning.py, whose better tunings are taken over first")
    given = parser.parse_args()
    problems = tuning_problems.selected(given.problems)
    rows = measured(given.also, problems) if given.also else []
    for stated in problems:
        for criterion in given.criteria:

            def save(best: dict, name: str = stated.name, criterion: str = criterion) -> None:
                whole = tuning_problems.read()
                entry = next(e for e in whole["problems"] if e["name"] == name)
                entry["best"] = entry.get("best", {}) | {criterion: best}
                tuning_problems.write(whole)

            taken_over(stated, criterion, stated.best.get(criterion, {}), rows, save)
            now = tuning_problems.selected([stated.name])[0]
            improved(stated, criterion, now.best.get(criterion, {}), given.seconds, save)


if __name__ == "__main__":
    main()
