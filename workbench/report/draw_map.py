"""The map of a plane of tunings: four figures of the late cycle in colour, and the textbook's borders over them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from workbench.model.cycle_map import OUTCOMES, CycleMap
from workbench.model.record import FloatArray
from workbench.report.draw_evidence import cells
from workbench.report.palette import BLACK, GROWS, SHADES, VERMILION
from workbench.report.style import Style, new_figure, styled
from workbench.report.words import given, label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["BORDERS", "PANELS", "MapPoint", "border_field", "draw_map", "map_figure", "map_panels"]

WIDTH, HEIGHT = 7.1, 6.9
PANELS = (
    ("period", "late period"),
    ("pv_peak_to_peak", "PV peak to peak (EU)"),
    ("mean_square_error", "mean square error in the cycle (EU²)"),
    ("travel_per_hour", "valve travel an hour (%)"),
)
# Limits of the bands: within each decade, the finest series that needs no more bands than shades; times by the clock.
SERIES = (
    (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0),
    (1.0, 1.5, 2.0, 3.0, 5.0, 7.0),
    (1.0, 2.0, 5.0),
    (1.0, 3.0),
)
CLOCK = (
    (1.0, (1, 2, 5, 10, 20, 30)),
    (60.0, (1, 2, 5, 10, 20, 30)),
    (3600.0, (1, 2, 5, 12)),
    (86400.0, (1, 3, 10, 30)),
)
TIMES = tuple(unit * count for unit, counts in CLOCK for count in counts)
SPARED = 0.01
STEPS = (1.0, 2.0, 5.0)
SIDES, REACH = ((1, 1), (-1, 1), (1, -1), (-1, -1)), 2.5  # of a point, for its number; how far off, in cells
CASING = "white"  # about lines and points, so that they stand out on every shade
OPEN, RESTS = "#ffffff", "#ffffff"
BORDERS: tuple[tuple[str, str, Style], ...] = (
    ("crossing", "describing function: loci meet from here on", {"color": BLACK, "linestyle": "-", "linewidth": 1.3}),
    ("loop_gain", "Kc K J/S = 1", {"color": BLACK, "linestyle": (0, (5, 2)), "linewidth": 1.0}),
    ("lag_ratio", "Ti = tau + theta", {"color": BLACK, "linestyle": (0, (1, 1.2)), "linewidth": 1.2}),
    ("linear_stable", "ideal valve: unstable beyond", {"color": VERMILION, "linestyle": "-", "linewidth": 1.3}),
)


@dataclass(frozen=True, slots=True)
class MapPoint:
    """A named tuning to mark: Kc (%/EU) and Ti or Td (s), in the controller's own form.

    tuned: found, not given. beside: its third parameter is not the map's, so that the cell under it is another tuning.
    """

    name: str
    Kc: float
    value: float
    tuned: bool = False
    beside: bool = False


def map_figure(found: CycleMap, points: Sequence[MapPoint] = ()) -> Figure:
    """Return the figure of a map: period, PV's swing, mean square error and valve travel, with tunings marked."""
    with styled():
        fig = new_figure(WIDTH, HEIGHT)
        panels = list(fig.subplots(2, 2).ravel())
        map_panels(panels, found, points)
        fig.legend(handles=_keys(found, points), loc="outside lower center", ncols=3, handlelength=3.0)
    return fig


def map_panels(axes: Sequence[Axes], found: CycleMap, points: Sequence[MapPoint] = ()) -> None:
    """Draw a map's figures on as many axes, in the order of the figure."""
    for ax, (name, title) in zip(axes, PANELS, strict=False):
        draw_map(ax, found, name, title, points)


def draw_map(ax: Axes, found: CycleMap, name: str, title: str, points: Sequence[MapPoint] = ()) -> None:
    """Draw one figure of a map; the axes count cells, their ticks say Kc (%/EU) and Ti or Td (s)."""
    values = np.where(found.cycles, getattr(found, name), math.nan)
    bands, keys = _bands(values, time=name == "period"), []
    for (low, high, words), shade in zip(bands, _shades(len(bands)), strict=True):
        _fill(ax, (values >= low) & (values < high), facecolor=shade)
        keys.append(Patch(facecolor=shade, edgecolor="none", label=words))
    for mask, style in _marked(found):
        _fill(ax, mask, **style)
    for field, _, style in BORDERS:
        _border(ax, found, field, style)
    _mark(ax, found, points)
    rows, columns = found.outcome.shape
    ax.set_xlim(-0.5, columns - 0.5)
    ax.set_ylim(-0.5, rows - 0.5)
    ax.grid(visible=False)
    _ticks(ax.xaxis, np.log(found.Kc), logarithmic=True)
    _ticks(ax.yaxis, np.log(found.values) if found.axis == "Ti" else found.values, logarithmic=found.axis == "Ti")
    parallel = found.loop.controller.form == "parallel"
    ax.set_xlabel("Kc (%/EU)")
    unit_of = {"Ti": "EU s/%", "Td": "% s/EU"} if parallel else {}
    ax.set_ylabel(f"{found.axis} ({unit_of.get(found.axis, 's')})")
    ax.set_title(title, loc="left", fontsize=7.5)
    ax.legend(
        handles=keys[::-1],
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        fontsize=6.5,
        handlelength=1.0,
        borderaxespad=0.2,
    )


def _shades(count: int) -> tuple[str, ...]:
    """Return so many of the shades, spread over all of them."""
    if count == 1:
        return (SHADES[len(SHADES) // 2],)
    return tuple(SHADES[i] for i in np.linspace(0, len(SHADES) - 1, count).round().astype(int))


def _bands(values: FloatArray, *, time: bool) -> list[tuple[float, float, str]]:
    """Return (low, high, words) of at most eight bands with round limits that hold every finite value.

    They are spread over all but the outermost hundredths of the values, and open at ends beyond which some still lie.
    """
    finite = values[np.isfinite(values) & (values > 0.0)]
    if finite.size == 0:
        return []
    low, high = (float(q) for q in np.quantile(finite, (SPARED, 1.0 - SPARED)))
    least, most = float(finite.min()), float(finite.max())
    for scale in _scales(low, high, time=time):
        # Rounding must not shut out a value that is itself a limit.
        first = max(i for i, edge in enumerate(scale) if edge <= low * (1.0 + 1e-12))
        last = max(first + 1, min(i for i, edge in enumerate(scale) if edge > high))
        if last - first <= len(SHADES):
            break
    edges = scale[first : last + 1]
    words = [_time(edge) if time else given(edge, 3) for edge in edges]
    out = [(a, b, f"{v} to {w}") for (a, b), (v, w) in zip(pairwise(edges), pairwise(words), strict=True)]
    below, above = least < edges[0], most >= edges[-1]
    if below and above and len(out) == 1:
        return [(0.0, edges[1], f"below {words[1]}"), (edges[1], math.inf, f"{words[1]} and more")]
    if below:
        out[0] = (0.0, edges[1], f"below {words[1]}")
    if above:
        out[-1] = (edges[-2], math.inf, f"{words[-2]} and more")
    return out


def _scales(low: float, high: float, *, time: bool) -> Iterator[list[float]]:
    """Yield round limits that enclose two positive values, ever coarser, without end."""
    first, last = math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1
    if time and low >= TIMES[0] and high < TIMES[-1]:
        yield from ([*TIMES[:-1:every], TIMES[-1]] for every in (1, 2, 3, 4))
    else:
        yield from ([step * 10.0**k for k in range(first, last + 1) for step in steps] for steps in SERIES)
    for every in count(1):
        yield [10.0**k for k in range(first, last + every, every)]


def _time(seconds: float) -> str:
    """Return a round time in the unit in which it is round."""
    for unit, name in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= unit:
            return f"{given(seconds / unit, 3)} {name}"
    return f"{given(seconds, 3)} s"


def _fill(ax: Axes, inside: NDArray[np.bool_], **style: Any) -> None:
    rows, columns = np.nonzero(inside)
    if rows.size:
        path = cells(columns.astype(float), rows.astype(float), 1.0)
        ax.add_patch(PathPatch(path, linewidth=0, **{"edgecolor": "none", **style}))


def _marked(found: CycleMap) -> list[tuple[NDArray[np.bool_], Style]]:
    """Return which cells are marked by a pattern, and how: growing, coming to rest, depending on the start, open."""
    code = {name: found.outcome == place for place, name in enumerate(OUTCOMES)}
    grows = code["undecided"] & ~found.linear_stable
    return [
        (grows, {"facecolor": GROWS, "edgecolor": "#777777", "hatch": "////"}),
        (code["undecided"] & found.linear_stable, {"facecolor": OPEN, "edgecolor": BLACK, "hatch": "xxxx"}),
        (code["settles"], {"facecolor": RESTS, "edgecolor": "#777777", "hatch": "----"}),
        (code["depends"], {"facecolor": "none", "edgecolor": "white", "hatch": "\\\\\\\\"}),
    ]


def border_field(found: CycleMap, name: str) -> FloatArray | None:
    """Return a border's field, shape (R, M), 0 on it; None where the map does not hold the border."""
    if name == "linear_stable":
        field = np.where(found.linear_stable, -1.0, 1.0)
    else:
        with np.errstate(divide="ignore", invalid="ignore"):
            field = np.clip(np.log(np.asarray(getattr(found, name), dtype=np.float64)), -50.0, 50.0)
    return field if np.isfinite(field).all() and field.min() < 0.0 < field.max() else None


def _border(ax: Axes, found: CycleMap, name: str, style: Style) -> None:
    field = border_field(found, name)
    if field is None:
        return
    rows, columns = found.outcome.shape
    lines = ax.contour(
        np.arange(columns),
        np.arange(rows),
        field,
        levels=[0.0],
        colors=[style["color"]],
        linewidths=[style["linewidth"]],
        linestyles=[style["linestyle"]],
    )
    lines.set(path_effects=[withStroke(linewidth=style["linewidth"] + 1.4, foreground=CASING)])


def _place(found: CycleMap, point: MapPoint) -> tuple[float, float] | None:
    """Return where a tuning lies, in cells, or None outside the map."""
    if not found.contains(point.Kc, point.value):
        return None
    x = float(np.interp(math.log(point.Kc), np.log(found.Kc), np.arange(found.Kc.size)))
    if found.axis == "Ti":
        return x, float(np.interp(math.log(point.value), np.log(found.values), np.arange(found.values.size)))
    return x, float(np.interp(point.value, found.values, np.arange(found.values.size)))


def _mark(ax: Axes, found: CycleMap, points: Sequence[MapPoint]) -> None:
    """Mark each tuning inside the map by a dot and its number, at the side where no other one lies."""
    placed = [(number, at) for number, point in enumerate(points, start=1) if (at := _place(found, point)) is not None]
    casing = [withStroke(linewidth=1.8, foreground=CASING)]
    for number, (x, y) in placed:
        ax.plot([x], [y], **_dot(points[number - 1]), path_effects=casing, zorder=6)
        others = [at for k, at in placed if k != number]
        sx, sy = max(SIDES, key=lambda side: _room(found, x + REACH * side[0], y + REACH * side[1], others))
        ax.annotate(
            str(number),
            (x, y),
            xytext=(3.5 * sx, 3.5 * sy),
            textcoords="offset points",
            ha="left" if sx > 0 else "right",
            va="bottom" if sy > 0 else "top",
            fontsize=7.5,
            fontweight="bold",
            path_effects=casing,
            zorder=7,
        )


def _dot(point: MapPoint) -> Style:
    """Return a tuning's marker: hollow where it lies beside the map's plane."""
    colour = VERMILION if point.tuned else BLACK
    return {
        "marker": "o",
        "linestyle": "none",
        "color": colour,
        "markerfacecolor": "white" if point.beside else colour,
        "markeredgewidth": 1.0,
        "markersize": 4.5,
    }


def _room(found: CycleMap, x: float, y: float, others: Sequence[tuple[float, float]]) -> float:
    """Return how far a place (in cells) is from the nearest of other points, below 0 outside the map."""
    rows, columns = found.outcome.shape
    if not (0.0 <= x <= columns - 1.0 and 0.0 <= y <= rows - 1.0):
        return -1.0
    return min((math.hypot(x - u, y - v) for u, v in others), default=math.inf)


def _ticks(axis: Any, values: FloatArray, *, logarithmic: bool) -> None:
    """Put round numbers at the cells where they lie; `values` are evenly spaced, logarithms where so said."""
    low, high = float(values[0]), float(values[-1])
    if logarithmic:
        decades = range(math.floor(low / math.log(10.0)), math.ceil(high / math.log(10.0)) + 1)
        steps = STEPS if (high - low) / math.log(10.0) < 3.0 else (1.0, 3.0)
        round_ones = [step * 10.0**k for k in decades for step in steps]
        at = [math.log(v) for v in round_ones]
    else:
        step = 10.0 ** math.floor(math.log10((high - low) / 2.0))
        step *= next(f for f in (1.0, 2.0, 5.0, 10.0) if (high - low) / (f * step) <= 6.0)
        round_ones = [step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
        at = round_ones
    kept = [(a, v) for a, v in zip(at, round_ones, strict=True) if low - 1e-9 <= a <= high + 1e-9]
    if len(kept) < 2:  # too narrow for round numbers
        kept = [(a, math.exp(a) if logarithmic else a) for a in (low, high)]
    scale = (values.size - 1) / (high - low)
    axis.set_ticks([(a - low) * scale for a, _ in kept], [given(v, 3) for _, v in kept])


def _keys(found: CycleMap, points: Sequence[MapPoint]) -> list[Any]:
    """Return the figure's key: borders, patterns and numbered tunings, as far as they are in it."""
    out: list[Any] = [
        Line2D([], [], label=text, **style) for name, text, style in BORDERS if border_field(found, name) is not None
    ]
    texts = ("unstable: PV grows", "undecided", "comes to rest from every start", "depends on the start")
    for (mask, style), text in zip(_marked(found), texts, strict=True):
        if mask.any():
            shown = {**style, "facecolor": SHADES[5]} if style["facecolor"] == "none" else style
            out.append(Patch(label=text, linewidth=0, **shown))
    for number, point in enumerate(points, start=1):
        if _place(found, point) is not None:
            text = f"{number}  {label(point.name, 30)}"
            out.append(Line2D([], [], label=text, **_dot(point)))
    return out
