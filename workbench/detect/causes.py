"""What else may be the matter with a loop: saturation, a sensor that stands still, a setpoint that cycles, manual."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from workbench.detect.oscillation import oscillation_of
from workbench.detect.resolution import exception_of
from workbench.detect.spikes import TRAVEL
from workbench.detect.verdict import Thresholds, times
from workbench.errors import RecordError
from workbench.model.detection import Oscillation
from workbench.model.numbers import given
from workbench.model.record import FloatArray, Record
from workbench.record.modes import manual_share
from workbench.record.rounding import on_lines, step_of

__all__ = [
    "FEWEST_SAMPLES",
    "RESOLVED",
    "along_lines",
    "below_step",
    "between_values",
    "beyond_op",
    "constant",
    "dead_signal",
    "kept_by_exception",
    "no_percent",
    "other_causes",
    "refuse_unusable",
    "steady_stretches",
]

FEWEST_SAMPLES = 30
FEWEST_CHANGES = 8  # of PV's value: fewer have no shape, and any stem has a move for each
STILL = 1e-9  # of a signal's size, which counts as this much at least (EU, %): a signal that moves by less is constant
HUGEST = 1e40  # EU, %: the sixth powers of larger values, of which the bicoherence is made, may overflow
MUCH = 0.2  # of the record, worth a word
HALF = 0.5  # of the record and of OP's range: PV no longer tells about the valve
RESOLVED = 0.1  # % of travel: positioners hardly follow less
ALIKE = 0.2  # relative difference of two periods that are one
USUAL, WIDER = (5.0, 95.0), 2.0  # percentiles of OP; a band so many times wider than they are apart rests on the rest
# Share of PV's samples that lie between recorded values: from the one on no range holds, from the other on no shape.
OFTEN, BETWEEN = 0.5, 0.9
# Share of PV on straight lines from which its innovations are the historian's work too. By simulation a stem must then
# explain a tenth of PV's variance, or nearly all that the linear loop leaves: of 240 healthy loops' records so drawn 95
# were accused, 89 of them by stems that explain less; of 56 sticking ones' that were found 22 explain as much.
DRAWN, EXPLAINS, ALL_LEFT = 0.25, 0.1, 0.9
STEADY = 1.0 / 3.0  # of the record, the least stretch at constant SP that may stand for its cycle
CYCLES = 0.5  # oscillation index of a setpoint that cycles


def refuse_unusable(record: Record, purpose: str) -> None:
    """Raise `RecordError` for a record of fewer than 30 samples, or with values that no plant has.

    purpose: what the samples are needed for, in words.
    """
    where, n = record.source or "record", len(record)
    if n < FEWEST_SAMPLES:
        lost = record.notes if n < record.counts.get("rows", n) else ()
        why = "".join(f"; {note}" for note in lost if not note.startswith("first timestamp"))
        msg = f"{where}: {n} samples given; at least {FEWEST_SAMPLES} are needed to {purpose}{why}"
        raise RecordError(msg)
    for name, signal in (("SP", record.sp), ("PV", record.pv), ("OP", record.op)):
        largest = 0.0 if signal is None else float(np.abs(signal).max())
        if largest > HUGEST:
            msg = f"{where}: {name} reaches {largest:g}: no signal of a plant"
            raise RecordError(msg)


def constant(signal: FloatArray) -> bool:
    """Return whether a signal (EU or %, shape (N,)) moves by no more than rounding, or not at all."""
    return bool(np.ptp(signal) <= STILL * max(STILL, float(np.abs(signal).max())))


def _longest_stay(signal: FloatArray) -> tuple[int, int]:
    """Return [first, stop) of the longest stretch in which a signal keeps its value exactly."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(signal) != 0.0) + 1, [signal.size]])
    longest = int(np.argmax(np.diff(edges)))
    return int(edges[longest]), int(edges[longest + 1])


def steady_stretches(record: Record) -> list[tuple[int, int]]:
    """Return each stretch [first, stop) of at least a third of the record at constant SP, or the whole without one.

    The longest comes first. The published statistics of a cycle take it to be stationary: a setpoint change would
    outweigh it.
    """
    n = len(record)
    if record.sp is None:
        return [(0, n)]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(record.sp) != 0.0) + 1, [n]]).tolist()
    long = [(a, b) for a, b in pairwise(edges) if b - a >= STEADY * n]
    return sorted(long, key=lambda ends: ends[0] - ends[1]) or [(0, n)]


def dead_signal(record: Record) -> str:
    """Say that PV or OP cannot tell about the valve, or return nothing.

    PV that keeps one value over half the record while OP moves over half its range tells only that PV did not answer.
    """
    n = len(record)
    for name, signal, why in (("PV", record.pv, "frozen or saturated"), ("OP", record.op, "in manual or saturated")):
        if constant(signal):
            return f"{name} is constant over all {n} samples ({why}): nothing can be told about the valve"
    width = float(np.ptp(record.op))
    if width < RESOLVED:
        return (
            f"OP moved over {given(width, 2)} % of travel only, less than a valve resolves ({RESOLVED:g} %): give its "
            "range if it is in another unit, such as a fraction of 1; else a longer record or a setpoint move would "
            "tell about the valve"
        )
    moves = int(np.count_nonzero(np.diff(record.op)))
    if moves <= Thresholds().few:
        only = f"OP moved {times(moves)} only in {n} samples"
        return f"{only}: a longer record or a setpoint move would tell about the valve"
    changes = int(np.count_nonzero(np.diff(record.pv)))
    if changes < FEWEST_CHANGES:
        return (
            f"PV took another value {times(changes)} only in {n} samples: it was kept too coarsely to show its moves; "
            "a record of every value would tell about the valve"
        )
    first, stop = _longest_stay(record.pv)
    moved = float(np.ptp(record.op[first:stop]))
    if stop - first >= HALF * n and moved >= HALF * float(np.ptp(record.op)):
        return (
            f"PV kept the value {given(record.pv[first], 4)} over {(stop - first) / n:.0%} of the record while OP "
            f"moved by {given(moved, 3)} %: a valve that no longer moves, no flow, or a sensor at its end or frozen"
        )
    return ""


def beyond_op(op: FloatArray, band: float) -> str:
    """Say that a stick band, %, is wider than any valve's travel, or than OP (%, shape (N,)) usually moves; or nothing.

    A cycle that a sticking valve makes takes OP over all of its band. A few values that nobody sent, or another unit,
    make a band of any width.
    """
    usual = float(np.ptp(np.percentile(op, USUAL)))
    if band > TRAVEL:
        said = "no valve travels so far: give OP's range if it has another unit, or look for values that were not sent"
    elif band > WIDER * usual:
        only = f"OP usually moves over {given(usual, 3)} % only"
        said = f"{only}, and the band rests on the few values beyond: were they sent?"
    else:
        return ""
    return f"a band of {given(band, 4)} % fits best, yet {said}"


def no_percent(op: FloatArray) -> str:
    """Say that OP (%, shape (N,)) has another unit: it stays where no valve in % is; or nothing."""
    low, high = np.percentile(op, USUAL).tolist()
    if low <= 2.0 * TRAVEL and high >= -TRAVEL:
        return ""
    return (
        f"OP usually lies between {given(low, 4)} and {given(high, 4)}, which is no output in %: stiction and gain are "
        "in its own unit; give the range that it calls 0 and 100 %"
    )


def below_step(op: FloatArray, band: float) -> str:
    """Say that a stick band, %, is narrower than the steps in which OP (%, shape (N,)) is recorded; or nothing."""
    step = step_of(op)
    if not 0.0 < band < step:
        return ""
    return f"OP is recorded in steps of {given(step, 3)} %: a band of {given(band, 3)} % is none that it can show"


def _between(record: Record) -> float:
    """The share of PV's samples that lie between recorded values."""
    return record.counts.get("between", 0) / (len(record) + sum(len(one) for one in record.rest))


def kept_by_exception(record: Record) -> str:
    """Say that a historian kept PV only now and then, so that no range holds what it left out; or nothing."""
    if deviation := exception_of(record.pv):
        how = f"PV was kept only where it had moved by {given(deviation, 2)} EU"
    elif (share := _between(record)) >= OFTEN:
        how = f"{share:.0%} of PV's samples lie between the values that were recorded"
    else:
        return ""
    return f"{how}: what it did meanwhile is not known, and no range allows for it"


def between_values(record: Record) -> str:
    """Say that hardly a sample of PV is a recorded value; or nothing."""
    share = _between(record)
    if share < BETWEEN:
        return ""
    return (
        f"{share:.0%} of PV's samples lie between the values that were recorded: how PV moved there is not known, and "
        "a valve that sticks looks the same as a historian that keeps changes alone; a record of all samples would tell"
    )


def along_lines(record: Record, unexplained: float, simulated: float) -> str:
    """Say that PV foretells itself along the straight lines that it was drawn in, and a stem tells no more; or nothing.

    unexplained: share of PV's variance that the linear loop's simulated PV leaves; simulated: what of it the stem
    explains.
    """
    share = max(float(np.mean(on_lines(record.pv))), _between(record))
    if share < DRAWN or simulated * unexplained >= EXPLAINS or simulated >= ALL_LEFT:
        return ""
    return (
        f"{share:.0%} of PV's samples lie on straight lines between others, as a historian draws them that keeps "
        "changes alone, and PV foretells itself along these; a stem that explains little of PV by simulation is no "
        "evidence: a record of all samples would tell"
    )


def other_causes(record: Record, oscillation: Oscillation) -> list[str]:
    """Return in words what else may explain how PV moves."""
    said = []
    n = len(record)
    for end, name in ((float(record.op.min()), "lowest"), (float(record.op.max()), "highest")):
        share = float((record.op == end).mean())
        if share >= MUCH:
            said.append(
                f"OP stays at its {name} value, {given(end, 4)} %, in {share:.0%} of the record: it may be saturated"
            )
    if record.mode is not None and manual_share(record.mode) >= MUCH:
        said.append(f"the controller was in manual in {manual_share(record.mode):.0%} of the record")
    first, stop = _longest_stay(record.pv)
    if stop - first >= MUCH * n:
        said.append(f"PV keeps the value {given(record.pv[first], 4)} over {(stop - first) / n:.0%} of the record")
    if record.sp is not None and np.count_nonzero(np.diff(record.sp)) >= MUCH * n:
        outer = oscillation_of(record.sp, record.sample_time)
        if outer.index >= CYCLES and abs(outer.period / oscillation.period - 1.0) <= ALIKE:
            said.append(
                f"SP cycles with PV's period ({given(outer.period, 3)} s): in a cascade the outer loop may drive the "
                "cycle"
            )
        else:
            said.append("SP moves all the time, as in a cascade")
    return said
