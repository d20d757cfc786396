"""Entries of a loop's further elements: the valve's characteristic."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from workbench.model.characteristic import EqualPercentage
from workbench.scenario.entries import Closed, Number, Percent, by_key

__all__ = ["DESCRIBED", "NOT_FROM_DATA", "CharacteristicEntry", "elements_of"]

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
