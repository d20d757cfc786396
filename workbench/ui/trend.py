"""Signals against time as the browser gets them: what a screen can show of them, and of a closer look all there is.

A browser draws twenty thousand samples of several signals too slowly for a slider. So each signal is thinned, by the
report's own law, to the extremes of each pixel column; zooming in asks for the samples of the stretch looked at.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d

from workbench.model.record import FloatArray
from workbench.report.thinned import COLUMNS, phase, seen, thin

__all__ = ["WHOLE", "Axis", "Trend", "columns", "loop_line"]

WHOLE = 4 * COLUMNS  # samples that are drawn as they are
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
PAD = 0.03
NOTHING = np.array([]), np.array([])


def columns(lines: Mapping[str, tuple[FloatArray, FloatArray]]) -> dict[str, Any]:
    """Return lines of any lengths as the columns `name_x` and `name_y` of one source, filled up with nan.

    One source is one message for all; in half the bits, which are far more than a screen shows.
    """
    longest = max((x.size for x, _ in lines.values()), default=0)
    out: dict[str, Any] = {}
    for name, pair in lines.items():
        for axis, values in zip("xy", pair, strict=True):
            column = np.full(longest, np.nan, np.float32)
            column[: values.size] = values
            out[f"{name}_{axis}"] = column
    return out


class Axis:
    """A range that fits its signals in round numbers, so that it rests while they move a little.

    The browser takes the ends from the session's answers, unless its user has zoomed.
    """

    def __init__(self) -> None:
        self.ends = (0.0, 1.0)

    def fit(self, signals: Iterable[FloatArray], *, round_ends: bool = True) -> None:
        """Hold the finite values of signals."""
        ends = [(np.nanmin(s), np.nanmax(s)) for s in signals if s.size and not np.isnan(s).all()]
        if not ends:
            return
        low, high = float(min(e[0] for e in ends)), float(max(e[1] for e in ends))
        if round_ends:
            low, high = _rounded(low, high)
        self.ends = low, high if high > low else low + 1.0


def _rounded(low: float, high: float) -> tuple[float, float]:
    """Return ends in whole steps of which some ten make the range."""
    span = high - low or abs(low) or 1.0
    low, high = low - PAD * span, high + PAD * span
    size = 10.0 ** math.floor(math.log10(span / 10.0))
    step = next(size * s for s in STEPS if size * s >= 0.999 * span / 10.0)
    return math.floor(low / step) * step, math.ceil(high / step) * step


class Trend:
    """Signals of one or two figures that share their time axis, in one source (see `columns`)."""

    def __init__(self, names: Iterable[str], time: Range1d) -> None:
        self.names = tuple(names)
        self.source = ColumnDataSource(columns(dict.fromkeys(self.names, NOTHING)))
        self.axis = Axis()
        self._range = time
        self._zoomed = False
        self._time = np.array([])
        self._signals: dict[str, FloatArray] = {}
        self._beside: dict[str, tuple[FloatArray, FloatArray]] = {}
        # The range changes here only where the browser's user zooms or resets.
        for end in ("start", "end"):
            time.on_change(end, lambda _attr, _old, _new: self._looked())

    def fill(
        self,
        time: FloatArray,
        signals: Mapping[str, FloatArray],
        beside: Mapping[str, tuple[FloatArray, FloatArray]] | None = None,
    ) -> None:
        """Draw signals, shape (N,), over a time axis in the unit that is shown; beside: lines that are no trends."""
        self._time, self._signals = time, {name: seen(signal) for name, signal in signals.items()}
        self._beside = dict(beside or {})
        self.axis.fit([time[[0, -1]]] if time.size else [], round_ends=False)
        self._draw()

    def _looked(self) -> None:
        """Draw the stretch that the user has zoomed to, if it is not all drawn already."""
        self._zoomed = True
        if self._time.size > WHOLE:
            self._draw()

    def _draw(self) -> None:
        parts = self._stretches()
        lines = dict.fromkeys(self.names, NOTHING)
        for name, signal in self._signals.items():
            drawn = [thin(self._time[part], signal[part]) for part in parts]
            lines[name] = np.concatenate([x for x, _ in drawn]), np.concatenate([y for _, y in drawn])
        self.source.data = columns(lines | self._beside)

    def _stretches(self) -> list[slice]:
        """Return the samples before, in and after what is looked at, each of which is thinned by itself."""
        n = self._time.size
        if n <= WHOLE or not self._zoomed:
            return [slice(0, n)]
        first, stop = np.searchsorted(self._time, (self._range.start, self._range.end))
        first, stop = max(int(first) - 1, 0), min(int(stop) + 1, n)
        return [part for part in (slice(0, first), slice(first, stop), slice(stop, n)) if part.stop > part.start]


def loop_line(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return one signal against another, of long ones each stretch that can be told apart once."""
    x, y = seen(x), seen(y)
    return (x, y) if x.size <= WHOLE else phase(x, y)
