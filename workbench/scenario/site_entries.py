"""How the site writes its settings, `site: ...`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from workbench.scenario.entries import Closed

__all__ = ["SiteEntry"]


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
