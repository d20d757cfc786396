"""What takes long, as functions of plain values for a process of its own: read, estimate, tune, map, report.

Each takes a scenario's text and the folder that its data lies in, so that a worker checks what it is given by the same
loader; each returns a frozen value of arrays and texts that can be sent back.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workbench.errors import ScenarioError
from workbench.model.controller import PID
from workbench.model.front import FrontPoint
from workbench.model.loop import Loop
from workbench.model.plant import Plant
from workbench.model.record import FloatArray, Record
from workbench.model.valve import Valve
from workbench.report.tables import Table
from workbench.scenario.loader import read_scenario
from workbench.scenario.plan import Scenario

__all__ = [
    "TASKS",
    "Found",
    "FrontFound",
    "MapFound",
    "Progress",
    "ReadRecord",
    "Report",
    "Task",
    "TunedCase",
    "estimate_record",
    "map_tunings",
    "read_data",
    "trade_off",
    "tune_loop",
    "write_html",
]

Progress = Callable[[str, float], None]
NEAR = 0.15  # of a place to a point of the front: the sum of both differences of logarithms
FILE = "screen.yaml"


@dataclass(frozen=True, eq=False)
class ReadRecord:
    """A record as it was read: signals of shape (N,), and in words what was kept. sp: None where not recorded."""

    source: str
    summary: tuple[str, ...]
    time: FloatArray
    pv: FloatArray
    op: FloatArray
    sp: FloatArray | None
    sample_time: float


@dataclass(frozen=True, eq=False)
class Found:
    """An estimate as the page shows it: signals of shape (N,), the profile over d, tables and sentences.

    action: the controller's, as the gain found needs. linear: the prediction that ignores stiction.
    """

    record: ReadRecord
    plant: Plant
    valve: Valve
    action: str
    verdict: str
    sentences: tuple[str, ...]
    reasons: tuple[str, ...]
    stem: FloatArray
    prediction: FloatArray
    linear: FloatArray
    profile_d: FloatArray
    profile_cost: FloatArray
    parameters: Table
    detection: str
    evidence: Table


@dataclass(frozen=True, slots=True)
class TunedCase:
    """A tuning found: the controller to type in, whether it was verified, and in words how it fares.

    primary: of a cascade, whose secondary's is `controller` then.
    """

    controller: PID
    success: bool
    status: str
    lines: tuple[str, ...]
    objective: float
    start_objective: float
    primary: PID | None = None


@dataclass(frozen=True, eq=False)
class MapFound:
    """A map of tunings: Kc (shape (M,), %/EU) and values (shape (R,), s) of the axis; figures of shape (R, M).

    outcome: place in `model.cycle_map.OUTCOMES`. text: what it shows, in sentences.
    """

    axis: str
    Kc: FloatArray
    values: FloatArray
    outcome: FloatArray
    stable: FloatArray
    figures: dict[str, FloatArray]
    text: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class FrontFound:
    """The least error that each amount of valve travel buys, and where the cases lie; means over random circumstances.

    sticky and repaired: points of both fronts, by rising travel. cases: (name, mean valve travel in %, mean square
    error in EU^2; nan for one that does not hold every plant), the page's own first. text: what it shows.
    """

    sticky: tuple[FrontPoint, ...]
    repaired: tuple[FrontPoint, ...]
    cases: tuple[tuple[str, float, float], ...]
    text: tuple[str, ...]

    def near(self, travel: float, error: float) -> FrontPoint | None:
        """Return the point of the valve as it is that lies closest, None where none is near; both are above 0."""
        points = [p for p in self.sticky if p.valve_travel > 0.0 and p.mean_square_error > 0.0]
        away = [abs(math.log(p.valve_travel / travel)) + abs(math.log(p.mean_square_error / error)) for p in points]
        return points[away.index(min(away))] if points and min(away) < NEAR else None


@dataclass(frozen=True, slots=True)
class Report:
    """A report's page, in one piece."""

    html: str


def _plan(text: str, folder: str) -> Scenario:
    return read_scenario(text, Path(folder) / FILE, FILE)


def _record(plan: Scenario) -> Record:
    record = plan.estimates[0].record if plan.estimates else None
    if record is None:
        raise ScenarioError("no record was given")
    return record


def _read(record: Record) -> ReadRecord:
    return ReadRecord(record.source, record.summary(), record.time, record.pv, record.op, record.sp, record.sample_time)


def read_data(text: str, folder: str, progress: Progress) -> ReadRecord:
    """Return the record that a scenario's first estimate names. Raises `ScenarioError` in the reader's own words."""
    progress("reading", 0.1)
    return _read(_record(_plan(text, folder)))


def estimate_record(text: str, folder: str, progress: Progress) -> Found:
    """Return the estimate that a scenario asks for, with the evidence. Raises `WorkbenchError`."""
    from workbench.detect.detect import detect
    from workbench.estimate.estimate import estimate
    from workbench.model.study import NamedEstimate
    from workbench.report.detections import detection_table, detection_words
    from workbench.report.estimates import estimate_sentences, estimate_table
    from workbench.report.known import known_sentences
    from workbench.report.words import sentences
    from workbench.scenario.controllers import fitting_action

    progress("reading", 0.0)
    plan = _plan(text, folder)
    job, record = plan.estimates[0], _record(plan)
    found = estimate(
        record,
        method=job.method,
        valve=job.valve,
        plant=job.plant,
        start=job.start,
        progress=lambda share: progress("estimating", 0.9 * share),
    )
    progress("gathering the evidence", 0.9)
    evidence = detect(record)
    named = NamedEstimate(job.name, found, detection=evidence)
    return Found(
        record=_read(record),
        plant=found.plant,
        valve=found.valve,
        action=fitting_action(found.plant),
        verdict=found.verdict,
        sentences=(*estimate_sentences(named), *known_sentences(found)),
        reasons=tuple(sentences([reason]) for reason in found.reasons),
        stem=found.valve_position,
        prediction=found.prediction,
        linear=found.linear.prediction,
        profile_d=found.profile_d,
        profile_cost=found.profile_cost,
        parameters=estimate_table(named),
        detection=detection_words(named, evidence),
        evidence=detection_table(evidence),
    )


def tune_loop(text: str, folder: str, progress: Progress) -> TunedCase:
    """Return the tuning that a scenario's last case asks for; stopped, the best so far. Raises `WorkbenchError`."""
    from workbench.report.words import change, controller_words, figure, sentences
    from workbench.scenario.retune import run_words
    from workbench.scenario.runner import tune_case

    plan = _plan(text, folder)
    if plan.cascade:
        return _tune_in_turn(plan, progress)
    job = plan.cases[-1].tune
    if plan.loop is None or plan.experiment is None or job is None:
        raise ScenarioError("no tuning was asked for")
    tuned = tune_case(plan.loop.with_controller(plan.cases[-1].controller), plan.experiment, job, progress)
    over = " over the ensemble" if tuned.ensemble is not None else ""
    gained = change(tuned.objective, tuned.start_objective)
    cost = (
        f"J {figure(tuned.objective, 5)}{over}, {gained} against the tuning on the page "
        f"({figure(tuned.start_objective, 5)}); worst near by {figure(tuned.worst, 5)}."
    )
    told = f"In the run on the page: {run_words(tuned)}."
    lines = [controller_words(tuned.controller, tuned.digits), cost, told, sentences([tuned.message])]
    if tuned.robustness is not None:
        fares = tuned.robustness
        lines.append(
            f"On fresh draws: median mean square error {figure(fares.mse_median)} EU², median valve travel "
            f"{figure(fares.travel_median)} %, Ms at the worst corner {figure(fares.max_sensitivity, 3)}."
        )
    return TunedCase(
        tuned.controller,
        tuned.status.success,
        tuned.status.value,
        tuple(lines),
        tuned.objective,
        tuned.start_objective,
    )


def _tune_in_turn(plan: Scenario, progress: Progress) -> TunedCase:
    from workbench.report.words import change, controller_words, error_and_wear, figure, sentences
    from workbench.scenario.cascade_runner import tune_job
    from workbench.simulate.run import simulate

    job = plan.cascade[-1]
    if plan.experiment is None or job.tune is None:
        raise ScenarioError("no tuning was asked for")
    tuned = tune_job(job.cascade, plan.experiment, job.tune, progress)
    found, digits = tuned.primary, tuned.primary.digits
    above, below = tuned.cascade.primary.controller, tuned.cascade.secondary.controller
    of_secondary = [] if tuned.secondary is None else [f"Secondary: {sentences([tuned.secondary.message])}"]
    cost = (
        f"J {figure(found.objective, 5)}, {change(found.objective, tuned.start_objective)} against the tuning on the "
        f"page ({figure(tuned.start_objective, 5)}); worst near by {figure(found.worst, 5)}."
    )
    # A diverging cascade overflows; its figures say so.
    with np.errstate(over="ignore", invalid="ignore"):
        now, was = (simulate(cascade, plan.experiment) for cascade in (tuned.cascade, job.cascade))
    errors = now.primary.kpis.mean_square_error, was.primary.kpis.mean_square_error
    travels = now.secondary.kpis.valve_travel, was.secondary.kpis.valve_travel
    lines = (
        f"Secondary: {controller_words(below, None if tuned.secondary is None else digits)}",
        f"Primary: {controller_words(above, digits, job.cascade.output_unit)}",
        cost,
        f"In the run on the page: {error_and_wear(errors, travels)}.",
        *of_secondary,
        f"Primary: {sentences([found.message])}",
    )
    both = found.status if tuned.secondary is None or tuned.secondary.status.success else tuned.secondary.status
    return TunedCase(below, both.success, both.value, lines, found.objective, tuned.start_objective, above)


def map_tunings(text: str, folder: str, progress: Progress) -> MapFound:
    """Return the map of Kc and Ti around a scenario's cases. Raises `WorkbenchError`."""
    from workbench.analyze.cycle_map import cycle_map, map_ranges
    from workbench.report.plain_truth import map_text

    plan = _plan(text, folder)
    if plan.loop is None or plan.cycle_map is None:
        raise ScenarioError("no map was asked for")
    loop: Loop = plan.loop
    asked = {"Kc": plan.cycle_map.Kc, "Ti": plan.cycle_map.Ti}
    given = {name: pair for name, pair in asked.items() if pair is not None}
    ranges = map_ranges(loop, [case.controller for case in plan.cases]) | given
    found = cycle_map(
        loop,
        **ranges,
        points=plan.cycle_map.points,
        starts=plan.cycle_map.starts,
        progress=lambda share: progress("following every tuning", share),
    )
    names = ("period", "pv_peak_to_peak", "mean_square_error", "travel_per_hour")
    return MapFound(
        axis=found.axis,
        Kc=found.Kc,
        values=found.values,
        outcome=found.outcome.astype(np.float64),
        stable=found.linear_stable.astype(np.float64),
        figures={name: np.where(found.cycles, getattr(found, name), np.nan) for name in names},
        text=tuple(map_text(found)),
    )


def trade_off(text: str, folder: str, progress: Progress) -> FrontFound:
    """Return the fronts of a scenario's loop, and where its cases lie; stopped, those so far. Raises `WorkbenchError`.

    The ensemble is the loop's "plant-ready" one.
    """
    from workbench.model.ensemble import Ensemble
    from workbench.model.study import CaseResult, Study
    from workbench.report.over_ensemble import front_text
    from workbench.scenario.over_ensemble import front_of, with_robustness
    from workbench.simulate.run import simulate

    plan = _plan(text, folder)
    if plan.loop is None or plan.experiment is None:
        raise ScenarioError("no loop was given")
    progress("the cases", 0.0)
    cases = []
    # A diverging loop overflows; its figures say so.
    with np.errstate(over="ignore", invalid="ignore"):
        for job in plan.cases:
            loop = plan.loop.with_controller(job.controller)
            cases.append(CaseResult(job.name, loop, simulate(loop, plan.experiment)))
        ensemble = Ensemble.plant_ready(cases[0].loop)
        cases = with_robustness(cases, ensemble, None, lambda words, share: progress(words, 0.1 * share))
        front = front_of(cases, plan.cases, ensemble, lambda words, share: progress(words, 0.1 + 0.9 * share))
    study = Study("", "", "", "", plan.experiment, None, (), tuple(cases), front=front)
    # A case that diverges in some draw would flatten the others; the sentences name it.
    fares = [(c.name, c.robustness) for c in cases if c.robustness is not None]
    held = [(name, r if r.stable and not r.diverged else None) for name, r in fares]
    placed = [(name, *((r.travel_mean, r.mse_mean) if r is not None else (math.nan, math.nan))) for name, r in held]
    drawn = f"Means over {front.fresh.draws:,} random steps, loads, noises, plants and valves that no search has seen."
    return FrontFound(front.sticky, front.repaired, tuple(placed), (drawn, *front_text(study)))


def write_html(text: str, folder: str, progress: Progress) -> Report:
    """Run a scenario and return its report's page; what is written stays below `folder`. Raises `WorkbenchError`."""
    from workbench.report.page import write_report
    from workbench.scenario.runner import run_scenario

    study = run_scenario(_plan(text, folder), progress=progress)
    target = Path(folder) / ".report"  # which no file that was opened is called
    write_report(study, target)
    return Report((target / "report.html").read_text(encoding="utf-8"))


Task = Callable[[str, str, Progress], object]
TASKS: dict[str, Task] = {
    "read": read_data,
    "estimate": estimate_record,
    "tune": tune_loop,
    "map": map_tunings,
    "front": trade_off,
    "report": write_html,
}
