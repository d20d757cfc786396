"""What leaves the page as a file: the scenario, and tables as CSV in which no text can become a formula."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

from workbench.errors import InvalidValue, ScenarioError
from workbench.report.cells import cell
from workbench.report.words import compensator_words
from workbench.ui.state import Session, value_of

__all__ = ["made"]

MOST_ROWS = 500_000  # of a table that goes through a browser


def made(what: str, session: Session) -> tuple[str, str, str]:
    """Return (file name, media type, content) of "scenario", "trends" or "figures".

    Raises `ScenarioError` where the page holds something that is refused, `InvalidValue` for anything else.
    """
    if session.stale:  # the run that shows is not of what stands there
        raise ScenarioError("\n".join(problem.text for problem in session.problems))
    if what == "scenario":
        return "scenario.yaml", "application/yaml", session.scenario()
    if what == "trends":
        return "trends.csv", "text/csv", _trends(session)
    if what == "figures":
        return "figures.csv", "text/csv", _figures(session)
    raise InvalidValue("export", what, "must be one of scenario, trends, figures, report")


def _csv(rows: Iterable[Iterable[object]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([cell(value) for value in row] for row in rows)
    return out.getvalue()


def _trends(session: Session) -> str:
    """Return the page's own run, a row for each sample."""
    own = session.own
    if own is None or own.run is None or own.outer is None:
        raise ScenarioError("nothing was simulated")
    run, outer = own.run, own.outer
    if run.time.size > MOST_ROWS:
        raise InvalidValue("samples", f"{run.time.size:,}", f"must be at most {MOST_ROWS:,} to leave as a table")
    names, columns = ["time_s", "SP", "PV", "OP", "valve"], [run.time, run.sp, run.pv, run.op, run.valve]
    if outer is not run:
        names[1:1] = ["primary_SP", "primary_PV", "primary_OP"]
        columns[1:1] = [outer.sp, outer.pv, outer.op]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return _csv([names, *rows])


def _figures(session: Session) -> str:
    """Return the pinned cases and the page's own: settings and every figure, a row for each case.

    Of a cascade the settings of its primary stand before those of its secondary.
    """
    own = [session.own] if session.own is not None else []
    names = [name for name, *_ in session.rows if name != "objective"]
    settings = ["Kc", "Ti", "Td", "form", "compensator"]
    above = [f"primary_{name}" for name in settings] if session.screen.cascade else []
    rows: list[list[object]] = [["case", *above, *settings, "objective", *names]]
    for one in [*session.runs(), *own]:
        pids = [pid for pid in (one.primary, one.controller) if pid is not None]
        told = [v for pid in pids for v in (pid.Kc, pid.Ti, pid.Td, pid.form, compensator_words(pid.compensator))]
        rows.append([one.name, *told, one.objective, *(value_of(one, name) for name in names)])
    return _csv(rows)
