"""`wb.pareto_front`: how much error each amount of valve travel buys, over an ensemble, sticky and repaired.

One evolving archive serves all amounts of travel at once, so that it costs little more than one robust tuning. Trials
start from tunings spread evenly along the front so far and move by differences of their neighbours on it; what breaks a
constraint never enters. First on few draws, then, at the digits to type in, on all; the figures of the result are
measured on draws that no search has seen. The choice of parents after K. Deb et al., "A fast and elitist multiobjective
genetic algorithm: NSGA-II", IEEE Trans. Evol. Comput. 6 (2002) 182-197, with spacing along the front in place of the
crowding distance.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InvalidValue
from workbench.model.checks import all_of, callback, instance, number, whole
from workbench.model.controller import PID
from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.experiment import Experiment
from workbench.model.front import Front, FrontPoint
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.results import SolveStatus
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Ideal
from workbench.tune.budget import OutOfBudget, Progress, deadline
from workbench.tune.ensemble import Circumstances
from workbench.tune.problem import Problem
from workbench.tune.repair import usual_bounds
from workbench.tune.robust import DEFAULT_CONSTRAINTS, Judge, fresh_draws, guesses

__all__ = ["alike", "pareto_front"]

# Trials a generation; generations on few and on all draws; how few; random tunings to begin with.
TRIALS, FEW_GENERATIONS, GENERATIONS, FEW_DRAWS, RANDOM = 40, 40, 14, 50, 64
# Standard deviation of a trial's own step in the unit cube, at the first and at the last generation of a search.
FIRST_STEP, LAST_STEP = 0.05, 0.004
# Neighbours along the front, as a share of it, whose difference a trial follows, and by how much of it.
NEAR, FACTORS = 0.15, (0.3, 0.6, 1.0)
# A tuning that leaves more than this share of the error of a loop left alone (Kc = 0) is no control.
IDLE = 0.25
# A front ends where the error exceeds this many times its least: what lies beyond is no choice that anyone makes.
WIDEST = 50.0
# A derivative time below this many sample times moves a point by less than the front is wide: it is left out.
NO_DERIVATIVE = 0.1
EVALUATED = 400_000  # draws simulated in one call of the last measurement


@dataclass
class _Archive:
    """Tunings in the unit cube, shape (M, D), with mean travel (%) and mean square error (EU^2), shape (M,) each."""

    points: FloatArray
    travel: FloatArray = field(default_factory=lambda: np.zeros(0))
    error: FloatArray = field(default_factory=lambda: np.zeros(0))

    def add(self, points: FloatArray, travel: FloatArray, error: FloatArray) -> None:
        """Take in tunings, and keep what nothing dominates."""
        all_points = np.concatenate([self.points, points])
        all_travel, all_error = np.append(self.travel, travel), np.append(self.error, error)
        kept = undominated(all_travel, all_error)
        kept = kept[all_error[kept] <= WIDEST * all_error[kept].min(initial=np.inf)]
        self.points, self.travel, self.error = all_points[kept], all_travel[kept], all_error[kept]


def undominated(travel: FloatArray, error: FloatArray) -> NDArray[np.int64]:
    """Return the indices of tunings that no other matches or beats in both figures, shape (M,) each, by rising travel.

    Infinite figures are left out; of equal tunings the first is kept.
    """
    order = np.lexsort((error, travel))
    order = order[np.isfinite(travel[order]) & np.isfinite(error[order])]
    if order.size == 0:
        return order
    before = np.append(np.inf, np.minimum.accumulate(error[order])[:-1])
    kept: NDArray[np.int64] = order[error[order] < before]
    return kept


def evenly(travel: FloatArray, error: FloatArray, count: int) -> NDArray[np.int64]:
    """Return the indices of up to `count` points of a front, ends included, at even steps along it on log axes."""
    if travel.size <= count:
        return np.arange(travel.size)
    steps = np.hypot(np.diff(np.log(np.maximum(travel, 1e-12))), np.diff(np.log(np.maximum(error, 1e-300))))
    along = np.append(0.0, np.cumsum(steps))
    wanted = np.linspace(0.0, along[-1], count)
    nearest = np.abs(along[None, :] - wanted[:, None]).argmin(axis=1)
    return np.unique(nearest)


def pareto_front(
    loop: Loop,
    ensemble: Ensemble | None = None,
    constraints: Constraints | None = None,
    bounds: Bounds | None = None,
    *,
    known: Sequence[PID] = (),
    points: int = 60,
    seed: int = 0,
    digits: int = 4,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> Front:
    """Return the trade-off of mean square error against mean valve travel, both means over an ensemble.

    For the loop's valve and for an ideal one in its place. ensemble: `Ensemble.plant_ready(loop)` by default; its
    statistic plays no part. constraints: by default a maximum sensitivity of at most 2 at the worst corner of the
    plant's uncertainty; every corner plant must be stable in any case; a cap on travel ends the front there. bounds: by
    default the usual ones widened to hold the present tuning, and PI where that has Td = 0. known: tunings to compare
    with, such as the one in use: those that differ from the loop's controller in Kc, Ti and Td alone, lie within the
    bounds and keep the constraints are taken in as they are, so that none of them lies below the front. points: the
    most of each front that are searched for (2..500). digits: significant digits (1..12) of the numbers to type in.
    time_limit: s. progress: called with a phase in words and the share done (0..1). The time limit and Ctrl-C return
    what is there, marked by the status.

    The front begins where the error falls below a quarter of that of a loop left alone (Kc = 0) and below 50 times the
    least. Equal arguments give equal fronts (but for times, and unless stopped). Raises `InvalidValue`.
    """
    instance(loop, Loop, "loop", "a Loop")
    for value, kind, name in ((ensemble, Ensemble, "ensemble"), (constraints, Constraints, "constraints")):
        if value is not None and not isinstance(value, kind):
            raise InvalidValue(f"pareto_front.{name}", value, f"must be {kind.__name__}(...) or None")
    if bounds is not None:
        instance(bounds, Bounds, "bounds", "a Bounds or None")
    known = all_of(known, PID, "pareto_front.known", "a PID")
    callback(progress, "pareto_front.progress")
    for name, given, least, most in (("points", points, 2, 500), ("seed", seed, 0, None), ("digits", digits, 1, 12)):
        number(whole(given, f"pareto_front.{name}"), f"pareto_front.{name}", least=least, most=most)
    if time_limit is not None:
        number(time_limit, "pareto_front.time_limit", above=0.0, unit="s")
    began = time.perf_counter()
    ensemble = Ensemble.plant_ready(loop) if ensemble is None else ensemble
    asked = DEFAULT_CONSTRAINTS if constraints is None else constraints
    bounds = usual_bounds(loop.controller) if bounds is None else bounds
    fresh, stop = fresh_draws(ensemble, loop.sample_time), deadline(began, time_limit)
    loops = [loop] if isinstance(loop.valve, Ideal) else [loop, replace(loop, valve=Ideal())]
    found: list[tuple[FrontPoint, ...]] = []
    status, notes, evaluations = SolveStatus.SOLVED, [], 0
    for i, one in enumerate(loops):
        which = "repaired valve" if i else "valve as it is"

        def tell(phase: str, share: float, begin: float = i / len(loops), name: str = which) -> None:
            if progress is not None:
                progress(f"{name}, {phase}", begin + share / len(loops))

        experiment = Experiment(ensemble.duration)
        problem = Problem(one, experiment, Objective(), bounds, digits, 0.0)
        own = _rows([pid for pid in known if alike(pid, loop.controller) and bounds.contains(pid)])
        search = _Search(problem, ensemble, asked, seed, stop, tell, own)
        try:
            search.run()
        except KeyboardInterrupt:
            status = SolveStatus.INTERRUPTED
            notes.append("stopped by the user; what was found till then")
        except OutOfBudget as limit:
            status = limit.status
            notes.append(f"stopped at {limit}; what was found till then")
        tell("fresh draws", 0.9)
        found.append(_measured(problem, search, asked, fresh, points))
        evaluations += problem.work.evaluations
        if status is not SolveStatus.SOLVED:
            break
    if progress is not None:
        progress("done", 1.0)
    if not found[0] and status is SolveStatus.SOLVED:
        status = SolveStatus.INFEASIBLE
        notes.append("no tuning found within the bounds keeps the constraints and controls the loop")
    notes.append(f"{ensemble.draws} draws searched in, {fresh.draws} fresh ones measured on")
    return Front(
        loop=loop,
        ensemble=ensemble,
        fresh=fresh,
        constraints=asked,
        bounds=bounds,
        digits=digits,
        sticky=found[0],
        repaired=found[1] if len(found) > 1 else (),
        status=status,
        message="; ".join(notes),
        seed=seed,
        evaluations=evaluations,
        wall_time=time.perf_counter() - began,
    )


class _Search:
    """The archive of one valve's front and how it grows."""

    def __init__(
        self,
        problem: Problem,
        ensemble: Ensemble,
        constraints: Constraints,
        seed: int,
        stop: Callable[[], None],
        tell: Progress,
        known: FloatArray,
    ) -> None:
        self.problem, self.stop, self.tell, self.known = problem, stop, tell, known
        self.rng = np.random.default_rng(seed)
        self.archive = _Archive(np.zeros((0, problem.free.size)))
        self.ensemble, self.constraints = ensemble, constraints
        self.most = math.inf  # EU^2: errors above it are no control

    def run(self) -> None:
        """Search on few draws, then at the digits to type in on all. May be stopped at any time."""
        problem, free = self.problem, self.problem.free.size
        start = problem.cube(np.concatenate([guesses(problem), self.known]))
        fresh = self.rng.random((RANDOM if free else 0, free))
        if problem.low[2] == 0.0 and 2 in problem.free:
            fresh[: RANDOM // 2, -1] = 0.0  # PI controllers are always among them
        start = np.concatenate([start, fresh])
        if self.ensemble.draws > FEW_DRAWS and free:
            few = Judge(problem, replace(self.ensemble, draws=FEW_DRAWS), self.constraints)
            self._evolve(few, start, FEW_GENERATIONS, (0.0, 0.25), rounded=False)
            start = self.archive.points[evenly(self.archive.travel, self.archive.error, 2 * TRIALS)]
            self.archive = _Archive(np.zeros((0, free)))
        whole_ensemble = Judge(problem, self.ensemble, self.constraints)
        self._evolve(whole_ensemble, start, GENERATIONS if free else 0, (0.25, 0.9), rounded=True)

    def _evolve(
        self, judge: Judge, start: FloatArray, generations: int, shares: tuple[float, float], *, rounded: bool
    ) -> None:
        phase = "all draws" if rounded else "first draws"
        self.most = IDLE * _left_alone(judge)
        self._take(judge, start, rounded)
        for generation in range(generations):
            part = generation / generations
            self.stop()
            self.tell(phase, shares[0] + (shares[1] - shares[0]) * part)
            self._take(judge, self._trials(FIRST_STEP * (LAST_STEP / FIRST_STEP) ** part), rounded)

    def _take(self, judge: Judge, points: FloatArray, rounded: bool) -> None:
        """Put those of the points into the archive that keep the constraints and do control."""
        problem = self.problem
        tunings = problem.tunings(points)
        if rounded:
            tunings = problem.rounded(tunings)
            points = problem.cube(tunings)
        keep = judge.broken(tunings) == 0.0
        points, tunings = points[keep], tunings[keep]
        if not points.shape[0]:
            return
        error, travel = judge.means(tunings)
        cap = self.constraints.valve_travel
        fit = error <= self.most
        if cap is not None:
            fit &= travel <= cap
        self.archive.add(points[fit], travel[fit], error[fit])

    def _trials(self, step: float) -> FloatArray:
        """Return new points: some of the archive, moved along differences of their neighbours and at random."""
        rng, archive = self.rng, self.archive
        free = self.problem.free.size
        if archive.travel.size < 4:
            known = archive.points[rng.integers(archive.travel.size, size=TRIALS // 2)] if archive.travel.size else None
            fresh = rng.random((TRIALS - (0 if known is None else TRIALS // 2), free))
            # Nothing holds yet: very cautious tunings are the likeliest to.
            fresh[::2, 0] *= 0.1 if 0 in self.problem.free else 1.0
            return fresh if known is None else np.concatenate([fresh, _inside(known, step, rng)])
        chosen = evenly(archive.travel, archive.error, TRIALS)
        chosen = np.append(chosen, rng.choice(chosen, TRIALS - chosen.size))
        reach = max(2, round(NEAR * archive.travel.size))
        ends = np.clip(chosen + rng.integers(-reach, reach + 1, size=(2, TRIALS)), 0, archive.travel.size - 1)
        factor = rng.choice(FACTORS, size=(TRIALS, 1))
        moved = archive.points[chosen] + factor * (archive.points[ends[0]] - archive.points[ends[1]])
        return _inside(moved, step, rng)


def alike(one: PID, other: PID) -> bool:
    """Whether two controllers differ in their tuning alone."""
    return replace(one, Kc=other.Kc, Ti=other.Ti, Td=other.Td) == other


def _rows(controllers: Sequence[PID]) -> FloatArray:
    """Return controllers as tunings, shape (M, 3)."""
    return np.array([(pid.Kc, pid.Ti, pid.Td) for pid in controllers], dtype=np.float64).reshape(-1, 3)


def _inside(points: FloatArray, step: float, rng: np.random.Generator) -> FloatArray:
    """Return points moved at random, within the unit cube: beyond it its face counts, where a PI lies."""
    moved: FloatArray = np.clip(points + step * rng.standard_normal(points.shape), 0.0, 1.0)
    return moved


def _left_alone(judge: Judge) -> float:
    """Return the mean square error (EU^2) over the draws without control: of steps that meet no answer."""
    loop = judge.problem.loop
    # The limits stay: a curved characteristic is not without them.
    idle = loop.with_controller(PID(0.0, math.inf, output_limits=loop.controller.output_limits))
    given = Circumstances(idle, judge.given.ensemble)
    terms = given.terms(np.array([[0.0, math.inf, 0.0]]))
    return float(terms[0, :, 4].mean() / given.samples)


def _measured(
    problem: Problem, search: _Search, constraints: Constraints, fresh: Ensemble, points: int
) -> tuple[FrontPoint, ...]:
    """Return a search's front on fresh draws: up to `points`, at the digits to type in, none dominated."""
    archive = search.archive
    chosen = evenly(archive.travel, archive.error, points)
    tunings = problem.tunings(archive.points[chosen])
    if problem.low[2] == 0.0:
        tunings[tunings[:, 2] < NO_DERIVATIVE * problem.loop.sample_time, 2] = 0.0
    tunings = np.unique(np.concatenate([problem.rounded(tunings), search.known]), axis=0)
    if not tunings.shape[0]:
        return ()
    judge = Judge(problem, fresh, constraints)
    tunings = tunings[judge.broken(tunings) == 0.0]
    size = max(1, EVALUATED // fresh.draws)
    parts = [judge.means(tunings[k : k + size]) for k in range(0, tunings.shape[0], size)]
    error, travel = (np.concatenate([part[k] for part in parts]) if parts else np.zeros(0) for k in (0, 1))
    return tuple(
        FrontPoint(problem.controller(tunings[i]), float(travel[i]), float(error[i]))
        for i in undominated(travel, error)
    )
