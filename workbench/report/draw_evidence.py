"""What is drawn of a detection on given axes: autocorrelation, bicoherence, PV against OP with its ellipse."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path

from workbench.kpi.oscillation import autocorrelation, zero_crossings
from workbench.model.detection import NONLINEARITY, NOT_ASKED, Detection
from workbench.model.record import FloatArray
from workbench.report.draw import phase, remark, thin, time_axis
from workbench.report.style import OP, PV, VALVE, Style
from workbench.report.words import duration, figure, given

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["apparent_stiction", "bicoherence_map", "pv_autocorrelation"]

# Light to dark, which grey print keeps: the bands of squared bicoherence between chance and 1.
SHADES = ("#c6dbef", "#6baed6", "#2171b5", "#08306b")
BEYOND_LAST = 1.15  # of the last zero crossing that counts: what of the lags is shown
POINTS = 200  # of an ellipse


def _legend(ax: Axes, columns: int) -> None:
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1, columnspacing=1.2)


def pv_autocorrelation(ax: Axes, found: Detection) -> None:
    """Draw PV's autocorrelation against the lag, with the zero crossings that give the period, and the period."""
    record, cycle = found.record, found.cycle
    acf = autocorrelation(record.pv[slice(*found.stretch)])
    crossings = zero_crossings(acf)[0]
    cyclic = math.isfinite(cycle.period)
    reach = max(acf.size // 2, 2)
    if cyclic:
        reach = min(reach, math.ceil(BEYOND_LAST * float(crossings[-1])) + 1)
    unit, name = time_axis(reach * record.sample_time)
    scale = record.sample_time / unit
    lags = np.arange(reach, dtype=np.float64) * scale
    x, y = thin(lags, acf[:reach])
    ax.axhline(0.0, color="#888888", linewidth=0.6)
    ax.plot(x, y, label="autocorrelation of PV", **PV)
    if cyclic:
        ax.plot(crossings * scale, np.zeros_like(crossings), "o", color="#D55E00", markersize=3, label="zero crossings")
        ax.axvline(cycle.period / unit, label=f"period {duration(cycle.period)}", **{**OP, "color": "#000000"})
    else:
        remark(ax, "fewer than four zero crossings in half the lags: no period")
    ax.set_ylabel("autocorrelation")
    ax.set_xlabel(f"lag ({name})")
    ax.margins(x=0.01)
    _legend(ax, 3)


def bicoherence_map(ax: Axes, found: Detection) -> None:
    """Draw where the squared bicoherence of SP - PV exceeds what chance shows, over both frequencies."""
    bic, per_hour = found.bicoherence, 3600.0 / found.record.sample_time
    ax.set_xlabel("frequency f₁ (cycles per hour)")
    ax.set_ylabel("f₂ (cycles per hour)")
    ax.grid(visible=False)
    if bic is None:
        ax.set_xticks([])
        ax.set_yticks([])
        why = next((one.says for one in found.statistics if one.name == NONLINEARITY), NOT_ASKED)
        remark(ax, "not asked for: detect(record, bicoherence=True)" if NOT_ASKED in why else why)
        return
    x, y = bic.frequency_1 * per_hour, bic.frequency_2 * per_hour
    step = float(x.min())  # the frequencies are multiples of the lowest
    top = float((x + y).max())
    edges = [bic.critical, *(edge for edge in (0.25, 0.5, 0.75) if edge > bic.critical), 1.0]
    shades = SHADES[len(SHADES) + 1 - len(edges) :]
    for i, ((low, high), shade) in enumerate(zip(pairwise(edges), shades, strict=True)):
        inside = (bic.values > low) & (bic.values <= high if i < len(shades) - 1 else True)
        if inside.any():
            ax.add_patch(PathPatch(cells(x[inside], y[inside], step), facecolor=shade, edgecolor="none", linewidth=0))
    keys = [Patch(facecolor=c, label=f"{a:.2f} to {b:.2f}") for (a, b), c in zip(pairwise(edges), shades, strict=True)]
    ax.plot([0.0, top, top / 2.0, 0.0], [0.0, 0.0, top / 2.0, 0.0], color="#888888", linewidth=0.6)
    period = found.cycle.period
    if math.isfinite(period):
        ax.axvline(3600.0 / period, color="#000000", linewidth=0.7, linestyle=":")
        at = (3600.0 / period, 0.52 * top)
        ax.annotate("the cycle", at, xytext=(3, 0), textcoords="offset points", fontsize=6.5)
    if not (bic.values > bic.critical).any():
        remark(ax, "no pair of frequencies above chance")
    ax.set_xlim(-0.02 * top, 1.02 * top)
    ax.set_ylim(-0.02 * top, 0.56 * top)
    ax.legend(
        handles=keys,
        title=f"squared bicoherence; NGI {given(bic.ngi, 3)}, NLI {given(bic.nli, 3)}",
        title_fontsize=7,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(keys),
        borderaxespad=0.1,
        columnspacing=1.2,
    )


def cells(x: FloatArray, y: FloatArray, step: float) -> Path:
    """Return squares about grid points as one path, those beside each other in a row as one rectangle."""
    columns, rows = np.round(x / step).astype(int), np.round(y / step).astype(int)
    order = np.lexsort((columns, rows))
    columns, rows = columns[order], rows[order]
    begins = np.concatenate(([True], (np.diff(rows) != 0) | (np.diff(columns) != 1)))
    ends = np.concatenate((begins[1:], [True]))
    left, right = (columns[begins] - 0.5) * step, (columns[ends] + 0.5) * step
    low, high = (rows[begins] - 0.5) * step, (rows[begins] + 0.5) * step
    corners = np.stack([left, low, right, low, right, high, left, high, left, low], axis=1).reshape(-1, 2)
    codes = np.tile([Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY], left.size)
    return Path(corners, codes)


def apparent_stiction(ax: Axes, found: Detection) -> None:
    """Draw PV against OP with the ellipse fitted to the cycle, and its width along OP, the apparent stiction."""
    record, ellipse, part = found.record, found.ellipse, slice(*found.stretch)
    x, y = phase(record.op[part], record.pv[part])
    ax.plot(x, y, **{**PV, "linewidth": 0.6, "alpha": 0.55})
    ax.set_xlabel("OP (%)")
    ax.set_ylabel("PV (EU)")
    if ellipse is None:
        return
    vuu, vuy, vyy = ellipse.covariance
    spread, axes = np.linalg.eigh([[vuu, vuy], [vuy, vyy]])
    angle = np.linspace(0.0, 2.0 * math.pi, POINTS)
    # x' C^-1 x = 2, as the cycle's covariance C gives it.
    ring = axes @ (np.sqrt(2.0 * np.maximum(spread, 0.0))[:, None] * np.vstack([np.cos(angle), np.sin(angle)]))
    ax.plot(ellipse.op + ring[0], ellipse.pv + ring[1], color="#D55E00", linewidth=1.3, label="ellipse of the cycle")
    half = 0.5 * ellipse.apparent_stiction
    bar: Style = {**VALVE, "color": "#000000", "marker": "|", "markersize": 6}
    width = f"width {figure(ellipse.apparent_stiction, 3)} %"
    ax.plot([ellipse.op - half, ellipse.op + half], [ellipse.pv] * 2, label=width, **bar)
    _legend(ax, 1)
