"""Files as columns of numbers: CSV as it is found in plants, and Parquet. Nothing is dropped here, only marked."""

from __future__ import annotations

import csv
import io
import math
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import RecordError
from workbench.model.record import FloatArray

__all__ = ["BLANK", "NOT_FINITE", "OK", "TEXT", "Cells", "Table", "read_csv", "read_parquet"]

OK, BLANK, TEXT, NOT_FINITE, FIELDS = range(5)

# Enough to find the delimiter and to tell text from a binary file.
_HEAD = 65536


@dataclass
class Cells:
    """One column: values (nan where bad) and marks (OK, BLANK, TEXT, NOT_FINITE, FIELDS), with the first bad text."""

    values: FloatArray
    marks: NDArray[np.int8]
    first_text: str = ""
    texts: list[str] | None = None


@dataclass
class Table:
    """A file's needed columns; lines[i] is row i's line (CSV) or row number from 1 (Parquet), `unit` names which."""

    columns: dict[str, Cells]
    lines: NDArray[np.int64]
    unit: str
    notes: list[str] = field(default_factory=list)


def _number(cell: str, decimal_comma: bool) -> tuple[float, int]:
    text = cell.strip()
    if not text:
        return math.nan, BLANK
    if decimal_comma and "," in text and "." not in text:
        text = text.replace(",", ".")
    try:
        value = float(text) if "_" not in text else None
    except ValueError:
        value = None
    if value is None:
        return math.nan, TEXT
    return (value, OK) if math.isfinite(value) else (math.nan, NOT_FINITE)


class _Numbers:
    """Collects one numeric column."""

    def __init__(self, decimal_comma: bool) -> None:
        self.values, self.marks, self.comma, self.first = array("d"), array("b"), decimal_comma, ""

    def add(self, cell: str) -> None:
        value, mark = _number(cell, self.comma)
        if mark == TEXT and not self.first:
            self.first = cell.strip()
        self.values.append(value)
        self.marks.append(mark)

    def cells(self) -> Cells:
        return Cells(np.array(self.values, dtype=np.float64), np.array(self.marks, dtype=np.int8), self.first)


def _encoding(head: bytes, source: str) -> str:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if any(b < 32 and b not in (9, 10, 12, 13) for b in head):
        msg = f"{source}: this is no text file (it holds binary bytes); CSV or Parquet is needed"
        raise RecordError(msg)
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        # The head may end within a character; anything before that is another encoding.
        if error.start < len(head) - 3 or len(head) < _HEAD:
            return "cp1252"
    return "utf-8-sig"


@contextmanager
def _reading(source: str) -> Iterator[None]:
    try:
        yield
    except UnicodeError as error:
        msg = f"{source}: text in no known encoding ({error.__class__.__name__}); UTF-8, UTF-16 or Windows-1252 needed"
        raise RecordError(msg) from None
    except csv.Error as error:
        msg = f"{source}: no readable CSV: {error}"
        raise RecordError(msg) from None
    except OSError as error:
        msg = f"{source}: cannot be read: {error.strerror or error}"
        raise RecordError(msg) from None


def _delimiter(line: str) -> str:
    bare = "".join(part for i, part in enumerate(line.split('"')) if i % 2 == 0)
    counts = {mark: bare.count(mark) for mark in ("\t", ";", ",")}
    # A comma may be a decimal comma or part of a name where another delimiter is there.
    return next((mark for mark in ("\t", ";") if counts[mark]), ",")


def read_csv(path: Path, match: Callable[[list[str]], dict[str, int]], source: str) -> tuple[Table, list[str]]:
    """Return the needed columns of a CSV file and its header.

    match: from the header to the column index of each needed signal. Delimiter comma, semicolon or tab, with a decimal
    comma allowed for the latter two; UTF-8 (with or without a byte order mark), UTF-16 or Windows-1252. Lines before
    the header that are empty or start with # are passed over. A row with more fields than the header is marked FIELDS
    (a decimal comma in a comma-separated file shows in that way). Raises `RecordError`.
    """
    notes: list[str] = []
    with _reading(source):
        with path.open("rb") as raw:
            head = raw.read(_HEAD)
        encoding = _encoding(head, source)
        if encoding == "cp1252":
            notes.append("the text is not UTF-8 and was read as Windows-1252")
        with path.open(encoding=encoding, newline="") as stream:
            skipped, first = 0, ""
            for line in stream:
                if line.strip() and not line.lstrip().startswith("#"):
                    first = line
                    break
                skipped += 1
            if not first:
                msg = f"{source}: empty: no header and no row"
                raise RecordError(msg)
            mark = _delimiter(first)
            reader = csv.reader(_chain(first, stream), delimiter=mark, skipinitialspace=True, strict=False)
            header = next(reader)
            if all(_number(cell, mark != ",")[1] == OK for cell in header):
                msg = f"{source}: line {skipped + 1}: numbers where the column names should be; a header line is needed"
                raise RecordError(msg)
            return _rows(reader, header, match(header), mark, skipped, notes), header


def _chain(first: str, stream: io.TextIOWrapper) -> Iterator[str]:
    yield first
    yield from stream


def _rows(
    reader: Iterator[list[str]],
    header: list[str],
    found: dict[str, int],
    mark: str,
    skipped: int,
    notes: list[str],
) -> Table:
    numbers = {name: _Numbers(mark != ",") for name in found if name not in ("time", "MODE")}
    texts: dict[str, list[str]] = {name: [] for name in found if name in ("time", "MODE")}
    lines, wide = array("q"), array("b")
    for row in reader:
        if not row or (len(row) == 1 and not row[0].strip()):
            continue
        lines.append(reader.line_num + skipped)  # type: ignore[attr-defined]
        # A trailing delimiter makes one empty field more; that is harmless.
        wide.append(len(row) > len(header) and any(cell.strip() for cell in row[len(header) :]))
        for name, collected in numbers.items():
            collected.add(row[found[name]] if found[name] < len(row) else "")
        for name, listed in texts.items():
            listed.append(row[found[name]].strip() if found[name] < len(row) else "")
    columns = {name: collected.cells() for name, collected in numbers.items()}
    for name, listed in texts.items():
        columns[name] = text_cells(listed, mark != ",")
    too_wide = np.array(wide, dtype=bool)
    for cells in columns.values():
        cells.marks[too_wide] = FIELDS
    return Table(columns, np.array(lines, dtype=np.int64), "line", notes)


def text_cells(listed: list[str], decimal_comma: bool) -> Cells:
    """Return a column that may hold numbers or text, with both."""
    collected = _Numbers(decimal_comma)
    for cell in listed:
        collected.add(cell)
    cells = collected.cells()
    cells.texts = listed
    return cells


def read_parquet(path: Path, match: Callable[[list[str]], dict[str, int]], source: str) -> tuple[Table, list[str]]:
    """Return the needed columns of a Parquet file and its column names; only these are read. Raises `RecordError`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            header = [str(name) for name in file.schema_arrow.names]
            found = match(header)
            if len(set(header)) < len(header):
                msg = f"{source}: several columns have the same name; each needs its own"
                raise RecordError(msg)
            table = file.read(columns=[header[i] for i in found.values()])
            columns = {name: _arrow_cells(table.column(header[i])) for name, i in found.items()}
            rows = table.num_rows
    except (pa.ArrowException, OSError, ValueError, KeyError, NotImplementedError) as error:
        if isinstance(error, RecordError):
            raise
        msg = (
            f"{source}: no readable Parquet file: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
        )
        raise RecordError(msg) from None
    return Table(columns, np.arange(1, rows + 1, dtype=np.int64), "row"), header


def _arrow_cells(column: object) -> Cells:
    import pyarrow as pa
    import pyarrow.compute as pc

    chunk = column.combine_chunks()  # type: ignore[attr-defined]
    kind = chunk.type
    if pa.types.is_dictionary(kind):
        chunk = chunk.dictionary_decode()
        kind = chunk.type
    if pa.types.is_timestamp(kind):
        listed = [
            "" if t is None else str(t) for t in pc.cast(chunk, pa.timestamp("us", kind.tz), safe=False).to_pylist()
        ]
        return text_cells(listed, False)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        values = np.array(pc.cast(chunk, pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
        marks = np.where(np.isfinite(values), OK, NOT_FINITE).astype(np.int8)
        marks[np.asarray(pc.is_null(chunk).to_numpy(zero_copy_only=False), dtype=bool)] = BLANK
        values[marks != OK] = np.nan
        return Cells(values, marks)
    return text_cells(["" if v is None else str(v) for v in chunk.to_pylist()], False)
