"""The stretches of a long record that are looked at instead of all of it: those in which most happens."""

from __future__ import annotations

import math

import numpy as np

from workbench.estimate.fits.data import Centred

__all__ = ["EXACT", "WHOLE", "active_windows", "stretch_of", "stretch_with", "windows_of"]

# Exact enumeration up to this many samples; longer records are first searched in their most active windows of this
# length.
EXACT = 1500
# Two-parameter stems and load steps are sought in all of a record up to this many: a stretch of a slow cycle holds too
# few slips.
WHOLE = 10_000
WINDOWS = 3  # most active windows of a long record, beside its head
STRETCHES = 8  # the share of a long record in which plants are sought
SLIPS, LEAST, MOST = 12, 2 * EXACT, 4 * EXACT  # of a stretch in which stem and colour are: slips, and its samples


def _by_activity(data: Centred, size: int) -> list[int]:
    """Where stretches of a size begin, the most active first: where OP ranges and PV varies the most."""
    n = data.samples
    begins = np.unique(np.minimum(np.arange(0, n, size // 2), n - size))
    spread = math.sqrt(data.variance)
    activity = [
        float(np.ptp(data.u[b : b + size])) / data.op_range + float(np.std(data.y[b : b + size])) / spread
        for b in begins.tolist()
    ]
    order: list[int] = begins[np.argsort(activity, kind="stable")[::-1]].tolist()
    return order


def windows_of(data: Centred) -> list[tuple[int, int]]:
    """Return the most active windows, samples (first, stop), the liveliest first."""
    size = min(EXACT, data.samples)
    chosen: list[int] = []
    for begin in _by_activity(data, size):
        if all(abs(begin - b) >= size for b in chosen):
            chosen.append(begin)
        if len(chosen) == WINDOWS:
            break
    return [(b, b + size) for b in chosen]


def active_windows(data: Centred) -> list[tuple[int, Centred]]:
    """Return the most active windows of a long record in which both signals move, the liveliest first.

    Each with the sample at which it begins.
    """
    parts = [(begin, data.part(begin, stop)) for begin, stop in windows_of(data)]
    return [(begin, part) for begin, part in parts if part.moves]


def stretch_of(data: Centred) -> tuple[int, int]:
    """Return the samples [begin, stop) of a long record in which its plant is sought: an active share of it."""
    size = min(max(data.samples // STRETCHES, 3 * EXACT), data.samples)
    begin = _by_activity(data, size)[0]
    return begin, begin + size


def stretch_with(data: Centred, slips: int) -> tuple[int, int]:
    """Return the samples [begin, stop) of a long record in which stem and colour are sought: its liveliest.

    As many as hold slips enough, of so many in all of the record.
    """
    size = int(np.clip(SLIPS * data.samples / max(slips, 1), LEAST, MOST))
    begin = _by_activity(data, size)[0]
    return begin, begin + size
