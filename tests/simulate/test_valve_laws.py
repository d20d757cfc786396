"""The valves' laws under a given output: as their authors wrote them, and where theory says that they agree."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import numbers

import workbench as wb
from workbench.simulate.run import valve_response


def outputs(seed, samples=400):
    """An output that wanders, jumps, stands still and turns."""
    rng = np.random.default_rng(seed)
    moves = rng.normal(0.0, 0.6, samples) + rng.choice([0.0, 0.0, 3.0, -3.0], samples, p=[0.5, 0.44, 0.03, 0.03])
    moves[rng.random(samples) < 0.15] = 0.0
    return np.cumsum(moves)


def published_he(op, fs, fd):
    """He's law by the accumulated force: u_r is what friction holds of the spring's force."""
    x = u_last = residual = 0.0
    path = []
    for u in op:
        force = residual + u - u_last
        if abs(force) > fs:
            residual = math.copysign(fd, force)
            x = u - residual
        else:
            residual = force
        u_last = u
        path.append(x)
    return np.array(path)


def published_kano(op, S, J):
    """Kano's flowchart: stp (at rest), u_s (input where it stopped), d (direction), from stp = 1, u_s = 0, d = 1."""
    x = u_last = move_last = u_s = 0.0
    at_rest, d = True, 1
    path = []
    for u in op:
        move = u - u_last
        if move * move_last <= 0.0 and not at_rest:
            u_s, at_rest = u_last, True
        if at_rest and -d * (u - u_s) > S:
            d, at_rest = -d, False
        elif at_rest and d * (u - u_s) > J:
            at_rest = False
        if not at_rest:
            x = u - d / 2.0 * (S - J)
        u_last, move_last = u, move
        path.append(x)
    return np.array(path)


@given(seed=st.integers(0, 10_000), fs=numbers(0.1, 4.0), share=numbers(0.0, 1.0))
def test_he_is_the_published_law(seed, fs, share):
    op = outputs(seed)
    np.testing.assert_allclose(valve_response(wb.He(fs, share * fs), op), published_he(op, fs, share * fs), atol=1e-9)


@given(seed=st.integers(0, 10_000), S=numbers(0.1, 6.0), share=numbers(0.01, 1.0))
def test_kano_is_the_published_law(seed, S, share):
    op = outputs(seed)
    np.testing.assert_allclose(valve_response(wb.Kano(S, share * S), op), published_kano(op, S, share * S), atol=1e-9)


@given(seed=st.integers(0, 10_000), d=numbers(0.0, 4.0))
def test_he_without_dynamic_friction_is_stenman(seed, d):
    op = outputs(seed)
    np.testing.assert_array_equal(valve_response(wb.He(d, 0.0), op), valve_response(wb.Stenman(d), op))


@given(seed=st.integers(0, 10_000), b=numbers(0.01, 6.0))
def test_dead_band_in_four_writings(seed, b):
    op = outputs(seed)
    stem = valve_response(wb.Deadband(b), op)
    np.testing.assert_array_equal(stem, valve_response(wb.Choudhury(b, 0.0), op))
    np.testing.assert_array_equal(stem, valve_response(wb.Directional(wb.Deadband(b), wb.Deadband(b)), op))
    # He's stem slips in every sample in which it would go on moving.
    np.testing.assert_allclose(stem, valve_response(wb.He(b / 2.0, b / 2.0), op), atol=1e-12)


@given(seed=st.integers(0, 10_000), S=numbers(0.1, 5.0), share=numbers(0.0, 1.0))
def test_kano_is_choudhury_after_the_first_reversal(seed, S, share):
    J = share * S
    # A swing that every stem follows both ways, and then anything.
    first = np.concatenate([np.linspace(0.0, 3.0 * S, 13), np.linspace(3.0 * S, -3.0 * S, 25)])
    op = np.concatenate([first, first[-1] + outputs(seed)])
    kano, choudhury = valve_response(wb.Kano(S, J), op), valve_response(wb.Choudhury(S, J), op)
    np.testing.assert_array_equal(kano[30:], choudhury[30:])


def test_kanos_first_slip_needs_the_jump_upward_and_the_band_downward():
    valve = wb.Kano(S=3.0, J=1.0)
    for op, slips in ([0.5, 1.0, 1.01], 2), ([-1.0, -3.0, -3.01], 2):
        moved = np.flatnonzero(valve_response(valve, np.array(op)))
        assert moved[0] == slips
    # Choudhury's band is centred: (S + J)/2 either way.
    assert not valve_response(wb.Choudhury(3.0, 1.0), np.array([2.0, -2.0])).any()


@given(
    seed=st.integers(0, 10_000),
    S=st.tuples(numbers(0.1, 5.0), numbers(0.1, 5.0)),
    share=st.tuples(numbers(0.0, 1.0), numbers(0.0, 1.0)),
)
def test_directional_law_with_equal_ways_and_seen_from_below(seed, S, share):
    op = outputs(seed)
    up, down = wb.Choudhury(S[0], share[0] * S[0]), wb.Choudhury(S[1], share[1] * S[1])
    np.testing.assert_array_equal(valve_response(wb.Directional(up, up), op), valve_response(up, op))
    mirrored = -valve_response(wb.Directional(down, up), -op)
    np.testing.assert_array_equal(valve_response(wb.Directional(up, down), op), mirrored)


def test_each_way_has_its_own_band_and_its_own_lag():
    valve = wb.Directional(up=wb.Choudhury(4.0, 1.0), down=wb.Choudhury(3.0, 2.0))
    ramp = np.concatenate([np.arange(0.0, 20.0, 0.001), np.arange(20.0, -20.0, -0.001), np.arange(-20.0, 20.0, 0.001)])
    x = valve_response(valve, ramp)
    at_top = 20_000
    turn_down = at_top + int(np.flatnonzero(np.diff(x[at_top:]))[0]) + 1
    turn_up = 60_000 + int(np.flatnonzero(np.diff(x[60_000:]))[0]) + 1
    # Moving: 1.5 behind upward, 0.5 downward. Reversals swallow 1.5 + 2.5 at the top, 0.5 + 2.5 at the bottom.
    assert ramp[at_top - 1] - x[at_top - 1] == pytest.approx(1.5)
    assert x[59_999] - ramp[59_999] == pytest.approx(0.5)
    assert 20.0 - ramp[turn_down] == pytest.approx(4.0, abs=0.002)
    assert ramp[turn_up] + 20.0 == pytest.approx(3.0, abs=0.002)
    assert abs(x[turn_down] - x[turn_down - 1]) == pytest.approx(2.0, abs=0.002)
    assert abs(x[turn_up] - x[turn_up - 1]) == pytest.approx(1.0, abs=0.002)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (wb.He(2.0, 0.0), wb.Stenman(2.0)),
        (wb.Directional(wb.Choudhury(3.0, 1.0), wb.Choudhury(3.0, 1.0)), wb.Choudhury(3.0, 1.0)),
    ],
)
def test_equal_laws_make_equal_loops_and_equal_cycles(one, other):
    loops = [wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), valve, wb.PID(1.0, 12.0), 1.0) for valve in (one, other)]
    runs = [wb.simulate(loop, wb.Experiment(500.0, wb.Step(4.0), noise=wb.Noise(0.02, 1))) for loop in loops]
    np.testing.assert_array_equal(runs[0].pv, runs[1].pv)
    np.testing.assert_array_equal(runs[0].branch, runs[1].branch)
    cycles = [wb.limit_cycle(loop) for loop in loops]
    assert cycles[0].outcome == cycles[1].outcome == "cycles"
    assert cycles[0].period == cycles[1].period
    assert cycles[0].pv_peak_to_peak == cycles[1].pv_peak_to_peak
