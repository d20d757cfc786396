"""Seeds for refinement from the loop in complementarity form: an alternative to scanning for where to start.

`wb.tune` takes it when asked (`complementarity=`). Measured on the paper's loop (step 4, N = 200, PID with n = 10) from
the best ten of a hundred random tunings each: refined by up to 12 branch programs, every seed reaches the best known J
within 0.1 % for w1 = w3 = 0.5 (derivative on PV), with w4 = 0.5 besides, and with w4 = 0.05 and derivative on error;
with w2 = 0.05 none comes nearer than 6.8 %. A seed takes 0.5 to 1.8 s, as long as several scans, which reach no less.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.record import FloatArray
from workbench.model.results import SolveStatus
from workbench.model.valve import Stenman
from workbench.symbolic.branch import Decisions
from workbench.symbolic.loop import unwritten
from workbench.symbolic.mpcc import Mpcc, MpccSolver
from workbench.symbolic.sticky import StickyProgram, relaxed
from workbench.tune.problem import Problem
from workbench.tune.refine import Seed, eq_2_alone, full_space, path

__all__ = ["MOST_SAMPLES", "applicable", "seeds"]

# A program has 9 variables and 8 sides for each sample; beyond this it takes longer than many scans.
MOST_SAMPLES = 500


def applicable(problem: Problem) -> None:
    """Raise `InvalidValue` where a problem has no complementarity program: see `seeds`."""
    if problem.samples > MOST_SAMPLES:
        raise InvalidValue("Experiment.duration", f"{problem.samples} samples", f"at most {MOST_SAMPLES} samples here")
    if not isinstance(problem.loop.valve, Stenman):
        raise InvalidValue("loop.valve", type(problem.loop.valve).__name__, "only Stenman's has a complementarity form")
    if unwritten(problem.loop):
        raise InvalidValue("loop", unwritten(problem.loop), "has no complementarity form")
    if problem.loop.controller.output_limits is not None:
        raise InvalidValue("PID.output_limits", problem.loop.controller.output_limits, "must be None here")
    if not eq_2_alone(problem):
        raise InvalidValue("tune", "figures or constraints", "complementarity programs know eq. (2) alone")


def seeds(
    problem: Problem, starts: FloatArray, reference: float, *, method: Callable[[Mpcc], MpccSolver] = relaxed
) -> list[Seed]:
    """Solve the complementarity program of a problem from the exact runs of tunings, shape (M, 3); a seed for each.

    reference: a typical J, above 0. A seed promises J as its program has it, which is no J of any run. Starts whose
    runs overflow are left out, and so are solves without a finite end. Raises `InvalidValue` for valves other than
    Stenman's, output limits, a compensator, and runs longer than `MOST_SAMPLES`; KeyboardInterrupt where a solve was
    interrupted.
    """
    applicable(problem)
    program = StickyProgram(full_space(problem), reference, method=method)
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
