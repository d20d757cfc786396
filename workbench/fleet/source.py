"""What a site is, a folder of records, a tall Parquet data set or a manifest, as a list of loops. No value is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

from workbench.errors import InvalidValue, RecordError
from workbench.model.fleet import LoopSource
from workbench.record.columns import NEEDED, is_tall, split_tag
from workbench.record.historian import Pieces, tags_of

__all__ = ["Sources", "only", "sources_of"]

FILES = (".csv", ".txt", ".parquet", ".pq")
MANIFESTS = (".yaml", ".yml")
LABELS = "labels.csv"  # what `workbench score` reads, and no loop


@dataclass(frozen=True, eq=False)
class Sources:
    """The loops of a site, by name; title: for the report; shown: where they come from; depth: that a manifest asks."""

    title: str
    shown: str
    loops: tuple[LoopSource, ...]
    depth: str | None = None


def sources_of(path: Path) -> Sources:
    """Return the loops of a folder, a Parquet data set or a manifest (YAML or CSV).

    In a folder every CSV and wide Parquet file is a loop, named by its path; tall Parquet files, in any partitioning,
    are one data set, whose tags tell the loops (FIC101.PV is PV of FIC101). Names that begin with "." or "_" are passed
    over. A file that cannot be read, tags without PV or OP and a name that two loops share become loops with a refusal.
    Raises `RecordError` where there is nothing to look at, and `ScenarioError` for a manifest with mistakes.
    """
    if not path.exists():
        raise RecordError(f"{path}: no such file or folder")
    if path.is_dir():
        return Sources(path.resolve().name, str(path), _nothing(_unique(loops_in(path)), path))
    if path.suffix.lower() in (*MANIFESTS, ".csv"):
        from workbench.fleet.manifest import read_manifest

        return read_manifest(path)
    if path.suffix.lower() in FILES:
        return Sources(path.stem, str(path), _nothing(_unique(loops_in(path)), path))
    raise RecordError(
        f"{path}: is no source of loops; give a folder of records, a tall Parquet file or folder, or a manifest "
        "(.yaml, .csv)"
    )


def only(sources: Sources, patterns: Sequence[str]) -> Sources:
    """Return the loops whose name matches one of the patterns ("FIC*"); all without any. Raises `InvalidValue`."""
    if not patterns:
        return sources
    kept = tuple(loop for loop in sources.loops if any(fnmatchcase(loop.name, pattern) for pattern in patterns))
    if not kept:
        raise InvalidValue("--include", ", ".join(patterns), f"matches none of the {len(sources.loops)} loops")
    return replace(sources, loops=kept)


def _nothing(loops: tuple[LoopSource, ...], path: Path) -> tuple[LoopSource, ...]:
    if not loops:
        raise RecordError(
            f"{path}: holds no record; CSV or Parquet files with PV and OP, or tags ending so, are needed"
        )
    return loops


def _unique(loops: Sequence[LoopSource]) -> tuple[LoopSource, ...]:
    """Return loops sorted by name; of several with one name there stays one, refused."""
    by: dict[str, list[LoopSource]] = {}
    for loop in loops:
        by.setdefault(loop.name, []).append(loop)
    out = []
    for name in sorted(by):
        first, *others = by[name]
        if others:
            places = ", ".join(sorted({one.path or one.pieces[0][0] for one in by[name]}))
            first = LoopSource(name, refusal=f"{len(by[name])} loops have this name ({places}); each needs its own")
        out.append(first)
    return tuple(out)


def loops_in(path: Path) -> list[LoopSource]:
    """Return the loops of a folder or file; two of one name stay two. Files are named by their path in the folder."""
    root = path if path.is_dir() else path.parent
    try:
        files = sorted(one for one in path.rglob("*") if _record_file(one, root)) if path.is_dir() else [path]
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror or error})") from None
    loops: list[LoopSource] = []
    tags: dict[str, Pieces] = {}
    for file in files:
        name = file.relative_to(root).with_suffix("").as_posix()
        if file.suffix.lower() not in (".parquet", ".pq"):
            loops.append(LoopSource(name, str(file)))
            continue
        try:
            if not _tall(file):
                loops.append(LoopSource(name, str(file)))
                continue
            for tag, pieces in tags_of(file).items():
                tags[tag] = (*tags.get(tag, ()), *pieces)
        except RecordError as error:
            loops.append(LoopSource(name, str(file), refusal=str(error)))
    return loops + list(tagged(tags).values())


def _record_file(path: Path, root: Path) -> bool:
    parts = path.relative_to(root).parts
    hidden = any(part.startswith((".", "_")) for part in parts)
    return not hidden and path.suffix.lower() in FILES and path.name.lower() != LABELS and path.is_file()


def _tall(file: Path) -> bool:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return is_tall([str(name) for name in pq.read_schema(file).names], None)
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
