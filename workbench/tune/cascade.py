"""`wb.tune_cascade`: the secondary first, by itself, then the primary in the cascade, by the searches of `wb.tune`."""

from __future__ import annotations

import time
from functools import partial
from types import MappingProxyType

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.cascade import Cascade, CascadeTuned
from workbench.model.checks import callback, instance
from workbench.model.experiment import Experiment
from workbench.model.record import FloatArray
from workbench.model.results import SolveStatus, Tuned
from workbench.model.tuning import Bounds, Objective
from workbench.simulate import cascade_kernel as kernel
from workbench.simulate.batch import kernel_weights, shared_out
from workbench.simulate.cascade import cascade_signals, chain
from workbench.simulate.coefficients import coefficients
from workbench.symbolic.solve import versions
from workbench.tune.budget import STOPPED, Progress, deadline
from workbench.tune.problem import Problem
from workbench.tune.search import Found, quick, searched
from workbench.tune.tune import DIGITS, check_search, tune
from workbench.tune.verify import digit_steps

__all__ = ["CascadeProblem", "evaluate_cascade", "tune_cascade"]

# As how many samples of one loop a cascade's count in the searches' budgets: how long they go on, not what they cost.
COST = 8


class CascadeProblem(Problem):
    """The exact costs of tunings of a cascade's primary, for the searches that know a `Problem`.

    J is of the error of the primary and of output and stem of the secondary, on the secondary's samples.
    """

    one_loop = False

    def __init__(
        self, cascade: Cascade, experiment: Experiment, objective: Objective, bounds: Bounds, digits: int, margin: float
    ) -> None:
        self.cascade, self.given = cascade, cascade_signals(cascade, experiment)
        self.whole = experiment
        plain = Experiment(experiment.duration, experiment.setpoint, None, experiment.noise)
        super().__init__(cascade.primary, plain, objective, bounds, digits, margin)
        # The primary's own scans are fewer than the samples on which its error and the valve are weighed.
        self.samples = self.given.samples
        self.weights = kernel_weights(objective, self.samples, cascade.secondary.sample_time)
        self.secondary = coefficients(cascade.secondary, experiment.stem_offset)[0]
        self.chain = chain(cascade)

    def _changed(self, bounds: Bounds, _: object) -> CascadeProblem:
        given = self.cascade, self.whole, self.objective, bounds, self.digits, self.margin
        other = CascadeProblem(*given)
        other.work = self.work
        return other

    def exact(self, tunings: FloatArray) -> FloatArray:
        """Return J of tunings, shape (M, 3) -> (M,), by exact simulation; inf where a run overflows."""
        return self._worst(tunings, 1, np.full(tunings.shape[0], np.inf))

    def _worst(self, tunings: FloatArray, group: int, ceilings: FloatArray) -> FloatArray:
        rows = coefficients(self.cascade.primary, 0.0, tunings)
        values = np.empty(ceilings.size)
        counts: list[int] = []
        s = self.given

        def work(part: slice) -> None:
            own = rows[part.start * group : part.stop * group]
            fixed = (self.secondary, self.chain, self.cascade.every, s.r, s.added, s.load, s.noise1, s.noise2)
            counts.append(kernel.cascade_worst(own, group, *fixed, self.weights, ceilings[part], values[part]))

        shared_out(ceilings.size, COST * group * self.samples, work)
        self.work.evaluations += rows.shape[0]
        self.work.simulated += COST * sum(counts)
        return values


def evaluate_cascade(cascade: Cascade, experiment: Experiment, objective: Objective) -> float:
    """Return J of a cascade by exact simulation (see `tune_cascade`), inf where it overflows. Raises `InvalidValue`."""
    problem = CascadeProblem(cascade, experiment, objective, Bounds(), DIGITS, 0.0)
    pid = cascade.primary.controller
    return float(problem.exact(np.array([[pid.Kc, pid.Ti, pid.Td]]))[0])


def tune_cascade(
    cascade: Cascade,
    experiment: Experiment,
    objective: Objective | None = None,
    bounds: Bounds | None = None,
    seed: int = 0,
    *,
    secondary_experiment: Experiment | None = None,
    secondary_objective: Objective | None = None,
    secondary_bounds: Bounds | None = None,
    digits: int = DIGITS,
    restarts: int = 2,
    margin: float = 0.001,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> CascadeTuned:
    """Tune a cascade in turn: the secondary with the primary in manual, then the primary over the secondary tuned so.

    secondary_experiment: what the secondary is tuned in, by itself, its setpoint in its own EU, as `wb.tune` does;
    without one it stays as it is. experiment, objective and bounds (in the controller's own form) are the primary's; J
    (eq. (2) and figures of the run, see `Objective`) is of the primary's error and of the output and stem of the
    secondary, summed over the secondary's samples. As in `wb.tune`, the worst J within the digits to type in, or within
    the relative `margin` where that is wider, is minimised by searches on the exact simulator, and a parameter that is
    free must start within its bounds. time_limit: s, of the primary's search; the best so far is then returned.

    The order matters, and is the usual one: the primary sees the secondary as part of its plant. Tuning the secondary
    anew afterwards would change that plant. progress: called with a phase in words and the share done (0..1). Raises
    `InvalidValue`.
    """
    objective = Objective() if objective is None else objective
    bounds = Bounds() if bounds is None else bounds
    instance(cascade, Cascade, "cascade", "a Cascade")
    instance(experiment, Experiment, "experiment", "an Experiment")
    instance(objective, Objective, "objective", "an Objective or None")
    instance(bounds, Bounds, "bounds", "a Bounds or None")
    callback(progress, "tune_cascade.progress")
    if secondary_experiment is None and (secondary_objective is not None or secondary_bounds is not None):
        where = "tune_cascade.secondary_experiment"
        raise InvalidValue(where, None, "must be given where the secondary has an objective or bounds")
    check_search(cascade.primary, bounds, seed, digits, restarts, margin, time_limit)

    def tell(begin: float, size: float, words: str, share: float) -> None:
        if progress is not None:
            progress(words, begin + size * share)

    start = evaluate_cascade(cascade, experiment, objective)
    secondary = None
    if secondary_experiment is not None:
        secondary = tune(
            cascade.secondary,
            secondary_experiment,
            secondary_objective,
            secondary_bounds,
            seed,
            digits=digits,
            restarts=restarts,
            margin=margin,
            progress=lambda words, share: tell(0.0, 0.3, f"secondary: {words}", share),
        )
        cascade = cascade.with_controllers(secondary=secondary.controller)
    begin = 0.3 if secondary is not None else 0.0
    interrupted = secondary is not None and secondary.status is SolveStatus.INTERRUPTED
    problem = CascadeProblem(cascade, experiment, objective, bounds, digits, margin)
    primary = _primary(problem, seed, restarts, time_limit, partial(tell, begin, 1.0 - begin), give_up=interrupted)
    return CascadeTuned(cascade.with_controllers(primary.controller), experiment, primary, secondary, start)


def _primary(
    problem: CascadeProblem, seed: int, restarts: int, time_limit: float | None, tell: Progress, *, give_up: bool
) -> Tuned:
    began, found = time.perf_counter(), Found()

    def telling(words: str, share: float) -> None:
        tell(f"primary: {words}", share)

    pid = problem.cascade.primary.controller
    own = float(problem.exact(np.array([[pid.Kc, pid.Ti, pid.Td]]))[0])
    if give_up:
        chosen, status, note = quick(problem, found), SolveStatus.INTERRUPTED, STOPPED
    else:
        check = deadline(began, time_limit)
        chosen, status, note = searched(problem, found, seed, restarts, 0.0, 0, check, telling)
    if status is SolveStatus.SOLVED and not np.isfinite(chosen.cost):
        status, note = SolveStatus.DIVERGED, "no tuning that was tried within the bounds keeps the cascade bounded"
    words = f"direct search on exact simulations of the cascade at {problem.digits} significant digits"
    return Tuned(
        loop=problem.cascade.primary,
        experiment=problem.whole,
        weights=problem.objective,
        bounds=problem.bounds,
        controller=problem.controller(chosen.tuning),
        objective=chosen.cost,
        status=status,
        message=f"{note}; {words}" if note else words,
        digits=problem.digits,
        nominal=min(found.least(), chosen.cost),
        worst=chosen.worst,
        margin=problem.margin,
        start_objective=own,
        guard_margin=float("nan"),
        slips=0,
        restarts=tuple(found.restarts),
        evaluations=problem.work.evaluations,
        solves=0,
        iterations=0,
        seed=seed,
        wall_time=time.perf_counter() - began,
        versions=MappingProxyType(dict(versions())),
        steps=digit_steps(problem, chosen.tuning, problem.exact),
    )
