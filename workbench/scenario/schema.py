"""The scenario's closed schema: what the YAML may hold, entry by entry, with units and ranges.

Pydantic models of the file as written; `workbench.scenario.build` makes the model's values of them. The JSON Schema
for editors, `schema.json` beside this file, is made from here.
"""

from __future__ import annotations

import json
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from workbench.model.tuning import Weighable
from workbench.scenario.compensator_entries import CompensatorEntry
from workbench.scenario.element_entries import Elements, KarnoppValve, OneParameterPlace, Place, PositionalValve
from workbench.scenario.entries import (
    Band,
    BandValue,
    Closed,
    FileName,
    FilterRatio,
    GainValue,
    IntegralRange,
    IntegralTime,
    Name,
    Noise,
    NonNegative,
    Number,
    OneOrMany,
    Percent,
    PositiveTime,
    Seed,
    Size,
    Time,
    Words,
    by_key,
    by_presence,
)
from workbench.scenario.estimate_entries import Estimate
from workbench.scenario.map_entries import MapEntry
from workbench.scenario.robust_entries import ConstraintsEntry, EnsembleEntry, RobustEntry, TravelBudget
from workbench.scenario.rule_entries import RuleEntry
from workbench.scenario.site_entries import SiteEntry

__all__ = [
    "Bounds",
    "Case",
    "Controller",
    "ControllerKeys",
    "Estimate",
    "Experiment",
    "FilePart",
    "KarnoppValve",
    "Loop",
    "OneParameterPlace",
    "Part",
    "Place",
    "PositionalValve",
    "RampPart",
    "RuledCase",
    "ScenarioFile",
    "SeriesPart",
    "StepPart",
    "Tune",
    "TunedCase",
    "Tuning",
    "json_schema",
]


class FopdtPlant(Closed):
    """First order plus dead time: gain exp(-dead_time s) / (time_constant s + 1)."""

    type: Literal["fopdt"]
    gain: Annotated[Number, Field(description="EU per % of valve travel, not 0")]
    time_constant: PositiveTime
    dead_time: Time = 0.0


class IntegratingPlant(Closed):
    """Integrator with dead time: gain exp(-dead_time s) / s."""

    type: Literal["integrating"]
    gain: Annotated[Number, Field(description="EU per % of valve travel per second, not 0")]
    dead_time: Time = 0.0


class IdealValve(Closed):
    """A valve without friction."""

    type: Literal["ideal"]


class StenmanValve(Closed):
    """One-parameter stiction: the stem moves to the input once that is more than d away."""

    type: Literal["stenman"]
    d: Annotated[Band, Field(description="stiction, % of travel")]


class HeValve(Closed):
    """Stiction by static and dynamic friction: the stem slips beyond fs and comes to rest fd behind the input."""

    type: Literal["he"]
    fs: Annotated[Band, Field(description="static friction, % of the input's span")]
    fd: Annotated[Band, Field(description="dynamic friction, % of the input's span; at most fs")]


class ChoudhuryValve(Closed):
    """Two-parameter stiction: stick band plus dead band S, slip jump J."""

    type: Literal["choudhury"]
    S: Annotated[Band, Field(description="stick band plus dead band, % of travel")]
    J: Annotated[Band, Field(description="slip jump, % of travel")]


class KanoValve(Closed):
    """Two-parameter stiction by the input at which the stem stopped: stick band plus dead band S, slip jump J."""

    type: Literal["kano"]
    S: Annotated[Band, Field(description="stick band plus dead band, % of travel")]
    J: Annotated[Band, Field(description="slip jump, % of travel; at most S")]


class DeadbandValve(Closed):
    """Backlash: the full band b is crossed on each reversal."""

    type: Literal["deadband"]
    b: Annotated[Band, Field(description="full band, % of travel")]


class OneWay(Closed):
    """Two-parameter stiction of one direction."""

    S: Annotated[Band, Field(description="stick band plus dead band, % of travel")]
    J: Annotated[Band, Field(description="slip jump, % of travel")]


class DirectionalValve(Closed):
    """Two-parameter stiction that differs between the way up and the way down."""

    type: Literal["directional"]
    up: OneWay
    down: OneWay


Plant = Annotated[
    Annotated[FopdtPlant, Tag("<fopdt>")] | Annotated[IntegratingPlant, Tag("<integrating>")],
    by_key("type", "fopdt", "integrating"),
]
Valve = Annotated[
    Annotated[IdealValve, Tag("<ideal>")]
    | Annotated[StenmanValve, Tag("<stenman>")]
    | Annotated[HeValve, Tag("<he>")]
    | Annotated[ChoudhuryValve, Tag("<choudhury>")]
    | Annotated[KanoValve, Tag("<kano>")]
    | Annotated[DeadbandValve, Tag("<deadband>")]
    | Annotated[DirectionalValve, Tag("<directional>")]
    | Annotated[PositionalValve, Tag("<positional>")]
    | Annotated[KarnoppValve, Tag("<karnopp>")],
    by_key("type", "ideal", "stenman", "he", "choudhury", "kano", "deadband", "directional", "positional", "karnopp"),
]


class Tuning(Closed):
    """The tuning parameters, in the controller's own form."""

    Kc: Annotated[GainValue | None, Field(description="gain: a number in %/EU, or with its unit %/EU or %/%")] = None
    proportional_band: Annotated[BandValue | None, Field(description="100/Kc in %; needs loop.pv_range")] = None
    Ti: Annotated[IntegralTime | None, Field(description="integral time, s, min, h or repeats/min; none for none")] = (
        None
    )
    Td: Annotated[Time | None, Field(description="derivative time")] = None


class ControllerKeys(Closed):
    """How the controller is built; what is left out is the model's default."""

    form: Literal["ideal", "series", "parallel"] | None = None
    structure: Literal["PID on error", "PI on error, D on PV", "I on error, PD on PV"] | None = None
    derivative_on: Literal["error", "pv"] | None = None
    derivative_filter: Annotated[FilterRatio | None, Field(description="n of Tf = Td/n; none for unfiltered")] = None
    setpoint_weight: Annotated[float | None, Field(ge=0, le=1, allow_inf_nan=False)] = None
    action: Literal["reverse", "direct"] | None = None
    output_limits: Annotated[
        list[Percent] | None, Field(min_length=2, max_length=2, description="[low, high], % from the resting output")
    ] = None
    anti_windup: Literal["clamp", "back_calculation"] | None = None
    tracking_time: PositiveTime | None = None
    output_resolution: Annotated[
        Band | None, Field(description="OP leaves the controller in multiples of this, % from the resting output; 0")
    ] = None
    compensator: Annotated[
        CompensatorEntry | None, Field(description="what the controller does about stiction besides its law")
    ] = None


class Controller(Tuning, ControllerKeys):
    """The controller that the cases start from; each case may override any entry."""


class Loop(Elements):
    """The loop. Plant, valve and sample_time are left out where they come from recorded data."""

    plant: Plant | None = None
    valve: Valve | None = None
    controller: Controller | None = None
    sample_time: PositiveTime | None = None
    pv_range: Annotated[
        list[Number] | None, Field(min_length=2, max_length=2, description="[low, high] of PV in EU")
    ] = None
    coarse_sampling: Annotated[
        bool, Field(description="allow a sample time longer than the time constant or the dead time")
    ] = False


class StepPart(Closed):
    """A step that has happened in the sample at its time."""

    step: Annotated[Size, Field(description="size: EU for a setpoint, % of travel for a load")]
    at: Time = 0.0


class RampPart(Closed):
    """A straight line from 0 at start to its size at end, held afterwards."""

    ramp: Annotated[Size, Field(description="size: EU for a setpoint, % of travel for a load")]
    start: Time = 0.0
    end: Time


class SeriesPart(Closed):
    """Values, one for each sample or each from its time on; the last is held."""

    series: Annotated[list[Number], Field(min_length=1)]
    times: list[Time] | None = None


class FilePart(Closed):
    """A recorded series: a column of a CSV or Parquet file that has a time column; its first row is at 0 s."""

    file: FileName
    column: Name
    time: Annotated[Name | None, Field(description="the time column (default: the one with a usual name)")] = None
    resting_value: Annotated[
        Number | None, Field(description="value at rest, which is taken off (default: the first one)")
    ] = None


Part = Annotated[
    Annotated[StepPart, Tag("<step>")]
    | Annotated[RampPart, Tag("<ramp>")]
    | Annotated[SeriesPart, Tag("<series>")]
    | Annotated[FilePart, Tag("<file>")],
    by_presence("step", "ramp", "series", "file"),
]


class Experiment(Closed):
    """What is done to the loop, in deviations from its resting point."""

    duration: PositiveTime
    setpoint: Annotated[list[Part], OneOrMany()] | None = None
    load: Annotated[list[Part], OneOrMany()] | None = None
    noise: Noise | None = None
    stem_offset: Annotated[Percent, Field(description="resting distance of OP from the stem, %")] = 0.0
    primary_load: (
        Annotated[list[Part], OneOrMany(), Field(description="of a cascade, at the primary, EU of the secondary")]
        | None
    ) = None
    secondary_noise: Annotated[Noise | None, Field(description="of a cascade, on the secondary's measurement")] = None


class Objective(Closed):
    """Weights of the objective; a weight left out is 0."""

    w1: Annotated[NonNegative, Field(description="on the squared error, samples 1..N")] = 0.0
    w2: Annotated[NonNegative, Field(description="on the squared output")] = 0.0
    w3: Annotated[NonNegative, Field(description="on the last squared error")] = 0.0
    w4: Annotated[NonNegative, Field(description="on the squared moves of the output")] = 0.0
    error_variance: Annotated[NonNegative, Field(description="on the variance of SP - PV, EU^2")] = 0.0
    mean_square_error: Annotated[NonNegative, Field(description="on the mean of (SP - PV)^2, EU^2")] = 0.0
    op_variance: Annotated[NonNegative, Field(description="on the variance of OP, %^2")] = 0.0
    valve_variance: Annotated[NonNegative, Field(description="on the variance of the valve position, %^2")] = 0.0
    valve_travel: Annotated[NonNegative, Field(description="on the valve's travel over the run, %")] = 0.0
    controller_travel: Annotated[NonNegative, Field(description="on OP's travel over the run, %")] = 0.0
    reversals: Annotated[NonNegative, Field(description="on the valve's changes of direction")] = 0.0
    iae: Annotated[NonNegative, Field(description="on the integral of |SP - PV|, EU s")] = 0.0
    ise: Annotated[NonNegative, Field(description="on the integral of (SP - PV)^2, EU^2 s")] = 0.0
    pv_sd: Annotated[NonNegative, Field(description="on PV's standard deviation, EU")] = 0.0


class Bounds(Closed):
    """Closed ranges of the tuning search, in the controller's own form."""

    Kc: Annotated[list[GainValue] | None, Field(min_length=2, max_length=2)] = None
    proportional_band: Annotated[list[BandValue] | None, Field(min_length=2, max_length=2)] = None
    Ti: Annotated[IntegralRange | None, Field(min_length=2, max_length=2)] = None
    Td: Annotated[list[Time] | None, Field(min_length=2, max_length=2)] = None


class Tune(Tuning, ControllerKeys):
    """A tuning to be found. Kc, proportional_band, Ti or Td given here are held at that value."""

    objective: Objective | None = None
    bounds: Bounds | None = None
    start: Annotated[Tuning | None, Field(description="the tuning to compare with; must lie within the bounds")] = None
    seed: Seed = 0
    digits: Annotated[int | None, Field(ge=1, le=12, description="significant digits to be typed in; 4")] = None
    nominal: Annotated[bool, Field(description="the least J itself, a cliff: to compare with, not to type in")] = False
    restarts: Annotated[int, Field(ge=1, le=64)] = 4
    robust: Annotated[
        RobustEntry, Field(description="tune over an ensemble of plants: true, or the ensemble written out")
    ] = None
    constraints: ConstraintsEntry | None = None
    travel_budget: Annotated[
        TravelBudget | None, Field(description="most mean valve travel over the ensemble: %, or a case's own")
    ] = None


KpiName = Literal[
    Weighable,
    "overshoot",
    "settling_time",
    "final_error",
    "oscillation_index",
    "oscillation_period",
    "objective",
]
CaseReference = Annotated[
    dict[KpiName, Number], Field(description="published figures to show beside ours, in the figures' own units")
]


class GivenCase(Tuning, ControllerKeys):
    """A tuning to be tried."""

    name: Name
    note: Words = ""
    reference: CaseReference = Field(default_factory=dict)


class RuledCase(ControllerKeys):
    """The tuning that a published rule gives for the loop, at 4 significant digits."""

    name: Name
    note: Words = ""
    reference: CaseReference = Field(default_factory=dict)
    rule: RuleEntry


class TunedCase(Closed):
    """A tuning to be found."""

    name: Name
    note: Words = ""
    reference: CaseReference = Field(default_factory=dict)
    tune: Tune


class CascadeLoop(Closed):
    """The primary of a cascade; the secondary has a valve besides."""

    plant: Plant
    controller: Controller
    sample_time: Annotated[PositiveTime, Field(description="the primary's is a whole number of the secondary's")]
    pv_range: Annotated[
        list[Number] | None, Field(min_length=2, max_length=2, description="[low, high] in EU, for site.gain")
    ] = None


class SecondaryLoop(CascadeLoop):
    """The secondary of a cascade, which holds the valve."""

    valve: Valve


class Cascade(Closed):
    """Two loops, the primary's output the setpoint of the secondary."""

    primary: CascadeLoop
    secondary: SecondaryLoop
    scale: Annotated[Number, Field(description="EU of the secondary per unit of the primary's output, not 0")] = 1.0
    anti_windup: Annotated[
        Literal["clamp", "none"], Field(description="of the primary while the secondary's output is at a limit")
    ] = "clamp"


class CascadeTunePart(Closed):
    """What one loop of a cascade is tuned for. Td given here is held at that value."""

    bounds: Bounds
    Td: Time | None = None
    objective: Objective | None = None


class SecondaryTunePart(CascadeTunePart):
    """The same for the secondary, by itself: its own experiment, with its setpoint in its own EU."""

    experiment: Experiment


class TuneCascade(Closed):
    """Tuning in turn: the secondary, where it is given, by itself; then the primary in the cascade."""

    secondary: SecondaryTunePart | None = None
    primary: CascadeTunePart
    seed: Seed = 0
    restarts: Annotated[int, Field(ge=1, le=64)] = 2
    digits: Annotated[int, Field(ge=1, le=12)] = 4


class CascadedCase(Closed):
    """A case of a cascade: other controllers for one loop or both, or their tuning in turn from what they are."""

    name: Name
    note: Words = ""
    primary: Controller | None = None
    secondary: Controller | None = None
    tune_cascade: TuneCascade | None = None


def _kind(data: object) -> str:
    """Return which of the cases a mapping is; what it holds of another one is then an unknown key."""
    given = data if isinstance(data, dict) else {}
    if not {"primary", "secondary", "tune_cascade"}.isdisjoint(given):
        return "<cascaded>"
    return "<tuned>" if "tune" in given else "<ruled>" if "rule" in given else "<given>"


Case = Annotated[
    Annotated[GivenCase, Tag("<given>")]
    | Annotated[RuledCase, Tag("<ruled>")]
    | Annotated[TunedCase, Tag("<tuned>")]
    | Annotated[CascadedCase, Tag("<cascaded>")],
    Discriminator(_kind),
]


class Analyze(Closed):
    """Which analyses each case gets."""

    describing_function: bool = True
    limit_cycle: bool = True
    repair: Annotated[bool, Field(description="what repairing the valve is worth; takes one or two searches more")] = (
        False
    )
    tradeoff: Annotated[
        bool, Field(description="error against valve travel over the ensemble, with the cases; takes two searches more")
    ] = False
    map: Annotated[MapEntry, Field(description="the long-run behaviour over a plane of tunings, with the cases")] = None


class ScenarioFile(Closed):
    """A Stiction Workbench scenario: a loop, what is done to it, and the tunings to compare."""

    title: Name
    description: Words = ""
    reference_source: Annotated[Words, Field(description="where the reference figures come from")] = ""
    loop: Loop | None = None
    cascade: Annotated[Cascade | None, Field(description="two loops in place of loop")] = None
    experiment: Experiment | None = None
    objective: Objective | None = None
    ensemble: Annotated[
        EnsembleEntry | None,
        Field(description="what robust tunings and the trade-off share, and cases are measured in"),
    ] = None
    estimate: Annotated[list[Estimate], Field(min_length=1, max_length=50), OneOrMany()] | None = None
    cases: Annotated[list[Case], Field(max_length=200)] = Field(default_factory=list)
    analyze: Analyze = Analyze()
    site: Annotated[SiteEntry | None, Field(description="the site's own form and units")] = None


def json_schema() -> str:
    """Return the JSON Schema of a scenario as text, the content of `schema.json`."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **ScenarioFile.model_json_schema()}
    return json.dumps(schema, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
