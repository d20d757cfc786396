"""Names beside points: they fit in the picture and do not stand on each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from bokeh.models import NoOverlap
from hypothesis import given
from hypothesis import strategies as st

from workbench.ui.draw import PLANE, ROW, edges, label_sides, labels, new_figure


def test_an_axis_leaves_out_numbers_that_would_stand_on_others():
    fig = new_figure("c_trade", "valve travel (%)", "mean square error (EU²)", x_axis_type="log")
    assert [type(axis.major_label_policy) for axis in fig.axis] == [NoOverlap, NoOverlap]


def test_names_stand_inward():
    found = label_sides([1.0, 100.0, 20.0], [0.0, 1.0, 0.5], ["a", "b", "c"])
    assert found["align"] == ["left", "right", "right"]
    assert found["beside"] == [9, -9, -9]
    assert found["rise"] == [4.0, 4.0, 4.0]
    assert label_sides([], [], []) == {"align": [], "beside": [], "rise": []}


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=13))
def test_no_name_stands_on_another(up):
    found = label_sides([1.0] * len(up), up, ["name"] * len(up))
    low, high = min(up), max(up)
    heights = [PLANE * (at - low) / (high - low) if high > low else 0.0 for at in up]
    places = sorted(height - rise for height, rise in zip(heights, found["rise"], strict=True))
    assert all(b - a > ROW - 1e-6 for a, b in pairwise(places))


def test_a_point_without_a_name_takes_no_place():
    assert label_sides([1.0, 1.0, 1.0], [2.0, 2.0, 1.0], ["a, b", "", "c"])["rise"] == [4.0, 4.0, 4.0]


def test_names_of_one_place_stand_together():
    assert labels(["a", "b", "c"], [(1.0, 2.0), (1.0, 3.0), (1.0, 2.0)]) == ["a, c", "b", ""]


def test_cells_meet_halfway_in_their_ratio():
    assert edges(np.array([1.0, 4.0, 16.0])).tolist() == [0.5, 2.0, 8.0, 32.0]
