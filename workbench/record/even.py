"""Whether rows lie on an even grid of time: its sample time, and each row's place on it.

A clock that stamps rows early, late or cut to whole seconds moves stamps, not samples. Its intervals may each be far
from the sample time (every 1.25 s, cut to seconds: 1, 1, 1 and 2 s), but no stamp leaves its place. So the sample time
is taken from several intervals on end, and a row's place from where the rows before it show the grid to lie.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray
from workbench.record.missing import rows_missing
from workbench.record.times import JITTER

__all__ = ["best_grid", "most_uneven", "places"]

UNEVEN = 0.05  # share of intervals that may break the pattern before the file counts as unevenly sampled
FEW = 40  # intervals, of which one may at least
ASTRAY = 0.4  # of the sample time, by which a row's time may miss its place on the even grid
MISSING = 1  # row at most that may be missing between two: its place is filled, as in a resampled record
TOGETHER = 8  # intervals on end that show the sample time; few of them hold a missing row where few are missing
# Of a row's distance from its place, what the places of the rows after it move by, and what their intervals grow by.
FOLLOWED, LEARNT = 1.0 / 6.0, 1.0 / 144.0
ROUNDING = 1e-6  # of the sample time


def places(seconds: FloatArray, values: Sequence[FloatArray] = ()) -> tuple[float, NDArray[np.int64] | None]:
    """Return the sample time, s, and by how many places each row follows the last, shape (N - 1,); 0 after a gap.

    seconds: ascending, shape (N,), two at least; values: of signals, shape (N,) each, nan for none. No places are
    returned where the rows lie on no even grid, or too many are missing; the sample time is then their median interval.
    """
    steps = np.diff(seconds)
    median = float(np.median(steps))
    most = most_uneven(steps.size)
    # Nearly even intervals need no grid: a clock may drift away from every one.
    many = np.rint(np.clip(steps / median, 0.0, MISSING + 2.0)).astype(np.int64)
    fits = (np.abs(steps - many * median) <= JITTER * median) & (many >= 1) & (many <= MISSING + 1)
    if not (fits & (many == 1)).all() and not rows_missing(seconds, values):
        found = _followed(seconds, _usual(seconds), most)
        if found is not None:
            usual, off = best_grid(seconds, found)
            if float(np.abs(off).max()) <= ASTRAY * usual:
                return _plain(usual, median), found
    if int(np.count_nonzero(~fits | (many != 1))) > most:
        return median, None
    moved = np.where(fits, many, 0)
    return _plain(float(steps[fits].sum() / moved.sum()), median), moved


def most_uneven(intervals: int) -> float:
    """Return how many of a file's intervals may break its pattern; of a short file one."""
    return max(UNEVEN * intervals, 1.0 if intervals < FEW else 0.0)


def best_grid(seconds: FloatArray, moved: NDArray[np.int64]) -> tuple[float, FloatArray]:
    """Return the sample time, s, of the grid that is nearest to the rows, and each row's distance from it, s.

    seconds: shape (N,); moved: places from each row to the next, shape (N - 1,), 0 where another stretch begins, whose
    grid has the same sample time and a place in time of its own. Least squares; distances have a mean of 0.
    """
    stretch = np.concatenate([[0], np.cumsum(moved == 0)])
    place = np.concatenate([[0], np.cumsum(moved)]).astype(np.float64)

    def within(values: FloatArray) -> FloatArray:
        # From a stretch's first row on, or digits are lost in large times.
        first = values[np.searchsorted(stretch, stretch)]
        out = values - first
        means = np.bincount(stretch, out) / np.bincount(stretch)
        return np.asarray(out - means[stretch], dtype=np.float64)

    places, times = within(place), within(seconds)
    usual = float(np.sum(places * times) / np.sum(places * places))
    return usual, times - usual * places


def _plain(usual: float, median: float) -> float:
    """Return the sample time, s, as the file writes it where both say the same."""
    return median if abs(usual - median) <= ROUNDING * median else usual


def _usual(seconds: FloatArray) -> float:
    """Return a first guess of the sample time, s, from several intervals on end."""
    together = min(TOGETHER, seconds.size - 1)
    spans = seconds[together:] - seconds[:-together]
    middle = float(np.median(spans))
    near = spans[np.abs(spans - middle) <= middle / together]
    return float(near.mean() if near.size else middle) / together


def _followed(seconds: FloatArray, usual: float, most: float) -> NDArray[np.int64] | None:
    """Return by how many places each row follows the last, 0 after a gap; None where more than `most` are not one.

    usual: the sample time, s, near enough to the true one that it is not lost from one row to the next.
    """
    moved = np.ones(seconds.size - 1, dtype=np.int64)
    times = (seconds / usual).tolist()
    at, period, breaks = _phase(seconds[: 2 * TOGETHER] / usual, times[0]), 1.0, 0
    for k in range(1, len(times)):
        step = max(round((times[k] - at) / period), 1)
        if step != 1:
            breaks += 1
            if breaks > most:
                return None
        if step > MISSING + 1:
            moved[k - 1] = 0
            at = _phase(seconds[k : k + 2 * TOGETHER] / usual, times[k])
            continue
        moved[k - 1] = step
        at += period * step
        away = times[k] - at
        at += FOLLOWED * away
        period += LEARNT * away
    return moved


def _phase(times: FloatArray, first: float) -> float:
    """Return where the first row's place is, in sample times, as the rows after it (shape (M,)) show together."""
    far = np.diff(times) > MISSING + 2.0
    turns = np.exp(2j * np.pi * (times[: int(np.argmax(far)) + 1 if far.any() else None] - first))
    return first + float(np.angle(turns.mean())) / (2.0 * np.pi)
