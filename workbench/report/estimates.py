"""What the report says of an estimate: its sentences, its table, and what to do about it."""

from __future__ import annotations

import math
import re

from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.study import NamedEstimate
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman, Valve
from workbench.report.results import aic
from workbench.report.tables import Cell, Row, Table
from workbench.report.titles import kpi_title
from workbench.report.words import decimals_of, difference, figure, given, interval, published, valve_words

__all__ = ["estimate_advice", "estimate_sentences", "estimate_table"]

NO_BIAS = 1e-6  # share of PV's span below which a bias is rounding error


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
    ours = dict(_valve_parameters(found.valve)) | _plant_parameters(found.plant)
    true = dict(_valve_parameters(truth.valve)) | _plant_parameters(truth.plant)
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


def _valve_parameters(valve: Valve) -> list[tuple[str, float]]:
    """Return a valve's parameters by their names, in order."""
    if isinstance(valve, Stenman):
        return [("d", valve.d)]
    if isinstance(valve, Choudhury):
        return [("S", valve.S), ("J", valve.J)]
    return [("b", valve.b)] if isinstance(valve, Deadband) else []


def estimate_table(named: NamedEstimate) -> Table:
    """Return an estimate's parameters with their ranges, beside truth, published figures and the linear fit."""
    found, truth = named.found, named.truth
    true_values = {} if truth is None else dict(_valve_parameters(truth.valve)) | _plant_parameters(truth.plant)
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
