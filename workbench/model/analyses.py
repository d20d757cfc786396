"""What an analysis of a loop answers with: describing functions and limit cycles. No computing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.show import Shown
from workbench.model.valve import Valve

__all__ = [
    "ComplexArray",
    "Crossing",
    "DescribingFunction",
    "LimitCycle",
    "LimitCycleStart",
    "RelaxationCycle",
    "Signature",
    "Waveform",
]

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
class DescribingFunction(Shown):
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


@dataclass(frozen=True, eq=False)
class Waveform:
    """One late cycle, from one upward turn of the stem to the next: time (s, from 0), pv (EU), op and valve (%).

    Each of shape (P,); exact at each of these samples, which leave out samples in between where a cycle is long.
    """

    time: FloatArray
    pv: FloatArray
    op: FloatArray
    valve: FloatArray


@dataclass(frozen=True, slots=True)
class RelaxationCycle:
    """A relaxation cycle in closed form at a split of the setpoint between the stem's two positions (0 < split < 1).

    period: s; pv_peak_to_peak: EU; mean_square_error: EU^2; stem_move: %, of each of a cycle's two moves.
    """

    split: float
    period: float
    pv_peak_to_peak: float
    mean_square_error: float
    stem_move: float


@dataclass(frozen=True, slots=True)
class LimitCycleStart:
    """The outcome from one start, noise-free, by exact simulation.

    name: the start in words. outcome: "settles", "cycles" or "undecided", with `reason`, which says by which way.
    first_period and period: of the first full cycle and late (s), the latter's means over blocks of cycles within
    period_range. Peak to peak in EU and %, median over late cycles; mean_square_error (EU^2); travel_per_hour (%),
    slips_per_hour (breakaways of the stem from rest) and reversals_per_hour; window: simulated time needed to see it
    (s); waveform of a late cycle. nan, and no waveform, where there is no cycle. rest_pv (EU), rest_stem (%) and
    rest_error (SP - PV, EU): where it settles, nan elsewhere.
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
    period_range: tuple[float, float] = (math.nan, math.nan)
    slips_per_hour: float = math.nan
    reversals_per_hour: float = math.nan
    rest_pv: float = math.nan
    rest_stem: float = math.nan
    rest_error: float = math.nan
    waveform: Waveform | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, eq=False)
class LimitCycle(Shown):
    """The exact long-run behaviour of a loop.

    outcome: "settles", "cycles", "depends" (on the start) or "undecided". The figures are those of the given
    experiment, else medians over the starts that cycle; period_range over the late cycles of all these starts. nan
    where none cycles.
    closed_form_period: the relaxation cycle's period by its formula at a symmetric split (its shortest), nan where its
    conditions do not hold, and closed_form the whole of it, or None. Units as in `LimitCycleStart`.
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
    slips_per_hour: float = math.nan
    reversals_per_hour: float = math.nan
    closed_form: RelaxationCycle | None = None

    @property
    def grows(self) -> bool:
        """Whether it is undecided as PV grows without bound from the given start."""
        return self.outcome == "undecided" and "grows without bound" in self.starts[0].reason

    @property
    def share(self) -> float:
        """Share of the starts that cycle among those that cycle or settle, 0 .. 1; nan where none was decided."""
        outcomes = [start.outcome for start in self.starts if start.outcome != "undecided"]
        return outcomes.count("cycles") / len(outcomes) if outcomes else math.nan


@dataclass(frozen=True, eq=False)
class Signature(Shown):
    """A valve's signature, as `wb.signature` measures it on the simulated test bench.

    ramp_op and ramp_stem (%, shape (N,)): a slow ramp up, down and up again; steps_op and steps_stem (%, shape (M,)):
    small steps up, then down, each held. step: the size of both, %. dead_band_down and dead_band_up: the change of the
    input after its turn downward, or upward, that the valve swallows, %; resolution_up and resolution_down: the change
    in the same direction that it swallows, %. All four are read from the runs, and lie at most a step below the true
    values.
    """

    valve: Valve
    step: float
    ramp_op: FloatArray
    ramp_stem: FloatArray
    steps_op: FloatArray
    steps_stem: FloatArray
    dead_band_down: float
    dead_band_up: float
    resolution_up: float
    resolution_down: float

    @property
    def dead_band(self) -> float:
        """The larger of both dead bands, %."""
        return max(self.dead_band_down, self.dead_band_up)

    @property
    def resolution(self) -> float:
        """The coarser of both resolutions, %."""
        return max(self.resolution_up, self.resolution_down)
