"""Which column of a file, or which tag of a tall one, is which signal: usual spellings, suffixes, explicit mapping."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

from workbench.errors import RecordError
from workbench.model.checks import reads_as_number
from workbench.record.times import is_timestamp
from workbench.record.units import TIME_UNITS

__all__ = [
    "SIGNALS",
    "TAGGED",
    "flags_unused",
    "is_tall",
    "loops_of",
    "match_columns",
    "match_tags",
    "names_time",
    "of_folders",
    "of_no_loop",
    "qualities_unused",
    "split_tag",
    "whole",
    "with_loops",
]

SIGNALS = ("time", "SP", "PV", "OP", "MODE", "valve_position")
# A tall file, as historians export them, has a row per value: tag, time, value and perhaps its quality and unit.
TALL = ("tag", "time", "value", "quality", "unit")
TAGGED = ("SP", "PV", "OP", "MODE", "valve_position")
# The qualities of a wide file: of the row, or of one signal.
QUALITIES = ("quality", *(f"{signal} quality" for signal in TAGGED))
NEEDED = ("PV", "OP")
NAMED = 12  # names of a file listed in a message

# The signal's own name first; the spellings after it count less where a file holds both.
_OWN: dict[str, tuple[str, ...]] = {
    "time": ("time", "timestamp", "t", "ts"),
    "SP": ("sp", "setpoint"),
    "PV": ("pv",),
    "OP": ("op",),
    "MODE": ("mode",),
    "valve_position": ("valveposition",),
    "quality": ("quality",),
    "unit": ("unit", "units"),
    "tag": ("tag", "tagname"),
    "value": ("value",),
}
_SPELLINGS: dict[str, tuple[str, ...]] = {
    "time": (
        *("seconds", "second", "sec", "secs", "s", "datetime", "date", "elapsed", "elapsedtime", "minutes", "hours"),
        *("tstamp", "iptrendtime", "xvalue", "datenum", "zeit", "zeitstempel", "horodatage", "temps"),
    ),
    "SP": ("setpt", "spt", "setpointvalue", "target", "reference", "r", "sv", "sollwert", "consigne"),
    "PV": ("processvalue", "processvariable", "measurement", "measured", "measuredvalue", "y", "istwert", "mesure"),
    "OP": (
        *("output", "co", "mv", "out", "controlleroutput", "manipulatedvariable", "outputvalue", "u", "lmn"),
        *("stellwert", "stellgre", "stellgroesse", "sortie"),  # Stellgröße, of which letters without marks are left
    ),
    "MODE": ("mod", "controllermode", "controlmode", "operatingmode"),
    "valve_position": ("valvepos", "stem", "stemposition", "position", "zt", "pos", "zi", "valvetravel", "valve"),
    "quality": (
        "qual",
        "qualitycode",
        "qualityflag",
        "status",
        "statuscode",
        "isgood",
        "opcquality",
        "confidence",
        "questionable",
        "datastatus",
        *("qualitt", "qualitaet", "qualit", "qualite"),  # Qualität, qualité, of which letters without marks are left
    ),
    "unit": ("uom", "eu", "engunit", "engunits", "engineeringunit", "engineeringunits"),
    "tag": (
        *("tagid", "point", "pointname", "pointid", "item", "itemid", "itemname", "name", "signal", "variable"),
        # Not InfluxDB's _field: it is the same for all loops of a file, and two would be read as one.
        *("varname", "variablename", "path", "tagpath", "object", "attribute", "series", "metric"),
    ),
    "value": ("val", "reading", "average", "avg", "pointvalue", "itemvalue", "varvalue", "vvalue", "iptrendvalue"),
}
_SUFFIXES: dict[str, tuple[str, ...]] = {
    "time": (),
    "SP": ("sp", "spt", "setpoint", "sv", "sollwert", "consigne"),
    "PV": ("pv", "measurement", "meas", "measured", "istwert", "mesure"),
    "OP": ("op", "co", "mv", "out", "output", "lmn", "stellwert", "sortie"),
    "MODE": ("mode", "mod"),
    "valve_position": ("zt", "zi", "pos", "position", "stem"),
    "quality": (),
    "unit": (),
    "tag": (),
    "value": (),
}
# Whose attribute the tag of a tall file is: PV, OP of several.
_LOOP = ("loop", "loopname", "element", "asset", "block", "module", "controller", "equipment", "instrument")
# A day and a clock in columns of their own.
_DAY, _CLOCK = ("date", "datum", "fecha"), ("time", "uhrzeit", "zeit", "heure", "hora")
# FactoryTalk's and others': the milliseconds of a time in whole seconds.
_MILLI = ("millitm", "millisecond", "milliseconds", "millis", "msec", "ms")
# WinCC's: the Time_ms beside it counts millionths of a day.
_FIRST = {"time": ("timestring",)}
# CV is the controlled variable beside an MV or OP, and the controller's beside a PV: the last to be looked at for both.
_LAST = {"PV": ("cv", "controlledvariable"), "OP": ("cv", "controlvariable")}
# What control systems write after the signal: FIC101/PID1/PV.CV, FIC101/PID1/MODE.ACTUAL.
_AFTER = ("cv", "value", "val", "actual")
# A quality beside a value bears the value's name and one of these: PV_Q, PV.Status, "FIC101.PV Quality", Quality_PV.
_QUALITIES = (
    *(*_OWN["quality"], *_SPELLINGS["quality"], "dataquality", "isgoodquality", "isquestionable", "qstatus"),
    *("good", "percentgood", "pctgood", "bad", "isbad", "valid", "isvalid", "validity", "invalid", "iptrendqstatus"),
    *("st", "q"),
)

_FLAGS = ("flag", "flags")
_ALIKE = "have this name: rename all but one of them in the file's header"

# Unit words that stand after a name without brackets too, as in "valve position %" written out.
_UNITS = ("pct", "percent", "eu", "ma")
# And what may: in brackets, or after a comma.
_BEHIND = re.compile(r"\s*(?:\([^()]*\)|\[[^][]*\]|,[^,]*)\s*$")
_ENDINGS = {*_AFTER, *_UNITS, *(word for words in _SUFFIXES.values() for word in words)}
_NUMBERED = re.compile(r"(?<=[A-Za-z]{3})[._ ]\d$")
_BRACKETS = re.compile(r"\([^)]*\)|\[[^]]*\]")


def _plain(name: str) -> str:
    """Lower case without units in brackets and without anything but letters and digits."""
    return re.sub(r"[^0-9a-z]", "", _BRACKETS.sub("", name.lower()))


def _tokens(name: str) -> list[str]:
    return [part for part in re.split(r"[^0-9a-z]+", re.sub(r"[()\[\]]", " ", name.lower())) if part]


def _tier(name: str, signal: str) -> int | None:
    """Return how well a column's name fits a signal: 0 its own name, 1 a usual spelling, 2 a tag's suffix, 3 CV.

    -1, before all of these: a name that is right even beside the signal's own.
    """
    tier = _fit(name, signal)
    head, comma, unit = name.rpartition(",")
    if tier is None and comma and not {*_ENDINGS, *_QUALITIES} & {*_tokens(unit)[-1:]}:
        # A unit may stand after a comma: "PV, m3/h".
        tier = _fit(head, signal)
        return None if tier is None else max(tier, 1)
    return tier


def _fit(name: str, signal: str) -> int | None:
    plain, tokens = _plain(name), _tokens(name)
    if plain in _FIRST.get(signal, ()):
        return -1
    if plain in _OWN[signal]:
        return 0
    if plain in _SPELLINGS[signal] or (signal == "quality" and plain in _QUALITIES):
        return 1
    if plain in _LAST.get(signal, ()):
        return 3
    if len(tokens) < 2:
        return None
    if signal == "time":
        head = "".join(tokens[:-1])
        return 0 if tokens[-1] in TIME_UNITS and head in _OWN["time"] + _SPELLINGS["time"] else None
    tokens = _tag(name)
    if "".join(tokens) in _OWN[signal] + _SPELLINGS[signal]:
        return 1
    # "FIC101 Set Point": a suffix may be two words.
    ends = {tokens[-1], "".join(tokens[-2:]) if len(tokens) > 2 else ""}
    return 2 if len(tokens) > 1 and ends & {*_SUFFIXES[signal]} else None


def _tag(name: str) -> list[str]:
    """Return a name's tokens up to its signal: without a unit, in brackets or not, and what systems write after it."""
    tokens = _tokens(name)
    if tokens and tokens[-1] not in _ENDINGS:
        tokens = _tokens(_BRACKETS.sub(" ", name)) or tokens
    if len(tokens) > 1 and tokens[-1] in _UNITS:
        tokens = tokens[:-1]
    named = len(tokens) > 2 or tokens[:1] in (["pv"], ["op"], ["sp"])
    return tokens[:-1] if named and tokens[-1] in _AFTER else tokens


def split_tag(tag: str) -> tuple[str, str] | None:
    """Return (the loop's name, the signal) of a historian's tag or a column by its ending, None where that tells none.

    FIC101.PV is PV of FIC101, FIC101/PID1/PV.CV that of FIC101/PID1. A unit may stand behind: FIC101.PV (m3/h).
    """
    pieces = [(m.group(0).lower(), m.start()) for m in re.finditer(r"[0-9A-Za-z]+", tag)]
    for behind in (_UNITS, _AFTER):
        if len(pieces) > 2 and pieces[-1][0] in behind:
            pieces.pop()
    for words in (2, 1):  # FIC101 Set Point
        ending = "".join(word for word, _ in pieces[-words:])
        signal = next((s for s in TAGGED if ending in _SUFFIXES[s]), None)
        name = tag[: pieces[-words][1]].rstrip(" ._-/:\\|[(") if signal is not None and len(pieces) > words else ""
        if signal is not None and name:
            return name, signal
    bare = _BEHIND.sub("", tag)
    return split_tag(bare) if bare != tag else None


def loops_of(names: Iterable[str]) -> dict[str, dict[str, list[str]]]:
    """Return the loops that tags or columns tell, by name: of each its signals, and the names that could be each.

    Beside FIC101.SP a name FIC101 is its PV.
    """
    loops: dict[str, dict[str, list[str]]] = {}
    others: dict[str, list[str]] = {}
    for name in names:
        if split := split_tag(name):
            loops.setdefault(split[0], {}).setdefault(split[1], []).append(name)
        else:
            others.setdefault(_plain(name), []).append(name)
    for loop, own in loops.items():
        if "SP" in own and "PV" not in own and (found := others.get(_plain(loop))):
            own["PV"] = found
    return loops


def whole(loops: Mapping[str, Mapping[str, list[str]]]) -> list[str]:
    """Return the names of those of `loops_of` that have PV and OP."""
    return [loop for loop, own in loops.items() if all(signal in own for signal in NEEDED)]


def of_no_loop(names: Collection[str]) -> list[str]:
    """Return which columns or tags of a file of many loops belong to none, and are neither times nor a quality."""
    used = {name for own in loops_of(names).values() for found in own.values() for name in found}
    rated = {stem for name in used for stem in _stems(_plain(name))}

    def other(name: str) -> bool:
        bare = _plain(name).rstrip("0123456789") in (*_OWN["quality"], *_SPELLINGS["quality"], *_MILLI)
        return bool(name) and not (names_time(name) or bare or not _rated(name).isdisjoint(rated))

    return [name for name in dict.fromkeys(names) if name not in used and other(name)]


def names_time(name: str) -> bool:
    """Whether a column's name is one of times: Time, Timestamp (UTC), PV time."""
    return _tier(name.strip(), "time") is not None or bool({*_tokens(name)} & {"timestamp", "datetime", *_DAY, *_CLOCK})


def with_loops(pairs: Collection[tuple[str, str]], wanted: Collection[str] = ()) -> dict[tuple[str, str], str]:
    """Return the name of each (loop, tag) of a tall file: the tag, or FIC101.PV where a tag stands for several loops.

    pairs: all of the file, each once. wanted: names asked for; a loop and tag that together are one have that name.
    """
    shared = len(pairs) > len({tag for _, tag in pairs})
    names = {}
    for loop, tag in pairs:
        both = f"{loop}.{tag}" if loop and tag else tag
        names[loop, tag] = both if shared or both in wanted else tag
    return names


def of_folders(path: Path, header: Sequence[str]) -> dict[str, str]:
    """Return what the names of its folders tell of a tall file's rows: {"tag": ...} of tag=FIC101.PV/0.parquet.

    Only the loop, or asset, and the tag are told so, and what `header`, the file's own columns, holds goes before.
    """
    told = dict(part.split("=", 1) for part in path.parts[:-1] if "=" in part)
    tagged = any(_tier(name.strip(), "tag") is not None for name in header)
    tags = () if tagged else (*_OWN["tag"], *_SPELLINGS["tag"])
    return {key: unquote(cell) for key, cell in told.items() if _plain(key) in (*_LOOP, *tags) and key not in header}


def is_tall(header: Sequence[str], columns: Mapping[str, str] | None) -> bool:
    """Whether a header is that of a tall file: tag, time and value, and not PV and OP in columns of their own."""
    given = {_plain(str(key)) for key in columns or {}}
    if {"tag", "value"} & given:
        return True
    if {_plain(signal) for signal in NEEDED} <= given:
        return False

    def there(signal: str) -> bool:
        return signal in given or any(_tier(name.strip(), signal) is not None for name in header)

    return there("tag") and there("value") and there("time") and not all(there(signal) for signal in NEEDED)


def match_columns(
    header: Sequence[str], columns: Mapping[str, str] | None, source: str, tall: bool = False, alone: bool = False
) -> dict[str, int]:
    """Return the column index of each signal found; PV and OP always, or tag, time and value of a tall file.

    header: the file's column names. columns: an explicit mapping from signal (`SIGNALS`, or the columns of a tall
    file, in any case) to column name, which goes before all spellings. A wide file's qualities are found as "quality"
    (of the row), "PV quality", "OP quality" ...; the day as "date" where "time" may be but a clock, and what may be its
    "milliseconds"; a tall file's "loop" where one names what its tags are of. alone: whether a wide file's `columns`
    are all that the loop has, but for its times and qualities. Raises `RecordError` for columns that are missing,
    ambiguous or mapped twice.
    """
    names = [h.strip() for h in header]
    if tall:
        found = _match(names, columns, TALL, TALL, ("tag", "time", "value"), source, "column")
        loops = [i for i, name in enumerate(names) if i not in found.values() and _plain(name) in _LOOP]
        return found | ({"loop": loops[0]} if loops else {})
    spelled = SIGNALS[:1] if alone else SIGNALS
    found = _match(names, columns, (*SIGNALS, *QUALITIES), spelled, NEEDED, source, "column")
    # A day and a clock in columns of their own are one time.
    free = [i for i in range(len(names)) if i == found.get("time") or i not in found.values()]
    day, clock = (next((i for i in free if _plain(names[i]) in words), None) for words in (_DAY, _CLOCK))
    told = "time" in {_plain(str(key)) for key in columns or {}}
    if day is not None and clock is not None and found.get("time") in ((clock,) if told else (None, day, clock)):
        found |= {"date": day, "time": clock}
    elif "time" in found and not told:
        # Time beside Time.1, as spreadsheets' and pandas' second column of a name is called.
        used = names[found["time"]]
        other = next((n for n in names if n != used and _NUMBERED.sub("", n) == _NUMBERED.sub("", used)), None)
        if other is not None:
            which = f"columns {used!r}, {other!r} could each be time"
            raise RecordError(f"{source}: {which}; say which one, for example columns={{'time': {used!r}}}")
    milli = next((i for i in free if i not in found.values() and _plain(names[i]) in _MILLI), None)
    found |= {} if milli is None or "time" not in found else {"milliseconds": milli}
    return found | _qualities(names, found)


def _qualities(names: Sequence[str], found: Mapping[str, int]) -> dict[str, int]:
    """Return the columns of quality of a wide file, by their names; found: its other columns."""
    taken = set(found.values())
    out: dict[str, int] = {}
    for signal in TAGGED:
        if signal in found and f"{signal} quality" not in found:
            own = _stems(_plain(names[found[signal]])) | set(_OWN[signal])
            hits = [i for i, n in enumerate(names) if i not in taken and not _rated(n).isdisjoint(own)]
            if hits:
                out[f"{signal} quality"] = hits[0]
                taken.add(hits[0])
    # Quality and nothing else: of the row, or of the column before it where there are several.
    bare = _OWN["quality"] + _SPELLINGS["quality"]
    rows = [i for i, n in enumerate(names) if i not in taken and _plain(n).rstrip("0123456789") in bare]
    if len(rows) == 1 and "quality" not in found:
        out["quality"] = rows[0]
    elif len(rows) > 1:
        signals = {i: signal for signal, i in found.items() if signal in TAGGED}
        before = {f"{signals[i - 1]} quality": i for i in rows if i - 1 in signals}
        out |= {name: i for name, i in before.items() if name not in found}
    return out


def _rated(name: str) -> set[str]:
    """Return what a column may hold the quality of, by its name: plain names, none where it is no quality's."""
    plain, tokens = _plain(name), _tokens(name)
    whole = {plain.removesuffix(word) for word in _QUALITIES if plain.endswith(word)}
    if len(tokens) > 1 and tokens[0] in _QUALITIES:
        whole.add("".join(tokens[2:] if tokens[1] in ("of", "for") else tokens[1:]))
    return {stem for one in whole for stem in _stems(one)}


def _stems(plain: str) -> set[str]:
    """Return a plain name as it is and without what control systems write after it."""
    return {plain, *(plain.removesuffix(word) for word in _AFTER)} - {""}


def _is_data(names: Sequence[str]) -> bool:
    """Whether what stands for names are numbers beside timestamps, as in a file without a header."""
    numbers = [not name or reads_as_number(name.replace(",", ".")) for name in names]
    stamps = [name for name, number in zip(names, numbers, strict=True) if not number]
    return len(stamps) < sum(map(bool, names)) and any(stamps) and all(is_timestamp(stamp) for stamp in stamps)


def qualities_unused(header: Sequence[str], found: Mapping[str, int]) -> list[str]:
    """Return a note on the columns of a wide file that look like qualities and belong to no column of it, or none.

    found: the columns in use.
    """
    names = [h.strip() for h in header]
    others = {_plain(n) for n in names}

    def looks(name: str) -> bool:
        tokens = _tokens(name)
        # Q alone is a flow.
        ends = {token for token in tokens[:1] if len(token) > 2} | set(tokens[-1:] if len(tokens) > 1 else ())
        rated = "quality" in _plain(name) or not ends.isdisjoint(_QUALITIES)
        return rated and _rated(name).isdisjoint(others)

    unused = [repr(n) for i, n in enumerate(names) if i not in found.values() and looks(n)]
    more = f" and {len(unused) - NAMED} more" if len(unused) > NAMED else ""
    say = "columns (--column) can say, as 'PV quality'"
    return [f"not used, for whose quality is it? {', '.join(unused[:NAMED])}{more}; {say}"] if unused else []


def flags_unused(header: Sequence[str], found: Mapping[str, int]) -> list[str]:
    """Return a note on a tall file's column of flags, as PI's of what is questionable, substituted or annotated.

    found: the columns in use.
    """
    unused = [name.strip() for i, name in enumerate(header) if i not in found.values() and _plain(name) in _FLAGS]
    say = "columns (--column) can say, as 'quality', that a value with a flag is bad"
    return [f"not used: {', '.join(map(repr, unused))}; {say}"] if unused else []


def match_tags(tags: Sequence[str], mapping: Mapping[str, str] | None, source: str) -> dict[str, int]:
    """Return which of a tall file's tags is which signal; PV and OP always. As `match_columns`."""
    return _match(list(tags), mapping, TAGGED, TAGGED, NEEDED, source, "tag")


def _match(
    names: list[str],
    mapping: Mapping[str, str] | None,
    wanted: Sequence[str],
    spelled: Sequence[str],
    needed: Sequence[str],
    source: str,
    what: str,
) -> dict[str, int]:
    """Return the index of each of `wanted` that the mapping gives, or, of those in `spelled`, that its name tells."""
    there = ", ".join(repr(n) for n in names[:NAMED]) + (
        f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    )
    argument = f"{what}s"
    found: dict[str, int] = {}
    for key, given in (mapping or {}).items():
        signal = next((s for s in wanted if _plain(s) == _plain(str(key))), None)
        if signal is None:
            msg = f"{source}: {argument}: {key!r} given; must be one of {', '.join(wanted)}"
            raise RecordError(msg)
        fits = [i for i, n in enumerate(names) if n == str(given).strip()]
        if len(fits) != 1:
            why = f"there is no such {what}; the file has {there}" if not fits else f"{len(fits)} {argument} {_ALIKE}"
            msg = f"{source}: {what} {given!r} given for {signal}: {why}"
            raise RecordError(msg)
        if fits[0] in found.values():
            msg = f"{source}: {what} {given!r} is given for more than one signal; each needs its own"
            raise RecordError(msg)
        found[signal] = fits[0]
    taken = set(found.values())
    loops = loops_of(names)
    told = [names[found[signal]] for signal in NEEDED if signal in found]
    others = _of_others(loops, told)
    for signal in spelled:
        if signal in found:
            continue
        tiers: dict[int, list[int]] = {}
        for i, name in enumerate(names):
            tier = None if i in taken or name in others else _tier(name, signal)
            if tier is not None:
                tiers.setdefault(tier, []).append(i)
        if not tiers:
            continue
        best = tiers[min(tiers)]
        if len(best) > 1 and signal not in ("quality", "unit"):
            single = next((names[i] for i in best if names.count(names[i]) == 1), None)
            way = f"say which one, for example {argument}={{{signal!r}: {single!r}}}"
            many = len(whole(loops)) > 1 and len(told) < len(NEEDED)
            if many:
                way = _one_of(loops, argument, told)
            which = ", ".join(repr(names[i]) for i in best[: 2 if many else NAMED])
            which += f" and {len(best) - 2} more" if many and len(best) > 2 else ""
            msg = f"{source}: {argument} {which} could each be {signal}; {f'all {_ALIKE}' if single is None else way}"
            raise RecordError(msg)
        found[signal] = best[0]
        taken.add(best[0])
    if "PV" in spelled and "PV" not in found and "SP" in found:
        # A flow beside a "flow setpoint", or FIC101 beside FIC101.SP.
        *head, end = _tag(names[found["SP"]]) or [""]
        alone = [i for i, name in enumerate(names) if i not in taken and _plain(name) == "".join(head)]
        if head and end in _SUFFIXES["SP"] and len(alone) == 1:
            found["PV"] = alone[0]
    missing = [s for s in needed if s not in found]
    if missing:
        if what == "column" and _is_data(names):
            msg = f"{source}: times and numbers ({there}) where the column names should be; a header line is needed"
            raise RecordError(msg)
        tall = ", or which are 'tag', 'time' and 'value' of a row per value" if missing == ["PV", "OP"] else ""
        msg = (
            f"{source}: no {what} for {' and '.join(missing)}; the file has {there or f'no named {what}'}; "
            f"give the mapping, for example {argument}={{{missing[0]!r}: 'name in the file'}}"
            f"{tall if what == 'column' else ''}"
        )
        raise RecordError(msg)
    return found


def _of_others(loops: Mapping[str, Mapping[str, list[str]]], given: Sequence[str]) -> set[str]:
    """Return the names that are another loop's, one with a PV or OP of its own, where PV and OP are given of one."""
    told = [{name for found in own.values() for name in found} for own in loops.values()]
    if len(given) < len(NEEDED) or not any(names.issuperset(given) for names in told):
        return set()
    rivals = [names for own, names in zip(loops.values(), told, strict=True) if own.keys() & set(NEEDED)]
    return {name for names in rivals if not names.issuperset(given) for name in names}


def _one_of(loops: Mapping[str, Mapping[str, list[str]]], argument: str, given: Sequence[str]) -> str:
    """Return in words which loops a file holds, and how to say which one, for example that of the names given."""
    names = whole(loops)
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    meant = next(
        (loop for loop in names if any(name in own for name in given for own in loops[loop].values())), names[0]
    )
    first = {signal: loops[meant][signal][0] for signal in NEEDED}
    return (
        f"say which one, for example {argument}={first!r} for {meant}; the file holds {len(names)} loops: "
        f"{', '.join(names[:NAMED])}{more}"
    )
