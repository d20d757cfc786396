"""Stems of another jump, each with the plant and the colour that it leaves.

In a cycle a larger jump makes up for a smaller gain, and in the measure of what one stem leaves another one looks worse
than it is: the filter has taken to the first. Where each has a filter of its own, the likelier shows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.drift import Drift
from workbench.estimate.fits.fit import Fit, Limits, grown
from workbench.estimate.kernels.coloured import lagged
from workbench.estimate.loads.coloured import SPREAD, Beside
from workbench.estimate.loads.drifting import Drifting
from workbench.estimate.loads.steps import Stem
from workbench.estimate.search.two_parameter import band_stem, best_start
from workbench.model.record import FloatArray

__all__ = ["OwnColour", "OwnDrift", "OwnLags", "as_it_is", "of_jump", "other_jumps", "own_akaike", "own_colour"]

EVALUATIONS = 60  # of a plant beside one stem, begun at that beside the last
RATIO, MOST = 1.2, 12  # of one jump to the next, and how many either way
FAR, WORSE = 20.0, 2  # of N log V: how many in a row may be so far behind before the rest is taken to be so too


@dataclass(frozen=True, eq=False)
class OwnDrift:
    """A record in whose measure noise upon a drift is free beside each stem; law: what it is beside the leading one."""

    drifting: Drifting
    law: Drift

    @property
    def data(self) -> Centred:
        """The record."""
        return self.drifting.data

    @property
    def begin(self) -> int:
        """The sample from which on what is left counts."""
        return self.drifting.begin

    def fit(self, x: FloatArray, first: int, near: Fit) -> Fit:
        """The plant that leaves least along a stem path, sought from another; without bias and start."""
        return self.drifting.nearer(x, first, (near.tau, near.theta), self.law)[0]

    def left(self, stem: Stem) -> float:
        """What is left of all samples, EU^2, with the plant that a stem had in the record's own measure."""
        level = self.drifting.level(stem.x, stem.first, (stem.fit.tau, stem.fit.theta), self.law)[0]
        return self.data.samples * math.exp(level / self.data.samples)


@dataclass(frozen=True, eq=False)
class OwnLags:
    """A record in whose measure the autoregression is free beside each stem; law: the lags at which its terms end."""

    data: Centred
    limits: Limits
    law: tuple[int, ...]
    moves: bool
    y: FloatArray
    own: FloatArray
    begin: int

    @classmethod
    def of(cls, data: Centred, limits: Limits, shared: tuple[int, ...]) -> OwnLags:
        """With as many terms as its filter has, at the same lags.

        A level's filter whose terms sum up to nought is one of how the disturbance changes (`INTEGRATED`).
        """
        lags = data.a.size - 1
        moves = data.integrating and abs(float(data.a.sum())) < 1e-9
        # A sum of white noise alone has no lag of its own.
        law = shared or tuple(range(1, max(lags - moves, 1) + 1))
        y = np.diff(data.y, prepend=data.y[0]) if moves else data.y
        begin = max(data.skip, law[-1] + moves)
        own = np.empty((law[-1] + 1, law[-1] + 1))
        lagged(y, y, begin, law[-1] + 1, own)
        return cls(data, limits, law, moves, y, own, begin)

    def fit(self, x: FloatArray, first: int, near: Fit) -> Fit:
        """The plant that leaves least along a stem path, sought from another; without bias and start."""
        data, limits = self.data, self.limits
        free = 2 if data.integrating else 3

        def plant(point: FloatArray) -> tuple[float, float, float]:
            by = point.tolist()
            tau = near.tau if data.integrating else min(max(near.tau * grown(by[2]), limits.tau[0]), limits.tau[1])
            return near.gain * grown(by[0]), tau, min(max(near.theta + by[1], limits.theta[0]), limits.theta[1])

        def level(point: FloatArray) -> float:
            return self._level(x, first, plant(point))

        least = minimize(
            level,
            np.zeros(free),
            method="Nelder-Mead",
            options={
                "initial_simplex": SPREAD * np.vstack([np.zeros(free), np.eye(free)]),
                "maxfev": EVALUATIONS,
                "xatol": 1e-3,
                "fatol": 1e-2,
            },
        )
        gain, tau, theta = plant(least.x)
        return Fit(self._sse(least.fun), tau, theta, gain, math.nan, math.nan, math.nan)

    def left(self, stem: Stem) -> float:
        """What is left of all samples, EU^2, with the plant that a stem had in the record's own measure."""
        return self._sse(self._level(stem.x, stem.first, (stem.fit.gain, stem.fit.tau, stem.fit.theta)))

    def _sse(self, level: float) -> float:
        """What is left of all samples, EU^2, of N log V."""
        return self.data.samples * math.exp(level / (self.data.samples - self.begin))

    def _level(self, x: FloatArray, first: int, plant: tuple[float, float, float]) -> float:
        there = Beside(self.data, self.y, self.own, x, first, plant, self.begin, self.moves)
        return there.level(self.law)


OwnColour = OwnLags | OwnDrift


def own_colour(data: Centred, limits: Limits) -> OwnColour:
    """Return a record whose disturbance is coloured, by a law as its filter's."""
    law = data.law
    if isinstance(law, Drift):
        return OwnDrift(Drifting.of(data, limits, data.skip), law)
    return OwnLags.of(data, limits, law)


def own_akaike(own: OwnColour, stem: Stem) -> float:
    """AIC of a stem with its own plant, from `fit`, as far as it depends on the stem."""
    free = 2.0 * (stem.valve is not None and stem.valve[1] > 0.0)
    return (own.data.samples - own.begin) * math.log(stem.fit.sse / own.data.samples) + free


def as_it_is(own: OwnColour, stem: Stem) -> float:
    """The same with the plant that it had in the record's own measure."""
    return own_akaike(own, replace(stem, fit=replace(stem.fit, sse=own.left(stem))))


def other_jumps(own: OwnColour, lead: Stem) -> Iterator[Stem]:
    """Yield a stem with its own plant, and those of smaller and larger jumps, until they are far behind the likeliest.

    Stenman's jumps by as much as it sticks, and has no others.
    """
    begun = replace(lead, fit=own.fit(lead.x, lead.first, lead.fit))
    yield begun
    if lead.valve is None or not lead.valve[1] > 0.0:
        return
    least = begun.fit.sse
    for ratio in (1.0 / RATIO, RATIO):
        last, worse = begun, 0
        for step in range(1, MOST + 1):
            last = of_jump(own, lead, lead.valve[1] * ratio**step, last)
            if not np.any(last.x[last.first :] != last.x[last.first]):
                break
            yield last
            least = min(least, last.fit.sse)
            worse = worse + 1 if own.data.samples * math.log(last.fit.sse / least) > FAR else 0
            if worse == WORSE:
                break


def of_jump(own: OwnColour, lead: Stem, J: float, alike: Stem) -> Stem:
    """Return a two-parameter stem of another jump, %, with its own plant, sought from that of one alike.

    It begins where that suits it best: from where the lead does, one of another jump may never slip again.
    """
    if lead.valve is None or alike.valve is None:
        return lead
    S, _, first, sense = lead.valve
    _, first, sense = best_start(own.data, (S, J), (alike.fit.tau, alike.fit.theta))
    x, begin = band_stem(own.data.u, S, J, first, sense)[0], max(first, 0)
    # What a jump gains a gain loses.
    near = replace(alike.fit, gain=alike.fit.gain * alike.valve[1] / J)
    return replace(lead, x=x, first=begin, fit=own.fit(x, begin, near), valve=(S, J, first, sense), near=None)
