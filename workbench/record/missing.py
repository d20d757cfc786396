"""Single rows that are missing all along, as every sixth, or a slower clock in whole seconds: what tells them apart.

A clock of 1.2 s in whole seconds and one of 1 s of which every sixth row is missing stamp rows alike: 0, 1, 2, 3, 4,
6 s. But over two seconds a signal moves further than over one, and from row to row of the slower clock equally far.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray

__all__ = ["DOUBT", "doubt_said", "missing_said", "rows_missing"]

WHOLE = 0.05  # of the least interval, by which others may be off its multiples
SHARE = 0.95  # of the intervals that are one or two of these
DOUBT = "or single rows are missing: neither the times nor the values tell"
SLOWER = 1.02  # of the least interval, from which a sample time is that of a slower clock
FEWEST = 20  # places where a row may be missing that must show it
# A signal's change over two intervals, in those over one beside them, and of how many standard errors it is more.
FURTHER, SURE = 1.25, 4.0


def _double(seconds: FloatArray) -> tuple[NDArray[np.bool_], float]:
    """Return which intervals, shape (N - 1,), are two of the least one, and that, s; none where many are neither."""
    steps = np.diff(seconds)
    none = np.zeros(steps.size, dtype=bool)
    least = float(np.percentile(steps, 5.0)) if steps.size else 0.0
    one, two = (np.abs(steps - many * least) <= WHOLE * least for many in (1.0, 2.0))
    # Where more intervals are doubled than not, that is the usual one.
    if not one.any() or float((one | two).mean()) < SHARE or np.count_nonzero(two) > np.count_nonzero(one) + 1:
        return none, 0.0
    return two, float(f"{np.median(steps[one]):.4g}")


def rows_missing(seconds: FloatArray, values: Sequence[FloatArray]) -> bool | None:
    """Whether signals move so much further over intervals of twice the least one that a row is missing there.

    seconds: ascending, shape (N,); values: of signals, shape (N,) each, nan for none. Returns None where neither this
    nor the contrary is sure, as of noise.
    """
    two, _ = _double(seconds)
    # Beside one that may hold a missing row stand two that do not.
    at = 1 + np.flatnonzero(two[1:-1] & ~two[:-2] & ~two[2:])
    told = at.size < FEWEST
    for signal in () if told else values:
        change = np.abs(np.diff(signal))
        beside = 0.5 * (change[at - 1] + change[at + 1])
        more = change[at] - beside
        known = np.isfinite(more)
        total, base, many = float(np.sum(more[known])), float(np.sum(beside[known])), int(np.count_nonzero(known))
        error = SURE * float(more[known].std()) * math.sqrt(many) if many else 0.0
        if many >= FEWEST and total > max((FURTHER - 1.0) * base, error):
            return True
        # As far as the signal moves over two intervals of the rows, it would move over one with a row missing in it.
        twice = float(np.nansum(np.abs(signal[2:] - signal[:-2]))) / max(float(np.nansum(change)), 1e-300)
        told |= many >= FEWEST and total + error < (min(twice, 2.0) - 1.0) * base
    return False if told else None


def missing_said(seconds: FloatArray) -> tuple[str, float] | None:
    """Return in words which rows are missing one by one, and the interval without these, s; None where none are."""
    two, least = _double(seconds)
    place = np.flatnonzero(two) + np.arange(1, np.count_nonzero(two) + 1)
    if not place.size:
        return None
    apart = np.diff(place)
    usual = int(np.median(apart)) if apart.size else 0
    if apart.size and float((apart == usual).mean()) >= SHARE:
        return f"every {_ordinal(usual)} row is missing", least
    return f"{place.size} single rows are missing", least


def doubt_said(seconds: FloatArray, values: Sequence[FloatArray], usual: float) -> list[str]:
    """Return a note where rows that are taken as every `usual` s may be faster ones with some missing, or none."""
    missing = missing_said(seconds)
    if missing is None or usual < SLOWER * missing[1] or rows_missing(seconds, values) is not None:
        return []
    return [f"taken as every {usual:.6g} s, {DOUBT}"]


def _ordinal(number: int) -> str:
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
