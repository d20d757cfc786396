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
from workbench.report.interactive_planes import dash_of, front_plane, map_planes, new_figure
from workbench.report.over_ensemble import named_points
from workbench.report.palette import OP, PV, SP, VALVE, case_style
from workbench.report.plain_truth import map_points
from workbench.report.thinned import seen, thin, time_axis
from workbench.report.words import label

__all__ = ["SAMPLES", "Zoomable", "zoomable"]

SAMPLES = 60_000  # of all cases together, above which each signal is thinned to its extremes: bounds the page's size
HEIGHT = 210  # CSS pixels of a panel


@dataclass(frozen=True, slots=True)
class Zoomable:
    """What a page with zoomable figures holds: Bokeh's script, the figures' own, and a place for each.

    overlay: of all cases. cases: (trend, PV-OP) for each case, in order. plane: the map of tunings. front: error
    against valve travel. "" for one that there is not.
    """

    library: Markup
    script: Markup
    overlay: Markup
    cases: tuple[tuple[Markup, Markup], ...]
    plane: Markup
    front: Markup


def zoomable(study: Study) -> Zoomable:
    """Return the zoomable figures of a study's cases, of which there is at least one: of all together, and of each."""
    from bokeh.embed import components
    from bokeh.resources import Resources

    columns = SAMPLES // (4 * max(len(study.cases), 1))
    models: list[Any] = []
    for case in study.cases:
        models += [_trend(case, columns), _pv_op(case, columns)]
    # Figures that there are not must not be in the script: it fails without their places.
    if len(study.cases) > 1:
        models.append(_overlay(study.cases, columns))
    planes = map_planes(study.cycle_map, map_points(study)) if study.cycle_map is not None else None
    if planes is not None:
        models.append(planes)
    if study.front is not None and study.front.sticky:
        models.append(front_plane(study.front, named_points(study)))
    script, divs = components(models)
    library = Resources(mode="inline", components=["bokeh"]).render_js()
    # Bokeh's own markup: what comes from a scenario is escaped JSON in it.
    places = iter(Markup(div) for div in divs)  # noqa: S704
    pairs = tuple((next(places), next(places)) for _ in study.cases)
    return Zoomable(
        Markup(library),  # noqa: S704
        Markup(script),  # noqa: S704
        next(places) if len(study.cases) > 1 else Markup(""),
        pairs,
        next(places) if planes is not None else Markup(""),
        next(places, Markup("")),
    )


def _line(into: Any, x: FloatArray, y: FloatArray, columns: int, style: dict[str, Any], name: str) -> None:
    """Draw a signal over time, at single precision, where it is more than what a screen shows."""
    x, y = thin(x, seen(y), columns)
    into.line(
        x.astype(np.float32),
        y.astype(np.float32),
        color=style["color"],
        line_width=style.get("linewidth", 1.3),
        line_dash=dash_of(style["linestyle"]),
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
    above, below = new_figure("PV, SP (EU)", height=HEIGHT), new_figure("OP, valve (%)", f"time ({name})", HEIGHT)
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
    above, below = new_figure("PV (EU)", height=HEIGHT), new_figure("valve (%)", "OP (%)", HEIGHT)
    for part, signal, style in ((above, run.pv, PV), (below, run.valve, VALVE)):
        part.line(op, seen(signal[last]).astype(np.float32), color=style["color"], line_width=1.0)
    return _stacked(above, below)


def _overlay(cases: Sequence[CaseResult], columns: int) -> Any:
    unit, name = time_axis(max(float(case.run.time[-1]) for case in cases))
    above, below = new_figure("PV (EU)", height=HEIGHT), new_figure("valve (%)", f"time ({name})", HEIGHT)
    for i, case in enumerate(cases):
        for part, signal in ((above, case.run.pv), (below, case.run.valve)):
            _line(part, case.run.time / unit, signal, columns, case_style(i), label(case.name, 30))
    below.legend.visible = False
    first = cases[0].run
    _line(above, first.time / unit, first.sp, columns, SP, "SP")
    return _stacked(above, below)
