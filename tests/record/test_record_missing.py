"""Rows that are missing one by one all along, and a slower clock whose stamps are the same: the values tell."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import workbench as wb
from workbench.record.missing import missing_said, rows_missing
from workbench.record.reader import read_record


@cache
def sticky(noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """PV and OP of a loop that cycles for its valve, shape (1200,)."""
    loop = wb.Loop(wb.FOPDT(1.0, 3.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=10.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1300.0, setpoint=wb.Step(3.0, at=300.0), noise=wb.Noise(noise, 1)))
    return (run.pv[100:] + 50.0).round(3), (run.op[100:] + 40.0).round(3)


def write(folder: Path, times: np.ndarray, pv: np.ndarray, op: np.ndarray, form: str = "g") -> Path:
    path = folder / "loop.csv"
    rows = [f"{t:{form}},{y},{u}\n" for t, y, u in zip(times, pv, op, strict=True)]
    path.write_text("t,PV,OP\n" + "".join(rows), encoding="utf-8")
    return path


def kept(every: int, many: int = 1200) -> np.ndarray:
    rows = np.arange(many)
    return rows[rows % every != every - 1]


@pytest.mark.parametrize("every", [3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 16])
@pytest.mark.parametrize("Ts", [1.0, 0.5, 60.0])
def test_a_missing_row_in_every_few_is_told_and_filled(tmp_path: Path, every: int, Ts: float) -> None:
    """They were read as rows of a slower clock: every sixth missing made one of 1.2 s out of 1 s."""
    pv, op = sticky()
    rows = kept(every)
    record = read_record(write(tmp_path, Ts * rows, pv[rows], op[rows]))
    assert record.sample_time == Ts
    own = rows[rows < len(record)]
    assert record.pv[own].tolist() == pv[own].tolist()
    assert record.pv[every - 1] == pytest.approx((pv[every - 2] + pv[every]) / 2)
    assert record.op[every - 1] == op[every - 2]
    ordinal = {3: "3rd"}.get(every, f"{every}th")
    assert any(
        note.startswith(f"resampled, as every {ordinal} row is missing: every {Ts:g} s") for note in record.notes
    )


def test_rows_missing_here_and_there_are_counted(tmp_path: Path) -> None:
    pv, op = sticky()
    rows = np.setdiff1d(np.arange(1200), [k for k in range(1, 1199, 2) if (k * 37 % 101) % 9 == 0])
    record = read_record(write(tmp_path, rows * 1.0, pv[rows], op[rows]))
    assert record.sample_time == 1.0
    assert any(f"as {1200 - rows.size} single rows are missing" in note for note in record.notes)


def test_where_most_intervals_are_doubled_the_usual_one_counts(tmp_path: Path) -> None:
    pv, op = sticky()
    rows = np.concatenate([[0], np.cumsum(np.random.default_rng(2).choice([1, 2], 650, p=[0.35, 0.65]))])
    record = read_record(write(tmp_path, rows * 1.0, pv[rows], op[rows]))
    assert record.sample_time == 2.0
    assert any(note.startswith("resampled, as the times are not even: every 2 s") for note in record.notes)


@pytest.mark.parametrize("Ts", [1.05, 1.1, 1.2, 1.25, 1.3, 1.5])
@pytest.mark.parametrize("start", [0.0, 0.3, 0.77])
def test_a_slower_clock_in_whole_seconds_stays_one(tmp_path: Path, Ts: float, start: float) -> None:
    pv, op = sticky()
    record = read_record(write(tmp_path, np.floor(start + Ts * np.arange(1200)), pv, op))
    assert record.sample_time == pytest.approx(Ts, rel=2e-4)
    assert record.pv.tolist() == pv.tolist()
    assert not any("missing" in note for note in record.notes)


@pytest.mark.parametrize("every", [6, 7])
def test_where_nothing_tells_that_is_said(tmp_path: Path, every: int) -> None:
    rng = np.random.default_rng(3)
    rows = kept(every)
    record = read_record(write(tmp_path, rows * 1.0, rng.normal(50, 1, rows.size), rng.normal(40, 1, rows.size)))
    assert record.sample_time == pytest.approx(every / (every - 1), rel=1e-4)
    assert any("or single rows are missing: neither the times nor the values tell" in note for note in record.notes)


@pytest.mark.parametrize("noise", [0.02, 0.1, 0.15, 0.2, 0.3, 0.5])
@pytest.mark.parametrize("every", [4, 5, 6, 8, 11])
def test_noise_makes_neither_of_the_other(noise: float, every: int) -> None:
    for tau, seed in ((3.0, 1), (12.0, 2), (25.0, 3)):
        loop = wb.Loop(wb.FOPDT(1.0, tau, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.8, Ti=10.0), 1.0)
        run = wb.simulate(loop, wb.Experiment(3000.0, setpoint=wb.Step(3.0, at=300.0), noise=wb.Noise(noise, seed)))
        rows, clock = kept(every, 3000), np.floor(every / (every - 1) * np.arange(3000))
        assert rows_missing(rows.astype(np.float64), [run.pv[rows], run.op[rows]]) is not False
        assert rows_missing(clock, [run.pv[:3000], run.op[:3000]]) is not True


def test_values_tell_where_they_move_on() -> None:
    rows = kept(6).astype(np.float64)
    ramp = np.abs(rows % 80 - 40)
    assert rows_missing(rows, [ramp]) is True
    assert rows_missing(rows, [np.abs(np.arange(rows.size) % 80.0 - 40)]) is False
    assert rows_missing(rows, [np.full(rows.size, 7.0), ramp]) is True
    assert rows_missing(rows, [np.where(np.arange(rows.size) % 50 == 0, np.nan, ramp)]) is True
    assert rows_missing(rows, [np.random.default_rng(1).normal(size=rows.size)]) is None
    assert rows_missing(rows[:60], [ramp[:60]]) is False


@pytest.mark.parametrize(
    ("every", "said"), [(2, None), (3, "3rd"), (6, "6th"), (11, "11th"), (21, "21st"), (22, "22nd")]
)
def test_how_often_a_row_is_missing_is_said(every: int, said: str | None) -> None:
    found = missing_said(0.5 * kept(every))
    assert found == (None if said is None else (f"every {said} row is missing", 0.5))
