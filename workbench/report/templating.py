"""How pages are made from templates: everything escaped, nothing left undefined."""

from __future__ import annotations

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from workbench.report.words import legible

__all__ = ["environment", "style_sheet"]

TEMPLATES = Path(__file__).parent / "templates"


def environment() -> Environment:
    """Return the environment that every page is rendered in."""
    return Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=_finalize,
    )


def style_sheet(*names: str) -> Markup:
    """Return our own style sheets or scripts, to stand in a page as they are."""
    return Markup("".join((TEMPLATES / name).read_text(encoding="utf-8") for name in names))  # noqa: S704


def _finalize(value: object) -> object:
    """Make text fit for a page; what is markup already stays as it is."""
    return legible(value) if isinstance(value, str) and not isinstance(value, Markup) else value
