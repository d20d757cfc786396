"""Fits of the output-error model to stems: time constant and dead time by a simplex, the rest by least squares."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.output_error import FIT, cost_at, drive_of, oe_cost, posed
from workbench.estimate.kernels.path import band_path, rest_range, spans_of, stem_path
from workbench.simulate.compiled import compiled, copy

__all__ = ["fit_bands", "fit_stems", "oe_fit", "scan_plants"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FURTHER = 8.0  # samples of dead time beyond where a search begins


@compiled
def _mirrored(value: float, low: float, high: float) -> float:
    """Return a value as far within a limit as it is beyond it, between both limits."""
    if value < low:
        value = 2.0 * low - value
    elif value > high:
        value = 2.0 * high - value
    return min(max(value, low), high)


@compiled
def oe_fit(
    y: Floats,
    drive: Floats,
    first: int,
    low: float,
    high: float,
    sign: float,
    integrating: bool,
    tau: float,
    theta: float,
    tau_limits: tuple[float, float],
    theta_limits: tuple[float, float],
    spread: float,
    evaluations: int,
    tolerance: float,
    a: Floats,
    skip: int,
    out: Floats,
) -> float:
    """Minimise `oe_cost` over (log tau, theta) by Nelder and Mead's simplex within limits; return the sum of squares.

    spread: the first simplex's size, in log tau and, times three, in samples of dead time. Ends after `evaluations`, or
    when the simplex's costs agree to `tolerance` relative. For an integrating plant tau is not used.
    """
    # Seldom does a search go further than that.
    longest = int(min(theta + FURTHER, theta_limits[1]))
    given = posed(y, drive, first, (low, high, sign), integrating, a, skip, longest)
    points = np.empty((3, 2))
    costs = np.empty(3)
    trial = np.empty(2)
    centre = np.empty(2)
    chosen = np.empty(2)
    low_tau, high_tau = math.log(tau_limits[0]), math.log(tau_limits[1])
    points[0, 0] = min(max(math.log(tau), low_tau), high_tau)
    points[0, 1] = min(max(theta, theta_limits[0]), theta_limits[1])
    for i in range(1, 3):
        copy(points[0], points[i])
    points[1, 0] += spread if points[0, 0] + spread <= high_tau else -spread
    side = 3.0 * spread
    points[2, 1] += side if points[0, 1] + side <= theta_limits[1] else -side
    points[2, 1] = max(points[2, 1], theta_limits[0])
    for i in range(3):
        costs[i] = cost_at(given, math.exp(points[i, 0]), points[i, 1], out)
    used = 3
    while used < evaluations:
        # Order: best, middle, worst.
        for i in range(2):
            for j in range(2 - i):
                if costs[j + 1] < costs[j]:
                    costs[j], costs[j + 1] = costs[j + 1], costs[j]
                    for c in range(2):
                        points[j, c], points[j + 1, c] = points[j + 1, c], points[j, c]
        size = abs(points[2, 0] - points[0, 0]) + abs(points[1, 0] - points[0, 0])
        size += abs(points[2, 1] - points[0, 1]) + abs(points[1, 1] - points[0, 1])
        if costs[2] - costs[0] <= tolerance * costs[0] or size < 1e-9:
            break
        # Reflect the worst point about the others' middle; go further where that is best, stay closer where it is not.
        for c in range(2):
            centre[c] = 0.5 * (points[0, c] + points[1, c])
        kept = math.inf
        for stage in range(2):
            if stage == 0:
                factor = -1.0
            elif kept < costs[0]:
                factor = -2.0
            elif kept < costs[1]:
                break
            else:
                factor = -0.5 if kept < costs[2] else 0.5
            for c in range(2):
                trial[c] = centre[c] + factor * (points[2, c] - centre[c])
            # Back from a limit as far as beyond it: points that all lie on the limit would never leave it.
            trial[0] = _mirrored(trial[0], low_tau, high_tau)
            trial[1] = _mirrored(trial[1], theta_limits[0], theta_limits[1])
            value = cost_at(given, math.exp(trial[0]), trial[1], out)
            used += 1
            if value < kept:
                kept = value
                chosen[0], chosen[1] = trial[0], trial[1]
        if kept < costs[1] or (kept < costs[2] and factor != -1.0):
            costs[2] = kept
            points[2, 0], points[2, 1] = chosen[0], chosen[1]
        else:
            for i in range(1, 3):
                for c in range(2):
                    points[i, c] = 0.5 * (points[i, c] + points[0, c])
                costs[i] = cost_at(given, math.exp(points[i, 0]), points[i, 1], out)
                used += 1
    best = 0
    for i in range(1, 3):
        if costs[i] < costs[best]:
            best = i
    return cost_at(given, math.exp(points[best, 0]), points[best, 1], out)


@compiled
def scan_plants(
    y: Floats, drive: Floats, sign: float, integrating: bool, plants: Floats, a: Floats, skip: int, costs: Floats
) -> None:
    """Write the costs (see `oe_cost`) of a drive from the first sample on at many plants, rows (tau, theta)."""
    longest = int(plants[:, 1].max())
    given, out = posed(y, drive, 0, (-math.inf, math.inf, sign), integrating, a, skip, longest), np.empty(FIT)
    for i in range(plants.shape[0]):
        costs[i] = cost_at(given, plants[i, 0], plants[i, 1], out)


@compiled
def fit_stems(
    y: Floats,
    op: Floats,
    paths: Floats,
    slack: float,
    sign: float,
    integrating: bool,
    taus: Floats,
    tau_limits: tuple[float, float],
    theta_limits: tuple[float, float],
    evaluations: int,
    tolerance: float,
    a: Floats,
    skip: int,
    fits: Floats,
    slips: Ints,
) -> None:
    """Fit the output-error model to many stem paths: rows (first, d_low, d_high, theta), theta where the search starts.

    taus: where each starts, nan for the best of ten from .3 samples to a quarter of the upper limit. evaluations: as in
    `oe_fit`, 0 for the cost at the start itself. Written: fits, shape (paths, FIT), and slips, shape (paths,).
    """
    x, drive = np.empty(op.size), np.empty(op.size)
    low_tau, high_tau = max(tau_limits[0], 0.3), tau_limits[1] / 4.0
    for i in range(paths.shape[0]):
        first, d_low, d_high = int(paths[i, 0]), paths[i, 1], paths[i, 2]
        theta = min(max(paths[i, 3], theta_limits[0]), theta_limits[1])
        slips[i] = stem_path(op, d_low, first, x)
        drive_of(x, first, a, drive)
        low, high = rest_range(op, first, d_low, d_high, slack)
        out = fits[i]
        start = taus[i]
        if integrating:
            start = 1.0
        elif math.isnan(start):
            least = math.inf
            given = posed(y, drive, first, (low, high, sign), False, a, skip, int(theta))
            for j in range(10):
                trial = low_tau * (high_tau / low_tau) ** (j / 9.0)
                cost = cost_at(given, trial, theta, out)
                if cost < least:
                    least, start = cost, trial
        if evaluations == 0:
            oe_cost(y, drive, first, low, high, sign, integrating, start, theta, a, skip, out)
        else:
            oe_fit(
                y,
                drive,
                first,
                low,
                high,
                sign,
                integrating,
                start,
                theta,
                tau_limits,
                theta_limits,
                0.15,
                evaluations,
                tolerance,
                a,
                skip,
                out,
            )


@compiled
def fit_bands(
    y: Floats,
    op: Floats,
    bands: Floats,
    first: int,
    sense: float,
    sign: float,
    integrating: bool,
    tau: float,
    theta: float,
    tau_limits: tuple[float, float],
    theta_limits: tuple[float, float],
    evaluations: int,
    tolerance: float,
    a: Floats,
    skip: int,
    fits: Floats,
    slips: Ints,
) -> None:
    """Fit the output-error model to many two-parameter stems, rows (S, J), with one start, from one plant.

    first, sense: as in `band_path`; tau, theta and the rest: as in `oe_fit`. Written: fits, shape (bands, FIT), and
    slips, shape (bands,).
    """
    x, drive, box, spans = np.empty(op.size), np.empty(op.size), np.empty(4), spans_of(op)
    inf = math.inf
    for i in range(bands.shape[0]):
        slips[i] = band_path(op, spans, bands[i, 0], bands[i, 1], first, sense, x, box)
        drive_of(x, max(first, 0), a, drive)
        oe_fit(
            y,
            drive,
            max(first, 0),
            -inf,
            inf,
            sign,
            integrating,
            tau,
            theta,
            tau_limits,
            theta_limits,
            0.15,
            evaluations,
            tolerance,
            a,
            skip,
            fits[i],
        )
