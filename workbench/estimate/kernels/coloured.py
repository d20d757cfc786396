"""What an autoregression leaves of PV beside a plant's response to a stem, from the products of both at all lags."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.kernels.output_error import oe_columns, plant_terms, solve
from workbench.simulate.compiled import compiled, copy

__all__ = ["HELD", "colour_left", "lagged", "products_of", "scan_colours"]

Floats = NDArray[np.float64]
HELD = 3  # signals that no stem changes, at most: the constant, the start and the transient
DIED = 1e-18  # of the largest value of a start or transient: it changes no sum


@compiled
def lagged(f: Floats, g: Floats, begin: int, size: int, out: Floats) -> None:
    """Write the sums over k from `begin` on of f[k - i] g[k - j], i and j below size."""
    n = f.size
    for i in range(size):
        out[0, i] = np.dot(f[begin:], g[begin - i : n - i])
        out[i, 0] = np.dot(f[begin - i : n - i], g[begin:])
    # One lag further in both is the same sum, one sample earlier.
    for i in range(1, size):
        for j in range(1, size):
            out[i, j] = out[i - 1, j - 1] + f[begin - i] * g[begin - j] - f[n - i] * g[n - j]


@compiled
def _lasting(signal: Floats) -> int:
    """Return how many samples a signal lasts before it has died out."""
    most = 0.0
    for k in range(signal.size):
        most = max(most, abs(signal[k]))
    last: int = signal.size
    while last > 0 and abs(signal[last - 1]) <= DIED * most:
        last -= 1
    return last


@compiled
def products_of(
    y: Floats,
    own: Floats,
    x: Floats,
    first: int,
    integrating: bool,
    tau: float,
    theta: float,
    begin: int,
    moves: bool,
    out: Floats,
) -> int:
    """Write the products that `colour_left` takes, over the samples from `begin` on, and return their rows.

    y, x: PV and the stem path, shape (N,), its first slip `first`; own, shape (size, size): PV's own (`lagged`). tau,
    theta: of a plant of gain 1, samples. moves: whether signals count by how they change from sample to sample, as y
    and own do already then. out,
    (2 size + HELD, 2 size + HELD): of PV at lags 0 to size - 1, of the response at the same, and of the signals that no
    stem changes, with each other; of these the ones that are nothing are left out.
    """
    n, size = y.size, own.shape[0]
    columns = np.empty((4, n))
    pole, c0, c1, m = plant_terms(integrating, tau, theta)
    oe_columns(x, first, pole, m, c0, c1, integrating, columns)
    if moves:
        for i in range(columns.shape[0]):
            for k in range(n - 1, 0, -1):
                columns[i, k] -= columns[i, k - 1]
    response, crossed, answered = columns[1], np.empty((size, size)), np.empty((size, size))
    lagged(y, response, begin, size, crossed)
    lagged(response, response, begin, size, answered)
    for i in range(size):
        for j in range(size):
            out[i, j], out[size + i, size + j] = own[i, j], answered[i, j]
            out[i, size + j] = out[size + j, i] = crossed[i, j]
    rows: int = 2 * size
    kept, lengths = np.empty((HELD, n - begin)), np.empty(HELD, np.int64)
    for column in (0, 2, 3):
        stop = begin + _lasting(columns[column, begin:])
        held = columns[column, begin:stop]
        if not np.dot(held, held) > 0.0:
            continue
        copy(held, kept[rows - 2 * size])
        lengths[rows - 2 * size] = held.size
        for i in range(size):
            out[i, rows] = np.dot(y[begin - i : stop - i], held)
            out[size + i, rows] = np.dot(response[begin - i : stop - i], held)
        for i in range(rows - 2 * size + 1):
            both = min(lengths[i], held.size)
            out[2 * size + i, rows] = np.dot(kept[i, :both], held[:both])
        for i in range(rows):
            out[rows, i] = out[i, rows]
        rows += 1
    return rows


@compiled
def colour_left(products: Floats, rows: int, size: int, gain: float, lags: int, room: Floats) -> float:
    """Return the sum of squares that an autoregression leaves of PV less the stem's response times a gain.

    products, rows: of `products_of`. lags: the autoregression's order, below size. What no stem changes stays what it
    is when it is filtered, but for its size. Written into the last row of room, (lags + h + 1, lags + h), with
    h = rows - 2 size: its coefficients, then those of the h signals.
    """
    held = rows - 2 * size
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


@compiled
def scan_colours(
    y: Floats,
    own: Floats,
    x: Floats,
    first: int,
    integrating: bool,
    plants: Floats,
    gains: Floats,
    begin: int,
    moves: bool,
    left: Floats,
) -> None:
    """Write what an autoregression leaves beside each plant, rows (tau, theta), and gain: sums, shape (plants, gains).

    own, begin, moves: as in `products_of`, own of one lag more than the autoregression's order.
    """
    size = own.shape[0]
    lags = size - 1
    products = np.empty((2 * size + HELD, 2 * size + HELD))
    for i in range(plants.shape[0]):
        rows = products_of(y, own, x, first, integrating, plants[i, 0], plants[i, 1], begin, moves, products)
        terms = lags + rows - 2 * size
        room = np.empty((terms + 1, terms))
        for j in range(gains.size):
            left[i, j] = colour_left(products, rows, size, gains[j], lags, room)
