"""The stem test's compiled part: a lag driven by whitened stem paths, and its least squares against whitened PV."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled

__all__ = ["lagged", "own_products", "screen", "screen_drive", "sums_of", "taps", "whiten"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@compiled
def whiten(a: Floats, rows: Floats, out: Floats) -> None:
    """Write each row filtered by a = (1, -a_1, .., -a_p), shape (R, N), as if it had been 0 before."""
    n = rows.shape[1]
    for i in range(rows.shape[0]):
        for k in range(n):
            out[i, k] = a[0] * rows[i, k]
        # Four terms at a time: the sums are kept in memory, and read and written once for them all.
        for j in range(1, min(a.size, n), 4):
            b = a[j + 1] if j + 1 < a.size else 0.0
            c = a[j + 2] if j + 2 < a.size else 0.0
            d = a[j + 3] if j + 3 < a.size else 0.0
            for k in range(j, min(j + 3, n)):
                for m in range(min(k - j + 1, a.size - j)):
                    out[i, k] += a[j + m] * rows[i, k - j - m]
            for k in range(j + 3, n):
                total = out[i, k] + a[j] * rows[i, k - j]
                total += b * rows[i, k - j - 1]
                total += c * rows[i, k - j - 2]
                total += d * rows[i, k - j - 3]
                out[i, k] = total


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
        value *= pole
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
def lagged(drive: Floats, pole: float, z: Floats) -> None:
    """Write into z the lag `z_k = pole z_{k-1} + (1 - pole) drive_{k-1}`, z_0 = 0."""
    lag = 0.0
    z[0] = 0.0
    for k in range(1, drive.size):
        lag = pole * lag + (1.0 - pole) * drive[k - 1]
        z[k] = lag


@compiled
def _project(target: Floats, live: Bools, pole: float, first: int, e: Floats, t: Floats) -> float:
    """Write into e the unit transient less its mean, into t the target less mean and transient; return its power.

    Only live samples from `first` on count; the others are left 0.
    """
    n = target.size
    count = 0
    value, mean, mean_t = 1.0, 0.0, 0.0
    for k in range(first, n):
        e[k], t[k] = 0.0, 0.0
        if live[k]:
            count += 1
            e[k] = value
            mean += value
            mean_t += target[k]
        value *= pole
    mean /= count
    mean_t /= count
    power, common = 0.0, 0.0
    for k in range(first, n):
        if live[k]:
            e[k] -= mean
            power += e[k] * e[k]
            common += e[k] * target[k]
    # A transient as slow as many records is no longer apart from the constant.
    scale = 1.0 / np.sqrt(power) if power > 1e-12 * count else 0.0
    left = 0.0
    for k in range(first, n):
        if live[k]:
            e[k] *= scale
            t[k] = target[k] - mean_t - common * scale * e[k]
            left += t[k] * t[k]
    return left


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


@compiled
def screen(
    target: Floats,
    live: Bools,
    drives: Floats,
    poles: Floats,
    first: int,
    delays: Ints,
    sign: float,
    best: Floats,
    pole_at: Ints,
    delay_at: Ints,
) -> None:
    """Write for each path i the least sum of squares best[i] over poles and dead times, and where it is.

    target: whitened PV, (N,); live: the samples that count, from `first` on; drives: whitened inputs, (P, N); sign:
    that the gain must have, or 0. A constant and a transient with the plant's pole are free.
    """
    n = target.size
    count = live[first:].sum()
    if count < n - first:
        _screen_live(target, live, drives, poles, first, delays, sign, best, pole_at, delay_at)
        return
    sum_y, sum_yy, fading_y, faded = sums_of(target, poles, delays, first)
    z, sums, met = np.empty((4, n)), np.zeros((3, 4, n + 1)), np.empty(3)
    within = (0, poles.size, 0, delays.size)
    for i in range(drives.shape[0]):
        met[:] = np.inf, 0.0, 0.0
        screen_drive(
            drives[i],
            target,
            poles,
            delays,
            within,
            sign,
            first,
            0,
            True,
            sum_y,
            sum_yy,
            fading_y,
            faded,
            z,
            sums,
            met,
        )
        best[i], pole_at[i], delay_at[i] = met[0] * count / n, int(met[1]), int(met[2])


@compiled
def _screen_live(
    target: Floats,
    live: Bools,
    drives: Floats,
    poles: Floats,
    first: int,
    delays: Ints,
    sign: float,
    best: Floats,
    pole_at: Ints,
    delay_at: Ints,
) -> None:
    """The same where some samples from `first` on do not count."""
    n = target.size
    weight = np.zeros(n)
    weight[first:] = live[first:]
    count = weight.sum()
    z, squares, e, t = np.empty(n), np.empty(n), np.zeros(n), np.zeros(n)
    best[:] = np.inf
    for j in range(poles.size):
        left = _project(target, live, poles[j], first, e, t)
        for i in range(drives.shape[0]):
            lagged(drives[i], poles[j], z)
            squares[:] = z * z
            for d in range(delays.size):
                # Before its dead time is over the response is nought.
                delay = delays[d]
                whole = np.dot(squares[: n - delay], weight[delay:])
                total = np.dot(z[: n - delay], weight[delay:])
                on_e = np.dot(z[: n - delay], e[delay:])
                common = np.dot(z[: n - delay], t[delay:])
                power = whole - total * total / count - on_e * on_e
                sse = left
                if power > 1e-9 * whole and common * sign >= 0.0:
                    sse -= common * common / power
                if sse < best[i]:
                    best[i] = max(sse, 0.0)
                    pole_at[i] = j
                    delay_at[i] = d


@compiled
def taps(
    target: Floats,
    live: Bools,
    drive: Floats,
    pole: float,
    first: int,
    delays: tuple[int, int],
    sign: float,
    costs: Floats,
    gains: Floats,
) -> None:
    """Write the sum of squares of a plant whose gain two neighbouring dead times share, and both parts of the gain.

    delays: the first and the last of the dead times tried, which costs, (D,), and gains, (D, 2), are for. Where the
    parts would differ in sign one dead time has all of it, where the gain would have the wrong sign none.
    """
    n = target.size
    count = live[first:].sum()
    z, e, t = np.empty(n), np.zeros(n), np.zeros(n)
    left = _project(target, live, pole, first, e, t)
    lagged(drive, pole, z)
    for delay in range(delays[0], delays[1] + 1):
        m0, m1, e0, e1 = 0.0, 0.0, 0.0, 0.0
        p00, p01, p11, c0, c1 = 0.0, 0.0, 0.0, 0.0, 0.0
        w = z[max(first, delay) - delay - 1] if first > delay else 0.0
        for k in range(max(first, delay), n):
            v = z[k - delay]
            if live[k]:
                m0 += v
                m1 += w
                e0 += v * e[k]
                e1 += w * e[k]
                p00 += v * v
                p01 += v * w
                p11 += w * w
                c0 += v * t[k]
                c1 += w * t[k]
            w = v
        whole = p00
        p00 -= m0 * m0 / count + e0 * e0
        p01 -= m0 * m1 / count + e0 * e1
        p11 -= m1 * m1 / count + e1 * e1
        i = delay - delays[0]
        gains[i, 0], gains[i, 1] = 0.0, 0.0
        least = left
        if p00 > 1e-9 * whole and c0 * sign >= 0.0:
            gains[i, 0] = c0 / p00
            least = left - c0 * c0 / p00
        det = p00 * p11 - p01 * p01
        if det > 1e-9 * p00 * p11:
            g0, g1 = (c0 * p11 - c1 * p01) / det, (c1 * p00 - c0 * p01) / det
            if g0 * g1 >= 0.0 and (g0 + g1) * sign >= 0.0:
                gains[i, 0], gains[i, 1] = g0, g1
                least = left - g0 * c0 - g1 * c1
        costs[i] = max(least, 0.0)
