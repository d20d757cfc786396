"""The controller's mode as plants write it: which samples were not in automatic, and the shares in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress

__all__ = ["MANUAL", "manual_share", "mode_kinds", "mode_words"]

MANUAL = "manual"
_KINDS = {
    MANUAL: {"MAN", "MANUAL", "M", "IMAN", "LO", "HAND", "OOS", "OFF", "TRK", "TRACK", "TRACKING", "ROUT", "INITMAN"},
    "automatic": {"AUTO", "AUT", "A", "AUTOMATIC"},
    "cascade": {"CAS", "CASC", "CASCADE", "C", "RCAS", "RSP", "REMOTE"},
}
_KIND_OF = {name: kind for kind, names in _KINDS.items() for name in names}
SHOWN = 4  # modes named one by one


def _name(text: str) -> str:
    name = text.strip().upper()
    with suppress(ValueError):
        name = f"{float(name):g}"
    return name or "blank"


def _counts(mode: Sequence[str]) -> Counter[str]:
    counts: Counter[str] = Counter()
    for text, many in Counter(mode).items():
        counts[_name(text)] += many
    return counts


def _kind(name: str, modes: int) -> str:
    # A code 0 is manual by custom; alone in the record it tells nothing.
    return MANUAL if name == "0" and modes > 1 else _KIND_OF.get(name.split(".")[0], name)


def mode_kinds(mode: Sequence[str]) -> list[str]:
    """Return per sample, shape (N,), what kind of mode it is: "manual", "automatic", "cascade", or its own name.

    mode: text per sample. Tracking, out of service and the like count as manual, for OP is then not the controller's;
    and so does the code 0 where other codes occur too. Codes and names that are not known are kinds of their own.
    """
    modes = len(_counts(mode))
    kinds = {text: _kind(_name(text), modes) for text in set(mode)}
    return [kinds[text] for text in mode]


def manual_share(mode: Sequence[str]) -> float:
    """Return the share of samples, 0 to 1, in which the controller did not move OP (see `mode_kinds`)."""
    return mode_kinds(mode).count(MANUAL) / len(mode) if mode else 0.0


def mode_words(mode: Sequence[str]) -> str:
    """Return the shares of the modes in words, "AUTO 90.0 %, MAN 10.0 %", the most frequent first."""
    counts = _counts(mode)
    total = sum(counts.values())
    told = [f"{name} {100.0 * many / total:.1f} %" for name, many in counts.most_common(SHOWN)]
    return ", ".join(told) + (f" and {len(counts) - SHOWN} more" if len(counts) > SHOWN else "")
