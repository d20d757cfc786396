"""The search of a long record for paths of a one-parameter stem: windows first, then all of it, closer and closer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Limits, fit_linear
from workbench.estimate.fits.windows import EXACT, windows_of
from workbench.estimate.kernels.walk import at_delays
from workbench.estimate.search.candidates import Candidate, best_per_bin, distinct, fitted, leaves_noise, refitted
from workbench.estimate.search.stems import (
    COST,
    FIRST,
    HIGH,
    LEAST_D,
    LOW,
    WIDE_D,
    firsts_for,
    scan,
    thin,
    walk,
    walk_starts,
)

__all__ = ["rows_beside", "scan_long"]

CLEARLY = 0.8  # of the linear fit's residual: a stem that leaves less in a window narrows the dead times
AGREED = 0.01  # of d: windows that differ by less agree
GLIMPSED = 16  # first slips tried in a window
NARROW = 40  # bands below WIDE_D on the whole of a long record, those above by 1 %
LEAN = 16  # dead times on the whole of a long record
NEAR = 4  # samples about what the windows say
LIKELY = 8  # bands looked at closely there
ABOUT, BESIDE = 0.02, 4e6  # of d, and samples in all: paths about one that part of the record shows


@dataclass(frozen=True, eq=False)
class _Glimpse:
    """What one window of a long record says: its best bands and dead times; clear where the stem beats linear."""

    bands: tuple[float, ...]
    delays: tuple[float, ...]
    clear: bool


def _glimpse(part: Centred, delays: NDArray[np.int64], longest: float) -> _Glimpse | None:
    """Search one window: every path from some starts, and from all where the best of those leaves more than noise."""
    if not part.moves:
        return None
    reach = LEAST_D * part.op_range, 1.0001 * part.op_range
    firsts, shifted = firsts_for(part, part.op_range, GLIMPSED).tolist(), at_delays(part.sums, delays)
    best = _distinct_in(part, np.vstack([walk(part, f, *reach, 0.0, shifted) for f in firsts]), longest)
    if not best or not leaves_noise(part, best[0]):
        # Noise in OP makes stems slip alike after a while, wherever they stood at first; in a quiet cycle they do not.
        best = _apart([*best, *_distinct_in(part, scan(part, delays), longest)])
    if not best:
        return None
    linear = fit_linear(part, longest)
    clear = best[0].fit.sse < CLEARLY * linear.sse and best[0].slips > 1
    return _Glimpse(tuple(c.d_low for c in best), tuple(c.fit.theta for c in best), clear)


def _distinct_in(part: Centred, rows: NDArray[np.float64], longest: float) -> list[Candidate]:
    """The best few bands of a window's rows, told apart by output-error fits, as noise misleads one step."""
    if not rows.size:
        return []
    by_cost = rows[np.argsort(rows[:, COST], kind="stable")]
    limits = Limits((LEAST_TAU, float(part.samples)), (0.0, longest))
    picked = np.unique(np.vstack([best_per_bin(by_cost, 30), by_cost[:20]]), axis=0)
    fits = fitted(part, picked, limits)
    near = by_cost[np.abs(np.log(by_cost[:, LOW] / fits[0].d_low)) < 0.03]
    fits = refitted(
        part, sorted([*fits, *fitted(part, near, limits, fits[0].fit, 0)], key=lambda c: c.fit.sse), limits, 8
    )
    return _apart(fits)


def _apart(fits: list[Candidate]) -> list[Candidate]:
    """The best few bands of some fits."""
    return distinct(sorted((c for c in fits if c.fit.gain != 0.0), key=lambda c: c.fit.sse), 3)


def _glimpses(
    data: Centred, delays: NDArray[np.int64], longest: float, progress: Callable[[float], None]
) -> list[_Glimpse]:
    """What the most active windows and the head say; no more of them once two in which the stem is clear agree."""
    windows = list(dict.fromkeys([*windows_of(data), (0, EXACT)]))
    seen: list[tuple[int, _Glimpse]] = []
    for i, window in enumerate(windows):
        if (one := _glimpse(data.part(*window), delays, longest)) is not None:
            agrees = any(
                one.clear
                and other.clear
                # Two windows of nearly the same samples say the same, right or wrong.
                and abs(window[0] - begin) >= EXACT // 2
                and abs(math.log(one.bands[0] / other.bands[0])) < AGREED
                and abs(one.delays[0] - other.delays[0]) < 1.0
                for begin, other in seen
            )
            seen.append((window[0], one))
            if agrees:
                break
        progress((i + 1) / len(windows))
    return [one for _, one in seen]


def scan_long(
    data: Centred, delays: NDArray[np.int64], longest: float, progress: Callable[[float], None]
) -> tuple[NDArray[np.float64], list[float]]:
    """Return rows as `scan` and the likely d of a long record: from its most active windows, then the whole.

    On the whole record d is stepped by 1 %, and more and more closely about the likely d, from every first slip that
    such a band allows. Dead times are narrowed only by windows in which the stem clearly beats the linear loop.
    """
    glimpses = _glimpses(data, delays, longest, lambda share: progress(0.5 * share))
    clear = [g for g in glimpses if g.clear]
    searched = delays
    if clear:
        low, high = min(g.delays[0] for g in clear) - NEAR, max(g.delays[0] for g in clear) + NEAR
        # Long dead times lie further apart than that: those on either side of it then.
        within = delays[(delays >= low) & (delays <= high)]
        searched = within if within.size else delays[max(int(np.searchsorted(delays, low)) - 1, 0) :][:2]
    lean = at_delays(data.sums, thin(searched, LEAN))
    likely = [d for g in clear for d in g.bands[:2]] + [g.bands[0] for g in glimpses if not g.clear]
    # Some paths over every d, for what no window is long enough to show; narrow bands slip often in each of them.
    span = data.op_range
    narrow = np.geomspace(LEAST_D, WIDE_D, NARROW, endpoint=False)
    wide = np.geomspace(WIDE_D, 1.0, math.ceil(math.log(1.0 / WIDE_D) / 0.01), endpoint=False)
    firsts = thin(firsts_for(data, span, 40), 8)
    found = [walk_starts(data, firsts, span * np.concatenate([narrow, wide]), lean)]
    progress(0.7)
    order = np.argsort(found[0][:, COST], kind="stable")
    likely += found[0][order[:400], LOW].tolist()
    centres: list[float] = []
    for d in likely:
        if len(centres) < LIKELY and all(abs(math.log(d / c)) > 0.01 for c in centres):
            centres.append(d)
    paths = math.ceil(max(4e5 / data.samples, 4.0))
    for d in centres:
        firsts = firsts_for(data, 1.01 * d, 100)
        found.append(walk_starts(data, firsts, d * np.linspace(0.995, 1.005, paths), lean))
    rows = np.vstack(found)
    progress(0.8)
    # Closer and closer: the best of every likely band over 2 %, then every path about the best.
    for d in centres:
        near = rows[np.abs(np.log(rows[:, LOW] / d)) < 0.01]
        if near.size:
            row = near[np.argmin(near[:, COST])]
            step = 0.04 / max(1e7 / data.samples, 100.0)
            found.append(walk(data, int(row[FIRST]), 0.98 * row[LOW], 1.02 * row[LOW], step, lean))
    rows = np.vstack(found)
    progress(0.9)
    # The best bands from every first slip again, as a band that is right to four digits may still have started wrongly.
    paths = math.ceil(min(max(1e6 / data.samples, 12.0), 100.0))
    bands: list[float] = []
    for d in rows[np.argsort(rows[:, COST], kind="stable")][:1000, LOW].tolist():
        if len(bands) < 2 and all(abs(d / b - 1.0) > 2e-3 for b in bands):
            bands.append(d)
            firsts = firsts_for(data, 1.01 * d, 150)
            found.append(walk_starts(data, firsts, d * np.linspace(0.9995, 1.0005, paths), lean))
    rows = np.vstack(found)
    done: list[tuple[float, float]] = []
    for row in rows[np.argsort(rows[:, COST], kind="stable")][:1000]:
        first, d = float(row[FIRST]), float(row[LOW])
        if any(first == f and abs(d / c - 1.0) < 1e-3 for f, c in done):
            continue
        done.append((first, d))
        beside = int(np.searchsorted(data.starts.firsts, int(first)))
        others = data.starts.firsts[max(beside - 4, 0) : beside + 5].tolist()
        found += [walk(data, other, 0.9995 * d, 1.0005 * d, 0.0, lean) for other in others]
        if len(done) == 4:
            break
    progress(1.0)
    return _each_once(np.vstack(found)), centres


def _each_once(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of which each path, known by its start and the band at which it ends, is kept once, from where it begins."""
    rows = rows[np.lexsort((rows[:, LOW], rows[:, HIGH], rows[:, FIRST]))]
    ends = rows[:, [FIRST, HIGH]]  # a path whose stem never moves again ends at no band: inf
    new = np.concatenate([[True], (ends[1:] != ends[:-1]).any(axis=1)])
    kept: NDArray[np.float64] = rows[new[: len(rows)]]
    return kept


def rows_beside(data: Centred, rows: NDArray[np.float64], seen: Candidate) -> NDArray[np.float64]:
    """Return rows as `scan_long` and those close about a path that part of the record shows, the lowest cost first."""
    lean = at_delays(data.sums, np.unique(np.maximum(round(seen.fit.theta) + np.arange(-NEAR, NEAR + 1), 0)))
    paths = math.ceil(min(max(BESIDE / data.samples, 20.0), 200.0))
    about = walk_starts(
        data, firsts_for(data, (1.0 + ABOUT) * seen.d, 60), seen.d * np.linspace(1.0 - ABOUT, 1.0 + ABOUT, paths), lean
    )
    found = _each_once(np.vstack([rows, about]))
    by_cost: NDArray[np.float64] = found[np.argsort(found[:, COST], kind="stable")]
    return by_cost
