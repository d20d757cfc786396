"""A session's page as a document: its template, its pictures and the bridge, made anew for each browser tab."""

from __future__ import annotations

from pathlib import Path

from bokeh.document import Document
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from workbench.report import palette
from workbench.ui.fields import DEFAULTS, FIELDS, GROUPS
from workbench.ui.figures import LEGENDS, MAP_FIGURES
from workbench.ui.given import dashes
from workbench.ui.load import Loaded
from workbench.ui.page import LARGEST_UPLOAD, VIEWS, Page
from workbench.ui.state import MOST_CASES

__all__ = ["open_page"]

TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def open_page(document: Document, loaded: Loaded | None, data: Path | None = None) -> Page:
    """Make one session's page in its document; data: a record to read at once."""
    page = Page(document, loaded, data)
    document.title = "Stiction Workbench"
    document.template = TEMPLATES.get_template("page.html.j2")
    variables = {
        "groups": GROUPS,
        "fields": {
            path: {
                "slider": f.slider,
                "reach": f.reach,
                "signed": f.signed,
                "when": f.when,
                "units": f.units,
                "otherwise": f.otherwise,
                "whole": f.whole,
                "usual": DEFAULTS[path],
            }
            for path, f in FIELDS.items()
        },
        "views": VIEWS,
        "map_figures": MAP_FIGURES,
        "cases": [{"color": s["color"], "dash": dashes(s)} for s in map(palette.case_style, range(MOST_CASES))],
        "legends": {
            name: [(text, look["color"], dashes(look)) for text, look in lines] for name, lines in LEGENDS.items()
        },
        "largest": LARGEST_UPLOAD,
    }
    document.template_variables.update(variables)
    page.bridge.name = "bridge"
    with document.models.freeze():  # else every root counts all models again
        for root in (*page.pictures.figures.values(), page.bridge):
            document.add_root(root)
    document.on_session_destroyed(lambda _context: page.close())
    return page
