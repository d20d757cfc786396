"""`wb.apply_rule`: the controller that a published tuning rule gives for a loop.

The formulas' sources stand with the rules themselves, in `model.rule`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
from scipy import optimize

from workbench.analyze.describing_function import meeting_gain
from workbench.analyze.frequency import linear_stable, sampled_plant_response
from workbench.errors import InvalidValue
from workbench.model.checks import instance, number, whole
from workbench.model.controller import PID
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import FloatArray
from workbench.model.rule import Amigo, DetunedIntegral, Lambda, NoCrossing, Rule, Simc, ZieglerNichols
from workbench.simulate.coefficients import discretise

__all__ = ["apply_rule", "ultimate_point"]

Settings = tuple[float, float, float]  # Kc without its sign (%/EU), Ti and Td (s) of the ideal form


def apply_rule(loop: Loop, rule: Rule, *, digits: int | None = None) -> PID:
    """Return the controller that a rule gives for a loop's plant (and valve, for `NoCrossing`).

    The controller keeps its form, structure, filter, action and limits: the rule's ideal settings are converted
    exactly. digits: significant digits (1..12) to round Kc, Ti and Td to in the controller's own form, or None. A
    `DetunedIntegral` changes Ti alone and rounds nothing. Raises `InvalidValue` where the rule does not apply, and
    where the form has no equivalent.
    """
    instance(loop, Loop, "loop", "a Loop")
    instance(rule, get_args(Rule), "rule", "one of " + ", ".join(kind.__name__ for kind in get_args(Rule)))
    if digits is not None:
        number(whole(digits, "apply_rule.digits"), "apply_rule.digits", least=1, most=12)
    if isinstance(rule, DetunedIntegral):
        if math.isinf(loop.controller.Ti):
            raise _refused(rule, "a controller without integral action", "there is no integral time to detune")
        return replace(loop.controller, Ti=rule.factor * loop.controller.Ti)
    if loop.controller.signed_gain * loop.gain < 0.0:
        needed = "direct" if loop.gain < 0.0 else "reverse"
        behind = " behind a fail-open valve" if loop.fail_open else ""
        given = f"{loop.controller.action} action with a plant gain of {loop.plant.gain:g}{behind}"
        raise _refused(rule, given, f"a plant of this sign needs action {needed}")
    try:
        found = _settings(loop, rule)
    except ArithmeticError:
        K, theta = loop.plant.gain, loop.plant.dead_time
        allowed = "its numbers are too large or too small for the rule's settings to be calculated"
        raise _refused(rule, f"a plant of gain {K:g} with a dead time of {theta:g} s", allowed) from None
    controller = loop.controller.with_ideal(*found)
    if digits is None:
        return controller
    Kc, Ti, Td = (float(f"{value:.{digits}g}") for value in (controller.Kc, controller.Ti, controller.Td))
    return replace(controller, Kc=Kc, Ti=Ti, Td=Td)


def _settings(loop: Loop, rule: Simc | Lambda | Amigo | ZieglerNichols | NoCrossing) -> Settings:
    if isinstance(rule, Simc):
        return _simc(loop.plant, rule)
    if isinstance(rule, Lambda):
        return _lambda(loop.plant, rule)
    if isinstance(rule, Amigo):
        return _amigo(loop.plant, rule)
    if isinstance(rule, ZieglerNichols):
        return _step(loop.plant, rule) if rule.method == "step" else _ultimate(loop, rule)
    return _no_crossing(loop, rule)


def _refused(rule: Rule, given: str, allowed: str) -> InvalidValue:
    return InvalidValue(f"rule {rule.name}", given, allowed)


def _dead_time(plant: Plant, rule: Rule, remedy: str = "") -> float:
    if plant.dead_time == 0.0:
        raise _refused(rule, "a dead time of 0 s", f"the rule needs a dead time above 0 s{remedy}")
    return plant.dead_time


def _simc(plant: Plant, rule: Simc) -> Settings:
    tau_c = _dead_time(plant, rule, ", or tau_c") if rule.tau_c is None else rule.tau_c
    K, total = abs(plant.gain), tau_c + plant.dead_time
    if isinstance(plant, FOPDT):
        return plant.time_constant / (K * total), min(plant.time_constant, 4.0 * total), 0.0
    return 1.0 / (K * total), 4.0 * total, 0.0


def _lambda(plant: Plant, rule: Lambda) -> Settings:
    K, theta = abs(plant.gain), plant.dead_time
    if isinstance(plant, FOPDT):
        tau = plant.time_constant
        wanted = rule.value * tau if rule.unit == "tau" else rule.value
        return tau / (K * (wanted + theta)), tau, 0.0
    if rule.unit == "tau":
        raise _refused(rule, f"{rule.value:g} tau", "an integrating plant has no time constant: give lambda in s")
    total = 2.0 * rule.value + theta
    return total / (K * (rule.value + theta) ** 2), total, 0.0


def _amigo(plant: Plant, rule: Amigo) -> Settings:
    K, theta = abs(plant.gain), _dead_time(plant, rule)
    if not isinstance(plant, FOPDT):
        if rule.controller == "PI":
            return 0.35 / (K * theta), 13.4 * theta, 0.0
        return 0.45 / (K * theta), 8.0 * theta, 0.5 * theta
    tau = plant.time_constant
    if rule.controller == "PI":
        Kc = (0.15 + (0.35 - theta * tau / (theta + tau) ** 2) * tau / theta) / K
        return Kc, 0.35 * theta + 13.0 * theta * tau**2 / (tau**2 + 12.0 * theta * tau + 7.0 * theta**2), 0.0
    Ti = theta * (0.4 * theta + 0.8 * tau) / (theta + 0.1 * tau)
    return (0.2 + 0.45 * tau / theta) / K, Ti, 0.5 * theta * tau / (0.3 * theta + tau)


def _step(plant: Plant, rule: ZieglerNichols) -> Settings:
    theta = _dead_time(plant, rule, ', or method "ultimate"')
    a = abs(plant.gain) * theta / (plant.time_constant if isinstance(plant, FOPDT) else 1.0)
    return (0.9 / a, theta / 0.3, 0.0) if rule.controller == "PI" else (1.2 / a, 2.0 * theta, 0.5 * theta)


def _ultimate(loop: Loop, rule: ZieglerNichols) -> Settings:
    Ku, Pu = ultimate_point(loop)
    return (0.45 * Ku, Pu / 1.2, 0.0) if rule.controller == "PI" else (0.6 * Ku, 0.5 * Pu, Pu / 8.0)


def ultimate_point(loop: Loop) -> tuple[float, float]:
    """Return (Ku, Pu): gain (%/EU, without sign) and period (s) at which proportional control alone keeps swinging.

    Of the sampled loop with an ideal valve: where the phase of `sampled_plant_response` first falls to -180 degrees.
    """
    Ts = loop.executed.sample_time
    step = discretise(loop.plant, Ts)

    def phase(x: FloatArray | float) -> FloatArray:
        """The phase at w Ts = x without jumps, + pi: each factor's own stays within half a turn up to Nyquist."""
        back = np.exp(-1j * np.asarray(x))
        lag = np.angle(step.c0 + step.c1 * back) - np.angle(1.0 - step.pole * back)
        total: FloatArray = lag - (step.delay + 1) * np.asarray(x) + math.pi
        return total

    # No factor leads: by here the whole samples of delay alone have turned the phase by 180 degrees.
    grid = np.linspace(0.0, math.pi / (step.delay + 1), 2200)[1:]
    past = np.flatnonzero(phase(grid) <= 0.0)
    at = float(grid[-1])  # where rounding alone keeps the phase above -180 degrees to the last
    if past.size:
        first = int(past[0])
        at = float(optimize.brentq(lambda x: float(phase(x)), grid[first - 1], grid[first], xtol=1e-14))
    w = at / Ts
    return 1.0 / float(abs(sampled_plant_response(loop, np.array([w]))[0])), 2.0 * math.pi / w


def _no_crossing(loop: Loop, rule: NoCrossing) -> Settings:
    plant = loop.plant
    if not isinstance(plant, FOPDT):
        what = "with integral action the loci of an integrating plant and a sticky valve always cross"
        raise _refused(rule, "an integrating plant", what)
    if loop.valve.stick_band == 0.0 and loop.valve.slip_jump == 0.0:
        raise _refused(rule, "a valve that does not stick", "there is no locus to keep clear of")
    Ti = rule.integral_ratio * (plant.time_constant + plant.dead_time)
    unit = loop.with_controller(
        PID(1.0, Ti, action=loop.controller.action, output_limits=loop.controller.output_limits)
    )
    return min(meeting_gain(unit), _stable_gain(unit)) / rule.gain_margin, Ti, 0.0


def _stable_gain(loop: Loop) -> float:
    """Return the gain (%/EU) up to which the sampled loop with an ideal valve is stable, by bisection."""

    def stable(Kc: float) -> bool:
        return linear_stable(loop.with_controller(replace(loop.controller, Kc=Kc)))

    high = 1.0 / abs(loop.plant.gain)
    while stable(high):
        high *= 2.0
    low = 0.5 * high
    while not stable(low):
        low *= 0.5
    while high - low > 1e-9 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
