"""Noise upon a drift: a disturbance told by three numbers, and the filter that leaves it white."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from workbench.estimate.kernels.drifting import remember
from workbench.model.record import FloatArray

__all__ = ["Drift"]

SHARE, MOST = 30, 400  # of the record, and samples: the filter's length at most
NEAREST = 1e-6  # to 0 and to 1: a drift's pole
QUIET, LOUD = 1e-6, 1e12  # the noise's variance
DIED = 1e-3  # of all that the filter remembers: what it may leave out


@dataclass(frozen=True)
class Drift:
    """White noise e upon a drift s: `s_{k+1} = pole s_k + z_k`, `z_{k+1} = drift z_k + w_k`, w white.

    noise: the variance of e, of w 1. tied: whether the pole is the plant's, through which the load comes as OP does.
    """

    pole: float
    drift: float
    noise: float
    tied: bool

    def moved(self, drift: float, noise: float, pole: float = 0.0) -> Drift:
        """The law a step away: in the logarithm of the noise's share, and of what poles are from 0 and from 1."""
        own = self.pole if self.tied else _between(_unbound(self.pole) + pole)
        sized = min(max(self.noise * math.exp(min(noise, MOST)), QUIET), LOUD)
        return Drift(own, _between(_unbound(self.drift) + drift), sized, self.tied)

    @property
    def terms(self) -> int:
        """How many parameters it has."""
        return 2 if self.tied else 3

    def filter(self, samples: int) -> FloatArray:
        """The filter (1, -a_1, .., -a_p) that leaves it white, as long as it remembers, or as so many samples allow.

        It is `(1 - pole B)(1 - drift B) / D(B)`, D from the steady Kalman filter (`remember`), and takes what the poles
        take, however short it is cut.
        """
        remembered = np.empty(2 * MOST)
        remember(self.pole, self.drift, self.noise, remembered)
        poles = np.convolve([1.0, -self.pole], [1.0, -self.drift])
        later = np.abs(remembered)[::-1].cumsum()[::-1]
        size = int(np.count_nonzero(later >= DIED * later[0]))
        return np.convolve(poles, remembered[: min(size, max(samples // SHARE, 1), MOST)])


def _unbound(pole: float) -> float:
    """A number for a pole between 0 and 1, from below to above all bounds."""
    near = min(max(pole, NEAREST), 1.0 - NEAREST)
    return math.log(near / (1.0 - near))


def _between(number: float) -> float:
    """The pole of that number."""
    return min(max(1.0 / (1.0 + math.exp(min(-number, 50.0))), NEAREST), 1.0 - NEAREST)
