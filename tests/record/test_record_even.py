"""Rows on an even grid whose stamps are not: cut to whole seconds, early or late, with rows missing and gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import RecordError
from workbench.record.even import best_grid, places
from workbench.record.reader import read_record


def write(folder: Path, times: list[float]) -> Path:
    path = folder / "loop.csv"
    path.write_text("t,PV,OP\n" + "".join(f"{t:.3f},{k},{k % 7}\n" for k, t in enumerate(times)), encoding="utf-8")
    return path


@pytest.mark.parametrize("cut", [np.floor, np.ceil, np.round])
@pytest.mark.parametrize("Ts", [1.37, 1.5, 1.7, 2.2, 2.5, 3.3, 3.5, 10.5])
def test_stamps_in_whole_seconds_do_not_move_the_samples(tmp_path: Path, cut: np.ufunc, Ts: float) -> None:
    path = write(tmp_path, cut(Ts * np.arange(400)).tolist())
    record = read_record(path)
    assert record.pv.tolist() == list(range(400))
    assert record.sample_time == pytest.approx(Ts, rel=2e-4)
    assert read_record(path, sample_time=Ts).sample_time == Ts
    with pytest.raises(RecordError, match="leave sample_time out"):
        read_record(path, sample_time=1.05 * Ts)


@pytest.mark.parametrize("Ts", [1.2, 1.25, 1.3])
def test_stamps_that_are_cut_by_nearly_the_sample_time_itself_keep_their_places(tmp_path: Path, Ts: float) -> None:
    """Every interval is one second or two, and which of them are two places no interval can tell."""
    record = read_record(write(tmp_path, np.floor(Ts * np.arange(400)).tolist()))
    assert record.pv.tolist() == list(range(400))
    assert record.sample_time == pytest.approx(Ts, rel=2e-4)


def test_how_far_the_times_are_from_the_grid_is_measured_from_the_nearest_one(tmp_path: Path) -> None:
    """Measured from the first row, which is as far from its place as any, the figure was nearly twice as large."""
    jitter = np.random.default_rng(1).uniform(-0.24, 0.24, 400)
    (said,) = (n for n in read_record(write(tmp_path, (5.0 * (np.arange(400) + jitter)).tolist())).notes if "grid" in n)
    assert said.startswith(
        ("times differ from the even grid by up to 24.", "times differ from the even grid by up to 25")
    )
    (said,) = (n for n in read_record(write(tmp_path, np.floor(2.5 * np.arange(400)).tolist())).notes if "grid" in n)
    assert "up to 10.1% of the sample time; taken as even" in said


def test_a_difference_that_rounds_to_nothing_is_not_said(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, [round(k / 3.0, 4) * 300.0 for k in range(400)]))
    assert record.sample_time == pytest.approx(100.0, rel=1e-4)
    assert not any("even grid" in note for note in record.notes)


@settings(deadline=None, max_examples=200)
@given(
    seed=st.integers(0, 2**32 - 1),
    Ts=st.floats(0.1, 1e3),
    jitter=st.floats(0.0, 0.25),
    start=st.floats(-1e9, 2e9),
    gap=st.floats(5.0, 1e4),
)
def test_rows_find_their_places(seed: int, Ts: float, jitter: float, start: float, gap: float) -> None:
    """300 rows, four of which are missing, and a gap that is no whole number of samples."""
    rng = np.random.default_rng(seed)
    at = np.sort(rng.choice(np.arange(1, 299), 296, replace=False))
    rows = np.concatenate([[0], at, [299]])
    split = int(rng.integers(20, 270))
    seconds = start + Ts * (rows + rng.uniform(-jitter, jitter, rows.size) + gap * (np.arange(rows.size) >= split))
    moved = np.diff(rows)
    moved[moved > 2] = 0
    moved[split - 1] = 0
    Ts_found, found = places(seconds)
    assert found is not None
    assert found.tolist() == moved.tolist()
    assert Ts_found == pytest.approx(Ts, rel=2e-3)
    usual, off = best_grid(seconds, found)
    assert np.abs(off).max() <= (jitter + 0.1) * usual + 1e-6


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.sampled_from([40, 100, 1000]))
def test_rows_on_no_grid_have_no_places(seed: int, many: int) -> None:
    seconds = np.cumsum(np.random.default_rng(seed).uniform(0.4, 2.0, many))
    assert places(seconds) == (float(np.median(np.diff(seconds))), None)


def test_a_clock_that_drifts_away_from_every_grid_has_even_intervals(tmp_path: Path) -> None:
    intervals = 10.0 + np.linspace(-0.5, 0.5, 1000)
    record = read_record(write(tmp_path, np.cumsum(intervals).tolist()))
    assert len(record) == 1000
    assert record.sample_time == pytest.approx(10.0, rel=1e-3)
