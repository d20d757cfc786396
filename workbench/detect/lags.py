"""First-order lags driven by many inputs side by side, and the least squares that fit them to PV.

LANES of them run at once. The compiler makes vector instructions of the loops over lanes. For that, each decision is a
choice between two values, and all numbers of the lanes are in flat arrays, the number of lane j at j and LANES further
on for each further sample.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.detect.whitening import NOUGHT
from workbench.simulate.compiled import compiled, copy, place

__all__ = ["ABREAST", "KINDS", "LANES", "fade", "gather", "one_tap", "two_taps"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LANES = 16
CHUNK = 64  # samples at a time, a multiple of 8: their rows stay in the fastest memory
# Where each number of the lanes begins, of a lag z: pole a and 1 - a; z now and in the sample before; sums of z, z^2, z
# with the sample before, and z with a transient; that transient; its own sum, that of its squares and with PV; a name
# for the lane; the best so far, its lane's name and dead time; and what PV's least squares leave without z: 1/the
# transient's power, its product with PV, both beside a constant, and the sum of squares.
P, G, Z, LAST, S, Q, R, F, W, SE, SEE, SYE = range(0, 12 * LANES, LANES)
ID, BEST, POLE_AT, DELAY_AT, SHARE, EY, LEFT = range(12 * LANES, 19 * LANES, LANES)
ABREAST = 19 * LANES
# Products of a lag that least squares asks for, see `gather`.
ONES, SQUARES, PAIRS, FADING, PV = range(5)
KINDS = 5
SAME = 1e-10  # share of a transient's power that is not the constant's: less is rounding
DRIVES = 1e-9  # share of a lag's power that is neither's: less is rounding


@compiled
def _lag_edge(w: Floats, count: int, st: Floats, z: Floats, edge: Floats) -> None:
    """Go on with the lags by `count` samples, or up to three more, and write the sums before each.

    w: their inputs; z: their answers, a row of LANES for each sample; edge: four such rows for each sample, and for the
    one after.
    """
    for k in range(0, count, 4):
        now, rows = w[k * LANES : (k + 4) * LANES], z[k * LANES : (k + 4) * LANES]
        kept = edge[4 * k * LANES : 4 * (k + 5) * LANES]
        for j in range(LANES):
            p, g, z0, last = st[P + j], st[G + j], st[Z + j], st[LAST + j]
            z1 = p * z0 + g * now[j]
            z2 = p * z1 + g * now[LANES + j]
            z3 = p * z2 + g * now[2 * LANES + j]
            st[Z + j] = p * z3 + g * now[3 * LANES + j]
            st[LAST + j] = z3
            rows[j], rows[LANES + j], rows[2 * LANES + j], rows[3 * LANES + j] = z0, z1, z2, z3
            w0 = st[W + j]
            w1 = w0 * p
            w2 = w1 * p
            w3 = w2 * p
            fade = w3 * p
            st[W + j] = fade if fade > NOUGHT else 0.0
            s, q, r, f = st[S + j], st[Q + j], st[R + j], st[F + j]
            kept[j], kept[LANES + j], kept[2 * LANES + j], kept[3 * LANES + j] = s, q, r, f
            s, q, r, f = s + z0, q + z0 * z0, r + z0 * last, f + z0 * w0
            kept[4 * LANES + j], kept[5 * LANES + j], kept[6 * LANES + j], kept[7 * LANES + j] = s, q, r, f
            s, q, r, f = s + z1, q + z1 * z1, r + z1 * z0, f + z1 * w1
            kept[8 * LANES + j], kept[9 * LANES + j], kept[10 * LANES + j], kept[11 * LANES + j] = s, q, r, f
            s, q, r, f = s + z2, q + z2 * z2, r + z2 * z1, f + z2 * w2
            kept[12 * LANES + j], kept[13 * LANES + j], kept[14 * LANES + j], kept[15 * LANES + j] = s, q, r, f
            s, q, r, f = s + z3, q + z3 * z3, r + z3 * z2, f + z3 * w3
            kept[16 * LANES + j], kept[17 * LANES + j], kept[18 * LANES + j], kept[19 * LANES + j] = s, q, r, f
            st[S + j], st[Q + j], st[R + j], st[F + j] = s, q, r, f


@compiled
def _lag_chunk(w: Floats, begin: int, st: Floats, z: Floats) -> None:
    """The same by CHUNK samples from `begin` on, without the sums before each."""
    for k in range(0, CHUNK, 4):
        now, row = place((begin + k) * LANES), place(k * LANES)
        for j in range(LANES):
            p, g, z0, last = st[P + j], st[G + j], st[Z + j], st[LAST + j]
            z1 = p * z0 + g * w[now + place(j)]
            z2 = p * z1 + g * w[now + place(LANES + j)]
            z3 = p * z2 + g * w[now + place(2 * LANES + j)]
            st[Z + j] = p * z3 + g * w[now + place(3 * LANES + j)]
            st[LAST + j] = z3
            z[row + place(j)], z[row + place(LANES + j)] = z0, z1
            z[row + place(2 * LANES + j)], z[row + place(3 * LANES + j)] = z2, z3
            st[S + j] += (z0 + z1) + (z2 + z3)
            st[Q + j] += (z0 * z0 + z1 * z1) + (z2 * z2 + z3 * z3)
            st[R + j] += (z0 * last + z1 * z0) + (z2 * z1 + z3 * z2)
            w0 = st[W + j]
            w1 = w0 * p
            w2 = w1 * p
            w3 = w2 * p
            st[F + j] += (z0 * w0 + z1 * w1) + (z2 * w2 + z3 * w3)
            fade = w3 * p
            st[W + j] = fade if fade > NOUGHT else 0.0


@compiled
def _cross(z: Floats, rows: int, t: Floats, begin: int, delays: Ints, sums: Floats) -> None:
    """Add to sums[i LANES + j] the products of `rows` (a multiple of 8) rows of z with t, delays[i] samples later.

    begin: the sample of t that the first row stands at.
    """
    for k in range(0, rows, 8):
        first = place(k * LANES)
        for i in range(delays.size):
            at, row = place(begin + k + delays[i]), place(i * LANES)
            v0, v1, v2, v3 = t[at], t[at + place(1)], t[at + place(2)], t[at + place(3)]
            v4, v5, v6, v7 = t[at + place(4)], t[at + place(5)], t[at + place(6)], t[at + place(7)]
            for j in range(LANES):
                b = first + place(j)
                near = z[b] * v0 + z[b + place(LANES)] * v1
                near += z[b + place(2 * LANES)] * v2 + z[b + place(3 * LANES)] * v3
                far = z[b + place(4 * LANES)] * v4 + z[b + place(5 * LANES)] * v5
                far += z[b + place(6 * LANES)] * v6 + z[b + place(7 * LANES)] * v7
                sums[row + place(j)] += near + far


@compiled
def _cross_own(z: Floats, rows: int, e: Floats, begin: int, delays: Ints, sums: Floats) -> None:
    """The same with a series of its own for each lane, e[k LANES + j]."""
    for k in range(rows):
        first = place(k * LANES)
        for i in range(delays.size):
            at, row = place((begin + k + delays[i]) * LANES), place(i * LANES)
            for j in range(LANES):
                sums[row + place(j)] += z[first + place(j)] * e[at + place(j)]


@compiled
def fade(t: Floats, weight: Floats, first: int, end: int, st: Floats, e: Floats) -> None:
    """Write the sums of a transient with each lane's pole, 1 at `first`: alone, squared, and with t.

    Over the samples up to `end`, by their weight, which is 0 from there on. e: room for the transient, e[k LANES + j],
    or empty.
    """
    st[SE : SE + LANES], st[SEE : SEE + LANES], st[SYE : SYE + LANES] = 0.0, 0.0, 0.0
    st[W : W + LANES] = 1.0
    for k in range(first, end, 4):
        v, c = t[k : k + 4], weight[k : k + 4]
        v0, v1, v2, v3 = v[0], v[1], v[2], v[3]
        c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
        for j in range(LANES):
            p, w0 = st[P + j], st[W + j]
            w1 = w0 * p
            w2 = w1 * p
            w3 = w2 * p
            e0, e1, e2, e3 = w0 * c0, w1 * c1, w2 * c2, w3 * c3
            st[SE + j] += (e0 + e1) + (e2 + e3)
            st[SEE + j] += (e0 * e0 + e1 * e1) + (e2 * e2 + e3 * e3)
            st[SYE + j] += (e0 * v0 + e1 * v1) + (e2 * v2 + e3 * v3)
            # One that has died out is nought before its products become too small for fast arithmetic.
            fade = w3 * p
            st[W + j] = fade if fade > NOUGHT else 0.0
    if e.size > 0:
        e[: first * LANES] = 0.0
        st[W : W + LANES] = 1.0
        for k in range(first, e.size // LANES):
            row, c0 = e[k * LANES : (k + 1) * LANES], weight[k]
            for j in range(LANES):
                row[j] = st[W + j] * c0
                fade = st[W + j] * st[P + j]
                st[W + j] = fade if fade > NOUGHT else 0.0


@compiled
def _times(powers: Floats, st: Floats) -> None:
    """Multiply by the lanes' poles."""
    for j in range(LANES):
        powers[j] *= st[P + j]


@compiled
def gather(w: Floats, t: Floats, weight: Floats, e: Floats, first: int, delays: Ints, st: Floats, sums: Floats) -> None:
    """Write the sums that least squares asks of LANES lags, answered to at each of `delays`, sums[(m D + i) LANES + j].

    m: ONES, SQUARES, PAIRS (a row with that of the sample before), FADING and PV: the products with 1, itself, and so
    on, over the samples that count. w: the lags' inputs, w[k LANES + j], and three rows more; t, weight: PV and 1 where
    a sample counts, both 0 where not, followed by delays[-1] + 8 noughts; e: the transient, likewise followed, empty
    where all samples from `first` on count. st: the lags' poles; all else of theirs is overwritten.
    """
    n, size = w.size // LANES - 3, delays.size
    # Before `head` and from `tail` on the sums are kept for all samples; both stretches are whole steps of four.
    head = (first + 3) // 4 * 4
    tail = head + max(n - 1 - delays[-1] - head, 0) // CHUNK * CHUNK
    z = np.zeros((max(CHUNK, head, n - tail) + 8) * LANES)
    head_edge, tail_edge = np.zeros(4 * (head + 1) * LANES), np.empty(4 * (n - tail + 4) * LANES)
    pairs = np.zeros(z.size if e.size > 0 else 0)
    sums[:] = 0.0
    for at in (Z, LAST, S, Q, R, F, W):
        st[at : at + LANES] = 0.0
    for j in range(LANES):
        st[G + j] = 1.0 - st[P + j]
    begin, end = 0, head
    while begin < n:
        rows = (end - begin + 7) // 8 * 8
        if e.size > 0:
            copy(st[LAST : LAST + LANES], pairs[:LANES])
        if end == head:
            _lag_edge(w, head, st, z, head_edge)
            st[W : W + LANES] = 1.0
        elif begin < tail:
            _lag_chunk(w, begin, st, z)
        else:
            _lag_edge(w[begin * LANES :], n - begin, st, z, tail_edge)
        z[(end - begin) * LANES : rows * LANES] = 0.0
        _cross(z, rows, t, begin, delays, sums[PV * size * LANES :])
        if e.size > 0:
            _cross(z, rows, weight, begin, delays, sums[ONES * size * LANES :])
            _cross_own(z, end - begin, e, begin, delays, sums[FADING * size * LANES :])
            for k in range((rows - 1) * LANES, 0, -1):
                pairs[LANES + k - 1] = z[k - 1]
            for k in range(rows * LANES):
                pairs[k] *= z[k]
                z[k] *= z[k]
            _cross(pairs, rows, weight, begin, delays, sums[PAIRS * size * LANES :])
            _cross(z, rows, weight, begin, delays, sums[SQUARES * size * LANES :])
        elif end == head:
            # Of a transient that begins there, in place of one that begins at its end: from each sample of the head.
            for k in range(head, -1, -1):
                row = head_edge[(4 * k + 3) * LANES : (4 * k + 4) * LANES]
                for j in range(LANES):
                    row[j] = z[k * LANES + j] + st[P + j] * head_edge[(4 * k + 7) * LANES + j] if k < head else 0.0
        begin = end
        end = begin + CHUNK if begin < tail else n
    if e.size > 0:
        return
    whole, late = np.ones(LANES), np.ones(LANES)
    for _ in range(head - first):
        _times(whole, st)
    reached = 0
    for i in range(size):
        for k in range(reached, delays[i]):
            _times(whole, st)
            if k >= first:
                _times(late, st)
        reached = delays[i]
        at, to = 4 * max(first - reached, 0) * LANES, 4 * (n - reached - tail) * LANES
        for j in range(LANES):
            sums[(ONES * size + i) * LANES + j] = tail_edge[to + j] - head_edge[at + j]
            to_j, at_j = to + LANES + j, at + LANES + j
            sums[(SQUARES * size + i) * LANES + j] = tail_edge[to_j] - head_edge[at_j]
            sums[(PAIRS * size + i) * LANES + j] = tail_edge[to_j + LANES] - head_edge[at_j + LANES]
            fading = late[j] * head_edge[at_j + 2 * LANES] + whole[j] * tail_edge[to_j + 2 * LANES]
            sums[(FADING * size + i) * LANES + j] = fading


@compiled
def one_tap(sums: Floats, size: int, pv: tuple[float, float, float], sign: float, st: Floats) -> None:
    """Better each lane's BEST by a gain, a constant and a transient at each of `size` dead times.

    pv: the number of samples that count, PV's sum and sum of squares over them. sign: that the gain must have, or 0.
    """
    count, sy, syy = pv
    for j in range(LANES):
        ee = st[SEE + j] - st[SE + j] * st[SE + j] / count
        apart = ee > SAME * st[SEE + j]
        st[SHARE + j] = 1.0 / (ee if apart else 1.0) if apart else 0.0
        st[EY + j] = st[SYE + j] - st[SE + j] * sy / count
        st[LEFT + j] = syy - sy * sy / count - st[EY + j] * st[EY + j] * st[SHARE + j]
    for i in range(size):
        ones, squares = sums[(ONES * size + i) * LANES :], sums[(SQUARES * size + i) * LANES :]
        fading, with_y = sums[(FADING * size + i) * LANES :], sums[(PV * size + i) * LANES :]
        for j in range(LANES):
            sz, szz = ones[j], squares[j]
            ze = fading[j] - sz * st[SE + j] / count
            zz = szz - sz * sz / count - ze * ze * st[SHARE + j]
            zy = with_y[j] - sz * sy / count - ze * st[EY + j] * st[SHARE + j]
            drives = zz > DRIVES * szz and zy * sign >= 0.0
            less = zy * zy / (zz if drives else 1.0)
            cost = st[LEFT + j] - (less if drives else 0.0)
            cost = cost if cost > 0.0 else 0.0
            better = cost < st[BEST + j]
            st[BEST + j] = cost if better else st[BEST + j]
            st[POLE_AT + j] = st[ID + j] if better else st[POLE_AT + j]
            st[DELAY_AT + j] = i if better else st[DELAY_AT + j]


@compiled
def two_taps(
    sums: Floats, size: int, i: int, j: int, pv: tuple[float, float, float], sign: float, st: Floats
) -> tuple[float, float, float]:
    """Return the sum of squares where dead time i and the next one share lane j's gain, and both parts of the gain.

    Where the parts would differ in sign the first has all of it, where the gain would have the wrong sign none.
    """
    count, sy, _ = pv
    z0, z1 = sums[(ONES * size + i) * LANES + j], sums[(ONES * size + i + 1) * LANES + j]
    p00, p11 = sums[(SQUARES * size + i) * LANES + j], sums[(SQUARES * size + i + 1) * LANES + j]
    p01 = sums[(PAIRS * size + i) * LANES + j]
    c0, c1 = sums[(PV * size + i) * LANES + j], sums[(PV * size + i + 1) * LANES + j]
    share, ey = st[SHARE + j], st[EY + j]
    e0 = sums[(FADING * size + i) * LANES + j] - z0 * st[SE + j] / count
    e1 = sums[(FADING * size + i + 1) * LANES + j] - z1 * st[SE + j] / count
    whole = p00
    p00 -= z0 * z0 / count + e0 * e0 * share
    p01 -= z0 * z1 / count + e0 * e1 * share
    p11 -= z1 * z1 / count + e1 * e1 * share
    c0 -= z0 * sy / count + e0 * ey * share
    c1 -= z1 * sy / count + e1 * ey * share
    left = st[LEFT + j]
    g0, g1, least = 0.0, 0.0, left
    if p00 > DRIVES * whole and c0 * sign >= 0.0:
        g0 = c0 / p00
        least = left - c0 * c0 / p00
    det = p00 * p11 - p01 * p01
    if det > DRIVES * p00 * p11:
        a, b = (c0 * p11 - c1 * p01) / det, (c1 * p00 - c0 * p01) / det
        if a * b >= 0.0 and (a + b) * sign >= 0.0:
            g0, g1 = a, b
            least = left - a * c0 - b * c1
    return max(least, 0.0), g0, g1
