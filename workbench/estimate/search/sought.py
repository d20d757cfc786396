"""Where two-parameter stems are searched: all of a record, or a long one's liveliest windows and all of it thinned."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits
from workbench.estimate.fits.windows import EXACT, WHOLE, active_windows
from workbench.estimate.search.nearer import search_short
from workbench.estimate.search.profile import HALF_SLIPS, Profile
from workbench.estimate.search.two_parameter import SEEDS, Band, Seed, best_of, best_start, fit_band, look, seen_thinned
from workbench.model.record import FloatArray

__all__ = ["HOPELESS", "Seek", "Sought", "Window", "coarse_of", "like_stenman", "on_all", "sought", "window_of"]

ABOUT = (0.8, 1.0, 1.2)  # of d: jumps of the stem that goes on from a one-parameter one
HOPELESS = 3.0  # times what a rival leaves: a stem that leaves more is not looked at closer
AGREED = 0.03, 0.1  # of S: windows of a long record whose S and J differ by less agree
THINNEST = 20  # stretches, each of as many samples as are left, of a record that is seen thinned

Seek = Callable[[Centred, float], list[Band]]


@dataclass(frozen=True, eq=False)
class Window:
    """A long record's window, the best of a grid there (`look`), and all stems that a search from them meets.

    begin: the sample of the record. met: of J as a share of S, None for any; searched when first asked for.
    """

    begin: int
    data: Centred
    coarse: list[Band]
    met: Callable[[float | None], list[Band]]


@dataclass(frozen=True, eq=False)
class Sought:
    """Where stems are searched: in all of a record, or in a long one's most active windows; pv: whose they are, EU.

    contested: whether stems that leave far more of PV than another valve does are of no use. known: whether the grid's
    stems were not looked for, but are known to be close to the best. thinned: what all of the record says thinned,
    where its windows may be too short for a slow loop.
    """

    pv: FloatArray
    whole: bool
    windows: tuple[Window, ...]
    contested: bool
    known: bool
    thinned: tuple[Seed, ...] = ()

    def rival(self, other: Fit | None) -> float:
        """What another valve's fit leaves where it is a rival, EU^2; infinite where it is none."""
        return other.sse if self.contested and other is not None else math.inf


def sought(data: Centred, longest: float, other: Fit | None, contested: bool, seek: Seek = look) -> Sought:
    """Return where to search, with dead times up to `longest` samples.

    seek: `look`, or the like (`like_stenman`). other: the fit of another valve to the record; where it leaves far less
    than any stem does in the liveliest window, or where two windows agree, neither the next ones are asked nor all of
    the record thinned. A window takes any disturbance as white: what it says is as good in another measure of the same
    PV.
    """
    known = seek is not look
    # What is known closely needs no more than a window to be told apart from.
    none = Sought(data.y, data.samples <= (EXACT if known else WHOLE), (), contested, known)
    windows: list[Window] = []
    settled = none.whole
    for begin, part in () if none.whole else active_windows(data):
        window = window_of(part, min(longest, part.samples / 4.0), seek, begin)
        settled = _hopeless(window, none.rival(other) / data.samples) or any(_agree(window, one) for one in windows)
        windows.append(window)
        if settled:
            break
    thinned = () if settled or known or data.samples > THINNEST * EXACT else tuple(seen_thinned(data, longest))
    return replace(none, windows=tuple(windows), thinned=thinned)


def _hopeless(window: Window, rival: float) -> bool:
    return bool(window.coarse) and all(b.fit.sse / window.data.samples > HOPELESS * rival for b in window.coarse)


def _agree(one: Window, other: Window) -> bool:
    """Whether the best stems of two windows are nearly one."""
    if not one.coarse or not other.coarse:
        return False
    a, b = one.coarse[0], other.coarse[0]
    # A few slips tell no stem from another.
    few = min(a.slips, b.slips) < 2 * HALF_SLIPS
    return not few and abs(math.log(a.S / b.S)) <= AGREED[0] and abs(a.J - b.J) <= AGREED[1] * a.S


def window_of(part: Centred, longest: float, seek: Seek = look, begin: int = 0) -> Window:
    """Return a part of a record, which begins at a sample of it, as a window, with dead times up to `longest` samples.

    seek: as in `sought`.
    """
    limits, coarse = Limits((LEAST_TAU, float(part.samples)), (0.0, longest)), seek(part, longest)
    known = seek is not look
    return Window(
        begin, part, coarse, cache(lambda only: search_short(part, coarse, only, limits, (), known and only is None)[0])
    )


def coarse_of(data: Centred, within: Sought, longest: float, seek: Seek = look) -> list[Band]:
    """Return the best stems of a grid, the best first: of a long record those of its windows, fitted to the whole."""
    if within.whole:
        return seek(data, longest)
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
    seeds = [(b.S, b.J, b.fit.tau, b.fit.theta) for window in within.windows for b in window.coarse[:SEEDS]]
    found = [
        fit_band(data, S, J, (-1, 0.0), limits, (tau, theta), 20, 1e-4)
        for S, J, tau, theta in (*seeds, *within.thinned)
    ]
    return sorted((b for b in found if b.slips > 0 and b.fit.gain != 0.0), key=lambda b: b.fit.sse)


def on_all(data: Centred, seed: Seed, limits: Limits) -> Band:
    """Return a stem found in part of a long record, or in it thinned, fitted to all of it from the start that suits."""
    S, J, tau, theta = seed
    return fit_band(data, S, J, best_start(data, (S, J), (tau, theta))[1:], limits, (tau, theta), 40)


def like_stenman(found: Profile | None, data: Centred, longest: float) -> list[Band]:
    """Return the two-parameter stem nearest to the best one-parameter one, S = d and J about d, or none.

    Between reversals of OP the two go alike, and a grid over S and J, with few plants, may miss what d tells. longest:
    samples, the longest dead time.
    """
    if found is None or found.best.fit.gain == 0.0:
        return []
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
    d, plant = found.best.d, (found.best.fit.tau, found.best.fit.theta)
    start = best_start(data, (d, d), plant)[1:]
    best = best_of([fit_band(data, d, share * d, start, limits, plant, 40) for share in ABOUT])
    return [best] if best.slips > 0 and best.fit.gain != 0.0 else []
