"""What the verbs answer with: frozen results, no computing. Arrays are float64 and belong to the result alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from workbench.errors import SolveError
from workbench.model.analyses import (
    Crossing,
    DescribingFunction,
    LimitCycle,
    LimitCycleStart,
    RelaxationCycle,
    Waveform,
)
from workbench.model.checks import choice
from workbench.model.controller import PID
from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.estimation import (
    Complementarity,
    Estimate,
    FittedModel,
    Intervals,
    Iteration,
    LinearFit,
    NoiseModel,
    Part,
    Repeats,
)
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.show import Shown
from workbench.model.status import SolveStatus
from workbench.model.tuning import Bounds, DigitStep, Objective

__all__ = [
    "ASKED_FROM",
    "Complementarity",
    "Crossing",
    "DescribingFunction",
    "Estimate",
    "FittedModel",
    "Intervals",
    "Iteration",
    "Kpis",
    "LimitCycle",
    "LimitCycleStart",
    "LinearFit",
    "Margins",
    "NlpResult",
    "NoiseModel",
    "Outcome",
    "Part",
    "RelaxationCycle",
    "Repair",
    "Repeats",
    "Restart",
    "Robustness",
    "Run",
    "SolveStatus",
    "Tuned",
    "Waveform",
]


@dataclass(frozen=True, slots=True)
class Kpis(Shown):
    """The figures of one run or record over its window; `nan` where the signal they need is missing.

    All are `inf` of a run that diverged so far that its squares overflow, but for reversals and the oscillation's.

    Variances are population variances. error_variance, mean_square_error, ise, iae are of SP - PV (EU; iae EU s, ise
    EU^2 s); pv_sd is PV's standard deviation (EU); op_variance and valve_variance in %^2; valve_travel and
    controller_travel are sums of absolute moves (%), the first move counted from the sample before the window;
    reversals counts the sign changes of successive stem moves, but for those of rounding at rest (`kpis.STILL`; 0 where
    the stem is not known). overshoot: % of the last setpoint step, until a load steps; settling_time: s from the last
    setpoint or load step, `inf` if it never settles; final_error: SP - PV at the window's last sample (EU);
    oscillation_index 0..1 and oscillation_period (s) from PV's autocorrelation.
    """

    error_variance: float
    mean_square_error: float
    op_variance: float
    valve_variance: float
    valve_travel: float
    controller_travel: float
    reversals: int
    iae: float
    ise: float
    pv_sd: float
    overshoot: float
    settling_time: float
    final_error: float
    oscillation_index: float
    oscillation_period: float


@dataclass(frozen=True, eq=False)
class Run(Shown):
    """One exact simulation: time (s), sp and pv (EU, pv measured), op and valve (%), each of shape (N,).

    load (%) is the disturbance at the plant input, shape (N,). final_sp and final_pv are the values of sample N, which
    closes the last interval. branch (int8, shape (N,)) codes the decisions taken (see `simulate.kernel`).
    """

    loop: Loop
    experiment: Experiment
    time: FloatArray
    sp: FloatArray
    pv: FloatArray
    op: FloatArray
    valve: FloatArray
    load: FloatArray
    branch: NDArray[np.int8]
    final_sp: float
    final_pv: float
    kpis: Kpis


# Worst J within the margin over J itself, above which a tuning is a knife-edge.
SAME_LEAST = 1e-3  # of J: searches whose least values are no further apart agree
KNIFE_EDGE = 1.05
# A parameter whose bounds begin at 0 is asked from this share of the upper one, for `Tuned.worst_bound`.
ASKED_FROM = 1e-3


@dataclass(frozen=True, eq=False)
class NlpResult:
    """One nonlinear program's end: x (solution, shape (n,)), objective, status and the solver's own words.

    residuals: worst constraint violation by name of the constraint group. complementarity: worst product of
    complementary quantities (0 where the program has none).
    """

    x: FloatArray
    objective: float
    status: SolveStatus
    message: str
    iterations: int
    residuals: Mapping[str, float]
    complementarity: float
    wall_time: float
    versions: Mapping[str, str]

    def require_success(self) -> NlpResult:
        """Return self if solved, else raise `SolveError`."""
        if not self.status.success:
            worst = max(self.residuals.items(), key=lambda item: item[1], default=("none", 0.0))
            msg = f"the solve ended as {self.status.value} ({self.message}); worst residual {worst[0]}: {worst[1]:.3g}"
            raise SolveError(msg)
        return self


@dataclass(frozen=True, slots=True)
class Restart:
    """One global search: its number `seed`, counted from 0 under the tuning's own seed; its figures.

    Best J of the scan, J after refinement, evaluations, branch programs solved and IPOPT's iterations.
    """

    seed: int
    scanned: float
    refined: float
    evaluations: int
    solves: int
    iterations: int


def agreeing(restarts: Sequence[Restart], least: float = math.inf) -> int:
    """Return how many restarts ended within `SAME_LEAST` of the least J of all; least: one met elsewhere."""
    best = min([least, *(r.refined for r in restarts)])
    return sum(math.isfinite(best) and r.refined <= best + SAME_LEAST * abs(best) for r in restarts)


@dataclass(frozen=True, slots=True)
class Margins(Shown):
    """The margins of a sampled loop with an ideal valve.

    max_sensitivity: Ms, inf where the loop is unstable; frequency: where it is reached, rad/s, nan then. gain_margin:
    factor on Kc, phase_margin: degrees, delay_margin: s of further dead time; inf where nothing of the kind makes the
    loop unstable, 0 for an unstable loop.
    """

    loop: Loop
    stable: bool
    max_sensitivity: float
    frequency: float
    gain_margin: float
    phase_margin: float
    delay_margin: float


@dataclass(frozen=True, slots=True)
class Standing:
    """How a tuning holds its loop with an ideal valve: on its own plant, and where the plant's ranges are worst for it.

    worst: the margins of the plant, each parameter its own or an end of its 95 % range, that the tuning holds least;
    None for a plant without ranges. Its `loop.plant` names the place.
    """

    own: Margins
    worst: Margins | None = None


@dataclass(frozen=True, eq=False)
class Robustness(Shown):
    """How a loop fares in an ensemble, by exact simulation of each draw.

    objective: the ensemble's statistic of J. mean_square_error (EU^2) and valve_travel (%): one value for each draw,
    shape (draws,), with their means, medians and 90th percentiles as properties. diverged: draws whose linear loop is
    unstable or whose run overflows. stable, max_sensitivity, gain_margin and phase_margin (degrees): the worst over the
    nominal plant and the corners of its uncertainty, with an ideal valve.
    """

    loop: Loop
    ensemble: Ensemble
    objective: float
    mean_square_error: FloatArray
    valve_travel: FloatArray
    diverged: int
    stable: bool
    max_sensitivity: float
    gain_margin: float
    phase_margin: float

    @property
    def mse_median(self) -> float:
        """Median of the mean square error, EU^2."""
        return float(np.median(self.mean_square_error))

    @property
    def mse_p90(self) -> float:
        """90th percentile of the mean square error, EU^2."""
        return float(np.quantile(self.mean_square_error, 0.9, method="higher"))

    @property
    def mse_mean(self) -> float:
        """Mean of the mean square error, EU^2."""
        return float(self.mean_square_error.mean())

    @property
    def travel_median(self) -> float:
        """Median of the valve travel, %."""
        return float(np.median(self.valve_travel))

    @property
    def travel_mean(self) -> float:
        """Mean of the valve travel, %."""
        return float(self.valve_travel.mean())


@dataclass(frozen=True, eq=False)
class Tuned(Shown):
    """A tuning and how it was found.

    controller: in the form of the loop's controller, with parameters rounded to `digits` significant digits, the ones
    to type in. objective: J of exactly that controller by exact simulation; nominal: the least J met at any settings,
    unrounded and as near to a cliff as it may be;
    worst: the worst J when each parameter moves by up to the larger of the relative `margin` and half a last digit, as
    up to 22,000 random points of that neighbourhood show (fewer for long runs and stopped searches; 115 of a nominal,
    robust or infeasible tuning): a sample, no bound, and a cliff that one point in ten thousand meets may lie above it.
    start_objective: J of the loop's own controller. guard_margin: the least distance (%) of the trajectory to a
    stick/slip decision; slips: how many samples the stem moves in, the length of its sequence of decisions. steps: J at
    one unit of the last digit more and less of each free parameter. nominal_only: J itself was minimised, not its worst
    case; where its searches did not agree the restarts are more than were asked for. worst_bound: what no worst J
    within the bounds is below that keeps the constraints, as a run in every neighbourhood of their plane shows
    (`asked_from`); None where not all were asked.

    A robust tuning minimises `ensemble.statistic` of J over the ensemble's draws: objective, nominal, worst,
    start_objective and the restarts are that statistic then, while guard_margin and slips are of the experiment's run.
    `robustness`: its figures on fresh draws, which the search has not seen; `start_robustness`: those of the loop's own
    controller on the same draws. All four are None for a tuning to one experiment.
    """

    loop: Loop
    experiment: Experiment
    weights: Objective
    bounds: Bounds
    controller: PID
    objective: float
    status: SolveStatus
    message: str
    digits: int
    nominal: float
    worst: float
    margin: float
    start_objective: float
    guard_margin: float
    slips: int
    restarts: tuple[Restart, ...]
    evaluations: int
    solves: int
    iterations: int
    seed: int
    wall_time: float
    versions: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    ensemble: Ensemble | None = None
    constraints: Constraints | None = None
    robustness: Robustness | None = None
    start_robustness: Robustness | None = None
    steps: tuple[DigitStep, ...] = ()
    nominal_only: bool = False
    worst_bound: float | None = None

    @property
    def asked_from(self) -> str:
        """The part of the bounds that `worst_bound` holds for, in words: "" where that is all of them.

        A neighbourhood is relative, so that Kc or Td from 0 on has no first one.
        """
        bounds = ((name, *getattr(self.bounds, name)) for name in ("Kc", "Ti", "Td"))
        first = [f"{name} from {ASKED_FROM * high:g} on" for name, low, high in bounds if low == 0.0 and high > 0.0]
        return f" ({', '.join(first)})" if first else ""

    @property
    def agreeing(self) -> int:
        """How many of the restarts ended within 0.1 % of the least J that was met, theirs or a later search's."""
        return agreeing(self.restarts, self.nominal)

    @property
    def knife_edge(self) -> bool:
        """Whether J grows by more than a twentieth within the margin: what is gained is lost by a small slip."""
        return self.worst > KNIFE_EDGE * self.objective

    @property
    def spread(self) -> tuple[float, float]:
        """Best and worst refined objective over the restarts."""
        values = [r.refined for r in self.restarts] or [self.objective]
        return min(values), max(values)

    def require_success(self) -> Tuned:
        """Return self if verified, else raise `SolveError`."""
        if not self.status.success:
            raise SolveError(f"the tuning ended as {self.status.value}: {self.message}")
        return self


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one controller achieves in an experiment by exact simulation: J of eq. (2) and the figures of the run."""

    controller: PID
    objective: float
    kpis: Kpis


@dataclass(frozen=True, eq=False)
class Repair(Shown):
    """What repairing the valve is worth: a loop with its sticky valve and with an ideal one, in the same experiment.

    loop: with its sticky valve and present controller. present and repaired: at the present tuning, with the sticky and
    the ideal valve; best and best_repaired: each at the best tuning found for it (tuned and tuned_repaired: the
    searches; best as typed in where a scenario's site rounds it). The figures are of measured PV: noise is in all four.
    """

    loop: Loop
    experiment: Experiment
    weights: Objective
    present: Outcome
    repaired: Outcome
    best: Outcome
    best_repaired: Outcome
    tuned: Tuned
    tuned_repaired: Tuned

    def share(self, figure: str) -> float:
        """Return the share of a figure, as the best tuning found leaves it, that no tuning removes but repair does.

        figure: "objective" or a name of `Kpis`. `1 - best_repaired/best`: 0 where repair changes nothing, negative
        where the ideal valve does worse, nan where there is nothing left to remove.
        """
        choice(figure, "figure", ("objective", *(one.name for one in fields(Kpis))))
        left, repaired = (
            one.objective if figure == "objective" else float(getattr(one.kpis, figure))
            for one in (self.best, self.best_repaired)
        )
        return 1.0 - repaired / left if left > 0.0 and math.isfinite(left) else math.nan
