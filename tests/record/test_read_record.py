"""Reading records: spellings, times, what is refused and what is said."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workbench.errors import InvalidValue, RecordError, WorkbenchError
from workbench.model.record import Record
from workbench.record import reader
from workbench.record.reader import read_record

RECORDS = Path(os.environ.get("WORKBENCH_RECORDS", Path(__file__).resolve().parents[2].parent / "shared" / "data"))


def write(folder: Path, text: str | bytes, name: str = "loop.csv") -> Path:
    path = folder / name
    if isinstance(text, bytes):
        path.write_bytes(text)
    else:
        path.write_text(text, encoding="utf-8")
    return path


def table(header: str, rows: int = 12, sep: str = ",") -> str:
    """Time every 2 s, OP 40 + k/10, PV 10 - k, SP 7, and text."""
    cells = {"t": "{0}", "OP": "{1}", "PV": "{2}", "SP": "7", "MODE": "AUTO", "X": "{1}"}
    kinds = header.split("|")
    lines = [sep.join(k.split("=")[-1] for k in kinds)]
    lines += [
        sep.join(cells[kind.split("=")[0]].format(2 * k, 40 + k / 10, 10 - k) for kind in kinds) for k in range(rows)
    ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "header",
    [
        "t|OP|PV|SP|MODE",
        "t=t_s|OP=op|PV=pv|SP=sp|MODE=mode",
        "t=Time (s)|OP=Controller Output|PV=Process Value|SP=Set Point|MODE=Mode",
        "t=seconds|OP=MV|PV=measurement|SP=set_point|MODE=Controller_Mode",
        "t=timestamp|OP=FIC101.OP|PV=FIC101.PV|SP=FIC101.SP|MODE=FIC101.MODE",
        "t=TIME|OP=FIC101_OP|PV=FIC101_PV|SP=FIC101_SP|MODE=FIC101_MODE",
        "t=t|OP=output [%]|PV=PV (m3/h)|SP=setpoint (m3/h)|MODE=mode",
        "t=time_s|OP=CO|PV=process_variable|SP=SetPoint|MODE=MODE",
        "t=Zeit|OP=Stellgröße (%)|PV=Istwert (m3/h)|SP=Sollwert (m3/h)|MODE=Mode",
        "t=Temps|OP=FIC101.Sortie|PV=FIC101.Mesure|SP=FIC101.Consigne|MODE=Mode",
    ],
)
def test_usual_spellings_are_found(tmp_path: Path, header: str) -> None:
    record = read_record(write(tmp_path, table(header)))
    assert record.sample_time == 2.0
    assert record.pv.tolist() == [10.0 - k for k in range(12)]
    assert record.op[3] == pytest.approx(40.3)
    assert record.sp is not None
    assert record.sp[0] == 7.0
    assert record.mode == ("AUTO",) * 12
    assert record.counts["kept"] == 12
    assert record.counts["rejected"] == 0


@pytest.mark.parametrize(
    "name", ["valve_position", "Valve Position %", "stem", "FV101.ZT", "position", "POS", "stem position [%]"]
)
def test_a_positioner_signal_is_found(tmp_path: Path, name: str) -> None:
    record = read_record(write(tmp_path, table(f"t|OP|PV|X={name}")))
    assert record.valve_position is not None
    assert record.valve_position.tolist() == record.op.tolist()


def test_the_signals_own_name_goes_before_other_spellings(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, table("t|X=output|OP|PV|SP=measurement")))
    assert record.pv[0] == 10.0
    assert record.op.tolist() == [40 + k / 10 for k in range(12)]


def test_an_explicit_mapping_goes_before_everything(tmp_path: Path) -> None:
    path = write(tmp_path, table("t|OP|PV|SP=my flow"))
    record = read_record(path, columns={"pv": "my flow", "OP": "OP"})
    assert record.pv.tolist() == [7.0] * 12


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"PV": "flow"}, ["'flow'", "no such column", "'OP'", "'PV'"]),
        ({"flow": "PV"}, ["'flow'", "must be one of", "valve_position"]),
        ({"PV": "OP", "OP": "OP"}, ["'OP'", "more than one signal"]),
    ],
)
def test_a_wrong_mapping_is_refused(tmp_path: Path, columns: dict[str, str], words: list[str]) -> None:
    with pytest.raises(RecordError) as refusal:
        read_record(write(tmp_path, table("t|OP|PV")), columns=columns)
    assert all(word in str(refusal.value) for word in words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty"]),
        ("\n\n  \n", ["empty"]),
        ("t,PV,OP\n", ["no row"]),
        ("t,PV\n0,1\n1,2\n", ["no column for OP", "'PV'", "columns="]),
        ("t,OP\n0,1\n1,2\n", ["no column for PV"]),
        ("a,b,c\n0,1,2\n1,2,3\n", ["no column for PV and OP"]),
        ("t,FIC1.PV,FIC2.PV,OP\n0,1,2,3\n1,1,2,3\n", ["'FIC1.PV'", "'FIC2.PV'", "could each be PV"]),
        ("t,PV,PV,OP\n0,1,2,3\n1,1,2,3\n", ["could each be PV; all have this name: rename all but one of them in"]),
        ("0,1,2\n1,2,3\n2,3,4\n", ["line 1", "header"]),
        ("2024-03-12 06:00:00,54.0,50.1\n2024-03-12 06:00:01,54.1,50.2\n", ["'54.0'", "a header line is needed"]),
        ("12.03.2024 06:00:00;54,0;\n12.03.2024 06:00:01;54,1;\n", ["'54,0'", "a header line is needed"]),
        ("2024-03-12 06:00:00,,Good\nt,A,B\n", ["no column for PV and OP"]),
        ("2024-03-12 06:00:00,,\nt,A,B\n", ["no column for PV and OP"]),
        ("PV,OP\n1,2\n2,3\n", ["no time column", "sample_time"]),
        (
            "t,PV,OP\n0,1,2\n1,1,2\n1,2,3\n2,1,2\n2,3,2\n3,1,2\n",
            ["line 4", "'t'", "same time as line 3", "1 times more"],
        ),
        ("t,PV,OP\n0,1,2\n1,1,2\n0.5,1,2\n2,1,2\n", ["line 4", "'t'", "before line 3"]),
        ("t,PV,OP\n0,bad,2\n1,worse,2\n2,ugly,2\n", ["line 2", "'PV'", "text", "'bad'"]),
        ("t,PV,OP\n0,1,\n1,2,\n2,3,\n", ["line 2", "'OP'", "blank"]),
        ("t,PV,OP\n0,nan,2\n1,nan,2\n", ["line 2", "'PV'", "not finite"]),
        ("t,PV,OP\n0,1,inf\n1,2,-inf\n", ["'OP'", "not finite"]),
        ("time,PV,OP\nyesterday,1,2\ntoday,1,2\n", ["line 2", "'time'", "'yesterday'", "allowed"]),
        ("t,PV,OP\n0,1,5,2,5\n1,1,5,2,5\n", ["line 2", "more fields than the header", "decimal comma"]),
        ("t,PV,OP\n0,1,2\n", ["at least two"]),
        ("t,PV,OP\n0,1,2\n1,x,2\n2,1,2\n3,x,2\n4,1,2\n", ["no two clean"]),
        (
            "time,PV,OP\n2024-03-31T01:59:50+01:00,1,2\n2024-03-31 02:00:00,1,2\n2024-03-31 02:00:10,1,2\n",
            ["time zone", "all or none"],
        ),
    ],
)
def test_bad_files_are_refused_in_words(tmp_path: Path, text: str, words: list[str]) -> None:
    path = write(tmp_path, text)
    with pytest.raises(RecordError) as refusal:
        read_record(path)
    said = str(refusal.value)
    assert str(path) in said
    assert all(word in said for word in words), said


def quoted(folder: Path, cells: list[str]) -> Path:
    """A comma-separated file with PV in quotes."""
    rows = "".join(f'{k},"{cell}",{k % 7}\n' for k, cell in enumerate(cells))
    return write(folder, f"t,PV,OP\n{rows}")


@pytest.mark.parametrize(
    ("cells", "first"),
    [
        ([f"{54 + k % 9},{k % 10}167" for k in range(40)], 54.0167),
        ([f"{54 + k % 9},{k % 9 + 1}" for k in range(40)], 54.1),
        ([f"{1 + k % 9},500" for k in range(39)] + ["0,5"], 1.5),  # the last leaves no doubt
        ([f"{1 + k % 9},500.25" for k in range(40)], 1500.25),
        ([f"{1 + k % 9},500" for k in range(39)] + ["999.75"], 1500.0),
        ([f"{1 + k % 9},500,000" for k in range(40)], 1500000.0),
        ([f"-{1 + k % 9},500.5 %" for k in range(40)], -1500.5),
    ],
)
def test_commas_in_quotes_are_read_where_they_leave_no_doubt(tmp_path: Path, cells: list[str], first: float) -> None:
    record = read_record(quoted(tmp_path, cells))
    assert (len(record), record.pv[0]) == (40, first)


def test_values_are_parted_from_a_thousand_on(tmp_path: Path) -> None:
    record = read_record(quoted(tmp_path, [f"{990 + k * 5 % 23:,}.5" for k in range(40)]))
    assert record.pv.tolist() == [990.5 + k * 5 % 23 for k in range(40)]


@pytest.mark.parametrize(
    "cells",
    [
        [f"{1 + k % 9},500" for k in range(40)],  # thousands, or decimals?
        [f"{1 + k % 9},5" if k % 2 else f"{k % 9 + 1},500.25" for k in range(40)],  # both
        [f"{1 + k % 9},5" if k % 2 else f"{k % 9 + 1}.5" for k in range(40)],
    ],
)
def test_commas_in_quotes_that_leave_a_doubt_are_not_guessed(tmp_path: Path, cells: list[str]) -> None:
    with pytest.raises(RecordError, match=r"usable number, the first is text|no two clean rows"):
        read_record(quoted(tmp_path, cells))


def test_a_title_of_a_time_and_a_number_is_passed_over(tmp_path: Path) -> None:
    rows = "".join(f"{k},{k},{k % 7}\n" for k in range(40))
    assert len(read_record(write(tmp_path, f"2024-03-12 06:00:00,1500\nt,PV,OP\n{rows}"))) == 40


def test_a_missing_file_and_a_directory_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no such file"):
        read_record(tmp_path / "none.csv")
    with pytest.raises(RecordError, match="directory"):
        read_record(tmp_path)
    with pytest.raises(RecordError):
        read_record("\0")


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "large.csv"
    with path.open("wb") as file:
        file.truncate(2 << 30)  # sparse: no disk space
    with pytest.raises(RecordError, match=r"2\.0 GiB given; at most 1 GiB"):
        read_record(path)


@pytest.mark.parametrize("content", [b"\x00\x01\x02PV,OP\x00", b"PV,OP\n\x00\x01", b"PK\x03\x04" + bytes(range(40))])
def test_binary_files_are_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(RecordError, match="no text file"):
        read_record(write(tmp_path, content))


def test_text_in_no_known_encoding_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="encoding"):
        read_record(write(tmp_path, b"t,PV,OP\n0,1,2 \x81\x8d\n"))
    with pytest.raises(RecordError, match="encoding"):
        read_record(write(tmp_path, b"\xff\xfet\x00,"))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_usual_encodings_are_read(tmp_path: Path, encoding: str) -> None:
    text = table("t|OP|PV|SP=Sollwert °C").replace("MODE", "M")
    record = read_record(write(tmp_path, text.encode(encoding)))
    assert len(record) == 12
    assert any("Windows-1252" in note for note in record.notes) == (encoding == "cp1252")


@pytest.mark.parametrize("sep", [",", ";", "\t", "|"])
def test_delimiters_and_quotes(tmp_path: Path, sep: str) -> None:
    quoted = "\n".join(sep.join(f'"{c}"' for c in line.split(sep)) for line in table("t|OP|PV", sep=sep).splitlines())
    assert read_record(write(tmp_path, quoted)).pv.tolist() == [10.0 - k for k in range(12)]


def test_columns_that_spaces_part(tmp_path: Path) -> None:
    rows = "\n".join(f"  {2.0 * k:8.1f}   {50.0 + k:10.3f} {40.0 - k:9.2f}  " for k in range(12))
    record = read_record(write(tmp_path, f"Loop 101 of unit two\n\n  t      PV     OP\n{rows}\n"))
    assert record.sample_time == 2.0
    assert record.pv.tolist() == [50.0 + k for k in range(12)]
    assert record.op.tolist() == [40.0 - k for k in range(12)]
    dates = "\n".join(f"2024-01-05 10:00:{k:02d} {50 + k} {40 - k}" for k in range(12))
    assert read_record(write(tmp_path, f"Date Time PV OP\n{dates}\n")).sample_time == 1.0
    with pytest.raises(RecordError, match="more fields than the header"):
        read_record(write(tmp_path, f"Time PV OP\n{dates}\n"))


@pytest.mark.parametrize("mark", [" ", "\u00a0", "\u202f", "'", "\u2019"])
def test_thousands_that_a_space_or_an_apostrophe_parts(tmp_path: Path, mark: str) -> None:
    rows = "\n".join(f"{k};1{mark}{234 + k}{mark}567,5;{40 - k},25" for k in range(12))
    record = read_record(write(tmp_path, f"t;PV;OP\n{rows}\n"))
    assert record.pv.tolist() == [1e6 + (234.0 + k) * 1000.0 + 567.5 for k in range(12)]
    assert record.op.tolist() == [40.25 - k for k in range(12)]


def test_percent_signs_are_no_text(tmp_path: Path) -> None:
    assert read_record(write(tmp_path, "t,PV,OP\n0,1,5.5%\n1,2,6 %\n2,3,7\n")).op.tolist() == [5.5, 6, 7]


def test_decimal_commas_where_the_delimiter_allows_them(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, "t;PV;OP\n0,5;1,25;2\n1,5;-2,5;3,125\n2,5;1;2\n"))
    assert record.pv.tolist() == [1.25, -2.5, 1.0]
    assert record.op[1] == 3.125
    assert (record.start, record.sample_time) == (0.5, 1.0)


@pytest.mark.parametrize(
    "form",
    [
        "%Y-%m-%d %H:%M:%S",
        "%Y-%m-%dT%H:%M:%SZ",
        "%Y-%m-%dT%H:%M:%S+03:00",
        "%Y-%m-%d %H:%M:%S.250",
        "%d.%m.%Y %H:%M:%S",
        "%d/%m/%Y %H:%M:%S",
        "%m/%d/%Y %I:%M:%S %p",
        "%d-%b-%y %H:%M:%S",
        "%Y/%m/%d %H:%M:%S",
    ],
)
def test_timestamps(tmp_path: Path, form: str) -> None:
    from datetime import UTC, datetime, timedelta

    start = datetime(2024, 10, 17, 23, 59, 0, tzinfo=UTC)
    lines = ["Timestamp,PV,OP"]
    lines += [f"{(start + timedelta(seconds=10 * k)).strftime(form)},{k},{2 * k}" for k in range(20)]
    record = read_record(write(tmp_path, "\n".join(lines)))
    assert len(record) == 20
    assert record.sample_time == pytest.approx(10.0)
    assert record.start == 0.0
    assert any("first timestamp" in note for note in record.notes)


def test_time_units_and_milliseconds_since_1970(tmp_path: Path) -> None:
    assert read_record(write(tmp_path, "t_min,PV,OP\n0,1,2\n1,1,2\n2,1,3\n")).sample_time == 60.0
    epoch = "timestamp,PV,OP\n" + "".join(f"{1729202100000 + 5000 * k},1,{k}\n" for k in range(5))
    assert read_record(write(tmp_path, epoch)).sample_time == pytest.approx(5.0)


def test_without_times_the_sample_time_is_needed_and_with_them_it_must_agree(tmp_path: Path) -> None:
    path = write(tmp_path, "PV,OP\n1,2\n2,3\n3,4\n")
    assert read_record(path, sample_time=5.0).time.tolist() == [0.0, 5.0, 10.0]
    with pytest.raises(InvalidValue):
        read_record(path, sample_time=-1.0)
    timed = write(tmp_path, table("t|OP|PV"))
    assert read_record(timed, sample_time=2.0).sample_time == 2.0
    with pytest.raises(RecordError, match="sample_time 5 s given"):
        read_record(timed, sample_time=5.0)


@pytest.mark.parametrize("name", ["loop.csv", "loop.parquet"])
def test_numbers_too_large_are_not_called_infinite(tmp_path: Path, name: str) -> None:
    pv = [1.0 * k for k in range(60)]
    pv[10], pv[20], pv[30] = 1e200, -1.1e100, float("inf")
    path = tmp_path / name
    if name.endswith("csv"):
        path.write_text("t,PV,OP\n" + "".join(f"{k},{v!r},{k % 7}\n" for k, v in enumerate(pv)))
    else:
        pq.write_table(pa.table({"t": list(range(60)), "PV": pv, "OP": [k % 7 for k in range(60)]}), path)
    record = read_record(path, max_gap=5.0)
    assert record.counts["rejected, beyond 1e+100 in size"] == 2
    assert record.counts["rejected, not finite"] == 1
    assert any(note.startswith("2 rows rejected: beyond 1e+100 in size, first in") for note in record.notes)


def test_rejected_rows_are_counted_and_the_longest_stretch_is_kept(tmp_path: Path) -> None:
    rows = [f"{k},{k},{2 * k}" for k in range(60)]
    rows[10] = "10,Bad Input,20"
    rows[11] = "11,,22"
    rows[40] = "40,40,nan"
    record = read_record(write(tmp_path, "t,PV,OP\n" + "\n".join(rows) + "\n"))
    assert (record.start, len(record)) == (12.0, 48)
    assert record.pv.tolist() == list(range(12, 60))
    assert record.op.tolist()[27:30] == [78.0, 78.0, 82.0]
    assert record.counts["rows"] == 60
    assert record.counts["rejected"] == 3
    assert (record.counts["rejected, text"], record.counts["rejected, blank"]) == (1, 1)
    assert record.counts["rejected, not finite"] == 1
    assert record.counts["kept"] + record.counts["left out"] + record.counts["rejected"] == 60 + record.counts["filled"]
    said = " ".join(record.notes)
    assert "'Bad Input'" in said
    assert "line 12, column 'PV'" in said
    assert "48 of 60 rows, lines 14 to 61" in said


def test_a_half_text_file_is_named_once_and_the_reason_is_true(tmp_path: Path) -> None:
    path = write(tmp_path, "t,PV,OP\n" + "".join(f"{k},{'Bad' if k % 2 else k},2\n" for k in range(20)))
    with pytest.raises(RecordError) as refusal:
        read_record(path)
    said = str(refusal.value)
    assert said.count(str(path)) == 1
    assert "10 rows rejected: text ('Bad'), first in line 3, column 'PV'" in said


def test_a_row_with_too_many_fields_blames_no_column(tmp_path: Path) -> None:
    rows = [f"{k},{k},{2 * k}" for k in range(20)]
    rows[4] = "4,4,8,9"
    record = read_record(write(tmp_path, "t,PV,OP\n" + "\n".join(rows) + "\n"))
    assert "1 row rejected: more fields than the header, first in line 6" in record.notes
    with pytest.raises(RecordError) as refusal:
        read_record(write(tmp_path, "t,PV,OP\n0,1,5,2,5\n1,1,5,2,5\n"))
    assert "column" not in str(refusal.value)


def test_a_damaged_parquet_file_is_called_one(tmp_path: Path) -> None:
    for content in (b"\x00\x01\x02" * 50, b"PAR1" + bytes(40)):
        with pytest.raises(RecordError, match="no readable Parquet file"):
            read_record(write(tmp_path, content, "loop.parquet"))


@pytest.mark.parametrize(
    ("modes", "words"),
    [
        (["AUTO"] * 15 + ["Man"] * 5, "stretches of one mode are kept apart; the 5 samples in manual are left out"),
        (["1"] * 15 + ["0.0"] * 5, "MODE: 1 75.0 %, 0 25.0 %; stretches of one mode are kept apart; the 5 samples"),
        (["AUTO"] * 12 + ["Cas"] * 8, "MODE: AUTO 60.0 %, CAS 40.0 %; stretches of one mode are kept apart"),
        (["MAN"] * 20, "MODE: MAN 100.0 %; the controller was never in automatic: OP is not its answer to PV"),
        (["CAS"] * 20, None),
        (["0"] * 20, None),
        (["Automatique"] * 15 + ["Manuel"] * 5, "the 5 samples in manual are left out"),
        (["Automático"] * 15 + ["Manual"] * 5, "the 5 samples in manual are left out"),
        (["AUT"] * 15 + ["MAN(8)"] * 5, "the 5 samples in manual are left out"),
        (["AUTO"] * 15 + ["O-MAN"] * 5, "the 5 samples in manual are left out"),
        (["16"] * 15 + ["8"] * 5, "the 5 samples in manual are left out"),  # the bits of a fieldbus block's mode
        (["1"] * 5 + ["0"] * 15, "the 15 samples in manual are left out; 0 is taken for manual; whether 1 is"),
        (["2"] * 15 + ["1"] * 5, "kept apart; whether 2 or 1 is automatic or manual is not known"),
        (["HALT"] * 20, "MODE: HALT 100.0 %; whether HALT is automatic or manual is not known"),
    ],
)
def test_samples_in_manual_are_said(tmp_path: Path, modes: list[str], words: str | None) -> None:
    rows = "".join(f"{k},{k},{2 * k},{mode}\n" for k, mode in enumerate(modes))
    record = read_record(write(tmp_path, "t,PV,OP,MODE\n" + rows))
    said = " ".join(note for note in record.notes if "MODE" in note)
    assert (words in said) if words else said == ""
    assert len(set(record.mode or ())) == 1


@pytest.mark.parametrize("name", ["MODE.ACTUAL", "Betriebsart", "Mode de marche", "Auto/Manual", "FIC101.MD", "Modo"])
def test_a_column_of_modes_is_known_by_its_usual_names(tmp_path: Path, name: str) -> None:
    rows = "".join(f"{k},{k},{2 * k},{'AUTO' if k < 40 else 'MAN'}\n" for k in range(60))
    assert len(read_record(write(tmp_path, f"t,PV,OP,{name}\n" + rows))) == 40


def test_a_gap_splits_the_record_and_is_said(tmp_path: Path) -> None:
    times = [*range(50), *range(90, 190)]
    text = "t,PV,OP\n" + "".join(f"{t},{t % 7},{t}\n" for t in times)
    record = read_record(write(tmp_path, text))
    assert (record.start, len(record)) == (90.0, 100)
    assert record.counts["gaps"] == 1
    assert any("1 gap in time" in note for note in record.notes)


def test_small_jitter_is_taken_as_even_and_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    times = 10.0 * np.arange(100) + rng.uniform(-0.5, 0.5, 100)
    text = "t,PV,OP\n" + "".join(f"{t:.3f},{i % 5},{i}\n" for i, t in enumerate(times))
    record = read_record(write(tmp_path, text))
    assert len(record) == 100
    assert record.sample_time == pytest.approx(10.0, rel=1e-3)
    assert any("taken as even" in note for note in record.notes)


def test_missing_setpoint_cells_hold_and_a_broken_stem_signal_is_left_out(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, "t,PV,OP,SP,stem\n0,1,2,,1\n1,1,2,5,1\n2,1,2,,bad\n3,1,3,6,1\n4,1,4,6,1\n"))
    assert record.sp is not None
    assert record.sp.tolist() == [5.0, 5.0, 5.0, 6.0, 6.0]
    assert record.valve_position is None
    first = "SP: the first good value is taken for the 1 cell before it, too; theirs may differ"
    assert {first, "SP: the value before is held in 1 cell without a good value"} <= {*record.notes}
    assert any(note.startswith("valve position left out") for note in record.notes)


def test_a_constant_signal_is_read(tmp_path: Path) -> None:
    assert np.ptp(read_record(write(tmp_path, "t,PV,OP\n0,1,2\n1,1,2\n2,1,2\n")).pv) == 0.0


def test_comments_and_blank_lines_keep_the_line_numbers_right(tmp_path: Path) -> None:
    text = "# export of FIC101\n\nt,PV,OP\n0,1,2\n\n1,1,2\n0.5,1,2\n"
    with pytest.raises(RecordError, match="line 7"):
        read_record(write(tmp_path, text))


def test_titles_before_the_header_and_units_below_it(tmp_path: Path) -> None:
    text = "Trend export, FIC101\nFrom;2024-10-17\n\nt,OP,PV\ns,%,m3/h\n" + table("t|OP|PV").split("\n", 1)[1]
    record = read_record(write(tmp_path, text))
    assert record.pv.tolist() == [10.0 - k for k in range(12)]
    assert "the header is line 4" in record.notes
    assert record.counts["rejected"] == 0
    with pytest.raises(RecordError, match="no column for PV and OP; the file has 'Trend export', 'FIC101'"):
        read_record(write(tmp_path, text.replace("t,OP,PV", "a,b,c")))


def test_a_day_and_a_clock_in_columns_of_their_own(tmp_path: Path) -> None:
    rows = [f"17.10.2024,23:59:{k:02d},{k},5" if k < 60 else f"18.10.2024,00:00:{k - 60:02d},{k},5" for k in range(90)]
    record = read_record(write(tmp_path, "Date,Time,PV,OP\n" + "\n".join(rows)))
    assert (len(record), record.sample_time, record.pv[-1]) == (90, 1.0, 89.0)
    assert "first timestamp 17.10.2024 23:59:00" in record.notes
    for names, day in (("Datum,Uhrzeit", ""), ("Datum,Zeit", ""), ("Date,Heure", ""), ("Date,Time", " 00:00:00.000")):
        text = f"{names},PV,OP\n" + "\n".join(row.replace("2024,", f"2024{day},") for row in rows)
        assert read_record(write(tmp_path, text)).notes == record.notes
    stamps = [f"{day} {clock},{clock},{rest}" for day, clock, rest in (row.split(",", 2) for row in rows)]
    assert read_record(write(tmp_path, "Datum,Zeit,PV,OP\n" + "\n".join(stamps))).notes == record.notes
    alone = write(tmp_path, "Time,PV,OP\n" + "\n".join(row.partition(",")[2] for row in rows))
    assert "column 'Time': times of day without a date: they run on over midnight" in read_record(alone).notes


def test_a_name_in_quotes_may_take_two_lines(tmp_path: Path) -> None:
    text = table("t|OP|PV").replace("t,OP,PV", 't,OP,"PV\n(m3/h)"')
    record = read_record(write(tmp_path, text))
    assert record.pv.tolist() == [10.0 - k for k in range(12)]
    path = write(tmp_path, text.replace("4,40.2", "4,bad"))
    assert any("first in line 5, column 'OP'" in note for note in read_record(path).notes)


def test_parquet_equals_csv(tmp_path: Path) -> None:
    text = table("t|OP|PV|SP|MODE", rows=40)
    from_csv = read_record(write(tmp_path, text))
    k = np.arange(40)
    columns = pa.table({"t": 2 * k, "OP": 40 + k / 10, "PV": 10 - k, "SP": np.full(40, 7), "MODE": ["AUTO"] * 40})
    pq.write_table(columns, tmp_path / "loop.parquet")
    from_parquet = read_record(tmp_path / "loop.parquet")
    for name in ("pv", "op", "sp", "time"):
        assert np.array_equal(getattr(from_csv, name), getattr(from_parquet, name))
    assert from_parquet.mode == from_csv.mode


def test_parquet_timestamps_and_missing_values(tmp_path: Path) -> None:
    stamps = pa.array(np.datetime64("2024-10-17T21:55:00", "ms") + 10_000 * np.arange(30).astype("timedelta64[ms]"))
    pv = pa.array([None if i in (3, 4) else float(i) for i in range(30)], pa.float64())
    tags = {"time": stamps, "FIC1.PV": pv, "FIC1.OP": pa.array(range(5, 35), pa.int32())}
    pq.write_table(pa.table(tags), tmp_path / "loop.pq")
    record = read_record(tmp_path / "loop.pq")
    assert (len(record), record.sample_time, record.start) == (25, 10.0, 50.0)
    assert record.counts["rejected, blank"] == 2
    assert any("row 4" in note for note in record.notes)


@pytest.mark.parametrize("kind", [pa.binary(), pa.large_binary(), pa.binary(4)])
def test_parquet_times_without_a_name_and_text_as_bytes(tmp_path: Path, kind: pa.DataType) -> None:
    at = pa.array([k * 1_000_000_000 for k in range(60)], pa.timestamp("ns", "UTC"))
    columns = {"PV": [float(k) for k in range(60)], "OP": [5.0] * 60, "MODE": pa.array([b"AUTO"] * 60, kind)}
    pq.write_table(pa.table({**columns, "__index_level_0__": at}), tmp_path / "loop.parquet")
    record = read_record(tmp_path / "loop.parquet")
    assert (record.sample_time, len(record), record.mode) == (1.0, 60, ("AUTO",) * 60)
    assert "the times are those of the column __index_level_0__" in record.notes


def test_a_broken_parquet_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="Parquet"):
        read_record(write(tmp_path, b"PAR1" + b"\x01" * 200 + b"PAR1", "loop.parquet"))


def test_reading_never_writes(tmp_path: Path) -> None:
    path = write(tmp_path, table("t|OP|PV"))
    before = path.read_bytes()
    read_record(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["loop.csv"]


quiet = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@quiet
@given(content=st.binary(max_size=300), kind=st.sampled_from([b"", b"PAR1", b"PV,OP,t\n", b"\xff\xfe"]))
def test_random_bytes_give_a_record_or_our_own_error(tmp_path: Path, content: bytes, kind: bytes) -> None:
    path = write(tmp_path, kind + content)
    with suppress(WorkbenchError):
        assert isinstance(read_record(path), Record)


cells = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True).map(repr),
    st.integers(-5, 40).map(str),
    st.sampled_from(["", "Bad", "1,5", '"', "'", "2024-01-01 00:00:00", "31.12.2024 23:59:59", "1e400", "1_0", ";"]),
    st.text(max_size=4),
)


@quiet
@given(
    header=st.lists(st.sampled_from(["t", "time", "PV", "OP", "SP", "MODE", "x.PV", "stem", "a b", ""]), max_size=6),
    rows=st.lists(st.lists(cells, max_size=6), max_size=8),
    sep=st.sampled_from([",", ";", "\t"]),
    sample_time=st.sampled_from([None, 1.0]),
)
def test_random_tables_give_a_record_or_our_own_error(
    tmp_path: Path, header: list[str], rows: list[list[str]], sep: str, sample_time: float | None
) -> None:
    lines = [sep.join(header)] + [sep.join(row) for row in rows]
    path = write(tmp_path, "\n".join(lines).encode("utf-8", "replace"))
    with suppress(WorkbenchError):
        record = read_record(path, sample_time=sample_time)
        assert record.counts["kept"] == len(record)
        assert np.isfinite(record.pv).all()


def test_the_real_records_are_read_whole() -> None:
    if not RECORDS.is_dir():
        pytest.skip(f"no folder of real records at {RECORDS}; set WORKBENCH_RECORDS")
    files = [f for f in sorted(RECORDS.glob("*/*.csv")) if f.name != "labels.csv"]
    assert files
    for file in files:
        record = read_record(file)
        assert record.counts["kept"] == record.counts["rows"] == len(record), file
        assert (record.sp is not None) == (file.parent.name == "plant")
    chem23 = read_record(RECORDS / "isdb" / "CHEM23.csv")
    assert (len(chem23), chem23.sample_time) == (1500, 10.0)


def test_the_size_limit_is_one_gibibyte() -> None:
    assert reader.LARGEST == 2**30


def test_a_given_sample_time_replaces_that_of_a_clock_which_is_slightly_off(tmp_path):
    path = tmp_path / "drift.csv"
    rows = "".join(f"{k * 1.0001:.4f},{k % 7},{k % 5}\n" for k in range(50))
    path.write_text("time,PV,OP\n" + rows)
    assert read_record(path).sample_time == pytest.approx(1.0001)
    record = read_record(path, sample_time=1.0)
    assert record.sample_time == 1.0
    assert any("as given" in note for note in record.notes)


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({20: '100,"20,6'}, "line 22, column 'PV': a quote (\") is opened and not closed, and rows would be taken"),
        ({20: '100,20,"6', 40: '"200,40,5'}, "line 22, column 'OP': a quote (\") is opened and not closed"),
        ({58: '"290,58,2'}, "line 60, column 'time'"),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_quote_that_is_not_closed_loses_no_rows(
    tmp_path: Path, changes: dict[int, str], where: str, end: str
) -> None:
    rows = [changes.get(k, f"{5 * k},{k},{k % 7}") for k in range(60)]
    path = tmp_path / "loop.csv"
    path.write_bytes((end.join(["time,PV,OP", *rows]) + end).encode())
    with pytest.raises(RecordError, match=re.escape(where)):
        read_record(path)


def test_a_quote_that_is_not_closed_is_named_in_a_long_file_and_in_the_header(tmp_path: Path) -> None:
    rows = [f"{5 * k},{k},{k % 7}" if k != 20 else '100,"20,6' for k in range(20_000)]
    with pytest.raises(RecordError, match=r"line 22: no readable CSV.*is a quote opened there that is not closed\?"):
        read_record(write(tmp_path, "\n".join(["time,PV,OP", *rows])))
    with pytest.raises(RecordError, match=r"line 1: a quote \(\"\) is opened and not closed"):
        read_record(write(tmp_path, "\n".join(['time,"PV,OP', *rows[:20]])))


def test_a_comment_in_quotes_may_take_several_lines(tmp_path: Path) -> None:
    rows = [f'{5 * k},{k},{k % 7},"a note\nof two lines, with, more, commas"' for k in range(60)]
    record = read_record(write(tmp_path, "\n".join(["time,PV,OP,note", *rows])))
    assert record.pv.tolist() == list(range(60))


@pytest.mark.parametrize(
    "header",
    [
        'time,"PV, m3/h","OP, %","SP, m3/h"',
        "time,Measured Value,Output,Set Point",
        "time,FIC101 Measured Value,FIC101 Output,FIC101 Set Point",
        '"time, s","FIC101.PV, bar","FIC101.OP, %",FIC101.SP',
    ],
)
def test_names_of_two_words_and_with_a_unit_after_a_comma(tmp_path: Path, header: str) -> None:
    rows = [f"{k},{k},{k % 7},5" for k in range(40)]
    record = read_record(write(tmp_path, "\n".join([header, *rows])))
    assert record.pv.tolist() == list(range(40))
    assert record.op[:7].tolist() == list(range(7))
    assert record.sp is not None


def test_what_stands_after_a_comma_may_be_more_than_a_unit(tmp_path: Path) -> None:
    rows = [f"{k},{k},{k % 7},{'Bad' if k == 20 else 'Good'}" for k in range(60)]
    record = read_record(write(tmp_path, "\n".join(['time,PV,OP,"PV, quality"', *rows])))
    assert record.counts["rejected, bad quality"] == 1
    record = read_record(write(tmp_path, "\n".join(['time,PV,OP,"PV, raw"', *rows])))
    assert len(record) == 60
