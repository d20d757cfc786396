"""The stem test's compiled part: a lag driven by whitened stem paths, and its least squares against whitened PV."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled

__all__ = ["lagged", "screen", "taps", "whiten"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@compiled
def whiten(a: Floats, rows: Floats, out: Floats) -> None:
    """Write each row filtered by a = (1, -a_1, .., -a_p), shape (R, N), as if it had been 0 before."""
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            total = 0.0
            for j in range(min(a.size, k + 1)):
                total += a[j] * rows[i, k - j]
            out[i, k] = total


@compiled
def lagged(drive: Floats, pole: float, z: Floats) -> None:
    """Write into z the lag `z_k = pole z_{k-1} + (1 - pole) drive_{k-1}`, z_0 = 0."""
    lag = 0.0
    z[0] = 0.0
    for k in range(1, drive.size):
        lag = pole * lag + (1.0 - pole) * drive[k - 1]
        z[k] = lag


@compiled
def _project(target: Floats, live: Bools, pole: float, first: int, e: Floats, t: Floats) -> float:
    """Write into e the unit transient less its mean, into t the target less mean and transient; return its power.

    Only live samples from `first` on count; the others are left 0.
    """
    n = target.size
    count = 0
    value, mean, mean_t = 1.0, 0.0, 0.0
    for k in range(first, n):
        e[k], t[k] = 0.0, 0.0
        if live[k]:
            count += 1
            e[k] = value
            mean += value
            mean_t += target[k]
        value *= pole
    mean /= count
    mean_t /= count
    power, common = 0.0, 0.0
    for k in range(first, n):
        if live[k]:
            e[k] -= mean
            power += e[k] * e[k]
            common += e[k] * target[k]
    # A transient as slow as many records is no longer apart from the constant.
    scale = 1.0 / np.sqrt(power) if power > 1e-12 * count else 0.0
    left = 0.0
    for k in range(first, n):
        if live[k]:
            e[k] *= scale
            t[k] = target[k] - mean_t - common * scale * e[k]
            left += t[k] * t[k]
    return left


@compiled
def screen(
    target: Floats,
    live: Bools,
    drives: Floats,
    poles: Floats,
    first: int,
    delays: NDArray[np.int64],
    sign: float,
    best: Floats,
    pole_at: NDArray[np.int64],
    delay_at: NDArray[np.int64],
) -> None:
    """Write for each path i the least sum of squares best[i] over poles and dead times, and where it is.

    target: whitened PV, (N,); live: the samples that count, from `first` on; drives: whitened inputs, (P, N); sign:
    that the gain must have, or 0. A constant and a transient with the plant's pole are free.
    """
    n = target.size
    weight = np.zeros(n)
    weight[first:] = live[first:]
    count = weight.sum()
    z, squares, e, t = np.empty(n), np.empty(n), np.zeros(n), np.zeros(n)
    # Where every sample counts, prefix sums give the response's own sums for every dead time.
    whole_record = count == n - first
    sums, powers = np.zeros(n + 1), np.zeros(n + 1)
    best[:] = np.inf
    for j in range(poles.size):
        left = _project(target, live, poles[j], first, e, t)
        for i in range(drives.shape[0]):
            lagged(drives[i], poles[j], z)
            if whole_record:
                for k in range(n):
                    sums[k + 1] = sums[k] + z[k]
                    powers[k + 1] = powers[k] + z[k] * z[k]
            else:
                squares[:] = z * z
            for d in range(delays.size):
                # Before its dead time is over the response is nought.
                delay = delays[d]
                if whole_record:
                    begin = max(first - delay, 0)
                    whole, total = powers[n - delay] - powers[begin], sums[n - delay] - sums[begin]
                else:
                    whole = np.dot(squares[: n - delay], weight[delay:])
                    total = np.dot(z[: n - delay], weight[delay:])
                on_e = np.dot(z[: n - delay], e[delay:])
                common = np.dot(z[: n - delay], t[delay:])
                power = whole - total * total / count - on_e * on_e
                sse = left
                if power > 1e-9 * whole and common * sign >= 0.0:
                    sse -= common * common / power
                if sse < best[i]:
                    best[i] = max(sse, 0.0)
                    pole_at[i] = j
                    delay_at[i] = d


@compiled
def taps(
    target: Floats, live: Bools, drive: Floats, pole: float, first: int, delay: int, sign: float, gains: Floats
) -> float:
    """Return the sum of squares of a plant whose gain two neighbouring dead times share; write both parts into gains.

    Where the parts would differ in sign one dead time has all of it, where the gain would have the wrong sign none.
    """
    n = target.size
    count = live[first:].sum()
    z, e, t = np.empty(n), np.zeros(n), np.zeros(n)
    left = _project(target, live, pole, first, e, t)
    lagged(drive, pole, z)
    m0, m1, e0, e1 = 0.0, 0.0, 0.0, 0.0
    p00, p01, p11, c0, c1 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(max(first, delay), n):
        if not live[k]:
            continue
        v = z[k - delay]
        w = z[k - delay - 1] if k > delay else 0.0
        m0 += v
        m1 += w
        e0 += v * e[k]
        e1 += w * e[k]
        p00 += v * v
        p01 += v * w
        p11 += w * w
        c0 += v * t[k]
        c1 += w * t[k]
    whole = p00
    p00 -= m0 * m0 / count + e0 * e0
    p01 -= m0 * m1 / count + e0 * e1
    p11 -= m1 * m1 / count + e1 * e1
    gains[0], gains[1] = 0.0, 0.0
    least = left
    if p00 > 1e-9 * whole and c0 * sign >= 0.0:
        gains[0] = c0 / p00
        least = left - c0 * c0 / p00
    det = p00 * p11 - p01 * p01
    if det > 1e-9 * p00 * p11:
        g0, g1 = (c0 * p11 - c1 * p01) / det, (c1 * p00 - c0 * p01) / det
        if g0 * g1 >= 0.0 and (g0 + g1) * sign >= 0.0:
            gains[0], gains[1] = g0, g1
            least = left - g0 * c0 - g1 * c1
    return max(least, 0.0)
