"""Cascades in scenarios: from `cascade:` and its cases as written to the values that are run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from workbench.model.cascade import Cascade, CascadeExperiment
from workbench.model.controller import PID
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Ideal, Valve
from workbench.scenario import schema
from workbench.scenario.build import Builder
from workbench.scenario.cautions import cascade_cautions
from workbench.scenario.controllers import Controllers, wrong_way
from workbench.scenario.document import Path
from workbench.scenario.plan import CascadeJob, CascadeTuneJob, Scenario, wrong_length
from workbench.scenario.refusals import Refusals
from workbench.scenario.site_forms import cascade_site
from workbench.scenario.valves import plant_of, valve_of
from workbench.simulate.cascade import cascade_signals
from workbench.simulate.signals import signals

__all__ = ["cascade_scenario"]

# What only a single loop has.
SINGLE = ("loop", "ensemble", "estimate")


def cascade_scenario(builder: Builder, given: schema.ScenarioFile, entry: schema.Cascade) -> Scenario | None:
    """Return the scenario of a cascade, or None where something is refused (in `builder.refusals`)."""
    refusals = builder.refusals
    for name in SINGLE:
        if getattr(given, name) is not None:
            refusals.refuse((name,), "given, and cascade as well; a scenario has a single loop or a cascade")
    for name in sorted(given.analyze.model_fields_set - {"limit_cycle"}):
        if getattr(given.analyze, name):
            refusals.refuse(("analyze", name), "given; of a cascade there is its limit_cycle alone")
    if not given.cases:
        refusals.refuse((), "must hold cases to simulate")
    if given.experiment is None:
        refusals.refuse(("experiment",), "missing; needed to simulate (at least duration and setpoint)")
    builder.controllers.without_range = "a cascade takes its gains per EU"
    experiment = None if given.experiment is None else builder.experiments.of_cascade(given.experiment)
    if experiment is not None:
        builder.controllers.duration = experiment.duration
    objective = builder.controllers.objective(given.objective, ("objective",))
    cascade = _Reader(refusals, builder.controllers).cascade(entry)
    jobs: list[CascadeJob] = []
    site = None
    if cascade is not None:
        site = cascade_site(given, refusals, cascade)
        if experiment is not None:
            _fits(builder, cascade, experiment)
        jobs = _Cases(builder, entry, cascade, objective).jobs(given.cases)
    if refusals.issues or experiment is None or not jobs:
        return None
    return Scenario(
        path=builder.file,
        name=builder.file.stem,
        title=given.title.strip(),
        description=given.description,
        reference_source=given.reference_source,
        text=builder.text,
        loop=None,
        pv_range=None,
        experiment=experiment,
        objective=objective,
        estimates=(),
        cases=(),
        describing_function=False,
        limit_cycle=given.analyze.limit_cycle,
        cascade=tuple(jobs),
        cascade_site=site,
        notes=tuple(builder.notes),
        warnings=tuple(builder.warnings),
        cautions=tuple(cascade_cautions(experiment, [(job.name, job.cascade) for job in jobs])),
    )


def _fits(builder: Builder, cascade: Cascade, experiment: CascadeExperiment) -> None:
    """Refuse an experiment that does not fit the cascade's samples, or is too long; note coarse sampling."""
    samples = experiment.duration / cascade.secondary.sample_time
    if what := wrong_length(samples):
        builder.refusals.refuse(("experiment", "duration"), what)
        return
    builder.refusals.attempt(("experiment",), lambda: cascade_signals(cascade, experiment))
    for name, loop in (("primary", cascade.primary), ("secondary", cascade.secondary)):
        note = loop.sampling_note()
        if note is not None:
            builder.notes.append(f"Coarse sampling of the {name}: {note}.")


class _Reader:
    """Reads the two loops; what is refused goes to `refusals`."""

    def __init__(self, refusals: Refusals, controllers: Controllers) -> None:
        self.refusals, self.controllers = refusals, controllers

    def cascade(self, given: schema.Cascade) -> Cascade | None:
        """Return the cascade under the controllers of its own entry."""
        secondary = self._loop(given.secondary, ("cascade", "secondary"))
        primary = self._loop(given.primary, ("cascade", "primary"))
        if primary is None or secondary is None:
            return None
        made = self.refusals.attempt(("cascade",), lambda: Cascade(primary, secondary, given.scale, given.anti_windup))
        if made is not None:
            self.acts(made, ("cascade", "primary", "controller"), ("cascade", "secondary", "controller"))
        return made

    def _loop(self, given: schema.CascadeLoop, path: Path) -> Loop | None:
        plant = self.refusals.attempt((*path, "plant"), lambda: plant_of(given.plant))
        valve: Valve | None = Ideal()
        if isinstance(given, schema.SecondaryLoop):
            entry = given.valve
            valve = self.refusals.attempt((*path, "valve"), lambda: valve_of(entry))
        controller = self.controller(given, (*path, "controller"))
        if plant is None or valve is None or controller is None:
            return None
        pv_range = None if given.pv_range is None else (given.pv_range[0], given.pv_range[1])
        return self.refusals.attempt(path, lambda: Loop(plant, valve, controller, given.sample_time, pv_range))

    def controller(self, loop: schema.CascadeLoop, path: Path, case: schema.Controller | None = None) -> PID | None:
        """Return the controller of a loop's entry, with what a case at `path` says instead."""
        fields: dict[str, Any] = {}
        tuning: dict[str, float] = {}
        for given in (loop.controller, case):
            if given is not None:
                fields |= self.controllers.keys(given, path)
                tuning |= self.controllers.tuning(given, path, fields.get("form", "ideal"))
        made = self.controllers.pid(path, fields, tuning)
        if made is None or not self.controllers.sampled(made, None, path, loop.sample_time):
            return None
        return made

    def acts(self, cascade: Cascade, primary: Path | None, secondary: Path | None) -> None:
        """Refuse controllers that act the wrong way, of the paths given; the primary acts through the scale."""
        outer = replace(cascade.primary.plant, gain=cascade.primary.plant.gain * cascade.scale)
        for path, plant, loop in (
            (primary, outer, cascade.primary),
            (secondary, cascade.secondary.plant, cascade.secondary),
        ):
            wrong = wrong_way(plant, loop.controller)
            if wrong is not None and path is not None:
                self.refusals.refuse(path, f"{loop.controller.action} action given; {wrong}")


class _Cases:
    """Reads the cases of one cascade."""

    def __init__(self, builder: Builder, entry: schema.Cascade, cascade: Cascade, objective: Objective | None) -> None:
        self.builder, self.refusals = builder, builder.refusals
        self.entry, self.cascade, self.objective = entry, cascade, objective
        self.reader = _Reader(builder.refusals, builder.controllers)

    def jobs(self, cases: Sequence[object]) -> list[CascadeJob]:
        """Return the cases that can be made."""
        found: list[CascadeJob] = []
        names: dict[str, int] = {}
        for i, case in enumerate(cases):
            path: Path = ("cases", i)
            plain = isinstance(case, schema.GivenCase) and case.model_fields_set <= {"name", "note"}
            if not plain and not isinstance(case, schema.CascadedCase):
                what = "a case of a single loop given; a cascade's holds primary and secondary, or tune_cascade"
                self.refusals.refuse(path, what)
                continue
            assert isinstance(case, schema.GivenCase | schema.CascadedCase)  # noqa: S101
            name = case.name.strip()
            if name in names:
                self.refusals.refuse((*path, "name"), f"{name!r} given; cases[{names[name]}] has this name already")
            names.setdefault(name, i)
            cascade: Cascade | None = self.cascade
            tune = None
            if isinstance(case, schema.CascadedCase):
                cascade = self._under(case, path)
                if case.tune_cascade is not None and cascade is not None:
                    tune = self._tune(case.tune_cascade, (*path, "tune_cascade"), cascade)
                    if tune is None:
                        continue
            if cascade is not None:
                found.append(CascadeJob(name, self.builder.place(path), cascade, tune, case.note))
        return found

    def _under(self, case: schema.CascadedCase, path: Path) -> Cascade | None:
        pids: dict[str, PID | None] = {"primary": None, "secondary": None}
        for name in pids:
            given = getattr(case, name)
            if given is not None:
                own: schema.CascadeLoop = getattr(self.entry, name)
                pids[name] = self.reader.controller(own, (*path, name), given)
                if pids[name] is None:
                    return None
        made = self.cascade.with_controllers(**pids)
        # A case that says nothing of the action has that of the loop's entry, where it is refused already.
        said = {name for name in pids if (given := getattr(case, name)) is not None and given.action is not None}
        self.reader.acts(made, *((*path, name) if name in said else None for name in pids))
        return made

    def _tune(self, given: schema.TuneCascade, path: Path, cascade: Cascade) -> CascadeTuneJob | None:
        primary = self._part(given.primary, (*path, "primary"), cascade.primary.controller)
        inner = None
        if given.secondary is not None:
            under = (*path, "secondary")
            wishes = self._part(given.secondary, under, cascade.secondary.controller)
            experiment = self.builder.experiments.plain(given.secondary.experiment, (*under, "experiment"))
            if wishes is None or experiment is None:
                return None
            inner = self._fitting(experiment, (*under, "experiment"), cascade), *wishes
        if primary is None:
            return None
        return CascadeTuneJob(primary[1], primary[0], inner, given.seed, given.restarts, given.digits)

    def _fitting(self, experiment: Experiment, path: Path, cascade: Cascade) -> Experiment:
        self.refusals.attempt(path, lambda: signals(cascade.secondary, experiment))
        return experiment

    def _part(self, given: schema.CascadeTunePart, path: Path, start: PID) -> tuple[Objective, Bounds] | None:
        """Return what a loop is tuned for, and within what bounds."""
        fixed = {} if given.Td is None else {"Td": given.Td}
        bounds = self.builder.controllers.bounds(given.bounds, path, start.form, fixed)
        own = self.builder.controllers.objective(given.objective, (*path, "objective"))
        if bounds is None or (given.objective is not None and own is None):
            return None
        for name in ("Ti", "Td") if self.builder.controllers.gain_refused else ("Kc", "Ti", "Td"):
            low, high = getattr(bounds, name)
            value = getattr(start, name)
            if low < high and not low <= value <= high:
                what = f"[{low:g}, {high:g}] excludes the start, {name} = {value:g}; widen the bounds"
                self.refusals.refuse((*path, "bounds", name), what)
        return own or self.objective or Objective(), bounds
