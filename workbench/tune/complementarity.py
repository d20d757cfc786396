"""Seeds for refinement from the loop in complementarity form: an alternative to scanning for where to start.

`wb.tune` does not use it. Measured on the paper's loop (step 4, N = 200, PID with n = 10, ten random starts each), the
refined seeds reach the best known J within 0.1 % from 9 of 10 starts for w1 = w3 = 0.5 (derivative on PV), and from 9
of 10 with w4 = 0.5 besides; from none with w2 = 0.05, or with w4 = 0.05 and the derivative on error. One seed takes as
long as all the scans and refinements of `wb.tune` together, which reach no less on any of the four.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.record import FloatArray
from workbench.model.results import SolveStatus
from workbench.symbolic.branch import Decisions
from workbench.symbolic.mpcc import Mpcc, MpccSolver
from workbench.symbolic.sticky import StickyProgram, relaxed
from workbench.tune.problem import Problem
from workbench.tune.refine import Seed, path, written

__all__ = ["MOST_SAMPLES", "seeds"]

# A program has 9 variables and 8 sides for each sample; beyond this it takes longer than many scans.
MOST_SAMPLES = 500


def seeds(
    problem: Problem, starts: FloatArray, reference: float, *, method: Callable[[Mpcc], MpccSolver] = relaxed
) -> list[Seed]:
    """Solve the complementarity program of a problem from the exact runs of tunings, shape (M, 3); a seed for each.

    reference: a typical J, above 0. A seed promises J as its program has it, which is no J of any run. Starts whose
    runs overflow are left out, and so are solves without a finite end. Raises `InvalidValue` for valves other than
    Stenman's, output limits, and runs longer than `MOST_SAMPLES`; KeyboardInterrupt where a solve was interrupted.
    """
    if problem.samples > MOST_SAMPLES:
        raise InvalidValue("Experiment.duration", f"{problem.samples} samples", f"at most {MOST_SAMPLES} samples here")
    law, size = written(problem)
    s = problem.signals
    program = StickyProgram(
        problem.loop,
        law,
        s.r,
        s.load,
        s.noise,
        problem.objective,
        problem.bounds,
        size=size,
        reference=reference,
        method=method,
    )
    found = []
    for start in starts:
        run = path(problem, start)
        if not math.isfinite(run.cost):
            continue
        end = program.solve(Decisions.from_branch(run.branch), (float(start[0]), float(start[1]), float(start[2])))
        if end.result.status is SolveStatus.INTERRUPTED:
            raise KeyboardInterrupt
        if math.isfinite(end.claim):
            found.append(Seed(end.decisions, end.claim, np.array(end.tuning), end.point))
    return found
