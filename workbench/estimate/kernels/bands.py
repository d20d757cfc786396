"""Two-parameter stems tried in great number: at given plants, from many starts, and over a grid of plants."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.detect.whitening import four_taps, run_filter
from workbench.estimate.kernels.output_error import FIT, GAIN, cost_at, drive_of, posed, posed_alike
from workbench.estimate.kernels.path import band_path, spans_of
from workbench.simulate.compiled import compiled, copy, fused

__all__ = ["scan_bands", "scan_starts", "screen_bands", "screen_drive", "sums_of"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
    x, drive, spans = np.empty(op.size), np.empty(op.size), spans_of(op)
    box = np.empty(4)
    out = np.empty(FIT)
    longest = int(plants[:, 1].max())
    for i in range(bands.shape[0]):
        if band_path(op, spans, bands[i, 0], bands[i, 1], first, sense, x, box) == 0:
            costs[i] = math.inf
            continue
        drive_of(x, max(first, 0), a, drive)
        given = posed(y, drive, max(first, 0), (-math.inf, math.inf, sign), integrating, a, skip, longest)
        for j in range(plants.shape[0]):
            cost = cost_at(given, plants[j, 0], plants[j, 1], out)
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
    x, drive, spans = np.empty(op.size), np.zeros(op.size), spans_of(op)
    box = np.empty(4)
    out = np.empty(FIT)
    # PV's part of it, which each start's stem is then put beside.
    given = posed(y, drive, 0, (-math.inf, math.inf, sign), integrating, a, skip, int(theta))
    for i in range(starts.shape[0]):
        first = int(starts[i, 0])
        if band_path(op, spans, S, J, first, starts[i, 1], x, box) == 0:
            costs[i] = math.inf
            continue
        drive_of(x, max(first, 0), a, drive)
        given = posed_alike(given, drive, max(first, 0))
        cost = cost_at(given, tau, theta, out)
        costs[i] = cost if out[GAIN] != 0.0 else math.inf


@fused
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


@fused
def _onwards(
    drive: Floats, poles: tuple[float, float, float, float], begin: int, end: int, kept: bool, z: Floats, power: Floats
) -> None:
    """Go on from `begin` to `end` with the answers of four lags to a drive, and the sums of their squares before.

    The lags have gain 1 / (1 - pole), and none waits for another. z, (4, N + 1): written at each sample; power,
    (4, N + 1): at `end`, and at all samples between where kept.
    """
    a, b, c, d = poles
    za, zb, zc, zd = z[0, begin], z[1, begin], z[2, begin], z[3, begin]
    qa, qb, qc, qd = power[0, begin], power[1, begin], power[2, begin], power[3, begin]
    for k in range(begin, end):
        w = drive[k]
        qa, qb, qc, qd = qa + za * za, qb + zb * zb, qc + zc * zc, qd + zd * zd
        za, zb, zc, zd = a * za + w, b * zb + w, c * zc + w, d * zd + w
        z[0, k + 1], z[1, k + 1], z[2, k + 1], z[3, k + 1] = za, zb, zc, zd
        if kept:
            power[0, k + 1], power[1, k + 1], power[2, k + 1], power[3, k + 1] = qa, qb, qc, qd
    power[0, end], power[1, end], power[2, end], power[3, end] = qa, qb, qc, qd


@fused
def _backwards(
    drive: Floats, poles: tuple[float, float, float, float], begin: int, end: int, kept: bool, later: Floats
) -> None:
    """Go on from `end` back to `begin` with the sums of a drive over all later samples k, weighted by pole^(i - k).

    later, (5, N + 1): those of four poles, and the plain sum, written as `power` is by `_onwards`.
    """
    a, b, c, d = poles
    fa, fb, fc, fd, total = later[0, end], later[1, end], later[2, end], later[3, end], later[4, end]
    for k in range(end - 1, begin - 1, -1):
        w = drive[k]
        fa, fb, fc, fd, total = w + a * fa, w + b * fb, w + c * fc, w + d * fd, total + w
        if kept:
            later[0, k], later[1, k], later[2, k], later[3, k], later[4, k] = fa, fb, fc, fd, total
    later[0, begin], later[1, begin], later[2, begin], later[3, begin], later[4, begin] = fa, fb, fc, fd, total


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
    own: tuple[Floats, Floats, Floats, Floats],
    room: Floats,
    best: Floats,
) -> None:
    """Try a drive's lag at a grid of poles and dead times beside a constant and a transient with the same pole.

    drive and y, shape (N,): the input, 0 before the record, and PV, both whitened. within: the first pole and the one
    after the last, the first dead time and the one after the last. sign: that the gain must have, or 0. The first
    `skip` samples do not count, nor those that answer to the first `known` samples of the drive. alone: whether a plant
    counts in which the drive has no part. own: of `sums_of`; room, (13, N + 1), 0 at first: to work in. best: (cost,
    pole, dead time) of the best so far, which is bettered; the cost is n times the mean square that is left.

    The answer z follows z' = a z + w: its sum, and that weighted by a^i, are those of w and what z is at both ends.
    """
    n = y.size
    sum_y, sum_yy, fading_y, faded = own
    low, high, soonest, latest = within
    z, power, later = room[:4], room[4:8], room[8:]
    # Sums are asked for from the first sample that counts on, and up to n less the dead time.
    tail = n - delays[-1]
    head = min(max(skip, known + 1), tail)
    first = min(known + 1, head) if known > 0 else 0
    for block in range(low, high, 4):
        end = high - 1
        four = (poles[block], poles[min(block + 1, end)], poles[min(block + 2, end)], poles[min(block + 3, end)])
        _onwards(drive, four, 0, first, False, z, power)
        _onwards(drive, four, first, head, True, z, power)
        _onwards(drive, four, head, tail, False, z, power)
        _onwards(drive, four, tail, n, True, z, power)
        _backwards(drive, four, tail, n, True, later)
        _backwards(drive, four, head, tail, False, later)
        _backwards(drive, four, first, head, True, later)
        for j in range(block, min(block + 4, high)):
            pole, row = poles[j], j - block
            short, shorter = 1.0 - pole, 1.0 - pole * pole
            last, left, se, see = -1, 0.0, 0.0, 0.0
            for d in range(soonest, latest):
                delay = delays[d]
                b = max(skip, known + delay + 1 if known > 0 else 0)
                from_z, to_z = max(b, delay) - delay, n - delay
                count = n - b
                if count < 8:
                    continue
                if b != last:
                    last, left = b, pole**count
                    se, see = (1.0 - left) / short, (1.0 - left * left) / shorter
                sy, sye = sum_y[b], fading_y[j, b]
                begun, ended = z[row, from_z], z[row, to_z]
                sz = (later[4, from_z] - later[4, to_z] - (ended - begun)) / short
                szz = power[row, to_z] - power[row, from_z]
                weight = faded[j, d] if known == 0 else 1.0
                sze = weight * (begun + pole * later[row, from_z]) - left * (ended + pole * later[row, to_z])
                sze /= shorter
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
def _averaged(stem: Floats, many: int, out: Floats) -> None:
    """Write the means of a stem over so many samples each."""
    if many == 1:
        copy(stem, out)
        return
    for k in range(out.size):
        total = 0.0
        for i in range(k * many, (k + 1) * many):
            total += stem[i]
        out[k] = total / many


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

    op: as many samples as y has, or a multiple, over which each stem is averaged. bands: rows (S, J); y, a: as in
    `oe_cost`; delays: whole samples. COST: n times the mean square that is left, inf
    where the stem never moves. Starts: either end of the band, its middle, and any: from where the paths from both ends
    have met the stem is known; what was before is a constant and a transient with the plant's pole, and does not count.
    Where they meet after half the record, that is no start. An integrating plant is a pole just below 1.
    """
    n, p = y.size, a.size - 1
    many = op.size // n
    stems, paths, w, room = np.empty((3, op.size)), np.empty((4, n)), np.empty(n), np.zeros((13, n + 1))
    box = np.empty(4)
    own, spans = sums_of(y, poles, delays, skip), spans_of(op)
    taps = four_taps(a)
    before = taps.size - 1
    begun = np.zeros(before + n)
    best = np.empty(3)
    found[:, :, 0] = math.inf
    found[:, :, 1:] = 0.0
    for i in range(bands.shape[0]):
        S, J = bands[i, 0], bands[i, 1]
        band_path(op, spans, S, J, 0, 1.0, stems[0], box)
        band_path(op, spans, S, J, 0, -1.0, stems[1], box)
        moves = band_path(op, spans, S, J, -1, 0.0, stems[2], box) > 0
        met = op.size
        while met > 0 and stems[0, met - 1] == stems[1, met - 1]:
            met -= 1
        met = (met + many - 1) // many
        for way in range(3):
            _averaged(stems[way], many, paths[way])
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
                begun[before + k] = x[k] - x[0]
            run_filter(taps, begun, 1, w)
            best[0], best[1], best[2] = math.inf, 0.0, 0.0
            within = (low, high, soonest, latest)
            screen_drive(w, y, poles, delays, within, sign, skip, known, False, own, room, best)
            copy(best, found[i, start])
