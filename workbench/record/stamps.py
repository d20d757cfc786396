"""Tags that are each even but stamped some time apart, as where a historian reads one after the other: put together.

A historian that stamps OP 20 ms after PV, or each tag some ms early or late, did not sample them at other times than
the controller used them. So the stamps of PV count for all tags that were stamped near them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray
from workbench.record.even import best_grid, places
from workbench.record.signals import Signal, Signals

__all__ = ["on_stamps_of_pv"]

Rows = NDArray[np.int64]

APART = 0.25  # of the sample time, by which a tag may be stamped before or after PV throughout
SAID = 0.01  # of the sample time, from which it is said how far stamps are apart


def on_stamps_of_pv(signals: Signals) -> tuple[Signals, list[str]]:
    """Return the signals with PV's stamps on samples stamped near them, and how far they were apart, in words.

    Only of a PV and of tags that are even, each by itself, with one sample time; other tags keep their stamps.
    """
    pv = signals.by["PV"].seconds
    others = {name: s for name, s in signals.by.items() if not (s.seconds is pv or np.array_equal(s.seconds, pv))}
    usual = _even(signals.by["PV"]) if others else None
    if usual is None:
        return signals, []
    by, said = dict(signals.by), []
    for name, signal in others.items():
        found = _paired(pv, usual, signal)
        if found is None:
            continue
        by[name], offset, most = found
        if most > SAID * usual:
            where = f", by {abs(offset):.3g} s {'after' if offset > 0.0 else 'before'} on average"
            said.append(f"{name} up to {most:.3g} s{where if abs(offset) > SAID * usual else ''}")
    notes = [f"stamped apart from PV: {'; '.join(said)}; taken as samples of PV's times"] if said else []
    return replace(signals, by=by), notes


def _even(signal: Signal) -> float | None:
    """Return the sample time, s, of times that lie on an even grid, or None."""
    seconds = signal.seconds
    if seconds.size < 2:
        return None
    moved = places(seconds, [signal.cells.values])[1]
    return None if moved is None or not moved.any() else best_grid(seconds, moved)[0]


def _paired(pv: FloatArray, usual: float, signal: Signal) -> tuple[Signal, float, float] | None:
    """Return a signal on the stamps of PV, and how far it was from them, s: on average and at most.

    pv: stamps, s, shape (N,), every `usual` s. Returns None for a signal that is not even, has another sample time,
    lies further from PV than is taken as one sample, or needs nothing.
    """
    own = signal.seconds
    every = _even(signal)
    # Grids that drift apart over the record are not one.
    if every is None or abs(every - usual) * max(own.size, pv.size) > APART * usual:
        return None
    apart = own - pv[_nearest(pv, own)]
    apart = apart[np.abs(apart) <= 0.5 * usual]
    if not apart.any():
        return None
    # On a circle, for jitter may take a stamp nearer to the sample beside its own; then from the pairs that it makes.
    offset = usual * float(np.angle(np.exp(2j * np.pi / usual * apart).mean())) / (2.0 * np.pi)
    own_pairs, at = _pairs(pv, own - offset, usual)
    offset = float((own[own_pairs] - pv[at]).mean()) if at.size else np.inf
    if abs(offset) > APART * usual * (1.0 + 1e-6):
        return None
    seconds = own - offset
    own_pairs, at = _pairs(pv, seconds, usual)
    seconds[own_pairs] = pv[at]
    return replace(signal, seconds=seconds), offset, float(np.abs(own[own_pairs] - pv[at]).max())


def _pairs(pv: FloatArray, seconds: FloatArray, usual: float) -> tuple[Rows, Rows]:
    """Return the rows of times, and of PV's stamps, that are nearest to each other, within half a sample."""
    at = _nearest(pv, seconds)
    away = np.abs(seconds - pv[at])
    # Of two samples at one stamp the nearer has it.
    order = np.lexsort((away, at))
    order = order[np.concatenate([[True], np.diff(at[order]) > 0])]
    order = order[away[order] <= 0.5 * usual]
    return order, at[order]


def _nearest(stamps: FloatArray, seconds: FloatArray) -> Rows:
    """Return which of the stamps, ascending, is nearest to each time."""
    after = np.clip(np.searchsorted(stamps, seconds), 1, stamps.size - 1)
    return after - (seconds - stamps[after - 1] <= stamps[after] - seconds)
