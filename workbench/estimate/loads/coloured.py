"""A plant and the colour of what disturbs it, found together beside a stem path.

In closed loop the stem answers the disturbance. A plant fitted as if that were white takes part of it for its own work,
and what it then leaves has neither the true colour nor does a fit in that colour find the true plant: alternating the
two stops far from the likeliest pair (a level under a slow load: gain and dead time off by a factor of three). Where
the disturbance's colour is free beside the plant the fit is consistent (L. Ljung, "System identification", 2nd ed.,
Prentice Hall 1999, 8.4 and 13.4).

Noise of a sensor upon a load that drifts is remembered for long, by coefficients that fall off smoothly: means over
lags that are further and further back hold them with a few (F. Corsi, "A simple approximate long-memory model of
realized volatility", Journal of Financial Econometrics 7 (2009) 174-196).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from workbench.estimate.fits.data import Centred, Law
from workbench.estimate.fits.fit import INTEGRATED, Fit, Limits, grown
from workbench.estimate.kernels.coloured import HELD, colour_left, lagged, products_of, scan_colours
from workbench.model.record import FloatArray

__all__ = ["LAGS", "TAUS", "Beside", "Colour", "colour_beside", "delays_about"]

LAGS = 12  # of the autoregression, each with a coefficient: at most
SHARED = (1, 2, 3, 4, 6, 9, 13, 20, 30)  # where there are more: up to which those after the one before share one
EACH = 50  # samples, for each lag where there are more
GAINS = np.geomspace(0.12, 6.0, 14)  # looked at: of the gain given,
TAUS = (0.2, 0.4, 0.7, 1.0, 1.5, 2.5, 5.0)  # of the time constant,
DELAYS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26, 30, 36, 43, 50)  # and in samples
ABOUT = (0.7, 0.85, 0.95, 1.0, 1.05, 1.15, 1.3)  # times a longer one
SPREAD, SHIFT = 0.1, 0.1  # of gain and time constant, and samples as a share: where the search for the best goes on
EVALUATIONS = 150


class Colour(NamedTuple):
    """A disturbance's colour: the filter (1, -a_1, .., -a_p) that leaves it white; law: as `Centred` has it."""

    a: FloatArray
    law: Law = ()


def colour_beside(
    data: Centred,
    x: FloatArray,
    first: int,
    fit: Fit,
    limits: Limits,
    skip: int,
    moves: bool = False,
    far: bool = True,
) -> tuple[Colour, tuple[float, float]]:
    """Return the colour of the likeliest plant and autoregression beside a stem path x, shape (N,).

    And that plant's tau and theta, samples: in a measure that takes what is slow they are not found from afar. fit: the
    plant as if the disturbance were white. The lags, and which of them share a coefficient, are those of least AIC (H.
    Akaike, IEEE Trans. Autom. Control 19 (1974) 716-723): too few leave the plant part of the disturbance, some too
    many cost little. moves: whether the autoregression is one of how the disturbance changes from sample to sample
    (`INTEGRATED`). far: whether it may remember more than `LAGS` samples.
    """
    if fit.gain == 0.0:
        return Colour(np.ones(1)), (fit.tau, fit.theta)
    y = np.diff(data.y, prepend=data.y[0]) if moves else data.y
    skip += moves
    delays = delays_about(fit.theta, limits.theta[1])
    taus = [fit.tau] if data.integrating else [min(max(f * fit.tau, limits.tau[0]), limits.tau[1]) for f in TAUS]
    plants, gains = np.array([(tau, theta) for tau in taus for theta in delays]), fit.gain * GAINS
    laws = _laws(data.samples // EACH if far else LAGS)
    most = max(law[-1] for law in laws)
    begin = skip + most
    left, own = np.empty((len(plants), gains.size)), np.empty((most + 1, most + 1))
    lagged(y, y, begin, most + 1, own)
    few = np.ascontiguousarray(own[: LAGS + 1, : LAGS + 1])
    scan_colours(y, few, x, first, data.integrating, plants, gains, begin, moves, left)
    least = np.maximum(left, data.floor * (data.samples - begin))
    i, j = divmod(int(np.argmin(least)), gains.size)
    (tau, theta), gain = plants[i].tolist(), float(gains[j])

    def placed(point: FloatArray, lags: int) -> Beside:
        by = point.tolist()
        slower = min(max(tau * grown(by[-1]), limits.tau[0]), limits.tau[1]) if not data.integrating else tau
        later = min(max(theta + by[1] / SHIFT, 0.0), limits.theta[1])
        there = own if lags == most else np.ascontiguousarray(own[: lags + 1, : lags + 1])
        return Beside(data, y, there, x, first, (gain * grown(by[0]), slower, later), begin, moves)

    def level(point: FloatArray, law: tuple[int, ...]) -> float:
        return placed(point, law[-1]).level(law)

    point, law = np.zeros(2 if data.integrating else 3), tuple(range(1, LAGS + 1))
    for _ in range(2):
        simplex = point + SPREAD * np.vstack([np.zeros(point.size), np.eye(point.size)])
        point = minimize(
            level,
            point,
            (law,),
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1e-2},
        ).x
        beside = placed(point, most)
        known, law = law, min(laws, key=lambda one: beside.level(one) + 2.0 * len(one))
        if law == known:
            break
    a = beside.filter_of(law)
    shared = () if law[-1] == len(law) else law
    return Colour(np.convolve(INTEGRATED, a) if moves else a, shared), beside.times


def _laws(most: int) -> list[tuple[int, ...]]:
    """The autoregressions to choose from, by the lags at which coefficients end, none beyond `most`."""
    single = [tuple(range(1, p + 1)) for p in range(1, LAGS + 1)]
    return [*single, *(SHARED[:p] for p in range(1, len(SHARED) + 1) if LAGS < SHARED[p - 1] <= most)]


def delays_about(theta: float, longest: float) -> list[float]:
    """The dead times to look at beside a fit's, samples, up to `longest`; about one that is long, others like it."""
    about = {theta} if theta <= DELAYS[-1] else {theta * share for share in ABOUT}
    return sorted({min(float(d), longest) for d in (*DELAYS, *about)})


class Beside:
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

    def level(self, law: tuple[int, ...]) -> float:
        """N log V of what is left with an autoregression, by the lags at which its coefficients end."""
        return self._solved(law)[0]

    def filter_of(self, law: tuple[int, ...]) -> FloatArray:
        """The filter (1, -a_1, .., -a_p)."""
        return np.concatenate([[1.0], np.repeat(-self._solved(law)[1], np.diff(law, prepend=0))])

    def _solved(self, law: tuple[int, ...]) -> tuple[float, FloatArray]:
        many, held = len(law), self.rows - 2 * self.size
        terms = many + held
        room = np.empty((terms + 1, terms))
        products, rows, size = self.products, self.rows, self.size
        if many < law[-1]:
            products, rows, size = self._shared(law), 2 * (many + 1) + held, many + 1
        left = colour_left(products, rows, size, self.gain, many, room) / self.samples
        return self.samples * math.log(max(left, self.floor, 1e-300)), room[terms, :many]

    def _shared(self, law: tuple[int, ...]) -> FloatArray:
        """The products where lags share coefficients: those of their sums."""
        longest, at = law[-1] + 1, np.array([0, 1, *(1 + end for end in law[:-1])])
        kept = np.r_[0:longest, self.size : self.size + longest, 2 * self.size : self.rows]
        begin = np.r_[at, longest + at, 2 * longest : kept.size]
        rows = np.add.reduceat(self.products[np.ix_(kept, kept)], begin, axis=0)
        return np.ascontiguousarray(np.add.reduceat(rows, begin, axis=1))
