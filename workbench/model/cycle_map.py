"""What each tuning of a plane does in the long run: a map over (Kc, Ti) or (Kc, Td). No computing but look-up."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.model.checks import choice, number
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.show import Shown

__all__ = ["FIGURES", "MOST", "OUTCOMES", "POINTS", "CycleMap", "MapCell"]

# Cells along each axis: what is usual, and the most.
POINTS, MOST = 60, 400
# A cell's outcome is the place in this tuple.
OUTCOMES = ("settles", "cycles", "depends", "undecided")
FIGURES = ("period", "pv_peak_to_peak", "mean_square_error", "travel_per_hour", "window")  # of a cell


@dataclass(frozen=True, slots=True)
class MapCell:
    """One tuning of a map, in the controller's own form, and what it does: units as in `LimitCycleStart`.

    linear_stable: whether the loop is stable with an ideal valve. nan where no start cycles.
    """

    Kc: float
    value: float
    outcome: str
    period: float
    pv_peak_to_peak: float
    mean_square_error: float
    travel_per_hour: float
    window: float
    linear_stable: bool


@dataclass(frozen=True, eq=False)
class CycleMap(Shown):
    """The long-run behaviour of a loop over a plane of tunings, each found by exact noise-free simulation.

    axis: "Ti" or "Td", what the rows are; Kc (%/EU, shape (M,)) the columns, rising in even ratios; `values` (s, shape
    (R,)) the rows, rising: Ti in even ratios, Td in even steps; in the controller's own form. What is not an axis, the
    third parameter included, is `loop`'s. starts: how many starts each cell was followed from.

    All else has shape (R, M). outcome: place in `OUTCOMES`. period (s), pv_peak_to_peak (EU), mean_square_error (EU^2),
    travel_per_hour (%), window (s, to see the cycle): medians over the starts that cycle, nan where none does.
    linear_stable: whether the loop with an ideal valve is stable.
    crossing: factor on the controller's gain from which on L(jw) meets -1/N(A): up to 1 the describing function sees a
    crossing, inf where no factor makes one, nan where it was not computed (parallel form). loop_gain: Kc K J/S of the
    ideal form, and lag_ratio: Ti/(tau + theta): below 1 and above 1 lies the relaxation cycle that the describing
    function does not see; nan where that means nothing, on integrating plants and for valves without slip jump.
    """

    loop: Loop
    axis: str
    Kc: FloatArray
    values: FloatArray
    starts: int
    outcome: NDArray[np.int8]
    period: FloatArray
    pv_peak_to_peak: FloatArray
    mean_square_error: FloatArray
    travel_per_hour: FloatArray
    window: FloatArray
    linear_stable: NDArray[np.bool_]
    crossing: FloatArray
    loop_gain: FloatArray
    lag_ratio: FloatArray

    @property
    def cycles(self) -> NDArray[np.bool_]:
        """Cells that cycle from one start at least, shape (R, M)."""
        held: NDArray[np.bool_] = np.isin(self.outcome, (OUTCOMES.index("cycles"), OUTCOMES.index("depends")))
        return held

    def count(self, outcome: str) -> int:
        """Return how many cells whose loop is stable with an ideal valve have that outcome."""
        choice(outcome, "outcome", OUTCOMES)
        return int(np.count_nonzero((self.outcome == OUTCOMES.index(outcome)) & self.linear_stable))

    def least(self, figure: str) -> MapCell | None:
        """Return the cell of least `figure` ("pv_peak_to_peak" ...) among stable ones that cycle from every start."""
        choice(figure, "figure", FIGURES)
        values = np.where(
            (self.outcome == OUTCOMES.index("cycles")) & self.linear_stable, getattr(self, figure), math.nan
        )
        if np.isnan(values).all():
            return None
        row, column = np.unravel_index(int(np.nanargmin(values)), values.shape)
        return self._cell(int(row), int(column))

    def contains(self, Kc: float, value: float) -> bool:
        """Return whether a tuning lies within the map."""
        Kc, value = number(Kc, "Kc", infinite=True), number(value, self.axis, infinite=True)
        inside = self.Kc[0] <= Kc <= self.Kc[-1] and self.values[0] <= value <= self.values[-1]
        return bool(inside)

    def at(self, Kc: float, value: float) -> MapCell | None:
        """Return the cell nearest to a tuning, or None for one outside the map."""
        if not self.contains(Kc, value):
            return None
        column = int(np.abs(np.log(self.Kc / Kc)).argmin())
        away = np.log(self.values / value) if self.axis == "Ti" else self.values - value
        return self._cell(int(np.abs(away).argmin()), column)

    def _cell(self, row: int, column: int) -> MapCell:
        at = row, column
        return MapCell(
            Kc=float(self.Kc[column]),
            value=float(self.values[row]),
            outcome=OUTCOMES[int(self.outcome[at])],
            period=float(self.period[at]),
            pv_peak_to_peak=float(self.pv_peak_to_peak[at]),
            mean_square_error=float(self.mean_square_error[at]),
            travel_per_hour=float(self.travel_per_hour[at]),
            window=float(self.window[at]),
            linear_stable=bool(self.linear_stable[at]),
        )
