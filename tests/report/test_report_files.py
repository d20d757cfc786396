"""What write_report puts on disk: whole, the same each time, strict, escaped."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import OutputError
from workbench.model.numbers import figure
from workbench.model.results import Kpis
from workbench.model.study import Study
from workbench.report import page
from workbench.report.cells import cell
from workbench.report.page import figure_names, write_report
from workbench.report.results import cases_csv, strict

EVIL = '<script>alert("x")</script>'


def read(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


def test_the_files(study: Study, written: Path) -> None:
    names = {p.name for p in written.iterdir()}
    figures = figure_names(study)
    expected = {n for group in (*figures["cases"], *figures["estimates"]) for n in group.values()}
    expected |= {"overlay.svg", "frequency.svg", "report.html", "results.json", "cases.csv", "run.json"}
    assert names == expected
    assert sum(p.stat().st_size for p in written.iterdir()) < 2_000_000


def test_the_same_to_the_byte_but_for_times_and_versions_in_run_json(
    study: Study, tmp_path: Path, written: Path
) -> None:
    slower = replace(study.cases[2], tuned=replace(study.cases[2].tuned, wall_time=99.0, versions={"casadi": "9.9"}))
    write_report(replace(study, cases=(*study.cases[:2], slower), times={"simulate": 77.0}), tmp_path)
    first, second = read(written), read(tmp_path)
    first.pop("run.json")
    run = json.loads(second.pop("run.json"))
    assert first == second
    assert run["times"] == {"simulate": 77.0}
    assert run["tuning_times"] == {"Optimised PI": 99.0}
    assert run["solver"] == {"casadi": "9.9"}
    assert {"python", "numpy", "matplotlib"} <= set(run["versions"])


def test_results_are_strict_json(study: Study, written: Path) -> None:
    def refuse(token: str) -> None:
        raise AssertionError(token)

    content = json.loads((written / "results.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert [c["name"] for c in content["cases"]] == ["Case 1", "Case 2", "Optimised PI"]
    first = content["cases"][0]
    assert first["controller"]["derivative_filter"] == "none"
    assert first["controller"]["structure"] == "PID on error"
    assert first["kpis"]["valve_travel"] == pytest.approx(12.18, abs=0.005)
    assert first["describing_function"]["predicts_cycle"] is False
    assert first["describing_function"]["period"] is None
    assert first["limit_cycle"]["outcome"] == "cycles"
    assert len(first["limit_cycle"]["starts"]) == 2
    assert content["cases"][1]["describing_function"] is None
    assert content["seeds"] == {"noise": None, "tuning": {"Optimised PI": 0}}
    assert content["tuning"][0]["status"] == "solved"
    assert content["tuning"][0]["spread"]["best"] <= content["tuning"][0]["spread"]["worst"]
    assert content["estimate"]["verdict"] == "stiction"
    assert content["estimate"]["intervals"]["d"] == [1.99, 2.01]
    assert content["estimates"] == [content["estimate"]]
    assert "wall_time" not in (written / "results.json").read_text()


@settings(deadline=None, max_examples=100)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda s: st.lists(s) | st.dictionaries(st.text(), s),
        max_leaves=10,
    )
)
def test_anything_becomes_strict_json(value: Any) -> None:
    text = json.dumps(strict(value), allow_nan=False)
    assert json.dumps(strict(json.loads(text)), allow_nan=False) == text


def test_last_bits_do_not_show() -> None:
    assert strict(0.1 + 0.2) == strict(0.3)
    assert strict(-3e-15) == strict(0.0)
    assert strict([float("inf"), float("-inf"), float("nan")]) == ["none", None, None]


class Tags(HTMLParser):
    """Gathers a page's tags, their addresses and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.open: list[str] = []
        self.outside: list[str] = []
        self.ids: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name == "id" and value:
                self.ids.append(value)
            if name in ("src", "href", "xlink:href") and value and not value.startswith("#"):
                self.outside.append(value)

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_stands_alone(written: Path) -> None:
    text = (written / "report.html").read_text(encoding="utf-8")
    seen = Tags(text)
    assert "script" not in seen.tags
    assert "link" not in seen.tags
    assert seen.outside == []
    assert seen.tags.count("svg") == len(list(written.glob("*.svg")))
    assert len(seen.ids) == len(set(seen.ids))
    for needed in (
        "What was found",
        "What to do",
        "publ. 12.18",
        "to the digit",
        "Appendix: the scenario",
        "2 rows were left out",
    ):
        assert needed in seen.text
    uses = set(re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', text))
    assert {a or b for a, b in uses} <= set(seen.ids)


def test_one_figure_has_one_rounding_on_the_page(study: Study, written: Path) -> None:
    page = (written / "report.html").read_text(encoding="utf-8")
    text = re.sub(r"<svg.*?</svg>|<[^>]*>", " ", page, flags=re.S)
    shown = set(re.findall(r"(?<![\d.,])\d[\d,]*(?:\.\d+)?", text))
    figures = [v for c in study.cases for v in (c.objective, c.run.kpis.mean_square_error, c.run.kpis.valve_travel)]
    figures += [c.tuned.worst for c in study.cases if c.tuned is not None]
    for value in figures:
        assert value is not None
        assert figure(value) in shown
        assert not {figure(value, k) for k in (3, 5, 6)} & shown - {figure(value), "4.01"}, "4.01 is published"


def test_the_svg_files_are_xml_with_their_text(written: Path) -> None:
    for path in written.glob("*.svg"):
        root = ET.fromstring(path.read_text(encoding="utf-8"))
        assert root.tag.endswith("svg")
        assert any(e.tag.endswith("text") and e.text for e in root.iter()), path.name
        assert "metadata" not in path.read_text(encoding="utf-8")


def test_text_from_scenarios_and_data_is_escaped(study: Study, tmp_path: Path) -> None:
    first, named = study.cases[0], study.estimates[0]
    evil = replace(
        study,
        title=EVIL,
        description=EVIL,
        scenario_text=EVIL + "]]>",
        reference_source=EVIL,
        notes=(EVIL,),
        cases=(replace(first, name=EVIL + ' d="M 1 2" $x^2$ \\frac', note=EVIL, agreement=EVIL), study.cases[2]),
        estimates=(replace(named, name=EVIL, note=EVIL, found=replace(named.found, reasons=(EVIL,))),),
    )
    write_report(evil, tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script" not in text
    seen = Tags(text)
    assert "script" not in seen.tags
    assert seen.text.count(EVIL) >= 8
    assert 'd="M 1 2" $x^2$' in seen.text
    for path in tmp_path.glob("*.svg"):
        assert "<script" not in path.read_text(encoding="utf-8")
        ET.fromstring(path.read_text(encoding="utf-8"))
    assert {p.parent for p in tmp_path.rglob("*") if p.is_file()} == {tmp_path}


def test_csv(study: Study) -> None:
    renamed = replace(study, cases=(replace(study.cases[0], name="=cmd|'/c calc'!A1"), *study.cases[1:]))
    rows = list(csv.DictReader(StringIO(cases_csv(renamed))))
    assert len(rows) == 3
    assert rows[0]["case"] == "'=cmd|'/c calc'!A1"
    assert float(rows[0]["valve_travel"]) == pytest.approx(12.18, abs=0.005)
    assert float(rows[0]["final_error"]) < 0.0
    assert rows[0]["reference_valve_travel"] == "12.18"
    assert rows[2]["reference_valve_travel"] == ""
    assert rows[2]["tuning_status"] == "solved"
    assert set(Kpis.__dataclass_fields__) <= set(rows[0])


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@x", "\t=1", " =1", "\r\n+1"])
def test_cells_that_spreadsheets_would_run_are_defused(text: str) -> None:
    assert cell(text) == "'" + text
    assert cell("Case 1") == "Case 1"
    assert cell(-1.5) == "-1.5"


@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_run_leaves_the_last_good_report(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = replace(study, cases=study.cases[:1], estimates=())
    write_report(study, tmp_path)
    before = read(tmp_path)
    other = replace(study, title="Another title")

    def broken(_: Study) -> str:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(page, "run_json", broken)
        with pytest.raises(KeyboardInterrupt):
            write_report(other, tmp_path)
    assert read(tmp_path) == before

    opened = Path.open
    count = 0

    def full(self: Path, *args: Any, **kwargs: Any) -> Any:
        nonlocal count
        count += "w" in args
        if count == 5:
            raise OSError(28, "No space left on device")
        return opened(self, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        with pytest.raises(OutputError, match="No space left on device"):
            write_report(other, tmp_path)
    assert read(tmp_path) == before


@pytest.mark.usefixtures("undrawn")
def test_figures_of_a_former_run_are_removed_and_others_kept(study: Study, written: Path, tmp_path: Path) -> None:
    shutil.copytree(written, tmp_path, dirs_exist_ok=True)
    mine = tmp_path / "my_sketch.svg"
    mine.write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    assert (tmp_path / "trend_case_2.svg").exists()
    write_report(replace(study, cases=study.cases[:1], estimates=()), tmp_path)
    left = {p.name for p in tmp_path.glob("*.svg")}
    assert left == {"trend_case_1.svg", "pv_op_case_1.svg", "frequency.svg", "my_sketch.svg"}


@pytest.mark.parametrize("where", ["a_file", "a_file/below"])
def test_a_folder_that_cannot_be_written(study: Study, tmp_path: Path, where: str) -> None:
    (tmp_path / "a_file").write_text("in the way")
    with pytest.raises(OutputError, match="is a file, not a folder") as caught:
        write_report(replace(study, cases=(), estimates=()), tmp_path / where)
    assert "\n" not in str(caught.value)
    assert read(tmp_path) == {"a_file": b"in the way"}


@pytest.mark.usefixtures("undrawn")
def test_a_folder_in_a_files_place_leaves_the_old_report_whole(study: Study, tmp_path: Path) -> None:
    small = replace(study, cases=study.cases[:1], estimates=())
    write_report(small, tmp_path)
    (tmp_path / "run.json").unlink()
    before = read(tmp_path)
    (tmp_path / "run.json").mkdir()
    (tmp_path / "sketch.svg").mkdir()
    with pytest.raises(OutputError, match=r"run.json: is a folder"):
        write_report(replace(small, title="Another title"), tmp_path)
    (tmp_path / "run.json").rmdir()
    (tmp_path / "sketch.svg").rmdir()
    assert read(tmp_path) == before
    (tmp_path / "sketch.svg").mkdir()
    write_report(small, tmp_path)
    assert (tmp_path / "sketch.svg").is_dir()


def test_a_study_of_nothing_has_a_page(tmp_path: Path) -> None:
    write_report(Study("none", "None", "", "", None, None, (), ()), tmp_path)
    assert "Nothing was asked" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_many_cases_of_wild_names_and_an_unstable_one(study: Study, case: Callable[..., Any], tmp_path: Path) -> None:
    cases = [replace(study.cases[0], name=f"名 {i} _$\\frac{{" + "x" * 80) for i in range(3)]
    cases += [replace(case("same", 50.0, 5.0), name=n) for n in ("same", "SAME", "_same")]
    write_report(replace(study, cases=tuple(cases), estimates=()), tmp_path)
    assert len(list(tmp_path.glob("trend_*.svg"))) == 6
    assert "the loop is unstable" in (tmp_path / "report.html").read_text(encoding="utf-8")
    for path in tmp_path.glob("*.svg"):
        assert not re.search(r'd="[^"]*(nan|inf)', path.read_text(encoding="utf-8"))
