"""Compensators: against their equations written independently, by hand where that can be done, and what is refused."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from loops import compensators, experiments, independent_simulation, loops, numbers, paper_loop, paper_step

import workbench as wb
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients, rest
from workbench.simulate.signals import signals

OPEN = wb.PID(Kc=0.0, Ti=math.inf)


def with_compensator(loop: wb.Loop, compensator: object) -> wb.Loop:
    return loop.with_controller(dataclasses.replace(loop.controller, compensator=compensator))


@given(loop=loops, compensator=compensators, experiment=experiments())
def test_every_compensator_is_its_equation(loop, compensator, experiment):
    loop = with_compensator(loop, compensator)
    run, s = wb.simulate(loop, experiment), signals(loop, experiment)
    other = independent_simulation(loop, s.r, s.load, s.noise)
    np.testing.assert_array_equal(run.op, other["op"])
    np.testing.assert_array_equal(run.valve, other["valve"])
    np.testing.assert_array_equal(run.pv, other["pv"])


@given(loop=loops, compensator=compensators, experiment=experiments(80.0), at=st.integers(1, 70))
def test_compiled_and_python_and_pieces_agree_to_the_bit(loop, compensator, experiment, at):
    loop = with_compensator(loop, compensator)
    s, row = signals(loop, experiment), coefficients(loop)[0]

    def run(function, *edges):
        state, past = rest(row)
        parts = []
        for begin, end in itertools.pairwise(edges):
            n = end - begin
            out = [np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int8)]
            function(row, s.r[begin:], s.load[begin:], s.noise[begin:], state, past, *out)
            parts.append(out[1])
        return np.concatenate(parts), state

    def python(*arguments):
        kernel.run_samples.py_func(*arguments, False)  # type: ignore[attr-defined]

    whole, end = run(kernel.run_loop, 0, s.samples)
    for function, edges in ((python, (0, s.samples)), (kernel.run_loop, (0, at, s.samples))):
        again, state = run(function, *edges)
        np.testing.assert_array_equal(again, whole)
        np.testing.assert_array_equal(state, end)


@given(loop=loops, experiment=experiments(80.0))
def test_a_deadband_of_ratio_1_is_no_compensator(loop, experiment):
    plain = wb.simulate(loop, experiment)
    same = wb.simulate(with_compensator(loop, wb.IntegralDeadband(1.0, ratio=1.0)), experiment)
    np.testing.assert_array_equal(plain.pv, same.pv)


def test_an_integral_deadband_stops_the_cycle_at_an_offset_within_it():
    # Stem positions lie 2 % and more apart, PV 2 EU: a band of 2 EU holds one of them, and the integral stays there.
    cycling = wb.simulate(paper_loop(0.5, 20.0), paper_step(3000.0))
    held = wb.simulate(paper_loop(0.5, 20.0, compensator=wb.IntegralDeadband(2.0)), paper_step(3000.0))
    assert np.ptp(cycling.pv[2000:]) > 1.9
    assert np.ptp(held.pv[2000:]) < 1e-9
    assert 0.0 < abs(held.kpis.final_error) <= 2.0
    assert np.ptp(held.op[2000:]) == 0.0


def test_reset_scheduling_slows_the_integral_by_its_ratio():
    # P and D at rest, error 1 EU within the band: OP rises by Kc Ts/(ratio Ti) each sample.
    plant = wb.FOPDT(gain=1.0, time_constant=5.0, dead_time=500.0)
    controller = wb.PID(Kc=2.0, Ti=10.0, compensator=wb.IntegralDeadband(band=1.0, ratio=16.0))
    run = wb.simulate(wb.Loop(plant, wb.Ideal(), controller, 1.0), wb.Experiment(400.0, setpoint=wb.Step(1.0)))
    np.testing.assert_allclose(np.diff(run.op), 0.2 / 16.0, rtol=1e-9)
    beyond = wb.simulate(wb.Loop(plant, wb.Ideal(), controller, 1.0), wb.Experiment(400.0, setpoint=wb.Step(1.001)))
    np.testing.assert_allclose(np.diff(beyond.op), 0.2 * 1.001, rtol=1e-9)


def test_pulses_of_the_knocker_by_hand():
    # OP of the controller rises by 0.1 % a sample without feedback in sight: pulses of +3 % from sample 10 on.
    plant = wb.FOPDT(gain=1.0, time_constant=5.0, dead_time=500.0)
    controller = wb.PID(Kc=1.0, Ti=10.0, compensator=wb.Knocker(amplitude=3.0, width=2.0, period=10.0))
    run = wb.simulate(wb.Loop(plant, wb.Stenman(2.5), controller, 1.0), wb.Experiment(100.0, setpoint=wb.Step(1.0)))
    k = np.arange(100)
    pulses = np.where((k >= 10) & (k % 10 < 2), 3.0, 0.0)
    np.testing.assert_allclose(run.op, 1.0 + 0.1 * (k + 1) + pulses, rtol=1e-12)
    # The first pulse frees the stem: 2.1 + 3 at sample 10, beyond 2.5; without it OP gets there at sample 15.
    assert run.valve[9] == 0.0
    assert run.valve[10] == pytest.approx(5.1, rel=1e-12)
    still = wb.simulate(wb.Loop(plant, wb.Stenman(2.5), OPEN, 1.0), wb.Experiment(50.0))
    assert not still.op.any()


def test_constant_reinforcement_by_hand():
    plant = wb.FOPDT(gain=1.0, time_constant=5.0, dead_time=500.0)
    controller = wb.PID(Kc=1.0, Ti=10.0, compensator=wb.ConstantReinforcement(2.0))
    steps = [wb.Step(1.0), wb.Step(-3.0, at=20.0)]
    run = wb.simulate(wb.Loop(plant, wb.Ideal(), controller, 1.0), wb.Experiment(40.0, setpoint=steps))
    k = np.arange(20)
    np.testing.assert_allclose(run.op[:20], 1.0 + 0.1 * (k + 1) + 2.0, rtol=1e-12)
    np.testing.assert_allclose(run.op[20:], 1.0 - 3.0 + 2.0 - 0.2 * (k + 1) - 2.0, rtol=1e-12)


def test_two_moves_put_pv_on_the_setpoint_and_hold_it():
    compensator = wb.TwoMove(amplitude=2.5, at=300.0, steady_output=4.0)
    loop = paper_loop(0.5, 20.0, compensator=compensator)
    run = wb.simulate(loop, paper_step())
    own = wb.simulate(paper_loop(0.5, 20.0), paper_step()).op[300]
    assert run.op[300] == pytest.approx(4.0 + (own - 4.0) + abs(own - 4.0) + 2.5, rel=1e-12)
    assert run.valve[300] == run.op[300]
    assert (run.op[301:] == 4.0).all()
    assert (run.valve[301:] == 4.0).all()
    assert abs(run.kpis.final_error) < 1e-12
    # The error that is left decays as the open loop does.
    np.testing.assert_allclose(
        run.pv[320:330] - 4.0, (run.pv[319] - 4.0) * math.exp(-0.2) ** np.arange(1, 11), atol=1e-12
    )


def test_two_moves_are_given_up_for_good_when_a_load_asks_for_control():
    compensator = wb.TwoMove(amplitude=4.5, at=300.0, steady_output=4.0, release=1.5)
    load = wb.Step(2.0, at=600.0)
    run = wb.simulate(
        paper_loop(0.5, 20.0, compensator=compensator), wb.Experiment(2000.0, setpoint=wb.Step(4.0), load=load)
    )
    assert (run.op[301:600] == 4.0).all()
    # PV - SP = 2 (1 - exp(-n/5)) n samples after the dead time's: beyond 1.5 at n = 7, and 8 is the controller's.
    assert (run.op[600:609] == 4.0).all()
    e = 4.0 - run.pv[607:610]
    assert abs(e[0]) < 1.5 < abs(e[1])
    # Without a bump: the sample after goes on from the held output.
    assert run.op[609] - 4.0 == pytest.approx(0.5 * (e[2] - e[1]) + 0.5 / 20.0 * e[2], rel=1e-9)
    assert np.ptp(run.valve[1000:]) > 1.0, "released, the loop cycles again"


@pytest.mark.parametrize("period", [2.0, 3.0, 7.0, 50.0])
def test_a_sine_dither_is_a_sine(period):
    loop = wb.Loop(
        wb.FOPDT(1.0, 5.0, 1.0), wb.Ideal(), dataclasses.replace(OPEN, compensator=wb.Dither(3.0, period)), 1.0
    )
    run = wb.simulate(loop, wb.Experiment(1000.0))
    k = np.arange(1000)
    np.testing.assert_allclose(run.op, 3.0 * np.sin(2.0 * math.pi * (k + 0.5) / period), atol=1e-12)


def test_dither_larger_than_the_band_frees_the_stem_of_its_stiction():
    # A square dither of 3 % takes Stenman's stem (d = 2 %) along at each turn: the mean of two samples follows OP.
    loop = paper_loop(0.5, 20.0, compensator=wb.Dither(3.0, 2.0, shape="square"))
    run = wb.simulate(loop, paper_step())
    assert (run.valve == run.op).all()
    assert abs(run.pv[500:].mean() - 4.0) < 1e-3


@given(loop=loops, compensator=compensators)
def test_what_leaves_the_controller_stays_within_its_limits(loop, compensator):
    assume(loop.controller.output_limits is not None)
    run = wb.simulate(with_compensator(loop, compensator), wb.Experiment(100.0, setpoint=wb.Step(5.0)))
    low, high = loop.controller.output_limits
    assert run.op.min() >= low
    assert run.op.max() <= high


@given(compensator=compensators, Kc=numbers(0.1, 2.0))
def test_costs_of_batches_are_those_of_the_run(compensator, Kc):
    loop, weights = paper_loop(Kc, 20.0, compensator=compensator), wb.Objective(w1=0.5, w2=0.1, w3=0.5, w4=0.2)
    run = wb.simulate(loop, paper_step(200.0))
    e = np.append(run.sp[1:] - run.pv[1:], run.final_sp - run.final_pv)
    J = 0.5 * (e**2).sum() + 0.1 * (run.op**2).sum() + 0.5 * e[-1] ** 2
    J += 0.2 * (np.diff(run.op, prepend=0.0) ** 2).sum()
    np.testing.assert_allclose(wb.evaluate(loop, paper_step(200.0), weights)[0], J, rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda: wb.IntegralDeadband(0.0), r"IntegralDeadband\.band"),
        (lambda: wb.IntegralDeadband(1.0, ratio=0.5), r"IntegralDeadband\.ratio"),
        (lambda: wb.Knocker(1.0, 4.0, 3.0), r"Knocker\.period"),
        (lambda: wb.Knocker(-1.0, 1.0, 3.0), r"Knocker\.amplitude"),
        (lambda: wb.ConstantReinforcement(math.nan), r"ConstantReinforcement\.amplitude"),
        (lambda: wb.TwoMove(1.0, 10.0, math.inf), r"TwoMove\.steady_output"),
        (lambda: wb.TwoMove(1.0, -1.0, 1.0), r"TwoMove\.at"),
        (lambda: wb.Dither(1.0, 4.0, shape="triangle"), r"Dither\.shape"),
        (lambda: wb.PID(1.0, 10.0, compensator="knocker"), r"PID\.compensator"),
        (lambda: paper_loop(1.0, 10.0, compensator=wb.Knocker(1.0, 1.5, 3.0)), r"Knocker\.width"),
        (lambda: paper_loop(1.0, 10.0, compensator=wb.Knocker(1.0, 1.0, 3.3)), r"Knocker\.period"),
        (lambda: paper_loop(1.0, 10.0, compensator=wb.Dither(1.0, 1.0)), r"Dither\.period"),
        (lambda: paper_loop(1.0, 10.0, compensator=wb.Dither(1.0, 3.0, "square")), r"Dither\.period"),
        (lambda: paper_loop(1.0, 10.0, compensator=wb.TwoMove(1.0, 0.4, 1.0)), r"TwoMove\.at"),
    ],
)
def test_what_no_compensator_can_be_is_refused(make, where):
    with pytest.raises(wb.InvalidValue, match=where):
        make()
