"""Loops that oscillate together: one frequency, one phase, and most likely one root.

Loops that one source drives keep their phases to one another all day, however the cycle wanders; loops that merely
have similar periods do not. The measure is the mean phase coherence `|mean exp(i (phi_a - phi_b))|` (F. Mormann,
K. Lehnertz, P. David, C.E. Elger, Physica D 144 (2000) 358-369), 1 for locked phases and near 0 for independent ones.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.model.fleet import FleetRow, Group

__all__ = ["grouped", "untold"]

LOCKED = 0.6  # coherence from which two loops cycle together,
# and more where they share few cycles: stretches of so many count as independent, which meet by chance less often than
# so. Of n independent phases the coherence exceeds R with a probability of exp(-n R^2) (Rayleigh).
MEMORY, CHANCE = 5.0, 0.01
TELLING = -math.log(CHANCE) * MEMORY  # cycles that two loops must share at the least: below, chance locks any phases
ALIKE = 0.15  # relative difference of two periods that may be one
FEWEST = 24  # instants that two loops must share
WIDTH = 256  # of a block of loops that are compared at once


def grouped(rows: Sequence[FleetRow]) -> tuple[Group, ...]:
    """Return the groups of two loops and more, the largest first; each one's likely root first.

    The root is the loop with the strongest evidence that its valve sticks and makes the cycle: its verdict, then the
    share of PV's unpredicted variance that the stem explains, times the share of OP's swing that its stick band is. In
    a cycle of its own making a controller moves OP as far as the valve sticks and no farther; one that answers to
    another loop's cycle moves it as it must. A group without such a loop begins with its strongest oscillation.
    """
    cycling = sorted((row for row in rows if row.oscillates and row.phases), key=lambda row: (row.period, row.name))
    if len(cycling) < 2:
        return ()
    step = max(row.phase_step for row in cycling)
    signals, known = _aligned(cycling, step)
    periods = np.array([row.period for row in cycling])
    leader = list(range(len(cycling)))

    def find(i: int) -> int:
        while leader[i] != i:
            leader[i] = leader[leader[i]]
            i = leader[i]
        return i

    for first in range(0, len(cycling), WIDTH):
        stop = min(first + WIDTH, len(cycling))
        # Sorted by period: only loops up to the last alike one can match.
        last = int(np.searchsorted(periods, periods[stop - 1] * (1.0 + ALIKE), side="right"))
        locks = _coherence(signals[first:stop], known[first:stop], signals[first:last], known[first:last])
        ratio = periods[None, first:last] / periods[first:stop, None]
        cycles = (known[first:stop] @ known[first:last].T) * step / periods[None, first:last]
        least = np.sqrt(TELLING / np.maximum(cycles, 1e-9))
        for a, b in np.argwhere(
            (locks >= np.maximum(least, LOCKED)) & (ratio <= 1.0 + ALIKE) & (ratio >= 1.0)
        ).tolist():
            i, j = find(first + a), find(first + b)
            if i != j:
                leader[max(i, j)] = min(i, j)
    members: dict[int, list[int]] = {}
    for i in range(len(cycling)):
        members.setdefault(find(i), []).append(i)
    groups = [_group([cycling[i] for i in own], signals[own], known[own]) for own in members.values() if len(own) > 1]
    return tuple(sorted(groups, key=lambda group: (-len(group.members), group.members)))


def untold(rows: Sequence[FleetRow], groups: Sequence[Group]) -> frozenset[str]:
    """Return the loops outside every group of which that does not tell that they cycle alone.

    Another loop's period is alike, and one of the two was recorded over too few cycles for any coherence to count.
    """
    cycling = sorted((row for row in rows if row.oscillates and row.period > 0.0), key=lambda row: row.period)
    periods = [row.period for row in cycling]
    open_ = np.zeros(len(cycling), dtype=bool)
    for row in cycling:
        low, high = bisect_left(periods, row.period / (1.0 + ALIKE)), bisect_right(periods, row.period * (1.0 + ALIKE))
        if high - low > 1 and row.hours * 3600.0 < TELLING * row.period:
            open_[low:high] = True
    known = {name for group in groups for name in group.members}
    return frozenset(cycling[i].name for i in np.flatnonzero(open_)) - known


def _group(rows: list[FleetRow], signals: NDArray[np.complex64], known: NDArray[np.float32]) -> Group:
    order = sorted(
        range(len(rows)),
        key=lambda i: (not rows[i].sticks, -_strength(rows[i]), rows[i].name),
    )
    root = order[0]
    locks = _coherence(signals[root : root + 1], known[root : root + 1], signals, known)[0]
    others = sorted(order[1:], key=lambda i: (-float(locks[i]), rows[i].name))
    chosen = [root, *others]
    return Group(
        tuple(rows[i].name for i in chosen),
        tuple(1.0 if i == root else round(float(locks[i]), 4) for i in chosen),
        rows[root].period,
        rows[root].sticks,
    )


def _strength(row: FleetRow) -> float:
    strength = row.predicts * min(row.swing, 1.0) if row.sticks else row.oscillation_index
    return strength if math.isfinite(strength) else 0.0


def _aligned(rows: Sequence[FleetRow], step: float) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
    """Return unit vectors of each loop's phase at instants common to all, and which are known, shape (L, T).

    step: s, the longest of theirs: each is a power of two, and its instants are among the shorter's.
    """
    ends = []
    for row in rows:
        many = round(step / row.phase_step)
        ends.append((-(-row.phase_first // many), (row.phase_first + len(row.phases) - 1) // many))
    begin, stop = min(low for low, _ in ends), max(high for _, high in ends) + 1
    # Loops of other days share no instant with these; a few weeks of instants are kept at most.
    begin = max(begin, stop - 4096)
    signals = np.zeros((len(rows), stop - begin), dtype=np.complex64)
    for i, row in enumerate(rows):
        many = round(step / row.phase_step)
        turns = np.frombuffer(row.phases, dtype=np.uint8).astype(np.float64) / 256.0
        low, high = max(ends[i][0], begin), ends[i][1] + 1
        if low < high:
            at = np.arange(low, high) * many - row.phase_first
            signals[i, low - begin : high - begin] = np.exp(2j * np.pi * turns[at])
    return signals, (signals != 0.0).astype(np.float32)


def _coherence(
    a: NDArray[np.complex64], known_a: NDArray[np.float32], b: NDArray[np.complex64], known_b: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Return the mean phase coherence of each of a, (A, T), with each of b, (B, T); 0 where they share too few."""
    shared = known_a @ known_b.T
    summed = np.abs(a @ b.conj().T)
    locks: NDArray[np.float64] = np.where(shared >= FEWEST, summed / np.maximum(shared, 1.0), 0.0).astype(np.float64)
    return locks
