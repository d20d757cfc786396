"""The installed characteristic: what flow a valve's opening gives, where that is not in proportion.

Without one the flow follows the opening in proportion, and the plant's gain holds over the whole travel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from workbench.errors import InvalidValue
from workbench.model.checks import number

__all__ = ["EqualPercentage"]

# Beyond this a valve would pass next to nothing over most of its travel; real ones have 20 to 100.
LARGEST_RANGEABILITY = 1000.0


@dataclass(frozen=True, slots=True)
class EqualPercentage:
    """Equal steps of travel change the flow in equal ratios: flow share `R^(h/100 - 1)` at an opening of h %.

    R: rangeability, the flow fully open over that at the least opening, > 1 (usual: 20 to 100). opening: h at the
    operating point, %, within 0..100, from which all signals are deviations. In the loop's units an opening x % above
    it gives the plant `v = (R^(x/100) - 1)/(ln R/100)` instead of x: the flow's change over its slope at the operating
    point, so that the plant's gain holds there, and is `R^(x/100)` times as large x % above it. As installed: with a
    pressure drop that does not fall as the flow rises (inherent and installed characteristic are then the same).
    Source: IEC 60534-2-4:2009, "Inherent flow characteristics and rangeability". Raises `InvalidValue`.
    """

    rangeability: float
    opening: float

    def __post_init__(self) -> None:
        where = "EqualPercentage"
        R = number(self.rangeability, f"{where}.rangeability", above=1.0, most=LARGEST_RANGEABILITY)
        object.__setattr__(self, "rangeability", R)
        opening = number(self.opening, f"{where}.opening", above=0.0, unit="%")
        if opening >= 100.0:
            raise InvalidValue(f"{where}.opening", f"{opening:g} %", "must be below 100 %, so that both ways are open")
        object.__setattr__(self, "opening", opening)

    @property
    def curve(self) -> float:
        """ln R/100: by how much of itself the flow grows with 1 % of travel."""
        return math.log(self.rangeability) / 100.0
