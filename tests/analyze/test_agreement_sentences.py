"""What is said where the describing function and the exact simulation agree, and where they do not."""

from __future__ import annotations

import math
from dataclasses import replace

from loops import paper_loop, paper_step

import workbench as wb
from workbench.analyze.agreement import agreement, comparison
from workbench.analyze.relaxation import relaxation_condition
from workbench.model.results import LimitCycle


def both(loop: wb.Loop) -> str:
    return agreement(wb.describing_function(loop), wb.limit_cycle(loop, paper_step()))


def test_case_1_is_the_blind_spot() -> None:
    sentence = both(paper_loop(0.5, 20.0))
    assert "predicts no cycle, but the loop cycles" in sentence
    assert "relaxation cycle" in sentence
    assert "Kc K J/S < 1 and Ti > tau + theta" in sentence


def test_case_4_agrees_with_its_errors() -> None:
    sentence = both(paper_loop(2.01, 301.0))
    assert sentence.startswith("Both say that the loop cycles")
    assert "period is 2 % too small" in sentence
    assert "PV swing 20 % too small" in sentence


def test_a_miss_outside_the_known_condition_is_not_explained_by_it() -> None:
    loop = paper_loop(1.32, 196.0, 1.0, derivative_filter=10.0)
    exact = wb.limit_cycle(loop, paper_step()).period
    assert both(loop) == (
        "The describing function predicts no cycle, but by exact simulation the loop cycles, with a period of "
        f"{exact:.3g} s."
    )


def test_both_say_no_cycle() -> None:
    assert both(replace(paper_loop(0.5, 20.0), valve=wb.Ideal())) == "Both say that the loop does not cycle."


def test_the_start_is_named_where_it_decides() -> None:
    loop = replace(paper_loop(0.5, 20.0), valve=wb.Choudhury(2.0, 0.5))
    told = (
        "The describing function predicts no cycle, and from this start the loop settles; from 7 of 8 others it cycles."
    )
    assert both(loop) == told
    assert "cycles from some starts" in agreement(wb.describing_function(loop), wb.limit_cycle(loop))


def test_a_predicted_cycle_that_does_not_exist_is_named() -> None:
    loop = paper_loop(2.01, 301.0)
    settled = wb.limit_cycle(replace(loop, valve=wb.Ideal()))
    sentence = agreement(wb.describing_function(loop), settled)
    assert "that does not exist: the loop settles" in sentence


def settling(loop: wb.Loop) -> LimitCycle:
    return wb.limit_cycle(replace(loop, valve=wb.Ideal()))


def test_a_predicted_cycle_that_exists_from_other_starts_is_not_denied() -> None:
    loop = paper_loop(2.01, 301.0)
    settled, cycling = settling(loop), wb.limit_cycle(loop)
    mixed = replace(settled, starts=(settled.starts[0], *cycling.starts[:2]))
    sentence = agreement(wb.describing_function(loop), mixed)
    assert sentence.endswith("but from this start the loop settles; from 2 of 2 others it cycles.")
    assert "does not exist" not in sentence


def test_crossings_that_are_all_unstable_are_no_missed_cycle() -> None:
    loop = paper_loop(2.01, 301.0)
    df, cycle = wb.describing_function(loop), wb.limit_cycle(loop)
    nan = math.nan
    crossing = replace(df.crossings[0], stable=False)
    wild = replace(df, crossings=(crossing,), period=nan, amplitude=nan, pv_amplitude=nan)
    assert agreement(wild, cycle) == (
        "The loci cross only where a cycle would not last, so the describing function gives no period; by exact "
        f"simulation the loop cycles, with a period of {cycle.period:.3g} s."
    )
    assert "should die out, and by exact simulation the loop settles" in agreement(wild, settling(loop))
    undecided = agreement(wild, replace(cycle, outcome="undecided"))
    assert undecided.startswith("The loci cross only where a cycle would not last; the exact")


def test_a_loop_unstable_by_its_tuning_is_not_blamed_on_the_valve_alone() -> None:
    loop = paper_loop(2.01, 301.0)
    df, cycle = wb.describing_function(loop), wb.limit_cycle(loop)
    assert "not the valve's alone" in agreement(replace(df, linear_stable=False), cycle)
    assert "not the valve's alone" not in agreement(df, cycle)


def test_long_periods_are_told_in_human_units() -> None:
    loop = paper_loop(2.01, 301.0)
    slow = replace(wb.describing_function(loop), period=4110.0)
    assert "a cycle with a period of 68 min that does not exist" in agreement(slow, settling(loop))


def test_no_verdict_is_not_compared() -> None:
    loop = paper_loop(20.0, 20.0)
    df, cycle = wb.describing_function(loop), wb.limit_cycle(loop)
    assert agreement(df, cycle).endswith("; by exact simulation PV grows without bound.")
    starts = tuple(replace(start, reason="fewer than 8 reversals") for start in cycle.starts)
    assert "no verdict to compare with" in agreement(df, replace(cycle, starts=starts))


def test_the_classes_of_agreement() -> None:
    relaxing, crossing = paper_loop(0.5, 20.0), paper_loop(2.01, 301.0)
    told = {loop: (wb.describing_function(loop), wb.limit_cycle(loop)) for loop in (relaxing, crossing)}
    assert comparison(*told[relaxing]) == "misses a relaxation cycle"
    assert comparison(*told[crossing]) == "agrees"
    assert comparison(told[relaxing][0], settling(relaxing)) == "agrees"
    assert comparison(told[crossing][0], settling(crossing)) == "predicts a cycle that does not exist"
    other = paper_loop(1.32, 196.0, 1.0, derivative_filter=10.0)
    assert comparison(wb.describing_function(other), wb.limit_cycle(other)) == "misses a cycle"
    assert comparison(told[relaxing][0], replace(told[relaxing][1], outcome="undecided")) == "no verdict"
    assert comparison(told[relaxing][0], replace(told[relaxing][1], outcome="depends")) == "misses a relaxation cycle"


def test_the_condition_of_the_blind_spot() -> None:
    assert relaxation_condition(paper_loop(0.5, 20.0))
    assert relaxation_condition(paper_loop(0.5, 20.0, 1.0))
    for loop in (
        paper_loop(1.01, 20.0),
        paper_loop(0.5, 5.9),
        paper_loop(0.5, math.inf),
        paper_loop(0.5, 20.0, action="direct"),
        replace(paper_loop(0.5, 20.0), valve=wb.Deadband(2.0)),
        replace(paper_loop(0.5, 20.0), valve=wb.Ideal()),
        replace(paper_loop(0.5, 20.0), plant=wb.Integrating(0.1)),
    ):
        assert not relaxation_condition(loop)
