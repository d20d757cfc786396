"""A whole run as equations in the states of all samples and the tuning: what the programs for a loop have in common.

Inside, PV and OP are counted in units of their own size, so that a solver sees numbers near 1. The stem's equation is
left to each program: `symbolic.branch` writes it for a given sequence, `symbolic.sticky` as complementarity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from workbench.model.controller import PID
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.tuning import Bounds, Objective
from workbench.symbolic.loop import (
    COEFFICIENTS,
    GUARDS,
    STATE,
    Action,
    Coefficients,
    Output,
    action,
    given_run_function,
    limited_as_given,
    plant_step,
    shape_of,
)
from workbench.symbolic.solve import Group

__all__ = ["Coordinates", "FullSpace", "Rows"]


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


class Rows(NamedTuple):
    """The law's equations but for the stem's, each a row of N expressions that must be 0; derivative: none or one.

    action and out are what the controller makes of the states.
    """

    plant: Any
    output: Any
    integral: Any
    derivative: tuple[Any, ...]
    action: Action
    out: Output


class FullSpace:
    """The variables of a run and what is written in them.

    Variables: the tuning's coordinates `t`, then for each sample y_{k+1}, u, x, I (and D). `coefficients`: the loop's
    numbers by the names of `symbolic.loop.COEFFICIENTS`; of them bias, limits, valve and plant are used. r (EU), load
    (%), noise (EU): shape (N + 1,). size: typical |PV| (EU) and |OP| (%) of a run, both above 0. `objective` is J of
    eq. (2), unscaled; u, x, x_last, u_last are rows of N expressions in OP's unit, as `c.band` is.
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
    ) -> None:
        self.loop, self.shape = loop, shape_of(loop)
        self.samples = n = int(r.size) - 1
        self.at = Coordinates(loop.controller, loop.sample_time, bounds)
        self.size = py, pu = size
        self._unit = py / pu
        fixed = {name.lower(): float(coefficients[name]) for name in COEFFICIENTS}
        for name in ("bias", "low", "high", "band", "offset"):
            fixed[name] /= pu
        fixed["gain"] *= pu / py
        self.raw = {name: float(coefficients[name]) for name in COEFFICIENTS}
        self._signals = (r, load, noise)
        self._run = given_run_function(self.shape, n)

        self._t = t = ca.SX.sym("t", self.at.size)
        self._names = ["y", "u", "x", "i"] + (["d"] if self.at.derivative else [])
        self._z = z = ca.SX.sym("z", len(self._names), n)
        self._y_next, self.u, self.x, self._i = z[0, :], z[1, :], z[2, :], z[3, :]
        self._d = z[4, :] if self.at.derivative else ca.SX.zeros(1, n)
        self.variables = ca.vertcat(t, ca.vec(z))
        self.c = Coefficients(**{**fixed, **self._scaled(self.at.terms(t))})
        self.x_last = ca.horzcat(0.0, self.x[:, : n - 1])
        self.u_last = ca.horzcat(fixed["bias"], self.u[:, : n - 1])

        e_next = ca.DM(r[1:] / py).T - (self._y_next + ca.DM(noise[1:] / py).T)
        w1, w2, w3, w4 = objective.weights
        J = w1 * py**2 * ca.sumsqr(e_next) + w3 * py**2 * e_next[n - 1] ** 2
        J += pu**2 * (w2 * ca.sumsqr(self.u) + w4 * ca.sumsqr(self.u - self.u_last))
        self.objective = J

    def rows(self, limit: Any = None, undone: Any = None) -> Rows:
        """Return the equations; limit and undone: rows of N given decisions where the output has limits."""
        n, c = self.samples, self.c
        py, pu = self.size
        r, load, noise = self._signals
        sp = ca.DM(r[:n] / py).T
        true_y = ca.horzcat(0.0, self._y_next[:, : n - 1])
        measured = true_y + ca.DM(noise[:n] / py).T
        s = -measured if self.shape.on_pv else sp - measured
        i_last = ca.horzcat(0.0, self._i[:, : n - 1])
        d_last = ca.horzcat(0.0, self._d[:, : n - 1])
        a = action(self.shape, c, i_last, d_last, ca.horzcat(0.0, s[:, : n - 1]), sp, measured)
        none = ca.SX.zeros(1, n)
        out = limited_as_given(
            self.shape, c, a, i_last, none if limit is None else limit, none if undone is None else undone
        )
        v = self.x + ca.DM(load[:n] / pu).T
        m = self.shape.delay
        near = ca.horzcat(ca.SX.zeros(1, min(m, n)), v[:, : max(n - m, 0)])
        far = ca.horzcat(ca.SX.zeros(1, min(m + 1, n)), v[:, : max(n - m - 1, 0)])
        return Rows(
            plant=self._y_next - plant_step(c, true_y, near, far),
            output=self.u - out.u,
            integral=self._i - out.i,
            derivative=(self._d - a.d,) if self.at.derivative else (),
            action=a,
            out=out,
        )

    def bound_groups(self) -> list[Group]:
        """Return the bounds of the tuning that involve two coordinates, as one group or none."""
        rows = self.at.rows(self._t)
        return [Group("bounds of the tuning", ca.vertcat(*rows), 0.0, math.inf)] if rows else []

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of the variables: states are free."""
        low, high = self.at.box()
        free = np.full(len(self._names) * self.samples, math.inf)
        return np.concatenate([low, -free]), np.concatenate([high, free])

    def start(
        self,
        tuning: tuple[float, float, float],
        motion: NDArray[np.int8],
        limit: NDArray[np.int8],
        undone: NDArray[np.int8],
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return the run that a tuning makes when the decisions, each of shape (N,), are given.

        The variables' values, and the guard quantities (%) by the names of `symbolic.loop.GUARDS`.
        """
        terms = self.at.terms(self.at.numbers(tuning))
        column = {name.lower(): value for name, value in self.raw.items()}
        column.update({name: float(value) for name, value in terms.items()})
        c = np.array([column[name.lower()] for name in COEFFICIENTS])
        state = np.zeros(len(STATE))
        state[STATE.index("U_LAST")] = self.raw["BIAS"]
        past = np.zeros(self.shape.delay + 1)
        r, load, noise = (signal[: self.samples] for signal in self._signals)
        given = [np.asarray(row, dtype=np.float64)[None, :] for row in (r, load, noise, motion, limit, undone)]
        found = self._run(state, past, c, *given)
        states, guards = np.asarray(found[0]), np.asarray(found[3])
        py, pu = self.size
        order = [STATE.index("Y"), STATE.index("U_LAST"), STATE.index("X_LAST"), STATE.index("I")]
        sizes = [py, pu, pu, pu]
        if self.at.derivative:
            order.append(STATE.index("D"))
            sizes.append(pu)
        z = states[order, :] / np.array(sizes)[:, None]
        values = np.concatenate([self.at.numbers(tuning), z.T.ravel()])
        return values, {name: guards[k] for k, name in enumerate(GUARDS)}

    def lead(self, values: FloatArray) -> FloatArray:
        """Return u_k - x_{k-1} (%) of the variables' values, shape (N,)."""
        z = values[self.at.size :].reshape(self.samples, len(self._names))
        lead: FloatArray = (z[:, 1] - np.append(0.0, z[:-1, 2])) * self.size[1]
        return lead

    def _scaled(self, terms: dict[str, Any]) -> dict[str, Any]:
        """Return the controller's terms in scaled units: gains are % per EU."""
        return {name: value * self._unit if name in ("kc", "ki", "kd") else value for name, value in terms.items()}
