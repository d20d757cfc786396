"""Stems of another jump that fit as well as the best where the disturbance beside them may have a colour of its own.

In a cycle a larger jump makes up for a smaller gain. In the measure of what the best stem leaves the others look worse
than they are, and the ranges narrower: the filter has taken to the best. The likelihood region is followed here along
the jump, plant and autoregression free in each (as `freed` follows it beside load steps of their own).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Limits
from workbench.estimate.fits.sureness import sure_samples
from workbench.estimate.loads.own_colour import of_jump, other_jumps, own_colour
from workbench.estimate.loads.steps import Stem
from workbench.estimate.search.bands import Bands
from workbench.estimate.search.profile import CHI_SQUARE
from workbench.estimate.search.two_parameter import Band

__all__ = ["recoloured"]

HALVINGS = 4  # of the way from a jump that fits as well to the next, which does not


def recoloured(data: Centred, found: Bands, only: float | None, limits: Limits) -> Bands:
    """Return the stems alike, and those of another jump that are as likely with a colour of their own.

    data: with the filter of what the best leaves. only: J as a share of S, None for any; found as it is where J is not
    free, and where what is left is white.
    """
    best = found.best
    if only is not None or data.a.size == 1 or best.fit.gain == 0.0 or not best.J > 0.0:
        return found
    own = own_colour(data, limits)
    near = partial(best.stem, data.u)
    lead = Stem(near(), best.begin, best.fit, near, valve=(best.S, best.J, best.first, best.sense))
    met = list(other_jumps(own, lead))
    n = sure_samples(data, lead.x, lead.first, float(data.samples))
    least = min(one.fit.sse for one in met)

    def behind(stem: Stem) -> float:
        return n * math.log(stem.fit.sse / least) / CHI_SQUARE

    met.sort(key=_jump)
    for one, other in list(pairwise(met)):
        inside, outside = sorted((one, other), key=behind)
        for _ in range(HALVINGS if behind(inside) <= 1.0 < behind(outside) else 0):
            halfway = of_jump(own, lead, math.sqrt(_jump(inside) * _jump(outside)), inside)
            met.append(halfway)
            inside, outside = (halfway, outside) if behind(halfway) <= 1.0 else (inside, halfway)
    alike = [one for one in met if behind(one) <= 1.0 and one.fit.gain * best.fit.gain > 0.0]
    bands = [_band_of(one, best) for one in alike]
    J = [b.J for b in bands]
    return replace(
        found,
        beside=(*found.beside, *bands),
        spare_beside=(*found.spare_beside, *(math.sqrt(min(max(1.0 - behind(one), 0.0), 1.0)) for one in alike)),
        J=(min([found.J[0], *J]), max([found.J[1], *J])),
    )


def _band_of(stem: Stem, like: Band) -> Band:
    return like if stem.valve is None else Band(*stem.valve, like.slips, stem.fit)


def _jump(stem: Stem) -> float:
    return math.nan if stem.valve is None else stem.valve[1]
