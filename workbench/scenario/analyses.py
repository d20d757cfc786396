"""What the analyses that a scenario asks for need, refused where it is not there."""

from __future__ import annotations

from workbench.analyze.valve_loci import no_locus
from workbench.model.valve import Ideal, Valve
from workbench.scenario import schema
from workbench.scenario.refusals import Refusals

__all__ = ["check_analyses"]


def check_analyses(given: schema.ScenarioFile, valve: Valve | None, refusals: Refusals) -> list[str]:
    """Refuse analyses that a scenario has nothing for; return notes on those left out. valve: None where not known."""
    asked, notes = given.analyze, []
    if asked.repair and not given.cases:
        refusals.refuse(("analyze", "repair"), "true given without cases; there is no tuning to compare with")
    if asked.tradeoff and not given.cases:
        what = "true given without cases; there is no tuning to place on the trade-off"
        refusals.refuse(("analyze", "tradeoff"), what)
    if asked.repair and isinstance(valve, Ideal):
        refusals.refuse(("analyze", "repair"), "true given for an ideal valve; there is nothing to repair")
    why = "" if valve is None else no_locus(valve)
    if why and asked.describing_function:
        if "describing_function" in asked.model_fields_set:
            refusals.refuse(("analyze", "describing_function"), f"true given; this valve has {why}")
        notes.append(f"This valve has {why}.")
    return notes
