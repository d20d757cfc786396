"""What the report says of a detection: its verdict, why, and every statistic with its source, limits and meaning."""

from __future__ import annotations

from collections.abc import Sequence

from workbench.model.detection import Detection
from workbench.model.study import NamedEstimate
from workbench.report.tables import Cell, Row, Table
from workbench.report.words import duration, figure

__all__ = ["detection_table", "detection_words", "first_with"]


def detection_words(named: NamedEstimate, found: Detection) -> str:
    """Return the verdict of detection beside that of the estimate, and of which stretch the statistics are."""
    own = ""
    if "stiction" in (found.verdict, named.found.verdict):
        own = ", whose stem is among those tried above, so that the width told there may be another,"
    said = f"Without the fitted model{own or ','} detection says {found.verdict.replace('_', ' ')}"
    if found.verdict == named.found.verdict:
        said += ", as the estimate does."
    else:
        ours = named.found.verdict.replace("_", " ")
        said += f"; with the fitted model the estimate says {ours}, which is the verdict that counts."
    first, stop = found.stretch
    if stop - first < len(found.record):
        begin, end = found.record.time[first], found.record.time[stop - 1]
        said += (
            f" The published statistics and their figures are of the stretch at constant SP from {duration(begin)} to "
            f"{duration(end)}, in which PV cycles most strongly: a setpoint change would outweigh the cycle."
        )
    return said


def first_with(estimates: Sequence[NamedEstimate], index: int) -> str:
    """Return the name of an earlier estimate from the same record, under which its evidence stands, or nothing."""
    mine = estimates[index].detection
    return next((e.name for e in estimates[:index] if mine is not None and e.detection is mine), "")


def detection_table(found: Detection) -> Table:
    """Return every statistic: what it measures and by whom, its value, its limits, and what it says here."""
    rows = []
    decided = True
    for one in found.statistics:
        cells = (Cell(figure(one.value, 3)), Cell(one.says), Cell(one.limits), Cell(one.measures, one.source))
        rows.append(Row(one.name, one.unit, cells, group=decided and not one.decides))
        decided = one.decides
    return Table(("value", "says here", "limits", "what it measures, and by whose definition"), tuple(rows))
