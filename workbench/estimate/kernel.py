"""The estimation's inner loops as plain floats under numba: stem paths, one-step and output-error costs.

Time is counted in samples here, PV and OP are centred by the caller. The stem before its first visible slip (`first`)
is an unknown constant x0; from there on the path follows from OP and d alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.detect.kernel import screen_drive, sums_of
from workbench.simulate.compiled import compiled, copy

__all__ = [
    "band_path",
    "colour_level",
    "drive_of",
    "fit_bands",
    "fit_stems",
    "oe_columns",
    "oe_cost",
    "oe_fit",
    "plant_terms",
    "rest_range",
    "scan_bands",
    "scan_held",
    "scan_plants",
    "scan_starts",
    "screen_bands",
    "solve",
    "stem_path",
    "stem_slips",
    "walk",
    "walk_starts",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Plant = tuple[float, float, float, int]

# Columns of a row that `walk` writes.
D_LOW, D_HIGH, DELAY, COST, SLIPS = range(5)
ROW = 5
# Entries that `oe_fit` and `oe_cost` write.
SSE, TAU, THETA, GAIN, BIAS, START, TRANSIENT = range(7)
FIT = 7
# A step of d that takes more than this share of the slips is routed anew.
MANY = 0.05
# Entries that `band_path` writes.
S_LOW, S_HIGH, J_LOW, J_HIGH = range(4)
# Entries that `scan_held` writes for each band beside its cost: where it started, its slips, bias, start, transient.
HELD = 6
# Time constants after which nothing is left of a start in double precision.
DIED = 25.0
FADED = 1e-6  # of a transient, at the first sample that counts, from which it is left out


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
def _sift_down(keys: Floats, links: Ints, size: int, i: int) -> None:
    """Restore the order of a heap below place i: the least key on top, each with its link (slip, slip before)."""
    while True:
        child = 2 * i + 1
        if child >= size:
            return
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[i] <= keys[child]:
            return
        keys[i], keys[child] = keys[child], keys[i]
        links[i, 0], links[child, 0] = links[child, 0], links[i, 0]
        links[i, 1], links[child, 1] = links[child, 1], links[i, 1]
        i = child


@compiled
def _sift_up(keys: Floats, links: Ints, i: int) -> None:
    """Restore the order of a heap above place i."""
    while i > 0:
        parent = (i - 1) // 2
        if keys[parent] <= keys[i]:
            return
        keys[i], keys[parent] = keys[parent], keys[i]
        links[i, 0], links[parent, 0] = links[parent, 0], links[i, 0]
        links[i, 1], links[parent, 1] = links[parent, 1], links[i, 1]
        i = parent


@compiled
def _fill(op: Floats, first: int, after: Ints, keys: Floats, links: Ints) -> int:
    """Fill the heap with a path's slips by their size; return their number."""
    size, k = 0, first
    while after[k] < op.size:
        keys[size] = abs(op[after[k]] - op[k])
        links[size, 0], links[size, 1] = after[k], k
        size += 1
        k = after[k]
    for i in range(size // 2 - 1, -1, -1):
        _sift_down(keys, links, size, i)
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
    keys = np.empty(last + 1)
    links = np.empty((last + 1, 2), np.int64)
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
            k, p = links[0, 0], links[0, 1]
            stale = after[k] < 0 or before[k] != p
            if not stale and keys[0] > d:
                break
            size -= 1
            keys[0], links[0, 0], links[0, 1] = keys[size], links[size, 0], links[size, 1]
            _sift_down(keys, links, size, 0)
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
                            more_keys = np.empty(2 * size)
                            more_links = np.empty((2 * size, 2), np.int64)
                            copy(keys, more_keys[:size])
                            for i in range(size):
                                more_links[i, 0], more_links[i, 1] = links[i, 0], links[i, 1]
                            keys, links = more_keys, more_links
                        keys[size] = abs(op[j] - x)
                        links[size, 0], links[size, 1] = j, origin
                        size += 1
                        _sift_up(keys, links, size - 1)
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
        g = pole * g
        if near >= first:
            s += c0 * x[near]
        else:
            g += c0
        if far >= first:
            s += c1 * x[far]
        else:
            g += c1
        r = r + 1.0 if integrating else r * pole


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
def drive_of(x: Floats, first: int, a: Floats, drive: Floats) -> None:
    """Write what drives the model along a stem path: 0 before `first`, the path from there on, filtered by a."""
    drive[:first] = 0.0
    copy(x[first:], drive[first:])
    for j in range(1, a.size):
        for k in range(first + j, x.size):
            drive[k] += a[j] * x[k - j]


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
def start_rests(a: Floats) -> Floats:
    """Return what is left of a start in the filter, rest[q] q samples after it ended: shape (p + 2,), the last is 0.

    rest[0] is what the filter makes of a constant; the sum of the others, by how many samples it delays a ramp.
    """
    rest = np.zeros(a.size + 1)
    for q in range(a.size - 1, -1, -1):
        rest[q] = rest[q + 1] + a[q]
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
    # Until the start has passed the dead time and the filter.
    passed = min(max(first + m + p + 2, skip), n)
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
    late_y, weighted_y, weight = 0.0, 0.0, 1.0 - grow
    pole2, pole3, pole4 = pole * pole, pole * pole * pole, pole * pole * pole * pole
    k, stop = passed, passed + count
    # Four samples at a time: the weight waits for itself but once.
    while k + 4 <= stop:
        ya, yb, yc, yd = y[k], y[k + 1], y[k + 2], y[k + 3]
        four = (ya + yb) + (yc + yd)
        late_y += four
        weighted_y += weight * ((ya + pole * yb) + (pole2 * yc + pole3 * yd)) + grow * (yb + 2.0 * yc + 3.0 * yd)
        weight = weight * pole4 + 4.0 * grow
        k += 4
    while k < stop:
        late_y += y[k]
        weighted_y += weight * y[k]
        weight = weight * pole + grow
        k += 1
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
def fading(pole: float) -> int:
    """Return the samples in which a lag forgets its start, in double precision."""
    return int(1.0 + (DIED / -math.log(pole) if pole > 0.0 else 0.0))


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
    out: Floats,
) -> None:
    """Write the products of the response to a stem with itself, with y and with what `start_products` is about.

    whole: what the filter of order p makes of a constant. passed, window: as `start_products` gave them.
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
    count = n - passed
    if not integrating:
        count = min(count, fading(pole))
    grow = 1.0 if integrating else 0.0
    late_s, weighted_s, weight = 0.0, 0.0, 1.0 - grow
    # Four samples at a time: each needs s of the first alone, not of the one before it.
    pole2, pole3, pole4 = pole * pole, pole * pole * pole, pole * pole * pole * pole
    k, stop = passed, passed + count
    while k + 4 <= stop:
        d0, d1, d2 = drive[k - m - 1], drive[k - m], drive[k - m + 1]
        d3, d4 = drive[k - m + 2], drive[k - m + 3]
        u0, u1, u2, u3 = c0 * d1 + c1 * d0, c0 * d2 + c1 * d1, c0 * d3 + c1 * d2, c0 * d4 + c1 * d3
        sb = pole * s + u0
        sc = pole2 * s + (pole * u0 + u1)
        sd = pole3 * s + (pole2 * u0 + (pole * u1 + u2))
        four = (s + sb) + (sc + sd)
        late_s += four
        ss += (s * s + sb * sb) + (sc * sc + sd * sd)
        sy += (s * y[k] + sb * y[k + 1]) + (sc * y[k + 2] + sd * y[k + 3])
        weighted_s += weight * ((s + pole * sb) + (pole2 * sc + pole3 * sd)) + grow * (sb + 2.0 * sc + 3.0 * sd)
        weight = weight * pole4 + 4.0 * grow
        s = pole4 * s + (pole3 * u0 + (pole2 * u1 + (pole * u2 + u3)))
        k += 4
    while k < stop:
        late_s += s
        ss += s * s
        sy += s * y[k]
        weighted_s += weight * s
        s = pole * s + (c0 * drive[k - m] + c1 * drive[k - m - 1])
        weight = weight * pole + grow
        k += 1
    g, r = window[0, p + 2], window[1, p + 2]
    s1 += late_s
    if integrating:
        sg += g * late_s
        sr += r * late_s + whole * weighted_s
    else:
        sg += g * weighted_s
        sr += r * weighted_s
    sA, sB, ssA, ssB, syA, syB = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    while k + 4 <= n:
        d0, d1, d2 = drive[k - m - 1], drive[k - m], drive[k - m + 1]
        d3, d4 = drive[k - m + 2], drive[k - m + 3]
        u0, u1, u2, u3 = c0 * d1 + c1 * d0, c0 * d2 + c1 * d1, c0 * d3 + c1 * d2, c0 * d4 + c1 * d3
        sb = pole * s + u0
        sc = pole2 * s + (pole * u0 + u1)
        sd = pole3 * s + (pole2 * u0 + (pole * u1 + u2))
        sA += s + sb
        sB += sc + sd
        ssA += s * s + sb * sb
        ssB += sc * sc + sd * sd
        syA += s * y[k] + sb * y[k + 1]
        syB += sc * y[k + 2] + sd * y[k + 3]
        s = pole4 * s + (pole3 * u0 + (pole2 * u1 + (pole * u2 + u3)))
        k += 4
    while k < n:
        sA += s
        ssA += s * s
        syA += s * y[k]
        s = pole * s + (c0 * drive[k - m] + c1 * drive[k - m - 1])
        k += 1
    out[0, 1], out[1, 1] = whole * (s1 + sA + sB), ss + ssA + ssB
    out[1, 2], out[1, 3], out[4, 1] = sg, sr, sy + syA + syB


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
    room, window, rest = np.empty((2, 5, 4)), np.empty((2, a.size + 2)), start_rests(a)
    own = own_sums(y, skip)
    bounds = (low, high, sign)
    return _cost(y, own, drive, first, bounds, integrating, tau, theta, a, rest, skip, window, room, out)


@compiled
def _cost(
    y: Floats,
    own: tuple[float, float],
    drive: Floats,
    first: int,
    bounds: tuple[float, float, float],
    integrating: bool,
    tau: float,
    theta: float,
    a: Floats,
    rest: Floats,
    skip: int,
    window: Floats,
    room: Floats,
    out: Floats,
) -> float:
    """`oe_cost` with what many costs share: own, of `own_sums`; rest, of `start_rests`; and what they work in."""
    low, high, sign = bounds
    plant = plant_terms(integrating, tau, theta)
    passed = start_products(y, own[0], first, integrating, plant, a, rest, skip, window, room[0])
    stem_products(y, drive, first, integrating, plant, rest[0], a.size - 1, skip, passed, window, room[0])
    return least(room, own[1], low, high, sign, tau, theta, out)


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
def oe_fit(
    y: Floats,
    drive: Floats,
    first: int,
    low: float,
    high: float,
    sign: float,
    integrating: bool,
    tau: float,
    theta: float,
    tau_limits: tuple[float, float],
    theta_limits: tuple[float, float],
    spread: float,
    evaluations: int,
    tolerance: float,
    a: Floats,
    skip: int,
    out: Floats,
) -> float:
    """Minimise `oe_cost` over (log tau, theta) by Nelder and Mead's simplex within limits; return the sum of squares.

    spread: the first simplex's size, in log tau and, times three, in samples of dead time. Ends after `evaluations`, or
    when the simplex's costs agree to `tolerance` relative. For an integrating plant tau is not used.
    """
    room, window, rest = np.empty((2, 5, 4)), np.empty((2, a.size + 2)), start_rests(a)
    own, bounds = own_sums(y, skip), (low, high, sign)
    points = np.empty((3, 2))
    costs = np.empty(3)
    trial = np.empty(2)
    centre = np.empty(2)
    chosen = np.empty(2)
    low_tau, high_tau = math.log(tau_limits[0]), math.log(tau_limits[1])
    points[0, 0] = min(max(math.log(tau), low_tau), high_tau)
    points[0, 1] = min(max(theta, theta_limits[0]), theta_limits[1])
    for i in range(1, 3):
        copy(points[0], points[i])
    points[1, 0] += spread if points[0, 0] + spread <= high_tau else -spread
    side = 3.0 * spread
    points[2, 1] += side if points[0, 1] + side <= theta_limits[1] else -side
    points[2, 1] = max(points[2, 1], theta_limits[0])
    for i in range(3):
        costs[i] = _cost(
            y,
            own,
            drive,
            first,
            bounds,
            integrating,
            math.exp(points[i, 0]),
            points[i, 1],
            a,
            rest,
            skip,
            window,
            room,
            out,
        )
    used = 3
    while used < evaluations:
        # Order: best, middle, worst.
        for i in range(2):
            for j in range(2 - i):
                if costs[j + 1] < costs[j]:
                    costs[j], costs[j + 1] = costs[j + 1], costs[j]
                    for c in range(2):
                        points[j, c], points[j + 1, c] = points[j + 1, c], points[j, c]
        size = abs(points[2, 0] - points[0, 0]) + abs(points[1, 0] - points[0, 0])
        size += abs(points[2, 1] - points[0, 1]) + abs(points[1, 1] - points[0, 1])
        if costs[2] - costs[0] <= tolerance * costs[0] or size < 1e-9:
            break
        # Reflect the worst point about the others' middle; go further where that is best, stay closer where it is not.
        for c in range(2):
            centre[c] = 0.5 * (points[0, c] + points[1, c])
        kept = math.inf
        for stage in range(2):
            if stage == 0:
                factor = -1.0
            elif kept < costs[0]:
                factor = -2.0
            elif kept < costs[1]:
                break
            else:
                factor = -0.5 if kept < costs[2] else 0.5
            for c in range(2):
                trial[c] = centre[c] + factor * (points[2, c] - centre[c])
            trial[0] = min(max(trial[0], low_tau), high_tau)
            trial[1] = min(max(trial[1], theta_limits[0]), theta_limits[1])
            value = _cost(
                y,
                own,
                drive,
                first,
                bounds,
                integrating,
                math.exp(trial[0]),
                trial[1],
                a,
                rest,
                skip,
                window,
                room,
                out,
            )
            used += 1
            if value < kept:
                kept = value
                chosen[0], chosen[1] = trial[0], trial[1]
        if kept < costs[1] or (kept < costs[2] and factor != -1.0):
            costs[2] = kept
            points[2, 0], points[2, 1] = chosen[0], chosen[1]
        else:
            for i in range(1, 3):
                for c in range(2):
                    points[i, c] = 0.5 * (points[i, c] + points[0, c])
                costs[i] = _cost(
                    y,
                    own,
                    drive,
                    first,
                    bounds,
                    integrating,
                    math.exp(points[i, 0]),
                    points[i, 1],
                    a,
                    rest,
                    skip,
                    window,
                    room,
                    out,
                )
                used += 1
    best = 0
    for i in range(1, 3):
        if costs[i] < costs[best]:
            best = i
    return _cost(
        y,
        own,
        drive,
        first,
        bounds,
        integrating,
        math.exp(points[best, 0]),
        points[best, 1],
        a,
        rest,
        skip,
        window,
        room,
        out,
    )


@compiled
def scan_plants(
    y: Floats, drive: Floats, sign: float, integrating: bool, plants: Floats, a: Floats, skip: int, costs: Floats
) -> None:
    """Write the costs (see `oe_cost`) of a drive from the first sample on at many plants, rows (tau, theta)."""
    room, window, rest, out = np.empty((2, 5, 4)), np.empty((2, a.size + 2)), start_rests(a), np.empty(FIT)
    own, bounds = own_sums(y, skip), (-math.inf, math.inf, sign)
    for i in range(plants.shape[0]):
        tau, theta = plants[i, 0], plants[i, 1]
        costs[i] = _cost(y, own, drive, 0, bounds, integrating, tau, theta, a, rest, skip, window, room, out)


@compiled
def fit_stems(
    y: Floats,
    op: Floats,
    paths: Floats,
    slack: float,
    sign: float,
    integrating: bool,
    tau: float,
    tau_limits: tuple[float, float],
    theta_limits: tuple[float, float],
    evaluations: int,
    tolerance: float,
    a: Floats,
    skip: int,
    fits: Floats,
    slips: Ints,
) -> None:
    """Fit the output-error model to many stem paths: rows (first, d_low, d_high, theta), theta where the search starts.

    tau: where it starts, nan for the best of ten from .3 samples to a quarter of its upper limit. evaluations: as in
    `oe_fit`, 0 for the cost at the start itself. Written: fits, shape (paths, FIT), and slips, shape (paths,).
    """
    x, drive = np.empty(op.size), np.empty(op.size)
    low_tau, high_tau = max(tau_limits[0], 0.3), tau_limits[1] / 4.0
    for i in range(paths.shape[0]):
        first, d_low, d_high = int(paths[i, 0]), paths[i, 1], paths[i, 2]
        theta = min(max(paths[i, 3], theta_limits[0]), theta_limits[1])
        slips[i] = stem_path(op, d_low, first, x)
        drive_of(x, first, a, drive)
        low, high = rest_range(op, first, d_low, d_high, slack)
        out = fits[i]
        start = tau
        if integrating:
            start = 1.0
        elif math.isnan(tau):
            least = math.inf
            for j in range(10):
                trial = low_tau * (high_tau / low_tau) ** (j / 9.0)
                cost = oe_cost(y, drive, first, low, high, sign, False, trial, theta, a, skip, out)
                if cost < least:
                    least, start = cost, trial
        if evaluations == 0:
            oe_cost(y, drive, first, low, high, sign, integrating, start, theta, a, skip, out)
        else:
            oe_fit(
                y,
                drive,
                first,
                low,
                high,
                sign,
                integrating,
                start,
                theta,
                tau_limits,
                theta_limits,
                0.15,
                evaluations,
                tolerance,
                a,
                skip,
                out,
            )


@compiled
def band_path(op: Floats, S: float, J: float, first: int, sense: float, x: Floats, box: Floats) -> int:
    """Write the path of a two-parameter (Choudhury) stem; return the number of times it slips.

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
    for k in range(first + 1, n):
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
    box[S_LOW], box[S_HIGH], box[J_LOW], box[J_HIGH] = back_held, back, on_held, further
    return slips


@compiled
def fit_bands(
    y: Floats,
    op: Floats,
    bands: Floats,
    first: int,
    sense: float,
    sign: float,
    integrating: bool,
    tau: float,
    theta: float,
    tau_limits: tuple[float, float],
    theta_limits: tuple[float, float],
    evaluations: int,
    tolerance: float,
    a: Floats,
    skip: int,
    fits: Floats,
    slips: Ints,
) -> None:
    """Fit the output-error model to many two-parameter stems, rows (S, J), with one start, from one plant.

    first, sense: as in `band_path`; tau, theta and the rest: as in `oe_fit`. Written: fits, shape (bands, FIT), and
    slips, shape (bands,).
    """
    x, drive, box = np.empty(op.size), np.empty(op.size), np.empty(4)
    inf = math.inf
    for i in range(bands.shape[0]):
        slips[i] = band_path(op, bands[i, 0], bands[i, 1], first, sense, x, box)
        drive_of(x, max(first, 0), a, drive)
        oe_fit(
            y,
            drive,
            max(first, 0),
            -inf,
            inf,
            sign,
            integrating,
            tau,
            theta,
            tau_limits,
            theta_limits,
            0.15,
            evaluations,
            tolerance,
            a,
            skip,
            fits[i],
        )


@compiled
def scan_bands(
    y: Floats,
    op: Floats,
    first: int,
    sense: float,
    bands: Floats,
    sign: float,
    integrating: bool,
    plants: Floats,
    a: Floats,
    skip: int,
    costs: Floats,
) -> None:
    """Fit the model at each of some plants to many stems with one start (see `band_path`; y, a: as in `oe_cost`).

    bands: rows (S, J); plants: rows (tau, theta) in samples. Written: costs, shape (bands, plants), inf where the stem
    never moves.
    """
    x, drive = np.empty(op.size), np.empty(op.size)
    box = np.empty(4)
    out = np.empty(FIT)
    for i in range(bands.shape[0]):
        if band_path(op, bands[i, 0], bands[i, 1], first, sense, x, box) == 0:
            costs[i] = math.inf
            continue
        drive_of(x, max(first, 0), a, drive)
        for j in range(plants.shape[0]):
            tau, theta = plants[j, 0], plants[j, 1]
            cost = oe_cost(y, drive, max(first, 0), -math.inf, math.inf, sign, integrating, tau, theta, a, skip, out)
            costs[i, j] = cost if out[GAIN] != 0.0 else math.inf


@compiled
def scan_starts(
    y: Floats,
    op: Floats,
    S: float,
    J: float,
    starts: Floats,
    sign: float,
    integrating: bool,
    tau: float,
    theta: float,
    a: Floats,
    skip: int,
    costs: Floats,
) -> None:
    """Fit the model at one plant to a stem (S, J) from many starts, rows (first, sense): see `band_path`, `oe_cost`.

    Written: costs, inf where the stem never moves.
    """
    x, drive = np.empty(op.size), np.empty(op.size)
    box = np.empty(4)
    out = np.empty(FIT)
    for i in range(starts.shape[0]):
        first = int(starts[i, 0])
        if band_path(op, S, J, first, starts[i, 1], x, box) == 0:
            costs[i] = math.inf
            continue
        drive_of(x, max(first, 0), a, drive)
        cost = oe_cost(y, drive, max(first, 0), -math.inf, math.inf, sign, integrating, tau, theta, a, skip, out)
        costs[i] = cost if out[GAIN] != 0.0 else math.inf


@compiled
def screen_bands(
    y: Floats,
    op: Floats,
    bands: Floats,
    poles: Floats,
    delays: Ints,
    sign: float,
    a: Floats,
    skip: int,
    found: Floats,
) -> None:
    """Write for each (S, J) the best of a grid of plants, found[i, start] = (COST, pole, delay), for four starts.

    bands: rows (S, J); y, a: as in `oe_cost`; delays: whole samples. COST: n times the mean square that is left, inf
    where the stem never moves. Starts: either end of the band, its middle, and any: from where the paths from both ends
    have met the stem is known; what was before is a constant and a transient with the plant's pole, and does not count.
    Where they meet after half the record, that is no start. An integrating plant is a pole just below 1.
    """
    n, p = y.size, a.size - 1
    paths, w, z = np.empty((4, n)), np.empty(n), np.empty((4, n))
    box = np.empty(4)
    sum_y, sum_yy, fading_y, faded = sums_of(y, poles, delays, skip)
    sums, best = np.zeros((3, 4, n + 1)), np.empty(3)
    found[:, :, 0] = math.inf
    found[:, :, 1:] = 0.0
    for i in range(bands.shape[0]):
        S, J = bands[i, 0], bands[i, 1]
        band_path(op, S, J, 0, 1.0, paths[0], box)
        band_path(op, S, J, 0, -1.0, paths[1], box)
        moves = band_path(op, S, J, -1, 0.0, paths[2], box) > 0
        met = n
        while met > 0 and paths[0, met - 1] == paths[1, met - 1]:
            met -= 1
        for way in range(4):
            start = 3 - way
            if (start == 2 and not moves) or (start == 3 and 2 * met > n):
                continue
            # A start that is known asks for nearly the plant of one that is not.
            near_pole, near_delay = int(found[i, 3, 1]), int(found[i, 3, 2])
            low, high, soonest, latest = 0, poles.size, 0, delays.size
            if found[i, 3, 0] < math.inf:
                low, high = max(near_pole - 1, 0), min(near_pole + 2, poles.size)
                soonest, latest = max(near_delay - 2, 0), min(near_delay + 3, delays.size)
            known = 0
            if start == 3:
                known = met + p
                copy(paths[0, met:], paths[3, met:])
                paths[3, :met] = paths[0, met]
            x = paths[start]
            for k in range(n):
                total = x[k] - x[0]
                for j in range(1, min(p, k) + 1):
                    total += a[j] * (x[k - j] - x[0])
                w[k] = total
            best[:] = math.inf, 0.0, 0.0
            within = (low, high, soonest, latest)
            screen_drive(
                w, y, poles, delays, within, sign, skip, known, False, sum_y, sum_yy, fading_y, faded, z, sums, best
            )
            copy(best, found[i, start])


@compiled
def each_way_path(op: Floats, gap: float, up: float, down: float, first: int, sense: float, x: Floats) -> int:
    """Write the path of a stem that sticks differently upward and downward, 0 before its first slip; return its slips.

    gap nan: a Stenman stem, which slips to OP where OP leads by more than `up` above or `down` below. Else the stem of
    `band_path`, gap = S - J apart in its two directions, with the slip jumps J = up and down: having been led to w in
    sense s it moves on beyond J of s and turns beyond gap + J of the other sense.
    """
    x[:first] = 0.0
    slips = 1
    if math.isnan(gap):
        held = op[first]
        for k in range(first, op.size):
            lead = op[k] - held
            if lead > up or -lead > down:
                held = op[k]
                slips += 1
            x[k] = held
        return slips
    led = op[first]
    x[first] = led - sense * 0.5 * gap
    moving = True
    for k in range(first + 1, op.size):
        if moving and (op[k] - op[k - 1]) * sense > 0.0:
            led = op[k]
        else:
            moving = False
            on = (op[k] - led) * sense
            if on > (up if sense > 0.0 else down):
                moving = True
            elif -on > gap + (down if sense > 0.0 else up):
                sense = -sense
                moving = True
            if moving:
                led = op[k]
                slips += 1
        x[k] = led - sense * 0.5 * gap
    return slips


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
    the stem can have slipped at none of the starts; found, rows (first, sense, slips, bias, start, transient).
    """
    x, white = np.empty(op.size), np.ones(1)
    room, window, rest, terms = np.empty((2, 5, 4)), np.empty((2, 3)), start_rests(white), np.empty(3)
    total, power = own_sums(y, 0)
    plant = plant_terms(integrating, tau, theta)
    costs[:] = math.inf
    for j in range(starts.shape[0]):
        first, sense = int(starts[j, 0]), starts[j, 1]
        top, bottom = (op[:first].max(), op[:first].min()) if first > 0 else (0.0, 0.0)
        passed = start_products(y, total, first, integrating, plant, white, rest, 0, window, room[0])
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
            slips = each_way_path(op, gap, up, down, first, sense, x)
            stem_products(y, x, first, integrating, plant, 1.0, 0, 0, passed, window, room[0])
            cost = held_least(room, power, low, high, gain, terms)
            if cost < costs[i]:
                costs[i] = cost
                found[i, 0], found[i, 1], found[i, 2] = first, sense, slips
                found[i, 3], found[i, 4], found[i, 5] = terms[0], terms[1], terms[2]


@compiled
def colour_level(products: Floats, size: int, gain: float, lags: int, room: Floats) -> float:
    """Return the sum of squares that an autoregression leaves of PV less the stem's response times a gain.

    products, (2 size + h, 2 size + h): of PV at lags 0 to size - 1, of the response of gain 1 at the same, and of h
    signals that no stem changes, with each other. lags: the autoregression's order, below size. Written into the last
    row of room, (lags + h + 1, lags + h): its coefficients, then those of the h signals.
    """
    held = products.shape[0] - 2 * size
    for i in range(lags + 1):
        for j in range(max(i, 1), lags + 1):
            value = products[i, j] - gain * (products[i, size + j] + products[j, size + i])
            value += gain * gain * products[size + i, size + j]
            if i == 0:
                room[lags + held, j - 1] = value
            else:
                room[i - 1, j - 1] = value
        for j in range(held):
            value = products[i, 2 * size + j] - gain * products[size + i, 2 * size + j]
            if i == 0:
                room[lags + held, lags + j] = value
            else:
                room[i - 1, lags + j] = value
    for i in range(held):
        for j in range(i, held):
            room[lags + i, lags + j] = products[2 * size + i, 2 * size + j]
    whole = products[0, 0] - 2.0 * gain * products[0, size] + gain * gain * products[size, size]
    left: float = max(whole - solve(room, lags + held), 0.0)
    return left
