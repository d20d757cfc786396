"""Many stems tried at a plant that is held: what a valve that sticks unlike upward and downward is told by."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.output_error import (
    own_sums,
    plant_terms,
    solve,
    start_products,
    start_rests,
    stem_products,
)
from workbench.estimate.kernels.parts import in_parts, parted
from workbench.estimate.kernels.path import DOWN_HIGH, DOWN_LOW, UP_HIGH, UP_LOW, each_way_path
from workbench.simulate.compiled import compiled

__all__ = ["HELD", "held_least", "scan_held"]

Floats = NDArray[np.float64]

# Entries that `scan_held` writes for each band beside its cost: where it started, its slips, bias, start, transient.
HELD = 6
WAYS = 64  # paths that are kept in memory: those of the last bands


@compiled
def held_least(room: Floats, yy: float, low: float, high: float, gain: float, terms: Floats) -> float:
    """Sum of squares at a plant that is held, gain included: bias, x0 (within low..high) and transient are free.

    room: as of `least`. Written into terms: bias, gain times x0, transient.
    """
    q, g = room[0], room[1]
    b = g[4]
    power = yy - 2.0 * gain * q[4, 1] + gain * gain * q[1, 1]
    bias, start, transient = q[4, 0] - gain * q[0, 1], q[4, 2] - gain * q[1, 2], q[4, 3] - gain * q[1, 3]
    g[0, 0], g[0, 1], g[0, 2], g[1, 1], g[1, 2], g[2, 2] = q[0, 0], q[0, 2], q[0, 3], q[2, 2], q[2, 3], q[3, 3]
    b[0], b[1], b[2] = bias, start, transient
    explained = solve(g, 3)
    free = b[1] / gain
    if free < low or free > high:
        held = gain * (low if free < low else high)
        power += held * held * q[2, 2] - 2.0 * held * start
        g[0, 0], g[0, 1], g[1, 1] = q[0, 0], q[0, 3], q[3, 3]
        b[0], b[1] = bias - held * q[0, 2], transient - held * q[2, 3]
        explained = solve(g, 2)
        b[1], b[2] = held, b[1]
    terms[0], terms[1], terms[2] = b[0], b[1], b[2]
    left: float = max(power - explained, 0.0)
    return left


@compiled
def _keep(q: Floats, products: Floats) -> None:
    """Copy what `stem_products` writes."""
    products[0], products[1], products[2], products[3], products[4] = q[0, 1], q[1, 1], q[1, 2], q[1, 3], q[4, 1]


@compiled
def _restore(products: Floats, q: Floats) -> None:
    """Write it as that does."""
    q[0, 1], q[1, 1], q[1, 2], q[1, 3], q[4, 1] = products[0], products[1], products[2], products[3], products[4]


@compiled
def scan_held(
    y: Floats,
    op: Floats,
    starts: Floats,
    bands: Floats,
    slack: float,
    gain: float,
    integrating: bool,
    tau: float,
    theta: float,
    costs: Floats,
    found: Floats,
) -> None:
    """Hold a plant and try many stems, each from the start that suits it best.

    starts: rows (first, sense); bands: rows (gap, up, down), see `each_way_path`. slack: share of a Stenman stem's band
    by which it may have rested beyond it until `first`. tau, theta: samples. Written: costs, sums of squares, inf where
    the stem can have slipped at none of the starts; found, rows (first, sense, slips, bias, start, transient). Bands
    that go the same way, of which there are many where they lie close together, are answered once.
    """
    x, white = np.empty(op.size), np.ones(1)
    boxes, products, moved = np.empty((WAYS, 4)), np.empty((WAYS, 5)), np.empty(WAYS)
    room, window, rest, terms = np.empty((2, 5, 4)), np.empty((2, 3)), start_rests(white), np.empty(3)
    total, power = own_sums(y, 0)
    plant = plant_terms(integrating, tau, theta)
    costs[:] = math.inf
    for j in range(starts.shape[0]):
        first, sense = int(starts[j, 0]), starts[j, 1]
        top, bottom = (op[:first].max(), op[:first].min()) if first > 0 else (0.0, 0.0)
        passed = start_products(y, total, first, integrating, plant, white, rest, 0, window, room[0])
        parts = in_parts(y, passed, plant[3] + 1)
        known, oldest = 0, 0
        gone = math.nan
        for i in range(bands.shape[0]):
            gap, up, down = bands[i, 0], bands[i, 1], bands[i, 2]
            low, high = -math.inf, math.inf
            if first > 0:
                band = slack * max(up, down)
                if math.isnan(gap):
                    low, high = top - up - band, bottom + down + band
                    if sense > 0.0:
                        high = min(high, op[first] - up + band)
                    else:
                        low = max(low, op[first] + down - band)
                if low > high or top - bottom > up + down + (0.0 if math.isnan(gap) else gap) + band:
                    continue
            if not (gap == gone or (math.isnan(gap) and math.isnan(gone))):
                known, oldest, gone = 0, 0, gap
            way = 0
            while way < known and not (
                boxes[way, UP_LOW] <= up < boxes[way, UP_HIGH] and boxes[way, DOWN_LOW] <= down < boxes[way, DOWN_HIGH]
            ):
                way += 1
            if way < known:
                _restore(products[way], room[0])
            else:
                way = oldest
                oldest, known = (oldest + 1) % WAYS, min(known + 1, WAYS)
                moved[way] = each_way_path(op, gap, up, down, first, sense, x, boxes[way])
                if parts.size > 0:
                    parted(x, parts)
                stem_products(y, x, first, integrating, plant, 1.0, 0, 0, passed, window, parts, room[0])
                _keep(room[0], products[way])
            slips = moved[way]
            cost = held_least(room, power, low, high, gain, terms)
            if cost < costs[i]:
                costs[i] = cost
                found[i, 0], found[i, 1], found[i, 2] = first, sense, slips
                found[i, 3], found[i, 4], found[i, 5] = terms[0], terms[1], terms[2]
