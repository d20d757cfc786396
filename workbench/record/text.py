"""A text file as it lies on the disk: how its characters are encoded, and what parts its cells."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import pairwise

from workbench.errors import RecordError

__all__ = ["HEAD", "arrow_text", "delimiter", "encoding_of", "fixed_width", "uncommented"]

HEAD = 65536  # bytes: enough to tell how text is encoded, and text from a binary file
_DASHES = re.compile(r" *-+( +-+)+")
_LOOKED_AT = 20  # rows below a header
ZEROS = 0.9  # of every other byte, which western text in UTF-16 leaves zero


def encoding_of(head: bytes, source: str) -> str:
    """Return the encoding of a text file that begins with these bytes. Raises `RecordError` for what is no text."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    # UTF-16 without its mark.
    for name, zeros, others in (("utf-16-le", head[1::2], head[::2]), ("utf-16-be", head[::2], head[1::2])):
        if len(zeros) > 0 and zeros.count(0) > ZEROS * len(zeros) and 0 not in others:
            return name
    if any(b < 32 and b not in (9, 10, 12, 13) for b in head):
        msg = f"{source}: this is no text file (it holds binary bytes); CSV or Parquet is needed"
        raise RecordError(msg)
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        # The head may end within a character; anything before that is another encoding.
        if error.start < len(head) - 3 or len(head) < HEAD:
            return "cp1252"
    return "utf-8-sig"


def delimiter(line: str, below: Sequence[str] = ()) -> str:
    """Return what parts the cells of a CSV file's line: tab, semicolon, bar or comma, and spaces where none is.

    below: lines below it; a mark that is in none of them is part of a name, as in Unit|FIC101|PV or ns=2;s=FIC101.PV.
    """
    bare, *others = (_unquoted(one) for one in (line, *below))
    # A comma may be a decimal comma or part of a name where another delimiter is there.
    found = [mark for mark in ("\t", ";", "|", ",") if mark in bare]
    used = [mark for mark in found if any(mark in other for other in others)]
    return next(iter(used or found), " " if len(bare.split()) > 1 else ",")


def _unquoted(line: str) -> str:
    """Return a line with what stands in quotes left out, and a word in place of it."""
    return "".join(part if i % 2 == 0 else "x" for i, part in enumerate(line.split('"')))


def fixed_width(lines: Sequence[str]) -> Callable[[str], str]:
    """Return what makes lines of fixed columns, as databases print them, lines with tabs; else what leaves them alone.

    lines: a file's first. Dashes under the heads show such columns, if nothing stands between them or beyond the last.
    """
    at = next((k for k, line in enumerate(lines) if _DASHES.fullmatch(line.rstrip()) and k > 0), None)
    if at is None:
        return str
    spans = [dashes.span() for dashes in re.finditer("-+", lines[at])]
    gaps = [*((a, b) for (_, a), (b, _) in pairwise(spans)), (spans[-1][1], None)]
    if any("\t" in line or any(line[a:b].strip() for a, b in gaps) for line in lines[at - 1 : at + _LOOKED_AT]):
        return str

    def cut(line: str) -> str:
        if not line.strip() or _DASHES.fullmatch(line.rstrip()):
            return "\n"
        return "\t".join(line[a:b].strip() for a, b in spans) + "\n"

    return cut


def uncommented(lines: list[str], is_data: Callable[[str], bool]) -> list[str]:
    """Return a file's first lines, with the names that stand behind a # right above rows of data as a header.

    is_data: whether a cell is a number or a time. numpy writes such, and gnuplot reads it.
    """
    at = next((k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), 0)
    if at == 0 or not lines[at - 1].lstrip().startswith("#"):
        return lines
    head = lines[at - 1].lstrip().lstrip("#").lstrip(" ")
    mark = delimiter(lines[at])

    def cells(line: str) -> list[str]:
        return line.split() if mark == " " else [cell.strip().strip('"') for cell in line.split(mark)]

    names, data = cells(head), cells(lines[at])
    if len(names) != len(data) or len(data) < 2 or any(map(is_data, names)) or not all(map(is_data, data)):
        return lines
    return [*lines[: at - 1], head, *lines[at:]]


def arrow_text(cell: object) -> str:
    """Return a value of an Arrow column as text, "" for none; older writers keep text as bytes."""
    return "" if cell is None else (cell.decode(errors="replace") if isinstance(cell, bytes) else str(cell)).strip()
