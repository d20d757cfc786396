"""A controller's settings as the site writes them: its form, gain or proportional band, seconds, minutes or repeats.

Inside, Kc is in %/EU and times are in seconds; here is the exact way out and back, at the digits that are typed in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from workbench.errors import InvalidValue
from workbench.model.checks import choice, number, ordered_pair
from workbench.model.controller import FORMS, PID
from workbench.model.results import KNIFE_EDGE, Kpis
from workbench.model.units import GAIN_UNITS, INTEGRAL_UNITS, gain_from, gain_to, integral_time_from, integral_time_to

__all__ = ["Beside", "CascadeSite", "CascadeSiteCase", "SiteCase", "SiteForm", "SiteSettings"]

DERIVATIVE_UNITS = ("s", "min")


@dataclass(frozen=True, slots=True)
class SiteSettings:
    """Settings as typed in: gain, integral and derivative in the site's units, and the controller that they make.

    A gain is inf for the proportional band of a controller without gain; an integral is inf for no integral action
    where it is a time, and 0 where it is a rate.
    """

    gain: float
    integral: float
    derivative: float
    controller: PID


@dataclass(frozen=True, slots=True)
class SiteForm:
    """How a site writes its controllers.

    form: "ideal", "series" or "parallel". gain: "%/EU", "%/%" of the PV range, or "PB %", the proportional band
    `100 / (%/%)`: the per cent of its range that PV moves for OP to move 100 %. With the range's span in EU,
    `PB = 100 * 100 / (Kc span)`. integral: "s", "min", "repeats/min" or "repeats/s"; derivative: "s" or "min".
    In the parallel form all three are gains: the integral one is told in %/EU (or %/%) per s or min, the derivative one
    times s or min; it has no proportional band, and no repeats. pv_range: (low, high) in EU, needed for "%/%" and
    "PB %". output: the unit of what the controller puts out, "%" but for a cascade's primary, whose output may be the
    secondary's setpoint in "EU", or in a "unit" of its own (`Cascade.output_unit`); output_span: what of it is 100 %,
    > 0. Raises `InvalidValue`.
    """

    form: str = "ideal"
    gain: str = "%/EU"
    integral: str = "s"
    derivative: str = "s"
    pv_range: tuple[float, float] | None = None
    output: str = "%"
    output_span: float = 100.0

    def __post_init__(self) -> None:
        choice(self.output, "SiteForm.output", ("%", "EU", "unit"))
        number(self.output_span, "SiteForm.output_span", above=0.0, unit=self.output)
        choice(self.form, "SiteForm.form", FORMS)
        choice(self.gain, "SiteForm.gain", GAIN_UNITS)
        choice(self.integral, "SiteForm.integral", INTEGRAL_UNITS)
        choice(self.derivative, "SiteForm.derivative", DERIVATIVE_UNITS)
        if self.form == "parallel" and self.gain == "PB %":
            allowed = "must be a gain: the actions of a parallel controller have a gain each, and no common band"
            raise InvalidValue("SiteForm.gain", self.gain, allowed)
        if self.form == "parallel" and self.integral.startswith("repeats"):
            allowed = "must be s or min: the integral action of a parallel controller is a gain of its own"
            raise InvalidValue("SiteForm.integral", self.integral, allowed)
        if self.pv_range is not None:
            object.__setattr__(self, "pv_range", ordered_pair(self.pv_range, "SiteForm.pv_range"))
        elif self.gain != "%/EU":
            raise InvalidValue("SiteForm.pv_range", "none", f"a gain in {self.gain} needs a PV range (low, high)")

    @property
    def units(self) -> tuple[str, str, str]:
        """The units of gain, integral and derivative in words: a band's "%", a parallel integral's "%/(EU s)"."""
        per, out = ("%", "%") if self.gain == "%/%" else ("EU", self.output)
        if self.form == "parallel":
            return f"{out}/{per}", f"{out}/({per} {self.integral})", f"{out} {self.derivative}/{per}"
        return "%" if self.gain == "PB %" else f"{out}/{per}", self.integral, self.derivative

    @property
    def _range(self) -> tuple[float, float] | None:
        """The PV range as the conversions of gains take it, which know an output of 100 %."""
        if self.pv_range is None or self.output_span == 100.0:
            return self.pv_range
        return 0.0, (self.pv_range[1] - self.pv_range[0]) * 100.0 / self.output_span

    def settings(self, controller: PID, digits: int | None = None, *, nearest: bool = False) -> SiteSettings:
        """Return a controller's settings in this form and these units, each rounded to `digits` significant digits.

        The settings' controller has exactly the rounded numbers (its filter ratio rounded as well), so that it is the
        one to simulate. digits: None rounds nothing. Raises `InvalidValue` where the form has no equivalent (see
        `PID.to_form`); `nearest` takes what comes nearest then (see `PID.nearest_form`).
        """
        pid = controller.nearest_form(self.form) if nearest else controller.to_form(self.form)
        minute = 60.0 if self.derivative == "min" else 1.0
        gain = gain_to(pid.Kc, self.gain, self._range)
        if self.form == "parallel":
            scale = gain_to(1.0, self.gain, self._range)
            slow = 60.0 if self.integral == "min" else 1.0
            numbers = gain, 0.0 if math.isinf(pid.Ti) else scale * slow / pid.Ti, scale * pid.Td / minute
        else:
            numbers = gain, integral_time_to(pid.Ti, self.integral), pid.Td / minute
        if digits is None:
            return SiteSettings(*numbers, pid)
        typed = [_rounded(value, digits) for value in numbers]
        if pid is not controller:  # the ratio that converts a filter has no last digit either
            pid = replace(pid, derivative_filter=_rounded(pid.derivative_filter, digits))
        return SiteSettings(typed[0], typed[1], typed[2], self.made(pid, *typed))

    def made(self, pid: PID, gain: float, integral: float, derivative: float) -> PID:
        """Return a controller of this form with the numbers given in these units."""
        Kc = 0.0 if math.isinf(gain) else gain_from(gain, self.gain, self._range)
        minute = 60.0 if self.derivative == "min" else 1.0
        if self.form == "parallel":
            scale = gain_to(1.0, self.gain, self._range)
            slow = 60.0 if self.integral == "min" else 1.0
            Ti = scale * slow / integral if integral > 0.0 else math.inf
            return replace(pid, Kc=Kc, Ti=Ti, Td=derivative * minute / scale)
        return replace(pid, Kc=Kc, Ti=integral_time_from(integral, self.integral), Td=derivative * minute)


@dataclass(frozen=True, slots=True)
class Beside:
    """What the same experiment gives with settings beside those that are typed in.

    Each number typed in moves by up to the larger of the relative `margin` and half a unit of the last of its `digits`
    (None: typed in as given, they have no last one). worst: the largest J met there, of a scenario without an objective
    the largest mean square error (EU^2), inf where a run overflows. kpis: of the run that has it, of a cascade the
    primary's, and secondary. step: the largest of them at one unit in one last digit, nan without digits.
    """

    margin: float
    digits: int | None
    worst: float
    kpis: Kpis
    step: float = math.nan
    secondary: Kpis | None = None

    def knife_edge(self, kpis: Kpis, objective: float | None) -> bool:
        """Whether settings beside give a J (a mean square error without one) larger by more than a twentieth.

        kpis and objective: of the settings that are typed in.
        """
        return self.worst > KNIFE_EDGE * (kpis.mean_square_error if objective is None else objective)


@dataclass(frozen=True, slots=True)
class SiteCase:
    """A case as typed in at the site: its settings, and what the same experiment gives with exactly them.

    settings: None where the site's form has no equivalent, and `refused` then says why. kpis and objective: of the
    controller with the rounded numbers, by exact simulation; the objective None where the scenario has none. beside:
    what settings beside them give.
    """

    name: str
    settings: SiteSettings | None
    kpis: Kpis | None = None
    objective: float | None = None
    refused: str = ""
    beside: Beside | None = None

    @property
    def knife_edge(self) -> bool:
        """Whether settings beside these give a J (a mean square error without one) larger by more than a twentieth."""
        if self.beside is None or self.kpis is None:
            return False
        return self.beside.knife_edge(self.kpis, self.objective)


@dataclass(frozen=True, slots=True)
class CascadeSite:
    """How a site writes the two controllers of a cascade."""

    primary: SiteForm
    secondary: SiteForm


@dataclass(frozen=True, slots=True)
class CascadeSiteCase:
    """A cascade's case as typed in at the site, as `SiteCase`: settings and figures of both loops.

    primary, secondary: None where the site's form has no equivalent of one of them; `refused` then says of which and
    why. kpis: of primary and secondary; objective: J of the cascade. beside: what settings of both beside them give.
    """

    name: str
    primary: SiteSettings | None
    secondary: SiteSettings | None
    kpis: tuple[Kpis, Kpis] | None = None
    objective: float | None = None
    refused: str = ""
    beside: Beside | None = None

    @property
    def knife_edge(self) -> bool:
        """Whether settings beside these do worse, as `SiteCase.knife_edge`: by the primary's error without J."""
        if self.beside is None or self.kpis is None:
            return False
        return self.beside.knife_edge(self.kpis[0], self.objective)


def _rounded(value: float, digits: int) -> float:
    return value if value == 0.0 or not math.isfinite(value) else float(f"{value:.{digits - 1}e}")
