"""`wb.detect`: a record to the evidence for and against stiction, and the verdict."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from workbench.detect.action import control_error, feedback, gain_sign
from workbench.detect.answer import answer_of
from workbench.detect.bicoherence import bicoherence_of, ellipse_of
from workbench.detect.causes import (
    RESOLVED,
    along_lines,
    below_step,
    between_values,
    beyond_op,
    constant,
    dead_signal,
    other_causes,
    steady_stretches,
)
from workbench.detect.correlation import cross_correlation, histogram_fit
from workbench.detect.direct import stem_evidence
from workbench.detect.evidence import statistics_of
from workbench.detect.late import as_seen, later, words_of_late
from workbench.detect.load import DETECTIONS, load_index
from workbench.detect.oscillation import no_period, oscillation_of, period_of_wave
from workbench.detect.resolution import resolved
from workbench.detect.scan import runs_faster
from workbench.detect.shape import movement_index, triangle_index
from workbench.detect.spikes import words_of_spikes
from workbench.detect.stem import stem_test
from workbench.detect.stem_search import FITTED, Fitted
from workbench.detect.verdict import Thresholds, decide, excluded, follows
from workbench.errors import InvalidValue
from workbench.model.checks import instance
from workbench.model.detection import Detection, Oscillation, StemTest
from workbench.model.numbers import given
from workbench.model.record import Record, signal_of
from workbench.record.rounding import step_of
from workbench.simulate.one_thread import one_thread

__all__ = ["detect"]

ACTS = 0.05  # share of OP's moves that the error must explain for a controller to be seen
SETTLING = 3  # the part of a stretch at constant SP, one in so many, that is left out at its start
LEAST_BETWEEN = 100  # samples
HIDES = 0.5  # of OP's range: setpoint moves hide a stem where OP moves by no more than this between them
MATTERS = 2.0 * RESOLVED  # %: a band that is narrower is as good as a positioner's own
PERHAPS_LATE = (
    "OP answers PV better some samples ahead than up to now: PV may be recorded later than the controller saw it, and "
    "a valve that sticks then looks like one that does not; records whose times agree would tell"
)
PATTERN = 20  # parts of a period over which moves are coded


@one_thread
def detect(record: Record, *, bicoherence: bool = False, fitted: Fitted | None = None) -> Detection:
    """Return the evidence for and against a sticking valve in a record.

    bicoherence: also the bicoherence of SP - PV with its indices and the ellipse of PV against OP, which want long
    records. fitted: a valve (Stenman, Choudhury or Deadband) and its stem (%, shape (N,)) from a model of the loop,
    which the stem test tries too; where it leaves no doubt, no others are tried and `test.wide` is nan. A PV that is
    recorded later than the controller saw it is looked at as that did (`pv_late`), and values of PV or OP that stand
    out from their neighbours alone are left out (`detect.spikes`). Raises `RecordError` for fewer than 30 samples or
    values that no plant has, and `InvalidValue` for anything that is not a record, or for a valve or a stem that cannot
    be tried.
    """
    if not isinstance(record, Record):
        raise InvalidValue("detect.record", type(record).__name__, "must be a Record (see read_record)")
    if fitted is not None:
        instance(fitted[0], FITTED, "detect.fitted[0]", "a Stenman, Choudhury or Deadband valve")
        fitted = fitted[0], signal_of(fitted[1], "detect.fitted[1]", len(record))
    seen, late = as_seen(record, "detect stiction")
    if late.samples and fitted is not None:
        fitted = fitted[0], later(fitted[1], late.samples)
    found = _detected(seen, bicoherence, fitted)
    if late.perhaps and found.verdict == "no_stiction" and found.stem is None:
        found = replace(found, verdict="undecided", reasons=(PERHAPS_LATE, *found.reasons))
    said = words_of_late(record, late) + words_of_spikes(record)
    return replace(found, record=record, reasons=found.reasons + said, pv_late=late.samples * record.sample_time)


def _detected(record: Record, bicoherence: bool, fitted: Fitted | None) -> Detection:
    """The evidence in a record whose PV is not late."""
    dead = dead_signal(record)
    whole = oscillation_of(record.pv, record.sample_time)
    nothing = (math.nan, math.nan)
    if constant(record.pv) or constant(record.op):
        found = Detection(
            record=record,
            verdict="undecided",
            reasons=(dead,),
            oscillation=whole,
            stretch=(0, len(record)),
            cycle=whole,
            load_index=0.0,
            correlation=nothing,
            histogram=math.nan,
            triangle=math.nan,
            triangle_pv=math.nan,
            movement=nothing,
            test=None,
            stem=None,
        )
        return replace(found, statistics=statistics_of(found, bicoherence))
    period = period_of_wave(record.pv, record.sample_time, whole)
    test = stem_test(record.pv, record.op, record.sp, record.sample_time, period, gain_sign(record), fitted)
    stem = None if record.valve_position is None else stem_evidence(record.op, record.valve_position)
    verdict, reasons = ("undecided", [dead]) if dead else decide(whole, test, stem)
    if verdict == "stiction" and stem is None and (why := _doubtful(record, whole, test, period)):
        verdict, reasons = "undecided", [why, *reasons]
    if verdict == "no_stiction" and follows(test) < Thresholds().seen and feedback(record)[0] < ACTS:
        verdict = "undecided"
        reasons = ["neither does PV follow OP nor OP the error: the record does not show a loop at work"]
    # No band is excluded that OP's steps would not show.
    if (
        verdict == "no_stiction"
        and stem is None
        and (hidden := below_step(record.op, test.wide_from) or _between_moves(record, test))
    ):
        verdict, reasons = "undecided", [hidden]
    # Where a plant is seen to answer OP that clearly, by its lag and dead time, no more is asked.
    if verdict != "stiction" and not dead and stem is None and follows(test) < Thresholds().likelihood:
        answer = answer_of(record)
        if answer is not None and answer.missing:
            larger = "a" if record.sp is None or np.ptp(record.sp) == 0.0 else "a larger"
            unanswered = (
                f"PV is not seen to answer the OP moves of {given(answer.moved, 3)} %: a slow disturbance may hide "
                "that it does, and a stuck valve, a closed block valve or a valve in manual look the same; "
                f"{larger} setpoint move would tell"
            )
            reasons = [unanswered, *reasons[verdict == "no_stiction" :]]
            verdict = "undecided"
    stretch, cycle = _strongest(record, whole)
    pv, op, error = (signal[slice(*stretch)] for signal in (record.pv, record.op, control_error(record)))
    oscillates = not no_period(cycle)
    samples = cycle.period / record.sample_time if oscillates else math.nan
    load = load_index(error, record.sample_time, samples * record.sample_time)
    found = Detection(
        record=record,
        verdict=verdict,
        reasons=(*reasons, *_cycle_said(cycle, oscillates, load), *other_causes(record, whole)),
        oscillation=whole,
        stretch=stretch,
        cycle=cycle,
        load_index=load,
        correlation=cross_correlation(pv, op, samples),
        histogram=histogram_fit(pv, samples),
        triangle=triangle_index(op) if oscillates else math.nan,
        triangle_pv=triangle_index(pv) if oscillates else math.nan,
        movement=movement_index(pv, op, max(int(samples / PATTERN), 1) if oscillates else 1),
        test=test,
        stem=stem,
        bicoherence=bicoherence_of(error) if bicoherence else None,
        ellipse=ellipse_of(pv, op, samples) if bicoherence else None,
    )
    return replace(found, statistics=statistics_of(found, bicoherence))


def _doubtful(record: Record, whole: Oscillation, test: StemTest, period: float) -> str:
    """Say why a stem that was found may be none, by how the record was kept; or nothing."""
    why = beyond_op(record.op, test.band) or below_step(record.op, test.band) or between_values(record)
    why = why or along_lines(record, test.unexplained, test.simulated)
    op, doubt = resolved(record)
    if why or doubt == 0.0 or op is record.op:
        return why
    within = stem_test(record.pv, op, record.sp, record.sample_time, period, gain_sign(record))
    if decide(whole, within, None)[0] == "stiction":
        return ""
    return (
        f"OP is recorded in steps of {given(step_of(record.op), 3)} %: where the controller's law has it within them "
        "no stem is needed; a record of OP in more digits would tell"
    )


def _between_moves(record: Record, whole: StemTest) -> str:
    """Say that stiction is found between setpoint moves, or not excluded there, or return nothing.

    whole: the stem test over the record. Moves of OP that are large beside a stick band hide it: over the whole record
    only bands are excluded that are wide beside these. The longest stretch is looked at; after a move the loop has a
    third of it to settle. Where nothing is excluded there, that acquits a valve all the same if the stem had what OP
    was recorded to be. If the controller runs faster than the record, the stem slips at peaks of OP that nobody
    recorded, and where narrow stems too are clearly worse than OP itself, LIKELIHOOD, none is at work. Of 55 sticking
    valves under such a controller that were called healthy 43 are not, for 26 of 80 healthy ones.
    """
    if record.sp is None or not np.ptp(record.sp) > 0.0:
        return ""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(record.sp) != 0.0) + 1, [len(record)]]).tolist()
    first, stop = max(pairwise(edges), key=lambda ends: ends[1] - ends[0])
    first += (stop - first) // SETTLING
    if stop - first < LEAST_BETWEEN:
        return ""
    part = Record(record.pv[first:stop], record.op[first:stop], record.sample_time, sp=record.sp[first:stop])
    if dead_signal(part):
        return ""
    cycle = oscillation_of(part.pv, part.sample_time)
    period = period_of_wave(part.pv, part.sample_time, cycle)
    test = stem_test(part.pv, part.op, part.sp, part.sample_time, period, gain_sign(record))
    Ts = record.sample_time
    between = f"between setpoint moves, from {given(first * Ts, 6)} to {given(stop * Ts, 6)} s"
    hide = "over the whole record large moves hide a band that is narrow beside them"
    # What load steps do as well is no finding, but reason enough not to acquit.
    verdict, reasons = decide(cycle, replace(test, loaded=test.predicting), None)
    if verdict == "stiction":
        return f"{between}, {reasons[0]}; {hide}: a longer stretch without them would tell"
    limits = Thresholds()
    hidden = np.ptp(part.op) <= HIDES * np.ptp(record.op) and test.wide_from >= MATTERS
    hidden = hidden and not excluded(test, limits) and whole.predicting > -limits.likelihood
    if hidden and runs_faster(record):
        return (
            f"{between}, a stem that sticks over {given(test.wide_from, 3)} % or more is not excluded, and {hide}: "
            "OP's moves come of no linear law of the samples, as where the controller runs faster than the record, and "
            "at which of OP's peaks a stem slipped is not known; a record at the controller's scan would tell"
        )
    return ""


def _strongest(record: Record, whole: Oscillation) -> tuple[tuple[int, int], Oscillation]:
    """Return the stretch at constant SP in which PV cycles most strongly, and its oscillation there."""
    stretches = steady_stretches(record)
    if stretches == [(0, len(record))]:
        return stretches[0], whole
    cycles = [(ends, oscillation_of(record.pv[slice(*ends)], record.sample_time)) for ends in stretches]
    return max(cycles, key=lambda found: found[1].index)


def _cycle_said(cycle: Oscillation, oscillates: bool, load: float) -> list[str]:
    if not oscillates:
        return []
    often = ", an oscillation by Hägglund's load index too" if load >= DETECTIONS else ""
    return [f"PV oscillates with a period of {given(cycle.period, 3)} s (index {cycle.index:.2f}{often})"]
