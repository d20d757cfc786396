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

from workbench.estimate.data import Centred
from workbench.estimate.fit import Fit, Limits, predict
from workbench.estimate.output_error import solve
from workbench.model.record import FloatArray
from workbench.simulate.compiled import compiled

__all__ = ["DELAYS", "MOST_LAGS", "TAUS", "colour_beside"]

MOST_LAGS = 12  # of the autoregression
GAINS = np.geomspace(0.12, 6.0, 14)  # looked at: of the gain given,
TAUS = (0.2, 0.4, 0.7, 1.0, 1.5, 2.5, 5.0)  # of the time constant,
DELAYS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26, 30, 36, 43, 50)  # and in samples
SPREAD, SHIFT = 0.1, 0.1  # of gain and time constant, and samples as a share: where the search for the best goes on
EVALUATIONS = 150


def colour_beside(data: Centred, x: FloatArray, first: int, fit: Fit, limits: Limits, skip: int) -> FloatArray:
    """Return the filter (1, -a_1, .., -a_p) of the likeliest plant and autoregression beside a stem path x, shape (N,).

    fit: the plant as if the disturbance were white. The order is that of least AIC (H. Akaike, IEEE Trans. Autom.
    Control 19 (1974) 716-723): one that is too low leaves the plant part of the disturbance, one too high costs little.
    """
    if fit.gain == 0.0:
        return np.ones(1)
    delays = sorted({min(float(d), limits.theta[1]) for d in DELAYS} | {fit.theta})
    taus = [fit.tau] if data.integrating else [min(max(f * fit.tau, limits.tau[0]), limits.tau[1]) for f in TAUS]
    starts = [
        (_level(products, gain, MOST_LAGS, data.floor)[0], gain, tau, theta)
        for tau in taus
        for theta in delays
        for products in (_Products(data, x, first, tau, theta, skip),)
        for gain in (fit.gain * GAINS).tolist()
    ]
    _, gain, tau, theta = min(starts)

    def placed(point: FloatArray) -> tuple[_Products, float]:
        own = min(max(tau * math.exp(point[-1]), limits.tau[0]), limits.tau[1]) if not data.integrating else tau
        later = min(max(theta + point[1] / SHIFT, 0.0), limits.theta[1])
        return _Products(data, x, first, own, later, skip), gain * math.exp(point[0])

    def level(point: FloatArray, lags: int) -> float:
        products, wider = placed(point)
        return _level(products, wider, lags, data.floor)[0]

    point, lags = np.zeros(2 if data.integrating else 3), MOST_LAGS
    for _ in range(2):
        simplex = point + SPREAD * np.vstack([np.zeros(point.size), np.eye(point.size)])
        point = minimize(
            level,
            point,
            (lags,),
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-4, "fatol": 1e-3},
        ).x
        products, wider = placed(point)
        order = min(range(1, MOST_LAGS + 1), key=lambda p: _level(products, wider, p, data.floor)[0] + 2.0 * p)
        if order == lags:
            break
        lags = order
    products, wider = placed(point)
    return np.concatenate([[1.0], -_level(products, wider, lags, data.floor)[1]])


class _Products:
    """Inner products of PV, a stem's response, both at MOST_LAGS lags, and what no stem changes, for one plant."""

    def __init__(self, data: Centred, x: FloatArray, first: int, tau: float, theta: float, skip: int) -> None:
        columns = predict(data, x, first, Fit(0.0, tau, theta, 1.0, 0.0, 0.0, 0.0))[1]
        held = columns[[0, 2, 3], skip + MOST_LAGS :]
        rows = [
            signal[skip + MOST_LAGS - lag : data.samples - lag]
            for signal in (data.y, columns[1])
            for lag in range(MOST_LAGS + 1)
        ]
        # What no stem changes stays what it is when it is filtered, but for its size.
        matrix = np.vstack([np.array(rows), held[(held**2).sum(axis=1) > 0.0]])
        self.samples = matrix.shape[1]
        self.gram: FloatArray = matrix @ matrix.T


def _level(products: _Products, gain: float, lags: int, floor: float) -> tuple[float, FloatArray]:
    """N log V of what an autoregression leaves of PV less the stem's response times a gain, and its coefficients."""
    gram, scale = products.gram, products.samples
    terms = lags + gram.shape[0] - 2 * (MOST_LAGS + 1)
    room = np.empty((terms + 1, terms))
    left = colour_level(gram, MOST_LAGS + 1, gain, lags, room) / scale
    return scale * math.log(max(left, floor, 1e-300)), room[terms, :lags].copy()


@compiled
def colour_level(products: FloatArray, size: int, gain: float, lags: int, room: FloatArray) -> float:
    """Return the sum of squares that an autoregression leaves of PV less the stem's response times a gain.

    products, (2 size + h, 2 size + h): of PV at lags 0 to size - 1, of the response of gain 1 at the same, and of h
    signals that no stem changes, with each other. lags: the autoregression's order, below size. Written into the last
    row of room, (lags + h + 1, lags + h): its coefficients, then those of the h signals.
    """
    held = products.shape[0] - 2 * size
    for i in range(lags + 1):
        for j in range(max(i, 1), lags + 1):
            value = products[i, j] - gain * (products[i, size + j] + products[j, size + i])
            value += gain * gain * products[size + i, size + j]
            if i == 0:
                room[lags + held, j - 1] = value
            else:
                room[i - 1, j - 1] = value
        for j in range(held):
            value = products[i, 2 * size + j] - gain * products[size + i, 2 * size + j]
            if i == 0:
                room[lags + held, lags + j] = value
            else:
                room[i - 1, lags + j] = value
    for i in range(held):
        for j in range(i, held):
            room[lags + i, lags + j] = products[2 * size + i, 2 * size + j]
    whole = products[0, 0] - 2.0 * gain * products[0, size] + gain * gain * products[size, size]
    left: float = max(whole - solve(room, lags + held), 0.0)
    return left
