"""The first screen: what to set, in the site's own form, how sure that is, and what to watch then."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from workbench.analyze.standing import standing
from workbench.model.controller import PID
from workbench.model.ensemble import Ensemble
from workbench.model.experiment import Experiment, Noise, Step
from workbench.model.numbers import figure
from workbench.model.results import Intervals, Kpis, Outcome, Repair, Restart, Robustness, Tuned
from workbench.model.site import SiteForm
from workbench.model.study import CaseResult, NamedEstimate, Study
from workbench.model.tuning import Objective
from workbench.model.valve import Ideal
from workbench.report.how import how_tables
from workbench.report.known import hint
from workbench.report.page import write_report
from workbench.report.results import results_json
from workbench.report.settings import as_found_as_left, site_table
from workbench.report.summary import summarise
from workbench.scenario.site_cases import nearest_controllers, site_cases, typed_controller
from workbench.simulate.run import evaluate, simulate

Make = Callable[..., Any]
SITE = SiteForm("series", "PB %", "repeats/min", "min", (0.0, 70.0))


def as_typed_in(site: SiteForm, case: CaseResult) -> CaseResult:
    """The case as a run makes it: of what the site types in."""
    digits = None if case.tuned is None else case.tuned.digits
    loop = case.loop.with_controller(typed_controller(site, case.loop.controller, digits))
    if loop == case.loop:
        return case
    was = Outcome(case.loop.controller, case.objective or math.nan, case.run.kpis)
    cost = None if case.objective is None else float(evaluate(loop, case.run.experiment, Objective())[0])
    return replace(case, loop=loop, run=simulate(loop, case.run.experiment), objective=cost, unrounded=was)


def of(study: Study, *cases: CaseResult, site: SiteForm | None = None, **more: Any) -> Study:
    if site is not None:
        cases = (cases[0], *(as_typed_in(site, case) for case in cases[1:]))
    typed = () if site is None else site_cases(site, cases, study.objective)
    return replace(study, cases=cases, estimates=(), site=site, site_cases=typed, **more)


def late(case: CaseResult) -> CaseResult:
    """The case with a cycle that a run of 1000 s does not show."""
    assert case.limit_cycle is not None
    return replace(case, limit_cycle=replace(case.limit_cycle, window=5000.0))


def tried(case: CaseResult, diverged: int = 0) -> CaseResult:
    k = case.run.kpis
    ensemble = replace(Ensemble.plant_ready(case.loop), draws=2)
    errors, travels = ([getattr(k, name)] * 2 for name in ("mean_square_error", "valve_travel"))
    found = Robustness(
        case.loop, ensemble, 1.0, np.array(errors), np.array(travels), diverged, stable=True, max_sensitivity=1.7,
        gain_margin=3.0, phase_margin=50.0,
    )  # fmt: skip
    return replace(case, robustness=found)


def sure(study: Study, *cases: CaseResult) -> tuple[str, str]:
    said = summarise(of(study, *cases)).sure
    assert said is not None
    return said.level, " ".join(said.reasons)


def test_a_run_that_hides_the_cycle_makes_confidence_low(study: Study) -> None:
    level, reasons = sure(study, study.cases[0], late(study.cases[2]))
    assert level == "low"
    assert "this run is too short to show it" in reasons
    level, reasons = sure(study, *study.cases)
    assert level == "moderate"
    assert "this run is too short to show it" not in reasons
    assert "Search: 2 of 3 independent searches end within 0.1 % of the best J, the worst" in reasons
    assert "Digits: the settings have 4; within the larger of ±0.1 %" in reasons
    assert "nothing here holds plant and valve against the plant's records" in reasons


def test_high_asks_for_searches_that_agree_and_plants_that_differ(study: Study) -> None:
    best = study.cases[2]
    assert best.tuned is not None
    same = replace(best.tuned, restarts=tuple(Restart(k, 11.0, 10.5, 1, 1, 1) for k in range(3)))
    agreed = replace(best, tuned=same)
    assert sure(study, study.cases[0], agreed)[0] == "moderate", "not tried elsewhere"
    assert sure(study, study.cases[0], tried(agreed))[0] == "high"
    said = summarise(of(study, study.cases[0], tried(agreed))).sure
    assert said is not None
    assert said.why.startswith("Provided that the loop is as the scenario gives it")
    apart = replace(best.tuned, restarts=tuple(Restart(k, 11.0, 10.5 + k, 1, 1, 1) for k in range(3)))
    level, reasons = sure(study, study.cases[0], tried(replace(best, tuned=apart)))
    assert level == "moderate", "the searches do not agree"
    assert "the worst 19 % above it" in reasons
    close = replace(best.tuned, restarts=tuple(Restart(k, 11.0, 10.5 + 0.04 * k, 1, 1, 1) for k in range(3)))
    assert sure(study, study.cases[0], tried(replace(best, tuned=close)))[0] == "high", "none is 1 % worse"
    level, reasons = sure(study, study.cases[0], tried(agreed, diverged=1))
    assert level == "low"
    assert "Of 2 draws of other plants and circumstances 1 diverge" in reasons
    unseen = replace(tried(agreed), limit_cycle=None)
    assert sure(study, study.cases[0], unseen)[0] == "moderate"


def test_a_run_at_odds_with_the_long_run_is_no_high_confidence(study: Study) -> None:
    noisy = Experiment(duration=1000.0, setpoint=Step(4.0), noise=Noise(0.3, 1))
    one = study.cases[2]
    assert one.tuned is not None
    same = replace(one.tuned, restarts=tuple(Restart(k, 11.0, 10.5, 1, 1, 1) for k in range(3)))
    best = replace(tried(one), tuned=same, run=simulate(one.loop, noisy))
    said = summarise(of(study, study.cases[0], best, experiment=noisy)).sure
    assert said is not None
    assert said.level == "moderate"
    assert said.why == "The run shows another motion of the valve than the long run."
    assert "% an hour instead of 142 %" in " ".join(said.reasons)


def test_a_knife_edge_makes_it_low(study: Study, tuned: Make) -> None:
    best = tried(study.cases[2])
    sharp = replace(best, tuned=tuned(best.loop.controller, best.objective, worst=2.0))
    assert sure(study, study.cases[0], sharp)[0] == "low"


def test_what_the_record_pins_of_the_loop_counts(study: Study, estimated: Make) -> None:
    found, _ = estimated()
    loop = replace(study.cases[0].loop, plant=found.plant, valve=found.valve)
    case = replace(study.cases[0], loop=loop, limit_cycle=None)

    def told(**changes: Any) -> tuple[str, str]:
        named = NamedEstimate("FIC1", replace(found, **changes))
        said = summarise(replace(study, cases=(case,), estimates=(named,))).sure
        assert said is not None
        return said.level, said.reasons[0]

    level, reason = told(verdict="undecided")
    assert level == "low"
    assert reason.endswith("whether the valve sticks is undecided.")
    assert told(intervals=Intervals())[1].endswith(
        "hardly known or without a range: stiction d, gain K, time constant and dead time."
    )
    product = Intervals(d=(1.0, 3.0), gain=(1.3, 4.0), dead_time=(0.9, 1.1))
    assert "pins only the product of gain and stiction" in told(identifiable=False, intervals=product)[1]
    assert "dead time 0.9000 to 1.100 s (95 % range)" in told(intervals=product)[1]
    assert "the valve: d = 2.003 % (95 % range 1.990 to 2.010 %); gain 1.970 to 2.010 EU/% (95 % range)" in told()[1]


def test_what_may_not_even_stick_gives_no_order(study: Study, estimated: Make) -> None:
    found, _ = estimated(verdict="undecided", identifiable=False)
    loop = replace(study.cases[0].loop, plant=found.plant, valve=found.valve)
    base, best = (replace(case, loop=replace(loop, controller=case.loop.controller)) for case in study.cases[::2])
    summary = summarise(replace(study, cases=(base, best), estimates=(NamedEstimate("FIC1", found),)))
    assert summary.decision.startswith("Set nothing yet: whether the valve sticks is undecided")
    words = "so take this tuning as a hint. The best for the loop as it was estimated is Kc 2.351 %/EU, Ti 9.500 s (Opt"
    assert words in summary.decision
    assert summary.decision.count("undecided") == 1
    assert "FIC1: before acting, take a longer record, with a setpoint change of several per cent of OP in it." in (
        summary.do
    )
    # A record with setpoint changes in it is not asked for one.
    sp = np.where(np.arange(len(found.record)) < 200, 0.0, 6.0)
    moved = replace(found, record=replace(found.record, sp=sp))
    said = summarise(replace(study, cases=(base, best), estimates=(NamedEstimate("FIC1", moved),))).do
    assert any(
        "take a longer record, with more or larger setpoint changes, each of several per cent" in t for t in said
    )
    # What is kept is no order to take back.
    kept = replace(study, cases=(replace(base, objective=1.0), best), estimates=(NamedEstimate("FIC1", found),))
    assert summarise(kept).decision.startswith("Keep Case 1")


OPEN = Intervals(d=(1.99, 2.01), gain=(1.2, math.inf), time_constant=(4.0, math.inf), dead_time=(0.9, 1.1))
NO_DELAY = Intervals(d=(1.99, 2.01), gain=(1.97, 2.01), time_constant=(4.9, 5.1), dead_time=(0.5, math.inf))


@pytest.mark.parametrize(
    ("ranges", "why"),
    [
        (OPEN, "The record leaves the range of the gain K and time constant open"),
        (NO_DELAY, "The record leaves the range of the dead time open"),
        (Intervals(), "The record gives no range for the gain K and dead time"),
    ],
)
def test_a_plant_that_the_record_leaves_open_makes_the_tuning_a_hint(
    study: Study, estimated: Make, tuned: Make, ranges: Intervals, why: str
) -> None:
    found, truth = estimated(identifiable=False)
    found = replace(found, intervals=ranges)
    loop = replace(study.cases[0].loop, plant=found.plant, valve=found.valve)
    base, best = (replace(case, loop=replace(loop, controller=case.loop.controller)) for case in study.cases[::2])
    named = NamedEstimate("FIC1", found)
    summary = summarise(replace(study, cases=(base, best), estimates=(named,)))
    assert summary.decision.startswith("Set Kc ")
    assert why in summary.decision
    assert summary.decision.endswith("so take this tuning as a hint.")
    assert summary.sure is not None
    assert summary.sure.level == "low"
    assert why in summary.sure.why
    # Nor is it known what a slip does to PV.
    assert not any("moves PV" in text for text in summary.advice)
    # The same words as of a tuning without a scenario.
    assert hint(found) in summary.decision.replace("The record", "the record")
    # A loop that the scenario gives, or one that was simulated, is in no doubt.
    for sure in (
        replace(study, estimates=(named,)),
        replace(study, cases=(base, best), estimates=(replace(named, truth=truth),)),
    ):
        assert "as a hint" not in summarise(sure).decision


def test_a_record_that_does_not_show_the_gain_advises_no_tuning(study: Study, estimated: Make) -> None:
    found, _ = estimated(identifiable=False)
    loop = replace(study.cases[0].loop, plant=found.plant, valve=found.valve)
    base, best = (replace(case, loop=replace(loop, controller=case.loop.controller)) for case in study.cases[::2])
    for gain, why in (
        ((-0.1, 2.0), "does not show whether the gain is positive or negative (95 % range −0.100 to 2.00 EU/%)"),
        ((0.0, math.inf), "does not show that the valve moves PV at all (95 % range of the gain 0 EU/% or more)"),
    ):
        named = NamedEstimate("FIC1", replace(found, intervals=replace(OPEN, gain=gain)))
        summary = summarise(replace(study, cases=(base, best), estimates=(named,)))
        assert summary.decision.startswith(f"Set none of these tunings: the record of FIC1 {why}.")
        assert summary.settings is summary.sure is None
        assert not any("Kc" in text for text in summary.advice)


def stands(case: CaseResult, controller: PID | None = None, ranges: Intervals | None = None) -> CaseResult:
    loop = case.loop if controller is None else case.loop.with_controller(controller)
    return replace(case, standing=standing(loop, ranges))


def test_a_tuning_that_only_stiction_holds_is_no_advice_where_another_holds_the_loop(study: Study) -> None:
    base, best = stands(study.cases[0]), stands(study.cases[2], PID(5.0, 5.0))
    other = replace(stands(study.cases[1]), name="Calm", objective=100.0)
    summary = summarise(of(study, base, other, best))
    assert "(Calm)" in summary.decision
    assert any("Do not use Optimised PI" in text and "only stiction holds it" in text for text in summary.do)
    kept = summarise(of(study, replace(base, objective=50.0), other, best)).decision
    assert "none of the other tunings that hold the loop without stiction too has a lower J" in kept
    # Where there is no other, it is said beside the settings, and how sure it is.
    alone = summarise(of(study, best))
    assert "Before the valve is repaired take another tuning" in alone.decision
    assert alone.sure is not None
    assert alone.sure.level == "low"
    assert alone.sure.why == "The loop with an ideal valve is unstable: only stiction holds it."
    # What is there now is no reason to stay with it.
    changed = summarise(of(study, stands(study.cases[0], PID(5.0, 5.0)), other)).decision
    assert changed.startswith("Set ")


def test_ranges_within_which_a_tuning_fails_make_it_a_hint(study: Study, estimated: Make) -> None:
    found, _ = estimated()
    wide = Intervals(d=(1.99, 2.01), gain=(1.9, 20.0), time_constant=(4.9, 5.1), dead_time=(0.97, 1.03))
    found = replace(found, intervals=wide)
    loop = replace(study.cases[0].loop, plant=found.plant, valve=found.valve)
    base, best = (replace(case, loop=replace(loop, controller=case.loop.controller)) for case in study.cases[::2])
    best = stands(best, PID(1.0, 9.5), wide)
    summary = summarise(replace(study, cases=(base, best), estimates=(NamedEstimate("FIC1", found),)))
    why = "ith gain 20.0 EU/%, within the plant's 95 % range, the loop with an ideal valve is unstable"
    assert f"W{why}, so take this tuning as a hint." in summary.decision
    assert summary.sure is not None
    assert (summary.sure.level, why in summary.sure.why) == ("low", True)
    assert hint(found, standing=best.standing) == f"w{why}, so take this tuning as a hint"
    near = stands(best, PID(1.0, 9.5), replace(wide, gain=(1.9, 4.2))).standing
    assert "is near instability (maximum sensitivity " in hint(found, standing=near)


def test_a_known_plant_leaves_the_decision_as_it_is(study: Study, estimated: Make) -> None:
    found, _ = estimated()
    found = replace(found, intervals=replace(found.intervals, time_constant=(4.9, 5.1), dead_time=(0.97, 1.03)))
    loop = replace(study.cases[0].loop, plant=found.plant, valve=found.valve)
    base, best = (replace(case, loop=replace(loop, controller=case.loop.controller)) for case in study.cases[::2])
    summary = summarise(replace(study, cases=(base, best), estimates=(NamedEstimate("FIC1", found),)))
    assert "as a hint" not in summary.decision
    assert any("each slip moves PV by 3.99 EU or more in the end" in text for text in summary.advice)
    healthy = replace(found, verdict="no_stiction", valve=Ideal(), identifiable=False)
    one = replace(base, loop=replace(loop, valve=Ideal()))
    sure = summarise(replace(study, cases=(one,), estimates=(NamedEstimate("FIC1", healthy),))).sure
    assert sure is not None
    assert "pin" not in sure.why + sure.reasons[0]


def test_one_given_tuning_leaves_nothing_to_set(study: Study) -> None:
    summary = summarise(of(study, study.cases[0]))
    assert summary.decision.startswith("Nothing to set: Case 1 (Kc 0.5 %/EU, Ti 20 s) is the only tuning here")
    assert summary.watch == ()
    assert summary.settings is not None
    assert len(summary.settings.heads) == 1


def test_what_gains_next_to_nothing_is_not_worth_a_change(study: Study, case: Make) -> None:
    near = case("Near", 0.5, 20.01)
    assert 0.95 * study.cases[0].objective < near.objective
    better = replace(near, objective=0.97 * study.cases[0].objective)
    told = summarise(of(study, study.cases[0], better))
    assert told.decision.startswith(
        "Keep Case 1 (Kc 0.5 %/EU, Ti 20 s): nothing here is worth a change. The best other"
    )
    assert told.watch == ()
    calmer = replace(better, run=replace(better.run, kpis=replace(better.run.kpis, valve_travel=5.0)))
    assert summarise(of(study, study.cases[0], calmer)).decision.startswith("Set Kc 0.5 %/EU, Ti 20.01 s (Near)")
    # What is said beside it is of the tuning that stays.
    assert not any("With Near" in line for line in told.left)


def test_given_tunings_are_not_called_the_best_there_is(study: Study) -> None:
    reasons = sure(study, *study.cases[:2])[1]
    assert "No tuning was searched for: this is the best of the given ones" in reasons


def test_the_better_tuning_that_the_search_for_repair_has_found_is_named(study: Study) -> None:
    base = study.cases[0]
    assert base.objective is not None

    def told(objective: float) -> tuple[str, str]:
        repair = _repair(study, base.run.kpis)
        repair = replace(repair, best=replace(repair.best, objective=objective))
        said = summarise(of(study, *study.cases[:2], repair=repair)).sure
        assert said is not None
        return next(text for text in said.reasons if "the best of the given" in text), said.why

    reason, why = told(0.5 * base.objective)
    better = f"Kc 2.351 %/EU, Ti 9.500 s: J {figure(0.5 * base.objective)} instead of 226.6 in this run."
    assert f"has found a better one for the sticking valve, {better}" in reason
    assert "No tuning was searched for" not in reason
    assert "a search has found a better tuning than the given ones" in why.lower()
    reason, why = told(2.0 * base.objective)
    assert reason.endswith("the search for what repairing the valve is worth has found none better.")
    assert "better tuning" not in why


def test_the_long_run_stands_beside_the_run(study: Study) -> None:
    worn = replace(study.cases[2].limit_cycle, mean_square_error=0.2, travel_per_hour=1420.0)
    starts = tuple(replace(s, mean_square_error=0.2, travel_per_hour=1420.0) for s in worn.starts)
    best = replace(study.cases[2], limit_cycle=replace(worn, starts=starts))
    told = summarise(of(study, study.cases[0], best)).decision
    assert told.endswith("In the long run: mean square error −75 %, valve travel 10 times.")
    apart = replace(worn, starts=(starts[0], replace(starts[1], mean_square_error=0.5)))
    told = summarise(of(study, study.cases[0], replace(best, limit_cycle=apart))).decision
    assert "In the long run" not in told, "which cycle comes depends on the start"


def _repair(study: Study, kpis: Kpis) -> Repair:
    best = study.cases[2]
    assert isinstance(best.tuned, Tuned)
    one = Outcome(best.loop.controller, 1.0, best.run.kpis)
    four = (one, one, one, replace(one, kpis=kpis))
    return Repair(best.loop, best.run.experiment, best.tuned.weights, *four, best.tuned, best.tuned)


def test_repair_is_told_only_where_it_was_asked_and_brings_something(study: Study) -> None:
    left = study.cases[2].run.kpis
    half = replace(left, error_variance=0.25 * left.error_variance)
    cases = (study.cases[0], study.cases[2])
    told = summarise(of(study, *cases, repair=_repair(study, half))).decision
    assert told.endswith(
        "Repairing the valve, and tuning anew, would bring a further −50 % in PV standard deviation, travel unchanged."
    )
    told = summarise(of(study, *cases, repair=_repair(study, left))).decision
    assert "would bring no less PV standard deviation than this" in told
    assert "epair" not in summarise(of(study, *cases)).decision


def test_repair_that_brings_a_little_is_not_said_to_bring_nothing(study: Study) -> None:
    left = study.cases[2].run.kpis
    little = replace(left, error_variance=0.96**2 * left.error_variance)
    alone = replace(left, error_variance=0.87**2 * left.error_variance)
    best = replace(study.cases[2], repaired=Outcome(study.cases[2].loop.controller, 1.0, alone))
    told = summarise(of(study, study.cases[0], best, repair=_repair(study, little))).decision
    assert "would bring hardly less PV standard deviation in this run (−4 %, valve travel unchanged)" in told
    assert "; without tuning anew −13 %" in told
    assert "no less" not in told


def test_repair_that_gains_error_and_not_j_says_so_and_the_other_way_round(study: Study) -> None:
    best = study.cases[2]
    left, J = best.run.kpis, best.objective
    assert J is not None

    def told(share: float, objective: float) -> str:
        repair = _repair(study, replace(left, error_variance=share**2 * left.error_variance))
        repair = replace(repair, best_repaired=replace(repair.best_repaired, objective=objective))
        return summarise(of(study, study.cases[0], best, repair=repair)).decision

    against = f"instead of {figure(J)}."
    assert told(0.6, 1.2 * J).endswith(f"; J, which was asked for, does not gain: {figure(1.2 * J)} {against}")
    assert told(0.6, 0.99 * J).endswith(f"; J, which was asked for, hardly gains: {figure(0.99 * J)} {against}")
    assert told(1.0, 0.5 * J).endswith(f"; J, which was asked for, gains: {figure(0.5 * J)} {against}")
    assert "which was asked for" not in told(0.6, 0.5 * J)
    assert "which was asked for" not in told(1.0, J)


def test_a_moving_setpoint_is_not_told_as_scatter_of_pv(study: Study) -> None:
    moves = Experiment(duration=1000.0, setpoint=Step(4.0, 500.0), noise=Noise(0.1, 1))
    cases = []
    for one in (study.cases[0], study.cases[2]):
        cost = float(evaluate(one.loop, moves, study.objective)[0])
        cases.append(replace(one, run=simulate(one.loop, moves), objective=cost))
    told = summarise(of(study, *cases, experiment=moves))
    assert "standard deviation of SP − PV" in told.decision
    assert "PV standard deviation" not in told.decision
    assert told.settings is not None
    assert {"Standard deviation of PV", "Standard deviation of SP − PV"} <= {row.label for row in told.settings.rows}


def test_what_to_watch_holds_the_figures_and_the_way_back(study: Study, case: Make) -> None:
    watch = " ".join(summarise(of(study, study.cases[0], study.cases[2])).watch)
    assert "The cycle that remains: PV 2.01 EU every 12.0 s" in watch
    assert "Valve travel: 16.79 % in this run of 17 min, 142 % an hour in the long run" in watch
    assert "the gain is 4.7 times what it was; noise of 1 EU moves OP by 2.35 %" in watch
    assert "put back Kc 0.5 %/EU, Ti 20 s (Case 1)" in watch
    assert "Recovery" not in watch
    slow = replace(case("Slow", 0.5, 200.0), objective=1.0)
    watch = " ".join(summarise(of(study, study.cases[0], slow)).watch)
    assert "the integral gain Kc/Ti is 10 % of what it was" in watch
    wild = " ".join(summarise(of(study, case("Wild", 50.0, 5.0), study.cases[2])).watch)
    assert "put back" not in wild, "an unstable loop is nothing to go back to"


def test_settings_stand_as_the_site_types_them(study: Study) -> None:
    told = of(study, study.cases[0], study.cases[2], site=SITE)
    summary = summarise(told)
    assert summary.decision.startswith("Set proportional band 60.76 %, 6.316 repeats/min (series form) (Optimised PI)")
    assert summary.settings is not None
    assert summary.settings.heads == ("as found: Case 1", "as left: Optimised PI", "change")
    rows = {row.label: [cell.text for cell in row.cells] for row in summary.settings.rows}
    assert rows["Form"][:2] == ["series", "series"]
    assert rows["Proportional band"][:2] == ["285.7 %", "60.76 %"]
    assert rows["Integral rate 1/Ti"][:2] == ["3 repeats/min", "6.316 repeats/min"]
    assert rows["Valve travel"][:2] == ["12.18", "16.80"]
    assert rows["Action"][:2] == ["reverse", "reverse"]
    typed = told.site_cases[1]
    assert typed.objective == told.cases[1].objective, "the page is of what is typed in"
    assert typed.objective != study.cases[2].objective, "the rounded digits are other settings"
    assert "Optimised PI is Kc 2.351 %/EU, Ti 9.500 s in the scenario's form; rounded" in summary.typed[0]
    assert any(text.startswith("Valve travel: 16.80 % in this run") for text in summary.watch)
    table = site_table(told)
    assert table is not None
    assert [row.label for row in table.rows] == ["Case 1", "Optimised PI"]
    content = json.loads(results_json(told))["site"]
    assert content["units"] == {"gain": "%", "integral": "repeats/min", "derivative": "min"}
    assert content["cases"][1]["objective"] == pytest.approx(typed.objective)
    assert "site" not in json.loads(results_json(study))


def beside(told: Study, worst: float, **kpis: float) -> Study:
    """The study with that J in a run beside the settings typed in of its last case."""
    *others, last = told.site_cases
    assert last.beside is not None
    there = replace(last.beside, worst=worst, kpis=replace(last.beside.kpis, **kpis))
    return replace(told, site_cases=(*others, replace(last, beside=there)))


def test_a_lucky_rounding_at_the_site_is_no_promise(study: Study) -> None:
    best = study.cases[2]
    assert best.tuned is not None
    told = of(study, study.cases[0], best, site=SITE)
    own, was = told.cases[1], told.cases[0]
    assert own.objective is not None
    assert was.objective is not None
    calm = summarise(beside(told, 1.04 * own.objective))
    assert "knife-edge" not in " ".join((calm.decision, *calm.do))
    assert calm.sure is not None
    assert calm.sure.level == "moderate"
    edge = beside(told, 40.0, mean_square_error=0.5 * was.run.kpis.mean_square_error, valve_travel=24.36)
    summary = summarise(edge)
    assert f"J {own.objective:.2f} instead of {was.objective:.1f}, " in summary.decision
    edge_words = "A knife-edge, so count on no more than what settings beside these give: J as much as 40.00 "
    assert f"{edge_words}(mean square error −50 %, valve travel +100 %)." in summary.decision
    rises = f"±0.1 % and half the last digit of each setting J rises from {own.objective:.2f} to as much as 40.00."
    assert [text for text in summary.do if text.startswith("Type in exactly")] == [
        f"Type in exactly these digits: they are a knife-edge, within the larger of {rises}"
    ]
    assert summary.sure is not None
    assert (summary.sure.level, summary.sure.why) == ("low", "The settings as typed in are a knife-edge.")
    (digits,) = (text for text in summary.sure.reasons if text.startswith("Digits"))
    assert digits.startswith("Digits: the settings as typed in have 4; within the larger of ±0.1 % and half the last ")
    assert f"J is at most 40.00 instead of {own.objective:.2f}, one unit in a last digit gives at most " in digits
    # What is not to be counted on is no reason for a change.
    kept = summarise(beside(told, 0.97 * was.objective, valve_travel=0.97 * was.run.kpis.valve_travel)).decision
    assert kept.startswith(
        "Keep Case 1 (proportional band 285.7 %, 3 repeats/min (series form)): nothing here is worth"
    )
    # The digits of the search are others, and no matter of what is typed in.
    sharp = replace(own, tuned=replace(best.tuned, worst=3.0 * best.tuned.objective))
    other = replace(told, cases=(was, sharp))
    assert "knife-edge" not in " ".join(summarise(other).advice)
    # Without an objective it is the error that counts.
    bare = of(replace(study, objective=None), *(replace(c, objective=None) for c in (study.cases[0], best)), site=SITE)
    alone = summarise(beside(replace(bare, cases=bare.cases[1:], site_cases=bare.site_cases[1:]), 0.9)).decision
    assert "what settings beside these give: mean square error " in alone
    assert "J as much" not in alone


def test_the_searchs_own_figures_name_the_settings_they_are_of(study: Study, undrawn: None, tmp_path: Path) -> None:
    told = of(study, study.cases[0], study.cases[2], site=SITE)
    said = summarise(told).sure
    assert said is not None
    assert study.cases[2].tuned is not None
    least = f"{study.cases[2].tuned.nominal:.2f}"
    assert f"end within 0.1 % of the best J of unrounded settings, {least}, the worst" in " ".join(said.reasons)
    write_report(told, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "<strong>Optimised PI.</strong> Before the site&#39;s rounding: Made for a test." in page.replace(
        "'", "&#39;"
    )
    rows = {row.label: [cell.text for cell in row.cells] for row in how_tables(told)[0].rows}
    assert rows["Settings found, before the site's rounding"] == ["Kc 2.351 %/EU, Ti 9.500 s"]
    plain = {row.label for row in how_tables(of(study, *study.cases))[0].rows}
    assert "Settings found, before the site's rounding" not in plain


def test_what_the_sites_form_cannot_take_is_not_advised_but_what_comes_nearest_is(study: Study, case: Make) -> None:
    steep = replace(case("Steep", 0.5, 20.0, 6.0), objective=1.0)
    ((_, controller),) = nearest_controllers(SITE, [study.cases[0], steep])
    assert controller.form == "series"
    assert controller.ideal_terms().Td == pytest.approx(5.0, rel=2e-3), "the longest with an equivalent, unfiltered"
    near = replace(steep, name="Steep, nearest series", loop=steep.loop.with_controller(controller), objective=2.0)
    near = replace(near, nearest_to="Steep", run=simulate(near.loop, study.experiment))
    told = of(study, study.cases[0], steep, near, site=SITE)
    summary = summarise(told)
    words = "proportional band 571.4 %, 6 repeats/min, Td 0.1667 min (series form)"
    price = "if 3.8 times the valve travel of Case 1 is acceptable"
    assert summary.decision.startswith(f"Set {words} (Steep, nearest series) {price}: in this run J ")
    assert len(summary.typed) == 1
    assert summary.typed[0].startswith(
        "Steep (Kc 0.5 %/EU, Ti 20 s, Td 6 s) cannot be typed in: the site's series form has no equivalent (Ti = 20 s, "
    )
    assert f"What comes nearest is {words} (Steep, nearest series), with J 2.000 instead of 1.000" in summary.typed[0]
    assert summary.settings is not None
    assert summary.settings.heads[1] == "as left: Steep, nearest series"
    assert summary.settings.rows[1].cells[1].text == "571.4 %"
    assert summary.sure is not None
    assert "comes nearest to Steep in the site's form" in " ".join(summary.sure.reasons)
    worse = replace(near, objective=1000.0)
    kept = summarise(of(study, study.cases[0], steep, worse, site=SITE))
    assert kept.decision.endswith("none of the other tunings that can be typed in has a lower J in this experiment.")
    assert "Steep (Kc 0.5" in kept.typed[0]
    choice = summarise(of(replace(study, objective=None), *(replace(c, objective=None) for c in told.cases), site=SITE))
    assert "Steep (" not in choice.decision, "without an objective it is no choice either"


def test_where_the_sites_form_takes_nothing_it_is_said(study: Study, case: Make) -> None:
    steep = replace(case("Steep", 0.5, 20.0, 6.0), objective=1.0)
    summary = summarise(of(study, steep, site=SITE))
    assert "Kc 0.5 %/EU, Ti 20 s, Td 6 s, which has no equivalent in the site's series form" in summary.decision
    assert summary.settings is not None
    assert summary.settings.rows[1].cells[0].text == "no equivalent"


def test_without_a_site_the_controllers_own_form_is_shown(study: Study) -> None:
    table = as_found_as_left(study, study.cases[0], study.cases[2])
    rows = {row.label: [cell.text for cell in row.cells] for row in table.rows}
    assert rows["Gain Kc"][:2] == ["0.5 %/EU", "2.351 %/EU"]
    assert rows["Integral Ti"][:2] == ["20 s", "9.500 s"]
    assert rows["Valve travel"] == ["12.18", "16.79", "+38 %"]


def test_names_stay_text_on_the_first_screen(study: Study, tmp_path: Path) -> None:
    script = "<script>alert(1)</script>"
    cases = (replace(study.cases[0], name=f"Was {script}"), replace(study.cases[2], name=script))
    told = replace(of(study, *cases, site=SITE), estimates=())
    write_report(told, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert script not in page
    assert page.count("&lt;script&gt;") > 3


@pytest.mark.parametrize(("times", "level"), [(1.1, "moderate"), (1.5, "low")])
def test_what_rounding_decides_is_told_of_the_tuning_left_and_the_one_as_found(
    study: Study, times: float, level: str
) -> None:
    own = study.cases[0].run.kpis
    others = (own, replace(own, valve_travel=times * own.valve_travel))
    first = replace(study.cases[0], chance=others)
    said = summarise(of(study, first, tried(study.cases[2]))).sure
    told = "Case 1: rounding decides what its run gives: with Kc changed in the twelfth digit the mean square error is "
    travel = f"the valve travel {figure(own.valve_travel)} to {figure(times * own.valve_travel)} %"
    assert any(one.startswith(told) and travel in one for one in said.reasons)
    assert said.level == level
    assert "ounding decides the figures of Case 1" in said.why
    # Of a case that is neither nothing is said.
    other = replace(study.cases[1], chance=others)
    said = summarise(of(study, study.cases[0], other, tried(study.cases[2]))).sure
    assert not any("rounding decides" in one for one in said.reasons)
