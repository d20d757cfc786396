"""OP as a historian rounds it: where that decides which way a stem goes, nothing is called known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import LEAST_TAU, Limits, fit_path, start_range
from workbench.estimate.ranges.hidden import hidden
from workbench.estimate.search.candidates import Candidate
from workbench.estimate.search.stems import path_of
from workbench.model.results import Intervals
from workbench.record.rounding import step_of

LIMITS = Limits((LEAST_TAU, 1000.0), (0.0, 30.0))


def cycle(samples: int, digits: int | None, restless: float = 0.05) -> wb.Record:
    """A valve of d = 0.77 % in the cycle of integral action, whose slips are hardly larger than d."""
    rng = np.random.default_rng(1)
    load = np.zeros(2000 + samples)
    for k in range(1, load.size):
        load[k] = 0.996 * load[k - 1] + math.sqrt(1.0 - 0.996**2) * restless * rng.normal()
    loop = wb.Loop(wb.FOPDT(1.45, 15.6, 5.0), wb.Stenman(0.77), wb.PID(Kc=0.344, Ti=137.0), 5.0)
    run = wb.simulate(loop, wb.Experiment(5.0 * load.size, wb.Step(0.4), wb.Series(load.tolist()), wb.Noise(0.02, 1)))
    op, pv = run.op[2000:], run.pv[2000:]
    return wb.Record(pv, op if digits is None else np.round(op, digits), 5.0)


def stem(data: Centred, d: float) -> Candidate:
    """The best path of a band, from the first slip that suits it."""
    highs, lows = np.maximum.accumulate(data.u), np.minimum.accumulate(data.u)
    firsts = np.flatnonzero((data.u[1:] > highs[:-1]) | (data.u[1:] < lows[:-1])) + 1
    found = []
    for first in [0, *firsts[:60].tolist()]:
        x, slips = path_of(data.u, d, first)
        fit = fit_path(data, x, first, start_range(data.u, first, d, d), LIMITS, 1.0, tau=3.0)
        found.append(Candidate(first, d, d, slips, fit))
    return min(found, key=lambda c: c.fit.sse)


@pytest.mark.parametrize("kept", [np.float64, np.float32])
def test_the_step_of_op_is_seen_however_far_it_ranges(kept: type) -> None:
    rng = np.random.default_rng(2)
    op = 50.0 + 8.0 * np.sin(0.1 * np.arange(800)) + rng.normal(size=800)

    for digits in (0, 1, 2):
        signal = np.round(op, digits).astype(kept).astype(float)
        assert step_of(signal) == pytest.approx(10.0**-digits, rel=1e-3)
    assert step_of(op.astype(kept).astype(float)) < 1e-5
    assert step_of(np.where(op > 50.0, 51.0, 49.0)) == 0.0


def test_a_wrong_stem_may_win_where_rounding_hides_the_right_one() -> None:
    exact = centre(cycle(1000, None), "fopdt")
    # The same OP in steps, and nothing that says where in them it was.
    rounded = replace(exact, u=np.round(exact.u + exact.op_middle, 2) - exact.op_middle, doubt=0.01 / math.sqrt(12.0))
    right, lost = stem(exact, 0.77), stem(rounded, 0.77)
    wrong = stem(rounded, 0.7)
    assert lost.fit.sse > 10.0 * wrong.fit.sse > 10.0 * right.fit.sse
    assert hidden(rounded, wrong)
    # Not where OP has all its digits, nor where its step is nothing beside the slips.
    assert not hidden(exact, right)
    assert not hidden(exact, wrong)
    assert not hidden(replace(rounded, doubt=1e-6), wrong)


def test_the_controllers_law_finds_the_stem_that_rounding_hid() -> None:
    found = wb.estimate(cycle(1000, 2), plant="fopdt", valve="stenman")
    assert found.valve.stick_band == pytest.approx(0.77, rel=0.005)
    assert found.identifiable


def test_no_range_is_given_where_it_does_not() -> None:
    found = wb.estimate(cycle(600, 1), plant="fopdt", valve="stenman")
    assert found.verdict == "stiction"
    assert found.intervals == Intervals()
    assert not found.identifiable
    assert any("OP was recorded in steps" in reason for reason in found.reasons)
