"""One-parameter stem paths: where they may first slip, and the walk over every path of d, costed at every dead time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.fits.data import Centred, integers
from workbench.estimate.kernels import long as long_kernel
from workbench.estimate.kernels import path as path_kernel
from workbench.estimate.kernels import walk as walk_kernel
from workbench.estimate.kernels.walk import AtDelays, at_delays

__all__ = [
    "COST",
    "DELAY",
    "FIRST",
    "HIGH",
    "LEAST_D",
    "LOW",
    "SLIPS",
    "WIDE_D",
    "firsts_for",
    "firsts_within",
    "path_of",
    "range_of",
    "rising",
    "scan",
    "silent",
    "thin",
    "walk",
    "walk_starts",
]

STARTS = 48  # first slips scanned in the first round
MOST_STARTS = 400  # and in the second, at wider bands
WIDE_D = 0.08  # of OP's range
LEAST_D = 0.005  # of OP's range: below it a stem is OP

FIRST, LOW, HIGH, DELAY, COST, SLIPS = range(6)


def path_of(u: NDArray[np.float64], d: float, first: int) -> tuple[NDArray[np.float64], int]:
    """Return (stem path, number of slips): shape (N,), 0 before `first`, where the stem is unknown."""
    x = np.empty(u.size)
    return x, path_kernel.stem_path(u, d, first, x)


def range_of(u: NDArray[np.float64], d: float, first: int) -> tuple[float, float]:
    """Return all of the range [low, high) of d, %, for which the stem goes the way that it does for this one."""
    return long_kernel.path_range(u, d, first)


def walk(data: Centred, first: int, d_from: float, d_to: float, step: float, shifted: AtDelays) -> NDArray[np.float64]:
    """Return rows (FIRST, LOW, HIGH, DELAY, COST, SLIPS) of the paths from `first` with d in [d_from, d_to)."""
    least = d_from
    if first > 0:
        # The stem held before `first`, so that OP had stayed within a band of 2 d.
        least = max(d_from, 0.5 * float(np.ptp(data.u[:first])))
    if least >= d_to:
        return np.empty((0, 6))
    buffer = np.empty((4 * data.samples + 1000, walk_kernel.ROW))
    pole = 1.0 if data.integrating else math.nan
    count = walk_kernel.walk(
        data.sums,
        data.squares,
        data.products,
        data.u,
        first,
        least,
        d_to,
        step,
        shifted,
        pole,
        data.sign,
        buffer,
    )
    return np.column_stack([np.full(count, float(first)), buffer[:count]])


def walk_starts(
    data: Centred, firsts: NDArray[np.int64], bands: NDArray[np.float64], shifted: AtDelays
) -> NDArray[np.float64]:
    """Return rows as `walk`, LOW the band itself, of the paths of some bands, %, from first slips, ascending from 0."""
    reaches = 0.5 * data.starts.ranged[np.searchsorted(data.starts.firsts, firsts)]
    buffer = np.empty((bands.size * firsts.size, walk_kernel.ROW + 1))
    count = walk_kernel.walk_starts(
        data.sums,
        data.squares,
        data.products,
        data.u,
        firsts,
        reaches,
        np.ascontiguousarray(bands),
        shifted,
        1.0 if data.integrating else math.nan,
        data.sign,
        buffer,
    )
    return np.roll(buffer[:count], 1, axis=1)


def thin(firsts: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return at most `most` of some samples, evenly chosen, the first and the last among them."""
    if firsts.size <= most:
        return firsts
    return firsts[np.round(np.linspace(0, firsts.size - 1, most)).astype(np.int64)]


def silent(share: float) -> None:
    """Ignore the progress."""


def rising(progress: Callable[[float], None]) -> Callable[[float], None]:
    """Progress that never falls: a search that goes on to longer dead times begins anew."""
    most = 0.0

    def tell(share: float) -> None:
        nonlocal most
        most = max(most, share)
        progress(most)

    return tell


def scan(data: Centred, delays: NDArray[np.int64], progress: Callable[[float], None] = silent) -> NDArray[np.float64]:
    """Return all paths over all first slips (the likely ones first, then those beside the best), at every delay."""
    d_from, d_to = LEAST_D * data.op_range, 1.0001 * data.op_range
    firsts = data.starts.firsts
    chosen = thin(firsts, STARTS)
    found, shifted = [], at_delays(data.sums, delays)
    for i, first in enumerate(chosen.tolist()):
        found.append(walk(data, first, d_from, d_to, 0.0, shifted))
        progress((i + 1) / chosen.size)
    rows = np.vstack(found)
    if rows.size == 0 or chosen.size == firsts.size:
        return rows
    # Every other first slip as well, at bands where a late first slip can matter: small ones slip early.
    rest = np.setdiff1d(firsts, chosen)
    beside = [walk(data, f, WIDE_D * data.op_range, d_to, 0.0, shifted) for f in thin(rest, MOST_STARTS).tolist()]
    return np.vstack([rows, *beside])


def firsts_within(data: Centred, d: float) -> NDArray[np.int64]:
    """Return the samples at which a stem that sticks within d, %, may first slip: OP had stayed in a band of 2 d."""
    return data.starts.firsts[data.starts.ranged <= 2.0 * d]


def firsts_for(data: Centred, d: float, most: int) -> NDArray[np.int64]:
    """Return the first slips that a band d allows, at most `most`, spread over the OP at which they happen."""
    u, firsts = data.u, firsts_within(data, d)
    if firsts.size <= most:
        return firsts
    width = float(np.ptp(u[firsts])) / most
    _, kept = np.unique(np.floor(u[firsts] / width), return_index=True)
    return integers(np.sort(firsts[kept]))
