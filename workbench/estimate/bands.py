"""What a record tells of a two-parameter valve: the best stem, and the stems that it cannot tell from that.

The search for stems is that of `two_parameter`; here it is run over a whole record, a long one's most active windows
first, and asked how far S and J may be moved, and what parts of the record say by themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.data import Centred
from workbench.estimate.fit import LEAST_TAU, Fit, Limits, inflation, predict
from workbench.estimate.profile import CHI_SQUARE
from workbench.estimate.two_parameter import (
    REACHES,
    REFITS,
    SEEDS,
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
from workbench.estimate.windows import EXACT, active_windows
from workbench.model.record import FloatArray

__all__ = ["Bands", "Found", "Sought", "coarse_of", "refit", "repeated", "search_bands", "sought"]

OUTWARDS = (0.004, 0.5, 1.5)  # of S: the least and the largest step away from the best, each to the one before
HOPELESS = 3.0  # times what a rival leaves of a long record: a stem that leaves more is not looked at closer
WIDE_REACH = (0.03, 0.0)  # as REACHES, where J follows from S, which is a single line
# Steps of walks over all of a long record, shares of their reach, in proportion to what a look at it costs.
COARSE, STEPS = 400_000.0, (0.03, 0.2)
AGREED = 0.03, 0.1  # of S: windows of a long record whose S and J differ by less agree
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


Seek = Callable[[Centred, float], list[Band]]


@dataclass(frozen=True, eq=False)
class Window:
    """A long record's window, the best of a grid there (`look`), and all stems that a search from them meets.

    met: of J as a share of S, None for any; searched when first asked for.
    """

    data: Centred
    coarse: list[Band]
    met: Callable[[float | None], list[Band]]


@dataclass(frozen=True, eq=False)
class Sought:
    """Where stems are searched: a long record's most active windows, none in a short one; pv: whose they are, EU.

    contested: whether stems that leave far more of PV than another valve does are of no use. known: whether the grid's
    stems were not looked for, but are known to be close to the best.
    """

    pv: FloatArray
    windows: tuple[Window, ...]
    contested: bool
    known: bool

    def rival(self, other: Fit | None) -> float:
        """What another valve's fit leaves where it is a rival, EU^2; infinite where it is none."""
        return other.sse if self.contested and other is not None else math.inf


def sought(data: Centred, longest: float, other: Fit | None, contested: bool, seek: Seek = look) -> Sought:
    """Return where to search, with dead times up to `longest` samples.

    seek: `look`, or the like (`two_parameter.stems_like`). other: the fit of another valve to the record; where it
    leaves far less than any stem does in the liveliest window, or where two windows agree, the next ones are not asked.
    A window takes any disturbance as white: what it says is as good in another measure of the same PV.
    """
    none = Sought(data.y, (), contested, seek is not look)
    windows: list[Window] = []
    for part in active_windows(data) if data.samples > EXACT else ():
        window = _window(part, min(longest, part.samples / 4.0), seek)
        settled = _hopeless(window, none.rival(other) / data.samples) or any(_agree(window, one) for one in windows)
        windows.append(window)
        if settled:
            break
    return replace(none, windows=tuple(windows))


def _hopeless(window: Window, rival: float) -> bool:
    return bool(window.coarse) and all(b.fit.sse / window.data.samples > HOPELESS * rival for b in window.coarse)


def _agree(one: Window, other: Window) -> bool:
    """Whether the best stems of two windows are nearly one."""
    if not one.coarse or not other.coarse:
        return False
    a, b = one.coarse[0], other.coarse[0]
    return abs(math.log(a.S / b.S)) <= AGREED[0] and abs(a.J - b.J) <= AGREED[1] * a.S


def _window(part: Centred, longest: float, seek: Seek = look) -> Window:
    limits, coarse = Limits((LEAST_TAU, float(part.samples)), (0.0, longest)), seek(part, longest)
    known = seek is not look
    return Window(
        part, coarse, cache(lambda only: search_short(part, coarse, only, limits, (), known and only is None)[0])
    )


def coarse_of(data: Centred, within: Sought, longest: float, seek: Seek = look) -> list[Band]:
    """Return the best stems of a grid, the best first: of a long record those of its windows, fitted to the whole."""
    if data.samples <= EXACT:
        return seek(data, longest)
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
    found = [
        fit_band(data, b.S, b.J, (-1, 0.0), limits, (b.fit.tau, b.fit.theta), 20, 1e-4)
        for window in within.windows
        for b in window.coarse[:SEEDS]
    ]
    return sorted((b for b in found if b.slips > 0 and b.fit.gain != 0.0), key=lambda b: b.fit.sse)


def search_bands(
    data: Centred,
    coarse: list[Band],
    within: Sought,
    limits: Limits,
    only: float | None,
    beside: tuple[Band, ...] = (),
    rival: float = math.inf,
    before: Found | None = None,
) -> Found | None:
    """Return the best stem, or None where none moves.

    coarse: the answer of `coarse_of`. only: J as a share of S (0: a dead band). beside: stems found otherwise, from
    which a short record is searched on too. rival: what the other valve leaves, EU^2. before: what the search found in
    another measure.
    """
    if data.samples <= EXACT:
        bands, rows = search_short(data, coarse, only, limits, beside, only is None and within.known)
    else:
        bands, rows = _search_long(data, within, limits, only, rival, before)
    bands = [b for b in bands if b.fit.gain != 0.0]
    if not bands:
        return None
    best = best_of(bands)
    start = (best.first, best.sense)
    best = best_of([best, fit_band(data, best.S, best.J, start, limits, (best.fit.tau, best.fit.theta), 300)])
    return Found(best, data, (best, *bands), rows, only)


def _search_long(
    data: Centred, within: Sought, limits: Limits, only: float | None, rival: float, before: Found | None
) -> tuple[list[Band], NDArray[np.float64]]:
    """The stems met and the last walk's rows: the stems of a long record's windows, walked closer on the whole.

    Not those that leave far more of PV than another valve does.
    """
    bands: list[Band] = []
    rows, step = np.empty((0, 4)), float(np.clip(data.samples / COARSE, *STEPS))
    if before is not None:
        b = before.best
        bands.append(fit_band(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta), 40))
    for window in within.windows:
        if met := window.met(only):
            b = replace(best_of(met), first=-1, sense=0.0)
            bands.append(fit_band(data, b.S, b.J, (-1, 0.0), limits, (b.fit.tau, b.fit.theta), 40))
            # A window's plant is nearer the truth than what all of the record makes of a stem that is a little off. In
            # a measure that takes what is slow the whole is no worse a judge.
            if before is None and b.fit.sse / window.data.samples <= HOPELESS * rival / data.samples:
                reach = REACHES[0] if only is None else WIDE_REACH
                bands += closer(data, b, reach, step * reach[0], only, limits)[0]
    bands = [b for b in bands if b.slips > 0]
    for reach in REACHES if bands and best_of(bands).fit.sse <= HOPELESS * rival else ():
        found, rows = closer(data, best_of(bands), reach, step * reach[0], only, limits)
        bands += found
    return bands, rows


def refit(data: Centred, found: Found, limits: Limits) -> Found:
    """Return the same search with its best stems fitted anew from their own plants, in the measure that data has."""
    likely = sorted(found.met, key=lambda b: b.fit.sse)[:REFITS]
    bands = [fit_band(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta), 80) for b in likely]
    b = found.best
    bands.append(fit_band(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta), 200))
    return replace(found, best=best_of(bands), again=tuple(bands))


def repeated(data: Centred, found: Found, limits: Limits, within: Sought) -> Bands:
    """Return the ranges, widened to what parts of the record say that reject the best stem, each searched by itself.

    The parts are the halves, of a long record its two most active windows. What they disagree on is not known, and
    a search that ended away from the truth seldom ends there twice. A part in which the best stem is as likely as its
    own says nothing against it: it may hold too few slips to tell any stem from another.
    """
    alike, within_S, jumps = _ranges(found, limits)
    n = data.samples
    windows: Sequence[Window] = within.windows[:2]
    if n <= EXACT:
        halves = [data.part(0, n // 2), data.part(n // 2, n)]
        moved = [part for part in halves if part.op_range > 0.0 and float(np.ptp(part.y)) > 0.0]
        windows = [_window(part, min(limits.theta[1], part.samples / 4.0)) for part in moved]
    S, J, fits = [*within_S], [*jumps], []
    for window in windows:
        part, met = window.data, window.met(found.only)
        if not met or best_of(met).slips < HALF_SLIPS:
            continue
        best = best_of(met)
        own = Limits((LEAST_TAU, float(part.samples)), (0.0, min(limits.theta[1], part.samples / 4.0)))
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
