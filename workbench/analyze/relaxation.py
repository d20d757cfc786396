"""The relaxation cycle in closed form: the stem jumps to and fro between two positions, and rests in between."""

from __future__ import annotations

import math

from workbench.model.loop import Loop
from workbench.model.plant import FOPDT

__all__ = ["relaxation_condition", "relaxation_period"]


def relaxation_condition(loop: Loop) -> bool:
    """Return whether a PI loop on a self-regulating plant meets `0 < Kc K J/S < 1` and `Ti > tau + theta`.

    A slip's own echo through the proportional action then stays within the stick band, so that only the integral moves
    the valve on: the cycle that a describing function does not see. Stenman: S = J = d.
    """
    plant, terms, S, J = loop.plant, loop.controller.ideal_terms(), loop.valve.stick_band, loop.valve.slip_jump
    if not isinstance(plant, FOPDT) or S <= 0.0 or J <= 0.0:
        return False
    gain = loop.controller.signed_gain * terms.Kc * plant.gain * J / S
    return terms.Td == 0.0 and 0.0 < gain < 1.0 and plant.time_constant + plant.dead_time < terms.Ti < math.inf


def relaxation_period(loop: Loop, split: float = 0.5) -> float:
    """Return the period (s) of the relaxation cycle, nan where `relaxation_condition` does not hold.

    `T = [Ti (S/(Kc K J) - 1) + tau + theta] / (a (1 - a))`, with the split a = (r/K - x_low)/(x_high - x_low) telling
    where the setpoint lies between the two stem positions, 0 < a < 1; a = 1/2 gives the shortest period. Derivation: at
    rest the error is a K J on one side and (1 - a) K J on the other, and the integral has to cross the stick band less
    the proportional echo on each; the lag and the dead time hold the old error that much longer. It assumes that the
    stem moves by J alone: right within about 2 % for Stenman's valve, while a two-parameter stem with J < S moves on
    until OP turns, which makes the swing larger and the period shorter than this (by up to a fifth in most loops).
    """
    if not relaxation_condition(loop) or not isinstance(loop.plant, FOPDT):
        return math.nan
    terms = loop.controller.ideal_terms()
    gain = loop.controller.signed_gain * terms.Kc * loop.plant.gain * loop.valve.slip_jump / loop.valve.stick_band
    idle = terms.Ti * (1.0 / gain - 1.0) + loop.plant.time_constant + loop.plant.dead_time
    return idle / (split * (1.0 - split))
