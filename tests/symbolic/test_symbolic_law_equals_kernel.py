"""The symbolic loop and the kernel are two writings of one law: sample by sample, and over whole runs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from workbench.errors import InvalidValue
from workbench.model.controller import PID
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Integrating
from workbench.model.valve import Choudhury, Deadband, Directional, He, Ideal, Kano, Stenman
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients, rest
from workbench.symbolic.branch import Decisions
from workbench.symbolic.loop import (
    COEFFICIENTS,
    STATE,
    controller_function,
    given_function,
    given_run_function,
    law_function,
    plant_function,
    shape_of,
    valve_function,
)

AWAY = 1e-9


def real(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


valves = st.one_of(
    st.just(Ideal()),
    st.builds(Stenman, d=real(0.0, 4.0)),
    st.builds(lambda fs, share: He(fs, share * fs), fs=real(0.0, 4.0), share=real(0.0, 1.0)),
    st.builds(Choudhury, S=real(0.0, 4.0), J=real(0.0, 5.0)),
    st.builds(Deadband, b=real(0.0, 4.0)),
)
plants = st.one_of(
    st.builds(FOPDT, gain=real(0.2, 3.0), time_constant=real(1.0, 30.0), dead_time=real(0.0, 5.0)),
    st.builds(FOPDT, gain=real(-3.0, -0.2), time_constant=real(1.0, 30.0), dead_time=st.just(2.0)),
    st.builds(Integrating, gain=real(0.01, 0.5), dead_time=real(0.0, 5.0)),
)
controllers = st.builds(
    PID,
    Kc=real(0.0, 4.0),
    Ti=real(1.0, 100.0),
    Td=st.one_of(st.just(0.0), real(0.01, 5.0)),
    form=st.sampled_from(["ideal", "series"]),
    derivative_on=st.sampled_from(["error", "pv"]),
    derivative_filter=st.sampled_from([math.inf, 10.0, 3.0]),
    setpoint_weight=real(0.0, 1.0),
    action=st.sampled_from(["reverse", "direct"]),
    output_limits=st.sampled_from([None, (-3.0, 4.0), (0.0, 1.0)]),
    anti_windup=st.sampled_from(["clamp", "back_calculation"]),
    tracking_time=st.sampled_from([None, 2.0]),
)
loops = st.builds(Loop, plant=plants, valve=valves, controller=controllers, sample_time=st.sampled_from([0.5, 1.0]))


def column(row: np.ndarray) -> np.ndarray:
    return np.array([row[getattr(kernel, name)] for name in COEFFICIENTS])


def one_sample(row, state, past, r, load, noise):
    """Return the kernel's (state, past, u, x, branch) after one sample."""
    after, moved = state.copy(), past.copy()
    y, u, x, v, branch = np.empty(2), np.empty(1), np.empty(1), np.empty(1), np.empty(1, np.int8)
    signals = (np.array([r]), np.array([load]), np.array([noise]))
    kernel.run_loop(row, *signals, after, moved, y, u, x, v, branch)
    return after, moved, u[0], x[0], int(branch[0])


def distance_from_guards(loop: Loop, row: np.ndarray, state: np.ndarray, guards: np.ndarray) -> float:
    lead, move, first, step, after = guards
    gaps = [abs(abs(lead) - row[kernel.BAND])]
    if isinstance(loop.valve, Choudhury | Deadband) and state[kernel.MOTION] != 0.0:
        gaps.append(abs(move))
    if loop.controller.output_limits is not None:
        gaps += [abs(step)]
        gaps += [abs(out - limit) for out in (first, after) for limit in loop.controller.output_limits]
    return min(gaps)


def close(ours: np.ndarray, theirs: np.ndarray) -> bool:
    scale = max(1.0, float(np.abs(theirs).max(initial=0.0)))
    return bool(np.abs(np.asarray(ours) - theirs).max(initial=0.0) <= 1e-12 * scale)


@settings(deadline=None, max_examples=150)
@given(loop=loops, data=st.data())
def test_one_sample_from_a_random_state_equals_the_kernels(loop: Loop, data: st.DataObject) -> None:
    row = coefficients(loop)[0]
    shape = shape_of(loop)
    assert shape.delay == int(row[kernel.DELAY])
    some = real(-6.0, 6.0)
    state = np.array([data.draw(some) for _ in STATE])
    two = isinstance(loop.valve, Choudhury | Deadband)
    state[kernel.MOTION] = data.draw(st.sampled_from([-1.0, 0.0, 1.0])) if two else 0.0
    past = np.array([data.draw(some) for _ in range(shape.delay + 1)])
    r, load, noise = data.draw(some), data.draw(some), data.draw(real(-0.1, 0.1))
    after, moved, u, x, branch = one_sample(row, state, past, r, load, noise)
    taken = Decisions.from_branch(np.array([branch], dtype=np.int8))
    as_given = given_function(shape)(
        state, past, column(row), r, load, noise, int(taken.motion[0]), int(taken.limit[0]), int(taken.undone[0])
    )
    assume(distance_from_guards(loop, row, state, np.asarray(as_given[4]).ravel()) > AWAY)
    by_law = law_function(shape)(state, past, column(row), r, load, noise)
    assert int(by_law[4]) == branch
    # An ideal valve has no decision: the kernel calls it at rest, as the law function does.
    for result in (by_law, as_given):
        assert close(np.asarray(result[0]).ravel(), after)
        assert close(np.asarray(result[1]).ravel(), moved)
        assert close(np.array([float(result[2]), float(result[3])]), np.array([u, x]))


@settings(deadline=None, max_examples=40)
@given(loop=loops, data=st.data())
def test_the_parts_make_up_the_whole_sample(loop: Loop, data: st.DataObject) -> None:
    row, shape = coefficients(loop)[0], shape_of(loop)
    c = column(row)
    some = real(-6.0, 6.0)
    state = np.array([data.draw(some) for _ in STATE])
    state[kernel.MOTION] = 0.0
    past = np.array([data.draw(some) for _ in range(shape.delay + 1)])
    r = data.draw(some)
    u, i, d, s, _ = controller_function(shape)(
        c, state[kernel.I_TERM], state[kernel.D_TERM], state[kernel.S_LAST], r, state[kernel.Y]
    )
    x, motion = valve_function(shape)(c, u, state[kernel.U_LAST], state[kernel.X_LAST], state[kernel.MOTION])
    inputs = np.concatenate([[float(x)], past])
    y = plant_function()(c, state[kernel.Y], inputs[shape.delay], inputs[shape.delay + 1])
    whole = np.asarray(law_function(shape)(state, past, c, r, 0.0, 0.0)[0]).ravel()
    parts = np.array([float(v) for v in (i, d, s, u, x, motion, y)])
    assert np.array_equal(whole, parts)


@settings(deadline=None, max_examples=25)
@given(loop=loops, seed=st.integers(0, 1000))
def test_a_whole_run_with_its_decisions_given_equals_the_kernels(loop: Loop, seed: int) -> None:
    n = 60
    row, shape = coefficients(loop)[0], shape_of(loop)
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.uniform(-4.0, 4.0, 3), 20)
    load, noise = np.repeat(rng.uniform(-1.0, 1.0, 2), 30), rng.normal(0.0, 0.02, n)
    state, past = rest(row)
    y, u, x, v, branch = np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int8)
    start, start_past = state[: len(STATE)].copy(), past.copy()
    kernel.run_loop(row, r, load, noise, state, past, y, u, x, v, branch)
    # A loop that runs away has no digits left to compare.
    assume(float(np.abs(y).max()) < 1e6)
    taken = Decisions.from_branch(branch)
    assert np.array_equal(taken.branch, branch)
    states, outputs, stems, _ = given_run_function(shape, n)(
        start,
        start_past,
        column(row),
        *(signal[None, :] for signal in (r, load, noise)),
        *(decision.astype(float)[None, :] for decision in (taken.motion, taken.limit, taken.undone)),
    )
    scale = max(1.0, float(np.abs(y).max()), float(np.abs(u).max()))
    assert np.abs(np.asarray(outputs).ravel() - u).max() <= 1e-12 * scale * n
    assert np.abs(np.asarray(stems).ravel() - x).max() <= 1e-12 * scale * n
    assert np.abs(np.asarray(states)[STATE.index("Y")] - y[1:]).max() <= 1e-12 * scale * n


def test_a_given_decision_that_the_law_would_not_take_is_obeyed() -> None:
    loop = Loop(FOPDT(1.0, 5.0, 1.0), Stenman(2.0), PID(1.0, 10.0), 1.0)
    shape, c = shape_of(loop), column(coefficients(loop)[0])
    state, past = np.zeros(len(STATE)), np.zeros(shape.delay + 1)
    _, _, u, stuck, _ = given_function(shape)(state, past, c, 4.0, 0.0, 0.0, 0, 0, 0)
    _, _, _, moved, _ = given_function(shape)(state, past, c, 4.0, 0.0, 0.0, 1, 0, 0)
    assert float(u) == pytest.approx(4.4)
    assert (float(stuck), float(moved)) == (0.0, float(u))


@pytest.mark.parametrize("valve", [Kano(2.0, 1.0), Directional(Choudhury(2.0, 1.0), Choudhury(3.0, 1.0))])
def test_a_law_that_is_not_written_here_is_refused(valve: Kano | Directional) -> None:
    with pytest.raises(InvalidValue, match="no symbolic form"):
        shape_of(Loop(FOPDT(1.0, 5.0, 1.0), valve, PID(1.0, 10.0), 1.0))
