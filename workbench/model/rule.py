"""Published tuning rules as values: which rule, with which options. `tune.rules.apply_rule` holds their formulas.

K is the plant's gain without its sign, tau its time constant, theta its dead time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from workbench.model.checks import choice, number

__all__ = ["Amigo", "DetunedIntegral", "Lambda", "NoCrossing", "Rule", "Simc", "ZieglerNichols"]

CONTROLLERS = ("PI", "PID")


@dataclass(frozen=True, slots=True)
class Simc:
    """Skogestad's rule, a PI controller.

    First order: `Kc = tau/(K (tau_c + theta))`, `Ti = min(tau, 4 (tau_c + theta))`. Integrating:
    `Kc = 1/(K (tau_c + theta))`, `Ti = 4 (tau_c + theta)`. tau_c: the closed loop's time constant, s, > 0; None: theta,
    the rule's own choice for tight control.
    Source: S. Skogestad, "Simple analytic rules for model reduction and PID controller tuning", J. Process Control 13
    (2003) 291-309. Raises `InvalidValue`.
    """

    name: ClassVar[str] = "simc"
    source: ClassVar[str] = "S. Skogestad, J. Process Control 13 (2003) 291-309"
    tau_c: float | None = None

    def __post_init__(self) -> None:
        if self.tau_c is not None:
            object.__setattr__(self, "tau_c", number(self.tau_c, "Simc.tau_c", above=0.0, unit="s"))


@dataclass(frozen=True, slots=True)
class Lambda:
    """Lambda tuning, a PI controller for a closed loop of time constant lambda.

    First order: `Kc = tau/(K (lambda + theta))`, `Ti = tau`. Integrating: `Kc = (2 lambda + theta)/(K (lambda +
    theta)^2)`, `Ti = 2 lambda + theta`. value: lambda in `unit`, > 0; unit: "tau", multiples of tau (3, the default, is
    the usual robust choice), or "s".
    Source: I.-L. Chien, P.S. Fruehauf, "Consider IMC tuning to improve controller performance", Chem. Eng. Prog. 86
    (10) (1990) 33-41. Raises `InvalidValue`.
    """

    name: ClassVar[str] = "lambda"
    source: ClassVar[str] = "I.-L. Chien, P.S. Fruehauf, Chem. Eng. Prog. 86 (10) (1990) 33-41"
    value: float = 3.0
    unit: str = "tau"

    def __post_init__(self) -> None:
        choice(self.unit, "Lambda.unit", ("tau", "s"))
        object.__setattr__(self, "value", number(self.value, "Lambda.value", above=0.0, unit=self.unit))


@dataclass(frozen=True, slots=True)
class Amigo:
    """AMIGO, for a maximum sensitivity of about 1.4. controller: "PI" or "PID" (in the ideal form).

    First order, PI: `Kc = [0.15 + (0.35 - theta tau/(theta + tau)^2) tau/theta]/K`,
    `Ti = 0.35 theta + 13 theta tau^2/(tau^2 + 12 theta tau + 7 theta^2)`; PID: `Kc = (0.2 + 0.45 tau/theta)/K`,
    `Ti = theta (0.4 theta + 0.8 tau)/(theta + 0.1 tau)`, `Td = 0.5 theta tau/(0.3 theta + tau)`.
    Integrating, PI: `Kc = 0.35/(K theta)`, `Ti = 13.4 theta`; PID: `Kc = 0.45/(K theta)`, `Ti = 8 theta`,
    `Td = 0.5 theta`. The rule's own choice of setpoint weight is left to the controller.
    Source: K.J. Astrom, T. Hagglund, "Revisiting the Ziegler-Nichols step response method for PID control", J. Process
    Control 14 (2004) 635-650. Raises `InvalidValue`.
    """

    name: ClassVar[str] = "amigo"
    source: ClassVar[str] = "K.J. Åström, T. Hägglund, J. Process Control 14 (2004) 635-650"
    controller: str = "PI"

    def __post_init__(self) -> None:
        choice(self.controller, "Amigo.controller", CONTROLLERS)


@dataclass(frozen=True, slots=True)
class ZieglerNichols:
    """Ziegler and Nichols' rules. method: "step" (from the plant's step response) or "ultimate". controller: PI or PID.

    Step, with a = K theta/tau (integrating: K theta): PI `Kc = 0.9/a`, `Ti = theta/0.3`; PID `Kc = 1.2/a`,
    `Ti = 2 theta`, `Td = theta/2`. Ultimate, with the gain Ku at which proportional control alone swings with the
    period Pu: PI `Kc = 0.45 Ku`, `Ti = Pu/1.2`; PID `Kc = 0.6 Ku`, `Ti = Pu/2`, `Td = Pu/8`. Ku and Pu are those of the
    sampled loop with an ideal valve, as an experiment on it would show them.
    Source: J.G. Ziegler, N.B. Nichols, "Optimum settings for automatic controllers", Trans. ASME 64 (1942) 759-768.
    Raises `InvalidValue`.
    """

    name: ClassVar[str] = "ziegler_nichols"
    source: ClassVar[str] = "J.G. Ziegler, N.B. Nichols, Trans. ASME 64 (1942) 759-768"
    method: str = "step"
    controller: str = "PI"

    def __post_init__(self) -> None:
        choice(self.method, "ZieglerNichols.method", ("step", "ultimate"))
        choice(self.controller, "ZieglerNichols.controller", CONTROLLERS)


@dataclass(frozen=True, slots=True)
class DetunedIntegral:
    """Slower integral action, all else as it is: `factor` times the present Ti. factor: > 1.

    It lengthens the cycle and saves wear; it does not make a slow cycle smaller.
    Source: Case 2 of Table II in "Managing the Performance of Control Loops with Valve Stiction: An Industrial
    Perspective", ten times the integral time of Case 1. Raises `InvalidValue`.
    """

    name: ClassVar[str] = "detuned_integral"
    source: ClassVar[str] = "Managing the Performance of Control Loops with Valve Stiction, Table II, Case 2"
    factor: float = 10.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "factor", number(self.factor, "DetunedIntegral.factor", above=1.0))


@dataclass(frozen=True, slots=True)
class NoCrossing:
    """The PI controller for which the describing function predicts no cycle, for a first-order plant.

    `Ti = integral_ratio (tau + theta)`, as with `Ti <= tau + theta` the loci always cross; Kc is the gain at which the
    loci first meet (or, where that is lower, at which the sampled loop with an ideal valve loses its stability) over
    gain_margin. A two-parameter valve's locus starts at -90 degrees: where L has that phase, |L| must stay below
    `pi S/(4 J)`. integral_ratio and gain_margin: > 1. An integrating plant's loci cross with every PI controller.
    The describing function is an approximation, and blind to slow cycles: the exact simulation may cycle all the same.
    Source: the describing function of M.A.A.S. Choudhury, N.F. Thornhill, S.L. Shah, Control Eng. Practice 13 (2005)
    641-658. Raises `InvalidValue`.
    """

    name: ClassVar[str] = "no_crossing"
    source: ClassVar[str] = "M.A.A.S. Choudhury, N.F. Thornhill, S.L. Shah, Control Eng. Practice 13 (2005) 641-658"
    integral_ratio: float = 2.0
    gain_margin: float = 2.0

    def __post_init__(self) -> None:
        for name in ("integral_ratio", "gain_margin"):
            object.__setattr__(self, name, number(getattr(self, name), f"NoCrossing.{name}", above=1.0))


Rule = Simc | Lambda | Amigo | ZieglerNichols | DetunedIntegral | NoCrossing
