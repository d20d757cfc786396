"""From a file's columns to a loop's signals, each with its own ascending times: wide files and tall exports alike."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from workbench.errors import RecordError
from workbench.model.checks import reads_as_number
from workbench.model.record import FloatArray
from workbench.record.clock import PARTS, as_clocks, digits_of_the_day, durations, of_the_day, put_together
from workbench.record.columns import NEEDED, QUALITIES, TALL, match_tags, with_loops
from workbench.record.counted import counted
from workbench.record.quality import good_quality
from workbench.record.table import (
    BLANK,
    FIELDS,
    LARGE,
    NOT_FINITE,
    NUMERIC,
    OK,
    QUALITY,
    Cells,
    Table,
    number_cells,
    one_mark,
)
from workbench.record.times import FORMATS_SAID, Order, in_order, parse_timestamps
from workbench.record.units import time_unit

__all__ = ["Clock", "Signal", "Signals", "Tall", "clock_of", "from_tall", "from_wide"]

# Share of times in another format than the rest, beyond which they are not left out: without one time in nine, or more,
# those that are left may pass for even ones with a longer sample time.
OTHERS = 0.1
# A time of day without its day, and the one that databases and Parquet's timestamps have with a day.
_CLOCK = re.compile(r"\d{1,2}:\d\d")
_MIDNIGHT = re.compile(r"[ T]0?0:00(:00)?(\.0+)?$")


@dataclass
class Signal:
    """One signal as recorded: times, s, strictly ascending, shape (N,), its cells, the line of each, and its unit.

    unit: as a tall file's column of units or a wide one's row of units has it, or "".
    """

    name: str
    seconds: FloatArray
    cells: Cells
    lines: NDArray[np.int64]
    unit: str = ""


@dataclass
class Signals:
    """A loop's signals by their kind (PV, OP, SP, MODE, valve_position).

    rows: of the file, of a tall one those that were read. dropped: rows without a readable time or with fields too
    many, as lines by cause. repeated: rows left out since their time occurs again. timed: False where the file has no
    times; `seconds` then counts samples. epoch: what second 0 is on the clock of the file's timestamps, s since 1970, 0
    where it has none; zone: as a `Record` has it. what: a signal's name is, a column or a tag. header: a wide file's
    names of columns; unnamed: whether one of them is blank.
    """

    by: dict[str, Signal]
    unit: str
    rows: int
    dropped: dict[str, list[int]] = field(default_factory=dict)
    repeated: int = 0
    timed: bool = True
    time_name: str = ""
    epoch: float = 0.0
    zone: tuple[tuple[float, float], ...] = ()
    what: str = "column"
    unnamed: bool = False
    header: Sequence[str] = ()
    notes: list[str] = field(default_factory=list)


def from_wide(table: Table, names: Mapping[str, str], source: str) -> Signals:
    """Return the signals of a file with a column each; names: of the columns. Raises `RecordError`."""
    rows = table.lines.size
    _one_loop(table, names, source)
    out = Signals({}, table.unit, rows, notes=list(table.notes), time_name=names.get("time", ""))
    for key in QUALITIES:
        if key in table.columns:
            for signal in NEEDED if key == "quality" else (key.removesuffix(" quality"),):
                if signal in table.columns:
                    _mark_quality(table.columns[signal], table.columns[key].as_texts(), names[key], out.notes)
    kinds = [s for s in ("PV", "OP", "SP", "MODE", "valve_position") if s in table.columns]
    if "time" not in table.columns:
        seconds, order_rows = np.arange(rows, dtype=np.float64), np.arange(rows)
        out.timed = False
    else:
        clock = clock_of(table.columns["time"], names["time"], table, source, out.notes)
        _add_milliseconds(clock, table, names, out.notes)
        times = clock.seconds
        times[table.columns["time"].marks == FIELDS] = np.nan
        same = np.ones(rows, dtype=bool)
        for signal in NEEDED:
            cells = table.columns[signal]
            same[1:] &= np.where(cells.marks[1:] == OK, cells.values[1:], 0.0) == np.where(
                cells.marks[:-1] == OK, cells.values[:-1], 0.0
            )

        def alike(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.bool_]:
            return np.asarray(np.all([table.columns[kind].alike(a, b) for kind in kinds], axis=0))

        order = in_order(times, same, clock.wall, alike, [table.columns[signal].values for signal in NEEDED])
        _refuse(order, table.lines, table.unit, names["time"], "", source)
        if clock.stamped and order.rows.size:
            out.epoch, out.zone = float(order.seconds[0]), clock.zone(order.rows)
            out.notes.append(clock.first_said(int(order.rows[0])))
        out.notes += order.notes
        out.repeated = order.repeated
        _dropped(out, times, table.columns["time"].marks == FIELDS, table.lines)
        seconds, order_rows = order.seconds - out.epoch, order.rows
    lines = table.lines[order_rows]
    whole = order_rows.size == rows and bool((np.diff(order_rows) == 1).all())
    for signal in kinds:
        cells = table.columns[signal] if whole else table.columns[signal].take(order_rows)
        out.by[signal] = Signal(names[signal], seconds, cells, lines, table.units.get(signal, ""))
    return out


def _one_loop(table: Table, names: Mapping[str, str], source: str) -> None:
    """Raise `RecordError` where a column names several loops, each of many rows: they would be read as one."""
    texts = [text for text in table.columns["loop"].as_texts() if text] if "loop" in table.columns else []
    loops = dict.fromkeys(texts)
    if len(loops) < 2 or 2 * len(loops) > len(texts) or all(reads_as_number(loop) for loop in loops):
        return
    told = f"{', '.join(list(loops)[:3])}{' ...' if len(loops) > 3 else ''}"
    raise RecordError(
        f"{source}: column {names['loop']!r} names {len(loops)} loops ({told}), whose rows stand in one file; export "
        "one loop, or give each signal a column of its own, as FIC101.PV"
    )


def from_tall(
    table: Table, names: Mapping[str, str], tags: Mapping[str, str] | None, source: str, listed: Sequence[str]
) -> Signals:
    """Return the signals of a historian export with a row per value.

    names: of the columns. tags: which tag is which. listed: all tags of the file, where the table holds the rows of
    those alone that are in use. Raises `RecordError`.
    """
    out = Signals({}, table.unit, table.lines.size, notes=list(table.notes), time_name=names["time"], what="tag")
    codes: dict[str, int] = {}
    of_row = np.array([codes.setdefault(tag, len(codes)) for tag in _tags(table, listed or (tags or {}).values())])
    listed = listed or [tag for tag in codes if tag]
    found = match_tags(listed, tags, source)
    others = [tag for i, tag in enumerate(listed) if i not in found.values()]
    if others:
        more = f" and {len(others) - 5} more" if len(others) > 5 else ""
        out.notes.append(f"tags not used: {', '.join(others[:5])}{more}")
    used = np.isin(of_row, [codes[listed[i]] for i in found.values()])
    clock = clock_of(table.columns["time"], names["time"], table, source, out.notes, used)
    wide = table.columns["time"].marks == FIELDS
    clock.seconds[wide] = np.nan
    qualities, units = (table.columns[name].as_texts() if name in table.columns else None for name in TALL[3:])
    # Rows of the logging itself, such as WinCC's $RT_OFF$, have codes of their own.
    rated = Counter(compress(qualities or (), used.tolist()))
    tall = Tall(out, clock, wide, table.lines, names, source, rated)
    rows_of = {kind: np.flatnonzero(of_row == codes[listed[i]]) for kind, i in found.items()}
    _one_mark({listed[found[kind]]: rows for kind, rows in rows_of.items() if kind in NUMERIC}, table, source)
    for kind, i in found.items():
        rows = rows_of[kind]
        cells = _values(table, rows, kind, f"{source}: tag {listed[i]!r}")
        said = [None if texts is None else [texts[k] for k in rows.tolist()] for texts in (qualities, units)]
        tall.add(kind, listed[i], rows, cells, *said)
    return tall.done()


def _tags(table: Table, wanted: Collection[str]) -> list[str]:
    """Return the tag of each row, by its name (see `with_loops`)."""
    tags = table.columns["tag"].as_texts()
    if "loop" not in table.columns:
        return tags
    rows = list(zip(table.columns["loop"].as_texts(), tags, strict=True))
    names = with_loops(set(rows), wanted)
    return [names[row] for row in rows]


def _one_mark(rows: Mapping[str, NDArray[np.int64]], table: Table, source: str) -> None:
    """Raise `RecordError` where the tags, by their rows, write numbers with marks that leave a doubt."""
    texts = table.columns["value"].texts
    if texts is not None:
        numbers = {tag: ([texts[k] for k in own.tolist()], table.lines[own].tolist()) for tag, own in rows.items()}
        one_mark(numbers, table.decimal_comma, "tag", table.unit, source)


@dataclass
class Tall:
    """A loop's signals as they are put together from the rows of a tall table.

    clock: of the rows, shape (N,); wide: rows with fields too many; lines: of the rows; names: of the columns;
    qualities: of all tags in use, counted. first: the time that comes first, s, and its row.
    """

    out: Signals
    clock: Clock
    wide: NDArray[np.bool_]
    lines: NDArray[np.int64]
    names: Mapping[str, str]
    source: str
    qualities: Counter[str]
    said: Counter[str] = field(default_factory=Counter)
    first: tuple[float, int] | None = None

    def add(
        self,
        kind: str,
        tag: str,
        rows: NDArray[np.int64],
        cells: Cells,
        qualities: list[str] | None,
        units: list[str] | None,
    ) -> None:
        """Add one tag as the signal `kind`; rows: its own, cells, qualities, units: theirs. Raises `RecordError`."""
        out, times = self.out, self.clock.seconds[rows]
        if qualities is not None:
            _mark_quality(cells, qualities, self.names["quality"], out.notes, self.qualities)
        value = np.where(cells.marks == OK, cells.values, 0.0)
        same = np.concatenate(([False], value[1:] == value[:-1]))
        if cells.texts is not None and kind == "MODE":
            texts = np.array(cells.texts, dtype=object)
            same[1:] &= (texts[1:] == texts[:-1]).astype(bool)
        order = in_order(times, same, self.clock.wall, cells.alike, [cells.values])
        _refuse(order, self.lines[rows], out.unit, self.names["time"], tag, self.source)
        self.said.update(order.notes)
        out.repeated += order.repeated
        _dropped(out, times, self.wide[rows], self.lines[rows])
        lines, unit = self.lines[rows[order.rows]], next(filter(None, units or ()), "")
        out.by[kind] = Signal(tag, order.seconds, cells.take(order.rows), lines, unit)
        if order.rows.size:
            first = float(order.seconds[0]), int(rows[order.rows[0]])
            self.first = first if self.first is None else min(self.first, first)
            out.zone = out.zone or self.clock.zone(rows[order.rows])

    def done(self) -> Signals:
        """Return the signals, on one time from the first stamp on, with what was said of several tags said once."""
        if self.clock.stamped and self.first is not None:
            self.out.epoch, row = self.first
            for signal in self.out.by.values():
                signal.seconds = signal.seconds - self.out.epoch
            self.out.notes.append(self.clock.first_said(row))
        self.out.notes += [note if many == 1 else f"{note} (in {many} tags)" for note, many in self.said.items()]
        return self.out


def _dropped(out: Signals, times: FloatArray, wide: NDArray[np.bool_], lines: NDArray[np.int64]) -> None:
    """Note the rows, shape (N,), that have no usable time; wide: those with fields too many."""
    for cause, hit in (("more fields than the header", wide), ("no readable time", np.isnan(times) & ~wide)):
        if hit.any():
            out.dropped.setdefault(cause, []).extend(lines[hit].tolist())


def _values(table: Table, rows: NDArray[np.int64], signal: str, where: str) -> Cells:
    """Return one tag's values; MODE as text."""
    values = table.columns["value"]
    if values.texts is None:
        return values.take(rows)
    texts = [values.texts[i] for i in rows.tolist()]
    if signal in NUMERIC:
        cells = number_cells(texts, table.decimal_comma, where)
    else:
        cells = Cells(np.full(rows.size, np.nan), np.array([BLANK if not t else OK for t in texts], np.int8))
    cells.marks[values.marks[rows] == FIELDS] = FIELDS
    cells.texts = texts
    return cells


def _mark_quality(
    cells: Cells, texts: list[str], name: str, notes: list[str], whole: Counter[str] | None = None
) -> None:
    good, bad, note = good_quality(texts, name, whole)
    hit = ~good & np.isin(cells.marks, (OK, NOT_FINITE, LARGE))
    cells.marks[hit] = QUALITY
    cells.values[hit] = np.nan
    cells.qualities.update(bad)
    if note and note not in notes:
        notes.append(note)


def _refuse(order: Order, lines: NDArray[np.int64], unit: str, name: str, tag: str, source: str) -> None:
    if not order.refusal:
        return
    row, earlier = (int(lines[k]) for k in order.between)
    which = f", tag {tag!r}" if tag else ""
    said = order.refusal.format(before=f"{unit} {earlier}")
    msg = f"{source}: {unit} {row}, column {name!r}{which}: {said}"
    raise RecordError(msg)


@dataclass
class Clock:
    """The times of rows: s, nan for none, shape (N,); wall: of a clock on a wall; texts: the timestamps as written.

    stamped: whether they are timestamps, and the seconds count since 1970. east: how far their zones are east of
    Greenwich, s, shape (N,); None for UTC, and on a wall.
    """

    seconds: FloatArray
    wall: bool = False
    stamped: bool = False
    texts: list[str] | None = None
    east: FloatArray | None = None

    def zone(self, rows: NDArray[np.int64]) -> tuple[tuple[float, float], ...]:
        """Return (time, s east of Greenwich from then on) of rows in the order of time; none without a zone."""
        if not self.stamped or self.wall:
            return ()
        east = np.zeros(rows.size) if self.east is None else self.east[rows]
        turns = np.flatnonzero(np.concatenate(([True], np.diff(east) != 0.0)))
        return tuple(zip(self.seconds[rows[turns]].tolist(), east[turns].tolist(), strict=True))

    def first_said(self, row: int) -> str:
        """Return in words which timestamp comes first, that of a row."""
        if self.texts is not None:
            return f"first timestamp {self.texts[row]}"
        at = datetime.fromtimestamp(float(self.seconds[row]), UTC)
        return f"first timestamp {at.replace(tzinfo=None) if self.wall else at}"


def clock_of(
    cells: Cells, name: str, table: Table, source: str, notes: list[str], used: NDArray[np.bool_] | None = None
) -> Clock:
    """Return the times of a column of times, shape (N,); used: which rows are needed, all where None.

    Raises `RecordError`.
    """
    # Rows with fields too many hold a time all the same, or the file would be told that it has none.
    if "month" in table.columns:
        parts = [table.columns[part] for part in PARTS if part in table.columns]
        whole = put_together(*(one.as_texts() for one in (cells, *parts)))
        cells = replace(cells, values=np.full(len(whole), np.nan), texts=whole)
        notes.append(f"the times are put together of year, {', '.join(PARTS[: len(parts)])} in columns of their own")
    if "date" in table.columns and cells.texts is not None:
        days, clocks = _days(table.columns["date"]), cells.texts
        first = next(filter(None, clocks), "")
        if not _CLOCK.match(first) and (written := as_clocks(clocks)) is not None:
            clocks, first = written[0], ""
            cells = replace(cells, values=np.full(len(clocks), np.nan))
            notes.append(f"column {name!r}: {written[1]}")
        if not first or _CLOCK.match(first):
            own = any(":" in day for day in days)  # the day has a clock, too
            both = days if own else [f"{day} {clock}" for day, clock in zip(days, clocks, strict=True)]
            cells = replace(cells, texts=both)
    if cells.stamped is not None:
        return Clock(cells.values.copy(), wall=not cells.stamped, stamped=True, east=cells.east)
    texts, numeric = cells.texts, int(np.count_nonzero(np.isfinite(cells.values)))
    if texts is None or numeric * 2 > np.count_nonzero(cells.marks != BLANK):
        if time_unit(name) is None and (day := digits_of_the_day(cells.values)) is not None:
            notes.append(f"column {name!r} {day[1]}")
            return Clock(day[0])
        found = counted(cells.values, name, table.units.get("time", ""))
        if found.refusal:
            msg = f"{source}: {table.unit} {table.lines[0]}, column {name!r}: {found.refusal}"
            raise RecordError(msg)
        notes += [f"column {name!r} {found.note}"] if found.note else []
        if found.seconds is not None:
            _one_format(found.seconds, cells, used, name, table, source)
            return Clock(found.seconds, found.wall, found.stamped)
        return _dated(found.texts or [], cells, name, table, source)
    if (day := of_the_day(texts) or durations(texts)) is not None:
        notes.append(f"column {name!r}: {day[1]}")
        _one_format(day[0], cells, used, name, table, source)
        return Clock(day[0])
    parsed = parse_timestamps(texts)
    if isinstance(parsed, str):
        msg = f"{source}: column {name!r}: {parsed}"
        raise RecordError(msg)
    seconds, note, east = parsed
    if not np.isfinite(seconds).any():
        msg = (
            f"{source}: {table.unit} {table.lines[0]}, column {name!r}: {texts[0]!r} is no time that can be read; "
            f"allowed: {FORMATS_SAID}"
        )
        raise RecordError(msg)
    _one_format(seconds, cells, used, name, table, source)
    notes += [note] if note else []
    return Clock(seconds, wall=east is None, stamped=True, texts=texts, east=east)


def _add_milliseconds(clock: Clock, table: Table, names: Mapping[str, str], notes: list[str]) -> None:
    """Add the milliseconds that stand in a column of their own to timestamps in whole seconds."""
    if "milliseconds" not in table.columns or not clock.stamped:
        return
    rows = np.flatnonzero(np.isfinite(clock.seconds))
    texts = table.columns["milliseconds"].take(rows).as_texts()
    whole = bool((clock.seconds[rows] % 1.0 == 0.0).all())
    if whole and all(text.isdecimal() and len(text) <= 3 for text in texts):
        clock.seconds[rows] += np.array(texts, dtype=np.float64) / 1e3
        notes.append(f"the milliseconds of column {names['milliseconds']!r} are added to the times")


def _days(cells: Cells) -> list[str]:
    """Return a column of days as text, "" for none, without the clock of a column that shows midnight throughout."""
    if cells.stamped is None:
        days = cells.as_texts()
    else:
        seconds = cells.values.tolist()
        days = ["" if one != one else str(np.datetime64(round(one * 1e6), "us")) for one in seconds]
    bare = [_MIDNIGHT.sub("", day) for day in days]
    return days if any(":" in day for day in bare) else bare


def _one_format(
    seconds: FloatArray, cells: Cells, used: NDArray[np.bool_] | None, name: str, table: Table, source: str
) -> None:
    """Raise `RecordError` where many of the times that were not read, nan in `seconds`, are such in another format.

    Titles, remarks, footers and headers within a column of times are no times in any format.
    """
    if cells.texts is None:
        return
    needed = np.ones(seconds.size, dtype=bool) if used is None else used
    read = np.flatnonzero(np.isfinite(seconds) & needed)
    others = np.flatnonzero(np.isnan(seconds) & needed & ~np.isin(cells.marks, (BLANK, FIELDS)))

    def few() -> bool:
        return others.size <= OTHERS * (read.size + others.size)

    if read.size == 0 or few():
        return
    texts = [cells.texts[i] for i in others.tolist()]
    parsed = parse_timestamps(texts)
    if not isinstance(parsed, str):
        # Numbers among timestamps are days that a spreadsheet understood, and the timestamps those that it did not.
        others = others[np.isfinite(parsed[0]) | np.array([reads_as_number(text.replace(",", ".")) for text in texts])]
    if few():
        return
    first, other = int(read[0]), int(others[0])
    msg = (
        f"{source}: column {name!r}: times in more than one format: {cells.texts[first]!r} in {table.unit} "
        f"{table.lines[first]}, but {cells.texts[other]!r} in {table.unit} {table.lines[other]}, as in {others.size} "
        f"of {read.size + others.size} times; write all of them in one format"
    )
    raise RecordError(msg)


def _dated(texts: list[str], cells: Cells, name: str, table: Table, source: str) -> Clock:
    """Return the times of dates in digits alone, of which each must be one: else they are some other number."""
    parsed = parse_timestamps(texts)
    seconds = np.full(len(texts), np.nan) if isinstance(parsed, str) else parsed[0]
    none = np.flatnonzero(np.isnan(seconds) & np.isfinite(cells.values))
    if none.size:
        at = int(none[0])
        msg = (
            f"{source}: {table.unit} {table.lines[at]}, column {name!r}: {cells.values[at]:.0f} is no date in digits "
            f"(YYYYMMDDhhmm or YYYYMMDDhhmmss), as the column seems to hold; allowed: {FORMATS_SAID}"
        )
        raise RecordError(msg)
    return Clock(seconds, wall=True, stamped=True, texts=texts)
