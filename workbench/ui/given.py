"""What passes between the page and the browser: file names, tables and line styles as plain values."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from workbench.report.tables import Table

__all__ = ["dashes", "safe_name", "table_content"]


def safe_name(name: str) -> str:
    """Return a file name without anything that could lead elsewhere."""
    kept = re.sub(r"[^A-Za-z0-9._-]+", "_", Path(name.replace("\\", "/")).name).lstrip(".")
    return kept[-80:] or "record.csv"


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
