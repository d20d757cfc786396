"""The relaxation cycle in closed form: by hand, against exact cycles at their own split, and where it stops."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from loops import numbers, paper_loop, paper_step

import workbench as wb
from workbench.analyze.limit_cycle import standard_starts
from workbench.analyze.long_run import follow
from workbench.analyze.relaxation import relaxation_cycle


def test_cases_1_and_2_by_hand() -> None:
    # m = 1 sample of dead time; PV then lacks a/(1 - a) samples more: L = 1 + .8187/.1813 = 5.517 s.
    a = math.exp(-0.2)
    lag = 1.0 + a / (1.0 - a)
    assert relaxation_cycle(paper_loop(0.5, 20.0)).period == pytest.approx(4.0 * (20.0 + lag))
    assert relaxation_cycle(paper_loop(0.5, 200.0)).period == pytest.approx(4.0 * (200.0 + lag))
    assert relaxation_cycle(paper_loop(0.5, 20.0), split=0.1).period == pytest.approx((20.0 + lag) / 0.09)
    cycle = relaxation_cycle(paper_loop(0.5, 200.0))
    assert cycle is not None
    # Half an OP step beyond the band: Kc Ts/Ti K d/2 / 2 = .00125.
    assert cycle.stem_move == pytest.approx(2.0 + 0.00125, abs=1e-5)
    assert cycle.pv_peak_to_peak == pytest.approx(cycle.stem_move)


def test_fine_sampling_gives_the_continuous_formula() -> None:
    loop = replace(paper_loop(0.5, 20.0), sample_time=1e-4)
    assert relaxation_cycle(loop).period == pytest.approx(4.0 * (20.0 + 5.0 + 1.0), rel=1e-4)
    integrating = wb.Loop(wb.Integrating(0.02), wb.Stenman(1.0), wb.PID(Kc=2.0, Ti=400.0), 1e-4)
    # Y = S/Kc, T = 4 S/(Kc K J): no integral time in it.
    cycle = relaxation_cycle(integrating)
    assert cycle is not None
    assert cycle.period == pytest.approx(4.0 / (2.0 * 0.02), rel=1e-4)
    assert cycle.pv_peak_to_peak == pytest.approx(0.5, rel=1e-4)


def test_the_exact_cycles_of_the_paper() -> None:
    assert relaxation_cycle(paper_loop(0.5, 20.0)).period == pytest.approx(
        wb.limit_cycle(paper_loop(0.5, 20.0), paper_step()).period, rel=0.005
    )
    # From the start that lies halfway between two stem positions.
    assert wb.limit_cycle(paper_loop(0.5, 200.0)).period_range[0] == pytest.approx(822.07, abs=0.2)


def test_a_two_parameter_stem_moves_on_until_pv_answers() -> None:
    loop = replace(paper_loop(0.4, 30.0), valve=wb.Choudhury(2.0, 1.0), plant=wb.FOPDT(1.0, 8.0, 6.0))
    closed = relaxation_cycle(loop)
    assert closed is not None
    assert closed.stem_move == pytest.approx(1.0 / (1.0 - 0.4 / 30.0 * 6.5 / 2.0))
    exact = wb.limit_cycle(loop)
    assert exact.closed_form == closed
    assert exact.closed_form_period == closed.period
    assert exact.period == pytest.approx(closed.period, rel=0.01)
    assert exact.pv_peak_to_peak == pytest.approx(closed.pv_peak_to_peak, rel=0.01)
    assert exact.mean_square_error == pytest.approx(closed.mean_square_error, rel=0.02)


@pytest.mark.parametrize(
    "loop",
    [
        paper_loop(0.5, math.inf),
        paper_loop(0.95, 20.0),
        paper_loop(0.5, 5.9),
        paper_loop(0.5, 20.0, 40.0, derivative_filter=10.0),
        paper_loop(0.5, 20.0, action="direct"),
        replace(paper_loop(0.5, 20.0), valve=wb.Deadband(2.0)),
        replace(paper_loop(0.5, 20.0), valve=wb.Ideal()),
        wb.Loop(wb.Integrating(0.02, 2.0), wb.Stenman(1.0), wb.PID(Kc=2.0, Ti=20.0), 1.0),
        wb.Loop(wb.Integrating(0.02, 2.0), wb.Stenman(1.0), wb.PID(Kc=2.0, Ti=400.0, Td=3.0), 1.0),
        wb.Loop(wb.Integrating(0.02, 8.0), wb.Stenman(1.0), wb.PID(Kc=5.0, Ti=400.0), 1.0),
        wb.Loop(wb.Integrating(0.02, 2.0), wb.Choudhury(1.0, 0.02), wb.PID(Kc=2.0, Ti=400.0), 1.0),
        wb.Loop(wb.Integrating(0.02, 2.0), wb.Choudhury(1.0, 0.9), wb.PID(Kc=2.0, Ti=400.0, Td=1.0), 1.0),
        wb.Loop(wb.Integrating(0.02, 2.0), wb.Deadband(1.0), wb.PID(Kc=2.0, Ti=400.0), 1.0),
    ],
)
def test_it_stops_where_its_conditions_do(loop: wb.Loop) -> None:
    assert relaxation_cycle(loop) is None


@pytest.mark.parametrize("split", [0.0, 1.0, -0.2, math.nan])
def test_a_setpoint_beyond_the_two_positions_is_refused(split: float) -> None:
    with pytest.raises(wb.InvalidValue, match="split"):
        relaxation_cycle(paper_loop(0.5, 20.0), split)


@st.composite
def slow_loops(draw: st.DrawFn) -> wb.Loop:
    tau, share = draw(numbers(8.0, 60.0)), draw(numbers(0.0, 1.5))
    K, S = draw(numbers(0.3, 3.0)), draw(numbers(0.3, 8.0))
    valve = draw(st.sampled_from([wb.Stenman(S), wb.Choudhury(S, S * draw(numbers(0.1, 1.0)))]))
    plant = draw(st.sampled_from([wb.FOPDT(K, tau, share * tau), wb.Integrating(K / tau, share * tau)]))
    Td = draw(st.sampled_from([0.0, 0.3])) * tau
    return wb.Loop(plant, valve, wb.PID(Kc=draw(numbers(0.05, 1.5)) / K, Ti=tau * draw(numbers(1.0, 30.0)), Td=Td), 1.0)


@pytest.mark.slow
@settings(max_examples=60)
@given(loop=slow_loops())
def test_exact_cycles_follow_the_closed_form_at_their_own_split(loop: wb.Loop) -> None:
    assume(relaxation_cycle(loop) is not None)
    start = standard_starts(loop)[1]
    exact = follow(loop, start)
    # Two slips a half cycle are another cycle, and sliding onto the setpoint is none.
    assume(exact.outcome == "cycles" and exact.slips_per_hour < 1.01 * exact.reversals_per_hour)
    # A stem that lands where PV hardly errs rests for longer than is traced.
    assume(exact.waveform is not None)
    assert exact.waveform is not None
    low, high = exact.waveform.valve.min(), exact.waveform.valve.max()
    balance = start.given.r[-1] / loop.plant.gain if isinstance(loop.plant, wb.FOPDT) else 0.0
    split = (balance - start.given.load[-1] - low) / (high - low)
    assume(0.05 < split < 0.95)
    closed = relaxation_cycle(loop, float(split))
    assume(closed is not None)
    assert closed is not None
    assert exact.waveform.time[-1] == pytest.approx(closed.period, rel=0.07)
    assert high - low == pytest.approx(closed.stem_move, rel=0.1)
    assert exact.pv_peak_to_peak == pytest.approx(closed.pv_peak_to_peak, rel=0.07)


@pytest.mark.parametrize(("plant", "Ti"), [(wb.FOPDT(1.0, 8.0, 2.0), 300.0), (wb.Integrating(0.02, 2.0), 2000.0)])
def test_hes_stem_sticks_at_once_but_has_a_wider_band(plant: wb.FOPDT | wb.Integrating, Ti: float) -> None:
    loop = wb.Loop(plant, wb.He(2.0, 1.0), wb.PID(0.8, Ti), 1.0)
    starts = [start for start in wb.limit_cycle(loop).starts if start.waveform is not None]
    assert starts
    for start in starts:
        x = start.waveform.valve
        split = float((x[:-1].mean() - x.min()) / (x.max() - x.min()))
        closed = relaxation_cycle(loop, split)
        assert closed is not None
        assert start.period == pytest.approx(closed.period, rel=0.02)
        assert start.pv_peak_to_peak == pytest.approx(closed.pv_peak_to_peak, rel=0.02)


def test_unlike_directions_have_no_closed_form() -> None:
    ways = wb.Directional(wb.Choudhury(2.0, 1.0), wb.Choudhury(2.0, 1.5))
    assert relaxation_cycle(replace(paper_loop(0.5, 20.0), valve=ways)) is None


@pytest.mark.parametrize(
    "loop",
    [
        wb.Loop(wb.FOPDT(1.0, 1e17, 1.0), wb.Stenman(1.0), wb.PID(1.0, 20.0), 1.0),
        wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.He(1e160, 1e159), wb.PID(0.5, 20.0), 1.0),
        wb.Loop(wb.FOPDT(1e-30, 5.0, 1.0), wb.Stenman(1e-300), wb.PID(0.7, 10.0), 1.0),
    ],
)
def test_values_beyond_what_floats_hold_end_in_no_traceback(loop: wb.Loop) -> None:
    closed = relaxation_cycle(loop)
    assert closed is None or closed.period > 0.0
