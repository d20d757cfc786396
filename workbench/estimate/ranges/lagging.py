"""A valve whose positioner lags behind, or a process with a second lag: what these leave open of the plant.

A first-order plant makes up for a short second lag with dead time and time constant, and hardly leaves more of PV, yet
its gain in a plain cycle is another: of loops with a positioner of 0.5 to 3 samples the gain's range missed it in most.
"""

from __future__ import annotations

import math

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, fit_path
from workbench.estimate.fits.sureness import effective_samples, standard_errors
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.loads.steps import CLEAR
from workbench.estimate.ranges.scale import ranges_of
from workbench.estimate.search.paths import Path
from workbench.estimate.search.profile import CHI_SQUARE
from workbench.model.numbers import given
from workbench.model.record import FloatArray
from workbench.model.results import Intervals
from workbench.simulate.filter import first_order

__all__ = ["lagging"]

LAGS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 10.0, 15.0)  # samples
FURTHEST = 30.0  # samples of dead time, or twice that found


def lagging(data: Centred, path: Path) -> tuple[Intervals, tuple[str, ...]]:
    """Return the plant's ranges with a stem that lags behind, and in words that one clearly does, if so.

    data: the record as it was fitted, beside its loads; path: the model's stem with its plant. Empty where no lag does
    as well, and of records beyond 10,000 samples.
    """
    n, fit = data.samples, path.fit
    if n > WHOLE or fit.gain == 0.0:
        return Intervals(), ()
    limits = Limits((LEAST_TAU, float(n)), (0.0, max(2.0 * fit.theta, FURTHEST)))
    room = math.exp(CHI_SQUARE / effective_samples(data, path.x, path.first, fit))
    least = own = max(fit.sse, n * data.floor)
    found: list[tuple[float, Fit]] = []
    near, before = fit, 0.0
    for lag in LAGS:
        near = _fitted(data, path, lag, limits, near, lag - before)
        left, before = max(near.sse, n * data.floor), lag
        if left > least * room or near.gain * fit.gain <= 0.0:
            break
        least = min(least, left)
        found.append((lag, near))
    if not found:
        return Intervals(), ()
    at = min(range(len(found)), key=lambda i: found[i][1].sse)
    # The likeliest lag may be between two of those that were tried.
    alike = [one for i, one in enumerate(found) if abs(i - at) <= 1 or max(one[1].sse, n * data.floor) <= least * room]
    lag, best = found[at]
    errors = standard_errors(data, _lagged(path, lag), path.first, best, clamped=False)
    ranges = ranges_of(data, [one for _, one in alike], errors, None, limits.theta[1])
    if not n * math.log(own / least) > CLEAR:
        return ranges, ()
    said = (
        f"the stem, or the process, has a second lag of about {given(lag * data.sample_time, 2)} s, for which time "
        "constant and dead time make up: the plant's ranges hold it"
    )
    return ranges, (said,)


def _fitted(data: Centred, path: Path, lag: float, limits: Limits, near: Fit, more: float) -> Fit:
    """The fit along a stem that lags behind; more: by how many samples more than that of a fit near by."""
    x, free = _lagged(path, lag), (-math.inf, math.inf)
    thetas = {near.theta, max(near.theta - more, 0.0)}
    fits = (fit_path(data, x, path.first, free, limits, theta, tau=near.tau) for theta in sorted(thetas))
    return min(fits, key=lambda fit: fit.sse)


def _lagged(path: Path, lag: float) -> FloatArray:
    """A stem that lags behind, %, shape (N,); its first slip ends a rest that nobody saw begin."""
    x, pole, first = np.zeros_like(path.x), math.exp(-1.0 / lag), path.first
    x[first:] = first_order(path.x[first:], 1.0 - pole, 0.0, pole, pole * path.x[first])
    return x
