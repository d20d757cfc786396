"""The one kernel: a sampled loop of PID controller, sticky valve and plant with fractional dead time, as plain floats.

The order of operations is fixed: sticky loops are chaotic, and rounding decides slips. `kernel == kernel.py_func` to
the bit.

A loop is a row of `COEFFICIENTS` floats (see the names below), a state is `STATES` floats, and the plant input's past
`past[i] = v_{-1-i}`. For each sample k the law is

1. y_k measured = plant output + noise, e_k = r_k - y_k
2. u_k = bias + P + I + D, `P = Kc (b r - y)`, `I += (Kc Ts/Ti) e`, `D = (Tf D + Kc Td (s - s_{k-1}))/(Tf + Ts)`,
   s = e or -y
3. output limits; clamping undoes this sample's I step where u is outside and the step pushes further out; back-
   calculation adds `(Ts/Tt)(u_limited - u)` to I; a compensator (model.compensator) changes the I step, or u after
   this; then OP's resolution q: a u that stands at no limit becomes `bias + q rint((u - bias)/q)`, halves to even, and
   at most the limit; I and D know nothing of it. All of 1 to 3 in every n-th sample only where the controller scans (Ts
   is then its own); between them u and its code stand
4. the valve (model.valve); 5. the plant's exact zero-order-hold step with v = x + load, or `(e^(c x) - 1)/c + load`
   where the characteristic curves (c not 0). All in OP's direction: behind a fail-open valve gain and load change sign.

`branch` codes the decisions of each sample: `stem + 3 (limit + 1) + 9 undone`, where stem is 0, 1 or 2 for a stem that
moves down, rests or moves up, limit is -1, 0 or 1 for an output at its low limit, free or at its high limit, and undone
is 1 where clamping undid the I step. An ideal valve codes as at rest.

What is made of the law stands beside it: the sums of a run that objectives weigh (`sums`), many runs side by side
(`batch_kernel`), very long ones from slip to slip (`events`), one loop in another (`cascade_kernel`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled, specialised, written_out

__all__ = [
    "COEFFICIENTS",
    "STATES",
    "flow",
    "place",
    "run_inline",
    "run_loop",
    "run_samples",
    "shown",
    "sign",
    "usual",
    "valve_path",
    "valve_step",
]

Floats = NDArray[np.float64]

# Columns of a coefficient row.
KC, KI, KD, TF, TF_TS, WEIGHT, ON_PV, BIAS, LOW, HIGH, WINDUP, TS_TT = range(12)
VALVE, BAND, OFFSET, POLE, GAIN, C0, C1, DELAY, BAND_DOWN, OFFSET_DOWN = range(12, 22)
COMPENSATOR, SIZE, EVERY, WIDTH, LEVEL, EXTRA, RESOLUTION, CURVE, SCAN, PLACES = range(22, 32)
COEFFICIENTS = 32
# KC signed gain; KI = Kc Ts/Ti; KD = Kc Td; TF_TS = Tf + Ts; ON_PV 1 for derivative on PV; WINDUP 0 clamp,
# 1 back-calculation.
# VALVE one of those below; BAND the lead u - x beyond which the stem slips, OFFSET the lead that it keeps while it
# moves: both upward, downward the last two columns (the same but for DIRECTIONAL); POLE a, 1 for integrating; GAIN K,
# or K Ts for integrating; C0, C1 the shares of v_{k-m} and v_{k-m-1}; DELAY m. RESOLUTION of OP, %, 0 for none.
# CURVE c of the characteristic, 0 for none. SCAN n, samples from one execution of the controller to the next.
# PLACES: how many positions the valve's table has that follows the row: these, then a band each, then an offset each.
# STAIRS sticks again after each sample's slip (Stenman, He). TWO_PARAMETER goes on moving (Choudhury, dead band), and
# so do KANO, whose band lies OFFSET lower until its first move, and DIRECTIONAL.
IDEAL, STAIRS, TWO_PARAMETER, KANO, DIRECTIONAL, KARNOPP = range(6)
# KARNOPP: what follows the row, in % of travel: the number of substeps a sample and their length h (s), h k/m,
# 1 + h Fv/m + h^2 k/m, Coulomb and static friction over the spring, Stribeck velocity and that below which a stem stops
# (%/s).
SUBSTEPS, H, PUSH, DAMPING, SLIDING, STATIC, STRIBECK, SLOW = range(8)
# COMPENSATOR one of those below. SIZE: a reset band (EU), else an amplitude (%). EVERY, WIDTH in samples: a period and
# a pulse's length, of TWO_MOVES the sample of the first. LEVEL: of RESET_BAND the share of the integral action that is
# left, of TWO_MOVES the steady output (%), EXTRA the error that releases it (EU). A SINE starts from (SIZE, WIDTH), a
# times sine and cosine of half a sample's angle, and turns by the angle of sine EXTRA and cosine LEVEL.
NONE, RESET_BAND, KNOCKER, REINFORCEMENT, TWO_MOVES, SINE, SQUARE = range(7)

# Entries of a state.
I_TERM, D_TERM, S_LAST, U_LAST, X_LAST, MOTION, Y, CLOCK, MARK, KEPT, PHASE, CODE, VELOCITY = range(13)
STATES = 13
# CLOCK, MARK, KEPT: a compensator's, see `_compensated`. PHASE: samples since the controller's last execution, CODE:
# what that one decided (branch, stem aside); both where the controller scans. VELOCITY of KARNOPP's stem, %/s.
# MOTION: -1 down, 0 at rest, 1 up; a stem of KANO's that has moved before rests as RESTED.
RESTED = 2


@specialised
def valve_step(
    kind: int,
    band: float,
    offset: float,
    band_down: float,
    offset_down: float,
    u: float,
    u_last: float,
    x: float,
    motion: int,
) -> tuple[float, int]:
    """One sample of a valve: the new stem position and motion (see MOTION; STAIRS: of this slip)."""
    if kind == STAIRS:
        if abs(u - x) <= band:
            return x, 0
        return (u - offset, 1) if u > x else (u + offset, -1)
    if kind == TWO_PARAMETER:
        if motion != 0 and (u - u_last) * motion > 0.0:
            return u - motion * offset, motion
        if abs(u - x) > band:
            motion = 1 if u > x else -1
            return u - motion * offset, motion
        return x, 0
    if kind >= KANO:
        if abs(motion) == 1 and (u - u_last) * motion > 0.0:
            return (u - offset if motion == 1 else u + offset_down), motion
        lower = offset if kind == KANO and motion == 0 else 0.0
        if u - x > band - lower:
            return u - offset, 1
        if x - u > band_down + lower:
            return u + offset_down, -1
        return x, RESTED if kind == KANO and motion != 0 else 0
    return u, 0


@compiled
def flow(curve: float, x: float) -> float:
    """What a stem gives the plant; math.expm1, as numpy's own may round otherwise than compiled code."""
    return math.expm1(curve * x) / curve if curve != 0.0 else x


@compiled
def _level(u: float, resolution: float, bias: float, low: float, high: float) -> float:
    """An output within its limits at its resolution: the nearest level counted from `bias`, or the limit before it."""
    level = bias + resolution * np.rint((u - bias) / resolution)
    return float(min(max(level, low), high))


@compiled
def shown(c: Floats, u: float) -> float:
    """An output within its limits as the valve sees it."""
    return _level(u, c[RESOLUTION], c[BIAS], c[LOW], c[HIGH]) if c[RESOLUTION] > 0.0 else u


@compiled
def place(c: Floats, x: float) -> tuple[float, float]:
    """Band and offset of a stem at x, from the table that follows the row."""
    n = int(c[PLACES])
    at = COEFFICIENTS
    last = at + n - 1
    if x <= c[at] or n == 1:
        return c[at + n], c[at + 2 * n]
    if x >= c[last]:
        return c[last + n], c[last + 2 * n]
    while x > c[at + 1]:
        at += 1
    share = (x - c[at]) / (c[at + 1] - c[at])
    band = c[at + n] + share * (c[at + n + 1] - c[at + n])
    return band, c[at + 2 * n] + share * (c[at + 2 * n + 1] - c[at + 2 * n])


@compiled
def _slide(c: Floats, state: Floats, u: float, x: float) -> tuple[float, int]:
    """One sample of a stem with mass: its position at the sample's end, and the direction of its move."""
    at = COEFFICIENTS
    h, push, damping, slow = c[at + H], c[at + PUSH], c[at + DAMPING], c[at + SLOW]
    sliding, more, stribeck = c[at + SLIDING], c[at + STATIC] - c[at + SLIDING], c[at + STRIBECK]
    hold, speed, begin = c[BAND], state[VELOCITY], x
    for _ in range(int(c[at + SUBSTEPS])):
        lead = u - x
        if speed == 0.0:
            if abs(lead) <= hold:
                break
            way = 1.0 if lead > 0.0 else -1.0
        else:
            way = 1.0 if speed > 0.0 else -1.0
        friction = sliding + more * math.exp(-((speed / stribeck) * (speed / stribeck)))
        new = (speed + push * (lead - way * friction)) / damping
        if speed != 0.0 and new * way < slow and abs(lead) <= hold:
            speed = 0.0
            break
        # A stem that turns stands for a substep.
        speed = new if new * way > 0.0 else 0.0
        x += h * speed
    state[VELOCITY] = speed
    return x, 1 if x > begin else (-1 if x < begin else 0)


@compiled
def _stem(c: Floats, state: Floats, u: float, u_last: float, x: float, motion: int) -> tuple[float, int]:
    """One sample of a valve of any kind: the new stem position and motion."""
    kind = int(c[VALVE])
    if kind == KARNOPP:
        return _slide(c, state, u, x)
    if c[PLACES] == 0.0:
        return valve_step(kind, c[BAND], c[OFFSET], c[BAND_DOWN], c[OFFSET_DOWN], u, u_last, x, motion)
    band, offset = place(c, x)
    new, motion = valve_step(kind, band, offset, band, offset, u, u_last, x, motion)
    # Where friction grows along the way a moving stem waits for its input.
    return (x if (new - x) * motion < 0.0 else new), motion


@compiled
def valve_path(c: Floats, op: Floats, state: Floats, x: Floats) -> None:
    """Write into `x` the stem's path under a given output, from `state`, which is left as after it."""
    u_last, x_last, motion = state[U_LAST], state[X_LAST], int(state[MOTION])
    for k in range(op.size):
        u = op[k]
        x_last, motion = _stem(c, state, u, u_last, x_last, motion)
        x[k] = x_last
        u_last = u
    state[U_LAST], state[X_LAST], state[MOTION] = u_last, x_last, motion


@compiled
def sign(value: float) -> float:
    """1, 0 or -1."""
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)


@compiled
def _compensated(c: Floats, state: Floats, e: float, out: float, others: float, i_term: float) -> tuple[float, float]:
    """The OP that the valve sees, and the integral, for the PID law's own output `out` (model.compensator).

    others: all terms of `out` but the integral. CLOCK counts samples: since a period or the run began. MARK: u_c of
    the sample before (REINFORCEMENT) or of the latest pulse's onset (KNOCKER), the level held (TWO_MOVES), the sine
    (SINE). KEPT: u_c at the running pulse's onset, 1 while held and 2 from then on, the cosine.
    """
    kind, clock, every = int(c[COMPENSATOR]), state[CLOCK], c[EVERY]
    added = 0.0
    if kind == KNOCKER:
        if clock == 0.0:
            state[MARK] = out
        if clock == every:
            state[KEPT] = out
        if clock >= every:
            added = c[SIZE] * sign(out - state[MARK])
            if clock == every + c[WIDTH] - 1.0:
                state[MARK] = state[KEPT]
                clock -= every
    elif kind == REINFORCEMENT:
        added = c[SIZE] * sign(out - (c[BIAS] if clock == 0.0 else state[MARK]))
        state[MARK] = out
    elif kind == SQUARE:
        added = c[SIZE] if 2.0 * clock < every else -c[SIZE]
        clock = -1.0 if clock == every - 1.0 else clock
    elif kind == SINE:
        if clock == 0.0:
            state[MARK], state[KEPT] = c[SIZE], c[WIDTH]
        added = state[MARK]
        state[MARK] = added * c[LEVEL] + state[KEPT] * c[EXTRA]
        state[KEPT] = state[KEPT] * c[LEVEL] - added * c[EXTRA]
        clock = -1.0 if clock == every - 1.0 else clock
    elif state[KEPT] == 1.0:
        # Held: the integral follows, so that the controller goes on from here when it is released.
        out = state[MARK]
        i_term = out - others
        state[KEPT] = 2.0 if abs(e) > c[EXTRA] else 1.0
    elif clock == every:
        state[KEPT], state[MARK] = 1.0, min(max(c[LEVEL], c[LOW]), c[HIGH])
        added = abs(out - c[LEVEL]) + c[SIZE]
    state[CLOCK] = clock + 1.0
    return min(max(out + added, c[LOW]), c[HIGH]), i_term


@written_out
def run_samples(
    c: Floats,
    r: Floats,
    load: Floats,
    noise: Floats,
    state: Floats,
    past: Floats,
    y: Floats,
    u: Floats,
    x: Floats,
    v: Floats,
    branch: NDArray[np.int8],
    plain: bool,
) -> None:
    """`run_loop`, without what few loops have (see `run_inline`) where `plain`.

    Two loops from one source: to ask at every sample for what few loops have would cost all the others.
    """
    kc, ki, kd, tf, tf_ts = c[KC], c[KI], c[KD], c[TF], c[TF_TS]
    weight, on_pv, bias = c[WEIGHT], c[ON_PV] != 0.0, c[BIAS]
    low, high, back, ts_tt = c[LOW], c[HIGH], c[WINDUP] != 0.0, c[TS_TT]
    kind, band, offset, band_down, offset_down = int(c[VALVE]), c[BAND], c[OFFSET], c[BAND_DOWN], c[OFFSET_DOWN]
    a, gain, c0, c1, m = c[POLE], c[GAIN], c[C0], c[C1], int(c[DELAY])
    n = u.size
    i_term, d_term, s_last, u_last, x_last = state[I_TERM], state[D_TERM], state[S_LAST], state[U_LAST], state[X_LAST]
    motion = int(state[MOTION])
    plant = state[Y]
    y[0] = plant
    for k in range(n):
        if not plain:
            i_before, d_before, s_before = i_term, d_term, s_last
        measured = plant + noise[k]
        e = r[k] - measured
        s = -measured if on_pv else e
        if kd != 0.0 or d_term != 0.0:
            d_term = (tf * d_term + kd * (s - s_last)) / tf_ts
        s_last = s
        p_term = kc * (weight * r[k] - measured)
        step = ki * e
        if not plain and c[COMPENSATOR] == RESET_BAND and abs(e) <= c[SIZE]:
            step *= c[LEVEL]
        i_last = i_term
        i_term = i_last + step
        out = bias + p_term + i_term + d_term
        limit, undone = 0, 0
        if not back and ((out > high and step > 0.0) or (out < low and step < 0.0)):
            undone = 1
            i_term = i_last
            out = bias + p_term + i_term + d_term
        if out > high:
            limit = 1
        elif out < low:
            limit = -1
        if limit != 0:
            limited = high if limit == 1 else low
            if back:
                i_term += ts_tt * (limited - out)
            out = limited
        if not plain and c[COMPENSATOR] > RESET_BAND and (c[SCAN] <= 1.0 or state[PHASE] == 0.0):
            out, i_term = _compensated(c, state, e, out, bias + p_term + d_term, i_term)
        if not plain and c[RESOLUTION] > 0.0 and low < out < high:
            out = shown(c, out)
        if not plain and c[SCAN] > 1.0:
            if state[PHASE] == 0.0:
                state[CODE] = 3 * (limit + 1) + 9 * undone
            else:
                i_term, d_term, s_last, out = i_before, d_before, s_before, u_last
                limit, undone = int(state[CODE]) % 9 // 3 - 1, int(state[CODE]) // 9
            state[PHASE] = (state[PHASE] + 1.0) % c[SCAN]
        if plain:
            x_last, motion = valve_step(kind, band, offset, band_down, offset_down, out, u_last, x_last, motion)
        else:
            x_last, motion = _stem(c, state, out, u_last, x_last, motion)
        u_last = out
        u[k] = out
        x[k] = x_last
        v[k] = (x_last if plain else flow(c[CURVE], x_last)) + load[k]
        branch[k] = (1 if motion == RESTED else motion + 1) + 3 * (limit + 1) + 9 * undone
        near = v[k - m] if k >= m else past[m - k - 1]
        far = v[k - m - 1] if k > m else past[m - k]
        plant = a * plant + gain * (c0 * near + c1 * far)
        y[k + 1] = plant
    state[I_TERM], state[D_TERM], state[S_LAST], state[U_LAST], state[X_LAST] = i_term, d_term, s_last, u_last, x_last
    state[MOTION] = motion
    state[Y] = plant
    length = past.size
    for i in range(length - 1, -1, -1):
        past[i] = v[n - 1 - i] if n - 1 - i >= 0 else past[i - n]


@compiled
def _plain(
    c: Floats,
    r: Floats,
    load: Floats,
    noise: Floats,
    state: Floats,
    past: Floats,
    y: Floats,
    u: Floats,
    x: Floats,
    v: Floats,
    branch: NDArray[np.int8],
) -> None:
    run_samples(c, r, load, noise, state, past, y, u, x, v, branch, True)


@compiled
def _special(
    c: Floats,
    r: Floats,
    load: Floats,
    noise: Floats,
    state: Floats,
    past: Floats,
    y: Floats,
    u: Floats,
    x: Floats,
    v: Floats,
    branch: NDArray[np.int8],
) -> None:
    run_samples(c, r, load, noise, state, past, y, u, x, v, branch, False)


@compiled
def usual(c: Floats) -> bool:
    """Whether a loop has nothing that few loops have (see `run_inline`)."""
    usual = c[COMPENSATOR] == NONE and c[RESOLUTION] == 0.0 and c[SCAN] <= 1.0
    return bool(usual and c[CURVE] == 0.0 and c[PLACES] == 0.0 and c[VALVE] < KARNOPP)


@written_out
def run_inline(
    c: Floats,
    r: Floats,
    load: Floats,
    noise: Floats,
    state: Floats,
    past: Floats,
    y: Floats,
    u: Floats,
    x: Floats,
    v: Floats,
    branch: NDArray[np.int8],
) -> None:
    """`run_loop` for the kernel's own use: a call of it costs as much as some samples, which this saves."""
    if usual(c):
        _plain(c, r, load, noise, state, past, y, u, x, v, branch)
    else:
        _special(c, r, load, noise, state, past, y, u, x, v, branch)


@compiled
def run_loop(
    c: Floats,
    r: Floats,
    load: Floats,
    noise: Floats,
    state: Floats,
    past: Floats,
    y: Floats,
    u: Floats,
    x: Floats,
    v: Floats,
    branch: NDArray[np.int8],
) -> None:
    """Run N = u.size samples of one loop from `state`, and leave the state after them in `state` and `past`.

    r, load, noise: at least N values; past: at least m + 1. Written: y (N + 1, the plant's true output) and u, x, v,
    branch (N each). Sample N's output y[N] is in the state; its controller action is the next run's first.
    """
    run_inline(c, r, load, noise, state, past, y, u, x, v, branch)
