"""Folders, data sets and manifests as lists of loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from fleet_helpers import record, tall, write_csv, write_tall

import workbench as wb
from workbench.errors import InvalidValue, RecordError, ScenarioError
from workbench.fleet.loops import OWN
from workbench.fleet.source import only, sources_of
from workbench.fleet.store import Store, fleet_csv
from workbench.fleet.task import look_at, read
from workbench.model.fleet import FleetRow, LoopSource, Settings, Tuning


@pytest.fixture(scope="module")
def one():
    return record(sticky=True, n=200)


def names(path: Path) -> list[str]:
    return [loop.name for loop in sources_of(path).loops]


def by_name(path: Path) -> dict[str, LoopSource]:
    return {loop.name: loop for loop in sources_of(path).loops}


def test_a_folder_of_files_of_all_kinds(tmp_path: Path, one) -> None:
    write_csv(tmp_path / "b.csv", one)
    (tmp_path / "unit 2").mkdir()
    write_csv(tmp_path / "unit 2" / "b.csv", one)
    for other in ("_truth.csv", ".hidden.csv", "labels.csv", "readme.md"):
        (tmp_path / other).write_text("no record")
    pq.write_table(pa.table({"PV": one.pv, "OP": one.op}), tmp_path / "wide.parquet")
    write_tall(tmp_path / "site" / "unit=1" / "x.parquet", tall("FIC1", one, 0, 100), tall("LIC2", one))
    write_tall(tmp_path / "site" / "unit=2" / "x.parquet", tall("FIC1", one, 100))
    (tmp_path / "half.parquet").write_bytes(b"PAR1 and no end")
    loops = by_name(tmp_path)
    assert list(loops) == ["FIC1", "LIC2", "b", "half", "unit 2/b", "wide"]
    assert "no readable Parquet" in loops["half"].refusal
    assert len(loops["FIC1"].pieces) == 2
    assert len(read(loops["FIC1"], Settings())) == 200
    assert len(read(loops["unit 2/b"], Settings())) == 200


def test_what_the_workbench_wrote_itself_is_no_loop(tmp_path: Path, one) -> None:
    write_csv(tmp_path / "FIC1.csv", one)
    for own, beside in OWN.items():  # as `workbench estimate`, `run` and `compare` leave them
        if own == "fleet.csv":
            continue
        folder = tmp_path / "reports" / own
        folder.mkdir(parents=True)
        write_csv(folder / own, one)
        (folder / beside).write_text("{}")
    row = FleetRow("FIC1")
    whole = Store(tmp_path / "monday", "x", Settings(), resume=False)
    whole.begin()
    whole.finish([row], {"fleet.csv": fleet_csv([row])}, ())
    half = Store(tmp_path / "tuesday", "x", Settings(), resume=False)
    half.begin()
    half.add(row)
    half.flush()
    assert len(list(tmp_path.rglob("part-*.parquet"))) == 1
    assert names(tmp_path) == ["FIC1"]
    # A loop's own record of such a name stays one.
    write_csv(tmp_path / "estimate.csv", one)
    assert names(tmp_path) == ["FIC1", "estimate"]


def test_names_that_two_loops_share_are_refused_and_others_stay(tmp_path: Path, one) -> None:
    write_csv(tmp_path / "FIC1.csv", one)
    write_tall(tmp_path / "x.parquet", tall("FIC1", one), tall("FIC2", one))
    loops = by_name(tmp_path)
    assert loops["FIC1"].refusal.startswith("2 loops have this name (")
    assert not loops["FIC2"].refusal


def test_tags_without_op_and_tags_of_one_signal_twice(tmp_path: Path, one) -> None:
    table = tall("FIC1", one)
    pv_only = table.slice(200)
    twice = tall("FIC3", one).set_column(0, "tag", pa.array(["FIC3.OUT"] * 200 + ["FIC3.PV"] * 200))
    odd = pa.table({"tag": ["ALARM"], "time": table.column("time").slice(0, 1), "value": [1.0], "quality": ["Good"]})
    write_tall(tmp_path / "x.parquet", pv_only, tall("FIC3", one), twice, odd)
    loops = by_name(tmp_path)
    assert list(loops) == ["FIC1", "FIC3"]
    assert loops["FIC1"].refusal == "no tag for OP (tags: FIC1.PV)"
    assert "'FIC3.OP' and 'FIC3.OUT' are both OP" in loops["FIC3"].refusal


def named_by_column(table: pa.Table, column: str, loop: str, tag: str = "") -> pa.Table:
    """A tall table whose loop stands in a column of its own; tag: before the signal, in the place of the loop's."""
    tags = [tag + str(one).rpartition(".")[2] for one in table.column("tag").to_pylist()]
    with_loop = table.set_column(0, "tag", pa.array(tags)).append_column(column, pa.array([loop] * len(tags)))
    return with_loop.set_column(4, column, with_loop.column(column).dictionary_encode())


def same_loops(path: Path, *records: wb.Record) -> list[str]:
    """The loops of a source by name, of which each must hold the PV and OP of its record."""
    loops = sources_of(path).loops
    for loop, one in zip(loops, records, strict=True):
        ours = read(loop, Settings())
        assert np.array_equal(ours.pv, one.pv)
        assert np.array_equal(ours.op, one.op)
    return [loop.name for loop in loops]


def test_a_column_names_the_loop_that_tags_are_of(tmp_path: Path, one) -> None:
    other = record(sticky=False, n=len(one))
    mixed = pa.concat_tables(
        [named_by_column(tall("x", one), "loop", "FIC1"), named_by_column(tall("x", other), "loop", "LIC2")]
    )
    pq.write_table(mixed.sort_by("time"), tmp_path / "x.parquet", row_group_size=300)
    assert same_loops(tmp_path, one, other) == ["FIC1", "LIC2"]
    (tmp_path / "m.yaml").write_text("data: x.parquet\nloops:\n  - {name: L, tags: {PV: LIC2.PV, OP: LIC2.OP}}\n")
    assert same_loops(tmp_path / "m.yaml", other) == ["L"]


def test_one_tag_of_two_units_is_two_loops(tmp_path: Path, one) -> None:
    # Half a second apart, the rows of both would else be one plausible record.
    other = record(sticky=False, n=len(one))
    later = tall("x", other)
    later = later.set_column(1, "time", pc.add(later.column("time"), pa.scalar(500, pa.duration("ms"))))
    write_tall(
        tmp_path / "x.parquet",
        named_by_column(tall("x", one), "asset", "North", "FIC1."),
        named_by_column(later, "asset", "South", "FIC1."),
    )
    assert same_loops(tmp_path, one, other) == ["North.FIC1", "South.FIC1"]


def test_folders_name_loop_and_tag_of_the_files_in_them(tmp_path: Path, one) -> None:
    other = record(sticky=False, n=len(one))
    both = pa.concat_tables([tall("FIC1", one), tall("LIC 2", other)])
    pq.write_to_dataset(both, tmp_path / "tags", partition_cols=["tag"])
    assert same_loops(tmp_path / "tags", one, other) == ["FIC1", "LIC 2"]
    loops = [named_by_column(tall("x", one), "loop", "FIC1"), named_by_column(tall("x", other), "loop", "LIC 2")]
    pq.write_to_dataset(pa.concat_tables(loops), tmp_path / "loops", partition_cols=["loop"])
    assert same_loops(tmp_path / "loops", one, other) == ["FIC1", "LIC 2"]


def test_tall_files_whose_tags_name_no_loop_are_a_loop_each(tmp_path: Path, one) -> None:
    other = record(sticky=False, n=len(one))
    for name, its in (("FIC1", one), ("LIC2", other)):
        write_tall(tmp_path / f"{name}.parquet", named_by_column(tall("x", its), "loop", name).drop_columns("loop"))
    assert same_loops(tmp_path, one, other) == ["FIC1", "LIC2"]


def test_nothing_to_look_at(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no such file or folder"):
        sources_of(tmp_path / "none")
    with pytest.raises(RecordError, match="holds no record"):
        sources_of(tmp_path)
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(RecordError, match="is no source of loops"):
        sources_of(tmp_path / "x.json")


def test_patterns_choose_loops(tmp_path: Path, one) -> None:
    write_tall(tmp_path / "x.parquet", tall("FIC1", one), tall("LIC2", one))
    sources = sources_of(tmp_path)
    assert [loop.name for loop in only(sources, ["L*", "X*"]).loops] == ["LIC2"]
    assert only(sources, ["L*"]).left_out == {loop.name for loop in sources.loops} - {"LIC2"}
    assert only(sources, []) is sources
    with pytest.raises(InvalidValue, match="matches none of the 2 loops"):
        only(sources, ["fic*"])


MANIFEST = """\
title: North
data: site
depth: estimate
loops:
  - name: FIC1
    pv_range: [0, 100]
    plant: integrating
    Kc: 0.5
    Ti: 2 repeats/min
    form: series
    criticality: 5
    area: "100"
  - {name: own tags, tags: {PV: FIC1.PV, OP: LIC2.OP}}
  - {name: file, file: b.csv, columns: {PV: PV}, sample_time: 1 s}
  - {name: gone, file: gone.csv}
  - {name: LIC9}
  - {name: missing, tags: {PV: FIC1.PV, OP: FIC1.CO}}
  - {name: twice}
  - {name: twice}
"""


@pytest.fixture
def site(tmp_path: Path, one) -> Path:
    write_tall(tmp_path / "site" / "x.parquet", tall("FIC1", one), tall("LIC2", one))
    write_csv(tmp_path / "b.csv", one)
    (tmp_path / "m.yaml").write_text(MANIFEST)
    return tmp_path


def test_a_manifest_in_yaml(site: Path) -> None:
    sources = sources_of(site / "m.yaml")
    loops = {loop.name: loop for loop in sources.loops}
    assert (sources.title, sources.depth) == ("North", "estimate")
    first = loops["FIC1"]
    assert first.tuning == Tuning(0.5, 30.0, 0.0, "series")
    assert (first.pv_range, first.plant, first.criticality, first.area) == ((0.0, 100.0), "integrating", 5, "100")
    for name in ("FIC1", "own tags", "file"):
        assert len(read(loops[name], Settings())) == 200
    refusals = {name: loop.refusal for name, loop in loops.items() if loop.refusal}
    assert set(refusals) == {"gone", "LIC9", "missing", "twice"}
    assert refusals["gone"] == f"{site / 'm.yaml'}: line 15: file gone.csv is not there"
    missing = "tag 'FIC1.CO' of OP is not in the data; nearest in its order: 'FIC1.OP', 'FIC1.PV', 'LIC2.OP', 'LIC2.PV'"
    assert refusals["missing"] == f"{site / 'm.yaml'}: line 17: {missing}"
    assert "line 18, line 19" in refusals["twice"]
    assert look_at(loops["twice"], Settings()).row.reason == refusals["twice"]


def test_a_manifest_in_csv(site: Path) -> None:
    text = (
        "name,file,PV,OP,pv_low,pv_high,Kc,Ti,criticality,area\n"
        "\n"
        "file,b.csv,,,0,100,0.5,20,2,north\n"
        "tags,,FIC1.PV,LIC2.OP,,,,,,\n"
    )
    (site / "m.csv").write_text(text)
    loops = by_name(site / "m.csv")
    assert loops["file"].tuning == Tuning(0.5, 20.0)
    assert loops["file"].pv_range == (0.0, 100.0)
    assert len(read(loops["file"], Settings())) == 200
    assert "neither a file nor a data set" in loops["tags"].refusal  # a CSV names no data set


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("loops: [{name: a, plnt: x}]", "m.yaml:1:19: loops[0].plnt: unknown entry 'plnt' (did you mean plant?)"),
        ("loops: [{nam: a}]", "loops[0]: name is missing"),
        ("loops: []", "m.yaml:1:8: loops: a list of 0 given; must hold at least 1"),
        ("title: x", "m.yaml:1:1: manifest: loops is missing"),
        ("loops: [{name: a, Ti: 20}]", 'loops[0].Ti: 20 given; must be a time with its unit, such as "20 s"'),
        (
            "loops: [{name: a, Kc: -1.5, Ti: 9 s}]",
            "loops[0].Kc: -1.5 given; must be above 0: Kc is positive, and",
        ),
        ("loops: [{name: a, Kc: 0, Ti: 9 s}]", "loops[0].Kc: 0 given; must be above 0: Kc is positive"),
        (
            "loops: [{name: a, action: direct}]",
            "unknown entry 'action', which is to be left out: Kc is positive",
        ),
        ("loops: [{name: a, Kc: abc}]", "loops[0].Kc: abc given; must be a number"),
        (
            "loops: [{name: a, plant: fopt}]",
            "fopt given (did you mean fopdt?); must be one of fopdt, integrating, auto",
        ),
        ("loops: [{name: a, criticality: 9}]", "loops[0].criticality: 9 given; must be <= 5"),
        ("loops: [{name: a, pv_range: [0]}]", "loops[0].pv_range: a list of 1 given; must be two numbers, [low, high]"),
        (
            "loops: [{name: a, pv_range: [5, 2]}]",
            "loops[0].pv_range: [5, 2] given; must be [low, high] with low < high",
        ),
        ("loops: [{name: a, Kc: 2}]", "m.yaml:1:9: loops[0]: Kc given without Ti; the present tuning needs both"),
        ("loops: [{name: a, Ti: 2 s}]", "loops[0]: Ti given without Kc"),
        ("loops: [{name: a, title: x}]", "unknown entry 'title' (did you mean file?); allowed: name, file,"),
        ("loops: [{name: a\n", "m.yaml:2:1: manifest: not valid YAML"),
        ("loops: [{name: a}]\ndata: none", "data: none given; no such file or folder"),
        ("loops: [{name: a}]\ndepth: deep", "depth"),
        ("", "m.yaml:1:1: manifest: the file is empty; must hold a mapping with title, data, depth, loops"),
        ("- a", "m.yaml:1:1"),
    ],
)
def test_manifests_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(ScenarioError) as refused:
        sources_of(tmp_path / "m.yaml")
    assert message in str(refused.value)
    assert "Traceback" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        (
            "m.yaml",
            "loops:\n  - {name: a}\n  - {name: b, Ti: 3}\n  - {name: a}\n  - {name: c, plant: x}\n",
            [
                "3:19: loops[1].Ti: 3 given; ",
                "4:12: loops[2].name: a given; loops[0] has this name",
                "5:22: loops[3].plant",
            ],
        ),
        (
            "m.csv",
            "name,Kc,Ti\na,1,9\nb,x,9\na,2,9\nc,-1,9\n",
            ["3:1: Kc: x given", "4:1: name: a given; line 2 has this name already", "5:1: Kc: -1 given"],
        ),
    ],
)
def test_all_mistakes_of_a_manifest_are_told_at_once(tmp_path: Path, name: str, text: str, told: list[str]) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ScenarioError) as refused:
        sources_of(tmp_path / name)
    lines = str(refused.value).splitlines()
    assert len(lines) == len(told)
    for line, start in zip(lines, told, strict=True):
        assert line.startswith(f"{tmp_path / name}:{start}")
        assert ": :" not in line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("loop,file\na,b.csv\n", "m.csv:1:1: unknown column 'loop'"),
        ("file\nb.csv\n", "no column 'name'"),
        ("name,Kc\na,x\n", "m.csv:2:1: Kc: x given; must be a number"),
        ("name,Kc\na,-1\n", "m.csv:2:1: Kc: -1 given; must be above 0"),
        (
            "name,Kc\na,-1\n",
            "Kc is positive, and the sign of the process gain, which the data show, decides",
        ),
        ("name,Action\na,direct\n", "m.csv:1:1: unknown column 'action', which is to be left out: Kc is positive"),
        ("name,pv_low\na,1\n", "needs both pv_low and pv_high"),
        ("name\na,b\n", "m.csv:2:1: more cells than columns"),
        ("name\n", "no loop"),
        ("name,Ti\na,soon\n", "m.csv:2:1: Ti: soon given; must be a time with its unit"),
        ("name,Ti\n,20\n", "m.csv:2:1: name: missing; it must be given"),
        ("name,criticality\na,1.5\n", "m.csv:2:1: criticality: 1.5 given"),
        ("name,plant\na,level\n", "m.csv:2:1: plant: level given; must be one of fopdt"),
        ("name,Kc\na,1\n", "m.csv:2:1: line: Kc given without Ti"),
        ("name,op_low,op_high\na,100,100\n", "m.csv:2:1: op_range: [100, 100] given; must be [low, high]"),
        ("name,Kc,kc,Ti\na,1,2,9\n", "m.csv:1:1: column 'kc' is there twice"),
        ("name;Kc\na;1\n", "m.csv:1:1: its cells stand between semicolons"),
    ],
)
def test_csv_manifests_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(ScenarioError) as refused:
        sources_of(tmp_path / "m.csv")
    assert message in str(refused.value)


def test_tags_without_data_are_said_to_be_without(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("name,PV,OP\nA,A.PV,A.OP\n")
    (loop,) = sources_of(tmp_path / "m.csv").loops
    assert loop.refusal.endswith("line 2: tags are given, but neither a file nor a data set that has them")
