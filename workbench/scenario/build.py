"""From the file as written (`schema`) to the model's values (`plan`), with every refusal under its entry's path."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path as FilePath
from typing import Any, TypeVar

from workbench.errors import InvalidValue, RecordError
from workbench.model.controller import PID, STRUCTURES
from workbench.model.experiment import Experiment, Noise, Profile, Ramp, Series, Step
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Integrating, Plant
from workbench.model.record import Record
from workbench.model.tuning import Bounds, Objective
from workbench.model.units import gain_from
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman, Valve
from workbench.record.reader import read_record
from workbench.scenario import schema
from workbench.scenario.document import Path
from workbench.scenario.plan import CaseJob, EstimateJob, Scenario, TuneJob
from workbench.scenario.series import read_series
from workbench.scenario.units import Quantity
from workbench.simulate.signals import sample_count

__all__ = ["MAX_SAMPLES", "Builder"]

MAX_SAMPLES = 5_000_000
T = TypeVar("T")

# Entries that the file calls otherwise than the model does.
_NAMES = {"values": "series"}
_FIELD = re.compile(r"[A-Za-z]+\.([A-Za-z_]+)(?:\[([0-9]+)\])?")


@dataclass
class Builder:
    """Builds a `Scenario`; `issues` collects (path, text) of what is refused.

    place: gives an entry's `line:column: where`.
    """

    file: FilePath
    text: str
    place: Callable[[Path], str]
    issues: list[tuple[Path, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    pv_range: tuple[float, float] | None = None

    def refuse(self, path: Path, text: str) -> None:
        """Note one refusal."""
        self.issues.append((path, text))

    def attempt(self, path: Path, make: Callable[[], T], names: Mapping[str, str] = _NAMES) -> T | None:
        """Return what `make` makes, or None after noting why the model refuses it, under the entry of its field."""
        try:
            return make()
        except InvalidValue as error:
            match = _FIELD.fullmatch(error.where)
            under: Path = ()
            if match is not None:
                under = (names.get(match[1], match[1]), *([int(match[2])] if match[2] else []))
            self.refuse(path + under, f"{error.given} given; {error.allowed}")
            return None

    # the whole -----------------------------------------------------------------------------------------------------

    def scenario(self, given: schema.ScenarioFile) -> Scenario | None:
        """Return the scenario, or None where `issues` holds something."""
        from_data = [i for i, e in enumerate(given.estimate or ()) if e.data is not None]
        loop = given.loop or schema.Loop()
        self._pv_range(loop)
        if not given.cases and not given.estimate:
            self.refuse((), "must hold cases to simulate, or an estimate")
        self._needs(given, loop, bool(from_data))
        plant, valve = self._plant(loop), self._valve(loop)
        experiment = self._experiment(given.experiment)
        objective = self._objective(given.objective, ("objective",))
        cases = self._cases(given, loop, objective)
        records = self._records(given)
        whole: Loop | None = None
        if plant is not None and valve is not None and loop.sample_time is not None and not from_data:
            whole = self._loop(loop, plant, valve, loop.sample_time, cases, given.experiment)
        if experiment is not None:
            first = next((record for record in records if record is not None), None)
            sample_time = first.sample_time if from_data and first is not None else loop.sample_time
            self._fits(experiment, sample_time, whole)
        estimates = self._estimates(given, records, whole, experiment)
        if self.issues:
            return None
        return Scenario(
            path=self.file,
            name=self.file.stem,
            title=given.title.strip(),
            description=given.description,
            reference_source=given.reference_source,
            text=self.text,
            loop=whole,
            pv_range=self.pv_range,
            experiment=experiment,
            objective=objective or _common([case.tune.objective for case in cases if case.tune is not None]),
            estimates=tuple(estimates),
            cases=tuple(cases),
            describing_function=given.analyze.describing_function,
            limit_cycle=given.analyze.limit_cycle,
            notes=tuple(self.notes),
        )

    def _needs(self, given: schema.ScenarioFile, loop: schema.Loop, from_data: bool) -> None:
        """Refuse what is missing for what is asked, and what is given twice."""
        simulated = any(e.simulate for e in given.estimate or ())
        if from_data and simulated:
            self.refuse(("estimate",), "data and simulate: true given; a scenario estimates one or the other")
        for name in ("plant", "valve", "sample_time"):
            there = getattr(loop, name) is not None
            if from_data and there:
                what = "given, and estimate.data as well; with recorded data it comes from the first estimate"
                self.refuse(("loop", name), what)
            if not from_data and not there and (given.cases or simulated):
                self.refuse(("loop", name), "missing; needed where no recorded data is given to estimate")
        if given.experiment is None and (given.cases or simulated):
            self.refuse(("experiment",), "missing; needed to simulate (at least duration and setpoint)")

    # the loop ------------------------------------------------------------------------------------------------------

    def _pv_range(self, loop: schema.Loop) -> None:
        if loop.pv_range is None:
            return
        low, high = loop.pv_range
        if low < high:
            self.pv_range = low, high
        else:
            self.refuse(("loop", "pv_range"), f"[{low:g}, {high:g}] given; must be [low, high] with low < high")

    def _plant(self, loop: schema.Loop) -> Plant | None:
        p = loop.plant
        if p is None:
            return None
        if isinstance(p, schema.FopdtPlant):
            return self.attempt(("loop", "plant"), lambda: FOPDT(p.gain, p.time_constant, p.dead_time))
        return self.attempt(("loop", "plant"), lambda: Integrating(p.gain, p.dead_time))

    def _valve(self, loop: schema.Loop) -> Valve | None:
        v = loop.valve
        path = ("loop", "valve")
        if isinstance(v, schema.StenmanValve):
            return self.attempt(path, lambda: Stenman(v.d))
        if isinstance(v, schema.ChoudhuryValve):
            return self.attempt(path, lambda: Choudhury(v.S, v.J))
        if isinstance(v, schema.DeadbandValve):
            return self.attempt(path, lambda: Deadband(v.b))
        return None if v is None else Ideal()

    def _loop(
        self,
        given: schema.Loop,
        plant: Plant,
        valve: Valve,
        sample_time: float,
        cases: list[CaseJob],
        experiment: schema.Experiment | None,
    ) -> Loop | None:
        controller = cases[0].controller if cases else self._own_controller(given)
        if controller is None:
            return None
        loop = self.attempt(("loop",), lambda: Loop(plant, valve, controller, sample_time, self.pv_range))
        if loop is None:
            return None
        note = loop.sampling_note()
        if note is not None and not given.coarse_sampling:
            self.refuse(("loop", "sample_time"), f"{note}; sample faster, or allow it with loop.coarse_sampling: true")
        elif note is not None:
            self.notes.append(f"Coarse sampling, allowed by the scenario: {note}.")
        if experiment is not None and plant.dead_time > experiment.duration:
            what = f"{plant.dead_time:g} s given; must be at most the experiment's duration ({experiment.duration:g} s)"
            self.refuse(("loop", "plant", "dead_time"), what)
        return loop

    # the controller ------------------------------------------------------------------------------------------------

    def _keys(self, given: schema.ControllerKeys, path: Path) -> dict[str, Any]:
        """Return the PID's fields that an entry sets."""
        there = given.model_fields_set
        fields: dict[str, Any] = {
            name: getattr(given, name)
            for name in schema.ControllerKeys.model_fields
            if name in there and name not in ("structure", "output_limits") and getattr(given, name) is not None
        }
        if "output_limits" in there:
            fields["output_limits"] = None if given.output_limits is None else tuple(given.output_limits)
        if given.structure is not None:
            for name in ("derivative_on", "setpoint_weight"):
                if name in fields:
                    self.refuse((*path, name), f"given, and structure as well; structure says it ({given.structure})")
            fields["derivative_on"], fields["setpoint_weight"] = STRUCTURES[given.structure]
        return fields

    def _tuning(self, given: schema.Tuning, path: Path, form: str) -> dict[str, float]:
        """Return Kc (%/EU), Ti (s) and Td (s), as far as an entry gives them."""
        found: dict[str, float] = {}
        if given.Kc is not None and given.proportional_band is not None:
            self.refuse((*path, "proportional_band"), "given, and Kc as well; one of the two is needed")
        for name in ("Kc", "proportional_band"):
            quantity = getattr(given, name)
            if quantity is not None:
                Kc = self._gain(quantity, (*path, name), form)
                found["Kc"] = 0.0 if Kc is None else Kc  # refused: any value, so that it is not called missing too
        if given.Ti is not None:
            found["Ti"] = given.Ti
        if given.Td is not None:
            found["Td"] = given.Td
        return found

    def _gain(self, quantity: Quantity, path: Path, form: str) -> float | None:
        if quantity.unit != "%/EU" and form == "parallel":
            self.refuse(path, "given in % of the PV range; a parallel controller takes its gains in %/EU")
            return None
        try:
            return gain_from(quantity.value, quantity.unit, self.pv_range)
        except InvalidValue as error:
            if error.where == "pv_range":
                self.refuse(path, f"a gain in {quantity.unit} given; needs loop.pv_range: [low, high] in EU")
            else:
                self.refuse(path, f"{error.given} given; {error.allowed}")
            return None

    def _own_controller(self, loop: schema.Loop) -> PID | None:
        """Return the controller that loop.controller alone describes."""
        given = loop.controller or schema.Controller()
        path: Path = ("loop", "controller")
        fields = self._keys(given, path)
        tuning = self._tuning(given, path, fields.get("form", "ideal"))
        return self._pid(path, fields, tuning)

    def _pid(self, path: Path, fields: dict[str, Any], tuning: dict[str, float]) -> PID | None:
        for name in ("Kc", "Ti"):
            if name not in tuning:
                self.refuse((*path, name), "missing; give it here or in loop.controller")
        if "Kc" not in tuning or "Ti" not in tuning:
            return None

        def make() -> PID:
            controller = PID(**{**fields, **tuning})
            controller.ideal_terms()  # refused here, where the entry is known, if the simulation could not take it
            return controller

        return self.attempt(path, make)

    # the experiment ------------------------------------------------------------------------------------------------

    def _experiment(self, given: schema.Experiment | None) -> Experiment | None:
        if given is None:
            return None
        path: Path = ("experiment",)
        noise = self._noise(given.noise, (*path, "noise"))
        setpoint = self._profile(given.setpoint, (*path, "setpoint"), given.duration)
        load = self._profile(given.load, (*path, "load"), given.duration)
        return self.attempt(
            path, lambda: Experiment(given.duration, setpoint or None, load or None, noise, given.stem_offset)
        )

    def _noise(self, given: schema.Noise | None, path: Path) -> Noise | None:
        return None if given is None else self.attempt(path, lambda: Noise(given.sd, given.seed))

    def _profile(self, parts: list[Any] | None, path: Path, duration: float) -> list[Profile]:
        found: list[Profile] = []
        for i, part in enumerate(parts or ()):
            made = self.attempt((*path, i), partial(self._part, part, (*path, i)))
            if made is None:
                continue
            begin = made.at if isinstance(made, Step) else made.start if isinstance(made, Ramp) else 0.0
            if begin > duration:
                name = "at" if isinstance(made, Step) else "start"
                what = f"{begin:g} s given; must be within the experiment's duration ({duration:g} s)"
                self.refuse((*path, i, name), what)
                continue
            found.append(made)
        return found

    def _part(self, part: object, path: Path) -> Profile | None:
        if isinstance(part, schema.StepPart):
            return Step(self._size(part.step, (*path, "step")), part.at)
        if isinstance(part, schema.RampPart):
            return Ramp(self._size(part.ramp, (*path, "ramp")), part.start, part.end)
        if isinstance(part, schema.SeriesPart):
            return Series(part.series, part.times)
        if not isinstance(part, schema.FilePart):
            return None
        source = self._beside(part.file)
        try:
            series = read_series(source, part.file, part.column.strip(), part.time, part.resting_value)
        except (RecordError, OSError, ValueError) as error:
            self.refuse((*path, "file"), _one_line(error))
            return None
        rest = "its first value" if part.resting_value is None else f"{part.resting_value:g}"
        self.notes.append(
            f"{path[1]}: column {part.column} of {part.file}, {len(series.values)} values as deviations from {rest}."
        )
        return series

    def _size(self, given: Quantity, path: Path) -> float:
        if given.unit == "%" and path[1] == "setpoint":
            self.refuse(path, f"{given.value:g} % given; a setpoint is a number in EU")
        return given.value

    def _fits(self, experiment: Experiment, sample_time: float | None, loop: Loop | None) -> None:
        """Refuse an experiment that does not fit the loop's samples, or whose start the valve would not hold."""
        if sample_time is not None:
            samples = self.attempt(("experiment",), lambda: sample_count(experiment.duration, sample_time))
            if samples is not None and samples > MAX_SAMPLES:
                what = f"{samples:,} samples; must be at most {MAX_SAMPLES:,}"
                self.refuse(("experiment", "duration"), what)
            for name, parts in (("setpoint", experiment.setpoint_parts), ("load", experiment.load_parts)):
                for i, part in enumerate(parts):
                    if samples is not None and isinstance(part, Series) and part.times is None:
                        many = len(part.values)
                        if many > samples + 1:
                            what = f"{many} values given; must be at most one for each of the {samples + 1} samples"
                            self.refuse(("experiment", name, i, "series"), what)
        if loop is not None and abs(experiment.stem_offset) > loop.valve.hold:
            hold = loop.valve.hold
            what = (
                f"{experiment.stem_offset:g} % given; must be at most {hold:g} % in size, as this valve holds no more"
            )
            self.refuse(("experiment", "stem_offset"), what)

    # the cases -----------------------------------------------------------------------------------------------------

    def _objective(self, given: schema.Objective | None, path: Path) -> Objective | None:
        if given is None:
            return None
        return self.attempt(path, lambda: Objective(given.w1, given.w2, given.w3, given.w4))

    def _cases(self, given: schema.ScenarioFile, loop: schema.Loop, objective: Objective | None) -> list[CaseJob]:
        own = loop.controller or schema.Controller()
        base_path: Path = ("loop", "controller")
        base = self._keys(own, base_path)
        tuning = self._tuning(own, base_path, base.get("form", "ideal"))
        jobs: list[CaseJob] = []
        names: dict[str, int] = {}
        first: CaseJob | None = None
        for i, case in enumerate(given.cases):
            path: Path = ("cases", i)
            name = case.name.strip()
            if name in names:
                self.refuse((*path, "name"), f"{name!r} given; cases[{names[name]}] has this name already")
            names.setdefault(name, i)
            if isinstance(case, schema.GivenCase):
                fields = {**base, **self._keys(case, path)}
                mine = {**tuning, **self._tuning(case, path, fields.get("form", "ideal"))}
                controller = self._pid(path, fields, mine)
                tune = None
            else:
                found = self._tuned(case.tune, (*path, "tune"), base, tuning, first, objective)
                if found is None:
                    continue
                controller, tune = found
            if controller is None:
                continue
            job = CaseJob(
                name, f"cases[{i}]", controller, tune, {str(k): v for k, v in case.reference.items()}, case.note
            )
            jobs.append(job)
            if first is None and tune is None:
                first = job
        return jobs

    def _tuned(
        self,
        given: schema.Tune,
        path: Path,
        base: dict[str, Any],
        base_tuning: dict[str, float],
        first: CaseJob | None,
        common: Objective | None,
    ) -> tuple[PID, TuneJob] | None:
        fields = {**base, **self._keys(given, path)}
        form = fields.get("form", "ideal")
        fixed = self._tuning(given, path, form)
        bounds = self._bounds(given, path, form, fixed)
        own = self._objective(given.objective, (*path, "objective"))
        if bounds is None or (given.objective is not None and own is None):
            return None
        start, source = self._start(given, path, form, bounds, base_tuning, first)
        start |= fixed
        controller = self._pid(path, fields, start)
        if controller is None:
            return None
        for name in ("Kc", "Ti", "Td"):
            low, high = getattr(bounds, name)
            value = getattr(controller, name)
            if low < high and not low - 1e-9 * abs(low) <= value <= high + 1e-9 * abs(high):
                what = (
                    f"[{low:g}, {high:g}] excludes the start, {name} = {value:g} ({source}); widen the bounds, "
                    "or give tune.start"
                )
                self.refuse((*path, "bounds", name), what)
        job = TuneJob(own or common or Objective(), bounds, given.seed, given.digits, given.restarts)
        return controller, job

    def _bounds(self, given: schema.Tune, path: Path, form: str, fixed: dict[str, float]) -> Bounds | None:
        pairs: dict[str, tuple[float, float]] = {}
        under = (*path, "bounds")
        asked = given.bounds or schema.Bounds()
        if asked.Kc is not None and asked.proportional_band is not None:
            self.refuse((*under, "proportional_band"), "given, and Kc as well; one of the two is needed")
        for name in ("Kc", "proportional_band"):
            ends = getattr(asked, name)
            if ends is None:
                continue
            values = [self._gain(end, (*under, name, i), form) for i, end in enumerate(ends)]
            if values[0] is not None and values[1] is not None:
                # A wide proportional band is a small gain.
                pair = values[0], values[1]
                pairs["Kc"] = pair if name == "Kc" else (pair[1], pair[0])
        if asked.Ti is not None:
            low, high = asked.Ti
            pairs["Ti"] = low, high
        if asked.Td is not None:
            low, high = asked.Td
            pairs["Td"] = low, high
        for name, value in fixed.items():
            if name in pairs:
                self.refuse((*under, name), f"given, and tune.{name} as well, which holds it at {value:g}")
            pairs[name] = value, value
        if "Ti" in pairs and math.isinf(pairs["Ti"][1]):
            at = under if "Ti" not in fixed else path
            self.refuse((*at, "Ti"), "no integral action given; a tuning needs a finite Ti")
            return None
        return self.attempt(under if given.bounds is not None else path, lambda: Bounds(**pairs))

    def _start(
        self,
        given: schema.Tune,
        path: Path,
        form: str,
        bounds: Bounds,
        base: dict[str, float],
        first: CaseJob | None,
    ) -> tuple[dict[str, float], str]:
        """Return the tuning to start from, as given or else the controller's own, the first case's, or the middle."""
        if given.start is not None:
            mine = {**base, **self._tuning(given.start, (*path, "start"), form)}
            return mine, "tune.start"
        if "Kc" in base and "Ti" in base:
            return dict(base), "loop.controller"
        if first is not None and first.controller.form == form:
            c = first.controller
            return {"Kc": c.Kc, "Ti": c.Ti, "Td": c.Td}, first.name
        (a, b), (c1, d), (e, _) = bounds.Kc, bounds.Ti, bounds.Td
        return {"Kc": math.sqrt(max(a, b / 100.0) * b), "Ti": math.sqrt(c1 * d), "Td": e}, "the bounds' middle"

    # the estimates -------------------------------------------------------------------------------------------------

    def _beside(self, name: str) -> FilePath:
        return self.file.parent / name

    def _records(self, given: schema.ScenarioFile) -> list[Record | None]:
        found: list[Record | None] = []
        for i, e in enumerate(given.estimate or ()):
            path: Path = ("estimate", i)
            record = None
            if e.data is None:
                for name in ("columns", "sample_time"):
                    if getattr(e, name) is not None:
                        self.refuse((*path, name), "given without data; a simulated record has no such entry")
            else:
                if e.noise is not None:
                    self.refuse((*path, "noise"), "given with data; only a simulated record can be given noise")
                columns = None if e.columns is None else e.columns.model_dump(exclude_none=True)
                try:
                    record = read_record(self._beside(e.data), columns=columns, sample_time=e.sample_time)
                except (RecordError, InvalidValue, OSError, ValueError) as error:
                    self.refuse((*path, "data"), _one_line(error))
                else:
                    record = replace(record, source=e.data)
                    self.notes += [f"{e.data}: {note}" for note in record.notes]
            if e.start is not None and e.method != "two_step":
                self.refuse((*path, "start"), "given; only the two_step method takes a start")
            found.append(record)
        return found

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
                self.refuse((*path, "name"), f"{name!r} given; estimate[{names[name]}] has this name already")
            names.setdefault(name, i)
            noise = self._noise(e.noise, (*path, "noise"))
            mine = experiment if noise is None or experiment is None else replace(experiment, noise=noise)
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


def _common(objectives: list[Objective]) -> Objective | None:
    """Return the objective that all tunings share, if they do."""
    return objectives[0] if objectives and all(one == objectives[0] for one in objectives) else None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
