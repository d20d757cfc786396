"""The PID controller in the forms that control systems offer, and the exact ways between them.

Ideal (ISA standard) form, the one that the simulation knows: `Kc (e + integral(e)/Ti + Td de/dt)`.
Series (interacting): `Kc (1 + 1/(Ti s)) (1 + Td s/(Tf s + 1))`.
Parallel (independent): `Kc e + integral(e)/Ti + Td de/dt`.
In every form the derivative is filtered with a time constant Tf, which all equivalent forms share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import get_args

from workbench.errors import InvalidValue
from workbench.model.checks import choice, number, ordered_pair
from workbench.model.compensator import Compensator

__all__ = ["PID", "STRUCTURES", "IdealTerms"]

FORMS = ("ideal", "series", "parallel")

# Plain names of where the three actions act: (derivative_on, setpoint_weight).
STRUCTURES: dict[str, tuple[str, float]] = {
    "PID on error": ("error", 1.0),
    "PI on error, D on PV": ("pv", 1.0),
    "I on error, PD on PV": ("pv", 0.0),
}


@dataclass(frozen=True, slots=True)
class IdealTerms:
    """What the law needs of a controller: ideal-form Kc (%/EU, unsigned), Ti (s), Td (s), Tf (s), setpoint weight b.

    Td may be negative where a series controller filters its derivative harder than its integral time.
    """

    Kc: float
    Ti: float
    Td: float
    Tf: float
    b: float


@dataclass(frozen=True, slots=True)
class PID:
    """A PID controller.

    Kc: gain, %/EU, >= 0 (the sign comes from `action`). Ti: integral time, s, > 0; `math.inf` for none.
    Td: derivative time, s, >= 0. `form`: "ideal", "series" or "parallel"; in the parallel form 1/Ti is the integral
    gain in %/(EU s) and Td the derivative gain in % s/EU. `derivative_on`: "error" or "pv".
    `derivative_filter`: n of `Tf = Td/n` (in the parallel form `Tf = Td/(Kc n)`), > 0; `math.inf` for unfiltered.
    `setpoint_weight`: b of the proportional action, 0..1. `action`: "reverse" (OP falls when PV rises, for plants of
    positive gain) or "direct". `output_limits`: (low, high), % in deviation from the resting output, or None.
    `anti_windup`: "clamp" (where OP lies beyond a limit and this sample's integral step pushes it further out, the step
    is undone and OP formed anew without it) or "back_calculation" (`I += Ts/Tt (u_limited - u)`, with `tracking_time`
    Tt, s, Ti of the ideal form unless given).
    `output_resolution`: q, %, >= 0, of the output that leaves the controller, as a converter or a smart positioner has
    it; 0 for none. After the limits, an output u that no limit holds becomes `bias + q round((u - bias)/q)`, halves to
    even: levels are counted from the resting output (bias, u before the first sample), which is a level; a level beyond
    a limit is that limit. Valve, record and figures see the rounded output; the controller does not: its integral, its
    derivative and back-calculation go on with the unrounded one.
    `compensator`: what the controller does about stiction besides this law (`model.compensator`), before the output is
    rounded, or None. Raises `InvalidValue`.
    """

    Kc: float
    Ti: float
    Td: float = 0.0
    form: str = "ideal"
    derivative_on: str = "error"
    derivative_filter: float = 10.0
    setpoint_weight: float = 1.0
    action: str = "reverse"
    output_limits: tuple[float, float] | None = None
    anti_windup: str = "clamp"
    tracking_time: float | None = None
    output_resolution: float = 0.0
    compensator: Compensator | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("Kc", number(self.Kc, "PID.Kc", least=0.0, unit="%/EU (a direct-acting controller: action 'direct')"))
        put("Ti", number(self.Ti, "PID.Ti", above=0.0, infinite=True, unit="s"))
        put("Td", number(self.Td, "PID.Td", least=0.0, unit="s"))
        choice(self.form, "PID.form", FORMS)
        choice(self.derivative_on, "PID.derivative_on", ("error", "pv"))
        put("derivative_filter", number(self.derivative_filter, "PID.derivative_filter", above=0.0, infinite=True))
        put("setpoint_weight", number(self.setpoint_weight, "PID.setpoint_weight", least=0.0, most=1.0))
        choice(self.action, "PID.action", ("reverse", "direct"))
        if self.output_limits is not None:
            limits = ordered_pair(self.output_limits, "PID.output_limits")
            if not limits[0] <= 0.0 <= limits[1]:
                raise InvalidValue("PID.output_limits", limits, "must enclose 0, the resting output in deviation")
            put("output_limits", limits)
        choice(self.anti_windup, "PID.anti_windup", ("clamp", "back_calculation"))
        if self.tracking_time is not None:
            put("tracking_time", number(self.tracking_time, "PID.tracking_time", above=0.0, unit="s"))
        put("output_resolution", number(self.output_resolution, "PID.output_resolution", least=0.0, unit="%"))
        if self.compensator is not None and not isinstance(self.compensator, get_args(Compensator)):
            raise InvalidValue("PID.compensator", self.compensator, "must be one of the compensators or None")
        if self.form == "parallel" and self.Kc == 0.0 and self.Td > 0.0 and not math.isinf(self.derivative_filter):
            raise InvalidValue("PID.Kc", self.Kc, "a filtered derivative in the parallel form needs Kc > 0")

    @property
    def structure(self) -> str | None:
        """The plain name of where the actions act, or None where the setpoint weight has no such name."""
        for name, settings in STRUCTURES.items():
            if settings == (self.derivative_on, self.setpoint_weight):
                return name
        return None

    @property
    def signed_gain(self) -> float:
        """+1.0 for reverse action, -1.0 for direct action: the factor on Kc in the law."""
        return 1.0 if self.action == "reverse" else -1.0

    def ideal_terms(self) -> IdealTerms:
        """Return the exactly equivalent ideal-form terms.

        Series (partial fractions): `Kc(1 + Td/Ti)`, `Ti + Td`, `Td(Ti - Tf)/(Ti + Td)`, the same Tf; the proportional
        action on the setpoint keeps its size. Raises `InvalidValue` where no equivalent exists (parallel with Kc = 0).
        """
        Kc, Ti, Td, b = self.Kc, self.Ti, self.Td, self.setpoint_weight
        if self.form == "ideal":
            return IdealTerms(Kc, Ti, Td, Td / self.derivative_filter, b)
        if self.form == "parallel":
            if Kc == 0.0:
                if Td == 0.0 and math.isinf(Ti):
                    return IdealTerms(0.0, Ti, 0.0, 0.0, b)
                raise InvalidValue("PID.Kc", Kc, "a parallel controller with Kc = 0 has no ideal equivalent")
            if Kc * Ti == 0.0:
                raise InvalidValue("PID.Ti", Ti, "the ideal equivalent's Ti, Kc Ti, is too small for a number")
            return IdealTerms(Kc, Kc * Ti, Td / Kc, Td / Kc / self.derivative_filter, b)
        Tf = Td / self.derivative_filter
        if math.isinf(Ti):
            return IdealTerms(Kc, Ti, Td, Tf, b)
        weight = (b * Ti + Td) / (Ti + Td) if self.derivative_on == "error" else b * Ti / (Ti + Td)
        return IdealTerms(Kc * (1.0 + Td / Ti), Ti + Td, Td * (Ti - Tf) / (Ti + Td), Tf, weight)

    def check_sampling(self, sample_time: float) -> None:
        """Refuse what does not suit the sample time (s): times of a compensator, fast back-calculation.

        Raises `InvalidValue`, for back-calculation as `check_tracking` says.
        """
        if self.compensator is not None:
            self.compensator.check(sample_time)
        self.check_tracking(sample_time)

    def check_tracking(self, sample_time: float) -> None:
        """Refuse back-calculation that is too fast for the sample time (s). Raises `InvalidValue`.

        `I += Ts/Tt (u_limited - u)` leaves `1 - Ts/Tt` of what OP exceeds a limit by: from `Tt = Ts/2` down it may
        throw OP past the other limit and back, without end at Ts/2 and ever further below it. Tt is Ti of the ideal
        form by default.
        """
        if self.output_limits is None or self.anti_windup != "back_calculation":
            return
        Tt = self.ideal_terms().Ti if self.tracking_time is None else self.tracking_time
        if Tt <= sample_time / 2.0:
            given = f"{Tt:g} s" if self.tracking_time is not None else f"{Tt:g} s (that of Ti)"
            limit = f"must be longer than half the sample time ({sample_time:g} s), or back-calculation is unstable"
            raise InvalidValue("PID.tracking_time", given, limit)

    def with_ideal(self, Kc: float, Ti: float, Td: float = 0.0) -> PID:
        """Return this controller with the parameters, in its own form, that act as Kc, Ti and Td of the ideal form.

        Form, structure, filter ratio n, action and limits stay. Ti must be finite. Raises `InvalidValue` where there
        are none: series needs `Ti >= 4 (1 + 1/n) Td`, parallel Kc > 0.
        """
        Kc = number(Kc, "PID.Kc", least=0.0, unit="%/EU")
        Ti = number(Ti, "Ti", above=0.0, unit="s")
        Td = number(Td, "PID.Td", least=0.0, unit="s")
        if self.form == "parallel":
            return replace(self, Kc=Kc, Ti=Ti / number(Kc, "PID.Kc", above=0.0, unit="%/EU"), Td=Kc * Td)
        if self.form == "ideal" or Td == 0.0:
            return replace(self, Kc=Kc, Ti=Ti, Td=Td)
        # The series terms of `ideal_terms`, with Tf = Td'/n, solved for Td'.
        share = 4.0 * (1.0 + 1.0 / self.derivative_filter)
        root = Ti * Ti - share * Ti * Td  # products, as a power that overflows raises
        if not root >= -1e-12 * Ti * Ti or math.isinf(root):
            rule = f"a series equivalent with this derivative filter needs Ti >= {share:g} Td"
            raise InvalidValue("PID", f"Ti = {Ti:g} s, Td = {Td:g} s of the ideal form", rule)
        series_Td = 2.0 * Ti * Td / (Ti + math.sqrt(max(root, 0.0)))
        return replace(self, Kc=Kc * (Ti - series_Td) / Ti, Ti=Ti - series_Td, Td=series_Td)

    def to_form(self, form: str) -> PID:
        """Return the exactly equivalent controller in another form.

        Raises `InvalidValue` where there is none: series needs `(Ti - Tf)^2 >= 4 Ti Td` of the ideal form (unfiltered:
        Ti >= 4 Td) and a setpoint weight that it can realise; ideal needs a derivative time that is not negative.
        """
        choice(form, "form", FORMS)
        if form == self.form:
            return self
        t = self.ideal_terms()
        if form == "ideal":
            if t.Td < 0.0 or (t.Td == 0.0 and t.Tf > 0.0):
                raise InvalidValue("PID.Td", self.Td, "the ideal equivalent needs Ti > Tf = Td/n of the series form")
            return self._rebuilt("ideal", t.Kc, t.Ti, t.Td, t.Tf, t.b)
        if form == "parallel":
            if t.Kc == 0.0 and not (math.isinf(t.Ti) and t.Td == 0.0):
                raise InvalidValue("PID.Kc", t.Kc, "a parallel equivalent needs Kc > 0")
            if t.Td < 0.0 or (t.Td == 0.0 and t.Tf > 0.0):
                raise InvalidValue("PID.Td", self.Td, "the parallel equivalent needs Ti > Tf = Td/n of the series form")
            Ti = math.inf if math.isinf(t.Ti) else t.Ti / t.Kc
            n = t.Td / t.Tf if t.Tf > 0.0 else (self.derivative_filter if t.Td == 0.0 else math.inf)
            return replace(
                self, form="parallel", Kc=t.Kc, Ti=Ti, Td=t.Kc * t.Td, derivative_filter=n, setpoint_weight=t.b
            )
        return self._to_series(t)

    def nearest_form(self, form: str) -> PID:
        """Return `to_form(form)`, or where there is none the controller of that form that comes nearest.

        Gain, integral time and filter ratio n of the ideal form stay. For series the derivative time is cut to the
        longest that has an equivalent, `(Ti - Td/n)^2 = 4 Ti Td`, and a setpoint weight outside 0..1 to its nearer end;
        for ideal and parallel a derivative that its filter outweighs is left out. Raises `InvalidValue` where gain is
        missing (parallel with Kc = 0).
        """
        try:
            return self.to_form(form)
        except InvalidValue:
            t = self.ideal_terms()
        if form != "series":
            plain = self._rebuilt("ideal", t.Kc, t.Ti, 0.0, 0.0, t.b)
            return plain.to_form(form)
        ratio = 0.0 if t.Tf == 0.0 else t.Tf / t.Td
        middle = 4.0 + 2.0 * ratio
        # The smaller root of (1 - ratio x)^2 = 4 x, x = Td/Ti, and a last bit less.
        longest = t.Ti * 2.0 / (middle + math.sqrt(middle * middle - 4.0 * ratio * ratio)) * (1.0 - 1e-12)
        Td = min(t.Td, longest)
        return self._to_series(replace(t, Td=Td, Tf=ratio * Td), nearest=True)

    def _to_series(self, t: IdealTerms, *, nearest: bool = False) -> PID:
        if t.Td == 0.0 and t.Tf == 0.0:
            return self._rebuilt("series", t.Kc, t.Ti, 0.0, 0.0, t.b)
        if math.isinf(t.Ti):
            return self._rebuilt("series", t.Kc, t.Ti, t.Td, t.Tf, t.b)
        root = (t.Ti - t.Tf) * (t.Ti - t.Tf) - 4.0 * t.Ti * t.Td
        if not 0.0 <= root < math.inf:
            rule = "a series equivalent needs (Ti - Tf)^2 >= 4 Ti Td (unfiltered: Ti >= 4 Td)"
            raise InvalidValue("PID", f"Ti = {t.Ti:g} s, Td = {t.Td:g} s, Tf = {t.Tf:g} s", rule)
        Ti = 0.5 * (t.Ti + t.Tf + math.sqrt(root))
        Td = t.Ti - Ti
        b = (t.b * t.Ti - Td) / Ti if self.derivative_on == "error" else t.b * t.Ti / Ti
        if not nearest and not -1e-12 <= b <= 1.0 + 1e-12:
            raise InvalidValue(
                "PID.setpoint_weight", t.b, f"a series equivalent would need the weight {b:g}, outside 0..1"
            )
        return self._rebuilt("series", t.Kc * Ti / t.Ti, Ti, Td, t.Tf, min(max(b, 0.0), 1.0))

    def _rebuilt(self, form: str, Kc: float, Ti: float, Td: float, Tf: float, b: float) -> PID:
        n = Td / Tf if Tf > 0.0 else (self.derivative_filter if Td == 0.0 else math.inf)
        return replace(self, form=form, Kc=Kc, Ti=Ti, Td=Td, derivative_filter=n, setpoint_weight=b)
