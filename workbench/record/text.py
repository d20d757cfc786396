"""A text file as it lies on the disk: how its characters are encoded, and what parts its cells."""

from __future__ import annotations

from workbench.errors import RecordError

__all__ = ["HEAD", "arrow_text", "delimiter", "encoding_of"]

HEAD = 65536  # bytes: enough to tell how text is encoded, and text from a binary file
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


def delimiter(line: str) -> str:
    """Return what parts the cells of a CSV file's line: tab, semicolon, bar or comma, and spaces where none is."""
    bare = "".join(part for i, part in enumerate(line.split('"')) if i % 2 == 0)
    # A comma may be a decimal comma or part of a name where another delimiter is there.
    found = next((mark for mark in ("\t", ";", "|", ",") if mark in bare), "")
    return found or (" " if len(bare.split()) > 1 else ",")


def arrow_text(cell: object) -> str:
    """Return a value of an Arrow column as text, "" for none; older writers keep text as bytes."""
    return "" if cell is None else (cell.decode(errors="replace") if isinstance(cell, bytes) else str(cell)).strip()
