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
    ("labels", "verdicts", "right"),
    [
        (("stiction", "no_stiction"), ("no_stiction", "stiction"), (0, 2)),
        (("stiction", "no_stiction"), ("undecided", "undecided"), (0, 2)),
        (("stiction", "no_stiction"), ("stiction", "no_stiction"), (2, 2)),  # before and after repair
        (("stiction", "stiction"), ("stiction", "no_stiction"), (0, 1)),
        (("stiction", "stiction"), ("undecided", "undecided"), (0, 1)),
        (("stiction", "stiction", "no_stiction"), ("stiction", "stiction", "stiction"), (1, 2)),
        (("stiction", "stiction", "stiction"), ("undecided", "stiction", "stiction"), (1, 1)),
    ],
)
def test_a_tie_within_a_tag_is_never_right_and_both_labels_are_two_tags(
    labels: tuple[str, ...], verdicts: tuple[str, ...], right: tuple[int, int]
) -> None:
    pairs = zip(labels, verdicts, strict=True)
    content = score_content([scored(f"{i}.csv", "T", *both) for i, both in enumerate(pairs)])
    assert content["tags"] == right[1]
    assert content["accuracy_by_tag"] == right[0] / right[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("file\na.csv\n", "no column 'label'"),
        ("file,label\na.csv,sticky\n", "labels.csv:2: label 'sticky' given; must be stiction or no_stiction"),
        ("file,label\nb.csv,stiction\n", "file 'b.csv' is not in"),
        ("file,label\na.csv,stiction\na.csv,stiction\n", "labelled twice"),
        (
            "file,label\na.csv,stiction\n./a.csv,stiction\n",
            "'./a.csv' is labelled twice; it stands already in line 2",
        ),
        ("file,label\n../beside.csv,stiction\n", "file '../beside.csv' is not in"),
        ("file,label\na.csv,stiction,FIC1\n", "labels.csv:2: 3 cells given; its columns are file, label"),
        ("file,label,Label\na.csv,stiction,no_stiction\n", "2 columns 'label'; it must have one"),
        ("file,label\n", "names no record"),
        ("", "no column 'file'"),
    ],
)
def test_labels_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    folder = tmp_path / "records"
    folder.mkdir()
    for path in (folder / "a.csv", tmp_path / "beside.csv"):
        path.write_text("PV,OP\n1,2\n", encoding="utf-8")
    (folder / "labels.csv").write_text(text, encoding="utf-8")
    result = CliRunner().invoke(app, ["score", str(folder)])
    assert result.exit_code == 2
    assert message in result.output
    assert not (folder / "score.json").exists()


def test_a_record_is_listed_once_however_it_is_written(tmp_path: Path) -> None:
    (tmp_path / "a.csv").touch()
    (tmp_path / "labels.csv").write_text(f"file,label\na.csv,stiction\n{tmp_path / 'a.csv'},stiction\n", "utf-8")
    with pytest.raises(wb.RecordError, match="labelled twice"):
        labelled(tmp_path)


def test_files_of_one_name_are_told_apart(tmp_path: Path) -> None:
    names = ["wide.csv", "wide.parquet", "sub/wide.csv"]
    (tmp_path / "sub").mkdir()
    for name in names:
        (tmp_path / name).write_text("PV,OP\n1,2\n", encoding="utf-8")
    (tmp_path / "labels.csv").write_text("file,label\n" + "".join(f"{name},stiction\n" for name in names), "utf-8")
    lines = labelled(tmp_path)
    assert [(line.file, line.tag) for line in lines] == [(name, name) for name in names]
    content = score_content(score(lines))
    assert [loop["file"] for loop in content["loops"]] == names
    assert content["tags"] == 3


@pytest.mark.parametrize(
    "text",
    ["PV,OP\n1,2\n2,3\n", "time,A,OP\n0,1,2\n1,1,3\n", "time,F1.PV,F2.PV,OP\n0,1,2,3\n1,2,2,4\n"],
)
def test_what_cannot_be_used_is_told_in_words_of_the_folder(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    (tmp_path / "labels.csv").write_text("file,label\na.csv,stiction\n", "utf-8")
    (found,) = score(labelled(tmp_path))
    assert found.error.endswith("in the file, one column or tag each must be called time, PV and OP")
    assert "={" not in found.error


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_labels_are_parted_as_records_are(tmp_path: Path, mark: str) -> None:
    (tmp_path / "a.csv").touch()
    (tmp_path / "labels.csv").write_text(f"file{mark}label\r\na.csv{mark}stiction\r\n", encoding="utf-8")
    assert [(line.path.name, line.label) for line in labelled(tmp_path)] == [("a.csv", "stiction")]


def test_the_case_of_a_column_does_not_matter(tmp_path: Path) -> None:
    (tmp_path / "a.csv").touch()
    (tmp_path / "labels.csv").write_text("File,LABEL,Tag,comment\na.csv,stiction,FIC1,\n", encoding="utf-8")
    assert [(line.label, line.tag) for line in labelled(tmp_path)] == [("stiction", "FIC1")]


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
