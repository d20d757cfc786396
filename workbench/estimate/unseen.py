"""Dead bands that a record cannot tell from a linear loop, and the plants that go with them.

A dead band that a loop crosses now and then delays and weakens what PV shows of OP: a slower, weaker linear plant with
a longer dead time is all but the same. The ranges of a linear plant are those of a valve without any; where wider bands
fit as well, with plants of their own, the record does not tell which it is. The band is a nuisance that is profiled
out: for each the likeliest plant, and all of them within the 95 % likelihood region.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from workbench.estimate.data import Centred
from workbench.estimate.fit import LEAST_TAU, Fit, Limits
from workbench.estimate.profile import CHI_SQUARE
from workbench.estimate.scale import ranges_of
from workbench.estimate.sureness import effective_samples, standard_errors
from workbench.estimate.two_parameter import NARROWEST, WIDEST, Band, band_stem, best_of, best_start, fit_band
from workbench.estimate.windows import WHOLE
from workbench.model.numbers import interval
from workbench.model.results import Intervals

__all__ = ["Unseen", "unseen", "words_of_unseen"]

BANDS, BANDS_LONG = 32, 12  # looked at, as many to a tenth of the range as to a hundredth
LEAST = 0.25 * NARROWEST  # of OP's range
EVALUATIONS = 60
MATTERS = 0.05  # of the gain, beyond the linear loop's own range: less is not worth a word


class Unseen(NamedTuple):
    """The widest dead band that a record does not exclude, %, and the ranges of the plants of all such bands."""

    band: float
    plant: Intervals


def unseen(data: Centred, linear: Fit, longest: float) -> Unseen | None:
    """Return the dead bands that fit as well as the linear loop; None where none does.

    data, linear: the record in the measure of what the linear loop leaves, and its fit there. longest: samples, the
    longest dead time searched.
    """
    if linear.gain == 0.0:
        return None
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, max(longest, linear.theta)))
    short, met = data.samples <= WHOLE, list[Band]()
    plant = (linear.tau, linear.theta)
    for S in np.geomspace(LEAST, WIDEST, BANDS if short else BANDS_LONG) * data.op_range:
        # Of a long record its start is nothing; the plant moves on with the band.
        start = best_start(data, (S, 0.0), plant)[1:] if short else (-1, 0.0)
        one = fit_band(data, float(S), 0.0, start, limits, plant, EVALUATIONS, 1e-6)
        if one.slips > 0 and one.fit.gain * linear.gain > 0.0:
            met.append(one)
            plant = (one.fit.tau, one.fit.theta)
    if not met:
        return None
    n, best = data.samples, best_of(met)
    base = max(min(best.fit.sse, linear.sse) / n, data.floor)
    effective = effective_samples(data, data.u, 0, linear)
    behind = {id(b): effective * math.log(max(b.fit.sse / n, base) / base) / CHI_SQUARE for b in met}
    alike = [b for b in met if behind[id(b)] <= 1.0]
    if not alike:
        return None
    best = best_of(alike)
    x, begin = band_stem(data.u, best.S, 0.0, best.first, best.sense)[0], max(best.first, 0)
    errors = standard_errors(data, x, begin, best.fit, clamped=False)
    spare = [math.sqrt(1.0 - behind[id(b)]) for b in alike]
    ranges = ranges_of(data, [b.fit for b in alike], errors, None, limits.theta[1], spare)
    return Unseen(max(b.S for b in alike), ranges)


def words_of_unseen(found: Unseen, own: Intervals, integrating: bool) -> tuple[str, ...]:
    """Return in words which dead bands a record does not exclude, where their plants widen the linear one's ranges."""
    gains = found.plant.gain, own.gain
    if gains[0] is None or gains[1] is None:
        return ()
    both = min(gains[0][0], gains[1][0]), max(gains[0][1], gains[1][1])
    if not both[1] - both[0] > gains[1][1] - gains[1][0] + MATTERS * min(abs(end) for end in gains[1]):
        return ()
    gain = interval(both, "EU/(% s)" if integrating else "EU/%", 3)
    return (f"dead bands of up to {found.band:.3g} % fit as well: the ranges hold their plants too, a gain of {gain}",)
