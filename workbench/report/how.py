"""How tunings were found, as tables: each search's figures, and its restarts."""

from __future__ import annotations

import math
from collections.abc import Callable

from workbench.model.results import Tuned
from workbench.model.study import Study
from workbench.report.judge import on_bounds
from workbench.report.shared import objective_words
from workbench.report.tables import Cell, Row, Table
from workbench.report.words import controller_words, figure, nearby, setting

__all__ = ["how_tables"]


def how_tables(study: Study) -> list[Table]:
    """Return how tunings were found: figures down and tunings across, then every restart."""
    tuned = [(c.name, c.tuned) for c in study.cases if c.tuned is not None]
    if not tuned:
        return []
    rows = [Row(title, unit, tuple(Cell(text(t)) for _, t in tuned)) for title, unit, text in _HOW_ROWS]
    rounded = [case for case in study.cases if case.tuned is not None]
    if any(case.unrounded is not None for case in rounded):
        # The cases are of what the site types in: these figures are of other settings.
        own = (controller_words(case.tuned.controller, case.tuned.digits) for case in rounded if case.tuned is not None)
        rows.insert(1, Row("Settings found, before the site's rounding", "", tuple(Cell(text) for text in own)))
    if any(t.weights != study.objective for _, t in tuned):
        # J of the cases is by the study's weights: a search under its own weights has another J.
        weights = tuple(Cell(objective_words(t.weights)) for _, t in tuned)
        rows.insert(1, Row("J of this search", "", weights))
    tables = [Table(tuple(name for name, _ in tuned), tuple(rows), "Tunings")]
    restarts = []
    for name, one in tuned:
        for i, r in enumerate(one.restarts):
            # A robust tuning is scanned on the first of its draws alone.
            few = "" if one.ensemble is None else "on the first draws"
            kept = figure(r.refined) if math.isfinite(r.refined) else "breaks a constraint"
            last = Cell(kept, "" if one.ensemble is None else "on all draws")
            counts = (f"{r.evaluations:,}", str(r.solves), f"{r.iterations:,}")
            cells = (Cell(str(r.seed)), Cell(figure(r.scanned), few), last, *(Cell(text) for text in counts))
            restarts.append(Row(name, "", cells, group=i == 0))
    if restarts:
        heads = ("search", "J after the scan", "J refined", "simulations", "NLPs", "IPOPT iterations")
        tables.append(Table(heads, tuple(restarts), "Restarts"))
    return tables


def _spread(tuned: Tuned) -> str:
    best, worst = tuned.spread
    if math.isinf(best):
        by_itself = ", only the search from all of them" if tuned.status.success else ""
        return f"none kept the constraints{by_itself}"
    return f"{figure(best)} to {figure(worst)}"


def _steps(tuned: Tuned) -> str:
    return "; ".join(f"{s.name}: {figure(s.below, 4)}, {figure(s.above, 4)}" for s in tuned.steps) or "none"


_HOW_ROWS: tuple[tuple[str, str, Callable[[Tuned], str]], ...] = (
    ("Status", "", lambda t: t.status.value),
    ("J of the settings, rounded", "", lambda t: figure(t.objective)),
    ("Digits typed in", "", lambda t: str(t.digits)),
    ("Least J met, unrounded and however near a cliff", "", lambda t: figure(t.nominal)),
    ("Worst J near the settings", "", lambda t: f"{figure(t.worst)} {nearby(t.margin)}"),
    (
        "No worst J within bounds and constraints is below",
        "",
        lambda t: "not known" if t.worst_bound is None else figure(t.worst_bound),
    ),
    ("J of the start", "", lambda t: figure(t.start_objective)),
    ("Guard margin", "%", lambda t: figure(t.guard_margin, 3)),
    ("Slips of the valve, the sequence's length", "", lambda t: f"{t.slips:,}"),
    ("J one last digit below and above", "", _steps),
    ("J over the restarts", "", _spread),
    ("Restarts within 0.1 % of the best", "", lambda t: f"{t.agreeing} of {len(t.restarts)}"),
    ("Simulations", "", lambda t: f"{t.evaluations:,}"),
    ("NLPs solved", "", lambda t: f"{t.solves:,}"),
    ("IPOPT iterations", "", lambda t: f"{t.iterations:,}"),
    ("Seed", "", lambda t: str(t.seed)),
    ("Settings on a bound", "", lambda t: "; ".join(on_bounds(t)) or "none"),
    ("Bounds of Kc, Ti, Td", "", lambda t: "; ".join(_bound(p) for p in (t.bounds.Kc, t.bounds.Ti, t.bounds.Td))),
)


def _bound(pair: tuple[float, float]) -> str:
    return setting(pair[0]) if pair[0] == pair[1] else f"{setting(pair[0])} to {setting(pair[1])}"
