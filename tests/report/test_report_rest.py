"""A loop that comes to rest: the error that stays is told with its cause, and so are the starts that cycle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from workbench.model.results import LimitCycle
from workbench.model.study import CaseResult, Study
from workbench.report.cycles import cycle_tables
from workbench.report.summary import summarise

Make = Callable[..., Any]
LIMIT = "PV comes to rest with an error of +0.8 EU, as OP is at its limit"
STAYS = "PV 0.800 EU below its setpoint"


def of(study: Study, *cases: CaseResult, **extra: Any) -> Study:
    return replace(study, cases=cases, estimates=(), **extra)


def resting(case: CaseResult, cycle: Make, reason: str, error: float) -> CaseResult:
    """Return the case with a loop that rests so from every start."""
    made: LimitCycle = cycle(case.loop, "settles")
    starts = tuple(replace(start, reason=reason, rest_error=error) for start in made.starts)
    return replace(case, limit_cycle=replace(made, starts=starts), describing_function=None)


def test_an_error_that_stays_is_told_with_its_cause_wherever_the_loop_is_said_to_rest(
    study: Study, cycle: Make
) -> None:
    best = resting(study.cases[2], cycle, LIMIT, 0.8)
    told = of(study, study.cases[0], best)
    summary = summarise(told)
    assert f"In the long run Optimised PI leaves {STAYS}, as OP is at its limit." in summary.decision
    assert f"Optimised PI ({STAYS}): the loop comes to rest there, as OP is at its limit." in summary.found
    assert any(f"comes to rest in this experiment, {STAYS}, as OP is at its limit" in text for text in summary.left)
    assert summary.sure is not None
    assert any(f"this experiment, {STAYS}, as OP is at its limit" in reason for reason in summary.sure.reasons)
    assert "PV comes to rest off its setpoint" in summary.sure.why
    rows = {row.label: [cell.text for cell in row.cells] for row in cycle_tables(told)[0].rows}
    assert rows["Rests with SP − PV at"] == ["–", "0.800"]
    assert rows["Rests there, as"] == ["–", "OP is at its limit"]


def test_cases_that_rest_for_one_cause_stand_in_one_sentence_each_with_its_error(study: Study, cycle: Make) -> None:
    cause = "no integral action moves the stem on"
    reason = f"PV comes to rest with an error of -2.25 EU, as {cause}"
    one, other = resting(study.cases[0], cycle, reason, -2.25), resting(study.cases[1], cycle, reason, 0.5)
    assert (
        "Case 1 (PV 2.25 EU above its setpoint) and Case 2 (PV 0.500 EU below its setpoint): the loop comes to rest "
        f"there, as {cause}."
    ) in summarise(of(study, one, other)).found


def test_a_loop_that_rests_on_its_setpoint_leaves_nothing(study: Study, cycle: Make) -> None:
    best = resting(study.cases[2], cycle, "PV comes to rest on the setpoint", 1e-12)
    summary = summarise(of(study, study.cases[0], best))
    assert "In the long run" not in summary.decision
    assert "Optimised PI: the loop comes to rest." in summary.found
    assert summary.sure is not None
    assert "off its setpoint" not in summary.sure.why
    assert not any(row.label.startswith("Rests") for row in cycle_tables(of(study, best))[0].rows)


def test_a_cycle_from_other_starts_is_the_loops_own_and_no_sign_of_another_loop(study: Study, cycle: Make) -> None:
    base, calm = study.cases[0], resting(study.cases[2], cycle, LIMIT, 0.8)
    rest, cycling = calm.limit_cycle, cycle(calm.loop, period=7200.0)
    assert rest is not None
    other = replace(cycling.starts[1], pv_peak_to_peak=0.73)
    starts = (rest.starts[0], rest.starts[1], other, replace(other, pv_peak_to_peak=0.7))
    best = replace(calm, limit_cycle=replace(rest, starts=starts, period_range=(7200.0, 7210.0)))
    summary = summarise(of(study, base, best))
    watch = summary.watch[0]
    assert "comes to rest (from this start), but from 2 of 3 other starts it cycles (PV up to 0.730 EU every" in watch
    assert "every 2.0 h), so that a cycle may be this loop's own" in watch
    assert "A swing well above 0.730 EU" in watch
    assert "a lasting cycle means" not in watch
    assert any(text.endswith("as OP is at its limit; from 2 of 3 other starts it cycles.") for text in summary.left)
    assert summary.sure is not None
    assert any("from 2 of 3 other starts it cycles" in reason for reason in summary.sure.reasons)
    assert "the long run is not one and the same" in summary.sure.why


def test_where_no_start_cycles_a_lasting_cycle_is_a_sign_of_another_loop(study: Study, cycle: Make) -> None:
    summary = summarise(of(study, study.cases[0], resting(study.cases[2], cycle, LIMIT, 0.8)))
    assert "a lasting cycle means that the loop is not the one modelled." in summary.watch[0]
    assert summary.sure is not None
    assert not any("other starts" in text for text in (*summary.left, *summary.sure.reasons))
