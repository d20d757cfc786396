"""Units as files write them: of time and mA, in a column's name or in a row of units below the header."""

from __future__ import annotations

import re

__all__ = ["TIME_UNITS", "in_milliamperes", "is_unit", "signal_unit", "time_unit", "time_unit_below"]

# Time columns may carry their unit, as in t_s, "time [min]" or time_ms.
TIME_UNITS = {
    "s": 1.0,
    "sec": 1.0,
    "secs": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "msec": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "mins": 60.0,
    "minute": 60.0,
    "minutes": 60.0,
    "h": 3600.0,
    "hr": 3600.0,
    "hrs": 3600.0,
    "hour": 3600.0,
    "hours": 3600.0,
    "d": 86_400.0,
    "day": 86_400.0,
    "days": 86_400.0,
}
_OTHERS = ("%", "pct", "percent", "ma")
_SIGNALS = ("V", "VDC", "V DC", "mV", "psi", "psig", "bar", "barg", "mbar", "kPa")


def in_milliamperes(text: str) -> bool:
    """Whether a name, a unit or the cell of a row of units says mA; _ma in small letters may be a moving average."""
    return re.search(r"(?<![A-Za-z])mA(?![A-Za-z])|[(\[]\s*(?i:ma)\s*[)\]]|(?i:milliamp)", text) is not None


def signal_unit(text: str) -> str:
    """Return the unit of a standard signal, V or a pressure, that a name ends with in brackets, or that a unit is."""
    unit = re.split(r"[(\[]", text)[-1].strip(")] ")
    return unit if unit in _SIGNALS else ""


def _plain(text: str) -> str:
    return text.replace("µ", "u").replace("μ", "u").lower()


def time_unit(name: str) -> float | None:
    """Return the seconds in one unit of a numeric time column, read from its name; None where it says nothing."""
    words = re.findall(r"[0-9a-z]+", _plain(name))
    return TIME_UNITS.get(words[-1]) if words else None


def _unit(cell: str) -> str:
    """Return the unit that a cell of a row of units is, or ends with in brackets, if it is one."""
    return re.split(r"[(\[]", _plain(cell))[-1].strip(")] ")


def time_unit_below(cell: str) -> float | None:
    """Return the same as `time_unit`, read from the column's cell in a row of units; h:min:s is a format, no unit."""
    return TIME_UNITS.get(_unit(cell))


def is_unit(cell: str) -> bool:
    """Whether a cell is a unit beyond doubt: %, mA, a unit of time, or anything per such a unit, as m3/h."""
    return _unit(cell) in _OTHERS or _unit(cell).rpartition("/")[2].strip() in TIME_UNITS
