"""What is asked of a tuning: the objective of the paper's eq. (2) and the bounds of its parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from workbench.errors import InvalidValue
from workbench.model.checks import number, ordered_pair
from workbench.model.controller import PID

__all__ = ["Bounds", "Objective"]


@dataclass(frozen=True, slots=True)
class Objective:
    """The weights, each >= 0 and at least one above 0, of

    `J = sum_{k=1..N} w1 (r_k - y_k)^2 + sum_{k=0..N-1} [w2 u_k^2 + w4 (u_k - u_{k-1})^2] + w3 (r_N - y_N)^2`.

    Plain sums over samples; y measured (with noise), u the limited output in deviation, bias included. Eq. (2) of the
    paper has w4 = 0; its Cases 4 and 5 have w1 = w3 = 0.5, w2 = 0. Raises `InvalidValue`.
    """

    w1: float = 0.5
    w2: float = 0.0
    w3: float = 0.5
    w4: float = 0.0

    def __post_init__(self) -> None:
        for name in ("w1", "w2", "w3", "w4"):
            object.__setattr__(self, name, number(getattr(self, name), f"Objective.{name}", least=0.0))
        if self.w1 + self.w2 + self.w3 + self.w4 == 0.0:
            raise InvalidValue("Objective", "all weights 0", "at least one of w1, w2, w3, w4 must be above 0")

    @property
    def weights(self) -> tuple[float, float, float, float]:
        """(w1, w2, w3, w4)."""
        return self.w1, self.w2, self.w3, self.w4


@dataclass(frozen=True, slots=True)
class Bounds:
    """Closed ranges of Kc (%/EU), Ti (s) and Td (s) in the controller's own form; equal ends fix a parameter.

    The defaults are those of the paper's eq. (2). `Td=(0, 0)` tunes a PI controller. Raises `InvalidValue`.
    """

    Kc: tuple[float, float] = (0.0, 10.0)
    Ti: tuple[float, float] = (5.0, 600.0)
    Td: tuple[float, float] = (0.0, 60.0)

    def __post_init__(self) -> None:
        for name in ("Kc", "Ti", "Td"):
            pair = ordered_pair(getattr(self, name), f"Bounds.{name}", least=0.0, equal=True)
            object.__setattr__(self, name, pair)
        if self.Ti[0] <= 0.0 or math.isinf(self.Ti[1]):
            raise InvalidValue("Bounds.Ti", self.Ti, "must be finite and above 0 s")

    def contains(self, controller: PID) -> bool:
        """Return whether the controller's Kc, Ti and Td lie within the bounds (to 1e-9 relative)."""
        return all(
            low - 1e-9 * abs(low) <= getattr(controller, name) <= high + 1e-9 * abs(high)
            for name, (low, high) in (("Kc", self.Kc), ("Ti", self.Ti), ("Td", self.Td))
        )
