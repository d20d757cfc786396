"""Margins of the sampled loop: against python-control, against what the definitions mean, and in batch."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from loops import PAPER_PLANT, controllers, numbers, paper_loop, plants

import workbench as wb
from workbench.analyze import margins_kernel
from workbench.analyze.frequency import linear_stable
from workbench.analyze.margins import loop_margins
from workbench.simulate.coefficients import coefficients

linear_loops = st.builds(
    wb.Loop, plant=plants, valve=st.just(wb.Ideal()), controller=controllers(), sample_time=st.sampled_from([0.5, 1.0])
)


def transfer_functions(plant, pid):
    """The sampled law at Ts = 1 built anew: backward integral, filtered difference, zero-order hold of the plant."""
    z = control.tf([1.0, 0.0], [1.0], 1.0)
    Tf = pid.Td / pid.derivative_filter
    C = pid.Kc * (1.0 + z / (z - 1.0) / pid.Ti)
    if pid.Td:
        C = C + pid.Kc * pid.Td * (z - 1.0) / ((Tf + 1.0) * z - Tf)
    whole = math.floor(plant.dead_time)
    f = plant.dead_time - whole
    if isinstance(plant, wb.FOPDT):
        a = math.exp(-1.0 / plant.time_constant)
        shares = [1.0 - a ** (1.0 - f), a ** (1.0 - f) - a]
    else:
        a, shares = 1.0, [1.0 - f, f]
    G = plant.gain * control.tf(shares, [1.0, -a], 1.0) * control.tf([1.0], [1.0] + [0.0] * (whole + 1), 1.0)
    return C, G


LOOPS = pytest.mark.parametrize(
    ("plant", "pid"),
    [
        (PAPER_PLANT, wb.PID(1.61, 12.2)),
        (PAPER_PLANT, wb.PID(1.53, 7.7, 0.33)),
        (wb.FOPDT(0.8, 20.0, 7.4), wb.PID(1.2, 25.0, 2.0, derivative_filter=math.inf)),
        (wb.FOPDT(2.0, 3.0, 11.3), wb.PID(0.2, 5.0)),
        (wb.Integrating(0.05, 3.6), wb.PID(1.5, 40.0, 1.5)),
    ],
)


@LOOPS
def test_as_python_control_finds_them(plant, pid):
    loop = wb.Loop(plant, wb.Ideal(), pid, 1.0)
    found = wb.margins(loop)
    C, G = transfer_functions(plant, pid)
    w = np.unique(np.concatenate([np.geomspace(1e-5, math.pi, 5000), np.linspace(1e-3, math.pi, 5000)]))[:-1]
    L = control.frequency_response(C * G, w).complex
    measured = control.stability_margins(control.frd(L, w), returnall=True)
    assert found.stable
    assert found.max_sensitivity == pytest.approx(1.0 / np.abs(1.0 + L).min(), rel=1e-4)
    assert found.gain_margin == pytest.approx(min(g for g in measured[0] if g > 1.0), rel=1e-4)
    assert found.phase_margin == pytest.approx(min(p % 360.0 for p in measured[1]), abs=0.01)
    S = 1.0 / abs(1.0 + control.frequency_response(C * G, np.array([found.frequency])).complex[0])
    assert found.max_sensitivity == pytest.approx(S, rel=1e-4)


@LOOPS
def test_the_step_response_of_the_repaired_loop_is_python_controls(plant, pid):
    run = wb.simulate(wb.Loop(plant, wb.Ideal(), pid, 1.0), wb.Experiment(150.0, wb.Step(2.0)))
    C, G = transfer_functions(plant, pid)
    closed = control.minreal(control.feedback(C * G, 1.0), verbose=False)
    theirs = control.forced_response(closed, np.arange(150.0), 2.0 * np.ones(150)).outputs
    assert np.abs(run.pv - theirs).max() < 1e-5


@given(loop=linear_loops, whole=st.integers(1, 40))
def test_the_delay_margin_is_the_dead_time_that_makes_the_loop_unstable(loop, whole):
    found = wb.margins(loop)
    if not found.stable:
        assert found.delay_margin == 0.0
        return
    # Whole samples of further dead time are a lag of just that, and nothing else.
    more = whole * loop.sample_time
    if abs(more / found.delay_margin - 1.0) > 0.02:
        later = replace(loop, plant=replace(loop.plant, dead_time=loop.plant.dead_time + more))
        if more < found.delay_margin:
            assert linear_stable(later)
        elif more < 1.5 * found.delay_margin:
            assert not linear_stable(later)


# So near its limit that two steps towards the peak ended 3e-5 short of it.
@example(
    loop=wb.Loop(
        wb.Integrating(1 / 64, 2.0), wb.Ideal(), wb.PID(1.0, 2.0, 1.0, derivative_filter=math.inf), sample_time=0.5
    )
)
@given(loop=linear_loops)
def test_the_gain_margin_is_where_the_loop_becomes_unstable(loop):
    found = wb.margins(loop)
    assert found.stable == linear_stable(loop)
    if not found.stable:
        assert (found.max_sensitivity, found.gain_margin, found.phase_margin) == (math.inf, 0.0, 0.0)
        return
    g = found.gain_margin
    # Far out it says nothing; at 1 the loop is so close to its limit that this may lie on either side (see AT_LIMIT).
    if not 1.0 < g < 1e3:
        return

    def stable_at(factor: float) -> bool:
        return linear_stable(loop.with_controller(replace(loop.controller, Kc=factor * loop.controller.Kc)))

    assert stable_at(g * (1.0 - 1e-6))
    assert not stable_at(g * (1.0 + 1e-6))
    if loop.plant.gain * loop.controller.signed_gain < 0.0:
        return
    assert found.max_sensitivity >= 1.0 - 1e-9
    # A circle of radius 1/Ms about -1 is kept free.
    if found.max_sensitivity > 1.0 + 1e-9:
        assert g >= found.max_sensitivity / (found.max_sensitivity - 1.0) * (1.0 - 1e-5)
        assert found.phase_margin >= math.degrees(2.0 * math.asin(0.5 / found.max_sensitivity)) * (1.0 - 1e-5)


@pytest.mark.parametrize(
    ("plant", "Ti"),
    [(wb.Integrating(0.05, 3.0), 5.918), (wb.FOPDT(1.0, 5.0, 1.0), 5.0), (wb.FOPDT(2.0, 3.0, 11.3), 8.0)],
)
@pytest.mark.parametrize("below", [1e-2, 1e-3, 1e-4, 1e-5])
def test_just_below_the_limit_all_margins_are_small(plant, Ti, below):
    low, high = 1e-3, 50.0
    for _ in range(60):
        Kc = math.sqrt(low * high)
        low, high = (Kc, high) if linear_stable(wb.Loop(plant, wb.Ideal(), wb.PID(Kc, Ti), 1.0)) else (low, Kc)
    loop = wb.Loop(plant, wb.Ideal(), wb.PID(low * (1.0 - below), Ti), 1.0)
    found = wb.margins(loop)
    assert found.stable
    assert found.gain_margin == pytest.approx(1.0 / (1.0 - below), abs=1e-8)
    C, G = transfer_functions(plant, loop.controller)
    w = found.frequency * np.linspace(1.0 - 20.0 * below, 1.0 + 20.0 * below, 2001)
    L = control.frequency_response(C * G, w).complex
    assert found.max_sensitivity == pytest.approx(1.0 / np.abs(1.0 + L).min(), rel=0.02 if below > 1e-5 else 0.5)
    # Of the response by another hand: the lag from -1 where |L| = 1, and the time that it is at that frequency.
    k = int(np.argmin(np.abs(np.abs(L) - 1.0)))
    assert found.phase_margin == pytest.approx(math.degrees(np.angle(-L[k])) % 360.0, rel=0.05)
    assert found.delay_margin == pytest.approx(math.radians(found.phase_margin) / w[k], rel=1e-2)
    # What the search for tunings reads of loops just beyond the limit says no other thing, whichever side it takes.
    beyond = loop.with_controller(wb.PID(low * (1.0 + 1e-5), Ti))
    values, _, stable = loop_margins(coefficients(beyond), 1.0)
    assert not stable[0] or (values[0, 1] == 1.0 and values[0, 2] == 0.0)


def test_a_controller_that_acts_the_wrong_way_is_unstable_where_its_gain_at_rest_is_one():
    for Td in (0.0, 0.5):
        loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Ideal(), wb.PID(0.5, math.inf, Td, action="direct"), 1.0)
        assert wb.margins(loop).gain_margin == pytest.approx(2.0, rel=1e-9)


def test_of_a_response_that_overflows_nothing_is_read():
    rows = np.repeat(coefficients(wb.Loop(PAPER_PLANT, wb.Ideal(), wb.PID(0.5, 20.0), 1.0)), 2, axis=0)
    rows[0, margins_kernel.KC] = math.nan
    values, at, stable = loop_margins(rows, 1.0)
    assert values[0].tolist() == [math.inf] * 3
    assert np.isfinite(at).all()
    assert stable.tolist() == [False, True]


def test_of_two_peaks_that_are_nearly_as_high_the_higher_is_told():
    plant = wb.FOPDT(2.8764044772270134, 11.961500407745712, 3.0)
    pid = wb.PID(0.15271001947125187, math.inf, 3.6971375741114985, form="parallel", derivative_filter=math.inf)
    found = wb.margins(wb.Loop(plant, wb.Ideal(), pid, 1.0))
    w = np.linspace(0.1, math.pi, 300_001)
    back, a = np.exp(-1j * w), math.exp(-1.0 / plant.time_constant)
    L = (pid.Kc + pid.Td * (1.0 - back)) * plant.gain * (1.0 - a) * back**4 / (1.0 - a * back)
    assert found.max_sensitivity == pytest.approx(1.0 / np.abs(1.0 + L).min(), rel=1e-6)
    assert found.frequency == pytest.approx(w[np.argmin(np.abs(1.0 + L))], abs=1e-4)


@given(loop=linear_loops, scale=numbers(0.1, 8.0))
def test_stability_read_off_the_response_agrees_where_it_counts(loop, scale):
    loop = loop.with_controller(replace(loop.controller, Kc=scale * loop.controller.Kc))
    values, _, stable = loop_margins(coefficients(loop), loop.sample_time)
    if values[0, 0] < 8.0:
        assert bool(stable[0]) == linear_stable(loop)


def test_many_loops_at_once_equal_each_alone():
    loops = [
        replace(paper_loop(k, 12.0, 0.3), plant=wb.FOPDT(1.0, 5.0, t)) for k in (0.5, 1.5) for t in (0.8, 1.0, 9.7)
    ]
    rows = np.concatenate([coefficients(loop) for loop in loops])
    values, at, stable = loop_margins(rows, 1.0)
    alone_values, alone_at, alone_stable = loop_margins(rows, 1.0, all_three=False)
    np.testing.assert_array_equal(alone_values[:, 0], values[:, 0])
    np.testing.assert_array_equal(alone_at, at)
    np.testing.assert_array_equal(alone_stable, stable)
    assert np.isinf(alone_values[:, 1:]).all()
    for loop, value, w in zip(loops, values, at, strict=True):
        alone = wb.margins(loop)
        if alone.stable:
            assert value == pytest.approx((alone.max_sensitivity, alone.gain_margin, alone.phase_margin), rel=5e-3)
            assert w == pytest.approx(alone.frequency, rel=2e-2)


@LOOPS
def test_the_response_that_is_read_is_python_controls_to_the_lowest_frequency(plant, pid):
    w = np.geomspace(1e-6, math.pi, 50)[:-1]
    turned, late, re, im = np.empty((2, w.size)), np.empty((2, w.size)), np.empty(w.size), np.empty(w.size)
    row = coefficients(wb.Loop(plant, wb.Ideal(), pid, 1.0))[0]
    margins_kernel._turned(w, turned)
    margins_kernel._lag(w, math.floor(plant.dead_time) + 1.0, late)
    margins_kernel._response(row, turned, late, re, im)
    C, G = transfer_functions(plant, pid)
    theirs = control.frequency_response(C, w).complex * control.frequency_response(G, w).complex
    # At 1e-6 theirs loses digits to 1 - cos w.
    np.testing.assert_allclose(re + 1j * im, theirs, rtol=2e-4)
    np.testing.assert_allclose((re + 1j * im)[w > 1e-3], theirs[w > 1e-3], rtol=1e-8)


def test_no_action_at_all_leaves_all_margins_open():
    found = wb.margins(paper_loop(0.0, 20.0))
    assert (found.stable, found.max_sensitivity) == (True, 1.0)
    assert math.isinf(found.gain_margin)
    assert math.isinf(found.phase_margin)
    assert math.isinf(found.delay_margin)
