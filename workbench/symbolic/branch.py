"""The branch program: the best tuning among those whose run takes one given sequence of decisions.

Freeze every decision of an exact run (stem moves or rests, output limited or free, integral step kept or undone),
impose each as an inequality with a guard margin, and what is left is smooth: states of all samples and the tuning are
the variables, the law's equations the constraints, eq. (2) the objective. A solution that keeps its guards is the
exact run of its tuning. The program is built once for a loop and an experiment; the sequence is a parameter.

Inside, PV and OP are counted in units of their own size, so that the solver sees numbers near 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from workbench.model.controller import PID
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.results import NlpResult
from workbench.model.tuning import Bounds, Objective
from workbench.symbolic.loop import (
    COEFFICIENTS,
    STATE,
    Coefficients,
    action,
    given_run_function,
    limited_as_given,
    plant_step,
    shape_of,
    valve_as_given,
)
from workbench.symbolic.solve import Group, IpoptOptions, Nlp, Solver, Values

__all__ = ["OPTIONS", "BranchProgram", "BranchSolution", "Decisions"]

# Iterations bound the work, so that a busy machine changes no result; the time is but a last resort.
OPTIONS = IpoptOptions(tolerance=1e-8, max_iterations=40, max_wall_time=120.0, barrier=1e-3, push=1e-6, scaling="none")


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


class Coordinates:
    """The tuning as the program sees it: Kc, ki = Kc Ts/Ti (parallel: Ts/Ti) and a derivative coordinate.

    The derivative coordinate is alpha = Tf/(Tf + Ts) of a filtered derivative, Kc Td/Ts (parallel: Td/Ts) of an
    unfiltered one, and Td/Ts in the series form. With it the law is polynomial in tuning and states (series: smooth).
    """

    def __init__(self, pid: PID, sample_time: float, bounds: Bounds) -> None:
        self.pid = pid
        self.Ts = sample_time
        self.bounds = bounds
        self.derivative = bounds.Td[1] > 0.0
        self.filtered = not math.isinf(pid.derivative_filter)
        self.size = 3 if self.derivative else 2

    def numbers(self, tuning: tuple[float, float, float]) -> FloatArray:
        """Return the coordinates of (Kc, Ti, Td)."""
        Kc, Ti, Td = tuning
        pid, Ts = self.pid, self.Ts
        ki = Ts / Ti if pid.form == "parallel" else Kc * Ts / Ti
        if not self.derivative:
            return np.array([Kc, ki])
        if pid.form == "series":
            return np.array([Kc, ki, Td / Ts])
        if not self.filtered:
            return np.array([Kc, ki, Td / Ts if pid.form == "parallel" else Kc * Td / Ts])
        # Parallel: Tf = Td/(Kc n), written so that Kc = 0 needs no division.
        n = pid.derivative_filter * (Kc if pid.form == "parallel" else 1.0)
        return np.array([Kc, ki, Td / (Td + n * Ts) if Td > 0.0 else 0.0])

    def tuning(self, t: FloatArray) -> tuple[float, float, float]:
        """Return (Kc, Ti, Td) of coordinates, moved into the bounds where rounding has left them."""
        pid, Ts = self.pid, self.Ts
        Kc, ki = float(t[0]), float(t[1])
        top = Ts if pid.form == "parallel" else Kc * Ts
        Ti = top / ki if ki > 0.0 else self.bounds.Ti[1]
        Td = 0.0
        if self.derivative:
            last = float(t[2])
            if pid.form == "series":
                Td = last * Ts
            elif self.filtered:
                n = pid.derivative_filter * (Kc if pid.form == "parallel" else 1.0)
                Td = n * Ts * last / (1.0 - last) if last < 1.0 else self.bounds.Td[1]
            elif pid.form == "parallel":
                Td = last * Ts
            else:
                Td = last * Ts / Kc if Kc > 0.0 else 0.0
        return (_within(Kc, self.bounds.Kc), _within(Ti, self.bounds.Ti), _within(Td, self.bounds.Td))

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of the coordinates as far as they are bounds of one coordinate alone."""
        b, Ts, pid = self.bounds, self.Ts, self.pid
        low, high = [b.Kc[0], 0.0], [b.Kc[1], math.inf]
        if pid.form == "parallel":
            low[1], high[1] = Ts / b.Ti[1], Ts / b.Ti[0]
        if self.derivative:
            low.append(0.0)
            high.append(math.inf)
            if pid.form == "series" or (pid.form == "parallel" and not self.filtered):
                low[2], high[2] = b.Td[0] / Ts, b.Td[1] / Ts
            elif pid.form == "ideal" and self.filtered:
                n = pid.derivative_filter
                low[2], high[2] = (Td / (Td + n * Ts) for Td in b.Td)
            elif self.filtered:
                high[2] = 1.0
        return np.array(low), np.array(high)

    def rows(self, t: Any) -> list[Any]:
        """Return expressions that must be >= 0: the bounds on Ti and Td that involve two coordinates."""
        b, Ts, pid = self.bounds, self.Ts, self.pid
        Kc, ki = t[0], t[1]
        rows = []
        if pid.form != "parallel":
            rows += [ki * b.Ti[1] - Kc * Ts, Kc * Ts - ki * b.Ti[0]]
        if self.derivative and pid.form == "ideal" and not self.filtered:
            rows += [t[2] * Ts - Kc * b.Td[0], Kc * b.Td[1] - t[2] * Ts]
        if self.derivative and pid.form == "parallel" and self.filtered:
            n = pid.derivative_filter
            rows += [n * Ts * Kc * t[2] - b.Td[0] * (1 - t[2]), b.Td[1] * (1 - t[2]) - n * Ts * Kc * t[2]]
        return rows

    def terms(self, t: Any) -> dict[str, Any]:
        """Return the law's kc, ki, kd, tf, tf_ts, weight and ts_tt, where tf and tf_ts are divided by Tf + Ts."""
        pid, Ts = self.pid, self.Ts
        sign = pid.signed_gain
        Kc, ki, b = t[0], t[1], pid.setpoint_weight
        kd: Any = 0.0
        tf: Any = 0.0
        kc, weight = Kc, b
        if self.derivative and pid.form == "series":
            Td = t[2] * Ts
            Tf = Td / pid.derivative_filter
            tf = Tf / (Tf + Ts)
            # kd = Kc Td (1 - Tf/Ti) and kc = Kc (1 + Td/Ti), with Kc/Ti = ki/Ts.
            kd = (Kc * Td - ki * Td * Tf / Ts) / (Tf + Ts)
            kc = Kc + ki * t[2]
            on_error = pid.derivative_on == "error"
            weight = (b * Kc + ki * t[2]) / kc if on_error else b * Kc / kc
        elif self.derivative and self.filtered:
            tf = t[2]
            kd = pid.derivative_filter * Kc * tf
        elif self.derivative:
            kd = t[2]
        tt: Any = 0.0
        if pid.output_limits is not None and pid.anti_windup == "back_calculation":
            # Ts over the ideal form's Ti, which is ki/kc in every form.
            tt = ki / kc if pid.tracking_time is None else Ts / pid.tracking_time
        return {
            "kc": sign * kc,
            "ki": sign * ki,
            "kd": sign * kd,
            "tf": tf,
            "tf_ts": 1.0,
            "weight": weight,
            "ts_tt": tt,
        }


def _within(value: float, ends: tuple[float, float]) -> float:
    return min(max(value, ends[0]), ends[1])


class BranchProgram:
    """The branch program of one loop, experiment, objective and bounds, compiled once.

    `coefficients`: the loop's numbers by the names of `symbolic.loop.COEFFICIENTS`; of them bias, limits, valve and
    plant are used. r (EU), load (%), noise (EU): shape (N + 1,). size: typical |PV| (EU) and |OP| (%) of a run, both
    above 0; reference: a typical J, above 0.
    """

    def __init__(
        self,
        loop: Loop,
        coefficients: Mapping[str, float],
        r: FloatArray,
        load: FloatArray,
        noise: FloatArray,
        objective: Objective,
        bounds: Bounds,
        *,
        size: tuple[float, float],
        reference: float,
        options: IpoptOptions = OPTIONS,
    ) -> None:
        self.shape = shape_of(loop)
        self.samples = int(r.size) - 1
        self.at = Coordinates(loop.controller, loop.sample_time, bounds)
        self._reference = reference
        self._py, self._pu = size
        py, pu = size
        self._unit = py / pu
        n = self.samples
        fixed = {name.lower(): float(coefficients[name]) for name in COEFFICIENTS}
        for name in ("bias", "low", "high", "band", "offset"):
            fixed[name] /= pu
        fixed["gain"] *= pu / py
        self._fixed = fixed
        self._raw = {name: float(coefficients[name]) for name in COEFFICIENTS}
        self._signals = (r, load, noise)
        self._run = given_run_function(self.shape, n)

        t = ca.SX.sym("t", self.at.size)
        names = ["y", "u", "x", "i"] + (["d"] if self.at.derivative else [])
        z = ca.SX.sym("z", len(names), n)
        y_next, u, x, i = z[0, :], z[1, :], z[2, :], z[3, :]
        d = z[4, :] if self.at.derivative else ca.SX.zeros(1, n)
        parameters = ca.SX.sym("decisions", 3 if self.shape.limited else 1, n)
        motion = parameters[0, :]
        limit = parameters[1, :] if self.shape.limited else ca.SX.zeros(1, n)
        undone = parameters[2, :] if self.shape.limited else ca.SX.zeros(1, n)

        c = Coefficients(**{**fixed, **self._scaled(self.at.terms(t))})
        sp = ca.DM(r[:n] / py).T
        true_y = ca.horzcat(0.0, y_next[:, : n - 1])
        measured = true_y + ca.DM(noise[:n] / py).T
        s = -measured if self.shape.on_pv else sp - measured
        i_last = ca.horzcat(0.0, i[:, : n - 1])
        d_last = ca.horzcat(0.0, d[:, : n - 1])
        x_last = ca.horzcat(0.0, x[:, : n - 1])
        u_last = ca.horzcat(fixed["bias"], u[:, : n - 1])
        a = action(self.shape, c, i_last, d_last, ca.horzcat(0.0, s[:, : n - 1]), sp, measured)
        out = limited_as_given(self.shape, c, a, i_last, limit, undone)
        v = x + ca.DM(load[:n] / pu).T
        m = self.shape.delay
        near = ca.horzcat(ca.SX.zeros(1, min(m, n)), v[:, : max(n - m, 0)])
        far = ca.horzcat(ca.SX.zeros(1, min(m + 1, n)), v[:, : max(n - m - 1, 0)])
        law = [
            y_next - plant_step(c, true_y, near, far),
            u - out.u,
            x - valve_as_given(self.shape, c, u, x_last, motion),
            i - out.i,
        ]
        if self.at.derivative:
            law.append(d - a.d)
        groups = [Group("law", ca.vec(ca.vertcat(*law)))]
        if self.shape.valve != "ideal":
            groups.append(Group("lead", (u - x_last).T))
        if self.shape.valve == "two_parameter":
            groups.append(Group("move", (u - u_last).T))
        if self.shape.limited:
            groups.append(Group("after", out.after.T))
            if not self.shape.back:
                groups += [Group("first", a.first.T), Group("step", a.step.T)]
        rows = self.at.rows(t)
        if rows:
            groups.append(Group("bounds of the tuning", ca.vertcat(*rows), 0.0, math.inf))
        self._groups = {group.name for group in groups}

        e_next = ca.DM(r[1:] / py).T - (y_next + ca.DM(noise[1:] / py).T)
        w1, w2, w3, w4 = objective.weights
        J = w1 * py**2 * ca.sumsqr(e_next) + w3 * py**2 * e_next[n - 1] ** 2
        J += pu**2 * (w2 * ca.sumsqr(u) + w4 * ca.sumsqr(u - u_last))
        low, high = self.at.box()
        free = np.full(len(names) * n, math.inf)
        nlp = Nlp(
            x=ca.vertcat(t, ca.vec(z)),
            objective=J / reference,
            groups=tuple(groups),
            lower=np.concatenate([low, -free]),
            upper=np.concatenate([high, free]),
            parameters=ca.vec(parameters.T),
        )
        self._solver = Solver(nlp, options)

    def _scaled(self, terms: dict[str, Any]) -> dict[str, Any]:
        """Return the controller's terms in scaled units: gains are % per EU."""
        return {name: value * self._unit if name in ("kc", "ki", "kd") else value for name, value in terms.items()}

    def solve(
        self, decisions: Decisions, tuning: tuple[float, float, float], guard: float, *, relaxed: bool = False
    ) -> BranchSolution:
        """Solve for one sequence, started from the run that `tuning` makes with it.

        guard: the least distance (%) to keep from a stem decision. As many parameters can lead a run away from as many
        guards only: where more are nearer than that at the start, or `relaxed`, half of the start's own distance is
        asked for instead. Never raises for a solve that fails.
        """
        n = self.samples
        states, guards = self._trajectory(decisions, tuning)
        order = [STATE.index("Y"), STATE.index("U_LAST"), STATE.index("X_LAST"), STATE.index("I")]
        sizes = [self._py, self._pu, self._pu, self._pu]
        if self.at.derivative:
            order.append(STATE.index("D"))
            sizes.append(self._pu)
        z = states[order, :] / np.array(sizes)[:, None]
        start = np.concatenate([self.at.numbers(tuning), z.T.ravel()])
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

    def _trajectory(
        self, decisions: Decisions, tuning: tuple[float, float, float]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """The run that a tuning makes when the decisions are given: states (7, N) and guard quantities by name."""
        terms = self.at.terms(self.at.numbers(tuning))
        column = {name.lower(): value for name, value in self._raw.items()}
        column.update({name: float(value) for name, value in terms.items()})
        c = np.array([column[name.lower()] for name in COEFFICIENTS])
        state = np.zeros(len(STATE))
        state[STATE.index("U_LAST")] = self._raw["BIAS"]
        past = np.zeros(self.shape.delay + 1)
        r, load, noise = (signal[: self.samples] for signal in self._signals)
        found = self._run(
            state,
            past,
            c,
            *(np.asarray(row, dtype=np.float64)[None, :] for row in (r, load, noise)),
            *(
                np.asarray(row, dtype=np.float64)[None, :]
                for row in (decisions.motion, decisions.limit, decisions.undone)
            ),
        )
        states, guards = np.asarray(found[0]), np.asarray(found[3])
        names = ("lead", "move", "first", "step", "after")
        return states, {name: guards[k] for k, name in enumerate(names)}

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
