"""How sure a fit along a stem is: its slips, standard errors of its plant, and the independent samples behind it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from workbench.detect.whitening import whitened
from workbench.estimate.fits.data import Centred, Law
from workbench.estimate.fits.drift import Drift
from workbench.estimate.fits.fit import Fit, disturbance, predict
from workbench.model.record import FloatArray

__all__ = [
    "ENOUGH_SLIPS",
    "NORMAL",
    "SHARP",
    "SURE_SLIPS",
    "effective_samples",
    "inflation",
    "score_covariance",
    "standard_errors",
    "sure_samples",
]

NORMAL = 1.96  # standard deviations: a range of 95 %
ENOUGH_SLIPS = 10  # fewer do not pin the unknown start of the stem
SURE_SLIPS = 2 * ENOUGH_SLIPS  # fewer may fall in with as many steps of the load, or come at other times than found
SMALL = 1e-2  # step of a drift's law, for its derivatives
SHARP = 0.10  # widest range of d, relative, that counts as identified


def inflation(residuals: FloatArray) -> float:
    """Return by how much autocorrelation inflates the variance of a mean: 1 + 2 sum of the autocorrelation, >= 1.

    Summed over lags while sums of successive pairs stay positive (C. Geyer, "Practical Markov chain Monte Carlo",
    Statistical Science 7 (1992) 473-483).
    """
    n = residuals.size
    centred = residuals - residuals.mean()
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    size = 1 << (2 * n - 1).bit_length()
    acf = np.fft.irfft(np.abs(np.fft.rfft(centred, size)) ** 2, size)[: n // 2] / power
    pairs = acf[: 2 * (acf.size // 2)].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    stop = int(negative[0]) if negative.size else pairs.size
    return float(np.clip(2.0 * pairs[:stop].sum() - 1.0, 1.0, n / 4.0))


def effective_samples(data: Centred, x: FloatArray, first: int, fit: Fit) -> float:
    """Return how many independent samples what a stem x, shape (N,), from `first` on leaves is worth."""
    return sure_samples(data, x, first, data.samples / inflation(data.innovations(predict(data, x, first, fit)[0])))


def sure_samples(data: Centred, x: FloatArray, first: int, samples: float) -> float:
    """Return what so many independent samples beside a stem x, shape (N,), from `first` on are worth.

    Where OP is not known exactly a slip may be a sample off, and all that PV answers to it: of the slips, so many count
    as may be off.
    """
    if data.unsure == 0.0:
        return samples
    moves = np.diff(x[first:]) != 0.0
    slips = max(float(np.count_nonzero(moves[1:] & ~moves[:-1])), 1.0)
    return min(samples, slips / data.unsure)


def standard_errors(data: Centred, x: FloatArray, first: int, fit: Fit, clamped: bool) -> tuple[float, float, float]:
    """Return standard errors of (gain, tau, theta), tau and theta in samples, with the path fixed.

    From the Jacobian of the (filtered) prediction, load steps and the filter included, the larger of the error for
    white residuals and the one that allows for their autocorrelation. Where the disturbance is coloured, the larger of
    those in two measures: the record's own filter, found beside the plant, has taken to what there was by chance (its
    order is that of least AIC); the other is the residual's, of least BIC. clamped: x0 is held at an end of its range,
    so that gain and start move together. nan where the data do not say.
    """
    base, columns = predict(data, x, first, fit)
    left = data.y - base
    vectors = [columns[0], columns[1] + fit.start / fit.gain * columns[2] if clamped and fit.gain else columns[1]]
    names = ["bias", "gain"]
    for name, step in (("tau", 1e-3 * fit.tau), ("theta", 1e-2)):
        if name == "tau" and data.integrating:
            continue
        at = getattr(fit, name)
        down_step = min(step, at) if name == "theta" else step
        up = predict(data, x, first, replace(fit, **{name: at + step}))[0]
        down = predict(data, x, first, replace(fit, **{name: at - down_step}))[0]
        vectors.append((up - down) / (step + down_step))
        names.append(name)
    if not clamped:
        vectors.append(columns[2])
    raw = np.array([*vectors, columns[3], *data.answers])
    filters: list[tuple[FloatArray, Law]] = [(data.a, data.law)]
    filters += [(disturbance(left, data.floor), ())] if data.a.size > 1 else []
    spreads = [_errors_of(raw, left, a, law, max(data.skip, a.size - 1), data.floor) for a, law in filters]
    found = dict(zip(names, np.max(spreads, axis=0).tolist(), strict=False))
    return found["gain"], found.get("tau", math.nan), found["theta"]


def _errors_of(vectors: FloatArray, left: FloatArray, a: FloatArray, law: Law, skip: int, floor: float) -> FloatArray:
    """Standard errors of what vectors, (p, N), stand for, in the measure of a filter; nan where a vector says nothing.

    left: the residual, (N,); law: as in `Centred`. The filter was found beside the plant: in closed loop a gain that
    is off passes for a part of the disturbance.
    """
    jacobian = np.vstack([whitened(a, vectors), *_past(left, a.size - 1, law)])[:, skip:]
    residuals = whitened(a, left)[skip:]
    scale = np.sqrt((jacobian**2).sum(axis=1))
    kept = scale > 0.0
    jacobian = jacobian[kept] / scale[kept, None]
    inverse = np.linalg.pinv(jacobian @ jacobian.T, rcond=1e-12)
    white = float(residuals @ residuals) / max(residuals.size - len(jacobian), 1) + floor
    spread = np.maximum(np.diag(inverse) * white, np.diag(inverse @ score_covariance(jacobian, residuals) @ inverse))
    errors = np.full(scale.size, math.nan)
    errors[kept] = np.sqrt(np.maximum(spread, 0.0)) / scale[kept]
    return errors[: len(vectors)]


def _past(left: FloatArray, lags: int, law: Law) -> list[FloatArray]:
    """What each parameter of a filter changes of what it leaves, each of shape (N,).

    Where coefficients share lags and the filter has one more, they are those of how what is left changes.
    """

    def before(signal: FloatArray, first: int, last: int) -> FloatArray:
        total = np.zeros(signal.size)
        for lag in range(first, last + 1):
            total[lag:] += signal[:-lag]
        return total

    if isinstance(law, Drift):
        steps = SMALL * np.eye(law.terms)
        ends = [[whitened(law.moved(*way).filter(left.size), left) for way in (step, -step)] for step in steps]
        return [(up - down) / (2.0 * SMALL) for up, down in ends]
    if not law:
        return [before(left, lag, lag) for lag in range(1, lags + 1)]
    moves = law[-1] < lags
    signal = np.diff(left, prepend=0.0) if moves else left
    groups = zip((0, *law), law, strict=False)
    return [before(signal, first + 1, last) for first, last in groups] + [before(left, 1, 1)] * moves


def score_covariance(jacobian: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return the covariance of the sum of scores, shape (p, p), with a Bartlett window over their autocorrelation.

    W. Newey, K. West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
    matrix", Econometrica 55 (1987) 703-708; the window is twice the residuals' own correlation time.
    """
    n = residuals.size
    window = int(np.clip(2.0 * inflation(residuals), 1.0, min(n / 8.0, 400.0)))
    scores = jacobian * residuals
    total = scores @ scores.T
    for lag in range(1, window + 1):
        part = scores[:, lag:] @ scores[:, :-lag].T
        total += (1.0 - lag / (window + 1.0)) * (part + part.T)
    covariance: FloatArray = total * (n / max(n - jacobian.shape[0], 1))
    return covariance
