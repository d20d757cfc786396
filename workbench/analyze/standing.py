"""Whether a tuning holds its loop by itself, or only the sticking valve does: over all that the plant may be."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np

from workbench.analyze.frequency import linear_stable
from workbench.analyze.margins import loop_margins, margins
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.results import Intervals, Standing
from workbench.simulate.coefficients import coefficients

__all__ = ["standing"]

FASTEST = 1e-3  # sample times: a time constant whose range begins below that is no slower than none


def standing(loop: Loop, ranges: Intervals | None = None) -> Standing | None:
    """Return the margins of a loop with an ideal valve, and those where the ranges of its plant are worst for it.

    ranges: of the plant (gain, s, s), None for a plant that is given; an end that is open, or a gain's that is not on
    the gain's side of 0, tells no place to try, and the plant's own value stands for it. None where the controller
    feeds nothing back. Raises `InvalidValue` where the controller has no ideal equivalent.
    """
    if loop.controller.Kc == 0.0:
        return None
    own = margins(loop)
    corners = [] if ranges is None else [replace(loop, plant=plant) for plant in _corners(loop, ranges)]
    if not corners:
        return Standing(own)
    falls = next((corner for corner in corners if not linear_stable(corner)), None)
    if falls is None:
        rows = np.concatenate([coefficients(corner.executed) for corner in corners])
        Ms = loop_margins(rows, loop.executed.sample_time, all_three=False)[0][:, 0]
        falls = corners[int(Ms.argmax())]
    return Standing(own, margins(falls))


def _corners(loop: Loop, ranges: Intervals) -> list[Plant]:
    """Return the plants at the ends of the ranges, those first that differ in the fewest parameters."""
    plant = loop.plant
    names = ("gain", "time_constant", "dead_time") if isinstance(plant, FOPDT) else ("gain", "dead_time")
    choices = []
    for name in names:
        value, pair = getattr(plant, name), getattr(ranges, name)
        ends = [end for end in pair or () if math.isfinite(end) and end != value]
        if name == "gain":
            ends = [end for end in ends if end * value > 0.0]
        elif name == "time_constant":
            ends = [max(end, FASTEST * loop.sample_time) for end in ends]
        choices.append([value, *reversed(ends)])
    places = sorted(product(*choices), key=lambda place: sum(a != b[0] for a, b in zip(place, choices, strict=True)))
    return [replace(plant, **dict(zip(names, place, strict=True))) for place in places[1:]]
