"""What the report says of a tuning that only a sticking valve holds, or that its plant's ranges may upset."""

from __future__ import annotations

from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.results import Margins, Standing
from workbench.model.study import CaseResult
from workbench.model.valve import Ideal
from workbench.report.words import figure, join

__all__ = ["held_by_stiction", "room_words", "standing_doubt", "trap_words"]

ROOM = 0.9  # of the maximum sensitivity allowed, below which a tuning leaves room for a faster one
POOR = 5.0  # maximum sensitivity above which a quarter more gain may make a loop unstable


def held_by_stiction(standing: Standing | None) -> bool:
    """Return whether the loop is unstable without the valve's stiction."""
    return standing is not None and not standing.own.stable


def standing_doubt(standing: Standing | None) -> str:
    """Return in a few words why a tuning may not hold its loop, the place in the plant's ranges named, or ""."""
    if standing is None:
        return ""
    if held_by_stiction(standing):
        sticks = not isinstance(standing.own.loop.valve, Ideal)
        return f"{_why(standing.own)}{': only stiction holds it' if sticks else ''}"
    if why := _why(standing.own):
        return why
    worst = standing.worst
    if worst is not None and (why := _why(worst)):
        return f"with {_place(worst.loop, standing.own.loop)}, within the plant's 95 % range, {why}"
    return ""


def _why(margins: Margins) -> str:
    if not margins.stable:
        return "the loop with an ideal valve is unstable"
    if margins.max_sensitivity > POOR:
        Ms = figure(margins.max_sensitivity, 2)
        return f"the loop with an ideal valve is near instability (maximum sensitivity {Ms})"
    return ""


def _place(there: Loop, own: Loop) -> str:
    """Return the parameters in which a plant differs from the loop's own: "gain 2.27 EU/% and dead time 2.44 s"."""
    fopdt = isinstance(there.plant, FOPDT)
    units = {"gain": "EU/%" if fopdt else "EU/(% s)", "time_constant": "s", "dead_time": "s"}
    return join(
        [
            f"{name.replace('_', ' ')} {figure(value, 3)} {unit}"
            for name, unit in units.items()
            # An integrating plant has no time constant.
            if (value := getattr(there.plant, name, None)) is not None and value != getattr(own.plant, name)
        ]
    )


def room_words(standing: Standing | None, most: float | None) -> str:
    """Return that a repaired valve allows more than a record's tuning asks of it, or "" where that is not known.

    most: the maximum sensitivity that the tuning was to keep, None where it was to keep none.
    """
    if standing is None or standing.worst is None or most is None:
        return ""
    reached = max(standing.own.max_sensitivity, standing.worst.max_sensitivity)
    if reached > ROOM * most:
        return ""
    return (
        f"A repaired valve allows more: with an ideal valve the maximum sensitivity is {figure(reached, 2)} at most "
        f"within the plant's 95 % range, and {figure(most, 2)} was allowed."
    )


def trap_words(case: CaseResult, back: str) -> str:
    """Return the warning that goes with a tuning that only stiction holds, "" for any other.

    back: the tuning to put back, in words, or "".
    """
    if not held_by_stiction(case.standing) or isinstance(case.loop.valve, Ideal):
        return ""
    before = f"put {back} back" if back else "take another tuning"
    return (
        f"Before the valve is repaired {before}: with an ideal valve this tuning makes the loop unstable, and a load "
        "that keeps the sticking valve moving may do the same."
    )
