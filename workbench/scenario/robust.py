"""Robust tunings of a scenario: from their entries in the file to what is asked, and that applied to a loop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from workbench.model.controller import PID
from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.loop import Loop
from workbench.scenario import schema
from workbench.scenario.document import Path
from workbench.scenario.plan import CaseJob, EnsembleJob, RobustJob, TuneJob
from workbench.scenario.refusals import Refusals
from workbench.scenario.robust_entries import CaseTravel, ConstraintsEntry, EnsembleEntry
from workbench.simulate.signals import sample_count

__all__ = ["RobustEntries", "constraints_of", "measured_in"]

PAIRS = ("setpoint", "load", "load_time", "noise")


@dataclass(frozen=True)
class RobustEntries:
    """Reads them; what is refused goes to `refusals`. loop: None where plant or valve come from an estimate."""

    refusals: Refusals
    loop: Loop | None

    def ensemble(self, given: EnsembleEntry, path: Path, shared: EnsembleJob | None = None) -> EnsembleJob | None:
        """Return the ensemble of an entry; what it leaves out is as in `shared`, else as in the default."""
        own: dict[str, Any] = {name: getattr(given, name) for name in given.model_fields_set}
        own = {k: tuple(v) if k in PAIRS else v for k, v in own.items() if v is not None}
        job = EnsembleJob({**(shared.given if shared is not None else {}), **own})
        if self.loop is None:
            # Without the loop its defaults are not known; what the fields allow by themselves is.
            whole = {"duration": max((1.0, *own.get("load_time", ()))), **own}
            return job if self.refusals.attempt(path, lambda: Ensemble(**whole)) is not None else None
        made = self.refusals.attempt(path, partial(job.of, self.loop))
        if made is None:
            return None
        sample_time = self.loop.sample_time
        samples = self.refusals.attempt((*path, "duration"), lambda: sample_count(made.duration, sample_time))
        return None if samples is None else job

    def tuning(
        self, given: schema.Tune, path: Path, shared: EnsembleJob | None, above: Iterable[str]
    ) -> RobustJob | None:
        """Return what a tuning asks of robustness, None where nothing. above: the names of the cases above it."""
        budget = given.travel_budget
        if given.robust is None:
            if budget is not None:
                what = "given without robust; it holds over an ensemble: robust: true (or constraints.valve_travel)"
                self.refusals.refuse((*path, "travel_budget"), what)
            return None
        if given.nominal:
            what = "true given, and robust as well; an ensemble has no nominal run"
            self.refusals.refuse((*path, "nominal"), what)
        ensemble = self.ensemble(given.robust, (*path, "robust"), shared)
        if budget is not None and given.constraints is not None and given.constraints.valve_travel is not None:
            self.refusals.refuse(
                (*path, "travel_budget"), "given, and constraints.valve_travel as well; one of the two is needed"
            )
        names = tuple(above)
        if isinstance(budget, CaseTravel) and budget.case.strip() not in names:
            listed = ", ".join(names) or "there is none"
            what = f"{budget.case.strip()!r} given; must be the name of a case above this one ({listed})"
            self.refusals.refuse((*path, "travel_budget", "case"), what)
        if ensemble is None:
            return None
        as_case = budget.case.strip() if isinstance(budget, CaseTravel) else ""
        most = None if budget is None or isinstance(budget, CaseTravel) else budget
        return RobustJob(ensemble, most, as_case)

    def constraints(self, given: ConstraintsEntry | None, path: Path) -> Constraints | None:
        """Return the constraints of an entry; None where it is not given."""
        if given is None:
            return None
        fields = {name: getattr(given, name) for name in given.model_fields_set}
        return self.refusals.attempt(path, lambda: Constraints(**fields))


def measured_in(cases: Sequence[CaseJob], *, tradeoff: bool) -> EnsembleJob | None:
    """Return what the cases are measured in where the file gives no common ensemble: the first robust tuning's."""
    asked = [case.tune.robust for case in cases if case.tune is not None]
    first = next((one.ensemble for one in asked if one is not None), None)
    return first or (EnsembleJob() if tradeoff else None)


def constraints_of(job: TuneJob, loop: Loop, ensemble: Ensemble, cases: Mapping[str, PID]) -> Constraints | None:
    """Return a robust tuning's constraints, its travel budget among them; None for the default.

    cases: the controllers of the cases above; that of `as_case` gives the budget by its own mean travel over the
    ensemble.
    """
    budget = None if job.robust is None else job.robust.travel_budget
    if job.robust is not None and job.robust.as_case:
        from workbench.tune.ensemble import assess  # numba: only where a scenario is run

        budget = assess(loop.with_controller(cases[job.robust.as_case]), ensemble).travel_mean
    if budget is None:
        return job.constraints
    from workbench.tune.robust import DEFAULT_CONSTRAINTS

    return replace(job.constraints or DEFAULT_CONSTRAINTS, valve_travel=budget)
