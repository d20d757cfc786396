"""Exports as control systems and historians write them, each read to the last value, or refused with the way out."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import pytest

from workbench.errors import RecordError
from workbench.record.names import split_tag
from workbench.record.reader import read_record

N = 60
PV = [50 + 0.25 * (k * k % 11) for k in range(N)]
OP = [40 + 0.125 * (k * k * k % 37) for k in range(N)]
BOTH = (("PV", PV), ("OP", OP))


def at(k: int, form: str) -> str:
    return (dt.datetime(2024, 10, 17, 9, 59, 30, tzinfo=dt.UTC) + dt.timedelta(seconds=k)).strftime(form)


def comma(value: float) -> str:
    return str(value).replace(".", ",")


def rows(form: str, line: str) -> list[str]:
    """Rows of a wide file: its times in this form, then t, pv, op or, with decimal commas, cpv and cop in the line."""
    return [line.format(t=at(k, form), k=k, pv=PV[k], op=OP[k], cpv=comma(PV[k]), cop=comma(OP[k])) for k in range(N)]


def tall(form: str, line: str, op: str = "OP") -> list[str]:
    named = ((signal if signal == "PV" else op, values) for signal, values in BOTH)
    return [
        line.format(t=at(k, form), s=signal, v=value, c=comma(value), ms=1729159170000 + 1000 * k)
        for signal, values in named
        for k, value in enumerate(values)
    ]


DAY, ISO, GERMAN = "%d-%b-%y %H:%M:%S", "%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M:%S"
EXPORTS: dict[str, list[str]] = {
    "Honeywell PHD": ["TagName,TimeStamp,Value,Confidence,Units", *tall(DAY, "FIC101.{s},{t},{v},100,M3/H")],
    "Honeywell PHD, two rows of names": [
        *("Start Time: 17-OCT-24 09:59:30", "End Time: 17-OCT-24 10:01:30", ""),
        *(",FIC101.PV,FIC101.PV,FIC101.OP,FIC101.OP", "Timestamp,Value,Confidence,Value,Confidence"),
        *rows(DAY, "{t},{pv},100,{op},100"),
    ],
    "Emerson DeltaV": [
        *("DeltaV Process History View", "Exported: 10/17/2024 11:00:00 AM", ""),
        "Time\tFIC-101/PID1/PV.CV\tStatus\tFIC-101/PID1/OUT.CV\tStatus",
        *rows("%m/%d/%Y %I:%M:%S %p", "{t}\t{pv}\tGood\t{op}\tGood"),
    ],
    "Yokogawa Exaquantum": [
        "Time,Root.FIC101.PV.Value,Root.FIC101.PV.Quality,Root.FIC101.MV.Value,Root.FIC101.MV.Quality",
        *rows("%d/%m/%Y %H:%M:%S", "{t},{pv},Good,{op},Good"),
    ],
    "ABB 800xA": [
        "Log name;Time;Value;Status",
        *tall(ISO, "Control Network/FIC101:Main.{s},Log1;{t};{c};0x00000000", "OUT"),
    ],
    "Siemens WinCC": [
        '"VarName";"TimeString";"VarValue";"Validity";"Time_ms"',
        *tall(GERMAN, '"FIC101_{s}";"{t}";{c};1;45582416319,444', "LMN"),
        "$RT_COUNT$;2;120;;",
    ],
    "Siemens PCS 7": [
        "Datum/Zeit;FIC101/PID.PV_IN#Value;FIC101/PID.LMN#Value",
        *rows(GERMAN, "{t},000;{cpv};{cop}"),
    ],
    "Siemens PCS 7, advanced library": [
        "Datum/Zeit;FIC101/PID.PV_Out#Value;FIC101/PID.MV#Value",
        *rows(GERMAN, "{t},000;{cpv};{cop}"),
    ],
    "AspenTech IP.21": [
        "NAME,IP_TREND_TIME,IP_TREND_VALUE,IP_TREND_QSTATUS",
        *tall(DAY, "FIC101.{s},{t}.0,{v},Good"),
    ],
    "PI DataLink, sampled": [
        *("Tag:,FIC101.PV,,FIC101.OP", "Descriptor:,Flow,,Output", "Eng Units:,m3/h,,%"),
        "Timestamp,Value,Timestamp,Value",
        *rows(DAY, "{t},{pv},{t},{op}"),
    ],
    "spreadsheet, merged cells": [
        *("Report of 17.10.2024", "", ";FIC101.PV;;FIC101.OP;", "Timestamp;Value;Quality;Value;Quality"),
        *rows(GERMAN, "{t};{cpv};192;{cop};192"),
    ],
    "Ignition, dataset": [
        *('"#NAMES"', '"t_stamp","FIC101/PV","FIC101/OP"', '"#TYPES"', '"T","R8","R8"', f'"#ROWS","{N}"'),
        *rows("%a %b %d %H:%M:%S CEST %Y", '"{t}","{pv}","{op}"'),
    ],
    "Ignition, database": [
        "tagpath,t_stamp,floatvalue,dataintegrity",
        *tall(ISO, "fic101/{s},{ms},{v},192"),
    ],
    "Grafana": ["Series;Time;Value", *tall("%Y-%m-%dT%H:%M:%S+00:00", "FIC101.{s};{t};{v}")],
    "Grafana, labels": [
        *("sep=,", '"Time","flow {tag=""PV""}","flow {tag=""OP""}"'),
        *rows(ISO, "{t},{pv},{op}"),
    ],
    "MATLAB timetable": ["Time,FIC101_PV,FIC101_OP", *rows("%d-%b-%Y %H:%M:%S", "{t},{pv},{op}")],
    "MATLAB timetable of durations": ["Time,PV,OP", *rows(ISO, "{k} sec,{pv},{op}")],
    "Canary": [
        "Timestamp,FIC101.PV (Avg),FIC101.PV (Min),FIC101.OP (Avg),FIC101.OP (Min)",
        *rows(ISO, "{t},{pv},0,{op},0"),
    ],
}


def write(folder: Path, lines: list[str]) -> Path:
    path = folder / "export.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("system", EXPORTS)
def test_an_export_is_read(tmp_path: Path, system: str) -> None:
    record = read_record(write(tmp_path, EXPORTS[system]))
    assert (record.pv.tolist(), record.op.tolist(), record.sample_time) == (PV, OP, 1.0)


def test_the_quality_below_a_tag_is_that_tags(tmp_path: Path) -> None:
    lines = list(EXPORTS["spreadsheet, merged cells"])
    lines[4:9] = [line.replace("192", "0", 1) for line in lines[4:9]]
    record = read_record(write(tmp_path, lines))
    assert (record.pv.tolist(), record.counts["rejected, bad quality"]) == (PV[5:], 5)
    assert "first in line 5, column 'FIC101.PV'" in "".join(record.notes)


def test_units_between_two_rows_of_names_count(tmp_path: Path) -> None:
    lines = ["Tag,FIC101.PV,FIC101.OP", "Unit,m3/h,mA", "Timestamp,Value,Value"]
    lines += [f"{at(k, ISO)},{PV[k]},{0.16 * OP[k] + 4.0}" for k in range(N)]
    record = read_record(write(tmp_path, lines), tags={"PV": "FIC101.PV", "OP": "FIC101.OP"})
    assert record.op.tolist() == pytest.approx(OP)
    assert "OP (in mA) taken in % of its range, 4 to 20" in record.notes


def test_a_row_of_values_below_no_tags_is_no_header(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no column for PV and OP; the file has 'Timestamp', 'Value', 'Value'"):
        read_record(write(tmp_path, ["Timestamp,Value,Value", *rows(ISO, "{t},{pv},{op}")]))


def test_a_process_value_at_an_output_pin_is_no_output(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no column for OP"):
        read_record(write(tmp_path, ["t,FIC1.PV,FIC1.PV_Out", *rows(ISO, "{k},{pv},{op}")]))
    record = read_record(write(tmp_path, ["t,FIC1.PV,FIC1.PV_IN,FIC1.OP", *rows(ISO, "{k},{pv},0,{op}")]))
    assert record.pv.tolist() == PV
    assert split_tag("FIC1.PV_Out") is None
    assert split_tag("FIC1.OUT") == ("FIC1", "OP")


def test_a_column_of_properties_is_asked_for(tmp_path: Path) -> None:
    lines = tall(ISO, "FIC101;{s};{t};{c};Good", "OUT")
    path = write(tmp_path, ["Object;Property;Timestamp;Value;Quality", *lines])
    with pytest.raises(RecordError, match=r"the file has 'FIC101'.*columns=\{'tag': 'its name'\}"):
        read_record(path)
    assert read_record(path, columns={"tag": "Property"}).op.tolist() == OP
    both = [*lines, *(line.replace("FIC101", "FIC102") for line in lines)]
    path = write(tmp_path, ["Object;Property;Timestamp;Value;Quality", *both])
    with pytest.raises(RecordError, match=r"the file holds 2 loops: FIC101, FIC102"):
        read_record(path, columns={"tag": "Property"})


@pytest.mark.parametrize("zone", ["", " UTC", " CEST"])
def test_a_time_as_java_prints_it_is_read(tmp_path: Path, zone: str) -> None:
    form = f"%a %b %d %H:%M:%S{zone} %Y"
    record = read_record(write(tmp_path, ["Time,PV,OP", *rows(form, "{t},{pv},{op}")]))
    shift = 7200.0 if zone == " CEST" else 0.0
    assert record.epoch == dt.datetime(2024, 10, 17, 9, 59, 30, tzinfo=dt.UTC).timestamp() - shift
