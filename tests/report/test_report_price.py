"""A search before a rule that is hardly better, and an order that depends on the valve travel that it costs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from workbench.analyze.standing import standing
from workbench.model.controller import PID
from workbench.model.experiment import Experiment, Noise, Step
from workbench.model.rule import Simc
from workbench.model.site import SiteForm
from workbench.model.study import CaseResult, Study
from workbench.report.judge import best_case
from workbench.report.summary import summarise
from workbench.scenario.site_cases import site_cases
from workbench.simulate.run import simulate

Make = Callable[..., Any]


def of(study: Study, *cases: CaseResult) -> Study:
    return replace(study, cases=cases, estimates=())


def at(case: CaseResult, objective: float, travel: float, rate: float | None = None, **changes: Any) -> CaseResult:
    """The case with that J, valve travel in the run (%) and, where given, an hour of the long run."""
    run = replace(case.run, kpis=replace(case.run.kpis, valve_travel=travel))
    cycle = case.limit_cycle if rate is not None else None
    if cycle is not None and rate is not None:
        starts = tuple(replace(start, travel_per_hour=rate) for start in cycle.starts)
        cycle = replace(cycle, travel_per_hour=rate, starts=starts)
    return replace(case, objective=objective, run=run, limit_cycle=cycle, **changes)


@pytest.mark.parametrize(("rule", "leads"), [(9.5, "Optimised PI"), (8.0, "Rule"), (11.0, "Optimised PI")])
def test_a_search_goes_before_a_rule_that_is_hardly_better(study: Study, rule: float, leads: str) -> None:
    found, other, best = study.cases
    textbook = at(other, rule, 180.0, name="Rule", rule=Simc())
    cases = of(study, found, textbook, at(best, 10.0, 16.0))
    chosen = best_case(cases)
    assert chosen is not None
    assert chosen.name == leads
    summary = summarise(cases)
    assert f"({leads})" in summary.decision
    words = (
        "Rule (Kc 0.5 %/EU, Ti 200 s) has J 9.500 instead of 10.00, at valve travel 180.0 % instead of 16.00 %: a rule "
        "that was not asked for it, and hardly better."
    )
    assert (words in summary.do) is (rule == 9.5)
    # Settings that somebody gave are a proposal as good as any.
    given = best_case(of(study, found, replace(textbook, rule=None), at(best, 10.0, 16.0)))
    assert given is not None
    assert (given.name == "Rule") is (rule < 10.0)


def test_an_order_that_multiplies_the_travel_depends_on_it(study: Study) -> None:
    found, other, best = study.cases
    base = at(found, 200.0, 10.0)
    dear = at(best, 10.0, 1180.0)
    decision = summarise(of(study, base, dear)).decision
    assert decision.startswith(
        "Set Kc 2.351 %/EU, Ti 9.500 s (Optimised PI) if 118 times the valve travel of Case 1 is acceptable: in this "
        "run J 10.00 instead of 200.0, "
    )
    assert "against Case 1; otherwise keep Kc 0.5 %/EU, Ti 20 s." in decision
    # Half the wear of the best at a clear gain goes before what is there.
    middle = at(other, 40.0, 30.0, name="Middle")
    decision = summarise(of(study, base, middle, dear)).decision
    assert "against Case 1; otherwise Kc 0.5 %/EU, Ti 200 s (Middle), J 40.00 at 3.0 times." in decision
    for useless in (at(middle, 195.0, 30.0), at(middle, 40.0, 600.0), at(middle, 40.0, 0.0)):
        assert "; otherwise keep Kc 0.5" in summarise(of(study, base, useless, dear)).decision
    assert "acceptable" not in summarise(of(study, base, at(best, 10.0, 19.0))).decision
    assert "acceptable" not in summarise(of(study, at(found, 200.0, 0.0), dear)).decision, "nothing to compare with"


def test_the_long_run_counts_where_it_moves_the_valve_more(study: Study) -> None:
    found, other, best = study.cases
    base = at(found, 200.0, 10.0, 100.0)
    decision = summarise(
        of(study, base, at(other, 30.0, 10.0, 210.0, name="Mild"), at(best, 10.0, 17.0, 950.0))
    ).decision
    assert "(Optimised PI) if 9.5 times the valve travel of Case 1 in the long run is acceptable: " in decision
    assert "(Mild), J 30.00 at 2.1 times in the long run." in decision
    assert "if 1" not in summarise(of(study, base, at(best, 10.0, 17.0, 190.0))).decision
    settled = replace(best.limit_cycle, outcome="settles")
    quiet = replace(at(best, 10.0, 17.0), limit_cycle=settled)
    assert "acceptable" not in summarise(of(study, base, quiet)).decision


def test_what_only_stiction_holds_is_not_kept_otherwise(study: Study) -> None:
    found, _, best = study.cases
    trap = at(found, 200.0, 10.0)
    trap = replace(trap, standing=standing(trap.loop.with_controller(PID(5.0, 5.0)), None))
    decision = summarise(of(study, trap, at(best, 10.0, 1180.0))).decision
    assert "if 118 times the valve travel of Case 1 is acceptable" in decision
    assert "otherwise" not in decision


def at_rest(case: CaseResult, error: float) -> CaseResult:
    """The case with a loop that comes to rest with that error (EU)."""
    cycle = case.limit_cycle
    assert cycle is not None
    nothing = {"mean_square_error": math.nan, "travel_per_hour": math.nan}
    start = replace(cycle.starts[0], outcome="settles", rest_error=error, **nothing)
    return replace(case, limit_cycle=replace(cycle, outcome="settles", starts=(start,), **nothing))


def test_a_cycle_that_goes_on_where_the_loop_rested_is_a_price(study: Study) -> None:
    found, other, best = study.cases
    base = at_rest(at(found, 200.0, 10.0, 100.0), 0.45)
    ours = at(best, 10.0, 9.0, 950.0)
    decision = summarise(of(study, base, ours)).decision
    assert decision.startswith(
        "Set Kc 2.351 %/EU, Ti 9.500 s (Optimised PI) if valve travel of 950 % an hour in the long run, where Case 1 "
        "comes to rest, is acceptable: in this run J 10.00 instead of 200.0, "
    )
    assert "; otherwise keep Kc 0.5 %/EU, Ti 20 s." in decision
    assert decision.endswith("In the long run: mean square error 4.0 times, valve travel from 0 to 950 % an hour.")
    both = summarise(of(study, base, at(best, 10.0, 53.0, 950.0))).decision
    run = (
        "if 5.3 times the valve travel of Case 1 in this run and 950 % an hour in the long run, where Case 1 comes to "
    )
    assert f"{run}rest, are acceptable: " in both
    # What rests too and does better goes before what is there; what cycles as well does not.
    calm = at_rest(at(other, 40.0, 15.0, 1.0, name="Calm"), 0.1)
    assert (
        "; otherwise Kc 0.5 %/EU, Ti 200 s (Calm), J 40.00 at 1.5 times."
        in summarise(of(study, base, calm, ours)).decision
    )
    cycling = at(other, 40.0, 15.0, 400.0, name="Cycling")
    assert "; otherwise keep" in summarise(of(study, base, cycling, ours)).decision
    # A run that keeps the valve moving shows that the noise, which the verdict leaves out, lets nothing rest.
    noisy = Experiment(duration=1000.0, setpoint=Step(4.0), noise=Noise(1.5, 1))
    moving = replace(base, run=simulate(base.loop, noisy))
    told = summarise(replace(of(study, moving, replace(ours, run=simulate(best.loop, noisy))), experiment=noisy))
    assert "comes to rest" not in told.decision


def test_a_knife_edge_counts_with_the_travel_beside_it(study: Study) -> None:
    found, _, best = study.cases
    form = SiteForm("ideal", "PB %", "repeats/min", "s", (0.0, 70.0))
    base, ours = at(found, 200.0, 10.0), at(best, 10.0, 14.0)
    typed = site_cases(form, (base, ours), study.objective)
    last = replace(typed[1], objective=10.0)
    assert last.beside is not None

    def decision(worst: float, travel: float) -> str:
        there = replace(last.beside, worst=worst, kpis=replace(last.beside.kpis, valve_travel=travel))
        cases = (typed[0], replace(last, beside=there))
        return summarise(replace(of(study, base, ours), site=form, site_cases=cases)).decision

    price = " if 3.7 times the valve travel of Case 1 (with settings beside these) is acceptable: "
    assert price in decision(20.0, 37.0)
    assert "; otherwise keep" in decision(20.0, 37.0)
    assert "acceptable" not in decision(20.0, 19.0)
    assert "acceptable" not in decision(10.1, 37.0), "no knife-edge"
