"""`load_scenario`: a scenario file to a checked `Scenario`, or one `ScenarioError` with a line for each thing wrong.

Each line reads `file:line:column: where: what is wrong, what is allowed`. Nothing of a file is run or written here.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path as FilePath
from typing import Any

from pydantic import ValidationError

from workbench.errors import ScenarioError
from workbench.model.checks import file_name
from workbench.scenario import units
from workbench.scenario.build import Builder
from workbench.scenario.cascade import cascade_scenario
from workbench.scenario.document import Node, Path, Problem, locate, nearest, parse, plain, spell
from workbench.scenario.element_entries import Elements
from workbench.scenario.mend import independent
from workbench.scenario.plan import Scenario
from workbench.scenario.schema import ScenarioFile, Tune, Tuning
from workbench.scenario.wrong import given_words, refusal

__all__ = ["LARGEST", "MANIFEST", "MOST_PROBLEMS", "load_scenario", "read_scenario", "refuse_manifest"]

LARGEST = 1 << 20  # bytes
MOST_PROBLEMS = 50
MANIFEST = "a manifest of many loops; `workbench fleet` or `workbench run` takes it"

CASE_KINDS = ("rule", "tune", *Tuning.model_fields)


def load_scenario(path: str | os.PathLike[str]) -> Scenario:
    """Return the scenario of a YAML file, checked in full, with the records that it names read.

    Data files are looked for beside the scenario. Raises `ScenarioError`: one line for each problem, up to 50, as
    `file:line:column: where: what is wrong, what is allowed`; and `InvalidValue` for what is no path.
    """
    shown = file_name(path, "a scenario file (YAML)")
    return read_scenario(_read(FilePath(path), shown), FilePath(path), shown)


def read_scenario(text: str, path: FilePath, shown: str | None = None) -> Scenario:
    """Return the scenario of YAML text as if it stood in the file `path` (which need not exist).

    shown: the file's name in messages. Raises `ScenarioError`.
    """
    shown = str(path) if shown is None else shown
    root, problems = parse(text)
    if root is None:
        raise _error(shown, problems)
    data = plain(root)
    refuse_manifest(data, shown)
    allowed: dict[int, tuple[str, ...]] = {}

    def place(entry: Path) -> str:
        node, taken = locate(root, entry)
        return f"{node.line}:{node.column}: {spell(taken)}"

    def build(given: ScenarioFile) -> tuple[Scenario | None, list[tuple[Path, str]]]:
        builder = Builder(path, text, place)
        cascade = given.cascade
        made = builder.scenario(given) if cascade is None else cascade_scenario(builder, given, cascade)
        return made, builder.refusals.issues

    try:
        given = ScenarioFile.model_validate(data, context=allowed)
    except ValidationError as error:
        problems += [_problem(root, data, allowed, one) for one in error.errors(include_url=False, include_input=True)]
        if len(problems) < MOST_PROBLEMS:
            problems += [_placed(root, where, what) for where, what in independent(root, lambda file: build(file)[1])]
        raise _error(shown, problems) from None
    scenario, refused = build(given)
    problems += [_placed(root, where, what) for where, what in refused]
    if scenario is None or problems:
        raise _error(shown, problems)
    return scenario


def refuse_manifest(data: object, shown: str) -> None:
    """Raise `ScenarioError` where a file's content is that of a site's manifest, which is none of a scenario."""
    if isinstance(data, dict) and isinstance(data.get("loops"), list):
        raise ScenarioError(f"{shown}: {MANIFEST}")


def _read(path: FilePath, shown: str) -> str:
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise ScenarioError(f"{shown}: is a directory; a scenario file (YAML) is needed")
        if not stat.S_ISREG(status.st_mode):
            raise ScenarioError(f"{shown}: is no regular file; a scenario file (YAML) is needed")
        if status.st_size > LARGEST:
            given = f"{status.st_size / 2**20:.1f} MiB"
            raise ScenarioError(
                f"{shown}: {given} given; a scenario file is at most 1 MiB (recorded data goes into a CSV)"
            )
        content = path.read_bytes()
    except ScenarioError:
        raise
    except FileNotFoundError:
        raise ScenarioError(f"{shown}: no such file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ScenarioError(f"{ascii(shown)[1:-1]}: cannot be read: {reason}") from None
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - (content.rfind(b"\n", 0, error.start) + 1) + 1
        what = f"byte 0x{content[error.start]:02x} is no UTF-8; a scenario is UTF-8 text"
        raise ScenarioError(f"{shown}:{line}:{column}: scenario: {what}") from None


def _error(shown: str, problems: list[Problem]) -> ScenarioError:
    """Return one error for all problems, in the order of the file and each said once."""
    unique = sorted(set(problems), key=lambda p: (p.line, p.column, p.where, p.text))
    lines = [f"{shown}:{p.line}:{p.column}: {p.where}: {p.text}" for p in unique[:MOST_PROBLEMS]]
    if len(unique) > MOST_PROBLEMS:
        lines.append(f"{shown}: and {len(unique) - MOST_PROBLEMS} more problems")
    return ScenarioError("\n".join(lines))


def _placed(root: Node, path: Path, text: str, *, key: bool = False) -> Problem:
    node, taken = locate(root, path, key=key)
    head, _ = locate(root, path, key=True)
    if given_words(node) == "nothing" and head.line < node.line:
        node = head  # nothing at a line's end is found where the next line begins
    if path[:1] == ("cases",) and taken[-1:] != path[-1:]:
        # A case inherits what loop.controller says; the refusal belongs where it is written.
        inherited = ("loop", "controller", *path[-1:])
        if locate(root, inherited)[1] == inherited:
            path = inherited
            node, taken = locate(root, path, key=key)
    rest = [e for e in path[-1:] if isinstance(e, str) and not e.startswith("<") and e not in taken[-1:]]
    return Problem(node.line, node.column, spell((*taken, *rest)), text)


def _problem(root: Node, data: object, allowed: dict[int, tuple[str, ...]], error: Any) -> Problem:
    """Return a refusal by the schema in our words, at its place in the file."""
    path: Path = tuple(e for e in error["loc"] if e != "[key]")
    kind = str(error["type"])
    is_key = error["loc"][-1:] == ("[key]",)
    node, _ = locate(root, path)
    if kind == "missing":
        return _placed(root, path, "missing; it must be given")
    if kind == "extra_forbidden":
        keys = allowed.get(id(_inside(data, path[:-1])), ())
        if units.is_quantity(path[-1]) and node.value is None:
            return _placed(root, path, f"no key, but the rest of a number? {units.COMMA_RULE}", key=True)
        near = nearest(path[-1], keys)
        if ":" in str(path[-1]) and str(path[-1]).partition(":")[0] in (*keys, *CASE_KINDS):
            near = " (a space must follow the colon)"
        elif not near and "tune" in keys and path[-1] in Tune.model_fields:
            near = " (write it inside tune)"
        elif not near and ("tune" in keys or "rule" in keys) and path[-1] in CASE_KINDS:
            near = " (a case holds Kc and Ti, or a rule, or tune)"
        elif path[:1] == ("cascade",) and path[-1] in Elements.model_fields:
            near = " (a single loop's; a cascade's are linear but for the valve and execute at every sample"
            near += ", and a plant gain of the other sign says fail-open)" if path[-1] == "fail_open" else ")"
        return _placed(root, path, f"unknown key{near}; allowed: {', '.join(keys)}", key=True)
    if kind == "variant":
        key, *variants = str(error["msg"]).split("|")
        return _variant(root, path, key, variants, node)
    return _placed(root, path, refusal(node, error), key=is_key and kind == "literal_error")


def _variant(root: Node, path: Path, key: str, variants: list[str], node: Node) -> Problem:
    names = ", ".join(variants)
    if node.entries is None and key == "name" and isinstance(node.value, str):
        return _placed(
            root, path, f"{given_words(node)} given{nearest(node.value, tuple(variants))}; must be one of {names}"
        )
    if node.entries is None:
        return _placed(root, path, f"{given_words(node)} given; must be a mapping with {_a(key, names)}")
    if not key:
        near = next((n for k in node.entries if (n := nearest(k, tuple(variants)))), "")
        return _placed(root, path, f"holds none of {names}{near}; one of these is needed")
    if key not in node.entries:
        return _placed(root, path, f"{key} is missing; must be one of {names}")
    value = node.entries[key][1]
    near = nearest(value.value, tuple(variants))
    return _placed(root, (*path, key), f"{given_words(value)} given{near}; must be one of {names}")


def _a(key: str, names: str) -> str:
    return f"{key} (one of {names})" if key else f"one of {names}"


def _inside(data: object, path: Path) -> object:
    """Return the value at a path of the plain data, walking as `locate` does."""
    for element in path:
        if (isinstance(data, dict) and element in data) or (
            isinstance(data, list) and isinstance(element, int) and 0 <= element < len(data)
        ):
            data = data[element]  # type: ignore[index]
    return data
