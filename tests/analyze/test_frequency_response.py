"""L(jw) and the linear loop's stability."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from workbench.analyze.frequency import (
    characteristic_polynomial,
    controller_response,
    linear_stable,
    loop_response,
    plant_response,
    roots_inside,
)
from workbench.model.controller import PID
from workbench.model.experiment import Experiment, Step
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Integrating
from workbench.model.valve import Ideal
from workbench.simulate.run import simulate

FREQUENCIES = np.geomspace(1e-3, 3.0, 50)


def test_series_form_is_the_product_of_its_factors() -> None:
    s = 1j * FREQUENCIES
    response = controller_response(PID(Kc=2.0, Ti=30.0, Td=4.0, form="series", derivative_filter=8.0), FREQUENCIES)
    assert response == pytest.approx(2.0 * (1.0 + 1.0 / (30.0 * s)) * (1.0 + 4.0 * s / (0.5 * s + 1.0)), rel=1e-12)


def test_unfiltered_derivative_and_missing_integral() -> None:
    response = controller_response(PID(Kc=2.0, Ti=math.inf, Td=3.0, derivative_filter=math.inf), FREQUENCIES)
    assert response == pytest.approx(2.0 * (1.0 + 3j * FREQUENCIES), rel=1e-12)


def test_direct_action_turns_the_sign() -> None:
    reverse, direct = PID(Kc=2.0, Ti=30.0), PID(Kc=2.0, Ti=30.0, action="direct")
    assert controller_response(direct, FREQUENCIES) == pytest.approx(-controller_response(reverse, FREQUENCIES))


def test_dead_time_turns_the_phase_alone() -> None:
    with_delay = plant_response(FOPDT(2.0, 5.0, 3.0), FREQUENCIES)
    without = plant_response(FOPDT(2.0, 5.0, 0.0), FREQUENCIES)
    assert with_delay / without == pytest.approx(np.exp(-3j * FREQUENCIES), rel=1e-12)


@pytest.mark.parametrize("plant", [FOPDT(2.0, 5.0, 1.37), Integrating(0.3, 2.21)])
def test_the_sampled_response_tends_to_the_continuous_one(plant: FOPDT | Integrating) -> None:
    loop = Loop(plant, Ideal(), PID(Kc=0.7, Ti=9.0, Td=1.5), 1e-4)
    sampled, exact = loop_response(loop, FREQUENCIES, sampling_delay=True)[0], loop_response(loop, FREQUENCIES)[0]
    assert sampled == pytest.approx(exact, rel=1e-3)


def test_the_sampled_response_lags_by_the_hold() -> None:
    loop = Loop(FOPDT(1.0, 50.0, 5.0), Ideal(), PID(Kc=0.7, Ti=math.inf), 2.0)
    w = np.array([0.05])
    lag = np.angle(loop_response(loop, w, sampling_delay=True)[0] / loop_response(loop, w)[0])
    assert lag[0] == pytest.approx(-0.05 * 2.0 / 2.0, rel=1e-2)


@settings(deadline=None, max_examples=60)
@given(
    Kc=st.floats(0.05, 3.0),
    Ti=st.one_of(st.just(math.inf), st.floats(1.0, 100.0)),
    Td=st.one_of(st.just(0.0), st.floats(0.1, 3.0)),
    n=st.sampled_from([3.0, 10.0, math.inf]),
    theta=st.floats(0.0, 6.0),
    integrating=st.booleans(),
)
def test_the_polynomial_is_the_recursion_that_the_simulation_obeys(
    Kc: float, Ti: float, Td: float, n: float, theta: float, integrating: bool
) -> None:
    plant = Integrating(0.1, theta) if integrating else FOPDT(1.0, 5.0, theta)
    controller = PID(Kc=Kc, Ti=Ti, Td=Td, derivative_filter=n, derivative_on="pv")
    loop = Loop(plant, Ideal(), controller, 1.0)
    pv = simulate(loop, Experiment(60.0, setpoint=Step(1.0))).pv
    polynomial = characteristic_polynomial(loop)
    # With a constant setpoint the recursion's right-hand side is constant once its terms have all begun.
    left = np.convolve(pv, polynomial, mode="valid")[polynomial.size :]
    assert np.ptp(left) <= 1e-9 * max(1.0, float(np.abs(pv).max()))


@settings(deadline=None, max_examples=200)
@given(st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=8))
def test_the_stability_test_agrees_with_the_roots(coefficients: list[float]) -> None:
    polynomial = np.array([1.0, *coefficients])
    largest = float(np.abs(np.roots(polynomial)).max(initial=0.0))
    assume(abs(largest - 1.0) > 1e-6)
    assert roots_inside(polynomial) == (largest < 1.0)


def test_stability_of_loops_known_by_heart() -> None:
    def loop(Kc: float, Ti: float = 20.0, action: str = "reverse", theta: float = 1.0) -> Loop:
        return Loop(FOPDT(1.0, 5.0, theta), Ideal(), PID(Kc=Kc, Ti=Ti, action=action), 1.0)

    assert linear_stable(loop(0.5))
    assert not linear_stable(loop(20.0))
    assert not linear_stable(loop(0.5, action="direct"))
    assert linear_stable(loop(0.0))
    assert linear_stable(loop(0.5, theta=300.0, Ti=300.0))
    assert not linear_stable(Loop(Integrating(1.0), Ideal(), PID(Kc=0.0, Ti=20.0), 1.0))
