"""What passes between the page and the browser: file names, tables and line styles as plain values."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from workbench.report.tables import Table

if TYPE_CHECKING:
    from workbench.ui.work import Found, ReadRecord

__all__ = ["dashes", "found_words", "record_words", "safe_name", "table_content"]


def safe_name(name: str) -> str:
    """Return a file name of letters, digits, `.`, `_` and `-`, which leads nowhere else."""
    kept = re.sub(r"[^\w.-]+", "_", Path(name.replace("\\", "/")).name)
    # No more bytes than any file system allows, four a character.
    return kept[-60:].lstrip(".") or "record.csv"


def table_content(table: Table) -> dict[str, Any]:
    """Return a report's table as plain values."""
    return {
        "heads": list(table.heads),
        "rows": [
            {"label": row.label, "unit": row.unit, "cells": [{"text": c.text, "small": c.small} for c in row.cells]}
            for row in table.rows
        ],
    }


def dashes(look: Mapping[str, Any]) -> str:
    """Return a line style's dashes as SVG writes them."""
    dash = look["linestyle"]
    return "" if dash == "-" else " ".join(f"{2 * part:g}" for part in dash[1])


def record_words(name: str, record: ReadRecord | None) -> dict[str, Any]:
    """Return a record's name and what was kept of it."""
    return {"name": name, "summary": [] if record is None else list(record.summary)}


def found_words(found: Found | None) -> dict[str, Any] | None:
    """Return an estimate's verdict with its reasons and tables; None where there is none."""
    if found is None:
        return None
    return {
        "verdict": found.verdict.replace("_", " "),
        "sentences": list(found.sentences),
        "reasons": list(found.reasons),
        "parameters": table_content(found.parameters),
        "detection": found.detection,
        "evidence": table_content(found.evidence),
    }
