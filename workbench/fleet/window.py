"""What a window of time leaves of a loop's record."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from workbench.errors import RecordError
from workbench.model.fleet import Settings
from workbench.model.record import Record
from workbench.record.segments import USABLE

__all__ = ["within"]


def within(record: Record, settings: Settings) -> Record:
    """Return the longest stretch of a record within the window, the others as its `rest`. Raises `RecordError`.

    A window without a zone is by the clock of the record's own timestamps.
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
    return replace(longest, rest=others, notes=record.notes, counts=record.counts)


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
