"""What is refused while a scenario is built: each refusal under the path of its entry."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from workbench.errors import InvalidValue
from workbench.scenario.document import Path

__all__ = ["Refusals", "in_entries", "one_line", "scalar"]

T = TypeVar("T")

# A mapping in the words of Python, in a reader's message, and its pairs.
_MAPPING = re.compile(r"\b(columns|tags)=\{([^}]*)\}")
_PAIR = re.compile(r"'([\w ]+)': (?:'([^']*)'|\"([^\"]*)\")")
# What YAML reads as text without quotes, and as nothing else.
_BARE = re.compile(r"[A-Za-z](?:[\w./ -]*[\w.])?")
_MEANT = re.compile(r"(?i:true|false|yes|no|on|off|null|y|n)")

# Entries that the file calls otherwise than the model does.
_NAMES = {"values": "series", "positions": "places", "valves": "places"}
_FIELD = re.compile(r"[A-Za-z]+\.([A-Za-z_]+(?:\.[A-Za-z_]+)*)(?:\[([0-9]+)\])?")


@dataclass
class Refusals:
    """Collects (path, text)."""

    issues: list[tuple[Path, str]] = field(default_factory=list)

    def refuse(self, path: Path, text: str) -> None:
        """Note one refusal."""
        self.issues.append((path, text))

    def attempt(self, path: Path, make: Callable[[], T]) -> T | None:
        """Return what `make` makes, or None after noting why the model refuses it, under the entry of its field."""
        try:
            return make()
        except InvalidValue as error:
            match = _FIELD.fullmatch(error.where)
            under: Path = ()
            if match is not None:
                names = [_NAMES.get(name, name) for name in match[1].split(".")]
                under = (*names, *([int(match[2])] if match[2] else []))
            self.refuse(path + under, f"{error.given} given; {error.allowed}")
            return None


def one_line(error: Exception) -> str:
    """Return an error's text on one line."""
    return " ".join(str(error).split())


def in_entries(message: str) -> str:
    """Return a reader's message with the entries of a scenario or manifest in place of the arguments of Python."""

    def entries(found: re.Match[str]) -> str:
        pairs = [f"{signal}: {scalar(plain or quoted)}" for signal, plain, quoted in _PAIR.findall(found[2])]
        return f"{found[1]}: {{{', '.join(pairs)}}}"

    return _MAPPING.sub(entries, message.replace("give sample_time in seconds", "give sample_time, such as 5 s"))


def scalar(text: str) -> str:
    """Return a name as YAML takes it for text."""
    bare = _BARE.fullmatch(text) and not _MEANT.fullmatch(text)
    return text if bare else json.dumps(text, ensure_ascii=False)
