"""Blocks of text cut into cells, or searched for lines, as a whole: many times faster than line by line.

For text of which nothing needs a closer look: lines that all end alike, and no quotes but around whole cells without a
mark. Of other text a block says None, and `csv` is to read it.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Block"]

_NEWLINE, _RETURN, _SPACE, _QUOTE = map(ord, '\n\r "')


class Block:
    """Text that ends where a line does; numbers: of its lines, shape (lines,), in the file.

    first: the number of the first line, or those of all.
    """

    def __init__(self, text: str, first: int | NDArray[np.int64]) -> None:
        self.text = text
        self._quoted = '"' in text
        # Whether all lines end alike, and no more than whole cells in quotes are in it.
        self._even = (not self._quoted or text.count('"') % 2 == 0) and (
            "\r" not in text or text.count("\r") == text.count("\r\n")
        )
        self._codes = _codes(text)
        self._ends = np.flatnonzero(self._codes == _NEWLINE)
        if text and not text.endswith("\n"):
            self._ends = np.append(self._ends, len(text))
        if isinstance(first, int):
            first = np.arange(first, first + (self._ends.size if self._even else sum(1 for _ in self.lines())))
        self.numbers = first

    def lines(self) -> io.StringIO:
        """Return the lines one by one."""
        return io.StringIO(self.text, newline="")

    def columns(self, mark: str, width: int, kept: Sequence[int]) -> list[list[str]] | None:
        """Return the cells of some columns, as `csv` has them without the spaces before a cell; None where `csv` must.

        mark: what parts the cells; width: of each line, cells. None where a line has another width, where quotes do
        more than to stand around a cell, and where spaces part the cells.
        """
        codes, lines = self._codes, self._ends.size
        if not self._even or mark == " " or width < 2:
            return None
        found = np.flatnonzero(codes == ord(mark))
        if found.size != lines * (width - 1):
            return None
        marks, begins = found.reshape(lines, width - 1), np.concatenate(([0], self._ends + 1))[:-1]
        if (marks[:, 0] < begins).any() or (marks[:, -1] > self._ends).any():
            return None
        ends = self._ends - (codes[self._ends - 1] == _RETURN)
        first, last = np.column_stack((begins, marks + 1)), np.column_stack((marks, ends))
        if not self._quoted:
            first, last = first[:, kept], last[:, kept]
        opening = codes.take(first, mode="clip")
        spaced = opening == _SPACE
        if self._quoted:
            quoted = (opening == _QUOTE) & (codes[last - 1] == _QUOTE) & (last - first > 1)
            if 2 * np.count_nonzero(quoted) != np.count_nonzero(codes == _QUOTE) or spaced.any():
                return None
            first, last, spaced = (first + quoted)[:, kept], (last - quoted)[:, kept], spaced[:, kept]
        out = []
        for k in range(len(kept)):
            cells = [self.text[a:b] for a, b in zip(first[:, k].tolist(), last[:, k].tolist(), strict=True)]
            out.append([cell.lstrip(" ") for cell in cells] if spaced[:, k].any() else cells)
        return out

    def having(self, pattern: re.Pattern[str]) -> Block:
        """Return the lines in which a pattern is found; all lines where some may be parts of a cell over several."""
        if not self._even:
            return self
        at = [found.start() for found in pattern.finditer(self.text)]
        chosen = np.searchsorted(self._ends, np.array(at, dtype=np.int64))
        chosen = chosen[np.diff(chosen, prepend=-1) > 0]
        bounds = np.concatenate(([0], self._ends + 1))
        spans = zip(bounds[chosen].tolist(), bounds[chosen + 1].tolist(), strict=True)
        lines = [self.text[a:b] for a, b in spans]
        if self._quoted and any(line.count('"') % 2 for line in lines):
            return self
        return Block("".join(lines), self.numbers[chosen])


def _codes(text: str) -> NDArray[Any]:
    """Return the number of each character, shape (characters,)."""
    try:
        return np.frombuffer(text.encode("latin-1"), np.uint8)
    except UnicodeEncodeError:
        return np.frombuffer(text.encode("utf-32-le"), np.uint32)
