"""While the library works, linear algebra has one thread, and afterwards as many as before."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import workbench as wb
from workbench.simulate.one_thread import one_thread


def threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.fixture
def two():
    one_thread(threads)()  # everything that does linear algebra is loaded
    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("linear algebra has one thread here")
        yield


def test_as_many_as_before_once_it_has_ended(two):
    assert one_thread(threads)() == {1}
    assert threads() == {2}

    @one_thread
    def fails() -> None:
        assert threads() == {1}
        raise KeyError

    with pytest.raises(KeyError):
        fails()
    assert threads() == {2}


def test_an_estimate_has_one(two):
    rng = np.random.default_rng(1)
    record = wb.Record(pv=rng.normal(size=300), op=50.0 + rng.normal(size=300), sample_time=1.0)
    seen: set[int] = set()
    wb.estimate(record, plant="fopdt", valve="stenman", progress=lambda _: seen.update(threads()))
    assert seen == {1}
    assert threads() == {2}
