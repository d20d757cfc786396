"""Times without a date: of day, as spreadsheets write them, which run on over midnight or the hour; and durations."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, timedelta

import numpy as np

from workbench.model.record import FloatArray
from workbench.record.units import TIME_UNITS

__all__ = ["PARTS", "as_clocks", "digits_of_the_day", "durations", "of_the_day", "put_together"]

# What a time in several columns has beside its year.
PARTS = ("month", "day", "hour", "minute", "second")

# 23:59:58, 11:59:58.5 PM, 0 days 00:05:00; and what a spreadsheet makes of them where it shows no hours: 59:58.0.
_DAY = re.compile(r"(?:(\d+) days?,? )?(\d{1,4}):(\d\d):(\d\d(?:[.,]\d+)?)(?: ?([AaPp])\.?[Mm]\.?)?")
_HOUR = re.compile(r"(\d{1,2}):(\d\d[.,]\d+)")
_DURATION = re.compile(r"([+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)\s?([a-z]+)")
DAY, HOUR, MOST = 86400.0, 3600.0, 60
# The day that databases and spreadsheets have with a clock alone: their first.
_NO_DAY = re.compile(r"(?:1899-12-30|1899/12/30|30[./]12[./]1899|12/30/1899)[ T]")
EVEN = 0.9  # share of steps that are alike, of a clock in digits


def of_the_day(cells: Sequence[str]) -> tuple[FloatArray, str] | None:
    """Return (seconds, note) of times of day, shape (N,), nan where a cell is none; None where most are something else.

    What steps back by more than half a day (or half an hour, where no hours are written) has run on over midnight.
    Where hours go beyond a day and times never back, they are not of the day but from a start on.
    """
    for form, turn, note in (
        (_DAY, DAY, "times of day without a date: they run on over midnight"),
        (_HOUR, HOUR, "minutes and seconds without an hour: they run on over the hour"),
    ):
        found = [form.fullmatch(cell.strip()) for cell in cells]
        if 2 * sum(one is not None for one in found) <= len(cells):
            continue
        seconds = np.array([np.nan if one is None else _seconds(*one.groups()) for one in found])
        read = np.isfinite(seconds)
        beyond = np.array([one is not None and _hours(one) >= DAY / HOUR for one in found])
        if beyond.any() and (np.diff(seconds[read]) >= 0.0).all():
            return seconds, "times from a start on"
        seconds[beyond], read = np.nan, read & ~beyond
        seconds[read] = np.unwrap(seconds[read], period=turn)
        return seconds, note
    return None


def _hours(found: re.Match[str]) -> int:
    """Return the hours of a match of `_DAY`, 0 of `_HOUR`, which shows none."""
    return int(found[2]) if found.re is _DAY else 0


def as_clocks(cells: Sequence[str]) -> tuple[list[str], str] | None:
    """Return (HH:MM:SS, note) of clocks beside a day that are written otherwise; None where most cells are not such.

    HHMMSS or HHMM in digits, a fraction of a day, or a clock behind the first day that a spreadsheet counts. What is
    none, as a blank or a footer, stays as it is.
    """
    there = [cell for cell in cells if cell]
    if 2 * sum(_NO_DAY.match(cell) is not None for cell in there) > len(there):
        return [_NO_DAY.sub("", cell) for cell in cells], "the day before each clock is none"
    numbers: dict[str, float] = {}
    for cell in {*there}:
        with suppress(ValueError):
            numbers[cell] = float(cell.replace(",", "."))
    if 2 * sum(cell in numbers for cell in there) <= len(there):
        return None
    least, most = min(numbers.values()), max(numbers.values())
    if all(cell.isdecimal() for cell in numbers):
        widths = {len(cell) for cell in numbers}
        for long, places, usual in ((True, 6, 2400), (False, 4, MOST)):
            read = {cell: _in_digits(int(cell), long) for cell in numbers}
            if all(read.values()) and max(widths) <= places and (most >= usual or widths == {places}):
                note = f"read as clocks in digits, {'HHMMSS' if long else 'HHMM'}"
                return [read.get(cell, cell) for cell in cells], note
    elif least >= 0.0 and most < 1.0:
        read = {cell: _clock(round(DAY * share, 3)) for cell, share in numbers.items()}
        return [read.get(cell, cell) for cell in cells], "read as fractions of a day"
    return None


def _in_digits(value: int, long: bool) -> str:
    """Return HH:MM:SS of HHMMSS (long) or HHMM, "" where no clock shows it."""
    hours, rest = divmod(value, 10_000 if long else 100)
    minutes, seconds = divmod(rest, 100) if long else (rest, 0)
    shown = hours < DAY / HOUR and minutes < MOST and seconds < MOST
    return f"{hours:02d}:{minutes:02d}:{seconds:02d}" if shown else ""


def _clock(seconds: float) -> str:
    minutes, rest = divmod(min(seconds, DAY - 1e-3), 60.0)
    return f"{int(minutes) // 60:02d}:{int(minutes) % 60:02d}:{rest:06.3f}"


def digits_of_the_day(values: FloatArray) -> tuple[FloatArray, str] | None:
    """Return (seconds, note) of clocks in digits, HHMMSS, without a day, shape (N,), nan for none; None where not such.

    Such are numbers that a clock may show and that are evenly apart as clocks and not as numbers: 60059 is a second
    before 60100.
    """
    read = np.isfinite(values)
    fine = values[read]
    if fine.size < MOST or fine.min() < 0.0 or fine.max() >= 240_000.0 or (fine % 1.0).any():
        return None
    hours, minutes, late = fine // 10_000, fine // 100 % 100, fine % 100
    if minutes.max() >= MOST or late.max() >= MOST:
        return None
    clock = np.unwrap(HOUR * hours + 60.0 * minutes + late, period=DAY)
    alike = [float(np.mean(steps == np.median(steps))) for steps in (np.diff(clock), np.diff(fine))]
    if alike[0] < EVEN or alike[0] <= alike[1]:
        return None
    seconds = np.full(values.size, np.nan)
    seconds[read] = clock
    return seconds, "read as clocks in digits, HHMMSS, without a date"


def put_together(*parts: Sequence[str]) -> list[str]:
    """Return timestamps as text, of years, months, days, hours, minutes and perhaps seconds as text, shape (N,) each.

    Where they are no time, with a year of four digits, they are left beside each other, which reads as none.
    """
    return [_whole(row) or " ".join(row) for row in zip(*parts, strict=True)]


def _whole(row: Sequence[str]) -> str:
    """Return the timestamp of a row of `put_together`, "" where it is none."""
    try:
        *days, second = (float(cell.replace(",", ".")) for cell in (*row, "0")[: len(PARTS) + 1])
        if any(part % 1.0 for part in days) or not (days[0] >= 1900.0 and 0.0 <= second < MOST + 1.0):
            return ""
        return str(datetime(*map(int, days)) + timedelta(seconds=second))  # type: ignore[arg-type] # noqa: DTZ001
    except (ValueError, OverflowError):
        return ""


def durations(cells: Sequence[str]) -> tuple[FloatArray, str] | None:
    """Return (seconds, note) of numbers with a unit of time, as MATLAB's durations, 0.5 sec; else as `of_the_day`."""
    found = [_DURATION.fullmatch(cell.strip()) for cell in cells]
    units = {one[2] for one in found if one is not None}
    if 2 * sum(one is not None for one in found) <= len(cells) or not units <= TIME_UNITS.keys():
        return None
    seconds = [np.nan if one is None else float(one[1].replace(",", ".")) * TIME_UNITS[one[2]] for one in found]
    return np.array(seconds), f"times with their unit ({', '.join(sorted(units))}) taken as seconds"


def _seconds(*parts: str | None) -> float:
    """Seconds of (days, hours, minutes, seconds, A or P), or of (minutes, seconds); nan of what no clock shows."""
    if len(parts) == 2:
        days, hours, half = 0, 0, ""
        minutes, rest = parts
    else:
        days, hours, half = int(parts[0] or 0), int(parts[1] or 0), (parts[4] or "").upper()
        minutes, rest = parts[2:4]
    at, late = int(minutes or 0), float((rest or "").replace(",", "."))
    if at >= MOST or late >= MOST or (half and not 1 <= hours <= 12):
        return float("nan")
    if half:
        hours = hours % 12 + (12 if half == "P" else 0)
    return DAY * days + HOUR * hours + 60.0 * at + late
