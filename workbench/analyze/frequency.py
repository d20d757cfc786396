"""The loop's linear part in the frequency domain, and whether the loop with an ideal valve is stable.

`L(jw)` is controller times plant, with the signs of the controller's action and of a fail-open valve: the loop with a
valve of describing function N has the characteristic equation `1 + N L = 0`. Setpoint weight and output limits play no
part in it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.model.controller import PID
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import FloatArray
from workbench.simulate.coefficients import discretise

__all__ = [
    "characteristic_polynomial",
    "controller_response",
    "linear_stable",
    "loop_response",
    "plant_response",
    "roots_inside",
    "sampled_plant_response",
]

ComplexArray = NDArray[np.complex128]


def controller_response(controller: PID, frequency: FloatArray) -> ComplexArray:
    """Return `C(jw) = s Kc (1 + 1/(jw Ti) + jw Td/(jw Tf + 1))`, shape (F,), %/EU; s = -1 for direct action.

    frequency: rad/s, > 0, shape (F,). Any form is taken through its exact ideal terms; the derivative counts in full,
    wherever it acts, as both places feed PV back alike. Raises `InvalidValue` where there is no ideal equivalent.
    """
    terms = controller.ideal_terms()
    s = 1j * frequency
    actions = 1.0 + 1.0 / terms.Ti / s + s * terms.Td / (s * terms.Tf + 1.0)
    C: ComplexArray = np.multiply(controller.signed_gain * terms.Kc, actions)
    return C


def plant_response(plant: Plant, frequency: FloatArray) -> ComplexArray:
    """Return `G(jw)`, shape (F,), EU/%, with the dead time exact."""
    s = 1j * frequency
    lag = plant.time_constant * s + 1.0 if isinstance(plant, FOPDT) else s
    G: ComplexArray = plant.gain * np.exp(-plant.dead_time * s) / lag
    return G


def sampled_controller_response(loop: Loop, frequency: FloatArray) -> ComplexArray:
    """Return the sampled controller's own response at `z = exp(jw Ts)` (the law of `simulate.kernel`), shape (F,).

    Here and below Ts is the time between its executions.
    """
    terms, Ts = loop.controller.ideal_terms(), loop.executed.sample_time
    back = np.exp(-1j * frequency * Ts)
    C: ComplexArray = (
        loop.controller.signed_gain
        * terms.Kc
        * (1.0 + Ts / terms.Ti / (1.0 - back) + terms.Td * (1.0 - back) / (terms.Tf + Ts - terms.Tf * back))
    )
    return C


def sampled_plant_response(loop: Loop, frequency: FloatArray) -> ComplexArray:
    """Return the pulse transfer function of zero-order hold and plant at `z = exp(jw Ts)`, shape (F,), exact."""
    Ts = loop.executed.sample_time
    step = discretise(loop.plant, Ts)
    back = np.exp(-1j * frequency * Ts)
    G: ComplexArray = (
        loop.direction * step.gain * (step.c0 + step.c1 * back) * back ** (step.delay + 1) / (1.0 - step.pole * back)
    )
    return G


@np.errstate(over="ignore", invalid="ignore")  # of a gain beyond all use it is inf or nan
def loop_response(
    loop: Loop, frequency: FloatArray, *, sampling_delay: bool = False
) -> tuple[ComplexArray, ComplexArray]:
    """Return (L, G) at `frequency` (rad/s, > 0, shape (F,)), each of shape (F,).

    Continuous by default, as the describing function is taught. With `sampling_delay` both are the sampled loop's own,
    hold included: exact for signals at the samples up to the Nyquist frequency pi/Ts. Raises `InvalidValue`.
    """
    if sampling_delay:
        G = sampled_plant_response(loop, frequency)
        return sampled_controller_response(loop, frequency) * G, G
    G = loop.direction * plant_response(loop.plant, frequency)
    return controller_response(loop.controller, frequency) * G, G


@np.errstate(over="ignore", invalid="ignore")  # whose roots lie far outside then
def characteristic_polynomial(loop: Loop) -> FloatArray:
    """Return the closed loop's characteristic polynomial in z, highest power first, for an ideal valve.

    It is that of the sampled loop that the kernel runs, without output limits; a controller without integral (or
    without derivative) has no state for it.
    """
    terms, Ts = loop.controller.ideal_terms(), loop.executed.sample_time
    step = discretise(loop.plant, Ts)
    # Polynomials in 1/z, lowest power first, so that they read as the law's differences.
    one, difference = np.array([1.0]), np.array([1.0, -1.0])
    integrates = math.isfinite(terms.Ti) and terms.Kc != 0.0
    summing = difference if integrates else one
    filtering = np.array([terms.Tf + Ts, -terms.Tf]) if terms.Td != 0.0 else one
    numerator = np.convolve(summing, filtering)
    if integrates:
        numerator = _sum(numerator, Ts / terms.Ti * filtering)
    if terms.Td != 0.0:
        numerator = _sum(numerator, terms.Td * np.convolve(summing, difference))
    denominator = np.convolve(np.convolve(summing, filtering), np.array([1.0, -step.pole]))
    forward = np.concatenate([np.zeros(step.delay + 1), np.convolve(numerator, np.array([step.c0, step.c1]))])
    gain = loop.controller.signed_gain * terms.Kc * loop.direction * step.gain
    # Roots at z = 0 (the delay's, where nothing feeds back) are stable and only cost time.
    return np.trim_zeros(_sum(denominator, gain * forward), "b")


def _sum(a: FloatArray, b: FloatArray) -> FloatArray:
    total = np.zeros(max(a.size, b.size))
    total[: a.size] += a
    total[: b.size] += b
    return total


def roots_inside(polynomial: FloatArray) -> bool:
    """Return whether all roots of a real polynomial (highest power first) lie inside the unit circle.

    By the Schur-Cohn (Jury) recursion, which decides without finding the roots, so that long dead times cost little.
    """
    a = polynomial / polynomial[0]
    while a.size > 1:
        k = a[-1] / a[0]
        if not abs(k) < 1.0:
            return False
        a = a[:-1] - k * a[:0:-1]
        a = a / a[0]
    return True


def linear_stable(loop: Loop) -> bool:
    """Return whether the loop with an ideal valve is asymptotically stable.

    Decided on the sampled loop that the simulation runs, exactly: all roots of its characteristic polynomial inside the
    unit circle, which is what the Nyquist criterion counts.
    """
    return roots_inside(characteristic_polynomial(loop))
