"""The command: what it prints and writes, its exit codes, and what starting it loads."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import typer.core
from cascades import TWO_LOOPS
from typer.testing import CliRunner

import workbench as wb
from workbench.cli import app, main
from workbench.cli.compiling import SAID
from workbench.model.results import SolveStatus
from workbench.scenario import runner as scenario_runner

GOOD = """\
title: A short run
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2.0}
  sample_time: 1 s
experiment: {duration: 120 s, setpoint: {step: 4, at: 0 s}}
objective: {w1: 0.5, w3: 0.5}
cases:
  - {name: Case 1, Kc: 0.5, Ti: 20 s}
  - {name: "[bold]Case 2", Kc: 0.5, Ti: 200 s}
analyze: {limit_cycle: false}
"""
TUNE = "  - {name: PI, tune: {Td: 0 s, restarts: 1, digits: 2}}\nanalyze:"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "good.yaml").write_text(GOOD)
    (tmp_path / "bad.yaml").write_text(GOOD.replace("gain: 1.0", "gain: x"))
    return tmp_path


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def record(folder: Path, name: str = "loop.csv") -> Path:
    loop = wb.Loop(wb.FOPDT(1.0, 6.0, 2.0), wb.Stenman(1.0), wb.PID(0.6, 15.0), 1.0)
    experiment = wb.Experiment(900.0, (wb.Step(2.0), wb.Step(1.5, 300.0)), noise=wb.Noise(0.02, 3))
    run = wb.simulate(loop, experiment)
    rows = np.column_stack([run.time, run.sp, run.pv, run.op])
    np.savetxt(folder / name, rows, delimiter=",", header="time,SP,PV,OP", comments="")
    return folder / name


def strict(text: str) -> dict[str, object]:
    def refuse(name: str) -> object:
        raise AssertionError(f"{name} is no strict JSON")

    return json.loads(text, parse_constant=refuse)


# starting ----------------------------------------------------------------------------------------------------------


HEAVY = ["casadi", "numba", "scipy", "matplotlib", "control", "bokeh", "numpy", "pyarrow", "ruamel", "jinja2"]


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["run", "--help"], ["schema"]])
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    code = f"""
import sys
from workbench.__main__ import main
sys.argv = ["workbench", *{arguments!r}]
try:
    main()
except SystemExit as end:
    assert not end.code
heavy = set({HEAVY!r})
found = heavy & set(sys.modules)
assert not found, found
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_version_help_and_usage() -> None:
    assert call("--version") == (0, f"workbench {wb.__version__}\n", "")
    code, out, _ = call("--help")
    assert code == 0
    for command in ("run", "check", "schema", "estimate", "tune"):
        assert command in out
    assert call("nonsense")[0] == 2
    assert call("run")[0] == 2
    assert call("estimate", "a.csv", "--nonsense")[0] == 2


def test_schema_is_the_committed_one() -> None:
    code, out, _ = call("schema")
    assert code == 0
    assert strict(out)["title"] == "ScenarioFile"


# run and check -----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("undrawn")
def test_run_writes_a_report_for_each_scenario(folder: Path) -> None:
    (folder / "other.yaml").write_text(GOOD.replace("A short run", "Another"))
    code, out, err = call("run", "good.yaml", "other.yaml", "--out", "there")
    assert (code, err) == (0, "")
    for name in ("good", "other"):
        files = {p.name for p in (folder / "there" / name).iterdir()}
        assert {"report.html", "results.json", "cases.csv", "run.json"} <= files
        assert str(Path("there") / name / "report.html") in out
        results = strict((folder / "there" / name / "results.json").read_text())
        assert [case["name"] for case in results["cases"]] == ["Case 1", "[bold]Case 2"]  # type: ignore[index, attr-defined]
    assert "A short run" in out
    assert "Another" in out
    # What a scenario writes is text, not markup.
    assert "[bold]Case 2" in out


@pytest.mark.usefixtures("undrawn")
def test_figures_zoom_where_that_is_asked(folder: Path) -> None:
    assert call("run", "good.yaml", "--out", "still")[0] == 0
    assert call("run", "good.yaml", "--out", "zoomed", "--interactive")[0] == 0
    still, zoomed = ((folder / name / "good" / "report.html").read_text() for name in ("still", "zoomed"))
    assert "<script" not in still
    assert 'class="zoom"' in zoomed
    for name in ("results.json", "cases.csv"):
        assert (folder / "still" / "good" / name).read_bytes() == (folder / "zoomed" / "good" / name).read_bytes()


def test_all_files_are_checked_before_anything_runs(folder: Path) -> None:
    code, out, err = call("run", "good.yaml", "bad.yaml", "none.yaml", "--out", "there")
    assert (code, out) == (2, "")
    assert err.splitlines() == [
        "bad.yaml:3:30: loop.plant.gain: x given; must be a number",
        "none.yaml: no such file",
    ]
    assert not (folder / "there").exists()


def test_reports_of_the_same_name_are_refused(folder: Path) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "good.yaml").write_text(GOOD)
    code, _, err = call("run", "good.yaml", "sub/good.yaml")
    assert code == 2
    assert "2 files named good" in err
    assert not (folder / "reports").exists()


@pytest.mark.parametrize("command", [["run", "good.yaml"], ["estimate", "loop.csv"]])
def test_an_output_folder_that_cannot_be_written_is_refused_before_the_work(
    folder: Path, command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    record(folder)
    (folder / "file").write_text("in the way")
    monkeypatch.setattr(scenario_runner, "simulate", lambda *_: pytest.fail("the work has begun"))
    before = sorted(folder.iterdir())
    for where in ("file", "file/deeper"):
        code, out, err = call(*command, "--out", where)
        assert (code, out) == (2, "")
        assert "cannot be written" in err
        assert len(err.splitlines()) == 1
    assert sorted(folder.iterdir()) == before


def test_check_reads_scenarios_and_runs_nothing(folder: Path) -> None:
    assert call("check", "good.yaml") == (0, "good.yaml: ok (2 cases)\n", "")
    code, out, err = call("check", "good.yaml", "bad.yaml")
    assert (code, out) == (2, "")
    assert err == "bad.yaml:3:30: loop.plant.gain: x given; must be a number\n"
    assert sorted(p.name for p in folder.iterdir()) == ["bad.yaml", "good.yaml"]


@pytest.mark.usefixtures("undrawn")
def test_a_tuning_that_failed_gives_exit_code_1_and_a_report(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    (folder / "good.yaml").write_text(GOOD.replace("analyze:", TUNE))
    true_tune = scenario_runner.tune
    monkeypatch.setattr(
        scenario_runner, "tune", lambda *a, **k: replace(true_tune(*a, **k), status=SolveStatus.UNVERIFIED)
    )
    code, _, err = call("run", "good.yaml")
    assert code == 1
    assert err.startswith("PI: not verified by exact re-simulation")
    assert (folder / "reports" / "good" / "report.html").exists()


@pytest.mark.usefixtures("undrawn")
def test_an_interrupt_ends_with_130_and_keeps_the_last_report(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call("run", "good.yaml")[0] == 0
    before = {p: p.read_bytes() for p in (folder / "reports" / "good").iterdir()}

    def interrupt(*_: object, **__: object) -> object:
        raise KeyboardInterrupt

    monkeypatch.setattr(scenario_runner, "simulate", interrupt)
    code, out, err = call("run", "good.yaml")
    assert (code, out) == (130, "")
    assert err.startswith("workbench: interrupted")
    assert {p: p.read_bytes() for p in (folder / "reports" / "good").iterdir()} == before


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_ctrl_c_says_one_line(folder: Path) -> None:
    (folder / "long.yaml").write_text(
        GOOD.replace("120 s", "2000 s")
        .replace("analyze: {limit_cycle: false}", TUNE.split("analyze")[0])
        .replace(", restarts: 1", ", restarts: 20")
    )
    code = """
import sys
from workbench.__main__ import main
from workbench.scenario import runner

search = runner.tune_case

def told(*given):
    print("started", flush=True)
    return search(*given)

runner.tune_case = told
sys.argv = ["workbench", "run", "long.yaml"]
main()
"""
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        # The folder is probed before the work starts; by then the loader is long done.
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, err
    # Whether anything is left to compile depends on the tests before.
    assert err.removeprefix(f"{SAID}\n") == "workbench: interrupted; the last complete report is left as it was\n"
    assert not (folder / "reports").exists()


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
@pytest.mark.parametrize("delay", [0.0, 0.05, 0.15, 1.2, 3.5])
def test_ctrl_c_of_a_tuning_says_one_line_whenever_it_comes(folder: Path, delay: float) -> None:
    second = TUNE.split("\n")[0].replace("PI", "Second")
    text = GOOD.replace("120 s", "2000 s").replace("analyze:", f"{TUNE.split('analyze')[0]}{second}\nanalyze:")
    (folder / "long.yaml").write_text(text.replace(", restarts: 1", ", restarts: 20"))
    # The interpreter's own start is not the command's to end: wait until the command begins to load.
    code = """
import sys
from workbench.__main__ import main

class Told:
    def find_spec(self, name, *_):
        if name == "workbench.cli":
            print("started", flush=True)

sys.meta_path.insert(0, Told())
sys.argv = ["workbench", "tune", "long.yaml"]
main()
"""
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert err.removeprefix(f"{SAID}\n").startswith("workbench: interrupted")
    assert len(err.removeprefix(f"{SAID}\n").splitlines()) == 1
    assert "Second" not in out


def test_ctrl_c_in_a_callback_that_cannot_raise_is_not_lost(folder: Path) -> None:
    (folder / "long.yaml").write_text(
        GOOD.replace("120 s", "2000 s").replace("analyze:", f"{TUNE.split('analyze')[0]}analyze:")
    )
    code = """
import sys
from workbench.__main__ import main

class Taken:
    def __del__(self):
        raise KeyboardInterrupt

class Told:
    def find_spec(self, name, *_):
        if name == LOADED:
            Taken()

sys.meta_path.insert(0, Told())
sys.argv = ["workbench", "tune", "long.yaml"]
main()
"""
    for loaded in ("workbench.cli", "workbench.tune.tune"):
        given = [sys.executable, "-c", code.replace("LOADED", repr(loaded))]
        done = subprocess.run(given, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 130, done.stderr
        assert done.stderr.removeprefix(f"{SAID}\n").startswith("workbench: interrupted")
        assert len(done.stderr.removeprefix(f"{SAID}\n").splitlines()) == 1


@pytest.mark.parametrize("raised", ["ValueError", "KeyboardInterrupt"])
def test_an_error_for_want_of_what_ctrl_c_took_is_an_interrupt(folder: Path, raised: str) -> None:
    code = """
import sys
from workbench.__main__ import main

class Taken:
    def __del__(self):
        raise RAISED

class Told:
    def find_spec(self, name, *_):
        if name == "workbench.model.loop":
            Taken()
            raise RuntimeError("no compiled object yet")

sys.meta_path.insert(0, Told())
sys.argv = ["workbench", "check", "good.yaml"]
main()
"""
    given = [sys.executable, "-c", code.replace("RAISED", raised)]
    done = subprocess.run(given, capture_output=True, text=True, timeout=120, check=False)
    if raised == "KeyboardInterrupt":
        assert done.returncode == 130, done.stderr
        assert done.stderr == "workbench: interrupted\n"
    else:
        # An error of the program stays one, and so does one in a destructor.
        assert done.returncode == 1
        assert "no compiled object yet" in done.stderr
        assert "ValueError" in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_what_ctrl_c_leaves_half_made_says_nothing(folder: Path) -> None:
    code = """
import os, signal, sys
from workbench.__main__ import main

class Half:
    def __init__(self):
        os.kill(os.getpid(), signal.SIGINT)
        self.whole = True

    def __del__(self):
        assert self.whole

class Told:
    def find_spec(self, name, *_):
        if name == "workbench.model.loop":
            Half()

sys.meta_path.insert(0, Told())
sys.argv = ["workbench", "check", "good.yaml"]
main()
"""
    given = [sys.executable, "-c", code]
    done = subprocess.run(given, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130, done.stderr
    assert done.stderr.startswith("workbench: interrupted")
    assert len(done.stderr.splitlines()) == 1


def test_an_interrupt_in_a_librarys_error_is_an_interrupt(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> object:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as cause:
            msg = "initialization failed"
            raise ImportError(msg) from cause

    def told(*_: object, **__: object) -> object:
        msg = 'Error building "model" validator:\n  KeyboardInterrupt: '
        raise ValueError(msg)

    for error in (broken, told):
        monkeypatch.setattr(scenario_runner, "simulate", error)
        code, _, err = call("run", "good.yaml")
        assert (code, err.count("\n")) == (130, 1)


def test_a_controller_that_acts_the_wrong_way_is_said(folder: Path) -> None:
    wrong = GOOD.replace("  sample_time", "  controller: {action: direct}\n  sample_time")
    (folder / "good.yaml").write_text(wrong)
    code, out, err = call("check", "good.yaml")
    assert (code, out) == (0, "good.yaml: ok (2 cases)\n")
    assert err.startswith("good.yaml: warning: Case 1: the controller acts the wrong way")


@pytest.mark.usefixtures("undrawn")
def test_what_a_cascade_most_likely_means_otherwise_is_a_warning_told_once(folder: Path) -> None:
    (folder / "two.yaml").write_text(TWO_LOOPS.replace("d: 1.0", "d: 0.02"))
    code, out, err = call("check", "two.yaml")
    words = "warning: cascade.secondary.valve sticks over 0.02 % of travel, less than a good valve resolves (0.1 %)"
    assert (code, out) == (0, "two.yaml: ok (1 cascade case)\n")
    assert err.startswith(f"two.yaml: {words}")
    code, out, err = call("run", "two.yaml")
    assert code == 0
    assert words.capitalize() in err
    assert "sticks over" not in out


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("arguments", [["check", "good.yaml"], ["schema"], ["--version"]])
def test_output_that_cannot_be_written_is_one_line(folder: Path, arguments: list[str]) -> None:
    command = [sys.executable, "-m", "workbench", *arguments]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert done.stderr == "workbench: the output cannot be written (No space left on device)\n"


# estimate and tune ---------------------------------------------------------------------------------------------------


def test_estimate_ends_with_model_interval_verdict_and_figure(folder: Path) -> None:
    record(folder)
    code, out, err = call("estimate", "loop.csv", "--out", "there")
    assert (code, err) == (0, "")
    for words in ("Model ", "gain", "Valve ", "d: ", "(95 %)", "Verdict    the valve sticks", "Stem ", "estimate.svg"):
        assert words in out
    there = folder / "there" / "loop_estimate"
    assert (there / "estimate.svg").read_text().startswith("<?xml")
    lines = (there / "estimate.csv").read_text().splitlines()
    assert lines[0] == "time,SP,PV,prediction,OP,valve_position"
    assert len(lines) == 901
    content = strict((there / "estimate.json").read_text())
    assert content["verdict"] == "stiction"
    assert sorted(p.name for p in there.iterdir()) == ["estimate.csv", "estimate.json", "estimate.svg"]


def test_estimate_as_json_writes_no_file(folder: Path) -> None:
    record(folder)
    before = sorted(folder.iterdir())
    code, out, err = call("estimate", "loop.csv", "--json", "--column", "PV=PV", "--sample-time", "1 s")
    assert (code, err) == (0, "")
    content = strict(out)
    assert content["plant"]["type"] == "fopdt"  # type: ignore[index]
    low, high = content["intervals"]["d"]  # type: ignore[index]
    assert low <= content["valve"]["d"] <= high  # type: ignore[index]
    assert len(content["valve_position"]) == 900  # type: ignore[arg-type]
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none.csv"], "no such file"),
        (["."], "directory"),
        (["loop.csv", "--method", "magic"], "--method: magic given; must be one of profile, joint, two_step"),
        (["loop.csv", "--column", "PV"], "must be SIGNAL=NAME"),
        (["loop.csv", "--column", "PV=none"], "no such column"),
        (["loop.csv", "--sample-time", "5"], '--sample-time: 5 given; must be a time with its unit, such as "5 s"'),
        (["loop.csv", "--start", "2"], "two_step"),
        (["loop.csv", "--method", "complementarity", "--valve", "deadband"], "knows the Stenman valve alone"),
    ],
)
def test_bad_arguments_of_estimate_are_one_clear_line(folder: Path, arguments: list[str], words: str) -> None:
    record(folder)
    before = sorted(folder.iterdir())
    code, out, err = call("estimate", *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert len(err.splitlines()) == 1
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("time,SP,A,OP", '--column "PV=name in the file"'),
        ("x,SP,PV,OP", '--sample-time, such as "5 s"'),
        ("time,SP,FIC1.PV,FIC2.PV,OP", '--column "PV=FIC1.PV"'),
    ],
)
def test_messages_of_the_reader_name_the_commands_options(folder: Path, header: str, words: str) -> None:
    row = ",".join("1" for _ in header.split(","))
    (folder / "data.csv").write_text(f"{header}\n" + f"{row}\n" * 5)
    code, _, err = call("estimate", "data.csv")
    assert (code, len(err.splitlines())) == (2, 1)
    assert words in err
    assert "columns={" not in err
    assert "sample_time" not in err


def test_tune_prints_the_settings_of_a_scenario(folder: Path) -> None:
    (folder / "good.yaml").write_text(GOOD.replace("analyze:", TUNE))
    code, out, err = call("tune", "good.yaml", "--Kc", "0.2:0.4", "--objective", "w1=1", "--seed", 2)
    assert (code, err) == (0, "")
    assert out.startswith("PI: Kc 0.")
    assert "within the larger of ±0.1 % and half the last digit of each setting)" in out
    assert "solved" in out
    assert "model     first order plus dead time: gain 1 EU/%" in out
    assert "weights   J = 1 Σ (SP − PV)², sums over samples" in out
    assert re.search(
        r"  run       mean square error \S+ EU² \(−\d+ %\), valve travel \S+ % \(.+\), against the start\n", out
    )
    code, out, _ = call("tune", "good.yaml", "--Kc", "0.3", "--json")
    (tuning,) = strict(out)["tunings"]  # type: ignore[misc]
    assert tuning["model"]["plant"]["gain"] == 1.0
    assert tuning["weights"]["w1"] > 0.0
    assert (code, tuning["status"], tuning["controller"]["Kc"], tuning["site"]) == (0, "solved", 0.3, None)
    assert not (folder / "reports").exists()


def test_tune_prints_the_settings_as_the_site_types_them_in(folder: Path) -> None:
    site = "site: {form: FORM, gain: proportional_band, integral: repeats_per_minute}\n"
    text = GOOD.replace("analyze:", TUNE).replace("sample_time", "pv_range: [0, 50]\n  sample_time") + site
    (folder / "site.yaml").write_text(text.replace("FORM", "series"))
    fixed = ("tune", "site.yaml", "--Kc", "0.3", "--Ti", "17 s:17 s")
    code, out, err = call(*fixed)
    assert (code, err) == (0, "")
    assert out.startswith(
        "PI: proportional band 670 %, 3.5 repeats/min (series form)\n  found     Kc 0.30 %/EU, Ti 17 s "
    )
    assert "(ideal form); with the site's digits J is " in out
    assert "  form      series, " in out
    code, out, _ = call(*fixed, "--json")
    (tuning,) = strict(out)["tunings"]  # type: ignore[misc]
    assert tuning["controller"]["Kc"] == 0.3
    told = tuning["site"]
    assert (told["form"], told["units"]["integral"], told["refused"]) == ("series", "repeats/min", None)
    assert (told["gain"], told["integral"], told["Kc"]) == (670.0, 3.5, pytest.approx(2.0 / 6.7))
    assert told["objective"] == pytest.approx(tuning["objective"], rel=0.1)
    assert told["objective"] != tuning["objective"]
    assert call("tune", "site.yaml", "--Kc", "0.3", "--Ti", "3.5 repeats/min:3.6 repeats/min")[0] == 0
    code, out, _ = call(*fixed, "--Td", "6 s")
    assert (code, "Td 6.0 s, which has no equivalent in the site's series form (Ti = 17 s, " in out) == (0, True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["good.yaml", "--objective", "w5=1"], "--objective"),
        (["good.yaml", "--objective", "w1=0"], "at least one"),
        (["good.yaml", "--Ti", "20"], "--Ti: 20 given; must be a time with its unit"),
        (["good.yaml", "--Kc", "3:1"], "--Kc: 3:1 given; must be LOW:HIGH with low <= high"),
        (["good.yaml", "--Kc", "0-3"], "--Kc: 0-3 given; must be a number, without a unit, or LOW:HIGH of such"),
        (["good.yaml", "--action", "up"], "--action: up given; must be reverse or direct"),
        (["good.yaml", "--step", "3"], "--step"),
        (
            ["good.yaml", "--max-sensitivity", "none"],
            "--max-sensitivity: none given; is for a record; a scenario states",
        ),
        (["good.yaml", "--max-sensitivity", "1"], "--max-sensitivity: 1 given; must be > 1, or none"),
        (["good.yaml", "--max-sensitivity", "high"], "--max-sensitivity: high given; must be a number"),
        (["bad.yaml"], "bad.yaml:3:30"),
    ],
)
def test_bad_arguments_of_tune_are_one_clear_line(folder: Path, arguments: list[str], words: str) -> None:
    code, out, err = call("tune", *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert len(err.splitlines()) == 1


def test_an_interrupt_before_a_command_starts_is_one_line_too(monkeypatch, capsys) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(typer.core.TyperGroup, "make_context", interrupted)
    monkeypatch.setattr(sys, "argv", ["workbench", "check", "any.yaml"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "workbench: interrupted\n"
