"""The strongest sinusoid in what a model leaves of PV."""

from __future__ import annotations

import math

import numpy as np

from workbench.model.record import FloatArray

__all__ = ["FEWEST_PERIODS", "slowest", "strongest"]

FEWEST_PERIODS = 3  # of a sinusoidal disturbance
FINER = 4  # its frequency against that of the record's own


def slowest(n: int) -> float:
    """Return the angular frequency, rad a sample, of which n samples hold just enough periods to tell it from drift."""
    return 2.0 * math.pi * FEWEST_PERIODS / n


def strongest(e: FloatArray) -> float:
    """Return the angular frequency, rad a sample, of the strongest sinusoid with three periods or more in e, (N,)."""
    n = e.size
    power = np.abs(np.fft.rfft((e - e.mean()) * np.hanning(n), FINER * n)) ** 2
    lowest = FEWEST_PERIODS * FINER
    return 2.0 * math.pi * (lowest + int(np.argmax(power[lowest : FINER * n // 4]))) / (FINER * n)
