"""Dead bands that a record cannot tell from a linear loop, and the plants that go with them.

A dead band that a loop crosses now and then delays and weakens what PV shows of OP: a slower, weaker linear plant with
a longer dead time is all but the same. The ranges of a linear plant are those of a valve without any; where wider bands
fit as well, with plants of their own, the record does not tell which it is. The band is a nuisance that is profiled
out: for each the likeliest plant, and all of them within the 95 % likelihood region.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits
from workbench.estimate.fits.sureness import effective_samples, standard_errors
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.ranges.freed import Loaded
from workbench.estimate.ranges.scale import ranges_of
from workbench.estimate.search.profile import CHI_SQUARE
from workbench.estimate.search.two_parameter import NARROWEST, WIDEST, Band, band_stem, best_of, best_start, fit_band
from workbench.model.numbers import given, interval
from workbench.model.results import Intervals
from workbench.model.valve import Valve

__all__ = ["Unseen", "unseen", "words_of_likelier", "words_of_unseen"]

BANDS, BANDS_LONG = 32, 12  # looked at, as many to a tenth of the range as to a hundredth
LEAST = 0.25 * NARROWEST  # of OP's range
EVALUATIONS = 60
ACROSS = ((-1, 0.0), (0, 1.0), (0, -1.0))  # starts (first, sense), amid the band and at its ends
HALVINGS = 5  # of the step from a band that fits as well to one that does not
MATTERS = 0.05  # of the gain, beyond the linear loop's own range: less is not worth a word

# A stem (S, J) from its start, with the plant that leaves least, sought from another.
Place = Callable[[float, float, tuple[int, float], Fit], Band]


class Unseen(NamedTuple):
    """The widest dead band that a record does not exclude, %, and the ranges of the plants of all such bands.

    best: the likeliest; ahead: by how much its `N log V` is below the linear loop's.
    """

    band: float
    plant: Intervals
    best: Band
    ahead: float


def unseen(data: Centred, linear: Fit, longest: float, loaded: Loaded | None = None) -> Unseen | None:
    """Return the dead bands that fit as well as the linear loop; None where none does.

    data, linear: the record in the measure of what the linear loop leaves, and its fit there. longest: samples, the
    longest dead time searched. loaded: the record with its load steps, beside which each band has its own.
    """
    if linear.gain == 0.0:
        return None
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, max(longest, linear.theta)))
    # Of a long record its start is nothing. In a short one the stem that starts where it suits best may never cross its
    # band, where OP goes one way: those that have to are as likely, with other plants.
    starts = (None, *ACROSS) if data.samples <= WHOLE else ACROSS[:1]
    rival = linear if loaded is None else loaded.fit(data.u, 0, linear)
    place: Place = partial(_placed, data, limits) if loaded is None else loaded.band
    chains = [_followed(data, linear, start, place) for start in starts]
    met = [one for chain in chains for one in chain]
    if not met:
        return None
    n = data.samples
    base = max(min(best_of(met).fit.sse, rival.sse) / n, data.floor)
    effective = effective_samples(data, data.u, 0, linear)

    def behind(one: Band) -> float:
        return effective * math.log(max(one.fit.sse / n, base) / base) / CHI_SQUARE

    alike = [one for one in met if behind(one) <= 1.0]
    if not alike:
        return None
    for chain in chains:
        for one, other in itertools.pairwise(chain):
            if (behind(one) <= 1.0) != (behind(other) <= 1.0):
                inner, outer = (one, other) if behind(one) <= 1.0 else (other, one)
                for _ in range(HALVINGS):
                    amid = place(math.sqrt(inner.S * outer.S), 0.0, (inner.first, inner.sense), inner.fit)
                    fits = amid.slips > 0 and amid.fit.gain * linear.gain > 0.0 and behind(amid) <= 1.0
                    inner, outer = (amid, outer) if fits else (inner, amid)
                alike.append(inner)
    x, begin, fit = data.u, 0, linear
    if loaded is None:
        best = best_of(alike)
        x, begin, fit = band_stem(data.u, best.S, 0.0, best.first, best.sense)[0], best.begin, best.fit
    errors = standard_errors(data, x, begin, fit, clamped=False)
    spare = [math.sqrt(1.0 - behind(b)) for b in alike]
    ranges = ranges_of(data, [b.fit for b in alike], errors, None, limits.theta[1], spare)
    likeliest = best_of(alike)
    left = [max(fit.sse / n, data.floor) for fit in (rival, likeliest.fit)]
    return Unseen(max(b.S for b in alike), ranges, likeliest, n * math.log(left[0] / left[1]))


def _followed(data: Centred, linear: Fit, start: tuple[int, float] | None, place: Place) -> list[Band]:
    """Dead bands, narrow to wide, whose plants move on from the linear loop's; start: (first, sense), or the best."""
    met: list[Band] = []
    fit = linear
    for S in (np.geomspace(LEAST, WIDEST, BANDS if data.samples <= WHOLE else BANDS_LONG) * data.op_range).tolist():
        given = best_start(data, (S, 0.0), (fit.tau, fit.theta))[1:] if start is None else start
        one = place(S, 0.0, given, fit)
        if one.slips > 0 and one.fit.gain * linear.gain > 0.0:
            met.append(one)
            fit = one.fit
    return met


def _placed(data: Centred, limits: Limits, S: float, J: float, start: tuple[int, float], near: Fit) -> Band:
    return fit_band(data, S, J, start, limits, (near.tau, near.theta), EVALUATIONS, 1e-6)


def words_of_unseen(found: Unseen, own: Intervals, integrating: bool) -> tuple[str, ...]:
    """Return in words which dead bands a record does not exclude, where their plants widen the linear one's ranges."""
    gains = found.plant.gain, own.gain
    if gains[0] is None or gains[1] is None:
        return ()
    both = min(gains[0][0], gains[1][0]), max(gains[0][1], gains[1][1])
    if not both[1] - both[0] > gains[1][1] - gains[1][0] + MATTERS * min(abs(end) for end in gains[1]):
        return ()
    gain = interval(both, "EU/(% s)" if integrating else "EU/%", 3)
    return (
        f"dead bands of up to {given(found.band, 3)} % fit as well: the ranges hold their plants too, a gain of {gain}",
    )


def words_of_likelier(valve: Valve, ratio: float) -> str:
    """Return in words that a valve is likelier than none, by a log likelihood ratio."""
    return (
        f"a stem that sticks over {given(valve.stick_band, 3)} % explains PV better than OP itself does, by the fitted "
        f"models alone (log likelihood ratio {ratio:.0f}): a setpoint move, a longer record or the measured stem would "
        "tell"
    )
