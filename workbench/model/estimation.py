"""What `wb.estimate` answers with: frozen, no computing. Arrays are float64 and belong to the result alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

from workbench.model.loads import LoadStep, LoadSwing
from workbench.model.plant import Plant
from workbench.model.record import FloatArray, Record
from workbench.model.show import Shown
from workbench.model.status import SolveStatus
from workbench.model.valve import Valve

__all__ = [
    "Complementarity",
    "Estimate",
    "FittedModel",
    "Intervals",
    "Iteration",
    "LinearFit",
    "NoiseModel",
    "Part",
    "Repeats",
]

MOST_IN_PROGRAM = 1500  # samples in a complementarity program, whose time grows faster than they do


@dataclass(frozen=True, slots=True)
class Intervals:
    """95 % ranges (low, high) of what was estimated, or None where the data or the model give none.

    An end is infinite where the range is open there: the search ended at its limit, or the record tells nothing up to
    all that it could show. The estimate's reasons say so. In JSON such an end is "none".

    d, S, J in %; gain in EU/% (integrating: EU/(% s)); time_constant and dead_time in s.
    """

    d: tuple[float, float] | None = None
    S: tuple[float, float] | None = None
    J: tuple[float, float] | None = None
    gain: tuple[float, float] | None = None
    time_constant: tuple[float, float] | None = None
    dead_time: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Iteration:
    """One step of the two-step algorithm: the stiction (%), the plant fitted to it, the residual variance and AIC."""

    d: float
    plant: Plant
    residual_variance: float
    aic: float


@dataclass(frozen=True, eq=False)
class LinearFit:
    """The fit that ignores stiction: plant, bias (EU), prediction (EU, shape (N,)), residual variance (EU^2), AIC."""

    plant: Plant
    bias: float
    prediction: FloatArray
    residual_variance: float
    aic: float


@dataclass(frozen=True, slots=True)
class FittedModel:
    """One model held against a record: valve, plant, residual variance (EU^2), AIC and BIC, times that the stem slips.

    AIC and BIC are those of the innovations where the disturbance is coloured, and do not fall below what the record
    resolves: fits better than that are equally good.
    """

    valve: Valve
    plant: Plant
    residual_variance: float
    aic: float
    bic: float
    slips: int


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """What disturbs PV beside the loop, as method "joint" finds it: `n_k = ar[0] n_{k-1} + ar[1] n_{k-2} + .. + e_k`.

    ar: as many coefficients as the order chosen, 0 to 4. innovation_sd: standard deviation of e, EU: how well PV is
    foretold one sample ahead. drift: of PV, EU/s (0 where none was chosen), with its 95 % range. compared: (order,
    with a drift, BIC) of each model held against the record, less a common constant. iterations: IPOPT's.
    """

    ar: tuple[float, ...]
    innovation_sd: float
    drift: float
    drift_interval: tuple[float, float] | None
    compared: tuple[tuple[int, bool, float], ...]
    iterations: int


@dataclass(frozen=True, slots=True)
class Complementarity:
    """What the complementarity program of method "complementarity" found, beside what the valve's own law makes of it.

    status, iterations, residual (worst violation of a constraint) and complementarity (worst product of a pair): how
    the program ended, PV and OP of size 1. d (%) and plant: at its end. cost: the mean square of the innovations that
    it claims, EU^2; exact_cost: of the exact stem path for its d with the plant fitted again, None where that stem does
    not move; profile_cost: of the profile's best path. partial: samples in which the program's stem moves part of the
    way, which the valve does not do. taken: whether the estimate is the program's d, which fits better, and not the
    profile's.
    """

    status: SolveStatus
    iterations: int
    residual: float
    complementarity: float
    d: float
    plant: Plant
    cost: float
    exact_cost: float | None
    profile_cost: float
    partial: int
    taken: bool


@dataclass(frozen=True, slots=True)
class Part:
    """A stretch of a record by itself, at the plant of the whole: from `start` to `end` (s, the record's clock).

    band: how far OP moves before the stem turns there, d or S, %, with its 95 % range; up and down: the same before it
    moves upward and downward, nan for a dead band, where a difference cannot be seen. slips: stem moves in it.
    """

    start: float
    end: float
    band: float
    interval: tuple[float, float]
    up: float
    down: float
    slips: int


@dataclass(frozen=True, slots=True)
class Repeats:
    """Whether a valve's stiction repeats: over parts of the record, upward and downward, and in time.

    spread: of the parts' bands, standard deviation over their mean. drift: of the band, %/h, and difference: band
    upward less band downward, %; each with its 95 % range, None where the parts are too few to tell.
    """

    parts: tuple[Part, ...]
    spread: float
    drift: float | None
    drift_interval: tuple[float, float] | None
    difference: float | None
    difference_interval: tuple[float, float] | None

    @property
    def band(self) -> float:
        """The mean of the parts' bands, %."""
        return math.fsum(p.band for p in self.parts) / len(self.parts)


@dataclass(frozen=True, eq=False)
class Estimate(Shown):
    """A loop estimated from a record.

    plant and valve: the model (valve `Ideal()` where no stiction helps). valve_position: the estimated stem, % of
    OP's scale, shape (N,). prediction: PV simulated from that stem, EU, shape (N,). bias: PV at stem 0, EU.
    verdict: "stiction", "no_stiction" or "undecided", with `reasons` in words. identifiable: True for a
    "stiction" verdict whose d (or S) the data pin to a tenth, with ten stem moves or more, and not only its product
    with the gain. residual_variance (EU^2) and aic by the paper's eq. (1); noise_sd: of PV about the prediction, EU;
    all three without spikes (`detect.spikes`). slips: stem moves in the record. profile_d and profile_cost:
    variance of the innovations (EU^2) against d. iterations: of two-step. candidates: the models compared, the lowest
    BIC first. noise_model: of "joint", or None. repeats: parts of the record by themselves; None with few moves.
    load_steps: lasting, and in the prediction.
    load_swing: an oscillation from outside, in the prediction too, or None.
    complementarity: the program of the method of that name, or None. pv_late: s by which PV is recorded later than the
    controller saw it; the plant's dead time is without it. op_late: s by which OP is recorded later than it was sent,
    at most; dead time and valve_position are from when it was.
    """

    record: Record
    method: str
    plant: Plant
    valve: Valve
    valve_position: FloatArray
    prediction: FloatArray
    bias: float
    verdict: str
    reasons: tuple[str, ...]
    intervals: Intervals
    identifiable: bool
    residual_variance: float
    aic: float
    noise_sd: float
    slips: int
    linear: LinearFit
    profile_d: FloatArray
    profile_cost: FloatArray
    iterations: tuple[Iteration, ...] = ()
    candidates: tuple[FittedModel, ...] = ()
    noise_model: NoiseModel | None = None
    repeats: Repeats | None = None
    load_steps: tuple[LoadStep, ...] = ()
    load_swing: LoadSwing | None = None
    complementarity: Complementarity | None = None
    pv_late: float = 0.0
    op_late: float = 0.0
