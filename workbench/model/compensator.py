"""Compensation of stiction beyond tuning: what a controller does besides its PID law about a sticky valve.

u_c is the output of the PID law, limits included. A compensator adds to it, or changes the integral action; the sum is
limited again and is the OP that the valve sees. Anti-windup looks at u_c alone. All times must be whole numbers of
samples of the loop. None of them knows where the stem is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from workbench.errors import InvalidValue
from workbench.model.checks import choice, number

__all__ = ["Compensator", "ConstantReinforcement", "Dither", "IntegralDeadband", "Knocker", "TwoMove", "in_samples"]


def in_samples(value: float, sample_time: float, where: str, least: int = 1) -> int:
    """Return a time (s) as a whole number of samples, or raise `InvalidValue` where it is none, or below `least`."""
    ratio = value / sample_time
    count = round(ratio)
    if count < least or abs(ratio - count) > 1e-9 * max(count, 1):
        limit = f"must be a whole number of samples of {sample_time:g} s, at least {least}"
        raise InvalidValue(where, f"{value:g} s", limit)
    return count


@dataclass(frozen=True, slots=True)
class IntegralDeadband:
    """Integral action slowed or stopped near the setpoint: `I += (Kc Ts/(ratio Ti)) e` where |e| <= band.

    band: EU, > 0. ratio: >= 1; `math.inf`, the default, stops the integrator within the band (integral deadband). A
    finite one is deadband reset scheduling, by its author from 10 to 20: D. B. Ender, "Techmation deadband reset
    scheduling algorithm", Control Engineering, February 1999. e is the measured error, noise included. The band is the
    price: PV may rest anywhere in it, and with a finite ratio the cycle is only slower.
    """

    band: float
    ratio: float = math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "band", number(self.band, "IntegralDeadband.band", above=0.0, unit="EU"))
        object.__setattr__(self, "ratio", number(self.ratio, "IntegralDeadband.ratio", least=1.0, infinite=True))

    def check(self, sample_time: float) -> None:
        """Nothing here depends on the sample time (s)."""


@dataclass(frozen=True, slots=True)
class Knocker:
    """Short pulses in the direction in which the controller's output is going.

    `u = u_c + a sign(u_c(t) - u_c(t_p))` for `t_p + h <= t < t_p + h + tau`, else `u = u_c`, with t_p the onset of the
    pulse before, for the first one the run's first sample; sign(0) = 0. amplitude a: %, > 0. width tau and period h: s,
    0 < tau <= h. After T. Hagglund, "A friction compensator for pneumatic control valves", J. Process Control 12
    (2002) 897-904.
    """

    amplitude: float
    width: float
    period: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitude", number(self.amplitude, "Knocker.amplitude", above=0.0, unit="%"))
        object.__setattr__(self, "width", number(self.width, "Knocker.width", above=0.0, unit="s"))
        object.__setattr__(self, "period", number(self.period, "Knocker.period", above=0.0, unit="s"))
        if self.period < self.width:
            raise InvalidValue("Knocker.period", f"{self.period:g} s", f"must be >= the width ({self.width:g} s)")

    def check(self, sample_time: float) -> None:
        """Raise `InvalidValue` where width or period is no whole number of samples (s)."""
        in_samples(self.width, sample_time, "Knocker.width")
        in_samples(self.period, sample_time, "Knocker.period")


@dataclass(frozen=True, slots=True)
class ConstantReinforcement:
    """A constant added in the direction of the last move: `u_k = u_c,k + a sign(u_c,k - u_c,k-1)`, sign(0) = 0.

    amplitude a: %, > 0; its authors take the estimated stiction. After L. Z. X. Ivan, S. Lakshminarayanan, "A new
    unified approach to valve stiction quantification and compensation", Ind. Eng. Chem. Res. 48 (2009) 3474-3483.
    Measurement noise turns the sign, and with it the stem, at every sample.
    """

    amplitude: float

    def __post_init__(self) -> None:
        value = number(self.amplitude, "ConstantReinforcement.amplitude", above=0.0, unit="%")
        object.__setattr__(self, "amplitude", value)

    def check(self, sample_time: float) -> None:
        """Nothing here depends on the sample time (s)."""


@dataclass(frozen=True, slots=True)
class TwoMove:
    """Two moves that put the stem where PV rests on the setpoint, after which the output is held.

    The PID law runs until `at` (s), when for one sample `u = u_s + (v + |v|) + a`, v = u_c - u_s, which frees the stem
    and takes it at least a away from u_s; from the next sample on `u = u_s`, to which it then returns. After R.
    Srinivasan, R. Rengaswamy, "Approaches for efficient stiction compensation in process control valves", Comput. Chem.
    Eng. 32 (2008) 218-229, where u_s = 0 and a = alpha d with alpha > 1.

    amplitude a: %, > 0. steady_output u_s: %, from the resting output: the one at which PV rests on the setpoint in
    open loop, which the method has to know; the mean of a cycling OP is a poor guess of it where the cycle's halves
    differ. release: EU; while the output is held the loop is open, and neither setpoint changes nor loads are answered,
    until |e| exceeds it: then the controller goes on for good from the held output, as u_s is no longer the right one.
    `math.inf`, the default, holds for good.

    Assumes a self-regulating plant and a stem that follows a long move to the input, as Stenman's does; one that stops
    short of it stays off by that. A stem that the first move finds above u_s slips only beyond its stick band: a of
    twice the band is always enough near u_s.
    """

    amplitude: float
    at: float
    steady_output: float
    release: float = math.inf

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("amplitude", number(self.amplitude, "TwoMove.amplitude", above=0.0, unit="%"))
        put("at", number(self.at, "TwoMove.at", least=0.0, unit="s"))
        put("steady_output", number(self.steady_output, "TwoMove.steady_output", unit="%"))
        put("release", number(self.release, "TwoMove.release", above=0.0, infinite=True, unit="EU"))

    def check(self, sample_time: float) -> None:
        """Raise `InvalidValue` where the moment is no whole number of samples (s)."""
        in_samples(self.at, sample_time, "TwoMove.at", least=0)


@dataclass(frozen=True, slots=True)
class Dither:
    """A fast periodic signal added to the output: `u_k = u_c,k + a sin(2 pi (k + 1/2)/n)`, n samples a period.

    amplitude a: %, > 0. period: s, at least 2 samples. shape: "sine", or "square", +a over the first half of a period
    and -a over the second, for which n must be even. The half sample keeps the mean of a period at 0 and lets n = 2
    alternate between +a and -a. See B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, "A survey of models, analysis
    tools and compensation methods for the control of machines with friction", Automatica 30 (1994) 1083-1138. A
    pneumatic valve filters dither that is too fast, which no valve here does.
    """

    amplitude: float
    period: float
    shape: str = "sine"

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitude", number(self.amplitude, "Dither.amplitude", above=0.0, unit="%"))
        object.__setattr__(self, "period", number(self.period, "Dither.period", above=0.0, unit="s"))
        choice(self.shape, "Dither.shape", ("sine", "square"))

    def check(self, sample_time: float) -> None:
        """Raise `InvalidValue` where the period is no whole number of samples (s), or a square one's is odd."""
        count = in_samples(self.period, sample_time, "Dither.period", least=2)
        if self.shape == "square" and count % 2:
            limit = f"must be an even number of samples of {sample_time:g} s for a square dither"
            raise InvalidValue("Dither.period", f"{self.period:g} s", limit)


Compensator = IntegralDeadband | Knocker | ConstantReinforcement | TwoMove | Dither
