"""InfluxDB's annotated CSV: its tables, each with annotations and a header, as one tall table of named series."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence

from workbench.errors import RecordError
from workbench.record.aggregates import aggregate_of
from workbench.record.names import tier_of

__all__ = ["SERIES", "annotated"]

SERIES = "InfluxDB series"  # the column that is put in the place of the empty one for annotations
_BEGIN = ["result", "table"]
# Columns that tell no series from another; nor do those of qualities and units.
_VALUES = {"", *_BEGIN, "_start", "_stop", "_time", "_value"}


def annotated(lines: Sequence[str], source: str) -> Callable[[str], str]:
    """Return what makes lines of such a file those of one tall table; else what leaves lines alone.

    lines: a file's first. Each line, in the file's order, becomes one: a row of the first table's columns, with its
    series' name before them (measurement, tags and field, and mean where that is the result's name), or a blank one.
    What is pivoted, with a column for each field, must be one series' rows. That raises `RecordError` for others.
    """
    return _Tables(source) if any(",result,table," in line for line in lines) else str


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]), [])


class _Tables:
    """The line by line of `annotated`. first, names: columns of the first table and of the one that lines are of."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.line = 0
        self.first: list[str] = []
        self.names: list[str] = []
        self.annotations: dict[str, list[str]] = {}
        self.inside = False
        self.told: list[int] = []
        self.pivoted: list[str] = []

    def __call__(self, line: str) -> str:
        self.line += 1
        cells = _cells(line)
        if not any(map(str.strip, cells)):
            return "\n"
        cells += [""] * (len(_BEGIN) + 1 - len(cells))  # a line that was cut short
        if cells[0].startswith("#"):
            self.annotations = {cells[0]: cells} if self.inside else self.annotations | {cells[0]: cells}
            self.inside = False
            return "\n"
        if cells[1:3] == _BEGIN:
            return self._header(cells)
        return self._row(cells) if self.first else line

    def _header(self, cells: list[str]) -> str:
        self.names, self.inside = cells, True
        grouped = self.annotations.get("#group", [])
        others = [k for k, name in enumerate(cells) if name not in _VALUES]
        others = [k for k in others if tier_of(cells[k], "quality") is None and tier_of(cells[k], "unit") is None]
        keys = [k for k in others if k < len(grouped) and grouped[k] == "true"]
        keys = keys or (others if "_value" in cells else [])
        self.told = sorted(keys, key=lambda k: (cells[k] == "_field", cells[k] != "_measurement"))
        if self.first:
            return "\n"
        self.first = cells
        return _joined([SERIES, *cells[1:]])

    def _row(self, cells: list[str]) -> str:
        if default := self.annotations.get("#default"):
            cells = [cell or (default[k] if k < len(default) else "") for k, cell in enumerate(cells)]
        series = [cells[k] for k in self.told if k < len(cells) and cells[k]]
        if "_value" not in self.names:
            self.pivoted = self.pivoted or series
            if series != self.pivoted:
                below = f"{'.'.join(series)} below {'.'.join(self.pivoted)}, with a column for each field of both"
                msg = f"{self.source}: line {self.line}: {below}; export one of them, or all without pivot()"
                raise RecordError(msg)
        if aggregate_of(f"PV.{cells[1]}")[1]:
            series.append(cells[1])
        if self.names != self.first:
            by = dict(zip(self.names, cells, strict=False))
            cells = [by.get(name, "") for name in self.first] + cells[len(self.names) :]
        return _joined([".".join(series), *cells[1:]])


def _joined(cells: Sequence[str]) -> str:
    quoted = ('"' + cell.replace('"', '""') + '"' if "," in cell or '"' in cell else cell for cell in cells)
    return ",".join(quoted) + "\n"
