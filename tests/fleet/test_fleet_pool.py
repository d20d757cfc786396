"""Worker processes: limits, deaths, and that no loop is lost or comes twice."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_helpers import record, write_csv

from workbench.errors import InvalidValue
from workbench.fleet import pool as pools
from workbench.fleet.pool import Limits, Pool, WorkersFailed
from workbench.model.fleet import LoopSource, Settings

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("loops")
    for k in range(6):
        write_csv(path / f"{k}.csv", record(sticky=k % 2 == 0, n=200, seed=k))
    # Takes some seconds, and hundreds of MiB, to be read.
    rows = "\n".join(f"{k},{k % 97},{k % 89}" for k in range(1_500_000))
    (path / "huge.csv").write_text(f"t,PV,OP\n{rows}\n")
    return path


def loops(folder: Path, *names: str) -> list[LoopSource]:
    return [LoopSource(name, str(folder / f"{name}.csv")) for name in names]


def test_a_loop_beyond_its_limits_is_a_row_and_the_others_go_on(folder: Path) -> None:
    with Pool(2, Settings(), Limits()) as pool:
        pool.start()
        # A worker's first loop takes longest.
        assert not any(r.row.failed for r in pool.run(loops(folder, "3", "4")))
        pool.limits = Limits(seconds=1.5)
        rows = {r.row.name: r.row for r in pool.run(loops(folder, "0", "huge", "1", "2"))}
        assert {name for name, row in rows.items() if row.failed} == {"huge"}
        assert rows["huge"].reason == "took longer than the limit of 1.5 s"
        assert rows["0"].samples == 200
        # The same workers take more loops, within other limits.
        pool.limits = Limits(mebibytes=350.0)
        rows = {r.row.name: r.row for r in pool.run(loops(folder, "huge", "3"))}
    assert "MiB of memory, more than the limit of 350 MiB" in rows["huge"].reason
    assert not rows["3"].failed


def test_killed_workers_lose_nothing(folder: Path) -> None:
    names = [str(k % 6) for k in range(12)]
    todo = [LoopSource(f"{i}-{name}", str(folder / f"{name}.csv")) for i, name in enumerate(names)]
    got: list[str] = []
    with Pool(2, Settings(), Limits()) as pool:
        for i, result in enumerate(pool.run(todo)):
            assert not result.row.failed
            got.append(result.row.name)
            if i in (0, 5):
                os.kill(pool.workers[i % 2].process.pid, signal.SIGKILL)
        assert len({worker.process.pid for worker in pool.workers}) == 2
        pids = [worker.process.pid for worker in pool.workers]
    assert sorted(got) == sorted(loop.name for loop in todo)
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_loop_that_kills_its_worker_again_and_again_is_a_row(folder: Path) -> None:
    def bait(pool: Pool) -> Iterator[LoopSource]:
        yield from loops(folder, "huge")

    with Pool(1, Settings(), Limits()) as pool:
        pool.start()
        stream = bait(pool)
        original = pools._Worker.give

        def give(worker: pools._Worker, loop: LoopSource, settings: Settings, seconds: float) -> None:
            original(worker, loop, settings, seconds)
            worker.process.send_signal(signal.SIGSEGV)

        pools._Worker.give = give  # type: ignore[method-assign]
        try:
            (result,) = pool.run(stream)
        finally:
            pools._Worker.give = original  # type: ignore[method-assign]
    assert result.row.reason == "its process ended 3 times (the last with signal SIGSEGV)"


def test_workers_that_cannot_start_end_the_run(folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\nexit 7\n")
    broken.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(broken))
    with Pool(2, Settings(), Limits()) as pool, pytest.raises(WorkersFailed, match="exit code 7"):
        list(pool.run(loops(folder, "0")))


@pytest.mark.parametrize(("seconds", "mebibytes"), [(0.5, 1024.0), (1e6, 1024.0), (10.0, 10.0)])
def test_limits_that_are_refused(seconds: float, mebibytes: float) -> None:
    with pytest.raises(InvalidValue, match="must be"):
        Limits(seconds, mebibytes)
