"""The plain truth about stick-slip cycles, from measured runs: what tuning changes, what it cannot, when to repair.

And what a map of tunings shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from workbench.model.cycle_map import CycleMap, MapCell
from workbench.model.plant import FOPDT
from workbench.model.results import LimitCycle
from workbench.model.study import CaseResult, Study
from workbench.report.cycles import period_words
from workbench.report.draw_map import MapPoint
from workbench.report.judge import late_figure, late_words, over_starts, source_of, unstable
from workbench.report.known import least_step
from workbench.report.words import duration, figure, given, join

__all__ = ["lasting", "map_points", "map_text"]

ALIKE = 1.1  # ratio up to which two swings count as the same
ENDS = (0.05, 0.95)  # quantiles between which a range is told
SLOWER = 2.0  # ratio of integral times from which on one is called slower
SPARED = 0.8  # ratio of valve travels an hour up to which the lesser spares the valve
ROOM = 2.0  # gain margin below which a tuning is said to be near instability


@dataclass(frozen=True, slots=True)
class _Seen:
    """A tuning whose cycle was measured: where it is, medians over its starts (EU, % an hour), and all in words."""

    where: str
    swing: float
    travel: float
    swing_words: str
    period_words: str
    travel_words: str


def map_points(study: Study) -> list[MapPoint]:
    """Return the study's cases as points of its map; one with another third parameter lies beside the plane."""
    found = study.cycle_map
    if found is None:
        return []
    fixed = "Td" if found.axis == "Ti" else "Ti"
    points = []
    for case in study.cases:
        pid = case.loop.controller
        same = getattr(pid, fixed) == getattr(found.loop.controller, fixed)
        points.append(MapPoint(case.name, pid.Kc, getattr(pid, found.axis), case.tuned is not None, not same))
    return points


def map_text(found: CycleMap) -> list[str]:
    """Return what a map shows, in sentences: how it was made, which tunings cycle, and what its borders mean."""
    pid = found.loop.controller
    fixed = "Td" if found.axis == "Ti" else "Ti"
    rows, columns = found.outcome.shape
    stable = int(found.linear_stable.sum())
    made = (
        f"Each of {columns} × {rows} tunings (Kc {_span(found.Kc)} %/EU, {found.axis} {_span(found.values)} s, "
        f"{fixed} {given(getattr(pid, fixed))} s) was followed exactly and without noise from {found.starts} "
        f"{'start' if found.starts == 1 else 'starts'}; figures are medians over the starts that cycle. With an ideal "
        f"valve the loop is stable at {stable:,} of them."
    )
    text = [made]
    if stable:
        text.append(f"Of these, {_outcomes(found, stable)}.")
    text += _borders(found)
    return text


def _span(values: np.ndarray) -> str:
    return f"{given(float(values[0]), 3)} to {given(float(values[-1]), 3)}"


def _outcomes(found: CycleMap, stable: int) -> str:
    """Return how many of the stable tunings do what."""
    words = (
        ("cycles", "keep cycling from every start tried"),
        ("depends", "cycle or come to rest depending on the start"),
        ("settles", "come to rest from every start tried"),
        ("undecided", "could not be decided"),
    )
    counts = [(found.count(name), text) for name, text in words]
    return join([f"{'all' if n == stable else f'{n:,}'} {text}" for n, text in counts if n])


def _borders(found: CycleMap) -> list[str]:
    """Say what the describing function's border and the two lines of the relaxation cycle mean on this map."""
    out = []
    known = ~np.isnan(found.crossing)
    cycling = found.cycles & found.linear_stable & known
    if cycling.any():
        missed = int((cycling & (found.crossing > 1.0)).sum())
        if missed:
            out.append(
                f"The describing function sees no crossing at {missed:,} of the {int(cycling.sum()):,} stable tunings "
                "that cycle: it is blind on that side of its border."
            )
        else:
            out.append("The describing function sees a crossing at every stable tuning that cycles.")
    if np.isnan(found.loop_gain).all():
        why = "of an integrating plant" if not isinstance(found.loop.plant, FOPDT) else "where the valve has no jump"
        out.append(
            f"The lines Kc K J/S = 1 and Ti = tau + theta mean nothing {why}, and are not drawn: they belong to "
            "self-regulating plants with a valve that jumps when it slips."
        )
        return out
    blind = (found.loop_gain < 1.0) & (found.lag_ratio > 1.0) & found.linear_stable
    cycles = blind & found.cycles
    if cycles.any():
        swing, period = found.pv_peak_to_peak[cycles], found.period[cycles]
        low, high = np.quantile(swing, ENDS)
        alike = ", whatever the tuning" if high <= ALIKE * low else ""
        out.append(
            f"Where Kc K J/S < 1 and Ti > tau + theta ({int(blind.sum()):,} stable tunings) a slip's own echo does not "
            f"set off the next one, and only the integral action moves the valve on: the relaxation cycle. There PV "
            f"swings {_range(swing)} EU at all but a tenth of them{alike} (K J is "
            f"{given(abs(found.loop.plant.gain) * found.loop.valve.slip_jump, 3)} EU), while the period runs from "
            f"{duration(float(period.min()))} to {duration(float(period.max()))}."
        )
    return out


def _range(values: np.ndarray) -> str:
    """Return the range that leaves out a twentieth at each end."""
    low, high = (figure(float(q), 3) for q in np.quantile(values, ENDS))
    return low if low == high else f"{low} to {high}"


def lasting(study: Study, best: CaseResult) -> list[str]:
    """Say what tuning changes, what it does not remove while the controller integrates, and when to repair the valve.

    Nothing of a valve whose stiction is undecided, of a loop that comes to rest, or without integral action.
    """
    if any(e.found.verdict == "undecided" and e.found.valve == best.loop.valve for e in study.estimates):
        return []
    cycle, loop = best.limit_cycle, best.loop
    settles = cycle is not None and cycle.outcome == "settles"
    if settles or loop.valve.stick_band == 0.0 or math.isinf(loop.controller.Ti):
        return []
    out: list[str] = _by_tuning(study)
    if loop.valve.slip_jump > 0.0 and isinstance(loop.plant, FOPDT):
        out.append(
            f"What no tuning removes: this valve moves in steps{_size(study, best)}. While the controller integrates, "
            "it hunts for a setpoint between two steps, the more slowly the weaker the integral action. Repairing the "
            "valve ends that; an integral dead band stops it at the price of a lasting offset."
        )
    return [*out, *_slower(study), *_at_best(study)]


def _size(study: Study, best: CaseResult) -> str:
    """Return how large the valve's least step is and what it does to PV, "" where an estimate does not tell."""
    loop, named = best.loop, source_of(study, best)
    jump = loop.valve.slip_jump
    plain = f"at least {given(jump)} %", f"{given(abs(loop.plant.gain) * jump, 3)} EU"
    told = plain if named is None else least_step(named.found)
    if told is None:
        return ""
    curved = "" if loop.characteristic is None else " (at the operating point; elsewhere by the characteristic)"
    return f" of {told[0]}, each of which moves PV by {told[1]} in the end{curved}"


def _by_tuning(study: Study) -> list[str]:
    """Name the cases whose cycle a weaker controller ends, at least in part."""
    some = [
        c.name
        for c in study.cases
        if c.limit_cycle is not None
        and c.limit_cycle.outcome == "cycles"
        and c.describing_function is not None
        and not c.describing_function.linear_stable
    ]
    if not some:
        return []
    text = (
        f"What tuning removes: the part of the cycle of {join(some)} that is not the valve's. With an ideal valve the "
        "loop would be unstable there; less gain or slower integral action ends that, and leaves the valve's own cycle."
    )
    return [text]


def _measured(study: Study) -> list[_Seen]:
    """Return the tunings whose cycle was measured, from every start tried, in loops that are stable by themselves."""
    out = []
    for case in study.cases:
        cycle = case.limit_cycle
        alone = case.describing_function is not None and not case.describing_function.linear_stable
        if cycle is not None and cycle.outcome == "cycles" and not alone and not unstable(case):
            swing, travel = (late_figure(cycle, name) for name in ("pv_peak_to_peak", "travel_per_hour"))
            words = (late_words(cycle, name) for name in ("pv_peak_to_peak", "travel_per_hour"))
            out.append(_Seen(case.name, swing, travel, next(words), period_words(cycle), next(words)))
    found = study.cycle_map
    if found is not None:
        cells = (found.least("pv_peak_to_peak"), found.least("travel_per_hour"))
        out += [
            _Seen(
                _where(found, cell),
                cell.pv_peak_to_peak,
                cell.travel_per_hour,
                figure(cell.pv_peak_to_peak, 3),
                duration(cell.period),
                figure(cell.travel_per_hour, 3),
            )
            for cell in cells
            if cell is not None
        ]
    return out


def _where(found: CycleMap, cell: MapCell) -> str:
    """Return a cell's tuning in words, with a warning where half as much gain again would be too much."""
    unit = "s" if found.loop.controller.form != "parallel" else "EU s/%" if found.axis == "Ti" else "% s/EU"
    text = f"Kc {figure(cell.Kc, 3)} %/EU and {found.axis} {figure(cell.value, 3)} {unit}"
    row = int(np.abs(found.values - cell.value).argmin())
    beyond = found.Kc[~found.linear_stable[row]]
    near = bool((beyond < ROOM * cell.Kc).any())
    return f"{text}, within a factor {given(ROOM)} in gain of instability" if near else text


def _slower(study: Study) -> list[str]:
    """Say from two cases of one gain what slower integral action changes, the travel, and what it does not, the swing.

    Nothing where the travel stays or the swing does not.
    """
    some = [
        (c, c.limit_cycle)
        for c in study.cases
        if c.limit_cycle is not None and c.limit_cycle.outcome == "cycles" and math.isfinite(c.loop.controller.Ti)
    ]
    for fast, was in some:
        for slow, now in some:
            a, b = fast.loop.controller, slow.loop.controller
            same = a.form == b.form == "ideal" and a.Kc == b.Kc and a.Td == b.Td
            same = same and a.compensator is b.compensator is None
            if not same or b.Ti < SLOWER * a.Ti or was.pv_peak_to_peak <= 0.0:
                continue
            if not 1.0 / ALIKE <= now.pv_peak_to_peak / was.pv_peak_to_peak <= ALIKE:
                continue
            # Only what holds for all their cycles is a claim: which of them comes is chosen by the start.
            if over_starts(now, "travel_per_hour")[1] > SPARED * over_starts(was, "travel_per_hour")[0]:
                continue
            return [_slowed(fast, was, slow, now)]
    return []


def _slowed(fast: CaseResult, was: LimitCycle, slow: CaseResult, now: LimitCycle) -> str:
    """Compare two cycles of one gain and swing, over all their starts: which of them comes is chosen by the start."""

    def both(name: str) -> tuple[str, str]:
        return late_words(was, name), late_words(now, name)

    travel, error = both("travel_per_hour"), both("mean_square_error")
    spans = [period_words(cycle) for cycle in (was, now)]
    return (
        f"Slower integral action spares the valve and does not shrink the cycle: {fast.name} (Ti "
        f"{given(fast.loop.controller.Ti)} s) cycles every {spans[0]} and moves the valve {travel[0]} % an hour, "
        f"{slow.name} (Ti {given(slow.loop.controller.Ti)} s) every {spans[1]} and {travel[1]} %, but PV swings "
        f"{figure(now.pv_peak_to_peak, 3)} EU all the same. The mean square error, {error[0]} and {error[1]} EU², is a "
        "matter of where the setpoint lies between two positions of the stem."
    )


def _at_best(study: Study) -> list[str]:
    """Say what the best of all measured tunings leave, and that what must be better needs the repair."""
    seen = _measured(study)
    if len(seen) < 2:
        return []
    least, calm = min(seen, key=lambda one: one.swing), min(seen, key=lambda one: one.travel)
    found = study.cycle_map
    many = f"{len(seen)} tunings" if found is None else f"all tunings, {found.count('cycles'):,} of the map among them,"
    text = (
        f"When to repair: of {many} whose cycle was measured here (by medians, where it depends on the start), PV "
        f"swings least, {least.swing_words} EU every {least.period_words}, with {least.where}, at "
        f"{least.travel_words} % of valve travel an hour"
    )
    if calm.where != least.where:
        text += (
            f"; the valve moves least, {calm.travel_words} % an hour, with {calm.where}, where PV swings "
            f"{calm.swing_words} EU every {calm.period_words}"
        )
    end = "What the process or the valve cannot bear of that is a matter of repair, not of tuning."
    if found is None:
        end = "Whether another tuning would do, a map of tunings shows; what none of them does is a matter of repair."
    return [f"{text}. {end}{_rest(study)}"]


def _rest(study: Study) -> str:
    """Name the tunings that come to rest, which the sentence on those that cycle leaves out."""
    found = study.cycle_map
    cells = 0 if found is None else found.count("settles")
    some = [c.name for c in study.cases if c.limit_cycle is not None and c.limit_cycle.outcome == "settles"]
    some += [f"{cells:,} of the map"] if cells else []
    return (
        f" These left out, which come to rest from the start given or from every start tried: {join(some)}."
        if some
        else ""
    )
