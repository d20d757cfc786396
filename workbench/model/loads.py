"""Loads that nobody recorded: what an estimate holds of them."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["LoadStep", "LoadSwing"]


@dataclass(frozen=True, slots=True)
class LoadStep:
    """A lasting change of load that PV shows and OP does not explain.

    at: s, the time at which PV begins to answer, between samples too; size: % of OP at the plant's input, positive
    where it raises the input (an integrating plant answers with a ramp); interval: of the size, 95 %, the plant as it
    is.
    """

    at: float
    size: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True)
class LoadSwing:
    """An oscillation of load, a sinusoid that PV shows and neither OP nor the stem explains.

    period: s; size: % of OP at the plant's input, to either side; amplitude: EU, what PV swings by, to either side.
    """

    period: float
    size: float
    amplitude: float
