"""From a checked scenario, or a loop that was found, to the screen that shows it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from workbench.model.cascade import Cascade, CascadeExperiment
from workbench.model.checks import reads_as_number
from workbench.model.controller import PID
from workbench.model.ensemble import Constraints
from workbench.model.experiment import Profile, Step
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Choudhury, Deadband, Directional, He, Positional, Stenman, Valve
from workbench.scenario import units
from workbench.scenario.document import parse, plain
from workbench.scenario.plan import CascadeTuneJob, EnsembleJob, RobustJob, Scenario, TuneJob
from workbench.ui.fields import DEFAULTS, FIELDS, OWN_WEIGHT
from workbench.ui.loop_fields import VALVES
from workbench.ui.screen import ON_SCREEN, Pinned, Screen
from workbench.ui.trees import compensator_texts, number_text

# Of a loop without cases of its own: what stands in the file stands on the page.
_ROOTS = ("loop.", "cascade.", "experiment.")
NO_LOOP_YET = (
    "The scenario's loop comes from its record: until that is estimated and its model used, the loop shown is this "
    "page's own example."
)
_OWN_OBJECTIVE = "A tuning's own objective is left out here: the page has one for all."
_AS_WRITTEN = re.compile(r"(loop|cascade\.primary|cascade\.secondary)\.(plant|sample_time)")

__all__ = [
    "NO_LOOP_YET",
    "Loaded",
    "bounds_entries",
    "controller_entries",
    "plant_entries",
    "screen_of",
    "valve_entries",
]


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

    """
    notes = [*plan.notes]
    first = plan.cases[0].controller if plan.cases else None if plan.loop is None else plan.loop.controller
    entries: dict[str, str] = _cascade(plan.cascade[0].cascade) if plan.cascade else {}
    if plan.loop is not None:
        entries |= plant_entries(plan.loop.plant) | valve_entries(plan.loop.valve)
        entries |= time_entry("loop.sample_time", plan.loop.sample_time) | _elements(plan.loop)
    elif plan.estimates and plan.estimates[0].record is not None:
        notes.append(NO_LOOP_YET)
    notes += _left_of_estimate(_written(plan).get("estimate"))
    if first is not None:
        entries |= controller_entries(first)
    if plan.site is not None or plan.cascade_site is not None:
        notes.append("How the site writes its settings (site:) is left out here: the page has them in %/EU and s.")
    if plan.pv_range is not None:
        entries |= _ends("loop.pv_range", plan.pv_range)
    more: dict[str, tuple[Profile, ...]] = {"setpoint": (), "load": (), "primary_load": ()}
    if plan.experiment is not None:
        experiment = plan.experiment
        entries |= time_entry("experiment.duration", experiment.duration)
        profiles = {"setpoint": experiment.setpoint_parts, "load": experiment.load_parts}
        noises = {"noise": experiment.noise}
        if isinstance(experiment, CascadeExperiment):
            profiles["primary_load"] = experiment.primary_load_parts
            noises["secondary_noise"] = experiment.secondary_noise
        for name, parts in profiles.items():
            entries |= _step(name, parts)
            more[name] = _beside(parts)
        entries["experiment.stem_offset"] = number_text(experiment.stem_offset)
        for name, noise in noises.items():
            if noise is not None:
                entries[f"experiment.{name}.sd"] = number_text(noise.sd)
                entries[f"experiment.{name}.seed"] = str(noise.seed)
    for name, parts in more.items():
        if parts:
            many = "1 more part, kept as it is" if len(parts) == 1 else f"{len(parts)} more parts, kept as they are"
            notes.append(f"The {name.replace('_', ' ')} has {many}.")
    if plan.objective is not None:
        entries |= _objective(plan.objective)
    entries |= _typed(plan)
    cases = []
    for i, case in enumerate(plan.cases):
        # A rule that waits for the loop, or for a tuning, has no gain yet.
        known = case.tune is None and (case.rule is None or case.controller.Kc > 0.0)
        if known and not (i == 0 and _is_own(plan)):
            cases.append(Pinned(case.name, case.controller, case.note, dict(case.reference)))
    asked = next((case.tune for case in plan.cases if case.tune is not None), None)
    if asked is not None:
        entries |= _tune(asked, notes, plan.objective)
    for i, job in enumerate(plan.cascade):
        if job.tune is None and not (i == 0 and _is_own(plan)):
            outer, inner = job.cascade.primary.controller, job.cascade.secondary.controller
            cases.append(Pinned(job.name, inner, job.note, primary=outer))
    in_turn = next((job.tune for job in plan.cascade if job.tune is not None), None)
    if in_turn is not None:
        entries |= _tune_cascade(in_turn, notes, plan.objective)
    open_ones = [job.name for job in plan.cascade if job.tune is not None]
    open_ones += [c.name for c in plan.cases if c.tune is not None or (c.rule is not None and c.controller.Kc == 0.0)]
    if open_ones:
        notes.append(f"Not shown, since still to be found: {', '.join(open_ones)}.")
    record = plan.estimates[0].record if plan.estimates else None
    source = "" if record is None else record.source
    screen = Screen(
        cases=tuple(cases),
        title=plan.title,
        description=plan.description,
        reference_source=plan.reference_source,
        more_setpoint=more["setpoint"],
        more_load=more["load"],
        more_primary_load=more["primary_load"],
        cascade=bool(plan.cascade),
        record=source,
    ).with_entries(entries)
    return Loaded(screen, tuple(notes), source)


def _cascade(cascade: Cascade) -> dict[str, str]:
    """Return the entries of a cascade."""
    entries = {"cascade.scale": number_text(cascade.scale), "cascade.anti_windup": cascade.anti_windup}
    entries |= valve_entries(cascade.secondary.valve, "cascade.secondary.valve")
    for name, loop in (("primary", cascade.primary), ("secondary", cascade.secondary)):
        path = f"cascade.{name}"
        entries |= plant_entries(loop.plant, f"{path}.plant") | time_entry(f"{path}.sample_time", loop.sample_time)
        entries |= controller_entries(loop.controller, f"{path}.controller")
        if loop.pv_range is not None:
            entries |= _ends(f"{path}.pv_range", loop.pv_range)
    return entries


def plant_entries(plant: Plant, path: str = "loop.plant") -> dict[str, str]:
    """Return the entries of a plant."""
    entries = {f"{path}.gain": number_text(plant.gain)} | time_entry(f"{path}.dead_time", plant.dead_time)
    if isinstance(plant, FOPDT):
        return entries | {f"{path}.type": "fopdt"} | time_entry(f"{path}.time_constant", plant.time_constant)
    return entries | {f"{path}.type": "integrating"}


def valve_entries(valve: Valve, path: str = "loop.valve") -> dict[str, str]:
    """Return the entries of a valve; stiction along the travel as scenarios know it, of `Stenman` or `Choudhury`."""
    kind = type(valve).__name__.lower()
    if isinstance(valve, Positional):
        lines = [
            " ".join(number_text(v) for v in (x, *_friction(at)))
            for x, at in zip(valve.positions, valve.valves, strict=True)
        ]
        values = {"places": "\n".join(lines)}
    elif isinstance(valve, Directional):
        ways = {"up": valve.up, "down": valve.down}
        values = {
            f"{way}.{name}": number_text(x)
            for way, one in ways.items()
            for name, x in zip("SJ", _friction(one), strict=True)
        }
    else:
        values = {name: number_text(getattr(valve, name)) for name in VALVES[kind]}
    entries = {f"{path}.type": kind} | {f"{path}.{name}": text for name, text in values.items()}
    return entries | ({f"{path}.substep.unit": "s"} if kind == "karnopp" else {})


def _friction(valve: Stenman | He | Choudhury | Deadband) -> tuple[float, ...]:
    return (valve.d,) if isinstance(valve, Stenman) else (valve.stick_band, valve.slip_jump)


def _elements(loop: Loop) -> dict[str, str]:
    """Return the entries of what few loops have beside plant, valve and controller."""
    entries = {"loop.scan": str(loop.scan), "loop.fail_open": "true" if loop.fail_open else "false"}
    curve = loop.characteristic
    if curve is None:
        return entries | {"loop.characteristic.type": "linear"}
    shape = {name: number_text(getattr(curve, name)) for name in ("rangeability", "opening")}
    path = "loop.characteristic"
    return entries | {f"{path}.type": "equal_percentage"} | {f"{path}.{name}": text for name, text in shape.items()}


def controller_entries(pid: PID, path: str = "loop.controller") -> dict[str, str]:
    """Return the entries of a controller; gains in the first unit of their field, %/EU, times in s."""
    entries = {f"{path}.Kc": number_text(pid.Kc), f"{path}.Kc.unit": FIELDS[f"{path}.Kc"].units[0]}
    entries |= time_entry(f"{path}.Ti", pid.Ti) | time_entry(f"{path}.Td", pid.Td)
    entries |= {
        f"{path}.form": pid.form,
        f"{path}.structure": pid.structure or OWN_WEIGHT,
        f"{path}.action": pid.action,
    }
    entries[f"{path}.derivative_filter"] = number_text(pid.derivative_filter)
    if pid.structure is None:
        entries[f"{path}.derivative_on"] = pid.derivative_on
        entries[f"{path}.setpoint_weight"] = number_text(pid.setpoint_weight)
    entries[f"{path}.limited"] = "false" if pid.output_limits is None else "true"
    entries[f"{path}.anti_windup"] = pid.anti_windup
    if pid.output_limits is not None:
        entries |= _ends(f"{path}.output_limits", pid.output_limits)
    tracking = "" if pid.tracking_time is None else number_text(pid.tracking_time)
    entries |= {f"{path}.tracking_time": tracking, f"{path}.tracking_time.unit": "s"}
    entries[f"{path}.output_resolution"] = number_text(pid.output_resolution)
    entries[f"{path}.compensator.type"] = "none"
    if pid.compensator is not None:
        kind, texts = compensator_texts(pid.compensator)
        under = f"{path}.compensator"
        entries |= {f"{under}.type": kind} | {f"{under}.{name}": text for name, text in texts.items()}
        entries |= {f"{under}.{name}.unit": "s" for name in texts if "s" in FIELDS[f"{under}.{name}"].units}
    return entries


def bounds_entries(bounds: Bounds, path: str = "tune") -> dict[str, str]:
    """Return the entries of a search's bounds: a PI where Td is held at 0."""
    entries = _ends(f"{path}.bounds.Kc", bounds.Kc)
    for name in ("Ti", "Td"):
        pair = getattr(bounds, name)
        entries |= _ends(f"{path}.bounds.{name}", pair)
        entries |= {f"{path}.bounds.{name}.{end}.unit": "s" for end in ("low", "high")}
    entries[f"{path}.kind"] = "PI" if bounds.Td == (0.0, 0.0) else "PID"
    if entries[f"{path}.kind"] == "PI":
        entries[f"{path}.bounds.Td.high"] = DEFAULTS[f"{path}.bounds.Td.high"]
    return entries


def _tune(asked: TuneJob, notes: list[str], common: Objective | None) -> dict[str, str]:
    """Return the entries of a loop's tuning, and note what of it the page has no entry for."""
    entries = bounds_entries(asked.bounds) | _search(asked)
    entries["tune.robust"] = "true" if asked.robust is not None else "false"
    kept = asked.constraints or Constraints()
    for name in ("max_sensitivity", "valve_travel"):
        value = getattr(kept, name)
        entries[f"tune.constraints.{name}"] = "" if value is None else number_text(value)
    robust = asked.robust or RobustJob(EnsembleJob())
    left = {
        "a gain margin": kept.gain_margin is not None,
        "a phase margin": kept.phase_margin is not None,
        "nominal": asked.nominal,
        "an ensemble of its own": bool(robust.ensemble.given),
        "a travel budget": robust.travel_budget is not None or bool(robust.as_case),
    }
    if any(left.values()):
        names = ", ".join(name for name, given in left.items() if given)
        notes.append(f"Left out of the tuning that the scenario asks for: {names}. The page has no entry for it.")
    if asked.objective != (common or Objective()):
        notes.append(_OWN_OBJECTIVE)
    return entries


def _tune_cascade(asked: CascadeTuneJob, notes: list[str], common: Objective | None) -> dict[str, str]:
    """Return the entries of a cascade's tuning in turn."""
    entries = bounds_entries(asked.bounds, "tune_cascade.primary") | _search(asked)
    entries["tune_cascade.tuned"] = "primary" if asked.secondary is None else "both"
    weighed = [asked.objective]
    if asked.secondary is not None:
        experiment, objective, bounds = asked.secondary
        weighed.append(objective)
        path = "tune_cascade.secondary"
        entries |= bounds_entries(bounds, path) | time_entry(f"{path}.experiment.duration", experiment.duration)
        for name, parts in (("setpoint", experiment.setpoint_parts), ("load", experiment.load_parts)):
            entries |= _step(name, parts, f"{path}.experiment")
            if _beside(parts):
                notes.append(f"Of the secondary's own experiment the {name}'s first step alone stands here.")
        noise = experiment.noise
        entries[f"{path}.experiment.noise.sd"] = "0" if noise is None else number_text(noise.sd)
        if noise is not None:
            entries[f"{path}.experiment.noise.seed"] = str(noise.seed)
    if any(objective != (common or Objective()) for objective in weighed):
        notes.append(_OWN_OBJECTIVE)
    return entries


def _search(asked: TuneJob | CascadeTuneJob) -> dict[str, str]:
    """Return the entries of how a tuning is searched for."""
    digits = DEFAULTS["tune.digits"] if asked.digits is None else str(asked.digits)
    return {"tune.digits": digits, "tune.restarts": str(asked.restarts), "tune.seed": str(asked.seed)}


def time_entry(path: str, seconds: float) -> dict[str, str]:
    """Return a time's entry in s."""
    return {path: number_text(seconds), f"{path}.unit": "s"}


def _ends(path: str, pair: tuple[float, float]) -> dict[str, str]:
    return {f"{path}.low": number_text(pair[0]), f"{path}.high": number_text(pair[1])}


def _step(name: str, parts: tuple[Profile, ...], under: str = "experiment") -> dict[str, str]:
    first = next((part for part in parts if isinstance(part, Step)), Step(0.0))
    path = f"{under}.{name}"
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
        if not isinstance(value, str) or not field.units or not path.startswith(_ROOTS):
            continue
        if not (_is_own(plan) or path.startswith("experiment.") or _AS_WRITTEN.match(path)):
            continue
        number, _, unit = value.strip().partition(" ")
        if unit in field.units and reads_as_number(number):
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
        if not field.units:
            entries[path] = str(value)
        elif unit in field.units:
            entries |= {path: number, f"{path}.unit": unit}
        else:
            entries |= time_entry(path, units.time(str(value)))
    return entries


def _left_of_estimate(given: object) -> tuple[str, ...]:
    """Return what a scenario's first estimate says of its record that the page has no field for, in words."""
    first = given[0] if isinstance(given, list) and given else given
    if not isinstance(first, Mapping) or "data" not in first:
        return ()
    told = [name for name in ("tags", "pv_range", "max_gap", "start") if name in first]
    told += [f"columns.{name}" for name in _under(first, "columns") if f"estimate.columns.{name}" not in FIELDS]
    if not told:
        return ()
    names = ", ".join(told)
    return (f"Left out of how the scenario reads and estimates its record: {names}. The page has no field for it.",)


def _written(plan: Scenario) -> Mapping[str, object]:
    root, _ = parse(plan.text)
    data = None if root is None else plain(root)
    return data if isinstance(data, Mapping) else {}


def _under(data: Mapping[str, object], name: str) -> Mapping[str, object]:
    inside = data.get(name)
    return inside if isinstance(inside, Mapping) else {}


def _is_own(plan: Scenario) -> bool:
    """Return whether the first case is a page's own controller, which stands in loop.controller."""
    cases = _written(plan).get("cases")
    first = cases[0] if isinstance(cases, list) and cases else None
    return isinstance(first, Mapping) and list(first) == ["name"] and str(first["name"]).startswith(ON_SCREEN)
