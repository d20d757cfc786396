"""CSV as it is found in plants, as columns of cells. Nothing is dropped here, only marked."""

from __future__ import annotations

import csv
import io
import re
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TextIO

import numpy as np

from workbench.errors import RecordError
from workbench.record.headings import in_one_row
from workbench.record.influx import SERIES, annotated
from workbench.record.pairs import PAIRED, Pairs, in_use, pairs_of, tall_rows, time_column, unguarded
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

__all__ = ["names_in_csv", "read_csv"]

_BLOCK = 1 << 20  # characters looked through at once
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


@dataclass(frozen=True, eq=False)
class _Opened:
    """A CSV file as far as its header: the lines read from that on, the text after them, and what the header says.

    cut: what makes lines of the text such as `lines` are, `str` where they are; skipped: lines before the header; mark:
    what parts the cells; found, pairs: the columns, and the pairs of such.
    """

    stream: TextIO
    cut: Callable[[str], str]
    lines: list[str]
    skipped: int
    mark: str
    header: list[str]
    found: dict[str, int]
    pairs: Pairs
    notes: list[str]

    def cells(self, lines: Iterable[str]) -> Iterator[list[str]]:
        """Return a reader of the rows that the lines hold."""
        return csv.reader(lines, delimiter=self.mark, skipinitialspace=True, strict=False)

    def further(self) -> Iterator[str]:
        """Return the lines after those read."""
        return map(self.cut, self.stream)


@contextmanager
def _opened(path: Path, match: Callable[[list[str]], dict[str, int]], source: str, apart: bool) -> Iterator[_Opened]:
    notes: list[str] = []
    with _reading(source):
        with path.open("rb") as raw:
            head = raw.read(HEAD)
        encoding = encoding_of(head, source)
        if encoding == "cp1252":
            notes.append("the text is not UTF-8 and was read as Windows-1252")
        with path.open(encoding=encoding, newline="") as stream:
            lines = list(islice(stream, _HEAD_LINES))
            cut = annotated(lines, source)
            if cut is str:
                cut = fixed_width(lines)
            else:
                notes.append(f"InfluxDB's tables taken as one, with the column {SERIES!r}")
            lines = in_one_row(uncommented(list(unguarded(map(cut, lines))), _is_data))
            skipped, mark, header, found, pairs = _header(lines, match, source, apart)
            if any(line.strip() and not line.lstrip().startswith("#") for line in lines[:skipped]):
                notes.append(f"the header is line {skipped + 1}")
            yield _Opened(stream, cut, lines[skipped:], skipped, mark, header, found, pairs, notes)


def read_csv(
    path: Path,
    match: Callable[[list[str]], dict[str, int]],
    source: str,
    apart: bool = False,
    wanted: Collection[str] = (),
) -> tuple[Table, list[str]]:
    """Return the needed columns of a CSV file and its header.

    match: from the header to the column index of each needed signal; "time", where it finds none, is the one other
    column of timestamps. apart: whether a file may have a pair of columns for each tag, of its times and its values;
    they become the columns `PAIRED` of a table. wanted: the tags of a tall file, or of such pairs, of which rows are
    kept, by their names (see `with_loops`); all where none is given. Delimiter comma, semicolon, tab, bar or spaces,
    or columns of fixed width under dashes; a decimal comma in all but the first; UTF-8 (with or without its mark),
    UTF-16 or Windows-1252. Lines before the header that are empty, # or a title are passed over. A row with more fields
    than the header is marked FIELDS (a decimal comma in a comma-separated file shows in that way). A wide file's row of
    units is no row of data. Raises `RecordError`.
    """
    with _opened(path, match, source, apart) as file:
        return _rows(file, frozenset(wanted), source), file.header


def names_in_csv(
    path: Path, match: Callable[[list[str]], dict[str, int]], source: str
) -> tuple[list[str], list[tuple[str, str]]]:
    """Return a CSV file's header and each (loop, tag) of a tall one, or of pairs of columns, once; none of a wide one.

    match: as in `read_csv`. Of a wide file only the head is read, of a tall one the column of tags, and the one of
    loops if there is one. Raises `RecordError`.
    """
    with _opened(path, match, source, apart=True) as file:
        if file.pairs:
            return file.header, [("", tag) for tag in file.pairs]
        if "tag" not in file.found:
            return file.header, []
        at = sorted(file.found[name] for name in ("loop", "tag") if name in file.found)
        # A cell of each column up to the last of these, those of them told.
        cell = rf"[^{re.escape(file.mark)}\r\n]*"
        line = re.escape(file.mark).join(f"({cell})" if i in at else cell for i in range(max(at) + 1))
        pattern = re.compile(f"^{line}.*", re.MULTILINE)  # to the end of the line, which a search would creep to
        found: dict[tuple[str, ...], None] = {}
        for block in chain(["".join(file.lines[1:])], _blocks(file)):
            if _even(block) and '"' not in block and file.mark != " ":
                told = dict.fromkeys(pattern.findall(block))  # texts of one column, or pairs of two
                found |= told if len(at) > 1 else dict.fromkeys((tag,) for tag in told)
            else:
                rows = file.cells(unguarded(io.StringIO(block, newline="")))
                found |= dict.fromkeys(tuple(row[i] for i in at) for row in rows if len(row) > max(at))
        back = at.index(file.found["tag"])
        pairs = ((told[1 - back].strip() if len(at) > 1 else "", told[back].strip()) for told in found)
        return file.header, list(dict.fromkeys(pair for pair in pairs if pair[1]))


def _blocks(file: _Opened) -> Iterator[str]:
    """Yield the lines after those read in parts that end where a line does."""
    while block := file.stream.read(_BLOCK) + file.stream.readline():
        yield block if file.cut is str else "".join(map(file.cut, io.StringIO(block, newline="")))


def _even(block: str) -> bool:
    """Whether all lines of a block end alike, and no more than whole cells in quotes are in it."""
    return block.count('"') % 2 == 0 and ("\r" not in block or block.count("\r") == block.count("\r\n"))


def _lines_with(file: _Opened, words: Collection[str], at: array[int]) -> Iterator[str]:
    """Yield the header and further lines of a file, all in which one of the words is; at: takes the number of each.

    Lines of a cell that goes on over several are not parted. Most lines are never looked at one by one.
    """
    pattern = re.compile("|".join(map(re.escape, words)))
    last = file.skipped + len(file.lines)
    at.extend(range(file.skipped + 1, last + 1))
    yield from file.lines
    for block in _blocks(file):
        chosen = list(_chosen(block, pattern)) if _even(block) else None
        if chosen is None or any(line.count('"') % 2 for _, line in chosen):
            chosen = list(enumerate(io.StringIO(block, newline="")))
            lines = len(chosen)
        else:
            lines = block.count("\n")
        for number, line in chosen:
            at.append(last + 1 + number)
            yield line
        last += lines


def _chosen(block: str, pattern: re.Pattern[str]) -> Iterator[tuple[int, str]]:
    """Yield the lines of a block in which the pattern is found, each with its number from 0."""
    number, end = 0, 0
    while found := pattern.search(block, end):
        begin = block.rfind("\n", end, found.start()) + 1 or end
        number += block.count("\n", end, begin)
        end = block.find("\n", found.end()) + 1 or len(block)
        yield number, block[begin:end]
        number += 1


def _is_data(cell: str) -> bool:
    return as_number(cell, True)[1] in (OK, NOT_FINITE) or is_timestamp(cell)


def _header(
    lines: list[str], match: Callable[[list[str]], dict[str, int]], source: str, apart: bool
) -> tuple[int, str, list[str], dict[str, int], Pairs]:
    """Return the number of lines before the header, the delimiter, the header, its columns and, if such, their pairs.

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
                return skipped, mark, cells, dict(zip(PAIRED, range(len(PAIRED)), strict=True)), pairs
            found = match(cells)
            if "time" not in found and (column := time_column(cells, below, found)) is not None:
                found["time"] = column
            return skipped, mark, cells, found, {}
        except RecordError as error:
            # If no line is a header, what is wrong with the first one is told.
            parts = max(line.count(mark), 1)
            said = _swallowed(cells, skipped + 1, (), lambda text, m=mark, n=parts: text.count(m) >= n)  # type: ignore[misc]
            refusal = refusal or (RecordError(f"{source}: {said}; close it, or take it out") if said else error)
    nothing = "empty: no header and no row" if len(lines) < _HEAD_LINES else f"no header in {_HEAD_LINES} lines"
    raise refusal or RecordError(f"{source}: {nothing}")


def _rows(file: _Opened, wanted: frozenset[str], source: str) -> Table:
    """Return the table of a file's rows; of each only the cells that are needed are held."""
    mark, found, pairs = file.mark, file.found, file.pairs
    width, needed = len(file.header), tuple(value for _, value in pairs.values()) or tuple(found.values())
    tag, loop = (found.get(name) if wanted and not pairs else None for name in ("tag", "loop"))

    def is_row(text: str) -> bool:
        cells = text.split(mark)
        return len(cells) >= width and any(as_number(cells[i], mark != ",")[1] == OK for i in needed)

    def of_others(row: list[str]) -> bool:
        if tag is None:
            return False
        own, whose = (row[i].strip() if i is not None and i < len(row) else "" for i in (tag, loop))
        return own not in wanted and f"{whose}.{own}" not in wanted

    if pairs:
        width = max(value for _, value in pairs.values()) + 1
        pairs = in_use(pairs, wanted)
        kept = [i for pair in pairs.values() for i in pair]
        pairs = {name: (2 * k, 2 * k + 1) for k, name in enumerate(pairs)}
    else:
        kept = sorted(found.values())
        found = {name: kept.index(i) for name, i in found.items()}
    header = [file.header[i] if i < len(file.header) else "" for i in kept]
    at: array[int] | None = None
    if tag is None or any('"' in name for name in wanted):  # which is written otherwise in a file
        reader = file.cells(chain(file.lines, unguarded(file.further())))
    else:
        at = array("q")
        words = wanted if loop is None else {name.partition(".")[0] for name in wanted}
        reader = file.cells(unguarded(_lines_with(file, words, at)))
    next(reader)

    def line(k: int) -> int:
        """Return the number, in the file, of the k-th line that the reader had."""
        return k + file.skipped if at is None else at[k - 1]

    lines, rows, count = array("q"), [], reader.line_num  # type: ignore[attr-defined]
    while True:
        before = count
        try:
            row = next(reader, None)
        except csv.Error as error:
            said = f"no readable CSV: {error}; is a quote opened there that is not closed?"
            raise RecordError(f"{source}: line {line(before + 1)}: {said}") from None
        if row is None:
            break
        count = reader.line_num  # type: ignore[attr-defined]
        if count > before + 1:
            said = _swallowed(row, line(before + 1), file.header, is_row)
            if said:
                msg = f"{source}: {said}, up to line {line(count)}; close it, or take it out"
                raise RecordError(msg)
        if not row or (len(row) == 1 and not row[0].strip()) or of_others(row):
            continue
        lines.append(line(count))
        # A trailing delimiter makes one empty field more; that is harmless.
        more = [cell for cell in row[width:] if cell.strip()]
        rows.append([row[i] if i < len(row) else "" for i in kept] + more)
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
    wide = [k for k, row in enumerate(rows) if len(row) > len(header)]
    for cells in columns.values():
        cells.marks[wide] = FIELDS
    return Table(columns, np.array(lines, dtype=np.int64), "line", file.notes, mark != ",", units, bool(pairs))


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
