"""From a scenario's `site: ...` to the form and units in which the site writes its settings."""

from __future__ import annotations

from workbench.model.cascade import Cascade
from workbench.model.site import CascadeSite, SiteForm
from workbench.scenario.refusals import Refusals
from workbench.scenario.schema import ScenarioFile
from workbench.scenario.site_entries import SiteEntry

__all__ = ["cascade_site", "site_form"]

GAINS = {"percent_per_eu": "%/EU", "percent_per_percent": "%/%", "proportional_band": "PB %"}
INTEGRALS = {
    "seconds": "s",
    "minutes": "min",
    "repeats_per_minute": "repeats/min",
    "repeats_per_second": "repeats/s",
}
DERIVATIVES = {"seconds": "s", "minutes": "min"}


def site_form(
    scenario: ScenarioFile, refusals: Refusals, pv_range: tuple[float, float] | None, own: str | None
) -> SiteForm | None:
    """Return what a scenario's entry says, None where it is missing or refused (under its path).

    pv_range: EU, or None; own: the form of loop.controller, None for the default.
    """
    given = _said(scenario, refusals)
    if given is None:
        return None
    before = len(refusals.issues)
    if given.gain != "percent_per_eu" and pv_range is None:
        refusals.refuse(("site", "gain"), f"{given.gain} given; needs loop.pv_range: [low, high] in EU")
    form = given.form or own or "ideal"
    _suits(given, refusals, form)
    if len(refusals.issues) > before:
        return None
    return SiteForm(form, GAINS[given.gain], INTEGRALS[given.integral], DERIVATIVES[given.derivative], pv_range)


def cascade_site(scenario: ScenarioFile, refusals: Refusals, cascade: Cascade) -> CascadeSite | None:
    """Return what a scenario's entry says of a cascade's two controllers, None where it is missing or refused.

    The primary puts out the secondary's setpoint, whose 100 % are the span of the secondary's PV range.
    """
    given = _said(scenario, refusals)
    if given is None:
        return None
    before = len(refusals.issues)
    loops = {"primary": cascade.primary, "secondary": cascade.secondary}
    missing = [name for name, loop in loops.items() if loop.pv_range is None]
    if given.gain != "percent_per_eu" and missing:
        needs = " and ".join(f"cascade.{name}.pv_range" for name in missing)
        refusals.refuse(("site", "gain"), f"{given.gain} given; needs {needs}: [low, high] in EU")
    forms = [given.form or loop.controller.form for loop in loops.values()]
    for form in dict.fromkeys(forms):
        _suits(given, refusals, form)
    if len(refusals.issues) > before:
        return None
    units = GAINS[given.gain], INTEGRALS[given.integral], DERIVATIVES[given.derivative]
    low, high = cascade.secondary.pv_range or (0.0, 100.0 * abs(cascade.scale))
    span = (high - low) / abs(cascade.scale)
    primary = SiteForm(forms[0], *units, cascade.primary.pv_range, cascade.output_unit, span)
    return CascadeSite(primary, SiteForm(forms[1], *units, cascade.secondary.pv_range))


def _said(scenario: ScenarioFile, refusals: Refusals) -> SiteEntry | None:
    """Return the entry where there is one that says something, and there are settings to write."""
    if "site" not in scenario.model_fields_set:
        return None
    given = scenario.site
    if given is None or not given.model_fields_set:
        what = f"nothing given; must say how the site writes its settings: {', '.join(SiteEntry.model_fields)}"
        refusals.refuse(("site",), what)
        return None
    if not scenario.cases:
        refusals.refuse(("site",), "given without cases; there are no settings to write")
        return None
    return given


def _suits(given: SiteEntry, refusals: Refusals, form: str) -> None:
    """Refuse the units that a form has none of."""
    if form == "parallel" and given.gain == "proportional_band":
        what = "proportional_band given; a parallel controller has a gain for each action, and no common band"
        refusals.refuse(("site", "gain"), what)
    if form == "parallel" and given.integral.startswith("repeats"):
        what = f"{given.integral} given; the integral action of a parallel controller is a gain: seconds or minutes"
        refusals.refuse(("site", "integral"), what)
