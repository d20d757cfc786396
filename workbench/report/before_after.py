"""Before and after a tuning, as the paper's Tables III and IV lay it out: figures down, with their change."""

from __future__ import annotations

import math

from workbench.model.study import CaseResult, Study
from workbench.model.titles import kpi_title
from workbench.report.judge import base_case, settling_doubt
from workbench.report.tables import Cell, Row, Table, printed, shown
from workbench.report.words import change, decimals_of

__all__ = ["before_after_table"]

ROWS = ("pv_sd", "controller_travel", "valve_travel", "settling_time", "oscillation_index")
ASKED = frozenset({"pv_sd", "settling_time", "oscillation_index"})  # published figures that ask for this layout
MOST = 3  # tunings beside the one as found: what an A4 page holds


def before_after_table(study: Study) -> Table | None:
    """Return figures as found and after each tuning, each with its change, and the published ones in small print.

    None unless published figures of this kind stand beside a given case and another one. A published change is worked
    out from the published figures.
    """
    base = base_case(study)
    after = [c for c in study.cases if c is not base and (c.reference or c.tuned is not None)][:MOST]
    if base is None or not any(ASKED & case.reference.keys() for case in after) or not ASKED & base.reference.keys():
        return None
    heads = [base.name]
    for case in after:
        heads += [case.name, "change"]
    rows = []
    for name in ROWS:
        title, unit = kpi_title(name)
        decimals = decimals_of([c.reference[name] for c in (base, *after) if name in c.reference])
        cells = [_value(study, base, name, decimals)]
        for case in after:
            cells += [_value(study, case, name, decimals), _change(study, base, case, name)]
        rows.append(Row(title, unit, tuple(cells)))
    return Table(tuple(heads), tuple(rows))


def _value(study: Study, case: CaseResult, name: str, decimals: int) -> Cell:
    value = float(getattr(case.run.kpis, name))
    small = [settling_doubt(case, study.experiment)] if name == "settling_time" else []
    small += [f"publ. {printed(name, case.reference[name], decimals)}"] if name in case.reference else []
    return Cell(shown(name, value), "; ".join(text for text in small if text))


def _change(study: Study, base: CaseResult, case: CaseResult, name: str) -> Cell:
    was, now = (float(getattr(one.run.kpis, name)) for one in (base, case))
    doubted = name == "settling_time" and (
        0.0 in (was, now) or any(settling_doubt(one, study.experiment) for one in (base, case))
    )
    both = name in base.reference and name in case.reference
    small = f"publ. {change(case.reference[name], base.reference[name])}" if both else ""
    return Cell(change(now, was) if math.isfinite(was) and math.isfinite(now) and not doubted else "–", small)
