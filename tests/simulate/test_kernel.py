"""The kernel against the law written independently, against its own Python source, and against itself restarted."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from loops import experiments, independent_simulation, loops, paper_loop, paper_step

import workbench as wb
from workbench.simulate import kernel
from workbench.simulate.batch import sums
from workbench.simulate.coefficients import coefficients, rest
from workbench.simulate.run import valve_response
from workbench.simulate.signals import signals


def run_rows(loop, experiment, run_loop=kernel.run_loop):
    given_signals = signals(loop, experiment)
    row = coefficients(loop, experiment.stem_offset)[0]
    n = given_signals.samples
    out = [np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int8)]
    state, past = rest(row)
    run_loop(row, given_signals.r, given_signals.load, given_signals.noise, state, past, *out)
    return [*out, state, past]


@given(loop=loops, experiment=experiments())
def test_kernel_equals_the_law_written_independently(loop, experiment):
    run = wb.simulate(loop, experiment)
    s = signals(loop, experiment)
    other = independent_simulation(loop, s.r, s.load, s.noise)
    np.testing.assert_array_equal(run.pv, other["pv"])
    np.testing.assert_array_equal(run.op, other["op"])
    np.testing.assert_array_equal(run.valve, other["valve"])
    assert run.final_pv == other["final"][0]


@given(loop=loops, experiment=experiments(60.0))
def test_compiled_kernel_equals_its_python_source_to_the_bit(loop, experiment):
    source = kernel.run_samples.py_func  # type: ignore[attr-defined]
    compiled = run_rows(loop, experiment)
    # The shorter loop, which leaves out what few loops have, for those that have nothing of it.
    pid = loop.controller
    for plain in (False, True) if pid.output_resolution == 0.0 and pid.compensator is None else (False,):
        python = run_rows(loop, experiment, lambda *given, plain=plain: source(*given, plain))
        for ours, theirs in zip(compiled, python, strict=True):
            np.testing.assert_array_equal(ours, theirs)


@given(loop=loops, experiment=experiments(120.0))
def test_a_run_in_pieces_equals_the_run_in_one(loop, experiment):
    whole = run_rows(loop, experiment)
    s = signals(loop, experiment)
    row = coefficients(loop)[0]
    state, past = rest(row)
    parts = []
    for start, stop in ((0, 3), (3, 70), (70, s.samples)):
        n = stop - start
        out = [np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int8)]
        kernel.run_loop(row, s.r[start:], s.load[start:], s.noise[start:], state, past, *out)
        parts.append(out)
    for signal in (1, 2, 3, 4):
        np.testing.assert_array_equal(np.concatenate([p[signal] for p in parts]), whole[signal])
    np.testing.assert_array_equal(np.concatenate([p[0][:-1] for p in parts] + [parts[-1][0][-1:]]), whole[0])
    np.testing.assert_array_equal(state, whole[5])
    np.testing.assert_array_equal(past, whole[6])


@given(loop=loops, experiment=experiments(100.0))
def test_cost_terms_are_those_of_the_trajectory(loop, experiment):
    run = wb.simulate(loop, experiment)
    s = signals(loop, experiment)
    e = s.r[1:] - np.append(run.pv[1:], run.final_pv)
    expected = 0.3 * (e**2).sum() + 0.2 * (run.op**2).sum() + 0.7 * e[-1] ** 2
    expected += 0.1 * (np.diff(run.op, prepend=0.0) ** 2).sum()
    J = wb.evaluate(loop, experiment, wb.Objective(w1=0.3, w2=0.2, w3=0.7, w4=0.1))
    assert J.shape == (1,)
    np.testing.assert_allclose(J[0], expected, rtol=1e-12)
    terms = sums(coefficients(loop), s)[0]
    np.testing.assert_allclose(terms[4] / run.pv.size, run.kpis.mean_square_error, rtol=1e-12)
    np.testing.assert_allclose(terms[5], run.kpis.valve_travel, rtol=1e-12)


@given(loop=loops)
def test_branch_codes_tell_what_the_trajectory_did(loop):
    run = wb.simulate(loop, wb.Experiment(duration=100.0, setpoint=wb.Step(5.0)))
    stem, limit = run.branch % 3 - 1, run.branch // 3 % 3 - 1
    moves = np.diff(run.valve, prepend=0.0)
    if not isinstance(loop.valve, wb.Ideal):
        assert (moves[stem == 0] == 0.0).all()
    low, high = loop.controller.output_limits or (-math.inf, math.inf)
    assert (run.op[limit == 1] == high).all()
    assert (run.op[limit == -1] == low).all()
    assert ((run.op[limit == 0] >= low) & (run.op[limit == 0] <= high)).all()
    if isinstance(loop.valve, wb.Stenman):
        np.testing.assert_array_equal(np.sign(moves), stem)


def test_dead_band_is_the_two_parameter_valve_without_jump():
    op = 5.0 * np.sin(np.linspace(0.0, 20.0, 400))
    np.testing.assert_array_equal(valve_response(wb.Deadband(2.0), op), valve_response(wb.Choudhury(2.0, 0.0), op))


def test_stenman_is_a_staircase_and_choudhury_goes_on_moving():
    ramp = np.arange(1.0, 41.0) * 0.25
    staircase = valve_response(wb.Stenman(2.0), ramp)
    moving = valve_response(wb.Choudhury(2.0, 2.0), ramp)
    assert np.count_nonzero(np.diff(staircase)) == 4
    assert np.count_nonzero(np.diff(moving)) == 32
    assert staircase[-1] == moving[8] + 4 * 2.25 - 2.25


def test_the_valve_at_exactly_its_band_holds():
    assert valve_response(wb.Stenman(2.0), np.array([2.0]))[0] == 0.0
    assert valve_response(wb.Stenman(2.0), np.array([np.nextafter(2.0, 3.0)]))[0] > 2.0
    assert valve_response(wb.Choudhury(3.0, 1.0), np.array([2.0]))[0] == 0.0
    assert valve_response(wb.Choudhury(3.0, 1.0), np.array([2.5]))[0] == 1.5


@pytest.mark.parametrize("dead_time", [0.0, 0.3, 1.0, 2.6])
@pytest.mark.parametrize("integrating", [False, True])
def test_plant_step_response_is_that_of_the_continuous_plant(dead_time, integrating):
    plant = wb.Integrating(0.2, dead_time) if integrating else wb.FOPDT(2.0, 7.0, dead_time)
    # Kc = 1 on the setpoint alone would feed PV back; a load step on a loop with Kc = 0 shows the plant itself.
    loop = wb.Loop(plant, wb.Ideal(), wb.PID(Kc=0.0, Ti=10.0), sample_time=1.0)
    run = wb.simulate(loop, wb.Experiment(60.0, load=wb.Step(1.5, at=3.0)))
    t = np.maximum(run.time - 3.0 - dead_time, 0.0)
    exact = 1.5 * 0.2 * t if integrating else 1.5 * 2.0 * (1.0 - np.exp(-t / 7.0))
    np.testing.assert_allclose(run.pv, exact, atol=1e-12)


def test_direct_action_on_a_negative_gain_mirrors_reverse_action():
    mirrored = wb.Loop(wb.FOPDT(-1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=20.0, action="direct"), 1.0)
    a, b = wb.simulate(paper_loop(0.5, 20.0), paper_step()), wb.simulate(mirrored, paper_step())
    np.testing.assert_array_equal(a.pv, b.pv)
    np.testing.assert_array_equal(a.op, -b.op)


def test_a_stem_offset_is_a_resting_state_until_something_happens():
    loop = paper_loop(0.5, 20.0)
    quiet = wb.simulate(loop, wb.Experiment(50.0, setpoint=wb.Step(4.0, at=30.0), stem_offset=1.5))
    assert (quiet.op[:30] == 1.5).all()
    assert (quiet.pv[:30] == 0.0).all()
    assert quiet.valve[30] == quiet.op[30] == 1.5 + 2.0 + 0.1
    with pytest.raises(wb.InvalidValue, match="stem_offset"):
        wb.simulate(loop, wb.Experiment(50.0, stem_offset=2.1))
    with pytest.raises(wb.InvalidValue, match="stem_offset"):
        wb.simulate(wb.Loop(loop.plant, wb.Ideal(), loop.controller, 1.0), wb.Experiment(50.0, stem_offset=0.1))


def test_limits_clamp_and_recover_without_wind_up():
    def recovery(anti_windup: str, limits):
        pid = wb.PID(Kc=1.0, Ti=5.0, output_limits=limits, anti_windup=anti_windup)
        loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Ideal(), pid, 1.0)
        # The setpoint cannot be reached for 100 s; afterwards it can.
        steps = [wb.Step(10.0, at=0.0), wb.Step(-7.0, at=100.0)]
        return wb.simulate(loop, wb.Experiment(200.0, setpoint=steps))

    for method in ("clamp", "back_calculation"):
        run = recovery(method, (-5.0, 5.0))
        assert run.op.max() == 5.0
        assert run.op[101] < 5.0, "leaves the limit at once when the error turns"
        assert abs(run.pv[150] - 3.0) < 0.05


def test_a_ramp_of_a_million_samples_keeps_the_law():
    loop = paper_loop(0.5, 20.0)
    run = wb.simulate(loop, wb.Experiment(1_000_000.0, setpoint=wb.Ramp(50.0, 0.0, 1_000_000.0)))
    np.testing.assert_array_equal(run.valve, valve_response(loop.valve, run.op))
