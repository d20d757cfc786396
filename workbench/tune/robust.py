"""Robust tuning: the least mean, percentile or CVaR of J over an ensemble, within constraints, proved on fresh draws.

1. Several seeded searches on the first draws; 2. a joint search from the best of them on all draws; 3. a walk on the
lattice of the digits to type in; 4. the figures of the chosen tuning on draws that no search has seen. Every value is
an exact simulation, the same draws for every tuning; what breaks a constraint is ranked as `limits` does.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.numbers import given
from workbench.model.record import FloatArray
from workbench.model.results import Restart, Robustness, SolveStatus, Tuned
from workbench.simulate.signals import sample_count
from workbench.tune.budget import STOPPED, OutOfBudget, Progress, deadline, stopper
from workbench.tune.ensemble import SURE, Circumstances, measured, statistic
from workbench.tune.limits import NARROW, UNSTABLE, WORN, more_than_sensitivity, narrowness, worn
from workbench.tune.problem import Problem, unit_of
from workbench.tune.refine import path
from workbench.tune.scan import evolve, spread
from workbench.tune.verify import digit_steps, stem_guard

__all__ = ["DEFAULT_CONSTRAINTS", "Judge", "fresh_draws", "guesses", "tune_robust"]

DEFAULT_CONSTRAINTS = Constraints(max_sensitivity=2.0)
# Sizes of the searches; the first ones see only so many draws.
SCAN_MEMBERS, SCAN_GENERATIONS, SCAN_DRAWS = 24, 40, 50
JOINT_MEMBERS, JOINT_GENERATIONS, GAP = 32, 30, 3e-3
# Steps of the last walk, in units of the last digit, and the most rounds of each.
STEPS, ROUNDS = (64, 16, 4, 1), 12
# Fresh draws up to 1,000 samples; longer runs get fewer.
FRESH, FRESH_SAMPLES = 2_000, 2_000_000


@dataclass
class _Found:
    """All tunings that a search has improved on, with their values over all draws, and the searches' ends."""

    tunings: list[FloatArray] = field(default_factory=list)
    values: list[FloatArray] = field(default_factory=list)
    restarts: list[Restart] = field(default_factory=list)

    def add(self, tunings: FloatArray, values: FloatArray) -> None:
        self.tunings.append(tunings)
        self.values.append(values)

    def best(self) -> tuple[FloatArray, float]:
        values = np.concatenate(self.values)
        return np.concatenate(self.tunings)[int(values.argmin())], float(values.min())


class Judge:
    """Values of tunings in one ensemble under constraints: the statistic of J, or how far a constraint is broken."""

    def __init__(self, problem: Problem, ensemble: Ensemble, constraints: Constraints) -> None:
        self.problem, self.constraints = problem, constraints
        self.given = Circumstances(problem.loop, ensemble)

    def statistic(self, tunings: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the statistic of J and the mean valve travel (%) of tunings, shape (M, 3) -> (M,) each."""
        terms = self._terms(tunings, every=bool(self.problem.objective.kpis))
        with np.errstate(over="ignore", invalid="ignore"):
            costs = self.given.costs(terms, self.problem.objective)
            return statistic(costs, self.given.ensemble), terms[:, :, 5].mean(axis=1)

    def means(self, tunings: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the means of square error (EU^2) and valve travel (%) over the draws, shape (M, 3) -> (M,) each.

        inf where a run overflows.
        """
        terms = self._terms(tunings, every=False)
        with np.errstate(over="ignore", invalid="ignore"):
            errors, travel = terms[:, :, 4].mean(axis=1) / self.given.samples, terms[:, :, 5].mean(axis=1)
        lost = ~(np.isfinite(errors) & np.isfinite(travel))
        return np.where(lost, np.inf, errors), np.where(lost, np.inf, travel)

    def _terms(self, tunings: FloatArray, *, every: bool) -> FloatArray:
        runs = tunings.shape[0] * self.given.ensemble.draws
        self.problem.work.evaluations += runs
        self.problem.work.simulated += runs * self.given.samples
        with np.errstate(over="ignore", invalid="ignore"):
            return self.given.terms(tunings, every=every)

    def broken(self, tunings: FloatArray) -> FloatArray:
        """Return how far tunings miss a stable loop and the margins asked for, shape (M, 3) -> (M,): 0 where not."""
        worst, lost = self.given.margins(tunings, all_three=more_than_sensitivity(self.constraints))
        # The nearer an unstable response passes by -1, the nearer the tuning is to a stable one.
        values = np.where(lost > 0, UNSTABLE * (1.0 + lost + 1.0 / worst[:, 0]), 0.0)
        narrow = narrowness(self.constraints, worst)
        values = np.where((lost == 0) & (narrow > 0.0), NARROW * (1.0 + narrow), values)
        for i in np.flatnonzero((values == 0.0) & (worst[:, 0] > SURE)):
            count = self.given.unstable(tunings[i])
            if count:
                values[i] = UNSTABLE * (1.0 + count)
        return values

    def values(self, tunings: FloatArray) -> FloatArray:
        """Return the values of tunings, shape (M, 3) -> (M,)."""
        values = self.broken(tunings)
        keep = np.flatnonzero(values == 0.0)
        if keep.size:
            costs, travel = self.statistic(tunings[keep])
            values[keep] = worn(costs, travel, self.constraints.valve_travel)
        return values


def fresh_draws(ensemble: Ensemble, sample_time: float) -> Ensemble:
    """Return the draws on which tunings found in an ensemble are measured: unseen ones, of the next seed."""
    samples = sample_count(ensemble.duration, sample_time)
    return replace(ensemble, seed=ensemble.seed + 1, draws=min(FRESH, max(ensemble.draws, FRESH_SAMPLES // samples)))


def tune_robust(
    problem: Problem,
    ensemble: Ensemble,
    constraints: Constraints | None,
    seed: int,
    restarts: int,
    time_limit: float | None,
    progress: Progress | None,
) -> Tuned:
    """Find the tuning of least `ensemble.statistic` of J that keeps the constraints (by default Ms <= 2).

    Every nominal and corner plant must be stable, whatever the constraints. The result's `robustness` is measured on
    fresh draws of the ensemble with the next seed (2,000, fewer for long runs). Status: `INFEASIBLE` where no tuning
    keeps a constraint (the nearest one is returned, with what it reaches), `DIVERGED` where none holds all corner
    plants, `UNVERIFIED` where a fresh draw diverges; `TIME_LIMIT` and `INTERRUPTED` return the best so far.
    """
    began = time.perf_counter()
    asked = DEFAULT_CONSTRAINTS if constraints is None else constraints
    judge = Judge(problem, ensemble, asked)
    found = _Found()
    status, notes = SolveStatus.SOLVED, []
    stop = stopper(problem, 2**62, deadline(began, time_limit))

    def tell(phase: str, share: float) -> None:
        if progress is not None:
            progress(phase, share)

    pid = problem.loop.controller
    start = np.array([[pid.Kc, pid.Ti, pid.Td]])
    fallback = problem.rounded(np.clip(start, problem.low, problem.high))
    nominal = math.inf
    try:
        found.add(fallback, judge.values(fallback))
        if problem.free.size:
            nominal = _search(judge, found, seed, restarts, stop, tell)
            tell("choosing the digits", 0.8)
            _walk(judge, found, stop)
    except KeyboardInterrupt:
        status = SolveStatus.INTERRUPTED
        notes.append(STOPPED)
    except OutOfBudget as limit:
        status = limit.status
        notes.append(f"stopped at {limit}; the best so far")
    chosen, value = found.best() if found.values else (fallback[0], math.inf)
    tell("fresh draws", 0.9)
    cost = float(judge.statistic(chosen[None, :])[0][0])
    around = float(judge.statistic(problem.around(chosen[None, :], dense=True))[0].max())
    fresh = fresh_draws(ensemble, problem.loop.sample_time)
    controller = problem.controller(chosen)
    robustness = measured(Circumstances(problem.loop.with_controller(controller), fresh), problem.objective)
    if problem.free.size == 0:
        notes.append("all parameters are fixed")
    status, reason = _verdict(status, value, asked, judge, chosen, robustness)
    notes += [one for one in (problem.remark(float(chosen[0])), reason) if one]
    tell("done", 1.0)
    run = path(problem, chosen)
    return Tuned(
        loop=problem.loop,
        experiment=problem.experiment,
        weights=problem.objective,
        bounds=problem.bounds,
        controller=controller,
        objective=cost,
        status=status,
        message="; ".join([*notes, _summary(ensemble, robustness)]),
        digits=problem.digits,
        nominal=min(nominal, cost),
        worst=max(around, cost),
        margin=problem.margin,
        start_objective=float(judge.statistic(start)[0][0]),
        guard_margin=stem_guard(problem, chosen),
        slips=int(np.count_nonzero(run.x != np.append(0.0, run.x[:-1]))),
        restarts=tuple(found.restarts),
        evaluations=problem.work.evaluations,
        solves=0,
        iterations=0,
        seed=seed,
        wall_time=time.perf_counter() - began,
        versions=MappingProxyType({}),
        ensemble=ensemble,
        constraints=asked,
        robustness=robustness,
        start_robustness=measured(Circumstances(problem.loop, fresh), problem.objective),
        steps=digit_steps(problem, chosen, lambda near: judge.statistic(near)[0]),
    )


def _search(judge: Judge, found: _Found, seed: int, restarts: int, stop: Callable[[], bool], tell: Progress) -> float:
    """Search on few draws from several seeds, then jointly on all; return the least statistic met before rounding."""
    problem = judge.problem
    free = problem.free.size
    whole = judge.given.ensemble
    few = judge
    if whole.draws > SCAN_DRAWS:
        few = Judge(problem, replace(whole, draws=SCAN_DRAWS), judge.constraints)
    first = problem.cube(guesses(problem))
    pool, least = [first], math.inf
    for k in range(restarts):
        tell(f"global search {k + 1} of {restarts}", 0.5 * k / restarts)
        before = problem.work.evaluations
        rng = np.random.default_rng([seed, k])
        fresh = rng.random((SCAN_MEMBERS, free))
        if problem.low[2] == 0.0 and 2 in problem.free:
            # PI controllers are always among them.
            fresh[: SCAN_MEMBERS // 4, -1] = 0.0
        population = evolve(
            lambda points, _: few.values(problem.tunings(points)),
            np.concatenate([first, fresh]),
            SCAN_GENERATIONS,
            rng,
            stop=stop,
        )
        best = problem.tunings(population.points[:1])
        ended = float(judge.values(best)[0])
        least = min(least, ended) if ended < WORN else least
        # At the digits to type in, so that a stop from here on has something to return.
        typed = problem.rounded(best)
        found.add(typed, judge.values(typed))
        scanned, ended = (v if v < WORN else math.inf for v in (float(population.values[0]), ended))
        found.restarts.append(Restart(k, scanned, ended, problem.work.evaluations - before, 0, 0))
        pool.append(population.points)
    tell("joint search on all draws", 0.55)
    points = np.concatenate(pool)
    values = few.values(problem.tunings(points))
    kept = spread(points, values, JOINT_MEMBERS, GAP)
    population = evolve(
        lambda some, _: judge.values(problem.rounded(problem.tunings(some))),
        points[kept] if kept.size else first,
        JOINT_GENERATIONS,
        np.random.default_rng([seed, restarts]),
        stop=stop,
    )
    found.add(problem.rounded(problem.tunings(population.points)), population.values)
    return least


def guesses(problem: Problem) -> FloatArray:
    """Return tunings worth a try, (M, 3): those of every search, and very cautious ones, which constraints may ask."""
    usual = problem.guesses()
    cautious = usual * np.array([0.03, 2.0, 0.0])
    both: FloatArray = np.clip(np.concatenate([usual, cautious]), problem.low, problem.high)
    return np.unique(both, axis=0)


def _walk(judge: Judge, found: _Found, stop: Callable[[], bool]) -> None:
    """Walk from the best rounded tuning on the lattice of its digits as long as its value falls."""
    problem = judge.problem
    tuning, value = found.best()
    moves = np.array([m for m in itertools.product((-1.0, 0.0, 1.0), repeat=problem.free.size) if any(m)])
    for step in STEPS:
        for _ in range(ROUNDS):
            stop()
            near = np.tile(tuning, (moves.shape[0], 1))
            near[:, problem.free] += step * moves * unit_of(tuning, problem.digits)[problem.free]
            near = problem.rounded(np.clip(near, problem.low, problem.high))
            values = judge.values(near)
            best = int(values.argmin())
            if not values[best] < value:
                break
            tuning, value = near[best], float(values[best])
            found.add(tuning[None, :], values[best : best + 1])


def _verdict(
    status: SolveStatus, value: float, asked: Constraints, judge: Judge, chosen: FloatArray, fresh: Robustness
) -> tuple[SolveStatus, str]:
    """The status that the chosen tuning's own value gives, and why, in words."""
    ended = status is SolveStatus.SOLVED
    if not fresh.stable or not math.isfinite(value):
        words = "the best tuning found within the bounds does not hold every corner plant of the ensemble"
        if fresh.stable:
            words = "every tuning within the bounds makes some draw of the ensemble diverge"
        return (SolveStatus.DIVERGED if ended else status), words
    if value >= WORN:
        broken = ", ".join(_missed(asked, judge, chosen, fresh))
        words = f"no tuning found within the bounds keeps every constraint; the nearest has {broken}"
        return (SolveStatus.INFEASIBLE if ended else status), words
    if fresh.diverged:
        words = f"{fresh.diverged} of {fresh.ensemble.draws} fresh draws diverge"
        return (SolveStatus.UNVERIFIED if ended else status), words
    # A mean over the draws that were searched; over others it is another.
    limit = asked.valve_travel
    if limit is not None and fresh.travel_mean > limit:
        mean = given(fresh.travel_mean, 3)
        kept = f"on fresh draws the mean valve travel is {mean} %, above the {limit:g} % kept on its own"
        return status, kept
    return status, ""


def _missed(asked: Constraints, judge: Judge, chosen: FloatArray, reached: Robustness) -> list[str]:
    margins = reached.max_sensitivity, reached.gain_margin, reached.phase_margin
    return asked.missed(margins, float(judge.statistic(chosen[None, :])[1][0]), "mean valve travel")


def _summary(ensemble: Ensemble, fresh: Robustness) -> str:
    what = {"mean": "mean", "percentile": f"{ensemble.level:g} quantile", "cvar": f"CVaR {ensemble.level:g}"}
    return (
        f"{what[ensemble.statistic]} of J over {ensemble.draws} draws; on {fresh.ensemble.draws} fresh ones mean "
        f"square error {given(fresh.mse_median, 3)} (median), {given(fresh.mse_p90, 3)} (90th percentile), "
        f"valve travel {given(fresh.travel_median, 3)} % (median), worst corner's Ms {given(fresh.max_sensitivity, 3)}"
    )
