"""Checks that the value types share: one clear `InvalidValue` for each thing that is not allowed."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from numbers import Integral, Real
from typing import Any

from workbench.errors import InvalidValue

__all__ = [
    "all_of",
    "callback",
    "choice",
    "file_name",
    "instance",
    "number",
    "ordered_pair",
    "reads_as_number",
    "sequence",
    "whole",
]


def number(
    value: object,
    where: str,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    infinite: bool = False,
    unit: str = "",
) -> float:
    """Return `value` as a float, or raise `InvalidValue` when it is no real number in the stated range.

    `above` is an open lower bound, `least` and `most` are closed bounds; `infinite` allows +inf.
    """
    parts = []
    if above is not None:
        parts.append(f"> {above:g}")
    if least is not None:
        parts.append(f">= {least:g}")
    if most is not None:
        parts.append(f"<= {most:g}")
    allowed = " ".join(["must be a finite number" if not infinite else "must be a number", " and ".join(parts), unit])
    allowed = " ".join(allowed.split())
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InvalidValue(where, value, allowed)
    try:
        x = float(value)
    except OverflowError:
        raise InvalidValue(where, "a number beyond 1e308", allowed) from None
    if math.isnan(x) or (math.isinf(x) and not (infinite and x > 0)):
        raise InvalidValue(where, x, allowed)
    if (above is not None and x <= above) or (least is not None and x < least) or (most is not None and x > most):
        raise InvalidValue(where, x, allowed)
    return x


def whole(value: object, where: str, *, least: int = 0) -> int:
    """Return `value` as an int, or raise `InvalidValue` when it is no whole number >= `least`."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise InvalidValue(where, value, f"must be a whole number >= {least}")
    return int(value)


def sequence(value: object, where: str, allowed: str) -> Iterable[Any]:
    """Return `value` if it can be gone through and is no text, else raise `InvalidValue`; `allowed` says what is."""
    # A numpy array without a dimension has __iter__, and nothing to go through.
    if isinstance(value, str | bytes) or not isinstance(value, Iterable) or getattr(value, "ndim", 1) == 0:
        raise InvalidValue(where, value, f"must be {allowed}")
    return value


def instance(value: object, kind: type | tuple[type, ...], where: str, allowed: str) -> None:
    """Raise `InvalidValue` unless `value` is of that kind; `allowed` says in words what is."""
    if not isinstance(value, kind):
        raise InvalidValue(where, value, f"must be {allowed}")


def all_of(values: object, kind: type, where: str, each: str) -> tuple[Any, ...]:
    """Return `values` as a tuple, or raise `InvalidValue` unless each is of that kind; `each` says which, in words."""
    listed = tuple(sequence(values, where, f"a sequence, each {each}"))
    for i, value in enumerate(listed):
        instance(value, kind, f"{where}[{i}]", each)
    return listed


def file_name(path: object, what: str) -> str:
    """Return a file's path as text, or raise `InvalidValue` unless it is one; `what` says which file is needed."""
    name = os.fspath(path) if isinstance(path, str | os.PathLike) else path
    if not isinstance(name, str) or not name:
        raise InvalidValue("path", repr(path), f"must be the path of {what}, as text or a pathlib.Path")
    return name


def callback(value: object, where: str) -> None:
    """Raise `InvalidValue` unless `value` can be called or is None."""
    if value is not None and not callable(value):
        raise InvalidValue(where, value, "must be a function or None")


def choice(value: object, where: str, allowed: Sequence[str]) -> str:
    """Return `value` if it is one of `allowed`, else raise `InvalidValue`."""
    if not isinstance(value, str) or value not in allowed:
        raise InvalidValue(where, value, "must be one of " + ", ".join(allowed))
    return value


def ordered_pair(value: object, where: str, *, least: float | None = None, equal: bool = False) -> tuple[float, float]:
    """Return (low, high) as floats with low < high (low <= high when `equal`), else raise `InvalidValue`."""
    rule = "must be a pair (low, high) with low " + ("<= high" if equal else "< high")
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise InvalidValue(where, value, rule)
    low = number(value[0], f"{where}[0]", least=least)
    high = number(value[1], f"{where}[1]", least=least)
    if low > high or (low == high and not equal):
        raise InvalidValue(where, (low, high), rule)
    return low, high


def reads_as_number(text: str) -> bool:
    """Return whether a text is that of a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
