"""Headers of two rows, as spreadsheets have them: tags above, and under each Value, Quality or Timestamp."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence

from workbench.record.names import OWN, QUALITY_WORDS, SPELLINGS, TAGGED, names_time, plain_of, tier_of
from workbench.record.text import delimiter

__all__ = ["in_one_row"]

_BELOW = 3  # lines below one, which show what parts cells
_VALUES = (*OWN["value"], "values", *SPELLINGS["value"])
_SOME = re.compile("|".join(_VALUES), re.IGNORECASE)
_FEWEST = 2  # tags above as many values


def in_one_row(lines: list[str]) -> list[str]:
    """Return a file's first lines, with a header of two rows as one in the place of the upper, the lower left blank.

    Rows between them, of descriptions and units, stay below the header. A value has its tag's name, a quality this and
    its own: a tag stands above its first column at least.
    """
    for k, line in enumerate(lines):
        if not _SOME.search(line):
            continue
        mark = delimiter(line, lines[k + 1 : k + 1 + _BELOW])
        lower = _cells(line, mark)
        values = [i for i, cell in enumerate(lower) if plain_of(cell) in _VALUES]
        if len(values) < _FEWEST or not all(map(_says_kind, filter(None, lower))):
            continue
        for j in range(k - 1, -1, -1):
            upper = _cells(lines[j], mark) + [""] * len(lower)
            if sum(any(tier_of(upper[i], signal) is not None for signal in TAGGED) for i in values) >= _FEWEST:
                return [*lines[:j], _line(_joint(upper, lower), mark), *lines[j + 1 : k], "\n", *lines[k + 1 :]]
    return lines


def _cells(line: str, mark: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])]
    except csv.Error:  # which is told where the rows are read
        return []


def _says_kind(cell: str) -> bool:
    return plain_of(cell) in (*_VALUES, *QUALITY_WORDS) or names_time(cell)


def _joint(upper: Sequence[str], lower: Sequence[str]) -> list[str]:
    """Return one name for each column of two rows of names."""
    names, tag = [], ""
    for above, below in zip(upper, lower, strict=False):
        tag = above or tag
        if not below or plain_of(below) in _VALUES or (names_time(above) and names_time(below)):
            names.append(above or (tag if below else ""))
        elif names_time(below):
            names.append(below)
        else:
            names.append(f"{tag} {below}")
    return names


def _line(cells: Sequence[str], mark: str) -> str:
    stream = io.StringIO(newline="")
    csv.writer(stream, delimiter=mark, lineterminator="\n").writerow(cells)
    return stream.getvalue()
