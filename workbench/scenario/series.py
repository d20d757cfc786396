"""Recorded data of a scenario: records to estimate from, their clock for the experiment, and columns as profiles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from workbench.errors import RecordError
from workbench.model.experiment import Experiment, Series
from workbench.model.numbers import given
from workbench.model.record import Record
from workbench.record.columns import match_columns
from workbench.record.csv_file import read_csv
from workbench.record.parquet import read_parquet
from workbench.record.reader import read_record
from workbench.record.signals import clock_of
from workbench.record.table import BLANK, OK
from workbench.scenario import schema

__all__ = ["LARGEST", "in_samples", "read_data", "read_series"]

LARGEST = 64 << 20  # bytes
CLOCK = 5e-3  # relative change of a duration by which it is fitted to a record's clock


def in_samples(experiment: Experiment, sample_time: float, notes: list[str]) -> Experiment:
    """Return the experiment over whole samples (s) of a record's clock, which no round duration need fit; note it.

    A duration that is further off than half a per cent is left as it is, to be refused. Raises `InvalidValue` where a
    signal starts after the fitted duration.
    """
    ratio = experiment.duration / sample_time
    samples = round(ratio)
    if not 1e-9 * samples < abs(ratio - samples) <= CLOCK * samples:
        return experiment
    notes.append(
        f"The experiment takes {given(samples * sample_time, 6)} s for the {experiment.duration:g} s given: "
        f"{samples:,} samples of the record's {given(sample_time, 6)} s."
    )
    return replace(experiment, duration=samples * sample_time)


def read_data(path: Path, given: schema.Estimate, pv_range: tuple[float, float] | None) -> Record:
    """Return the record that an estimate's entries ask for; pv_range: the loop's, EU, where the estimate has none."""
    return read_record(
        path,
        columns=None if given.columns is None else given.columns.model_dump(exclude_none=True),
        tags=None if given.tags is None else given.tags.model_dump(exclude_none=True),
        sample_time=given.sample_time,
        pv_range=given.pv_range or pv_range,
        op_range=given.op_range,
        max_gap=given.max_gap,
    )


def read_series(path: Path, source: str, column: str, time: str | None, resting_value: float | None) -> Series:
    """Return a column as deviations from `resting_value` (default: its first value), each held from its time on.

    Time starts at 0 with the first row. A blank cell holds the value before it; text, infinite numbers, times that do
    not ascend, and a missing column are refused: `RecordError`, naming the file (`source`), line and column.
    """
    if not path.is_file():
        what = "is a directory" if path.is_dir() else "no such file"
        raise RecordError(f"{source}: {what}; a CSV or Parquet file is needed")
    if path.stat().st_size > LARGEST:
        raise RecordError(f"{source}: larger than {LARGEST >> 20} MiB; too large for a profile")

    def match(header: list[str]) -> dict[str, int]:
        names = [name.strip() for name in header]
        times = [i for i, name in enumerate(names) if (name == time if time is not None else _is_time(name))]
        values = [i for i, name in enumerate(names) if name == column]
        there = ", ".join(repr(name) for name in names[:50])
        for what, found in (
            (f"column {column!r}", values),
            (f"time column {time!r}" if time else "time column", times),
        ):
            if len(found) != 1:
                how_many = "no" if not found else f"{len(found)} of the"
                raise RecordError(f"{source}: {how_many} {what}; the file has {there}")
        if times == values:
            raise RecordError(f"{source}: column {column!r} is the time column; another one is needed")
        return {"time": times[0], "PV": values[0]}

    with path.open("rb") as stream:
        is_parquet = stream.read(4) == b"PAR1"
    table, header = (read_parquet if is_parquet else read_csv)(path, match, source)
    if table.lines.size == 0:
        raise RecordError(f"{source}: a header and no row of data")
    seconds = clock_of(table.columns["time"], header[match(header)["time"]].strip(), table, source, []).seconds
    values = table.columns["PV"].values.copy()
    marks = table.columns["PV"].marks
    bad = ((marks != OK) & (marks != BLANK)) | ~np.isfinite(seconds)
    if marks[0] == BLANK:
        bad[0] = True
    bad[1:] |= ~(np.diff(seconds) > 0.0)
    if bad.any():
        first = int(np.argmax(bad))
        what = "no finite number" if marks[first] != OK else "its time does not come after the one before it"
        raise RecordError(f"{source}: {table.unit} {table.lines[first]}, column {column!r}: {what}")
    last = np.maximum.accumulate(np.where(marks == OK, np.arange(values.size), 0))
    values = values[last]
    rest = float(values[0]) if resting_value is None else resting_value
    return Series((values - rest).tolist(), (seconds - seconds[0]).tolist())


def _is_time(name: str) -> bool:
    others = ["PV", "OP"]
    return name not in others and "time" in match_columns([name, *others], dict(zip(others, others, strict=True)), "")
