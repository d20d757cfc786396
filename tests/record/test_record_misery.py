"""A historian's misery, from the file to the verdict: one clear message or an honest answer, and never a traceback."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.errors import InvalidValue, RecordError, WorkbenchError

VERDICTS = {"stiction", "no_stiction", "undecided"}


@cache
def sticky() -> tuple[np.ndarray, np.ndarray]:
    """PV and OP of a loop that cycles for its valve, shape (600,)."""
    loop = wb.Loop(wb.FOPDT(1.0, 3.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=10.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(700.0, setpoint=wb.Step(3.0, at=300.0), noise=wb.Noise(0.05, 1)))
    return (run.pv[100:] + 50.0).round(3), (run.op[100:] + 40.0).round(3)


def wide(folder: Path, pv: list[str], op: list[str], times: list[str] | None = None, more: str = "") -> Path:
    path = folder / "loop.csv"
    times = times or [str(k) for k in range(len(pv))]
    rows = [f"{t},{y},{u}{more}" for t, y, u in zip(times, pv, op, strict=True)]
    path.write_text("\n".join(["t,PV,OP" + (",MODE" if more else ""), *rows]), encoding="utf-8")
    return path


def texts(values: np.ndarray) -> list[str]:
    return [f"{v:g}" for v in values.tolist()]


def outcome(path: Path, **reading: object) -> str:
    """The verdict on a file, or the message that it is refused with."""
    try:
        return wb.estimate(wb.read_record(path, **reading)).verdict  # type: ignore[arg-type]
    except WorkbenchError as error:
        said = str(error)
        assert said.strip()
        assert "\n" not in said
        return said


Column = list[str]

# Name: PV and OP as text, made of those of the sticky loop, and what must be in the outcome.
CASES: dict[str, tuple[Callable[[Column, Column], tuple[Column, Column]], str]] = {
    "one sample": (lambda pv, op: (pv[:1], op[:1]), "at least two are needed"),
    "a few samples": (lambda pv, op: (pv[:20], op[:20]), "20 samples given; at least 30"),
    "PV constant": (lambda pv, op: (["50"] * len(pv), op), "PV is constant (50)"),
    "OP never moves": (lambda pv, op: (pv, ["100"] * len(op)), "OP is constant (100)"),
    "all text": (
        lambda pv, op: (["No Data"] * len(pv), op),
        "line 2, column 'PV': no row holds a usable number, the first is text ('No Data')",
    ),
    "cells with units": (lambda pv, op: ([f"{v} m3/h" for v in pv], op), "first is text ('"),
    "all infinite": (
        lambda pv, op: (pv, ["inf"] * len(op)),
        "column 'OP': no row holds a usable number, the first is not finite",
    ),
    "all nan": (
        lambda pv, op: (["NaN"] * len(pv), ["NaN"] * len(op)),
        "no row holds a usable number, the first is not finite",
    ),
    "fill values": (lambda pv, op: (["1e300"] * len(pv), op), "the first is beyond 1e+100 in size"),
    "every other row bad": (
        lambda pv, op: ([v if k % 2 else "Bad" for k, v in enumerate(pv)], op),
        "no two clean rows follow each other",
    ),
    "PV is OP": (lambda _, op: (op, op), "PV and OP hold the same values in all 600 kept rows"),
    "noise": (
        lambda pv, op: (
            texts(np.random.default_rng(1).normal(50, 1, len(pv))),
            texts(np.random.default_rng(2).normal(50, 1, len(op))),
        ),
        "undecided",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_misery_has_a_clear_outcome(tmp_path: Path, name: str) -> None:
    y, u = sticky()
    made, words = CASES[name]
    said = outcome(wide(tmp_path, *made(texts(y), texts(u))))
    assert words in said, said


def test_the_loop_itself_is_found(tmp_path: Path) -> None:
    y, u = sticky()
    assert outcome(wide(tmp_path, texts(y), texts(u))) == "stiction"


def test_a_loop_in_manual_with_moves_of_the_operator_is_read_with_a_warning(tmp_path: Path) -> None:
    y, u = sticky()
    path = wide(tmp_path, texts(y), texts(u), more=",MAN")
    assert any("never in automatic" in note for note in wb.read_record(path).notes)
    found = wb.estimate(wb.read_record(path))
    assert any("manual in 100%" in reason for reason in found.reasons)


@pytest.mark.parametrize(
    ("reading", "words"),
    [
        ({"sample_time": 0.0}, "sample_time"),
        ({"max_gap": -1.0}, "max_gap"),
        ({"max_gap": float("nan")}, "max_gap"),
        ({"pv_range": (0.0,)}, "pv_range"),
        ({"pv_range": (5.0, 1.0)}, "pv_range"),
        ({"pv_range": 5.0}, "pv_range"),
        ({"pv_range": "0:100"}, "pv_range"),
        ({"columns": ["PV"]}, "columns"),
        ({"op_range": (4.0, 20.0)}, "OP runs from"),
        ({"tags": {"FLOW": "PV"}}, "'FLOW'"),
        ({"tags": {"PV": "no such"}}, "no such column"),
    ],
)
def test_wrong_wishes_are_refused(tmp_path: Path, reading: dict[str, object], words: str) -> None:
    y, u = sticky()
    path = wide(tmp_path, texts(y), texts(u))
    with pytest.raises((RecordError, InvalidValue), match=words):
        wb.read_record(path, **reading)  # type: ignore[arg-type]


# A busy machine is no defect.
CALM = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
quiet = settings(max_examples=100, deadline=None, suppress_health_check=CALM)
words = st.sampled_from(
    ["", "Bad Input", "I/O Timeout", "No Data", "nan", "inf", "-inf", "1e300", "1,5", '"', "0", "-0.0", "1e-320", "x;y"]
)
cell = st.one_of(words, st.floats(-1e3, 1e3).map(repr), st.integers(-3, 120).map(str), st.text(max_size=3))
clock = st.one_of(
    st.integers(0, 60).map(str),
    st.integers(0, 90).map(lambda k: f"2024-10-27 0{1 + k // 60}:{k % 60:02d}:00"),
    st.sampled_from(["27.10.2024 02:30:00", "10/27/2024 2:30 PM", "", "1e300", "yesterday", "45291.5"]),
)


@quiet
@given(
    rows=st.lists(
        st.tuples(st.sampled_from(["A.PV", "A.OP", "A.SP", "A.MODE", "B.PV", ""]), clock, cell, words), max_size=40
    ),
    sep=st.sampled_from([",", ";"]),
    max_gap=st.sampled_from([None, 5.0, 1e9]),
    sample_time=st.sampled_from([None, None, 1.0, 60.0]),
    tags=st.sampled_from([None, {"PV": "A.PV"}]),
)
def test_random_tall_files_give_a_record_or_our_own_error(
    tmp_path: Path,
    rows: list[tuple[str, str, str, str]],
    sep: str,
    max_gap: float | None,
    sample_time: float | None,
    tags: dict[str, str] | None,
) -> None:
    path = tmp_path / "tall.csv"
    path.write_text("\n".join([sep.join(("Tag", "Time", "Value", "Quality")), *map(sep.join, rows)]), "utf-8")
    with suppress(WorkbenchError):
        record = wb.read_record(path, tags=tags, max_gap=max_gap, sample_time=sample_time)
        holds(record)


value = st.one_of(*[st.integers(-800, 800).map(lambda k: str(k / 8))] * 9, words)
moment = st.sampled_from([0.0, 0.5, 1.0, 1.0, 1.0, 3.0, 40.0])
history = st.lists(st.tuples(moment, value, st.sampled_from(["Good"] * 9 + ["Bad"])), min_size=5, max_size=30)


@quiet
@given(
    tags=st.fixed_dictionaries(
        {"PV": history, "OP": history}, optional={"SP": history, "MODE": history, "ZT": history}
    ),
    by_time=st.booleans(),
    max_gap=st.sampled_from([None, None, 2.0, 1e9]),
    sample_time=st.sampled_from([None, None, 0.3, 1.0]),
    op_range=st.sampled_from([None, (-1e3, 1e3)]),
)
def test_random_histories_give_a_record_or_our_own_error(
    tmp_path: Path,
    tags: dict[str, list[tuple[float, str, str]]],
    by_time: bool,
    max_gap: float | None,
    sample_time: float | None,
    op_range: tuple[float, float] | None,
) -> None:
    rows: list[tuple[float, str]] = []
    for tag, values in tags.items():
        times = np.cumsum([step for step, *_ in values]).tolist()
        rows += [(t, f'F.{tag},{t},"{v}",{q}'.replace('"""', '"')) for t, (_, v, q) in zip(times, values, strict=True)]
    if by_time:
        rows.sort(key=lambda row: row[0])
    path = tmp_path / "tall.csv"
    path.write_text("\n".join(["tag,time,value,quality", *(text for _, text in rows)]), "utf-8")
    with suppress(WorkbenchError):
        record = wb.read_record(path, max_gap=max_gap, sample_time=sample_time, op_range=op_range)
        holds(record)
        if "resampled" in record.counts and sample_time is not None:
            assert record.sample_time == sample_time


def holds(record: wb.Record) -> None:
    """What every record promises."""
    assert record.counts["kept"] == len(record) >= 2
    assert record.counts.get("left out", 0) >= sum(len(part) for part in record.rest)
    for part in record.segments:
        assert np.isfinite(part.pv).all()
        assert np.isfinite(part.op).all()
        assert np.isfinite(part.time).all()
    starts = [part.start for part in record.segments]
    assert starts == sorted(starts)
    assert record.summary()[1:] == record.notes


@quiet
@given(
    data=st.data(),
    n=st.integers(40, 160),
    modes=st.booleans(),
    max_gap=st.sampled_from([None, None, 3.0, 50.0]),
    pv_range=st.sampled_from([None, (0.0, 100.0), (49.0, 53.0)]),
)
def test_damaged_records_give_a_record_or_our_own_error(
    tmp_path: Path,
    data: st.DataObject,
    n: int,
    modes: bool,
    max_gap: float | None,
    pv_range: tuple[float, float] | None,
) -> None:
    path = damaged(tmp_path, data, n, modes)
    with suppress(WorkbenchError):
        holds(wb.read_record(path, max_gap=max_gap, pv_range=pv_range))


def damaged(folder: Path, data: st.DataObject, n: int, modes: bool) -> Path:
    """The sticky loop's file after a few accidents."""
    y, u = sticky()
    rows = [[str(k), pv, op, "AUTO"] for k, (pv, op) in enumerate(zip(texts(y[:n]), texts(u[:n]), strict=True))]
    place = st.integers(0, n - 1)
    for _ in range(data.draw(st.integers(0, 6))):
        first, stop = sorted((data.draw(place), data.draw(place)))
        what = data.draw(st.sampled_from(["cell", "time", "frozen", "gone", "mode", "late", "twice", "zero"]))
        for k in range(first, min(stop, len(rows))):
            if what == "frozen":
                rows[k][1] = rows[first][1]
            elif what == "mode":
                rows[k][3] = "MAN"
            elif what == "late":
                rows[k][0] = str(float(rows[k][0].strip() or 0) + 0.4)
            elif what == "zero":
                rows[k][2] = "0"
        if what == "cell" and first < len(rows):
            rows[first][data.draw(st.integers(1, 2))] = (
                data.draw(cell).replace(",", "").replace("\n", "").replace("\r", "")
            )
        elif what == "time" and first < len(rows):
            rows[first][0] = str(data.draw(st.integers(-5, n)))
        elif what == "gone":
            del rows[first:stop]
        elif what == "twice" and first < len(rows):
            rows.insert(first, list(rows[first]))
    path = folder / "loop.csv"
    lines = ["t,PV,OP" + (",MODE" if modes else "")]
    lines += [",".join(row if modes else row[:3]) for row in rows]
    path.write_text("\n".join(lines), encoding="utf-8", errors="replace")
    return path


@pytest.mark.slow
@settings(max_examples=6, deadline=None, suppress_health_check=CALM)
@given(data=st.data(), n=st.integers(60, 200), modes=st.booleans())
def test_damaged_records_are_estimated_or_refused(tmp_path: Path, data: st.DataObject, n: int, modes: bool) -> None:
    said = outcome(damaged(tmp_path, data, n, modes))
    assert said in VERDICTS or str(tmp_path) in said
