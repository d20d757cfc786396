"""Stems of a slow level, from the slips that its PV shows: its slope changes where the stem moves.

A level sums up all that its valve lets through, so that a stem which is wrong in one slip leaves much of PV from there
on: of a long record no small steps lead from a stem some hundredths off to the right one. Seen as kinks, a wrong slip
costs no more than itself. Where OP stood at them, a dead time before, says what S and J the valve has: a stem turns
where OP comes back by S from where the last slip led it, and moves on where OP goes on by J (see
`kernels.path.band_path`). Each dead time asks for another pair; the slips that these make tell which is the valve's.

PV of a lag steps, with a kink at either end: the same is asked of its steps, a part of the time constant later.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Limits
from workbench.estimate.search.nearer import REACHES_LONG, SPREADS, closer, nearer
from workbench.estimate.search.sought import on_all
from workbench.estimate.search.two_parameter import (
    AT_ONCE,
    LONGEST,
    MOST_STARTS,
    Band,
    Seed,
    band_stem,
    best_of,
    started,
)
from workbench.model.record import FloatArray

__all__ = ["Kinks", "about_kinks", "between_steps", "kinks_of", "seen_as_kinks", "sums_up"]

Times = NDArray[np.int64]

WIDTHS = (20, 40, 80, 160)  # samples: lines are fitted to so many before and after each
CLEAR, LEAST = 6.0, 0.01  # standard deviations of noise, and of the largest: a change of slope that is a kink
NEARLY = 0.95  # of the most kinks: the narrowest width that sees as many times them best
FEWEST, FEWEST_ON, FEWEST_STEPS = 10, 3, 4  # kinks that tell a stem from others, slips onwards that tell J, and steps
# Widths after a kink, and a share of all: of 15 random lags 14 have 0.42 to 0.49 with one the other way by then, of 63
# random levels none more than 0.08.
SOON, PAIRED = 1.5, 0.25
# Times what OP comes back by to a kink: less, as it goes on while the slip before is still to be seen, or more, as
# noise in OP moves a stem on a little after each slip.
NARROWER = 0.45
WIDER, WIDER_STEP = 1.2, 0.003
ONWARDS, SHARES = (0.9, 0.95, 1.0, 1.05, 1.1), (0.2, 0.5, 0.8, 1.1, 1.4)  # J: times what OP goes on by, or shares of S
# How many kinks stems are sought beside: the fewer, the wider is what S and J lead to them, and the more lead nowhere.
BEGINNINGS = (30, 60)
FEW = 10  # of a lag's steps alone: in a quiet cycle a slip that is missed is never made up for
MISSED = 0.5  # of the first of them: a stem that misses more explains less than it leaves
SEEDS, APART, APART_JUMP = 8, 0.02, 0.05  # of the best, which differ in S or J, of S
LONGEST_STEP, SHORTEST_STEP = 0.02, 4e-4  # of S, on the way from each to the best about it
# Ways to step from a stem: shares of the step along S and along J.
WAYS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1), (0, 3), (0, -3))
ABOUT_JUMP = (0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5)  # times J as the slips tell it
TAUS, HALF_DONE = (5.0, 15.0, 45.0), 0.7  # samples: time constants of lags, by which of them a step is half done
JUMPS = 120  # values of J looked at for a lag's stem
ALIKE = 6  # of the seeds, which may be one stem but for J
# How often the best is gone on from, until it leaves so much of what it left before.
ROUNDS, HARDLY_LESS = 3, 0.999
MOST = 3  # slips to a kink: a stem that turns with all that OP does tells nothing
AT_REST = tuple((int(first), sense) for first, sense in AT_ONCE.tolist())


class Kinks(NamedTuple):
    """Where PV's slope changes: samples, ascending; +1 where it rises, -1; and over how many samples it was seen."""

    at: Times
    senses: FloatArray
    width: int


class _Match(NamedTuple):
    """How many of the kinks and slips, as a share, a stem misses; its S and J, %, and dead time, samples; its start."""

    missed: float
    S: float
    J: float
    theta: float
    start: tuple[int, float]


def kinks_of(y: FloatArray) -> Kinks | None:
    """Return the kinks of PV, EU, shape (N,), at the narrowest of some widths that sees them; None for less than ten.

    A kink is where lines fitted to the samples before and after it differ in slope by far more than noise makes them.
    """
    found = [_turns(y, width) for width in WIDTHS if 4 * width < y.size]
    most = max((one.at.size for one in found), default=0)
    return None if most < FEWEST else next(one for one in found if one.at.size >= NEARLY * most)


def _turns(y: FloatArray, width: int) -> Kinks:
    """The kinks that are seen with one width."""
    from scipy.signal import find_peaks  # takes long to load, and short records do not need it

    steps = np.arange(width) - 0.5 * (width - 1)
    slopes = np.convolve(y, steps[::-1] / float(steps @ steps), "valid")
    change = slopes[width:] - slopes[:-width]
    noise = 1.4826 * float(np.median(np.abs(change - np.median(change))))
    least = max(CLEAR * noise, LEAST * float(np.abs(change).max()))
    at = find_peaks(np.abs(change), height=least, distance=width)[0]
    return Kinks(at + width, np.sign(change[at]), width)


def sums_up(data: Centred, longest: float) -> bool:
    """Return whether PV has the kinks of a level: whether some stem slips where most of the first of them are.

    longest: samples, the longest dead time.
    """
    return any(_begun(beside) for beside in _each_sense(data, longest, level=True))


def between_steps(data: Centred) -> float:
    """Return the time between the steps of a lag's PV, samples, the median; 0 where it shows too few."""
    steps = _slips_seen(data.y, level=False)
    return 0.0 if steps is None or steps.at.size < FEWEST_STEPS else float(np.median(np.diff(steps.at)))


def seen_as_kinks(data: Centred, longest: float) -> tuple[Seed, ...]:
    """Return the stems (S, J, tau, theta) that slip where a level's PV has kinks, or a lag's steps, likeliest first.

    longest: samples, the longest dead time. Empty where PV shows too few, or those of the other kind of plant.
    """
    met: list[_Match] = []
    for beside in _each_sense(data, longest, level=data.integrating):
        seeds = _begun(beside)
        if not data.integrating:
            seeds = [*beside.beginning(FEW).first(), *seeds]
        if seeds:
            seeds += beside.beginning(BEGINNINGS[1]).first()
            here = [beside.nearest(one) for one in seeds]
            if not data.integrating:
                here += beside.jumping(min(here))
            met += here
    met = sorted(one for one in met if one.missed <= MISSED)
    return tuple((one.S, one.J, LONGEST * data.samples, one.theta) for one in _apart(met, len(met)))


def about_kinks(data: Centred, limits: Limits) -> list[Band]:
    """Return the stems met about the likeliest one of `seen_as_kinks`, fitted to all of PV."""
    seeds = seen_as_kinks(data, limits.theta[1])
    if not seeds:
        return []
    S, J, tau, theta = seeds[0]
    # Where OP never goes on by J no slip tells it: PV does, by where the stem stands beside OP.
    jumps = [share * J for share in ABOUT_JUMP] + [seed[1] for seed in seeds[1:ALIKE] if abs(seed[0] / S - 1.0) < APART]
    plants = [(tau, theta)]
    if not data.integrating:
        plants = [(tau, max(theta - HALF_DONE * tau, 0.0)) for tau in TAUS]
    bands = [on_all(data, (S, jump, *plant), limits) for jump in jumps for plant in plants]
    for _ in range(ROUNDS):
        before = best_of(bands)
        bands += nearer(data, started(data, before, limits, MOST_STARTS), SPREADS[2:], None, limits)
        for reach in REACHES_LONG:
            bands += closer(data, best_of(bands), reach, 0.05 * reach[0], None, limits)[0]
        if best_of(bands).fit.sse > HARDLY_LESS * before.fit.sse:
            break
    return [b for b in bands if b.slips > 0 and b.fit.gain != 0.0]


def _slips_seen(y: FloatArray, *, level: bool) -> Kinks | None:
    """The kinks of a level's PV, or the steps of a lag's, None where it shows too few or those of the other."""
    kinks = kinks_of(y)
    if kinks is None or _paired(kinks) == level:
        return None
    return kinks if level else _steps(kinks)


def _each_sense(data: Centred, longest: float, *, level: bool) -> list[_Beside]:
    """What PV shows of slips, with the senses of what moves it: both ways where the sign of the gain is not known."""
    seen = _slips_seen(data.y, level=level)
    if seen is None or seen.at.size < FEWEST:
        return []
    signs = (data.sign,) if data.sign else (1.0, -1.0)
    return [_Beside(data.u, seen._replace(senses=sign * seen.senses), longest) for sign in signs]


def _steps(kinks: Kinks) -> Kinks:
    """The steps between kinks and those that soon follow the other way, each where it is half done."""
    begins: list[int] = []
    for i in np.flatnonzero(_back(kinks)).tolist():
        # The one that ends a step begins none.
        if not begins or i > begins[-1] + 1:
            begins.append(i)
    first = np.array(begins, dtype=np.int64)
    return Kinks((kinks.at[first] + kinks.at[first + 1]) // 2, kinks.senses[first], kinks.width)


def _back(kinks: Kinks) -> NDArray[np.bool_]:
    """Which kinks are soon followed by one the other way, of all but the last."""
    turned: NDArray[np.bool_] = kinks.senses[1:] != kinks.senses[:-1]
    return turned & (np.diff(kinks.at) <= SOON * kinks.width)


def _paired(kinks: Kinks) -> bool:
    """Whether many kinks soon follow one the other way: PV steps, as that of a lag does, which soon levels off."""
    return bool(_back(kinks).mean() > PAIRED)


def _begun(beside: _Beside) -> list[_Match]:
    """The best stems beside the first kinks, none where the best misses most of them."""
    found = beside.beginning(BEGINNINGS[0]).first()
    return found if found and found[0].missed <= MISSED else []


def _apart(matches: list[_Match], most: int) -> list[_Match]:
    """The first that differ, up to so many."""
    chosen: list[_Match] = []
    for one in matches:
        if all(abs(one.S / c.S - 1.0) > APART or abs(one.J - c.J) > APART_JUMP * one.S for c in chosen):
            chosen.append(one)
        if len(chosen) == most:
            break
    return chosen


class _Beside:
    """The slips of stems beside the kinks of a level's PV, or the steps of a lag's.

    op: %, shape (N,); kinks: with the senses of what moves PV; longest: samples, of the dead times, of which none is
    more than half of the time between kinks.
    """

    def __init__(self, op: FloatArray, kinks: Kinks, longest: float) -> None:
        self._op, self._kinks = op, kinks
        self._longest = min(longest, 0.5 * float(np.median(np.diff(kinks.at))))
        self._ways = [kinks.at[kinks.senses == sense] for sense in (1.0, -1.0)]

    def beginning(self, most: int) -> _Beside:
        """The record up to the end of so many of the kinks."""
        at, senses, width = self._kinks
        if at.size <= most:
            return self
        return _Beside(self._op[: at[most - 1] + width], Kinks(at[:most], senses[:most], width), self._longest)

    def first(self) -> list[_Match]:
        """The best few of the stems whose S and J OP tells where it stood at the kinks, for any dead time."""
        back, on = self._moved()
        if not back.size:
            return []
        low, high = max(float(back.min()), NARROWER * float(back.max())), WIDER * float(back.max())
        met = []
        for S in np.geomspace(low, high, int(np.log(high / low) / WIDER_STEP) + 1).tolist():
            further = on[np.argmin(np.abs(back * np.sqrt(WIDER) - S))]
            jumps = [share * S for share in SHARES] if np.isnan(further) else [share * further for share in ONWARDS]
            met += [self._match(S, J, AT_REST[0]) for J in jumps]
        return _apart(sorted(met), SEEDS)

    def nearest(self, one: _Match) -> _Match:
        """The best stem about another, by smaller and smaller steps of S and J."""
        best = min(self._match(one.S, one.J, start) for start in AT_REST)
        step = LONGEST_STEP
        while step >= SHORTEST_STEP:
            before = best
            for S, J in WAYS:
                there = self._match(best.S * (1.0 + S * step), max(best.J + J * step * best.S, 0.0), best.start)
                best = min(best, there)
            step = step if best.missed < before.missed else 0.5 * step
        return best

    def jumping(self, one: _Match) -> list[_Match]:
        """The same stem with other jumps: many slip at the same samples, and PV tells which is the valve's."""
        return [self._match(one.S, share * one.J, one.start) for share in np.geomspace(0.5, 2.0, JUMPS).tolist()]

    def _moved(self) -> tuple[FloatArray, FloatArray]:
        """By how much OP came back to a slip, and went on to one, %: the medians at each dead time, NaN of too few."""
        half = max(self._kinks.width // 16, 1)
        op = np.convolve(self._op, np.full(2 * half + 1, 1.0 / (2 * half + 1)), "same")
        at, turned = self._kinks.at, self._kinks.senses[1:] != self._kinks.senses[:-1]
        back, on = [], []
        for theta in range(0, int(self._longest) + 1, max(self._kinks.width // 20, 1)):
            known = at[:-1] >= theta
            moved = np.abs(op[at[1:] - theta] - op[np.maximum(at[:-1] - theta, 0)])
            came, went = moved[turned & known], moved[~turned & known]
            if came.size >= FEWEST_ON and (median := float(np.median(came))) > 0.0:
                back.append(median)
                on.append(float(np.median(went)) if went.size >= FEWEST_ON else np.nan)
        return np.array(back), np.array(on)

    def _match(self, S: float, J: float, start: tuple[int, float]) -> _Match:
        """What a stem misses of the kinks, at the dead time by which most of them follow a slip in the same sense."""
        x, slips = band_stem(self._op, S, J, *start)
        n, cap = self._kinks.at.size, 0.5 * self._kinks.width
        if not 0 < slips <= MOST * n:
            return _Match(1.0, S, J, 0.0, start)
        moves = np.diff(x)
        moving = np.flatnonzero(moves)
        senses = np.sign(moves[moving])
        sets_off = np.append(True, (np.diff(moving) > 1) | (senses[1:] != senses[:-1]))
        away = []
        for sense, at in zip((1.0, -1.0), self._ways, strict=True):
            slip = moving[sets_off & (senses == sense)] + 1
            if not slip.size:
                return _Match(1.0, S, J, 0.0, start)
            # A kink is not seen to the sample: a slip just after it may be the one before a dead time of nothing.
            last = np.searchsorted(slip, at + 0.5 * cap, side="right") - 1
            away.append(np.where(last >= 0, at - slip[np.maximum(last, 0)], np.inf))
        lags = np.sort(np.concatenate(away))
        able = np.flatnonzero(lags <= self._longest)
        if not able.size:
            return _Match(1.0, S, J, 0.0, start)
        together = np.searchsorted(lags, lags[able] + cap, side="right")
        i = int(np.argmax(together - able))
        theta = float(np.clip(np.median(lags[able[i] : together[i]]), 0.0, self._longest))
        missed = float(np.minimum(np.abs(lags - theta) / cap, 1.0).sum())
        more = max(slips - n, 0)
        return _Match((missed + more) / (n + more), S, J, theta, start)
