"""How a solve ended: the one vocabulary for every solver in the project."""

from __future__ import annotations

from enum import Enum

__all__ = ["SolveStatus"]


class SolveStatus(Enum):
    """How a solve ended."""

    SOLVED = "solved"  # to the tolerances asked for and, for a tuning, verified by exact re-simulation
    ACCEPTABLE = "solved to acceptable tolerances"
    INFEASIBLE = "infeasible"
    ITERATION_LIMIT = "iteration limit"
    TIME_LIMIT = "time limit"
    DIVERGED = "diverged"
    FAILED = "failed"
    EVALUATION_LIMIT = "evaluation limit"
    UNVERIFIED = "not verified by exact re-simulation"
    INTERRUPTED = "interrupted"

    @property
    def success(self) -> bool:
        """Whether the result may be used as a solution."""
        return self in (SolveStatus.SOLVED, SolveStatus.ACCEPTABLE)
