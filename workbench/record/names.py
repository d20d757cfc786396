"""What the name of a column, or of a tag, tells: usual spellings, suffixes, units, qualities."""

from __future__ import annotations

import re

from workbench.record.aggregates import DOUBTFUL, aggregate_of, rank_of
from workbench.record.units import TIME_UNITS

__all__ = [
    "CALENDAR",
    "CLOCK",
    "DAY",
    "LOOP",
    "MILLI",
    "OWN",
    "QUALITY_WORDS",
    "SPELLINGS",
    "SUFFIXES",
    "TAGGED",
    "names_time",
    "plain_of",
    "rated_by",
    "split_tag",
    "stems",
    "tier_of",
    "tokens_of",
    "up_to_signal",
]

TAGGED = ("SP", "PV", "OP", "MODE", "valve_position")

# The signal's own name first; the spellings after it count less where a file holds both.
OWN: dict[str, tuple[str, ...]] = {
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
SPELLINGS: dict[str, tuple[str, ...]] = {
    "time": (
        *("seconds", "second", "sec", "secs", "s", "datetime", "date", "elapsed", "elapsedtime", "minutes", "hours"),
        *("tstamp", "iptrendtime", "xvalue", "datenum", "zeit", "zeitstempel", "horodatage", "temps"),
        *("epoch", "epochtime", "epochseconds", "epochms", "unixtime", "unixtimestamp", "posixtime"),
        *("sourcetimestamp", "sourcetime"),  # OPC UA's; the server's own is when it was told
    ),
    "SP": ("setpt", "spt", "setpointvalue", "target", "reference", "r", "sv", "sollwert", "consigne"),
    "PV": ("processvalue", "processvariable", "measurement", "measured", "measuredvalue", "y", "istwert", "mesure"),
    "OP": (
        *("output", "co", "mv", "out", "controlleroutput", "manipulatedvariable", "outputvalue", "u", "lmn"),
        *("stellwert", "stellgre", "stellgroesse", "sortie"),  # Stellgröße, of which letters without marks are left
    ),
    "MODE": (
        *("mod", "controllermode", "controlmode", "operatingmode", "modeactual", "modeact", "automanual", "automan"),
        *("betriebsart", "betriebsmodus", "modus", "modedemarche", "modo"),
    ),
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
        "dataintegrity",
        *("qualitt", "qualitaet", "qualit", "qualite"),  # Qualität, qualité, of which letters without marks are left
    ),
    "unit": (
        *("uom", "eu", "engunit", "engunits", "engineeringunit", "engineeringunits"),
        *("einheit", "unite"),
    ),
    "tag": (
        *(
            "tagid",
            "point",
            "pointname",
            "pointid",
            "item",
            "itemid",
            "itemname",
            "name",
            "signal",
            "variable",
            "logname",
        ),
        # Not InfluxDB's _field: it is the same for all loops of a file, and two would be read as one.
        *("varname", "variablename", "path", "tagpath", "object", "attribute", "series", "metric"),
        *("nodeid", "browsename", "displayname"),
        *("variablenname", "messstelle", "kennzeichen", "bezeichnung", "nom", "nomvariable"),
        *("repre", "repere", "tiquette", "etiquette", "etiqueta"),  # repère, étiquette, without the letters with marks
    ),
    "value": (
        "val",
        "reading",
        "average",
        "avg",
        "pointvalue",
        "itemvalue",
        "varvalue",
        "vvalue",
        "iptrendvalue",
        "floatvalue",
        *("wert", "valeur"),
    ),
}
SUFFIXES: dict[str, tuple[str, ...]] = {
    "time": (),
    "SP": ("sp", "spt", "setpoint", "sv", "sollwert", "consigne"),
    "PV": ("pv", "measurement", "meas", "measured", "istwert", "mesure"),
    "OP": ("op", "co", "mv", "out", "output", "lmn", "stellwert", "sortie"),
    "MODE": ("mode", "mod", "md", "betriebsart"),
    "valve_position": ("zt", "zi", "pos", "position", "stem"),
    "quality": (),
    "unit": (),
    "tag": (),
    "value": (),
}
# Whose attribute the tag of a tall file is: PV, OP of several.
LOOP = ("loop", "loopname", "element", "asset", "block", "module", "controller", "equipment", "instrument", "object")
# A day and a clock in columns of their own.
DAY, CLOCK = ("date", "datum", "fecha"), ("time", "uhrzeit", "zeit", "heure", "hora")
# A year, month, day, hour and minute in columns of their own, and perhaps a second.
CALENDAR = {
    "year": ("year", "years", "yr", "yyyy", "jahr", "annee"),
    "month": ("month", "months", "mon", "monat", "mois"),
    "day": ("day", "days", "dd", "jour"),
    "hour": ("hour", "hours", "hr", "hh", "stunde", "heure"),
    "minute": ("minute", "minutes", "min", "mins"),
    "second": ("second", "seconds", "sec", "secs", "ss", "sekunde", "seconde"),
}
# FactoryTalk's and others': the milliseconds of a time in whole seconds.
MILLI = ("millitm", "millisecond", "milliseconds", "millis", "msec", "ms")
# InfluxDB's series have one name of all that tells them. WinCC's: the Time_ms beside it counts millionths of a day.
_FIRST = {"time": ("timestring",), "tag": ("influxdbseries",)}
# CV is the controlled variable beside an MV or OP, and the controller's beside a PV: the last to be looked at for both.
_LAST = {"PV": ("cv", "controlledvariable"), "OP": ("cv", "controlvariable")}
_PINS = ("pvin", "pvout")  # PCS 7's, where PV is no pin of its own; PV_Out is no output
_APART = 4  # tiers that the signal itself, its last values, interpolated ones and so on each have
_CV = (DOUBTFUL + 1) * _APART
# What control systems write after the signal: FIC101/PID1/PV.CV, FIC101/PID1/MODE.ACTUAL.
_AFTER = ("cv", "value", "val", "actual")
# A quality beside a value bears the value's name and one of these: PV_Q, PV.Status, "FIC101.PV Quality", Quality_PV.
QUALITY_WORDS = (
    *(*OWN["quality"], *SPELLINGS["quality"], "dataquality", "isgoodquality", "isquestionable", "qstatus"),
    *("good", "percentgood", "pctgood", "bad", "isbad", "valid", "isvalid", "validity", "invalid", "iptrendqstatus"),
    *("st", "q"),
)

# Unit words that stand after a name without brackets too, as in "valve position %" written out.
_UNITS = ("pct", "percent", "eu", "ma")
# And what may: in brackets, or after a comma.
_BEHIND = re.compile(r"\s*(?:\([^()]*\)|\[[^][]*\]|,[^,]*)\s*$")
_ENDINGS = {*_AFTER, *_UNITS, *(word for words in SUFFIXES.values() for word in words)}
_BRACKETS = re.compile(r"\([^)]*\)|\[[^]]*\]")


def plain_of(name: str) -> str:
    """Lower case without units in brackets and without anything but letters and digits."""
    return re.sub(r"[^0-9a-z]", "", _BRACKETS.sub("", name.lower()))


def tokens_of(name: str) -> list[str]:
    """Return the words of a name, of letters and digits, in lower case."""
    return [part for part in re.split(r"[^0-9a-z]+", re.sub(r"[()\[\]]", " ", name.lower())) if part]


def tier_of(name: str, signal: str) -> int | None:
    """Return how well a column's name fits a signal: 0 its own name, 1 a usual spelling, 2 a tag's suffix, then CV.

    -1, before all of these: a name that is right even beside the signal's own. Aggregates such as averages come after
    what is the signal itself.
    """
    bare, rank = (aggregate_of(name)[0], rank_of(name)) if signal in TAGGED else (name, 0)
    if rank is None:
        return None
    tier = _fit(bare, signal)
    head, comma, unit = bare.rpartition(",")
    if tier is None and comma and not {*_ENDINGS, *QUALITY_WORDS} & {*tokens_of(unit)[-1:]}:
        # A unit may stand after a comma: "PV, m3/h".
        tier = _fit(head, signal)
        tier = None if tier is None else max(tier, 1)
    return None if tier is None else tier + _APART * rank


def _fit(name: str, signal: str) -> int | None:
    plain, tokens = plain_of(name), tokens_of(name)
    if plain in _FIRST.get(signal, ()):
        return -1
    if plain in OWN[signal]:
        return 0
    if plain in SPELLINGS[signal] or (signal == "quality" and plain in QUALITY_WORDS):
        return 1
    if plain in _LAST.get(signal, ()):
        return _CV
    if len(tokens) < 2:
        return None
    if signal == "time":
        head = "".join(tokens[:-1])
        return 0 if tokens[-1] in TIME_UNITS and head in OWN["time"] + SPELLINGS["time"] else None
    tokens = up_to_signal(name)
    if "".join(tokens) in OWN[signal] + SPELLINGS[signal]:
        return 1
    # "FIC101 Set Point": a suffix may be two words.
    ends = {tokens[-1], "".join(tokens[-2:]) if len(tokens) > 2 else ""}
    if "".join(tokens[-2:]) in _PINS:
        return 3 if signal == "PV" else None
    return 2 if len(tokens) > 1 and ends & {*SUFFIXES[signal]} else None


def up_to_signal(name: str) -> list[str]:
    """Return a name's tokens up to its signal: without a unit, in brackets or not, and what systems write after it."""
    tokens = tokens_of(name)
    if tokens and tokens[-1] not in _ENDINGS:
        tokens = tokens_of(_BRACKETS.sub(" ", name)) or tokens
    if len(tokens) > 1 and tokens[-1] in _UNITS:
        tokens = tokens[:-1]
    named = len(tokens) > 2 or tokens[:1] in (["pv"], ["op"], ["sp"])
    return tokens[:-1] if named and tokens[-1] in _AFTER else tokens


def split_tag(tag: str) -> tuple[str, str] | None:
    """Return (the loop's name, the signal) of a historian's tag or a column by its ending, None where that tells none.

    FIC101.PV is PV of FIC101, FIC101/PID1/PV.CV that of FIC101/PID1. A unit may stand behind: FIC101.PV (m3/h). Of an
    aggregate it is the same, FIC101.PV_AVG; a figure that is no signal, as FIC101.PV_MAX, tells none.
    """
    whole, (tag, _) = tag, aggregate_of(tag)
    if rank_of(whole) is None:
        return None
    pieces = [(m.group(0).lower(), m.start()) for m in re.finditer(r"[0-9A-Za-z]+", tag)]
    for behind in (_UNITS, _AFTER):
        if len(pieces) > 2 and pieces[-1][0] in behind:
            pieces.pop()
    for words in (2, 1):  # FIC101 Set Point
        ending = "".join(word for word, _ in pieces[-words:])
        signal = next((s for s in TAGGED if ending in SUFFIXES[s]), None)
        if ending in _PINS:
            return None
        name = tag[: pieces[-words][1]].rstrip(" ._-/:\\|[(") if signal is not None and len(pieces) > words else ""
        if signal is not None and name:
            return name, signal
    bare = _BEHIND.sub("", tag)
    return split_tag(bare) if bare != tag else None


def names_time(name: str) -> bool:
    """Whether a column's name is one of times: Time, Timestamp (UTC), PV time."""
    return tier_of(name.strip(), "time") is not None or bool(
        {*tokens_of(name)} & {"timestamp", "datetime", *DAY, *CLOCK}
    )


def rated_by(name: str) -> set[str]:
    """Return what a column may hold the quality of, by its name: plain names, none where it is no quality's."""
    plain, tokens = plain_of(name), tokens_of(name)
    whole = {plain.removesuffix(word) for word in QUALITY_WORDS if plain.endswith(word)}
    if len(tokens) > 1 and tokens[0] in QUALITY_WORDS:
        whole.add("".join(tokens[2:] if tokens[1] in ("of", "for") else tokens[1:]))
    return {stem for one in whole for stem in stems(one)}


def stems(plain: str) -> set[str]:
    """Return a plain name as it is and without what control systems write after it."""
    return {plain, *(plain.removesuffix(word) for word in _AFTER)} - {""}
