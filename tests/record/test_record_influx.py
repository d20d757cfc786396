"""InfluxDB's annotated CSV: tables below each other, whose columns together name a series."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from workbench.errors import RecordError
from workbench.fleet.loops import loops_in
from workbench.record.reader import read_loop, read_record

N = 60
PV = [50 + 0.25 * (k * k % 11) for k in range(N)]
OP = [40 + 0.125 * (k * k * k % 37) for k in range(N)]
SPAN = "2024-10-17T00:00:00Z,2024-10-18T00:00:00Z"


def stamp(k: int) -> str:
    return f"2024-10-17T10:{k // 60:02d}:{k % 60:02d}Z"


def head(kind: str = "double", result: str = "_result", loop: str = "loop") -> list[str]:
    return [
        "#group,false,false,true,true,false,false,true,true,true",
        f"#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,{kind},string,string,string",
        f"#default,{result},,,,,,,,",
        f",result,table,_start,_stop,_time,_value,_field,_measurement,{loop}",
    ]


def rows(values: Sequence[object], field: str, loop: str = "FIC101", result: str = "") -> list[str]:
    return [f",{result},0,{SPAN},{stamp(k)},{value},{field},flow,{loop}" for k, value in enumerate(values)]


def write(folder: Path, lines: Sequence[str], end: str = "\r\n") -> Path:
    path = folder / "influx.csv"
    path.write_bytes((end.join(lines) + end).encode())
    return path


def loop(name: str) -> list[str]:
    return rows(OP, "OP", name) + rows([pv + (name != "FIC101") for pv in PV], "PV", name)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_tables_with_annotations_of_their_own_are_one(tmp_path: Path, end: str) -> None:
    mode = [*head("string"), *rows(["AUTO"] * N, "MODE"), "", ""]
    # Another table may have other columns, in another order, and its field as their default.
    other = ["#group,false,false,false,false,true,true", "#default,_result,,,,flow,SP"]
    other += [",result,table,_value,_time,_measurement,_field"]
    other += [f",,3,{v},{stamp(k)},," for k, v in enumerate([50.5] * N)]
    record = read_record(write(tmp_path, [*head(), *loop("FIC101"), "", *mode, *other], end))
    assert (record.pv.tolist(), record.op.tolist(), record.sample_time) == (PV, OP, 1.0)
    assert record.sp is not None
    assert (set(record.sp.tolist()), record.counts["rejected"], record.counts["rows"]) == ({50.5}, 0, 4 * N)
    assert "InfluxDB's tables taken as one, with the column 'InfluxDB series'" in record.notes


def test_many_loops_are_told_by_their_tags(tmp_path: Path) -> None:
    lines = [*head(), *loop("FIC101"), *loop("FIC102")]
    for kept in (lines, [line for line in lines if not line.startswith("#")]):
        path = write(tmp_path, kept)
        with pytest.raises(RecordError, match=r"the file holds 2 loops: flow.FIC101, flow.FIC102"):
            read_record(path)
        tags = {"PV": "flow.FIC102.PV", "OP": "flow.FIC102.OP"}
        for record in (read_record(path, tags=tags), read_loop(path, tags)):
            assert (record.pv.tolist(), record.op.tolist()) == ([pv + 1 for pv in PV], OP)
        assert [one.name for one in loops_in(path)[0]] == ["flow.FIC101", "flow.FIC102"]


def test_the_signal_may_stand_in_a_tag(tmp_path: Path) -> None:
    lines = [*head(loop="tag"), *rows(OP, "value", "FIC101.OP"), *rows(PV, "value", "FIC101.PV")]
    record = read_record(write(tmp_path, lines))
    assert (record.pv.tolist(), record.op.tolist()) == (PV, OP)


def test_a_quality_rates_a_value_and_names_no_series(tmp_path: Path) -> None:
    lines = head(loop="quality") + rows(OP, "OP", "Good")
    lines += [line.replace("Good", "Bad") if k < 5 else line for k, line in enumerate(rows(PV, "PV", "Good"))]
    record = read_record(write(tmp_path, lines))
    assert (record.pv.tolist(), record.counts["rejected, bad quality"]) == (PV[5:], 5)


def test_a_mean_is_said_and_a_maximum_is_no_signal(tmp_path: Path) -> None:
    mean = [*head(result="mean"), *rows(OP, "OP"), *rows(PV, "PV", result="mean"), ""]
    both = [*mean, *head(result="max"), *rows(OP[::-1], "OP"), *rows(PV[::-1], "PV")]
    record = read_record(write(tmp_path, both))
    assert (record.pv.tolist(), record.op.tolist()) == (PV, OP)
    assert any(note.startswith("PV ('flow.FIC101.PV.mean'), OP ('flow.FIC101.OP.mean')") for note in record.notes)


def pivoted(name: str, first: int, table: int) -> list[str]:
    return [
        f",,{table},{SPAN},{stamp(first + k)},flow,{name},{v[0]},{v[1]}" for k, v in enumerate(zip(OP, PV, strict=True))
    ]


def test_pivoted_tables_are_of_one_loop(tmp_path: Path) -> None:
    lines = [
        "#group,false,false,true,true,false,true,true,false,false",
        ",result,table,_start,_stop,_time,_measurement,loop,OP,PV",
        *pivoted("FIC101", 0, 0),
    ]
    assert read_record(write(tmp_path, lines)).pv.tolist() == PV
    more = read_record(write(tmp_path, lines + pivoted("FIC101", N, 1)))
    assert more.pv.tolist() == PV + PV
    with pytest.raises(
        RecordError, match=r"influx.csv: line 63: flow.FIC102 below flow.FIC101, with a column for each"
    ):
        read_record(write(tmp_path, lines + pivoted("FIC102", N, 1)))


def test_a_line_that_was_cut_short_is_no_row(tmp_path: Path) -> None:
    for last in (",", ",,1", "x", f",,0,{SPAN},{stamp(1)}"):
        record = read_record(write(tmp_path, [*head(), *rows(OP, "OP"), *rows(PV, "PV"), last]))
        assert (record.pv.tolist(), record.op.tolist()) == (PV, OP)


def test_a_line_of_it_is_told_as_in_the_file(tmp_path: Path) -> None:
    lines = [*head(), *rows(OP, "OP"), "", *head(), *rows(["Bad Input", "Bad Input", *PV[2:]], "PV")]
    record = read_record(write(tmp_path, lines))
    assert any("first in line 70, tag 'flow.FIC101.PV'" in note for note in record.notes)
