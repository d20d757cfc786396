"""A case's settings as the site types them in: in words, and beside the settings as found."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from workbench.model.results import Kpis
from workbench.model.site import Beside, SiteCase, SiteForm, SiteSettings
from workbench.model.study import CaseResult, Study
from workbench.model.titles import kpi_title
from workbench.report.judge import late_words, measure, refused, settling_band, settling_doubt, typed_case
from workbench.report.shared import CONTROLLER_ROWS
from workbench.report.tables import Cell, Row, Table, shown
from workbench.report.words import change, controller_words, figure, given, join, nearby, setting

__all__ = [
    "around",
    "as_found_as_left",
    "beside_content",
    "beside_words",
    "case_content",
    "form_content",
    "refused_sentences",
    "rounded",
    "rounding_sentences",
    "setting_names",
    "setting_texts",
    "settings_words",
    "site_content",
    "site_table",
    "spread",
    "typed_content",
    "typed_words",
]

EFFECT = ("mean_square_error", "pv_sd", "valve_travel", "settling_time", "oscillation_index")
ALWAYS = ("Structure", "Action")  # of CONTROLLER_ROWS, shown even where both are alike: they are typed in as well
SAME = 1e-3  # relative difference of a figure below which rounded digits have not changed it


def spread(case: CaseResult, kpis: Kpis) -> tuple[str, float]:
    """Return what PV's scatter in a run is called, and its size (EU): about the setpoint where that moves."""
    moves = bool(np.any(case.run.sp != case.run.sp[0]))
    return "standard deviation of SP − PV" if moves else "PV standard deviation", math.sqrt(kpis.error_variance)


def around(beside: Beside) -> str:
    """Return where settings beside those typed in were looked at, in words."""
    if beside.digits is None:
        return f"within ±{given(100.0 * beside.margin)} % of each setting"
    return nearby(beside.margin)


def beside_words(beside: Beside, was: tuple[float, float] | None, by: str, error: str = "mean square error") -> str:
    """Return what to count on where settings are a knife-edge: their own figures are one draw of many, and no promise.

    was: error (EU^2) and valve travel (%) as found, None where there is nothing to compare with. by: "J", or the error.
    """
    stem = beside.kpis if beside.secondary is None else beside.secondary
    now = beside.kpis.mean_square_error, stem.valve_travel
    if was is None:
        texts = [f"{figure(now[0])} EU²", f"{figure(now[1])} %"]
    else:
        texts = [change(ours, theirs) for ours, theirs in zip(now, was, strict=True)]
    told = f"{error} {texts[0]}, valve travel {texts[1]}"
    told = f"J as much as {figure(beside.worst)} ({told})" if by == "J" else told
    return f" A knife-edge, so count on no more than what settings beside these give: {told}."


def _written(study: Study, case: CaseResult) -> tuple[SiteForm, SiteSettings] | None:
    """Return form and settings of a case as it is typed in, None where the site's form has no equivalent."""
    typed = typed_case(study, case)
    if study.site is None or typed is None:
        own = SiteForm(case.loop.controller.form)
        return own, own.settings(case.loop.controller)
    return None if typed.settings is None else (study.site, typed.settings)


def setting_names(site: SiteForm) -> tuple[str, str, str]:
    """Return what the site calls gain, integral and derivative."""
    if site.form == "parallel":
        return "Gain Kp", "Integral gain Ki", "Derivative gain Kd"
    integral = "Integral rate 1/Ti" if "repeats" in site.integral else "Integral Ti"
    return "Proportional band" if site.gain == "PB %" else "Gain Kc", integral, "Derivative Td"


def _number(value: float, digits: int | None) -> str:
    return "none" if math.isinf(value) else setting(value, digits)


def setting_texts(site: SiteForm, settings: SiteSettings, digits: int | None) -> tuple[str, str, str]:
    """Return gain, integral and derivative with their units; "none" for an action that is not there."""
    integral = "none" if settings.integral == 0.0 else _number(settings.integral, digits)
    numbers = _number(settings.gain, digits), integral, _number(settings.derivative, digits)
    texts = [text if text == "none" else f"{text} {unit}" for text, unit in zip(numbers, site.units, strict=True)]
    return texts[0], texts[1], texts[2]


def settings_words(study: Study, case: CaseResult) -> str:
    """Return the settings of a case as the site types them in: "PB 41.95 %, 6.599 repeats/min (series form)".

    Without `site` those of the controller itself. Where the site's form has no equivalent, these, and that it is so.
    """
    own = controller_words(case.loop.controller, case.digits)
    written = _written(study, case)
    if study.site is None:
        return own
    if written is None:
        return f"{own}, which has no equivalent in the site's {study.site.form} form"
    return typed_words(written[0], written[1], case.digits)


def typed_words(site: SiteForm, settings: SiteSettings, digits: int | None) -> str:
    """Return settings in the site's form: "proportional band 41.95 %, 6.599 repeats/min (series form)"."""
    gain, integral, derivative = setting_texts(site, settings, digits)
    short = {"Proportional band": "proportional band", "Gain Kc": "Kc", "Gain Kp": "Kp"}[setting_names(site)[0]]
    i, d = ("Ki", "Kd") if site.form == "parallel" else ("" if "repeats" in site.integral else "Ti", "Td")
    parts = [f"{short} {gain}", "no integral action" if integral == "none" else f"{i} {integral}".strip()]
    parts += [f"{d} {derivative}"] if settings.derivative != 0.0 else []
    return f"{', '.join(parts)} ({site.form} form)"


def as_found_as_left(study: Study, base: CaseResult | None, best: CaseResult) -> Table:
    """Return the settings as found and as left in the site's form and units, and what the same run gives with each.

    base: None where no tuning as found is given, or it is itself the one to keep; the table has one column then.
    """
    cases = [best] if base is None or base is best else [base, best]
    heads = [_headed("as found", cases[0]), _headed("as left", best), "change"] if len(cases) > 1 else [best.name]
    written = [_written(study, case) for case in cases]
    forms = {one[0] for one in written if one is not None}
    site = next(iter(forms)) if len(forms) == 1 else SiteForm()
    texts = [
        ("no equivalent",) * 3 if one is None else setting_texts(one[0], one[1], case.digits)
        for one, case in zip(written, cases, strict=True)
    ]
    pids = [
        case.loop.controller if one is None else one[1].controller for one, case in zip(written, cases, strict=True)
    ]
    blank = (Cell(""),) if len(cases) > 1 else ()
    rows = [Row("Form", "", (*(Cell(pid.form) for pid in pids), *blank))]
    for i, name in enumerate(setting_names(site)):
        rows.append(Row(name, "", (*(Cell(text[i]) for text in texts), *blank)))
    for name, describe in CONTROLLER_ROWS[1:]:
        both = [describe(pid) for pid in pids]
        if name in ALWAYS or len(set(both)) > 1 or (name == "Derivative filter" and set(both) != {"–"}):
            rows.append(Row(name, "", (*(Cell(text) for text in both), *blank)))
    return Table(tuple(heads), (*rows, *_effect(study, cases)))


def _headed(what: str, case: CaseResult) -> str:
    return what if case.name.lower() == what else f"{what}: {case.name}"


def _effect(study: Study, cases: list[CaseResult]) -> list[Row]:
    """Return what the run gives with the settings of the columns, and the change from the first to the last."""
    kpis = [case.run.kpis for case in cases]
    costs = [math.nan if case.objective is None else case.objective for case in cases]
    measured: list[tuple[str, str, str, list[float]]] = []
    if not any(math.isnan(cost) for cost in costs):
        measured.append(("objective", "J", "", costs))
    for name in EFFECT:
        title, unit = kpi_title(name)
        measured.append((name, title, unit, [float(getattr(one, name)) for one in kpis]))
        if name == "pv_sd" and spread(cases[0], kpis[0])[0] != "PV standard deviation":
            about = [spread(case, one)[1] for case, one in zip(cases, kpis, strict=True)]
            measured.append(("error_sd", "Standard deviation of SP − PV", "EU", about))
    rows: list[Row] = []
    for name, title, unit, values in measured:
        if all(math.isnan(value) for value in values):
            continue
        doubts = [""] * len(cases)
        if name == "settling_time":
            unit = settling_band(cases[-1], study.experiment)
            doubts = [settling_doubt(case, study.experiment) for case in cases]
        cells = [Cell(shown(name, value), doubt) for value, doubt in zip(values, doubts, strict=True)]
        if len(cases) > 1:
            known = not any(doubts) and all(math.isfinite(value) for value in values)
            known = known and not (name == "settling_time" and 0.0 in values)
            cells.append(Cell(change(values[-1], values[0]) if known else "–"))
        rows.append(Row(title, unit, tuple(cells), group=not rows))
    return rows + _later(cases)


def _later(cases: list[CaseResult]) -> list[Row]:
    """Return error and wear once the cycle has set in, over the starts, where every column has one."""
    cycles = [case.limit_cycle for case in cases if case.limit_cycle is not None]
    if len(cycles) < len(cases) or any(cycle.outcome != "cycles" for cycle in cycles):
        return []
    rows: list[Row] = []
    for name, title, unit in (
        ("mean_square_error", "Mean square error of the late cycle", "EU²"),
        ("travel_per_hour", "Valve travel of the late cycle, an hour", "%"),
    ):
        cells = [Cell(late_words(cycle, name)) for cycle in cycles]
        if len(cases) > 1:
            now, was = (float(getattr(cycles[place], name)) for place in (-1, 0))
            same = all(" to " not in cell.text for cell in cells)
            cells.append(Cell(change(now, was) if same else "depends on the start"))
        rows.append(Row(title, unit, tuple(cells), group=not rows))
    return rows


def rounding_sentences(case: CaseResult) -> list[str]:
    """Return what the site's form and digits have made of a case, where they round it, and that the page tells that."""
    was, kpis = case.unrounded, case.run.kpis
    if was is None:
        return []
    pairs = [("mean square error", kpis.mean_square_error, was.kpis.mean_square_error, " EU²")]
    pairs.append(("valve travel", kpis.valve_travel, was.kpis.valve_travel, " %"))
    if case.objective is not None:
        pairs.insert(0, ("J", case.objective, was.objective, ""))
    return [rounded(case.name, controller_words(was.controller, case.digits), pairs)]


def refused_sentences(study: Study, chosen: CaseResult) -> list[str]:
    """Name the cases that would do better than the chosen one and that the site's form has no equivalent of."""
    out = []
    for case in study.cases:
        typed = typed_case(study, case)
        if study.site is None or typed is None or not refused(study, case):
            continue
        if case is not chosen and not measure(case) < measure(chosen):
            continue
        form, own = study.site.form, controller_words(case.loop.controller, case.digits)
        text = f"{case.name} ({own}) cannot be typed in: the site's {form} form has no equivalent ({typed.refused})."
        near = next((one for one in study.cases if one.nearest_to == case.name), None)
        if near is not None:
            by = "J" if case.objective is not None else "mean square error"
            text += (
                f" What comes nearest is {settings_words(study, near)} ({near.name}), with {by} "
                f"{figure(measure(near))} instead of {figure(measure(case))}."
            )
        out.append(f"{text} A tuning with form: {form} searches among what can be typed in.")
    return out


def rounded(name: str, own: str, pairs: Sequence[tuple[str, float, float, str]]) -> str:
    """Say how figures with the site's rounded digits differ from a case's: (title, as typed in, before, unit) each."""
    off = [p for p in pairs if not math.isclose(p[1], p[2], rel_tol=SAME, abs_tol=1e-12)]
    begin = f"{name} is {own} in the scenario's form; rounded in the site's units it gives by exact simulation"
    if not off:
        return f"{begin} the same {join([p[0] for p in pairs])} (to 0.1 %)."
    told = join([f"{what} {figure(a)}{unit} instead of {figure(b)}{unit}" for what, a, b, unit in off])
    return f"{begin} {told}. This page tells of it as rounded."


def site_table(study: Study) -> Table | None:
    """Return every case as typed in at the site, cases down; None where the scenario does not say how."""
    if study.site is None:
        return None
    rows = []
    for case, typed in zip(study.cases, study.site_cases, strict=True):
        if typed.settings is None:
            cells = tuple(Cell("no equivalent") for _ in range(3))
        else:
            cells = tuple(Cell(text) for text in setting_texts(study.site, typed.settings, case.digits))
        rows.append(Row(case.name, "", cells))
    return Table(setting_names(study.site), tuple(rows))


def site_content(study: Study) -> dict[str, object]:
    """Return what results.json holds of the site's form and the cases in it."""
    if study.site is None:
        return {}
    return {**form_content(study.site), "cases": [case_content(one) for one in study.site_cases]}


def case_content(one: SiteCase) -> dict[str, object]:
    """Return what results.json holds of a case as typed in at the site."""
    content: dict[str, object] = {"name": one.name, "refused": one.refused or None}
    if one.settings is not None and one.kpis is not None:
        content |= typed_content(one.settings, one.kpis) | {"objective": one.objective}
        content |= {"beside": beside_content(one.beside)} if one.beside is not None else {}
    return content


def beside_content(beside: Beside) -> dict[str, object]:
    """Return what results.json holds of settings beside those typed in: of a cascade the error is the primary's."""
    stem = beside.kpis if beside.secondary is None else beside.secondary
    worst = {"mean_square_error": beside.kpis.mean_square_error, "valve_travel": stem.valve_travel}
    own = {"margin": beside.margin, "digits": beside.digits, "worst": beside.worst, "last_digit": beside.step}
    return own | {"worst_run": worst}


def form_content(site: SiteForm) -> dict[str, object]:
    """Return what results.json holds of a site's form."""
    units = dict(zip(("gain", "integral", "derivative"), site.units, strict=True))
    return {"form": site.form, "proportional_band": site.gain == "PB %", "units": units}


def typed_content(typed: SiteSettings, kpis: Kpis) -> dict[str, object]:
    """Return what results.json holds of settings as typed in, and of what they give."""
    pid = typed.controller
    return {
        **{name: getattr(typed, name) for name in ("gain", "integral", "derivative")},
        **{name: getattr(pid, name) for name in ("Kc", "Ti", "Td")},
        **{name: getattr(kpis, name) for name in ("mean_square_error", "error_variance", "valve_travel")},
    }
