"""What the figures show: their artists hold the data given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from cascades import flow_and_temperature
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import workbench as wb
from workbench.errors import InvalidValue
from workbench.model.record import Record
from workbench.model.results import FittedModel
from workbench.model.study import CaseResult, Study
from workbench.model.valve import Choudhury, Directional, Ideal
from workbench.report import draw, figures
from workbench.report.plot import plot
from workbench.report.style import CASES, case_style, svg_text
from workbench.report.thinned import fills, phase, settled
from workbench.report.words import figure
from workbench.simulate.signature import signature

Make = Callable[..., Any]


def lines(ax: Axes) -> dict[str, tuple[Any, Any]]:
    return {str(line.get_label()): (line.get_xdata(), line.get_ydata()) for line in ax.get_lines()}


def test_trends(study: Study) -> None:
    run = study.cases[0].run
    fig = figures.trend_figure(run)
    above, below = fig.axes
    assert np.array_equal(lines(above)["PV"][1], run.pv)
    assert np.array_equal(lines(above)["SP"][1], run.sp)
    assert np.array_equal(lines(below)["OP"][1], run.op)
    assert np.array_equal(lines(below)["valve"][1], run.valve)
    assert np.array_equal(lines(below)["valve"][0], run.time)
    assert above.get_shared_x_axes().joined(above, below)
    assert (above.get_ylabel(), below.get_ylabel(), below.get_xlabel()) == ("PV, SP (EU)", "OP, valve (%)", "time (s)")


def test_overlay(study: Study) -> None:
    fig = figures.overlay_figure(study.cases)
    above, near, below, near_below = fig.axes  # one of the cases comes to rest early: its first stretch from near
    assert [str(line.get_label()) for line in above.get_lines()] == ["Case 1", "Case 2", "Optimised PI", "SP"]
    assert np.array_equal(above.get_lines()[1].get_ydata(), study.cases[1].run.pv)
    assert np.array_equal(below.get_lines()[2].get_ydata(), study.cases[2].run.valve)
    seen = near.get_lines()[2].get_xdata()
    assert 4.0 <= seen[-1] <= 0.3 * study.cases[2].run.time[-1]
    assert np.array_equal(near_below.get_lines()[2].get_ydata(), study.cases[2].run.valve[: len(seen)])
    assert near.get_title("left") == f"the first {seen[-1]:g} s"
    assert len(figures.overlay_figure(study.cases[:1]).axes) == 2


def test_a_case_that_comes_to_rest_early_is_shown_from_near(study: Study) -> None:
    run = study.cases[2].run
    above, near, below, near_below = figures.trend_figure(run).axes
    assert np.array_equal(lines(above)["PV"][1], run.pv)
    assert np.array_equal(lines(near_below)["valve"][1], run.valve[: near_below.get_lines()[0].get_xdata().size])
    assert below.get_xlabel() == near_below.get_xlabel() == "time (s)"
    assert near.get_legend() is None
    assert settled(run.time, run.pv) < 0.1 * run.time[-1] < settled(run.time, study.cases[0].run.pv)
    assert settled(np.arange(4.0), np.array([0.0, 1.0, np.nan, 1.0])) == np.inf


def test_a_signal_that_moves_by_next_to_no_number_is_drawn() -> None:
    x, y = phase(np.arange(4.0), np.array([0.0, 1e-320, 0.0, 1e-320]))
    assert (x[0], x[-1]) == (0.0, 3.0)
    assert y.max() == 1e-320


def test_a_case_that_swings_fast_is_a_band_under_the_others() -> None:
    time = np.arange(1500.0)
    slow, fast = 4.0 + np.sin(time / 40.0), 4.0 + 2.0 * np.sin(2.0 * np.pi * time / 3.7)
    sp = np.full(1500, 4.0)
    cases = [figures.Curves(n, (time, sp), (time, slow), (time, x)) for n, x in (("Slow", slow), ("Dither", fast))]
    above, below = figures.overlaid(cases, "valve (%)").axes
    assert len(above.get_lines()) == 3
    assert [len(ax.collections) for ax in (above, below)] == [0, 1]
    assert len(below.get_lines()) == 1
    band = below.collections[0]
    assert band.get_zorder() < below.get_lines()[0].get_zorder()
    assert band.get_alpha() < 0.5
    low, high = band.get_paths()[0].get_extents().intervaly
    assert low == pytest.approx(2.0, abs=0.05)
    assert high == pytest.approx(6.0, abs=0.05)
    assert not fills(np.full(300, np.nan), 1.0)
    # Thinned signals, as other runs' files hold them, alike.
    assert len(figures.overlaid([replace(cases[1], below=draw.thin(time, fast, 150))], "").axes[1].collections) == 1


def test_cases_differ_in_colour_and_line_style() -> None:
    assert len({c["color"] for c in CASES}) == len(CASES)
    solid = [c for c in CASES if c["linestyle"] == "-"]
    assert len({str(c["linestyle"]) for c in CASES}) >= len(CASES) - len(solid) + 1
    assert len({str(case_style(i)) for i in range(16)}) == 16
    assert [case_style(i) for i in range(8)] == list(CASES)


def test_an_unstable_case_does_not_hide_the_others(study: Study, case: Make) -> None:
    wild: CaseResult = case("Wild", 50.0, 5.0)
    above, _ = figures.overlay_figure([wild, study.cases[0]]).axes
    assert np.nanmax(np.abs(above.get_lines()[0].get_ydata())) < 1000.0
    assert np.array_equal(above.get_lines()[1].get_ydata(), study.cases[0].run.pv)


def test_frequency(study: Study) -> None:
    named = [(c.name, c.describing_function) for c in study.cases if c.describing_function is not None]
    ax = figures.frequency_figure(named).axes[0]
    drawn = lines(ax)
    assert {"−1/N(A)", "L(jω), Case 1", "L(jω), Optimised PI"} <= set(drawn)
    x, y = drawn["−1/N(A)"]
    assert np.array_equal(x + 1j * y, named[0][1].locus)
    # The crossing of the second stands at its amplitude on the locus, the first's nearest approach is marked.
    dots = [line for line in ax.get_lines() if line.get_marker() == "o"]
    assert dots[0].get_ydata()[0] == pytest.approx(-0.8 / 2.2, rel=1e-3)
    assert sum(line.get_marker() == "x" for line in ax.get_lines()) == 1
    left, right = ax.get_xlim()
    assert left < -1.0 < right


def test_estimates(estimated: Make) -> None:
    found, _ = estimated()
    above, below = figures.estimate_figure(found).axes
    assert np.array_equal(lines(above)["PV"][1], found.record.pv)
    assert np.array_equal(lines(above)["prediction"][1], found.prediction)
    assert np.array_equal(lines(below)["valve (estimated)"][1], found.valve_position)


def test_the_fit_that_ignores_stiction_stands_below_the_right_one_with_both_parameter_sets(estimated: Make) -> None:
    found, _ = estimated()
    above, below = figures.linear_fit_figure(found).axes
    for ax in (above, below):
        assert np.array_equal(lines(ax)["PV"][1], found.record.pv)
    assert np.array_equal(lines(above)["prediction"][1], found.prediction)
    assert np.array_equal(lines(below)["prediction without stiction"][1], found.linear.prediction)
    assert above.get_ylim() == below.get_ylim()
    assert above.get_title("left").startswith("d 2.003 %, gain 1.990 EU/%, time constant 5.030 s, dead time 1.000 s")
    assert below.get_title("left").startswith("gain 1.250 EU/%, time constant 63.00 s, dead time 50.00 s")


def test_no_legend_covers_the_parameters(estimated: Make) -> None:
    found, _ = estimated()
    fig = figures.linear_fit_figure(replace(found, valve=Choudhury(S=2.123, J=1.234), residual_variance=0.3136))
    fig.canvas.draw()
    for ax in fig.axes:
        legend = ax.get_legend()
        assert legend is not None
        assert not legend.get_window_extent().overlaps(ax._left_title.get_window_extent())  # type: ignore[attr-defined]


def test_the_stem_is_drawn_against_op_with_the_measured_one_where_there_is_one(estimated: Make) -> None:
    found, _ = estimated()
    left, right = figures.op_stem_figure(found).axes
    assert set(lines(left)) == {"PV", "prediction"}
    assert set(lines(right)) == {"no friction", "estimated"}
    x, y = lines(right)["estimated"]
    drawn = {(round(a, 9), round(b, 9)) for a, b in zip(x, y, strict=True) if np.isfinite(a)}
    assert drawn <= {(round(a, 9), round(b, 9)) for a, b in zip(found.record.op, found.valve_position, strict=True)}
    measured = replace(found, record=replace(found.record, valve_position=found.record.op + 0.5), valve=Ideal())
    x, y = lines(figures.op_stem_figure(measured).axes[1])["measured"]
    assert np.nanmax(np.abs(y - x - 0.5)) < 1e-12
    assert "estimated" not in lines(figures.op_stem_figure(measured).axes[1])


def test_a_window_of_the_estimate(estimated: Make) -> None:
    found, _ = estimated()
    above, _ = figures.estimate_figure(found, "", (100.0, 150.0)).axes
    assert np.array_equal(lines(above)["PV"][0], np.arange(100.0, 150.0))


def test_profile_shows_the_interval_and_the_estimate(estimated: Make) -> None:
    found, _ = estimated()
    whole, near = figures.profile_figure(found).axes
    shaded = [p.get_x() for p in whole.patches]
    assert shaded == [1.99]
    # The paper's eq. (1), one parameter more than the linear fit has.
    n, linear = len(found.record), found.linear
    shift = linear.aic - n * np.log(linear.residual_variance) + 2.0
    assert lines(whole)["AIC"][1] == pytest.approx(n * np.log(found.profile_cost) + shift)
    assert lines(whole)["linear fit"][1][0] == pytest.approx(linear.aic)
    assert lines(whole)["d = 2.003 %"][1] == [found.aic]
    assert lines(whole)["d = 2.003 %"][0] == [2.003]
    low, high = near.get_xlim()
    assert low < 1.99 < 2.01 < high < 2.5


def test_no_aic_is_drawn_below_what_the_record_resolves(estimated: Make) -> None:
    found, _ = estimated()
    floor = FittedModel(found.valve, found.plant, 1e-20, -1000.0, -990.0, 44)
    clean = replace(
        found, candidates=(floor,), residual_variance=1e-20, aic=-1e5, profile_cost=found.profile_cost - 0.0101
    )
    drawn = lines(figures.profile_figure(clean).axes[0])
    assert drawn["AIC"][1].min() == -1000.0
    assert drawn["d = 2.003 %"][1] == [-1000.0]


def test_convergence(estimated: Make) -> None:
    found, _ = estimated()
    above, below = figures.convergence_figure(found).axes
    assert list(lines(above)["d"][1]) == [1.0, 2.0]
    assert list(lines(below)["residual variance"][1]) == [1.0, 0.01]


@settings(deadline=None, max_examples=50)
@given(st.integers(1, 20000), st.integers(1, 300), st.integers(0, 10))
def test_thinning_keeps_what_shows(n: int, columns: int, seed: int) -> None:
    x = np.arange(float(n))
    y = np.random.default_rng(seed).normal(size=n)
    px, py = draw.thin(x, y, columns)
    assert px.size <= max(4 * columns, 1)
    assert np.all(np.diff(px) > 0.0)
    assert py.min() == y.min()
    assert py.max() == y.max()
    assert (px[0], px[-1]) == (x[0], x[-1])


def test_a_phase_plot_draws_each_stretch_once() -> None:
    turns = np.tile(np.arange(40), 500)
    angle = 2.0 * np.pi * turns / 40.0
    x, y = draw.phase(np.cos(angle), np.sin(angle))
    assert x.size < 60
    assert np.nanmax(x) == 1.0
    assert np.nanmin(y) == pytest.approx(-1.0)


def test_a_phase_plot_of_noise_alone_is_bounded() -> None:
    x, y = np.random.default_rng(0).normal(size=(2, 60000))
    px, py = draw.phase(x, y)
    assert 2000 < np.isfinite(px).sum() <= 5000
    assert np.nanmax(px) > 3.0
    assert np.nanmin(py) < -3.0


def test_no_global_setting_is_left_behind(study: Study) -> None:
    before = dict(mpl.rcParams)
    svg_text(figures.trend_figure(study.cases[0].run), "t")
    plot(study.cases[0].run)
    assert dict(mpl.rcParams) == before


def test_svg_files_are_the_same_to_the_byte(study: Study) -> None:
    first, second = (svg_text(figures.overlay_figure(study.cases), "t", "Case <1> & more") for _ in range(2))
    assert figures.svg_file(first) == figures.svg_file(second)
    assert "Case &lt;1&gt; &amp; more" in first


def test_plot_of_every_result(study: Study) -> None:
    case, named = study.cases[2], study.estimates[0]
    above, below = plot(case.run)
    assert np.array_equal(lines(above)["PV"][1], case.run.pv)
    assert np.array_equal(lines(below)["OP"][1], case.run.op)
    above, below = plot(named.found)
    assert np.array_equal(lines(below)["valve (estimated)"][1], named.found.valve_position)
    above, below = plot(named.found.record)
    assert np.array_equal(lines(above)["SP"][1], named.found.record.sp)
    assert isinstance(plot(case.describing_function), Axes)
    ax = plot(case.limit_cycle)
    assert isinstance(ax, Axes)
    assert [t.get_text() for t in ax.get_yticklabels()] == ["the given experiment", "setpoint step of 1 EU"]
    ax = plot(case.tuned)
    assert isinstance(ax, Axes)
    assert list(lines(ax)["refined"][0]) == [r.refined for r in case.tuned.restarts]


def test_a_tuning_is_drawn_search_by_search_or_by_its_objective_alone(study: Study) -> None:
    tuned = study.cases[2].tuned
    assert tuned is not None
    assert [t.get_text() for t in plot(tuned).get_yticklabels()] == ["search 0", "search 1", "search 2"]
    ax = plot(replace(tuned, restarts=()))
    low, high = ax.get_ylim()
    assert low != high
    assert list(lines(ax)[f"J as typed in, {figure(tuned.objective)}"][0]) == [tuned.objective] * 2


def test_plot_on_given_axes(study: Study) -> None:
    run = study.cases[0].run
    fig = Figure()
    axes = fig.subplots(2, 1)
    assert list(plot(run, axes)) == list(axes)
    single = Figure().subplots()
    assert plot(run, single) is single
    assert "OP" not in lines(single)
    target = Figure().subplots()
    assert plot(study.cases[0].describing_function, target) is target


def test_plot_of_a_cascade_shows_both_loops() -> None:
    run = wb.simulate(flow_and_temperature(), wb.Experiment(100.0, setpoint=wb.Step(5.0)))
    axes = plot(run)
    assert [ax.get_ylabel() for ax in axes] == ["primary (EU)", "secondary (EU)", "OP, valve (%)"]
    own = Figure().subplots(3, 1)
    assert list(plot(run, own)) == list(own)
    with pytest.raises(InvalidValue, match="must be 1 or 3 matplotlib Axes"):
        plot(run, Figure().subplots(2, 1))
    single = Figure().subplots()
    assert plot(run, single) is single
    assert single.get_ylabel() == "primary (EU)"
    assert single.get_xlabel() == "time (s)"


@pytest.mark.parametrize("wrong", [None, 3, "run", [1, 2]])
def test_plot_of_anything_else(wrong: object) -> None:
    with pytest.raises(InvalidValue, match="must be a Run, Record, Estimate"):
        plot(wrong)


def test_plot_on_something_else(study: Study) -> None:
    with pytest.raises(InvalidValue, match="matplotlib Axes"):
        plot(study.cases[0].run, "axes")
    with pytest.raises(InvalidValue, match="must be 1 matplotlib Axes"):
        plot(study.cases[0].limit_cycle, Figure().subplots(2, 1))


def test_a_record_without_setpoint() -> None:
    above, _ = plot(Record(pv=np.arange(5.0), op=np.ones(5), sample_time=2.0))
    assert set(lines(above)) == {"PV"}
    assert list(lines(above)["PV"][0]) == [0.0, 2.0, 4.0, 6.0, 8.0]


def test_plot_draws_a_signature() -> None:
    found = signature(Choudhury(3.0, 1.0))
    ramp, steps = plot(found)
    assert [line.get_label() for line in ramp.get_lines()] == ["no friction", "stem"]
    assert "dead band 3 %" in ramp.texts[0].get_text()
    assert "resolution 0.99 %" in steps.texts[0].get_text()
    np.testing.assert_array_equal(steps.get_lines()[1].get_ydata(), found.steps_op)
    unlike = signature(Directional(Choudhury(4.0, 1.0), Choudhury(3.0, 2.0)))
    single = Figure().subplots()
    assert plot(unlike, single) is single
    assert "3 % up, 4 % down" in single.texts[0].get_text()
