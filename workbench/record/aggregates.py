"""What a name says of a historian's aggregates: FIC101.PV_AVG holds averages of FIC101.PV, FIC101.PV_MAX no signal."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

__all__ = ["DOUBTFUL", "aggregate_of", "aggregates_said", "is_average", "rank_of", "said_of"]

# Aggregates that are a signal, the nearest to it first, and what reading one means.
_SIGNALS = {
    "last": "the values at the end or the beginning of the historian's intervals",
    "interpolated": "values that the historian interpolated: what moved between those that it kept is lost",
    "average": "averages over the historian's intervals: they blunt a valve's slips, and what moved within one is lost",
    "doubtful": "named as a figure of the historian's intervals, unless that is its unit; a figure is not the signal",
}
_OTHER = "figure"  # what is of a signal and no signal; in brackets it may be a unit
DOUBTFUL = len(_SIGNALS)  # the rank of the last
_WORDS = {
    "last": r"last(?:[ _]?value)?|first(?:[ _]?value)?|sampled|snapshot",
    "interpolated": r"interp|interpolated",
    "average": r"(?:time[ _]?)?(?:weighted[ _]?)?(?:average|avg|mean)|twa|median",
    _OTHER: r"min|max|minimum|maximum|range|std|stdev|stddev|standard[ _]?deviation|variance|count|sum|total",
}
_LONGEST = 200  # characters of a name that are looked through; a line of a title may be taken for one
_ANY = f"(?i:{'|'.join(f'(?P<{kind}>{words})' for kind, words in _WORDS.items())})"
_EVERY = r"(?i:[ ._-]*\d+ ?(?:s|sec|m|min|h|hr)\b)?"  # the interval, as in PV_AVG_1MIN
_PARTED = r"[ ._:/\\|-]+"
_BRACKETED = r"[(\[][^()[\]]*[)\]]"
_UNIT = rf" ?{_BRACKETED}|,[^,]*|[ _]?%|[ _](?i:pct|percent|eu|ma)"
_FORMS = tuple(
    re.compile(form)
    for form in (
        # AVG(FIC101.PV)
        rf"{_ANY} ?[(\[](?P<bare>(?:[^()[\]]|{_BRACKETED})+)[)\]](?P<unit>.*)",
        # FIC101.PV (avg)
        rf"(?P<bare>.*\w.*?)[ ._-]*(?P<bracketed>[(\[]){_ANY}{_EVERY}[)\]](?P<unit>.*)",
        # FIC101.PV_AVG, FIC101.PV (m3/h) - Average, FIC101.PV_AVG (m3/h)
        rf"(?P<bare>.*?[\w)\]%]){_PARTED}{_ANY}{_EVERY}(?P<unit>{_UNIT})?",
        # Maximum of FIC101.PV, avg_FIC101_PV, max_PV; MIN_FLOW.PV is a loop's name, and a total output may be one.
        rf"{_ANY} of (?P<bare>.*)(?P<unit>)",
        rf"(?i:(?P<average>{_WORDS['average']})){_PARTED}(?P<bare>.*)(?P<unit>)",
        rf"(?!(?i:sum|total)){_ANY}{_PARTED}(?P<bare>[A-Za-z]+)(?P<unit>)",
    )
)


@lru_cache(maxsize=1 << 16)
def aggregate_of(name: str) -> tuple[str, str]:
    """Return a name without its aggregate, and which kind that is: "" where it names none."""
    for form in _FORMS if len(name) <= _LONGEST else ():
        if found := form.fullmatch(name.strip()):
            parts = found.groupdict()
            kind = next(kind for kind in _WORDS if parts.get(kind))
            kind = "doubtful" if kind == _OTHER and parts.get("bracketed") else kind
            return f"{parts['bare']}{parts['unit'] or ''}".strip(), kind
    return name, ""


def rank_of(name: str) -> int | None:
    """Return how near what a name says is to the signal itself, from 0 to `DOUBTFUL`; None of what is no signal."""
    kind = aggregate_of(name)[1]
    return None if kind == _OTHER else ["", *_SIGNALS].index(kind)


def is_average(name: str) -> bool:
    """Whether a name is that of averages and nothing else, as of the column of values in a tall file."""
    return re.fullmatch(f"(?i:{_WORDS['average']})", name.strip()) is not None


def aggregates_said(names: Mapping[str, str]) -> list[str]:
    """Return notes on the signals that are aggregates; names: of the columns, or tags, by signal."""
    kinds: dict[str, list[str]] = {}
    for signal, name in names.items():
        kinds.setdefault(aggregate_of(name)[1], []).append(f"{signal.replace('_', ' ')} ({name!r})")
    return [said_of(", ".join(kinds[kind]), kind) for kind in _SIGNALS if kind in kinds]


def said_of(what: str, kind: str = "average") -> str:
    """Return a note that `what` is an aggregate of this kind."""
    return f"{what}: {_SIGNALS[kind]}"
