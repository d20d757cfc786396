"""`wb.tune` against general optimisers on the problems of `tuning_problems.json`, all on the same exact simulation.

Run by hand: `python benchmarks/tuning.py [--seeds 3] [--problems A200 R03] [--methods tune de1] [--criteria nominal]`.
Every run is written to the results file at once: stop it when you like, run it again and it goes on. After a change of
the code measure into a new file (`--results`). `--table` prints the tables of what is there and measures nothing.

Criteria: the least J of a tuning (nominal), and the least worst J within 0.1 % of its parameters (worst); the problem
file defines both. Each method minimises the criterion that it is judged by, and what counts is the value of its final
tuning, simulated here. All but wb.tune and mpcc search the unit cube of wb.tune's coordinates (root of Kc and Td,
logarithm of Ti) within the problem's bounds:

- tune: `wb.tune`, with `nominal=True` for the nominal criterion; its tunings have 12 and 4 digits;
- de1: scipy's differential_evolution as it comes, one kernel call for each evaluation;
- de16: the best of 16 seeds of it, vectorised, one kernel call for each generation;
- nelder-mead: the best of 20 starts (internal-model tunings, then random ones);
- l-bfgs-b: once, from the loop's own tuning;
- mpcc: the loop in complementarity form solved by IPOPT (Fischer-Burmeister homotopy) from the loop's own tuning, its
  (Kc, Ti, Td) as they are. Stenman valves without output limits up to 500 samples; nominal only.

Times are of this process; the first call of each compiled function is made before. l-bfgs-b and mpcc know no seed, and
de16 has its own: they run once.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tuning_problems
from scipy.optimize import differential_evolution, minimize
from tuning_problems import Stated

import workbench as wb
from workbench.errors import InvalidValue
from workbench.model.record import FloatArray
from workbench.tune.complementarity import MOST_SAMPLES, seeds
from workbench.tune.problem import Problem

RESULTS = Path(__file__).with_name("tuning_results.jsonl")
STARTS, SEEDS = 20, 16
# What a run that overflows costs for scipy, whose convergence tests square it.
HUGE = 1e100
Costs = Callable[[FloatArray], FloatArray]


def costs(problem: Problem, criterion: str) -> Costs:
    """The criterion of points of the unit cube, shape (M, D) -> (M,)."""

    def worst(points: FloatArray) -> FloatArray:
        return problem.worst_below(problem.tunings(points), np.full(points.shape[0], np.inf), dense=True)

    def nominal(points: FloatArray) -> FloatArray:
        return problem.exact(problem.tunings(points))

    of = nominal if criterion == "nominal" else worst
    return lambda points: np.minimum(of(np.clip(points, 0.0, 1.0)), HUGE)


def own(stated: Stated) -> FloatArray:
    """The tuning that the loop comes with, shape (1, 3)."""
    pid = stated.loop.controller
    return np.array([[pid.Kc, pid.Ti, pid.Td]])


def tune(stated: Stated, criterion: str, seed: int) -> FloatArray:
    tuned = wb.tune(
        stated.loop, stated.experiment, stated.objective, stated.bounds, seed, nominal=criterion == "nominal"
    )
    return np.array([tuned.controller.Kc, tuned.controller.Ti, tuned.controller.Td])


def de1(stated: Stated, criterion: str, seed: int) -> FloatArray:
    problem = stated.problem()
    cost = costs(problem, criterion)
    box = [(0.0, 1.0)] * problem.free.size
    end = differential_evolution(lambda x: float(cost(x[None, :])[0]), box, rng=np.random.default_rng(seed))
    return problem.tunings(end.x[None, :])[0]


def de16(stated: Stated, criterion: str, seed: int) -> FloatArray:
    problem = stated.problem()
    cost = costs(problem, criterion)
    box = [(0.0, 1.0)] * problem.free.size

    def vector(x: FloatArray) -> Any:
        # The polish at the end asks for one point at a time.
        return float(cost(x[None, :])[0]) if x.ndim == 1 else cost(np.ascontiguousarray(x.T))

    ends = [
        differential_evolution(
            vector, box, rng=np.random.default_rng(SEEDS * seed + k), updating="deferred", vectorized=True
        )
        for k in range(SEEDS)
    ]
    return problem.tunings(min(ends, key=lambda end: float(end.fun)).x[None, :])[0]


def nelder_mead(stated: Stated, criterion: str, seed: int) -> FloatArray:
    problem = stated.problem()
    cost = costs(problem, criterion)
    guesses = problem.cube(problem.guesses())
    fresh = np.random.default_rng(seed).random((max(STARTS - guesses.shape[0], STARTS // 2), problem.free.size))
    starts = np.concatenate([guesses[: STARTS - fresh.shape[0]], fresh])
    box = [(0.0, 1.0)] * problem.free.size
    ends = [minimize(lambda x: float(cost(x[None, :])[0]), s, method="Nelder-Mead", bounds=box) for s in starts]
    return problem.tunings(min(ends, key=lambda end: float(end.fun)).x[None, :])[0]


def l_bfgs_b(stated: Stated, criterion: str, seed: int) -> FloatArray:  # noqa: ARG001
    problem = stated.problem()
    cost = costs(problem, criterion)
    start = problem.cube(own(stated))[0]
    box = [(0.0, 1.0)] * problem.free.size
    end = minimize(lambda x: float(cost(x[None, :])[0]), start, method="L-BFGS-B", bounds=box)
    return problem.tunings(end.x[None, :])[0]


def mpcc(stated: Stated, criterion: str, seed: int) -> FloatArray | None:  # noqa: ARG001
    problem = stated.problem()
    start = own(stated)
    fits = isinstance(stated.loop.valve, wb.Stenman) and stated.loop.controller.output_limits is None
    if criterion != "nominal" or not fits or problem.samples > MOST_SAMPLES:
        return None
    found = seeds(problem, start, max(float(problem.exact(start)[0]), 1e-12))
    # A solve without a finite end leaves the loop as it was.
    return found[0].tuning if found else start[0]


METHODS: dict[str, tuple[Callable[[Stated, str, int], FloatArray | None], bool]] = {
    "tune": (tune, True),
    "de1": (de1, True),
    "de16": (de16, False),
    "nelder-mead": (nelder_mead, True),
    "l-bfgs-b": (l_bfgs_b, False),
    "mpcc": (mpcc, False),
}
CRITERIA = ("nominal", "worst")


def judged(stated: Stated, criterion: str, tuning: FloatArray) -> float:
    """The criterion's value of a tuning; inf outside the bounds."""
    problem = stated.problem()
    slack = 1e-9 * np.maximum(np.abs(problem.low), np.abs(problem.high))
    if (tuning < problem.low - slack).any() or (tuning > problem.high + slack).any():
        return float("inf")
    return stated.value(criterion, tuning)


def measured(file: Path, problems: list[Stated]) -> list[dict[str, Any]]:
    """The results in a file that belong to these problems as they stand."""
    if not file.exists():
        return []
    marks = {p.name: p.mark for p in problems}
    rows = []
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            # The last line of a run that was killed.
            continue
    return [row for row in rows if marks.get(row["problem"]) == row["mark"]]


def measure(problems: list[Stated], methods: list[str], criteria: list[str], count: int, file: Path) -> None:
    """Run what the file does not have yet, and append it."""
    done = {(r["problem"], r["criterion"], r["method"], r["seed"]) for r in measured(file, problems)}
    plan = [
        (stated, criterion, method, seed)
        for seed in range(count)
        for criterion in criteria
        for method in methods
        for stated in problems
        if (seed == 0 or METHODS[method][1]) and (stated.name, criterion, method, seed) not in done
    ]
    if not plan:
        return
    whole = not file.exists() or file.read_bytes()[-1:] in (b"", b"\n")
    warm = tuning_problems.selected(["E200"])[0]
    for criterion in CRITERIA:
        judged(warm, criterion, own(warm)[0])
    if "tune" in methods:
        wb.tune(warm.loop, warm.experiment, warm.objective, warm.bounds)
    for number, (stated, criterion, method, seed) in enumerate(plan, 1):
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            tuning = METHODS[method][0](stated, criterion, seed)
        except InvalidValue as refused:
            raise SystemExit(f"{stated.name}, {method}: {refused}") from refused
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        if tuning is None:
            continue
        row = {
            "problem": stated.name,
            "criterion": criterion,
            "method": method,
            "seed": seed,
            "value": judged(stated, criterion, tuning),
            "tuning": tuning.tolist(),
            "wall": round(wall, 3),
            "cpu": round(cpu, 3),
            "mark": stated.mark,
        }
        with file.open("a", encoding="utf-8") as out:
            # A line of its own, also after one that was cut off.
            out.write(("" if whole else "\n") + json.dumps(row) + "\n")
        whole = True
        ratio = row["value"] / stated.best.get(criterion, {}).get("J", float("nan"))
        print(
            f"[{number}/{len(plan)}] {stated.name:10s} {criterion:8s} {method:12s} seed {seed}  "
            f"{row['value']:12.6g}  {ratio:9.6g} of best known  {wall:6.2f} s",
            flush=True,
        )


def tables(problems: list[Stated], rows: list[dict[str, Any]]) -> None:
    """Print how the methods compare, then how each problem went."""
    best = {(p.name, criterion): p.best[criterion]["J"] for p in problems for criterion in CRITERIA}
    for row in rows:
        row["ratio"] = row["value"] / best[row["problem"], row["criterion"]]
    print(f"\n{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}\n")
    print("| criterion | method | problems | runs | within 0.1 % | within 1 % | median | worst | wall s | CPU s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for criterion in CRITERIA:
        for method in METHODS:
            some = [r for r in rows if r["criterion"] == criterion and r["method"] == method]
            if not some:
                continue
            ratios = [r["ratio"] for r in some]
            near, close = (sum(x <= 1.0 + limit for x in ratios) / len(some) for limit in (0.001, 0.01))
            wall, cpu = (statistics.median(r[key] for r in some) for key in ("wall", "cpu"))
            cells = [criterion, method, str(len({r["problem"] for r in some})), str(len(some))]
            cells += [f"{near:.0%}", f"{close:.0%}", f"{statistics.median(ratios):.5g}", f"{max(ratios):.4g}"]
            print(f"| {' | '.join(cells)} | {wall:.2f} | {cpu:.2f} |")
    print("\nRatios to the best known value; times are medians over runs.")
    names = [(c, m) for c in CRITERIA for m in METHODS if any((r["criterion"], r["method"]) == (c, m) for r in rows)]
    print("\nEach problem: best known J and worst case; share of the heavy searches that end within 0.1 % of each;")
    print("each method's median ratio (and worst).\n")
    head = ["problem", "J", "heavy", "worst case", "heavy", *(f"{m}, {c}" for c, m in names)]
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for p in problems:
        cells = [p.name]
        for criterion in CRITERIA:
            entry = p.best[criterion]
            ends = [x for some in entry["ends"].values() for x in some]
            cells += [f"{entry['J']:.6g}", f"{sum(x <= 1.001 * entry['J'] for x in ends)}/{len(ends)}"]
        for criterion, method in names:
            own_rows = [r for r in rows if (r["problem"], r["criterion"], r["method"]) == (p.name, criterion, method)]
            ratios = [r["ratio"] for r in own_rows]
            more = f" ({max(ratios):.5g})" if len(ratios) > 1 else ""
            cells.append(f"{statistics.median(ratios):.5g}{more}" if ratios else "")
        print(f"| {' | '.join(cells)} |")
    # A method cannot be far from a best value of its own.
    finders = Counter(p.best[c]["found_by"].partition(",")[0] for p in problems for c in CRITERIA)
    print("\nBest values found by:", ", ".join(f"{name} {count}" for name, count in finders.most_common()))
    better = sorted({(r["problem"], r["criterion"]) for r in rows if r["ratio"] < 1.0 - 1e-6})
    if better:
        print("\nBelow the best known value:", ", ".join(" ".join(pair) for pair in better))


def main() -> None:
    """Measure what is missing, then print the tables."""
    parser = argparse.ArgumentParser(description="wb.tune against general optimisers on tuning_problems.json.")
    parser.add_argument("--problems", nargs="*", help="names; all by default")
    parser.add_argument("--methods", nargs="*", choices=tuple(METHODS), default=list(METHODS))
    parser.add_argument("--criteria", nargs="*", choices=CRITERIA, default=list(CRITERIA))
    parser.add_argument("--seeds", type=int, default=3, help="seeds of each method that has one")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--table", action="store_true", help="only print the tables of what is there")
    given = parser.parse_args()
    problems = tuning_problems.selected(given.problems)
    if not given.table:
        try:
            measure(problems, given.methods, given.criteria, given.seeds, given.results)
        except KeyboardInterrupt:
            print("\nstopped: what is there so far")
    known = [p for p in problems if all("J" in p.best.get(criterion, {}) for criterion in CRITERIA)]
    tables(known, [r for r in measured(given.results, known) if r["method"] in given.methods])


if __name__ == "__main__":
    main()
