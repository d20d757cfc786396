"""The trade-off between error and valve travel: `wb.pareto_front` makes a `Front`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from workbench.model.controller import PID
from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.loop import Loop
from workbench.model.results import SolveStatus
from workbench.model.tuning import Bounds

__all__ = ["Front", "FrontPoint"]


@dataclass(frozen=True, slots=True)
class FrontPoint:
    """One tuning of a front, at the digits to type in, and its means over the front's fresh draws.

    valve_travel: % in the ensemble's duration; mean_square_error: EU^2.
    """

    controller: PID
    valve_travel: float
    mean_square_error: float


@dataclass(frozen=True, eq=False)
class Front:
    """Tunings of which none has both less error and less valve travel than another, over an ensemble.

    sticky: for the loop's own valve; repaired: for an ideal valve in its place (empty where the loop's own does not
    stick, or the search did not come that far). Both sorted by travel, rising, so that the error falls. ensemble: what
    was searched in; fresh: its draws that no search has seen, on which every figure is measured and dominated points
    are dropped. constraints hold for every point, at the worst corner of the plant's uncertainty. digits: significant
    ones of each parameter. status: `SOLVED`, `TIME_LIMIT` or `INTERRUPTED` (what was found till then), or `INFEASIBLE`
    where no tuning within the bounds keeps the constraints.
    """

    loop: Loop
    ensemble: Ensemble
    fresh: Ensemble
    constraints: Constraints
    bounds: Bounds
    digits: int
    sticky: tuple[FrontPoint, ...]
    repaired: tuple[FrontPoint, ...]
    status: SolveStatus
    message: str
    seed: int
    evaluations: int
    wall_time: float

    def at(self, valve_travel: float, *, repaired: bool = False) -> FrontPoint | None:
        """Return the point of least error whose mean travel is at most `valve_travel` (%), or None."""
        points: Iterator[FrontPoint] = reversed(self.repaired if repaired else self.sticky)
        return next((point for point in points if point.valve_travel <= valve_travel), None)
