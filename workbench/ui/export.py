"""What leaves the page as a file: the scenario, and tables as CSV in which no text can become a formula."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable

from workbench.errors import InvalidValue, ScenarioError
from workbench.ui.state import ROWS, Session

__all__ = ["defused", "made"]

_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def defused(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula: an apostrophe before what begins like one."""
    return f"'{text}" if text.lstrip(" \n").startswith(_FORMULA) else text


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


def _csv(rows: Iterable[Iterable[str]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.12g}"


def _trends(session: Session) -> str:
    """Return the page's own run, a row for each sample."""
    own = session.own
    if own is None or own.run is None:
        raise ScenarioError("nothing was simulated")
    run = own.run
    columns = [run.time, run.sp, run.pv, run.op, run.valve]
    rows = ([_number(float(value)) for value in row] for row in zip(*columns, strict=True))
    return _csv([["time_s", "SP", "PV", "OP", "valve"], *rows])


def _figures(session: Session) -> str:
    """Return the pinned cases and the page's own: settings and every figure, a row for each case."""
    own = [session.own] if session.own is not None else []
    names = [name for name, *_ in ROWS if name != "objective"]
    rows: list[list[str]] = [["case", "Kc", "Ti", "Td", "form", "objective", *names]]
    for one in [*session.runs(), *own]:
        pid = one.controller
        figures = [math.nan if one.run is None else float(getattr(one.run.kpis, name)) for name in names]
        settings = [_number(v) for v in (pid.Kc, pid.Ti, pid.Td)]
        rows.append([defused(one.name), *settings, pid.form, _number(one.objective), *map(_number, figures)])
    return _csv(rows)
