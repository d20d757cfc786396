"""Phase between OP and PV: Horch's cross-correlation for self-regulating loops, his histograms for integrating ones."""

from __future__ import annotations

import math

import numpy as np

from workbench.model.record import FloatArray

__all__ = ["LAGS", "VALUES", "cross_correlation", "histogram_fit"]

# Up to the first no stiction, from the second on stiction: for a sinusoid the phases of 30 and 60 degrees.
LAGS = (1.0 / 3.0, 2.0 / 3.0)
VALUES = ((2.0 - math.sqrt(3.0)) / (2.0 + math.sqrt(3.0)), 1.0 / 3.0)

BINS = 31
LONGEST = 2.0  # periods searched for the crossings


def cross_correlation(pv: FloatArray, op: FloatArray, period: float) -> tuple[float, float]:
    """Return (asymmetry of the crossings, asymmetry of the values) of the cross-correlation of OP and PV, 0 to 1 each.

    An odd function, both near 1, speaks for stiction, an even one, both near 0, against. With the lags of the first
    zero crossings right and left of zero, tau_r and tau_l, the value at zero r_0 and the extreme one r_opt between
    them: `|tau_l - tau_r|/(tau_l + tau_r)` and `|r_0 - r_opt|/|r_0 + r_opt|`. Stiction from 2/3 (`LAGS`) and from 1/3
    (`VALUES`) on, none up to 1/3 and (2 - sqrt 3)/(2 + sqrt 3) = 0.072, between them no decision: sinusoids 60 and 30
    degrees out of phase have just these values. For an oscillating self-regulating loop under PI control (A. Horch, "A
    simple method for detection of stiction in control valves", Control Engineering Practice 7 (1999) 1221-1231).
    period: in samples; (nan, nan) where it is nan or the function does not cross zero on both sides.
    """
    if not math.isfinite(period):
        return math.nan, math.nan
    y, u = pv - pv.mean(), op - op.mean()
    n = y.size
    size = 1 << (2 * n - 1).bit_length()
    raw = np.fft.irfft(np.fft.rfft(y, size) * np.conj(np.fft.rfft(u, size)), size)
    reach = min(int(LONGEST * period) + 2, n - 1)
    right, left = raw[: reach + 1], np.concatenate([raw[:1], raw[: -reach - 1 : -1]])
    ends = []
    for side in (right, left):
        over = np.flatnonzero((side[:-1] > 0.0) != (side[1:] > 0.0))
        if over.size == 0:
            return math.nan, math.nan
        i = int(over[0])
        ends.append(i + float(side[i] / (side[i] - side[i + 1])))
    near = np.concatenate([left[int(ends[1]) : 0 : -1], right[: int(ends[0]) + 1]])
    zero, extreme = float(raw[0]), float(near[np.argmax(np.abs(near))])
    total = abs(zero + extreme)
    lags = abs(ends[1] - ends[0]) / (ends[0] + ends[1]) if ends[0] + ends[1] > 0.0 else math.nan
    return lags, min(abs(zero - extreme) / total, 1.0) if total > 0.0 else math.nan


def histogram_fit(pv: FloatArray, period: float) -> float:
    """Return how much better a bell describes the second derivative of PV than the two humps of a sinusoid, -1 to 1.

    For integrating loops: with a sticking valve PV runs in straight lines, so that its second derivative is noise with
    rare peaks, a bell; an external oscillation or tight tuning leaves a sinusoid, whose values crowd at both ends (A.
    Horch, "Condition monitoring of control loops", PhD thesis, KTH Stockholm 2000, ch. 4). The answer is
    `(e_humps - e_bell)/(e_humps + e_bell)` with the squared errors of both densities fitted to the histogram; positive
    speaks for stiction. PV is smoothed over a twelfth of the period (samples) first; nan where the period is nan or
    shorter than 12 samples.
    """
    if not math.isfinite(period) or period < 12.0:
        return math.nan
    width = max(int(period / 12.0), 1)
    smooth = np.convolve(pv, np.ones(width) / width, mode="valid")
    second = smooth[2 * width :] - 2.0 * smooth[width:-width] + smooth[: -2 * width]
    if second.size < BINS or not np.ptp(second) > 0.0:
        return math.nan
    second = (second - second.mean()) / second.std()
    reach = float(np.quantile(np.abs(second), 0.995))
    density, edges = np.histogram(second, bins=BINS, range=(-reach, reach), density=True)
    at = 0.5 * (edges[1:] + edges[:-1])
    angles = np.cos((np.arange(64) + 0.5) * math.pi / 64.0)

    def error(amplitude: float, spread: float) -> float:
        means = amplitude * angles
        shape = np.exp(-0.5 * ((at[:, None] - means) / spread) ** 2).mean(axis=1) / (spread * math.sqrt(2.0 * math.pi))
        return float(((shape - density) ** 2).sum())

    bell = min(error(0.0, s) for s in np.linspace(0.3, 1.2, 19).tolist())
    # A sinusoid has amplitude sqrt(2) of its standard deviation; what is not sinusoid is noise.
    humps = min(error(math.sqrt(2.0 * share), math.sqrt(1.0 - share)) for share in (0.6, 0.7, 0.8, 0.9, 0.95))
    return (humps - bell) / (humps + bell) if humps + bell > 0.0 else math.nan
