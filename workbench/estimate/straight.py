"""The linear loop, which ignores stiction, with all that may disturb it: load steps, colour, an outside oscillation."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.detect.rivals import Rivals, dead_times, fine_taus
from workbench.estimate.data import Centred
from workbench.estimate.fit import Fit, again_linear, fit_linear
from workbench.estimate.paths import linear_path
from workbench.estimate.scale import linear_result
from workbench.estimate.settled import coloured_linear
from workbench.estimate.swing import Answered, Swing, beside_swing
from workbench.model.results import LinearFit

__all__ = ["Straight", "linear_beside", "sought_beside_steps"]

MOST = 4  # load steps that are sought together with the plant: as many as detection gives the linear loop


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


def sought_beside_steps(line: Straight, free: NDArray[np.bool_]) -> tuple[Straight, tuple[int, ...]]:
    """Return the line with the plant beside which load steps leave least, and the samples at which PV answers these.

    An unseen step spoils the plant that is fitted without it, so that what this leaves does not show the step (see
    `detect.load_steps`). free: shape (N,), the samples in which the load may step; there may be no steps.
    """
    data, n = line.data, line.data.samples
    rivals, taus = (
        Rivals(data.y - data.y.mean(), dead_times(n, math.nan), data.sign, np.zeros(n, dtype=bool)),
        fine_taus(n),
    )
    filters = rivals.linear(data.u, taus).a, rivals.white
    found = [rivals.under_load(data.u, a, taus, free, MOST, ramps=False) for a in filters]
    best = min(found, key=lambda one: one.variance)
    if best.fit is None:
        return line, ()
    near = replace(line.fit, tau=best.fit.tau, theta=min(float(best.fit.delay), line.longest))
    fit = again_linear(data.less(best.wave, np.empty((0, n))), near, line.longest)
    # PV has nothing of a step yet where it begins to answer it.
    return line._replace(fit=fit), tuple(t - 1 for t in best.times)
