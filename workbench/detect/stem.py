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

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from workbench.detect import kernel
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Stenman
from workbench.simulate.run import valve_response

__all__ = ["StemTest", "stem_test"]

# Valves: widths as a share of OP's range, from what noise leaves visible to what lets the stem move at all.
WIDTHS = np.geomspace(0.03, 0.95, 20).tolist()  # d
BANDS = np.geomspace(0.04, 0.97, 14).tolist()  # S
JUMPS = (0.0, 0.3, 1.0)  # J/S
STARTS = (-0.8, 0.0, 0.8)  # where the stem may rest at the start: OP less stem, as a share of what holds it
WIDE = 0.25  # of OP's range: a band that matters to the loop
FINE = (0.85, 0.93, 1.08, 1.17)  # refinement of the widths
KEPT = 3  # best paths that are refined
# Plants: time constants and dead times, in samples.
COARSE_TAUS, FINE_TAUS = 7, 22
SHORTEST = 0.3
ORDER = 4  # of the autoregression: noise on a drift needs two, a cycle left over two more
SPREADS = (1.25, 1.08, 1.03)  # refinement of the time constant
ROUNDS = 3  # of plant and autoregression in turn
WINDOW, WINDOWS = 3000, 3  # samples of one stretch, and the stretches of a long record
PER_CYCLE = 100  # samples of a cycle: more are thinned out
FLOOR = 0.005  # of PV's standard deviation: no record is good for less


@dataclass(frozen=True, slots=True)
class StemTest:
    """How a sticking stem compares with the linear loop; time constant and dead time of the linear one in s.

    improvement: share of the linear rival's innovation variance that the stem explains; likelihood: the log likelihood
    ratio, N times its logarithm. wide: the same ratio for the best stem with a band of a quarter of OP's range or
    more, at most 0 where such a stem fits no better. left: share of PV's variance that the linear rival leaves as
    innovations; unfollowed: likewise without any input. band: width (%) of the best stem's stick band (Stenman: d);
    jump: its slip jump; moves: times that it set off or turned.
    """

    improvement: float
    likelihood: float
    simulated: float
    wide: float
    left: float
    unexplained: float
    unfollowed: float
    band: float
    jump: float
    moves: int
    samples: int
    time_constant: float
    dead_time: float


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
    """A valve and its log likelihood ratios over the linear rival: of the innovations, and of the simulated PV."""

    law: _Law
    innovations: float
    simulated: float

    @property
    def both(self) -> float:
        if min(self.innovations, self.simulated) <= 0.0:
            return min(self.innovations, self.simulated)
        return self.innovations * self.simulated


@dataclass(frozen=True, slots=True)
class _Law:
    """A valve of the grid and where its stem rests at the start: OP less stem, %."""

    valve: Stenman | Choudhury
    rest: float

    @property
    def band(self) -> float:
        return self.valve.d if isinstance(self.valve, Stenman) else self.valve.S

    def path(self, u: FloatArray) -> FloatArray:
        return valve_response(self.valve, u, float(u[0]), float(u[0]) - self.rest)

    def scaled(self, factor: float) -> Iterator[_Law]:
        v, rest = self.valve, self.rest * min(factor, 1.0)
        if isinstance(v, Stenman):
            yield _Law(Stenman(v.d * factor), rest)
        else:
            yield _Law(Choudhury(v.S * factor, v.J * factor), rest)
            yield _Law(Choudhury(v.S, v.J * factor), rest * min(factor, 1.0))


def _laws(width: float) -> list[_Law]:
    stenman = [_Law(Stenman(w * width), s * w * width) for w in WIDTHS for s in STARTS]
    laws = [Choudhury(b * width, j * b * width) for b in BANDS for j in JUMPS]
    return stenman + [_Law(v, s * 0.5 * (v.S + v.J)) for v in laws for s in STARTS]


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


class _Rivals:
    """PV of one stretch and all that both rivals share."""

    def __init__(self, y: FloatArray, delays: list[int], sign: float) -> None:
        self.y, self.n, self.sign = y, y.size, sign
        self.delays = np.array(delays, dtype=np.int64)

    def least(
        self, paths: FloatArray, a: FloatArray, taus: Sequence[float]
    ) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
        """Return each path's least sum of squares over the plants of the grid, and which time and dead time gave it."""
        best = np.empty(paths.shape[0])
        tau_at, delay_at = np.zeros(best.size, dtype=np.int64), np.zeros(best.size, dtype=np.int64)
        poles = np.exp(-1.0 / np.asarray(taus))
        target = lfilter(a, [1.0], self.y)
        kernel.screen(target, paths, poles, a, self.delays, self.sign, best, tau_at, delay_at)
        return best, tau_at, delay_at

    def plant(self, x: FloatArray, a: FloatArray, taus: Sequence[float]) -> _Fit:
        """Return the best plant driven by x, in the measure of the whitening filter a, the dead time in between too."""
        _, tau_at, delay_at = self.least(x[None, :], a, taus)
        tau, near = taus[int(tau_at[0])], int(self.delays[delay_at[0]])
        target, gains = lfilter(a, [1.0], self.y), np.zeros(2)
        best = (math.inf, tau, near, 0.0, 0.0)
        for spread in SPREADS:
            centre, middle = best[1], best[2]
            for factor in (1.0 / spread, 1.0, spread):
                for delay in range(max(middle - 1, 0), middle + 2):
                    pole = math.exp(-1.0 / (centre * factor))
                    cost = kernel.taps(target, x, pole, a, delay, self.sign, gains)
                    if cost < best[0]:
                        best = (cost, centre * factor, delay, float(gains[0]), float(gains[1]))
        cost, tau, delay, g0, g1 = best
        lag = np.empty(self.n)
        kernel.lagged(x, math.exp(-1.0 / tau), np.ones(1), lag)
        answer = np.zeros(self.n)
        answer[delay:] = g0 * lag[: self.n - delay]
        answer[delay + 1 :] += g1 * lag[: self.n - delay - 1]
        return _Fit(cost / (self.n - a.size + 1), tau, delay, a, self.y - answer)

    def settle(self, x: FloatArray, a: FloatArray, taus: Sequence[float], rounds: int) -> _Fit:
        """Return the rival driven by x: plant and autoregression fitted in turn, the best round."""
        fits = []
        for _ in range(rounds):
            fit = self.plant(x, a, taus)
            variance, a = _autoregression(fit.residual, math.exp(-1.0 / fit.tau))
            fits.append(_Fit(variance, fit.tau, fit.delay, a, fit.residual))
        return min(fits, key=lambda f: f.variance)


def _autoregression(e: FloatArray, pole: float) -> tuple[float, FloatArray]:
    """Return the innovation variance and whitening filter (1, -a_1, .., -a_p) of a residual, by least squares.

    A constant and a transient with the plant's pole, which the residual still holds, are fitted along.
    """
    n = e.size - ORDER
    lags = [e[ORDER - 1 - i : e.size - 1 - i] for i in range(ORDER)]
    columns = np.column_stack([*lags, np.ones(n), pole ** np.arange(n, dtype=np.float64)])
    scale = np.sqrt((columns**2).sum(axis=0))
    scale[scale == 0.0] = 1.0
    terms, *_ = np.linalg.lstsq(columns / scale, e[ORDER:], rcond=1e-10)
    left = e[ORDER:] - columns @ (terms / scale)
    return float(np.mean(left**2)), np.concatenate([[1.0], -terms[:ORDER] / scale[:ORDER]])


def _stretch(y: FloatArray, u: FloatArray, sample_time: float, period: float, sign: float) -> StemTest:
    y, u = y - y.mean(), u - u.mean()
    n = y.size
    floor = FLOOR**2 * float(y.var())
    rivals = _Rivals(y, dead_times(n, period / sample_time), sign)
    fine = np.geomspace(SHORTEST, n, FINE_TAUS).tolist()
    white = np.concatenate([[1.0], np.zeros(ORDER)])
    unfollowed, alone = _autoregression(y, 0.5)
    # The two ends of what noise may be: none but white, and all of PV. Each may lead to a better plant.
    linear = min((rivals.settle(u, a, fine, ROUNDS) for a in (white, alone)), key=lambda f: f.variance)

    straight = rivals.plant(u, white, fine)
    laws = _laws(float(np.ptp(u)))
    paths = np.array([law.path(u) for law in laws])
    coarse = np.geomspace(SHORTEST, n, COARSE_TAUS).tolist()
    wide = np.array([law.band >= WIDE * float(np.ptp(u)) for law in laws])

    def judged(law: _Law, path: FloatArray) -> _Candidate:
        fit = rivals.settle(path, linear.a, fine, 2)
        simulated = rivals.plant(path, white, fine)
        return _Candidate(
            law,
            n * math.log((linear.variance + floor) / (fit.variance + floor)),
            n * math.log((straight.variance + floor) / (simulated.variance + floor)),
        )

    by_innovations = rivals.least(paths, linear.a, coarse)[0]
    by_simulation = rivals.least(paths, white, coarse)[0]
    first = np.argsort(by_innovations, kind="stable")[:KEPT].tolist()
    first += [i for i in np.argsort(by_simulation, kind="stable")[:KEPT].tolist() if i not in first]
    best = max((judged(laws[i], paths[i]) for i in first), key=lambda c: c.both)
    for factor in FINE:
        for law in best.law.scaled(factor):
            best = max(best, judged(law, law.path(u)), key=lambda c: c.both)
    likely = int(np.argmin(np.where(wide, by_innovations, math.inf)))
    broad = best if best.law.band >= WIDE * float(np.ptp(u)) else judged(laws[likely], paths[likely])
    law = best.law
    moving = np.diff(law.path(u)) != 0.0
    gain = best.innovations
    power = float(y.var())
    return StemTest(
        improvement=1.0 - math.exp(-gain / n),
        likelihood=gain,
        simulated=1.0 - math.exp(-best.simulated / n),
        wide=broad.innovations,
        left=linear.variance / power,
        unexplained=straight.variance / power,
        unfollowed=unfollowed / power,
        band=law.band,
        jump=law.valve.slip_jump,
        moves=int((moving[1:] & ~moving[:-1]).sum()) + int(moving[0]),
        samples=n,
        time_constant=linear.tau * sample_time,
        dead_time=linear.delay * sample_time,
    )


def stem_test(pv: FloatArray, op: FloatArray, sample_time: float, period: float, sign: float) -> StemTest:
    """Return the stem test of PV (EU) and OP (%), shape (N,), both moving.

    period: s, of PV's oscillation, nan where it has none. sign: that the plant's gain must have, +1 or -1, 0 where it
    is not known. A cycle of more than 100 samples is thinned to that, and of a long record three stretches of 3,000
    samples are looked at, evenly spaced, whose likelihoods add up; the rest is told for the first of them.
    """
    thin = max(int(period / sample_time / PER_CYCLE), 1) if math.isfinite(period) else 1
    pv, op, step = pv[::thin], op[::thin], thin * sample_time
    n = pv.size
    if n <= WINDOW:
        return _stretch(pv, op, step, period, sign)
    count = min(-(-n // WINDOW), WINDOWS)
    starts = np.linspace(0, n - WINDOW, count).astype(int).tolist()
    parts = [
        _stretch(pv[s : s + WINDOW], op[s : s + WINDOW], step, period, sign)
        for s in starts
        if np.ptp(pv[s : s + WINDOW]) > 0.0 and np.ptp(op[s : s + WINDOW]) > 0.0
    ]
    if not parts:
        return _stretch(pv, op, step, period, sign)
    total = sum(p.samples for p in parts)
    gain = sum(p.likelihood for p in parts)
    lead = max(parts, key=lambda p: p.likelihood)
    return StemTest(
        improvement=1.0 - math.exp(-gain / total),
        likelihood=gain,
        simulated=float(np.median([p.simulated for p in parts])),
        wide=sum(p.wide for p in parts),
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
