"""Fail-open valves and the equal-percentage characteristic: what they are, refuse, and do to simulated loops."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import experiments, independent_simulation, late_cycles, loops, numbers

import workbench as wb
from workbench.simulate.signals import signals

LIMITED = wb.PID(0.5, 20.0, output_limits=(-30.0, 60.0))
curves = st.builds(wb.EqualPercentage, rangeability=numbers(1.5, 100.0), opening=numbers(30.0, 40.0))


def curved(opening: float = 35.0, R: float = 50.0, **parts) -> wb.Loop:
    given_parts = {"plant": wb.FOPDT(1.0, 5.0, 1.0), "valve": wb.Stenman(2.0), "controller": LIMITED, **parts}
    return wb.Loop(**given_parts, sample_time=1.0, characteristic=wb.EqualPercentage(R, opening))


@pytest.mark.parametrize(
    ("make", "where", "allowed"),
    [
        (lambda: wb.EqualPercentage(1.0, 50.0), "EqualPercentage.rangeability", "1"),
        (lambda: wb.EqualPercentage(50.0, 0.0), "EqualPercentage.opening", "0"),
        (lambda: wb.EqualPercentage(50.0, 100.0), "EqualPercentage.opening", "below 100 %"),
        (lambda: curved(controller=wb.PID(0.5, 20.0)), "PID.output_limits", r"\(-35, 65\) %, the travel of a valve"),
        (lambda: curved(opening=20.0), "PID.output_limits", r"\(-20, 80\) %"),
        (lambda: curved(opening=45.0), "PID.output_limits", r"\(-45, 55\) %"),
        (lambda: curved(valve=wb.Choudhury(2.0, 14.0)), "PID.output_limits", r"\(-29, 59\) %"),
        (lambda: wb.Loop(wb.FOPDT(1.0, 5.0), wb.Ideal(), LIMITED, 1.0, characteristic=2.0), "Loop.characteristic", "E"),
        (lambda: wb.Loop(wb.FOPDT(1.0, 5.0), wb.Ideal(), LIMITED, 1.0, fail_open=1), "Loop.fail_open", "True or False"),
    ],
)
def test_what_has_no_meaning_is_refused(make, where, allowed):
    with pytest.raises(wb.InvalidValue, match=allowed) as caught:
        make()
    assert caught.value.where == where


def test_a_fail_open_valve_has_its_travel_the_other_way_round():
    with pytest.raises(wb.InvalidValue, match=r"\(-65, 35\) %"):
        replace(curved(), fail_open=True)
    other = replace(LIMITED, output_limits=(-60.0, 30.0), action="direct")
    assert replace(curved(controller=replace(other, output_limits=(-20.0, 20.0))), fail_open=True).gain == -1.0


@given(loop=loops, experiment=experiments())
def test_a_fail_open_valve_is_a_plant_of_the_other_sign(loop, experiment):
    mirrored = replace(loop, plant=replace(loop.plant, gain=-loop.plant.gain), fail_open=True)
    other_load = tuple(replace(part, size=-part.size) for part in experiment.load_parts)
    ours = wb.simulate(mirrored, replace(experiment, load=other_load or None))
    theirs = wb.simulate(loop, experiment)
    for name in ("pv", "op", "valve", "branch"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    np.testing.assert_array_equal(ours.load, -theirs.load)


@given(loop=loops, curve=curves, fail_open=st.booleans(), experiment=experiments())
def test_the_kernel_equals_the_law_written_independently(loop, curve, fail_open, experiment):
    pid = replace(loop.controller, output_limits=(-20.0, 20.0))
    # Such a jump could leave the travel.
    valve = loop.valve if loop.valve.slip_jump <= loop.valve.stick_band else wb.Ideal()
    loop = replace(loop, valve=valve, controller=pid, characteristic=curve, fail_open=fail_open)
    s = signals(loop, experiment)
    other = independent_simulation(loop, s.r, loop.direction * s.load, s.noise)
    run = wb.simulate(loop, experiment)
    np.testing.assert_array_equal(run.pv, other["pv"])
    np.testing.assert_array_equal(run.op, other["op"])
    np.testing.assert_array_equal(run.valve, other["valve"])


@given(curve=curves, x=numbers(-30.0, 60.0), fail_open=st.booleans())
def test_the_flow_is_the_textbooks_over_its_slope_at_the_operating_point(curve, x, fail_open):
    controller = replace(LIMITED, output_limits=(-30.0, 30.0))
    loop = replace(curved(controller=controller), characteristic=curve, fail_open=fail_open)
    R, h = curve.rangeability, curve.opening
    sign = -1.0 if fail_open else 1.0

    def share(opening):
        return R ** (opening / 100.0 - 1.0)

    slope = share(h) * math.log(R) / 100.0
    assert sign * loop.flow(x) == pytest.approx((share(h + sign * x) - share(h)) / slope, rel=1e-9, abs=1e-9)


def test_a_step_of_the_plant_follows_the_curve():
    pid = wb.PID(1.0, math.inf, output_limits=(-30.0, 60.0))
    loop = curved(plant=wb.FOPDT(1e-9, 5.0), valve=wb.Ideal(), controller=pid)
    run = wb.simulate(loop, wb.Experiment(200.0, setpoint=wb.Step(20.0)))
    assert run.pv[-1] == pytest.approx(1e-9 * (50.0**0.2 - 1.0) / (math.log(50.0) / 100.0))


@pytest.mark.parametrize("valve", [wb.Stenman(2.0), wb.Choudhury(3.0, 1.0)])
def test_the_long_run_equals_plain_simulation(valve):
    loop = curved(valve=valve, plant=wb.FOPDT(1.0, 20.0, 3.0), controller=replace(LIMITED, Kc=0.3, Ti=60.0))
    experiment = wb.Experiment(500_000.0, setpoint=wb.Step(9.3), load=wb.Step(1.0, at=500.0))
    start = wb.limit_cycle(loop, experiment).starts[0]
    run = wb.simulate(loop, experiment)
    assert start.outcome == "cycles"
    assert (start.period, start.pv_peak_to_peak) == pytest.approx(late_cycles(run, 450_000.0), rel=0.03)
    # There a slip moves PV by more than at the operating point.
    straight = wb.limit_cycle(replace(loop, characteristic=None), experiment).starts[0]
    assert start.pv_peak_to_peak > 1.2 * straight.pv_peak_to_peak
    assert "gain at the operating point" in wb.describing_function(loop).verdict
    assert wb.limit_cycle(loop).closed_form is None


def test_linear_analysis_takes_the_sign_of_the_valve():
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
    turned = replace(loop, fail_open=True, controller=replace(loop.controller, action="direct"))
    assert replace(wb.margins(turned), loop=loop) == wb.margins(loop)
    assert wb.limit_cycle(turned).period == wb.limit_cycle(loop).period
    assert wb.limit_cycle(turned).closed_form == wb.limit_cycle(loop).closed_form
    ours, theirs = wb.describing_function(turned), wb.describing_function(loop)
    np.testing.assert_array_equal(ours.L, theirs.L)
    assert wb.apply_rule(turned, wb.Simc()).Kc == wb.apply_rule(loop, wb.Simc()).Kc
    assert not wb.describing_function(replace(loop, fail_open=True)).linear_stable
    with pytest.raises(wb.InvalidValue, match="behind a fail-open valve"):
        wb.apply_rule(replace(loop, fail_open=True), wb.Simc())


@pytest.mark.slow
def test_tuning_knows_both():
    task = wb.Experiment(60.0, setpoint=wb.Step(4.0), load=wb.Step(1.0, at=30.0))
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
    turned = replace(loop, fail_open=True, controller=replace(loop.controller, action="direct"))
    asked = {"bounds": wb.Bounds(Td=(0, 0)), "restarts": 1, "digits": 2}
    ours, theirs = wb.tune(turned, task, **asked), wb.tune(loop, task, **asked)
    assert (ours.controller.Kc, ours.controller.Ti) == (theirs.controller.Kc, theirs.controller.Ti)
    assert ours.solves > 0, "branch programs know fail-open valves"
    bent = wb.tune(curved(), task, **asked)
    assert "do not know the curved characteristic" in bent.message
    assert bent.objective == wb.evaluate(bent.loop.with_controller(bent.controller), task, wb.Objective())[0]
