"""A cascade's figures: both loops against time, PV against output of each, and the cycle as both loops see it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from workbench.model.cascade import CascadeCycle, CascadeRun
from workbench.report import draw
from workbench.report.style import OP, PV, SP, VALVE, new_figure, styled

__all__ = ["cascade_panels", "cycle_figure", "pv_op_figure", "trend_figure"]

# Cycles that the figure of the cycle shows.
SHOWN = 4


def trend_figure(run: CascadeRun) -> Figure:
    """Return both loops against time: the primary's PV above, the secondary's, and OP with the valve below."""
    with styled():
        fig = new_figure(4.6, 3.9)
        axes = fig.subplots(3, 1, sharex=True)
        cascade_panels(axes, run)
    return fig


def cascade_panels(axes: Sequence[Axes], run: CascadeRun, part: slice = slice(None), begin: float = 0.0) -> None:
    """Draw primary, secondary and valve into three axes, or the first of these into one.

    part: the samples shown, with time from `begin` (s).
    """
    time = run.time[part] - begin
    unit, name = draw.time_axis(float(time[-1]))
    for ax, one, label in zip(axes[:2], (run.primary, run.secondary), ("primary", "secondary"), strict=False):
        draw.line(ax, time / unit, one.pv[part], "PV", PV)
        draw.line(ax, time / unit, one.sp[part], "SP", SP, steps=True)
        draw.finish(ax, f"{label} (EU)")
    for ax in axes[2:]:
        draw.line(ax, time / unit, run.secondary.valve[part], "valve", VALVE, steps=True)
        draw.line(ax, time / unit, run.secondary.op[part], "OP", OP, steps=True)
        draw.finish(ax, "OP, valve (%)")
    axes[-1].set_xlabel(f"time ({name})")


def pv_op_figure(run: CascadeRun) -> Figure:
    """Return PV against its own loop's output: the primary's above, the secondary's below."""
    with styled():
        fig = new_figure(2.5, 3.9)
        above, below = fig.subplots(2, 1)
        _against(above, run.secondary.sp, run.primary.pv, "secondary's SP (EU)", "primary's PV (EU)")
        _against(below, run.secondary.op, run.secondary.pv, "OP (%)", "secondary's PV (EU)")
    return fig


def _against(ax: Axes, op: np.ndarray, pv: np.ndarray, across: str, up: str) -> None:
    x, y = draw.phase(op, pv)
    ax.plot(x, y, **{**PV, "linewidth": 0.8})
    ax.set_xlabel(across)
    ax.set_ylabel(up)


def cycle_figure(cycle: CascadeCycle) -> Figure | None:
    """Return the last cycles of the long run without noise, as both loops see them; None where there is none."""
    if cycle.late is None or cycle.primary is None or not math.isfinite(cycle.period):
        return None
    run = cycle.late
    samples = max(2, math.ceil(SHOWN * cycle.period / run.cascade.secondary.sample_time))
    part = slice(max(0, run.time.size - samples), None)
    with styled():
        fig = new_figure(4.6, 3.6)
        axes = fig.subplots(3, 1, sharex=True)
        cascade_panels(axes, run, part, float(run.time[part][0]))
    return fig
