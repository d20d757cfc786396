"""What the command's options say: quantities, ranges, and how to read data. Readers load where they are used."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from workbench.errors import InvalidValue, RecordError, ScenarioError

if TYPE_CHECKING:
    from workbench.model.record import Record
    from workbench.model.tuning import Objective
    from workbench.scenario.plan import Scenario

__all__ = ["Reading", "in_options", "limit", "quantity", "read_data", "scenario_of", "span", "weights_of"]


@dataclass(frozen=True)
class Reading:
    """The options on reading data, as typed; None where not given."""

    column: Sequence[str] | None
    tag: Sequence[str] | None
    sample_time: str | None
    pv_range: str | None
    op_range: str | None
    max_gap: str | None


def scenario_of(path: Path) -> Scenario:
    """Return the scenario of a file; raises `ScenarioError`, which says so where it is a site's manifest."""
    from workbench.fleet.manifest import is_manifest
    from workbench.scenario.loader import MANIFEST, load_scenario

    if is_manifest(path):
        raise ScenarioError(f"{path}: {MANIFEST}")
    return load_scenario(path)


def quantity(option: str, text: str, read: Callable[[object], float]) -> float:
    """Return an option's value; raises `InvalidValue` naming the option."""
    try:
        return read(text)
    except InvalidValue as error:
        raise InvalidValue(option, error.given, error.allowed) from None


def limit(option: str, text: str) -> float:
    """Return a limit, inf for "none"; raises `InvalidValue` naming the option."""
    from workbench.scenario import units

    return math.inf if text.strip().lower() == "none" else quantity(option, text, units.bare)


def weights_of(text: str) -> Objective:
    """Return the weights of --objective; raises `InvalidValue`."""
    from workbench.model.tuning import WEIGHABLE, Objective
    from workbench.scenario import units

    weights = dict.fromkeys(("w1", "w2", "w3", "w4", *WEIGHABLE), 0.0)
    for part in text.split(","):
        name, sign, value = (piece.strip() for piece in part.partition("="))
        if name not in weights or not sign:
            allowed = f"must be weights such as w1=0.5,w3=0.5, of {', '.join(weights)}"
            raise InvalidValue("--objective", text, allowed)
        weights[name] = quantity("--objective", value, units.bare)
    w1, w2, w3, w4 = (weights.pop(name) for name in ("w1", "w2", "w3", "w4"))
    return Objective(w1, w2, w3, w4, weights)


def span(option: str, text: str, read: Callable[[object], float]) -> tuple[float, float]:
    """Return (low, high) of `low:high`; one value fixes. Raises `InvalidValue` naming the option."""
    from workbench.scenario import units

    low, sign, high = text.partition(":")
    try:
        first = read(low.strip())
        last = read(high.strip()) if sign else first
    except InvalidValue as error:
        raise InvalidValue(option, text, f"{error.allowed}, or LOW:HIGH of such") from None
    first, last = units.integral_range((low, high), (first, last))
    if not first <= last:
        raise InvalidValue(option, text, "must be LOW:HIGH with low <= high")
    return first, last


def read_data(data: Path, reading: Reading) -> Record:
    """Return the record of a data file. Raises `RecordError` and `InvalidValue` in terms of the options."""
    from workbench.record.reader import read_record
    from workbench.scenario import units

    ranges: dict[str, tuple[float, float] | None] = {}
    for option, text in (("--pv-range", reading.pv_range), ("--op-range", reading.op_range)):
        ranges[option] = None if text is None else _range(option, text)
    times: dict[str, float | None] = {}
    for option, text in (("--sample-time", reading.sample_time), ("--max-gap", reading.max_gap)):
        times[option] = None if text is None else quantity(option, text, units.time)
    try:
        with in_options():
            return read_record(
                data,
                columns=_mapping("--column", reading.column) or None,
                tags=_mapping("--tag", reading.tag) or None,
                sample_time=times["--sample-time"],
                pv_range=ranges["--pv-range"],
                op_range=ranges["--op-range"],
                max_gap=times["--max-gap"],
            )
    except RecordError as error:
        raise RecordError(_as_options(str(error), str(data))) from None


def _range(option: str, text: str) -> tuple[float, float]:
    from workbench.scenario import units

    try:
        low, high = span(option, text, units.bare)
    except InvalidValue:
        low = high = 0.0
    if not low < high:
        raise InvalidValue(option, text, "must be LOW:HIGH with LOW < HIGH, such as 4:20")
    return low, high


def _mapping(option: str, given: Sequence[str] | None) -> dict[str, str]:
    out = {}
    for text in given or ():
        signal, sign, name = text.partition("=")
        # A column may have no name, as a table's index has none where it is written; a tag has one.
        if not sign or not (name.strip() or option == "--column"):
            raise InvalidValue(option, text, "must be SIGNAL=NAME, such as PV=FIC101.PV")
        out[signal.strip()] = name.strip()
    return out


# What the reader's messages call its arguments, outside of quotes: there stand names of the file.
_ARGUMENTS = {"sample_time": "--sample-time", "max_gap": "--max-gap"}
_WORDS = re.compile(r"'[^']*'|\"[^\"]*\"|\b(?:" + "|".join(_ARGUMENTS) + r")\b")
# What a value is called in Python, whose option is named otherwise.
_FIELDS = {**_ARGUMENTS, "estimate.start": "--start", "loops": "--loops", "hours": "--hours"}


@contextmanager
def in_options() -> Iterator[None]:
    """Name the option of the command in place of the field or argument that an `InvalidValue` names."""
    try:
        yield
    except InvalidValue as error:
        if error.where not in _FIELDS:
            raise
        raise InvalidValue(_FIELDS[error.where], error.given, error.allowed) from None


def _as_options(message: str, source: str) -> str:
    """Return a reader's message with the command's options in place of the arguments of Python; source: the file."""

    def options(found: re.Match[str]) -> str:
        pairs = re.findall(r"'([\w ]+)': (?:'([^']*)'|\"([^\"]*)\")", found[2])
        return " ".join(f'--{found[1]} "{signal}={plain or quoted}"' for signal, plain, quoted in pairs)

    head, message = (source, message.removeprefix(source)) if message.startswith(source) else ("", message)
    message = message.replace("give sample_time in seconds", 'give --sample-time, such as "5 s"')
    message = _WORDS.sub(lambda word: _ARGUMENTS.get(word[0], word[0]), message)
    return head + re.sub(r"\b(column|tag)s=\{([^}]*)\}", options, message)
