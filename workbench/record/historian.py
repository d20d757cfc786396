"""Tall Parquet data sets of many loops: where each tag's values are, and one loop's record from them alone.

A data set is a file, or a folder of files (partitioned in any way), with a row per value: tag, time, value and perhaps
quality. Of each file only the footer is read first, and the column of tags where the footer does not tell; a loop's
record then takes only the row groups and columns that hold it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import RecordError
from workbench.model.record import FloatArray, Record
from workbench.record.columns import NEEDED, TALL, match_columns, of_folders, with_loops
from workbench.record.counted import counted
from workbench.record.names import split_tag
from workbench.record.parquet import arrow_cells, joined, reading
from workbench.record.reader import record_from
from workbench.record.signals import Signals, Tall, clock_of
from workbench.record.table import FIELDS, Table
from workbench.record.text import arrow_text

__all__ = ["Piece", "Pieces", "named", "pairs_of", "read_tags", "tags_of"]

DAY = 86_400.0  # s, by which no zone is away from UTC


@dataclass(frozen=True, slots=True)
class Piece:
    """Row groups of one Parquet file; none of a file that is no tall Parquet, which is read by `read_loop`."""

    path: str
    groups: tuple[int, ...]


Pieces = tuple[Piece, ...]


@lru_cache(maxsize=64)
def _footer(path: str, _stamp: tuple[int, int]) -> Any:
    import pyarrow.parquet as pq

    return pq.read_metadata(path)


def _open(path: str, **how: object) -> Any:
    """Return the open file; its footer is read once in a process, as files of many loops have long ones."""
    import pyarrow.parquet as pq

    status = Path(path).stat()
    return pq.ParquetFile(path, metadata=_footer(path, (status.st_mtime_ns, status.st_size)), **how)


def _names(file: Any, source: str) -> tuple[dict[str, str], dict[str, str]]:
    """Return the column of each of `TALL` and "loop" that a file has, and what its folders tell of those beside it."""
    header = [str(name) for name in file.schema_arrow.names]
    told = of_folders(Path(source), header)
    found = match_columns([*header, *told], None, source, tall=True)
    if "month" in found:
        raise RecordError(f"{source}: times in columns of year, month ...; a tall data set needs one column of times")
    names = {signal: [*header, *told][i] for signal, i in found.items() if signal in (*TALL, "loop")}
    own = {signal: name for signal, name in names.items() if name not in told}
    return own, {signal: told[name] for signal, name in names.items() if name in told}


def pairs_of(path: str | Path) -> dict[tuple[str, str], Pieces]:
    """Return which row groups of a tall Parquet file hold which (loop, tag), the loop "" where no column names it.

    A row group of which the footer gives equal least and greatest values holds one loop or tag alone; of the others the
    columns are read. Raises `RecordError` for anything but a tall file.
    """
    source = str(path)
    groups: dict[tuple[str, str], list[int]] = {}
    with reading(source), _open(source) as file:
        names, told = _names(file, source)
        meta = file.metadata
        places = [meta.schema.column(i).path for i in range(meta.num_columns)]
        wanted = {signal: names[signal] for signal in ("loop", "tag") if signal in names}
        for group in range(meta.num_row_groups):
            known: dict[str, Any] = dict(told)
            for signal, name in wanted.items():
                stats = meta.row_group(group).column(places.index(name)).statistics
                if stats is not None and stats.has_min_max and stats.min == stats.max and stats.null_count == 0:
                    known[signal] = stats.min
            rest = {name: signal for signal, name in wanted.items() if signal not in known}
            rows: list[dict[str, Any]] = [{}]
            if rest:
                read = file.read_row_group(group, columns=list(rest), use_threads=False)
                rows = read.group_by(list(rest)).aggregate([]).to_pylist()
            for row in rows:
                of = known | {rest[name]: cell for name, cell in row.items()}
                loop, tag = (arrow_text(of.get(signal)) for signal in ("loop", "tag"))
                if tag:
                    groups.setdefault((loop, tag), []).append(group)
    return {pair: (Piece(source, tuple(found)),) for pair, found in groups.items()}


def named(pairs: Mapping[tuple[str, str], Pieces]) -> dict[str, Pieces]:
    """Return a data set's tags by name, as `read_tags` takes them; pairs: of all its files.

    A tag that tells no loop by itself bears its loop's name, too, as one does that stands for several loops.
    """
    tags: dict[str, Pieces] = {}
    for (loop, tag), name in with_loops(pairs.keys()).items():
        whole = f"{loop}.{tag}" if loop and split_tag(name) is None else name
        tags[whole] = (*tags.get(whole, ()), *pairs[loop, tag])
    return tags


def tags_of(path: str | Path) -> dict[str, Pieces]:
    """Return which row groups of a tall Parquet file hold which tag. Raises `RecordError` for anything else."""
    return named(pairs_of(path))


def read_tags(
    pieces: Pieces,
    tags: Mapping[str, str],
    source: str,
    *,
    window: tuple[float, float] | None = None,
    zoned: bool = True,
    sample_time: float | None = None,
    pv_range: tuple[float, float] | None = None,
    op_range: tuple[float, float] | None = None,
    max_gap: float | None = None,
) -> Record:
    """Return one loop's record from the row groups that hold its tags.

    tags: signal to tag; PV and OP at least. window: [start, end) of the timestamps, s since 1970; where not zoned, it
    is by the clock of their own zone, and a day more on both sides is read of files whose zone is another than UTC. The
    rest as `read_record`, whose laws hold here too. source: how messages name the loop. Raises `RecordError`.
    """
    for needed in NEEDED:
        if needed not in tags:
            raise RecordError(f"{source}: no tag for {needed}; tags: {', '.join(sorted(tags.values())) or 'none'}")
    with reading(source):
        import pyarrow as pa
        import pyarrow.compute as pc

        parts = [_rows(piece, sorted(set(tags.values())), window, zoned, source) for piece in pieces]
        if not parts:
            raise RecordError(f"{source}: no row holds {' or '.join(sorted(tags.values()))}")
        try:
            whole = pa.concat_tables(_of_one_zone(parts), promote_options="permissive")
        except pa.ArrowException as error:
            how = str(error).partition(": ")[2] or str(error)
            raise RecordError(f"{source}: its files do not agree: {how}; export all with one type of each") from None
        order: list[tuple[str, str, Any]] = []
        for kind, tag in tags.items():
            rows = whole.filter(pc.is_in(whole.column("tag"), pa.array([tag]))).combine_chunks()
            if rows.num_rows:
                order.append((kind, tag, rows))
            elif kind in NEEDED:
                within = "" if window is None else " within the window of time"
                raise RecordError(f"{source}: tag {tag!r} holds no value{within}")
        clocks = [arrow_cells(rows.column("time"), "time", f"{source}: column 'time'") for _, _, rows in order]
        values = [arrow_cells(rows.column("value"), kind, f"{source}: tag {tag!r}") for kind, tag, rows in order]
        said = [
            [_texts(rows.column(name)) if name in rows.column_names else None for name in TALL[3:]]
            for _, _, rows in order
        ]
    lines = np.arange(1, sum(clock.marks.size for clock in clocks) + 1, dtype=np.int64)
    signals = Signals({}, "value", lines.size, time_name="time", what="tag")
    clock = joined(clocks)
    table = Table({"time": clock}, lines, "value")
    times = clock_of(clock, "time", table, source, signals.notes)
    rated = Counter(text for qualities, _ in said for text in qualities or ())
    tall = Tall(signals, times, clock.marks == FIELDS, lines, {name: name for name in TALL}, source, rated)
    first = 0
    for (kind, tag, _), cells, (qualities, units) in zip(order, values, said, strict=True):
        stop = first + cells.marks.size
        tall.add(kind, tag, np.arange(first, stop), cells, qualities, units)
        first = stop
    return record_from(tall.done(), sample_time, max_gap, pv_range, op_range, True, source)


def _rows(piece: Piece, tags: list[str], window: tuple[float, float] | None, zoned: bool, source: str) -> Any:
    """Return a piece's rows of these tags within the window as a table of the columns of `TALL` that it has."""
    import pyarrow as pa

    with _open(piece.path) as file:
        names, told = _names(file, piece.path)
        groups = list(piece.groups)
        if window is not None:
            zone = getattr(file.schema_arrow.field(names["time"]).type, "tz", None)
            if not zoned and zone not in (None, "UTC"):
                window = window[0] - DAY, window[1] + DAY
            groups = [g for g in groups if _meets(file.metadata.row_group(g), names["time"], window)]
    texts = [names[name] for name in ("tag", "loop", "quality", "unit") if name in names]
    with _open(piece.path, read_dictionary=texts) as file:
        read = file.read_row_groups(groups, columns=list(names.values()), use_threads=False)
    table = read.select(list(names.values())).rename_columns(list(names))
    for signal, cell in told.items():
        table = table.append_column(signal, pa.repeat(cell, table.num_rows))
    for i, name in enumerate(table.column_names):
        if name not in ("time", "value"):
            table = table.set_column(i, name, _coded(table.column(name)))
    table = _of_tags(table, tags)
    if window is not None:
        cells = arrow_cells(table.column("time"), "time", source)
        seconds = cells.values if cells.stamped is not None else _since_1970(cells.values)
        if cells.texts is not None:
            return table  # which are read for the whole column
        table = table.filter(pa.array((seconds >= window[0]) & (seconds < window[1])))
    return table


def _of_one_zone(parts: list[Any]) -> list[Any]:
    """Return tables with their times in UTC where they name several zones: the instants are the same."""
    import pyarrow as pa

    kinds = [part.schema.field("time").type for part in parts]
    zones = {kind.tz for kind in kinds if pa.types.is_timestamp(kind) and kind.tz is not None}
    if len(zones) < 2:
        return parts
    out = []
    for part, kind in zip(parts, kinds, strict=True):
        if pa.types.is_timestamp(kind) and kind.tz is not None:
            at = part.column_names.index("time")
            out.append(part.set_column(at, "time", part.column("time").cast(pa.timestamp(kind.unit, "UTC"))))
        else:
            out.append(part)
    return out


def _of_tags(table: Any, tags: list[str]) -> Any:
    """Return the rows of these tags, each under the name of `named`: the tag, or its loop's name and the tag."""
    import pyarrow as pa
    import pyarrow.compute as pc

    wanted = pa.array(tags)
    keep = pc.is_in(table.column("tag"), wanted)
    if "loop" in table.column_names:
        # Few rows are of these loops: names are put together of those alone.
        loops = pc.unique(table.column("loop")).to_pylist()
        ours = pa.array(
            [loop for loop in loops if loop and any(tag.startswith(f"{loop}.") for tag in tags)], pa.string()
        )
        keep = pc.or_(keep, pc.is_in(table.column("loop"), ours))
    table = table.filter(keep)
    names = pc.cast(table.column("tag"), pa.string())
    if "loop" in table.column_names:
        joined = pc.binary_join_element_wise(pc.cast(table.column("loop"), pa.string()), names, ".")
        names = pc.if_else(pc.fill_null(pc.is_in(joined, wanted), False), joined, names)
    table = table.set_column(table.column_names.index("tag"), "tag", names)
    return table.filter(pc.is_in(names, wanted))


def _since_1970(values: FloatArray) -> FloatArray:
    """Return numbers as seconds, as the record's times will be, or as they are where they are none."""
    found = counted(values, "time").seconds
    return values if found is None else found


def _meets(group: Any, column: str, window: tuple[float, float]) -> bool:
    """Whether a row group's times may lie within the window, as far as its footer tells."""
    stats = next(
        (group.column(i).statistics for i in range(group.num_columns) if group.column(i).path_in_schema == column), None
    )
    if stats is None or not stats.has_min_max:
        return True
    try:
        limits = stats.min, stats.max
    except ValueError:  # nanoseconds, which a datetime does not hold
        return True
    ends = [end.replace(tzinfo=end.tzinfo or UTC).timestamp() if isinstance(end, datetime) else end for end in limits]
    if not all(isinstance(end, float | int) for end in ends):
        return True
    if not isinstance(limits[0], datetime):
        ends = _since_1970(np.array(ends, dtype=np.float64)).tolist()
    return bool(ends[0] < window[1] and ends[1] >= window[0])


def _coded(column: Any) -> Any:
    """Return a column of texts, or of codes, as a dictionary of texts; its few values are made text only once."""
    import pyarrow as pa

    coded = column.combine_chunks()
    if not pa.types.is_dictionary(coded.type):
        coded = coded.dictionary_encode()
    words = [arrow_text(cell) for cell in coded.dictionary.to_pylist()]
    return pa.DictionaryArray.from_arrays(coded.indices, pa.array(words, pa.string()))


def _texts(column: Any) -> list[str]:
    """Return a column of `_coded` as a list of texts, "" for none."""
    coded = column.combine_chunks()
    words = np.array([*coded.dictionary.to_pylist(), ""], dtype=object)
    at = np.asarray(coded.indices.fill_null(len(words) - 1).to_numpy(zero_copy_only=False))
    texts: list[str] = words[at].tolist()
    return texts
