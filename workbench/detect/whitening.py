"""Whitening: the filter of a signal's past, and the autoregression of a residual that it is taken from."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled, copy, specialised

__all__ = ["NOUGHT", "four_taps", "noise", "own_products", "run_filter", "whiten", "whitened"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

BLOCK = 512  # numbers at a time, where a filter's terms are summed up: they stay in the fastest memory
NOUGHT = 1e-100  # of a transient that was 1
PIVOT = 1e-8  # of Cholesky's factor of an autoregression's normal equations: with less they are solved with care
RANK = 1e-12  # of their eigenvalues: less is rounding


def whitened(a: Floats, rows: Floats) -> Floats:
    """Return signals, shape (N,) or (R, N), filtered by a = (1, -a_1, .., -a_p), as if they had been 0 before."""
    if a.size == 1:
        return rows
    out = np.empty(rows.shape)
    for row, filtered in zip(np.atleast_2d(np.ascontiguousarray(rows)), np.atleast_2d(out), strict=True):
        whiten(a, row, filtered)
    return out


@compiled
def whiten(a: Floats, row: Floats, out: Floats) -> None:
    """Write a signal filtered by a = (1, -a_1, .., -a_p), shape (N,), as if it had been 0 before."""
    if a.size == 1:
        copy(row, out)
        return
    taps = four_taps(a)
    before = np.zeros(taps.size - 1 + row.size)
    copy(row, before[taps.size - 1 :])
    run_filter(taps, before, 1, out)


@compiled
def four_taps(a: Floats) -> Floats:
    """Return a filter (1, -a_1, ..) without the nought at its end, filled up to one and a multiple of four terms."""
    size = a.size
    while size > 1 and a[size - 1] == 0.0:
        size -= 1
    taps = np.zeros(1 + (size + 2) // 4 * 4)
    copy(a[:size], taps[:size])
    return taps


@specialised
def run_filter(taps: Floats, x: Floats, stride: int, w: Floats) -> None:
    """Write a filtered signal, or `stride` of them side by side; taps: as `four_taps` has them, p + 1.

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
