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
FINE = 41  # points between the neighbours of the least of a grid


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
def _gain_margin(re: Floats, im: Floats) -> float:
    """The least 1/|L| above 1 where L crosses the negative real axis (at the Nyquist frequency L is real)."""
    least, last = math.inf, re.size - 1
    for i in range(last):
        if re[i] < 0.0 and re[i + 1] < 0.0 and (im[i] < 0.0) != (im[i + 1] < 0.0):
            # Log magnitude over phase: both run evenly in the logarithm of frequency.
            here, there = math.atan2(-im[i], -re[i]), math.atan2(-im[i + 1], -re[i + 1])
            size, next_size = math.log(math.hypot(re[i], im[i])), math.log(math.hypot(re[i + 1], im[i + 1]))
            factor = math.exp(-(size + here / (here - there) * (next_size - size)))
            if 1.0 < factor < least:
                least = factor
    if -1.0 < re[last] < 0.0:
        least = min(least, -1.0 / re[last])
    return least


@compiled
def _unit_crossings(w: Floats, re: Floats, im: Floats) -> tuple[float, float]:
    """Return the least lag, rad, that turns a point of |L| = 1 into -1, and the least over frequency; inf without."""
    phase, delay = math.inf, math.inf
    above = re[0] * re[0] + im[0] * im[0] >= 1.0
    for i in range(w.size - 1):
        here, above = above, re[i + 1] * re[i + 1] + im[i + 1] * im[i + 1] >= 1.0
        if here != above:
            size, next_size = math.log(math.hypot(re[i], im[i])), math.log(math.hypot(re[i + 1], im[i + 1]))
            share = min(max(size / (size - next_size), 0.0), 1.0)
            across, along = re[i] * im[i + 1] - im[i] * re[i + 1], re[i] * re[i + 1] + im[i] * im[i + 1]
            angle = math.atan2(-im[i], -re[i]) + share * math.atan2(across, along)
            # Of lag alone: a point beyond -180 degrees needs nearly a whole turn.
            lag = angle % (2.0 * math.pi)
            phase = min(phase, lag)
            delay = min(delay, lag / (w[i] * (w[i + 1] / w[i]) ** share))
    return phase, delay


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
    re, im = np.empty(w.size), np.empty(w.size)
    near, near_turned, near_late = np.empty(FINE), np.empty((2, FINE)), np.empty((2, FINE))
    near_re, near_im = np.empty(FINE), np.empty(FINE)
    for m in range(rows.shape[0]):
        row = rows[m]
        _response(row, turned, late[which[m]], re, im)
        k, _ = _nearest(re, im)
        # The peak of |S| again on a grid as fine as the gap around it, then a parabola through its best three points.
        low, high = w[max(k - 1, 0)], w[min(k + 1, w.size - 1)]
        for i in range(FINE):
            near[i] = low + (high - low) * (i / (FINE - 1))
        _turned(near, near_turned)
        _lag(near, row[DELAY] + 1.0, near_late)
        _response(row, near_turned, near_late, near_re, near_im)
        k, least = _nearest(near_re, near_im)
        lowest, k = math.sqrt(least), min(max(k, 1), FINE - 2)
        before, here = math.hypot(1.0 + near_re[k - 1], near_im[k - 1]), math.hypot(1.0 + near_re[k], near_im[k])
        after = math.hypot(1.0 + near_re[k + 1], near_im[k + 1])
        curve, shift = before - 2.0 * here + after, 0.0
        if curve > 0.0:
            shift = min(max(0.5 * (before - after) / curve, -1.0), 1.0)
        lowest = min(lowest, here - 0.25 * (before - after) * shift)
        read[m, 0] = 1.0 / lowest if lowest > 0.0 else math.inf
        read[m, 1] = near[k] + shift * (high - low) / (FINE - 1)
        read[m, 2] = read[m, 3] = read[m, 4] = math.inf
        if all_three:
            read[m, 2] = _gain_margin(re, im)
            phase, read[m, 4] = _unit_crossings(w, re, im)
            read[m, 3] = math.degrees(phase)
        stable[m] = _encloses_nothing(row, turned, re, im)
