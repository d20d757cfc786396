"""What the rounding of a recorded OP hides of a stem.

A stem that just reaches the end of its band slips or does not, and everything after it goes another way. Where OP was
rounded (a historian keeps .01 % or .1 % of it), and its controller's law does not say where it was within its steps
(`resolution`), the record may not say which, and then the right stem is not among those that the recorded OP can make:
another one wins, however well its range seems to hold it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import disturbance, predict
from workbench.estimate.fits.sureness import effective_samples
from workbench.estimate.search.candidates import Candidate
from workbench.estimate.search.profile import CHI_SQUARE
from workbench.estimate.search.stems import path_of
from workbench.estimate.search.two_parameter import Band, band_stem
from workbench.model.numbers import given
from workbench.model.record import FloatArray

__all__ = ["hidden", "words_of_hidden"]

DRAWS, SEED = 3, 0  # OPs that may have been recorded as this one was
BANDS = (0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4)  # of the best one: bands that are looked at
SHIFTS = (-2.0, 0.0, 2.0)  # of what is not known of OP: bands that each of these OPs is tried with


def hidden(data: Centred, best: Candidate | Band) -> bool:
    """Whether OP's rounding may have kept the right stem out of the search, and PV does not tell that it has not.

    Moved by what is not known of it, OP takes the stems of bands like the best one another way. Where that commonly
    changes PV by more than the 95 % likelihood region has room for, the right stem may have fitted no better than
    others that are far from it. A stem that leaves nothing of PV but white noise is right.
    """
    if not data.doubt > 0.0:
        return False
    begin, fit = max(best.first, 0), best.fit
    x = _stem(data.u, best, _band(best))
    if disturbance((data.y - predict(data, x, begin, fit)[0])[data.skip :], data.floor).size == 1:
        return False
    rng = np.random.default_rng(SEED)
    others = data.u + rng.normal(0.0, data.doubt, (DRAWS, data.samples))
    changes = []
    for band in (_band(best) * np.array(BANDS)).tolist():
        here = data.y - predict(data, _stem(data.u, best, band), begin, fit)[0]
        shifted = [max(band + shift * data.doubt, 0.0) for shift in SHIFTS]
        for u in others:
            answers = (predict(data, _stem(u, best, one), begin, fit)[0] for one in shifted)
            changes.append(min(float(np.mean(data.innovations(here + there) ** 2)) for there in answers))
    room = math.expm1(CHI_SQUARE / effective_samples(replace(data, doubt=0.0), x, begin, fit))
    return float(np.median(changes)) > room * max(fit.sse / data.samples, data.floor)


def _band(best: Candidate | Band) -> float:
    return best.d if isinstance(best, Candidate) else best.S


def _stem(u: FloatArray, best: Candidate | Band, band: float) -> FloatArray:
    """The stem under OP u, % about its middle, as the best one but for its band, %."""
    if isinstance(best, Candidate):
        return path_of(u, band, best.first)[0]
    return band_stem(u, band, best.J, best.first, best.sense)[0]


def words_of_hidden(doubt: float) -> str:
    """Return in words why no range is given; doubt: what is not known of OP, % (standard deviation)."""
    return (
        f"OP was recorded in steps, which leave it open by about {given(doubt, 2)} %, and within that the stem goes "
        "another way: the record does not say how wide the band is, nor with which gain and dead time PV answers; no "
        "ranges are given, and a record of OP with more digits would tell"
    )
