"""`wb.limit_cycle`: what the loop really does in the long run, by exact noise-free simulation from several starts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from workbench.analyze.long_run import Start, follow
from workbench.analyze.relaxation import relaxation_cycle
from workbench.model.checks import callback, instance
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.numbers import given as plain
from workbench.model.plant import FOPDT
from workbench.model.results import LimitCycle, LimitCycleStart
from workbench.simulate.signals import Signals, signals

__all__ = ["limit_cycle", "standard_starts", "together"]

# Each start's stem offset, as a share of what the valve holds, and its shift of the resting stem, in slip jumps. They
# put the setpoint at different places between two stem positions, and begin at rest as well as stuck near a slip.
STARTS = ((0.0, 0.5), (0.0, -1.3), (0.0, 2.7), (0.0, -6.2), (0.5, 0.2), (-0.9, 1.1), (0.9, -0.75), (-0.5, -3.4))


def limit_cycle(
    loop: Loop,
    experiment: Experiment | None = None,
    *,
    others: bool = True,
    progress: Callable[[float], None] | None = None,
) -> LimitCycle:
    """Return the loop's long-run behaviour: settles, cycles, depends on the start, or undecided.

    Eight starts are followed (`standard_starts`), each from slip to slip as `long_run.follow` says; a loop with a
    compensator sample by sample, which is as exact, with less patience for cycles of days. With an experiment
    its signals are applied without the noise, the last values held for good, and its outcome and figures are the
    result's; the other starts tell whether they depend on it. Without one the figures are medians over the starts that
    cycle, and the outcome is "depends" where some starts cycle and others settle. others: whether those are followed
    beside a given experiment.

    `progress` is called with the share done, 0 .. 1. Raises `InvalidValue` for an experiment that does not fit the loop
    or a controller that has no ideal equivalent.
    """
    instance(loop, Loop, "loop", "a Loop")
    callback(progress, "limit_cycle.progress")
    starts = list(standard_starts(loop)) if others or experiment is None else []
    if experiment is not None:
        instance(experiment, Experiment, "experiment", "an Experiment")
        quiet = replace(experiment, noise=None)
        starts.insert(0, Start("the given experiment, without noise", experiment.stem_offset, signals(loop, quiet)))
    found: list[LimitCycleStart] = []
    for start in starts:
        if progress is not None:
            progress(len(found) / len(starts))
        found.append(follow(loop, start))
    if progress is not None:
        progress(1.0)
    return _summary(loop, tuple(found), experiment is not None)


def standard_starts(loop: Loop) -> tuple[Start, ...]:
    """Return the documented starts: four from rest with the stem centred, four with the stem held off its input.

    The resting stem position is shifted by 0.5, -1.3, 2.7, -6.2, 0.2, 1.1, -0.75 and -3.4 slip jumps (stick bands
    where there is no jump, else steps of OP's resolution), the last four with a stem offset of 0.5, -0.9, 0.9 and -0.5
    of what the valve holds: by a setpoint step on a self-regulating plant, and on an integrating one by a load with a
    setpoint step that moves OP as far. A loop with output limits is not asked to rest beyond 0.8 of them.
    """
    valve, plant = loop.valve, loop.plant
    frictionless = valve.slip_jump == valve.stick_band == 0.0
    unit = valve.slip_jump or valve.stick_band or loop.controller.output_resolution
    if unit == 0.0:
        unit = 1.0 / abs(plant.gain) if isinstance(plant, FOPDT) else 1.0
    Kc = loop.controller.ideal_terms().Kc
    limits = loop.controller.output_limits or (-math.inf, math.inf)
    starts = []
    for share, shift in STARTS[:4] if frictionless else STARTS:
        stem = min(max(shift * unit, 0.8 * limits[0]), 0.8 * limits[1])
        offset = share * valve.hold
        if isinstance(plant, FOPDT):
            r, load = loop.gain * loop.flow(stem), 0.0
            name = f"setpoint step of {r:+.3g} EU"
        else:
            r, load = (stem / Kc if Kc > 0.0 else 0.0), -loop.flow(stem)
            name = f"load step of {loop.direction * load:+.3g} % and setpoint step of {r:+.3g} EU"
        if offset != 0.0:
            name += f", OP resting {offset:+.3g} % off the stem"
        # Two samples of constant signals say all: the last value is held.
        given = Signals(np.full(2, r), np.full(2, load), np.zeros(2))
        starts.append(Start(name, offset, given))
    return tuple(starts)


def _summary(loop: Loop, starts: tuple[LimitCycleStart, ...], given: bool) -> LimitCycle:
    cycling = [start for start in starts if start.outcome == "cycles"]
    shown = [start for start in starts[:1] if start.outcome == "cycles"] if given else cycling
    outcome = starts[0].outcome if given else together(starts)

    def middle(name: str) -> float:
        values = [float(getattr(start, name)) for start in shown]
        return float(np.median(values)) if values else math.nan

    ranges = [start.period_range for start in cycling]
    spread = (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else (math.nan, math.nan)
    closed_form = relaxation_cycle(loop)
    result = LimitCycle(
        loop=loop,
        outcome=outcome,
        period=middle("period"),
        period_range=spread,
        pv_peak_to_peak=middle("pv_peak_to_peak"),
        op_peak_to_peak=middle("op_peak_to_peak"),
        mean_square_error=middle("mean_square_error"),
        travel_per_hour=middle("travel_per_hour"),
        window=middle("window"),
        starts=starts,
        closed_form_period=math.nan if closed_form is None else closed_form.period,
        verdict="",
        slips_per_hour=middle("slips_per_hour"),
        reversals_per_hour=middle("reversals_per_hour"),
        closed_form=closed_form,
    )
    return replace(result, verdict=_verdict(result, given))


def together(starts: tuple[LimitCycleStart, ...]) -> str:
    """Return the outcome of several starts: "depends" where some cycle and some settle."""
    outcomes = {start.outcome for start in starts}
    if {"cycles", "settles"} <= outcomes:
        return "depends"
    for outcome in ("cycles", "undecided", "settles"):
        if outcome in outcomes:
            return outcome
    return "undecided"


def _verdict(cycle: LimitCycle, given: bool) -> str:
    starts = cycle.starts
    counts = {name: sum(start.outcome == name for start in starts) for name in ("cycles", "settles", "undecided")}
    others = starts[1:] if given else starts
    figures = (
        f"with a period of {plain(cycle.period, 4)} s, PV swinging by {plain(cycle.pv_peak_to_peak, 3)} EU and OP by "
        f"{plain(cycle.op_peak_to_peak, 3)} % peak to peak"
    )
    if cycle.outcome == "cycles":
        if given:
            first = starts[0].first_period
            text = f"The loop cycles {figures}"
            if abs(first - cycle.period) > 0.05 * cycle.period:
                text += f" (the first cycle takes {plain(first, 4)} s)"
        else:
            text = f"The loop cycles {figures}"
    elif cycle.outcome == "depends":
        text = (
            f"It depends on the start: from {counts['cycles']} of {len(starts)} starts the loop cycles {figures}, "
            f"from {counts['settles']} it settles"
        )
    elif cycle.outcome == "settles":
        reasons = {start.reason for start in (starts[:1] if given else starts)}
        text = "The loop settles" + (f": {reasons.pop()}" if len(reasons) == 1 else " from every start that was tried")
    else:
        first_open = next(start for start in starts if start.outcome == "undecided")
        text = f"No verdict: {first_open.reason}"
    return text + _elsewhere(cycle, others, given) + "."


def _elsewhere(cycle: LimitCycle, others: tuple[LimitCycleStart, ...], given: bool) -> str:
    """What the other starts say, where that differs."""
    low, high = cycle.period_range
    parts = []
    if cycle.outcome in ("cycles", "depends") and high > 1.05 * low:
        drifts = any(start.period_range[1] > 1.05 * start.period_range[0] for start in cycle.starts)
        lasts = " and on how long the loop has been cycling" if drifts else ""
        parts.append(f"periods run from {plain(low, 4)} to {plain(high, 4)} s, depending on the start{lasts}")
    if given:
        for name, words in (("cycles", "it cycles"), ("settles", "it settles")):
            count = sum(start.outcome == name for start in others)
            if name != cycle.outcome and count:
                parts.append(f"from {count} of {len(others)} other starts {words}")
    open_count = sum(start.outcome == "undecided" for start in others)
    if open_count and (given or cycle.outcome != "undecided"):
        parts.append(f"{open_count} of {len(others)} {'other ' if given else ''}starts could not be decided")
    return "".join(f"; {part}" for part in parts)
