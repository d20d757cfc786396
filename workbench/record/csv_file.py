"""CSV as it is found in plants, as columns of cells. Nothing is dropped here, only marked."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, islice
from pathlib import Path

import numpy as np

from workbench.errors import RecordError
from workbench.record.pairs import PAIRED, Pairs, pairs_of, tall_rows, time_column, unguarded
from workbench.record.table import (
    BLANK,
    FIELDS,
    NOT_FINITE,
    NUMERIC,
    OK,
    TEXT,
    Cells,
    Table,
    as_number,
    number_cells,
    one_mark,
    text_cells,
)
from workbench.record.text import HEAD, delimiter, encoding_of, fixed_width, uncommented
from workbench.record.times import is_timestamp
from workbench.record.units import is_unit

__all__ = ["read_csv"]

_HEAD_LINES = 50  # in which a header is looked for
_BELOW = 3  # rows below it, which show what parts cells
_UNIT_ROWS = 5  # below the header, in which one of units is looked for: descriptions may stand before it


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


def read_csv(
    path: Path, match: Callable[[list[str]], dict[str, int]], source: str, apart: bool = False
) -> tuple[Table, list[str]]:
    """Return the needed columns of a CSV file and its header.

    match: from the header to the column index of each needed signal; "time", where it finds none, is the one other
    column of timestamps. apart: whether a file may have a pair of columns for each tag, of its times and its values;
    they become the columns `PAIRED` of a table. Delimiter comma, semicolon, tab, bar or spaces, or columns of fixed
    width under dashes; a decimal comma in all but the first; UTF-8 (with or without its mark), UTF-16 or Windows-1252.
    Lines before the header that are empty, # or a title are passed over. A row with more fields than the header is
    marked FIELDS (a decimal comma in a comma-separated file shows in that way). A wide file's row of units is no row of
    data. Raises `RecordError`.
    """
    notes: list[str] = []
    with _reading(source):
        with path.open("rb") as raw:
            head = raw.read(HEAD)
        encoding = encoding_of(head, source)
        if encoding == "cp1252":
            notes.append("the text is not UTF-8 and was read as Windows-1252")
        with path.open(encoding=encoding, newline="") as stream:
            head_lines = list(unguarded(islice(stream, _HEAD_LINES)))
            cut = fixed_width(head_lines)
            head_lines = uncommented([cut(line) for line in head_lines], _is_data)
            skipped, mark, found, pairs = _header(head_lines, match, source, apart)
            if any(line.strip() and not line.lstrip().startswith("#") for line in head_lines[:skipped]):
                notes.append(f"the header is line {skipped + 1}")
            lines = chain(head_lines[skipped:], map(cut, unguarded(stream)))
            reader = csv.reader(lines, delimiter=mark, skipinitialspace=True, strict=False)
            header = next(reader)
            return _rows(reader, header, found, pairs, mark, skipped, notes, source), header


def _is_data(cell: str) -> bool:
    return as_number(cell, True)[1] in (OK, NOT_FINITE) or is_timestamp(cell)


def _header(
    lines: list[str], match: Callable[[list[str]], dict[str, int]], source: str, apart: bool
) -> tuple[int, str, dict[str, int], Pairs]:
    """Return the number of lines before the header, the delimiter, the columns and, if they are such, their pairs.

    Titles may stand before a header.
    """
    refusal: RecordError | None = None
    for skipped, line in enumerate(lines):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        mark = delimiter(line, [one for one in lines[skipped + 1 :] if one.strip()][:_BELOW])
        # A name in quotes may go on in the next line.
        rows = csv.reader(lines[skipped:], delimiter=mark, skipinitialspace=True, strict=False)
        cells = next(rows)
        below: list[list[str]] = []
        with suppress(csv.Error):  # which is told where the rows are read
            below += rows
        if all(as_number(cell, mark != ",")[1] == OK for cell in cells):
            msg = f"{source}: line {skipped + 1}: numbers where the column names should be; a header line is needed"
            raise refusal or RecordError(msg)
        try:
            pairs = pairs_of(cells, below, source) if apart else {}
            if pairs:
                return skipped, mark, dict(zip(PAIRED, range(len(PAIRED)), strict=True)), pairs
            found = match(cells)
            if "time" not in found and (column := time_column(cells, below, found)) is not None:
                found["time"] = column
            return skipped, mark, found, {}
        except RecordError as error:
            # If no line is a header, what is wrong with the first one is told.
            parts = max(line.count(mark), 1)
            said = _swallowed(cells, skipped + 1, (), lambda text, m=mark, n=parts: text.count(m) >= n)  # type: ignore[misc]
            refusal = refusal or (RecordError(f"{source}: {said}; close it, or take it out") if said else error)
    nothing = "empty: no header and no row" if len(lines) < _HEAD_LINES else f"no header in {_HEAD_LINES} lines"
    raise refusal or RecordError(f"{source}: {nothing}")


def _rows(
    reader: Iterator[list[str]],
    header: list[str],
    found: dict[str, int],
    pairs: Pairs,
    mark: str,
    skipped: int,
    notes: list[str],
    source: str,
) -> Table:
    lines, rows, last = array("q"), [], reader.line_num + skipped  # type: ignore[attr-defined]
    width, needed = len(header), tuple(value for _, value in pairs.values()) or tuple(found.values())

    def is_row(text: str) -> bool:
        cells = text.split(mark)
        return len(cells) >= width and any(as_number(cells[i], mark != ",")[1] == OK for i in needed)

    while True:
        first = last + 1
        try:
            row = next(reader, None)
        except csv.Error as error:
            msg = f"{source}: line {first}: no readable CSV: {error}; is a quote opened there that is not closed?"
            raise RecordError(msg) from None
        if row is None:
            break
        last = reader.line_num + skipped  # type: ignore[attr-defined]
        if last > first:
            said = _swallowed(row, first, header, is_row)
            if said:
                msg = f"{source}: {said}, up to line {last}; close it, or take it out"
                raise RecordError(msg)
        if not row or (len(row) == 1 and not row[0].strip()):
            continue
        lines.append(last)
        rows.append(row)
    if pairs:
        header = list(PAIRED)
        rows, lines = tall_rows(rows, lines, pairs)
    units = _taken_units(rows, lines, found, mark != ",")
    columns: dict[str, Cells] = {}
    texts = {name: [row[i] if i < len(row) else "" for row in rows] for name, i in found.items()}
    numbers = {header[found[name]].strip(): (texts[name], lines) for name in NUMERIC if name in found}
    one_mark(numbers, mark != ",", "column", "line", source)
    for name, i in found.items():
        listed = texts[name]
        where = f"{source}: column {header[i].strip()!r}"
        if name in NUMERIC:
            columns[name] = number_cells(listed, mark != ",", where)
        else:
            columns[name] = text_cells([cell.strip() for cell in listed], mark != ",", where, name == "time")
    # A trailing delimiter makes one empty field more; that is harmless.
    width = len(header)
    wide = [k for k, row in enumerate(rows) if len(row) > width and any(cell.strip() for cell in row[width:])]
    for cells in columns.values():
        cells.marks[wide] = FIELDS
    return Table(columns, np.array(lines, dtype=np.int64), "line", notes, mark != ",", units, bool(pairs))


def _taken_units(
    rows: list[list[str]], lines: array[int], found: Mapping[str, int], decimal_comma: bool
) -> dict[str, str]:
    """Take a wide file's row of units, above all data, out of its rows and lines; return what it says, {} for none."""
    kinds = [name for name in ("time", *NUMERIC) if name in found and "PV" in found]
    for k, row in enumerate(rows[:_UNIT_ROWS]):
        cells = {name: row[found[name]].strip() if found[name] < len(row) else "" for name in kinds}
        timed = any(mark.isdigit() for mark in cells.get("time", ""))
        if timed or any(as_number(cells[name], decimal_comma)[1] not in (TEXT, BLANK) for name in kinds):
            break
        if any(map(is_unit, cells.values())):
            del rows[k], lines[k]
            return cells
    return {}


def _swallowed(cells: list[str], begin: int, names: Sequence[str], is_row: Callable[[str], bool]) -> str:
    """Return a refusal of cells, from line `begin` on, of which a quoted one holds whole rows; "" where none does.

    A cell may go on over several lines, as comments do; rows within it are those after a quote that was not closed.
    """
    line = begin
    for i, cell in enumerate(cells):
        if any(is_row(part) for part in cell.split("\n")[1:]):
            name = f", column {names[i].strip()!r}" if i < len(names) else ""
            return f'line {line}{name}: a quote (") is opened and not closed, and rows would be taken for its text'
        line += cell.count("\n")
    return ""
