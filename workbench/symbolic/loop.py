"""The loop's law as CasADi expressions: the second writing of what `simulate.kernel` computes.

Two forms of each part. The *law* takes its own decisions (`if_else`), for comparing sample by sample. The *given* form
takes the decisions as numbers and is then smooth in states and coefficients, so that a solver can differentiate it.

A state is the column (I, D, s_{k-1}, u_{k-1}, x_{k-1}, motion, y_k); the past is the column v_{-1}, v_{-2}, ..,
v_{-1-m} of plant inputs; the coefficients are the column named by `COEFFICIENTS`, in deviation units as everywhere.
The equations are DESIGN's laws 1 to 5: ISA-standard PID, output limits, valve (see `model.valve`), zero-order hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from workbench.errors import InvalidValue
from workbench.model.loop import Loop
from workbench.model.valve import Choudhury, Deadband, He, Ideal, Stenman

__all__ = [
    "COEFFICIENTS",
    "GUARDS",
    "STATE",
    "Shape",
    "controller_function",
    "given_function",
    "given_run_function",
    "held",
    "law_function",
    "plant_function",
    "shape_of",
    "unwritten",
    "valve_function",
]

# A CasADi expression (SX, MX) or number (DM, float): the same code writes all of them.
Expression = Any

STATE = ("I", "D", "S_LAST", "U_LAST", "X_LAST", "MOTION", "Y")
CONTROLLER_COEFFICIENTS = ("KC", "KI", "KD", "TF", "TF_TS", "WEIGHT", "BIAS", "LOW", "HIGH", "TS_TT")
COEFFICIENTS = (*CONTROLLER_COEFFICIENTS, "BAND", "OFFSET", "POLE", "GAIN", "C0", "C1")
# What each sample's decisions look at: u - x_{k-1}; u - u_{k-1}; the output before limits; its integral step; the
# output after the integral step may have been undone. The last three only matter where the output has limits.
GUARDS = ("lead", "move", "first", "step", "after")


@dataclass(frozen=True, slots=True)
class Shape:
    """What gives the expressions their shape, as opposed to their numbers.

    valve: "ideal", "stairs" (Stenman, He) or "two_parameter" (Choudhury, Deadband). delay: whole dead time m in
    samples. on_pv: derivative on PV. limited: the output has limits. back: anti-windup by back-calculation instead of
    clamping.
    """

    valve: str
    delay: int
    on_pv: bool
    limited: bool
    back: bool


class Coefficients(NamedTuple):
    """The coefficients by name; fields as in `simulate.kernel`, each an expression or a number."""

    kc: Expression
    ki: Expression
    kd: Expression
    tf: Expression
    tf_ts: Expression
    weight: Expression
    bias: Expression
    low: Expression
    high: Expression
    ts_tt: Expression
    band: Expression
    offset: Expression
    pole: Expression
    gain: Expression
    c0: Expression
    c1: Expression


class Action(NamedTuple):
    """The controller before its limits: output with the I step, output without it, the I step, D and s."""

    first: Expression
    undone: Expression
    step: Expression
    d: Expression
    s: Expression


class Output(NamedTuple):
    """The controller's sample: limited output, integral term, and the output that the limits were applied to."""

    u: Expression
    i: Expression
    after: Expression


def unwritten(loop: Loop) -> str:
    """Return what of a loop is the kernel's alone, in words: its law is not written here; empty if all of it is."""
    if not isinstance(loop.valve, Ideal | Stenman | He | Choudhury | Deadband):
        return f"the valve {type(loop.valve).__name__}"
    if loop.controller.output_resolution > 0.0:
        return "OP's resolution"
    if loop.characteristic is not None:
        return "the curved characteristic"
    if loop.scan > 1:
        return "the controller's scan"
    if loop.controller.compensator is not None:
        return f"the compensator {type(loop.controller.compensator).__name__}"
    return ""


def shape_of(loop: Loop) -> Shape:
    """Return the shape of a loop's expressions; m = floor(theta/Ts + 1e-9).

    Raises `InvalidValue` where part of its law is not written here.
    """
    valve = loop.valve
    missing = unwritten(loop)
    if missing:
        allowed = "has no symbolic form and no nonlinear program (Ideal, Stenman, He, Choudhury, Deadband valves have)"
        raise InvalidValue("Loop", missing, allowed)
    kind = "stairs" if valve.sticks_at_once else "ideal" if isinstance(valve, Ideal) else "two_parameter"
    pid = loop.controller
    return Shape(
        valve=kind,
        delay=math.floor(loop.plant.dead_time / loop.sample_time + 1e-9),
        on_pv=pid.derivative_on == "pv",
        limited=pid.output_limits is not None,
        back=pid.anti_windup == "back_calculation",
    )


def action(
    shape: Shape,
    c: Coefficients,
    i_last: Expression,
    d_last: Expression,
    s_last: Expression,
    r: Expression,
    y: Expression,
) -> Action:
    """Return the PID action on setpoint r and measured y, before limits (any common shape, elementwise)."""
    e = r - y
    s = -y if shape.on_pv else e
    d = (c.tf * d_last + c.kd * (s - s_last)) / c.tf_ts
    p = c.kc * (c.weight * r - y)
    step = c.ki * e
    return Action(c.bias + p + (i_last + step) + d, c.bias + p + i_last + d, step, d, s)


def limited_by_law(shape: Shape, c: Coefficients, a: Action, i_last: Expression) -> tuple[Output, Expression]:
    """Return the limited output as the law decides it, and the decisions' code `3 (limit + 1) + 9 undone`."""
    i = i_last + a.step
    if not shape.limited:
        return Output(a.first, i, a.first), 3
    undone = 0
    after = a.first
    if not shape.back:
        beyond = ca.logic_or(ca.logic_and(a.first > c.high, a.step > 0), ca.logic_and(a.first < c.low, a.step < 0))
        undone = ca.if_else(beyond, 1, 0)
        i = ca.if_else(beyond, i_last, i)
        after = ca.if_else(beyond, a.undone, a.first)
    limit = ca.if_else(after > c.high, 1, ca.if_else(after < c.low, -1, 0))
    u = ca.if_else(limit > 0, c.high, ca.if_else(limit < 0, c.low, after))
    if shape.back:
        i = ca.if_else(limit != 0, i + c.ts_tt * (u - after), i)
    return Output(u, i, after), 3 * (limit + 1) + 9 * undone


def limited_as_given(
    shape: Shape, c: Coefficients, a: Action, i_last: Expression, limit: Expression, undone: Expression
) -> Output:
    """Return the limited output where `limit` (-1, 0, 1) and `undone` (0, 1) are given numbers."""
    i = i_last + a.step
    if not shape.limited:
        return Output(a.first, i, a.first)
    after = a.first
    if not shape.back:
        i = i_last + (1 - undone) * a.step
        after = (1 - undone) * a.first + undone * a.undone
    up, down = limit * (limit + 1) / 2, limit * (limit - 1) / 2
    u = (1 - up - down) * after + up * c.high + down * c.low
    if shape.back:
        i = i + (up + down) * c.ts_tt * (u - after)
    return Output(u, i, after)


def valve_by_law(
    shape: Shape, c: Coefficients, u: Expression, u_last: Expression, x_last: Expression, motion: Expression
) -> tuple[Expression, Expression]:
    """Return the stem and its motion (-1, 0, 1) as the valve's law decides them."""
    if shape.valve == "ideal":
        return u, 0
    lead = u - x_last
    slips = ca.fabs(lead) > c.band
    way = ca.if_else(u > x_last, 1, -1)
    if shape.valve == "stairs":
        return ca.if_else(slips, u - way * c.offset, x_last), ca.if_else(slips, way, 0)
    goes_on = ca.logic_and(motion != 0, (u - u_last) * motion > 0)
    new = ca.if_else(goes_on, motion, ca.if_else(slips, way, 0))
    return ca.if_else(new == 0, x_last, u - new * c.offset), new


def valve_as_given(shape: Shape, c: Coefficients, u: Expression, x_last: Expression, motion: Expression) -> Expression:
    """Return the stem where its motion (-1, 0, 1) is a given number."""
    if shape.valve == "ideal":
        return u
    moves = motion * motion
    return (1 - moves) * x_last + moves * (u - motion * c.offset)


def plant_step(c: Coefficients, y: Expression, near: Expression, far: Expression) -> Expression:
    """Return y_{k+1} from y_k, near = v_{k-m} and far = v_{k-m-1} (exact zero-order hold)."""
    return c.pole * y + c.gain * (c.c0 * near + c.c1 * far)


def held(time_constant: Expression, share: Expression) -> tuple[Expression, Expression, Expression]:
    """Return (pole, c0, c1) of a first-order plant under a zero-order hold, all times in samples.

    share: what the dead time has beyond whole samples, 0 to 1.
    """
    pole, part = ca.exp(-1.0 / time_constant), ca.exp(-(1.0 - share) / time_constant)
    return pole, 1.0 - part, part - pole


def _split(column: Any) -> Coefficients:
    return Coefficients(*[column[i] for i in range(len(COEFFICIENTS))])


def controller_function(shape: Shape) -> ca.Function:
    """Return the controller's sample: (coefficients, I, D, s_{k-1}, r, y) -> (u, I, D, s, code of limit and undone)."""
    c, i, d, s, r, y = (ca.SX.sym(*a) for a in (("c", len(COEFFICIENTS)), ("i",), ("d",), ("s",), ("r",), ("y",)))
    a = action(shape, _split(c), i, d, s, r, y)
    out, code = limited_by_law(shape, _split(c), a, i)
    return ca.Function("controller", [c, i, d, s, r, y], [out.u, out.i, a.d, a.s, code])


def valve_function(shape: Shape) -> ca.Function:
    """Return the valve's sample: (coefficients, u, u_{k-1}, x_{k-1}, motion) -> (x, motion)."""
    c, u, u_last, x, motion = (
        ca.SX.sym(*a) for a in (("c", len(COEFFICIENTS)), ("u",), ("u_last",), ("x",), ("motion",))
    )
    stem, new = valve_by_law(shape, _split(c), u, u_last, x, motion)
    return ca.Function("valve", [c, u, u_last, x, motion], [stem, new])


def plant_function() -> ca.Function:
    """Return the plant's sample: (coefficients, y_k, v_{k-m}, v_{k-m-1}) -> y_{k+1}."""
    c, y, near, far = (ca.SX.sym(*a) for a in (("c", len(COEFFICIENTS)), ("y",), ("near",), ("far",)))
    return ca.Function("plant", [c, y, near, far], [plant_step(_split(c), y, near, far)])


def _symbols(shape: Shape) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    return (
        ca.SX.sym("state", len(STATE)),
        ca.SX.sym("past", shape.delay + 1),
        ca.SX.sym("c", len(COEFFICIENTS)),
        ca.SX.sym("r"),
        ca.SX.sym("load"),
        ca.SX.sym("noise"),
    )


def _moved_on(
    shape: Shape, c: Coefficients, past: ca.SX, y: ca.SX, x: ca.SX, load: ca.SX
) -> tuple[Expression, Expression]:
    """Return y_{k+1} and the new past, v_k first."""
    inputs = ca.vertcat(x + load, past)
    return plant_step(c, y, inputs[shape.delay], inputs[shape.delay + 1]), inputs[: shape.delay + 1]


def law_function(shape: Shape) -> ca.Function:
    """Return one sample of the loop, decisions taken by the law.

    (state, past, coefficients, r, load, noise) -> (state, past, u, x, branch), branch coded as in `simulate.kernel`.
    """
    state, past, column, r, load, noise = _symbols(shape)
    i, d, s, u_last, x_last, motion, y = (state[k] for k in range(len(STATE)))
    c = _split(column)
    a = action(shape, c, i, d, s, r, y + noise)
    out, code = limited_by_law(shape, c, a, i)
    x, new = valve_by_law(shape, c, out.u, u_last, x_last, motion)
    after, moved = _moved_on(shape, c, past, y, x, load)
    return ca.Function(
        "law",
        [state, past, column, r, load, noise],
        [ca.vertcat(out.i, a.d, a.s, out.u, x, new, after), moved, out.u, x, new + 1 + code],
    )


def given_function(shape: Shape) -> ca.Function:
    """Return one sample of the loop, decisions given: smooth in state, past and coefficients.

    (state, past, coefficients, r, load, noise, motion, limit, undone) -> (state, past, u, x, guards of shape (5,)),
    the guards as named by `GUARDS`.
    """
    state, past, column, r, load, noise = _symbols(shape)
    motion, limit, undone = ca.SX.sym("motion"), ca.SX.sym("limit"), ca.SX.sym("undone")
    i, d, s, u_last, x_last, _, y = (state[k] for k in range(len(STATE)))
    c = _split(column)
    a = action(shape, c, i, d, s, r, y + noise)
    out = limited_as_given(shape, c, a, i, limit, undone)
    x = valve_as_given(shape, c, out.u, x_last, motion)
    after, moved = _moved_on(shape, c, past, y, x, load)
    guards = ca.vertcat(out.u - x_last, out.u - u_last, a.first, a.step, out.after)
    return ca.Function(
        "given",
        [state, past, column, r, load, noise, motion, limit, undone],
        [ca.vertcat(out.i, a.d, a.s, out.u, x, motion, after), moved, out.u, x, guards],
    )


def given_run_function(shape: Shape, samples: int) -> ca.Function:
    """Return a whole run of N samples, decisions given.

    (state, past, coefficients, r, load, noise, motion, limit, undone), the last six of shape (1, N), -> (states after
    each sample, shape (7, N), u (1, N), x (1, N), guards (5, N)).
    """
    step = given_function(shape)
    state, past, column, r, load, noise = _symbols(shape)
    motion, limit, undone = ca.SX.sym("motion"), ca.SX.sym("limit"), ca.SX.sym("undone")
    new, moved, u, x, guards = step(state, past, column, r, load, noise, motion, limit, undone)
    one = ca.Function(
        "one",
        [ca.vertcat(state, past), column, ca.vertcat(r, load, noise, motion, limit, undone)],
        [ca.vertcat(new, moved), ca.vertcat(new, u, x, guards)],
    )
    chain = one.mapaccum("chain", samples)
    state0, past0 = ca.MX.sym("state", len(STATE)), ca.MX.sym("past", shape.delay + 1)
    c = ca.MX.sym("c", len(COEFFICIENTS))
    rows = [ca.MX.sym(name, 1, samples) for name in ("r", "load", "noise", "motion", "limit", "undone")]
    _, kept = chain(ca.vertcat(state0, past0), ca.repmat(c, 1, samples), ca.vertcat(*rows))
    n = len(STATE)
    return ca.Function(
        "given_run", [state0, past0, c, *rows], [kept[:n, :], kept[n, :], kept[n + 1, :], kept[n + 2 :, :]]
    )
