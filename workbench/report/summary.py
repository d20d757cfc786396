"""The report's first screen: sentences composed from the results by rules, never claiming more than the figures say."""

from __future__ import annotations

from dataclasses import dataclass, replace

from workbench.model.study import CascadeResult, CaseResult, Study
from workbench.report.advice import Advice, case_advice, stays_off
from workbench.report.cascade import cascade_sentences
from workbench.report.cascade_advice import cascade_advice, cascade_confidence, cascade_watch
from workbench.report.cascade_settings import cascade_base, cascade_rounding, cascade_table
from workbench.report.confidence import Confidence, confidence, watch
from workbench.report.cycles import cycle_sentences
from workbench.report.estimates import estimate_advice, estimate_sentences
from workbench.report.judge import base_case, best_case, on_bounds, source_of
from workbench.report.known import gain_doubt, hint
from workbench.report.over_ensemble import robust_advice, robust_choice
from workbench.report.plain_truth import lasting
from workbench.report.reference import reference_sentences
from workbench.report.settings import as_found_as_left, refused_sentences, rounding_sentences
from workbench.report.standing import held_by_stiction
from workbench.report.tables import Table
from workbench.report.words import capital, join

__all__ = ["Summary", "summarise"]

ORDER = "Set "  # how a decision for a change begins


@dataclass(frozen=True, slots=True)
class Summary:
    """What was found and what to do, sentence by sentence.

    decision: the one thing to do first, "" where there is nothing to decide. settings: as found and as left, None
    where no case is recommended; typed: what the site's form and digits make of them. sure: how sure the recommendation
    is. watch: what to watch after the change. do: what else to do; left: what the decision leaves, and what repair is
    worth.
    """

    found: tuple[str, ...]
    decision: str
    do: tuple[str, ...]
    left: tuple[str, ...]
    settings: Table | None = None
    typed: tuple[str, ...] = ()
    sure: Confidence | None = None
    watch: tuple[str, ...] = ()

    @property
    def advice(self) -> tuple[str, ...]:
        """Every sentence on what to do, the decision first."""
        return tuple(text for text in (self.decision, *self.do, *self.left) if text)


def summarise(study: Study) -> Summary:
    """Return a study's summary in words."""
    found: list[str] = [f"Look at the scenario again: {text}" for text in study.mistakes]
    do: list[str] = []
    advice = Advice("")
    for i, named in enumerate(study.estimates):
        found += estimate_sentences(named, linear=i == 0)
        do += estimate_advice(named)
    if study.cases:
        found += cycle_sentences(study) + reference_sentences(study) + _bound_sentences(study)
        robust = robust_advice(study)
        choice = robust_choice(study)
        if refusal := _refusal(study):
            advice = Advice(refusal)
        elif choice is None:
            advice = case_advice(study)
        else:
            order = " ".join(text for text in (robust[0], stays_off(study, choice)) if text)
            advice = Advice(order, choice, tuple(robust[1:]), tuple(lasting(study, choice)))
        if not refusal and (doubt := _hint(study, advice)):
            advice = replace(advice, decision=_hinted(study, advice, doubt))
    if study.cascade:
        found += cascade_sentences(study)
        advice = cascade_advice(study)
    decision, rest = advice.decision, dict.fromkeys((*advice.do, *do))
    if not decision and rest:
        decision = next(iter(rest))
        del rest[decision]
    told = tuple(found), decision, tuple(rest), advice.left
    case = advice.case
    if case is None:
        return Summary(*told)
    if isinstance(case, CascadeResult):
        first = cascade_base(study)
        return Summary(
            *told,
            settings=cascade_table(study, first or case, case),
            typed=tuple(cascade_rounding(case)),
            sure=cascade_confidence(study, case),
            watch=tuple(cascade_watch(study, first, case)),
        )
    base = base_case(study)
    return Summary(
        *told,
        settings=as_found_as_left(study, base, case),
        typed=(*rounding_sentences(case), *refused_sentences(study, case)),
        sure=confidence(study, case),
        watch=tuple(watch(study, base, case)),
    )


def _refusal(study: Study) -> str:
    """Return why none of the tunings is advised, where they rest on a record that does not show the plant's gain."""
    for named in (source_of(study, case) for case in study.cases):
        if named is not None and (doubt := gain_doubt(named.found)):
            return (
                f"Set none of these tunings: the record of {named.name} {doubt}. Take one in which OP clearly moves PV."
            )
    return ""


def _hint(study: Study, advice: Advice) -> str:
    """Return why the decision is no more than a hint, where it rests on an estimate that leaves the loop in doubt."""
    case = advice.case or best_case(study)
    named = source_of(study, case) if isinstance(case, CaseResult) else None
    if named is None or not isinstance(case, CaseResult):
        return ""
    # A decision for what only stiction holds says so itself.
    standing = None if held_by_stiction(case.standing) else case.standing
    return hint(named.found, "these tunings" if advice.case is None else "this tuning", standing)


def _hinted(study: Study, advice: Advice, doubt: str) -> str:
    """Return a decision with its doubt; where not even stiction is sure, the doubt first, so that none is an order."""
    named = source_of(study, advice.case) if isinstance(advice.case, CaseResult) else None
    if named is None or named.found.verdict != "undecided" or not advice.decision.startswith(ORDER):
        return f"{advice.decision} {capital(doubt)}."
    best = advice.decision.removeprefix(ORDER)
    return f"Set nothing yet: {doubt}. The best for the loop as it was estimated is {best}"


def _bound_sentences(study: Study) -> list[str]:
    """Name the searches that ended on a bound."""
    return [
        f"{c.name}: the search ended with {join(on_bounds(c.tuned))}; a better tuning may lie beyond."
        for c in study.cases
        if c.tuned is not None and on_bounds(c.tuned)
    ]
