"""A plant beside noise upon a load that drifts, found together along a stem path.

A sensor's noise is added to what a load does to PV, and the load reaches PV as the valve does: through the plant. An
autoregression holds such a sum with many terms alone, and what they do not hold the plant makes up for. Here it is told
as what it is: white noise, and a first-order drift that passes a pole, the plant's or one of its own (a structural
model: A. Harvey, "Forecasting, structural time series models and the Kalman filter", Cambridge University Press 1989,
chapters 2 to 4). Its likelihood is that of the errors of a Kalman filter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.drift import Drift
from workbench.estimate.fits.fit import LOUD, Fit, Limits, grown
from workbench.estimate.kernels.drifting import ROOM, drift_left
from workbench.model.record import FloatArray

__all__ = ["LONGEST", "Drifting", "drifting_bic"]

LONGEST = 30_000  # samples: a record of 86,400 took half as long again with it, and its gain was no closer
# Where the search for a law begins: the drift's pole, the noise's variance, and the pole where it is not the plant's.
DRIFTS, NOISES, POLES = (0.8, 0.95, 0.99, 0.998), (0.1, 10.0, 1e2, 1e3, 1e4, 1e5), (0.5, 0.95)
# Its first steps: of the logarithm of tau, of theta in samples, and as `Drift.moved` takes them.
SPREADS = (0.1, 0.5, 1.0, 2.0, 1.0)
EVALUATIONS, ROUNDS = 150, 2
NEAR = 60  # evaluations from a law that is known nearly


@dataclass(frozen=True, eq=False)
class Drifting:
    """A record whose disturbance is noise upon a drift, without the samples before `begin`; room: to work in."""

    data: Centred
    limits: Limits
    begin: int
    room: FloatArray

    @classmethod
    def of(cls, data: Centred, limits: Limits, skip: int) -> Drifting:
        """The record, from its first sample at the earliest, before which nothing is foretold."""
        return cls(data, limits, max(skip, 1), np.empty((ROOM, data.samples)))

    def level(self, x: FloatArray, first: int, plant: tuple[float, float], law: Drift) -> tuple[float, float]:
        """Return N log V of what the law leaves beside a stem path's response, and the gain; plant: tau, theta.

        Of a law that is tied the pole is this plant's. x: shape (N,); times in samples.
        """
        data, (tau, theta) = self.data, plant
        law = self._tied(law, tau)
        own = (law.pole, law.drift, law.noise)
        left, gain = drift_left(data.y, x, first, data.integrating, tau, theta, *own, self.begin, self.room)
        return data.samples * math.log(max(left, data.floor, 1e-300)), gain

    def likeliest(self, x: FloatArray, first: int, near: list[tuple[float, float]], *, tied: bool) -> tuple[Fit, Drift]:
        """Return the likeliest plant and law along a stem path, from plants (tau, theta) near it."""
        begins = [(plant, law) for plant in near for law in _laws(tied)]
        plant, law = min(begins, key=lambda one: self.level(x, first, *one)[0])
        for _ in range(ROUNDS):
            fit, law = self.nearer(x, first, plant, law, EVALUATIONS)
            plant = fit.tau, fit.theta
        return fit, law

    def nearer(
        self, x: FloatArray, first: int, plant: tuple[float, float], law: Drift, evaluations: int = NEAR
    ) -> tuple[Fit, Drift]:
        """Return the likeliest plant and law close to some; the fit is without bias and start."""
        (tau, theta), limits = plant, self.limits
        free = [i for i in range(len(SPREADS)) if not ((i == 0 and self.data.integrating) or (i == 4 and law.tied))]

        def moved(point: FloatArray) -> tuple[tuple[float, float], Drift]:
            by = [0.0] * len(SPREADS)
            for i, step in zip(free, point.tolist(), strict=True):
                by[i] = step
            slower = tau if self.data.integrating else min(max(tau * grown(by[0]), limits.tau[0]), limits.tau[1])
            return (slower, min(max(theta + by[1], limits.theta[0]), limits.theta[1])), law.moved(*by[2:])

        def cost(point: FloatArray) -> float:
            return self.level(x, first, *moved(point))[0]

        found = minimize(
            cost,
            np.zeros(len(free)),
            method="Nelder-Mead",
            options={
                "initial_simplex": np.vstack([np.zeros(len(free)), np.diag(np.array(SPREADS)[free])]),
                "maxfev": evaluations,
                "xatol": 1e-3,
                "fatol": 1e-2,
            },
        )
        (tau, theta), law = moved(found.x)
        level, gain = self.level(x, first, (tau, theta), law)
        sse = self.data.samples * math.exp(level / self.data.samples)
        return Fit(sse, tau, theta, gain, math.nan, math.nan, math.nan), self._tied(law, tau)

    def _tied(self, law: Drift, tau: float) -> Drift:
        if not law.tied:
            return law
        return Drift(1.0 if self.data.integrating else math.exp(-1.0 / tau), law.drift, law.noise, law.tied)


def drifting_bic(
    data: Centred, x: FloatArray, first: int, near: list[tuple[float, float]], limits: Limits, skip: int
) -> float:
    """Return the BIC of noise upon a drift that comes through the plant, as `autoregression` gives that of its terms.

    Of what is left beside a stem path x, shape (N,), and the plant that suits it best, from those near it (tau, theta);
    the first `skip` samples do not count. It is inf where less is left than the record resolves, of which no drift is
    seen, and beyond `LONGEST`.
    """
    if data.samples > LONGEST:
        return math.inf
    fit, law = Drifting.of(data, limits, skip).likeliest(x, first, near, tied=True)
    left, count = fit.sse / data.samples, data.samples - skip
    return count * math.log(left) + law.terms * math.log(count) if left > LOUD * data.floor else math.inf


def _laws(tied: bool) -> Iterator[Drift]:
    """Where the search for a law begins."""
    for pole in (math.nan,) if tied else POLES:
        for drift in DRIFTS:
            for noise in NOISES:
                yield Drift(pole, drift, noise, tied)
