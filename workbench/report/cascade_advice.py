"""What the report advises of a cascade: what to set in both controllers, at what price, how sure, what to watch."""

from __future__ import annotations

import math
from dataclasses import replace

from workbench.model.controller import PID
from workbench.model.study import CascadeResult, Study
from workbench.report.advice import Advice, worth_it
from workbench.report.cascade_settings import cascade_base, cascade_error, cascade_kpis, cascade_typed, cascade_words
from workbench.report.confidence import UNROUNDED, Confidence, Judged, digits, recovery, searches, settled, typed_digits
from workbench.report.judge import at_odds, quiet, run_travel, too_short, unstable
from workbench.report.settings import beside_words
from workbench.report.wear import condition, from_rest, rests, watch_travel
from workbench.report.words import change, duration, figure

__all__ = ["cascade_advice", "cascade_confidence", "cascade_watch"]


def _measure(case: CascadeResult) -> float:
    value = case.run.primary.kpis.mean_square_error if case.objective is None else case.objective
    return value if math.isfinite(value) else math.inf


def _failed(case: CascadeResult) -> str:
    """Return how the search of a case ended where that was no success, "" where it was, or there was none."""
    if case.tuned is None:
        return ""
    every = [one for one in (case.tuned.secondary, case.tuned.primary) if one is not None]
    return next((one.status.value for one in every if not one.status.success), "")


def _refused(study: Study, case: CascadeResult) -> str:
    typed = cascade_typed(study, case)
    return "" if typed is None else typed.refused


def cascade_advice(study: Study) -> Advice:
    """Return which case to set or to keep, and what it leaves."""
    failed = [
        f"Do not use {case.name} as it stands: its search ended as “{_failed(case)}”."
        for case in study.cascade
        if _failed(case)
    ]
    fit = [c for c in study.cascade if not _failed(c) and not unstable(c) and math.isfinite(_measure(c))]
    best = min([c for c in fit if not _refused(study, c)] or fit, key=_measure, default=None)
    if best is None:
        text = "None of these tunings can be recommended: their loops are unstable, or their searches failed."
        return Advice(text, None, tuple(failed))
    if all(_idle(case) for case in study.cascade):
        return Advice("This experiment tells nothing of these tunings: neither PV nor the valve moves in it.")
    decision, case = _decision(study, cascade_base(study), best)
    cannot = [
        f"{other.name} cannot be typed in: the site's form has no equivalent of {_refused(study, other)}. A tuning of "
        "controllers that have the site's form (controller: form) searches among what can be typed in."
        for other in fit
        if _refused(study, other) and (other is case or _measure(other) < _measure(case))
    ]
    do = (*failed, *_less_wear(study, [c for c in fit if not _refused(study, c)], case), *cannot)
    return Advice(decision, case, do, tuple(_remaining(study, cascade_base(study), case)))


def _idle(case: CascadeResult) -> bool:
    """Whether nothing happens in a case's run."""
    both = (case.run.primary.kpis, case.run.secondary.kpis)
    return all(k.mean_square_error == k.valve_travel == k.controller_travel == 0.0 for k in both)


def _less_wear(study: Study, fit: list[CascadeResult], case: CascadeResult) -> list[str]:
    """Name the calmest other case where it moves the valve less than half as far."""
    # A valve that never moves controls nothing.
    others = [(c, *cascade_kpis(c)[:2]) for c in fit if c is not case]
    moving = [one for one in others if one[2].valve_travel > 0.0]
    if not moving:
        return []
    calm, above, below = min(moving, key=lambda one: one[2].valve_travel)
    one, two, _ = cascade_kpis(case)
    if not below.valve_travel < 0.5 * two.valve_travel:
        return []
    cycle = calm.cycle
    later = (
        f"; once its cycle has set in, {figure(cycle.travel_per_hour)} % an hour"
        if cycle is not None and _swing(calm)
        else ""
    )
    settings = f"primary {cascade_words(study, calm, 'primary')}; secondary {cascade_words(study, calm, 'secondary')}"
    text = (
        f"Where wear counts more than error: {calm.name} ({settings}) has in this run valve travel "
        f"{figure(below.valve_travel)} % instead of {figure(two.valve_travel)} %, at mean square error of the primary "
        f"{figure(above.mean_square_error)} EU² instead of {figure(one.mean_square_error)} EU²"
    )
    return [f"{text}{later}."]


def _decision(study: Study, base: CascadeResult | None, best: CascadeResult) -> tuple[str, CascadeResult]:
    """Return the decision, and the case that it is about."""
    by = "J" if best.objective is not None else "mean square error of the primary"
    words = {which: cascade_words(study, best, which) for which in ("primary", "secondary")}
    both = f"primary {words['primary']}; secondary {words['secondary']}"
    if best is base and len(study.cascade) == 1:
        return f"Nothing to set: {best.name} ({both}) is the only tuning here, and none was searched for.", best
    if best is base:
        typed = "" if study.cascade_site is None else " that can be typed in"
        return f"Keep {best.name} ({both}): no other tuning{typed} has a lower {by} in this experiment.", best
    one, two, cost = cascade_kpis(best)
    there, error = cascade_typed(study, best), "mean square error of the primary"
    beside = None if there is None or not there.knife_edge else there.beside
    # The secondary first: the primary's tuning takes it for a part of its plant.
    lead = f"Set the secondary to {words['secondary']}, then the primary to {words['primary']} ({best.name})"
    if base is None or unstable(base):
        figures = f"{error} {figure(one.mean_square_error)} EU²"
        edge = "" if beside is None else beside_words(beside, None, by, error)
        return f"{lead}: the lowest {by}, {figures}, valve travel {figure(two.valve_travel)} %.{edge}", best
    was, wore, before = cascade_kpis(base)
    parts = [] if math.isnan(cost) or math.isnan(before) else [f"J {figure(cost)} instead of {figure(before)}"]
    (name, ours), (_, theirs) = cascade_error(best, one), cascade_error(base, was)
    parts.append(f"{name} {change(ours, theirs)}")
    parts.append(f"its mean square error {change(one.mean_square_error, was.mean_square_error)}")
    parts.append(f"valve travel {change(two.valve_travel, wore.valve_travel)}")
    told, rest = f"in this run {', '.join(parts)} against {base.name}", "."
    gain = _measure(best), two.valve_travel
    if beside is not None:  # what is lost by a digit beside is no gain to count on
        rest += beside_words(beside, (was.mean_square_error, wore.valve_travel), by, error)
        gain = beside.worst, gain[1] if beside.secondary is None else beside.secondary.valve_travel
    rest += _in_the_long_run(study, base, best)
    if not worth_it(gain, (_measure(base), wore.valve_travel)):
        own = "; ".join(f"{which} {cascade_words(study, base, which)}" for which in ("primary", "secondary"))
        text = f"Keep {base.name} ({own}): nothing here is worth a change. The best other tuning, {best.name} ({both}),"
        return f"{text} has {told}{rest}", base
    price = condition(study, base, best, gain[1])
    if price:
        told += f"; otherwise keep {base.name}"
    return f"{lead}{price}: {told}{rest}", best


def _in_the_long_run(study: Study, base: CascadeResult, best: CascadeResult) -> str:
    """Say what becomes of the primary's swing and of wear once the best's cycle has set in, "" where it has none."""
    was, now = base.cycle, best.cycle
    if was is None or now is None or now.primary is None:
        return ""
    before = (0.0, 0.0) if rests(study, base) else None
    if was.primary is not None:
        before = was.primary.pv_peak_to_peak, was.travel_per_hour
    if before is None:
        return ""
    aside = quiet(study.experiment)
    return (
        f" In the long run{f' {aside}' if aside else ''}: swing of the primary's PV "
        f"{from_rest(now.primary.pv_peak_to_peak, before[0], 'EU')}, valve travel "
        f"{from_rest(now.travel_per_hour, before[1], '% an hour')}."
    )


def _swing(case: CascadeResult) -> str:
    """Return a case's cycle in words, "" where it has none."""
    cycle = case.cycle
    if cycle is None or cycle.primary is None or cycle.secondary is None:
        return ""
    return (
        f"PV swings {figure(cycle.primary.pv_peak_to_peak)} EU in the primary and "
        f"{figure(cycle.secondary.pv_peak_to_peak)} EU in the secondary every {duration(cycle.period)}"
    )


def _remaining(study: Study, base: CascadeResult | None, case: CascadeResult) -> list[str]:
    """Say what a case leaves of the cycle, and what ends it."""
    cycle, aside = case.cycle, quiet(study.experiment)
    swing = _swing(case)
    if cycle is None or not swing:
        return []
    text = f"With {case.name} the cycle remains{f' ({aside})' if aside else ''}: {swing}, and the valve travels "
    text += f"{figure(cycle.travel_per_hour)} % an hour"
    if at_odds(case, study.experiment):
        text += f", in the run itself {figure(run_travel(case, study.experiment))} %"
    was = None if base is None or base is case else base.cycle
    if was is not None and was.primary is not None and base is not None:
        text += (
            f". With {base.name} PV of the primary swings {figure(was.primary.pv_peak_to_peak)} EU, and the valve "
            f"travels {figure(was.travel_per_hour)} % an hour"
        )
    out = [f"{text}."]
    if case.run.cascade.secondary.valve.slip_jump > 0.0:
        out.append(
            "While a controller integrates, it hunts for a setpoint between two positions of the stem. Repairing the "
            "valve ends that in both loops; what it is worth, the same scenario with valve: {type: ideal} shows."
        )
    return out


def cascade_confidence(study: Study, case: CascadeResult) -> Confidence:
    """Return how sure it is that a case of a cascade does at the plant what it does here."""
    judged = Judged()
    judged.say(
        "Both loops are as the scenario gives them: nothing here holds plants and valve against the plant's records"
    )
    typed = None if case is cascade_base(study) else cascade_typed(study, case)
    if typed is not None:
        by = "J" if case.objective is not None else "the mean square error of the primary"
        typed_digits(typed, _measure(case), by, judged)
    if case.tuned is not None:
        if case.tuned.secondary is not None:
            before = "" if case.unrounded is None else f", {UNROUNDED}"
            lead = f"Digits of the secondary, tuned by itself{before}"
            digits(case.tuned.secondary, judged, lead, "the secondary's optimum")
            searches(case.tuned.secondary, judged, "Search of the secondary")
        if typed is None:
            digits(case.tuned.primary, judged, "Digits of the primary", "the primary's optimum")
        searches(case.tuned.primary, judged, "Search of the primary", rounded=case.unrounded is not None)
    elif all(one.tuned is None for one in study.cascade):
        judged.say("No tuning was searched for: this is the best of the given ones, and a search may find a better one")
    judged.say(
        "Other plants and disturbances: not tried, all figures are of this one experiment on this one model",
        open_point="it was tried on this model and experiment alone",
    )
    _long_run(study, case, judged)
    return settled(judged, given=True)


def _long_run(study: Study, case: CascadeResult, judged: Judged) -> None:
    cycle, aside = case.cycle, quiet(study.experiment)
    if cycle is None:
        judged.say(
            "Long run: not asked for; what the loops do after this experiment is open",
            open_point="the long run was not looked at",
        )
        return
    lead = f"Long run ({aside}), by exact simulation: " if aside else "Long run, by exact simulation: "
    if not _swing(case):
        judged.say(
            f"{lead}{cycle.reason}",
            open_point="" if cycle.outcome == "settles" else "the long run is not one and the same",
        )
        return
    text, doubt, open_point = f"{lead}both loops cycle; {_swing(case)}", "", ""
    experiment = study.experiment
    if too_short(case, experiment):
        text += "; this run is too short to show it, and its figures are not those of the loops later on"
        doubt = "the run is too short for the cycle that the loops have in the long run"
    elif at_odds(case, experiment):
        rates = (run_travel(case, experiment), cycle.travel_per_hour)
        text += "; in the run itself the valve travels {} % an hour instead of {} %".format(*map(figure, rates))
        open_point = "the run shows another motion of the valve than the long run"
    judged.say(text, doubt=doubt, open_point=open_point)


def _in_eu(primary: PID, scale: float) -> PID:
    """Return a primary whose output is the secondary's setpoint in EU, whatever it puts out."""
    ideal = primary.to_form("ideal")
    return replace(ideal, Kc=abs(scale) * ideal.Kc)


def cascade_watch(study: Study, base: CascadeResult | None, best: CascadeResult) -> list[str]:
    """Return what to watch once a case's settings are in; nothing where it is the one to keep."""
    if best is base:
        return []
    out = []
    cycle = best.cycle
    if cycle is not None and cycle.primary is not None and _swing(best):
        out.append(
            f"The cycle that remains: {_swing(best)}, without noise. A swing of the primary well above "
            f"{figure(cycle.primary.pv_peak_to_peak)} EU that does not come from a disturbance means that the loops "
            "are not those modelled here."
        )
    elif cycle is not None and cycle.outcome == "settles":
        out.append("Here both loops come to rest: a lasting cycle means that the loops are not those modelled.")
    experiment = study.experiment
    out.append(watch_travel(study, best))
    if base is not None and not unstable(base):
        noises = (
            None if experiment is None else experiment.noise,
            getattr(experiment, "secondary_noise", None),
        )
        for which, noise in zip(("primary", "secondary"), noises, strict=True):
            was, now = (getattr(case.run.cascade, which).controller for case in (base, best))
            put = "moves OP by {} %"
            if which == "primary":
                put = "moves the secondary's setpoint by {} EU"
                was, now = (_in_eu(pid, best.run.cascade.scale) for pid in (was, now))
            out += [f"{which.capitalize()}. {text}" for text in recovery(was, now, noise, put)]
        before = "; ".join(f"{which} {cascade_words(study, base, which)}" for which in ("primary", "secondary"))
        out.append(f"If PV or valve do worse than before, put back {before} ({base.name}) and look at the model again.")
    return out
