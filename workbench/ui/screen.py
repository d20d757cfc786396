"""What stands on the page, as texts, and its way to a scenario: the loader alone says what it means.

A screen is a frozen value, so that undoing a change is going back to the one before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from types import MappingProxyType

from workbench.model.controller import PID
from workbench.model.experiment import Profile, Ramp, Series, Step
from workbench.ui.entry import WRITTEN
from workbench.ui.fields import DEFAULTS, FIELDS
from workbench.ui.trees import case_controller, controller_tree, is_zero, number_text, plant_tree, valve_tree
from workbench.ui.yaml_text import Tree, scalar, words, yaml_of

__all__ = ["ON_SCREEN", "MapView", "Pinned", "Screen", "estimate_text", "scenario_text"]

ON_SCREEN = "On screen"  # the case that is the page's own controller
TUNED = "Tuned"
# What is seen of a map: the ends of Kc (%/EU) and of Ti (s).
MapView = tuple[tuple[float, float], tuple[float, float]]
_CURVE = ("rangeability", "opening")


@dataclass(frozen=True, eq=False)
class Pinned:
    """A case kept to compare with: its name, controller, note, and published figures to show beside ours.

    primary: of a cascade, whose secondary's is `controller` then. key: by which the page names the case, whatever its
    name and place have become since it was shown.
    """

    name: str
    controller: PID
    note: str = ""
    reference: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    primary: PID | None = None
    key: int = field(default_factory=partial(next, count()))


@dataclass(frozen=True, eq=False)
class Screen:
    """Everything that can be typed or pinned.

    entries: text by path (see `fields`), units under `path.unit`. cases: pinned, the first the base of comparison.
    more_setpoint, more_load, more_primary_load: parts of the experiment's profiles beside the step that the fields
    show. cascade: whether it is one, of entries under `cascade.`, and not a loop of entries under `loop.`. record:
    which the scenario names, or the loop was found in. published_of: the loop, experiment and weights that the cases'
    published figures are of, None where they are of none.
    """

    entries: Mapping[str, str] = field(default_factory=lambda: DEFAULTS)
    cases: tuple[Pinned, ...] = ()
    title: str = "A loop with a sticky valve"
    description: str = ""
    reference_source: str = ""
    more_setpoint: tuple[Profile, ...] = ()
    more_load: tuple[Profile, ...] = ()
    more_primary_load: tuple[Profile, ...] = ()
    cascade: bool = False
    record: str = ""
    published_of: object = None

    def with_entries(self, changed: Mapping[str, str]) -> Screen:
        """Return the screen with other texts; unknown paths raise KeyError."""
        for path in changed:
            if path not in DEFAULTS:
                raise KeyError(path)
        return replace(self, entries=MappingProxyType({**self.entries, **changed}))

    def quantity(self, path: str) -> str:
        """Return an entry with its unit, as a scenario writes it; "" where nothing is typed."""
        text = self.entries[path].strip()
        unit = self.entries.get(f"{path}.unit", "")
        # A unit that the field does not know is refused as it was typed behind its number.
        own = text == "none" or (text[:1] in "+-.0123456789" and (text[-1:].isalpha() or text[-1:] == "%"))
        return f"{text} {unit}" if text and not own and unit in WRITTEN else text


def scenario_text(
    screen: Screen, *, cases: bool = True, tune: bool = False, mapped: bool = False, view: MapView | None = None
) -> str:
    """Return the screen as a scenario.

    cases: with the pinned ones; tune: the tuning asked for instead of any case; mapped: with the map asked for, of
    `view` or what suits the loop.

    The page's own controller stands in `loop.controller` and is the first case, `ON_SCREEN`, which takes all of it.
    """
    tree: dict[str, Tree] = {"title": words(screen.title)}
    if screen.description:
        tree["description"] = words(screen.description)
    if screen.reference_source and any(case.reference for case in screen.cases):
        tree["reference_source"] = words(screen.reference_source)
    if screen.cascade:
        tree["cascade"] = _cascade(screen)
    else:
        tree["loop"] = _loop(screen)
    tree["experiment"] = _experiment(screen)
    tree["objective"] = _weights(screen)
    if tune:
        asked: dict[str, Tree] = {"tune_cascade": _tune_cascade(screen)} if screen.cascade else {"tune": _tune(screen)}
        tree["cases"] = [{"name": words(TUNED), **asked}]
    else:
        tree["cases"] = [
            {"name": words(_free(screen))},
            *([_case(screen, case) for case in screen.cases] if cases else []),
        ]
    if mapped:
        plane: dict[str, Tree] = {"points": scalar(screen.entries["analyze.map.points"])}
        if view is not None:
            plane |= {"Kc": [f"{end:.4g}" for end in view[0]], "Ti": [f"{end:.4g} s" for end in view[1]]}
        tree["analyze"] = {"map": plane}
    return yaml_of(tree)


def _free(screen: Screen) -> str:
    """Return the name of the page's own case, which no pinned one has."""
    taken, name, count = {case.name for case in screen.cases}, ON_SCREEN, 2
    while name in taken:
        name, count = f"{ON_SCREEN} {count}", count + 1
    return name


def _loop(screen: Screen) -> dict[str, Tree]:
    entries = screen.entries
    loop: dict[str, Tree] = {
        "plant": plant_tree(entries, screen.quantity, "loop.plant"),
        "valve": valve_tree(entries, screen.quantity, "loop.valve"),
        "controller": controller_tree(entries, screen.quantity, "loop.controller"),
        "sample_time": _typed(screen, "loop.sample_time"),
    }
    loop |= _pv_range(screen, "loop")
    kind = entries["loop.characteristic.type"]
    if kind != "linear":
        shape: dict[str, Tree] = {name: _typed(screen, f"loop.characteristic.{name}") for name in _CURVE}
        loop["characteristic"] = {"type": scalar(kind), **shape}
    if entries["loop.scan"].strip() != "1":
        loop["scan"] = _typed(screen, "loop.scan")
    for name in ("fail_open", "coarse_sampling"):
        if entries[f"loop.{name}"] == "true":
            loop[name] = "true"
    return loop


def _pv_range(screen: Screen, path: str) -> dict[str, Tree]:
    low, high = (screen.quantity(f"{path}.pv_range.{end}") for end in ("low", "high"))
    return {"pv_range": [scalar(low), scalar(high)]} if low or high else {}


def _cascade(screen: Screen) -> dict[str, Tree]:
    entries, quantity = screen.entries, screen.quantity
    tree: dict[str, Tree] = {}
    for name in ("primary", "secondary"):
        path = f"cascade.{name}"
        loop: dict[str, Tree] = {"plant": plant_tree(entries, quantity, f"{path}.plant")}
        if name == "secondary":
            loop["valve"] = valve_tree(entries, quantity, f"{path}.valve")
        loop["controller"] = controller_tree(entries, quantity, f"{path}.controller")
        tree[name] = loop | {"sample_time": _typed(screen, f"{path}.sample_time")} | _pv_range(screen, path)
    for name, usual in (("scale", "1"), ("anti_windup", "clamp")):
        if entries[f"cascade.{name}"].strip() != usual:
            tree[name] = _typed(screen, f"cascade.{name}")
    return tree


def _typed(screen: Screen, path: str) -> str:
    return scalar(screen.quantity(path))


def _experiment(screen: Screen) -> dict[str, Tree]:
    tree: dict[str, Tree] = {"duration": _typed(screen, "experiment.duration")}
    profiles = [("setpoint", "", screen.more_setpoint), ("load", " %", screen.more_load)]
    noises = ["noise"]
    if screen.cascade:
        profiles.append(("primary_load", "", screen.more_primary_load))
        noises.append("secondary_noise")
    for name, unit, more in profiles:
        path = f"experiment.{name}"
        parts: list[Tree] = []
        if not is_zero(screen.entries[f"{path}.step"]):
            parts.append({"step": _typed(screen, f"{path}.step"), "at": _typed(screen, f"{path}.at")})
        parts += [_part(part, unit) for part in more]
        if parts:
            tree[name] = parts[0] if len(parts) == 1 else parts
    for noise in noises:
        if not is_zero(screen.entries[f"experiment.{noise}.sd"]):
            tree[noise] = {name: _typed(screen, f"experiment.{noise}.{name}") for name in ("sd", "seed")}
    if not is_zero(screen.entries["experiment.stem_offset"]):
        tree["stem_offset"] = _typed(screen, "experiment.stem_offset")
    return tree


def _part(part: Profile, unit: str) -> Tree:
    if isinstance(part, Step):
        return {"step": number_text(part.size) + unit, "at": f"{number_text(part.at)} s"}
    if isinstance(part, Ramp):
        ends: dict[str, Tree] = {"start": f"{number_text(part.start)} s", "end": f"{number_text(part.end)} s"}
        return {"ramp": number_text(part.size) + unit, **ends}
    assert isinstance(part, Series)  # noqa: S101 - a profile is one of the three
    tree: dict[str, Tree] = {"series": [number_text(value) for value in part.values]}
    if part.times is not None:
        tree["times"] = [f"{number_text(time)} s" for time in part.times]
    return tree


def _weights(screen: Screen) -> dict[str, Tree]:
    names = [path for path in FIELDS if path.startswith("objective.")]
    given = {path.removeprefix("objective."): screen.entries[path].strip() for path in names}
    return {name: scalar(text) for name, text in given.items() if not is_zero(text)} or {"w1": "0"}


def _tune_cascade(screen: Screen) -> dict[str, Tree]:
    tree: dict[str, Tree] = {}
    if screen.entries["tune_cascade.tuned"] == "both":
        path = "tune_cascade.secondary.experiment"
        alone: dict[str, Tree] = {"duration": _typed(screen, f"{path}.duration")}
        for name, first, second in (("setpoint", "step", "at"), ("load", "step", "at"), ("noise", "sd", "seed")):
            if not is_zero(screen.entries[f"{path}.{name}.{first}"]):
                alone[name] = {one: _typed(screen, f"{path}.{name}.{one}") for one in (first, second)}
        tree["secondary"] = _bounds(screen, "tune_cascade.secondary") | {"experiment": alone}
    tree["primary"] = _bounds(screen, "tune_cascade.primary")
    return tree | {name: _typed(screen, f"tune.{name}") for name in ("digits", "restarts", "seed")}


def _bounds(screen: Screen, path: str) -> dict[str, Tree]:
    """Return the bounds of a search, with Td held at 0 for a PI."""
    bounds: dict[str, Tree] = {
        name: [_typed(screen, f"{path}.bounds.{name}.{end}") for end in ("low", "high")] for name in ("Kc", "Ti", "Td")
    }
    if screen.entries[f"{path}.kind"] != "PI":
        return {"bounds": bounds}
    del bounds["Td"]
    return {"bounds": bounds, "Td": "0 s"}


def _tune(screen: Screen) -> dict[str, Tree]:
    entries = screen.entries
    tree = _bounds(screen, "tune")
    for name in ("digits", "restarts", "seed"):
        tree[name] = _typed(screen, f"tune.{name}")
    if entries["tune.robust"] == "true":
        tree["robust"] = "true"
    asked = {name: screen.quantity(f"tune.constraints.{name}") for name in ("max_sensitivity", "valve_travel")}
    kept: dict[str, Tree] = {name: scalar(text) for name, text in asked.items() if text}
    if kept:
        tree["constraints"] = kept
    return tree


def _case(screen: Screen, case: Pinned) -> dict[str, Tree]:
    entries = screen.entries
    tree: dict[str, Tree] = {"name": words(case.name)}
    if case.primary is None:
        tree |= case_controller(case.controller, entries, "loop.controller")
    else:
        tree["primary"] = case_controller(case.primary, entries, "cascade.primary.controller", "")
        tree["secondary"] = case_controller(case.controller, entries, "cascade.secondary.controller")
    if case.note:
        tree["note"] = words(case.note)
    if case.reference:
        tree["reference"] = {name: number_text(value) for name, value in case.reference.items()}
    return tree


def estimate_text(screen: Screen, data: str) -> str:
    """Return the scenario that estimates from the file `data`, which lies beside it."""
    entries = screen.entries
    tree: dict[str, Tree] = {"data": words(data)}
    columns = {name: entries[f"estimate.columns.{name}"].strip() for name in ("time", "SP", "PV", "OP")}
    named: dict[str, Tree] = {name: words(text) for name, text in columns.items() if text}
    if named:
        tree["columns"] = named
    if screen.quantity("estimate.sample_time"):
        tree["sample_time"] = _typed(screen, "estimate.sample_time")
    low, high = (screen.quantity(f"estimate.op_range.{end}") for end in ("low", "high"))
    if low or high:
        tree["op_range"] = [scalar(low), scalar(high)]
    for name in ("method", "valve", "plant"):
        tree[name] = scalar(entries[f"estimate.{name}"])
    return yaml_of({"title": words(f"Estimate of {data}"[:80]), "estimate": tree})
