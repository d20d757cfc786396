"""What noise upon a load that drifts leaves of PV beside a plant's response to a stem, by a Kalman filter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.output_error import NOTHING, oe_columns, plant_terms, solve
from workbench.simulate.compiled import compiled

__all__ = ["ROOM", "drift_left", "remember", "steady"]

Floats = NDArray[np.float64]
DIFFUSE = 1e8  # times what drift and noise come to: the variance of where the disturbance begins
STEADY = 1e-13  # of the variance foretold: it no longer changes
TERMS = 4  # the model's columns
ROOM = 2 * TERMS + 1  # rows of signals to work in: the columns, and what is not foretold of these and of PV


@compiled
def _begun(drift: float, noise: float) -> tuple[float, float, float]:
    """The covariance of the states before anything is seen: of s, of s with z, and of z."""
    p22 = 1.0 / (1.0 - drift * drift)
    return DIFFUSE * (p22 + noise), 0.0, p22


@compiled
def _onward(p11: float, p12: float, p22: float, pole: float, drift: float, noise: float) -> tuple[float, float, float]:
    """The same a sample later, once the sum of s and noise is seen (Riccati's equation)."""
    F = p11 + noise
    a11, a12, a22 = p11 * (noise / F), p12 * (noise / F), p22 - p12 * p12 / F
    return pole * pole * a11 + 2.0 * pole * a12 + a22, drift * (pole * a12 + a22), drift * drift * a22 + 1.0


@compiled
def steady(pole: float, drift: float, noise: float) -> tuple[float, float, float]:
    """Return (F, g1, g2): the variance of what is not foretold in the end, and by how much of that the states move.

    The disturbance s + e is a sum of noise e, of variance `noise`, and `s_{k+1} = pole s_k + z_k`,
    `z_{k+1} = drift z_k + w_k`, w of variance 1. Foretold is `s_{k+1} = pole s_k + z_k + g1 v_k`,
    `z_{k+1} = drift z_k + g2 v_k`, v the error of the last.
    """
    p11, p12, p22 = _begun(drift, noise)
    F = p11 + noise
    for _ in range(1_000_000):
        p11, p12, p22 = _onward(p11, p12, p22, pole, drift, noise)
        last, F = F, p11 + noise
        if abs(F - last) <= STEADY * F:
            break
    return F, (pole * p11 + p12) / F, drift * p12 / F


@compiled
def remember(pole: float, drift: float, noise: float, out: Floats) -> None:
    """Write by how much each error counts in what is foretold so many samples later: 1 / D(B), B a sample's delay.

    D is `(1 - pole B)(1 - drift B) + g1 B + (g2 - g1 drift) B^2` with the gains of `steady`.
    """
    _, g1, g2 = steady(pole, drift, noise)
    one, two = -drift - pole + g1, pole * drift + (g2 - g1 * drift)
    last, before = 1.0, 0.0
    for k in range(out.size):
        out[k] = last
        last, before = -one * last - two * before, last


@compiled
def drift_left(
    y: Floats,
    x: Floats,
    first: int,
    integrating: bool,
    tau: float,
    theta: float,
    pole: float,
    drift: float,
    noise: float,
    begin: int,
    room: Floats,
) -> tuple[float, float]:
    """Return what the disturbance of `steady` leaves of PV beside a stem's response, EU^2 a sample, and the gain.

    y, x: PV and the stem path, shape (N,), its first slip `first`; tau, theta: samples. Left is `V exp(mean log F_k)`
    over the samples from `begin` on: F_k the variances foretold of the errors where w's is 1, V their mean square as
    shares of them. Its logarithm times N is -2 log of the likelihood but for a constant. Gain, bias, start and
    transient are by least squares in that measure. room: (ROOM, N).
    """
    n = y.size
    m_pole, c0, c1, m = plant_terms(integrating, tau, theta)
    columns, errors = room[:TERMS], room[TERMS:]
    oe_columns(x, first, m_pole, m, c0, c1, integrating, columns)
    # A sum that begins anywhere has no level of its own.
    level = 0 if pole == 1.0 else 1
    s0 = s1 = s2 = s3 = s4 = 0.0
    z0 = z1 = z2 = z3 = z4 = 0.0
    p11, p12, p22 = _begun(drift, noise)
    F = p11 + noise
    weight, total, settled = 1.0 / math.sqrt(F), 0.0, False
    g1, g2 = (pole * p11 + p12) / F, drift * p12 / F
    for k in range(n):
        if k >= begin:
            total += math.log(F) if not settled else 0.0
        v0, v1, v2 = y[k] - s0, columns[1, k] - s1, columns[2, k] - s2
        v3, v4 = columns[3, k] - s3, level * columns[0, k] - s4
        errors[0, k], errors[1, k], errors[2, k] = v0 * weight, v1 * weight, v2 * weight
        errors[3, k], errors[4, k] = v3 * weight, v4 * weight
        s0, z0 = pole * s0 + z0 + g1 * v0, drift * z0 + g2 * v0
        s1, z1 = pole * s1 + z1 + g1 * v1, drift * z1 + g2 * v1
        s2, z2 = pole * s2 + z2 + g1 * v2, drift * z2 + g2 * v2
        s3, z3 = pole * s3 + z3 + g1 * v3, drift * z3 + g2 * v3
        s4, z4 = pole * s4 + z4 + g1 * v4, drift * z4 + g2 * v4
        # What dies out is nought before its numbers are so small that each sum of them takes long.
        if abs(s2) + abs(z2) < NOTHING:
            s2, z2 = 0.0, 0.0
        if abs(s3) + abs(z3) < NOTHING:
            s3, z3 = 0.0, 0.0
        if not settled:
            p11, p12, p22 = _onward(p11, p12, p22, pole, drift, noise)
            last, F = F, p11 + noise
            weight = 1.0 / math.sqrt(F)
            g1, g2 = (pole * p11 + p12) / F, drift * p12 / F
            if abs(F - last) <= STEADY * F:
                settled = True
                total += (n - max(k + 1, begin)) * math.log(F)
    solved = np.empty((TERMS + 1, TERMS))
    for i in range(TERMS):
        for j in range(i, TERMS):
            solved[i, j] = np.dot(errors[1 + i, begin:], errors[1 + j, begin:])
        solved[TERMS, i] = np.dot(errors[0, begin:], errors[1 + i, begin:])
    left = np.dot(errors[0, begin:], errors[0, begin:]) - solve(solved, TERMS)
    count = n - begin
    return max(left, 0.0) / count * math.exp(total / count), solved[TERMS, 0]
