"""How well a record pins its estimate: what is known, what stays open, and why a tuning of it is but a hint."""

from __future__ import annotations

import math

import numpy as np

from workbench.model.plant import FOPDT, Plant
from workbench.model.results import Estimate, Intervals, Standing
from workbench.model.titles import kpi_title, within
from workbench.model.valve import Choudhury, Deadband, He, Ideal, Kano, Stenman, Valve
from workbench.report.standing import standing_doubt
from workbench.report.words import figure, given, interval, join

__all__ = [
    "gain_doubt",
    "gain_unit",
    "hint",
    "known_groups",
    "known_sentences",
    "least_step",
    "plant_doubt",
    "plant_parameters",
    "range_of",
    "sp_moves",
    "strays",
    "tuning_doubts",
    "unpinned",
    "useless",
    "valve_parameters",
]

KNOWN, ROUGH = 0.1, 0.5  # width of a 95 % range over the value, up to which a parameter is known, or roughly known
COARSE = 2.0  # samples: a time below that is one that the sampling hides
NO_EFFECT = 1e-6  # share of PV's span that the whole of OP's moves: below it the gain is a number and no finding


def known_groups(found: Estimate) -> dict[str, list[str]]:
    """Return the parameters' names by how well their 95 % ranges pin them: "known", "roughly", "hardly", "none"."""
    values = dict(valve_parameters(found.valve)) | plant_parameters(found.plant)
    groups: dict[str, list[str]] = {"known": [], "roughly": [], "hardly": [], "none": []}
    for name, value in values.items():
        pair = range_of(found.intervals, name)
        groups[_how_known(name, value, pair, found.record.sample_time)].append(name)
    return groups


def _how_known(name: str, value: float, pair: tuple[float, float] | None, sample_time: float) -> str:
    if pair is None:
        return "none"
    # A time far below the sampling is known well enough where its range is.
    scale = max(abs(value), sample_time) if name in ("time_constant", "dead_time") else abs(value)
    width = (pair[1] - pair[0]) / scale if scale > 0.0 else math.inf
    return "known" if width <= KNOWN else "roughly" if width <= ROUGH else "hardly"


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
    values = plant_parameters(found.plant)
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


def unpinned(found: Estimate) -> str:
    """Return what the record leaves unknown of a valve that sticks and is not identifiable."""
    plant, band = found.plant, found.valve.stick_band
    groups, bands = known_groups(found), found.intervals.d or found.intervals.S
    if bands is None:
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
            f"({interval(found.intervals.gain, gain_unit(plant), 3)}): what the stem's moves do to PV is known "
            f"roughly{best}"
        )
    gains = found.intervals.gain
    if gains is None:
        return f"the record gives no range for the gain, and the stiction lies in {interval(bands, '%', 3)}"
    more = "more or larger setpoint changes" if sp_moves(found) else "a setpoint change"
    remedy = f"a record with {more} in it would tell more"
    # Where one makes up for the other, the least band goes with the largest gain, and their product is one.
    products = gains[0] * bands[1], gains[1] * bands[0]
    if _width(products) <= KNOWN and min(_width(gains), _width(bands)) > KNOWN:
        product = f"{figure(abs(plant.gain) * band)} {'EU' if isinstance(plant, FOPDT) else 'EU/s'}"
        return f"the record pins only the product of gain and stiction ({product}), not the stiction alone; {remedy}"
    how = {"known": "closely", "roughly": "only roughly", "hardly": "hardly"}
    told = [
        f"the {what} {next(how[which] for which in how if names & {*groups[which]})} ({interval(pair, unit, 3)})"
        for what, names, pair, unit in (
            ("stiction", {"d", "S", "b"}, bands, "%"),
            ("gain", {"gain"}, gains, gain_unit(plant)),
        )
    ]
    if all("closely" in text for text in told):
        return f"the record pins {join(told)} for this model alone, which may be another (the reasons say why)"
    return f"the record pins {join(told)}; {remedy}"


def sp_moves(found: Estimate) -> bool:
    """Return whether the record has setpoint changes in it."""
    sp = found.record.sp
    return sp is not None and bool(np.any(sp != sp[0]))


def range_of(ranges: Intervals, name: str) -> tuple[float, float] | None:
    """Return a parameter's 95 % range by its name; a dead band's is that of S."""
    pair: tuple[float, float] | None = getattr(ranges, "S" if name == "b" else name, None)
    return pair


def _width(pair: tuple[float, float]) -> float:
    """Return the width of a pair over its mean, inf where that is 0."""
    middle = abs(pair[0] + pair[1]) / 2.0
    return abs(pair[1] - pair[0]) / middle if middle > 0.0 else math.inf


def tuning_doubts(found: Estimate | None, standing: Standing | None = None) -> list[str]:
    """Return in words why a tuning of this model is no more than a hint; nothing where it is more.

    found: None for a loop that no record gave.
    """
    said = []
    if found is not None and useless(found):
        said.append("the model leaves more of PV unexplained than one without stiction")
    if found is not None and found.verdict == "undecided":
        said.append("whether the valve sticks is undecided")
    if found is not None and (doubt := gain_doubt(found) or plant_doubt(found)):
        said.append(f"the record {doubt}")
    return said + [doubt for doubt in (standing_doubt(standing),) if doubt]


def hint(found: Estimate | None, what: str = "this tuning", standing: Standing | None = None) -> str:
    """Return "whether the valve sticks is undecided, so take this tuning as a hint", or ""."""
    doubts = tuning_doubts(found, standing)
    return f"{join(doubts)}, so take {what} as a hint" if doubts else ""


def gain_doubt(found: Estimate) -> str:
    """Return why the record does not show how the valve acts on PV at all, or ""."""
    pair, unit = found.intervals.gain, gain_unit(found.plant)
    if pair is not None and pair[0] <= 0.0 <= pair[1]:
        if pair[0] < 0.0 < pair[1]:
            return f"does not show whether the gain is positive or negative (95 % range {interval(pair, unit, 3)})"
        return f"does not show that the valve moves PV at all (95 % range of the gain {interval(pair, unit, 3)})"
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


def _open_ranges(found: Estimate) -> list[str]:
    """Return the names of the plant's parameters whose range has an open end."""
    pairs = {name: getattr(found.intervals, name) for name in ("gain", "time_constant", "dead_time")}
    return [name for name, pair in pairs.items() if pair is not None and any(math.isinf(end) for end in pair)]


def useless(found: Estimate) -> bool:
    """Return whether a model of a sticking valve explains PV no better than the fit that ignores stiction.

    Not where it foretells PV better: a load that the stem's model leaves to the noise costs it PV's simulation alone.
    """
    sticks = found.verdict == "stiction" and not isinstance(found.valve, Ideal)
    bics = {type(model.valve): model.bic for model in found.candidates}
    foretells = bics.get(type(found.valve), math.inf) < bics.get(Ideal, math.inf)
    return sticks and not foretells and found.residual_variance > found.linear.residual_variance


def strays(found: Estimate) -> bool:
    """Return whether a model's prediction leaves more than all of PV's variance, and the model is of use all the same.

    It is simulated from the stem alone: a load, which stem and model tell nothing of, carries PV away from it.
    """
    return not useless(found) and found.residual_variance > float(np.var(found.record.pv))


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


def valve_parameters(valve: Valve) -> list[tuple[str, float]]:
    """Return a valve's parameters by their names, in order."""
    if isinstance(valve, Stenman):
        return [("d", valve.d)]
    if isinstance(valve, Choudhury | Kano | He):
        return [("S", valve.stick_band), ("J", valve.slip_jump)]
    return [("b", valve.b)] if isinstance(valve, Deadband) else []


def plant_parameters(plant: Plant) -> dict[str, float]:
    """Return a plant's parameters by their names, in order."""
    names = ("gain", "time_constant", "dead_time")
    return {n: getattr(plant, n) for n in names if hasattr(plant, n)}


def _titles(names: list[str]) -> str:
    return join([within(kpi_title(name)[0]) for name in names])


def gain_unit(plant: Plant) -> str:
    """Return the unit of a plant's gain."""
    return "EU/%" if isinstance(plant, FOPDT) else "EU/(% s)"
