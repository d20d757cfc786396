"""Whether a tuning holds its loop without the valve's stiction, over all that its plant may be."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import workbench as wb
from workbench.analyze.standing import standing
from workbench.model.results import Intervals

LOOP = wb.Loop(wb.FOPDT(0.64, 5.9, 2.3), wb.Choudhury(2.2, 0.9), wb.PID(2.8, 9.5), 1.0)
RANGES = Intervals(gain=(0.37, 2.27), time_constant=(4.7, 10.4), dead_time=(0.9, 2.4))


def test_a_tuning_is_tried_at_the_ends_of_its_plants_ranges():
    found = standing(LOOP, RANGES)
    assert found.own.stable
    assert found.own.max_sensitivity == wb.margins(LOOP).max_sensitivity
    # One parameter that is enough by itself is named alone.
    assert not found.worst.stable
    assert found.worst.loop.plant == replace(LOOP.plant, gain=2.27)
    calm = standing(LOOP.with_controller(wb.PID(0.3, 9.5)), RANGES)
    corners = [
        wb.margins(replace(LOOP, plant=wb.FOPDT(K, tau, theta), controller=wb.PID(0.3, 9.5))).max_sensitivity
        for K in RANGES.gain
        for tau in RANGES.time_constant
        for theta in RANGES.dead_time
    ]
    assert calm.worst.max_sensitivity == pytest.approx(max(corners), rel=1e-6)


def test_open_ends_and_given_plants_have_no_corner():
    assert standing(LOOP).worst is None
    opened = Intervals(gain=(0.0, math.inf), time_constant=(0.0, math.inf), dead_time=None)
    worst = standing(LOOP, opened).worst
    assert worst.loop.plant == replace(LOOP.plant, time_constant=1e-3)
    assert standing(LOOP.with_controller(wb.PID(0.0, 20.0))) is None


def test_a_loop_that_only_its_valve_holds_is_seen():
    fast = wb.Loop(wb.FOPDT(16.7, 5.0, 49.6), wb.Deadband(3.5), wb.PID(0.092, 98.8), 60.0)
    assert not standing(fast).own.stable
    rising = standing(wb.Loop(wb.Integrating(-0.1, 2.0), wb.Stenman(1.0), wb.PID(1.0, 60.0, action="direct"), 1.0))
    assert rising.own.stable
