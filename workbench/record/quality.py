"""A historian's quality of a value, in words or codes: which values are good."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["good_quality"]

_GOOD = re.compile(
    # NR and CLP are CENTUM's words for a normal value and for one at a limit.
    r"(good\w*|ok|valid|true|yes|normal|g|gut|bon(ne)?|nr|clp|192|0x0*c0)\b"
    r"(?!.*\b(bad|uncertain|questionable)\b)",
    re.IGNORECASE,
)
# A column named after a fault says "good" by 0 or False.
_FAULT_NAMES = ("bad", "questionable", "invalid", "fault", "error")
# Shares of what was good: Honeywell's confidence, and the quality of GE's historian, which writes 100 for a good value.
_SHARES = ("confidence", "percent", "pct")
_WHOLE = 100
# Of the values, from which a code that is not known is taken for the usual one, and the rare others for faults.
USUAL = 0.95
# OPC DA: the two high bits of a byte, 11 is good (OPC Data Access 3.00, 6.8). OPC UA: the two high bits of 32, 00 is
# good (OPC UA part 4, 7.39).
_DA_GOOD, _DA_MASK, _UA_LEAST = 192, 192, 1 << 30


def good_quality(
    texts: Sequence[str], name: str, whole: Counter[str] | None = None
) -> tuple[NDArray[np.bool_], Counter[str], str]:
    """Return (good, the qualities that are not good with their counts, a note) of a quality column, shape (N,).

    texts: the cells. name: of the column. whole: those of the whole column, counted, where texts are one tag's of
    several: what a code means is the same for all of them, and one tag may be bad throughout. Words ("Good", "Bad",
    "Uncertain" ...), OPC DA codes (192 and above good), OPC UA codes (below 2^30 good), confidences and per cents of
    what was good (0 and below bad) and 0/1 flags are known; of two flags the more frequent is taken as good unless the
    name tells ("IsGood", "Questionable"), and the note says so. Of codes that are not known the one of 95 % of the
    values or more is taken as good and the rare others as bad, for a good value lost costs less than a bad one kept;
    where none is so frequent all are taken as good. Either is noted. A blank quality is good: nothing was said against
    it.
    """
    kinds = Counter(texts) if whole is None else whole
    numbers = {text: number for text in kinds if (number := _whole(text)) is not None}
    plain = re.sub(r"[^a-z]", "", name.lower())
    fault = any(word in plain for word in _FAULT_NAMES)
    note = ""
    fine: dict[str, bool] = {}
    if numbers and len(numbers) == sum(1 for text in kinds if text):
        codes = set(numbers.values())
        if codes <= {0, 1}:
            good_code = 0 if fault else 1
            if not fault and "good" not in plain and "valid" not in plain:
                good_code = numbers[max(numbers, key=lambda text: kinds[text])]
                note = f"{name!r} holds flags; {good_code}, the more frequent, is taken as good"
            fine = {text: number == good_code for text, number in numbers.items()}
        elif max(codes) == _WHOLE or any(word in plain for word in _SHARES):
            fine = {text: number > 0 for text, number in numbers.items()}
        elif max(codes) < 256 and _DA_GOOD in {code & _DA_MASK for code in codes}:
            fine = {text: number & _DA_MASK == _DA_GOOD for text, number in numbers.items()}
        elif codes == {0} or max(codes) >= _UA_LEAST:
            fine = {text: 0 <= number < _UA_LEAST for text, number in numbers.items()}
        else:
            usual = max(numbers, key=lambda text: kinds[text])
            rare = len(codes) > 1 and kinds[usual] >= USUAL * sum(kinds[text] for text in numbers)
            fine = {text: number == numbers[usual] or not rare for text, number in numbers.items()}
            taken = (
                f"{usual}, the usual one, is taken as good, the rare others as bad" if rare else "all are taken as good"
            )
            note = f"{name!r} holds codes that are not known ({_some(numbers)}); {taken}"
    else:
        for text in kinds:
            fine[text] = bool(_GOOD.match(text)) != fault
    bad = Counter({text: many for text, many in Counter(texts).items() if text and not fine[text]})
    good = np.array([not text or fine[text] for text in texts], dtype=bool)
    return good, bad, note


def _some(numbers: dict[str, int]) -> str:
    return ", ".join(sorted(numbers)[:4])


def _whole(text: str) -> int | None:
    try:
        value = float(text) if not text.lower().startswith("0x") else float(int(text, 16))
    except (ValueError, OverflowError):
        return None
    return int(value) if value == value and abs(value) < 2**53 else None
