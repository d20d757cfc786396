"""The planes of a study that can be zoomed: the map of tunings, and error against valve travel; see `interactive`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from workbench.model.cycle_map import OUTCOMES, CycleMap
from workbench.model.front import Front, FrontPoint
from workbench.model.record import FloatArray
from workbench.report.draw_map import BORDERS, PANELS, MapPoint, border_field
from workbench.report.palette import GROWS, PV, SHADES, VALVE, VERMILION
from workbench.report.trade import NamedPoint
from workbench.report.words import controller_words, label

__all__ = ["MOST_CELLS", "dash_of", "front_plane", "map_planes", "new_figure"]

MOST_CELLS = 10_000  # of a map; more would make the page slow
HEIGHT = 300  # CSS pixels of a plane
TOOLS = "pan,wheel_zoom,box_zoom,reset,save"
MARK = {"size": 9, "line_color": "white", "line_width": 1.2}
TICKS = [1, 2, 5]
NOTHING = "rgba(0, 0, 0, 0)"


def new_figure(ylabel: str, xlabel: str = "", height: int = HEIGHT, **more: Any) -> Any:
    """Return an empty figure that takes the width of its place."""
    from bokeh.plotting import figure as bokeh_figure

    made = bokeh_figure(height=height, sizing_mode="stretch_width", tools=TOOLS, active_drag="box_zoom", **more)
    made.toolbar.logo = None
    made.yaxis.axis_label = ylabel
    made.xaxis.axis_label = xlabel
    return made


def dash_of(pattern: Any) -> Any:
    """Return a line style's dashes as Bokeh's."""
    return (
        {"-": "solid"}.get(pattern, pattern) if isinstance(pattern, str) else [max(1, round(2 * p)) for p in pattern[1]]
    )


def _logarithmic(fig: Any, *axes: Any) -> None:
    from bokeh.models import BasicTickFormatter, LogTicker, NoOverlap

    for axis in axes:
        axis.major_label_policy = NoOverlap()
        axis.formatter = BasicTickFormatter()
        axis.ticker = LogTicker(mantissas=TICKS)
    fig.grid.grid_line_color = "#e4e4e4"


def _edges(middles: FloatArray, *, ratio: bool) -> FloatArray:
    """Return the borders of cells in even ratios or steps."""
    at = np.log(middles) if ratio else middles
    half = 0.5 * (at[1] - at[0])
    edges = np.append(at - half, at[-1] + half)
    return np.exp(edges) if ratio else edges


def map_planes(found: CycleMap, points: Sequence[MapPoint]) -> Any:
    """Return a map's four figures, which zoom together; None for one of more than `MOST_CELLS` cells."""
    from bokeh.layouts import gridplot
    from bokeh.models import ColumnDataSource

    rows, columns = found.outcome.shape
    if rows * columns > MOST_CELLS:
        return None
    across, up = _edges(found.Kc, ratio=True), _edges(found.values, ratio=found.axis == "Ti")
    outcome = [
        OUTCOMES[code] if stable else "unstable even with an ideal valve"
        for code, stable in zip(found.outcome.ravel().tolist(), found.linear_stable.ravel().tolist(), strict=True)
    ]
    cells: dict[str, Any] = {
        "left": np.tile(across[:-1], rows),
        "right": np.tile(across[1:], rows),
        "bottom": np.repeat(up[:-1], columns),
        "top": np.repeat(up[1:], columns),
    }
    for name, _ in PANELS:
        held = found.cycles & found.linear_stable
        cells[name] = np.where(held, getattr(found, name), math.nan).ravel()
    cells = {name: column.astype(np.float32) for name, column in cells.items()}
    source = ColumnDataSource(cells | {"outcome": outcome, "grey": np.where(found.linear_stable, 0.0, 1.0).ravel()})
    panels: list[Any] = []
    for name, title in PANELS:
        panels.append(_panel(found, name, title, source, panels[0] if panels else None))
        _marks(panels[-1], points)
    _borders(panels, found)
    return gridplot([panels[:2], panels[2:]], sizing_mode="stretch_width", merge_tools=True, toolbar_location="right")


def _panel(found: CycleMap, name: str, title: str, source: Any, first: Any) -> Any:
    from bokeh.models import BasicTickFormatter, ColorBar, HoverTool, LogColorMapper, LogTicker

    kind = "log" if found.axis == "Ti" else "linear"
    shared = {} if first is None else {"x_range": first.x_range, "y_range": first.y_range}
    fig = new_figure(f"{found.axis} (s)", "Kc (%/EU)", x_axis_type="log", y_axis_type=kind, **shared)
    _logarithmic(fig, *fig.xaxis, *(fig.yaxis if kind == "log" else ()))
    fig.title.text = title
    fig.title.text_font_size = "12px"
    values = source.data[name]
    shown = values[np.isfinite(values) & (values > 0.0)]
    low, high = (float(shown.min()), float(shown.max())) if shown.size else (1.0, 10.0)
    mapper = LogColorMapper(palette=list(SHADES), low=low, high=max(high, 1.001 * low), nan_color=NOTHING)
    sides = {side: side for side in ("left", "right", "bottom", "top")}
    fig.quad(**sides, source=source, fill_color=GROWS, fill_alpha="grey", line_color=None)
    shade = {"field": name, "transform": mapper}
    # Lines of the same shade close the gaps that a browser leaves between cells.
    quads = fig.quad(**sides, source=source, fill_color=shade, line_color=shade, line_width=0.6)
    ticks = {"ticker": LogTicker(mantissas=TICKS), "formatter": BasicTickFormatter()}
    fig.add_layout(ColorBar(color_mapper=mapper, width=10, padding=3, **ticks), "right")
    tips = [("Kc", "$x{0.000a}"), (found.axis, "$y{0.0a} s"), ("long run", "@outcome"), (title, f"@{name}")]
    fig.add_tools(HoverTool(renderers=[quads], tooltips=tips, point_policy="follow_mouse"))
    return fig


def _marks(fig: Any, points: Sequence[MapPoint]) -> None:
    """Mark each tuning by a dot that says its name."""
    from bokeh.models import ColumnDataSource, HoverTool

    if not points:
        return
    data = {
        "x": [p.Kc for p in points],
        "y": [p.value for p in points],
        "name": [label(p.name, 40) + (" (beside this plane)" if p.beside else "") for p in points],
        "color": [VERMILION if p.tuned else "#000000" for p in points],
    }
    dots = fig.scatter("x", "y", source=ColumnDataSource(data), fill_color="color", **MARK)
    fig.add_tools(HoverTool(renderers=[dots], tooltips="@name"))


def _borders(panels: Sequence[Any], found: CycleMap) -> None:
    """Draw the textbook's borders over every panel; the caption tells which is which."""
    from bokeh.models import HoverTool
    from bokeh.plotting.contour import contour_data

    ratio = found.axis == "Ti"
    x, y = np.log(found.Kc), np.log(found.values) if ratio else found.values
    for name, text, look in BORDERS:
        field = border_field(found, name)
        if field is None:
            continue
        lines = contour_data(x, y, field, levels=[0.0], want_fill=False).line_data
        Kc, values = np.exp(lines.xs[0]), np.exp(lines.ys[0]) if ratio else lines.ys[0]
        width, dash = 1.2 * look["linewidth"], dash_of(look["linestyle"])
        for fig in panels:
            fig.line(Kc, values, line_color="white", line_width=width + 2.0)
            line = fig.line(Kc, values, line_color=look["color"], line_width=width, line_dash=dash)
            fig.add_tools(HoverTool(renderers=[line], tooltips=text))


def front_plane(front: Front, named: Sequence[NamedPoint]) -> Any:
    """Return the figure of error against valve travel; each point of a front says its tuning."""
    from bokeh.models import ColumnDataSource, HoverTool

    fig = new_figure(
        "mean square error (EU²)",
        "mean valve travel in a draw (%)",
        height=420,
        x_axis_type="log",
        y_axis_type="log",
    )
    _logarithmic(fig, *fig.xaxis, *fig.yaxis)
    both = [("valve travel", "@x{0.0} %"), ("mean square error", "@y{0.0000} EU²")]
    own = "valve as it is" if front.repaired else "least error for its travel"
    for points, look, text in ((front.sticky, VALVE, own), (front.repaired, PV, "valve repaired")):
        kept = [p for p in points if _drawable(p.valve_travel, p.mean_square_error)]
        if not kept:
            continue
        source = ColumnDataSource(_column(kept, front.digits))
        fig.line("x", "y", source=source, line_color=look["color"], line_width=1.5, legend_label=text)
        dots = fig.scatter("x", "y", source=source, color=look["color"], size=5, legend_label=text)
        fig.add_tools(HoverTool(renderers=[dots], tooltips=[("tuning", "@tuning"), *both]))
    placed = [p for p in named if _drawable(p.valve_travel, p.mean_square_error)]
    for tuned, text, colour in ((False, "cases", "#000000"), (True, "tuned here", VERMILION)):
        some = [p for p in placed if p.tuned is tuned]
        if some:
            data = {
                "x": [p.valve_travel for p in some],
                "y": [p.mean_square_error for p in some],
                "name": [label(p.name, 40) for p in some],
            }
            source = ColumnDataSource(data)
            dots = fig.scatter("x", "y", source=source, fill_color=colour, legend_label=text, **MARK)
            words = {"x_offset": 7, "y_offset": -4, "text_font_size": "11px"}
            fig.text("x", "y", text="name", source=source, **words)
            fig.add_tools(HoverTool(renderers=[dots], tooltips=[("case", "@name"), *both]))
    if fig.legend:
        legend = fig.legend[0]
        legend.update(label_text_font_size="11px", orientation="horizontal", padding=2, border_line_color=None)
        fig.add_layout(legend, "above")
    return fig


def _drawable(*values: float) -> bool:
    return all(math.isfinite(v) and v > 0.0 for v in values)


def _column(points: Sequence[FrontPoint], digits: int) -> dict[str, Any]:
    return {
        "x": np.array([p.valve_travel for p in points]),
        "y": np.array([p.mean_square_error for p in points]),
        "tuning": [controller_words(p.controller, digits) for p in points],
    }
