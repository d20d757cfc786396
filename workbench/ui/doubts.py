"""Why a settling time on the page is none to go by, as the report says it of the same run."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

from workbench.errors import WorkbenchError
from workbench.model.cascade import Cascade, CascadeCycle, CascadeRun
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.results import LimitCycle
from workbench.model.study import CascadeResult, CaseResult
from workbench.report.judge import settling_doubt

if TYPE_CHECKING:
    from workbench.ui.state import CaseRun

__all__ = ["doubt_of"]

KEPT = 64  # long runs that are remembered: pinned cases stay what they are while another tuning moves


def doubt_of(one: CaseRun, name: str) -> str:
    """Return why a figure of `Session.rows` is none to go by, "" where it is, or where it is no settling time."""
    outer, run = one.outer, one.run
    if not name.endswith("settling_time") or outer is None or run is None or math.isnan(outer.kpis.settling_time):
        return ""
    experiment = outer.experiment
    if one.cascade is None or one.above is None:
        case = CaseResult(one.name, run.loop, run, limit_cycle=_cycle(run.loop, experiment))
        return settling_doubt(case, experiment)
    both = CascadeRun(one.cascade, experiment, one.above, run)
    return settling_doubt(CascadeResult(one.name, both, cycle=_cascade_cycle(one.cascade, experiment)), experiment)


@lru_cache(maxsize=KEPT)
def _cycle(loop: Loop, experiment: Experiment) -> LimitCycle | None:
    from workbench.analyze.limit_cycle import limit_cycle

    try:
        return limit_cycle(loop, experiment, others=False)
    except WorkbenchError:
        return None


@lru_cache(maxsize=KEPT)
def _cascade_cycle(cascade: Cascade, experiment: Experiment) -> CascadeCycle | None:
    from workbench.analyze.cascade import cascade_cycle

    try:
        return cascade_cycle(cascade, experiment)
    except WorkbenchError:
        return None
