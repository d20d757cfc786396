"""How well the verdicts do on a folder of labelled records: `workbench score`."""

from __future__ import annotations

import csv
import json
import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from workbench.errors import RecordError

if TYPE_CHECKING:
    from workbench.model.results import Estimate

__all__ = ["Labelled", "Scored", "labelled", "score", "score_content", "write_score"]

LABELS = ("stiction", "no_stiction")
VERDICTS = (*LABELS, "undecided")

# What a reader's message advises to give it, which a folder's files cannot be given.
_ADVICE = re.compile(r"; (?:say which one|give (?:the mapping|sample_time)\b).*", re.DOTALL)
_RENAME = "; score takes names as they are: in the file, one column or tag each must be called time, PV and OP"


@dataclass(frozen=True, slots=True)
class Labelled:
    """One line of labels.csv: the record's path, its label, and the tag of its loop (the file where it names none).

    file: the path as it is written there.
    """

    path: Path
    label: str
    tag: str
    file: str


@dataclass(frozen=True, slots=True)
class Scored:
    """One record's verdict beside its label.

    S, J in % (Stenman: S = J = d), gain in EU/%, time_constant and dead_time in s; nan where the model has none.
    error: why the record could not be used, counted as undecided. seconds: reading and estimating.
    """

    file: str
    tag: str
    label: str
    verdict: str
    S: float
    J: float
    gain: float
    time_constant: float
    dead_time: float
    error: str
    seconds: float


def labelled(folder: Path) -> list[Labelled]:
    """Return the lines of folder/labels.csv, whose columns are file, label and optionally tag, parted as records are.

    Raises `RecordError` where the file is missing, has other columns or labels, one of them twice, or more cells in a
    line, names a file twice (however it is written), or one that is not in the folder or below it.
    """
    from workbench.record.text import delimiter

    path = folder / "labels.csv"
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            text = stream.readlines()
            reader = csv.DictReader(text, delimiter=delimiter(text[0] if text else ""))
            rows = [(reader.line_num, row) for row in reader]
            columns = [(name or "").strip().casefold() for name in reader.fieldnames or ()]
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RecordError(f"{path}: cannot be read ({reason}); it must be a CSV file with columns file,label") from None
    for needed in ("file", "label"):
        if needed not in columns:
            given = ", ".join(columns) or "nothing"
            raise RecordError(f"{path}: no column {needed!r}; it has {given}; file and label are needed, tag may be")
    for name in ("file", "label", "tag"):
        if columns.count(name) > 1:
            raise RecordError(f"{path}: {columns.count(name)} columns {name!r}; it must have one")
    lines: list[Labelled] = []
    known: dict[Path, int] = {}
    # Without following links: records may lie elsewhere and be linked here.
    inside = os.path.normpath(folder.absolute())
    for number, row in rows:
        cells = {name.strip().casefold(): cell.strip() for name, cell in row.items() if name and cell}
        name, label = cells.get("file", ""), cells.get("label", "")
        if not name and not label:
            continue
        where = f"{path}:{number}"
        if any(row.get(None, ())):
            raise RecordError(
                f"{where}: {len(columns) + len(row[None])} cells given; its columns are {', '.join(columns)}"
            )
        if label not in LABELS:
            raise RecordError(f"{where}: label {label!r} given; must be stiction or no_stiction")
        record = folder / name
        if not name or not record.is_file() or not Path(os.path.normpath(record.absolute())).is_relative_to(inside):
            raise RecordError(f"{where}: file {name!r} is not in {folder}")
        other = known.setdefault(record.resolve(), number)
        if other != number:
            raise RecordError(f"{where}: file {name!r} is labelled twice; it stands already in line {other}")
        lines.append(Labelled(record, label, cells.get("tag", "") or name, name))
    if not lines:
        raise RecordError(f"{path}: names no record; each line must hold a file and its label")
    return lines


def score(lines: list[Labelled], progress: Callable[[str, float], None] | None = None) -> list[Scored]:
    """Return each record's verdict beside its label; a record that cannot be used counts as undecided."""
    done = []
    for i, line in enumerate(lines):
        if progress is not None:
            progress(line.file, i / len(lines))
        done.append(_one(line))
    return done


def _one(line: Labelled) -> Scored:
    from time import perf_counter

    from workbench.estimate.estimate import estimate
    from workbench.record.reader import read_record

    start = perf_counter()
    try:
        found: Estimate | None = estimate(read_record(line.path))
        error = ""
    except RecordError as refusal:
        found, error = None, _ADVICE.sub(_RENAME, str(refusal))
    seconds = perf_counter() - start
    plant = None if found is None else found.plant
    return Scored(
        file=line.file,
        tag=line.tag,
        label=line.label,
        verdict="undecided" if found is None else found.verdict,
        S=math.nan if found is None else found.valve.stick_band,
        J=math.nan if found is None else found.valve.slip_jump,
        gain=math.nan if plant is None else plant.gain,
        time_constant=float(getattr(plant, "time_constant", math.nan)),
        dead_time=math.nan if plant is None else plant.dead_time,
        error=error,
        seconds=seconds,
    )


def score_content(scored: list[Scored]) -> dict[str, Any]:
    """Return accuracy (undecided counts as wrong), accuracy by tag, confusion and loops, as score.json holds them.

    By tag: more than half of its records' verdicts must be its label, a tie is wrong. A tag whose records have both
    labels, as of a valve before and after its repair, is two. confusion: label to verdict to count. Times are not in
    it: the file is the same from run to run.
    """
    tags: dict[tuple[str, str], list[str]] = {}
    for one in scored:
        tags.setdefault((one.tag, one.label), []).append(one.verdict)
    by_tag = [2 * verdicts.count(label) > len(verdicts) for (_, label), verdicts in tags.items()]
    confusion = {label: dict.fromkeys(VERDICTS, 0) for label in LABELS}
    for one in scored:
        confusion[one.label][one.verdict] += 1
    loops = [
        {
            "file": one.file,
            "tag": one.tag,
            "label": one.label,
            "verdict": one.verdict,
            "S": _number(one.S),
            "J": _number(one.J),
            "K": _number(one.gain),
            "tau": _number(one.time_constant),
            "theta": _number(one.dead_time),
            "error": one.error,
        }
        for one in scored
    ]
    return {
        "accuracy": sum(one.verdict == one.label for one in scored) / len(scored),
        "accuracy_by_tag": sum(by_tag) / len(by_tag),
        "records": len(scored),
        "tags": len(tags),
        "confusion": confusion,
        "loops": loops,
    }


def _number(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None


def write_score(content: dict[str, Any], out: Path) -> Path:
    """Write OUT/score.json whole; raises `OutputError` where that is not possible."""
    from workbench.report.files import write_files

    write_files({"score.json": json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"}, out)
    return out / "score.json"
