"""The stem of a valve that does not stick alike at every slip, from OP, PV and a plant: the likeliest by a beam search.

Time is counted in samples and signals are centred, as in all kernels of the estimation. Each rest holds until OP has
gone on by a band of its own, normally distributed; where PV speaks for a slip now, or for one a little later, both are
followed on, and of all stems that are, the likeliest few are kept (the M-algorithm: J. B. Anderson, S. Mohan, IEEE
Trans. Commun. 32 (1984) 169-176).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled

__all__ = ["BEAM", "uneven_path"]

Floats = NDArray[np.float64]

BEAM = 32  # stems that are followed at once
SAME = 3  # of them, that last slipped at the same sample
BEHIND = 120.0  # of twice the log likelihood: a stem that is so far behind is given up
EARLY, LATE = -5.0, 6.0  # standard deviations of the band: sooner no stem slips, later none rests
RARE = 1e-7  # the least chance that is told from none

# Columns of a stem that is followed; PRICE: what its slips cost, of twice the log likelihood.
COST, PRICE, LED, SENSE, MOVING, ON, BACK, ANSWER, LAST, FROM, SLIPPED, HELD, GONE = range(13)
STATE = 13


@compiled
def _tail(z: float) -> float:
    """The chance that a standard normal variable is above z."""
    return 0.5 * math.erfc(z / math.sqrt(2.0))


@compiled
def _slips_now(held: float, now: float, band: float, spread: float) -> float:
    """The chance that a rest that held up to `held` ends on the way to `now`, its band normally distributed."""
    if now <= held or now < band + EARLY * spread:
        return 0.0
    if now > band + LATE * spread:
        return 1.0
    before = _tail((held - band) / spread)
    return 1.0 - _tail((now - band) / spread) / before if before > 0.0 else 1.0


@compiled
def _branch(
    state: Floats, h: int, then: Floats, count: int, now: float, last: float, sticks: bool, valve: Floats
) -> int:
    """Write what may become of stem h as OP comes to `now` from `last`: rest, slip or move on; return the new count."""
    S, J, spread = valve[0], valve[1], valve[2]
    for column in range(STATE):
        then[count, column] = state[h, column]
    then[count, FROM], then[count, SLIPPED] = h, 0.0
    led, sense = state[h, LED], state[h, SENSE]
    if not sticks and state[h, MOVING] > 0.0 and (now - last) * sense > 0.0:
        then[count, LED] = now
        return count + 1
    if state[h, MOVING] > 0.0:
        then[count, MOVING], then[count, ON], then[count, BACK] = 0.0, 0.0, 0.0
    # Away from where it rests OP goes on, or comes back, as the stem was led; one that sticks at once knows no sense.
    lead = abs(now - led) if sticks else (now - led) * sense
    side = ON if lead > 0.0 else BACK
    held, gone, band = then[count, side], abs(lead), J if lead > 0.0 else S
    chance = _slips_now(held, gone, band, spread)
    if chance > RARE:
        other = count + 1 if chance < 1.0 - RARE else count
        for column in range(STATE):
            then[other, column] = then[count, column]
        price = -2.0 * math.log(min(chance, 1.0))
        then[other, COST] += price
        then[other, PRICE] += price
        # What the band goes beyond S - J by, whichever way it was gone through.
        beyond = S - J if side == BACK else 0.0
        then[other, SLIPPED], then[other, HELD], then[other, GONE] = 1.0, held - beyond, gone - beyond
        then[other, LED], then[other, ON], then[other, BACK] = now, 0.0, 0.0
        if not sticks:
            then[other, MOVING], then[other, SENSE] = 1.0, sense if lead > 0.0 else -sense
        if other == count:
            return count + 1
        price = -2.0 * math.log(1.0 - chance)
        then[count, COST] += price
        then[count, PRICE] += price
        then[count, side] = gone
        return count + 2
    then[count, side] = max(held, gone)
    return count + 1


@compiled
def uneven_path(
    y: Floats,
    u: Floats,
    plant: tuple[float, float, float, int],
    terms: Floats,
    sticks: bool,
    valve: Floats,
    variance: float,
    starts: Floats,
    a: Floats,
    skip: int,
    x: Floats,
    senses: Floats,
    slips: Floats,
) -> tuple[float, int]:
    """Write the likeliest stem and its senses, shape (N,); return the price of its slips and their number.

    The price is twice a log likelihood. y, u: PV and OP. plant: as of `plant_terms`; terms: (gain, bias, response at
    the start, ramp), the ramp of an integrating plant alone. sticks: whether the stem sticks again at once (Stenman),
    or is led on (see `band_path`); valve: (S, J, spread), the means of the band as OP comes back and as it goes on, S =
    J for one that sticks at once, and their standard deviation. variance: EU^2, of what the model leaves, filtered by
    a, from sample `skip` on. starts: rows (stem, sense) that the record may begin with. Written into slips, shape
    (N, 3), a row each, the last first: the sample, and between which bands the valve's then was, beyond S - J where OP
    had come back.
    """
    n, order = y.size, a.size
    pole, c0, c1, m = plant
    gain, bias, begun, ramp = terms[0], terms[1], terms[2], terms[3]
    gap = 0.0 if sticks else valve[0] - valve[1]
    room, depth = max(BEAM, len(starts)), m + 2
    state, then = np.empty((room, STATE)), np.empty((2 * room, STATE))
    # What each of them had in its last samples, sample k in column k modulo their number.
    stems, stems_then = np.empty((room, depth)), np.empty((room, depth))
    left, left_then = np.empty((room, order)), np.empty((room, order))
    parents, told = np.empty((n, room), np.int32), np.empty((n, room, 5))
    ranked = np.empty(2 * room, np.int64)
    alive = len(starts)
    for h in range(alive):
        for column in range(STATE):
            state[h, column] = 0.0
        state[h, SENSE], state[h, LED] = starts[h, 1], starts[h, 0] + 0.5 * starts[h, 1] * gap
        state[h, ANSWER], state[h, LAST] = begun, -1.0 - h
        for i in range(depth):
            stems[h, i] = starts[h, 0]
    for k in range(n):
        best = math.inf
        for h in range(alive):
            error = y[k] - bias - ramp * k - state[h, ANSWER]
            left[h, k % order] = error
            for i in range(1, min(order, k + 1)):
                error += a[i] * left[h, (k - i) % order]
            if k >= skip:
                state[h, COST] += error * error / variance
            best = min(best, state[h, COST])
        count = 0
        for h in range(alive):
            if state[h, COST] <= best + BEHIND:
                count = _branch(state, h, then, count, u[k], u[max(k - 1, 0)], sticks, valve)
        for i in range(count):
            if then[i, SLIPPED] > 0.0:
                then[i, LAST] = k
            # They are few, and mostly in order.
            j = i
            while j > 0 and then[ranked[j - 1], COST] > then[i, COST]:
                ranked[j] = ranked[j - 1]
                j -= 1
            ranked[j] = i
        alive = 0
        for i in range(count):
            one, same = ranked[i], 0
            for h in range(alive):
                same += state[h, LAST] == then[one, LAST]
            if same == SAME or alive == BEAM:
                continue
            came, stem = int(then[one, FROM]), then[one, LED] - 0.5 * then[one, SENSE] * gap
            for column in range(STATE):
                state[alive, column] = then[one, column]
            for j in range(depth):
                stems_then[alive, j] = stems[came, j]
            for j in range(order):
                left_then[alive, j] = left[came, j]
            stems_then[alive, k % depth] = stem
            near, far = stems_then[alive, (k - m) % depth], stems_then[alive, (k - m - 1) % depth]
            state[alive, ANSWER] = pole * then[one, ANSWER] + gain * (c0 * near + c1 * far)
            parents[k, alive] = came
            told[k, alive, 0], told[k, alive, 1] = stem, then[one, SLIPPED]
            told[k, alive, 2], told[k, alive, 3] = then[one, HELD], then[one, GONE]
            told[k, alive, 4] = then[one, SENSE]
            alive += 1
        stems, stems_then = stems_then, stems
        left, left_then = left_then, left
    # The first is the likeliest.
    h, count = 0, 0
    for k in range(n - 1, -1, -1):
        x[k], senses[k] = told[k, h, 0], told[k, h, 4]
        if told[k, h, 1] > 0.0:
            slips[count, 0], slips[count, 1], slips[count, 2] = k, told[k, h, 2], told[k, h, 3]
            count += 1
        h = parents[k, h]
    return state[0, PRICE], count
