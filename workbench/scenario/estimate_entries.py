"""Estimates in a scenario: where the record comes from, how its columns are named, and the method."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from workbench.scenario.entries import (
    Band,
    Closed,
    FileName,
    Name,
    Noise,
    Number,
    PositiveTime,
    Time,
    Words,
)

__all__ = ["Estimate"]


class EstimateReference(Closed):
    """Published figures of the same record: d, S, J in %, gain in EU/%, times with their unit."""

    d: Band | None = None
    S: Band | None = None
    J: Band | None = None
    gain: Number | None = None
    time_constant: PositiveTime | None = None
    dead_time: Time | None = None


class Columns(Closed):
    """Which column of the data is which signal, where the usual names do not say it."""

    time: Name | None = None
    PV: Name | None = None
    OP: Name | None = None
    SP: Name | None = None
    MODE: Name | None = None
    valve_position: Name | None = None
    tag: Annotated[Name | None, Field(description="of a tall export, as value and quality")] = None
    value: Name | None = None
    quality: Name | None = None


class Tags(Closed):
    """Which tag of a historian's tall export, or column, is which signal, where the tags' endings do not say it."""

    PV: Name | None = None
    OP: Name | None = None
    SP: Name | None = None
    MODE: Name | None = None
    valve_position: Name | None = None


Span = Annotated[list[Number], Field(min_length=2, max_length=2)]


class Estimate(Closed):
    """An estimate of the loop from recorded data, or from a record simulated with this scenario's loop."""

    name: Name | None = None
    data: Annotated[FileName | None, Field(description="CSV or Parquet file, relative to the scenario")] = None
    simulate: Annotated[bool, Field(description="estimate from a record simulated with loop and experiment")] = False
    columns: Columns | None = None
    tags: Tags | None = None
    sample_time: Annotated[PositiveTime | None, Field(description="where the data has no even times")] = None
    pv_range: Annotated[Span | None, Field(description="[low, high] of PV in EU; the loop's where not given")] = None
    op_range: Annotated[Span | None, Field(description="[low, high]: what the data calls 0 and 100 % of OP")] = None
    max_gap: Annotated[PositiveTime | None, Field(description="the longest time without a value that is bridged")] = (
        None
    )
    noise: Annotated[Noise | None, Field(description="of the simulated record, instead of the experiment's")] = None
    method: Literal["profile", "joint", "two_step", "complementarity"] = "profile"
    valve: Literal["auto", "linear", "stenman", "choudhury", "deadband"] = "auto"
    plant: Literal["fopdt", "integrating", "auto"] = "auto"
    start: Annotated[Band | None, Field(description="initial stiction of the two-step method, %")] = None
    reference: EstimateReference | None = None
    note: Words = ""

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.simulate == (self.data is not None):
            raise ValueError("must hold either data (a file) or simulate: true")
        return self
