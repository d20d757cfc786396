"""The map of a scenario, `analyze: {map: ...}`: its entry, and the job that it is."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from pydantic import Field

from workbench.model.checks import ordered_pair
from workbench.model.cycle_map import MOST, POINTS
from workbench.scenario.entries import Closed, IntegralRange, IntegralTime, Number, Time, TrueOr
from workbench.scenario.plan import MapJob
from workbench.scenario.refusals import Refusals

__all__ = ["MapEntry", "map_job"]


class MapFields(Closed):
    """What each tuning of a plane does in the long run; ranges that are left out suit the loop and hold its cases."""

    Kc: Annotated[
        list[Annotated[Number, Field(gt=0)]] | None,
        Field(min_length=2, max_length=2, description="[low, high], %/EU, in the controller's own form"),
    ] = None
    Ti: Annotated[
        IntegralRange | None, Field(min_length=2, max_length=2, description="[low, high]; or a range of Td")
    ] = None
    Td: Annotated[list[Time] | None, Field(min_length=2, max_length=2, description="[low, high]; or a range of Ti")] = (
        None
    )
    at_Ti: Annotated[IntegralTime | None, Field(description="of a map over Kc and Td; the first case's")] = None
    at_Td: Annotated[Time | None, Field(description="of a map over Kc and Ti; the first case's")] = None
    points: Annotated[int, Field(ge=2, le=MOST, description="cells along each axis")] = POINTS
    starts: Annotated[int, Field(ge=1, le=8, description="how many starts each cell is followed from")] = 4


MapEntry = Annotated[MapFields | None, TrueOr("a map")]


def map_job(given: MapFields | None, refusals: Refusals, *, cases: bool) -> MapJob | None:
    """Return what the entry asks for, None where nothing; what it must not ask for is refused under its path."""
    if given is None:
        return None
    path = ("analyze", "map")
    if not cases:
        refusals.refuse(path, "given without cases; the map shows where they lie")
    if given.Ti is not None and given.Td is not None:
        refusals.refuse((*path, "Td"), "range given beside a range of Ti; a map has two axes, Kc and one of them")
    over, fixed = ("Td", "Ti") if given.Td is not None else ("Ti", "Td")
    if getattr(given, f"at_{over}") is not None:
        what = f"given, but {over} is an axis of this map; at_{fixed} says the other one"
        refusals.refuse((*path, f"at_{over}"), what)
    for name in ("Kc", "Ti", "Td"):
        pair = getattr(given, name)
        if pair is not None:
            refusals.attempt((*path, name), partial(ordered_pair, pair, name))

    def both(pair: list[float] | None) -> tuple[float, float] | None:
        return None if pair is None else (pair[0], pair[1])

    return MapJob(both(given.Kc), both(given.Ti), both(given.Td), given.at_Ti, given.at_Td, given.points, given.starts)
