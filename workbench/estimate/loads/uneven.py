"""Stems that do not stick alike at every slip, in the measure of what disturbs the loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, Limits, fit_path, grounded, predict
from workbench.estimate.loads.settled import colour_of
from workbench.estimate.loads.steps import Stem
from workbench.estimate.search.uneven import Uneven, differing, uneven_stems

__all__ = ["uneven_beside_colour"]

COLOURINGS = 3  # rounds of stems and disturbance in turn
GONE_ON_WITH = 3  # stems
# In N log V behind an even stem: in the measure of another disturbance stems follow that, and those about the best are
# of little use. Of 38 searches that uneven ones won all but two were at most 440 behind once in colour.
FAR = 1000.0


def uneven_beside_colour(
    whole: Centred, seeds: Sequence[tuple[bool, float, float, Fit]], limits: Limits, skip: int, even: float
) -> tuple[Centred, list[Uneven]]:
    """Return the record in the measure of what the likeliest stem leaves, and the stems there, the likeliest first.

    whole: the record as if the disturbance were white; seeds: as of `uneven_stems`; skip: the first samples, which do
    not count; even: BIC of what a stem of one band does. Colour and stem are found in turn, until the stem stays.
    """
    data = whole.whitened(whole.a, skip)
    kinds = {sticks for sticks, *_ in seeds}
    met = uneven_stems(data, seeds, limits, kinds, even + FAR)
    last: Uneven | None = None
    for _ in range(COLOURINGS):
        if not met or (last is not None and np.array_equal(last.x, met[0].x)):
            break
        best = met[0]
        left = (
            whole.y - predict(whole, best.x, best.first, grounded(data, best.x, best.first, best.fit, best.bounds))[0]
        )
        lead = Stem(best.x, best.first, best.fit, valve=(best.S, best.J, best.first, 0.0))
        colour, _ = colour_of(whole, left[skip:], lead, limits, skip)
        if colour.a.size == data.a.size == 1:
            break
        last = best if data.a.size > 1 else None
        data = whole.whitened(colour.a, skip, colour.law)
        again: list[tuple[bool, float, float, Fit]] = []
        for one in differing(met, GONE_ON_WITH):
            tau, theta = one.fit.tau, one.fit.theta
            fit = fit_path(data, one.x, one.first, one.bounds, limits, theta, tau=tau)
            again.append((one.sticks, one.S, one.J, fit))
        met = uneven_stems(data, again, limits, kinds, even + FAR)
    return data, met
