"""A control loop: plant, valve, controller and the time between samples."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

from workbench.errors import InvalidValue
from workbench.model.checks import number, ordered_pair
from workbench.model.controller import PID
from workbench.model.plant import FOPDT, Plant
from workbench.model.valve import Valve

__all__ = ["Loop"]

# The kernel keeps the plant input's past: this many samples of dead time are beyond any process.
LONGEST_DEAD_TIME = 1_000_000


@dataclass(frozen=True, slots=True)
class Loop:
    """A single loop.

    sample_time: s, > 0, of controller and record alike. pv_range: (low, high) in EU, only for units such as %/% or a
    proportional band. Raises `InvalidValue`, also for back-calculation that is unstable at this sample time (see
    `PID.check_tracking`) and a compensator's times that are no whole number of samples.
    """

    plant: Plant
    valve: Valve
    controller: PID
    sample_time: float
    pv_range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.plant, get_args(Plant)):
            raise InvalidValue("Loop.plant", self.plant, "must be an FOPDT or Integrating plant")
        if not isinstance(self.valve, get_args(Valve)):
            raise InvalidValue("Loop.valve", self.valve, "must be one of the valve types")
        if not isinstance(self.controller, PID):
            raise InvalidValue("Loop.controller", self.controller, "must be a PID")
        object.__setattr__(self, "sample_time", number(self.sample_time, "Loop.sample_time", above=0.0, unit="s"))
        self.controller.check_sampling(self.sample_time)
        if self.plant.dead_time > LONGEST_DEAD_TIME * self.sample_time:
            limit = f"must be at most {LONGEST_DEAD_TIME:,} samples of {self.sample_time:g} s"
            raise InvalidValue("Loop.plant.dead_time", f"{self.plant.dead_time:g} s", limit)
        if self.pv_range is not None:
            object.__setattr__(self, "pv_range", ordered_pair(self.pv_range, "Loop.pv_range"))

    def with_controller(self, controller: PID) -> Loop:
        """Return the same loop under another controller."""
        return replace(self, controller=controller)

    def sampling_note(self) -> str | None:
        """Return a sentence where the sampling is coarse for the plant (slower than its time constant or dead time)."""
        slow = []
        if isinstance(self.plant, FOPDT) and self.sample_time > self.plant.time_constant:
            slow.append(f"the time constant ({self.plant.time_constant:g} s)")
        if 0.0 < self.plant.dead_time < self.sample_time:
            slow.append(f"the dead time ({self.plant.dead_time:g} s)")
        if not slow:
            return None
        return f"the sample time ({self.sample_time:g} s) is longer than " + " and ".join(slow)
