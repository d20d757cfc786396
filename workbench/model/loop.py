"""A control loop: plant, valve, controller and the time between samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import get_args

from workbench.errors import InvalidValue
from workbench.model.characteristic import EqualPercentage
from workbench.model.checks import instance, number, ordered_pair, whole
from workbench.model.controller import PID
from workbench.model.karnopp import Karnopp
from workbench.model.numbers import given
from workbench.model.plant import FOPDT, Plant
from workbench.model.valve import Valve

__all__ = ["Loop"]

# The kernel keeps the plant input's past: this many samples of dead time are beyond any process.
LONGEST_DEAD_TIME = 1_000_000
MOST_SUBSTEPS = 100_000


@dataclass(frozen=True, slots=True)
class Loop:
    """A single loop.

    sample_time: s, > 0, of plant and record, and of the controller unless it scans. pv_range: (low, high) in EU, only
    for units such as %/% or a proportional band.

    `characteristic`: flow against opening, None for in proportion; one that curves needs output limits within the
    travel of 0..100 % about its operating point, as beyond them it says nothing. `fail_open`: whether OP closes the
    valve (air to close), so that an OP of u % above rest opens it by -u %. The stem x is told in OP's direction, load
    and characteristic in the opening's: the plant's input is `v = f(x) + load`, for a fail-open valve `f(-x) + load`,
    and in the loop the plant's gain counts with the opposite sign (`gain`).

    `scan`: n, a whole number >= 1: the controller executes in samples 0, n, 2n, .., with n sample times for its Ts, on
    what it measures then; in between OP stands. The valve's law runs at every sample, so that a stem that goes on only
    while its input moves (Choudhury, Kano, dead band) sticks between executions.

    Raises `InvalidValue`, also for back-calculation that is unstable at this sample time (see `PID.check_tracking`) and
    a compensator's times that are no whole number of the controller's executions.
    """

    plant: Plant
    valve: Valve
    controller: PID
    sample_time: float
    pv_range: tuple[float, float] | None = None
    characteristic: EqualPercentage | None = None
    fail_open: bool = False
    scan: int = 1

    def __post_init__(self) -> None:
        if not isinstance(self.plant, get_args(Plant)):
            raise InvalidValue("Loop.plant", self.plant, "must be an FOPDT or Integrating plant")
        if not isinstance(self.valve, get_args(Valve)):
            raise InvalidValue("Loop.valve", self.valve, "must be one of the valve types")
        if not isinstance(self.controller, PID):
            raise InvalidValue("Loop.controller", self.controller, "must be a PID")
        object.__setattr__(self, "sample_time", number(self.sample_time, "Loop.sample_time", above=0.0, unit="s"))
        object.__setattr__(self, "scan", whole(self.scan, "Loop.scan", least=1))
        self.controller.check_sampling(self.scan * self.sample_time)
        if self.plant.dead_time > LONGEST_DEAD_TIME * self.sample_time:
            limit = f"must be at most {LONGEST_DEAD_TIME:,} samples of {self.sample_time:g} s"
            raise InvalidValue("Loop.plant.dead_time", f"{self.plant.dead_time:g} s", limit)
        if isinstance(self.valve, Karnopp) and self.valve.substep * MOST_SUBSTEPS < self.sample_time:
            limit = f"must be at least {self.sample_time / MOST_SUBSTEPS:g} s, a {MOST_SUBSTEPS:,}th of the sample time"
            raise InvalidValue("Karnopp.substep", f"{self.valve.substep:g} s", limit)
        if self.pv_range is not None:
            object.__setattr__(self, "pv_range", ordered_pair(self.pv_range, "Loop.pv_range"))
        instance(self.fail_open, bool, "Loop.fail_open", "True or False")
        if self.characteristic is not None:
            instance(self.characteristic, EqualPercentage, "Loop.characteristic", "an EqualPercentage or None")
            self._check_travel(self.characteristic.opening)

    def _check_travel(self, opening: float) -> None:
        """Refuse output limits between which the stem may leave the travel of 0..100 %."""
        below, above = (100.0 - opening, opening) if self.fail_open else (opening, 100.0 - opening)
        # A jump longer than the stick band carries the stem beyond its input.
        beyond = max(0.0, (self.valve.slip_jump - self.valve.stick_band) / 2.0)
        limits = self.controller.output_limits
        if limits is None or limits[0] < beyond - below or limits[1] > above - beyond:
            given = "none" if limits is None else f"({limits[0]:g}, {limits[1]:g}) %"
            within = f"must lie within ({beyond - below:g}, {above - beyond:g}) %"
            why = f"the travel of a valve that is {opening:g} % open at rest and has a curved characteristic"
            raise InvalidValue("PID.output_limits", given, f"{within}, {why}")

    @property
    def direction(self) -> float:
        """The sign of the opening's change with OP: -1.0 for a fail-open valve, else 1.0."""
        return -1.0 if self.fail_open else 1.0

    @property
    def gain(self) -> float:
        """What OP does to PV at the operating point, signed: the plant's gain times `direction`, its unit."""
        return self.plant.gain * self.direction

    @property
    def curve(self) -> float:
        """c of `f(x) = (e^(c x) - 1)/c` in OP's direction, 1/%; 0 for a flow in proportion, where f(x) = x."""
        return 0.0 if self.characteristic is None else self.characteristic.curve * self.direction

    def flow(self, stem: float) -> float:
        """Return what a stem (% from rest, in OP's direction) gives the plant, % of travel in OP's direction."""
        return math.expm1(self.curve * stem) / self.curve if self.curve != 0.0 else stem

    def with_controller(self, controller: PID) -> Loop:
        """Return the same loop under another controller."""
        return replace(self, controller=controller)

    @property
    def executed(self) -> Loop:
        """The loop at the controller's executions alone: with an ideal valve, or one that sticks at once, the same."""
        return self if self.scan == 1 else replace(self, sample_time=self.scan * self.sample_time, scan=1)

    def sampling_note(self) -> str | None:
        """Return a sentence where the controller is slow for the plant (its time constant or its dead time)."""
        slow, Ts = [], self.scan * self.sample_time
        if isinstance(self.plant, FOPDT) and Ts > self.plant.time_constant:
            slow.append(f"the time constant ({given(self.plant.time_constant)} s)")
        if 0.0 < self.plant.dead_time < Ts:
            slow.append(f"the dead time ({given(self.plant.dead_time)} s)")
        if not slow:
            return None
        what = "sample time" if self.scan == 1 else "time between the controller's executions"
        return f"the {what} ({given(Ts)} s) is longer than " + " and ".join(slow)
