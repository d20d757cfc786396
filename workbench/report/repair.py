"""What repairing the valve is worth, as the report tells it: four outcomes in a table, all cases in another, words."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from workbench.model.front import RobustRepair
from workbench.model.results import Outcome, Repair
from workbench.model.study import CaseResult, Study
from workbench.model.titles import KPI_ROWS
from workbench.report.judge import base_case
from workbench.report.standing import held_by_stiction
from workbench.report.tables import Cell, Row, Table, shown
from workbench.report.words import change, controller_words, figure, setting

__all__ = ["repair_sentence", "repair_tables", "repair_text", "robust_repair_table", "robust_repair_text"]

FIGURES = ("error_variance", "mean_square_error", "valve_travel", "controller_travel", "reversals", "iae")
WORTH_NAMING = 0.05  # share of the error below which repair is not said to remove anything
NOTHING = 1e-9  # EU^2: an error this small is none
UNSTABLE = "unstable"


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
    falls = held_by_stiction(_present(study).standing)

    def cells(text: Callable[[Outcome], str]) -> tuple[Cell, ...]:
        # Figures of a loop that grows without bound tell how long the run is, and nothing else.
        return tuple(Cell(UNSTABLE if falls and o is repair.repaired else text(o)) for o in outcomes)

    rows.append(Row("J", "", cells(lambda o: figure(o.objective)), group=True))
    for name, title, unit, _ in KPI_ROWS:
        if name in FIGURES:
            rows.append(Row(title, unit, cells(partial(_shown, name))))
    return [Table(heads, tuple(rows)), _cases_table(study)]


def _shown(name: str, outcome: Outcome) -> str:
    return shown(name, float(getattr(outcome.kpis, name)))


def _present(study: Study) -> CaseResult:
    """Return the case of the present tuning."""
    return base_case(study) or study.cases[0]


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
        falls = held_by_stiction(case.standing)
        cells = [
            Cell(
                UNSTABLE if falls else change(of(case.repaired), of(sticky)),
                f"{figure(of(sticky))} sticky{'' if falls else f', {figure(of(case.repaired))} repaired'}",
            )
            for _, of in columns
        ]
        rows.append(Row(case.name, "", tuple(cells)))
    return Table(tuple(head for head, _ in columns), tuple(rows))


def repair_text(study: Study) -> list[str]:
    """Return the sentences of the report's section, none where the study does not ask what repair is worth."""
    repair = study.repair
    if repair is None:
        return []
    best, repaired = repair.best, repair.best_repaired
    settings = (
        f"{controller_words(best.controller, repair.tuned.digits)} with the sticky valve, "
        f"{controller_words(repaired.controller, repair.tuned_repaired.digits)} with the repaired one"
    )
    what = (
        "The same experiment with an ideal valve in place of the sticky one, at the present tuning and at the best one"
    )
    text = [f"{what}: {settings}, searched for within the same bounds and for the same J.", _limit(study, repair)]
    text += [
        f"The search with the {what} valve ended as “{one.status.value}”: its best tuning is the best found so far."
        for what, one in (("sticky", repair.tuned), ("repaired", repair.tuned_repaired))
        if not one.status.success
    ]
    return text


def _limit(study: Study, repair: Repair) -> str:
    """Say which share of the error no tuning removes."""
    alone = any(case.tuned is repair.tuned and held_by_stiction(case.standing) for case in study.cases)
    sticky = f"the sticky valve{' (a loop that only stiction holds)' if alone else ''}"
    best, repaired = repair.best.kpis, repair.best_repaired.kpis
    left = best.mean_square_error
    if not math.isfinite(left) or left < NOTHING:
        return "The best tuning leaves no error that a repair could remove in this experiment."
    share = repair.share("mean_square_error")
    if share < WORTH_NAMING:
        return (
            f"In this experiment the best tuning for {sticky} does as well as a repair: mean square error "
            f"{figure(left)} EU² against {figure(repaired.mean_square_error)} EU². One run without further "
            "disturbances flatters it: where the setpoint lies between two of the valve's steps, the loop cycles."
        )
    variance = repair.share("error_variance")
    also = "" if math.isnan(variance) else f" ({figure(100.0 * variance, 2)} % of the error variance)"
    return (
        f"Of the mean square error that the best tuning found for {sticky} leaves ({figure(left)} EU²), "
        f"{figure(100.0 * share, 2)} % goes only with the repair{also}: {figure(repaired.mean_square_error)} EU² "
        "remain with the repaired valve at its own best tuning."
    )


def repair_sentence(study: Study) -> str:
    """Return the summary's sentence, "" where the study does not ask what repair is worth."""
    repair = study.repair
    if repair is None:
        return ""
    was, now, case = repair.present.kpis, repair.repaired.kpis, _present(study)
    lead = f"What repair is worth: with an ideal valve {case.name}"
    if held_by_stiction(case.standing):
        return f"{lead} is unstable. {_limit(study, repair)}"
    text = f"{lead} has mean square error "
    text += f"{figure(now.mean_square_error)} EU² instead of {figure(was.mean_square_error)} EU², valve travel "
    text += f"{figure(now.valve_travel)} % instead of {figure(was.valve_travel)} %."
    return f"{text} {_limit(study, repair)}"


def robust_repair_text(study: Study) -> list[str]:
    """Return what repair is worth over the ensemble, in words."""
    repair = study.robust_repair
    if repair is None:
        return []
    best, repaired = repair.best, repair.best_repaired
    ours = controller_words(best.loop.controller, repair.tuned.digits)
    theirs = controller_words(repaired.loop.controller, repair.tuned_repaired.digits)
    text = [
        (
            f"Over {best.ensemble.draws:,} draws of the ensemble: with a repaired valve at the present tuning the mean "
            f"square error is {figure(repair.repaired.mse_mean, 3)} EU² instead of "
            f"{figure(repair.present.mse_mean, 3)} EU², valve travel {figure(repair.repaired.travel_mean, 3)} % "
            f"instead of {figure(repair.present.travel_mean, 3)} % (means)."
        ),
        (
            f"The best robust tuning of the sticky valve ({ours}) leaves {figure(best.mse_mean, 3)} EU², that of the "
            f"repaired one ({theirs}) {figure(repaired.mse_mean, 3)} EU²: {_that_goes(repair)}"
        ),
    ]
    if not repair.tuned_repaired.status.success:
        text.append(f"The search with the repaired valve ended as “{repair.tuned_repaired.status.value}”.")
    return text


def _that_goes(repair: RobustRepair) -> str:
    """Say what share of the error goes only with the repair, and what a cap on travel makes of that."""
    text = f"{figure(100.0 * repair.share, 2)} % of the error goes only with the repair, whatever tuning keeps the "
    text = f"{text}constraints." if repair.share > 0.0 else "within the constraints a repair lessens no error."
    asked = repair.tuned.constraints
    if asked is None or asked.valve_travel is None:
        return text
    text += f" Among them is a mean valve travel of at most {figure(asked.valve_travel, 3)} %"
    if repair.best.ensemble.noise[1] == 0.0:
        return f"{text}."
    return f"{text}: a repaired valve follows the noise, which a sticking stem ignores, and uses it up sooner."


def robust_repair_table(study: Study) -> Table | None:
    """Return the four outcomes over the ensemble."""
    repair = study.robust_repair
    if repair is None:
        return None
    four = (repair.present, repair.repaired, repair.best, repair.best_repaired)
    digits = (None, None, repair.tuned.digits, repair.tuned_repaired.digits)
    heads = ("present tuning, sticky", "present tuning, repaired", "best robust, sticky", "best robust, repaired")
    rows = (
        Row(
            "Settings",
            "",
            tuple(Cell(controller_words(r.loop.controller, d)) for r, d in zip(four, digits, strict=True)),
        ),
        Row("Mean square error, median", "EU²", tuple(Cell(figure(r.mse_median, 3)) for r in four), group=True),
        Row("90th percentile", "EU²", tuple(Cell(figure(r.mse_p90, 3)) for r in four)),
        Row("mean", "EU²", tuple(Cell(figure(r.mse_mean, 3)) for r in four)),
        Row("Valve travel, median", "%", tuple(Cell(figure(r.travel_median, 3)) for r in four)),
        Row("mean", "%", tuple(Cell(figure(r.travel_mean, 3)) for r in four)),
        Row("Ms at the worst corner", "", tuple(Cell(figure(r.max_sensitivity, 3)) for r in four)),
    )
    return Table(heads, rows)
