"""Valves that stick: how the stem position x follows the controller output u, both in % of travel.

Every valve knows its stick band S (the width of input change that it swallows on reversal), its slip jump J, whether
it would rest at a given distance between input and stem, and whether its stem, once it slips, sticks again at once or
goes on with the input. The laws themselves stand in the simulation kernel.

In forces, of a spring and diaphragm with friction f_s at rest and f_d in motion (both in % of the input's span):
`S = f_s + f_d`, `J = f_s - f_d`; the stem slips where u is further than f_s from it, and moves f_d behind u.
"""

from __future__ import annotations

from dataclasses import dataclass

from workbench.errors import InvalidValue
from workbench.model.checks import instance, number
from workbench.model.karnopp import Karnopp

__all__ = ["Choudhury", "Deadband", "Directional", "He", "Ideal", "Kano", "Positional", "Stenman", "Valve"]

MOST_PLACES = 64


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

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip: no, it never sticks."""
        return False


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

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip: yes."""
        return True


@dataclass(frozen=True, slots=True)
class He:
    """Stiction by static and dynamic friction: `x_k = x_{k-1}` if `|u_k - x_{k-1}| <= fs`, else `u_k - s fd`.

    s is the sign of `u_k - x_{k-1}`; fs and fd: %, `fs >= fd >= 0`. As published it accumulates the residual force
    `u_r + u_k - u_{k-1}`, which is `u_k - x_{k-1}`, and sticks again after each sample's slip: `He(d, 0)` is
    `Stenman(d)`, `He(b/2, b/2)` is `Deadband(b)` but for rounding, and between them a ramp becomes a staircase of steps
    J. Source: Q.P. He, J. Wang, M. Pottmann, S.J. Qin, "A curve fitting method for detecting valve stiction in
    oscillating control loops", Ind. Eng. Chem. Res. 46 (2007) 4549-4560. Raises `InvalidValue`.
    """

    fs: float
    fd: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "fs", number(self.fs, "He.fs", least=0.0, unit="%"))
        object.__setattr__(self, "fd", number(self.fd, "He.fd", least=0.0, unit="%"))
        if self.fd > self.fs:
            allowed = f"must be at most fs ({self.fs:g} %): friction in motion does not exceed that at rest"
            raise InvalidValue("He.fd", f"{self.fd:g} %", allowed)

    @property
    def stick_band(self) -> float:
        """S, %: fs + fd."""
        return self.fs + self.fd

    @property
    def slip_jump(self) -> float:
        """J, %: fs - fd, the least slip."""
        return self.fs - self.fd

    @property
    def hold(self) -> float:
        """Largest |u - x|, %, at which the stem stays: fs."""
        return self.fs

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip: yes."""
        return True


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

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip: no, it goes on until the input turns."""
        return False


@dataclass(frozen=True, slots=True)
class Kano:
    """Two-parameter stiction as Kano writes it: stick band plus dead band S, slip jump J, both in %, `S >= J >= 0`.

    It remembers u_s, the input at which the stem stopped, and d (1 or -1), the direction in which it moved before. At
    rest it slips in direction d where `d (u_k - u_s) > J`, and the other way, d changing its sign, where
    `-d (u_k - u_s) > S`; moving, `x_k = u_k - d (S - J)/2` until the input stands or turns. Starts at rest with u_s at
    the stem and d = 1, so that the first slip upward needs J and the first downward S; from the first reversal that the
    stem follows on, it is the law of `Choudhury`. J > S would be a negative friction in motion and is refused.
    Source: M. Kano, H. Maruta, H. Kugemoto, K. Shimizu, "Practical model and detection algorithm for valve stiction",
    IFAC Proc. Volumes 37 (9) (DYCOPS 2004) 859-864. Raises `InvalidValue`.
    """

    S: float
    J: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "S", number(self.S, "Kano.S", least=0.0, unit="%"))
        object.__setattr__(self, "J", number(self.J, "Kano.J", least=0.0, unit="%"))
        if self.J > self.S:
            allowed = f"must be at most S ({self.S:g} %): more would be a negative friction in motion"
            raise InvalidValue("Kano.J", f"{self.J:g} %", allowed)

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
        """Largest |u - x|, %, at which the stem stays before its first move, either way: J."""
        return self.J

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip: no, it goes on until the input turns."""
        return False


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

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip: no, it goes on until the input turns."""
        return False


@dataclass(frozen=True, slots=True)
class Directional:
    """Two-parameter stiction that differs by direction.

    up, down: the friction of each direction, as the `Choudhury` (or `Deadband`) valve that has it both ways. At rest
    the stem slips up where `u_k - x_{k-1} > (S + J)/2` of `up`, and down where `x_{k-1} - u_k > (S + J)/2` of `down`;
    moving, it follows `(S - J)/2` of that direction's pair behind u, until the input stands or turns. With equal pairs
    it is that valve. On reversal it swallows `(S_up - J_up)/2 + (S_down + J_down)/2` at the top and the mirrored sum at
    the bottom. A jump so long that one of these is negative would carry the stem beyond what holds it there, and is
    refused. Raises `InvalidValue`.
    """

    up: Choudhury | Deadband
    down: Choudhury | Deadband

    def __post_init__(self) -> None:
        instance(self.up, (Choudhury, Deadband), "Directional.up", "a Choudhury or a Deadband")
        instance(self.down, (Choudhury, Deadband), "Directional.down", "a Choudhury or a Deadband")
        for name, swallowed in zip(("up", "down"), self.swallowed, strict=True):
            if swallowed < 0.0:
                most = 2.0 * swallowed + getattr(self, name).slip_jump
                allowed = (
                    f"must be at most {most:g} %: beyond that the friction of the other way does not hold the stem"
                )
                raise InvalidValue(f"Directional.{name}", f"slip jump {getattr(self, name).slip_jump:g} %", allowed)

    @property
    def swallowed(self) -> tuple[float, float]:
        """The change of the input that the turn at the top, after a way up, and that at the bottom swallow, %."""
        ways = ((self.up, self.down), (self.down, self.up))
        top, bottom = ((a.stick_band - a.slip_jump) / 2.0 + b.hold for a, b in ways)
        return top, bottom

    @property
    def stick_band(self) -> float:
        """S, %: the mean of both directions', which is that of both reversals' too."""
        return (self.up.stick_band + self.down.stick_band) / 2.0

    @property
    def slip_jump(self) -> float:
        """J, %: the smaller of both directions'."""
        return min(self.up.slip_jump, self.down.slip_jump)

    @property
    def hold(self) -> float:
        """Largest |u - x|, %, at which the stem at rest stays, either way: the smaller of both directions'."""
        return min(self.up.hold, self.down.hold)

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip: no, it goes on until the input turns."""
        return False


@dataclass(frozen=True, slots=True)
class Positional:
    """Stiction that varies along the travel: tight packing, a worn seat, a bent stem.

    positions: stem positions, % from rest in OP's direction, ascending, 1 to 64; valves: the friction at each, all
    `Stenman`, all `He`, all `Choudhury` or all `Deadband`. Their parameters are interpolated linearly between the
    positions and stay beyond the ends. In each sample the law is that valve's with the parameters at x_{k-1}, where the
    stem stands before it; where this would take a moving stem back against its motion it stays, moving. With one and
    the same valve everywhere it is that valve. What a stem slips at or follows by, (S + J)/2, (S - J)/2, d, f_s or f_d,
    may change by less than 1 % for each % of travel: faster, and the spring could not hold a moving stem back. The form
    is this project's own. Raises `InvalidValue`.
    """

    positions: tuple[float, ...]
    valves: tuple[Stenman | He | Choudhury | Deadband, ...]

    def __post_init__(self) -> None:
        for name in ("positions", "valves"):
            where = f"Positional.{name}"
            instance(getattr(self, name), (tuple, list), where, "a tuple")
            if not 1 <= len(getattr(self, name)) <= MOST_PLACES:
                raise InvalidValue(where, f"{len(getattr(self, name))} entries", f"must be 1 to {MOST_PLACES}")
        at = tuple(number(x, f"Positional.positions[{i}]", unit="%") for i, x in enumerate(self.positions))
        if len(at) != len(self.valves):
            allowed = f"must be as many as the positions ({len(at)})"
            raise InvalidValue("Positional.valves", f"{len(self.valves)} entries", allowed)
        kind = type(self.valves[0])
        for i, valve in enumerate(self.valves):
            instance(valve, (Stenman, He, Choudhury, Deadband), f"Positional.valves[{i}]", "a valve of those kinds")
            if type(valve) is not kind:
                allowed = f"must be of the first one's kind ({kind.__name__})"
                raise InvalidValue(f"Positional.valves[{i}]", type(valve).__name__, allowed)
        object.__setattr__(self, "positions", at)
        object.__setattr__(self, "valves", tuple(self.valves))
        for i in range(len(at) - 1):
            if not at[i] < at[i + 1]:
                raise InvalidValue(f"Positional.positions[{i + 1}]", f"{at[i + 1]:g} %", f"must be above {at[i]:g} %")
            a, b = self.valves[i], self.valves[i + 1]
            change = max(abs(b.hold - a.hold), abs(_followed(b) - _followed(a)))
            if change >= at[i + 1] - at[i]:
                allowed = f"must be less than the {at[i + 1] - at[i]:g} % of travel from the position before"
                raise InvalidValue(f"Positional.valves[{i + 1}]", f"friction that changes by {change:g} %", allowed)

    @property
    def stick_band(self) -> float:
        """S, %: the largest."""
        return max(valve.stick_band for valve in self.valves)

    @property
    def slip_jump(self) -> float:
        """J, %: the smallest."""
        return min(valve.slip_jump for valve in self.valves)

    @property
    def hold(self) -> float:
        """Largest |u - x|, %, at which the stem at rest stays where it starts, at x = 0."""
        return self.between(0.0, tuple(valve.hold for valve in self.valves))

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip, as its valves do."""
        return self.valves[0].sticks_at_once

    def between(self, x: float, values: tuple[float, ...]) -> float:
        """Return the value at stem position x (%) where `values` stand at the positions."""
        at = self.positions
        if x <= at[0]:
            return values[0]
        for i in range(len(at) - 1):
            if x <= at[i + 1]:
                return values[i] + (x - at[i]) / (at[i + 1] - at[i]) * (values[i + 1] - values[i])
        return values[-1]


def _followed(valve: Stenman | He | Choudhury | Deadband) -> float:
    """How far behind its input a moving stem stays, %."""
    return valve.fd if isinstance(valve, He) else (valve.stick_band - valve.slip_jump) / 2.0


Valve = Ideal | Stenman | He | Choudhury | Kano | Deadband | Directional | Positional | Karnopp
