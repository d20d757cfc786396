"""Stems that fit as well as the best where the load steps beside them may have sizes and times of their own.

Steps of the load are found beside the best stem and taken out of PV as large as suits it. A wider stem has another
gain, and would have had others: against PV less these it looks worse than it is; so does one of another jump. From the
best stem outwards S, and J, are followed here in the record with its load, the sizes free, and the times by a sample.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, Limits, grown, predict
from workbench.estimate.fits.sureness import effective_samples
from workbench.estimate.kernels.beside import left_beside
from workbench.estimate.loads.steps import SHIFT, steps_of
from workbench.estimate.search.bands import Bands
from workbench.estimate.search.profile import CHI_SQUARE
from workbench.estimate.search.two_parameter import AT_ONCE, Band, band_stem
from workbench.model.loads import LoadStep
from workbench.model.record import FloatArray

__all__ = ["Loaded", "freed"]

# Of S: steps outwards, fine at first, and how many in a row may fit worse before the rest is taken to do so too; along
# J, which moves no slips by itself, fewer.
AWAY = np.concatenate([np.arange(0.001, 0.02, 0.001), np.arange(0.02, 0.1, 0.004), np.arange(0.1, 0.31, 0.02)])
WAYS = ((AWAY, 8), (0.001 * 1.35 ** np.arange(20), 4))
SPREAD, EVALUATIONS = 0.03, 60  # of a plant's parameters, as one search for them begins


@dataclass(frozen=True, eq=False)
class Loaded:
    """A record with its load steps; times: samples at which PV may begin to answer these; skip: as in `Centred`."""

    data: Centred
    times: NDArray[np.int64]
    skip: int
    limits: Limits

    @classmethod
    def of(cls, whole: Centred, bare: Centred, steps: Sequence[LoadStep], limits: Limits) -> Loaded:
        """A record as it is with its steps, whole, from where they were taken out of it, bare."""
        at = {round(step.at / whole.sample_time) + moved for step in steps for moved in (-1, 0, 1)}
        return cls(whole, np.array(sorted(at)), bare.skip, limits)

    def left(self, plant: tuple[float, float], x: FloatArray, first: int) -> float:
        """Sum of squares that a plant, (tau, theta) in samples, leaves along a stem x, shape (N,), from `first` on."""
        data = self.data
        mean = left_beside(data.y, x, first, data.integrating, *plant, self.times, self.skip)
        return mean * (data.samples - self.skip)

    def band(self, S: float, J: float, start: tuple[int, float], near: Fit) -> Band:
        """A two-parameter stem with the plant that leaves least, sought from another."""
        x, slips = band_stem(self.data.u, S, J, *start)
        return Band(S, J, *start, slips, self.fit(x, max(start[0], 0), near))

    def fit(self, x: FloatArray, first: int, near: Fit) -> Fit:
        """The plant that leaves least along a stem path, sought from another."""
        data, skip, limits = self.data, self.skip, self.limits

        def plant(point: FloatArray) -> tuple[float, float]:
            slower, later = point.tolist()
            tau, theta = min(max(grown(slower), limits.tau[0]), limits.tau[1]), later / SHIFT
            return tau, min(max(theta, limits.theta[0]), limits.theta[1])

        def left(point: FloatArray) -> float:
            return self.left(plant(point), x, first)

        point = np.array([math.log(near.tau), near.theta * SHIFT])
        least = minimize(
            left,
            point,
            method="Nelder-Mead",
            # As many steps for each: a stem is not to look worse because its search ended sooner.
            options={
                "initial_simplex": point + SPREAD * np.vstack([np.zeros(2), np.eye(2)]),
                "maxfev": EVALUATIONS,
                "xatol": 0.0,
            },
        )
        tau, theta = plant(least.x)
        placed = replace(near, tau=tau, theta=theta)
        columns = np.array([*predict(data, x, first, placed)[1], *steps_of(data, placed, self.times.tolist())])
        terms, *_ = np.linalg.lstsq(columns[:, skip:].T, data.y[skip:], rcond=1e-10)
        bias, gain, start, transient = terms[:4].tolist()
        return Fit(float(least.fun), tau, theta, gain, bias, start, transient)


def freed(
    data: Centred, whole: Centred, found: Bands, only: float | None, limits: Limits, steps: Sequence[LoadStep]
) -> Bands:
    """Return the stems alike, and those that are as likely with load steps of their own.

    data: without its load steps; whole: with them. only: J as a share of S, None for any.
    """
    best = found.best
    # The steps stand beside no filter: where what is left is coloured they are not asked.
    if not steps or best.fit.gain == 0.0 or data.a.size > 1:
        return found
    loaded = Loaded.of(whole, data, steps, limits)
    x = best.stem(data.u)
    room = CHI_SQUARE / effective_samples(data, x, best.begin, best.fit)
    begun = loaded.band(best.S, best.J, (best.first, best.sense), best.fit)
    floor = data.floor * data.samples
    least, met = max(begun.fit.sse, floor), [begun]
    for along, way in [(along, way) for along in ((0, 1) if only is None else (0,)) for way in (1.0, -1.0)]:
        last, worse = begun, 0
        steps_away, most_worse = WAYS[along]
        for away in (way * steps_away).tolist():
            last, worse = _stepped(loaded, best, (along, away), only, last.fit), worse + 1
            if last.slips > 0 and last.fit.gain * best.fit.gain > 0.0 and last.fit.sse <= least * math.exp(room):
                least = min(least, max(last.fit.sse, floor))
                met.append(last)
                worse = 0
            if worse == most_worse:
                break
    alike = [b for b in met if b.fit.sse <= least * math.exp(room)]
    S, J = [b.S for b in alike], [b.J for b in alike]
    behind = [math.log(max(b.fit.sse, floor) / least) / room for b in alike]
    return replace(
        found,
        beside=tuple(alike),
        spare_beside=tuple(math.sqrt(max(1.0 - share, 0.0)) for share in behind),
        S=(min([found.S[0], *S]), max([found.S[1], *S])),
        J=(min([found.J[0], *J]), max([found.J[1], *J])),
    )


def _stepped(loaded: Loaded, best: Band, away: tuple[int, float], only: float | None, near: Fit) -> Band:
    """The best stem with an S (0), or J (1), that is wider by a share of S, its plant sought from another."""
    u, (along, share) = loaded.data.u, away
    apart = share * best.S
    if along == 1:
        # By itself, or with S so that slips stay where they are.
        pairs = {(best.S, max(best.J + apart, 0.0)), (max(best.S + apart, 0.5 * best.S), max(best.J + apart, 0.0))}
    elif only is not None:
        pairs = {(best.S + apart, only * (best.S + apart))}
    else:
        # As a share of S, or as slips stay where they are: on the way back, or on the way on.
        jumps = {best.J * (1.0 + share), *(max(best.J + f * apart, 0.0) for f in (-1, 1))}
        pairs = {(best.S + apart, J) for J in jumps}
    beside = {(best.first + i, best.sense) for i in (-1, 0, 1)} if best.first > 0 else {(best.first, best.sense)}
    starts = {*beside, *((int(first), float(sense)) for first, sense in AT_ONCE)}
    tried = [
        (loaded.left((near.tau, near.theta), band_stem(u, S, J, *start)[0], max(start[0], 0)), S, J, start)
        for start in starts
        for S, J in pairs
    ]
    _, S, J, start = min(tried)
    return loaded.band(S, J, start, near)
