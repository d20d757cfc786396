"""What can be run as it is written, and most likely was meant otherwise: said, not refused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from workbench.model.controller import PID
from workbench.model.experiment import Experiment, Profile, Series
from workbench.model.loop import Loop

__all__ = ["RESOLVED", "Caution", "cautions"]

RESOLVED = 0.1  # % of travel: a good valve with a positioner resolves no less


class Caution(NamedTuple):
    """What to look at again, in words; where: the entry of a scenario that it is about."""

    where: str
    text: str


def cautions(loop: Loop | None, experiment: Experiment | None, controllers: Sequence[tuple[str, PID]]) -> list[Caution]:
    """Return what to look at again; loop: None where it comes from a record. controllers: of the cases, by name."""
    found = []
    band = 0.0 if loop is None else loop.valve.stick_band
    if 0.0 < band < RESOLVED:
        text = (
            f"loop.valve sticks over {band:g} % of travel, less than a good valve resolves ({RESOLVED:g} %): "
            "2 % is written 2, not 0.02."
        )
        found.append(Caution("loop.valve", text))
    found += _at_rest(controllers)
    compensated = any(controller.compensator is not None for _, controller in controllers)
    if experiment is not None and controllers and not compensated and not _moves(experiment):
        text = (
            "experiment: without a setpoint move, a load or noise the loop stays at rest, and its run tells nothing of "
            "any tuning: give a setpoint, such as {step: 4, at: 0 s}, or a load."
        )
        found.append(Caution("experiment.setpoint.step", text))
    return found


def _at_rest(controllers: Iterable[tuple[str, PID]]) -> list[Caution]:
    """Say which limits the resting output lies on."""
    names: dict[tuple[float, float], list[str]] = {}
    for name, controller in controllers:
        limits = controller.output_limits
        if limits is not None and 0.0 in limits:
            names.setdefault(limits, []).append(name)
    return [
        Caution(
            "loop.controller.output_limits",
            f"{', '.join(some)}: output limits {low:g} to {high:g} %: the loop rests on one of them, as OP is counted "
            "from its resting point; at rest at 40 % open, 0 to 100 % is written [-40, 60].",
        )
        for (low, high), some in names.items()
    ]


def _moves(experiment: Experiment) -> bool:
    """Whether anything happens in an experiment."""
    noise = experiment.noise is not None and experiment.noise.sd > 0.0
    parts = (*experiment.setpoint_parts, *experiment.load_parts)
    return noise or experiment.stem_offset != 0.0 or any(_is_felt(part) for part in parts)


def _is_felt(part: Profile) -> bool:
    return any(value != 0.0 for value in part.values) if isinstance(part, Series) else part.size != 0.0
