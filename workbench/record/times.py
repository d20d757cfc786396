"""Times of samples: from numbers or timestamps to seconds, and how evenly they are spaced."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np

from workbench.model.record import FloatArray

__all__ = ["FORMATS_SAID", "parse_timestamps"]

_DAYS = ("%Y/%m/%d", "%d.%m.%Y", "%d.%m.%y", "%d-%b-%Y", "%d-%b-%y", "%d %b %Y", "%d/%m/%Y", "%m/%d/%Y", "%d-%m-%Y")
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M", "%I:%M:%S %p", "%I:%M %p")
_FORMATS = (*(f"{day} {clock}" for day in _DAYS for clock in _CLOCKS), "%Y%m%d%H%M%S")
FORMATS_SAID = (
    "seconds, ISO 8601 (2024-10-17 21:55:00, with or without a zone) or spellings such as 17.10.2024 21:55:00"
)


def _iso(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def _formatted(text: str, form: str) -> datetime | None:
    try:
        return datetime.strptime(text, form)  # noqa: DTZ007 - zones are settled for the whole column
    except ValueError:
        return None


def _seconds(stamps: Sequence[datetime | None]) -> FloatArray | None:
    """Seconds since 1970 (nan where None), or None where some stamps have a zone and some have none."""
    known = [s for s in stamps if s is not None]
    aware = [s.tzinfo is not None for s in known]
    if any(aware) and not all(aware):
        return None
    out = np.full(len(stamps), np.nan)
    for i, stamp in enumerate(stamps):
        if stamp is not None:
            try:
                out[i] = (stamp if stamp.tzinfo is not None else stamp.replace(tzinfo=UTC)).timestamp()
            except (OverflowError, ValueError):
                continue
    return out


def parse_timestamps(cells: Sequence[str]) -> tuple[FloatArray, str] | str:
    """Return (seconds, note) of timestamps, shape (N,), nan where a cell is none; or a refusal in words.

    The spelling is settled for the whole column: the one that reads most cells, and of two that read the same (day or
    month first) the one whose times ascend; the note says so where both do. Stamps without a zone are taken as one
    clock without jumps.
    """
    # Fractions with a comma are ISO 8601, and Python reads them as such.
    stamps = [_iso(c) for c in cells]
    read = sum(s is not None for s in stamps)
    note = ""
    if read < len(cells):
        sample = [c for c, s in zip(cells, stamps, strict=True) if s is None and c][:50]
        fitting = [f for f in _FORMATS if any(_formatted(c, f) is not None for c in sample)]
        best: tuple[int, bool] = (read, False)
        for form in fitting:
            other = [_formatted(c, form) for c in cells]
            count = sum(s is not None for s in other)
            plain = [s for s in other if s is not None]
            ascending = all(b > a for a, b in pairwise(plain))
            if (count, ascending) > best:
                best, stamps, note = (count, ascending), other, f"timestamps read as {form}"
            elif (count, ascending) == best and ascending and count > 0 and other != stamps:
                note += f" (as {form} they would ascend as well)"
    seconds = _seconds(stamps)
    if seconds is None:
        return "some timestamps carry a time zone and some do not; all or none must"
    return seconds, note
