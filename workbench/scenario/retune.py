"""Tuning without a scenario written for it: a scenario's loop under other wishes, or a loop found in a record."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from workbench.analyze.standing import standing
from workbench.errors import InvalidValue, RecordError
from workbench.model.controller import PID
from workbench.model.ensemble import Constraints
from workbench.model.experiment import Experiment, Step
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.results import Estimate, SolveStatus, Standing, Tuned
from workbench.model.rule import Simc
from workbench.model.site import SiteCase, SiteForm
from workbench.model.study import CaseResult
from workbench.model.tuning import Bounds, Objective
from workbench.report.known import gain_doubt, hint
from workbench.report.words import error_and_wear
from workbench.scenario.controllers import fitting_action, ruled, wrong_way
from workbench.scenario.plan import CaseJob, Scenario, TuneJob
from workbench.scenario.runner import Progress, for_plant, run_scenario, tune_case
from workbench.scenario.site_cases import site_cases
from workbench.simulate.run import evaluate, simulate
from workbench.tune.rules import apply_rule

__all__ = ["Retuned", "Wishes", "run_words", "tune_found", "tune_scenario"]

Range = tuple[float, float]

# How long a found loop is simulated to tune it, in samples.
FEWEST, MOST = 300, 20_000
# Maximum sensitivity of a found loop with an ideal valve, at most: a plant from a record is never known exactly, and a
# load that keeps the stem moving leaves the loop without the stiction that may hold it (1.4 to 2 are usual; K. Astrom,
# T. Hagglund, Advanced PID Control, 2006).
SAFE = 2.0


@dataclass(frozen=True, slots=True)
class Wishes:
    """What is asked beside the loop; None leaves it to the scenario or to the loop found.

    Bounds of Kc (%/EU), Ti (s), Td (s), equal ends fix; seed of the search; for a loop from a record also the setpoint
    step (EU, other than 0), the duration (s), the controller's action and the maximum sensitivity (> 1, inf for none)
    that the loop with an ideal valve is to keep. Raises `InvalidValue`.
    """

    objective: Objective | None = None
    Kc: Range | None = None
    Ti: Range | None = None
    Td: Range | None = None
    seed: int | None = None
    step: float | None = None
    duration: float | None = None
    action: str | None = None
    max_sensitivity: float | None = None

    def __post_init__(self) -> None:
        if self.step == 0.0:
            raise InvalidValue("--step", "0 EU", "must be other than 0, or there is nothing to tune for")
        if self.action not in (None, "reverse", "direct"):
            raise InvalidValue("--action", self.action, "must be reverse or direct")
        if self.max_sensitivity is not None and not self.max_sensitivity > 1.0:
            raise InvalidValue("--max-sensitivity", f"{self.max_sensitivity:g}", "must be > 1, or none")


@dataclass(frozen=True, eq=False)
class Retuned:
    """A tuning under its name, with what was assumed to find it, in words, and how it holds its loop by itself.

    site: how the site writes its settings, and typed: the tuning as it is typed in there; None where no one has said.
    """

    name: str
    tuned: Tuned
    assumed: tuple[str, ...] = ()
    standing: Standing | None = None
    site: SiteForm | None = None
    typed: SiteCase | None = None


def tune_scenario(plan: Scenario, wishes: Wishes, progress: Progress | None = None) -> list[Retuned]:
    """Tune what the scenario asks to tune, else its loop from the first case's controller.

    Wishes go before the scenario's own objective, bounds and seed. Ends with a tuning that was interrupted. Raises
    `InvalidValue` where there is no loop or experiment, or the wishes belong to a record's loop, and what tuning and
    estimating raise; `RecordError` where the scenario's record does not show the plant's gain.
    """
    for name in ("step", "duration", "action", "max_sensitivity"):
        if (given := getattr(wishes, name)) is not None:
            given = "none" if given == math.inf else given
            raise InvalidValue(f"--{name.replace('_', '-')}", given, "is for a record; a scenario states its own")
    experiment = plan.experiment
    if plan.cascade:
        raise InvalidValue(
            str(plan.path), "a cascade", "a single loop is needed; a cascade's tuning is its case's task"
        )
    if not plan.cases or experiment is None:
        raise InvalidValue(str(plan.path), "no case and experiment", "needs both, to know controller and task")
    base, cases, notes, source = _loop(plan, progress)
    jobs = [case for case in cases if case.tune is not None]
    if not jobs:
        first = cases[0]
        start = first.controller if first.rule is None else ruled(base, first.controller, first.rule)
        default = TuneJob(plan.objective or Objective(), Bounds(), 0, None, 4)
        jobs = [CaseJob("Tuned", first.where, start, default)]
    found: list[Retuned] = []
    for case in jobs:
        if case.tune is None:
            continue
        own = case.tune
        bounds = Bounds(wishes.Kc or own.bounds.Kc, wishes.Ti or own.bounds.Ti, wishes.Td or own.bounds.Td)
        job = replace(
            own,
            objective=wishes.objective or own.objective,
            bounds=bounds,
            seed=own.seed if wishes.seed is None else wishes.seed,
        )
        controller = _within(case.controller, wishes)
        as_case = own.robust.as_case if own.robust is not None else ""
        known = {as_case: _controller(as_case, base, cases, found)} if as_case else {}
        tuned = tune_case(base.with_controller(controller), experiment, job, progress, known)
        stands = _standing(tuned, source)
        doubt = hint(source, standing=stands)
        assumed, site = (*notes, *((doubt,) if doubt else ())), plan.site
        typed = None if site is None else _typed(site, case.name, tuned)
        found.append(Retuned(case.name, tuned, assumed, stands, site, typed))
        if tuned.status is SolveStatus.INTERRUPTED:
            break
    return found


def run_words(tuned: Tuned) -> str:
    """Return what a tuning makes of error and wear in the run of its experiment, against the loop's own controller."""
    loop, both = tuned.loop, (tuned.controller, tuned.loop.controller)
    # A diverging loop overflows; its figures say so.
    with np.errstate(over="ignore", invalid="ignore"):
        now, was = (simulate(loop.with_controller(controller), tuned.experiment).kpis for controller in both)
    return error_and_wear((now.mean_square_error, was.mean_square_error), (now.valve_travel, was.valve_travel))


def _typed(site: SiteForm, name: str, tuned: Tuned) -> SiteCase:
    """Return a tuning as it is typed in at the site, with what it gives in the experiment with exactly these digits."""
    loop = tuned.loop.with_controller(tuned.controller)
    with np.errstate(over="ignore", invalid="ignore"):
        run = simulate(loop, tuned.experiment)
        cost = float(evaluate(loop, tuned.experiment, tuned.weights)[0])
    return site_cases(site, [CaseResult(name, loop, run, cost, tuned)], tuned.weights)[0]


def _controller(name: str, base: Loop, cases: tuple[CaseJob, ...], found: list[Retuned]) -> PID:
    """Return the controller of the case of that name, tuned already where it asks for a tuning."""
    case = next(case for case in cases if case.name == name)
    if case.tune is not None:
        return next(one.tuned.controller for one in found if one.name == name)
    if case.rule is None:
        return case.controller
    return ruled(base, _controller(case.base, base, cases, found) if case.base else case.controller, case.rule)


def _standing(tuned: Tuned, source: Estimate | None) -> Standing | None:
    """Return how a tuning holds its loop by itself; source: the estimate of a plant's record that is the loop."""
    loop = tuned.loop.with_controller(tuned.controller)
    return standing(loop, None if source is None else source.intervals)


def _loop(
    plan: Scenario, progress: Progress | None
) -> tuple[Loop, tuple[CaseJob, ...], tuple[str, ...], Estimate | None]:
    """Return the loop, the cases with the action that it needs, notes on what was assumed, and a record's estimate."""
    if plan.loop is not None:
        return plan.loop, plan.cases, plan.mistakes, None
    study = run_scenario(replace(plan, cases=(), estimates=plan.estimates[:1]), progress=progress)
    named = study.estimates[0]
    found = named.found
    if named.truth is None:
        _refuse_blind(found)
    cases, notes, mistakes = for_plant(plan.cases, found.plant)
    loop = Loop(found.plant, found.valve, cases[0].controller, found.record.sample_time, plan.pv_range)
    return loop, cases, (*mistakes, *notes, *_coarse(loop)), found if named.truth is None else None


def _refuse_blind(found: Estimate) -> None:
    """Raise `RecordError` for an estimate whose record does not show the plant's gain."""
    if doubt := gain_doubt(found):
        raise RecordError(
            f"{found.record.source or 'record'}: the record {doubt}; take one in which OP clearly moves PV"
        )


def _coarse(loop: Loop) -> tuple[str, ...]:
    note = loop.sampling_note()
    return () if note is None else (f"coarse sampling: {note}",)


def _within(controller: PID, wishes: Wishes) -> PID:
    """Return the start moved into the bounds that were wished for."""
    moved = {}
    for name in ("Kc", "Ti", "Td"):
        bounds = getattr(wishes, name)
        if bounds is not None:
            moved[name] = min(max(getattr(controller, name), bounds[0]), bounds[1])
    return replace(controller, **moved) if moved else controller


def tune_found(found: Estimate, wishes: Wishes, progress: Progress | None = None) -> Retuned:
    """Tune a PI controller (a PID where Td is given bounds) for a loop estimated from a record.

    Unless wished otherwise: from the SIMC rule, Kc up to 4 times its gain and at least to twice the inverse of the
    plant's, Ti from a fifth of the plant's time scale, or half of the rule's where that is less, to 20 times that
    scale; a setpoint step of twice the PV change of the least slip (without stiction: of PV's standard deviation) and,
    half way, a load step of half that size at the plant's input; D on PV; a maximum sensitivity of `SAFE` at most with
    an ideal valve. Where the bounds hold no tuning that keeps it, none is asked for. What was assumed is said in the
    result. Raises `RecordError` where the record does not show the plant's gain, `InvalidValue` for an action with
    which errors grow, and what tuning raises.
    """
    _refuse_blind(found)
    plant, Ts = found.plant, found.record.sample_time
    lag = max(plant.dead_time, Ts)
    scale = (plant.time_constant if isinstance(plant, FOPDT) else 4.0 * lag) + lag
    suited = fitting_action(plant)
    effect = abs(plant.gain) * (1.0 if isinstance(plant, FOPDT) else scale)
    # Without dead time the sample time stands in for it.
    lagging = Loop(replace(plant, dead_time=lag), found.valve, PID(0.0, math.inf, action=suited), Ts)
    simc = apply_rule(lagging, Simc())
    Kc, Ti = simc.Kc, simc.Ti
    bounds = Bounds(
        # Where dead time dominates, the rule's gain and integral time are small beside what such a loop can take.
        Kc=wishes.Kc or (0.0, _round(max(4.0 * Kc, 2.0 / effect))),
        Ti=wishes.Ti or (_round(min(scale / 5.0, max(Ti / 2.0, Ts / 5.0))), _round(20.0 * scale)),
        Td=wishes.Td or (0.0, 0.0),
    )
    action = wishes.action or suited
    start = PID(
        Kc=min(max(Kc, bounds.Kc[0]), bounds.Kc[1]),
        Ti=min(max(Ti, bounds.Ti[0]), bounds.Ti[1]),
        Td=min(max(0.0, bounds.Td[0]), bounds.Td[1]),
        derivative_on="pv",
        action=action,
    )
    # A search could but switch such a controller off.
    if wrong := wrong_way(plant, replace(start, Kc=1.0)):
        raise InvalidValue("--action", action, wrong)
    loop = Loop(plant, found.valve, start, Ts)
    samples = min(max(round(60.0 * scale / Ts), FEWEST), MOST)
    duration = samples * Ts
    if wishes.duration is not None:
        # No round duration need be a whole number of samples of a record's own clock.
        duration = max(1, round(wishes.duration / Ts)) * Ts if wishes.duration > 0.0 else wishes.duration
    step = wishes.step if wishes.step is not None else _round(_usual_step(found, plant, scale))
    load = _round(0.5 * abs(step) / effect)
    at = round(0.5 * duration / Ts) * Ts
    experiment = Experiment(duration, Step(step), Step(load, at) if load > 0.0 else None)
    objective = wishes.objective or Objective(w1=0.5, w2=0.0, w3=0.5, w4=0.0)
    most = SAFE if wishes.max_sensitivity is None else wishes.max_sensitivity
    safe = Constraints(max_sensitivity=most) if math.isfinite(most) else None
    job = TuneJob(objective, bounds, wishes.seed or 0, digits=None, restarts=4, constraints=safe)
    task = f"setpoint step of {step:g} EU at 0 s and load step of {load:g} % at {at:g} s, over {duration:g} s"
    searched = ", ".join(
        f"{name} {low:g} to {high:g} {unit}"
        for name, (low, high), unit in (("Kc", bounds.Kc, "%/EU"), ("Ti", bounds.Ti, "s"), ("Td", bounds.Td, "s"))
    )
    verdict = {"stiction": "the valve sticks", "no_stiction": "no stiction"}.get(found.verdict, "")
    tuned = tune_case(loop, experiment, job, progress)
    kept = "no maximum sensitivity" if safe is None else f"maximum sensitivity {most:g} at most, with an ideal valve"
    if tuned.status is SolveStatus.INFEASIBLE:
        tuned = tune_case(loop, experiment, replace(job, constraints=None), progress)
        kept = f"no maximum sensitivity, as none within the bounds keeps one of {most:g} with an ideal valve"
    stands = _standing(tuned, found)
    assumed = (
        f"the record's loop: {'; '.join(words for words in (verdict, hint(found, standing=stands)) if words)}",
        task,
        f"bounds {searched}",
        kept,
        f"{action} action, derivative on PV",
        *_coarse(loop),
    )
    return Retuned("Tuned for the record's loop", tuned, assumed, stands)


def _usual_step(found: Estimate, plant: Plant, scale: float) -> float:
    """Return twice the PV change of the least slip (of PV's standard deviation where nothing slips), EU."""
    slip = abs(plant.gain) * found.valve.slip_jump * (1.0 if isinstance(plant, FOPDT) else scale)
    if slip > 0.0:
        return 2.0 * slip
    deviation = float(found.record.pv.std())
    return 2.0 * deviation if deviation > 0.0 else 1.0


def _round(value: float) -> float:
    """Return a value at two significant digits, as an engineer would choose it."""
    return float(f"{value:.2g}") if math.isfinite(value) else value
