"""A filter of first order, as plants, lags and level-free differences need it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled

__all__ = ["first_order"]

Floats = NDArray[np.float64]


def first_order(values: Floats, now: float, before: float, pole: float, start: float = 0.0) -> Floats:
    """Return `(now + before z^-1) / (1 - pole z^-1)` of signals of shape (N,) or, each by itself, of rows (M, N).

    start: added to the first sample, what the filter held before. scipy.signal has it too, but takes a second to load.
    """
    out = np.empty_like(values, dtype=np.float64)
    rows = np.ascontiguousarray(np.atleast_2d(values), dtype=np.float64)
    _first_order(rows, now, before, pole, start, np.atleast_2d(out))
    return out


@compiled
def _first_order(rows: Floats, now: float, before: float, pole: float, start: float, out: Floats) -> None:
    for i in range(rows.shape[0]):
        held = start
        for k in range(rows.shape[1]):
            out[i, k] = now * rows[i, k] + held
            held = before * rows[i, k] + pole * out[i, k]
