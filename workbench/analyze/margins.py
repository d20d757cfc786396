"""Maximum sensitivity, gain, phase and delay margin of the sampled loop with an ideal valve, for one or many.

All of it on the sampled law itself, its hold included, as that is the loop that runs: a continuous model of the same
loop promises margins that sampling has used up.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.analyze.frequency import linear_stable
from workbench.analyze.margins_kernel import READ, read_margins
from workbench.model.checks import instance
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.results import Margins
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients

__all__ = ["loop_margins", "margins"]

# The grid of w Ts: per decade from its least value, and per turn of the dead time's phase up to the Nyquist frequency.
LEAST, PER_DECADE, PER_TURN = 1e-6, 40, 60


def margins(loop: Loop) -> Margins:
    """Return the margins of a loop with an ideal valve, as it is sampled, without its output limits and compensator.

    Ms = max |1/(1 + L)| over frequencies up to pi/Ts; gain margin: the least factor on Kc above 1 at which the loop
    becomes unstable; phase margin: the least phase lag, degrees, that does so; delay margin: the least further dead
    time, s, that does so (as a lag of w times it, exact for whole samples). Source of the definitions: K.J. Astrom, T.
    Hagglund, "Advanced PID Control", ISA (2006), sections 4.6 and 7.5. An unstable loop has Ms = inf and margins 0; one
    whose limit lies at a factor on Kc from 0.99 to 1, or a lead of at most 0.01 rad, is told a gain margin of 1, or a
    phase margin of 0. Raises `InvalidValue` for what is no loop.
    """
    instance(loop, Loop, "loop", "a Loop")
    if not linear_stable(loop):
        return Margins(loop, False, math.inf, math.nan, 0.0, 0.0, 0.0)
    Ts = loop.executed.sample_time
    Ms, at, gain, phase, delay = _read(coefficients(loop.executed), all_three=True)[0][0].tolist()
    return Margins(loop, True, Ms, at / Ts, gain, phase, delay * Ts)


def loop_margins(
    rows: FloatArray, sample_time: float, *, all_three: bool = True
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return (Ms, gain margin, phase margin in degrees), shape (M, 3), Ms' frequency (rad/s) and stability, shape (M,).

    rows: coefficient rows (`simulate.coefficients`) of one sample time; the valve's columns play no part. Read off the
    loop's frequency response: the margins mean something for stable loops only, and stability, by the argument
    principle, may be wrong within some per cent of its limit (`frequency.linear_stable` decides there). Where not
    `all_three` are asked for, Ms alone is read and the others are inf.
    """
    read, stable = _read(rows, all_three=all_three)
    return read[:, [0, 2, 3]], read[:, 1] / sample_time, stable


def _read(rows: FloatArray, *, all_three: bool) -> tuple[FloatArray, NDArray[np.bool_]]:
    """What is read off the responses of coefficient rows (see `read_margins`), and which loops are stable."""
    delays, which = np.unique(rows[:, kernel.DELAY], return_inverse=True)
    read, stable = np.empty((rows.shape[0], READ)), np.empty(rows.shape[0], np.bool_)
    read_margins(np.ascontiguousarray(rows), _grid(rows), delays, which, all_three, read, stable)
    return read, stable


def _grid(rows: FloatArray) -> FloatArray:
    """Return frequencies times Ts, rising to pi, at which the responses of these rows are well resolved."""
    longest = float(rows[:, kernel.DELAY].max(initial=0.0)) + 2.0
    # Above the first turn of the dead time's phase the response needs even steps, below it even ratios.
    turn = math.pi / longest
    decades = math.log10(turn / LEAST)
    slow = np.geomspace(LEAST, turn, max(2, math.ceil(PER_DECADE * decades)))
    fast = np.linspace(turn, math.pi, math.ceil(PER_TURN / 2 * longest))
    return np.concatenate([slow, fast[1:]])
