"""Work shared out over threads: every part once, whoever does it, and whatever goes wrong."""

from __future__ import annotations

import multiprocessing
import os
import threading
import warnings

import pytest

from workbench.simulate import batch
from workbench.simulate.batch import shared_out

MANY = 10_000_000


@pytest.fixture(autouse=True)
def several_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "cores", lambda: 3)


def parts_of(count: int, samples: int = MANY) -> list[int]:
    done: list[int] = []
    shared_out(count, samples, lambda part: done.extend(range(part.start, part.stop)))
    return sorted(done)


@pytest.mark.parametrize("count", [0, 1, 5, 6, 12, 1000])
def test_every_part_is_done_once(count: int) -> None:
    for _ in range(50):
        assert parts_of(count) == list(range(count))
    assert parts_of(count, 1) == list(range(count))


def test_threads_are_kept_and_help() -> None:
    own, helped = threading.get_ident(), threading.Event()

    def work(part: slice) -> None:
        if threading.get_ident() != own:
            helped.set()
        if part.start == 0:
            assert helped.wait(60.0)

    shared_out(1000, MANY, work)
    before = threading.active_count()
    for _ in range(20):
        parts_of(1000)
    assert threading.active_count() <= before + 1


@pytest.mark.parametrize("bad", [0, 500])
def test_what_goes_wrong_in_any_thread_comes_out(bad: int) -> None:
    def work(part: slice) -> None:
        if part.start <= bad < part.stop:
            raise IndexError("this part")

    with pytest.raises(IndexError, match="this part"):
        shared_out(1000, MANY, work)
    assert parts_of(100) == list(range(100))


def test_work_may_share_out_work() -> None:
    found: list[list[int]] = []
    shared_out(12, MANY, lambda _part: found.append(parts_of(50)))
    assert found == [list(range(50))] * len(found)
    # Two parts for each core.
    assert len(found) == 6


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_copy_of_the_process_has_threads_of_its_own() -> None:
    parts_of(1000)
    context = multiprocessing.get_context("fork")
    child = context.Process(target=_in_child)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # that the process has threads is the point
        child.start()
    child.join(60.0)
    assert child.exitcode == 0


def _in_child() -> None:
    assert parts_of(1000) == list(range(1000))
