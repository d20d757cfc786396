"""Two spellings in one file, of times or of decimal marks: read where they leave no doubt, else refused in one line."""

from __future__ import annotations

import datetime as dt
import re
from pathlib import Path

import pytest

from workbench.errors import RecordError
from workbench.record.reader import read_record


def write(folder: Path, times: list[object]) -> Path:
    path = folder / "loop.csv"
    path.write_text("time,PV,OP\n" + "".join(f"{t},{k},{k % 7}\n" for k, t in enumerate(times)), encoding="utf-8")
    return path


def mixed(form: str, other: str, every: int, many: int = 360) -> list[object]:
    """Times every 5 s in one format, and every so many in another."""
    at = [dt.datetime(2024, 3, 5, 6) + dt.timedelta(seconds=5 * k) for k in range(many)]  # noqa: DTZ001
    return [one.strftime(form if k % every else other) for k, one in enumerate(at)]


ISO = "%Y-%m-%d %H:%M:%S"


@pytest.mark.parametrize("every", [2, 3, 4, 9])
@pytest.mark.parametrize("other", ["%d/%m/%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%m/%d/%Y %I:%M:%S %p", f"{ISO} CET"])
def test_times_in_two_formats_are_refused_with_an_example_of_each(tmp_path: Path, other: str, every: int) -> None:
    times = mixed(ISO, other, every)
    with pytest.raises(RecordError, match=r"times in more than one format|all or none must") as refusal:
        read_record(write(tmp_path, times))
    if "CET" not in other:
        assert f"{times[0]!r} in line 2" in str(refusal.value)
        assert f"{times[1]!r} in line 3" in str(refusal.value)
        assert f"as in {360 // every} of 360 times; write all of them in one format" in str(refusal.value)


@pytest.mark.parametrize("day", ["%d/%m/%Y", "%d.%m.%Y", "%d %b %Y"])
@pytest.mark.parametrize("clocks", [("%H:%M:%S", "%H:%M"), ("%I:%M:%S %p", "%I:%M %p")])
def test_a_clock_that_leaves_out_its_seconds_where_they_are_none_is_read(
    tmp_path: Path, day: str, clocks: tuple[str, str]
) -> None:
    # As spreadsheets show the full minutes, here one time in six.
    at = [dt.datetime(2024, 3, 15, 6) + dt.timedelta(seconds=10 * k) for k in range(360)]  # noqa: DTZ001
    times: list[object] = [one.strftime(f"{day} {clocks[one.second == 0]}") for one in at]
    record = read_record(write(tmp_path, times))
    assert (len(record), record.sample_time, record.counts.get("rejected, time", 0)) == (360, 10.0, 0)


def test_times_as_a_spreadsheet_writes_those_that_it_understands_are_refused(tmp_path: Path) -> None:
    stamps = mixed(ISO, ISO, 1)
    days: list[object] = [f"{45356.25 + 5 * k / 86_400:.8f}" for k in range(360)]
    for least, most in ((stamps, days), (days, stamps)):
        times = [most[k] if k % 3 else least[k] for k in range(360)]
        words = f"'{most[1]}' in line 3, but '{least[0]}' in line 2, as in 120 of 360 times"
        with pytest.raises(RecordError, match=re.escape(words)):
            read_record(write(tmp_path, times))


def test_few_times_in_another_format_are_left_out_and_counted(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, mixed(ISO, "%d.%m.%Y %H:%M:%S", 12)))
    assert (record.sample_time, record.counts["rejected, no readable time"]) == (5.0, 30)


@pytest.mark.parametrize("between", ["time", "# operator: bypass opened", "Total", "########", ""])
def test_what_is_no_time_in_any_format_is_left_out_and_counted(tmp_path: Path, between: str) -> None:
    path = write(tmp_path, mixed(ISO, ISO, 1))
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    text = "\n".join(f"{row}\n{between},PV,OP" if k % 3 == 0 else row for k, row in enumerate(rows))
    path.write_text(f"{head}\n{text}\n", encoding="utf-8")
    record = read_record(path)
    assert (len(record), record.sample_time, record.counts["rejected, no readable time"]) == (360, 5.0, 120)


@pytest.mark.parametrize("tag", ["F.OP", "TIC9"])
def test_in_a_tall_file_only_the_times_of_the_tags_in_use_count(tmp_path: Path, tag: str) -> None:
    times = zip(mixed(ISO, ISO, 1), mixed("%d/%m/%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S", 1), strict=True)
    rows = [
        f"{name},{day if name == tag else iso},{k % by}"
        for k, (iso, day) in enumerate(times)
        for name, by in (("F.PV", 7), ("F.OP", 5), ("TIC9", 3))
    ]
    path = tmp_path / "tall.csv"
    path.write_text("tag,time,value\n" + "\n".join(rows) + "\n", encoding="utf-8")
    if tag == "TIC9":
        assert (len(read_record(path)), read_record(path).sample_time) == (360, 5.0)
        return
    with pytest.raises(
        RecordError, match="'2024-03-05 06:00:00' in line 2, but '05/03/2024 06:00:00' in line 3, as in"
    ):
        read_record(path)


def columns(folder: Path, pv: list[str], op: list[str], sep: str) -> Path:
    path = folder / "loop.csv"
    rows = [sep.join((f"2024-03-05 06:00:{k:02d}", pv[k % len(pv)], op[k % len(op)])) for k in range(60)]
    path.write_text("\n".join([sep.join(("time", "PV", "OP")), *rows]), encoding="utf-8")
    return path


COMMA = ["42,43", "42,5", "41"]
POINT = ["42.43", "42.5", "41"]


@pytest.mark.parametrize(
    ("pv", "op", "sep", "words"),
    [
        (
            ["26.145", "25.951"],
            COMMA,
            ";",
            "commas in column 'OP' ('42,43' in line 2) and points in column 'PV' ('26.145'",
        ),
        (
            ["25", "26.145 %"],
            COMMA,
            "\t",
            "points in column 'PV' ('26.145 %' in line 3): decimal marks, or thousands? ",
        ),
        (
            ["26,145", "25,951"],
            POINT,
            ";",
            "commas in column 'PV' ('26,145' in line 2) and points in column 'OP' ('42.43'",
        ),
        (["26,145", "25,951"], ["42.430", "42.508"], "|", "and points in column 'OP' ('42.430' in line 2)"),
        (["1.026,15", "999,5"], ["42.430", "42.508"], ";", "commas in column 'PV' ('1.026,15' in line 2)"),
        (["26.145", "25.951"], ['"42,43"', '"42,5"'], ",", "commas in column 'OP' ('42,43' in line 2) and points in"),
        (["1.026,15", "1.027"], COMMA, ";", "column 'PV': decimal commas ('1.026,15') and decimal points ('1.027')"),
        (["1,026.15", "1,027"], POINT, ";", "column 'PV': decimal commas ('1,027') and decimal points ('1,026.15')"),
    ],
)
def test_a_mark_that_may_part_thousands_beside_another_is_refused(
    tmp_path: Path, pv: list[str], op: list[str], sep: str, words: str
) -> None:
    with pytest.raises(RecordError, match=re.escape(words)):
        read_record(columns(tmp_path, pv, op, sep))


@pytest.mark.parametrize(
    ("pv", "op", "sep", "first"),
    [
        (["26,145", "25,951"], COMMA, ";", 26.145),
        (["26.145", "25.951"], POINT, ";", 26.145),
        (["26.145", "25.951"], POINT, ",", 26.145),
        (["26", "25"], COMMA, ";", 26.0),
        (["16.1450", "15.9512"], COMMA, ";", 16.145),  # each leaves no doubt
        (["0.125", "26.145"], COMMA, ";", 0.125),
        (["26.145", "25.9"], COMMA, ";", 26.145),
        (["1.026,15", "999,5"], COMMA, ";", 1026.15),
        (["1,026.15", "999.5"], ["42.430", "42.508"], ";", 1026.15),
        (['"1,026,150"', '"998"'], ["42.430", "42.508"], ",", 1026150.0),
        (['"26,145"', '"25,9"'], ['"42,430"', '"42,5"'], ",", 26.145),
    ],
)
def test_marks_that_leave_no_doubt_are_read(
    tmp_path: Path, pv: list[str], op: list[str], sep: str, first: float
) -> None:
    record = read_record(columns(tmp_path, pv, op, sep))
    assert (len(record), record.pv[0], record.counts["rejected"]) == (60, first, 0)


def test_marks_in_columns_that_are_no_numbers_of_the_loop_say_nothing(tmp_path: Path) -> None:
    path = tmp_path / "loop.csv"
    rows = [f"{k}.125;26,{k:02d};42,5;Auto, v1.250;26.145" for k in range(60)]
    path.write_text("\n".join(["time [s];PV;OP;MODE;Other", *rows]), encoding="utf-8")
    record = read_record(path)
    assert (len(record), record.sample_time, record.pv[1]) == (60, 1.0, 26.01)


def test_marks_of_the_tags_of_a_tall_file_leave_no_doubt(tmp_path: Path) -> None:
    path = tmp_path / "tall.csv"
    tags = (("F.PV", "26.145", "25.951"), ("F.OP", "42,43", "42,5"), ("TIC9", "1.125", "26.145"))
    rows = [f"{tag};2024-03-05 06:00:{k:02d};{(a, b)[k % 2]}" for k in range(60) for tag, a, b in tags]
    path.write_text("tag;time;value\n" + "\n".join(rows), encoding="utf-8")
    words = "commas in tag 'F.OP' ('42,43' in line 3) and points in tag 'F.PV' ('26.145' in line 2)"
    with pytest.raises(RecordError, match=re.escape(words)):
        read_record(path)
    path.write_text(
        path.read_text(encoding="utf-8").replace("V;2024-03-05 06:00:00;26.145", "V;2024-03-05 06:00:00;26.1")
    )
    assert read_record(path).pv[0] == 26.1


def test_points_that_stand_twice_part_thousands_throughout_their_column(tmp_path: Path) -> None:
    pv = [f"{999_870 + 10 * k:,}".replace(",", ".") for k in range(60)]
    record = read_record(columns(tmp_path, pv, [f"{40 + k % 7},5" for k in range(60)], ";"))
    assert record.pv.tolist() == [999_870.0 + 10.0 * k for k in range(60)]
    assert record.counts.get("rejected, text", 0) == 0
