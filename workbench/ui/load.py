"""From a checked scenario, or a loop that was found, to the screen that shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from workbench.errors import ScenarioError
from workbench.model.controller import PID
from workbench.model.experiment import Profile, Step
from workbench.model.karnopp import Karnopp
from workbench.model.plant import FOPDT, Plant
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Choudhury, Deadband, Directional, He, Ideal, Kano, Positional, Stenman, Valve
from workbench.scenario.document import parse, plain
from workbench.scenario.plan import Scenario
from workbench.ui.fields import DEFAULTS, FIELDS, OWN_WEIGHT
from workbench.ui.screen import ON_SCREEN, Pinned, Screen, number_text

__all__ = ["Loaded", "bounds_entries", "controller_entries", "plant_entries", "screen_of", "valve_entries"]


@dataclass(frozen=True, eq=False)
class Loaded:
    """A scenario's screen, and what of the scenario it does not show, in words. data: the record to estimate, or ""."""

    screen: Screen
    notes: tuple[str, ...]
    data: str = ""


def screen_of(plan: Scenario) -> Loaded:
    """Return the screen that shows a scenario: its loop, experiment, objective and the cases whose tuning is known.

    The page's own controller is the first case's. That case is no pinned one where it is the page's own, as
    `scenario_text` writes it.

    Raises `ScenarioError` where the page has no entry for a part of the scenario: it shows no other loop instead.
    """
    missing = _not_on_the_page(plan)
    if missing:
        raise ScenarioError(
            f"{plan.path.name}: {', '.join(missing)}: this page has no entry for that; the scenario runs with "
            "`workbench run`"
        )
    notes = [*plan.warnings, *plan.notes]
    first = plan.cases[0].controller if plan.cases else None if plan.loop is None else plan.loop.controller
    entries: dict[str, str] = {}
    if plan.loop is not None:
        entries |= plant_entries(plan.loop.plant) | valve_entries(plan.loop.valve)
        entries |= time_entry("loop.sample_time", plan.loop.sample_time)
    elif plan.estimates and plan.estimates[0].record is not None:
        notes.append(
            "The scenario's loop comes from its record: until that is estimated and its model used, the loop shown is "
            "this page's own example."
        )
    if first is not None:
        entries |= controller_entries(first)
    if plan.site is not None:
        notes.append("How the site writes its settings (site:) is left out here: the page has them in %/EU and s.")
    if plan.pv_range is not None:
        entries |= _ends("loop.pv_range", plan.pv_range)
    more: dict[str, tuple[Profile, ...]] = {"setpoint": (), "load": ()}
    if plan.experiment is not None:
        experiment = plan.experiment
        entries |= time_entry("experiment.duration", experiment.duration)
        for name, parts in (("setpoint", experiment.setpoint_parts), ("load", experiment.load_parts)):
            entries |= _step(name, parts)
            more[name] = _beside(parts)
        entries["experiment.stem_offset"] = number_text(experiment.stem_offset)
        if experiment.noise is not None:
            entries["experiment.noise.sd"] = number_text(experiment.noise.sd)
            entries["experiment.noise.seed"] = str(experiment.noise.seed)
    for name, parts in more.items():
        if parts:
            notes.append(f"The {name} has {len(parts)} more part{'s' if len(parts) > 1 else ''}, kept as they are.")
    if plan.objective is not None:
        weights = _objective(plan.objective)
        unshown = [name for name in dict(plan.objective.kpis) if f"objective.{name}" not in FIELDS]
        if any(float(weight) > 0.0 for weight in weights.values()):
            entries |= weights
            if unshown:
                notes.append(f"The objective also weighs {', '.join(unshown)}: this page leaves that out.")
        else:
            notes.append(
                "The objective weighs figures that this page has no entry for: the page keeps its own, w1 and w3."
            )
    entries |= _typed(plan)
    cases = []
    for i, case in enumerate(plan.cases):
        # A rule that waits for the loop, or for a tuning, has no gain yet.
        known = case.tune is None and (case.rule is None or case.controller.Kc > 0.0)
        if known and not (i == 0 and _is_own(plan)):
            cases.append(Pinned(case.name, case.controller, case.note, dict(case.reference)))
    asked = next((case.tune for case in plan.cases if case.tune is not None), None)
    if asked is not None:
        entries |= bounds_entries(asked.bounds)
        entries["tune.robust"] = "true" if asked.robust is not None else "false"
    open_ones = [c.name for c in plan.cases if c.tune is not None or (c.rule is not None and c.controller.Kc == 0.0)]
    if open_ones:
        notes.append(f"Not shown, since still to be found: {', '.join(open_ones)}.")
    screen = Screen(
        cases=tuple(cases),
        title=plan.title,
        description=plan.description,
        reference_source=plan.reference_source,
        more_setpoint=more["setpoint"],
        more_load=more["load"],
    ).with_entries(entries)
    record = plan.estimates[0].record if plan.estimates else None
    return Loaded(screen, tuple(notes), record.source if record is not None else "")


def plant_entries(plant: Plant) -> dict[str, str]:
    """Return the entries of a plant."""
    entries = {"loop.plant.gain": number_text(plant.gain)} | time_entry("loop.plant.dead_time", plant.dead_time)
    if isinstance(plant, FOPDT):
        entries |= {"loop.plant.type": "fopdt"} | time_entry("loop.plant.time_constant", plant.time_constant)
    else:
        entries["loop.plant.type"] = "integrating"
    return entries


def valve_entries(valve: Valve) -> dict[str, str]:
    """Return the entries of a valve."""
    match valve:
        case Ideal():
            kind, values = "ideal", {}
        case Stenman():
            kind, values = "stenman", {"d": valve.d}
        case He():
            kind, values = "he", {"fs": valve.fs, "fd": valve.fd}
        case Kano():
            kind, values = "kano", {"S": valve.S, "J": valve.J}
        case Choudhury():
            kind, values = "choudhury", {"S": valve.S, "J": valve.J}
        case Deadband():
            kind, values = "deadband", {"b": valve.b}
        case Directional():
            kind, values = "directional", {}
            for way in ("up", "down"):
                one = getattr(valve, way)
                values |= {f"{way}.S": one.stick_band, f"{way}.J": one.slip_jump}
    return {"loop.valve.type": kind, **{f"loop.valve.{name}": number_text(v) for name, v in values.items()}}


def controller_entries(pid: PID) -> dict[str, str]:
    """Return the entries of a controller; gains in %/EU, times in s."""
    path = "loop.controller."
    entries = {f"{path}Kc": number_text(pid.Kc), f"{path}Kc.unit": "%/EU"}
    entries |= time_entry(f"{path}Ti", pid.Ti) | time_entry(f"{path}Td", pid.Td)
    entries |= {f"{path}form": pid.form, f"{path}structure": pid.structure or OWN_WEIGHT, f"{path}action": pid.action}
    entries[f"{path}derivative_filter"] = number_text(pid.derivative_filter)
    if pid.structure is None:
        entries[f"{path}derivative_on"] = pid.derivative_on
        entries[f"{path}setpoint_weight"] = number_text(pid.setpoint_weight)
    entries[f"{path}limited"] = "false" if pid.output_limits is None else "true"
    entries[f"{path}anti_windup"] = pid.anti_windup
    if pid.output_limits is not None:
        entries |= _ends(f"{path}output_limits", pid.output_limits)
    tracking = "" if pid.tracking_time is None else number_text(pid.tracking_time)
    return entries | {f"{path}tracking_time": tracking, f"{path}tracking_time.unit": "s"}


def bounds_entries(bounds: Bounds) -> dict[str, str]:
    """Return the entries of a search's bounds: a PI where Td is held at 0."""
    entries = _ends("tune.bounds.Kc", bounds.Kc)
    for name in ("Ti", "Td"):
        pair = getattr(bounds, name)
        entries |= _ends(f"tune.bounds.{name}", pair)
        entries |= {f"tune.bounds.{name}.{end}.unit": "s" for end in ("low", "high")}
    entries["tune.kind"] = "PI" if bounds.Td == (0.0, 0.0) else "PID"
    if entries["tune.kind"] == "PI":
        entries["tune.bounds.Td.high"] = DEFAULTS["tune.bounds.Td.high"]
    return entries


def time_entry(path: str, seconds: float) -> dict[str, str]:
    """Return a time's entry in s."""
    return {path: number_text(seconds), f"{path}.unit": "s"}


def _ends(path: str, pair: tuple[float, float]) -> dict[str, str]:
    return {f"{path}.low": number_text(pair[0]), f"{path}.high": number_text(pair[1])}


def _step(name: str, parts: tuple[Profile, ...]) -> dict[str, str]:
    first = next((part for part in parts if isinstance(part, Step)), Step(0.0))
    path = f"experiment.{name}"
    return {f"{path}.step": number_text(first.size)} | time_entry(f"{path}.at", first.at)


def _beside(parts: tuple[Profile, ...]) -> tuple[Profile, ...]:
    """Return the parts that the fields do not show: all but the first step."""
    shown = next((i for i, part in enumerate(parts) if isinstance(part, Step)), -1)
    return tuple(part for i, part in enumerate(parts) if i != shown)


def _objective(objective: Objective) -> dict[str, str]:
    values = dict(zip(("w1", "w2", "w3", "w4"), objective.weights, strict=True)) | dict(objective.kpis)
    names = [path.removeprefix("objective.") for path in FIELDS if path.startswith("objective.")]
    return {f"objective.{name}": number_text(values.get(name, 0.0)) for name in names}


def _typed(plan: Scenario) -> dict[str, str]:
    """Return the entries whose text and unit the scenario's file writes as the page would: "1 h" stays "1 h"."""
    data = _written(plan)
    entries: dict[str, str] = {}
    for path, field in FIELDS.items():
        value: object = data
        for name in path.split("."):
            value = value.get(name) if isinstance(value, Mapping) else None
        own = path.startswith(("loop.plant", "loop.sample", "experiment.")) or _is_own(plan)
        if not own or not field.units or not isinstance(value, str) or not path.startswith(("loop.", "experiment.")):
            continue
        number, _, unit = value.strip().partition(" ")
        if unit in field.units and _is_number(number):
            entries |= {path: number, f"{path}.unit": unit}
    entries |= _estimate(data.get("estimate"))
    loop = _under(data, "loop")
    band = _under(loop, "controller").get("proportional_band")
    if _is_own(plan) and isinstance(band, int | float | str):
        entries |= {"loop.controller.Kc": str(band).replace("%", "").strip(), "loop.controller.Kc.unit": "PB %"}
    entries["loop.coarse_sampling"] = "true" if loop.get("coarse_sampling") is True else "false"
    return entries


def _estimate(given: object) -> dict[str, str]:
    """Return how a scenario's first estimate is to be read and made, as far as the page has fields for it."""
    first = given[0] if isinstance(given, list) and given else given
    entries: dict[str, str] = {}
    if not isinstance(first, Mapping):
        return entries
    for path, field in FIELDS.items():
        group, _, rest = path.partition(".")
        if group != "estimate":
            continue
        name, _, inner = rest.partition(".")
        value = first.get(name)
        if isinstance(value, list) and inner:
            value = value[0] if inner == "low" else value[1]
        elif isinstance(value, Mapping):
            value = value.get(inner)
        if value is None:
            continue
        number, _, unit = str(value).strip().partition(" ")
        entries |= {path: number, f"{path}.unit": unit} if field.units else {path: str(value)}
        if field.units and unit not in field.units:
            entries[f"{path}.unit"] = field.units[0]
    return entries


def _written(plan: Scenario) -> Mapping[str, object]:
    root, _ = parse(plan.text)
    data = None if root is None else plain(root)
    return data if isinstance(data, Mapping) else {}


def _under(data: Mapping[str, object], name: str) -> Mapping[str, object]:
    inside = data.get(name)
    return inside if isinstance(inside, Mapping) else {}


def _not_on_the_page(plan: Scenario) -> list[str]:
    """Return what of a scenario the page cannot show, in words."""
    controllers = [case.controller for case in plan.cases]
    found = ["a cascade"] if plan.cascade else []
    if plan.loop is not None:
        loop = plan.loop
        controllers.append(loop.controller)
        if isinstance(loop.valve, Positional | Karnopp):
            found.append(f"a valve of type {type(loop.valve).__name__.lower()}")
        if loop.characteristic is not None:
            found.append("a valve's characteristic")
        if loop.fail_open:
            found.append("a fail-open valve")
        if loop.scan != 1:
            found.append("a controller's scan")
    if any(c.compensator is not None for c in controllers):
        found.append("a compensator")
    if any(c.output_resolution > 0.0 for c in controllers):
        found.append("an output resolution")
    return found


def _is_own(plan: Scenario) -> bool:
    """Return whether the first case is a page's own controller, which stands in loop.controller."""
    cases = _written(plan).get("cases")
    first = cases[0] if isinstance(cases, list) and cases else None
    return isinstance(first, Mapping) and list(first) == ["name"] and str(first["name"]).startswith(ON_SCREEN)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
