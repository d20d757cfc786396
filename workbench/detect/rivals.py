"""The two rivals of the stem test: PV of one stretch, answered for by one kind of plant, whatever drives it.

A first-order lag with gain and dead time is fitted in the measure of an autoregression, what no valve explains, which
is fitted in turn; beside a sinusoid from outside, or beside load steps, where that is asked for.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.detect.laws import Laws
from workbench.detect.load_steps import load_steps
from workbench.detect.sinusoid import strongest
from workbench.detect.stem_kernel import plant, screen, settle
from workbench.detect.whitening import noise, whitened
from workbench.model.record import FloatArray
from workbench.simulate import kernel as simulate

__all__ = [
    "FURTHER",
    "LONGEST",
    "SHORTEST",
    "USUAL",
    "Fit",
    "Loaded",
    "Rivals",
    "dead_times",
    "fine_taus",
    "held_of",
    "live_of",
    "order_of",
]

# Plants: time constants and dead times, in samples.
STEP_TAUS, FINE_TAUS = 8, 28
SHORTEST = 0.3
LONGEST = 10.0  # records: as good as an integrating plant
USUAL, FURTHER = 1.0 / 20.0, 1.0 / 4.0  # of the record: the longest dead time, and where PV clearly shows one beyond it
# Order of the autoregression: samples/100 within limits; white noise on a slow drift is no short one.
SHORT, LONG, PER_ORDER = 8, 30, 100
ROUNDS = 3  # of plant and autoregression in turn
HOLD = 5  # samples in which both signals stand still: a running controller with an error moves OP in every one
MOST_RAMPS = 4  # two that come and end: what a stem at rest leaves bends as often as OP does
FURTHEST = 1e6  # times PV's largest value, that a residual may be


@dataclass(frozen=True, slots=True)
class Fit:
    """One rival fitted: innovation variance, time constant and dead time (samples), autoregression, residual."""

    variance: float
    tau: float
    delay: int
    a: FloatArray
    residual: FloatArray


def fine_taus(n: int) -> FloatArray:
    """Return the time constants from which a plant is refined, samples, of a record of n."""
    taus: FloatArray = np.geomspace(SHORTEST, LONGEST * n, FINE_TAUS)
    return taus


@dataclass(frozen=True, slots=True)
class Loaded:
    """A rival under load steps: innovation variance with each step paid for, their part of PV (EU, (N,)), how many.

    times: samples at which PV first answers each; fit: the rival's plant; None without any step.
    """

    variance: float
    wave: FloatArray
    steps: int
    times: tuple[int, ...] = ()
    fit: Fit | None = None


def dead_times(n: int, period: float, share: float = USUAL) -> list[int]:
    """Return the dead times to try, in samples: all up to 4, then by 40 % more, up to the longest that is sensible.

    At most a share of the record, and half of PV's period (samples; nan where it has none).
    """
    longest = max(min(share * n, period / 2.0 if math.isfinite(period) else math.inf), 2.0)
    tried, at = [], 0.0
    while at <= longest:
        tried.append(round(at))
        at = max(at + 1.0, at * 1.4)
    return tried


def held_of(y: FloatArray, u: FloatArray) -> NDArray[np.bool_]:
    """Return the samples in which PV and OP both kept their values for a while: nobody recorded the loop then."""
    still = np.concatenate([[False], (np.diff(y) == 0.0) & (np.diff(u) == 0.0)])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    held = np.zeros(y.size, dtype=bool)
    for first, stop in edges.reshape(-1, 2).tolist():
        if stop - first >= HOLD:
            held[first:stop] = True
    return held


def order_of(n: int) -> int:
    """Return the order of the autoregression for n samples."""
    return min(max(n // PER_ORDER, SHORT), LONG)


def live_of(held: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the innovations, shape (N,), that are known: neither held nor predicted from a sample that was."""
    live: NDArray[np.bool_] = np.convolve(held, np.ones(order_of(held.size) + 1))[: held.size] == 0.0
    return live


class Rivals:
    """PV of one stretch and all that both rivals share."""

    def __init__(self, y: FloatArray, delays: list[int], sign: float, held: NDArray[np.bool_]) -> None:
        self.y, self.n, self.sign = y, y.size, sign
        self.order = order_of(y.size)
        self.live = live_of(held)
        self.count = int(self.live[self.order :].sum())
        self.delays = np.array(delays, dtype=np.int64)
        self.longest = delays[-1]

    def least(self, u: FloatArray, laws: Laws, a: FloatArray, taus: FloatArray) -> FloatArray:
        """Return each stem's least sum of squares over the plants of the grid, in the measure of the filter a."""
        best = np.empty(len(laws.rows))
        kind = simulate.STAIRS if laws.stenman else simulate.TWO_PARAMETER
        rows, target, poles = laws.kernel_rows, whitened(a, self.y), np.exp(-1.0 / taus)
        screen(kind, u, rows, a, target, self.live, poles, self.order, self.delays, self.sign, best)
        return best

    def plant(self, x: FloatArray, a: FloatArray, taus: FloatArray) -> Fit:
        """Return the best plant driven by x, in the measure of the whitening filter a, the dead time in between too."""
        residual = np.empty(self.n)
        cost, tau, delay = plant(
            self.y, x, a, self.live, self.order, taus, self.delays, self.sign, LONGEST * self.n, residual
        )
        return Fit(cost / self.count, tau, delay, a, residual)

    def settle(self, x: FloatArray, a: FloatArray, taus: FloatArray, rounds: int) -> Fit:
        """Return the rival driven by x: plant and autoregression fitted in turn, the best round."""
        filters, residuals = np.empty((rounds, self.order + 1)), np.empty((rounds, self.n))
        longest = LONGEST * self.n
        best, variance, tau, delay = settle(
            self.y, x, a, self.live, self.order, taus, self.delays, self.sign, longest, rounds, filters, residuals
        )
        return Fit(variance, tau, delay, filters[best], residuals[best])

    @property
    def white(self) -> FloatArray:
        """The filter that leaves white noise as it is."""
        return np.concatenate([[1.0], np.zeros(self.order)])

    def alone(self) -> tuple[FloatArray, float]:
        """Return the filter that makes white noise of PV by itself, and the variance of that."""
        a = np.empty(self.order + 1)
        variance = noise(self.y, self.live, self.order, 0.5, a)
        return a, variance

    def linear(self, u: FloatArray, taus: FloatArray) -> Fit:
        """Return the linear rival, driven by OP.

        The two ends of what noise may be, none but white, and all of PV: each may lead to a better plant.
        """
        return min((self.settle(u, a, taus, ROUNDS) for a in (self.white, self.alone()[0])), key=lambda f: f.variance)

    def beside_sinusoid(self, x: FloatArray, fit: Fit, taus: FloatArray) -> Fit:
        """Return the rival driven by x beside a sinusoidal disturbance, the strongest of what `fit` leaves."""
        n, order = self.n, self.order
        # A transient that has died out where samples count may have begun with anything.
        most = FURTHEST * float(np.abs(self.y).max())
        left = np.clip(fit.residual, -most, most)
        angle = strongest(left)
        waves = np.column_stack([np.cos(angle * np.arange(n)), np.sin(angle * np.arange(n)), np.ones(n)])
        wave, fits = np.zeros(n), []
        for _ in range(2):
            columns = whitened(fit.a, waves.T).T[order:][self.live[order:]]
            target = whitened(fit.a, left + wave)[order:][self.live[order:]]
            terms, *_ = np.linalg.lstsq(columns, target, rcond=None)
            wave = waves[:, :2] @ terms[:2]
            fit = self.less(wave).settle(x, fit.a, taus, 2)
            left = np.clip(fit.residual, -most, most)
            fits.append(fit)
        return min(fits, key=lambda f: f.variance)

    def under_load(
        self, x: FloatArray, a: FloatArray, fine: FloatArray, free: NDArray[np.bool_], most: int, *, ramps: bool = True
    ) -> Loaded:
        """Return the least innovation variance beside up to `most` load steps, time and size of each paid for by ln N.

        ramps: ramps in their place too, up to MOST_RAMPS after one that began before. inf, and no steps, where there is
        no place for one.
        """
        kinds = (False, True)[: 1 + ramps]
        left = (one for kind in kinds for one in self.loads(x, a, fine, free, MOST_RAMPS if kind else most, ramps=kind))
        return min(left, key=lambda one: one.variance, default=Loaded(math.inf, np.zeros(self.n), 0))

    def loads(
        self, x: FloatArray, a: FloatArray, fine: FloatArray, free: NDArray[np.bool_], most: int, *, ramps: bool
    ) -> Iterator[Loaded]:
        """Yield the rival beside one load step, beside two, .., up to `most`, each paid for (see `under_load`).

        ramps: beside ramps, of which one began before.
        """
        taus = np.geomspace(SHORTEST, LONGEST * self.n, STEP_TAUS)
        live = self.live.copy()
        live[: self.order] = False
        delays = np.union1d(self.delays[::2], self.delays[-1:])
        price = self.count ** (2.0 / self.count)
        asked = self.y, x, a, live, free, taus, delays, self.sign
        for k, (wave, times) in enumerate(load_steps(*asked, most, ramps), 1 + ramps):
            fit = self.less(wave).settle(x, a, fine, 2)
            yield Loaded(fit.variance * price**k, wave, k, tuple(times), fit)

    def less(self, wave: FloatArray) -> Rivals:
        """Return the same without a part of PV."""
        rivals = copy.copy(self)
        rivals.y = self.y - wave
        return rivals
