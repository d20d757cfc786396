"""Values of PV that the process did not take: they stand out from both neighbours, alone or a few together.

A transmitter's or a historian's single wrong values are no noise that sums of squares can weigh: a handful of them
holds most of a record's squares, and what happens to go with these few samples, a stem that sticks among others, seems
to explain much. The controller did see the sensor's, so that OP stays as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray, Record

__all__ = ["spikes_of", "without_spikes", "words_of_spikes"]

LONGEST = 3  # samples of one spike
# Normal noise stands out by so many of its standard deviations once in some 1e8 samples.
OUT = 7.0
BEYOND = 4.0  # times what PV moves beside it: a sharp peak is no spike
MOST, ROUNDS = 0.03, 3  # of a record: more are the noise that it has; looks at what is left
# The noise is judged by percentiles of how far samples are from the middle of their neighbours, which a few spikes
# leave as they are: in normal noise the 90th, of all of the record, is 1.645 standard deviations, the 80th, of so many
# samples about each, 1.28, of a distance that is sqrt(3/2) of the noise's own.
AROUND = 50
QUANTILE, QUANTILE_AROUND, OF_NOISE, OF_NOISE_AROUND = 90.0, 80.0, 1.645 * 1.5**0.5, 1.28 * 1.5**0.5


def spikes_of(pv: FloatArray) -> NDArray[np.bool_]:
    """Return which samples of PV, shape (N,), are spikes: none where they would be too many."""
    found = np.zeros(pv.size, bool)
    left = pv
    for _ in range(ROUNDS):
        more = _outstanding(left)
        if not more.any():
            break
        # One beside another is seen when that is gone.
        found |= more
        left = _without(pv, found)
    return found if np.count_nonzero(found) <= MOST * pv.size else np.zeros(pv.size, bool)


def _outstanding(pv: FloatArray) -> NDArray[np.bool_]:
    """Which samples stand out, alone or up to LONGEST together."""
    found = np.zeros(pv.size, bool)
    if pv.size < 2 * LONGEST + 4:
        return found
    moves = np.abs(np.diff(pv))
    aside = np.abs(pv[1:-1] - 0.5 * (pv[:-2] + pv[2:]))
    noise = _noise(aside, moves)
    for length in range(1, LONGEST + 1):
        # The samples before and after a spike that begins at the third sample, at the fourth, and so on.
        before, after = pv[1 : pv.size - length - 2], pv[length + 2 : -1]
        level, n = 0.5 * (before + after), before.size
        beside = np.maximum(np.abs(after - before), np.minimum(moves[:n], moves[length + 2 :]))
        out = np.array([pv[2 + i : 2 + i + n] - level for i in range(length)])
        one_way = (out > 0.0).all(axis=0) | (out < 0.0).all(axis=0)
        least = np.abs(out).min(axis=0)
        for first in np.flatnonzero(one_way & (least > OUT * noise[2 : 2 + n]) & (least > BEYOND * beside)).tolist():
            found[first + 2 : first + 2 + length] = True
    return found


def _noise(aside: FloatArray, moves: FloatArray) -> FloatArray:
    """The noise about each sample, shape (N,), EU: at least that of the whole record, and what that resolves."""
    steps = moves[moves > 0.0]
    whole = max(float(np.percentile(aside, QUANTILE)) / OF_NOISE, float(steps.min()) if steps.size else 0.0)
    size = min(AROUND, aside.size)
    parts = aside[: aside.size // size * size].reshape(-1, size)
    around = np.percentile(parts, QUANTILE_AROUND, axis=1) / OF_NOISE_AROUND
    noise = np.repeat(np.maximum(around, whole), size)
    return np.pad(noise, (1, aside.size + 1 - noise.size), mode="edge")


def without_spikes(record: Record) -> Record:
    """Return a record with PV's spikes on straight lines between their neighbours, itself where it has none."""
    spikes = spikes_of(record.pv)
    return replace(record, pv=_without(record.pv, spikes), rest=()) if spikes.any() else record


def _without(pv: FloatArray, spikes: NDArray[np.bool_]) -> FloatArray:
    at, kept = np.arange(pv.size), ~spikes
    return np.interp(at, at[kept], pv[kept])


def words_of_spikes(record: Record, seen: Record) -> tuple[str, ...]:
    """Return in words how many samples of PV are spikes, where any are; seen: the record without them."""
    count = int(np.count_nonzero(record.pv != seen.pv))
    if count == 0:
        return ()
    many = "1 sample of PV stands" if count == 1 else f"{count} samples of PV stand"
    what = "out from its neighbours as nothing else in the record does: taken for the sensor's or the historian's"
    return (f"{many} {what}, not for the process, and left out",)
