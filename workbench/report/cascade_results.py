"""A cascade's part of `results.json`, and its `cases.csv`."""

from __future__ import annotations

import csv
import math
from dataclasses import fields
from io import StringIO
from typing import Any

from workbench.model.cascade import Cascade
from workbench.model.results import Kpis, Tuned
from workbench.model.study import Study
from workbench.report.cells import cell
from workbench.report.content import controller_content, loop_content, plain, tuned_content
from workbench.report.judge import settling_doubt
from workbench.report.words import compensator_words

__all__ = ["cascade_content", "cascade_csv"]


def cascade_content(study: Study) -> dict[str, Any]:
    """Return the cascade's part of results.json."""

    def parts(cascade: Cascade) -> dict[str, Any]:
        return {name: controller_content(getattr(cascade, name).controller) for name in ("primary", "secondary")}

    def search(one: Tuned | None, name: str) -> Any:
        return None if one is None else tuned_content(name, one)

    first = study.cascade[0].run.cascade
    cases = []
    for case in study.cascade:
        cycle = case.cycle
        cases.append(
            {
                "name": case.name,
                "controllers": parts(case.run.cascade),
                "kpis": {name: plain(getattr(case.run, name).kpis) for name in ("primary", "secondary")},
                "settling_doubt": settling_doubt(case, case.run.experiment) or None,
                "objective": case.objective,
                "limit_cycle": None
                if cycle is None
                else {
                    **{name: getattr(cycle, name) for name in ("outcome", "reason", "period", "travel_per_hour")},
                    **{
                        name: None if getattr(cycle, name) is None else plain(getattr(cycle, name))
                        for name in ("primary", "secondary")
                    },
                },
                "looked_at_alone": None
                if case.detections is None
                else {
                    name: {"verdict": d.verdict, "reasons": list(d.reasons)}
                    for name, d in zip(("primary", "secondary"), case.detections, strict=True)
                },
                "tuning": None
                if case.tuned is None
                else {
                    "start_objective": case.tuned.start_objective,
                    "secondary": search(case.tuned.secondary, "secondary"),
                    "primary": search(case.tuned.primary, "primary"),
                },
                "note": case.note,
            }
        )
    return {
        "primary": loop_content(first.primary),
        "secondary": loop_content(first.secondary),
        "scale": first.scale,
        "anti_windup": first.anti_windup,
        "cases": cases,
    }


def cascade_csv(study: Study) -> str:
    """Return cases.csv's text for a cascade: two rows for each case, the primary's and the secondary's."""
    names = [f.name for f in fields(Kpis)]
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["case", "loop", "Kc", "Ti", "Td", "compensator", "objective", *names]
    writer.writerow([*head, "limit_cycle", "limit_cycle_period", "pv_peak_to_peak", "looked_at_alone"])
    for case in study.cascade:
        for place, which in enumerate(("primary", "secondary")):
            run, cycle = getattr(case.run, which), case.cycle
            pid = run.loop.controller
            row: list[object] = [case.name, which, pid.Kc, "none" if math.isinf(pid.Ti) else pid.Ti, pid.Td]
            row += [None if pid.compensator is None else compensator_words(pid.compensator), case.objective]
            row += [getattr(run.kpis, name) for name in names]
            appearance = None if cycle is None else getattr(cycle, which)
            row += [None, None] if cycle is None else [cycle.outcome, cycle.period]
            row.append(None if appearance is None else appearance.pv_peak_to_peak)
            row.append(None if case.detections is None else case.detections[place].verdict)
            writer.writerow([cell(value) for value in row])
    return out.getvalue()
