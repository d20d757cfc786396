"""The relaxation cycle in closed form: the stem jumps to and fro between two positions, and rests in between.

Between two slips the stem rests, and only the integral of the error, and the echo of the last slip through the plant
and the proportional action, move OP. Both are known sums, and OP has to travel the stick band from slip to slip: that
gives the period. The sums are those of the sampled loop, so that the figures need no fine sampling.

Where it stops: a dead band alone (J = 0) has no jump, hence no two positions, and no such cycle. Where friction differs
by direction or place the moves differ too, and the slips do not close to two positions; a stem with mass lands where
its motion takes it. Where OP moves in levels (a resolution) the slips wait for the next level, which the sums do not
know, and behind a curved characteristic the two positions lie in unlike gains. Where an echo crosses the stick band by
itself (Kc K J/S near 1 and above) the describing function's domain begins. A compensator moves OP by more than these
sums. On an integrating plant cycles of two slips a half cycle, twice as wide, may exist beside the one described here,
chosen by the start.
"""

from __future__ import annotations

import math

import numpy as np

from workbench.errors import InvalidValue
from workbench.model.analyses import RelaxationCycle
from workbench.model.controller import IdealTerms
from workbench.model.karnopp import Karnopp
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.valve import Directional, Positional
from workbench.simulate.coefficients import discretise

__all__ = ["relaxation_condition", "relaxation_cycle"]

# Limits within which the formulas have been found right within 5 % (benchmarks/limit_cycles.py): the echo of a slip, in
# stick bands, PV's time to come to rest, in time constants beyond the dead time, and the jump's least share in the
# stem's move on a self-regulating plant; on an integrating one OP's rise after a slip, how much farther than its jump a
# stem may move, the period in twice the integral time, and samples a cycle.
ECHO, SETTLED, OWN = 0.9, 4.0, 0.5
RISE, FARTHER, PERIOD, FEWEST = 0.3, 1.5, 1.0, 30.0
# Steps towards a stem move and a PV swing that fit each other, each halving what is left.
ROUNDS = 60


def relaxation_condition(loop: Loop) -> bool:
    """Return whether a loop on a self-regulating plant meets `0 < Kc K J/S < 1` and `tau + theta < Ti < inf`.

    A slip's own echo through the proportional action then stays within the stick band, so that only the integral moves
    the valve on: the cycle that a describing function does not see. Stenman: S = J = d.
    """
    plant, terms, S, J = loop.plant, loop.controller.ideal_terms(), loop.valve.stick_band, loop.valve.slip_jump
    if not isinstance(plant, FOPDT) or S <= 0.0 or J <= 0.0 or loop.controller.compensator is not None:
        return False
    gain = loop.controller.signed_gain * terms.Kc * loop.gain * J / S
    return 0.0 < gain < 1.0 and plant.time_constant + plant.dead_time < terms.Ti < math.inf


def relaxation_cycle(loop: Loop, split: float = 0.5) -> RelaxationCycle | None:
    """Return the relaxation cycle of a loop with integral action, or None where its conditions do not hold.

    split: where the setpoint lies between the two stem positions, a = (r/K - load - x_low)/(x_high - x_low), with r/K =
    0 on an integrating plant; 0 < a < 1, and 1/2 gives the shortest period. M is the stem's move.

    Self-regulating plant, PI or PID: `T = [Ti (S/(Kc K M) - 1) + L]/(a (1 - a))`, PV swings by K M, mean square error
    `(K M)^2 [a(1-a) - (tau/T)(1 - e^(-aT/tau))(1 - e^(-(1-a)T/tau))/(1 - e^(-T/tau))]`. At rest the error is a K M on
    one side and (1 - a) K M on the other; the integral has to move OP by the stick band less the echo Kc K M, and the
    lag L holds the old error that much longer: `L = Ts (m + b/(1 - a_p))`, b the share of a step that PV still lacks m
    + 1 samples later: tau + theta - Ts/2 nearly. Stenman, He: M = J, as they stick at once. A two-parameter stem moves
    on with OP until PV answers, m samples later: `M = J/(1 - Kc Ts K (m + 1/2)/(2 Ti))`, OP's way to the next slip is
    shorter by that, and the split is driven to 1/2, as only there both moves are equal. The derivative is at rest at
    every slip. Conditions: Ti > tau + theta; the echo, the derivative's kick included, at most 0.9 S; half cycles of at
    least 4 tau + theta; M <= 2 J.

    Integrating plant, PI or PID: PV is a triangle, as wide as `Y = [S + kp K M theta - (Kc/Ti) K M theta^2/2 - Kc Td
    K M]/(kp - Kc theta/Ti)`, kp = Kc (1 + Ts/(2 Ti)), `T = Y/(K M a (1 - a))`, mean square error Y^2/12: no Ti in it,
    but for the dead time's share. The error averages 0, so that OP's way S from slip to slip is the proportional
    action's, kp (Y - K M theta), less the change of the derivative and the integral over the dead times. A two-
    parameter stem moves on while PV goes on for the dead time, by Kc [K M theta/2 + (Y theta/2 - K M theta^2/4)/Ti],
    which makes M larger and OP's way shorter. Conditions: OP turns when PV turns, with room to spare (Y/2 <= Ti/2 times
    the slower of PV's slopes); its rise after a slip at most 0.3 S; M <= 1.5 J; Td <= theta, and 0 with a two-
    parameter valve; half cycles longer than twice the dead time; 30 samples a cycle.

    All lengths of OP carry half an OP step more at each slip, as a slip is seen at the first sample beyond the band.
    Derived for this project; measured in `benchmarks/limit_cycles.py`. Raises `InvalidValue` for another split.
    """
    if not 0.0 < split < 1.0:
        raise InvalidValue("split", split, "must lie between 0 and 1: the setpoint between the two stem positions")
    terms, valve = loop.controller.ideal_terms(), loop.valve
    gain = loop.controller.signed_gain * terms.Kc * loop.gain
    if valve.stick_band <= 0.0 or valve.slip_jump <= 0.0 or gain <= 0.0 or math.isinf(terms.Ti):
        return None
    if loop.controller.compensator is not None:
        return None
    if loop.scan > 1:
        # Between executions a stem that goes on with OP sticks.
        return relaxation_cycle(loop.executed, split) if valve.sticks_at_once else None
    if (
        isinstance(valve, Directional | Positional | Karnopp)
        or loop.controller.output_resolution > 0.0
        or loop.curve != 0.0
    ):
        return None
    try:
        if isinstance(loop.plant, FOPDT):
            return _self_regulating(loop, loop.plant, terms, split)
        return _integrating(loop, terms, split)
    except ArithmeticError:  # products of numbers beyond all use vanish or overflow
        return None


def _self_regulating(loop: Loop, plant: FOPDT, terms: IdealTerms, split: float) -> RelaxationCycle | None:
    S, J, K = loop.valve.stick_band, loop.valve.slip_jump, abs(plant.gain)
    Ts, tau = loop.sample_time, plant.time_constant
    step = discretise(plant, Ts)
    ki, m = terms.Kc * Ts / terms.Ti, step.delay
    if step.pole == 1.0:
        return None  # to rounding it integrates
    lag = m + (step.pole + step.c1) / (1.0 - step.pole)
    # OP's step beyond the band at a slip is half of ki K M/2 in the mean over both sides, whatever the split.
    sticks_at_once = loop.valve.sticks_at_once
    own = 1.0 - ki * K / 2.0 * (0.5 if sticks_at_once else m + 0.5)
    if own < OWN:
        return None
    M = J / own
    if sticks_at_once:
        S, way, lag_more = M + (S - J), 0.0, 0.0
    else:
        way = (m - 0.5) * ki * K * M / 2.0
        lag_more = m * ki * K / 2.0 * (m + 1) / 2.0
    samples = ((S - way) / (terms.Kc * K * M) - 1.0) * terms.Ti / Ts + lag + lag_more
    period = samples * Ts / (split * (1.0 - split))
    echo = terms.Kc * K * M * _echo(terms, tau)
    settles = period * min(split, 1.0 - split) >= SETTLED * tau + plant.dead_time
    if not (echo <= ECHO * S and terms.Ti > tau + plant.dead_time and settles):
        return None
    high, low = -math.expm1(-split * period / tau), -math.expm1(-(1.0 - split) * period / tau)
    error = split * (1.0 - split) - tau / period * high * low / -math.expm1(-period / tau)
    return RelaxationCycle(split, period, K * M, K * M * K * M * error, M)


@np.errstate(over="ignore")  # of a filter time that is next to no number
def _echo(terms: IdealTerms, tau: float) -> float:
    """The peak of proportional and derivative action after a step of PV's rest by 1, Kc aside; 1 without derivative."""
    if terms.Td == 0.0:
        return 1.0
    t = np.linspace(0.0, 8.0, 401) * max(tau, terms.Tf)
    # Equal time constants are moved apart by what does not matter.
    Tf = terms.Tf if abs(terms.Tf - tau) > 1e-6 * tau else terms.Tf * (1.0 + 1e-5)
    kick = np.exp(-t / tau) - (np.exp(-t / Tf) if Tf > 0.0 else np.zeros(t.size))
    return float((1.0 - np.exp(-t / tau) + terms.Td / (tau - Tf) * kick).max())


def _integrating(loop: Loop, terms: IdealTerms, split: float) -> RelaxationCycle | None:
    S, J, K, theta = loop.valve.stick_band, loop.valve.slip_jump, abs(loop.plant.gain), loop.plant.dead_time
    Kc, Ti = terms.Kc, terms.Ti
    kp = Kc * (1.0 + loop.sample_time / (2.0 * Ti))
    moves_on = not loop.valve.sticks_at_once
    if terms.Td > (0.0 if moves_on else theta):
        return None
    M, Y, more, beyond = J, 0.0, 0.0, 0.0
    # How far the stem moves on, and beyond the band at a slip, depends on PV's swing, and that on the stem's move.
    for _ in range(ROUNDS):
        # What comes later than the jump comes later by half the dead time in the mean.
        late = theta * (1.0 + 0.5 * more / M)
        slope = kp - Kc * late / Ti
        if slope <= 0.0:
            return None
        Y = (S - more + beyond + K * M * (kp * late - Kc / Ti * late**2 / 2.0 - Kc * terms.Td)) / slope
        beyond = Kc * (K * M + Y / Ti) * loop.sample_time / 4.0
        if moves_on:
            more = Kc * (K * M / 2.0 * theta + (Y * theta / 2.0 - K * M * theta**2 / 4.0) / Ti)
        M = 0.5 * (M + J + more + beyond)
        if not (0.0 < M <= FARTHER * J and Y > 0.0):
            return None
    slow, fast = (K * M * share for share in sorted((split, 1.0 - split)))
    rise = Kc * (fast * theta + (Y * theta / 2.0 - fast * theta**2 / 2.0) / Ti)
    period = Y / (K * M * split * (1.0 - split))
    turns = Y / slow <= PERIOD * Ti and rise <= RISE * S
    room = period * min(split, 1.0 - split) > 2.0 * theta and period >= FEWEST * loop.sample_time
    if not (turns and room):
        return None
    return RelaxationCycle(split, period, Y, Y**2 / 12.0, M)
