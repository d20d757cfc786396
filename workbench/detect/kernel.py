"""The stem test's compiled part: stems, whitened, drive lags that are fitted to whitened PV by least squares.

Stems, or time constants, are many: LANES of them run side by side. The compiler makes vector instructions of the loops
over lanes. For that, each decision is a choice between two values, and all numbers of the lanes are in flat arrays, the
number of lane j at j and LANES further on for each further sample.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled, copy, specialised
from workbench.simulate.kernel import STAIRS, TWO_PARAMETER, valve_step

__all__ = ["LANES", "noise", "own_products", "plant", "screen", "screen_drive", "settle", "sums_of", "whiten"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LANES = 16
CHUNK = 64  # samples at a time, a multiple of 8: their rows stay in the fastest memory
BLOCK = 512  # numbers at a time likewise, where a filter's terms are summed up
# Where each number of the lanes begins: of a stem the leads at which it slips and that it keeps, position and motion,
# and the first position.
_BAND, _OFFSET, _X, _MOTION, _X0 = range(0, 5 * LANES, LANES)
# Of a lag z: pole a and 1 - a; z now and in the sample before; sums of z, z^2, z with the sample before, and z with a
# transient; that transient; its own sum, that of its squares and with PV; a name for the lane; the best so far, its
# lane's name and dead time; and what PV's least squares leave without z: 1/the transient's power, its product with PV,
# both beside a constant, and the sum of squares.
_P, _G, _Z, _LAST, _S, _Q, _R, _F, _W, _SE, _SEE, _SYE = range(0, 12 * LANES, LANES)
_ID, _BEST, _POLE_AT, _DELAY_AT, _SHARE, _EY, _LEFT = range(12 * LANES, 19 * LANES, LANES)
ABREAST = 19 * LANES
# Products of a lag that least squares asks for, see `_gather`.
ONES, SQUARES, PAIRS, FADING, PV = range(5)
KINDS = 5
NOUGHT = 1e-100  # of a transient that was 1
SAME = 1e-10  # share of a transient's power that is not the constant's: less is rounding
DRIVES = 1e-9  # share of a lag's power that is neither's: less is rounding
SPREADS = (1.25, 1.08, 1.03)  # refinement of the time constant, the dead time by whole samples beside it
STEPS = 12  # at most, at each of them
NEAR = 6  # dead times looked at at once there
PIVOT = 1e-8  # of Cholesky's factor of an autoregression's normal equations: with less they are solved with care
RANK = 1e-12  # of their eigenvalues: less is rounding


@compiled
def whiten(a: Floats, row: Floats, out: Floats) -> None:
    """Write a signal filtered by a = (1, -a_1, .., -a_p), shape (N,), as if it had been 0 before."""
    taps = _four(a)
    before = np.zeros(taps.size - 1 + row.size)
    copy(row, before[taps.size - 1 :])
    _filter(taps, before, 1, out)


@compiled
def own_products(e: Floats, live: Bools, order: int, pole: float, gram: Floats, side: Floats) -> None:
    """Write the normal equations of a residual's autoregression, beside a constant and a transient with a pole.

    Rows k from `order` on, where live. Columns: e_{k-1} to e_{k-order}, 1, and pole^(k - order); gram, (order + 2,
    order + 2), their products with each other and side, (order + 2,), with e_k.
    """
    n, size = e.size, order + 2
    fading = np.empty(n - order)
    value = 1.0
    for k in range(n - order):
        fading[k] = value
        value = value * pole if value > NOUGHT else 0.0
    gram[:], side[:] = 0.0, 0.0
    if live[order:].all():
        # One lag further on both sides is the same products less one at the end and one more at the beginning.
        for j in range(order):
            gram[0, j] = np.dot(e[order - 1 : n - 1], e[order - 1 - j : n - 1 - j])
            side[j] = np.dot(e[order:], e[order - 1 - j : n - 1 - j])
            gram[j, order + 1] = np.dot(fading, e[order - 1 - j : n - 1 - j])
        for i in range(1, order):
            for j in range(i, order):
                gram[i, j] = gram[i - 1, j - 1] + e[order - 1 - i] * e[order - 1 - j] - e[n - 1 - i] * e[n - 1 - j]
        gram[0, order] = e[order - 1 : n - 1].sum()
        for i in range(1, order):
            gram[i, order] = gram[i - 1, order] + e[order - 1 - i] - e[n - 1 - i]
        gram[order, order] = n - order
        gram[order, order + 1] = fading.sum()
        gram[order + 1, order + 1] = np.dot(fading, fading)
        side[order] = e[order:].sum()
        side[order + 1] = np.dot(fading, e[order:])
    else:
        row = np.empty(size)
        for k in range(order, n):
            if not live[k]:
                continue
            for j in range(order):
                row[j] = e[k - 1 - j]
            row[order], row[order + 1] = 1.0, fading[k - order]
            for i in range(size):
                side[i] += row[i] * e[k]
                for j in range(i, size):
                    gram[i, j] += row[i] * row[j]
    for i in range(size):
        for j in range(i):
            gram[i, j] = gram[j, i]


@compiled
def sums_of(y: Floats, poles: Floats, delays: Ints, skip: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return what `screen_drive` takes of PV, four arrays of sums.

    Over the samples from k on, of y and of y^2, shape (N + 1,), and for each pole of y weighted by pole^(i - k), shape
    (P, N + 1); and what a transient that begins at the first sample that counts has come down to when a drive known
    from the start on is answered, shape (P, D).
    """
    n = y.size
    sum_y, sum_yy, fading = np.zeros(n + 1), np.zeros(n + 1), np.zeros((poles.size, n + 1))
    for k in range(n - 1, -1, -1):
        sum_y[k] = sum_y[k + 1] + y[k]
        sum_yy[k] = sum_yy[k + 1] + y[k] * y[k]
    # Four sums side by side, as none waits for another.
    for block in range(0, poles.size, 4):
        end = poles.size - 1
        ja, jb, jc, jd = block, min(block + 1, end), min(block + 2, end), min(block + 3, end)
        a, b, c, d = poles[ja], poles[jb], poles[jc], poles[jd]
        fa, fb, fc, fd = 0.0, 0.0, 0.0, 0.0
        for k in range(n - 1, -1, -1):
            v = y[k]
            fa, fb, fc, fd = v + a * fa, v + b * fb, v + c * fc, v + d * fd
            fading[ja, k], fading[jb, k], fading[jc, k], fading[jd, k] = fa, fb, fc, fd
    faded = np.empty((poles.size, delays.size))
    for j in range(poles.size):
        for i in range(delays.size):
            faded[j, i] = poles[j] ** max(delays[i] - skip, 0)
    return sum_y, sum_yy, fading, faded


@compiled
def _lags(drive: Floats, poles: tuple[float, float, float, float], z: Floats) -> None:
    """Write the answers of four lags of gain 1 to a drive, shape (4, N), side by side: none waits for another."""
    a, b, c, d = poles
    ga, gb, gc, gd = 1.0 - a, 1.0 - b, 1.0 - c, 1.0 - d
    za, zb, zc, zd = 0.0, 0.0, 0.0, 0.0
    for k in range(drive.size):
        z[0, k], z[1, k], z[2, k], z[3, k] = za, zb, zc, zd
        w = drive[k]
        za, zb, zc, zd = a * za + ga * w, b * zb + gb * w, c * zc + gc * w, d * zd + gd * w


@compiled
def _sums_from(
    z: Floats, poles: tuple[float, float, float, float], begin: int, end: int, kept: bool, sums: Floats
) -> None:
    """Go on from `end` back to `begin` with the sums over all later samples: of z, z^2, and z weighted by pole^(i - k).

    z: (4, N); sums: (3, 4, N + 1), read at `end` and written at `begin`, and at all samples between where kept.
    """
    a, b, c, d = poles
    sa, sb, sc, sd = sums[0, 0, end], sums[0, 1, end], sums[0, 2, end], sums[0, 3, end]
    qa, qb, qc, qd = sums[1, 0, end], sums[1, 1, end], sums[1, 2, end], sums[1, 3, end]
    fa, fb, fc, fd = sums[2, 0, end], sums[2, 1, end], sums[2, 2, end], sums[2, 3, end]
    for k in range(end - 1, begin - 1, -1):
        za, zb, zc, zd = z[0, k], z[1, k], z[2, k], z[3, k]
        sa, sb, sc, sd = sa + za, sb + zb, sc + zc, sd + zd
        qa, qb, qc, qd = qa + za * za, qb + zb * zb, qc + zc * zc, qd + zd * zd
        fa, fb, fc, fd = za + a * fa, zb + b * fb, zc + c * fc, zd + d * fd
        if kept or k == begin:
            sums[0, 0, k], sums[0, 1, k], sums[0, 2, k], sums[0, 3, k] = sa, sb, sc, sd
            sums[1, 0, k], sums[1, 1, k], sums[1, 2, k], sums[1, 3, k] = qa, qb, qc, qd
            sums[2, 0, k], sums[2, 1, k], sums[2, 2, k], sums[2, 3, k] = fa, fb, fc, fd


@compiled
def screen_drive(
    drive: Floats,
    y: Floats,
    poles: Floats,
    delays: Ints,
    within: tuple[int, int, int, int],
    sign: float,
    skip: int,
    known: int,
    alone: bool,
    sum_y: Floats,
    sum_yy: Floats,
    fading_y: Floats,
    faded: Floats,
    z: Floats,
    sums: Floats,
    best: Floats,
) -> None:
    """Try a drive's lag at a grid of poles and dead times beside a constant and a transient with the same pole.

    drive and y, shape (N,): the input, 0 before the record, and PV, both whitened. within: the first pole and the one
    after the last, the first dead time and the one after the last. sign: that the gain must have, or 0. The first
    `skip` samples do not count, nor those that answer to the first `known` samples of the drive. alone: whether a plant
    counts in which the drive has no part. sum_y, sum_yy, fading_y, faded: see `sums_of`; z, (4, N), and sums,
    (3, 4, N + 1): room to work in. best: (cost, pole, dead time) of the best so far, which is bettered; the cost is n
    times the mean square that is left.
    """
    n = y.size
    low, high, soonest, latest = within
    # Sums are asked for from the first sample that counts on, and up to n less the dead time.
    tail = n - delays[-1]
    head = min(max(skip, known + 1), tail)
    for block in range(low, high, 4):
        end = high - 1
        four = (poles[block], poles[min(block + 1, end)], poles[min(block + 2, end)], poles[min(block + 3, end)])
        _lags(drive, four, z)
        _sums_from(z, four, tail, n, True, sums)
        _sums_from(z, four, head, tail, False, sums)
        _sums_from(z, four, min(known + 1, head) if known > 0 else 0, head, True, sums)
        for j in range(block, min(block + 4, high)):
            pole, row = poles[j], j - block
            last, left = -1, 0.0
            for d in range(soonest, latest):
                delay = delays[d]
                b = max(skip, known + delay + 1 if known > 0 else 0)
                from_z, to_z = max(b, delay) - delay, n - delay
                count = n - b
                if count < 8:
                    continue
                if b != last:
                    last, left = b, pole**count
                se, see = (1.0 - left) / (1.0 - pole), (1.0 - left * left) / (1.0 - pole * pole)
                sy, sye = sum_y[b], fading_y[j, b]
                sz, szz = sums[0, row, from_z] - sums[0, row, to_z], sums[1, row, from_z] - sums[1, row, to_z]
                weight = faded[j, d] if known == 0 else 1.0
                sze = weight * sums[2, row, from_z] - left * sums[2, row, to_z]
                szy = np.dot(z[row, from_z:to_z], y[from_z + delay :])
                yy = sum_yy[b] - sy * sy / count
                zz, zy = szz - sz * sz / count, szy - sz * sy / count
                ee = see - se * se / count
                if ee > 1e-10 * see:
                    ey, ze = sye - se * sy / count, sze - sz * se / count
                    yy -= ey * ey / ee
                    zz -= ze * ze / ee
                    zy -= ze * ey / ee
                if zz > 1e-9 * szz and zy * sign >= 0.0:
                    yy -= zy * zy / zz
                elif not alone:
                    continue
                cost = max(yy, 0.0) * n / count
                if cost < best[0]:
                    best[0], best[1], best[2] = cost, j, d


@specialised
def _stems(kind: int, u: Floats, stems: Floats, x: Floats) -> None:
    """Write the moves of LANES stems away from where they are in sample 0, `x[k LANES + j]`; at rest before it."""
    u_last = u[0]
    for k in range(u.size):
        now, row = u[k], x[k * LANES : (k + 1) * LANES]
        for j in range(LANES):
            band, offset = stems[_BAND + j], stems[_OFFSET + j]
            motion = 0 if kind == STAIRS else int(stems[_MOTION + j])
            at, motion = valve_step(kind, band, offset, band, offset, now, u_last, stems[_X + j], motion)
            stems[_X + j], stems[_MOTION + j] = at, motion
        if k == 0:
            copy(stems[_X : _X + LANES], stems[_X0 : _X0 + LANES])
        for j in range(LANES):
            row[j] = stems[_X + j] - stems[_X0 + j]
        u_last = now


@compiled
def stems_abreast(kind: int, u: Floats, laws: Floats, stems: Floats, x: Floats) -> None:
    """Write the moves of up to LANES stems, x[k LANES + j], N LANES in all, as `valve_path` has them.

    kind: STAIRS or TWO_PARAMETER; laws: rows (lead u - x at which it slips, lead that it keeps while it moves, lead at
    the start, at rest); lanes without one have the last. stems: 5 LANES of room.
    """
    for j in range(LANES):
        i = min(j, laws.shape[0] - 1)
        stems[_BAND + j], stems[_OFFSET + j] = laws[i, 0], laws[i, 1]
        stems[_X + j], stems[_MOTION + j] = u[0] - laws[i, 2], 0.0
    if kind == STAIRS:
        _stems(STAIRS, u, stems, x)
    else:
        _stems(TWO_PARAMETER, u, stems, x)


@compiled
def _four(a: Floats) -> Floats:
    """Return a filter (1, -a_1, ..) without the nought at its end, filled up to one and a multiple of four terms."""
    size = a.size
    while size > 1 and a[size - 1] == 0.0:
        size -= 1
    taps = np.zeros(1 + (size + 2) // 4 * 4)
    copy(a[:size], taps[:size])
    return taps


@specialised
def _filter(taps: Floats, x: Floats, stride: int, w: Floats) -> None:
    """Write a filtered signal, or `stride` of them side by side; taps: as `_four` has them, p + 1.

    x begins p samples earlier than w.
    """
    p = (taps.size - 1) * stride
    for begin in range(0, w.size, BLOCK):
        # A block at a time, so that its sums stay in the fastest memory; within it none waits for another.
        size = min(BLOCK, w.size - begin)
        row, now = w[begin : begin + size], x[begin + p : begin + p + size]
        for j in range(size):
            row[j] = now[j]
        for i in range(1, taps.size, 4):
            a, b, c, d = taps[i], taps[i + 1], taps[i + 2], taps[i + 3]
            at = begin + p - i * stride
            near, late, later, last = x[at:], x[at - stride :], x[at - 2 * stride :], x[at - 3 * stride :]
            for j in range(size):
                row[j] += (a * near[j] + b * late[j]) + (c * later[j] + d * last[j])


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
            p, g, z0, last = st[_P + j], st[_G + j], st[_Z + j], st[_LAST + j]
            z1 = p * z0 + g * now[j]
            z2 = p * z1 + g * now[LANES + j]
            z3 = p * z2 + g * now[2 * LANES + j]
            st[_Z + j] = p * z3 + g * now[3 * LANES + j]
            st[_LAST + j] = z3
            rows[j], rows[LANES + j], rows[2 * LANES + j], rows[3 * LANES + j] = z0, z1, z2, z3
            w0 = st[_W + j]
            w1 = w0 * p
            w2 = w1 * p
            w3 = w2 * p
            fade = w3 * p
            st[_W + j] = fade if fade > NOUGHT else 0.0
            s, q, r, f = st[_S + j], st[_Q + j], st[_R + j], st[_F + j]
            kept[j], kept[LANES + j], kept[2 * LANES + j], kept[3 * LANES + j] = s, q, r, f
            s, q, r, f = s + z0, q + z0 * z0, r + z0 * last, f + z0 * w0
            kept[4 * LANES + j], kept[5 * LANES + j], kept[6 * LANES + j], kept[7 * LANES + j] = s, q, r, f
            s, q, r, f = s + z1, q + z1 * z1, r + z1 * z0, f + z1 * w1
            kept[8 * LANES + j], kept[9 * LANES + j], kept[10 * LANES + j], kept[11 * LANES + j] = s, q, r, f
            s, q, r, f = s + z2, q + z2 * z2, r + z2 * z1, f + z2 * w2
            kept[12 * LANES + j], kept[13 * LANES + j], kept[14 * LANES + j], kept[15 * LANES + j] = s, q, r, f
            s, q, r, f = s + z3, q + z3 * z3, r + z3 * z2, f + z3 * w3
            kept[16 * LANES + j], kept[17 * LANES + j], kept[18 * LANES + j], kept[19 * LANES + j] = s, q, r, f
            st[_S + j], st[_Q + j], st[_R + j], st[_F + j] = s, q, r, f


@compiled
def _lag_chunk(w: Floats, st: Floats, z: Floats) -> None:
    """The same by CHUNK samples, without the sums before each."""
    for k in range(0, CHUNK, 4):
        now, rows = w[k * LANES : (k + 4) * LANES], z[k * LANES : (k + 4) * LANES]
        for j in range(LANES):
            p, g, z0, last = st[_P + j], st[_G + j], st[_Z + j], st[_LAST + j]
            z1 = p * z0 + g * now[j]
            z2 = p * z1 + g * now[LANES + j]
            z3 = p * z2 + g * now[2 * LANES + j]
            st[_Z + j] = p * z3 + g * now[3 * LANES + j]
            st[_LAST + j] = z3
            rows[j], rows[LANES + j], rows[2 * LANES + j], rows[3 * LANES + j] = z0, z1, z2, z3
            st[_S + j] += (z0 + z1) + (z2 + z3)
            st[_Q + j] += (z0 * z0 + z1 * z1) + (z2 * z2 + z3 * z3)
            st[_R + j] += (z0 * last + z1 * z0) + (z2 * z1 + z3 * z2)
            w0 = st[_W + j]
            w1 = w0 * p
            w2 = w1 * p
            w3 = w2 * p
            st[_F + j] += (z0 * w0 + z1 * w1) + (z2 * w2 + z3 * w3)
            fade = w3 * p
            st[_W + j] = fade if fade > NOUGHT else 0.0


@compiled
def _cross(z: Floats, rows: int, t: Floats, delays: Ints, sums: Floats) -> None:
    """Add to sums[i LANES + j] the products of `rows` (a multiple of 8) rows of z with t, delays[i] samples later."""
    for k in range(0, rows, 8):
        b = z[k * LANES : (k + 8) * LANES]
        for i in range(delays.size):
            v = t[k + delays[i] : k + delays[i] + 8]
            v0, v1, v2, v3, v4, v5, v6, v7 = v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7]
            c = sums[i * LANES : (i + 1) * LANES]
            for j in range(LANES):
                near = (b[j] * v0 + b[LANES + j] * v1) + (b[2 * LANES + j] * v2 + b[3 * LANES + j] * v3)
                far = (b[4 * LANES + j] * v4 + b[5 * LANES + j] * v5) + (b[6 * LANES + j] * v6 + b[7 * LANES + j] * v7)
                c[j] += near + far


@compiled
def _cross_own(z: Floats, rows: int, e: Floats, delays: Ints, sums: Floats) -> None:
    """The same with a series of its own for each lane, e[k LANES + j]."""
    for k in range(rows):
        b = z[k * LANES : (k + 1) * LANES]
        for i in range(delays.size):
            v, c = e[(k + delays[i]) * LANES : (k + delays[i] + 1) * LANES], sums[i * LANES : (i + 1) * LANES]
            for j in range(LANES):
                c[j] += b[j] * v[j]


@compiled
def _fade(t: Floats, weight: Floats, first: int, end: int, st: Floats, e: Floats) -> None:
    """Write the sums of a transient with each lane's pole, 1 at `first`: alone, squared, and with t.

    Over the samples up to `end`, by their weight, which is 0 from there on. e: room for the transient, e[k LANES + j],
    or empty.
    """
    st[_SE : _SE + LANES], st[_SEE : _SEE + LANES], st[_SYE : _SYE + LANES] = 0.0, 0.0, 0.0
    st[_W : _W + LANES] = 1.0
    for k in range(first, end, 4):
        v, c = t[k : k + 4], weight[k : k + 4]
        v0, v1, v2, v3 = v[0], v[1], v[2], v[3]
        c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
        for j in range(LANES):
            p, w0 = st[_P + j], st[_W + j]
            w1 = w0 * p
            w2 = w1 * p
            w3 = w2 * p
            e0, e1, e2, e3 = w0 * c0, w1 * c1, w2 * c2, w3 * c3
            st[_SE + j] += (e0 + e1) + (e2 + e3)
            st[_SEE + j] += (e0 * e0 + e1 * e1) + (e2 * e2 + e3 * e3)
            st[_SYE + j] += (e0 * v0 + e1 * v1) + (e2 * v2 + e3 * v3)
            # One that has died out is nought before its products become too small for fast arithmetic.
            fade = w3 * p
            st[_W + j] = fade if fade > NOUGHT else 0.0
    if e.size > 0:
        e[: first * LANES] = 0.0
        st[_W : _W + LANES] = 1.0
        for k in range(first, e.size // LANES):
            row, c0 = e[k * LANES : (k + 1) * LANES], weight[k]
            for j in range(LANES):
                row[j] = st[_W + j] * c0
                fade = st[_W + j] * st[_P + j]
                st[_W + j] = fade if fade > NOUGHT else 0.0


@compiled
def _times(powers: Floats, st: Floats) -> None:
    """Multiply by the lanes' poles."""
    for j in range(LANES):
        powers[j] *= st[_P + j]


@compiled
def _gather(
    w: Floats, t: Floats, weight: Floats, e: Floats, first: int, delays: Ints, st: Floats, sums: Floats
) -> None:
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
    for at in (_Z, _LAST, _S, _Q, _R, _F, _W):
        st[at : at + LANES] = 0.0
    for j in range(LANES):
        st[_G + j] = 1.0 - st[_P + j]
    begin, end = 0, head
    while begin < n:
        rows = (end - begin + 7) // 8 * 8
        if e.size > 0:
            copy(st[_LAST : _LAST + LANES], pairs[:LANES])
        if end == head:
            _lag_edge(w, head, st, z, head_edge)
            st[_W : _W + LANES] = 1.0
        elif begin < tail:
            _lag_chunk(w[begin * LANES :], st, z)
        else:
            _lag_edge(w[begin * LANES :], n - begin, st, z, tail_edge)
        z[(end - begin) * LANES : rows * LANES] = 0.0
        _cross(z, rows, t[begin:], delays, sums[PV * size * LANES :])
        if e.size > 0:
            _cross(z, rows, weight[begin:], delays, sums[ONES * size * LANES :])
            _cross_own(z, end - begin, e[begin * LANES :], delays, sums[FADING * size * LANES :])
            for k in range((rows - 1) * LANES, 0, -1):
                pairs[LANES + k - 1] = z[k - 1]
            for k in range(rows * LANES):
                pairs[k] *= z[k]
                z[k] *= z[k]
            _cross(pairs, rows, weight[begin:], delays, sums[PAIRS * size * LANES :])
            _cross(z, rows, weight[begin:], delays, sums[SQUARES * size * LANES :])
        elif end == head:
            # Of a transient that begins there, in place of one that begins at its end: from each sample of the head.
            for k in range(head, -1, -1):
                row = head_edge[(4 * k + 3) * LANES : (4 * k + 4) * LANES]
                for j in range(LANES):
                    row[j] = z[k * LANES + j] + st[_P + j] * head_edge[(4 * k + 7) * LANES + j] if k < head else 0.0
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
def _one_tap(sums: Floats, size: int, pv: tuple[float, float, float], sign: float, st: Floats) -> None:
    """Better each lane's BEST by a gain, a constant and a transient at each of `size` dead times.

    pv: the number of samples that count, PV's sum and sum of squares over them. sign: that the gain must have, or 0.
    """
    count, sy, syy = pv
    for j in range(LANES):
        ee = st[_SEE + j] - st[_SE + j] * st[_SE + j] / count
        apart = ee > SAME * st[_SEE + j]
        st[_SHARE + j] = 1.0 / (ee if apart else 1.0) if apart else 0.0
        st[_EY + j] = st[_SYE + j] - st[_SE + j] * sy / count
        st[_LEFT + j] = syy - sy * sy / count - st[_EY + j] * st[_EY + j] * st[_SHARE + j]
    for i in range(size):
        ones, squares = sums[(ONES * size + i) * LANES :], sums[(SQUARES * size + i) * LANES :]
        fading, with_y = sums[(FADING * size + i) * LANES :], sums[(PV * size + i) * LANES :]
        for j in range(LANES):
            sz, szz = ones[j], squares[j]
            ze = fading[j] - sz * st[_SE + j] / count
            zz = szz - sz * sz / count - ze * ze * st[_SHARE + j]
            zy = with_y[j] - sz * sy / count - ze * st[_EY + j] * st[_SHARE + j]
            drives = zz > DRIVES * szz and zy * sign >= 0.0
            less = zy * zy / (zz if drives else 1.0)
            cost = st[_LEFT + j] - (less if drives else 0.0)
            cost = cost if cost > 0.0 else 0.0
            better = cost < st[_BEST + j]
            st[_BEST + j] = cost if better else st[_BEST + j]
            st[_POLE_AT + j] = st[_ID + j] if better else st[_POLE_AT + j]
            st[_DELAY_AT + j] = i if better else st[_DELAY_AT + j]


@compiled
def _two_taps(
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
    share, ey = st[_SHARE + j], st[_EY + j]
    e0 = sums[(FADING * size + i) * LANES + j] - z0 * st[_SE + j] / count
    e1 = sums[(FADING * size + i + 1) * LANES + j] - z1 * st[_SE + j] / count
    whole = p00
    p00 -= z0 * z0 / count + e0 * e0 * share
    p01 -= z0 * z1 / count + e0 * e1 * share
    p11 -= z1 * z1 / count + e1 * e1 * share
    c0 -= z0 * sy / count + e0 * ey * share
    c1 -= z1 * sy / count + e1 * ey * share
    left = st[_LEFT + j]
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


@compiled
def _counted(
    target: Floats, live: Bools, first: int, longest: int
) -> tuple[Floats, Floats, bool, tuple[float, float, float]]:
    """Return what `_gather` takes of PV: t and weight, whether all samples from `first` on count, and PV's sums."""
    n = target.size
    t, weight = np.zeros(n + longest + 8), np.zeros(n + longest + 8)
    count, sy, syy = 0, 0.0, 0.0
    for k in range(first, n):
        if live[k]:
            t[k], weight[k] = target[k], 1.0
            count += 1
            sy += target[k]
            syy += target[k] * target[k]
    return t, weight, count == n - first, (float(count), sy, syy)


@compiled
def screen(
    kind: int,
    u: Floats,
    laws: Floats,
    a: Floats,
    target: Floats,
    live: Bools,
    poles: Floats,
    first: int,
    delays: Ints,
    sign: float,
    best: Floats,
) -> None:
    """Write for each valve i the least sum of squares over a grid of plants that its stem drives, best[i].

    kind, laws: of `stems_abreast`, u: OP, (N,); a: the filter that whitens the stems, target: PV whitened, (N,); live:
    the samples that count, from `first` on; poles, delays (ascending): the grid; sign: that the gain must have, or 0. A
    constant and a transient with the plant's pole are free.
    """
    n, count = target.size, laws.shape[0]
    taps = _four(a)
    before = (taps.size - 1) * LANES
    t, weight, whole, pv = _counted(target, live, first, delays[-1])
    e = np.zeros(0 if whole else t.size * LANES)
    x, w, stems, st = np.zeros(before + n * LANES), np.zeros((n + 3) * LANES), np.empty(5 * LANES), np.zeros(ABREAST)
    sums = np.empty(KINDS * delays.size * LANES)
    fades = np.empty((poles.size, 3))
    for i in range(poles.size):
        st[_P : _P + LANES] = poles[i]
        _fade(t, weight, first, n, st, e[:0])
        fades[i, 0], fades[i, 1], fades[i, 2] = st[_SE], st[_SEE], st[_SYE]
    for begin in range(0, count, LANES):
        stems_abreast(kind, u, laws[begin : begin + LANES], stems, x[before:])
        _filter(taps, x, LANES, w[: n * LANES])
        st[_BEST : _BEST + LANES] = np.inf
        for i in range(poles.size):
            st[_P : _P + LANES], st[_ID : _ID + LANES] = poles[i], i
            if whole:
                st[_SE : _SE + LANES], st[_SEE : _SEE + LANES], st[_SYE : _SYE + LANES] = (
                    fades[i, 0],
                    fades[i, 1],
                    fades[i, 2],
                )
            else:
                _fade(t, weight, first, n, st, e)
            _gather(w, t, weight, e, first, delays, st, sums)
            _one_tap(sums, delays.size, pv, sign, st)
        for j in range(min(LANES, count - begin)):
            best[begin + j] = st[_BEST + j]


@compiled
def plant(
    y: Floats,
    x: Floats,
    a: Floats,
    live: Bools,
    first: int,
    taus: Floats,
    delays: Ints,
    sign: float,
    longest: float,
    residual: Floats,
) -> tuple[float, float, int]:
    """Fit a lag driven by x to PV, the gain shared by two neighbouring dead times, and write what it leaves of PV.

    y, x: PV and the drive, (N,), measured as the filter a whitens them; live, first, sign: as in `screen`. Begins with
    the best of a grid, taus and delays (ascending), samples, and goes on to time constants of up to `longest` and dead
    times up to the grid's last. Returns the least sum of squares, time constant and dead time (the shorter of the two).
    """
    n, end = y.size, delays[-1]
    target, drive, moves = np.empty(n), np.empty(n), x - x[0]
    whiten(a, y, target)
    whiten(a, moves, drive)
    t, weight, whole, pv = _counted(target, live, first, end + 1)
    e = np.zeros(0 if whole else t.size * LANES)
    w, st = np.zeros((n + 3) * LANES), np.zeros(ABREAST)
    for k in range(n):
        w[k * LANES : (k + 1) * LANES] = drive[k]
    sums = np.empty(KINDS * max(delays.size, NEAR) * LANES)
    least, tau, delay = np.inf, taus[0], delays[0]
    for begin in range(0, taus.size, LANES):
        for j in range(LANES):
            st[_ID + j] = min(begin + j, taus.size - 1)
            st[_P + j] = math.exp(-1.0 / taus[int(st[_ID + j])])
        st[_BEST : _BEST + LANES] = np.inf
        _fade(t, weight, first, n, st, e)
        _gather(w, t, weight, e, first, delays, st, sums)
        _one_tap(sums, delays.size, pv, sign, st)
        for j in range(LANES):
            if st[_BEST + j] < least:
                least, tau, delay = st[_BEST + j], taus[int(st[_POLE_AT + j])], delays[int(st[_DELAY_AT + j])]
    least, g0, g1 = np.inf, 0.0, 0.0
    trials = np.empty(LANES)
    for spread in SPREADS:
        low, high, lane = 0, -1, 0
        for _ in range(STEPS):
            before, middle = least, delay
            if not (0 < lane < LANES - 1 and low <= max(middle - 1, 0) and min(middle + 1, end) <= high):
                low, high, lane = max(middle - 2, 0), min(middle + 2, end), LANES // 2
                centre = tau
                for j in range(LANES):
                    trials[j] = min(centre * spread ** (j - lane), longest)
                    st[_P + j] = math.exp(-1.0 / trials[j])
                near = np.arange(low, high + 2)
                _fade(t, weight, first, n, st, e)
                _gather(w, t, weight, e, first, near, st, sums)
                _one_tap(sums, near.size, pv, sign, st)
            at = lane
            for j in range(at - 1, at + 2):
                for d in range(max(middle - 1, 0), min(middle + 1, end) + 1):
                    cost, h0, h1 = _two_taps(sums, near.size, d - low, j, pv, sign, st)
                    if cost < least:
                        least, tau, delay, g0, g1, lane = cost, trials[j], d, h0, h1, j
            if not least < before:
                break
    pole = math.exp(-1.0 / tau)
    lag, last = 0.0, 0.0
    copy(y[:delay], residual[:delay])
    for k in range(delay, n):
        residual[k] = y[k] - (g0 * lag + g1 * last)
        last = lag
        lag = pole * lag + (1.0 - pole) * moves[k - delay]
    return least, tau, delay


@compiled
def noise(e: Floats, live: Bools, order: int, pole: float, a: Floats) -> float:
    """Write a residual's whitening filter a = (1, -a_1, .., -a_p), by least squares; return the innovations' variance.

    A constant and a transient with the plant's pole, which the residual still holds, are fitted along.
    """
    n, size = e.size, order + 2
    gram, terms = np.empty((size, size)), np.empty(size)
    own_products(e, live, order, pole, gram, terms)
    _least(gram, terms)
    a[0] = 1.0
    for i in range(order):
        a[1 + i] = -terms[i]
    left = np.empty(n)
    whiten(a, e, left)
    power, count, fading = 0.0, 0, terms[order + 1]
    for k in range(order, n):
        if live[k]:
            v = left[k] - terms[order] - fading
            power += v * v
            count += 1
        fading = fading * pole if abs(fading) > NOUGHT else 0.0
    return power / count


@compiled
def _least(gram: Floats, side: Floats) -> None:
    """Write into `side` the solution of normal equations, by Cholesky's factor or, where that says too little, shared.

    A pole just below a sample's makes a transient no more than the constant: the pseudo-inverse shares it.
    """
    size = side.size
    scale = np.empty(size)
    for i in range(size):
        scale[i] = math.sqrt(gram[i, i]) if gram[i, i] > 0.0 else 1.0
    for i in range(size):
        side[i] /= scale[i]
        for j in range(size):
            gram[i, j] /= scale[i] * scale[j]
    factor = np.zeros((size, size))
    apart = True
    for i in range(size):
        for j in range(i + 1):
            total = gram[i, j]
            for m in range(j):
                total -= factor[i, m] * factor[j, m]
            if j < i:
                factor[i, j] = total / factor[j, j]
            elif total > PIVOT:
                factor[i, i] = math.sqrt(total)
            else:
                apart = False
        if not apart:
            break
    if apart:
        for i in range(size):
            for m in range(i):
                side[i] -= factor[i, m] * side[m]
            side[i] /= factor[i, i]
        for i in range(size - 1, -1, -1):
            for m in range(i + 1, size):
                side[i] -= factor[m, i] * side[m]
            side[i] /= factor[i, i]
    else:
        values, vectors = np.linalg.eigh(gram)
        largest = np.abs(values).max()
        parts = np.zeros(size)
        for m in range(size):
            if abs(values[m]) > RANK * largest:
                parts[m] = np.dot(vectors[:, m].copy(), side) / values[m]
        for i in range(size):
            side[i] = np.dot(vectors[i, :].copy(), parts)
    for i in range(size):
        side[i] /= scale[i]


@compiled
def settle(
    y: Floats,
    x: Floats,
    a: Floats,
    live: Bools,
    order: int,
    taus: Floats,
    delays: Ints,
    sign: float,
    longest: float,
    rounds: int,
    filters: Floats,
    residuals: Floats,
) -> tuple[int, float, float, int]:
    """Fit plant and autoregression in turn, `rounds` times; return the best round, its variance, tau and dead time.

    a: the filter to begin with. Written, a row for each round: filters, (rounds, order + 1), residuals, (rounds, N).
    All else as in `plant`.
    """
    best, least, tau, delay = 0, np.inf, 0.0, 0
    for i in range(rounds):
        _, trial, at = plant(y, x, a, live, order, taus, delays, sign, longest, residuals[i])
        variance = noise(residuals[i], live, order, math.exp(-1.0 / trial), filters[i])
        a = filters[i]
        if i == 0 or variance < least:
            best, least, tau, delay = i, variance, trial, at
    return best, least, tau, delay
