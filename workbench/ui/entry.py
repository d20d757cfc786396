"""What an entry of the page is: its label, units, choices and where it shows; and entries under one heading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["SECONDS", "WRITTEN", "Field", "Group"]

SECONDS = ("s", "min", "h")
# Units that a scenario writes behind a number; every other one is the only one that its entry can have.
WRITTEN = frozenset({*SECONDS, "ms", "%", "%/%", "repeats/min"})


@dataclass(frozen=True, slots=True)
class Field:
    """One entry. units: to choose from, () for none. choices: (value, words), () for what is typed.

    otherwise: (another entry, a value of it, the unit that this one has then in place of its own).

    slider: "log" (even ratios), "linear" or "" for none; reach: how far a linear one goes from 0 at least, to both
    sides where it is signed. when: the entry shows where another has one of these values.
    flag: a yes or no. whole: a whole number, which keys step by 1. rows: lines of a longer text, 0 for one line.
    hint: shown under the field's name.
    more: few loops have it; it shows where its group is opened further, or where it is used.
    """

    path: str
    label: str
    default: str
    units: tuple[str, ...] = ()
    otherwise: tuple[str, str, str] | None = None
    choices: tuple[tuple[str, str], ...] = ()
    slider: str = ""
    reach: float = 1.0
    signed: bool = False
    when: tuple[str, tuple[str, ...]] | None = None
    flag: bool = False
    whole: bool = False
    rows: int = 0
    hint: str = ""
    more: bool = False

    def units_in(self, entries: Mapping[str, str]) -> tuple[str, ...]:
        """Return the units that it has beside these entries."""
        if self.otherwise is not None and entries.get(self.otherwise[0]) == self.otherwise[1]:
            return self.otherwise[2:]
        return self.units

    @property
    def of(self) -> str:
        """Which kind of scenario alone has it: "loop", "cascade", or "" for both."""
        outer = ("cascade.", "tune_cascade.", "experiment.primary_load.", "experiment.secondary_noise.")
        if self.path.startswith(outer):
            return "cascade"
        shared = ("tune.digits", "tune.restarts", "tune.seed")
        return "loop" if self.path.startswith(("loop.", "tune.")) and self.path not in shared else ""


@dataclass(frozen=True, slots=True)
class Group:
    """Fields under one heading."""

    name: str
    title: str
    fields: tuple[Field, ...]

    @property
    def of(self) -> str:
        """Which kind of scenario alone has the group, or "" for both."""
        kinds = {field.of for field in self.fields}
        return kinds.pop() if len(kinds) == 1 else ""
