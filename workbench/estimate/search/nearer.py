"""From two-parameter stems on to the best about them: ever smaller steps, and walks from one sequence of slips on.

Where the search begins is told by the grids of `two_parameter` and `dense`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Limits
from workbench.estimate.fits.windows import EXACT
from workbench.estimate.kernels.bands import scan_bands
from workbench.estimate.search.two_parameter import SEEDS, Band, Line, best_of, fit_band, fitted, started, walked
from workbench.model.record import FloatArray

__all__ = ["CROSSINGS", "REACHES", "REACHES_LONG", "REFITS", "SPREADS", "closer", "nearer", "search_short", "within"]

SPREADS = (0.1, 0.04, 0.015, 0.005)  # of S: how far stems with plants of their own are looked at about a seed,
FURTHER = dict(zip(SPREADS, (*SPREADS[1:], 0.0), strict=True))  # and how far next, after each of them
BEHIND = (40.0, 20.0, 20.0, math.inf)  # in N log V: who is as far behind then has never come to lead
CLOSE = 1  # of the spreads are left out where the best is known to be near
TELLS = 0.05  # in N log V: a stem that is likelier by less is no step on
STEPS = 6  # how often at most a spread is gone through, each time about the best so far,
AROUND, QUICK = 5, 14  # how many values of S, and evaluations of each
WALKED, WALKS = 2.0, 2  # of the spread: how far sequences of slips are walked, and how many of each are fitted
ACROSS, ACROSS_GRID = 0.07, 29  # of S: how far a close grid about the best goes, and how many values of S it has
CROSSINGS = 3  # of it at most, with `SEEDS` of its stems, about which S and J are walked
REACHES = ((0.006, 0.015), (0.002, 0.005))  # how far, of S: along S and along J
REACHES_LONG = (*REACHES, (0.0006, 0.0012))  # in a long record, where a slip that is a sample off is dear
LINES, FINEST = 13, 200  # of J in each, and steps of S at most where it is known closely
REFITS = 6  # best lines of which each gets its own plant


def closer(
    data: Centred, seed: Band, reach: tuple[float, float], step: float, only: float | None, limits: Limits
) -> tuple[list[Band], NDArray[np.float64]]:
    """Walk S and J about a seed within a reach of both, relative to S; fit the best and the best of each line of J."""
    if only is None:
        J = np.unique(np.maximum(seed.J + np.linspace(-reach[1], reach[1], LINES) * seed.S, 0.0))
    else:
        J = np.array([only * seed.S])
    low, high = seed.S * (1.0 - reach[0]), min(seed.S * (1.0 + reach[0]), data.op_range)
    # Breakpoints closer than a tenth of the step are passed over: a stem that hardly moves has thousands of them.
    steps = (0.1 * step * low if data.samples <= EXACT else step * low, step * low)
    return _best_along(data, seed, (low, high), J, steps, limits)


def within(
    data: Centred, seed: Band, box: tuple[float, float, float, float], only: float | None, limits: Limits
) -> list[Band]:
    """Return the best stems in a rectangle (S from, to, J from, to) about a seed, within the first of `REACHES` of it.

    only: J as a share of S, None for any.
    """
    reach_S, reach_J = (share * seed.S for share in REACHES[0])
    low, high = max(box[0], seed.S - reach_S), min(box[1], seed.S + reach_S, data.op_range)
    J = np.array([0.0 if only is None else only * seed.S])
    if only is None:
        J = np.unique(np.linspace(max(box[2], seed.J - reach_J, 0.0), min(box[3], seed.J + reach_J), LINES))
    step = (high - low) / FINEST
    return _best_along(data, seed, (low, high), J, (step, 10.0 * step), limits)[0]


def _best_along(
    data: Centred,
    seed: Band,
    span: tuple[float, float],
    jumps: FloatArray,
    steps: tuple[float, float],
    limits: Limits,
) -> tuple[list[Band], NDArray[np.float64]]:
    """The best stems of walks of S over a span, %, at some J, %, with plants of their own, and all their rows."""
    plant, start, (low, high) = (seed.fit.tau, seed.fit.theta), (seed.first, seed.sense), span
    lines = [
        line
        for line in walked(data, [Line((low, j), 0, high, steps, start, plant) for j in jumps.tolist()])
        if len(line)
    ]
    if not lines:
        return [], np.empty((0, 4))
    tops = np.array([line[np.argmin(line[:, 2])] for line in lines])
    tops = tops[np.argsort(tops[:, 2], kind="stable")][:REFITS]
    fits = fitted(data, [tuple(row) for row in tops[:, :2].tolist()], start, limits, plant, 50)
    return [b for b in fits if b.fit.gain != 0.0 and b.slips > 0], np.vstack(lines)


def nearer(
    data: Centred,
    seed: Band,
    spreads: tuple[float, ...],
    only: float | None,
    limits: Limits,
    known: Sequence[Band] = (),
) -> list[Band]:
    """Return all stems met from a seed on by steps of less and less size towards the best about it.

    spreads: some of `SPREADS`. known: ends of other such ways; one that comes close to them goes no further.
    """
    best = started(data, seed, limits)
    met = [seed, best]
    for spread in spreads:
        for _ in range(STEPS):
            if any(_same_way(data, best, end, FURTHER[spread]) for end in known):
                return met
            met += [*_about(data, best, spread, only, limits), *_lengthways(data, best, spread, only, limits)]
            before, best = best, best_of(met)
            if not _likelier(data, best, before):
                break
            best = started(data, best, limits)
            met.append(best)
    return met


def _likelier(data: Centred, one: Band, other: Band) -> bool:
    return _level(data, other) - _level(data, one) > TELLS


def _same_way(data: Centred, b: Band, end: Band, reach: float) -> bool:
    """Whether a stem is within a reach, of S, of the end of another's way, and no likelier than that."""
    near = abs(math.log(b.S / end.S)) < 0.5 * reach and abs(b.J - end.J) < reach * end.S
    return near and not _likelier(data, b, end)


def _lengthways(data: Centred, seed: Band, spread: float, only: float | None, limits: Limits) -> list[Band]:
    """The best of the sequences of slips along S and along J about a seed, each fitted with its own plant.

    A sequence may hold for a range of J far narrower than what a grid in proportion to S can meet.
    """
    if only is not None:
        return []
    reach = WALKED * spread * seed.S
    steps = (0.01 * reach, 0.1 * reach)
    plant, start = (seed.fit.tau, seed.fit.theta), (seed.first, seed.sense)
    lines = []
    for along, at in enumerate((seed.S, seed.J)):
        low = max(at - reach, 0.1 * at)
        begin, other = ((low, seed.J), seed.J) if along == 0 else ((seed.S, low), seed.S)
        end = min(at + reach, 2.0 * data.op_range - other)
        lines.append(Line(begin, along, end, steps, start, plant))
    found = []
    for rows in walked(data, lines):
        found += [tuple(row) for row in rows[_lows(rows[:, 2])[:WALKS], :2].tolist()]
    fits = fitted(data, found, start, limits, plant, QUICK, 1e-5)
    return [b for b in fits if b.fit.gain != 0.0 and b.slips > 0]


def _lows(costs: NDArray[np.float64]) -> NDArray[np.int64]:
    """Where the costs along a line are no higher than on either side, the lowest first, then all others likewise.

    Beside the lowest lie others of the same sequence of slips, which lead nowhere else.
    """
    beside = np.concatenate([[math.inf], costs, [math.inf]])
    high = (costs > beside[:-2]) | (costs > beside[2:])
    return np.lexsort((costs, high))


def _across(data: Centred, b: Band, only: float | None, limits: Limits) -> list[Band]:
    """The best few of a close grid of (S, J) about a stem, at plants close to its own."""
    widths = b.S * (1.0 + np.linspace(-ACROSS, ACROSS, ACROSS_GRID))
    jumps = np.unique(np.maximum(b.J + 3.0 * ACROSS * b.S * np.linspace(-1.0, 1.0, 9), 0.0))
    grid = np.column_stack([np.repeat(widths, jumps.size), np.tile(jumps, widths.size)])
    if only is not None:
        grid = np.column_stack([widths, only * widths])
    thetas = {min(max(b.fit.theta + step, 0.0), limits.theta[1]) for step in (-0.3, 0.0, 0.3)}
    plants = [(b.fit.tau * factor, theta) for factor in (0.93, 1.0, 1.07) for theta in sorted(thetas)]
    pairs, costs = np.array(plants), np.empty((len(grid), len(plants)))
    scan_bands(
        data.target, data.u, b.first, b.sense, grid, data.sign, data.integrating, pairs, data.a, data.skip, costs
    )
    chosen = np.argsort(costs.min(axis=1), kind="stable")[:SEEDS].tolist()
    found = []
    for i in chosen:
        S, J = grid[i].tolist()
        found.append(fit_band(data, S, J, (b.first, b.sense), limits, plants[int(np.argmin(costs[i]))], 40))
    return found


def _about(data: Centred, seed: Band, spread: float, only: float | None, limits: Limits) -> list[Band]:
    """The stems about a seed, up to a share of S away in S and twice that in J, each with its own plant."""
    steps = np.linspace(-1.0, 1.0, AROUND) * spread
    plant, start = (seed.fit.tau, seed.fit.theta), (seed.first, seed.sense)
    jumps = [-spread, 0.0, spread] if only is None else [0.0]
    widths = (seed.S * (1.0 + float(step)) for step in steps)
    bands = [
        (S, max(seed.J + 2.0 * float(jump) * seed.S, 0.0) if only is None else only * S)
        for S in widths
        for jump in jumps
    ]
    # A jump beyond all that OP moves is never made.
    found = fitted(data, [b for b in bands if sum(b) < 2.0 * data.op_range], start, limits, plant, QUICK, 1e-5)
    return [b for b in found if b.fit.gain != 0.0 and b.slips > 0]


def _apart(bands: list[Band]) -> list[Band]:
    """The first few of some stems that differ in S."""
    kept: list[Band] = []
    for b in bands:
        if len(kept) < SEEDS and all(abs(math.log(b.S / k.S)) > 0.04 or abs(b.J - k.J) > 0.1 * k.S for k in kept):
            kept.append(b)
    return kept


def _level(data: Centred, b: Band) -> float:
    """N log V of what a stem leaves, at least what the record resolves."""
    return data.samples * math.log(max(b.fit.sse / data.samples, data.floor))


def _leading(data: Centred, ends: list[Band], behind: float, further: float) -> list[Band]:
    """Of the ends of some ways, the best first, those that are neither far behind nor on another's way.

    behind: by which N log V may be higher than the best; further: the share of S within which each is looked about
    next.
    """
    kept: list[Band] = []
    for b in sorted(ends, key=lambda one: one.fit.sse):
        near = (abs(math.log(b.S / k.S)) < 0.5 * further and abs(b.J - k.J) < further * k.S for k in kept)
        if not kept or (_level(data, b) - _level(data, kept[0]) <= behind and not any(near)):
            kept.append(b)
    return kept


def search_short(
    data: Centred,
    coarse: list[Band],
    only: float | None,
    limits: Limits,
    beside: tuple[Band, ...] = (),
    known: bool = False,
    most: float = math.inf,
    near: bool = False,
) -> tuple[list[Band], NDArray[np.float64]]:
    """Search a short record: the close grid, then closer about its best few; all stems met and the last rows.

    known: whether the best is known to be close by; near: whether it is likely to be. most: EU^2, of a stem that is
    looked at closer.
    """
    met = [b for b in coarse if b.fit.gain != 0.0]
    if only is not None:
        met = [fit_band(data, b.S, only * b.S, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta)) for b in met]
    bands: list[Band] = []
    # Neither takes the other's place: which of some stems with wrong slips leads to the right ones is not seen yet.
    leaders = [b for kind in (met, beside) for b in _apart(sorted(kind, key=lambda b: b.fit.sse))]
    if not leaders:
        return [], np.empty((0, 4))
    for spread, behind in list(zip(SPREADS, BEHIND, strict=True))[CLOSE if known or near else 0 :]:
        ends: list[Band] = []
        for seed in leaders:
            met = nearer(data, seed, (spread,), only, limits)
            bands += met
            ends.append(best_of(met))
        leaders = _leading(data, ends, behind, FURTHER[spread])
        if leaders[0].fit.sse > most:
            return bands, np.empty((0, 4))
    # Between two sequences of slips lies many a worse one, which steps along the valley of S and plant do not cross.
    best = leaders[0]
    for _ in range(0 if known else CROSSINGS):
        # Whatever came to be better in the end was no worse when it was met.
        seeds = [seed for seed in _across(data, best, only, limits) if _level(data, seed) <= _level(data, best)]
        ends = [best]
        for seed in seeds:
            met = nearer(data, seed, SPREADS[2:], only, limits, ends)
            bands += met
            ends.append(best_of(met))
        before, best = best, best_of(ends)
        if not _likelier(data, best, before):
            break
    best = started(data, best, limits)
    rows = np.empty((0, 4))
    for _ in range(2):
        before = best
        for reach in REACHES:
            found, walked = closer(data, best, reach, 0.05 * reach[0], only, limits)
            rows = np.vstack([rows, walked])
            bands += found
            best = best_of([best, *found])
        if not _likelier(data, best, before):
            break
    return [best, *bands], rows
