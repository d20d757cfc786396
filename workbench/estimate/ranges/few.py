"""Stems with few slips that slip some samples earlier or later, and a dead time that makes up for it.

PV shows when the plant answers, not when the stem slipped. Between reversals OP ramps, so that a wider band lets every
slip come later by nearly as many samples, and a shorter dead time hides that. Ten slips on ramps that differ tell them
apart; a few do not. On the way from one such stem to the next some slips have moved and others not, which fits worse
than either: a search in steps of S stops there.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Limits
from workbench.estimate.fits.sureness import ENOUGH_SLIPS, effective_samples
from workbench.estimate.kernels.bands import scan_starts
from workbench.estimate.kernels.path import S_HIGH, S_LOW, band_path, spans_of
from workbench.estimate.search.bands import Bands, alike_about
from workbench.estimate.search.profile import CHI_SQUARE
from workbench.estimate.search.two_parameter import Band, best_of, fit_band, jumped, started

__all__ = ["widened"]

ROUNDS = 3  # walks, from a better stem each
MOST = 400  # paths tried each way
ASIDE = 4  # samples by which every slip moves while no path fits as well: no further one is looked for
EVALUATIONS = 40  # of each fit
BESIDE = 3  # first slips before and after the present one


def widened(data: Centred, found: Bands, only: float | None, limits: Limits, rival: float = math.inf) -> Bands:
    """Return the stems alike with those of other slip times among them, where fewer than ten slips pin the best.

    The best may then be another. only: J as a share of S, None for any. rival: EU^2, the sum of squares of another
    valve's best stem, where that is the better one.
    """
    best, n = found.best, data.samples
    if best.slips >= ENOUGH_SLIPS or best.fit.gain == 0.0:
        return found
    others: list[Band] = []
    for _ in range(ROUNDS):
        x = best.stem(data.u)
        base = max(min(best.fit.sse, rival) / n, data.floor)
        most = base * math.exp(CHI_SQUARE / effective_samples(data, x, best.begin, best.fit)) * n
        others += [b for way in (-1, 1) for b in _walked(data, best, way, most, only, limits)]
        known, best = best, best_of([best, *others])
        if known.fit.sse <= max(best.fit.sse, n * data.floor):
            break
    spare = [1.0 for _ in others]
    ends = [(b.S, b.J) for b in others]
    if best is not found.best:
        # What cannot be told from the better stem lies about it; that from which it was met shows how far a search
        # may end from the best.
        about = alike_about(data, best, tuple(others), only, limits)
        best, others, spare = about.best, [*others, *about.alike], [*spare, *about.spare]
        ends += zip(about.S, about.J, strict=True)
    return replace(
        found,
        best=best,
        alike=(*found.alike, *others),
        spare=(*found.spare, *spare),
        S=(min([found.S[0], *(S for S, _ in ends)]), max([found.S[1], *(S for S, _ in ends)])),
        J=(min([found.J[0], *(J for _, J in ends)]), max([found.J[1], *(J for _, J in ends)])),
    )


def _walked(data: Centred, best: Band, way: int, most: float, only: float | None, limits: Limits) -> list[Band]:
    """The stems that leave at most so much, EU^2, path after path of a wider (+1) or narrower (-1) band."""
    met: list[Band] = []
    last, at, aside = best, best, 0
    box = np.empty(4)
    for _ in range(MOST):
        band_path(data.u, spans_of(data.u), at.S, at.J, at.first, at.sense, np.empty(data.samples), box)
        S = float(box[S_HIGH]) if way > 0 else math.nextafter(float(box[S_LOW]), 0.0)
        if not 0.0 < S < data.op_range or aside > ASIDE * best.slips:
            break
        J, start = last.J if only is None else only * S, (at.first, at.sense)
        later = _later(data, last, replace(at, S=S, J=J))
        theta = last.fit.theta - later
        if not limits.theta[0] - ASIDE <= theta <= limits.theta[1] + ASIDE:
            break
        plant = (last.fit.tau, float(np.clip(theta, *limits.theta)))
        at = _started(data, fit_band(data, S, J, start, limits, plant, EVALUATIONS), limits)
        at = at if only is not None else jumped(data, at, limits, 1, EVALUATIONS)
        aside += 1
        if at.fit.sse <= most and at.fit.gain != 0.0:
            met.append(at)
            last, aside = at, 0
    return met


def _started(data: Centred, b: Band, limits: Limits) -> Band:
    """The same stem from the start that suits it best; the first slip comes later with the others."""
    b = started(data, b, limits)
    if b.first <= 0:
        return b
    i = int(np.searchsorted(data.starts.firsts, b.first))
    near = slice(max(i - BESIDE, 1), i + BESIDE + 1)
    starts = np.column_stack([data.starts.firsts[near], data.starts.senses[near]])
    costs, plant = np.empty(len(starts)), (b.fit.tau, b.fit.theta)
    scan_starts(data.target, data.u, b.S, b.J, starts, data.sign, data.integrating, *plant, data.a, data.skip, costs)
    first, sense = starts[int(np.argmin(costs))].tolist()
    return best_of([b, fit_band(data, b.S, b.J, (int(first), sense), limits, plant, EVALUATIONS)])


def _slips(data: Centred, b: Band) -> NDArray[np.int64]:
    moves = np.diff(b.stem(data.u), prepend=0.0) != 0.0
    return np.flatnonzero(moves[1:] & ~moves[:-1]) + 1


def _later(data: Centred, one: Band, other: Band) -> float:
    """By how many samples a stem slips later than another does, the median over its slips; 0 where others are made."""
    here, there = _slips(data, one), _slips(data, other)
    return float(np.median(there - here)) if here.size == there.size and here.size else 0.0
