"""Refinement of scanned tunings by branch programs: the best sequences first, then the neighbours across active guards.

A program is accepted only if the exact simulation of its tuning takes the same decisions and gives the same J.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray
from workbench.model.results import SolveStatus
from workbench.simulate import kernel
from workbench.simulate.batch import weigh
from workbench.simulate.coefficients import coefficients, rest
from workbench.simulate.sums import SUMS, add_sums
from workbench.symbolic.branch import BranchProgram, BranchSolution, Decisions
from workbench.symbolic.full_space import FullSpace
from workbench.symbolic.loop import COEFFICIENTS, unwritten
from workbench.symbolic.solve import held_interrupt
from workbench.tune.problem import Problem

__all__ = ["AGREEMENT", "Path", "Refined", "Refiner", "Seed", "full_space", "path", "usable"]

# Claim and exact re-simulation of an accepted program agree to this, relative to J.
AGREEMENT = 1e-9
# Beyond this many samples building and solving a program takes longer than the scan that it would refine.
MOST_SAMPLES = 10_000
# How many active guards of a solution are tried from their other side.
FLIPS = 3
# After so many programs in a row that came to nothing, over all restarts, refinement is given up.
FAILURES = 5
# After so many in a row that did not lower the least J known a restart's refinement ends: what programs gain they gain
# at once. The second number holds after a restart whose programs gained nothing.
IDLE, IDLE_LATER = 4, 2
# A program that lowers J by less, relative to it, has not.
GAIN = 1e-7
# A neighbour whose run, as it goes on from the flip, costs more than this many times the best is not worth a solve.
WORTH = 1.5


# J of the start, order of arrival, sequence, start, whether the start's own run takes that sequence, and variables.
_Waiting = tuple[float, int, bytes, FloatArray, bool, FloatArray | None]


@dataclass(frozen=True, eq=False)
class Path:
    """A run as the decisions see it: branch codes, output and stem (%), each of shape (N,), and its J."""

    branch: NDArray[np.int8]
    u: FloatArray
    x: FloatArray
    cost: float


@dataclass(frozen=True, eq=False)
class Seed:
    """A sequence of decisions worth a branch program, the J that it promises, and where to start.

    tuning: shape (3,); point: the program's variables, needed where the tuning's exact run takes another sequence.
    """

    decisions: Decisions
    promise: float
    tuning: FloatArray
    point: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Refined:
    """The end of a refinement: tunings (M, 3) with their exact J (M,), verified ones first; counts of work."""

    tunings: FloatArray
    costs: FloatArray
    accepted: int
    solves: int
    iterations: int


def usable(problem: Problem) -> bool:
    """Whether branch programs of this problem are worth their time."""
    short = problem.samples <= MOST_SAMPLES and problem.free.size > 0
    return short and problem.one_loop and eq_2_alone(problem) and not unwritten(problem.loop)


def eq_2_alone(problem: Problem) -> bool:
    """Whether J of eq. (2) is all that is asked, which is what a branch program can state."""
    return not problem.objective.kpis and problem.constraints is None


def path(problem: Problem, tuning: FloatArray, flip: int | None = None) -> Path:
    """Run a tuning; at sample `flip`, take the other stem decision than the valve would, and go on exactly."""
    row = coefficients(problem.loop, problem.experiment.stem_offset, tuning[None, :])[0]
    n, s = problem.samples, problem.signals
    state, past = rest(row)
    y = np.empty(n + 1)
    u, x, v, branch = np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int8)

    def run(begin: int, end: int, law: FloatArray) -> None:
        part = slice(begin, end)
        kernel.run_loop(
            law,
            s.r[part],
            s.load[part],
            s.noise[part],
            state,
            past,
            y[begin : end + 1],
            u[part],
            x[part],
            v[part],
            branch[part],
        )

    def ended() -> Path:
        sums, last = np.zeros(SUMS), np.array([row[kernel.BIAS], 0.0, 0.0])
        add_sums(sums, last, bool(problem.objective.kpis), s.r, s.noise, y, u, x)
        return Path(branch, u, x, float(weigh(sums[None, :], problem.weights, n)[0]))

    if flip is None:
        run(0, n, row)
        return ended()
    run(0, flip, row)
    own = Decisions.from_branch(path(problem, tuning).branch[flip : flip + 1]).motion[0]
    other = row.copy()
    # With no band the stem slips whatever the distance; with an infinite one it rests.
    other[kernel.BAND] = -1.0 if own == 0 else np.inf
    run(flip, flip + 1, other)
    run(flip + 1, n, row)
    return ended()


def full_space(problem: Problem) -> FullSpace:
    """Return a problem's runs as the symbolic programs take them."""
    law = coefficients(problem.loop, problem.experiment.stem_offset)[0]
    s = problem.signals
    travel = max(float(np.abs(s.r).max()), float(np.abs(s.load).max()) * abs(law[kernel.GAIN]), 1e-12)
    steady = abs(law[kernel.GAIN] * (law[kernel.C0] + law[kernel.C1]) / max(1.0 - law[kernel.POLE], 0.1))
    size = (travel, max(problem.loop.valve.hold, travel / steady, 1e-12))
    numbers = {name: float(law[getattr(kernel, name)]) for name in COEFFICIENTS}
    signals = (s.r, s.load, s.noise)
    return FullSpace(problem.loop, numbers, *signals, problem.objective, problem.bounds, size=size)


class Refiner:
    """Branch programs of one problem: compiled once, each sequence solved at most once over all restarts."""

    def __init__(self, problem: Problem, guard: float, reference: float) -> None:
        self._problem = problem
        valve = problem.loop.valve
        # Guard margins count in the valve's own mean of stick band and slip jump; a valve without any has no guards.
        self._guard = guard * (valve.stick_band + valve.slip_jump) / 2.0
        with held_interrupt() as held:
            self._program = BranchProgram(full_space(problem), reference)
        if held.asked:
            raise KeyboardInterrupt
        self._strict = valve.sticks_at_once
        self._seen: set[bytes] = set()
        self._failures = 0
        self._least, self._idle = math.inf, IDLE

    def refine(self, tunings: FloatArray, costs: FloatArray, budget: int, seeds: Sequence[Seed] = ()) -> Refined:
        """Solve the programs of the best distinct sequences among scanned tunings, and of their neighbours.

        tunings: shape (M, 3), costs: their J, shape (M,); seeds: further sequences, which the exact runs of their
        tunings need not take. At most `budget` solves, the most promising next. Raises KeyboardInterrupt where a solve
        was interrupted.
        """
        problem = self._problem
        queue: list[_Waiting] = []
        order = np.argsort(costs, kind="stable")
        waiting = 0
        for index in order[np.isfinite(costs[order])]:
            if waiting == budget:
                break
            branch = path(problem, tunings[index]).branch
            key = branch.tobytes()
            if key not in self._seen:
                self._seen.add(key)
                heapq.heappush(queue, (float(costs[index]), waiting, key, tunings[index], True, None))
                waiting += 1
        self._least = min(self._least, float(costs.min(initial=math.inf)))
        before, idle, patience = self._least, 0, self._idle
        if seeds:
            # Sequences from elsewhere are a chance of their own.
            self._failures, patience = 0, budget
        for seed in seeds:
            if seed.decisions.key not in self._seen:
                self._seen.add(seed.decisions.key)
                heapq.heappush(queue, (seed.promise, waiting, seed.decisions.key, seed.tuning, False, seed.point))
                waiting += 1
        found: list[FloatArray] = []
        values: list[float] = []
        accepted: list[bool] = []
        iterations = solves = 0
        while queue and solves < budget and idle < patience and self._failures < FAILURES:
            _, _, key, start, natural, point = heapq.heappop(queue)
            decisions = Decisions.from_branch(np.frombuffer(key, dtype=np.int8))
            begin = (float(start[0]), float(start[1]), float(start[2]))
            end = self._solved(decisions, begin, point=point)
            solves += 1
            iterations += end.result.iterations
            if not end.result.status.success and natural and self._strict and solves < budget:
                # No tuning keeps the full margin: be content with the margin that the start has.
                end = self._solved(decisions, begin, relaxed=True)
                solves += 1
                iterations += end.result.iterations
            tuning = np.array(end.tuning)
            exact = float(problem.exact(tuning[None, :])[0])
            same = path(problem, tuning).branch.tobytes() == key
            agrees = same and abs(exact - end.objective) <= AGREEMENT * max(abs(exact), 1e-12)
            found.append(tuning)
            values.append(exact)
            accepted.append(end.result.status.success and agrees)
            self._failures = 0 if accepted[-1] else self._failures + 1
            idle = 0 if exact < (1.0 - GAIN) * self._least else idle + 1
            self._least = min(self._least, exact)
            if not accepted[-1] or exact > min(values):
                continue
            for sample in end.active[:FLIPS]:
                across = path(problem, tuning, flip=sample)
                neighbour = across.branch.tobytes()
                if neighbour not in self._seen and across.cost <= WORTH * exact:
                    self._seen.add(neighbour)
                    waiting += 1
                    heapq.heappush(queue, (across.cost, waiting, neighbour, tuning, False, None))
        self._idle = IDLE if self._least < (1.0 - GAIN) * before else IDLE_LATER
        best = sorted(range(len(values)), key=lambda i: (not accepted[i], values[i]))
        return Refined(
            tunings=np.array([found[i] for i in best]).reshape(-1, 3),
            costs=np.array([values[i] for i in best]),
            accepted=sum(accepted),
            solves=solves,
            iterations=iterations,
        )

    def _solved(
        self,
        decisions: Decisions,
        begin: tuple[float, float, float],
        *,
        relaxed: bool = False,
        point: FloatArray | None = None,
    ) -> BranchSolution:
        """Solve one program. Raises KeyboardInterrupt where Ctrl-C came meanwhile."""
        with held_interrupt() as held:
            end = self._program.solve(decisions, begin, self._guard, relaxed=relaxed, point=point)
        if held.asked or end.result.status is SolveStatus.INTERRUPTED:
            raise KeyboardInterrupt
        return end
