"""The rules that compose the summary."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from workbench.model.estimation import LoadSwing
from workbench.model.results import FittedModel, Intervals, SolveStatus
from workbench.model.study import CaseResult, NamedEstimate, Study
from workbench.model.valve import Ideal
from workbench.report.estimates import estimate_advice, estimate_sentences
from workbench.report.judge import best_case, df_disagrees
from workbench.report.known import known_sentences
from workbench.report.summary import summarise

Make = Callable[..., Any]


def with_cases(study: Study, *cases: CaseResult) -> Study:
    return replace(study, cases=cases, estimates=())


def test_the_best_case_is_recommended_with_its_changes(study: Study) -> None:
    told = " ".join(summarise(study).advice)
    best = study.cases[2]
    assert best_case(study) is best
    assert (
        "Set Kc 2.351 %/EU, Ti 9.500 s (Optimised PI): in this run J 10.46 instead of 226.6, PV standard deviation "
        "−72 %, mean square error −92 %, valve travel +38 % against Case 1." in told
    )
    assert "the cycle remains: PV swings 2.01 EU every 12.0 s" in told
    assert "steps of at least 2 %, each of which moves PV by 2 EU in the end" in told


def test_an_unsuccessful_search_is_never_recommended(study: Study, tuned: Make) -> None:
    best = study.cases[2]
    failed = replace(best, tuned=tuned(best.loop.controller, best.objective, SolveStatus.ITERATION_LIMIT))
    changed = with_cases(study, study.cases[0], failed)
    told = summarise(changed).advice
    assert best_case(changed) is study.cases[0]
    assert told[0].startswith("Keep Case 1")
    assert told[1].startswith("Do not use Optimised PI as it stands: its search ended as “iteration limit”")


def test_a_knife_edge_is_named(study: Study, tuned: Make) -> None:
    best = study.cases[2]
    sharp = replace(best, tuned=tuned(best.loop.controller, best.objective, worst=2.0))
    told = " ".join(summarise(with_cases(study, study.cases[0], sharp)).advice)
    near = "knife-edge, within the larger of ±0.1 % and half the last digit of each setting J rises from 10.46"
    assert f"{near} to as much as 20.92." in told
    assert not any("knife-edge" in t for t in summarise(study).advice)


def test_a_run_too_short_for_the_cycle_is_said(study: Study) -> None:
    told = " ".join(summarise(study).found)
    assert "too short to show the cycle of Case 2: its figures" in told


def test_disagreement_is_told_and_agreement_is_not(study: Study) -> None:
    told = " ".join(summarise(study).found)
    assert "Case 1: the describing function predicts no cycle, but the loop cycles." in told
    assert "Both say" not in told
    assert [df_disagrees(c) for c in study.cases] == [True, False, False]


@pytest.mark.parametrize(
    ("outcome", "text"),
    [
        ("settles", "Case 1: the loop comes to rest."),
        ("depends", "Case 1: the loop cycles or comes to rest depending on where it starts."),
        ("undecided", "Case 1: whether the loop cycles could not be decided by simulation."),
    ],
)
def test_other_outcomes(study: Study, cycle: Make, outcome: str, text: str) -> None:
    case = replace(study.cases[0], limit_cycle=cycle(study.cases[0].loop, outcome), describing_function=None)
    summary = summarise(with_cases(study, case))
    assert text in summary.found
    assert any("What no tuning removes" in t for t in summary.advice) == (outcome != "settles")


def test_no_objective_no_recommendation(study: Study) -> None:
    cases = [replace(c, objective=None, tuned=None) for c in study.cases[:2]]
    told = summarise(replace(with_cases(study, *cases), objective=None)).advice
    assert told[0].startswith(
        "No objective was given, so there is a choice to make. Least mean square error in this run: Case 1"
    )
    assert "Least wear: Case 2" in told[0]
    assert not any(t.startswith("Set ") for t in told)


def test_published_figures_to_the_digit(study: Study) -> None:
    told = summarise(study).found
    begin = "Of the published figures, valve travel of Case 1 and Case 2 comes out to the digit; the other 2 differ"
    assert any(t.startswith(begin) for t in told)


def test_an_unstable_case_is_said_and_not_compared(study: Study, case: Make) -> None:
    wild = case("Wild", 50.0, 5.0)
    changed = with_cases(study, wild, study.cases[2])
    summary = summarise(changed)
    assert "Wild: the loop is unstable, PV grows without bound." in summary.found
    assert any(t.startswith("Set Kc 2.351") and "against Wild" not in t for t in summary.advice)


def test_estimates(estimated: Make) -> None:
    found, truth = estimated()
    told = estimate_sentences(NamedEstimate("E", found, truth))
    assert told[0].startswith(
        "E: the valve sticks, d = 2.003 % (95 % range 1.990 to 2.010 %); the process has gain 1.990 EU/%"
    )
    assert told[0].endswith("Every parameter lies within 0.60 % of the true one.")
    assert "leaves 119 times the residual variance" in told[1]
    assert estimate_advice(NamedEstimate("E", found, truth)) == []
    assert "have the valve looked at" in estimate_advice(NamedEstimate("E", found))[0]


def test_a_wrong_estimate_of_a_known_loop_is_called_wrong(estimated: Make) -> None:
    found, truth = estimated()
    blind = replace(found, valve=Ideal(), verdict="no_stiction", intervals=Intervals())
    assert "This is wrong" in estimate_sentences(NamedEstimate("E", blind, truth))[0]
    far = replace(found, plant=replace(found.plant, gain=3.0))
    assert "This is wrong by 50 % in the gain (true value 2)." in estimate_sentences(NamedEstimate("E", far, truth))[0]


def test_a_model_that_explains_less_than_none_is_of_no_use(estimated: Make) -> None:
    found, truth = estimated()
    poor = replace(found, residual_variance=1.01 * found.linear.residual_variance)
    (text,) = estimate_sentences(NamedEstimate("E", poor, truth))
    assert text.startswith("E: the record shows stiction, but the model that the method ends with (d = 2.003 % ")
    assert "leaves more of PV unexplained than one without stiction, and is of no use." in text
    assert known_sentences(poor) == [
        "The model leaves more of PV unexplained than one without stiction: use none of its figures."
    ]
    assert "moves PV" not in estimate_advice(NamedEstimate("E", poor))[0]
    # A load that nobody recorded is in the simulation of both, and no fault of the stem: it foretells PV better.
    models = tuple(
        FittedModel(valve, found.plant, 1.0, bic, bic, 20) for valve, bic in ((found.valve, -300.0), (Ideal(), -200.0))
    )
    assert not any(
        "of no use" in text for text in estimate_sentences(NamedEstimate("E", replace(poor, candidates=models)))
    )
    worse = tuple(replace(model, bic=-model.bic) for model in models)
    assert "of no use" in estimate_sentences(NamedEstimate("E", replace(poor, candidates=worse)))[0]


def test_an_oscillation_beside_a_gain_that_is_not_known_may_be_the_loops_own(estimated: Make) -> None:
    found, _ = estimated()
    found = replace(found, verdict="no_stiction", load_swing=LoadSwing(42.0, 2.3, 4.8))
    known, unknown = (
        NamedEstimate("E", replace(found, intervals=replace(found.intervals, gain=gain)))
        for gain in ((1.97, 2.01), (0.0, math.inf))
    )
    assert "look outside the loop for what oscillates" in estimate_advice(known)[-1]
    assert "a load that nobody recorded" in " ".join(estimate_sentences(known))
    assert "the loop's own tuning, or what drives it from outside" in estimate_advice(unknown)[-1]
    assert "a load that nobody recorded" not in " ".join(estimate_sentences(unknown))


def test_what_is_not_identified_is_said(estimated: Make) -> None:
    found, _ = estimated(identifiable=False)

    def said(d: tuple[float, float], gain: tuple[float, float]) -> str:
        ranges = replace(found.intervals, d=d, gain=gain)
        return estimate_sentences(NamedEstimate("E", replace(found, intervals=ranges)))[1]

    assert "pins only the product of gain and stiction (3.986 EU)" in said((1.0, 3.0), (1.3, 4.0))
    # A band that is known better than the gain is no matter of their product, nor is one known worse.
    assert "pins the stiction only roughly (1.90 to 2.20 %) and the gain hardly (0.800 to 5.00 EU/%)" in said(
        (1.9, 2.2), (0.8, 5.0)
    )
    assert "pins the stiction hardly (1.50 to 3.00 %) and the gain closely" in said((1.5, 3.0), (1.95, 2.0))
    assert "for this model alone" in said((1.99, 2.01), (1.97, 2.01))
    # A record that has setpoint changes in it is not asked for one.
    assert said((1.0, 3.0), (1.3, 4.0)).endswith("; a record with a setpoint change in it would tell more.")
    sp = np.where(np.arange(len(found.record)) < 200, 0.0, 6.0)
    found = replace(found, record=replace(found.record, sp=sp))
    more = "; a record with more or larger setpoint changes in it would tell more."
    assert said((1.0, 3.0), (1.3, 4.0)).endswith(more)
    assert said((1.9, 2.2), (0.8, 5.0)).endswith(more)
    bare = replace(found, intervals=Intervals())
    assert "gives no range" in estimate_sentences(NamedEstimate("E", bare))[1]


def test_an_undecided_estimate_of_a_known_loop_is_not_called_wrong(estimated: Make) -> None:
    found, truth = estimated(verdict="undecided")
    blind = estimate_sentences(NamedEstimate("E", replace(found, valve=Ideal()), truth))[0]
    assert blind.endswith("The record was simulated with Stenman's one-parameter stiction, d = 2 %.")
    off = estimate_sentences(NamedEstimate("E", replace(found, plant=replace(found.plant, gain=3.0)), truth))[0]
    assert off.endswith("The model is off by 50 % in the gain (true value 2).")
    assert "wrong" not in blind + off


def test_undecided_claims_nothing(estimated: Make) -> None:
    found, _ = estimated(verdict="undecided")
    told = estimate_sentences(NamedEstimate("E", found))
    assert told[0].startswith("E: whether the valve sticks stays undecided")
    assert "take it as a hint, not as a finding" in told[0]
    assert "longer record" in estimate_advice(NamedEstimate("E", found))[0]
