"""OP's resolution: levels from the resting output, after the limits, unseen by the controller; long runs with it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from loops import experiments, late_cycles, loops, numbers, paper_loop, paper_step

import workbench as wb


@given(loop=loops, experiment=experiments(80.0), q=numbers(0.05, 2.0))
def test_op_stands_on_levels_or_at_a_limit(loop, experiment, q):
    run = wb.simulate(loop.with_controller(replace(loop.controller, output_resolution=q)), experiment)
    steps = run.op / q
    limits = loop.controller.output_limits or (-math.inf, math.inf)
    on_level = np.abs(steps - np.rint(steps)) <= 1e-9 * np.maximum(np.abs(steps), 1.0)
    assert (on_level | (run.op == limits[0]) | (run.op == limits[1])).all()


@given(loop=loops, experiment=experiments(80.0))
def test_no_resolution_and_one_below_rounding_change_nothing_else(loop, experiment):
    none = loop.with_controller(replace(loop.controller, output_resolution=0.0))
    fine = loop.with_controller(replace(loop.controller, output_resolution=2.0**-40))
    ours, theirs = wb.simulate(none, experiment), wb.simulate(fine, experiment)
    # Until a decision is closer than the resolution, or the loop has amplified it.
    part = slice(0, 20)
    if np.abs(ours.op).max() < 1e3:
        same = np.abs(ours.valve[part] - theirs.valve[part]).max() < 1e-6
        assert same or np.abs(np.abs(ours.op - np.append(0.0, ours.valve[:-1])) - loop.valve.hold)[part].min() < 1e-6


def test_the_resting_output_is_a_level_and_the_integral_goes_on_unrounded():
    loop = paper_loop(0.5, 20.0, output_resolution=0.4)
    quiet = wb.simulate(loop, wb.Experiment(60.0, setpoint=wb.Step(0.98, at=30.0), stem_offset=1.5))
    assert (quiet.op[:30] == 1.5).all()
    # P is 0.49 and I rises by 0.0245 a sample: 0.6 is passed in the fifth sample of the error.
    rises = quiet.op[30:45] - 1.5
    np.testing.assert_allclose(rises[:4], 0.4, rtol=1e-12)
    assert rises[4] == pytest.approx(0.8, rel=1e-12)


def test_a_limit_between_two_levels_is_a_level_of_its_own():
    pid = wb.PID(Kc=1.0, Ti=math.inf, output_limits=(-5.0, 5.0), output_resolution=2.0)
    loop = wb.Loop(wb.FOPDT(1.0, 1e6), wb.Ideal(), pid, 1.0)
    run = wb.simulate(loop, wb.Experiment(8.0, setpoint=wb.Ramp(7.0, 0.0, 7.0)))
    # OP is the setpoint less a hair of PV: the nearest level, and from the limit on the limit.
    assert run.op.tolist() == [0.0, 0.0, 2.0, 2.0, 4.0, 4.0, 5.0, 5.0]


def test_rounding_makes_a_loop_with_an_ideal_valve_cycle():
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Ideal(), wb.PID(0.5, 8.0), 1.0)
    assert wb.limit_cycle(loop).outcome == "settles"
    coarse = loop.with_controller(replace(loop.controller, output_resolution=1.0))
    cycle = wb.limit_cycle(coarse)
    assert cycle.outcome == "cycles"
    # OP goes to and fro between the two levels about the setpoint.
    assert cycle.op_peak_to_peak == pytest.approx(1.0)
    assert 0.0 < cycle.pv_peak_to_peak <= 1.0
    assert "OP's resolution of 1 % is left out" in wb.describing_function(coarse).verdict


@pytest.mark.parametrize("valve", [wb.Stenman(2.0), wb.Choudhury(3.0, 1.0), wb.Kano(3.0, 1.0)])
def test_the_long_run_equals_plain_simulation(valve):
    pid = wb.PID(0.3, 60.0, output_resolution=0.35)
    loop = wb.Loop(wb.FOPDT(1.0, 20.0, 3.0), valve, pid, 1.0)
    experiment = wb.Experiment(800_000.0, setpoint=wb.Step(3.1))
    start = wb.limit_cycle(loop, experiment).starts[0]
    run = wb.simulate(loop, experiment)
    assert start.outcome == "cycles"
    assert (start.period, start.pv_peak_to_peak) == pytest.approx(late_cycles(run, 400_000.0), rel=0.03)
    # The closed form knows no levels.
    assert start.period == pytest.approx(wb.limit_cycle(loop, experiment).period)
    assert math.isnan(wb.limit_cycle(loop).closed_form_period)


def test_tuning_searches_directly_and_the_complementarity_program_refuses():
    loop = paper_loop(0.5, 20.0, output_resolution=0.5)
    tuned = wb.tune(loop, paper_step(100.0), bounds=wb.Bounds(Td=(0, 0)), restarts=1, max_evaluations=20_000)
    assert "branch programs do not know OP's resolution" in tuned.message
    assert tuned.controller.output_resolution == 0.5
    assert tuned.objective == wb.evaluate(loop.with_controller(tuned.controller), paper_step(100.0), wb.Objective())[0]
    with pytest.raises(wb.InvalidValue, match="OP's resolution"):
        wb.tune(loop, paper_step(100.0), complementarity=1)
