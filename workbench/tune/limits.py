"""Constraints as values of a search: what breaks one is ranked by how far, below everything that keeps them all.

A search then finds its way to the feasible tunings first (K. Deb, "An efficient constraint handling method for genetic
algorithms", Comput. Methods Appl. Mech. Eng. 186 (2000) 311-338).
"""

from __future__ import annotations

import numpy as np

from workbench.model.ensemble import Constraints
from workbench.model.record import FloatArray

__all__ = ["NARROW", "UNSTABLE", "WORN", "beyond", "more_than_sensitivity", "narrowness", "worn"]

# Values of what breaks a constraint lie above every J that a run that does not overflow can have.
UNSTABLE, NARROW, WORN = 1e280, 1e240, 1e200


def narrowness(asked: Constraints, margins: FloatArray) -> FloatArray:
    """How far margins (Ms, gain, phase in degrees), shape (M, 3), miss what is asked: a sum of logarithms, (M,)."""
    total: FloatArray = np.maximum(_missed(asked, margins), 0.0).sum(axis=0)
    return total


def beyond(asked: Constraints, margins: FloatArray) -> FloatArray:
    """By how much of a logarithm the worst of the margins misses what is asked, below 0 if all are kept, shape (M,)."""
    most: FloatArray = _missed(asked, margins).max(axis=0, initial=-np.inf)
    return most


def _missed(asked: Constraints, margins: FloatArray) -> FloatArray:
    """Logarithms of what is asked of margins over what they are, a row each; shape (asked, M)."""
    rows = [np.log(margins[:, 0] / asked.max_sensitivity)] if asked.max_sensitivity is not None else []
    for column, least in ((1, asked.gain_margin), (2, asked.phase_margin)):
        if least is not None:
            rows.append(np.log(np.maximum(least / np.maximum(margins[:, column], 1e-9), 1e-9)))
    return np.array(rows).reshape(-1, margins.shape[0])


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
