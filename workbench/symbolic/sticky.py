"""The sticky loop in complementarity form: the stem's decisions as unknowns of one program over the whole run.

A Stenman valve moves by `x_k = x_{k-1} + (a_k + b_k)(u_k - x_{k-1})`, where a_k is the unit step of
`w = u_k - x_{k-1} - d` and b_k that of `w = x_{k-1} - u_k - d`. A unit step of w is the solution of a linear program,
whose conditions are two pairs (A. Nurkanovic, M. Diehl, "NOSNOC: a software package for numerical optimal control of
nonsmooth systems", IEEE Control Syst. Lett. 6 (2022) 3110-3115): with w = p - n, `0 <= n perp a >= 0` and
`0 <= p perp 1 - a >= 0`. At w = 0 any a between is a solution, which the valve itself does not have: what this program
finds is therefore no tuning to use but a *sequence* to start a branch program from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InvalidValue
from workbench.model.record import FloatArray
from workbench.model.valve import Stenman
from workbench.symbolic.branch import Decisions
from workbench.symbolic.full_space import FullSpace
from workbench.symbolic.mpcc import Homotopy, Mpcc, MpccResult, MpccSolver, Pairs, RelaxedSolver
from workbench.symbolic.solve import Group, IpoptOptions, Nlp, Values

__all__ = [
    "HOMOTOPY",
    "OPTIONS",
    "StickyProgram",
    "StickySolution",
    "decided",
    "moved",
    "relaxed",
    "unit_steps",
    "unknown_decisions",
]

# Fischer-Burmeister's rows are equations: with so few inequalities left a small barrier lets IPOPT take Newton's steps.
HOMOTOPY = Homotopy("fischer_burmeister", (1.0, 0.1, 1e-2, 1e-4, 1e-6, 1e-8), finish=False)
OPTIONS = IpoptOptions(tolerance=1e-6, max_iterations=100, max_wall_time=120.0, barrier=1e-3, push=1e-4, scaling="none")


def unknown_decisions(n: int) -> Any:
    """Return the symbols of N samples' decisions, shape (4, N): a, b, and n of each."""
    return ca.vertcat(*(ca.SX.sym(name, 1, n) for name in ("a", "b", "short_a", "short_b")))


def moved(decisions: Any, u: Any, x_last: Any) -> Any:
    """Return the stem after its decisions, a row of N."""
    return x_last + (decisions[0, :] + decisions[1, :]) * (u - x_last)


def unit_steps(decisions: Any, lead: Any, band: Any) -> Pairs:
    """Return the pairs that make a and b the unit steps of lead - band and -lead - band, rows of N as `band` is."""
    a, b, short_a, short_b = (decisions[i, :] for i in range(4))
    G = ca.vertcat(short_a, short_b, lead - band + short_a, -lead - band + short_b)
    H = ca.vertcat(a, b, 1.0 - a, 1.0 - b)
    return Pairs("decisions", ca.vec(G), ca.vec(H))


def decided(motion: NDArray[np.int8], lead: FloatArray, band: float) -> FloatArray:
    """Return the values, shape (4, N), of decisions (-1, 0, 1) that a valve took at these leads."""
    steps = np.stack([motion > 0, motion < 0]).astype(np.float64)
    return np.vstack([steps, np.maximum(np.stack([band - lead, band + lead]), 0.0)])


def relaxed(problem: Mpcc) -> MpccSolver:
    """Return the solver that serves this program best of those measured."""
    return RelaxedSolver(problem, HOMOTOPY, OPTIONS)


@dataclass(frozen=True, eq=False)
class StickySolution:
    """What one solve suggests: a tuning (Kc, Ti, Td) within the bounds and the rounded sequence of decisions.

    claim: J as the program has it, which exact simulation of the tuning does not confirm. point: the variables of the
    full space at its end.
    """

    tuning: tuple[float, float, float]
    decisions: Decisions
    claim: float
    point: FloatArray
    result: MpccResult


class StickyProgram:
    """The complementarity program of one loop with a Stenman valve and no output limits, compiled once.

    reference: a typical J, > 0; `method` makes the solver. Raises `InvalidValue` for other loops.
    """

    def __init__(self, space: FullSpace, reference: float, *, method: Callable[[Mpcc], MpccSolver] = relaxed) -> None:
        loop = space.loop
        if not isinstance(loop.valve, Stenman):
            raise InvalidValue("Loop.valve", loop.valve, "the complementarity form is written for Stenman valves")
        if space.shape.limited:
            raise InvalidValue(
                "PID.output_limits", loop.controller.output_limits, "the complementarity form knows no output limits"
            )
        self._space, self._reference = space, reference
        n, c = space.samples, space.c
        decisions = unknown_decisions(n)
        rows = space.rows()
        stem = space.x - moved(decisions, space.u, space.x_last)
        law = ca.vertcat(rows.plant, rows.output, stem, rows.integral, *rows.derivative)
        low, high = space.box()
        free = np.full(4 * n, np.inf)
        nlp = Nlp(
            x=ca.vertcat(space.variables, ca.vec(decisions)),
            objective=space.objective / reference,
            groups=(Group("law", ca.vec(law)), *space.bound_groups()),
            lower=np.concatenate([low, -free]),
            upper=np.concatenate([high, free]),
        )
        self._solver = method(Mpcc(nlp, (unit_steps(decisions, space.u - space.x_last, c.band),)))

    def solve(self, decisions: Decisions, tuning: tuple[float, float, float]) -> StickySolution:
        """Solve from the run that `tuning` makes with these decisions. Never raises for a solve that fails."""
        space = self._space
        start, guards = space.start(tuning, decisions.motion, decisions.limit, decisions.undone)
        steps = decided(decisions.motion, guards["lead"] / space.size[1], space.c.band)
        result = self._solver.solve(Values(start=np.concatenate([start, steps.T.ravel()])))
        found = result.x[start.size :].reshape(space.samples, 4)
        motion = ((found[:, 0] >= 0.5).astype(np.int8) - (found[:, 1] >= 0.5).astype(np.int8)).astype(np.int8)
        none = np.zeros(space.samples, np.int8)
        return StickySolution(
            tuning=space.at.tuning(result.x[: space.at.size]),
            decisions=Decisions(motion, none, none),
            claim=result.objective * self._reference,
            point=result.x[: start.size],
            result=result,
        )
