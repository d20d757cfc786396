"""A Dask cluster on the loopback, scheduler and workers as processes of their own: the same rows as without one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_helpers import record, write_csv
from typer.testing import CliRunner

import workbench
from workbench.cli import app
from workbench.fleet.pool import Limits, WorkersFailed
from workbench.fleet.run import run_fleet
from workbench.fleet.source import sources_of
from workbench.model.fleet import Settings

cluster = pytest.importorskip("workbench.fleet.cluster")
pytest.importorskip("distributed", reason="dask.distributed is not installed")
pytestmark = pytest.mark.slow


class Processes:
    """A scheduler, and workers that come and go."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / "scheduler.json"
        self.environment = os.environ | {
            "PYTHONPATH": str(Path(workbench.__file__).parents[1]),
            "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s",
        }
        self.all: list[subprocess.Popen[bytes]] = []
        self.start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(self.file))
        self.until(self.file.exists)
        time.sleep(0.1)
        self.address = str(json.loads(self.file.read_text())["address"])

    def start(self, what: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + what, *arguments, "--no-dashboard"]
        process = subprocess.Popen(
            command, env=self.environment, cwd=self.folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self.all.append(process)
        return process

    def worker(self) -> subprocess.Popen[bytes]:
        return self.start("worker", self.address, "--nthreads", "1", "--no-nanny", "--host", "127.0.0.1")

    def with_worker(self) -> None:
        """See to it that there is a worker beside the scheduler."""
        if len(self.all) < 2:
            self.worker()

    def until(self, holds: object) -> None:
        assert callable(holds)
        end = time.monotonic() + 60.0
        while not holds():
            assert all(process.poll() is None for process in self.all), "a process of the cluster ended"
            assert time.monotonic() < end
            time.sleep(0.05)

    def end(self) -> None:
        for process in reversed(self.all):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    processes = Processes(tmp_path_factory.mktemp("cluster"))
    yield processes
    processes.end()


@pytest.fixture(scope="module")
def loops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loops")
    for k in range(8):
        write_csv(folder / f"{k}.csv", record(sticky=k % 3 == 0, n=300, seed=k))
    (folder / "bad.csv").write_text("t,PV\n0,1\n")
    return folder


def test_a_scheduler_without_workers_is_said(running: Processes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "REACH", 2.0)
    with pytest.raises(WorkersFailed, match=r"has no worker; start some with `dask worker"):
        cluster.Cluster(running.address, Settings(), Limits())


def test_the_cluster_gives_the_same_and_a_killed_worker_loses_nothing(
    running: Processes, loops: Path, tmp_path: Path
) -> None:
    first, second = running.worker(), running.worker()
    done: list[int] = []

    def tell(count: int, total: int, failed: int) -> None:
        done.append(count)
        if count == 3:
            second.send_signal(signal.SIGKILL)
            running.all.remove(second)

    sources = sources_of(loops)
    run_fleet(sources, tmp_path / "cluster", Settings(), scheduler=running.address, progress=tell)
    second.wait()
    run_fleet(sources, tmp_path / "here", Settings(), workers=1)
    assert done == list(range(10))
    for name in ("fleet.parquet", "fleet.csv", "report.html"):
        assert (tmp_path / "cluster" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
    assert first.poll() is None


def test_other_versions_are_refused(running: Processes, monkeypatch: pytest.MonkeyPatch) -> None:
    running.with_worker()
    monkeypatch.setattr(cluster, "__version__", "0.0.9")
    with pytest.raises(WorkersFailed, match=r"stiction-workbench is 0\.0\.9 here and .* at tcp://.*install the same"):
        cluster.Cluster(running.address, Settings(), Limits())


def test_a_scheduler_that_cannot_be_reached(loops: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "REACH", 1.0)
    arguments = ["fleet", str(loops), "--out", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:9"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "tcp://127.0.0.1:9 cannot be reached" in result.output
    assert "Traceback" not in result.output
    assert not (tmp_path / "out" / "report.html").exists()
