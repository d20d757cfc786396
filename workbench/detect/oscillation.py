"""Does PV oscillate? The regularity of the zero crossings of its autocorrelation, and how much of PV the cycle is."""

from __future__ import annotations

import math

import numpy as np

from workbench.kpi.oscillation import autocorrelation, zero_crossings
from workbench.model.detection import Oscillation
from workbench.model.record import FloatArray

__all__ = ["OSCILLATES", "REGULAR", "no_period", "oscillation_of", "period_of_wave"]

OSCILLATES = 0.3  # index from which a period is one
REGULAR = 1.0  # regularity above which an oscillation is one, as published
WHOLE = 6  # crossings at least that show whole periods


def no_period(cycle: Oscillation) -> str:
    """Return why the statistics of a cycle are not defined for this record, or nothing where PV has a period."""
    if math.isnan(cycle.period):
        return "PV shows no cycle"
    if cycle.index < OSCILLATES:
        return "PV's cycle is too weak"
    return "" if cycle.regularity > REGULAR else "PV's cycle is not regular"


def period_of_wave(pv: FloatArray, sample_time: float, cycle: Oscillation) -> float:
    """Return the period of PV's oscillation, s, where it is regular by half or by whole periods, and nan elsewhere.

    A cycle whose halves differ, of a heater that is on for a fifth of the time, crosses its mean in turns of unequal
    length: the regularity of `oscillation_of` is that of halves, as published. pv: shape (N,), with its oscillation.
    """
    if not no_period(cycle):
        return cycle.period
    crossings, _ = zero_crossings(autocorrelation(pv))
    if crossings.size < WHOLE or not cycle.index >= OSCILLATES:
        return math.nan
    periods = crossings[2:] - crossings[:-2]
    mean, spread = float(periods.mean()), float(periods.std(ddof=1))
    # `cycle.period` is off where there is an odd number of unequal intervals.
    return mean * sample_time if mean > 3.0 * REGULAR * spread else math.nan


def oscillation_of(pv: FloatArray, sample_time: float) -> Oscillation:
    """Return period, regularity and index of the strongest oscillation of PV, shape (N,).

    Period: twice the mean interval T between the first eleven zero crossings of the autocorrelation; regularity
    `r = mean(T) / (3 sd(T))`, more than 1 for a regular oscillation (N.F. Thornhill, B. Huang, H. Zhang, "Detection of
    multiple oscillations in control loops", J. Process Control 13 (2003) 91-100). index: the autocorrelation one
    period on, corrected for the overlap that lags lose: the share of PV's variance that repeats, 0 for noise and 1 for
    a perfect sinusoid; 0 where the record shows no four crossings in the first half of the lags.
    """
    acf = autocorrelation(pv)
    n = pv.size
    crossings, before = zero_crossings(acf)
    if crossings.size < 4:
        return Oscillation(index=0.0, period=math.nan, regularity=0.0, cycles=0.0)
    intervals = np.diff(crossings)
    mean, spread = float(intervals.mean()), float(intervals.std(ddof=1))
    first, last = int(before[1]) + 1, int(before[2]) + 1
    peak = first + int(np.argmax(acf[first:last]))
    index = float(acf[peak]) * n / (n - peak)
    return Oscillation(
        index=min(max(index, 0.0), 1.0),
        period=2.0 * mean * sample_time,
        regularity=mean / (3.0 * spread) if spread > 1e-3 * mean else math.inf,
        cycles=n / (2.0 * mean),
    )
