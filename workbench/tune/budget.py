"""What a search may spend, and how it says where it is: its time limit, its samples, and its progress."""

from __future__ import annotations

import time
from collections.abc import Callable

from workbench.model.results import SolveStatus
from workbench.tune.problem import Problem

__all__ = ["STOPPED", "OutOfBudget", "Progress", "deadline", "stopper"]

# Called with a phase in words and the share done (0..1).
Progress = Callable[[str, float], None]

# What a message says of a search that Ctrl-C ended.
STOPPED = "stopped by the user; the best so far"


class OutOfBudget(Exception):
    """A limit has been reached, raised by a search's `stop`: how the search then ends, and which limit it was."""

    def __init__(self, status: SolveStatus, limit: str) -> None:
        super().__init__(limit)
        self.status = status


def deadline(began: float, time_limit: float | None) -> Callable[[], None]:
    """Return what raises `OutOfBudget` later than `time_limit` s, if there is one, after `began` (perf_counter, s)."""

    def check() -> None:
        if time_limit is not None and time.perf_counter() - began > time_limit:
            raise OutOfBudget(SolveStatus.TIME_LIMIT, f"the time limit of {time_limit:g} s")

    return check


def stopper(problem: Problem, most: int, check: Callable[[], None]) -> Callable[[], bool]:
    """Return the question whether more than `most` samples have been simulated; it also looks at the time."""

    def stop() -> bool:
        check()
        return problem.work.simulated > most

    return stop
