"""Robust tunings, shared ensembles, travel budgets and the trade-off, from the file to the study."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import pytest

import workbench as wb
from workbench.errors import ScenarioError
from workbench.model.study import Study
from workbench.report.results import results_content, strict
from workbench.scenario import runner
from workbench.scenario.loader import read_scenario
from workbench.scenario.plan import EnsembleJob, RobustJob, Scenario
from workbench.scenario.retune import Wishes, tune_scenario
from workbench.scenario.robust_entries import EnsembleEntry
from workbench.scenario.runner import run_scenario

BASE = """\
title: Robust
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2.0}
  controller: {derivative_on: pv}
  sample_time: 1 s
experiment: {duration: 200 s, setpoint: {step: 4}}
ensemble: {duration: 200 s, draws: 6, noise: [0.01, 0.05]}
cases:
  - {name: Case 1, Kc: 0.5, Ti: 20 s}
"""
ROBUST = "  - {name: Robust, tune: {robust: true, Td: 0 s, restarts: 1, digits: 2}}\n"
CALM = (
    "  - {name: Calm, tune: {robust: {draws: 4}, travel_budget: {case: Case 1}, Td: 0 s, restarts: 1, digits: 2,"
    " constraints: {max_sensitivity: 1.8}}}\n"
)
ANALYSES = "analyze: {describing_function: false, limit_cycle: false, tradeoff: true, repair: true}\n"


def read(text: str) -> Scenario:
    return read_scenario(text, Path("loop.yaml"))


def refusal(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        read(text)
    return str(caught.value)


def robust_of(plan: Scenario, index: int) -> RobustJob:
    tune = plan.cases[index].tune
    assert tune is not None
    assert tune.robust is not None
    return tune.robust


def ensemble_of(job: EnsembleJob | None, plan: Scenario) -> wb.Ensemble:
    assert job is not None
    assert plan.loop is not None
    return job.of(plan.loop)


def test_true_takes_the_shared_ensemble_and_what_is_left_out_is_the_default() -> None:
    plan = read(BASE + ROBUST + CALM)
    assert plan.loop is not None
    ready = wb.Ensemble.plant_ready(plan.loop)
    shared = replace(ready, duration=200.0, load_time=(40.0, 100.0), draws=6, noise=(0.01, 0.05))
    assert ensemble_of(plan.ensemble, plan) == shared
    first, second = robust_of(plan, 1), robust_of(plan, 2)
    assert ensemble_of(first.ensemble, plan) == shared
    assert (first.travel_budget, first.as_case) == (None, "")
    assert ensemble_of(second.ensemble, plan) == replace(shared, draws=4)
    assert plan.cases[1].tune is not None
    assert plan.cases[1].tune.constraints is None
    assert plan.cases[2].tune is not None
    assert plan.cases[2].tune.constraints == wb.Constraints(max_sensitivity=1.8)
    assert second.as_case == "Case 1"
    assert plan.cases[0].tune is None


def test_without_a_shared_one_the_first_robust_tuning_says_what_cases_are_measured_in() -> None:
    alone = BASE.replace("ensemble: {duration: 200 s, draws: 6, noise: [0.01, 0.05]}\n", "")
    plan = read(alone + CALM)
    assert plan.loop is not None
    assert ensemble_of(plan.ensemble, plan) == replace(wb.Ensemble.plant_ready(plan.loop), draws=4)
    assert read(alone).ensemble is None
    assert ensemble_of(read(alone + ANALYSES).ensemble, plan) == wb.Ensemble.plant_ready(plan.loop)
    off = read(alone + "  - {name: Nominal, tune: {robust: false, Td: 0 s}}\n")
    assert off.cases[1].tune is not None
    assert off.cases[1].tune.robust is None


def test_every_field_of_the_ensemble_has_its_key() -> None:
    assert set(EnsembleEntry.model_fields) == {field.name for field in fields(wb.Ensemble)}
    text = (
        "{duration: 5 min, setpoint: [1, 8], load: [0.5 %, 2], load_time: [1 min, 100 s], stem_offset: 0.5, "
        "noise: [0.02, 0.1], gain: 0.1, time_constant: 0.2, dead_time: 0.3, stiction: 0.4, draws: 7, seed: 3, "
        "statistic: cvar, level: 0.8}"
    )
    plan = read(BASE + ROBUST.replace("true", text))
    expected = wb.Ensemble(300.0, (1, 8), (0.5, 2), (60, 100), 0.5, (0.02, 0.1), 0.1, 0.2, 0.3, 0.4, 7, 3, "cvar", 0.8)
    assert ensemble_of(robust_of(plan, 1).ensemble, plan) == expected


@pytest.mark.parametrize(
    ("case", "where", "words"),
    [
        (ROBUST.replace("true", "yes"), "11:35: cases[1].tune.robust", "must be true, false, or a mapping"),
        (ROBUST.replace("true", "{drws: 3}"), "11:36: cases[1].tune.robust.drws", "(did you mean draws?)"),
        (ROBUST.replace("true", "{duration: 10.5 s}"), "cases[1].tune.robust.duration", "whole number of samples"),
        (ROBUST.replace("true", "{setpoint: [3, 1]}"), "cases[1].tune.robust.setpoint", "low <= high"),
        (ROBUST.replace("true", "{gain: 20}"), "11:42: cases[1].tune.robust.gain", "must be <= 0.9"),
        (ROBUST.replace("true", "{level: 1}"), "cases[1].tune.robust.level", "1 given"),
        (CALM.replace("1.8", "0.9"), "11:140: cases[1].tune.constraints.max_sensitivity", "must be above 1"),
        (CALM.replace("case: Case 1", "case: Calm"), "cases[1].tune.travel_budget.case", "above this one (Case 1)"),
        (CALM.replace("{case: Case 1}", "0"), "cases[1].tune.travel_budget", "must be above 0"),
        (CALM.replace("{case: Case 1}", "fast"), "cases[1].tune.travel_budget", 'such as 2 or "2 %"'),
        (CALM.replace("{case: Case 1}", "{cas: Case 1}"), "cases[1].tune.travel_budget.cas", "did you mean case?"),
        (CALM.replace("max_sensitivity: 1.8", "valve_travel: 20"), "cases[1].tune.travel_budget", "one of the two"),
        (CALM.replace("robust: {draws: 4}, ", ""), "cases[1].tune.travel_budget", "given without robust"),
        (CALM.replace("digits: 2", "nominal: true"), "cases[1].tune.nominal", "an ensemble has no nominal run"),
        (CALM.replace("robust: {draws: 4}", "robust: false"), "cases[1].tune.travel_budget", "given without robust"),
    ],
)
def test_refusals_say_where_and_what(case: str, where: str, words: str) -> None:
    text = refusal(BASE + case)
    assert where in text
    assert words in text


def test_refusals_of_the_shared_ensemble_and_the_trade_off() -> None:
    late = refusal(BASE.replace("draws: 6", "load_time: [10 s, 300 s]"))
    assert "8:" in late
    assert "ensemble.load_time: (10.0, 300.0) given; must lie within the duration of 200 s" in late
    nothing = BASE.split("cases:")[0] + "estimate: {simulate: true}\nanalyze: {tradeoff: true}\n"
    assert "analyze.tradeoff: true given without cases" in refusal(nothing)


@pytest.fixture(scope="module")
def study() -> Study:
    with pytest.MonkeyPatch.context() as patch:
        # The repair's value without an ensemble is other tests' matter: one search each.
        patch.setattr(runner, "value_of_repair", partial(runner.value_of_repair, restarts=1, digits=2))
        return run_scenario(read(BASE + ROBUST + CALM + ANALYSES))


@pytest.mark.slow
def test_every_case_is_measured_on_the_same_fresh_draws(study: Study) -> None:
    found = [case.robustness for case in study.cases]
    assert all(one is not None for one in found)
    assert len({one.ensemble for one in found if one is not None}) == 1
    for case in study.cases:
        assert case.robustness is not None
        assert case.robustness_repaired is not None
        again = wb.assess(case.loop, case.robustness.ensemble)
        assert again.mse_mean == pytest.approx(case.robustness.mse_mean, rel=1e-12)
        repaired = wb.assess(replace(case.loop, valve=wb.Ideal()), case.robustness.ensemble)
        assert repaired.travel_mean == pytest.approx(case.robustness_repaired.travel_mean, rel=1e-12)


@pytest.mark.slow
def test_a_budget_is_the_named_cases_own_travel(study: Study) -> None:
    first, robust, calm = study.cases
    assert calm.tuned is not None
    assert calm.tuned.ensemble is not None
    assert calm.tuned.constraints is not None
    own = wb.assess(first.loop, calm.tuned.ensemble).travel_mean
    assert calm.tuned.constraints == wb.Constraints(max_sensitivity=1.8, valve_travel=own)
    reached = wb.assess(calm.loop, calm.tuned.ensemble)
    assert reached.travel_mean <= own
    assert robust.tuned is not None
    assert robust.tuned.constraints == wb.Constraints(max_sensitivity=2.0)


@pytest.mark.slow
def test_the_front_and_the_value_of_repair_stand_in_the_results(study: Study) -> None:
    front, repair = study.front, study.robust_repair
    assert front is not None
    assert front.constraints == wb.Constraints(max_sensitivity=2.0)
    assert front.bounds == wb.Bounds(Td=(0.0, 0.0))
    assert front.digits == 2
    assert repair is not None
    assert repair.tuned is study.cases[1].tuned
    assert repair.present.loop.controller == study.cases[0].loop.controller
    assert 0.0 < repair.share < 1.0
    content = json.loads(json.dumps(strict(results_content(study)), allow_nan=False))
    assert len(content["tradeoff"]["sticky"]) == len(front.sticky)
    assert content["tradeoff"]["repaired"][0]["Kc"] == front.repaired[0].controller.Kc
    assert content["robust_repair"]["share_that_only_repair_removes"] == pytest.approx(repair.share)
    assert content["cases"][0]["robustness"]["mse_mean"] == pytest.approx(repair.present.mse_mean)
    assert content["tuning"][1]["constraints"]["valve_travel"] > 0.0
    assert "wall_time" not in json.dumps(content)


def test_a_scenario_without_an_ensemble_has_nothing_of_it() -> None:
    plain = read(BASE.replace("ensemble: {duration: 200 s, draws: 6, noise: [0.01, 0.05]}\n", ""))
    content = results_content(run_scenario(plain))
    assert "robustness" not in content["cases"][0]
    assert "tradeoff" not in content


def test_the_tune_command_makes_robust_tunings_too() -> None:
    found = tune_scenario(read(BASE + CALM), Wishes(Ti=(5.0, 100.0)))
    assert [one.name for one in found] == ["Calm"]
    tuned = found[0].tuned
    assert tuned.ensemble is not None
    assert tuned.bounds.Ti == (5.0, 100.0)
    assert tuned.constraints is not None
    assert tuned.constraints.valve_travel is not None
