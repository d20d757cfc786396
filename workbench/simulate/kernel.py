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

__all__ = [
    "COEFFICIENTS",
    "FEW_SUMS",
    "STATES",
    "SUMS",
    "WEIGHTS",
    "add_sums",
    "run_costs",
    "run_loop",
    "run_worst",
    "valve_path",
    "valve_step",
    "weigh",
    "weigh_all",
]

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

# Columns of a run's sums over e_k = r_k - y_k (measured), u_k and x_k: squares of e_1..e_N, of u, of e_N, of moves of u
# and of e_0..e_{N-1}; |moves of x|; where all are asked for, |e|, e, u, |moves of u|, x, x^2, stem reversals, y, y^2.
ERROR2, OP2, FINAL2, MOVES2, WINDOW2, TRAVEL, IAE, ERROR, OP, OP_TRAVEL, STEM, STEM2, REVERSALS, PV, PV2 = range(15)
FEW_SUMS, SUMS = 6, 15
# Weights of an objective: of the first four sums, which is eq. (2), then of WINDOW2, TRAVEL, IAE, OP_TRAVEL, REVERSALS,
# of the variances of e, u and x, and of the standard deviation of y.
WEIGHTS = 13

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
    for i in range(rows.shape[0]):
        j = which[i]
        state[:] = 0.0
        state[U_LAST] = rows[i, BIAS]
        past[:] = 0.0
        run_loop(rows[i], r[j], load[j], noise[j], state, past, y, u, x, v, branch)
        last[0], last[1], last[2] = rows[i, BIAS], 0.0, 0.0
        sums[i] = 0.0
        add_sums(sums[i], last, every, r[j], noise[j], y, u, x)


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
    """The worst J in each group of `group` successive rows, from rest, as long as it stays below a ceiling.

    For searches that only ask whether a candidate beats what they have: a group is given up, and its worst is inf, as
    soon as a run's J so far has passed ceilings[i] or is nan. r, load, noise: N + 1 each; weights: WEIGHTS of them;
    ceilings and worst: one for each group; longest: the largest whole dead time m. Returns the number of samples run.
    """
    n = r.size - 1
    # Long enough that the bookkeeping between chunks costs little, short enough to stop early.
    chunk = max(64, longest + 1)
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
    for i in range(worst.size):
        worst[i] = 0.0
        for j in range(i * group, (i + 1) * group):
            state[:] = 0.0
            state[U_LAST] = rows[j, BIAS]
            past[:] = 0.0
            last[0], last[1], last[2] = rows[j, BIAS], 0.0, 0.0
            sums[:] = 0.0
            cost, begin = 0.0, 0
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
                add_sums(
                    sums, last, every, r[begin : end + 1], noise[begin : end + 1], y[: size + 1], u[:size], x[:size]
                )
                cost = weigh(sums, weights, end, n)
                begin = end
            samples += begin
            if not cost <= ceilings[i]:
                worst[i] = np.inf
                break
            worst[i] = max(worst[i], cost)
    return samples
