"""The manifest: a site's loops with what is known of each, as YAML or as CSV with a line per loop.

YAML: `title`, `data` (tall Parquet that tags refer to, a file of many loops, or a folder of such), `depth`, and
`loops`, each with a `name` and any of `file`, `tags`, `columns`, `pv_range`, `op_range`, `sample_time`, `max_gap`,
`plant`, `Kc`, `Ti`, `Td`, `form`, `criticality`, `area`. CSV: the same names as columns, PV, OP, SP, MODE for tags,
pv_low, pv_high, op_low, op_high.
Paths are looked for beside the manifest.
"""

from __future__ import annotations

import csv
from bisect import bisect
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from workbench.errors import InvalidValue, RecordError, ScenarioError
from workbench.fleet.loops import Sources, all_tags, loops_in, of_tags, tagged, tags_in
from workbench.model.checks import reads_as_number
from workbench.model.fleet import LoopSource, Tuning
from workbench.record.historian import Pieces, tags_of
from workbench.record.names import TAGGED
from workbench.scenario import units
from workbench.scenario.document import Node, Problem, locate, nearest, parse, plain, spell
from workbench.scenario.wrong import given_words, refusal

__all__ = ["Manifest", "is_manifest", "read_manifest"]

MOST = 50  # mistakes told at once
NEAR = 3  # tags named on either side of one that is not there
LARGEST = 64 << 20  # bytes
SIGN = "Kc is positive, and the sign of the process gain, which the data show, decides the action"


def _time(value: object) -> float:
    return units.time(value)


def _integral(value: object) -> float:
    return units.integral_time(value)


def _gain(value: object) -> float:
    gain = units.bare(value)
    if gain <= 0.0:
        raise InvalidValue("Kc", gain, f"must be above 0: {SIGN}")
    return gain


def _ascending(span: tuple[float, float]) -> tuple[float, float]:
    if not span[0] < span[1]:
        raise ValueError(f"[{span[0]:g}, {span[1]:g}] given; must be [low, high] with low < high")
    return span


Name = Annotated[str, Field(min_length=1, max_length=200, pattern=r"\S")]
Time = Annotated[float, BeforeValidator(_time), Field(gt=0.0)]
Span = Annotated[tuple[float, float], AfterValidator(_ascending)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Entry(_Strict):
    """One loop of a manifest."""

    name: Name
    file: Name | None = None
    tags: dict[str, Name] | None = None
    columns: dict[str, Name] | None = None
    pv_range: Annotated[Span | None, Field(strict=False)] = None
    op_range: Annotated[Span | None, Field(strict=False)] = None
    sample_time: Time | None = None
    max_gap: Time | None = None
    plant: Literal["fopdt", "integrating", "auto"] = "auto"
    Kc: Annotated[float, BeforeValidator(_gain), Field(gt=0.0)] | None = None
    Ti: Annotated[float, BeforeValidator(_integral), Field(gt=0.0)] | None = None
    Td: Annotated[float, BeforeValidator(_time), Field(ge=0.0)] = 0.0
    form: Literal["ideal", "series", "parallel"] = "ideal"
    criticality: Annotated[int, Field(ge=1, le=5)] | None = None
    area: Name | None = None

    @model_validator(mode="after")
    def _whole_tuning(self) -> Entry:
        if (self.Kc is None) != (self.Ti is None):
            there, missing = ("Kc", "Ti") if self.Ti is None else ("Ti", "Kc")
            raise ValueError(
                f"{there} given without {missing}; the present tuning needs both (Ti: none without integral)"
            )
        return self


class Manifest(_Strict):
    """A manifest as a whole."""

    title: Name | None = None
    data: Name | None = None
    depth: Literal["screen", "estimate", "tune"] | None = None
    loops: Annotated[list[Entry], Field(min_length=1)]


@dataclass(frozen=True, eq=False)
class _Given:
    """A manifest read: its content, and where each loop stands in the file, in words."""

    content: Manifest
    places: list[str]


def is_manifest(path: Path) -> bool:
    """Whether a file is a manifest of loops and no scenario of one: CSV, or YAML with an entry `loops`."""
    if path.suffix.lower() == ".csv":
        return path.is_file()
    try:
        # Anything else that is odd is for the scenario loader to say.
        text = path.read_text(encoding="utf-8-sig") if path.is_file() and path.stat().st_size <= LARGEST else ""
    except (OSError, ValueError):
        return False
    if "\nloops:" not in f"\n{text}":
        return False
    root, _ = parse(text)
    return root is None or (root.entries is not None and "loops" in root.entries)


def read_manifest(path: Path) -> Sources:
    """Return the loops of a manifest, sorted by name, and of its data set where it names no tags.

    Raises `ScenarioError` with a line for each mistake, `file:line:column: where: what, what is allowed`. A file or tag
    that is not there, and a name given twice, concern their loop alone: it is refused when its turn comes.
    """
    given = _from_csv(path) if path.suffix.lower() == ".csv" else _from_yaml(path)
    content, folder = given.content, path.parent
    tags, known = _data(content, folder, path)
    many = Counter(entry.name for entry in content.loops)
    loops: dict[str, LoopSource] = {}
    for entry, place in zip(content.loops, given.places, strict=True):
        if entry.name in loops:
            continue
        if many[entry.name] > 1:
            places = [p for e, p in zip(content.loops, given.places, strict=True) if e.name == entry.name]
            refusal = f"{path}: {many[entry.name]} loops have this name ({', '.join(places)}); each needs its own"
            loops[entry.name] = LoopSource(entry.name, refusal=refusal)
            continue
        loops[entry.name] = _loop(entry, folder, tags, known, f"{path}: {place}")
    title = content.title or path.stem.replace("_", " ")
    return Sources(title, str(path), tuple(loops[name] for name in sorted(loops)), content.depth)


def _data(content: Manifest, folder: Path, path: Path) -> tuple[dict[str, Pieces], dict[str, LoopSource]]:
    """Return the tags of the manifest's data set and the loops that they tell by themselves."""
    if content.data is None:
        return {}, {}
    data = folder / content.data
    if not data.exists():
        raise ScenarioError(f"{path}: data: {content.data} given; no such file or folder beside the manifest")
    if data.is_dir():
        tags = all_tags(data)
        if not tags and not loops_in(data)[0]:
            raise ScenarioError(
                f"{path}: data: {content.data} given; holds no tall Parquet file and none of many loops"
            )
    else:
        tags = tags_in(data)
        try:
            tags = tags or tags_of(data)
        except RecordError as error:
            raise ScenarioError(f"{path}: data: {error}") from None
    return tags, tagged(tags)


def _not_there(given: Mapping[str, str], tags: Mapping[str, Pieces], place: str) -> str:
    """Return in words which tags are not in the data, and what is there beside them; nothing where all are."""
    there, wrong = sorted(tags), []
    for signal, tag in given.items():
        if tag not in tags:
            at = max(bisect(there, tag) - NEAR, 0)
            beside = ", ".join(map(repr, there[at : at + 2 * NEAR]))
            wrong.append(f"tag {tag!r} of {signal} is not in the data; nearest in its order: {beside}")
    return f"{place}: {'; '.join(wrong)}" if wrong else ""


def _loop(entry: Entry, folder: Path, tags: dict[str, Pieces], known: dict[str, LoopSource], place: str) -> LoopSource:
    if entry.file is not None:
        file = folder / entry.file
        loop = LoopSource(
            entry.name,
            str(file),
            columns=tuple((entry.columns or {}).items()),
            tags=tuple((entry.tags or {}).items()),
            refusal="" if file.is_file() else f"{place}: file {entry.file} is not there",
        )
    elif entry.tags is not None and not tags:
        loop = LoopSource(
            entry.name, refusal=f"{place}: tags are given, but neither a file nor a data set that has them"
        )
    elif entry.tags is not None:
        loop = of_tags(entry.name, dict(entry.tags), tags, _not_there(entry.tags, tags, place))
    else:
        loop = known.get(
            entry.name, LoopSource(entry.name, refusal=f"{place}: no file, no tags, and no tag of this name")
        )
    tuning = None
    if entry.Kc is not None and entry.Ti is not None:
        tuning = Tuning(entry.Kc, entry.Ti, entry.Td, entry.form)
    return replace(
        loop,
        sample_time=entry.sample_time,
        pv_range=entry.pv_range,
        op_range=entry.op_range,
        max_gap=entry.max_gap,
        plant=entry.plant,
        tuning=tuning,
        area=entry.area or loop.area,
        criticality=entry.criticality or 0,
    )


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST:
            raise ScenarioError(
                f"{path}: larger than {LARGEST >> 20} MiB; a manifest is a list of loops, not their data"
            )
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no UTF-8 text"
        raise ScenarioError(f"{path}: cannot be read ({reason})") from None


def _from_yaml(path: Path) -> _Given:
    root, problems = parse(_text(path), "manifest", "title, data, depth, loops ...")
    if root is None:
        raise ScenarioError("\n".join(f"{path}:{p.line}:{p.column}: {p.where}: {p.text}" for p in problems))
    found = list(problems)
    content: Manifest | None = None
    try:
        content = Manifest.model_validate(plain(root))
    except ValidationError as error:
        found += [_problem(root, one) for one in error.errors(include_url=False)]
    if found or content is None:
        # Of two loops of one name a readable manifest leaves out these alone; beside other mistakes they are told.
        found += _twice(root)
        said = [f"{path}:{p.line}:{p.column}: {p.where}: {p.text}" for p in sorted(set(found), key=_place)]
        raise ScenarioError("\n".join(said[:MOST]))
    places = []
    for i in range(len(content.loops)):
        node, _ = locate(root, ("loops", i))
        places.append(f"line {node.line}")
    return _Given(content, places)


def _place(problem: Problem) -> tuple[int, int, str]:
    return problem.line, problem.column, problem.text


def _problem(root: Node, error: Any) -> Problem:
    """Return a refusal by the schema at its place in the file."""
    kind, path = error["type"], tuple(error["loc"])
    node, taken = locate(root, path, key=kind == "extra_forbidden")
    if kind == "missing":
        # What is missing has no place of its own; of a pair it is the second number.
        pair = isinstance(path[-1], int)
        text = f"{given_words(node)} given; must be two numbers, [low, high]" if pair else f"{path[-1]} is missing"
    elif kind == "extra_forbidden":
        text = _unknown(path[-1], Entry if len(path) > 1 else Manifest)
    else:
        text = refusal(node, error)
    return Problem(node.line, node.column, spell(taken) if taken else "manifest", text)


def _unknown(name: object, model: type[BaseModel]) -> str:
    allowed = tuple(model.model_fields)
    if name == "action" and model is Entry:
        return f"unknown entry 'action', which is to be left out: {SIGN}"
    return f"unknown entry {name!r}{nearest(name, allowed)}; allowed: {', '.join(allowed)}"


def _twice(root: Node) -> list[Problem]:
    """Return the loops whose name another one above them has."""
    loops, _ = locate(root, ("loops",))
    first: dict[str, int] = {}
    found = []
    for i, loop in enumerate(loops.items or ()):
        name, taken = locate(loop, ("name",))
        if taken and first.setdefault(name.text, i) != i:
            where = spell(("loops", i, "name"))
            text = f"{given_words(name)} given; loops[{first[name.text]}] has this name already"
            found.append(Problem(name.line, name.column, where, text))
    return found


_TEXTS = ("name", "file", "plant", "form", "area")
_NUMBERS = ("Kc", "Ti", "Td", "sample_time", "max_gap")
_PAIRS = {"pv_range": ("pv_low", "pv_high"), "op_range": ("op_low", "op_high")}


def _from_csv(path: Path) -> _Given:
    reader = csv.DictReader(_text(path).splitlines(), skipinitialspace=True)
    known = (*_TEXTS, *_NUMBERS, "criticality", *TAGGED, *(name for pair in _PAIRS.values() for name in pair))
    folded = {name.casefold(): name for name in known}
    header = [(name or "").strip() for name in reader.fieldnames or ()]
    if len(header) == 1 and ";" in header[0]:
        raise ScenarioError(f"{path}:1:1: its cells stand between semicolons; a manifest's stand between commas")
    twice_there = [name for name, many in Counter(name.casefold() for name in header).items() if many > 1]
    if twice_there:
        raise ScenarioError(f"{path}:1:1: column {twice_there[0]!r} is there twice")
    wrong = [name for name in header if name.casefold() not in folded]
    if "name" not in {name.casefold() for name in header} or wrong:
        if wrong and wrong[0].casefold() == "action":
            raise ScenarioError(f"{path}:1:1: unknown column 'action', which is to be left out: {SIGN}")
        words = f"unknown column {wrong[0]!r}{nearest(wrong[0], known)}" if wrong else "no column 'name'"
        raise ScenarioError(f"{path}:1:1: {words}; a manifest has a line per loop, with columns of {', '.join(known)}")
    said: list[tuple[int, str]] = []
    twice: list[tuple[int, str]] = []  # told beside other mistakes; alone they concern these loops only
    first: dict[str, int] = {}
    entries: list[Entry] = []
    places: list[str] = []
    for row in reader:
        cells = {
            folded[k.strip().casefold()]: v.strip() for k, v in row.items() if k and isinstance(v, str) and v.strip()
        }
        if not cells:
            continue
        line = reader.line_num
        if None in row:
            said.append((line, "more cells than columns"))
            continue
        try:
            entries.append(Entry.model_validate(_cells(cells)))
            places.append(f"line {line}")
        except InvalidValue as error:
            said.append((line, str(error)))
        except ValidationError as error:
            for one in error.errors(include_url=False):
                where = str(one["loc"][-1 if one["loc"][0] == "tags" else 0]) if one["loc"] else "line"
                cell = cells.get(where, "")
                missing = one["type"] == "missing"
                text = "missing; it must be given" if missing else refusal(Node(line, 1, cell, cell), one)
                said.append((line, f"{where}: {text}"))
        name = cells.get("name", "")
        if name and first.setdefault(name, line) != line:
            twice.append((line, f"name: {name} given; line {first[name]} has this name already"))
    if not entries and not said:
        said.append((2, "no loop; a manifest has a line per loop"))
    if said:
        told = sorted(said + twice, key=lambda one: one[0])[:MOST]
        raise ScenarioError("\n".join(f"{path}:{line}:1: {text}" for line, text in told))
    return _Given(Manifest(loops=entries), places)


def _cells(cells: dict[str, str]) -> dict[str, Any]:
    """Return a CSV line's cells as the entries of a loop. Raises `InvalidValue`."""
    out: dict[str, Any] = {name: cells[name] for name in _TEXTS if name in cells}
    for name in ("Ti", "Td", "sample_time", "max_gap"):
        if name in cells:
            # A bare number of a column is in seconds, as the column's unit is.
            out[name] = f"{cells[name]} s" if reads_as_number(cells[name]) else cells[name]
    if "Kc" in cells:
        out["Kc"] = _number("Kc", cells["Kc"])
    if "criticality" in cells:
        value = _number("criticality", cells["criticality"])
        out["criticality"] = int(value) if value.is_integer() else value
    for name, (low, high) in _PAIRS.items():
        if low in cells or high in cells:
            if low not in cells or high not in cells:
                raise InvalidValue(name, "one end", f"needs both {low} and {high}")
            out[name] = (_number(low, cells[low]), _number(high, cells[high]))
    tags = {signal: cells[signal] for signal in TAGGED if signal in cells}
    if tags:
        out["tags"] = tags
    return out


def _number(name: str, text: str) -> float:
    if not reads_as_number(text):
        raise InvalidValue(name, text, "must be a number")
    return float(text)
