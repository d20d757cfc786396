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
from workbench.model.detection import StemTest
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Stenman
from workbench.simulate.run import valve_response

__all__ = ["Fitted", "Law", "laws_of", "stem_test"]

Fitted = tuple[Stenman | Choudhury, FloatArray]

# Valves: widths as a share of OP's range, from what noise leaves visible to what lets the stem move at all.
WIDTHS = np.geomspace(0.03, 0.95, 70).tolist()  # d
BANDS = np.geomspace(0.04, 0.97, 24).tolist()  # S
JUMPS = (0.0, 0.3, 1.0)  # J/S
STARTS = (-0.8, 0.0, 0.8)  # where the stem may rest at the start: OP less stem, as a share of what holds it
WIDE = 0.25  # of OP's range: a band that matters to the loop
ZOOM = (0.94, 0.96, 0.98, 1.02, 1.04, 1.06)  # the widths looked at between those of the grid
FINE = (0.99, 1.01, 0.97, 1.03)  # refinement of the widths
KEPT = 3  # best paths that are refined
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
FLOOR = 0.005  # of PV's standard deviation: no record is good for less


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

    law: Law
    path: FloatArray
    innovations: float
    simulated: float

    @property
    def both(self) -> float:
        if min(self.innovations, self.simulated) <= 0.0:
            return min(self.innovations, self.simulated)
        return self.innovations * self.simulated


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

    def neighbours(self) -> Iterator[Law]:
        """Yield this law with widths up to the next ones of the grid."""
        for factor in ZOOM:
            if isinstance(self.valve, Stenman):
                yield Law(Stenman(self.valve.d * factor), self.rest)
            else:
                for jump in (self.valve.J, 0.85 * self.valve.J, 1.15 * self.valve.J + 0.1 * self.valve.S):
                    yield Law(Choudhury(self.valve.S * factor, jump), self.rest)

    def scaled(self, factor: float) -> Iterator[Law]:
        """Yield this law with its widths scaled."""
        v, rest = self.valve, self.rest * min(factor, 1.0)
        if isinstance(v, Stenman):
            yield Law(Stenman(v.d * factor), rest)
        else:
            yield Law(Choudhury(v.S * factor, v.J * factor), rest)
            yield Law(Choudhury(v.S, v.J * factor), rest * min(factor, 1.0))


def laws_of(width: float) -> list[Law]:
    """Return the grid of valves for an OP that moves over `width` (%)."""
    stenman = [Law(Stenman(w * width), s * w * width) for w in WIDTHS for s in STARTS]
    laws = [Choudhury(b * width, j * b * width) for b in BANDS for j in JUMPS]
    return stenman + [Law(v, s * 0.5 * (v.S + v.J)) for v in laws for s in STARTS]


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
        target = lfilter(a, [1.0], self.y)
        drives = lfilter(a, [1.0], paths - paths[:, :1], axis=1)
        kernel.screen(target, self.live, drives, poles, self.order, self.delays, self.sign, best, tau_at, delay_at)
        return best, tau_at, delay_at

    def plant(self, x: FloatArray, a: FloatArray, taus: Sequence[float]) -> _Fit:
        """Return the best plant driven by x, in the measure of the whitening filter a, the dead time in between too."""
        _, tau_at, delay_at = self.least(x[None, :], a, taus)
        tau, near = taus[int(tau_at[0])], int(self.delays[delay_at[0]])
        target, gains = lfilter(a, [1.0], self.y), np.zeros(2)
        drive = lfilter(a, [1.0], x - x[0])
        best = (math.inf, tau, near, 0.0, 0.0)
        for spread in SPREADS:
            for _ in range(STEPS):
                before = best[0]
                centre, middle = best[1], best[2]
                for trial in (centre / spread, centre, min(centre * spread, LONGEST * self.n)):
                    for delay in range(max(middle - 1, 0), min(middle + 1, self.longest) + 1):
                        pole = math.exp(-1.0 / trial)
                        cost = kernel.taps(target, self.live, drive, pole, self.order, delay, self.sign, gains)
                        if cost < best[0]:
                            best = (cost, trial, delay, float(gains[0]), float(gains[1]))
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

    def noise(self, e: FloatArray, pole: float) -> tuple[float, FloatArray]:
        """Return the innovation variance and whitening filter (1, -a_1, .., -a_p) of a residual, by least squares.

        A constant and a transient with the plant's pole, which the residual still holds, are fitted along.
        """
        order = self.order
        n, live = e.size - order, self.live[order:]
        lags = [e[order - 1 - i : e.size - 1 - i] for i in range(order)]
        columns = np.column_stack([*lags, np.ones(n), pole ** np.arange(n, dtype=np.float64)])[live]
        scale = np.sqrt((columns**2).sum(axis=0))
        scale[scale == 0.0] = 1.0
        columns /= scale
        # A pole just below a sample's makes the transient no more than the constant: the pseudo-inverse shares it.
        terms = np.linalg.pinv(columns.T @ columns, rcond=1e-12, hermitian=True) @ (columns.T @ e[order:][live])
        left = e[order:][live] - columns @ terms
        return float(np.mean(left**2)), np.concatenate([[1.0], -terms[:order] / scale[:order]])


def _best(by_innovations: FloatArray, by_simulation: FloatArray) -> list[int]:
    """Return the best few by either measure."""
    first: list[int] = np.argsort(by_innovations, kind="stable")[:KEPT].tolist()
    return first + [i for i in np.argsort(by_simulation, kind="stable")[:KEPT].tolist() if i not in first]


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
    floor = FLOOR**2 * power
    rivals = _Rivals(y, dead_times(y.size, period / sample_time), sign, held)
    fine = np.geomspace(SHORTEST, LONGEST * y.size, FINE_TAUS).tolist()
    white = np.concatenate([[1.0], np.zeros(rivals.order)])
    unfollowed, alone = rivals.noise(y, 0.5)
    # The two ends of what noise may be: none but white, and all of PV. Each may lead to a better plant.
    linear = min((rivals.settle(u, a, fine, ROUNDS) for a in (white, alone)), key=lambda f: f.variance)

    straight = rivals.plant(u, white, fine)
    laws = laws_of(float(np.ptp(u)))
    paths = np.array([law.path(u) for law in laws])
    coarse = np.geomspace(SHORTEST, LONGEST * y.size, COARSE_TAUS).tolist()

    def judged(law: Law, path: FloatArray) -> _Candidate:
        fit = rivals.settle(path, linear.a, fine, 2)
        simulated = rivals.plant(path, white, fine)
        return _Candidate(
            law,
            path,
            rivals.count * math.log((linear.variance + floor) / (fit.variance + floor)),
            rivals.count * math.log((straight.variance + floor) / (simulated.variance + floor)),
        )

    by_innovations = rivals.least(paths, linear.a, coarse)[0]
    by_simulation = rivals.least(paths, white, coarse)[0]
    # A stem of a width a little off slips at other times: the neighbourhood of the best is searched once more.
    near = [law for i in _best(by_innovations, by_simulation) for law in laws[i].neighbours()]
    closer = np.array([law.path(u) for law in near])
    laws, paths = laws + near, np.vstack([paths, closer])
    by_innovations = np.concatenate([by_innovations, rivals.least(closer, linear.a, coarse)[0]])
    by_simulation = np.concatenate([by_simulation, rivals.least(closer, white, coarse)[0]])
    wide = np.array([law.band >= WIDE * float(np.ptp(u)) for law in laws])
    first = _best(by_innovations, by_simulation)
    best = max((judged(laws[i], paths[i]) for i in first), key=lambda c: c.both)
    for factor in FINE:
        for law in best.law.scaled(factor):
            best = max(best, judged(law, law.path(u)), key=lambda c: c.both)
    if fitted is not None:
        best = max(best, judged(Law(fitted[0], 0.0), fitted[1]), key=lambda c: c.both)
    likely = int(np.argmin(np.where(wide, by_innovations, math.inf)))
    broad = best if best.law.band >= WIDE * float(np.ptp(u)) else judged(laws[likely], paths[likely])
    law = best.law
    moving = np.diff(best.path) != 0.0
    gain = best.innovations
    return StemTest(
        improvement=1.0 - math.exp(-gain / rivals.count),
        likelihood=gain,
        simulated=1.0 - math.exp(-best.simulated / rivals.count),
        wide=broad.innovations,
        left=linear.variance / power,
        unexplained=straight.variance / power,
        unfollowed=unfollowed / power,
        band=law.band,
        jump=law.valve.slip_jump,
        moves=int((moving[1:] & ~moving[:-1]).sum()) + int(moving[0]),
        samples=rivals.count,
        time_constant=straight.tau * sample_time,
        dead_time=straight.delay * sample_time,
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
