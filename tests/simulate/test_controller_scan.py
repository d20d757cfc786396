"""A controller that executes in every n-th sample: against the law written again, and against the slower loop."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from loops import compensators, experiments, independent_simulation, late_cycles, loops, paper_loop, paper_step

import workbench as wb
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients, rest
from workbench.simulate.signals import signals


def scanned(loop: wb.Loop, scan: int) -> wb.Loop:
    try:
        return replace(loop, scan=scan)
    except wb.InvalidValue:  # back-calculation that is too fast for it
        assume(False)
        raise


@given(loop=loops, experiment=experiments(), scan=st.integers(2, 7))
def test_the_kernel_equals_the_law_written_independently(loop, experiment, scan):
    loop = scanned(loop, scan)
    s = signals(loop, experiment)
    other = independent_simulation(loop, s.r, s.load, s.noise)
    run = wb.simulate(loop, experiment)
    np.testing.assert_array_equal(run.pv, other["pv"])
    np.testing.assert_array_equal(run.op, other["op"])
    np.testing.assert_array_equal(run.valve, other["valve"])
    held = np.arange(run.op.size) % scan != 0
    assert (run.op[held] == run.op[np.flatnonzero(held) - 1]).all()
    # What OP's limits did goes on with it.
    assert (run.branch[held] // 3 == run.branch[np.flatnonzero(held) - 1] // 3).all()


@given(loop=loops, experiment=experiments(), scan=st.integers(1, 3), compensator=compensators)
def test_a_compensator_counts_executions_and_comes_before_the_rounding(loop, experiment, scan, compensator):
    try:
        loop = replace(loop, scan=scan, controller=replace(loop.controller, compensator=compensator))
    except wb.InvalidValue:  # times that are no whole number of executions
        assume(False)
    s = signals(loop, experiment)
    other = independent_simulation(loop, s.r, s.load, s.noise)
    run = wb.simulate(loop, experiment)
    np.testing.assert_array_equal(run.pv, other["pv"])
    np.testing.assert_array_equal(run.op, other["op"])
    np.testing.assert_array_equal(run.valve, other["valve"])


@given(loop=loops, experiment=experiments(120.0), scan=st.integers(2, 5))
def test_a_run_in_pieces_equals_the_run_in_one(loop, experiment, scan):
    loop = scanned(loop, scan)
    s, row = signals(loop, experiment), coefficients(loop)[0]
    results = []
    for cuts in ((0, s.samples), (0, 3, 71, s.samples)):
        state, past = rest(row)
        parts = []
        for start, stop in pairwise(cuts):
            n = stop - start
            out = [np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int8)]
            kernel.run_loop(row, s.r[start:], s.load[start:], s.noise[start:], state, past, *out)
            parts.append(out)
        results.append([np.concatenate([p[i] for p in parts]) for i in (1, 2, 3, 4)])
    for whole, pieces in zip(*results, strict=True):
        np.testing.assert_array_equal(whole, pieces)


@pytest.mark.parametrize("valve", [wb.Ideal(), wb.Stenman(2.0), wb.He(2.0, 0.7)])
@pytest.mark.parametrize("dead_time", [0.0, 2.0, 6.3])
def test_at_its_executions_it_is_the_slower_loop(valve, dead_time):
    pid = wb.PID(0.4, 30.0, 2.0, output_limits=(-5.0, 6.0))
    loop = wb.Loop(wb.FOPDT(1.2, 25.0, dead_time), valve, pid, 1.0, scan=4)
    task = wb.Experiment(1200.0, setpoint=[wb.Step(3.1), wb.Step(-4.0, at=600.0)], load=wb.Step(1.0, at=400.0))
    fine, slow = wb.simulate(loop, task), wb.simulate(loop.executed, task)
    for name in ("pv", "op", "valve"):
        np.testing.assert_allclose(getattr(fine, name)[::4], getattr(slow, name), rtol=1e-9, atol=1e-9)
    assert wb.margins(loop) == replace(wb.margins(loop.executed), loop=loop)


@pytest.mark.slow
def test_a_stem_that_goes_on_with_op_sticks_between_executions():
    loop = wb.Loop(wb.FOPDT(1.0, 25.0), wb.Choudhury(3.0, 1.0), wb.PID(0.4, 30.0), 1.0)
    task = wb.Experiment(400.0, setpoint=wb.Ramp(20.0, 0.0, 400.0))
    moves = [np.count_nonzero(np.diff(wb.simulate(replace(loop, scan=n), task).valve)) for n in (1, 4)]
    assert moves[0] > 300
    assert moves[1] < 40
    assert wb.limit_cycle(replace(loop, scan=4)).closed_form is None
    assert "sticks, is left out" in wb.describing_function(replace(loop, scan=4)).verdict


@pytest.mark.parametrize("valve", [wb.Stenman(2.0), wb.Choudhury(3.0, 1.0)])
def test_the_long_run_equals_plain_simulation(valve):
    loop = wb.Loop(wb.FOPDT(1.0, 20.0, 3.0), valve, wb.PID(0.5, 40.0), 1.0, scan=5)
    task = wb.Experiment(200_000.0, setpoint=wb.Step(3.1))
    start = wb.limit_cycle(loop, task).starts[0]
    assert start.outcome == "cycles"
    late = late_cycles(wb.simulate(loop, task), 150_000.0)
    assert (start.period, start.pv_peak_to_peak) == pytest.approx(late, rel=0.03)


def test_a_loop_that_saturates_between_executions_comes_to_rest_at_its_limit():
    loop = replace(paper_loop(0.5, 20.0, output_limits=(-3.0, 3.0)), scan=3)
    start = wb.limit_cycle(loop, wb.Experiment(100.0, setpoint=wb.Step(40.0))).starts[0]
    assert (start.outcome, start.rest_stem) == ("settles", 3.0)
    assert "OP is at its limit" in start.reason


def test_tuning_searches_directly_and_keeps_the_margins_of_the_executions():
    loop = replace(paper_loop(0.5, 20.0), scan=2)
    asked = {
        "bounds": wb.Bounds(Td=(0, 0)),
        "restarts": 1,
        "digits": 2,
        "constraints": wb.Constraints(max_sensitivity=1.6),
    }
    tuned = wb.tune(loop, paper_step(60.0), **asked)
    assert tuned.status.success
    assert wb.margins(tuned.loop.with_controller(tuned.controller)).max_sensitivity <= 1.6 * (1.0 + 1e-6)
    free = wb.tune(loop, paper_step(100.0), bounds=wb.Bounds(Td=(0, 0)), restarts=1, max_evaluations=200)
    assert "do not know the controller's scan" in free.message


def test_the_ensemble_measures_margins_at_the_executions_too():
    loop = replace(paper_loop(0.5, 20.0), scan=2)
    ours, slow = wb.assess(loop), wb.assess(loop.executed)
    assert ours.max_sensitivity == pytest.approx(slow.max_sensitivity, rel=1e-9)
    assert ours.diverged == 0


@pytest.mark.parametrize("scan", [0, -1, 1.5, True])
def test_other_scans_are_refused(scan):
    with pytest.raises(wb.InvalidValue, match=r"Loop\.scan"):
        replace(paper_loop(0.5, 20.0), scan=scan)
    with pytest.raises(wb.InvalidValue, match="back-calculation is unstable"):
        replace(
            paper_loop(0.5, 3.0, output_limits=(-3.0, 3.0), anti_windup="back_calculation", tracking_time=1.0), scan=4
        )
