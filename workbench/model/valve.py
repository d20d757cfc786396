"""Valves that stick: how the stem position x follows the controller output u, both in % of travel.

Every valve knows its stick band S (the width of input change that it swallows on reversal), its slip jump J and
whether it would rest at a given distance between input and stem. The laws themselves stand in the simulation kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

from workbench.model.checks import number

__all__ = ["Choudhury", "Deadband", "Ideal", "Stenman", "Valve"]


@dataclass(frozen=True, slots=True)
class Ideal:
    """A valve without friction: x_k = u_k."""

    @property
    def stick_band(self) -> float:
        """S, %: 0."""
        return 0.0

    @property
    def slip_jump(self) -> float:
        """J, %: 0."""
        return 0.0

    @property
    def hold(self) -> float:
        """Largest |u - x|, %, at which the stem at rest stays where it is: 0."""
        return 0.0


@dataclass(frozen=True, slots=True)
class Stenman:
    """One-parameter stiction: `x_k = x_{k-1}` if `|u_k - x_{k-1}| <= d`, else `u_k`.

    d: %, >= 0; the S of the paper's examples. After a slip the stem sticks at once, so a ramp becomes a staircase.
    Source: A. Stenman, F. Gustafsson, K. Forsman, "A segmentation-based method for detection of stiction in control
    valves", Int. J. Adapt. Control Signal Process. 17 (2003) 625-634. Raises `InvalidValue`.
    """

    d: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "d", number(self.d, "Stenman.d", least=0.0, unit="%"))

    @property
    def stick_band(self) -> float:
        """S, %: d, as after each slip the input must move by d again."""
        return self.d

    @property
    def slip_jump(self) -> float:
        """J, %: d, the least slip."""
        return self.d

    @property
    def hold(self) -> float:
        """Largest |u - x|, %, at which the stem stays: d."""
        return self.d


@dataclass(frozen=True, slots=True)
class Choudhury:
    """Two-parameter stiction: stick band plus dead band S, slip jump J, both in %, >= 0.

    Moving in direction s while `(u_k - u_{k-1}) s > 0`: `x_k = u_k - s (S - J)/2`. Otherwise at rest: slips when
    `|u_k - x_{k-1}| > (S + J)/2` to `x_k = u_k - s (S - J)/2` with s the sign of `u_k - x_{k-1}`, and is then moving;
    else `x_k = x_{k-1}`. Starts at rest in the middle of its band. J > S (the stem overshoots its input) is allowed.
    Source: M.A.A.S. Choudhury, N.F. Thornhill, S.L. Shah, "Modelling valve stiction", Control Eng. Practice 13
    (2005) 641-658. Raises `InvalidValue`.
    """

    S: float
    J: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "S", number(self.S, "Choudhury.S", least=0.0, unit="%"))
        object.__setattr__(self, "J", number(self.J, "Choudhury.J", least=0.0, unit="%"))

    @property
    def stick_band(self) -> float:
        """S, %."""
        return self.S

    @property
    def slip_jump(self) -> float:
        """J, %."""
        return self.J

    @property
    def hold(self) -> float:
        """Largest |u - x|, %, at which the stem at rest stays: (S + J)/2."""
        return (self.S + self.J) / 2.0


@dataclass(frozen=True, slots=True)
class Deadband:
    """Backlash or hysteresis: the stem follows at half the band's distance after a reversal has crossed the band.

    b: the full band, %, >= 0. The same law as `Choudhury(S=b, J=0)`. Raises `InvalidValue`.
    """

    b: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "b", number(self.b, "Deadband.b", least=0.0, unit="%"))

    @property
    def stick_band(self) -> float:
        """S, %: b."""
        return self.b

    @property
    def slip_jump(self) -> float:
        """J, %: 0."""
        return 0.0

    @property
    def hold(self) -> float:
        """Largest |u - x|, %, at which the stem at rest stays: b/2."""
        return self.b / 2.0


Valve = Ideal | Stenman | Choudhury | Deadband
