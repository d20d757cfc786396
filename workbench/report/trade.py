"""The figure of error against valve travel: both fronts, and the cases as named points whose labels keep apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from workbench.model.front import Front, FrontPoint
from workbench.model.record import FloatArray
from workbench.report.style import PV, VALVE, new_figure, styled
from workbench.report.words import given, label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["NamedPoint", "draw_front", "trade_figure"]

WIDTH, HEIGHT = 7.1, 4.6
FONT = 7.0  # points
LETTER = 0.56  # mean width of a letter, in font sizes
RINGS = (6.0, 13.0, 22.0, 34.0, 48.0, 66.0, 90.0, 120.0)  # points from a named point to its label
MARKER = 3.2  # points from a named point to the edge of its marker
LEADER = {"arrowstyle": "-", "linewidth": 0.5, "color": "#767676", "shrinkA": 0.0, "shrinkB": 2.0}
NEEDED = 1.3  # factor by which an axis reaches beyond what it shows


@dataclass(frozen=True, slots=True)
class NamedPoint:
    """A case's mean valve travel (%) and mean square error (EU^2); tuned: whether it was found here."""

    name: str
    valve_travel: float
    mean_square_error: float
    tuned: bool = False


def trade_figure(front: Front, named: Sequence[NamedPoint]) -> Figure:
    """Return the figure of a front and the cases of its study."""
    with styled():
        fig = new_figure(WIDTH, HEIGHT, layout=None)
        # Placed by hand: labels can only keep apart in axes whose size is known.
        ax = fig.add_axes((0.075, 0.09, 0.915, 0.84))
        draw_front(ax, front, named)
    return fig


def draw_front(ax: Axes, front: Front, named: Sequence[NamedPoint] = ()) -> None:
    """Draw both fronts and named points on log axes; points that are not finite and above 0 are left out."""
    shown = [p for p in named if _drawable(p.valve_travel) and _drawable(p.mean_square_error)]
    sticky, repaired = _line(front.sticky), _line(front.repaired)
    own = "valve as it is" if front.repaired else "least error for its travel"
    ax.plot(*sticky, label=own, marker=".", markersize=3.5, **VALVE)
    if front.repaired:
        ax.plot(*repaired, label="valve repaired", marker=".", markersize=3.5, **PV)
    ax.set_xscale("log")
    ax.set_yscale("log")
    lines = np.concatenate([sticky, repaired], axis=1)
    points = np.array([[p.valve_travel for p in shown], [p.mean_square_error for p in shown]])
    everything = np.concatenate([lines, points], axis=1)
    if everything.shape[1]:
        (left, bottom), (right, top) = everything.min(axis=1) / NEEDED, everything.max(axis=1) * NEEDED
        ax.set_xlim(left, right)
        ax.set_ylim(bottom, top)
    for tuned, text, marker, colour in ((False, "cases", "o", "#000000"), (True, "tuned here", "D", "#D55E00")):
        some = [p for p in shown if p.tuned is tuned]
        if some:
            x, y = [p.valve_travel for p in some], [p.mean_square_error for p in some]
            ax.plot(x, y, marker, label=text, color=colour, markersize=4.5, zorder=5)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: given(value)))
        axis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("mean valve travel in a draw (%)")
    ax.set_ylabel("mean square error (EU²)")
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.1)
    _name(ax, shown, lines)


def _drawable(value: float) -> bool:
    return math.isfinite(value) and value > 0.0


def _line(points: Sequence[FrontPoint]) -> FloatArray:
    """Return (travel, error) of a front, shape (2, M), without what log axes do not hold."""
    kept = [p for p in points if _drawable(p.valve_travel) and _drawable(p.mean_square_error)]
    return np.array([[p.valve_travel for p in kept], [p.mean_square_error for p in kept]]).reshape(2, -1)


def _name(ax: Axes, named: Sequence[NamedPoint], lines: FloatArray) -> None:
    """Write each name beside its point where it hides least: other names, other points, the fronts."""
    if not named:
        return
    scale = 72.0 / ax.figure.dpi  # pixels to points
    to_points = ax.transData.transform
    at = to_points([(p.valve_travel, p.mean_square_error) for p in named]) * scale
    dense = _dense(lines)
    busy = to_points(dense.T) * scale if dense.size else np.zeros((0, 2))
    box = ax.get_window_extent()
    frame = np.array([[box.x0, box.y0], [box.x1, box.y1]]) * scale
    taken: list[tuple[float, float, float, float]] = []
    # The most crowded points choose first, while there is room.
    distance = np.hypot(*(at[:, None, :] - at[None, :, :]).transpose(2, 0, 1))
    order = np.argsort(np.sort(distance, axis=1)[:, : min(4, len(named))].sum(axis=1), kind="stable")
    for i in order:
        text = label(named[i].name, 34)
        width, height = LETTER * FONT * len(text), 1.25 * FONT
        best = min(
            (_cost(at[i] + offset, width, height, i, at, busy, taken, frame, ring), ring, k, offset)
            for k, (ring, offset) in enumerate(_offsets(width, height))
        )
        _, ring, _, offset = best
        x, y = at[i] + np.array(offset)
        taken.append((x, y, x + width, y + height))
        ax.annotate(
            text,
            (named[i].valve_travel, named[i].mean_square_error),
            xytext=offset,
            textcoords="offset points",
            fontsize=FONT,
            zorder=6,
            arrowprops=None if ring == RINGS[0] else LEADER,
        )


def _offsets(width: float, height: float) -> list[tuple[float, tuple[float, float]]]:
    """Return (ring, lower left corner from the point) of the places that a label may take, the nearest first."""
    places = []
    for ring in RINGS:
        for turn in (0.0, 45.0, -45.0, 90.0, -90.0, 180.0, 135.0, -135.0, 22.0, -22.0, 158.0, -158.0):
            c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
            # The label's nearest edge or corner lies on the ring.
            x = ring * c - width * 0.5 * (1.0 - min(1.0, max(-1.0, 1.6 * c)))
            y = ring * s - height * 0.5 * (1.0 - min(1.0, max(-1.0, 1.6 * s)))
            places.append((ring, (round(x, 2), round(y, 2))))
    return places


def _dense(lines: FloatArray) -> FloatArray:
    """Return the fronts' points with two more between each pair, in the log plane, so that no label slips between."""
    if lines.shape[1] < 2:
        return lines
    logs = np.log(lines)
    steps = np.arange(3 * lines.shape[1] - 2) / 3.0
    whole = np.arange(lines.shape[1])
    dense: FloatArray = np.exp(np.array([np.interp(steps, whole, row) for row in logs]))
    return dense


def _cost(
    corner: FloatArray,
    width: float,
    height: float,
    own: int,
    points: FloatArray,
    busy: FloatArray,
    taken: Sequence[tuple[float, float, float, float]],
    frame: FloatArray,
    ring: float,
) -> float:
    """Return how much a label there hides or misleads: other labels count most, then points, the fronts, distance.

    own: the index of its point; a label nearer to another one would be read as that one's.
    """
    x0, y0 = float(corner[0]), float(corner[1])
    x1, y1 = x0 + width, y0 + height
    outside = x0 < frame[0, 0] or y0 < frame[0, 1] or x1 > frame[1, 0] or y1 > frame[1, 1]
    over = sum(x0 < b[2] and b[0] < x1 and y0 < b[3] and b[1] < y1 for b in taken)

    def within(some: FloatArray, slack: float) -> int:
        inside = (some > (x0 - slack, y0 - slack)).all(axis=1) & (some < (x1 + slack, y1 + slack)).all(axis=1)
        return int(np.count_nonzero(inside))

    beside = np.hypot(
        np.maximum(np.maximum(x0 - points[:, 0], points[:, 0] - x1), 0.0),
        np.maximum(np.maximum(y0 - points[:, 1], points[:, 1] - y1), 0.0),
    )
    # Beside another point nearly as near, only a line tells whose the label is; the nearest ring has none.
    strays = int(np.count_nonzero(beside < 2.0 * beside[own] + 2.0)) - 1
    cost: float = (
        (200.0 if ring == RINGS[0] else 30.0) * strays
        + 1000.0 * outside
        + 300.0 * over
        + 250.0 * within(points, MARKER)
        + 8.0 * within(busy, 1.0)
        + 0.5 * ring
    )
    return cost
