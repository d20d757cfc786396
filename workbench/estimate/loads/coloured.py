"""A plant and the colour of what disturbs it, found together beside a stem path.

In closed loop the stem answers the disturbance. A plant fitted as if that were white takes part of it for its own work,
and what it then leaves has neither the true colour nor does a fit in that colour find the true plant: alternating the
two stops far from the likeliest pair (a level under a slow load: gain and dead time off by a factor of three). Where
the disturbance's colour is free beside the plant the fit is consistent (L. Ljung, "System identification", 2nd ed.,
Prentice Hall 1999, 8.4 and 13.4).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import minimize

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, Limits, grown
from workbench.estimate.kernels.coloured import HELD, colour_left, lagged, products_of, scan_colours
from workbench.model.record import FloatArray

__all__ = ["MOST_LAGS", "TAUS", "colour_beside", "delays_about"]

MOST_LAGS = 12  # of the autoregression
SIZE = MOST_LAGS + 1
GAINS = np.geomspace(0.12, 6.0, 14)  # looked at: of the gain given,
TAUS = (0.2, 0.4, 0.7, 1.0, 1.5, 2.5, 5.0)  # of the time constant,
DELAYS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26, 30, 36, 43, 50)  # and in samples
ABOUT = (0.7, 0.85, 0.95, 1.0, 1.05, 1.15, 1.3)  # times a longer one
SPREAD, SHIFT = 0.1, 0.1  # of gain and time constant, and samples as a share: where the search for the best goes on
EVALUATIONS = 150


def colour_beside(data: Centred, x: FloatArray, first: int, fit: Fit, limits: Limits, skip: int) -> FloatArray:
    """Return the filter (1, -a_1, .., -a_p) of the likeliest plant and autoregression beside a stem path x, shape (N,).

    fit: the plant as if the disturbance were white. The order is that of least AIC (H. Akaike, IEEE Trans. Autom.
    Control 19 (1974) 716-723): one that is too low leaves the plant part of the disturbance, one too high costs little.
    """
    if fit.gain == 0.0:
        return np.ones(1)
    delays = delays_about(fit.theta, limits.theta[1])
    taus = [fit.tau] if data.integrating else [min(max(f * fit.tau, limits.tau[0]), limits.tau[1]) for f in TAUS]
    plants, gains = np.array([(tau, theta) for tau in taus for theta in delays]), fit.gain * GAINS
    left, own = np.empty((len(plants), gains.size)), np.empty((SIZE, SIZE))
    lagged(data.y, data.y, skip + MOST_LAGS, SIZE, own)
    scan_colours(data.y, own, x, first, data.integrating, plants, gains, skip, left)
    least = np.maximum(left, data.floor * (data.samples - skip - MOST_LAGS))
    i, j = divmod(int(np.argmin(least)), gains.size)
    (tau, theta), gain = plants[i].tolist(), float(gains[j])

    def placed(point: FloatArray) -> _Beside:
        slower = min(max(tau * grown(point[-1]), limits.tau[0]), limits.tau[1]) if not data.integrating else tau
        later = min(max(theta + point[1] / SHIFT, 0.0), limits.theta[1])
        return _Beside(data, own, x, first, (gain * grown(point[0]), slower, later), skip)

    def level(point: FloatArray, lags: int) -> float:
        return placed(point).level(lags)

    point, lags = np.zeros(2 if data.integrating else 3), MOST_LAGS
    for _ in range(2):
        simplex = point + SPREAD * np.vstack([np.zeros(point.size), np.eye(point.size)])
        point = minimize(
            level,
            point,
            (lags,),
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1e-2},
        ).x
        beside = placed(point)
        order = min(range(1, MOST_LAGS + 1), key=lambda p: beside.level(p) + 2.0 * p)
        if order == lags:
            break
        lags = order
    return placed(point).filter_of(lags)


def delays_about(theta: float, longest: float) -> list[float]:
    """The dead times to look at beside a fit's, samples, up to `longest`; about one that is long, others like it."""
    about = {theta} if theta <= DELAYS[-1] else {theta * share for share in ABOUT}
    return sorted({min(float(d), longest) for d in (*DELAYS, *about)})


class _Beside:
    """The autoregressions beside one plant (gain, tau, theta)."""

    def __init__(
        self,
        data: Centred,
        own: FloatArray,
        x: FloatArray,
        first: int,
        plant: tuple[float, float, float],
        skip: int,
    ) -> None:
        self.gain, tau, theta = plant
        self.samples, self.floor = data.samples - skip - MOST_LAGS, data.floor
        self.products = np.empty((2 * SIZE + HELD, 2 * SIZE + HELD))
        begin = skip + MOST_LAGS
        self.rows = products_of(data.y, own, x, first, data.integrating, tau, theta, begin, self.products)

    def level(self, lags: int) -> float:
        """N log V of what is left with some lags."""
        return self._solved(lags)[0]

    def filter_of(self, lags: int) -> FloatArray:
        """The filter (1, -a_1, .., -a_p)."""
        return np.concatenate([[1.0], -self._solved(lags)[1]])

    def _solved(self, lags: int) -> tuple[float, FloatArray]:
        terms = lags + self.rows - 2 * SIZE
        room = np.empty((terms + 1, terms))
        left = colour_left(self.products, self.rows, SIZE, self.gain, lags, room) / self.samples
        return self.samples * math.log(max(left, self.floor, 1e-300)), room[terms, :lags]
