"""A cascade: the primary's output is the setpoint of the secondary, which holds the valve. And what comes of one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from workbench.errors import InvalidValue
from workbench.model.checks import choice, instance, number
from workbench.model.controller import PID
from workbench.model.experiment import Experiment, Noise, Profile, profile_parts
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.results import Run, Tuned
from workbench.model.show import Shown
from workbench.model.valve import Ideal

__all__ = ["Appearance", "Cascade", "CascadeCycle", "CascadeExperiment", "CascadeRun", "CascadeTuned"]


@dataclass(frozen=True, slots=True)
class Cascade:
    """Two loops, one in the other.

    secondary: a `Loop` with the valve; its sample time Ts is the cascade's. primary: a `Loop` whose plant runs from the
    secondary's PV (EU of the secondary) to the primary's, so that its gain is in EU of the primary per EU of the
    secondary; its valve must be `Ideal()`, as its final element is the secondary; its sample time is n Ts, n whole: it
    acts on every n-th sample, the first included, before the secondary does, and its output is held in between.

    scale: EU of the secondary per unit of the primary's output, not 0. 1, the default, lets the primary put out the
    secondary's setpoint in its own unit (Kc in EU of the secondary per EU of the primary); a primary that puts out % of
    the secondary's range has a hundredth of its span. All in deviations from rest.

    anti_windup: "clamp", the default: the primary leaves out its integral step while the secondary's output stands at a
    limit and the step would drive it further out; "none": it integrates on. The primary's own `output_limits` and
    anti-windup hold besides. Raises `InvalidValue`.
    """

    primary: Loop
    secondary: Loop
    scale: float = 1.0
    anti_windup: str = "clamp"

    def __post_init__(self) -> None:
        instance(self.primary, Loop, "Cascade.primary", "a Loop")
        instance(self.secondary, Loop, "Cascade.secondary", "a Loop")
        if not isinstance(self.primary.valve, Ideal):
            given = type(self.primary.valve).__name__
            raise InvalidValue("Cascade.primary.valve", given, "must be Ideal(): the valve is the secondary's")
        for name, loop in (("primary", self.primary), ("secondary", self.secondary)):
            more = {
                "characteristic": loop.characteristic is not None,
                "fail_open": loop.fail_open,
                "scan": loop.scan > 1,
            }
            for field in (field for field, there in more.items() if there):
                limit = "must be left out: a cascade's loops are linear but for the valve and execute at every sample"
                raise InvalidValue(f"Cascade.{name}.{field}", getattr(loop, field), limit)
        object.__setattr__(self, "scale", number(self.scale, "Cascade.scale"))
        if self.scale == 0.0:
            raise InvalidValue("Cascade.scale", self.scale, "must not be 0")
        choice(self.anti_windup, "Cascade.anti_windup", ("clamp", "none"))
        ratio = self.primary.sample_time / self.secondary.sample_time
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            limit = f"must be a whole number of the secondary's samples of {self.secondary.sample_time:g} s"
            raise InvalidValue("Cascade.primary.sample_time", f"{self.primary.sample_time:g} s", limit)

    @property
    def output_unit(self) -> str:
        """What the primary's output is in: "EU" of the secondary, "%" of its PV range, or a "unit" that `scale` tells.

        Unlike `scale` it is of words alone: the primary's own figures are all in it.
        """
        if self.scale == 1.0:
            return "EU"
        low, high = self.secondary.pv_range or (0.0, 0.0)
        return "%" if math.isclose(high - low, 100.0 * abs(self.scale)) else "unit"

    @property
    def every(self) -> int:
        """How many samples of the secondary the primary's scan takes: n."""
        return round(self.primary.sample_time / self.secondary.sample_time)

    def with_controllers(self, primary: PID | None = None, secondary: PID | None = None) -> Cascade:
        """Return the same cascade under other controllers; None leaves one as it is."""
        loops = (self.primary, self.secondary)
        first, second = (
            loop if pid is None else loop.with_controller(pid)
            for loop, pid in zip(loops, (primary, secondary), strict=True)
        )
        return replace(self, primary=first, secondary=second)


@dataclass(frozen=True, slots=True)
class CascadeExperiment(Experiment):
    """An `Experiment` of a cascade: setpoint and noise are the primary's, load and stem offset the valve's.

    primary_load: EU of the secondary, added to its PV at the primary plant's input, before the dead time. It is not
    measured by the secondary. secondary_noise: on the secondary's measurement. A plain `Experiment` has neither.
    """

    primary_load: Profile | tuple[Profile, ...] | None = None
    secondary_noise: Noise | None = None

    def __post_init__(self) -> None:
        Experiment.__post_init__(self)
        parts = profile_parts(self.primary_load, "CascadeExperiment.primary_load", self.duration)
        object.__setattr__(self, "primary_load", parts or None)
        if self.secondary_noise is not None and not isinstance(self.secondary_noise, Noise):
            where = "CascadeExperiment.secondary_noise"
            raise InvalidValue(where, self.secondary_noise, "must be a Noise(sd, seed) or None")

    @property
    def primary_load_parts(self) -> tuple[Profile, ...]:
        """The primary load's parts as a tuple."""
        return profile_parts(self.primary_load, "CascadeExperiment.primary_load", self.duration)


@dataclass(frozen=True, eq=False)
class CascadeRun(Shown):
    """One exact simulation of a cascade, both loops on the secondary's samples: time (s), shape (N,).

    secondary: its `sp` is the primary's output times the scale. primary: `op` is its output, held between scans, and
    what is called `valve` (with its travel and reversals) is what the primary moves: the secondary's PV, without noise,
    in units of that output; `load` is the primary's (EU of the secondary). In both, `experiment` is the cascade's, and
    overshoot and settling time are the primary's alone.
    """

    cascade: Cascade
    experiment: Experiment
    primary: Run
    secondary: Run

    @property
    def time(self) -> FloatArray:
        """s, shape (N,)."""
        return self.primary.time


@dataclass(frozen=True, slots=True)
class Appearance:
    """What a cycle looks like in one of the loops.

    pv_, sp_ and op_peak_to_peak: median over cycles of max - min (EU; %, or the primary's own output). _amplitude: of
    the fundamental; _phase: how far that lags the fundamental of the stem, degrees, 0 to 360; nan for a signal at rest.
    """

    pv_peak_to_peak: float
    sp_peak_to_peak: float
    op_peak_to_peak: float
    pv_amplitude: float
    sp_amplitude: float
    op_amplitude: float
    pv_phase: float
    sp_phase: float
    op_phase: float


@dataclass(frozen=True, eq=False)
class CascadeCycle(Shown):
    """A cascade's long run after an experiment, without noise: "settles", "cycles" or "undecided", and why.

    period: s; travel_per_hour: of the stem, %; primary and secondary: how the cycle appears in each; nan and None where
    there is none. `late`: the run's last stretch, from which the appearances are taken.
    """

    cascade: Cascade
    outcome: str
    reason: str
    period: float = math.nan
    travel_per_hour: float = math.nan
    primary: Appearance | None = None
    secondary: Appearance | None = None
    late: CascadeRun | None = None


@dataclass(frozen=True, eq=False)
class CascadeTuned(Shown):
    """A cascade tuned in turn: the secondary by itself, the primary in the cascade with the secondary tuned so.

    cascade: with the controllers found. secondary: None where it was left as it was. primary: its objective, and all
    other J in it, are of exact simulations of the cascade, with the primary's error and the secondary's output and
    valve (see `tune_cascade`); guard_margin is nan. start_objective: J of the cascade as it was given.
    """

    cascade: Cascade
    experiment: Experiment
    primary: Tuned
    secondary: Tuned | None
    start_objective: float
