"""Many runs of the kernel's law in one call: where these are of one plain loop under several tunings, side by side.

What is asked of them are the sums that objectives weigh (`run_costs`), or which is the worst of each group as long as
it may still beat a ceiling (`run_worst`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled, place, written_out
from workbench.simulate.kernel import (
    BAND,
    BAND_DOWN,
    BIAS,
    C0,
    C1,
    COEFFICIENTS,
    DELAY,
    GAIN,
    HIGH,
    IDEAL,
    KC,
    KD,
    KI,
    LOW,
    OFFSET,
    OFFSET_DOWN,
    ON_PV,
    POLE,
    STAIRS,
    STATES,
    TF,
    TF_TS,
    TS_TT,
    TWO_PARAMETER,
    U_LAST,
    VALVE,
    WEIGHT,
    WINDUP,
    run_inline,
    usual,
    valve_step,
)
from workbench.simulate.sums import (
    ERROR2,
    FEW_SUMS,
    FINAL2,
    MOVES2,
    OP2,
    SUMS,
    TRAVEL,
    WINDOW2,
    add_sums,
    weigh,
)

__all__ = ["CHUNK", "fits_abreast", "run_costs", "run_worst", "weighs_every"]

Floats = NDArray[np.float64]

# Runs side by side (see `_abreast`): so many lanes, and where each number of theirs begins in a flat array: what a
# tuning's row has of its own, the state, this sample's proportional term and integral step and the stem before it, and
# the sums.
LANES = 16
ABREAST = 22 * LANES
_KC, _KI, _KD, _TF, _TF_TS, _WEIGHT, _I, _D, _S, _U, _X, _MOTION, _Y = range(0, 13 * LANES, LANES)
_P, _STEP, _X_LAST, _MOTION_LAST, _ERROR2, _OP2, _MOVES2, _WINDOW2, _TRAVEL = range(13 * LANES, ABREAST, LANES)
# Below so many runs the idle lanes cost more than the others save.
WORTH_LANES = 5
# Samples of a search's runs at a time: so long that the bookkeeping between costs little, so short as to stop early.
CHUNK = 64


@written_out
def _abreast(
    c: Floats, r: Floats, load: Floats, noise: Floats, lanes: Floats, v: Floats, kind: int, first: bool
) -> None:
    """r.size samples of LANES plain runs side by side: `run_samples` and `add_sums` in the same order of operations.

    The compiler makes vector instructions of the loops over lanes, each lane rounded as if it ran alone. For that, each
    decision is a choice between two values, all numbers of the lanes are in one array at constant distances, and the
    loops are two, as a single one would read inputs of the plant that it might itself have written. A choice that keeps
    a number as it is would become a store under a mask, which is slow where vectors are of four numbers: the stem's
    last values have places of their own. c: the row of what all lanes share; v: the plant's inputs of
    samples -m-2 .. r.size-1, LANES of each, moved up at the end for the next stretch; the plant's output in `lanes` is
    the last sample's. kind: STAIRS or TWO_PARAMETER; first: whether the runs begin here.
    """
    on_pv, bias, low, high = c[ON_PV] != 0.0, c[BIAS], c[LOW], c[HIGH]
    band, offset, band_down, offset_down = c[BAND], c[OFFSET], c[BAND_DOWN], c[OFFSET_DOWN]
    a, gain, c0, c1, m = c[POLE], c[GAIN], c[C0], c[C1], int(c[DELAY])
    if c[VALVE] == IDEAL:
        # Stairs of any height: the stem is where the input is.
        band, offset = -1.0, 0.0
    for k in range(r.size):
        r_now, load_now, noise_now = r[k], load[k], noise[k]
        far, near, now = place(k * LANES), place((k + 1) * LANES), place((k + m + 2) * LANES)
        for j in range(LANES):
            plant = a * lanes[_Y + j] + gain * (c0 * v[near + place(j)] + c1 * v[far + place(j)])
            measured = plant + noise_now
            e = r_now - measured
            s = -measured if on_pv else e
            d_term = (lanes[_TF + j] * lanes[_D + j] + lanes[_KD + j] * (s - lanes[_S + j])) / lanes[_TF_TS + j]
            lanes[_D + j] = d_term if lanes[_KD + j] != 0.0 else 0.0
            lanes[_Y + j], lanes[_S + j], lanes[_STEP + j] = plant, s, lanes[_KI + j] * e
            lanes[_P + j] = lanes[_KC + j] * (lanes[_WEIGHT + j] * r_now - measured)
            lanes[_X_LAST + j] = lanes[_X + j]
            if kind != STAIRS:
                lanes[_MOTION_LAST + j] = lanes[_MOTION + j]
            lanes[_ERROR2 + j] += e * e
            lanes[_WINDOW2 + j] += e * e
        for j in range(LANES):
            step, i_last, others = lanes[_STEP + j], lanes[_I + j], bias + lanes[_P + j]
            i_term, d_term = i_last + step, lanes[_D + j]
            out = others + i_term + d_term
            undone = (out > high and step > 0.0) or (out < low and step < 0.0)
            i_term = i_last + (0.0 if undone else step)
            out = others + i_term + d_term
            out = high if out > high else (low if out < low else out)
            u_last, x_last = lanes[_U + j], lanes[_X_LAST + j]
            motion = lanes[_MOTION_LAST + j]
            x, motion = valve_step(kind, band, offset, band_down, offset_down, out, u_last, x_last, motion)
            lanes[_I + j], lanes[_U + j], lanes[_X + j], lanes[_MOTION + j] = i_term, out, x, motion
            lanes[_OP2 + j] += out * out
            lanes[_MOVES2 + j] += (out - u_last) * (out - u_last)
            lanes[_TRAVEL + j] += abs(x - x_last)
            v[now + place(j)] = x + load_now
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
def fits_abreast(c: Floats) -> bool:
    """Whether `_abreast` knows what a loop has."""
    return usual(c) and c[VALVE] <= TWO_PARAMETER and c[WINDUP] == 0.0


@compiled
def weighs_every(weights: Floats) -> bool:
    """Whether an objective needs sums that `_abreast` does not keep."""
    return bool(weights[6:].max() > 0.0)


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
    if fits_abreast(rows[0]):
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
        run_inline(rows[i], r[j], load[j], noise[j], state, past, y, u, x, v, branch)
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
    every = weighs_every(weights)
    samples = 0
    if not every and worst.size * group >= WORTH_LANES and fits_abreast(rows[0]):
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
                run_inline(
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
