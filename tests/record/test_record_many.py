"""One file of many loops: which it holds, and one loop's record from it as from a file of its own."""

from __future__ import annotations

import csv
import io
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import workbench as wb
from workbench.errors import RecordError
from workbench.record import csv_file
from workbench.record.columns import of_no_loop
from workbench.record.many import many_in
from workbench.record.names import split_tag
from workbench.record.reader import read_loop

N = 120
SIGNALS = ("PV", "SP", "OP", "MODE")
Loops = dict[str, dict[str, list[str]]]


def stamp(k: int) -> str:
    return f"2024-10-17 00:{k // 60:02d}:{k % 60:02d}"


@pytest.fixture(scope="module")
def loops() -> Loops:
    out: Loops = {}
    for i in range(4):
        rng = np.random.default_rng(i)
        # A value that is none: its line is told, as in the file.
        pv = [f"{x:.2f}" for x in 50 + rng.normal(size=N)]
        pv[80 + i] = "Bad Input"
        op = [f"{x:.2f}" for x in 40 + rng.normal(size=N)]
        out[f"FIC1{i}"] = {"PV": pv, "SP": ["50.00"] * N, "OP": op, "MODE": ["AUTO"] * N}
    return out


def test_columns_of_a_date_and_a_clock_are_of_no_loop_and_told_as_times(loops: Loops) -> None:
    calendar = ["Year", "Month", "Day", "Hour", "Minute", "Second"]
    assert of_no_loop([*calendar, *wide(loops)[0][1:], "Remark"]) == ["Remark"]
    assert of_no_loop([*calendar[:3], *wide(loops)[0][1:]]) == calendar[:3]


def text(rows: list[list[str]], **how: object) -> str:
    stream = io.StringIO(newline="")
    csv.writer(stream, **how).writerows(rows)  # type: ignore[arg-type]
    return stream.getvalue()


def wide(loops: Loops, joint: str = ".") -> list[list[str]]:
    columns = [(name, signal) for name in loops for signal in SIGNALS]
    rows = [[stamp(k), *(loops[name][signal][k] for name, signal in columns)] for k in range(N)]
    return [["Time", *(f"{name}{joint}{signal}" for name, signal in columns)], *rows]


def tall(loops: Loops) -> list[list[str]]:
    rows = [[f"{n}.{s}", stamp(k), loops[n][s][k], "Good"] for k in range(N) for n in loops for s in SIGNALS]
    return [["Tag", "Timestamp", "Value", "Quality"], *rows]


def attributes(loops: Loops) -> list[list[str]]:
    rows = [[s, stamp(k), n, loops[n][s][k]] for n in loops for k in range(N) for s in SIGNALS]
    return [["Attribute", "Timestamp", "Element", "Value"], *rows]


def pairs(loops: Loops) -> list[list[str]]:
    columns = [(name, signal) for name in loops for signal in SIGNALS]
    rows = [[cell for n, s in columns for cell in (stamp(k), loops[n][s][k])] for k in range(N)]
    return [[cell for n, s in columns for cell in ("Time", f"{n}.{s}")], *rows]


def parted(row: list[str]) -> list[str]:
    return [cell for k in range(0, len(row), 2) for cell in (*row[k : k + 2], "")]


def dashes(rows: list[list[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [rows[0], ["-" * width for width in widths], *rows[1:]]
    padded = ([cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in lines)
    return "".join(" ".join(row) + "\n" for row in padded)


SHAPES = {
    "wide": lambda loops: text(wide(loops)),
    "wide, units and semicolons": lambda loops: text(wide(loops, " "), delimiter=";").replace("PV;", "PV (m3/h);"),
    "tall": lambda loops: text(tall(loops)),
    "tall, quoted": lambda loops: text(tall(loops), quoting=csv.QUOTE_ALL, lineterminator="\n"),
    "tall, bars": lambda loops: text(tall(loops), delimiter="|", lineterminator="\r"),
    "tall, guarded": lambda loops: text(tall(loops)).replace("\nFIC11.PV,", '\n="FIC11.PV",'),
    "attributes": lambda loops: text(attributes(loops)),
    "tall, dashes": lambda loops: dashes(tall(loops)),
    "pairs": lambda loops: text(pairs(loops)),
    "pairs, parted": lambda loops: text([parted(row) for row in pairs(loops)]),
}


def tags_of(path: Path, name: str) -> dict[str, str]:
    """The tags of a loop among those of a file, by their signal."""
    listed = [f"{loop}.{tag}" if loop else tag for loop, tag in many_in(path)]
    return {split[1]: tag for tag in listed if (split := split_tag(tag)) and split[0] == name}


@pytest.mark.parametrize("block", [64, 1 << 20])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_loop_of_many_is_read_as_from_a_file_of_its_own(
    tmp_path: Path, loops: Loops, shape: str, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_file, "_BLOCK", block)
    many = tmp_path / "many.csv"
    many.write_text(SHAPES[shape](loops), encoding="utf-16" if shape == "tall" else "utf-8", newline="")
    alone = tmp_path / "alone.csv"
    for name, own in loops.items():
        alone.write_text(SHAPES[shape]({name: own}), newline="")
        tags = tags_of(many, name)
        assert set(tags) == set(SIGNALS)
        ours, its = read_loop(many, tags), wb.read_record(alone)
        assert np.array_equal(ours.pv, its.pv)
        assert np.array_equal(ours.op, its.op)
        assert ours.sp is not None
        assert ours.mode is not None
        assert ours.counts == its.counts
        assert len(ours.notes) == len(its.notes)
        # The line is that of the whole file.
        line = next(note for note in ours.notes if "'Bad Input'" in note).partition("first in line ")[2].split(",")[0]
        assert "Bad Input" in many.read_text("utf-16" if shape == "tall" else "utf-8").splitlines()[int(line) - 1]
        assert many_in(alone) == []


@pytest.mark.parametrize("shape", SHAPES)
def test_pv_and_op_alone_are_named(tmp_path: Path, loops: Loops, shape: str) -> None:
    (tmp_path / "many.csv").write_text(SHAPES[shape](loops), newline="")
    tags = tags_of(tmp_path / "many.csv", "FIC12")
    ours = wb.read_record(tmp_path / "many.csv", tags={"PV": tags["PV"], "OP": tags["OP"]})
    assert ours.sp is not None  # told by its name, which begins as theirs do
    assert np.array_equal(ours.pv, read_loop(tmp_path / "many.csv", tags).pv)


@pytest.mark.parametrize("name", ["Loop", "Tag"])
@pytest.mark.parametrize("mixed", [True, False])
def test_rows_of_several_loops_are_not_read_as_one(tmp_path: Path, loops: Loops, name: str, mixed: bool) -> None:
    """In turn, at times between each other's, or one after the other: either would pass for a record of one loop."""
    rows = []
    for i, (loop, own) in enumerate([*loops.items()][:2]):
        for k in range(N):
            second = 2 * k + i if mixed else N * i + k
            rows.append((second, [loop, stamp(second), own["PV"][k], own["OP"][k]]))
    path = tmp_path / "rows.csv"
    path.write_text(text([[name, "Time", "PV", "OP"], *(row for _, row in sorted(rows))]))
    with pytest.raises(RecordError, match=rf"column '{name}' names 2 loops \(FIC10, FIC11\), whose rows stand in one"):
        wb.read_record(path)
    path.write_text(text([[name, "Time", "PV", "OP"], *(row for _, row in sorted(rows) if row[0] == "FIC10")]))
    assert wb.read_record(path).sample_time == (2.0 if mixed else 1.0)


def test_a_comment_over_lines_is_not_parted(tmp_path: Path, loops: Loops, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_file, "_BLOCK", 500)
    rows = [[f"a remark,\non {row[0]},\nand more" if k % 50 == 7 else "", *row] for k, row in enumerate(tall(loops))]
    rows[0][0] = "Comment"
    (tmp_path / "x.csv").write_text(text(rows))
    ours = read_loop(tmp_path / "x.csv", {"PV": "FIC12.PV", "OP": "FIC12.OP"})
    (tmp_path / "y.csv").write_text(text(tall({"FIC12": loops["FIC12"]})))
    assert np.array_equal(ours.pv, wb.read_record(tmp_path / "y.csv").pv)


def test_a_wide_parquet_file_of_many(tmp_path: Path, loops: Loops) -> None:
    numbers = {f"{n}/{s}": pa.array([float(x) for x in own[s][:80]]) for n, own in loops.items() for s in ("PV", "OP")}
    seconds = pa.array(np.arange(80.0))
    pq.write_table(pa.table({"time": seconds, **numbers}), tmp_path / "x.parquet")
    assert ("", "FIC10/PV") in many_in(tmp_path / "x.parquet")
    ours = read_loop(tmp_path / "x.parquet", {"PV": "FIC13/PV", "OP": "FIC13/OP"})
    assert ours.pv.tolist() == numbers["FIC13/PV"].to_pylist()


def test_a_parquet_file_of_pairs_of_many(tmp_path: Path, loops: Loops) -> None:
    numbers = {f"{n}.{s}": pa.array([float(x) for x in own[s][:80]]) for n, own in loops.items() for s in ("PV", "OP")}
    columns = {}
    for k, (name, values) in enumerate(numbers.items()):
        columns |= {f"Time.{k}" if k else "Time": [stamp(at) for at in range(80)], name: values}
    many, alone = tmp_path / "many.parquet", tmp_path / "alone.parquet"
    pq.write_table(pa.table(columns), many)
    assert many_in(many) == [("", name) for name in numbers]
    tags = {"PV": "FIC13.PV", "OP": "FIC13.OP"}
    for record in (read_loop(many, tags), wb.read_record(many, tags=tags)):
        assert record.pv.tolist() == numbers["FIC13.PV"].to_pylist()
        assert record.op.tolist() == numbers["FIC13.OP"].to_pylist()
    assert not any("not used" in note for note in read_loop(many, tags).notes)
    pq.write_table(pa.table({name: columns[name] for name in ("Time", "FIC10.PV", "Time.1", "FIC10.OP")}), alone)
    assert many_in(alone) == []


def test_milliseconds_are_of_all_loops(tmp_path: Path, loops: Loops) -> None:
    rows = [[row[0], "millitm" if k == 0 else "250", *row[1:]] for k, row in enumerate(wide(loops))]
    (tmp_path / "x.csv").write_text(text(rows))
    assert of_no_loop([tag for _, tag in many_in(tmp_path / "x.csv")]) == []
    record = read_loop(tmp_path / "x.csv", {"PV": "FIC12.PV", "OP": "FIC12.OP"})
    assert any("milliseconds of column 'millitm' are added" in note for note in record.notes)


def test_listing_reads_no_values(tmp_path: Path, loops: Loops, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_file, "number_cells", None)
    monkeypatch.setattr(csv_file, "_blocks", None)
    (tmp_path / "x.csv").write_text(text(wide(loops)))
    assert len(many_in(tmp_path / "x.csv")) == 1 + 4 * len(SIGNALS)


def test_of_a_file_of_many_only_one_loop_is_held(tmp_path: Path) -> None:
    row = ",".join(f"{k}.25" for k in range(200))
    names = ",".join(f"FIC{i}.{signal}" for i in range(100) for signal in ("PV", "OP"))
    (tmp_path / "x.csv").write_text(f"t,{names}\n" + "".join(f"{k},{row}\n" for k in range(1000)))
    tracemalloc.start()
    try:
        read_loop(tmp_path / "x.csv", {"PV": "FIC7.PV", "OP": "FIC7.OP"})
        assert tracemalloc.get_traced_memory()[1] < 4e6  # of 200,000 cells, some 12 MB as text
    finally:
        tracemalloc.stop()


def test_of_a_tall_file_of_many_only_the_tags_in_use_are_held(tmp_path: Path) -> None:
    rows = "".join(f"FIC{i}.{s},{k},{k % 7}.{i % 10}\n" for k in range(400) for i in range(100) for s in ("PV", "OP"))
    (tmp_path / "x.csv").write_text(f"tag,time,value\n{rows}")
    tracemalloc.start()
    try:
        record = wb.read_record(tmp_path / "x.csv", tags={"PV": "FIC7.PV", "OP": "FIC8.OP"})
        assert tracemalloc.get_traced_memory()[1] < 8e6  # of 80,000 rows, some 20 MB as text
    finally:
        tracemalloc.stop()
    assert len(record) == 400
    assert any(note.endswith("FIC2.PV and 193 more") for note in record.notes)
    with pytest.raises(
        RecordError, match=r"tag 'FIC7.CO' given for OP: there is no such tag; the file has 'FIC0.PV', "
    ):
        wb.read_record(tmp_path / "x.csv", tags={"PV": "FIC7.PV", "OP": "FIC7.CO"})


@pytest.mark.parametrize(
    ("tag", "split"),
    [
        ("FIC101.PV (m3/h)", ("FIC101", "PV")),
        ("FIC101_SP, m3/h", ("FIC101", "SP")),
        ("FIC101.OP [%]", ("FIC101", "OP")),
        ("FIC101(PV)", ("FIC101", "PV")),
        ("FIC101 Set Point", ("FIC101", "SP")),
        ("FIC101.PV pct", ("FIC101", "PV")),
        ("PV (m3/h)", None),
        ("Set Point", None),
        ("FIC101.PV Quality", None),
    ],
)
def test_names_tell_loops_as_they_tell_signals(tag: str, split: tuple[str, str] | None) -> None:
    assert split_tag(tag) == split


def test_times_and_qualities_of_loops_are_not_of_no_loop() -> None:
    header = [
        "Time",
        "FIC1.PV",
        "FIC1.PV Quality",
        "FIC1.OP",
        "Status",
        "FIC2",
        "FIC2.SP",
        "FIC2.OP",
        "Ambient",
        "T9.Q",
    ]
    assert of_no_loop(header) == ["Ambient", "T9.Q"]


def test_a_loop_without_a_setpoint_does_not_take_another_ones(tmp_path: Path, loops: Loops) -> None:
    rows = [[cell for k, cell in enumerate(row) if k not in (2, 4)] for row in wide(loops)]
    (tmp_path / "x.csv").write_text(text([row[:7] for row in rows]))  # FIC10 without SP and MODE, FIC11 with them
    record = wb.read_record(tmp_path / "x.csv", columns={"PV": "FIC10.PV", "OP": "FIC10.OP"})
    assert record.sp is None
    assert record.mode is None
    record = wb.read_record(tmp_path / "x.csv", columns={"PV": "FIC11.PV", "OP": "FIC11.OP"})
    assert record.sp is not None
    assert record.mode is not None


def test_a_measurement_of_another_name_still_goes_with_the_rest(tmp_path: Path, loops: Loops) -> None:
    rows = [[*row[:5], row[5]] for row in wide(loops)]
    rows[0][5] = "FT10.MEAS"
    (tmp_path / "x.csv").write_text(text(rows))
    record = wb.read_record(tmp_path / "x.csv", columns={"PV": "FT10.MEAS"})
    assert record.sp is not None


@pytest.mark.parametrize(("shape", "argument"), [("wide", "columns"), ("tall", "tags"), ("attributes", "tags")])
def test_a_file_of_many_says_which_loops_it_holds(tmp_path: Path, loops: Loops, shape: str, argument: str) -> None:
    (tmp_path / "x.csv").write_text(SHAPES[shape](loops))
    with pytest.raises(RecordError) as refused:
        wb.read_record(tmp_path / "x.csv")
    way = f"say which one, for example {argument}={{'PV': 'FIC10.PV', 'OP': 'FIC10.OP'}} for FIC10; "
    assert str(refused.value).endswith(f"{way}the file holds 4 loops: FIC10, FIC11, FIC12, FIC13")
    with pytest.raises(
        RecordError, match=r"for example .*'PV': 'FIC12.PV', 'OP': 'FIC12.OP'} for FIC12; the file holds 4"
    ):
        wb.read_record(tmp_path / "x.csv", tags={"PV": "FIC12.PV"})
