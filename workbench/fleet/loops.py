"""The loops that files and a data set's tags tell. No value is read."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from workbench.errors import RecordError
from workbench.fleet.store import MARK
from workbench.model.fleet import LoopSource
from workbench.record.columns import NAMED, NEEDED, is_tall, loops_of, of_folders, of_no_loop
from workbench.record.historian import Piece, Pieces, named, pairs_of
from workbench.record.many import many_in
from workbench.record.names import split_tag

__all__ = ["FILES", "OWN", "Sources", "all_tags", "loops_in", "of_tags", "tagged", "tags_in"]

PARQUET = (".parquet", ".pq")
FILES = (".csv", ".txt", *PARQUET)
Key = TypeVar("Key")
LABELS = "labels.csv"  # what `workbench score` reads, and no loop
# What the workbench itself writes, each with the file that it always writes beside it, and no loop either.
OWN = {
    "cases.csv": "results.json",
    "estimate.csv": "estimate.json",
    "compare.csv": "compare.html",
    "fleet.csv": "fleet.parquet",
}


@dataclass(frozen=True, eq=False)
class Sources:
    """The loops of a site, by name; title: for the report; shown: where they come from; depth: that a manifest asks.

    left_out: names of further loops that are there and were not asked for. notes: on what is there and of no loop.
    """

    title: str
    shown: str
    loops: tuple[LoopSource, ...]
    depth: str | None = None
    left_out: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()


def loops_in(path: Path) -> tuple[list[LoopSource], list[str]]:
    """Return the loops of a folder or file, and notes on what is of none; two loops of one name stay two.

    A file of one loop gives it its name, by its path in the folder.
    """
    root = path if path.is_dir() else path.parent
    loops: list[LoopSource] = []
    notes: list[str] = []
    pairs: dict[tuple[str, str], Pieces] = {}
    for file in _files(path):
        name = file.relative_to(root).with_suffix("").as_posix()
        try:
            if file.suffix.lower() in PARQUET:
                schema = _schema(file)
                if MARK in (schema.metadata or {}):
                    continue  # rows of a fleet run, and no loop
                header = [str(name) for name in schema.names]
                if is_tall([*header, *of_folders(file, header)], None):
                    found = pairs_of(file)
                    if _alone(found):
                        loops.append(LoopSource(name, str(file)))
                    else:
                        _add(pairs, found)
                    continue
        except RecordError as error:
            loops.append(LoopSource(name, str(file), refusal=str(error)))
            continue
        tags = tags_in(file)
        loops += tagged(tags).values() if tags else [LoopSource(name, str(file))]
        notes += _unused(tags, str(file))
    tags = named(pairs)
    return loops + list(tagged(tags).values()), notes + _unused(tags, "tall Parquet")


def tags_in(file: Path) -> dict[str, Pieces]:
    """Return the tags, or columns, of a CSV or wide Parquet file of many loops, by name; none of a file of one loop.

    Of a file that cannot be read there are none: who reads it as a loop's says why.
    """
    pairs: dict[tuple[str, str], Pieces] = {}
    with suppress(RecordError):
        for pair in many_in(file) if file.suffix.lower() in FILES else ():
            _add(pairs, {pair: (Piece(str(file), ()),)})
    return named(pairs)


def _add(pairs: dict[Key, Pieces], found: Mapping[Key, Pieces]) -> None:
    for pair, pieces in found.items():
        pairs[pair] = (*pairs.get(pair, ()), *pieces)


def _unused(tags: Collection[str], where: str) -> list[str]:
    """Return a note on the tags or columns that belong to no loop, or none."""
    unused = of_no_loop(tags)
    more = f" and {len(unused) - NAMED} more" if len(unused) > NAMED else ""
    return [f"{where}: of no loop, and not used: {', '.join(unused[:NAMED])}{more}"] if unused else []


def _alone(pairs: Iterable[tuple[str, str]]) -> bool:
    """Whether a tall file's tags are PV and OP and tell no loop: the file is one loop's, and has its name."""
    signals = {split[1] for loop, tag in pairs if not loop and not split_tag(tag) and (split := split_tag(f"x.{tag}"))}
    return signals.issuperset(NEEDED)


def all_tags(folder: Path) -> dict[str, Pieces]:
    """Return the tags of the tall Parquet files in a folder, as one data set, and of files of many loops, by name.

    Files that cannot be read are passed over: of the loops in them the tags are missing, and they say so.
    """
    pairs: dict[tuple[str, str], Pieces] = {}
    others: dict[str, Pieces] = {}
    for file in _files(folder):
        try:
            _add(pairs, pairs_of(file))
        except RecordError:
            _add(others, tags_in(file))
    tags = named(pairs)
    _add(tags, others)
    return tags


def _files(path: Path) -> list[Path]:
    try:
        return sorted(one for one in path.rglob("*") if _record_file(one, path)) if path.is_dir() else [path]
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror or error})") from None


def _record_file(path: Path, root: Path) -> bool:
    parts = path.relative_to(root).parts
    hidden = any(part.startswith((".", "_")) for part in parts)
    named = path.suffix.lower() in FILES and path.name.lower() != LABELS and path.is_file()
    own = path.name in OWN and (path.parent / OWN[path.name]).is_file()
    return named and not hidden and not own


def _schema(file: Path) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_schema(file)
    except (pa.ArrowException, OSError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordError(f"{file}: no readable Parquet file: {said}") from None


def tagged(tags: dict[str, Pieces]) -> dict[str, LoopSource]:
    """Return the loops that a data set's tags tell, by name; tags that end in no signal's name are passed over."""
    loops = {}
    for name, own in loops_of(sorted(tags)).items():
        twice = [
            f"tags {found[0]!r} and {found[1]!r} are both {signal}; a manifest can say which"
            for signal, found in own.items()
            if len(found) > 1
        ]
        loops[name] = of_tags(name, {signal: found[-1] for signal, found in own.items()}, tags, "; ".join(twice))
    return loops


def of_tags(name: str, own: dict[str, str], tags: dict[str, Pieces], refusal: str) -> LoopSource:
    """Return the loop whose signals are the tags `own` of a data set, refused where PV or OP is not among them."""
    missing = [f"tag {tag!r} of {signal} is not in the data" for signal, tag in own.items() if tag not in tags]
    missing += [f"no tag for {signal}" for signal in NEEDED if signal not in own]
    groups: dict[str, set[int]] = {}
    for tag in own.values():
        places = [piece.path for piece in tags.get(tag, ()) if not piece.groups]
        if len(places) > 1:
            missing.append(f"{tag!r} is there {len(places)} times, in {', '.join(sorted(set(places)))}")
        for piece in tags.get(tag, ()):
            groups.setdefault(piece.path, set()).update(piece.groups)
    if len(groups) > 1 and not all(groups.values()):
        missing.append(f"its tags are in {len(groups)} files ({', '.join(sorted(groups))}), and not all tall Parquet")
    return LoopSource(
        name,
        pieces=tuple((path, tuple(sorted(groups[path]))) for path in sorted(groups)),
        tags=tuple(own.items()),
        refusal=refusal or (f"{'; '.join(missing)} (tags: {', '.join(sorted(own.values()))})" if missing else ""),
    )
