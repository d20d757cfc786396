"""A controller's compensator in a scenario, `compensator: {type: knocker, ..}`: its entry, and the value that it is."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, Tag

from workbench.model.compensator import (
    Compensator,
    ConstantReinforcement,
    Dither,
    IntegralDeadband,
    Knocker,
    TwoMove,
)
from workbench.scenario.entries import Band, Closed, FilterRatio, Number, Percent, PositiveTime, Time, by_key

__all__ = ["CompensatorEntry", "compensator_of"]

Amplitude = Annotated[Band, Field(description="% of travel, above 0")]


class IntegralDeadbandEntry(Closed):
    """Integral action stopped, or slowed by a ratio, while the error lies within a band."""

    type: Literal["integral_deadband"]
    band: Annotated[Number, Field(gt=0, description="EU")]
    ratio: Annotated[FilterRatio | None, Field(description="how much longer Ti is within the band; none to stop")] = (
        None
    )


class KnockerEntry(Closed):
    """Pulses in the direction in which the output is going."""

    type: Literal["knocker"]
    amplitude: Amplitude
    width: PositiveTime
    period: PositiveTime


class ConstantReinforcementEntry(Closed):
    """A constant added in the direction of the output's last move."""

    type: Literal["constant_reinforcement"]
    amplitude: Amplitude


class TwoMoveEntry(Closed):
    """Two moves to the steady output, which is then held."""

    type: Literal["two_move"]
    amplitude: Amplitude
    at: Time
    steady_output: Annotated[Percent, Field(description="% from the resting output, where PV rests on the setpoint")]
    release: Annotated[Number | None, Field(gt=0, description="EU of error that ends the hold; never if left out")] = (
        None
    )


class DitherEntry(Closed):
    """A fast periodic signal added to the output."""

    type: Literal["dither"]
    amplitude: Amplitude
    period: PositiveTime
    shape: Literal["sine", "square"] = "sine"


CompensatorEntry = Annotated[
    Annotated[IntegralDeadbandEntry, Tag("<integral_deadband>")]
    | Annotated[KnockerEntry, Tag("<knocker>")]
    | Annotated[ConstantReinforcementEntry, Tag("<constant_reinforcement>")]
    | Annotated[TwoMoveEntry, Tag("<two_move>")]
    | Annotated[DitherEntry, Tag("<dither>")],
    by_key("type", "integral_deadband", "knocker", "constant_reinforcement", "two_move", "dither"),
]


def compensator_of(given: CompensatorEntry) -> Compensator:
    """Return the compensator of an entry. Raises `InvalidValue` where its values do not go together."""
    match given:
        case IntegralDeadbandEntry():
            return IntegralDeadband(given.band, math.inf if given.ratio is None else given.ratio)
        case KnockerEntry():
            return Knocker(given.amplitude, given.width, given.period)
        case ConstantReinforcementEntry():
            return ConstantReinforcement(given.amplitude)
        case TwoMoveEntry():
            release = math.inf if given.release is None else given.release
            return TwoMove(given.amplitude, given.at, given.steady_output, release)
        case DitherEntry():
            return Dither(given.amplitude, given.period, given.shape)
