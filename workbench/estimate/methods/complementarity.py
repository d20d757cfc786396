"""The complementarity form of estimation: plant, stiction and stem path as one program over the whole record.

Given OP u and PV y of N samples, choose the plant, its bias, d, the stem before the record and its whole path x:

- the stem by the complementarity form of a Stenman valve, as `symbolic.sticky` writes it (A. Nurkanovic, M. Diehl, IEEE
  Control Syst. Lett. 6 (2022) 3110-3115): `x_k = x_{k-1} + (a_k + b_k)(u_k - x_{k-1})`, a_k and b_k the unit steps of
  `u_k - x_{k-1} - d` and `x_{k-1} - u_k - d`, each the solution of a linear program;
- the plant's exact response w to x under a zero-order hold, its dead time m + f samples with m given and f in [0, 1]
  free;
- `minimise sum of e_k^2 / N`, e what the disturbance's filter leaves of `y - w - bias` (none where it is white), in the
  measure of the profile (`Centred.innovations`), which makes the two comparable.

The pairs are relaxed by Scholtes' way, and their sides fixed in the end (`symbolic.mpcc`). The cost is piecewise
constant in d, so that nearly every stem path is a local minimum; and at `|u - x| = d` a and b may lie between 0 and 1:
a stem that moves part of the way, which no Stenman valve does. What the program finds is therefore no answer by itself:
its d is taken, the stem moved by the valve's own law on OP (`path_kernel.stem_path`), and the plant fitted again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, Limits, fit_path, predict, start_range
from workbench.estimate.search.paths import Path
from workbench.estimate.search.stems import LEAST_D, path_of
from workbench.model.record import FloatArray
from workbench.model.status import SolveStatus
from workbench.model.valve import Stenman
from workbench.symbolic.loop import held
from workbench.symbolic.mpcc import Homotopy, Mpcc, MpccResult, RelaxedSolver
from workbench.symbolic.solve import Group, IpoptOptions, Nlp, Values
from workbench.symbolic.sticky import decided, moved, unit_steps, unknown_decisions

__all__ = ["COLD", "WARM", "Found", "Point", "cold", "solved", "warm"]

# From a path that is nearly right wide relaxations only lead away; without one they lead somewhere at least.
WARM = Homotopy("scholtes", (1e-6, 1e-8))
COLD = Homotopy("scholtes", (1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8))
OPTIONS = IpoptOptions(tolerance=1e-6, max_iterations=200, max_wall_time=60.0, barrier=1e-6, push=1e-6, scaling="none")
ROUNDING = 1e-6  # of OP's range: the program knows its d no better
PART = 1e-3  # a step as far from 0 and 1 moves the stem part of the way
GAIN, TAU, SHARE, X0, BIAS, W0, RAMP, BAND = range(8)
OWN = BAND + 1


@dataclass(frozen=True, eq=False)
class Point:
    """Where a program starts or ends: d (%), the stem's path x (centred, %, shape (N,)) and x0 before it, the plant.

    decisions: as `symbolic.sticky` has them, shape (4, N). at_op: the stem is at OP in sample 0, wherever it was
    before; else it moves from x0 by the law. At an end fit.sse is what the program claims, EU^2.
    """

    d: float
    x0: float
    x: FloatArray
    fit: Fit
    decisions: FloatArray
    at_op: bool


@dataclass(frozen=True, eq=False)
class Found:
    """What a program found, and the path that the valve's law makes of its d with the plant fitted to it.

    exact is None where the stem does not move by that law. partial: samples in which the program's stem moves part of
    the way.
    """

    point: Point
    result: MpccResult
    exact: Path | None
    partial: int


def warm(data: Centred, path: Path) -> Point:
    """Return a Stenman path and its fit as a start."""
    fit = path.fit
    x0 = fit.start / fit.gain if fit.gain != 0.0 else float(data.u[path.first])
    x0 = float(np.clip(x0, *path.bounds))
    x = np.where(np.arange(data.samples) < path.first, x0, path.x)
    d = path.valve.stick_band
    at_op = path.first == 0
    lead = data.u - np.append(data.u[0] if at_op else x0, x[:-1])
    motion = ((lead > d).astype(np.int8) - (lead < -d).astype(np.int8)).astype(np.int8)
    return Point(d, x0, x, fit, decided(motion, lead, d), at_op)


def cold(data: Centred, linear: Fit, d: float) -> Point:
    """Return a start without any stem: it follows OP, and no decision is taken yet."""
    x0 = float(data.u[0])
    still = np.zeros(data.samples, np.int8)
    decisions = decided(still, data.u - np.append(x0, data.u[:-1]), d)
    decisions[:2] = 0.5
    return Point(d, x0, data.u, linear, decisions, at_op=False)


def solved(
    data: Centred,
    start: Point,
    limits: Limits,
    m: int,
    homotopy: Homotopy = WARM,
    tell: Callable[[float], None] | None = None,
) -> Found:
    """Solve the program with m whole samples of dead time; verify its d by the exact law.

    limits: of tau and theta, samples. tell: called with the share done. Never raises for a program that fails: its
    status says so. Raises KeyboardInterrupt where interrupted.
    """
    result = RelaxedSolver(_program(data, m, at_op=start.at_op), homotopy, OPTIONS, tell).solve(
        _values(data, start, limits, m)
    )
    if result.status is SolveStatus.INTERRUPTED:
        raise KeyboardInterrupt
    point = _read(data, result, m, at_op=start.at_op)
    steps = point.decisions[0] + point.decisions[1]
    partial = int(np.count_nonzero((steps > PART) & (steps < 1.0 - PART)))
    return Found(point, result, _exact(data, point, limits), partial)


def _program(data: Centred, m: int, *, at_op: bool) -> Mpcc:
    """The program of a record: `own`, then w and x of all samples, then their decisions; PV and OP of size 1."""
    n = data.samples
    own, w, x, decisions = ca.SX.sym("own", OWN), ca.SX.sym("w", 1, n), ca.SX.sym("x", 1, n), unknown_decisions(n)
    u, y = ca.DM(data.u / data.op_range).T, ca.DM(data.y / math.sqrt(data.variance)).T
    past = ca.horzcat(ca.repmat(own[X0], 1, m + 1), x)
    if data.integrating:
        pole, c0, c1 = 1.0, 1.0 - own[SHARE], own[SHARE]
    else:
        pole, c0, c1 = held(ca.exp(own[TAU]), own[SHARE])
    answer = pole * w[:, : n - 1] + own[GAIN] * (c0 * past[:, 1:n] + c1 * past[:, : n - 1]) + own[RAMP]
    x_last = ca.horzcat(u[:, 0] if at_op else own[X0], x[:, : n - 1])
    law = ca.horzcat(w[:, 0] - own[W0], w[:, 1:] - answer, x - moved(decisions, u, x_last))
    left = y - w - own[BIAS]
    p = data.a.size - 1
    e = sum((a * left[:, p - i : n - i] for i, a in enumerate(data.a.tolist())), ca.DM.zeros(1, n - p))
    nlp = Nlp(
        x=ca.vertcat(own, w.T, x.T, ca.vec(decisions)),
        objective=ca.sumsqr(e[:, data.skip - p :]) / n,
        groups=(Group("law", law.T),),
    )
    return Mpcc(nlp, (unit_steps(decisions, u - x_last, own[BAND]),))


def _values(data: Centred, start: Point, limits: Limits, m: int) -> Values:
    """Where the program starts, in its own sizes, and its bounds."""
    n, pv, op = data.samples, math.sqrt(data.variance), data.op_range
    share = min(max(start.fit.theta - m, 0.0), 1.0)
    fit = replace(start.fit, theta=m + share, start=start.fit.gain * start.x0)
    level = 0.0 if data.integrating else fit.bias
    w = predict(data, start.x, 0, fit)[0] - level
    own = np.zeros(OWN)
    own[GAIN], own[SHARE], own[X0], own[BAND] = fit.gain * op / pv, share, start.x0 / op, start.d / op
    own[TAU] = 0.0 if data.integrating else math.log(fit.tau)
    own[BIAS], own[W0] = level / pv, w[0] / pv
    own[RAMP] = fit.transient / pv if data.integrating else 0.0
    lower, upper = np.full(OWN + 6 * n, -np.inf), np.full(OWN + 6 * n, np.inf)
    lower[TAU], upper[TAU] = (math.log(t) for t in limits.tau)
    lower[SHARE], upper[SHARE] = 0.0, min(1.0, max(limits.theta[1] - m, 0.0))
    lower[BAND], upper[BAND] = LEAST_D, 1.0
    if data.sign > 0.0:
        lower[GAIN] = 0.0
    elif data.sign < 0.0:
        upper[GAIN] = 0.0
    held_at = [TAU, BIAS] if data.integrating else [RAMP]
    lower[held_at] = upper[held_at] = own[held_at]
    decisions = start.decisions / np.array([1.0, 1.0, op, op])[:, None]
    values = np.concatenate([own, w / pv, start.x / op, decisions.T.ravel()])
    return Values(start=np.clip(values, lower, upper), lower=lower, upper=upper)


def _read(data: Centred, result: MpccResult, m: int, *, at_op: bool) -> Point:
    n, pv, op = data.samples, math.sqrt(data.variance), data.op_range
    own = result.x[:OWN].tolist()
    start, level = own[GAIN] * own[X0] * pv, own[W0] * pv
    fit = Fit(
        sse=result.objective * n * data.variance,
        tau=1.0 if data.integrating else math.exp(own[TAU]),
        theta=m + own[SHARE],
        gain=own[GAIN] * pv / op,
        bias=level if data.integrating else own[BIAS] * pv,
        start=start,
        transient=own[RAMP] * pv if data.integrating else level - start,
    )
    decisions = result.x[OWN + 2 * n :].reshape(n, 4).T * np.array([1.0, 1.0, op, op])[:, None]
    return Point(own[BAND] * op, own[X0] * op, result.x[OWN + n : OWN + 2 * n] * op, fit, decisions, at_op)


def _exact(data: Centred, point: Point, limits: Limits) -> Path | None:
    """The exact stem for the program's d and x0, and the plant fitted anew.

    The program's d often lies where a path ends, and no more exactly than its tolerance: the best of d and its two
    sides.
    """
    found = []
    for d in (point.d, point.d - ROUNDING * data.op_range, point.d + ROUNDING * data.op_range):
        slips = np.flatnonzero(np.abs(data.u - (data.u[0] if point.at_op else point.x0)) > d)
        if slips.size == 0:
            continue
        first = 0 if point.at_op else int(slips[0])
        x, count = path_of(data.u, d, first)
        bounds = start_range(data.u, first, d, d)
        theta, tau = min(point.fit.theta, limits.theta[1]), float(np.clip(point.fit.tau, *limits.tau))
        fit = fit_path(data, x, first, bounds, limits, theta, tau=tau, evaluations=240, tolerance=1e-9)
        found.append(Path(Stenman(d), x, first, bounds, fit, count, (d, d)))
    return min(found, key=lambda path: path.fit.sse, default=None)
