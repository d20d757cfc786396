"""What a record tells of a two-parameter valve: the best stem, and the stems that it cannot tell from that.

The search for stems is that of `two_parameter` and `nearer`; here it is run over a whole record, a long one's most
active windows first, and asked how far S and J may be moved, and what parts of the record say by themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, noise_alone, predict
from workbench.estimate.fits.sureness import ENOUGH_SLIPS, effective_samples
from workbench.estimate.kernels.path import J_HIGH, J_LOW, S_HIGH, S_LOW, band_path, spans_of
from workbench.estimate.search.kinks import about_kinks
from workbench.estimate.search.nearer import (
    CROSSINGS,
    REACHES,
    REACHES_LONG,
    REFITS,
    SPREADS,
    closer,
    nearer,
    search_short,
)
from workbench.estimate.search.outwards import outwards
from workbench.estimate.search.profile import CHI_SQUARE, HALF_SLIPS
from workbench.estimate.search.sought import HOPELESS, Sought, Window, on_all, window_of
from workbench.estimate.search.two_parameter import (
    MOST_STARTS,
    NARROWEST,
    WIDEST,
    Band,
    best_of,
    best_start,
    fit_band,
    jumped,
    look,
    started,
    started_beside,
)

__all__ = [
    "Bands",
    "Found",
    "alike",
    "alike_about",
    "further",
    "noise_beside",
    "refit",
    "repeated",
    "search_bands",
]

OUTWARDS = (0.004, 6.0, 1.5)  # of S: the least and the largest step away from the best, each to the one before
CLOSELY, MOST_STEPS = 0.15, 25  # of such a step: how closely it is known where the record tells; and how many at most
APART = 0.01  # of S: where a part's own stem is as far from the whole's, the search goes on from it
BEFORE = 4  # samples before a slip over which OP's rate is taken
# Samples by which stems beside the best slip later, of which those with many slips need the first few.
LATER, LATER_MANY = (-2, -1, 1, 2, -3, 3, -5, 5, -8, 8, -12, 12, -18, 18, -27, 27), 4
JUMPS = (0.5, 0.7, 1.4, 2.0)  # times the best stem's: where slips are few, gain makes up for them
SIDEWAYS = (0.01, 0.0)  # of S: how far S follows a step of J
SLACK = 6.0  # in N log V: what another measure of the same record may make of a stem
LIKELIEST = 24  # stems fitted again in it, beside the outermost
THINNED = 4  # stems of a long record thinned from which it is searched
WIDE_REACH = (0.03, 0.0)  # as REACHES, where J follows from S, which is a single line
# Steps of walks over all of a long record, shares of their reach, in proportion to what a look at it costs.
COARSE, STEPS = 400_000.0, (0.03, 0.2)


@dataclass(frozen=True, eq=False)
class Found:
    """The best stem, all that were met on the way with their fits in the record's measure then, and rows of walks.

    rows: (S, J, COST, SLIPS), in the measure of walked; only: J as a share of S, None for any; again:
    the best few fitted anew in another measure, and what was met later.
    """

    best: Band
    measure: Centred
    met: tuple[Band, ...]
    rows: NDArray[np.float64]
    walked: Centred
    only: float | None
    again: tuple[Band, ...] = ()


@dataclass(frozen=True, eq=False)
class Bands:
    """The best stem, those that the record cannot tell from it, and their ranges of S and J, %.

    spare: of each of those, the share of a 95 % range's half that its cost leaves it within the likelihood region.
    parts: the fits that parts of the record have by themselves (see `repeated`). beside: those alike with load steps or
    a colour of their own (see `freed`, `recoloured`), of which only gain, tau and theta need be known; spare_beside:
    their spare.
    """

    best: Band
    alike: tuple[Band, ...]
    spare: tuple[float, ...]
    S: tuple[float, float]
    J: tuple[float, float]
    parts: tuple[Fit, ...] = ()
    beside: tuple[Band, ...] = ()
    spare_beside: tuple[float, ...] = ()


def search_bands(
    data: Centred,
    coarse: list[Band],
    within: Sought,
    limits: Limits,
    only: float | None,
    beside: tuple[Band, ...] = (),
    rival: float = math.inf,
    before: Found | None = None,
    near: bool = False,
) -> Found | None:
    """Return the best stem, or None where none moves.

    coarse: the answer of `coarse_of`. only: J as a share of S (0: a dead band). beside: stems found otherwise, from
    which a short record is searched on too. rival: what another valve leaves, EU^2. before: what the search found in
    another measure. near: as in `search_short`.
    """
    if within.whole:
        most = HOPELESS * max(rival, data.samples * data.floor)
        likely = tuple(b for b in beside if b.fit.sse <= most)
        bands, rows = search_short(data, coarse, only, limits, likely, only is None and within.known, most, near)
        # No jump at all is one of any.
        bands += beside
    else:
        bands, rows = _search_long(data, within, limits, only, rival, before)
    bands = [b for b in bands if b.fit.gain != 0.0 and _travels(data, b)]
    if not bands:
        return None
    best = best_of(started_beside(data, best_of(bands), limits))
    start = (best.first, best.sense)
    best = best_of([best, fit_band(data, best.S, best.J, start, limits, (best.fit.tau, best.fit.theta), 300)])
    best = best if only is not None or within.known else jumped(data, best, limits)
    return Found(best, data, (best, *bands), rows, data, only)


def _travels(data: Centred, b: Band) -> bool:
    """Whether a stem moves by as much as the widest band that is searched leaves of OP's range."""
    return bool(np.ptp(b.stem(data.u)[b.begin :]) >= (1.0 - WIDEST) * data.op_range)


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
            b = best_of(met)
            if before is None and not within.known and _leads(window, b, only):
                span = window.begin, window.begin + window.data.samples
                followed, right = outwards(data, span, b, only, limits)
                bands += followed
                if right:
                    break
            bands.append(on_all(data, (b.S, b.J, b.fit.tau, b.fit.theta), limits))
            b = replace(b, first=bands[-1].first, sense=bands[-1].sense)
            # A window's plant is nearer the truth than what all of the record makes of a stem that is a little off. In
            # a measure that takes what is slow the whole is no worse a judge.
            if before is None and b.fit.sse / window.data.samples <= HOPELESS * rival / data.samples:
                reach = REACHES[0] if only is None else WIDE_REACH
                bands += closer(data, b, reach, step * reach[0], only, limits)[0]
    if before is None and only is None:
        alone = bool(bands) and noise_beside(data, best_of(bands))
        if not (within.known or alone):
            bands += about_kinks(data, limits)
        bands += _thinned(data, within, min([rival, *(b.fit.sse for b in bands)]), limits)
    bands = [b for b in bands if b.slips > 0 and b.fit.gain != 0.0]
    if not bands:
        return bands, rows
    # A start that suits a stem on the way may be one slip off for the one it leads to: dearer than any S and J.
    bands.append(started(data, best_of(bands), limits, MOST_STARTS))
    for reach in REACHES_LONG if best_of(bands).fit.sse <= HOPELESS * rival else ():
        found, rows = closer(data, best_of(bands), reach, step * reach[0], only, limits)
        bands += found
    bands.append(started(data, best_of(bands), limits, MOST_STARTS))
    return bands, rows


def _thinned(data: Centred, within: Sought, least: float, limits: Limits) -> list[Band]:
    """The stems met from the best few of a long record thinned that are likely; least: EU^2, what others leave.

    Where each window shows a few slips, what all of the record shows is nearer the truth; else it is far off.
    """
    placed = sorted((on_all(data, seed, limits) for seed in within.thinned), key=lambda b: b.fit.sse)
    bands: list[Band] = []
    ends: list[Band] = []
    for seed in placed[:THINNED]:
        if seed.fit.sse < HOPELESS * least:
            way = nearer(data, seed, SPREADS, None, limits, ends)
            bands, ends = [*bands, *way], [*ends, best_of(way)]
    return bands


def _leads(window: Window, b: Band, only: float | None) -> bool:
    """Whether a window's best stem is worth following: not one whose jump is given where any jump leaves far less."""
    if b.slips == 0 or b.fit.gain == 0.0:
        return False
    least = math.inf if only is None else min((one.fit.sse for one in window.met(None)), default=math.inf)
    return b.fit.sse <= HOPELESS * max(least, window.data.samples * window.data.floor)


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
    a search that ended away from the truth seldom ends there twice: a short record is searched on from where its halves
    ended, and from the stems that slip some samples earlier and later, and the best may then be another.
    """
    own = _of_parts(data, found, limits, within)
    if within.whole:
        apart = [b for *_, b in own if abs(b.S / found.best.S - 1.0) > APART]
        found = further(data, found, [_here(data, b, limits) for b in apart], limits)
        for _ in range(CROSSINGS):
            known, found = found.best, further(data, found, _beside(data, found.best, found.only, limits), limits)
            # A best that moved by no whole sample has the same stems beside it.
            if abs(found.best.S / known.S - 1.0) <= APART:
                break
    # A part in which the best stem is as likely as its own may hold too few slips to tell any stem from another.
    against = [
        b for part, there, b in own if b.slips >= HALF_SLIPS and _rejects(part, b, _here(part, found.best, there))
    ]
    bands = alike(data, found, limits)
    S, J = (*bands.S, *(b.S for b in against)), (*bands.J, *(b.J for b in against))
    return replace(bands, S=(min(S), max(S)), J=(min(J), max(J)), parts=tuple(b.fit for b in against))


def _of_parts(data: Centred, whole: Found, limits: Limits, within: Sought) -> list[tuple[Centred, Limits, Band]]:
    """The parts of a record, each with the best stem of a search of its own, where one is found.

    whole: the search in all of it. Where that leaves noise alone, the halves' stems are sought from its best.
    """
    n, best = data.samples, whole.best
    windows: Sequence[Window] = within.windows[:2]
    if within.whole:
        halves = [data.part(0, n // 2), data.part(n // 2, n)]
        moved = [part for part in halves if part.moves]
        seek = partial(_known, best) if best.slips >= ENOUGH_SLIPS and noise_beside(data, best) else look
        windows = [window_of(part, min(limits.theta[1], part.samples / 4.0), seek) for part in moved]
    found = []
    for window in windows:
        part, met = window.data, window.met(whole.only)
        if met and best_of(met).slips > 0:
            own = Limits((LEAST_TAU, float(part.samples)), (0.0, min(limits.theta[1], part.samples / 4.0)))
            found.append((part, own, best_of(met)))
    return found


def _known(best: Band, part: Centred, longest: float) -> list[Band]:
    """A record's best stem in a part of it, with dead times up to `longest` samples; none where it does not move."""
    there = _here(part, best, Limits((LEAST_TAU, float(part.samples)), (0.0, longest)))
    return [there] if there.slips > 0 and there.fit.gain != 0.0 else []


def noise_beside(data: Centred, b: Band) -> bool:
    """Return whether a stem leaves no more of PV than white noise."""
    return noise_alone(data, b.stem(data.u), b.begin, b.fit)


def further(data: Centred, found: Found, seeds: Sequence[Band], limits: Limits) -> Found:
    """Return the same search, gone on with from further stems, and the best of both."""
    met: list[Band] = []
    ends: list[Band] = []
    for seed in seeds:
        way = [b for b in nearer(data, seed, SPREADS[1:], found.only, limits, ends) if b.fit.gain != 0.0]
        met, ends = [*met, *way], [*ends, *([best_of(way)] if way else [])]
    best = best_of([found.best, *met])
    if best is found.best:
        return replace(found, again=(*found.again, *met))
    best, fits, rows = _polished(data, best, found.only, limits)
    return replace(found, best=best, again=(*found.again, *met, *fits), rows=rows, walked=data)


def _polished(
    data: Centred, best: Band, only: float | None, limits: Limits
) -> tuple[Band, list[Band], NDArray[np.float64]]:
    """The best of the stems close about one, all that were met, and the walks' rows."""
    met: list[Band] = []
    rows = np.empty((0, 4))
    for reach in REACHES:
        fits, walked = closer(data, best, reach, 0.05 * reach[0], only, limits)
        met, rows = [*met, *fits], np.vstack([rows, walked])
        best = best_of([best, *fits])
    plant, start = (best.fit.tau, best.fit.theta), (best.first, best.sense)
    best = best_of([best, fit_band(data, best.S, best.J, start, limits, plant, 300)])
    return best if only is not None else jumped(data, best, limits), met, rows


def _beside(data: Centred, best: Band, only: float | None, limits: Limits) -> list[Band]:
    """The stems that slip some whole samples before or after the best, with dead times that make up for that.

    Between them some slips have moved and others not, which fits worse: a search by small steps ends in any of them.
    Where slips are few, and OP ramps between them, that may be many samples from the truth. No stem is closer to the
    best than `APART` of S. With few slips a stem of another jump, and gain, may be one slip from the truth as well.
    """
    x = best.stem(data.u)
    moves = np.diff(x, prepend=x[0]) != 0.0
    slips = np.flatnonzero(moves[1:] & ~moves[:-1]) + 1
    slips = slips[slips >= BEFORE]
    if not slips.size:
        return []
    rate = float(np.median(np.abs(data.u[slips] - data.u[slips - BEFORE]))) / BEFORE
    start, found = (best.first, best.sense), []
    few = best.slips < ENOUGH_SLIPS
    if not few and rate < APART * best.S:
        return []
    for later in LATER if few else LATER[:LATER_MANY]:
        S, theta = best.S + later * rate, best.fit.theta - later
        if S > 0.0 and abs(S - best.S) >= APART * best.S and 0.0 <= theta <= limits.theta[1]:
            J = best.J if only is None else only * S
            found.append(fit_band(data, S, J, start, limits, (best.fit.tau, theta), 40))
    if only is None and few:
        plant = (best.fit.tau, best.fit.theta)
        found += [fit_band(data, best.S, share * best.J, start, limits, plant, 40) for share in JUMPS]
    return found


def _here(part: Centred, b: Band, limits: Limits) -> Band:
    """The same stem on a part of the record, from the start that suits it there and with a plant of its own."""
    theta = min(b.fit.theta, limits.theta[1])
    start = best_start(part, (b.S, b.J), (b.fit.tau, theta))[1:]
    return fit_band(part, b.S, b.J, start, limits, (b.fit.tau, theta), 120)


def _rejects(part: Centred, own: Band, other: Band) -> bool:
    """Whether a part's own best stem is significantly likelier there than another."""
    ratio = max(other.fit.sse / part.samples, part.floor) / max(own.fit.sse / part.samples, part.floor)
    return _effective(part, own) * math.log(ratio) > CHI_SQUARE


def _effective(data: Centred, b: Band) -> float:
    """The number of independent samples that what a stem leaves is worth."""
    return effective_samples(data, b.stem(data.u), b.begin, b.fit)


def alike(data: Centred, found: Found, limits: Limits, rival: float = math.inf) -> Bands:
    """Return what the record cannot tell from the best stem: the 95 % likelihood region, and what each half chooses.

    The stems have plants of their own. rival: EU^2, the sum of squares of another valve's best stem, where that is the
    better one.
    """
    best, n = found.best, data.samples
    effective = _effective(data, best)
    base = max(min(best.fit.sse, rival) / n, data.floor)
    most = base * math.exp(CHI_SQUARE / effective) * n
    met = _measured(data, found, limits)
    stems = [best, *(b for b in met if max(b.fit.sse, n * data.floor) <= most)]
    if best.slips >= 2 * HALF_SLIPS:
        stems += _halves(data, sorted(met, key=lambda b: b.fit.sse)[:60])
    stems += _outwards(data, best, most, found.only, limits)
    rows = found.rows
    if data is not found.walked:
        rows = np.vstack([closer(data, best, reach, 0.05 * reach[0], found.only, limits)[1] for reach in REACHES])
    near = rows[np.maximum(rows[:, 2], n * data.floor) <= most]
    if near.size:
        # Gain and jump make up for each other: the plant may be what it is with the outermost of these stems.
        ends = {tuple(near[end(near[:, i]), :2].tolist()) for i in (0, 1) for end in (np.argmin, np.argmax)}
        start, plant = (best.first, best.sense), (best.fit.tau, best.fit.theta)
        stems += [fit_band(data, S, J, start, limits, plant, 40) for S, J in sorted(ends)]
    stems = [best, *(b for b in stems[1:] if b.fit.gain != 0.0)]
    held = np.array([_held(data, b, found.only) for b in stems])
    S = [*held[:, :2].ravel().tolist(), *near[:, 0].tolist()]
    J = [*held[:, 2:].ravel().tolist(), *near[:, 1].tolist()]
    behind = [effective * math.log(max(b.fit.sse / n, base) / base) / CHI_SQUARE for b in stems]
    spare = tuple(math.sqrt(max(1.0 - share, 0.0)) for share in behind)
    return Bands(best, tuple(stems), spare, (min(S), max(S)), (min(J), max(J)))


def alike_about(data: Centred, best: Band, met: tuple[Band, ...], only: float | None, limits: Limits) -> Bands:
    """Return what the record cannot tell from the best stem close about one that was met beside the search.

    met: others that were met there.
    """
    ways = [_polished(data, b, only, limits) for b in started_beside(data, best, limits)]
    best, _, rows = min(ways, key=lambda way: way[0].fit.sse)
    fits = (b for _, fits, _ in ways for b in fits)
    return alike(data, Found(best, data, (best, *met, *fits), rows, data, only), limits)


def _measured(data: Centred, found: Found, limits: Limits) -> list[Band]:
    """The stems met in a search, in the measure that the record has now: the likely ones are fitted again."""
    if data is found.measure:
        return [*found.met, *found.again]
    n, best = found.measure.samples, best_of(list(found.met))
    least = max(best.fit.sse / n, found.measure.floor) * n
    most = least * math.exp((CHI_SQUARE + SLACK) / _effective(found.measure, best))
    likely = sorted((b for b in found.met if b.fit.sse <= most), key=lambda b: b.fit.sse)
    reach = np.array([(b.S, b.J, b.fit.gain, b.fit.tau, b.fit.theta) for b in likely])
    outermost = [likely[i] for i in (*reach.argmin(axis=0).tolist(), *reach.argmax(axis=0).tolist())]
    chosen = {id(b): b for b in (*likely[:LIKELIEST], *outermost)}.values()
    again = [fit_band(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta), 30) for b in chosen]
    return [*found.again, *again]


def _held(data: Centred, b: Band, only: float | None) -> tuple[float, float, float, float]:
    """The least and the largest S, and J, with which a stem goes the same way: where it slips, and S - J, stay."""
    if only is not None:
        return b.S, b.S, b.J, b.J
    box = np.empty(4)
    band_path(data.u, spans_of(data.u), b.S, b.J, b.first, b.sense, np.empty(data.samples), box)
    less = min(b.S - box[S_LOW], b.J - box[J_LOW])
    more = min(box[S_HIGH] - b.S, box[J_HIGH] - b.J, data.op_range)
    return b.S - less, b.S + more, b.J - less, b.J + more


def _outwards(data: Centred, best: Band, most: float, only: float | None, limits: Limits) -> list[Band]:
    """The stems met in steps of S, and of J, away from the best, each way until the record tells them apart.

    Each begins with the plant of the one before it, as gain, jump and plant make up for each other. Steps grow; between
    the last that the record does not tell apart and the first that it does it is asked again.
    """
    met: list[Band] = []
    for along in (0, 1) if only is None else (0,):
        for way in (-1.0, 1.0):
            step, reach, beyond, last = OUTWARDS[0], 0.0, math.inf, best
            for _ in range(MOST_STEPS):
                there = _beyond(data, best, last, (along, way * step * best.S), only, limits)
                if there is not None and max(there.fit.sse, data.samples * data.floor) <= most:
                    met.append(there)
                    last, reach = there, step
                else:
                    beyond = step
                if reach == 0.0 or beyond - reach < CLOSELY * reach:
                    break
                step = 0.5 * (reach + beyond) if math.isfinite(beyond) else OUTWARDS[2] * reach
                if step > OUTWARDS[1]:
                    break
    return met


def _beyond(
    data: Centred, best: Band, last: Band, away: tuple[int, float], only: float | None, limits: Limits
) -> Band | None:
    """The best stem a step away from the best, along S (0) or J (1), with what is not stepped left to follow."""
    along, step = away
    plant, start = (last.fit.tau, last.fit.theta), (last.first, last.sense)
    if along == 0:
        S = best.S + step
        if not NARROWEST * data.op_range <= S <= WIDEST * data.op_range:
            return None
        jumps = {max(best.J + f * abs(step), 0.0) for f in (-1.0, 0.0, 1.0)} | {last.J} if only is None else {only * S}
        there = started(data, best_of([fit_band(data, S, J, start, limits, plant, 24) for J in jumps]), limits)
    else:
        J = best.J + step
        if J < 0.0:
            return None
        fits = [
            fit_band(data, S, J, start, limits, plant, 24) for S in {last.S, max(last.S + J - last.J, 0.5 * last.S)}
        ]
        seed = best_of(fits)
        there = best_of([seed, *closer(data, seed, SIDEWAYS, 0.1 * SIDEWAYS[0], None, limits)[0]])
    return there if there.fit.gain != 0.0 else None


def _halves(data: Centred, bands: list[Band]) -> list[Band]:
    """The stems that each half of the record would choose by itself among the likely ones."""
    half = data.samples // 2
    costs = np.empty((len(bands), 2))
    for i, b in enumerate(bands):
        squares = data.innovations(predict(data, b.stem(data.u), b.begin, b.fit)[0]) ** 2
        costs[i] = squares[:half].sum(), squares[half:].sum()
    costs = np.maximum(costs, half * data.floor)
    return [bands[int(i)] for i in np.argmin(costs, axis=0)]
