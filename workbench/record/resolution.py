"""Stamps that are rounded about as coarsely as samples are apart: the even clock that explains them.

A spreadsheet's days with five decimals are 0.864 s apart at least: of a record of every second most rows are then one
such step apart, and some two; and of one of every half second, in whole seconds, most share their stamp with another.
Neither an interval nor a row's distance from its place tells the sample time there. What does is that an even clock
explains every stamp to within its resolution: places at random cannot be explained so for long.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray
from workbench.record.missing import DOUBT, rows_missing

__all__ = ["coarse_clock"]

# What written times may be rounded to, s: a minute, a second, and decimals of seconds, minutes, hours and days.
_MINUTE = 60.0
_DECIMALS = (1.0, *(1.0 / 10.0**digits for digits in range(1, 7)))  # of seconds, which may be sample times, too
_WRITTEN = (_MINUTE, 1.0, *(unit / 10.0**digits for unit in (1.0, 60.0, 3600.0, 86_400.0) for digits in range(1, 7)))
WHOLE = 1e-3  # of the resolution, by which stamps may be off its multiples: what is kept of large numbers
FINEST, COARSEST = 0.3, 1.3  # resolutions in a sample time, beyond which this is not looked for
FIT = 0.6  # of the resolution, by which a stamp may miss its place: half of it by rounding, and the clock's own jitter
SPAN = 32  # rows on end, from which the sample time is first guessed
LOOSE, NEAR = 2e-3, 0.01  # resolutions by which a row's place may drift, and by which the guess may be off
IN_TURN = 0.5  # of the change from row to row, below which that between rows further apart tells of several loops
DIGITS = 7  # at most, of the sample times that are tried
# Of rows one resolution apart of which every tenth is missing, a slower clock of a sample time with digits enough makes
# the same stamps. So over the record one in its last digit makes at least so many resolutions, and the root mean square
# of what it drifts from what least squares say is at most so many.
PLAIN, DRIFT = 4.0, 0.05
# Steps that are not the usual one and that the clock explains: five, and ten times those that it leaves unexplained.
SURE, TIMES = 5, 10
_MISSING = 2  # places from a row to the next where one is missing between them


def coarse_clock(seconds: FloatArray, values: Sequence[FloatArray] = ()) -> tuple[FloatArray, str] | None:
    """Return the times of the even clock that explains stamps, s, shape (N,), and what they were, in words.

    seconds: stamps in ascending order, shape (N,), of which some may be the same. values: of signals, shape (N,) each,
    nan for none. Returns None where no even clock explains the stamps, where their resolution is far from the sample
    time, where rows of one stamp are of several loops in turn, or where some of the rows are missing: as values tell,
    or as only a sample time of many digits explains stamps in seconds of which none is there twice.
    """
    if seconds.size < SPAN:
        return None
    steps = np.diff(seconds)
    least = float(steps[steps > 0.0].min(initial=np.inf))
    # Rows that are missing leave steps of two samples, too: only what times are written in is a resolution, and minutes
    # are what many samples are apart.
    unit = next((one for one in _WRITTEN if abs(least - one) <= WHOLE * one), 0.0)
    if not unit:
        return None
    stamps = (seconds - seconds[0]) / unit
    units = np.rint(stamps)
    usual, whole = _guess(units), np.diff(units)
    missing = rows_missing(seconds, values) if usual > 1.0 else False
    uneven = int(np.count_nonzero(whole == 0.0 if usual < 1.0 else whole == _MISSING))
    if (
        not FINEST <= usual <= COARSEST
        or (usual > 1.0 and unit == _MINUTE)
        or uneven < SURE
        or float(np.abs(stamps - units).max()) > WHOLE
        or _alternate(values, round(1.0 / usual))
        or missing
    ):
        return None
    best: tuple[int, float, NDArray[np.int64]] | None = None
    for period, digits in _tried(units, usual, unit).items():
        moved, early = _walked(units, period, 0.0)
        breaks = int(np.count_nonzero(moved != 1)) + early
        # A digit more must explain a row more.
        if breaks * TIMES <= uneven and (best is None or breaks + digits < best[0]):
            best = breaks + digits, period, moved
    if best is None:
        return None
    _, period, moved = best
    note = f"times are rounded to {unit:g} s; taken as those of the even clock, of {period * unit:.6g} s, that they fit"
    note += f" ({DOUBT})" if missing is None else ""
    return seconds[0] + unit * _places(units, period, moved), note


def _alternate(values: Sequence[FloatArray], many: int) -> bool:
    """Whether signals, shape (N,) each, are more alike `many` rows apart than from row to row, as of loops in turn."""
    for signal in values:
        known = signal[np.isfinite(signal)]
        if known.size > many > 1:
            apart, next_to = (float(np.median(np.abs(known[k:] - known[:-k]))) for k in (many, 1))
            if apart < IN_TURN * next_to:
                return True
    return False


def _tried(units: FloatArray, guess: float, unit: float) -> dict[float, int]:
    """Return sample times, in units, near a guess, with their digits in seconds; last what least squares say.

    Of those that rows which are missing might be taken for, only such as are no accident.
    """
    moved, _ = _walked(units, guess, LOOSE)
    place, off = _within(np.concatenate([[0], np.cumsum(moved)]), moved), _within(units, moved)
    least = float(np.sum(place * off) / np.sum(place * place))
    missing, spread = guess > 1.0 and unit in _DECIMALS, float(np.sqrt(np.mean(place * place)))
    out: dict[float, int] = {}
    for digits in range(1, DIGITS + 1):
        for one in (guess, least):
            plain = float(f"{one * unit:.{digits}g}") / unit
            away, last = abs(plain - least), _last_digit(plain * unit, digits) / unit
            sure = away * spread <= DRIFT and last * place.size >= PLAIN
            if sure if missing else away <= NEAR:
                out.setdefault(plain, digits)
    if not missing:
        out.setdefault(least, DIGITS + 1)
    return out


def _last_digit(value: float, digits: int) -> float:
    """Return what one in the last of a value's significant digits is worth."""
    return float(10.0 ** (math.floor(math.log10(value) + 1e-9) - digits + 1))


def _guess(units: FloatArray) -> float:
    """Return the sample time in units, from rows some way apart of which few are missing or part a gap."""
    spans = units[SPAN - 1 :] - units[: 1 - SPAN]
    near = spans[np.abs(spans - np.sort(spans)[spans.size // 2]) <= 1.0]
    return float(near.mean()) / (SPAN - 1)


def _walked(units: FloatArray, usual: float, drift: float) -> tuple[NDArray[np.int64], int]:
    """Return by how many places each row follows the last, shape (N - 1,): 1 or 2 as far as that explains it, else 0.

    What is kept from row to row is where the clock may stand, [low, high] in units, with all stamps so far. Second is
    how many stamps are too early for it: none of their rows begins a stretch, as a clock goes on and not back.
    """
    moved, early = np.ones(units.size - 1, dtype=np.int64), 0
    low, high = units[0] - FIT, units[0] + FIT
    for k, at in enumerate(units[1:].tolist()):
        if at + FIT < low + usual - drift:
            low, high, early = low + usual - drift, high + usual + drift, early + 1
            continue
        for places in (1, _MISSING, 0):
            if not places:
                low, high = at - FIT, at + FIT
                break
            least = max(low + places * (usual - drift), at - FIT)
            most = min(high + places * (usual + drift), at + FIT)
            if least <= most:
                low, high = least, most
                break
        moved[k] = places
    return moved, early


def _within(values: NDArray[np.int64] | FloatArray, moved: NDArray[np.int64]) -> FloatArray:
    """Return values, shape (N,), from the mean of their stretch on."""
    stretch = np.concatenate([[0], np.cumsum(moved == 0)])
    means = np.bincount(stretch, values) / np.bincount(stretch)
    return np.asarray(values - means[stretch], dtype=np.float64)


def _places(units: FloatArray, period: float, moved: NDArray[np.int64]) -> FloatArray:
    """Return the times of the clock, in units, in the middle of where each stretch of stamps lets it stand."""
    places = period * np.concatenate([[0], np.cumsum(moved)])
    first = np.flatnonzero(np.concatenate([[True], moved == 0]))
    off = units - places
    middle = 0.5 * (np.maximum.reduceat(off, first) + np.minimum.reduceat(off, first))
    return np.asarray(places + np.repeat(middle, np.diff([*first, units.size])), dtype=np.float64)
