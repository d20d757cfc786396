"""Whole runs: the same rows whatever the workers and interruptions, the command, and its exit codes."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fleet_helpers import record, tall, write_csv, write_tall
from typer.testing import CliRunner

import workbench
from workbench.cli import app
from workbench.fleet.demo import write_site
from workbench.fleet.loops import Sources
from workbench.fleet.run import run_fleet
from workbench.fleet.source import sources_of
from workbench.fleet.store import Store, read_rows
from workbench.model.fleet import Settings

pytestmark = pytest.mark.slow
LOOPS = 6


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo") / "site"
    write_site(folder, LOOPS, 0.75)
    # Two more that cannot be looked at.
    (folder / "half.parquet").write_bytes(b"PAR1")
    write_tall(folder / "more.parquet", tall("FIC9", record(sticky=False, n=100)).slice(100))
    return folder


@pytest.fixture(scope="module")
def whole(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    outcome = run_fleet(sources_of(site), out, Settings(), workers=2)
    assert outcome.resumed == 0
    return out


def content(out: Path) -> tuple[bytes, str, str, list[str]]:
    pages = sorted(path.name for path in (out / "loops").iterdir())
    return (
        (out / "fleet.parquet").read_bytes(),
        (out / "fleet.csv").read_text(),
        (out / "report.html").read_text(),
        pages,
    )


def test_the_rows_are_right(site: Path, whole: Path) -> None:
    truth = {row["loop"]: row for row in csv.DictReader((site / "_truth.csv").read_text().splitlines())}
    rows = {row.name: row for row in read_rows(whole / "fleet.parquet")[0]}
    assert set(rows) == {*truth, "half", "FIC9"}
    for name, known in truth.items():
        if known["kind"] == "sticky":
            assert rows[name].verdict == "stiction", name
    wrong = [name for name, known in truth.items() if rows[name].sticks and known["verdict"] != "stiction"]
    assert not wrong
    assert rows["FIC9"].reason == "no tag for OP (tags: FIC9.PV)"
    assert "no readable Parquet" in rows["half"].reason
    assert rows[next(iter(truth))].automatic == 1.0
    assert not (whole / "parts").exists()
    report = (whole / "report.html").read_text()
    assert "half: " in report


def test_one_worker_gives_the_same_as_two(site: Path, whole: Path, tmp_path: Path) -> None:
    given = sources_of(site)
    # In another order too.
    run_fleet(Sources(given.title, given.shown, given.loops[::-1]), tmp_path, Settings(), workers=1)
    assert content(tmp_path) == content(whole)


def started(site: Path, out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "workbench", "fleet", str(site), "--out", str(out), "--workers", "1"]
    environment = os.environ | {"PYTHONPATH": str(Path(workbench.__file__).parents[1])}
    return subprocess.Popen(command, env=environment, stdout=-1, stderr=-1)


def test_a_run_that_is_killed_goes_on(site: Path, whole: Path, tmp_path: Path) -> None:
    sources, out = sources_of(site), tmp_path / "out"
    # A first run that writes every row at once and is killed from within after five of them, without a last word.
    code = (
        "import os, signal, sys; from pathlib import Path; from workbench.fleet import store; store.BATCH = 1\n"
        "from workbench.fleet.run import run_fleet; from workbench.fleet.source import sources_of\n"
        "from workbench.model.fleet import Settings\n"
        "tell = lambda done, total, failed: done == 5 and os.kill(os.getpid(), signal.SIGKILL)\n"
        "run_fleet(sources_of(Path(sys.argv[1])), Path(sys.argv[2]), Settings(), workers=1, progress=tell)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(workbench.__file__).parents[1])}
    ended = subprocess.run([sys.executable, "-c", code, str(site), str(out)], env=environment, timeout=120)
    assert ended.returncode == -signal.SIGKILL
    assert not (out / "report.html").exists()
    kept = Store(out, sources.shown, Settings(), resume=True).done
    assert len(kept) == 5
    outcome = run_fleet(sources, out, Settings(), workers=1, resume=True)
    assert outcome.resumed == sum(not row.failed for row in kept.values())
    assert content(out) == content(whole)
    # Once more: only the two that fail are left to try again, and nothing changes.
    assert run_fleet(sources, out, Settings(), workers=1, resume=True).resumed == LOOPS
    assert content(out) == content(whole)


def test_an_interrupt_keeps_what_was_found(site: Path, tmp_path: Path) -> None:
    process = started(site, tmp_path)
    while not (tmp_path / "loops").is_dir():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert b"go on with --resume" in said
    assert b"Traceback" not in said
    # Rows that were found are not looked for again.
    assert Store(tmp_path, sources_of(site).shown, Settings(), resume=True).done


def test_changes_are_told_since_the_run_before(whole: Path, site: Path, tmp_path: Path) -> None:
    given = sources_of(site)
    fewer = Sources(given.title, given.shown, [loop for loop in given.loops if loop.name not in ("half", "FIC9")][:1])
    shutil.copytree(whole, tmp_path, dirs_exist_ok=True)
    outcome = run_fleet(fewer, tmp_path, Settings(), workers=1, resume=True, previous=whole)
    assert outcome.resumed == 1
    assert outcome.site.changes is not None
    assert {change.kind for change in outcome.site.changes} == {"gone"}
    assert len(outcome.site.changes) == LOOPS + 2 - 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none"], "no such file or folder"),
        (["."], "holds no record"),
        (["site", "--depth", "deep"], "--depth: deep given; must be one of screen, estimate, tune"),
        (["site", "--from", "yesterday"], "--from: yesterday given; must be a time such as"),
        (["site", "--from", "2024-10-18", "--to", "2024-10-17"], "--from: 2024-10-18 00:00:00 given; must be before"),
        (
            ["site", "--from", "2024-10-17", "--to", "2024-10-18T00:00Z"],
            "--to: 2024-10-18T00:00Z given; must have a zone",
        ),
        (["site", "--last", "8"], "--last"),
        (["site", "--time-limit", "0 s"], "--time-limit"),
        (["site", "--memory-limit", "1"], "--memory-limit"),
        (["site", "--workers", "0"], "--workers: 0 given; must be 1 to 1024"),
        (["site", "--include", "X*"], "--include"),
        (["site", "--previous", "none"], "--previous must name the folder of an earlier run"),
        (["site", "--scheduler", "host"], "must be an address such as tcp://host:8786"),
        (["site", "--scheduler", "tcp://x:1", "--workers", "2"], "has its own workers"),
    ],
)
def test_what_cannot_start_is_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if arguments[0] == "site":
        (tmp_path / "site").mkdir()
        write_csv(tmp_path / "site" / "a.csv", record(sticky=False, n=60))
    result = CliRunner().invoke(app, ["fleet", *arguments, "--out", "out"])
    assert result.exit_code == 2, result.output
    assert message in result.output
    assert "Traceback" not in result.output
    assert not (tmp_path / "out" / "report.html").exists()


def test_the_window_is_by_the_clock_of_each_record_and_told(tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    one = record(sticky=False, n=600)
    for name, zone in (("east", "+05:30"), ("plain", "")):
        stamps = [f"2024-10-17T{6 + k // 60:02d}:{k % 60:02d}:00{zone}" for k in range(600)]
        rows = zip(stamps, one.pv.tolist(), one.op.tolist(), strict=True)
        (tmp_path / "site" / f"{name}.csv").write_text(
            "Time,PV,OP\n" + "\n".join(f"{t},{y:.6g},{u:.6g}" for t, y, u in rows)
        )
    out = tmp_path / "out"
    given = ["fleet", str(tmp_path / "site"), "--out", str(out), "--workers", "1", "--from"]
    result = CliRunner().invoke(app, [*given, "2024-10-17T06:00", "--to", "2024-10-17T08:00"])
    assert result.exit_code == 0, result.output
    rows = read_rows(out / "fleet.parquet")[0]
    assert [row.samples for row in rows] == [120, 120]
    assert [row.pv_sd for row in rows] == [pytest.approx(one.pv[:120].std(), rel=1e-4)] * 2
    said = "Window of time: from 2024-10-17 06:00:00 to 2024-10-17 08:00:00, by the clock of each record."
    assert said in (out / "report.html").read_text()
    told = json.loads((out / "run.json").read_text())
    assert told["window"] == {"from": "2024-10-17T06:00:00", "to": "2024-10-17T08:00:00", "last": None}
    result = CliRunner().invoke(app, [*given, "2024-10-17T06:00+05:30", "--last", "2 h"])
    assert result.exit_code == 1
    assert "plain: not looked at: " in result.output
    assert "the window of time has a zone, and the record's times have none" in result.output
    assert "from 2024-10-17 00:30:00, UTC; of that the last 2.0 h of each record." in (out / "report.html").read_text()


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x")
    result = CliRunner().invoke(app, ["fleet", str(tmp_path), "--out", str(tmp_path / "a.csv" / "out")])
    assert result.exit_code == 2
    assert "cannot be written" in result.output


def test_a_full_disk_in_mid_run_leaves_what_was_found_and_runs_have_exit_codes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import errno

    import pyarrow.parquet as pq

    from workbench.fleet import store as stores

    loops, out = tmp_path / "loops", tmp_path / "out"
    loops.mkdir()
    write_csv(loops / "sticky.csv", record(sticky=True, n=300))
    for k in range(2):
        write_csv(loops / f"{k}.csv", record(sticky=False, n=60, seed=k))
    monkeypatch.setattr(stores, "BATCH", 1)
    original, calls = pq.write_table, []

    def second_fails(*given: object, **more: object) -> None:
        calls.append(1)
        if len(calls) > 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        original(*given, **more)

    def run(*more: str) -> tuple[int, str]:
        result = CliRunner().invoke(app, ["fleet", str(loops), "--out", str(out), "--workers", "1", *more])
        return result.exit_code, result.output

    monkeypatch.setattr(pq, "write_table", second_fails)
    code, said = run()
    assert code == 1
    assert "No space left on device" in said
    assert "go on with --resume" in said
    monkeypatch.setattr(pq, "write_table", original)
    code, said = run("--resume")
    assert code == 0, said
    assert "1 loop had been looked at before" in said
    assert "3 loops looked at" in said
    assert "sticky: stiction" in said
    assert len(read_rows(out / "fleet.parquet")[0]) == 3
    (loops / "bad.csv").write_text("t,PV\n0,1\n")
    code, said = run("--previous", str(out), "--last", "4 min")
    assert code == 1
    assert "bad: not looked at" in said
    assert "bad: " in (out / "report.html").read_text()


def test_the_demo_command(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["fleet-demo", "--loops", "3", "--hours", "0.25", "--out", str(tmp_path / "x")])
    assert result.exit_code == 0
    assert "3 loops, 1 with a valve that sticks" in result.output
    again = CliRunner().invoke(app, ["fleet-demo", "--loops", "3", "--out", str(tmp_path / "x")])
    assert again.exit_code == 2
    assert "holds files already" in again.output
    for option, value, allowed in (("--loops", "0", "must be 1 to 1,000,000"), ("--hours", "-1", "must be 0.2 to 744")):
        wrong = CliRunner().invoke(app, ["fleet-demo", option, value, "--out", str(tmp_path / "y")])
        assert wrong.exit_code == 2
        assert f"{option}: " in wrong.output
        assert allowed in wrong.output
