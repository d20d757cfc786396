"""What is drawn on given axes: the parts that the figures and `wb.plot` share. Layout only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from workbench.model.record import FloatArray, Record
from workbench.model.results import DescribingFunction, Estimate, LimitCycle, Run, Tuned
from workbench.model.valve import Ideal, Stenman
from workbench.report.style import LINEAR, OP, PREDICTION, PV, SP, VALVE, Style, case_style
from workbench.report.thinned import BEYOND, but_for_kicks, envelope, fills, phase, seen, thin, time_axis
from workbench.report.words import ROUNDING, duration, figure, given, label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "BEYOND",
    "beside",
    "convergence",
    "curve",
    "finish",
    "frequency",
    "frequency_window",
    "limit_cycle_starts",
    "limit_to",
    "line",
    "model_op",
    "model_pv",
    "near_best",
    "op_stem",
    "op_stem_found",
    "phase",
    "profile",
    "pv_op",
    "pv_op_found",
    "record_op",
    "record_pv",
    "remark",
    "restarts",
    "run_op",
    "run_pv",
    "seen",
    "thin",
    "time_axis",
    "without_kicks",
]


def line(ax: Axes, time: FloatArray, signal: FloatArray, text: str, style: Style, *, steps: bool = False) -> None:
    """Draw a signal against time, no finer than the figure shows."""
    x, y = thin(time, seen(signal))
    ax.plot(x, y, label=text, drawstyle="steps-post" if steps else "default", **style)


def curve(
    ax: Axes, time: FloatArray, signal: FloatArray, span: float, text: str, style: Style, *, steps: bool = False
) -> None:
    """Draw one of many signals over each other; span: the plot's range.

    One that swings so fast that its line would hide the others lies under them, as the band that it sweeps.
    """
    if fills(signal, span):
        x, low, high = envelope(time, signal)
        ax.fill_between(x, low, high, color=style["color"], alpha=0.3, linewidth=0.0, zorder=1.0, label=text)
        return
    x, y = thin(time, signal)
    ax.plot(x, y, label=text, drawstyle="steps-post" if steps else "default", **style)


def beside(above: Axes, below: Axes) -> None:
    """Take from the plots of a second column what the first says for both: names of the axes and legends."""
    for ax in (above, below):
        own = ax.get_legend()
        if own is not None:
            own.remove()
        ax.set_ylabel("")


def finish(ax: Axes, ylabel: str) -> None:
    """Name the axis and put the legend above the plot, where it hides nothing."""
    ax.set_ylabel(ylabel)
    ax.margins(x=0.01)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.1, columnspacing=1.2)


def run_pv(ax: Axes, run: Run, unit: float = 1.0, part: slice = slice(None)) -> None:
    """Draw PV and SP against time (s / unit)."""
    line(ax, run.time[part] / unit, run.pv[part], "PV", PV)
    line(ax, run.time[part] / unit, run.sp[part], "SP", SP, steps=True)
    finish(ax, "PV, SP (EU)")


def run_op(ax: Axes, run: Run, unit: float = 1.0, part: slice = slice(None)) -> None:
    """Draw OP and the valve's position against time (s / unit)."""
    line(ax, run.time[part] / unit, run.valve[part], "valve", VALVE, steps=True)
    line(ax, run.time[part] / unit, run.op[part], "OP", OP, steps=True)
    finish(ax, "OP, valve (%)")


def without_kicks(ax: Axes, signals: Sequence[FloatArray]) -> None:
    """Limit the y axis to what the signals do but for 1 % at each end, where a first kick dwarfs it; say so."""
    calm = but_for_kicks(signals)
    if calm is None:
        return
    low, high = calm
    finite = [s[np.isfinite(s)] for s in signals]
    least, most = (pick(float(pick(s)) for s in finite if s.size) for pick in (min, max))
    pad = 0.15 * (high - low)
    ax.set_ylim(low - pad, high + pad)
    remark(ax, f"first kicks reach from {given(least, 3)} to {given(most, 3)}")


def limit_to(ax: Axes, signals: Sequence[FloatArray]) -> None:
    """Limit the y axis to what these signals do: others may leave it."""
    kept = [s[np.isfinite(s)] for s in signals]
    kept = [s for s in kept if s.size]
    if not kept:
        return
    low, high = min(float(s.min()) for s in kept), max(float(s.max()) for s in kept)
    pad = 0.1 * (high - low) or 1.0
    ax.set_ylim(low - pad, high + pad)


def remark(ax: Axes, text: str) -> None:
    """Write a remark at the top of a plot."""
    paper: Style = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    ax.annotate(text, (0.5, 0.98), xycoords="axes fraction", ha="center", va="top", fontsize=7, bbox=paper)


def record_pv(ax: Axes, record: Record, unit: float = 1.0) -> None:
    """Draw a record's PV, and SP where it was recorded."""
    line(ax, record.time / unit, record.pv, "PV", PV)
    if record.sp is not None:
        line(ax, record.time / unit, record.sp, "SP", SP, steps=True)
    finish(ax, "PV (EU)" if record.sp is None else "PV, SP (EU)")


def record_op(ax: Axes, record: Record, unit: float = 1.0) -> None:
    """Draw a record's OP, and the measured valve position where there is one."""
    if record.valve_position is not None:
        line(ax, record.time / unit, record.valve_position, "valve (measured)", VALVE, steps=True)
    line(ax, record.time / unit, record.op, "OP", OP, steps=True)
    finish(ax, "OP (%)")


def model_pv(ax: Axes, found: Estimate, unit: float = 1.0, part: slice = slice(None), *, linear: bool = False) -> None:
    """Draw PV with the model's prediction, or with that of the fit that ignores stiction."""
    time = found.record.time[part] / unit
    line(ax, time, found.record.pv[part], "PV", PV)
    if linear:
        line(ax, time, found.linear.prediction[part], "prediction without stiction", LINEAR)
    else:
        line(ax, time, found.prediction[part], "prediction", PREDICTION)
    finish(ax, "PV (EU)")


def pv_op_found(ax: Axes, found: Estimate) -> None:
    """Draw PV and its prediction against OP."""
    for signal, text, style in ((found.record.pv, "PV", PV), (found.prediction, "prediction", PREDICTION)):
        x, y = phase(found.record.op, signal)
        ax.plot(x, y, label=text, **{**style, "linewidth": 0.8})
    ax.set_xlabel("OP (%)")
    finish(ax, "PV (EU)")


def op_stem_found(ax: Axes, found: Estimate) -> None:
    """Draw the estimated valve position against OP, the measured one where there is one, and a valve that follows."""
    op, measured = found.record.op, found.record.valve_position
    ends = [float(op.min()), float(op.max())]
    ax.plot(ends, ends, label="no friction", **{**LINEAR, "linewidth": 0.7})
    if measured is not None:
        x, y = phase(op, measured)
        ax.plot(x, y, label="measured", **{**SP, "linewidth": 0.8})
    if found.valve.hold > 0.0:
        x, y = phase(op, found.valve_position)
        ax.plot(x, y, label="estimated", **{**VALVE, "linewidth": 0.8})
    ax.set_xlabel("OP (%)")
    finish(ax, "valve (%)")


def model_op(ax: Axes, found: Estimate, unit: float = 1.0, part: slice = slice(None), *, stem: bool = True) -> None:
    """Draw OP with the estimated valve position (and the measured one where there is one)."""
    time = found.record.time[part] / unit
    if stem:
        line(ax, time, found.valve_position[part], "valve (estimated)", VALVE, steps=True)
        if found.record.valve_position is not None:
            line(ax, time, found.record.valve_position[part], "valve (measured)", SP, steps=True)
    line(ax, time, found.record.op[part], "OP", OP, steps=True)
    finish(ax, "OP, valve (%)" if stem else "OP (%)")


def pv_op(ax: Axes, run: Run) -> None:
    """Draw PV against OP."""
    x, y = phase(run.op, run.pv)
    ax.plot(x, y, **{**PV, "linewidth": 0.8})
    ax.set_ylabel("PV (EU)")


def op_stem(ax: Axes, run: Run) -> None:
    """Draw the valve's position against OP, with the line that a valve without friction would follow."""
    x, y = phase(run.op, run.valve)
    ends = [float(np.nanmin(x)), float(np.nanmax(x))] if x.size else []
    ax.plot(ends, ends, **{**SP, "linewidth": 0.7})
    ax.plot(x, y, **{**VALVE, "linewidth": 0.8})
    ax.set_ylabel("valve (%)")
    ax.set_xlabel("OP (%)")


def _log(axis: Any) -> None:
    """Make an axis logarithmic, its ticks written as plain numbers."""
    getattr(axis.axes, f"set_{axis.axis_name}scale")("log")
    axis.set_major_formatter(FuncFormatter(lambda value, _: given(value, 3)))
    axis.set_minor_formatter(NullFormatter())
    low, high = axis.get_view_interval()
    if 0.0 < low < high < 100.0 * low:  # few powers of ten: name some ticks between them
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0, 7.0)))


def near_best(found: Estimate) -> tuple[float, float] | None:
    """Return the range of d (%) about the estimate that shows a narrow interval from near, or None for a wide one."""
    if found.intervals.d is None or found.profile_d.size < 2:
        return None
    low, high = found.intervals.d
    width = max(high - low, 0.002 * high)
    return None if width > 0.1 * float(np.ptp(found.profile_d)) else (low - 4.0 * width, high + 4.0 * width)


def _level(found: Estimate, variance: Any) -> Any:
    """Return `N log V` of residual variances, those of rounding error taken for 1e-12 EU²."""
    return len(found.record) * np.log(np.maximum(variance, ROUNDING))


def profile(ax: Axes, found: Estimate, window: tuple[float, float] | None = None) -> None:
    """Draw the AIC of the fit at each d, with the interval shaded, the estimate and the linear fit's level.

    AIC is the paper's eq. (1), `N log V + 2 p`; every d has one parameter more than the linear fit. window: (low, high)
    of d, %, without the linear fit; the whole profile by default.
    """
    finite = np.isfinite(found.profile_cost)
    plain = found.linear
    # Two for each parameter of the linear fit; a residual that is rounding error hides them.
    parameters = plain.aic - _level(found, plain.residual_variance) if plain.residual_variance >= ROUNDING else 0.0
    # What no model's AIC falls below, the record does not resolve.
    least = min((model.aic for model in found.candidates), default=-math.inf)
    d = found.profile_d[finite]
    cost = np.maximum(_level(found, found.profile_cost[finite]) + parameters + 2.0, least)
    order = np.argsort(d, kind="stable")
    d, cost = d[order], cost[order]
    if window is not None:
        first, stop = np.searchsorted(d, window)
        part = slice(max(0, int(first) - 1), int(stop) + 1)
        d, cost = d[part], cost[part]
    if found.intervals.d is not None:
        low, high = found.intervals.d
        ax.axvspan(low, high, color="#56B4E9", alpha=0.35, linewidth=0, label="95 % range of d")
    x, y = thin(d, cost)
    marks: Style = {} if window is None or x.size > 200 else {"marker": ".", "markersize": 3}
    ax.plot(x, y, label="AIC", **{**PV, "linewidth": 0.9}, **marks)
    if window is None:
        rival = next((m.aic for m in found.candidates if isinstance(m.valve, Ideal)), plain.aic)
        ax.axhline(rival, label="linear fit", **LINEAR)
    best = found.valve.stick_band
    if best > 0.0:
        # In the curve's own measure, which differs from the residual's where the disturbance is coloured.
        at = next((m.aic for m in found.candidates if m.valve == found.valve), found.aic)
        name = "d" if isinstance(found.valve, Stenman) else "S"
        ax.plot([best], [max(at, least)], "o", color="#D55E00", markersize=4, label=f"{name} = {figure(best)} %")
    ax.set_xlabel("d (%)")
    if window is None:
        finish(ax, "AIC")
        return
    ax.set_xlim(*window)
    ax.xaxis.set_major_locator(MaxNLocator(5))


def convergence(ax: Axes, below: Axes, found: Estimate) -> None:
    """Draw the two-step algorithm's d and residual variance, iteration by iteration.

    Residuals below 1e-12 EU² are rounding error and drawn there.
    """
    steps = np.arange(len(found.iterations))
    ax.plot(steps, [i.d for i in found.iterations], "o-", color="#0072B2", markersize=3, linewidth=1.0, label="d")
    finish(ax, "d (%)")
    costs = [max(i.residual_variance, ROUNDING) for i in found.iterations]
    below.plot(steps, costs, "s-", color="#D55E00", markersize=3, linewidth=1.0, label="residual variance")
    _log(below.yaxis)
    finish(below, "variance (EU²)")
    below.set_xlabel("iteration")
    below.xaxis.set_major_locator(MaxNLocator(integer=True))


def _finite(values: Any) -> Any:
    return values[np.isfinite(values.real) & np.isfinite(values.imag)]


def frequency_window(
    named: Sequence[tuple[str, DescribingFunction]], ratio: float
) -> tuple[float, float, float, float]:
    """Return (left, right, bottom, top) of the complex plane to show, width / height = `ratio`, one scale on both axes.

    It holds the origin, -1, every crossing, the nearest approach, and -1/N(A) as far as it stays within five units.
    """
    points = [np.array([0.15 + 0.15j, -1.0 + 0.0j])]
    for _, df in named:
        locus = _finite(df.locus)
        points.append(locus[np.abs(locus) < 5.0])
        points += [_at(df.amplitudes, df.locus, c.amplitude) for c in df.crossings]
        if not df.crossings and math.isfinite(df.distance_amplitude):
            points.append(_at(df.amplitudes, df.locus, df.distance_amplitude))
            points.append(_at(df.frequencies, df.L, df.distance_frequency))
    every = _finite(np.concatenate(points))
    every = every[np.abs(every) < 50.0]
    left, right = float(every.real.min()), float(every.real.max())
    bottom, top = float(every.imag.min()), float(every.imag.max())
    width, height = 1.25 * (right - left), 1.25 * (top - bottom)
    width, height = max(width, height * ratio), max(height, width / ratio)
    x, y = (left + right) / 2.0, (bottom + top) / 2.0
    return x - width / 2.0, x + width / 2.0, y - height / 2.0, y + height / 2.0


def _at(grid: FloatArray, values: Any, where: float) -> Any:
    """Return the value at a grid position, linear between its neighbours, as an array of one."""
    order = np.argsort(grid)
    real = np.interp(where, grid[order], values.real[order])
    imag = np.interp(where, grid[order], values.imag[order])
    return np.array([real + 1j * imag])


def _broken(values: Any, gap: float) -> Any:
    """Return a curve with nan where it jumps by more than `gap`: a locus may be discontinuous."""
    jump = np.flatnonzero(np.abs(np.diff(values)) > gap) + 1
    return np.insert(values, jump, complex(math.nan, math.nan))


def frequency(ax: Axes, named: Sequence[tuple[str, DescribingFunction]], ratio: float = 1.6) -> None:
    """Draw L(jω) of each case and -1/N(A) of each valve, with crossings, or the nearest approach where none is."""
    left, right, bottom, top = frequency_window(named, ratio)
    size = math.hypot(right - left, top - bottom)
    ax.axhline(0.0, color="#888888", linewidth=0.6)
    ax.axvline(0.0, color="#888888", linewidth=0.6)
    drawn: list[Any] = []
    for name, df in named:
        if not any(d.shape == df.locus.shape and np.array_equal(d, df.locus, equal_nan=True) for d in drawn):
            text = "−1/N(A)" if not drawn else f"−1/N(A), {label(name, 30)}"
            locus = _broken(df.locus, 0.05 * size)
            style: Style = {
                "color": "#D55E00",
                "linewidth": 2.2,
                "alpha": 0.55,
                "linestyle": ("-", "--", ":")[len(drawn) % 3],
            }
            ax.plot(locus.real, locus.imag, label=text, **style)
            points = _finite(df.locus)
            if points.size and float(np.abs(points - points[0]).max()) < 1e-9:  # an ideal valve's: a point
                ax.plot(locus.real[:1], locus.imag[:1], "o", color="#D55E00", alpha=0.55, markersize=5)
            drawn.append(df.locus)
    for index, (name, df) in enumerate(named):
        style = case_style(index)
        L = df.L[(df.L.real > left - size) & (df.L.imag > bottom - size) & (df.L.imag < top + size)]
        ax.plot(L.real, L.imag, label=f"L(jω), {label(name, 30)}", linewidth=1.2, **style)
        for crossing in df.crossings:
            at = _at(df.amplitudes, df.locus, crossing.amplitude)[0]
            fill = style["color"] if crossing.stable else "white"
            ax.plot([at.real], [at.imag], "o", color=style["color"], markerfacecolor=fill, markersize=5, zorder=5)
        if not df.crossings and math.isfinite(df.distance_amplitude) and math.isfinite(df.distance_frequency):
            ends = np.concatenate(
                (_at(df.amplitudes, df.locus, df.distance_amplitude), _at(df.frequencies, df.L, df.distance_frequency))
            )
            ax.plot(ends.real, ends.imag, "x-", color=style["color"], linewidth=0.8, markersize=4, zorder=5)
    if named:
        _amplitude_ticks(ax, named[0][1], (left, right, bottom, top))
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlabel("real part")
    ax.set_ylabel("imaginary part")


def _amplitude_ticks(ax: Axes, df: DescribingFunction, window: tuple[float, float, float, float]) -> None:
    """Mark a few input amplitudes along -1/N(A), as far as they lie in the window and apart from each other."""
    left, right, bottom, top = window
    band = df.loop.valve.stick_band
    placed: list[complex] = []
    for multiple in (0.5, 0.75, 1.0, 1.5, 2.5, 5.0):
        amplitude = multiple * band
        if band == 0.0 or not df.amplitudes.min() <= amplitude <= df.amplitudes.max():
            continue
        at = complex(_at(df.amplitudes, df.locus, amplitude)[0])
        inside = left < at.real < right and bottom < at.imag < top
        if not inside or any(abs(at - other) < 0.1 * (top - bottom) for other in placed):
            continue
        placed.append(at)
        ax.plot([at.real], [at.imag], "|", color="#8a3c00", markersize=6, zorder=4)
        ax.annotate(
            f"A = {given(amplitude, 3)} %",
            (at.real, at.imag),
            xytext=(3, 5),
            textcoords="offset points",
            fontsize=6.5,
            color="#8a3c00",
            zorder=6,
        )


def limit_cycle_starts(ax: Axes, cycle: LimitCycle) -> None:
    """Draw each start's first (hollow) and late (full) period, with the closed form's as a line."""
    names: list[str] = []
    for row, start in enumerate(cycle.starts):
        names.append(label(start.name, 40))
        if start.outcome == "cycles":
            ax.plot([start.first_period], [row], "o", color="#0072B2", markerfacecolor="white", markersize=5)
            ax.plot([start.period], [row], "o", color="#0072B2", markersize=5)
        else:
            ax.annotate(label(start.outcome), (0.02, row), xycoords=("axes fraction", "data"), va="center", fontsize=7)
    if math.isfinite(cycle.closed_form_period):
        text = f"closed form {duration(cycle.closed_form_period)}"
        ax.axvline(cycle.closed_form_period, label=text, **LINEAR)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    if any(s.outcome == "cycles" for s in cycle.starts):
        _log(ax.xaxis)
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlabel("period (s): first (hollow), late (full)")


def restarts(ax: Axes, tuned: Tuned) -> None:
    """Draw each restart's objective after the scan and after refinement, with the reported J and the start's."""
    rows = range(len(tuned.restarts))
    ax.plot(
        [r.scanned for r in tuned.restarts], rows, "o", color="#767676", markerfacecolor="white", label="after the scan"
    )
    ax.plot([r.refined for r in tuned.restarts], rows, "o", color="#0072B2", label="refined")
    ax.axvline(tuned.objective, label=f"J as typed in, {figure(tuned.objective)}", **SP)
    ax.set_yticks(list(rows), [f"search {r.seed}" for r in tuned.restarts])
    ax.set_ylim(max(1, len(tuned.restarts)) - 0.5, -0.5)
    ax.set_xlabel("J")
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)
