"""YAML text as a tree in which every key and value knows its line and column.

Built from ruamel's parse events rather than by its constructors, so that nothing in a file can build an object, grow
without bound (aliases) or recurse: depth and size are counted while the tree grows. Plain scalars follow the YAML 1.2
core schema, whatever a %YAML directive says: `on` and `yes` are text, `1e-3` is a number.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)
from ruamel.yaml.reader import ReaderError

__all__ = [
    "MAX_DEPTH",
    "MAX_VALUES",
    "Node",
    "Path",
    "Problem",
    "closest",
    "locate",
    "nearest",
    "parse",
    "plain",
    "spell",
]

MAX_DEPTH = 24
MAX_VALUES = 200_000

Path = tuple[str | int, ...]

_INT = re.compile(r"[-+]?[0-9]{1,300}|0o[0-7]{1,60}|0x[0-9a-fA-F]{1,60}")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_SPECIAL = {".nan": float("nan"), ".NaN": float("nan"), ".NAN": float("nan")}
_SPECIAL |= {sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in (".inf", ".Inf", ".INF")}
_CONSTANTS: dict[str, object] = {"": None, "~": None}
_CONSTANTS |= dict.fromkeys(("null", "Null", "NULL"))
_CONSTANTS |= dict.fromkeys(("true", "True", "TRUE"), True)
_CONSTANTS |= dict.fromkeys(("false", "False", "FALSE"), False)


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a file: where it stands (from 1), which entry it is in, and the words."""

    line: int
    column: int
    where: str
    text: str


@dataclass(slots=True, eq=False)
class Node:
    """A value of the file: a scalar, a list of nodes, or a mapping of keys to (key's node, value's node).

    text: as written, for messages. size and depth count what stands under the node with aliases expanded.
    """

    line: int
    column: int
    value: object
    text: str = ""
    items: list[Node] | None = None
    entries: dict[str, tuple[Node, Node]] | None = None
    size: int = 1
    depth: int = 1
    key: Node | None = field(default=None, repr=False)

    def children(self) -> Iterator[Node]:
        """The nodes right under this one."""
        if self.items is not None:
            yield from self.items
        if self.entries is not None:
            for _, value in self.entries.values():
                yield value


class _Stop(Exception):
    """Reading cannot go on."""

    def __init__(self, line: int, column: int, text: str) -> None:
        self.line, self.column, self.text = line, column, text


def parse(
    text: str, kind: str = "scenario", holds: str = "title, loop, cases ..."
) -> tuple[Node | None, list[Problem]]:
    """Return the tree of one YAML document and what is wrong with it; None where nothing could be read.

    kind: what the document is, for messages: `scenario` or `manifest`. holds: its entries.
    """
    builder = _Builder(kind)

    def stopped(line: int, column: int, text: str) -> tuple[None, list[Problem]]:
        return None, [*builder.problems, Problem(line, column, kind, text)]

    reader = YAML(typ="safe", pure=True)
    try:
        for event in reader.parse(text):
            builder.take(event)
    except _Stop as stop:
        return stopped(stop.line, stop.column, stop.text)
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        column = error.position - (text.rfind("\n", 0, error.position) + 1) + 1
        return stopped(line, column, f"the character {ascii(chr(error.character))[1:-1]} is not allowed in YAML")
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = " ".join(str(part) for part in (error.context, error.problem) if part) or "cannot be read"
        line, column = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
        return stopped(line, column, f"not valid YAML: {' '.join(what.split())}")
    except (YAMLError, ValueError, LookupError, TypeError, AttributeError, AssertionError, RecursionError) as error:
        # The parser meets some malformed input with errors of its own making, which carry no position.
        return stopped(1, 1, f"not valid YAML: {' '.join(str(error).split())[:200]}")
    if builder.root is None and not builder.problems:
        return stopped(1, 1, f"the file is empty; must hold a mapping with {holds}")
    return builder.root, builder.problems


class _Builder:
    """Grows the tree from events, with an explicit stack."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.root: Node | None = None
        self.problems: list[Problem] = []
        self.stack: list[Node] = []
        self.open_anchors: list[str | None] = []
        self.anchors: dict[str, Node] = {}
        self.documents = 0
        self.values = 0

    def take(self, event: Event) -> None:
        """Take the next event."""
        if isinstance(event, DocumentStartEvent):
            self.documents += 1
            if self.documents > 1:
                raise _Stop(*_at(event), f"a second document begins; a {self.kind} is one document")
        elif isinstance(event, MappingEndEvent | SequenceEndEvent):
            node = self.stack.pop()
            anchor = self.open_anchors.pop()
            if node.entries is not None:
                self._merge(node)
            self._measure(node)
            if anchor is not None:
                self.anchors[anchor] = node
            self._put(node)
        elif isinstance(event, AliasEvent):
            target = self.anchors.get(event.anchor)
            if target is None:
                raise _Stop(*_at(event), f"*{event.anchor} refers to no value above it")
            self._put(target)
        elif isinstance(event, NodeEvent):
            self._begin(event)

    def _begin(self, event: NodeEvent) -> None:
        line, column = _at(event)
        tag = getattr(event, "tag", None)
        if tag is not None:
            self._note(line, column, f"the tag {_clip(str(tag))} given; tags are not allowed")
        self.values += 1
        if self.values > MAX_VALUES:
            raise _Stop(line, column, f"more than {MAX_VALUES:,} values; that is no {self.kind}")
        if isinstance(event, ScalarEvent):
            implicit = event.style in (None, "")
            text = event.value
            if not text.isascii():
                try:
                    # JSON writes characters beyond 16 bits as pairs of escapes, which YAML leaves in halves.
                    text = text.encode("utf-16", "surrogatepass").decode("utf-16")
                except UnicodeDecodeError:
                    raise _Stop(line, column, "an escape that is half of a character; \\u needs its pair") from None
            node = Node(line, column, _scalar(text) if implicit else text, text)
            if event.anchor is not None:
                self.anchors[event.anchor] = node
            self._put(node)
            return
        if len(self.stack) >= MAX_DEPTH:
            raise _Stop(line, column, f"nested more than {MAX_DEPTH} levels deep; that is no {self.kind}")
        node = Node(line, column, None)
        if isinstance(event, MappingStartEvent):
            node.entries = {}
        elif isinstance(event, SequenceStartEvent):
            node.items = []
        self.stack.append(node)
        self.open_anchors.append(event.anchor)

    def _put(self, node: Node) -> None:
        if not self.stack:
            self.root = node
            return
        parent = self.stack[-1]
        if parent.items is not None:
            parent.items.append(node)
        elif parent.key is None:
            if node.entries is not None or node.items is not None:
                raise _Stop(node.line, node.column, "a mapping or list given as a key; keys are plain names")
            parent.key = node
        else:
            key, parent.key = parent.key, None
            entries = parent.entries
            if entries is None:
                return
            if key.text in entries:
                first = entries[key.text][0]
                what = f"the key {_clip(key.text)} is given twice; it stands already in line {first.line}"
                self._note(key.line, key.column, what)
                return
            entries[key.text] = (key, node)

    def _note(self, line: int, column: int, text: str) -> None:
        self.problems.append(Problem(line, column, self.kind, text))

    def _merge(self, node: Node) -> None:
        """Take over the entries of `<<: *other` that the mapping does not hold itself."""
        entries = node.entries
        if entries is None or "<<" not in entries:
            return
        _, source = entries.pop("<<")
        for other in source.items if source.items is not None else [source]:
            if other.entries is None:
                what = "<< takes a mapping or a list of mappings"
                self._note(source.line, source.column, what)
                return
            for name, entry in other.entries.items():
                entries.setdefault(name, entry)

    def _measure(self, node: Node) -> None:
        for child in node.children():
            node.size += child.size
            node.depth = max(node.depth, child.depth + 1)
        if node.size > MAX_VALUES:
            raise _Stop(node.line, node.column, f"more than {MAX_VALUES:,} values once its aliases are written out")
        if node.depth > MAX_DEPTH:
            raise _Stop(node.line, node.column, f"nested more than {MAX_DEPTH} levels deep; that is no {self.kind}")


def _at(event: Event) -> tuple[int, int]:
    return event.start_mark.line + 1, event.start_mark.column + 1


def _scalar(text: str) -> object:
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if text in _SPECIAL:
        return _SPECIAL[text]
    if _INT.fullmatch(text):
        base = {"0o": 8, "0x": 16}.get(text[:2], 10)
        return int(text, base)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


def plain(node: Node) -> object:
    """Return the node as plain dictionaries, lists and scalars."""
    if node.items is not None:
        return [plain(item) for item in node.items]
    if node.entries is not None:
        return {name: plain(value) for name, (_, value) in node.entries.items()}
    return node.value


def locate(root: Node, path: Path, *, key: bool = False) -> tuple[Node, Path]:
    """Return the node that stands nearest above or at `path`, and the path's elements that lead to it.

    Elements that lead nowhere are passed over where a later one leads on: an index 0 into a mapping that stands for
    a list of one, and the names in <> of a variant. With `key` the last element's key is returned, not its value.
    """
    node = root
    taken: list[str | int] = []
    for i, element in enumerate(path):
        if node.entries is not None and isinstance(element, str) and element in node.entries:
            name, value = node.entries[element]
            node = name if key and i == len(path) - 1 else value
            taken.append(element)
        elif node.items is not None and isinstance(element, int) and 0 <= element < len(node.items):
            node = node.items[element]
            taken.append(element)
    return node, tuple(taken)


def spell(path: Path) -> str:
    """Return a path in words: `cases[2].tune.bounds.Kc`."""
    words = ""
    for element in path:
        if isinstance(element, int):
            words += f"[{element}]"
        else:
            words += ("." if words else "") + _clip(element)
    return words or "scenario"


# What other books and systems call an entry or a choice, and how its value is had from theirs.
_ALSO_CALLED = {
    "kp": ("Kc", ""),
    "p": ("Kc", ""),
    "ki": ("Ti", ", Kc/Ki, in parallel form 1/Ki"),
    "kd": ("Td", ", Kd/Kc, in parallel form Kd"),
    "pb": ("proportional_band", ""),
    "tau": ("time_constant", ""),
    "theta": ("dead_time", ""),
    "delay": ("dead_time", ""),
    "k": ("gain", ""),
    "ts": ("sample_time", ""),
    "dt": ("sample_time", ""),
    "sp": ("setpoint", ""),
    "length": ("duration", ""),
    "ms": ("max_sensitivity", ""),
    "standard": ("ideal", ""),
    "isa": ("ideal", ""),
    "noninteracting": ("ideal", ""),
    "interacting": ("series", ""),
    "classical": ("series", ""),
}


def nearest(name: object, allowed: tuple[str, ...]) -> str:
    """Return ` (did you mean x?)` for the allowed name that means or looks most like the given one, else nothing."""
    close = closest(name, allowed)
    known, how = _ALSO_CALLED.get(str(name).casefold(), ("", ""))
    return f" (did you mean {close}{how if known == close else ''}?)" if close else ""


def closest(name: object, allowed: tuple[str, ...]) -> str:
    """Return the allowed name that means the same as the given one, or looks most like it, "" where none does."""
    if not isinstance(name, str):
        return ""
    known = _ALSO_CALLED.get(name.casefold(), ("", ""))[0]
    if known in allowed:
        return known
    by_folded = {candidate.casefold(): candidate for candidate in allowed}
    close = get_close_matches(name.casefold()[:80], list(by_folded), n=1, cutoff=0.6)
    return by_folded[close[0]] if close else ""


def _clip(text: str) -> str:
    """Return text fit for one line of a message."""
    shown = text if text.isprintable() else ascii(text)[1:-1]
    return shown if len(shown) <= 60 else shown[:57] + "..."
