"""Many stems fitted each beside the step of load that explains most, `LANES` of them in one pass over a record.

The compiler makes vector instructions of the loops over lanes (see `abreast`): each decision is a choice between two
values, and the lanes' numbers stand in one array at constant distances.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.output_error import plant_terms
from workbench.estimate.kernels.path import band_path, spans_of, stem_path
from workbench.simulate.compiled import compiled, copy, fused, place, written_out

__all__ = ["LANES", "STRIDE", "screen_stepped"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Plant = tuple[float, float, float, int]

LANES = 16
RUN = 8  # samples of a lane at a time, its numbers in registers
STRIDE = 4  # samples between the steps that are tried roughly
# A lane's numbers: its response, that squared, its products with what no stem changes (three columns) and with PV;
# then, backward, its sums beyond a sample, the best step so far, its sample, the stem's gain beside it, and one over
# the response's length.
(_S, _SS, _P0, _P1, _P2, _SY) = range(0, 6 * LANES, LANES)
(_BEYOND, _FADED, _BEST, _AT, _GAIN, _SCALE) = range(6 * LANES, 12 * LANES, LANES)
WIDTH = 12 * LANES
NEGLIGIBLE = 1e-9  # of a response: what is left of it beside the columns that no stem changes
ONCE = 1e-6  # of a step's answer: the same, beside those and the stem's response


@written_out
def _respond(
    x: Floats, w: Floats, held: Floats, lanes: Floats, terms: tuple[float, float, float], first: int, count: int
) -> None:
    """`count` samples of the lanes' responses from `first` on, written to w, and of their sums.

    x: the stems, late by the dead time, behind one sample more; held: rows of the three columns and PV.
    """
    pole, c0, c1 = terms
    at, row = place(first * LANES), place(4 * first)
    for j in range(LANES):
        s, ss, sy = lanes[_S + j], lanes[_SS + j], lanes[_SY + j]
        p0, p1, p2 = lanes[_P0 + j], lanes[_P1 + j], lanes[_P2 + j]
        for i in range(count):
            w[at + place(i * LANES + j)] = s
            ss += s * s
            p0 += s * held[row + place(4 * i)]
            p1 += s * held[row + place(4 * i + 1)]
            p2 += s * held[row + place(4 * i + 2)]
            sy += s * held[row + place(4 * i + 3)]
            s = pole * s + (c0 * x[at + place((i + 1) * LANES + j)] + c1 * x[at + place(i * LANES + j)])
        lanes[_S + j], lanes[_SS + j], lanes[_SY + j] = s, ss, sy
        lanes[_P0 + j], lanes[_P1 + j], lanes[_P2 + j] = p0, p1, p2


@fused
def _responses(
    x: Floats, w: Floats, held: Floats, lanes: Floats, terms: tuple[float, float, float], begin: int, end: int
) -> None:
    """The lanes' responses in samples [begin, end), and their sums."""
    k = begin
    while k + RUN <= end:
        _respond(x, w, held, lanes, terms, k, RUN)
        k += RUN
    while k < end:
        _respond(x, w, held, lanes, terms, k, 1)
        k += 1


@written_out
def _answered(
    w: Floats, lanes: Floats, fades: float, steps: Floats, first: int, integrating: bool, tries: int, every: int
) -> None:
    """Go back by `tries` times `every` samples of the lanes' responses to `first`, and try a step after each time.

    The answer of a step begins at the sample come to. steps: for each sample six numbers of its step's answer: its
    parts along the three columns, its product with PV, its square beside the columns; last the square alone.
    """
    at, row = place(first * LANES), place(6 * first)
    for j in range(LANES):
        beyond, faded = lanes[_BEYOND + j], lanes[_FADED + j]
        p0, p1, p2 = lanes[_P0 + j], lanes[_P1 + j], lanes[_P2 + j]
        product, scale = lanes[_SY + j], lanes[_SCALE + j]
        best, best_at, gain = lanes[_BEST + j], lanes[_AT + j], lanes[_GAIN + j]
        for i in range(tries * every - 1, -1, -1):
            now = w[at + place(i * LANES + j)]
            # Of a plant that integrates nothing fades: its answers are the sum of these sums.
            faded = fades * faded + (beyond if integrating else now)
            beyond += now
            if i % every == 0:
                total = faded if integrating else beyond - faded
                k0, k1, k2 = steps[row + place(6 * i)], steps[row + place(6 * i + 1)], steps[row + place(6 * i + 2)]
                s = (total - p0 * k0 - p1 * k1 - p2 * k2) * scale
                own = steps[row + place(6 * i + 4)] - s * s
                r = steps[row + place(6 * i + 3)] - product * s
                # One division for both: it takes as long as all else.
                over = r / own
                better = (own > ONCE * steps[row + place(6 * i + 5)]) & (r * r > best * own)
                best = r * over if better else best
                best_at = first + i if better else best_at
                gain = product - s * over if better else gain
        lanes[_BEYOND + j], lanes[_FADED + j] = beyond, faded
        lanes[_BEST + j], lanes[_AT + j], lanes[_GAIN + j] = best, best_at, gain


@fused
def _answers(
    w: Floats, lanes: Floats, fades: float, steps: Floats, integrating: bool, begin: int, end: int, every: int
) -> None:
    """Try steps of load from `end` back to `begin`, at each sample or at one of STRIDE so many."""
    k = end
    while every == 1 and k - STRIDE >= begin:
        k -= STRIDE
        _answered(w, lanes, fades, steps, k, integrating, STRIDE, 1)
    while every != 1 and k - STRIDE >= begin:
        k -= STRIDE
        _answered(w, lanes, fades, steps, k, integrating, 1, STRIDE)
    while every == 1 and k > begin:
        k -= 1
        _answered(w, lanes, fades, steps, k, integrating, 1, 1)


@fused
def _back(w: Floats, lanes: Floats, fades: float, integrating: bool, begin: int, end: int) -> None:
    """Go back over the lanes' responses from `end` to `begin`, before the steps that are tried."""
    for k in range(end - 1, begin - 1, -1):
        at = place(k * LANES)
        for j in range(LANES):
            now = w[at + place(j)]
            lanes[_FADED + j] = fades * lanes[_FADED + j] + (lanes[_BEYOND + j] if integrating else now)
            lanes[_BEYOND + j] += now


@compiled
def _stems(op: Floats, spans: Floats, stems: Floats, early: int, x: Floats, slips: Ints) -> None:
    """Write the paths of up to LANES stems, flat with LANES apart, behind `early` samples before the record.

    Where x has fewer samples than OP each is a mean of OP's. Written: slips, of each.
    """
    path, box = np.empty(op.size), np.empty(4)
    n = x.size // LANES - early
    many = op.size // n
    x[:] = 0.0
    for i in range(stems.shape[0]):
        first = int(stems[i, 2])
        if math.isnan(stems[i, 1]):
            slips[i] = stem_path(op, stems[i, 0], first, path)
        else:
            slips[i] = band_path(op, spans, stems[i, 0], stems[i, 1], first, stems[i, 3], path, box)
        if first < 0:
            for k in range(early):
                x[k * LANES + i] = path[0]
        for k in range(n):
            total = 0.0
            for q in range(k * many, (k + 1) * many):
                total += path[q]
            x[(early + k) * LANES + i] = total / many


@compiled
def _tried(
    x: Floats, w: Floats, lanes: Floats, held: Floats, steps: Floats, plant: Plant, span: tuple[int, int, int, int]
) -> None:
    """Run the lanes over the record and back; their sums and best steps are then in `lanes`.

    x: the lanes' stems, late by the dead time, from a sample before the record on; w: room for their responses and
    STRIDE samples more, which are 0; held, steps: for each sample what `_respond` and `_answered` need. span: the first
    sample that counts, those between which a step may begin, and how many lie between two that are tried, 1 or STRIDE.
    """
    skip, begin, end, every = span
    pole, c0, c1, _ = plant
    n = held.shape[0]
    flat, terms, integrating = held.ravel(), (pole, c0, c1), pole == 1.0
    lanes[:] = 0.0
    _responses(x, w, flat, lanes, terms, 0, skip)
    lanes[_SS : _SY + LANES] = 0.0
    _responses(x, w, flat, lanes, terms, skip, n)
    for j in range(LANES):
        p0, p1, p2 = lanes[_P0 + j], lanes[_P1 + j], lanes[_P2 + j]
        length = lanes[_SS + j] - p0 * p0 - p1 * p1 - p2 * p2
        scale = 1.0 / math.sqrt(length) if length > NEGLIGIBLE * lanes[_SS + j] else 0.0
        lanes[_SCALE + j] = scale
        lanes[_SY + j] *= scale
        lanes[_GAIN + j], lanes[_AT + j] = lanes[_SY + j], begin
    if begin >= end:
        return
    last = begin + (end - 1 - begin) // every * every
    _back(w, lanes, pole, integrating, last + every, n)
    _answers(w, lanes, pole, steps.ravel(), integrating, begin, last + every, every)


@compiled
def screen_stepped(
    y: Floats,
    op: Floats,
    stems: Floats,
    plants: Floats,
    integrating: bool,
    sign: float,
    skip: int,
    begin: int,
    end: int,
    every: int,
    found: Floats,
) -> None:
    """Fit the model and one step of load, at the sample that explains most, to many stems at each of some plants.

    op: as many samples as y has, or a multiple, over which each stem is averaged. stems: rows (S, J, first, sense), see
    `band_path`, those that slip first at one sample together; J nan for a Stenman stem of band S. plants: rows (tau,
    theta) in samples. The step's answer begins in [begin, end), at one of its samples (every 1) or one of STRIDE so
    many (every STRIDE). Written: found, shape (stems, plants, 2): the sum of squares from `skip` on, inf where the stem
    does not move or its gain is not of `sign`, and that sample.

    What no stem changes is taken out of PV first, for each pole: bias, transient, what the stem was before. What a step
    explains beside these and the stem's response s is `(r.h)^2 / |h|^2` with r and h the residual and the step's answer
    less their parts along s; products of a signal with the answers at all times are one backward sum.
    """
    n = y.size
    many = op.size // n
    early = 1
    for j in range(plants.shape[0]):
        early = max(early, plant_terms(integrating, plants[j, 0], plants[j, 1])[3] + 1)
    blocks, i = [0], 0
    while i < stems.shape[0]:
        first = stems[i, 2]
        until = i
        while until < min(i + LANES, stems.shape[0]) and stems[until, 2] == first:
            until += 1
        blocks.append(until)
        i = until
    paths, slips = np.empty((len(blocks) - 1, (early + n) * LANES)), np.zeros(stems.shape[0], np.int64)
    spans = spans_of(op)
    for b in range(len(blocks) - 1):
        _stems(op, spans, stems[blocks[b] : blocks[b + 1]], early, paths[b], slips[blocks[b] : blocks[b + 1]])
    w, lanes, held, steps = np.zeros((n + STRIDE) * LANES), np.empty(WIDTH), np.zeros((n, 4)), np.zeros((n, 6))
    column, basis, parts, size = np.empty(n), np.zeros((3, n)), np.zeros((3, n)), 0
    rest, along, power = np.empty(n), np.empty(n), np.empty(n)
    found[:, :, 0] = math.inf
    found[:, :, 1] = begin
    last, left_y = math.nan, 0.0
    for j in range(plants.shape[0]):
        plant = plant_terms(integrating, plants[j, 0], plants[j, 1])
        a, c0, c1, m = plant
        if a != last:
            last, size = a, 0
            basis[:] = 0.0
            parts[:] = 0.0
            for which in range(2):
                value = 1.0
                for k in range(n):
                    column[k] = 1.0 if which == 0 else (float(k) - 0.5 * n if integrating else value)
                    value *= a
                length = _apart_from(column, basis, size, skip)
                if length > 0.0:
                    for k in range(skip, n):
                        basis[size, k] = column[k] / length
                    _step_products(basis[size], a, integrating, parts[size])
                    size += 1
            copy(y, rest)
            left_y = _apart_from(rest, basis, size, skip) ** 2
            rest[:skip] = 0.0
            _step_products(rest, a, integrating, along)
            total, answer, own = 0.0, 0.0, 1.0
            for k in range(n - 1, -1, -1):
                total += answer * answer
                power[k] = total - parts[0, k] ** 2 - parts[1, k] ** 2
                own *= a
                answer = answer + 1.0 if integrating else 1.0 - own
        started, left_bare = -2, 0.0
        for b in range(len(blocks) - 1):
            first = int(stems[blocks[b], 2]) // many
            if first != started:
                # What the unknown stem before the first slip adds; stems that slip first at one sample share it.
                started = first
                value = 0.0
                for k in range(n):
                    column[k] = value
                    value = a * value + (c0 if k - m < first else 0.0) + (c1 if k - m - 1 < first else 0.0)
                length = 0.0 if first < 0 else _apart_from(column, basis, size, skip)
                basis[2] = 0.0
                product = 0.0
                if length > 0.0:
                    for k in range(skip, n):
                        basis[2, k] = column[k] / length
                        product += basis[2, k] * rest[k]
                _step_products(basis[2], a, integrating, parts[2])
                for k in range(n):
                    held[k, 3] = rest[k] - product * basis[2, k]
                    steps[k, 3] = along[k] - product * parts[2, k]
                    steps[k, 4] = power[k] - parts[2, k] ** 2
                    steps[k, 5] = power[k]
                    for q in range(3):
                        held[k, q], steps[k, q] = basis[q, k], parts[q, k]
                left_bare = left_y - product * product
            _tried(paths[b, (early - m - 1) * LANES :], w, lanes, held, steps, plant, (skip, begin, end, every))
            for lane in range(blocks[b + 1] - blocks[b]):
                i = blocks[b] + lane
                gain, product = lanes[_GAIN + lane], lanes[_SY + lane]
                if slips[i] >= 2 and lanes[_SCALE + lane] > 0.0 and sign * gain >= 0.0:
                    found[i, j, 0] = max(left_bare - product * product - lanes[_BEST + lane], 0.0)
                    found[i, j, 1] = lanes[_AT + lane]


@fused
def _apart_from(column: Floats, basis: Floats, size: int, skip: int) -> float:
    """Take out of a column its parts along an orthonormal basis, from `skip` on; return its length then, 0 for none."""
    whole = 0.0
    for k in range(skip, column.size):
        whole += column[k] * column[k]
    for i in range(size):
        part = 0.0
        for k in range(skip, column.size):
            part += column[k] * basis[i, k]
        for k in range(skip, column.size):
            column[k] -= part * basis[i, k]
    left = 0.0
    for k in range(skip, column.size):
        left += column[k] * column[k]
    if not left > 1e-12 * whole:
        return 0.0
    return math.sqrt(left)


@fused
def _step_products(signal: Floats, a: float, integrating: bool, out: Floats) -> None:
    """Write the products of a signal with a step's answer that begins at each sample."""
    beyond, faded, total = 0.0, 0.0, 0.0
    for k in range(signal.size - 1, -1, -1):
        if integrating:
            total += beyond
            beyond += signal[k]
            out[k] = total
        else:
            beyond += signal[k]
            faded = signal[k] + a * faded
            out[k] = beyond - faded
