"""What a scenario asks for, as validated values of the model: the loader makes it, the runner carries it out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from workbench.model.cascade import Cascade
from workbench.model.controller import PID
from workbench.model.ensemble import Constraints, Ensemble
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.record import Record
from workbench.model.rule import Rule
from workbench.model.site import CascadeSite, SiteForm
from workbench.model.tuning import Bounds, Objective
from workbench.scenario.cautions import Caution

__all__ = [
    "RULE_DIGITS",
    "CascadeJob",
    "CascadeTuneJob",
    "CaseJob",
    "EnsembleJob",
    "EstimateJob",
    "MapJob",
    "RobustJob",
    "Scenario",
    "TuneJob",
    "wrong_length",
]

MAX_SAMPLES = 5_000_000  # of an experiment
FEWEST_SAMPLES = 10  # of one: fewer show nothing of a loop
RULE_DIGITS = 4  # significant digits of what a rule gives, to be typed in


def wrong_length(samples: float) -> str:
    """Return in words that an experiment has too many samples or too few, or nothing."""
    if FEWEST_SAMPLES <= samples <= MAX_SAMPLES:
        return ""
    many = "1 sample" if samples == 1 else f"{samples:,.0f} samples"
    return f"{many}; must be at most {MAX_SAMPLES:,}, and at least {FEWEST_SAMPLES}"


@dataclass(frozen=True, eq=False)
class EstimateJob:
    """One estimate: of `record`, or of a record simulated with `truth` and `experiment` where that is None.

    method, valve, plant and start as `wb.estimate` takes them (start: %, of the two-step method). where: the entry's
    line:column and name in the file, for messages.
    """

    name: str
    where: str
    record: Record | None
    truth: Loop | None
    experiment: Experiment | None
    method: str
    valve: str
    plant: str
    start: float | None
    reference: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    note: str = ""


@dataclass(frozen=True, eq=False)
class EnsembleJob:
    """An ensemble as far as a file says it: values of `Ensemble`'s fields by name."""

    given: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    def of(self, loop: Loop) -> Ensemble:
        """Return it for a loop; what is not given is as in `Ensemble.plant_ready`. Raises `InvalidValue`.

        Where a duration is given alone, the load steps keep their place in it, from 0.2 to 0.5 of it.
        """
        given = dict(self.given)
        if "duration" in given:
            given.setdefault("load_time", (0.2 * given["duration"], 0.5 * given["duration"]))
        return replace(Ensemble.plant_ready(loop), **given)


@dataclass(frozen=True, eq=False)
class RobustJob:
    """What makes a tuning robust: its ensemble, and its budget of valve travel.

    travel_budget: the most mean travel over the ensemble, %, or None; as_case: the case whose own is the budget, or "".
    """

    ensemble: EnsembleJob
    travel_budget: float | None = None
    as_case: str = ""


@dataclass(frozen=True, slots=True)
class TuneJob:
    """A tuning to be found; the case's controller is its start.

    digits: None for what `wb.tune` takes by itself; constraints: None for its default; robust: None for the one
    experiment alone.
    """

    objective: Objective
    bounds: Bounds
    seed: int
    digits: int | None
    restarts: int
    nominal: bool = False
    constraints: Constraints | None = None
    robust: RobustJob | None = None


@dataclass(frozen=True, eq=False)
class CaseJob:
    """One case: the controller to try, or the start of the tuning to find. where: its line:column and name.

    rule: to be applied to the loop with this controller, in place of its Kc, Ti and Td; base: the case whose controller
    takes this one's place before that, or empty. action_given: whether the file says how the controller acts; where it
    does not, an estimated plant's gain says it.
    """

    name: str
    where: str
    controller: PID
    tune: TuneJob | None = None
    rule: Rule | None = None
    base: str = ""
    action_given: bool = True
    reference: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    note: str = ""


@dataclass(frozen=True, slots=True)
class MapJob:
    """A map over Kc (%/EU) and Ti, or Kc and Td (s): ranges, None for those that suit the loop and its cases.

    at_Ti, at_Td: the parameter that is not an axis, None for the first case's.
    """

    Kc: tuple[float, float] | None
    Ti: tuple[float, float] | None
    Td: tuple[float, float] | None
    at_Ti: float | None
    at_Td: float | None
    points: int
    starts: int


@dataclass(frozen=True, eq=False)
class CascadeTuneJob:
    """A cascade to be tuned in turn; the case's controllers are the start. secondary: None leaves it as it is."""

    bounds: Bounds
    objective: Objective
    secondary: tuple[Experiment, Objective, Bounds] | None
    seed: int
    restarts: int
    digits: int


@dataclass(frozen=True, eq=False)
class CascadeJob:
    """One case of a cascade: the cascade under its controllers. where: its line:column and name."""

    name: str
    where: str
    cascade: Cascade
    tune: CascadeTuneJob | None = None
    note: str = ""


@dataclass(frozen=True, eq=False)
class Scenario:
    """A checked scenario file.

    loop: as given, under the first case's controller; None where plant and valve come from the first estimate, or no
    case asks for a loop. pv_range: EU, or None. objective: what J is computed with for every case, or None. repair:
    whether to say what repairing the valve is worth. tradeoff: whether to find the front of error against travel.
    cycle_map: the map to draw, or None. cascade: the cases of a cascade, which has no others and no loop.
    ensemble: what the cases are measured in beside the experiment, None where nothing asks for it. site: how the site
    writes its settings, None for the controllers' own form in %/EU and s; cascade_site: both of a cascade. notes: what
    loading assumed or left out (rejected rows, coarse sampling), for the report. warnings: the controllers that act the
    wrong way, which can be run. cautions: what else can be run and is most likely a mistake.
    """

    path: Path
    name: str
    title: str
    description: str
    reference_source: str
    text: str
    loop: Loop | None
    pv_range: tuple[float, float] | None
    experiment: Experiment | None
    objective: Objective | None
    estimates: tuple[EstimateJob, ...]
    cases: tuple[CaseJob, ...]
    describing_function: bool
    limit_cycle: bool
    repair: bool = False
    tradeoff: bool = False
    cycle_map: MapJob | None = None
    ensemble: EnsembleJob | None = None
    cascade: tuple[CascadeJob, ...] = ()
    site: SiteForm | None = None
    cascade_site: CascadeSite | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    cautions: tuple[Caution, ...] = ()

    @property
    def mistakes(self) -> tuple[str, ...]:
        """All that can be run and is most likely a mistake."""
        return (*self.warnings, *(caution.text for caution in self.cautions))
