"""Controllers, bounds and tunings to be found: from their entries in the file to the model's values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from workbench.errors import InvalidValue
from workbench.model.compensator import TwoMove
from workbench.model.controller import PID, STRUCTURES
from workbench.model.loop import Loop
from workbench.model.plant import Plant
from workbench.model.rule import Rule
from workbench.model.tuning import WEIGHABLE, Bounds, Objective
from workbench.model.units import gain_from
from workbench.scenario import schema
from workbench.scenario.compensator_entries import compensator_of
from workbench.scenario.document import Path
from workbench.scenario.plan import RULE_DIGITS, CaseJob, TuneJob
from workbench.scenario.refusals import Refusals
from workbench.scenario.units import Quantity

__all__ = ["Controllers", "fitting_action", "ruled", "wrong_way"]


def fitting_action(plant: Plant, *, fail_open: bool = False) -> str:
    """Return the controller action that makes the feedback negative."""
    return "reverse" if (plant.gain > 0.0) != fail_open else "direct"


def wrong_way(plant: Plant, controller: PID, *, fail_open: bool = False) -> str | None:
    """Return what is wrong where controller, valve and plant feed back positively, else None."""
    fitting = fitting_action(plant, fail_open=fail_open)
    if controller.Kc == 0.0 or controller.action == fitting:
        return None
    behind = " behind a fail-open valve" if fail_open else ""
    return (
        f"the controller acts the wrong way, so that errors grow: a plant gain of {plant.gain:g}{behind} needs action "
        f"{fitting}"
    )


def ruled(loop: Loop, controller: PID, rule: Rule) -> PID:
    """Return what a rule makes of this controller in a loop, at the digits to type in. Raises `InvalidValue`."""
    from workbench.tune.rules import apply_rule  # scipy: only where a scenario has rules

    return apply_rule(loop.with_controller(controller), rule, digits=RULE_DIGITS)


@dataclass
class Controllers:
    """Reads controllers and tunings; what is refused goes to `refusals`.

    pv_range: EU, or None; without_range: what is then said of gains that need one. duration: of the experiment, s, once
    it is known.
    """

    refusals: Refusals
    pv_range: tuple[float, float] | None
    without_range: str = "needs loop.pv_range: [low, high] in EU"
    duration: float = math.inf
    gain_refused: bool = field(default=False, init=False)  # one stands at 0 for now: nothing is to be said of that

    def keys(self, given: schema.ControllerKeys, path: Path) -> dict[str, Any]:
        """Return the PID's fields that an entry sets."""
        there = given.model_fields_set
        fields: dict[str, Any] = {
            name: getattr(given, name)
            for name in schema.ControllerKeys.model_fields
            if name in there
            and name not in ("structure", "output_limits", "compensator")
            and getattr(given, name) is not None
        }
        if "compensator" in there:
            entry = given.compensator
            make = None if entry is None else partial(compensator_of, entry)
            fields["compensator"] = None if make is None else self.refusals.attempt((*path, "compensator"), make)
        if "output_limits" in there:
            fields["output_limits"] = None if given.output_limits is None else tuple(given.output_limits)
        if given.structure is not None:
            for name in ("derivative_on", "setpoint_weight"):
                if name in fields:
                    self.refusals.refuse(
                        (*path, name), f"given, and structure as well; structure says it ({given.structure})"
                    )
            fields["derivative_on"], fields["setpoint_weight"] = STRUCTURES[given.structure]
        return fields

    def tuning(self, given: schema.Tuning, path: Path, form: str) -> dict[str, float]:
        """Return Kc (%/EU), Ti (s) and Td (s), as far as an entry gives them."""
        found: dict[str, float] = {}
        if given.Kc is not None and given.proportional_band is not None:
            self.refusals.refuse((*path, "proportional_band"), "given, and Kc as well; one of the two is needed")
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
            why = "given in % of the PV range; a parallel controller takes its gains in %/EU"
        else:
            try:
                return gain_from(quantity.value, quantity.unit, self.pv_range)
            except InvalidValue as error:
                why = f"{error.given} given; {error.allowed}"
                if error.where == "pv_range":
                    why = f"a gain in {quantity.unit} given; {self.without_range}"
        self.refusals.refuse(path, why)
        self.gain_refused = True
        return None

    def pid(self, path: Path, fields: dict[str, Any], tuning: dict[str, float]) -> PID | None:
        """Return the controller of these fields and tuning, if Kc and Ti are there and the model takes it."""
        for name in ("Kc", "Ti"):
            if name not in tuning:
                self.refusals.refuse((*path, name), "missing; give it here or in loop.controller")
        if "Kc" not in tuning or "Ti" not in tuning:
            return None

        def make() -> PID:
            controller = PID(**{**fields, **tuning})
            controller.ideal_terms()  # refused here, where the entry is known, if the simulation could not take it
            return controller

        return self.refusals.attempt(path, make)

    def sampled(
        self, controller: PID, tune: TuneJob | None, path: Path, sample_time: float | None, *, own: bool = True
    ) -> bool:
        """Return whether compensator and back-calculation suit the sample time (s), for every Ti of a tuning.

        Refuses what does not. own: whether the entry at `path`, and not loop.controller, says the compensator.
        """
        if sample_time is None:
            return True
        least = controller if tune is None else replace(controller, Ti=min(controller.Ti, tune.bounds.Ti[0]))
        before = len(self.refusals.issues)
        at = path if tune is None else (*path, "tune")
        self.refusals.attempt(at, lambda: least.check_tracking(sample_time))
        if controller.compensator is not None:
            under = (*(at if own else ("loop", "controller")), "compensator")
            self.refusals.attempt(under, partial(controller.compensator.check, sample_time))
            begin = controller.compensator.at if isinstance(controller.compensator, TwoMove) else 0.0
            if begin > self.duration:
                # As a step of the experiment that would never come.
                what = f"{begin:g} s given; must be within the experiment's duration ({self.duration:g} s)"
                self.refusals.refuse((*under, "at"), what)
        return len(self.refusals.issues) == before

    def objective(self, given: schema.Objective | None, path: Path) -> Objective | None:
        """Return the weights of an entry."""
        if given is None:
            return None
        kpis = {name: getattr(given, name) for name in WEIGHABLE}
        return self.refusals.attempt(path, lambda: Objective(given.w1, given.w2, given.w3, given.w4, kpis))

    def tuned(
        self,
        given: schema.Tune,
        path: Path,
        base: dict[str, Any],
        base_tuning: dict[str, float],
        first: CaseJob | None,
        common: Objective | None,
    ) -> tuple[PID, TuneJob] | None:
        """Return the start and the task of a tuning to be found.

        base, base_tuning: what loop.controller says; first: the first given case, whose tuning may be the start.
        common: the scenario's objective.
        """
        fields = {**base, **self.keys(given, path)}
        form = fields.get("form", "ideal")
        fixed = self.tuning(given, path, form)
        bounds = self.bounds(given.bounds, path, form, fixed)
        own = self.objective(given.objective, (*path, "objective"))
        if bounds is None or (given.objective is not None and own is None):
            return None
        start, source = self._start(given, path, form, bounds, base_tuning, first)
        start |= fixed
        controller = self.pid(path, fields, start)
        if controller is None:
            return None
        for name in ("Ti", "Td") if self.gain_refused else ("Kc", "Ti", "Td"):
            low, high = getattr(bounds, name)
            value = getattr(controller, name)
            if low < high and not low - 1e-9 * abs(low) <= value <= high + 1e-9 * abs(high):
                what = (
                    f"[{low:g}, {high:g}] excludes the start, {name} = {value:g} ({source}); widen the bounds, "
                    "or give tune.start"
                )
                self.refusals.refuse((*path, "bounds", name), what)
        job = TuneJob(
            own or common or Objective(), bounds, given.seed, given.digits, given.restarts, nominal=given.nominal
        )
        return controller, job

    def bounds(self, given: schema.Bounds | None, path: Path, form: str, fixed: dict[str, float]) -> Bounds | None:
        """Return the bounds of the entry at `path`, whose bounds are `given`; fixed parameters are held."""
        pairs: dict[str, tuple[float, float]] = {}
        under = (*path, "bounds")
        asked = given or schema.Bounds()
        if asked.Kc is not None and asked.proportional_band is not None:
            self.refusals.refuse((*under, "proportional_band"), "given, and Kc as well; one of the two is needed")
        for name in ("Kc", "proportional_band"):
            ends = getattr(asked, name)
            if ends is None:
                continue
            values = [self._gain(end, (*under, name, i), form) for i, end in enumerate(ends)]
            if values[0] is not None and values[1] is not None:
                # A wide proportional band is a small gain, whichever of the two is written first.
                pair = values[0], values[1]
                pairs["Kc"] = pair if name == "Kc" else (min(pair), max(pair))
        if asked.Ti is not None:
            low, high = asked.Ti
            pairs["Ti"] = low, high
        if asked.Td is not None:
            low, high = asked.Td
            pairs["Td"] = low, high
        for name, value in fixed.items():
            if name in pairs:
                self.refusals.refuse((*under, name), f"given, and tune.{name} as well, which holds it at {value:g}")
            pairs[name] = value, value
        if "Ti" in pairs and math.isinf(pairs["Ti"][1]):
            at = under if "Ti" not in fixed else path
            self.refusals.refuse((*at, "Ti"), "no integral action given; a tuning needs a finite Ti")
            return None
        return self.refusals.attempt(under if given is not None else path, lambda: Bounds(**pairs))

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
            mine = {**base, **self.tuning(given.start, (*path, "start"), form)}
            return mine, "tune.start"
        if "Kc" in base and "Ti" in base:
            return dict(base), "loop.controller"
        if first is not None and first.controller.form == form:
            c = first.controller
            return {"Kc": c.Kc, "Ti": c.Ti, "Td": c.Td}, first.name
        (a, b), (c1, d), (e, _) = bounds.Kc, bounds.Ti, bounds.Td
        return {"Kc": math.sqrt(max(a, b / 100.0) * b), "Ti": math.sqrt(c1 * d), "Td": e}, "the bounds' middle"
