"""What is said of cycles that have set in, or that the run cannot show: never more than every start shows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from workbench.analyze.standing import standing
from workbench.model.ensemble import Constraints
from workbench.model.experiment import Experiment, Ramp, Series, Step
from workbench.model.numbers import given
from workbench.model.results import LimitCycle
from workbench.model.study import CaseResult, Study
from workbench.report.cycles import by_start, cycle_tables, late_figures
from workbench.report.judge import last_change
from workbench.report.plain_truth import lasting
from workbench.report.summary import summarise
from workbench.simulate.run import simulate

Make = Callable[..., Any]


def with_errors(case: CaseResult, *errors: float) -> CaseResult:
    cycle = case.limit_cycle
    assert isinstance(cycle, LimitCycle)
    starts = tuple(replace(s, mean_square_error=e) for s, e in zip(cycle.starts, errors, strict=True))
    return replace(case, limit_cycle=replace(cycle, mean_square_error=errors[0], starts=starts))


def of(study: Study, *cases: CaseResult, **extra: Any) -> Study:
    return replace(study, cases=cases, estimates=(), **extra)


def test_what_is_left_of_the_cycle_is_a_range_where_it_depends_on_the_start(study: Study) -> None:
    base, best = study.cases[0], with_errors(study.cases[2], 0.12, 0.4)
    told = " ".join(summarise(of(study, base, best)).advice)
    assert (
        "Once it has set in, the mean square error is 0.120 to 0.400 EU² at 142 % an hour, with Case 1 0.810 EU² at "
        "142 % an hour (where a range stands, it depends on the start)."
    ) in told


def test_a_case_that_comes_to_rest_is_named_where_the_recommended_one_cycles_on(study: Study, cycle: Make) -> None:
    calm = replace(study.cases[0], limit_cycle=cycle(study.cases[0].loop, "settles"))
    told = summarise(of(study, calm, study.cases[2]))
    by_run = "the recommendation goes by the run of this experiment."
    assert f"In the long run without disturbances Case 1 comes to rest after this experiment; {by_run}" in told.left
    assert not any("comes to rest after" in text for text in summarise(of(study, calm, calm)).left)


def test_single_figures_are_not_called_ranges(study: Study) -> None:
    bare = [replace(c, objective=None, tuned=None) for c in study.cases[:2]]
    told = " ".join(summarise(of(study, *bare, objective=None)).advice)
    assert "once the cycle has set in: Case 1 0.810 EU² at 142 % an hour; Case 2 0.810 EU² at 142 % an hour." in told
    assert "range" not in told
    told = " ".join(summarise(of(study, with_errors(bare[0], 0.03, 0.9), bare[1], objective=None)).advice)
    assert "Case 1 0.0300 to 0.900 EU² at 142 % an hour (where a range stands, it depends on the start)." in told


def test_late_figures_say_when_the_start_decides(study: Study) -> None:
    wide = with_errors(study.cases[0], 0.03, 0.9).limit_cycle
    same = study.cases[1].limit_cycle
    assert wide is not None
    assert same is not None
    assert late_figures(wide).startswith("0.0300 to 0.900 EU²")
    assert by_start(same, wide)
    assert by_start(same) == ""


def test_a_cycle_is_sought_in_what_follows_the_last_change(study: Study) -> None:
    def moved(at: float) -> str:
        experiment = Experiment(duration=1000.0, setpoint=Step(4.0, at=at))
        case = replace(study.cases[0], run=simulate(study.cases[0].loop, experiment))
        return " ".join(summarise(of(study, case, experiment=experiment)).found)

    # The cycle takes 800 s to show: of a run of 1000 s, 900 s are enough, 700 s are not.
    assert "too short" not in moved(100.0)
    assert (
        "The run of 17 min, with its last change at 300 s, is too short to show the cycle of Case 1: its figures in "
        "the table do not contain it."
    ) in moved(300.0)


def test_a_run_too_short_for_the_cycle_does_not_show_otherwise(study: Study) -> None:
    load = Experiment(duration=1000.0, load=Step(0.01, at=1.0))

    def found(window: float) -> str:
        cycle = replace(study.cases[0].limit_cycle, period=100.0, travel_per_hour=142.0, window=window)
        case = replace(study.cases[0], run=simulate(study.cases[0].loop, load), limit_cycle=cycle)
        return " ".join(summarise(of(study, case, experiment=load)).found)

    shown = found(800.0)
    assert "Case 1: the run itself shows otherwise, late in it the valve travels 0 % an hour, not 142 %." in shown
    assert "too short" not in shown
    hidden = found(5000.0)
    assert "is too short to show the cycle of Case 1" in hidden
    assert "shows otherwise" not in hidden


def test_a_loop_that_grows_is_not_called_undecided(study: Study, cycle: Make) -> None:
    made = cycle(study.cases[0].loop, "undecided")

    def row(reason: str) -> str:
        starts = tuple(replace(start, reason=reason) for start in made.starts)
        case = replace(study.cases[0], limit_cycle=replace(made, starts=starts))
        return next(r for r in cycle_tables(of(study, case))[0].rows if r.label == "Exact simulation").cells[0].text

    assert row("the loop is unstable: PV grows without bound") == "unstable: PV grows"
    assert row("PV grows without bound, although the loop is stable with an ideal valve") == "unstable: PV grows"
    assert row("fewer than 8 reversals") == "undecided"


def test_the_last_change_is_one_of_setpoint_or_load_within_the_run(case: Make) -> None:
    loop = case("Any", 0.5, 20.0).loop

    def at(**signals: Any) -> float:
        return last_change(simulate(loop, Experiment(duration=100.0, **signals)))

    assert at(setpoint=Step(4.0)) == 0.0
    assert at(setpoint=Step(4.0), load=Step(1.0, at=60.0)) == 60.0
    assert at(setpoint=Ramp(4.0, 10.0, 30.0)) == 30.0
    assert at(load=Series([0.0, 1.0, 1.0])) == 1.0


def test_an_unstable_case_is_no_choice_for_less_wear(study: Study, case: Make) -> None:
    best = study.cases[2]
    wild = case("Wild", 50.0, 5.0)
    for travel in (0.1, math.nan):
        calm = replace(wild, run=replace(wild.run, kpis=replace(wild.run.kpis, valve_travel=travel)))
        told = " ".join(summarise(of(study, calm, best)).advice)
        assert "Where wear counts" not in told
        told = " ".join(summarise(of(study, calm, study.cases[1], best)).advice)
        assert "Where wear counts more than error: Case 2" in told


def test_why_a_cycle_stays_undecided_is_said(study: Study, cycle: Make) -> None:
    def told(*reasons: str) -> tuple[str, ...]:
        cases = []
        for one, reason in zip(study.cases, reasons, strict=False):
            open_ = cycle(one.loop, "undecided")
            open_ = replace(open_, starts=tuple(replace(s, reason=reason) for s in open_.starts))
            cases.append(replace(one, limit_cycle=open_, describing_function=None))
        return summarise(of(study, *cases)).found

    chatter, few = "the stem chatters", "fewer than 8 reversals"
    assert "Case 1: whether the loop cycles could not be decided by simulation (the stem chatters)." in told(chatter)
    assert [t for t in told(chatter, few, chatter) if "decided" in t] == [
        "Case 1 and Optimised PI: whether the loop cycles could not be decided by simulation (the stem chatters).",
        "Case 2: whether the loop cycles could not be decided by simulation (fewer than 8 reversals).",
    ]


def test_a_calm_choice_is_told_with_its_cycle_too(study: Study) -> None:
    told = " ".join(summarise(of(study, with_errors(study.cases[1], 0.03, 0.9), study.cases[2])).advice)
    assert (
        "Where wear counts more than error: Case 2 (Kc 0.5 %/EU, Ti 200 s) has in this run valve travel 4.013 %" in told
    )
    assert "EU²; once its cycle has set in, 0.0300 to 0.900 EU² at 142 % an hour (where a range stands" in told


def test_constraints_of_another_case_that_the_advised_one_breaks_are_named(study: Study) -> None:
    _, found, best = study.cases
    assert best.tuned is not None
    asked = replace(best.tuned, constraints=Constraints(max_sensitivity=1.0001, valve_travel=5.0))
    told = " ".join(summarise(of(study, study.cases[0], replace(found, tuned=asked), replace(best, tuned=None))).advice)
    travel = best.run.kpis.valve_travel
    kept = "Optimised PI does not keep what Case 2 was asked to: it has"
    assert f"{kept} a valve travel of {given(travel, 3)} % (at most 5 %). Where" in told
    assert "Where that must hold: Case 2 (Kc 0.5" in told
    loose = replace(asked, constraints=Constraints(valve_travel=1000.0))
    told = " ".join(summarise(of(study, study.cases[0], replace(found, tuned=loose), replace(best, tuned=None))).advice)
    assert "was asked to" not in told
    stands = replace(best, tuned=None, standing=standing(best.loop))
    told = " ".join(summarise(of(study, study.cases[0], replace(found, tuned=asked), stands)).advice)
    assert stands.standing is not None
    Ms = given(stands.standing.own.max_sensitivity, 3)
    assert f"{kept} a maximum sensitivity of {Ms} (at most 1.0001) and a valve travel of " in told


def test_hardly_more_error_for_far_less_wear_is_named(study: Study) -> None:
    def told(error: float) -> str:
        cases = []
        for one, mse, travel in zip(study.cases, (1.0, error, 3.0), (70.0, 12.0, 4.0), strict=True):
            kpis = replace(one.run.kpis, mean_square_error=mse, valve_travel=travel)
            cases.append(replace(one, run=replace(one.run, kpis=kpis), objective=None, tuned=None))
        return summarise(of(study, *cases, objective=None)).advice[0]

    assert told(1.03).endswith(" Case 2 has 3.0 % more error than the least, at valve travel 12.00 %.")
    assert "more error than the least" not in told(1.3)


def test_the_table_of_cycles_shows_what_depends_on_the_start(study: Study) -> None:
    told = of(study, with_errors(study.cases[0], 0.03, 0.9), study.cases[1])
    rows = {r.label: [c.text for c in r.cells] for r in cycle_tables(told)[0].rows}
    assert rows["Mean square error, all starts"] == ["0.0300 to 0.900", "0.810"]
    assert "Valve travel an hour, all starts" not in rows, "all starts give the same"
    assert rows["Late period, all starts"][0].replace("\u00a0", " ") == "102 s to 123 s"
    alike = replace(told.cases[0].limit_cycle, period_range=(102.1, 102.2))
    told = of(study, replace(told.cases[0], limit_cycle=alike))
    rows = {r.label: [c.text for c in r.cells] for r in cycle_tables(told)[0].rows}
    assert rows["Late period"] == ["102 s"]
    assert "Late period, all starts" not in rows


def test_text_and_table_give_one_cycle_the_same_figures(study: Study) -> None:
    wide = with_errors(study.cases[0], 0.03, 0.9)
    assert wide.limit_cycle is not None
    late = replace(wide.limit_cycle.starts[1], travel_per_hour=900.0, window=4000.0)
    cycle = replace(wide.limit_cycle, starts=(wide.limit_cycle.starts[0], late))
    told = of(study, replace(wide, limit_cycle=cycle), study.cases[1])
    rows = {r.label: r.cells[0].text.replace("\u00a0", " ") for r in cycle_tables(told)[0].rows}
    assert rows["Valve travel an hour, all starts"] == "142 to 900"
    assert rows["Time after the last change to see it, all starts"] == "13 min to 67 min"
    repair = next(text for text in lasting(told, told.cases[0]) if text.startswith("When to repair"))
    assert rows["Late period, all starts"] == "102 s to 123 s"
    assert "2.01 EU every 102 s to 123 s" in repair
    assert "142 to 900 % of valve travel an hour" in repair or "142 to 900 % an hour" in repair
