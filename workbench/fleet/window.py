"""What a window of time leaves of a loop's record, and what its notes then say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from workbench.errors import RecordError
from workbench.model.fleet import Settings
from workbench.model.record import Record
from workbench.record.checks import held_said, op_said, setpoint_said
from workbench.record.segments import USABLE

__all__ = ["WINDOW", "within"]

WINDOW = "window"  # a count, of samples, that only the record of a window has


def within(record: Record, settings: Settings) -> Record:
    """Return the longest stretch of a record within the window, the others as its `rest`. Raises `RecordError`.

    A window without a zone is by the clock of the record's own timestamps. The notes on what the signals do are those
    of what is left, and the others are said to be of the whole record.
    """
    begin = -math.inf if settings.begin is None else _instant(record, settings.begin, settings.zoned)
    end = math.inf if settings.end is None else _instant(record, settings.end, settings.zoned)
    if settings.last is not None:
        latest = max(one.epoch + one.start + len(one) * one.sample_time for one in record.segments)
        begin = max(begin, min(latest, end) - settings.last)
    if begin == -math.inf and end == math.inf:
        return record
    kept: list[Record] = []
    for one in record.segments:
        at = one.epoch + one.time
        where = np.flatnonzero((at >= begin - 1e-9) & (at < end - 1e-9))
        if where.size >= USABLE:
            part = slice(int(where[0]), int(where[-1]) + 1)
            kept.append(
                replace(
                    one,
                    pv=one.pv[part],
                    op=one.op[part],
                    sp=None if one.sp is None else one.sp[part],
                    valve_position=None if one.valve_position is None else one.valve_position[part],
                    mode=None if one.mode is None else one.mode[part],
                    start=float(one.time[part.start]),
                )
            )
    if not kept:
        raise RecordError(f"{record.source}: no {USABLE} samples on end within the window of time")
    longest = max(kept, key=len)
    others = tuple(replace(one, notes=()) for one in kept if one is not longest)
    if sum(map(len, kept)) == sum(map(len, record.segments)):
        return replace(longest, rest=others, notes=record.notes, counts=record.counts)
    left = replace(longest, rest=others)
    return replace(left, notes=_notes(record, left), counts=_counts(record, left))


def _instant(record: Record, bound: float, zoned: bool) -> float:
    """Return a bound of the window as `epoch` + `time` of a record counts it. Raises `RecordError`."""
    if not zoned:
        return record.instant(bound)
    if not record.zone:
        raise RecordError(
            f"{record.source}: the window of time has a zone, and the record's times have none; give --from and --to "
            "without one, by the record's own clock"
        )
    return bound


def _said(record: Record, even: bool) -> list[str]:
    """Return what reading says of how a record's signals behave; even: whether its samples are the rows themselves.

    What the range of OP says of its unit is a matter of the whole record.
    """
    return [
        *(held_said(record.pv, record.op, np.ones(len(record), dtype=bool)) if even else []),
        *op_said(record.op, scaled=True),
        *(setpoint_said(record.sp, record.pv, record.op) if record.sp is not None else []),
    ]


def _notes(record: Record, left: Record) -> tuple[str, ...]:
    """Return the notes of what a window leaves of a record."""
    even = "resampled" not in record.counts
    behaviour = _said(record, even)
    read = [note for note in record.notes if note not in behaviour and not note.startswith("first timestamp")]
    return (*_said(left, even), *([f"of the whole record: {'; '.join(read)}"] if read else []))


def _counts(record: Record, left: Record) -> dict[str, int]:
    """Return the counts of what a window leaves; samples between recorded values are taken to be as many everywhere."""
    many = sum(map(len, left.segments))
    counts = {"kept": len(left), WINDOW: many}
    between = record.counts.get("between", 0)
    if between:
        counts["between"] = round(between * many / sum(map(len, record.segments)))
    return counts | ({"manual": record.counts["manual"]} if "manual" in record.counts else {})
