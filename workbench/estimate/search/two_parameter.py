"""The two-parameter valve (S, J): the stem that explains PV best, dead band (J = 0) included.

A sequence of slips holds for a rectangle in (S, J): the stem turns where OP has come back by more than S and moves on
where it has gone on by more than J. Walking S at a fixed J, or J at a fixed S, from breakpoint to breakpoint meets the
sequences one after the other. A coarse grid with its own plant at each point finds where to walk. Unlike the
one-parameter stem, this one forgets its start once it has turned, so that a long record is searched in its most active
windows and then walked as a whole (`bands`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.detect.rivals import dead_times
from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, fit_bands
from workbench.estimate.fits.windows import EXACT, windows_of
from workbench.estimate.kernels import abreast
from workbench.estimate.kernels.bands import scan_starts, screen_bands
from workbench.estimate.kernels.path import band_path, spans_of
from workbench.estimate.search.stems import thin
from workbench.model.record import FloatArray

__all__ = [
    "NARROWEST",
    "SEEDS",
    "SHARES",
    "USUAL",
    "WIDE",
    "WIDEST",
    "Band",
    "Line",
    "Seed",
    "band_stem",
    "best_of",
    "best_start",
    "bests",
    "differs",
    "fit_band",
    "fitted",
    "held_range",
    "jumped",
    "look",
    "seen_thinned",
    "started",
    "started_beside",
    "walked",
]

NARROWEST, WIDEST = 0.04, 0.95  # of OP's range
GRID = 48  # values of S looked at; from WIDE on there are few slips, and a single one that is wrong spoils the fit:
WIDE, GRID_WIDE = 0.25, 60  # as many as that
WIDE_OPEN, JUMPS = 0.5, 0.75  # from there on S is walked too, with J in shares of that of OP's range
STEEPEST = 3  # and the plants of so many of the best
SHARES = (0.0, 0.12, 0.27, 0.45, 0.7, 1.0, 1.35)  # of J, of S
FINER, FINER_TAUS = (-0.04, -0.02, 0.0, 0.02, 0.04), (0.7, 0.85, 1.0, 1.2, 1.45)  # about the best of them, of each
SHORTEST, LONGEST, TAUS = 0.3, 10.0, 9  # time constants looked at: samples, records, how many
USUAL, FURTHER = 40.0, 1.15  # samples: beyond it each dead time is so much longer than the one before
PICKED, WALKED_IN, WIDE_IN = 14, 6, 4  # stems of the grid, of walks of J from it and of S that get their own plant,
SEEN = 10  # stems of a long record thinned
NEAR, NEAR_JUMP = 0.05, 0.1  # no two of them as near as that, of S
SEEDS = 4  # of the best, from which the search goes on
MOST_ROWS = 4000  # of a line that is walked
AT_ONCE = np.array([[-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])  # starts (first, sense) that any record may have
# First slips tried beside the stem that rests in the middle of its band, and at the end of a search of a long record:
# one that is another's is dear, and of many one or two suit.
STARTS, MOST_STARTS = 60, 1000
BESIDE = 2  # and before and after the best, with plants of their own
JUMP, FURTHEST, PARABOLAS = 0.005, 8.0, 3  # of S: a step of J, how many of them a parabola is followed, and how often


Seed = tuple[float, float, float, float]  # S, J, tau, theta


@dataclass(frozen=True, eq=False)
class Band:
    """A two-parameter stem (S, J in %) with its output-error fit; first and sense: its start (see `band_path`)."""

    S: float
    J: float
    first: int
    sense: float
    slips: int
    fit: Fit

    @property
    def begin(self) -> int:
        """The sample from which the stem is known."""
        return max(self.first, 0)

    def stem(self, u: FloatArray, wider: float = 1.0, further: float = 1.0) -> FloatArray:
        """Return the path under OP u, shape (N,), 0 before `begin`; of S and J multiplied by two factors."""
        return band_stem(u, self.S * wider, self.J * further, self.first, self.sense)[0]


def band_stem(u: FloatArray, S: float, J: float, first: int = -1, sense: float = 0.0) -> tuple[FloatArray, int]:
    """Return (stem path, number of slips): shape (N,), 0 before `first` unless that is -1 (see `band_path`)."""
    x = np.empty(u.size)
    return x, band_path(u, spans_of(u), S, J, first, sense, x, np.empty(4))


def held_range(u: FloatArray, b: Band) -> tuple[float, float]:
    """Return the range of the stem before `first`, %, in which the valve can hold it until then; infinite from 0 on."""
    if b.first <= 0:
        return -math.inf, math.inf
    reach = 0.5 * (b.S + b.J)
    low, high = sorted((float(u[: b.first].max()) - reach, float(u[: b.first].min()) + reach))
    return low, high


def look(data: Centred, longest: float) -> list[Band]:
    """Return the best fits over a grid of (S, J), starts and plants, the best first, with dead times up to `longest`.

    Each of the grid's stems has the best of a grid of plants; the best few that differ are then fitted with their own.
    A long record is looked at thinned and in its liveliest window. Empty where no stem of the grid moves.
    """
    if data.samples > EXACT:
        return _look_aside(data, longest)
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
    found = [_placed(data, seed, limits) for seed in _screened(data, *_grid(data, longest), PICKED)]
    return sorted((b for b in found if b.slips > 0 and b.fit.gain != 0.0), key=lambda b: b.fit.sse)


def _grid(data: Centred, longest: float) -> tuple[FloatArray, FloatArray, list[float]]:
    """Rows (S, J), time constants and dead times to look at."""
    taus = np.geomspace(SHORTEST, LONGEST * data.samples, TAUS)[-1 if data.integrating else 0 :]
    narrow, wide = np.geomspace(NARROWEST, WIDEST, GRID), np.geomspace(WIDE, WIDEST, GRID_WIDE)
    S = np.concatenate([narrow[narrow < WIDE], wide]) * data.op_range
    grid = np.column_stack([np.repeat(S, len(SHARES)), (S[:, None] * np.array(SHARES)).ravel()])
    return grid, taus, _delays(data.samples, longest)


def seen_thinned(data: Centred, longest: float) -> list[Seed]:
    """Return the best (S, J, tau, theta) that differ of a grid over a long record thinned, whose stems see all of OP.

    A stem that sees one sample of so many of OP slips at other times, and few slips forgive nothing.
    """
    every = math.ceil(data.samples / EXACT)
    thin = data.thinned(every)
    op = data.u[: thin.samples * every]
    seeds = _screened(thin, *_grid(thin, longest / every), SEEN, op)
    return [(S, J, tau * every, theta * every) for S, J, tau, theta in seeds]


def _delays(n: int, longest: float) -> list[float]:
    """The dead times of the grid of plants, samples: closer together where longer ones than usual are asked for."""
    delays = [float(d) for d in dead_times(n, math.nan) if d <= longest]
    while longest > USUAL and (further := max(delays[-1] + 1.0, round(FURTHER * delays[-1]))) <= longest:
        delays.append(float(further))
    return delays


def _look_aside(data: Centred, longest: float) -> list[Band]:
    """What is seen of a longer record that is thinned, and in its liveliest window, each placed in all of it.

    Thinned, slow cycles are all there; a window has slips enough of fast ones.
    """
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
    found: list[Band] = []
    for begin, stop in windows_of(data)[:1]:
        part = data.part(begin, stop)
        if part.moves:
            part = part.whitened(data.a, max(data.skip - begin, 0), data.law)
            found += look(part, min(longest, part.samples / 4.0))[:SEEDS]
    seeds = [*seen_thinned(data, longest), *((b.S, b.J, b.fit.tau, b.fit.theta) for b in found)]
    placed = [_placed(data, seed, limits) for seed in seeds]
    return sorted((b for b in placed if b.slips > 0 and b.fit.gain != 0.0), key=lambda b: b.fit.sse)


def _screened(
    data: Centred, grid: FloatArray, taus: FloatArray, delays: list[float], most: int, op: FloatArray | None = None
) -> list[Seed]:
    """The best (S, J, tau, theta) of a grid of rows (S, J) that differ, each with the best plant of a grid.

    op: that stems see, where data is a record thinned.
    """
    grid = grid[grid.sum(axis=1) < 2.0 * data.op_range]
    found = np.empty((len(grid), 4, 3))
    poles, whole = np.exp(-1.0 / taus), np.array(delays, dtype=np.int64)
    screen_bands(data.target, data.u if op is None else op, grid, poles, whole, data.sign, data.a, data.skip, found)
    chosen: list[Seed] = []
    # A start that is known uses all of the record, one that is not may leave its liveliest part out: both are asked.
    started = np.argmin(found[:, :3, 0], axis=1)
    for starts, share in ((started, (most + 1) // 2), (np.full(len(grid), 3), most)):
        best = found[np.arange(len(grid)), starts]
        for i in np.argsort(best[:, 0], kind="stable").tolist():
            seed = (*grid[i].tolist(), float(taus[int(best[i, 1])]), delays[int(best[i, 2])])
            if len(chosen) < share and math.isfinite(best[i, 0]) and differs(seed, chosen):
                chosen.append(seed)
    if most == 1 or op is not None:
        return chosen
    # A sequence of slips may hold for a range of J too narrow for any grid: at each S all of J is walked.
    least = np.argmin(found.reshape(len(grid), 4, 3)[:, :, 0], axis=1)
    best = found[np.arange(len(grid)), least]
    seeds: list[Seed] = []
    for S in np.unique(grid[:, 0]).tolist():
        here = np.flatnonzero(grid[:, 0] == S)
        i = int(here[np.argmin(best[here, 0])])
        if math.isfinite(best[i, 0]):
            seeds.append((*grid[i].tolist(), float(taus[int(best[i, 1])]), delays[int(best[i, 2])]))
    finest = np.argsort(best[:, 0], kind="stable")[:STEEPEST]
    plants = {(float(taus[int(best[i, 1])]), delays[int(best[i, 2])]) for i in finest if math.isfinite(best[i, 0])}
    for walks, share in (
        (_along(data, seeds), most + WALKED_IN),
        (_over(data, sorted(plants)), most + WALKED_IN + WIDE_IN),
    ):
        for _, seed in sorted(walks):
            if len(chosen) < share and differs(seed, chosen):
                chosen.append(seed)
    return chosen


def differs(seed: Seed, chosen: list[Seed]) -> bool:
    """Return whether a stem's S or J is not near that of any of those chosen."""
    S, J = seed[:2]
    return all(abs(S / c[0] - 1.0) > NEAR or abs(J - c[1]) > NEAR_JUMP * S for c in chosen)


def _along(data: Centred, seeds: list[Seed]) -> list[tuple[float, Seed]]:
    """(cost, seed), of each seed's S and plant, for the best of the sequences of slips that J leads through."""
    lines = []
    for S, J, tau, theta in seeds:
        _, first, sense = best_start(data, (S, J), (tau, theta))
        end = min(1.5 * S, 2.0 * data.op_range - S)
        lines.append(Line((S, 0.02 * S), 1, end, (0.004 * S, 0.02 * S), (first, sense), (tau, theta)))
    return bests(lines, walked(data, lines))


def _over(data: Centred, plants: list[tuple[float, float]]) -> list[tuple[float, Seed]]:
    """(cost, seed) of the best of the sequences of slips that wide S lead through with a plant, for some J.

    A stem that sticks over nearly all that OP moves slips twice a cycle; what S it takes is known to a hundredth.
    """
    span, lines = data.op_range, []
    for plant in plants:
        for J in (share * JUMPS * span for share in SHARES):
            _, first, sense = best_start(data, (0.8 * span, J), plant)
            for start in sorted({(first, sense), (0, 1.0), (0, -1.0)}):
                steps = (0.002 * span, 0.004 * span)
                lines.append(Line((WIDE_OPEN * span, J), 0, WIDEST * span, steps, start, plant))
    return bests(lines, walked(data, lines))


def bests(lines: list[Line], rows: list[NDArray[np.float64]]) -> list[tuple[float, Seed]]:
    """Return (cost, seed) of the best row of each line that has any."""
    bests = [(line, met[np.argmin(met[:, 2])]) for line, met in zip(lines, rows, strict=True) if len(met)]
    return [(float(row[2]), (float(row[0]), float(row[1]), *line.plant)) for line, row in bests]


def _placed(data: Centred, seed: Seed, limits: Limits) -> Band:
    """The best stem of a finer grid about a seed (S, J, tau, theta), with the start that suits it and its own plant."""
    S, J, tau, theta = seed
    widths = S * (1.0 + np.array(FINER))
    jumps = np.unique(np.maximum(J + 2.0 * S * np.array(FINER), 0.0))
    grid = np.column_stack([np.repeat(widths, jumps.size), np.tile(jumps, widths.size)])
    delays = [d for d in (theta + step for step in range(-3, 4)) if 0.0 <= d <= limits.theta[1]]
    near = _screened(data, grid, tau * np.array(FINER_TAUS), delays, 1)
    S, J, tau, theta = near[0] if near else seed
    least = best_start(data, (S, J), (tau, theta))
    return fit_band(data, S, J, least[1:], limits, (tau, theta), 60, 1e-5)


def fit_band(
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
    return fitted(data, [(S, J)], start, limits, plant, evaluations, tolerance)[0]


def fitted(
    data: Centred,
    bands: list[tuple[float, float]],
    start: tuple[int, float],
    limits: Limits,
    plant: tuple[float, float],
    evaluations: int,
    tolerance: float = 1e-7,
) -> list[Band]:
    """The output-error fits of some stems (S, J) with one start."""
    fits = fit_bands(data, np.reshape(np.array(bands), (-1, 2)), start, limits, plant, evaluations, tolerance)
    return [Band(S, J, *start, slips, fit) for (S, J), (fit, slips) in zip(bands, fits, strict=True)]


@dataclass(frozen=True, slots=True)
class Line:
    """A walk from (S, J), %, along S (0) or J (1) up to `end`, in steps of at least and at most so much.

    start: the stem's (first, sense), see `band_path`; plant: (tau, theta) in samples.
    """

    begin: tuple[float, float]
    along: int
    end: float
    steps: tuple[float, float]
    start: tuple[int, float]
    plant: tuple[float, float]


def walked(data: Centred, lines: list[Line]) -> list[NDArray[np.float64]]:
    """Return the rows (S, J, COST, SLIPS) of each line, in its order, all of its length within `MOST_ROWS` a line."""
    table = np.array([(*line.begin, line.along, line.end, *line.steps, *line.start, *line.plant) for line in lines])
    rows = abreast.walk_bands(
        data.target,
        data.u,
        table.reshape(-1, abreast.LINE),
        data.sign,
        data.integrating,
        data.a,
        data.skip,
        MOST_ROWS * len(lines),
    )
    ends = np.searchsorted(rows[:, 4], np.arange(len(lines) + 1))
    return [rows[first:stop, :4] for first, stop in itertools.pairwise(ends.tolist())]


def best_start(
    data: Centred, band: tuple[float, float], plant: tuple[float, float], most: int = STARTS
) -> tuple[float, int, float]:
    """Return (cost, first, sense) of the start that suits a stem best, at one plant.

    Each sample at which OP lets it slip first is tried, both senses at the record's own start, and the stem that rests
    in the middle of its band. Of more such samples than `most` so many are tried, then those about the best: a first
    slip that is off by one sample costs more of the likelihood than another stem may gain.
    """
    firsts, ranged, senses = data.starts
    able = np.flatnonzero(ranged <= sum(band))[1:]

    def scanned(starts: FloatArray) -> tuple[FloatArray, FloatArray]:
        costs = np.empty(len(starts))
        scan_starts(data.target, data.u, *band, starts, data.sign, data.integrating, *plant, data.a, data.skip, costs)
        return starts, costs

    def among(places: NDArray[np.int64]) -> FloatArray:
        return np.column_stack([firsts[places], senses[places]])

    tried = thin(able, most)
    starts, costs = scanned(np.vstack([AT_ONCE, among(tried)]))
    i = int(np.argmin(costs))
    if tried.size < able.size and i >= len(AT_ONCE):
        here = i - len(AT_ONCE)
        low, high = tried[max(here - 1, 0)], tried[min(here + 1, tried.size - 1)]
        starts, costs = scanned(among(thin(able[(able >= low) & (able <= high)], most)))
        i = int(np.argmin(costs))
    return float(costs[i]), int(starts[i, 0]), float(starts[i, 1])


def started(data: Centred, b: Band, limits: Limits, most: int = STARTS) -> Band:
    """Return the same stem from the start that suits it best; most: as in `best_start`."""
    least, first, sense = best_start(data, (b.S, b.J), (b.fit.tau, b.fit.theta), most)
    if least >= b.fit.sse or (first, sense) == (b.first, b.sense):
        return b
    other = fit_band(data, b.S, b.J, (first, sense), limits, (b.fit.tau, b.fit.theta))
    return other if other.fit.sse < b.fit.sse and other.fit.gain != 0.0 else b


def started_beside(data: Centred, b: Band, limits: Limits) -> list[Band]:
    """Return the same stem, and from the first slips before and after its own, each with a plant of its own."""
    if b.first <= 0:
        return [b]
    firsts, _, senses = data.starts
    i = int(np.searchsorted(firsts, b.first))
    plant = b.fit.tau, b.fit.theta
    near = [k for k in range(max(i - BESIDE, 1), min(i + BESIDE + 1, firsts.size)) if firsts[k] != b.first]
    fits = [fit_band(data, b.S, b.J, (int(firsts[k]), float(senses[k])), limits, plant) for k in near]
    return [b, *(one for one in fits if one.fit.gain != 0.0)]


def jumped(data: Centred, b: Band, limits: Limits, rounds: int = PARABOLAS, evaluations: int = 80) -> Band:
    """Return the same stem with the jump that suits its slips best, by parabolas through three jumps.

    Stems that slip at about the same samples differ in how far they stand to the side from which they were led. What
    that changes of PV gain and dead time make up for in part, so that steps of S and J at one plant stop short of it.
    """
    start, step = (b.first, b.sense), JUMP * b.S
    for _ in range(rounds):
        here, plant = b.J, (b.fit.tau, b.fit.theta)
        less, more = (
            fit_band(data, b.S, max(here + way * step, 0.0), start, limits, plant, evaluations) for way in (-1.0, 1.0)
        )
        slope, bend = more.fit.sse - less.fit.sse, more.fit.sse + less.fit.sse - 2.0 * b.fit.sse
        way = -0.5 * slope / bend if bend > 0.0 else 0.0
        J = max(here + step * min(max(way, -FURTHEST), FURTHEST), 0.0)
        third = fit_band(data, b.S, J, start, limits, plant, evaluations)
        b = best_of([b, *(one for one in (less, more, third) if one.fit.gain != 0.0)])
        if abs(b.J - here) <= step:
            break
    return b


def best_of(bands: list[Band]) -> Band:
    """Return the stem that leaves least."""
    return min(bands, key=lambda b: b.fit.sse)
