"""Carries the scenario of a cascade out: tuning in turn, the runs, their long runs, and what each loop shows alone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from workbench.analyze.cascade import cascade_cycle
from workbench.detect.detect import detect
from workbench.errors import InvalidValue, ScenarioError, WorkbenchError
from workbench.model.cascade import Cascade, CascadeRun, CascadeTuned
from workbench.model.controller import PID
from workbench.model.detection import Detection
from workbench.model.experiment import Experiment
from workbench.model.record import FloatArray, Record
from workbench.model.results import SolveStatus, Tuned
from workbench.model.site import Beside, CascadeSite, CascadeSiteCase, SiteSettings
from workbench.model.study import CascadeResult, Study
from workbench.model.tuning import Bounds, Objective
from workbench.scenario.plan import RULE_DIGITS, CascadeJob, CascadeTuneJob, Scenario
from workbench.scenario.site_cases import (
    MARGIN,
    alike,
    last_digits,
    last_steps,
    neighbours,
    same_numbers,
    typed_controller,
    typed_settings,
)
from workbench.simulate.run import simulate
from workbench.tune.cascade import CascadeProblem, evaluate_cascade, tune_cascade
from workbench.tune.problem import last_offsets

__all__ = ["cascade_study", "tune_job"]

# Shares of the whole by which progress is told; samples of a late record that detection looks at.
RUN, TUNE = 1.0, 12.0
SHOWN = 1500
BESIDE = 40  # settings of each controller beside those typed in, each of one with each of the other
PARTS = ("primary", "secondary")


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
            found = next((case.run.cascade for case in results if case.tuned is None), None)
            results.append(_result(plan, job, experiment, tell, found))
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
        notes=plan.notes,
        mistakes=plan.mistakes,
        cascade=tuple(results),
        cascade_site=plan.cascade_site,
        cascade_site_cases=()
        if plan.cascade_site is None
        else tuple(_typed(plan.cascade_site, result, plan.objective) for result in results),
        times=times,
    )


def _result(
    plan: Scenario,
    job: CascadeJob,
    experiment: Experiment,
    tell: Callable[[str, float], None],
    found: Cascade | None,
) -> CascadeResult:
    """Return a case, of what the site types in; found: the first that is given, which is there already."""
    cascade, tuned, asked, unrounded = job.cascade, None, job.tune, None
    tell(job.name, 0.0)
    if asked is not None:
        tuned = tune_job(cascade, experiment, asked, partial(_told, tell, job.name))
        if tuned.primary.status is SolveStatus.INTERRUPTED:
            raise KeyboardInterrupt
        cascade = tuned.cascade
    if plan.cascade_site is not None and (found is not None or tuned is not None):
        typed = _as_typed_in(plan.cascade_site, cascade, tuned, found)
        if typed != cascade:
            unrounded = CascadeResult(job.name, *_run(cascade, experiment, plan.objective), tuned=tuned)
            cascade = typed
    run, cost = _run(cascade, experiment, plan.objective)
    cycle = cascade_cycle(cascade, experiment) if plan.limit_cycle else None
    seen = None
    if cycle is not None and cycle.outcome == "cycles" and cycle.late is not None:
        seen = alone(cycle.late)
    return CascadeResult(job.name, run, cost, cycle, seen, tuned, job.note, unrounded)


def _run(cascade: Cascade, experiment: Experiment, objective: Objective | None) -> tuple[CascadeRun, float | None]:
    # A diverging cascade overflows; its figures say so.
    with np.errstate(over="ignore", invalid="ignore"):
        run = simulate(cascade, experiment)
        return run, None if objective is None else evaluate_cascade(cascade, experiment, objective)


def _digits(tuned: CascadeTuned | None, which: str) -> int | None:
    one: Tuned | None = None if tuned is None else getattr(tuned, which)
    return None if one is None else one.digits


def _as_typed_in(site: CascadeSite, cascade: Cascade, tuned: CascadeTuned | None, found: Cascade | None) -> Cascade:
    """Return a cascade under what is typed in, itself where the site's form cannot take both of its controllers.

    found: the cascade as found, whose controllers stay as they are.
    """
    made: dict[str, PID] = {}
    for which in PARTS:
        form, controller, digits = getattr(site, which), getattr(cascade, which).controller, _digits(tuned, which)
        try:
            form.settings(controller)
        except InvalidValue:
            return cascade
        there = found is not None and same_numbers(getattr(found, which).controller, controller)
        made[which] = controller if there else typed_controller(form, controller, digits)
    return cascade.with_controllers(**made)


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
    for name in PARTS:
        controller: PID = getattr(cascade, name).controller
        try:
            made[name] = typed_settings(getattr(site, name), controller, _digits(case.tuned, name))
        except InvalidValue as error:
            refused = f"the {name}'s {error.given}: {error.allowed}"
            return CascadeSiteCase(case.name, None, None, refused=refused)
    one, two = made["primary"], made["secondary"]
    typed = cascade.with_controllers(one.controller, two.controller)
    run, cost = case.run, case.objective
    if not all(alike(made[name].controller, getattr(cascade, name).controller) for name in PARTS):
        run, cost = _run(typed, experiment, objective)
    beside = _beside(site, made, case, objective)
    return CascadeSiteCase(case.name, one, two, (run.primary.kpis, run.secondary.kpis), cost, beside=beside)


def _beside(
    site: CascadeSite, made: Mapping[str, SiteSettings], case: CascadeResult, objective: Objective | None
) -> Beside:
    """Return what settings of both controllers beside those typed in give."""
    cascade, experiment = case.run.cascade, case.run.experiment
    tuned = None if case.tuned is None else case.tuned.primary
    margin, weights = MARGIN if tuned is None else tuned.margin, objective or Objective.of(mean_square_error=1.0)
    digits = {n: last_digits(getattr(site, n), getattr(cascade, n).controller, _digits(case.tuned, n)) for n in PARTS}
    offsets = last_offsets(case.run.primary.pv.size)[:BESIDE]
    near, steps = {}, {}
    for name in PARTS:
        form = getattr(site, name)
        near[name] = neighbours(form, made[name], margin, digits[name], offsets)
        steps[name] = last_steps(form, made[name], digits[name])
    one, two = made["primary"].controller, made["secondary"].controller

    def costs(primaries: Sequence[PID], secondary: PID) -> FloatArray:
        over = cascade.with_controllers(one, secondary)
        problem = CascadeProblem(over, experiment, weights, Bounds(), RULE_DIGITS, margin)
        return problem.exact(np.array([(pid.Kc, pid.Ti, pid.Td) for pid in primaries]))

    around = np.array([costs(near["primary"], pid) for pid in near["secondary"]])
    below, above = divmod(int(np.argmax(around)), around.shape[1])
    worst = cascade.with_controllers(near["primary"][above], near["secondary"][below])
    run, _ = _run(worst, experiment, None)
    last = [costs(steps["primary"], two)] if steps["primary"] else []
    last += [costs([one], pid) for pid in steps["secondary"]]
    return Beside(
        margin,
        digits["primary"] or digits["secondary"],
        float(around.max()),
        run.primary.kpis,
        float(np.concatenate(last).max()) if last else math.nan,
        run.secondary.kpis,
    )


def alone(late: CascadeRun) -> tuple[Detection, Detection]:
    """Return what the last samples of each loop show of stiction to one who sees that loop alone, without its stem."""
    part = slice(-SHOWN, None)
    Ts = late.cascade.secondary.sample_time
    first, second = (
        detect(Record(pv=run.pv[part], op=run.op[part], sp=run.sp[part], sample_time=Ts))
        for run in (late.primary, late.secondary)
    )
    return first, second
