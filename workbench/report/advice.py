"""What the report advises once the cases are compared: which tuning to set, at what price, and what it leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass

from workbench.model.ensemble import Constraints
from workbench.model.results import Repair
from workbench.model.study import CascadeResult, CaseResult, Study
from workbench.report.cycles import (
    better_late,
    by_start,
    from_others,
    late_errors,
    late_figures,
    off_setpoint,
    rest_cause,
    swing,
)
from workbench.report.judge import (
    at_odds,
    base_case,
    best_case,
    measure,
    nominal_only,
    quiet,
    refused,
    run_travel,
    typed_case,
    unstable,
)
from workbench.report.plain_truth import lasting
from workbench.report.repair import repair_sentence
from workbench.report.settings import around, beside_words, settings_words, spread
from workbench.report.standing import held_by_stiction, trap_words
from workbench.report.wear import DEAR, condition, from_rest, rests, wear
from workbench.report.words import change, figure, join, nearby

__all__ = ["Advice", "case_advice", "stays_off", "worth_it"]

ALIKE = 1.1  # ratio of mean square errors up to which one is hardly more than the other
WORTH = 0.95  # ratio of J (or mean square error) above which a change of settings is not worth it,
CALMER = 0.8  # unless the valve's travel falls below this ratio
IDLE = " (its valve never moves: it controls nothing)"


@dataclass(frozen=True, slots=True)
class Advice:
    """What to do: the decision in one sentence, what else there is to do, and what the decision leaves.

    case: the one to set or to keep (of a cascade, both controllers), None where the choice is left open, or there is
    none.
    """

    decision: str
    case: CaseResult | CascadeResult | None = None
    do: tuple[str, ...] = ()
    left: tuple[str, ...] = ()


def case_advice(study: Study) -> Advice:
    """Return which case to set, against which price, what it leaves, and what only repair ends."""
    do: list[str] = []
    left: list[str] = []
    base, best = base_case(study), best_case(study)
    failed = [
        f"Do not use {case.name} as it stands: its search ended as “{case.tuned.status.value}”"
        f"{f' ({case.tuned.message.rstrip(chr(46))})' if case.tuned.message else ''}."
        for case in study.cases
        if case.tuned is not None and not case.tuned.status.success
    ]
    if best is None:
        text = "None of these tunings can be recommended: their loops are unstable, or their searches failed."
        if cliffs := _cliffs(study, best):
            text = "Set none of these tunings: none is meant to be typed in."
        return Advice(text, None, (*failed, *cliffs))
    if all(_idle(case) for case in study.cases):
        text = "This experiment tells nothing of these tunings: neither PV nor a valve moves in it."
        return Advice(text, None, tuple(failed))
    do += _traps(study, best) + _cliffs(study, best)
    if len(study.cases) > 1 and best.objective is None:
        decision, case = _trade_off(study, best), None
        do += late_errors(study)
    else:
        decision, case = _recommendation(study, base, best)
        back = "" if base is None or base is case or held_by_stiction(base.standing) else settings_words(study, base)
        decision = " ".join(text for text in (decision, stays_off(study, case), trap_words(case, back)) if text)
        # What follows is of the case that is to be set, or kept.
        best = case
        do += _exactly(study, base, best)
        left += _remaining(study, base, best)
        do += _rules_with_less(study, best) + (_asked_elsewhere(study, best) or _less_wear(study, best))
    left += lasting(study, best)
    if study.repair is not None:
        left.append(repair_sentence(study))
    return Advice(decision, case, (*failed, *do), tuple(left))


def _idle(case: CaseResult) -> bool:
    """Whether nothing happens in a case's run."""
    kpis = case.run.kpis
    return kpis.mean_square_error == 0.0 and kpis.valve_travel == 0.0 and kpis.controller_travel == 0.0


def stays_off(study: Study, case: CaseResult) -> str:
    """Say which error stays for good with a tuning, and why, "" where none is known to."""
    cycle = case.limit_cycle
    if cycle is None or not (where := off_setpoint(cycle)):
        return ""
    aside = quiet(study.experiment)
    return f"In the long run{f' {aside}' if aside else ''} {case.name} leaves {where}, as {rest_cause(cycle)}."


def _exactly(study: Study, base: CaseResult | None, best: CaseResult) -> list[str]:
    """Say that no digit may be another where settings are a knife-edge: those that the site types in, if it does."""
    typed = typed_case(study, best)
    if typed is not None and best is not base:
        if typed.beside is None or not typed.knife_edge:
            return []
        own, worst, where = measure(best), typed.beside.worst, around(typed.beside)
        what, by = "they are a knife-edge", "J" if best.objective is not None else "the mean square error"
    elif best.tuned is not None and best.tuned.knife_edge:
        own, worst, where = best.tuned.objective, best.tuned.worst, nearby(best.tuned.margin)
        what, by = "the optimum is a knife-edge", "J"
    else:
        return []
    rises = f"{where} {by} rises from {figure(own)} to as much as {figure(worst)}"
    return [f"Type in exactly these digits: {what}, {rises}."]


def _beside(study: Study, base: CaseResult | None, best: CaseResult) -> str:
    """Say what settings beside those typed in give where these are a knife-edge, "" where they are not."""
    typed = typed_case(study, best)
    if typed is None or typed.beside is None or not typed.knife_edge:
        return ""
    was = None if base is None else (base.run.kpis.mean_square_error, base.run.kpis.valve_travel)
    return beside_words(typed.beside, was, "mean square error" if best.objective is None else "J")


def _recommendation(study: Study, base: CaseResult | None, best: CaseResult) -> tuple[str, CaseResult]:
    """Return the decision, and the case that it is about."""
    controller = settings_words(study, best)
    kpis, objective = best.run.kpis, best.objective
    by = "J" if best.objective is not None else "mean square error"
    if len(study.cases) == 1 and best is base:
        return f"Nothing to set: {best.name} ({controller}) is the only tuning here, and none was searched for.", best
    if best is base:
        better = [case for case in study.cases if measure(case) < measure(best)]
        others = "other tunings"
        if any(refused(study, case) or nominal_only(case) for case in better):
            others += " that can be typed in"
        if any(held_by_stiction(case.standing) for case in better):
            others += " that hold the loop without stiction too"
        return f"Keep {best.name} ({controller}): none of the {others} has a lower {by} in this experiment.", best
    if base is None or unstable(base):
        least = "the lowest " + by + " of the cases" if len(study.cases) > 1 else "the best that the search found"
        return (
            f"Set {controller} ({best.name}): {least}, mean square error {figure(kpis.mean_square_error)} EU², "
            f"valve travel {figure(kpis.valve_travel)} %.{_beside(study, None, best)}{_by_repair(study, best)}"
        ), best
    was, before = base.run.kpis, base.objective
    parts = []
    if objective is not None and before is not None:
        parts.append(f"J {figure(objective)} instead of {figure(before)}")
    (name, ours), (_, theirs) = spread(best, kpis), spread(base, was)
    parts.append(f"{name} {change(ours, theirs)}")
    parts.append(f"mean square error {change(kpis.mean_square_error, was.mean_square_error)}")
    parts.append(f"valve travel {change(kpis.valve_travel, was.valve_travel)}")
    told = f"in this run {', '.join(parts)} against {base.name}"
    rest = f".{_beside(study, base, best)}{_in_the_long_run(study, base, best)}"
    worth = worth_it(_gain(study, best), (_cost(base), base.run.kpis.valve_travel))
    if not worth and not held_by_stiction(base.standing):
        return (
            f"Keep {base.name} ({settings_words(study, base)}): nothing here is worth a change. The best other tuning, "
            f"{best.name} ({controller}), has {told}{rest}"
        ), base
    price = condition(study, base, best, _gain(study, best)[1])
    if price:
        told += _otherwise(study, base, best)
    return f"Set {controller} ({best.name}){price}: {told}{rest}{_by_repair(study, best)}", best


def _otherwise(study: Study, base: CaseResult, best: CaseResult) -> str:
    """Return what to do where the best case's valve travel is not acceptable."""
    # What is clearly better than the tuning as found, at half the wear of the best or less.
    dear = wear(study, base, best, _gain(study, best)[1])[0]
    most = DEAR if math.isinf(dear) else dear / DEAR
    fit = [
        c
        for c in study.cases
        if c not in (base, best) and _can_be_set(study, c) and c.run.kpis.valve_travel > 0.0
        if wear(study, base, c, _gain(study, c)[1])[0] <= most and measure(c) < WORTH * measure(base)
    ]
    other = min(fit, key=measure, default=None)
    if other is not None:
        by = "mean square error" if other.objective is None else "J"
        travel, there = wear(study, base, other, _gain(study, other)[1])
        settings = f"{settings_words(study, other)} ({other.name})"
        return f"; otherwise {settings}, {by} {figure(measure(other))} at {figure(travel, 2)} times{there}"
    return "" if held_by_stiction(base.standing) else f"; otherwise keep {settings_words(study, base)}"


def _rules_with_less(study: Study, best: CaseResult) -> list[str]:
    """Tell of the rules that a search goes before although they have a little less J."""
    by = "J" if best.objective is not None else "mean square error"
    return [
        f"{case.name} ({settings_words(study, case)}) has {by} {figure(measure(case))} instead of "
        f"{figure(measure(best))}, at valve travel {figure(case.run.kpis.valve_travel)} % instead of "
        f"{figure(best.run.kpis.valve_travel)} %: a rule that was not asked for it, and hardly better."
        for case in study.cases
        if best.tuned is not None and case.rule is not None and _can_be_set(study, case)
        if measure(case) < measure(best)
    ]


def _in_the_long_run(study: Study, base: CaseResult, best: CaseResult) -> str:
    """Say what becomes of error and wear once the best's cycle has set in, "" where that depends on the start."""
    was, now = base.limit_cycle, best.limit_cycle
    if was is None or now is None or now.outcome != "cycles":
        return ""
    error, travel = was.mean_square_error, was.travel_per_hour
    if rests(study, base):
        error, travel = was.starts[0].rest_error ** 2, 0.0
    elif was.outcome != "cycles" or by_start(was):
        return ""
    if by_start(now):
        return ""
    error_words = from_rest(now.mean_square_error, error, "EU²")
    aside = quiet(study.experiment)
    return (
        f" In the long run{f' {aside}' if aside else ''}: mean square error {error_words}, valve travel "
        f"{from_rest(now.travel_per_hour, travel, '% an hour')}."
    )


def _gain(study: Study, best: CaseResult) -> tuple[float, float]:
    """Return J (mean square error without one) and valve travel to count on: on a knife-edge those beside it."""
    typed, tuned = typed_case(study, best), best.tuned
    if typed is None and tuned is not None and tuned.ensemble is None and tuned.knife_edge:
        return tuned.worst, best.run.kpis.valve_travel
    if typed is None or typed.beside is None or not typed.knife_edge:
        return _cost(best), best.run.kpis.valve_travel
    return typed.beside.worst, typed.beside.kpis.valve_travel


def _cost(case: CaseResult) -> float:
    return _error(case) if case.objective is None else case.objective


def worth_it(best: tuple[float, float], base: tuple[float, float]) -> bool:
    """Return whether the best case gains clearly more than the last digits of the figures, in error or in wear.

    Each is J (the mean square error without one) and the valve's travel.
    """
    return best[0] < WORTH * base[0] or best[1] < CALMER * base[1]


def _by_repair(study: Study, best: CaseResult) -> str:
    """Say what repairing the valve would add to the recommended tuning in the same run, "" where that was not asked.

    J too, where it gains and the error does not, or the other way round.
    """
    if study.repair is None:
        return ""
    repaired = study.repair.best_repaired.kpis
    kpis = best.run.kpis
    (name, left), (_, after) = spread(best, kpis), spread(best, repaired)
    wear = change(repaired.valve_travel, kpis.valve_travel)
    if not after < left:
        text = f" Repairing the valve would bring no less {name} than this in this run (valve travel {wear})"
    elif not after < WORTH * left:
        less = change(after, left)
        text = f" Repairing the valve, and tuning anew, would bring hardly less {name} in this run ({less}, valve "
        text += f"travel {wear})"
    else:
        text = f" Repairing the valve, and tuning anew, would bring a further {change(after, left)} in {name}, travel "
        text += wear
    return f"{text}{_same_tuning(best, after)}{_asked(study.repair, best, gains=after < WORTH * left)}."


def _same_tuning(best: CaseResult, after: float) -> str:
    """Say what repair alone would bring where it leaves clearly less error than with the tuning of least J."""
    if best.repaired is None or held_by_stiction(best.standing):
        return ""
    (_, left), (_, alone) = spread(best, best.run.kpis), spread(best, best.repaired.kpis)
    return f"; without tuning anew {change(alone, left)}" if alone < WORTH * min(after, left) else ""


def _asked(repair: Repair, best: CaseResult, *, gains: bool) -> str:
    """Tell what becomes of J, which the tunings were searched for, where that is not what becomes of the error."""
    was, now = best.objective, repair.best_repaired.objective
    if was is None or not math.isfinite(was) or (now < WORTH * was) == gains:
        return ""
    verb = "gains" if now < WORTH * was else "hardly gains" if now < was else "does not gain"
    return f"; J, which was asked for, {verb}: {figure(now)} instead of {figure(was)}"


def _can_be_set(study: Study, case: CaseResult) -> bool:
    found = (case.tuned is None or case.tuned.status.success) and not nominal_only(case)
    return found and not unstable(case) and not refused(study, case) and not held_by_stiction(case.standing)


def _traps(study: Study, best: CaseResult) -> list[str]:
    """Name the cases that do better than the best and that nothing but the valve's stiction holds."""
    by = "J" if best.objective is not None else "mean square error"
    return [
        f"Do not use {case.name} ({settings_words(study, case)}), whose {by} is {figure(measure(case))} here: with an "
        "ideal valve the loop is unstable, and only stiction holds it. A search with “max_sensitivity” under "
        "“constraints” in tune keeps to tunings that hold the loop by themselves."
        for case in study.cases
        if held_by_stiction(case.standing) and not unstable(case) and measure(case) < measure(best)
    ]


def _cliffs(study: Study, best: CaseResult | None) -> list[str]:
    """Name the least J's own tunings where they do better than the best: they are there to compare with."""
    other = " A search without “nominal: true” finds settings to type in."
    return [
        f"Do not type in {case.name} ({settings_words(study, case)}): it is the least J itself, "
        f"{figure(tuned.objective)}, and {nearby(tuned.margin)} J rises to as much as {figure(tuned.worst)}."
        f"{other if best is None or best.tuned is None else ''}"
        for case in study.cases
        if (tuned := case.tuned) is not None and nominal_only(case) and not unstable(case)
        if best is None or measure(case) < measure(best)
    ]


def _trade_off(study: Study, best: CaseResult) -> str:
    """Without an objective to go by: name the case of least error and the case of least wear."""
    fit = [c for c in study.cases if _can_be_set(study, c)] or [best]
    # A valve that never moves does not wear, and does not control either.
    calm = min([c for c in fit if c.run.kpis.valve_travel > 0.0] or fit, key=lambda c: c.run.kpis.valve_travel)

    def told(case: CaseResult) -> str:
        kpis = case.run.kpis
        return (
            f"{case.name} ({settings_words(study, case)}), mean square error "
            f"{figure(kpis.mean_square_error)} EU², valve travel {figure(kpis.valve_travel)} %"
            f"{IDLE if kpis.valve_travel == 0.0 else ''}"
        )

    if calm is best:
        return f"Least error and least wear in this experiment: {told(best)}."
    choice = "No objective was given, so there is a choice to make."
    text = f"{choice} Least mean square error in this run: {told(best)}. Least wear: {told(calm)}."
    # Hardly more error for far less wear is most often the better choice.
    near = [c for c in fit if c is not calm and _error(c) <= ALIKE * _error(best)]
    mild = min(near, key=lambda c: c.run.kpis.valve_travel)
    if mild.run.kpis.valve_travel < 0.5 * best.run.kpis.valve_travel:
        more = figure(100.0 * (_error(mild) / _error(best) - 1.0), 2)
        travel = figure(mild.run.kpis.valve_travel)
        text += f" {mild.name} has {more} % more error than the least, at valve travel {travel} %."
    return text


def _error(case: CaseResult) -> float:
    return case.run.kpis.mean_square_error


def _less_wear(study: Study, best: CaseResult) -> list[str]:
    """Name the calmest other case where it moves the valve less than half as far."""
    # A valve that never moves controls nothing, and wear under a PV that grows without bound is no choice.
    others = [c for c in study.cases if c is not best and c.run.kpis.valve_travel > 0.0 and _can_be_set(study, c)]
    calm = min(others, key=lambda c: c.run.kpis.valve_travel, default=None)
    if calm is None or not calm.run.kpis.valve_travel < 0.5 * best.run.kpis.valve_travel:
        return []
    ours, theirs = calm.run.kpis, best.run.kpis
    return [
        (
            f"Where wear counts more than error: {calm.name} ({settings_words(study, calm)}) has in this "
            f"run valve travel {figure(ours.valve_travel)} % instead of {figure(theirs.valve_travel)} %, at mean "
            f"square error {figure(ours.mean_square_error)} EU² instead of "
            f"{figure(theirs.mean_square_error)} EU²{_later(calm)}."
        )
    ]


def _asked_elsewhere(study: Study, best: CaseResult) -> list[str]:
    """Name the constraints of another case's tuning that this one does not keep, and that case beside it."""
    for case in study.cases:
        tuned = case.tuned
        # What a robust tuning keeps to holds over its ensemble, not in this run.
        if case is best or tuned is None or tuned.ensemble is not None or tuned.constraints is None:
            continue
        missed = _missed(best, tuned.constraints)
        if missed and tuned.status.success and _can_be_set(study, case):
            ours, theirs = case.run.kpis, best.run.kpis
            return [
                (
                    f"{best.name} does not keep what {case.name} was asked to: it has {join(missed)}. Where that must "
                    f"hold: {case.name} ({settings_words(study, case)}), in this run mean square error "
                    f"{figure(ours.mean_square_error)} EU² instead of {figure(theirs.mean_square_error)} EU², valve "
                    f"travel {figure(ours.valve_travel)} % instead of {figure(theirs.valve_travel)} %{_later(case)}."
                )
            ]
    return []


def _missed(case: CaseResult, asked: Constraints) -> list[str]:
    """Return which constraints a case does not keep in its run and with an ideal valve, in words."""
    margins = (0.0, math.inf, math.inf)
    if case.standing is not None:
        own = case.standing.own
        margins = own.max_sensitivity, own.gain_margin, own.phase_margin
    return asked.missed(margins, case.run.kpis.valve_travel, "valve travel")


def _later(case: CaseResult) -> str:
    """Return what a case's cycle shows once it has set in, "" where it has none."""
    cycle = case.limit_cycle
    if cycle is None or cycle.outcome != "cycles":
        return ""
    return f"; once its cycle has set in, {late_figures(cycle)}{by_start(cycle)}"


def _remaining(study: Study, base: CaseResult | None, best: CaseResult) -> list[str]:
    """Say what the recommended tuning leaves of the cycle."""
    out = []
    cycle, loop = best.limit_cycle, best.loop
    aside = quiet(study.experiment)
    if cycle is not None and cycle.outcome == "cycles":
        text = (
            f"With {best.name} the cycle remains{f' ({aside})' if aside else ''}: {swing(cycle)}, and the valve "
            f"travels {figure(cycle.travel_per_hour, 3)} % an hour"
        )
        if at_odds(best, study.experiment):
            text += f", in the run itself {figure(run_travel(best, study.experiment), 3)} %"
        text += "."
        was = None if base is None or base is best else base.limit_cycle
        if was is not None and base is not None and was.outcome == "cycles":
            text += (
                f" Once it has set in, the mean square error is {late_figures(cycle)}, with {base.name} "
                f"{late_figures(was)}{by_start(cycle, was)}."
            )
        out.append(text)
        out += better_late(study, best, cycle)
    elif cycle is not None and cycle.outcome == "settles":
        text = f"With {best.name} the loop comes to rest in this experiment"
        if aside:
            text = f"With {best.name} the loop comes to rest {aside}"
        if where := off_setpoint(cycle):
            text += f", {where}, as {rest_cause(cycle)}"
        if at_odds(best, study.experiment):
            text += f"; in the run itself the valve travels {figure(run_travel(best, study.experiment), 3)} % an hour"
        may = "from another start it may still cycle" if loop.valve.slip_jump > 0.0 else ""
        out.append("; ".join(part for part in (text, from_others(cycle) or may) if part) + ".")
    return out
