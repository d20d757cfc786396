"""What a site is, a folder of records, a tall Parquet data set or a manifest, as a list of loops."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

from workbench.errors import InvalidValue, RecordError
from workbench.fleet.loops import FILES, Sources, loops_in
from workbench.fleet.manifest import read_manifest
from workbench.model.fleet import LoopSource
from workbench.record.names import tier_of
from workbench.record.text import HEAD, delimiter, encoding_of

__all__ = ["only", "sources_of"]

MANIFESTS = (".yaml", ".yml")


def sources_of(path: Path) -> Sources:
    """Return the loops of a folder, a Parquet data set, a file of one loop or many, or a manifest (YAML or CSV).

    In a folder a CSV or wide Parquet file of one loop is a loop, named by its path; one of many, wide or tall, holds
    those that its columns or tags tell (FIC101.PV is PV of FIC101), or a column of loops beside the tags. Tall Parquet
    files, in any partitioning, are one data set, whose tags tell the loops in the same way, or folders such as
    loop=FIC101; a tall file with PV and OP and no loop's name is a loop. Names that begin with "." or "_"
    are passed over, and so is what the workbench itself wrote there, such as an estimate's table or the rows of a
    fleet run. A file that cannot be read, tags without PV or OP and a name that two loops share become loops with a
    refusal. Raises `RecordError` where there is nothing to look at, and `ScenarioError` for a manifest with mistakes.
    """
    if not path.exists():
        raise RecordError(f"{path}: no such file or folder")
    kind = path.suffix.lower()
    if path.is_dir() or kind in FILES:
        loops, notes = loops_in(path)
        if path.is_dir() or kind != ".csv" or any(loop.pieces for loop in loops) or _timed(path):
            title = path.resolve().name if path.is_dir() else path.stem
            return Sources(title, str(path), _nothing(_unique(loops), path), notes=tuple(notes))
    if kind in (*MANIFESTS, ".csv"):
        return read_manifest(path)
    raise RecordError(
        f"{path}: is no source of loops; give a folder of records, a file of them (.csv, .parquet), or a manifest "
        "(.yaml, .csv)"
    )


def _timed(path: Path) -> bool:
    """Whether the first line of a CSV file names a column of times, which a manifest has not."""
    with suppress(OSError, RecordError):
        with path.open("rb") as raw:
            head = raw.read(HEAD)
        lines = head.decode(encoding_of(head, str(path)), errors="replace").splitlines()
        names = lines[0].split(delimiter(lines[0], lines[1:2])) if lines else []
        return any(tier_of(name.strip(' "'), "time") is not None for name in names)
    return False


def only(sources: Sources, patterns: Sequence[str]) -> Sources:
    """Return the loops whose name matches one of the patterns ("FIC*"); all without any. Raises `InvalidValue`."""
    if not patterns:
        return sources
    kept = tuple(loop for loop in sources.loops if any(fnmatchcase(loop.name, pattern) for pattern in patterns))
    if not kept:
        raise InvalidValue("--include", ", ".join(patterns), f"matches none of the {len(sources.loops)} loops")
    left_out = frozenset(loop.name for loop in sources.loops) - {loop.name for loop in kept}
    return replace(sources, loops=kept, left_out=left_out)


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
