"""`wb.read_record`: a CSV or Parquet file of one loop to a `Record`, with everything that was left out said.

Policy. Values that are no finite numbers, codes for no value such as -9999, of bad quality or beyond their range are
rejected and counted; they, gaps in time, a frozen sensor and changes of mode part the file into stretches, of which the
longest that is not in manual is the record and the others are its `rest`. Evenly spaced rows are taken as they are;
anything else is resampled (see `grid`). Times that leave a doubt are refused.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from workbench.errors import RecordError
from workbench.model.checks import file_name, instance, number, ordered_pair
from workbench.model.record import Record
from workbench.record.aggregates import aggregates_said, is_average, said_of
from workbench.record.checks import held_said, no_codes, none_far, op_said, setpoint_said, swapped, within_range
from workbench.record.columns import (
    NEEDED,
    flags_unused,
    is_tall,
    match_columns,
    match_tags,
    names_said,
    qualities_unused,
    with_loops,
)
from workbench.record.csv_file import names_in_csv, read_csv
from workbench.record.grid import Samples, lay
from workbench.record.names import names_time
from workbench.record.pairs import PAIRED
from workbench.record.parquet import names_in_parquet, read_parquet
from workbench.record.segments import Parts, part, record_of
from workbench.record.signals import Signal, Signals, from_tall, from_wide
from workbench.record.table import (
    BLANK,
    CODE,
    FIELDS,
    LARGE,
    LIMIT,
    NOT_FINITE,
    NUMERIC,
    OK,
    QUALITY,
    RANGE,
    TEXT,
)
from workbench.record.units import in_milliamperes, signal_unit

__all__ = ["LARGEST", "read_loop", "read_record", "record_from"]

LARGEST = 1 << 30  # bytes
CURRENT = (4.0, 20.0)  # mA, of 0 to 100 % (IEC 60381-1)
SAME = 10  # samples in which PV and OP are equal by chance at most
SHOWN = 4  # texts or qualities named one by one

_WHY = {
    BLANK: "blank",
    TEXT: "text",
    NOT_FINITE: "not finite",
    LARGE: f"beyond {LIMIT:g} in size",
    FIELDS: "more fields than the header",
    QUALITY: "bad quality",
    RANGE: "out of range",
    CODE: "a code for no value",
}
_HINTS = {QUALITY: "; a column that rates no values is to be renamed or taken out"}


def read_record(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    tags: Mapping[str, str] | None = None,
    sample_time: float | None = None,
    pv_range: Sequence[float] | None = None,
    op_range: Sequence[float] | None = None,
    max_gap: float | None = None,
) -> Record:
    """Read one loop's record from a CSV or Parquet file.

    path: of the file, at most 1 GiB; wide (a column per signal, or a pair of columns for each, its own times and its
    values) or tall, as historians export (a row per value, with tag, time, value and perhaps quality). columns: which
    column is which signal ("time", "SP", "PV", "OP", "MODE", "valve_position", "quality" of the row, "PV quality" ...;
    "tag", "value", "quality" and "unit" of a tall file), where the usual spellings do not tell; only PV and OP are
    needed. tags: which tag, or column of a wide file, is which signal ({"PV": "FIC101.PV"}), by default told by its
    ending. sample_time: s, needed where the file has no time column; where the rows are even, taken in the place of
    their own if both agree within 1 %; else the sample time to resample to (default: the usual interval).

    pv_range: (low, high) of the transmitter, EU; op_range: (low, high) of OP in the file's unit, which are 0 and 100 %,
    by default 4 and 20 where its name, a row of units or a tall file's column of units says mA. Values beyond a given
    range are rejected (NAMUR NE 43), and without one those of OP far beyond 0 to 100 %. max_gap: s, the longest time
    without a good value of PV or OP that is interpolated or held over; by default one row of an even file where few are
    missing or unusable, and ten usual intervals of others.

    Returns a `Record` in PV's unit and OP in %: the longest clean stretch in one mode, the others as its `rest`; its
    `notes` and `counts` (rows, kept, rejected, gaps ...) say what was done and left out. Times become seconds: as
    given (in the unit that their name or a row of units says), or from the first timestamp on. Raises `RecordError`
    naming file, line and column, and `InvalidValue`.
    """
    return _read(path, columns, tags, sample_time, pv_range, op_range, max_gap, alone=False)


def read_loop(
    path: str | os.PathLike[str],
    tags: Mapping[str, str],
    *,
    sample_time: float | None = None,
    pv_range: Sequence[float] | None = None,
    op_range: Sequence[float] | None = None,
    max_gap: float | None = None,
) -> Record:
    """Return one loop's record from a CSV or wide Parquet file of many.

    tags: all signals that the loop has, as tags or columns: of the others nothing is kept, and nothing said. The rest
    as `read_record`.
    """
    return _read(path, None, tags, sample_time, pv_range, op_range, max_gap, alone=True)


def _read(
    path: str | os.PathLike[str],
    columns: Mapping[str, str] | None,
    tags: Mapping[str, str] | None,
    sample_time: float | None,
    pv_range: Sequence[float] | None,
    op_range: Sequence[float] | None,
    max_gap: float | None,
    *,
    alone: bool,
) -> Record:
    file = Path(file_name(path, "a CSV or Parquet file"))
    source = str(path)
    _check_file(file, source)
    if sample_time is not None:
        number(sample_time, "sample_time", above=0.0, unit="s")
    if max_gap is not None:
        number(max_gap, "max_gap", above=0.0, unit="s")
    for where, mapping in (("columns", columns), ("tags", tags)):
        instance(mapping, (Mapping, type(None)), where, "a mapping such as {'PV': 'FIC101.PV'}")
    scale_pv = None if pv_range is None else ordered_pair(pv_range, "pv_range")
    scale_op = None if op_range is None else ordered_pair(op_range, "op_range")
    both = {**(columns or {}), **(tags or {})}
    found: dict[str, int] = {}
    tall = False
    listed: list[str] = []

    def match(header: list[str]) -> dict[str, int]:
        nonlocal tall
        tall = is_tall(header, columns)
        found.update(match_columns(header, columns if tall or not tags else both, source, tall, alone))
        return found

    names_in, read = (names_in_parquet, read_parquet) if _is_parquet(file) else (names_in_csv, read_csv)
    wanted = list(tags.values()) if alone and tags else []
    if tags and not alone:
        # Of a file of many loops most rows are of others: which tags there are is looked for first.
        _, pairs = names_in(file, match, source)
        listed = list(with_loops(pairs, tags.values()).values())
        if listed:
            wanted = [listed[i] for i in match_tags(listed, tags if tall else both, source).values()]
    table, header = read(file, match, source, True, wanted)
    names = {signal: header[i].strip() for signal, i in found.items()}
    if table.lines.size == 0:
        own = f" of {', '.join(map(repr, wanted))}" if wanted else ""
        msg = f"{source}: a header and no row of data{own}"
        raise RecordError(msg)
    if table.paired:  # the names of columns are those of tags
        signals = from_tall(table, dict(zip(PAIRED, PAIRED, strict=True)), both, source, listed)
    elif tall:
        signals = from_tall(table, names, tags, source, listed)
        signals.notes += flags_unused(header, found)
        signals.notes += [said_of(f"column {names['value']!r}")] if is_average(names["value"]) else []
    else:
        signals = from_wide(table, names, source)
        signals.notes += [] if alone else qualities_unused(header, found)
        stripped = [name.strip() for name in header]
        signals.header, signals.unnamed = stripped, stripped.count("") == 1
        if "time" not in {key.lower() for key in both} and not (
            "month" in names or names_time(names.get("time", "time"))
        ):
            signals.notes.append(f"the times are those of the column {names['time'] or 'without a name'}")
    given = {str(key).upper() for key in both}
    return record_from(signals, sample_time, max_gap, scale_pv, scale_op, set(NEEDED) <= given, source)


def record_from(
    signals: Signals,
    sample_time: float | None,
    max_gap: float | None,
    pv_range: tuple[float, float] | None,
    op_range: tuple[float, float] | None,
    named: bool,
    source: str,
) -> Record:
    """Return the record of a loop's signals, wherever they were read from; arguments as `read_record` checked them.

    named: whether the user said which signal is PV and which OP. Raises `RecordError`.
    """
    for name in NUMERIC:
        if name in signals.by:
            no_codes(signals.by[name].cells)
    signals.notes += aggregates_said({kind: signal.name for kind, signal in signals.by.items()})
    scaled = _scale(signals, pv_range, op_range, source)
    _some_usable(signals, source)
    if not signals.timed and sample_time is None:
        way = "columns={'time': ''} if it is the one without a name" if signals.unnamed else "columns={'time': 'name'}"
        there = f"; the file has {names_said(signals.header)}" if signals.header else ""
        msg = f"{source}: no time column; give sample_time in seconds, or the column, {way}{there}"
        raise RecordError(msg)
    samples = lay(signals, sample_time, max_gap, source)
    if samples.seconds.size == 0:
        spans = (f"{s.seconds[0]:g} to {s.seconds[-1]:g} s" for s in (signals.by["PV"], signals.by["OP"]))
        msg = f"{source}: PV ({next(spans)}) and OP ({next(spans)}) have no sample time in common"
        raise RecordError(msg)
    parts = part(samples, signals.unit)
    if parts.best[1] - parts.best[0] < 2:
        causes = [*_rejections(signals, samples)[1], *parts.notes]
        msg = f"{source}: no two clean rows follow each other in one mode" + "".join(f"; {one}" for one in causes)
        raise RecordError(msg)
    return _record(signals, samples, parts, sample_time, pv_range, scaled, named, source)


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


def _scale(
    signals: Signals, pv_range: tuple[float, float] | None, op_range: tuple[float, float] | None, source: str
) -> bool:
    """Mark what is beyond the ranges, bring OP and the stem to %; return whether OP's range is known."""
    if pv_range is not None:
        within_range(signals.by["PV"].cells, pv_range, "PV", source)
    known = {} if op_range is None else {"OP": op_range}
    for name in ("OP", "valve_position"):
        signal = signals.by.get(name)
        if signal is None:
            continue
        said = name.replace("_", " ")
        if name not in known and any(map(in_milliamperes, (signal.name, signal.unit, *signal.cells.words))):
            known[name] = CURRENT
            said += " (in mA)"
        if name not in known:
            if name == "OP":
                none_far(signal.cells)
                if unit := next(filter(None, map(signal_unit, (signal.name, signal.unit, *signal.cells.words))), ""):
                    way = "give its range, as op_range (--op-range LOW:HIGH)"
                    signals.notes.append(f"OP is in {unit} by its name or unit, and taken as %: {way}")
            continue
        low, high = known[name]
        if name == "OP":
            within_range(signal.cells, known[name], said, source)
        if (low, high) != (0.0, 100.0):
            signal.cells.values = 100.0 * (signal.cells.values - low) / (high - low)
            signals.notes.append(f"{said} taken in % of its range, {low:g} to {high:g}")
    return "OP" in known


def _some_usable(signals: Signals, source: str) -> None:
    """Raise `RecordError` where PV or OP has no usable value at all."""
    for name in NEEDED:
        signal = signals.by[name]
        if (signal.cells.marks == OK).any():
            continue
        if signal.lines.size == 0:
            cause, lines = next(iter(signals.dropped.items()))
            hint = "; is it a decimal comma among commas, or a space among spaces?" if cause == _WHY[FIELDS] else ""
            msg = f"{source}: {signals.unit} {min(lines)}: {cause}, and no row of {signal.name!r} without{hint}"
            raise RecordError(msg)
        mark, line = int(signal.cells.marks[0]), int(signal.lines[0])
        if mark == FIELDS:
            hint = "is it a decimal comma among commas, or a space among spaces?"
            msg = f"{source}: {signals.unit} {line}: {_WHY[mark]}, and no row without; {hint}"
            raise RecordError(msg)
        united = mark == TEXT and all(word[:1].isdigit() for word in signal.cells.words)
        hint = "; export numbers without their unit" if united else _HINTS.get(mark, "")
        msg = (
            f"{source}: {signals.unit} {line}, {signals.what} {signal.name!r}: no row holds a usable number, the first "
            f"is {_WHY[mark]}{_examples(signal, mark)}{hint}"
        )
        raise RecordError(msg)


def _examples(signal: Signal, mark: int) -> str:
    cells = signal.cells
    words = {TEXT: cells.words, QUALITY: cells.qualities, CODE: cells.codes}.get(mark)
    if not words:
        return ""
    common = words.most_common(SHOWN)
    if len(words) == 1:
        return f" ({common[0][0]!r})"
    if len(words) > SHOWN and common[0][1] == 1:
        return f" ({common[0][0]!r} and {len(words) - 1} others)"
    return f" ({', '.join(f'{text!r} {many}' for text, many in common)}{' ...' if len(words) > SHOWN else ''})"


def _beyond(signal: Signal, line: int) -> str:
    """Return the value of a line that is out of range, and what is allowed, to end a note with; "" for others."""
    if signal.cells.beyond is None:
        return ""
    values, least, most = signal.cells.beyond
    value = values[np.flatnonzero(signal.lines[signal.cells.marks == RANGE] == line)[0]]
    return f": {value:.6g}, allowed {least:.6g} to {most:.6g}"


def _rejections(signals: Signals, samples: Samples) -> tuple[dict[str, int], list[str]]:
    """Return how many rows (of a tall file: values) were rejected for each cause, and that in words."""
    counts: dict[str, int] = {}
    notes: list[str] = []
    pv, op = signals.by["PV"], signals.by["OP"]
    if pv.cells.marks.size == op.cells.marks.size and np.array_equal(pv.lines, op.lines):
        # One row, one rejection: PV's cause goes before OP's.
        hits = [(pv, pv.cells.marks), (op, np.where(pv.cells.marks == OK, op.cells.marks, OK))]
    else:
        hits = [(pv, pv.cells.marks), (op, op.cells.marks)]
    for mark, why in _WHY.items():
        if mark == BLANK and not samples.even:
            continue
        found = [(int(s.lines[marks == mark].min()), s) for s, marks in hits if (marks == mark).any()]
        if not found:
            continue
        first, signal = min(found, key=lambda one: one[0])
        lines = np.concatenate([s.lines[marks == mark] for s, marks in hits])
        counts[f"rejected, {why}"] = int(lines.size)
        # Fields too many are the row's fault, and no column's.
        where = "" if mark == FIELDS else f", {signals.what} {signal.name!r}"
        where += _beyond(signal, first) if mark == RANGE else ""
        notes.append(
            f"{lines.size} row{'s' if lines.size > 1 else ''} rejected: {why}{_examples(signal, mark)}, first in "
            f"{signals.unit} {first}{where}"
        )
    for cause, dropped in signals.dropped.items():
        counts[f"rejected, {cause}"] = len(dropped)
        many = f"{len(dropped)} row{'s' if len(dropped) > 1 else ''}"
        notes.append(f"{many} rejected: {cause}, first in {signals.unit} {min(dropped)}")
    return counts, notes


def _record(
    signals: Signals,
    samples: Samples,
    parts: Parts,
    sample_time: float | None,
    pv_range: tuple[float, float] | None,
    scaled: bool,
    named: bool,
    source: str,
) -> Record:
    first, stop = parts.best
    rejected, said = _rejections(signals, samples)
    total = samples.seconds.size
    counts = {"rows": signals.rows, "kept": stop - first, "rejected": sum(rejected.values()), "gaps": samples.gaps}
    counts |= rejected
    counts |= {name: many for name, many in (("repeated", signals.repeated), ("frozen", parts.frozen)) if many}
    counts |= {name: many for name, many in (("manual", parts.manual), ("between", samples.between)) if many}
    counts |= {"filled": samples.filled} if samples.filled else {}
    if not samples.even:
        counts["resampled"] = total
    notes = [*signals.notes, *samples.notes, *said, *parts.notes]
    others = sum(e - b for b, e in parts.others)
    whole = int(np.count_nonzero(samples.usable)) if samples.even else total
    if stop - first < whole:
        counts["left out"] = whole - (stop - first)
        notes.append(_kept_said(signals, samples, parts, others))
    best = record_of(samples, first, stop, sample_time, notes)
    if len(best) > SAME and np.array_equal(best.pv, best.op) and float(np.ptp(best.pv)) > 0.0:
        msg = f"{source}: PV and OP hold the same values in all {len(best)} kept rows: one signal exported twice?"
        raise RecordError(msg)
    if not named and best.sp is not None and swapped(best.sp, best.pv, best.op):
        pv, op = signals.by["PV"].name, signals.by["OP"].name
        way = f"{signals.what}s={{'PV': %r, 'OP': %r}}"
        msg = (
            f"{source}: the setpoint goes with {op!r}, read as OP, and not with {pv!r}, read as PV: swapped? If so, "
            f"give {way % (op, pv)}; if they are right as they are, {way % (pv, op)}"
        )
        raise RecordError(msg)
    notes += held_said(best.pv, best.op, np.ones(len(best), dtype=bool)) if samples.even else []
    notes += op_said(best.op, scaled)
    notes += setpoint_said(best.sp, best.pv, best.op) if best.sp is not None else []
    rest = [record_of(samples, b, e, sample_time, []) for b, e in parts.others]
    return replace(
        best,
        source=source,
        notes=tuple(notes),
        counts=counts,
        pv_range=pv_range,
        epoch=signals.epoch,
        zone=signals.zone,
        rest=tuple(
            replace(
                one,
                source=source,
                pv_range=pv_range,
                epoch=signals.epoch,
                zone=signals.zone,
                counts={"kept": len(one)},
            )
            for one in rest
        ),
    )


def _kept_said(signals: Signals, samples: Samples, parts: Parts, others: int) -> str:
    first, stop = parts.best
    rows = samples.even and signals.what == "column" and not samples.between
    of = f"{signals.rows} rows" if rows else f"{samples.seconds.size} samples"
    said = (
        f"kept the longest clean stretch: {stop - first} of {of}, {signals.unit}s "
        f"{samples.lines[first]} to {samples.lines[stop - 1]}"
    )
    if samples.gaps:
        said += f"; {samples.gaps} gap{'s' if samples.gaps > 1 else ''} in time"
    if parts.others:
        said += f"; {len(parts.others)} more stretch{'es' if len(parts.others) > 1 else ''} with {others} samples"
    return said
