"""Wide files as plants export them: whose quality a column is, OP in mA, names with their units."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from workbench.errors import RecordError
from workbench.model.record import Record
from workbench.record.historian import read_tags, tags_of
from workbench.record.reader import read_record

N = 60
PV = [50 + 0.25 * (k * k % 11) for k in range(N)]
OP = [40 + 0.5 * (k % 9) for k in range(N)]


def read(folder: Path, header: str, cells: Sequence[Sequence[object]], **reading: object) -> Record:
    path = folder / "loop.csv"
    lines = [header, *(",".join(str(cell) for cell in (k, *row)) for k, row in enumerate(zip(*cells, strict=True)))]
    path.write_text("\n".join(lines), encoding="utf-8")
    return read_record(path, **reading)  # type: ignore[arg-type]


def bad_at(*rows: int, good: str = "Good", bad: str = "Bad") -> list[str]:
    return [bad if k in rows else good for k in range(N)]


@pytest.mark.parametrize(
    "header",
    [
        "t,PV,PV_Q,OP,OP_Q",
        "t,PV,PV Quality,OP,OP Quality",
        "t,PV,PV.Status,OP,OP.Status",
        "t,PV (m3/h),PV (m3/h) Status Code,OP (%),OP Status Code",
        "t,FIC101.PV,FIC101.PV_Quality,FIC101.OP,FIC101.OP_Quality",
        "t,FIC101.PV,PV_Quality,FIC101.OP,OP_Quality",
        "t,FIC101/PID1/PV.CV,FIC101/PID1/PV.ST,FIC101/PID1/OUT.CV,FIC101/PID1/OUT.ST",
        "t,PV value,PV quality,OP value,OP quality",
        "t,PV,Quality (PV),OP,Quality (OP)",
        "t,PV,Q_PV,OP,Q_OP",
        "t,Process Value,Quality of PV,Controller Output,Quality of OP",
        "t,PV,Quality,OP,Quality",
        "t,PV,Quality,OP,Quality.1",
        "t,PV,Data Status,OP,Data Status",
        "t,PV,PV Qualität,OP,OP Qualität",
        "t,PV,Qualité,OP,Qualité",
    ],
)
@pytest.mark.parametrize(("good", "bad"), [("Good", "Bad"), ("192", "0"), ("1", "0"), ("Good", "Uncertain")])
def test_a_quality_beside_a_signal_is_that_signals(tmp_path: Path, header: str, good: str, bad: str) -> None:
    of_pv, of_op = bad_at(4, 5, good=good, bad=bad), bad_at(9, 10, good=good, bad=bad)
    record = read(tmp_path, header, [PV, of_pv, OP, of_op])
    assert record.pv.tolist() == PV[11:]
    assert record.counts["rejected, bad quality"] == 4
    assert any("4 rows rejected: bad quality" in line for line in record.summary())
    assert not any("whose quality" in note for note in record.notes)


def test_a_setpoint_of_bad_quality_holds_the_one_before(tmp_path: Path) -> None:
    sp = [50 if k < 30 else 0 if k == 40 else 51 for k in range(N)]
    record = read(tmp_path, "t,PV,OP,SP,SP_Q", [PV, OP, sp, bad_at(40)])
    assert record.sp is not None
    assert record.sp.tolist() == [50.0] * 30 + [51.0] * 30
    assert "SP: the value before is held in 1 cell without a good value" in record.notes


@pytest.mark.parametrize("name", ["Quality of the flow", "FIC101.Status", "LT7_Q", "Good"])
def test_a_quality_of_no_signal_is_said(tmp_path: Path, name: str) -> None:
    record = read(tmp_path, f"t,PV,OP,{name}", [PV, OP, bad_at(3)])
    assert len(record) == N
    assert sum(note.startswith(f"not used, for whose quality is it? {name!r}; columns") for note in record.notes) == 1
    told = read(tmp_path, f"t,PV,OP,{name}", [PV, OP, bad_at(3, 4)], columns={"OP quality": name})
    assert told.op.tolist() == OP[5:]
    assert not any("whose quality" in note for note in told.notes)


def test_a_quality_given_for_a_signal_that_is_not_there_does_no_harm(tmp_path: Path) -> None:
    assert len(read(tmp_path, "t,PV,OP,X", [PV, OP, bad_at(3)], columns={"SP quality": "X"})) == N


@pytest.mark.parametrize("name", ["LT7,LT7_Q", "Q,X", "Qualifier,Y", "PV_HI,Equipment"])
def test_another_columns_quality_is_not_told(tmp_path: Path, name: str) -> None:
    record = read(tmp_path, f"t,PV,OP,{name}", [PV, OP, PV, bad_at(3)])
    assert len(record) == N
    assert not any("quality" in note for note in record.notes)


MA = [4 + 0.16 * u for u in OP]


@pytest.mark.parametrize("name", ["OP (mA)", "OP [mA]", "OP_mA", "Output (MA)", "FIC101.OP (mA)", "FIC101_OP_mA"])
def test_an_output_in_ma_is_brought_to_percent(tmp_path: Path, name: str) -> None:
    record = read(tmp_path, f"t,PV,{name}", [PV, MA])
    assert record.op == pytest.approx(OP)
    assert "OP (in mA) taken in % of its range, 4 to 20" in record.notes
    given = read(tmp_path, f"t,PV,{name}", [PV, MA], op_range=(0.0, 20.0))
    assert given.op == pytest.approx([5.0 * value for value in MA])
    assert "OP taken in % of its range, 0 to 20" in given.notes


def test_a_row_of_units_and_a_stem_in_ma_are_heeded(tmp_path: Path) -> None:
    columns = [["m3/h", *PV], ["[mA]", *MA], ["mA", *MA]]
    record = read(tmp_path, "t,PV,OP,ZT", columns)
    assert record.op == pytest.approx(OP)
    assert record.valve_position == pytest.approx(OP)
    assert "valve position (in mA) taken in % of its range, 4 to 20" in record.notes


@pytest.mark.parametrize("name", ["OP", "OP (%)", "OP_ma", "gamma_OP", "OP (max)"])
def test_names_that_do_not_say_ma_leave_percent(tmp_path: Path, name: str) -> None:
    assert read(tmp_path, f"t,PV,{name}", [PV, MA]).op.tolist() == MA


def test_percent_under_a_name_that_says_ma_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"OP \(in mA\) runs from 40 to 44, and most of it lies beyond its range, 4"):
        read(tmp_path, "t,PV,OP (mA)", [PV, OP])


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_tall_file_may_have_units(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"tall{suffix}"
    rows = [
        [tag, float(k), value, unit]
        for k in range(N)
        for tag, value, unit in (("F.PV", PV[k], "m3/h"), ("F.OP", MA[k], "mA"))
    ]
    names = ["tag", "time", "value", "Units"]
    if suffix == ".csv":
        path.write_text("\n".join(",".join(map(str, row)) for row in [names, *rows]), encoding="utf-8")
        records = [read_record(path)]
    else:
        pq.write_table(pa.table(dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))), path)
        pieces = tags_of(path)["F.OP"]
        records = [read_record(path), read_tags(pieces, {"PV": "F.PV", "OP": "F.OP"}, "F")]
    for record in records:
        assert record.op == pytest.approx(OP)
        assert "OP (in mA) taken in % of its range, 4 to 20" in record.notes


@pytest.mark.parametrize(("sp", "said"), [(120.0, True), (54.0, False), (48.0, False), (44.0, True), (40.0, True)])
def test_a_setpoint_far_from_pv_all_along_is_said(tmp_path: Path, sp: float, said: bool) -> None:
    # PV runs from 50 to 52.25, OP from 40 to 44: within a swing of PV an offset is one of control.
    record = read(tmp_path, "t,PV,OP,SP", [PV, OP, [sp] * N])
    words = f"SP ({sp:g}) stays far from PV (50 to 52.25) all along: are PV and OP exchanged"
    assert any(line.startswith(words) for line in record.summary()) == said


def test_a_setpoint_that_is_met_at_times_is_not_told(tmp_path: Path) -> None:
    record = read(tmp_path, "t,PV,OP,SP", [PV, OP, [90] * (N - 1) + [51]])
    assert not any("exchanged" in note for note in record.notes)


@pytest.mark.parametrize(
    "header",
    [
        "Timestamp (s),Flow (m3/h),Valve Output (%),Flow Setpoint (m3/h)",
        "t,Flow PV (m3/h),Controller Output (%),Flow SP [m3/h]",
        "t,FIC101.PV (m3/h),FIC101.OP (%),FIC101.SP (m3/h)",
        "t,FIC101,FIC101.OP,FIC101.SP",
        "t,FIC101 (PV),FIC101 (OP),FIC101 (SP)",
        "t,PV,CV,SP",
        "t,CV,MV,SP",
        "t,Controlled Variable,CO,SP",
    ],
)
def test_names_with_units_and_of_quantities_are_found(tmp_path: Path, header: str) -> None:
    record = read(tmp_path, header, [PV, OP, [51] * N])
    assert (record.pv.tolist(), record.op.tolist()) == (PV, OP)
    assert record.sp is not None
    assert record.sp.tolist() == [51.0] * N


@pytest.mark.parametrize("header", ["t,CV,X", "t,Flow (m3/h),Valve Output (%)", "t,Flow (m3/h),Flow (t/h),OP,Flow SP"])
def test_names_that_leave_a_doubt_are_refused(tmp_path: Path, header: str) -> None:
    with pytest.raises(RecordError, match="no column for "):
        read(tmp_path, header, [PV, PV, OP, OP][: header.count(",")])


def test_a_setpoint_named_by_a_sign_tells_no_pv(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no column for PV; the file has"):
        read(tmp_path, "t,%,OP", [PV, OP], columns={"SP": "%"})


@pytest.mark.parametrize("exchanged", [False, True])
def test_a_setpoint_in_the_middle_of_op_asks_whether_pv_is_exchanged_with_it(tmp_path, exchanged):
    # OP is so near to SP that either might be controlled; integral action leaves no lasting error.
    k = np.arange(400)
    pv, op = 50.0 + np.sin(k / 7.0), 52.5 + 1.2 * np.cos(k / 7.0)
    first, second = (op, pv) if exchanged else (pv, op)
    rows = [f"{i},50.0,{a:.4f},{b:.4f}" for i, a, b in zip(k.tolist(), first, second, strict=True)]
    path = tmp_path / "loop.csv"
    path.write_text("\n".join(["time,SP,PV,OP", *rows]))
    said = "SP lies in the middle of OP, and PV lies off it: are PV and OP exchanged?"
    assert (said in read_record(path).notes) == exchanged


@pytest.mark.parametrize("title", ["", "\n", "Report of the night\n\n"])
def test_columns_of_a_fixed_width_under_dashes_are_read(tmp_path: Path, title: str) -> None:
    """As SQL*Plus and sqlcmd print them: a time with a space in it, numbers to the right, pages, a count at the end."""
    page = f"{'TIME':19s} {'PV':>10s} {'OP':>10s} NOTE\n{'-' * 19} {'-' * 10} {'-' * 10} ----\n"
    rows = [
        f"2024-10-17 08:{k:02d}:00 {'' if k == 20 else pv:>10} {op:>10.2f} {'x y' if k % 7 == 0 else '':4s}\n"
        for k, (pv, op) in enumerate(zip(PV, OP, strict=True))
    ]
    path = tmp_path / "spool.lst"
    path.write_text(f"{title}{page}{''.join(rows[:30])}\n{page}{''.join(rows[30:])}\n60 rows selected.\n")
    record = read_record(path)
    assert (record.sample_time, record.op.tolist()) == (60.0, pytest.approx(OP))
    assert np.delete(record.pv, 20).tolist() == PV[:20] + PV[21:]
    assert record.counts["rejected, no readable time"] == 2  # the second page's heads, and the count


@pytest.mark.parametrize(
    ("head", "form", "mark"),
    [
        ("# time PV OP", "{0} {1} {2}", 5.0),  # numpy.savetxt
        ("# by a logger\n#time,PV,OP", "{0},{1},{2}", 5.0),
        ("#Timestamp;PV;OP", "2024-10-17 08:{3:02d}:00;{1};{2}", 60.0),
        ("X_Value\tPV\tOP\tComment", "{0}\t{1}\t{2}", 5.0),  # LabVIEW
        ("time,PV,OP", "{0} sec,{1},{2}", 5.0),  # MATLAB
        ("t,PV,OP", "{0} min,{1},{2}", 300.0),
        (",PV,OP", "0 days 00:{3:02d}:00,{1},{2}", 60.0),  # pandas
        ("Clock;PV;OP", "00:{3:02d}:00;{1};{2}", 60.0),
    ],
)
def test_heads_and_times_as_other_tools_write_them(tmp_path: Path, head: str, form: str, mark: float) -> None:
    path = tmp_path / "loop.txt"
    path.write_text("\n".join([head, *(form.format(5 * k, PV[k], OP[k], k) for k in range(N))]))
    record = read_record(path)
    assert (record.sample_time, record.pv.tolist(), record.op.tolist()) == (mark, PV, OP)


def test_numbers_below_a_comment_that_names_nothing_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "loop.txt"
    path.write_text("# written at 2024\n" + "".join(f"{k},{PV[k]},{OP[k]}\n" for k in range(N)))
    with pytest.raises(RecordError, match=r"line 2: numbers where the column names should be"):
        read_record(path)


@pytest.mark.parametrize("form", ["\u2212{}", "{}-", " \u2013{}", "{} -"])
def test_minus_signs_that_are_no_hyphens_before_a_number(tmp_path: Path, form: str) -> None:
    """Only the values above zero were kept."""
    below = [value - 51.0 for value in PV]
    shown = [form.format(-value) if value < 0.0 else str(value) for value in below]
    assert read(tmp_path, "t,PV,OP", [shown, OP]).pv.tolist() == below


@pytest.mark.parametrize(
    "header",
    [
        "Timestamp,Unit1\\FIC101|PV,Unit1\\FIC101|OP",  # PI's asset framework
        "Timestamp,ns=2;s=FIC101.PV,ns=2;s=FIC101.OP",  # OPC UA
        "Timestamp,PV (a;b),OP",
    ],
)
def test_what_stands_in_names_alone_parts_no_cells(tmp_path: Path, header: str) -> None:
    assert read(tmp_path, header, [PV, OP]).pv.tolist() == PV


def test_names_in_quotes_are_parted_by_spaces(tmp_path: Path) -> None:
    path = tmp_path / "r.txt"
    path.write_text('"t" "PV" "OP"\n' + "".join(f"{k} {PV[k]} {OP[k]}\n" for k in range(N)))
    assert read_record(path).pv.tolist() == PV


@pytest.mark.parametrize(("header", "unit"), [("OP [V]", "V"), ("OP (psi)", "psi"), ("OP,V", ""), ("OP", "")])
def test_an_op_in_another_unit_than_per_cent_is_told(tmp_path: Path, header: str, unit: str) -> None:
    path = tmp_path / "loop.csv"
    path.write_text(f'time,PV,"{header}"\n' + "".join(f"{k},{k},{k % 7}\n" for k in range(60)))
    told = [note for note in read_record(path).notes if "taken as %" in note]
    assert bool(told) == bool(unit)
    assert not unit or told[0].startswith(f"OP is in {unit} by its name or unit")
    ranged = read_record(path, op_range=(0.0, 10.0))
    assert not any("taken as %" in note for note in ranged.notes)
    assert ranged.op.max() == pytest.approx(60.0)


def test_a_file_without_times_says_what_it_has(tmp_path: Path) -> None:
    path = tmp_path / "loop.csv"
    path.write_text("row,PV,OP\n" + "".join(f"{k},{k},{k % 7}\n" for k in range(60)))
    with pytest.raises(RecordError, match=r"no time column; .* the file has 'row', 'PV', 'OP'"):
        read_record(path)
