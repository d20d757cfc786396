"""The branch program: the best tuning among those whose run takes one given sequence of decisions.

Freeze every decision of an exact run (stem moves or rests, output limited or free, integral step kept or undone),
impose each as an inequality with a guard margin, and what is left is smooth: states of all samples and the tuning are
the variables, the law's equations the constraints, eq. (2) the objective. A solution that keeps its guards is the
exact run of its tuning. The program is built once for a loop and an experiment; the sequence is a parameter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray
from workbench.model.results import NlpResult
from workbench.symbolic.full_space import FullSpace
from workbench.symbolic.loop import valve_as_given
from workbench.symbolic.solve import Group, IpoptOptions, Nlp, Solver, Values

__all__ = ["OPTIONS", "BranchProgram", "BranchSolution", "Decisions"]

# Iterations bound the work, so that a busy machine changes no result; the time is but a last resort. A run is a long
# chain of samples: put off along it, pivots pile up, and a dead band's can take minutes for one iteration. Dissected
# halves stop them, for half as much time again elsewhere.
OPTIONS = IpoptOptions(
    tolerance=1e-8,
    max_iterations=40,
    max_wall_time=120.0,
    barrier=1e-3,
    push=1e-6,
    scaling="none",
    ordering="nested_dissection",
)


@dataclass(frozen=True, eq=False)
class Decisions:
    """The decisions of a run, int8 arrays of shape (N,): motion and limit are -1, 0 or 1, undone is 0 or 1."""

    motion: NDArray[np.int8]
    limit: NDArray[np.int8]
    undone: NDArray[np.int8]

    @classmethod
    def from_branch(cls, branch: NDArray[np.int8]) -> Decisions:
        """Return the decisions of a run's code `motion + 1 + 3 (limit + 1) + 9 undone`."""
        undone, rest = np.divmod(branch, 9)
        limit, motion = np.divmod(rest, 3)
        return cls((motion - 1).astype(np.int8), (limit - 1).astype(np.int8), undone.astype(np.int8))

    @property
    def branch(self) -> NDArray[np.int8]:
        """The code of the decisions."""
        code: NDArray[np.int8] = (self.motion + 1 + 3 * (self.limit + 1) + 9 * self.undone).astype(np.int8)
        return code

    @property
    def key(self) -> bytes:
        """A value that is equal for equal sequences."""
        return self.branch.tobytes()


@dataclass(frozen=True, eq=False)
class BranchSolution:
    """The end of one branch program.

    tuning: (Kc, Ti, Td) in the controller's own form, within the bounds. objective: J as the program claims it. active:
    the samples whose stem decision lies on its guard, the most pressing first.
    """

    tuning: tuple[float, float, float]
    objective: float
    active: tuple[int, ...]
    result: NlpResult


class BranchProgram:
    """The branch program of one loop, experiment, objective and bounds, compiled once; reference: a typical J, > 0."""

    def __init__(self, space: FullSpace, reference: float, options: IpoptOptions = OPTIONS) -> None:
        self.shape, self.samples, self.at = space.shape, space.samples, space.at
        self._space, self._raw, self._pu = space, space.raw, space.size[1]
        self._reference = reference
        n = self.samples
        parameters = ca.SX.sym("decisions", 3 if self.shape.limited else 1, n)
        motion = parameters[0, :]
        rows = space.rows(parameters[1, :], parameters[2, :]) if self.shape.limited else space.rows()
        u, x, x_last = space.u, space.x, space.x_last
        stem = x - valve_as_given(self.shape, space.c, u, x_last, motion)
        groups = [Group("law", ca.vec(ca.vertcat(rows.plant, rows.output, stem, rows.integral, *rows.derivative)))]
        if self.shape.valve != "ideal":
            groups.append(Group("lead", (u - x_last).T))
        if self.shape.valve == "two_parameter":
            groups.append(Group("move", (u - space.u_last).T))
        if self.shape.limited:
            groups.append(Group("after", rows.out.after.T))
            if not self.shape.back:
                groups += [Group("first", rows.action.first.T), Group("step", rows.action.step.T)]
        groups += space.bound_groups()
        self._groups = {group.name for group in groups}
        low, high = space.box()
        nlp = Nlp(
            x=space.variables,
            objective=space.objective / reference,
            groups=tuple(groups),
            lower=low,
            upper=high,
            parameters=ca.vec(parameters.T),
        )
        self._solver = Solver(nlp, options)

    def solve(
        self,
        decisions: Decisions,
        tuning: tuple[float, float, float],
        guard: float,
        *,
        relaxed: bool = False,
        point: FloatArray | None = None,
    ) -> BranchSolution:
        """Solve for one sequence, started from the run that `tuning` makes with it.

        guard: the least distance (%) to keep from a stem decision. As many parameters can lead a run away from as many
        guards only: where more are nearer than that at the start, or `relaxed`, half of the start's own distance is
        asked for instead. point: values of the full space's variables to start from instead of that run, where the
        tuning's run with these decisions would lead far away. Never raises for a solve that fails.
        """
        n = self.samples
        start, guards = self._space.start(tuning, decisions.motion, decisions.limit, decisions.undone)
        if point is not None:
            start, guards = point, {**guards, "lead": self._space.lead(point)}
        parts = [decisions.motion, decisions.limit, decisions.undone] if self.shape.limited else [decisions.motion]
        bounds = {
            name: (low / self._pu, high / self._pu)
            for name, (low, high) in self._guard_bounds(decisions, guards, guard, relaxed).items()
            if name in self._groups
        }
        result = self._solver.solve(
            Values(start=start, parameters=np.concatenate(parts).astype(np.float64), bounds=bounds)
        )
        return BranchSolution(
            tuning=self.at.tuning(result.x[: self.at.size]),
            objective=result.objective * self._reference,
            active=self._active(result.x, bounds, n),
            result=result,
        )

    def _guard_bounds(
        self, decisions: Decisions, at: Mapping[str, FloatArray], guard: float, relaxed: bool
    ) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Bounds (%) that make each decision hold, by the name of what it looks at."""
        n = self.samples
        now = decisions.motion.astype(np.float64)
        before = np.append(0.0, now[:-1])
        band, low, high = self._raw["BAND"], self._raw["LOW"], self._raw["HIGH"]
        free = np.full(n, math.inf)
        bounds: dict[str, tuple[FloatArray, FloatArray]] = {}
        resting, goes_on = now == 0.0, np.zeros(n, bool)
        if self.shape.valve == "two_parameter":
            goes_on = (now != 0.0) & (now == before)
        distance = np.where(resting, band - np.abs(at["lead"]), now * at["lead"] - band)
        near = ~goes_on & (distance > 0.0) & (distance < guard)
        # Just after a reversal the two-parameter law itself puts the stem next to its guard: a full margin there would
        # forbid slow reversals altogether.
        relaxed = relaxed or self.shape.valve == "two_parameter" or int(near.sum()) > self.at.size
        margin = np.where(near, distance / 2.0, guard) if relaxed else np.full(n, guard)
        if self.shape.valve == "two_parameter":
            room = np.abs(at["move"]) / 2.0
            least = np.where(
                np.sign(at["move"]) == np.where(goes_on, now, -before), np.minimum(1e-3 * guard, room), 0.0
            )
            stops = resting & (before != 0.0)
            up = (goes_on & (now > 0)) | (stops & (before < 0))
            down = (goes_on & (now < 0)) | (stops & (before > 0))
            bounds["move"] = (np.where(up, least, -free), np.where(down, -least, free))
        slips = ~resting & ~goes_on
        bounds["lead"] = (
            np.where(resting, -(band - margin), np.where(slips & (now > 0), band + margin, -free)),
            np.where(resting, band - margin, np.where(slips & (now < 0), -(band + margin), free)),
        )
        limit, undone = decisions.limit, decisions.undone == 1
        bounds["after"] = (
            np.where(limit > 0, high, np.where(limit == 0, low, -free)),
            np.where(limit < 0, low, np.where(limit == 0, high, free)),
        )
        rising = at["step"] > 0.0
        bounds["first"] = (np.where(undone & rising, high, -free), np.where(undone & ~rising, low, free))
        keeps_high, keeps_low = ~undone & (limit > 0), ~undone & (limit < 0)
        bounds["step"] = (
            np.where((undone & rising) | keeps_low, 0.0, -free),
            np.where((undone & ~rising) | keeps_high, 0.0, free),
        )
        return bounds

    def _active(
        self, point: FloatArray, bounds: Mapping[str, tuple[FloatArray, FloatArray]], n: int
    ) -> tuple[int, ...]:
        """Samples whose stem decision lies within 1e-4 of OP's unit from its guard, the nearest first."""
        if "lead" not in bounds:
            return ()
        z = point[self.at.size :].reshape(n, -1)
        lead = z[:, 1] - np.append(0.0, z[:-1, 2])
        low, high = bounds["lead"]
        gap = np.minimum(lead - low, high - lead)
        near = np.flatnonzero(gap < 1e-4)
        return tuple(int(k) for k in near[np.argsort(gap[near], kind="stable")])
