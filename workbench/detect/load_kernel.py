"""Orthogonal least squares of one load step, or ramp, after the other, for a row of signals each: its own basis."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled, copy

__all__ = ["add_step", "take"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

NOUGHT = 1e-100  # its square is nought
ALONE = 1e-6  # of a step's squares: where less is left that the plant and the steps before it do not show, it is none


@compiled
def _products(row: Floats, a: Floats, pole: float, ramps: bool, out: Floats) -> None:
    """Write the products of a signal with a whitened lag's answer to a step (ramp) that begins at each sample, (N,).

    An answer filtered by a is as good as the signal filtered by a backwards, and what 1 - pole^(i+1) gives from each
    sample on are two sums that run back. A ramp that rises by 1 a sample is a step at each sample from there on.
    """
    n, p = row.size, a.size - 1
    beyond, faded = 0.0, 0.0
    copied = np.zeros(n + p)
    copy(row, copied[:n])
    filtered = np.zeros(n)
    for j in range(p + 1):
        tap = a[j]
        later = copied[j : j + n]
        for k in range(n):
            filtered[k] += tap * later[k]
    for k in range(n - 1, -1, -1):
        beyond += filtered[k]
        faded = pole * (filtered[k] + faded)
        out[k] = beyond - faded
    if ramps:
        for k in range(n - 2, -1, -1):
            out[k] += out[k + 1]


@compiled
def take(
    columns: Floats, a: Floats, pole: float, ramps: bool, basis: Floats, taken: int, rest: Floats, left: Floats
) -> None:
    """Let each row's column explain what it can of what is left of it.

    columns, (D, N): written over by their parts apart from the basis, of length 1, which become its next; basis, (most,
    D, N), of which `taken` are there. rest, (D, N): what is left of PV; left, (D, N): of the squares of a step at each
    sample, or of a ramp (`_products`).
    """
    n = columns.shape[1]
    products = np.empty(n)
    for i in range(columns.shape[0]):
        column = columns[i]
        for _ in range(2):
            for b in range(taken):
                part = np.dot(basis[b, i], column)
                for k in range(n):
                    column[k] -= part * basis[b, i, k]
        length = math.sqrt(np.dot(column, column))
        # A transient that has died out before the first sample that counts explains nothing.
        for k in range(n):
            column[k] = column[k] / length if length > NOUGHT else 0.0
            basis[taken, i, k] = column[k]
        part = np.dot(column, rest[i])
        _products(column, a, pole, ramps, products)
        for k in range(n):
            rest[i, k] -= part * column[k]
            left[i, k] -= products[k] * products[k]


@compiled
def add_step(
    step: Floats,
    live: Bools,
    places: Bools,
    a: Floats,
    pole: float,
    ramps: bool,
    rest: Floats,
    left: Floats,
    whole: float,
    at: Ints,
) -> Floats:
    """Return each row's step, or ramp, that explains most of what is left of it, (D, N), and write its sample into at.

    at: (D,); step: the whitened answer to one at sample 0, (N,); live: the samples that count; places: those at which
    one may be. rest, left: as in `take`; whole: the largest square of a step.
    """
    rows, n = rest.shape
    columns, products = np.zeros((rows, n)), np.empty(n)
    for i in range(rows):
        _products(rest[i], a, pole, ramps, products)
        best, where = -math.inf, 0
        for k in range(n):
            gain = products[k] * products[k] / left[i, k] if places[k] and left[i, k] > ALONE * whole else -1.0
            if gain > best:
                best, where = gain, k
        at[i] = where
        for k in range(where, n):
            columns[i, k] = step[k - where] if live[k] else 0.0
    return columns
