"""A load step: what an estimate holds of a disturbance that nobody recorded."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["LoadStep"]


@dataclass(frozen=True, slots=True)
class LoadStep:
    """A lasting change of load that PV shows and OP does not explain.

    at: s, the time at which PV begins to answer; size: % of OP at the plant's input, positive where it raises the input
    (an integrating plant answers with a ramp); interval: of the size, 95 %, time and plant as they are.
    """

    at: float
    size: float
    interval: tuple[float, float]
