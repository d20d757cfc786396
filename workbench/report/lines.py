"""Small pictures as SVG written by hand: trends of a few hundred bytes each, and the signals of a loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from workbench.model.record import FloatArray
from workbench.report.words import given

__all__ = ["panel", "spark"]

WIDE, TALL = 120, 26  # px of a trend
SPAN, HEIGHT, LEFT, BELOW = 960, 180, 62, 22  # px of a panel
MOST = 700  # points of a line


def _path(xs: Sequence[int], ys: Sequence[int]) -> str:
    """Return the path through whole pixels, each step relative to the one before."""
    steps = [f"M{xs[0]} {ys[0]}l"]
    for x, y, x0, y0 in zip(xs[1:], ys[1:], xs[:-1], ys[:-1], strict=True):
        steps.append(f"{x - x0} {y - y0}")
    return steps[0] + " ".join(steps[1:])


def spark(trend: bytes) -> Markup:
    """Return a trend of bytes, 0 at the foot and 255 at the top, as an `<svg>` element; nothing for fewer than two."""
    if len(trend) < 2:
        return Markup()
    n = len(trend)
    # Drawn at ten times its size, so that whole numbers are fine enough.
    xs = [round(10 * WIDE * i / (n - 1)) for i in range(n)]
    ys = [round(10 * (1 + (TALL - 2) * (1.0 - value / 255.0))) for value in trend]
    return Markup(  # noqa: S704 - numbers alone
        f'<svg class="spark" viewBox="0 0 {10 * WIDE} {10 * TALL}" width="{WIDE}" height="{TALL}" '
        f'aria-hidden="true"><path d="{_path(xs, ys)}"/></svg>'
    )


def panel(hours: FloatArray, signals: Sequence[tuple[str, FloatArray]], title: str) -> Markup:
    """Return signals over time, each (its class for the style sheet, values of shape (N,)), in one scale, as `<svg>`.

    hours: shape (N,). More samples than the width shows are drawn as least and greatest value of each stretch.
    """
    low = min(float(values.min()) for _, values in signals)
    high = max(float(values.max()) for _, values in signals)
    span = high - low or max(abs(high), 1.0) * 1e-3
    drawn = []
    for name, values in signals:
        at, shown = _thin(values)
        xs = [LEFT + round((SPAN - LEFT - 8) * (h - hours[0]) / ((hours[-1] - hours[0]) or 1.0)) for h in hours[at]]
        ys = [8 + round((HEIGHT - BELOW - 16) * (1.0 - (v - low) / span)) for v in shown.tolist()]
        drawn.append(f'<path class="{name}" d="{_path(xs, ys)}"/>')
    foot = HEIGHT - BELOW
    labels = [
        f'<text x="{LEFT - 6}" y="14" class="y">{given(high)}</text>',
        f'<text x="{LEFT - 6}" y="{foot - 6}" class="y">{given(low)}</text>',
        f'<text x="{LEFT}" y="{HEIGHT - 6}">{given(float(hours[0]), 3)} h</text>',
        f'<text x="{SPAN - 8}" y="{HEIGHT - 6}" class="y">{given(float(hours[-1]), 3)} h</text>',
        f'<text x="{LEFT - 6}" y="{foot // 2}" class="y">{title}</text>',
    ]
    frame = f'<rect x="{LEFT}" y="4" width="{SPAN - LEFT - 8}" height="{foot - 8}"/>'
    inside = "".join([frame, *drawn, *labels])
    return Markup(f'<svg class="panel" viewBox="0 0 {SPAN} {HEIGHT}">{inside}</svg>')  # noqa: S704 - our own words


def _thin(values: FloatArray) -> tuple[np.ndarray, FloatArray]:
    if values.size <= MOST:
        return np.arange(values.size), values
    edges = np.linspace(0, values.size, MOST // 2 + 1).astype(int)
    at: list[int] = []
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        ends = sorted({a + int(np.argmin(values[a:b])), a + int(np.argmax(values[a:b]))})
        at += ends
    chosen = np.array(at)
    return chosen, values[chosen]
