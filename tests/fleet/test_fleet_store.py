"""Rows on disk: parts, resuming, and the CSV for spreadsheets."""

from __future__ import annotations

import csv
import errno
import io
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from workbench.errors import OutputError
from workbench.fleet import run as runs
from workbench.fleet import store as stores
from workbench.fleet.loops import Sources
from workbench.fleet.pool import WorkersFailed
from workbench.fleet.store import Store, fleet_csv, read_rows
from workbench.fleet.task import Result
from workbench.model.fleet import FleetRow, LoopSource, Settings, Tuning

SITE = "a folder of records"
ROWS = [
    FleetRow("b", verdict="stiction", stiction=1.25, oscillates=True, phases=b"\x01\xff", trend=b"\x00\x80"),
    FleetRow("a", status="failed", reason="=cmd|'/c calc'!A1"),
    FleetRow("c", criticality=4, reasons="+1\n-2"),
]


def same(a: FleetRow, b: FleetRow) -> bool:
    """Whether two rows are equal, nan to nan."""
    ours, theirs = a.values(), b.values()
    return all(
        x == y or (isinstance(x, float) and math.isnan(x) and math.isnan(y))
        for x, y in zip(ours.values(), theirs.values(), strict=True)
    )


def begun(folder: Path, *, resume: bool = False) -> Store:
    store = Store(folder, SITE, Settings(), resume)
    store.begin()
    return store


def test_rows_come_back_as_they_were(tmp_path: Path) -> None:
    store = begun(tmp_path)
    for row in ROWS:
        store.add(row)
    store.flush()
    (part,) = (tmp_path / "parts").glob("part-*")
    rows, _ = read_rows(part)
    assert all(same(a, b) for a, b in zip(rows, ROWS, strict=True))


def test_an_interrupted_run_goes_on_and_no_row_is_there_twice(tmp_path: Path) -> None:
    store = begun(tmp_path)
    store.add(ROWS[0])
    store.flush()
    store.add(ROWS[1])  # never written: the run is killed here
    (tmp_path / "parts" / ".part-000002.parquet.99.tmp").write_bytes(b"half")
    again = begun(tmp_path, resume=True)
    assert set(again.done) == {"b"}
    for row in (ROWS[0], ROWS[1]):
        again.add(row)
    again.flush()
    assert sorted(path.name for path in (tmp_path / "parts").glob("part-*")) == [
        "part-000001.parquet",
        "part-000002.parquet",
    ]
    once_more = begun(tmp_path, resume=True)
    assert set(once_more.done) == {"a", "b"}
    once_more.page("a.html", "kept")
    once_more.page("former.html", "of a loop that no longer has one")
    once_more.finish(list(once_more.done.values()), {"report.html": "x"}, {"a.html"})
    assert [path.name for path in (tmp_path / "loops").iterdir()] == ["a.html"]
    assert not (tmp_path / "parts").exists()
    assert set(Store(tmp_path, SITE, Settings(), resume=True).done) == {"a", "b"}


def test_parts_are_written_after_a_batch_or_some_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "BATCH", 2)
    store = begun(tmp_path)
    store.add(ROWS[0])
    assert not store.done
    store.add(ROWS[1])
    assert set(store.done) == {"a", "b"}
    monkeypatch.setattr(stores, "PATIENCE", 0.0)
    store.add(ROWS[2])
    assert set(store.done) == {"a", "b", "c"}


def test_without_resume_a_run_begins_anew(tmp_path: Path) -> None:
    store = begun(tmp_path)
    store.add(ROWS[0])
    store.flush()
    fresh = begun(tmp_path)
    assert not fresh.done
    assert fresh.dropped == 1
    assert not list((tmp_path / "parts").glob("part-*"))


def test_rows_of_a_former_whole_run_are_not_those_of_an_interrupted_new_one(tmp_path: Path) -> None:
    # Every morning into one folder: what --resume goes on with is this morning's run, not yesterday's.
    begun(tmp_path).finish(ROWS, {}, ())
    assert set(Store(tmp_path, SITE, Settings(), resume=True).done) == {"a", "b", "c"}
    begun(tmp_path)  # killed before its first row
    assert not Store(tmp_path, SITE, Settings(), resume=True).done
    today = begun(tmp_path, resume=True)
    today.add(replace(ROWS[0], stiction=3.0))
    today.flush()
    again = begun(tmp_path, resume=True)
    assert [row.stiction for row in again.done.values()] == [3.0]
    again.finish(ROWS, {}, ())
    assert not (tmp_path / "parts").exists()


def engine_of(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Put an engine that looks at nothing in the place of the pool; return the names of the loops that it is given."""
    looked: list[str] = []

    class Engine:
        def run(self, loops: Iterable[LoopSource]) -> Iterator[Result]:
            for loop in loops:
                looked.append(loop.name)
                yield Result(FleetRow.failure(loop, loop.refusal) if loop.refusal else FleetRow(loop.name))

    @contextmanager
    def engine(*_: object) -> Iterator[Engine]:
        yield Engine()

    monkeypatch.setattr(runs, "_engine", engine)
    return looked


def test_loops_that_were_not_asked_for_are_not_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun(tmp_path / "before").finish(ROWS, {}, ())
    engine_of(monkeypatch)
    some = Sources("x", SITE, (LoopSource("a", "a.csv"),), left_out=frozenset({"b"}))
    site = runs.run_fleet(some, tmp_path / "now", Settings(), previous=tmp_path / "before").site
    assert site.changes is not None
    assert [(change.name, change.kind) for change in site.changes] == [("a", "better"), ("c", "gone")]


def test_a_run_goes_on_with_the_rows_that_still_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked = engine_of(monkeypatch)

    def run(*loops: LoopSource) -> int:
        looked.clear()
        return runs.run_fleet(Sources("x", SITE, loops), tmp_path, Settings(), resume=True).resumed

    good, wrong, tuned = LoopSource("a", "a.csv"), LoopSource("b", refusal="not there"), LoopSource("c", "c.csv")
    assert run(good, wrong, tuned) == 0
    # What failed, perhaps because of an entry that is mended since, and what has another entry: its tuning was added.
    assert run(good, replace(wrong, path="b.csv", refusal=""), replace(tuned, tuning=Tuning(0.5, 20.0))) == 1
    assert looked == ["b", "c"]
    assert not any(row.failed for row in read_rows(tmp_path / "fleet.parquet")[0])


def test_a_run_that_nothing_can_start_leaves_the_folder_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A scheduler that does not answer.
    @contextmanager
    def none(*_: object) -> Iterator[None]:
        raise WorkersFailed("cannot be reached")
        yield

    monkeypatch.setattr(runs, "_engine", none)
    sources = Sources("x", SITE, (LoopSource("a", "a.csv"),))
    with pytest.raises(WorkersFailed):
        runs.run_fleet(sources, tmp_path / "out", Settings())
    assert not (tmp_path / "out").exists()
    half = begun(tmp_path / "half")
    half.add(ROWS[0])
    half.flush()
    with pytest.raises(WorkersFailed):
        runs.run_fleet(sources, tmp_path / "half", Settings())
    assert set(Store(tmp_path / "half", SITE, Settings(), resume=True).done) == {"b"}


def test_other_settings_are_not_resumed(tmp_path: Path) -> None:
    store = begun(tmp_path)
    store.add(ROWS[0])
    store.flush()
    with pytest.raises(OutputError, match=r"with other settings.*--resume"):
        Store(tmp_path, SITE, Settings("estimate"), resume=True)
    with pytest.raises(OutputError, match="made of another site"):
        Store(tmp_path, "another folder", Settings(), resume=True)


def test_files_that_are_no_rows_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "fleet.parquet"
    path.write_bytes(b"PAR1 no")
    with pytest.raises(OutputError, match="cannot be read as the rows"):
        read_rows(path)
    pq.write_table(pq.read_table(_other(tmp_path)), path)
    with pytest.raises(OutputError, match="holds no rows of a fleet run"):
        Store(tmp_path, SITE, Settings(), resume=True)


def _other(folder: Path) -> Path:
    import pyarrow as pa

    pq.write_table(pa.table({"name": ["x"]}), folder / "other.parquet")
    return folder / "other.parquet"


def test_a_row_of_another_version_keeps_what_is_known(tmp_path: Path) -> None:
    store = begun(tmp_path)
    store.add(ROWS[0])
    store.flush()
    (part,) = (tmp_path / "parts").glob("part-*")
    table = pq.read_table(part)
    import pyarrow as pa

    changed = table.drop_columns(["verdict"]).append_column("novel", pa.array([1]))
    pq.write_table(changed.replace_schema_metadata(table.schema.metadata), part)
    (row,), _ = read_rows(part)
    assert (row.name, row.verdict, row.stiction) == ("b", "", 1.25)


def test_a_full_disk_is_said_and_what_is_there_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = begun(tmp_path)
    store.add(ROWS[0])
    store.flush()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    store.add(ROWS[1])
    with pytest.raises(OutputError, match="No space left on device"):
        store.flush()
    monkeypatch.undo()
    assert set(Store(tmp_path, SITE, Settings(), resume=True).done) == {"b"}


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="cannot be written"):
        begun(tmp_path / "file" / "out")


def test_the_csv_holds_no_formula_and_no_bytes() -> None:
    rows = list(csv.DictReader(io.StringIO(fleet_csv(ROWS))))
    assert [row["name"] for row in rows] == ["b", "a", "c"]
    assert rows[1]["reason"] == "'=cmd|'/c calc'!A1"
    assert rows[2]["reasons"] == "'+1\n-2"
    assert rows[0]["stiction"] == "1.25"
    assert rows[0]["oscillates"] == "yes"
    assert rows[1]["stiction"] == ""
    assert not {"phases", "trend"} & set(rows[0])
    for text in ("-x", "@x", "\tx", "=1+1", "\rx"):
        assert fleet_csv([FleetRow(text)]).splitlines()[1].lstrip('"').startswith("'")
