"""Times of day without a date: what a spreadsheet leaves of a time stamp."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import workbench as wb
from workbench.record.clock import of_the_day

BEGIN = datetime(2024, 3, 4, 23, 50)  # noqa: DTZ001 - a clock on a wall
TIMES = [BEGIN + timedelta(seconds=5 * k) for k in range(300)]


@pytest.mark.parametrize(
    ("spelled", "first", "said"),
    [
        (lambda t: f"{t:%H:%M:%S}", 85800.0, "midnight"),
        (lambda t: f"{t:%H:%M:%S}.000", 85800.0, "midnight"),
        (lambda t: f"{t:%I:%M:%S %p}", 85800.0, "midnight"),
        (lambda t: f"{(t - BEGIN).days} days {t:%H:%M:%S}", 85800.0, "midnight"),
        (lambda t: f"{t:%M:%S}.0", 3000.0, "hour"),
    ],
    ids=["clock", "fractions", "half days", "days", "no hours"],
)
def test_they_run_on_over_midnight_and_over_the_hour(tmp_path: Path, spelled, first: float, said: str) -> None:
    path = tmp_path / "loop.csv"
    pv, op = np.sin(np.arange(300) / 9.0), np.cos(np.arange(300) / 9.0)
    rows = [f"{spelled(t)},{a:.4f},{b:.4f}" for t, a, b in zip(TIMES, pv, op, strict=True)]
    path.write_text("Time,PV,OP\n" + "\n".join(rows) + "\n")
    record = wb.read_record(path)
    assert len(record) == 300
    assert record.sample_time == 5.0
    assert record.start == first
    assert record.epoch == 0.0
    assert any(said in note for note in record.notes)
    path.write_text("Time,PV,OP\n" + "\n".join(reversed(rows)) + "\n")
    turned = wb.read_record(path)
    assert turned.sample_time == 5.0
    assert turned.pv.tolist() == record.pv.tolist()


def test_what_no_clock_shows_is_no_time() -> None:
    found = of_the_day(["10:00:00", "10:00:60", "25:00:00", "13:00:00 PM", "10:00:05", "10:00:10", ""])
    assert found is not None
    np.testing.assert_array_equal(found[0], [36000.0, np.nan, np.nan, np.nan, 36005.0, 36010.0, np.nan])
    assert of_the_day(["10:00", "10:05"]) is None
    assert of_the_day(["2024-01-05 10:00:00", "2024-01-05 10:00:05"]) is None
    assert of_the_day([]) is None


@pytest.mark.parametrize("form", ["{0}:{1:02d}:00", "{2} days {3:02d}:{1:02d}:00", "{2} day, {3}:{1:02d}:00"])
def test_times_from_a_start_on_go_beyond_a_day(form: str) -> None:
    """They ended after 24 hours."""
    cells = [form.format(m // 60, m % 60, m // 1440, m // 60 % 24) for m in range(0, 3000, 7)]
    found = of_the_day(cells)
    assert found is not None
    np.testing.assert_array_equal(found[0], 60.0 * np.arange(0, 3000, 7))
