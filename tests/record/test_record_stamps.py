"""Tags of a tall export that are each even and stamped some time apart: taken as recorded, not interpolated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.model.record import Record
from workbench.record.reader import read_record

MANY = 400
PV = np.random.default_rng(1).integers(0, 1000, MANY) / 8.0
OP = np.random.default_rng(2).integers(0, 800, MANY) / 8.0
EVERY = np.arange(MANY)
Rows = NDArray[np.int64]


def tall(
    folder: Path, times: dict[str, NDArray[np.float64]], rows: dict[str, Rows] | None = None, order: bool = True
) -> Record:
    """Write the samples, all or those in `rows`, of each tag at its times, and read them."""
    values = {"PV": PV, "OP": OP, "SP": np.round(PV), "ZT": OP + 0.5}
    listed = [
        (float(t), f"F1.{tag},{t:.6f},{values[tag][k]}\n")
        for tag, at in times.items()
        for k, t in enumerate(at)
        if rows is None or tag not in rows or k in rows[tag]
    ]
    path = folder / "tall.csv"
    path.write_text("tag,time [s],value\n" + "".join(line for _, line in (sorted(listed) if order else listed)))
    return read_record(path)


@pytest.mark.parametrize("Ts", [1.0, 5.0])
@pytest.mark.parametrize("apart", [0.001, 0.02, 0.05, 0.25, -0.02, -0.25])
def test_a_tag_stamped_a_little_after_pv_or_before_it_is_taken_as_recorded(
    tmp_path: Path, Ts: float, apart: float
) -> None:
    at = 100.0 + Ts * EVERY
    record = tall(tmp_path, {"PV": at, "OP": at + apart * Ts, "SP": at - 0.1 * Ts, "ZT": at + 0.1 * Ts})
    assert record.pv.tolist() == PV.tolist()
    assert record.op.tolist() == OP.tolist()
    assert record.sp is not None
    assert record.sp.tolist() == np.round(PV).tolist()
    assert record.valve_position is not None
    assert record.valve_position.tolist() == (OP + 0.5).tolist()
    assert (record.sample_time, record.rest) == (Ts, ())
    assert "resampled" not in record.counts
    (said,) = (note for note in record.notes if "apart" in note)
    assert f"SP up to {0.1 * Ts:.3g} s, by {0.1 * Ts:.3g} s before on average" in said
    way = "after" if apart > 0.0 else "before"
    words = f"OP up to {abs(apart) * Ts:.3g} s, by {abs(apart) * Ts:.3g} s {way} on average"
    assert (words in said) == (abs(apart) > 0.01)


@pytest.mark.parametrize("jitter", [0.01, 0.1, 0.24])
@pytest.mark.parametrize("apart", [0.0, 0.2])
def test_tags_stamped_early_and_late_each_by_itself_are_taken_as_recorded(
    tmp_path: Path, jitter: float, apart: float
) -> None:
    rng = np.random.default_rng(3)
    at = {tag: 2.0 * (EVERY + where + rng.uniform(-jitter, jitter, MANY)) for tag, where in (("PV", 0), ("OP", apart))}
    record = tall(tmp_path, at)
    assert record.pv.tolist() == PV.tolist()
    assert record.op.tolist() == OP.tolist()
    assert record.sample_time == pytest.approx(2.0, rel=1e-3)


def test_rows_missing_of_one_tag_are_those_of_equal_stamps(tmp_path: Path) -> None:
    """Single rows of either tag, and a block of OP."""
    rows = {"PV": np.delete(EVERY, [50, 90]), "OP": np.delete(EVERY, [120, *range(300, 310)])}
    at = 1.0 * EVERY
    same = tall(tmp_path, {"PV": at, "OP": at}, rows)
    apart = tall(tmp_path, {"PV": at, "OP": at + 0.02}, rows)
    assert same.counts["filled"] == 3
    for one, other in zip(same.segments, apart.segments, strict=True):
        assert one.pv.tolist() == other.pv.tolist()
        assert one.op.tolist() == other.op.tolist()
    assert dict(same.counts) == dict(apart.counts)


@pytest.mark.parametrize(
    "times",
    [
        1.0 * EVERY + 0.3,  # too far from PV to be one sample
        1.002 * EVERY,  # a clock of its own, which runs away from PV's
        2.0 * EVERY + 0.02,  # every second sample alone
        np.cumsum(np.random.default_rng(4).uniform(0.4, 1.6, MANY)),  # no even tag
    ],
)
def test_tags_with_times_of_their_own_are_resampled_still(tmp_path: Path, times: NDArray[np.float64]) -> None:
    record = tall(tmp_path, {"PV": 1.0 * EVERY, "OP": times})
    assert record.counts["resampled"] >= len(record)
    assert not any("apart" in note for note in record.notes)


def test_equal_stamps_of_tags_say_nothing(tmp_path: Path) -> None:
    at = 1.0 * EVERY
    record = tall(tmp_path, {"PV": at, "OP": at, "SP": at}, order=False)
    assert record.notes == ()
    assert record.pv.tolist() == PV.tolist()
