"""The report's figures, each from one result, as matplotlib figures without pyplot; and how they become SVG files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from workbench.model.detection import Detection
from workbench.model.record import FloatArray, Record
from workbench.model.results import DescribingFunction, Estimate, Run
from workbench.model.study import CaseResult
from workbench.model.valve import Ideal
from workbench.report import draw
from workbench.report.draw_evidence import apparent_stiction, bicoherence_map, pv_autocorrelation
from workbench.report.style import SP, case_style, new_figure, styled
from workbench.report.thinned import settled
from workbench.report.words import given, join, label, parameter_words

__all__ = [
    "Curves",
    "apparent_stiction_figure",
    "autocorrelation_figure",
    "bicoherence_figure",
    "convergence_figure",
    "estimate_figure",
    "frequency_figure",
    "linear_fit_figure",
    "op_stem_figure",
    "overlaid",
    "overlay_figure",
    "profile_figure",
    "pv_op_figure",
    "trend_figure",
]

DIVERGES = 10.0  # times the calm cases' range: a PV beyond it would flatten them
WIDTH = 7.1  # inch: the text width of an A4 page
# Share of a run within which a loop at rest came to it early, and how many times that long is shown from near.
EARLY, SHOWN = 0.1, 3.0
ABOVE = 13.0  # points: what a legend of one line above a plot takes


def trend_figure(run: Run) -> Figure:
    """Return PV and SP above, OP and valve position below, on one time axis.

    Where the loop comes to rest early, its first stretch stands beside them, from near.
    """
    with styled():
        fig = new_figure(4.6, 2.75)
        unit, name = draw.time_axis(float(run.time[-1]))
        until = _first_stretch([((run.time, run.pv), (run.time, run.valve))])
        above, below = _columns_of(fig, until, unit, name)
        parts = [slice(None)] if until is None else [slice(None), slice(int(np.searchsorted(run.time, until)) + 1)]
        for i, part in enumerate(parts):
            draw.run_pv(above[i], run, unit, part)
            draw.run_op(below[i], run, unit, part)
            if i:
                draw.beside(above[i], below[i])
    return fig


Signals = tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def _first_stretch(cases: Sequence[Signals]) -> float | None:
    """Return until when (s) to show from near what the cases that come to rest early do, or None where none does.

    cases: PV and valve of each as (time, s; values).
    """
    ends = []
    for both in cases:
        first, last = float(both[0][0][0]), float(both[0][0][-1])
        rest = max(settled(*signal) for signal in both)
        if first < rest <= first + EARLY * (last - first):
            ends.append(first + SHOWN * (rest - first))
    return max(ends, default=None)


def _columns_of(fig: Figure, until: float | None, unit: float, name: str) -> tuple[Sequence[Axes], Sequence[Axes]]:
    """Return the plots above and those below: of the whole run, and where asked for until a time (s) from near."""
    ratios = (1,) if until is None else (3, 2)
    above, below = fig.subplots(2, len(ratios), sharex="col", squeeze=False, width_ratios=ratios)
    for ax in below:
        ax.set_xlabel(f"time ({name})")
    if until is not None:
        above[1].set_title(f"the first {given(until / unit, 2)} {name}", loc="left", fontsize=7, fontweight="normal")
    return above, below


@dataclass(frozen=True, eq=False)
class Curves:
    """One case of an overlay: sp and pv (EU), and below (%) what stands in the lower plot; each (time, s; values)."""

    name: str
    sp: tuple[FloatArray, FloatArray]
    pv: tuple[FloatArray, FloatArray]
    below: tuple[FloatArray, FloatArray]

    def before(self, until: float) -> Curves:
        """Return the part until a time in s."""
        ends = [int(np.searchsorted(time, until)) + 1 for time, _ in (self.sp, self.pv, self.below)]
        parts = zip((self.sp, self.pv, self.below), ends, strict=True)
        return Curves(self.name, *((time[:end], values[:end]) for (time, values), end in parts))


def overlay_figure(cases: Sequence[CaseResult]) -> Figure:
    """Return PV of all cases above and their valve positions below, on one time axis, with the first case's SP."""
    runs = [(case.name, case.run) for case in cases]
    curves = [Curves(name, (r.time, r.sp), (r.time, r.pv), (r.time, r.valve)) for name, r in runs]
    return overlaid(curves, "valve (%)")


def overlaid(cases: Sequence[Curves], below_label: str) -> Figure:
    """Return PV of all cases above and what they have below, on one time axis, with the first case's SP.

    Where cases come to rest early, their first stretch stands beside them, from near.
    """
    with styled():
        fig = new_figure(WIDTH, 4.4)
        unit, name = draw.time_axis(max((float(c.pv[0][-1]) for c in cases), default=0.0))
        until = _first_stretch([(c.pv, c.below) for c in cases])
        above, below = _columns_of(fig, until, unit, name)
        _over_each_other(above[0], below[0], cases, unit)
        if until is not None:
            _over_each_other(above[1], below[1], [case.before(until) for case in cases], unit, near=True)
            draw.beside(above[1], below[1])
        above[0].set_ylabel("PV (EU)")
        below[0].set_ylabel(below_label)
        names = [label(case.name, 30) for case in cases] + ["SP"]
        fig.legend(
            *above[0].get_legend_handles_labels(), loc="outside upper center", ncols=_columns(names), handlelength=3.2
        )
    return fig


def _over_each_other(above: Axes, below: Axes, cases: Sequence[Curves], unit: float, *, near: bool = False) -> None:
    pvs, lower = _comparable([c.pv[1] for c in cases]), _comparable([c.below[1] for c in cases])
    wild = _diverging(cases)
    calm = [i for i in range(len(cases)) if i not in wild]
    for index, case in enumerate(cases):
        style = {**case_style(index), "linewidth": 1.0}
        draw.curve(above, case.pv[0] / unit, pvs[index], _span(pvs, calm), label(case.name, 30), style)
        draw.curve(below, case.below[0] / unit, lower[index], _span(lower, calm), "", style, steps=True)
    if cases:
        x, y = draw.thin(cases[0].sp[0] / unit, cases[0].sp[1])
        above.plot(x, y, label="SP", drawstyle="steps-post", **SP)
    if wild:
        draw.limit_to(above, [*(pvs[i] for i in calm), *(c.sp[1] for c in cases[:1])])
        draw.limit_to(below, [lower[i] for i in calm])
        if not near:
            draw.remark(above, f"{join([label(cases[i].name, 30) for i in wild])}: beyond this axis")
    if not near:
        draw.without_kicks(below, [lower[i] for i in calm])
    above.margins(x=0.01)


def _span(signals: Sequence[FloatArray], calm: Sequence[int]) -> float:
    """Return the range of those signals that a figure shows whole."""
    kept = [signals[i][np.isfinite(signals[i])] for i in calm]
    kept = [signal for signal in kept if signal.size]
    return max((float(s.max()) for s in kept), default=0.0) - min((float(s.min()) for s in kept), default=0.0)


def _columns(names: Sequence[str]) -> int:
    """Return how many columns, at most five, a legend of these names may have in a page's width."""
    for count in range(min(5, len(names)), 1, -1):
        # Filled from top to bottom; 3.7 points for a letter, 42 for the line before it and what parts columns.
        columns = np.array_split([len(name) for name in names], count)
        if sum(3.7 * int(column.max()) + 42.0 for column in columns) <= 72.0 * WIDTH:
            return count
    return 1


def _diverging(cases: Sequence[Curves]) -> list[int]:
    """Return the cases whose PV reaches more than ten times as far as that of the calmest, and as the setpoint."""
    reach = [float(np.nanmax(np.abs(draw.seen(c.pv[1])), initial=0.0)) for c in cases]
    target = max((float(np.abs(c.sp[1]).max()) for c in cases), default=0.0)
    limit = DIVERGES * max(min((r for r in reach if r > 0.0), default=0.0), target)
    out = [i for i, r in enumerate(reach) if r > limit]
    return out if len(out) < len(cases) else []


def _comparable(signals: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the signals, each only as far as it stays within 100 times the calmest one's range: one may diverge."""
    kept = [draw.seen(s) for s in signals]
    reach = [float(np.nanmax(np.abs(s))) for s in kept if np.isfinite(s).any()]
    limit = 100.0 * min((r for r in reach if r > 0.0), default=draw.BEYOND)
    return [draw.seen(s, limit) for s in kept]


def pv_op_figure(run: Run) -> Figure:
    """Return PV against OP above, valve position against OP below."""
    with styled():
        fig = new_figure(2.5, 2.75)
        above, below = fig.subplots(2, 1, sharex=True)
        draw.pv_op(above, run)
        draw.op_stem(below, run)
    return fig


def frequency_figure(named: Sequence[tuple[str, DescribingFunction]]) -> Figure:
    """Return L(jω) and −1/N(A) in the complex plane for named analyses, like the paper's Fig. 8.

    Full dots: crossings that the describing function reads as stable cycles; hollow: unstable ones; a thin line with
    crosses: the nearest approach of two loci that do not cross.
    """
    with styled():
        fig = new_figure(WIDTH, 4.2, layout=None)
        # Placed by hand: with one scale on both axes, the window has to have the shape of the axes.
        ax = fig.add_axes((0.075, 0.1, 0.66, 0.88))
        draw.frequency(ax, named, ratio=(0.66 * WIDTH) / (0.88 * 4.2))
        fig.legend(loc="upper right", bbox_to_anchor=(1.0, 0.99), handlelength=3.2)
    return fig


def _part(record: Record, window: tuple[float, float] | None) -> slice:
    """Return the samples of a record within a window (s, in the record's time), at least two; all by default."""
    if window is None:
        return slice(None)
    first = max(0, math.floor((window[0] - record.start) / record.sample_time))
    return slice(first, max(first + 2, math.ceil((window[1] - record.start) / record.sample_time)))


def estimate_figure(found: Estimate, title: str = "", window: tuple[float, float] | None = None) -> Figure:
    """Return PV with the model's prediction above, OP with the estimated stem below, like the paper's Fig. 4.

    window: (start, end) in the record's time, s; the whole record by default.
    """
    with styled():
        fig = new_figure(WIDTH, 3.4)
        above, below = fig.subplots(2, 1, sharex=True)
        part = _part(found.record, window)
        unit, name = draw.time_axis(float(found.record.time[part][-1]))
        draw.model_pv(above, found, unit, part)
        draw.model_op(below, found, unit, part)
        below.set_xlabel(f"time ({name})")
        above.set_title(label(title, 55), loc="left")
    return fig


def linear_fit_figure(found: Estimate, title: str = "", window: tuple[float, float] | None = None) -> Figure:
    """Return PV with the model's prediction above, and below with that of the fit that ignores stiction.

    Each with its parameters, like the paper's Figs. 3 and 4. window: as in `estimate_figure`.
    """
    plain = found.linear
    with styled():
        fig = new_figure(WIDTH, 3.6)
        above, below = fig.subplots(2, 1, sharex=True, sharey=True)
        part = _part(found.record, window)
        unit, name = draw.time_axis(float(found.record.time[part][-1]))
        draw.model_pv(above, found, unit, part)
        draw.model_pv(below, found, unit, part, linear=True)
        below.set_xlabel(f"time ({name})")
        with_stiction = parameter_words(found.valve, found.plant, found.residual_variance)
        without = parameter_words(Ideal(), plain.plant, plain.residual_variance)
        for ax, text in ((above, with_stiction), (below, without)):
            # Above the legend, which would cover its end.
            ax.set_title(text, loc="left", fontsize=7, fontweight="normal", pad=ABOVE)
        if title:
            fig.suptitle(label(title, 55), x=0.01, ha="left", fontsize=8.5, fontweight="bold")
    return fig


def op_stem_figure(found: Estimate, title: str = "") -> Figure:
    """Return PV and its prediction against OP, and beside it the estimated stem (and the measured one, Fig. 2)."""
    with styled():
        fig = new_figure(WIDTH, 2.9)
        left, right = fig.subplots(1, 2)
        draw.pv_op_found(left, found)
        draw.op_stem_found(right, found)
        left.set_title(label(title, 30), loc="left")
    return fig


def autocorrelation_figure(found: Detection, title: str = "") -> Figure:
    """Return PV's autocorrelation with its zero crossings and the period."""
    with styled():
        fig = new_figure(WIDTH, 2.0)
        ax = fig.subplots()
        pv_autocorrelation(ax, found)
        ax.set_title(label(title, 35), loc="left")
    return fig


def bicoherence_figure(found: Detection) -> Figure:
    """Return the squared bicoherence over both frequencies, with NGI and NLI."""
    with styled():
        fig = new_figure(4.6, 2.9)
        bicoherence_map(fig.subplots(), found)
    return fig


def apparent_stiction_figure(found: Detection) -> Figure:
    """Return PV against OP with the ellipse of the cycle and the apparent stiction."""
    with styled():
        fig = new_figure(2.5, 2.9)
        apparent_stiction(fig.subplots(), found)
    return fig


def profile_figure(found: Estimate, title: str = "") -> Figure:
    """Return the AIC against d, with the 95 % range shaded; a narrow range also from near."""
    with styled():
        fig = new_figure(WIDTH, 2.6)
        near = draw.near_best(found)
        if near is None:
            ax = fig.subplots()
        else:
            ax, zoomed = fig.subplots(1, 2, width_ratios=(3, 2))
            draw.profile(zoomed, found, near)
            zoomed.set_title("from near", loc="left")
        draw.profile(ax, found)
        own = ax.get_legend()
        if own is not None:  # over both panels instead
            own.remove()
        fig.legend(*ax.get_legend_handles_labels(), loc="outside upper right", ncols=4)
        ax.set_title(label(title, 35), loc="left")
    return fig


def convergence_figure(found: Estimate, title: str = "") -> Figure:
    """Return the two-step algorithm's d and residual variance against its iterations."""
    with styled():
        fig = new_figure(WIDTH, 2.8)
        above, below = fig.subplots(2, 1, sharex=True)
        draw.convergence(above, below, found)
        above.set_title(label(title, 55), loc="left")
    return fig


def svg_file(element: str) -> str:
    """Return an `<svg>` element as a file of its own."""
    return f'<?xml version="1.0" encoding="utf-8"?>\n{SVG_MARK}\n{element}\n'


SVG_MARK = "<!-- figure by Stiction Workbench -->"
