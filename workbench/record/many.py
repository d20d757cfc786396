"""Which loops one file of many holds, wide or tall: by its header, and a tall CSV file's column of tags."""

from __future__ import annotations

from pathlib import Path

from workbench.errors import RecordError
from workbench.record.columns import is_tall, loops_of, match_columns, match_tags, whole, with_loops
from workbench.record.csv_file import names_in_csv
from workbench.record.historian import named
from workbench.record.pairs import unnamed
from workbench.record.parquet import names_in_parquet
from workbench.record.reader import LARGEST

__all__ = ["many_in"]


def many_in(path: Path) -> list[tuple[str, str]]:
    """Return each (loop, tag) of a CSV file, or column of a wide one, that holds loops; the loop "" where none says it.

    None at all where the file reads as one loop's, or no loop in it has PV and OP: `read_record` says what is wrong.
    Columns of one name come as often as they are there. Parquet files are wide ones, or of pairs. Raises `RecordError`.
    """
    source, many = str(path), False
    if path.stat().st_size > LARGEST:
        return []

    def match(header: list[str]) -> dict[str, int]:
        nonlocal many
        tall = is_tall(header, None)
        try:
            return match_columns(header, None, source, tall)
        except RecordError:
            many = not tall and bool(whole(loops_of(name.strip() for name in header)))
            if not many:
                raise
            return {}

    names_in = names_in_parquet if path.suffix.lower() in (".parquet", ".pq") else names_in_csv
    header, pairs = names_in(path, match, source)
    if many:
        return [("", name.strip()) for name in header if not unnamed(name)]
    if len({loop for loop, _ in pairs}) < 2:
        try:
            match_tags(list(with_loops(pairs).values()), None, source)
        except RecordError:
            pass
        else:
            return []
    return pairs if whole(loops_of(named(dict.fromkeys(pairs, ())))) else []
