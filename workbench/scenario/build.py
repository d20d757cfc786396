"""From the file as written (`schema`) to the model's values (`plan`), with every refusal under its entry's path."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path as FilePath

from workbench.detect.causes import FEWEST_SAMPLES
from workbench.errors import InvalidValue, RecordError
from workbench.estimate.fits.data import PURPOSE, refuse_unfit
from workbench.model.controller import PID
from workbench.model.estimation import MOST_IN_PROGRAM
from workbench.model.experiment import Experiment, Series
from workbench.model.loop import Loop
from workbench.model.plant import Plant
from workbench.model.record import Record
from workbench.model.rule import Rule
from workbench.model.tuning import Objective
from workbench.model.valve import Valve
from workbench.scenario import schema
from workbench.scenario.analyses import check_analyses
from workbench.scenario.cautions import cautions
from workbench.scenario.controllers import Controllers, fitting_action, ruled, wrong_way
from workbench.scenario.document import Path
from workbench.scenario.element_entries import DESCRIBED, NOT_FROM_DATA, elements_of
from workbench.scenario.experiments import Experiments
from workbench.scenario.map_entries import map_job
from workbench.scenario.plan import CaseJob, EnsembleJob, EstimateJob, Scenario, wrong_length
from workbench.scenario.refusals import Refusals, in_entries, one_line
from workbench.scenario.robust import RobustEntries, measured_in
from workbench.scenario.rule_entries import DetunedIntegralRule, rule_of
from workbench.scenario.series import in_samples, read_data
from workbench.scenario.site_forms import site_form
from workbench.scenario.valves import plant_of, valve_of
from workbench.simulate.signals import sample_count

__all__ = ["Builder"]


@dataclass
class Builder:
    """Builds a `Scenario`; `refusals` collects what stands against it. place: gives an entry's `line:column: where`.

    A controller that acts the wrong way for the plant's gain is refused where its action is the default only, and in a
    tuning, which would find nothing; where the file says the action, it may be meant, and is a warning.
    """

    file: FilePath
    text: str
    place: Callable[[Path], str]
    refusals: Refusals = field(default_factory=Refusals)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    fail_open: bool = False

    def __post_init__(self) -> None:
        self.controllers = Controllers(self.refusals, None)
        self.experiments = Experiments(self.refusals, self.notes, self.file.parent)

    # the whole -----------------------------------------------------------------------------------------------------

    def scenario(self, given: schema.ScenarioFile) -> Scenario | None:
        """Return the scenario of a single loop, or None where something is refused."""
        from_data = [i for i, e in enumerate(given.estimate or ()) if e.data is not None]
        loop = given.loop or schema.Loop()
        self.fail_open = loop.fail_open
        self._pv_range(loop)
        if not given.cases and not given.estimate:
            self.refusals.refuse((), "must hold cases to simulate, or an estimate")
        self._needs(given, loop, bool(from_data))
        plant, valve = self._plant(loop), self._valve(loop)
        self.notes += check_analyses(given, valve, self.refusals)
        experiment = self.experiments.plain(given.experiment)
        if experiment is not None:
            self.controllers.duration = experiment.duration
        objective = self.controllers.objective(given.objective, ("objective",))
        ruling: Loop | None = None
        if plant is not None and valve is not None and loop.sample_time is not None and not from_data:
            idle = (plant, valve, PID(0.0, math.inf), loop.sample_time, None, None, loop.fail_open, loop.scan)
            ruling = self.refusals.attempt(("loop",), lambda: Loop(*idle))
        robust = RobustEntries(self.refusals, ruling)
        shared = None if given.ensemble is None else robust.ensemble(given.ensemble, ("ensemble",))
        records = self._records(given)
        first = next((record for record in records if record is not None), None)
        sample_time = loop.sample_time if not from_data else None if first is None else first.sample_time
        executed = None if sample_time is None else sample_time * loop.scan
        cases = self._cases(given, loop, objective, ruling, None if from_data else plant, robust, shared, executed)
        whole: Loop | None = None
        if plant is not None and valve is not None and loop.sample_time is not None and ruling is not None:
            first_controller = cases[0].controller if cases else None
            if not given.cases:
                first_controller = self._own_controller(loop)
                if first_controller is not None:
                    self.controllers.sampled(first_controller, None, ("loop", "controller"), executed)
                    there = loop.controller is not None and loop.controller.action is not None
                    self._acts(plant, first_controller, there, ("loop", "controller"), "loop.controller", tune=False)
            whole = self._loop(loop, plant, valve, loop.sample_time, first_controller, given.experiment)
            if whole is not None and not self.refusals.issues:
                for i, case in enumerate(cases):
                    self.refusals.attempt(("cases", i), partial(whole.with_controller, case.controller))
        if experiment is not None:
            if from_data and sample_time is not None:
                fitted = partial(in_samples, experiment, sample_time, self.notes)
                experiment = self.refusals.attempt(("experiment",), fitted) or experiment
            self._fits(experiment, sample_time, whole)
        estimates = self._estimates(given, records, whole, experiment)
        mapped = map_job(given.analyze.map, self.refusals, cases=bool(given.cases))
        own_form = None if loop.controller is None else loop.controller.form
        site = site_form(given, self.refusals, self.controllers.pv_range, own_form)
        if self.refusals.issues:
            return None
        said = cautions(whole, experiment, [(case.name, case.controller) for case in cases])
        return Scenario(
            path=self.file,
            name=self.file.stem,
            title=given.title.strip(),
            description=given.description,
            reference_source=given.reference_source,
            text=self.text,
            loop=whole,
            pv_range=self.controllers.pv_range,
            experiment=experiment,
            objective=objective or _common([case.tune.objective for case in cases if case.tune is not None]),
            estimates=tuple(estimates),
            cases=tuple(cases),
            describing_function=given.analyze.describing_function,
            limit_cycle=given.analyze.limit_cycle,
            repair=given.analyze.repair,
            tradeoff=given.analyze.tradeoff,
            cycle_map=mapped,
            ensemble=shared or measured_in(cases, tradeoff=given.analyze.tradeoff),
            site=site,
            notes=tuple(self.notes),
            warnings=tuple(self.warnings),
            cautions=tuple(said),
        )

    def _needs(self, given: schema.ScenarioFile, loop: schema.Loop, from_data: bool) -> None:
        """Refuse what is missing for what is asked, and what is given twice."""
        simulated = any(e.simulate for e in given.estimate or ())
        if from_data and simulated:
            self.refusals.refuse(("estimate",), "data and simulate: true given; a scenario estimates one or the other")
        if given.loop is None and not from_data and (given.cases or simulated):
            what = "missing; needed where no recorded data is given to estimate: plant, valve, controller, sample_time"
            self.refusals.refuse(("loop",), what)
        for name in ("plant", "valve", "sample_time") if given.loop is not None or from_data else ():
            there = getattr(loop, name) is not None
            if from_data and there:
                what = "given, and estimate.data as well; with recorded data it comes from the first estimate"
                self.refusals.refuse(("loop", name), what)
            if not from_data and not there and (given.cases or simulated):
                self.refusals.refuse(("loop", name), "missing; needed where no recorded data is given to estimate")
        for name in sorted(DESCRIBED & loop.model_fields_set) if from_data else ():
            self.refusals.refuse(("loop", name), NOT_FROM_DATA)
        if given.experiment is None and (given.cases or simulated):
            self.refusals.refuse(("experiment",), "missing; needed to simulate (at least duration and setpoint)")

    # the loop ------------------------------------------------------------------------------------------------------

    def _pv_range(self, loop: schema.Loop) -> None:
        if loop.pv_range is None:
            return
        low, high = loop.pv_range
        if low < high:
            self.controllers.pv_range = low, high
        else:
            self.refusals.refuse(
                ("loop", "pv_range"), f"[{low:g}, {high:g}] given; must be [low, high] with low < high"
            )

    def _plant(self, loop: schema.Loop) -> Plant | None:
        p = loop.plant
        if p is None:
            return None
        return self.refusals.attempt(("loop", "plant"), lambda: plant_of(p))

    def _valve(self, loop: schema.Loop) -> Valve | None:
        v = loop.valve
        return None if v is None else self.refusals.attempt(("loop", "valve"), lambda: valve_of(v))

    def _loop(
        self,
        given: schema.Loop,
        plant: Plant,
        valve: Valve,
        sample_time: float,
        controller: PID | None,
        experiment: schema.Experiment | None,
    ) -> Loop | None:
        if controller is None:
            return None
        more = self.refusals.attempt(("loop", "characteristic"), partial(elements_of, given))
        if more is None:
            return None
        loop = self.refusals.attempt(
            ("loop",), lambda: Loop(plant, valve, controller, sample_time, self.controllers.pv_range, **more)
        )
        if loop is None:
            return None
        note = loop.sampling_note()
        if note is not None and not given.coarse_sampling:
            self.refusals.refuse(
                ("loop", "sample_time"), f"{note}; sample faster, or allow it with loop.coarse_sampling: true"
            )
        elif note is not None:
            self.notes.append(f"Coarse sampling, allowed by the scenario: {note}.")
        if experiment is not None and plant.dead_time > experiment.duration:
            what = f"{plant.dead_time:g} s given; must be at most the experiment's duration ({experiment.duration:g} s)"
            self.refusals.refuse(("loop", "plant", "dead_time"), what)
        return loop

    def _own_controller(self, loop: schema.Loop) -> PID | None:
        """Return the controller that loop.controller alone describes."""
        given = loop.controller or schema.Controller()
        path: Path = ("loop", "controller")
        fields = self.controllers.keys(given, path)
        return self.controllers.pid(path, fields, self.controllers.tuning(given, path, fields.get("form", "ideal")))

    # the experiment ------------------------------------------------------------------------------------------------

    def _fits(self, experiment: Experiment, sample_time: float | None, loop: Loop | None) -> None:
        """Refuse an experiment that does not fit the loop's samples, or whose start the valve would not hold."""
        if sample_time is not None:
            samples = self.refusals.attempt(("experiment",), lambda: sample_count(experiment.duration, sample_time))
            if samples is not None and (what := wrong_length(samples)):
                self.refusals.refuse(("experiment", "duration"), what)
            for name, parts in (("setpoint", experiment.setpoint_parts), ("load", experiment.load_parts)):
                for i, part in enumerate(parts):
                    if samples is not None and isinstance(part, Series) and part.times is None:
                        many = len(part.values)
                        if many > samples + 1:
                            what = f"{many} values given; must be at most one for each of the {samples + 1} samples"
                            self.refusals.refuse(("experiment", name, i, "series"), what)
        if loop is not None and abs(experiment.stem_offset) > loop.valve.hold:
            hold = loop.valve.hold
            what = (
                f"{experiment.stem_offset:g} % given; must be at most {hold:g} % in size, as this valve holds no more"
            )
            self.refusals.refuse(("experiment", "stem_offset"), what)

    # the cases -----------------------------------------------------------------------------------------------------

    def _cases(
        self,
        given: schema.ScenarioFile,
        loop: schema.Loop,
        objective: Objective | None,
        ruling: Loop | None,
        plant: Plant | None,
        robust: RobustEntries,
        shared: EnsembleJob | None,
        sample_time: float | None,
    ) -> list[CaseJob]:
        """Return the cases; rules are applied to the loop `ruling` here where it and their base are known already.

        plant: None where it comes from an estimate; sample_time: s, the controller's, None where it is missing.
        """
        own = loop.controller or schema.Controller()
        base_path: Path = ("loop", "controller")
        base = self.controllers.keys(own, base_path)
        tuning = self.controllers.tuning(own, base_path, base.get("form", "ideal"))
        jobs: list[CaseJob] = []
        names: dict[str, int] = {}
        known: dict[str, PID] = {}
        first: CaseJob | None = None
        for i, case in enumerate(given.cases):
            path: Path = ("cases", i)
            name = case.name.strip()
            if name in names:
                self.refusals.refuse((*path, "name"), f"{name!r} given; cases[{names[name]}] has this name already")
            names.setdefault(name, i)
            tune, rule, under = None, None, ""
            if isinstance(case, schema.CascadedCase):
                self.refusals.refuse(path, "a case of a cascade given; needs cascade in place of loop")
                continue
            entry = case.tune if isinstance(case, schema.TunedCase) else case
            action_given = entry.action is not None or "action" in base
            if isinstance(case, schema.GivenCase):
                fields = {**base, **self.controllers.keys(case, path)}
                mine = {**tuning, **self.controllers.tuning(case, path, fields.get("form", "ideal"))}
                controller = self.controllers.pid(path, fields, mine)
            elif isinstance(case, schema.RuledCase):
                rule, under = self._rule(case, path, names)
                fields = {**base, **self.controllers.keys(case, path)}
                # Without gain and integral: the rule says them, at the latest when the loop has been found.
                controller = self.controllers.pid(path, fields, {"Kc": 0.0, "Ti": math.inf})
                if rule is None or controller is None:
                    continue
                # A default action that does not fit is refused below, in words of its own.
                suited = None if plant is None else fitting_action(plant, fail_open=self.fail_open)
                fits = suited is None or action_given or controller.action == suited
                if ruling is not None and fits and (not under or under in known):
                    apply = partial(ruled, ruling, known.get(under, controller), rule)
                    controller = self.refusals.attempt((*path, "rule"), apply)
            else:
                found = self.controllers.tuned(case.tune, (*path, "tune"), base, tuning, first, objective)
                if found is None:
                    continue
                controller, tune = found
                above = [other for other in names if other != name]
                at = (*path, "tune")
                tune = replace(
                    tune,
                    robust=robust.tuning(case.tune, at, shared, above),
                    constraints=robust.constraints(case.tune.constraints, (*at, "constraints")),
                )
            mine_too = "compensator" in entry.model_fields_set
            if controller is None or not self.controllers.sampled(controller, tune, path, sample_time, own=mine_too):
                continue
            if plant is not None:
                at = path if tune is None else (*path, "tune")
                self._acts(plant, controller, action_given, at, name, tune=tune is not None, rule=rule is not None)
            job = CaseJob(
                name=name,
                where=self.place(path),
                controller=controller,
                tune=tune,
                rule=rule,
                base=under,
                action_given=action_given,
                reference={str(k): v for k, v in case.reference.items()},
                note=case.note,
            )
            jobs.append(job)
            if tune is None and (rule is None or (ruling is not None and (not under or under in known))):
                known[name] = controller
            if first is None and tune is None and rule is None:
                first = job
        return jobs

    def _acts(
        self,
        plant: Plant,
        controller: PID,
        action_given: bool,
        path: Path,
        name: str,
        *,
        tune: bool,
        rule: bool = False,
    ) -> None:
        """Refuse a controller that acts the wrong way, or warn where the file itself says so; see `Builder`."""
        asked = replace(controller, Kc=1.0) if tune or rule else controller
        wrong = wrong_way(plant, asked, fail_open=self.fail_open)
        if wrong is None:
            return
        if not action_given:
            what = f"{plant.gain:g} given, and {controller.action} action by default; {wrong} (in loop.controller)"
            self.refusals.refuse(("loop", "plant", "gain"), what)
        elif tune:
            self.refusals.refuse((*path, "action"), f"{controller.action} given; {wrong}")
        else:
            self.warnings.append(f"{name}: {wrong}.")

    def _rule(self, case: schema.RuledCase, path: Path, names: dict[str, int]) -> tuple[Rule | None, str]:
        """Return a case's rule and the name of the case that it starts from, if it needs one."""
        rule = self.refusals.attempt((*path, "rule"), lambda: rule_of(case.rule))
        if not isinstance(case.rule, DetunedIntegralRule):
            return rule, ""
        under = case.rule.base.strip()
        if names.get(under, path[1]) == path[1]:
            above = ", ".join(name for name, i in names.items() if i != path[1]) or "there is none"
            self.refusals.refuse(
                (*path, "rule", "base"), f"{under!r} given; must be the name of a case above this one ({above})"
            )
            return None, under
        for name in sorted(case.model_fields_set & set(schema.ControllerKeys.model_fields)):
            self.refusals.refuse(
                (*path, name), "given; detuned_integral takes the controller of its base case as it is"
            )
        return rule, under

    # the estimates -------------------------------------------------------------------------------------------------

    def _beside(self, name: str) -> FilePath:
        return self.file.parent / name

    def _records(self, given: schema.ScenarioFile) -> list[Record | None]:
        found: list[Record | None] = []
        for i, e in enumerate(given.estimate or ()):
            path: Path = ("estimate", i)
            record = None
            if e.data is None:
                for name in ("columns", "tags", "sample_time", "pv_range", "op_range", "max_gap"):
                    if getattr(e, name) is not None:
                        self.refusals.refuse((*path, name), "given without data; a simulated record has no such entry")
            else:
                if e.noise is not None:
                    self.refusals.refuse(
                        (*path, "noise"), "given with data; only a simulated record can be given noise"
                    )
                record = self._read(e, path)
            if e.start is not None and e.method != "two_step":
                self.refusals.refuse((*path, "start"), "given; only the two_step method takes a start")
            if e.method == "two_step" and e.valve not in ("auto", "stenman"):
                self.refusals.refuse((*path, "valve"), f"{e.valve} given; method two_step knows stenman alone")
            found.append(record)
        return found

    def _read(self, e: schema.Estimate, path: Path) -> Record | None:
        """Return the record that an estimate is made from; None after a refusal of what a run would refuse."""
        name = e.data or ""
        try:
            record = replace(read_data(self._beside(name), e, self.controllers.pv_range), source=name)
            refuse_unfit(record)
        except InvalidValue as error:
            # A range that the loop gives stands elsewhere, and was refused there.
            own = error.where in e.model_fields_set
            text = f"{error.given} given; {error.allowed}" if own else one_line(error)
            self.refusals.refuse((*path, error.where if own else "data"), text)
            return None
        except (RecordError, OSError, ValueError) as error:
            self.refusals.refuse((*path, "data"), in_entries(one_line(error)))
            return None
        self.notes += [f"{name}: {note}" for note in record.notes]
        return record

    def _estimates(
        self,
        given: schema.ScenarioFile,
        records: list[Record | None],
        loop: Loop | None,
        experiment: Experiment | None,
    ) -> list[EstimateJob]:
        jobs: list[EstimateJob] = []
        names: dict[str, int] = {}
        for i, (e, record) in enumerate(zip(given.estimate or (), records, strict=True)):
            path: Path = ("estimate", i)
            fallback = FilePath(e.data).stem if e.data is not None else "simulated record"
            name = (e.name or fallback).strip()
            if name in names:
                self.refusals.refuse((*path, "name"), f"{name!r} given; estimate[{names[name]}] has this name already")
            names.setdefault(name, i)
            noise = self.experiments.noise(e.noise, (*path, "noise"))
            mine = experiment if noise is None or experiment is None else replace(experiment, noise=noise)
            simulated = _simulated(loop, mine) if e.simulate else 0
            if 0 < simulated < FEWEST_SAMPLES:
                what = f"{simulated} samples are simulated; at least {FEWEST_SAMPLES} are needed to {PURPOSE}"
                self.refusals.refuse((*path, "simulate"), what)
            if e.method == "complementarity":
                self._fits_program(e, path, record, loop, mine)
            reference = {} if e.reference is None else e.reference.model_dump(exclude_none=True)
            jobs.append(
                EstimateJob(
                    name=name,
                    where=self.place(path),
                    record=record,
                    truth=loop if e.simulate else None,
                    experiment=mine if e.simulate else None,
                    method=e.method,
                    valve=e.valve,
                    plant=e.plant,
                    start=e.start,
                    reference=reference,
                    note=e.note,
                )
            )
        return jobs

    def _fits_program(
        self, e: schema.Estimate, path: Path, record: Record | None, loop: Loop | None, mine: Experiment | None
    ) -> None:
        """Refuse a valve or a record that the complementarity program does not take."""
        if e.valve not in ("auto", "stenman"):
            self.refusals.refuse((*path, "valve"), f"{e.valve} given; method complementarity knows stenman alone")
        samples = _simulated(loop, mine) if record is None else len(record)
        if samples > MOST_IN_PROGRAM:
            what = f"complementarity given for {samples:,} samples; at most {MOST_IN_PROGRAM:,}"
            self.refusals.refuse((*path, "method"), what)


def _simulated(loop: Loop | None, experiment: Experiment | None) -> int:
    """Return how many samples a simulated record has, 0 where that was refused."""
    if loop is None or experiment is None:
        return 0
    try:
        return sample_count(experiment.duration, loop.sample_time)
    except InvalidValue:
        return 0


def _common(objectives: list[Objective]) -> Objective | None:
    """Return the objective that all tunings share, if they do."""
    return objectives[0] if objectives and all(one == objectives[0] for one in objectives) else None
