"""Constraints as values of a search: what breaks one is ranked by how far, below everything that keeps them all.

A search then finds its way to the feasible tunings first (K. Deb, "An efficient constraint handling method for genetic
algorithms", Comput. Methods Appl. Mech. Eng. 186 (2000) 311-338).
"""

from __future__ import annotations

import numpy as np

from workbench.model.ensemble import Constraints
from workbench.model.numbers import given
from workbench.model.record import FloatArray

__all__ = ["NARROW", "UNSTABLE", "WORN", "missed", "more_than_sensitivity", "narrowness", "worn"]

# Values of what breaks a constraint lie above every J that a run that does not overflow can have.
UNSTABLE, NARROW, WORN = 1e280, 1e240, 1e200


def narrowness(asked: Constraints, margins: FloatArray) -> FloatArray:
    """How far margins (Ms, gain, phase in degrees), shape (M, 3), miss what is asked: a sum of logarithms, (M,)."""
    total = np.zeros(margins.shape[0])
    if asked.max_sensitivity is not None:
        total += np.maximum(np.log(margins[:, 0] / asked.max_sensitivity), 0.0)
    for column, least in ((1, asked.gain_margin), (2, asked.phase_margin)):
        if least is not None:
            total += np.log(np.maximum(least / np.maximum(margins[:, column], 1e-9), 1.0))
    return total


def more_than_sensitivity(asked: Constraints) -> bool:
    """Whether constraints ask for a gain or a phase margin."""
    return asked.gain_margin is not None or asked.phase_margin is not None


def worn(costs: FloatArray, travel: FloatArray, cap: float | None) -> FloatArray:
    """Return costs, shape (M,), with those of a valve travel (%) above the cap ranked by how far it is."""
    if cap is None:
        return costs
    with np.errstate(invalid="ignore"):
        over = np.log(np.maximum(travel, 1e-300) / cap)
    ranked: FloatArray = np.where(over > 0.0, np.where(np.isfinite(over), WORN * (1.0 + over), np.inf), costs)
    return ranked


def missed(asked: Constraints, margins: tuple[float, float, float], travel: float, travel_words: str) -> list[str]:
    """Say which constraints margins (Ms, gain, phase in degrees) and a valve travel (%) break, and by how much."""
    Ms, gain, phase = margins
    words = []
    if asked.max_sensitivity is not None and Ms > asked.max_sensitivity:
        words.append(f"a maximum sensitivity of {given(Ms, 3)} (at most {asked.max_sensitivity:g})")
    if asked.gain_margin is not None and gain < asked.gain_margin:
        words.append(f"a gain margin of {given(gain, 3)} (at least {asked.gain_margin:g})")
    if asked.phase_margin is not None and phase < asked.phase_margin:
        words.append(f"a phase margin of {given(phase, 3)} degrees (at least {asked.phase_margin:g})")
    if asked.valve_travel is not None and travel > asked.valve_travel:
        words.append(f"a {travel_words} of {given(travel, 3)} % (at most {asked.valve_travel:g} %)")
    return words
