"""The jump from slip to slip against the kernel from the same state; runs made of jumps against plain ones."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from loops import controllers, loops, numbers, paper_loop

import workbench as wb
from workbench.analyze.half_cycles import fresh_carry
from workbench.simulate import events, kernel
from workbench.simulate.coefficients import coefficients, rest

FAR = 100_000
TIE = 1e-9


def table_of(row):
    table = np.empty((events.DOUBLINGS, events.FILTER_SUM + 1))
    events.doublings(row, table)
    return table


def run_on(row, r, load, state, past, n):
    """Run n samples of the kernel, changing state and past; return y, u, x and branch."""
    y, u, x, v, branch = np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int8)
    kernel.run_loop(row, np.full(n, r), np.full(n, load), np.zeros(n), state, past, y, u, x, v, branch)
    return y, u, x, branch


def near(given_value, wanted, size):
    return abs(given_value - wanted) <= 1e-9 * size


def tied(row, u, x):
    """Whether u stands, but for rounding, at the end of the stick band, at a limit or between two levels."""
    q, seen = row[kernel.RESOLUTION], u
    if q > 0.0:
        if abs(abs(math.remainder(u - row[kernel.BIAS], q)) - 0.5 * q) <= TIE:
            return True
        # The stem sees the level: where this is the band's end, all that is rounded to it is tied.
        seen = kernel._level(u, q, row[kernel.BIAS], row[kernel.LOW], row[kernel.HIGH])
    up, down = row[kernel.BAND], row[kernel.BAND_DOWN]
    if row[kernel.PLACES] > 0.0:
        up = down = kernel.place(row, x)[0]
    gaps = [seen - x - up, seen - x + down, u - row[kernel.LOW], u - row[kernel.HIGH]]
    if row[kernel.VALVE] == kernel.KANO:
        # Where its stem has not moved yet.
        gaps += [seen - x - up + row[kernel.OFFSET], seen - x + down + row[kernel.OFFSET]]
    return min(abs(gap) for gap in gaps) <= TIE


def check_jump(row, r, load, state, past, most=FAR):
    """Hold one jump against the kernel from the same state; return its samples and leave state and past after them."""
    x0, before = state[kernel.X_LAST], state.copy()
    jumped, carry = state.copy(), fresh_carry(x0)
    n = events.jump(row, r, load, jumped, most, table_of(row), carry, np.empty(events.SCRATCH))
    y, u, x, branch = run_on(row, r, load, state, past.copy(), max(n, 1))
    # What OP would be at any resolution: nothing of it comes back while the stem rests.
    fine = row.copy()
    fine[kernel.RESOLUTION], fine[kernel.PLACES] = 0.0, 0.0
    fine[kernel.BAND], fine[kernel.BAND_DOWN] = math.inf, math.inf
    op = run_on(fine, r, load, before.copy(), past.copy(), max(n, 1) + 1)[1]
    if n == 0:
        state[:] = before
    else:
        moved = np.flatnonzero((x != x0) | (branch % 9 // 3 != 1) | (branch >= 9))
        if moved.size:
            # Only rounding decides here.
            k = int(moved[0])
            assert tied(row, op[k], x0)
            return None
        op_size, pv_size = row[kernel.BAND] + np.abs(u).max() + abs(before[kernel.I_TERM]), abs(r) + np.abs(y).max()
        sizes = {kernel.S_LAST: pv_size, kernel.Y: pv_size}
        sizes |= dict.fromkeys((kernel.I_TERM, kernel.D_TERM, kernel.U_LAST), op_size)
        for entry, size in sizes.items():
            assert near(jumped[entry], state[entry], size) or tied(row, op[n - 1], x0), (entry, n)
        assert jumped[kernel.X_LAST] == x0
        assert near(carry[events.Y_HIGH], y[:n].max(), sizes[kernel.Y])
        assert near(carry[events.Y_LOW], y[:n].min(), sizes[kernel.Y])
        for entry, extreme, at in ((events.U_HIGH, u.max(), op[:n].max()), (events.U_LOW, u.min(), op[:n].min())):
            assert near(carry[entry], extreme, sizes[kernel.U_LAST]) or tied(row, at, x0)
        squares = float(((r - y[:n]) ** 2).sum())
        assert abs(carry[events.SQUARES] - squares) <= 1e-9 * n * sizes[kernel.Y] ** 2 + 1e-300
    if n < most:
        # The sample after the jump leaves the band, or meets a limit.
        _, u, x, branch = run_on(row, r, load, state.copy(), past.copy(), 1)
        free = x[0] == x0 and branch[0] % 9 // 3 == 1 and branch[0] < 9
        assert not free or tied(row, op[n] if n else op[0], x0)
    return n


def follow_jumps(loop, r, load, pauses):
    """Alternate the kernel and checked jumps; return the number of jumps."""
    row = coefficients(loop)[0]
    state, past = rest(row)
    jumps = 0
    for pause in pauses:
        run_on(row, r, load, state, past, past.size + pause)
        if not np.isfinite(state).all() or np.abs(state).max() > 1e6:
            break
        if events._rests(row, load, state, past):
            if check_jump(row, r, load, state, past) is None:
                break
            jumps += 1
    return jumps


@st.composite
def slow_loops(draw):
    """Loops that rest for long: small gains, long integral times, poles of plant and filter equal or nearly so."""
    tau = draw(numbers(0.5, 3000.0))
    integrating = draw(st.booleans())
    a = math.exp(-1.0 / tau)
    K, theta = draw(numbers(0.2, 3.0)), draw(numbers(0.0, 20.0))
    plant = wb.Integrating(K / tau, theta) if integrating else wb.FOPDT(K, tau, theta)
    two_parameter = st.builds(wb.Choudhury, S=numbers(0.3, 6.0), J=numbers(0.0, 6.0))
    less_jump = st.builds(lambda S, share: wb.Choudhury(S, share * S), S=numbers(0.3, 6.0), share=numbers(0.0, 1.0))
    valve = draw(
        st.one_of(
            st.builds(wb.Stenman, d=numbers(0.3, 4.0)),
            st.builds(lambda fs, share: wb.He(fs, share * fs), fs=numbers(0.3, 4.0), share=numbers(0.0, 1.0)),
            two_parameter,
            st.builds(lambda S, share: wb.Kano(S, share * S), S=numbers(0.3, 6.0), share=numbers(0.0, 1.0)),
            st.builds(wb.Deadband, b=numbers(0.3, 5.0)),
            st.builds(wb.Directional, up=less_jump, down=less_jump),
        )
    )
    kind = draw(st.sampled_from(["none", "unfiltered", "filtered", "equal poles"]))
    Td, n = {"none": 0.0}.get(kind, tau * draw(numbers(0.1, 2.0))), 10.0
    if kind == "unfiltered":
        n = math.inf
    if kind == "equal poles":
        Tf = a / (1.0 - a) * draw(st.sampled_from([1.0, 1.0 + 1e-9, 1.0 - 1e-6]))
        n = max(1.0, Td / Tf)
        Td = n * Tf
    Ti = draw(st.one_of(st.just(math.inf), numbers(0.3, 100.0).map(lambda share: share * tau)))
    pid = replace(
        draw(controllers()), Kc=draw(numbers(0.05, 3.0)) / K, Ti=Ti, Td=Td, derivative_filter=n, action="reverse"
    )
    assume(pid.output_limits is None or pid.output_limits[1] > 0.0)
    try:
        return wb.Loop(plant, valve, pid, 1.0)
    except wb.InvalidValue:
        assume(False)


pauses = st.lists(st.integers(1, 30), min_size=4, max_size=12)


LEVEL_AT_THE_BANDS_END = wb.Loop(
    wb.Integrating(0.07142857142857142, 0.0),
    wb.Deadband(1.764295241414547),
    wb.PID(1.0, math.inf, 14.0, derivative_on="pv", derivative_filter=math.inf, output_resolution=0.7),
    1.0,
)


@settings(max_examples=40)
@given(loop=slow_loops(), r=numbers(-6.0, 6.0), load=numbers(-2.0, 2.0), pauses=pauses)
@example(LEVEL_AT_THE_BANDS_END, 3.0, 0.0, [1, 1, 1, 1])
def test_each_jump_equals_the_kernel_restarted_from_the_same_state(loop, r, load, pauses):
    follow_jumps(loop, r, load, pauses)


@settings(max_examples=20)
@given(loop=slow_loops(), R=numbers(2.0, 100.0), r=numbers(-6.0, 6.0), load=numbers(-2.0, 2.0), pauses=pauses)
def test_jumps_behind_a_curved_characteristic_equal_the_kernel_too(loop, R, r, load, pauses):
    assume(loop.valve.slip_jump <= loop.valve.stick_band)
    pid = replace(loop.controller, output_limits=(-20.0, 20.0), tracking_time=None)
    follow_jumps(replace(loop, controller=pid, characteristic=wb.EqualPercentage(R, 35.0)), r, load, pauses)


@settings(max_examples=20)
@given(loop=slow_loops(), far=numbers(0.5, 2.0), r=numbers(-6.0, 6.0), load=numbers(-2.0, 2.0), pauses=pauses)
def test_jumps_of_stems_whose_friction_differs_by_place_equal_the_kernel_too(loop, far, r, load, pauses):
    one_parameter = loop.valve.sticks_at_once
    ends = (wb.Stenman(1.0), wb.Stenman(1.0 + far)) if one_parameter else (wb.Choudhury(3.0, far), wb.Choudhury(1.0, 0))
    follow_jumps(replace(loop, valve=wb.Positional((-3.0, 2.0), ends)), r, load, pauses)


@settings(max_examples=20)
@given(loop=slow_loops(), fs=numbers(0.3, 3.0), share=numbers(0.3, 1.0), r=numbers(-6.0, 6.0), pauses=pauses)
def test_jumps_of_a_stem_with_mass_equal_the_kernel_too(loop, fs, share, r, pauses):
    forces = 50.0 * fs * share, 50.0 * fs
    valve = wb.Karnopp(1.0, 50_000.0, 0.1, *forces, viscous=600.0, stribeck=3e-4, substep=5e-3)
    follow_jumps(replace(loop, valve=valve), r, 0.0, pauses)


@settings(max_examples=25)
@given(loop=loops, r=numbers(-6.0, 6.0), load=numbers(-2.0, 2.0), pauses=pauses)
def test_jumps_of_fast_loops_with_limits_equal_the_kernel_too(loop, r, load, pauses):
    follow_jumps(loop, r, load, pauses)


def test_a_jump_of_a_hundred_thousand_samples_and_one_that_ends_in_a_slip():
    row = coefficients(paper_loop(0.5, 20_000.0))[0]
    state, past = rest(row)
    run_on(row, 4.1, 0.0, state, past, 10)
    assert check_jump(row, 4.1, 0.0, state, past, most=20_000) == 20_000
    n = check_jump(row, 4.1, 0.0, state, past, most=10 * FAR)
    assert 20_000 < n < FAR


def test_a_turn_of_op_between_two_cuts_is_not_missed():
    # After a load step PV comes back: OP leaves the band for a few samples only, in the midst of a long stretch.
    loop = wb.Loop(wb.FOPDT(1.0, 200.0), wb.Stenman(2.0), wb.PID(Kc=1.0, Ti=1e5, Td=400.0, derivative_filter=4.0), 1.0)
    row = coefficients(loop)[0]
    for x in np.linspace(-3.9, 3.9, 40):
        state, past = rest(row)
        state[kernel.X_LAST], state[kernel.U_LAST], state[kernel.I_TERM], state[kernel.Y] = x, x, x, 0.4 * x
        state[kernel.S_LAST] = -0.4 * x
        past[:] = x
        # OP starts within the band, so that the derivative's kick and the slow drift decide.
        state[kernel.I_TERM] = x + 0.4 * x
        check_jump(row, 0.0, 0.0, state, past)


@settings(max_examples=25)
@given(loop=slow_loops(), r=numbers(-6.0, 6.0))
def test_the_compiled_jump_equals_its_python_source_to_the_bit(loop, r):
    row = coefficients(loop)[0]
    state, past = rest(row)
    run_on(row, r, 0.0, state, past, past.size + 3)
    assume(np.isfinite(state).all() and events._rests(row, 0.0, state, past))
    table, results = table_of(row), []
    for function in (events.jump, events.jump.py_func):
        mine, carry = state.copy(), fresh_carry(state[kernel.X_LAST])
        results.append([function(row, r, 0.0, mine, 3000, table, carry, np.empty(events.SCRATCH)), *mine, *carry])
    np.testing.assert_array_equal(results[0], results[1])


@pytest.mark.parametrize("n", [1, 2, 3, 7, 100, 1023])
@pytest.mark.parametrize(("a", "q"), [(0.8, 0.5), (0.9, 0.9), (1.0, 0.3), (0.7, 0.0), (0.5, 0.5 + 1e-13)])
def test_doublings_are_the_sums_that_they_stand_for(a, q, n):
    row = np.zeros(kernel.COEFFICIENTS)
    row[kernel.POLE], row[kernel.TF], row[kernel.TF_TS] = a, q, 1.0
    table, at, trial = table_of(row), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]), np.empty(7)
    for j in range(11):
        if n >> j & 1:
            events._join(at, table[j], trial)
            at[:] = trial
    rises = [sum(a**k for k in range(i)) for i in range(n + 1)]
    wanted = [
        n,
        a**n,
        rises[n],
        sum(rises[:n]),
        sum(w * w for w in rises[:n]),
        q**n,
        sum(q ** (n - 1 - i) * a**i for i in range(n)),
    ]
    np.testing.assert_allclose(at, wanted, rtol=1e-11, atol=1e-300)


def plain_turns(loop, r, n, band):
    """Stem reversals and slips by plain simulation, from rest."""
    run = wb.simulate(loop, wb.Experiment(n * loop.sample_time, setpoint=wb.Step(r)))
    moves = np.diff(run.valve, prepend=0.0)
    at = np.flatnonzero(np.abs(moves) > 1e-10 * band)
    return [int(k) for before, k in pairwise(at) if moves[before] * moves[k] < 0.0], run


@pytest.mark.parametrize(
    ("valve", "Ti"),
    [
        (wb.Stenman(2.0), 20.0),
        (wb.Stenman(2.0), 200.0),
        (wb.Choudhury(2.0, 0.8), 50.0),
        (wb.Choudhury(1.0, 1.4), 90.0),
        (wb.He(2.0, 0.5), 40.0),
        (wb.Kano(2.0, 0.8), 50.0),
        (wb.Directional(wb.Choudhury(2.0, 0.8), wb.Choudhury(1.5, 1.0)), 50.0),
    ],
)
@pytest.mark.parametrize("dead_time", [0.0, 1.0, 17.3])
def test_a_run_made_of_jumps_has_the_half_cycles_of_the_plain_run(valve, Ti, dead_time):
    loop = wb.Loop(wb.FOPDT(1.0, 12.0, dead_time), valve, wb.PID(Kc=0.5, Ti=Ti), 1.0)
    row, n = coefficients(loop)[0], 60_000
    state, past = rest(row)
    carry, rows = fresh_carry(0.0), np.empty((8000, events.HALF_CYCLE))
    scale = (1e-10 * valve.stick_band, 1e-12, 1e9)
    samples, worked, count, ended = events.run_events(
        row, 3.7, 0.0, state, past, table_of(row), n, n, 0, *scale, carry, rows
    )
    turns, run = plain_turns(loop, 3.7, n, valve.stick_band)
    assert (samples, ended) == (n, events.DONE) or ended == events.RESTS
    assert worked <= samples
    # Small differences grow from slip to slip of all but Stenman's stem: sooner or later the two runs part.
    alike, off = (len(turns), 1e-9) if isinstance(valve, wb.Stenman) else (6, 1e-5)
    assert rows[: min(count, alike), events.END].tolist() == turns[:alike]
    assert len(turns) >= 6
    moves = np.diff(run.valve, prepend=0.0)
    for row_ in rows[: min(count, 6)]:
        inside = slice(int(row_[events.START]), int(row_[events.END]))
        assert row_[events.Y_HIGH] == pytest.approx(run.pv[inside].max(), rel=off)
        assert row_[events.U_LOW] == pytest.approx(run.op[inside].min(), rel=off, abs=off)
        assert row_[events.SQUARES] == pytest.approx(float(((3.7 - run.pv[inside]) ** 2).sum()), rel=off)
        assert row_[events.STEM_TRAVEL] == pytest.approx(np.abs(moves[inside]).sum(), rel=off)
        motion = run.branch % 3 - 1
        still = np.concatenate([[0], motion[:-1]])
        slips = (motion != 0) if valve.sticks_at_once else (motion != 0) & (motion != still)
        assert row_[events.SLIPS] == np.count_nonzero(slips[inside])


def test_most_of_a_slow_cycle_is_jumped_over():
    row = coefficients(paper_loop(0.5, 200.0))[0]
    state, past = rest(row)
    rows = np.empty((2000, events.HALF_CYCLE))
    asked = (10**9, 10**9, 0, 1e-10, 1e-9, 1e9)
    samples, worked, count, _ = events.run_events(
        row, 4.0, 0.0, state, past, table_of(row), *asked, fresh_carry(0.0), rows
    )
    assert count > 900
    assert worked < 0.001 * samples


def test_what_never_slips_rests_and_what_grows_is_away():
    for loop, r, ended in (
        (paper_loop(0.5, math.inf), 6.0, events.RESTS),
        (paper_loop(0.5, 20.0), 0.0, events.RESTS),
        (paper_loop(20.0, 20.0), 1.0, events.AWAY),
    ):
        row = coefficients(loop)[0]
        state, past = rest(row)
        asked = (2**40, 10**6, 0, 1e-10, 1e-9, 1e9)
        carry, rows = fresh_carry(0.0), np.empty((3000, events.HALF_CYCLE))
        assert events.run_events(row, r, 0.0, state, past, table_of(row), *asked, carry, rows)[3] == ended


@pytest.mark.parametrize("on_pv", ["error", "pv"])
@pytest.mark.parametrize("stride", [1, 7, 250])
def test_a_trace_shows_the_samples_of_the_plain_run(stride, on_pv):
    loop = paper_loop(0.5, 60.0, 2.0, derivative_on=on_pv)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=wb.Step(4.0)))
    row = coefficients(loop)[0]
    state, past = rest(row)
    points = np.empty((2000 // stride, 3))
    events.trace(row, 4.0, 0.0, state, past, table_of(row), stride, points)
    for column, signal in enumerate((run.pv, run.op, run.valve)):
        np.testing.assert_allclose(points[:, column], signal[stride - 1 :: stride], rtol=1e-9, atol=1e-9)
