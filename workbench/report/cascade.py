"""What the report says of a cascade: tables of both loops, and sentences."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from workbench.model.cascade import Appearance
from workbench.model.results import Kpis
from workbench.model.study import CascadeResult, Study
from workbench.model.titles import kpi_title, within
from workbench.report.judge import on_bounds, settling_band, settling_doubt
from workbench.report.shared import CONTROLLER_ROWS, experiment_words, objective_words
from workbench.report.tables import Cell, Row, Table, shown
from workbench.report.words import (
    duration,
    figure,
    given,
    join,
    parameter,
    plant_words,
    valve_words,
)

__all__ = ["cascade_figure", "cascade_lines", "cascade_rows", "cascade_sentences", "cascade_tables"]

PRIMARY_KPIS = ("mean_square_error", "iae", "pv_sd", "settling_time", "final_error", "controller_travel")
SECONDARY_KPIS = ("mean_square_error", "pv_sd", "valve_travel", "reversals", "controller_travel")
LESS = ("mean_square_error", "iae", "valve_travel", "reversals")
VERDICTS = {"stiction": "stiction", "no_stiction": "no stiction", "undecided": "undecided"}


def cascade_lines(study: Study) -> list[tuple[str, str]]:
    """Return what the cases share, as (what, text)."""
    cascade = study.cascade[0].run.cascade
    one, two = cascade.primary, cascade.secondary
    scale = f", scale {given(cascade.scale)} EU of the secondary per unit of its output" if cascade.scale != 1.0 else ""
    held = "the primary holds its integral while the secondary's output is at a limit"
    winds = held if cascade.anti_windup == "clamp" else "the primary knows nothing of the secondary's limits"
    outer = plant_words(one.plant).replace("EU/%", "EU/EU").replace("EU/(% s)", "EU/(EU s)")
    lines = [
        ("Primary", f"{outer}, from the secondary's PV; acts every {given(one.sample_time)} s{scale}"),
        ("Secondary", f"{plant_words(two.plant)}; sample time {given(two.sample_time)} s"),
        ("Valve", valve_words(two.valve)),
        ("Anti-windup", winds),
        ("Experiment", experiment_words(study)),
    ]
    if study.objective is not None:
        of = "error of the primary, output and valve of the secondary"
        lines.append(("Objective J", f"{objective_words(study.objective)}: {of}"))
    return lines


def _settings(study: Study, which: str) -> list[Row]:
    pids = [getattr(case.run.cascade, which).controller for case in study.cascade]
    tuned = [None if case.tuned is None else getattr(case.tuned, which) for case in study.cascade]
    digits = [None if one is None else one.digits for one in tuned]
    out = study.cascade[0].run.cascade.output_unit if which == "primary" else "%"
    rows = [
        Row(f"{which.capitalize()}: {name}", f"{out}/EU" if name == "Kc" else "s", cells, group=name == "Kc")
        for name in ("Kc", "Ti", "Td")
        for cells in (
            tuple(
                Cell(parameter(getattr(p, name), d, converted=case.unrounded is not None))
                for case, p, d in zip(study.cascade, pids, digits, strict=True)
            ),
        )
    ]
    for text, describe in CONTROLLER_ROWS:
        if len({describe(pid) for pid in pids}) > 1:
            rows.append(Row(f"{which.capitalize()}: {text.lower()}", "", tuple(Cell(describe(pid)) for pid in pids)))
    return rows


def cascade_tables(study: Study) -> list[Table]:
    """Return the comparison of the cases over the run, and their cycles: rows of both loops, cases across."""
    cases = study.cascade
    heads = tuple(case.name for case in cases)
    rows = _settings(study, "primary") + _settings(study, "secondary")
    if study.objective is not None:
        rows.append(_numbers("J", "", [math.nan if c.objective is None else c.objective for c in cases], less=True))
    for which, name, title, unit, less in cascade_rows():
        values = [cascade_figure(getattr(c.run, which).kpis, which, name, c.run.cascade.scale) for c in cases]
        doubts = [settling_doubt(c, study.experiment) if name == "settling_time" else "" for c in cases]
        unit = settling_band(cases[0], study.experiment) if name == "settling_time" else unit
        first = name in (PRIMARY_KPIS[0], SECONDARY_KPIS[0])
        rows.append(_numbers(title, unit, values, name, less=less, group=first, small=doubts))
    tables = [Table(heads, tuple(rows))]
    if any(case.cycle is not None for case in cases):
        tables.append(Table(heads, tuple(_cycle_rows(cases))))
    return tables


def cascade_rows() -> list[tuple[str, str, str, str, bool]]:
    """Return a cascade's figures, each as (loop, name in Kpis, title, unit, whether less is better)."""
    rows = []
    for which, names in (("primary", PRIMARY_KPIS), ("secondary", SECONDARY_KPIS)):
        for name in names:
            title, unit = kpi_title(name)
            if which == "primary" and name == "controller_travel":
                title, unit = "Travel of its output", "EU of the secondary"
            words = f"{which.capitalize()}: {within(title)}"
            rows.append((which, name, words, unit, name in LESS))
    return rows


def cascade_figure(kpis: Kpis, which: str, name: str, scale: float) -> float:
    """Return a figure of `cascade_rows` in its unit there: the primary's travel is that of the secondary's setpoint."""
    value = float(getattr(kpis, name))
    return abs(scale) * value if (which, name) == ("primary", "controller_travel") else value


def _numbers(
    title: str,
    unit: str,
    values: Sequence[float],
    name: str = "",
    *,
    less: bool = False,
    group: bool = False,
    small: Sequence[str] = (),
) -> Row:
    best = min((v for v in values if math.isfinite(v)), default=math.nan)
    mark = less and len(values) > 1
    notes = small or [""] * len(values)
    cells = tuple(
        Cell(shown(name, v), note, mark and v == best and not math.isnan(v))
        for v, note in zip(values, notes, strict=True)
    )
    return Row(title, unit, cells, group=group or title == "J")


def _cycle_rows(cases: Sequence[CascadeResult]) -> list[Row]:
    def of(title: str, unit: str, text: Callable[[CascadeResult], str], *, group: bool = False) -> Row:
        return Row(title, unit, tuple(Cell(text(case)) for case in cases), group=group)

    def cycle(name: str, words: Callable[[float], str]) -> Callable[[CascadeResult], str]:
        return lambda case: "–" if case.cycle is None else words(getattr(case.cycle, name))

    def seen(which: str, name: str, words: Callable[[float], str]) -> Callable[[CascadeResult], str]:
        def text(case: CascadeResult) -> str:
            appearance: Appearance | None = None if case.cycle is None else getattr(case.cycle, which)
            return "–" if appearance is None else words(getattr(appearance, name))

        return text

    def alone(place: int) -> Callable[[CascadeResult], str]:
        return lambda case: "–" if case.detections is None else VERDICTS[case.detections[place].verdict]

    def in_eu(output: float) -> str:
        return figure(abs(cases[0].run.cascade.scale) * output)

    def degrees(value: float) -> str:
        return "–" if math.isnan(value) else f"{value:.0f}°"

    rows = [
        of("Exact simulation", "", lambda case: "–" if case.cycle is None else case.cycle.outcome, group=True),
        of("Period", "", cycle("period", duration)),
        of("Valve travel an hour", "%", cycle("travel_per_hour", figure)),
    ]
    for which, signals in (
        ("primary", (("pv", "PV"), ("op", "output"))),
        ("secondary", (("sp", "SP"), ("pv", "PV"), ("op", "OP"))),
    ):
        for name, title in signals:
            unit = "%" if title == "OP" else "EU of the secondary" if title == "output" else "EU"
            words = f"{which.capitalize()}: {title} peak to peak"
            swing = seen(which, f"{name}_peak_to_peak", in_eu if title == "output" else figure)
            rows.append(of(words, unit, swing, group=title in ("PV", "SP")))
        for name, title in signals:
            rows.append(
                of(f"{which.capitalize()}: {title} lags the stem by", "", seen(which, f"{name}_phase", degrees))
            )
    rows.append(of("Looked at alone, the primary shows", "", alone(0), group=True))
    rows.append(of("Looked at alone, the secondary shows", "", alone(1)))
    return rows


def cascade_sentences(study: Study) -> list[str]:
    """Return what was found, in sentences."""
    found: list[str] = []
    for case in study.cascade:
        cycle = case.cycle
        if cycle is None:
            continue
        if cycle.outcome != "cycles" or cycle.primary is None or cycle.secondary is None:
            found.append(f"{case.name}: {cycle.reason}.")
            continue
        above, below = cycle.primary, cycle.secondary
        found.append(
            f"{case.name}: without noise both loops cycle every {duration(cycle.period)}; PV swings "
            f"{figure(above.pv_peak_to_peak)} EU in the primary and {figure(below.pv_peak_to_peak)} EU in the "
            f"secondary, whose setpoint swings {figure(below.sp_peak_to_peak)} EU."
        )
    return found + _alone(study.cascade) + [text for case in study.cascade for text in _bounded(case)]


def _bounded(case: CascadeResult) -> list[str]:
    """Name the searches of a case that ended on a bound."""
    if case.tuned is None:
        return []
    units = {"secondary": "%", "primary": case.tuned.cascade.output_unit}
    searches = {which: getattr(case.tuned, which) for which in units}
    ended = {which: on_bounds(one, units[which]) for which, one in searches.items() if one is not None}
    return [
        f"{case.name}: the search of the {which} ended with {join(where)}; a better tuning may lie beyond."
        for which, where in ended.items()
        if where
    ]


def _alone(cases: Sequence[CascadeResult]) -> list[str]:
    """Say where one loop shows what the other hides."""
    hidden = [
        case.name
        for case in cases
        if case.detections is not None
        and case.detections[0].verdict != "stiction"
        and case.detections[1].verdict == "stiction"
    ]
    if not hidden:
        return []
    return [
        (
            f"{join(hidden)}: looked at alone, the primary does not show stiction and the secondary does. Where a "
            "primary cycles with its secondary, the valve is looked for in the secondary's record."
        )
    ]
