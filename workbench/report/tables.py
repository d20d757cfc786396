"""The report's tables as rows of text: which figures stand where, with which unit and how many digits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from workbench.model.study import CaseResult, Study
from workbench.model.titles import KPI_ROWS, kpi_title
from workbench.report.judge import settling_band, settling_doubt, unstable
from workbench.report.reference import reference_names
from workbench.report.shared import CONTROLLER_ROWS
from workbench.report.words import decimals_of, difference, duration, figure, parameter, published

__all__ = ["Cell", "Row", "Table", "blocks", "case_tables", "difference_table", "printed", "shown"]

TIMES = ("settling_time", "oscillation_period")
COLUMNS = 7  # cases beside each other in one table: what an A4 page holds


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell: its text, a second line in small print, and whether it is the best of its row."""

    text: str
    small: str = ""
    best: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One row: what it shows, its unit, its cells; `group` starts a new group of rows."""

    label: str
    unit: str
    cells: tuple[Cell, ...]
    group: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table: the column heads after the first, and the rows; note: a sentence below it."""

    heads: tuple[str, ...]
    rows: tuple[Row, ...]
    title: str = ""
    note: str = ""


def blocks(cases: Sequence[CaseResult]) -> list[Sequence[CaseResult]]:
    """Return the cases in parts of at most seven, as even as can be."""
    count = math.ceil(len(cases) / COLUMNS)
    size = math.ceil(len(cases) / count) if count else 0
    return [cases[i * size : (i + 1) * size] for i in range(count)]


def _value(case: CaseResult, name: str) -> float:
    if name == "objective":
        return math.nan if case.objective is None else case.objective
    return float(getattr(case.run.kpis, name, math.nan))


def shown(kpi: str, value: float) -> str:
    """Return a figure as the tables print it; `kpi` is its name in `Kpis`."""
    if kpi == "settling_time" and math.isinf(value):
        return "not in the run"
    if kpi == "settling_time" and value == 0.0:
        return "never outside"
    if kpi in TIMES:
        return duration(value)
    return f"{value:,.0f}" if kpi == "reversals" and math.isfinite(value) else figure(value)


def printed(kpi: str, value: float, decimals: int) -> str:
    """Return a published figure as it was printed, a time (s) in the unit that reads best."""
    return duration(value) if kpi in TIMES else published(value, decimals)


def case_tables(study: Study) -> list[Table]:
    """Return the comparison of the cases, KPIs down and cases across, at most seven beside each other."""
    decimals = {n: decimals_of([c.reference[n] for c in study.cases if n in c.reference]) for n in _references(study)}
    return [
        Table(tuple(c.name for c in block), tuple(_case_rows(study, block, decimals))) for block in blocks(study.cases)
    ]


def _references(study: Study) -> list[str]:
    order = ["objective", *(name for name, *_ in KPI_ROWS)]
    names = reference_names(study.cases)
    return [n for n in order if n in names] + [n for n in names if n not in order]


def _case_rows(study: Study, block: Sequence[CaseResult], decimals: dict[str, int]) -> list[Row]:
    pids = [c.loop.controller for c in block]
    parallel = all(p.form == "parallel" for p in pids)
    digits = [c.tuned.digits if c.tuned is not None else None for c in block]

    def settings(name: str) -> tuple[Cell, ...]:
        return tuple(
            Cell(parameter(getattr(case.loop.controller, name), d, converted=case.unrounded is not None))
            for case, d in zip(block, digits, strict=True)
        )

    rows = [
        Row("Kc", "%/EU", settings("Kc"), group=True),
        Row("Ti", "EU s/%" if parallel else "s", settings("Ti")),
        Row("Td", "% s/EU" if parallel else "s", settings("Td")),
    ]
    for text, describe in CONTROLLER_ROWS:
        every = [describe(c.loop.controller) for c in study.cases]
        if len(set(every)) > 1:
            rows.append(Row(text, "", tuple(Cell(describe(p)) for p in pids)))
    first = True
    everything = [("objective", "J", "", True), *KPI_ROWS]
    for name, title, given_unit, less in everything:
        unit = given_unit
        values = [_value(c, name) for c in block]
        if all(math.isnan(v) for v in values):
            continue
        doubts = {c.name: settling_doubt(c, study.experiment) if name == "settling_time" else "" for c in study.cases}
        fit = [c for c in study.cases if not unstable(c) and not doubts[c.name]]
        best = min((v for v in (_value(c, name) for c in fit) if not math.isnan(v)), default=math.nan)
        if name == "settling_time":
            unit = settling_band(block[0], study.experiment)
        cells = []
        for case, value in zip(block, values, strict=True):
            small = doubts[case.name]
            if name in case.reference:
                small = "; ".join(filter(None, (small, f"publ. {printed(name, case.reference[name], decimals[name])}")))
            mark = less and len(study.cases) > 1 and value == best and math.isfinite(value) and case in fit
            cells.append(Cell(shown(name, value), small, mark))
        rows.append(Row(title, unit, tuple(cells), group=first))
        first = False
    return rows


def difference_table(study: Study) -> Table | None:
    """Return our figures against the published ones in words, cases down and figures across; None without any."""
    names = _references(study)
    if not names:
        return None
    rows = []
    for case in study.cases:
        if not case.reference:
            continue
        cells = []
        for name in names:
            if name not in case.reference:
                cells.append(Cell("–"))
                continue
            theirs = case.reference[name]
            decimals = decimals_of([c.reference[name] for c in study.cases if name in c.reference])
            ours = _value(case, name)
            text = difference(ours, theirs, decimals)
            text = "not in the run here" if name in TIMES and math.isinf(ours) else text
            both = f"{shown(name, ours)} here, {printed(name, theirs, decimals)} published"
            cells.append(Cell(text, both, text == "to the digit"))
        rows.append(Row(case.name, "", tuple(cells)))
    heads = []
    for name in names:
        title, unit = kpi_title(name)
        heads.append(f"{title}, {unit}" if unit else title)
    return Table(tuple(heads), tuple(rows))
