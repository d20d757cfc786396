"""The command's options on reading data: tags, ranges, gaps, and what a wrong one says."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import workbench as wb
from workbench.cli import app
from workbench.cli.compiling import SAID, tell_compiling
from workbench.cli.input import Reading, read_data


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A tall export of a sticky loop, OP in mA, PV bad for a while and the loop in manual at the end."""
    monkeypatch.chdir(tmp_path)
    loop = wb.Loop(wb.FOPDT(1.0, 6.0, 2.0), wb.Stenman(1.0), wb.PID(0.6, 15.0), 1.0)
    parts = (wb.Step(2.0), wb.Step(1.5, 300.0))
    run = wb.simulate(loop, wb.Experiment(900.0, parts, noise=wb.Noise(0.02, 3)))
    lines = ["Tag,Timestamp,Value,Quality"]
    for k in range(900):
        pv = "Bad Input,Bad" if k in (40, 41) else f"{run.pv[k] + 20.0:.4f},Good"
        lines.append(f"FIC7.MEAS,{k},{pv}")
        lines.append(f"FIC7.OUT,{k},{4.0 + 0.16 * (run.op[k] + 40.0):.5f},Good")
        lines.append(f"FIC7.MODE,{k},{'AUTO' if k < 800 else 'MAN'},Good")
        lines.append(f"FIC8.PV,{k},1,Good")
    (tmp_path / "tall.csv").write_text("\n".join(lines))
    return tmp_path


def test_a_historian_export_is_estimated_with_tags_and_ranges(folder: Path) -> None:
    reading = ("--tag", "PV=FIC7.MEAS", "--op-range", "4:20", "--pv-range", "0:50")
    code, out, err = call("estimate", "tall.csv", *reading)
    assert (code, err) == (0, "")
    for words in (
        "Record     758 samples of 1 s (0.211 h); 1 other stretch of 40 samples",
        "tags not used: FIC8.PV",
        "OP taken in % of its range, 4 to 20",
        "2 rows rejected: text ('Bad Input'), first in line 162, tag 'FIC7.MEAS'",
        "the 100 samples in manual are left out",
        "Verdict    the valve sticks",
    ):
        assert words in out, words
    code, out, _ = call("estimate", "tall.csv", "--json", "--max-gap", "5 s", *reading)
    record = json.loads(out)["record"]
    assert code == 0
    assert record["samples"] == 800
    assert record["counts"]["between"] == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--tag", "PV"], "--tag: PV given; must be SIGNAL=NAME"),
        (["--tag", "PV="], "--tag: PV= given; must be SIGNAL=NAME"),
        (["--tag", "FLOW=FIC7.MEAS"], "tags: 'FLOW' given; must be one of"),
        (["--op-range", "20:4"], "--op-range: 20:4 given; must be LOW:HIGH with LOW < HIGH"),
        (["--op-range", "4-20"], "--op-range: 4-20 given; must be LOW:HIGH with LOW < HIGH, such as 4:20"),
        (["--sample-time", "0"], "--sample-time: 0.0 given; must be a finite number > 0 s"),
        (["--sample-time", "2,5 s"], "decimals are written with a point, such as 2.5"),
        (["--max-gap", "5"], "--max-gap: 5 given; must be a time with its unit"),
        (["--tag", "PV=FIC7.MEAS", "--pv-range", "500:600"], "PV runs from 19"),
    ],
)
@pytest.mark.parametrize("command", ["estimate", "tune"])
def test_wrong_reading_is_one_clear_line(folder: Path, command: str, arguments: list[str], words: str) -> None:
    code, out, err = call(command, "tall.csv", *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert len(err.splitlines()) == 1


def test_a_file_without_a_known_tag_asks_for_the_option(folder: Path) -> None:
    text = (folder / "tall.csv").read_text()
    (folder / "tall.csv").write_text(text.replace("FIC8.PV", "FIC8").replace("FIC7.MEAS", "FLOW"))
    code, _, err = call("estimate", "tall.csv")
    assert code == 2
    assert "no tag for PV; the file has 'FLOW', 'FIC7.OUT', 'FIC7.MODE', 'FIC8'" in err
    assert '--tag "PV=name in the file"' in err


def test_names_of_the_file_stay_what_they_are(folder: Path) -> None:
    (folder / "sample_time.csv").write_text("sample_time,sample_time_s,sp\n1,2,3\n", encoding="utf-8")
    _, _, err = call("estimate", "sample_time.csv")
    assert err.startswith(
        "workbench: sample_time.csv: no column for PV and OP; the file has 'sample_time', 'sample_time_s'"
    )
    (folder / "even.csv").write_text("PV,OP\n1,2\n2,3\n", encoding="utf-8")
    assert "no time column; give --sample-time" in call("estimate", "even.csv")[2]


def test_a_column_without_a_name_can_be_given(folder: Path) -> None:
    rows = "".join(f"{2 * k},{k % 7},{k % 5}\n" for k in range(40))
    (folder / "even.csv").write_text(f",PV,OP\n{rows}", encoding="utf-8")
    assert 'or the column, --column "time=" if it is the one without a name' in call("estimate", "even.csv")[2]
    record = read_data(folder / "even.csv", Reading(["time="], None, None, None, None, None))
    assert (len(record), record.sample_time) == (40, 2.0)


def test_what_the_hint_on_swapped_columns_says_mends_them(folder: Path) -> None:
    from workbench.record.reader import read_record

    rng = np.random.default_rng(0)
    sp = np.repeat([250.0, 251.0], 100)
    rows = zip(sp, sp + rng.normal(0.0, 0.1, 200), 40.0 + rng.normal(0.0, 1.0, 200), strict=True)
    text = "".join(f"{k},{a},{b},{c}\n" for k, (a, b, c) in enumerate(rows))
    (folder / "swap.csv").write_text("t,SP,OP,PV\n" + text, encoding="utf-8")
    _, _, err = call("estimate", "swap.csv")
    assert """If so, give --column "PV=OP" --column "OP=PV"; if they are right""" in err
    assert read_record(folder / "swap.csv", columns={"PV": "OP", "OP": "PV"}).pv.mean() == pytest.approx(250.5, abs=0.1)


def test_too_few_samples_say_what_became_of_the_others(folder: Path) -> None:
    rows = "".join(f"{k},{'Bad Input' if k % 7 == 0 else k % 5},{k % 3}\n" for k in range(700))
    (folder / "bad.csv").write_text("t,PV,OP\n" + rows, encoding="utf-8")
    _, _, err = call("estimate", "bad.csv")
    assert "6 samples given; at least 30 are needed to estimate a loop; 100 rows rejected: text ('Bad Input')" in err
    assert err.strip().endswith("kept the longest clean stretch: 6 of 700 rows, lines 3 to 8")


def test_an_option_that_does_not_fit_is_named(folder: Path) -> None:
    _, _, err = call("estimate", "tall.csv", "--tag", "PV=FIC7.MEAS", "--start", "5")
    assert err.startswith("workbench: --start: 5.0 given; only method 'two_step' starts")


def test_two_loops_in_a_file_ask_for_the_option(folder: Path) -> None:
    text = (folder / "tall.csv").read_text()
    (folder / "two.csv").write_text(text.replace("FIC7.MEAS", "FIC7.PV"))
    code, _, err = call("estimate", "two.csv")
    assert code == 2
    assert """tags 'FIC7.PV', 'FIC8.PV' could each be PV; say which one, for example --tag "PV=FIC7.PV\"""" in err


SCENARIO = """\
title: From a historian
loop: {controller: {Kc: 0.6, Ti: 15 s}}
estimate:
  data: tall.csv
  tags: {PV: FIC7.MEAS}
  op_range: [4, 20]
  pv_range: [0, 50]
  max_gap: 5 s
"""


def test_a_scenario_says_the_same(folder: Path) -> None:
    from workbench.scenario.loader import load_scenario

    (folder / "plan.yaml").write_text(SCENARIO)
    record = load_scenario(folder / "plan.yaml").estimates[0].record
    assert record is not None
    assert (len(record), record.pv_range) == (800, (0.0, 50.0))
    assert 35.0 < record.op.min() < record.op.max() < 50.0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[4, 20]", "[20, 4]", "op_range"),
        ("[0, 50]", "[500, 600]", "PV runs from 19"),
        ("PV: FIC7.MEAS", "PV: FIC9", "tag 'FIC9' given for PV: there is no such tag"),
        ("PV: FIC7.MEAS", "FLOW: FIC7", "tags.FLOW"),
        ("5 s", "0 s", "max_gap"),
    ],
)
def test_a_wrong_scenario_is_refused_where_it_is_wrong(folder: Path, old: str, new: str, words: str) -> None:
    assert old in SCENARIO
    (folder / "plan.yaml").write_text(SCENARIO.replace(old, new))
    code, _, err = call("check", "plan.yaml")
    assert code == 2
    assert words in err
    assert err.startswith("plan.yaml:")


def write_moving(path: Path) -> None:
    """Write a record of a loop that moves, as a run looks at it."""
    path.write_text("t,PV,OP\n" + "".join(f"{k},{k * 7 % 11},{k * 5 % 13}\n" for k in range(200)), encoding="utf-8")


@pytest.mark.parametrize("command", ["tune", "ui"])
def test_a_manifest_of_many_loops_is_named_as_one(command: str) -> None:
    manifest = Path(__file__).parents[1] / "scenarios" / "fleet_table_1.yaml"
    result = CliRunner().invoke(app, [command, str(manifest)])
    assert result.exit_code == 2
    assert "a manifest of many loops; `workbench fleet` or `workbench run` takes it" in result.output
    assert "unknown key" not in result.output


@pytest.mark.parametrize(
    ("entries", "code", "said"),
    [
        ("- {name: A, file: a.csv}", 0, "site.yaml: ok (1 loop)"),
        ("- {name: A, file: a.csv}\n  - {name: B, file: b.csv}", 1, "site.yaml: 1 of 2 loops cannot be read"),
        ("- {name: B, file: b.csv}", 1, "site.yaml: 1 of 1 loop cannot be read"),
    ],
)
def test_a_manifest_is_checked_as_its_run_would_end(folder: Path, entries: str, code: int, said: str) -> None:
    write_moving(folder / "a.csv")
    (folder / "site.yaml").write_text(f"loops:\n  {entries}\n", encoding="utf-8")
    ended, out, err = call("check", "site.yaml")
    assert (ended, out.strip()) == (code, said)
    assert ("b.csv is not there" in err) == (code == 1)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"t,PV,OP\n" + b"".join(b"%d,%d,%d\n" % (k, k % 7, k % 5) for k in range(20)), "at least 30 are needed"),
        (b"t,SP,OP\n" + b"".join(b"%d,3,%d\n" % (k, k % 5) for k in range(60)), "no column for PV"),
        (bytes(range(256)) * 4, "no text file (it holds binary bytes)"),
        (b"PV,OP\n1,2\n", "no time column"),
    ],
)
def test_a_check_reads_a_manifests_loops_as_its_run_does(folder: Path, content: bytes, said: str) -> None:
    (folder / "b.csv").write_bytes(content)
    write_moving(folder / "a.csv")
    (folder / "site.yaml").write_text("loops:\n  - {name: A, file: a.csv}\n  - {name: B, file: b.csv}\n")
    code, out, err = call("check", "site.yaml")
    assert (code, out) == (1, "site.yaml: 1 of 2 loops cannot be read\n")
    assert err.startswith("site.yaml: B: ")
    assert said in err
    assert err.count("\n") == 1


def test_a_loop_that_stands_still_is_a_warning_as_its_run_looks_at_it(folder: Path) -> None:
    (folder / "a.csv").write_text("t,PV,OP\n" + "".join(f"{k},40,{k % 5}\n" for k in range(60)))
    (folder / "site.yaml").write_text("loops:\n  - {name: A, file: a.csv}\n")
    code, out, err = call("check", "site.yaml")
    assert (code, out) == (0, "site.yaml: ok (1 loop)\n")
    assert err.startswith("site.yaml: A: warning: PV is constant over all 60 samples")


def test_a_manifest_in_csv_is_checked_too(folder: Path) -> None:
    write_moving(folder / "a.csv")
    (folder / "site.csv").write_text("name,file\nA,a.csv\n", encoding="utf-8")
    assert call("check", "site.csv")[:2] == (0, "site.csv: ok (1 loop)\n")


def test_that_kernels_compile_is_said_once_on_standard_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from numba.core import event

    monkeypatch.setattr(event, "_registered", defaultdict(list))
    tell_compiling.__wrapped__()
    assert capsys.readouterr() == ("", "")
    for _ in range(2):
        with event.trigger_event("numba:compile"):
            pass
    assert capsys.readouterr() == ("", f"{SAID}\n")
