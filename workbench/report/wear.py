"""What a change of settings costs the valve: times its travel as found, in the run and in the long run."""

from __future__ import annotations

import math

from workbench.model.cascade import CascadeCycle
from workbench.model.results import LimitCycle
from workbench.model.study import CascadeResult, CaseResult, Study
from workbench.report.judge import SAME_CYCLE, at_odds, cycle_of, late_words, over_starts, run_travel, with_stem
from workbench.report.words import change, duration, figure

__all__ = ["DEAR", "condition", "from_rest", "rests", "watch_travel", "wear"]

DEAR = 2.0  # times the valve's travel as found, from which the decision depends on it
LONG = " in the long run"


def rests(study: Study, case: CaseResult | CascadeResult) -> bool:
    """Return whether a case's loop comes to rest in the long run, and its own run shows nothing else."""
    cycle = cycle_of(case)
    return cycle is not None and cycle.outcome == "settles" and not at_odds(case, study.experiment)


def wear(
    study: Study, base: CaseResult | CascadeResult, case: CaseResult | CascadeResult, counted: float
) -> tuple[float, str]:
    """Return how many times the travel as found a case's is, in the run or the long run, and where, "" of the run.

    The larger counts: a run may be too short for the cycle, and a cycle without noise may be calmer than the run.
    Infinite where the case cycles on and the loop as found rests. counted: the travel in a run to count on, %.
    """
    before, after, in_run = cycle_of(base), cycle_of(case), _in_run(base, case, counted)
    if before is None or after is None or after.outcome != "cycles":
        return in_run
    if before.outcome == "cycles":
        return max(in_run, (after.travel_per_hour / before.travel_per_hour, LONG))
    # What never moves its valve controls nothing, and its rest is no measure.
    moved = with_stem(base).kpis.valve_travel > 0.0
    return (math.inf, LONG) if moved and rests(study, base) else in_run


def _in_run(base: CaseResult | CascadeResult, case: CaseResult | CascadeResult, counted: float) -> tuple[float, str]:
    was, now = with_stem(base).kpis.valve_travel, with_stem(case).kpis.valve_travel
    if was == 0.0:
        return 0.0, ""
    return (counted / was, " (with settings beside these)") if counted > now else (now / was, "")


def condition(study: Study, base: CaseResult | CascadeResult, case: CaseResult | CascadeResult, counted: float) -> str:
    """Return on which valve travel the order to set a case depends, "" where it is not several times that as found.

    counted: the travel in a run to count on, %.
    """
    ratio, where = wear(study, base, case, counted)
    cycle = cycle_of(case)
    if math.isinf(ratio) and cycle is not None:
        long = f"{_rate(cycle)[0]} % an hour{where}, where {base.name} comes to rest,"
        ratio, where = _in_run(base, case, counted)
        if ratio > DEAR:
            run = f"{figure(ratio, 2)} times the valve travel of {base.name}{where or ' in this run'}"
            return f" if {run} and {long} are acceptable"
        return f" if valve travel of {long} is acceptable"
    return f" if {figure(ratio, 2)} times the valve travel of {base.name}{where} is acceptable" if ratio > DEAR else ""


def _rate(cycle: LimitCycle | CascadeCycle) -> tuple[str, float]:
    """Return the valve's travel an hour (%) in the long run, over its starts in words, and the most of it or nan."""
    if isinstance(cycle, LimitCycle):
        return late_words(cycle, "travel_per_hour"), over_starts(cycle, "travel_per_hour")[1]
    return figure(cycle.travel_per_hour), cycle.travel_per_hour


def from_rest(new: float, old: float, unit: str) -> str:
    """Return how a figure of the long run changes, with its unit where it was none: "+66 %", "from 0 to 12 EU"."""
    return f"{change(new, old)} {unit}" if old == 0.0 < new else change(new, old)


def watch_travel(study: Study, case: CaseResult | CascadeResult) -> str:
    """Say how far a case's valve travels by this model, in its run and from every start tried: more is wear unseen."""
    cycle, experiment = cycle_of(case), study.experiment
    length = "this length" if experiment is None else duration(experiment.duration)
    text = f"Valve travel: {figure(with_stem(case).kpis.valve_travel)} % in this run of {length}"
    words, most = ("", math.nan) if cycle is None else _rate(cycle)
    if cycle is not None and cycle.outcome == "cycles":
        text += f", {words} % an hour in the long run without noise{', by the start' if ' to ' in words else ''}"
        rate = run_travel(case, experiment)
        text += f", {figure(rate, 3)} % an hour late in this run" if rate > SAME_CYCLE * most else ""
    elif not math.isnan(most):
        text += f", up to {figure(most, 3)} % an hour where it cycles, from another start"
    return f"{text}. More than that is wear which this model does not see."
