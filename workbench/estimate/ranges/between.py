"""Ranges of a loop whose controller runs faster than the record: between samples OP went where nobody recorded it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from workbench.detect.scan import runs_faster
from workbench.model.numbers import given
from workbench.model.record import FloatArray, Record
from workbench.model.results import Estimate, Intervals

__all__ = ["between_samples"]

# Of a sample: as much older than what moved the valve is an OP that is held from one to the next, when it moved n times
# meanwhile, (n - 1) / 2n. A linear loop's dead time is found to be shorter by it.
OLDER = 0.5
FASTER = "OP's moves come of no linear law of the samples, as where the controller runs faster than the record: "


def between_samples(record: Record, answer: Estimate) -> tuple[Intervals, tuple[str, ...]]:
    """Return an estimate's ranges, and what is to be said of them, where OP moves between samples too (`detect.scan`).

    record: as the controller saw it. When the stem set off, OP was between two recorded values, or beyond: the stick
    band and the jump are known to no less than OP's usual move in such a sample. The dead time may be half a sample
    longer.
    """
    ranges = answer.intervals
    sticks = answer.valve.stick_band > 0.0 and bool(ranges.d or ranges.S)
    if not (sticks or ranges.dead_time) or not runs_faster(record):
        return ranges, ()
    said: list[str] = []
    if sticks:
        doubt = _move_of(record.op, answer.valve_position)
        S, d, J = (
            None if pair is None else (max(pair[0] - doubt, 0.0), pair[1] + doubt)
            for pair in (ranges.S, ranges.d, ranges.J)
        )
        ranges = replace(ranges, S=S, d=d, J=J)
        said.append(
            f"{FASTER}where OP was when the stem set off is known to {given(doubt, 2)} %, its usual move in such a "
            "sample; a faster record would tell"
        )
    if ranges.dead_time is not None:
        low, high = ranges.dead_time
        older = OLDER * record.sample_time
        ranges = replace(ranges, dead_time=(low, high + older))
        said.append(
            f"{'' if said else FASTER}what moved the valve is newer than the recorded OP by up to half a sample, and "
            f"the dead time may be longer than found by as much, {given(older, 3)} s"
        )
    return ranges, tuple(said)


def _move_of(op: FloatArray, stem: FloatArray) -> float:
    """OP's usual move, %, in the samples in which a stem sets off; both of shape (N,)."""
    moves = np.diff(stem) != 0.0
    off = np.flatnonzero(moves[1:] & ~moves[:-1]) + 2
    moved = np.abs(op[off] - op[off - 1]) if off.size else np.abs(np.diff(op))
    return float(np.median(moved))
