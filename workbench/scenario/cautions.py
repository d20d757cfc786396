"""What can be run as it is written, and most likely was meant otherwise: said, not refused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from workbench.model.cascade import Cascade, CascadeExperiment
from workbench.model.controller import PID
from workbench.model.experiment import Experiment, Profile, Series
from workbench.model.loop import Loop

__all__ = ["RESOLVED", "Caution", "cascade_cautions", "cautions"]

IDLE = (
    "experiment: without a setpoint move, a load or noise {} at rest, and its run tells nothing of any tuning: give a "
    "setpoint, such as {{step: 4, at: 0 s}}, or {}."
)
RESOLVED = 0.1  # % of travel: a good valve with a positioner resolves no less


class Caution(NamedTuple):
    """What to look at again, in words; where: the entry of a scenario that it is about."""

    where: str
    text: str


def cautions(loop: Loop | None, experiment: Experiment | None, controllers: Sequence[tuple[str, PID]]) -> list[Caution]:
    """Return what to look at again; loop: None where it comes from a record. controllers: of the cases, by name."""
    found = [] if loop is None else _stiction(loop, "loop")
    found += _at_rest(controllers, "loop")
    if experiment is not None and controllers and not _moves(experiment, controllers):
        found.append(Caution("experiment.setpoint.step", IDLE.format("the loop stays", "a load")))
    return found


def cascade_cautions(experiment: CascadeExperiment, cases: Sequence[tuple[str, Cascade]]) -> list[Caution]:
    """Return what to look at again in a cascade, of which there is at least one case."""
    primaries = [(name, cascade.primary.controller) for name, cascade in cases]
    secondaries = [(name, cascade.secondary.controller) for name, cascade in cases]
    found = _stiction(cases[0][1].secondary, "cascade.secondary")
    found += _at_rest(primaries, "cascade.primary") + _at_rest(secondaries, "cascade.secondary")
    if not _moves(experiment, primaries + secondaries):
        found.append(Caution("experiment.setpoint.step", IDLE.format("both loops stay", "a load or primary_load")))
    return found


def _stiction(loop: Loop, root: str) -> list[Caution]:
    """Say that a valve sticks over less than it may well be meant to; root: the loop's entry in the scenario."""
    band = loop.valve.stick_band
    if not 0.0 < band < RESOLVED:
        return []
    text = (
        f"{root}.valve sticks over {band:g} % of travel, less than a good valve resolves ({RESOLVED:g} %): "
        "2 % is written 2, not 0.02."
    )
    return [Caution(f"{root}.valve", text)]


def _at_rest(controllers: Iterable[tuple[str, PID]], root: str) -> list[Caution]:
    """Say which limits the resting output lies on; root: the loop's entry in the scenario."""
    names: dict[tuple[float, float], list[str]] = {}
    for name, controller in controllers:
        limits = controller.output_limits
        if limits is not None and 0.0 in limits:
            names.setdefault(limits, []).append(name)
    where, unit = {"loop": "", "cascade.primary": " of the primary"}.get(root, " of the secondary"), " %"
    remedy = "OP is counted from its resting point; at rest at 40 % open, 0 to 100 % is written [-40, 60]"
    if root == "cascade.primary":  # which puts out a setpoint
        unit, remedy = "", "its output, the secondary's setpoint, is counted from its resting point"
    return [
        Caution(
            f"{root}.controller.output_limits",
            f"{', '.join(some)}: output limits{where} {low:g} to {high:g}{unit}: the loop rests on one of them, as "
            f"{remedy}.",
        )
        for (low, high), some in names.items()
    ]


def _moves(experiment: Experiment, controllers: Sequence[tuple[str, PID]]) -> bool:
    """Whether anything happens in an experiment under these controllers, of which a compensator may move by itself."""
    noises, parts = [experiment.noise], [*experiment.setpoint_parts, *experiment.load_parts]
    if isinstance(experiment, CascadeExperiment):
        noises.append(experiment.secondary_noise)
        parts += experiment.primary_load_parts
    noise = any(one is not None and one.sd > 0.0 for one in noises)
    compensated = any(controller.compensator is not None for _, controller in controllers)
    return compensated or noise or experiment.stem_offset != 0.0 or any(_is_felt(part) for part in parts)


def _is_felt(part: Profile) -> bool:
    return any(value != 0.0 for value in part.values) if isinstance(part, Series) else part.size != 0.0
