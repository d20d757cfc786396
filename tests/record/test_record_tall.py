"""Tall historian exports: a row per value, tags, qualities, compression."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from workbench.errors import RecordError
from workbench.record.quality import good_quality
from workbench.record.reader import read_record

START = dt.datetime(2024, 10, 17, 21, 55)  # noqa: DTZ001 - a clock on a wall


def stamp(second: float) -> str:
    return str(START + dt.timedelta(seconds=second))


def write(folder: Path, rows: list[tuple[str, str, str, str]], header: str = "Tag,Timestamp,Value,Quality") -> Path:
    path = folder / "tall.csv"
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n", encoding="utf-8")
    return path


def rows_of(tag: str, values: list[float], every: float = 10.0) -> list[tuple[str, str, str, str]]:
    return [(tag, stamp(every * k), f"{v:g}", "Good") for k, v in enumerate(values)]


PV = [50.0 + (k * 7 % 11) / 10 for k in range(60)]
OP = [40.0 + (k * 5 % 13) / 10 for k in range(60)]


def test_an_even_tall_export_is_the_wide_file_to_the_last_digit(tmp_path: Path) -> None:
    rows = rows_of("FIC101.PV", PV) + rows_of("FIC101.OP", OP) + rows_of("FIC101.SP", [50.5] * 60)
    record = read_record(write(tmp_path, rows))
    assert record.pv.tolist() == PV
    assert record.op.tolist() == OP
    assert record.sp is not None
    assert set(record.sp.tolist()) == {50.5}
    assert (record.sample_time, record.start, record.rest) == (10.0, 0.0, ())
    assert dict(record.counts) == {"rows": 180, "kept": 60, "rejected": 0, "gaps": 0}
    assert record.notes == ("first timestamp 2024-10-17 21:55:00",)


def test_the_rows_may_come_in_any_order_of_tags(tmp_path: Path) -> None:
    rows = [pair for both in zip(rows_of("A.PV", PV), rows_of("A.OP", OP), strict=True) for pair in both]
    assert read_record(write(tmp_path, rows)).pv.tolist() == PV
    assert read_record(write(tmp_path, rows[::-1])).pv.tolist() == PV


@pytest.mark.parametrize(
    ("header", "pv", "op"),
    [
        ("TagName,DateTime,Value,OPCQuality", "FIC101/PID1/PV.CV", "FIC101/PID1/OUT.CV"),
        ("point,time,reading,status", "31FC101.DACA.PV", "31FC101.PIDA.OP"),
        ("Messstelle,Zeitstempel,Wert,Qualität", "FIC101.PV", "FIC101.OP"),
        ("Kennzeichen,Zeitstempel,Wert,Status", "FIC101.Istwert", "FIC101.Stellwert"),
        ("Repère,Horodatage,Valeur,Qualité", "FIC101.PV", "FIC101.OP"),
        # Ignition, ABB, Wonderware, IP.21.
        ("path,t_stamp,value,quality", "FIC101/PV", "FIC101/OP"),
        ("Object,Timestamp,Value,Quality", "FIC101:PV", "FIC101:OUT"),
        ("TagName,DateTime,vValue,Quality", "FIC101.PV", "FIC101.OP"),
        ("NAME,IP_TREND_TIME,IP_TREND_VALUE,IP_TREND_QSTATUS", "FIC101.PV", "FIC101.OP"),
        ("name,timestamp,val,quality", "FIC101_PV", "FIC101_MV"),
        ("Item ID,Date,Average,Qual", "fic101 pv", "fic101 co"),
    ],
)
def test_usual_headers_and_tags(tmp_path: Path, header: str, pv: str, op: str) -> None:
    record = read_record(write(tmp_path, rows_of(pv, PV) + rows_of(op, OP), header))
    assert record.pv.tolist() == PV
    assert record.op.tolist() == OP


def test_tags_are_mapped_and_others_are_said(tmp_path: Path) -> None:
    rows = rows_of("F1", PV) + rows_of("Z1", OP) + rows_of("T1", OP) + rows_of("F2.PV", OP)
    path = write(tmp_path, rows)
    record = read_record(path, tags={"pv": "F1", "OP": "Z1"})
    assert record.pv.tolist() == PV
    assert "tags not used: T1, F2.PV" in record.notes
    with pytest.raises(RecordError, match=r"no tag for OP; the file has 'F1'.*tags=\{'OP'"):
        read_record(path)
    with pytest.raises(RecordError, match="tag 'F3' given for PV: there is no such tag"):
        read_record(path, tags={"PV": "F3", "OP": "Z1"})


def test_two_loops_in_one_file_are_not_guessed_between(tmp_path: Path) -> None:
    rows = rows_of("F1.PV", PV) + rows_of("F2.PV", PV) + rows_of("F1.OP", OP)
    with pytest.raises(RecordError, match=r"tags 'F1.PV', 'F2.PV' could each be PV; .* tags=\{'PV': 'F1.PV'\}"):
        read_record(write(tmp_path, rows))


@pytest.mark.parametrize("header", ["Element,Attribute,Timestamp,Value", "loop,name,time,value"])
def test_attributes_of_two_loops_are_not_read_as_one(tmp_path: Path, header: str) -> None:
    """Their times are their own, so that no time has two values."""
    lines = [header]
    for k in range(60):
        for loop, at, pv in (("FIC101", 0, 50 + k % 7), ("FIC102", 500, 20 + k % 5)):
            lines += [
                f"{loop},{name},2024-10-17T09:00:{k:02d}.{at:03d},{pv + more}" for name, more in (("PV", 0), ("OP", 3))
            ]
    file = tmp_path / "two.csv"
    file.write_text("\n".join(lines))
    with pytest.raises(RecordError, match=r"tags 'FIC101.PV', 'FIC102.PV' could each be PV; say which one"):
        read_record(file)
    record = read_record(file, tags={"PV": "FIC102.PV", "OP": "FIC102.OP"})
    assert (record.sample_time, record.pv.tolist()) == (1.0, [20.0 + k % 5 for k in range(60)])
    assert "tags not used: FIC101.PV, FIC101.OP" in record.notes
    # Of one loop the attributes are the tags.
    file.write_text("\n".join(line for line in lines if "FIC102" not in line))
    assert read_record(file, tags={"OP": "OP"}).op.tolist() == [53.0 + k % 7 for k in range(60)]


def test_a_tag_twice_at_one_time_counts_once_or_is_refused(tmp_path: Path) -> None:
    rows = rows_of("F1.PV", PV) + rows_of("F1.OP", OP)
    record = read_record(write(tmp_path, rows[:5] + rows[4:]))
    assert record.pv.tolist() == PV
    assert record.counts["repeated"] == 1
    other = [(tag, time, f"{float(value) + 1:g}", good) for tag, time, value, good in rows]
    both = [row for pair in zip(rows, other, strict=True) for row in pair]
    with pytest.raises(RecordError, match=r"line 3, column 'Timestamp', tag 'F1\.PV': the same time as line 2"):
        read_record(write(tmp_path, both))


def test_texts_and_qualities_are_rejected_and_counted(tmp_path: Path) -> None:
    rows = rows_of("F1.PV", PV) + rows_of("F1.OP", OP)
    rows[20] = (*rows[20][:2], "Bad Input", "Bad")
    rows[21] = (*rows[21][:2], "I/O Timeout", "Bad")
    rows[22] = (*rows[22][:3], "Uncertain")
    record = read_record(write(tmp_path, rows))
    assert record.pv.tolist() == PV[23:]
    assert record.start == 230.0
    assert (record.counts["rejected, text"], record.counts["rejected, bad quality"]) == (2, 1)
    said = " ".join(record.notes)
    assert "2 rows rejected: text ('Bad Input' 1, 'I/O Timeout' 1), first in line 22, tag 'F1.PV'" in said
    assert "1 row rejected: bad quality" in said


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("DataQuality", "Good - NonSpecific", "Bad - Comm Failure"),
        ("Good", "True", "False"),
        ("Validity", "1", "0"),
        ("IsQuestionable", "False", "True"),
        ("QStatus", "Good", "Bad"),
        ("Percent Good", "100", "0"),
    ],
)
def test_a_quality_by_another_name_is_one(tmp_path: Path, name: str, good: str, bad: str) -> None:
    rows = [(*row[:3], good) for row in rows_of("F1.PV", PV) + rows_of("F1.OP", OP)]
    rows[20:22] = [(*row[:2], "0", bad) for row in rows[20:22]]
    record = read_record(write(tmp_path, rows, f"Tag,Timestamp,Value,{name}"))
    assert record.pv.tolist() == PV[22:]
    assert record.counts["rejected, bad quality"] == 2


def test_the_times_of_wincc_are_its_timestamps(tmp_path: Path) -> None:
    rows = ['"VarName";"TimeString";"VarValue";"Validity";"Time_ms"']
    for tag, values in (("FIC101_PV", PV), ("FIC101_LMN", OP)):
        for k, value in enumerate(values):
            bad = tag == "FIC101_PV" and k == 20
            shown = "0" if bad else f"{value:.2f}".replace(".", ",")
            days = f"{45582913194.444443 + k / 0.0864:.6f}".replace(".", ",")
            at = f"{START + dt.timedelta(seconds=k):%d.%m.%Y %H:%M:%S}"
            rows.append(f'"{tag}";"{at}";{shown};{0 if bad else 1};{days}')
    path = tmp_path / "wincc.csv"
    path.write_text("\n".join([*rows, '"$RT_OFF$";"17.10.2024 22:11:40";0;2;45582924768,518517']) + "\n")
    record = read_record(path)
    assert record.sample_time == 1.0
    assert record.pv.tolist() == [*PV[:20], pytest.approx((PV[19] + PV[21]) / 2), *PV[21:]]
    assert record.counts["rejected, bad quality"] == 1


def test_fields_of_influxdb_are_no_tags_unless_said(tmp_path: Path) -> None:
    path = write(tmp_path, rows_of("PV", PV) + rows_of("OP", OP), "_field,_time,_value,loop")
    with pytest.raises(RecordError, match=r"or which are 'tag', 'time' and 'value' of a row per value"):
        read_record(path)
    assert read_record(path, columns={"tag": "_field"}).pv.tolist() == PV


@pytest.mark.parametrize("name", ["Series", "metric"])
def test_the_tags_of_a_dashboard_are_read(tmp_path: Path, name: str) -> None:
    rows = [row[:3] for row in rows_of("F1.PV", PV) + rows_of("F1.OP", OP)]
    assert read_record(write(tmp_path, rows, f"{name},Time,Value")).pv.tolist() == PV


def test_flags_beside_values_are_not_passed_over_unsaid(tmp_path: Path) -> None:
    rows = [(*row[:3], "") for row in rows_of("F1.PV", PV) + rows_of("F1.OP", OP)]
    rows[20:22] = [(*row[:3], "Q") for row in rows[20:22]]
    path = write(tmp_path, rows, "Tag,Timestamp,Value,Flags")
    record = read_record(path)
    assert record.pv.tolist() == PV
    assert any(note.startswith("not used: 'Flags'; columns (--column) can say, as 'quality'") for note in record.notes)
    assert read_record(path, columns={"quality": "Flags"}).pv.tolist() == PV[22:]


def test_what_is_no_quality_and_no_number_is_told(tmp_path: Path) -> None:
    rows = rows_of("F1.PV", PV) + rows_of("F1.OP", OP)
    with pytest.raises(RecordError, match=r"quality \('Running'\); a column that rates no values is to be renamed"):
        read_record(write(tmp_path, [(*row[:3], "Running") for row in rows], "Tag,Timestamp,Value,Status"))
    with pytest.raises(RecordError, match=r"text .*50 m3/h.*; export numbers without their unit"):
        read_record(write(tmp_path, [(*row[:2], f"{row[2]} m3/h", "Good") for row in rows]))


def test_a_code_means_the_same_for_all_tags(tmp_path: Path) -> None:
    for good, bad in (("192", "0"), ("1", "0"), ("0", "1")):
        rows = [(*row[:3], good) for row in rows_of("F1.PV", PV) + rows_of("F1.OP", OP)]
        rows[:40] = [(*row[:2], "0", bad) for row in rows[:40]]
        rows += [(*row[:2], "0", bad) for row in rows_of("F1.SP", OP)[:10]]
        record = read_record(write(tmp_path, rows))
        assert record.sp is None
        assert record.pv.tolist() == PV[40:]


def test_tags_of_different_hours_are_refused(tmp_path: Path) -> None:
    rows = rows_of("F1.PV", PV) + [
        (tag, stamp(3600 + 10 * k), v, q) for k, (tag, _, v, q) in enumerate(rows_of("F1.OP", OP))
    ]
    with pytest.raises(RecordError, match=r"PV \(0 to 590 s\) and OP \(3600 to 4190 s\) have no sample time in common"):
        read_record(write(tmp_path, rows))


def test_a_tag_without_one_number_is_refused(tmp_path: Path) -> None:
    rows = [(tag, time, "No Data", "Bad") for tag, time, *_ in rows_of("F1.PV", PV)] + rows_of("F1.OP", OP)
    with pytest.raises(RecordError, match=r"line 2, tag 'F1\.PV': no row holds a usable number, the first is text"):
        read_record(write(tmp_path, rows))


def test_a_compressed_export_is_resampled_by_the_stated_method(tmp_path: Path) -> None:
    # PV recorded at its corners, OP at its changes: between them PV is a line and OP a stair.
    corners = [(0, 0.0), (7, 7.0), (20, -6.0), (29, 3.0), (40, 3.0)]
    stairs = [(0, 10.0), (13, 30.0), (26, 20.0), (40, 20.0)]
    rows = [("F1.PV", stamp(t), f"{v}", "Good") for t, v in corners]
    rows += [("F1.OP", stamp(t), f"{v}", "Good") for t, v in stairs]
    rows += [("F1.SP", stamp(0), "5", "Good"), ("F1.SP", stamp(11.5), "6", "Good")]
    rows += [("F1.MODE", stamp(0), "AUTO", "Good")]
    record = read_record(write(tmp_path, rows), sample_time=2.0)
    t = record.time
    assert t.tolist() == [2.0 * k for k in range(21)]
    assert record.pv == pytest.approx(np.interp(t, *zip(*corners, strict=True)))
    assert record.op.tolist() == [10.0 if s < 13 else 30.0 if s < 26 else 20.0 for s in t]
    assert record.sp is not None
    assert record.sp.tolist() == [5.0 if s < 11.5 else 6.0 for s in t]
    assert record.mode == ("AUTO",) * 21
    said = next(note for note in record.notes if note.startswith("resampled"))
    assert "every 2 s" in said
    assert "PV linear between values, OP, SP, MODE held" in said
    assert record.counts["between"] == 18


def test_a_compressed_archive_is_not_interpolated_over_a_gap_or_a_bad_value(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.choice([1.0, 1.0, 1.0, 2.0, 20.0], 600))
    times[300:] += 500.0
    times -= times[0]
    rows = [("F1.PV", stamp(t), f"{t % 7:g}", "Good") for t in times]
    rows += [("F1.OP", stamp(t), f"{t % 5:g}", "Good") for t in times + 0.5]
    bad = (times[99] + times[100]) / 2
    rows.append(("F1.PV", stamp(bad), "Bad", "Bad"))
    rows.sort(key=lambda row: (row[0], row[1]))
    record = read_record(write(tmp_path, rows))
    assert record.counts["gaps"] == 1
    first, second, third = record.segments
    assert first.time[-1] <= times[99] < bad < times[100] <= second.start + 1.0
    assert second.time[-1] <= times[299]
    assert third.start >= times[300]
    # The archive's own silences of 20 s are no gaps.
    assert len(third) == pytest.approx(times[-1] - times[300], abs=3)


def test_decimal_commas_in_a_tall_export(tmp_path: Path) -> None:
    rows = [(*row[:2], row[2].replace(".", ","), "Good") for row in rows_of("F.PV", PV) + rows_of("F.OP", OP)]
    path = tmp_path / "tall.csv"
    path.write_text("Tag;Time;Value;Quality\n" + "\n".join(";".join(row) for row in rows))
    assert read_record(path).pv.tolist() == PV
    path.write_text(path.read_text().replace("50,1", "50.1"))
    with pytest.raises(RecordError, match=r"tag 'F.PV': decimal commas \('50,7'\) and decimal points \('50.1'\)"):
        read_record(path)


def test_decimal_commas_in_quotes_in_a_tall_export(tmp_path: Path) -> None:
    rows = [(*row[:2], f'"{row[2].replace(".", ",")}"', "Good") for row in rows_of("F.PV", PV) + rows_of("F.OP", OP)]
    record = read_record(write(tmp_path, rows))
    assert record.pv.tolist() == PV
    assert record.op.tolist() == OP


def test_a_tall_parquet_export(tmp_path: Path) -> None:
    stamps = [START + dt.timedelta(seconds=10 * k) for k in range(60)]
    table = pa.table(
        {
            "tag": pa.array(["F.PV"] * 60 + ["F.OP"] * 60).dictionary_encode(),
            "timestamp": stamps * 2,
            "value": PV + OP,
            "quality": [192] * 119 + [0],
        }
    )
    pq.write_table(table, tmp_path / "tall.parquet")
    record = read_record(tmp_path / "tall.parquet")
    assert record.pv.tolist() == PV[:-1]
    assert record.op.tolist() == OP[:-1]
    assert record.counts["rejected, bad quality"] == 1
    assert "first timestamp 2024-10-17 21:55:00" in record.notes


def test_a_wide_file_may_have_qualities_and_tags(tmp_path: Path) -> None:
    lines = ["time,F1.PV,F1.PV quality,F1.OP,F1.OP quality,F2.PV"]
    lines += [f"{k},{PV[k]},{'Bad' if k == 5 else 'Good'},{OP[k]},{'Bad' if k == 6 else 'Good'},1" for k in range(60)]
    path = tmp_path / "wide.csv"
    path.write_text("\n".join(lines))
    record = read_record(path, tags={"PV": "F1.PV"})
    assert record.pv.tolist() == PV[7:]
    assert record.counts["rejected, bad quality"] == 2


@pytest.mark.parametrize(
    ("name", "texts", "good", "words"),
    [
        ("quality", ["Good", "good", "Bad", "Uncertain", "Questionable", "", "GOOD"], "1100011", ""),
        ("status", ["Good", "Good; annotated", "Bad [scan off]", "Not good"], "1100", ""),
        ("quality", ["192", "216", "0", "64", "192"], "11001", ""),
        ("status", ["0", "0", "2147483648", "1073741824"], "1100", ""),
        ("IsGood", ["True", "False", "true"], "101", ""),
        ("is_good", ["0", "0", "1"], "001", ""),
        ("Questionable", ["False", "True", "False"], "101", ""),
        ("questionable", ["0", "1", "0"], "101", ""),
        ("status", ["0", "0", "0", "1"], "1110", "0, the more frequent, is taken as good"),
        ("confidence", ["100", "0", "80"], "101", ""),
        ("confidence", ["100", "-1", "80"], "101", ""),
        ("quality", ["100", "0", "100"], "101", ""),
        ("Percent Good", ["90", "0", "80"], "101", ""),
        ("status", ["Good_NonCascade", "Bad_Stale", "GoodClamped", "Uncertain_Initial"], "1010", ""),
        ("status", ["7", "9"], "11", "codes that are not known (7, 9); all are taken as good"),
        ("status", ["3"] * 18 + ["0"], "1" * 19, "codes that are not known (0, 3); all are taken as good"),
        ("status", ["3"] * 19 + ["0"], "1" * 19 + "0", "not known (0, 3); 3, the usual one, is taken as good"),
        ("Quality", ["0"] * 57 + ["133", "1", ""], "1" * 57 + "001", "0, the usual one, is taken as good"),
        ("status", ["8", "8"], "11", "codes that are not known (8); all are taken as good"),
        ("Data Status", ["NR", "IOP", "NR", "CLP+", "NRDY"], "10110", ""),
        ("Qualität", ["Gut", "Schlecht"], "10", ""),
        ("Qualité", ["Bon", "Bonne", "Mauvais"], "110", ""),
    ],
)
def test_qualities(name: str, texts: list[str], good: str, words: str) -> None:
    found, bad, note = good_quality(texts, name)
    assert "".join(str(int(g)) for g in found) == good
    assert sum(bad.values()) == good.count("0")
    assert words in note
    assert bool(words) == bool(note)
