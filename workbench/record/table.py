"""Columns of a file as cells (`csv_file` and `parquet` have the files). Nothing is dropped here, only marked."""

from __future__ import annotations

import math
import re
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from workbench.errors import RecordError
from workbench.model.record import FloatArray

__all__ = [
    "BLANK",
    "CODE",
    "FIELDS",
    "LARGE",
    "LIMIT",
    "NOT_FINITE",
    "NUMERIC",
    "OK",
    "QUALITY",
    "RANGE",
    "TEXT",
    "Cells",
    "Table",
    "as_number",
    "marked",
    "number_cells",
    "one_mark",
    "text_cells",
]

# What a cell is; all but OK and BLANK are a value that was recorded and cannot be used.
OK, BLANK, TEXT, NOT_FINITE, FIELDS, QUALITY, RANGE, CODE, LARGE = range(9)
# The signals that are numbers and nothing else; the other columns are kept as text too.
NUMERIC = ("PV", "OP", "SP", "valve_position")

# Larger values are fill values of a historian, and their squares would overflow.
LIMIT = 1e100

# What parts thousands and is no mark: a space, of whatever width, or an apostrophe.
_PARTED = re.compile(r"(?<=\d)[ \u00a0\u2009\u202f'\u2019](?=\d{3}(?!\d))")
# Signs that are no hyphen before a number: a minus as typography has it, and one behind the number, as SAP writes it.
_MINUS = re.compile(r"^\s*[\u2212\u2013\ufe63\uff0d](?=[\d.,])|^(?=\s*[\d.,]+\s*[-\u2212]\s*$)", re.MULTILINE)
# Numbers with commas: that part thousands, or are decimal marks. 5,461 may be either.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?")
_DECIMAL = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_POINT = re.compile(r"[+-]?[\d,]*\.\d+([eE][+-]?\d+)?")
_POINTED = re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+(,\d+)?%?")
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")


@dataclass
class Cells:
    """One column: values (nan where bad) and marks, shape (N,), with the texts that stood for numbers, counted.

    texts: the cells as text, where they may be timestamps, modes, tags or qualities. stamped: whether a Parquet file's
    timestamps carry a zone, None for anything else; `values` are then seconds since 1970, and east how far, in s, that
    zone is east of Greenwich, None for UTC itself. qualities: that were not good, counted. codes: numbers that stood
    for no value, counted. beyond: the values marked `RANGE`, and between which limits the others lie.
    """

    values: FloatArray
    marks: NDArray[np.int8]
    words: Counter[str] = field(default_factory=Counter)
    texts: list[str] | None = None
    stamped: bool | None = None
    qualities: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    beyond: tuple[FloatArray, float, float] | None = None
    east: FloatArray | None = None

    def take(self, rows: NDArray[np.int64]) -> Cells:
        """Return the cells of these rows, shape (M,), in this order."""
        texts = None if self.texts is None else [self.texts[i] for i in rows.tolist()]
        east = None if self.east is None else self.east[rows]
        return replace(self, values=self.values[rows], marks=self.marks[rows], texts=texts, east=east)

    def alike(self, rows: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether each of these rows, shape (M,), holds the same as its one of the others."""
        a, b = self.values[rows], self.values[others]
        out: NDArray[np.bool_] = (self.marks[rows] == self.marks[others]) & ((a == b) | (np.isnan(a) & np.isnan(b)))
        if self.texts is not None:
            pairs = zip(rows.tolist(), others.tolist(), strict=True)
            out &= np.array([self.texts[i] == self.texts[j] for i, j in pairs], dtype=bool)
        return out

    def as_texts(self) -> list[str]:
        """Return the cells as text."""
        if self.texts is not None:
            return self.texts
        shown = [f"{v:g}" if float(f"{v:g}") == v or v != v else repr(v) for v in self.values.tolist()]
        return ["" if mark == BLANK else text for text, mark in zip(shown, self.marks.tolist(), strict=True)]


@dataclass
class Table:
    """A file's needed columns; lines[i] is row i's line (CSV) or row number from 1 (Parquet), `unit` names which.

    units: what a row of units below the header says of each column, as it is written; no row of data is such. paired:
    whether it was put together from a pair of columns for each tag.
    """

    columns: dict[str, Cells]
    lines: NDArray[np.int64]
    unit: str
    notes: list[str] = field(default_factory=list)
    decimal_comma: bool = False
    units: dict[str, str] = field(default_factory=dict)
    paired: bool = False


def as_number(cell: str, decimal_comma: bool) -> tuple[float, int]:
    """Return the number of a cell, nan where it is none, and its mark; decimal_comma: as in `number_cells`."""
    text = cell.strip().removesuffix("%")
    if not text:
        return math.nan, BLANK
    if decimal_comma and "," in text:
        # Of two marks the last is the decimal one, and the other parts thousands.
        last = text.rfind(",") > text.rfind(".")
        text = text.replace(".", "").replace(",", ".") if last else text.replace(",", "")
    try:
        value = float(text) if "_" not in text else None
    except ValueError:
        value = None
    if value is None:
        return math.nan, TEXT
    if abs(value) <= LIMIT:
        return value, OK
    return math.nan, LARGE if math.isfinite(value) else NOT_FINITE


def marked(values: FloatArray) -> Cells:
    """Return cells of numbers that may not be finite, or too large."""
    fine = np.abs(values) <= LIMIT
    marks = np.where(fine, OK, np.where(np.isfinite(values), LARGE, NOT_FINITE))
    return Cells(np.where(fine, values, np.nan), marks.astype(np.int8))


def _quoted(listed: Sequence[str]) -> tuple[Sequence[str], bool]:
    """Return cells that hold commas without those that part thousands, and whether the commas are decimal ones."""
    plain = [cell.strip().removesuffix("%").strip() for cell in listed]
    parted = [_THOUSANDS.fullmatch(cell) is not None for cell in plain]
    decimal = any(_DECIMAL.fullmatch(cell) and not one for cell, one in zip(plain, parted, strict=True))
    pointed = any(one and cell.count(",") > 1 for cell, one in zip(plain, parted, strict=True)) or any(
        _POINT.fullmatch(cell) for cell in plain
    )
    if any(parted) and pointed and not decimal:
        return [cell.replace(",", "") if one else cell for cell, one in zip(listed, parted, strict=True)], False
    return listed, decimal and not pointed


def _points_part(listed: Sequence[str]) -> bool:
    """Whether a column's points part thousands: in 1.000.120 they do, and then they do so throughout."""
    twice = any(cell.count(".") > 1 for cell in listed)
    return twice and all("." not in cell or _POINTED.fullmatch(cell.strip()) for cell in listed)


def _last(cell: str) -> str:
    """Return which of comma and point stands last in a cell, where a decimal mark does; "" for neither."""
    comma, point = cell.rfind(","), cell.rfind(".")
    return "" if comma == point else "," if comma > point else "."


def _mark(listed: Sequence[str], decimal_comma: bool) -> tuple[str, int, bool] | None:
    """Return the mark that a column's numbers have, a row that shows it, and whether it is sure to be the decimal one.

    Returns None where there is none, or commas alone that are not taken for decimal ones (see `number_cells`).
    """
    doubtful = None
    if decimal_comma and _points_part(listed):
        return None
    for row, cell in enumerate(listed):
        mark = _last(cell)
        if not mark:
            continue
        text = cell.strip().removesuffix("%").strip()
        if _EITHER.fullmatch(text):
            doubtful = doubtful or ((mark, row, False) if decimal_comma or mark == "." else None)
        elif text.count(mark) == 1 and as_number(text, True)[1] == OK:
            return mark, row, True
    return doubtful


def one_mark(
    columns: Mapping[str, tuple[Sequence[str], Sequence[int]]], decimal_comma: bool, what: str, unit: str, source: str
) -> None:
    """Raise `RecordError` where one column's numbers have commas and another's points, and either may part thousands.

    columns: cells and their lines by name; decimal_comma: as in `number_cells`; what: they are, columns or tags; unit:
    what `lines` count. Where both are decimal marks beyond doubt, as in 42,43 and 16.1450, each column is read by its
    own.
    """
    if not all(any(mark in cell for cells, _ in columns.values() for cell in cells) for mark in ",."):
        return
    marks = {name: found for name, (cells, _) in columns.items() if (found := _mark(cells, decimal_comma))}
    for (one, (comma, i, sure)), (other, (point, k, surely)) in product(marks.items(), marks.items()):
        if (comma, point) == (",", ".") and not (sure and surely):
            first, second = (
                f"{what} {name!r} ({columns[name][0][at].strip()!r} in {unit} {columns[name][1][at]})"
                for name, at in ((one, i), (other, k))
            )
            msg = (
                f"{source}: commas in {first} and points in {second}: decimal marks, or thousands? Export all numbers "
                "with one decimal mark, and thousands without a mark"
            )
            raise RecordError(msg)


def number_cells(listed: Sequence[str], decimal_comma: bool, where: str) -> Cells:
    """Return the numbers of a column's cells.

    decimal_comma: whether a comma may be the decimal mark; where it parts cells, one within a quoted cell is that mark,
    or parts thousands, only if the column leaves no doubt which. Raises `RecordError`, beginning with `where`, for a
    column in which some cells have a decimal comma and others a decimal point: one of them parts thousands, but which?
    """
    together = "\n".join(listed)
    if _PARTED.search(together):
        listed = [_PARTED.sub("", cell) for cell in listed]
    if _MINUS.search(together):
        listed = ["-" + _MINUS.sub("", cell).strip(" -\u2212") if _MINUS.search(cell) else cell for cell in listed]
    if not decimal_comma and any("," in cell for cell in listed):
        listed, decimal_comma = _quoted(listed)
    if decimal_comma and _points_part(listed):
        listed = [cell.replace(".", "") for cell in listed]
    together = "\n".join(listed)
    if decimal_comma and "," in together and "." in together:
        comma = next((c for c in listed if _last(c) == "," and as_number(c, True)[1] == OK), None)
        point = next((c for c in listed if _last(c) == "." and as_number(c, True)[1] == OK), None)
        if comma is not None and point is not None:
            msg = (
                f"{where}: decimal commas ({comma.strip()!r}) and decimal points ({point.strip()!r}) in one column; "
                "export with one of them"
            )
            raise RecordError(msg)
    comma_only = decimal_comma and "." not in together
    if "_" not in together and (comma_only or "," not in together) and together.count("\n") == len(listed) - 1:
        # Nearly always every cell is a number, and this takes a tenth of the time.
        with suppress(ValueError):
            return marked(np.array(list(map(float, together.replace(",", ".").split("\n"))), dtype=np.float64))
    values, marks, words = array("d"), array("b"), Counter[str]()
    for cell in listed:
        value, mark = as_number(cell, decimal_comma)
        if mark == TEXT:
            words[cell.strip()] += 1
        values.append(value)
        marks.append(mark)
    return Cells(np.array(values, dtype=np.float64), np.array(marks, dtype=np.int8), words)


def text_cells(listed: list[str], decimal_comma: bool, where: str, numbers: bool = True) -> Cells:
    """Return a column of text; with its numbers as well where `numbers` asks for them and its first cells are such."""
    some = [c for c in listed[:1000] if c.strip()][:50]
    if numbers and sum(as_number(c, decimal_comma)[1] != TEXT for c in some) * 2 >= len(some):
        cells = number_cells(listed, decimal_comma, where)
    else:
        blank = np.array([not c for c in listed], dtype=bool)
        cells = Cells(np.full(len(listed), np.nan), np.where(blank, BLANK, TEXT).astype(np.int8))
    cells.texts = listed
    return cells
