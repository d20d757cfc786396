"""The sampled loop's frequency response, and what is read off it for one row of coefficients after the other.

`L(e^(jw))` with w = frequency times Ts, of the law in `simulate.kernel` with an ideal valve. `1 - e^(-jw)` is built
from half angles: at the least frequencies 1 less a cosine would keep four digits.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled
from workbench.simulate.kernel import C0, C1, DELAY, GAIN, KC, KD, KI, POLE, TF, TF_TS

__all__ = ["READ", "read_margins"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

READ = 5  # columns of what is read: Ms, its frequency, gain margin, phase margin and delay margin
# Points between the neighbours of a grid's least, and steps about the best of these, as shares of their gap.
FINE, CLOSER = 9, (0.5, 0.1, 0.01)
BESIDE = 0.1  # L's step between points of the grid, about: a minimum of |1 + L| may lie by so much beside them
SOLVING, EXACT = 40, 1e-10  # steps of a crossing's search, and how closely it is found
# Of the limit: a factor on Kc and a lag, rad, below it by less count as at it, as a chord of the grid may read a loop
# as stable that just is not.
AT_LIMIT = 0.01


@compiled
def _response(row: Floats, turned: Floats, late: Floats, re: Floats, im: Floats) -> None:
    """Write L at some frequencies; turned: of `_turned` there, late: of `_lag`, delay + 1 samples."""
    kc, ki, kd, filtered, short = row[KC], row[KI], row[KD], row[TF], row[TF_TS] - row[TF]
    gain, c0, c1, pole = row[GAIN], row[C0], row[C1], row[POLE]
    for i in range(re.size):
        d, s = turned[0, i], turned[1, i]
        # C = KC + KI / (1 - b) + KD (1 - b) / (TF_TS - TF b), b = e^(-jw)
        below_re, below_im = short + filtered * d, filtered * s
        share = kd / (below_re * below_re + below_im * below_im)
        c_re = kc + 0.5 * ki + share * (d * below_re + s * below_im)
        c_im = share * (s * below_re - d * below_im) - 0.5 * ki * s / d
        # hold e^(-jw(delay + 1)) / (1 - POLE b)
        h_re, h_im = c0 + c1 * (1.0 - d), -c1 * s
        l_re = h_re * late[0, i] + h_im * late[1, i]
        l_im = h_im * late[0, i] - h_re * late[1, i]
        q_re, q_im = 1.0 - pole + pole * d, pole * s
        scale = gain / (q_re * q_re + q_im * q_im)
        p_re, p_im = scale * (l_re * q_re + l_im * q_im), scale * (l_im * q_re - l_re * q_im)
        re[i], im[i] = c_re * p_re - c_im * p_im, c_re * p_im + c_im * p_re


@compiled
def _turned(w: Floats, turned: Floats) -> None:
    """Write real and imaginary part of `1 - e^(-jw)`, shape (2, F)."""
    for i in range(w.size):
        half = math.sin(0.5 * w[i])
        turned[0, i], turned[1, i] = 2.0 * half * half, math.sin(w[i])


@compiled
def _lag(w: Floats, samples: float, late: Floats) -> None:
    """Write cosine and sine of a lag of so many samples, shape (2, F)."""
    for i in range(w.size):
        late[0, i], late[1, i] = math.cos(w[i] * samples), math.sin(w[i] * samples)


@compiled
def _nearest(re: Floats, im: Floats) -> tuple[int, float]:
    """Return where L is nearest to -1, and the square of how near."""
    best, least = 0, math.inf
    for i in range(re.size):
        apart = (1.0 + re[i]) * (1.0 + re[i]) + im[i] * im[i]
        if apart < least:
            best, least = i, apart
    return best, least


@compiled
def _encloses_nothing(row: Floats, turned: Floats, re: Floats, im: Floats) -> bool:
    """Whether `1 + L`, freed of its poles at z = 1, does not turn about 0: then no closed-loop pole lies outside.

    All other open-loop poles lie inside the unit circle, and the freed function is positive at z = 1 for a stable loop.
    """
    alone = row[KC] * row[GAIN] if row[POLE] == 1.0 else 1.0 + row[KC] * row[GAIN]
    if not (row[KI] * row[GAIN] if row[KI] != 0.0 else alone) > 0.0:
        return False
    integrators = (row[KI] != 0.0) + (row[POLE] == 1.0)
    turns, before_re, before_im = 0, 0.0, 0.0
    for i in range(re.size):
        f_re, f_im = 1.0 + re[i], im[i]
        d, s = turned[0, i], turned[1, i]
        for _ in range(integrators):
            f_re, f_im = f_re * d - f_im * s, f_re * s + f_im * d
        # Past the negative real axis, to the left or to the right of 0 as it is seen from the point before.
        if i > 0 and (before_im < 0.0) != (f_im < 0.0):
            across = before_re * f_im - before_im * f_re
            if f_im < 0.0 and across > 0.0:
                turns += 1
            elif before_im < 0.0 and across < 0.0:
                turns -= 1
        before_re, before_im = f_re, f_im
    return abs(math.atan2(before_im, before_re) + 2.0 * math.pi * turns) < 0.5 * math.pi


@compiled
def _at(row: Floats, w: float, point: Floats) -> tuple[float, float]:
    """Return L at one frequency; point: room for what it is made of, shape (7, 1)."""
    point[0, 0] = w
    _turned(point[0], point[1:3])
    _lag(point[0], row[DELAY] + 1.0, point[3:5])
    _response(row, point[1:3], point[3:5], point[5], point[6])
    return point[5, 0], point[6, 0]


@compiled
def _offset(re: float, im: float, axis: bool) -> float:
    """How far a point is from the real axis, or else from the unit circle (of its logarithm)."""
    return im if axis else 0.5 * math.log(re * re + im * im)


@compiled
def _crossing(
    row: Floats, w: Floats, re: Floats, im: Floats, i: int, axis: bool, point: Floats
) -> tuple[float, float, float]:
    """Return the frequency after the i-th at which L crosses the real axis, or else the unit circle, and L there.

    The false position by turns of Illinois (M. Dowell, P. Jarratt, BIT 11 (1971) 168-174).
    """
    low, high = w[i], w[i + 1]
    before, after = _offset(re[i], im[i], axis), _offset(re[i + 1], im[i + 1], axis)
    at, real, imaginary, kept = high, re[i + 1], im[i + 1], 0
    for _ in range(SOLVING):
        if after == before:
            break
        at = high - after * (high - low) / (after - before)
        real, imaginary = _at(row, at, point)
        here = _offset(real, imaginary, axis)
        if abs(here) <= EXACT:
            break
        if (here < 0.0) == (after < 0.0):
            high, after = at, here
            before *= 0.5 if kept == 1 else 1.0
            kept = 1
        else:
            low, before = at, here
            after *= 0.5 if kept == -1 else 1.0
            kept = -1
    return at, real, imaginary


@compiled
def _gain_margin(row: Floats, w: Floats, re: Floats, im: Floats, point: Floats) -> float:
    """The least 1/|L| from 1 on where L is real and negative: at its crossings, and at both ends of the frequencies."""
    least, last = math.inf, re.size - 1
    for i in range(last):
        if (re[i] < 0.0 or re[i + 1] < 0.0) and (im[i] < 0.0) != (im[i + 1] < 0.0):
            _, real, _ = _crossing(row, w, re, im, i, True, point)
            if real < 0.0 and -1.0 / real >= 1.0 - AT_LIMIT:
                least = min(least, max(-1.0 / real, 1.0))
    if -1.0 < re[last] < 0.0:
        least = min(least, -1.0 / re[last])
    if row[KI] == 0.0 and row[POLE] != 1.0 and -1.0 < row[KC] * row[GAIN] < 0.0:
        least = min(least, -1.0 / (row[KC] * row[GAIN]))
    return least


@compiled
def _unit_crossings(row: Floats, w: Floats, re: Floats, im: Floats, point: Floats) -> tuple[float, float]:
    """Return the least lag, rad, that turns a point of |L| = 1 into -1, and the least over frequency; inf without."""
    phase, delay = math.inf, math.inf
    above = re[0] * re[0] + im[0] * im[0] >= 1.0
    for i in range(w.size - 1):
        here, above = above, re[i + 1] * re[i + 1] + im[i + 1] * im[i + 1] >= 1.0
        if here != above:
            at, real, imaginary = _crossing(row, w, re, im, i, False, point)
            # Of lag alone: a point beyond -180 degrees needs nearly a whole turn.
            lag = math.atan2(-imaginary, -real) % (2.0 * math.pi)
            if lag > 2.0 * math.pi - AT_LIMIT:
                lag = 0.0
            phase = min(phase, lag)
            delay = min(delay, lag / at)
    return phase, delay


@compiled
def _apart(row: Floats, w: float, point: Floats) -> float:
    """|1 + L|, squared, at one frequency."""
    re, im = _at(row, w, point)
    return (1.0 + re) * (1.0 + re) + im * im


@compiled
def _nearest_between(row: Floats, low: float, high: float, fine: Floats) -> tuple[float, float]:
    """Return the least |1 + L| between two frequencies, and where; fine: room, shape (7, FINE).

    On a fine grid, then where parabolas through three points about its best one have the least square.
    """
    gap = (high - low) / (FINE - 1)
    for i in range(FINE):
        fine[0, i] = low + gap * i
    _turned(fine[0], fine[1:3])
    _lag(fine[0], row[DELAY] + 1.0, fine[3:5])
    _response(row, fine[1:3], fine[3:5], fine[5], fine[6])
    k, least = _nearest(fine[5], fine[6])
    at, point = fine[0, k], fine[:, :1]
    for share in CLOSER:
        step = share * gap
        if at - step < low or at + step > high:
            continue
        before, after = _apart(row, at - step, point), _apart(row, at + step, point)
        curve = before - 2.0 * least + after
        if curve > 0.0:
            w = at + step * min(max(0.5 * (before - after) / curve, -1.0), 1.0)
            here = _apart(row, w, point)
            if here < least:
                at, least = w, here
    return math.sqrt(least), at


@compiled
def read_margins(
    rows: Floats, w: Floats, delays: Floats, which: Ints, all_three: bool, read: Floats, stable: Bools
) -> None:
    """Write `READ` columns for each row of coefficients, and whether its loop is stable.

    w: frequencies times Ts, rising; delays: whole samples, each once, which: that of each row. Ms' frequency times Ts;
    gain margin, phase margin (degrees) and delay margin (samples) are inf where not `all_three` are asked for.
    """
    turned, late = np.empty((2, w.size)), np.empty((delays.size, 2, w.size))
    _turned(w, turned)
    for j in range(delays.size):
        _lag(w, delays[j] + 1.0, late[j])
    re, im, fine = np.empty(w.size), np.empty(w.size), np.empty((7, FINE))
    apart, last, point = np.empty(w.size), w.size - 1, fine[:, :1]
    for m in range(rows.shape[0]):
        row = rows[m]
        _response(row, turned, late[which[m]], re, im)
        lowest, least, read[m, 1] = math.inf, math.inf, w[0]
        for i in range(w.size):
            apart[i] = (1.0 + re[i]) * (1.0 + re[i]) + im[i] * im[i]
            least = min(least, apart[i])
        for i in range(w.size):
            low, high = max(i - 1, 0), min(i + 1, last)
            if apart[i] <= least + BESIDE * BESIDE and apart[low] >= apart[i] <= apart[high]:
                deepest, at = _nearest_between(row, w[low], w[high], fine)
                if deepest < lowest:
                    lowest, read[m, 1] = deepest, at
        # Of a response that overflows nothing is read.
        read[m, 0] = 1.0 / lowest if 0.0 < lowest < math.inf else math.inf
        read[m, 2] = read[m, 3] = read[m, 4] = math.inf
        if all_three:
            read[m, 2] = _gain_margin(row, w, re, im, point)
            phase, read[m, 4] = _unit_crossings(row, w, re, im, point)
            read[m, 3] = math.degrees(phase)
        stable[m] = _encloses_nothing(row, turned, re, im)
