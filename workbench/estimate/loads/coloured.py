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
from workbench.estimate.fits.fit import INTEGRATED, Fit, Limits, grown
from workbench.estimate.kernels.coloured import HELD, colour_left, lagged, products_of, scan_colours
from workbench.model.record import FloatArray

__all__ = ["MOST_LAGS", "TAUS", "colour_beside", "delays_about"]

LAGS, MOST_LAGS = 12, 30  # of the autoregression: at most, and where a level sums up what disturbs it
EACH = 50  # samples, for each lag more
GAINS = np.geomspace(0.12, 6.0, 14)  # looked at: of the gain given,
TAUS = (0.2, 0.4, 0.7, 1.0, 1.5, 2.5, 5.0)  # of the time constant,
DELAYS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26, 30, 36, 43, 50)  # and in samples
ABOUT = (0.7, 0.85, 0.95, 1.0, 1.05, 1.15, 1.3)  # times a longer one
SPREAD, SHIFT = 0.1, 0.1  # of gain and time constant, and samples as a share: where the search for the best goes on
EVALUATIONS = 150


def colour_beside(
    data: Centred,
    x: FloatArray,
    first: int,
    fit: Fit,
    limits: Limits,
    skip: int,
    moves: bool = False,
    longest: int = LAGS,
) -> tuple[FloatArray, tuple[float, float]]:
    """Return the filter (1, -a_1, .., -a_p) of the likeliest plant and autoregression beside a stem path x, shape (N,).

    And that plant's tau and theta, samples: in a measure that takes what is slow they are not found from afar. fit: the
    plant as if the disturbance were white. The order is that of least AIC (H. Akaike, IEEE Trans. Autom. Control 19
    (1974) 716-723): one that is too low leaves the plant part of the disturbance, one too high costs little. moves:
    whether the autoregression is one of how the disturbance changes from sample to sample (`INTEGRATED`). longest: how
    many lags it may have in a long record.
    """
    if fit.gain == 0.0:
        return np.ones(1), (fit.tau, fit.theta)
    y = np.diff(data.y, prepend=data.y[0]) if moves else data.y
    skip += moves
    delays = delays_about(fit.theta, limits.theta[1])
    taus = [fit.tau] if data.integrating else [min(max(f * fit.tau, limits.tau[0]), limits.tau[1]) for f in TAUS]
    plants, gains = np.array([(tau, theta) for tau in taus for theta in delays]), fit.gain * GAINS
    most = min(max(data.samples // EACH, LAGS), longest)
    begin = skip + most
    left, own = np.empty((len(plants), gains.size)), np.empty((most + 1, most + 1))
    lagged(y, y, begin, most + 1, own)
    few = np.ascontiguousarray(own[: LAGS + 1, : LAGS + 1])
    scan_colours(y, few, x, first, data.integrating, plants, gains, begin, moves, left)
    least = np.maximum(left, data.floor * (data.samples - begin))
    i, j = divmod(int(np.argmin(least)), gains.size)
    (tau, theta), gain = plants[i].tolist(), float(gains[j])

    def placed(point: FloatArray, lags: int) -> _Beside:
        slower = min(max(tau * grown(point[-1]), limits.tau[0]), limits.tau[1]) if not data.integrating else tau
        later = min(max(theta + point[1] / SHIFT, 0.0), limits.theta[1])
        there = np.ascontiguousarray(own[: lags + 1, : lags + 1])
        return _Beside(data, y, there, x, first, (gain * grown(point[0]), slower, later), begin, moves)

    def level(point: FloatArray, lags: int) -> float:
        return placed(point, lags).level(lags)

    point, lags = np.zeros(2 if data.integrating else 3), LAGS
    for _ in range(2):
        simplex = point + SPREAD * np.vstack([np.zeros(point.size), np.eye(point.size)])
        point = minimize(
            level,
            point,
            (lags,),
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1e-2},
        ).x
        beside = placed(point, most)
        order = min(range(1, most + 1), key=lambda p: beside.level(p) + 2.0 * p)
        if order == lags:
            break
        lags = order
    beside = placed(point, lags)
    a = beside.filter_of(lags)
    return np.convolve(INTEGRATED, a) if moves else a, beside.times


def delays_about(theta: float, longest: float) -> list[float]:
    """The dead times to look at beside a fit's, samples, up to `longest`; about one that is long, others like it."""
    about = {theta} if theta <= DELAYS[-1] else {theta * share for share in ABOUT}
    return sorted({min(float(d), longest) for d in (*DELAYS, *about)})


class _Beside:
    """The autoregressions beside one plant (gain, tau, theta)."""

    def __init__(
        self,
        data: Centred,
        y: FloatArray,
        own: FloatArray,
        x: FloatArray,
        first: int,
        plant: tuple[float, float, float],
        begin: int,
        moves: bool,
    ) -> None:
        self.gain, tau, theta = plant
        self.times = tau, theta
        self.size = own.shape[0]
        self.samples, self.floor = data.samples - begin, data.floor
        self.products = np.empty((2 * self.size + HELD, 2 * self.size + HELD))
        self.rows = products_of(y, own, x, first, data.integrating, tau, theta, begin, moves, self.products)

    def level(self, lags: int) -> float:
        """N log V of what is left with some lags."""
        return self._solved(lags)[0]

    def filter_of(self, lags: int) -> FloatArray:
        """The filter (1, -a_1, .., -a_p)."""
        return np.concatenate([[1.0], -self._solved(lags)[1]])

    def _solved(self, lags: int) -> tuple[float, FloatArray]:
        terms = lags + self.rows - 2 * self.size
        room = np.empty((terms + 1, terms))
        left = colour_left(self.products, self.rows, self.size, self.gain, lags, room) / self.samples
        return self.samples * math.log(max(left, self.floor, 1e-300)), room[terms, :lags]
