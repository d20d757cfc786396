"""The global profile over (d, first slip, dead time) of a one-parameter (Stenman) valve.

The stem path depends on OP alone, and only finitely many paths exist: one holds for every d from the largest |u - x| it
rests at up to the smallest slip it makes, so that walking upward the next breakpoint is that slip. The stem before its
first visible slip is an unknown constant; the first slip lies where OP first leaves a band, at a prefix record high or
low. Each path is scored by one-step least squares at every dead time, and the best ones by an output-error fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.data import Centred, integers
from workbench.estimate.fit import (
    LEAST_TAU,
    Fit,
    Limits,
    effective_samples,
    fit_linear,
    fit_path,
    fit_stems,
    predict,
    start_range,
)
from workbench.estimate.stems import (
    COST,
    DELAY,
    FIRST,
    HIGH,
    LEAST_D,
    LOW,
    first_slips,
    firsts_for,
    path_of,
    scan,
    thin,
    walk,
)

__all__ = [
    "CHI_SQUARE",
    "EXACT",
    "Candidate",
    "Profile",
    "active_windows",
    "islands",
    "profile_again",
    "profile_of",
    "search",
]

# Exact enumeration up to this many samples; longer records are first searched in their most active windows of this
# length.
EXACT = 1500
BINS = 120  # of log d, one output-error fit each
HALF_SLIPS = 5  # in each half of a record, for the halves to be compared
WINDOWS = 3  # most active windows of a long record, beside its head
CLEARLY = 0.8  # of the linear fit's residual: a stem that leaves less in a window narrows the dead times
LEAN = 16  # dead times on the whole of a long record
LIKELY = 8  # bands looked at closely there
WINNERS = 6  # paths of a long record with a full output-error fit before the search about the best
LIKELIEST = 60  # paths of which the halves of the record choose
ROUGH = 30  # evaluations of a first fit; the best are fitted on
REFITS = 60  # and about the best, fewer in a long record
APART = 0.02  # of d, the least gap between ranges of d that counts
CHI_SQUARE = 3.841  # 95 %, one degree of freedom


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
    """The search's result: the best path; those the data cannot tell from it; best fits along d; what was searched.

    rows: every path met, (first, d_low, d_high, dead time, one-step cost, slips), the lowest cost first; likely: bands
    that windows of a long record prefer.
    """

    best: Candidate
    alike: tuple[Candidate, ...]
    fits: tuple[Candidate, ...]
    rows: NDArray[np.float64]
    likely: tuple[float, ...]
    exact: bool
    limits: Limits
    at_limit: bool


@dataclass(frozen=True, eq=False)
class _Glimpse:
    """What one window of a long record says: its best bands and dead times; clear where the stem beats linear."""

    bands: tuple[float, ...]
    delays: tuple[float, ...]
    clear: bool


def _windows(data: Centred, *, head: bool = True) -> list[tuple[int, int]]:
    """The head, if asked for, and the most active stretches, (first, stop): where OP ranges and PV varies the most."""
    n = data.samples
    size = min(EXACT, n)
    begins = np.unique(np.minimum(np.arange(0, n, size // 2), n - size)).tolist()
    spread = math.sqrt(data.variance)
    activity = [
        float(np.ptp(data.u[b : b + size])) / data.op_range + float(np.std(data.y[b : b + size])) / spread
        for b in begins
    ]
    chosen: list[int] = []
    for i in np.argsort(activity, kind="stable")[::-1].tolist():
        if all(abs(begins[i] - b) >= size for b in chosen):
            chosen.append(begins[i])
        if len(chosen) == WINDOWS:
            break
    return [(b, b + size) for b in sorted({0, *chosen} if head else chosen)]


def active_windows(data: Centred) -> list[Centred]:
    """Return the most active stretches of a long record in which both signals move."""
    parts = [data.part(*window) for window in _windows(data, head=False)]
    return [part for part in parts if part.op_range > 0.0 and float(np.ptp(part.y)) > 0.0]


def _glimpse(
    part: Centred, delays: NDArray[np.int64], longest: float, progress: Callable[[float], None]
) -> _Glimpse | None:
    """Search one window exactly; its best paths are told apart by output-error fits, as noise misleads one step."""
    if not part.op_range > 0.0 or not float(np.ptp(part.y)) > 0.0:
        return None
    rows = scan(part, delays, progress)
    if not rows.size:
        return None
    by_cost = rows[np.argsort(rows[:, COST], kind="stable")]
    limits = Limits((LEAST_TAU, float(part.samples)), (0.0, longest))
    picked = np.unique(np.vstack([_best_per_bin(by_cost, 30), by_cost[:20]]), axis=0)
    fits = _fitted(part, picked, limits)
    near = by_cost[np.abs(np.log(by_cost[:, LOW] / fits[0].d_low)) < 0.03]
    fits = _refitted(
        part, sorted([*fits, *_fitted(part, near, limits, fits[0].fit, 0)], key=lambda c: c.fit.sse), limits, 8
    )
    best = _distinct([c for c in fits if c.fit.gain != 0.0], 3)
    if not best:
        return None
    linear = fit_linear(part, longest)
    clear = best[0].fit.sse < CLEARLY * linear.sse and best[0].slips > 1
    return _Glimpse(tuple(c.d_low for c in best), tuple(c.fit.theta for c in best), clear)


def _scan_long(
    data: Centred, delays: NDArray[np.int64], longest: float, progress: Callable[[float], None]
) -> tuple[NDArray[np.float64], list[float]]:
    """As `_scan`, for long records: likely d from the most active windows, then the whole record; and the likely d.

    On the whole record d is stepped by 1 %, and more and more closely about the likely d, from every first slip that
    such a band allows. Dead times are narrowed only by windows in which the stem clearly beats the linear loop.
    """
    windows = _windows(data)
    glimpses = []
    for i, (begin, stop) in enumerate(windows):
        seen = _glimpse(data.part(begin, stop), delays, longest, _silent)
        glimpses += [] if seen is None else [seen]
        progress(0.5 * (i + 1) / len(windows))
    clear = [g for g in glimpses if g.clear]
    lean = delays
    if clear:
        low, high = min(g.delays[0] for g in clear) - 4, max(g.delays[0] for g in clear) + 4
        lean = delays[(delays >= low) & (delays <= high)]
    lean = thin(lean, LEAN)
    likely = [d for g in clear for d in g.bands[:2]] + [g.bands[0] for g in glimpses if not g.clear]
    # Some paths over every d, for what no window is long enough to show.
    found = [
        walk(data, first, LEAST_D * data.op_range, data.op_range, 0.01, lean)
        for first in thin(firsts_for(data.u, data.op_range, 40), 8).tolist()
    ]
    rows = np.vstack(found)
    progress(0.7)
    order = np.argsort(rows[:, COST], kind="stable")
    likely += [float(rows[i, LOW]) for i in order[:400].tolist()]
    centres: list[float] = []
    for d in likely:
        if len(centres) < LIKELY and all(abs(math.log(d / c)) > 0.01 for c in centres):
            centres.append(d)
    paths = max(4e5 / data.samples, 4.0)
    for d in centres:
        firsts = firsts_for(data.u, 1.01 * d, 100).tolist()
        found += [walk(data, first, 0.995 * d, 1.005 * d, 0.01 / paths, lean) for first in firsts]
    rows = np.vstack(found)
    progress(0.8)
    # Closer and closer: the best of every likely band over 2 %, then every path about the best.
    all_firsts = first_slips(data.u)
    for d in centres:
        near = rows[np.abs(np.log(rows[:, LOW] / d)) < 0.01]
        if near.size:
            row = near[np.argmin(near[:, COST])]
            step = 0.04 / max(1e7 / data.samples, 100.0)
            found.append(walk(data, int(row[FIRST]), 0.98 * row[LOW], 1.02 * row[LOW], step, lean))
    rows = np.vstack(found)
    progress(0.9)
    # The best bands from every first slip again, as a band that is right to four digits may still have started wrongly.
    paths = min(max(1e6 / data.samples, 12.0), 100.0)
    bands: list[float] = []
    for d in rows[np.argsort(rows[:, COST], kind="stable")][:1000, LOW].tolist():
        if len(bands) < 2 and all(abs(d / b - 1.0) > 2e-3 for b in bands):
            bands.append(d)
            firsts = firsts_for(data.u, 1.01 * d, 150).tolist()
            found += [walk(data, first, 0.9995 * d, 1.0005 * d, 1e-3 / paths, lean) for first in firsts]
    rows = np.vstack(found)
    done: list[tuple[float, float]] = []
    for row in rows[np.argsort(rows[:, COST], kind="stable")][:1000]:
        first, d = float(row[FIRST]), float(row[LOW])
        if any(first == f and abs(d / c - 1.0) < 1e-3 for f, c in done):
            continue
        done.append((first, d))
        beside = int(np.searchsorted(all_firsts, int(first)))
        others = all_firsts[max(beside - 4, 0) : beside + 5].tolist()
        found += [walk(data, other, 0.9995 * d, 1.0005 * d, 0.0, lean) for other in others]
        if len(done) == 4:
            break
    rows = np.vstack(found)
    progress(1.0)
    return rows, centres


def _silent(share: float) -> None:
    """Ignore the progress."""


def _fitted(
    data: Centred, rows: NDArray[np.float64], limits: Limits, like: Fit | None = None, evaluations: int = 120
) -> list[Candidate]:
    """Output-error fits of rows, the best first; started from `like`, or from a coarse list and the row's delay."""
    paths = rows[:, [FIRST, LOW, HIGH, DELAY]]
    if like is not None:
        paths[:, 3] = like.theta
    tau = math.nan if like is None else like.tau
    fits = fit_stems(data, paths, limits, tau=tau, evaluations=evaluations)
    found = [
        Candidate(int(row[FIRST]), float(row[LOW]), float(row[HIGH]), slips, fit)
        for row, (fit, slips) in zip(rows, fits, strict=True)
    ]
    return sorted(found, key=lambda c: c.fit.sse)


def _refitted(data: Centred, found: list[Candidate], limits: Limits, most: int) -> list[Candidate]:
    """The candidates, best first, of which the `most` best are fitted on from their own plant."""
    better = [
        Candidate(c.first, c.d_low, c.d_high, c.slips, min(c.fit, fit, key=lambda f: f.sse))
        for c in found[:most]
        for fit, _ in fit_stems(
            data, np.array([[c.first, c.d_low, c.d_high, c.fit.theta]]), limits, tau=c.fit.tau, evaluations=80
        )
    ]
    return sorted([*better, *found[most:]], key=lambda c: c.fit.sse)


def search(data: Centred, max_delay: float, progress: Callable[[float], None]) -> Profile | None:
    """Return the best stem path and plant, or None where no path fits.

    max_delay: samples, the longest dead time.
    """
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, float(max_delay)))
    delays = integers(np.arange(math.floor(max_delay + 1e-9) + 1))
    exact = data.samples <= EXACT
    likely: list[float] = []
    if exact:
        rows = scan(data, delays, lambda share: progress(0.6 * share))
    else:
        rows, likely = _scan_long(data, delays, float(max_delay), lambda share: progress(0.6 * share))
    if not rows.size:
        return None
    by_cost = rows[np.argsort(rows[:, COST], kind="stable")]
    return profile_of(data, by_cost, likely, limits, progress)


def profile_of(
    data: Centred,
    by_cost: NDArray[np.float64],
    likely: list[float],
    limits: Limits,
    progress: Callable[[float], None],
    beside: tuple[Candidate, ...] = (),
) -> Profile:
    """Return the profile of the paths in by_cost by fits in the measure of data's disturbance.

    beside: candidates fitted in another measure, which are fitted again.
    """
    exact = data.samples <= EXACT
    effort = _effort(data)
    chosen = [_best_per_bin(by_cost, max(int(BINS * effort), 24)), by_cost[: int(40 * effort) + 4]]
    _, order = np.unique(by_cost[:, FIRST], return_index=True)
    chosen.append(by_cost[np.sort(order)[:12]])
    chosen += [by_cost[np.abs(np.log(by_cost[:, LOW] / d)) < 0.01][:2] for d in likely]
    picked = np.unique(np.vstack(chosen), axis=0)
    fits = _fitted(data, picked, limits, evaluations=ROUGH if exact else 12)
    fits = sorted([*fits, *_again(data, beside, limits)], key=lambda c: c.fit.sse)
    if not exact:
        fits = _refitted(data, fits, limits, WINNERS)
    progress(0.8)
    # Closer around the best few: every path there, judged by the output-error fit.
    done = {(c.first, c.d_low) for c in fits}
    around = np.zeros(len(by_cost), dtype=bool)
    for best in _distinct(fits, 3):
        around |= np.abs(np.log(by_cost[:, LOW] / best.d_low)) < 0.03
    near = by_cost[around][: int(2000 * effort)]
    near = near[[(int(row[FIRST]), float(row[LOW])) not in done for row in near]]
    if near.size:
        fits = sorted([*fits, *_fitted(data, near, limits, fits[0].fit, 0)], key=lambda c: c.fit.sse)
    fits = _refitted(data, fits, limits, int(REFITS * effort))
    best = _polished(data, fits[0], limits)
    progress(1.0)
    at_limit = best.fit.theta > limits.theta[1] - 0.5
    return Profile(
        best=best,
        alike=_alike(data, best, fits),
        fits=_envelope(data, [best, *fits]),
        rows=by_cost,
        likely=tuple(likely),
        exact=exact,
        limits=limits,
        at_limit=at_limit,
    )


def profile_again(data: Centred, found: Profile) -> Profile:
    """Return a profile in a measure that differs little: its likeliest paths fitted on from their own plants."""
    ranked = sorted(found.fits, key=lambda c: c.fit.sse)
    fits = sorted(_again(data, (found.best, *ranked), found.limits), key=lambda c: c.fit.sse)
    fits = _refitted(data, fits, found.limits, int(REFITS * _effort(data)))
    best = _polished(data, fits[0], found.limits)
    at_limit = best.fit.theta > found.limits.theta[1] - 0.5
    return replace(
        found, best=best, alike=_alike(data, best, fits), fits=_envelope(data, [best, *fits]), at_limit=at_limit
    )


def _effort(data: Centred) -> float:
    """Output-error fits cost some 5 ns x 120 a sample; their number keeps the whole within seconds."""
    return float(np.clip(3000.0 / data.samples, 0.1, 1.0))


def _again(data: Centred, found: tuple[Candidate, ...], limits: Limits) -> list[Candidate]:
    """The candidates at their own plants in another measure, unsorted."""
    return [
        Candidate(c.first, c.d_low, c.d_high, c.slips, fit)
        for c in found
        for fit, _ in fit_stems(
            data,
            np.array([[c.first, c.d_low, c.d_high, c.fit.theta]]),
            limits,
            tau=c.fit.tau,
            evaluations=0,
        )
    ]


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
    n, effective = data.samples, effective_samples(data, x, best.first, best.fit)
    base = max(best.fit.sse / n, data.floor)
    region = [c for c in fits if effective * math.log(max(c.fit.sse / n, data.floor) / base) <= CHI_SQUARE]
    return (best, *region, *_halves(data, fits[:LIKELIEST]))


def islands(found: Profile) -> tuple[tuple[float, float], ...]:
    """The ranges of d, %, whose paths are alike the best, ascending; apart where paths between them fit worse."""
    kept: list[tuple[float, float]] = []
    between = np.array([c.d_low for c in found.fits])
    for low, high in sorted((c.d_low, c.d_high) for c in found.alike):
        if kept:
            top = kept[-1][1]
            worse = ((between >= top) & (between < low)).any()
            if not worse or low - top <= APART * low:
                kept[-1] = (kept[-1][0], max(top, high))
                continue
        kept.append((low, high))
    return tuple(kept)


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
        squares = data.innovations(predict(data, x, c.first, c.fit)[0]) ** 2
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
