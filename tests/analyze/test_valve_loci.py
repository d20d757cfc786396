"""Describing functions of the valves against their own laws: exact integrals, and brute force on a sampled sine."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from workbench.analyze.valve_loci import locus_pieces, stenman_response, two_parameter_response
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman, Valve
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


@pytest.mark.parametrize("valve", [Choudhury(2.0, 0.5), Choudhury(2.0, 2.0), Choudhury(1.0, 1.6), Deadband(2.0)])
@pytest.mark.parametrize("A", [1.6, 2.3, 9.0])
def test_closed_form_equals_the_simulated_law(valve: Choudhury | Deadband, A: float) -> None:
    response = two_parameter_response(np.array([A]), valve.stick_band, valve.slip_jump)[0]
    # Stuck at -1 before, as an amplitude between S/2 and (S + J)/2 does not move a stem at rest in mid-band.
    assert response == pytest.approx(sampled_response(valve, A, rest_at=-1.0), abs=5e-4)


@pytest.mark.parametrize("A", [2.1, 3.9, 4.2, 5.5, 11.3])
def test_staircase_from_rest_equals_the_simulated_law(A: float) -> None:
    response = stenman_response(np.array([A]), 2.0, between=False)[0]
    assert response == pytest.approx(sampled_response(Stenman(2.0), A, periods=1), abs=5e-3)


@pytest.mark.parametrize("A", [1.01, 1.8, 2.9, 3.1, 6.4])
def test_staircase_between_two_stairs_equals_the_simulated_law(A: float) -> None:
    # Started on the stair next to the mean, the sampled stem drifts by its overshoots: one period shows the stairs.
    response = stenman_response(np.array([A]), 2.0, between=True)[0]
    top = 2.0 * math.floor(A / 2.0 + 0.5) - 1.0
    t = 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES
    x = valve_response(Stenman(2.0), A * np.cos(t), A, top)
    assert response == pytest.approx(
        complex(np.sum(x * np.cos(t)), -np.sum(x * np.sin(t))) * 2.0 / SAMPLES / A, abs=5e-3
    )


def test_a_big_swing_makes_every_valve_ideal() -> None:
    assert two_parameter_response(np.array([1e6]), 2.0, 0.5)[0] == pytest.approx(1.0, abs=1e-5)
    for between in (True, False):
        assert stenman_response(np.array([4e3]), 2.0, between=between)[0] == pytest.approx(1.0, abs=1e-3)


def test_a_swing_within_the_band_moves_nothing() -> None:
    assert two_parameter_response(np.array([0.99]), 2.0, 0.5)[0] == 0.0
    assert stenman_response(np.array([1.99]), 2.0, between=False)[0] == 0.0
    assert stenman_response(np.array([0.99]), 2.0, between=True)[0] == 0.0


@pytest.mark.parametrize(("S", "J"), [(2.0, 2.0), (2.0, 0.5), (1.0, 3.0)])
def test_a_jumping_locus_starts_on_the_imaginary_axis(S: float, J: float) -> None:
    start = -1.0 / two_parameter_response(np.array([S / 2.0]), S, J)[0]
    assert start == pytest.approx(-0.25j * math.pi * S / J, abs=1e-12)


def test_stenman_and_two_parameter_loci_start_alike() -> None:
    start = -1.0 / stenman_response(np.array([1.0]), 2.0, between=True)[0]
    assert start == pytest.approx(-0.25j * math.pi, abs=1e-7)


@pytest.mark.parametrize("valve", [Choudhury(2.0, 0.5), Choudhury(0.0, 1.0), Deadband(0.3), Stenman(2.0)])
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


@pytest.mark.parametrize("valve", [Ideal(), Stenman(0.0), Choudhury(0.0, 0.0), Deadband(0.0)])
def test_a_valve_without_friction_has_no_locus(valve: Valve) -> None:
    assert locus_pieces(valve) == ()
