"""The global profile over (d, first slip, dead time) of a one-parameter (Stenman) valve.

The stem path depends on OP alone, and only finitely many paths exist: one holds for every d from the largest |u - x| it
rests at up to the smallest slip it makes, so that walking upward the next breakpoint is that slip. The stem before its
first visible slip is an unknown constant; the first slip lies where OP first leaves a band, at a prefix record high or
low. Each path is scored by one-step least squares at every dead time, and the best ones by an output-error fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.estimate import kernel
from workbench.estimate.data import Centred, integers
from workbench.estimate.fit import LEAST_TAU, Fit, Limits, fit_path, inflation, predict, start_range

__all__ = ["Candidate", "Profile", "first_slips", "path_of", "search"]

# Exact enumeration up to this many samples; longer records are first searched on their head of this length.
EXACT = 1500
STARTS = 48  # first slips scanned in the first round
BINS = 120  # of log d, one output-error fit each
MOST_STARTS = 400  # and in the second, at wider bands
WIDE_D = 0.08  # of OP's range
LEAST_D = 0.005  # of OP's range: below it a stem is OP
HALF_SLIPS = 5  # in each half of a record, for the halves to be compared
CHI_SQUARE = 3.841  # 95 %, one degree of freedom

FIRST, LOW, HIGH, DELAY, COST, SLIPS = range(6)


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
        """The middle of the range, %."""
        return 0.5 * (self.d_low + self.d_high)


@dataclass(frozen=True, eq=False)
class Profile:
    """The search's result: the best path; those the data cannot tell from it; best fits along d; what was searched."""

    best: Candidate
    alike: tuple[Candidate, ...]
    fits: tuple[Candidate, ...]
    paths: int
    exact: bool
    limits: Limits
    at_limit: bool


def first_slips(u: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the samples at which the stem may first slip: 0, and where OP exceeds all that was before it."""
    highs = np.maximum.accumulate(u)
    lows = np.minimum.accumulate(u)
    new = np.flatnonzero((u[1:] > highs[:-1]) | (u[1:] < lows[:-1])) + 1
    return integers(np.concatenate([[0], new]))


def path_of(u: NDArray[np.float64], d: float, first: int) -> tuple[NDArray[np.float64], int]:
    """Return (stem path, number of slips): shape (N,), 0 before `first`, where the stem is unknown."""
    at = np.empty(u.size, np.int64)
    count, _ = kernel.stem_slips(u, d, first, at)
    x = np.zeros(u.size)
    x[first:] = np.repeat(u[at[:count]], np.diff(np.append(at[:count], u.size)))
    return x, count


def _walk(
    data: Centred, first: int, d_from: float, d_to: float, step: float, delays: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Rows (FIRST, LOW, HIGH, DELAY, COST, SLIPS) of the paths from `first` with d in [d_from, d_to)."""
    least = d_from
    if first > 0:
        # The stem held before `first`, so that OP had stayed within a band of 2 d.
        least = max(d_from, 0.5 * float(np.ptp(data.u[:first])))
    if least >= d_to:
        return np.empty((0, 6))
    buffer = np.empty((4 * data.samples + 1000, kernel.ROW))
    pole = 1.0 if data.integrating else math.nan
    count = kernel.walk(
        data.y,
        data.sums,
        data.squares,
        data.products,
        data.u,
        first,
        least,
        d_to,
        step,
        delays,
        pole,
        data.sign,
        buffer,
    )
    return np.column_stack([np.full(count, float(first)), buffer[:count]])


def _thin(firsts: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    if firsts.size <= most:
        return firsts
    return firsts[np.unique(np.round(np.linspace(0, firsts.size - 1, most)).astype(np.int64))]


def _scan(data: Centred, delays: NDArray[np.int64], progress: Callable[[float], None]) -> NDArray[np.float64]:
    """All paths over all first slips (the likely ones first, then those beside the best), at every delay."""
    d_from, d_to = LEAST_D * data.op_range, 1.0001 * data.op_range
    firsts = first_slips(data.u)
    chosen = _thin(firsts, STARTS)
    found = []
    for i, first in enumerate(chosen.tolist()):
        found.append(_walk(data, first, d_from, d_to, 0.0, delays))
        progress((i + 1) / chosen.size)
    rows = np.vstack(found)
    if rows.size == 0 or chosen.size == firsts.size:
        return rows
    # Every other first slip as well, at bands where a late first slip can matter: small ones slip early.
    rest = np.setdiff1d(firsts, chosen)
    beside = [_walk(data, f, WIDE_D * data.op_range, d_to, 0.0, delays) for f in _thin(rest, MOST_STARTS).tolist()]
    return np.vstack([rows, *beside])


def _scan_long(data: Centred, delays: NDArray[np.int64], progress: Callable[[float], None]) -> NDArray[np.float64]:
    """As `_scan`, for long records: first slips and likely d from the head, then the whole record.

    On the whole record d is stepped by 0.3 %, and every path is met within 2 % of the likely d.
    """
    window = EXACT
    head = np.empty((0, 6))
    while window < 2 * data.samples and not head.size:
        head = _scan(data.head(min(window, data.samples)), delays, progress)
        window *= 2
    if not head.size:
        return head
    head = head[np.argsort(head[:, COST])]
    _, order = np.unique(head[:, FIRST], return_index=True)
    starts = head[np.sort(order)[:5]]
    middle = int(np.median(starts[:, DELAY]))
    span = delays[(delays >= min(starts[:, DELAY]) - 3) & (delays <= max(starts[:, DELAY]) + 3)]
    lean = span if span.size <= 16 else span[np.argsort(np.abs(span - middle))[:16]]
    lean = np.sort(lean)
    coarse, likely = [], []
    for row in starts:
        first = int(row[FIRST])
        coarse.append(_walk(data, first, LEAST_D * data.op_range, data.op_range, 0.003, lean))
        likely.append((first, float(row[LOW])))
    rows = np.vstack(coarse)
    best = rows[np.argsort(rows[:, COST])[:6]]
    likely = likely[:2] + [(int(r[FIRST]), float(r[LOW])) for r in best]
    fine, done = [], np.empty((0, 2))
    for first, d in likely:
        seen = done[(done[:, 0] == first)]
        if seen.size and (np.abs(seen[:, 1] / d - 1.0) < 0.015).any():
            continue
        done = np.vstack([done, [first, d]])
        paths = _walk(data, first, 0.98 * d, 1.02 * d, 2.0 * 1.02 * 0.02 / max(2e7 / data.samples, 100.0), lean)
        fine.append(paths)
    return np.vstack([rows, *fine])


def _fitted(data: Centred, row: NDArray[np.float64], limits: Limits, like: Fit | None = None) -> Candidate:
    first = int(row[FIRST])
    x, slips = path_of(data.u, float(row[LOW]), first)
    bounds = start_range(data.u, first, float(row[LOW]), float(row[HIGH]))
    fits = [fit_path(data, x, first, bounds, limits, float(row[DELAY]))]
    if like is not None:
        fits.append(fit_path(data, x, first, bounds, limits, like.theta, tau=like.tau))
    return Candidate(first, float(row[LOW]), float(row[HIGH]), slips, min(fits, key=lambda f: f.sse))


def search(data: Centred, max_delay: int, progress: Callable[[float], None]) -> Profile | None:
    """Return the best stem path and plant, or None where no path fits.

    max_delay: samples.
    """
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, float(max(max_delay, 1))))
    delays = integers(np.arange(max_delay + 1))
    exact = data.samples <= EXACT
    rows = (_scan if exact else _scan_long)(data, delays, lambda share: progress(0.6 * share))
    if not rows.size:
        return None
    by_cost = rows[np.argsort(rows[:, COST], kind="stable")]
    # Output-error fits cost some 5 ns x 120 a sample; their number keeps the whole within seconds.
    effort = float(np.clip(3000.0 / data.samples, 0.1, 1.0))
    chosen = [_best_per_bin(by_cost, max(int(BINS * effort), 24)), by_cost[: int(40 * effort) + 4]]
    _, order = np.unique(by_cost[:, FIRST], return_index=True)
    chosen.append(by_cost[np.sort(order)[:12]])
    picked = np.unique(np.vstack(chosen), axis=0)
    fits = [_fitted(data, row, limits) for row in picked]
    progress(0.8)
    fits.sort(key=lambda c: c.fit.sse)
    # Closer around the best few: every path there, judged by the output-error fit.
    done = {(c.first, c.d_low) for c in fits}
    around = np.zeros(len(by_cost), dtype=bool)
    for best in _distinct(fits, 3):
        around |= np.abs(np.log(by_cost[:, LOW] / best.d_low)) < 0.03
    near = by_cost[around][: int(400 * effort) + 20]
    like = fits[0].fit
    fits += [_fitted(data, row, limits, like) for row in near if (int(row[FIRST]), float(row[LOW])) not in done]
    fits.sort(key=lambda c: c.fit.sse)
    best = _polished(data, fits[0], limits)
    progress(1.0)
    at_limit = best.fit.theta > limits.theta[1] - 0.5
    return Profile(best, _alike(data, best, fits), _envelope(data, [best, *fits]), len(rows), exact, limits, at_limit)


def _best_per_bin(by_cost: NDArray[np.float64], bins: int) -> NDArray[np.float64]:
    low, high = by_cost[:, LOW].min(), by_cost[:, LOW].max()
    edges = np.geomspace(low, high * 1.0001, bins + 1)
    _, first = np.unique(np.digitize(by_cost[:, LOW], edges), return_index=True)
    return by_cost[first]


def _distinct(fits: list[Candidate], most: int) -> list[Candidate]:
    kept: list[Candidate] = []
    for c in fits:
        if all(abs(math.log(c.d_low / k.d_low)) > 0.03 for k in kept):
            kept.append(c)
        if len(kept) == most:
            break
    return kept


def _polished(data: Centred, best: Candidate, limits: Limits) -> Candidate:
    x, slips = path_of(data.u, best.d_low, best.first)
    bounds = start_range(data.u, best.first, best.d_low, best.d_high)
    fits = [
        fit_path(data, x, best.first, bounds, limits, theta, tau=best.fit.tau, evaluations=400, tolerance=1e-12)
        for theta in (best.fit.theta, float(round(best.fit.theta)))
    ]
    return Candidate(best.first, best.d_low, best.d_high, slips, min([best.fit, *fits], key=lambda f: f.sse))


def _alike(data: Centred, best: Candidate, fits: list[Candidate]) -> tuple[Candidate, ...]:
    """The paths within the 95 % likelihood region of the best.

    `N_e log(max(V, f)/max(V_best, f)) <= 3.84`, with N_e the samples less what the residuals' autocorrelation takes and
    f the variance that the record can resolve, below which all fits are equally good.
    """
    x, _ = path_of(data.u, best.d_low, best.first)
    residuals = data.y - predict(data, x, best.first, best.fit)[0]
    n = data.samples
    effective = n / inflation(residuals)
    base = max(best.fit.sse / n, data.floor)
    region = [c for c in fits if effective * math.log(max(c.fit.sse / n, data.floor) / base) <= CHI_SQUARE]
    return (best, *region, *_halves(data, fits))


def _halves(data: Centred, fits: list[Candidate]) -> list[Candidate]:
    """The paths that each half of the record would choose by itself among the likely ones.

    Real valves do not repeat exactly: what the halves disagree on belongs in the range, where the likelihood alone is
    too sure of itself.
    """
    if fits[0].slips < 2 * HALF_SLIPS:
        return []
    half = data.samples // 2
    costs = np.empty((len(fits), 2))
    for i, c in enumerate(fits):
        x, _ = path_of(data.u, c.d_low, c.first)
        squares = (data.y - predict(data, x, c.first, c.fit)[0]) ** 2
        costs[i] = squares[:half].sum(), squares[half:].sum()
    # Below the resolution, one fit is as good as another.
    costs = np.maximum(costs, half * data.floor)
    return [fits[int(i)] for i in np.argmin(costs, axis=0)]


def _envelope(data: Centred, fits: list[Candidate]) -> tuple[Candidate, ...]:
    """The best fits along d: one for each distinct path range, ascending, thinned to the lowest of close neighbours."""
    ordered = sorted(fits, key=lambda c: (c.d_low, c.fit.sse))
    kept: list[Candidate] = []
    for c in ordered:
        if kept and c.d_low - kept[-1].d_low <= 1e-4 * data.op_range:
            if c.fit.sse < kept[-1].fit.sse:
                kept[-1] = c
            continue
        kept.append(c)
    return tuple(sorted(kept, key=lambda c: c.d))
