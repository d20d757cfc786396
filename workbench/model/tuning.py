"""What is asked of a tuning, its objective (eq. (2) of the paper, figures of the run) and bounds, and its digits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from workbench.errors import InvalidValue
from workbench.model.checks import choice, instance, number, ordered_pair
from workbench.model.controller import PID

__all__ = ["WEIGHABLE", "Bounds", "DigitStep", "Objective", "Weighable"]


# The figures of `Kpis` that an objective can weigh: sums, variances and a standard deviation. The others say nothing
# about a loop that goes on cycling: they are infinite, or hang on the window's last sample.
Weighable = Literal[
    "error_variance",
    "mean_square_error",
    "op_variance",
    "valve_variance",
    "valve_travel",
    "controller_travel",
    "reversals",
    "iae",
    "ise",
    "pv_sd",
]
WEIGHABLE: tuple[str, ...] = get_args(Weighable)


@dataclass(frozen=True, slots=True)
class Objective:
    """The weights, each >= 0 and at least one above 0, of

    `J = sum_{k=1..N} w1 (r_k - y_k)^2 + sum_{k=0..N-1} [w2 u_k^2 + w4 (u_k - u_{k-1})^2] + w3 (r_N - y_N)^2`.

    Plain sums over samples; y measured (with noise), u the limited output in deviation, bias included. Eq. (2) of the
    paper has w4 = 0; its Cases 4 and 5 have w1 = w3 = 0.5, w2 = 0.

    kpis: weights of figures of the whole run, added to J, each in its own unit as `Kpis` defines it; a mapping or pairs
    of names out of `WEIGHABLE` and weights. `Objective.of(iae=1.0)` weighs figures alone. Raises `InvalidValue`.
    """

    w1: float = 0.5
    w2: float = 0.0
    w3: float = 0.5
    w4: float = 0.0
    kpis: Mapping[str, float] | tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        for name in ("w1", "w2", "w3", "w4"):
            object.__setattr__(self, name, number(getattr(self, name), f"Objective.{name}", least=0.0))
        given = _pairs(self.kpis)
        for name in given:
            choice(name, "Objective.kpis", WEIGHABLE)
            given[name] = number(given[name], f"Objective.kpis.{name}", least=0.0)
        object.__setattr__(self, "kpis", tuple((name, given[name]) for name in WEIGHABLE if given.get(name, 0.0) > 0.0))
        if self.w1 + self.w2 + self.w3 + self.w4 == 0.0 and not self.kpis:
            raise InvalidValue("Objective", "all weights 0", "at least one of w1, w2, w3, w4 or kpis must be above 0")

    @classmethod
    def of(cls, **kpis: float) -> Objective:
        """Return the objective that is a weighted sum of figures of the run and nothing else."""
        return cls(w1=0.0, w3=0.0, kpis=tuple(kpis.items()))

    @property
    def weights(self) -> tuple[float, float, float, float]:
        """(w1, w2, w3, w4)."""
        return self.w1, self.w2, self.w3, self.w4


def _pairs(kpis: object) -> dict[str, float]:
    try:
        pairs = dict(kpis)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        raise InvalidValue("Objective.kpis", kpis, "must be weights by name, such as {'iae': 1.0}") from None
    return dict(pairs)


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
        instance(controller, PID, "controller", "a PID")
        return all(
            low - 1e-9 * abs(low) <= getattr(controller, name) <= high + 1e-9 * abs(high)
            for name, (low, high) in (("Kc", self.Kc), ("Ti", self.Ti), ("Td", self.Td))
        )


@dataclass(frozen=True, slots=True)
class DigitStep:
    """What one unit of a parameter's last digit does: its name, that unit, and J with one unit less and one more.

    nan where the bounds leave no room on that side.
    """

    name: str
    unit: float
    below: float
    above: float
