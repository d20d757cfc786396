"""Which column of a file, or which tag of a tall one, is which signal: by their names, or an explicit mapping."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

from workbench.errors import RecordError
from workbench.model.checks import reads_as_number
from workbench.record.aggregates import DOUBTFUL, aggregate_of, rank_of
from workbench.record.names import (
    CALENDAR,
    CLOCK,
    DAY,
    LOOP,
    MILLI,
    OWN,
    QUALITY_WORDS,
    SPELLINGS,
    SUFFIXES,
    TAGGED,
    names_time,
    plain_of,
    rated_by,
    split_tag,
    stems,
    tier_of,
    tokens_of,
    up_to_signal,
)
from workbench.record.times import is_timestamp

__all__ = [
    "SIGNALS",
    "flags_unused",
    "is_tall",
    "loops_of",
    "match_columns",
    "match_tags",
    "names_said",
    "of_folders",
    "of_no_loop",
    "qualities_unused",
    "whole",
    "with_loops",
]

SIGNALS = ("time", "SP", "PV", "OP", "MODE", "valve_position")
# A tall file, as historians export them, has a row per value: tag, time, value and perhaps its quality and unit.
TALL = ("tag", "time", "value", "quality", "unit")
# The qualities of a wide file: of the row, or of one signal.
QUALITIES = ("quality", *(f"{signal} quality" for signal in TAGGED))
NEEDED = ("PV", "OP")
NAMED = 12  # names of a file listed in a message

# As spreadsheets and pandas call a second column of a name.
_NUMBERED = re.compile(r"(?<=[A-Za-z]{3})[._ ]\d$")
_FLAGS = ("flag", "flags")
_ALIKE = "have this name: rename all but one of them in the file's header"


def loops_of(names: Iterable[str]) -> dict[str, dict[str, list[str]]]:
    """Return the loops that tags or columns tell, by name: of each its signals, and the names that could be each.

    Beside FIC101.SP a name FIC101 is its PV. Beside the signal itself its averages count for nothing.
    """
    return {loop: {signal: _nearest(found) for signal, found in own.items()} for loop, own in _loops(names).items()}


def _nearest(names: list[str]) -> list[str]:
    """Return the names of a signal that are nearest to it, where some are its aggregates."""
    ranks = [rank_of(name) or 0 for name in names]
    return [name for name, rank in zip(names, ranks, strict=True) if rank == min(ranks)]


def _loops(names: Iterable[str]) -> dict[str, dict[str, list[str]]]:
    """Return the same as `loops_of` with all aggregates that are a signal."""
    loops: dict[str, dict[str, list[str]]] = {}
    others: dict[str, list[str]] = {}
    for name in names:
        if split := split_tag(name):
            loops.setdefault(split[0], {}).setdefault(split[1], []).append(name)
        else:
            others.setdefault(plain_of(name), []).append(name)
    for loop, own in loops.items():
        if "SP" in own and "PV" not in own and (found := others.get(plain_of(loop))):
            own["PV"] = found
    return loops


def whole(loops: Mapping[str, Mapping[str, list[str]]]) -> list[str]:
    """Return the names of those of `loops_of` that have PV and OP."""
    return [loop for loop, own in loops.items() if all(signal in own for signal in NEEDED)]


def of_no_loop(names: Collection[str]) -> list[str]:
    """Return which columns or tags of a file of many loops belong to none, and are neither times nor a quality."""
    used = {name for own in loops_of(names).values() for found in own.values() for name in found}
    rated = {stem for name in used for stem in stems(plain_of(name))}
    calendar = set(map(plain_of, _calendar(list(names), {}).values()))

    def other(name: str) -> bool:
        bare = plain_of(name).rstrip("0123456789") in (*OWN["quality"], *SPELLINGS["quality"], *MILLI)
        bare = bare or plain_of(name) in calendar
        return bool(name) and not (names_time(name) or bare or not rated_by(name).isdisjoint(rated))

    return [name for name in dict.fromkeys(names) if name not in used and other(name)]


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
    tagged = any(tier_of(name.strip(), "tag") is not None for name in header)
    tags = () if tagged else (*OWN["tag"], *SPELLINGS["tag"])
    return {key: unquote(cell) for key, cell in told.items() if plain_of(key) in (*LOOP, *tags) and key not in header}


def is_tall(header: Sequence[str], columns: Mapping[str, str] | None) -> bool:
    """Whether a header is that of a tall file: tag, time and value, and not PV and OP in columns of their own."""
    given = {plain_of(str(key)) for key in columns or {}}
    if {"tag", "value"} & given:
        return True
    if {plain_of(signal) for signal in NEEDED} <= given:
        return False

    def there(signal: str) -> bool:
        return signal in given or any(tier_of(name.strip(), signal) is not None for name in header)

    timed = there("time") or bool(_calendar([name.strip() for name in header], {}))
    return there("tag") and there("value") and timed and not all(there(signal) for signal in NEEDED)


def match_columns(
    header: Sequence[str], columns: Mapping[str, str] | None, source: str, tall: bool = False, alone: bool = False
) -> dict[str, int]:
    """Return the column index of each signal found; PV and OP always, or tag, time and value of a tall file.

    header: the file's column names. columns: an explicit mapping from signal (`SIGNALS`, or the columns of a tall
    file, in any case) to column name, which goes before all spellings. A wide file's qualities are found as "quality"
    (of the row), "PV quality", "OP quality" ...; the day as "date" where "time" may be but a clock, what may be its
    "milliseconds", and "month", "day", "hour", "minute" and "second" where it is but the year; the "loop" where a
    column names what a row, or a tall file's tag, is of. alone: whether a wide file's `columns` are all that the loop
    has, but for its times and qualities. Raises `RecordError` for columns that are missing, ambiguous or mapped twice.
    """
    names = [h.strip() for h in header]
    calendar = _calendar(names, columns or {})
    given = {**calendar, **(columns or {})}
    if tall:
        needed = ("tag", "value") if calendar else ("tag", "time", "value")
        found = _match(names, given, (*TALL, *calendar), TALL, needed, source, "column")
        found = _dated(names, found, calendar)
        loops = [i for i, name in enumerate(names) if i not in found.values() and plain_of(name) in LOOP]
        return found | ({"loop": loops[0]} if loops else {})
    spelled = SIGNALS[:1] if alone else SIGNALS
    found = _match(names, given, (*SIGNALS, *QUALITIES, *calendar), spelled, NEEDED, source, "column")
    found = _dated(names, found, calendar)
    if "month" in found:
        found |= _milliseconds(names, found)
        return found | _qualities(names, found)
    # A day and a clock in columns of their own are one time.
    free = [i for i in range(len(names)) if i == found.get("time") or i not in found.values()]
    day, clock = (next((i for i in free if plain_of(names[i]) in words), None) for words in (DAY, CLOCK))
    told = "time" in {plain_of(str(key)) for key in columns or {}}
    if day is not None and clock is not None and found.get("time") in ((clock,) if told else (None, day, clock)):
        found |= {"date": day, "time": clock}
    elif "time" in found and not told:
        # Time beside Time.1, as spreadsheets' and pandas' second column of a name is called.
        used = names[found["time"]]
        other = next((n for n in names if n != used and _NUMBERED.sub("", n) == _NUMBERED.sub("", used)), None)
        if other is not None:
            which = f"columns {used!r}, {other!r} could each be time"
            raise RecordError(f"{source}: {which}; say which one, for example columns={{'time': {used!r}}}")
    found |= _milliseconds(names, found)
    return found | _qualities(names, found) | ({} if alone else _of_rows(names, found))


def _of_rows(names: Sequence[str], found: Mapping[str, int]) -> dict[str, int]:
    """Return the column that may tell which loop each row is of; found: the other columns."""
    words = ("loop", "loopname", *OWN["tag"], "tagid")
    at = next((i for i, name in enumerate(names) if i not in found.values() and plain_of(name) in words), None)
    return {} if at is None else {"loop": at}


def _calendar(names: Sequence[str], columns: Mapping[str, str]) -> dict[str, str]:
    """Return which columns hold the year, month, day, hour, minute and, if there is one, second; {} where times do not.

    columns: what the user said, which goes before.
    """
    said = {str(name).strip() for name in columns.values()}
    found = {
        part: [name for name in names if plain_of(name) in words and name not in said]
        for part, words in CALENDAR.items()
    }
    told = "time" in {plain_of(str(key)) for key in columns}
    if told or any(len(own) > 1 or (not own and part != "second") for part, own in found.items()):
        return {}
    return {part: own[0] for part, own in found.items() if own}


def _dated(names: Sequence[str], found: Mapping[str, int], calendar: Collection[str]) -> dict[str, int]:
    """Return the columns found, with the year of a calendar as "time", and its other parts, where no time is there."""
    bare = {signal: i for signal, i in found.items() if signal not in calendar}
    if not calendar or ("time" in bare and plain_of(names[bare["time"]]) not in DAY):
        return bare
    return bare | {"time": found["year"]} | {part: found[part] for part in calendar if part != "year"}


def _milliseconds(names: Sequence[str], found: Mapping[str, int]) -> dict[str, int]:
    """Return the column that may hold the milliseconds of a time; found: the other columns."""
    milli = next((i for i, n in enumerate(names) if i not in found.values() and plain_of(n) in MILLI), None)
    return {} if milli is None or "time" not in found else {"milliseconds": milli}


def _qualities(names: Sequence[str], found: Mapping[str, int]) -> dict[str, int]:
    """Return the columns of quality of a wide file, by their names; found: its other columns."""
    taken = set(found.values())
    out: dict[str, int] = {}
    for signal in TAGGED:
        if signal in found and f"{signal} quality" not in found:
            name = names[found[signal]]
            own = stems(plain_of(name)) | stems(plain_of(aggregate_of(name)[0])) | set(OWN[signal])
            hits = [i for i, n in enumerate(names) if i not in taken and not rated_by(n).isdisjoint(own)]
            if hits:
                out[f"{signal} quality"] = hits[0]
                taken.add(hits[0])
    # Quality and nothing else: of the row, or of the column before it where there are several.
    bare = OWN["quality"] + SPELLINGS["quality"]
    rows = [i for i, n in enumerate(names) if i not in taken and plain_of(n).rstrip("0123456789") in bare]
    if len(rows) == 1 and "quality" not in found:
        out["quality"] = rows[0]
    elif len(rows) > 1:
        signals = {i: signal for signal, i in found.items() if signal in TAGGED}
        before = {f"{signals[i - 1]} quality": i for i in rows if i - 1 in signals}
        out |= {name: i for name, i in before.items() if name not in found}
    return out


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
    others = {plain_of(n) for n in names}

    def looks(name: str) -> bool:
        tokens = tokens_of(name)
        # Q alone is a flow.
        ends = {token for token in tokens[:1] if len(token) > 2} | set(tokens[-1:] if len(tokens) > 1 else ())
        rated = "quality" in plain_of(name) or not ends.isdisjoint(QUALITY_WORDS)
        return rated and rated_by(name).isdisjoint(others)

    unused = [repr(n) for i, n in enumerate(names) if i not in found.values() and looks(n)]
    more = f" and {len(unused) - NAMED} more" if len(unused) > NAMED else ""
    say = "columns (--column) can say, as 'PV quality'"
    return [f"not used, for whose quality is it? {', '.join(unused[:NAMED])}{more}; {say}"] if unused else []


def flags_unused(header: Sequence[str], found: Mapping[str, int]) -> list[str]:
    """Return a note on a tall file's column of flags, as PI's of what is questionable, substituted or annotated.

    found: the columns in use.
    """
    unused = [name.strip() for i, name in enumerate(header) if i not in found.values() and plain_of(name) in _FLAGS]
    say = "columns (--column) can say, as 'quality', that a value with a flag is bad"
    return [f"not used: {', '.join(map(repr, unused))}; {say}"] if unused else []


def match_tags(tags: Sequence[str], mapping: Mapping[str, str] | None, source: str) -> dict[str, int]:
    """Return which of a tall file's tags is which signal; PV and OP always. As `match_columns`."""
    return _match(list(tags), mapping, TAGGED, TAGGED, NEEDED, source, "tag")


def names_said(names: Sequence[str]) -> str:
    """Return the first of some names, and how many more there are, in words."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(map(repr, names[:NAMED]))}{more}"


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
    there = names_said(names)
    argument = f"{what}s"
    found: dict[str, int] = {}
    for key, given in (mapping or {}).items():
        signal = next((s for s in wanted if plain_of(s) == plain_of(str(key))), None)
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
    others = _of_others(_loops(names), told)
    for signal in spelled:
        if signal in found:
            continue
        tiers: dict[int, list[int]] = {}
        for i, name in enumerate(names):
            tier = None if i in taken or name in others else tier_of(name, signal)
            if tier is not None and (signal in needed or signal not in TAGGED or rank_of(name) != DOUBTFUL):
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
        *head, end = up_to_signal(names[found["SP"]]) or [""]
        alone = [i for i, name in enumerate(names) if i not in taken and plain_of(name) == "".join(head)]
        if head and end in SUFFIXES["SP"] and len(alone) == 1:
            found["PV"] = alone[0]
    missing = [s for s in needed if s not in found]
    if missing:
        if what == "column" and _is_data(names):
            msg = f"{source}: times and numbers ({there}) where the column names should be; a header line is needed"
            raise RecordError(msg)
        other = ", or, where another column holds the tags, columns={'tag': 'its name'}"
        if what == "column":
            other = ", or which are 'tag', 'time' and 'value' of a row per value" if missing == ["PV", "OP"] else ""
        msg = (
            f"{source}: no {what} for {' and '.join(missing)}; the file has {there or f'no named {what}'}; "
            f"give the mapping, for example {argument}={{{missing[0]!r}: 'name in the file'}}"
            f"{other}{_figures(names, missing)}"
        )
        raise RecordError(msg)
    return found


def _figures(names: Sequence[str], missing: Sequence[str]) -> str:
    """Return what ends a refusal where a missing signal's maximum, or another such figure, is there; else ""."""
    figures = [
        n for n in names if rank_of(n) is None and any(tier_of(aggregate_of(n)[0], s) is not None for s in missing)
    ]
    return f"; {figures[0]!r} is a figure of its intervals, not the signal" if figures else ""


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
