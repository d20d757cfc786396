"""What results.json holds of a loop's parts and of a search, by the names of their fields."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from workbench.model.controller import PID
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.results import Robustness, Tuned
from workbench.model.tuning import Objective
from workbench.model.valve import Directional, Positional, Valve

__all__ = [
    "controller_content",
    "loop_content",
    "plain",
    "plant_content",
    "robustness_content",
    "tuned_content",
    "valve_content",
    "weights_content",
]


def plain(value: Any) -> dict[str, Any]:
    """Return a value's fields by name."""
    return {f.name: getattr(value, f.name) for f in fields(value)}


def weights_content(objective: Objective) -> dict[str, float]:
    """Return an objective's weights, those of eq. (2) and of further figures."""
    return {name: getattr(objective, name) for name in ("w1", "w2", "w3", "w4")} | dict(objective.kpis)


def controller_content(controller: PID) -> dict[str, Any]:
    """Return a controller in full; a resolution and a compensator are there only where it has one."""
    content = plain(controller)
    if controller.output_resolution == 0.0:
        del content["output_resolution"]
    given = content.pop("compensator")
    if given is not None:
        content["compensator"] = {"type": type(given).__name__, **plain(given)}
    return {"form": controller.form, "structure": controller.structure, **content}


def plant_content(plant: Plant) -> dict[str, Any]:
    """Return a plant and its type."""
    return {"type": "fopdt" if isinstance(plant, FOPDT) else "integrating", **plain(plant)}


def valve_content(valve: Valve) -> dict[str, Any]:
    """Return a valve and its type; of one that differs by direction or place its parts."""
    if isinstance(valve, Directional):
        parts: dict[str, Any] = {"up": plain(valve.up), "down": plain(valve.down)}
    elif isinstance(valve, Positional):
        parts = {"positions": valve.positions, "valves": [valve_content(one) for one in valve.valves]}
    else:
        parts = plain(valve)
    return {"type": type(valve).__name__.lower(), **parts}


def loop_content(loop: Loop) -> dict[str, Any]:
    """Return plant, valve, sample time and further elements of a loop."""
    content = {"plant": plant_content(loop.plant), "valve": valve_content(loop.valve), "sample_time": loop.sample_time}
    if loop.characteristic is not None:
        content["characteristic"] = {"type": "equal_percentage", **plain(loop.characteristic)}
    more = {"fail_open": loop.fail_open, "scan": loop.scan if loop.scan > 1 else 0}
    return content | {name: value for name, value in more.items() if value}


def tuned_content(name: str, tuned: Tuned) -> dict[str, Any]:
    """Return what results.json holds of a search."""
    best, worst = tuned.spread
    return {
        "name": name,
        "status": tuned.status.name.lower(),
        "message": tuned.message,
        "weights": weights_content(tuned.weights),
        "bounds": plain(tuned.bounds),
        "digits": tuned.digits,
        "objective": tuned.objective,
        "nominal": tuned.nominal,
        "worst": tuned.worst,
        "worst_bound": tuned.worst_bound,
        "margin": tuned.margin,
        "start_objective": tuned.start_objective,
        "guard_margin": tuned.guard_margin,
        "slips": tuned.slips,
        "nominal_only": tuned.nominal_only,
        "knife_edge": tuned.knife_edge,
        "agreeing": tuned.agreeing,
        "steps": [plain(step) for step in tuned.steps],
        "seed": tuned.seed,
        "spread": {"best": best, "worst": worst},
        "restarts": [plain(r) for r in tuned.restarts],
        "evaluations": tuned.evaluations,
        "solves": tuned.solves,
        "iterations": tuned.iterations,
        **_robust(tuned),
    }


def _robust(tuned: Tuned) -> dict[str, Any]:
    """Return a tuning's constraints, ensemble and figures over it, as far as it has them."""
    content = {} if tuned.constraints is None else {"constraints": plain(tuned.constraints)}
    if tuned.ensemble is None or tuned.robustness is None:
        return content
    return {**content, "ensemble": plain(tuned.ensemble), "robustness": robustness_content(tuned.robustness)}


def robustness_content(found: Robustness) -> dict[str, Any]:
    """Return a tuning's figures over an ensemble."""
    names = ("mse_mean", "mse_median", "mse_p90", "travel_mean", "travel_median", "diverged", "stable")
    return {
        "draws": found.ensemble.draws,
        "seed": found.ensemble.seed,
        "objective": found.objective,
        **{name: getattr(found, name) for name in (*names, "max_sensitivity", "gain_margin", "phase_margin")},
    }
