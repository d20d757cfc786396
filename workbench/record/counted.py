"""Times written as numbers: seconds, or another count that its size tells, or a date in digits alone."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from workbench.model.record import FloatArray
from workbench.record.units import time_unit, time_unit_below

__all__ = ["Counted", "counted"]

DAY = 86_400.0  # s
# Counts are told by the years that they give: from 1991 on no count in use looks like another.
_FROM, _TO = 662_688_000.0, 4_102_444_800.0  # s, 1991 and 2100
# Units in a second, and 1970 on that count. .NET's ticks (100 ns) begin with the year 1, Windows' file times with 1601.
_COUNTS = {
    "milliseconds since 1970": (1e3, 0.0),
    "microseconds since 1970": (1e6, 0.0),
    "nanoseconds since 1970": (1e9, 0.0),
    "ticks of 100 ns since the year 1, as .NET counts them": (1e7, 621_355_968e9),
    "units of 100 ns since 1601, as Windows counts them": (1e7, 116_444_736e9),
}
# Days: from and to, and what is taken off to make them days since 1970.
_DAYS = {
    "as spreadsheets count them": (20_000.0, 80_000.0, 25_569.0),
    "as MATLAB counts them": (727_000.0, 767_000.0, 719_529.0),
}
# What was 2**53 and more before it became a float is known to 13 microseconds at worst.
_DECIMALS = 5
LARGEST = 1e11  # s, far beyond any count of seconds in use
# s between rows, up to which numbers are taken for days; beyond that only such as are whole minutes, and no short
# number of seconds: 0.0104167 is a quarter of an hour, and 0.0125 s a step of 12.5 ms.
SLOWEST, MINUTE, SHORT = 600.0, 60.0, 3
_DIGITS = {12: "YYYYMMDDhhmm", 14: "YYYYMMDDhhmmss"}


class Counted(NamedTuple):
    """Numbers as times.

    seconds: shape (N,), or None where `texts` holds dates to be read, "" for none. note: what they were taken for, or
    "". refusal: why they are no times, or "". stamped: whether the seconds count since 1970; wall: of a clock on a
    wall.
    """

    seconds: FloatArray | None
    note: str = ""
    texts: list[str] | None = None
    refusal: str = ""
    stamped: bool = False
    wall: bool = False


def counted(values: FloatArray, name: str, below: str = "") -> Counted:
    """Return the times of a column of numbers, shape (N,), nan for none.

    name: the column's, which may say its unit; below: what a row of units says, which counts where the name does not.
    """
    unit, where = time_unit(name), ""
    if unit is None:
        unit, where = time_unit_below(below), f", as the row of units says ({below})"
    fine = values[np.isfinite(values)]
    low, high = (float(fine.min()), float(fine.max())) if fine.size else (0.0, 0.0)
    if unit not in (None, 1.0):
        since = bool(low * unit >= _FROM and high * unit < _TO)
        return Counted(values * unit, f"read in units of {unit:g} s{where}", stamped=since)
    if fine.size == 0:
        return Counted(values)
    if max(high, -low) > LARGEST:
        return _large(values, fine, low, high)
    if low >= _FROM and high < _TO:
        return Counted(values, "read as seconds since 1970", stamped=True)
    if unit is not None:
        return Counted(values)
    # Rows of one time, as in a tall file, say nothing about the steps.
    steps = np.abs(np.diff(fine))
    step = float(np.median(steps[steps > 0.0])) if steps.any() else math.inf
    if step * DAY >= SLOWEST and not _whole_minutes(step):
        return Counted(values)
    for who, (least, most, origin) in _DAYS.items():
        if least < low and high < most:
            # They are rounded to about a millisecond's hundredth.
            seconds = np.round((values - origin) * DAY, 3)
            return Counted(seconds, f"read as days, {who}", stamped=True, wall=True)
    if low >= 0.0 and high <= 1.0:
        doubt = f"numbers from {low:.6g} to {high:.6g}, {step:.3g} apart: seconds, or fractions of a day?"
        return Counted(None, refusal=f"{doubt} Say it in the column's name, as 'time [s]' or 'time [d]'")
    return Counted(values)


def _whole_minutes(step: float) -> bool:
    """Whether a step between rows is whole minutes as days, as far as written, and no short number of seconds."""
    minutes = step * DAY / MINUTE
    short = abs(step - float(f"{step:.{SHORT}g}")) < 1e-4 * step
    return math.isfinite(step) and not short and abs(minutes - round(minutes)) < 1e-3 * minutes


def _large(values: FloatArray, fine: FloatArray, low: float, high: float) -> Counted:
    """Return the times of numbers that are no seconds; fine: the finite ones, which run from low to high."""
    for words, (per_second, origin) in _COUNTS.items():
        first, last = (low - origin) / per_second, (high - origin) / per_second
        if first >= _FROM and last < _TO:
            seconds = np.round((values - origin) / per_second, _DECIMALS)
            return Counted(seconds, f"read as {words}", stamped=True)
    many = len(f"{high:.0f}")
    if many in _DIGITS and len(f"{low:.0f}") == many and bool((fine == np.floor(fine)).all()):
        digits = ["" if math.isnan(v) else f"{v:.0f}" for v in values.tolist()]
        return Counted(
            None, f"read as dates in digits, {_DIGITS[many]}", [f"{d[:8]}T{d[8:]}" if d else "" for d in digits]
        )
    return Counted(
        None,
        refusal=(
            f"numbers from {low:.17g} to {high:.17g} are no times that are known; allowed: seconds; milliseconds, "
            "microseconds or nanoseconds since 1970, .NET's ticks or Windows' file times, of the years 1991 to 2099; "
            "YYYYMMDDhhmm or YYYYMMDDhhmmss; days as spreadsheets or MATLAB count them; or any numbers of a unit that "
            "the column's name says, as 'time [ms]'"
        ),
    )
