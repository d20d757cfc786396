"""What can be typed on the page: every entry with its label, units, choices and where it shows.

An entry's path is its place in a scenario (`loop.plant.gain`), so that the loader's messages find their field; entries
under `tune.` and `estimate.` are those of a tuning to be found and of an estimate. Values are texts as typed: only the
loader says what they mean and whether they are allowed.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from workbench.model.controller import FORMS, STRUCTURES

__all__ = ["DEFAULTS", "FIELDS", "GROUPS", "OWN_WEIGHT", "Field", "Group", "field_of"]

SECONDS = ("s", "min", "h")
OWN_WEIGHT = "own setpoint weight"  # a structure without a name of its own


@dataclass(frozen=True, slots=True)
class Field:
    """One entry. units: to choose from, () for none. choices: (value, words), () for what is typed.

    slider: "log" (even ratios), "linear" or "" for none; reach: how far a linear one goes from 0 at least, to both
    sides where it is signed. when: the entry shows where another has one of these values.
    flag: a yes or no. hint: shown under the field's name.
    """

    path: str
    label: str
    default: str
    units: tuple[str, ...] = ()
    choices: tuple[tuple[str, str], ...] = ()
    slider: str = ""
    reach: float = 1.0
    signed: bool = False
    when: tuple[str, tuple[str, ...]] | None = None
    flag: bool = False
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Group:
    """Fields under one heading."""

    name: str
    title: str
    fields: tuple[Field, ...]


def _valve(path: str, label: str, default: str, *types: str, hint: str = "") -> Field:
    when = ("loop.valve.type", types)
    return Field(f"loop.valve.{path}", label, default, ("%",), slider="log", when=when, hint=hint)


_PLANT = Group(
    "plant",
    "Plant",
    (
        Field(
            "loop.plant.type",
            "Kind",
            "fopdt",
            choices=(("fopdt", "first order plus dead time"), ("integrating", "integrating plus dead time")),
        ),
        Field("loop.plant.gain", "Gain K", "1", ("EU/%",), slider="log", hint="integrating: EU/(% s)"),
        Field(
            "loop.plant.time_constant",
            "Time constant",
            "5",
            SECONDS,
            slider="log",
            when=("loop.plant.type", ("fopdt",)),
        ),
        Field("loop.plant.dead_time", "Dead time", "1", SECONDS, slider="linear", reach=5.0),
    ),
)
_VALVE = Group(
    "valve",
    "Valve",
    (
        Field(
            "loop.valve.type",
            "Law",
            "stenman",
            choices=(
                ("ideal", "ideal, no friction"),
                ("stenman", "Stenman (d)"),
                ("he", "He (fs, fd)"),
                ("choudhury", "Choudhury (S, J)"),
                ("kano", "Kano (S, J)"),
                ("deadband", "dead band (b)"),
                ("directional", "Choudhury, unlike directions"),
            ),
        ),
        _valve("d", "Stiction d", "2", "stenman"),
        _valve("fs", "Static friction fs", "1.5", "he"),
        _valve("fd", "Dynamic friction fd", "0.5", "he", hint="at most fs"),
        _valve("S", "Stick band S", "2", "choudhury", "kano"),
        _valve("J", "Slip jump J", "1", "choudhury", "kano"),
        _valve("b", "Full band b", "2", "deadband"),
        _valve("up.S", "Upward S", "2", "directional"),
        _valve("up.J", "Upward J", "1", "directional"),
        _valve("down.S", "Downward S", "3", "directional"),
        _valve("down.J", "Downward J", "1", "directional"),
    ),
)
_LIMITED = ("loop.controller.limited", ("true",))
_CONTROLLER = Group(
    "controller",
    "Controller",
    (
        Field("loop.controller.Kc", "Gain Kc", "0.5", ("%/EU", "%/%", "PB %"), slider="log"),
        Field("loop.controller.Ti", "Integral time Ti", "20", (*SECONDS, "repeats/min"), slider="log", hint="or none"),
        Field("loop.controller.Td", "Derivative time Td", "0", SECONDS, slider="linear", reach=10.0),
        Field("loop.controller.form", "Form", "ideal", choices=tuple((form, form) for form in FORMS)),
        Field(
            "loop.controller.structure",
            "Structure",
            "PID on error",
            choices=tuple((name, name) for name in (*STRUCTURES, OWN_WEIGHT)),
        ),
        Field(
            "loop.controller.derivative_on",
            "Derivative on",
            "pv",
            choices=(("error", "error"), ("pv", "PV")),
            when=("loop.controller.structure", (OWN_WEIGHT,)),
        ),
        Field(
            "loop.controller.setpoint_weight",
            "Setpoint weight",
            "0.5",
            when=("loop.controller.structure", (OWN_WEIGHT,)),
            hint="0 to 1",
        ),
        Field("loop.controller.derivative_filter", "Derivative filter n", "10", hint="Tf = Td/n, or none"),
        Field(
            "loop.controller.action",
            "Action",
            "reverse",
            choices=(("reverse", "reverse (plant gain > 0)"), ("direct", "direct (plant gain < 0)")),
        ),
        Field("loop.controller.limited", "Output limits", "false", flag=True),
        Field("loop.controller.output_limits.low", "Lowest OP", "-50", ("%",), when=_LIMITED, hint="from rest"),
        Field("loop.controller.output_limits.high", "Highest OP", "50", ("%",), when=_LIMITED, hint="from rest"),
        Field(
            "loop.controller.anti_windup",
            "Anti-windup",
            "clamp",
            choices=(("clamp", "clamp"), ("back_calculation", "back-calculation")),
            when=_LIMITED,
        ),
        Field(
            "loop.controller.tracking_time",
            "Tracking time",
            "",
            SECONDS,
            when=_LIMITED,
            hint="of back-calculation; empty: Ti",
        ),
        Field("loop.pv_range.low", "PV range from", "", ("EU",), hint="for %/% and PB"),
        Field("loop.pv_range.high", "PV range to", "", ("EU",)),
    ),
)
_EXPERIMENT = Group(
    "experiment",
    "Experiment",
    (
        Field("experiment.duration", "Duration", "1000", SECONDS),
        Field("loop.sample_time", "Sample time", "1", ("s", "ms", "min")),
        Field("loop.coarse_sampling", "Allow coarse sampling", "false", flag=True),
        Field("experiment.setpoint.step", "Setpoint step", "4", ("EU",), slider="linear", reach=5.0, signed=True),
        Field("experiment.setpoint.at", "at", "0", SECONDS),
        Field(
            "experiment.load.step",
            "Load step",
            "0",
            ("%",),
            slider="linear",
            reach=5.0,
            signed=True,
            hint="at the plant's input",
        ),
        Field("experiment.load.at", "at", "0", SECONDS),
        Field("experiment.noise.sd", "Noise", "0", ("EU",), slider="linear", reach=0.2, hint="standard deviation"),
        Field("experiment.noise.seed", "Noise seed", "0"),
        Field(
            "experiment.stem_offset",
            "Stem offset",
            "0",
            ("%",),
            slider="linear",
            reach=2.0,
            signed=True,
            hint="OP from stem at rest",
        ),
    ),
)
_OBJECTIVE = Group(
    "objective",
    "Objective J",
    (
        Field("objective.w1", "w1", "0.5", hint="on Σ (SP − PV)²"),
        Field("objective.w2", "w2", "0", hint="on Σ OP²"),
        Field("objective.w3", "w3", "0.5", hint="on the last error, squared"),
        Field("objective.w4", "w4", "0", hint="on Σ (OP move)²"),
        Field("objective.valve_travel", "Valve travel", "0", hint="weight per %"),
        Field("objective.iae", "IAE", "0", hint="weight per EU s"),
    ),
)
_TUNE = Group(
    "tune",
    "Search",
    (
        Field("tune.kind", "Controller", "PI", choices=(("PI", "PI (Td = 0)"), ("PID", "PID"))),
        Field("tune.bounds.Kc.low", "Kc from", "0", ("%/EU",)),
        Field("tune.bounds.Kc.high", "Kc to", "10", ("%/EU",)),
        Field("tune.bounds.Ti.low", "Ti from", "5", SECONDS),
        Field("tune.bounds.Ti.high", "Ti to", "600", SECONDS),
        Field("tune.bounds.Td.low", "Td from", "0", SECONDS, when=("tune.kind", ("PID",))),
        Field("tune.bounds.Td.high", "Td to", "60", SECONDS, when=("tune.kind", ("PID",))),
        Field(
            "tune.robust",
            "Robust",
            "false",
            flag=True,
            hint="over random steps, loads, noise and plants 20 % off",
        ),
        Field("tune.constraints.max_sensitivity", "Largest Ms", "", hint="empty: none (robust: 2)"),
        Field("tune.constraints.valve_travel", "Largest valve travel", "", ("%",), hint="empty: none"),
        Field("tune.digits", "Digits to type in", "4"),
        Field("tune.restarts", "Searches", "4"),
        Field("tune.seed", "Seed", "0"),
    ),
)
_ESTIMATE = Group(
    "estimate",
    "How to read and estimate",
    (
        Field(
            "estimate.method",
            "Method",
            "profile",
            choices=(
                ("profile", "profile (global)"),
                ("joint", "joint (profile, then refined)"),
                ("two_step", "two-step (the paper's)"),
                ("complementarity", "complementarity (to compare)"),
            ),
        ),
        Field(
            "estimate.valve",
            "Valve model",
            "auto",
            choices=tuple((v, v) for v in ("auto", "linear", "stenman", "choudhury", "deadband")),
        ),
        Field(
            "estimate.plant",
            "Plant model",
            "fopdt",
            choices=(("fopdt", "first order"), ("integrating", "integrating"), ("auto", "the lower BIC")),
        ),
        Field("estimate.sample_time", "Sample time", "", SECONDS, hint="where the data has no even times"),
        *(
            Field(f"estimate.columns.{name}", f"{words} column", "", hint="where its name does not tell")
            for name, words in (("time", "Time"), ("SP", "SP"), ("PV", "PV"), ("OP", "OP"))
        ),
        Field("estimate.op_range.low", "OP range from", "", hint="what the data calls 0 %"),
        Field("estimate.op_range.high", "OP range to", "", hint="what the data calls 100 %"),
    ),
)

_MAP = Group(
    "map",
    "Map",
    (Field("analyze.map.points", "Cells", "30", choices=tuple((str(n), f"{n} × {n} cells") for n in (15, 30, 60))),),
)

GROUPS = MappingProxyType(
    {g.name: g for g in (_PLANT, _VALVE, _CONTROLLER, _EXPERIMENT, _OBJECTIVE, _TUNE, _ESTIMATE, _MAP)}
)
FIELDS = MappingProxyType({field.path: field for group in GROUPS.values() for field in group.fields})


def _defaults() -> dict[str, str]:
    entries = {path: field.default for path, field in FIELDS.items()}
    return entries | {f"{path}.unit": field.units[0] for path, field in FIELDS.items() if field.units}


DEFAULTS = MappingProxyType(_defaults())


def field_of(where: str) -> str | None:
    """Return the path of the field that a loader's message is about, by its `where`; None where no field has it."""
    path = where.replace("cases[0].tune.", "tune.").replace("cases[0].tune", "tune").replace("estimate[0]", "estimate")
    for name in ("output_limits", "pv_range", "op_range", "bounds.Kc", "bounds.Ti", "bounds.Td"):
        path = path.replace(f"{name}[0]", f"{name}.low").replace(f"{name}[1]", f"{name}.high")
    path = path.replace("[0]", "").replace("proportional_band", "Kc").removeprefix("cases.")
    path = path.replace("tune.objective.", "objective.")
    while path:
        if path in FIELDS:
            return path
        low = f"{path}.low"
        if low in FIELDS:
            return low
        path = path.rpartition(".")[0]
    return None
