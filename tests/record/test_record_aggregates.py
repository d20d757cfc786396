"""Historians' aggregates: averages and last values are read as the signal and said, maxima and counts are none."""

from __future__ import annotations

from pathlib import Path

import pytest

from workbench.errors import RecordError
from workbench.record.aggregates import aggregate_of
from workbench.record.columns import loops_of, of_no_loop
from workbench.record.many import many_in
from workbench.record.names import split_tag
from workbench.record.reader import read_loop, read_record

N = 60
PV = [50 + 0.25 * (k * k % 11) for k in range(N)]
OP = [40 + 0.125 * (k * k * k % 37) for k in range(N)]
BLUNT = "averages over the historian's intervals: they blunt a valve's slips, and what moved within one is lost"


def write(folder: Path, columns: dict[str, list[float]]) -> Path:
    path = folder / "loop.csv"
    header = [f'"{name}"' if "," in name else name for name in ("t", *columns)]
    rows = [",".join(map(str, (k, *cells))) for k, cells in enumerate(zip(*columns.values(), strict=True))]
    path.write_text("\n".join([",".join(header), *rows]), encoding="utf-8")
    return path


def off(values: list[float]) -> list[float]:
    return [value + 1.0 for value in values]


@pytest.mark.parametrize(
    "form",
    [
        *("FIC101_%s_AVG", "FIC101.%s.Average", "FIC101_%s (avg)", "AVG(FIC101.%s)", "FIC101.%s - Average"),
        *("FIC101_%s_AVG (m3/h)", "FIC101.%s [EU] Mean", "FIC101.%s (m3/h) - Average", "AVG(FIC101.%s (m3/h))"),
        *("%s_AVG", "mean_%s", "Average of FIC101.%s", "MEAN(%s)", "avg(FIC101.%s) [EU]", "FIC101.%s Time Average"),
        *("FIC101.%s_AVG_1MIN", "FIC101.%s_AVG, m3/h", "avg_FIC101_%s"),
    ],
)
def test_averages_are_the_signal_and_said(tmp_path: Path, form: str) -> None:
    pv, op = form % "PV", form % "OP"
    record = read_record(write(tmp_path, {pv: PV, op: OP}))
    assert (record.pv.tolist(), record.op.tolist()) == (PV, OP)
    assert record.notes == (f"PV ({pv!r}), OP ({op!r}): {BLUNT}",)


@pytest.mark.parametrize(
    ("word", "says"),
    [
        *((word, "values that the historian interpolated") for word in ("INTERP", "Interpolated")),
        *((word, "values at the end or the beginning") for word in ("LAST", "SAMPLED", "Snapshot")),
        *((word, None) for word in ("VALUE", "VAL", "ACTUAL")),
    ],
)
def test_other_values_of_an_interval_are_the_signal(tmp_path: Path, word: str, says: str | None) -> None:
    record = read_record(write(tmp_path, {f"FIC101.PV.{word}": PV, f"FIC101.OP.{word}": OP}))
    assert (record.pv.tolist(), record.op.tolist()) == (PV, OP)
    assert len(record.notes) == (says is not None)
    assert says is None or says in record.notes[0]


@pytest.mark.parametrize("word", ["MIN", "MAX", "RANGE", "STDDEV", "COUNT"])
@pytest.mark.parametrize(
    ("form", "other"),
    [
        ("FIC101_%s_AVG", "FIC101_%s_{}"),
        ("FIC101_%s (avg)", "FIC101_%s ({})"),
        ("AVG(FIC101.%s)", "{}(FIC101.%s)"),
        ("FIC101.%s - Average", "FIC101.%s - {}"),
        ("mean_%s", "{}_%s"),
        ("FIC101.%s", "FIC101.%s ({})"),
    ],
)
def test_figures_of_an_interval_are_no_signal(tmp_path: Path, form: str, other: str, word: str) -> None:
    other = other.format(word)
    columns = {other % "PV": off(PV), form % "PV": PV, other % "OP": off(OP), form % "OP": OP, other % "SP": off(PV)}
    record = read_record(write(tmp_path, columns))
    assert (record.pv.tolist(), record.op.tolist(), record.sp) == (PV, OP, None)
    alone = write(tmp_path, {other % "PV": PV, other % "OP": OP})
    if " (" in other:  # it may be a unit
        assert "named as a figure of the historian's intervals, unless that is its unit" in read_record(alone).notes[0]
        return
    with pytest.raises(RecordError, match=r"no column for PV and OP.* is a figure of its intervals, not the signal$"):
        read_record(alone)


def test_a_time_in_minutes_is_no_minimum(tmp_path: Path) -> None:
    path = write(tmp_path, {"PV_AVG": PV, "OP_AVG": OP})
    path.write_text(path.read_text().replace("t,", "time [min],", 1))
    assert read_record(path).sample_time == 60.0


def test_what_is_nearest_to_the_signal_is_read(tmp_path: Path) -> None:
    kinds = {"_AVG": off(PV), ".INTERP": off(off(PV)), "_LAST": PV}
    columns = {f"FIC101.PV{kind}": values for kind, values in kinds.items()} | {"FIC101.OP": OP, "CV": off(OP)}
    record = read_record(write(tmp_path, columns))
    assert (record.pv.tolist(), record.op.tolist()) == (PV, OP)
    assert record.notes[0].startswith("PV ('FIC101.PV_LAST'): the values at the end")
    assert read_record(write(tmp_path, columns | {"FIC101.PV": off(PV)})).pv.tolist() == off(PV)
    assert read_record(write(tmp_path, columns), tags={"PV": "FIC101.PV_AVG"}).notes[0].endswith(BLUNT)


def test_a_quality_is_that_of_the_average_beside_it(tmp_path: Path) -> None:
    rating = [0.0 if k < 5 else 192.0 for k in range(N)]
    for name in ("FIC101.PV_AVG_Q", "FIC101.PV_Quality"):
        record = read_record(write(tmp_path, {"FIC101.PV_AVG": PV, name: rating, "FIC101.OP_AVG": OP}))
        assert record.pv.tolist() == PV[5:]


def test_loops_of_averages_have_their_names(tmp_path: Path) -> None:
    names = [f"FIC10{k}.{signal}_{kind}" for k in (1, 2) for signal in ("PV", "OP") for kind in ("AVG", "MAX")]
    loops = {f"FIC10{k}": {signal: [f"FIC10{k}.{signal}_AVG"] for signal in ("PV", "OP")} for k in (1, 2)}
    assert loops_of(names) == loops
    assert of_no_loop(["t", *names]) == names[1::2]
    assert loops_of([*names, "FIC101.PV"])["FIC101"]["PV"] == ["FIC101.PV"]
    path = write(tmp_path, {name: off(PV) if "PV" in name else OP for name in names})
    assert ("", "FIC102.PV_AVG") in many_in(path)
    record = read_loop(path, {"PV": "FIC102.PV_AVG", "OP": "FIC102.OP_AVG"})
    assert (record.pv.tolist(), len(record.notes)) == (off(PV), 1)
    # Another loop's average is not this one's, though its raw values stand beside it.
    columns = {"A.PV": PV, "A.OP": OP, "B.PV": OP, "B.OP": PV, "B.SP": PV, "B.SP_AVG": PV}
    assert read_record(write(tmp_path, columns), tags={"PV": "A.PV", "OP": "A.OP"}).sp is None


@pytest.mark.parametrize(
    "name",
    ["MIN_FLOW.PV", "Total Output", "LAST_STAGE_PV", "MEANDER.PV", "COUNT5.PV", "PV (counts)", "Average"],
)
def test_names_that_only_begin_so_are_no_aggregates(name: str) -> None:
    assert aggregate_of(name) == (name, "")


def test_a_name_of_any_length_is_looked_through_soon() -> None:
    assert split_tag("avg " + "(a " * 20_000) is None


def test_tall_averages_are_said(tmp_path: Path) -> None:
    path = tmp_path / "tall.csv"
    rows = [f"FIC101.{s}{{}},{k},{v}" for s, values in (("PV", PV), ("OP", OP)) for k, v in enumerate(values)]
    path.write_text("\n".join(["Tag,Time,Value", *rows]).replace("{}", ".AVG"))
    assert read_record(path).notes[0] == f"PV ('FIC101.PV.AVG'), OP ('FIC101.OP.AVG'): {BLUNT}"
    path.write_text("\n".join(["Tag,Time,Average", *rows]).replace("{}", ""))
    assert read_record(path).notes[0] == f"column 'Average': {BLUNT}"
