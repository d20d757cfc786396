"""Tall Parquet data sets: where tags are found, and records read from the row groups that hold them alone."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from fleet_helpers import START, record, tall, write_tall

import workbench as wb
from workbench.errors import RecordError
from workbench.record.historian import read_tags, tags_of
from workbench.record.names import split_tag

FIC1 = {"PV": "FIC1.PV", "OP": "FIC1.OP"}


@pytest.fixture(scope="module")
def one() -> wb.Record:
    return record(sticky=True, n=400)


def found(path: Path, tags: dict[str, str], **how: object) -> wb.Record:
    places = tags_of(path)
    pieces = tuple(dict.fromkeys(piece for tag in tags.values() for piece in places[tag]))
    return read_tags(pieces, tags, "FIC1", **how)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("tag", "split"),
    [
        ("FIC101.PV", ("FIC101", "PV")),
        ("FIC101/PID1/PV.CV", ("FIC101/PID1", "PV")),
        ("unit 3:LIC-7 out", ("unit 3:LIC-7", "OP")),
        ("FIC101.ZT", ("FIC101", "valve_position")),
        ("PV", None),
        ("FIC101.ALARM", None),
        ("", None),
    ],
)
def test_tags_tell_loop_and_signal(tag: str, split: tuple[str, str] | None) -> None:
    assert split_tag(tag) == split


def test_a_loop_is_read_as_from_a_file_of_its_own(tmp_path: Path, one: wb.Record) -> None:
    write_tall(tmp_path / "all.parquet", tall("FIC1", one), tall("FIC2", record(sticky=False, n=400)))
    write_tall(tmp_path / "alone.parquet", tall("FIC1", one))
    ours, alone = found(tmp_path / "all.parquet", FIC1), wb.read_record(tmp_path / "alone.parquet")
    assert np.array_equal(ours.pv, alone.pv)
    assert np.array_equal(ours.op, alone.op)
    assert (ours.sample_time, ours.start, ours.epoch) == (alone.sample_time, alone.start, alone.epoch)
    assert ours.epoch == START
    assert ours.notes == alone.notes


def test_only_the_row_groups_with_the_tags_are_read(tmp_path: Path, one: wb.Record) -> None:
    path = tmp_path / "all.parquet"
    whole = tall("FIC2", record(sticky=False, n=400))
    write_tall(
        path, whole.slice(0, 400), whole.slice(400), tall("FIC1", one).slice(0, 400), tall("FIC1", one).slice(400)
    )
    places = tags_of(path)
    assert {tag: pieces[0].groups for tag, pieces in places.items()} == {
        "FIC2.OP": (0,),
        "FIC2.PV": (1,),
        "FIC1.OP": (2,),
        "FIC1.PV": (3,),
    }
    # Damage elsewhere in the file does no harm then.
    content = bytearray(path.read_bytes())
    offset = pq.read_metadata(path).row_group(0).column(2).data_page_offset
    content[offset : offset + 40] = bytes(40)
    path.write_bytes(bytes(content))
    assert len(found(path, FIC1)) == 400
    with pytest.raises(RecordError, match="no readable Parquet"):
        found(path, {"PV": "FIC2.PV", "OP": "FIC2.OP"})


def test_row_groups_of_many_tags_and_partitions_by_day(tmp_path: Path, one: wb.Record) -> None:
    other = tall("FIC2", one)
    for day, (begin, stop) in enumerate(((0, 150), (150, 400))):
        mixed = pa.concat_tables([tall("FIC1", one, begin, stop), other]).sort_by("time")
        write_tall(tmp_path / f"day={day}" / "part.parquet", mixed)
    pieces = tuple(piece for day in range(2) for piece in tags_of(tmp_path / f"day={day}" / "part.parquet")["FIC1.PV"])
    assert len(pieces) == 2
    joined = read_tags(pieces, FIC1, "FIC1")
    assert np.array_equal(joined.pv, one.pv)


def test_a_window_of_time_reads_that_alone(tmp_path: Path, one: wb.Record) -> None:
    write_tall(tmp_path / "a.parquet", tall("FIC1", one, 0, 200), tall("FIC1", one, 200))
    part = found(tmp_path / "a.parquet", FIC1, window=(START + 250.0, START + 300.0))
    assert np.array_equal(part.pv, one.pv[250:300])
    assert part.epoch + part.start == START + 250.0
    with pytest.raises(RecordError, match="holds no value within the window"):
        found(tmp_path / "a.parquet", FIC1, window=(0.0, 1.0))


@pytest.mark.parametrize(("zone", "east"), [("+05:30", 19_800.0), ("Europe/Berlin", 7200.0), ("UTC", 0.0)])
def test_a_window_without_a_zone_loses_nothing_of_a_file_in_another_zone(
    tmp_path: Path, one: wb.Record, zone: str, east: float
) -> None:
    parts = [
        part.set_column(1, "time", part.column("time").cast(pa.timestamp("ms", zone)))
        for part in (tall("FIC1", one, 0, 200), tall("FIC1", one, 200))
    ]
    write_tall(tmp_path / "a.parquet", *parts)
    by_clock = START + 250.0 + east, START + 300.0 + east
    part = found(tmp_path / "a.parquet", FIC1, window=by_clock, zoned=False)
    assert part.zone == ((part.epoch, east),)
    at = part.epoch + part.time
    inside = (at >= part.instant(by_clock[0])) & (at < part.instant(by_clock[1]))
    assert np.array_equal(part.pv[inside], one.pv[250:300])
    assert np.array_equal(
        found(tmp_path / "a.parquet", FIC1, window=(START + 250.0, START + 300.0)).pv, one.pv[250:300]
    )


def test_a_window_of_times_written_as_text(tmp_path: Path, one: wb.Record) -> None:
    table = tall("FIC1", one)
    texts = pa.array([f"{at.isoformat()}+02:00" for at in table.column("time").to_pylist()])
    write_tall(tmp_path / "a.parquet", table.set_column(1, "time", texts))
    whole = found(tmp_path / "a.parquet", FIC1, window=(START + 250.0, START + 300.0))
    assert np.array_equal(whole.pv, one.pv)  # the window is cut out of the record
    assert whole.zone == ((START - 7200.0, 7200.0),)


def test_a_window_of_nanoseconds(tmp_path: Path, one: wb.Record) -> None:
    # A datetime, as a footer's statistics give it, holds none.
    table = tall("FIC1", one)
    at = table.column("time").cast(pa.timestamp("ns")).to_numpy() + np.timedelta64(1, "ns")
    write_tall(tmp_path / "a.parquet", table.set_column(1, "time", pa.array(at)))
    part = found(tmp_path / "a.parquet", FIC1, window=(START + 250.0, START + 300.0))
    assert np.array_equal(part.pv, one.pv[250:300])


def test_files_of_one_data_set_may_differ_in_zone_and_in_how_they_write_texts(tmp_path: Path, one: wb.Record) -> None:
    first, second = tall("FIC1", one, 0, 200), tall("FIC1", one, 200)
    zoned = [
        part.set_column(1, "time", part.column("time").cast(pa.timestamp("ms", zone)))
        for part, zone in ((first, "Europe/Berlin"), (second, "UTC"))
    ]
    codes = pa.array([192] * len(first))
    write_tall(tmp_path / "a.parquet", zoned[0].set_column(3, "quality", codes))
    write_tall(tmp_path / "b.parquet", zoned[1].set_column(0, "tag", zoned[1].column("tag").cast(pa.binary())))
    pieces = tuple(tags_of(tmp_path / f"{name}.parquet")["FIC1.PV"][0] for name in "ab")
    both = read_tags(pieces, FIC1, "FIC1")
    assert np.array_equal(both.pv, one.pv)
    assert both.epoch == START
    write_tall(tmp_path / "b.parquet", second)
    with pytest.raises(RecordError, match="FIC1: its files do not agree: Field time has incompatible types"):
        read_tags(pieces, FIC1, "FIC1")


@pytest.mark.parametrize("per_second", [1, 10**3, 10**6, 10**9])
def test_a_window_of_time_is_told_of_counts_too(tmp_path: Path, one: wb.Record, per_second: int) -> None:
    def counts(table: pa.Table) -> pa.Table:
        at = table.column("time").cast(pa.int64()).to_numpy() // 1000
        return table.set_column(1, "time", pa.array(at * per_second))

    write_tall(tmp_path / "a.parquet", *(counts(tall("FIC1", one, *part)) for part in ((0, 200), (200, None))))
    part = found(tmp_path / "a.parquet", FIC1, window=(START + 250.0, START + 300.0))
    assert np.array_equal(part.pv, one.pv[250:300])
    assert (part.sample_time, part.epoch + part.start) == (one.sample_time, START + 250.0)


def test_qualities_modes_and_sparse_setpoints(tmp_path: Path, one: wb.Record) -> None:
    table = tall("FIC1", one)
    quality = table.column("quality").to_pylist()
    quality[400 + 100] = quality[400 + 101] = "Bad"  # of PV, behind the 400 rows of OP
    table = table.set_column(3, "quality", pa.array(quality))
    at = pa.array([START * 1000]).cast(pa.timestamp("ms"))
    more = [
        pa.table({"tag": [tag], "time": at, "value": [value], "quality": ["Good"]})
        for tag, value in (("FIC1.SP", 51.5), ("FIC1.MODE", 1.0))
    ]
    write_tall(tmp_path / "a.parquet", pa.concat_tables([table, *more]))
    read = found(tmp_path / "a.parquet", {**FIC1, "SP": "FIC1.SP", "MODE": "FIC1.MODE"})
    assert read.counts["rejected, bad quality"] == 2
    assert len(read) == 298  # behind the bad values
    assert read.sp is not None
    assert set(read.sp.tolist()) == {51.5}
    assert set(read.mode or ()) == {"1"}


def test_times_as_text_and_values_as_text(tmp_path: Path, one: wb.Record) -> None:
    lines = ["tag,time,value"]
    for k in range(60):
        stamp = f"2024-10-17 00:{k // 60:02d}:{k % 60:02d}"
        lines += [f"FIC1.PV,{stamp},{one.pv[k]:.4f}", f"FIC1.OP,{stamp},{'No Data' if k in (3, 4) else one.op[k]}"]
    types = pa.csv.ConvertOptions(column_types={"time": pa.string(), "value": pa.string()})
    table = pa.csv.read_csv(io.BytesIO("\n".join(lines).encode()), convert_options=types)
    write_tall(tmp_path / "a.parquet", table)
    read = found(tmp_path / "a.parquet", FIC1)
    assert len(read) == 55
    assert read.counts["rejected, text"] == 2
    assert read.epoch == START


def test_what_is_missing_is_said(tmp_path: Path, one: wb.Record) -> None:
    path = tmp_path / "a.parquet"
    write_tall(path, tall("FIC1", one))
    pieces = tags_of(path)["FIC1.PV"]
    with pytest.raises(RecordError, match=r"FIC1: no tag for OP; tags: FIC1\.PV"):
        read_tags(pieces, {"PV": "FIC1.PV"}, "FIC1")
    with pytest.raises(RecordError, match=r"tag 'FIC1\.CO' holds no value"):
        read_tags(pieces, {"PV": "FIC1.PV", "OP": "FIC1.CO"}, "FIC1")
    with pytest.raises(RecordError, match="no row holds"):
        read_tags((), FIC1, "FIC1")
    wide = tmp_path / "wide.parquet"
    pq.write_table(pa.table({"PV": [1.0], "OP": [1.0]}), wide)
    with pytest.raises(RecordError, match="no column for tag"):
        tags_of(wide)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(RecordError, match="no readable Parquet"):
        tags_of(path)
    with pytest.raises(RecordError, match="no readable Parquet"):
        tags_of(tmp_path / "none.parquet")


def test_a_changed_file_is_not_read_by_the_footer_of_the_former(tmp_path: Path, one: wb.Record) -> None:
    path = tmp_path / "a.parquet"
    write_tall(path, tall("FIC1", one))
    assert len(found(path, FIC1)) == 400
    write_tall(path, tall("FIC1", one, 0, 100), tall("FIC2", one))
    assert len(found(path, FIC1)) == 100
