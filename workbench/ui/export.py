"""What leaves the page as a file: the scenario, and tables as CSV in which no text can become a formula."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable

from workbench.errors import InvalidValue, ScenarioError
from workbench.report.cells import cell
from workbench.ui.state import ROWS, Session

__all__ = ["made"]

MOST_ROWS = 500_000  # of a table that goes through a browser


def made(what: str, session: Session) -> tuple[str, str, str]:
    """Return (file name, media type, content) of "scenario", "trends" or "figures".

    Raises `ScenarioError` where the page holds something that is refused, `InvalidValue` for anything else.
    """
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
    if own is None or own.run is None:
        raise ScenarioError("nothing was simulated")
    run = own.run
    if run.time.size > MOST_ROWS:
        raise InvalidValue("samples", f"{run.time.size:,}", f"must be at most {MOST_ROWS:,} to leave as a table")
    columns = [run.time, run.sp, run.pv, run.op, run.valve]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return _csv([["time_s", "SP", "PV", "OP", "valve"], *rows])


def _figures(session: Session) -> str:
    """Return the pinned cases and the page's own: settings and every figure, a row for each case."""
    own = [session.own] if session.own is not None else []
    names = [name for name, *_ in ROWS if name != "objective"]
    rows: list[list[object]] = [["case", "Kc", "Ti", "Td", "form", "objective", *names]]
    for one in [*session.runs(), *own]:
        pid = one.controller
        figures = [math.nan if one.run is None else float(getattr(one.run.kpis, name)) for name in names]
        rows.append([one.name, pid.Kc, pid.Ti, pid.Td, pid.form, one.objective, *figures])
    return _csv(rows)
