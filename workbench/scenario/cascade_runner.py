"""Carries the scenario of a cascade out: tuning in turn, the runs, their long runs, and what each loop shows alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from workbench.analyze.cascade import cascade_cycle
from workbench.detect.detect import detect
from workbench.errors import InvalidValue, ScenarioError, WorkbenchError
from workbench.model.cascade import Cascade, CascadeRun, CascadeTuned
from workbench.model.controller import PID
from workbench.model.detection import Detection
from workbench.model.experiment import Experiment
from workbench.model.record import Record
from workbench.model.results import SolveStatus
from workbench.model.site import CascadeSite, CascadeSiteCase, SiteSettings
from workbench.model.study import CascadeResult, Study
from workbench.model.tuning import Objective
from workbench.scenario.plan import CascadeJob, CascadeTuneJob, Scenario
from workbench.scenario.site_cases import typed_settings
from workbench.simulate.run import simulate
from workbench.tune.cascade import evaluate_cascade, tune_cascade

__all__ = ["cascade_study", "tune_job"]

# Shares of the whole by which progress is told; samples of a late record that detection looks at.
RUN, TUNE = 1.0, 12.0
SHOWN = 1500


def cascade_study(plan: Scenario, progress: Callable[[str, float], None] | None) -> Study:
    """Return the study of a cascade's scenario; see `run_scenario`."""
    experiment = plan.experiment
    if experiment is None:
        raise ScenarioError(f"{plan.path}: experiment: missing; needed to simulate")
    total = sum(RUN + (0.0 if job.tune is None else TUNE) for job in plan.cascade)
    results: list[CascadeResult] = []
    times: dict[str, float] = {}
    done = 0.0

    def tell(words: str, share: float) -> None:
        if progress is not None:
            progress(words, (done + share) / total)

    for job in plan.cascade:
        began = time.perf_counter()
        try:
            results.append(_result(plan, job, experiment, tell))
        except ScenarioError:
            raise
        except WorkbenchError as error:
            raise ScenarioError(f"{plan.path}:{job.where}: {error}") from error
        times[job.name] = time.perf_counter() - began
        done += RUN + (0.0 if job.tune is None else TUNE)
    tell("done", 0.0)
    return Study(
        name=plan.name,
        title=plan.title,
        description=plan.description,
        scenario_text=plan.text,
        experiment=experiment,
        objective=plan.objective,
        estimates=(),
        cases=(),
        reference_source=plan.reference_source,
        notes=(*plan.warnings, *plan.notes),
        cascade=tuple(results),
        cascade_site=plan.cascade_site,
        cascade_site_cases=()
        if plan.cascade_site is None
        else tuple(_typed(plan.cascade_site, result, plan.objective) for result in results),
        times=times,
    )


def _result(
    plan: Scenario, job: CascadeJob, experiment: Experiment, tell: Callable[[str, float], None]
) -> CascadeResult:
    cascade, tuned, asked = job.cascade, None, job.tune
    tell(job.name, 0.0)
    if asked is not None:
        tuned = tune_job(cascade, experiment, asked, partial(_told, tell, job.name))
        if tuned.primary.status is SolveStatus.INTERRUPTED:
            raise KeyboardInterrupt
        cascade = tuned.cascade
    # A diverging cascade overflows; its figures say so.
    with np.errstate(over="ignore", invalid="ignore"):
        run = simulate(cascade, experiment)
        cost = None if plan.objective is None else evaluate_cascade(cascade, experiment, plan.objective)
    cycle = cascade_cycle(cascade, experiment) if plan.limit_cycle else None
    seen = None
    if cycle is not None and cycle.outcome == "cycles" and cycle.late is not None:
        seen = alone(cycle.late)
    return CascadeResult(job.name, run, cost, cycle, seen, tuned, job.note)


def _told(tell: Callable[[str, float], None], name: str, words: str, share: float) -> None:
    tell(f"tune {name}: {words}", TUNE * share)


def tune_job(
    cascade: Cascade, experiment: Experiment, asked: CascadeTuneJob, progress: Callable[[str, float], None]
) -> CascadeTuned:
    """Return the tuning in turn that a case asks for. Raises `WorkbenchError`."""
    inner = asked.secondary or (None, None, None)
    return tune_cascade(
        cascade,
        experiment,
        asked.objective,
        asked.bounds,
        asked.seed,
        secondary_experiment=inner[0],
        secondary_objective=inner[1],
        secondary_bounds=inner[2],
        restarts=asked.restarts,
        digits=asked.digits,
        progress=progress,
    )


def _typed(site: CascadeSite, case: CascadeResult, objective: Objective | None) -> CascadeSiteCase:
    """Return a case as the site writes it, with what exactly these rounded settings give in its experiment."""
    cascade, experiment = case.run.cascade, case.run.experiment
    made: dict[str, SiteSettings] = {}
    for name in ("primary", "secondary"):
        form, tuned = getattr(site, name), None if case.tuned is None else getattr(case.tuned, name)
        controller: PID = getattr(cascade, name).controller
        try:
            made[name] = typed_settings(form, controller, None if tuned is None else tuned.digits)
        except InvalidValue as error:
            refused = f"the {name}'s {error.given}: {error.allowed}"
            return CascadeSiteCase(case.name, None, None, refused=refused)
    one, two = made["primary"], made["secondary"]
    typed = cascade.with_controllers(one.controller, two.controller)
    if typed == cascade:
        return CascadeSiteCase(case.name, one, two, (case.run.primary.kpis, case.run.secondary.kpis), case.objective)
    with np.errstate(over="ignore", invalid="ignore"):
        run = simulate(typed, experiment)
        cost = None if objective is None else evaluate_cascade(typed, experiment, objective)
    return CascadeSiteCase(case.name, one, two, (run.primary.kpis, run.secondary.kpis), cost)


def alone(late: CascadeRun) -> tuple[Detection, Detection]:
    """Return what the last samples of each loop show of stiction to one who sees that loop alone, without its stem."""
    part = slice(-SHOWN, None)
    Ts = late.cascade.secondary.sample_time
    first, second = (
        detect(Record(pv=run.pv[part], op=run.op[part], sp=run.sp[part], sample_time=Ts))
        for run in (late.primary, late.secondary)
    )
    return first, second
