"""Every case of a scenario as it is typed in at the site: rounded in its units, and what the digits beside these give.

A page has one basis: where the site rounds a case, what is typed in is what its run, its analyses and what a repair is
worth are of. Only the case as found keeps the scenario's own digits, as it is what is there now.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.controller import PID
from workbench.model.record import FloatArray
from workbench.model.site import Beside, SiteCase, SiteForm, SiteSettings
from workbench.model.study import CaseResult
from workbench.model.tuning import Objective
from workbench.scenario.plan import RULE_DIGITS
from workbench.simulate.run import evaluate, simulate
from workbench.tune.problem import last_offsets, unit_of

__all__ = [
    "MARGIN",
    "alike",
    "last_digits",
    "last_steps",
    "nearest_controllers",
    "neighbours",
    "same_numbers",
    "site_cases",
    "typed_controller",
    "typed_settings",
]

MARGIN = 0.001  # relative margin around settings that no search has found, as `tune` has it
ROUNDING = 1e-9  # relative difference of controllers that is the rounding error of a conversion


def nearest_controllers(site: SiteForm, cases: Sequence[CaseResult]) -> list[tuple[CaseResult, PID]]:
    """Return what comes nearest, as it is typed in, to each case that the site's form cannot take."""
    found = []
    for case in cases:
        try:
            site.settings(case.loop.controller)
        except InvalidValue:
            try:
                near = site.settings(case.loop.controller, case.digits or RULE_DIGITS, nearest=True)
            except InvalidValue:
                continue  # a controller without gain has nothing near it
            found.append((case, near.controller))
    return found


def site_cases(site: SiteForm, cases: Sequence[CaseResult], objective: Objective | None) -> tuple[SiteCase, ...]:
    """Return every case as the site writes it, with what exactly these rounded settings give in its experiment."""
    by_name = {case.name: case for case in cases}
    return tuple(_typed(site, case, by_name.get(case.nearest_to, case), objective) for case in cases)


def typed_settings(site: SiteForm, controller: PID, digits: int | None) -> SiteSettings:
    """Return a controller's settings as typed in, at the digits of its search. Raises `InvalidValue`."""
    return site.settings(controller, last_digits(site, controller, digits))


def last_digits(site: SiteForm, controller: PID, digits: int | None) -> int | None:
    """Return the digits that are typed in, None for all that there are.

    Without digits what was given in these very units stands as it was given; what is converted has no last digit of its
    own and gets those of a rule.
    """
    same = site.form == controller.form and site.units == SiteForm(controller.form, output=site.output).units
    return digits or (None if same else RULE_DIGITS)


def typed_controller(site: SiteForm, controller: PID, digits: int | None) -> PID:
    """Return what a controller is once its rounded numbers are typed in at the site, in its own form where that can be.

    Where the site's form has no equivalent, or rounds nothing, the controller itself.
    """
    try:
        typed = typed_settings(site, controller, digits).controller
    except InvalidValue:
        return controller
    if alike(typed, controller):
        return controller
    try:
        own = typed.to_form(controller.form)
    except InvalidValue:
        return typed  # what was rounded may lie just beyond what the own form can be
    # The way out and back leaves rounding errors in what no site rounds.
    kept = {
        name: getattr(controller, name)
        for name in ("Td", "derivative_filter", "setpoint_weight")
        if _near(getattr(own, name), getattr(controller, name)) or controller.Td == 0.0
    }
    return replace(own, **kept)


def same_numbers(one: PID, other: PID) -> bool:
    """Return whether two controllers have the same gain and times to type in, whatever else they differ in."""
    return (one.form, one.Kc, one.Ti, one.Td) == (other.form, other.Kc, other.Ti, other.Td)


def alike(one: PID, other: PID) -> bool:
    """Return whether two controllers are the same but for their form."""
    terms = one.ideal_terms(), other.ideal_terms()
    return all(_near(getattr(terms[0], name), getattr(terms[1], name)) for name in ("Kc", "Ti", "Td", "Tf", "b"))


def _near(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=ROUNDING)


def _typed(site: SiteForm, case: CaseResult, source: CaseResult, objective: Objective | None) -> SiteCase:
    controller, digits = case.loop.controller, source.digits
    try:
        settings = typed_settings(site, controller, digits)
    except InvalidValue as error:
        return SiteCase(case.name, None, refused=f"{error.given}: {error.allowed}")
    beside = _beside(site, settings, case, last_digits(site, controller, digits), objective)
    if alike(settings.controller, controller):
        return SiteCase(case.name, settings, case.run.kpis, case.objective, beside=beside)
    loop, experiment = case.loop.with_controller(settings.controller), case.run.experiment
    with np.errstate(over="ignore", invalid="ignore"):  # a diverging loop overflows; its figures say so
        kpis = simulate(loop, experiment).kpis
        cost = None if objective is None else float(evaluate(loop, experiment, objective)[0])
    return SiteCase(case.name, settings, kpis, cost, beside=beside)


def _beside(
    site: SiteForm, settings: SiteSettings, case: CaseResult, digits: int | None, objective: Objective | None
) -> Beside:
    """Return what settings beside those typed in give, looked at as closely as the last word of a search."""
    margin = MARGIN if case.tuned is None else case.tuned.margin
    loop, experiment = case.loop.with_controller(settings.controller), case.run.experiment
    near = neighbours(site, settings, margin, digits, last_offsets(case.run.pv.size))
    steps = last_steps(site, settings, digits)
    tunings = np.array([(pid.Kc, pid.Ti, pid.Td) for pid in (*near, *steps)])
    costs = evaluate(loop, experiment, objective or Objective.of(mean_square_error=1.0), tunings)
    costs = np.where(np.isnan(costs), np.inf, costs)
    most = int(np.argmax(costs[: len(near)]))
    with np.errstate(over="ignore", invalid="ignore"):
        kpis = simulate(loop.with_controller(near[most]), experiment).kpis
    step = float(costs[len(near) :].max()) if steps else math.nan
    return Beside(margin, digits, float(costs[most]), kpis, step)


def neighbours(
    site: SiteForm, settings: SiteSettings, margin: float, digits: int | None, offsets: FloatArray
) -> list[PID]:
    """Return controllers beside one that is typed in, as `Beside` says; offsets: in [-1, 1]^3, shape (M, 3)."""
    typed, size, unit = _typed_numbers(settings, digits)
    return [_made(site, settings, point) for point in typed + offsets * np.maximum(margin * size, 0.5 * unit)]


def last_steps(site: SiteForm, settings: SiteSettings, digits: int | None) -> list[PID]:
    """Return the controllers one unit in one last digit below and above, none without digits."""
    typed, size, unit = _typed_numbers(settings, digits)
    steps = [typed + sign * row for row in np.diag(unit) if row.any() for sign in (-1.0, 1.0)]
    return [_made(site, settings, point) for point in steps if (point[size > 0.0] > 0.0).all()]


def _typed_numbers(settings: SiteSettings, digits: int | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the three numbers typed in, their sizes, and the units of their last digits: 0 for what is not there."""
    typed = np.array([settings.gain, settings.integral, settings.derivative])
    size = np.where(np.isfinite(typed), np.abs(typed), 0.0)
    return typed, size, np.zeros(3) if digits is None else unit_of(size, digits)


def _made(site: SiteForm, settings: SiteSettings, point: FloatArray) -> PID:
    gain, integral, derivative = (float(value) for value in point)
    return site.made(settings.controller, gain, integral, derivative)
