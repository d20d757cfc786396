"""The stretch and rate that a day of a loop is judged by."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import workbench as wb
from workbench.detect.oscillation import oscillation_of
from workbench.fleet.sampling import PER_CYCLE, WINDOW, cycle_of, means, oscillation_at_any_rate, stretch, thinned


def wave(n: int, period: float, noise: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.sin(2.0 * math.pi * np.arange(n) / period) + rng.normal(0.0, noise, n)


def of(pv: np.ndarray, **more: object) -> wb.Record:
    op = np.cumsum(pv) / 100.0 + 50.0
    return wb.Record(pv, op, 1.0, **more)  # type: ignore[arg-type]


@given(period=st.floats(60.0, 2000.0), noise=st.floats(0.0, 0.5), seed=st.integers(0, 50))
def test_a_cycle_is_found_under_noise_at_some_rate(period: float, noise: float, seed: int) -> None:
    seen = oscillation_at_any_rate(wave(20_000, period, noise, seed), 1.0)
    assert seen.oscillation.period == pytest.approx(period, rel=0.05)
    # What is left of the index is the wave's share of the variance.
    assert seen.oscillation.index == pytest.approx(0.5 / (0.5 + noise**2), abs=0.1)


def test_the_full_rate_alone_would_miss_it() -> None:
    pv = wave(20_000, 1000.0, 1.0)
    assert oscillation_of(pv, 1.0).regularity < 1.0
    seen = oscillation_at_any_rate(pv, 1.0)
    assert seen.factor > 1
    assert seen.oscillation.period == pytest.approx(1000.0, rel=0.02)


def test_noise_and_constants_show_no_cycle() -> None:
    assert oscillation_at_any_rate(np.random.default_rng(1).normal(size=20_000), 1.0).oscillation.index < 0.1
    assert oscillation_at_any_rate(np.full(5000, 3.0), 1.0).oscillation.index == 0.0
    assert oscillation_at_any_rate(np.arange(10.0), 1.0).factor == 1


def test_a_long_record_is_cut_and_thinned_to_the_cycle() -> None:
    record = of(wave(50_000, 800.0, 0.1))
    part = stretch(record, oscillation_at_any_rate(record.pv, 1.0))
    assert len(part) == WINDOW
    assert 800.0 / part.sample_time == pytest.approx(PER_CYCLE, rel=0.1)
    # A short one stays as it is.
    short = of(wave(1000, 40.0, 0.1))
    assert stretch(short, oscillation_at_any_rate(short.pv, 1.0)) is short


def test_the_window_is_where_the_cycle_is_strongest() -> None:
    pv = np.random.default_rng(2).normal(0.0, 1.0, 48_000)
    pv[30_000:36_000] += 3.0 * wave(6000, 40.0, 0.0)
    record = of(pv)
    part = stretch(record, oscillation_at_any_rate(record.pv, 1.0))
    middle = part.start + 0.5 * len(part) * part.sample_time
    assert 28_000 < middle < 38_000


def test_means_and_times() -> None:
    record = wb.Record(
        np.arange(10.0), np.arange(10.0) * 2.0, 2.0, sp=np.ones(10), start=100.0, epoch=5.0, mode=tuple("aabbccddee")
    )
    part = thinned(record, 3, 1, 2)
    assert part.pv.tolist() == [2.0, 5.0]
    assert part.op.tolist() == [4.0, 10.0]
    assert part.sample_time == 6.0
    # The mean of samples 1, 2, 3 stands for sample 2.
    assert part.start == 104.0
    assert part.epoch == 5.0
    assert part.mode == ("a", "c")
    assert means(record.pv, 4).tolist() == [1.5, 5.5]
    assert thinned(record, 1) is record


def test_setpoint_steps_hide_no_cycle() -> None:
    sp = np.repeat([50.0, 56.0, 53.0, 58.0], 1500)
    record = of(sp + wave(sp.size, 400.0, 0.1), sp=sp)
    assert oscillation_at_any_rate(record.pv, 1.0).oscillation.index < 0.3
    seen = cycle_of(record)
    assert seen.oscillation.period == pytest.approx(400.0, rel=0.05)
    assert seen.oscillation.index > 0.9
    # A loop that follows a setpoint that cycles goes with it.
    cycling = of(wave(6000, 400.0, 0.1), sp=wave(6000, 400.0, 0.0))
    assert cycle_of(cycling).oscillation.period == pytest.approx(400.0, rel=0.05)
