"""The page of one loop of a fleet: its figures, its signals where it was judged, the evidence, model and tuning."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence

from workbench.model.controller import PID
from workbench.model.detection import Statistic
from workbench.model.fleet import FleetRow
from workbench.model.record import Record
from workbench.model.results import Estimate, LinearFit
from workbench.model.valve import Ideal
from workbench.report.known import unpinned
from workbench.report.lines import panel
from workbench.report.templating import environment, style_sheet
from workbench.report.words import (
    controller_words,
    duration,
    figure,
    interval,
    plant_words,
    quantity,
    slug,
    valve_words,
)

__all__ = ["DIGITS", "PINS_NOT", "page_name", "render_loop", "verdict_words"]

DIGITS = 4  # of a proposed tuning, as `wb.tune` gives it

PINS_NOT = "a hint: the record does not pin it"
VERDICTS = {"stiction": "stiction", "no_stiction": "no stiction", "undecided": "undecided", "": "–"}
NEAR = 20.0  # cycles drawn once more where they are two thirds of the stretch at most


def page_name(name: str) -> str:
    """Return the file name of a loop's page, another one for every name."""
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,60}", name):
        return f"{name}.html"
    return f"{slug(name)}-{hashlib.sha256(name.encode()).hexdigest()[:8]}.html"


def verdict_words(verdict: str) -> str:
    """Return a verdict as people read it."""
    return VERDICTS.get(verdict, verdict)


def render_loop(
    row: FleetRow,
    record: Record,
    judged: Record,
    statistics: Sequence[Statistic],
    found: Estimate | LinearFit | None,
    tuned: PID | None,
    room: str = "",
) -> str:
    """Return a loop's page as HTML. judged: the stretch that the verdict rests on, and statistics are of.

    found, tuned: None without one. room: what a repaired valve allows beyond the tuning, in words.
    """
    near = judged if math.isnan(row.period) else _latest(judged, NEAR * row.period)
    evidence = [(one.name, one.measures, quantity(one.value, one.unit), one.limits, one.says) for one in statistics]
    return (
        environment()
        .get_template("loop.html.j2")
        .render(
            row=row,
            css=style_sheet("report.css", "fleet.css"),
            verdict=verdict_words(row.verdict),
            facts=_facts(row, record, judged),
            model=_model(row, found),
            tuning=None if tuned is None else controller_words(tuned, DIGITS),
            room=room,
            gain=figure(row.gain_of_tuning, 2) if math.isfinite(row.gain_of_tuning) else None,
            pictures=[*_pictures(judged), *(_pictures(near) if 3 * len(near) <= 2 * len(judged) else [])],
            evidence=evidence,
        )
    )


def _latest(record: Record, seconds: float) -> Record:
    count = min(max(int(seconds / record.sample_time), 30), len(record))
    part = slice(len(record) - count, None)
    return Record(
        record.pv[part],
        record.op[part],
        record.sample_time,
        sp=None if record.sp is None else record.sp[part],
        start=float(record.time[part][0]),
    )


def _pictures(record: Record) -> list[object]:
    hours = record.time / 3600.0
    pv = [("pv", record.pv)]
    if record.sp is not None:
        pv.insert(0, ("sp", record.sp))
    return [panel(hours, pv, "PV, EU"), panel(hours, [("op", record.op)], "OP, %")]


def _facts(row: FleetRow, record: Record, judged: Record) -> list[tuple[str, str]]:
    cycle = "none"
    if row.oscillates:
        cycle = f"index {row.oscillation_index:.2f}, period {duration(row.period)}, over the whole record"
    facts = [
        ("Record", f"{row.samples:,} samples of {figure(row.sample_time)} s, {figure(row.hours, 3)} h"),
        (
            "Judged by",
            f"{len(judged):,} samples of {figure(judged.sample_time)} s, which verdict, evidence and figures are of",
        ),
        ("Oscillation", cycle),
        ("Stiction", _stiction(row)),
        ("PV", f"standard deviation {figure(row.pv_sd)} EU"),
        (
            "OP",
            f"travel {figure(row.op_travel)} % an hour; at its highest or lowest value {row.saturated:.0%} of the time",
        ),
    ]
    if math.isfinite(row.error_sd):
        facts.append(("SP − PV", f"standard deviation {figure(row.error_sd)} EU"))
    if math.isfinite(row.automatic):
        facts.append(("In automatic", f"{row.automatic:.1%} of the time"))
    if record.rest:
        facts.append(("Other stretches", f"{len(record.rest)} of the same loop, not looked at"))
    notes = row.notes.replace(row.hint, "").strip("; ")  # the hint stands beside the tuning
    if notes:
        facts.append(("Notes", notes))
    return facts


def _stiction(row: FleetRow) -> str:
    if not math.isfinite(row.stiction):
        return "–"
    words = f"{figure(row.stiction, 3)} % of travel"
    if math.isfinite(row.stiction_low):
        words += f" (95 %: {interval((row.stiction_low, row.stiction_high), '%', 3)})"
    if math.isfinite(row.jump):
        words += f", slip jump {figure(row.jump, 3)} %"
    if row.plant:
        words += ", of the model below"
    return f"{words}; {PINS_NOT}" if row.vague else words


def _model(row: FleetRow, found: Estimate | LinearFit | None) -> list[tuple[str, str]]:
    if found is None:
        return []
    valve = found.valve if isinstance(found, Estimate) else Ideal()
    lines = [("Plant", plant_words(found.plant)), ("Valve", valve_words(valve))]
    if isinstance(found, Estimate) and row.sticks and not row.identifiable:
        lines.append(("Note", unpinned(found)))
    return lines
