"""What a scenario shows over an ensemble: every case on the same fresh draws, the trade-off, the value of repair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from workbench.model.controller import PID
from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.front import Front
from workbench.model.results import Tuned
from workbench.model.study import CaseResult
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Ideal
from workbench.scenario.plan import CaseJob
from workbench.tune.ensemble import Circumstances, measured
from workbench.tune.front import alike, pareto_front
from workbench.tune.robust import fresh_draws

__all__ = ["best_robust", "front_of", "widest", "with_robustness"]

Progress = Callable[[str, float], None]


def with_robustness(
    cases: Sequence[CaseResult], ensemble: Ensemble, objective: Objective | None, progress: Progress
) -> list[CaseResult]:
    """Return the cases with their figures on fresh draws of the ensemble, sticky and repaired."""
    loop = cases[0].loop
    fresh = fresh_draws(ensemble, loop.sample_time)
    weights = objective or Objective()
    sticky = Circumstances(loop, fresh)
    repaired = None if isinstance(loop.valve, Ideal) else Circumstances(replace(loop, valve=Ideal()), fresh)
    found = []
    for i, case in enumerate(cases):
        progress("fresh draws", i / len(cases))
        pid = case.loop.controller
        own = measured(sticky.under(pid), weights)
        other = None if repaired is None else measured(repaired.under(pid), weights)
        found.append(replace(case, robustness=own, robustness_repaired=other))
    return found


def front_of(
    cases: Sequence[CaseResult],
    jobs: Sequence[CaseJob],
    ensemble: Ensemble,
    progress: Progress,
    also: Sequence[PID] = (),
) -> Front:
    """Return the trade-off in the widest bounds of the robust tunings, under the first one's other wishes.

    also: controllers beside those of the cases that must not lie below it. Without any robust tuning: under the first
    case's controller, in the bounds and constraints that `pareto_front` takes itself.
    """
    robust = [job for job in jobs if job.tune is not None and job.tune.robust is not None]
    present = cases[0].loop
    first = robust[0] if robust else None
    pid, seed, digits = present.controller, 0, 4
    bounds: Bounds | None = None
    constraints: Constraints | None = None
    if first is not None and first.tune is not None and first.tune.robust is not None:
        pid = first.controller
        seed, digits = first.tune.seed, first.tune.digits or digits
        asked = first.tune.constraints
        # A budget is one place on the front, not its end.
        constraints = None if asked is None else replace(asked, valve_travel=None)
        bounds = widest([job.tune.bounds for job in robust if job.tune is not None and alike(job.controller, pid)])
    return pareto_front(
        present.with_controller(pid),
        ensemble,
        constraints,
        bounds,
        known=[*(case.loop.controller for case in cases), *also],
        seed=seed,
        digits=digits,
        progress=progress,
    )


def widest(bounds: Sequence[Bounds]) -> Bounds | None:
    """Return bounds that hold all of these, None without any."""

    def hull(name: str) -> tuple[float, float]:
        pairs = [getattr(one, name) for one in bounds]
        return min(low for low, _ in pairs), max(high for _, high in pairs)

    return Bounds(hull("Kc"), hull("Ti"), hull("Td")) if bounds else None


def best_robust(cases: Sequence[CaseResult]) -> Tuned | None:
    """Return the robust tuning, found and without a cap on travel if there is one, of least mean square error."""
    found = [c.tuned for c in cases if c.tuned is not None and c.tuned.robustness is not None]
    found = [one for one in found if one.status.success]
    free = [one for one in found if one.constraints is None or one.constraints.valve_travel is None]

    def error(one: Tuned) -> float:
        return one.robustness.mse_mean if one.robustness is not None else 0.0

    return min(free or found, key=error, default=None)
