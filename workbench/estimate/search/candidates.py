"""Stem paths of a one-parameter valve with their output-error fits: fitted, told apart, and fitted closer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import (
    Fit,
    Limits,
    fit_in_stretch,
    fit_near,
    fit_path,
    fit_stems,
    noise_alone,
    start_range,
)
from workbench.estimate.fits.windows import EXACT, stretch_of
from workbench.estimate.search.stems import DELAY, FIRST, HIGH, LOW, path_of, range_of
from workbench.model.record import FloatArray
from workbench.model.valve import Stenman

__all__ = ["Candidate", "again", "best_per_bin", "distinct", "fitted", "held", "leaves_noise", "polished", "refitted"]

EVALUATIONS, FURTHER = 120, 80  # of the output-error cost for each, and for one that is fitted on
CLOSER, FINEST = 2, 4  # rounds of a long record's fits near a plant: of the likely paths, of the best

LEAST_BAND = 1e-9  # % of travel: the least lower end of a range of d


@dataclass(frozen=True, eq=False)
class Candidate:
    """One stem path with its output-error fit: it holds for d in [d_low, d_high)."""

    first: int
    d_low: float
    d_high: float
    slips: int
    fit: Fit

    @property
    def d(self) -> float:
        """The middle of the range, %; its lower end where the stem slips but once, for d however large."""
        return 0.5 * (self.d_low + self.d_high) if math.isfinite(self.d_high) else self.d_low

    @property
    def valve(self) -> Stenman:
        """The valve that sticks so."""
        return Stenman(self.d)

    def stem(self, u: FloatArray, wider: float = 1.0) -> FloatArray:
        """Return the path under OP u, shape (N,), 0 before `first`; of d multiplied by a factor."""
        return path_of(u, self.d_low * wider, self.first)[0]


def fitted(
    data: Centred, rows: NDArray[np.float64], limits: Limits, like: Fit | None = None, evaluations: int = EVALUATIONS
) -> list[Candidate]:
    """Return output-error fits of rows, the best first; from `like`, or from a coarse list and the row's delay."""
    paths = rows[:, [FIRST, LOW, HIGH, DELAY]]
    if like is not None:
        paths[:, 3] = like.theta
    if like is None and data.samples > EXACT:
        fits = fit_in_stretch(data, paths, limits, stretch_of(data), evaluations)
    else:
        tau = math.nan if like is None else like.tau
        fits = fit_stems(data, paths, limits, tau=tau, evaluations=evaluations)
    found = [
        Candidate(int(row[FIRST]), float(row[LOW]), float(row[HIGH]), slips, fit)
        for row, (fit, slips) in zip(rows, fits, strict=True)
    ]
    return sorted(found, key=lambda c: c.fit.sse)


def refitted(data: Centred, found: list[Candidate], limits: Limits, most: int) -> list[Candidate]:
    """Return the candidates, best first, of which the `most` best are fitted on from their own plant."""
    likely = found[:most]
    if data.samples > EXACT:
        fits = [_nearer(data, c, limits) for c in likely]
    else:
        fits = _from_own(data, likely, limits, FURTHER)
    better = [replace(c, fit=min(c.fit, fit, key=lambda f: f.sse)) for c, fit in zip(likely, fits, strict=True)]
    return sorted([*better, *found[most:]], key=lambda c: c.fit.sse)


def _nearer(data: Centred, c: Candidate, limits: Limits) -> Fit:
    bounds = start_range(data.u, c.first, c.d_low, c.d_high)
    return fit_near(data, c.stem(data.u), c.first, bounds, limits, c.fit, CLOSER)


def again(data: Centred, found: Sequence[Candidate], limits: Limits) -> list[Candidate]:
    """Return the candidates at their own plants in another measure, unsorted."""
    return [replace(c, fit=fit) for c, fit in zip(found, _from_own(data, found, limits, 0), strict=True)]


def _from_own(data: Centred, found: Sequence[Candidate], limits: Limits, evaluations: int) -> list[Fit]:
    """Fits of the candidates, each from its own plant; evaluations: 0 for that plant itself."""
    paths = np.array([(c.first, c.d_low, c.d_high, c.fit.theta) for c in found]).reshape(-1, 4)
    taus = np.array([c.fit.tau for c in found])
    return [fit for fit, _ in fit_stems(data, paths, limits, tau=taus, evaluations=evaluations)]


def best_per_bin(by_cost: NDArray[np.float64], bins: int) -> NDArray[np.float64]:
    """Return the best row of each bin of log d; by_cost: rows, the lowest cost first."""
    low, high = by_cost[:, LOW].min(), by_cost[:, LOW].max()
    edges = np.geomspace(low, high * 1.0001, bins + 1)
    _, first = np.unique(np.digitize(by_cost[:, LOW], edges), return_index=True)
    return by_cost[first]


def leaves_noise(data: Centred, best: Candidate) -> bool:
    """Return whether a stem leaves no more of PV than white noise."""
    return noise_alone(data, best.stem(data.u), best.first, best.fit)


def distinct(fits: list[Candidate], most: int) -> list[Candidate]:
    """Return the first few of some candidates whose d differ by more than 3 %."""
    kept: list[Candidate] = []
    for c in fits:
        if all(abs(math.log(c.d_low / k.d_low)) > 0.03 for k in kept):
            kept.append(c)
        if len(kept) == most:
            break
    return kept


def held(data: Centred, c: Candidate) -> Candidate:
    """Return the candidate with all of its path's range of d, of which a walk in steps sees a part."""
    low, high = range_of(data.u, c.d_low, c.first)
    # An OP in steps may slip at each of them, down to no band at all; ranges are compared by their logarithms.
    return replace(c, d_low=max(low, LEAST_BAND), d_high=high)


def polished(data: Centred, best: Candidate, limits: Limits) -> Candidate:
    """Return the candidate with its plant fitted as closely as PV tells, also from the nearest whole dead time."""
    x, slips = path_of(data.u, best.d_low, best.first)
    bounds = start_range(data.u, best.first, best.d_low, best.d_high)
    thetas = (best.fit.theta, float(round(best.fit.theta)))
    if data.samples > EXACT:
        near = (replace(best.fit, theta=theta) for theta in thetas)
        fits = [fit_near(data, x, best.first, bounds, limits, one, FINEST) for one in near]
    else:
        fits = [
            fit_path(data, x, best.first, bounds, limits, theta, tau=best.fit.tau, evaluations=400, tolerance=1e-12)
            for theta in thetas
        ]
    return Candidate(best.first, best.d_low, best.d_high, slips, min([best.fit, *fits], key=lambda f: f.sse))
