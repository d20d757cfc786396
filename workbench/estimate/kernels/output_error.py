"""The output-error model: a plant's response to a stem beside bias, start and transient, and what it leaves of PV.

Time is counted in samples; PV and OP are centred by the caller.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.detect.whitening import whiten
from workbench.estimate.kernels.parts import (
    AFTER,
    GONE,
    PARTS,
    SS,
    SY,
    WEIGHTED_S,
    Parts,
    S,
    in_parts,
    parted,
    sum_fading,
    sum_parts,
)
from workbench.simulate.compiled import compiled, copy

__all__ = [
    "BIAS",
    "FIT",
    "GAIN",
    "NO_DELAY",
    "SSE",
    "START",
    "TAU",
    "THETA",
    "TRANSIENT",
    "drive_of",
    "least",
    "oe_columns",
    "oe_cost",
    "own_sums",
    "passed_by",
    "plant_terms",
    "posed",
    "posed_alike",
    "solve",
    "start_products",
    "start_rests",
    "stem_products",
    "transient_at",
]

Floats = NDArray[np.float64]
Plant = tuple[float, float, float, int]

# Entries of a fit that `oe_cost` writes.
SSE, TAU, THETA, GAIN, BIAS, START, TRANSIENT = range(7)
FIT = 7
DIED = 25.0  # time constants after which nothing is left of a start in double precision
NOTHING = 1e-300  # below it what dies out is 0: numbers without all their digits are many times slower
NO_DELAY = 1e-4  # samples: a dead time as good as none, to which a fit comes and which is told as none
STEP = 16  # samples of dead time
REACH = 64  # samples that are summed one by one rather than part a record anew
FADED = 1e-6  # of a transient, at the first sample that counts, from which it is left out


class Posed(NamedTuple):
    """A stem whose plant is sought: see `oe_cost`; own: of `own_sums`, rest: of `start_rests`, and room to work in."""

    y: Floats
    own: tuple[float, float]
    drive: Floats
    first: int
    bounds: tuple[float, float, float]
    integrating: bool
    a: Floats
    rest: Floats
    skip: int
    window: Floats
    parts: Parts
    room: Floats


@compiled
def plant_terms(integrating: bool, tau: float, theta: float) -> tuple[float, float, float, int]:
    """Return a plant's pole, the shares c0 and c1 of its two inputs, and the whole samples of its dead time.

    `y_{k+1} = a y_k + c0 v_{k-m} + c1 v_{k-m-1}` of gain 1, a sample being the unit of time.
    """
    m = math.floor(theta + 1e-9)
    f = theta - m
    if f < 1e-9:
        f = 0.0
    if integrating:
        return 1.0, 1.0 - f, f, m
    pole = math.exp(-1.0 / tau)
    part = pole ** (1.0 - f)
    return pole, 1.0 - part, part - pole, m


@compiled
def oe_columns(
    x: Floats, first: int, pole: float, m: int, c0: float, c1: float, integrating: bool, columns: Floats
) -> None:
    """Write the output-error model's columns, shape (4, N): 1, response to the stem, to x0 = 1, and the transient.

    FOPDT of gain 1 with `y_{k+1} = a y_k + c0 v_{k-m} + c1 v_{k-m-1}`; the transient is a^k. Integrating: a = 1, the
    transient is the ramp k of a constant load.
    """
    s, g, r = 0.0, 0.0 if integrating else 1.0, 0.0 if integrating else 1.0
    for k in range(x.size):
        columns[0, k] = 1.0
        columns[1, k] = s
        columns[2, k] = g
        columns[3, k] = r
        near, far = k - m, k - m - 1
        s = pole * s
        g = pole * g if g > NOTHING else 0.0
        if near >= first:
            s += c0 * x[near]
        else:
            g += c0
        if far >= first:
            s += c1 * x[far]
        else:
            g += c1
        r = r + 1.0 if integrating else r * pole if r > NOTHING else 0.0


@compiled
def drive_of(x: Floats, first: int, a: Floats, drive: Floats) -> None:
    """Write what drives the model along a stem path: 0 before `first`, the path from there on, filtered by a."""
    drive[:first] = 0.0
    whiten(a, x[first:], drive[first:])


@compiled
def start_rests(a: Floats) -> Floats:
    """Return what is left of a start in the filter, rest[q] q samples after it ended: shape (p + 2,), the last is 0.

    rest[0] is what the filter makes of a constant; the sum of the others, by how many samples it delays a ramp.
    """
    rest = np.zeros(a.size + 1)
    for q in range(a.size - 1, -1, -1):
        rest[q] = rest[q + 1] + a[q]
    if abs(rest[0]) < 1e-12:
        rest[0] = 0.0  # of a filter that takes constants: rounding
    return rest


@compiled
def transient_at(skip: int, integrating: bool, pole: float, whole: float, lead: float, a: Floats) -> float:
    """Return the filtered transient (`oe_columns`) at the first sample that counts, 0 where it has died out before."""
    if integrating:
        return whole * skip - lead
    r = 0.0
    if skip == 0 or pole**skip >= FADED:
        for q in range(a.size):
            r += a[q] * pole ** (skip - q)
    return r


@compiled
def own_sums(y: Floats, skip: int) -> tuple[float, float]:
    """Return the sums of y and of y^2 over the samples that count, from `skip` on."""
    total, power = 0.0, 0.0
    for k in range(skip, y.size):
        total += y[k]
        power += y[k] * y[k]
    return total, power


@compiled
def fading(pole: float) -> int:
    """Return the samples in which a lag forgets its start, in double precision."""
    return int(1.0 + (DIED / -math.log(pole) if pole > 0.0 else 0.0))


@compiled
def passed_by(first: int, m: int, p: int, skip: int) -> int:
    """Return the first sample that counts, from which on the start has passed dead time and filter."""
    return max(first + m + p + 2, skip)


@compiled
def start_products(
    y: Floats,
    total: float,
    first: int,
    integrating: bool,
    plant: Plant,
    a: Floats,
    rest: Floats,
    skip: int,
    window: Floats,
    out: Floats,
) -> int:
    """Write the products of the constant, the start and the transient with each other and with y: no stem is in them.

    See `oe_cost`. total: the sum of y (`own_sums`). plant: of `plant_terms`; rest: of `start_rests`. out, (5, 4): of
    rows 0 to 3 the upper half, those with y in row 4.
    Returned: the first sample that counts from which on start and transient only fade as pole^q (integrating: stay,
    and grow as q); window, (2, p + 3): both, in this sample and in as many before it as they may be together with a
    response, that of the sample itself last.
    """
    n, p = y.size, a.size - 1
    pole, c0, c1, m = plant
    whole, lead = rest[0], 0.0
    for q in range(1, p + 1):
        lead += rest[q]
    r = transient_at(skip, integrating, pole, whole, lead, a)
    passed = min(passed_by(first, m, p, skip), n)
    begin = first + m
    g = whole * begin - lead if integrating else whole
    for k in range(begin, min(skip, passed)):
        near, far = min(k - begin + 1, p + 1), min(k - begin, p + 1)
        g = pole * g + (c0 * rest[near] + c1 * rest[far])
    if skip < begin and integrating:
        g = whole * skip - lead
    # Weights of pole^q, or of q where the plant forgets nothing.
    grow = 1.0 if integrating else 0.0
    gy, gg, gr, ry, rr, g1, r1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(skip, passed):
        v = y[k]
        i = k - (passed - p - 2)
        if i >= 0:
            window[0, i], window[1, i] = g, r
        g1 += g
        gg += g * g
        gy += g * v
        r1 += r
        rr += r * r
        ry += r * v
        gr += g * r
        near, far = min(max(k - begin + 1, 0), p + 1), min(max(k - begin, 0), p + 1)
        g = pole * g + (c0 * rest[near] + c1 * rest[far])
        r = r * pole + grow * whole
    window[0, p + 2], window[1, p + 2] = g, r
    count = n - passed
    if not integrating:
        # Once they have died out the stem's response alone is left.
        count = min(count, fading(pole))
    late_y, weighted_y, weight = sum_fading(y, passed, passed + count, pole, integrating)
    if integrating:
        sum_q = 0.5 * count * (count - 1.0)
        sum_qq = sum_q * (2.0 * count - 1.0) / 3.0
        late_r = count * r + whole * sum_q
        g1 += count * g
        gg += count * g * g
        gy += g * late_y
        r1 += late_r
        rr += count * r * r + 2.0 * r * whole * sum_q + whole * whole * sum_qq
        ry += r * late_y + whole * weighted_y
        gr += g * late_r
    else:
        sum_e, sum_ee = (1.0 - weight) / (1.0 - pole), (1.0 - weight * weight) / (1.0 - pole * pole)
        g1 += g * sum_e
        gg += g * g * sum_ee
        gy += g * weighted_y
        r1 += r * sum_e
        rr += r * r * sum_ee
        ry += r * weighted_y
        gr += g * r * sum_ee
    out[0, 0], out[0, 2], out[0, 3] = whole * whole * (n - skip), whole * g1, whole * r1
    out[2, 2], out[2, 3], out[3, 3] = gg, gr, rr
    out[4, 0], out[4, 2], out[4, 3] = whole * total, gy, ry
    return passed


@compiled
def stem_products(
    y: Floats,
    drive: Floats,
    first: int,
    integrating: bool,
    plant: Plant,
    whole: float,
    p: int,
    skip: int,
    passed: int,
    window: Floats,
    parts: Parts,
    out: Floats,
) -> None:
    """Write the products of the response to a stem with itself, with y and with what `start_products` is about.

    whole: what the filter of order p makes of a constant. passed, window: as `start_products` gave them. parts: most of
    y and drive side by side.
    """
    n = y.size
    pole, c0, c1, m = plant
    s, sy, ss, sg, sr, s1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(first + m, passed):
        i = k - (passed - p - 2)
        if k >= skip and i >= 0:
            s1 += s
            ss += s * s
            sy += s * y[k]
            sg += s * window[0, i]
            sr += s * window[1, i]
        s = pole * s + c0 * drive[k - m]
        if k > m:
            s += c1 * drive[k - m - 1]
    late_s, weighted_s, grow, span = 0.0, 0.0, 1.0 if integrating else 0.0, parts.size * PARTS
    weight, k = 1.0 - grow, passed
    split = span > 0 and passed <= parts.begin and m < parts.before
    # One by one up to the parts, and what is left after them.
    for end in (parts.begin if split else n, n):
        while k < end:
            late_s += s
            ss += s * s
            sy += s * y[k]
            weighted_s += weight * s
            s = pole * s + (c0 * drive[k - m] + c1 * drive[k - m - 1])
            weight = weight * pole + grow
            weight = weight if weight > GONE else 0.0
            k += 1
        if split and end < n:
            sum_parts(parts, m, (pole, c0, c1), integrating, s)
            sums = parts.sums
            ss, sy, late_s, s = ss + sums[SS], sy + sums[SY], late_s + sums[S], sums[AFTER]
            weighted_s += weight * sums[S] + sums[WEIGHTED_S] if integrating else weight * sums[WEIGHTED_S]
            weight = weight + span if integrating else weight * pole**span
            k += span
    g, r = window[0, p + 2], window[1, p + 2]
    if integrating:
        sg += g * late_s
        sr += r * late_s + whole * weighted_s
    else:
        sg += g * weighted_s
        sr += r * weighted_s
    out[0, 1], out[1, 1] = whole * (s1 + late_s), ss
    out[1, 2], out[1, 3], out[4, 1] = sg, sr, sy


@compiled
def solve(g: Floats, size: int) -> float:
    """Solve the normal equations by elimination in place; columns that add nothing get 0. Return b' G^-1 b.

    g: rows of the matrix, of which the upper half is read, and in the last row the right side b, then the solution.
    """
    b = g[g.shape[0] - 1]
    for i in range(1, size):
        # What a column is before the others are taken from it stands in the half that is not used.
        g[i, 0] = g[i, i]
    explained = 0.0
    for i in range(size):
        whole = g[i, i] if i == 0 else g[i, 0]
        if not (g[i, i] > 1e-11 * whole and g[i, i] > 0.0):
            g[i, i] = 0.0
            continue
        explained += b[i] * b[i] / g[i, i]
        for j in range(i + 1, size):
            factor = g[i, j] / g[i, i]
            for k in range(j, size):
                g[j, k] -= factor * g[i, k]
            b[j] -= factor * b[i]
    for i in range(size - 1, -1, -1):
        if g[i, i] == 0.0:
            b[i] = 0.0
            continue
        for k in range(i + 1, size):
            b[i] -= g[i, k] * b[k]
        b[i] /= g[i, i]
    return explained


@compiled
def least(
    room: Floats, yy: float, low: float, high: float, sign: float, tau: float, theta: float, out: Floats
) -> float:
    """Solve the normal equations of `oe_columns` with x0 in [low, high] and the gain's sign (see `oe_cost`).

    room, (2, 5, 4): the products as `start_products` and `stem_products` write them, and as much to work in.
    """
    q, g = room[0], room[1]
    for i in range(q.shape[0]):
        copy(q[i], g[i])
    b = g[4]
    explained = solve(g, 4)
    if b[1] * sign < 0.0:
        # A gain of the other sign is the controller's inverse, not the plant: the stem then has no part in PV.
        g[0, 0], g[0, 1], g[1, 1] = q[0, 0], q[0, 3], q[3, 3]
        b[0], b[1] = q[4, 0], q[4, 3]
        explained = solve(g, 2)
        b[3], b[1], b[2] = b[1], 0.0, 0.0
    elif math.isfinite(low) or math.isfinite(high):
        gain = b[1]
        x0 = b[2] / gain if gain != 0.0 else math.inf
        if not low <= x0 <= high:
            # The nearer end: stem and start move together, as one column.
            x0 = low if (not x0 > low) else high
            g[0, 0], g[0, 2], g[2, 2] = q[0, 0], q[0, 3], q[3, 3]
            g[0, 1] = q[0, 1] + x0 * q[0, 2]
            g[1, 1] = q[1, 1] + 2.0 * x0 * q[1, 2] + x0 * x0 * q[2, 2]
            g[1, 2] = q[1, 3] + x0 * q[2, 3]
            b[0], b[1], b[2] = q[4, 0], q[4, 1] + x0 * q[4, 2], q[4, 3]
            explained = solve(g, 3)
            b[3] = b[2]
            b[2] = x0 * b[1]
    sse = max(yy - explained, 0.0)
    out[SSE], out[TAU], out[THETA] = sse, tau, theta
    out[GAIN], out[BIAS], out[START], out[TRANSIENT] = b[1], b[0], b[2], b[3]
    return sse


@compiled
def oe_cost(
    y: Floats,
    drive: Floats,
    first: int,
    low: float,
    high: float,
    sign: float,
    integrating: bool,
    tau: float,
    theta: float,
    a: Floats,
    skip: int,
    out: Floats,
) -> float:
    """Sum of squares of the output-error model at a time constant and dead time (samples), the rest by least squares.

    y: PV, and drive: the stem from `first` on (`drive_of`), both filtered by a = (1, -a_1, .., -a_p), the residual's
    autoregression (generalized least squares); the first `skip` samples, p or more, do not count. The model's columns
    are those of `oe_columns`, filtered alike: a first-order lag answers a filtered drive as it answers the drive. low,
    high: the range in which x0 must lie for the stem to rest until `first` (infinite for none); where the free x0 falls
    outside, it is set to the nearer end. sign: the gain's sign, 0 for either. Written into `out` (FIT): SSE, TAU,
    THETA, GAIN (per sample for integrating plants), BIAS, START (gain times x0) and TRANSIENT.
    """
    return cost_at(posed(y, drive, first, (low, high, sign), integrating, a, skip, int(theta)), tau, theta, out)


@compiled
def posed(
    y: Floats,
    drive: Floats,
    first: int,
    bounds: tuple[float, float, float],
    integrating: bool,
    a: Floats,
    skip: int,
    longest: int,
) -> Posed:
    """Gather what all costs of one stem share, as `oe_cost` takes it; bounds: (low, high, sign).

    longest: whole samples of dead time; what is beyond them takes longer.
    """
    room, window = np.empty((2, 5, 4)), np.empty((2, a.size + 2))
    # In steps: a dead time that is searched and one that is given mostly part the record alike, and round alike.
    longest = (longest // STEP + 1) * STEP
    parts = in_parts(y, passed_by(first, longest, a.size - 1, skip), longest)
    if parts.size > 0:
        parted(drive, parts)
    return Posed(y, own_sums(y, skip), drive, first, bounds, integrating, a, start_rests(a), skip, window, parts, room)


@compiled
def posed_alike(of: Posed, drive: Floats, first: int) -> Posed:
    """Gather the same for another stem of the same record, which makes use of the other's room."""
    parts = of.parts
    least = passed_by(first, parts.before - 1, of.a.size - 1, of.skip)
    if not least <= parts.begin <= least + REACH:
        # So that stems that start somewhat later find PV in parts too.
        parts = in_parts(of.y, least + REACH // 2, parts.before - 1)
    if parts.size > 0:
        parted(drive, parts)
    return Posed(
        of.y, of.own, drive, first, of.bounds, of.integrating, of.a, of.rest, of.skip, of.window, parts, of.room
    )


@compiled
def cost_at(of: Posed, tau: float, theta: float, out: Floats) -> float:
    """`oe_cost` of what is posed."""
    low, high, sign = of.bounds
    plant = plant_terms(of.integrating, tau, theta)
    products, window = of.room[0], of.window
    passed = start_products(of.y, of.own[0], of.first, of.integrating, plant, of.a, of.rest, of.skip, window, products)
    stem_products(
        of.y,
        of.drive,
        of.first,
        of.integrating,
        plant,
        of.rest[0],
        of.a.size - 1,
        of.skip,
        passed,
        window,
        of.parts,
        products,
    )
    return least(of.room, of.own[1], low, high, sign, tau, theta, out)
