"""`wb.value_of_repair`: the same loop with its sticky valve and with a repaired one, each at its best tuning."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.checks import callback, instance
from workbench.model.controller import PID
from workbench.model.experiment import Experiment
from workbench.model.front import RobustRepair
from workbench.model.loop import Loop
from workbench.model.results import Outcome, Repair, SolveStatus, Tuned
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Ideal
from workbench.simulate.run import evaluate, simulate
from workbench.tune.budget import Progress
from workbench.tune.ensemble import Circumstances, measured
from workbench.tune.tune import tune

__all__ = ["outcome", "repair_over", "repaired_outcome", "usual_bounds", "value_of_repair"]


def value_of_repair(
    loop: Loop,
    experiment: Experiment,
    objective: Objective | None = None,
    bounds: Bounds | None = None,
    seed: int = 0,
    *,
    tuned: Tuned | None = None,
    digits: int = 4,
    restarts: int = 4,
    progress: Progress | None = None,
) -> Repair:
    """Return what repairing the valve is worth to a loop: figures with the sticky valve and with an ideal one.

    Both at the loop's present tuning, and each at the best tuning that `tune` finds for it under the same objective,
    bounds, seed, digits and restarts. tuned: a search of the sticky loop that has been made already; its experiment,
    objective, bounds, seed, digits and number of restarts are then used (and those given here are not). Without bounds:
    the defaults widened to hold the present tuning, and PI where that has Td = 0. A search for a loop without integral
    action starts at the longest Ti of the bounds. A stem offset of the experiment is
    left out with the ideal valve, which holds none, and so is a compensator. progress: as `tune`.

    One setpoint step and nothing else flatters the sticky valve: a search finds the tuning that lands on the setpoint
    and rests there. Give an experiment with the load changes and the noise that the loop has to live with.

    Raises `InvalidValue` for a valve that does not stick or another loop's `tuned`, and what `tune` raises;
    KeyboardInterrupt where the first search was interrupted.
    """
    instance(loop, Loop, "loop", "a Loop")
    callback(progress, "value_of_repair.progress")
    if loop.valve.stick_band == 0.0 and loop.valve.slip_jump == 0.0:
        raise InvalidValue("Loop.valve", loop.valve, "must be a valve that sticks: there is nothing to repair")
    if tuned is not None:
        instance(tuned, Tuned, "tuned", "what `tune` returns, or None")
        if replace(tuned.loop, controller=loop.controller) != loop:
            raise InvalidValue("tuned", "the tuning of another loop", "must be a tuning of this plant and valve")
        if tuned.experiment != experiment:
            raise InvalidValue("tuned", "a tuning in another experiment", "must be a tuning in the given experiment")
        objective, bounds, seed, digits = tuned.weights, tuned.bounds, tuned.seed, tuned.digits
        restarts = len(tuned.restarts) or restarts
    objective = Objective() if objective is None else objective
    bounds = usual_bounds(loop.controller) if bounds is None else bounds

    def part(begin: float, size: float, words: str, share: float) -> None:
        if progress is not None:
            progress(words, begin + size * share)

    half = 0.0 if tuned is not None else 0.5
    if tuned is None:
        pid = loop.controller
        start = pid if math.isfinite(pid.Ti) else replace(pid, Ti=bounds.Ti[1])
        tuned = tune(
            loop.with_controller(start),
            experiment,
            objective,
            bounds,
            seed,
            digits=digits,
            restarts=restarts,
            progress=partial(part, 0.0, 0.5),
        )
    if tuned.status is SolveStatus.INTERRUPTED:
        raise KeyboardInterrupt
    # From where the search of the sticky loop started, which lies within the bounds.
    ideal, quiet = _repaired(tuned.loop, experiment)
    tuned_repaired = tune(
        ideal,
        quiet,
        objective,
        bounds,
        seed,
        digits=digits,
        restarts=restarts,
        progress=partial(part, half, 1.0 - half),
    )
    return Repair(
        loop=loop,
        experiment=experiment,
        weights=objective,
        present=outcome(loop, experiment, objective),
        repaired=repaired_outcome(loop, experiment, objective),
        best=outcome(loop.with_controller(tuned.controller), experiment, objective),
        best_repaired=outcome(ideal.with_controller(tuned_repaired.controller), quiet, objective),
        tuned=tuned,
        tuned_repaired=tuned_repaired,
    )


def repair_over(tuned: Tuned, present: PID, *, progress: Progress | None = None) -> RobustRepair:
    """Return what repair is worth over the ensemble of a robust tuning of the sticky loop.

    present: the controller in use. The ideal valve gets a robust tuning of its own under the same objective, bounds,
    constraints, seed, digits and restarts. Raises `InvalidValue` where `tuned` is not robust or its valve does not
    stick.
    """
    if tuned.ensemble is None or tuned.robustness is None:
        raise InvalidValue("tuned", "a tuning to one experiment", "must be a robust tuning")
    loop = tuned.loop
    if isinstance(loop.valve, Ideal):
        raise InvalidValue("Loop.valve", loop.valve, "must be a valve that sticks: there is nothing to repair")
    ideal = _ideal(loop.with_controller(tuned.controller))
    again = tune(
        ideal,
        tuned.experiment,
        tuned.weights,
        tuned.bounds,
        tuned.seed,
        digits=tuned.digits,
        restarts=len(tuned.restarts) or 1,
        robust=tuned.ensemble,
        constraints=tuned.constraints,
        progress=progress,
    )
    fresh = tuned.robustness.ensemble
    sticky, repaired = Circumstances(loop.with_controller(present), fresh), Circumstances(ideal, fresh)
    return RobustRepair(
        present=measured(sticky, tuned.weights),
        repaired=measured(repaired.under(replace(present, compensator=None)), tuned.weights),
        best=tuned.robustness,
        best_repaired=measured(repaired.under(again.controller), tuned.weights),
        tuned=tuned,
        tuned_repaired=again,
    )


def outcome(loop: Loop, experiment: Experiment, objective: Objective) -> Outcome:
    """Return J and the figures of a loop in an experiment. Raises `InvalidValue`."""
    # A diverging loop overflows; its figures say so.
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(evaluate(loop, experiment, objective)[0])
        return Outcome(loop.controller, cost, simulate(loop, experiment).kpis)


def repaired_outcome(loop: Loop, experiment: Experiment, objective: Objective) -> Outcome:
    """Return the same with an ideal valve under the same controller. Raises `InvalidValue`."""
    return outcome(*_repaired(loop, experiment), objective)


def _repaired(loop: Loop, experiment: Experiment) -> tuple[Loop, Experiment]:
    return _ideal(loop), replace(experiment, stem_offset=0.0)


def _ideal(loop: Loop) -> Loop:
    """The loop with an ideal valve; what was there against stiction is taken out with it."""
    return replace(loop, valve=Ideal(), controller=replace(loop.controller, compensator=None))


def usual_bounds(controller: PID, given: Bounds | None = None) -> Bounds:
    """Return bounds wide enough for the present tuning: those given, or the default ones.

    The default ones have no derivative where the present tuning has none. A tuning without integral action lies beyond
    any bounds of Ti.
    """
    usual = Bounds() if given is None else given

    def with_present(name: str) -> tuple[float, float]:
        low, high = getattr(usual, name)
        value = getattr(controller, name)
        # No integral action has no finite time that bounds could hold.
        return (min(low, value), max(high, value)) if math.isfinite(value) else (low, high)

    none = given is None and controller.Td == 0.0
    return Bounds(with_present("Kc"), with_present("Ti"), (0.0, 0.0) if none else with_present("Td"))
