"""What is done to the loop: setpoint, load disturbance, measurement noise, where the stem starts.

All signals are deviations from the resting operating point. A profile's parts are added up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from workbench.errors import InvalidValue
from workbench.model.checks import number, sequence, whole

__all__ = ["Experiment", "Noise", "Profile", "Ramp", "Series", "Step", "profile_parts"]

PROFILES = "a Step, Ramp or Series, or a list of these: Step(4.0) for a step of 4"


@dataclass(frozen=True, slots=True)
class Step:
    """A step of `size` (EU for setpoints, % of travel for loads) that has happened in the sample at time `at` (s)."""

    size: float
    at: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", number(self.size, "Step.size"))
        object.__setattr__(self, "at", number(self.at, "Step.at", least=0.0, unit="s"))


@dataclass(frozen=True, slots=True)
class Ramp:
    """A straight line from 0 at `start` (s) to `size` at `end` (s), held afterwards."""

    size: float
    start: float
    end: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", number(self.size, "Ramp.size"))
        object.__setattr__(self, "start", number(self.start, "Ramp.start", least=0.0, unit="s"))
        object.__setattr__(self, "end", number(self.end, "Ramp.end", unit="s"))
        if self.end <= self.start:
            raise InvalidValue("Ramp.end", self.end, f"must be after the start ({self.start:g} s)")


@dataclass(frozen=True, slots=True)
class Series:
    """A list of values, or a recorded series.

    Without `times` one value for each sample, the last held. With `times` (s, ascending, as many as values) each
    value holds from its time on, and the signal is 0 before the first. Any sequence of numbers; kept as tuples.
    """

    values: Sequence[float]
    times: Sequence[float] | None = None

    def __post_init__(self) -> None:
        values = _numbers(self.values, "Series.values")
        if not values:
            raise InvalidValue("Series.values", "no value", "must hold at least one number")
        object.__setattr__(self, "values", values)
        if self.times is None:
            return
        times = _numbers(self.times, "Series.times")
        if len(times) != len(values):
            raise InvalidValue("Series.times", f"{len(times)} times", f"must be as many as the {len(values)} values")
        for i in range(1, len(times)):
            if times[i] <= times[i - 1]:
                raise InvalidValue(
                    f"Series.times[{i}]", times[i], f"must be after the time before it ({times[i - 1]:g} s)"
                )
        object.__setattr__(self, "times", times)


def _numbers(values: object, where: str) -> tuple[float, ...]:
    listed = sequence(values, where, "a sequence of numbers")
    return tuple(number(value, f"{where}[{i}]") for i, value in enumerate(listed))


Profile = Step | Ramp | Series


@dataclass(frozen=True, slots=True)
class Noise:
    """White Gaussian measurement noise of standard deviation `sd` (EU, >= 0), drawn by `default_rng(seed)`."""

    sd: float
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "sd", number(self.sd, "Noise.sd", least=0.0, unit="EU"))
        object.__setattr__(self, "seed", whole(self.seed, "Noise.seed"))


def profile_parts(value: object, where: str, last: float) -> tuple[Profile, ...]:
    """Return a profile's parts, checked; `last` (s) is the latest start. Raises `InvalidValue`."""
    if value is None:
        return ()
    parts = (value,) if isinstance(value, Step | Ramp | Series) else tuple(sequence(value, where, PROFILES))
    checked: list[Profile] = []
    for part in parts:
        if not isinstance(part, Step | Ramp | Series):
            raise InvalidValue(where, part, f"must be {PROFILES}")
        begin = part.at if isinstance(part, Step) else part.start if isinstance(part, Ramp) else 0.0
        if begin > last:
            raise InvalidValue(where, f"a start at {begin:g} s", f"must start within the experiment of {last:g} s")
        checked.append(part)
    return tuple(checked)


@dataclass(frozen=True, slots=True)
class Experiment:
    """One run's circumstances.

    duration: s, > 0, a whole number of samples. setpoint: EU, load: % at the plant input before the dead time; each a
    `Step`, `Ramp`, `Series`, a sequence of them (added up), or None. noise: on the measurement. stem_offset: %, the
    resting distance of the controller's output from the stem at the start (the valve must hold it). Raises
    `InvalidValue`.
    """

    duration: float
    setpoint: Profile | Sequence[Profile] | None = None
    load: Profile | Sequence[Profile] | None = None
    noise: Noise | None = None
    stem_offset: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "duration", number(self.duration, "Experiment.duration", above=0.0, unit="s"))
        for name in ("setpoint", "load"):
            parts = profile_parts(getattr(self, name), f"Experiment.{name}", self.duration)
            # One part is the same run, and the same experiment, in a list as by itself.
            object.__setattr__(self, name, parts[0] if len(parts) == 1 else parts or None)
        if self.noise is not None and not isinstance(self.noise, Noise):
            raise InvalidValue("Experiment.noise", self.noise, "must be a Noise(sd, seed) or None")
        object.__setattr__(self, "stem_offset", number(self.stem_offset, "Experiment.stem_offset", unit="%"))

    @property
    def setpoint_parts(self) -> tuple[Profile, ...]:
        """The setpoint's parts as a tuple."""
        return profile_parts(self.setpoint, "Experiment.setpoint", self.duration)

    @property
    def load_parts(self) -> tuple[Profile, ...]:
        """The load's parts as a tuple."""
        return profile_parts(self.load, "Experiment.load", self.duration)
