"""What one scenario has produced, ready to be told by the report: no computing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from workbench.model.cascade import CascadeCycle, CascadeRun, CascadeTuned
from workbench.model.checks import choice
from workbench.model.cycle_map import CycleMap
from workbench.model.detection import Detection
from workbench.model.experiment import Experiment
from workbench.model.front import Front, RobustRepair
from workbench.model.loop import Loop
from workbench.model.results import (
    DescribingFunction,
    Estimate,
    Kpis,
    LimitCycle,
    Outcome,
    Repair,
    Robustness,
    Run,
    Standing,
    Tuned,
)
from workbench.model.rule import Rule
from workbench.model.show import Shown
from workbench.model.site import CascadeSite, CascadeSiteCase, SiteCase, SiteForm
from workbench.model.tuning import Objective

__all__ = ["CascadeResult", "CaseResult", "NamedEstimate", "Study"]


@dataclass(frozen=True, eq=False)
class CaseResult:
    """One tuning of the loop: its run, J (None where the scenario has no objective) and the analyses asked for.

    `tuned` where the tuning was found and not given. `agreement`: one sentence on describing function and exact
    verdict, empty where not both were asked for. `reference`: published figures to show beside ours, by the names of
    `model.results.Kpis`, and `objective`. `note`: the scenario's own words on the case.
    `rule`: the rule that gave the tuning. `repaired`: the figures at this tuning with an ideal valve, where asked for.
    `robustness`: how it fares over the study's ensemble, on draws that no search has seen, and `robustness_repaired`
    with an ideal valve; None where the scenario has no ensemble, or the valve does not stick. `nearest_to`: the name of
    the case that the site's form cannot take, where this is what comes nearest to it there. `standing`: whether the
    tuning holds the loop without the valve's stiction, None where nothing is fed back. `unrounded`: what the scenario's
    own digits give, where the site rounds them and the case is of what is typed in there. `chance`: figures of runs
    whose Kc is a hair larger or smaller, where they are others (`analyze.chance`), of a tuning that was given.
    """

    name: str
    loop: Loop
    run: Run
    objective: float | None = None
    tuned: Tuned | None = None
    describing_function: DescribingFunction | None = None
    limit_cycle: LimitCycle | None = None
    agreement: str = ""
    reference: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    note: str = ""
    rule: Rule | None = None
    repaired: Outcome | None = None
    robustness: Robustness | None = None
    robustness_repaired: Robustness | None = None
    nearest_to: str = ""
    standing: Standing | None = None
    unrounded: Outcome | None = None
    chance: tuple[Kpis, ...] = ()

    @property
    def digits(self) -> int | None:
        """The significant digits of the search that found the tuning, None where it was given."""
        return None if self.tuned is None else self.tuned.digits


@dataclass(frozen=True, eq=False)
class NamedEstimate:
    """One estimate under its scenario name; `truth` where the record was simulated from a known loop.

    `reference`: published figures to show beside ours, by the names d, gain, time_constant, dead_time. `detection`: the
    evidence for and against stiction in the same record, without the fitted model; one and the same object for
    estimates from one record.
    """

    name: str
    found: Estimate
    truth: Loop | None = None
    reference: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    note: str = ""
    detection: Detection | None = None


@dataclass(frozen=True, eq=False)
class CascadeResult:
    """One case of a cascade: its run, J (None without an objective), its long run, and what each loop shows alone.

    detections: of the primary's and of the secondary's late record without noise, None where it does not cycle.
    `tuned` where its controllers were found. `unrounded`: the case at the scenario's own digits, its run and J alone,
    where the site rounds them and the case is of what is typed in there.
    """

    name: str
    run: CascadeRun
    objective: float | None = None
    cycle: CascadeCycle | None = None
    detections: tuple[Detection, Detection] | None = None
    tuned: CascadeTuned | None = None
    note: str = ""
    unrounded: CascadeResult | None = None


@dataclass(frozen=True, eq=False)
class Study(Shown):
    """A scenario's results. `name` is the file's stem and the report folder's name; `scenario_text` the YAML as given.

    `reference_source`: where the reference figures come from, in words. `notes`: what an engineer should know about
    how the results came about (coarse sampling, rejected rows ...). `mistakes`: what could be run and most likely was
    meant otherwise. `front`: the trade-off of error and valve travel;
    `robust_repair`: what repair is worth over an ensemble. `cycle_map`: the long-run behaviour over a plane of tunings.
    `cascade`: the cases of a cascade, which has no others. `site`: how the site writes its settings, with every case as
    typed in there, in order; None and empty where the scenario does not say; `cascade_site` and `cascade_site_cases`
    of a cascade. `times`: seconds by stage, for run.json alone.
    """

    name: str
    title: str
    description: str
    scenario_text: str
    experiment: Experiment | None
    objective: Objective | None
    estimates: tuple[NamedEstimate, ...]
    cases: tuple[CaseResult, ...]
    reference_source: str = ""
    notes: tuple[str, ...] = ()
    mistakes: tuple[str, ...] = ()
    repair: Repair | None = None
    front: Front | None = None
    robust_repair: RobustRepair | None = None
    cycle_map: CycleMap | None = None
    cascade: tuple[CascadeResult, ...] = ()
    site: SiteForm | None = None
    site_cases: tuple[SiteCase, ...] = ()
    cascade_site: CascadeSite | None = None
    cascade_site_cases: tuple[CascadeSiteCase, ...] = ()
    times: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def case(self, name: str) -> CaseResult:
        """Return the case of that name. Raises `InvalidValue`; a cascade's cases stand in `cascade`."""
        by_name = {case.name: case for case in self.cases}
        return by_name[choice(name, "Study.case", tuple(by_name))]

    @property
    def tunings(self) -> tuple[tuple[str, Tuned], ...]:
        """Every search under its case's name; of a cascade the secondary's, then the primary's."""
        found = [(case.name, case.tuned) for case in self.cases]
        for one in self.cascade:
            if one.tuned is not None:
                found.append((f"{one.name}, secondary", one.tuned.secondary))
                found.append((f"{one.name}, primary", one.tuned.primary))
        return tuple((name, tuned) for name, tuned in found if tuned is not None)
