"""The errors that Workbench raises for its user's mistakes, and nothing else.

Every message says what is wrong, where, what was given and what is allowed. Anything that is not a
`WorkbenchError` is a defect of the program.
"""

from __future__ import annotations

__all__ = ["InvalidValue", "OutputError", "RecordError", "ScenarioError", "SolveError", "WorkbenchError", "shown"]

LONGEST = 80  # characters of a value in a message


def shown(value: object) -> str:
    """Return a value for a message: on one line, and as its type's name where it takes more than 80 characters.

    A text that is longer is cut.
    """
    if isinstance(value, str):
        text = value if value.isprintable() else ascii(value)[1:-1]
        return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."
    try:
        text = " ".join(repr(value).split())
    except Exception:  # noqa: BLE001 - whatever the value's own type raises, a message must come out
        text = ""
    return text if 0 < len(text) <= LONGEST and text.isprintable() else type(value).__name__


class WorkbenchError(Exception):
    """Base of every error that a user can cause and mend."""


class InvalidValue(WorkbenchError, ValueError):
    """A value that its field does not allow.

    Attributes: `where` (the field, such as "FOPDT.time_constant"), `given` (the value as it is `shown`), `allowed`.
    """

    def __init__(self, where: str, given: object, allowed: str) -> None:
        self.where = where
        self.given = shown(given)
        self.allowed = allowed
        super().__init__(f"{where}: {self.given} given; {allowed}")


class RecordError(WorkbenchError, ValueError):
    """Recorded data that cannot be read or used; the message names the file, and the line and column where known."""


class ScenarioError(WorkbenchError, ValueError):
    """A scenario file that is refused; the message starts with file:line:column."""


class SolveError(WorkbenchError, RuntimeError):
    """A solve that did not end in a verified result, raised by `.require_success()`."""


class OutputError(WorkbenchError, OSError):
    """A result that could not be written."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""
