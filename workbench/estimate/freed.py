"""Stems that fit as well as the best where the load steps beside them may have sizes and times of their own.

Steps of the load are found beside the best stem and taken out of PV as large as suits it. A wider stem has another
gain, and would have had others: against PV less these it looks worse than it is. From the best stem outwards S is
followed here in the record with its load, the sizes free, and the times by a sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from workbench.estimate.bands import Bands
from workbench.estimate.beside_kernel import left_beside
from workbench.estimate.data import Centred
from workbench.estimate.fit import Fit, Limits, predict
from workbench.estimate.loads import SHIFT, steps_of
from workbench.estimate.profile import CHI_SQUARE
from workbench.estimate.sureness import effective_samples
from workbench.estimate.two_parameter import AT_ONCE, Band, band_stem
from workbench.model.loads import LoadStep
from workbench.model.record import FloatArray

__all__ = ["freed"]

# Of S: steps outwards, fine at first, and how many in a row may fit worse before the rest is taken to do so too.
AWAY = np.concatenate([np.arange(0.001, 0.02, 0.001), np.arange(0.02, 0.1, 0.004), np.arange(0.1, 0.31, 0.02)])
WORSE = 8
SPREAD, EVALUATIONS = 0.03, 60  # of a plant's parameters, as one search for them begins


@dataclass(frozen=True, eq=False)
class _Loaded:
    """A record with its load steps; times: samples at which PV may begin to answer these."""

    data: Centred
    times: NDArray[np.int64]
    skip: int
    limits: Limits

    def plant(self, point: FloatArray) -> tuple[float, float]:
        """Time constant and dead time, samples, of a point of the search."""
        tau, theta = self.limits.tau, self.limits.theta
        return float(np.clip(math.exp(point[0]), *tau)), float(np.clip(point[1] / SHIFT, *theta))

    def left(self, point: FloatArray, x: FloatArray, first: int) -> float:
        """Mean square that a plant leaves along a stem path."""
        data = self.data
        return left_beside(data.y, x, first, data.integrating, *self.plant(point), self.times, self.skip)

    def least(self, point: FloatArray, x: FloatArray, first: int) -> tuple[float, FloatArray]:
        """The least of these, from a point onwards, and where."""
        done = minimize(
            self.left,
            point,
            args=(x, first),
            method="Nelder-Mead",
            options={
                "initial_simplex": point + SPREAD * np.vstack([np.zeros(2), np.eye(2)]),
                "maxfev": EVALUATIONS,
                "xatol": 0.0,
                "fatol": 1e-6 * self.left(point, x, first),
            },
        )
        return float(done.fun), done.x

    def fitted(self, band: Band, cost: float, point: FloatArray) -> Band:
        """A stem with its plant, from the place of that in the search."""
        data, first = self.data, max(band.first, 0)
        x, slips = band_stem(data.u, band.S, band.J, band.first, band.sense)
        tau, theta = self.plant(point)
        fit = replace(band.fit, tau=tau, theta=theta)
        columns = np.array([*predict(data, x, first, fit)[1], *steps_of(data, fit, self.times.tolist())])
        terms, *_ = np.linalg.lstsq(columns[:, self.skip :].T, data.y[self.skip :], rcond=1e-10)
        bias, gain, start, transient = terms[:4].tolist()
        sse = cost * (data.samples - self.skip)
        return replace(band, slips=slips, fit=Fit(sse, tau, theta, gain, bias, start, transient))


def freed(
    data: Centred, whole: Centred, found: Bands, only: float | None, limits: Limits, steps: tuple[LoadStep, ...]
) -> Bands:
    """Return the stems alike with those among them that are as likely with load steps of their own.

    data: without its load steps; whole: with them. only: J as a share of S, None for any.
    """
    best = found.best
    if not steps or best.fit.gain == 0.0:
        return found
    at = {round(step.at / data.sample_time) + moved for step in steps for moved in (-1, 0, 1)}
    loaded = _Loaded(whole, np.array(sorted(at)), data.skip, limits)
    x, _ = band_stem(data.u, best.S, best.J, best.first, best.sense)
    room = CHI_SQUARE / effective_samples(data, x, max(best.first, 0), best.fit)
    floor = data.floor
    begun = loaded.least(np.array([math.log(best.fit.tau), best.fit.theta * SHIFT]), x, max(best.first, 0))
    least, met = max(begun[0], floor), list[tuple[float, Band, FloatArray]]()
    for way in (1.0, -1.0):
        point, worse = begun[1], 0
        for away in (way * AWAY).tolist():
            cost, band, point = _stepped(loaded, best, away, only, point)
            least, worse = min(least, max(cost, floor)), worse + 1
            if cost <= least * math.exp(room):
                met.append((cost, band, point))
                worse = 0
            if worse == WORSE:
                break
    near = [one for one in met if one[0] <= least * math.exp(room)]
    alike = [(max(cost, floor), loaded.fitted(band, cost, point)) for cost, band, point in near]
    alike = [one for one in alike if one[1].fit.gain * best.fit.gain > 0.0]
    S, J = [b.S for _, b in alike], [b.J for _, b in alike]
    spare = [math.sqrt(max(1.0 - math.log(cost / least) / room, 0.0)) for cost, _ in alike]
    return replace(
        found,
        alike=(*found.alike, *(b for _, b in alike)),
        spare=(*found.spare, *spare),
        S=(min([found.S[0], *S]), max([found.S[1], *S])),
        J=(min([found.J[0], *J]), max([found.J[1], *J])),
    )


def _stepped(
    loaded: _Loaded, best: Band, away: float, only: float | None, point: FloatArray
) -> tuple[float, Band, FloatArray]:
    """The best stem with an S that is wider by a share, its cost, and its plant, sought from a point."""
    u, S = loaded.data.u, best.S * (1.0 + away)
    apart = S - best.S
    # As a share of S, or as slips stay where they are: on the way back, or on the way on.
    jumps = {only * S} if only is not None else {best.J * S / best.S, *(max(best.J + f * apart, 0.0) for f in (-1, 1))}
    tried = list[tuple[float, int, FloatArray, Band]]()
    for first, sense in ((best.first, best.sense), *((int(first), float(sense)) for first, sense in AT_ONCE)):
        for J in sorted(jumps):
            x, _ = band_stem(u, S, J, first, sense)
            tried.append(
                (loaded.left(point, x, max(first, 0)), len(tried), x, replace(best, S=S, J=J, first=first, sense=sense))
            )
    _, _, x, band = min(tried)
    cost, point = loaded.least(point, x, max(band.first, 0))
    return cost, band, point
