"""Every case of a scenario as it is typed in at the site: rounded in its units, and simulated with these digits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.site import SiteCase, SiteForm
from workbench.model.study import CaseResult
from workbench.model.tuning import Objective
from workbench.scenario.plan import RULE_DIGITS
from workbench.simulate.run import evaluate, simulate

__all__ = ["site_cases"]


def site_cases(site: SiteForm, cases: Sequence[CaseResult], objective: Objective | None) -> tuple[SiteCase, ...]:
    """Return every case as the site writes it, with what exactly these rounded settings give in its experiment."""
    return tuple(_typed(site, case, objective) for case in cases)


def _typed(site: SiteForm, case: CaseResult, objective: Objective | None) -> SiteCase:
    controller = case.loop.controller
    same = site.form == controller.form and site.units == SiteForm(controller.form).units
    # What was given in these very units stands as it was given; what is converted has no last digit of its own.
    digits = case.tuned.digits if case.tuned is not None else None if same else RULE_DIGITS
    try:
        settings = site.settings(controller, digits)
    except InvalidValue as error:
        return SiteCase(case.name, None, refused=f"{error.given}: {error.allowed}")
    if settings.controller == controller:
        return SiteCase(case.name, settings, case.run.kpis, case.objective)
    loop, experiment = case.loop.with_controller(settings.controller), case.run.experiment
    with np.errstate(over="ignore", invalid="ignore"):  # a diverging loop overflows; its figures say so
        kpis = simulate(loop, experiment).kpis
        cost = None if objective is None else float(evaluate(loop, experiment, objective)[0])
    return SiteCase(case.name, settings, kpis, cost)
