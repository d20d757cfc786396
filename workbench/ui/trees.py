"""Plants, valves and controllers as the mappings that scenarios hold: from what is typed, and from the model's values.

`path` is where such a mapping stands in a scenario, and the beginning of its entries' paths; `quantity` returns an
entry with its unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

from workbench.model.compensator import (
    Compensator,
    ConstantReinforcement,
    Dither,
    IntegralDeadband,
    Knocker,
    TwoMove,
)
from workbench.model.controller import PID, STRUCTURES
from workbench.ui.loop_fields import COMPENSATORS, OWN_WEIGHT, VALVES
from workbench.ui.yaml_text import Tree, scalar

__all__ = [
    "case_controller",
    "compensator_texts",
    "controller_tree",
    "is_zero",
    "number_text",
    "plant_tree",
    "valve_tree",
]

Quantity = Callable[[str], str]
Entries = Mapping[str, str]


def number_text(value: float) -> str:
    """Return a number with every digit that it has, as it is typed: "5", "0.1", "none" for infinity."""
    if math.isinf(value):
        return "none" if value > 0 else "-.inf"
    text = repr(float(value))
    return text.removesuffix(".0")


def is_zero(text: str) -> bool:
    """Whether a text is a number, and 0."""
    try:
        return float(text) == 0.0
    except ValueError:
        return False


def plant_tree(entries: Entries, quantity: Quantity, path: str) -> dict[str, Tree]:
    """Return the plant that is typed."""
    kind = entries[f"{path}.type"]
    names = ("gain", "dead_time") if kind == "integrating" else ("gain", "time_constant", "dead_time")
    tree: dict[str, Tree] = {"type": scalar(kind)}
    return tree | {name: scalar(quantity(f"{path}.{name}")) for name in names}


def valve_tree(entries: Entries, quantity: Quantity, path: str) -> dict[str, Tree]:
    """Return the valve that is typed."""
    kind = entries[f"{path}.type"]
    tree: dict[str, Tree] = {"type": scalar(kind)}
    for name in VALVES.get(kind, ()):
        way, _, own = name.rpartition(".")
        inside = tree
        if way:
            inside = tree.setdefault(way, {})  # type: ignore[assignment]
        text = quantity(f"{path}.{name}")
        inside[own] = _places(text) if name == "places" else scalar(text)
    return tree


def _places(text: str) -> list[Tree]:
    """Return the friction along the travel, a line for each place: position and d, or position, S and J."""
    places: list[Tree] = []
    for line in re.split(r"[\n;]", text):
        parts = line.replace("%", " ").replace(",", " ").split()
        if parts:
            names = ("position", "d") if len(parts) < 3 else ("position", "S", "J")
            # What is too much on a line stays in its last entry, for the loader to refuse.
            last = len(names) - 1
            told = [*parts[:last], " ".join(parts[last:])]
            places.append({name: scalar(part) for name, part in zip(names, told, strict=True) if part})
    return places


def controller_tree(entries: Entries, quantity: Quantity, path: str) -> dict[str, Tree]:
    """Return the controller that is typed."""
    tree: dict[str, Tree] = {"form": scalar(entries[f"{path}.form"])}
    structure = entries[f"{path}.structure"]
    if structure == OWN_WEIGHT:
        for name in ("derivative_on", "setpoint_weight"):
            tree[name] = scalar(entries[f"{path}.{name}"])
    else:
        tree["structure"] = _quote(structure)
    tree["derivative_filter"] = scalar(entries[f"{path}.derivative_filter"])
    tree["action"] = scalar(entries[f"{path}.action"])
    gain = "proportional_band" if entries[f"{path}.Kc.unit"] == "PB %" else "Kc"
    tree[gain] = scalar(quantity(f"{path}.Kc"))
    for name in ("Ti", "Td"):
        tree[name] = scalar(quantity(f"{path}.{name}"))
    if entries[f"{path}.limited"] == "true":
        tree["output_limits"] = [scalar(quantity(f"{path}.output_limits.{end}")) for end in ("low", "high")]
        tree["anti_windup"] = scalar(entries[f"{path}.anti_windup"])
        if quantity(f"{path}.tracking_time"):
            tree["tracking_time"] = scalar(quantity(f"{path}.tracking_time"))
    if not is_zero(entries[f"{path}.output_resolution"]):
        tree["output_resolution"] = scalar(quantity(f"{path}.output_resolution"))
    kind = entries[f"{path}.compensator.type"]
    if kind != "none":
        given = {name: quantity(f"{path}.compensator.{name}") for name in COMPENSATORS.get(kind, ())}
        shape: dict[str, Tree] = {name: scalar(text) for name, text in given.items() if text or name != "release"}
        tree["compensator"] = {"type": scalar(kind), **shape}
    return tree


def _quote(text: str) -> str:
    return '"' + text + '"' if text in STRUCTURES else scalar(text)


def case_controller(pid: PID, entries: Entries, path: str, unit: str = " %") -> dict[str, Tree]:
    """Return a pinned controller, with every key that it would else inherit from the one that is typed.

    unit: of its output, as it is written.
    """
    tree: dict[str, Tree] = {"Kc": number_text(pid.Kc)}
    tree["Ti"] = "none" if math.isinf(pid.Ti) else f"{number_text(pid.Ti)} s"
    tree["Td"] = f"{number_text(pid.Td)} s"
    tree["form"] = pid.form
    if pid.structure is None:
        tree |= {"derivative_on": pid.derivative_on, "setpoint_weight": number_text(pid.setpoint_weight)}
    else:
        tree["structure"] = _quote(pid.structure)
    tree["derivative_filter"] = number_text(pid.derivative_filter)
    tree["action"] = pid.action
    if pid.output_limits is None:
        tree["output_limits"] = "null"
    else:
        tree["output_limits"] = [f"{_limit(end)}{unit}" for end in pid.output_limits]
        tree["anti_windup"] = pid.anti_windup
        if pid.anti_windup == "back_calculation":
            Tt = pid.ideal_terms().Ti if pid.tracking_time is None else pid.tracking_time
            tree["tracking_time"] = f"{number_text(Tt)} s"
    # Few have these; where neither has, nothing is said of them.
    if pid.output_resolution > 0.0 or not is_zero(entries[f"{path}.output_resolution"]):
        tree["output_resolution"] = f"{number_text(pid.output_resolution)}{unit}"
    if pid.compensator is not None:
        kind, texts = compensator_texts(pid.compensator)
        told = {name: f"{text} s" if name in _TIMES else text for name, text in texts.items() if text}
        tree["compensator"] = {"type": kind, **told}
    elif entries[f"{path}.compensator.type"] != "none":
        tree["compensator"] = "null"
    return tree


_TIMES = ("width", "period", "at")


def compensator_texts(given: Compensator) -> tuple[str, dict[str, str]]:
    """Return a compensator's type and its values as texts without units; "" for what it does without."""
    match given:
        case IntegralDeadband():
            kind = "integral_deadband"
        case Knocker():
            kind = "knocker"
        case ConstantReinforcement():
            kind = "constant_reinforcement"
        case TwoMove():
            kind = "two_move"
        case Dither():
            kind = "dither"
    values = {name: getattr(given, name) for name in COMPENSATORS[kind]}
    texts = {name: value if isinstance(value, str) else number_text(value) for name, value in values.items()}
    if texts.get("release") == "none":
        texts["release"] = ""
    return kind, texts


def _limit(value: float) -> str:
    return repr(float(value)).removesuffix(".0")
