"""Entries of a loop's further elements: characteristic, friction by place or as a mechanism, the controller's scan."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from workbench.model.characteristic import EqualPercentage
from workbench.model.valve import MOST_PLACES
from workbench.scenario.entries import Band, Closed, NonNegative, Number, Percent, PositiveTime, by_key, by_presence

__all__ = [
    "DESCRIBED",
    "NOT_FROM_DATA",
    "Elements",
    "KarnoppValve",
    "OneParameterPlace",
    "Place",
    "PositionalValve",
    "elements_of",
]

# Entries that only a loop which the file describes can have, and what is said of them elsewhere.
DESCRIBED = {"characteristic", "fail_open", "scan"}
NOT_FROM_DATA = (
    "given, and estimate.data as well; a loop found in recorded data is linear, with the valve's sign in its gain, and "
    "executes at every sample"
)


class LinearCharacteristic(Closed):
    """Flow in proportion to the opening, as without a characteristic."""

    type: Literal["linear"]


class EqualPercentageCharacteristic(Closed):
    """Equal steps of travel change the flow in equal ratios; needs output limits within the travel."""

    type: Literal["equal_percentage"]
    rangeability: Annotated[Number, Field(description="flow fully open over that at the least opening, above 1")]
    opening: Annotated[Percent, Field(description="opening at the operating point, % of travel")]


CharacteristicEntry = Annotated[
    Annotated[LinearCharacteristic, Tag("<linear>")]
    | Annotated[EqualPercentageCharacteristic, Tag("<equal_percentage>")],
    by_key("type", "linear", "equal_percentage"),
]


class OneParameterPlace(Closed):
    """Friction at one place of the travel, by one parameter."""

    position: Annotated[Percent, Field(description="stem position, % from rest")]
    d: Annotated[Band, Field(description="stiction there, % of travel")]


class TwoParameterPlace(Closed):
    """Friction at one place of the travel, by two parameters."""

    position: Annotated[Percent, Field(description="stem position, % from rest")]
    S: Annotated[Band, Field(description="stick band plus dead band there, % of travel")]
    J: Annotated[Band, Field(description="slip jump there, % of travel")]


Place = Annotated[
    Annotated[OneParameterPlace, Tag("<d>")] | Annotated[TwoParameterPlace, Tag("<S>")], by_presence("d", "S")
]


class PositionalValve(Closed):
    """Stiction that varies along the travel: linear between places, which all have d, or all S and J."""

    type: Literal["positional"]
    places: Annotated[list[Place], Field(min_length=1, max_length=MOST_PLACES, description="by ascending position")]


class KarnoppValve(Closed):
    """A stem with mass on a spring under Coulomb, static, Stribeck and viscous friction, to try methods on."""

    type: Literal["karnopp"]
    mass: Annotated[Number, Field(description="kg, above 0")]
    spring: Annotated[Number, Field(description="N/m, above 0")]
    travel: Annotated[Number, Field(description="m, above 0")]
    coulomb: Annotated[NonNegative, Field(description="friction in motion, N")]
    static: Annotated[NonNegative, Field(description="friction at rest, N; at least coulomb")]
    viscous: Annotated[NonNegative, Field(description="N s/m")]
    stribeck: Annotated[Number, Field(description="Stribeck velocity, m/s, above 0")]
    substep: Annotated[PositiveTime, Field(description="longest step of the integration; 1 ms")] = 1e-3


class Elements(Closed):
    """What few loops have."""

    characteristic: CharacteristicEntry | None = None
    fail_open: Annotated[bool, Field(description="whether OP closes the valve (air to close)")] = False
    scan: Annotated[int, Field(ge=1, description="the controller executes in samples 0, n, 2n, ..; 1")] = 1


def elements_of(given: Elements) -> dict[str, Any]:
    """Return the loop's fields that its entry sets here. Raises `InvalidValue`."""
    curve = given.characteristic
    found = None if curve is None or isinstance(curve, LinearCharacteristic) else curve
    return {
        "characteristic": None if found is None else EqualPercentage(found.rangeability, found.opening),
        "fail_open": given.fail_open,
        "scan": given.scan,
    }
