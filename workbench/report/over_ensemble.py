"""What holds over an ensemble of circumstances and plants, as the report tells it: tables, words, the advice."""

from __future__ import annotations

import math

from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.front import Front, FrontPoint
from workbench.model.plant import FOPDT
from workbench.model.results import Robustness, Tuned
from workbench.model.study import CaseResult, Study
from workbench.report.judge import over_budget
from workbench.report.repair import robust_repair_text
from workbench.report.settings import settings_words
from workbench.report.tables import Cell, Row, Table
from workbench.report.trade import NamedPoint
from workbench.report.words import change, controller_words, duration, figure, given, join

__all__ = [
    "ensemble_tables",
    "ensemble_text",
    "front_table",
    "front_text",
    "named_points",
    "robust_advice",
    "robust_choice",
]

NEAR = 1.1  # times the front's error, up to which a case lies on it
LISTED = 10  # points of the front in its table
DEAR = 2.0  # times the travel as found from which the decision names the calmer tuning beside it


def ensemble_text(study: Study) -> list[str]:
    """Return what the cases were measured in, and what each robust tuning was asked, sentence by sentence."""
    first = next((c.robustness for c in study.cases if c.robustness is not None), None)
    if first is None:
        return []
    seen = f"{first.ensemble.draws:,} draws, the same for every tuning, and none that a search has seen."
    text = [f"{seen} {ensemble_words(first.ensemble, first.loop.plant)}"]
    for case in study.cases:
        tuned = case.tuned
        if tuned is None or tuned.ensemble is None:
            continue
        what = {"mean": "mean", "cvar": f"mean over the worst {figure(100 * (1 - tuned.ensemble.level), 2)} %"}
        least = what.get(tuned.ensemble.statistic, f"{given(tuned.ensemble.level)} quantile")
        other = (
            ""
            if _same(tuned.ensemble, first.ensemble)
            else f" of its own ensemble ({ensemble_words(tuned.ensemble, first.loop.plant, short=True)})"
        )
        kept = constraint_words(tuned.constraints)
        text.append(
            f"{case.name}: the least {least} of J over {tuned.ensemble.draws:,} draws{other}, with every corner of the "
            f"plant's uncertainty stable{f', {kept}' if kept else ''}.{over_budget(case)}"
        )
    return text


def _same(one: Ensemble, other: Ensemble) -> bool:
    names = [n for n in one.__dataclass_fields__ if n not in ("draws", "seed", "statistic", "level")]
    return all(getattr(one, name) == getattr(other, name) for name in names)


def ensemble_words(ensemble: Ensemble, plant: object, *, short: bool = False) -> str:
    """Return an ensemble in words."""

    def span(pair: tuple[float, float], unit: str) -> str:
        low, high = pair
        return f"{given(low)} {unit}" if low == high else f"{given(low)} to {given(high)} {unit}"

    parts = []
    if ensemble.setpoint[1] > 0.0:
        parts.append(f"a setpoint step of {span(ensemble.setpoint, 'EU')}, up or down, at 0 s")
    if ensemble.load[1] > 0.0:
        parts.append(f"a load step of {span(ensemble.load, '%')}, up or down, at {span(ensemble.load_time, 's')}")
    if ensemble.noise[1] > 0.0:
        parts.append(f"noise of standard deviation {span(ensemble.noise, 'EU')}")
    if ensemble.stem_offset > 0.0:
        share = "" if ensemble.stem_offset == 1.0 else f"{given(100.0 * ensemble.stem_offset)} % of "
        parts.append(f"the stem at first anywhere within {share}what the valve holds")
    sizes: dict[float, list[str]] = {}
    for name, size in (
        ("gain", ensemble.gain),
        ("time constant", ensemble.time_constant if isinstance(plant, FOPDT) else 0.0),
        ("dead time", ensemble.dead_time),
        ("stiction", ensemble.stiction),
    ):
        if size > 0.0:
            sizes.setdefault(size, []).append(name)
    if sizes:
        parts.append(join([f"{join(names)} off by up to {given(100.0 * size)} %" for size, names in sizes.items()]))
    told = "; ".join([f"{given(ensemble.duration)} s from rest", *parts])
    return told if short else f"Each: {told}. Every quantity is uniform and independent."


def constraint_words(asked: Constraints | None) -> str:
    """Return constraints in words: "Ms at most 2 at the worst of these corners", or nothing."""
    if asked is None:
        return ""
    parts = []
    if asked.max_sensitivity is not None:
        parts.append(f"maximum sensitivity Ms at most {given(asked.max_sensitivity)}")
    if asked.gain_margin is not None:
        parts.append(f"gain margin at least {given(asked.gain_margin)}")
    if asked.phase_margin is not None:
        parts.append(f"phase margin at least {given(asked.phase_margin)}°")
    worst = f"{join(parts)} at the worst of these corners" if parts else ""
    if asked.valve_travel is None:
        return worst
    cap = f"mean valve travel at most {figure(asked.valve_travel, 3)} %"
    return f"{worst}, {cap}" if worst else cap


def ensemble_tables(study: Study) -> list[Table]:
    """Return every case over the ensemble: figures down would be too wide, so cases down and figures across."""
    some = [c for c in study.cases if c.robustness is not None]
    if not some:
        return []
    # A repaired valve has no place in the figures of one that does not stick.
    both = all(c.robustness_repaired is not None for c in some)
    heads = [
        "Mean square error, EU²: median",
        "90th percentile",
        "mean",
        "Valve travel, %: median",
        "mean",
        "Ms at the worst corner",
        "Gain, phase margin there",
        "Draws that diverge",
    ]
    if both:
        heads += ["Repaired: mean square error, median", "valve travel, median"]
    asked = _asked(study)
    steady = [r for c in some for r in (c.robustness,) if r is not None and held(r) and not _broken(r, asked)]
    least = min((r.mse_mean for r in steady), default=math.nan)
    rows = []
    for case in some:
        r = case.robustness
        if r is None:
            continue
        best = r in steady and r.mse_mean == least
        margins = f"{_ratio(r.gain_margin)}, {figure(r.phase_margin, 3)}°" if r.stable else "unstable"
        cells = [
            Cell(figure(r.mse_median, 3), best=best),
            Cell(figure(r.mse_p90, 3), best=best),
            Cell(figure(r.mse_mean, 3), best=best),
            Cell(figure(r.travel_median, 3)),
            Cell(figure(r.travel_mean, 3)),
            Cell(figure(r.max_sensitivity, 3)),
            Cell(margins),
            Cell(f"{r.diverged:,} of {r.ensemble.draws:,}" if r.diverged else "none"),
        ]
        if case.robustness_repaired is not None and both:
            other = case.robustness_repaired
            cells += [Cell(figure(other.mse_median, 3)), Cell(figure(other.travel_median, 3))]
        rows.append(Row(case.name, "", tuple(cells), group=case.tuned is not None and case is _first_tuned(study)))
    return [Table(tuple(heads), tuple(rows))]


def _asked(study: Study) -> Constraints:
    """Return what the cases are held to: the constraints of the trade-off, else of the first robust tuning."""
    if study.front is not None:
        return study.front.constraints
    return next((c.tuned.constraints for c in study.cases if c.tuned and c.tuned.constraints), Constraints())


def _ratio(value: float) -> str:
    return "no limit" if math.isinf(value) else figure(value, 3)


def held(r: Robustness) -> bool:
    """Return whether every corner plant is stable and no draw diverges."""
    return r.stable and r.diverged == 0


def _first_tuned(study: Study) -> CaseResult | None:
    return next((c for c in study.cases if c.tuned is not None), None)


# --- the trade-off ---------------------------------------------------------------------------------------------


def named_points(study: Study) -> list[NamedPoint]:
    """Return the cases as points of the figure."""
    return [
        NamedPoint(c.name, c.robustness.travel_mean, c.robustness.mse_mean, c.tuned is not None)
        for c in study.cases
        if c.robustness is not None
    ]


def front_table(front: Front) -> Table:
    """Return some points of the front, by travel, each with what a repaired valve reaches at equal travel."""
    points = front.sticky
    count = min(LISTED, len(points))
    chosen = sorted({round(i * (len(points) - 1) / max(count - 1, 1)) for i in range(count)})
    rows = []
    for i in chosen:
        point = points[i]
        cells = [
            Cell(figure(point.mean_square_error, 3)),
            Cell(controller_words(point.controller, front.digits)),
        ]
        if front.repaired:
            other = front.at(point.valve_travel, repaired=True)
            cells += (
                [Cell("–"), Cell("–")]
                if other is None
                else [Cell(figure(other.mean_square_error, 3)), Cell(controller_words(other.controller, front.digits))]
            )
        rows.append(Row(figure(point.valve_travel, 3), "%", tuple(cells)))
    heads = ["Mean square error, EU²", "Settings"]
    if front.repaired:
        heads += ["Repaired: mean square error, EU²", "Settings for the repaired valve"]
    return Table(tuple(heads), tuple(rows))


def front_text(study: Study) -> list[str]:
    """Return the trade-off in words: where each case lies against the front, and what the ends of the dial are."""
    front = study.front
    if front is None:
        return []
    text = []
    if not front.status.success:
        text.append(f"The search for the trade-off ended as “{front.status.value}”: {front.message}.")
    if not front.sticky:
        return text
    kept = constraint_words(front.constraints).replace("these corners", "the plant's corners")
    calm, brisk = front.sticky[0], front.sticky[-1]
    text.append(
        "Each point of a line is a tuning for which none was found with less error at no more valve travel"
        f"{f', with {kept}' if kept else ''}. With the valve as it is the error can be chosen from "
        f"{figure(calm.mean_square_error, 3)} EU² at {figure(calm.valve_travel, 3)} % of travel to "
        f"{figure(brisk.mean_square_error, 3)} EU² at {figure(brisk.valve_travel, 3)} %."
    )
    text += _noisy(front)
    above, near, beyond = [], [], []
    for case in study.cases:
        r = case.robustness
        if r is None:
            continue
        point = front.at(r.travel_mean)
        if r.diverged or not r.stable:
            text.append(f"{case.name} does not hold every plant of the ensemble and is no choice.")
        elif point is None:
            beyond.append(f"{case.name} moves the valve less than any tuning on the front")
        elif r.mse_mean > NEAR * point.mean_square_error:
            above.append((r.mse_mean / point.mean_square_error, case, point))
        elif not _broken(r, front.constraints):
            near.append(case.name)
        else:
            beyond.append(f"{case.name} is not on it: {_broken(r, front.constraints)}")
    text += [_above(ratio, case, point, front) for ratio, case, point in sorted(above, key=lambda a: -a[0])]
    if near:
        verb = "lies" if len(near) == 1 else "lie"
        text.append(f"{join(near)} {verb} on the front, or within {100.0 * (NEAR - 1.0):.0f} % of its error.")
    text += [f"{words}." for words in beyond]
    return text


def _noisy(front: Front) -> list[str]:
    """Explain a repaired valve that travels further for the same error: what looks wrong is the noise."""
    worse = 0
    for point in front.sticky:
        other = front.at(point.valve_travel, repaired=True)
        worse += other is None or other.mean_square_error > point.mean_square_error
    if not front.repaired or front.fresh.noise[1] == 0.0 or worse <= len(front.sticky) // 2:
        return []
    last = front.repaired[-1]
    text = (
        "For most of the line the repaired valve travels further for the same error: it follows the measurement noise, "
        f"which a sticking stem ignores. Its least error is {figure(last.mean_square_error, 3)} EU², at "
        f"{figure(last.valve_travel, 3)} % of travel. Filter PV before judging its wear."
    )
    return [text]


def _broken(r: Robustness, asked: Constraints) -> str:
    """Return which margin a case misses at the worst corner, in words, or nothing."""
    if asked.max_sensitivity is not None and r.max_sensitivity > asked.max_sensitivity:
        return (
            f"its Ms reaches {figure(r.max_sensitivity, 3)} at the worst corner, above {given(asked.max_sensitivity)}"
        )
    if asked.gain_margin is not None and r.gain_margin < asked.gain_margin:
        return (
            f"its gain margin falls to {figure(r.gain_margin, 3)} at the worst corner, below {given(asked.gain_margin)}"
        )
    if asked.phase_margin is not None and r.phase_margin < asked.phase_margin:
        least = given(asked.phase_margin)
        return f"its phase margin falls to {figure(r.phase_margin, 3)}° at the worst corner, below {least}°"
    return ""


def _above(ratio: float, case: CaseResult, point: FrontPoint, front: Front) -> str:
    return (
        f"{case.name} has {figure(ratio, 2)} times the error of the tuning with equal travel: "
        f"{controller_words(point.controller, front.digits)}."
    )


def _beside(case: CaseResult, its: Robustness, r: Robustness, asked: Constraints) -> str:
    """Say why a case with less error than the recommended one is not the one to take, or nothing."""
    if not its.mse_mean < r.mse_mean or not held(its) or not _broken(its, asked):
        return ""
    return (
        f"{case.name} has less error ({figure(its.mse_mean, 3)} EU²) at valve travel {figure(its.travel_mean, 3)} %, "
        f"but {_broken(its, asked)}: take it only where the plant is known better than this ensemble says."
    )


def _only_here(other: CaseResult, case: CaseResult) -> str:
    """Name a given case that does better than the recommended one in the experiment, and not over the ensemble."""
    a, b = other.robustness, case.robustness
    if a is None or b is None or other.objective is None or case.objective is None:
        return ""
    if not other.objective < case.objective or not b.mse_mean < a.mse_mean:
        return ""
    return (
        f"{other.name} does better in this one experiment (J {figure(other.objective)} against "
        f"{figure(case.objective)}), and worse over the ensemble: mean square error {figure(a.mse_mean, 3)} EU² at "
        f"valve travel {figure(a.travel_mean, 3)} %."
    )


# --- advice ----------------------------------------------------------------------------------------------------


def _robust(study: Study) -> list[tuple[CaseResult, Tuned, Robustness]]:
    """Return the robust tunings with their figures; in place of what the site's form cannot take what is nearest."""
    near = {c.nearest_to: c for c in study.cases if c.nearest_to}
    found = []
    for case in study.cases:
        tuned = case.tuned
        if tuned is None or tuned.ensemble is None or not tuned.status.success:
            continue
        own = near.get(case.name, case)
        if own.robustness is not None:
            found.append((own, tuned, own.robustness))
    return found


def robust_choice(study: Study) -> CaseResult | None:
    """Return the robust tuning of least mean square error, one without a cap on travel if there is any, or None."""
    found = _robust(study)
    free = [one for one in found if one[1].constraints is None or one[1].constraints.valve_travel is None]
    return min(free or found, key=lambda one: one[2].mse_mean, default=(None,))[0]


def robust_advice(study: Study) -> list[str]:
    """Return what to do where a robust tuning was found, else nothing: it goes before what one experiment says.

    The first sentence says what to set.
    """
    found = _robust(study)
    choice = robust_choice(study)
    if choice is None:
        return []
    case, tuned, r = next(one for one in found if one[0] is choice)
    base = next((c for c in study.cases if c.tuned is None and not c.nearest_to and c.robustness is not None), None)
    calmer = [
        f"Where wear counts more: {settings_words(study, other)} ({other.name}) has mean "
        f"square error {figure(figures.mse_mean, 3)} EU² at valve travel {figure(figures.travel_mean, 3)} %"
        f"{_matched(study, figures, other)}."
        for other, _, figures in found
        if other is not case and figures.travel_mean < 0.8 * r.travel_mean
    ]
    # Less error at several times the wear is a choice, which belongs with the decision.
    dear = base is not None and base.robustness is not None and r.travel_mean > DEAR * base.robustness.travel_mean
    price = _price(r, base) if dear else ""
    beside = calmer[:1] if dear else []
    if price and base is not None and not beside:
        beside = [f"Otherwise keep {base.name}."]
    order = f"{_setting(study, case, r, price)}{_against(r, base)}"
    out = [" ".join([order, *beside]), *(text for text in calmer if text not in beside)]
    asked = tuned.constraints or Constraints()
    for other in study.cases:
        theirs = other.robustness
        if theirs is None:
            continue
        if other.tuned is None:
            out += [text for text in (_beside(other, theirs, r, asked), _only_here(other, case)) if text]
        elif other.tuned.ensemble is None:
            out.append(_nominal(other, theirs, r, asked))
    out += [
        f"Do not use {c.name} as it stands: its search ended as “{c.tuned.status.value}” ({c.tuned.message})."
        for c in study.cases
        if c.tuned is not None and not c.tuned.status.success
    ]
    out += robust_repair_text(study)
    return out


def _price(r: Robustness, base: CaseResult | None) -> str:
    """Return the valve travel on which the order depends, "" where the tuning as found is nothing to go back to."""
    was = None if base is None else base.robustness
    if base is None or was is None or not held(was) or was.travel_mean == 0.0:
        return ""
    return f" if {figure(r.travel_mean / was.travel_mean, 2)} times the valve travel of {base.name} is acceptable"


def _setting(study: Study, case: CaseResult, r: Robustness, price: str) -> str:
    lost = "none diverges" if r.diverged == 0 else f"{r.diverged} diverge"
    many, long = f"{r.ensemble.draws:,}", duration(r.ensemble.duration)
    return (
        f"Set {settings_words(study, case)} ({case.name}){price}. Over {many} plants and circumstances of {long} each "
        f"that no search has seen it has mean square error {figure(r.mse_mean, 3)} EU² and valve travel "
        f"{figure(r.travel_mean, 3)} % (means); {lost}, and Ms is at most {figure(r.max_sensitivity, 3)}"
    )


def _against(r: Robustness, base: CaseResult | None) -> str:
    if base is None or base.robustness is None:
        return "."
    was = base.robustness
    if not held(was):
        return f". {base.name} does not hold every plant of the ensemble."
    return (
        f". Against {base.name}: error {change(r.mse_mean, was.mse_mean)}, travel "
        f"{change(r.travel_mean, was.travel_mean)}."
    )


def _matched(study: Study, figures: Robustness, own: CaseResult) -> str:
    """Name a given case of about the same travel and clearly more error."""
    others = [
        c
        for c in study.cases
        if c is not own
        and c.tuned is None
        and c.robustness is not None
        and abs(c.robustness.travel_mean - figures.travel_mean) < 0.1 * figures.travel_mean
        and c.robustness.mse_mean > NEAR * figures.mse_mean
    ]
    if not others or others[0].robustness is None:
        return ""
    other = others[0]
    ratio = others[0].robustness.mse_mean / figures.mse_mean
    return f", at equal travel {figure(ratio, 2)} times less than {other.name}"


def _nominal(case: CaseResult, its: Robustness, r: Robustness, asked: Constraints) -> str:
    """Say what a tuning to the one experiment is worth over the ensemble."""
    if not held(its):
        return f"Do not use {case.name}: best in the one experiment, it does not hold every plant of the ensemble."
    better = its.mse_mean < r.mse_mean
    word = "less" if better else "more"
    broken = _broken(its, asked)
    end = f"Ms reaches {figure(its.max_sensitivity, 3)} at the worst corner"
    if broken:
        end = f"{broken}: not for a plant that may differ from the model"
    return (
        f"{case.name} is the best found for the one experiment; over the ensemble it has {word} error "
        f"({figure(its.mse_mean, 3)} EU²) at valve travel {figure(its.travel_mean, 3)} %, and {end}."
    )
