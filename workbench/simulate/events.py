"""The kernel's law for very long times, from slip to slip, and the half cycles of the stem that come of it.

While the stem rests the loop is linear with a constant input, and is taken to the next slip in closed form.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled, copy, specialised
from workbench.simulate.kernel import (
    BAND,
    BAND_DOWN,
    BIAS,
    C0,
    C1,
    COMPENSATOR,
    CURVE,
    D_TERM,
    GAIN,
    HIGH,
    I_TERM,
    IDEAL,
    KANO,
    KARNOPP,
    KC,
    KD,
    KI,
    LOW,
    MOTION,
    NONE,
    OFFSET,
    ON_PV,
    PLACES,
    POLE,
    RESOLUTION,
    RESTED,
    S_LAST,
    SCAN,
    STAIRS,
    TF,
    TF_TS,
    U_LAST,
    VALVE,
    VELOCITY,
    WEIGHT,
    X_LAST,
    Y,
    flow,
    place,
    run_inline,
    shown,
)

__all__ = ["CARRIED", "HALF_CYCLE", "SCRATCH", "collect", "doublings", "jump", "run_events", "trace"]

Floats = NDArray[np.float64]

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
        up = place(c, x)[0]
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
    _begin(c, r, flow(c[CURVE], state[X_LAST]) + load, state, at)
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
    carry[U_HIGH], carry[U_LOW] = max(carry[U_HIGH], shown(c, u)), min(carry[U_LOW], shown(c, u))
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
        carry[U_HIGH], carry[U_LOW] = max(carry[U_HIGH], shown(c, u)), min(carry[U_LOW], shown(c, u))
        if outside:
            break
    # n is the last sample at rest.
    y, e = at[Y_FIRST] + at[SLOPE] * n[RISE], at[E_FIRST] - at[SLOPE] * n[RISE]
    carry[Y_HIGH] = max(carry[Y_HIGH], max(at[Y_FIRST], y))
    carry[Y_LOW] = min(carry[Y_LOW], min(at[Y_FIRST], y))
    carry[MOTION_LAST] = 0.0
    state[I_TERM], state[D_TERM] = _integral(c, at, n), _derivative(c, at, n)
    state[S_LAST] = -y if c[ON_PV] != 0.0 else e
    state[U_LAST] = shown(c, u)
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
    v = flow(c[CURVE], state[X_LAST]) + load
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
        if (table[j, POWER] if c[POLE] < 1.0 else table[j, FILTER]) > 1e-16:
            gone = 2 * int(table[j, SAMPLES])
    while done < most and worked < work and count + longest <= rows.shape[0]:
        if _rests(c, load, state, past):
            a, left = c[POLE], most - done
            slope = c[GAIN] * (c[C0] + c[C1]) * past[0] - (1.0 - a) * state[Y]
            rest = r - state[Y] - (slope / (1.0 - a) if a < 1.0 else 0.0)
            # A stem that slid onto a level's load stops short of it by rounding: what is left integrates to nothing.
            lands = abs(rest) <= still and (a < 1.0 or abs(past[0]) <= dust)
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
        run_inline(
            c, rs[:size], loads[:size], noise[:size], state, past, y[: size + 1], u[:size], x[:size], v[:size], branch
        )
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
                run_inline(
                    c, rs[:size], loads[:size], noise[:size], state, past, y[: size + 1], u[:size], x[:size], v, branch
                )
                left -= size
        points[i, 0] = -state[S_LAST] if c[ON_PV] != 0.0 else r - state[S_LAST]
        points[i, 1], points[i, 2] = state[U_LAST], state[X_LAST]
