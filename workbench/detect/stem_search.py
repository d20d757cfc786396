"""The search for the stem of a valve that beats the linear loop of one stretch of a record (see `stem`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from workbench.detect.laws import BAND, CLASSES, Law, laws_of
from workbench.detect.predictor import FreePredictor
from workbench.detect.rivals import LONGEST, SHORTEST, Fit, Loaded, Rivals, fine_taus
from workbench.detect.turns import turns_of_pv
from workbench.detect.verdict import Thresholds
from workbench.detect.wave import steady_wave, uneven_wave
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Deadband, Stenman

__all__ = ["FEW", "FITTED", "FLOOR", "Candidate", "Fitted", "Search", "search_of"]

FITTED = (Stenman, Choudhury, Deadband)  # valves that the stem test may be given
Fitted = tuple[Stenman | Choudhury | Deadband, FloatArray]

CLOSER = (0.06, 0.03, 0.012, 0.005)  # widths are searched on by up to twice these shares
COARSE_TAUS, OWN_TAUS = 8, (0.8, 1.0, 1.25)  # time constants of the grid, and times those of the linear loop
FLOOR = 0.005  # of PV's standard deviation: no record is good for less
FEW = 8  # moves of a stem, two each of four load steps, that may look the same
SINUSOID = 3  # parameters
FAR = 100.0  # a stem that is so far ahead of a linear loop under load steps needs none of its own
KEPT = 8  # searches: one estimate asks of a record with several stems, and of what its load steps leave
HARM = 0.5  # a stem that simulates PV worse than OP itself does by more than this share is not this loop's


@dataclass(frozen=True, slots=True)
class Candidate:
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


class Search:
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
        self._under: dict[tuple[bytes, bytes, int, bool], Loaded] = {}
        self._wave: dict[float, float] = {}
        self._uneven: dict[float, tuple[float, float]] = {}

    def _gain(self, rival: float, variance: float) -> float:
        return self.rivals.count * math.log((rival + self.floor) / (variance + self.floor))

    def judged(self, law: Law, path: FloatArray, a: FloatArray, taus: FloatArray | None = None) -> Candidate:
        """Return a valve with its likelihoods, its plant and noise fitted in turn from the whitening filter a.

        taus: the time constants to start from, samples; then its simulation is not looked at.
        """
        fit = self.rivals.settle(path, a, self.fine if taus is None else taus, 2)
        simulated, adds = -math.inf, [0.0]
        if taus is None:
            simulated = self._gain(self.straight.variance, self.rivals.plant(path, self.white, self.fine).variance)
            adds = [known.adds(path, fit.delay) for known in self.known]
        innovations = self._gain(self.rival.variance, fit.variance)
        return Candidate(law, path, fit, innovations, simulated, adds[0], min(adds), self.rivals.count)

    @cached_property
    def own(self) -> list[Candidate]:
        """The valves met."""
        return self.met()

    def met(self) -> list[Candidate]:
        """Return the valves judged: the best of the grid, and those found closer and closer about them."""
        width = float(np.ptp(self.u))
        grid = laws_of(width)
        limits = np.array(CLASSES) * width
        classes = [np.digitize(laws.rows[:, BAND], limits) for laws in grid]
        coarse = np.geomspace(SHORTEST, LONGEST * self.rivals.n, COARSE_TAUS)
        # Where OP makes most of PV, what is amiss with the grid's plants hides any stem: it is looked at with plants
        # like the linear loops' own too.
        own = np.array([f.tau * share for f in (self.linear, self.straight) for share in OWN_TAUS])
        found: list[Candidate] = []

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
    def own_swung(self) -> list[Candidate]:
        """The same beside what swings the loop from outside."""
        return [self.swung(c) for c in self.own]

    def over_load_steps(self, best: Candidate, moves: int, free: NDArray[np.bool_]) -> float:
        """Return a stem's log likelihood ratio over the linear rival under at most half as many load steps as FEW.

        A stem that moves more often than FEW is no likeness of them, and may have as many beside it.
        """
        if moves == 0:
            return best.innovations
        most, often = min(moves, FEW // 2), moves > FEW
        filters = [self.linear.a, best.fit.a] if often else [self.linear.a, best.fit.a, self.white]
        left = math.inf
        for a in filters:
            left = min(left, self._under_load(a, free, most).variance)
            if often and self._gain(left, best.fit.variance) > FAR:
                return best.innovations
        stem = best.fit.variance
        if often:
            stem = min([stem, *(self.rivals.under_load(best.path, a, self.fine, free, most).variance for a in filters)])
        return min(best.innovations, self._gain(left, stem))

    def _under_load(self, a: FloatArray, free: NDArray[np.bool_], most: int, ramps: bool = True) -> Loaded:
        """The linear rival under load steps: the same for every stem that it is set against, done once."""
        key = a.tobytes(), free.tobytes(), most, ramps
        if key not in self._under:
            self._under[key] = self.rivals.under_load(self.u, a, self.fine, free, most, ramps=ramps)
        return self._under[key]

    def load(self, free: NDArray[np.bool_]) -> Loaded:
        """Return the load steps under which the linear rival does best, none where they add no more than chance."""
        best = self._under_load(self.linear.a, free, FEW // 2, ramps=False)
        more = best.steps and self._gain(self.rival.variance, best.variance) > Thresholds().chance
        return best if more else Loaded(self.rival.variance, np.zeros(self.rivals.n), 0)

    def swung(self, judged: Candidate) -> Candidate:
        """Return a valve with a sinusoidal disturbance beside it where that is likelier, as its rival may have one.

        Frequency, size and phase are paid for by ln N each, which the rival does not pay.
        """
        fit = self.rivals.beside_sinusoid(judged.path, judged.fit, self.fine)
        innovations = self._gain(self.rival.variance, fit.variance) - SINUSOID * math.log(self.rivals.count)
        return replace(judged, fit=fit, innovations=innovations) if innovations > judged.innovations else judged

    def instead(self, met: list[Candidate]) -> float:
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

    def over_wave(self, met: list[Candidate], period: float) -> float:
        """Return what the best stem is ahead of a wave of PV's period in the free predictor, beside OP or in its place.

        The best likelihood ratio over the linear rival where that is chance, or PV has no period (nan; samples).
        """
        best = max(c.innovations for c in met)
        if not (best > Thresholds().chance and math.isfinite(period) and self.free.enough):
            return best
        if period not in self._wave:
            self._wave[period] = steady_wave(self.free, self.rivals.y, period)
        wave = self._wave[period]
        ahead = self._ahead(met, wave, wave)
        if ahead < Thresholds().chance:
            return ahead
        # Not asked where equal halves do as well.
        if period not in self._uneven:
            self._uneven[period] = uneven_wave(self.free, self.rivals.y, period)
        return min(ahead, self._ahead(met, *self._uneven[period]))

    def _ahead(self, met: list[Candidate], beside: float, instead: float) -> float:
        """What the best stem is ahead of a wave that adds so much, beside OP or in its place."""
        ahead = max(c.linearly for c in met) - beside
        # Not asked where it changes nothing.
        return ahead if beside <= 0.0 else max([ahead, *(self._instead(c.path) - instead for c in met)])

    @property
    def squares(self) -> float:
        """What squares add to the free linear predictor; 0 where they are not asked."""
        return self.known[-1].ahead_of(self.free)

    @cached_property
    def turns(self) -> float:
        """What PV's own turns add to the free predictor."""
        return turns_of_pv(self.free, self.rivals.delays.tolist())

    def told(self, fitted: Fitted) -> list[Candidate]:
        """Return a model's valve judged, and the best found about it."""
        judged = [self.judged(Law(fitted[0], 0.0), fitted[1], a) for a in (self.white, self.linear.a)]
        return [*judged, self.closer(max(judged, key=lambda c: c.innovations))]

    def closer(self, best: Candidate) -> Candidate:
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


@lru_cache(maxsize=KEPT)
def search_of(y: bytes, u: bytes, held: bytes, delays: tuple[int, ...], sign: float, blur: float) -> Search:
    """The search in a stretch of PV, about its mean, and OP, as their numbers stand in memory (see `stem._among`)."""
    pv, op, still = np.frombuffer(y).copy(), np.frombuffer(u).copy(), np.frombuffer(held, dtype=np.bool_).copy()
    return Search(Rivals(pv, list(delays), sign, still), op, still, float(pv[~still].var()), blur)
