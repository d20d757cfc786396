"""How strongly and how slowly a signal oscillates, from its autocorrelation."""

from __future__ import annotations

import numpy as np

from workbench.model.record import FloatArray

__all__ = ["autocorrelation", "oscillation"]

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
    half = acf[: max(signal.size // 2 + 1, 2)]
    after = np.flatnonzero((half[:-1] > 0.0) != (half[1:] > 0.0))
    if after.size < 4:
        return 0.0, float("nan")
    crossings = (after + half[after] / (half[after] - half[after + 1]))[:CROSSINGS]
    period = 2.0 * float(np.diff(crossings).mean()) * sample_time
    first, second, third, fourth = (int(i) for i in after[:4])
    trough = first + 1 + int(np.argmin(half[first + 1 : second + 1]))
    peak = second + 1 + int(np.argmax(half[second + 1 : third + 1]))
    next_trough = third + 1 + int(np.argmin(half[third + 1 : fourth + 1]))
    share = (peak - trough) / (next_trough - trough)
    rise = half[peak] - (half[trough] + share * (half[next_trough] - half[trough]))
    fall = (half[0] + trough / peak * (half[peak] - half[0])) - half[trough]
    return float(np.clip(rise / fall, 0.0, 1.0)), period
