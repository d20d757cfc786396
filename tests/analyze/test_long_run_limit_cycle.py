"""The exact limit cycle: published cases to the figures that long runs gave, and every way to come to rest."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import loops, paper_loop, paper_step

import workbench as wb
from workbench.analyze.half_cycles import fresh_carry
from workbench.analyze.limit_cycle import standard_starts
from workbench.analyze.long_run import follow
from workbench.simulate.events import (
    END,
    HALF_CYCLE,
    SLIPS,
    SQUARES,
    START,
    STEM_TRAVEL,
    Y_HIGH,
    Y_LOW,
    collect,
)
from workbench.simulate.kernel import STAIRS


def test_case_1_cycles_as_long_runs_say() -> None:
    cycle = wb.limit_cycle(paper_loop(0.5, 20.0), paper_step())
    assert cycle.outcome == "cycles"
    assert cycle.starts[0].first_period == 340.0
    assert 101.5 < cycle.period < 103.5
    assert cycle.pv_peak_to_peak == pytest.approx(2.01, abs=0.01)
    assert cycle.mean_square_error == pytest.approx(0.813, abs=0.005)
    assert cycle.closed_form_period == pytest.approx(102.07, abs=0.01)
    # Each of a cycle's two reversals is one slip.
    assert cycle.reversals_per_hour == pytest.approx(2.0 * 3600.0 / cycle.period)
    assert cycle.slips_per_hour == pytest.approx(cycle.reversals_per_hour)
    assert cycle.share == 1.0
    # The stem moves by J twice a cycle.
    assert cycle.travel_per_hour == pytest.approx(2.0 * 2.01 * 3600.0 / cycle.period, rel=0.01)
    assert "cycles" in cycle.verdict
    assert "340 s" in cycle.verdict


def test_case_2_takes_eight_hours_a_cycle() -> None:
    cycle = wb.limit_cycle(paper_loop(0.5, 200.0), paper_step())
    assert cycle.outcome == "cycles"
    assert cycle.starts[0].first_period == 30_493.0
    assert cycle.period == pytest.approx(28_887.0, rel=1e-3)
    assert cycle.period_range[0] == pytest.approx(822.0, abs=1.0)
    assert cycle.closed_form_period == pytest.approx(822.07, abs=0.01)
    assert cycle.window > 30_493.0


def test_the_given_experiment_alone_comes_to_the_same_cycle() -> None:
    loop, step = paper_loop(0.5, 20.0), paper_step()
    whole, alone = wb.limit_cycle(loop, step), wb.limit_cycle(loop, step, others=False)
    assert len(alone.starts) == 1
    for name in ("outcome", "period", "pv_peak_to_peak", "mean_square_error", "travel_per_hour", "window"):
        assert getattr(alone, name) == getattr(whole, name)
    # Without an experiment there is nothing else to follow.
    assert len(wb.limit_cycle(loop, others=False).starts) == len(standard_starts(loop))


def test_case_4_and_5_cycle_fast() -> None:
    fourth = wb.limit_cycle(paper_loop(2.01, 301.0), paper_step())
    assert fourth.period == pytest.approx(13.7, abs=0.1)
    assert fourth.pv_peak_to_peak == pytest.approx(1.24, abs=0.01)
    assert math.isnan(fourth.closed_form_period)
    fifth = wb.limit_cycle(paper_loop(1.32, 196.0, 1.0, derivative_filter=10.0), paper_step())
    assert fifth.period == pytest.approx(19.65, abs=0.1)
    assert fifth.pv_peak_to_peak == pytest.approx(1.49, abs=0.01)


def test_the_noise_of_an_experiment_plays_no_part() -> None:
    noisy = replace(paper_step(), noise=wb.Noise(sd=0.5, seed=3))
    with_noise, without = (wb.limit_cycle(paper_loop(0.5, 20.0), e) for e in (noisy, paper_step()))
    assert with_noise.starts == without.starts


def test_the_last_value_of_a_profile_is_held_and_the_clock_starts_there() -> None:
    late = wb.Experiment(900.0, setpoint=[wb.Step(4.0, at=700.0)])
    cycle = wb.limit_cycle(paper_loop(0.5, 20.0), late)
    assert cycle.starts[0].first_period == 340.0
    assert cycle.window == wb.limit_cycle(paper_loop(0.5, 20.0), paper_step()).window


def test_late_figures_are_those_of_a_plain_simulation() -> None:
    loop = paper_loop(2.01, 301.0)
    cycle = wb.limit_cycle(loop, paper_step())
    run = wb.simulate(loop, paper_step(60_000.0))
    tail = slice(30_000, None)
    moves = np.diff(run.valve[tail])
    at = np.flatnonzero(moves) + 1
    turns = at[1:][np.sign(moves[at[1:] - 1]) != np.sign(moves[at[:-1] - 1])]
    assert cycle.period == pytest.approx(2.0 * float(np.diff(turns).mean()), rel=0.01)
    assert cycle.mean_square_error == pytest.approx(float(np.mean((4.0 - run.pv[tail]) ** 2)), rel=0.15)
    assert cycle.travel_per_hour == pytest.approx(float(np.abs(moves).sum()) / 30_000.0 * 3600.0, rel=0.02)


def test_an_ideal_valve_settles() -> None:
    cycle = wb.limit_cycle(replace(paper_loop(0.5, 20.0), valve=wb.Ideal()))
    assert cycle.outcome == "settles"
    assert math.isnan(cycle.period)
    assert all(math.isnan(value) for value in cycle.period_range)
    assert cycle.verdict == "The loop settles: PV comes to rest on the setpoint."


def test_proportional_control_settles_with_an_offset() -> None:
    cycle = wb.limit_cycle(paper_loop(0.5, math.inf), wb.Experiment(100.0, setpoint=wb.Step(6.0)))
    # The step's kick moves the stem to u = 3, and there it stays: e = 3, u = 1.5.
    assert cycle.outcome == "settles"
    assert "an error of +3 EU" in cycle.starts[0].reason
    assert "no integral action" in cycle.verdict


def test_no_gain_leaves_everything_where_it_is() -> None:
    assert wb.limit_cycle(paper_loop(0.0, 20.0)).outcome == "settles"
    integrating = wb.Loop(wb.Integrating(0.1), wb.Stenman(1.0), wb.PID(Kc=0.0, Ti=20.0), 1.0)
    cycle = wb.limit_cycle(integrating)
    assert cycle.outcome == "undecided"
    assert "no feedback" in cycle.verdict


@pytest.mark.parametrize("valve", [wb.Ideal(), wb.Stenman(2.0), wb.Choudhury(2.0, 0.5)])
def test_an_unstable_loop_is_said_to_be_one(valve: wb.Ideal | wb.Stenman | wb.Choudhury) -> None:
    cycle = wb.limit_cycle(replace(paper_loop(20.0, 20.0), valve=valve))
    assert cycle.outcome == "undecided"
    assert "the loop is unstable: PV grows without bound" in cycle.verdict


def test_positive_feedback_is_unstable_too() -> None:
    assert "unstable" in wb.limit_cycle(paper_loop(0.5, 20.0, action="direct")).verdict


def test_output_limits_end_a_cycle() -> None:
    # The limit lies within the stick band: the stem never moves.
    loop = paper_loop(0.5, 20.0, output_limits=(-1.5, 1.5))
    cycle = wb.limit_cycle(loop, wb.Experiment(100.0, setpoint=wb.Step(1.0)))
    assert cycle.outcome == "settles"
    assert "OP is at its limit" in cycle.starts[0].reason
    runaway = wb.Loop(wb.Integrating(0.1), wb.Stenman(2.0), wb.PID(Kc=1.0, Ti=20.0, output_limits=(-1.0, 1.0)), 1.0)
    drifting = wb.limit_cycle(runaway, wb.Experiment(100.0, load=wb.Step(0.5)))
    assert drifting.outcome == "undecided"
    assert "drifts away" in drifting.verdict


def test_a_stem_that_lands_exactly_on_the_setpoint_rests() -> None:
    # u_0 = Kc (1 + Ts/Ti) r = r/K: the first slip is the last, as the integral then moves OP by less than d.
    loop = wb.Loop(wb.FOPDT(1.0, 5.0), wb.Stenman(3.0), wb.PID(Kc=1.0 / 1.2, Ti=5.0), 1.0)
    landing = wb.limit_cycle(loop, wb.Experiment(50.0, setpoint=wb.Step(4.0)))
    assert landing.starts[0].outcome == "settles"
    assert landing.starts[0].reason == "PV comes to rest on the setpoint"
    # Where OP's rest is off the stem, the slip misses the setpoint, and the integral forces another one.
    assert all(start.outcome == "cycles" for start in landing.starts if "off the stem" in start.name)
    assert "other starts it cycles" in landing.verdict


def test_nothing_happens_where_nothing_is_done() -> None:
    assert wb.limit_cycle(paper_loop(0.5, 20.0), wb.Experiment(50.0)).starts[0].outcome == "settles"


def test_a_two_parameter_stem_may_slide_onto_the_setpoint_depending_on_the_start() -> None:
    loop = replace(paper_loop(0.5, 20.0), valve=wb.Choudhury(2.0, 0.5))
    cycle = wb.limit_cycle(loop)
    assert cycle.outcome == "depends"
    assert "depends on the start" in cycle.verdict
    assert cycle.pv_peak_to_peak == pytest.approx(0.511, abs=0.005)
    given_start = wb.limit_cycle(loop, paper_step())
    assert given_start.outcome == "settles"
    assert math.isnan(given_start.period)
    assert "other starts it cycles" in given_start.verdict


def test_an_integrating_loop_with_integral_action_cycles() -> None:
    loop = wb.Loop(wb.Integrating(0.05, 2.0), wb.Stenman(1.0), wb.PID(Kc=2.0, Ti=60.0), 1.0)
    cycle = wb.limit_cycle(loop)
    assert cycle.outcome == "cycles"
    assert cycle.period_range[0] == pytest.approx(cycle.closed_form_period, rel=0.03)
    assert cycle.period_range[0] <= cycle.period <= cycle.period_range[1]


def test_progress_rises_to_one() -> None:
    seen: list[float] = []
    wb.limit_cycle(paper_loop(0.5, 20.0), paper_step(), progress=seen.append)
    assert seen == sorted(seen)
    assert seen[0] == 0.0
    assert seen[-1] == 1.0


def test_starts_stay_within_the_output_limits_and_the_stick_band() -> None:
    loop = paper_loop(0.5, 20.0, output_limits=(-3.0, 2.0))
    for start in standard_starts(loop):
        assert -2.4 - 1e-9 <= start.given.r[-1] <= 1.6 + 1e-9
        assert abs(start.stem_offset) <= loop.valve.hold
    assert len(standard_starts(paper_loop(0.5, 20.0))) == 8


def test_an_experiment_that_does_not_fit_is_refused() -> None:
    with pytest.raises(wb.InvalidValue, match="stem_offset"):
        wb.limit_cycle(paper_loop(0.5, 20.0), replace(paper_step(), stem_offset=5.0))


@settings(max_examples=60)
@given(
    stem=st.lists(st.integers(-3, 3), min_size=2, max_size=60),
    cuts=st.lists(st.integers(1, 20), min_size=1, max_size=60),
)
def test_half_cycles_run_from_reversal_to_reversal_however_the_run_is_cut(stem: list[int], cuts: list[int]) -> None:
    x = np.array(stem, dtype=np.float64)
    y, u, r = np.sin(np.arange(x.size + 1.0)), np.cos(np.arange(x.size * 1.0)), 0.3
    moves = np.diff(x, prepend=0.0)
    branch = (np.sign(moves) + 4.0).astype(np.int8)
    carry, found, first = fresh_carry(0.0), [], 0
    for cut in cuts * 60:
        part = slice(first, first + cut)
        rows = np.empty((u[part].size, HALF_CYCLE))
        count = collect(STAIRS, y[first:], u[part], x[part], branch[part], r, first, 1e-9, carry, rows)
        found.append(rows[:count])
        first += cut
        if first >= x.size:
            break
    halves = np.concatenate(found)
    at = np.flatnonzero(moves)
    turns = [k for before, k in pairwise(at) if moves[before] * moves[k] < 0.0]
    begins = [*at[:1], *turns]
    assert halves[:, END].tolist() == turns
    assert halves[:, START].tolist() == begins[: len(turns)]
    for row in halves:
        inside = slice(int(row[START]), int(row[END]))
        assert row[Y_HIGH] == y[inside].max()
        assert row[Y_LOW] == y[inside].min()
        assert row[SQUARES] == pytest.approx(float(((r - y[inside]) ** 2).sum()))
        assert row[STEM_TRAVEL] == np.abs(moves[inside]).sum()
        assert row[SLIPS] == np.count_nonzero(moves[inside])


@settings(max_examples=25)
@given(loop=loops)
def test_random_loops_end_in_a_verdict_with_figures_that_fit_it(loop: wb.Loop) -> None:
    start = standard_starts(loop)[0]
    found = follow(loop, start)
    assert found.outcome in ("settles", "cycles", "undecided")
    assert found.reason
    figures = (found.period, found.pv_peak_to_peak, found.op_peak_to_peak, found.mean_square_error, found.window)
    if found.outcome == "cycles":
        assert all(value > 0.0 and math.isfinite(value) for value in figures)
    else:
        assert all(math.isnan(value) for value in figures)


@pytest.mark.slow
@settings(max_examples=30)
@given(
    tau=st.floats(20.0, 60.0),
    theta=st.floats(0.0, 1.0),
    d=st.floats(0.3, 5.0),
    gain=st.floats(0.1, 0.65),
    slowness=st.floats(2.0, 20.0),
)
def test_pi_with_a_stenman_valve_always_cycles(
    tau: float, theta: float, d: float, gain: float, slowness: float
) -> None:
    controller = wb.PID(Kc=gain / 1.7, Ti=slowness * tau * (1.0 + theta))
    loop = wb.Loop(wb.FOPDT(1.7, tau, theta * tau), wb.Stenman(d), controller, 1.0)
    cycle = wb.limit_cycle(loop)
    assert cycle.outcome == "cycles"
    shortest = cycle.period_range[0]
    assert shortest == pytest.approx(cycle.closed_form_period, rel=0.06)


def test_a_stuck_stem_under_a_constant_error_is_not_called_settled():
    # Sampled so finely that the whole budget ends before the integral action has pushed the stem over its band.
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), sample_time=1e-3)
    found = wb.limit_cycle(loop, wb.Experiment(1.0, setpoint=wb.Step(4.0)))
    assert found.starts[0].outcome in {"undecided", "cycles"}


def test_a_waveform_is_one_late_cycle() -> None:
    cycle = wb.limit_cycle(paper_loop(0.5, 20.0), paper_step())
    wave = cycle.starts[0].waveform
    assert wave is not None
    assert wave.time[0] == 0.0
    assert wave.time[-1] == pytest.approx(cycle.period, rel=0.03)
    assert wave.pv.shape == wave.op.shape == wave.valve.shape == wave.time.shape
    assert float(np.ptp(wave.pv)) == pytest.approx(cycle.pv_peak_to_peak, rel=0.01)
    assert float(np.ptp(wave.op)) == pytest.approx(cycle.op_peak_to_peak, rel=0.01)
    # It starts with the stem's move upward, holds one move down, and ends with the next move upward.
    assert np.sign(np.diff(wave.valve))[np.diff(wave.valve) != 0.0].tolist() == [-1.0, 1.0]
    # The sampled controller's own law holds within it.
    e = 4.0 - wave.pv
    np.testing.assert_allclose(np.diff(wave.op), 0.5 * (np.diff(e) + e[1:] / 20.0), atol=1e-9)


def test_a_waveform_of_hours_leaves_samples_out() -> None:
    wave = wb.limit_cycle(paper_loop(0.5, 200.0), paper_step()).starts[0].waveform
    assert wave is not None
    assert 200 < wave.time.size < 600
    assert wave.time[-1] == pytest.approx(28_887.0, rel=0.01)


def test_where_it_settles_is_told() -> None:
    cycle = wb.limit_cycle(paper_loop(0.5, math.inf), wb.Experiment(100.0, setpoint=wb.Step(6.0)))
    rest = cycle.starts[0]
    assert (rest.rest_pv, rest.rest_stem, rest.rest_error) == pytest.approx((3.0, 3.0, 3.0))
    assert rest.waveform is None
    assert math.isnan(cycle.starts[0].slips_per_hour)
    assert cycle.share < 1.0
    assert math.isnan(wb.limit_cycle(paper_loop(20.0, 20.0)).share)


def test_a_slide_onto_the_setpoint_is_told_by_its_way() -> None:
    loop = replace(paper_loop(0.5, 20.0), valve=wb.Choudhury(2.0, 0.5))
    found = wb.limit_cycle(loop, paper_step()).starts[0]
    assert found.reason == "the stem slides onto the setpoint without turning"
    assert abs(found.rest_error) < 0.02
    # So does the plain simulation.
    run = wb.simulate(loop, wb.Experiment(100_000.0, setpoint=wb.Step(4.0)))
    assert abs(run.final_sp - run.final_pv) < 1e-6
    assert run.kpis.reversals <= 1


def test_periods_of_a_drifting_cycle_lie_within_the_stated_range() -> None:
    cycle = wb.limit_cycle(paper_loop(0.5, 20.0, 6.0))
    for start in cycle.starts:
        if start.outcome == "cycles":
            assert cycle.period_range[0] <= start.period_range[0] <= start.period <= start.period_range[1]
            assert start.period_range[1] <= cycle.period_range[1]
    assert cycle.starts[3].period_range[1] > 1.05 * cycle.starts[3].period_range[0]
    assert "on how long the loop has been cycling" in cycle.verdict


def test_a_cycle_far_beyond_the_budget_of_samples_is_followed() -> None:
    # One slip takes some ten million samples.
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 2e6), 1.0)
    cycle = wb.limit_cycle(loop)
    assert cycle.outcome == "cycles"
    assert cycle.period_range[0] == pytest.approx(cycle.closed_form_period, rel=0.01)
    assert cycle.period > 7e6


def test_rounding_moves_no_level_that_has_come_to_rest() -> None:
    # A stem that slides onto the load's place is off it by a rounding, which moves PV in thousand million s.
    plant, pid = wb.Integrating(0.01, 4.0), wb.PID(5.68182, 242.915, derivative_on="pv")
    loop = wb.Loop(plant, wb.Deadband(3.0), pid, 2.0)
    slid = [start for start in wb.limit_cycle(loop).starts if start.outcome == "settles"]
    assert len(slid) == 3
    assert all(start.reason == "the stem slides onto the setpoint without turning" for start in slid)
    for load, setpoint in ((-8.1, 1.43), (18.6, -3.27)):
        run = wb.simulate(loop, wb.Experiment(100_000.0, wb.Step(setpoint), wb.Step(load)))
        assert np.count_nonzero(np.diff(run.valve[5000:])) == 0
        assert abs(run.sp[-1] - run.pv[-1]) < 1e-12
    for start in wb.limit_cycle(loop).starts:
        assert start.outcome == "settles" or start.first_period < 2000.0
