"""`wb.read_record`: a CSV or Parquet file of one loop to a `Record`, with everything that was left out said.

Policy. Rows whose PV, OP or time holds no finite number are rejected and counted; they and gaps in time split the file,
and the longest clean, evenly sampled stretch is kept (nothing is interpolated). Times that do not ascend are refused.
A missing SP cell holds the value before it, as a setpoint does; a stem signal with bad cells is left out.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import RecordError
from workbench.model.checks import number
from workbench.model.record import FloatArray, Record
from workbench.record.columns import match_columns, time_unit
from workbench.record.modes import manual_share, mode_words
from workbench.record.table import BLANK, FIELDS, NOT_FINITE, OK, TEXT, Cells, Table, read_csv, read_parquet
from workbench.record.times import FORMATS_SAID, parse_timestamps

__all__ = ["JITTER", "LARGEST", "read_record"]

LARGEST = 1 << 30  # bytes
JITTER = 0.2  # of the sample time, by which an interval may differ from it
UNEVEN = 0.05  # share of intervals that may break the pattern before the file counts as unevenly sampled

_WHY = {
    BLANK: "blank",
    TEXT: "text",
    NOT_FINITE: "not finite",
    FIELDS: "more fields than the header",
}


def read_record(
    path: str | os.PathLike[str], *, columns: Mapping[str, str] | None = None, sample_time: float | None = None
) -> Record:
    """Read one loop's record from a CSV or Parquet file.

    path: of the file, at most 1 GiB. columns: which column is which signal ("time", "SP", "PV", "OP", "MODE",
    "valve_position"), where the usual spellings do not tell; only PV and OP are needed. sample_time: s, needed where
    the file has no time column; where it has one, taken in its place if both agree within 1 %. PV keeps its unit, OP
    is in %.

    Returns a `Record` of the longest clean, evenly sampled stretch; its `notes` and `counts` (rows, kept, rejected,
    gaps ...) say what was left out. Times become seconds: as given, or from the first timestamp on. Raises
    `RecordError` naming file, line and column.
    """
    file = Path(path)
    source = str(path)
    _check_file(file, source)
    if sample_time is not None:
        number(sample_time, "sample_time", above=0.0, unit="s")
    found: dict[str, int] = {}

    def match(header: list[str]) -> dict[str, int]:
        found.update(match_columns(header, columns, source))
        return found

    table, header = (read_parquet if _is_parquet(file) else read_csv)(file, match, source)
    names = {signal: header[i].strip() for signal, i in found.items()}
    if table.lines.size == 0:
        msg = f"{source}: a header and no row of data"
        raise RecordError(msg)
    return _assemble(table, names, sample_time, source)


def _check_file(file: Path, source: str) -> None:
    try:
        if file.is_dir():
            msg = f"{source}: is a directory; a CSV or Parquet file is needed"
            raise RecordError(msg)
        if not file.exists():
            msg = f"{source}: no such file"
            raise RecordError(msg)
        if not file.is_file():
            msg = f"{source}: is no regular file"
            raise RecordError(msg)
        size = file.stat().st_size
    except (OSError, ValueError) as error:
        if isinstance(error, RecordError):
            raise
        msg = f"{source}: cannot be read: {error}"
        raise RecordError(msg) from None
    if size == 0:
        msg = f"{source}: empty: no header and no row"
        raise RecordError(msg)
    if size > LARGEST:
        msg = f"{source}: {size / 2**30:.1f} GiB given; at most 1 GiB is read: export one loop, or fewer hours"
        raise RecordError(msg)


def _is_parquet(file: Path) -> bool:
    # A damaged file may have lost the mark that a Parquet file begins with; its name still tells.
    if file.suffix.lower() in (".parquet", ".pq"):
        return True
    try:
        with file.open("rb") as stream:
            return stream.read(4) == b"PAR1"
    except OSError as error:
        msg = f"{file}: cannot be read: {error.strerror or error}"
        raise RecordError(msg) from None


@dataclass(frozen=True)
class _Clock:
    """Times of the rows, s, shape (N,), nan where a row has none; the sample time; what to say."""

    seconds: FloatArray
    sample_time: float
    notes: tuple[str, ...]


def _assemble(table: Table, names: Mapping[str, str], sample_time: float | None, source: str) -> Record:
    rows = table.lines.size
    bad = np.zeros(rows, np.int8)
    for signal in ("PV", "OP"):
        cells = table.columns[signal]
        bad = np.where(bad == OK, cells.marks, bad)
    if not (bad == OK).any():
        raise RecordError(_nothing_usable(table, names, source))
    clock = _clock(table, names, sample_time, source)
    no_time = (bad == OK) & ~np.isfinite(clock.seconds)
    good = (bad == OK) & ~no_time
    if not good.any():
        raise RecordError(_nothing_usable(table, names, source))
    first, stop, gaps = _longest(clock, good, table, source)
    if stop - first < 2:
        causes = [
            _rejected(table, names, bad == mark, said, int(np.count_nonzero(bad == mark)))
            for mark, said in _WHY.items()
            if (bad == mark).any()
        ]
        if no_time.any():
            causes.append(f"{np.count_nonzero(no_time)} without a readable time")
        msg = f"{source}: no two clean, evenly spaced rows follow each other" + "".join(f"; {one}" for one in causes)
        raise RecordError(msg)
    part = slice(first, stop)
    counts = {"rows": rows, "kept": stop - first, "rejected": int(np.count_nonzero(~good)), "gaps": gaps}
    notes = [*table.notes, *clock.notes]
    for mark, why in _WHY.items():
        many = int(np.count_nonzero(bad == mark))
        if many:
            counts[f"rejected, {why}"] = many
            notes.append(_rejected(table, names, bad == mark, why, many))
    if no_time.any():
        counts["rejected, time"] = int(np.count_nonzero(no_time))
        at = int(table.lines[np.argmax(no_time)])
        notes.append(f"{counts['rejected, time']} rows rejected: no readable time, first in {table.unit} {at}")
    if stop - first < rows:
        counts["left out"] = rows - (stop - first) - counts["rejected"]
        notes.append(
            f"kept the longest clean, evenly sampled stretch: {stop - first} of {rows} rows, {table.unit}s "
            f"{table.lines[first]} to {table.lines[stop - 1]}"
            + (f"; {gaps} gap{'s' if gaps > 1 else ''} in time" if gaps else "")
        )
    Ts, start, jitter = _grid(clock, part)
    if jitter > 1e-6:
        notes.append(f"times differ from the even grid by up to {jitter:.1%} of the sample time; taken as even")
    if sample_time is not None and sample_time != Ts:
        notes.append(f"the sample time is taken as {sample_time:g} s, as given; the times show {Ts:.9g} s")
        Ts = sample_time
    sp = _setpoint(table.columns.get("SP"), part, notes)
    valve = _stem(table.columns.get("valve_position"), part, notes)
    mode = table.columns["MODE"].texts if "MODE" in table.columns else None
    if mode is None and "MODE" in table.columns:
        mode = [f"{v:g}" for v in table.columns["MODE"].values.tolist()]
    kept_mode = None if mode is None else tuple(mode[part])
    manual = 0.0 if kept_mode is None else manual_share(kept_mode)
    if kept_mode is not None and manual > 0.0:
        notes.append(f"MODE: {mode_words(kept_mode)}; {manual:.1%} of the kept samples are in manual")
    return Record(
        pv=table.columns["PV"].values[part],
        op=table.columns["OP"].values[part],
        sample_time=Ts,
        sp=sp,
        valve_position=valve,
        mode=kept_mode,
        start=start,
        source=source,
        notes=tuple(notes),
        counts=counts,
    )


def _rejected(table: Table, names: Mapping[str, str], which: NDArray[np.bool_], why: str, many: int) -> str:
    row = int(np.argmax(which))
    signal = "PV" if table.columns["PV"].marks[row] != OK else "OP"
    text = f" ({table.columns[signal].first_text!r})" if why == "text" and table.columns[signal].first_text else ""
    # Fields too many are the row's fault, and no column's.
    where = "" if table.columns[signal].marks[row] == FIELDS else f", column {names[signal]!r}"
    return f"{many} row{'s' if many > 1 else ''} rejected: {why}{text}, first in {table.unit} {table.lines[row]}{where}"


def _nothing_usable(table: Table, names: Mapping[str, str], source: str) -> str:
    for signal in ("PV", "OP"):
        cells = table.columns[signal]
        if not (cells.marks == OK).any():
            row = int(np.argmax(cells.marks != OK))
            why = _WHY[int(cells.marks[row])]
            text = f" ({cells.first_text!r})" if cells.marks[row] == TEXT else ""
            if cells.marks[row] == FIELDS:
                return (
                    f"{source}: {table.unit} {table.lines[row]}: {why}, and no row without; is it a decimal comma in a "
                    "comma-separated file?"
                )
            return (
                f"{source}: {table.unit} {table.lines[row]}, column {names[signal]!r}: no row holds a number, "
                f"the first is {why}{text}"
            )
    row = int(np.argmax((table.columns["PV"].marks != OK) | (table.columns["OP"].marks != OK)))
    return f"{source}: {table.unit} {table.lines[row]}: no row holds PV, OP and time together"


def _clock(table: Table, names: Mapping[str, str], sample_time: float | None, source: str) -> _Clock:
    rows = table.lines.size
    if "time" not in table.columns:
        if sample_time is None:
            msg = f"{source}: no time column; give sample_time in seconds, or the column, columns={{'time': 'name'}}"
            raise RecordError(msg)
        return _Clock(np.arange(rows, dtype=np.float64) * sample_time, sample_time, ())
    cells = table.columns["time"]
    seconds, notes = _seconds(cells, names["time"], table, source)
    known = np.flatnonzero(np.isfinite(seconds) & (cells.marks != FIELDS))
    seconds[cells.marks == FIELDS] = np.nan
    steps = np.diff(seconds[known])
    if (steps <= 0.0).any():
        at = int(np.argmax(steps <= 0.0))
        what = "the same time as" if steps[at] == 0.0 else f"{-steps[at]:g} s before"
        row, before = int(table.lines[known[at + 1]]), int(table.lines[known[at]])
        msg = (
            f"{source}: {table.unit} {row}, column {names['time']!r}: {what} {table.unit} {before}; times must ascend "
            "(a changed clock, daylight saving or two exports in one file do this)"
        )
        raise RecordError(msg)
    if steps.size == 0:
        msg = f"{source}: {known.size} row{'s' if known.size != 1 else ''} with a time; at least two are needed"
        raise RecordError(msg)
    usual = float(np.median(steps))
    if sample_time is not None and abs(usual - sample_time) > 0.01 * sample_time:
        msg = (
            f"{source}: sample_time {sample_time:g} s given, but column {names['time']!r} has {usual:g} s between "
            "rows; leave sample_time out, or the time column"
        )
        raise RecordError(msg)
    return _Clock(seconds, usual, tuple(notes))


def _seconds(cells: Cells, name: str, table: Table, source: str) -> tuple[FloatArray, list[str]]:
    """Return seconds, shape (N,), nan where a row has no time, and notes."""
    numeric = int(np.count_nonzero(cells.marks == OK))
    texts = cells.texts
    if texts is None or numeric * 2 > np.count_nonzero(cells.marks != BLANK):
        unit = time_unit(name)
        values = cells.values * unit
        # Milliseconds since 1970 are far beyond any count of seconds in use.
        if unit == 1.0 and numeric and float(np.nanmedian(np.abs(values))) > 1e11:
            return values / 1000.0, [f"column {name!r} read as milliseconds since 1970"]
        return values, [] if unit == 1.0 else [f"column {name!r} read in units of {unit:g} s"]
    parsed = parse_timestamps(texts)
    if isinstance(parsed, str):
        msg = f"{source}: column {name!r}: {parsed}"
        raise RecordError(msg)
    seconds, note = parsed
    usable = np.isfinite(seconds)
    if not usable.any():
        msg = (
            f"{source}: {table.unit} {table.lines[0]}, column {name!r}: {texts[0]!r} is no time that can be read; "
            f"allowed: {FORMATS_SAID}"
        )
        raise RecordError(msg)
    first = int(np.argmax(usable))
    notes = [note] if note else []
    notes.append(f"first timestamp {texts[first]}")
    return seconds - seconds[first], notes


def _longest(clock: _Clock, good: NDArray[np.bool_], table: Table, source: str) -> tuple[int, int, int]:
    """Return (first, stop, gaps): the longest run of good rows whose intervals keep to the sample time."""
    usual = clock.sample_time
    seconds = clock.seconds
    follows = np.zeros(good.size, dtype=bool)
    steps = np.diff(seconds)
    with np.errstate(invalid="ignore"):
        even = np.abs(steps - usual) <= JITTER * usual
        gap = steps > (1.0 + JITTER) * usual
    follows[1:] = good[1:] & good[:-1] & even
    neighbours = good[1:] & good[:-1]
    uneven = int(np.count_nonzero(neighbours & ~even))
    if uneven > max(UNEVEN * np.count_nonzero(neighbours), 1 if neighbours.sum() < 40 else 0):
        at = int(np.argmax(neighbours & ~even))
        msg = (
            f"{source}: not evenly sampled: {uneven} of {np.count_nonzero(neighbours)} intervals differ from the usual "
            f"{usual:g} s by more than {JITTER:.0%}, the first ({steps[at]:g} s) after {table.unit} "
            f"{table.lines[at]}; export at a fixed interval"
        )
        raise RecordError(msg)
    best, best_first, best_stop, first = 0, 0, 0, -1
    breaks = np.flatnonzero(~follows)
    for i, begin in enumerate(breaks.tolist()):
        stop = int(breaks[i + 1]) if i + 1 < breaks.size else good.size
        first = begin
        length = stop - first if good[first] else 0
        if length > best:
            best, best_first, best_stop = length, first, stop
    return best_first, best_stop, int(np.count_nonzero(gap & neighbours))


def _grid(clock: _Clock, part: slice) -> tuple[float, float, float]:
    """Return (sample time, start, largest deviation from the even grid as a share of the sample time)."""
    times = clock.seconds[part]
    n = times.size
    usual = clock.sample_time
    grid = times[0] + usual * np.arange(n)
    off = float(np.abs(times - grid).max()) / usual
    if off > 1e-6:
        # A rounded or drifting clock: the mean interval is the better sample time.
        usual = float(times[-1] - times[0]) / (n - 1)
        off = float(np.abs(times - times[0] - usual * np.arange(n)).max()) / usual
    return usual, float(times[0]), off


def _setpoint(cells: Cells | None, part: slice, notes: list[str]) -> FloatArray | None:
    if cells is None:
        return None
    values, good = cells.values[part].copy(), cells.marks[part] == OK
    missing = int(np.count_nonzero(~good))
    if missing == values.size:
        notes.append("SP left out: no cell of the kept rows holds a number")
        return None
    if missing:
        held = np.maximum.accumulate(np.where(good, np.arange(values.size), -1))
        held[held < 0] = int(np.argmax(good))
        values = values[held]
        notes.append(f"SP: {missing} cells without a number hold the value before them")
    return values


def _stem(cells: Cells | None, part: slice, notes: list[str]) -> FloatArray | None:
    if cells is None:
        return None
    missing = int(np.count_nonzero(cells.marks[part] != OK))
    if missing:
        notes.append(f"valve position left out: {missing} of the kept cells hold no number")
        return None
    return cells.values[part]
