"""How a result shows itself in a notebook: a plain table of its figures with their units, all text escaped.

Which attributes of a result are worth a row stands here, in one place; titles and units are those of `titles`.
"""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from typing import Any, ClassVar

import numpy as np

from workbench.model.numbers import duration, figure, given, interval
from workbench.model.titles import KPI_ROWS, kpi_title, within

__all__ = ["SHOWN", "Shown", "rows_of"]

Row = tuple[str, str, str]  # title, value, unit
Rows = Callable[[Any], Iterator[Row]]


class Shown:
    """Base of results that a notebook shows as a table."""

    __slots__: ClassVar[tuple[str, ...]] = ()

    def _repr_html_(self) -> str:
        """Return the result as an HTML table: what it is above, then title, value and unit of each figure."""
        body = "".join(
            '<tr><th scope="row" style="text-align:left;font-weight:normal">'
            f'{html.escape(title)}</th><td style="text-align:left;max-width:60em">{html.escape(text)}</td>'
            f'<td style="text-align:left">{html.escape(unit)}</td></tr>'
            for title, text, unit in rows_of(self)
        )
        name = html.escape(type(self).__name__)
        return f'<table><caption style="text-align:left">{name}</caption><tbody>{body}</tbody></table>'


def rows_of(result: object) -> list[Row]:
    """Return (title, value, unit), as text, of what is worth showing of a result; KeyError for what is none."""
    rows: list[Row] = []
    for path in SHOWN[type(result).__name__]:
        if callable(path):
            rows += path(result)
            continue
        value, part = result, ""
        *owners, name = path.split(".")
        for owner in owners:
            value = getattr(value, owner, None)
            part = owner.replace("_", " ").capitalize() if owner in PARTS else part
        value = getattr(value, name, None)
        if value is not None:
            title, unit = kpi_title(name)
            title = f"{part}: {within(title)}" if part else title[:1].upper() + title[1:]
            rows += ((title if i == 0 else "", *row) for i, row in enumerate(_texts(name, value, unit)))
    return rows


def _texts(name: str, value: Any, unit: str) -> list[tuple[str, str]]:
    """Return a value as lines of (text, unit)."""
    if isinstance(value, bool):
        return [("yes" if value else "no", "")]
    if isinstance(value, Enum):
        return [(str(value.value), "")]
    if isinstance(value, float):
        if unit == "s" or name in TIMES:
            return [(duration(value), "")]
        return [(figure(value), "" if math.isnan(value) else unit)]
    if isinstance(value, np.ndarray):
        finite = value[np.isfinite(value)]
        ends = f"{figure(float(finite.min()))} to {figure(float(finite.max()))}" if finite.size else "none"
        return [(f"{ends} ({' x '.join(map(str, value.shape))} values)", unit)]
    if isinstance(value, tuple) and len(value) == 2 and all(isinstance(v, float) for v in value):
        return [("–" if math.isnan(value[0]) else f"{figure(value[0])} to {figure(value[1])}", unit)]
    if isinstance(value, tuple):
        texts = all(isinstance(v, str) for v in value)
        return [(v, "") for v in value] if texts else [(f"{len(value):,}", "")]
    if is_dataclass(value):
        return [(_words(value), "")]
    return [(str(value).replace("_", " ") if name == "verdict" else str(value), "")]


TIMES = ("settling_time", "oscillation_period")


def _words(value: Any) -> str:
    """Return a small frozen value in words: its kind, and what of it is not as it is by default, with units."""
    parts = []
    for one in fields(value):
        content = getattr(value, one.name)
        if content is None or (_default(one) is not MISSING and content == _default(one)):
            continue
        title, unit = kpi_title(one.name)
        if type(value).__name__ == "Integrating" and one.name == "gain":
            unit = "EU/(% s)"
        if getattr(value, "form", "") == "parallel" and one.name in ("Ti", "Td"):
            unit = {"Ti": "EU s/%", "Td": "% s/EU"}[one.name]
        if is_dataclass(content) and not isinstance(content, type):
            text = _words(content)
        elif isinstance(content, float):
            text = "none" if math.isinf(content) else f"{given(content)} {unit}".rstrip()
        else:
            text = str(content)
        parts.append(f"{within(title)} {text}")
    return f"{type(value).__name__}({', '.join(parts)})"


def _default(one: Field[Any]) -> object:
    return one.default if one.default_factory is MISSING else one.default_factory()


def _statistics(found: Any) -> Iterator[Row]:
    for one in found.statistics:
        yield one.name, figure(one.value), one.unit
        yield "", one.says, ""


def _intervals(found: Any) -> Iterator[Row]:
    for one in fields(found.intervals):
        pair = getattr(found.intervals, one.name)
        if pair is not None:
            title, unit = kpi_title(one.name)
            unit = "EU/(% s)" if one.name == "gain" and type(found.plant).__name__ == "Integrating" else unit
            yield f"{title}, 95 %", interval(pair, ""), unit


def _summary(record: Any) -> Iterator[Row]:
    for i, line in enumerate(record.summary()):
        yield "Record" if i == 0 else "", line, ""


def _cases(study: Any) -> Iterator[Row]:
    for case in study.cases:
        yield case.name, _words(case.loop.controller), ""
        kpis = case.run.kpis
        words = f"mean square error {figure(kpis.mean_square_error)} EU², valve travel {figure(kpis.valve_travel)} %"
        yield "", words if case.objective is None else f"J {figure(case.objective)}, {words}", ""
    for one in study.estimates:
        yield one.name, f"{one.found.verdict}: {_words(one.found.plant)}; {_words(one.found.valve)}", ""
    for one in study.cascade:
        yield one.name, f"primary {_words(one.run.cascade.primary.controller)}", ""
        yield "", f"secondary {_words(one.run.cascade.secondary.controller)}", ""


PARTS = ("primary", "secondary", "present", "repaired", "best", "best_repaired")
_KPIS = (*(name for name, *_ in KPI_ROWS), "ise")
_LOOP = ("loop.plant", "loop.valve", "loop.controller", "loop.sample_time")
_OVER = ("mse_mean", "mse_median", "mse_p90", "travel_mean", "travel_median", "max_sensitivity")
_CYCLE = ("period", "pv_peak_to_peak", "op_peak_to_peak", "mean_square_error", "travel_per_hour", "reversals_per_hour")
_OUTCOME = ("controller", "objective", "kpis.mean_square_error", "kpis.valve_travel")

# The rows of each result, by the name of its class: attributes, or what makes rows of the result.
SHOWN: dict[str, tuple[str | Rows, ...]] = {
    "Kpis": _KPIS,
    "Run": (*_LOOP, "experiment", *(f"kpis.{name}" for name in _KPIS)),
    "Record": (_summary, "sample_time", "sp", "pv", "op", "valve_position"),
    "Estimate": (
        "verdict",
        "reasons",
        "plant",
        "valve",
        _intervals,
        "identifiable",
        "noise_sd",
        "slips",
        "method",
    ),
    "Detection": ("verdict", "reasons", _statistics),
    "LimitCycle": (
        "verdict",
        "outcome",
        *_CYCLE,
        "period_range",
        "closed_form_period",
        "window",
        *_LOOP[:3],
    ),
    "DescribingFunction": (
        "verdict",
        "prediction",
        "amplitude",
        "period",
        "pv_amplitude",
        "distance",
        "linear_stable",
        *_LOOP[:3],
    ),
    "Margins": ("stable", "max_sensitivity", "frequency", "gain_margin", "phase_margin", "delay_margin", *_LOOP[:3]),
    "Tuned": (
        "controller",
        "objective",
        "start_objective",
        "worst",
        "knife_edge",
        "status",
        "message",
        *(f"robustness.{name}" for name in _OVER),
    ),
    "Robustness": (*_OVER, "gain_margin", "phase_margin", "stable", "diverged", *_LOOP[:3]),
    "Repair": tuple(f"{part}.{name}" for part in PARTS[2:] for name in _OUTCOME),
    "RobustRepair": (
        *(f"{part}.{name}" for part in PARTS[2:] for name in ("loop.controller", "mse_mean", "travel_mean")),
        "share",
    ),
    "Front": ("status", "message", "sticky", "repaired", "constraints", "bounds"),
    "CycleMap": ("axis", "Kc", "values", "period", "pv_peak_to_peak", "mean_square_error", "travel_per_hour"),
    "Signature": (
        "valve",
        "dead_band_down",
        "dead_band_up",
        "resolution_up",
        "resolution_down",
        "dead_band",
        "resolution",
    ),
    "CascadeRun": tuple(
        f"{part}.{name}" for part in PARTS[:2] for name in (*_LOOP[:3], *(f"kpis.{kpi}" for kpi in _KPIS))
    ),
    "CascadeCycle": (
        "outcome",
        "reason",
        "period",
        "travel_per_hour",
        *(f"{part}.{kind}_peak_to_peak" for part in PARTS[:2] for kind in ("pv", "sp", "op")),
    ),
    "CascadeTuned": (
        "start_objective",
        *(f"{part}.{name}" for part in PARTS[:2] for name in ("controller", "objective", "status", "message")),
    ),
    "Study": ("title", _cases, "notes"),
}
