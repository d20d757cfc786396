"""The least J itself, a cliff: it is there to compare with, never ordered, and told with every digit that it needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from workbench.model.controller import PID
from workbench.model.numbers import setting
from workbench.model.study import CaseResult, Study
from workbench.report.summary import summarise
from workbench.report.words import controller_words, parameter

Make = Callable[..., Any]
KC, TI = 2.44719005808, 8.32616150835


def of(study: Study, *cases: CaseResult, **extra: Any) -> Study:
    return replace(study, cases=cases, estimates=(), **extra)


@pytest.fixture(scope="module")
def cliff(case: Make, tuned: Make) -> CaseResult:
    made = case("Cliff", KC, TI)
    found = replace(tuned(made.loop.controller, made.objective, worst=7.0), nominal_only=True, digits=12)
    return replace(made, tuned=found, limit_cycle=None)


def test_the_least_j_itself_is_not_ordered_but_what_is_meant_to_be_typed_in(study: Study, cliff: CaseResult) -> None:
    base, best = study.cases[0], study.cases[2]
    assert cliff.objective < best.objective
    summary = summarise(of(study, base, best, cliff))
    assert summary.decision.startswith("Set Kc 2.351 %/EU, Ti 9.500 s (Optimised PI)")
    (told,) = (text for text in summary.do if "Cliff" in text)
    assert told.startswith(
        f"Do not type in Cliff (Kc {KC} %/EU, Ti {TI} s): it is the least J itself, 10.32, and within"
    )
    assert "J rises to as much as 72.2" in told
    calm = replace(cliff, run=replace(cliff.run, kpis=replace(cliff.run.kpis, valve_travel=0.1)), objective=11.0)
    assert "Cliff" not in " ".join(summarise(of(study, base, best, calm)).advice), "nor where it wears the valve less"


def test_beside_the_least_j_alone_the_tuning_as_found_is_kept(study: Study, cliff: CaseResult) -> None:
    summary = summarise(of(study, study.cases[0], cliff))
    assert summary.decision.startswith(
        "Keep Case 1 (Kc 0.5 %/EU, Ti 20 s): none of the other tunings that can be typed in"
    )
    (told,) = (text for text in summary.do if text.startswith("Do not type in Cliff"))
    assert told.endswith(". A search without “nominal: true” finds settings to type in.")
    alone = summarise(of(study, cliff))
    assert alone.decision == "Set none of these tunings: none is meant to be typed in."
    assert alone.settings is None
    assert any(text.startswith("Do not type in Cliff") for text in alone.do)
    bare = summarise(of(study, *(replace(c, objective=None) for c in (study.cases[0], study.cases[1], cliff))))
    assert "Cliff" not in bare.decision, "nor is it a choice without an objective"


def test_as_many_digits_are_told_as_the_figures_need() -> None:
    assert setting(KC, 12) == str(KC)
    assert setting(KC) == "2.44719", "a number without digits of its own"
    assert controller_words(PID(KC, TI), 12) == f"Kc {KC} %/EU, Ti {TI} s"
    assert controller_words(PID(0.5, 3.0, form="parallel"), 12).endswith("1/Ti 0.333333333333 %/(EU s)")
    assert parameter(KC, 12, converted=True) == "2.44719", "what a site's digits make of it"


def test_what_a_knife_edge_loses_beside_its_digits_is_no_gain_to_count_on(
    study: Study, case: Make, tuned: Make
) -> None:
    J = study.cases[0].objective
    made = replace(case("Sharp", 0.5, 20.01), objective=0.7 * J)

    def decision(worst: float) -> str:
        sharp = replace(made, tuned=tuned(made.loop.controller, 0.7 * J, worst=worst / 0.7))
        return summarise(of(study, study.cases[0], sharp)).decision

    assert decision(0.97).startswith("Keep Case 1 (Kc 0.5 %/EU, Ti 20 s): nothing here is worth a change.")
    assert decision(0.8).startswith("Set Kc 0.5000 %/EU, Ti 20.01 s (Sharp)")
