"""Figures that can be zoomed, for a page made with them on purpose: Bokeh, with all that it needs inside the page.

They stand beside the static figures and take their place only where scripts run and on a screen; print, and a reader
without scripts, keep the static ones. Bokeh's own script is 1.2 MiB, and its models have names that change from run to
run: therefore the default report, which is kept and compared, has none of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from workbench.model.record import FloatArray
from workbench.model.study import CaseResult, Study
from workbench.report.palette import OP, PV, SP, VALVE, case_style
from workbench.report.thinned import seen, thin, time_axis
from workbench.report.words import label

__all__ = ["SAMPLES", "Zoomable", "zoomable"]

SAMPLES = 60_000  # of all cases together, above which each signal is thinned to its extremes: bounds the page's size
HEIGHT = 210  # CSS pixels of a panel
TOOLS = "pan,wheel_zoom,box_zoom,reset,save"


@dataclass(frozen=True, slots=True)
class Zoomable:
    """What a page with zoomable figures holds: Bokeh's script, the figures' own, and a place for each.

    overlay: of all cases. cases: (trend, PV-OP) for each case, in order.
    """

    library: Markup
    script: Markup
    overlay: Markup
    cases: tuple[tuple[Markup, Markup], ...]


def zoomable(study: Study) -> Zoomable:
    """Return the zoomable figures of a study's cases, of which there is at least one: of all together, and of each."""
    from bokeh.embed import components
    from bokeh.resources import Resources

    columns = SAMPLES // (4 * max(len(study.cases), 1))
    models: list[Any] = []
    for case in study.cases:
        models += [_trend(case, columns), _pv_op(case, columns)]
    several = len(study.cases) > 1  # one case has no figure of all together, and a script without its place fails
    if several:
        models.append(_overlay(study.cases, columns))
    script, divs = components(models)
    library = Resources(mode="inline", components=["bokeh"]).render_js()
    # Bokeh's own markup: what comes from a scenario is escaped JSON in it.
    places = [Markup(div) for div in divs]  # noqa: S704
    pairs = tuple((places[2 * i], places[2 * i + 1]) for i in range(len(study.cases)))
    return Zoomable(Markup(library), Markup(script), places[-1] if several else Markup(""), pairs)  # noqa: S704


def _figure(ylabel: str, xlabel: str = "", **more: Any) -> Any:
    from bokeh.plotting import figure

    made = figure(height=HEIGHT, sizing_mode="stretch_width", tools=TOOLS, active_drag="box_zoom", **more)
    made.toolbar.logo = None
    made.yaxis.axis_label = ylabel
    made.xaxis.axis_label = xlabel
    return made


def _line(into: Any, x: FloatArray, y: FloatArray, columns: int, style: dict[str, Any], name: str) -> None:
    """Draw a signal over time, at single precision, where it is more than what a screen shows."""
    x, y = thin(x, seen(y), columns)
    pattern = style["linestyle"]
    dash = "solid" if isinstance(pattern, str) else [max(1, round(2 * part)) for part in pattern[1]]
    into.line(
        x.astype(np.float32),
        y.astype(np.float32),
        color=style["color"],
        line_width=style.get("linewidth", 1.3),
        line_dash=dash,
        legend_label=name,
    )


def _stacked(above: Any, below: Any) -> Any:
    from bokeh.layouts import column

    below.x_range = above.x_range
    for part in (above, below):
        for legend in part.legend:
            legend.update(click_policy="hide", label_text_font_size="11px", orientation="horizontal", ncols=4)
            legend.update(padding=2, border_line_color=None)
            part.add_layout(legend, "above")
    return column(above, below, sizing_mode="stretch_width")


def _trend(case: CaseResult, columns: int) -> Any:
    run = case.run
    unit, name = time_axis(float(run.time[-1]))
    time = run.time / unit
    above, below = _figure("PV, SP (EU)"), _figure("OP, valve (%)", f"time ({name})")
    _line(above, time, run.pv, columns, PV, "PV")
    _line(above, time, run.sp, columns, SP, "SP")
    _line(below, time, run.valve, columns, VALVE, "valve")
    _line(below, time, run.op, columns, OP, "OP")
    return _stacked(above, below)


def _pv_op(case: CaseResult, columns: int) -> Any:
    """PV and valve against OP: every sample of the stretch that fits, the last of the run."""
    run = case.run
    last = slice(max(0, run.op.size - 4 * columns), None)
    op = seen(run.op[last]).astype(np.float32)
    above, below = _figure("PV (EU)"), _figure("valve (%)", "OP (%)")
    for part, signal, style in ((above, run.pv, PV), (below, run.valve, VALVE)):
        part.line(op, seen(signal[last]).astype(np.float32), color=style["color"], line_width=1.0)
    return _stacked(above, below)


def _overlay(cases: Sequence[CaseResult], columns: int) -> Any:
    unit, name = time_axis(max(float(case.run.time[-1]) for case in cases))
    above, below = _figure("PV (EU)"), _figure("valve (%)", f"time ({name})")
    for i, case in enumerate(cases):
        for part, signal in ((above, case.run.pv), (below, case.run.valve)):
            _line(part, case.run.time / unit, signal, columns, case_style(i), label(case.name, 30))
    below.legend.visible = False
    first = cases[0].run
    _line(above, first.time / unit, first.sp, columns, SP, "SP")
    return _stacked(above, below)
