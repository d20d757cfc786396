"""What least squares asks of a lag's response to a stem, summed in PARTS of the record side by side.

A lag is linear: in each part it begins at nought, and what it had come to when the part began fades within it by powers
of its pole. So no part waits for the one before, and the compiler makes vector instructions of the loops over them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled, fused, place, written_out

__all__ = [
    "AFTER",
    "GONE",
    "PARTS",
    "SS",
    "SY",
    "WEIGHTED_S",
    "Parts",
    "S",
    "in_parts",
    "parted",
    "sum_fading",
    "sum_parts",
]

Floats = NDArray[np.float64]

PARTS = 16
RUN = 6  # samples of a part at a time, its numbers in registers
ROWS = 4  # the same, where the parts are neighbouring samples
LEAST = 2 * RUN  # samples of a part: shorter ones are not worth it
GONE = 1e-100  # of a weight that was 1: before its products become too small for fast arithmetic
# A part's numbers: its response and the input before, and the sums of the response, its square, its product with PV,
# both by their weight, and PV's own.
_S, _LAST, _TOTAL, _SS, _SY, _WS, _WY, _Y = range(0, 8 * PARTS, PARTS)
WIDTH = 8 * PARTS
# What `sum_parts` writes: sums of the response, its square, its product with PV, and of it by its weight, over all
# parts, and the response after the last.
S, SS, SY, WEIGHTED_S, AFTER = range(5)
SUMS = 5


class Parts(NamedTuple):
    """A record's PV and drive in parts of `size` samples from `begin` on, 0 of a record that is too short for them.

    y, drive: sample k of part i at (before + k) PARTS + i, y with none before, the drive with so many of before each
    part. lanes: room to work in; sums: what `sum_parts` wrote.
    """

    begin: int
    size: int
    before: int
    y: Floats
    drive: Floats
    lanes: Floats
    sums: Floats


@compiled
def in_parts(y: Floats, begin: int, longest: int) -> Parts:
    """Return a record of PV in parts that begin at sample `begin`, with room for a drive (`parted`).

    longest: the most whole samples of a dead time that sums are asked for.
    """
    size = max(y.size - begin, 0) // PARTS
    size = size if size >= LEAST else 0
    before = longest + 1
    own, drive = np.empty(size * PARTS), np.empty((before + size) * PARTS if size > 0 else 0)
    if size > 0:
        _part(y, begin, size, 0, own)
    return Parts(begin, size, before, own, drive, np.empty(WIDTH), np.empty(SUMS))


@compiled
def _part(signal: Floats, begin: int, size: int, before: int, out: Floats) -> None:
    """Write a signal in parts, see `Parts`, of which `before` samples stand before each part; 0 before it begins."""
    for k in range(before + size):
        for i in range(PARTS):
            at = begin + i * size - before + k
            out[k * PARTS + i] = signal[at] if at >= 0 else 0.0


@compiled
def parted(drive: Floats, parts: Parts) -> None:
    """Put a drive, shape (N,), into parts."""
    _part(drive, parts.begin, parts.size, parts.before, parts.drive)


@written_out
def _fade(y: Floats, first: int, lanes: Floats, times: float, grow: float, count: int) -> None:
    """`count` rows of PARTS samples each, from `first` on: their sum, and that by their weights."""
    at = place(first)
    for j in range(PARTS):
        weight, own, weighted = lanes[j], lanes[PARTS + j], lanes[2 * PARTS + j]
        for i in range(count):
            v = y[at + place(i * PARTS + j)]
            own += v
            weighted += weight * v
            weight = weight * times + grow
        lanes[j], lanes[PARTS + j], lanes[2 * PARTS + j] = weight, own, weighted


@fused
def sum_fading(y: Floats, begin: int, stop: int, pole: float, integrating: bool) -> tuple[float, float, float]:
    """Return the sum of y over samples [begin, stop), that by their weight, and the weight at `stop`.

    The weights are pole^k from `begin` on, of an integrating plant k.
    """
    lanes = np.empty(3 * PARTS)
    for j in range(PARTS):
        lanes[j] = j if integrating else pole**j
        lanes[PARTS + j], lanes[2 * PARTS + j] = 0.0, 0.0
    times, grow = (1.0, float(PARTS)) if integrating else (pole**PARTS, 0.0)
    k = begin
    while k + ROWS * PARTS <= stop:
        _fade(y, k, lanes, times, grow, ROWS)
        k += ROWS * PARTS
    while k + PARTS <= stop:
        _fade(y, k, lanes, times, grow, 1)
        k += PARTS
    total, weighted, weight = 0.0, 0.0, lanes[0]
    for j in range(PARTS):
        total += lanes[PARTS + j]
        weighted += lanes[2 * PARTS + j]
    while k < stop:
        total += y[k]
        weighted += weight * y[k]
        weight = weight + 1.0 if integrating else weight * pole
        k += 1
    return total, weighted, weight


@written_out
def _sum(
    drive: Floats,
    late: int,
    y: Floats,
    first: int,
    lanes: Floats,
    terms: tuple[float, float, float],
    weights: tuple[float, float, float],
    count: int,
) -> None:
    """`count` samples of all parts, from `first` on; late: the drive's row that the first of them leads to.

    weights: the first one's weight, by what it is multiplied a sample, and what is added to it then.
    """
    pole, c0, c1 = terms
    begun, times, grow = weights
    there, here = place(late * PARTS), place(first * PARTS)
    for j in range(PARTS):
        s, last, weight = lanes[_S + j], lanes[_LAST + j], begun
        total, ss, sy = lanes[_TOTAL + j], lanes[_SS + j], lanes[_SY + j]
        ws, wy, own = lanes[_WS + j], lanes[_WY + j], lanes[_Y + j]
        for i in range(count):
            v, now = y[here + place(i * PARTS + j)], drive[there + place(i * PARTS + j)]
            total += s
            ss += s * s
            sy += s * v
            ws += weight * s
            wy += weight * v
            own += v
            s = pole * s + (c0 * now + c1 * last)
            last = now
            weight = weight * times + grow
        lanes[_S + j], lanes[_LAST + j] = s, last
        lanes[_TOTAL + j], lanes[_SS + j], lanes[_SY + j] = total, ss, sy
        lanes[_WS + j], lanes[_WY + j], lanes[_Y + j] = ws, wy, own


@fused
def sum_parts(parts: Parts, delay: int, terms: tuple[float, float, float], integrating: bool, s: float) -> None:
    """Write the sums of a lag's response to the drive over all parts, see SUMS.

    terms: pole, and the shares of the input `delay` samples ago, fewer than stand before each part, and of that one
    sample further. s: the response at the first sample. The weights are pole^k from there on, of an integrating plant
    k.
    """
    lanes, out, size = parts.lanes, parts.sums, parts.size
    lanes[:] = 0.0
    late = parts.before - delay
    for j in range(PARTS):
        lanes[_LAST + j] = parts.drive[(late - 1) * PARTS + j]
    weight, times, grow = (0.0, 1.0, 1.0) if integrating else (1.0, terms[0], 0.0)
    k, once, twice = 0, 0.0, 0.0
    while k < size:
        count = RUN if k + RUN <= size else 1
        if count == RUN:
            _sum(parts.drive, late + k, parts.y, k, lanes, terms, (weight, times, grow), RUN)
        else:
            _sum(parts.drive, late + k, parts.y, k, lanes, terms, (weight, times, grow), 1)
        for _ in range(count):
            once += weight
            twice += weight * weight
            weight = weight * times + grow
        weight = weight if weight > GONE else 0.0
        k += count
    out[:] = 0.0
    # Of each part: what its response had come to when it began, and the weight that it begins with.
    fades, own = weight, 0.0 if integrating else 1.0
    for j in range(PARTS):
        total, ws, wy = lanes[_TOTAL + j], lanes[_WS + j], lanes[_WY + j]
        if integrating:
            out[S] += total + size * s
            out[SS] += lanes[_SS + j] + s * (2.0 * total + size * s)
            out[SY] += lanes[_SY + j] + s * lanes[_Y + j]
            out[WEIGHTED_S] += own * (total + size * s) + (ws + s * once)
            own += size
            s += lanes[_S + j]
        else:
            out[S] += total + s * once
            out[SS] += lanes[_SS + j] + s * (2.0 * ws + s * twice)
            out[SY] += lanes[_SY + j] + s * wy
            out[WEIGHTED_S] += own * (ws + s * twice)
            own *= fades
            s = lanes[_S + j] + fades * s
    out[AFTER] = s
