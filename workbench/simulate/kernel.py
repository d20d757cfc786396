"""The one kernel: a sampled loop of PID controller, sticky valve and plant with fractional dead time, as plain floats.

Everything that is compiled together lives in this file (numba's cache does not see changes elsewhere). The order of
operations is fixed: sticky loops are chaotic, and rounding decides slips. `kernel == kernel.py_func` to the bit.

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

`run_costs` and `run_worst` run many: where these are of one plain loop under several tunings, side by side in `LANES`.
`run_events` runs the same law for very long times: while the stem rests the loop is linear with a constant input, and
is taken from slip to slip in closed form.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled, copy, specialised, written_out

__all__ = [
    "CARRIED",
    "CHAIN",
    "COEFFICIENTS",
    "FEW_SUMS",
    "HALF_CYCLE",
    "SCRATCH",
    "STATES",
    "SUMS",
    "WEIGHTS",
    "add_sums",
    "cascade_worst",
    "collect",
    "doublings",
    "jump",
    "run_cascade",
    "run_costs",
    "run_events",
    "run_loop",
    "run_samples",
    "run_worst",
    "trace",
    "valve_path",
    "valve_step",
    "weigh",
    "weigh_all",
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

# Columns of a run's sums over e_k = r_k - y_k (measured), u_k and x_k: squares of e_1..e_N, of u, of e_N, of moves of u
# and of e_0..e_{N-1}; |moves of x|; where all are asked for, |e|, e, u, |moves of u|, x, x^2, stem reversals, y, y^2.
ERROR2, OP2, FINAL2, MOVES2, WINDOW2, TRAVEL, IAE, ERROR, OP, OP_TRAVEL, STEM, STEM2, REVERSALS, PV, PV2 = range(15)
FEW_SUMS, SUMS = 6, 15
# Weights of an objective: of the first four sums, which is eq. (2), then of WINDOW2, TRAVEL, IAE, OP_TRAVEL, REVERSALS,
# of the variances of e, u and x, and of the standard deviation of y.
WEIGHTS = 13

# Runs side by side (see `_abreast`): so many lanes, and where each number of theirs begins in a flat array: what a
# tuning's row has of its own, the state, this sample's proportional term and integral step, and the sums.
LANES = 16
ABREAST = 20 * LANES
_KC, _KI, _KD, _TF, _TF_TS, _WEIGHT, _I, _D, _S, _U, _X, _MOTION, _Y = range(0, 13 * LANES, LANES)
_P, _STEP, _ERROR2, _OP2, _MOVES2, _WINDOW2, _TRAVEL = range(13 * LANES, ABREAST, LANES)
# Below so many runs the idle lanes cost more than the others save.
WORTH_LANES = 5
# Samples of a search's runs at a time: so long that the bookkeeping between costs little, so short as to stop early.
CHUNK = 64

# Entries of a state.
I_TERM, D_TERM, S_LAST, U_LAST, X_LAST, MOTION, Y, CLOCK, MARK, KEPT, PHASE, CODE, VELOCITY = range(13)
STATES = 13
# CLOCK, MARK, KEPT: a compensator's, see `_compensated`. PHASE: samples since the controller's last execution, CODE:
# what that one decided (branch, stem aside); both where the controller scans. VELOCITY of KARNOPP's stem, %/s.
# MOTION: -1 down, 0 at rest, 1 up; a stem of KANO's that has moved before rests as RESTED.
RESTED = 2

# Columns of a half cycle [start, end) of the stem: sample numbers, extremes of PV and OP, sum of squared errors, stem
# travel, slips (breakaways from rest). Carried beside the one begun: the stem's last position that counted, its
# direction, and its motion in the sample before.
START, END, Y_HIGH, Y_LOW, U_HIGH, U_LOW, SQUARES, STEM_TRAVEL, SLIPS = range(9)
HALF_CYCLE = 9
STEM_AT, DIRECTION, MOTION_LAST = range(9, 12)
CARRIED = 12

# Columns of a table of doublings, or of one entry for n samples: n, a^n, sum_{i<n} a^i = W_n, sum_{i<n} W_i, sum_{i<n}
# W_i^2, q^n and sum_{i<n} q^(n-1-i) a^i, with the plant's pole a and the derivative filter's q.
SAMPLES, POWER, RISE, RISE_SUM, RISE2_SUM, FILTER, FILTER_SUM = range(7)
DOUBLINGS = 41
SCRATCH = (5, 7)
# Of a stretch at rest: what `_output` needs of the loop and of the state at its first sample.
Y_FIRST, E_FIRST, SLOPE, I_LAST, D_FIRST, BASE = range(6)
# How `run_events` ended: what was asked for is done, the stem rests for good, PV has left every bound.
DONE, RESTS, AWAY = range(3)


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
def _flow(curve: float, x: float) -> float:
    """What a stem gives the plant; math.expm1, as numpy's own may round otherwise than compiled code."""
    return math.expm1(curve * x) / curve if curve != 0.0 else x


@compiled
def _level(u: float, resolution: float, bias: float, low: float, high: float) -> float:
    """An output within its limits at its resolution: the nearest level counted from `bias`, or the limit before it."""
    level = bias + resolution * np.rint((u - bias) / resolution)
    return float(min(max(level, low), high))


@compiled
def _shown(c: Floats, u: float) -> float:
    """An output within its limits as the valve sees it."""
    return _level(u, c[RESOLUTION], c[BIAS], c[LOW], c[HIGH]) if c[RESOLUTION] > 0.0 else u


@compiled
def _place(c: Floats, x: float) -> tuple[float, float]:
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
    band, offset = _place(c, x)
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
def _sign(value: float) -> float:
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
            added = c[SIZE] * _sign(out - state[MARK])
            if clock == every + c[WIDTH] - 1.0:
                state[MARK] = state[KEPT]
                clock -= every
    elif kind == REINFORCEMENT:
        added = c[SIZE] * _sign(out - (c[BIAS] if clock == 0.0 else state[MARK]))
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
    """`run_loop`, without what few loops have (see `_run`) where `plain`.

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
            out = _shown(c, out)
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
        v[k] = (x_last if plain else _flow(c[CURVE], x_last)) + load[k]
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
def _usual(c: Floats) -> bool:
    """Whether a loop has nothing that few loops have (see `_run`)."""
    usual = c[COMPENSATOR] == NONE and c[RESOLUTION] == 0.0 and c[SCAN] <= 1.0
    return bool(usual and c[CURVE] == 0.0 and c[PLACES] == 0.0 and c[VALVE] < KARNOPP)


@written_out
def _run(
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
    if _usual(c):
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
    _run(c, r, load, noise, state, past, y, u, x, v, branch)


@compiled
def add_sums(
    sums: Floats, last: Floats, every: bool, r: Floats, noise: Floats, y: Floats, u: Floats, x: Floats
) -> None:
    """Add a stretch of a run to its sums (SUMS values; the first FEW_SUMS unless `every`).

    r, noise, y: one value more than u and x; last: u, x and the direction of the last stem move before the stretch, and
    after it.
    """
    u_last, x_last, direction = last[0], last[1], last[2]
    squares, outputs, moves, window, travel = sums[ERROR2], sums[OP2], sums[MOVES2], sums[WINDOW2], sums[TRAVEL]
    e = r[0] - (y[0] + noise[0])
    for k in range(u.size):
        window += e * e
        out, stem = u[k], x[k]
        if every:
            measured = y[k] + noise[k]
            sums[IAE] += abs(e)
            sums[ERROR] += e
            sums[OP] += out
            sums[OP_TRAVEL] += abs(out - u_last)
            sums[STEM] += stem
            sums[STEM2] += stem * stem
            sums[PV] += measured
            sums[PV2] += measured * measured
            if stem != x_last:
                way = 1.0 if stem > x_last else -1.0
                if direction != 0.0 and way != direction:
                    sums[REVERSALS] += 1.0
                direction = way
        e = r[k + 1] - (y[k + 1] + noise[k + 1])
        squares += e * e
        outputs += out * out
        moves += (out - u_last) * (out - u_last)
        travel += abs(stem - x_last)
        u_last = out
        x_last = stem
    sums[ERROR2], sums[OP2], sums[MOVES2], sums[WINDOW2], sums[TRAVEL] = squares, outputs, moves, window, travel
    sums[FINAL2] = e * e
    last[0], last[1], last[2] = u_last, x_last, direction


@compiled
def weigh(sums: Floats, weights: Floats, count: int, n: int) -> float:
    """J of the first `count` of n samples (see WEIGHTS); it never falls as samples are added.

    e_N counts once `count` is n. A weight of 0 leaves its sum out, whatever it is.
    """
    cost = 0.0
    for j in range(4):
        if weights[j] > 0.0 and (j != FINAL2 or count == n):
            cost += weights[j] * sums[j]
    for j, column in ((4, WINDOW2), (5, TRAVEL), (6, IAE), (7, OP_TRAVEL), (8, REVERSALS)):
        if weights[j] > 0.0:
            cost += weights[j] * sums[column]
    for j, mean, square in ((9, ERROR, WINDOW2), (10, OP, OP2), (11, STEM, STEM2), (12, PV, PV2)):
        if weights[j] > 0.0:
            # The sum of squares about the mean so far; max would pass over a nan.
            spread = (sums[square] - sums[mean] * sums[mean] / count) / n
            spread = 0.0 if spread < 0.0 else spread
            cost += weights[j] * (np.sqrt(spread) if j == 12 else spread)
    return cost


@compiled
def weigh_all(sums: Floats, weights: Floats, n: int, costs: Floats) -> None:
    """J of whole runs of n samples from their sums, a row each; inf where a run overflowed."""
    for i in range(costs.size):
        cost = weigh(sums[i], weights, n, n)
        costs[i] = cost if np.isfinite(cost) else np.inf


@written_out
def _abreast(
    c: Floats, r: Floats, load: Floats, noise: Floats, lanes: Floats, v: Floats, kind: int, first: bool
) -> None:
    """r.size samples of LANES plain runs side by side: `run_samples` and `add_sums` in the same order of operations.

    The compiler makes vector instructions of the loops over lanes, each lane rounded as if it ran alone. For that, each
    decision is a choice between two values, all numbers of the lanes are in one array at constant distances, and the
    loops are two, as a single one would read inputs of the plant that it might itself have written. c: the row of what
    all lanes share; v: the plant's inputs of samples -m-2 .. r.size-1, LANES of each, moved up at the end for the next
    stretch; the plant's output in `lanes` is the last sample's. kind: STAIRS or TWO_PARAMETER; first: whether the runs
    begin here.
    """
    on_pv, bias, low, high = c[ON_PV] != 0.0, c[BIAS], c[LOW], c[HIGH]
    band, offset, band_down, offset_down = c[BAND], c[OFFSET], c[BAND_DOWN], c[OFFSET_DOWN]
    a, gain, c0, c1, m = c[POLE], c[GAIN], c[C0], c[C1], int(c[DELAY])
    if c[VALVE] == IDEAL:
        # Stairs of any height: the stem is where the input is.
        band, offset = -1.0, 0.0
    for k in range(r.size):
        r_now, load_now, noise_now = r[k], load[k], noise[k]
        # Views: an index that may be negative would be looked at for each lane.
        far, near, now = v[k * LANES :], v[(k + 1) * LANES :], v[(k + m + 2) * LANES :]
        for j in range(LANES):
            plant = a * lanes[_Y + j] + gain * (c0 * near[j] + c1 * far[j])
            measured = plant + noise_now
            e = r_now - measured
            s = -measured if on_pv else e
            kd, d_last = lanes[_KD + j], lanes[_D + j]
            d_term = (lanes[_TF + j] * d_last + kd * (s - lanes[_S + j])) / lanes[_TF_TS + j]
            lanes[_D + j] = d_term if kd != 0.0 or d_last != 0.0 else d_last
            lanes[_Y + j], lanes[_S + j], lanes[_STEP + j] = plant, s, lanes[_KI + j] * e
            lanes[_P + j] = lanes[_KC + j] * (lanes[_WEIGHT + j] * r_now - measured)
            lanes[_ERROR2 + j] += e * e
            lanes[_WINDOW2 + j] += e * e
        for j in range(LANES):
            step, i_last, others = lanes[_STEP + j], lanes[_I + j], bias + lanes[_P + j]
            i_term, d_term = i_last + step, lanes[_D + j]
            out = others + i_term + d_term
            undone = (out > high and step > 0.0) or (out < low and step < 0.0)
            i_term = i_last if undone else i_term
            out = others + i_term + d_term if undone else out
            out = high if out > high else (low if out < low else out)
            u_last, x_last = lanes[_U + j], lanes[_X + j]
            motion = 0 if kind == STAIRS else int(lanes[_MOTION + j])
            x, motion = valve_step(kind, band, offset, band_down, offset_down, out, u_last, x_last, motion)
            lanes[_I + j], lanes[_U + j], lanes[_X + j], lanes[_MOTION + j] = i_term, out, x, motion
            lanes[_OP2 + j] += out * out
            lanes[_MOVES2 + j] += (out - u_last) * (out - u_last)
            lanes[_TRAVEL + j] += abs(x - x_last)
            now[j] = x + load_now
        if first and k == 0:
            # J counts the errors from sample 1 on.
            lanes[_ERROR2 : _ERROR2 + LANES] = 0.0
    for i in range((m + 2) * LANES):
        v[i] = v[r.size * LANES + i]


@compiled
def _stairs_abreast(c: Floats, r: Floats, load: Floats, noise: Floats, lanes: Floats, v: Floats, first: bool) -> None:
    _abreast(c, r, load, noise, lanes, v, STAIRS, first)


@compiled
def _two_parameter_abreast(
    c: Floats, r: Floats, load: Floats, noise: Floats, lanes: Floats, v: Floats, first: bool
) -> None:
    _abreast(c, r, load, noise, lanes, v, TWO_PARAMETER, first)


@compiled
def _step_abreast(c: Floats, r: Floats, load: Floats, noise: Floats, lanes: Floats, v: Floats, first: bool) -> None:
    if c[VALVE] == TWO_PARAMETER:
        _two_parameter_abreast(c, r, load, noise, lanes, v, first)
    else:
        _stairs_abreast(c, r, load, noise, lanes, v, first)


@compiled
def _fits_abreast(c: Floats) -> bool:
    """Whether `_abreast` knows what a loop has."""
    return _usual(c) and c[VALVE] <= TWO_PARAMETER and c[WINDUP] == 0.0


@compiled
def _alike(c: Floats, other: Floats) -> bool:
    """Whether two rows differ at most in what a lane has of its own."""
    differ = 0
    for j in range(ON_PV, COEFFICIENTS):
        differ += 1 if c[j] != other[j] and j != TS_TT else 0
    return differ == 0


@compiled
def _enter(c: Floats, lanes: Floats, j: int) -> None:
    """Put a run at rest into lane j."""
    for at in range(j, ABREAST, LANES):
        lanes[at] = 0.0
    lanes[_KC + j], lanes[_KI + j], lanes[_KD + j] = c[KC], c[KI], c[KD]
    lanes[_TF + j], lanes[_TF_TS + j], lanes[_WEIGHT + j] = c[TF], c[TF_TS], c[WEIGHT]
    lanes[_U + j] = c[BIAS]


@compiled
def _leave(c: Floats, lanes: Floats, v: Floats, j: int, r: float, noise: float, sums: Floats) -> None:
    """Write the sums of lane j so far, the error of the sample after included; r, noise: of that sample."""
    plant = c[POLE] * lanes[_Y + j] + c[GAIN] * (c[C0] * v[LANES + j] + c[C1] * v[j])
    e = r - (plant + noise)
    sums[ERROR2], sums[OP2], sums[FINAL2] = lanes[_ERROR2 + j] + e * e, lanes[_OP2 + j], e * e
    sums[MOVES2], sums[WINDOW2], sums[TRAVEL] = lanes[_MOVES2 + j], lanes[_WINDOW2 + j], lanes[_TRAVEL + j]


@compiled
def _run_abreast(rows: Floats, which: NDArray[np.int64], r: Floats, load: Floats, noise: Floats, sums: Floats) -> int:
    """Write the sums of as many of the first rows as fill the lanes, and return how many; 0 where they are too few."""
    used = 0
    if _fits_abreast(rows[0]):
        while used < min(LANES, rows.shape[0]) and which[used] == which[0] and _alike(rows[used], rows[0]):
            used += 1
    if used < WORTH_LANES:
        return 0
    n, m = r.size - 1, int(rows[0, DELAY])
    chunk = max(CHUNK, m + 2)
    lanes, v = np.zeros(ABREAST), np.zeros((chunk + m + 2) * LANES)
    for j in range(used):
        _enter(rows[j], lanes, j)
    for begin in range(0, n, chunk):
        end = min(begin + chunk, n)
        _step_abreast(rows[0], r[begin:end], load[begin:end], noise[begin:end], lanes, v, begin == 0)
    for j in range(used):
        _leave(rows[0], lanes, v, j, r[n], noise[n], sums[j])
    return used


@compiled
def run_costs(
    rows: Floats, which: NDArray[np.int64], r: Floats, load: Floats, noise: Floats, sums: Floats, longest: int
) -> None:
    """Sums of many loops from rest: row i of `rows` in experiment which[i] (a row of r, load, noise: N + 1 each).

    Written: sums[i], the first FEW_SUMS or all SUMS of them, as wide as it is. longest: the largest whole dead time m.
    """
    n = r.shape[1] - 1
    y = np.empty(n + 1)
    u = np.empty(n)
    x = np.empty(n)
    v = np.empty(n)
    branch = np.empty(n, np.int8)
    state = np.empty(STATES)
    past = np.empty(longest + 1)
    last = np.empty(3)
    every = sums.shape[1] > FEW_SUMS
    i = 0
    while i < rows.shape[0]:
        j = which[i]
        if not every:
            used = _run_abreast(rows[i:], which[i:], r[j], load[j], noise[j], sums[i:])
            if used > 0:
                i += used
                continue
        state[:] = 0.0
        state[U_LAST] = rows[i, BIAS]
        past[:] = 0.0
        _run(rows[i], r[j], load[j], noise[j], state, past, y, u, x, v, branch)
        last[0], last[1], last[2] = rows[i, BIAS], 0.0, 0.0
        sums[i] = 0.0
        add_sums(sums[i], last, every, r[j], noise[j], y, u, x)
        i += 1


@compiled
def _worst_abreast(
    rows: Floats,
    group: int,
    r: Floats,
    load: Floats,
    noise: Floats,
    weights: Floats,
    ceilings: Floats,
    worst: Floats,
    order: NDArray[np.int64],
    lost: NDArray[np.int64],
) -> int:
    """`run_worst` in lanes: the first member of each group, then the second of those that are left, and so on."""
    n, count, m = r.size - 1, worst.size, int(rows[0, DELAY])
    chunk = max(CHUNK, m + 2)
    lanes, v = np.zeros(ABREAST), np.zeros((chunk + m + 2) * LANES)
    sums, whose, member = np.zeros(SUMS), np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    worst[:] = 0.0
    samples, task = 0, 0
    while True:
        used = 0
        while used < LANES and task < group * count:
            i = task % count
            if worst[i] < np.inf:
                whose[used], member[used] = i, order[task // count]
                _enter(rows[i * group + member[used]], lanes, used)
                used += 1
            task += 1
        if used == 0:
            return samples
        v[: (m + 2) * LANES] = 0.0
        begin, running = 0, used
        while begin < n and running > 0:
            size = min(chunk, n - begin)
            end = begin + size
            _step_abreast(rows[0], r[begin:end], load[begin:end], noise[begin:end], lanes, v, begin == 0)
            running = 0
            for j in range(used):
                i = whose[j]
                if worst[i] == np.inf:
                    continue
                samples += size
                _leave(rows[0], lanes, v, j, r[end], noise[end], sums)
                cost = weigh(sums, weights, end, n)
                if not cost <= ceilings[i]:
                    worst[i] = np.inf
                    lost[member[j]] += 1
                elif end < n:
                    running += 1
                else:
                    worst[i] = max(worst[i], cost)
            begin = end


@compiled
def run_worst(
    rows: Floats,
    group: int,
    r: Floats,
    load: Floats,
    noise: Floats,
    weights: Floats,
    ceilings: Floats,
    worst: Floats,
    longest: int,
    order: NDArray[np.int64],
    lost: NDArray[np.int64],
) -> int:
    """The worst J in each group of `group` successive rows, from rest, as long as it stays below a ceiling.

    For searches that only ask whether a candidate beats what they have: a group is given up, and its worst is inf, as
    soon as a run's J so far has passed ceilings[i] or is nan. r, load, noise: N + 1 each; weights: WEIGHTS of them;
    ceilings and worst: one for each group; longest: the largest whole dead time m. order: in which the members of a
    group are run; lost: counts, by member, whose run gave a group up. All rows are of one loop but for its tuning.
    Returns the number of samples run.
    """
    n = r.size - 1
    chunk = max(CHUNK, longest + 1)
    y = np.empty(chunk + 1)
    u = np.empty(chunk)
    x = np.empty(chunk)
    v = np.empty(chunk)
    branch = np.empty(chunk, np.int8)
    state = np.empty(STATES)
    past = np.empty(longest + 1)
    last = np.empty(3)
    sums = np.empty(SUMS)
    every = weights[6:].max() > 0.0
    samples = 0
    if not every and worst.size * group >= WORTH_LANES and _fits_abreast(rows[0]):
        return _worst_abreast(rows, group, r, load, noise, weights, ceilings, worst, order, lost)
    for i in range(worst.size):
        worst[i] = 0.0
        for member in order:
            j = i * group + member
            state[:] = 0.0
            state[U_LAST] = rows[j, BIAS]
            past[:] = 0.0
            last[0], last[1], last[2] = rows[j, BIAS], 0.0, 0.0
            sums[:] = 0.0
            cost, begin = 0.0, 0
            while begin < n and cost <= ceilings[i]:
                size = min(chunk, n - begin)
                end = begin + size
                _run(
                    rows[j],
                    r[begin:end],
                    load[begin:end],
                    noise[begin:end],
                    state,
                    past,
                    y[: size + 1],
                    u[:size],
                    x[:size],
                    v[:size],
                    branch[:size],
                )
                add_sums(
                    sums, last, every, r[begin : end + 1], noise[begin : end + 1], y[: size + 1], u[:size], x[:size]
                )
                cost = weigh(sums, weights, end, n)
                begin = end
            samples += begin
            if not cost <= ceilings[i]:
                worst[i] = np.inf
                lost[member] += 1
                break
            worst[i] = max(worst[i], cost)
    return samples


@compiled
def collect(
    kind: int,
    y: Floats,
    u: Floats,
    x: Floats,
    branch: NDArray[np.int8],
    r: float,
    first: int,
    dust: float,
    carry: Floats,
    rows: Floats,
) -> int:
    """Write the half cycles that end within this stretch into `rows` (at least u.size of them); return how many.

    A half cycle runs from one reversal of the stem to the next, the first from the first move of all: a staircase of
    slips in one direction is one half cycle. Moves are counted once they add up to more than `dust` (%), so that
    rounding reverses nothing. `first` is the number of the stretch's first sample; `kind` the valve's. A slip is a move
    out of rest or against the motion before, and where the stem sticks at once (STAIRS) every move.
    """
    count = 0
    stem, direction, motion_last = carry[STEM_AT], carry[DIRECTION], carry[MOTION_LAST]
    y_high, y_low, u_high, u_low = carry[Y_HIGH], carry[Y_LOW], carry[U_HIGH], carry[U_LOW]
    squares, travel, slips = carry[SQUARES], carry[STEM_TRAVEL], carry[SLIPS]
    for k in range(u.size):
        move = x[k] - stem
        if abs(move) > dust:
            way = 1.0 if move > 0.0 else -1.0
            if way != direction:
                if direction != 0.0:
                    row = rows[count]
                    row[START], row[END] = carry[START], first + k
                    row[Y_HIGH], row[Y_LOW], row[U_HIGH], row[U_LOW] = y_high, y_low, u_high, u_low
                    row[SQUARES], row[STEM_TRAVEL], row[SLIPS] = squares, travel, slips
                    count += 1
                carry[START] = first + k
                y_high, y_low, u_high, u_low = -np.inf, np.inf, -np.inf, np.inf
                squares, travel, slips = 0.0, 0.0, 0.0
                direction = way
            travel += abs(move)
            stem = x[k]
        motion = branch[k] % 3 - 1.0
        if motion != 0.0 and (kind == STAIRS or motion != motion_last):
            slips += 1.0
        motion_last = motion
        y_high = max(y_high, y[k])
        y_low = min(y_low, y[k])
        u_high = max(u_high, u[k])
        u_low = min(u_low, u[k])
        squares += (r - y[k]) * (r - y[k])
    carry[STEM_AT], carry[DIRECTION], carry[MOTION_LAST] = stem, direction, motion_last
    carry[Y_HIGH], carry[Y_LOW], carry[U_HIGH], carry[U_LOW] = y_high, y_low, u_high, u_low
    carry[SQUARES], carry[STEM_TRAVEL], carry[SLIPS] = squares, travel, slips
    return count


@compiled
def _join(before: Floats, after: Floats, both: Floats) -> None:
    """The entry for the samples of two entries, one after the other: sums of positive terms, so that none cancel."""
    a, w, n = before[POWER], before[RISE], after[SAMPLES]
    both[SAMPLES] = before[SAMPLES] + n
    both[RISE2_SUM] = before[RISE2_SUM] + n * w * w + 2.0 * w * a * after[RISE_SUM] + a * a * after[RISE2_SUM]
    both[RISE_SUM] = before[RISE_SUM] + n * w + a * after[RISE_SUM]
    both[RISE] = w + a * after[RISE]
    both[FILTER_SUM] = after[FILTER] * before[FILTER_SUM] + a * after[FILTER_SUM]
    both[FILTER] = before[FILTER] * after[FILTER]
    both[POWER] = a * after[POWER]


@compiled
def doublings(c: Floats, table: Floats) -> None:
    """Fill the table, DOUBLINGS rows for 1, 2, 4, .. samples, of a loop's free motion.

    By products alone: equal or nearly equal poles, and poles near 1, lose nothing, and every machine gets the same.
    """
    a = c[POLE]
    q = c[TF] / c[TF_TS]
    # One by one, see `copy`.
    table[0, SAMPLES], table[0, POWER], table[0, RISE], table[0, RISE_SUM] = 1.0, a, 1.0, 0.0
    table[0, RISE2_SUM], table[0, FILTER], table[0, FILTER_SUM] = 0.0, q, 1.0
    for j in range(1, table.shape[0]):
        _join(table[j - 1], table[j - 1], table[j])


@compiled
def _begin(c: Floats, r: float, v: float, state: Floats, at: Floats) -> None:
    """What the next samples need while the plant's input stays v: PV, error and derivative of the first of them."""
    y = state[Y]
    e = r - y
    s = -y if c[ON_PV] != 0.0 else e
    d_term = state[D_TERM]
    if c[KD] != 0.0 or d_term != 0.0:
        d_term = (c[TF] * d_term + c[KD] * (s - state[S_LAST])) / c[TF_TS]
    at[Y_FIRST], at[E_FIRST], at[D_FIRST] = y, e, d_term
    at[SLOPE] = c[GAIN] * (c[C0] + c[C1]) * v - (1.0 - c[POLE]) * y
    at[I_LAST] = state[I_TERM]
    at[BASE] = c[BIAS] + c[KC] * c[WEIGHT] * r


@compiled
def _derivative(c: Floats, at: Floats, n: Floats) -> float:
    """D_n of a stretch at rest."""
    return float(n[FILTER] * at[D_FIRST] - c[KD] / c[TF_TS] * at[SLOPE] * n[FILTER_SUM])


@compiled
def _integral(c: Floats, at: Floats, n: Floats) -> float:
    """I_n of a stretch at rest, the step of sample n included."""
    e = at[E_FIRST] - at[SLOPE] * n[RISE]
    return float(at[I_LAST] + c[KI] * (n[SAMPLES] * at[E_FIRST] - at[SLOPE] * n[RISE_SUM] + e))


@compiled
def _output(c: Floats, at: Floats, n: Floats) -> float:
    """u_n of a stretch at rest."""
    y = at[Y_FIRST] + at[SLOPE] * n[RISE]
    return float(at[BASE] - c[KC] * y + _integral(c, at, n) + _derivative(c, at, n))


@compiled
def _room(c: Floats, state: Floats) -> tuple[float, float]:
    """The least and the largest output, resolution aside, at which the stem at rest stays and no limit is met."""
    x, q, bias = state[X_LAST], c[RESOLUTION], c[BIAS]
    lower = c[OFFSET] if c[VALVE] == KANO and state[MOTION] == 0.0 else 0.0
    down, up = c[BAND_DOWN] + lower, c[BAND] - lower
    if c[PLACES] > 0.0:
        up = _place(c, x)[0]
        down = up
    low, high = x - down, x + up
    if q > 0.0:
        # The last levels that hold the stem, by the very comparisons of `valve_step`, and half a level more.
        n = np.ceil((low - bias) / q)
        n += -1.0 if x - (bias + q * (n - 1.0)) <= down else (1.0 if x - (bias + q * n) > down else 0.0)
        low = bias + q * (n - 0.5) if low > c[LOW] else low
        n = np.floor((high - bias) / q)
        n += 1.0 if bias + q * (n + 1.0) - x <= up else (-1.0 if bias + q * n - x > up else 0.0)
        high = bias + q * (n + 0.5) if high < c[HIGH] else high
    return max(low, c[LOW]), min(high, c[HIGH])


@specialised
def _grows(order: int, c: Floats, at: Floats, n: Floats) -> bool:
    """Whether u_{n+1} - u_n is positive (order 1), or that difference's own next step (order 2)."""
    step = -at[SLOPE] * n[POWER]
    d_term = _derivative(c, at, n)
    filtered = c[KD] / c[TF_TS]
    lost = 1.0 - c[TF] / c[TF_TS]
    if order == 1:
        e_next = at[E_FIRST] - at[SLOPE] * n[RISE] + step
        return bool((c[KC] + filtered) * step + c[KI] * e_next - lost * d_term > 0.0)
    a = c[POLE]
    bend = (c[KC] + filtered) * (a - 1.0) + c[KI] * a - filtered * lost
    return bool(bend * step + lost * lost * d_term > 0.0)


@specialised
def _stays(order: int, grew: bool, low: float, high: float, c: Floats, at: Floats, n: Floats) -> bool:
    """What `_advance` asks: whether the sign is what it was (order 1 or 2), or u within [low, high] (order 0)."""
    if order == 0:
        u = _output(c, at, n)
        return low <= u <= high
    return _grows(order, c, at, n) == grew


@specialised
def _advance(
    order: int, low: float, high: float, c: Floats, at: Floats, table: Floats, until: float, n: Floats, trial: Floats
) -> None:
    """Move n to the last sample, `until` at most, up to which `_stays` holds, given that it fails but once."""
    grew = order > 0 and _grows(order, c, at, n)
    j = 0
    while j < table.shape[0] and n[SAMPLES] + table[j, SAMPLES] <= until:
        _join(n, table[j], trial)
        if not _stays(order, grew, low, high, c, at, trial):
            break
        copy(trial, n)
        j += 1
    # The last step failed or went too far: halve it.
    for i in range(min(j, table.shape[0] - 1), -1, -1):
        if n[SAMPLES] + table[i, SAMPLES] <= until:
            _join(n, table[i], trial)
            if _stays(order, grew, low, high, c, at, trial):
                copy(trial, n)


@compiled
def jump(
    c: Floats, r: float, load: float, state: Floats, most: int, table: Floats, carry: Floats, scratch: Floats
) -> int:
    """Take a loop whose stem rests, and whose plant input has been constant for its dead time, up to the next slip.

    Up to the last sample, `most` in all, at which OP stays within the stick band and within its limits; the sample
    after it is `run_loop`'s. Returns the number of samples; `state` and `carry` are left as after them. scratch: of
    shape SCRATCH, overwritten.

    In sample n of the stretch `y_n = y_0 + w W_n`, `W_n = 1 + a + .. + a^(n-1)`, with w = y_1 - y_0, and OP follows by
    sums over it. No crossing is missed, as OP is cut where it turns: its second difference is a sum of a^n and q^n (or,
    with equal poles, n a^n), whose sign changes once at most; so OP's difference has two turns at most, and between its
    zeros OP is monotone. Between the cuts the crossing is bracketed by doubling steps and found by halving them.
    """
    at, n, trial, last, cut = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    low, high = _room(c, state)
    _begin(c, r, _flow(c[CURVE], state[X_LAST]) + load, state, at)
    n[:] = 0.0
    n[POWER] = n[FILTER] = 1.0
    u = _output(c, at, n)
    if most < 1 or not low <= u <= high:
        return 0
    end = most - 1.0
    # Beyond this all that decays has decayed, down to where products would underflow.
    live = 1.0
    for j in range(table.shape[0]):
        if max(table[j, POWER], table[j, FILTER]) > 1e-280:
            live = table[j, SAMPLES]
    live = min(live, end)
    turn = live
    if at[D_FIRST] != 0.0 or (c[KD] != 0.0 and at[SLOPE] != 0.0):
        copy(n, last)
        _advance(2, low, high, c, at, table, live, last, trial)
        turn = min(last[SAMPLES] + 1.0, live)
    carry[U_HIGH], carry[U_LOW] = max(carry[U_HIGH], _shown(c, u)), min(carry[U_LOW], _shown(c, u))
    for stage in range(5):
        # Up to the turn of OP's difference, then up to `live`, each cut where that difference changes its sign.
        until = turn if stage < 2 else (live if stage < 4 else end)
        if n[SAMPLES] >= until:
            continue
        copy(n, last)
        if stage == 0 or stage == 2:
            _advance(1, low, high, c, at, table, until - 1.0, last, trial)
            _join(last, table[0], cut)
        else:
            for j in range(table.shape[0] - 1, -1, -1):
                if last[SAMPLES] + table[j, SAMPLES] <= until:
                    _join(last, table[j], trial)
                    copy(trial, last)
            copy(last, cut)
        u = _output(c, at, cut)
        outside = not low <= u <= high
        if outside:
            _advance(0, low, high, c, at, table, cut[SAMPLES] - 1.0, n, trial)
            u = _output(c, at, n)
        else:
            copy(cut, n)
        carry[U_HIGH], carry[U_LOW] = max(carry[U_HIGH], _shown(c, u)), min(carry[U_LOW], _shown(c, u))
        if outside:
            break
    # n is the last sample at rest.
    y, e = at[Y_FIRST] + at[SLOPE] * n[RISE], at[E_FIRST] - at[SLOPE] * n[RISE]
    carry[Y_HIGH] = max(carry[Y_HIGH], max(at[Y_FIRST], y))
    carry[Y_LOW] = min(carry[Y_LOW], min(at[Y_FIRST], y))
    carry[MOTION_LAST] = 0.0
    state[I_TERM], state[D_TERM] = _integral(c, at, n), _derivative(c, at, n)
    state[S_LAST] = -y if c[ON_PV] != 0.0 else e
    state[U_LAST] = _shown(c, u)
    if state[MOTION] != RESTED:
        state[MOTION] = 0.0
    _join(n, table[0], cut)
    state[Y] = at[Y_FIRST] + at[SLOPE] * cut[RISE]
    errors = cut[SAMPLES] * at[E_FIRST] - 2.0 * at[SLOPE] * cut[RISE_SUM]
    carry[SQUARES] += max(0.0, at[E_FIRST] * errors + at[SLOPE] * at[SLOPE] * cut[RISE2_SUM])
    return int(cut[SAMPLES])


@compiled
def _rests(c: Floats, load: float, state: Floats, past: Floats) -> bool:
    """Whether the stem rests, away from OP's limits, and the plant's input has not changed for the dead time.

    Never where the controller scans or has a compensator: its OP is then no sum over every sample's error, and such
    loops are run sample by sample.
    """
    if c[SCAN] > 1.0 or c[COMPENSATOR] != NONE:
        return False
    if c[VALVE] == IDEAL or c[POLE] == 0.0:
        return False
    moves = state[VELOCITY] != 0.0 if c[VALVE] == KARNOPP else c[VALVE] != STAIRS and abs(state[MOTION]) == 1.0
    if moves:
        return False
    v = _flow(c[CURVE], state[X_LAST]) + load
    return bool((past == v).all())


@compiled
def run_events(
    c: Floats,
    r: float,
    load: float,
    state: Floats,
    past: Floats,
    table: Floats,
    most: int,
    work: int,
    first: int,
    dust: float,
    still: float,
    reach: float,
    carry: Floats,
    rows: Floats,
) -> tuple[int, int, int, int]:
    """Run a loop without noise at constant setpoint and load, sample by sample only where its stem may move.

    Stops after `most` samples, after `work` samples of the kernel, or before `rows` (half cycles, see `collect`) could
    overflow. Returns the samples, the kernel's share of them, the half cycles written, and how it ended: DONE; RESTS
    where OP will not leave the stick band within `most` samples, or, once all has decayed, rests with an error of at
    most `still` (EU); AWAY where |PV| is beyond `reach`. `first`: number of the first sample; table: `doublings`.
    """
    kind = int(c[VALVE])
    least = past.size + 1
    longest = max(4 * least, 1024)
    rs, loads, noise = np.full(longest, r), np.full(longest, load), np.zeros(longest)
    y, u, x, v = np.empty(longest + 1), np.empty(longest), np.empty(longest), np.empty(longest)
    branch, scratch = np.empty(longest, np.int8), np.empty(SCRATCH)
    done, worked, count, chunk = 0, 0, 0, least
    gone = 1
    for j in range(table.shape[0]):
        if table[j, POWER] > 1e-16:
            gone = 2 * int(table[j, SAMPLES])
    while done < most and worked < work and count + longest <= rows.shape[0]:
        if _rests(c, load, state, past):
            a, left = c[POLE], most - done
            slope = c[GAIN] * (c[C0] + c[C1]) * past[0] - (1.0 - a) * state[Y]
            rest = r - state[Y] - (slope / (1.0 - a) if a < 1.0 else 0.0)
            lands = abs(rest) <= still and (a < 1.0 or slope == 0.0)
            if lands:
                left = min(left, gone)
            n = jump(c, r, load, state, left, table, carry, scratch)
            done += n
            if n == left and (lands or done == most):
                return done, worked, count, RESTS
            # Where stretches at rest are short, the kernel alone is as fast.
            chunk = least if n >= 32 else min(2 * chunk, longest)
        else:
            chunk = min(2 * chunk, longest)
        size = min(chunk, most - done)
        _run(c, rs[:size], loads[:size], noise[:size], state, past, y[: size + 1], u[:size], x[:size], v[:size], branch)
        count += collect(kind, y, u[:size], x[:size], branch, r, first + done, dust, carry, rows[count:])
        done += size
        worked += size
        if not abs(y[size]) <= reach:
            return done, worked, count, AWAY
    return done, worked, count, DONE


@compiled
def trace(
    c: Floats, r: float, load: float, state: Floats, past: Floats, table: Floats, stride: int, points: Floats
) -> None:
    """Run on from `state` as `run_events` does, and write y, u and x of every stride-th sample into `points`."""
    least = past.size + 1
    longest = max(4 * least, 1024)
    rs, loads, noise = np.full(longest, r), np.full(longest, load), np.zeros(longest)
    y, u, x, v = np.empty(longest + 1), np.empty(longest), np.empty(longest), np.empty(longest)
    branch, scratch = np.empty(longest, np.int8), np.empty(SCRATCH)
    carry = np.zeros(CARRIED)
    for i in range(points.shape[0]):
        left = stride
        while left > 0:
            if _rests(c, load, state, past):
                left -= jump(c, r, load, state, left, table, carry, scratch)
            size = min(least, left)
            if size > 0:
                _run(
                    c, rs[:size], loads[:size], noise[:size], state, past, y[: size + 1], u[:size], x[:size], v, branch
                )
                left -= size
        points[i, 0] = -state[S_LAST] if c[ON_PV] != 0.0 else r - state[S_LAST]
        points[i, 1], points[i, 2] = state[U_LAST], state[X_LAST]


# Of a cascade's chain from v to the primary's PV: (w, y) with w the secondary's PV, delayed by the primary's dead time,
# `w += .., y = A10 w + A11 y + ..`, the inputs' shares of v_{k-m} and v_{k-m-1}, and m, the whole samples of both dead
# times. SCALE: EU of the secondary per unit of the primary's output; HELD_BACK: 1 where a secondary at its limit holds
# the primary's integral.
A00, A10, A11, NEAR_W, NEAR_Y, FAR_W, FAR_Y, CHAIN_DELAY, SCALE, HELD_BACK = range(10)
CHAIN = 10
# A cascade's state beside those of its controllers: w, y, and the secondary's limit in the sample before.
CHAIN_W, CHAIN_Y, LIMIT = range(3)


@compiled
def run_cascade(
    c1: Floats,
    c2: Floats,
    chain: Floats,
    every: int,
    r: Floats,
    added: Floats,
    load: Floats,
    noise1: Floats,
    noise2: Floats,
    state1: Floats,
    state2: Floats,
    past2: Floats,
    link: Floats,
    tail: Floats,
    y1: Floats,
    u1: Floats,
    r2: Floats,
    y2: Floats,
    u2: Floats,
    x: Floats,
    v: Floats,
    branch: NDArray[np.int8],
) -> None:
    """Run N = u2.size samples, whole scans of `every`, of a cascade (model.cascade), and leave the state after them.

    c1: the primary's row with an ideal valve; what it says of a plant is not used. added: what the primary's load makes
    of its PV (EU). state1, state2, past2: as `run_loop`'s; link: the chain's state; tail[i] = v_{-1-i}, at least m + 1
    values. Written: y1 and y2 (N + 1, without noise), the rest N each; u1 and r2 are held between scans.
    """
    n = u2.size
    m = int(chain[CHAIN_DELAY])
    row = c1.copy()
    row[VALVE], row[POLE], row[GAIN], row[DELAY] = IDEAL, 1.0, 0.0, 0.0
    pushes = chain[SCALE] * _sign(c2[KC])
    past1, still, py, one, px, pv = np.zeros(1), np.zeros(1), np.empty(2), np.empty(1), np.empty(1), np.empty(1)
    code = np.empty(1, np.int8)
    w, y, limit = link[CHAIN_W], link[CHAIN_Y], link[LIMIT]
    y1[0] = y + added[0]
    for first in range(0, n, every):
        end = first + every
        e = r[first] - (y1[first] + noise1[first])
        outward = chain[HELD_BACK] != 0.0 and limit * pushes * c1[KI] * e > 0.0
        row[KI] = 0.0 if outward else c1[KI]
        state1[Y] = y1[first]
        run_loop(row, r[first:end], still, noise1[first:end], state1, past1, py, one, px, pv, code)
        u1[first:end] = one[0]
        r2[first:end] = chain[SCALE] * one[0]
        run_loop(
            c2,
            r2[first:end],
            load[first:end],
            noise2[first:end],
            state2,
            past2,
            y2[first : end + 1],
            u2[first:end],
            x[first:end],
            v[first:end],
            branch[first:end],
        )
        limit = branch[end - 1] % 9 // 3 - 1.0
        for k in range(first, end):
            near = v[k - m] if k >= m else tail[m - k - 1]
            far = v[k - m - 1] if k > m else tail[m - k]
            y = chain[A10] * w + chain[A11] * y + (chain[NEAR_Y] * near + chain[FAR_Y] * far)
            w = chain[A00] * w + (chain[NEAR_W] * near + chain[FAR_W] * far)
            y1[k + 1] = y + added[k + 1]
    link[CHAIN_W], link[CHAIN_Y], link[LIMIT] = w, y, limit
    length = tail.size
    for i in range(length - 1, -1, -1):
        tail[i] = v[n - 1 - i] if n - 1 - i >= 0 else tail[i - n]


@compiled
def cascade_worst(
    rows: Floats,
    group: int,
    c2: Floats,
    chain: Floats,
    every: int,
    r: Floats,
    added: Floats,
    load: Floats,
    noise1: Floats,
    noise2: Floats,
    weights: Floats,
    ceilings: Floats,
    worst: Floats,
) -> int:
    """As `run_worst`, of a cascade under many primaries, from rest; returns the samples run.

    J is of the primary's error and of the secondary's output and stem. All signals: N + 1, N whole scans.
    """
    n = r.size - 1
    chunk = min(n, every * (127 // every + 1))
    y1, y2 = np.empty(chunk + 1), np.empty(chunk + 1)
    u1, r2, u2, x, v = np.empty(chunk), np.empty(chunk), np.empty(chunk), np.empty(chunk), np.empty(chunk)
    branch = np.empty(chunk, np.int8)
    state1, state2, link = np.empty(STATES), np.empty(STATES), np.empty(3)
    past2, tail = np.empty(int(c2[DELAY]) + 1), np.empty(int(chain[CHAIN_DELAY]) + 1)
    last, sums = np.empty(3), np.empty(SUMS)
    every_sum = weights[6:].max() > 0.0
    samples = 0
    for i in range(worst.size):
        worst[i] = 0.0
        for j in range(i * group, (i + 1) * group):
            state1[:], state2[:], link[:], past2[:], tail[:], sums[:] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            state2[U_LAST] = c2[BIAS]
            last[0], last[1], last[2] = c2[BIAS], 0.0, 0.0
            cost, begin = 0.0, 0
            while begin < n and cost <= ceilings[i]:
                size = min(chunk, n - begin)
                end = begin + size
                run_cascade(
                    rows[j],
                    c2,
                    chain,
                    every,
                    r[begin : end + 1],
                    added[begin : end + 1],
                    load[begin : end + 1],
                    noise1[begin : end + 1],
                    noise2[begin : end + 1],
                    state1,
                    state2,
                    past2,
                    link,
                    tail,
                    y1[: size + 1],
                    u1[:size],
                    r2[:size],
                    y2[: size + 1],
                    u2[:size],
                    x[:size],
                    v[:size],
                    branch[:size],
                )
                errors = noise1[begin : end + 1]
                add_sums(sums, last, every_sum, r[begin : end + 1], errors, y1[: size + 1], u2[:size], x[:size])
                cost = weigh(sums, weights, end, n)
                begin = end
            samples += begin
            if not cost <= ceilings[i]:
                worst[i] = np.inf
                break
            worst[i] = max(worst[i], cost)
    return samples
