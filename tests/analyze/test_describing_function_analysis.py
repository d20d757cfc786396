"""Crossings, distances and words of the describing-function analysis."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from workbench.analyze.describing_function import describing_function
from workbench.analyze.frequency import loop_response
from workbench.analyze.limit_cycle import limit_cycle
from workbench.analyze.valve_loci import two_parameter_response
from workbench.model.controller import PID
from workbench.model.experiment import Experiment, Step
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Integrating
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman, Valve

PAPER = Loop(FOPDT(1.0, 5.0, 1.0), Stenman(2.0), PID(Kc=0.5, Ti=20.0), 1.0)


def paper(Kc: float, Ti: float, Td: float = 0.0, valve: Valve | None = None) -> Loop:
    return replace(PAPER, valve=valve or PAPER.valve, controller=PID(Kc=Kc, Ti=Ti, Td=Td))


def test_a_relay_like_stem_on_an_integrator_with_dead_time_as_solved_by_hand() -> None:
    # Between two stairs -1/N = -(pi/4)(sqrt((2A/d)^2 - 1) + j), and L = (k/w) e^{-j(pi/2 + w theta)}.
    k, theta, d = 0.02, 20.0, 3.0
    df = describing_function(Loop(Integrating(k, theta), Stenman(d), PID(Kc=1.0, Ti=math.inf), 0.1))
    w = brentq(lambda w: k / w * math.cos(w * theta) - math.pi / 4.0, 1e-3, math.pi / 2.0 / theta)
    A = 0.5 * d / math.cos(w * theta)
    assert df.crossings[0].frequency == pytest.approx(w, rel=1e-8)
    assert df.crossings[0].amplitude == pytest.approx(A, rel=1e-8)
    assert df.crossings[0].stable
    assert df.period == pytest.approx(2.0 * math.pi / w, rel=1e-8)
    # |N| A is the fundamental of a square wave of height d/2.
    assert df.pv_amplitude == pytest.approx(2.0 * d / math.pi * k / w, rel=1e-8)
    assert df.distance == 0.0


@settings(deadline=None, max_examples=25)
@given(
    S=st.floats(0.1, 10.0),
    share=st.floats(0.02, 1.0),
    Kc=st.floats(0.05, 1.2),
    Ti=st.floats(3.0, 200.0),
    theta=st.floats(0.0, 3.0),
)
def test_every_crossing_is_one(S: float, share: float, Kc: float, Ti: float, theta: float) -> None:
    loop = Loop(Integrating(0.4, theta), Choudhury(S, share * S), PID(Kc=Kc, Ti=Ti), 0.5)
    df = describing_function(loop)
    # Integrating plants under PI cross whenever they are stable: their phase starts at -180 degrees, below the locus.
    assert df.predicts_cycle or not df.linear_stable
    for crossing in df.crossings:
        L, G = loop_response(loop, np.array([crossing.frequency]))
        N = two_parameter_response(np.array([crossing.amplitude]), S, share * S)
        assert 1.0 + N[0] * L[0] == pytest.approx(0.0, abs=1e-8)
        assert crossing.pv_amplitude == pytest.approx(crossing.amplitude * abs(N[0] * G[0]), rel=1e-9)
    assert [c.amplitude for c in df.crossings] == sorted(c.amplitude for c in df.crossings)


def test_self_regulating_plants_cross_where_the_phase_of_minus_90_degrees_lies_too_far_out() -> None:
    # No crossing needs Ti > tau + theta and |L| < pi S/(4 J) where L's phase is -90 degrees.
    def crosses(Ti: float, Kc: float) -> bool:
        return describing_function(paper(Kc, Ti, valve=Choudhury(2.0, 1.0))).predicts_cycle

    assert crosses(Ti=4.0, Kc=0.5)
    assert not crosses(Ti=20.0, Kc=0.5)
    w = brentq(lambda w: np.angle(1j * loop_response(paper(1.0, 60.0), np.array([w]))[0][0]), 0.05, 0.9)
    gain = abs(loop_response(paper(1.0, 60.0), np.array([w]))[0][0])
    limit = math.pi * 2.0 / (4.0 * 1.0) / gain
    assert not crosses(Ti=60.0, Kc=0.98 * limit)
    assert crosses(Ti=60.0, Kc=1.02 * limit)


@pytest.mark.parametrize("valve", [Stenman(2.0), Choudhury(2.0, 0.5), Deadband(2.0)])
def test_distance_is_the_least_on_a_brute_force_grid(valve: Valve) -> None:
    df = describing_function(paper(0.5, 20.0, valve=valve))
    assert not df.predicts_cycle
    grid = min(float(np.abs(df.L - point).min()) for point in df.locus)
    assert df.distance <= grid + 1e-12
    assert df.distance == pytest.approx(grid, rel=1e-2)
    L = loop_response(df.loop, np.array([df.distance_frequency]))[0][0]
    nearest = df.locus[int(np.argmin(np.abs(df.amplitudes - df.distance_amplitude)))]
    assert abs(L - nearest) == pytest.approx(df.distance, rel=2e-2)


def test_the_papers_first_two_cases_are_predicted_not_to_cycle() -> None:
    for Ti in (20.0, 200.0):
        df = describing_function(paper(0.5, Ti))
        assert not df.predicts_cycle
        assert math.isnan(df.period)
        assert df.linear_stable
        assert "do not cross" in df.verdict


def test_derivative_action_brings_the_loci_closer_as_the_paper_says() -> None:
    # Section III.B and Fig. 8: with Td = 6 s the loop's curve lies closer to the locus, without a crossing.
    plain, derivative = describing_function(paper(0.5, 20.0)), describing_function(paper(0.5, 20.0, 6.0))
    assert not derivative.predicts_cycle
    assert plain.distance == pytest.approx(0.336, abs=0.002)
    assert derivative.distance == pytest.approx(0.232, abs=0.002)


def test_case_4_is_predicted_to_cycle() -> None:
    df = describing_function(paper(2.01, 301.0))
    assert df.period == pytest.approx(13.4, abs=0.1)
    sampled = describing_function(paper(2.01, 301.0), sampling_delay=True)
    assert sampled.period == pytest.approx(13.8, abs=0.1)
    assert 2.0 * sampled.pv_amplitude == pytest.approx(1.04, abs=0.02)
    assert "13.8 s" in sampled.verdict


def test_a_dead_band_in_an_integrating_loop_swings_as_predicted() -> None:
    # A waveform close to a sine: the describing function's swing is then right, which holds both methods together.
    loop = Loop(Integrating(0.05, 1.0), Deadband(1.0), PID(Kc=2.0, Ti=30.0), 0.5)
    df, cycle = describing_function(loop, sampling_delay=True), limit_cycle(loop)
    assert [c.stable for c in df.crossings] == [True]
    assert 2.0 * df.pv_amplitude == pytest.approx(cycle.pv_peak_to_peak, rel=0.02)


def test_an_unstable_crossing_parts_swings_that_die_out_from_swings_that_grow() -> None:
    # A dead band keeps small swings of a linearly unstable loop from growing.
    loop = Loop(FOPDT(1.0, 5.0, 2.0), Deadband(1.0), PID(Kc=5.5, Ti=math.inf), 0.1)
    df = describing_function(loop)
    assert [c.stable for c in df.crossings] == [False]
    assert math.isnan(df.amplitude)
    assert "would not last" in df.verdict
    small, large = (
        limit_cycle(loop, Experiment(10.0, setpoint=Step(size))).starts[0] for size in (0.05 / 5.5, 30.0 / 5.5)
    )
    assert small.outcome == "settles"
    assert "unstable" in large.reason


def test_words_for_loops_that_the_method_says_nothing_about() -> None:
    idle = describing_function(paper(0.0, 20.0))
    assert "gain is 0" in idle.verdict
    assert not idle.predicts_cycle
    assert np.isfinite(idle.distance)
    ideal = describing_function(paper(0.5, 20.0, valve=Ideal()))
    assert "does not stick" in ideal.verdict
    assert ideal.locus.tolist() == [-1.0]
    assert "unstable" in describing_function(paper(20.0, 20.0, valve=Stenman(0.0))).verdict
    unstable = describing_function(paper(20.0, 20.0))
    assert not unstable.linear_stable
    assert "unstable with an ideal valve" in unstable.verdict


@pytest.mark.parametrize(("Kc", "Ti"), [(1e160, 20.0), (1e300, 20.0), (0.5, 1e-160)])
def test_the_distance_of_gains_beyond_all_use_is_theirs(Kc: float, Ti: float) -> None:
    df = describing_function(paper(Kc, Ti))
    assert not df.crossings
    # L is least at the Nyquist frequency, beside which the locus is as good as 0.
    assert df.distance == pytest.approx(np.abs(df.L).min(), rel=1e-9)
    assert df.distance_frequency == pytest.approx(math.pi, rel=1e-6)
    assert "unstable with an ideal valve" in df.verdict


@pytest.mark.parametrize(
    "loop", [paper(1e300, 1e-160), paper(0.5, 1e-320), paper(0.5, 20.0, 0.0, Choudhury(*[1e-320] * 2))]
)
def test_loci_that_no_number_holds_are_said(loop: Loop) -> None:
    df = describing_function(loop)
    assert math.isinf(df.distance)
    assert df.verdict.startswith("The numbers of this loop are too large or too small for its loci to be calculated")


def test_output_limits_too_narrow_for_the_cycle_are_said() -> None:
    loop = paper(2.01, 301.0)
    narrow = loop.with_controller(replace(loop.controller, output_limits=(-0.5, 0.5)))
    assert "output limits" in describing_function(narrow).verdict
    assert "output limits" not in describing_function(loop).verdict


def test_breaks_cut_the_locus_into_continuous_pieces() -> None:
    df = describing_function(paper(0.5, 20.0))
    assert df.breaks[0] == 0
    for first, stop in zip(df.breaks, [*df.breaks[1:], df.locus.size], strict=True):
        assert (np.diff(df.amplitudes[first:stop]) > 0.0).all()
        assert np.abs(np.diff(df.locus[first:stop])).max() < 0.2


@st.composite
def loops(draw: st.DrawFn) -> Loop:
    scale = st.floats(0.05, 20.0)
    gain = draw(scale) * draw(st.sampled_from([-1.0, 1.0]))
    theta = draw(st.one_of(st.just(0.0), st.floats(0.1, 40.0)))
    plant = draw(st.sampled_from([FOPDT(gain, draw(scale), theta), Integrating(0.1 * gain, theta)]))
    valve = draw(
        st.sampled_from(
            [
                Ideal(),
                Stenman(draw(scale)),
                Choudhury(draw(st.one_of(st.just(0.0), scale)), draw(st.one_of(st.just(0.0), scale))),
                Deadband(draw(scale)),
            ]
        )
    )
    controller = PID(
        Kc=draw(st.one_of(st.just(0.0), scale)),
        Ti=draw(st.one_of(st.just(math.inf), scale.map(lambda t: 10.0 * t))),
        Td=draw(st.one_of(st.just(0.0), scale)),
        form=draw(st.sampled_from(["ideal", "series"])),
        derivative_filter=draw(st.sampled_from([0.5, 10.0, math.inf])),
        action=draw(st.sampled_from(["reverse", "direct"])),
    )
    return Loop(plant, valve, controller, draw(st.floats(0.05, 5.0)))


@settings(deadline=None, max_examples=40)
@given(loop=loops(), sampling_delay=st.booleans())
def test_random_loops_have_finite_loci_and_a_verdict(loop: Loop, sampling_delay: bool) -> None:
    df = describing_function(loop, sampling_delay=sampling_delay)
    for values in (df.amplitudes, df.N, df.locus, df.frequencies, df.L):
        assert np.isfinite(values).all()
    assert np.isfinite(df.distance)
    assert df.verdict.endswith(".")
    assert "nan" not in df.verdict
    assert df.predicts_cycle == (len(df.crossings) > 0)
    assert math.isfinite(df.period) == any(c.stable for c in df.crossings)


def test_crossings_are_a_prediction_only_where_one_lasts():
    df = describing_function(paper(2.01, 301.0))
    assert df.prediction == "cycle"
    assert replace(df, period=math.nan).prediction == "unstable crossings only"
    assert replace(df, predicts_cycle=False, period=math.nan).prediction == "no cycle"
