"""How a signal's values were kept: rounded to steps, or drawn in straight lines from value to value."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray

__all__ = ["ROUNDED", "on_lines", "step_of"]

ROUNDED = 1e-9  # of a signal's range: values that lie closer are one
OFF_STEP = 0.2  # of a step: values further from a multiple were not rounded to it
# Of a line's samples the second difference is rounding, two steps at most; a kink is so many times that in the median.
# A smooth or a rounded signal bends everywhere, by little more than rounding where it bends at all.
LINE, KINK = 2.01, 10.0


def step_of(signal: FloatArray) -> float:
    """Return the step that all values of a signal are multiples of it apart, in its unit; 0 where there is none."""
    values = np.unique(signal)
    steps = np.diff(values)
    steps = steps[steps > ROUNDED * float(np.ptp(signal))]
    if steps.size < 2:
        return 0.0
    # Neighbours are one step apart, but for the digits in which they are kept.
    step = float(steps[steps < 1.5 * steps.min()].mean())
    away = (values - values[0]) / step
    if float(np.abs(away - np.round(away)).max()) > OFF_STEP:
        return 0.0
    return float(values[-1] - values[0]) / float(np.round(away[-1]))


def on_lines(signal: FloatArray) -> NDArray[np.bool_]:
    """Return which samples but the first and the last lie on straight lines between others while a signal moves.

    signal: shape (N,) -> (N - 2,); none do where it bends nearly everywhere.
    """
    moves = np.diff(signal)
    bend, slope = np.abs(np.diff(moves)), np.maximum(np.abs(moves[:-1]), np.abs(moves[1:]))
    # A single wrong value, however large, makes nothing of the others straight.
    spread = float(np.ptp(np.percentile(signal, (1.0, 99.0))))
    rounding = max(LINE * step_of(signal), ROUNDED * spread)
    kinks = bend[bend > rounding]
    if not kinks.size or not float(np.median(kinks)) > KINK * rounding:
        return np.zeros(bend.size, dtype=bool)
    straight: NDArray[np.bool_] = (bend <= rounding) & (slope > 2.0 * rounding)
    return straight
