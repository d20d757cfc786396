"""compare.html: runs beside each other on one page, in one table and one figure."""

from __future__ import annotations

from markupsafe import Markup

from workbench.report.compare import Comparison, estimate_table, tables, which
from workbench.report.figures import Curves, overlaid
from workbench.report.style import CASES, svg_text
from workbench.report.templating import environment, style_sheet
from workbench.report.words import join, label

__all__ = ["comparison_page", "drawn"]


def drawn(found: Comparison) -> tuple[list[Curves], list[str]]:
    """Return what the figure shows, the base first, and what it leaves out and why, in sentences.

    At most as many cases as there are colours, of those that are held against the base: what lived through something
    else, or is the other loop of a cascade, has nothing to lie over.
    """
    if found.base is None:
        return [], []
    lines = [line for line in (found.base, *found.others) if not line.apart]
    without = [line for line in lines if line.entry.trend is None]
    with_signals = [(line, line.entry.trend) for line in lines if line.entry.trend is not None]
    shown = with_signals[: len(CASES)]
    names = [line.entry.name for line, _ in shown]
    curves = []
    for line, trend in shown:
        name = line.entry.name
        # The legend is narrow: what tells two of one name apart must not be cut off.
        name = name if names.count(name) == 1 else f"{label(name, 15)} ({label(line.results.label, 12)})"
        curves.append(Curves(name, trend.sp, trend.pv, trend.op))
    said = []
    if len(lines) <= len(found.others):
        said.append("The figure shows those that are held against the base.")
    if without:
        said.append(f"{which(without, found.lines)}: the file holds no signals to draw; run its scenario again.")
    if len(with_signals) > len(CASES):
        said.append(f"The figure shows the first {len(CASES)} of {len(with_signals)} cases; --include chooses others.")
    return curves, said


def comparison_page(found: Comparison) -> str:
    """Return compare.html, in one piece: tables, notes and the figure of PV and OP; the same to the byte each time."""
    curves, left_out = drawn(found)
    picture = (
        svg_text(overlaid(curves, "OP (%)"), "overlay", "PV and OP of the cases over each other") if curves else ""
    )
    names = [result.label for result in found.results]
    return (
        environment()
        .get_template("compare.html.j2")
        .render(
            css=style_sheet("report.css"),
            title=f"Comparison of {join(names)}" if len(names) < 4 else f"Comparison of {len(names)} runs",
            files=[(result.label, result.title, str(result.path)) for result in found.results],
            base=None if found.base is None else found.base.name,
            notes=[*found.notes, *left_out],
            tables=tables(found),
            estimates=estimate_table(found),
            picture=Markup(picture),  # noqa: S704 - matplotlib has escaped its text
        )
    )
