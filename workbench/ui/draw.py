"""What the page's pictures are made of: an empty figure, lines, names beside points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import BasicTickFormatter, ColumnDataSource, Line, NoOverlap, Range1d, Step
from bokeh.plotting import figure

from workbench.model.record import FloatArray
from workbench.report import palette as style
from workbench.report.words import label

__all__ = [
    "FONT",
    "curve",
    "edges",
    "label_sides",
    "labels",
    "line_look",
    "new_figure",
    "plain_ticks",
    "positive",
    "step",
]

FONT = '"Segoe UI", Arial, "Liberation Sans", Helvetica, sans-serif'
SOFT, GRID = "#555555", "#e4e4e4"
LABEL = 24  # characters of a name in a picture
PLANE, ROW = 250.0, 13.0  # CSS pixels: what a plane of points is high at least, and a line of text


def line_look(look: style.Style, width: float = 1.5) -> dict[str, Any]:
    """Return a line style of the report's figures as Bokeh's."""
    dash = look["linestyle"]
    return {
        "line_color": look["color"],
        "line_dash": "solid" if dash == "-" else [math.ceil(3 * part) if part > 1 else 2 for part in dash[1]],
        "line_width": width,
    }


def new_figure(name: str, x: str, y: str, **options: Any) -> Any:
    """Return an empty figure that fills its place on the page."""
    for axis in ("x_range", "y_range"):
        options.setdefault(axis, Range1d(0, 1))
    fig = figure(
        name=name,
        sizing_mode="stretch_both",
        min_height=120,
        tools="pan,box_zoom,wheel_zoom,reset,save",
        active_drag="box_zoom",
        active_scroll=None,
        toolbar_location="right",
        x_axis_label=x,
        y_axis_label=y,
        **options,
    )
    fig.toolbar.logo = None
    fig.toolbar.autohide = True
    fig.outline_line_color = None
    fig.min_border_left, fig.min_border_right = 64, 12
    for axis in fig.axis:
        axis.axis_label_text_font = axis.major_label_text_font = FONT
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = axis.major_label_text_font_size = "12px"
        axis.axis_label_text_color = axis.major_label_text_color = SOFT
        axis.axis_line_color = axis.major_tick_line_color = "#999999"
        axis.minor_tick_line_color = None
        axis.major_label_policy = NoOverlap()
    fig.grid.grid_line_color = GRID
    return fig


def curve(fig: Any, source: ColumnDataSource, x: str, y: str, **look: Any) -> Any:
    """Add a line; with nothing beside the glyph that a page without selections would have to carry."""
    return fig.add_glyph(source, Line(x=x, y=y, **look))


def step(fig: Any, source: ColumnDataSource, x: str, y: str, **look: Any) -> Any:
    """Add a line that holds each value until the next."""
    return fig.add_glyph(source, Step(x=x, y=y, mode="after", **look))


def plain_ticks() -> BasicTickFormatter:
    """Return what writes an axis's numbers without powers, from 0.0001 to a million."""
    return BasicTickFormatter(power_limit_low=-5, power_limit_high=6)


def positive(*values: float) -> bool:
    """Whether all values are finite and above 0."""
    return all(math.isfinite(v) and v > 0.0 for v in values)


def labels(names: Sequence[str], places: Sequence[tuple[float, float]]) -> list[str]:
    """Return names fit for a picture, those of one place together at the first of them."""
    out = []
    for i, place in enumerate(places):
        here = [label(name, LABEL) for name, other in zip(names, places, strict=True) if other == place]
        out.append(", ".join(here) if places.index(place) == i else "")
    return out


def label_sides(x: Sequence[float], up: Sequence[float], names: Sequence[str]) -> dict[str, list[Any]]:
    """Return where the names of points stand beside them: inward, so that they fit, and each below the one before.

    x: above 0, on a logarithmic axis; up: on whatever axis, as it is drawn. A point without a name takes no place.
    """
    middle = math.sqrt(min(x) * max(x)) if x else 0.0
    left = [at > middle for at in x]
    low, high = (min(up), max(up)) if up else (0.0, 1.0)
    heights = [PLANE * (at - low) / (high - low) if high > low else 0.0 for at in up]
    below, rise = math.inf, [0.0] * len(heights)
    for i in sorted(range(len(heights)), key=lambda k: -heights[k]):
        if names[i]:
            below = min(heights[i], below - ROW)
            rise[i] = heights[i] - below
    return {
        "align": ["right" if one else "left" for one in left],
        "beside": [-9 if one else 9 for one in left],
        "rise": [4 + one for one in rise],
    }


def edges(middles: FloatArray) -> FloatArray:
    """Return the borders of cells in even ratios."""
    ratio = math.sqrt(float(middles[1] / middles[0]))
    edges: FloatArray = np.append(middles / ratio, middles[-1] * ratio)
    return edges
