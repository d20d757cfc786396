"""`wb.plot`: one figure for each kind of result."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.analyses import Signature
from workbench.model.cascade import CascadeRun
from workbench.model.cycle_map import CycleMap
from workbench.model.detection import Detection
from workbench.model.front import Front
from workbench.model.record import Record
from workbench.model.results import DescribingFunction, Estimate, LimitCycle, Run, Tuned
from workbench.report import draw
from workbench.report.draw_cascade import cascade_panels
from workbench.report.draw_evidence import apparent_stiction, bicoherence_map, pv_autocorrelation
from workbench.report.draw_map import map_figure, map_panels
from workbench.report.draw_signature import signature_ramp, signature_steps
from workbench.report.style import new_figure, styled
from workbench.report.trade import draw_front

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

__all__ = ["plot"]

_KINDS = (
    "a Run, Record, Estimate, Detection, DescribingFunction, LimitCycle, CycleMap, Tuned, Front, Signature or "
    "CascadeRun"
)


def plot(result: object, ax: Any = None) -> Axes | NDArray[Any]:
    """Draw a result and return its axes.

    Run, Record, Estimate: two axes, PV above and OP with the valve's position below (an array of shape (2,)); `ax` may
    be two axes, or one, which gets PV alone. Detection: three axes, PV's autocorrelation, the bicoherence and PV
    against OP with its ellipse (shape (3,); the last two want `detect(record, bicoherence=True)`); `ax` may be three
    axes, or one, which gets the autocorrelation alone. DescribingFunction: the loci in the complex plane. LimitCycle:
    periods by start. CycleMap: four axes, late period, PV's swing, mean square error and valve travel an hour (shape
    (4,)); `ax` may be four axes, or one, which gets the period alone. Tuned: objectives by restart. Front: error
    against valve travel, sticky and repaired. Signature: two axes, the stem against the slow ramp, and the small steps
    with its answer (shape (2,)); `ax` may be two axes, or one, which gets the ramp alone.
    CascadeRun: three axes, primary, secondary and valve (shape (3,)); `ax` may be three axes, or one, which gets the
    primary alone. `ax`: where to draw; a new figure by default (`.figure` of the axes, to show or save). Raises
    `InvalidValue` for anything else.
    """
    pairs: dict[type, tuple[Callable[..., None], Callable[..., None]]] = {
        Run: (draw.run_pv, draw.run_op),
        Record: (draw.record_pv, draw.record_op),
        Estimate: (draw.model_pv, draw.model_op),
    }
    singles: dict[type, Callable[..., None]] = {
        LimitCycle: draw.limit_cycle_starts,
        Tuned: draw.restarts,
        Front: draw_front,
        DescribingFunction: _loci,
    }
    with styled():
        if isinstance(result, CascadeRun):
            return _cascade(result, ax)
        for kind, (above, below) in pairs.items():
            if isinstance(result, kind):
                return _two(result, ax, above, below)
        if isinstance(result, Detection):
            return _evidence(result, ax)
        if isinstance(result, CycleMap):
            return _map(result, ax)
        if isinstance(result, Signature):
            return _signature(result, ax)
        for kind, one in singles.items():
            if isinstance(result, kind):
                return _one(result, ax, one)
    raise InvalidValue("plot", type(result).__name__, f"must be {_KINDS}")


def _cascade(run: CascadeRun, ax: Any) -> Axes | NDArray[Any]:
    axes = list(new_figure(4.6, 3.9).subplots(3, 1, sharex=True)) if ax is None else _axes(ax, (1, 3))
    cascade_panels(axes, run)
    return _together(axes)


def _map(found: CycleMap, ax: Any) -> Axes | NDArray[Any]:
    if ax is None:
        return np.array(map_figure(found).axes, dtype=object)
    axes = _axes(ax, (1, 4))
    map_panels(axes, found)
    if len(axes) == 1:
        single: Axes = axes[0]
        return single
    return np.array(axes, dtype=object)


def _evidence(found: Detection, ax: Any) -> Axes | NDArray[Any]:
    axes = list(new_figure(6.4, 7.0).subplots(3, 1, height_ratios=(2, 3, 3))) if ax is None else _axes(ax, (1, 3))
    parts = (pv_autocorrelation, bicoherence_map, apparent_stiction)
    for target, part in zip(axes, parts, strict=False):
        part(target, found)
    return _together(axes)


def _signature(found: Signature, ax: Any) -> Axes | NDArray[Any]:
    axes = list(new_figure(6.4, 3.2).subplots(1, 2)) if ax is None else _axes(ax, (1, 2))
    for target, part in zip(axes, (signature_ramp, signature_steps), strict=False):
        part(target, found)
    return _together(axes)


def _together(axes: list[Any]) -> Axes | NDArray[Any]:
    """One axes as it is, several as an array."""
    if len(axes) == 1:
        single: Axes = axes[0]
        return single
    out = np.empty(len(axes), dtype=object)
    out[:] = axes
    return out


def _loci(ax: Axes, df: DescribingFunction) -> None:
    draw.frequency(ax, [("loop", df)])
    ax.legend(loc="best")


def _axes(ax: Any, allowed: tuple[int, ...]) -> list[Any]:
    given = [a for a in np.ravel(np.array(ax, dtype=object)) if hasattr(a, "plot") and hasattr(a, "set_xlabel")]
    if len(given) not in allowed or len(given) != np.size(np.array(ax, dtype=object)):
        raise InvalidValue("plot.ax", ax, f"must be {' or '.join(map(str, allowed))} matplotlib Axes")
    return given


def _one(result: object, ax: Any, one: Callable[..., None]) -> Axes:
    target: Axes = new_figure(6.4, 4.0).subplots() if ax is None else _axes(ax, (1,))[0]
    one(target, result)
    return target


def _two(result: Any, ax: Any, above: Callable[..., None], below: Callable[..., None]) -> Axes | NDArray[Any]:
    axes = list(new_figure(6.4, 4.4).subplots(2, 1, sharex=True)) if ax is None else _axes(ax, (1, 2))
    time = result.record.time if isinstance(result, Estimate) else result.time
    unit, name = draw.time_axis(float(time[-1]))
    above(axes[0], result, unit)
    axes[-1].set_xlabel(f"time ({name})")
    if len(axes) > 1:
        below(axes[1], result, unit)
    return _together(axes)
