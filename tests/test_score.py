"""`workbench score`: labels, figures and refusals."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import workbench as wb
from workbench.cli import app
from workbench.score import Scored, labelled, score, score_content


def scored(file: str, tag: str, label: str, verdict: str) -> Scored:
    return Scored(file, tag, label, verdict, 1.0, 1.0, 2.0, math.nan, 0.5, "", 0.1)


def test_the_figures() -> None:
    content = score_content(
        [
            scored("a.csv", "A", "stiction", "stiction"),
            scored("b.csv", "A", "stiction", "stiction"),
            scored("c.csv", "A", "stiction", "undecided"),
            scored("d.csv", "B", "no_stiction", "stiction"),
            scored("e.csv", "C", "no_stiction", "no_stiction"),
            scored("f.csv", "C", "no_stiction", "undecided"),
        ]
    )
    assert content["accuracy"] == 0.5
    assert content["accuracy_by_tag"] == pytest.approx(1.0 / 3.0)
    assert content["confusion"]["no_stiction"] == {"stiction": 1, "no_stiction": 1, "undecided": 1}
    assert content["loops"][0]["tau"] is None
    assert content["loops"][0]["K"] == 2.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("file\na.csv\n", "no column 'label'"),
        ("file,label\na.csv,sticky\n", "labels.csv:2: label 'sticky' given; must be stiction or no_stiction"),
        ("file,label\nb.csv,stiction\n", "file 'b.csv' is not in"),
        ("file,label\na.csv,stiction\na.csv,stiction\n", "labelled twice"),
        ("file,label\n", "names no record"),
        ("", "no column 'file'"),
    ],
)
def test_labels_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_text("PV,OP\n1,2\n", encoding="utf-8")
    (tmp_path / "labels.csv").write_text(text, encoding="utf-8")
    result = CliRunner().invoke(app, ["score", str(tmp_path)])
    assert result.exit_code == 2
    assert message in result.output
    assert not (tmp_path / "score.json").exists()


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_labels_are_parted_as_records_are(tmp_path: Path, mark: str) -> None:
    (tmp_path / "a.csv").touch()
    (tmp_path / "labels.csv").write_text(f"file{mark}label\r\na.csv{mark}stiction\r\n", encoding="utf-8")
    assert [(line.path.name, line.label) for line in labelled(tmp_path)] == [("a.csv", "stiction")]


def test_a_folder_without_labels_is_refused(tmp_path: Path) -> None:
    with pytest.raises(wb.RecordError, match="cannot be read"):
        labelled(tmp_path)


def test_a_folder_is_scored_and_a_bad_record_counts_as_undecided(tmp_path: Path) -> None:
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(600.0, setpoint=wb.Step(4.0), noise=wb.Noise(0.05, 1)))
    table = np.column_stack([run.time, run.sp, run.pv, run.op])
    np.savetxt(tmp_path / "sticky.csv", table, delimiter=",", header="time,SP,PV,OP", comments="", fmt="%.9g")
    (tmp_path / "bad.csv").write_text("time,PV,OP\n0,1,2\n1,1,2\n", encoding="utf-8")
    (tmp_path / "labels.csv").write_text("file,label,tag\nsticky.csv,stiction,FIC1\nbad.csv,stiction,FIC2\n", "utf-8")
    seen: list[str] = []
    lines = labelled(tmp_path)
    found = score(lines, lambda name, _: seen.append(name))
    assert seen == ["sticky.csv", "bad.csv"]
    assert [one.verdict for one in found] == ["stiction", "undecided"]
    assert found[1].error
    result = CliRunner().invoke(app, ["score", str(tmp_path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0
    assert "accuracy 50.0% of 2 records, 50.0% of 2 tags" in result.output
    content = json.loads((tmp_path / "out" / "score.json").read_text(encoding="utf-8"))
    assert content["accuracy"] == 0.5
    assert content["loops"][0]["S"] == pytest.approx(2.0, rel=0.05)
    assert "time" not in content["loops"][0]
