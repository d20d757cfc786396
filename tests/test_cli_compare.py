"""`workbench compare`: what it prints and writes, and that bad input is one line and leaves nothing behind."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from cascades import TWO_LOOPS
from typer.testing import CliRunner

from workbench.cli import app
from workbench.report import page

SCENARIO = """\
title: A short run
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2.0}
  sample_time: 1 s
experiment: {duration: 120 s, setpoint: {step: 4, at: 0 s}}
objective: {w1: 0.5, w3: 0.5}
cases:
  - {name: Case 1, Kc: 0.5, Ti: 20 s}
  - {name: "[bold]=Case 2", Kc: 0.5, Ti: 200 s}
analyze: {limit_cycle: false}
"""


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Reports of two runs, the second with another dead time of the plant."""
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "svg_text", lambda *_: "<svg></svg>")  # what is compared is no figure
        for name, text in (("first", SCENARIO), ("second", SCENARIO.replace("dead_time: 1 s", "dead_time: 2 s"))):
            (folder / f"{name}.yaml").write_text(text)
            assert call("run", folder / f"{name}.yaml", "--out", folder / "reports")[0] == 0
    return folder / "reports"


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def test_two_runs_are_laid_beside_each_other(reports: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "compared"
    code, said, wrong = call("compare", reports / "first", reports / "second" / "results.json", "--out", out)
    assert (code, wrong) == (0, "")
    lines = said.splitlines()
    assert lines[0].split()[:2] == ["scenario", "case"]
    assert "first" in lines[1]
    assert "(base)" in lines[1]
    assert "[bold]=Case 2" in lines[2]
    assert "another plant than the base's" in " ".join(said.split())
    assert {path.name for path in out.iterdir()} == {"compare.html", "compare.csv"}
    assert "'[bold]" not in (out / "compare.csv").read_text()
    assert (out / "compare.html").read_text().count("<svg") == 1
    again = tmp_path / "again"
    assert call("compare", reports / "first", reports / "second" / "results.json", "--out", again)[0] == 0
    for name in ("compare.html", "compare.csv"):
        assert (again / name).read_bytes() == (out / name).read_bytes()


def test_settings_that_a_search_found_have_all_its_digits(reports: Path, tmp_path: Path) -> None:
    content = json.loads((reports / "first" / "results.json").read_text())
    searched = content["cases"][0]
    searched["controller"]["Kc"] = 0.792288158932
    content["tuning"] = [{"name": searched["name"], "digits": 12}]
    (tmp_path / "results.json").write_text(json.dumps(content))
    code, said, _ = call("compare", tmp_path)
    assert code == 0
    assert "0.792288158932" in said


def test_base_and_cases_are_chosen(reports: Path) -> None:
    code, said, _ = call("compare", reports, "--base", "second", "--include", "Case 1")
    assert code == 0
    rows = [line for line in said.splitlines() if "Case 1" in line]
    assert len([row for row in rows if not row.startswith("Note")]) == 2
    assert rows[0].startswith("second")
    code, _, wrong = call("compare", reports, "--base", "Case 1")
    assert code == 2
    assert wrong == "workbench: --base: Case 1 given; must say which one: first: Case 1; second: Case 1\n"


@pytest.mark.usefixtures("undrawn")
def test_a_cascades_loops_stand_apart(tmp_path: Path) -> None:
    (tmp_path / "both.yaml").write_text(TWO_LOOPS)
    assert call("run", tmp_path / "both.yaml", "--out", tmp_path)[0] == 0
    code, said, _ = call("compare", tmp_path / "both", "--out", tmp_path / "out")
    assert code == 0
    assert "As found (primary)" in said
    assert "As found (secondary)" in said
    assert "the secondary is another loop than the base's" in " ".join(said.split())
    html = (tmp_path / "out" / "compare.html").read_text()
    assert html.count("<svg") == 1
    # A primary has no stem, so that it has no reversals either.
    assert ">nan<" not in html
    rows = list(csv.DictReader((tmp_path / "out" / "compare.csv").read_text().splitlines()))
    assert [(row["loop"], bool(row["valve_travel"])) for row in rows] == [("primary", False), ("secondary", True)]


def test_bad_input_is_one_line_and_nothing_is_written(reports: Path, tmp_path: Path) -> None:
    half = tmp_path / "half.json"
    half.write_bytes((reports / "first" / "results.json").read_bytes()[:-300])
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"format": 3}))
    for given, said in (
        (half, "broken JSON"),
        (other, "format 3 given"),
        (tmp_path / "none", "no such file or folder"),
        (reports / "first" / "cases.csv", "broken JSON"),
        (tmp_path, "a folder without results.json"),
    ):
        out = tmp_path / "out"
        code, printed, wrong = call("compare", reports / "first", given, "--out", out)
        assert (code, printed) == (2, ""), given
        assert said in wrong
        assert wrong.count("\n") == 1
        assert not out.exists()


def test_a_place_that_cannot_be_written_is_said(reports: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    code, _, wrong = call("compare", reports / "first", "--out", tmp_path / "file" / "x")
    assert code == 2
    assert "cannot be written (a part of this path is a file, not a folder)" in wrong
