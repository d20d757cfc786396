"""Over an ensemble: the trade-off of error and valve travel, and what repairing the valve is worth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from workbench.model.controller import PID
from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.loop import Loop
from workbench.model.results import Robustness, SolveStatus, Tuned
from workbench.model.show import Shown
from workbench.model.tuning import Bounds

__all__ = ["Front", "FrontPoint", "RobustRepair"]


@dataclass(frozen=True, slots=True)
class FrontPoint:
    """One tuning of a front, at the digits to type in, and its means over the front's fresh draws.

    valve_travel: % in the ensemble's duration; mean_square_error: EU^2.
    """

    controller: PID
    valve_travel: float
    mean_square_error: float


@dataclass(frozen=True, eq=False)
class Front(Shown):
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


@dataclass(frozen=True, eq=False)
class RobustRepair(Shown):
    """What repairing the valve is worth over an ensemble, all on the same fresh draws.

    present and repaired: the present tuning with the sticky and with an ideal valve; best and best_repaired: the best
    robust tuning of each under the same objective, constraints and bounds; `tuned` and `tuned_repaired` say how they
    were found.
    """

    present: Robustness
    repaired: Robustness
    best: Robustness
    best_repaired: Robustness
    tuned: Tuned
    tuned_repaired: Tuned

    @property
    def share(self) -> float:
        """The share of the best tuning's mean square error that goes only with the repair; nan where it has none."""
        left = self.best.mse_mean
        return max(0.0, 1.0 - self.best_repaired.mse_mean / left) if left > 0.0 else math.nan
