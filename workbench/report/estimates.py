"""What the report says of an estimate: its sentences, its table, and what to do about it."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.results import Estimate, Intervals
from workbench.model.study import NamedEstimate
from workbench.model.titles import kpi_title, within
from workbench.model.valve import Choudhury, Deadband, He, Ideal, Kano, Stenman, Valve
from workbench.report.results import aic
from workbench.report.tables import Cell, Row, Table
from workbench.report.words import (
    decimals_of,
    difference,
    duration,
    figure,
    given,
    interval,
    join,
    published,
    valve_words,
)

__all__ = [
    "candidates_table",
    "estimate_advice",
    "estimate_sentences",
    "estimate_table",
    "gain_doubt",
    "hint",
    "known_groups",
    "known_sentences",
    "least_step",
    "load_words",
    "plant_doubt",
    "stiction_words",
    "tuning_doubts",
    "unpinned",
]

KNOWN, ROUGH = 0.1, 0.5  # width of a 95 % range over the value, up to which a parameter is known, or roughly known
COARSE = 2.0  # samples: a time below that is one that the sampling hides
NO_EFFECT = 1e-6  # share of PV's span that the whole of OP's moves: below it the gain is a number and no finding
NO_BIAS = 1e-6  # share of PV's span below which a bias is rounding error


def estimate_sentences(named: NamedEstimate, *, linear: bool = True) -> list[str]:
    """Return what an estimate found: verdict, stiction with its range, plant, identifiability, and the linear fit."""
    found, name = named.found, named.name
    plant = found.plant
    process = f"gain {figure(plant.gain)} {'EU/%' if isinstance(plant, FOPDT) else 'EU/(% s)'}"
    if isinstance(plant, FOPDT):
        process += f", time constant {figure(plant.time_constant)} s"
    process += f", dead time {figure(plant.dead_time)} s"
    reason = found.reasons[0].rstrip(".") if found.reasons else ""
    if useless(found):
        text = (
            f"{name}: the record shows stiction, but the model that the method ends with ({stiction_words(named)}, "
            f"{process}) leaves more of PV unexplained than one without stiction, and is of no use."
        )
    elif found.verdict == "stiction":
        text = f"{name}: the valve sticks, {stiction_words(named)}; the process has {process}."
    elif found.verdict == "no_stiction":
        text = f"{name}: no stiction found{f' ({reason})' if reason else ''}; the process has {process}."
    else:
        text = f"{name}: whether the valve sticks stays undecided{f': {reason}' if reason else ''}."
        if not isinstance(found.valve, Ideal):
            text += f" The best model has {stiction_words(named)} and {process}; take it as a hint, not as a finding."
    if named.truth is not None:
        text += f" {_against_truth(named, named.truth)}"
    if useless(found):
        return [text]
    sentences = [text]
    if found.verdict == "stiction" and not isinstance(found.valve, Ideal) and not found.identifiable:
        sentences.append(f"{name}: {unpinned(found)}.")
    plain = found.linear
    if linear and found.verdict == "stiction":
        left = found.residual_variance
        ratio = plain.residual_variance / left if left > 0.0 else math.inf
        if ratio > 1.05 and isinstance(plain.plant, FOPDT) and isinstance(plant, FOPDT):
            times = f"{figure(ratio, 2)} times" if ratio < 1e4 else "more than 10,000 times"
            sentences.append(
                f"{name}: a fit that ignores the stiction leaves {times} the residual variance, with gain "
                f"{figure(plain.plant.gain)} EU/%, time constant {figure(plain.plant.time_constant)} s and "
                f"dead time {figure(plain.plant.dead_time)} s."
            )
    if found.pv_late:
        by = f"{given(found.pv_late, 6)} s"
        sentences.append(f"{name}: PV is recorded {by} later than the controller saw it; the dead time is without it.")
    # An undecided record gives no number to rely on.
    loads = [] if found.verdict == "undecided" else load_words(found)
    sentences += [f"{name}: beside the valve PV holds a load that nobody recorded: {load}." for load in loads]
    return sentences


def load_words(found: Estimate) -> list[str]:
    """Return in words what loads, of which the record tells nothing but PV, were found beside the model."""
    words = []
    for step in found.load_steps:
        size = f"{'+' if step.size > 0.0 else ''}{figure(step.size, 3)} % of OP"
        words.append(f"from {given(step.at, 6)} s on {size} (95 %: {interval(step.interval, '%', 3)})")
    if found.load_swing is not None:
        swing = found.load_swing
        words.append(
            f"an oscillation of {figure(swing.size, 3)} % of OP to either side, with a period of "
            f"{duration(swing.period)}"
        )
    return words


def unpinned(found: Estimate) -> str:
    """Return what the record leaves unknown of a valve that sticks and is not identifiable."""
    plant, band = found.plant, found.valve.stick_band
    groups = known_groups(found)
    if found.intervals.d is None and found.intervals.S is None:
        if found.method != "two_step":
            return "the record gives no range for the stiction (the reasons say why): take its value as a hint"
        return (
            "the method gives no range for the stiction, so this does not show whether the record pins the stiction "
            "alone or only its product with the gain; the global profile tells"
        )
    if opened := _open_ranges(found):
        return (
            f"the record leaves the range of the {_titles(opened)} open: what the stem's moves do to PV is not known, "
            "however narrow the range of the stiction"
        )
    if {"d", "S", "b"} & {*groups["known"]} and "gain" in (*groups["roughly"], *groups["hardly"]):
        closely, best = ("only roughly", "") if "gain" in groups["roughly"] else ("hardly", " at best")
        return (
            f"the record pins the stiction, but {closely} the gain "
            f"({interval(found.intervals.gain, _gain_unit(plant), 3)}): what the stem's moves do to PV is known "
            f"roughly{best}"
        )
    product = f"{figure(abs(plant.gain) * band)} {'EU' if isinstance(plant, FOPDT) else 'EU/s'}"
    return (
        f"the record pins only the product of gain and stiction ({product}), not the stiction alone; a record with a "
        "setpoint change in it would resolve that"
    )


def tuning_doubts(found: Estimate) -> list[str]:
    """Return in words why a tuning of this model is no more than a hint; nothing where it is more."""
    said = []
    if useless(found):
        said.append("the model leaves more of PV unexplained than one without stiction")
    if found.verdict == "undecided":
        said.append("whether the valve sticks is undecided")
    return said + [f"the record {doubt}" for doubt in (gain_doubt(found) or plant_doubt(found),) if doubt]


def hint(found: Estimate, what: str = "this tuning") -> str:
    """Return "whether the valve sticks is undecided, so take this tuning as a hint", or ""."""
    doubts = tuning_doubts(found)
    return f"{join(doubts)}, so take {what} as a hint" if doubts else ""


def gain_doubt(found: Estimate) -> str:
    """Return why the record does not show how the valve acts on PV at all, or ""."""
    pair, unit = found.intervals.gain, _gain_unit(found.plant)
    if pair is not None and pair[0] <= 0.0 <= pair[1]:
        return f"does not show whether the gain is positive or negative (95 % range {interval(pair, unit, 3)})"
    record = found.record
    length = 1.0 if isinstance(found.plant, FOPDT) else len(record) * record.sample_time
    effect = abs(found.plant.gain) * float(record.op.max() - record.op.min()) * length
    if effect <= NO_EFFECT * float(record.pv.max() - record.pv.min()):
        return f"shows no effect of the valve on PV (gain {figure(found.plant.gain, 3)} {unit})"
    return ""


def plant_doubt(found: Estimate) -> str:
    """Return which of the plant's ranges are open, or not given where a tuning needs them, or ""."""
    if opened := _open_ranges(found):
        return f"leaves the range of the {_titles(opened)} open"
    missing = [name for name in ("gain", "dead_time") if getattr(found.intervals, name) is None]
    return f"gives no range for the {_titles(missing)}" if missing else ""


def least_step(found: Estimate) -> tuple[str, str] | None:
    """Return the least slip and what it does to PV in the end, "at least 1.5 %" and "1.8 EU", or None.

    Each is "about" that where it is hardly known; None is told where it is not known at all.
    """
    jump = found.valve.slip_jump
    step = abs(found.plant.gain) * jump if isinstance(found.plant, FOPDT) else 0.0
    if step == 0.0 or useless(found) or gain_doubt(found) or plant_doubt(found):
        return None
    groups = known_groups(found)
    vague = {*groups["hardly"], *groups["none"]}
    about = "about" if {"d", "J"} & vague else "at least"
    return f"{about} {given(jump)} %", f"{'about ' if {'d', 'J', 'gain'} & vague else ''}{given(step, 3)} EU"


def _open_ranges(found: Estimate) -> list[str]:
    """Return the names of the plant's parameters whose range has an open end."""
    pairs = {name: getattr(found.intervals, name) for name in ("gain", "time_constant", "dead_time")}
    return [name for name, pair in pairs.items() if pair is not None and any(math.isinf(end) for end in pair)]


def _titles(names: list[str]) -> str:
    return join([within(kpi_title(name)[0]) for name in names])


def _gain_unit(plant: Plant) -> str:
    return "EU/%" if isinstance(plant, FOPDT) else "EU/(% s)"


def useless(found: Estimate) -> bool:
    """Return whether a model of a sticking valve explains PV no better than the fit that ignores stiction.

    Not where it foretells PV better: a load that the stem's model leaves to the noise costs it PV's simulation alone.
    """
    sticks = found.verdict == "stiction" and not isinstance(found.valve, Ideal)
    bics = {type(model.valve): model.bic for model in found.candidates}
    foretells = bics.get(type(found.valve), math.inf) < bics.get(Ideal, math.inf)
    return sticks and not foretells and found.residual_variance > found.linear.residual_variance


def _against_truth(named: NamedEstimate, truth: Loop) -> str:
    """Say how far the worst parameter of a simulated record's estimate lies from the truth."""
    found = named.found
    ours = dict(_valve_parameters(found.valve)) | _plant_parameters(found.plant)
    true = _true_parameters(truth)
    decided = found.verdict != "undecided"
    if isinstance(found.valve, Ideal) != isinstance(truth.valve, Ideal):
        wrong = "This is wrong: the" if decided else "The"
        return f"{wrong} record was simulated with {valve_words(truth.valve)}."
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
    # A record that is left undecided claims nothing that could be wrong.
    what = "This is wrong" if decided else "The model is off"
    return f"{what} by {miss} % in the {title} (true value {given(true[worst])})."


def stiction_words(named: NamedEstimate) -> str:
    """Return what was found of the valve, with its ranges: "d = 2.00 % (95 % range 1.99 to 2.01 %)"."""
    valve, ranges = named.found.valve, named.found.intervals
    # Of an undecided valve the range is the fit's own, and no statement about the valve.
    span = "fits from" if named.found.verdict == "undecided" else "95 % range"

    def with_range(name: str, value: float, pair: tuple[float, float] | None) -> str:
        text = f"{name} = {figure(value)} %"
        return text if pair is None else f"{text} ({span} {interval(pair, '%')})"

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
    swings = []
    if found.load_swing is not None:
        swings.append(
            f"{named.name}: look outside the loop for what oscillates with a period of "
            f"{duration(found.load_swing.period)}, and drives it: another loop, or what feeds this one."
        )
    if found.verdict == "stiction":
        text = f"{named.name}: have the valve looked at (packing, actuator, positioner)."
        if step := least_step(found):
            text += f" As long as it sticks each slip moves PV by {step[1]} or more in the end, whatever the tuning."
        return [text, *swings]
    if found.verdict == "no_stiction":
        if swings:
            return swings
        return [f"{named.name}: if the loop oscillates, look for another cause: tight tuning, or a disturbance."]
    return [
        *swings,
        f"{named.name}: before acting, take a longer record, with a setpoint change of several per cent of OP in it.",
    ]


def _valve_parameters(valve: Valve) -> list[tuple[str, float]]:
    """Return a valve's parameters by their names, in order."""
    if isinstance(valve, Stenman):
        return [("d", valve.d)]
    if isinstance(valve, Choudhury | Kano | He):
        return [("S", valve.stick_band), ("J", valve.slip_jump)]
    return [("b", valve.b)] if isinstance(valve, Deadband) else []


def estimate_table(named: NamedEstimate) -> Table:
    """Return an estimate's parameters with their ranges, beside truth, published figures and the linear fit."""
    found, truth = named.found, named.truth
    true_values = {} if truth is None else _true_parameters(truth)
    linear = _plant_parameters(found.linear.plant)
    heads = ["estimate", "95 % range"]
    heads += ["true value", "off by"] if truth is not None else []
    heads += ["published", "difference"] if named.reference else []
    heads.append("fit that ignores stiction")
    rows = []
    for name, value in [*_valve_parameters(found.valve), *_plant_parameters(found.plant).items()]:
        title, unit = kpi_title(name)
        if name == "gain" and not isinstance(found.plant, FOPDT):
            unit = "EU/(% s)"
        cells = [Cell(figure(value)), Cell(interval(getattr(found.intervals, name, None), ""))]
        if truth is not None:
            true = true_values.get(name)
            cells.append(Cell("–" if true is None else given(true)))
            cells.append(Cell("–" if true is None else _off_by(value, true)))
        if named.reference:
            theirs = named.reference.get(name)
            decimals = 0 if theirs is None else decimals_of([theirs])
            cells.append(Cell("–" if theirs is None else published(theirs, decimals)))
            cells.append(Cell("–" if theirs is None else difference(value, theirs, decimals)))
        cells.append(Cell(figure(linear[name]) if name in linear else "–"))
        rows.append(Row(title, unit, tuple(cells)))
    blanks = len(heads) - 3
    span = float(found.record.pv.max() - found.record.pv.min())
    for title, unit, ours, theirs in (
        ("Bias (PV at stem 0)", "EU", found.bias, found.linear.bias),
        ("Residual variance", "EU²", found.residual_variance, found.linear.residual_variance),
        (
            "AIC",
            "",
            aic(found.aic, found.residual_variance),
            aic(found.linear.aic, found.linear.residual_variance),
        ),
    ):
        if title.startswith("Bias"):
            ours, theirs = (0.0 if abs(b) < NO_BIAS * span else b for b in (ours, theirs))
        middle = tuple(Cell("") for _ in range(blanks + 1))
        rows.append(Row(title, unit, (Cell(figure(ours)), *middle, Cell(figure(theirs)))))
    return Table(tuple(heads), tuple(rows))


def _true_parameters(truth: Loop) -> dict[str, float]:
    """The valve's and the plant's, with the sign that a fail-open valve gives the gain."""
    return dict(_valve_parameters(truth.valve)) | _plant_parameters(replace(truth.plant, gain=truth.gain))


def _plant_parameters(plant: Plant) -> dict[str, float]:
    """Return a plant's parameters by their names, in order."""
    names = ("gain", "time_constant", "dead_time")
    return {n: getattr(plant, n) for n in names if hasattr(plant, n)}


def _off_by(value: float, true: float) -> str:
    """Return how far an estimate lies from the true value, in per cent of it."""
    if value == true:
        return "0"
    if true == 0.0:
        return figure(value - true, 2)
    percent = 100.0 * (value / true - 1.0)
    return "under 0.01 %" if abs(percent) < 0.01 else f"{figure(percent, 2)} %"


def candidates_table(found: Estimate) -> Table | None:
    """Return the models held against the record, the lowest BIC first, AIC and BIC's lowest in bold; None without."""
    if not found.candidates:
        return None
    models = found.candidates
    unit = "EU/%" if isinstance(found.plant, FOPDT) else "EU/(% s)"
    timed = isinstance(found.plant, FOPDT)
    heads = ["valve, %", f"gain, {unit}", *(["time constant, s"] if timed else []), "dead time, s"]
    heads += ["stem moves", "residual variance, EU²", "AIC", "BIC", "BIC above the lowest"]
    aics, bics = [m.aic for m in models], [m.bic for m in models]
    rows = []
    for model in models:
        parameters = ", ".join(f"{name}\u00a0{figure(value)}" for name, value in _valve_parameters(model.valve))
        plant = _plant_parameters(model.plant)
        cells = [Cell(parameters or "–"), *(Cell(figure(value)) for value in plant.values())]
        cells += [Cell(f"{model.slips:,}"), Cell(figure(model.residual_variance))]
        cells.append(Cell(_whole(model.aic), best=model.aic == min(aics)))
        cells.append(Cell(_whole(model.bic), best=model.bic == min(bics)))
        cells.append(Cell(_whole(model.bic - min(bics))))
        used = type(model.valve) is type(found.valve)
        rows.append(Row(f"{_KINDS.get(type(model.valve), 'other')}{' (used)' if used else ''}", "", tuple(cells)))
    return Table(tuple(heads), tuple(rows))


_KINDS: dict[type, str] = {
    Ideal: "No stiction",
    Stenman: "One parameter (Stenman)",
    Choudhury: "Two parameters (Choudhury)",
    Deadband: "Dead band",
}


def _whole(value: float) -> str:
    return f"{value:,.0f}".replace("-", "−")


def known_groups(found: Estimate) -> dict[str, list[str]]:
    """Return the parameters' names by how well their 95 % ranges pin them: "known", "roughly", "hardly", "none"."""
    values = dict(_valve_parameters(found.valve)) | _plant_parameters(found.plant)
    groups: dict[str, list[str]] = {"known": [], "roughly": [], "hardly": [], "none": []}
    for name, value in values.items():
        pair = getattr(found.intervals, "S" if name == "b" else name, None)
        groups[_how_known(name, value, pair, found.record.sample_time)].append(name)
    return groups


def known_sentences(found: Estimate) -> list[str]:
    """Return which parameters the record pins down and which not, by their 95 % ranges, and what would tell more."""
    groups = known_groups(found)

    def names(which: str) -> str:
        return _titles(groups[which])

    if useless(found):
        return ["The model leaves more of PV unexplained than one without stiction: use none of its figures."]
    said = []
    if found.verdict == "undecided":
        said.append("Whether the valve sticks is open, so these are the figures of a model that may be wrong.")
    if groups["known"]:
        said.append(f"Pinned down, the 95 % range no wider than a tenth of the value: {names('known')}.")
    if groups["roughly"]:
        said.append(f"Roughly known, the range no wider than half the value: {names('roughly')}.")
    if groups["hardly"]:
        said.append(f"Hardly known, the range wider than that: {names('hardly')}.")
    if groups["none"]:
        said.append(f"Given without a range: {names('none')}.")
    return said + _would_tell(found, groups)


def _how_known(name: str, value: float, pair: tuple[float, float] | None, sample_time: float) -> str:
    if pair is None:
        return "none"
    # A time far below the sampling is known well enough where its range is.
    scale = max(abs(value), sample_time) if name in ("time_constant", "dead_time") else abs(value)
    width = (pair[1] - pair[0]) / scale if scale > 0.0 else math.inf
    return "known" if width <= KNOWN else "roughly" if width <= ROUGH else "hardly"


def _would_tell(found: Estimate, groups: dict[str, list[str]]) -> list[str]:
    """What to do about what is not known."""
    said = []
    valve, vague = found.valve, {*groups["roughly"], *groups["hardly"], *groups["none"]}
    band = valve.stick_band
    if found.verdict == "stiction" and not found.identifiable and band > 0.0:
        step = abs(found.plant.gain) * band
        size = f" (gain times band: {figure(step, 2)} EU)" if isinstance(found.plant, FOPDT) else ""
        told, what = f"Give maintenance the range of the stiction, not its value{size}. ", "narrow it"
        if {"d", "S", "b"} & {*groups["known"]}:
            told, what = "", "tell more of the gain"
        elif found.intervals.d is None and found.intervals.S is None:
            told, what = "", "tell more of the stiction"
        if found.intervals == Intervals() and found.method != "two_step":
            said.append("A record of OP with more digits would tell more of the stiction.")
        else:
            said.append(
                f"{told}A setpoint change that moves OP by clearly more than {given(band, 2)} %, or a longer record, "
                f"would {what}."
            )
    if "J" in vague:
        said.append("How far the stem jumps once it breaks loose, J, would show in more slips, or in a measured stem.")
    if doubt := gain_doubt(found) or plant_doubt(found):
        said.append(f"The record {doubt}: tune by no rule from these figures.")
    elif vague & {"gain", "dead_time"} and found.verdict != "undecided":
        said.append("When tuning by a rule, take the upper end of the ranges of gain and dead time: the cautious side.")
    Ts = found.record.sample_time
    values = _plant_parameters(found.plant)
    times = {n: within(kpi_title(n)[0]) for n in ("time_constant", "dead_time") if n in groups["hardly"]}
    coarse = [title for n, title in times.items() if values[n] < COARSE * Ts]
    slow = [title for title in times.values() if title not in coarse]
    if coarse:
        verb = "is" if len(coarse) == 1 else "are"
        said.append(
            f"The {join(coarse)} {verb} of the size of the sampling, {given(Ts)} s: a record sampled faster would tell."
        )
    if slow:
        said.append(f"More setpoint changes in the record would show the {join(slow)} better.")
    return said
