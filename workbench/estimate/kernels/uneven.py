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

# Columns of a stem that is followed; PRICE: what its slips cost, of twice the log likelihood; ON and BACK: how far OP
# went each way since it rests, and ABOVE columns further the chance that the band is wider, or UNKNOWN.
COST, PRICE, LED, SENSE, MOVING, ON, BACK, _, _, ANSWER, SLIPPED, HELD, GONE = range(13)
STATE, ABOVE, UNKNOWN = 13, 2, -1.0


@compiled
def _tail(z: float) -> float:
    """The chance that a standard normal variable is above z."""
    return 0.5 * math.erfc(z / math.sqrt(2.0))


@compiled
def _slips_now(held: float, before: float, now: float, band: float, spread: float) -> tuple[float, float]:
    """The chance that a rest that held up to `held` ends on the way to `now`, its band normally distributed.

    before: the chance that the band is above `held`, or UNKNOWN; returned as well is that for `now`, as far as asked.
    """
    if now <= held:
        return 0.0, before
    if now < band + EARLY * spread:
        return 0.0, UNKNOWN
    if now > band + LATE * spread:
        return 1.0, UNKNOWN
    after = _tail((now - band) / spread)
    if before == UNKNOWN:
        before = _tail((held - band) / spread)
    return 1.0 - after / before if before > 0.0 else 1.0, after


@compiled
def _rest(state: Floats, row: int) -> None:
    """Let a stem begin to rest."""
    for side in (ON, BACK):
        state[row, side], state[row, side + ABOVE] = 0.0, UNKNOWN


@compiled
def _branch(state: Floats, row: int, other: int, now: float, last: float, sticks: bool, valve: Floats) -> bool:
    """Go on with the stem of a row as OP comes to `now` from `last`; return whether it may slip, too, in `other`."""
    S, J, spread = valve[0], valve[1], valve[2]
    state[row, SLIPPED] = 0.0
    led, sense = state[row, LED], state[row, SENSE]
    if not sticks and state[row, MOVING] > 0.0 and (now - last) * sense > 0.0:
        state[row, LED] = now
        return False
    if state[row, MOVING] > 0.0:
        state[row, MOVING] = 0.0
        _rest(state, row)
    # Away from where it rests OP goes on, or comes back, as the stem was led; one that sticks at once knows no sense.
    lead = abs(now - led) if sticks else (now - led) * sense
    side = ON if lead > 0.0 else BACK
    held, gone, band = state[row, side], abs(lead), J if lead > 0.0 else S
    chance, above = _slips_now(held, state[row, side + ABOVE], gone, band, spread)
    if not chance > RARE:
        state[row, side], state[row, side + ABOVE] = max(held, gone), above
        return False
    one = other if chance < 1.0 - RARE else row
    for column in range(STATE):
        state[one, column] = state[row, column]
    price = -2.0 * math.log(min(chance, 1.0))
    state[one, COST] += price
    state[one, PRICE] += price
    # What the band goes beyond S - J by, whichever way it was gone through.
    beyond = S - J if side == BACK else 0.0
    state[one, SLIPPED], state[one, HELD], state[one, GONE] = 1.0, held - beyond, gone - beyond
    state[one, LED] = now
    _rest(state, one)
    if not sticks:
        state[one, MOVING], state[one, SENSE] = 1.0, sense if lead > 0.0 else -sense
    if one == row:
        return False
    price = -2.0 * math.log(1.0 - chance)
    state[row, COST] += price
    state[row, PRICE] += price
    state[row, side], state[row, side + ABOVE] = gone, above
    return True


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
    # A row each: how a stem stands, what it had in its last samples, sample k in column k modulo their number, and the
    # sample where it slipped last, before the record one of its own. `kept` are those that are followed, the likeliest
    # first, `free` the rows without one.
    rows = 2 * room
    state, slipped = np.empty((rows, STATE)), np.arange(rows)
    stems, left = np.empty((rows, depth)), np.empty((rows, order))
    kept, ranked, free = np.arange(rows), np.empty(rows, np.int64), np.arange(rows)[::-1].copy()
    # Where among those before each comes from, and how many that are kept slipped last at a sample.
    came, source, taken = np.empty(rows, np.int64), np.empty(rows, np.int64), np.zeros(rows + n, np.int64)
    # By sample: which one each came from, times four, with two for a slip and one for a sense upwards; the stem; the
    # bands of a slip.
    parents, told, bands = np.empty((n, room), np.int32), np.empty((n, room)), np.empty((n, room, 2))
    alive = len(starts)
    frees = rows - alive
    for h in range(alive):
        for column in range(STATE):
            state[h, column] = 0.0
        state[h, SENSE], state[h, LED] = starts[h, 1], starts[h, 0] + 0.5 * starts[h, 1] * gap
        state[h, ANSWER] = begun
        _rest(state, h)
        for i in range(depth):
            stems[h, i] = starts[h, 0]
    for k in range(n):
        newest, place = k % order, k % depth
        best = math.inf
        for h in range(alive):
            row = kept[h]
            error = y[k] - bias - ramp * k - state[row, ANSWER]
            left[row, newest] = error
            at = newest
            for i in range(1, min(order, k + 1)):
                at = at - 1 if at > 0 else order - 1
                error += a[i] * left[row, at]
            if k >= skip:
                state[row, COST] += error * error / variance
            best = min(best, state[row, COST])
        count = 0
        for h in range(alive):
            row = kept[h]
            if state[row, COST] > best + BEHIND:
                free[frees] = row
                frees += 1
                continue
            came[row], source[row] = h, row
            other = free[frees - 1]
            both = _branch(state, row, other, u[k], u[max(k - 1, 0)], sticks, valve)
            if both:
                frees -= 1
                came[other], source[other], slipped[other] = h, row, rows + k
            elif state[row, SLIPPED] > 0.0:
                slipped[row] = rows + k
            # They are few, and mostly in order.
            for new in range(1 + both):
                one, j = other if new > 0 else row, count
                while j > 0 and state[ranked[j - 1], COST] > state[one, COST]:
                    ranked[j] = ranked[j - 1]
                    j -= 1
                ranked[j] = one
                count += 1
        alive = 0
        for i in range(count):
            one = ranked[i]
            if alive == BEAM or taken[slipped[one]] == SAME:
                free[frees] = one
                frees += 1
                continue
            taken[slipped[one]] += 1
            kept[alive] = one
            alive += 1
            if source[one] != one:
                for j in range(depth):
                    stems[one, j] = stems[source[one], j]
                for j in range(order):
                    left[one, j] = left[source[one], j]
        near, far = (k - m) % depth, (k - m - 1) % depth
        for h in range(alive):
            row = kept[h]
            taken[slipped[row]] = 0
            stem = state[row, LED] - 0.5 * state[row, SENSE] * gap
            told[k, h], stems[row, place] = stem, stem
            state[row, ANSWER] = pole * state[row, ANSWER] + gain * (c0 * stems[row, near] + c1 * stems[row, far])
            parents[k, h] = 4 * came[row] + (1 if state[row, SENSE] > 0.0 else 0)
            if state[row, SLIPPED] > 0.0:
                parents[k, h] += 2
                bands[k, h, 0], bands[k, h, 1] = state[row, HELD], state[row, GONE]
    # The first is the likeliest.
    h, count = 0, 0
    for k in range(n - 1, -1, -1):
        parent = parents[k, h]
        x[k], senses[k] = told[k, h], 1.0 if parent % 2 > 0 else -1.0
        if parent % 4 > 1:
            slips[count, 0], slips[count, 1], slips[count, 2] = k, bands[k, h, 0], bands[k, h, 1]
            count += 1
        h = parent // 4
    return state[kept[0], PRICE], count
