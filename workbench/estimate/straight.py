"""The linear loop, which ignores stiction, with all that may disturb it: load steps, colour, an outside oscillation."""

from __future__ import annotations

from typing import NamedTuple

from workbench.estimate.data import Centred
from workbench.estimate.fit import Fit, fit_linear
from workbench.estimate.paths import linear_path
from workbench.estimate.scale import linear_result
from workbench.estimate.settled import coloured_linear
from workbench.estimate.swing import Answered, Swing, beside_swing
from workbench.model.results import LinearFit

__all__ = ["Straight", "linear_beside"]


class Straight(NamedTuple):
    """The linear fit to a record whose OP is as it explains more of PV; longest: the longest delay, samples."""

    data: Centred
    fit: Fit
    longest: float


def linear_beside(line: Straight, times: tuple[int, ...] = ()) -> tuple[Answered[LinearFit], Swing | None]:
    """Return the linear model beside what disturbs the loop from outside, and the oscillation if there is one.

    times: samples at which load steps are tried first.
    """

    def settled(line: Straight) -> Answered[LinearFit]:
        data, linear, _ = coloured_linear(*line, times)
        return Answered(linear_result(data, linear), linear_path(data, linear), data, ())

    def again(calm: Centred) -> Answered[LinearFit]:
        return settled(Straight(calm, fit_linear(calm, line.longest), line.longest))

    return beside_swing(line.data, settled(line), again, line.longest)
