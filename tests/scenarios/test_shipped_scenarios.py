"""The shipped scenarios run, and still say what their committed reports say.

Runs with given tunings repeat on every machine; what a search or a fit found is held by its quality instead. Where the
search takes long and is like those of the other scenarios, the tuning that it found is run as given. All that is asked
of a scenario is one test, as running it takes long and tests of one file may run in several processes.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import workbench as wb
from workbench.report.page import write_report
from workbench.report.results import results_json
from workbench.scenario.loader import load_scenario
from workbench.scenario.plan import Scenario

ROOT = Path(__file__).parents[2]
SHIPPED = sorted(path.stem for path in (ROOT / "scenarios").glob("*.yaml") if not path.stem.startswith("fleet_"))
LARGEST = 2 * 2**20  # bytes of one report folder
NOT_SEARCHED = ("compensators", "loop_1_feed_flow", "which_tunings_cycle")


def committed(name: str) -> Any:
    return json.loads((ROOT / "reports" / name / "results.json").read_text())


def same(ours: Any, theirs: Any, where: str, rel: float = 1e-6) -> None:
    if isinstance(theirs, dict):
        assert isinstance(ours, dict), where
        assert ours.keys() == theirs.keys(), where
        for key, value in theirs.items():
            same(ours[key], value, f"{where}.{key}", rel)
    elif isinstance(theirs, list):
        assert len(ours) == len(theirs), where
        for i, value in enumerate(theirs):
            same(ours[i], value, f"{where}[{i}]", rel)
    elif isinstance(theirs, float) and not isinstance(ours, str):
        assert math.isclose(ours, theirs, rel_tol=rel, abs_tol=1e-9), f"{where}: {ours} here, {theirs} committed"
    else:
        assert ours == theirs, where


def test_six_stories_are_shipped_each_with_its_report():
    told = {"table_2", "stick_slip", "identify_benchmark", "industrial_flow_loop", "robust_retune", "integrating_level"}
    assert set(SHIPPED) >= told
    for name in SHIPPED:
        folder = ROOT / "reports" / name
        assert {"report.html", "results.json", "cases.csv"} <= {path.name for path in folder.iterdir()}
        assert sum(path.stat().st_size for path in folder.iterdir()) <= LARGEST


def given_tunings_come_out_as_committed(name: str, study: Any) -> None:
    ours = json.loads(results_json(study))
    theirs = committed(name)
    assert [case["name"] for case in ours["cases"]] == [case["name"] for case in theirs["cases"]]
    searched = {case.name for case in study.cases if case.tuned is not None}
    estimated = bool(study.estimates) and not any(one.truth for one in study.estimates)
    found = {one["name"]: one for one in theirs["tuning"]}
    for mine, case in zip(ours["cases"], theirs["cases"], strict=True):
        if case["name"] in searched or estimated:
            continue
        if case["tuned"] and found[case["name"]]["knife_edge"]:  # a day of its run hangs on a controller's last bit
            same(mine["controller"], case["controller"], case["name"])
            assert mine["objective"] <= found[case["name"]]["worst"]
            continue
        keys = case.keys() - ({"tuned", "repaired"} if name in NOT_SEARCHED else set())
        same({key: mine[key] for key in keys}, {key: case[key] for key in keys}, case["name"])


def what_was_searched_for_is_as_good_as_committed(name: str, study: Any) -> None:
    objectives = {case["name"]: case["objective"] for case in committed(name)["cases"]}
    found = {one["name"]: one for one in committed(name)["tuning"]}
    for case in study.cases:
        if case.tuned is None:
            continue
        assert case.tuned.status is wb.SolveStatus.SOLVED
        again = wb.evaluate(case.loop, study.experiment, case.tuned.weights)[0]
        if study.objective is not None:
            assert case.objective == pytest.approx(again, rel=1e-12), "the figure shown is the exact simulation's"
        if case.tuned.ensemble is not None:
            assert case.tuned.objective <= 1.02 * found[case.name]["objective"]
            continue
        # The least worst case within the digits is searched for: a tuning that betters it may have a higher J.
        assert case.tuned.worst <= 1.02 * found[case.name]["worst"]
        better = case.tuned.worst < found[case.name]["worst"]
        if case.unrounded is not None:  # what a site's digits make of it is a draw: the search's own J is compared
            assert better or case.tuned.objective <= 1.02 * found[case.name]["objective"]
            continue
        assert better or case.objective <= 1.02 * objectives[case.name]


def estimates_come_out_as_committed(name: str, study: Any) -> None:
    theirs = committed(name)["estimates"]
    ours = json.loads(results_json(study))["estimates"]
    for mine, other in zip(ours, theirs, strict=True):
        assert mine["verdict"] == other["verdict"]
        same(mine["plant"], other["plant"], f"{other['name']}.plant", rel=1e-3)
        same(mine["valve"], other["valve"], f"{other['name']}.valve", rel=1e-3)


def table_2_says_what_the_paper_says_where_it_can(study: Any) -> None:
    cases = {case.name: case for case in study.cases}
    assert round(cases["Case 1"].run.kpis.valve_travel, 2) == 12.18
    assert round(cases["Case 2"].run.kpis.valve_travel, 2) == 4.01
    assert round(cases["Case 4"].objective, 1) == 303.6
    assert round(cases["Case 5"].objective, 1) == 320.5
    for name, target in (("Optimised PI", 10.6), ("Optimised PID", 9.8)):
        assert cases[name].objective == cases[name].tuned.objective <= target
        assert cases[name].tuned.worst <= 1.01 * target
    # Three decisions in a thousand samples: the refinement slides along them where the scan is caught.
    pid = cases["Optimised PID"].tuned
    assert pid.controller.Td == 0.0 or any(r.refined < 0.99 * r.scanned for r in pid.restarts)
    assert not cases["Case 1"].describing_function.predicts_cycle
    assert cases["Case 1"].limit_cycle.outcome == "cycles"
    assert "Kc K J/S < 1" in cases["Case 1"].agreement


def robust_tunings_are_worth_what_the_report_says(study: Any) -> None:
    front = study.front
    assert front is not None
    assert front.status is wb.SolveStatus.SOLVED
    cases = {case.name: case for case in study.cases}
    best = cases["Robust PI"].robustness
    assert best.ensemble.draws == 2000
    assert best.max_sensitivity <= 2.0
    assert best.diverged == 0
    assert best.mse_median <= 0.265
    assert best.travel_median <= 250.0
    # Cases 4 and 5 pay for their slow integral action with more than twice the error at equal travel.
    # Between two points of the front: at its steep end, where Case 2 lies, they are up to 15 % apart.
    travel = [math.log(point.valve_travel) for point in front.sticky]
    error = [math.log(point.mean_square_error) for point in front.sticky]
    for name, times in (("Case 2", 1.1), ("Case 4", 2.2), ("Case 5", 2.1)):
        r = cases[name].robustness
        assert r.mse_mean >= times * math.exp(np.interp(math.log(r.travel_mean), travel, error)), name
    # Nothing that keeps the constraints lies below the front.
    for case in study.cases:
        r = case.robustness
        point = front.at(r.travel_mean * (1.0 + 1e-9))
        if case.loop.controller.Kc > 0.0 and r.max_sensitivity <= 2.0 and point is not None:
            assert point.mean_square_error <= r.mse_mean * (1.0 + 1e-9), case.name
    assert 0.5 < study.robust_repair.share < 0.9


def the_level_is_held_better_with_less_wear_than_by_tight_rules(study: Any) -> None:
    cases = {case.name: case for case in study.cases}
    calm, found = cases["Robust PI, calmer"], cases["As found"]
    assert calm.tuned.constraints.valve_travel == 60.0
    assert calm.robustness.travel_mean <= 65.0
    assert calm.robustness.mse_mean < 0.2 * found.robustness.mse_mean


def compensators_buy_error_with_wear_or_rest_with_an_offset(study: Any) -> None:
    cases = {case.name: case for case in study.cases}
    found = cases["As found"].run.kpis
    for name in ("Knocker", "Constant reinforcement", "Dither"):
        ours = cases[name].run.kpis
        assert ours.mean_square_error < 0.5 * found.mean_square_error
        assert ours.valve_travel > 20.0 * found.valve_travel
        assert ours.reversals > 10 * found.reversals
    band = cases["Integral dead band"]
    assert band.limit_cycle.outcome == "settles"
    assert band.run.kpis.valve_travel < 0.25 * found.valve_travel
    assert abs(band.run.kpis.final_error) > 0.5
    assert cases["Two moves"].limit_cycle.outcome == "cycles", "after the load the steady output is another"
    assert cases["Retuned"].objective < 0.6 * cases["As found"].objective
    assert all(case.describing_function is None for case in cases.values() if case.loop.controller.compensator)


def the_stand_ins_behave_as_the_paper_says_of_its_loops(study: Any) -> None:
    before, after, best = study.cases
    for kpi in ("pv_sd", "controller_travel"):
        assert getattr(before.run.kpis, kpi) == pytest.approx(before.reference[kpi], rel=0.25)
        assert getattr(after.run.kpis, kpi) < 0.5 * getattr(before.run.kpis, kpi)
    assert after.run.kpis.pv_sd == pytest.approx(after.reference["pv_sd"], rel=0.25)
    assert math.isinf(before.run.kpis.settling_time)
    assert after.run.kpis.settling_time < 600.0
    assert after.run.kpis.oscillation_index < before.run.kpis.oscillation_index
    assert before.limit_cycle.outcome == "cycles"
    assert best.objective < 0.25 * before.objective
    assert {case.settings.controller.form for case in study.site_cases} == {study.site.form}


def the_cascades_cycle_is_in_both_loops_and_comes_out_as_committed(study: Any) -> None:
    ours, theirs = json.loads(results_json(study))["cascade"], committed("cascade")["cascade"]
    for mine, case in zip(ours["cases"], theirs["cases"], strict=True):
        if case["tuning"] is None:
            same(mine, case, case["name"])
        else:
            # What the site's digits make of it is a draw: the search's own J is compared.
            ours_J, theirs_J = (one["tuning"]["primary"]["objective"] for one in (mine, case))
            assert ours_J <= 1.02 * theirs_J
    cases = {case.name: case for case in study.cascade}
    found, detuned, tuned = cases["As found"], cases["Primary detuned"], cases["Tuned in turn"]
    for case in (found, detuned):
        assert [one.verdict for one in case.detections] == ["no_stiction", "stiction"]
        assert case.cycle.secondary.sp_peak_to_peak > 0.05
    assert found.cycle.primary.pv_peak_to_peak > 1.5 * detuned.cycle.primary.pv_peak_to_peak
    assert tuned.objective < 0.85 * found.objective
    assert tuned.tuned.primary.status is tuned.tuned.secondary.status is wb.SolveStatus.SOLVED


def the_benchmark_record_is_identified(study: Any) -> None:
    estimates = {one.name: one.found for one in study.estimates}
    clean, noisy = estimates["Global profile, no noise"], estimates["Global profile, noise 0.1"]
    for found, rel in ((clean, 0.01), (noisy, 0.05)):
        assert found.verdict == "stiction"
        assert found.valve.d == pytest.approx(2.0, rel=rel)
        assert found.plant.gain == pytest.approx(2.0, rel=rel)
        assert found.plant.time_constant == pytest.approx(5.0, rel=rel)
        assert found.plant.dead_time == pytest.approx(1.0, abs=0.1)


STORIES = {
    "cascade": the_cascades_cycle_is_in_both_loops_and_comes_out_as_committed,
    "compensators": compensators_buy_error_with_wear_or_rest_with_an_offset,
    "identify_benchmark": the_benchmark_record_is_identified,
    "integrating_level": the_level_is_held_better_with_less_wear_than_by_tight_rules,
    "loop_1_feed_flow": the_stand_ins_behave_as_the_paper_says_of_its_loops,
    "loop_2_reflux": the_stand_ins_behave_as_the_paper_says_of_its_loops,
    "robust_retune": robust_tunings_are_worth_what_the_report_says,
    "table_2": table_2_says_what_the_paper_says_where_it_can,
}


def test_each_story_is_of_a_shipped_scenario():
    assert set(SHIPPED) >= set(STORIES)


def with_the_tunings_found(name: str) -> Scenario:
    """The scenario with the tunings of its report in the place of its searches, and nothing else that searches."""
    plan = load_scenario(ROOT / "scenarios" / f"{name}.yaml")
    found = {case["name"]: case["controller"] for case in committed(name)["cases"] if case["tuned"]}
    assert found.keys() == {job.name for job in plan.cases if job.tune is not None}
    cases = []
    for job in plan.cases:
        if job.tune is not None:
            controller = replace(job.controller, **{key: found[job.name][key] for key in ("Kc", "Ti", "Td")})
            job = replace(job, tune=None, controller=controller)
        cases.append(job)
    return replace(plan, cases=tuple(cases), repair=False, cycle_map=None)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_scenario_still_says_what_its_report_says(name):
    searched = name not in NOT_SEARCHED
    study = wb.run_scenario(ROOT / "scenarios" / f"{name}.yaml" if searched else with_the_tunings_found(name))
    given_tunings_come_out_as_committed(name, study)
    what_was_searched_for_is_as_good_as_committed(name, study)
    if name in ("identify_benchmark", "industrial_flow_loop"):
        estimates_come_out_as_committed(name, study)
    if name in STORIES:
        STORIES[name](study)


def test_a_report_is_the_same_to_the_byte_when_run_again(tmp_path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        write_report(wb.run_scenario(ROOT / "scenarios" / "stick_slip.yaml"), folder)
    names = {path.name for path in folders[0].iterdir()} - {"run.json"}
    assert names == {path.name for path in folders[1].iterdir()} - {"run.json"}
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes(), name
