"""Parquet files as columns of numbers. Nothing is dropped here, only marked."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import RecordError
from workbench.model.record import FloatArray
from workbench.record.names import names_time
from workbench.record.pairs import PAIRED, Pairs, in_use, pairs_of, unnamed
from workbench.record.table import BLANK, NUMERIC, OK, TEXT, Cells, Table, marked, number_cells, text_cells
from workbench.record.text import arrow_text

__all__ = ["arrow_cells", "joined", "names_in_parquet", "read_parquet", "reading"]

_LOOKED_AT = 20  # rows, whose cells show whether there are pairs of columns


@contextmanager
def reading(source: str) -> Iterator[None]:
    """Refuse, with `RecordError`, a file that cannot be read as Parquet."""
    import pyarrow as pa

    try:
        yield
    except RecordError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, NotImplementedError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordError(f"{source}: no readable Parquet file: {said}") from None


def read_parquet(
    path: Path,
    match: Callable[[list[str]], dict[str, int]],
    source: str,
    apart: bool = False,
    wanted: Collection[str] = (),
) -> tuple[Table, list[str]]:
    """Return the needed columns of a Parquet file and its column names; only these are read.

    match, apart: as in `read_csv`. wanted: of pairs, the tags that are kept; all where none is given. Raises
    `RecordError`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading(source), pq.ParquetFile(path) as file:
        header, pairs = _header(file, source, apart)
        if pairs:
            return _in_pairs(file, header, in_use(pairs, wanted), source), header
        found = match(header)
        if len(set(header)) < len(header):
            raise RecordError(f"{source}: several columns have the same name; each needs its own")
        stamps = [i for i, kind in enumerate(file.schema_arrow.types) if pa.types.is_timestamp(kind)]
        if "time" not in found and len(stamps) == 1 and stamps[0] not in found.values():
            found["time"] = stamps[0]
        table = file.read(columns=[header[i] for i in found.values()])
        columns = {
            name: arrow_cells(table.column(header[i]), name, f"{source}: column {header[i]!r}")
            for name, i in found.items()
        }
        rows = table.num_rows
    return Table(columns, np.arange(1, rows + 1, dtype=np.int64), "row"), header


def names_in_parquet(
    path: Path, match: Callable[[list[str]], dict[str, int]], source: str
) -> tuple[list[str], list[tuple[str, str]]]:
    """Return a Parquet file's column names and, as ("", tag), the tag of each pair of columns; none of a wide one.

    match: as in `read_csv`; it looks at the names of anything but pairs. Raises `RecordError`.
    """
    import pyarrow.parquet as pq

    with reading(source), pq.ParquetFile(path) as file:
        header, pairs = _header(file, source, apart=True)
    if not pairs:
        match(header)
    return header, [("", tag) for tag in pairs]


def _header(file: Any, source: str, apart: bool) -> tuple[list[str], Pairs]:
    """Return the names of the columns, and the pairs of them, if they are such and may be."""
    header = [str(name) for name in file.schema_arrow.names]
    # Looking at cells takes time, and nearly no file is such.
    several = apart and sum(unnamed(name) or names_time(name) for name in header) > 1
    return header, pairs_of(header, _first(file), source) if several else {}


def _first(file: Any) -> list[list[str]]:
    """Return the cells of the first rows as text."""
    batch = next(file.iter_batches(batch_size=_LOOKED_AT), None)
    columns = [] if batch is None else [[arrow_text(cell) for cell in column.to_pylist()] for column in batch.columns]
    return [list(row) for row in zip(*columns, strict=True)]


def _in_pairs(file: Any, header: Sequence[str], pairs: Pairs, source: str) -> Table:
    """Return a file that has a pair of columns for each tag as the table of `PAIRED`, without the rows of no value."""
    if len(set(header)) < len(header):
        raise RecordError(f"{source}: several columns have the same name; each needs its own")
    tags, times, values, lines = [], [], [], []
    for tag, at in pairs.items():
        read = file.read(columns=[header[i] for i in at])
        time, value = (arrow_cells(read.column(i), kind, f"{source}: tag {tag!r}") for i, kind in enumerate(PAIRED[1:]))
        rows = np.flatnonzero((time.marks != BLANK) | (value.marks != BLANK))
        tags += [tag] * rows.size
        times.append(time.take(rows))
        values.append(value.take(rows))
        lines.append(rows + 1)
    named = Cells(np.full(len(tags), np.nan), np.full(len(tags), TEXT, dtype=np.int8), texts=tags)
    columns = dict(zip(PAIRED, (named, joined(times), joined(values)), strict=True))
    return Table(columns, np.concatenate(lines).astype(np.int64), "row", paired=True)


def joined(cells: Sequence[Cells]) -> Cells:
    """Return the cells of several columns as one; with texts where one of them has such."""
    texts = None if all(one.texts is None for one in cells) else [text for one in cells for text in one.as_texts()]
    stamps = [one.stamped for one in cells]
    easts = [np.zeros(one.values.size) if one.east is None else one.east for one in cells]
    return Cells(
        np.concatenate([one.values for one in cells]),
        np.concatenate([one.marks for one in cells]),
        texts=texts,
        stamped=None if None in stamps else stamps[0],
        east=None if all(one.east is None for one in cells) else np.concatenate(easts),
    )


def arrow_cells(column: object, name: str, where: str) -> Cells:
    """Return a column of an Arrow table as cells; name: the signal that it is, which tells numbers from text."""
    import pyarrow as pa
    import pyarrow.compute as pc

    chunk = column.combine_chunks()  # type: ignore[attr-defined]
    kind = chunk.type
    if pa.types.is_dictionary(kind):
        chunk = chunk.dictionary_decode()
        kind = chunk.type
    if pa.types.is_date(kind):
        chunk, kind = pc.cast(chunk, pa.timestamp("us")), pa.timestamp("us")
    missing = np.asarray(pc.is_null(chunk).to_numpy(zero_copy_only=False), dtype=bool)
    if pa.types.is_timestamp(kind):
        fine = pc.cast(chunk, pa.timestamp("us", kind.tz), safe=False)
        values = np.where(missing, np.nan, np.asarray(fine.cast(pa.int64()).fill_null(0)) / 1e6)
        marks = np.where(missing, BLANK, OK).astype(np.int8)
        return Cells(values, marks, stamped=kind.tz is not None, east=_east(fine, values))
    if pa.types.is_boolean(kind):
        chunk, kind = pc.cast(chunk, pa.int8()), pa.int8()
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        # A float holds nanoseconds since 1970 to the quarter of a microsecond: near enough, but not exact.
        plain = pc.cast(chunk, pa.float64(), safe=False)
        cells = marked(np.array(plain.to_numpy(zero_copy_only=False), dtype=np.float64))
        cells.marks[missing] = BLANK
        return cells
    listed = [arrow_text(v) for v in chunk.to_pylist()]
    return text_cells(listed, False, where) if name not in NUMERIC else number_cells(listed, False, where)


def _east(stamps: Any, seconds: FloatArray) -> FloatArray | None:
    """Return how far the zone of an Arrow column of timestamps is east of Greenwich, s, shape (N,); None for UTC.

    seconds: the same since 1970, nan for none. Where the system knows no zones they are taken for UTC.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    if stamps.type.tz in (None, "UTC"):
        return None
    with suppress(pa.ArrowException):
        local = pc.cast(pc.local_timestamp(stamps), pa.int64()).fill_null(0)
        return np.asarray(np.where(np.isnan(seconds), np.nan, np.asarray(local) / 1e6 - seconds))
    return None
