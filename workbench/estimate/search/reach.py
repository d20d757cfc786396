"""How long the dead times are that are searched: the usual ones, and longer ones where stems explain PV better so.

A short dead time is enough for most loops, and in a steady cycle one that is longer by a period fits as well. A stem
with other parameters may explain a long one after a fashion, with a plant far from the truth: whether there is a long
one must be asked before a close search, over all valves at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from workbench.estimate.fits.data import Centred, integers
from workbench.estimate.fits.sureness import ENOUGH_SLIPS
from workbench.estimate.fits.windows import EXACT, active_windows
from workbench.estimate.kernels.bands import screen_bands
from workbench.estimate.search.candidates import leaves_noise
from workbench.estimate.search.kinks import between_steps
from workbench.estimate.search.profile import Profile, search
from workbench.estimate.search.stems import WIDE_D, silent

__all__ = ["searched"]

BANDS, NARROWEST, WIDEST = 24, 0.04, 0.95  # values of S, of OP's range,
HARDLY = 1e-6  # beside one that OP itself has,
SHARES = (0.0, 0.45, 1.0)  # and of J, of S
TAUS, SHORTEST, LONGEST = 9, 1.0, 3.0  # time constants looked at: how many, samples, records
NEAR, FAR = 1.35, 1.15  # each dead time is so much longer than the one before, within the usual ones and beyond
ROOM = 1.3  # times the dead time that was seen: as far dead times are searched
# Times the usual dead times: of many each is looked at less closely, and where longer ones were seen they do.
DOUBLED = 2.0
CYCLED = 0.5  # of the time between a lag's steps: in a cycle each follows the slip that another, later by more, led to
# Of N log V, "very strong" evidence (R. Kass, A. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795) four times: none of
# the stems compared may be the right one, and what they leave is coloured.
CLEAR = 40.0


class _Seen(NamedTuple):
    """The likeliest dead time beyond the usual ones, samples, and N log V of the best stems within and beyond them."""

    delay: float
    within: float
    beyond: float


def searched(data: Centred, longest: float, most: float, progress: Callable[[float], None]) -> Profile | None:
    """Return what `profile.search` finds with dead times up to `longest`, or with longer ones where these fit better.

    most: the longest at all; samples both. Of a long record it is first asked of its liveliest window and,
    unless that shows a fast loop, of all of it thinned; and where neither shows a stem that leaves noise alone, nor a
    dead time beyond twice the usual ones, how far PV's steps are apart.
    """
    if data.samples <= EXACT:
        return _searched(data, longest, most, _seen, progress)
    usual, every, alone = longest, math.ceil(data.samples / EXACT), False
    # A window of so many wide slips is that of a fast loop, of which the record thinned shows nothing.
    views = [(part, 1) for _, part in active_windows(data)[:1]] + [(data.thinned(every), every)]
    for view, times in views if longest < most else ():
        reach = longest / times, min(most / times, view.samples / 4.0)
        if reach[0] < reach[1] and (found := _searched(view, *reach, _seen, silent)) is not None:
            longest = max(longest, times * found.limits.theta[1])
            alone = alone or leaves_noise(view, found.best)
            if found.best.slips >= ENOUGH_SLIPS and found.best.d >= WIDE_D * view.op_range:
                break
    if longest <= DOUBLED * usual and longest < most and not alone:
        longest = max(longest, min(CYCLED * between_steps(data), most))
    found = _searched(data, longest, most, _unseen, progress)
    if longest > usual and found is not None and not leaves_noise(data, found.best):
        # Of fewer dead times each is looked at closer, and a stem may be met that was passed over among more; what else
        # is searched may have the longer ones all the same.
        other = search(data, usual)
        if other is not None and other.best.fit.sse <= found.best.fit.sse:
            found = replace(other, limits=found.limits)
    return found


def _searched(
    data: Centred,
    longest: float,
    most: float,
    looked: Callable[[Centred, float, float], _Seen],
    progress: Callable[[float], None],
) -> Profile | None:
    """`searched` in all of a record, with a look at it that says whether to go on to longer dead times."""
    found = search(data, longest, progress)
    # Who leaves noise alone leaves nothing for another.
    while found is not None and longest < most and not leaves_noise(data, found.best):
        seen = looked(data, longest, most)
        further = 2.0 * longest if found.at_limit else 0.0
        if seen.within - seen.beyond >= CLEAR:
            further = max(further, ROOM * seen.delay, 2.0 * longest)
        if further <= longest:
            return found
        longest = min(further, most)
        other = search(data, longest, progress)
        if other is None:
            return found
        # Where a stem of another kind explains more, it is the one to compare.
        within, beyond = min(_level(data, found), seen.within), min(_level(data, other), seen.beyond)
        # Which ends at any limit, and fits no better for being longer, is none that PV shows.
        if within - beyond < (0.0 if found.at_limit and not other.at_limit else CLEAR):
            return found
        found = other
    return found


def _unseen(*_: object) -> _Seen:
    """Nothing is looked for."""
    return _Seen(0.0, math.inf, math.inf)


def _level(data: Centred, found: Profile) -> float:
    return data.samples * math.log(max(found.best.fit.sse / data.samples, data.floor))


def _seen(data: Centred, longest: float, most: float) -> _Seen:
    """What a coarse grid of stems, valves of any kind, says of dead times up to `longest` and up to `most`."""
    S = np.geomspace(NARROWEST, WIDEST, BANDS) * data.op_range
    grid = np.column_stack([np.repeat(S, len(SHARES)), (S[:, None] * np.array(SHARES)).ravel()])
    grid = np.vstack([[HARDLY * data.op_range, 0.0], grid])
    grid = grid[grid.sum(axis=1) < 2.0 * data.op_range]
    taus = np.geomspace(SHORTEST, LONGEST * data.samples, TAUS)[-1 if data.integrating else 0 :]
    levels, found = [], np.empty((len(grid), 4, 3))
    far = _spaced(longest + 1.0, most, FAR)
    if not far:
        return _unseen()
    for delays in (_spaced(0.0, longest, NEAR), far):
        screen_bands(
            data.target, data.u, grid, np.exp(-1.0 / taus), integers(delays), data.sign, data.a, data.skip, found
        )
        best = found.reshape(-1, 3)[np.argmin(found[:, :, 0])]
        levels.append(data.samples * math.log(max(best[0] / data.samples, data.floor)))
    return _Seen(float(far[int(best[2])]), *levels)


def _spaced(first: float, last: float, ratio: float) -> list[int]:
    """Whole samples from `first` to `last`, each by a share longer than the one before."""
    delays, at = [], first
    while at <= last:
        delays.append(math.ceil(at))
        at = max(at + 1.0, at * ratio)
    return sorted({d for d in delays if d <= last})
