"""What passes between the page and the browser: file names, tables and line styles as plain values."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from workbench.errors import ScenarioError
from workbench.report.tables import Table

if TYPE_CHECKING:
    from workbench.ui.work import Found, ReadRecord

__all__ = ["dashes", "files_named", "find_file", "found_words", "record_words", "safe_name", "table_content"]


def safe_name(name: str) -> str:
    """Return a file name of letters, digits, `.`, `_` and `-`, which leads nowhere else."""
    kept = re.sub(r"[^\w.-]+", "_", Path(name.replace("\\", "/")).name)
    # No more bytes than any file system allows, four a character.
    return kept[-60:].lstrip(".") or "record.csv"


def table_content(table: Table) -> dict[str, Any]:
    """Return a report's table as plain values."""
    return {
        "heads": list(table.heads),
        "note": table.note,
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


def find_file(path: Path, named: str) -> None:
    """Put a file that was opened beside the scenario `path` where that names it. Raises `ScenarioError`."""
    folder = path.parent.resolve()
    wanted, own = (folder / named).resolve(), folder / safe_name(named)
    if not wanted.is_relative_to(folder):
        raise ScenarioError(f"{path.name}: {named} given; open that file here first, and name it by itself")
    try:
        if not own.is_file():
            raise ScenarioError(f"{path.name}: {named} given; open that file here first, then the scenario")
        if own != wanted:  # a browser does not tell the folder of what it opens
            wanted.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(own, wanted)
    except OSError as error:
        raise ScenarioError(f"{path.name}: {named} given; cannot be had here ({error.strerror})") from None


def files_named(data: object) -> list[str]:
    """Return the files that a scenario's plain data names."""
    if isinstance(data, list):
        return [name for one in data for name in files_named(one)]
    if not isinstance(data, dict):
        return []
    own = [value for key, value in data.items() if key in ("data", "file") and isinstance(value, str)]
    return own + [name for value in data.values() for name in files_named(value)]
