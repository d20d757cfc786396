"""The stem test's compiled part: a lag driven by stem paths, whitened, and its least squares against whitened PV."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled

__all__ = ["lagged", "screen", "taps"]

Floats = NDArray[np.float64]


@compiled
def lagged(x: Floats, pole: float, a: Floats, z: Floats) -> None:
    """Write into z the lag `l_k = pole l_{k-1} + (1 - pole) (x_{k-1} - x_0)`, l_0 = 0, filtered by `sum a_i l_{k-i}`."""
    n, order = x.size, a.size
    lag = 0.0
    z[0] = 0.0
    for k in range(1, n):
        lag = pole * lag + (1.0 - pole) * (x[k - 1] - x[0])
        z[k] = lag
    for k in range(n - 1, -1, -1):
        total = 0.0
        for i in range(min(order, k + 1)):
            total += a[i] * z[k - i]
        z[k] = total


@compiled
def _project(target: Floats, pole: float, first: int, e: Floats, t: Floats) -> float:
    """Write into e the unit transient less its mean, into t the target less mean and transient; return its power.

    Only samples from `first` on count.
    """
    n = target.size
    count = n - first
    value, mean, mean_t = 1.0, 0.0, 0.0
    for k in range(first, n):
        e[k] = value
        value *= pole
        mean += e[k]
        mean_t += target[k]
    mean /= count
    mean_t /= count
    power, common = 0.0, 0.0
    for k in range(first, n):
        e[k] -= mean
        power += e[k] * e[k]
        common += e[k] * target[k]
    # A transient as slow as many records is no longer apart from the constant.
    scale = 1.0 / np.sqrt(power) if power > 1e-12 * count else 0.0
    left = 0.0
    for k in range(first, n):
        e[k] *= scale
        t[k] = target[k] - mean_t - common * scale * e[k]
        left += t[k] * t[k]
    return left


@compiled
def screen(
    target: Floats,
    paths: Floats,
    poles: Floats,
    a: Floats,
    delays: NDArray[np.int64],
    sign: float,
    best: Floats,
    pole_at: NDArray[np.int64],
    delay_at: NDArray[np.int64],
) -> None:
    """Write for each path i the least sum of squares best[i] over poles and dead times, and where it is.

    target: PV whitened by a, (N,); paths: (P, N); sign: that the gain must have, or 0. A constant and a transient with
    the plant's pole are free.
    """
    n = target.size
    first = a.size - 1
    z, e, t = np.empty(n), np.zeros(n), np.zeros(n)
    best[:] = np.inf
    for j in range(poles.size):
        left = _project(target, poles[j], first, e, t)
        for i in range(paths.shape[0]):
            lagged(paths[i], poles[j], a, z)
            for d in range(delays.size):
                delay = delays[d]
                power, total, on_e, common = 0.0, 0.0, 0.0, 0.0
                for k in range(max(first, delay), n):
                    v = z[k - delay]
                    power += v * v
                    total += v
                    on_e += v * e[k]
                    common += v * t[k]
                whole = power
                power -= total * total / (n - first) + on_e * on_e
                sse = left
                if power > 1e-9 * whole and common * sign >= 0.0:
                    sse -= common * common / power
                if sse < best[i]:
                    best[i] = max(sse, 0.0)
                    pole_at[i] = j
                    delay_at[i] = d


@compiled
def taps(target: Floats, x: Floats, pole: float, a: Floats, delay: int, sign: float, gains: Floats) -> float:
    """Return the sum of squares of a plant whose gain two neighbouring dead times share; write both parts into gains.

    Where the parts would differ in sign one dead time has all of it, where the gain would have the wrong sign none.
    """
    n = target.size
    first = a.size - 1
    z, e, t = np.empty(n), np.zeros(n), np.zeros(n)
    left = _project(target, pole, first, e, t)
    lagged(x, pole, a, z)
    m0, m1, e0, e1 = 0.0, 0.0, 0.0, 0.0
    p00, p01, p11, c0, c1 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(max(first, delay), n):
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
    count = n - first
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
