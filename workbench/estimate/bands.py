"""What a record tells of a two-parameter valve: the best stem, and the stems that it cannot tell from that.

The search for stems is that of `two_parameter`; here it is run over a whole record, a long one's most active stretch
first, and asked how far S and J may be moved, and what parts of the record say by themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.data import Centred
from workbench.estimate.fit import LEAST_TAU, Fit, Limits, inflation, predict
from workbench.estimate.profile import CHI_SQUARE, EXACT, active_windows
from workbench.estimate.two_parameter import (
    REACHES,
    REFITS,
    Band,
    band_stem,
    best_of,
    closer,
    fit_band,
    look,
    search_short,
    start_costs,
    started,
)

__all__ = ["Bands", "Found", "Sought", "refit", "repeated", "search_bands", "sought"]

OUTWARDS = (0.004, 0.5, 1.5)  # of S: the least and the largest step away from the best, each to the one before
HALF_SLIPS = 5  # in each half of a record, for the halves to be compared


@dataclass(frozen=True, eq=False)
class Found:
    """The best stem, all that were met on the way with their fits in the record's measure then, and rows of walks.

    rows: (S, J, COST, SLIPS); only: J as a share of S, None for any; again: the best few, fitted anew since.
    """

    best: Band
    measure: Centred
    met: tuple[Band, ...]
    rows: NDArray[np.float64]
    only: float | None
    again: tuple[Band, ...] = ()


@dataclass(frozen=True, eq=False)
class Bands:
    """The best stem, those that the record cannot tell from it, and their ranges of S and J, %.

    parts: the fits that parts of the record have by themselves (see `repeated`).
    """

    best: Band
    alike: tuple[Band, ...]
    S: tuple[float, float]
    J: tuple[float, float]
    parts: tuple[Fit, ...]


@dataclass(frozen=True, eq=False)
class Sought:
    """Where stems are searched: a record, a long one's most active stretch, and the best of a grid there (`look`).

    known: whether these were not looked for, but are known to be close to the best.
    """

    data: Centred
    coarse: list[Band]
    known: bool


def sought(
    data: Centred, coarse: list[Band], limits: Limits, seek: Callable[[Centred, float], list[Band]] = look
) -> Sought:
    """Return where to search; coarse: the answer of `seek`, `look` or the like, for the whole record."""
    known = seek is not look
    if data.samples <= EXACT:
        return Sought(data, coarse, known)
    parts = active_windows(data)[:1]
    return Sought(parts[0], seek(parts[0], limits.theta[1]), known) if parts else Sought(data, [], known)


def search_bands(
    data: Centred, within: Sought, limits: Limits, only: float | None, beside: tuple[Band, ...] = ()
) -> Found | None:
    """Return the best stem, or None where none moves.

    The stem of a long record's stretch is walked closer on the whole. only: J as a share of S (0: a dead band). beside:
    stems found otherwise, from which a short record is searched on too.
    """
    rows = np.empty((0, 4))
    if within.data is data:
        known = only is None and within.known
        bands, rows = search_short(data, within.coarse, only, limits, beside, known)
    else:
        bands = []
        if found := search_short(within.data, within.coarse, only, limits)[0]:
            best = best_of(found)
            bands.append(fit_band(data, best.S, best.J, (-1, 0.0), limits, (best.fit.tau, best.fit.theta), 40))
        bands = [b for b in bands if b.slips > 0]
        if bands:
            best = best_of(bands)
            for reach in REACHES:
                found, rows = closer(data, best, reach, 0.2 * reach[0], only, limits)
                bands += found
                best = best_of([best, *found])
    bands = [b for b in bands if b.fit.gain != 0.0]
    if not bands:
        return None
    best = best_of(bands)
    start = (best.first, best.sense)
    best = best_of([best, fit_band(data, best.S, best.J, start, limits, (best.fit.tau, best.fit.theta), 300)])
    return Found(best, data, (best, *bands), rows, only)


def refit(data: Centred, found: Found, limits: Limits) -> Found:
    """Return the same search with its best stems fitted anew from their own plants, in the measure that data has."""
    likely = sorted(found.met, key=lambda b: b.fit.sse)[:REFITS]
    bands = [fit_band(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta), 80) for b in likely]
    b = found.best
    bands.append(fit_band(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta), 200))
    return replace(found, best=best_of(bands), again=tuple(bands))


def repeated(data: Centred, found: Found, limits: Limits) -> Bands:
    """Return the ranges, widened to what parts of the record say that reject the best stem, each searched by itself.

    The parts are the halves, of a long record its two most active stretches. What they disagree on is not known, and
    a search that ended away from the truth seldom ends there twice. A part in which the best stem is as likely as its
    own says nothing against it: it may hold too few slips to tell any stem from another.
    """
    alike, within, jumps = _ranges(found, limits)
    n = data.samples
    parts = [data.part(0, n // 2), data.part(n // 2, n)] if n <= EXACT else active_windows(data)[:2]
    S, J, fits = [*within], [*jumps], []
    for part in parts:
        if not part.op_range > 0.0 or not float(np.ptp(part.y)) > 0.0:
            continue
        longest = min(limits.theta[1], part.samples / 4.0)
        own = Limits((LEAST_TAU, float(part.samples)), (0.0, longest))
        met, _ = search_short(part, look(part, longest), found.only, own)
        if not met or best_of(met).slips < HALF_SLIPS:
            continue
        best = best_of(met)
        if _rejects(part, best, _here(part, found.best, own)):
            S.append(best.S)
            J.append(best.J)
            fits.append(best.fit)
    return Bands(found.best, found.again or alike, (min(S), max(S)), (min(J), max(J)), tuple(fits))


def _here(part: Centred, b: Band, limits: Limits) -> Band:
    """The same stem on a part of the record, from the start that suits it there and with a plant of its own."""
    theta = min(b.fit.theta, limits.theta[1])
    start = start_costs(part, (b.S, b.J), (b.fit.tau, theta))[0][1:]
    return fit_band(part, b.S, b.J, start, limits, (b.fit.tau, theta), 120)


def _rejects(part: Centred, own: Band, other: Band) -> bool:
    """Whether a part's own best stem is significantly likelier there than another."""
    ratio = max(other.fit.sse / part.samples, part.floor) / max(own.fit.sse / part.samples, part.floor)
    return _effective(part, own) * math.log(ratio) > CHI_SQUARE


def _effective(data: Centred, b: Band) -> float:
    """The number of independent samples that what a stem leaves is worth."""
    x, _ = band_stem(data.u, b.S, b.J, b.first, b.sense)
    return data.samples / inflation(data.innovations(predict(data, x, max(b.first, 0), b.fit)[0]))


def _ranges(found: Found, limits: Limits) -> tuple[tuple[Band, ...], tuple[float, float], tuple[float, float]]:
    """What the record cannot tell from the best: the 95 % likelihood region, and what each half would choose.

    As it was measured when the search was made: the stems, and their ranges of S and J.
    """
    data, best = found.measure, best_of(list(found.met))
    n = data.samples
    most = max(best.fit.sse / n, data.floor) * math.exp(CHI_SQUARE / _effective(data, best)) * n
    alike = [best, *(b for b in found.met if max(b.fit.sse, n * data.floor) <= most)]
    if best.slips >= 2 * HALF_SLIPS:
        alike += _halves(data, sorted(found.met, key=lambda b: b.fit.sse)[:60])
    alike += _outwards(data, best, most, found.only, limits)
    near = found.rows[np.maximum(found.rows[:, 2], n * data.floor) <= most]
    if near.size:
        # Gain and jump make up for each other: the plant may be what it is with the outermost of these stems.
        ends = {tuple(near[end(near[:, i]), :2].tolist()) for i in (0, 1) for end in (np.argmin, np.argmax)}
        start, plant = (best.first, best.sense), (best.fit.tau, best.fit.theta)
        fits = [fit_band(data, S, J, start, limits, plant, 40) for S, J in sorted(ends)]
        alike += [b for b in fits if b.fit.gain != 0.0]
    S = [b.S for b in alike] + near[:, 0].tolist()
    J = [b.J for b in alike] + near[:, 1].tolist()
    return tuple(alike), (min(S), max(S)), (min(J), max(J))


def _outwards(data: Centred, best: Band, most: float, only: float | None, limits: Limits) -> list[Band]:
    """The stems met in steps of S away from the best, each way until the record tells them apart."""
    met, plant, start = [], (best.fit.tau, best.fit.theta), (best.first, best.sense)
    for way in (-1.0, 1.0):
        step = OUTWARDS[0]
        while step <= OUTWARDS[1]:
            S = best.S * (1.0 + way * step)
            jumps = {max(best.J + f * step * S, 0.0) for f in (-1.0, 0.0, 1.0)} if only is None else {only * S}
            there = started(data, best_of([fit_band(data, S, J, start, limits, plant, 24) for J in jumps]), limits)
            if there.fit.gain == 0.0 or max(there.fit.sse, data.samples * data.floor) > most:
                break
            met.append(there)
            step *= OUTWARDS[2]
    return met


def _halves(data: Centred, bands: list[Band]) -> list[Band]:
    """The stems that each half of the record would choose by itself among the likely ones."""
    half = data.samples // 2
    costs = np.empty((len(bands), 2))
    for i, b in enumerate(bands):
        x, _ = band_stem(data.u, b.S, b.J, b.first, b.sense)
        squares = data.innovations(predict(data, x, max(b.first, 0), b.fit)[0]) ** 2
        costs[i] = squares[:half].sum(), squares[half:].sum()
    costs = np.maximum(costs, half * data.floor)
    return [bands[int(i)] for i in np.argmin(costs, axis=0)]
