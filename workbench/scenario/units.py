"""Quantities as scenarios write them: `5 s`, `2 min`, `0.5 repeats/min`, `2 %/%`, `150 %`.

Each reader takes what YAML gave and returns SI-like values of the model (s, %, %/EU); anything else is an
`InvalidValue` whose `allowed` says how the quantity is written. Ranges are not checked here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from workbench.errors import InvalidValue

__all__ = [
    "COMMA_RULE",
    "FILTER_FORM",
    "GAIN_FORM",
    "INTEGRAL_FORM",
    "LAMBDA_FORM",
    "NUMBER",
    "PERCENT_FORM",
    "TIME_FORM",
    "Quantity",
    "bare",
    "comma_rule",
    "filter_ratio",
    "gain",
    "integral_range",
    "integral_time",
    "is_quantity",
    "lambda_time",
    "percent",
    "proportional_band",
    "size",
    "time",
]

NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
TIME_UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}

# The same grammar for editors, as JSON Schema patterns.
TIME_FORM = rf"^\s*{NUMBER}\s*(ms|s|min|h|d)\s*$"
INTEGRAL_FORM = rf"^\s*({NUMBER}\s*(ms|s|min|h|d|repeats/min)|none)\s*$"
PERCENT_FORM = rf"^\s*{NUMBER}\s*%\s*$"
GAIN_FORM = rf"^\s*{NUMBER}\s*(%/EU|%/%)\s*$"
LAMBDA_FORM = rf"^\s*{NUMBER}\s*(ms|s|min|h|d|tau)\s*$"
FILTER_FORM = "^none$"

COMMA_RULE = "decimals are written with a point, such as 2.5"

# No unit begins with a decimal comma.
_QUANTITY = re.compile(rf"\s*({NUMBER})\s*((?!,\d)\S*)\s*")
_TIME_RULE = 'must be a time with its unit, such as "5 s" (ms, s, min, h, d)'
_INTEGRAL_RULE = 'must be a time with its unit, such as "20 s" (ms, s, min, h, d), "0.5 repeats/min", or none'
_GAIN_RULE = 'must be a gain in %/EU, such as 0.5 or "0.5 %/EU", or "2 %/%" of the PV range'
_LAMBDA_RULE = 'must be a time with its unit, such as "15 s", or a multiple of the time constant, such as "3 tau"'
_PERCENT_RULE = 'must be a number of %, such as 2 or "2 %"'


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number in its unit: "%/EU", "%/%" or "PB %" (a proportional band); "s" or "tau"; "%" or none."""

    value: float
    unit: str


def _split(value: object, rule: str) -> tuple[float, str]:
    """Return the number and the unit ("" for a bare number) of a quantity."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InvalidValue("", value, rule)
    if not isinstance(value, str):
        x, unit = float(value), ""
    else:
        match = _QUANTITY.fullmatch(value)
        if match is None:
            raise InvalidValue("", value, f"{rule}{comma_rule(value)}")
        x, unit = float(match[1]), match[2]
    if not math.isfinite(x):
        raise InvalidValue("", value, f"{rule}; and be finite")
    return x, unit


def comma_rule(text: str) -> str:
    """Return what is to be said besides of a text that is a quantity but for its decimal comma, "" of any other."""
    comma = "," in text and _QUANTITY.fullmatch(text.replace(",", ".", 1)) is not None
    return f"; {COMMA_RULE}" if comma else ""


def is_quantity(text: object) -> bool:
    """Return whether a text begins with a number: no key of a scenario does."""
    return _QUANTITY.fullmatch(str(text)) is not None


def bare(value: object) -> float:
    """Return a plain number."""
    x, unit = _split(value, "must be a number")
    if unit:
        raise InvalidValue("", value, "must be a number, without a unit")
    return x


def time(value: object) -> float:
    """Return a time in s; its unit must be written, but for a bare 0."""
    x, unit = _split(value, _TIME_RULE)
    if unit in TIME_UNITS:
        return x * TIME_UNITS[unit]
    if unit == "" and x == 0.0:
        return 0.0
    raise InvalidValue("", value, _TIME_RULE)


def integral_time(value: object) -> float:
    """Return an integral time in s; `none` or 0 repeats/min give `math.inf`, no integral action."""
    if value == "none":
        return math.inf
    x, unit = _split(value, _INTEGRAL_RULE)
    if unit == "repeats/min":
        if x < 0.0:
            raise InvalidValue("", value, "must be >= 0 repeats/min")
        return 60.0 / x if x > 0.0 else math.inf
    if unit in TIME_UNITS:
        return x * TIME_UNITS[unit]
    raise InvalidValue("", value, _INTEGRAL_RULE)


def integral_range(written: Sequence[object], times: Sequence[float]) -> list[float]:
    """Return the ends of a range of integral times, as they are `written`, in s.

    Low to high where both are rates: repeats/min from low to high are times from high to low.
    """
    rates = all(isinstance(end, str) and end.rstrip().endswith("repeats/min") for end in written)
    return sorted(times) if rates else list(times)


def lambda_time(value: object) -> Quantity:
    """Return a closed-loop time constant above 0 in "s", or in multiples of the plant's own, "tau"."""
    x, unit = _split(value, _LAMBDA_RULE)
    if unit in TIME_UNITS:
        x, unit = x * TIME_UNITS[unit], "s"
    if unit not in ("s", "tau") or x <= 0.0:
        raise InvalidValue("", value, _LAMBDA_RULE)
    return Quantity(x, unit)


def percent(value: object) -> float:
    """Return a number of %; the sign % may be left out."""
    x, unit = _split(value, _PERCENT_RULE)
    if unit not in ("", "%"):
        raise InvalidValue("", value, _PERCENT_RULE)
    return x


def size(value: object) -> Quantity:
    """Return the size of a setpoint or load change: a bare number, or one with the sign %."""
    x, unit = _split(value, "must be a number: EU for a setpoint, % for a load")
    if unit not in ("", "%"):
        raise InvalidValue("", value, "must be a number: EU for a setpoint, % for a load")
    return Quantity(x, unit)


def gain(value: object) -> Quantity:
    """Return a controller gain: a bare number is in %/EU."""
    x, unit = _split(value, _GAIN_RULE)
    if unit not in ("", "%/EU", "%/%"):
        raise InvalidValue("", value, _GAIN_RULE)
    return Quantity(x, unit or "%/EU")


def proportional_band(value: object) -> Quantity:
    """Return a proportional band, such as `150 %`."""
    return Quantity(percent(value), "PB %")


def filter_ratio(value: object) -> float:
    """Return n of the derivative filter Tf = Td/n; `none` gives `math.inf`, unfiltered."""
    if value == "none":
        return math.inf
    x, unit = _split(value, "must be a number n of Tf = Td/n, or none (unfiltered)")
    if unit:
        raise InvalidValue("", value, "must be a number n of Tf = Td/n, or none (unfiltered)")
    return x
