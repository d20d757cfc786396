"""What repairing the valve is worth, as the report tells it: four outcomes in a table, all cases in another, words."""

from __future__ import annotations

import math
from collections.abc import Callable

from workbench.model.results import Outcome, Repair
from workbench.model.study import Study
from workbench.model.titles import KPI_ROWS
from workbench.report.tables import Cell, Row, Table, shown
from workbench.report.words import change, controller_words, figure, setting

__all__ = ["repair_sentence", "repair_tables", "repair_text"]

FIGURES = ("error_variance", "mean_square_error", "valve_travel", "controller_travel", "reversals", "iae")
WORTH_NAMING = 0.05  # share of the error below which repair is not said to remove anything
NOTHING = 1e-9  # EU^2: an error this small is none


def repair_tables(study: Study) -> list[Table]:
    """Return the four outcomes (sticky or repaired, present or best tuning), and every case with a repaired valve."""
    repair = study.repair
    if repair is None:
        return []
    outcomes = (repair.present, repair.repaired, repair.best, repair.best_repaired)
    digits = (None, None, repair.tuned.digits, repair.tuned_repaired.digits)
    heads = ("present tuning, sticky", "present tuning, repaired", "best tuning, sticky", "best tuning, repaired")
    parallel = repair.loop.controller.form == "parallel"
    rows = [
        Row(
            name,
            unit,
            tuple(Cell(setting(getattr(o.controller, name), d)) for o, d in zip(outcomes, digits, strict=True)),
        )
        for name, unit in (("Kc", "%/EU"), ("Ti", "EU s/%" if parallel else "s"), ("Td", "% s/EU" if parallel else "s"))
    ]
    rows.append(Row("J", "", tuple(Cell(figure(o.objective)) for o in outcomes), group=True))
    for name, title, unit, _ in KPI_ROWS:
        if name in FIGURES:
            rows.append(Row(title, unit, tuple(Cell(shown(name, float(getattr(o.kpis, name)))) for o in outcomes)))
    return [Table(heads, tuple(rows)), _cases_table(study)]


def _cases_table(study: Study) -> Table:
    columns: tuple[tuple[str, Callable[[Outcome], float]], ...] = (
        ("Error variance, EU²", lambda o: o.kpis.error_variance),
        ("Mean square error, EU²", lambda o: o.kpis.mean_square_error),
        ("Valve travel, %", lambda o: o.kpis.valve_travel),
    )
    rows = []
    for case in study.cases:
        if case.repaired is None:
            continue
        sticky = Outcome(case.loop.controller, math.nan, case.run.kpis)
        cells = [
            Cell(
                change(of(case.repaired), of(sticky)),
                f"{figure(of(sticky))} sticky, {figure(of(case.repaired))} repaired",
            )
            for _, of in columns
        ]
        rows.append(Row(case.name, "", tuple(cells)))
    return Table(tuple(head for head, _ in columns), tuple(rows))


def repair_text(repair: Repair) -> list[str]:
    """Return the sentences of the report's section."""
    best, repaired = repair.best, repair.best_repaired
    settings = (
        f"{controller_words(best.controller, repair.tuned.digits)} with the sticky valve, "
        f"{controller_words(repaired.controller, repair.tuned_repaired.digits)} with the repaired one"
    )
    what = (
        "The same experiment with an ideal valve in place of the sticky one, at the present tuning and at the best one"
    )
    text = [f"{what}: {settings}, searched for within the same bounds and for the same J.", _limit(repair)]
    text += [
        f"The search with the {what} valve ended as “{one.status.value}”: its best tuning is the best found so far."
        for what, one in (("sticky", repair.tuned), ("repaired", repair.tuned_repaired))
        if not one.status.success
    ]
    return text


def _limit(repair: Repair) -> str:
    """Say which share of the error no tuning removes."""
    best, repaired = repair.best.kpis, repair.best_repaired.kpis
    left = best.mean_square_error
    if not math.isfinite(left) or left < NOTHING:
        return "The best tuning leaves no error that a repair could remove in this experiment."
    share = repair.share("mean_square_error")
    if share < WORTH_NAMING:
        return (
            f"In this experiment the best tuning for the sticky valve does as well as a repair: mean square error "
            f"{figure(left)} EU² against {figure(repaired.mean_square_error)} EU². One run without further "
            "disturbances flatters it: where the setpoint lies between two of the valve's steps, the loop cycles."
        )
    variance = repair.share("error_variance")
    also = "" if math.isnan(variance) else f" ({figure(100.0 * variance, 2)} % of the error variance)"
    return (
        f"Of the mean square error that the best tuning found for the sticky valve leaves ({figure(left)} EU²), "
        f"{figure(100.0 * share, 2)} % goes only with the repair{also}: {figure(repaired.mean_square_error)} EU² "
        "remain with the repaired valve at its own best tuning."
    )


def repair_sentence(repair: Repair, present: str) -> str:
    """Return the summary's sentence. present: the name of the case of the present tuning."""
    was, now = repair.present.kpis, repair.repaired.kpis
    text = f"What repair is worth: with an ideal valve {present} has mean square error "
    text += f"{figure(now.mean_square_error)} EU² instead of {figure(was.mean_square_error)} EU², valve travel "
    text += f"{figure(now.valve_travel)} % instead of {figure(was.valve_travel)} %."
    return f"{text} {_limit(repair)}"
