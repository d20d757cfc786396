"""What the report advises once the cases are compared: which tuning to set, at what price, and what it leaves."""

from __future__ import annotations

from workbench.model.study import CaseResult, Study
from workbench.report.cycles import better_late, by_start, late_errors, late_figures, swing
from workbench.report.judge import at_odds, base_case, best_case, quiet, run_travel, unstable
from workbench.report.plain_truth import lasting
from workbench.report.repair import repair_sentence
from workbench.report.words import change, controller_words, figure, nearby

__all__ = ["case_advice"]

ALIKE = 1.1  # ratio of mean square errors up to which one is hardly more than the other
IDLE = " (its valve never moves: it controls nothing)"


def case_advice(study: Study) -> list[str]:
    """Return which case to set, against which price, what it leaves, and what only repair ends."""
    out = [
        f"Do not use {case.name} as it stands: its search ended as “{case.tuned.status.value}”"
        f"{f' ({case.tuned.message.rstrip(chr(46))})' if case.tuned.message else ''}."
        for case in study.cases
        if case.tuned is not None and not case.tuned.status.success
    ]
    base, best = base_case(study), best_case(study)
    if best is None:
        return out
    if len(study.cases) > 1 and best.objective is None:
        out += _trade_off(study, best)
        out += late_errors(study)
    else:
        if len(study.cases) > 1:
            out += _recommendation(base, best)
        out += _remaining(study, base, best)
        out += _less_wear(study, best)
    out += lasting(study, best)
    if study.repair is not None:
        out.append(repair_sentence(study.repair, (base or study.cases[0]).name))
    if best.tuned is not None:
        out.append(
            "All this holds for this experiment on this model; a plant that differs from the model, or another "
            "disturbance, will give other figures. Watch PV and valve travel after the change."
        )
    return out


def _recommendation(base: CaseResult | None, best: CaseResult) -> list[str]:
    out = []
    controller = controller_words(best.loop.controller, best.tuned.digits if best.tuned is not None else None)
    kpis = best.run.kpis
    by = "J" if best.objective is not None else "mean square error"
    if best is base:
        out.append(f"Keep {best.name} ({controller}): none of the other tunings has a lower {by} in this experiment.")
    elif base is None or unstable(base):
        out.append(
            f"Set {controller} ({best.name}): the lowest {by} of the cases, mean square error "
            f"{figure(kpis.mean_square_error, 3)} EU², valve travel {figure(kpis.valve_travel, 3)} %."
        )
    else:
        was = base.run.kpis
        parts = []
        if best.objective is not None and base.objective is not None:
            parts.append(f"J {figure(best.objective, 3)} instead of {figure(base.objective, 3)}")
        parts.append(f"mean square error {change(kpis.mean_square_error, was.mean_square_error)}")
        parts.append(f"valve travel {change(kpis.valve_travel, was.valve_travel)}")
        out.append(f"Set {controller} ({best.name}): in this run {', '.join(parts)} against {base.name}.")
    if best.tuned is not None:
        tuned = best.tuned
        if tuned.knife_edge:
            out.append(
                f"Type in exactly these digits: the optimum is a knife-edge, {nearby(tuned.margin)} J rises from "
                f"{figure(tuned.objective, 3)} to as much as {figure(tuned.worst, 3)}."
            )
    return out


def _trade_off(study: Study, best: CaseResult) -> list[str]:
    """Without an objective to go by: name the case of least error and the case of least wear."""
    fit = [c for c in study.cases if (c.tuned is None or c.tuned.status.success) and not unstable(c)]
    # A valve that never moves does not wear, and does not control either.
    calm = min([c for c in fit if c.run.kpis.valve_travel > 0.0] or fit, key=lambda c: c.run.kpis.valve_travel)

    def told(case: CaseResult) -> str:
        kpis = case.run.kpis
        return (
            f"{case.name} ({controller_words(case.loop.controller)}), mean square error "
            f"{figure(kpis.mean_square_error, 3)} EU², valve travel {figure(kpis.valve_travel, 3)} %"
            f"{IDLE if kpis.valve_travel == 0.0 else ''}"
        )

    if calm is best:
        return [f"Least error and least wear in this experiment: {told(best)}."]
    choice = "No objective was given, so there is a choice to make."
    text = f"{choice} Least mean square error in this run: {told(best)}. Least wear: {told(calm)}."
    # Hardly more error for far less wear is most often the better choice.
    near = [c for c in fit if c is not calm and _error(c) <= ALIKE * _error(best)]
    mild = min(near, key=lambda c: c.run.kpis.valve_travel)
    if mild.run.kpis.valve_travel < 0.5 * best.run.kpis.valve_travel:
        more = figure(100.0 * (_error(mild) / _error(best) - 1.0), 2)
        travel = figure(mild.run.kpis.valve_travel, 3)
        text += f" {mild.name} has {more} % more error than the least, at valve travel {travel} %."
    return [text]


def _error(case: CaseResult) -> float:
    return case.run.kpis.mean_square_error


def _less_wear(study: Study, best: CaseResult) -> list[str]:
    """Name the calmest other case where it moves the valve less than half as far."""
    others = [c for c in study.cases if c is not best and (c.tuned is None or c.tuned.status.success)]
    # A valve that never moves controls nothing, and wear under a PV that grows without bound is no choice.
    others = [c for c in others if c.run.kpis.valve_travel > 0.0 and not unstable(c)]
    calm = min(others, key=lambda c: c.run.kpis.valve_travel, default=None)
    if calm is None or not calm.run.kpis.valve_travel < 0.5 * best.run.kpis.valve_travel:
        return []
    ours, theirs = calm.run.kpis, best.run.kpis
    return [
        (
            f"Where wear counts more than error: {calm.name} ({controller_words(calm.loop.controller)}) has in this "
            f"run valve travel {figure(ours.valve_travel, 3)} % instead of {figure(theirs.valve_travel, 3)} %, at mean "
            f"square error {figure(ours.mean_square_error, 3)} EU² instead of "
            f"{figure(theirs.mean_square_error, 3)} EU²{_later(calm)}."
        )
    ]


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
        if at_odds(best, study.experiment):
            text += f"; in the run itself the valve travels {figure(run_travel(best, study.experiment), 3)} % an hour"
        out.append(f"{text}; from another start it may still cycle." if loop.valve.slip_jump > 0.0 else f"{text}.")
    return out
