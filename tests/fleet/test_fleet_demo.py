"""The synthetic site: what it claims of its loops is so."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from workbench.errors import InvalidValue, OutputError
from workbench.fleet.demo import KINDS, MEMBERS, site, write_site
from workbench.fleet.source import sources_of
from workbench.fleet.task import read
from workbench.model.fleet import Settings


def test_loops_depend_on_seed_and_place_alone() -> None:
    ten, twenty = list(site(10, 2000)), list(site(20, 2000))
    for a, b in zip(ten, twenty, strict=False):
        assert (a.truth.name, a.truth.kind, a.truth.stiction) == (b.truth.name, b.truth.kind, b.truth.stiction)
        assert np.array_equal(a.pv, b.pv)
        assert np.array_equal(a.op, b.op)
    assert not np.array_equal(ten[0].pv, next(iter(site(1, 2000, seed=1))).pv)


def test_every_kind_is_there_and_groups_have_their_root() -> None:
    made = list(site(40, 3000))
    truths = [one.truth for one in made]
    assert {truth.kind for truth in truths} == set(KINDS)
    assert len({truth.name for truth in truths}) == 40
    by = {truth.name: truth for truth in truths}
    roots = {truth.root for truth in truths if truth.kind == "coupled"}
    assert all(by[root].kind == "sticky" for root in roots)
    assert all(sum(truth.root == root for truth in truths) == MEMBERS for root in roots)
    for one in made:
        assert one.op.min() >= 0.0
        assert one.op.max() <= 100.0
        if one.truth.kind == "saturated":
            assert np.mean(one.op == one.op.max()) > 0.5
        if one.truth.kind == "sticky":
            assert one.truth.stiction > 0.0


def test_the_files_hold_what_was_made(tmp_path: Path) -> None:
    truths = write_site(tmp_path / "site", 6, 0.25, seed=3)
    loops = sources_of(tmp_path / "site").loops
    assert sorted(truth.name for truth in truths) == [loop.name for loop in loops]
    for loop, made in zip(loops, sorted(site(6, 900, seed=3), key=lambda one: one.truth.name), strict=True):
        record = read(loop, Settings())
        assert np.array_equal(record.pv, made.pv)
        assert np.array_equal(record.op, made.op)
        assert record.sp is not None
        assert np.array_equal(record.sp, made.sp)
        assert record.mode == ("1",) * 900
    rows = list(csv.DictReader((tmp_path / "site" / "_truth.csv").read_text().splitlines()))
    assert [row["loop"] for row in rows] == [truth.name for truth in truths]
    assert [row["verdict"] for row in rows] == [truth.verdict for truth in truths]


def test_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InvalidValue, match="loops: 0 given"):
        write_site(tmp_path / "a", 0)
    with pytest.raises(InvalidValue, match="hours"):
        write_site(tmp_path / "a", 1, 0.0)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("")
    with pytest.raises(OutputError, match="holds files already"):
        write_site(tmp_path / "full", 1, 0.25)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        write_site(tmp_path / "file" / "x", 1, 0.25)
