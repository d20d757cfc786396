"""The one kernel: a sampled loop of PID controller, sticky valve and plant with fractional dead time, as plain floats.

Everything that is compiled together lives in this file (numba's cache does not see changes elsewhere). The order of
operations is fixed: sticky loops are chaotic, and rounding decides slips. `kernel == kernel.py_func` to the bit.

A loop is a row of `COEFFICIENTS` floats (see the names below), a state is `STATES` floats, and the plant input's past
`past[i] = v_{-1-i}`. For each sample k the law is

1. y_k measured = plant output + noise, e_k = r_k - y_k
2. u_k = bias + P + I + D, `P = Kc (b r - y)`, `I += (Kc Ts/Ti) e`, `D = (Tf D + Kc Td (s - s_{k-1}))/(Tf + Ts)`,
   s = e or -y
3. output limits; clamping undoes this sample's I step where u is outside and the step pushes further out; back-
   calculation adds `(Ts/Tt)(u_limited - u)` to I
4. the valve (model.valve); 5. the plant's exact zero-order-hold step with v = x + load.

`branch` codes the decisions of each sample: `stem + 3 (limit + 1) + 9 undone`, where stem is 0, 1 or 2 for a stem that
moves down, rests or moves up, limit is -1, 0 or 1 for an output at its low limit, free or at its high limit, and undone
is 1 where clamping undid the I step. An ideal valve codes as at rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled

__all__ = ["COEFFICIENTS", "STATES", "run_costs", "run_loop", "run_worst", "valve_path", "valve_step"]

Floats = NDArray[np.float64]

# Columns of a coefficient row.
KC, KI, KD, TF, TF_TS, WEIGHT, ON_PV, BIAS, LOW, HIGH, WINDUP, TS_TT = range(12)
VALVE, BAND, OFFSET, POLE, GAIN, C0, C1, DELAY = range(12, 20)
COEFFICIENTS = 20
# KC signed gain; KI = Kc Ts/Ti; KD = Kc Td; TF_TS = Tf + Ts; ON_PV 1 for derivative on PV; WINDUP 0 clamp,
# 1 back-calculation.
# VALVE 0 ideal, 1 Stenman, 2 two-parameter; BAND d or (S + J)/2; OFFSET (S - J)/2; POLE a, 1 for integrating;
# GAIN K, or K Ts for integrating; C0, C1 the shares of v_{k-m} and v_{k-m-1}; DELAY m.
IDEAL, STENMAN, TWO_PARAMETER = 0, 1, 2

# Entries of a state.
I_TERM, D_TERM, S_LAST, U_LAST, X_LAST, MOTION, Y = range(7)
STATES = 7


@compiled
def valve_step(
    kind: int, band: float, offset: float, u: float, u_last: float, x: float, motion: int
) -> tuple[float, int]:
    """One sample of a valve: the new stem position and motion (-1 down, 0 at rest, 1 up; Stenman: of this slip)."""
    if kind == STENMAN:
        if abs(u - x) <= band:
            return x, 0
        return u, 1 if u > x else -1
    if kind == TWO_PARAMETER:
        if motion != 0 and (u - u_last) * motion > 0.0:
            return u - motion * offset, motion
        if abs(u - x) > band:
            motion = 1 if u > x else -1
            return u - motion * offset, motion
        return x, 0
    return u, 0


@compiled
def valve_path(
    kind: int, band: float, offset: float, op: Floats, u_last: float, x_last: float, motion: int, x: Floats
) -> int:
    """Write into `x` the stem's path under a given output; return the last motion."""
    for k in range(op.size):
        u = op[k]
        x_last, motion = valve_step(kind, band, offset, u, u_last, x_last, motion)
        x[k] = x_last
        u_last = u
    return motion


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
    kc, ki, kd, tf, tf_ts = c[KC], c[KI], c[KD], c[TF], c[TF_TS]
    weight, on_pv, bias = c[WEIGHT], c[ON_PV] != 0.0, c[BIAS]
    low, high, back, ts_tt = c[LOW], c[HIGH], c[WINDUP] != 0.0, c[TS_TT]
    kind, band, offset = int(c[VALVE]), c[BAND], c[OFFSET]
    a, gain, c0, c1, m = c[POLE], c[GAIN], c[C0], c[C1], int(c[DELAY])
    n = u.size
    i_term, d_term, s_last, u_last, x_last = state[I_TERM], state[D_TERM], state[S_LAST], state[U_LAST], state[X_LAST]
    motion = int(state[MOTION])
    plant = state[Y]
    y[0] = plant
    for k in range(n):
        measured = plant + noise[k]
        e = r[k] - measured
        s = -measured if on_pv else e
        if kd != 0.0 or d_term != 0.0:
            d_term = (tf * d_term + kd * (s - s_last)) / tf_ts
        s_last = s
        p_term = kc * (weight * r[k] - measured)
        step = ki * e
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
        x_last, motion = valve_step(kind, band, offset, out, u_last, x_last, motion)
        u_last = out
        u[k] = out
        x[k] = x_last
        v[k] = x_last + load[k]
        branch[k] = motion + 1 + 3 * (limit + 1) + 9 * undone
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
def run_costs(
    rows: Floats, which: NDArray[np.int64], r: Floats, load: Floats, noise: Floats, terms: Floats, longest: int
) -> None:
    """Cost terms of many loops from rest: row i of `rows` in experiment which[i] (a row of r, load, noise: N + 1 each).

    Written: terms[i] = (sum_{1..N} e^2, sum_{0..N-1} u^2, e_N^2, sum_{0..N-1} (u_k - u_{k-1})^2), so that J of
    eq. (2) is their product with (w1, w2, w3, w4), then sum_{0..N-1} e^2 and sum_{0..N-1} |x_k - x_{k-1}|, for the mean
    square error and the valve travel. `longest`: the largest whole dead time m.
    """
    n = r.shape[1] - 1
    y = np.empty(n + 1)
    u = np.empty(n)
    x = np.empty(n)
    v = np.empty(n)
    branch = np.empty(n, np.int8)
    state = np.empty(STATES)
    past = np.empty(longest + 1)
    for i in range(rows.shape[0]):
        j = which[i]
        state[:] = 0.0
        state[U_LAST] = rows[i, BIAS]
        past[:] = 0.0
        run_loop(rows[i], r[j], load[j], noise[j], state, past, y, u, x, v, branch)
        last, stem = rows[i, BIAS], 0.0
        squares, outputs, moves, window, travel = 0.0, 0.0, 0.0, 0.0, 0.0
        e = r[j, 0] - noise[j, 0]
        for k in range(n):
            window += e * e
            e = r[j, k + 1] - (y[k + 1] + noise[j, k + 1])
            squares += e * e
            outputs += u[k] * u[k]
            moves += (u[k] - last) * (u[k] - last)
            last = u[k]
            travel += abs(x[k] - stem)
            stem = x[k]
        terms[i, 0] = squares
        terms[i, 1] = outputs
        terms[i, 2] = e * e
        terms[i, 3] = moves
        terms[i, 4] = window
        terms[i, 5] = travel


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
) -> int:
    """The worst J of eq. (2) in each group of `group` successive rows, from rest, as long as it stays below a ceiling.

    For searches that only ask whether a candidate beats what they have: a group is given up, and its worst is inf, as
    soon as a partial sum of J (no term is negative) has passed ceilings[i] or is nan. r, load, noise: N + 1 each;
    weights (w1, w2, w3, w4); ceilings and worst: one for each group; longest: the largest whole dead time m. Returns
    the number of samples that were run. Sums in another order than `run_costs`: the last digits may differ.
    """
    n = r.size - 1
    # Long enough that the bookkeeping between chunks costs little, short enough to stop early.
    chunk = max(32, longest + 1)
    y = np.empty(chunk + 1)
    u = np.empty(chunk)
    x = np.empty(chunk)
    v = np.empty(chunk)
    branch = np.empty(chunk, np.int8)
    state = np.empty(STATES)
    past = np.empty(longest + 1)
    w1, w2, w3, w4 = weights[0], weights[1], weights[2], weights[3]
    samples = 0
    for i in range(worst.size):
        worst[i] = 0.0
        for j in range(i * group, (i + 1) * group):
            state[:] = 0.0
            state[U_LAST] = rows[j, BIAS]
            past[:] = 0.0
            last, cost, e, begin = rows[j, BIAS], 0.0, 0.0, 0
            while begin < n and cost <= ceilings[i]:
                size = min(chunk, n - begin)
                end = begin + size
                run_loop(
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
                for k in range(size):
                    e = r[begin + k + 1] - (y[k + 1] + noise[begin + k + 1])
                    cost += w1 * e * e
                    if w2 != 0.0:
                        cost += w2 * u[k] * u[k]
                    if w4 != 0.0:
                        cost += w4 * (u[k] - last) * (u[k] - last)
                    last = u[k]
                begin = end
            samples += begin
            if begin == n:
                cost += w3 * e * e
            if not cost <= ceilings[i]:
                worst[i] = np.inf
                break
            worst[i] = max(worst[i], cost)
    return samples
