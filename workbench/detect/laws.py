"""The valves that the stem test tries: a grid of them, and those about one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Deadband, Stenman
from workbench.simulate.run import valve_response

__all__ = ["BAND", "CLASSES", "Law", "Laws", "laws_of"]

# Widths as a share of OP's range, from what noise leaves visible to what lets the stem move at all.
WIDTHS = np.geomspace(0.03, 0.95, 70).tolist()  # d
BANDS = np.geomspace(0.04, 0.97, 48).tolist()  # S
JUMPS = (0.0, 0.3, 0.9, 1.4)  # J/S
# Where the stem may rest at the start: OP less stem, as a share of what holds it. A start that is wrong puts slips in
# wrong places until OP makes a move that is large beside the band: of narrow ones a few are enough.
STARTS = (-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9)
CLASSES = (0.1, 0.25, 0.5)  # of OP's range: between narrow and wide bands
BAND, JUMP, REST = range(3)  # columns of `Laws`


@dataclass(frozen=True, slots=True)
class Law:
    """A valve of the grid and where its stem rests at the start: OP less stem, %."""

    valve: Stenman | Choudhury | Deadband
    rest: float

    @property
    def band(self) -> float:
        """Width of the stick band, % (Stenman: d)."""
        return self.valve.stick_band

    def path(self, u: FloatArray) -> FloatArray:
        """Return the stem under OP, %, shape (N,)."""
        return valve_response(self.valve, u, float(u[0]), float(u[0]) - self.rest)

    def about(self, spread: float) -> Laws:
        """Return laws about this one: widths scaled by up to twice the spread, the jump and the rest moved."""
        factors = [1.0 + spread * f for f in (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)]
        S, J, rest = self.valve.stick_band, self.valve.slip_jump, self.rest
        stenman = isinstance(self.valve, Stenman)
        if stenman:
            found = [(S * f, S * f, r) for f in (*factors, 1.0) for r in (rest * f, rest - 4.0 * spread * S)]
            found.append((S, S, rest + 4.0 * spread * S))
        else:
            more = 3.0 * spread * J + spread * S
            jumps = (J, J + more, max(J - more, 0.0))
            found = [(S * f, jump, rest) for f in (*factors, 1.0) for jump in jumps]
            found += [(S, J, rest + f * spread * S) for f in (-3.0, 3.0)]
        laws = Laws(stenman, np.array(found))
        return Laws(laws.stenman, laws.rows[np.abs(laws.rows[:, REST]) <= laws.reach])


@dataclass(frozen=True, slots=True)
class Laws:
    """Valves of one kind, Stenman (its d is both S and J) or Choudhury: rows (S, J, rest), %, as `Law` has the rest."""

    stenman: bool
    rows: FloatArray

    def law(self, i: int) -> Law:
        """Return one of them."""
        S, J, rest = self.rows[i].tolist()
        return Law(Stenman(S) if self.stenman else Choudhury(S, J), rest)

    def each(self) -> Iterator[Law]:
        """Return one after the other."""
        return (self.law(i) for i in range(len(self.rows)))

    @property
    def reach(self) -> FloatArray:
        """How far OP may be from a stem at rest, %."""
        reach: FloatArray = 0.5 * (self.rows[:, BAND] + self.rows[:, JUMP])
        return reach

    @property
    def kernel_rows(self) -> FloatArray:
        """The kernel's rows: the leads at which they slip, those that they keep while moving, those at the start."""
        return np.column_stack([self.reach, 0.5 * (self.rows[:, BAND] - self.rows[:, JUMP]), self.rows[:, REST]])


def laws_of(width: float) -> tuple[Laws, Laws]:
    """Return the grid of valves for an OP that moves over `width` (%)."""
    stenman = [
        (w * width, w * width, s * w * width) for w in WIDTHS for s in (STARTS if w > CLASSES[0] else STARTS[::3])
    ]
    choudhury = [(b * width, j * b * width, 0.0) for b in BANDS for j in JUMPS]
    return Laws(True, np.array(stenman)), Laws(False, np.array(choudhury))
