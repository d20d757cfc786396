"""How figures look in matplotlib: its settings, and an SVG of what it has drawn. Colours and lines: `palette`."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from typing import Any, Literal
from xml.sax.saxutils import escape

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from workbench.report.palette import CASES, LINEAR, OP, PREDICTION, PV, SP, VALVE, Style, case_style

__all__ = [
    "CASES",
    "LINEAR",
    "OP",
    "PREDICTION",
    "PV",
    "SP",
    "VALVE",
    "Style",
    "case_style",
    "new_figure",
    "styled",
    "svg_text",
]

_SETTINGS: Any = {
    "font.family": ["DejaVu Sans"],  # shipped with matplotlib: the layout is the same on every machine
    "font.size": 7.5,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#444444",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.fontsize": 7.0,
    "legend.frameon": True,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "legend.borderpad": 0.25,
    "legend.handlelength": 2.4,
    "figure.dpi": 72.0,
    "savefig.dpi": 72.0,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,  # points of 1/72 inch: below what print shows
    "text.parse_math": False,  # a $ in a case's name is a $
    "text.usetex": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "stiction-workbench",
}

FONT_STACK = "Arial, 'Liberation Sans', Helvetica, 'DejaVu Sans', sans-serif"


@contextmanager
def styled() -> Iterator[None]:
    """Apply the figures' settings for as long as the block lasts, and leave matplotlib's own as they were."""
    with mpl.rc_context(), warnings.catch_warnings():
        # A glyph that the layout font lacks is drawn by the reader's own font, as text stays text.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """Return an empty figure of that size, inch, with a canvas of its own (no pyplot)."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasSVG(figure)
    return figure


def svg_text(figure: Figure, name: str = "figure", title: str = "") -> str:
    """Return the figure as an `<svg>` element, the same to the byte for the same figure.

    name: prefixes the element ids, so that several figures fit in one page. title: for screen readers.
    """
    out = StringIO()
    with styled():
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(out, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return _lean(out.getvalue(), name, title)


_TAG = re.compile(r"<[^>]+>")  # matplotlib escapes > in attributes and in text
_COMMENT = re.compile(r"<!--.*?-->|<metadata>.*?</metadata>", re.DOTALL)
_PATH = re.compile(r'(?<=\sd=")[^"]*(?=")')
_TOKEN = re.compile(r"[A-Za-z]|-?[\d.]+(?:e-?\d+)?")
_ID = re.compile(r'\s+id="([^"]*)"')
_USED = re.compile(r'url\(#([^)]+)\)|href="#([^"]+)"')
_FONT = re.compile(r"font: ([^;\"]*?)([\d.]+px)[^;\"]*")


def _lean(svg: str, name: str, title: str) -> str:
    """Cut matplotlib's SVG to what is seen: no prologue, coordinates to 1/100 point, only the ids that are used."""
    svg = _COMMENT.sub("", svg[svg.index("<svg") :].rstrip())
    used = {a or b for a, b in _USED.findall(svg)}

    def font(match: re.Match[str]) -> str:
        return f"font-size: {match[2]}" + ("; font-weight: bold" if re.search(r"bold|[6-9]00", match[1]) else "")

    def tag(match: re.Match[str]) -> str:
        text = _ID.sub(lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", match[0])
        text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
        text = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', text)
        text = _FONT.sub(font, _PATH.sub(lambda m: _short_path(m[0]), text))
        return re.sub(r"\s*\n\s*", " ", text.replace("; font-family: 'DejaVu Sans'", ""))

    svg = re.sub(r"\n\s*(?=\n)|(?<=\n) +", "", _TAG.sub(tag, svg))
    head, rest = svg.split(">", 1)
    head += f' role="img" font-family="{FONT_STACK}"'
    inner = f"\n<title>{escape(title)}</title>" if title else ""
    return f"{head}>{inner}{rest}"


def _short_path(path: str) -> str:
    """Write path data with coordinates to 1/100 and without repeating the command letter."""
    parts: list[str] = []
    last = ""
    for item in _TOKEN.findall(path):
        if item.isalpha():
            # After M, further pairs would mean L already; writing each other letter once is enough.
            if item != last or item in "MZz":
                parts.append(item)
            last = item
        else:
            text = f"{float(item):.2f}".rstrip("0").rstrip(".")
            text = "0" if text in ("-0", "") else text
            if parts and not parts[-1].isalpha() and not text.startswith("-"):
                parts.append(" ")
            parts.append(text)
    return "".join(parts)
