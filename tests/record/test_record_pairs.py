"""Files as spreadsheets leave them: a pair of columns for each tag, cells held to be text, times without a name."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import workbench as wb
from workbench.errors import RecordError

PV = [41.5, 41.7, 42.25, 42.0, 41.75, 41.5, 41.25, 41.0]
OP = [55.0, 55.5, 56.0, 56.5, 56.0, 55.5, 55.0, 54.5]


def stamp(seconds: float) -> str:
    return f"2024-03-01 08:{int(seconds) // 60:02d}:{int(seconds) % 60:02d}"


def written(path: Path, header: str, rows: list[str]) -> Path:
    file = path / "loop.csv"
    file.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return file


def alike(mark: str = ",") -> list[str]:
    return [mark.join([stamp(10 * k), str(PV[k]), stamp(10 * k), str(OP[k])]) for k in range(8)]


@pytest.mark.parametrize(
    "header",
    [
        ",FIC101.PV,,FIC101.OP",
        "Time,FIC101.PV,Time,FIC101.OP",
        "PV time,PV,OP time,OP",
        "Timestamp,FIC101.PV,Timestamp.1,FIC101.OP",
        "FIC101.PV,,FIC101.OP,",  # the name above the times, where a spreadsheet's function begins
    ],
)
def test_a_pair_of_columns_for_each_tag_is_read(tmp_path: Path, header: str) -> None:
    record = wb.read_record(written(tmp_path, header, alike()))
    assert record.pv.tolist() == PV
    assert record.op.tolist() == OP
    assert record.sample_time == 10.0
    assert f"first timestamp {stamp(0)}" in record.notes


def test_decimal_commas_stand_in_pairs_too(tmp_path: Path) -> None:
    rows = [row.replace(".", ",") for row in alike(";")]
    assert wb.read_record(written(tmp_path, "Time;PV;Time;OP", rows)).pv.tolist() == PV


@pytest.mark.parametrize("header", ["Time,PV,Time,OP", "time,PV,time.1,OP", "Time,PV,,Time,OP", "Time,PV,,Time,OP,"])
@pytest.mark.parametrize("form", ["{:.8f}", "{:%Y-%m-%d %H:%M:%S}"])
def test_pairs_may_be_parted_and_have_the_days_of_spreadsheets(tmp_path: Path, header: str, form: str) -> None:
    start = dt.datetime(2024, 3, 1, 8, tzinfo=dt.UTC)
    rows = []
    for k in range(8):
        time = form.format(45352 + 1 / 3 + k / 8640 if ":.8f" in form else start + dt.timedelta(seconds=10 * k))
        rows.append(",".join([time, str(PV[k]), *[""] * (",," in header), time, str(OP[k])]))
    record = wb.read_record(written(tmp_path, header, rows))
    assert (record.sample_time, record.pv.tolist(), record.op.tolist()) == (pytest.approx(10.0, rel=1e-4), PV, OP)


def test_each_tag_has_its_own_times_and_its_own_length(tmp_path: Path) -> None:
    """PV every 10 s; OP, kept by exception, came at four other times; a setpoint was kept once, at the beginning."""
    events = [(0, 55.0), (13, 56.0), (37, 55.0), (70, 54.0)]
    rows = []
    for k in range(8):
        op = f"{stamp(events[k][0])},{events[k][1]}" if k < 4 else ","
        rows.append(f"{stamp(10 * k)},{PV[k]},{op}," + (f"{stamp(0)},41.5" if k == 0 else ","))
    record = wb.read_record(written(tmp_path, ",FIC101.PV,,FIC101.OP,,FIC101.SP", rows), sample_time=10.0)
    assert record.pv.tolist() == PV
    assert record.op.tolist() == [55.0, 55.0, 56.0, 56.0, 55.0, 55.0, 55.0, 54.0]
    assert record.sp is not None
    assert np.all(record.sp == 41.5)


def test_what_is_no_number_in_a_pair_is_told_by_its_line_and_tag(tmp_path: Path) -> None:
    rows = alike()
    rows[3] = rows[3].replace("42.0", "Bad Input")
    record = wb.read_record(written(tmp_path, ",FIC101.PV,,FIC101.OP", rows))
    assert any("'Bad Input'" in note and "line 5, tag 'FIC101.PV'" in note for note in record.notes)
    assert record.pv[3] == pytest.approx(0.5 * (PV[2] + PV[4]))


@pytest.mark.parametrize("words", [False, True])
@pytest.mark.parametrize(
    "names",
    [
        ["Time", "FIC101.PV", "Time.1", "FIC101.OP"],
        ["PV time", "PV", "OP time", "OP"],
        ["Unnamed: 0", "PV", "Unnamed: 2", "OP"],
        ["PV", "Unnamed: 1", "OP", "Unnamed: 3"],
    ],
)
def test_pairs_are_read_from_parquet_too(tmp_path: Path, names: list[str], words: bool) -> None:
    """OP was taken at the times of PV, half a minute off, where these had a name that is known."""
    start = dt.datetime(2024, 3, 1, 8)  # noqa: DTZ001 - a clock on a wall
    times = [start + dt.timedelta(seconds=10 * k) for k in range(40)]
    pv, op = [41.123456789 + k % 7 for k in range(40)], [55.5 + k % 5 for k in range(40)]
    shifted = [*times[3:], None, None, None]
    columns: list[list[object]] = [list(times), list(pv), list(shifted), [*op[3:], None, None, None]]
    if words:
        columns[3] = [None if value is None else str(value) for value in columns[3]]
        columns[3][5] = "Bad Input"
    path = tmp_path / "pairs.parquet"
    pq.write_table(pa.table(dict(zip(names, columns, strict=True))), path)
    record = wb.read_record(path)
    assert (record.sample_time, record.pv.tolist()) == (10.0, pv[3:])
    assert record.op.tolist() == [op[7] if words and k == 8 else op[k] for k in range(3, 40)]


def test_a_second_column_of_times_that_makes_no_pair_is_asked_about(tmp_path: Path) -> None:
    rows = [f"{stamp(10 * k)},{PV[k]},41.5,{stamp(10 * k + 5)},{OP[k]}" for k in range(8)]
    path = written(tmp_path, "Time,PV,SP,Time.1,OP", rows)
    with pytest.raises(RecordError, match=r"columns 'Time', 'Time\.1' could each be time; say which one"):
        wb.read_record(path)
    assert wb.read_record(path, columns={"time": "Time"}).pv.tolist() == PV


def test_pairs_of_any_name_are_mapped(tmp_path: Path) -> None:
    file = written(tmp_path, "Time,FT101,Time,FV101", alike())
    for argument in ("columns", "tags"):
        assert wb.read_record(file, **{argument: {"PV": "FT101", "OP": "FV101"}}).op.tolist() == OP
    with pytest.raises(wb.RecordError, match="no tag for PV and OP; the file has 'FT101', 'FV101'"):
        wb.read_record(file)


def test_pairs_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(wb.RecordError, match=r"two pairs of columns, .* have the name 'FIC101.PV'"):
        wb.read_record(written(tmp_path, ",FIC101.PV,,FIC101.PV", alike()))


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("Time,PV,OP,", "{time},{pv},{op},"),  # a delimiter too many
        ("PV,,OP,", "{pv},,{op},"),  # columns left empty
        ("Time,PV,Dead time,OP", "{time},{pv},3.5,{op}"),
        ("Time,PV,Dead time,OP", "{k}0,{pv},3.5,{op}"),
    ],
)
def test_a_column_for_each_signal_stays_one(tmp_path: Path, header: str, row: str) -> None:
    rows = [row.format(k=k, time=stamp(10 * k), pv=PV[k], op=OP[k]) for k in range(8)]
    record = wb.read_record(written(tmp_path, header, rows), sample_time=10.0)
    assert record.pv.tolist() == PV
    assert record.op.tolist() == OP


@pytest.mark.parametrize("name", ["", "Tag", "Batch"])
def test_times_are_found_by_what_they_are(tmp_path: Path, name: str) -> None:
    rows = [f"{stamp(10 * k)},{PV[k]},{OP[k]}" for k in range(8)]
    record = wb.read_record(written(tmp_path, f"{name},FIC101.PV,FIC101.OP", rows))
    assert record.sample_time == 10.0
    assert record.pv.tolist() == PV
    assert f"the times are those of the column {name or 'without a name'}" in record.notes


def test_of_two_columns_of_timestamps_none_is_taken(tmp_path: Path) -> None:
    rows = [f"{stamp(10 * k)},{PV[k]},{OP[k]},{stamp(10 * k + 1)}" for k in range(8)]
    with pytest.raises(wb.RecordError, match="no time column"):
        wb.read_record(written(tmp_path, "Begin,PV,OP,End", rows))


def test_cells_that_are_held_to_be_text_are_read(tmp_path: Path) -> None:
    rows = [f'="{stamp(10 * k)}",="{PV[k]}",="{OP[k]}"' for k in range(8)]
    record = wb.read_record(written(tmp_path, '="Time",="PV",="OP"', rows))
    assert record.pv.tolist() == PV
    assert record.op.tolist() == OP
