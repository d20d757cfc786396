"""The loops that files and a data set's tags tell. No value is read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from workbench.errors import RecordError
from workbench.fleet.store import MARK
from workbench.model.fleet import LoopSource
from workbench.record.columns import NEEDED, is_tall, of_folders, split_tag
from workbench.record.historian import Pieces, named, pairs_of

__all__ = ["FILES", "OWN", "Sources", "loops_in", "of_tags", "tagged"]

FILES = (".csv", ".txt", ".parquet", ".pq")
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

    left_out: names of further loops that are there and were not asked for.
    """

    title: str
    shown: str
    loops: tuple[LoopSource, ...]
    depth: str | None = None
    left_out: frozenset[str] = frozenset()


def loops_in(path: Path) -> list[LoopSource]:
    """Return the loops of a folder or file; two of one name stay two. Files are named by their path in the folder."""
    root = path if path.is_dir() else path.parent
    try:
        files = sorted(one for one in path.rglob("*") if _record_file(one, root)) if path.is_dir() else [path]
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror or error})") from None
    loops: list[LoopSource] = []
    pairs: dict[tuple[str, str], Pieces] = {}
    for file in files:
        name = file.relative_to(root).with_suffix("").as_posix()
        if file.suffix.lower() not in (".parquet", ".pq"):
            loops.append(LoopSource(name, str(file)))
            continue
        try:
            schema = _schema(file)
            if MARK in (schema.metadata or {}):
                continue  # rows of a fleet run, and no loop
            header = [str(name) for name in schema.names]
            if not is_tall([*header, *of_folders(file, header)], None):
                loops.append(LoopSource(name, str(file)))
                continue
            found = pairs_of(file)
            if _alone(found):
                loops.append(LoopSource(name, str(file)))
                continue
            for pair, pieces in found.items():
                pairs[pair] = (*pairs.get(pair, ()), *pieces)
        except RecordError as error:
            loops.append(LoopSource(name, str(file), refusal=str(error)))
    return loops + list(tagged(named(pairs)).values())


def _alone(pairs: Iterable[tuple[str, str]]) -> bool:
    """Whether a tall file's tags are PV and OP and tell no loop: the file is one loop's, and has its name."""
    signals = {split[1] for loop, tag in pairs if not loop and not split_tag(tag) and (split := split_tag(f"x.{tag}"))}
    return signals.issuperset(NEEDED)


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
    by: dict[str, dict[str, str]] = {}
    twice: dict[str, str] = {}
    for tag in sorted(tags):
        split = split_tag(tag)
        if split is None:
            continue
        name, signal = split
        own = by.setdefault(name, {})
        if signal in own:
            twice.setdefault(name, f"tags {own[signal]!r} and {tag!r} are both {signal}; a manifest can say which")
        own[signal] = tag
    return {name: of_tags(name, own, tags, twice.get(name, "")) for name, own in by.items()}


def of_tags(name: str, own: dict[str, str], tags: dict[str, Pieces], refusal: str = "") -> LoopSource:
    """Return the loop whose signals are the tags `own` of a data set, refused where PV or OP is not among them."""
    missing = [f"tag {tag!r} of {signal} is not in the data" for signal, tag in own.items() if tag not in tags]
    missing += [f"no tag for {signal}" for signal in NEEDED if signal not in own]
    groups: dict[str, set[int]] = {}
    for tag in own.values():
        for piece in tags.get(tag, ()):
            groups.setdefault(piece.path, set()).update(piece.groups)
    return LoopSource(
        name,
        pieces=tuple((path, tuple(sorted(groups[path]))) for path in sorted(groups)),
        tags=tuple(own.items()),
        refusal=refusal or (f"{'; '.join(missing)} (tags: {', '.join(sorted(own.values()))})" if missing else ""),
    )
