"""The page's pictures, in the report's colours: trends, phase plots, overlays, estimate, loci and map.

Each figure draws from sources of columns that the session fills; nothing is computed here but what is seen of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import (
    ColorBar,
    ColumnDataSource,
    CrosshairTool,
    DataRange1d,
    HoverTool,
    Line,
    LogColorMapper,
    LogTicker,
    Range1d,
    Scatter,
    Span,
    Text,
)

from workbench.model.analyses import DescribingFunction
from workbench.model.cycle_map import OUTCOMES
from workbench.model.record import FloatArray
from workbench.report import palette as style
from workbench.report.palette import GROWS, SHADES
from workbench.report.thinned import but_for_kicks, seen, time_axis
from workbench.ui.draw import (
    FONT,
    curve,
    edges,
    label_sides,
    labels,
    line_look,
    new_figure,
    plain_ticks,
    positive,
    step,
)
from workbench.ui.state import MOST_CASES, CaseRun
from workbench.ui.trend import WHOLE, Axis, Trend, loop_line
from workbench.ui.work import Found, FrontFound, MapFound, ReadRecord

__all__ = ["LEGENDS", "MAP_FIGURES", "Pictures"]

BESIDE = {"text_align": "align", "x_offset": "beside", "y_offset": "rise"}  # see `label_sides`
TEXT = {"text_font": value(FONT), "text_font_size": "12px"}
NO_SIGNAL = np.array([])
EMPTY = {"x": NO_SIGNAL, "y": NO_SIGNAL}
OWN = {"line_color": "#9aa5b1", "line_width": 4.0}  # the page's own run beside the pinned ones
TRADE = [("travel", "@x %"), ("mean square error", "@y EU²")]
WILD = 1e6  # EU: a diverging case would flatten the others
MAP_FIGURES = {
    "period": "late period, s",
    "pv_peak_to_peak": "PV peak to peak, EU",
    "mean_square_error": "mean square error in the cycle, EU²",
    "travel_per_hour": "valve travel an hour, %",
}


# What is drawn in which figure, for the page's own legends: a browser draws those once, not with every picture.
LEGENDS: dict[str, tuple[tuple[str, style.Style], ...]] = {
    "pv": (("PV", style.PV), ("SP", style.SP)),
    "pv2": (("PV", style.PV), ("SP", style.SP)),
    "op": (("OP", style.OP), ("stem", style.VALVE)),
    "e_pv": (("PV", style.PV), ("SP", style.SP), ("model", style.PREDICTION), ("without stiction", style.LINEAR)),
    "e_op": (("OP", style.OP), ("estimated stem", style.VALVE)),
    "c_front": (("valve as it is", style.VALVE), ("valve repaired", style.PV)),
    "f_loci": (("L(jω)", style.PV), ("−1/N(A)", style.OP)),
}


class Pictures:
    """All figures of one session, by name, and what fills them."""

    def __init__(self) -> None:
        self.figures: dict[str, Any] = {}
        self.axes: dict[str, Axis] = {}
        self._fine = False
        self._told: dict[str, tuple[float, float]] = {}
        self._loop()
        self._compare()
        self._estimate()
        self._frequency()

    def _add(self, name: str, x: str, y: str, **options: Any) -> Any:
        fig = self.figures[name] = new_figure(name, x, y, **options)
        # The figure below shows the axis that both share; each axis and grid that is not drawn makes a slider quicker.
        fig.xaxis.visible = bool(x)
        fig.xgrid.visible = name not in ("pv", "pv2", "op", "pv_op", "op_stem")
        if isinstance(fig.y_range, Range1d):
            self.axes |= {f"{name}.x": Axis(), f"{name}.y": Axis()}
        return fig

    def moved(self, *, all_of_them: bool, anew: str) -> dict[str, tuple[float, float]]:
        """Return the ends of every axis ("pv.y") that changed since they were last told, and of the figure `anew`."""
        shared = {"op.x": "pv.x", "pv2.x": "pv.x", "op_stem.x": "pv_op.x", "c_stem.x": "c_pv.x", "e_op.x": "e_pv.x"}
        now = {name: axis.ends for name, axis in self.axes.items() if name not in shared}
        told = {} if all_of_them else self._told
        self._told = now
        drawn = {f"{anew}.x", f"{anew}.y"}
        return {name: ends for name, ends in now.items() if told.get(name) != ends or name in drawn}

    # the loop ------------------------------------------------------------------------------------------------------

    def _loop(self) -> None:
        pv = self._add("pv", "", "PV, SP (EU)")
        self.run = Trend(("sp", "pv", "op", "valve", "pv_op", "op_stem"), pv.x_range)
        self.axes["pv.x"] = self.run.axis
        step(pv, self.run.source, "sp_x", "sp_y", **line_look(style.SP, 1.2))
        pv_line = curve(pv, self.run.source, "pv_x", "pv_y", **line_look(style.PV))
        inner = self._add("pv2", "", "secondary's PV, SP (EU)", x_range=pv.x_range)
        self.inner = Trend(("sp2", "pv2"), pv.x_range)  # of its own: only a cascade sends it
        step(inner, self.inner.source, "sp2_x", "sp2_y", **line_look(style.SP, 1.2))
        curve(inner, self.inner.source, "pv2_x", "pv2_y", **line_look(style.PV))
        op = self._add("op", "time (s)", "OP, stem (%)", x_range=pv.x_range)
        op_line = step(op, self.run.source, "op_x", "op_y", **line_look(style.OP, 1.2))
        step(op, self.run.source, "valve_x", "valve_y", **line_look(style.VALVE, 1.7))
        cross = Span(dimension="height", line_color="#aaaaaa", line_width=1)
        for fig in (pv, op):
            fig.add_tools(CrosshairTool(overlay=cross, dimensions="height"))
        for fig, text, unit, line in ((pv, "pv", "EU", pv_line), (op, "op", "%", op_line)):
            rows = [("time", f"@{text}_x"), (text.upper(), f"@{text}_y {unit}")]
            fig.add_tools(HoverTool(renderers=[line], tooltips=rows, mode="vline", line_policy="nearest"))
        pv_op = self._add("pv_op", "", "PV (EU)")
        curve(pv_op, self.run.source, "pv_op_x", "pv_op_y", **line_look(style.PV, 1.1))
        op_stem = self._add("op_stem", "OP (%)", "stem (%)", x_range=pv_op.x_range)
        curve(op_stem, self.run.source, "op_stem_x", "op_stem_y", **line_look(style.VALVE, 1.1))
        glyphs = [renderer.glyph for fig in (pv, inner, op, pv_op, op_stem) for renderer in fig.renderers]
        self._lines = [(g, {"line_width": g.line_width, "line_dash": g.line_dash}) for g in glyphs]

    def _time(self, span: float, name: str) -> float:
        """Return the seconds in the unit that suits a span, after writing it at that figure's time axis."""
        unit, words = time_axis(span)
        axis = self.figures[name].xaxis[0]
        if axis.axis_label != f"time ({words})":
            axis.axis_label = f"time ({words})"
        return unit

    def _fit(self, name: str, signals: Sequence[FloatArray], *, kicks: bool = False) -> None:
        """Fit an axis to signals; kicks: without those that would dwarf what follows."""
        shown = [seen(signal) for signal in signals]
        calm = but_for_kicks(shown) if kicks else None
        self.axes[name].fit(shown if calm is None else [np.array(calm)])

    def _draw_finely(self, fine: bool) -> None:
        """Draw long signals in hairlines without dashes, which cost a browser half as much and show as much."""
        if fine == self._fine:
            return
        self._fine = fine
        for glyph, look in self._lines:
            glyph.update(**(look | {"line_width": 1.0, "line_dash": "solid"} if fine else look))

    def show_run(self, shown: CaseRun) -> None:
        """Draw the page's own run, as far as it stays finite; of a cascade both loops."""
        run, outer = shown.run, shown.outer
        if run is None or outer is None:
            return
        unit = self._time(float(run.time[-1]), "op")
        self._draw_finely(run.time.size > WHOLE)
        against = {"pv_op": loop_line(run.op, run.pv), "op_stem": loop_line(run.op, run.valve)}
        self.run.fill(run.time / unit, {"sp": outer.sp, "pv": outer.pv, "op": run.op, "valve": run.valve}, against)
        self._fit("pv.y", (outer.sp, outer.pv))
        self._name(self.figures["pv"], "PV, SP (EU)", cascade=outer is not run)
        self._name(self.figures["pv_op"], "PV (EU)", cascade=outer is not run, own="secondary's ")
        if outer is not run:
            self.inner.fill(run.time / unit, {"sp2": run.sp, "pv2": run.pv})
            self._fit("pv2.y", (run.sp, run.pv))
        self._fit("op.y", (run.op, run.valve), kicks=True)
        self._fit("pv_op.x", (run.op,))
        self._fit("pv_op.y", (run.pv,))
        self._fit("op_stem.y", (run.valve,))

    @staticmethod
    def _name(fig: Any, words: str, *, cascade: bool, own: str = "primary's ") -> None:
        """Write what a figure's upright axis is; of a cascade whose it is, too."""
        words = own + words if cascade else words
        if fig.yaxis[0].axis_label != words:
            fig.yaxis[0].axis_label = words

    # comparing -----------------------------------------------------------------------------------------------------

    def _compare(self) -> None:
        pv = self._add("c_pv", "", "PV (EU)")
        stem = self._add("c_stem", "time (s)", "stem (%)", x_range=pv.x_range)
        places = (MOST_CASES, *range(MOST_CASES))  # the page's own lies under the others
        self.cases = Trend([f"{what}{i}" for i in places for what in ("pv", "valve")], pv.x_range)
        self.axes["c_pv.x"] = self.cases.axis
        for i in places:
            look = OWN if i == MOST_CASES else line_look(style.case_style(i), 1.4)
            curve(pv, self.cases.source, f"pv{i}_x", f"pv{i}_y", **look)
            step(stem, self.cases.source, f"valve{i}_x", f"valve{i}_y", **look)
        self.trade, _ = self._plane("c_trade", "valve travel (%)")
        self.front, lines = self._plane("c_front", "mean valve travel in a draw (%)")
        self.fronts = tuple(ColumnDataSource(EMPTY) for _ in range(2))
        for source, look in zip(self.fronts, (style.VALVE, style.PV), strict=True):
            line = lines.add_glyph(source, Line(x="x", y="y", **line_look(look, 1.6)))
            lines.add_glyph(source, Scatter(x="x", y="y", size=5, fill_color=look["color"], line_color=look["color"]))
            lines.add_tools(HoverTool(renderers=[line], tooltips=TRADE))

    def _plane(self, name: str, across: str) -> tuple[ColumnDataSource, Any]:
        """Add a figure of mean square error against valve travel, in logarithms, with named points."""
        fig = self._add(
            name,
            across,
            "mean square error (EU²)",
            x_axis_type="log",
            y_axis_type="linear" if name == "c_trade" else "log",
            x_range=DataRange1d(range_padding=0.6),
            y_range=DataRange1d(range_padding=0.2),
        )
        fig.yaxis.formatter = fig.xaxis.formatter = plain_ticks()
        for axis in fig.xaxis if name == "c_trade" else fig.axis:
            axis.ticker = LogTicker(mantissas=[1, 2, 5])
        source = ColumnDataSource({"x": [], "y": [], "color": [], "name": [], "align": [], "beside": [], "rise": []})
        dots = fig.add_glyph(source, Scatter(x="x", y="y", size=11, fill_color="color", line_color="white"))
        fig.add_glyph(source, Text(x="x", y="y", text="name", **BESIDE, **TEXT))
        fig.add_tools(HoverTool(renderers=[dots], tooltips=TRADE))
        return source, fig

    def show_front(self, found: FrontFound) -> None:
        """Draw both fronts and the cases, but for what logarithms do not hold."""
        for source, points in zip(self.fronts, (found.sticky, found.repaired), strict=True):
            pairs = [
                (p.valve_travel, p.mean_square_error) for p in points if positive(p.valve_travel, p.mean_square_error)
            ]
            source.data = {"x": np.array([x for x, _ in pairs]), "y": np.array([y for _, y in pairs])}
        placed = [(i, one) for i, one in enumerate(found.cases) if positive(one[1], one[2])]
        names = labels([one[0] for _, one in placed], [one[1:] for _, one in placed])
        self.front.data = {
            "x": [one[1] for _, one in placed],
            "y": [one[2] for _, one in placed],
            "color": [OWN["line_color"] if i == 0 else style.case_style(i - 1)["color"] for i, _ in placed],
            "name": names,
            **label_sides([one[1] for _, one in placed], [math.log(one[2]) for _, one in placed], names),
        }

    def show_cases(self, runs: Sequence[CaseRun], own: CaseRun | None) -> None:
        """Draw the pinned cases and the page's own over each other, and all in the plane of error and travel."""
        placed = [*enumerate(runs[:MOST_CASES]), *([(MOST_CASES, own)] if own is not None else [])]
        points: dict[str, list[Any]] = {"x": [], "y": [], "color": [], "name": []}
        signals: dict[str, FloatArray] = {}
        time = NO_SIGNAL
        for place, one in placed:
            if one.run is None or one.outer is None:
                continue
            time = one.run.time
            signals |= {f"pv{place}": one.outer.pv, f"valve{place}": one.run.valve}
            travel, error = one.run.kpis.valve_travel, one.outer.kpis.mean_square_error
            if math.isfinite(error) and travel > 0.0:
                points["x"].append(travel)
                points["y"].append(error)
                points["color"].append(OWN["line_color"] if place == MOST_CASES else style.case_style(place)["color"])
                points["name"].append(one.name)
        unit = self._time(float(time[-1]) if time.size else 0.0, "c_stem")
        self.cases.fill(time / unit, signals)
        calm = [name[2:] for name in signals if name[:2] == "pv" and float(np.nanmax(np.abs(signals[name]))) < WILD]
        self._fit("c_pv.y", [signals[f"pv{place}"] for place in calm])
        self._fit("c_stem.y", [signals[f"valve{place}"] for place in calm], kicks=True)
        self._name(self.figures["c_pv"], "PV (EU)", cascade=any(one.primary is not None for _, one in placed))
        points["name"] = labels(points["name"], [*zip(points["x"], points["y"], strict=True)])
        self.trade.data = points | label_sides(points["x"], points["y"], points["name"])

    # estimate ------------------------------------------------------------------------------------------------------

    def _estimate(self) -> None:
        pv = self._add("e_pv", "", "PV (EU)")
        self.record = Trend(("sp", "pv", "prediction", "linear", "op", "stem"), pv.x_range)
        self.axes["e_pv.x"] = self.record.axis
        source = self.record.source
        step(pv, source, "sp_x", "sp_y", **line_look(style.SP, 1.1))
        curve(pv, source, "pv_x", "pv_y", **line_look(style.PV))
        curve(pv, source, "prediction_x", "prediction_y", **line_look(style.PREDICTION, 1.3))
        curve(pv, source, "linear_x", "linear_y", **line_look(style.LINEAR, 1.1))
        op = self._add("e_op", "time (s)", "OP, stem (%)", x_range=pv.x_range)
        step(op, source, "op_x", "op_y", **line_look(style.OP, 1.2))
        step(op, source, "stem_x", "stem_y", **line_look(style.VALVE, 1.6))
        profile = self._add(
            "e_profile",
            "stiction d (%)",
            "variance of the innovations (EU²)",
            y_axis_type="log",
            x_range=DataRange1d(),
            y_range=DataRange1d(),
        )
        profile.yaxis.formatter = plain_ticks()
        self.profile = ColumnDataSource(EMPTY)
        step(profile, self.profile, "x", "y", **line_look(style.PV, 1.3))

    def show_record(self, found: Found | None, record: ReadRecord) -> None:
        """Draw a record, and what was estimated from it, if it was."""
        unit = self._time(float(record.time[-1] - record.time[0]), "e_op")
        signals = {"pv": record.pv, "op": record.op} | ({} if record.sp is None else {"sp": record.sp})
        if found is not None:
            signals |= {"stem": found.stem, "prediction": found.prediction, "linear": found.linear}
        self.record.fill(record.time / unit, signals)
        self._fit("e_pv.y", [signals[name] for name in ("pv", "sp", "prediction") if name in signals])
        self._fit("e_op.y", [signals[name] for name in ("op", "stem") if name in signals])
        if found is None or found.profile_d.size < 2:
            self.profile.data = dict(EMPTY)
        else:
            self.profile.data = {"x": found.profile_d, "y": np.maximum(found.profile_cost, 1e-300)}

    def show_no_record(self) -> None:
        """Draw neither record nor estimate."""
        self.record.fill(NO_SIGNAL, {})
        self.profile.data = dict(EMPTY)

    # frequency -----------------------------------------------------------------------------------------------------

    def _frequency(self) -> None:
        loci = self._add(
            "f_loci",
            "real part",
            "imaginary part",
        )
        self.L = ColumnDataSource({"x": NO_SIGNAL, "y": NO_SIGNAL})
        self.locus = ColumnDataSource({"x": NO_SIGNAL, "y": NO_SIGNAL})
        self.crossings = ColumnDataSource({"x": [], "y": [], "fill": [], "tip": []})
        for dimension in ("width", "height"):
            loci.add_layout(Span(location=0, dimension=dimension, line_color="#bbbbbb", line_width=1))
        curve(loci, self.L, "x", "y", **line_look(style.PV, 1.8))
        curve(loci, self.locus, "x", "y", **line_look(style.OP, 1.6))
        dots = loci.scatter(
            "x", "y", source=self.crossings, size=10, fill_color="fill", line_color="#000000", line_width=1.4
        )
        loci.scatter([-1], [0], marker="cross", size=9, line_color="#000000")
        loci.add_tools(HoverTool(renderers=[dots], tooltips=[("cycle", "@tip")]))
        plane = self._add(
            "f_map",
            "Kc (%/EU)",
            "Ti (s)",
            x_axis_type="log",
            y_axis_type="log",
            x_range=Range1d(0.1, 10.0),
            y_range=Range1d(1.0, 100.0),
        )
        plane.xaxis.formatter = plane.yaxis.formatter = plain_ticks()
        plane.xaxis.ticker = plane.yaxis.ticker = LogTicker(mantissas=[1, 2, 5])
        plane.grid.grid_line_color = None
        names = ("left", "right", "bottom", "top", "shade", "value", "outcome")
        self.map = ColumnDataSource({name: [] for name in names})
        self.mapper = LogColorMapper(palette=list(SHADES), low=1.0, high=10.0, nan_color=GROWS)
        self.cells = plane.quad(
            "left",
            "right",
            "bottom",
            "top",
            source=self.map,
            line_color=None,
            fill_color={"field": "shade", "transform": self.mapper},
        )
        ticks = {"ticker": LogTicker(mantissas=[1, 2, 5]), "formatter": plain_ticks()}
        plane.add_layout(ColorBar(color_mapper=self.mapper, width=12, padding=4, **ticks), "right")
        self.here = ColumnDataSource({"x": [], "y": [], "name": [], "align": [], "beside": [], "rise": []})
        ring = {"fill_color": "white", "fill_alpha": 0.6, "line_color": "#000000"}
        plane.add_glyph(self.here, Scatter(x="x", y="y", marker="circle_cross", size=13, **ring))
        ground = {"background_fill_color": "white", "background_fill_alpha": 0.7}  # names stand on dark cells too
        plane.add_glyph(self.here, Text(x="x", y="y", text="name", **BESIDE, **TEXT, **ground))
        tips = [("Kc", "$x"), ("Ti", "$y s"), ("long run", "@outcome"), ("figure", "@value")]
        plane.add_tools(HoverTool(renderers=[self.cells], tooltips=tips))

    def show_loci(self, found: DescribingFunction | None) -> None:
        """Draw L(jw) and -1/N(A) around the origin and the crossings: full dots are stable cycles, hollow ones not.

        None: the method says nothing of the loop, and nothing is drawn.
        """
        if found is None:
            self.L.data, self.locus.data = dict(EMPTY), dict(EMPTY)
            self.crossings.data = {"x": [], "y": [], "fill": [], "tip": []}
            return
        breaks = [b for b in found.breaks if b > 0]
        locus = np.insert(found.locus, breaks, complex(math.nan, math.nan)) if breaks else found.locus
        self.L.data = {"x": found.L.real.copy(), "y": found.L.imag.copy()}
        self.locus.data = {"x": locus.real.copy(), "y": locus.imag.copy()}
        at = [
            complex(
                np.interp(c.frequency, found.frequencies, found.L.real),
                np.interp(c.frequency, found.frequencies, found.L.imag),
            )
            for c in found.crossings
        ]
        self.crossings.data = {
            "x": [p.real for p in at],
            "y": [p.imag for p in at],
            "fill": ["#000000" if c.stable else "#ffffff" for c in found.crossings],
            "tip": [
                f"{'stable' if c.stable else 'unstable'}, period {c.period:.3g} s, OP amplitude {c.amplitude:.3g} %"
                for c in found.crossings
            ],
        }
        reach = max([2.0, *(1.6 * abs(p) for p in at), 1.3 * float(np.abs(found.locus[found.breaks[0]]))])
        reach = min(reach, 20.0)
        for name in ("f_loci.x", "f_loci.y"):
            self.axes[name].ends = (-reach, 0.4 * reach)

    def show_map(self, found: MapFound, name: str) -> None:
        """Draw one figure of a map in colour, even in its logarithm; grey where an ideal valve's loop is unstable."""
        across, up = edges(found.Kc), edges(found.values)
        rows, columns = found.outcome.shape
        values, unit = found.figures[name], MAP_FIGURES[name].rpartition(" ")[2]
        usable = (found.stable > 0.5) & np.isfinite(values) & (values > 0.0)
        shade = np.where(usable, values, math.nan)
        self.map.data = {
            "left": np.tile(across[:-1], rows),
            "right": np.tile(across[1:], rows),
            "bottom": np.repeat(up[:-1], columns),
            "top": np.repeat(up[1:], columns),
            "shade": shade.ravel(),
            "value": [f"{v:.3g} {unit}" if ok else "–" for v, ok in zip(values.ravel(), usable.ravel(), strict=True)],
            "outcome": [
                OUTCOMES[int(code)] if steady else "unstable even with an ideal valve"
                for code, steady in zip(found.outcome.ravel(), found.stable.ravel() > 0.5, strict=True)
            ],
        }
        if usable.any():
            low, high = float(np.nanmin(shade)), float(np.nanmax(shade))
            self.mapper.update(low=low, high=max(high, 1.001 * low))
        self.axes["f_map.x"].ends = float(across[0]), float(across[-1])
        self.axes["f_map.y"].ends = float(up[0]), float(up[-1])

    def mark(self, tunings: Sequence[tuple[str, float, float]]) -> None:
        """Mark tunings (name, Kc in %/EU, Ti in s) on the map."""
        inside = [one for one in tunings if one[1] > 0.0 and math.isfinite(one[2])]
        names = labels([t[0] for t in inside], [t[1:] for t in inside])
        across, up = [t[1] for t in inside], [t[2] for t in inside]
        sides = label_sides(across, [math.log(value) for value in up], names)
        self.here.data = {"x": across, "y": up, "name": names, **sides}
