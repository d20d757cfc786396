"""How a value stands in a CSV file: one law for every table that leaves the workbench."""

from __future__ import annotations

import math

__all__ = ["DIGITS", "cell", "harmless"]

DIGITS = 12


def cell(value: object) -> str:
    """Return a value as a CSV cell: numbers at 12 digits, nothing for nan or None, text that no spreadsheet runs."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if math.isnan(value):
            return ""
        return f"{value:.{DIGITS}g}"
    return harmless(str(value))


def harmless(text: str) -> str:
    """Return a text so that no spreadsheet takes it for a formula, also behind blanks and control characters."""
    return f"'{text}" if text.lstrip().startswith(("=", "+", "-", "@")) or text.startswith(("\t", "\r", "\n")) else text
