"""Every figure on signals small enough to work out by hand, and on runs whose figures are known."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import paper_loop, paper_step

import workbench as wb
from workbench.kpi.kpis import last_event, measure, reversals, travel
from workbench.kpi.oscillation import autocorrelation, oscillation

PV = np.array([0.0, 1.0, 3.0, 5.0, 4.0, 4.0])
SP = np.full(6, 4.0)
OP = np.array([1.0, 2.0, 2.0, 0.0, 1.0, 1.0])
STEM = np.array([0.0, 2.0, 2.0, 0.0, 0.0, 1.0])


def test_figures_by_hand():
    k = measure(PV, 2.0, sp=SP, op=OP, valve=STEM, op_before=0.0, valve_before=0.0)
    error = [4, 3, 1, -1, 0, 0]
    assert k.mean_square_error == pytest.approx(27 / 6)
    assert k.error_variance == pytest.approx(27 / 6 - (7 / 6) ** 2)
    assert k.op_variance == pytest.approx(11 / 6 - (7 / 6) ** 2)
    assert k.valve_variance == pytest.approx(np.var(STEM))
    assert k.valve_travel == 5.0
    assert k.controller_travel == 5.0
    assert k.reversals == 2
    assert k.iae == 2.0 * sum(abs(e) for e in error)
    assert k.ise == 2.0 * 27
    assert k.final_error == 0.0
    assert k.pv_sd == pytest.approx(np.std(PV))


def test_a_window_counts_the_first_move_from_the_sample_before():
    k = measure(PV, 2.0, sp=SP, op=OP, valve=STEM, window=(6.0, 12.0))
    assert k.valve_travel == 2.0 + 0.0 + 1.0
    assert k.controller_travel == 2.0 + 1.0
    assert k.mean_square_error == pytest.approx(1 / 3)
    with pytest.raises(wb.InvalidValue, match="window"):
        measure(PV, 2.0, window=(8.0, 8.0))
    with pytest.raises(wb.InvalidValue, match="window"):
        measure(PV, 2.0, window=(0.0, 20.0))


def test_travel_and_reversals():
    assert travel(np.array([1.0, 3.0])) == 2.0
    assert travel(np.array([1.0, 3.0]), 0.0) == 3.0
    assert reversals(np.array([1.0, 1.0, 2.0, 1.5, 1.5, 0.0, 1.0]), 0.0) == 2
    assert reversals(np.zeros(3)) == 0
    assert reversals(np.array([1.0, 2.0, 2.0 + 1e-13, 2.0, 2.0 + 1e-13])) == 0


def test_overshoot_and_settling_of_a_step():
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Ideal(), wb.PID(2.5, 5.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(100.0, setpoint=[wb.Step(1.0), wb.Step(4.0, at=40.0)]))
    after = run.pv[40:] - 5.0
    assert run.kpis.overshoot == pytest.approx(100 * after.max() / 4.0)
    outside = np.flatnonzero(np.abs(after) > 0.08)
    assert run.kpis.settling_time == outside[-1] + 1
    down = wb.simulate(loop, wb.Experiment(100.0, setpoint=wb.Step(-4.0)))
    up = wb.simulate(loop, wb.Experiment(100.0, setpoint=wb.Step(4.0)))
    assert down.kpis.overshoot == pytest.approx(up.kpis.overshoot)


def test_the_settling_band_is_the_larger_of_two_per_cent_and_half_a_slip():
    loop = paper_loop(0.5, 20.0)
    assert last_event(loop, paper_step()).band == 1.0
    assert last_event(loop, wb.Experiment(10.0, setpoint=wb.Step(200.0))).band == 4.0
    assert last_event(loop, wb.Experiment(10.0)) is None
    load = last_event(loop, wb.Experiment(100.0, setpoint=wb.Step(4.0), load=wb.Step(-80.0, at=50.0)))
    assert (load.at, load.band) == (50.0, 1.6)
    assert (load.setpoint_step, load.setpoint_at, load.setpoint_stop) == (4.0, 0.0, 50.0)


@pytest.mark.parametrize("plant", [wb.FOPDT(1.0, 5.0, 1.0), wb.Integrating(0.2, 1.0)], ids=["flow", "level"])
def test_the_overshoot_of_a_setpoint_step_stays_where_a_load_steps_later(plant):
    loop = wb.Loop(plant, wb.Ideal(), wb.PID(2.5, 5.0), 1.0)
    step = wb.Step(4.0, at=10.0)
    alone = wb.simulate(loop, wb.Experiment(100.0, setpoint=step)).kpis
    loads = [wb.Step(1.0, at=150.0), wb.Step(-9.0, at=100.0), wb.Step(2.0)]
    later = wb.simulate(loop, wb.Experiment(250.0, setpoint=step, load=loads[:2]))
    assert alone.overshoot > 1.0
    assert later.kpis.overshoot == alone.overshoot
    assert later.kpis.settling_time != alone.settling_time
    # A load before it, or none of the setpoint at all.
    before = wb.simulate(loop, wb.Experiment(100.0, setpoint=step, load=loads[2]))
    assert before.kpis.overshoot == pytest.approx(25.0 * max(before.pv[10:].max() - 4.0, 0.0))
    assert math.isnan(wb.simulate(loop, wb.Experiment(100.0, load=loads[2])).kpis.overshoot)


def test_a_run_that_never_settles_says_infinity_and_one_without_a_step_nan():
    cycling = wb.simulate(paper_loop(20.0, 301.0), paper_step(100.0))
    assert cycling.kpis.settling_time == math.inf
    quiet = wb.simulate(paper_loop(0.5, 20.0), wb.Experiment(50.0))
    assert math.isnan(quiet.kpis.settling_time)
    assert math.isnan(quiet.kpis.overshoot)


def test_signals_without_setpoint_or_stem_have_no_such_figures():
    k = measure(PV, 2.0, op=OP)
    assert math.isnan(k.error_variance)
    assert math.isnan(k.valve_travel)
    assert k.controller_travel == 4.0
    with_stem = measure(PV, 2.0, sp=SP, op=OP, valve=STEM)
    assert with_stem.valve_travel == 5.0
    assert with_stem.mean_square_error == pytest.approx(27 / 6)


@pytest.mark.parametrize("period", [7.3, 25.0, 120.0])
def test_a_sinusoid_has_index_one_and_its_period(period):
    t = np.arange(3000.0)
    index, found = oscillation(np.sin(2 * np.pi * t / period), 1.0)
    assert index > 0.95
    assert found == pytest.approx(period, rel=0.01)
    _, scaled = oscillation(np.sin(2 * np.pi * t / period), 10.0)
    assert scaled == pytest.approx(10 * period, rel=0.01)


def test_noise_has_a_small_index_and_noise_on_a_cycle_a_lesser_one():
    rng = np.random.default_rng(1)
    noise = [oscillation(rng.normal(size=2000), 1.0)[0] for _ in range(40)]
    assert np.median(noise) < 0.3
    cycle = np.sin(2 * np.pi * np.arange(2000) / 40)
    clean, noisy = oscillation(cycle, 1.0)[0], oscillation(cycle + rng.normal(size=2000), 1.0)[0]
    assert clean > noisy > 0.4


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60))
def test_oscillation_never_fails_and_stays_in_range(values):
    index, period = oscillation(np.array(values), 1.0)
    assert 0.0 <= index <= 1.0
    assert math.isnan(period) == (index == 0.0) or period > 0.0


def test_autocorrelation_of_a_constant_is_zero():
    assert not autocorrelation(np.full(10, 0.1 + 0.2)).any()
    assert autocorrelation(np.array([1.0, -1.0]))[0] == 1.0


@pytest.mark.parametrize("duration", [600.0, 2000.0])  # squares overflow; the signals themselves
def test_a_run_that_diverged_has_infinite_figures(duration):
    run = wb.simulate(paper_loop(30.0, 20.0), paper_step(duration))
    k = run.kpis
    sizes = {f.name: getattr(k, f.name) for f in fields(k)}
    assert (sizes.pop("oscillation_index"), math.isnan(sizes.pop("oscillation_period"))) == (0.0, True)
    assert sizes.pop("reversals") > 0
    assert set(sizes.values()) == {math.inf}
    # What is not there stays nan.
    alone = measure(run.pv, 1.0, op=run.op)
    assert (alone.pv_sd, alone.controller_travel) == (math.inf, math.inf)
    assert math.isnan(alone.mean_square_error)
    assert math.isnan(alone.valve_travel)
