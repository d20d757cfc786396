"""The stem test: does a valve that sticks explain PV better than the linear loop does?

Two rivals answer for PV with the same kind of plant, a first-order lag with gain and dead time: in one OP itself drives
it, in the other the stem of a valve that sticks. What no valve explains, disturbances and noise, is an autoregression
of low order in both, so that a slow drift counts for as little as it tells (generalized least squares; D. Cochrane,
G. Orcutt, J. American Statistical Association 44 (1949) 32-61). What counts is by how much the stem lowers the variance
of the innovations, `1 - s_stem^2/s_linear^2`, and the log likelihood ratio `N ln(s_linear^2/s_stem^2)`.

The plant is causal and of low order on purpose: a free impulse response copies the controller's inverse, and a dead
time of more than half a cycle passes for any phase. One of more than a twentieth of the record is tried only where a
linear loop that has one is clearly likelier than any stem without: else it makes up for what a valve does in a slow
cycle. Valves and plants come from a coarse grid with a short refinement: enough for a verdict; `estimate` finds the
model.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.detect.load_steps import unforced
from workbench.detect.resolution import unseen
from workbench.detect.rivals import (
    FURTHER,
    USUAL,
    Fit,
    Rivals,
    dead_times,
    fine_taus,
    held_of,
    live_of,
    order_of,
)
from workbench.detect.stem_search import FEW, FLOOR, Candidate, Fitted, Search, search_of
from workbench.detect.verdict import DUST, Thresholds, accuses, convinces
from workbench.model.detection import StemTest
from workbench.model.record import FloatArray

__all__ = ["WIDE", "stem_test"]

WIDE = 0.25  # of OP's range: a band that matters to the loop, one of CLASSES
BEYOND = 1.5  # of the dead time that the linear loop shows: as far stems are tried where that is an unusual one
WINDOW, WINDOWS = 3000, 3  # samples of one stretch, and the stretches of a long record
LIVELIER, FINER = 2.0, 6  # times what OP's standard deviation is elsewhere: there; starts a stretch that are tried
PER_CYCLE = 100  # samples of a cycle: more are thinned out of a record longer than a stretch
LEAST_LIVE = 0.25  # of a record: where less is left it is the loop itself that rests
NOISY = 0.1  # share by which noise alone may be more than its innovations, to which many terms are fitted


def _stretch(
    y: FloatArray,
    u: FloatArray,
    sp: FloatArray | None,
    sample_time: float,
    period: float,
    sign: float,
    fitted: Fitted | None,
    blur: float,
) -> StemTest:
    held = held_of(y, u)
    if not live_of(held)[order_of(y.size) :].mean() > LEAST_LIVE:
        held[:] = False
    at = np.arange(y.size)
    u = np.interp(at, at[~held], u[~held])
    u = u - u.mean()

    def among(delays: list[int]) -> StemTest:
        return _among(delays, y, u, held, unforced(sp, y, delays[-1]), sample_time, period, sign, fitted, blur)

    usual, further = (dead_times(y.size, period / sample_time, share) for share in (USUAL, FURTHER))
    test = among(usual)
    if len(further) == len(usual):
        return test
    level = y - y[~held].mean()
    long = _linear(level, u, further, sign, held)
    if long.delay <= usual[-1]:
        return test
    short = _linear(level, u, usual, sign, held)
    floor = FLOOR**2 * float(y[~held].var()) + blur
    ahead = test.samples * math.log((short.variance + floor) / (long.variance + floor))
    # Stems that are clearly worse than a linear loop with a longer dead time were given too short ones.
    if ahead < max(test.predicting, Thresholds().likelihood):
        return test
    return among([d for d in further if d <= BEYOND * long.delay])


def _linear(y: FloatArray, u: FloatArray, delays: list[int], sign: float, held: NDArray[np.bool_]) -> Fit:
    """The linear loop by itself."""
    return Rivals(y, delays, sign, held).linear(u, fine_taus(y.size))


def _among(
    delays: list[int],
    y: FloatArray,
    u: FloatArray,
    held: NDArray[np.bool_],
    free: NDArray[np.bool_],
    sample_time: float,
    period: float,
    sign: float,
    fitted: Fitted | None,
    blur: float,
) -> StemTest:
    """The stem test of one stretch with some dead times; held: the samples that nobody recorded, free: see `_test`.

    blur: variance of what is not seen of PV, EU^2.
    """

    def look(pv: FloatArray, steps: int) -> tuple[StemTest, Search]:
        search = search_of((pv - pv[~held].mean()).tobytes(), u.tobytes(), held.tobytes(), tuple(delays), sign, blur)
        told = [] if fitted is None else search.told(fitted)
        if told and _leaves_little(search, told):
            test = _test(search, [], told, free, sample_time, period, steps)
            if convinces(test):
                return test, search
        test = _test(search, search.own, told, free, sample_time, period, steps)
        if search.rival is not search.linear and not accuses(test):
            told = [search.swung(c) for c in told]
            beside = _test(search, search.own_swung, told, free, sample_time, period, steps, swings=True)
            test = beside if accuses(beside) else replace(test, wide=float(np.fmax(test.wide, beside.wide)))
        return test, search

    # What disturbs the loop from outside is taken out as the linear loop shows it, where anything is left then. Much of
    # what the valve did may go with it: to look so may accuse a valve, but acquits none.
    test, search = look(y, 0)
    if accuses(test):
        return test
    load = search.load(free)
    more = load.steps and (y - load.wave)[~held].var() > DUST * y[~held].var()
    relieved = look(y - load.wave, load.steps)[0] if more else test
    return relieved if accuses(relieved) else test


def _throughout(met: list[Candidate]) -> Candidate:
    """The stem that is best by prediction and simulation together."""
    return max(met, key=lambda c: c.both)


def _explained(met: list[Candidate]) -> tuple[float, float]:
    """Of what the linear loop leaves, unpredicted and simulated, the shares that this stem explains."""
    both = _throughout(met)
    return 1.0 - math.exp(-both.innovations / both.samples), 1.0 - math.exp(-both.simulated / both.samples)


def _leaves_little(search: Search, met: list[Candidate]) -> bool:
    """Whether the best stem explains most of both errors, or leaves of simulated PV but noise: nothing to predict."""
    explained, floor = _explained(met), search.floor
    left = (1.0 - explained[1]) * (search.straight.variance + floor)
    return min(explained) >= Thresholds().most or left <= (1.0 + NOISY) * (_throughout(met).fit.variance + floor)


def _test(
    search: Search,
    own: list[Candidate],
    told: list[Candidate],
    free: NDArray[np.bool_],
    sample_time: float,
    period: float,
    steps: int,
    swings: bool = False,
) -> StemTest:
    """What the search's own stems and a model's come to.

    free: the samples in which a load step may be; steps: those taken out of PV; swings: the stems are beside a sinusoid
    from outside, as their rival is.
    """
    rivals, power, met = search.rivals, search.power, own + told
    best, both = max(met, key=lambda c: c.innovations), _throughout(met)
    improvement, simulated = _explained(met)
    moving = np.diff(best.path) != 0.0
    moves = int((moving[1:] & ~moving[:-1]).sum()) + int(moving[0])
    width = float(np.ptp(search.u))
    test = StemTest(
        predicting=best.innovations,
        loaded=best.innovations,
        waved=search.over_wave(met, period / sample_time),
        turned=0.0,
        squares=search.squares,
        improvement=improvement,
        likelihood=both.innovations,
        simulated=simulated,
        adds=both.adds,
        sure=max(c.sure for c in met),
        instead=search.instead(met),
        # What chance gives is known for the search's own stems, not for one that a model was fitted with.
        wide=max((c.harmless for c in own if c.law.band >= WIDE * width), default=math.nan),
        wide_from=WIDE * width,
        left=search.linear.variance / power,
        unexplained=search.straight.variance / power,
        unfollowed=rivals.alone()[1] / power,
        band=best.law.band,
        jump=best.law.valve.slip_jump,
        moves=moves,
        samples=rivals.count,
        time_constant=search.straight.tau * sample_time,
        dead_time=search.straight.delay * sample_time,
        steps=steps,
        swings=swings,
    )
    limits = Thresholds()
    if test.sure >= limits.close * limits.sure:
        test = replace(test, turned=max(c.linearly for c in met) - search.turns)
    # A stem that moves often, and accuses nobody or explains most, is not worth a search for steps.
    if moves > FEW and not (accuses(test) and test.improvement < limits.most):
        return test
    loaded = search.over_load_steps(best, moves, free)
    if moves <= FEW:
        return replace(test, loaded=loaded)
    # It had steps too: what it is ahead by is the less of both.
    return replace(test, loaded=loaded, likelihood=min(test.likelihood, loaded), sure=min(test.sure, loaded))


def _starts(op: FloatArray) -> list[int]:
    """Where the stretches of a long record begin.

    A stem shows only where OP moves, and a loop at rest moves it seldom in a day: of each third the stretch is taken in
    which it moves most, where that is far more than in the one that would be.
    """
    n = op.size
    count = min(-(-n // WINDOW), WINDOWS)
    starts: list[int] = np.linspace(0, n - WINDOW, count).astype(int).tolist()
    if n < count * WINDOW:
        return starts

    def moves(start: int) -> float:
        return float(np.std(op[start : start + WINDOW]))

    ends = np.linspace(0, n, count + 1).astype(int).tolist()
    for k, (first, stop) in enumerate(pairwise(ends)):
        best = max(range(first, stop - WINDOW + 1, WINDOW // FINER), key=moves)
        if moves(best) > LIVELIER * moves(starts[k]):
            starts[k] = best
    return starts


def stem_test(
    pv: FloatArray,
    op: FloatArray,
    sp: FloatArray | None,
    sample_time: float,
    period: float,
    sign: float,
    fitted: Fitted | None = None,
) -> StemTest:
    """Return the stem test of PV (EU) and OP (%), shape (N,), both moving; sp: EU, (N,), where it was recorded.

    period: s, of PV's oscillation, nan where it has none. sign: that the plant's gain must have, +1 or -1, 0 where it
    is not known. fitted: a valve and its stem, %, shape (N,), from a model of the loop, tried before the grid, which is
    not asked where that one leaves no doubt (`wide` is nan then). A record of more than 3,000 samples is thinned
    until a cycle has no more than 100 or one stretch of 3,000 holds all; of what is longer yet three stretches are
    looked at, evenly spaced but where OP moves far more elsewhere in a third of the record, whose likelihoods add up,
    but for those of two rivals, and of squares: the clearest but one's count (see `verdict`); the rest is told for the
    clearest of them.
    """
    blur = unseen(pv)
    thin = int(period / sample_time / PER_CYCLE) if math.isfinite(period) else 1
    thin = max(min(thin, -(-pv.size // WINDOW)), 1)
    pv, op, step = pv[::thin], op[::thin], thin * sample_time
    sp = None if sp is None else sp[::thin]
    n = pv.size

    def stretch(first: int, stop: int) -> StemTest:
        there, of_sp = slice(first, stop), None if sp is None else sp[first:stop]
        return _stretch(pv[there], op[there], of_sp, step, period, sign, part(first, stop), blur)

    def part(first: int, stop: int) -> Fitted | None:
        # Gaps in memory, or what may only be read, would have the kernels compiled once more.
        return None if fitted is None else (fitted[0], np.array(fitted[1][::thin][first:stop]))

    if n <= WINDOW:
        return stretch(0, n)
    parts = [
        stretch(s, s + WINDOW)
        for s in _starts(op)
        if np.ptp(pv[s : s + WINDOW]) > 0.0 and np.ptp(op[s : s + WINDOW]) > 0.0
    ]
    if not parts:
        return stretch(0, n)
    total = sum(p.samples for p in parts)
    gain = sum(p.likelihood for p in parts)
    lead = max(parts, key=lambda p: p.predicting)
    counts = sorted(parts, key=lambda p: p.sure)[max(len(parts) - 2, 0)]
    return StemTest(
        predicting=sum(p.predicting for p in parts),
        loaded=sum(p.loaded for p in parts),
        waved=sum(p.waved for p in parts),
        turned=counts.turned,
        squares=sorted(p.squares for p in parts)[max(len(parts) - 2, 0)],
        improvement=1.0 - math.exp(-gain / total),
        likelihood=gain,
        simulated=float(np.median([p.simulated for p in parts])),
        adds=sum(p.adds for p in parts),
        sure=counts.sure,
        instead=sum(p.instead for p in parts),
        wide=sum(p.wide for p in parts),
        wide_from=max(p.wide_from for p in parts),
        left=float(np.mean([p.left for p in parts])),
        unexplained=float(np.mean([p.unexplained for p in parts])),
        unfollowed=float(np.mean([p.unfollowed for p in parts])),
        band=lead.band,
        jump=lead.jump,
        moves=sum(p.moves for p in parts),
        samples=total,
        time_constant=lead.time_constant,
        dead_time=lead.dead_time,
        steps=sum(p.steps for p in parts),
        swings=any(p.swings for p in parts),
    )
