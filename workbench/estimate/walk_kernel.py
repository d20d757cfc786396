"""All stem paths of a record, walked in order of the band d, with a one-step fit of the plant to each."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.path_kernel import stem_slips
from workbench.simulate.compiled import compiled

__all__ = ["COST", "DELAY", "D_HIGH", "D_LOW", "ROW", "SLIPS", "walk", "walk_starts"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Columns of a row that `walk` writes.
D_LOW, D_HIGH, DELAY, COST, SLIPS = range(5)
ROW = 5
# A link of the heap is one number, to be moved at once: the slip, and below it the slip before.
HALF = 32
BEFORE = (1 << HALF) - 1
# A step of d that takes more than this share of the slips is routed anew.
MANY = 0.05


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
def _route(
    sums: Floats, op: Floats, d: float, first: int, delays: Ints, after: Ints, before: Ints, totals: Floats
) -> int:
    """Write the path of d as a linked list with its sums; return the number of slips."""
    at = np.empty(op.size, np.int64)
    slips, _ = stem_slips(op, d, first, at)
    after[:] = -1
    totals[:] = 0.0
    for i in range(slips):
        end = op.size if i == slips - 1 else at[i + 1]
        after[at[i]] = end
        before[end] = at[i]
        _hold(totals, sums, delays, op[at[i]], at[i], end, 1.0)
    return slips


@compiled
def _hold(totals: Floats, sums: Floats, delays: Ints, x: float, begin: int, end: int, weight: float) -> None:
    """Add, `weight` times, what a stem at x during [begin, end) adds to each delay's sums of x, x^2, x y and x y_+1."""
    n = sums.size - 2
    for j in range(delays.size):
        start, stop = min(begin + delays[j], n), min(end + delays[j], n)
        if start >= stop:
            break
        share = weight * x * (stop - start)
        totals[j, 0] += share
        totals[j, 1] += x * share
        totals[j, 2] += weight * x * (sums[stop] - sums[start])
        totals[j, 3] += weight * x * (sums[stop + 1] - sums[start + 1])


@compiled
def _grouped(sums: Floats, squares: Floats, products: Floats, n1: int, out: Floats) -> None:
    """Write what PV alone gives a delay: rows after the first slip n2, their sums of y and y_+1, and yy, zz, yz.

    The last three are within two groups, rows before the first slip has an effect (n1 of them) and rows after it.
    """
    n = sums.size - 2
    n2 = n - n1
    out[0] = n2
    if n2 < 3:
        return
    out[1], out[2] = sums[n] - sums[n1], sums[n + 1] - sums[n1 + 1]
    out[3] = squares[n] - out[1] ** 2 / n2
    out[4] = squares[n + 1] - squares[1] - out[2] ** 2 / n2
    out[5] = products[n] - out[1] * out[2] / n2
    if n1 > 0:
        out[3] -= sums[n1] ** 2 / n1
        out[4] -= (sums[n1 + 1] - sums[1]) ** 2 / n1
        out[5] -= sums[n1] * (sums[n1 + 1] - sums[1]) / n1


@compiled
def _one_step(total: Floats, group: Floats, fixed_pole: float, sign: float) -> float:
    """Sum of squares of the one-step fit at one delay; inf where there is none."""
    n2, yy, zz, yz = group[0], group[3], group[4], group[5]
    if n2 < 3.0:
        return math.inf
    xx = total[1] - total[0] * total[0] / n2
    xy = total[2] - total[0] * group[1] / n2
    xz = total[3] - total[0] * group[2] / n2
    if xx <= 1e-12 * n2:
        return math.inf
    a = fixed_pole
    if math.isnan(a):
        det = yy * xx - xy * xy
        a = (yz * xx - xz * xy) / det if det > 1e-14 * yy * xx else 0.0
        a = min(max(a, 0.0), 0.9999)
    b = (xz - a * xy) / xx
    if b * sign < 0.0:
        return math.inf
    cost: float = zz - 2.0 * a * yz + a * a * yy - b * (xz - a * xy)
    return cost


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
    delays: Ints,
    fixed_pole: float,
    sign: float,
    rows: Floats,
) -> int:
    """Walk every stem path that starts at `first`, for d from d_from up to d_to, and fit the plant to each.

    One-step-ahead least squares `y_{k+1} = a y_k + b x_{k-m} + c` for each whole delay m (ascending), with another
    constant while x_{k-m} is the unknown stem before `first`. a is kept within [0, 0.9999], or at `fixed_pole` where
    that is not nan; b keeps the sign `sign` (0: either). sums, squares, products: prefix sums of y_k, y_k^2,
    y_k y_{k+1}. `step`: least relative step of d, 0 to meet every path. Written: rows (D_LOW, D_HIGH, DELAY, COST,
    SLIPS), COST the sum of squares at the best delay; the last path is the one of a single slip. Returns the number of
    rows.

    Slips stand in a linked list and, by size, in a heap. As d passes a slip's size, the stem is re-routed from the slip
    before it until it meets an old slip again; the sums change by the altered stretches alone.
    """
    last = op.size
    after = np.empty(last, np.int64)  # the next slip, `last` for none; -1 for a sample that is no slip
    before = np.empty(last + 1, np.int64)
    totals = np.empty((delays.size, 4))
    groups = np.zeros((delays.size, 6))
    for j in range(delays.size):
        _grouped(sums, squares, products, min(first + delays[j], last - 1), groups[j])
    keys, links = np.empty(2 * last + 2), np.empty(2 * last + 2, np.int64)
    d = d_from
    slips = _route(sums, op, d, first, delays, after, before, totals)
    size = _fill(op, first, after, keys, links)
    count = 0
    while d < d_to and count < rows.shape[0]:
        if step > 0.0:
            small = 0
            for i in range(size):
                small += keys[i] <= d
            if small > MANY * slips:
                slips = _route(sums, op, d, first, delays, after, before, totals)
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
            _hold(totals, sums, delays, op[p], p, k, -1.0)
            j, origin, x = k, p, op[p]
            while True:
                if j == last or abs(op[j] - x) > d:
                    met = j == last or after[j] >= 0
                    _hold(totals, sums, delays, x, origin, j, 1.0)
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
                    _hold(totals, sums, delays, op[j], j, after[j], -1.0)
                    after[j] = -1
                    slips -= 1
                j += 1
        best, best_delay = math.inf, 0
        for j in range(delays.size):
            cost = _one_step(totals[j], groups[j], fixed_pole, sign)
            if cost < best:
                best, best_delay = cost, delays[j]
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
def _add_path(totals: Floats, sums: Floats, op: Floats, at: Ints, slips: int, delays: Ints, products: Floats) -> None:
    """Write the sums that `_hold` gives for all of a path, from its slips: one product of a move for each delay.

    `sum x_i (Y_end - Y_begin)` is that of the moves `(x_{i-1} - x_i) Y_begin`, Y the prefix sums of PV. products:
    room for them, shape (2, delays).
    """
    last, n = op.size, sums.size - 2
    inside = slips  # slips whose effect begins within the record at every delay
    while inside > 0 and at[inside - 1] + delays[delays.size - 1] > n:
        inside -= 1
    products[:] = 0.0
    held, power, x = 0.0, 0.0, 0.0
    for i in range(inside):
        new = op[at[i]]
        move = x - new
        length = float((at[i + 1] if i + 1 < slips else last) - at[i])
        held += length * new
        power += length * new * new
        x = new
        for j in range(delays.size):
            products[0, j] += move * sums[at[i] + delays[j]]
            products[1, j] += move * sums[at[i] + delays[j] + 1]
    end = at[inside] if inside < slips else last
    for j in range(delays.size):
        stop = min(end + delays[j], n)
        totals[j, 2] = products[0, j] + x * sums[stop]
        totals[j, 3] = products[1, j] + x * sums[stop + 1]
        # What the dead time moves out of the record, back from the last of these slips.
        totals[j, 0], totals[j, 1] = held, power
        out, i = end + delays[j] - n, inside - 1
        while out > 0 and i >= 0:
            share = min(out, (at[i + 1] if i + 1 < slips else last) - at[i])
            totals[j, 0] -= share * op[at[i]]
            totals[j, 1] -= share * op[at[i]] * op[at[i]]
            out, i = out - share, i - 1
    for i in range(inside, slips):
        _hold(totals, sums, delays, op[at[i]], at[i], last if i == slips - 1 else at[i + 1], 1.0)


@compiled
def walk_starts(
    sums: Floats,
    squares: Floats,
    products: Floats,
    op: Floats,
    firsts: Ints,
    reaches: Floats,
    bands: Floats,
    delays: Ints,
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
    groups = np.zeros((firsts.size, delays.size, 6))
    for i in range(firsts.size):
        for j in range(delays.size):
            _grouped(sums, squares, products, min(firsts[i] + delays[j], last - 1), groups[i, j])
    whole, totals, room = np.empty((delays.size, 4)), np.empty((delays.size, 4)), np.empty((2, delays.size))
    count = 0
    for b in range(bands.size):
        d = bands[b]
        slips, _ = stem_slips(op, d, firsts[0], at)
        _add_path(whole, sums, op, at, slips, delays, room)
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
                _hold(totals, sums, delays, x, origin, k, 1.0)
                if k < last:
                    smallest = min(smallest, abs(op[k] - x))
                    origin, x = k, op[k]
            if k < last:
                met = which[k]
                for j in range(met):
                    _hold(totals, sums, delays, op[at[j]], at[j], at[j + 1], -1.0)
                totals += whole
                smallest = min(smallest, least[met + 1])
                own += slips - met
            best, best_delay = math.inf, 0
            for j in range(delays.size):
                cost = _one_step(totals[j], groups[i, j], fixed_pole, sign)
                if cost < best:
                    best, best_delay = cost, delays[j]
            if best < math.inf:
                rows[count, D_LOW], rows[count, D_HIGH] = d, smallest
                rows[count, DELAY], rows[count, COST] = best_delay, max(best, 0.0)
                rows[count, SLIPS], rows[count, ROW] = own, firsts[i]
                count += 1
        for i in range(slips):
            which[at[i]] = -1
    return count
