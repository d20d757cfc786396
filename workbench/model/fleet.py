"""What a fleet run is asked and what it answers with: loops, a row for each, groups, changes. No computing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from typing import Any

from workbench.errors import InvalidValue
from workbench.model.checks import choice, number
from workbench.model.numbers import duration

__all__ = ["DEPTHS", "Change", "FleetRow", "Group", "LoopSource", "Settings", "Site", "Tuning"]

DEPTHS = ("screen", "estimate", "tune")
FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Tuning:
    """A controller's settings as the manifest gives them: Kc (%/EU), Ti and Td (s), in the form named."""

    Kc: float
    Ti: float
    Td: float = 0.0
    form: str = "ideal"


@dataclass(frozen=True, slots=True)
class LoopSource:
    """Where one loop's data are, and what is known of it.

    path: its own file, or "" where `pieces` (file, row groups) of a tall data set hold its tags, or one file of many
    loops, without row groups, does. columns and tags: pairs (signal, name), as `read_record` takes them. plant:
    "fopdt", "integrating" or "auto". criticality: 1 (least) to 5, 0 where not told. refusal: why it cannot be read at
    all, "" where it can.
    """

    name: str
    path: str = ""
    pieces: tuple[tuple[str, tuple[int, ...]], ...] = ()
    columns: tuple[tuple[str, str], ...] = ()
    tags: tuple[tuple[str, str], ...] = ()
    sample_time: float | None = None
    pv_range: tuple[float, float] | None = None
    op_range: tuple[float, float] | None = None
    max_gap: float | None = None
    plant: str = "auto"
    tuning: Tuning | None = None
    area: str = ""
    criticality: int = 0
    refusal: str = ""


@dataclass(frozen=True, slots=True)
class Settings:
    """What is to be done with each loop; two runs with equal settings give equal rows.

    depth: "screen", "estimate" or "tune". begin, end: of the window of time, s since 1970; zoned: whether they are
    instants, else they are by the clock of each record's own timestamps. last: s before a record's end; None where not
    limited. Raises `InvalidValue`.
    """

    depth: str = "screen"
    begin: float | None = None
    end: float | None = None
    last: float | None = None
    zoned: bool = False

    def __post_init__(self) -> None:
        choice(self.depth, "--depth", DEPTHS)
        if self.last is not None:
            number(self.last, "--last", above=0.0, unit="s")
        if self.begin is not None and self.end is not None and not self.begin < self.end:
            raise InvalidValue("--from", _at(self.begin), f"must be before --to, {_at(self.end)}")

    @property
    def window(self) -> str:
        """The window of time in words, "" without one."""
        bounds = [f"{word} {_at(at)}" for word, at in (("from", self.begin), ("to", self.end)) if at is not None]
        said = [f"{' '.join(bounds)}, {'UTC' if self.zoned else 'by the clock of each record'}"] if bounds else []
        return "; of that ".join([*said, *([f"the last {duration(self.last)} of each record"] if self.last else [])])

    def window_as_data(self) -> dict[str, str | float | None]:
        """Return the window for a file: ISO 8601, with UTC's zone where it has one, and s."""
        zone = "+00:00" if self.zoned else ""
        begin, end = (None if at is None else _at(at, "T") + zone for at in (self.begin, self.end))
        return {"from": begin, "to": end, "last": self.last}


def _at(seconds: float, between: str = " ") -> str:
    """Return a time of the window, s since 1970, as it is written without a zone."""
    return datetime.fromtimestamp(seconds, UTC).replace(tzinfo=None).isoformat(between)


@dataclass(frozen=True, slots=True)
class FleetRow:
    """One loop's result; nan and "" where a figure does not apply.

    status: "ok", or "failed" with the reason. samples of sample_time s were looked at, over hours; automatic: share of
    the time in automatic or cascade, nan where no mode is recorded; saturated: share of the samples with OP at its
    highest or lowest value. pv_sd in EU, error_sd of SP - PV in EU, op_travel in % an hour.

    oscillation_index 0 to 1, period (s) and regularity of PV's strongest oscillation; oscillates: whether that is one.
    verdict: "stiction", "no_stiction", "undecided"; likelihood: log likelihood ratio of the stem that predicts PV best
    to the linear loop; predicts: share of the unpredicted that it explains; swing: its stick band over the range of OP,
    near 1 where the stick makes the swing; all three of the stretch of the screening, which is alike for every loop.
    evidence: the share of `predicts` in the stretch that the verdict rests on, a model's where it went before.
    stiction: stick band (d or S), % of travel, as the stem test or the model found it, with its 95 % range from a
    model; jump: slip jump, %. model_* and plant: of the model; identifiable: whether the record pins its stiction; Kc,
    Ti, Td, form: proposed tuning, present_*: the present one, as the manifest gives it; gain_of_tuning: objective J
    with the former over that with the latter; hint: why the proposal is no more than one, "" where it is.

    phase_step (s), phase_first and phases (a byte each, 256 to a turn): the phase of PV's oscillation at the instants
    `phase_step (phase_first + i)` of the data's clock. trend: PV of the latest cycles, a byte each. entry: a mark of
    what the source said of the loop, by which a run that goes on knows a row that still holds.
    """

    name: str
    status: str = "ok"
    reason: str = ""
    area: str = ""
    criticality: int = 0
    verdict: str = ""
    oscillates: bool = False
    oscillation_index: float = math.nan
    period: float = math.nan
    regularity: float = math.nan
    stiction: float = math.nan
    stiction_low: float = math.nan
    stiction_high: float = math.nan
    jump: float = math.nan
    likelihood: float = math.nan
    predicts: float = math.nan
    swing: float = math.nan
    evidence: float = math.nan
    samples: int = 0
    sample_time: float = math.nan
    hours: float = math.nan
    automatic: float = math.nan
    saturated: float = math.nan
    pv_sd: float = math.nan
    error_sd: float = math.nan
    op_travel: float = math.nan
    plant: str = ""
    model_gain: float = math.nan
    model_time_constant: float = math.nan
    model_dead_time: float = math.nan
    identifiable: bool = False
    Kc: float = math.nan
    Ti: float = math.nan
    Td: float = math.nan
    form: str = ""
    gain_of_tuning: float = math.nan
    hint: str = ""
    present_Kc: float = math.nan
    present_Ti: float = math.nan
    present_Td: float = math.nan
    present_form: str = ""
    reasons: str = ""
    notes: str = ""
    trend_hours: float = math.nan
    phase_step: float = math.nan
    phase_first: int = 0
    phases: bytes = b""
    trend: bytes = b""
    entry: str = ""

    @property
    def failed(self) -> bool:
        """Whether the loop could not be looked at."""
        return self.status == FAILED

    @property
    def sticks(self) -> bool:
        """Whether the verdict is stiction."""
        return self.verdict == "stiction"

    @property
    def vague(self) -> bool:
        """Whether its stiction is a hint alone: of a model that the record does not pin."""
        return self.sticks and bool(self.plant) and not self.identifiable

    @classmethod
    def failure(cls, loop: LoopSource, reason: str) -> FleetRow:
        """Return the row of a loop that could not be looked at."""
        return cls(loop.name, FAILED, reason, area=loop.area, criticality=loop.criticality)

    def values(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {one.name: getattr(self, one.name) for one in fields(self)}


@dataclass(frozen=True, slots=True)
class Group:
    """Loops that oscillate together, the likely root first; period: s, of the root; locked: each one's phase coherence
    with the root, 0 to 1, the root's own 1. sticky: whether the root's valve shows stiction."""

    members: tuple[str, ...]
    locked: tuple[float, ...]
    period: float
    sticky: bool


@dataclass(frozen=True, slots=True)
class Change:
    """What changed for one loop since the run before, in words; kind: "worse", "better", "new" or "gone"."""

    name: str
    kind: str
    words: str


@dataclass(frozen=True, eq=False)
class Site:
    """A whole run: rows by rank, groups, and the changes since the run before (None without one).

    untold: loops that oscillate over too few recorded cycles to tell whether they do so with another.
    """

    title: str
    source: str
    settings: Settings
    rows: tuple[FleetRow, ...]
    groups: tuple[Group, ...] = ()
    changes: tuple[Change, ...] | None = None
    pages: frozenset[str] = field(default_factory=frozenset)
    untold: frozenset[str] = field(default_factory=frozenset)

    @property
    def looked_at(self) -> tuple[FleetRow, ...]:
        """The rows of loops that could be looked at."""
        return tuple(row for row in self.rows if not row.failed)

    @property
    def failures(self) -> tuple[FleetRow, ...]:
        """The rows of loops that could not."""
        return tuple(row for row in self.rows if row.failed)
