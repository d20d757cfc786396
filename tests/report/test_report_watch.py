"""What to watch after a change names what the model itself does, from every start and in the run, as its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from workbench.model.study import CaseResult, Study
from workbench.report.summary import summarise

Make = Callable[..., Any]


def watched(study: Study, best: CaseResult) -> str:
    return " ".join(summarise(replace(study, cases=(study.cases[0], best), estimates=())).watch)


def by_starts(case: CaseResult, **figures: tuple[float, ...]) -> CaseResult:
    """The case with these figures of its starts, and the first of each as the cycle's own."""
    cycle = case.limit_cycle
    assert cycle is not None
    starts = list(cycle.starts)
    for name, values in figures.items():
        starts = [replace(start, **{name: value}) for start, value in zip(starts, values, strict=True)]
    own = {name: values[0] for name, values in figures.items()}
    return replace(case, limit_cycle=replace(cycle, starts=tuple(starts), **own))


def test_a_swing_and_a_travel_that_another_start_comes_to_are_the_loops_own(study: Study) -> None:
    best = study.cases[2]
    told = watched(study, by_starts(best, pv_peak_to_peak=(1.08, 1.22), travel_per_hour=(1359.3, 1870.0)))
    assert "PV 1.08 EU every 12.0 s without noise, up to 1.22 EU by the start, which took up to 13 min to show" in told
    assert "A swing well above 1.22 EU that" in told
    assert (
        "16.79 % in this run of 17 min, 1,359 to 1,870 % an hour in the long run without noise, by the start. " in told
    )
    told = watched(study, by_starts(best, pv_peak_to_peak=(1.22, 1.08)))
    assert "without noise, which took" in told, "the start given swings most"
    assert "A swing well above 1.22 EU that" in told


def test_what_the_run_itself_travels_is_no_wear_unseen(study: Study) -> None:
    base, _, best = study.cases
    moving = replace(base, name="Moving", objective=1.0, limit_cycle=best.limit_cycle)
    told = watched(study, by_starts(moving, travel_per_hour=(6.73, 5.39)))
    assert "5.39 to 6.73 % an hour in the long run without noise, by the start, " in told
    assert "% an hour late in this run. More than that" in told
    assert "late in this run" not in watched(study, by_starts(moving, travel_per_hour=(6.73, 1870.0)))


def test_the_travel_of_a_cycle_from_another_start_is_told_where_the_loop_rests(study: Study) -> None:
    best = by_starts(study.cases[2], travel_per_hour=(142.0, 250.0))
    cycle = best.limit_cycle
    assert cycle is not None
    starts = (replace(cycle.starts[0], outcome="settles"), cycle.starts[1])
    told = watched(study, replace(best, limit_cycle=replace(cycle, outcome="settles", starts=starts)))
    assert "16.79 % in this run of 17 min, up to 250 % an hour where it cycles, from another start. More" in told
