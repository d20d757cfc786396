"""A cascade's settings as the site types them in, for both controllers: in words, and beside those as found."""

from __future__ import annotations

import math

import numpy as np

from workbench.model.controller import PID
from workbench.model.results import Kpis
from workbench.model.site import CascadeSiteCase, SiteForm, SiteSettings
from workbench.model.study import CascadeResult, Study
from workbench.model.titles import kpi_title, within
from workbench.report.judge import settling_doubt
from workbench.report.settings import (
    ALWAYS,
    beside_content,
    form_content,
    rounded,
    setting_names,
    setting_texts,
    typed_content,
    typed_words,
)
from workbench.report.shared import CONTROLLER_ROWS
from workbench.report.tables import Cell, Row, Table, shown
from workbench.report.words import change, controller_words

__all__ = [
    "cascade_base",
    "cascade_error",
    "cascade_kpis",
    "cascade_rounding",
    "cascade_site_content",
    "cascade_site_table",
    "cascade_table",
    "cascade_typed",
    "cascade_words",
]

PARTS = ("primary", "secondary")
EFFECT = (
    ("primary", ("mean_square_error", "pv_sd", "settling_time", "oscillation_index")),
    ("secondary", ("valve_travel", "reversals")),
)


def cascade_base(study: Study) -> CascadeResult | None:
    """Return the case that others are compared with: the first whose controllers were given."""
    return next((case for case in study.cascade if case.tuned is None), None)


def cascade_typed(study: Study, case: CascadeResult) -> CascadeSiteCase | None:
    """Return the case as typed in at the site, None where the scenario does not say how the site writes."""
    return next((o for o, own in zip(study.cascade_site_cases, study.cascade, strict=False) if own is case), None)


def cascade_kpis(case: CascadeResult) -> tuple[Kpis, Kpis, float]:
    """Return the figures of both loops, and J (nan without one)."""
    return case.run.primary.kpis, case.run.secondary.kpis, math.nan if case.objective is None else case.objective


def cascade_error(case: CascadeResult, kpis: Kpis) -> tuple[str, float]:
    """Return what the scatter of the primary's PV is called, and its size (EU): about a setpoint that moves."""
    sp = case.run.primary.sp
    name = (
        "standard deviation of the primary's SP − PV"
        if np.any(sp != sp[0])
        else "standard deviation of the primary's PV"
    )
    return name, math.sqrt(kpis.error_variance)


def _form(study: Study, case: CascadeResult, which: str) -> SiteForm:
    """Return the form that a controller's settings stand in: the site's, or its own."""
    if study.cascade_site is not None:
        form: SiteForm = getattr(study.cascade_site, which)
        return form
    return SiteForm(_pid(case, which).form, output=_out(case, which))


def _out(case: CascadeResult, which: str) -> str:
    return case.run.cascade.output_unit if which == "primary" else "%"


def _pid(case: CascadeResult, which: str) -> PID:
    pid: PID = getattr(case.run.cascade, which).controller
    return pid


def _written(study: Study, case: CascadeResult, which: str) -> SiteSettings | None:
    """Return a controller's settings as they are typed in, None where the site's form has no equivalent."""
    typed = cascade_typed(study, case)
    if typed is None:
        return _form(study, case, which).settings(_pid(case, which))
    found: SiteSettings | None = getattr(typed, which)
    return found


def _digits(case: CascadeResult, which: str) -> int | None:
    tuned = None if case.tuned is None else getattr(case.tuned, which)
    return None if tuned is None else tuned.digits


def cascade_words(study: Study, case: CascadeResult, which: str) -> str:
    """Return the settings of a case's primary or secondary as the site types them in."""
    written = _written(study, case, which)
    if study.cascade_site is not None and written is not None:
        return typed_words(_form(study, case, which), written, _digits(case, which))
    return _own_words(case, which)


def _own_words(case: CascadeResult, which: str) -> str:
    return controller_words(_pid(case, which), _digits(case, which), _out(case, which))


def cascade_table(study: Study, base: CascadeResult, best: CascadeResult) -> Table:
    """Return both controllers' settings as found and as left, and what the same run gives with each.

    base: the case as found; where it is itself the one to keep, the table has one column.
    """
    cases = [best] if base is best else [base, best]
    heads = [best.name]
    if len(cases) > 1:
        titles = (("as found", base), ("as left", best))
        heads = [what if case.name.lower() == what else f"{what}: {case.name}" for what, case in titles] + ["change"]
    rows: list[Row] = []
    for which in PARTS:
        rows += _settings(study, cases, which)
    return Table(tuple(heads), (*rows, *_effect(study, cases)))


def _settings(study: Study, cases: list[CascadeResult], which: str) -> list[Row]:
    forms = [_form(study, case, which) for case in cases]
    site = forms[0] if len(set(forms)) == 1 else SiteForm(output=forms[0].output)
    written = [_written(study, case, which) for case in cases]
    texts = [
        ("no equivalent",) * 3 if one is None else setting_texts(form, one, _digits(case, which))
        for one, form, case in zip(written, forms, cases, strict=True)
    ]
    pids = [_pid(case, which) if one is None else one.controller for one, case in zip(written, cases, strict=True)]
    blank = (Cell(""),) if len(cases) > 1 else ()

    def row(title: str, every: list[str]) -> Row:
        words = f"{which.capitalize()}: {within(title)}"
        return Row(words, "", (*(Cell(text) for text in every), *blank), group=title == "Form")

    rows = [row("Form", [pid.form for pid in pids])]
    rows += [row(name, [text[i] for text in texts]) for i, name in enumerate(setting_names(site))]
    for name, describe in CONTROLLER_ROWS[1:]:
        both = [describe(pid) for pid in pids]
        if name in ALWAYS or len(set(both)) > 1 or (name == "Derivative filter" and set(both) != {"–"}):
            rows.append(row(name, both))
    return rows


def _effect(study: Study, cases: list[CascadeResult]) -> list[Row]:
    """Return what the run gives with the settings of the columns, then what the long run does."""
    kpis = [cascade_kpis(case) for case in cases]
    rows: list[Row] = []

    def add(title: str, unit: str, name: str, values: list[float], doubts: list[str] | None = None) -> None:
        if all(math.isnan(value) for value in values):
            return
        notes = doubts or [""] * len(values)
        cells = [Cell(shown(name, value), note) for value, note in zip(values, notes, strict=True)]
        if len(values) > 1:
            known = not any(notes) and all(math.isfinite(value) for value in values)
            known = known and not (name == "settling_time" and 0.0 in values)
            cells.append(Cell(change(values[-1], values[0]) if known else "–"))
        rows.append(Row(title, unit, tuple(cells), group=not rows or name == "late"))

    add("J", "", "objective", [one[2] for one in kpis])
    for which, names in EFFECT:
        for name in names:
            title, unit = kpi_title(name)
            values = [float(getattr(one[PARTS.index(which)], name)) for one in kpis]
            doubts = [settling_doubt(case, study.experiment) for case in cases] if name == "settling_time" else None
            add(f"{which.capitalize()}: {within(title)}", unit, name, values, doubts)
            if name == "pv_sd" and cascade_error(cases[0], kpis[0][0])[0].endswith("SP − PV"):
                about = [cascade_error(case, one[0])[1] for case, one in zip(cases, kpis, strict=True)]
                add("Primary: standard deviation of SP − PV", "EU", "error_sd", about)
    cycles = [case.cycle for case in cases]
    seen = [one.primary for one in cycles if one is not None]
    if len(seen) == len(cases) and all(one is not None for one in seen):
        swings = [one.pv_peak_to_peak for one in seen if one is not None]
        add("Primary: PV peak to peak of the late cycle", "EU", "late", swings)
        travels = [one.travel_per_hour for one in cycles if one is not None]
        add("Secondary: valve travel of the late cycle, an hour", "%", "travel_per_hour", travels)
    return rows


def cascade_rounding(case: CascadeResult) -> list[str]:
    """Return what the site's form and digits have made of a case, where they round it, and that the page tells that."""
    if case.unrounded is None:
        return []
    own = " over ".join(_own_words(case.unrounded, which) for which in PARTS)
    (one, two, cost), was = cascade_kpis(case), cascade_kpis(case.unrounded)
    pairs = [
        ("mean square error of the primary", one.mean_square_error, was[0].mean_square_error, " EU²"),
        ("valve travel", two.valve_travel, was[1].valve_travel, " %"),
    ]
    if case.objective is not None:
        pairs.insert(0, ("J", cost, was[2], ""))
    return [rounded(case.name, own, pairs)]


def cascade_site_table(study: Study) -> Table | None:
    """Return every case as typed in at the site, cases down; None where the scenario does not say how."""
    site = study.cascade_site
    if site is None:
        return None
    heads = [f"{which.capitalize()}: {within(n)}" for which in PARTS for n in setting_names(getattr(site, which))]
    rows = []
    for case in study.cascade:
        texts: list[str] = []
        for which in PARTS:
            written = _written(study, case, which)
            none = ("no equivalent",) * 3
            form = _form(study, case, which)
            texts += none if written is None else setting_texts(form, written, _digits(case, which))
        rows.append(Row(case.name, "", tuple(Cell(text) for text in texts)))
    return Table(tuple(heads), tuple(rows))


def cascade_site_content(study: Study) -> dict[str, object]:
    """Return what results.json holds of the site's form and the cascade's cases in it."""
    site = study.cascade_site
    if site is None:
        return {}
    content: dict[str, object] = {}
    for which in PARTS:
        content[which] = form_content(getattr(site, which))
    cases = []
    for one in study.cascade_site_cases:
        case: dict[str, object] = {"name": one.name, "refused": one.refused or None}
        if one.primary is not None and one.secondary is not None and one.kpis is not None:
            for which, settings, kpis in zip(PARTS, (one.primary, one.secondary), one.kpis, strict=True):
                case[which] = typed_content(settings, kpis)
            case["objective"] = one.objective
        if one.beside is not None:
            case["beside"] = beside_content(one.beside)
        cases.append(case)
    return content | {"cases": cases}
