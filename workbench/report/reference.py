"""Published figures beside ours: which there are, and what the summary says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

from workbench.model.results import Kpis
from workbench.model.study import CaseResult, Study
from workbench.model.titles import kpi_title, within
from workbench.report.words import decimals_of, difference, join

__all__ = ["KPI_NAMES", "reference_names", "reference_sentences"]

KPI_NAMES = tuple(f.name for f in fields(Kpis))


def reference_names(cases: Sequence[CaseResult]) -> list[str]:
    """Return the names of the published figures that any case has, in the order of the KPIs, others after them."""
    given = {name for case in cases for name in case.reference}
    known = [name for name in (*KPI_NAMES, "objective") if name in given]
    return known + sorted(given - set(known))


def reference_sentences(study: Study) -> list[str]:
    """Return which published figures come out to the digit, and how many differ."""
    same: dict[str, list[str]] = {}
    other = rounds = 0
    for name in reference_names(study.cases):
        decimals = decimals_of([c.reference[name] for c in study.cases if name in c.reference])
        for case in study.cases:
            if name not in case.reference:
                continue
            ours = case.objective if name == "objective" else getattr(case.run.kpis, name, None)
            told = "" if ours is None else difference(ours, case.reference[name], decimals)
            if told == "to the digit":
                same.setdefault(name, []).append(case.name)
            elif told.startswith("rounds"):
                rounds += 1
            else:
                other += 1
    if not same and not other and not rounds:
        return []
    also = (
        f" {rounds} of them {'is' if rounds == 1 else 'are'} met only within the one digit printed." if rounds else ""
    )
    parts = [f"{within(kpi_title(name)[0])} of {join(cases)}" for name, cases in same.items()]
    if not parts:
        number = other + rounds
        text = f"None of the {number} published figures comes out to the digit"
        return [f"{text}; the table says by how much each differs.{also}"]
    text = f"Of the published figures, {'; '.join(parts)} {'come' if len(parts) > 1 else 'comes'} out to the digit"
    if other:
        text += f"; the other {other} differ, as the table says" if other > 1 else "; the other one differs"
    return [f"{text}.{also}"]
