"""How sure a recommendation is, from the results alone: a word, its reasons in numbers, and what to watch then.

"high" asks for all of: a test over an ensemble that every draw passes, searches that agree, no knife-edge, a model
whose parameters are known (or given), a run that shows the loop's own cycle. "low" is said of what may well turn out
otherwise: an undecided valve, a plant whose ranges are open or missing, a knife-edge, draws that diverge, a run too
short for the cycle. The rest is "moderate".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from workbench.model.controller import PID
from workbench.model.experiment import Noise
from workbench.model.plant import FOPDT
from workbench.model.results import LimitCycle, Robustness, Standing, Tuned
from workbench.model.site import CascadeSiteCase, SiteCase
from workbench.model.study import CaseResult, Study
from workbench.model.titles import kpi_title, within
from workbench.report.cycles import from_others, off_setpoint, period_words, rest_cause
from workbench.report.estimates import stiction_words
from workbench.report.judge import (
    at_odds,
    base_case,
    late_words,
    measure,
    over_starts,
    quiet,
    run_travel,
    source_of,
    too_short,
    typed_case,
    unstable,
)
from workbench.report.known import known_groups, tuning_doubts, unpinned
from workbench.report.settings import around, settings_words
from workbench.report.standing import standing_doubt
from workbench.report.wear import watch_travel
from workbench.report.words import capital, controller_words, duration, figure, given, interval, join, nearby

__all__ = ["Confidence", "Judged", "confidence", "digits", "recovery", "searches", "settled", "typed_digits", "watch"]

NEARLY = 1.01  # ratio of the worst search's J to the best's up to which it does not matter which of them was lucky
SLOWER = 0.5  # ratio of integral gains below which the controller is said to recover more slowly
UNROUNDED = "before the site's rounding"
FAR = 1.25  # ratio of what runs of one loop give beyond which a change against it says little
STRONGER = 1.5  # ratio of gains above which it is said to pass more noise to the valve


@dataclass(frozen=True, slots=True)
class Confidence:
    """A level ("high", "moderate" or "low"), its reasons, and in short why it is no higher."""

    level: str
    reasons: tuple[str, ...]
    why: str


@dataclass
class Judged:
    """The reasons so far; `doubts` speak for low, `open_points` against high, each in a few words."""

    reasons: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    open_points: list[str] = field(default_factory=list)

    def say(self, text: str, *, doubt: str = "", open_point: str = "") -> None:
        """Add a reason, and in a few words the doubt or the open point that it is."""
        self.reasons.append(f"{text}.")
        self.doubts += [doubt] if doubt else []
        self.open_points += [open_point] if open_point else []


def confidence(study: Study, case: CaseResult) -> Confidence:
    """Return how sure it is that a case does at the plant what it does here."""
    judged = Judged()
    _model(study, case, judged)
    _by_itself(case.standing, judged)
    _by_chance(study, case, judged)
    typed = None if case is base_case(study) else typed_case(study, case)
    if case.tuned is not None and (typed is None or case.tuned.ensemble is not None):
        lead = "Digits" if case.unrounded is None else f"Digits of the search, {UNROUNDED}"
        digits(case.tuned, judged, lead)
    elif typed is not None:
        typed_digits(typed, measure(case), "the mean square error" if case.objective is None else "J", judged)
    if case.tuned is not None:
        searches(case.tuned, judged, rounded=case.unrounded is not None)
    elif case.nearest_to:
        judged.say(
            f"These settings are what comes nearest to {case.nearest_to} in the site's form; none was searched for "
            "among what can be typed in there",
            open_point="no tuning was searched for in the site's form",
        )
    elif all(one.tuned is None for one in study.cases):
        _unsearched(study, case, judged)
    _elsewhere(case.robustness, judged)
    _long_run(study, case, judged)
    return settled(judged, given=source_of(study, case) is None)


def _by_chance(study: Study, case: CaseResult, judged: Judged) -> None:
    """Say of a case and the one as found whose figures rounding decides what other runs of the same loop give."""
    for one in dict.fromkeys(c for c in (base_case(study), case) if c is not None and c.chance):
        runs = (one.run.kpis, *one.chance)
        errors, travels = (sorted(getattr(k, name) for k in runs) for name in ("mean_square_error", "valve_travel"))
        short = f"rounding decides the figures of {one.name}"
        far = max(errors[-1] - FAR * errors[0], travels[-1] - FAR * travels[0]) > 0.0
        judged.say(
            f"{one.name}: rounding decides what its run gives: with Kc changed in the twelfth digit the mean square "
            f"error is {figure(errors[0])} to {figure(errors[-1])} EU², the valve travel {figure(travels[0])} to "
            f"{figure(travels[-1])} %. A longer run tells more",
            doubt=short if far else "",
            open_point="" if far else short,
        )


def _unsearched(study: Study, case: CaseResult, judged: Judged) -> None:
    """Say that a case is the best of the given ones, and what the search for the value of repair has found beside."""
    repair, own = study.repair, case.objective
    if repair is None or own is None or not repair.tuned.status.success:
        judged.say("No tuning was searched for: this is the best of the given ones, and a search may find a better one")
        return
    text = "This is the best of the given tunings; the search for what repairing the valve is worth has found"
    if not repair.best.objective < own:
        judged.say(f"{text} none better")
        return
    judged.say(
        f"{text} a better one for the sticking valve, {controller_words(repair.best.controller, repair.tuned.digits)}: "
        f"J {figure(repair.best.objective)} instead of {figure(own)} in this run. As a case (tune) it would be told "
        "with its long run",
        open_point="a search has found a better tuning than the given ones",
    )


def settled(judged: Judged, *, given: bool) -> Confidence:
    """Return the level that the reasons come to. given: whether the loop is as the scenario gives it."""
    reasons = tuple(judged.reasons)
    against = judged.doubts or judged.open_points
    if not against:
        nothing = "Provided that the loop is as the scenario gives it, nothing" if given else "Nothing"
        return Confidence("high", reasons, f"{nothing} that was looked at speaks against it.")
    return Confidence("low" if judged.doubts else "moderate", reasons, f"{capital(join(against))}.")


def _model(study: Study, case: CaseResult, judged: Judged) -> None:
    named = source_of(study, case)
    if named is None:
        judged.say(
            "The loop is as the scenario gives it: nothing here holds plant and valve against the plant's records"
        )
        return
    found = named.found
    groups = known_groups(found)
    open_ones = [*groups["hardly"], *groups["none"]]
    told = [] if found.verdict == "undecided" else [f"the valve: {stiction_words(named)}"]
    for name in ("gain", "time_constant", "dead_time"):
        pair = getattr(found.intervals, name)
        unit = "s" if name != "gain" else "EU/%" if isinstance(found.plant, FOPDT) else "EU/(% s)"
        if pair is not None:
            told.append(f"{name.replace('_', ' ')} {interval(pair, unit)} (95 % range)")
    # A valve that does not stick has nothing to be identified.
    unknown = found.verdict != "no_stiction" and not found.identifiable
    vague = unknown or bool(open_ones) or bool(groups["roughly"])
    text = f"The loop is an estimate from {named.name}"
    text += f"; {'; '.join(told)}" if told else ""
    if found.verdict == "undecided":
        text += "; whether the valve sticks is undecided"
    elif not found.identifiable and found.verdict == "stiction":
        text += f"; {unpinned(found)}"
    elif open_ones:
        text += f"; hardly known or without a range: {join([within(kpi_title(name)[0]) for name in open_ones])}"
    judged.say(
        text,
        doubt=join(tuning_doubts(found)),
        open_point="the record does not pin every parameter" if vague else "",
    )


def _by_itself(standing: Standing | None, judged: Judged) -> None:
    """Say whether the tuning holds the loop without the valve's stiction, over all that the plant may be."""
    if standing is None:
        return
    worst, lead = standing.worst, "With an ideal valve the loop is"
    if standing.own.stable:
        text = f"{lead} stable, its maximum sensitivity {figure(standing.own.max_sensitivity, 3)}"
        if worst is not None and worst.stable:
            text += f", at most {figure(worst.max_sensitivity, 3)} within the plant's 95 % ranges"
        elif worst is not None:
            text += "; within the plant's 95 % ranges it may be unstable"
    else:
        text = f"{lead} unstable"
    judged.say(text, doubt=standing_doubt(standing))


def digits(tuned: Tuned, judged: Judged, lead: str, whose: str = "the optimum") -> None:
    """Say what the last digits matter."""
    steps = [v for step in tuned.steps for v in (step.below, step.above) if not math.isnan(v)]
    what = "J" if tuned.ensemble is None else "J over the draws of its search"
    text = (
        f"{lead}: the settings have {tuned.digits}; {nearby(tuned.margin)} {what} is at most {figure(tuned.worst)} "
        f"instead of {figure(tuned.objective)}"
    )
    if steps:
        text += f", one unit in a last digit gives at most {figure(max(steps))}"
    judged.say(
        f"{text}, a knife-edge" if tuned.knife_edge else text,
        doubt=f"{whose} is a knife-edge" if tuned.knife_edge else "",
    )


def typed_digits(typed: SiteCase | CascadeSiteCase, own: float, by: str, judged: Judged) -> None:
    """Say what the last digits matter that the site types in, which are not those of a search.

    own: J of what is typed in, or without one the error that `by` names.
    """
    beside = typed.beside
    if beside is None:
        return
    have = "are typed in as given" if beside.digits is None else f"as typed in have {beside.digits}"
    text = (
        f"Digits: the settings {have}; {around(beside)} {by} is at most {figure(beside.worst)} instead of {figure(own)}"
    )
    if not math.isnan(beside.step):
        text += f", one unit in a last digit gives at most {figure(beside.step)}"
    judged.say(
        f"{text}, a knife-edge" if typed.knife_edge else text,
        doubt="the settings as typed in are a knife-edge" if typed.knife_edge else "",
    )


def searches(tuned: Tuned, judged: Judged, lead: str = "Search", *, rounded: bool = False) -> None:
    """Say whether the searches agree. rounded: whether J is told of other settings, those that the site types in."""
    many, best, worst = len(tuned.restarts), *tuned.spread
    if many < 2:
        judged.say(
            f"{lead}: made once, so nothing tells whether another would find better",
            open_point="there was one search only",
        )
        return
    agree = tuned.agreeing
    alike = 2 * agree > many or (math.isfinite(worst) and worst <= NEARLY * best)
    least = min(best, tuned.nominal)
    whose = f" of unrounded settings, {figure(least)}" if rounded and tuned.ensemble is None else ""
    text = f"{lead}: {agree} of {many} independent searches end within 0.1 % of the best J{whose}"
    if math.isfinite(worst) and agree < many and least > 0.0:
        text += f", the worst {figure(100.0 * (worst / least - 1.0), 2)} % above it"
    elif math.isinf(best) and tuned.status.success:
        text += ": none of them keeps the constraints by itself; the search that goes on from all of them does"
    if tuned.worst_bound is not None:
        text += (
            f"; a run in every neighbourhood of the bounds{tuned.asked_from} shows that no settings "
            f"{'' if tuned.constraints is None else 'that keep the constraints '}have a worst J "
            f"below {figure(tuned.worst_bound)} (these: {figure(tuned.worst)})"
        )
        alike = alike or tuned.worst <= NEARLY * tuned.worst_bound
    judged.say(text, open_point="" if alike else "the searches do not agree")


def _elsewhere(r: Robustness | None, judged: Judged) -> None:
    """Say how it fares where plant and circumstances are others."""
    if r is None:
        text = "Other plants and disturbances: not tried, all figures are of this one experiment on this one model"
        judged.say(
            f"{text} (“robust: true” in tune, or “ensemble”, tries them)",
            open_point="it was tried on this model and experiment alone",
        )
        return
    bad = r.diverged > 0 or not r.stable
    many = f"{r.ensemble.draws:,} draws of other plants and circumstances"
    if bad:
        judged.say(
            f"Of {many} {r.diverged:,} diverge{'' if r.stable else ', and a corner plant is unstable'}",
            doubt="it does not hold all plants tried",
        )
        return
    judged.say(
        f"Over {many} none diverges; mean square error {figure(r.mse_median, 3)} EU² (median) to "
        f"{figure(r.mse_p90, 3)} EU² (90th percentile); Ms at the worst corner is {figure(r.max_sensitivity, 3)}"
    )


def _long_run(study: Study, case: CaseResult, judged: Judged) -> None:
    cycle, aside = case.limit_cycle, quiet(study.experiment)
    if cycle is None:
        judged.say(
            "Long run: not asked for; what the loop does after this experiment is open",
            open_point="the long run was not looked at",
        )
        return
    lead = f"Long run ({aside}), by exact simulation: " if aside else "Long run, by exact simulation: "
    if cycle.outcome != "cycles":
        where = off_setpoint(cycle)
        others = from_others(cycle)
        rests = f", {where}, as {rest_cause(cycle)}" if where else ""
        rests += f"; {others}" if others else ""
        told = {
            "settles": f"the loop comes to rest from the start of this experiment{rests}",
            "depends": "the loop cycles or comes to rest, depending on where it starts",
        }.get(cycle.outcome, "whether the loop cycles could not be decided")
        open_points = ["PV comes to rest off its setpoint"] if where else []
        open_points += [] if cycle.outcome == "settles" and not others else ["the long run is not one and the same"]
        judged.say(lead + told, open_point=join(open_points))
        return
    text, doubt, open_point = f"{lead}the loop cycles, {_swing(cycle)}", "", ""
    if too_short(case, study.experiment):
        text += "; this run is too short to show it, and its figures are not those of the loop later on"
        doubt = "the run is too short for the cycle that the loop has in the long run"
    elif at_odds(case, study.experiment):
        rates = (run_travel(case, study.experiment), cycle.travel_per_hour)
        text += "; in the run itself the valve travels {} % an hour instead of {} %".format(
            *(figure(r, 3) for r in rates)
        )
        open_point = "the run shows another motion of the valve than the long run"
    judged.say(text, doubt=doubt, open_point=open_point)


def _longest(cycle: LimitCycle) -> float:
    """How long it takes until the cycle shows, s: the longest of the starts that come to it."""
    return max([cycle.window, *(s.window for s in cycle.starts if s.outcome == "cycles")])


def _swing(cycle: LimitCycle) -> str:
    return f"PV {figure(cycle.pv_peak_to_peak, 3)} EU every {duration(cycle.period)}"


def watch(study: Study, base: CaseResult | None, best: CaseResult) -> list[str]:
    """Return what to watch once a case's settings are in, with the numbers that it should then show.

    base: the case as found, None where none is given. Nothing where it is the one to keep.
    """
    if best is base:
        return []
    out = []
    cycle = best.limit_cycle
    if cycle is not None and cycle.outcome == "cycles":
        most, other = cycle.pv_peak_to_peak, ""
        if " to " in late_words(cycle, "pv_peak_to_peak"):
            most = over_starts(cycle, "pv_peak_to_peak")[1]
            other = f", up to {figure(most, 3)} EU by the start" if most > cycle.pv_peak_to_peak else ""
        text = (
            f"The cycle that remains: {_swing(cycle)} without noise{other}, which took up to "
            f"{duration(_longest(cycle))} to show from the starts tried. A swing well above {figure(most, 3)} EU that "
            "does not come from a disturbance means that the loop is not the one modelled here."
        )
        out.append(text)
    elif cycle is not None and cycle.outcome == "settles":
        out.append(_watch_rest(study, cycle))
    out.append(watch_travel(study, best))
    if base is not None and not unstable(base):
        noise = None if study.experiment is None else study.experiment.noise
        out += recovery(base.loop.controller, best.loop.controller, noise)
        before = settings_words(study, base)
        out.append(f"If PV or valve do worse than before, put back {before} ({base.name}) and look at the model again.")
    return out


def _watch_rest(study: Study, cycle: LimitCycle) -> str:
    """Say which lasting cycle speaks against the model of a loop that comes to rest here: not one of its own."""
    text = f"Here the loop comes to rest ({quiet(study.experiment) or 'from this start'})"
    if others := from_others(cycle):
        swing = figure(over_starts(cycle, "pv_peak_to_peak")[1], 3)
        return (
            f"{text}, but {others} (PV up to {swing} EU every {period_words(cycle)}), so that a cycle may be this "
            f"loop's own, from another start. A swing well above {swing} EU that does not come from a disturbance "
            "means that the loop is not the one modelled here."
        )
    return f"{text}: a lasting cycle means that the loop is not the one modelled."


def recovery(before: PID, after: PID, noise: Noise | None, moves: str = "moves OP by {} %") -> list[str]:
    """Name what new settings do more or less of than those before, by their ideal-form gains.

    moves: what noise does to the output, with a place for by how much.
    """
    was, now = before.ideal_terms(), after.ideal_terms()
    out = []
    slower = now.Kc / now.Ti / (was.Kc / was.Ti) if was.Kc > 0.0 and math.isfinite(was.Ti) else math.nan
    if slower == 0.0:
        out.append("Recovery: without integral action the offset that a disturbance makes stays.")
    elif slower < SLOWER:
        out.append(
            f"Recovery: the integral gain Kc/Ti is {figure(100.0 * slower, 2)} % of what it was, so that PV stays "
            "beside its setpoint for longer after a disturbance."
        )
    stronger = now.Kc / was.Kc if was.Kc > 0.0 else math.nan
    if stronger > STRONGER:
        sd = 1.0 if noise is None or noise.sd == 0.0 else noise.sd
        out.append(
            f"Noise: the gain is {figure(stronger, 2)} times what it was; noise of {given(sd)} EU "
            f"{moves.format(given(now.Kc * sd, 3))}{', and by more through the derivative' if now.Td > 0.0 else ''}. "
            "See that the output does not reach its limits."
        )
    return out
