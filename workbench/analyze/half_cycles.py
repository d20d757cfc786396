"""Figures of half cycles: what happened between two reversals of the stem, as `simulate.events.collect` counted it."""

from __future__ import annotations

import numpy as np

from workbench.model.record import FloatArray
from workbench.simulate import events

__all__ = ["Block", "fresh_carry", "mean_period"]


def fresh_carry(stem: float) -> FloatArray:
    """Return what `collect` carries along, for a stem at rest at `stem` (%) that has not moved yet."""
    carry = np.zeros(events.CARRIED)
    carry[events.STEM_AT] = stem
    carry[events.Y_HIGH] = carry[events.U_HIGH] = -np.inf
    carry[events.Y_LOW] = carry[events.U_LOW] = np.inf
    return carry


def mean_period(halves: FloatArray, sample_time: float) -> float:
    """Return the mean period (s) of an even number of successive half cycles."""
    samples = float(halves[-1, events.END] - halves[0, events.START])
    return float(2.0 * samples * sample_time / halves.shape[0])


class Block:
    """Figures of an even number of successive half cycles.

    period: s, mean over its cycles; pv_peak_to_peak (EU) and op_peak_to_peak (%): median over its cycles of max - min;
    mean_square_error: EU^2; travel_per_hour: %; slips_per_hour, reversals_per_hour.
    """

    def __init__(self, halves: FloatArray, sample_time: float) -> None:
        self._halves = halves
        self.period = mean_period(halves, sample_time)
        self.pv_peak_to_peak = self._swing(events.Y_HIGH, events.Y_LOW)
        self._samples = float(halves[-1, events.END] - halves[0, events.START])
        self._per_hour = 3600.0 / (self._samples * sample_time)

    @property
    def op_peak_to_peak(self) -> float:
        """%, median over cycles."""
        return self._swing(events.U_HIGH, events.U_LOW)

    @property
    def mean_square_error(self) -> float:
        """EU^2."""
        return float(self._halves[:, events.SQUARES].sum()) / self._samples

    @property
    def travel_per_hour(self) -> float:
        """%."""
        return float(self._halves[:, events.STEM_TRAVEL].sum()) * self._per_hour

    @property
    def slips_per_hour(self) -> float:
        """Breakaways of the stem from rest."""
        return float(self._halves[:, events.SLIPS].sum()) * self._per_hour

    @property
    def reversals_per_hour(self) -> float:
        """Changes of the stem's direction."""
        return float(self._halves.shape[0] * self._per_hour)

    def _swing(self, high: int, low: int) -> float:
        first, second = self._halves[0::2], self._halves[1::2]
        swings = np.maximum(first[:, high], second[:, high]) - np.minimum(first[:, low], second[:, low])
        swings.sort()
        middle = swings.size // 2
        return float(swings[middle] if swings.size % 2 else 0.5 * (swings[middle - 1] + swings[middle]))
