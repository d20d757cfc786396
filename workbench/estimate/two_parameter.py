"""The two-parameter valve (S, J): the stem that explains PV best, dead band (J = 0) included.

A sequence of slips holds for a rectangle in (S, J): the stem turns where OP has come back by more than S and moves on
where it has gone on by more than J. At a fixed J the sequences are met one after the other by walking S from breakpoint
to breakpoint; J is put on lines. A coarse grid with its own plant at each point finds where to walk. Unlike the
one-parameter stem, this one forgets its start once it has turned, so that a long record is searched in its most active
windows and then walked as a whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.estimate import kernel
from workbench.estimate.data import Centred
from workbench.estimate.fit import LEAST_TAU, Fit, Limits, fit_linear, fit_path, inflation, predict
from workbench.estimate.profile import CHI_SQUARE, EXACT, active_windows
from workbench.estimate.stems import first_slips
from workbench.model.record import FloatArray

__all__ = ["Band", "Bands", "band_stem", "look", "refit", "repeated", "search_bands"]

BANDS = 14
NARROWEST, WIDEST = 0.04, 0.95  # of OP's range
JUMPS = (0.0, 0.3, 0.8)  # J as a share of S
GRID = 90  # values of S in the close grid
SHARES = (0.0, 0.08, 0.16, 0.26, 0.38, 0.5, 0.65, 0.8, 0.95, 1.1, 1.35)  # of J in it, of S
PICKED = 14  # points of the grid that get their own plant
SEEDS = 4  # of them, about which S and J are walked
REACHES = ((0.06, 0.15), (0.02, 0.05), (0.006, 0.015), (0.002, 0.005))  # how far, of S: along S and along J
LINES = 13  # of J in each
REFITS = 6  # best lines of which each gets its own plant
MOST_STARTS = 3  # starts at which the grid is scanned, beside a stem that stands at either end of its band
ENDS = ((0, 1.0), (0, -1.0))
PLANTS, MORE_PLANTS = 3, 6  # at which it is scanned, for any J and for a dead band
WIDTH_APART = 0.3  # of log S, between stems whose plants are scanned
STARTS = 12  # first slips tried beside the stem that rests in the middle of its band
HALF_SLIPS = 5  # in each half of a record, for the halves to be compared


@dataclass(frozen=True, eq=False)
class Band:
    """A two-parameter stem (S, J in %) with its output-error fit; first and sense: its start (see `band_path`)."""

    S: float
    J: float
    first: int
    sense: float
    slips: int
    fit: Fit


@dataclass(frozen=True, eq=False)
class Bands:
    """The best stem, those that the record cannot tell from it, and their ranges of S and J, %.

    parts: the fits that parts of the record have by themselves (see `repeated`).
    """

    best: Band
    alike: tuple[Band, ...]
    S: tuple[float, float]
    J: tuple[float, float]
    parts: tuple[Fit, ...] = ()


def band_stem(u: FloatArray, S: float, J: float, first: int = -1, sense: float = 0.0) -> tuple[FloatArray, int]:
    """Return (stem path, number of slips): shape (N,), 0 before `first` unless that is -1 (see `band_path`)."""
    x = np.empty(u.size)
    return x, kernel.band_path(u, S, J, first, sense, x, np.empty(4))


def look(data: Centred, linear: Fit, longest: float) -> list[Band]:
    """Return the best fits over a coarse grid of (S, J), the best first, with dead times up to `longest` samples.

    The stem starts in the middle of its band at OP's first value. Empty where no stem of the grid moves.
    """
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
    tau, theta = max(linear.tau, LEAST_TAU), min(linear.theta, longest)
    evaluations = 50 if data.samples <= EXACT else 20
    found = [
        _fit(data, S, share * S, (-1, 0.0), limits, (tau, start), evaluations, 1e-4)
        for S in (np.geomspace(NARROWEST, WIDEST, BANDS) * data.op_range).tolist()
        for share in JUMPS
        for start in {theta, max(theta - S / data.op_range * theta, 0.0)}
    ]
    return sorted((b for b in found if b.slips > 0), key=lambda b: b.fit.sse)


def _fit(
    data: Centred,
    S: float,
    J: float,
    start: tuple[int, float],
    limits: Limits,
    plant: tuple[float, float],
    evaluations: int = 80,
    tolerance: float = 1e-7,
) -> Band:
    """The output-error fit of a stem, from the plant (tau, theta) in samples."""
    first, sense = start
    x, slips = band_stem(data.u, S, J, first, sense)
    fit = fit_path(
        data,
        x,
        max(first, 0),
        (-math.inf, math.inf),
        limits,
        plant[1],
        tau=plant[0],
        evaluations=evaluations,
        tolerance=tolerance,
    )
    return Band(S, J, first, sense, slips, fit)


def _line(
    data: Centred, J: float, S: tuple[float, float], like: Band, steps: tuple[float, float]
) -> NDArray[np.float64]:
    """Rows (S, J, COST, SLIPS) along S at one J, with the start and plant of `like`; steps: least and largest."""
    rows = np.empty((4000, 4))
    count = kernel.walk_bands(
        data.target,
        data.u,
        like.first,
        like.sense,
        J,
        S[0],
        S[1],
        steps[0],
        steps[1],
        data.sign,
        data.integrating,
        like.fit.tau,
        like.fit.theta,
        data.a,
        data.skip,
        rows,
    )
    return rows[:count].copy()


def _start_costs(data: Centred, b: Band) -> list[tuple[float, int, float]]:
    """(cost, first, sense) of a stem's starts, ascending: each at which OP lets it slip first, at the stem's plant."""
    u = data.u
    firsts = first_slips(u)
    held = np.maximum.accumulate(u) - np.minimum.accumulate(u)
    firsts = firsts[(firsts == 0) | (held[np.maximum(firsts - 1, 0)] <= b.S + b.J)]
    chosen = firsts[np.unique(np.round(np.linspace(0, firsts.size - 1, min(STARTS, firsts.size))).astype(np.int64))]
    starts = [(-1, 0.0), (0, 1.0), (0, -1.0)]
    starts += [(f, 1.0 if u[f] > u[:f].max() else -1.0) for f in chosen.tolist() if f > 0]
    band, plant, cost = np.array([[b.S, b.J]]), np.array([[b.fit.tau, b.fit.theta]]), np.empty((1, 1))
    found = []
    for first, sense in starts:
        kernel.scan_bands(
            data.target, data.u, first, sense, band, data.sign, data.integrating, plant, data.a, data.skip, cost
        )
        found.append((float(cost[0, 0]), first, sense))
    return sorted(found)


def _started(data: Centred, b: Band, limits: Limits) -> Band:
    """The same stem from the start that suits it best."""
    least, first, sense = _start_costs(data, b)[0]
    if least >= b.fit.sse or (first, sense) == (b.first, b.sense):
        return b
    other = _fit(data, b.S, b.J, (first, sense), limits, (b.fit.tau, b.fit.theta))
    return other if other.fit.sse < b.fit.sse and other.fit.gain != 0.0 else b


def _scanned(
    data: Centred,
    plants: list[tuple[float, float]],
    starts: list[tuple[int, float]],
    only: float | None,
    limits: Limits,
) -> list[Band]:
    """The best stems over a close grid of (S, J) at some plants and starts, each with its own plant then."""
    S = np.geomspace(NARROWEST, WIDEST, GRID) * data.op_range
    shares = np.array(SHARES if only is None else [only])
    bands = np.column_stack([np.repeat(S, shares.size), (S[:, None] * shares).ravel()])
    costs = np.empty((len(starts), len(bands), len(plants)))
    for i, (first, sense) in enumerate(starts):
        pairs = np.array(plants)
        kernel.scan_bands(
            data.target, data.u, first, sense, bands, data.sign, data.integrating, pairs, data.a, data.skip, costs[i]
        )
    least = costs.min(axis=(0, 2))
    chosen: list[int] = []
    for i in np.argsort(least, kind="stable").tolist():
        S_i, J_i = bands[i]
        near = any(abs(S_i / bands[j, 0] - 1.0) < 0.05 and abs(J_i - bands[j, 1]) < 0.15 * S_i for j in chosen)
        if not near and math.isfinite(least[i]):
            chosen.append(i)
        if len(chosen) == PICKED:
            break
    found = []
    for i in chosen:
        start, plant = np.unravel_index(int(np.argmin(costs[:, i])), (len(starts), len(plants)))
        at = (float(bands[i, 0]), float(bands[i, 1]))
        found.append(_fit(data, *at, starts[int(start)], limits, plants[int(plant)], 60))
    return sorted((b for b in found if b.fit.gain != 0.0 and b.slips > 0), key=lambda b: b.fit.sse)


def _likely_starts(data: Centred, bands: list[Band]) -> list[tuple[int, float]]:
    """The starts that suit some stems best: those that more of them prefer first."""
    votes: dict[tuple[int, float], int] = {}
    for b in bands:
        for rank, (_, first, sense) in enumerate(_start_costs(data, b)[:3]):
            votes[first, sense] = votes.get((first, sense), 0) + 3 - rank
    return sorted(votes, key=lambda start: -votes[start])[:MOST_STARTS]


def _plants(bands: list[Band], most: int) -> list[tuple[float, float]]:
    """The plants (tau, theta) of the best stems, of which no two have nearly one S: each width has its own plant."""
    kept: list[Band] = []
    for b in bands:
        if len(kept) < most and all(abs(math.log(b.S / k.S)) > WIDTH_APART for k in kept):
            kept.append(b)
    return [(b.fit.tau, b.fit.theta) for b in kept]


def _closer(
    data: Centred, seed: Band, reach: tuple[float, float], step: float, only: float | None, limits: Limits
) -> tuple[list[Band], NDArray[np.float64]]:
    """Walk S and J about a seed within a reach of both, relative to S; fit the best and the best of each line of J."""
    if only is None:
        J = np.unique(np.maximum(seed.J + np.linspace(-reach[1], reach[1], LINES) * seed.S, 0.0))
    else:
        J = np.array([only * seed.S])
    S = (seed.S * (1.0 - reach[0]), min(seed.S * (1.0 + reach[0]), data.op_range))
    # Breakpoints closer than a tenth of the step are passed over: a stem that hardly moves has thousands of them.
    least = 0.1 * step if data.samples <= EXACT else step
    lines = [_line(data, j, S, seed, (least, step)) for j in J.tolist()]
    lines = [line for line in lines if len(line)]
    if not lines:
        return [], np.empty((0, 4))
    tops = np.array([line[np.argmin(line[:, 2])] for line in lines])
    tops = tops[np.argsort(tops[:, 2], kind="stable")][:REFITS]
    plant = (seed.fit.tau, seed.fit.theta)
    start = (seed.first, seed.sense)
    fits = [_fit(data, float(row[0]), float(row[1]), start, limits, plant, 50) for row in tops]
    return [b for b in fits if b.fit.gain != 0.0 and b.slips > 0], np.vstack(lines)


def _apart(bands: list[Band]) -> list[Band]:
    """The first few of some stems that differ in S."""
    kept: list[Band] = []
    for b in bands:
        if len(kept) < SEEDS and all(abs(math.log(b.S / k.S)) > 0.04 or abs(b.J - k.J) > 0.1 * k.S for k in kept):
            kept.append(b)
    return kept


def _best_of(bands: list[Band]) -> Band:
    return min(bands, key=lambda b: b.fit.sse)


def _short(
    data: Centred, coarse: list[Band], only: float | None, limits: Limits, beside: tuple[Band, ...] = ()
) -> tuple[list[Band], NDArray[np.float64]]:
    """Search a short record: the close grid, then closer about its best few; all stems met and the last rows."""
    coarse = [b for b in coarse if b.fit.gain != 0.0 and (only is None or only * b.S == b.J)]
    if not coarse:
        return [], np.empty((0, 4))
    starts = list(dict.fromkeys([*_likely_starts(data, coarse[:SEEDS]), *ENDS]))
    met = _scanned(data, _plants(coarse, PLANTS if only is None else MORE_PLANTS), starts, only, limits)
    # The grid is scanned again at the plants that its best stems have: stiction and plant make up for each other.
    if met:
        starts = list(dict.fromkeys([*_likely_starts(data, met[:SEEDS]), *ENDS]))
        met += _scanned(data, _plants(met, PLANTS if only is None else MORE_PLANTS), starts, only, limits)
    bands: list[Band] = []
    ends = []
    for seed in _apart(sorted([*met, *beside], key=lambda b: b.fit.sse)):
        best = _started(data, seed, limits)
        bands.append(best)
        for reach in REACHES[:2]:
            found, _ = _closer(data, best, reach, 0.1 * reach[0], only, limits)
            bands += found
            best = _best_of([best, *found])
        ends.append(best)
    if not ends:
        return [], np.empty((0, 4))
    best = _started(data, _best_of(ends), limits)
    rows = np.empty((0, 4))
    for reach in (*REACHES[1:], *REACHES[2:]):
        found, walked = _closer(data, best, reach, 0.05 * reach[0], only, limits)
        rows = np.vstack([rows, walked])
        bands += found
        best = _best_of([best, *found])
    return [best, *bands], rows


def search_bands(
    data: Centred, coarse: list[Band], limits: Limits, only: float | None, beside: tuple[Band, ...] = ()
) -> Bands | None:
    """Return the best stem and its ranges, or None where none moves.

    beside: stems found otherwise, from which a short record is searched on too.

    coarse: the answer of `look`; a long record is searched in its most active stretch alone, and the stem of that
    is walked closer on the whole. only: J as a share of S (0: a dead band).
    """
    rows = np.empty((0, 4))
    if data.samples <= EXACT:
        bands, rows = _short(data, coarse, only, limits, beside)
    else:
        bands = []
        for part in active_windows(data)[:1]:
            seen = look(part, fit_linear(part, limits.theta[1]), limits.theta[1])
            found = _short(part, seen, only, limits)[0]
            if found:
                best = _best_of(found)
                bands.append(_fit(data, best.S, best.J, (-1, 0.0), limits, (best.fit.tau, best.fit.theta), 40))
        bands = [b for b in bands if b.slips > 0]
        if bands:
            best = _best_of(bands)
            for reach in REACHES[2:]:
                found, rows = _closer(data, best, reach, 0.2 * reach[0], only, limits)
                bands += found
                best = _best_of([best, *found])
    bands = [b for b in bands if b.fit.gain != 0.0]
    if not bands:
        return None
    best = _best_of(bands)
    start = (best.first, best.sense)
    best = _best_of([best, _fit(data, best.S, best.J, start, limits, (best.fit.tau, best.fit.theta), 300)])
    return _ranges(data, best, bands, rows)


def refit(data: Centred, found: Bands, limits: Limits) -> Bands:
    """Return the same stems fitted anew from their own plants, the best first; the ranges stay."""
    bands = [
        _fit(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta), 80) for b in found.alike[:REFITS]
    ]
    b = found.best
    bands.append(_fit(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta), 200))
    return Bands(_best_of(bands), tuple(bands), found.S, found.J)


def repeated(data: Centred, found: Bands, limits: Limits, only: float | None) -> Bands:
    """Return the ranges widened by what parts of the record say, each searched by itself.

    The parts are the halves, of a long record its two most active stretches. What they disagree on is not known, and
    a search that ended away from the truth seldom ends there twice.
    """
    n = data.samples
    parts = [data.part(0, n // 2), data.part(n // 2, n)] if n <= EXACT else active_windows(data)[:2]
    S, J, fits = [*found.S], [*found.J], []
    for part in parts:
        if not part.op_range > 0.0 or not float(np.ptp(part.y)) > 0.0:
            continue
        longest = min(limits.theta[1], part.samples / 4.0)
        own = Limits((LEAST_TAU, float(part.samples)), (0.0, longest))
        met, _ = _short(part, look(part, fit_linear(part, longest), longest), only, own)
        if met and _best_of(met).slips >= HALF_SLIPS:
            S.append(_best_of(met).S)
            J.append(_best_of(met).J)
            fits.append(_best_of(met).fit)
    return Bands(found.best, found.alike, (min(S), max(S)), (min(J), max(J)), tuple(fits))


def _ranges(data: Centred, best: Band, bands: list[Band], rows: NDArray[np.float64]) -> Bands:
    """What the record cannot tell from the best: the 95 % likelihood region, and what each half would choose."""
    n = data.samples
    x, _ = band_stem(data.u, best.S, best.J, best.first, best.sense)
    effective = n / inflation(data.innovations(predict(data, x, max(best.first, 0), best.fit)[0]))
    most = max(best.fit.sse / n, data.floor) * math.exp(CHI_SQUARE / effective) * n
    alike = [best, *(b for b in bands if max(b.fit.sse, n * data.floor) <= most)]
    if best.slips >= 2 * HALF_SLIPS:
        alike += _halves(data, sorted(bands, key=lambda b: b.fit.sse)[:60])
    near = rows[np.maximum(rows[:, 2], n * data.floor) <= most]
    S = [b.S for b in alike] + near[:, 0].tolist()
    J = [b.J for b in alike] + near[:, 1].tolist()
    return Bands(best, tuple(alike), (min(S), max(S)), (min(J), max(J)))


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
