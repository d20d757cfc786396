"""Rows on disk: parts written as they come, so that a run that was interrupted goes on, and the files of a whole run.

A part is a Parquet file of some rows, written beside its place and renamed; it carries what was asked of the run. Parts
are removed when fleet.parquet holds all rows.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import time
from collections.abc import Container, Iterable, Sequence
from contextlib import suppress
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

from workbench import __version__
from workbench.errors import OutputError
from workbench.model.fleet import FleetRow, Settings
from workbench.report.cells import harmless
from workbench.report.files import write_files

__all__ = ["MARK", "ROWS", "Store", "fleet_csv", "read_rows"]

ROWS = "fleet.parquet"
PARTS = "parts"
BATCH, PATIENCE = 64, 5.0  # rows, and s, after which a part is written
ANEW = "anew"  # beside the parts of a run that goes on from no whole one
MARK = b"workbench.fleet"  # of a Parquet file of rows: its metadata say what was asked
# Not for people: the mark of the entry, phases and trends.
_HIDDEN = ("entry", "phase_step", "phase_first", "phases", "trend", "trend_hours")


def _schema(asked: str) -> Any:
    import pyarrow as pa

    kinds = {"str": pa.string(), "bool": pa.bool_(), "float": pa.float64(), "int": pa.int64(), "bytes": pa.binary()}
    return pa.schema([(one.name, kinds[str(one.type)]) for one in fields(FleetRow)], metadata={MARK: asked.encode()})


def _asked(source: str, settings: Settings) -> str:
    return json.dumps({"version": __version__, "source": source, **asdict(settings)}, sort_keys=True)


def _table(rows: Sequence[FleetRow], asked: str) -> Any:
    import pyarrow as pa

    schema = _schema(asked)
    columns = [pa.array([getattr(row, name) for row in rows], schema.field(name).type) for name in schema.names]
    return pa.table(columns, schema=schema)


def read_rows(path: Path) -> tuple[list[FleetRow], str]:
    """Return the rows of a part or of a fleet.parquet, and what was asked of the run. Raises `OutputError`.

    Columns that this version does not know are passed over, and those that are missing take their default.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path, partitioning=None)
    except (pa.ArrowException, OSError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise OutputError(f"{path}: cannot be read as the rows of a fleet run ({said})") from None
    asked = (table.schema.metadata or {}).get(MARK, b"").decode()
    if not asked or "name" not in table.column_names:
        raise OutputError(f"{path}: holds no rows of a fleet run")
    known = {one.name: one for one in fields(FleetRow)}
    names = [name for name in table.column_names if name in known]
    rows = []
    for values in zip(*(table.column(name).to_pylist() for name in names), strict=True):
        given: dict[str, Any] = {
            name: known[name].default if value is None and known[name].default is not MISSING else value
            for name, value in zip(names, values, strict=True)
        }
        rows.append(FleetRow(**given))
    return rows, asked


class Store:
    """The folder of a run: done holds the rows that are safely there, by name.

    source: the site, as it was named; a loop of another site may have the same name. resume: go on with what the folder
    holds of the latest run of that with the same settings, else begin anew. Before `begin` all stays as it is.
    Raises `OutputError` where the folder holds another run to resume.
    """

    def __init__(self, folder: Path, source: str, settings: Settings, resume: bool) -> None:
        self.folder, self.asked, self.resume = folder, _asked(source, settings), resume
        self.done: dict[str, FleetRow] = {}
        self.fresh: list[FleetRow] = []
        self.since = time.monotonic()
        self.dropped = 0
        parts = sorted((folder / PARTS).glob("part-*.parquet"))
        if resume:
            # A whole run's files stay until the next one is whole, which does not make its rows this one's.
            whole = folder / ROWS
            for path in [*([whole] if whole.is_file() and not (folder / PARTS / ANEW).exists() else []), *parts]:
                self._take(path)
        self.spare = [] if resume else parts
        self.number = 1 + max((int(path.stem.split("-")[1]) for path in parts if resume), default=0)

    def begin(self) -> None:
        """Make the folder ready for rows and drop an unfinished run that is not resumed. Raises `OutputError`."""
        parts = self.folder / PARTS
        try:
            parts.mkdir(parents=True, exist_ok=True)
            for path in parts.glob(".*.tmp"):
                path.unlink()
            if not self.resume:
                (parts / ANEW).touch()
        except OSError as error:
            raise OutputError(f"{self.folder}: cannot be written ({error.strerror or error})") from None
        for path in self.spare:
            path.unlink(missing_ok=True)
            self.dropped += 1

    def _take(self, path: Path) -> None:
        rows, asked = read_rows(path)
        if asked != self.asked:
            raise OutputError(
                f"{path}: was made of another site, with other settings or another version ({asked}); resume with "
                "those, or leave --resume out to begin anew"
            )
        for row in rows:
            self.done[row.name] = row  # the latest, where a loop was looked at again

    def add(self, row: FleetRow) -> None:
        """Take a row, and write a part where it is time. Raises `OutputError` (such as a full disk)."""
        self.fresh.append(row)
        if len(self.fresh) >= BATCH or time.monotonic() - self.since >= PATIENCE:
            self.flush()

    def flush(self) -> None:
        """Write the rows taken since the last part. Raises `OutputError`."""
        self.since = time.monotonic()
        if not self.fresh:
            return
        target = self.folder / PARTS / f"part-{self.number:06d}.parquet"
        self._write(self.fresh, target)
        self.number += 1
        self.done.update((row.name, row) for row in self.fresh)
        self.fresh = []

    def _write(self, rows: Sequence[FleetRow], target: Path) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        spare = target.with_name(f".{target.name}.{os.getpid()}.tmp")
        try:
            pq.write_table(_table(rows, self.asked), spare, compression="zstd")
            spare.replace(target)
        except (OSError, pa.ArrowException) as error:
            raise OutputError(f"{target}: cannot be written ({getattr(error, 'strerror', None) or error})") from None
        finally:
            with suppress(OSError):
                spare.unlink(missing_ok=True)

    def page(self, name: str, text: str) -> None:
        """Write a loop's page under its name. Raises `OutputError`."""
        write_files({name: text}, self.folder / "loops")

    def finish(self, rows: Sequence[FleetRow], texts: dict[str, str], pages: Container[str]) -> None:
        """Write fleet.parquet and the texts of a whole run; remove the parts, and pages of a former run not in `pages`.

        Raises `OutputError`.
        """
        self._write(rows, self.folder / ROWS)
        write_files(texts, self.folder)
        former = [path for path in (self.folder / "loops").glob("*.html") if path.name not in pages]
        parts = self.folder / PARTS
        for path in [*parts.glob("part-*.parquet"), parts / ANEW, *former]:
            with suppress(OSError):
                path.unlink()
        with suppress(OSError):
            parts.rmdir()


def fleet_csv(rows: Iterable[FleetRow]) -> str:
    """Return the rows as CSV, without what is not for people; text that a spreadsheet takes for a formula is quoted."""
    names = [one.name for one in fields(FleetRow) if one.name not in _HIDDEN]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([_cell(getattr(row, name)) for name in names])
    return text.getvalue()


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else ""
    return harmless(str(value))
