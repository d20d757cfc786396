"""What an analysis of a loop answers with: describing functions and limit cycles. No computing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.model.loop import Loop
from workbench.model.record import FloatArray

__all__ = ["ComplexArray", "Crossing", "DescribingFunction", "LimitCycle", "LimitCycleStart"]

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Crossing:
    """Where L(jw) meets -1/N(A): input amplitude (%), frequency (rad/s), period (s), PV amplitude (EU), stability.

    `amplitude` is that of the valve's input (OP), half of its peak to peak; `stable` by the Nyquist reading of the
    loci: growing amplitude leads out of the region that L encircles.
    """

    amplitude: float
    frequency: float
    period: float
    pv_amplitude: float
    stable: bool


@dataclass(frozen=True, eq=False)
class DescribingFunction:
    """Describing-function analysis of a loop.

    amplitudes (%, shape (M,)) with the valve's describing function `N` and `locus = -1/N`; frequencies (rad/s, shape
    (F,)) with `L`, the loop's linear part (controller and plant). crossings sorted by amplitude. distance: the least
    |L - locus|, 0 where they cross, reached at distance_amplitude and distance_frequency. predicts_cycle: whether any
    crossing exists; amplitude, period and pv_amplitude of the stable crossing of largest amplitude, nan without one.
    linear_stable: whether the loop with an ideal valve is stable by the Nyquist criterion. verdict: one sentence.
    breaks: indices at which a new continuous piece of the locus starts (to be drawn unconnected), 0 first.
    """

    loop: Loop
    amplitudes: FloatArray
    N: ComplexArray
    locus: ComplexArray
    frequencies: FloatArray
    L: ComplexArray
    crossings: tuple[Crossing, ...]
    distance: float
    distance_amplitude: float
    distance_frequency: float
    predicts_cycle: bool
    amplitude: float
    period: float
    pv_amplitude: float
    linear_stable: bool
    verdict: str
    breaks: tuple[int, ...] = (0,)

    @property
    def prediction(self) -> str:
        """What the crossings say: "cycle", "no cycle" (there are none), or "unstable crossings only".

        Crossings that are all unstable say what dies out and what grows, not whether a cycle lasts.
        """
        if not self.predicts_cycle:
            return "no cycle"
        return "unstable crossings only" if math.isnan(self.period) else "cycle"


@dataclass(frozen=True, slots=True)
class LimitCycleStart:
    """The outcome from one start, noise-free, by exact simulation.

    name: the start in words. outcome: "settles", "cycles" or "undecided", with `reason`. first_period and period: of
    the first full cycle and late (s). Peak to peak in EU and %, median over late cycles; mean_square_error (EU^2);
    travel_per_hour (%); window: simulated time needed to see it (s). nan where there is no cycle.
    """

    name: str
    outcome: str
    reason: str
    first_period: float
    period: float
    pv_peak_to_peak: float
    op_peak_to_peak: float
    mean_square_error: float
    travel_per_hour: float
    window: float


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """The exact long-run behaviour of a loop.

    outcome: "settles", "cycles", "depends" (on the start) or "undecided". The figures are those of the given
    experiment, else medians over the starts that cycle; period_range over these starts. nan where none cycles.
    closed_form_period: the relaxation cycle's period by its formula at a symmetric split (its shortest), nan where its
    conditions do not hold.
    """

    loop: Loop
    outcome: str
    period: float
    period_range: tuple[float, float]
    pv_peak_to_peak: float
    op_peak_to_peak: float
    mean_square_error: float
    travel_per_hour: float
    window: float
    starts: tuple[LimitCycleStart, ...]
    closed_form_period: float
    verdict: str
