"""What of long signals can be seen: the extremes of each pixel column, and each stretch of a phase plot once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray

__all__ = ["BEYOND", "COLUMNS", "but_for_kicks", "envelope", "fills", "phase", "seen", "settled", "thin", "time_axis"]

COLUMNS = 500  # pixel columns of a figure's plot area: half a point of a page-wide trend
BEYOND = 1e9  # EU or %: a signal that grows past this has left every plant, and its figure
GRIDS = (400, 200, 100, 50, 25)  # cells along each side of a phase plot, within which points are one
FILLS, SWING = 200, 0.05  # swings across a figure, and their share of its range, from which lines are a block
SETTLED, LATE = (
    0.05,
    0.1,
)  # of a signal's range, about what it is at the end; share of its samples that say what that is
STRETCHES = 2500  # of a phase plot, above which the next coarser grid is taken


def thin(x: FloatArray, y: FloatArray, columns: int = COLUMNS) -> tuple[FloatArray, FloatArray]:
    """Return the samples of an evenly spaced signal that show in `columns` pixel columns, in order.

    Signals of up to four samples a column are returned whole; a column's least and largest values are always kept.
    """
    n = x.size
    if n <= 4 * columns:
        return x, y
    dense = n > 16 * columns  # a column is a stroke from its least to its largest value
    edges = np.linspace(0, n, columns + 1).astype(int)
    first, last = edges[:-1], edges[1:] - 1
    # Columns differ by a sample in width; the shorter ones look at their last sample twice.
    places = np.minimum(first[:, None] + np.arange(int((last - first).max()) + 1), last[:, None])
    parts = y[places]
    extremes = [places[np.arange(columns), which] for which in (parts.argmin(axis=1), parts.argmax(axis=1))]
    ends = (first[[0, -1]], last[[0, -1]]) if dense else (first, last)
    keep = np.unique(np.concatenate([*extremes, *ends]))
    return x[keep], y[keep]


def seen(signal: FloatArray, limit: float = BEYOND) -> FloatArray:
    """Return a signal with nan where it is not finite or exceeds `limit` in size: the stretch that is not drawn."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(signal) <= limit, signal, math.nan)


def fills(signal: FloatArray, span: float) -> bool:
    """Return whether a signal swings so often that its line, in a figure of range `span`, hides all behind it."""
    y = signal[np.isfinite(signal)]
    y = y[1:][np.diff(y) != 0.0]
    if y.size < FILLS:
        return False
    turns = y[np.concatenate(([True], np.diff(np.sign(np.diff(y))) != 0.0, [True]))]
    return int(np.count_nonzero(np.abs(np.diff(turns)) > SWING * span)) > FILLS


def envelope(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (times, least, largest value) of a signal that swings fast, stretch by stretch, each of shape (M,)."""
    # A thinned signal holds little more than its extremes: a stretch has some of both.
    stretches = np.array_split(np.arange(x.size), min(FILLS, max(1, x.size // 6)))
    parts = [part for part in stretches if np.isfinite(y[part]).any()]
    low, high = ([pick(y[part]) for part in parts] for pick in (np.nanmin, np.nanmax))
    return np.array([x[part].mean() for part in parts]), np.array(low), np.array(high)


def settled(time: FloatArray, signal: FloatArray) -> float:
    """Return from when on a signal, shape (N,), stays about its late mean; infinite where it never does."""
    if not np.isfinite(signal).all():
        return math.inf
    late = float(signal[-max(1, int(LATE * signal.size)) :].mean())
    away = np.flatnonzero(np.abs(signal - late) > SETTLED * float(np.ptp(signal)))
    rest = int(away[-1]) + 1 if away.size else 0
    return float(time[rest]) if rest < time.size else math.inf


def phase(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a phase plot's line with every stretch drawn once; nan separates stretches that do not join.

    Points are told apart on a grid over the signals' ranges, of 400 x 400 cells, or coarser where noise fills it; of
    noise that fills even that, a part of the stretches is drawn.
    """
    both = np.isfinite(seen(x)) & np.isfinite(seen(y))
    x, y = x[both], y[both]
    if x.size < 2:
        return x, y
    for cells in GRIDS:
        moved, first = _stretches(x, y, cells)
        if first.size <= STRETCHES:
            break
    if first.size == 0:
        return x[moved], y[moved]
    first = first[:: math.ceil(first.size / STRETCHES)]  # of a cloud of noise, evenly over time
    # A stretch that does not begin where the last one ended is set off by a gap.
    gap = np.concatenate(([False], np.diff(first) != 1))
    ends = np.concatenate(([0], np.cumsum(1 + 2 * gap[1:]))) + 1  # place of each stretch's end in the line
    px, py = np.full(int(ends[-1]) + 1, math.nan), np.full(int(ends[-1]) + 1, math.nan)
    for out, signal in ((px, x), (py, y)):
        out[ends - 1] = signal[moved[first]]
        out[ends] = signal[moved[first + 1]]
    return px, py


def _stretches(x: FloatArray, y: FloatArray, cells: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the samples that enter another cell, and which of the stretches between them are new, in order."""
    places = []
    for signal in (x, y):
        low, high = float(signal.min()), float(signal.max())
        # What moves by next to no number is at rest: its cells cannot be told apart.
        places.append(
            np.round((signal - low) * (cells / (high - low) if high - low > 1e-300 else 0.0)).astype(np.int64)
        )
    code = places[0] * 1000 + places[1]
    moved = np.flatnonzero(np.concatenate(([True], np.diff(code) != 0)))
    code = code[moved]
    pair = np.minimum(code[:-1], code[1:]) * 1_000_000 + np.maximum(code[:-1], code[1:])
    return moved, np.sort(np.unique(pair, return_index=True)[1])


def time_axis(span: float) -> tuple[float, str]:
    """Return the seconds in the unit that suits a span, and the unit: s, min, h."""
    if span > 3.0 * 3600.0:
        return 3600.0, "h"
    return (60.0, "min") if span > 3600.0 else (1.0, "s")


def but_for_kicks(signals: Sequence[FloatArray]) -> tuple[float, float] | None:
    """Return what signals do but for 1 % at each end, where a first kick dwarfs that; None where none does."""
    kept = [s[np.isfinite(s)] for s in signals]
    kept = [s for s in kept if s.size]
    if not kept:
        return None
    ends = [float(np.quantile(s, q)) for s in kept for q in (0.01, 0.99)]
    low, high = min(ends), max(ends)
    least, most = min(float(s.min()) for s in kept), max(float(s.max()) for s in kept)
    return (low, high) if 0.0 < high - low < 0.5 * (most - least) else None
