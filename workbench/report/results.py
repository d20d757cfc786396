"""`results.json`, `cases.csv` and `run.json`: a study's figures for other programs.

results.json and cases.csv hold nothing that changes from one run to the next; times, versions and machine are
run.json's. Numbers carry 12 significant digits, and 0 for what is below 1e-12, so that the last bits in which machines
differ do not show.
"""

from __future__ import annotations

import csv
import json
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from io import StringIO
from typing import Any

from workbench.model.cycle_map import OUTCOMES, CycleMap
from workbench.model.detection import Detection
from workbench.model.front import Front, FrontPoint, RobustRepair
from workbench.model.results import (
    DescribingFunction,
    FittedModel,
    LimitCycle,
    Outcome,
    Repair,
    Repeats,
)
from workbench.model.rule import Rule
from workbench.model.study import CaseResult, NamedEstimate, Study
from workbench.report.cells import DIGITS, cell
from workbench.report.content import (
    controller_content,
    loop_content,
    plain,
    plant_content,
    robustness_content,
    tuned_content,
    valve_content,
    weights_content,
)
from workbench.report.judge import settling_doubt
from workbench.report.reference import KPI_NAMES, reference_names
from workbench.report.trends import experiment_content, trends_content
from workbench.report.words import ROUNDING

__all__ = [
    "FORMAT",
    "cases_csv",
    "results_content",
    "results_json",
    "run_json",
    "strict",
    "strict_json",
]

# Of results.json: told to readers, and raised where what stood in it means something else from then on. Files of
# the first have no format, experiment or trends.
FORMAT = 2
_DISTRIBUTIONS = ("stiction-workbench", "casadi", "matplotlib", "numba", "numpy", "scipy")


def strict(value: Any) -> Any:
    """Return a value as strict JSON takes it, floats at 12 significant digits.

    What there is none of (no limit, no filter, not settled in the run) is infinite in Python and "none" here, as in a
    scenario; what is not known, nan and what has run off to minus infinity, is None.
    """
    if isinstance(value, bool) or value is None or isinstance(value, str | int):
        return value
    if isinstance(value, float):
        if math.isnan(value) or value == -math.inf:
            return None
        if math.isinf(value):
            return "none"
        if abs(value) < ROUNDING:
            return 0.0
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, Mapping):
        return {str(k): strict(v) for k, v in value.items()}
    if isinstance(value, Sequence):
        return [strict(v) for v in value]
    if hasattr(value, "item"):
        return strict(value.item())
    msg = f"{type(value).__name__} has no JSON form here"
    raise TypeError(msg)


def strict_json(content: object) -> str:
    """Return a value as the text of a strict JSON file (see `strict`)."""
    return json.dumps(strict(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _or_none(value: float) -> float | str:
    return "none" if math.isinf(value) else value


def _describing_function(df: DescribingFunction | None) -> dict[str, Any] | None:
    if df is None:
        return None
    names = ("predicts_cycle", "amplitude", "period", "pv_amplitude", "distance", "distance_amplitude")
    return {
        **{name: getattr(df, name) for name in names},
        "distance_frequency": df.distance_frequency,
        "linear_stable": df.linear_stable,
        "crossings": [plain(c) for c in df.crossings],
        "verdict": df.verdict,
    }


def _limit_cycle(cycle: LimitCycle | None) -> dict[str, Any] | None:
    if cycle is None:
        return None
    content = {f.name: getattr(cycle, f.name) for f in fields(cycle) if f.name not in ("loop", "starts", "closed_form")}
    form = None if cycle.closed_form is None else plain(cycle.closed_form)
    starts = [{name: v for name, v in plain(start).items() if name != "waveform"} for start in cycle.starts]
    return {**content, "closed_form": form, "starts": starts}


def _front(front: Front) -> dict[str, Any]:
    def points(some: Sequence[FrontPoint]) -> list[dict[str, float]]:
        return [
            {
                "valve_travel": p.valve_travel,
                "mean_square_error": p.mean_square_error,
                **{name: getattr(p.controller, name) for name in ("Kc", "Ti", "Td")},
            }
            for p in some
        ]

    return {
        "status": front.status.name.lower(),
        "message": front.message,
        "ensemble": plain(front.ensemble),
        "constraints": plain(front.constraints),
        "bounds": plain(front.bounds),
        "digits": front.digits,
        "seed": front.seed,
        "measured_on": {"draws": front.fresh.draws, "seed": front.fresh.seed},
        "evaluations": front.evaluations,
        "sticky": points(front.sticky),
        "repaired": points(front.repaired),
    }


def _map(found: CycleMap) -> dict[str, Any]:
    """Return a map by rows; each row of a figure is one text, its cells at four digits ("-" for none)."""

    def rows(values: Any) -> list[str]:
        return [" ".join("-" if math.isnan(v) else f"{v:.4g}" for v in row) for row in values.tolist()]

    fields_of = ("period", "pv_peak_to_peak", "mean_square_error", "travel_per_hour", "window")
    return {
        "axis": found.axis,
        "controller": controller_content(found.loop.controller),
        "starts": found.starts,
        "Kc": found.Kc.tolist(),
        found.axis: found.values.tolist(),
        "outcome": [" ".join(OUTCOMES[k] for k in row) for row in found.outcome.tolist()],
        "linear_stable": ["".join("1" if v else "0" for v in row) for row in found.linear_stable.tolist()],
        "describing_function_factor": rows(found.crossing),
        **{name: rows(getattr(found, name)) for name in fields_of},
    }


def _robust_repair(repair: RobustRepair) -> dict[str, Any]:
    names = ("present", "repaired", "best", "best_repaired")
    return {
        **{
            name: {"controller": controller_content(one.loop.controller), **robustness_content(one)}
            for name in names
            for one in (getattr(repair, name),)
        },
        "share_that_only_repair_removes": repair.share,
        "tuning_repaired": tuned_content("repaired", repair.tuned_repaired),
    }


def _rule(rule: Rule | None) -> dict[str, Any] | None:
    return None if rule is None else {"name": rule.name, **plain(rule), "source": rule.source}


def _outcome(outcome: Outcome) -> dict[str, Any]:
    return {
        "controller": controller_content(outcome.controller),
        "objective": outcome.objective,
        "kpis": plain(outcome.kpis),
    }


def _repair(repair: Repair | None) -> dict[str, Any] | None:
    if repair is None:
        return None
    return {
        "weights": weights_content(repair.weights),
        **{name: _outcome(getattr(repair, name)) for name in ("present", "repaired", "best", "best_repaired")},
        "share_that_only_repair_removes": {
            name: repair.share(name) for name in ("objective", "error_variance", "mean_square_error")
        },
        "tuning": tuned_content("sticky", repair.tuned),
        "tuning_repaired": tuned_content("repaired", repair.tuned_repaired),
    }


def _case(case: CaseResult) -> dict[str, Any]:
    return {
        "name": case.name,
        "controller": controller_content(case.loop.controller),
        "kpis": plain(case.run.kpis),
        "settling_doubt": settling_doubt(case, case.run.experiment) or None,
        "objective": case.objective,
        "describing_function": _describing_function(case.describing_function),
        "limit_cycle": _limit_cycle(case.limit_cycle),
        "agreement": case.agreement,
        "tuned": case.tuned is not None,
        "rule": _rule(case.rule),
        "repaired": None if case.repaired is None else _outcome(case.repaired),
        **{
            name: robustness_content(found)
            for name, found in (("robustness", case.robustness), ("robustness_repaired", case.robustness_repaired))
            if found is not None
        },
        "reference": dict(case.reference),
        "note": case.note,
    }


def aic(value: float, residual_variance: float) -> float:
    """Return an AIC, or nan where the residuals are rounding error and their logarithm means nothing."""
    return value if residual_variance >= ROUNDING else math.nan


def _detection(found: Detection) -> dict[str, Any]:
    return {
        "verdict": found.verdict,
        "reasons": list(found.reasons),
        "statistics": [{n: getattr(s, n) for n in ("name", "value", "unit", "says")} for s in found.statistics],
        **({"pv_late": found.pv_late} if found.pv_late else {}),
    }


def _candidate(model: FittedModel) -> dict[str, Any]:
    criteria = {name: aic(getattr(model, name), model.residual_variance) for name in ("aic", "bic")}
    return {**plain(model), "plant": plant_content(model.plant), "valve": valve_content(model.valve), **criteria}


def _repeats(found: Repeats) -> dict[str, Any]:
    return {**plain(found), "parts": [plain(part) for part in found.parts]}


def _open(pair: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return a range as it is written: where an end is open there is no limit, whichever end it is."""
    return None if pair is None else (math.inf if math.isinf(pair[0]) else pair[0], pair[1])


def _estimate(named: NamedEstimate) -> dict[str, Any]:
    found, program = named.found, named.found.complementarity
    ended = {} if program is None else {"status": program.status.value, "plant": plant_content(program.plant)}
    return {
        "name": named.name,
        "method": found.method,
        "verdict": found.verdict,
        "reasons": list(found.reasons),
        "plant": plant_content(found.plant),
        "valve": valve_content(found.valve),
        "intervals": {name: _open(pair) for name, pair in plain(found.intervals).items()},
        "identifiable": found.identifiable,
        "bias": found.bias,
        "residual_variance": found.residual_variance,
        "aic": aic(found.aic, found.residual_variance),
        "noise_sd": found.noise_sd,
        "slips": found.slips,
        "noise_model": None if found.noise_model is None else plain(found.noise_model),
        **({} if program is None else {"complementarity": plain(program) | ended}),
        "repeats": None if found.repeats is None else _repeats(found.repeats),
        "load_steps": [plain(step) for step in found.load_steps],
        **({} if found.load_swing is None else {"load_swing": plain(found.load_swing)}),
        **({"pv_late": found.pv_late} if found.pv_late else {}),
        **({"op_late": found.op_late} if found.op_late else {}),
        "linear": {
            "plant": plant_content(found.linear.plant),
            "bias": found.linear.bias,
            "residual_variance": found.linear.residual_variance,
            "aic": aic(found.linear.aic, found.linear.residual_variance),
        },
        "iterations": [
            {**plain(i), "plant": plant_content(i.plant), "aic": aic(i.aic, i.residual_variance)}
            for i in found.iterations
        ],
        "record": {
            "samples": len(found.record),
            "sample_time": found.record.sample_time,
            "notes": list(found.record.notes),
            "counts": dict(found.record.counts),
        },
        "candidates": [_candidate(c) for c in found.candidates],
        **({} if named.detection is None else {"detection": _detection(named.detection)}),
        "truth": None if named.truth is None else loop_content(named.truth),
        "reference": dict(named.reference),
        "note": named.note,
    }


def results_content(study: Study) -> dict[str, Any]:
    """Return what results.json holds, in plain Python values (see `strict`)."""
    noise = None if study.experiment is None else study.experiment.noise
    estimates = [_estimate(e) for e in study.estimates]
    tuning = [tuned_content(c.name, c.tuned) for c in study.cases if c.tuned is not None]
    return {
        "format": FORMAT,
        "name": study.name,
        "title": study.title,
        "loop": loop_content(study.cases[0].loop) if study.cases else None,
        "experiment": experiment_content(study),
        "objective": None if study.objective is None else plain(study.objective),
        "seeds": {
            "noise": None if noise is None else noise.seed,
            "tuning": {t["name"]: t["seed"] for t in tuning},
        },
        "cases": [_case(c) for c in study.cases],
        "estimate": estimates[0] if estimates else None,
        "estimates": estimates,
        "tuning": tuning,
        "repair": _repair(study.repair),
        **({} if study.front is None else {"tradeoff": _front(study.front)}),
        **({} if study.cycle_map is None else {"map": _map(study.cycle_map)}),
        **({} if study.robust_repair is None else {"robust_repair": _robust_repair(study.robust_repair)}),
        **_further(study),
        "reference_source": study.reference_source,
        "notes": [*study.mistakes, *study.notes],
        "trends": trends_content(study),
    }


def _further(study: Study) -> dict[str, Any]:
    # These build on this module.
    from workbench.report.cascade_results import cascade_content
    from workbench.report.cascade_settings import cascade_site_content
    from workbench.report.settings import site_content

    site = cascade_site_content(study) if study.cascade else site_content(study)
    content = {"site": site} if site else {}
    return {"cascade": cascade_content(study), **content} if study.cascade else content


def results_json(study: Study) -> str:
    """Return results.json's text: strict JSON, keys in a fixed order."""
    return strict_json(results_content(study))


def run_json(study: Study) -> str:
    """Return run.json's text: when, where, with which versions and in what time the study was made."""
    versions = {}
    for name in _DISTRIBUTIONS:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    solver: dict[str, str] = {}
    for _, tuned in study.tunings:
        solver.update(tuned.versions)
    return strict_json(
        {
            "name": study.name,
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "times": dict(study.times),
            "tuning_times": {name: tuned.wall_time for name, tuned in study.tunings},
            "versions": {"python": platform.python_version(), **versions},
            "solver": solver,
            "machine": {"platform": platform.platform(), "processor": platform.machine(), "cpus": os.cpu_count()},
        }
    )


def cases_csv(study: Study) -> str:
    """Return cases.csv's text: one row for each case."""
    references = reference_names(study.cases)
    head = ["case", "form", "derivative_on", "derivative_filter", "Kc", "Ti", "Td", "objective", *KPI_NAMES]
    compensated = any(case.loop.controller.compensator is not None for case in study.cases)
    head += ["compensator"] if compensated else []
    head += ["limit_cycle", "limit_cycle_period", "limit_cycle_pv_peak_to_peak"]
    head += ["describing_function_predicts_cycle", "describing_function_period", "tuning_status"]
    head += [f"reference_{name}" for name in references]
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([cell(h) for h in head])
    for case in study.cases:
        c, cycle, df = case.loop.controller, case.limit_cycle, case.describing_function
        row: list[object] = [case.name, c.form, c.derivative_on, _or_none(c.derivative_filter), c.Kc, _or_none(c.Ti)]
        row += [c.Td, case.objective, *(getattr(case.run.kpis, name) for name in KPI_NAMES)]
        row += [None if c.compensator is None else type(c.compensator).__name__] if compensated else []
        row += [None] * 3 if cycle is None else [cycle.outcome, cycle.period, cycle.pv_peak_to_peak]
        row += [None] * 2 if df is None else [df.predicts_cycle, df.period]
        row.append(None if case.tuned is None else case.tuned.status.name.lower())
        row += [case.reference.get(name) for name in references]
        writer.writerow([cell(value) for value in row])
    return out.getvalue()
