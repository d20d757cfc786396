"""A valve as a mechanism: a stem with mass on a spring, held by packing friction, to try methods on.

It is nobody's stiction model: what the laws of `model.valve` say of it is an approximation, and so is what an estimate
finds.
"""

from __future__ import annotations

from dataclasses import dataclass

from workbench.errors import InvalidValue
from workbench.model.checks import number

__all__ = ["Karnopp"]

# Of the Stribeck velocity: slower, a stem that its friction can hold has stopped.
CREEP = 1e-3


@dataclass(frozen=True, slots=True)
class Karnopp:
    """A stem of mass m on a spring k under Coulomb, static, Stribeck and viscous friction.

    With X the stem's position and U that of its input (m; 100 % is `travel`), V = dX/dt:
    `m dV/dt = k (U - X) - F(V)`, `F(V) = sign(V) [Fc + (Fs - Fc) exp(-(V/Vs)^2)] + Fv V`; a stem at rest stays while
    `k |U - X|` is at most what friction can hold, `Fs + Fv Vs/1000`, and one that is slower than Vs/1000 stops where
    that holds. mass: kg, > 0. spring: N/m, > 0. travel: m, > 0. coulomb, static: Fc and Fs, N, `Fs >= Fc >= 0`,
    viscous: Fv, N s/m, >= 0. stribeck: Vs, m/s, > 0. OP is held through each sample, within which the motion is
    integrated in equal substeps of at most `substep` (s, > 0), spring and viscous friction implicitly, which is stable
    for every substep; the plant sees the position at the sample's end through that sample.

    Sources: D. Karnopp, "Computer simulation of stick-slip friction in mechanical dynamic systems", J. Dyn. Syst. Meas.
    Control 107 (1985) 100-103, whose band of zero velocity this is; C. Garcia, "Comparison of friction models applied
    to a control valve", Control Eng. Practice 16 (2008) 1231-1243. A set from the literature (A. Kayihan, F.J. Doyle,
    "Friction compensation for a process control valve", Control Eng. Practice 8 (2000) 799-812, as Choudhury, Thornhill
    and Shah use it, 2005): m = 1.36 kg, k = 52,500 N/m, Fc = 1423 N, Fs = 1708 N, Fv = 612 N s/m, Vs = 0.254 mm/s,
    travel 84.7 mm (0.0645 m2 of diaphragm under 68,950 Pa). Raises `InvalidValue`.
    """

    mass: float
    spring: float
    travel: float
    coulomb: float
    static: float
    viscous: float
    stribeck: float
    substep: float = 1e-3

    def __post_init__(self) -> None:
        for name, unit in (("mass", "kg"), ("spring", "N/m"), ("travel", "m"), ("stribeck", "m/s"), ("substep", "s")):
            object.__setattr__(self, name, number(getattr(self, name), f"Karnopp.{name}", above=0.0, unit=unit))
        for name, unit in (("coulomb", "N"), ("static", "N"), ("viscous", "N s/m")):
            object.__setattr__(self, name, number(getattr(self, name), f"Karnopp.{name}", least=0.0, unit=unit))
        if self.static < self.coulomb:
            allowed = f"must be at least the Coulomb friction ({self.coulomb:g} N)"
            raise InvalidValue("Karnopp.static", f"{self.static:g} N", allowed)

    def percent(self, force: float) -> float:
        """Return the change of the input, %, that a force (N) is worth at the spring."""
        return 100.0 * force / (self.spring * self.travel)

    @property
    def stick_band(self) -> float:
        """S, %: of static and Coulomb friction together, what a slow reversal would swallow without Stribeck effect."""
        return self.percent(self.static + self.coulomb)

    @property
    def slip_jump(self) -> float:
        """J, %: of their difference. The stem itself lands where speed, mass and Stribeck effect let it."""
        return self.percent(self.static - self.coulomb)

    @property
    def hold(self) -> float:
        """Largest |u - x|, %, at which the stem at rest stays."""
        return self.percent(self.static + self.viscous * CREEP * self.stribeck)

    @property
    def sticks_at_once(self) -> bool:
        """Whether the stem sticks again after each sample's slip: no, it may still move when the sample ends."""
        return False
