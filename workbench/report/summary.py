"""The report's summary: sentences composed from the results by rules, never claiming more than the figures say."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.results import LimitCycle
from workbench.model.study import CaseResult, NamedEstimate, Study
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman
from workbench.report.judge import at_odds, on_bounds, over_starts, quiet, run_travel, span_words, unstable
from workbench.report.over_ensemble import robust_advice
from workbench.report.reference import reference_sentences
from workbench.report.repair import repair_sentence
from workbench.report.tables import kpi_title, plant_parameters, valve_parameters
from workbench.report.words import (
    change,
    controller_words,
    duration,
    figure,
    given,
    interval,
    join,
    valve_words,
)

__all__ = ["Summary", "base_case", "best_case", "df_disagrees", "summarise"]

LISTED = 3  # cycling cases that are listed one by one
IDLE = " (its valve never moves: it controls nothing)"
ALONE = "not the valve's alone"
KNIFE_EDGE = 1.05  # worst J near the settings over their own, above which a tuning is called a knife-edge


@dataclass(frozen=True, slots=True)
class Summary:
    """What was found and what to do, sentence by sentence."""

    found: tuple[str, ...]
    do: tuple[str, ...]


def summarise(study: Study) -> Summary:
    """Return a study's summary in words."""
    found: list[str] = []
    do: list[str] = []
    for i, named in enumerate(study.estimates):
        found += estimate_sentences(named, linear=i == 0)
        do += estimate_advice(named)
    if study.cases:
        found += _case_sentences(study)
        do += robust_advice(study) or _case_advice(study)
    return Summary(tuple(found), tuple(dict.fromkeys(do)))


def base_case(study: Study) -> CaseResult | None:
    """Return the case that others are compared with: the first whose tuning was given."""
    return next((c for c in study.cases if c.tuned is None), None)


def _measure(case: CaseResult) -> float:
    value = case.run.kpis.mean_square_error if case.objective is None else case.objective
    return value if math.isfinite(value) else math.inf


def best_case(study: Study) -> CaseResult | None:
    """Return the case of least J (least mean square error without an objective) among those that are verified."""
    fit = [c for c in study.cases if c.tuned is None or c.tuned.status.success]
    fit = [c for c in fit if math.isfinite(_measure(c)) and not unstable(c)]
    return min(fit, key=_measure, default=None)


def df_disagrees(case: CaseResult) -> bool:
    """Return whether describing function and exact simulation give opposite answers on a cycle."""
    df, cycle = case.describing_function, case.limit_cycle
    if df is None or cycle is None or cycle.outcome not in ("cycles", "settles"):
        return False
    if df.predicts_cycle and math.isnan(df.period):
        return False  # unstable crossings alone say what dies out and what grows, not whether a cycle lasts
    return df.predicts_cycle != (cycle.outcome == "cycles")


def _names(cases: list[CaseResult]) -> str:
    return join([c.name for c in cases])


# --- estimates -------------------------------------------------------------------------------------------------


def estimate_sentences(named: NamedEstimate, *, linear: bool = True) -> list[str]:
    """Return what an estimate found: verdict, stiction with its range, plant, identifiability, and the linear fit."""
    found, name = named.found, named.name
    plant = found.plant
    process = f"gain {figure(plant.gain, 3)} {'EU/%' if isinstance(plant, FOPDT) else 'EU/(% s)'}"
    if isinstance(plant, FOPDT):
        process += f", time constant {figure(plant.time_constant, 3)} s"
    process += f", dead time {figure(plant.dead_time, 3)} s"
    reason = found.reasons[0].rstrip(".") if found.reasons else ""
    if found.verdict == "stiction":
        text = f"{name}: the valve sticks, {_stiction(named)}; the process has {process}."
    elif found.verdict == "no_stiction":
        text = f"{name}: no stiction found{f' ({reason})' if reason else ''}; the process has {process}."
    else:
        text = f"{name}: whether the valve sticks stays undecided{f': {reason}' if reason else ''}."
        if not isinstance(found.valve, Ideal):
            text += f" The best model has {_stiction(named)} and {process}; take it as a hint, not as a finding."
    if named.truth is not None:
        text += f" {_against_truth(named, named.truth)}"
    sentences = [text]
    if found.verdict == "stiction" and not isinstance(found.valve, Ideal) and not found.identifiable:
        product = abs(plant.gain) * found.valve.stick_band
        unit = "EU" if isinstance(plant, FOPDT) else "EU/s"
        if found.intervals.d is None and found.intervals.S is None:
            sentences.append(
                f"{name}: the method gives no range for the stiction, so this does not show whether the record pins "
                "the stiction alone or only its product with the gain; the global profile tells."
            )
        else:
            sentences.append(
                f"{name}: the record pins only the product of gain and stiction ({figure(product, 3)} {unit}), not the "
                "stiction alone; a record with a setpoint change in it would resolve that."
            )
    plain = found.linear
    if linear and found.verdict == "stiction":
        left = found.residual_variance
        ratio = plain.residual_variance / left if left > 0.0 else math.inf
        if ratio > 1.05 and isinstance(plain.plant, FOPDT) and isinstance(plant, FOPDT):
            times = f"{figure(ratio, 2)} times" if ratio < 1e4 else "more than 10,000 times"
            sentences.append(
                f"{name}: a fit that ignores the stiction leaves {times} the residual variance, with gain "
                f"{figure(plain.plant.gain, 3)} EU/%, time constant {figure(plain.plant.time_constant, 3)} s and "
                f"dead time {figure(plain.plant.dead_time, 3)} s."
            )
    return sentences


def _against_truth(named: NamedEstimate, truth: Loop) -> str:
    """Say how far the worst parameter of a simulated record's estimate lies from the truth."""
    found = named.found
    ours = dict(valve_parameters(found.valve)) | plant_parameters(found.plant)
    true = dict(valve_parameters(truth.valve)) | plant_parameters(truth.plant)
    if isinstance(found.valve, Ideal) != isinstance(truth.valve, Ideal):
        return f"This is wrong: the record was simulated with {valve_words(truth.valve)}."
    if ours.keys() != true.keys():
        return f"The record was simulated from another kind of loop ({valve_words(truth.valve)})."
    # A true dead time of 0 has no relative error: it is judged in samples.
    errors = {name: abs(ours[name] - true[name]) / (abs(true[name]) or found.record.sample_time) for name in true}
    worst = max(errors, key=lambda name: errors[name])
    title = re.sub(r" \w$", "", kpi_title(worst)[0]).lower()
    if errors[worst] < 1e-4:
        return "Every parameter is true to 0.01 %."
    miss = figure(100.0 * errors[worst], 2)
    if errors[worst] <= 0.1:
        return f"Every parameter lies within {miss} % of the true one."
    return f"This is wrong by {miss} % in the {title} (true value {given(true[worst])})."


def _stiction(named: NamedEstimate) -> str:
    valve, ranges = named.found.valve, named.found.intervals
    # Of an undecided valve the range is the fit's own, and no statement about the valve.
    span = "fits from" if named.found.verdict == "undecided" else "95 % range"

    def with_range(name: str, value: float, pair: tuple[float, float] | None) -> str:
        text = f"{name} = {figure(value, 3)} %"
        return text if pair is None else f"{text} ({span} {interval(pair, '%', 3)})"

    if isinstance(valve, Stenman):
        return with_range("d", valve.d, ranges.d)
    if isinstance(valve, Choudhury):
        return f"{with_range('S', valve.S, ranges.S)}, {with_range('J', valve.J, ranges.J)}"
    if isinstance(valve, Deadband):
        return with_range("dead band", valve.b, ranges.S)
    return "no stiction"


def estimate_advice(named: NamedEstimate) -> list[str]:
    """Return what to do about an estimate of a plant's own record; a simulated record asks for nothing."""
    found = named.found
    if named.truth is not None:
        return []
    if found.verdict == "stiction":
        step = abs(found.plant.gain) * found.valve.slip_jump if isinstance(found.plant, FOPDT) else 0.0
        text = f"{named.name}: have the valve looked at (packing, actuator, positioner)."
        if step > 0.0:
            text += f" As long as it sticks it moves PV in steps of at least {given(step, 3)} EU, whatever the tuning."
        return [text]
    if found.verdict == "no_stiction":
        return [f"{named.name}: if the loop oscillates, look for another cause: tight tuning, or a disturbance."]
    return [
        f"{named.name}: before acting, take a longer record, with a setpoint change of several per cent of OP in it."
    ]


# --- cases -----------------------------------------------------------------------------------------------------


def _swing(cycle: LimitCycle) -> str:
    return f"PV swings {figure(cycle.pv_peak_to_peak, 3)} EU every {duration(cycle.period)}"


def _case_sentences(study: Study) -> list[str]:
    out: list[str] = []
    wild = [c for c in study.cases if unstable(c)]
    aside = quiet(study.experiment)
    if wild:
        out.append(f"{_names(wild)}: the loop is unstable, PV grows without bound.")
    seen = [(c, c.limit_cycle) for c in study.cases if c.limit_cycle is not None]
    cycling = [(c, cycle) for c, cycle in seen if cycle.outcome == "cycles"]
    if cycling:
        lead = f"{len(cycling)} of {len(seen)} tunings keep the loop cycling"
        if len(cycling) == len(seen):
            every = "both" if len(seen) == 2 else f"all {len(seen)}"
            lead = "the loop keeps cycling" if len(seen) == 1 else f"{every} tunings keep the loop cycling"
        lead = _capital(f"{aside}, {lead}" if aside else lead)
        ranked = sorted(cycling, key=lambda pair: pair[1].pv_peak_to_peak)
        if len(cycling) <= LISTED:
            out.append(f"{lead}: {'; '.join(f'{c.name} ({_swing(cycle)})' for c, cycle in cycling)}.")
        else:
            least, most = (f"{_swing(cycle)} ({c.name})" for c, cycle in (ranked[0], ranked[-1]))
            out.append(f"{lead}; at the least {least}, at the most {most}.")
    for outcome, text in (
        ("settles", "comes to rest"),
        ("depends", "cycles or comes to rest depending on where it starts"),
        ("undecided", "could not be decided by simulation"),
    ):
        some = [c for c, cycle in seen if cycle.outcome == outcome and c not in wild]
        if some:
            out.append(f"{_names(some)}: {aside} the loop {text}." if aside else f"{_names(some)}: the loop {text}.")
    out += _noisy_sentences(study)
    out += _tuning_alone(cycling)
    out += _late_sentences(study, cycling)
    out += _agreement_sentences(study)
    out += reference_sentences(study)
    out += [
        f"{c.name}: the search ended with {join(on_bounds(c.tuned))}; a better tuning may lie beyond."
        for c in study.cases
        if c.tuned is not None and on_bounds(c.tuned)
    ]
    return out


def _noisy_sentences(study: Study) -> list[str]:
    """Name the cases whose own run, with its noise or load, contradicts the verdict without."""
    told = []
    for case in study.cases:
        cycle = case.limit_cycle
        if cycle is None or not at_odds(case, study.experiment):
            continue
        rate = figure(run_travel(case, study.experiment), 3)
        text = f"{case.name}: the run itself shows otherwise, late in it the valve"
        if cycle.outcome == "settles":
            told.append(f"{text} keeps moving, by {rate} % an hour.")
        else:
            told.append(f"{text} travels {rate} % an hour, not {figure(cycle.travel_per_hour, 3)} %.")
    return told


def _tuning_alone(cycling: list[tuple[CaseResult, LimitCycle]]) -> list[str]:
    """Name the cycling cases whose loop would be unstable without any stiction."""
    some = [
        c
        for c, _ in cycling
        if c.describing_function is not None
        and not c.describing_function.linear_stable
        and not (df_disagrees(c) and ALONE in c.agreement)
    ]
    if not some:
        return []
    whose = "its cycle is" if len(some) == 1 else "their cycles are"
    return [f"{_names(some)}: the loop would be unstable with an ideal valve too, so {whose} {ALONE}."]


def _late_sentences(study: Study, cycling: list[tuple[CaseResult, LimitCycle]]) -> list[str]:
    """Name the cases whose cycle the run is too short to show: their figures are flattered."""
    if study.experiment is None:
        return []
    late = [c for c, cycle in cycling if cycle.window > study.experiment.duration]
    if not late:
        return []
    whose = "its figures in the table do" if len(late) == 1 else "their figures in the table do"
    return [
        (
            f"The run of {duration(study.experiment.duration)} is too short to show the cycle of {_names(late)}: "
            f"{whose} not contain it."
        )
    ]


def _agreement_sentences(study: Study) -> list[str]:
    """Say where describing function and exact simulation disagree on whether the loop cycles."""
    out = []
    wrong = [c for c in study.cases if df_disagrees(c)]
    for sentence in dict.fromkeys(c.agreement for c in wrong):
        owners = _names([c for c in wrong if c.agreement == sentence])
        if sentence:
            out.append(f"{owners}: {lower_first(sentence)}")
        else:
            out.append(f"{owners}: the describing function is wrong about the cycle; the exact simulation is right.")
    return out


def _case_advice(study: Study) -> list[str]:
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
        out += _late_errors(study)
    else:
        if len(study.cases) > 1:
            out += _recommendation(base, best)
        out += _remaining(study, base, best)
        out += _less_wear(study, best)
    out += _lasting(study, best)
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
        out.append(f"Set {controller} ({best.name}): {', '.join(parts)} against {base.name}.")
    if best.tuned is not None:
        tuned = best.tuned
        within = f"within ±{figure(100.0 * tuned.margin, 2)} % of these settings"
        if tuned.worst > KNIFE_EDGE * tuned.objective:
            out.append(
                f"Type in exactly these digits: the optimum is a knife-edge, {within} J rises from "
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
    return [f"{choice} Least mean square error: {told(best)}. Least wear: {told(calm)}."]


def _late_errors(study: Study) -> list[str]:
    """Compare the cases once their cycles have set in, which one run may not show."""
    late = [(c, c.limit_cycle) for c in study.cases if c.limit_cycle and c.limit_cycle.outcome == "cycles"]
    if len(late) < 2:
        return []
    late = sorted(late, key=lambda pair: over_starts(pair[1], "mean_square_error")[1])
    if len(late) > LISTED:
        late = [late[0], late[-1]]
    told = [
        f"{c.name} {span_words(over_starts(cycle, 'mean_square_error'))} EU² and "
        f"{span_words(over_starts(cycle, 'travel_per_hour'))} %"
        for c, cycle in late
    ]
    aside = quiet(study.experiment)
    when = f"once the cycle has set in, {aside}" if aside else "once the cycle has set in"
    return [f"Mean square error and valve travel an hour {when} (a range: it depends on the start): {'; '.join(told)}."]


def _less_wear(study: Study, best: CaseResult) -> list[str]:
    """Name the calmest other case where it moves the valve less than half as far."""
    others = [c for c in study.cases if c is not best and (c.tuned is None or c.tuned.status.success)]
    others = [c for c in others if c.run.kpis.valve_travel > 0.0]  # a valve that never moves controls nothing
    calm = min(others, key=lambda c: c.run.kpis.valve_travel, default=None)
    if calm is None or not calm.run.kpis.valve_travel < 0.5 * best.run.kpis.valve_travel:
        return []
    ours, theirs = calm.run.kpis, best.run.kpis
    return [
        (
            f"Where wear counts more than error: {calm.name} ({controller_words(calm.loop.controller)}) has valve "
            f"travel {figure(ours.valve_travel, 3)} % instead of {figure(theirs.valve_travel, 3)} %, at mean square "
            f"error {figure(ours.mean_square_error, 3)} EU² instead of {figure(theirs.mean_square_error, 3)} EU²."
        )
    ]


def _remaining(study: Study, base: CaseResult | None, best: CaseResult) -> list[str]:
    """Say what the recommended tuning leaves of the cycle."""
    out = []
    cycle, loop = best.limit_cycle, best.loop
    aside = quiet(study.experiment)
    if cycle is not None and cycle.outcome == "cycles":
        text = (
            f"With {best.name} the cycle remains{f' ({aside})' if aside else ''}: {_swing(cycle)}, and the valve "
            f"travels {figure(cycle.travel_per_hour, 3)} % an hour"
        )
        if at_odds(best, study.experiment):
            text += f", in the run itself {figure(run_travel(best, study.experiment), 3)} %"
        text += "."
        was = None if base is None or base is best else base.limit_cycle
        if was is not None and base is not None and was.outcome == "cycles":
            text += (
                f" Once it has set in, the mean square error is {figure(cycle.mean_square_error, 3)} EU², with "
                f"{base.name} {figure(was.mean_square_error, 3)} EU² at {figure(was.travel_per_hour, 3)} % an hour."
            )
        out.append(text)
        out += _better_late(study, best, cycle)
    elif cycle is not None and cycle.outcome == "settles":
        text = f"With {best.name} the loop comes to rest in this experiment"
        if aside:
            text = f"With {best.name} the loop comes to rest {aside}"
        if at_odds(best, study.experiment):
            text += f"; in the run itself the valve travels {figure(run_travel(best, study.experiment), 3)} % an hour"
        out.append(f"{text}; from another start it may still cycle." if loop.valve.slip_jump > 0.0 else f"{text}.")
    return out


def _lasting(study: Study, best: CaseResult) -> list[str]:
    """Say what no tuning removes while the controller integrates, but not of a valve whose stiction is undecided."""
    out: list[str] = []
    if any(e.found.verdict == "undecided" and e.found.valve == best.loop.valve for e in study.estimates):
        return out
    cycle, loop = best.limit_cycle, best.loop
    stuck = cycle is None or cycle.outcome != "settles"
    if stuck and loop.valve.slip_jump > 0.0 and math.isfinite(loop.controller.Ti) and isinstance(loop.plant, FOPDT):
        step = abs(loop.plant.gain) * loop.valve.slip_jump
        out.append(
            f"What no tuning removes: this valve moves in steps of at least {given(loop.valve.slip_jump, 3)} %, which "
            f"is {given(step, 3)} EU of PV. While the controller integrates, it hunts for a setpoint between two "
            "steps, the more slowly the weaker the integral action. Repairing the valve ends that; an integral dead "
            "band stops it at the price of a lasting offset."
        )
    return out


def _better_late(study: Study, best: CaseResult, cycle: LimitCycle) -> list[str]:
    """Name a case that does clearly better than the recommended one once the cycles have set in."""
    others = [
        (c, over_starts(c.limit_cycle, "mean_square_error"))
        for c in study.cases
        if c is not best and c.limit_cycle is not None and c.limit_cycle.outcome == "cycles"
    ]
    ours = over_starts(cycle, "mean_square_error")
    other, error = min(others, key=lambda pair: pair[1][1], default=(best, (math.inf, math.inf)))
    # Which of its cycles a slow loop falls into is chosen by the start: only what holds for all of them is a claim.
    if not error[1] < 0.8 * ours[0]:
        return []
    when = quiet(study.experiment) or "without disturbances"
    return [
        (
            f"In the long run {when} {other.name} has a smaller error in its cycle, from every start tried "
            f"({span_words(error)} EU² against {span_words(ours)} EU²); the recommendation goes by "
            "the run of this experiment."
        )
    ]


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def lower_first(sentence: str) -> str:
    """Return a sentence to stand after a colon: its first word in lower case, unless it is a name or symbol."""
    first = sentence.split(" ", 1)[0]
    return sentence[:1].lower() + sentence[1:] if first in ("The", "Both", "It", "Neither", "A", "No") else sentence
