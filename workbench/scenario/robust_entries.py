"""The robust side of a scenario: `ensemble:`, and a tuning's `robust:`, `constraints:` and `travel_budget:`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from workbench.scenario.entries import (
    Band,
    Closed,
    Name,
    NonNegative,
    Number,
    Percent,
    PositiveTime,
    Seed,
    Time,
    TrueOr,
)

__all__ = ["CaseTravel", "ConstraintsEntry", "EnsembleEntry", "RobustEntry", "TravelBudget"]

Share = Annotated[float, Field(ge=0, le=0.9, allow_inf_nan=False)]


class EnsembleEntry(Closed):
    """Random circumstances and plants around the loop; what is left out is as in the default, "plant-ready"."""

    duration: PositiveTime | None = None
    setpoint: Annotated[
        list[NonNegative] | None, Field(min_length=2, max_length=2, description="[least, largest] step at 0 s, EU")
    ] = None
    load: Annotated[list[Band] | None, Field(min_length=2, max_length=2, description="[least, largest] step, %")] = None
    load_time: Annotated[list[Time] | None, Field(min_length=2, max_length=2, description="when it comes")] = None
    stem_offset: Annotated[
        float | None, Field(ge=0, le=1, description="at the start, as a share of what the valve holds")
    ] = None
    noise: Annotated[
        list[NonNegative] | None, Field(min_length=2, max_length=2, description="standard deviation, EU")
    ] = None
    gain: Annotated[Share | None, Field(description="relative uncertainty, 0.2 for 20 %")] = None
    time_constant: Annotated[Share | None, Field(description="relative uncertainty")] = None
    dead_time: Annotated[Share | None, Field(description="relative uncertainty")] = None
    stiction: Annotated[Share | None, Field(description="relative uncertainty")] = None
    draws: Annotated[int | None, Field(ge=1, le=20_000)] = None
    seed: Seed | None = None
    statistic: Annotated[
        Literal["mean", "percentile", "cvar"] | None, Field(description="of J over the draws, minimised")
    ] = None
    level: Annotated[float | None, Field(gt=0, lt=1, description="of percentile and cvar")] = None


RobustEntry = Annotated[EnsembleEntry | None, TrueOr("an ensemble")]


class ConstraintsEntry(Closed):
    """What a tuning must keep; a robust one at the worst corner of the plant's uncertainty (by default Ms <= 2)."""

    max_sensitivity: Annotated[Number | None, Field(gt=1, description="largest maximum sensitivity Ms")] = None
    gain_margin: Annotated[Number | None, Field(gt=1, description="least factor on Kc")] = None
    phase_margin: Annotated[Number | None, Field(gt=0, le=90, description="least angle, degrees")] = None
    valve_travel: Annotated[
        Percent | None, Field(gt=0, description="largest travel, %: in the experiment, or mean over the ensemble")
    ] = None


class CaseTravel(Closed):
    """The mean travel of another case over the ensemble."""

    case: Annotated[Name, Field(description="a case above this one")]


def _budget(data: object) -> str:
    return "<case>" if isinstance(data, dict) else "<percent>"


TravelBudget = Annotated[
    Annotated[CaseTravel, Tag("<case>")] | Annotated[Percent, Field(gt=0), Tag("<percent>")], Discriminator(_budget)
]
