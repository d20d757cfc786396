"""A PV that is recorded later than the controller saw it: OP then answers what the record shows only samples on.

Historians take PV and OP from different sources, and a PV that is filtered, or kept until it has changed enough, comes
late. OP then foretells PV's noise, which no valve between the two lets through: a stem that sticks is excluded,
wrongly, and a plant that is the controller's inverse fits. The controller gives it away: its law holds with PV some
samples ahead, and with no PV up to now.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from workbench.detect.causes import constant, refuse_unusable
from workbench.detect.spikes import without_op_spikes, without_spikes
from workbench.model.numbers import given
from workbench.model.record import FloatArray, Record

__all__ = ["Late", "as_seen", "earlier", "late", "later", "words_of_late"]

LATEST = 10  # samples that PV may be late
PAST = 6  # samples of PV, up to now, from which OP's moves may come otherwise: more than PID or a filter needs
FEWEST = 100  # samples
# What the law leaves at most of OP's moves, and of what the past leaves of them. Where nothing is late it leaves of
# these 1.5 times as much and more in 42 labelled records (in another .64 times, in the last it explains nothing), .8
# times in simulated PID loops, and beside a knocker .64 times, but .56 of the moves; a plant's answer to an OP that is
# moved at random, taken for a law, leaves .43 of the moves. The labelled records were in view when these were chosen.
LEAVES, LESS = 0.4, 0.6
PERHAPS = 0.8  # of either: not enough to look at the loop otherwise, too much to acquit it
MATTERS = 0.02  # of OP's moves: where the past tells so much of them, PV ahead tells nothing that is new
CERTAIN = 3.0  # standard errors that the integral action is away from none; in a plant's answer it has the other sign
NOUGHT, DEPENDENT = 1e-9, 1e-10  # shares of OP's moves, and of what error and its change are together: rounding


class Late(NamedTuple):
    """PV's delay in samples, 0 where none is seen, and whether SP is as late; perhaps: one that is not sure."""

    samples: int = 0
    with_sp: bool = False
    perhaps: bool = False


def late(record: Record) -> Late:
    """Return how much later than the controller saw it PV is recorded, ten samples at most.

    OP's moves are regressed on error and its change at each number of samples ahead, as a PI controller has them, and,
    for comparison, on the errors and setpoints of the past.
    """
    n = len(record)
    if n < FEWEST or constant(record.pv):
        return Late()

    def at(signal: FloatArray, ahead: int) -> FloatArray:
        return signal[PAST + ahead : n - LATEST + ahead]

    moves = np.diff(at(record.op, 0), prepend=record.op[PAST - 1])
    moves = moves - moves.mean()
    power = float(moves @ moves)
    if not power > 0.0:
        return Late()
    sp = np.zeros(n) if record.sp is None else record.sp
    moved = bool(np.ptp(sp) > 0.0)
    past = [at(sp - record.pv, -back) for back in range(PAST)]
    past += [at(sp, -back) for back in range(2)] if moved else []
    least = _left(np.column_stack(past), moves) / power
    if least <= MATTERS:
        return Late()
    best, found, perhaps = min(LEAVES, LESS * least, least - MATTERS), Late(), False
    for ahead in range(1, LATEST + 1):
        for with_sp in (False, True)[: 1 + moved]:
            now, before = (at(sp, back + ahead * with_sp) - at(record.pv, back + ahead) for back in (0, -1))
            left, feedback = _law(now - before, now, moves)
            if left / power < best and feedback > CERTAIN:
                best, found = left / power, Late(ahead, with_sp)
            likely = left / power < min(PERHAPS, PERHAPS * least, least - MATTERS)
            perhaps = perhaps or (likely and feedback > -CERTAIN)
    return found if found.samples else Late(perhaps=perhaps)


def as_seen(record: Record, purpose: str) -> tuple[Record, Late]:
    """Return a record with OP as much later as PV is late, as the controller saw them, and that; without spikes.

    PV keeps its times; OP, and SP where it is not as late itself, begin with their first values. Raises `RecordError`
    for a record that cannot be used for its purpose, in words (see `refuse_unusable`).
    """
    refuse_unusable(record, purpose)
    # The controller answered the sensor's spikes too.
    record = without_op_spikes(record)
    found, record = late(record), without_spikes(record)
    if found.samples == 0:
        return record, found
    stem = None if record.valve_position is None else later(record.valve_position, found.samples)
    sp = record.sp if record.sp is None or found.with_sp else later(record.sp, found.samples)
    return replace(record, op=later(record.op, found.samples), sp=sp, valve_position=stem, rest=()), found


def later(signal: FloatArray, samples: int) -> FloatArray:
    """Return a signal, shape (N,), so many samples later; its first value stands before it."""
    return np.concatenate([np.full(samples, signal[0]), signal[: signal.size - samples]])


def earlier(signal: FloatArray, samples: int) -> FloatArray:
    """Return a signal, shape (N,), so many samples earlier; its last value stands after it."""
    return np.concatenate([signal[samples:], np.full(samples, signal[-1])])


def words_of_late(record: Record, found: Late) -> tuple[str, ...]:
    """Return in words that PV is late, where it is."""
    if found.samples == 0:
        return ()
    both = "PV and SP are" if found.with_sp else "PV is"
    by = f"{given(found.samples * record.sample_time, 3)} s ({found.samples} sample{'s' if found.samples > 1 else ''})"
    seen = "OP answers PV before the record shows it; the loop is looked at as the controller saw it"
    return (f"{both} recorded {by} later than the controller saw it: {seen}",)


def _left(columns: FloatArray, moves: FloatArray) -> float:
    """Return the squares of OP's moves that columns, shape (N, M), leave."""
    columns = columns - columns.mean(axis=0)
    scale = np.sqrt((columns**2).sum(axis=0))
    columns = columns / np.where(scale > 0.0, scale, 1.0)
    terms, *_ = np.linalg.lstsq(columns, moves, rcond=1e-10)
    return float(((moves - columns @ terms) ** 2).sum())


def _law(change: FloatArray, error: FloatArray, moves: FloatArray) -> tuple[float, float]:
    """Return the squares of OP's moves that a PI law leaves, and its integral action in standard errors.

    That is positive where both actions have one sign.
    """
    change, error = change - change.mean(), error - error.mean()
    pp, pi, ii = float(change @ change), float(change @ error), float(error @ error)
    det = pp * ii - pi * pi
    if not det > DEPENDENT * pp * ii:
        return math.inf, 0.0
    with_change, with_error = float(change @ moves), float(error @ moves)
    proportional = (with_change * ii - with_error * pi) / det
    integral = (with_error * pp - with_change * pi) / det
    left = float(((moves - proportional * change - integral * error) ** 2).sum())
    spread = math.sqrt(max(left, NOUGHT * float(moves @ moves)) * pp / det / moves.size)
    return left, math.copysign(1.0, proportional) * integral / spread
