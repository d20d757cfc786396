"""What parts a record, what is kept of it, and what signals give away."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import workbench as wb
from workbench.errors import InvalidValue, RecordError
from workbench.record.checks import frozen_rows
from workbench.record.modes import mode_kinds
from workbench.record.reader import read_record


def write(folder: Path, columns: dict[str, object], every: float = 1.0) -> Path:
    """A wide file with a row every `every` seconds."""
    path = folder / "loop.csv"
    many = len(next(iter(columns.values())))  # type: ignore[arg-type]
    lines = [",".join(["t", *columns])]
    lines += [",".join([f"{every * k:g}", *(str(c[k]) for c in columns.values())]) for k in range(many)]  # type: ignore[index]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def noise(many: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(50.0, 1.0, many).round(4)


def joined(many: int) -> np.ndarray:
    out = np.ones(many, dtype=bool)
    out[0] = False
    return out


def test_stretches_of_one_mode_are_kept_apart_and_manual_is_left_out(tmp_path: Path) -> None:
    mode = ["AUTO"] * 100 + ["CAS"] * 150 + ["MAN"] * 300 + ["AUTO"] * 120 + ["MAN"] * 5 + ["AUTO"] * 20
    record = read_record(write(tmp_path, {"PV": noise(695), "OP": noise(695, 1), "MODE": mode}))
    assert set(record.mode or ()) == {"CAS"}
    assert (record.start, len(record)) == (100.0, 150)
    parts = record.segments
    assert [(part.start, len(part), set(part.mode or ())) for part in parts] == [
        (0.0, 100, {"AUTO"}),
        (100.0, 150, {"CAS"}),
        (550.0, 120, {"AUTO"}),
    ]
    assert record.counts["manual"] == 305
    assert any("the 305 samples in manual are left out" in note for note in record.notes)
    assert record.summary()[0] == "150 samples of 1 s (0.0417 h); 2 other stretches of 220 samples"


def test_segments_stay_those_of_the_record_when_a_field_is_replaced(tmp_path: Path) -> None:
    mode = ["AUTO"] * 100 + ["CAS"] * 150
    record = replace(read_record(write(tmp_path, {"PV": noise(250), "OP": noise(250, 1), "MODE": mode})), source="new")
    assert [len(part) for part in record.segments] == [100, 150]
    assert record.segments[1].source == "new"
    assert all(part.rest == () for part in record.segments)
    alone = wb.Record([1.0, 2.0], [1.0, 2.0], 1.0)
    (only,) = alone.segments
    assert only.pv.tolist() == [1.0, 2.0]


def test_a_blank_mode_is_the_mode_before_it(tmp_path: Path) -> None:
    mode = ["AUTO"] * 10 + [""] * 30 + ["CAS"] * 15
    record = read_record(write(tmp_path, {"PV": noise(55), "OP": noise(55, 1), "MODE": mode}))
    assert record.mode == ("AUTO",) * 40


def test_a_record_in_manual_throughout_is_read_and_said(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, {"PV": noise(50), "OP": [40] * 50, "MODE": ["MAN"] * 50}))
    assert len(record) == 50
    assert any("the controller was never in automatic" in note for note in record.notes)
    with pytest.raises(RecordError, match=r"OP is constant \(40\).*in manual"):
        wb.estimate(record)


def test_modes_that_alternate_row_by_row_leave_nothing(tmp_path: Path) -> None:
    mode = ["AUTO", "CAS"] * 20
    with pytest.raises(RecordError, match=r"no two clean rows follow each other in one mode; MODE: AUTO 50\.0 %, CAS"):
        read_record(write(tmp_path, {"PV": noise(40), "OP": noise(40), "MODE": mode}))


def test_mode_kinds() -> None:
    modes = ["Auto", "AUT", "Cas", "RCAS", "Man", "IMan", "Trk", "1.0", "1", "0", "Program", ""]
    automatic, cascade, manual = "automatic", "cascade", "manual"
    assert mode_kinds(modes) == [
        *[automatic, automatic, cascade, cascade, manual, manual, manual],
        *["1", "1", manual, "PROGRAM", "blank"],
    ]
    assert mode_kinds(["0", "0"]) == ["0", "0"]


# a frozen sensor ------------------------------------------------------------------------------------------------------


def test_a_sensor_that_sticks_is_left_out_and_said(tmp_path: Path) -> None:
    pv = noise(400)
    pv[120:200] = pv[119]
    record = read_record(write(tmp_path, {"PV": pv, "OP": noise(400, 1)}))
    assert [(part.start, len(part)) for part in record.segments] == [(0.0, 119), (200.0, 200)]
    assert record.counts["frozen"] == 81
    assert any(f"PV is frozen at {pv[119]:g} in lines 121 to 201 (81 samples)" in note for note in record.notes)


def test_a_sensor_frozen_twice_for_quite_different_times() -> None:
    pv = noise(1000)
    pv[100:400] = 50.2
    pv[600:640] = 49.7
    assert frozen_rows(pv, joined(1000)) == [(100, 400), (600, 640)]


@pytest.mark.parametrize(
    ("plant", "valve"),
    [
        (wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0)),
        (wb.FOPDT(1.0, 0.2, 0.0), wb.Stenman(2.0)),
        (wb.FOPDT(1.0, 5.0, 1.0), wb.Choudhury(3.0, 1.0)),
        (wb.FOPDT(2.0, 1.0, 3.0), wb.Deadband(1.0)),
    ],
)
@pytest.mark.parametrize("digits", [1, 2, 4, 17])
def test_the_rests_between_slips_are_no_frozen_sensor(plant: wb.FOPDT, valve: wb.Stenman, digits: int) -> None:
    loop = wb.Loop(plant, valve, wb.PID(Kc=0.3, Ti=20.0), 1.0)
    for step, sd in ((4.0, 0.0), (1.3, 0.0), (4.0, 0.01)):
        run = wb.simulate(loop, wb.Experiment(3000.0, setpoint=wb.Step(step, at=100.0), noise=wb.Noise(sd, 0)))
        # The quiet before the step is not what a historian shows.
        pv = run.pv[100:].round(digits)
        assert frozen_rows(pv, joined(pv.size)) == [], (step, sd)


def test_what_is_no_frozen_sensor_stays() -> None:
    rng = np.random.default_rng(5)
    shut = np.where(np.arange(600) < 200, noise(600) - 45.0, 0.0)  # a flow that is cut off at zero
    coarse = rng.normal(50.0, 0.2, 2000).round(0)
    walk = np.cumsum(rng.choice([-1.0, 0.0, 0.0, 0.0, 1.0], 2000))
    held = np.repeat(noise(100), 12)
    for pv in (shut, coarse, walk, held, np.full(300, 5.0), noise(2000)):
        assert frozen_rows(pv, joined(pv.size)) == []


# ranges, units, limits ------------------------------------------------------------------------------------------------


def test_values_beyond_a_range_are_rejected_at_namur_limits(tmp_path: Path) -> None:
    pv = noise(100)
    pv[10:12], pv[40], pv[41] = 200.0, -2.4, 106.2  # beyond; within 2.5 % below and 6.25 % above
    path = write(tmp_path, {"PV": pv, "OP": noise(100, 1)})
    record = read_record(path, pv_range=(0.0, 100.0))
    assert (record.start, len(record), record.pv_range) == (12.0, 88, (0.0, 100.0))
    assert record.counts["rejected, out of range"] == 2
    assert any("2 rows rejected: out of range, first in line 12, column 'PV'" in note for note in record.notes)
    assert any(note.endswith("column 'PV': 200, allowed -2.5 to 106.25") for note in record.notes)


@pytest.mark.parametrize("code", ["-9999", "9999", "-999.25", "-32768", "3.4028235e+38"])
def test_codes_for_no_value_are_rejected_as_other_bad_values_are(tmp_path: Path, code: str) -> None:
    pv, op = noise(100).astype(object), noise(100, 1).astype(object)
    pv[40] = op[40] = op[41] = code
    record = read_record(write(tmp_path, {"PV": pv, "OP": op}))
    assert [len(part) for part in record.segments] == [40, 58]
    assert record.counts["rejected"] == record.counts["rejected, a code for no value"] == 2
    assert any("2 rows rejected: a code for no value (" in note for note in record.notes)
    assert float(record.op.max()) < 100.0
    # A signal that comes near it has it as a value.
    near = 100.0 * noise(100) + 4000.0
    near[40] = 9999.0
    assert len(read_record(write(tmp_path, {"PV": near, "OP": noise(100, 1)}))) == 100


def test_values_of_op_far_beyond_its_range_are_rejected_where_it_is_in_percent(tmp_path: Path) -> None:
    op = noise(100)
    op[[30, 60]] = 4500.0, -321.0
    record = read_record(write(tmp_path, {"PV": noise(100, 1), "OP": op}))
    assert record.counts["rejected, out of range"] == 2
    assert any("2 rows rejected: out of range, first in line 32, column 'OP'" in note for note in record.notes)
    assert any(note.endswith("column 'OP': 4500, allowed -100 to 200") for note in record.notes)
    # What is told is the value of the line that is told, in the file's unit and in any order of the file.
    pv, narrow = noise(100, 1), op / 100.0
    pv[50], narrow[[30, 60]] = 500.0, (45.0, -3.21)
    rows = [f"{99 - k},{pv[k]},{narrow[k]}" for k in range(100)]
    path = tmp_path / "turned.csv"
    path.write_text("\n".join(["t,PV,OP", *rows]), encoding="utf-8")
    notes = read_record(path, op_range=(0.0, 1.0), pv_range=(0.0, 100.0)).notes
    assert any(note.endswith("first in line 32, column 'OP': 45, allowed -0.025 to 1.0625") for note in notes)
    assert not any("beyond 0 to 100 %" in note for note in record.notes)
    # In counts of a converter nothing of the kind can be told, and a little beyond may be a controller's limit.
    counts = 40.0 * noise(100)
    counts[30] = 4095.0
    assert len(read_record(write(tmp_path, {"PV": noise(100, 1), "OP": counts}))) == 100
    op[[30, 60]] = 106.9, -6.9
    assert len(read_record(write(tmp_path, {"PV": noise(100, 1), "OP": op}))) == 100


def test_one_huge_value_makes_no_straight_lines(tmp_path: Path) -> None:
    pv = noise(200)
    pv[90] = 1e9
    record = read_record(write(tmp_path, {"PV": pv, "OP": noise(200, 1)}))
    assert record.notes == ()


def test_blanks_in_a_block_are_a_gap_and_no_export_of_changes(tmp_path: Path) -> None:
    op = noise(1200, 1).astype(object)
    op[500:801] = ""
    record = read_record(write(tmp_path, {"PV": noise(1200), "OP": op}))
    assert [(part.start, len(part)) for part in record.segments] == [(0.0, 500), (801.0, 399)]
    assert record.counts["rejected, blank"] == 301
    assert any("301 rows rejected: blank, first in line 502, column 'OP'" in note for note in record.notes)
    assert not any("resampled" in note for note in record.notes)


def test_op_is_scaled_from_its_range(tmp_path: Path) -> None:
    ma = 4.0 + 16.0 * np.arange(50) / 49
    record = read_record(write(tmp_path, {"PV": noise(50), "OP": ma.round(6)}), op_range=(4, 20))
    assert record.op == pytest.approx(100.0 * np.arange(50) / 49, abs=1e-4)
    assert any("OP taken in % of its range, 4 to 20" in note for note in record.notes)


def test_a_pv_in_another_unit_than_its_range_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, {"PV": 273.15 + noise(50), "OP": noise(50)})
    with pytest.raises(RecordError, match=r"PV runs from 32.*most of it lies beyond its range, 0 to 100: another unit"):
        read_record(path, pv_range=(0.0, 100.0))
    with pytest.raises(InvalidValue, match=r"pv_range.*low < high"):
        read_record(path, pv_range=(100.0, 0.0))


def test_swapped_columns_are_refused_unless_insisted_on(tmp_path: Path) -> None:
    sp = np.repeat([250.0, 251.0], 100)
    path = write(tmp_path, {"SP": sp, "PV": noise(200) - 10.0, "OP": sp + noise(200, 1) - 50.0})
    with pytest.raises(RecordError, match=r"goes with 'OP', read as OP, and not with 'PV'.*swapped\?") as refused:
        read_record(path)
    assert "If so, give columns={'PV': 'OP', 'OP': 'PV'}; if they are right as they are, columns={'PV': 'PV'" in str(
        refused.value
    )
    assert len(read_record(path, columns={"PV": "OP", "OP": "PV"})) == 200
    assert len(read_record(path, columns={"PV": "PV", "OP": "OP"})) == 200


def test_swapped_columns_are_refused_where_op_lies_two_swings_from_sp(tmp_path: Path) -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(600.0, setpoint=wb.Step(4.0), noise=wb.Noise(0.05, 3)))
    op = run.op + 54.0 - float(np.median(run.op)) - 2.0 * float(np.ptp(run.op))
    path = write(tmp_path, {"SP": run.sp + 50.0, "PV": op, "OP": run.pv + 50.0})
    with pytest.raises(RecordError, match=r"swapped\?"):
        read_record(path)
    # A proportional controller's PV rests away from SP, and so does its OP.
    path = write(tmp_path, {"SP": np.full(200, 50.0), "PV": noise(200) + 8.0, "OP": noise(200, 1) - 3.0})
    assert len(read_record(path)) == 200


@pytest.mark.parametrize(
    ("op", "words"),
    [
        (noise(100) + 300.0, "beyond 0 to 100 %: give its range"),
        (noise(100) / 100.0, "give its range, 0 to 1, if it is a fraction, as op_range (--op-range 0:1)"),
        (np.where(np.arange(100) < 60, 100.0, noise(100)), "highest value, 100 %, in 60% of the samples: saturated"),
        (np.where(np.arange(100) < 30, 0.0, noise(100)), "lowest value, 0 %, in 30% of the samples: saturated"),
    ],
)
def test_what_op_gives_away_is_said(tmp_path: Path, op: np.ndarray, words: str) -> None:
    record = read_record(write(tmp_path, {"PV": noise(100, 1), "OP": op}))
    assert len(record) == 100
    assert any(words in note for note in record.notes)


def test_a_plain_record_says_nothing(tmp_path: Path) -> None:
    record = read_record(write(tmp_path, {"PV": noise(100, 1), "OP": noise(100), "SP": [50] * 100}))
    assert record.notes == ()
    assert dict(record.counts) == {"rows": 100, "kept": 100, "rejected": 0, "gaps": 0}


def test_held_and_interpolated_values_are_said(tmp_path: Path) -> None:
    held = {"PV": np.repeat(noise(50), 3), "OP": np.repeat(noise(50, 1), 3)}
    record = read_record(write(tmp_path, held))
    assert any(
        "PV repeats the value before it in 67% of the samples, 2 on end at most; and OP" in n for n in record.notes
    )
    only = read_record(write(tmp_path, {"PV": held["PV"], "OP": noise(150)}))
    assert any("a coarse, compressed or held signal" in note for note in only.notes)
    straight = np.interp(np.arange(200), np.arange(0, 200, 8), noise(25)).round(12)
    lines = read_record(write(tmp_path, {"PV": straight, "OP": noise(200)}))
    assert any("PV lies on straight lines in 8" in note for note in lines.notes)


def test_single_unusable_rows_are_filled_where_they_are_few(tmp_path: Path) -> None:
    pv, op = noise(100), noise(100, 1)
    cells = {"PV": pv.astype(object), "OP": op.astype(object)}
    cells["PV"][[20, 50]] = "Bad Input"
    cells["OP"][[50, 70]] = ""
    record = read_record(write(tmp_path, cells))
    assert len(record) == 100
    assert (record.counts["filled"], record.counts["between"], record.counts["rejected"]) == (3, 2, 3)
    assert "3 single unusable rows are filled: there PV is linear between its neighbours, or OP held" in record.notes
    for k in (20, 50):
        assert record.pv[k] == pytest.approx(0.5 * (pv[k - 1] + pv[k + 1]), abs=1e-3)
    assert record.pv[70] == pytest.approx(pv[70], abs=1e-3)
    assert record.op[[50, 70]] == pytest.approx(op[[49, 69]], abs=1e-3)


@pytest.mark.parametrize("bad", [(0,), (99,), (40, 41), tuple(range(5, 95, 10))])
def test_unusable_rows_at_an_end_two_on_end_or_many_are_not_filled(tmp_path: Path, bad: tuple[int, ...]) -> None:
    pv = noise(100).astype(object)
    pv[list(bad)] = "Bad Input"
    record = read_record(write(tmp_path, {"PV": pv, "OP": noise(100, 1)}))
    assert "filled" not in record.counts
    assert record.counts["rejected"] == len(bad)
    assert len(record) < 100


def test_a_row_that_is_bad_in_every_column_is_filled_in_every_column(tmp_path: Path) -> None:
    pv, stem = noise(100), noise(100, 2)
    cells = {"PV": pv, "OP": noise(100, 1), "SP": np.full(100, 50.0), "MODE": np.full(100, "AUTO"), "VALVE": stem}
    cells = {name: values.astype(object) for name, values in cells.items()}
    for values in cells.values():
        values[40] = "I/O Timeout"
    record = read_record(write(tmp_path, cells), columns={"valve_position": "VALVE"})
    assert len(record) == 100
    assert record.counts["filled"] == 1
    assert set(record.mode or ()) == {"AUTO"}
    assert record.sp is not None
    assert set(record.sp.tolist()) == {50.0}
    assert record.valve_position is not None
    assert record.valve_position[40] == pytest.approx(0.5 * (stem[39] + stem[41]), abs=1e-3)
    assert record.pv[40] == pytest.approx(0.5 * (pv[39] + pv[41]), abs=1e-3)
