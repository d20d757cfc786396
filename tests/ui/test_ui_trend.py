"""What the browser gets of a signal: enough for its picture, more where it looks closer, round axes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bokeh.models import Range1d
from hypothesis import given
from hypothesis import strategies as st

from workbench.report.thinned import COLUMNS
from workbench.ui.trend import WHOLE, Axis, Trend, columns, loop_line


def finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def test_a_short_signal_is_sent_whole():
    trend = Trend(["a", "b"], Range1d(start=0, end=1))
    time, signal = np.arange(500.0), np.sin(np.arange(500.0))
    trend.fill(time, {"a": signal})
    assert np.array_equal(trend.source.data["a_y"], signal.astype(np.float32))
    assert np.array_equal(trend.source.data["a_x"], time.astype(np.float32))
    assert np.isnan(trend.source.data["b_y"]).all()
    assert trend.axis.ends == (0.0, 499.0)


def test_a_long_signal_keeps_its_extremes_and_a_closer_look_every_sample():
    time = Range1d(start=0.0, end=1.0)
    trend = Trend(["a"], time)
    n = 20 * WHOLE
    signal = np.random.default_rng(0).normal(size=n)
    signal[12345] = 50.0
    trend.fill(np.arange(float(n)), {"a": signal})
    seen = trend.source.data
    assert finite(seen["a_x"]).size < n / 10
    assert finite(seen["a_y"]).max() == 50.0
    time.update(start=12000.0, end=12600.0)
    seen = trend.source.data
    inside = (seen["a_x"] >= 12000.0) & (seen["a_x"] <= 12600.0)
    assert np.array_equal(seen["a_y"][inside], signal[12000:12601].astype(np.float32))
    assert np.isfinite(seen["a_x"]).sum() < 3 * 4 * COLUMNS
    assert (np.diff(finite(seen["a_x"])) > 0).all()
    # Filled anew, it stays with what is looked at.
    trend.fill(np.arange(float(n)), {"a": -signal})
    inside = (trend.source.data["a_x"] >= 12000.0) & (trend.source.data["a_x"] <= 12600.0)
    assert inside.sum() == 601


def test_a_signal_that_leaves_every_plant_is_a_gap():
    trend = Trend(["a"], Range1d(start=0, end=1))
    signal = np.array([1.0, 2.0, 1e300, math.inf, math.nan])
    trend.fill(np.arange(5.0), {"a": signal})
    assert np.isfinite(trend.source.data["a_y"]).tolist() == [True, True, False, False, False]


def test_lines_of_any_lengths_make_one_source():
    made = columns({"a": (np.arange(3.0), np.ones(3)), "b": (np.arange(5.0), np.zeros(5)), "c": (np.array([]),) * 2})
    assert {values.size for values in made.values()} == {5}
    assert np.isfinite(made["a_x"]).sum() == 3
    assert not np.isfinite(made["c_y"]).any()
    assert loop_line(np.arange(10.0), np.ones(10))[0].size == 10
    angle = np.linspace(0, 400, 50 * WHOLE)
    assert loop_line(np.cos(angle), np.sin(angle))[0].size < 3 * WHOLE


@given(low=st.floats(-1e6, 1e6), span=st.floats(1e-3, 1e6))
def test_axes_hold_the_signal_in_round_steps(low, span):
    axis = Axis()
    axis.fit([np.array([low, low + span])])
    start, end = axis.ends
    assert start < low
    assert end > low + span
    assert end - start < 1.7 * span + 1e-9 * abs(low)


def test_axes_rest_while_the_signal_moves_a_little_and_stay_without_one():
    axis = Axis()
    axis.fit([np.array([0.0, 4.13])])
    before = axis.ends
    axis.fit([np.array([0.0, 4.17])])
    assert axis.ends == before
    axis.fit([np.array([math.nan]), np.array([])])
    assert axis.ends == before
    axis.fit([np.array([3.0, 3.0])])
    assert axis.ends[0] < 3.0 < axis.ends[1]
    assert axis.ends[1] - axis.ends[0] == pytest.approx(0.6, abs=0.5)
