"""CSV as it is found in plants, as columns of cells. Nothing is dropped here, only marked."""

from __future__ import annotations

import csv
import io
import re
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import compress, islice
from pathlib import Path
from typing import TextIO

import numpy as np

from workbench.errors import RecordError
from workbench.record.blocks import Block
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

_BLOCK = 1 << 18  # characters looked through at once
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
        at = [file.found[name] for name in ("loop", "tag") if name in file.found]
        found: dict[tuple[str, ...], None] = {}
        for k, block in enumerate(_blocks(file)):
            cut = block.columns(file.mark, len(file.header), at) if k > 0 else None
            if cut is not None:
                found |= dict.fromkeys(zip(*cut, strict=True))
                continue
            rows = file.cells(unguarded(block.lines()))
            if k == 0:
                next(rows)  # the header
            found |= dict.fromkeys(tuple(row[i] for i in at) for row in rows if len(row) > max(at))
        pairs = ((cells[0].strip() if len(at) > 1 else "", cells[-1].strip()) for cells in found)
        return file.header, list(dict.fromkeys(pair for pair in pairs if pair[1]))


def _blocks(file: _Opened) -> Iterator[Block]:
    """Yield a file's lines from its header on in blocks, the lines read with the header as the first."""
    text, first = "".join(file.lines), file.skipped + 1
    while text:
        block = Block(text, first)
        yield block
        first += block.numbers.size
        text = file.stream.read(_BLOCK) + file.stream.readline()
        if file.cut is not str:
            text = "".join(map(file.cut, io.StringIO(text, newline="")))


class _Lines:
    """A file's lines from its header on, one by one, by blocks.

    words: lines without any of them are left out where that can be told (see `Block.having`), but for those read with
    the header; none for all lines. block: the present one; given: how many of its lines were.
    """

    def __init__(self, file: _Opened, words: Collection[str]) -> None:
        self._blocks = _blocks(file)
        self._pattern = re.compile("|".join(map(re.escape, words))) if words else None
        self._take(next(self._blocks))

    def _take(self, block: Block) -> None:
        self.block, self.given, self._each = block, 0, iter(block.lines())

    def left(self) -> bool:
        """Whether there is a line more; the present block is then the one that it is of."""
        while self.given == self.block.numbers.size:
            block = next(self._blocks, None)
            if block is None:
                return False
            self._take(block if self._pattern is None else block.having(self._pattern))
        return True

    def __iter__(self) -> Iterator[str]:
        while self.left():
            self.given += 1
            yield next(self._each)


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
    found, pairs, decimal_comma = file.found, file.pairs, file.mark != ","
    if pairs:
        width = max(value for _, value in pairs.values()) + 1
        pairs = in_use(pairs, wanted)
        kept = [i for pair in pairs.values() for i in pair]
        pairs = {name: (2 * k, 2 * k + 1) for k, name in enumerate(pairs)}
        columns, lines, over = _held(file, kept, width, frozenset(), source)
        columns, of_row = tall_rows(columns, pairs)
        lines, over = array("q", [lines[k] for k in of_row]), bytearray(over[k] for k in of_row)
        header = list(PAIRED)
    else:
        kept = sorted(found.values())
        columns, lines, over = _held(file, kept, len(file.header), wanted, source)
        header = [file.header[i] for i in kept]
        found = {name: kept.index(i) for name, i in found.items()}
    units = _taken_units(columns, lines, over, found, decimal_comma)
    named = {header[found[name]].strip(): (columns[found[name]], lines) for name in NUMERIC if name in found}
    one_mark(named, decimal_comma, "column", "line", source)
    out: dict[str, Cells] = {}
    for name, i in found.items():
        listed = columns[i]
        where = f"{source}: column {header[i].strip()!r}"
        if name in NUMERIC:
            out[name] = number_cells(listed, decimal_comma, where)
        else:
            out[name] = text_cells([cell.strip() for cell in listed], decimal_comma, where, name == "time")
        out[name].marks[np.frombuffer(over, dtype=bool)] = FIELDS
    return Table(out, np.array(lines, dtype=np.int64), "line", file.notes, decimal_comma, units, bool(pairs))


def _held(
    file: _Opened, kept: Sequence[int], width: int, wanted: frozenset[str], source: str
) -> tuple[list[list[str]], array[int], bytearray]:
    """Return the cells of each of the columns `kept`, the line of each row, and whether it has more than `width` cells.

    wanted: as in `read_csv`, of a tall file.
    """
    mark, needed = file.mark, tuple(value for _, value in file.pairs.values()) or tuple(file.found.values())
    by_tag = bool(wanted) and "tag" in file.found
    whose = [file.found[name] for name in ("tag", "loop") if by_tag and name in file.found]

    def is_row(text: str) -> bool:
        cells = text.split(mark)
        return len(cells) >= width and any(as_number(cells[i], mark != ",")[1] == OK for i in needed)

    def is_own(cells: Sequence[str]) -> bool:
        """Whether a row is wanted, by its cells of the tag and, if there is such a column, of the loop."""
        own, *loop = (cell.strip() for cell in cells)
        return own in wanted or ".".join([*loop, own]) in wanted

    words: Collection[str] = ()
    if whose and not any('"' in name for name in wanted):  # which is written otherwise in a file
        words = wanted if len(whose) == 1 else {name.partition(".")[0] for name in wanted}
    text = _Lines(file, words)
    reader = file.cells(unguarded(text))
    next(reader)  # the header
    columns: list[list[str]] = [[] for _ in kept]
    lines, over = array("q"), bytearray()
    while text.left():
        numbers = text.block.numbers
        if text.given == 0 and (cut := text.block.columns(mark, width, kept)) is not None:
            text.given = numbers.size
            if whose:
                told = list(zip(*(cut[kept.index(i)] for i in whose), strict=True))
                own = {cells: is_own(cells) for cells in set(told)}
                chosen = np.array([own[cells] for cells in told], dtype=bool)
                cut, numbers = [list(compress(cells, chosen)) for cells in cut], numbers[chosen]
            for column, cells in zip(columns, cut, strict=True):
                column += cells
            lines.frombytes(numbers.tobytes())
            over.extend(bytes(numbers.size))
            continue
        begin, before = int(numbers[text.given]), reader.line_num  # type: ignore[attr-defined]
        try:
            row = next(reader)
        except csv.Error as error:
            said = f"no readable CSV: {error}; is a quote opened there that is not closed?"
            raise RecordError(f"{source}: line {begin}: {said}") from None
        line = int(text.block.numbers[text.given - 1])
        if reader.line_num > before + 1:  # type: ignore[attr-defined]
            said = _swallowed(row, begin, file.header, is_row)
            if said:
                msg = f"{source}: {said}, up to line {line}; close it, or take it out"
                raise RecordError(msg)
        if not row or (len(row) == 1 and not row[0].strip()):
            continue
        if whose and not is_own([row[i] if i < len(row) else "" for i in whose]):
            continue
        lines.append(line)
        for column, i in zip(columns, kept, strict=True):
            column.append(row[i] if i < len(row) else "")
        # A trailing delimiter makes one empty field more; that is harmless.
        over.append(any(map(str.strip, row[width:])))
    return columns, lines, over


def _taken_units(
    columns: Sequence[list[str]], lines: array[int], over: bytearray, found: Mapping[str, int], decimal_comma: bool
) -> dict[str, str]:
    """Take a wide file's row of units, above all data, out of its rows; return what it says, {} for none.

    lines, over: the line of each row, and whether it has too many fields.
    """
    kinds = [name for name in ("time", *NUMERIC) if name in found and "PV" in found]
    for k in range(min(_UNIT_ROWS, len(lines))):
        cells = {name: columns[found[name]][k].strip() for name in kinds}
        timed = any(mark.isdigit() for mark in cells.get("time", ""))
        if timed or any(as_number(cells[name], decimal_comma)[1] not in (TEXT, BLANK) for name in kinds):
            break
        if any(map(is_unit, cells.values())):
            for column in columns:
                del column[k]
            del lines[k], over[k]
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
