"""The controller's mode as plants write it: which samples were not in automatic, and the shares in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress

__all__ = ["manual_share", "mode_words"]

MANUAL = frozenset(
    {"MAN", "MANUAL", "M", "IMAN", "LO", "HAND", "OOS", "OFF", "TRK", "TRACK", "TRACKING", "ROUT", "INITMAN"}
)
SHOWN = 4  # modes named one by one


def _counts(mode: Sequence[str]) -> Counter[str]:
    counts: Counter[str] = Counter()
    for text, many in Counter(mode).items():
        name = text.strip().upper()
        with suppress(ValueError):
            name = f"{float(name):g}"
        counts[name or "blank"] += many
    return counts


def _is_manual(name: str, modes: int) -> bool:
    # A code 0 is manual by custom; alone in the record it tells nothing.
    return name.split(".")[0] in MANUAL or (name == "0" and modes > 1)


def manual_share(mode: Sequence[str]) -> float:
    """Return the share of samples, 0 to 1, in which the controller did not move OP.

    mode: text per sample, shape (N,): MAN, MANUAL, tracking, out of service and the like, or the code 0 where other
    codes occur too. Modes that are not known count as automatic.
    """
    counts = _counts(mode)
    total = sum(counts.values())
    return sum(n for name, n in counts.items() if _is_manual(name, len(counts))) / total if total else 0.0


def mode_words(mode: Sequence[str]) -> str:
    """Return the shares of the modes in words, "AUTO 90.0 %, MAN 10.0 %", the most frequent first."""
    counts = _counts(mode)
    total = sum(counts.values())
    told = [f"{name} {100.0 * many / total:.1f} %" for name, many in counts.most_common(SHOWN)]
    return ", ".join(told) + (f" and {len(counts) - SHOWN} more" if len(counts) > SHOWN else "")
