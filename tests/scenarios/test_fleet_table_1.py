"""The site after Table I: its committed report says what the loops are, and they still say so."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

from workbench.fleet.groups import grouped
from workbench.fleet.source import sources_of
from workbench.fleet.store import read_rows
from workbench.fleet.task import look_at
from workbench.model.fleet import Settings

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "reports" / "fleet_table_1"
MANIFEST = ROOT / "scenarios" / "fleet_table_1.yaml"
# Those with stiction in Table I.
STICKY = {f"FIC{100 + number}" for number in (2, 5, 6, 7, 8, 13, 14, 15, 17, 19, 20)}


@pytest.fixture(scope="module")
def committed():
    return {row.name: row for row in read_rows(REPORT / "fleet.parquet")[0]}


def test_the_report_tells_the_sticking_valves_and_the_roots(committed) -> None:
    assert len(committed) == 20
    assert {name for name, row in committed.items() if row.sticks} == STICKY
    assert all(row.oscillates and not row.failed for row in committed.values())
    groups = {group.members: group.sticky for group in grouped(tuple(committed.values()))}
    assert groups == {
        ("FIC102", "FIC101"): True,
        ("FIC108", "FIC109"): True,
        ("FIC115", "FIC116"): True,
        ("FIC103", "FIC104"): False,
        ("FIC110", "FIC111"): False,
    }
    tuned = {name for name, row in committed.items() if math.isfinite(row.Kc)}
    assert tuned == STICKY
    assert {path.stem for path in (REPORT / "loops").iterdir()} == set(committed)
    assert sum(path.stat().st_size for path in REPORT.rglob("*") if path.is_file()) < 2 * 2**20


def test_the_csv_and_the_page_hold_the_same_loops(committed) -> None:
    rows = list(csv.DictReader((REPORT / "fleet.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["name"] for row in rows] == list(committed)
    page = (REPORT / "report.html").read_text(encoding="utf-8")
    assert all(f'href="loops/{name}.html"' in page for name in committed)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FIC102", "FIC108", "FIC109", "FIC118"])
def test_loops_still_say_the_same(name: str, committed) -> None:
    loop = next(loop for loop in sources_of(MANIFEST).loops if loop.name == name)
    row = look_at(loop, Settings()).row
    kept = committed[name]
    assert row.verdict == kept.verdict
    for figure in ("oscillation_index", "period", "likelihood", "swing", "pv_sd", "op_travel"):
        assert getattr(row, figure) == pytest.approx(getattr(kept, figure), rel=1e-5), figure
    # A byte may round either way on another machine.
    near = [min((a - b) % 256, (b - a) % 256) <= 1 for a, b in zip(row.phases, kept.phases, strict=True)]
    assert all(near)
