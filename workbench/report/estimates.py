"""What the report says of an estimate: its sentences, its table, and what to do about it."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.results import Estimate
from workbench.model.study import NamedEstimate
from workbench.model.titles import kpi_title
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman
from workbench.report.known import (
    gain_doubt,
    least_step,
    plant_parameters,
    range_of,
    sp_moves,
    strays,
    unpinned,
    useless,
    valve_parameters,
)
from workbench.report.results import aic
from workbench.report.tables import Cell, Row, Table
from workbench.report.words import (
    decimals_of,
    difference,
    duration,
    figure,
    given,
    interval,
    published,
    valve_words,
)

__all__ = [
    "candidates_table",
    "estimate_advice",
    "estimate_sentences",
    "estimate_table",
    "load_words",
    "stiction_words",
]

STRAYS = (
    "The prediction is simulated from the stem alone and wanders away with the load, by more than all of PV's "
    "variance: its residual variance and AIC are left out, as models are compared by what of PV cannot be foretold."
)
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
    if found.op_late:
        by = f"up to {given(found.op_late, 6)} s"
        sentences.append(f"{name}: OP is recorded {by} later than it was sent; the dead time is from there on.")
    # An undecided record gives no number to rely on, nor does one that does not show the gain.
    loads = [] if found.verdict == "undecided" or gain_doubt(found) else load_words(found)
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


def _against_truth(named: NamedEstimate, truth: Loop) -> str:
    """Say how far the worst parameter of a simulated record's estimate lies from the truth."""
    found = named.found
    ours = dict(valve_parameters(found.valve)) | plant_parameters(found.plant)
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
        period = duration(found.load_swing.period)
        if gain_doubt(found):
            swings.append(
                f"{named.name}: find out what oscillates with a period of {period}: the loop's own tuning, or what "
                "drives it from outside. With the controller in manual for some periods it goes on or not."
            )
        else:
            swings.append(
                f"{named.name}: look outside the loop for what oscillates with a period of {period}, and drives it: "
                "another loop, or what feeds this one."
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
    # Of a record that has setpoint changes it is their size, or their number, that leaves this open.
    change = "more or larger setpoint changes, each" if sp_moves(found) else "a setpoint change"
    return [
        *swings,
        f"{named.name}: before acting, take a longer record, with {change} of several per cent of OP in it.",
    ]


def estimate_table(named: NamedEstimate) -> Table:
    """Return an estimate's parameters with their ranges, beside truth, published figures and the linear fit.

    Where the prediction `strays` the table leaves out how closely it meets PV, and says so.
    """
    found, truth = named.found, named.truth
    true_values = {} if truth is None else _true_parameters(truth)
    linear = plant_parameters(found.linear.plant)
    heads = ["estimate", "95 % range"]
    heads += ["true value", "off by"] if truth is not None else []
    heads += ["published", "difference"] if named.reference else []
    heads.append("fit that ignores stiction")
    rows = []
    for name, value in [*valve_parameters(found.valve), *plant_parameters(found.plant).items()]:
        title, unit = kpi_title(name)
        if name == "gain" and not isinstance(found.plant, FOPDT):
            unit = "EU/(% s)"
        cells = [Cell(figure(value)), Cell(interval(range_of(found.intervals, name), ""))]
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
        elif strays(found):
            ours = math.nan
        middle = tuple(Cell("") for _ in range(blanks + 1))
        rows.append(Row(title, unit, (Cell(figure(ours)), *middle, Cell(figure(theirs)))))
    return Table(tuple(heads), tuple(rows), note=STRAYS if strays(found) else "")


def _true_parameters(truth: Loop) -> dict[str, float]:
    """The valve's and the plant's, with the sign that a fail-open valve gives the gain."""
    return dict(valve_parameters(truth.valve)) | plant_parameters(replace(truth.plant, gain=truth.gain))


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
        parameters = ", ".join(f"{name}\u00a0{figure(value)}" for name, value in valve_parameters(model.valve))
        plant = plant_parameters(model.plant)
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
