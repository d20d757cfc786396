"""How strongly and how slowly a signal oscillates, from its autocorrelation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray

__all__ = ["autocorrelation", "oscillation", "zero_crossings"]

# Thornhill, Huang, Zhang (2003) take the intervals between the first eleven zero crossings; later lags are too noisy.
CROSSINGS = 11


def autocorrelation(signal: FloatArray) -> FloatArray:
    """Return the biased autocorrelation about the mean for lags 0 .. N-1: 1 at lag 0, or zeros if constant."""
    centred = signal - signal.mean()
    # A constant signal may keep rounding dust about its mean: no oscillation is to be read out of that.
    if np.abs(centred).max() <= 1e-12 * max(1.0, float(np.abs(signal).max())):
        return np.zeros(signal.size)
    size = 1 << (2 * signal.size - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    raw = np.fft.irfft(np.abs(spectrum) ** 2, size)[: signal.size]
    acf: FloatArray = raw / raw[0]
    return acf


def zero_crossings(acf: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return (lags, last lags before them) at which an autocorrelation crosses zero, in samples.

    acf: as `autocorrelation` gives it, shape (N,). At most the first eleven crossings within the first half of the
    lags; the lags are linear between samples.
    """
    half = acf[: max(acf.size // 2 + 1, 2)]
    before = np.flatnonzero((half[:-1] > 0.0) != (half[1:] > 0.0))[:CROSSINGS]
    return before + half[before] / (half[before] - half[before + 1]), before


def oscillation(signal: FloatArray, sample_time: float) -> tuple[float, float]:
    """Return (index, period in s) of a signal of shape (N,).

    The index, 0 for a random signal to 1 for a perfect sinusoid, is the decay ratio of the autocorrelation: the height
    of its first positive peak above the line through the minima beside it, over the depth of its first minimum below
    the line through the peaks beside it (T. Miao, D.E. Seborg, "Automatic detection of excessively oscillatory feedback
    control loops", IEEE Int. Conf. Control Applications, 1999). The period is twice the mean interval between the
    autocorrelation's first zero crossings (N.F. Thornhill, B. Huang, H. Zhang, "Detection of multiple oscillations in
    control loops", J. Process Control 13 (2003) 91-100). Without four crossings within the first half of the lags the
    record holds no full oscillation: (0, nan).
    """
    acf = autocorrelation(signal)
    crossings, before = zero_crossings(acf)
    if crossings.size < 4:
        return 0.0, float("nan")
    period = 2.0 * float(np.diff(crossings).mean()) * sample_time
    first, second, third, fourth = (int(i) for i in before[:4])
    trough = first + 1 + int(np.argmin(acf[first + 1 : second + 1]))
    peak = second + 1 + int(np.argmax(acf[second + 1 : third + 1]))
    next_trough = third + 1 + int(np.argmin(acf[third + 1 : fourth + 1]))
    share = (peak - trough) / (next_trough - trough)
    rise = acf[peak] - (acf[trough] + share * (acf[next_trough] - acf[trough]))
    fall = (acf[0] + trough / peak * (acf[peak] - acf[0])) - acf[trough]
    return float(np.clip(rise / fall, 0.0, 1.0)), period
