"""What can be typed on the page: every entry with its label, units, choices and where it shows.

An entry's path is its place in a scenario (`loop.plant.gain`), so that the loader's messages find their field; entries
under `tune.` and `estimate.` are those of a tuning to be found and of an estimate. Values are texts as typed: only the
loader says what they mean and whether they are allowed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

from workbench.model.titles import kpi_title
from workbench.model.tuning import WEIGHABLE
from workbench.scenario.units import NUMBER
from workbench.ui.entry import SECONDS, Field, Group
from workbench.ui.loop_fields import OWN_WEIGHT, controller_fields, element_fields, plant_fields, valve_fields
from workbench.ui.tune_fields import TUNE_GROUPS

__all__ = ["DEFAULTS", "FIELDS", "GROUPS", "OWN_WEIGHT", "field_of", "parted"]

_WITH_UNIT = re.compile(rf"({NUMBER})\s*(\S.*)")


def _range(path: str, hint: str) -> tuple[Field, Field]:
    return (
        Field(f"{path}.pv_range.low", "PV range from", "", ("EU",), hint=hint, more=True),
        Field(f"{path}.pv_range.high", "PV range to", "", ("EU",), more=True),
    )


_PLANT = Group("plant", "Plant", plant_fields("loop.plant"))
_VALVE = Group("valve", "Valve", (*valve_fields("loop.valve"), *element_fields("loop")))
_CONTROLLER = Group(
    "controller",
    "Controller",
    (
        *controller_fields("loop.controller"),
        Field("loop.scan", "Scan", "1", whole=True, hint="executes every so many samples", more=True),
        *_range("loop", "for %/% and PB"),
    ),
)
_OUTER = "cascade.primary"
_INNER = "cascade.secondary"
_PRIMARY_PLANT = Group(
    "primary_plant",
    "Primary: plant",
    plant_fields(f"{_OUTER}.plant", gain="EU/EU", moved="EU", given=("1.2", "60", "10")),
)
_PRIMARY = Group(
    "primary",
    "Primary: controller",
    (
        *controller_fields(f"{_OUTER}.controller", of_cascade="primary", given=("3", "80")),
        Field(f"{_OUTER}.sample_time", "Sample time", "5", ("s", "ms", "min"), hint="whole samples of the secondary"),
        *_range(_OUTER, "for the site's proportional band"),
        Field("cascade.scale", "Scale", "1", hint="EU of the secondary per unit of the output", more=True),
        Field(
            "cascade.anti_windup",
            "Where the secondary is at a limit",
            "clamp",
            choices=(("clamp", "the integral is held"), ("none", "it integrates on")),
            more=True,
        ),
    ),
)
_SECONDARY_PLANT = Group("secondary_plant", "Secondary: plant", plant_fields(f"{_INNER}.plant", given=("1", "3", "1")))
_SECONDARY_VALVE = Group("secondary_valve", "Valve", valve_fields(f"{_INNER}.valve", d="1"))
_SECONDARY = Group(
    "secondary",
    "Secondary: controller",
    (
        *controller_fields(f"{_INNER}.controller", of_cascade="secondary", given=("0.5", "5")),
        Field(f"{_INNER}.sample_time", "Sample time", "1", ("s", "ms", "min")),
        *_range(_INNER, "for the site's proportional band"),
    ),
)
_EXPERIMENT = Group(
    "experiment",
    "Experiment",
    (
        Field("experiment.duration", "Duration", "1000", SECONDS),
        Field("loop.sample_time", "Sample time", "1", ("s", "ms", "min")),
        Field("loop.coarse_sampling", "Allow coarse sampling", "false", flag=True, more=True),
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
        Field(
            "experiment.primary_load.step",
            "Load step of the primary",
            "0",
            ("EU",),
            slider="linear",
            reach=5.0,
            signed=True,
            hint="EU of the secondary",
        ),
        Field("experiment.primary_load.at", "at", "0", SECONDS),
        Field("experiment.noise.sd", "Noise", "0", ("EU",), slider="linear", reach=0.2, hint="standard deviation"),
        Field("experiment.noise.seed", "Noise seed", "0", whole=True),
        Field(
            "experiment.secondary_noise.sd",
            "Noise of the secondary",
            "0",
            ("EU",),
            slider="linear",
            reach=0.2,
            hint="standard deviation",
        ),
        Field("experiment.secondary_noise.seed", "Its seed", "0", whole=True),
        Field(
            "experiment.stem_offset",
            "Stem offset",
            "0",
            ("%",),
            slider="linear",
            reach=2.0,
            signed=True,
            hint="OP from stem at rest",
            more=True,
        ),
    ),
)


def _weight(name: str, *, more: bool) -> Field:
    title, unit = kpi_title(name)
    return Field(f"objective.{name}", title, "0", hint=f"weight per {unit}" if unit else "weight", more=more)


_OBJECTIVE = Group(
    "objective",
    "Objective J",
    (
        Field("objective.w1", "w1", "0.5", hint="on Σ (SP − PV)²"),
        Field("objective.w2", "w2", "0", hint="on Σ OP²"),
        Field("objective.w3", "w3", "0.5", hint="on the last error, squared"),
        Field("objective.w4", "w4", "0", hint="on Σ (OP move)²"),
        *(_weight(name, more=name not in ("valve_travel", "iae")) for name in WEIGHABLE),
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
            "auto",
            choices=(("auto", "the one that PV shows"), ("fopdt", "first order"), ("integrating", "integrating")),
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
    {
        group.name: group
        for group in (
            _PLANT,
            _VALVE,
            _CONTROLLER,
            _PRIMARY_PLANT,
            _PRIMARY,
            _SECONDARY_PLANT,
            _SECONDARY_VALVE,
            _SECONDARY,
            _EXPERIMENT,
            _OBJECTIVE,
            *TUNE_GROUPS,
            _ESTIMATE,
            _MAP,
        )
    }
)
FIELDS = MappingProxyType({field.path: field for group in GROUPS.values() for field in group.fields})


def _defaults() -> dict[str, str]:
    entries = {path: field.default for path, field in FIELDS.items()}
    return entries | {f"{path}.unit": field.units[0] for path, field in FIELDS.items() if field.units}


DEFAULTS = MappingProxyType(_defaults())


def parted(entries: Mapping[str, str], beside: Mapping[str, str]) -> dict[str, str]:
    """Return entries with a unit that was typed behind its number in the unit's own entry, where the field knows it.

    beside: what stands on the page.
    """
    out = dict(entries)
    for path, text in entries.items():
        field, typed = FIELDS.get(path), _WITH_UNIT.fullmatch(text.strip())
        if field is not None and typed is not None and typed[2] in field.units_in({**beside, **entries}):
            out |= {path: typed[1], f"{path}.unit": typed[2]} if typed[2] in field.units else {path: typed[1]}
    return out


def field_of(where: str, entries: Mapping[str, str] | None = None) -> str | None:
    """Return the path of the field that a loader's message is about, by its `where`; None where no field has it.

    entries: what stands on the page; for a field that they hide it is the one that would show it. None: all show.
    """
    path = where.replace("cases[0].tune.", "tune.").replace("cases[0].tune", "tune").replace("estimate[0]", "estimate")
    for name in ("output_limits", "pv_range", "op_range", "bounds.Kc", "bounds.Ti", "bounds.Td"):
        path = path.replace(f"{name}[0]", f"{name}.low").replace(f"{name}[1]", f"{name}.high")
    path = re.sub(r"\[[0-9]+\]", "", path).replace("proportional_band", "Kc").removeprefix("cases.")
    path = path.replace("tune.objective.", "objective.")
    path = re.sub(r"^tune_cascade\.(digits|restarts|seed)$", r"tune.\1", path)
    root = next((one for one in ("loop", _OUTER, _INNER) if path.startswith(f"{one}.")), "loop")
    own = path.removeprefix(f"{root}.")
    # What valve or controller refuse of the loop about them is said of the loop.
    for place in (path, f"{root}.controller.{own}", f"{root}.valve.{own}"):
        found = _nearest(place)
        if found is not None and (place == path or found.startswith(place)):
            return found if entries is None else _shown(found, entries)
    return None


def _nearest(path: str) -> str | None:
    """Return the field of a path, or of the nearest path above it."""
    while path:
        for one in (path, f"{path}.low", f"{path}.type", f"{path}.action"):
            if one in FIELDS:
                return one
        path = path.rpartition(".")[0]
    return None


def _shown(path: str, entries: Mapping[str, str]) -> str:
    when = FIELDS[path].when
    return path if when is None or entries[when[0]] in when[1] else _shown(when[0], entries)
