"""What is refused while a scenario is built: each refusal under the path of its entry."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from workbench.errors import InvalidValue
from workbench.scenario.document import Path

__all__ = ["Refusals", "one_line"]

T = TypeVar("T")

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
