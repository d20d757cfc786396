"""The controller's mode as plants write it: which samples were not in automatic, and the shares in words."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import suppress

from workbench.model.checks import reads_as_number

__all__ = ["MANUAL", "manual_said", "manual_share", "mode_kinds", "mode_words", "modes_unknown", "zero_is_manual"]

MANUAL = "manual"
_KINDS = {
    MANUAL: {
        *("MAN", "MANUAL", "M", "IMAN", "LO", "HAND", "OOS", "OS", "OFF", "TRK", "TRACK", "TRACKING", "ROUT"),
        *("INITMAN", "OMAN", "LOCAL", "LOC", "MANU", "MANUEL", "MANUELL", "MANUALE"),
    },
    "automatic": {
        "AUTO",
        "AUT",
        "A",
        "AUTOMATIC",
        "AUTOMATIK",
        "AUTOMATIQUE",
        "AUTOMATICO",
        "AUTOMTICO",
        "LAUTO",
    },  # automático
    "cascade": {"CAS", "CASC", "CASCADE", "C", "RCAS", "RSP", "REMOTE", "KASKADE", "CASCATA", "CASCADA"},
}
# The bits of a fieldbus block's mode, as DeltaV keeps them: out of service, initialisation, local override, manual, ...
_BITS = dict.fromkeys(("1", "2", "4", "8", "128"), MANUAL) | {"16": "automatic", "32": "cascade", "64": "cascade"}
_KIND_OF = {name: kind for kind, names in _KINDS.items() for name in names}
SHOWN = 4  # modes named one by one
MUCH_MANUAL = 0.05  # share of a record in manual that is worth a word


def _name(text: str) -> str:
    name = text.strip().upper()
    with suppress(ValueError):
        name = f"{float(name):g}"
    return name or "blank"


def _names(mode: Sequence[str]) -> set[str]:
    return {_name(text) for text in set(mode)}


def _counts(mode: Sequence[str]) -> Counter[str]:
    counts: Counter[str] = Counter()
    for text, many in Counter(mode).items():
        counts[_name(text)] += many
    return counts


def _kind(name: str, modes: Collection[str]) -> str:
    """Return the kind of a mode; modes: the names of all in the record."""
    if name == "0" and len(modes) > 1:  # see `zero_is_manual`
        return MANUAL
    # Of the bits, several there are and one that small codes do not reach.
    if name in _BITS and len(modes) > 1 and _BITS.keys() >= set(modes) and {"8", "16"} & set(modes):
        return _BITS[name]
    return _KIND_OF.get(re.sub(r"[^0-9A-Z]", "", re.split(r"[.(\[]", name)[0]), name)


def mode_kinds(mode: Sequence[str]) -> list[str]:
    """Return per sample, shape (N,), what kind of mode it is: "manual", "automatic", "cascade", or its own name.

    mode: text per sample. Tracking, out of service and the like count as manual, for OP is then not the controller's;
    and so does the code 0 where other codes occur too. Codes and names that are not known are kinds of their own.
    """
    modes = _names(mode)
    kinds = {text: _kind(_name(text), modes) for text in set(mode)}
    return [kinds[text] for text in mode]


def modes_unknown(mode: Sequence[str]) -> list[str]:
    """Return the names and codes that are of no known kind, the most frequent first; none for a code that is alone."""
    counts, modes = _counts(mode), _names(mode)
    unknown = [name for name, _ in counts.most_common() if name != "blank" and _kind(name, modes) not in _KINDS]
    return [name for name in unknown if len(modes) > 1 or not reads_as_number(name)]


def zero_is_manual(mode: Sequence[str]) -> bool:
    """Whether a code 0 is taken for manual, as is the custom; alone in a record it tells nothing."""
    return "0" in (modes := _names(mode)) and len(modes) > 1


def manual_share(mode: Sequence[str]) -> float:
    """Return the share of samples, 0 to 1, in which the controller did not move OP (see `mode_kinds`)."""
    return mode_kinds(mode).count(MANUAL) / len(mode) if mode else 0.0


def mode_words(mode: Sequence[str]) -> str:
    """Return the shares of the modes in words, "AUTO 90.0 %, MAN 10.0 %", the most frequent first."""
    counts = _counts(mode)
    total = sum(counts.values())
    told = [f"{name} {100.0 * many / total:.1f} %" for name, many in counts.most_common(SHOWN)]
    return ", ".join(told) + (f" and {len(counts) - SHOWN} more" if len(counts) > SHOWN else "")


def manual_said(mode: Sequence[str] | None) -> tuple[str, ...]:
    """Return in words that the controller was in manual for much of a record; nothing else, or without modes."""
    share = manual_share(mode) if mode else 0.0
    if mode is None or share < MUCH_MANUAL:
        return ()
    said = f"the controller was in manual in {share:.0%} of the record ({mode_words(mode)})"
    return (f"{said}: a stretch in automatic alone would show the loop better",)
