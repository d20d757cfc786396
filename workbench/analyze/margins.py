"""Maximum sensitivity, gain, phase and delay margin of the sampled loop with an ideal valve, for one or many.

All of it on the sampled law itself, its hold included, as that is the loop that runs: a continuous model of the same
loop promises margins that sampling has used up.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.analyze.frequency import linear_stable
from workbench.model.checks import instance
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.results import Margins
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients

__all__ = ["loop_margins", "margins"]

ComplexArray = NDArray[np.complex128]

# The grid of w Ts: per decade from its least value, and per turn of the dead time's phase up to the Nyquist frequency.
LEAST, PER_DECADE, PER_TURN, FINE = 1e-6, 40, 60, 41
# Complex numbers that one pass may hold.
MOST = 2_000_000


def margins(loop: Loop) -> Margins:
    """Return the margins of a loop with an ideal valve, as it is sampled, without its output limits and compensator.

    Ms = max |1/(1 + L)| over frequencies up to pi/Ts; gain margin: the least factor on Kc above 1 at which the loop
    becomes unstable; phase margin: the least phase lag, degrees, that does so; delay margin: the least further dead
    time, s, that does so (as a lag of w times it, exact for whole samples). Source of the definitions: K.J. Astrom, T.
    Hagglund, "Advanced PID Control", ISA (2006), sections 4.6 and 7.5. An unstable loop has Ms = inf and margins 0.
    Raises `InvalidValue` for what is no loop.
    """
    instance(loop, Loop, "loop", "a Loop")
    if not linear_stable(loop):
        return Margins(loop, False, math.inf, math.nan, 0.0, 0.0, 0.0)
    Ts, rows = loop.executed.sample_time, coefficients(loop.executed)
    values, at, _ = loop_margins(rows, Ts)
    Ms, gain, phase = (float(v) for v in values[0])
    w = _grid(rows)
    lag, share = _unit_crossings(_response(rows, w))
    delay = float((lag / (w[:-1] * (w[1:] / w[:-1]) ** share)).min()) * Ts
    return Margins(loop, True, Ms, float(at[0]), gain, phase, delay)


def loop_margins(
    rows: FloatArray, sample_time: float, *, all_three: bool = True
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return (Ms, gain margin, phase margin in degrees), shape (M, 3), Ms' frequency (rad/s) and stability, shape (M,).

    rows: coefficient rows (`simulate.coefficients`) of one sample time; the valve's columns play no part. Read off the
    loop's frequency response: the margins mean something for stable loops only, and stability, by the argument
    principle, may be wrong within some per cent of its limit (`frequency.linear_stable` decides there). Where not
    `all_three` are asked for, Ms alone is read and the others are inf: they take as long again.
    """
    w = _grid(rows)
    values, at, stable = np.empty((rows.shape[0], 3)), np.empty(rows.shape[0]), np.empty(rows.shape[0], np.bool_)
    size = max(1, MOST // w.size)
    for begin in range(0, rows.shape[0], size):
        part = slice(begin, begin + size)
        values[part], at[part], stable[part] = _margins(rows[part], w, all_three)
    return values, at / sample_time, stable


def _grid(rows: FloatArray) -> FloatArray:
    """Return frequencies times Ts, rising to pi, at which the responses of these rows are well resolved."""
    longest = float(rows[:, kernel.DELAY].max(initial=0.0)) + 2.0
    # Above the first turn of the dead time's phase the response needs even steps, below it even ratios.
    turn = math.pi / longest
    decades = math.log10(turn / LEAST)
    slow = np.geomspace(LEAST, turn, max(2, math.ceil(PER_DECADE * decades)))
    fast = np.linspace(turn, math.pi, math.ceil(PER_TURN / 2 * longest))
    return np.concatenate([slow, fast[1:]])


def _response(rows: FloatArray, w: FloatArray) -> ComplexArray:
    """`L(exp(jw))` of coefficient rows, w = frequency times Ts, shape (F,) or (M, F) -> (M, F)."""
    back = np.exp(-1j * w)
    if back.ndim == 1:
        back = back[None, :]

    def column(index: int) -> FloatArray:
        values: FloatArray = rows[:, index, None]
        return values

    difference = 1.0 - back
    C = column(kernel.KC) + column(kernel.KI) / difference
    if rows[:, kernel.KD].any():
        C = C + column(kernel.KD) * difference / (column(kernel.TF_TS) - column(kernel.TF) * back)
    if w.ndim == 1:
        # Corner plants share few whole dead times.
        delays, which = np.unique(rows[:, kernel.DELAY], return_inverse=True)
        delayed = np.exp(-1j * w[None, :] * (delays[:, None] + 1.0))[which]
    else:
        delayed = np.exp(-1j * w * (column(kernel.DELAY) + 1.0))
    hold = column(kernel.C0) + column(kernel.C1) * back
    L: ComplexArray = C * column(kernel.GAIN) * hold * delayed / (1.0 - column(kernel.POLE) * back)
    return L


def _margins(rows: FloatArray, w: FloatArray, all_three: bool) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    L = _response(rows, w)
    nearness = np.abs(1.0 + L)
    k = nearness.argmin(axis=1)
    # The peak of |S| again on a grid as fine as the gap around it, then a parabola through its best three points.
    low, high = w[np.maximum(k - 1, 0)], w[np.minimum(k + 1, w.size - 1)]
    near = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, FINE)[None, :]
    close = np.abs(1.0 + _response(rows, near))
    best = np.clip(close.argmin(axis=1), 1, FINE - 2)
    each = np.arange(rows.shape[0])
    before, here, after = close[each, best - 1], close[each, best], close[each, best + 1]
    curve = before - 2.0 * here + after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curve > 0.0, np.clip(0.5 * (before - after) / curve, -1.0, 1.0), 0.0)
        lowest = here - 0.25 * (before - after) * shift
    lowest = np.minimum(np.minimum(lowest, close.min(axis=1)), 1e300)
    with np.errstate(divide="ignore"):
        Ms = 1.0 / np.maximum(lowest, 0.0)
    at = near[each, best] + shift * (high - low) / (FINE - 1)
    unread = np.full(Ms.size, np.inf)
    gain, phase = (_gain_margin(L), _phase_margin(L)) if all_three else (unread, unread)
    return np.column_stack([Ms, gain, phase]), at, _encloses_nothing(rows, w, L)


def _encloses_nothing(rows: FloatArray, w: FloatArray, L: ComplexArray) -> NDArray[np.bool_]:
    """Whether `1 + L`, freed of its poles at z = 1, does not turn about 0: then no closed-loop pole lies outside.

    All other open-loop poles lie inside the unit circle, and the freed function is positive at z = 1 for a stable loop.
    """
    integrators = (rows[:, kernel.KI] != 0.0).astype(int) + (rows[:, kernel.POLE] == 1.0)
    F = (1.0 + L) * (1.0 - np.exp(-1j * w))[None, :] ** integrators[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = np.angle(F[:, 0]) + np.angle(F[:, 1:] / F[:, :-1]).sum(axis=1)
    gain, KC, KI = rows[:, kernel.GAIN], rows[:, kernel.KC], rows[:, kernel.KI]
    alone = np.where(rows[:, kernel.POLE] == 1.0, KC * gain, 1.0 + KC * gain)
    right = np.where(KI != 0.0, KI * gain, alone) > 0.0
    held: NDArray[np.bool_] = right & (np.abs(turned) < 0.5 * math.pi)
    return held


def _gain_margin(L: ComplexArray) -> FloatArray:
    """The least 1/|L| above 1 where L crosses the negative real axis (at the Nyquist frequency L is real)."""
    left = (L.real[:, :-1] < 0.0) & (L.real[:, 1:] < 0.0)
    crossing = left & (np.signbit(L.imag[:, :-1]) != np.signbit(L.imag[:, 1:]))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Log magnitude over phase: both run evenly in the logarithm of frequency.
        size, angle = np.log(np.abs(L)), np.angle(-L)
        share = angle[:, :-1] / (angle[:, :-1] - angle[:, 1:])
        factor = np.exp(-(size[:, :-1] + share * np.diff(size, axis=1)))
    factor = np.where(crossing & (factor > 1.0), factor, np.inf)
    end = L.real[:, -1]
    last = np.where((end < 0.0) & (end > -1.0), -1.0 / np.minimum(end, -1e-300), np.inf)
    least: FloatArray = np.minimum(factor.min(axis=1), last)
    return least


def _phase_margin(L: ComplexArray) -> FloatArray:
    """The least lag (degrees) that turns a point of |L| = 1 into -1; inf where |L| never crosses 1."""
    least: FloatArray = np.degrees(_unit_crossings(L)[0]).min(axis=1)
    return least


def _unit_crossings(L: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return, between each two frequencies, the lag (rad) that turns |L| = 1 there into -1, inf where |L| does not
    cross 1, and the crossing's place between them, 0 .. 1, in log magnitude; shape (M, F - 1) each.
    """
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(L))
    crossing = (size[:, :-1] >= 0.0) != (size[:, 1:] >= 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crossing, size[:, :-1] / (size[:, :-1] - size[:, 1:]), 0.0)
    turn = np.angle(L[:, 1:] / np.where(L[:, :-1] == 0.0, 1.0, L[:, :-1]))
    phase = np.angle(-L[:, :-1]) + share * turn
    # Of lag alone: a point beyond -180 degrees needs nearly a whole turn.
    lag = np.where(crossing, np.remainder(phase, 2.0 * math.pi), np.inf)
    return lag, share
