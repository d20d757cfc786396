"""How the site writes its settings, `site: ...`: its entry, and the form that it is."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from workbench.model.site import SiteForm
from workbench.scenario.entries import Closed
from workbench.scenario.refusals import Refusals

__all__ = ["SiteEntry", "site_form"]

GAINS = {"percent_per_eu": "%/EU", "percent_per_percent": "%/%", "proportional_band": "PB %"}
INTEGRALS = {
    "seconds": "s",
    "minutes": "min",
    "repeats_per_minute": "repeats/min",
    "repeats_per_second": "repeats/s",
}
DERIVATIVES = {"seconds": "s", "minutes": "min"}


class SiteEntry(Closed):
    """How the site's control system takes its settings; the report gives them so, as found and as left."""

    form: Annotated[
        Literal["ideal", "series", "parallel"] | None, Field(description="that of loop.controller by default")
    ] = None
    gain: Annotated[
        Literal["percent_per_eu", "percent_per_percent", "proportional_band"],
        Field(description="per cent and the proportional band, 100 / gain, are of loop.pv_range"),
    ] = "percent_per_eu"
    integral: Literal["seconds", "minutes", "repeats_per_minute", "repeats_per_second"] = "seconds"
    derivative: Literal["seconds", "minutes"] = "seconds"


def site_form(
    given: SiteEntry | None, refusals: Refusals, pv_range: tuple[float, float] | None, own: str | None, *, cases: bool
) -> SiteForm | None:
    """Return what the entry says, None where it is missing or refused (under its path).

    pv_range: EU, or None; own: the form of loop.controller, None for the default; cases: whether there are any.
    """
    if given is None:
        return None
    form, before = given.form or own or "ideal", len(refusals.issues)
    if not cases:
        refusals.refuse(("site",), "given without cases; there are no settings to write")
    if given.gain != "percent_per_eu" and pv_range is None:
        refusals.refuse(("site", "gain"), f"{given.gain} given; needs loop.pv_range: [low, high] in EU")
    if form == "parallel" and given.gain == "proportional_band":
        what = "proportional_band given; a parallel controller has a gain for each action, and no common band"
        refusals.refuse(("site", "gain"), what)
    if form == "parallel" and given.integral.startswith("repeats"):
        what = f"{given.integral} given; the integral action of a parallel controller is a gain: seconds or minutes"
        refusals.refuse(("site", "integral"), what)
    if len(refusals.issues) > before:
        return None
    return SiteForm(form, GAINS[given.gain], INTEGRALS[given.integral], DERIVATIVES[given.derivative], pv_range)
