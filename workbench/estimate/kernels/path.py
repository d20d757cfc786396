"""The paths of stems that stick, from OP and the valve's parameters, and the ranges in which they stay as they are.

Time is counted in samples here and OP is centred, as in all kernels of the estimation. The stem before its first
visible slip (`first`) is an unknown constant x0; from there on the path follows from OP and the valve alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled

__all__ = [
    "DOWN_HIGH",
    "DOWN_LOW",
    "J_HIGH",
    "J_LOW",
    "S_HIGH",
    "S_LOW",
    "UP_HIGH",
    "UP_LOW",
    "band_path",
    "each_way_path",
    "rest_range",
    "spans_of",
    "stem_path",
    "stem_slips",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Entries that `band_path` writes, and `each_way_path`.
S_LOW, S_HIGH, J_LOW, J_HIGH = range(4)
UP_LOW, UP_HIGH, DOWN_LOW, DOWN_HIGH = range(4)
SPAN = 8  # samples of OP that a stem may rest through at once


@compiled
def spans_of(op: Floats) -> Floats:
    """Return the least and the largest of each SPAN samples of OP, shape (2, N // SPAN): what `band_path` takes."""
    spans = np.empty((2, op.size // SPAN))
    for i in range(spans.shape[1]):
        low, high = math.inf, -math.inf
        for k in range(i * SPAN, (i + 1) * SPAN):
            low = op[k] if op[k] < low else low
            high = op[k] if op[k] > high else high
        spans[0, i], spans[1, i] = low, high
    return spans


@compiled
def stem_slips(op: Floats, d: float, first: int, at: Ints) -> tuple[int, float]:
    """Write the samples at which a Stenman stem slips, the one at `first` included.

    Return their number and the smallest slip after the first (inf without one): the path holds for every band from the
    largest |u - x| it rests at up to, but not including, that smallest slip.
    """
    x = op[first]
    at[0] = first
    count = 1
    smallest = math.inf
    for k in range(first + 1, op.size):
        move = abs(op[k] - x)
        if move > d:
            if move < smallest:
                smallest = move
            x = op[k]
            at[count] = k
            count += 1
    return count, smallest


@compiled
def stem_path(op: Floats, d: float, first: int, x: Floats) -> int:
    """Write the stem's path, 0 before `first`; return the number of slips, the one at `first` included."""
    x[:first] = 0.0
    held, begin = op[first], first
    slips = 1
    # Written from slip to slip: a stem chosen anew at each sample would make each wait for the one before.
    for k in range(first + 1, op.size):
        if abs(op[k] - held) > d:
            x[begin:k] = held
            held, begin = op[k], k
            slips += 1
    x[begin:] = held
    return slips


@compiled
def rest_range(op: Floats, first: int, d_low: float, d_high: float, slack: float) -> tuple[float, float]:
    """Range of x0 for which a stem with d in [d_low, d_high) rests until it slips at `first`; infinite for first 0.

    Widened by `slack` times d_high on both sides.
    """
    if first == 0:
        return -math.inf, math.inf
    top, bottom = op[:first].max(), op[:first].min()
    low, high = top - d_high, bottom + d_high
    if op[first] > top:
        high = min(high, op[first] - d_low)
    else:
        low = max(low, op[first] + d_low)
    return min(low, high) - slack * d_high, max(low, high) + slack * d_high


@compiled
def band_path(op: Floats, spans: Floats, S: float, J: float, first: int, sense: float, x: Floats, box: Floats) -> int:
    """Write the path of a two-parameter (Choudhury) stem; return the number of times it slips.

    op, spans: OP, shape (N,), and `spans_of` it.
    first: its first slip, the stem before it is unknown and written 0, or -1 for a stem that rests in the middle of its
    band at OP's first value. sense: of the first slip, +1 or -1, not used for first = -1. A stem that was led to w in
    sense s stands at `w - s (S - J)/2`; it turns where OP comes back by more than S from w and moves on where OP goes
    on by more than J. Written into box: (S_LOW, S_HIGH, J_LOW, J_HIGH), the rectangle in which the same slips happen,
    S_LOW <= S < S_HIGH and J_LOW <= J < J_HIGH (inf for none); for first = -1 it does not bound the first slip.
    """
    offset = 0.5 * (S - J)
    box[S_LOW], box[S_HIGH], box[J_LOW], box[J_HIGH] = 0.0, math.inf, 0.0, math.inf
    back_held, back, on_held, further = 0.0, math.inf, 0.0, math.inf
    n = op.size
    if first < 0:
        band = 0.5 * (S + J)
        k = 0
        while k < n and abs(op[k] - op[0]) <= band:
            x[k] = op[0]
            k += 1
        if k == n:
            return 0
        sense = 1.0 if op[k] > op[0] else -1.0
        first = k
    else:
        x[:first] = 0.0
    led = op[first]
    x[first] = led - sense * offset
    moving = True
    slips = 1
    k = first + 1
    while k < n:
        if not moving and k % SPAN == 0 and k + SPAN <= n:
            # Where all of a span is held, none of its samples is looked at.
            above, below = spans[1, k // SPAN] - led, led - spans[0, k // SPAN]
            ahead, behind = (above, below) if sense > 0.0 else (below, above)
            if ahead <= J and behind <= S:
                on_held = max(on_held, ahead)
                back_held = max(back_held, behind)
                for i in range(SPAN):
                    x[k + i] = led - sense * offset
                k += SPAN
                continue
        if moving and (op[k] - op[k - 1]) * sense > 0.0:
            led = op[k]
        else:
            moving = False
            on = (op[k] - led) * sense
            if on > J:
                further = min(further, on)
                moving = True
            elif -on > S:
                back = min(back, -on)
                sense = -sense
                moving = True
            else:
                on_held = max(on_held, on)
                back_held = max(back_held, -on)
            if moving:
                led = op[k]
                slips += 1
        x[k] = led - sense * offset
        k += 1
    box[S_LOW], box[S_HIGH], box[J_LOW], box[J_HIGH] = back_held, back, on_held, further
    return slips


@compiled
def each_way_path(
    op: Floats, gap: float, up: float, down: float, first: int, sense: float, x: Floats, box: Floats
) -> int:
    """Write the path of a stem that sticks differently upward and downward, 0 before its first slip; return its slips.

    gap nan: a Stenman stem, which slips to OP where OP leads by more than `up` above or `down` below. Else the stem of
    `band_path`, gap = S - J apart in its two directions, with the slip jumps J = up and down: having been led to w in
    sense s it moves on beyond J of s and turns beyond gap + J of the other sense. Written into box: (UP_LOW, UP_HIGH,
    DOWN_LOW, DOWN_HIGH), the rectangle in which the path is the same, UP_LOW <= up < UP_HIGH and so on.
    """
    x[:first] = 0.0
    slips = 1
    # The furthest that was held, and the least beyond which the stem slipped, upward and downward.
    up_held, up_slip, down_held, down_slip = -math.inf, math.inf, -math.inf, math.inf
    if math.isnan(gap):
        held = op[first]
        for k in range(first, op.size):
            lead = op[k] - held
            if lead > up or -lead > down:
                if lead > up:
                    up_slip = min(up_slip, lead)
                else:
                    down_slip = min(down_slip, -lead)
                held = op[k]
                slips += 1
            else:
                up_held = max(up_held, lead)
                down_held = max(down_held, -lead)
            x[k] = held
        box[UP_LOW], box[UP_HIGH], box[DOWN_LOW], box[DOWN_HIGH] = up_held, up_slip, down_held, down_slip
        return slips
    led = op[first]
    x[first] = led - sense * 0.5 * gap
    moving = True
    for k in range(first + 1, op.size):
        if moving and (op[k] - op[k - 1]) * sense > 0.0:
            led = op[k]
        else:
            moving = False
            # Upward it moves on, or turns, as its sense says, and downward.
            lead = op[k] - led
            rising, falling = (0.0, gap) if sense > 0.0 else (gap, 0.0)
            if lead > rising + up:
                up_slip = min(up_slip, lead - rising)
                sense, moving = 1.0, True
            elif -lead > falling + down:
                down_slip = min(down_slip, -lead - falling)
                sense, moving = -1.0, True
            else:
                up_held = max(up_held, lead - rising)
                down_held = max(down_held, -lead - falling)
            if moving:
                led = op[k]
                slips += 1
        x[k] = led - sense * 0.5 * gap
    box[UP_LOW], box[UP_HIGH], box[DOWN_LOW], box[DOWN_HIGH] = up_held, up_slip, down_held, down_slip
    return slips
