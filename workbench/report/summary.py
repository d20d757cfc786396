"""The report's summary: sentences composed from the results by rules, never claiming more than the figures say."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.model.study import Study
from workbench.report.advice import case_advice
from workbench.report.cascade import cascade_sentences
from workbench.report.cycles import cycle_sentences
from workbench.report.estimates import estimate_advice, estimate_sentences
from workbench.report.judge import on_bounds
from workbench.report.over_ensemble import robust_advice
from workbench.report.reference import reference_sentences
from workbench.report.words import join

__all__ = ["Summary", "summarise"]


@dataclass(frozen=True, slots=True)
class Summary:
    """What was found and what to do, sentence by sentence."""

    found: tuple[str, ...]
    do: tuple[str, ...]


def summarise(study: Study) -> Summary:
    """Return a study's summary in words."""
    found: list[str] = []
    do: list[str] = []
    for i, named in enumerate(study.estimates):
        found += estimate_sentences(named, linear=i == 0)
        do += estimate_advice(named)
    if study.cases:
        found += cycle_sentences(study) + reference_sentences(study) + _bound_sentences(study)
        do += robust_advice(study) or case_advice(study)
    if study.cascade:
        seen, advice = cascade_sentences(study)
        found += seen
        do += advice
    return Summary(tuple(found), tuple(dict.fromkeys(do)))


def _bound_sentences(study: Study) -> list[str]:
    """Name the searches that ended on a bound."""
    return [
        f"{c.name}: the search ended with {join(on_bounds(c.tuned))}; a better tuning may lie beyond."
        for c in study.cases
        if c.tuned is not None and on_bounds(c.tuned)
    ]
