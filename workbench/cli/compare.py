"""The `workbench compare` command: options, and the table that it prints."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from workbench.report.compare import Comparison

__all__ = ["compare"]

# Of all figures those that a terminal has room for, with their heads.
SHOWN = {
    "objective": "J",
    "mean_square_error": "mean square error",
    "pv_sd": "sd of PV",
    "valve_travel": "valve travel, %",
    "reversals": "reversals",
    "settling_time": "settling",
}


def compare(
    results: Annotated[
        list[Path], typer.Argument(metavar="RESULTS", help="results.json files, report folders, or folders of these.")
    ],
    base: Annotated[
        str, typer.Option("--base", metavar="NAME", help="The case that the others are held against (the first).")
    ] = "",
    include: Annotated[
        list[str] | None, typer.Option("--include", metavar="PATTERN", help="Cases by name, such as 'Case*'.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where compare.html and compare.csv go.")
    ] = None,
) -> int:
    """Lay the cases of several runs beside each other: settings, figures, verdicts and differences from one of them."""
    from rich.console import Console
    from rich.text import Text

    from workbench.report.compare import comparison, comparison_csv
    from workbench.report.compared import read_all

    read, notes = read_all(results)
    found = comparison(read, base, include or [], notes)
    console = Console(width=None if sys.stdout.isatty() else 160, highlight=False, markup=False)
    for table in (_cases(found), _estimates(found)):
        if table is not None:
            console.print(table)
    for note in found.notes:
        console.print(Text(f"Note: {note}"))
    if out is not None:
        from workbench.report.compare_page import comparison_page
        from workbench.report.files import write_files

        write_files({"compare.html": comparison_page(found), "compare.csv": comparison_csv(found)}, out)
        typer.echo(f"Written: {out / 'compare.html'}, {out / 'compare.csv'}")
    return 0


def _cases(found: Comparison) -> Table | None:
    from rich.table import Table
    from rich.text import Text

    from workbench.report.compare import cycle_words, difference_words
    from workbench.report.tables import shown
    from workbench.report.words import legible, setting

    base = found.base
    if base is None:
        return None
    names = [name for name in SHOWN if not all(math.isnan(line.figure(name)) for line in found.lines)]
    table = Table(box=None, pad_edge=False)
    several = len(found.results) > 1
    if several:
        table.add_column("scenario", overflow="fold")
    table.add_column("case", overflow="fold")
    for head in ("Kc", "Ti, s", "Td, s", *(SHOWN[name] for name in names)):
        table.add_column(head, justify="right")
    table.add_column("in the long run", overflow="fold")
    above = ""
    for line in (base, *found.others):
        cells = []
        for name in names:
            difference = difference_words(line, base, name) or line.doubt(name)
            text = shown(name, line.figure(name))
            cells.append(f"{text} ({difference})" if difference else text)
        mark = " (base)" if line is base and found.others else ""
        label = line.results.label
        names_of = [Text(legible(label) if label != above else "")] if several else []
        name = line.name.removeprefix(f"{label}: ") if several else line.name
        above = label
        pid = [setting(value, line.entry.digits) for value in (line.entry.Kc, line.entry.Ti, line.entry.Td)]
        table.add_row(*names_of, Text(legible(name) + mark), *pid, *cells, cycle_words(line.entry))
    return table


def _estimates(found: Comparison) -> Table | None:
    from rich.table import Table
    from rich.text import Text

    from workbench.report.compare import estimate_table
    from workbench.report.words import legible

    made = estimate_table(found)
    if made is None:
        return None
    table = Table(box=None, pad_edge=False)
    table.add_column("estimate", overflow="fold")
    for row in made.rows:
        table.add_column(f"{row.label}, {row.unit}" if row.unit else row.label, justify="right")
    for i, name in enumerate(made.heads):
        cells = [row.cells[i] for row in made.rows]
        table.add_row(Text(legible(name)), *(f"{c.text} ({c.small})" if c.small else c.text for c in cells))
    return table
