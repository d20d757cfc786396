"""Is the loop nonlinear? Bicoherence with the NGI and NLI, and the ellipse of PV against OP: apparent stiction."""

from __future__ import annotations

import math

import numpy as np

from workbench.model.detection import Bicoherence, Ellipse
from workbench.model.record import FloatArray

__all__ = ["LONG", "NONLINEAR", "SHORTEST", "bicoherence_of", "ellipse_of"]

SEGMENT = 128  # samples; fewer in short records
FEWEST_SEGMENTS = 8
SHORTEST_SEGMENT = 32
SHORTEST = SHORTEST_SEGMENT * (FEWEST_SEGMENTS + 1) // 2  # samples that hold so many, half overlapping
LONG = 4096  # samples that the authors work with
NONLINEAR = 0.01  # NLI above which a non-Gaussian signal counts as nonlinear
SIGNIFICANT = 0.05


def bicoherence_of(signal: FloatArray) -> Bicoherence | None:
    """Return the squared bicoherence of a signal, shape (N,), with its two indices; None where the record is too short.

    `bic^2(f1, f2) = |E[X(f1) X(f2) X*(f1+f2)]|^2 / (E|X(f1) X(f2)|^2 E|X(f1+f2)|^2)` over half-overlapping Hann
    segments, in the principal domain. NLI: `|max - (mean + 2 sd)|` over all, above 0.01 nonlinear (M.A.A.S. Choudhury,
    S.L. Shah, N.F. Thornhill, "Diagnosis of poor control-loop performance using higher-order statistics", Automatica 40
    (2004) 1719-1728). NGI: mean over the significant bicoherences less their critical value, above 0 non-Gaussian, as
    modified by M.A.A.S. Choudhury, D.S. Shook, S.L. Shah, "Linear or nonlinear? A bicoherence based metric of
    nonlinearity measure", IFAC Fault Detection, Supervision and Safety of Technical Processes, Beijing 2006; 0 where no
    more than one pair in twenty is significant, as chance has it. Critical value: 2 K bic^2 is chi^2 with two degrees
    of freedom for a linear Gaussian signal over K segments, taken at 5 %. Such an index wants long records (`LONG`, the
    authors' own).
    """
    n = signal.size
    length = SEGMENT
    while length > SHORTEST_SEGMENT and 2 * n // length - 1 < 4 * FEWEST_SEGMENTS:
        length //= 2
    count = 2 * n // length - 1
    if count < FEWEST_SEGMENTS or not np.ptp(signal) > 0.0:
        return None
    starts = np.arange(count) * (length // 2)
    pieces = signal[starts[:, None] + np.arange(length)]
    pieces = (pieces - pieces.mean(axis=1, keepdims=True)) * np.hanning(length)
    spectra = np.fft.rfft(pieces, axis=1)
    top = length // 2
    i, j = np.meshgrid(np.arange(1, top), np.arange(1, top), indexing="ij")
    domain = (j <= i) & (i + j <= top)
    i, j = i[domain], j[domain]
    pair = spectra[:, i] * spectra[:, j]
    third = spectra[:, i + j]
    over = (np.abs(pair) ** 2).mean(axis=0) * (np.abs(third) ** 2).mean(axis=0)
    values = np.abs((pair * np.conj(third)).mean(axis=0)) ** 2 / np.maximum(over, 1e-300)
    # Frequencies that hold nothing but rounding have a bicoherence of their own making.
    values[over <= 1e-12 * over.max()] = 0.0
    critical = -math.log(SIGNIFICANT) / count
    significant = values[values > critical]
    ngi = float(significant.mean()) - critical if significant.size > SIGNIFICANT * values.size else 0.0
    return Bicoherence(
        frequency_1=i / length,
        frequency_2=j / length,
        values=values,
        ngi=ngi,
        critical=critical,
        nli=abs(float(values.max()) - float(values.mean()) - 2.0 * float(values.std())),
        segments=count,
    )


def ellipse_of(pv: FloatArray, op: FloatArray, period: float) -> Ellipse | None:
    """Return the ellipse fitted to PV against OP over the cycle, and the apparent stiction; None without a cycle.

    Both signals are first filtered to the cycle, 0.5 to 2 times its frequency. The ellipse is the one of the signals'
    covariance (least squares for a cycle); its width along OP at PV's mean is the apparent stiction, the dead band that
    OP has to cross, in % (M.A.A.S. Choudhury, S.L. Shah, N.F. Thornhill, D.S. Shook, "Automatic detection and
    quantification of stiction in control valves", Control Engineering Practice 14 (2006) 1395-1412). Any phase between
    OP and PV opens the ellipse: it measures stiction only where the loop is known to be nonlinear. period: in samples.
    """
    if not math.isfinite(period) or pv.size < 2 * period:
        return None
    y, u = _band(pv, period), _band(op, period)
    if not (np.ptp(y) > 0.0 and np.ptp(u) > 0.0):
        return None
    covariance = np.cov(np.vstack([u, y]))
    vuu, vuy, vyy = float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])
    # For a cycle u = a cos, y = b cos(. - phase) the ellipse is x' C^-1 x = 2.
    width = 2.0 * math.sqrt(max(2.0 * (vuu - vuy * vuy / vyy), 0.0)) if vyy > 0.0 else 0.0
    return Ellipse(
        op=float(op.mean()),
        pv=float(pv.mean()),
        covariance=(vuu, vuy, vyy),
        apparent_stiction=min(width, float(np.ptp(op))),
    )


def _band(signal: FloatArray, period: float) -> FloatArray:
    spectrum = np.fft.rfft(signal - signal.mean())
    frequency = np.fft.rfftfreq(signal.size)
    spectrum[(frequency < 0.5 / period) | (frequency > 2.0 / period)] = 0.0
    filtered: FloatArray = np.fft.irfft(spectrum, signal.size)
    return filtered
