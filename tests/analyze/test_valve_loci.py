"""Describing functions of the valves against their own laws: exact integrals, and brute force on a sampled sine."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from workbench.analyze.valve_loci import directional_response, locus_pieces, staircase_response, two_parameter_response
from workbench.model.valve import Choudhury, Deadband, Directional, He, Ideal, Kano, Stenman, Valve
from workbench.simulate.run import valve_response

SAMPLES = 40_000


def sampled_response(valve: Valve, A: float, rest_at: float = 0.0, periods: int = 4) -> complex:
    """N(A) of the kernel's own law, from the last period of a finely sampled sine."""
    t = 2.0 * math.pi * np.arange(periods * SAMPLES) / SAMPLES
    x = valve_response(valve, A * np.sin(t), 0.0, rest_at)[-SAMPLES:]
    t = t[-SAMPLES:]
    return complex(np.sum(x * np.sin(t)), np.sum(x * np.cos(t))) * 2.0 / SAMPLES / A


def integrated_response(A: float, S: float, J: float) -> complex:
    """N(A) of the two-parameter stem by quadrature of its four segments in steady state (half of them, mirrored)."""
    s, offset = S / A, (S - J) / 2.0 / A
    slip = math.pi - math.asin(1.0 - s)

    def integral(low: float, high: float, stem: Callable[[float], float], wave: Callable[[float], float]) -> float:
        return quad(lambda t: stem(t) * wave(t), low, high, epsabs=1e-11, epsrel=1e-11)[0]

    def stuck(t: float) -> float:
        return 1.0 - offset

    def moving(t: float) -> float:
        return math.sin(t) + offset

    b1, a1 = (
        integral(math.pi / 2.0, slip, stuck, wave) + integral(slip, 1.5 * math.pi, moving, wave)
        for wave in (math.sin, math.cos)
    )
    return 2.0 / math.pi * complex(b1, a1)


@settings(deadline=None, max_examples=60)
@given(S=st.floats(0.01, 50.0), share=st.floats(0.0, 2.0), reach=st.floats(0.5001, 50.0))
def test_closed_form_equals_the_exact_integrals(S: float, share: float, reach: float) -> None:
    A = reach * S
    closed = two_parameter_response(np.array([A]), S, share * S)[0]
    assert closed == pytest.approx(integrated_response(A, S, share * S), abs=1e-9)


def integrated_directional_response(A: float, up: Choudhury, down: Choudhury) -> complex:
    """N(A) by quadrature of the four segments of a stem that differs by direction, from the leads that it slips at."""
    lag_up, lag_down = (up.S - up.J) / 2.0 / A, (down.S - down.J) / 2.0 / A
    slip_down = math.pi - math.asin(1.0 - lag_up - (down.S + down.J) / 2.0 / A)
    slip_up = 2.0 * math.pi + math.asin(-1.0 + lag_down + (up.S + up.J) / 2.0 / A)
    turn, end = 1.5 * math.pi, 2.5 * math.pi
    # From each angle to the next: the share of the sine in the stem, and the constant beside it.
    segments = [
        (0.5 * math.pi, slip_down, 0.0, 1.0 - lag_up),
        (slip_down, turn, 1.0, lag_down),
        (turn, slip_up, 0.0, lag_down - 1.0),
        (slip_up, end, 1.0, -lag_up),
    ]

    def fundamental(wave: Callable[[float], float]) -> float:
        return sum(
            quad(lambda t, m=m, c=c: (m * math.sin(t) + c) * wave(t), low, high, epsabs=1e-11, epsrel=1e-11)[0]
            for low, high, m, c in segments
        )

    return complex(fundamental(math.sin), fundamental(math.cos)) / math.pi


@settings(deadline=None, max_examples=60)
@given(
    S=st.tuples(st.floats(0.01, 20.0), st.floats(0.01, 20.0)),
    share=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
    reach=st.floats(1.01, 50.0),
)
def test_closed_form_by_direction_equals_the_exact_integrals(
    S: tuple[float, float], share: tuple[float, float], reach: float
) -> None:
    up, down = Choudhury(S[0], share[0] * S[0]), Choudhury(S[1], share[1] * S[1])
    A = reach * sum(S) / 2.0
    closed = directional_response(np.array([A]), Directional(up, down))[0]
    assert closed == pytest.approx(integrated_directional_response(A, up, down), abs=1e-9)


@pytest.mark.parametrize("A", [2.2, 3.1, 9.0])
@pytest.mark.parametrize("jump", [0.5, 3.5])
def test_closed_form_by_direction_equals_the_simulated_law(A: float, jump: float) -> None:
    # With the long jump the top reversal swallows next to nothing.
    valve = Directional(Choudhury(1.0, jump), Choudhury(2.0, 0.8))
    closed = directional_response(np.array([A]), valve)[0]
    assert closed == pytest.approx(sampled_response(valve, A, rest_at=-4.0), abs=5e-4)


def integrated_staircase(A: float, step: float, lag: float, between: bool) -> complex:
    """N(A) by the integrals over each stair, whose ends are found from the law itself: a slip at step + lag."""
    top = 0.5 * step if between else 0.0
    while top + step + lag <= A:
        top += step
    x, angle, moves = -top, -0.5 * math.pi, []
    while x + step + lag <= A and x < top:
        angle = math.asin((x + step + lag) / A)
        moves.append((angle, x))
        x += step
    # A quarter turn either side of the rise is the mirrored fall: twice the half turn from trough to crest.
    ends = [-0.5 * math.pi, *(at for at, _ in moves), 0.5 * math.pi]
    levels = [*(low for _, low in moves), x]
    b1 = sum(v * (math.cos(p) - math.cos(q)) for v, p, q in zip(levels, ends[:-1], ends[1:], strict=True))
    a1 = sum(v * (math.sin(q) - math.sin(p)) for v, p, q in zip(levels, ends[:-1], ends[1:], strict=True))
    return 2.0 * complex(b1, a1) / math.pi / A


@settings(deadline=None, max_examples=60)
@given(
    step=st.floats(0.05, 4.0),
    lag=st.floats(0.0, 4.0),
    stairs=st.integers(1, 30),
    part=st.floats(0.01, 0.99),
    between=st.booleans(),
)
def test_staircases_equal_the_exact_integrals(step: float, lag: float, stairs: int, part: float, between: bool) -> None:
    A = lag + step * (stairs + part - (0.5 if between else 0.0))
    closed = staircase_response(np.array([A]), step, lag, between=between)[0]
    assert closed == pytest.approx(integrated_staircase(A, step, lag, between), abs=1e-9)


@pytest.mark.parametrize("A", [2.1, 3.9, 4.2, 11.3])
def test_hes_staircase_from_rest_equals_the_simulated_law(A: float) -> None:
    # Finely sampled, the stem overshoots each stair by a little, which adds up from period to period.
    response = staircase_response(np.array([A]), 1.5, 0.5, between=False)[0]
    valve = He(2.0, 0.5)
    t = 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES
    # From the top stair at the crest on, the whole of one period.
    top = 1.5 * math.floor((A - 0.5) / 1.5)
    x = valve_response(valve, A * np.cos(t), A, top)
    sampled = complex(np.sum(x * np.cos(t)), -np.sum(x * np.sin(t))) * 2.0 / SAMPLES / A
    assert response == pytest.approx(sampled, abs=5e-3)


def test_a_fine_staircase_is_nearly_a_dead_band() -> None:
    for fs, fd in ((2.0, 0.5), (2.0, 1.9), (13.07, 12.19)):
        step = fs - fd
        A = fd + step * np.linspace(20.5, 60.0, 300)
        band = two_parameter_response(A, fs + fd, 0.0)
        for between in (True, False):
            assert np.abs(staircase_response(A, step, fd, between=between) - band).max() < 0.0125


def test_loci_agree_where_the_laws_do() -> None:
    def same(one: Valve, other: Valve) -> bool:
        pairs = zip(locus_pieces(one), locus_pieces(other), strict=True)
        return all(np.array_equal(p.N(p.amplitude(p.points)), q.N(q.amplitude(q.points))) for p, q in pairs)

    assert same(He(2.0, 0.0), Stenman(2.0))
    assert same(He(1.0, 1.0), Deadband(2.0))
    assert same(Kano(3.0, 1.0), Choudhury(3.0, 1.0))
    assert same(Deadband(2.0), Choudhury(2.0, 0.0))
    A = np.geomspace(1.6, 100.0, 50)
    equal = Directional(Choudhury(3.0, 1.0), Choudhury(3.0, 1.0))
    np.testing.assert_allclose(directional_response(A, equal), two_parameter_response(A, 3.0, 1.0), rtol=1e-12)


@pytest.mark.parametrize(
    "valve", [Choudhury(2.0, 0.5), Choudhury(2.0, 2.0), Choudhury(1.0, 1.6), Kano(2.0, 0.5), Deadband(2.0)]
)
@pytest.mark.parametrize("A", [1.6, 2.3, 9.0])
def test_closed_form_equals_the_simulated_law(valve: Choudhury | Deadband, A: float) -> None:
    response = two_parameter_response(np.array([A]), valve.stick_band, valve.slip_jump)[0]
    # Stuck at -1 before, as an amplitude between S/2 and (S + J)/2 does not move a stem at rest in mid-band.
    assert response == pytest.approx(sampled_response(valve, A, rest_at=-1.0), abs=5e-4)


@pytest.mark.parametrize("A", [2.1, 3.9, 4.2, 5.5, 11.3])
def test_staircase_from_rest_equals_the_simulated_law(A: float) -> None:
    response = staircase_response(np.array([A]), 2.0, between=False)[0]
    assert response == pytest.approx(sampled_response(Stenman(2.0), A, periods=1), abs=5e-3)


@pytest.mark.parametrize("A", [1.01, 1.8, 2.9, 3.1, 6.4])
def test_staircase_between_two_stairs_equals_the_simulated_law(A: float) -> None:
    # Started on the stair next to the mean, the sampled stem drifts by its overshoots: one period shows the stairs.
    response = staircase_response(np.array([A]), 2.0, between=True)[0]
    top = 2.0 * math.floor(A / 2.0 + 0.5) - 1.0
    t = 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES
    x = valve_response(Stenman(2.0), A * np.cos(t), A, top)
    assert response == pytest.approx(
        complex(np.sum(x * np.cos(t)), -np.sum(x * np.sin(t))) * 2.0 / SAMPLES / A, abs=5e-3
    )


def test_a_big_swing_makes_every_valve_ideal() -> None:
    assert two_parameter_response(np.array([1e6]), 2.0, 0.5)[0] == pytest.approx(1.0, abs=1e-5)
    for between in (True, False):
        assert staircase_response(np.array([4e3]), 2.0, between=between)[0] == pytest.approx(1.0, abs=1e-3)


def test_a_swing_within_the_band_moves_nothing() -> None:
    assert two_parameter_response(np.array([0.99]), 2.0, 0.5)[0] == 0.0
    assert staircase_response(np.array([1.99]), 2.0, between=False)[0] == 0.0
    assert staircase_response(np.array([0.99]), 2.0, between=True)[0] == 0.0


@pytest.mark.parametrize(("S", "J"), [(2.0, 2.0), (2.0, 0.5), (1.0, 3.0)])
def test_a_jumping_locus_starts_on_the_imaginary_axis(S: float, J: float) -> None:
    start = -1.0 / two_parameter_response(np.array([S / 2.0]), S, J)[0]
    assert start == pytest.approx(-0.25j * math.pi * S / J, abs=1e-12)


def test_stenman_and_two_parameter_loci_start_alike() -> None:
    start = -1.0 / staircase_response(np.array([1.0]), 2.0, between=True)[0]
    assert start == pytest.approx(-0.25j * math.pi, abs=1e-7)


@pytest.mark.parametrize(
    "valve",
    [
        Choudhury(2.0, 0.5),
        Choudhury(0.0, 1.0),
        Deadband(0.3),
        Stenman(2.0),
        He(2.0, 1.5),
        Kano(2.0, 0.5),
        Directional(Choudhury(2.0, 0.5), Choudhury(2.0, 0.5)),
    ],
)
def test_pieces_are_finite_and_ascend_from_the_least_amplitude_that_moves(valve: Valve) -> None:
    pieces = locus_pieces(valve)
    for piece in pieces:
        A = piece.amplitude(piece.points)
        locus = -1.0 / piece.N(A)
        assert (np.diff(A) > 0.0).all()
        assert np.isfinite(locus).all()
        # Continuous: no step much larger than the curve's own size there.
        assert (np.abs(np.diff(locus)) < 0.3 * np.abs(locus[:-1])).all()
    assert min(piece.amplitude(piece.points[:1])[0] for piece in pieces) == pytest.approx(
        valve.stick_band / 2.0, abs=1e-6
    )


@pytest.mark.parametrize(
    "valve", [Ideal(), Stenman(0.0), He(0.0, 0.0), Choudhury(0.0, 0.0), Kano(0.0, 0.0), Deadband(0.0)]
)
def test_a_valve_without_friction_has_no_locus(valve: Valve) -> None:
    assert locus_pieces(valve) == ()
