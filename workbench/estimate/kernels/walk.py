"""All stem paths of a record, walked in order of the band d, with a one-step fit of the plant to each.

The compiler makes vector instructions of the loops over dead times: `LANES` of them stand in one block, at constant
distances, and what PV's prefix sums are at each dead time stands side by side too (`at_delays`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.path import stem_slips
from workbench.simulate.compiled import compiled

__all__ = ["COST", "DELAY", "D_HIGH", "D_LOW", "ROW", "SLIPS", "AtDelays", "at_delays", "walk", "walk_starts"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Columns of a row that `walk` writes.
D_LOW, D_HIGH, DELAY, COST, SLIPS = range(5)
ROW = 5
LANES = 16  # dead times in a block
# A block's sums of x, x^2, x y and x y_+1, and what the fit leaves;
(_X, _XX, _XY, _XZ, _LEFT) = (np.uint64(i * LANES) for i in range(5))
BLOCK = 5 * LANES
# and what PV alone gives it: rows after the first slip, their sums of y and y_+1, and yy, zz, yz (see `_grouped`).
(_N2, _SY, _SZ, _YY, _ZZ, _YZ) = (np.uint64(i * LANES) for i in range(6))
GROUP = 6 * LANES
# A link of the heap is one number, to be moved at once: the slip, and below it the slip before.
HALF = 32
BEFORE = (1 << HALF) - 1
# A step of d that takes more than this share of the slips is routed anew.
MANY = 0.05


class AtDelays(NamedTuple):
    """A record's prefix sums as a stem's effect meets them at each of some dead times (see `at_delays`).

    delays: whole samples, ascending. counts, ys, zs: samples, and the sums of y and y_+1 over them, before sample k
    moved by the dead times, at [k * stride : k * stride + delays.size], and the last of the record after its end.
    """

    delays: Ints
    counts: Floats
    ys: Floats
    zs: Floats
    stride: int


def at_delays(sums: Floats, delays: Ints) -> AtDelays:
    """Return prefix sums of PV, shape (N + 1,), at some dead times, whole samples, ascending."""
    n = sums.size - 2
    filled = np.concatenate([delays, delays[-1] + np.arange(1, -delays.size % LANES + 1)])
    times = np.minimum(np.arange(n + 2 + filled[-1]), n)
    if filled[-1] - filled[0] == filled.size - 1:
        at, stride = times[filled[0] :], 1
    else:
        at, stride = times[np.arange(n + 2)[:, None] + filled].ravel(), filled.size
    return AtDelays(delays, at.astype(np.float64), sums[at], sums[at + 1], stride)


@compiled
def _sink(keys: Floats, links: Ints, size: int, i: int, key: float, link: int) -> None:
    """Put a link in at place i of a heap, the least key on top, or below it, where what is there is smaller."""
    child = 2 * i + 1
    while child < size:
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if key <= keys[child]:
            break
        keys[i], links[i] = keys[child], links[child]
        i, child = child, 2 * child + 1
    keys[i], links[i] = key, link


@compiled
def _rise(keys: Floats, links: Ints, i: int, key: float, link: int) -> None:
    """Put a link in at place i of a heap, its last, or above it, where what is there is larger."""
    while i > 0:
        parent = (i - 1) // 2
        if keys[parent] <= key:
            break
        keys[i], links[i] = keys[parent], links[parent]
        i = parent
    keys[i], links[i] = key, link


@compiled
def _fill(op: Floats, first: int, after: Ints, keys: Floats, links: Ints) -> int:
    """Fill the heap with a path's slips by their size; return their number."""
    size, k = 0, first
    while after[k] < op.size:
        keys[size], links[size] = abs(op[after[k]] - op[k]), after[k] << HALF | k
        size += 1
        k = after[k]
    for i in range(size // 2 - 1, -1, -1):
        _sink(keys, links, size, i, keys[i], links[i])
    return size


@compiled
def _refill(op: Floats, first: int, after: Ints, before: Ints, keys: Floats, links: Ints) -> int:
    """Fill the heap anew, amid a change of the path, without the links that are no more; return their number."""
    size = 0
    for k in range(first + 1, op.size):
        if after[k] >= 0:
            _rise(keys, links, size, abs(op[k] - op[before[k]]), k << HALF | before[k])
            size += 1
    return size


@compiled
def _route(sums: AtDelays, op: Floats, d: float, first: int, after: Ints, before: Ints, totals: Floats) -> int:
    """Write the path of d as a linked list with its sums; return the number of slips."""
    at = np.empty(op.size, np.int64)
    slips, _ = stem_slips(op, d, first, at)
    after[:] = -1
    totals[:] = 0.0
    for i in range(slips):
        end = op.size if i == slips - 1 else at[i + 1]
        after[at[i]] = end
        before[end] = at[i]
        _hold(totals, sums, op[at[i]], at[i], end, 1.0)
    return slips


@compiled
def _hold(totals: Floats, sums: AtDelays, x: float, begin: int, end: int, weight: float) -> None:
    """Add, `weight` times, what a stem at x during [begin, end) adds to each delay's sums of x, x^2, x y and x y_+1."""
    counts, ys, zs = sums.counts, sums.ys, sums.zs
    level = weight * x
    for block in range(totals.size // BLOCK):
        # Unsigned, as the compiler must know that no index counts from the end.
        to = np.uint64(block * BLOCK)
        low, high = np.uint64(begin * sums.stride + block * LANES), np.uint64(end * sums.stride + block * LANES)
        for i in range(LANES):
            j = np.uint64(i)
            share = level * (counts[high + j] - counts[low + j])
            totals[to + _X + j] += share
            totals[to + _XX + j] += x * share
            totals[to + _XY + j] += level * (ys[high + j] - ys[low + j])
            totals[to + _XZ + j] += level * (zs[high + j] - zs[low + j])


@compiled
def _grouped(sums: Floats, squares: Floats, products: Floats, first: int, delays: Ints, groups: Floats) -> None:
    """Write what PV alone gives each delay: rows after the first slip n2, their sums of y and y_+1, and yy, zz, yz.

    The last three are within two groups, rows before the first slip has an effect and rows after it. Of no use are
    delays that leave fewer than three rows, and what fills up the last block: n2 is 0.
    """
    n = sums.size - 2
    groups[:] = 0.0
    for j in range(delays.size):
        n1 = min(first + delays[j], n + 1)
        n2 = n - n1
        if n2 < 3:
            continue
        to = np.uint64(j // LANES * GROUP + j % LANES)
        sy, sz = sums[n] - sums[n1], sums[n + 1] - sums[n1 + 1]
        groups[to + _N2], groups[to + _SY], groups[to + _SZ] = n2, sy, sz
        groups[to + _YY] = squares[n] - sy**2 / n2
        groups[to + _ZZ] = squares[n + 1] - squares[1] - sz**2 / n2
        groups[to + _YZ] = products[n] - sy * sz / n2
        if n1 > 0:
            groups[to + _YY] -= sums[n1] ** 2 / n1
            groups[to + _ZZ] -= (sums[n1 + 1] - sums[1]) ** 2 / n1
            groups[to + _YZ] -= sums[n1] * (sums[n1 + 1] - sums[1]) / n1


@compiled
def _one_step(totals: Floats, groups: Floats, pole: float, sign: float) -> None:
    """Write the sum of squares that the one-step fit leaves at each delay; inf where there is none."""
    free = math.isnan(pole)
    for block in range(totals.size // BLOCK):
        to, own = np.uint64(block * BLOCK), np.uint64(block * GROUP)
        for i in range(LANES):
            j = np.uint64(i)
            n2, yy, zz, yz = groups[own + _N2 + j], groups[own + _YY + j], groups[own + _ZZ + j], groups[own + _YZ + j]
            x = totals[to + _X + j]
            xx = totals[to + _XX + j] - x * x / n2
            xy = totals[to + _XY + j] - x * groups[own + _SY + j] / n2
            xz = totals[to + _XZ + j] - x * groups[own + _SZ + j] / n2
            det = yy * xx - xy * xy
            a = (yz * xx - xz * xy) / det
            a = a if det > 1e-14 * yy * xx else 0.0
            a = 0.0 if a < 0.0 else a
            a = 0.9999 if a > 0.9999 else a
            a = a if free else pole
            b = (xz - a * xy) / xx
            cost = zz - 2.0 * a * yz + a * a * yy - b * (xz - a * xy)
            cost = cost if n2 > 0.0 else math.inf
            cost = cost if xx > 1e-12 * n2 else math.inf
            totals[to + _LEFT + j] = math.inf if b * sign < 0.0 else cost


@compiled
def _best(totals: Floats, groups: Floats, delays: Ints, pole: float, sign: float) -> tuple[float, int]:
    """Return the least that the one-step fit leaves, inf where there is none, and its delay."""
    _one_step(totals, groups, pole, sign)
    best, delay = math.inf, 0
    for j in range(delays.size):
        left = totals[np.uint64(j // LANES * BLOCK + j % LANES) + _LEFT]
        if left < best:
            best, delay = left, delays[j]
    return best, delay


@compiled
def walk(
    sums: Floats,
    squares: Floats,
    products: Floats,
    op: Floats,
    first: int,
    d_from: float,
    d_to: float,
    step: float,
    shifted: AtDelays,
    fixed_pole: float,
    sign: float,
    rows: Floats,
) -> int:
    """Walk every stem path that starts at `first`, for d from d_from up to d_to, and fit the plant to each.

    One-step-ahead least squares `y_{k+1} = a y_k + b x_{k-m} + c` for each delay m that PV's sums are shifted by, with
    another constant while x_{k-m} is the unknown stem before `first`. a is kept within [0, 0.9999], or at `fixed_pole`
    where that is not nan; b keeps the sign `sign` (0: either). sums, squares, products: prefix sums of y_k, y_k^2,
    y_k y_{k+1}. `step`: least relative step of d, 0 to meet every path. Written: rows (D_LOW, D_HIGH, DELAY, COST,
    SLIPS), COST the sum of squares at the best delay; the last path is the one of a single slip. Returns the number of
    rows.

    Slips stand in a linked list and, by size, in a heap. As d passes a slip's size, the stem is re-routed from the slip
    before it until it meets an old slip again; the sums change by the altered stretches alone.
    """
    last = op.size
    after = np.empty(last, np.int64)  # the next slip, `last` for none; -1 for a sample that is no slip
    before = np.empty(last + 1, np.int64)
    blocks = (shifted.delays.size + LANES - 1) // LANES
    totals, groups = np.empty(blocks * BLOCK), np.empty(blocks * GROUP)
    _grouped(sums, squares, products, first, shifted.delays, groups)
    keys, links = np.empty(2 * last + 2), np.empty(2 * last + 2, np.int64)
    d = d_from
    slips = _route(shifted, op, d, first, after, before, totals)
    size = _fill(op, first, after, keys, links)
    count = 0
    while d < d_to and count < rows.shape[0]:
        if step > 0.0:
            small = 0
            for i in range(size):
                small += keys[i] <= d
            if small > MANY * slips:
                slips = _route(shifted, op, d, first, after, before, totals)
                size = _fill(op, first, after, keys, links)
        # A link that is larger than d holds, however the others came about: so all smaller ones go, in any order.
        while size > 0:
            k, p = links[0] >> HALF, links[0] & BEFORE
            stale = after[k] < 0 or before[k] != p
            if not stale and keys[0] > d:
                break
            size -= 1
            _sink(keys, links, size, 0, keys[size], links[size])
            if stale:
                continue
            _hold(totals, shifted, op[p], p, k, -1.0)
            j, origin, x = k, p, op[p]
            while True:
                if j == last or abs(op[j] - x) > d:
                    met = j == last or after[j] >= 0
                    _hold(totals, shifted, x, origin, j, 1.0)
                    after[origin] = j
                    before[j] = origin
                    if j < last:
                        if size == keys.size:
                            size = _refill(op, first, after, before, keys, links)
                        _rise(keys, links, size, abs(op[j] - x), j << HALF | origin)
                        size += 1
                    if met:
                        break
                    slips += 1
                    origin, x = j, op[j]
                elif after[j] >= 0:
                    # An old slip that no longer happens.
                    _hold(totals, shifted, op[j], j, after[j], -1.0)
                    after[j] = -1
                    slips -= 1
                j += 1
        best, best_delay = _best(totals, groups, shifted.delays, fixed_pole, sign)
        smallest = keys[0] if size > 0 else math.inf
        if best < math.inf:
            rows[count, D_LOW] = d
            rows[count, D_HIGH] = min(smallest, d_to)
            rows[count, DELAY] = best_delay
            rows[count, COST] = max(best, 0.0)
            rows[count, SLIPS] = slips
            count += 1
        if slips == 1:
            break
        d = max(smallest, d * (1.0 + step))
    return count


@compiled
def _add_path(totals: Floats, sums: AtDelays, op: Floats, at: Ints, slips: int) -> None:
    """Write the sums that `_hold` gives for all of a path, from its slips: one product of a move for each delay.

    `sum x_i (Y_end - Y_begin)` is that of the moves `(x_{i-1} - x_i) Y_begin`, Y the prefix sums of PV.
    """
    delays, ys, zs = sums.delays, sums.ys, sums.zs
    last = op.size
    n = last - 1
    inside = slips  # slips whose effect begins within the record at every delay
    while inside > 0 and at[inside - 1] + delays[delays.size - 1] > n:
        inside -= 1
    totals[:] = 0.0
    held, power, x = 0.0, 0.0, 0.0
    for i in range(inside):
        new = op[at[i]]
        move = x - new
        length = float((at[i + 1] if i + 1 < slips else last) - at[i])
        held += length * new
        power += length * new * new
        x = new
        _add_products(totals, ys, zs, at[i] * sums.stride, move)
    end = at[inside] if inside < slips else last
    _add_products(totals, ys, zs, end * sums.stride, x)
    for j in range(delays.size):
        # What the dead time moves out of the record, back from the last of these slips.
        to = np.uint64(j // LANES * BLOCK + j % LANES)
        totals[to + _X], totals[to + _XX] = held, power
        out, i = end + delays[j] - n, inside - 1
        while out > 0 and i >= 0:
            share = min(out, (at[i + 1] if i + 1 < slips else last) - at[i])
            totals[to + _X] -= share * op[at[i]]
            totals[to + _XX] -= share * op[at[i]] * op[at[i]]
            out, i = out - share, i - 1
    for i in range(inside, slips):
        _hold(totals, sums, op[at[i]], at[i], last if i == slips - 1 else at[i + 1], 1.0)


@compiled
def _add_products(totals: Floats, ys: Floats, zs: Floats, begin: int, x: float) -> None:
    """Add x times the prefix sums of y and y_+1 from a place in them on to each delay's."""
    for block in range(totals.size // BLOCK):
        to, at = np.uint64(block * BLOCK), np.uint64(begin + block * LANES)
        for i in range(LANES):
            j = np.uint64(i)
            totals[to + _XY + j] += x * ys[at + j]
            totals[to + _XZ + j] += x * zs[at + j]


@compiled
def walk_starts(
    sums: Floats,
    squares: Floats,
    products: Floats,
    op: Floats,
    firsts: Ints,
    reaches: Floats,
    bands: Floats,
    shifted: AtDelays,
    fixed_pole: float,
    sign: float,
    rows: Floats,
) -> int:
    """Fit the plant, as `walk` does, to the paths of some bands d, each from many first slips.

    firsts: ascending, the first of them for every band; reaches: half of OP's range before each, which a band must hold
    to slip there first. Written: rows as by `walk`, and after them the first slip; D_LOW is the band itself. Returns
    their number. Paths that slip at one and the same sample are one from there on: what follows is summed once.
    """
    last = op.size
    at = np.empty(last, np.int64)
    which = np.full(last, -1)  # of the slips from the first start, the one at a sample
    least = np.empty(last + 1)  # the smallest of its slips from each on
    blocks = (shifted.delays.size + LANES - 1) // LANES
    groups = np.empty((firsts.size, blocks * GROUP))
    for i in range(firsts.size):
        _grouped(sums, squares, products, firsts[i], shifted.delays, groups[i])
    whole, totals = np.empty(blocks * BLOCK), np.empty(blocks * BLOCK)
    count = 0
    for b in range(bands.size):
        d = bands[b]
        slips, _ = stem_slips(op, d, firsts[0], at)
        _add_path(whole, shifted, op, at, slips)
        least[slips] = math.inf
        for i in range(slips - 1, -1, -1):
            least[i] = min(least[i + 1], abs(op[at[i]] - op[at[i - 1]])) if i > 0 else least[1]
            which[at[i]] = i
        for i in range(firsts.size):
            if reaches[i] > d or count == rows.shape[0]:
                break
            totals[:] = 0.0
            own, smallest = 0, math.inf
            k, origin, x = firsts[i], firsts[i], op[firsts[i]]
            while k < last and which[k] < 0:
                own += 1
                k += 1
                while k < last and abs(op[k] - x) <= d:
                    k += 1
                _hold(totals, shifted, x, origin, k, 1.0)
                if k < last:
                    smallest = min(smallest, abs(op[k] - x))
                    origin, x = k, op[k]
            if k < last:
                met = which[k]
                for j in range(met):
                    _hold(totals, shifted, op[at[j]], at[j], at[j + 1], -1.0)
                totals += whole
                smallest = min(smallest, least[met + 1])
                own += slips - met
            best, best_delay = _best(totals, groups[i], shifted.delays, fixed_pole, sign)
            if best < math.inf:
                rows[count, D_LOW], rows[count, D_HIGH] = d, smallest
                rows[count, DELAY], rows[count, COST] = best_delay, max(best, 0.0)
                rows[count, SLIPS], rows[count, ROW] = own, firsts[i]
                count += 1
        for i in range(slips):
            which[at[i]] = -1
    return count
