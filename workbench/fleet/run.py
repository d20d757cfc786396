"""A fleet run: sources in, rows, groups, changes and the report out, on either engine."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from workbench import __version__
from workbench.errors import OutputError
from workbench.fleet.groups import grouped, untold
from workbench.fleet.loops import Sources
from workbench.fleet.pool import Limits, Pool
from workbench.fleet.store import ROWS, Store, fleet_csv, read_rows
from workbench.fleet.task import Result
from workbench.model.fleet import Change, FleetRow, LoopSource, Settings, Site
from workbench.model.numbers import given
from workbench.report.fleet_page import page_name, render_site

__all__ = ["Engine", "Outcome", "changes_since", "ranked", "run_fleet"]

MUCH = 0.15  # change of an oscillation index that is worth a word
HALF = 1.5  # ratio of two stick bands that is

Progress = Callable[[int, int, int], None]


class Engine(Protocol):
    """What looks at loops: the embedded pool, or a cluster."""

    def run(self, loops: Iterable[LoopSource]) -> Iterator[Result]:
        """Give each loop's result as it comes."""
        ...


@dataclass(frozen=True, eq=False)
class Outcome:
    """A finished run: the site, how many rows an earlier run had, how many parts of one were dropped, seconds."""

    site: Site
    resumed: int
    dropped: int
    seconds: float


@contextmanager
def _engine(workers: int, settings: Settings, limits: Limits, scheduler: str | None) -> Iterator[Engine]:
    if scheduler is None:
        with Pool(workers, settings, limits) as pool:
            yield pool
    else:
        from workbench.fleet.cluster import Cluster

        with Cluster(scheduler, settings, limits) as cluster:
            yield cluster


def run_fleet(
    sources: Sources,
    folder: Path,
    settings: Settings,
    *,
    limits: Limits | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    previous: Path | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Look at every loop of `sources` and write the report, fleet.parquet, fleet.csv and loops/ into `folder`.

    workers: processes of the embedded engine; scheduler: address of a Dask scheduler to use in its place. resume: keep
    the rows that an interrupted run with the same settings left, but for loops that could not be looked at and those of
    which the source now says something else. previous: an earlier run's folder, or its
    fleet.parquet, to compare with. progress: called with (loops done, loops, loops failed). Rows come in parts as they
    are found; the rest is written once all are there. Raises `OutputError`, and what the engines raise when nothing can
    start.
    """
    begin = time.perf_counter()
    tell = progress if progress is not None else _silent
    former = None if previous is None else [row for row in _former(previous) if row.name not in sources.left_out]
    store = Store(folder, sources.shown, settings, resume)
    loops = sources.loops
    marks = {loop.name: _mark(loop) for loop in loops}
    store.done = {name: row for name, row in store.done.items() if not row.failed and row.entry == marks.get(name)}
    resumed = len(store.done)
    todo = [loop for loop in loops if loop.name not in store.done]
    count, failed = resumed, 0
    if todo:
        with _engine(min(workers, len(todo)), settings, limits or Limits(), scheduler) as engine:
            store.begin()
            tell(count, len(loops), failed)
            try:
                for result in engine.run(todo):
                    if result.page:
                        store.page(page_name(result.row.name), result.page)
                    store.add(replace(result.row, entry=marks[result.row.name]))
                    count, failed = count + 1, failed + result.row.failed
                    tell(count, len(loops), failed)
            finally:
                # Whatever stops the run, the rows that came are kept.
                store.flush()
    rows = ranked(store.done.values())
    groups = grouped(rows)
    pages = frozenset(
        row.name
        for row in rows
        if (row.sticks or row.oscillates) and (folder / "loops" / page_name(row.name)).is_file()
    )
    changes = None if former is None else changes_since(former, rows)
    site = Site(sources.title, sources.shown, settings, rows, groups, changes, pages, untold(rows, groups))
    seconds = time.perf_counter() - begin
    machine = {
        "version": __version__,
        "python": platform.python_version(),
        "machine": platform.platform(),
        "seconds": round(seconds, 3),
        "depth": settings.depth,
        "window": settings.window_as_data(),
        "loops": len(rows),
        "resumed": resumed,
        "workers": workers if scheduler is None else None,
        "scheduler": scheduler,
    }
    texts = {
        "fleet.csv": fleet_csv(rows),
        "run.json": json.dumps(machine, indent=2) + "\n",
        "report.html": render_site(site),
    }
    store.finish(rows, texts, {page_name(name) for name in pages})
    return Outcome(site, resumed, store.dropped, seconds)


def _mark(loop: LoopSource) -> str:
    """Return a mark of all that the source says of a loop."""
    return hashlib.sha256(repr(loop).encode()).hexdigest()[:16]


def _silent(done: int, total: int, failed: int) -> None:
    """Tell nobody."""


def ranked(rows: Iterable[FleetRow]) -> tuple[FleetRow, ...]:
    """Return rows by urgency: stiction first, then what oscillates, then the rest, at last what failed.

    Within these by criticality, then by the strength of the oscillation.
    """

    def urgency(row: FleetRow) -> tuple[int, int, float, str]:
        kind = 3 if row.failed else 0 if row.sticks else 1 if row.oscillates else 2
        return kind, -row.criticality, -row.oscillation_index if row.oscillation_index >= 0.0 else 0.0, row.name

    return tuple(sorted(rows, key=urgency))


def _former(previous: Path) -> list[FleetRow]:
    path = previous / ROWS if previous.is_dir() else previous
    if not path.is_file():
        raise OutputError(f"{path}: no such file; --previous must name the folder of an earlier run")
    return read_rows(path)[0]


def changes_since(former: Sequence[FleetRow], rows: Sequence[FleetRow]) -> tuple[Change, ...]:
    """Return what changed for each loop, what is worse first."""
    before, found = {row.name: row for row in former}, []
    for row in rows:
        old = before.pop(row.name, None)
        if old is None:
            found.append(Change(row.name, "new", "was not in the run before"))
        else:
            found += _changed(old, row)
    found += [Change(name, "gone", "is no longer in the source") for name in before]
    order = ("worse", "better", "new", "gone")
    return tuple(sorted(found, key=lambda change: (order.index(change.kind), change.name)))


def _changed(old: FleetRow, new: FleetRow) -> list[Change]:
    def said(kind: str, words: str) -> list[Change]:
        return [Change(new.name, kind, words)]

    if old.failed != new.failed:
        return said("worse", f"could not be read: {new.reason}") if new.failed else said("better", "can be read again")
    if new.failed:
        return []
    if old.sticks != new.sticks:
        if new.sticks:
            return said("worse", "the valve now shows stiction")
        return said("better", "stiction is no longer found" + (", but undecided" if new.verdict == "undecided" else ""))
    if old.oscillates != new.oscillates:
        return said("worse", "now oscillates") if new.oscillates else said("better", "no longer oscillates")
    if new.sticks and old.stiction > 0.0 and not 1.0 / HALF <= new.stiction / old.stiction <= HALF:
        kind = "worse" if new.stiction > old.stiction else "better"
        return said(kind, f"stiction {given(old.stiction, 3)} % before, {given(new.stiction, 3)} % now")
    if new.oscillates and abs(new.oscillation_index - old.oscillation_index) >= MUCH:
        kind = "worse" if new.oscillation_index > old.oscillation_index else "better"
        return said(kind, f"oscillation index {old.oscillation_index:.2f} before, {new.oscillation_index:.2f} now")
    return []
