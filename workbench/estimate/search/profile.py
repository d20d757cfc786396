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

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Limits, halves_left
from workbench.estimate.fits.sureness import effective_samples
from workbench.estimate.fits.windows import EXACT
from workbench.estimate.search.candidates import (
    EVALUATIONS,
    Candidate,
    again,
    best_per_bin,
    distinct,
    fitted,
    held,
    polished,
    refitted,
)
from workbench.estimate.search.long_record import scan_long
from workbench.estimate.search.stems import COST, FIRST, LOW, scan, silent

__all__ = [
    "CHI_SQUARE",
    "Profile",
    "islands",
    "profile_again",
    "profile_of",
    "search",
]

EACH, SPACED = 40, 1.03  # samples up to which each dead time is tried, then each so much longer than the one before
BINS = 120  # of log d, one output-error fit each
HALF_SLIPS = 5  # in each half of a record, for the halves to be compared
WINNERS = 6  # paths of a long record with a full output-error fit before the search about the best
LIKELIEST = 60  # paths of which the halves of the record choose
ROUGH = 30  # evaluations of a first fit; the best are fitted on
CLOSER_ABOUT, AROUND = 3, 2000  # bands about which every path is looked at, and how many paths in all
REFITS = 60  # and about the best, fewer in a long record
APART = 0.02  # of d, the least gap between ranges of d that counts
CHI_SQUARE = 3.841  # 95 %, one degree of freedom


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


def search(data: Centred, max_delay: float, progress: Callable[[float], None] = silent) -> Profile | None:
    """Return the best stem path and plant, or None where no path fits.

    max_delay: samples, the longest dead time.
    """
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, float(max_delay)))
    delays = _delays(max_delay)
    exact = data.samples <= EXACT
    likely: list[float] = []
    if exact:
        rows = scan(data, delays, lambda share: progress(0.6 * share))
    else:
        rows, likely = scan_long(data, delays, float(max_delay), lambda share: progress(0.6 * share))
    if not rows.size:
        return None
    by_cost = rows[np.argsort(rows[:, COST], kind="stable")]
    return profile_of(data, by_cost, likely, limits, progress=progress)


def _delays(longest: float) -> NDArray[np.int64]:
    """The dead times that each path is scanned at: whole samples, and from `EACH` on as many as tell them apart."""
    last = math.floor(longest + 1e-9)
    beyond = np.geomspace(EACH, max(last, EACH), math.ceil(math.log(max(last / EACH, 1.0)) / math.log(SPACED)) + 1)
    return np.unique(np.concatenate([np.arange(min(last, EACH) + 1), np.round(beyond[1:])])).astype(np.int64)


def profile_of(
    data: Centred,
    by_cost: NDArray[np.float64],
    likely: list[float],
    limits: Limits,
    beside: tuple[Candidate, ...] = (),
    progress: Callable[[float], None] = silent,
) -> Profile:
    """Return the profile of the paths in by_cost by fits in the measure of data's disturbance.

    beside: candidates fitted in another measure, which are fitted again.
    """
    exact = data.samples <= EXACT
    effort = _effort(data)
    chosen = [best_per_bin(by_cost, max(int(BINS * effort), 24)), by_cost[: int(40 * effort) + 4]]
    _, order = np.unique(by_cost[:, FIRST], return_index=True)
    chosen.append(by_cost[np.sort(order)[:12]])
    chosen += [by_cost[np.abs(np.log(by_cost[:, LOW] / d)) < 0.01][:2] for d in likely]
    picked = np.unique(np.vstack(chosen), axis=0)
    fits = fitted(data, picked, limits, evaluations=ROUGH if exact else EVALUATIONS)
    fits = sorted([*fits, *again(data, beside, limits)], key=lambda c: c.fit.sse)
    if not exact:
        fits = refitted(data, fits, limits, WINNERS)
    progress(0.8)
    # Closer around the best few: every path there, judged by the output-error fit.
    done = {(c.first, c.d_low) for c in fits}
    # Half of them about the best: another band may have them all by a lower one-step cost, and be no better for that.
    around, left = np.zeros(len(by_cost), dtype=bool), int(AROUND * effort)
    for i, best in enumerate(distinct(fits, CLOSER_ABOUT), 1):
        there = np.flatnonzero(~around & (np.abs(np.log(by_cost[:, LOW] / best.d_low)) < 0.03))
        there = there[: left // 2 if i < CLOSER_ABOUT else left]
        around[there] = True
        left -= there.size
    near = by_cost[around]
    near = near[[(int(row[FIRST]), float(row[LOW])) not in done for row in near]]
    if near.size:
        fits = sorted([*fits, *fitted(data, near, limits, fits[0].fit, 0)], key=lambda c: c.fit.sse)
    fits = refitted(data, fits, limits, int(REFITS * effort))
    best = polished(data, fits[0] if exact else held(data, fits[0]), limits)
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
    fits = sorted(again(data, (found.best, *ranked), found.limits), key=lambda c: c.fit.sse)
    fits = refitted(data, fits, found.limits, int(REFITS * _effort(data)))
    best = polished(data, fits[0] if found.exact else held(data, fits[0]), found.limits)
    at_limit = best.fit.theta > found.limits.theta[1] - 0.5
    return replace(
        found, best=best, alike=_alike(data, best, fits), fits=_envelope(data, [best, *fits]), at_limit=at_limit
    )


def _effort(data: Centred) -> float:
    """Output-error fits cost some 5 ns x 120 a sample; their number keeps the whole within seconds."""
    return float(np.clip(3000.0 / data.samples, 0.1, 1.0))


def _alike(data: Centred, best: Candidate, fits: list[Candidate]) -> tuple[Candidate, ...]:
    """The paths within the 95 % likelihood region of the best.

    `N_e log(max(V, f)/max(V_best, f)) <= 3.84`, with N_e the samples less what the residuals' autocorrelation takes and
    f the variance that the record can resolve, below which all fits are equally good.
    """
    x = best.stem(data.u)
    n, effective = data.samples, effective_samples(data, x, best.first, best.fit)
    base = max(best.fit.sse / n, data.floor)
    region = [c for c in fits if effective * math.log(max(c.fit.sse / n, data.floor) / base) <= CHI_SQUARE]
    alike = [*region, *_halves(data, fits[:LIKELIEST])]
    if n > EXACT:
        # One path has one range, however often it is among them.
        whole = {(c.first, c.d_high): held(data, c) for c in {(c.first, c.d_high): c for c in alike}.values()}
        alike = list(whole.values())
    return (best, *alike)


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
        costs[i] = halves_left(data, c.stem(data.u), c.first, c.fit)
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
