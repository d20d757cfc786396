"""What a robust tuning must stand: an ensemble of circumstances and plants, and the constraints on the loop."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.errors import InvalidValue
from workbench.model.checks import choice, number, ordered_pair, whole
from workbench.model.loop import Loop
from workbench.model.numbers import given
from workbench.model.plant import FOPDT

__all__ = ["Constraints", "Ensemble"]

STATISTICS = ("mean", "percentile", "cvar")
# The relative uncertainties, in the order in which they are drawn.
UNCERTAIN = ("gain", "time_constant", "dead_time", "stiction")
# Plant-ready runs: at least and at most so many samples; the stiction (%) that stands in for a valve without any.
FEWEST, MOST, USUAL_STICTION = 300, 5_000, 1.0
# The signals of so many draws of a thousand samples still fit into memory.
MOST_DRAWS = 20_000


@dataclass(frozen=True, slots=True)
class Ensemble:
    """Random circumstances and plants around a loop, every quantity uniform and independent.

    Each draw is one run of `duration` (s, a whole number of samples) from rest: a setpoint step at 0 s of random sign
    and a size in the range `setpoint` (EU); a load step of random sign, a size in `load` (%) and at a whole sample in
    `load_time` (s); an initial stem offset within +-`stem_offset` (0..1) times what the drawn valve holds; white
    measurement noise of a standard deviation in `noise` (EU); and a plant and valve whose gain, time constant, dead
    time and stiction (d; S and J alike; b) differ from the loop's by at most the relative amounts `gain`,
    `time_constant`, `dead_time` and `stiction` (0..0.9). Equal ends and 0 fix a quantity.

    draws: how many, 1..20,000; seed: draw i comes from `default_rng([seed, i])`, so that fewer are the first of more.
    statistic: what is minimised of J over the draws: "mean", "percentile" (the `level` quantile) or "cvar" (the mean of
    the worst 1 - `level` share); level: 0 < level < 1, without meaning for the mean. Raises `InvalidValue`.
    """

    duration: float
    setpoint: tuple[float, float] = (0.0, 0.0)
    load: tuple[float, float] = (0.0, 0.0)
    load_time: tuple[float, float] = (0.0, 0.0)
    stem_offset: float = 0.0
    noise: tuple[float, float] = (0.0, 0.0)
    gain: float = 0.0
    time_constant: float = 0.0
    dead_time: float = 0.0
    stiction: float = 0.0
    draws: int = 300
    seed: int = 0
    statistic: str = "mean"
    level: float = 0.9

    def __post_init__(self) -> None:
        object.__setattr__(self, "duration", number(self.duration, "Ensemble.duration", above=0.0, unit="s"))
        for name in ("setpoint", "load", "load_time", "noise"):
            pair = ordered_pair(getattr(self, name), f"Ensemble.{name}", least=0.0, equal=True)
            object.__setattr__(self, name, pair)
        if self.load_time[1] > self.duration:
            allowed = f"must lie within the duration of {self.duration:g} s"
            raise InvalidValue("Ensemble.load_time", self.load_time, allowed)
        value = number(self.stem_offset, "Ensemble.stem_offset", least=0.0, most=1.0)
        object.__setattr__(self, "stem_offset", value)
        for name in UNCERTAIN:
            value = number(getattr(self, name), f"Ensemble.{name}", least=0.0, most=0.9)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "draws", whole(self.draws, "Ensemble.draws", least=1))
        number(self.draws, "Ensemble.draws", most=MOST_DRAWS)
        object.__setattr__(self, "seed", whole(self.seed, "Ensemble.seed"))
        choice(self.statistic, "Ensemble.statistic", STATISTICS)
        level = number(self.level, "Ensemble.level", above=0.0)
        if level >= 1.0:
            raise InvalidValue("Ensemble.level", level, "must be below 1")
        object.__setattr__(self, "level", level)

    @classmethod
    def plant_ready(cls, loop: Loop) -> Ensemble:
        """Return the default ensemble of a loop, named "plant-ready": what a loop in service has to stand.

        With D the valve's stiction ((S + J)/2; 1 % where it has none), T the larger of time constant and dead time
        (integrating: 4 dead times, or 4 samples) and K the gain (integrating: that times T): setpoint steps of 0.5 to 4
        times K D, load steps of 0.25 to 1 times D at 0.2 to 0.5 of the duration, noise of 0.01 to 0.05 times K D, stem
        offsets within all that the valve holds, gain, time constant and dead time within 20 %, stiction within 30 %.
        The duration is 200 T, but 300 samples at least and 5,000 at most.
        """
        plant, Ts = loop.plant, loop.sample_time
        if isinstance(plant, FOPDT):
            T = max(plant.time_constant, plant.dead_time)
            K = abs(plant.gain)
        else:
            T = 4.0 * max(plant.dead_time, Ts)
            K = abs(plant.gain) * T
        D = loop.valve.hold if loop.valve.hold > 0.0 else USUAL_STICTION
        duration = min(max(round(200.0 * T / Ts), FEWEST), MOST) * Ts
        return cls(
            duration=duration,
            setpoint=(0.5 * K * D, 4.0 * K * D),
            load=(0.25 * D, D),
            load_time=(0.2 * duration, 0.5 * duration),
            stem_offset=1.0,
            noise=(0.01 * K * D, 0.05 * K * D),
            gain=0.2,
            time_constant=0.2 if isinstance(plant, FOPDT) else 0.0,
            dead_time=0.2,
            stiction=0.3,
        )


@dataclass(frozen=True, slots=True)
class Constraints:
    """What a robust tuning must keep, besides the stability of every corner plant; None asks for nothing.

    max_sensitivity: the largest maximum sensitivity Ms (> 1), gain_margin: the least factor (> 1) and phase_margin: the
    least angle (degrees, 0..90), each of the sampled loop with an ideal valve at the worst corner of the plant's
    uncertainty. valve_travel: the largest mean travel over the draws, % in the ensemble's duration, > 0. Raises
    `InvalidValue`.
    """

    max_sensitivity: float | None = None
    gain_margin: float | None = None
    phase_margin: float | None = None
    valve_travel: float | None = None

    def __post_init__(self) -> None:
        for name, above, most, unit in (
            ("max_sensitivity", 1.0, None, ""),
            ("gain_margin", 1.0, None, ""),
            ("phase_margin", 0.0, 90.0, "degrees"),
            ("valve_travel", 0.0, None, "%"),
        ):
            value = getattr(self, name)
            if value is not None:
                checked = number(value, f"Constraints.{name}", above=above, most=most, unit=unit)
                object.__setattr__(self, name, checked)

    def missed(self, margins: tuple[float, float, float], travel: float, travel_words: str) -> list[str]:
        """Say which of these margins (Ms, gain, phase in degrees) and a valve travel (%) break, and by how much."""
        Ms, gain, phase = margins
        words = []
        if self.max_sensitivity is not None and Ms > self.max_sensitivity:
            words.append(f"a maximum sensitivity of {given(Ms, 3)} (at most {self.max_sensitivity:g})")
        if self.gain_margin is not None and gain < self.gain_margin:
            words.append(f"a gain margin of {given(gain, 3)} (at least {self.gain_margin:g})")
        if self.phase_margin is not None and phase < self.phase_margin:
            words.append(f"a phase margin of {given(phase, 3)} degrees (at least {self.phase_margin:g})")
        if self.valve_travel is not None and travel > self.valve_travel:
            words.append(f"a {travel_words} of {given(travel, 3)} % (at most {self.valve_travel:g} %)")
        return words
