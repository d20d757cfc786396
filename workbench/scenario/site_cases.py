"""Every case of a scenario as it is typed in at the site: rounded in its units, and simulated with these digits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.controller import PID
from workbench.model.site import SiteCase, SiteForm, SiteSettings
from workbench.model.study import CaseResult
from workbench.model.tuning import Objective
from workbench.scenario.plan import RULE_DIGITS
from workbench.simulate.run import evaluate, simulate

__all__ = ["nearest_controllers", "site_cases", "typed_settings"]


def nearest_controllers(site: SiteForm, cases: Sequence[CaseResult]) -> list[tuple[CaseResult, PID]]:
    """Return what comes nearest, as it is typed in, to each case that the site's form cannot take."""
    found = []
    for case in cases:
        try:
            site.settings(case.loop.controller)
        except InvalidValue:
            try:
                near = site.settings(case.loop.controller, _digits(case) or RULE_DIGITS, nearest=True)
            except InvalidValue:
                continue  # a controller without gain has nothing near it
            found.append((case, near.controller))
    return found


def site_cases(site: SiteForm, cases: Sequence[CaseResult], objective: Objective | None) -> tuple[SiteCase, ...]:
    """Return every case as the site writes it, with what exactly these rounded settings give in its experiment."""
    by_name = {case.name: case for case in cases}
    return tuple(_typed(site, case, by_name.get(case.nearest_to, case), objective) for case in cases)


def _digits(case: CaseResult) -> int | None:
    return None if case.tuned is None else case.tuned.digits


def typed_settings(site: SiteForm, controller: PID, digits: int | None) -> SiteSettings:
    """Return a controller's settings as typed in, at the digits of its search. Raises `InvalidValue`.

    Without digits what was given in these very units stands as it was given; what is converted has no last digit of its
    own and gets those of a rule.
    """
    same = site.form == controller.form and site.units == SiteForm(controller.form, output=site.output).units
    return site.settings(controller, digits or (None if same else RULE_DIGITS))


def _typed(site: SiteForm, case: CaseResult, source: CaseResult, objective: Objective | None) -> SiteCase:
    controller = case.loop.controller
    try:
        settings = typed_settings(site, controller, _digits(source))
    except InvalidValue as error:
        return SiteCase(case.name, None, refused=f"{error.given}: {error.allowed}")
    if settings.controller == controller:
        return SiteCase(case.name, settings, case.run.kpis, case.objective)
    loop, experiment = case.loop.with_controller(settings.controller), case.run.experiment
    with np.errstate(over="ignore", invalid="ignore"):  # a diverging loop overflows; its figures say so
        kpis = simulate(loop, experiment).kpis
        cost = None if objective is None else float(evaluate(loop, experiment, objective)[0])
    return SiteCase(case.name, settings, kpis, cost)
