"""Times of samples: from numbers or timestamps to seconds that ascend, and what was done to make them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray
from workbench.record.resolution import coarse_clock

__all__ = ["FORMATS_SAID", "JITTER", "Order", "in_order", "is_timestamp", "parse_timestamps", "runs"]

JITTER = 0.2  # of the sample time, by which an interval may differ from it
HOUR, DAY = 3600.0, 86_400.0
DUPLICATES = 0.2  # share of times that may repeat with other values before they say nothing
# Of an hour that goes by twice, only this many sample times may be missing: anything longer is no changed clock.
SLACK = 10.0
# More may be on the night of a Sunday, where the silence holds a full hour, at which clocks are changed.
SILENT = HOUR / 3.0
LEAP = 10.0  # usual steps, from which a step tells that a day and a month may have been mistaken
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_SPRING = (3, 4, 9, 10)  # months in which clocks go forward, north and south
SEASON = 100.0 * 24.0 * HOUR  # s, that are between two springs and more
_SUNDAY, _NIGHT = 3, 4.0  # 1 January 1970 was a Thursday; clocks change before four in the morning

_DAYS = (
    "%Y/%m/%d",
    "%d.%m.%Y",
    "%d.%m.%y",
    "%d-%b-%Y",
    "%d-%b-%y",
    "%d %b %Y",
    "%b %d %Y",
    "%d/%m/%Y",
    "%m/%d/%Y",
    "%d-%m-%Y",
    "%d/%m/%y",
    "%m/%d/%y",
    "%y/%m/%d",
)
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M")
# Where the clock has twelve hours, the month is written before the day.
_TWELVE = ("%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M %p")
_MONTH_FIRST = sorted(_DAYS, key=lambda day: not day.startswith("%m/"))
_FORMATS = (
    *(f"{day} {clock}" for day in _DAYS for clock in _CLOCKS),
    *(f"{day} {clock}" for day in _MONTH_FIRST for clock in _TWELVE),
)
# Hours east of Greenwich of zones that are written by name: Europe's, and North America's as RFC 5322 has them.
_ZONES = {
    **dict.fromkeys(("Z", "UT", "UTC", "GMT", "WET"), 0),
    **dict.fromkeys(("CET", "MEZ", "WEST"), 1),
    **dict.fromkeys(("CEST", "MESZ", "EET"), 2),
    "EEST": 3,
    "EST": -5,
    "EDT": -4,
    "CST": -6,
    "CDT": -5,
    "MST": -7,
    "MDT": -6,
    "PST": -8,
    "PDT": -7,
}
_ZONE = re.compile(rf"(.*[\dMm.])\s?({'|'.join(_ZONES)})")
_HALF = re.compile(r"(?<=\d)\s?([AP])(?:M|\.\s?M\.)$", re.IGNORECASE)
_FRACTION = re.compile(r"(:\d\d)(?:,|(?<=:\d\d:\d\d):)(\d{1,6})\b")
# What Java and JavaScript write: Oct 17, 2024, 9:55:00 PM, and a zone's place after its hours.
_LISTED, _PLACE = re.compile(r"(?<=\d),(?= )"), re.compile(r"\[[\w/+-]+\]$")
# Months as German and French plants write them where that is not as English ones do.
_MONTHS = {
    "mrz": "Mar",
    "mär": "Mar",
    "märz": "Mar",
    "mai": "May",
    "okt": "Oct",
    "dez": "Dec",
    "janv": "Jan",
    "févr": "Feb",
    "mars": "Mar",
    "avr": "Apr",
    "juin": "Jun",
    "juil": "Jul",
    "août": "Aug",
    "sept": "Sep",
    "déc": "Dec",
}
_MONTH = re.compile(rf"(?<=\d)(\. |[- ])({'|'.join(_MONTHS)})\b\.?", re.IGNORECASE)
# A weekday before the day, "Uhr" behind the clock, a clock with points for colons, and one before the day.
_WEEKDAY = re.compile(r"^(?:Mon|Tue|Wed|Thu|Fri|Sat|Sun)[a-z]{0,6},? (?=\d)| Uhr$")
_POINTS = re.compile(r"(?<= )(\d\d)\.(\d\d)\.(\d\d)(?=$|[.,])")
_TURNED = re.compile(r"(\d{1,2}:\d\d(?::\d\d(?:\.\d+)?)?(?: [AaPp][Mm])?),? (\d{1,4}[-./ ]\w+[-./ ]\d{2,4})")
# As Java and C print a time: Thu Oct 17 21:55:00 UTC 2024.
_PRINTED = re.compile(r"(?:[A-Z][a-z]{2} )?([A-Z][a-z]{2}) +(\d{1,2}) (\d\d:\d\d:\d\d(?:\.\d+)?)( [A-Z]{2,4})? (\d{4})")
_UNUSUAL = re.compile(r"[^\W\d_]{3}|^\d{1,2}:| \d\d\.\d\d\.")
# The end of a day, which ISO 8601 and control systems write as 24:00.
_END = re.compile(r"(?<=[ T])24(?=:00(?::00(?:[.,]0+)?)?(?![\d:.,]))")
FORMATS_SAID = (
    "seconds, ISO 8601 (2024-10-17 21:55:00, with or without a zone) or spellings such as 17.10.2024 21:55:00"
)


def _iso(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


@lru_cache(maxsize=4096)
def _day(text: str, form: str) -> datetime | None:
    try:
        return datetime.strptime(text, form)  # noqa: DTZ007 - zones are settled for the whole column
    except ValueError:
        return None


def _formatted(text: str, form: str) -> datetime | None:
    day_form, gap, clock_form = form.partition(" %H")
    if not gap or clock_form not in (":%M:%S", ":%M"):
        return _day(text, form)
    # strptime takes ten times as long as reading the few days once and the clock by hand.
    day_text, _, clock = text.rpartition(" ")
    day, parts = _day(day_text, day_form), clock.split(":")
    if day is None or len(parts) != clock_form.count("%") + 1 or not all(p.isdecimal() and len(p) < 3 for p in parts):
        return None
    hour, minute, second = (*map(int, parts), 0)[:3]
    return day.replace(hour=hour, minute=minute, second=second) if hour < 24 and minute < 60 and second < 60 else None


@lru_cache(maxsize=16)
def _alike(form: str) -> list[str]:
    """The other spellings of the same day with a clock of the same hours."""
    for day in sorted(_DAYS, key=len, reverse=True):
        for clocks in (_CLOCKS, _TWELVE):
            if form in (forms := [f"{day} {clock}" for clock in clocks]):
                return [other for other in forms if other != form]
    return []


def _other_clock(text: str, form: str) -> datetime | None:
    """Read a timestamp whose clock leaves out the seconds, or has their fraction, unlike the others of its column."""
    return next((s for other in _alike(form) if text and (s := _formatted(text, other)) is not None), None)


def _with_midnights(stamps: list[datetime | None], texts: Sequence[str], form: str) -> list[datetime | None]:
    """Return stamps with those that are a day alone, as midnight is written, where it lies between its neighbours."""
    day, out = re.split(r" %[HI]", form)[0], list(stamps)
    known = [(i, stamp) for i, stamp in enumerate(stamps) if stamp is not None]
    for (before, one), (after, other) in pairwise(known):
        for i in range(before + 1, after):
            stamp = _day(texts[i], day)
            if stamp is not None and min(one, other) <= stamp <= max(one, other):
                out[i] = stamp
    return out


def _spelled(text: str) -> tuple[str, timezone | None]:
    """Return a timestamp without the name of its zone, with months, AM and PM and points as Python knows them."""
    text = _LISTED.sub("", _PLACE.sub("", text))
    if _UNUSUAL.search(text):  # few are, and looking for all of it takes time
        text = _PRINTED.sub(r"\2 \1 \5 \3\4", text) if _PRINTED.fullmatch(text) else text
        text = _POINTS.sub(r"\1:\2:\3", _WEEKDAY.sub("", text))
        text = _MONTH.sub(lambda m: m[1][-1] + _MONTHS[m[2].lower()], text)
        text = _TURNED.sub(r"\2 \1", text) if _TURNED.fullmatch(text) else text
    found = _ZONE.fullmatch(text)
    zone = None if found is None else timezone(timedelta(hours=_ZONES[found[2]]))
    bare = text if found is None else found[1]
    return _FRACTION.sub(r"\1.\2", _HALF.sub(r" \1M", bare)), zone


def _zoned(stamp: datetime | None, zone: timezone | None) -> datetime | None:
    return stamp if stamp is None or zone is None else stamp.replace(tzinfo=zone)


def _seconds(stamps: Sequence[datetime | None]) -> tuple[FloatArray, FloatArray | None] | None:
    """Seconds since 1970 (nan where None) and how far east their zones are, or None where only some have a zone."""
    known = [s for s in stamps if s is not None]
    aware = {s.tzinfo is not None for s in known}
    if len(aware) > 1:
        return None
    zoned = aware == {True}
    epoch = _EPOCH if zoned else _EPOCH.replace(tzinfo=None)
    seconds = np.array([np.nan if s is None else (s - epoch).total_seconds() for s in stamps])
    return seconds, np.array([_east(s) for s in stamps]) if zoned else None


def _east(stamp: datetime | None) -> float:
    """Return how far east of Greenwich a timestamp's zone is, s, nan where it has none."""
    east = None if stamp is None else stamp.utcoffset()
    return np.nan if east is None else east.total_seconds()


def parse_timestamps(cells: Sequence[str]) -> tuple[FloatArray, str, FloatArray | None] | str:
    """Return (seconds, note, east) of timestamps, shape (N,), nan where a cell is none; or a refusal in words.

    The spelling is settled for the whole column: the one that reads most cells, and of two that read the same (day or
    month first) the one whose times run in one direction, then the one with the fewest leaps; where both do as well,
    the day comes first, or the month with a clock of twelve hours, and the note says so. east: s by which the zones of
    the stamps are east of Greenwich; None where they carry none, and are a clock on a wall, which may have been
    changed. 24:00 is the end of a day, and a day alone between timestamps its begin.
    """
    ends = np.array([_END.search(c) is not None for c in cells], dtype=bool)
    if ends.any():
        cells = [_END.sub("00", c) for c in cells]
    # Fractions with a comma are ISO 8601, and Python reads them as such.
    stamps = [_iso(c) for c in cells]
    read = sum(s is not None for s in stamps)
    note = ""
    if read < len(cells):
        texts, zones = zip(*(_spelled(c) for c in cells), strict=True)
        if texts != tuple(cells):
            stamps = [s or _zoned(_iso(t), z) for s, t, z in zip(stamps, texts, zones, strict=True)]
            read = sum(s is not None for s in stamps)
        sample = [t for t, s in zip(texts, stamps, strict=True) if s is None and t][:50]
        fitting = [f for f in _FORMATS if any(_formatted(c, f) is not None for c in sample)]
        best: tuple[int, bool, int] = (read, False, 0)
        chosen: list[datetime | None] = []
        spelling = ""
        for form in fitting:
            other = [_formatted(t, form) for t in texts]
            plain = [s for s in other if s is not None]
            one_way = all(b > a for a, b in pairwise(plain)) or all(b < a for a, b in pairwise(plain))
            rank = (len(plain), one_way, -_leaps(plain))
            if rank > best:
                best, chosen, spelling, note = rank, other, form, f"timestamps read as {form}"
            elif rank == best and plain and other != chosen:
                note += f" (as {form} they would run as evenly)"
        if chosen:
            chosen = [s or _other_clock(t, spelling) for s, t in zip(chosen, texts, strict=True)]
            chosen = _with_midnights(chosen, texts, spelling)
            stamps = [_zoned(s, z) for s, z in zip(chosen, zones, strict=True)]
    parsed = _seconds(stamps)
    if parsed is None:
        return "some timestamps carry a time zone and some do not; all or none must"
    return parsed[0] + np.where(ends, DAY, 0.0), note, parsed[1]


def is_timestamp(text: str) -> bool:
    """Whether a text is a timestamp that can be read."""
    parsed = parse_timestamps([text])
    return not isinstance(parsed, str) and bool(np.isfinite(parsed[0]).all())


def _leaps(stamps: Sequence[datetime]) -> int:
    """Return how many steps are far longer than usual, as over midnight where day and month are mistaken."""
    steps = np.abs(np.diff(np.array(stamps, dtype="datetime64[us]").astype(np.int64)))
    return int(np.count_nonzero(steps > LEAP * np.median(steps[steps > 0]))) if steps.any() else 0


# Whether the rows of one array hold the same as those of another, shape (M,) each.
Alike = Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.bool_]]


@dataclass(frozen=True)
class Order:
    """Times in ascending order: `rows` (M,) picks them from the file, `seconds` (M,) are theirs, strictly ascending.

    repeated: rows left out since another one has the same time. notes: what was done, in words. refusal: why the times
    make no order, with {row} and {before} for the lines of the two rows in `between`; else "".
    """

    rows: NDArray[np.int64]
    seconds: FloatArray
    repeated: int
    notes: tuple[str, ...]
    refusal: str = ""
    between: tuple[int, int] = (0, 0)


def in_order(
    seconds: FloatArray,
    same: NDArray[np.bool_],
    wall_clock: bool,
    alike: Alike,
    values: Sequence[FloatArray] = (),
) -> Order:
    """Bring times into ascending order as far as that leaves no doubt.

    seconds: as in the file, shape (N,), nan for none (those rows are left out). same: where a row holds the same
    values as the row before. wall_clock: timestamps without a zone. alike: whether rows hold the same in all their
    cells as other rows do. values: of signals, shape (N,) each, nan for none. Rows that a second export repeats are
    left out; a file from the latest time to the earliest is turned round; of rows with one time the last counts; a wall
    clock that was put back or forward by an hour at the change of daylight saving runs on; stamps that are rounded as
    coarsely as samples are apart become the times of the even clock that explains them (see `resolution`). Anything
    else is refused.
    """
    rows, notes = np.flatnonzero(np.isfinite(seconds)), []
    again = _exported_again(seconds[rows], wall_clock, lambda a, b: alike(rows[a], rows[b]))
    doubled = int(np.count_nonzero(again))
    if doubled:
        rows = rows[~again]
        many = f"{doubled} rows that were exported before are" if doubled > 1 else "1 row that was exported before is"
        notes.append(f"{many} left out, with the same times and values")
    times = seconds[rows]
    steps = np.diff(times)
    turned = _backwards(times, wall_clock)
    if turned:
        rows, times = rows[::-1], times[::-1]
        same = np.concatenate((same[1:], [False]))
        steps = np.diff(times)
        notes.append("the file goes from the latest time to the earliest; turned round")
    if wall_clock:
        times, said = _clock_changes(times)
        notes += said
        steps = np.diff(times)
    back = np.flatnonzero(steps < 0.0)
    if back.size:
        at = int(back[0])
        refusal = (
            f"{-steps[at]:g} s before {{before}}; times must ascend (a changed clock, daylight saving or two exports "
            "in one file do this)"
        )
        return Order(rows, times, doubled, tuple(notes), refusal, (int(rows[at + 1]), int(rows[at])))
    twice = np.flatnonzero(steps == 0.0)
    other = twice[~same[rows[twice + 1]]]
    if 2 * other.size >= twice.size and (clock := coarse_clock(times, [one[rows] for one in values])) is not None:
        return Order(rows, clock[0], doubled, (*notes, clock[1]))
    if twice.size:
        if other.size > max(DUPLICATES * times.size, 1):
            at = int(other[0])
            refusal = (
                f"the same time as {{before}} with other values, and {other.size - 1} times more; times must ascend "
                "(times cut to whole seconds or minutes, or several loops in one file, do this)"
            )
            return Order(rows, times, doubled, tuple(notes), refusal, (int(rows[at + 1]), int(rows[at])))
        keep = np.concatenate((steps > 0.0, [True]))
        rows, times = rows[keep], times[keep]
        some = "with other values" if other.size == twice.size else f"{other.size} of them with other values"
        which = some if other.size else "with the same values"
        kept = f": the {'first' if turned else 'last'} row of a time is kept" if other.size else ""
        many = f"{twice.size} row{'s' if twice.size > 1 else ''}"
        notes.append(f"{many} of a time that occurs again left out, {which}{kept}")
    return Order(rows, times, doubled + int(twice.size), tuple(notes))


def _exported_again(times: FloatArray, wall_clock: bool, alike: Alike) -> NDArray[np.bool_]:
    """Return which rows, in blocks that go back in time, all repeat rows before: overlapping exports in one file."""
    out, steps = np.zeros(times.size, dtype=bool), np.diff(times)
    if not (steps < 0.0).any():
        return out
    late = np.concatenate([[False], times[1:] <= np.maximum.accumulate(times)[:-1]])
    kept = np.flatnonzero(~late)
    at = kept[np.minimum(np.searchsorted(times[kept], times), kept.size - 1)]
    # How many rows up to each go back in time, and are at no time of a row before.
    backwards = np.concatenate([[0], np.cumsum(steps < 0.0)])
    unknown = np.cumsum(times[at] != times)
    first, many = runs(late)
    last = first + many - 1
    some = (backwards[last] > backwards[first - 1]) & (unknown[last] == unknown[first - 1])
    for begin, end in zip(first[some].tolist(), (last[some] + 1).tolist(), strict=True):
        block = np.arange(begin, end)
        back = float(steps[begin - 1 : end - 1].min())
        if not alike(at[block], block).all():
            continue
        # A loop at rest is the same in both hours that a clock shows in autumn.
        out[block] = back < -HOUR or not wall_clock or not alike(block[1:], block[:-1]).all()
    return out


def runs(flags: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (first, length) of every run of True, shapes (R,)."""
    edges = np.diff(np.concatenate(([False], flags, [False])).astype(np.int8))
    first = np.flatnonzero(edges == 1)
    return first, np.flatnonzero(edges == -1) - first


def _backwards(times: FloatArray, wall_clock: bool) -> bool:
    """Whether times, shape (N,), go from the latest to the earliest, but for a clock that was changed."""
    steps = np.diff(times)
    if not (steps < 0.0).any():
        return False
    if wall_clock and (steps > 0.0).any():
        # That must leave no doubt, or it is the file's own order that is refused.
        return bool(np.count_nonzero(steps < 0.0) > np.count_nonzero(steps > 0.0)) and bool(
            (np.diff(_clock_changes(times[::-1])[0]) >= 0.0).all()
        )
    return bool((steps <= 0.0).all())


def _clock_changes(times: FloatArray) -> tuple[FloatArray, list[str]]:
    """Return times of a wall clock with the hour of daylight saving taken out, and what was done."""
    steps = np.diff(times)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    if not 0.0 < usual <= SILENT * (1.0 + JITTER):
        return times, []
    notes = []
    before, silent = times[:-1], steps + HOUR
    night = (np.floor(before / (24.0 * HOUR)) % 7 == _SUNDAY) & (before % (24.0 * HOUR) < _NIGHT * HOUR)

    def changing(silence: FloatArray) -> NDArray[np.bool_]:
        hours = np.floor((before + silence) / HOUR + 1e-9) - np.floor(before / HOUR)
        return np.asarray(night & (hours > 0.0))

    fine = usual < HOUR / SLACK
    few = fine & (silent <= SLACK * usual)
    sure = changing(silent) & ((1.0 - JITTER) * usual <= silent) & (silent <= SILENT * (1.0 + JITTER))
    back = np.flatnonzero((steps < 0.0) & (silent > 0.0) & (few | sure))
    forward = np.flatnonzero(night & (np.abs(steps - usual - HOUR) <= JITTER * usual))
    if not fine:
        # A few missing rows are an hour too.
        forward = forward[(changing(steps - HOUR) & np.isin(_months(before), _SPRING))[forward]]
    if (np.diff(times[forward]) < SEASON).any():
        # Every Sunday's silence is no changed clock.
        forward = forward[:0]
    shift = np.zeros(times.size)
    for many, at, sign, words in (
        (back.size, back, 1.0, "back an hour (daylight saving ends)"),
        (forward.size, forward, -1.0, "forward an hour (daylight saving begins)"),
    ):
        if many > 0:
            shift[at + 1] += sign * HOUR
            notes.append(f"the clock goes {words}{f' {many} times' if many > 1 else ''}; the times run on through it")
    return times + np.cumsum(shift), notes


def _months(times: FloatArray) -> NDArray[np.int64]:
    """Return the months, 1 to 12, of seconds since 1970, shape (N,)."""
    return times.astype("datetime64[s]").astype("datetime64[M]").astype(np.int64) % 12 + 1
