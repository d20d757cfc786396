"""Does the stiction repeat? Parts of the record by themselves, upward against downward, and its drift in time.

The plant of the whole record is held, gain included, so that a part's stem is all that is left to find: bias, start and
transient by least squares, the band by a scan that is made closer about its best. A part of its own start knows nothing
of the others; their agreement is a check that no likelihood of the whole gives.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import START_SLACK, Fit, predict
from workbench.estimate.fits.sureness import NORMAL, inflation
from workbench.estimate.fits.windows import EXACT
from workbench.estimate.kernels.path import each_way_path
from workbench.estimate.kernels.repeat import HELD, scan_held
from workbench.estimate.search.profile import CHI_SQUARE
from workbench.model.numbers import given
from workbench.model.record import FloatArray
from workbench.model.results import Estimate, Part, Repeats
from workbench.model.valve import Choudhury, Deadband, Stenman

__all__ = ["repeats_of", "words_of"]

MOST_PARTS = 6
SLIPS = 8  # stem moves that a part should hold
FEWEST = 5  # and those below which it says nothing
SHORT = 600  # samples that a part of a long record takes at first
STARTS = 24  # first slips tried in a part
BESIDE = 8  # of them, tried about the best band so far,
LIKELY = 4  # and for each way by itself
REACHES = (0.45, 0.08, 0.015)  # how far from the band so far the scans go, of it
STEPS = 45  # bands in a scan
SIDES = (19, 9, 9)  # and for each way by itself, in each direction
BEST = 3  # of them, about which the next scan goes closer
COUNTS = 0.25  # rise of the residual variance below which a part does not tell two bands apart: many are tried
REPEAT = 0.01  # of the band: closer than this real valves do not repeat
MATTERS = 0.10  # of the band: a difference or a drift over the record that is worth a word
# 97.5 % points of Student's distribution with 1, 2, .. degrees of freedom.
STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571)


@dataclass(frozen=True, eq=False)
class _Held:
    """A part's signals with the plant that is held: gain (per sample for integrating plants), tau and theta."""

    data: Centred
    gain: float
    tau: float
    theta: float

    def scan(self, starts: FloatArray, bands: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Costs of bands (gap, up, down), each from its best start, and what `scan_held` finds beside."""
        costs, found = np.empty(len(bands)), np.zeros((len(bands), HELD))
        data = self.data
        scan_held(
            data.y,
            data.u,
            starts,
            bands,
            START_SLACK,
            self.gain,
            data.integrating,
            self.tau,
            self.theta,
            costs,
            found,
        )
        return costs, found

    def effective(self, band: FloatArray, found: FloatArray) -> float:
        """The samples less what the autocorrelation of this stem's residuals takes."""
        data = self.data
        x = np.empty(data.samples)
        first = int(found[0])
        each_way_path(data.u, band[0], band[1], band[2], first, found[1], x, np.empty(4))
        fit = Fit(math.nan, self.tau, self.theta, self.gain, found[3], found[4], found[5])
        return data.samples / inflation(data.y - predict(data, x, first, fit)[0])


@dataclass(frozen=True, slots=True)
class _Law:
    """The valve that was found, to be varied: Stenman, or two parameters with share = J/S; band: its d or S, %."""

    stenman: bool
    share: float
    band: float

    def rows(self, bands: FloatArray) -> FloatArray:
        """Rows (gap, up, down) of valves that stick alike both ways."""
        if self.stenman:
            return np.column_stack([np.full(bands.size, np.nan), bands, bands])
        jumps = self.share * bands
        return np.column_stack([bands - jumps, jumps, jumps])

    def each_way(self, offsets: FloatArray, about: tuple[float, float]) -> FloatArray:
        """Rows of valves that stick as wide as `about` (up, down), each moved by offsets, shares of the band."""
        up, down = (np.maximum(v + offsets * self.band, 0.01 * self.band) for v in about)
        gap = math.nan
        if not self.stenman:
            gap = self.band * (1.0 - self.share)
            up, down = (np.maximum(v - gap, 0.0) for v in (up, down))
        pairs = np.column_stack([np.repeat(up, down.size), np.tile(down, up.size)])
        return np.column_stack([np.full(len(pairs), gap), pairs])


def repeats_of(data: Centred, found: Estimate) -> Repeats | None:
    """Return what parts of the record say of the valve that was found, or None where they say too little.

    The parts follow one another, up to six, of some eight stem moves or more; of a long record each gives its stretch
    with the most stem moves. data: the record as it was estimated.
    """
    valve = found.valve
    if found.verdict == "no_stiction" or not isinstance(valve, Stenman | Choudhury | Deadband) or found.slips < SLIPS:
        return None
    if not valve.stick_band > 0.0:
        return None
    law = _Law(isinstance(valve, Stenman), valve.slip_jump / valve.stick_band, valve.stick_band)
    many = min(max(found.slips // SLIPS, 2), MOST_PARTS)
    gain = found.plant.gain * (data.sample_time if data.integrating else 1.0)
    tau = getattr(found.plant, "time_constant", data.sample_time) / data.sample_time
    moves = _moves(found.valve_position, law.stenman)
    parts = []
    for first, stop in _stretches(moves, data.samples, many):
        part = data.part(first, stop)
        if not part.moves:
            continue
        held = _Held(part, gain, tau, found.plant.dead_time / data.sample_time)
        one = _part(held, law)
        if one is not None:
            span = (found.record.start + data.sample_time * k for k in (first, stop))
            parts.append(_told(one, *span))
    if len(parts) < 2:
        return None
    return _together(tuple(parts))


def _moves(position: FloatArray, stenman: bool) -> FloatArray:
    """1 where the stem starts to move, else 0, shape (N,)."""
    moving = np.diff(position, prepend=position[0]) != 0.0
    if not stenman:
        moving[1:] &= ~moving[:-1].copy()
    counted: FloatArray = moving.astype(np.float64)
    return counted


def _stretches(moves: FloatArray, n: int, many: int) -> list[tuple[int, int]]:
    """The samples (first, stop) of each part; of a long part the stretch with the most moves, if enough are in it."""
    edges = np.round(np.linspace(0, n, many + 1)).astype(np.int64).tolist()
    total = np.concatenate([[0.0], np.cumsum(moves)])
    chosen = []
    for begin, end in itertools.pairwise(edges):
        size = min(SHORT, end - begin)
        while True:
            firsts = np.unique(np.append(np.arange(begin, end - size, max(size // 4, 1)), end - size))
            held = total[firsts + size] - total[firsts]
            if held.max() >= (2 * SLIPS if size < EXACT else SLIPS) or size == end - begin:
                break
            size = min(2 * size, end - begin)
        first = int(firsts[np.argmax(held)])
        chosen.append((first, first + size))
    return chosen


def _starts(data: Centred, stenman: bool) -> FloatArray:
    """Rows (first, sense): where OP exceeds all that was before it in the part, and its first sample."""
    u, firsts, senses = data.u, data.starts.firsts[1:], data.starts.senses[1:]
    if firsts.size > STARTS:
        # Spread over the OP at which they happen: a kick of OP within one sample counts as much as a slow ramp.
        _, kept = np.unique(np.floor(u[firsts] * (STARTS / float(np.ptp(u[firsts])))), return_index=True)
        firsts, senses = firsts[np.sort(kept)], senses[np.sort(kept)]
    rows = [[0.0, 1.0]] if stenman else [[0.0, 1.0], [0.0, -1.0]]
    return np.vstack([rows, np.column_stack([firsts, senses])])


@dataclass(frozen=True, slots=True)
class _Found:
    """A part's band with its 95 % range, and each way by itself, %."""

    band: float
    interval: tuple[float, float]
    up: float
    down: float
    slips: int


def _part(held: _Held, law: _Law) -> _Found | None:
    """The band of one part, alike both ways and then each way by itself; None where too few slips are in it."""
    starts = _starts(held.data, law.stenman)
    near = starts
    band, bands, costs = law.band, np.empty(0), np.empty(0)
    for reach in REACHES:
        tried = np.linspace(1.0 - reach, 1.0 + reach, STEPS) * band
        cost, found = held.scan(near, law.rows(tried))
        i = int(np.argmin(cost))
        if not math.isfinite(cost[i]) or (costs.size and cost[i] > costs.min()):
            bands, costs = np.append(bands, tried), np.append(costs, cost)
            continue
        band, best = float(tried[i]), found[i]
        near = _beside(starts, best)
        bands, costs = np.append(bands, tried), np.append(costs, cost)
    if not np.isfinite(costs).any() or best[2] < FEWEST:
        return None
    data = held.data
    floor = data.samples * data.floor
    effective = held.effective(law.rows(np.array([band]))[0], best)
    most = max(float(costs.min()), floor) * max(math.exp(CHI_SQUARE / effective), 1.0 + COUNTS)
    alike = bands[np.maximum(costs, floor) <= most]
    interval = (float(alike.min()), float(alike.max()))
    up = down = math.nan
    if law.stenman or law.share > 0.0:
        up, down = _each_way(held, law, band, starts, best)
    return _Found(band, interval, up, down, int(best[2]))


def _beside(starts: FloatArray, best: FloatArray) -> FloatArray:
    """The start of a scan's best band and those beside it, the nearest first."""
    order = np.argsort(np.abs(starts[:, 0] - best[0]), kind="stable")[:BESIDE]
    return np.ascontiguousarray(starts[order])


def _each_way(held: _Held, law: _Law, band: float, starts: FloatArray, best: FloatArray) -> tuple[float, float]:
    """The bands upward and downward that fit the part best, from the start that suits it and its neighbours.

    The distance of the two directions, S - J, is held as it was found in the whole record.
    """
    near = _beside(starts, best)[:LIKELY]
    gap = 0.0 if law.stenman else law.band * (1.0 - law.share)
    seeds, met = [(band, band)], np.empty((0, 3))
    for reach, side in zip(REACHES, SIDES, strict=True):
        for about in seeds:
            rows = law.each_way(np.linspace(-reach, reach, side), about)
            cost, _ = held.scan(near, rows)
            met = np.vstack([met, np.column_stack([cost, rows[:, 1:] + gap])])
        met = met[np.argsort(met[:, 0], kind="stable")][:BEST]
        seeds = [(float(row[1]), float(row[2])) for row in met]
    return seeds[0]


def _told(one: _Found, start: float, end: float) -> Part:
    return Part(start, end, one.band, one.interval, one.up, one.down, one.slips)


def _together(parts: tuple[Part, ...]) -> Repeats:
    """Spread, drift and difference of the parts, with ranges by their scatter and by their own ranges, the wider.

    Drift and difference by least squares, each part weighed by its own range and by how closely valves repeat at all.
    """
    n = len(parts)
    bands = np.array([p.band for p in parts])
    own = np.array([0.5 * (p.interval[1] - p.interval[0]) / NORMAL for p in parts])
    weights = 1.0 / (own**2 + (REPEAT * bands.mean()) ** 2)
    difference, difference_interval = None, None
    gaps = np.array([p.up - p.down for p in parts])
    if np.isfinite(gaps).all():
        total = float(weights.sum())
        difference = float(weights @ gaps) / total
        scatter = float(weights @ (gaps - difference) ** 2) / (n - 1)
        half = max(STUDENT[n - 2] * math.sqrt(scatter / total), NORMAL * math.sqrt(2.0 / total))
        difference_interval = (difference - half, difference + half)
    drift, drift_interval = None, None
    if n > 2:
        hours = np.array([0.5 * (p.start + p.end) / 3600.0 for p in parts])
        away = hours - float(weights @ hours) / float(weights.sum())
        power = float(weights @ away**2)
        drift = float((weights * away) @ bands) / power
        left = bands - float(weights @ bands) / float(weights.sum()) - drift * away
        scatter = float(weights @ left**2) / (n - 2)
        half = max(STUDENT[n - 3] * math.sqrt(scatter / power), NORMAL / math.sqrt(power))
        drift_interval = (drift - half, drift + half)
    spread = float(bands.std(ddof=1) / bands.mean())
    return Repeats(parts, spread, drift, drift_interval, difference, difference_interval)


def words_of(found: Repeats) -> tuple[str, ...]:
    """Return in words what of it matters: parts that disagree, a band that drifts, a stem that sticks one way more."""
    said = []
    band, parts = found.band, found.parts
    ways = _sure(found.difference, found.difference_interval, MATTERS * band)
    if ways and found.difference is not None:
        more, less = ("upward", "downward") if found.difference > 0.0 else ("downward", "upward")
        said.append(
            f"the stem sticks more {more} than {less}: OP moves {given(abs(found.difference), 2)} % further before it "
            "follows"
        )
    drifts = _sure(found.drift, found.drift_interval, MATTERS * band / max(_hours(parts), 1e-12))
    if drifts and found.drift is not None:
        way = "grows" if found.drift > 0.0 else "falls"
        first, last = (band + found.drift * side * _hours(parts) for side in (-0.5, 0.5))
        said.append(f"the stiction {way} over the record, from about {given(first, 3)} to {given(last, 3)} %")
    elif not ways and found.spread > MATTERS and _apart(parts):
        # A band alike both ways is no measure of a stem that is not.
        low, high = min(p.band for p in parts), max(p.band for p in parts)
        said.append(
            f"the estimate does not repeat: parts of the record by themselves give {given(low, 3)} to {given(high, 3)} "
            "% with the same process"
        )
    return tuple(said)


def _hours(parts: tuple[Part, ...]) -> float:
    return (parts[-1].end - parts[0].start) / 3600.0


def _sure(value: float | None, interval: tuple[float, float] | None, least: float) -> bool:
    """Whether a value is as large as matters and its range does not hold 0."""
    return value is not None and interval is not None and abs(value) >= least and interval[0] * interval[1] > 0.0


def _apart(parts: tuple[Part, ...]) -> bool:
    """Whether the ranges of some two parts have nothing in common."""
    return max(p.interval[0] for p in parts) > min(p.interval[1] for p in parts)
