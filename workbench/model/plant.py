"""The process between the valve and the measurement: first order or integrating, each with dead time."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.errors import InvalidValue
from workbench.model.checks import number

__all__ = ["FOPDT", "Integrating", "Plant"]


def _gain(value: object, where: str) -> float:
    gain = number(value, where)
    if gain == 0.0:
        raise InvalidValue(where, gain, "must not be 0: the valve would have no effect")
    return gain


@dataclass(frozen=True, slots=True)
class FOPDT:
    """First order plus dead time: `gain exp(-dead_time s) / (time_constant s + 1)`.

    gain: EU per % of valve travel, any sign but not 0. time_constant: s, > 0. dead_time: s, >= 0, any fraction
    of the sample time. Raises `InvalidValue`.
    """

    gain: float
    time_constant: float
    dead_time: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "gain", _gain(self.gain, "FOPDT.gain"))
        object.__setattr__(
            self, "time_constant", number(self.time_constant, "FOPDT.time_constant", above=0.0, unit="s")
        )
        object.__setattr__(self, "dead_time", number(self.dead_time, "FOPDT.dead_time", least=0.0, unit="s"))


@dataclass(frozen=True, slots=True)
class Integrating:
    """An integrator with dead time: `gain exp(-dead_time s) / s`.

    gain: EU per % of valve travel per second, any sign but not 0. dead_time: s, >= 0. Raises `InvalidValue`.
    """

    gain: float
    dead_time: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "gain", _gain(self.gain, "Integrating.gain"))
        object.__setattr__(self, "dead_time", number(self.dead_time, "Integrating.dead_time", least=0.0, unit="s"))


Plant = FOPDT | Integrating
