"""Values that no process took and no controller sent: they stand out from both neighbours, alone or a few together.

A transmitter's or a historian's single wrong values are no noise that sums of squares can weigh: a handful of them
holds most of a record's squares, and what happens to go with these few samples, a stem that sticks among others, seems
to explain much. A valve that sticks over more than such a value of OP would explain why PV does not care.

OP is what the controller sent: a setpoint step and derivative action send one value that stands out, and so does a
sensor's spike, which the controller did see. Such values stay (see `op_spikes_of`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray, Record

__all__ = ["TRAVEL", "op_spikes_of", "spikes_of", "without_op_spikes", "without_spikes", "words_of_spikes"]

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
# Samples from before to after a jump of OP in which what it answers, or what answers it, is looked for: PV may be
# recorded some samples late.
BEFORE, AFTER = 2, 10
EXPLAINED = 0.05  # of a jump: a coarse PV tells roughly how the controller answers; by chance less of a large jump
TRAVEL = 100.0  # %, all of a valve's: no controller sends a larger jump
RARELY = 99.0  # percentile of SP's moves: a larger one is a step
# Without SP: a setpoint step moves OP for good besides, by one part in eleven of a derivative filtered at N = 10, in 61
# of one unfiltered over 60 samples. What comes back to a hundredth, or to what it moves by anyway, is no step's.
BACK, ANYWAY = 0.01, 4.0
WIDER = 2.0  # times all that OP does else: without SP a smaller value may be the controller's, and harms little

_OF_PV = (
    " as nothing else in the record does: taken for the sensor's or the historian's, not for the process, and left out"
)
_OF_OP = (
    ", and neither SP nor PV moves with it: taken for the historian's, not for what the valve was sent, and left out"
)


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


def op_spikes_of(record: Record) -> NDArray[np.bool_]:
    """Return which samples of OP, shape (N,), are spikes that neither a setpoint step nor PV nor the stem explains.

    OP's moves are regressed on those of PV, SP and a measured stem, about them, all without their spikes: this is how
    the controller answers PV, and PV the valve. A jump stays if the same law makes some of it of what PV does
    there, PV's spikes included, unless it is larger than all of a valve's travel.
    """
    op, n = record.op, len(record)
    found = spikes_of(op)
    if not found.any():
        return found
    first = np.flatnonzero(found & ~np.concatenate([[False], found[:-1]]))
    stop = np.flatnonzero(found & ~np.concatenate([found[1:], [False]])) + 1
    clean = _without(op, found)
    others = [one for one in (record.pv, record.sp, record.valve_position) if one is not None]
    law, *_ = np.linalg.lstsq(
        np.hstack([_about(np.diff(_without(one, spikes_of(one)))) for one in others]), np.diff(clean), rcond=1e-10
    )
    answered = np.hstack([_about(np.diff(one)) for one in others]) @ law
    jumps, width = np.diff(op), float(np.ptp(clean))
    steps = np.zeros(n - 1) if record.sp is None else np.abs(np.diff(record.sp))
    stepped = _about(np.where(steps > np.percentile(steps, RARELY), 1.0, 0.0)).max(axis=1) > 0.0
    for a, b in zip(first.tolist(), stop.tolist(), strict=True):
        ends = [a - 1, b - 1]
        own = bool((answered[ends] * jumps[ends] >= EXPLAINED * jumps[ends] ** 2).any())
        height = float(np.abs(op[a:b] - clean[a:b]).max())
        away = abs(float(op[b] - op[a - 1])) if record.sp is None else 0.0
        stays = away > max(BACK * height, ANYWAY * float(np.abs(np.diff(clean)).mean()))
        # Where SP is recorded, what it sends is known.
        small = record.sp is None and height < WIDER * width
        sent = (own or stays or small) and height <= TRAVEL
        if sent or stepped[ends].any():
            found[a:b] = False
    return found


def _about(moves: FloatArray) -> FloatArray:
    """Return the moves of a signal, shape (N - 1,), from BEFORE to AFTER each of them, side by side."""
    padded = np.pad(moves, (BEFORE, AFTER))
    return np.lib.stride_tricks.sliding_window_view(padded, BEFORE + AFTER + 1)


def without_op_spikes(record: Record) -> Record:
    """Return a record with OP's spikes on straight lines between their neighbours, itself where it has none."""
    spikes = op_spikes_of(record)
    return replace(record, op=_without(record.op, spikes), rest=()) if spikes.any() else record


def without_spikes(record: Record) -> Record:
    """Return a record with PV's spikes on straight lines between their neighbours, itself where it has none."""
    spikes = spikes_of(record.pv)
    return replace(record, pv=_without(record.pv, spikes), rest=()) if spikes.any() else record


def _without(signal: FloatArray, spikes: NDArray[np.bool_]) -> FloatArray:
    at, kept = np.arange(signal.size), ~spikes
    return np.interp(at, at[kept], signal[kept])


def words_of_spikes(record: Record) -> tuple[str, ...]:
    """Return in words how many samples of PV and of OP are spikes, where any are."""
    said = []
    for name, spikes, told in (
        ("PV", spikes_of(record.pv), _OF_PV),
        ("OP", op_spikes_of(record), _OF_OP),
    ):
        count = int(np.count_nonzero(spikes))
        if count:
            many = (
                f"1 sample of {name} stands out from its"
                if count == 1
                else f"{count} samples of {name} stand out from their"
            )
            said.append(f"{many} neighbours{told}")
    return tuple(said)
