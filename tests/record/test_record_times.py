"""Times as clocks and historians write them: changed clocks, order, repeats, uneven spacing, gaps."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workbench.errors import RecordError
from workbench.record.historian import tags_of
from workbench.record.reader import read_record
from workbench.record.times import in_order

BERLIN = ZoneInfo("Europe/Berlin")


def write(folder: Path, times: list[object], header: str = "time,PV,OP") -> Path:
    """PV is the row's number, so that a record tells which rows it holds."""
    path = folder / "loop.csv"
    path.write_text(header + "\n" + "".join(f"{t},{k},{k % 7}\n" for k, t in enumerate(times)), encoding="utf-8")
    return path


def local(start: dt.datetime, many: int, every: int, form: str = "%Y-%m-%d %H:%M:%S") -> list[object]:
    """Clock times in Berlin of samples that are even in truth."""
    return [(start + dt.timedelta(seconds=every * k)).astimezone(BERLIN).strftime(form) for k in range(many)]


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (dt.datetime(2024, 10, 26, 23, 30, tzinfo=dt.UTC), "the clock goes back an hour"),
        (dt.datetime(2024, 3, 31, 0, 30, tzinfo=dt.UTC), "the clock goes forward an hour"),
    ],
)
def test_a_clock_without_zone_runs_on_through_daylight_saving(tmp_path: Path, start: dt.datetime, words: str) -> None:
    record = read_record(write(tmp_path, local(start, 600, 10)))
    assert len(record) == 600
    assert record.sample_time == 10.0
    assert sum(words in note for note in record.notes) == 1
    assert record.start == 0.0
    first = local(start, 1, 10)[0]
    assert f"first timestamp {first}" in record.notes
    assert record.epoch == dt.datetime.fromisoformat(f"{first}+00:00").timestamp()


FALL, SPRING = dt.datetime(2024, 10, 26, 18, 0, tzinfo=dt.UTC), dt.datetime(2024, 3, 30, 18, 0, tzinfo=dt.UTC)


@pytest.mark.parametrize("minutes", [6, 10, 15, 20])
@pytest.mark.parametrize(("start", "words"), [(FALL, "back"), (SPRING, "forward")])
@pytest.mark.parametrize("turned", [False, True])
def test_coarse_sampling_runs_on_through_daylight_saving(
    tmp_path: Path, minutes: int, start: dt.datetime, words: str, turned: bool
) -> None:
    times = local(start, 120, 60 * minutes)
    record = read_record(write(tmp_path, times[::-1] if turned else times))
    assert record.pv.tolist() == list(range(120))[:: -1 if turned else 1]
    assert (record.sample_time, record.rest) == (60.0 * minutes, ())
    assert any(f"the clock goes {words} an hour" in note for note in record.notes)


@pytest.mark.parametrize(
    ("day", "missing"),
    [
        ("2024-03-30", range(8, 12)),  # not the night of a Sunday
        ("2024-06-02", range(8, 12)),  # no season for it
        ("2024-03-31", range(7, 11)),  # from 01:45 on, at which no clock is changed
        ("2024-03-31", range(8, 13)),  # an hour and a quarter
    ],
)
def test_rows_missing_of_a_coarse_record_are_a_gap(tmp_path: Path, day: str, missing: range) -> None:
    start = dt.datetime.fromisoformat(day)
    times: list[object] = [start + dt.timedelta(minutes=15 * k) for k in range(80) if k not in missing]
    record = read_record(write(tmp_path, times))
    assert record.counts["gaps"] == 1
    assert not any("clock" in note for note in record.notes)


def test_an_hour_missing_on_every_sunday_is_a_gap(tmp_path: Path) -> None:
    start = dt.datetime(2024, 3, 23)  # noqa: DTZ001 - a clock on a wall
    times: list[object] = [start + dt.timedelta(minutes=5 * k) for k in range(3000) if k % 2016 not in range(312, 324)]
    record = read_record(write(tmp_path, times))
    assert record.counts["gaps"] == 2
    assert not any("clock" in note for note in record.notes)


@pytest.mark.parametrize("every", [1, 60])
def test_rows_missing_as_the_clock_goes_back_are_a_gap(tmp_path: Path, every: int) -> None:
    """The times tell how many: the silence holds 3 o'clock, when the clock showed 2."""
    times = local(dt.datetime(2024, 10, 26, 23, 30, tzinfo=dt.UTC), 9000 // every, every)
    at = 5400 // every
    times[at - 6 : at + 900 // every] = []
    record = read_record(write(tmp_path, times))
    assert record.counts["gaps"] == 1
    assert record.segments[0].start == 0.0
    assert record.segments[-1].start == 5400.0 + 900.0
    assert any("the clock goes back an hour" in note for note in record.notes)


@pytest.mark.parametrize(
    ("day", "begin", "silent"),
    [
        (26, 1800, 900),  # a Saturday
        (27, 1000, 700),  # from 00:46:40 to 00:58:20
        (27, 1800, 1900),  # too long to be sure
    ],
)
def test_a_clock_set_back_at_no_change_of_clocks_is_refused(tmp_path: Path, day: int, begin: int, silent: int) -> None:
    start = dt.datetime(2024, 10, day, 0, 30)  # noqa: DTZ001 - a clock on a wall
    times: list[object] = [start + dt.timedelta(seconds=k + (silent - 3600 if k >= begin else 0)) for k in range(6000)]
    with pytest.raises(RecordError, match="times must ascend"):
        read_record(write(tmp_path, times))


def test_a_tall_file_begins_with_the_first_sample_before_the_clock_goes_back(tmp_path: Path) -> None:
    stamps = local(dt.datetime(2024, 10, 27, 0, 30, tzinfo=dt.UTC), 600, 10)
    path = tmp_path / "tall.csv"
    rows = [f"FIC1.{tag},{t},{k % by}\n" for tag, by in (("PV", 7), ("OP", 5)) for k, t in enumerate(stamps)]
    path.write_text("tag,time,value\n" + "".join(rows))
    record = read_record(path)
    assert (record.start, len(record), record.sample_time) == (0.0, 600, 10.0)
    assert "first timestamp 2024-10-27 02:30:00" in record.notes


def test_stamps_with_a_zone_need_no_mending(tmp_path: Path) -> None:
    start = dt.datetime(2024, 10, 26, 23, 30, tzinfo=dt.UTC)
    record = read_record(write(tmp_path, local(start, 600, 10, "%Y-%m-%dT%H:%M:%S%z")))
    assert len(record) == 600
    assert not any("clock" in note for note in record.notes)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_record_keeps_the_zone_of_its_stamps(tmp_path: Path, kind: str) -> None:
    start = dt.datetime(2024, 10, 26, 23, 30, tzinfo=dt.UTC)
    stamps = [(start + dt.timedelta(seconds=10 * k)).astimezone(BERLIN) for k in range(600)]
    path = write(tmp_path, [at.isoformat() for at in stamps])
    if kind == "parquet":
        path = tmp_path / "loop.parquet"
        at = pa.array(stamps, pa.timestamp("us", "Europe/Berlin"))
        pq.write_table(
            pa.table({"time": at, "PV": [float(k) for k in range(600)], "OP": [k % 7 for k in range(600)]}), path
        )
    record = read_record(path)
    turn = dt.datetime(2024, 10, 27, 1, 0, tzinfo=dt.UTC).timestamp()
    assert record.zone == ((start.timestamp(), 7200.0), (turn, 3600.0))
    late = dt.datetime(2024, 10, 27, 2, 5, tzinfo=dt.UTC)
    shown = late.astimezone(BERLIN).replace(tzinfo=dt.UTC).timestamp()
    assert record.instant(shown) == late.timestamp()


def test_stamps_without_a_zone_and_counts_have_the_clock_that_they_show(tmp_path: Path) -> None:
    assert read_record(write(tmp_path, local(dt.datetime(2024, 7, 1, tzinfo=dt.UTC), 60, 10))).zone == ()
    assert read_record(write(tmp_path, list(range(60)))).zone == ()
    assert read_record(write(tmp_path, list(range(1_720_000_000, 1_720_000_060)))).zone == ((1_720_000_000.0, 0.0),)


def test_an_hour_missing_on_a_weekday_is_a_gap(tmp_path: Path) -> None:
    start = dt.datetime(2024, 3, 27, 0, 30)  # noqa: DTZ001 - a clock on a wall
    times: list[object] = [start + dt.timedelta(seconds=10 * k + (3600 if k >= 200 else 0)) for k in range(600)]
    record = read_record(write(tmp_path, times))
    assert (len(record), record.counts["gaps"]) == (400, 1)
    assert [len(part) for part in record.segments] == [200, 400]


def test_a_clock_set_back_by_anything_else_is_refused(tmp_path: Path) -> None:
    start = dt.datetime(2024, 10, 27, 0, 30)  # noqa: DTZ001
    times: list[object] = [start + dt.timedelta(seconds=10 * k - (1800 if k >= 300 else 0)) for k in range(600)]
    with pytest.raises(RecordError, match="line 302, column 'time': 1790 s before line 301; times must ascend"):
        read_record(write(tmp_path, times))


def test_newest_first_is_turned_round(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, [10 * (59 - k) for k in range(60)]))
    assert record.pv.tolist() == [59.0 - k for k in range(60)]
    assert any("turned round" in note for note in record.notes)


@pytest.mark.parametrize(
    "start", [dt.datetime(2024, 10, 26, 23, 30, tzinfo=dt.UTC), dt.datetime(2024, 3, 31, 0, 30, tzinfo=dt.UTC)]
)
def test_newest_first_is_turned_round_where_the_clock_was_changed_too(tmp_path: Path, start: dt.datetime) -> None:
    record = read_record(write(tmp_path, local(start, 600, 10)[::-1]))
    assert record.pv.tolist() == [599.0 - k for k in range(600)]
    assert any("turned round" in note for note in record.notes)
    assert any("the clock goes" in note for note in record.notes)
    broken = local(start, 600, 10)[::-1]
    broken[100], broken[101] = broken[101], broken[100]
    with pytest.raises(RecordError, match="times must ascend"):
        read_record(write(tmp_path, broken))


def test_a_repeated_time_keeps_the_last_row(tmp_path: Path) -> None:
    path = tmp_path / "loop.csv"
    rows = [f"{k},{k},{k % 5}\n" for k in range(50)]
    rows.insert(21, "20,-1,3\n")
    path.write_text("t,PV,OP\n" + "".join(rows))
    record = read_record(path)
    assert record.pv[20] == -1.0
    assert (len(record), record.counts["repeated"]) == (50, 1)
    assert any("1 row of a time that occurs again left out, with other values: the last row" in n for n in record.notes)
    assert any(note.endswith("with other values: the last row of a time is kept") for note in record.notes)
    path.write_text("t,PV,OP\n" + "".join(reversed(rows)))
    turned = read_record(path)
    assert turned.pv[20] == -1.0
    assert any(note.endswith("with other values: the first row of a time is kept") for note in turned.notes)
    rows[21] = rows[20]
    path.write_text("t,PV,OP\n" + "".join(rows))
    assert any(note.endswith("left out, with the same values") for note in read_record(path).notes)


def overlapping(folder: Path, rows: list[str], change: tuple[str, str] = ("", "")) -> Path:
    """Two exports in one file, header and all, of which the second begins 40 rows before the first ends."""
    path, (old, new) = folder / "loop.csv", change
    again = [row.replace(old, new) if old else row for row in rows[160:200]]
    header = "time,SP,PV,OP,MODE"
    path.write_text("\n".join([header, *rows[:200], header, *again, *rows[200:]]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("stamped", [False, True])
def test_rows_of_two_exports_that_overlap_count_once(tmp_path: Path, stamped: bool) -> None:
    """On a clock on a wall too, where the second begins an hour before the first ends."""
    start = dt.datetime(2024, 3, 12)  # noqa: DTZ001 - a clock on a wall
    times = [start + dt.timedelta(seconds=90 * k) if stamped else 90 * k for k in range(300)]
    rows = [f"{t},5,{'Bad' if k == 180 else k % 11},{k % 7},AUTO" for k, t in enumerate(times)]
    record = read_record(overlapping(tmp_path, rows))
    assert record.pv.tolist() == [k % 11 for k in range(300)]
    assert (record.sample_time, record.counts["repeated"], record.counts["gaps"]) == (90.0, 40, 0)
    assert "40 rows that were exported before are left out, with the same times and values" in record.notes
    assert not any("clock" in note for note in record.notes)


def test_rows_of_two_exports_that_overlap_in_every_tag_count_once(tmp_path: Path) -> None:
    rows = [f"F1.{tag},{k},{k % by}" for k in range(300) for tag, by in (("PV", 11), ("OP", 7))]
    path = tmp_path / "tall.csv"
    path.write_text("\n".join(["tag,time,value", *rows[:400], *rows[320:]]))
    record = read_record(path)
    assert record.pv.tolist() == [k % 11 for k in range(300)]
    assert record.counts["repeated"] == 80
    assert any(note.endswith("same times and values (in 2 tags)") for note in record.notes)


@pytest.mark.parametrize("change", [(",5,3,", ",5,4,"), (",5,3,", ",6,3,"), (",AUTO", ",MAN")])
def test_exports_that_overlap_with_other_values_are_refused(tmp_path: Path, change: tuple[str, str]) -> None:
    rows = [f"{k},5,{k % 11},{k % 7},AUTO" for k in range(300)]
    with pytest.raises(RecordError, match=r"line 203, column 'time': 39 s before line 201; times must ascend"):
        read_record(overlapping(tmp_path, rows, change))


def test_an_hour_at_rest_that_a_clock_shows_twice_is_no_second_export(tmp_path: Path) -> None:
    times = local(dt.datetime(2024, 10, 26, 23, 30, tzinfo=dt.UTC), 1500, 10)
    path = tmp_path / "loop.csv"
    path.write_text("time,PV,OP\n" + "".join(f"{t},{max(k - 1400, 0)},5\n" for k, t in enumerate(times)))
    record = read_record(path)
    assert len(record) == 1500
    assert "repeated" not in record.counts


def test_times_cut_to_whole_minutes_are_refused(tmp_path: Path) -> None:
    times: list[object] = [f"2024-10-17 21:{k // 6:02d}" for k in range(120)]
    with pytest.raises(
        RecordError, match=r"the same time as line 2 with other values.*cut to whole seconds or minutes"
    ):
        read_record(write(tmp_path, times))


@pytest.mark.parametrize(
    ("day", "month"),
    [
        *(("17-Okt-24 {}", 10), ("17-Dez-2024 {}", 12), ("17. März 2024 {}", 3), ("17. Mai 2024 {}", 5)),
        *(("17-mars-24 {}", 3), ("17 août 2024 {}", 8), ("17.10.2024 {} Uhr", 10), ("Thu 17 Oct 2024 {}", 10)),
        *(("Thursday 17 Oct 2024 {}", 10), ("{} 17/10/2024", 10), ("{} 2024-10-17", 10)),
    ],
)
def test_days_as_other_countries_write_them(tmp_path: Path, day: str, month: int) -> None:
    record = read_record(write(tmp_path, [day.format(f"21:{k // 6:02d}:{10 * (k % 6):02d}") for k in range(100)]))
    assert (len(record), record.sample_time) == (100, 10.0)
    assert dt.datetime.fromtimestamp(record.epoch, dt.UTC).month == month


@pytest.mark.parametrize("half", ["AM", " AM", " am", "a.m.", " a. m."])
def test_the_half_of_the_day_behind_the_clock(tmp_path: Path, half: str) -> None:
    record = read_record(write(tmp_path, [f"10/17/2024 09:{k // 6:02d}:{10 * (k % 6):02d}{half}" for k in range(100)]))
    assert (len(record), record.sample_time) == (100, 10.0)


@pytest.mark.parametrize("name", ["Millitm", "ms"])
def test_milliseconds_in_a_column_of_their_own_are_added(tmp_path: Path, name: str) -> None:
    """As FactoryTalk logs: every quarter of a second, four rows had one time, and were refused."""
    path = tmp_path / "loop.csv"
    rows = "".join(f"10/17/2024;21:00:{k // 4:02d};{250 * (k % 4):3d}; ;{k};{k % 7 + 20}\n" for k in range(200))
    path.write_text(f"Date;Time;{name};Marker;PV;OP\n{rows}")
    record = read_record(path)
    assert (record.sample_time, record.pv.tolist()) == (0.25, list(range(200)))
    path.write_text(
        f"Date;Time;{name};PV;OP\n" + "".join(f"10/17/2024;21:{k:02d}:00;{k}.5;{k};{k % 7}\n" for k in range(60))
    )
    assert read_record(path).sample_time == 60.0


CALENDAR = "Year,Month,Day,Hour,Minute,Second,PV,OP"


def calendar(stamps: list[dt.datetime], many: int = 6, cell: str = "{}") -> list[object]:
    return [",".join(cell.format(part) for part in stamp.timetuple()[:many]) for stamp in stamps]


def every(seconds: float, many: int = 200) -> list[dt.datetime]:
    start = dt.datetime(2024, 10, 31, 23, 55, tzinfo=dt.UTC)
    return [start + dt.timedelta(seconds=seconds * k) for k in range(many)]


@pytest.mark.parametrize("header", [CALENDAR, "years,months,days,hours,minutes,seconds,PV,OP", f"Date,{CALENDAR}"])
@pytest.mark.parametrize("cell", ["{}", "{:02d}", "{:.7e}"])
def test_a_time_in_six_columns_is_one(tmp_path: Path, header: str, cell: str) -> None:
    times = calendar(every(10.0), cell=cell)
    path = write(tmp_path, [f"31.10.2024,{time}" for time in times] if "Date" in header else times, header)
    record = read_record(path)
    assert (record.sample_time, len(record), record.counts["rejected"]) == (10.0, 200, 0)
    assert record.epoch == every(10.0)[0].timestamp()
    said = "the times are put together of year, month, day, hour, minute, second in columns of their own"
    assert record.notes[:2] == (said, "first timestamp 2024-10-31 23:55:00")


def test_a_time_in_columns_may_have_no_seconds_or_parts_of_them(tmp_path: Path) -> None:
    whole = write(tmp_path, calendar(every(60.0), 5), "Year,Month,Day,Hour,Minute,PV,OP")
    assert read_record(whole).sample_time == 60.0
    parts = [f"{time},{500 * (k % 2)}" for k, time in enumerate(calendar(every(0.5)))]
    assert read_record(write(tmp_path, parts, "Year,Month,Day,Hour,Minute,Second,ms,PV,OP")).sample_time == 0.5
    halves = [f"{time}.{5 * (k % 2)}" for k, time in enumerate(calendar(every(0.5)))]
    assert read_record(write(tmp_path, halves, CALENDAR)).sample_time == 0.5
    cut = write(tmp_path, calendar(every(10.0), 5), "Year,Month,Day,Hour,Minute,PV,OP")
    with pytest.raises(RecordError, match="line 3, column 'Year': the same time as line 2 with other values"):
        read_record(cut)


@pytest.mark.parametrize("many", [5, 6])
def test_a_tall_file_may_have_its_times_in_columns(tmp_path: Path, many: int) -> None:
    path, header = tmp_path / "tall.csv", ",".join(CALENDAR.split(",")[:many])
    times = calendar(every(60.0 if many == 5 else 1.0), many)
    rows = [f"FIC1.{tag},{time},{n * k % 13}" for tag, n in (("PV", 7), ("OP", 5)) for k, time in enumerate(times)]
    path.write_text("\n".join([f"Tag,{header},Value", *rows]))
    record = read_record(path)
    assert (record.sample_time, len(record)) == (60.0 if many == 5 else 1.0, 200)


def test_parquet_may_have_its_times_in_columns(tmp_path: Path) -> None:
    parts = ("year", "month", "day", "hour", "minute", "second")
    columns = {part: [getattr(stamp, part) for stamp in every(1.0)] for part in parts}
    values = {"PV": [7.0 * k % 13 for k in range(200)], "OP": [5.0 * k % 13 for k in range(200)]}
    path = tmp_path / "loop.parquet"
    pq.write_table(pa.table(columns | values), path)
    record = read_record(path)
    assert (record.sample_time, len(record), record.epoch) == (1.0, 200, every(1.0)[0].timestamp())
    pq.write_table(pa.table(columns | {"tag": ["FIC1.PV"] * 200, "value": values["PV"]}), path)
    with pytest.raises(RecordError, match=r"times in columns of year, month ...; a tall data set needs one column"):
        tags_of(path)


def test_a_time_in_columns_is_not_guessed(tmp_path: Path) -> None:
    short = write(tmp_path, [str(time)[2:] for time in calendar(every(10.0))], CALENDAR)
    with pytest.raises(RecordError, match="line 2, column 'Year': '24 10 31 23 55 0' is no time that can be read"):
        read_record(short)
    rows = calendar(every(10.0))
    rows[40] = str(rows[40]).replace("2024,11,1", "2024,11,31")
    record = read_record(write(tmp_path, rows, CALENDAR))
    assert record.counts["rejected, no readable time"] == 1
    # A column of whole timestamps, or what the user says, goes before.
    both = [f"{stamp:%Y-%m-%d %H:%M:%S},{time}" for stamp, time in zip(every(10.0), rows, strict=True)]
    path = write(tmp_path, both, f"Timestamp,{CALENDAR}")
    assert read_record(path).counts["rejected"] == 0
    assert read_record(path, columns={"time": "Timestamp"}).notes[0] == "first timestamp 2024-10-31 23:55:00"


def test_a_clock_with_points_is_read(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, [f"17.10.2024 21.{k // 6:02d}.{10 * (k % 6):02d}" for k in range(100)]))
    assert (len(record), record.sample_time) == (100, 10.0)


@pytest.mark.parametrize("tall", [False, True])
@pytest.mark.parametrize(
    ("form", "midnight"),
    [
        ("%d.%m.%Y %H:%M:%S", "16.10.2024 24:00:00"),
        ("%Y-%m-%d %H:%M:%S", "2024-10-16 24:00:00"),
        ("%Y-%m-%dT%H:%M:%S.000", "2024-10-16T24:00:00.000"),
        ("%d.%m.%Y %H:%M:%S", "17.10.2024"),
        ("%m/%d/%Y %I:%M:%S %p", "10/17/2024"),
        ("%Y-%m-%d %H:%M:%S", "2024-10-17"),
    ],
)
def test_midnight_is_a_time_however_it_is_written(tmp_path: Path, form: str, midnight: str, tall: bool) -> None:
    stamps = [dt.datetime(2024, 10, 16, 23, 59, tzinfo=dt.UTC) + dt.timedelta(seconds=2 * k) for k in range(60)]
    times = [midnight if k == 30 else f"{t:{form}}" for k, t in enumerate(stamps)]
    path = tmp_path / "loop.csv"
    if tall:
        rows = "".join(f"F1.PV,{t},{k}\nF1.OP,{t},{k % 7 + 20}\n" for k, t in enumerate(times))
        path.write_text(f"tag,time,value\n{rows}")
    else:
        path.write_text("time,PV,OP\n" + "".join(f"{t},{k},{k % 7 + 20}\n" for k, t in enumerate(times)))
    record = read_record(path)
    assert (record.sample_time, record.pv.tolist()) == (2.0, list(range(60)))
    assert not any("missing" in note or "no readable time" in note for note in record.notes)


def test_a_day_below_the_times_is_no_midnight(tmp_path: Path) -> None:
    path = tmp_path / "loop.csv"
    path.write_text(
        "time,PV,OP\n" + "".join(f"17.10.2024 12:00:{k:02d},{k},{k % 7}\n" for k in range(60)) + "17.10.2024,59,3\n"
    )
    assert read_record(path).pv.tolist() == list(range(60))


def test_days_as_spreadsheets_count_them(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, [f"{45291.5 + 5 * k / 86400:.8f}" for k in range(100)], "Timestamp,PV,OP"))
    assert (len(record), record.sample_time) == (100, pytest.approx(5.0, rel=1e-4))
    assert any("as spreadsheets count them" in note for note in record.notes)


@pytest.mark.parametrize(
    ("form", "start", "day"),
    [
        ("%m/%d/%Y %I:%M:%S %p", dt.datetime(2021, 5, 11, 23, 50), "over midnight"),  # noqa: DTZ001 - a clock on a wall
        ("%d/%m/%Y %I:%M:%S %p", dt.datetime(2021, 5, 11, 23, 50), "over midnight"),  # noqa: DTZ001
        ("%m/%d/%Y %H:%M:%S", dt.datetime(2021, 5, 11, 23, 50), "over midnight"),  # noqa: DTZ001
        ("%d/%m/%Y %H:%M", dt.datetime(2021, 5, 11, 22, 0), "over midnight"),  # noqa: DTZ001
        ("%m/%d/%Y %I:%M %p", dt.datetime(2021, 5, 11, 22, 0), "over midnight"),  # noqa: DTZ001
        ("%m/%d/%Y %I:%M:%S %p", dt.datetime(2021, 5, 12, 23, 50), "day beyond 12"),  # noqa: DTZ001
        ("%d/%m/%Y %I:%M:%S %p", dt.datetime(2021, 5, 13, 3, 50), "day beyond 12"),  # noqa: DTZ001
        ("%m/%d/%Y %I:%M:%S %p", dt.datetime(2021, 5, 11, 3, 50), "either"),  # noqa: DTZ001
        ("%d/%m/%Y %H:%M:%S", dt.datetime(2021, 5, 11, 3, 50), "either"),  # noqa: DTZ001
    ],
)
@pytest.mark.parametrize("uneven", [False, True])
def test_of_day_and_month_the_reading_without_leaps_counts(
    tmp_path: Path, form: str, start: dt.datetime, day: str, uneven: bool
) -> None:
    step = 60 if ":%S" not in form else 5
    at = [start + dt.timedelta(seconds=step * (2 * k + k % 2 if uneven else k)) for k in range(600)]
    record = read_record(write(tmp_path, [one.strftime(form) for one in at]))
    assert record.rest == ()
    assert record.counts["gaps"] == 0
    assert record.epoch == (at[0] - dt.datetime(1970, 1, 1)).total_seconds()  # noqa: DTZ001
    said = next(note for note in record.notes if note.startswith("timestamps read as"))
    assert said.startswith(f"timestamps read as {form}")
    assert ("would run as evenly" in said) == (day == "either")


@pytest.mark.parametrize(
    ("form", "zone"),
    [
        ("%m/%d/%y %I:%M:%S %p", ""),
        ("%m/%d/%y %H:%M:%S", ""),
        ("%d/%m/%y %H:%M:%S", ""),
        ("%d-%b-%Y %I:%M:%S.%f %p", ""),
        ("%b %d %Y %I:%M:%S %p", ""),
        ("%d.%m.%Y %H:%M:%S,%f", ""),
        ("%m/%d/%Y %I:%M:%S p.m.", ""),
        ("%d.%m.%Y %H:%M:%S,%f", " UTC"),
        ("%Y-%m-%dT%H:%M:%S", " UTC"),
        ("%Y-%m-%d %H:%M:%S", " CET"),
        ("%d-%b-%Y %I:%M:%S.%f %p", " EST"),
        ("%d.%m.%Y %H:%M:%S", "Z"),
    ],
)
def test_spellings_as_plants_have_them(tmp_path: Path, form: str, zone: str) -> None:
    start = dt.datetime(2026, 3, 9, 23, 50) if "p.m." not in form else dt.datetime(2026, 3, 13, 20)  # noqa: DTZ001
    times = [(start + dt.timedelta(seconds=5 * k)).strftime(form) + zone for k in range(600)]
    record = read_record(write(tmp_path, [f'"{time}"' for time in times]))
    assert (len(record), record.sample_time) == (600, 5.0)
    east = {" CET": 3600.0, " EST": -5 * 3600.0}.get(zone, 0.0)
    assert record.epoch == start.replace(tzinfo=dt.UTC).timestamp() - east
    assert f"first timestamp {times[0]}" in record.notes


def test_a_zone_by_name_tells_the_two_hours_apart(tmp_path: Path) -> None:
    start = dt.datetime(2024, 10, 26, 23, 30, tzinfo=dt.UTC)
    record = read_record(write(tmp_path, local(start, 600, 10, "%Y-%m-%d %H:%M:%S %Z")))
    assert (len(record), record.sample_time, record.epoch) == (600, 10.0, start.timestamp())
    assert not any("clock" in note for note in record.notes)


def test_a_name_that_is_no_known_zone_is_no_time(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="line 2, column 'time': '2026-03-09 22:50:00 XYZ' is no time"):
        read_record(write(tmp_path, [f"2026-03-09 22:50:{k:02d} XYZ" for k in range(60)]))


def test_uneven_times_are_resampled_and_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    times = np.round(np.cumsum(rng.uniform(2.0, 9.0, 300)), 3)
    path = tmp_path / "loop.csv"
    path.write_text("t,PV,OP,SP\n" + "".join(f"{t},{3 * t + 1},{k},{k % 2}\n" for k, t in enumerate(times)))
    record = read_record(path, sample_time=5.0)
    assert record.sample_time == 5.0
    assert record.pv == pytest.approx(3.0 * record.time + 1.0)
    before = np.searchsorted(times, record.time, side="right") - 1
    assert record.op.tolist() == before.tolist()
    assert record.sp is not None
    assert record.sp.tolist() == (before % 2).tolist()
    assert record.rest == ()
    assert any(note.startswith("resampled, as the times are not even: every 5 s") for note in record.notes)
    usual = read_record(path)
    assert usual.sample_time == pytest.approx(float(np.median(np.diff(times))), rel=1e-3)


def test_rows_that_hold_only_what_changed_are_filled(tmp_path: Path) -> None:
    path = tmp_path / "loop.csv"
    rows = [f"{k},{k if k % 2 == 0 else ''},{'' if k % 5 else k}\n" for k in range(101)]
    path.write_text("t,PV,OP\n" + "".join(rows))
    record = read_record(path, sample_time=1.0)
    assert record.pv.tolist() == [float(k) for k in range(101)]
    assert record.op.tolist() == [float(5 * (k // 5)) for k in range(101)]
    assert "rejected, blank" not in record.counts
    assert any("most rows hold only what changed" in note for note in record.notes)


def test_gaps_are_bridged_only_up_to_max_gap(tmp_path: Path) -> None:
    times = [10 * k for k in range(300) if k not in (50, 51) and not 150 <= k < 170]
    path = tmp_path / "loop.csv"
    path.write_text("t,PV,OP\n" + "".join(f"{t},{'x' if t in (2500, 2510) else t},{t + 1}\n" for t in times))
    parted = read_record(path)
    assert [len(part) for part in parted.segments] == [50, 98, 80, 48]
    assert (parted.counts["gaps"], parted.counts["rejected, text"]) == (2, 2)
    bridged = read_record(path, max_gap=60.0)
    assert [len(part) for part in bridged.segments] == [150, 130]
    first = bridged.segments[0]
    assert first.pv.tolist() == first.time.tolist()
    assert first.op[49:53].tolist() == [491.0, 491.0, 491.0, 521.0]
    assert any("resampled, as gaps are to be bridged" in note for note in bridged.notes)
    assert "2 rows rejected: text ('x'), first in line 230, column 'PV'" in bridged.notes


def test_a_sample_time_far_below_the_recorded_interval_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, [k**1.5 for k in range(100)])
    with pytest.raises(RecordError, match=r"sample_time 0.01 s is too short: values are recorded every 10.\d+ s"):
        read_record(path, sample_time=0.01)
    path = write(tmp_path, [*range(50), *(10**9 + k**1.01 for k in range(50))])
    with pytest.raises(RecordError, match="at most 20,000,000 are made; give a longer sample_time, or a shorter max_"):
        read_record(path, max_gap=1e12)


CALM = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]  # a busy machine is no defect
quiet = settings(max_examples=100, deadline=None, suppress_health_check=CALM)


@quiet
@given(
    times=st.lists(
        st.one_of(st.integers(-50, 50).map(float), st.floats(allow_nan=True, allow_infinity=True)), max_size=30
    ),
    wall=st.booleans(),
)
def test_times_come_out_ascending_or_are_refused(times: list[float], wall: bool) -> None:
    seconds = np.array([t if abs(t) < 1e100 else np.nan for t in times], dtype=np.float64)
    values = np.arange(seconds.size) % 2
    order = in_order(seconds, np.zeros(seconds.size, dtype=bool), wall, lambda a, b: values[a] == values[b])
    if not order.refusal:
        assert (np.diff(order.seconds) > 0.0).all()
        assert order.rows.size + order.repeated == np.count_nonzero(np.isfinite(seconds))
        assert order.notes or order.seconds.tolist() == seconds[order.rows].tolist()
    else:
        assert "{before}" in order.refusal


@quiet
@given(
    steps=st.lists(st.floats(0.5, 2.0), min_size=40, max_size=120), Ts=st.floats(0.3, 4.0), shift=st.floats(-1e6, 1e6)
)
def test_resampling_a_straight_line_gives_the_line(tmp_path: Path, steps: list[float], Ts: float, shift: float) -> None:
    times = shift + np.concatenate(([0.0], np.cumsum(steps)))
    path = tmp_path / "loop.csv"
    path.write_text("t,PV,OP\n" + "".join(f"{t!r},{0.5 * (t - shift)!r},{k}\n" for k, t in enumerate(times.tolist())))
    try:
        record = read_record(path, sample_time=Ts)
    except RecordError as refusal:
        # Nearly even times are taken as they are, and then the sample time must be theirs.
        assert "sample_time" in str(refusal)  # noqa: PT017
        return
    if record.counts.get("resampled"):
        assert record.pv == pytest.approx(0.5 * (record.time - shift), abs=1e-8)
        assert record.start >= times[0] - 1e-9 * abs(shift)


def test_rows_stamped_early_and_late_are_taken_as_they_are(tmp_path: Path) -> None:
    """Resampled at their median interval such rows would slip against the grid, and OP be held a row late."""
    rng = np.random.default_rng(3)
    times = 1e5 + 10.0 * (np.arange(400) + rng.uniform(-0.24, 0.24, 400))
    record = read_record(write(tmp_path, [f"{t:.3f}" for t in times]))
    assert record.pv.tolist() == list(range(400))
    assert record.op.tolist() == [k % 7 for k in range(400)]
    assert record.sample_time == pytest.approx(10.0, rel=2e-3)
    assert any("taken as even" in note for note in record.notes)
    away = read_record(write(tmp_path, [f"{t:.3f}" for t in times + 4.5 * (np.arange(400) % 50 == 7)]))
    assert any("resampled, as the times are not even" in note for note in away.notes)


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_the_place_of_a_single_missing_row_is_filled_and_that_of_two_is_a_gap(tmp_path: Path, jitter: float) -> None:
    rng = np.random.default_rng(4)
    gone = {30, 50, 120, 121, 180}
    rows = [k for k in range(300) if k not in gone]
    text = "t,SP,PV,OP,MODE\n" + "".join(f"{k + jitter * rng.uniform(-1, 1):.6f},{k},{k},{k + 1},AUTO\n" for k in rows)
    path = tmp_path / "loop.csv"
    path.write_text(text, encoding="utf-8")
    record = read_record(path)
    assert [len(part) for part in record.segments] == [120, 178]
    assert (record.counts["gaps"], record.counts["between"]) == (1, 3)
    assert "3 single rows are missing: there PV is linear between its neighbours, and OP held" in record.notes
    for first, part in zip((0, 122), record.segments, strict=True):
        places = np.arange(first, first + len(part))
        assert part.pv == pytest.approx(places)
        held = [k - 1.0 if k in gone else k for k in places.tolist()]
        assert part.op.tolist() == [k + 1 for k in held]
        assert part.sp is not None
        assert part.sp.tolist() == held
        assert part.mode == ("AUTO",) * len(part)


def test_no_place_is_filled_beside_a_bad_value(tmp_path: Path) -> None:
    path = tmp_path / "loop.csv"
    path.write_text("t,PV,OP\n" + "".join(f"{k},{'x' if k == 51 else k},{k + 1}\n" for k in range(100) if k != 50))
    record = read_record(path)
    assert [len(part) for part in record.segments] == [50, 48]
    assert "between" not in record.counts


@pytest.mark.parametrize(
    "form", ["%b %d, %Y, %I:%M:%S %p", "%d/%m/%Y %H:%M:%S:000", "%Y-%m-%dT%H:%M:%S+02:00[Europe/Berlin]"]
)
def test_stamps_as_programs_spell_them(tmp_path: Path, form: str) -> None:
    rows = [
        f"{dt.datetime(2024, 10, 17, 21, 55) + dt.timedelta(seconds=k):{form}};{k};{k % 7}"  # noqa: DTZ001
        for k in range(90)
    ]
    path = tmp_path / "loop.csv"
    path.write_text("\n".join(["time;PV;OP", *rows]), encoding="utf-8")
    record = read_record(path)
    assert (len(record), record.sample_time, record.epoch % 60.0) == (90, 1.0, 0.0)
