"""What the page says of a loop's long run: loci with the describing function's verdict, and the exact one."""

from __future__ import annotations

from dataclasses import replace

from workbench.errors import WorkbenchError
from workbench.model.analyses import DescribingFunction
from workbench.model.cascade import Cascade
from workbench.model.controller import PID
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.report.words import duration, figure
from workbench.ui.state import Built

__all__ = ["map_key", "tuning_key", "verdicts"]


def verdicts(built: Built) -> tuple[DescribingFunction | None, list[str]]:
    """Return the loci, None where the method says nothing of this loop, and both verdicts in words."""
    from workbench.analyze.agreement import agreement
    from workbench.analyze.describing_function import describing_function
    from workbench.analyze.limit_cycle import limit_cycle
    from workbench.analyze.valve_loci import no_locus

    if built.cascade is not None:
        return None, _of_cascade(built.cascade, built.experiment)
    loop = built.loop
    df, cycle, lines = None, None, []
    reason = no_locus(loop.valve)
    if loop.controller.compensator is not None:
        reason = "no describing function with a compensator: the method holds for the loop without one"
    if reason:
        lines.append(f"This loop has {reason}.")
    try:
        df = None if reason else describing_function(loop)
    except WorkbenchError as error:
        lines.append(str(error))
    if df is not None:
        lines.append(f"Describing function: {df.verdict}")
    try:
        cycle = limit_cycle(loop, built.experiment)
    except WorkbenchError as error:
        lines.append(str(error))
    else:
        lines.append(f"Exact: {cycle.verdict}")
    if df is not None and cycle is not None:
        lines.append(agreement(df, cycle))
    return df, [line for line in lines if line]


def _of_cascade(cascade: Cascade, experiment: Experiment) -> list[str]:
    from workbench.analyze.cascade import cascade_cycle

    try:
        cycle = cascade_cycle(cascade, experiment)
    except WorkbenchError as error:
        return [str(error)]
    lines = ["A cascade has neither loci nor a map here; its long run without noise is followed exactly."]
    if cycle.outcome != "cycles" or cycle.primary is None or cycle.secondary is None:
        return [*lines, f"Exact: {cycle.outcome}; {cycle.reason}."]
    above, below = cycle.primary, cycle.secondary
    told = (
        f"Exact: both loops cycle every {duration(cycle.period)}; PV swings {figure(above.pv_peak_to_peak, 3)} EU in "
        f"the primary and {figure(below.pv_peak_to_peak, 3)} EU in the secondary, whose setpoint swings "
        f"{figure(below.sp_peak_to_peak, 3)} EU. Valve travel an hour: {figure(cycle.travel_per_hour)} %."
    )
    return [*lines, told]


def map_key(built: Built | None) -> object:
    """Return what a map is of: everything of a loop but the tuning, which is where one stands on it."""
    if built is None:
        return None
    return _under(built.loop, replace(built.loop.controller, Kc=1.0, Ti=1.0))


def tuning_key(built: Built | None) -> object:
    """Return what a tuning is of: everything that stands on the page but the settings that are searched for."""
    if built is None:
        return None
    cascade = built.cascade
    loops = [built.loop] if cascade is None else [cascade.primary, cascade.secondary]
    bare = [_under(loop, replace(loop.controller, Kc=1.0, Ti=1.0, Td=0.0)) for loop in loops]
    between = None if cascade is None else (cascade.scale, cascade.anti_windup)
    return bare, between, built.experiment, built.objective


def _under(loop: Loop, controller: PID) -> object:
    """Return everything of a loop but its controller, and this one."""
    elements = loop.characteristic, loop.fail_open, loop.scan
    return loop.plant, loop.valve, controller, loop.sample_time, elements
