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
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from workbench.detect.laws import BAND, CLASSES, Law, laws_of
from workbench.detect.load_steps import unforced
from workbench.detect.predictor import FreePredictor
from workbench.detect.resolution import unseen
from workbench.detect.rivals import (
    FURTHER,
    LONGEST,
    SHORTEST,
    USUAL,
    Fit,
    Loaded,
    Rivals,
    dead_times,
    fine_taus,
    held_of,
    live_of,
    order_of,
)
from workbench.detect.turns import turns_of_pv
from workbench.detect.verdict import DUST, Thresholds, accuses, convinces
from workbench.detect.wave import steady_wave
from workbench.model.detection import StemTest
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Deadband, Stenman

__all__ = ["FITTED", "WIDE", "Fitted", "stem_test"]

FITTED = (Stenman, Choudhury, Deadband)  # valves that the stem test may be given
Fitted = tuple[Stenman | Choudhury | Deadband, FloatArray]

WIDE = 0.25  # of OP's range: a band that matters to the loop, one of CLASSES
CLOSER = (0.06, 0.03, 0.012, 0.005)  # widths are searched on by up to twice these shares
COARSE_TAUS, OWN_TAUS = 8, (0.8, 1.0, 1.25)  # time constants of the grid, and times those of the linear loop
BEYOND = 1.5  # of the dead time that the linear loop shows: as far stems are tried where that is an unusual one
WINDOW, WINDOWS = 3000, 3  # samples of one stretch, and the stretches of a long record
PER_CYCLE = 100  # samples of a cycle: more are thinned out of a record longer than a stretch
LEAST_LIVE = 0.25  # of a record: where less is left it is the loop itself that rests
FLOOR = 0.005  # of PV's standard deviation: no record is good for less
FEW = 8  # moves of a stem, two each of four load steps, that may look the same
SINUSOID = 3  # parameters
FAR = 100.0  # a stem that is so far ahead of a linear loop under load steps needs none of its own
NOISY = 0.1  # share by which noise alone may be more than its innovations, to which many terms are fitted
KEPT = 8  # searches: one estimate asks of a record with several stems, and of what its load steps leave
HARM = 0.5  # a stem that simulates PV worse than OP itself does by more than this share is not this loop's


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A valve and its log likelihood ratios over the linear rival: of the innovations, and of the simulated PV.

    linearly: that over the free linear predictor; adds: the less of it and of that over the curved one, where little is
    left. samples: that count.
    """

    law: Law
    path: FloatArray
    fit: Fit
    innovations: float
    simulated: float
    linearly: float
    adds: float
    samples: int

    @property
    def both(self) -> float:
        """The less of innovations and simulation."""
        return min(self.innovations, self.simulated)

    @property
    def harmless(self) -> float:
        """The likelihood ratio of the innovations, or the less of both where the stem spoils the simulation."""
        return self.innovations if self.simulated >= -self.samples * math.log(1.0 + HARM) else self.both

    @property
    def sure(self) -> float:
        """The less of that and of what the stem adds to the free predictor."""
        return min(self.harmless, self.adds)


class _Search:
    """The search for the stem that beats the linear rival of one stretch."""

    def __init__(self, rivals: Rivals, u: FloatArray, held: NDArray[np.bool_], power: float, blur: float) -> None:
        self.rivals, self.u, self.power = rivals, u, power
        self.floor = FLOOR**2 * power + blur
        self.fine, self.white = fine_taus(rivals.n), rivals.white
        self.linear = rivals.linear(u, self.fine)
        # A sinusoid from outside is no valve's work; an autoregression under noise does not see all of it.
        self.rival = min(self.linear, rivals.beside_sinusoid(u, self.linear, self.fine), key=lambda f: f.variance)
        self.straight = rivals.plant(u, self.white, self.fine)
        past = rivals.y, u, held, self.floor, rivals.longest
        self.free = FreePredictor(*past, delay=self.linear.delay)
        # What moves most of PV shows what curve the plant has.
        self.little = self.straight.variance < Thresholds().little * power
        self.known = [self.free]
        if self.little:
            curved = FreePredictor(*past, True, self.linear.delay)
            # In a short record the one may have to do with less of the past than the other.
            self.known += [curved] if curved.past == self.free.past else []
        self._in_place: dict[bytes, float] = {}
        self._wave: dict[float, float] = {}

    def _gain(self, rival: float, variance: float) -> float:
        return self.rivals.count * math.log((rival + self.floor) / (variance + self.floor))

    def judged(self, law: Law, path: FloatArray, a: FloatArray, taus: FloatArray | None = None) -> _Candidate:
        """Return a valve with its likelihoods, its plant and noise fitted in turn from the whitening filter a.

        taus: the time constants to start from, samples; then its simulation is not looked at.
        """
        fit = self.rivals.settle(path, a, self.fine if taus is None else taus, 2)
        simulated, adds = -math.inf, [0.0]
        if taus is None:
            simulated = self._gain(self.straight.variance, self.rivals.plant(path, self.white, self.fine).variance)
            adds = [known.adds(path, fit.delay) for known in self.known]
        innovations = self._gain(self.rival.variance, fit.variance)
        return _Candidate(law, path, fit, innovations, simulated, adds[0], min(adds), self.rivals.count)

    @cached_property
    def own(self) -> list[_Candidate]:
        """The valves met."""
        return self.met()

    def met(self) -> list[_Candidate]:
        """Return the valves judged: the best of the grid, and those found closer and closer about them."""
        width = float(np.ptp(self.u))
        grid = laws_of(width)
        limits = np.array(CLASSES) * width
        classes = [np.digitize(laws.rows[:, BAND], limits) for laws in grid]
        coarse = np.geomspace(SHORTEST, LONGEST * self.rivals.n, COARSE_TAUS)
        # Where OP makes most of PV, what is amiss with the grid's plants hides any stem: it is looked at with plants
        # like the linear loops' own too.
        own = np.array([f.tau * share for f in (self.linear, self.straight) for share in OWN_TAUS])
        found: list[_Candidate] = []

        # The linear rival's noise holds what the stem would explain, white noise what it would not: once more with
        # the noise of the best so far. Wide and narrow stems are looked at apart: neither is to crowd out the other.
        starts = [(self.linear.a, coarse), (self.white, coarse), *([(self.linear.a, own)] if self.little else [])]
        for start, taus in (*starts, (None, coarse)):
            a = max(found, key=lambda c: c.innovations).fit.a if start is None else start
            costs = [self.rivals.least(self.u, laws, a, taus) for laws in grid]
            for part in range(len(CLASSES) + 1):
                there = [np.where(c == part, cost, math.inf) for c, cost in zip(classes, costs, strict=True)]
                # Of both kinds of valve in the end: which of them is nearer to a better one is not known yet.
                for kind in sorted((0, 1), key=lambda k: there[k].min())[: 1 if start is not None else 2]:
                    law = grid[kind].law(int(np.argmin(there[kind])))
                    found.append(self.judged(law, law.path(self.u), a))
        # The best of each class is looked at closer, and beside the best of all the other kind of valve too.
        found.sort(key=lambda c: -c.innovations)
        parts = np.digitize([c.law.band for c in found], limits).tolist()
        leaders = [found[parts.index(part)] for part in range(len(CLASSES) + 1)]
        lead = found[0]
        kinds = (c for c, part in zip(found, parts, strict=True) if part == parts[0])
        leaders.append(next(c for c in kinds if type(c.law.valve) is not type(lead.law.valve)))
        return found + [self.closer(c) for c in leaders]

    @cached_property
    def own_swung(self) -> list[_Candidate]:
        """The same beside what swings the loop from outside."""
        return [self.swung(c) for c in self.own]

    def over_load_steps(self, best: _Candidate, moves: int, free: NDArray[np.bool_]) -> float:
        """Return a stem's log likelihood ratio over the linear rival under at most half as many load steps as FEW.

        A stem that moves more often than FEW is no likeness of them, and may have as many beside it.
        """
        if moves == 0:
            return best.innovations
        most, often = min(moves, FEW // 2), moves > FEW
        filters = [self.linear.a, best.fit.a] if often else [self.linear.a, best.fit.a, self.white]
        left = math.inf
        for a in filters:
            left = min(left, self.rivals.under_load(self.u, a, self.fine, free, most).variance)
            if often and self._gain(left, best.fit.variance) > FAR:
                return best.innovations
        stem = best.fit.variance
        if often:
            stem = min([stem, *(self.rivals.under_load(best.path, a, self.fine, free, most).variance for a in filters)])
        return min(best.innovations, self._gain(left, stem))

    def load(self, free: NDArray[np.bool_]) -> Loaded:
        """Return the load steps under which the linear rival does best, none where they add no more than chance."""
        best = self.rivals.under_load(self.u, self.linear.a, self.fine, free, FEW // 2, ramps=False)
        more = best.steps and self._gain(self.rival.variance, best.variance) > Thresholds().chance
        return best if more else Loaded(self.rival.variance, np.zeros(self.rivals.n), 0)

    def swung(self, judged: _Candidate) -> _Candidate:
        """Return a valve with a sinusoidal disturbance beside it where that is likelier, as its rival may have one.

        Frequency, size and phase are paid for by ln N each, which the rival does not pay.
        """
        fit = self.rivals.beside_sinusoid(judged.path, judged.fit, self.fine)
        innovations = self._gain(self.rival.variance, fit.variance) - SINUSOID * math.log(self.rivals.count)
        return replace(judged, fit=fit, innovations=innovations) if innovations > judged.innovations else judged

    def instead(self, met: list[_Candidate]) -> float:
        """Return the best stem's least ratio: over the linear rival, beside OP in the free predictor, in its place."""
        best = -math.inf
        for c in sorted(met, key=lambda c: -min(c.innovations, c.adds)):
            least = min(c.innovations, c.adds)
            if least <= max(best, 0.0):
                return max(best, least)
            best = max(best, min(least, self._instead(c.path)))
        return best

    def _instead(self, path: FloatArray) -> float:
        """What a stem is ahead of OP in the free predictor, in its place: a regression of its own, done once."""
        key = path.tobytes()
        if key not in self._in_place:
            self._in_place[key] = self.free.instead(path)
        return self._in_place[key]

    def over_wave(self, met: list[_Candidate], period: float) -> float:
        """Return what the best stem is ahead of a wave of PV's period in the free predictor, beside OP or in its place.

        The best likelihood ratio over the linear rival where that is chance, or PV has no period (nan; samples).
        """
        best = max(c.innovations for c in met)
        if not (best > Thresholds().chance and math.isfinite(period) and self.free.enough):
            return best
        if period not in self._wave:
            self._wave[period] = steady_wave(self.free, self.rivals.y, period)
        wave = self._wave[period]
        ahead = max(c.linearly for c in met) - wave
        # Not asked where it changes nothing.
        return ahead if wave <= 0.0 else max([ahead, *(self._instead(c.path) - wave for c in met)])

    @property
    def squares(self) -> float:
        """What squares add to the free linear predictor; 0 where they are not asked."""
        return self.known[-1].ahead_of(self.free)

    @cached_property
    def turns(self) -> float:
        """What PV's own turns add to the free predictor."""
        return turns_of_pv(self.free, self.rivals.delays.tolist())

    def told(self, fitted: Fitted) -> list[_Candidate]:
        """Return a model's valve judged, and the best found about it."""
        judged = [self.judged(Law(fitted[0], 0.0), fitted[1], a) for a in (self.white, self.linear.a)]
        return [*judged, self.closer(max(judged, key=lambda c: c.innovations))]

    def closer(self, best: _Candidate) -> _Candidate:
        """Return the best about a candidate, closer and closer: a stem a little off slips at other times."""
        for spread in CLOSER:
            laws = best.law.about(spread)
            taus = best.fit.tau * np.array([0.85, 1.0, 1.18])
            costs = self.rivals.least(self.u, laws, best.fit.a, taus)
            first, *others = np.argsort(costs, kind="stable")[:2].tolist()
            # Wide stems that differ little make the same moves: where the costs are equal it is the same stem.
            near = [laws.law(i) for i in (first, *others) if i == first or costs[i] > costs[first]]
            judged = [self.judged(law, law.path(self.u), best.fit.a, taus) for law in near]
            best = max([best, *judged], key=lambda c: c.innovations)
        return self.judged(best.law, best.path, best.fit.a)


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

    def look(pv: FloatArray, steps: int) -> tuple[StemTest, _Search]:
        search = _search_of((pv - pv[~held].mean()).tobytes(), u.tobytes(), held.tobytes(), tuple(delays), sign, blur)
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


@lru_cache(maxsize=KEPT)
def _search_of(y: bytes, u: bytes, held: bytes, delays: tuple[int, ...], sign: float, blur: float) -> _Search:
    """The search in a stretch of PV, about its mean, and OP, as their numbers stand in memory; held: see `_among`."""
    pv, op, still = np.frombuffer(y).copy(), np.frombuffer(u).copy(), np.frombuffer(held, dtype=np.bool_).copy()
    return _Search(Rivals(pv, list(delays), sign, still), op, still, float(pv[~still].var()), blur)


def _throughout(met: list[_Candidate]) -> _Candidate:
    """The stem that is best by prediction and simulation together."""
    return max(met, key=lambda c: c.both)


def _explained(met: list[_Candidate]) -> tuple[float, float]:
    """Of what the linear loop leaves, unpredicted and simulated, the shares that this stem explains."""
    both = _throughout(met)
    return 1.0 - math.exp(-both.innovations / both.samples), 1.0 - math.exp(-both.simulated / both.samples)


def _leaves_little(search: _Search, met: list[_Candidate]) -> bool:
    """Whether the best stem explains most of both errors, or leaves of simulated PV but noise: nothing to predict."""
    explained, floor = _explained(met), search.floor
    left = (1.0 - explained[1]) * (search.straight.variance + floor)
    return min(explained) >= Thresholds().most or left <= (1.0 + NOISY) * (_throughout(met).fit.variance + floor)


def _test(
    search: _Search,
    own: list[_Candidate],
    told: list[_Candidate],
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
    looked at, evenly spaced, whose likelihoods add up, but for those of two rivals, and of squares: the clearest but
    one's count (see `verdict`); the rest is told for the clearest of them.
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
    count = min(-(-n // WINDOW), WINDOWS)
    starts = np.linspace(0, n - WINDOW, count).astype(int).tolist()
    parts = [
        stretch(s, s + WINDOW) for s in starts if np.ptp(pv[s : s + WINDOW]) > 0.0 and np.ptp(op[s : s + WINDOW]) > 0.0
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
