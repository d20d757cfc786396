"""Stamps rounded about as coarsely as samples are apart: the even clock that explains them, and what is none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from workbench.errors import RecordError
from workbench.record.reader import read_record
from workbench.record.resolution import coarse_clock

UNITS = {"s": 1.0, "s, one decimal": 0.1, "min": 0.6, "h": 0.36, "days": 0.864, "days, four decimals": 8.64}


def write(folder: Path, header: str, times: Sequence[str], values: Sequence[object] | None = None) -> Path:
    path = folder / "loop.csv"
    rows = (f"{t},{v},{k % 7 + 0.5}\n" for k, (t, v) in enumerate(zip(times, values or range(len(times)), strict=True)))
    path.write_text(f"{header},PV,OP\n" + "".join(rows), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "times", "Ts"),
    [
        ("Timestamp", [f"{45291.5 + k / 86400:.5f}" for k in range(900)], 1.0),
        ("Timestamp", [f"{45291.5 + 10 * k / 86400:.4f}" for k in range(900)], 10.0),
        ("time [min]", [f"{0.61 / 60 * k:.2f}" for k in range(900)], 0.61),
        ("time [h]", [f"{0.4 / 3600 * k:.4f}" for k in range(900)], 0.4),
        ("Timestamp", [f"2024-10-17 21:{k // 120:02d}:{k // 2 % 60:02d}" for k in range(900)], 0.5),
        ("Timestamp", [f"2024-10-17 21:{k * 4 // 300:02d}:{k * 4 // 5 % 60:02d}" for k in range(900)], 0.8),
        ("t", [f"{np.floor(1.05 * k):.0f}" for k in range(900)], 1.05),
        ("t", [f"{np.floor(1.05 * k):.0f}" for k in range(900)][::-1], 1.05),
    ],
)
def test_the_sample_time_is_that_of_the_clock_that_explains_all_stamps(
    tmp_path: Path, header: str, times: list[str], Ts: float
) -> None:
    record = read_record(write(tmp_path, header, times))
    assert record.sample_time == pytest.approx(Ts, rel=1e-9)
    assert sorted(record.pv.tolist()) == list(range(900))
    assert any(f"the even clock, of {Ts:g} s" in note for note in record.notes)
    assert "repeated" not in record.counts


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    unit=st.sampled_from(list(UNITS.values())),
    ratio=st.floats(0.32, 1.28),
    cut=st.sampled_from([np.floor, np.ceil, np.round]),
    start=st.floats(0.0, 1e6),
)
@example(seed=0, unit=1.0, ratio=0.494668810489955, cut=np.floor, start=0.0)  # half a second, but for two leaps back
def test_rounded_stamps_of_an_even_clock_find_it(
    seed: int, unit: float, ratio: float, cut: np.ufunc, start: float
) -> None:
    """600 rows with a gap: the times are those of the clock, but for where within the resolution each part lies."""
    rng = np.random.default_rng(seed)
    gap = int(rng.integers(100, 500))
    true = unit * (start + ratio * np.arange(600) + 50.3 * (np.arange(600) >= gap))
    found = coarse_clock(unit * cut(true / unit))
    uneven = min(abs(ratio - 1.0), 1.0 - abs(ratio - 1.0)) * 600
    if found is None:
        # Nothing, or next to it, tells the clock from whole resolutions; or it might be rows that are missing.
        assert uneven < 25 or (ratio > 1.0 and unit in (1.0, 0.1))
        return
    off = (found[0] - true) / unit
    assert (np.diff(found[0]) > 0.0).all()
    # A sample time of fewer digits may stand for it, with a row that is taken for missing.
    assert max(float(np.ptp(part)) for part in (off[:gap], off[gap:])) < 0.8 + ratio
    assert float(np.median(np.diff(found[0]))) == pytest.approx(ratio * unit, rel=0.01)


@given(seed=st.integers(0, 2**32 - 1), ratio=st.floats(0.32, 0.97), jitter=st.floats(0.0, 0.3))
def test_a_clock_that_comes_late_now_and_then_goes_on_and_never_back(seed: int, ratio: float, jitter: float) -> None:
    true = ratio * np.arange(600)
    found = coarse_clock(np.sort(np.floor(true + np.random.default_rng(seed).uniform(0.0, jitter, 600))))
    if found is None:
        assert jitter > 0.2 or min(ratio, 1.0 - ratio) * 600 < 25
        return
    assert (np.diff(found[0]) > 0.0).all()
    assert jitter > 0.2 or float(np.ptp(found[0] - true)) < 0.8 + ratio


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), missing=st.floats(0.01, 0.25))
def test_rows_that_are_missing_at_random_are_no_clock(seed: int, missing: float) -> None:
    rows = np.flatnonzero(np.random.default_rng(seed).uniform(size=800) > missing)
    assert coarse_clock(rows.astype(np.float64)) is None


@pytest.mark.parametrize("rows", [60, 120, 200, 400, 900, 3600, 20_000])
@pytest.mark.parametrize("every", [7, 8, 10, 12, 13, 20, 30, 50, 60])
@pytest.mark.parametrize("unit", [1.0, 0.1])
def test_rows_that_are_missing_at_every_nth_place_are_no_clock(rows: int, every: int, unit: float) -> None:
    places = np.arange(rows)
    assert coarse_clock(unit * places[places % every != every - 1]) is None


@pytest.mark.parametrize("Ts", [1.1, 1.2, 1.25, 1.05])
@pytest.mark.parametrize("unit", [1.0, 0.1, 0.01])
def test_a_slower_clock_of_few_digits_is_found(Ts: float, unit: float) -> None:
    found = coarse_clock(unit * np.floor(Ts * np.arange(400) + 0.01))
    assert found is not None
    assert float(np.median(np.diff(found[0]))) == pytest.approx(Ts * unit, rel=1e-9)


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1))
def test_irregular_times_in_whole_seconds_are_no_clock(seed: int) -> None:
    steps = np.random.default_rng(seed).exponential(0.9, 800)
    assert coarse_clock(np.floor(np.cumsum(steps))) is None


def test_two_parts_far_apart_are_read(tmp_path: Path) -> None:
    """Half of the spans of rows were a gap, so that their median was like none of them."""
    times = [float(k) for k in range(31)] + [1000.0 + k for k in range(31)]
    assert len(read_record(write(tmp_path, "t", [f"{t:g}" for t in times]))) == 31


def test_a_clock_with_rows_missing_is_found_and_they_are_filled(tmp_path: Path) -> None:
    rows = [k for k in range(3000) if k not in (700, 1500, 2222)]
    record = read_record(write(tmp_path, "Timestamp", [f"{45291.5 + k / 86400:.5f}" for k in rows], rows))
    assert record.sample_time == 1.0
    assert len(record) == 3000
    assert float(np.abs(record.pv - np.arange(3000)).max()) <= 1.0


def test_rows_of_two_loops_in_turn_are_no_faster_clock(tmp_path: Path) -> None:
    times = [f"2024-10-17 21:{k // 120:02d}:{k // 2 % 60:02d}" for k in range(900)]
    with pytest.raises(RecordError, match=r"the same time as line 2 with other values.*several loops"):
        read_record(write(tmp_path, "Timestamp", times, [k + 500 * (k % 2) for k in range(900)]))
