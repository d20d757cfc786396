"""`run_scenario`: carries a checked scenario out, from estimate to tuning, and gathers the study for its report."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from workbench.analyze.agreement import agreement
from workbench.analyze.chance import by_chance
from workbench.analyze.cycle_map import cycle_map, map_ranges
from workbench.analyze.describing_function import describing_function
from workbench.analyze.limit_cycle import limit_cycle
from workbench.analyze.standing import standing
from workbench.analyze.valve_loci import no_locus
from workbench.errors import ScenarioError, WorkbenchError
from workbench.model.checks import callback, instance
from workbench.model.controller import PID
from workbench.model.cycle_map import CycleMap
from workbench.model.detection import Detection
from workbench.model.experiment import Experiment
from workbench.model.front import RobustRepair
from workbench.model.loop import Loop
from workbench.model.numbers import given
from workbench.model.plant import Plant
from workbench.model.record import Record
from workbench.model.results import Intervals, Outcome, Repair, SolveStatus, Tuned
from workbench.model.study import CaseResult, NamedEstimate, Study
from workbench.model.tuning import Objective
from workbench.scenario.controllers import fitting_action, ruled, wrong_way
from workbench.scenario.loader import load_scenario
from workbench.scenario.over_ensemble import best_robust, front_of, widest, with_robustness
from workbench.scenario.plan import CaseJob, EstimateJob, MapJob, Scenario, TuneJob
from workbench.scenario.robust import constraints_of
from workbench.scenario.site_cases import nearest_controllers, same_numbers, site_cases, typed_controller
from workbench.simulate.run import evaluate, simulate
from workbench.tune.front import alike
from workbench.tune.repair import outcome, repair_over, repaired_outcome, usual_bounds, value_of_repair
from workbench.tune.tune import tune

__all__ = ["Progress", "for_plant", "run_scenario", "simulated_record", "tune_case"]

Progress = Callable[[str, float], None]

# Shares of the whole by which progress is told; a tuning takes the time of many simulations.
_SHARE = {"estimate": 3.0, "case": 1.0, "tune": 8.0, "map": 8.0}


def run_scenario(scenario: Scenario | str | os.PathLike[str], *, progress: Progress | None = None) -> Study:
    """Run a scenario, given as loaded or as its file's path, and return its `Study`.

    Estimates first; the loop is the scenario's, or the first estimate's; each case is given, made by its rule or tuned,
    simulated exactly, and analysed (describing function, limit cycle and whether they agree), and where the scenario
    has an ensemble, measured over it; last, where asked for, the trade-off of error and valve travel, the map of a
    plane of tunings, and what repairing the valve is worth. progress: called with a few words and the share done, 0..1.
    A tuning that did not succeed stays in the study with its status. Raises `ScenarioError` for a scenario that is
    refused, and with the entry named where running shows that it cannot be carried out; `KeyboardInterrupt` where a
    tuning was interrupted.
    """
    instance(scenario, (Scenario, str, os.PathLike), "scenario", "a Scenario or the path of a scenario file (YAML)")
    callback(progress, "run_scenario.progress")
    plan = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    if plan.cascade:
        from workbench.scenario.cascade_runner import cascade_study

        return cascade_study(plan, progress)
    return _Runner(plan, progress).study()


class _Runner:
    """One run: what is done, what it took."""

    def __init__(self, plan: Scenario, progress: Progress | None) -> None:
        self.plan = plan
        self.tell = progress
        self.times: dict[str, float] = {}
        self.detections: list[Detection] = []
        self.done = 0.0
        self.ranges: Intervals | None = None  # of the plant, where it is an estimate
        cases = sum(_SHARE["case"] + (_SHARE["tune"] if case.tune is not None else 0.0) for case in plan.cases)
        searches = 0.0
        if plan.repair:
            alone = [case for case in plan.cases if case.tune is not None and case.tune.robust is None]
            robust = any(case.tune is not None and case.tune.robust is not None for case in plan.cases)
            searches = (1.0 if alone else 2.0) + (1.0 if robust else 0.0)
        searches += 2.0 if plan.tradeoff else 0.0
        cases += _SHARE["map"] if plan.cycle_map is not None else 0.0
        cases += _SHARE["case"] if plan.ensemble is not None else 0.0
        self.total = cases + _SHARE["tune"] * searches + _SHARE["estimate"] * len(plan.estimates) or 1.0

    def study(self) -> Study:
        """Return the study."""
        plan = self.plan
        notes, mistakes = [*plan.notes], [*plan.mistakes]
        estimates = tuple(self._estimate(job) for job in plan.estimates)
        loop, jobs = plan.loop, plan.cases
        if loop is None and jobs:
            jobs, said, wrong = for_plant(jobs, estimates[0].found.plant)
            notes += said
            mistakes += wrong
            loop, self.ranges = self._found_loop(estimates[0], jobs[0]), estimates[0].found.intervals
            note = loop.sampling_note()
            if note is not None:
                notes.append(f"Coarse sampling: {note}.")
        cases: list[CaseResult] = []
        if loop is not None:
            for job in jobs:
                cases.append(self._case(job, loop, cases))
            cases += self._nearest(cases)
        if plan.ensemble is not None and cases:
            with self._stage("ensemble", "ensemble", _SHARE["case"]) as progress:
                cases = with_robustness(cases, plan.ensemble.of(cases[0].loop), plan.objective, progress)
        mapped = None
        if plan.cycle_map is not None and cases:
            with self._stage("map", "analyze.map", _SHARE["map"]) as progress:
                mapped = _map(plan.cycle_map, cases, partial(progress, ""))
        repair, robust_repair = None, None
        if plan.repair and cases:
            if cases[0].repaired is None:
                notes.append("The valve does not stick: there is nothing to repair.")
            else:
                repair = self._repair(cases)
                robust_repair = self._robust_repair(cases)
        front = None
        if plan.tradeoff and plan.ensemble is not None and cases:
            # The best tuning of the repaired valve must not lie below the front.
            also = () if robust_repair is None else (robust_repair.tuned_repaired.controller,)
            with self._stage("trade-off", "analyze.tradeoff", 2.0 * _SHARE["tune"]) as progress:
                front = front_of(cases, jobs, plan.ensemble.of(cases[0].loop), progress, also)
            if front.status is SolveStatus.INTERRUPTED:
                raise KeyboardInterrupt
        if self.tell is not None:
            self.tell("done", 1.0)
        return Study(
            name=plan.name,
            title=plan.title,
            description=plan.description,
            scenario_text=plan.text,
            experiment=plan.experiment,
            objective=plan.objective,
            estimates=estimates,
            cases=tuple(cases),
            reference_source=plan.reference_source,
            notes=tuple(notes),
            mistakes=tuple(mistakes),
            repair=repair,
            front=front,
            robust_repair=robust_repair,
            cycle_map=mapped,
            site=plan.site,
            site_cases=() if plan.site is None else site_cases(plan.site, cases, plan.objective),
            times=self.times,
        )

    def _found_loop(self, first: NamedEstimate, case: CaseJob) -> Loop:
        found = first.found
        return Loop(found.plant, found.valve, case.controller, found.record.sample_time, self.plan.pv_range)

    def _estimate(self, job: EstimateJob) -> NamedEstimate:
        from workbench.estimate.estimate import estimate  # compiled code that most scenarios do not need

        with self._stage(f"estimate {job.name}", job.where, _SHARE["estimate"]) as progress:
            record = job.record
            if record is None and job.truth is not None and job.experiment is not None:
                record = simulated_record(job.truth, job.experiment)
            if record is None:
                raise ScenarioError("no record to estimate from")
            found = estimate(
                record,
                method=job.method,
                valve=job.valve,
                plant=job.plant,
                start=job.start,
                progress=partial(progress, ""),
            )
            detection = self._detection(record)
        return NamedEstimate(job.name, found, job.truth, job.reference, job.note, detection)

    def _detection(self, record: Record) -> Detection:
        """Return the evidence in a record, once for estimates from the same one."""
        from workbench.detect.detect import detect

        for known in self.detections:
            if np.array_equal(known.record.pv, record.pv) and np.array_equal(known.record.op, record.op):
                return known
        found = detect(record, bicoherence=True)
        self.detections.append(found)
        return found

    def _case(self, job: CaseJob, base: Loop, above: Sequence[CaseResult], nearest_to: str = "") -> CaseResult:
        plan, experiment = self.plan, self.plan.experiment
        if experiment is None:
            raise ScenarioError(f"{plan.path}: experiment: missing; needed to simulate")
        loop, tuned = base.with_controller(job.controller), None
        if job.rule is not None:
            under = next((case.loop.controller for case in above if case.name == job.base), job.controller)
            with self._stage(f"rule {job.name}", job.where, 0.0):
                loop = loop.with_controller(ruled(base, under, job.rule))
        if job.tune is not None:
            controllers = {case.name: case.loop.controller for case in above}
            with self._stage(f"tune {job.name}", job.where, _SHARE["tune"]) as progress:
                tuned = tune_case(loop, experiment, job.tune, progress, controllers)
            if tuned.status is SolveStatus.INTERRUPTED:
                raise KeyboardInterrupt
            loop = loop.with_controller(tuned.controller)
        unrounded = None
        if not nearest_to:  # which is what is typed in
            loop, unrounded = self._as_typed_in(job, loop, tuned, above)
        with self._stage(job.name, job.where, _SHARE["case"]) as progress:
            # A diverging loop overflows; its figures say so.
            with np.errstate(over="ignore", invalid="ignore"):
                run = simulate(loop, experiment)
                cost = None if plan.objective is None else float(evaluate(loop, experiment, plan.objective)[0])
            # The method does not know a compensator, and has nothing to say of some valves.
            known = plan.describing_function and loop.controller.compensator is None and not no_locus(loop.valve)
            df = describing_function(loop) if known else None
            cycle = (
                limit_cycle(loop, experiment, progress=partial(progress, "limit cycle")) if plan.limit_cycle else None
            )
            sentence = agreement(df, cycle) if df is not None and cycle is not None else ""
            repaired = None
            if plan.repair and loop.valve.hold > 0.0:
                repaired = repaired_outcome(loop, experiment, plan.objective or Objective())
        return CaseResult(
            name=job.name,
            loop=loop,
            run=run,
            objective=cost,
            tuned=tuned,
            describing_function=df,
            limit_cycle=cycle,
            agreement=sentence,
            reference=job.reference,
            note=job.note,
            rule=job.rule,
            repaired=repaired,
            nearest_to=nearest_to,
            standing=standing(loop, self.ranges),
            unrounded=unrounded,
            chance=by_chance(loop, experiment, run.kpis) if tuned is None else (),
        )

    def _as_typed_in(
        self, job: CaseJob, loop: Loop, tuned: Tuned | None, above: Sequence[CaseResult]
    ) -> tuple[Loop, Outcome | None]:
        """Return a case's loop as the site types it in, and what it gave before, None where that rounds nothing.

        The case as found, the first that is given, is there already, and so are its settings where another case has
        them too: whatever the site's digits.
        """
        site, experiment = self.plan.site, self.plan.experiment
        first = next((case for case in above if case.tuned is None), None)
        if first is None and job.tune is None and job.rule is None:
            return loop, None
        there = first is not None and first.rule is None and same_numbers(first.loop.controller, loop.controller)
        if site is None or experiment is None or there:
            return loop, None
        typed = typed_controller(site, loop.controller, None if tuned is None else tuned.digits)
        if typed == loop.controller:
            return loop, None
        return loop.with_controller(typed), outcome(loop, experiment, self.plan.objective or Objective())

    def _nearest(self, cases: Sequence[CaseResult]) -> list[CaseResult]:
        """Return a case more for each that the site's form cannot take: what comes nearest to it there."""
        site, names = self.plan.site, {case.name for case in cases}
        found: list[CaseResult] = []
        for case, controller in [] if site is None else nearest_controllers(site, cases):
            name = f"{case.name}, nearest {controller.form}"
            while name in names:
                name += "'"
            names.add(name)
            job = CaseJob(name, f"case {name}", controller, note=f"What comes nearest to {case.name} at the site.")
            found.append(self._case(job, case.loop, cases, case.name))
        return found

    def _repair(self, cases: Sequence[CaseResult]) -> Repair:
        """Return what repair is worth to the first given case, from the best search that the cases have made."""
        plan, experiment = self.plan, cases[0].run.experiment
        present = next((case for case in cases if case.tuned is None), cases[0])
        # A robust tuning's objective is one over an ensemble, not of this experiment; the least J itself is no tuning.
        found = [case.tuned for case in cases if case.tuned is not None and case.tuned.ensemble is None]
        searches = [one for one in found if one.status.success and not one.nominal_only]
        if plan.objective is not None:
            searches = [one for one in searches if one.weights == plan.objective]
        best = min(searches, key=lambda one: one.objective, default=None)
        # A search of its own stays within what the scenario's tunings, such as robust ones, may set.
        pid = present.loop.controller
        asked = widest([j.tune.bounds for j in plan.cases if j.tune is not None and alike(j.controller, pid)])
        own = usual_bounds(pid, asked)
        with self._stage("value of repair", "analyze.repair", _SHARE["tune"] * (1.0 if searches else 2.0)) as progress:
            repair = value_of_repair(present.loop, experiment, plan.objective, own, tuned=best, progress=progress)
        if SolveStatus.INTERRUPTED in (repair.tuned.status, repair.tuned_repaired.status):
            raise KeyboardInterrupt
        # What the site types in is what the best tuning is elsewhere on the page.
        typed = next((case.loop for case in cases if case.tuned is repair.tuned and case.unrounded is not None), None)
        return repair if typed is None else replace(repair, best=outcome(typed, experiment, repair.weights))

    def _robust_repair(self, cases: Sequence[CaseResult]) -> RobustRepair | None:
        """Return what repair is worth over the ensemble of the best robust tuning, if there is one."""
        best = best_robust(cases)
        if best is None:
            return None
        present = next((case for case in cases if case.tuned is None), cases[0])
        with self._stage("value of repair over the ensemble", "analyze.repair", _SHARE["tune"]) as progress:
            found = repair_over(best, present.loop.controller, progress=progress)
        if found.tuned_repaired.status is SolveStatus.INTERRUPTED:
            raise KeyboardInterrupt
        return found

    @contextmanager
    def _stage(self, words: str, where: str, share: float) -> Iterator[Progress]:
        """Time one stage, tell its progress as a part of the whole, and name its entry in what goes wrong."""
        begun, done = time.perf_counter(), self.done

        def progress(inner: str, fraction: float) -> None:
            if self.tell is not None:
                text = f"{words}: {inner}" if inner else words
                # Cases that the site's form adds are not in the total.
                self.tell(text, min((done + share * min(max(fraction, 0.0), 1.0)) / self.total, 1.0))

        progress("", 0.0)
        try:
            yield progress
        except ScenarioError:
            raise
        except WorkbenchError as error:
            raise ScenarioError(f"{self.plan.path}:{where}: {error}") from error
        self.done = done + share
        self.times[words] = time.perf_counter() - begun


def for_plant(jobs: Sequence[CaseJob], plant: Plant) -> tuple[tuple[CaseJob, ...], list[str], list[str]]:
    """Return the cases with the controller action that an estimated gain needs where none is given, and notes on it.

    A given action stays; the last list says where it does not fit.
    """
    action = fitting_action(plant)
    notes: list[str] = []
    mistakes: list[str] = []
    fitted: list[CaseJob] = []
    for job in jobs:
        if not job.action_given and job.controller.action != action:
            job = replace(job, controller=replace(job.controller, action=action))
            gain = given(plant.gain, 3)
            note = f"The controller acts {action}, as the estimated gain ({gain}) needs; no action is given."
            notes += [] if note in notes else [note]
        wrong = wrong_way(plant, job.controller)
        if wrong is not None:
            mistakes.append(f"{job.name}: {wrong}.")
        fitted.append(job)
    return tuple(fitted), notes, mistakes


def _map(job: MapJob, cases: Sequence[CaseResult], progress: Callable[[float], None]) -> CycleMap:
    """Return the map that a job asks for, under the first case's controller."""
    loop = cases[0].loop
    Ti, Td = loop.controller.Ti if job.at_Ti is None else job.at_Ti, loop.controller.Td
    Td = Td if job.at_Td is None else job.at_Td
    loop = loop.with_controller(replace(loop.controller, Ti=Ti, Td=Td))
    axis = "Td" if job.Td is not None else "Ti"
    ranges = map_ranges(loop, [case.loop.controller for case in cases], axis=axis)
    for name in ranges:
        ranges[name] = getattr(job, name) or ranges[name]
    return cycle_map(loop, **ranges, points=job.points, starts=job.starts, progress=progress)


def simulated_record(loop: Loop, experiment: Experiment) -> Record:
    """Return what a historian would have kept of a simulated run: SP, PV and OP, without the stem."""
    run = simulate(loop, experiment)
    return Record(
        pv=run.pv, op=run.op, sample_time=loop.sample_time, sp=run.sp, source="simulated with the scenario's loop"
    )


def tune_case(
    loop: Loop,
    experiment: Experiment,
    job: TuneJob,
    progress: Progress | None,
    cases: Mapping[str, PID] | None = None,
) -> Tuned:
    """Return the tuning that a case asks for, started from the loop's controller.

    cases: the controllers of the cases above it, by name, of which one may give the budget of valve travel.
    """
    ensemble, constraints = None, job.constraints
    if job.robust is not None:
        ensemble = job.robust.ensemble.of(loop)
        constraints = constraints_of(job, loop, ensemble, cases or {})
    return tune(
        loop,
        experiment,
        job.objective,
        job.bounds,
        job.seed,
        digits=job.digits,
        restarts=job.restarts,
        nominal=job.nominal,
        robust=ensemble or False,
        constraints=constraints,
        progress=progress,
    )
