"""What spreadsheets make of a historian's data: pairs of columns, cells held to be text, times without a name."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from workbench.errors import RecordError
from workbench.model.checks import reads_as_number
from workbench.record.clock import of_the_day
from workbench.record.names import names_time
from workbench.record.times import is_timestamp
from workbench.record.units import time_unit

__all__ = ["PAIRED", "Pairs", "in_use", "pairs_of", "tall_rows", "time_column", "unguarded", "unnamed"]

# What the columns of pairs are once they stand below each other, as in a tall file.
PAIRED = ("tag", "time", "value")
_LOOKED_AT = 20  # rows below a header
_KEPT_AS_TEXT = re.compile(r'(^|[,;\t|])="([^"\r\n]*)"')

# The columns of each tag's times and values, by the tag.
Pairs = Mapping[str, tuple[int, int]]


def unnamed(name: str) -> bool:
    """Whether a column has no name; pandas makes one up."""
    return not name.strip() or re.fullmatch(r"Unnamed: \d+", name.strip()) is not None


def unguarded(lines: Iterable[str]) -> Iterator[str]:
    """Return lines with `="51.2"`, as a spreadsheet is told that a cell is text, as a cell in quotes."""
    for line in lines:
        yield _KEPT_AS_TEXT.sub(r'\1"\2"', line) if '="' in line else line


def pairs_of(header: Sequence[str], below: Sequence[Sequence[str]], source: str) -> Pairs:
    """Return where a file has two columns for each tag, its own times and its values, and {} where it has not.

    Of a pair either the values have the tag's name, and the times such a name as "Time" or none; or the tag's name
    stands above the times, and none above the values, as where a spreadsheet's function was filled in below the name.
    below: the cells of rows below the header, which show whether there are timestamps; numbers are times where all of
    them have one such name, without a unit. Columns without a name and a cell may part the pairs. Raises `RecordError`
    for tags of the same name.
    """
    names = ["" if unnamed(name) else name.strip() for name in header]
    while names and not names[-1]:
        names.pop()
    filled = [k for k, name in enumerate(names) if name or _cells(below, k)]
    tags = _paired(names, list(range(len(names))), below) or _paired(names, filled, below)
    twice = next((tag for tag, many in Counter(tag for tag, _ in tags).items() if many > 1), None)
    if twice is not None:
        msg = f"{source}: two pairs of columns, of times and values, have the name {twice!r}; each needs its own"
        raise RecordError(msg)
    return {tag: (time, time + 1) for tag, time in tags}


def _paired(names: Sequence[str], columns: list[int], below: Sequence[Sequence[str]]) -> list[tuple[str, int]]:
    """Return each tag of `pairs_of` and the column of its times, where these columns are pairs, and else none."""
    times, values = columns[::2], [*columns[1::2], len(names)][: len(columns[::2])]
    couples = [(names[k], names[j] if j < len(names) else "") for k, j in zip(times, values, strict=True)]
    if len(couples) < 2 or any(j != k + 1 for k, j in zip(times, values, strict=True)):
        return []
    if all(value and not names_time(value) and (not time or names_time(time)) for time, value in couples):
        tags = [value for _, value in couples]
    elif all(time and not value for time, value in couples):
        tags = [time for time, _ in couples]
    else:
        return []
    alike = len({re.sub(r"[\W\d]", "", names[k]).lower() for k in times}) == 1 and names_time(names[times[0]])
    timed = [_timed(below, k) or (alike and _counted(names[k], below, k)) for k in times]
    if sum(timed) < 2 or not all(one or not _numbered(below, k + 1) for one, k in zip(timed, times, strict=True)):
        return []
    return list(zip(tags, times, strict=True))


def in_use(pairs: Pairs, wanted: Collection[str]) -> Pairs:
    """Return the pairs of the tags wanted; all where none of them is there."""
    return {tag: pair for tag, pair in pairs.items() if tag in wanted} or pairs


def tall_rows(columns: Sequence[list[str]], pairs: Pairs) -> tuple[list[list[str]], list[int]]:
    """Return the columns of `PAIRED` that the pairs are below each other, and the row of each; none for empty pairs."""
    tags, times, values, rows = [], [], [], []
    for tag, (time, value) in pairs.items():
        for row, cells in enumerate(zip(columns[time], columns[value], strict=True)):
            if any(map(str.strip, cells)):
                tags.append(tag)
                times.append(cells[0])
                values.append(cells[1])
                rows.append(row)
    return [tags, times, values], rows


def time_column(header: Sequence[str], below: Sequence[Sequence[str]], found: Mapping[str, int]) -> int | None:
    """Return the one column of a wide file, of no name that tells, that holds timestamps; None where none is, or two.

    Where none holds such, times of day without a date count. found: the columns that are something else; what may only
    be a loop's name may be times as well.
    """
    others = [k for k in range(len(header)) if k not in {i for name, i in found.items() if name != "loop"}]
    columns = [k for k in others if _timed(below, k)]
    columns = columns or [k for k in others if (cells := _cells(below, k)) and of_the_day(cells) is not None]
    return columns[0] if len(columns) == 1 else None


def _cells(below: Sequence[Sequence[str]], column: int) -> list[str]:
    return [cell for row in below[:_LOOKED_AT] if column < len(row) and (cell := row[column].strip())]


def _timed(below: Sequence[Sequence[str]], column: int) -> bool:
    """Whether most of a column's cells are timestamps; titles, units and "No Data" may stand among them."""
    cells = _cells(below, column)
    return bool(cells) and 2 * sum(not reads_as_number(cell) and is_timestamp(cell) for cell in cells) > len(cells)


def _counted(name: str, below: Sequence[Sequence[str]], column: int) -> bool:
    """Whether all of a column's cells are numbers, and its name gives them no unit: that would be lost in a pair."""
    cells = _cells(below, column)
    numbers = all(reads_as_number(cell.replace(",", ".")) for cell in cells)
    return bool(cells) and numbers and time_unit(name) in (None, 1.0)


def _numbered(below: Sequence[Sequence[str]], column: int) -> bool:
    return any(reads_as_number(cell.replace(",", ".")) for cell in _cells(below, column))
