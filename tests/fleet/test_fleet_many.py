"""Files of many loops in a folder and in a manifest: each loop a row of its own."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fleet_helpers import START, record, tall, write_csv, write_tall
from typer.testing import CliRunner

import workbench as wb
from workbench.cli import app
from workbench.errors import ScenarioError
from workbench.fleet.run import run_fleet
from workbench.fleet.source import sources_of
from workbench.fleet.task import Result, look_at, read
from workbench.model.fleet import FleetRow, LoopSource, Settings

N = 200


@pytest.fixture(scope="module")
def records() -> dict[str, wb.Record]:
    return {"FIC1": record(sticky=True, n=N), "FIC2": record(sticky=False, n=N, seed=1), "LIC3": record(True, N, 2)}


def columns(records: dict[str, wb.Record], *signals: str) -> dict[str, list[float]]:
    """The columns of a wide file of many loops, FIC1.PV and so on, with times in seconds since 1970."""
    out = {"Time": (START + np.arange(N)).tolist()}
    for name, one in records.items():
        for signal in signals or ("PV", "OP", "SP"):
            out[f"{name}.{signal}"] = getattr(one, signal.lower()).tolist()
    return out


def write_wide(path: Path, table: dict[str, list[float]], header: str = "") -> None:
    rows = "".join(",".join(f"{cell:.10g}" for cell in row) + "\n" for row in zip(*table.values(), strict=True))
    path.write_text((header or ",".join(table)) + "\n" + rows)


def by_name(path: Path) -> dict[str, LoopSource]:
    return {loop.name: loop for loop in sources_of(path).loops}


def same(loops: dict[str, LoopSource], records: dict[str, wb.Record]) -> None:
    for name, one in records.items():
        ours = read(loops[name], Settings())
        assert np.allclose(ours.pv, one.pv, rtol=1e-8, atol=0.0)
        assert np.allclose(ours.op, one.op, rtol=1e-8, atol=0.0)


def test_files_of_many_beside_files_of_one(tmp_path: Path, records: dict[str, wb.Record]) -> None:
    renamed = {f"N{k}": one for k, one in enumerate(records.values())}
    write_wide(tmp_path / "wide.csv", columns(records))
    pq.write_table(pa.table(columns(renamed)), tmp_path / "wide.parquet")
    write_csv(tmp_path / "alone.csv", records["FIC1"])
    write_wide(tmp_path / "tagged.csv", columns({"FIC9": records["FIC1"]}))  # of one loop: the file's name
    lines = ["Element,Attribute,Timestamp,Value"]
    for k in range(N):
        for name, one in records.items():
            lines += [f"A{name},{s},{START + k},{getattr(one, s.lower())[k]:.10g}" for s in ("PV", "OP")]
    (tmp_path / "tall.csv").write_text("\n".join(lines))
    write_tall(tmp_path / "set" / "x.parquet", tall("X1", records["FIC1"]), tall("X2", records["FIC2"]))
    sources = sources_of(tmp_path)
    assert [loop.name for loop in sources.loops] == [
        *("AFIC1", "AFIC2", "ALIC3", "FIC1", "FIC2", "LIC3", "N0", "N1", "N2", "X1", "X2", "alone", "tagged")
    ]
    assert sources.notes == ()
    assert not any(loop.refusal for loop in sources.loops)
    same(by_name(tmp_path), records | renamed | {f"A{name}": one for name, one in records.items()})
    assert sources.loops == sources_of(tmp_path).loops  # by which --resume knows them


def test_a_row_of_many_is_that_of_a_file_of_its_own(tmp_path: Path, records: dict[str, wb.Record]) -> None:
    (tmp_path / "each").mkdir()
    for name, one in records.items():
        table = columns({name: one})
        write_wide(tmp_path / "each" / f"{name}.csv", table, "Time,PV,OP,SP")
    (tmp_path / "many").mkdir()
    write_wide(tmp_path / "many" / "x.csv", columns(records) | {"Ambient": [20.0] * N})
    for settings in (Settings(), Settings(begin=START + 20.0, end=START + 150.0), Settings(last=100.0)):
        rows = [
            [look_at(loop, settings).row for loop in sources_of(tmp_path / kind).loops] for kind in ("each", "many")
        ]
        assert [repr(row) for row in rows[0]] == [repr(row) for row in rows[1]]
        assert {row.status for row in rows[1]} == {"ok"}


def stamp(k: int, form: str = "%Y-%m-%d %H:%M:%S") -> str:
    return datetime.fromtimestamp(START + k + (40 if k >= 150 else 0), UTC).strftime(form)


def forms(folder: Path, records: dict[str, wb.Record]) -> dict[str, Path]:
    """The same loops in files of many: text among PV, a gap in time, one bad value, and a loop without OP."""
    table = {k: [f"{x:.4f}" for x in cells] for k, cells in columns(records).items() if k not in ("Time", "FIC2.OP")}
    table["FIC1.PV"][60] = "Bad Input"
    table["LIC3.PV"][20] = ""
    rows = list(zip(*table.values(), strict=True))

    def german(cell: str) -> str:
        return cell.replace(".", ",")

    def wide(path: Path, mark: str, time: str, form: str, said: Callable[[str], str], **how: str) -> Path:
        lines = [mark.join([time, *table])]
        lines += [mark.join([stamp(k, form), *map(said, row)]) for k, row in enumerate(rows)]
        path.write_text("\n".join(lines) + "\n", **how)  # type: ignore[arg-type]
        return path

    def long(path: Path, mark: str, header: str, form: str, said: Callable[[str], str], **how: str) -> Path:
        lines = [header]
        for k, row in enumerate(rows):
            lines += [mark.join([tag, stamp(k, form), said(x), "Good"]) for tag, x in zip(table, row, strict=True)]
        path.write_text("\n".join(lines), **how)  # type: ignore[arg-type]
        return path

    days = "%d.%m.%Y %H:%M:%S"
    out = {
        "wide": wide(folder / "wide.csv", ",", "Time", "%Y-%m-%d %H:%M:%S", str),
        "semicolons": wide(folder / "semicolons.csv", ";", "Zeit", days, german, encoding="cp1252", newline="\r\n"),
        "tall": long(folder / "tall.csv", ",", "Tag,Timestamp,Value,Quality", "%Y-%m-%d %H:%M:%S", str),
        "tall, semicolons": long(
            folder / "tall_german.csv", ";", "Tag;Zeit;Wert;Qualit\u00e4t", days, german, encoding="cp1252"
        ),
        "Parquet": folder / "wide.parquet",
    }
    times = pa.array([datetime.fromisoformat(stamp(k)) for k in range(N)])
    pq.write_table(pa.table({"Time": times, **{k: pa.array(v) for k, v in table.items()}}), out["Parquet"])
    return out


def test_rows_are_the_same_by_all_forms_of_a_file(tmp_path: Path, records: dict[str, wb.Record]) -> None:
    told: dict[str, list[FleetRow]] = {}
    for form, path in forms(tmp_path, records).items():
        told[form] = [look_at(loop, Settings()).row for loop in sources_of(path).loops]
    for rows in told.values():
        assert [(row.name, row.status) for row in rows] == [("FIC1", "ok"), ("FIC2", "failed"), ("LIC3", "ok")]
        assert "no tag for OP" in rows[1].reason
        # Notes name columns or tags, and each file's own lines.
        bare = [replace(row, notes="", reason="") for row in rows]
        assert repr(bare) == repr([replace(row, notes="", reason="") for row in told["wide"]])
    assert "text ('Bad Input'), first in line 62, column 'FIC1.PV'" in told["wide"][0].notes
    assert "text ('Bad Input'), first in line 62, column 'FIC1.PV'" in told["semicolons"][0].notes
    assert "text ('Bad Input'), first in line 482, tag 'FIC1.PV'" in told["tall"][0].notes
    assert "text ('Bad Input'), first in line 482, tag 'FIC1.PV'" in told["tall, semicolons"][0].notes
    assert "text ('Bad Input'), first in row 61, column 'FIC1.PV'" in told["Parquet"][0].notes
    assert told["wide"][0].samples == 150  # what lies beyond the gap is another stretch


@pytest.mark.parametrize("form", ["wide", "tall"])
def test_a_file_that_changes_under_way_is_a_reason(tmp_path: Path, records: dict[str, wb.Record], form: str) -> None:
    path = forms(tmp_path, records)[form]
    loop = by_name(path)["FIC1"]
    whole = path.read_bytes()
    for now, said in (
        (whole.replace(b"FIC1.OP", b"FIC9.OP"), "'FIC1.OP' given for OP: there is no such "),
        (whole.replace(b"FIC1", b"FIC8"), "no such column" if form == "wide" else "no row of data of 'FIC1.OP', 'FIC1"),
        (whole[:20], "there is no such column" if form == "wide" else "no row of data of"),
        (b"", "empty"),
    ):
        path.write_bytes(now)
        row = look_at(loop, Settings()).row
        assert row.failed
        assert said in row.reason
        assert "\n" not in row.reason
        assert "unexpected" not in row.reason
    path.unlink()
    assert "no such file" in look_at(loop, Settings()).row.reason
    path.write_bytes(whole)
    assert not look_at(loop, Settings()).row.failed


def test_a_run_of_one_file_that_is_stopped_goes_on(tmp_path: Path, records: dict[str, wb.Record]) -> None:
    sources = sources_of(forms(tmp_path, records)["tall"])

    def stop(done: int, total: int, failed: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_fleet(sources, tmp_path / "out", Settings(), progress=stop)
    outcome = run_fleet(sources, tmp_path / "out", Settings(), resume=True)
    assert outcome.resumed <= 1
    run_fleet(sources, tmp_path / "other", Settings(), workers=2)
    assert (tmp_path / "out" / "fleet.csv").read_text() == (tmp_path / "other" / "fleet.csv").read_text()
    # Beside the file itself nothing was written.
    assert {path.name for path in tmp_path.iterdir() if path.is_dir()} == {"out", "other"}
    assert not (tmp_path / "out" / "parts").exists()


def test_a_file_of_one_loop_may_be_the_source(tmp_path: Path, records: dict[str, wb.Record]) -> None:
    write_csv(tmp_path / "FIC1.csv", records["FIC1"])
    assert not look_at(by_name(tmp_path / "FIC1.csv")["FIC1"], Settings()).row.failed
    (tmp_path / "x.csv").write_bytes("Zeit;Me\u00dfgr\u00f6\u00dfe\n1;2\n".encode("cp1252"))
    reason = look_at(by_name(tmp_path / "x.csv")["x"], Settings()).row.reason
    assert "no column for PV and OP; the file has 'Zeit', 'Me\u00dfgr\u00f6\u00dfe'" in reason
    (tmp_path / "y.csv").write_text("")
    with pytest.raises(ScenarioError, match="a manifest has a line per loop"):
        sources_of(tmp_path / "y.csv")


def test_loops_of_a_file_that_cannot_be_read_are_rows_and_the_others_stay(
    tmp_path: Path, records: dict[str, wb.Record]
) -> None:
    table = columns(records, "PV", "OP")
    table["TI5.PV"] = table["FIC1.PV"]
    table |= {"Ambient": table["FIC1.PV"], "Density": table["FIC1.PV"], "FIC1.PV Quality": table["FIC1.PV"]}
    header = ",".join(table).replace("LIC3.OP", "LIC3.PV")  # twice, and no OP
    write_wide(tmp_path / "x.csv", table, header)
    loops = by_name(tmp_path)
    refusals = {name: loop.refusal for name, loop in loops.items() if loop.refusal}
    assert set(loops) - set(refusals) == {"FIC1", "FIC2"}
    assert refusals["TI5"] == "no tag for OP (tags: TI5.PV)"
    assert f"'LIC3.PV' is there 2 times, in {tmp_path / 'x.csv'}" in refusals["LIC3"]
    assert sources_of(tmp_path).notes == (f"{tmp_path / 'x.csv'}: of no loop, and not used: Ambient, Density",)
    assert read(loops["FIC2"], Settings()).sp is None


def test_a_name_in_two_files_is_refused(tmp_path: Path, records: dict[str, wb.Record]) -> None:
    write_wide(tmp_path / "a.csv", columns(records))
    shutil.copy(tmp_path / "a.csv", tmp_path / "b.csv")
    refusal = by_name(tmp_path)["FIC1"].refusal
    assert refusal.startswith("2 loops have this name (")
    assert "a.csv" in refusal
    assert "b.csv" in refusal


def test_a_file_that_cannot_be_parted_names_the_line_of_a_manifest(
    tmp_path: Path, records: dict[str, wb.Record]
) -> None:
    table = columns({"FIC1": records["FIC1"]}, "PV", "OP")
    write_wide(tmp_path / "x y.csv", table | {"FIC2.PV": table["FIC1.PV"]}, "Time,FIC1.PV,OP,FIC2.PV")
    (loop,) = sources_of(tmp_path).loops
    reason = look_at(loop, Settings()).row.reason
    assert "columns 'FIC1.PV', 'FIC2.PV' could each be PV" in reason
    line = reason.partition("a line of a manifest: ")[2]
    assert line == "- {name: x y, file: x y.csv, columns: {PV: FIC1.PV}}"
    (tmp_path / "m.yaml").write_text(f"loops:\n  {line}\n")
    assert look_at(by_name(tmp_path / "m.yaml")["x y"], Settings()).row.status == "ok"


@pytest.mark.parametrize("data", ["site", "site/x.csv"])
def test_a_manifest_says_more_of_the_loops_of_a_file(tmp_path: Path, records: dict[str, wb.Record], data: str) -> None:
    (tmp_path / "site").mkdir()
    write_wide(tmp_path / "site" / "x.csv", columns(records))
    (tmp_path / "m.yaml").write_text(
        f"data: {data}\n"
        "loops:\n"
        "  - {name: FIC1, pv_range: [0, 100], criticality: 4}\n"
        "  - {name: other, tags: {PV: FIC2.PV, OP: LIC3.OP}}\n"
        "  - {name: FIC7}\n"
        "  - {name: none, tags: {PV: FIC2.PV, OP: LIC3.OUT}}\n"
    )
    loops = by_name(tmp_path / "m.yaml")
    assert read(loops["FIC1"], Settings()).pv_range == (0.0, 100.0)
    assert loops["FIC1"].criticality == 4
    assert np.allclose(read(loops["other"], Settings()).op, records["LIC3"].op, rtol=1e-8)
    assert "no tag of this name" in loops["FIC7"].refusal
    assert "tag 'LIC3.OUT' of OP is not in the data" in loops["none"].refusal


def test_tags_of_a_loop_in_two_files_are_refused(tmp_path: Path, records: dict[str, wb.Record]) -> None:
    (tmp_path / "site").mkdir()
    write_wide(tmp_path / "site" / "x.csv", columns(records))
    write_wide(tmp_path / "site" / "y.csv", columns({f"N{k}": one for k, one in enumerate(records.values())}))
    (tmp_path / "m.yaml").write_text("data: site\nloops:\n  - {name: a, tags: {PV: FIC2.PV, OP: N1.OP}}\n")
    assert "its tags are in 2 files" in by_name(tmp_path / "m.yaml")["a"].refusal
    (tmp_path / "n.yaml").write_text("data: site/z.csv\nloops:\n  - {name: a}\n")
    write_csv(tmp_path / "site" / "z.csv", records["FIC1"])
    with pytest.raises(ScenarioError, match=r"data: .*z\.csv"):
        sources_of(tmp_path / "n.yaml")


class InLine:
    """Looks at loops in this process."""

    def run(self, loops: Iterable[LoopSource]) -> Iterator[Result]:
        for loop in loops:
            yield look_at(loop, Settings())


def test_the_command_tells_loops_and_what_is_of_none(
    tmp_path: Path, records: dict[str, wb.Record], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("workbench.fleet.run._engine", lambda *_: nullcontext(InLine()))
    two = {name: records[name] for name in ("FIC1", "FIC2")}
    write_wide(tmp_path / "x.csv", columns(two) | {"Ambient": [20.0] * N, "TI5.PV": [1.0] * N})
    done = CliRunner().invoke(app, ["fleet", str(tmp_path / "x.csv"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 1
    assert done.stdout.count("Ambient") == 1
    assert "2 loops looked at" in done.stdout
    assert "TI5: not looked at: no tag for OP" in done.stdout
    done = CliRunner().invoke(app, ["estimate", str(tmp_path / "x.csv")])
    assert done.exit_code == 2
    assert '--column "PV=FIC1.PV" --column "OP=FIC1.OP" for FIC1; the file holds 2 loops' in done.stderr
