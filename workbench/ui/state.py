"""One session's state: the screen with its past, what it means, and the runs and figures that follow from it.

No widgets and no server here: what the page shows can be asked of this alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from workbench.errors import InvalidValue, ScenarioError, WorkbenchError
from workbench.kpi.kpis import cascade_event, last_event
from workbench.model.cascade import Cascade
from workbench.model.checks import reads_as_number
from workbench.model.controller import PID
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.plant import Plant
from workbench.model.results import Run
from workbench.model.titles import KPI_ROWS
from workbench.model.tuning import Objective
from workbench.model.valve import Valve
from workbench.report.cascade import cascade_figure, cascade_rows
from workbench.report.judge import band_words
from workbench.report.tables import printed, shown
from workbench.report.words import change, controller_words, decimals_of
from workbench.scenario.controllers import wrong_way
from workbench.scenario.document import parse, plain
from workbench.scenario.loader import read_scenario, refuse_manifest
from workbench.simulate.run import evaluate, simulate
from workbench.ui.doubts import doubt_of
from workbench.ui.fields import field_of, parted
from workbench.ui.given import files_named, find_file, safe_name
from workbench.ui.load import (
    NO_LOOP_YET,
    Loaded,
    controller_entries,
    plant_entries,
    screen_of,
    time_entry,
    valve_entries,
)
from workbench.ui.screen import MapView, Pinned, Screen, scenario_text

__all__ = ["MOST_CASES", "ROWS", "Built", "CaseRun", "Problem", "Session", "problems_of", "unplaced", "value_of"]

MOST_CASES = 12
MOST_UNDONE = 200
MODEL_DIGITS = 5  # of an estimate on the page: far more than any record pins down
FILE = Path("screen.yaml")  # the name under which the page's own scenario is read
UNPUBLISHED = (
    "The cases' published figures are of the loop, experiment and weights as the scenario gives them, and are left out "
    "for what stands here now."
)
# Name, title, unit, whether less is better; of a cascade the loop stands before the name.
Rows = tuple[tuple[str, str, str, bool], ...]
ROWS: Rows = (("objective", "Objective J", "", True), *KPI_ROWS)
CASCADE_ROWS: Rows = (
    ROWS[0],
    *(
        (f"{which}.{name}", title, unit.removesuffix(" of the secondary"), less)
        for which, name, title, unit, less in cascade_rows()
    ),
)


@dataclass(frozen=True, slots=True)
class Problem:
    """What is wrong: the field that it is about ("" where none is), and the loader's words."""

    field: str
    text: str


@dataclass(frozen=True, eq=False)
class Built:
    """What a screen means: the loop under the page's own controller, and what is done to it.

    cascade: of which `loop` is the secondary, or None.
    """

    loop: Loop
    experiment: Experiment
    objective: Objective
    cascade: Cascade | None = None


@dataclass(frozen=True, eq=False)
class CaseRun:
    """One tuning's exact simulation; run is None where the loop as it stands does not take it, `refused` says why.

    run: of the loop that holds the valve, a cascade's secondary; primary: the controller above it, above: its run,
    cascade: both loops.
    """

    name: str
    controller: PID
    run: Run | None
    objective: float
    refused: str = ""
    primary: PID | None = None
    above: Run | None = None
    cascade: Cascade | None = None

    @property
    def outer(self) -> Run | None:
        """The run whose error counts: the primary's, or the single loop's."""
        return self.run if self.primary is None else self.above

    @property
    def words(self) -> str:
        """The tuning, in words."""
        own = controller_words(self.controller)
        if self.primary is None:
            return own
        out = "EU" if self.cascade is None else self.cascade.output_unit
        return f"primary {controller_words(self.primary, out=out)}; secondary {own}"


def unplaced(line: str) -> str:
    """Return a refusal's line without its place in the page's own scenario: `where: what is wrong`.

    The case that the page makes for its own controller, or for a tuning, is nothing that anyone has seen.
    """
    place, _, text = line.partition(": ")
    return re.sub(r"^cases\[0\](\.|: )", "", text) if text and place.startswith(str(FILE)) else line


def problems_of(error: ScenarioError, entries: Mapping[str, str] | None = None) -> tuple[Problem, ...]:
    """Return a refusal's lines, `unplaced`. entries: what stands on the page, which hides some fields."""
    found = []
    for text in map(unplaced, str(error).splitlines()):
        where = text.split(": ", 1)[0]
        found.append(Problem(field_of(where, entries) or "", text))
    return tuple(found)


class Session:
    """What one browser tab shows. Sessions share nothing."""

    def __init__(self, loaded: Loaded | None = None) -> None:
        self.screen = Screen()
        self.past: list[tuple[Screen, tuple[str, ...]]] = []
        self.gesture = ""
        self.problems: tuple[Problem, ...] = ()
        self.stale = False  # whether what stands here was refused, and the last good run shows
        self.notes: tuple[str, ...] = ()
        self.built: Built | None = None
        self.own: CaseRun | None = None
        if loaded is not None:
            self.screen, self.notes = loaded.screen, loaded.notes
        self._build()
        self._publish()

    # changes -------------------------------------------------------------------------------------------------------

    def change(self, entries: Mapping[str, str], gesture: str = "") -> None:
        """Take typed texts by path. Changes of one gesture, such as a slider's, are undone together.

        What the loader refuses stays typed, with `problems` saying why, beside the last run that was good. Raises
        KeyError for an unknown path.
        """
        self._become(self.screen.with_entries(parted(entries, self.screen.entries)), gesture)

    def undo(self) -> bool:
        """Go back to the screen before the last change; False where there is none."""
        if not self.past:
            return False
        (self.screen, self.notes), self.gesture = self.past.pop(), ""
        self._build()
        return True

    def pin(self, name: str, controller: PID | None = None, note: str = "", primary: PID | None = None) -> None:
        """Keep a controller (the page's own by default) as a case, of a cascade both. Raises `WorkbenchError`."""
        if controller is None:
            built = self._whole()
            controller = built.loop.controller
            primary = None if built.cascade is None else built.cascade.primary.controller
        if len(self.screen.cases) >= MOST_CASES:
            raise InvalidValue("cases", f"{MOST_CASES + 1} cases", f"must be at most {MOST_CASES}; remove one first")
        self._with_cases((*self.screen.cases, Pinned(name.strip(), controller, note, primary=primary)))

    def place(self, key: int) -> int | None:
        """Return where a pinned case stands; None where it is gone."""
        return next((i for i, case in enumerate(self.screen.cases) if case.key == key), None)

    def rename(self, index: int, name: str) -> None:
        """Give a pinned case another name. Raises `WorkbenchError`."""
        cases = list(self.screen.cases)
        cases[index] = replace(cases[index], name=name.strip())
        self._with_cases(tuple(cases))

    def remove(self, index: int) -> None:
        """Remove a pinned case."""
        self._with_cases(tuple(case for i, case in enumerate(self.screen.cases) if i != index))

    def move(self, index: int, to: int) -> None:
        """Put a pinned case in another place; the first is the base of comparison."""
        cases = list(self.screen.cases)
        cases.insert(min(max(to, 0), len(cases) - 1), cases.pop(index))
        self._with_cases(tuple(cases))

    def show(self, index: int) -> None:
        """Put a pinned case's controller on the page; of a cascade both."""
        self.use(self.screen.cases[index].controller, self.screen.cases[index].primary)

    def use(self, controller: PID, primary: PID | None = None) -> None:
        """Put a controller on the page; of a cascade both."""
        if primary is None:
            self.change(controller_entries(controller))
            return
        entries = controller_entries(primary, "cascade.primary.controller")
        self.change(entries | controller_entries(controller, "cascade.secondary.controller"))

    def use_tuning(self, Kc: float, value: float, axis: str) -> None:
        """Put a map's tuning, in %/EU and s, on the page, at three digits."""
        entries = {"loop.controller.Kc": f"{Kc:.3g}", "loop.controller.Kc.unit": "%/EU"}
        self.change(entries | time_entry(f"loop.controller.{axis}", float(f"{value:.3g}")))

    def use_model(self, plant: Plant, valve: Valve, sample_time: float, action: str, record: str) -> None:
        """Put an estimated plant and valve on the page, at `MODEL_DIGITS`, with the action that the gain needs.

        record: what they were found in; where the scenario named another one, what it says of its loop is left out.
        """
        entries = {
            path: f"{float(text):.{MODEL_DIGITS}g}" if reads_as_number(text) else text
            for path, text in (plant_entries(plant) | valve_entries(valve)).items()
        }
        entries |= time_entry("loop.sample_time", sample_time) | {"loop.controller.action": action}
        # No round duration need be a whole number of a record's samples.
        duration = self.built.experiment.duration if self.built is not None else 1000.0 * sample_time
        samples = max(round(duration / sample_time), 1)
        entries |= time_entry("experiment.duration", samples * sample_time)
        entries["loop.coarse_sampling"] = "true"  # the record's sampling is what it is
        # A loop that was found is linear, with the valve's sign in its gain, and executes at every sample.
        entries |= {"loop.characteristic.type": "linear", "loop.fail_open": "false", "loop.scan": "1"}
        screen, notes = self.screen.with_entries(entries), tuple(n for n in self.notes if n != NO_LOOP_YET)
        if record != safe_name(screen.record):
            cases = tuple(replace(case, note="", reference=MappingProxyType({})) for case in screen.cases)
            title, notes = f"The loop found in {record}", ()
            screen = replace(screen, title=title, description="", reference_source="", cases=cases, record=record)
        # A cascade's cases are none of the loop that was found.
        self._become(replace(screen, cascade=False, cases=()) if screen.cascade else screen, "")
        self._publish()
        self.notes = notes

    def load(self, loaded: Loaded) -> None:
        """Show another scenario; what stood here before can be had back."""
        self._become(loaded.screen, "")
        self._publish()
        self.notes = loaded.notes

    def _publish(self) -> None:
        """Take what stands here now as that which the cases' published figures are of."""
        self.screen = replace(self.screen, published_of=None if self.stale else _published_of(self.built))

    @property
    def compared(self) -> Screen:
        """The screen without published figures where these are not of what stands on it now."""
        screen = self.screen
        if self.built is not None and screen.published_of == _published_of(self.built):
            return screen
        cases = tuple(replace(case, reference=MappingProxyType({})) for case in screen.cases)
        return replace(screen, reference_source="", cases=cases)

    def _become(self, screen: Screen, gesture: str) -> None:
        if not gesture or gesture != self.gesture:
            self.past = [*self.past[-MOST_UNDONE + 1 :], (self.screen, self.notes)]
        self.gesture = gesture
        self.screen = screen
        self._build()

    def _with_cases(self, cases: tuple[Pinned, ...]) -> None:
        """Take these cases if a scenario may hold them: names that differ and are not blank."""
        wanted = replace(self.screen, cases=cases)
        try:
            read_scenario(scenario_text(replace(Screen(), cascade=self.screen.cascade, cases=cases)), FILE)
        except ScenarioError as error:
            # The first case there is the page's own, so that a pinned one's number is its place.
            texts = (re.sub(r"^cases\[\d+\]\.", "", problem.text) for problem in problems_of(error))
            raise ScenarioError("\n".join(re.sub(r"\bcases\[(\d+)\]", r"case \1", text) for text in texts)) from None
        self._become(wanted, "")

    # what follows --------------------------------------------------------------------------------------------------

    def _build(self) -> None:
        """Read the screen and simulate it; where it is refused the last good run stays."""
        try:
            plan = read_scenario(scenario_text(self.screen, cases=False), FILE)
        except ScenarioError as error:
            self.problems, self.stale = problems_of(error, self.screen.entries), True
            return
        self.stale = False
        cascade = plan.cascade[0].cascade if plan.cascade else None
        loop = plan.loop if cascade is None else cascade.secondary
        if loop is None or plan.experiment is None or plan.objective is None:
            raise AssertionError("a page's scenario holds a loop, an experiment and an objective")
        self.built = Built(loop, plan.experiment, plan.objective, cascade)
        # What can be run and was most likely meant otherwise is said beside the run.
        said = [Problem("loop.controller.action", text) for text in plan.warnings]
        said += [Problem(field_of(one.where, self.screen.entries) or "", one.text) for one in plan.cautions]
        self.problems = tuple(said)
        self.own = self._run("On screen", loop.controller, None if cascade is None else cascade.primary.controller)
        if self.own.refused:
            self.problems = (*self.problems, Problem("", self.own.refused))

    def _whole(self) -> Built:
        if self.built is None or self.stale or (self.own is not None and self.own.refused):
            raise ScenarioError("\n".join(p.text for p in self.problems) or "nothing to show")
        return self.built

    def _wrong_way(self, one: CaseRun) -> str:
        """Return what is wrong where a single loop's tuning acts the wrong way, "" where it does not."""
        if self.built is None or self.built.cascade is not None:
            return ""
        loop = self.built.loop
        return wrong_way(loop.plant, one.controller, fail_open=loop.fail_open) or ""

    def _run(self, name: str, controller: PID, primary: PID | None = None) -> CaseRun:
        built = self.built
        assert built is not None  # noqa: S101 - only asked for once something was built
        if built.cascade is not None:
            return _cascade_run(name, controller, primary, built, built.cascade)
        try:
            loop = built.loop.with_controller(controller)
            # A diverging loop overflows; its figures say so.
            with np.errstate(over="ignore", invalid="ignore"):
                run = simulate(loop, built.experiment)
                cost = float(evaluate(loop, built.experiment, built.objective)[0])
        except WorkbenchError as error:
            return CaseRun(name, controller, None, math.nan, str(error))
        return CaseRun(name, controller, run, cost)

    def runs(self) -> list[CaseRun]:
        """Return the pinned cases under the loop and experiment as they stand, in order."""
        if self.built is None:
            return []
        return [self._run(case.name, case.controller, case.primary) for case in self.screen.cases]

    @property
    def rows(self) -> Rows:
        """The figures of what stands on the page: `ROWS` or `CASCADE_ROWS`, the settling time with its band."""
        if self.built is None:
            return ROWS
        loop, cascade, experiment = self.built.loop, self.built.cascade, self.built.experiment
        event = last_event(loop, experiment) if cascade is None else cascade_event(cascade, experiment)
        into = "" if event is None else f", into {band_words(event)}"
        return tuple(
            (name, title + into if name.endswith("settling_time") else title, unit, less)
            for name, title, unit, less in (ROWS if cascade is None else CASCADE_ROWS)
        )

    def figures(self) -> list[dict[str, str]]:
        """Return the figures of the page's own run: name, title, unit, value as text, and why it is none to go by."""
        if self.own is None or self.own.run is None:
            return []
        values = [_shown(self.own, name) for name, *_ in self.rows]
        return [
            {
                "name": name,
                "title": title,
                "unit": unit,
                "text": shown(name.rpartition(".")[2], value),
                "doubt": doubt_of(self.own, name),
            }
            for (name, title, unit, _), value in zip(self.rows, values, strict=True)
            if not math.isnan(value)
        ]

    def comparison(self, runs: list[CaseRun]) -> dict[str, object]:
        """Return the table of the pinned cases and the page's own: heads, rows of cells, and a note on it or "".

        A cell is (text, why it is none to go by or "", difference from the first case in words, whether it is the least
        of a figure of which less is better, published figure). One in doubt is compared with no other.
        """
        columns = [*runs, *([self.own] if self.own is not None else [])]
        cases = self.compared.cases
        rows: list[dict[str, object]] = []
        for name, title, unit, less in self.rows:
            values = [_shown(one, name) for one in columns]
            if all(math.isnan(v) for v in values):
                continue
            doubts = [doubt_of(one, name) for one in columns]
            finite = [v for v, doubt in zip(values, doubts, strict=True) if math.isfinite(v) and not doubt]
            best = min(finite) if less and len(finite) > 1 else math.nan
            decimals = decimals_of([case.reference[name] for case in cases if name in case.reference])
            cells = []
            for i, value in enumerate(values):
                published = cases[i].reference.get(name) if i < len(cases) else None
                differs = i > 0 and math.isfinite(value - values[0]) and not (doubts[i] or doubts[0])
                cells.append(
                    {
                        "text": shown(name.rpartition(".")[2], value),
                        "doubt": doubts[i],
                        "difference": change(value, values[0]) if differs else "",
                        "best": value == best and not doubts[i],
                        "published": "" if published is None else printed(name, published, decimals),
                    }
                )
            rows.append({"title": title, "unit": unit, "cells": cells})
        keys = [case.key for case in cases] + [None] * (len(columns) - len(cases))
        heads = [
            {"name": one.name, "settings": one.words, "refused": one.refused or self._wrong_way(one), "case": key}
            for one, key in zip(columns, keys, strict=True)
        ]
        left_out = any(case.reference for case in self.screen.cases) and not any(case.reference for case in cases)
        return {"heads": heads, "rows": rows, "note": UNPUBLISHED if left_out else ""}

    # scenarios -----------------------------------------------------------------------------------------------------

    def scenario(self) -> str:
        """Return the page as a scenario. Raises `ScenarioError` where it is refused."""
        return self._checked(scenario_text(self.compared))

    def mapped(self, view: MapView | None) -> str:
        """Return the page as a scenario with a map; view: of these ends of Kc (%/EU) and Ti (s). Raises as it does."""
        return self._checked(scenario_text(self.compared, mapped=True, view=view))

    def _checked(self, text: str) -> str:
        try:
            read_scenario(text, FILE)
        except ScenarioError as error:
            raise ScenarioError("\n".join(problem.text for problem in problems_of(error))) from None
        return text

    def tuning(self) -> str:
        """Return the scenario of the tuning asked for. Raises `ScenarioError`; `problems` then says where."""
        text = scenario_text(self.screen, tune=True)
        try:
            read_scenario(text, FILE)
        except ScenarioError as error:
            self.problems = problems_of(error, self.screen.entries)
            raise ScenarioError("\n".join(problem.text for problem in self.problems)) from None
        return text

    def read(self, text: str, path: Path) -> str:
        """Show the scenario of a text, as if it stood in the file `path`; return the record that it names, or "".

        Files that it names must have been opened into that file's folder, by whatever path it names them below it: a
        scenario that comes from elsewhere looks at nothing else here. Raises `ScenarioError`.
        """
        root, _ = parse(text)
        data = None if root is None else plain(root)
        refuse_manifest(data, path.name)
        for named in files_named(data):
            find_file(path, named)
        loaded = screen_of(read_scenario(text, path, path.name))
        self.load(loaded)
        return loaded.data


def _published_of(built: Built | None) -> object:
    """Return all of what stands on a page but the tunings."""
    if built is None:
        return None
    loops = (built.loop,) if built.cascade is None else (built.cascade.primary, built.cascade.secondary)
    bare = tuple(loop.with_controller(PID(0.0, math.inf)) for loop in loops)
    more = None if built.cascade is None else (built.cascade.scale, built.cascade.anti_windup)
    return bare, more, built.experiment, built.objective


def _cascade_run(name: str, below: PID, above: PID | None, built: Built, cascade: Cascade) -> CaseRun:
    from workbench.tune.cascade import evaluate_cascade  # casadi: only where there is a cascade

    try:
        cascade = cascade.with_controllers(above, below)
        # A diverging cascade overflows; its figures say so.
        with np.errstate(over="ignore", invalid="ignore"):
            run = simulate(cascade, built.experiment)
            cost = float(evaluate_cascade(cascade, built.experiment, built.objective))
    except WorkbenchError as error:
        return CaseRun(name, below, None, math.nan, str(error), above, None, cascade)
    return CaseRun(name, below, run.secondary, cost, "", above, run.primary, cascade)


def _shown(one: CaseRun, name: str) -> float:
    """Return a figure in the unit that `Session.rows` gives it."""
    which, _, own = name.rpartition(".")
    if one.above is None or one.cascade is None or which != "primary":
        return value_of(one, name)
    return cascade_figure(one.above.kpis, which, own, one.cascade.scale)


def value_of(one: CaseRun, name: str) -> float:
    """Return a figure of `Session.rows` as the run has it; nan where there is no run."""
    which, _, own = name.rpartition(".")
    run = one.outer if which == "primary" else one.run
    if run is None:
        return math.nan
    return one.objective if name == "objective" else float(getattr(run.kpis, own))
