"""One loop's row: what is measured, judged and refused."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fleet_helpers import START, record, write_csv
from hypothesis import given
from hypothesis import strategies as st

import workbench as wb
from workbench.errors import InvalidValue, RecordError
from workbench.fleet import task
from workbench.fleet.groups import grouped
from workbench.fleet.sampling import oscillation_at_any_rate
from workbench.fleet.window import within
from workbench.model.estimation import Estimate, Intervals
from workbench.model.fleet import FleetRow, LoopSource, Settings, Tuning
from workbench.scenario import retune

SCREEN = Settings()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("loops")
    write_csv(path / "sticky.csv", record(sticky=True))
    write_csv(path / "healthy.csv", record(sticky=False))
    return path


def test_a_sticking_loop(folder: Path) -> None:
    loop = LoopSource("FIC1", str(folder / "sticky.csv"), criticality=3, area="north")
    result = task.look_at(loop, SCREEN)
    row, read = result.row, wb.read_record(folder / "sticky.csv")
    assert row.verdict == wb.detect(read).verdict == "stiction"
    assert row.stiction == pytest.approx(2.0, rel=0.3)
    assert row.oscillates
    assert row.period == pytest.approx(wb.detect(read).oscillation.period, rel=0.05)
    assert (row.name, row.criticality, row.area, row.samples) == ("FIC1", 3, "north", 1200)
    assert row.pv_sd == pytest.approx(float(read.pv.std()))
    assert row.op_travel == pytest.approx(float(np.abs(np.diff(read.op)).sum()) * 3.0)
    assert math.isnan(row.automatic)
    assert row.status == "ok"
    assert "FIC1" in result.page
    assert len(row.trend) > 50


def test_a_healthy_loop(folder: Path) -> None:
    result = task.look_at(LoopSource("FIC2", str(folder / "healthy.csv")), SCREEN)
    assert result.row.verdict == "no_stiction"
    assert not result.row.oscillates
    assert math.isnan(result.row.stiction)
    assert result.page == ""


@pytest.mark.slow
def test_models_and_tunings_come_with_depth(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Estimate] = []
    search, true_tune = cache(retune.tune_found), retune.tune_case
    # How well it is searched for is the tuning's own test.
    monkeypatch.setattr(
        retune, "tune_case", lambda loop, do, job, told: true_tune(loop, do, replace(job, restarts=1, digits=2), told)
    )

    def searched_once(found: Estimate, wishes: retune.Wishes) -> object:
        asked.append(found)
        return search(asked[0], wishes)

    monkeypatch.setattr(retune, "tune_found", searched_once)
    write_csv(folder / "short.csv", record(sticky=True, n=700, moved=8.0))
    loop = LoopSource("FIC1", str(folder / "short.csv"), tuning=Tuning(0.5, 20.0, 0.0, "series"))
    result = task.look_at(loop, Settings("tune"))
    row = result.row
    assert row.verdict == "stiction"
    assert row.stiction == pytest.approx(2.0, rel=0.1)
    assert f"leaves {row.evidence:.1%} less of PV unpredicted" in row.reasons  # one figure, of one stretch
    assert (row.present_Kc, row.present_Ti, row.present_Td, row.present_form) == (0.5, 20.0, 0.0, "series")
    assert row.stiction_low <= row.stiction <= row.stiction_high
    assert row.model_gain == pytest.approx(1.0, rel=0.2)
    assert row.form == "series"
    assert 0.0 < row.gain_of_tuning < 1.0  # better than the tuning that it has
    assert "Proposed tuning" in result.page
    vague = task._tuned(row, loop, replace(asked[0], intervals=Intervals()))[0]
    notes = vague.notes
    assert vague.hint
    assert notes.endswith(vague.hint)
    assert row.hint == ""
    assert notes.endswith("the record gives no range for the gain K and dead time, so take this tuning as a hint")
    assert "as a hint" not in row.notes
    write_csv(folder / "calm.csv", record(sticky=False))
    found = task.look_at(LoopSource("FIC2", str(folder / "calm.csv")), Settings("tune")).row
    assert found.verdict == "no_stiction"
    assert math.isnan(found.Kc)
    assert math.isnan(found.present_Kc)
    assert found.evidence == found.predicts
    assert found.plant == "fopdt"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "t,PV\n0,1\n1,2\n",
            "no column for OP; the file has 't', 'PV'; give the mapping, for example columns: {OP: name in the file}",
        ),
        ("", "empty"),
        ("t,PV,OP\n" + "\n".join(f"{k},{k},{k % 3}" for k in range(20)), "20 samples given; at least 30"),
        ("t,PV,OP\n" + "\n".join(f"{(k * 7) % 50},{k % 7},{k % 3}" for k in range(60)), "times must ascend"),
    ],
)
def test_what_is_wrong_with_a_record_is_its_row(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    row = task.look_at(LoopSource("a", str(tmp_path / "a.csv")), SCREEN).row
    assert row.failed
    assert reason in row.reason
    assert "\n" not in row.reason


def test_other_refusals_and_accidents_are_rows_too(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert task.look_at(LoopSource("a", refusal="two loops have this name"), SCREEN).row.reason.startswith("two loops")
    assert "no such file" in task.look_at(LoopSource("a", str(folder / "none.csv")), SCREEN).row.reason

    def breaks(*_: object) -> None:
        raise ZeroDivisionError("a\ndefect")

    monkeypatch.setattr(task, "detect", breaks)
    row = task.look_at(LoopSource("a", str(folder / "sticky.csv")), SCREEN).row
    assert row.reason == "unexpected: ZeroDivisionError: a defect"


def test_a_signal_that_stands_still_is_undecided(tmp_path: Path) -> None:
    still = record(sticky=False)
    write_csv(tmp_path / "a.csv", replace(still, op=np.full(len(still), 40.0)))
    row = task.look_at(LoopSource("a", str(tmp_path / "a.csv")), Settings("estimate")).row
    assert row.verdict == "undecided"
    assert row.saturated == 1.0
    assert not row.failed


def test_a_long_record_that_stands_still_is_told_by_its_own_samples(tmp_path: Path) -> None:
    rest = np.full(4000, 40.0)
    (tmp_path / "a.csv").write_text("t,PV,OP\n" + "".join(f"{t},{y:g},{t % 7}\n" for t, y in enumerate(rest)))
    row = task.look_at(LoopSource("a", str(tmp_path / "a.csv")), SCREEN).row
    assert row.samples == 4000
    assert row.reasons.startswith("PV is constant over all 4000 samples")
    # What holds of the stretch alone stays the stretch's.
    moved = wb.Record(np.concatenate((np.arange(9000.0) % 9, rest)), np.arange(13000.0) % 7, 1.0)
    part = replace(moved, pv=moved.pv[9000:], op=moved.op[9000:])
    assert task._of_whole(wb.detect(part), part, moved).reasons == wb.detect(part).reasons


def test_windows_of_time() -> None:
    base = replace(record(sticky=False, n=600), epoch=1000.0, start=50.0)
    part = within(base, Settings(begin=1100.0, end=1200.0))
    assert len(part) == 100
    assert part.epoch + part.start == 1100.0
    assert np.array_equal(part.pv, base.pv[50:150])
    late = within(base, Settings(last=60.0))
    assert np.array_equal(late.pv, base.pv[-60:])
    assert within(base, SCREEN) is base
    with pytest.raises(RecordError, match="no 30 samples"):
        within(base, Settings(begin=0.0, end=1000.0))
    # The longest stretch within the window is the record, though another one is the longest of all.
    two = replace(base, rest=(replace(base, start=2000.0, pv=base.pv[:200], op=base.op[:200], sp=None),))
    assert len(within(two, Settings(begin=1600.0))) == 200


def test_a_window_without_a_zone_is_by_the_clock_of_the_record() -> None:
    base = replace(record(sticky=False, n=600), epoch=START, zone=((START, 19_800.0),))
    by_clock = within(base, Settings(begin=START + 19_800.0 + 100.0, end=START + 19_800.0 + 200.0))
    assert np.array_equal(by_clock.pv, base.pv[100:200])
    instant = within(base, Settings(begin=START + 100.0, end=START + 200.0, zoned=True))
    assert np.array_equal(instant.pv, base.pv[100:200])
    with pytest.raises(RecordError, match="no 30 samples"):
        within(base, Settings(begin=START + 100.0, end=START + 200.0))
    with pytest.raises(
        RecordError, match=r"has a zone, and the record's times have none; give --from and --to without"
    ):
        within(replace(base, zone=()), Settings(begin=START + 100.0, zoned=True))


def test_a_clock_that_is_changed_in_the_record() -> None:
    turn = START + 300.0
    autumn = replace(record(sticky=False, n=600), epoch=START, zone=((START, 7200.0), (turn, 3600.0)))
    assert autumn.instant(START + 7200.0 + 299.0) == START + 299.0
    assert autumn.instant(turn + 3600.0 + 100.0) == turn + 100.0 - 3600.0  # an hour that is shown twice: the first
    assert autumn.instant(turn + 7200.0 + 100.0) == turn + 3700.0
    spring = replace(autumn, zone=((START, 3600.0), (turn, 7200.0)))
    assert spring.instant(turn + 3600.0 + 100.0) == turn  # an hour that is never shown
    assert spring.instant(turn + 7200.0 + 100.0) == turn + 100.0
    with pytest.raises(InvalidValue, match=r"Record\.zone"):
        replace(autumn, zone=3.0)


def test_the_notes_of_a_window_are_of_what_it_leaves(tmp_path: Path) -> None:
    one = record(sticky=False, n=900)
    op = one.op.copy()
    op[300:] = op.min()
    rows = zip(one.time.tolist(), one.pv.tolist(), op.tolist(), strict=True)
    lines = [f"{START + t:.0f},{y:.6g},{u:.6g}" for t, y, u in rows]
    lines[5] = lines[5].rsplit(",", 1)[0] + ",Bad"
    (tmp_path / "a.csv").write_text("Time,PV,OP\n" + "\n".join(lines))
    loop = LoopSource("a", str(tmp_path / "a.csv"))
    assert any(note.startswith("OP stays at its lowest value") for note in task.read(loop, SCREEN).notes)
    part = task.read(loop, Settings(begin=START + 100.0, end=START + 250.0))
    assert not any("OP stays" in note for note in part.notes)
    (whole,) = part.notes
    assert whole.startswith("of the whole record: ")
    assert "first timestamp" not in whole
    late = task.read(loop, Settings(begin=START + 280.0, end=START + 480.0))
    assert late.notes[0].startswith("OP stays at its lowest value")
    assert "90%" in late.notes[0]
    assert dict(late.counts) == {"kept": 200, "window": 200}


def test_counts_within_a_window() -> None:
    base = replace(
        record(sticky=False, n=600), mode=("AUTO",) * 600, counts={"between": 300, "manual": 200, "rows": 900}
    )
    part = within(base, Settings(last=200.0))
    assert part.counts["between"] == 100
    # How much of the window was in manual nobody knows.
    assert math.isnan(task._automatic(part))
    assert task._automatic(base) == 0.75


def test_time_in_automatic() -> None:
    base = record(sticky=False, n=100)
    assert task._automatic(replace(base, mode=("AUTO",) * 75 + ("MAN",) * 25)) == 0.75
    assert task._automatic(replace(base, mode=("AUTO",) * 100, counts={"manual": 300})) == 0.25


@given(shift=st.floats(0.0, 1.0), period=st.floats(90.0, 110.0), seed=st.integers(0, 20))
def test_phases_of_one_clock_differ_by_the_shift(shift: float, period: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 8000

    def made(turns: float, start: float) -> FleetRow:
        at = start + np.arange(n)
        pv = np.sin(2.0 * math.pi * (at / period + turns)) + rng.normal(0.0, 0.2, n)
        one = wb.Record(pv, rng.normal(size=n), 1.0, start=start, epoch=1e9)
        step, first, phases = task._phases(one, oscillation_at_any_rate(one.pv, 1.0))
        return FleetRow(str(turns), oscillates=True, period=period, phase_step=step, phase_first=first, phases=phases)

    a, b = made(0.0, 0.0), made(shift, 777.0)
    assert a.phase_step == b.phase_step
    common = range(max(a.phase_first, b.phase_first), min(a.phase_first + len(a.phases), b.phase_first + len(b.phases)))
    turns = np.array([b.phases[i - b.phase_first] - a.phases[i - a.phase_first] for i in common]) / 256.0 - shift
    error = np.abs(turns - np.rint(turns))
    assert np.median(error) < 0.03
    (group,) = grouped([replace(a, name="a"), replace(b, name="b")])
    assert min(group.locked) > 0.9
