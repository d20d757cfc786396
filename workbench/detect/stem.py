"""The stem test: does a valve that sticks explain PV better than the linear loop does?

Two rivals answer for PV with the same kind of plant, a first-order lag with gain and dead time: in one OP itself drives
it, in the other the stem of a valve that sticks. What no valve explains, disturbances and noise, is an autoregression
of low order in both, so that a slow drift counts for as little as it tells (generalized least squares; D. Cochrane,
G. Orcutt, J. American Statistical Association 44 (1949) 32-61). What counts is by how much the stem lowers the variance
of the innovations, `1 - s_stem^2/s_linear^2`, and the log likelihood ratio `N ln(s_linear^2/s_stem^2)`.

The plant is causal and of low order on purpose: a free impulse response copies the controller's inverse, and a dead
time of more than half a cycle passes for any phase. Valves and plants come from a coarse grid with a short refinement:
enough for a verdict; `estimate` finds the model.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.detect import kernel
from workbench.detect.predictor import FreePredictor
from workbench.model.detection import StemTest
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Stenman
from workbench.simulate.run import valve_response

__all__ = ["Fitted", "Law", "dead_times", "laws_of", "stem_test", "whitened"]

Fitted = tuple[Stenman | Choudhury, FloatArray]

# Valves: widths as a share of OP's range, from what noise leaves visible to what lets the stem move at all.
WIDTHS = np.geomspace(0.03, 0.95, 70).tolist()  # d
BANDS = np.geomspace(0.04, 0.97, 48).tolist()  # S
JUMPS = (0.0, 0.3, 0.9, 1.4)  # J/S
STARTS = (-0.8, 0.0, 0.8)  # where the stem may rest at the start: OP less stem, as a share of what holds it
WIDE = 0.25  # of OP's range: a band that matters to the loop, one of CLASSES
CLOSER = (0.06, 0.03, 0.012, 0.005)  # widths are searched on by up to twice these shares
CLASSES = (0.1, 0.25, 0.5)  # of OP's range: between narrow and wide bands
# Plants: time constants and dead times, in samples.
COARSE_TAUS, FINE_TAUS = 8, 28
SHORTEST = 0.3
LONGEST = 10.0  # records: as good as an integrating plant
SHORT, LONG, PER_ORDER = (
    8,
    30,
    100,
)  # order of the autoregression: samples/100 within limits; white noise on a slow drift is no short one
SPREADS = (1.25, 1.08, 1.03)  # refinement of the time constant, the dead time by whole samples beside it
STEPS = 12  # at most, at each of them
ROUNDS = 3  # of plant and autoregression in turn
WINDOW, WINDOWS = 3000, 3  # samples of one stretch, and the stretches of a long record
PER_CYCLE = 100  # samples of a cycle: more are thinned out
HOLD = 5  # samples in which both signals stand still: a running controller with an error moves OP in every one
LEAST_LIVE = 0.25  # of a record: where less is left it is the loop itself that rests
FEWEST_PERIODS = 3  # of a sinusoidal disturbance that the linear rival may have beside it
FINER = 4  # its frequency against that of the record's own
FLOOR = 0.005  # of PV's standard deviation: no record is good for less
HARM = 0.5  # a stem that simulates PV worse than OP itself does by more than this share is not this loop's


@dataclass(frozen=True, slots=True)
class _Fit:
    """One rival fitted: innovation variance, time constant and dead time (samples), autoregression, residual."""

    variance: float
    tau: float
    delay: int
    a: FloatArray
    residual: FloatArray


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A valve and its log likelihood ratios over the linear rival: of the innovations, and of the simulated PV.

    adds: that over the free linear predictor. samples: that count.
    """

    law: Law
    path: FloatArray
    fit: _Fit
    innovations: float
    simulated: float
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


@dataclass(frozen=True, slots=True)
class Law:
    """A valve of the grid and where its stem rests at the start: OP less stem, %."""

    valve: Stenman | Choudhury
    rest: float

    @property
    def band(self) -> float:
        """Width of the stick band, % (Stenman: d)."""
        return self.valve.d if isinstance(self.valve, Stenman) else self.valve.S

    def path(self, u: FloatArray) -> FloatArray:
        """Return the stem under OP, %, shape (N,)."""
        return valve_response(self.valve, u, float(u[0]), float(u[0]) - self.rest)

    def about(self, spread: float) -> list[Law]:
        """Return laws about this one: widths scaled by up to twice the spread, the jump and the rest moved."""
        factors = [1.0 + spread * f for f in (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)]
        v, rest = self.valve, self.rest
        found: list[Law] = []
        if isinstance(v, Stenman):
            found += [Law(Stenman(v.d * f), r) for f in (*factors, 1.0) for r in (rest * f, rest - 4.0 * spread * v.d)]
            found.append(Law(v, rest + 4.0 * spread * v.d))
        else:
            more = 3.0 * spread * v.J + spread * v.S
            jumps = (v.J, v.J + more, max(v.J - more, 0.0))
            found += [Law(Choudhury(v.S * f, J), rest) for f in (*factors, 1.0) for J in jumps]
            found += [Law(v, rest + f * spread * v.S) for f in (-3.0, 3.0)]
        return [law for law in found if abs(law.rest) <= law.reach]

    @property
    def reach(self) -> float:
        """How far OP may be from a stem at rest, %."""
        return self.valve.d if isinstance(self.valve, Stenman) else 0.5 * (self.valve.S + self.valve.J)


def laws_of(width: float) -> list[Law]:
    """Return the grid of valves for an OP that moves over `width` (%)."""
    stenman = [Law(Stenman(w * width), s * w * width) for w in WIDTHS for s in STARTS]
    laws = [Choudhury(b * width, j * b * width) for b in BANDS for j in JUMPS]
    return stenman + [Law(v, 0.0) for v in laws]


def dead_times(n: int, period: float) -> list[int]:
    """Return the dead times to try, in samples: all up to 4, then by 40 % more, up to the longest that is sensible.

    At most a twentieth of the record and half of PV's period (samples; nan where it has none).
    """
    longest = max(min(n / 20.0, period / 2.0 if math.isfinite(period) else math.inf), 2.0)
    tried, at = [], 0.0
    while at <= longest:
        tried.append(round(at))
        at = max(at + 1.0, at * 1.4)
    return tried


def whitened(a: FloatArray, rows: FloatArray) -> FloatArray:
    """Return signals, shape (N,) or (R, N), filtered by a = (1, -a_1, .., -a_p), as if they had been 0 before."""
    if a.size == 1:
        return rows
    out = np.empty(rows.shape)
    kernel.whiten(a, np.atleast_2d(np.ascontiguousarray(rows)), np.atleast_2d(out))
    return out


def _held(y: FloatArray, u: FloatArray) -> NDArray[np.bool_]:
    """Return the samples in which PV and OP both kept their values for a while: nobody recorded the loop then."""
    still = np.concatenate([[False], (np.diff(y) == 0.0) & (np.diff(u) == 0.0)])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    held = np.zeros(y.size, dtype=bool)
    for first, stop in edges.reshape(-1, 2).tolist():
        if stop - first >= HOLD:
            held[first:stop] = True
    return held


def _order(n: int) -> int:
    return min(max(n // PER_ORDER, SHORT), LONG)


def _innovations(held: NDArray[np.bool_]) -> NDArray[np.bool_]:
    live: NDArray[np.bool_] = np.convolve(held, np.ones(_order(held.size) + 1))[: held.size] == 0.0
    return live


class _Rivals:
    """PV of one stretch and all that both rivals share."""

    def __init__(self, y: FloatArray, delays: list[int], sign: float, held: NDArray[np.bool_]) -> None:
        self.y, self.n, self.sign = y, y.size, sign
        # An innovation is known where neither its sample nor one of those that it is predicted from was held.
        self.order = _order(y.size)
        self.live = _innovations(held)
        self.count = int(self.live[self.order :].sum())
        self.delays = np.array(delays, dtype=np.int64)
        self.longest = delays[-1]

    def least(
        self, paths: FloatArray, a: FloatArray, taus: Sequence[float]
    ) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
        """Return each path's least sum of squares over the plants of the grid, and which time and dead time gave it."""
        best = np.empty(paths.shape[0])
        tau_at, delay_at = np.zeros(best.size, dtype=np.int64), np.zeros(best.size, dtype=np.int64)
        poles = np.exp(-1.0 / np.asarray(taus))
        target = whitened(a, self.y)
        drives = whitened(a, paths - paths[:, :1])
        kernel.screen(target, self.live, drives, poles, self.order, self.delays, self.sign, best, tau_at, delay_at)
        return best, tau_at, delay_at

    def plant(self, x: FloatArray, a: FloatArray, taus: Sequence[float]) -> _Fit:
        """Return the best plant driven by x, in the measure of the whitening filter a, the dead time in between too."""
        _, tau_at, delay_at = self.least(x[None, :], a, taus)
        tau, near = taus[int(tau_at[0])], int(self.delays[delay_at[0]])
        target, costs, gains = whitened(a, self.y), np.empty(3), np.zeros((3, 2))
        drive = whitened(a, x - x[0])
        best = (math.inf, tau, near, 0.0, 0.0)
        seen: set[tuple[float, int, int]] = set()
        for spread in SPREADS:
            for _ in range(STEPS):
                before = best[0]
                centre, middle = best[1], best[2]
                for trial in (centre / spread, centre, min(centre * spread, LONGEST * self.n)):
                    delays = (max(middle - 1, 0), min(middle + 1, self.longest))
                    if (trial, *delays) in seen:
                        continue
                    seen.add((trial, *delays))
                    pole = math.exp(-1.0 / trial)
                    kernel.taps(target, self.live, drive, pole, self.order, delays, self.sign, costs, gains)
                    i = int(np.argmin(costs[: delays[1] - delays[0] + 1]))
                    if costs[i] < best[0]:
                        best = (float(costs[i]), trial, delays[0] + i, float(gains[i, 0]), float(gains[i, 1]))
                if not best[0] < before:
                    break
        cost, tau, delay, g0, g1 = best
        lag = np.empty(self.n)
        kernel.lagged(x - x[0], math.exp(-1.0 / tau), lag)
        answer = np.zeros(self.n)
        answer[delay:] = g0 * lag[: self.n - delay]
        answer[delay + 1 :] += g1 * lag[: self.n - delay - 1]
        return _Fit(cost / self.count, tau, delay, a, self.y - answer)

    def settle(self, x: FloatArray, a: FloatArray, taus: Sequence[float], rounds: int) -> _Fit:
        """Return the rival driven by x: plant and autoregression fitted in turn, the best round."""
        fits = []
        for _ in range(rounds):
            fit = self.plant(x, a, taus)
            variance, a = self.noise(fit.residual, math.exp(-1.0 / fit.tau))
            fits.append(_Fit(variance, fit.tau, fit.delay, a, fit.residual))
        return min(fits, key=lambda f: f.variance)

    def beside_sinusoid(self, x: FloatArray, fit: _Fit, taus: Sequence[float]) -> _Fit:
        """Return the rival driven by x beside a sinusoidal disturbance, the strongest of what `fit` leaves."""
        n, order = self.n, self.order
        angle = _strongest(fit.residual)
        waves = np.column_stack([np.cos(angle * np.arange(n)), np.sin(angle * np.arange(n)), np.ones(n)])
        wave, fits = np.zeros(n), []
        for _ in range(2):
            columns = whitened(fit.a, waves.T).T[order:][self.live[order:]]
            target = whitened(fit.a, fit.residual + wave)[order:][self.live[order:]]
            terms, *_ = np.linalg.lstsq(columns, target, rcond=None)
            wave = waves[:, :2] @ terms[:2]
            fit = self._less(wave).settle(x, fit.a, taus, 2)
            fits.append(fit)
        return min(fits, key=lambda f: f.variance)

    def _less(self, wave: FloatArray) -> _Rivals:
        rivals = copy.copy(self)
        rivals.y = self.y - wave
        return rivals

    def noise(self, e: FloatArray, pole: float) -> tuple[float, FloatArray]:
        """Return the innovation variance and whitening filter (1, -a_1, .., -a_p) of a residual, by least squares.

        A constant and a transient with the plant's pole, which the residual still holds, are fitted along.
        """
        order = self.order
        gram, side = np.empty((order + 2, order + 2)), np.empty(order + 2)
        kernel.own_products(e, self.live, order, pole, gram, side)
        scale = np.sqrt(np.diag(gram))
        scale[scale == 0.0] = 1.0
        # A pole just below a sample's makes the transient no more than the constant: the pseudo-inverse shares it.
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-12, hermitian=True)
        terms = (inverse @ (side / scale)) / scale
        a: FloatArray = np.concatenate([[1.0], -terms[:order]])
        left = whitened(a, e)[order:] - terms[order] - terms[order + 1] * pole ** np.arange(e.size - order)
        return float(np.mean(left[self.live[order:]] ** 2)), a


def _strongest(e: FloatArray) -> float:
    """Return the angular frequency, rad a sample, of the strongest sinusoid with three periods or more in e."""
    n = e.size
    power = np.abs(np.fft.rfft((e - e.mean()) * np.hanning(n), FINER * n)) ** 2
    lowest = FEWEST_PERIODS * FINER
    return 2.0 * math.pi * (lowest + int(np.argmax(power[lowest : FINER * n // 4]))) / (FINER * n)


def _best(costs: FloatArray, most: int) -> list[int]:
    """Return where the lowest costs are, the lowest first."""
    first: list[int] = np.argsort(costs, kind="stable")[:most].tolist()
    return first


class _Search:
    """The search for the stem that beats the linear rival of one stretch."""

    def __init__(self, rivals: _Rivals, u: FloatArray, held: NDArray[np.bool_], power: float) -> None:
        self.rivals, self.u, self.power = rivals, u, power
        self.fine = np.geomspace(SHORTEST, LONGEST * rivals.n, FINE_TAUS).tolist()
        self.white = np.concatenate([[1.0], np.zeros(rivals.order)])
        self.unfollowed, alone = rivals.noise(rivals.y, 0.5)
        # The two ends of what noise may be: none but white, and all of PV. Each may lead to a better plant.
        linear = (rivals.settle(u, a, self.fine, ROUNDS) for a in (self.white, alone))
        self.linear = min(linear, key=lambda f: f.variance)
        # A sinusoid from outside is no valve's work; an autoregression under noise does not see all of it.
        self.rival = min(self.linear, rivals.beside_sinusoid(u, self.linear, self.fine), key=lambda f: f.variance)
        self.straight = rivals.plant(u, self.white, self.fine)
        self.free = FreePredictor(rivals.y, u, held, FLOOR**2 * power, rivals.longest)

    def _gain(self, rival: _Fit, fit: _Fit) -> float:
        floor = FLOOR**2 * self.power
        return self.rivals.count * math.log((rival.variance + floor) / (fit.variance + floor))

    def judged(self, law: Law, path: FloatArray, a: FloatArray, taus: Sequence[float] | None = None) -> _Candidate:
        """Return a valve with its likelihoods, its plant and noise fitted in turn from the whitening filter a.

        taus: the time constants to start from, samples; then its simulation is not looked at.
        """
        fit = self.rivals.settle(path, a, self.fine if taus is None else taus, 2)
        simulated, adds = -math.inf, 0.0
        if taus is None:
            simulated = self._gain(self.straight, self.rivals.plant(path, self.white, self.fine))
            adds = self.free.adds(path, fit.delay)
        return _Candidate(law, path, fit, self._gain(self.rival, fit), simulated, adds, self.rivals.count)

    def met(self) -> list[_Candidate]:
        """Return the valves judged: the best of the grid, and those found closer and closer about them."""
        laws = laws_of(float(np.ptp(self.u)))
        paths = np.array([law.path(self.u) for law in laws])
        classes = np.digitize([law.band for law in laws], np.array(CLASSES) * float(np.ptp(self.u)))
        coarse = np.geomspace(SHORTEST, LONGEST * self.rivals.n, COARSE_TAUS).tolist()
        found: list[_Candidate] = []

        # The linear rival's noise holds what the stem would explain, white noise what it would not: once more with
        # the noise of the best so far. Wide and narrow stems are looked at apart: neither is to crowd out the other.
        for start in (self.linear.a, self.white, None):
            a = max(found, key=lambda c: c.innovations).fit.a if start is None else start
            costs = self.rivals.least(paths, a, coarse)[0]
            for part in range(len(CLASSES) + 1):
                i = _best(np.where(classes == part, costs, math.inf), 1)[0]
                found.append(self.judged(laws[i], paths[i], a))
        kinds = np.digitize([c.law.band for c in found], np.array(CLASSES) * float(np.ptp(self.u)))
        leaders = [
            max((c for c, kind in zip(found, kinds, strict=True) if kind == part), key=lambda c: c.innovations)
            for part in range(len(CLASSES) + 1)
        ]
        return found + [self.closer(c) for c in leaders]

    def told(self, fitted: Fitted) -> list[_Candidate]:
        """Return a model's valve judged, and the best found about it."""
        judged = [self.judged(Law(fitted[0], 0.0), fitted[1], a) for a in (self.white, self.linear.a)]
        return [*judged, self.closer(max(judged, key=lambda c: c.innovations))]

    def closer(self, best: _Candidate) -> _Candidate:
        """Return the best about a candidate, closer and closer: a stem a little off slips at other times."""
        for spread in CLOSER:
            laws = best.law.about(spread)
            paths = np.array([law.path(self.u) for law in laws])
            taus = [best.fit.tau * f for f in (0.85, 1.0, 1.18)]
            costs = self.rivals.least(paths, best.fit.a, taus)[0]
            near = [self.judged(laws[i], paths[i], best.fit.a, taus) for i in _best(costs, 2)]
            best = max([best, *near], key=lambda c: c.innovations)
        return self.judged(best.law, best.path, best.fit.a)


def _stretch(
    y: FloatArray, u: FloatArray, sample_time: float, period: float, sign: float, fitted: Fitted | None
) -> StemTest:
    held = _held(y, u)
    if not _innovations(held)[_order(y.size) :].mean() > LEAST_LIVE:
        held[:] = False
    at = np.arange(y.size)
    u = np.interp(at, at[~held], u[~held])
    y, u = y - y[~held].mean(), u - u.mean()
    power = float(y[~held].var())
    rivals = _Rivals(y, dead_times(y.size, period / sample_time), sign, held)
    search = _Search(rivals, u, held, power)
    own = search.met()
    met = own if fitted is None else own + search.told(fitted)
    best, both = max(met, key=lambda c: c.innovations), max(met, key=lambda c: c.both)
    moving = np.diff(best.path) != 0.0
    width = float(np.ptp(u))
    return StemTest(
        predicting=best.innovations,
        improvement=1.0 - math.exp(-both.innovations / rivals.count),
        likelihood=both.innovations,
        simulated=1.0 - math.exp(-both.simulated / rivals.count),
        adds=both.adds,
        sure=max(c.sure for c in met),
        # What chance gives is known for the search's own stems, not for one that a model was fitted with.
        wide=max(c.harmless for c in own if c.law.band >= WIDE * width),
        wide_from=WIDE * width,
        left=search.linear.variance / power,
        unexplained=search.straight.variance / power,
        unfollowed=search.unfollowed / power,
        band=best.law.band,
        jump=best.law.valve.slip_jump,
        moves=int((moving[1:] & ~moving[:-1]).sum()) + int(moving[0]),
        samples=rivals.count,
        time_constant=search.straight.tau * sample_time,
        dead_time=search.straight.delay * sample_time,
    )


def stem_test(
    pv: FloatArray, op: FloatArray, sample_time: float, period: float, sign: float, fitted: Fitted | None = None
) -> StemTest:
    """Return the stem test of PV (EU) and OP (%), shape (N,), both moving.

    period: s, of PV's oscillation, nan where it has none. sign: that the plant's gain must have, +1 or -1, 0 where it
    is not known. fitted: a valve and its stem, %, shape (N,), from a model of the loop, tried beside the grid. A cycle
    of more than 100 samples is thinned to that, and of a long record three stretches of 3,000 samples are looked at,
    evenly spaced, whose likelihoods add up; the rest is told for the clearest of them.
    """
    thin = max(int(period / sample_time / PER_CYCLE), 1) if math.isfinite(period) else 1
    pv, op, step = pv[::thin], op[::thin], thin * sample_time
    n = pv.size

    def part(first: int, stop: int) -> Fitted | None:
        return None if fitted is None else (fitted[0], fitted[1][::thin][first:stop])

    if n <= WINDOW:
        return _stretch(pv, op, step, period, sign, part(0, n))
    count = min(-(-n // WINDOW), WINDOWS)
    starts = np.linspace(0, n - WINDOW, count).astype(int).tolist()
    parts = [
        _stretch(pv[s : s + WINDOW], op[s : s + WINDOW], step, period, sign, part(s, s + WINDOW))
        for s in starts
        if np.ptp(pv[s : s + WINDOW]) > 0.0 and np.ptp(op[s : s + WINDOW]) > 0.0
    ]
    if not parts:
        return _stretch(pv, op, step, period, sign, part(0, n))
    total = sum(p.samples for p in parts)
    gain = sum(p.likelihood for p in parts)
    lead = max(parts, key=lambda p: p.predicting)
    return StemTest(
        predicting=sum(p.predicting for p in parts),
        improvement=1.0 - math.exp(-gain / total),
        likelihood=gain,
        simulated=float(np.median([p.simulated for p in parts])),
        adds=sum(p.adds for p in parts),
        sure=sum(p.sure for p in parts),
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
    )
