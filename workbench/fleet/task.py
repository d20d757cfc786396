"""One loop: read, measured, judged and, where asked, modelled and tuned. The same on every engine."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.detect.causes import dead_signal, refuse_unusable
from workbench.detect.detect import detect
from workbench.detect.oscillation import OSCILLATES, REGULAR
from workbench.detect.stem_search import FITTED
from workbench.errors import RecordError, WorkbenchError
from workbench.fleet.sampling import Seen, cycle_of, means, stretch
from workbench.fleet.window import WINDOW, within
from workbench.kpi.kpis import travel
from workbench.model.fleet import FleetRow, LoopSource, Settings, Tuning
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import Record
from workbench.model.results import Estimate
from workbench.record.historian import Piece, read_tags
from workbench.record.modes import manual_share
from workbench.record.reader import read_loop, read_record
from workbench.report.known import hint
from workbench.report.loop_page import render_loop
from workbench.report.standing import room_words
from workbench.scenario.refusals import in_entries, scalar

if TYPE_CHECKING:
    from workbench.model.controller import PID
    from workbench.model.detection import Detection, StemTest
    from workbench.model.results import LinearFit
    from workbench.scenario.retune import Retuned

__all__ = ["Result", "checked", "look_at", "read"]

# What a model is fitted to, samples and samples in a cycle: ten cycles, at the data's own rate as far as that goes, for
# a plant is faster than its cycle, and thinning biases d. More of a loop whose valve may stick.
MODEL, MODEL_STICKY = (2000, 200), (4000, 400)
CYCLES = 8.0  # recorded, from which a phase is worth keeping
FRESH = 10.0  # samples of a cycle that its phase is read from
BAND = (0.6, 1.6)  # of the frequency of the cycle
INSTANTS = 256  # of the phase, at most
DRAWN = 96  # points of a trend
SHOWN = 10.0  # cycles in a trend
_ENTRY = re.compile(r"\b(columns|tags): \{[^}]*\}")
NOTES = 1200  # characters of reasons and notes


@dataclass(frozen=True, slots=True)
class Result:
    """A loop's row, and its page as HTML where it is worth one ("" else)."""

    row: FleetRow
    page: str = ""


def read(loop: LoopSource, settings: Settings) -> Record:
    """Return the loop's record within the window asked for. Raises `RecordError` and `InvalidValue`."""
    if loop.refusal:
        raise RecordError(loop.refusal)
    if loop.pieces and not loop.pieces[0][1]:
        record = read_loop(
            loop.pieces[0][0],
            dict(loop.tags),
            sample_time=loop.sample_time,
            pv_range=loop.pv_range,
            op_range=loop.op_range,
            max_gap=loop.max_gap,
        )
    elif loop.pieces:
        window = None
        if settings.begin is not None or settings.end is not None:
            window = (
                -math.inf if settings.begin is None else settings.begin,
                math.inf if settings.end is None else settings.end,
            )
        record = read_tags(
            tuple(Piece(path, groups) for path, groups in loop.pieces),
            dict(loop.tags),
            loop.name,
            window=window,
            zoned=settings.zoned,
            sample_time=loop.sample_time,
            pv_range=loop.pv_range,
            op_range=loop.op_range,
            max_gap=loop.max_gap,
        )
    else:
        record = read_record(
            loop.path,
            columns=dict(loop.columns) or None,
            tags=dict(loop.tags) or None,
            sample_time=loop.sample_time,
            pv_range=loop.pv_range,
            op_range=loop.op_range,
            max_gap=loop.max_gap,
        )
    return within(record, settings)


def look_at(loop: LoopSource, settings: Settings) -> Result:
    """Return the result of one loop; whatever is wrong with its data becomes its row's reason."""
    try:
        return _looked_at(loop, settings)
    except Exception as error:  # noqa: BLE001 - one loop must never stop the others, whatever it meets
        return Result(FleetRow.failure(loop, _reason(loop, error)))


def checked(loop: LoopSource) -> tuple[str, str]:
    """Return why `look_at` would refuse a loop, and why its record would tell nothing of the valve; "" for nothing."""
    try:
        record = read(loop, Settings())
        refuse_unusable(record, "detect stiction")
    except Exception as error:  # noqa: BLE001 - as above
        return _reason(loop, error), ""
    return "", dead_signal(record)


def _reason(loop: LoopSource, error: Exception) -> str:
    """Return in a line why a loop could not be looked at."""
    if isinstance(error, WorkbenchError):
        return _line(_refused(loop, str(error)))
    if isinstance(error, MemoryError):
        return "the record does not fit into memory"
    return _line(f"unexpected: {type(error).__name__}: {error}")


def _refused(loop: LoopSource, message: str) -> str:
    """Return a reader's message as a manifest says what `columns` and `tags` are, with the line of one for a file."""
    said = in_entries(message)
    if said == message or not loop.path or loop.columns or loop.tags:
        return said
    told = _ENTRY.search(said)
    entry = told[0] if told else "sample_time: 5 s"
    return (
        f"{said}; a line of a manifest: - {{name: {scalar(loop.name)}, file: {scalar(Path(loop.path).name)}, {entry}}}"
    )


def _line(text: str) -> str:
    return " ".join(text.split())[:NOTES]


def _looked_at(loop: LoopSource, settings: Settings) -> Result:
    record = read(loop, settings)
    seen = cycle_of(record)
    judged = stretch(record, seen)
    found = _of_whole(detect(judged), judged, record)
    row = _measured(loop, record, seen, judged, found)
    estimated: Estimate | LinearFit | None = None
    tuned: Retuned | None = None
    if settings.depth != "screen" and found.test is not None:
        row, estimated = _estimated(row, loop, record, seen)
    if isinstance(estimated, Estimate):
        judged, found = estimated.record, _evidence(estimated)
        row = replace(row, evidence=math.nan if found.test is None else _share(found.test))
    if settings.depth == "tune" and isinstance(estimated, Estimate) and row.sticks:
        row, tuned = _tuned(row, loop, estimated)
    page = ""
    if row.sticks or row.oscillates:
        controller = None if tuned is None else tuned.tuned.controller
        page = render_loop(row, record, judged, found.statistics, estimated, controller, _room(tuned))
    return Result(row, page)


def _of_whole(found: Detection, judged: Record, record: Record) -> Detection:
    """Return the evidence with its word on a signal that tells nothing said of the whole record, where it holds there.

    Beside the record's number of samples that of the stretch would be another record's.
    """
    said, whole = dead_signal(judged), dead_signal(record)
    if not (said and whole):
        return found
    return replace(found, reasons=tuple(whole if reason == said else reason for reason in found.reasons))


def _evidence(estimated: Estimate) -> Detection:
    """Return the evidence where a model's verdict rests on it: in its stretch, its own stem among those tried."""
    valve = estimated.valve
    return detect(estimated.record, fitted=(valve, estimated.valve_position) if isinstance(valve, FITTED) else None)


def _share(test: StemTest) -> float:
    """Return the share of what a linear loop leaves of PV unpredicted that the stem explains which predicts best."""
    return 1.0 - math.exp(-test.predicting / test.samples)


def _measured(loop: LoopSource, record: Record, seen: Seen, judged: Record, found: Detection) -> FleetRow:
    cycle, test = seen.oscillation, found.test
    oscillates = cycle.index >= OSCILLATES and cycle.regularity > REGULAR and math.isfinite(cycle.period)
    hours = len(record) * record.sample_time / 3600.0
    step, first, phases = _phases(record, seen) if oscillates and cycle.cycles >= CYCLES else (math.nan, 0, b"")
    shown, trend = _trend(record, cycle.period if oscillates else math.nan)
    ends = [float(np.mean(record.op == end)) for end in (record.op.min(), record.op.max())]
    nan = math.nan
    share = nan if test is None else _share(test)
    present = loop.tuning or Tuning(nan, nan, nan, "")
    return FleetRow(
        loop.name,
        area=loop.area,
        criticality=loop.criticality,
        verdict=found.verdict,
        oscillates=oscillates,
        oscillation_index=cycle.index,
        period=cycle.period if oscillates else nan,
        regularity=min(cycle.regularity, 1e6),
        stiction=test.band if test is not None and found.verdict == "stiction" else nan,
        likelihood=nan if test is None else test.predicting,
        predicts=share,
        evidence=share,
        swing=nan if test is None else test.band / float(np.ptp(judged.op)),
        samples=len(record),
        sample_time=record.sample_time,
        hours=hours,
        automatic=_automatic(record),
        saturated=max(ends) if np.ptp(record.op) > 0.0 else 1.0,
        pv_sd=float(record.pv.std()),
        error_sd=nan if record.sp is None else float((record.sp - record.pv).std()),
        op_travel=travel(record.op) / hours,
        present_Kc=present.Kc,
        present_Ti=present.Ti,
        present_Td=present.Td,
        present_form=present.form,
        reasons=_line("; ".join(found.reasons)),
        notes=_line("; ".join(note for note in record.notes if not note.startswith("first timestamp"))),
        trend_hours=shown,
        phase_step=step,
        phase_first=first,
        phases=phases,
        trend=trend,
    )


def _automatic(record: Record) -> float:
    """Return the share of the samples in automatic or cascade, nan where no mode is recorded, or a window hides it."""
    if record.mode is None:
        return math.nan
    if manual_share(record.mode) > 0.0:
        return 1.0 - manual_share(record.mode)
    kept, manual = sum(len(one) for one in record.segments), record.counts.get("manual", 0)
    if manual and WINDOW in record.counts:
        return math.nan  # reading leaves samples in manual out, and does not say how many of them the window has
    return kept / (kept + manual)


def _phases(record: Record, seen: Seen) -> tuple[float, int, bytes]:
    """Return (step in s, number of the first instant, phase at each instant in 256ths of a turn) of PV's oscillation.

    PV is thinned to some ten samples in a cycle and kept in a band about the cycle's frequency; its analytic signal
    there has the phase. The instants are multiples of the step, a power of two, on the clock of the data, so that any
    two loops share them.
    """
    period = seen.oscillation.period
    factor = max(int(period / record.sample_time / FRESH), 1)
    y = means(record.pv, factor)
    Ts = factor * record.sample_time
    frequencies = np.fft.fftfreq(y.size, Ts)
    spectrum = np.fft.fft(y - y.mean())
    spectrum[(frequencies < BAND[0] / period) | (frequencies > BAND[1] / period)] = 0.0
    analytic = np.fft.ifft(spectrum)
    first = record.epoch + record.start + 0.5 * (factor - 1) * record.sample_time
    step = 2.0 ** math.ceil(math.log2(y.size * Ts / INSTANTS))
    instants = np.arange(math.ceil(first / step), math.floor((first + (y.size - 1) * Ts) / step) + 1)
    at = (instants * step - first) / Ts
    near = np.clip(np.rint(at).astype(int), 0, y.size - 1)
    turns = np.angle(analytic[near]) / (2.0 * math.pi) + (at - near) * Ts / period
    return step, int(instants[0]), (np.rint(turns * 256.0).astype(np.int64) % 256).astype(np.uint8).tobytes()


def _trend(record: Record, period: float) -> tuple[float, bytes]:
    """Return (hours, bytes 0 to 255) of PV over its latest cycles, or over the whole record without a cycle."""
    wanted = len(record) if math.isnan(period) else max(int(SHOWN * period / record.sample_time), DRAWN)
    pv = record.pv[-wanted:]
    hours = pv.size * record.sample_time / 3600.0
    if pv.size > DRAWN:
        pv = means(pv, pv.size // DRAWN)[-DRAWN:]
    low, span = float(pv.min()), float(np.ptp(pv))
    scaled = np.rint(255.0 * (pv - low) / span) if span > 0.0 else np.full(pv.size, 128.0)
    return hours, scaled.astype(np.uint8).tobytes()


def _estimated(
    row: FleetRow, loop: LoopSource, record: Record, seen: Seen
) -> tuple[FleetRow, Estimate | LinearFit | None]:
    """Return the row with the loop's model, or with why there is none, and the model.

    Where the evidence excludes stiction the model is linear, and the verdict stands; elsewhere the model has a valve
    that may stick, and its verdict goes before that of the evidence alone.
    """
    from workbench.estimate.estimate import estimate, linear_loop

    healthy = row.verdict == "no_stiction"
    part = stretch(record, seen, *(MODEL if healthy else MODEL_STICKY))
    try:
        if healthy:
            linear = linear_loop(part, loop.plant)
            return _modelled(row, linear.plant), linear
        found = estimate(part, plant=loop.plant)
    except WorkbenchError as error:
        return replace(row, notes=_line(f"{row.notes}; no model: {error}".lstrip("; "))), None
    sticks = found.verdict == "stiction"
    limits = (found.intervals.d or found.intervals.S) if sticks else None
    row = replace(
        _modelled(row, found.plant),
        verdict=found.verdict,
        reasons=_line("; ".join(found.reasons)),
        stiction=found.valve.stick_band if sticks else math.nan,
        jump=found.valve.slip_jump if sticks else math.nan,
        stiction_low=math.nan if limits is None else limits[0],
        stiction_high=math.nan if limits is None else limits[1],
        identifiable=found.identifiable,
    )
    return row, found


def _modelled(row: FleetRow, plant: Plant) -> FleetRow:
    """Return the row with a plant."""
    return replace(
        row,
        plant="fopdt" if isinstance(plant, FOPDT) else "integrating",
        model_gain=plant.gain,
        model_time_constant=plant.time_constant if isinstance(plant, FOPDT) else math.nan,
        model_dead_time=plant.dead_time,
    )


def _tuned(row: FleetRow, loop: LoopSource, found: Estimate) -> tuple[FleetRow, Retuned | None]:
    """Return the row with a tuning for the loop found, in the form of the present one."""
    from workbench.scenario.retune import Wishes, tune_found
    from workbench.simulate.run import evaluate

    try:
        result = tune_found(found, Wishes())
    except WorkbenchError as error:
        return replace(row, notes=_line(f"{row.notes}; no tuning: {error}".lstrip("; "))), None
    tuned, doubt = result.tuned, hint(found, standing=result.standing)
    controller, ratio, note = tuned.controller, math.nan, _line(f"{row.notes}; {doubt}".strip("; "))
    if loop.tuning is not None:
        present = _present(loop, controller)
        cost = float(evaluate(tuned.loop.with_controller(present), tuned.experiment, tuned.weights)[0])
        ratio = tuned.objective / cost if cost > 0.0 and math.isfinite(cost) else math.nan
        try:
            controller = controller.to_form(loop.tuning.form)
        except WorkbenchError as error:
            note = _line(f"{note}; tuning in the ideal form: {error}".lstrip("; "))
    row = replace(
        row,
        Kc=controller.Kc,
        Ti=controller.Ti,
        Td=controller.Td,
        form=controller.form,
        gain_of_tuning=ratio,
        hint=doubt,
        notes=note,
    )
    return row, result


def _room(result: Retuned | None) -> str:
    """Return what a repaired valve allows beyond a tuning, in words, "" where that is not known."""
    kept = None if result is None else result.tuned.constraints
    return "" if result is None or kept is None else room_words(result.standing, kept.max_sensitivity)


def _present(loop: LoopSource, like: PID) -> PID:
    """Return the present controller, acting as the proposed one does."""
    assert loop.tuning is not None  # noqa: S101
    given = loop.tuning
    return replace(like, Kc=given.Kc, Ti=given.Ti, Td=given.Td, form=given.form)
