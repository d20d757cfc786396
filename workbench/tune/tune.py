"""`wb.tune`: global scan on the exact simulator, refinement by branch programs, choice at the digits to type in.

1. Several seeded searches for the least J of eq. (2); 2. branch programs on the best distinct sequences of decisions
and their neighbours; 3. a search, from all of these, for the least *worst* J within the parameters' digits,
because the best nominal tunings sit on cliffs, and the same without derivative where the bounds allow both. Where that
is affordable a run in every neighbourhood of a plane of tunings leaves no valley out, and proves how far the best is
from the least possible; in three dimensions a coarser grid tells where to search;
4. rounding, and the same search on the rounded numbers themselves.
Every J that is reported is an exact simulation of the numbers that are reported.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.checks import callback, instance, number, whole
from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.numbers import given
from workbench.model.record import FloatArray
from workbench.model.results import SolveStatus, Tuned
from workbench.model.tuning import Bounds, Objective
from workbench.symbolic.loop import unwritten
from workbench.symbolic.solve import versions
from workbench.tune.budget import OutOfBudget, Progress, deadline
from workbench.tune.complementarity import applicable
from workbench.tune.problem import NAMES, Problem
from workbench.tune.refine import Path, eq_2_alone, path, usable
from workbench.tune.robust import tune_robust
from workbench.tune.search import Found, searched
from workbench.tune.verify import digit_steps, stem_guard

__all__ = ["check_search", "tune"]

# Digits of a tuning to type in, and of one that is only to be looked at: at a nominal optimum a few digits decide.
DIGITS, NOMINAL_DIGITS = 4, 12


def tune(
    loop: Loop,
    experiment: Experiment,
    objective: Objective | None = None,
    bounds: Bounds | None = None,
    seed: int = 0,
    *,
    digits: int | None = None,
    restarts: int = 4,
    guard: float = 0.0,
    margin: float = 0.001,
    nominal: bool = False,
    complementarity: int = 0,
    robust: bool | Ensemble = False,
    constraints: Constraints | None = None,
    time_limit: float | None = None,
    max_evaluations: int | None = None,
    progress: Progress | None = None,
) -> Tuned:
    """Find the Kc, Ti and Td of least J (eq. (2), see `Objective`) for a loop in an experiment.

    The controller keeps its form, structure, filter and limits; bounds are in its own form, and equal ends fix a
    parameter. Its present tuning must lie within the bounds of the parameters that are free. digits: significant
    digits (1..12) of the numbers to type in, 4 by default. restarts: independent global searches (1..100); with 3 or
    more, some seconds for each are also spent on leaving no valley out (`Tuned.worst_bound`). margin: relative change
    (0..0.2) of each parameter against which the worst J is minimised; half a last digit is always covered. progress:
    called with a phase in words and the share done (0..1).

    guard: the distance (0..0.5) that solutions of branch programs keep from a stick/slip decision, relative to the
    valve's (S + J)/2, half of their start's own where a program has no solution at that distance. It moves what these
    programs add to the search and nothing else: the tuning returned may lie nearer to a decision
    (`Tuned.guard_margin` says how near), and where `Tuned.solves` is 0 it plays no part.

    time_limit: s, and max_evaluations: simulated runs (both looked at between generations of a search); the best so far
    is returned as `TIME_LIMIT` or `EVALUATION_LIMIT`. Ctrl-C returns it as `INTERRUPTED`.

    nominal: minimise J of the tuning itself, at 12 digits unless they are given. Such optima sit on cliffs:
    `Tuned.worst` tells what the margin costs, and the message warns. For comparison, not for a controller. Where
    no more than half of three searches or more meet the least J, up to four larger ones are made.

    complementarity: how many random starts (0..100) are also taken to the loop's complementarity program, rounded to
    sequences of decisions and refined; for Stenman's valve without output limits, up to 500 samples, under eq. (2).
    A second opinion on the scans: it takes a second or more for each.

    constraints: what the tuning must keep: margins of the loop's own plant, valve travel in the experiment, within
    digits and margin too unless nominal. Where no tuning keeps them, the nearest is returned as `INFEASIBLE`. Travel
    jumps where the stem slips once more: the limit is kept at all random points by which `Tuned.worst` is judged, or,
    where none of the last candidates does that, at 115 of them, and the message says at how many it is not.

    robust: tune for an `Ensemble` of circumstances and plants instead of the one experiment; True takes the default,
    `Ensemble.plant_ready(loop)`. The constraints then hold at the worst corner of the plant's uncertainty and for the
    mean travel, and are a maximum sensitivity of at most 2 unless given. See `tune_robust`; guard and max_evaluations
    play no part then.

    Returns a `Tuned` whose objective is the exact J of the rounded controller. Equal arguments give equal results
    (but for times, and unless stopped by time). Raises `InvalidValue`.
    """
    objective = Objective() if objective is None else objective
    bounds = Bounds() if bounds is None else bounds
    instance(loop, Loop, "loop", "a Loop")
    instance(experiment, Experiment, "experiment", "an Experiment")
    instance(objective, Objective, "objective", "an Objective or None")
    instance(bounds, Bounds, "bounds", "a Bounds or None")
    callback(progress, "tune.progress")
    instance(nominal, bool, "tune.nominal", "True or False")
    number(whole(complementarity, "tune.complementarity"), "tune.complementarity", most=100)
    digits = (NOMINAL_DIGITS if nominal else DIGITS) if digits is None else digits
    check_search(loop, bounds, seed, digits, restarts, margin, time_limit)
    number(guard, "tune.guard", least=0.0, most=0.5)
    if max_evaluations is not None:
        number(whole(max_evaluations, "tune.max_evaluations"), "tune.max_evaluations", least=1)
    instance(robust, (bool, Ensemble), "tune.robust", "True, False or an Ensemble")
    instance(constraints, (Constraints, type(None)), "tune.constraints", "Constraints(...) or None")
    began = time.perf_counter()
    # An ensemble has constraints of its own, and those that ask for nothing are none.
    single = None if robust is not False or constraints == Constraints() else constraints
    problem = Problem(loop, experiment, objective, bounds, digits, margin, nominal=nominal, constraints=single)
    if robust is not False:
        if nominal:
            raise InvalidValue("tune.nominal", nominal, "an ensemble has no nominal run: give nominal or robust")
        ensemble = Ensemble.plant_ready(loop) if robust is True else robust
        return tune_robust(problem, ensemble, constraints, seed, restarts, time_limit, progress)
    if complementarity and problem.free.size:
        applicable(problem)
    start = float(problem.exact(np.array([[loop.controller.Kc, loop.controller.Ti, loop.controller.Td]]))[0])
    found, late = Found(), deadline(began, time_limit)

    def check() -> None:
        late()
        if max_evaluations is not None and problem.work.evaluations >= max_evaluations:
            raise OutOfBudget(SolveStatus.EVALUATION_LIMIT, f"the limit of {max_evaluations} evaluations")

    def tell(phase: str, share: float) -> None:
        if progress is not None:
            progress(phase, share)

    chosen, status, note = searched(problem, found, seed, restarts, guard, complementarity, check, tell)
    tell("done", 1.0)
    solves = found.solves + sum(r.solves for r in found.restarts)
    run = path(problem, chosen.tuning)
    if status is SolveStatus.SOLVED and _runs_away(problem, run, chosen.cost):
        status, note = SolveStatus.DIVERGED, "no tuning that was tried within the bounds keeps the loop from diverging"
    broken = _broken(problem, chosen.tuning)
    if broken:
        words = f"no tuning found within the bounds keeps every constraint; the nearest has {', '.join(broken)}"
        note = f"{note}; {words}" if note else words
        status = SolveStatus.INFEASIBLE if status is SolveStatus.SOLVED else status
    tuned = Tuned(
        loop=loop,
        experiment=experiment,
        weights=objective,
        bounds=bounds,
        controller=problem.controller(chosen.tuning),
        objective=chosen.cost,
        status=status,
        message="",
        digits=digits,
        nominal=min(found.least(), chosen.cost),
        worst=max(chosen.cost, _around(problem, chosen.tuning)) if nominal or broken else chosen.worst,
        margin=margin,
        start_objective=start,
        guard_margin=stem_guard(problem, chosen.tuning),
        slips=int(np.count_nonzero(run.x != np.append(0.0, run.x[:-1]))),
        restarts=tuple(found.restarts),
        evaluations=problem.work.evaluations,
        solves=solves,
        iterations=sum(r.iterations for r in found.restarts),
        seed=seed,
        wall_time=time.perf_counter() - began,
        versions=MappingProxyType(dict(versions())),
        constraints=single,
        steps=digit_steps(problem, chosen.tuning, problem.exact),
        nominal_only=nominal,
        worst_bound=min(found.bound, chosen.worst)
        if status is SolveStatus.SOLVED and math.isfinite(found.bound)
        else None,
    )
    return replace(tuned, message=_message(problem, found, note, tuned))


def _around(problem: Problem, tuning: FloatArray) -> float:
    """The worst J within the digits of a tuning, whatever was asked of it."""
    return float(problem.unconstrained().spread(tuning[None, :], np.array([np.inf]))[0])


def _broken(problem: Problem, tuning: FloatArray) -> list[str]:
    """Say which constraints a tuning breaks."""
    asked = problem.constraints
    if asked is None:
        return []
    margins, stable = problem.margins(tuning[None, :])
    Ms, gain, phase = (float(v) for v in margins[0]) if stable[0] else (math.inf, 0.0, 0.0)
    return asked.missed((Ms, gain, phase), problem.travel(tuning), "valve travel")


def _runs_away(problem: Problem, run: Path, cost: float) -> bool:
    """Whether a run has left every bound: OP beyond a thousand million times what the experiment can ask of it."""
    s = problem.signals
    asked = float(np.abs(s.r).max()) / abs(problem.loop.plant.gain) + float(np.abs(s.load).max())
    scale = max(asked, problem.loop.valve.hold, float(np.abs(s.noise).max()) / abs(problem.loop.plant.gain), 1e-12)
    return not math.isfinite(cost) or float(np.abs(run.x).max()) > 1e9 * scale


def check_search(
    loop: Loop, bounds: Bounds, seed: int, digits: int, restarts: int, margin: float, time_limit: float | None
) -> None:
    """Raise `InvalidValue` where a search cannot be asked for so, or a free parameter starts outside its bounds."""
    whole(seed, "tune.seed")
    for name, count, most in (("digits", digits, 12), ("restarts", restarts, 100)):
        number(whole(count, f"tune.{name}"), f"tune.{name}", least=1, most=most)
    number(margin, "tune.margin", least=0.0, most=0.2)
    if time_limit is not None:
        number(time_limit, "tune.time_limit", above=0.0, unit="s")
    for name in NAMES:
        (low, high), value = getattr(bounds, name), getattr(loop.controller, name)
        slack = 1e-9 * max(abs(low), abs(high))
        if low < high and not low - slack <= value <= high + slack:
            allowed = f"the tuning to start from must lie within the bounds ({low:g}, {high:g})"
            raise InvalidValue(f"PID.{name}", value, allowed)


def _message(problem: Problem, found: Found, note: str, tuned: Tuned) -> str:
    parts = [note] if note else []
    remark = problem.remark(tuned.controller.Kc)
    parts += [remark] if remark else []
    around = f"within the larger of {100.0 * tuned.margin:g} % and half a last digit"
    if tuned.nominal_only:
        parts.append(f"the least J itself, not to be typed in: {around} J rises to {given(tuned.worst, 5)}")
    elif tuned.knife_edge:
        parts.append(f"a knife-edge: {around} J rises from {given(tuned.objective, 5)} to {given(tuned.worst, 5)}")
    if problem.limited and not problem.nominal and tuned.status is not SolveStatus.INFEASIBLE:
        count, points, most = problem.further(np.array([getattr(tuned.controller, name) for name in NAMES]))
        if count:
            parts.append(
                f"{around} the valve travels by up to {given(most, 3)} %, at {count} of {points} points too far"
            )
    for k in problem.free if not remark else ():
        low, high, value = float(problem.low[k]), float(problem.high[k]), float(getattr(tuned.controller, NAMES[k]))
        # No controller goes below 0: Td = 0 is a choice, a PI controller, and Kc = 0 leaves the loop alone.
        if value >= high * (1.0 - 1e-9) or 0.0 < value <= low * (1.0 + 1e-9):
            which = "upper" if value >= high * (1.0 - 1e-9) else "lower"
            parts.append(f"{NAMES[k]} ends on its {which} bound ({value:g}): wider bounds may give a better tuning")
    if problem.free.size == 0:
        parts.append("all parameters are fixed")
    elif not eq_2_alone(problem):
        parts.append("direct search on the exact simulator: branch programs know eq. (2) without constraints only")
    elif unwritten(problem.loop):
        parts.append(f"direct search on the exact simulator: branch programs do not know {unwritten(problem.loop)}")
    elif not usable(problem):
        parts.append(f"{problem.samples} samples: direct search on the exact simulator without branch programs")
    elif tuned.solves:
        parts.append(f"{found.accepted} of {tuned.solves} branch programs verified by exact simulation")
    if len(tuned.restarts) > 1:
        parts.append(f"{tuned.agreeing} of {len(tuned.restarts)} searches agree on the least J within 0.1 %")
    if tuned.worst_bound is not None:
        kept = "" if tuned.constraints is None else " that keeps the constraints"
        bound = given(tuned.worst_bound, 5)
        parts.append(f"no tuning within the bounds{tuned.asked_from}{kept} has a worst J below {bound}")
    parts.append(f"objective by exact simulation at {problem.digits} significant digits")
    return "; ".join(parts)
