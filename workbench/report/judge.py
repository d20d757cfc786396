"""What the report holds a case to be before it is told: unstable, not settled for good, on a bound, at odds with noise.

Judgements on figures that are there already; nothing is simulated here.
"""

from __future__ import annotations

import math

import numpy as np

from workbench.kpi.kpis import Event, cascade_event, last_event, reversals, travel
from workbench.model.cascade import CascadeCycle, CascadeExperiment, CascadeRun
from workbench.model.experiment import Experiment
from workbench.model.results import LimitCycle, Run, Tuned
from workbench.model.site import SiteCase
from workbench.model.study import CascadeResult, CaseResult, NamedEstimate, Study
from workbench.report.standing import held_by_stiction
from workbench.report.thinned import BEYOND
from workbench.report.words import figure, given, setting

__all__ = [
    "at_odds",
    "band_words",
    "base_case",
    "best_case",
    "cycle_of",
    "df_disagrees",
    "last_change",
    "late_figure",
    "late_words",
    "measure",
    "nominal_only",
    "on_bounds",
    "over_budget",
    "over_starts",
    "quiet",
    "refused",
    "run_travel",
    "settling_band",
    "settling_doubt",
    "source_of",
    "too_short",
    "typed_case",
    "unstable",
    "with_stem",
]

LATE = 0.9  # share of the run after which an entry into the band is no settling
NEAR = 2e-3  # relative distance within which a tuned parameter lies on its bound
TAIL = 0.5  # last share of a run that is compared with the verdict without noise
SHORTEST = 0.1  # share of a run that is enough for that, and that a change before it is left to die out
SAME_CYCLE = 1.1  # ratio up to which the figures of cycles from several starts are one figure
MOVING = 3  # reversals of the stem from which a valve keeps moving
AHEAD = 0.9  # times the J of a search, below which a rule that was not asked to minimise it goes before


def unstable(case: CaseResult | CascadeResult) -> bool:
    """Return whether the case's run grows past all measure, or the long run that was followed does."""
    runs = (case.run.primary, case.run.secondary) if isinstance(case, CascadeResult) else (case.run,)
    if not all(float(np.abs(run.pv).max()) <= BEYOND for run in runs):
        return True
    if isinstance(case, CascadeResult):
        return case.cycle is not None and "grows without bound" in case.cycle.reason
    cycle = case.limit_cycle
    return cycle is not None and cycle.grows


def base_case(study: Study) -> CaseResult | None:
    """Return the case that others are compared with: the first whose tuning was given."""
    return next((c for c in study.cases if c.tuned is None and not c.nearest_to), None)


def source_of(study: Study, case: CaseResult) -> NamedEstimate | None:
    """Return the estimate of a plant's own record that is the case's loop, None where the scenario gives the loop."""
    for named in study.estimates:
        found = named.found
        if named.truth is None and found.plant == case.loop.plant and found.valve == case.loop.valve:
            return named
    return None


def typed_case(study: Study, case: CaseResult) -> SiteCase | None:
    """Return the case as typed in at the site, None where the scenario does not say how the site writes."""
    return next((one for one, own in zip(study.site_cases, study.cases, strict=False) if own is case), None)


def refused(study: Study, case: CaseResult) -> bool:
    """Return whether the site's form has no equivalent of the case, so that it cannot be typed in."""
    typed = typed_case(study, case)
    return typed is not None and typed.settings is None


def nominal_only(case: CaseResult) -> bool:
    """Return whether a case is the least J itself, which sits on a cliff: to compare with, and not to be typed in."""
    return case.tuned is not None and case.tuned.nominal_only


def measure(case: CaseResult) -> float:
    """Return what a case is judged by: J, or its mean square error without an objective; inf where it overflowed."""
    value = case.run.kpis.mean_square_error if case.objective is None else case.objective
    return value if math.isfinite(value) else math.inf


def best_case(study: Study) -> CaseResult | None:
    """Return the case of least J (least mean square error without an objective) of those that can be set.

    They are verified, meant to be typed in, bounded, have an equivalent in the site's form, and hold the loop without
    the valve's stiction; where none has, the form, and where none does, the stiction is left aside. A search, which was
    asked for, goes before a rule that is hardly better.
    """
    fit = [c for c in study.cases if (c.tuned is None or c.tuned.status.success) and not nominal_only(c)]
    fit = [c for c in fit if math.isfinite(measure(c)) and not unstable(c)]
    fit = [c for c in fit if not refused(study, c)] or fit
    fit = [c for c in fit if not held_by_stiction(c.standing)] or fit
    best = min(fit, key=measure, default=None)
    if best is None or best.rule is None:
        return best
    found = min([c for c in fit if c.tuned is not None], key=measure, default=best)
    return best if measure(best) < AHEAD * measure(found) else found


def df_disagrees(case: CaseResult) -> bool:
    """Return whether describing function and exact simulation give opposite answers on a cycle."""
    df, cycle = case.describing_function, case.limit_cycle
    if df is None or cycle is None or cycle.outcome not in ("cycles", "settles"):
        return False
    return df.prediction == ("no cycle" if cycle.outcome == "cycles" else "cycle")


def over_starts(cycle: LimitCycle, name: str) -> tuple[float, float]:
    """Return the least and largest of a figure over the starts that cycle: which one comes is chosen by the start."""
    values = [float(getattr(start, name)) for start in cycle.starts if start.outcome == "cycles"]
    return (min(values), max(values)) if values else (math.nan, math.nan)


def late_figure(cycle: LimitCycle, name: str) -> float:
    """Return a figure of a cycle that has set in: the cycle's own, or the median where it depends on the start."""
    values = [float(getattr(start, name)) for start in cycle.starts if start.outcome == "cycles"]
    return float(np.median(values)) if _differs(cycle, name) else float(getattr(cycle, name))


def late_words(cycle: LimitCycle, name: str) -> str:
    """Return "0.0278 to 0.98" over the starts, or the cycle's own figure where all agree within a tenth."""
    if not _differs(cycle, name):
        return figure(float(getattr(cycle, name)), 3)
    low, high = over_starts(cycle, name)
    return f"{figure(low, 3)} to {figure(high, 3)}"


def _differs(cycle: LimitCycle, name: str) -> bool:
    low, high = over_starts(cycle, name)
    return high > SAME_CYCLE * low


def quiet(experiment: Experiment | None) -> str:
    """Return what the verdict on cycles leaves out of the experiment: "without noise", or "" where nothing."""
    if experiment is None:
        return ""
    noises = [experiment.noise, experiment.secondary_noise if isinstance(experiment, CascadeExperiment) else None]
    noise = any(one is not None and one.sd > 0.0 for one in noises)
    if noise and experiment.load_parts:
        return "without noise and further disturbance"
    return "without noise" if noise else "without further disturbance" if experiment.load_parts else ""


def _event(case: CaseResult | CascadeResult, experiment: Experiment | None) -> Event | None:
    """Return the last step that the loop, or the cascade's primary, has to settle from, or None."""
    if experiment is None:
        return None
    if isinstance(case, CascadeResult):
        return cascade_event(case.run.cascade, experiment)
    return last_event(case.loop, experiment)


def settling_band(case: CaseResult | CascadeResult, experiment: Experiment | None) -> str:
    """Return the settling time's band in words, "" where there is none."""
    event = _event(case, experiment)
    if event is None:
        return ""
    return f"from the last step into {band_words(event)}"


def band_words(event: Event) -> str:
    """Return the band that PV has to enter after an event, in words."""
    return "±2 % of the largest error" if math.isnan(event.band) else f"±{given(event.band, 2)} EU"


def settling_doubt(case: CaseResult | CascadeResult, experiment: Experiment | None) -> str:
    """Return why a finite settling time, of a cascade the primary's, is not one to go by, or ""."""
    event, run = _event(case, experiment), case.run.primary if isinstance(case, CascadeResult) else case.run
    value = run.kpis.settling_time
    if experiment is None or event is None or not math.isfinite(value):
        return ""
    band = event.band
    if math.isnan(band):
        band = 0.02 * float(np.abs(run.sp - run.pv)[run.time >= event.at - 1e-9].max(initial=0.0))
    if _late_error(case) > band:
        return "not for good: it cycles"
    return "only at the run's end" if event.at + value > LATE * experiment.duration else ""


def _late_error(case: CaseResult | CascadeResult) -> float:
    """Return how far PV lies from its setpoint once the cycle has set in, EU; nan where it does not cycle."""
    if isinstance(case, CascadeResult):
        late = None if case.cycle is None or case.cycle.outcome != "cycles" else case.cycle.late
        seen = None if case.cycle is None else case.cycle.primary
        if late is None or seen is None:
            return math.nan
        return max(0.5 * seen.pv_peak_to_peak, math.sqrt(late.primary.kpis.mean_square_error))
    cycle = case.limit_cycle
    if cycle is None or cycle.outcome != "cycles":
        return math.nan
    return max(0.5 * cycle.pv_peak_to_peak, math.sqrt(cycle.mean_square_error))


def on_bounds(tuned: Tuned, moves: str = "%") -> list[str]:
    """Return which tuned parameters lie on a bound that could be wider: "Kc on its upper bound of 10 %/EU".

    moves: the unit of what the controller puts out.
    """
    parallel = tuned.controller.form == "parallel"
    units = {
        "Kc": f"{moves}/EU",
        "Ti": f"EU s/{moves}" if parallel else "s",
        "Td": f"{moves} s/EU" if parallel else "s",
    }
    out = []
    for name, unit in units.items():
        value, (low, high) = getattr(tuned.controller, name), getattr(tuned.bounds, name)
        if low == high:
            continue
        for which, end in (("lower", low), ("upper", high)):
            if end > 0.0 and abs(value - end) <= NEAR * end:
                out.append(f"{name} on its {which} bound of {setting(end)} {unit}")
    return out


def over_budget(case: CaseResult) -> str:
    """Say that the fresh draws exceed the cap on mean travel that a robust search kept on its own, "" if they do not.

    The sentence begins with a space.
    """
    r, tuned = case.robustness, case.tuned
    asked = None if tuned is None else tuned.constraints
    if r is None or tuned is None or tuned.ensemble is None or asked is None or asked.valve_travel is None:
        return ""
    if not r.travel_mean > asked.valve_travel:
        return ""
    # A search that found nothing within the constraints kept the cap nowhere.
    own = (
        f"That holds for the {tuned.ensemble.draws:,} draws of its search alone: over"
        if tuned.status.success
        else "Over"
    )
    return f" {own} the draws shown here the mean is {figure(r.travel_mean, 3)} %."


def last_change(run: Run | CascadeRun) -> float:
    """Return when the setpoint or a load last changes within the run (s), 0 where neither does."""
    one = run.primary if isinstance(run, CascadeRun) else run
    moved = (np.diff(one.sp) != 0.0) | (np.diff(one.load) != 0.0)
    if isinstance(run, CascadeRun):  # the secondary's setpoint is the primary's output, and no change from outside
        moved |= np.diff(run.secondary.load) != 0.0
    moves = np.flatnonzero(moved)
    return float(one.time[moves[-1] + 1]) if moves.size else 0.0


def with_stem(case: CaseResult | CascadeResult) -> Run:
    """Return the run of the loop that holds the valve."""
    return case.run.secondary if isinstance(case, CascadeResult) else case.run


def cycle_of(case: CaseResult | CascadeResult) -> LimitCycle | CascadeCycle | None:
    """Return what a case does in the long run, None where it was not asked."""
    return case.cycle if isinstance(case, CascadeResult) else case.limit_cycle


def _tail(case: CaseResult | CascadeResult, experiment: Experiment) -> tuple[int, int] | None:
    """Return the samples [first, stop) of the second half, once the last change has died out, or None if too few."""
    run, last = with_stem(case), last_change(case.run)
    # A change needs time to die out, or its own answer would be taken for the loop's lasting motion.
    start = max((1.0 - TAIL) * experiment.duration, last + SHORTEST * experiment.duration if last > 0.0 else 0.0)
    if experiment.duration - start < SHORTEST * experiment.duration:
        return None
    first = math.ceil(start / run.loop.sample_time - 1e-9)
    return (first, run.valve.size) if 0 < first < run.valve.size else None


def run_travel(case: CaseResult | CascadeResult, experiment: Experiment | None) -> float:
    """Return the valve's travel an hour (%) in the run's second half, after its last change; nan where unknown."""
    part = None if experiment is None else _tail(case, experiment)
    if part is None or unstable(case):
        return math.nan
    first, stop = part
    run = with_stem(case)
    moved = travel(run.valve[first:stop], float(run.valve[first - 1]))
    return 3600.0 * moved / ((stop - first) * run.loop.sample_time)


def too_short(case: CaseResult | CascadeResult, experiment: Experiment | None) -> bool:
    """Return whether the run ends before it could show the cycle that the case comes to: it holds other figures."""
    cycle = cycle_of(case)
    if experiment is None or cycle is None or cycle.outcome != "cycles":
        return False
    window = cycle.window if isinstance(cycle, LimitCycle) else 2.0 * cycle.period
    # It counts from the last change of the signals on: what comes before that shows another motion.
    return window > experiment.duration - last_change(case.run)


def at_odds(case: CaseResult | CascadeResult, experiment: Experiment | None) -> bool:
    """Return whether the run, with its noise or load, shows another motion of the valve than the verdict without."""
    cycle, run = cycle_of(case), with_stem(case)
    part = None if experiment is None or not quiet(experiment) else _tail(case, experiment)
    if cycle is None or part is None or unstable(case):
        return False
    first, stop = part
    moving = reversals(run.valve[first:stop], float(run.valve[first - 1])) >= MOVING
    if cycle.outcome == "settles":
        return moving
    if cycle.outcome != "cycles":
        return False
    rate = run_travel(case, experiment)
    if rate > 2.0 * cycle.travel_per_hour:
        return moving
    long = (stop - first) * run.loop.sample_time >= 2.0 * cycle.period
    return long and not too_short(case, experiment) and rate < 0.5 * cycle.travel_per_hour
