"""Which column of a file is which signal: usual spellings, tag suffixes, explicit mapping."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from workbench.errors import RecordError

__all__ = ["SIGNALS", "match_columns"]

SIGNALS = ("time", "SP", "PV", "OP", "MODE", "valve_position")
NEEDED = ("PV", "OP")

# The signal's own name first; the spellings after it count less where a file holds both.
_OWN: dict[str, tuple[str, ...]] = {
    "time": ("time", "timestamp", "t", "ts"),
    "SP": ("sp", "setpoint"),
    "PV": ("pv",),
    "OP": ("op",),
    "MODE": ("mode",),
    "valve_position": ("valveposition",),
}
_SPELLINGS: dict[str, tuple[str, ...]] = {
    "time": ("seconds", "second", "sec", "secs", "s", "datetime", "date", "elapsed", "elapsedtime", "minutes", "hours"),
    "SP": ("setpt", "spt", "setpointvalue", "target", "reference", "r", "sv"),
    "PV": ("processvalue", "processvariable", "measurement", "measured", "measuredvalue", "y"),
    "OP": ("output", "co", "mv", "out", "controlleroutput", "manipulatedvariable", "outputvalue", "u"),
    "MODE": ("mod", "controllermode", "controlmode", "operatingmode"),
    "valve_position": ("valvepos", "stem", "stemposition", "position", "zt", "pos", "zi", "valvetravel", "valve"),
}
_SUFFIXES: dict[str, tuple[str, ...]] = {
    "time": (),
    "SP": ("sp", "spt", "setpoint", "sv"),
    "PV": ("pv", "measurement", "meas"),
    "OP": ("op", "co", "mv", "out", "output"),
    "MODE": ("mode", "mod"),
    "valve_position": ("zt", "zi", "pos", "position", "stem"),
}
# Time columns may carry their unit, as in t_s, "time [min]" or time_ms.
_TIME_UNITS = {
    "s": 1.0,
    "sec": 1.0,
    "secs": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "min": 60.0,
    "minute": 60.0,
    "minutes": 60.0,
    "h": 3600.0,
    "hour": 3600.0,
    "hours": 3600.0,
}


def _plain(name: str) -> str:
    """Lower case without units in brackets and without anything but letters and digits."""
    return re.sub(r"[^0-9a-z]", "", re.sub(r"\([^)]*\)|\[[^]]*\]", "", name.lower()))


def _tokens(name: str) -> list[str]:
    return [part for part in re.split(r"[^0-9a-z]+", re.sub(r"[()\[\]]", " ", name.lower())) if part]


def _tier(name: str, signal: str) -> int | None:
    """Return how well a column's name fits a signal: 0 its own name, 1 a usual spelling, 2 a tag's suffix."""
    plain, tokens = _plain(name), _tokens(name)
    if plain in _OWN[signal]:
        return 0
    if plain in _SPELLINGS[signal]:
        return 1
    if len(tokens) < 2:
        return None
    if signal == "time":
        head = "".join(tokens[:-1])
        return 0 if tokens[-1] in _TIME_UNITS and head in _OWN["time"] + _SPELLINGS["time"] else None
    # "valve position %" and the like: a unit word after the name.
    if tokens[-1] in ("pct", "percent", "eu") and "".join(tokens[:-1]) in _OWN[signal] + _SPELLINGS[signal]:
        return 1
    return 2 if tokens[-1] in _SUFFIXES[signal] else None


def time_unit(name: str) -> float:
    """Return the seconds in one unit of a numeric time column, read from its name; 1 where it says nothing."""
    tokens = _tokens(name)
    return _TIME_UNITS.get(tokens[-1], 1.0) if tokens else 1.0


def match_columns(header: Sequence[str], columns: Mapping[str, str] | None, source: str) -> dict[str, int]:
    """Return the column index of each signal found; PV and OP always.

    header: the file's column names. columns: an explicit mapping from signal (`SIGNALS`, in any case) to column name,
    which goes before all spellings. Raises `RecordError` for columns that are missing, ambiguous or mapped twice.
    """
    names = [h.strip() for h in header]
    there = ", ".join(repr(n) for n in names)
    found: dict[str, int] = {}
    for key, wanted in (columns or {}).items():
        signal = next((s for s in SIGNALS if _plain(s) == _plain(str(key))), None)
        if signal is None:
            msg = f"{source}: columns: {key!r} given; must be one of {', '.join(SIGNALS)}"
            raise RecordError(msg)
        fits = [i for i, n in enumerate(names) if n == str(wanted).strip()]
        if len(fits) != 1:
            what = "there is no such column" if not fits else f"{len(fits)} columns have this name"
            msg = f"{source}: column {wanted!r} given for {signal}: {what}; the file has {there}"
            raise RecordError(msg)
        if fits[0] in found.values():
            msg = f"{source}: column {wanted!r} is given for more than one signal; each needs its own"
            raise RecordError(msg)
        found[signal] = fits[0]
    taken = set(found.values())
    for signal in SIGNALS:
        if signal in found:
            continue
        tiers: dict[int, list[int]] = {}
        for i, name in enumerate(names):
            tier = None if i in taken else _tier(name, signal)
            if tier is not None:
                tiers.setdefault(tier, []).append(i)
        if not tiers:
            continue
        best = tiers[min(tiers)]
        if len(best) > 1:
            which = ", ".join(repr(names[i]) for i in best)
            msg = (
                f"{source}: columns {which} could each be {signal}; say which one, "
                f"for example columns={{{signal!r}: {names[best[0]]!r}}}"
            )
            raise RecordError(msg)
        found[signal] = best[0]
        taken.add(best[0])
    missing = [s for s in NEEDED if s not in found]
    if missing:
        msg = (
            f"{source}: no column for {' and '.join(missing)}; the file has {there or 'no named column'}; "
            f"give the mapping, for example columns={{{missing[0]!r}: 'name in the file'}}"
        )
        raise RecordError(msg)
    return found
