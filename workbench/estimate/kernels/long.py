"""Kernels for long records: fits that search a plant in one stretch, closer fits by a quadratic, squares of two halves.

Signals, filters and units are those of `output_error`. Where a short record is fitted by a simplex from each stem's own
start, a long one has plants that are nearly right already, and each look at all of it is dear.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.fit import oe_fit
from workbench.estimate.kernels.output_error import (
    BIAS,
    GAIN,
    NO_DELAY,
    START,
    TAU,
    THETA,
    TRANSIENT,
    cost_at,
    drive_of,
    oe_cost,
    plant_terms,
    posed,
    start_rests,
    transient_at,
)
from workbench.estimate.kernels.path import rest_range, stem_path
from workbench.simulate.compiled import compiled, copy

__all__ = ["fit_in_stretch", "fit_near", "halves_left", "path_range"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STARTS = 10  # time constants from which a stem's plant is sought
SHRINK = 0.2  # of a quadratic's step: how far apart the next one's points are


@compiled
def path_range(op: Floats, d: float, first: int) -> tuple[float, float]:
    """Return the range [low, high) of bands for which a Stenman stem that first slips at `first` goes as for d."""
    x, low, high = op[first], 0.0, math.inf
    for k in range(first + 1, op.size):
        lead = abs(op[k] - x)
        if lead > d:
            high = min(high, lead)
            x = op[k]
        else:
            low = max(low, lead)
    return low, high


@compiled
def fit_in_stretch(
    y: Floats,
    op: Floats,
    paths: Floats,
    slack: float,
    sign: float,
    integrating: bool,
    tau_limits: tuple[float, float],
    theta_limits: tuple[float, float],
    evaluations: int,
    a: Floats,
    skip: int,
    begin: int,
    stop: int,
    fits: Floats,
    slips: Ints,
) -> None:
    """Fit the model to many stems: time constant and dead time in the samples [begin, stop), the rest in all of them.

    paths: rows (first, d_low, d_high, theta); fits, slips and the rest: as in `fit_kernel.fit_stems`. A stem that has
    slipped before the stretch stands there as it would from the record's start; what came before is unknown again.
    """
    x, drive = np.empty(op.size), np.empty(op.size)
    low_tau, high_tau = max(tau_limits[0], 0.3), tau_limits[1] / 4.0
    part = y[begin:stop]
    skipped = max(skip - begin, a.size - 1)
    for i in range(paths.shape[0]):
        first, d_low, d_high = int(paths[i, 0]), paths[i, 1], paths[i, 2]
        theta = min(max(paths[i, 3], theta_limits[0]), theta_limits[1])
        slips[i] = stem_path(op, d_low, first, x)
        drive_of(x, first, a, drive)
        low, high = rest_range(op, first, d_low, d_high, slack)
        within, from_there, out = drive[begin:stop], 0, fits[i]
        low_there, high_there = -math.inf, math.inf
        if first >= begin:
            from_there, low_there, high_there = min(first, stop) - begin, low, high
        start, least = 1.0, math.inf
        if not integrating:
            bounds = (low_there, high_there, sign)
            given = posed(part, within, from_there, bounds, integrating, a, skipped, int(theta))
            for j in range(STARTS):
                trial = low_tau * (high_tau / low_tau) ** (j / (STARTS - 1.0))
                cost = cost_at(given, trial, theta, out)
                if cost < least:
                    least, start = cost, trial
        oe_fit(
            part,
            within,
            from_there,
            low_there,
            high_there,
            sign,
            integrating,
            start,
            theta,
            tau_limits,
            theta_limits,
            0.15,
            evaluations,
            1e-7,
            a,
            skipped,
            out,
        )
        oe_cost(y, drive, first, low, high, sign, integrating, out[TAU], out[THETA], a, skip, out)


@compiled
def fit_near(
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
    rounds: int,
    a: Floats,
    skip: int,
    out: Floats,
) -> float:
    """Minimise `oe_cost` over (log tau, theta) from a plant that is nearly right; return the sum of squares.

    Each round takes the minimum of the quadratic through six points about the best so far, `spread` apart in log tau
    and three times that in samples of dead time, then closer as the steps are. No point that was met is better than
    the answer; the rest: as in `oe_fit`.
    """
    low_tau, high_tau = math.log(tau_limits[0]), math.log(tau_limits[1])
    at, best, trial = np.empty(2), np.empty(2), np.empty(2)
    best[0] = min(max(math.log(tau), low_tau), high_tau)
    best[1] = min(max(theta, theta_limits[0]), theta_limits[1])
    least = oe_cost(y, drive, first, low, high, sign, integrating, math.exp(best[0]), best[1], a, skip, out)
    chosen = out.copy()
    far, late = spread, 3.0 * spread
    cost = np.empty(6)
    for _ in range(rounds):
        # Points on the limits: one-sided as far as there is room.
        at[0] = best[0] if integrating else min(max(best[0], low_tau + far), high_tau - far)
        at[1] = min(max(best[1], theta_limits[0] + late), theta_limits[1] - late)
        for i in range(6):
            trial[0], trial[1] = at[0], at[1]
            if i == 1 or i == 5:
                trial[0] += far
            elif i == 2:
                trial[0] -= far
            if i == 3 or i == 5:
                trial[1] += late
            elif i == 4:
                trial[1] -= late
            if integrating and (i == 1 or i == 2 or i == 5):
                cost[i] = 0.0
                continue
            trial[0] = min(max(trial[0], low_tau), high_tau)
            trial[1] = min(max(trial[1], theta_limits[0]), theta_limits[1])
            cost[i] = oe_cost(y, drive, first, low, high, sign, integrating, math.exp(trial[0]), trial[1], a, skip, out)
            if cost[i] < least:
                least = cost[i]
                best[0], best[1] = trial[0], trial[1]
                copy(out, chosen)
        slope_tau, bend_tau = 0.5 * (cost[1] - cost[2]), cost[1] - 2.0 * cost[0] + cost[2]
        slope_theta, bend_theta = 0.5 * (cost[3] - cost[4]), cost[3] - 2.0 * cost[0] + cost[4]
        both = cost[5] - cost[1] - cost[3] + cost[0]
        if integrating:
            slope_tau, bend_tau, both = 0.0, 1.0, 0.0
        if not theta_limits[0] < theta_limits[1]:
            slope_theta, bend_theta, both = 0.0, 1.0, 0.0
        det = bend_tau * bend_theta - both * both
        if not (bend_tau > 0.0 and det > 0.0):
            far, late = 0.5 * far, 0.5 * late
            continue
        step_tau = min(max((both * slope_theta - bend_theta * slope_tau) / det, -4.0), 4.0)
        step_theta = min(max((both * slope_tau - bend_tau * slope_theta) / det, -4.0), 4.0)
        trial[1] = min(max(at[1] + late * step_theta, theta_limits[0]), theta_limits[1])
        if trial[1] != at[1] + late * step_theta:
            # At the end of its range, what suits this dead time.
            step_tau = -(slope_tau + both * (trial[1] - at[1]) / late) / bend_tau
        if trial[1] == 0.0 < theta_limits[1]:
            trial[1] = NO_DELAY  # at none at all the input before the record, which is free, has no part
        trial[0] = min(max(at[0] + far * step_tau, low_tau), high_tau)
        value = oe_cost(y, drive, first, low, high, sign, integrating, math.exp(trial[0]), trial[1], a, skip, out)
        if value < least:
            least = value
            best[0], best[1] = trial[0], trial[1]
            copy(out, chosen)
        far *= max(min(SHRINK * abs(step_tau), 1.0), 0.1)
        late *= max(min(SHRINK * abs(step_theta), 1.0), 0.1)
    copy(chosen, out)
    return least


@compiled
def halves_left(
    y: Floats, drive: Floats, first: int, fit: Floats, integrating: bool, a: Floats, skip: int, half: int
) -> tuple[float, float]:
    """Sums of squares of what a fit (see `oe_cost`) leaves in the first `half` samples that count, and after.

    y, drive: filtered by a.
    """
    n, p = y.size, a.size - 1
    tau, theta, gain, bias = fit[TAU], fit[THETA], fit[GAIN], fit[BIAS]
    start, transient = fit[START], fit[TRANSIENT]
    pole, c0, c1, m = plant_terms(integrating, tau, theta)
    rest = start_rests(a)
    whole, lead = rest[0], 0.0
    for q in range(1, p + 1):
        lead += rest[q]
    # The response, with gain and start in it, from the first sample on, and the transient from the first that counts.
    s, r = start * (-lead if integrating else whole), transient_at(skip, integrating, pole, whole, lead, a)
    early, late = 0.0, 0.0
    for k in range(n):
        if k >= skip:
            left = y[k] - bias * whole - s - transient * r
            if k < skip + half:
                early += left * left
            else:
                late += left * left
            r = r + whole if integrating else r * pole
        near, far = k - m - first + 1, k - m - first
        u = 0.0
        if near <= p:
            u += start * c0 * rest[max(near, 0)]
        if far <= p:
            u += start * c1 * rest[max(far, 0)]
        if k >= m:
            u += gain * c0 * drive[k - m]
        if k > m:
            u += gain * c1 * drive[k - m - 1]
        s = pole * s + u
    return early, late
