"""Times written as numbers: what their size tells, and what it leaves open."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import RecordError
from workbench.record.counted import counted
from workbench.record.reader import read_record
from workbench.scenario.series import read_series

START = dt.datetime(2026, 3, 9, 22, 50, tzinfo=dt.UTC)
SINCE_1970 = int(START.timestamp())
TICKS = SINCE_1970 + 62_135_596_800  # s since the year 1
FILE_TIME = SINCE_1970 + 11_644_473_600  # s since 1601

COUNTS = [
    (10**3, SINCE_1970, "milliseconds since 1970"),
    (10**6, SINCE_1970, "microseconds since 1970"),
    (10**9, SINCE_1970, "nanoseconds since 1970"),
    (10**7, TICKS, "ticks of 100 ns since the year 1, as .NET counts them"),
    (10**7, FILE_TIME, "units of 100 ns since 1601, as Windows counts them"),
]


def write(folder: Path, times: list[object], name: str = "time") -> Path:
    path = folder / "loop.csv"
    path.write_text(f"{name},PV,OP\n" + "".join(f"{t},{k},{k % 7}\n" for k, t in enumerate(times)), encoding="utf-8")
    return path


@pytest.mark.parametrize(("per_second", "first", "words"), COUNTS)
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_count_is_told_by_the_year_that_it_gives(
    tmp_path: Path, per_second: int, first: int, words: str, kind: str
) -> None:
    times = [(first + 5 * k) * per_second for k in range(100)]
    path = write(tmp_path, [*times])
    if kind == "parquet":
        path = tmp_path / "loop.parquet"
        pq.write_table(pa.table({"time": times, "PV": list(range(100)), "OP": [k % 7 for k in range(100)]}), path)
    record = read_record(path)
    assert (len(record), record.sample_time) == (100, 5.0)
    assert record.epoch + record.start == SINCE_1970
    assert f"column 'time' read as {words}" in record.notes
    assert not any("even grid" in note for note in record.notes)


@pytest.mark.parametrize(("origin", "who"), [(25_569, "spreadsheets"), (719_529, "MATLAB")])
@pytest.mark.parametrize("every", [1, 60, 900, 3600])
def test_days_are_placed_on_the_calendar_however_far_apart(tmp_path: Path, origin: int, who: str, every: int) -> None:
    days = [f"{origin + (SINCE_1970 + every * k) / 86_400:.8f}" for k in range(100)]
    record = read_record(write(tmp_path, [*days]))
    assert (len(record), record.sample_time) == (100, every)
    assert record.epoch + record.start == SINCE_1970
    assert any(f"read as days, as {who} count" in note for note in record.notes)
    assert "first timestamp 2026-03-09 22:50:00" in record.notes


def test_a_short_number_of_seconds_is_no_day(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, [f"{45_000 + 0.0125 * k:.4f}" for k in range(100)]))
    assert (record.sample_time, record.epoch) == (pytest.approx(0.0125, rel=1e-6), 0.0)


@pytest.mark.parametrize(("name", "per_second"), [("epoch", 1), ("unixtime", 1), ("epoch_ms", 1000)])
def test_seconds_since_1970_are_known_by_their_size(tmp_path: Path, name: str, per_second: int) -> None:
    record = read_record(write(tmp_path, [(SINCE_1970 + 5 * k) * per_second for k in range(100)], name))
    assert (record.sample_time, record.start, record.epoch) == (5.0, 0.0, SINCE_1970)
    assert "first timestamp 2026-03-09 22:50:00+00:00" in record.notes


@pytest.mark.parametrize(
    ("form", "every", "said"),
    [
        ("{:%H%M%S}", 1, "clocks in digits, HHMMSS"),
        ("{:%H%M}", 60, "clocks in digits, HHMM"),
        ("1899-12-30 {:%H:%M:%S}", 60, "the day before each clock is none"),
        ("fraction", 60, "fractions of a day"),
    ],
)
def test_a_clock_beside_a_date_is_read_however_it_is_written(tmp_path: Path, form: str, every: int, said: str) -> None:
    rows = []
    for k in range(200):  # over midnight
        at = START + dt.timedelta(minutes=69) + dt.timedelta(seconds=every * k)
        seconds = at.hour * 3600 + at.minute * 60 + at.second
        clock = f"{seconds / 86_400:.8f}" if form == "fraction" else form.format(at)
        rows.append(f"{at:%d.%m.%Y};{clock};{k};{k % 7}")
    path = tmp_path / "loop.csv"
    path.write_text("\n".join(["Date;Time;PV;OP", *rows, "End of report;200 rows;;"]))
    record = read_record(path)
    assert (len(record), record.sample_time, record.epoch) == (200, every, SINCE_1970 + 69 * 60)
    assert any(said in note for note in record.notes)


def test_seconds_beside_a_date_are_no_clock(tmp_path: Path) -> None:
    path = tmp_path / "loop.csv"
    path.write_text("Date;Time;PV;OP\n" + "".join(f"09.03.2026;{k};{k};{k % 7}\n" for k in range(200)))
    assert (len(read_record(path)), read_record(path).sample_time) == (200, 1.0)


def test_a_clock_in_digits_alone_is_told_by_its_even_steps(tmp_path: Path) -> None:
    clocks = [f"{START + dt.timedelta(minutes=65, seconds=5 * k):%H%M%S}" for k in range(200)]  # over midnight
    record = read_record(write(tmp_path, [str(int(clock)) for clock in clocks]))
    assert (len(record), record.sample_time, record.start) == (200, 5.0, 23 * 3600 + 55 * 60)
    assert "column 'time' read as clocks in digits, HHMMSS, without a date" in record.notes


@pytest.mark.parametrize(("form", "every"), [("%Y%m%d%H%M%S", 5), ("%Y%m%d%H%M", 60)])
def test_twelve_or_fourteen_digits_are_a_date(tmp_path: Path, form: str, every: int) -> None:
    times: list[object] = [(START + dt.timedelta(seconds=every * k)).strftime(form) for k in range(100)]
    record = read_record(write(tmp_path, times))
    assert (len(record), record.sample_time, record.epoch) == (100, float(every), float(SINCE_1970))
    assert any("read as dates in digits, YYYYMMDDhhmm" in note for note in record.notes)
    times[40] = int(str(times[40])[:8] + "2575" + "00" * (every == 5))
    with pytest.raises(RecordError, match=rf"line 42, column 'time': {times[40]} is no date in digits"):
        read_record(write(tmp_path, times))


@pytest.mark.parametrize(
    "times",
    [
        [5 * k * 10**9 for k in range(50)],
        [10**14 + 10**6 * k for k in range(50)],
        [-(10**12) + k for k in range(50)],
    ],
)
def test_a_count_that_gives_no_year_of_ours_is_refused(tmp_path: Path, times: list[object]) -> None:
    with pytest.raises(
        RecordError, match=r"line 2, column 'time': numbers from .* are no times that are known; allowed"
    ):
        read_record(write(tmp_path, times))


def test_a_unit_in_the_name_goes_before_the_size(tmp_path: Path) -> None:
    for name, per_second in (("time_us", 1e6), ("t [ns]", 1e9), ("time [µs]", 1e6), ("time_d", 1 / 86_400)):
        record = read_record(write(tmp_path, [repr(5 * k * per_second) for k in range(100)], name))
        assert record.sample_time == pytest.approx(5.0, rel=1e-9), name
    assert read_record(write(tmp_path, [1e-3 * k for k in range(100)], "time [s]")).sample_time == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("name", "below", "seconds"),
    [
        ("time", "min", 60.0),
        ("time", "[h]", 3600.0),
        ("time", "(ms)", 1e-3),
        ("time", "µs", 1e-6),
        ("time", "Elapsed (min)", 60.0),
        ("time", "s", 1.0),
        ("time [s]", "min", 1.0),  # the header's own goes first
        ("time", "", 1.0),
        ("time", "fortnights", 1.0),  # no known unit
        ("time", "h:min:s", 1.0),  # a format
        ("time", "Time of day", 1.0),
    ],
)
def test_a_row_of_units_says_that_of_time(tmp_path: Path, name: str, below: str, seconds: float) -> None:
    path = write(tmp_path, [5 * k for k in range(100)], name)
    head, _, rows = path.read_text(encoding="utf-8").partition("\n")
    path.write_text(f"{head}\n{below},m3/h,%\n{rows}", encoding="utf-8")
    record = read_record(path)
    assert (len(record), record.sample_time) == (100, pytest.approx(5.0 * seconds, rel=1e-9))
    assert (record.counts["rows"], record.counts["rejected"]) == (100, 0)
    words = f"column 'time' read in units of {seconds:g} s, as the row of units says ({below})"
    assert (words in record.notes) == (seconds != 1.0)
    assert not any("rejected" in note for note in record.notes)
    assert read_series(path, "loop.csv", "PV", None, None).times[1] == pytest.approx(5.0 * seconds, rel=1e-9)


def test_a_row_of_units_may_stand_below_one_of_descriptions_and_no_row_of_data_is_one(tmp_path: Path) -> None:
    path = write(tmp_path, [5 * k for k in range(100)])
    head, _, rows = path.read_text(encoding="utf-8").partition("\n")
    path.write_text(f"{head}\n,Feed,Valve\nmin,m3/h,%\n{rows}", encoding="utf-8")
    record = read_record(path)
    assert (record.sample_time, record.pv[0]) == (300.0, 0.0)
    assert "1 row rejected: no readable time, first in line 2" in record.notes
    path.write_text(f"{head}\n{rows}min,m3/h,%\n", encoding="utf-8")
    record = read_record(path)
    assert (record.sample_time, len(record)) == (5.0, 100)
    assert "1 row rejected: no readable time, first in line 102" in record.notes
    path.write_text(f"{head}\nElapsed (min),bar,V\n{rows}", encoding="utf-8")
    assert read_record(path).sample_time == 300.0
    path.write_text(f"{head}\n-5,Bad,%\n{rows}", encoding="utf-8")
    assert read_record(path).counts["rows"] == 101


def test_days_as_matlab_counts_them(tmp_path: Path) -> None:
    day = 719_529 + SINCE_1970 / 86_400
    record = read_record(write(tmp_path, [f"{day + 5 * k / 86_400:.9f}" for k in range(100)]))
    assert (len(record), record.sample_time) == (100, pytest.approx(5.0, rel=1e-4))
    assert "column 'time' read as days, as MATLAB counts them" in record.notes


def test_what_may_be_seconds_or_fractions_of_a_day_is_refused(tmp_path: Path) -> None:
    times: list[object] = [f"{0.2 + 5 * k / 86_400:.9f}" for k in range(100)]
    with pytest.raises(
        RecordError, match=r"line 2, column 'time': numbers from 0.2 to .* seconds, or fractions of a day"
    ):
        read_record(write(tmp_path, times))


def test_rows_of_one_time_do_not_hide_that_numbers_are_days(tmp_path: Path) -> None:
    path = tmp_path / "tall.csv"
    rows = [
        f"{tag},{45291.5 + 5 * k / 86400:.8f},{k % by}"
        for k in range(100)
        for tag, by in (("F.PV", 7), ("F.OP", 5), ("F.SP", 3))
    ]
    path.write_text("tag,time,value\n" + "\n".join(rows) + "\n", encoding="utf-8")
    assert read_record(path).sample_time == pytest.approx(5.0, rel=1e-4)


def test_a_profile_reads_its_times_by_the_same_law(tmp_path: Path) -> None:
    path = write(tmp_path, [(SINCE_1970 + 5 * k) * 10**6 for k in range(50)])
    assert read_series(path, "loop.csv", "PV", None, None).times == tuple(5.0 * k for k in range(50))


@settings(deadline=None)
@given(st.floats(1e11, 1e19), st.floats(1e-9, 10.0))
def test_no_number_is_read_as_two_counts(first: float, share: float) -> None:
    """Whatever the size, what is read lies in the years that are allowed, or dates in digits come out, or a refusal."""
    values = first + first * share * 1e-6 * np.arange(10.0)
    found = counted(values, "time")
    if found.seconds is not None:
        assert found.seconds.min() >= dt.datetime(1991, 1, 1, tzinfo=dt.UTC).timestamp()
        assert found.seconds.max() <= dt.datetime(2100, 1, 1, tzinfo=dt.UTC).timestamp()
        assert found.note
    else:
        assert bool(found.texts) != bool(found.refusal)
