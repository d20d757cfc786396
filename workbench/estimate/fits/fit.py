"""Output-error fits, whitened where the disturbance is coloured: of a plant to a stem path, and of the linear loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from workbench.estimate.fits.data import WHITE, Centred
from workbench.estimate.fits.windows import EXACT, stretch_of
from workbench.estimate.kernels import fit as fit_kernel
from workbench.estimate.kernels import long as long_kernel
from workbench.estimate.kernels import output_error
from workbench.estimate.kernels import path as path_kernel
from workbench.model.record import FloatArray

__all__ = [
    "INTEGRATED",
    "LOUD",
    "Fit",
    "Limits",
    "again_linear",
    "autoregression",
    "disturbance",
    "fit_bands",
    "fit_in_stretch",
    "fit_linear",
    "fit_near",
    "fit_nothing",
    "fit_path",
    "fit_stems",
    "grounded",
    "grown",
    "halves_left",
    "noise_alone",
    "predict",
    "start_range",
]

# Time constants from far below the sample time (a plant that follows at once) up to the record's length.
LEAST_TAU = 0.05
# A real valve does not hold exactly; the stem's start may leave its exact range by this share of d.
START_SLACK = 0.02
ORDERS = 8  # most of a disturbance's autoregression
NEAR = 0.02  # of a time constant: how far apart the points of a quadratic about a plant are at first
FOLLOWED = 2  # linear fits of a stretch of a long record, on all of it
MOST = 700.0  # of an exponent: e^709 is the largest number there is
LARGEST = 1e150  # EU: the square of a larger residual may overflow
INTEGRATED = np.array([1.0, -1.0])  # the filter of a disturbance whose changes are white, as a level sums up its load
LOUD = 4.0  # times what the record resolves: quieter residuals tell nothing of a disturbance


@dataclass(frozen=True, slots=True)
class Limits:
    """Ranges of the search, in samples: time constant and dead time."""

    tau: tuple[float, float]
    theta: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Fit:
    """An output-error fit: sum of squares (EU^2), tau and theta (samples), gain, bias, start = gain x0, transient."""

    sse: float
    tau: float
    theta: float
    gain: float
    bias: float
    start: float
    transient: float


def _fit(out: FloatArray) -> Fit:
    return Fit(*out.tolist())


def grown(by: float) -> float:
    """Return e^by, at most what a number holds: a simplex goes as far as it likes where nothing holds it back."""
    return math.exp(min(by, MOST))


def start_range(u: FloatArray, first: int, d_low: float, d_high: float) -> tuple[float, float]:
    """Return the range of x0 for which a Stenman stem rests until it slips at `first`; infinite where first is 0."""
    return path_kernel.rest_range(u, first, d_low, d_high, START_SLACK)


def drive_of(data: Centred, x: FloatArray, first: int) -> FloatArray:
    """Return what drives the model in data's measure: the stem path x, shape (N,), from `first` on, filtered."""
    drive = np.empty_like(x)
    output_error.drive_of(x, first, data.a, drive)
    return drive


def fit_path(
    data: Centred,
    x: FloatArray,
    first: int,
    bounds: tuple[float, float],
    limits: Limits,
    theta: float,
    *,
    tau: float | None = None,
    evaluations: int = 120,
    tolerance: float = 1e-7,
) -> Fit:
    """Return the output-error fit of a plant to the stem path x, shape (N,), that starts at `first`.

    bounds: the range of x0 (see `start_range`). theta (samples): where the search starts; tau likewise, or the best of
    a coarse list.
    """
    out = np.empty(output_error.FIT)
    low, high = bounds
    drive = drive_of(data, x, first)
    if tau is None and not data.integrating:
        best = math.inf
        for trial in np.geomspace(max(limits.tau[0], 0.3), limits.tau[1] / 4.0, 10).tolist():
            cost = output_error.oe_cost(
                data.target, drive, first, low, high, data.sign, False, trial, theta, data.a, data.skip, out
            )
            if cost < best:
                best, tau = cost, trial
    fit_kernel.oe_fit(
        data.target,
        drive,
        first,
        low,
        high,
        data.sign,
        data.integrating,
        1.0 if tau is None else tau,
        theta,
        limits.tau,
        limits.theta,
        0.15,
        evaluations,
        tolerance,
        data.a,
        data.skip,
        out,
    )
    return _fit(out)


def fit_stems(
    data: Centred,
    paths: FloatArray,
    limits: Limits,
    *,
    tau: float | FloatArray = math.nan,
    evaluations: int = 120,
    tolerance: float = 1e-7,
) -> list[tuple[Fit, int]]:
    """Return the output-error fit and the number of slips of many stem paths, rows (first, d_low, d_high, theta).

    theta (samples): where the search starts; tau likewise, of all or of each, nan for the best of a coarse list.
    evaluations: 0 for the fit at those two themselves.
    """
    fits = np.empty((len(paths), output_error.FIT))
    slips = np.empty(len(paths), np.int64)
    fit_kernel.fit_stems(
        data.target,
        data.u,
        np.ascontiguousarray(paths),
        START_SLACK,
        data.sign,
        data.integrating,
        np.full(len(paths), tau),
        limits.tau,
        limits.theta,
        evaluations,
        tolerance,
        data.a,
        data.skip,
        fits,
        slips,
    )
    return [(_fit(out), int(count)) for out, count in zip(fits, slips.tolist(), strict=True)]


def fit_in_stretch(
    data: Centred, paths: FloatArray, limits: Limits, stretch: tuple[int, int], evaluations: int
) -> list[tuple[Fit, int]]:
    """Return fits and slips as `fit_stems`, tau and theta searched in the samples [begin, stop) of a stretch alone."""
    fits = np.empty((len(paths), output_error.FIT))
    slips = np.empty(len(paths), np.int64)
    long_kernel.fit_in_stretch(
        data.target,
        data.u,
        np.ascontiguousarray(paths),
        START_SLACK,
        data.sign,
        data.integrating,
        limits.tau,
        limits.theta,
        evaluations,
        data.a,
        data.skip,
        *stretch,
        fits,
        slips,
    )
    return [(_fit(out), int(count)) for out, count in zip(fits, slips.tolist(), strict=True)]


def fit_near(
    data: Centred, x: FloatArray, first: int, bounds: tuple[float, float], limits: Limits, near: Fit, rounds: int
) -> Fit:
    """Return the fit of a plant to the stem path x, shape (N,), from one that is nearly right (see `fit_path`)."""
    out = np.empty(output_error.FIT)
    long_kernel.fit_near(
        data.target,
        drive_of(data, x, first),
        first,
        *bounds,
        data.sign,
        data.integrating,
        near.tau,
        near.theta,
        limits.tau,
        limits.theta,
        NEAR,
        rounds,
        data.a,
        data.skip,
        out,
    )
    return _fit(out)


def halves_left(data: Centred, x: FloatArray, first: int, fit: Fit) -> tuple[float, float]:
    """Return the sums of squares of what a fit to the stem path x leaves in the first half of the record, and after."""
    terms = np.array([fit.sse, fit.tau, fit.theta, fit.gain, fit.bias, fit.start, fit.transient])
    drive = drive_of(data, x, first)
    half = data.samples // 2
    return long_kernel.halves_left(data.target, drive, first, terms, data.integrating, data.a, data.skip, half)


def fit_bands(
    data: Centred,
    bands: FloatArray,
    start: tuple[int, float],
    limits: Limits,
    plant: tuple[float, float],
    evaluations: int,
    tolerance: float,
) -> list[tuple[Fit, int]]:
    """Return the output-error fit and the number of slips of many two-parameter stems, rows (S, J) in %.

    start: (first, sense) of all of them (see `band_path`); plant: (tau, theta) in samples, where each begins.
    """
    fits = np.empty((len(bands), output_error.FIT))
    slips = np.empty(len(bands), np.int64)
    fit_kernel.fit_bands(
        data.target,
        data.u,
        np.ascontiguousarray(bands),
        *start,
        data.sign,
        data.integrating,
        *plant,
        limits.tau,
        limits.theta,
        evaluations,
        tolerance,
        data.a,
        data.skip,
        fits,
        slips,
    )
    return [(_fit(out), count) for out, count in zip(fits, slips.tolist(), strict=True)]


def fit_linear(data: Centred, longest: float) -> Fit:
    """Return the fit that ignores stiction: the stem is OP itself, the dead time anywhere up to `longest` samples.

    The input before the record is an unknown constant, as for the stem. The plant of a long record is sought in its
    liveliest stretch first.
    """
    part = _sought_in(data, longest)
    delays = np.unique(np.floor(np.linspace(0, longest, min(int(longest) + 1, 80))))
    taus = np.ones(1) if data.integrating else np.geomspace(0.3, data.samples / 4.0, 14)
    plants = np.column_stack([np.repeat(taus, delays.size), np.tile(delays, taus.size)])
    costs = np.empty(len(plants))
    drive = drive_of(part, part.u, 0)
    fit_kernel.scan_plants(part.target, drive, data.sign, data.integrating, plants, data.a, part.skip, costs)
    likely = plants[np.argsort(costs, kind="stable")[:6]].tolist()
    return _linear_from(data, part, [(tau, theta) for tau, theta in likely], longest)


def again_linear(data: Centred, linear: Fit, longest: float) -> Fit:
    """Return the linear fit in the measure of data's disturbance, from that in another."""
    plants = [
        (tau, min(theta, longest))
        for tau in {linear.tau, max(linear.tau / 4.0, LEAST_TAU)}
        for theta in {linear.theta, 0.0}
    ]
    fit = _linear_from(data, _sought_in(data, longest), plants, longest)
    if not data.integrating:
        return fit
    # In a measure that takes what is slow, no dead time leads to the right one from afar.
    return min(fit, fit_linear(data, longest), key=lambda f: f.sse)


def _sought_in(data: Centred, longest: float) -> Centred:
    """Where a linear plant is sought: in all of a record, or in a stretch of a long one, in its measure."""
    if data.samples <= EXACT:
        return data
    begin, stop = stretch_of(data)
    part = data.part(begin, stop).whitened(data.a, max(data.skip - begin, 0), data.law)
    return part if 4.0 * longest <= part.samples else data


def _linear_from(data: Centred, part: Centred, plants: list[tuple[float, float]], longest: float) -> Fit:
    """The best linear fit from some plants (tau, theta), followed within a part first."""
    limits, free = Limits((LEAST_TAU, float(data.samples)), (0.0, float(longest))), (-math.inf, math.inf)

    def followed(where: Centred, tau: float, theta: float) -> Fit:
        return fit_path(where, where.u, 0, free, limits, theta, tau=tau, evaluations=160, tolerance=1e-9)

    fits = [followed(part, tau, theta) for tau, theta in plants]
    if part is not data:
        there = [fit_near(data, data.u, 0, free, limits, fit, 0) for fit in fits]
        fits = [followed(data, fit.tau, fit.theta) for fit in sorted(there, key=lambda f: f.sse)[:FOLLOWED]]
    return min(fits, key=lambda f: f.sse)


def fit_nothing(data: Centred) -> float:
    """Return the sum of squares that no input at all leaves: a constant and a transient (integrating: a ramp)."""
    n = data.samples
    k = np.arange(n, dtype=np.float64)
    taus = [1.0] if data.integrating else np.geomspace(1.0, n, 12).tolist()
    least = math.inf
    for tau in taus:
        shape = k if data.integrating else np.exp(-k / tau)
        columns = np.column_stack([np.ones(n), shape])
        terms, *_ = np.linalg.lstsq(columns, data.y, rcond=None)
        least = min(least, float(((data.y - columns @ terms) ** 2).sum()))
    return least


def predict(data: Centred, x: FloatArray, first: int, fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Return (prediction of y, shape (N,), and the model's columns, shape (4, N))."""
    pole, c0, c1, delay = output_error.plant_terms(data.integrating, fit.tau, fit.theta)
    columns = np.empty((4, data.samples))
    output_error.oe_columns(x, first, pole, delay, c0, c1, data.integrating, columns)
    return np.array([fit.bias, fit.gain, fit.start, fit.transient]) @ columns, columns


def grounded(
    data: Centred, x: FloatArray, first: int, fit: Fit, bounds: tuple[float, float] = (-math.inf, math.inf)
) -> Fit:
    """Return a fit with its bias, start and transient by least squares on PV itself, its plant as it is.

    Where the first samples do not count, or a filter takes what is slow, these three are hardly seen in the measure
    that the plant was found in. bounds: the range of x0 (see `start_range`); where it has no end x0 is no further than
    OP goes in the record: what wanders slowly would have a stem that nobody saw make up for some of it in the first
    samples, a level's by a leap.
    """
    if data.skip == 0 and data.a.size == 1:
        return fit
    bounds = (
        bounds[0] if math.isfinite(bounds[0]) else float(data.u.min()),
        bounds[1] if math.isfinite(bounds[1]) else float(data.u.max()),
    )
    columns = predict(data, x, first, fit)[1]
    rest = data.y - fit.gain * columns[1]

    def solved(kept: list[int], target: FloatArray) -> list[float]:
        terms, *_ = np.linalg.lstsq(columns[kept].T, target, rcond=1e-8)
        values: list[float] = terms.tolist()
        return values

    bias, start, transient = solved([0, 2, 3], rest)
    low, high = sorted((fit.gain * bounds[0], fit.gain * bounds[1])) if fit.gain != 0.0 else (0.0, 0.0)
    if not low <= start <= high:
        start = min(max(start, low), high)
        bias, transient = solved([0, 3], rest - start * columns[2])
    left = data.y - np.array([bias, fit.gain, start, transient]) @ columns
    return Fit(float(left @ left), fit.tau, fit.theta, fit.gain, bias, start, transient)


def disturbance(residuals: FloatArray, floor: float) -> FloatArray:
    """Return the filter (1, -a_1, .., -a_p) that leaves a residual white (see `autoregression`)."""
    return autoregression(residuals, floor)[0]


def noise_alone(data: Centred, x: FloatArray, first: int, fit: Fit) -> bool:
    """Return whether a stem path x, shape (N,), from its first slip on leaves no more of PV than white noise."""
    left = data.y - predict(data, x, first, fit)[0]
    return disturbance(left[data.skip :], data.floor).size == 1


def autoregression(residuals: FloatArray, floor: float) -> tuple[FloatArray, float]:
    """Return the filter (1, -a_1, .., -a_p) that leaves a residual white, and its BIC; (1,) below `floor` (EU^2).

    A residual that runs away has none, and a BIC of inf.
    The autoregression of lowest BIC up to ORDERS (G. Schwarz, Ann. Statist. 6 (1978) 461-464), by Levinson's recursion
    on the autocorrelation (J. Durbin, Rev. Int. Stat. Inst. 28 (1960) 233-244).
    """
    n = residuals.size
    if not float(np.abs(residuals).max(initial=0.0)) < LARGEST:
        return WHITE, math.inf  # of a model that runs away; its squares would overflow
    left = residuals - residuals.mean()
    power = float(left @ left) / n
    if not power > LOUD * floor:
        return WHITE, n * math.log(max(power, floor, 1e-300))
    lags = np.array([float(left[k:] @ left[: n - k]) / n for k in range(ORDERS + 1)])
    best, least, a, variance = WHITE, n * math.log(power), np.ones(1), power
    for p in range(1, ORDERS + 1):
        partial = -float(a @ lags[p:0:-1]) / variance
        a = np.concatenate([a, [0.0]]) + partial * np.concatenate([a, [0.0]])[::-1]
        variance *= 1.0 - partial * partial
        if not variance > 0.0:
            break
        # Innovations that the record does not resolve are no smaller for it.
        bic = n * math.log(max(variance, floor)) + p * math.log(n)
        if bic < least:
            best, least = a, bic
    return best, least
