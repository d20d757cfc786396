"""A stem with mass: against its equation integrated otherwise, against the law that it comes near to, on the bench."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from loops import late_cycles, paper_step
from scipy.integrate import solve_ivp

import workbench as wb
from workbench.simulate import kernel
from workbench.simulate.coefficients import valve_row
from workbench.simulate.run import valve_response

# Kayihan and Doyle's set with a tenth of its friction; after Garcia, with graphite packing.
SOFT = wb.Karnopp(1.36, 52_500.0, 0.0847, 142.3, 170.8, 612.0, 2.54e-4)
GRAPHITE = wb.Karnopp(1.6, 210_490.0, 0.029, 700.0, 780.0, 125_000.0, 5e-4)
FS, FC = SOFT.percent(170.8), SOFT.percent(142.3)


def loop_with(valve: wb.Karnopp, **parts) -> wb.Loop:
    given = {"plant": wb.FOPDT(1.0, 20.0, 3.0), "controller": wb.PID(0.5, 40.0), "sample_time": 1.0, **parts}
    return wb.Loop(valve=valve, **given)


@pytest.mark.parametrize("valve", [SOFT, GRAPHITE])
@pytest.mark.parametrize("beyond", [0.05, 1.0, 6.0])
def test_a_slip_is_the_equations_integrated_by_another_method(valve, beyond):
    u, Ts = valve.hold + beyond, 0.08
    U = u * valve.travel / 100.0

    def motion(_: float, state: np.ndarray) -> list[float]:
        X, V = state
        shape = valve.coulomb + (valve.static - valve.coulomb) * math.exp(-((V / valve.stribeck) ** 2))
        return [V, (valve.spring * (U - X) - shape - valve.viscous * V) / valve.mass]

    def stops(_: float, state: np.ndarray) -> float:
        return float(state[1])

    stops.terminal, stops.direction = True, -1.0  # type: ignore[attr-defined]
    exact = solve_ivp(motion, (0.0, Ts), [0.0, 1e-12], method="LSODA", rtol=1e-9, atol=1e-13, events=stops)
    wanted = 100.0 * exact.y[0, -1] / valve.travel
    ours = valve_response(replace(valve, substep=1e-6), np.array([u]), sample_time=Ts)[0]
    assert ours == pytest.approx(wanted, rel=2e-3)
    assert ours > 0.0


@pytest.mark.parametrize("valve", [SOFT, GRAPHITE])
def test_the_path_converges_as_the_substep_is_halved(valve):
    op = 1.3 * valve.stick_band * np.sin(np.arange(300) / 30.0)
    exact = valve_response(replace(valve, substep=1e-5), op)
    errors = [np.abs(valve_response(replace(valve, substep=h), op) - exact).max() for h in (8e-3, 4e-3, 2e-3, 1e-3)]
    for coarse, fine in pairwise(errors):
        assert fine < 0.8 * coarse
    assert errors[-1] < 2e-4 * valve.stick_band


@pytest.mark.parametrize("substep", [1.0, 0.1, 1e-3])
def test_it_is_stable_at_any_substep(substep):
    op = np.concatenate([np.full(200, 50.0), np.full(200, -50.0)])
    stem = valve_response(replace(SOFT, substep=substep), op)
    assert abs(stem[199] - 50.0) <= SOFT.hold
    assert abs(stem[-1] + 50.0) <= SOFT.hold
    assert np.abs(stem).max() <= 50.0


def test_compiled_and_python_take_the_same_path_to_the_bit():
    op = 12.0 * np.sin(np.arange(60) / 5.0)
    row, paths = valve_row(replace(SOFT, substep=5e-3), 0.1), []
    for slide in (kernel._slide, kernel._slide.py_func):
        state, x, path = np.zeros(kernel.STATES), 0.0, []
        for u in op:
            x, motion = slide(row, state, u, x)
            path += [x, motion, state[kernel.VELOCITY]]
        paths.append(path)
    assert paths[0] == paths[1]


def test_at_slow_sampling_it_comes_near_to_hes_law_with_its_forces():
    rng = np.random.default_rng(3)
    op = np.cumsum(rng.normal(0.0, 0.8, 400))
    ours, law = valve_response(SOFT, op), valve_response(wb.He(FS, FC), op)
    assert np.ptp(law) > 10.0
    # All that the Stribeck effect leaves where the stem lands; no slip is a sample off.
    assert np.abs(ours - law).max() < 0.01


def test_without_friction_the_stem_is_a_damped_spring():
    free = wb.Karnopp(1.0, 10_000.0, 0.1, 0.0, 0.0, 40.0, 1e-3, substep=1e-5)
    stem = valve_response(free, np.full(20, 10.0), sample_time=5e-3)
    t = 5e-3 * np.arange(1, 21)
    sigma, omega = 20.0, math.sqrt(10_000.0 - 400.0)
    exact = 10.0 * (1.0 - np.exp(-sigma * t) * (np.cos(omega * t) + sigma / omega * np.sin(omega * t)))
    np.testing.assert_allclose(stem, exact, atol=0.05)
    assert stem.max() > 14.0


def test_the_bench_shows_what_motion_makes_of_the_forces():
    soft, graphite = wb.signature(SOFT), wb.signature(GRAPHITE)
    # A quick stem lands where Coulomb friction alone holds it: S = f_s + f_c, J = f_s - f_c, but for little.
    assert soft.dead_band == pytest.approx(FS + FC, rel=0.01)
    assert soft.resolution == pytest.approx(FS - FC, rel=0.1)
    # Graphite's viscous friction leaves no jump, and all of the static friction twice as dead band.
    assert graphite.dead_band == pytest.approx(2.0 * GRAPHITE.hold, rel=0.01)
    assert graphite.resolution < 0.02


def test_the_long_run_equals_plain_simulation():
    loop, task = loop_with(SOFT), wb.Experiment(60_000.0, setpoint=wb.Step(4.0))
    start = wb.limit_cycle(loop, task).starts[0]
    assert start.outcome == "cycles"
    period, swing = late_cycles(wb.simulate(loop, task), 30_000.0)
    assert start.pv_peak_to_peak == pytest.approx(swing, rel=0.03)
    # The cycle drifts on for longer than this run.
    assert start.period == pytest.approx(period, rel=0.5)
    assert start.slips_per_hour > 0.0
    settles = wb.limit_cycle(loop_with(GRAPHITE), task).starts[0]
    assert settles.outcome == "settles"
    assert abs(wb.simulate(loop_with(GRAPHITE), task).pv[-1] - 4.0) < 1e-3


def test_fast_sampling_sees_the_stem_in_motion():
    loop = loop_with(GRAPHITE, sample_time=0.05)
    run = wb.simulate(loop, wb.Experiment(40.0, setpoint=wb.Step(60.0)))
    moving = run.branch % 3 - 1 != 0
    assert np.count_nonzero(moving) > 50
    np.testing.assert_array_equal(run.valve, valve_response(GRAPHITE, run.op, sample_time=0.05))


def test_methods_that_do_not_know_it_say_so():
    loop = loop_with(SOFT)
    with pytest.raises(wb.InvalidValue, match="depends on speed"):
        wb.describing_function(loop)
    assert wb.limit_cycle(loop).closed_form is None
    tuned = wb.tune(loop, paper_step(100.0), bounds=wb.Bounds(Td=(0, 0)), restarts=1, digits=2, max_evaluations=3000)
    assert "do not know the valve Karnopp" in tuned.message
    assert tuned.objective == wb.evaluate(loop.with_controller(tuned.controller), paper_step(100.0), wb.Objective())[0]


@pytest.mark.slow
def test_an_estimate_finds_the_band_of_a_valve_that_is_not_its_own_model():
    loop = loop_with(GRAPHITE, controller=wb.PID(1.0, 15.0))
    steps = [wb.Step(20.0), wb.Step(-27.0, at=900.0), wb.Step(18.0, at=1500.0)]
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=steps, noise=wb.Noise(0.25, 1)))
    found = wb.estimate(wb.Record(pv=run.pv, op=run.op, sp=run.sp, sample_time=1.0), plant="fopdt")
    assert found.verdict == "stiction"
    assert found.valve.stick_band == pytest.approx(wb.signature(GRAPHITE).dead_band, rel=0.03)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"mass": 0.0}, "Karnopp.mass"),
        ({"spring": -1.0}, "Karnopp.spring"),
        ({"travel": math.nan}, "Karnopp.travel"),
        ({"static": 100.0}, "Karnopp.static"),
        ({"coulomb": -1.0}, "Karnopp.coulomb"),
        ({"viscous": math.inf}, "Karnopp.viscous"),
        ({"stribeck": 0.0}, "Karnopp.stribeck"),
        ({"substep": 0.0}, "Karnopp.substep"),
    ],
)
def test_what_no_mechanism_has_is_refused(change, where):
    with pytest.raises(wb.InvalidValue) as caught:
        replace(SOFT, **change)
    assert caught.value.where == where


def test_a_substep_that_would_never_end_is_refused():
    with pytest.raises(wb.InvalidValue, match=r"Karnopp\.substep"):
        loop_with(replace(SOFT, substep=1e-6))
