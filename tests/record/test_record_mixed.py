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
