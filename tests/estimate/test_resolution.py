"""OP that a historian keeps in steps: where within a step it was, and what estimates make of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.detect.resolution import resolved
from workbench.estimate.estimate import linear_loop
from workbench.estimate.fits.data import centre
from workbench.model.results import Estimate, Intervals
from workbench.record.rounding import step_of

STEP = 0.1
FLOW = wb.Loop(wb.FOPDT(2.0, 6.0, 3.0), wb.Stenman(1.2), wb.PID(Kc=0.3, Ti=10.0), 1.0)


def cycle(loop: wb.Loop, seed: int, sd: float = 0.02, samples: int = 1000) -> wb.Record:
    """Samples of a cycle long after its setpoint move, as the controller had them."""
    run = wb.simulate(loop, wb.Experiment(777.0 + samples, setpoint=wb.Step(3.0), noise=wb.Noise(sd, seed)))
    return wb.Record(run.pv[777:] + 50.0, run.op[777:] + 40.0, 1.0, sp=run.sp[777:] + 50.0)


def kept(record: wb.Record, pv: float = 0.0) -> wb.Record:
    """The record as a historian keeps it: OP, and PV where pv is a step, in steps."""
    rounded = np.round(record.pv / pv) * pv if pv else record.pv
    return replace(record, op=np.round(record.op / STEP) * STEP, pv=rounded)


PID = replace(FLOW, controller=wb.PID(Kc=0.3, Ti=10.0, Td=1.5))
REVERSED = wb.Loop(wb.FOPDT(-1.5, 20.0, 6.0), wb.Stenman(1.5), wb.PID(Kc=0.8, Ti=15.0, action="direct"), 1.0)


@pytest.mark.parametrize("loop", [FLOW, PID, REVERSED], ids=["PI", "PID", "direct"])
@pytest.mark.parametrize("pv", [0.0, 0.05], ids=["PV in full", "PV in steps"])
def test_op_is_found_within_its_steps(loop: wb.Loop, pv: float) -> None:
    full = cycle(loop, 1)
    record = kept(full, pv)
    op, doubt = resolved(record)
    error = float(np.sqrt(np.mean((op - full.op) ** 2)))
    rounding = float(np.sqrt(np.mean((record.op - full.op) ** 2)))
    assert error < 0.6 * rounding
    assert error < 1.5 * doubt < 0.6 * STEP
    assert np.abs(op - record.op).max() <= STEP / 2 * (1 + 1e-9)


def test_without_a_setpoint_pv_and_op_are_enough() -> None:
    full = cycle(FLOW, 2)
    op, doubt = resolved(replace(kept(full), sp=None))
    assert np.sqrt(np.mean((op - full.op) ** 2)) < doubt < 0.2 * STEP


def test_an_op_recorded_in_full_stays_as_it_is() -> None:
    full = cycle(FLOW, 3)
    op, doubt = resolved(full)
    assert op is full.op
    assert doubt == 0.0
    assert centre(full, "fopdt").doubt == 0.0


def test_an_op_that_no_law_explains_stays_as_it_is() -> None:
    # An operator's moves in whole per cents, and a PV that has nothing to do with them.
    rng = np.random.default_rng(0)
    moves = np.where(rng.random(800) < 0.05, rng.choice([-2.0, -1.0, 1.0, 2.0], 800), 0.0)
    record = wb.Record(rng.normal(50.0, 1.0, 800), 40.0 + np.cumsum(moves), 1.0)
    op, doubt = resolved(record)
    assert np.array_equal(op, record.op)
    assert doubt == pytest.approx(1.0 / np.sqrt(12.0))


@pytest.mark.parametrize(
    ("values", "step"),
    [
        (np.arange(400) % 7 * 0.25, 0.25),
        ((np.arange(400) % 7 * 0.1) * (1.0 + 1e-15) + 33.3, 0.1),  # rounding of the numbers themselves is no step
        (np.arange(400) * 0.1, 0.1),
        (np.random.default_rng(0).normal(size=400), 0.0),
        (np.full(400, 3.0), 0.0),
    ],
)
def test_steps_are_what_all_values_are_multiples_apart(values: np.ndarray, step: float) -> None:
    assert step_of(values) == pytest.approx(step, rel=1e-9)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.integers(-3, 3), min_size=40, max_size=200).filter(any),
    st.floats(1e-3, 10.0),
    st.integers(0, 2**32 - 1),
)
def test_op_never_leaves_its_step(moves: list[int], step: float, seed: int) -> None:
    pv = np.random.default_rng(seed).normal(size=len(moves)).cumsum()
    record = wb.Record(pv, np.cumsum(moves) * step, 1.0)
    op, doubt = resolved(record)
    assert np.abs(op - record.op).max() <= 0.5 * step * (1.0 + 1e-6)
    assert 0.0 <= doubt <= step


@cache
def found_in_steps(method: str) -> tuple[Estimate, tuple[float, ...]]:
    """What is found where OP is in steps, and the shares of the work that were told on the way."""
    told: list[float] = []
    return wb.estimate(kept(cycle(FLOW, 2)), plant="fopdt", method=method, progress=told.append), tuple(told)


TWO_PARAMETER = wb.Loop(wb.FOPDT(1.0, 10.0, 4.0), wb.Choudhury(2.0, 1.0), wb.PID(Kc=0.8, Ti=12.0), 1.0)
STICKY = {
    "flow": (FLOW, 0.02),
    "level": (wb.Loop(wb.Integrating(0.1, 5.0), wb.Stenman(1.0), wb.PID(Kc=0.9, Ti=60.0), 1.0), 0.01),
    "two-parameter": (TWO_PARAMETER, 0.02),
    "two-parameter, longer": (TWO_PARAMETER, 0.005),
}
# What is not known of OP, and the noise, leave the gain open by more than a tenth; in more samples, less.
VAGUE = ("two-parameter",)
LONGER = {"two-parameter, longer": 1400}


@pytest.mark.parametrize("name", STICKY)
def test_a_valve_is_identified_from_an_op_in_steps(name: str) -> None:
    # Taken for exact, the same OP gives a band 3 to 60 % off, another kind of valve, or a gain 40 % off.
    loop, sd = STICKY[name]
    plant = "integrating" if isinstance(loop.plant, wb.Integrating) else "fopdt"
    record = kept(cycle(loop, 0, sd, LONGER.get(name, 1000)))
    found = found_in_steps("profile")[0] if loop is FLOW else wb.estimate(record, plant=plant)
    assert found.verdict == "stiction"
    assert isinstance(found.valve, type(loop.valve))
    assert found.valve.stick_band == pytest.approx(loop.valve.stick_band, rel=0.01)
    assert found.plant.gain == pytest.approx(loop.plant.gain, rel=0.02)
    assert found.identifiable == (name not in VAGUE)
    low, high = found.intervals.d or found.intervals.S
    assert low <= loop.valve.stick_band <= high
    assert high - low <= 0.1 * loop.valve.stick_band
    low, high = found.intervals.gain
    assert low <= loop.plant.gain <= high
    assert (high - low <= 0.2 * abs(found.plant.gain)) == (name not in VAGUE)


@pytest.mark.parametrize("method", ["profile", "joint"])
def test_ranges_know_what_is_not_known_of_op(method: str) -> None:
    found = found_in_steps(method)[0]
    record = kept(cycle(FLOW, 2))
    data = centre(record, "fopdt")
    rate = float(np.abs(np.diff(data.u)).mean())
    low, high = found.intervals.d or found.intervals.S
    assert high - low >= 3.9 * data.doubt > 0.0
    assert low <= 1.2 <= high
    (low, high), theta = found.intervals.gain, found.intervals.dead_time
    assert high - low >= 3.9 * data.doubt * 2.0 / 1.25
    assert theta[1] - theta[0] >= 3.9 * data.doubt / rate
    assert low <= 2.0 <= high
    assert theta[0] <= 3.0 <= theta[1]


@pytest.mark.parametrize("method", ["profile", "joint"])
def test_progress_never_falls_where_op_is_taken_in_two_ways(method: str) -> None:
    told = found_in_steps(method)[1]
    assert list(told) == sorted(told)
    # The second search is seen to go on.
    searched = [share for share in told if 0.5 < share / (0.5 if method == "joint" else 1.0) < 1.0]
    assert len(set(searched)) > 10


@pytest.mark.parametrize("valve", [wb.Stenman(1.24), wb.Choudhury(2.03, 1.04)], ids=["stenman", "two-parameter"])
def test_steps_that_the_controller_sent_are_taken_as_they_are(valve: wb.Valve) -> None:
    # Taken for the historian's, the same steps give another kind of valve or no range at all.
    loop = replace(FLOW, valve=valve, controller=wb.PID(Kc=0.8, Ti=8.0, output_resolution=STEP))
    moves = [wb.Step(3.0), wb.Step(-4.0, 1300.0)]
    run = wb.simulate(loop, wb.Experiment(1777.0, setpoint=moves, noise=wb.Noise(0.02, 1)))
    record = wb.Record(run.pv[777:] + 50.0, run.op[777:] + 40.0, 1.0, sp=run.sp[777:] + 50.0)
    assert centre(record, "fopdt").doubt > 0.0
    found = wb.estimate(record)
    assert isinstance(found.valve, type(valve))
    assert found.valve.stick_band == pytest.approx(valve.stick_band, abs=STEP)
    assert found.plant.gain == pytest.approx(2.0, rel=0.02)
    low, high = found.intervals.d or found.intervals.S
    assert low - 1e-9 <= valve.stick_band <= high + 1e-9
    assert found.identifiable


def test_moves_between_a_few_levels_are_no_rounding() -> None:
    op = np.repeat([40.0, 45.0, 50.0, 45.0, 40.0], 80)
    pv = np.convolve(np.diff(op, prepend=op[0]), 1.0 - np.exp(-np.arange(400) / 20.0))[:400]
    record = wb.Record(pv + np.random.default_rng(0).normal(0.0, 0.01, 400), op, 1.0)
    assert resolved(record) == (record.op, 0.0)


def test_a_pv_of_two_values_is_followed_no_closer_than_they_are_apart() -> None:
    full = cycle(FLOW, 0)
    record = replace(full, pv=np.where(full.pv > np.median(full.pv), 55.0, 51.0))
    assert centre(record, "fopdt").floor >= 16.0 / 12.0


def test_ops_steps_beside_a_valve_that_stands_still_end_in_no_traceback() -> None:
    # A path that holds for every band below OP's step begins at a band of nothing.
    full = cycle(FLOW, 1, samples=1600)
    op = np.round(full.op)
    op[500:] = op[500]
    pv = np.where(np.arange(1600) < 500, full.pv, full.pv[500])
    pv += np.where(np.arange(1600) < 500, 0.0, np.random.default_rng(0).normal(0.0, 0.05, 1600))
    found = wb.estimate(replace(full, op=op, pv=pv), plant="fopdt", valve="stenman")
    assert np.isfinite(found.plant.gain)


@pytest.mark.parametrize("plant", [wb.FOPDT(2.0, 6.0, 3.0), wb.Integrating(0.1, 5.0)], ids=["fopdt", "integrating"])
def test_a_linear_loop_takes_the_steps_that_its_controller_sent_too(plant: wb.FOPDT | wb.Integrating) -> None:
    # Taken for the historian's, the same steps leave five times the noise of PV unexplained, and more.
    flow = isinstance(plant, wb.FOPDT)
    pid = wb.PID(Kc=0.8, Ti=8.0 if flow else 60.0, output_resolution=0.5)
    moves = [wb.Step(8.0, 20.0), wb.Step(-12.0, 450.0)]
    run = wb.simulate(wb.Loop(plant, wb.Ideal(), pid, 1.0), wb.Experiment(1000.0, moves, noise=wb.Noise(0.02, 1)))
    record = wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)
    kind = "fopdt" if flow else "integrating"
    assert centre(record, kind).doubt > 0.0
    alone = linear_loop(record, kind)
    assert alone.residual_variance == pytest.approx(0.02**2, rel=0.1)
    assert alone.plant.gain == pytest.approx(plant.gain, rel=1e-4)
    found = wb.estimate(record, plant=kind, valve="linear")
    assert found.plant == alone.plant
    assert np.array_equal(found.prediction, alone.prediction)


def test_a_linear_loop_is_the_estimates_where_a_stem_would_take_op_otherwise() -> None:
    # Which OP explains more of PV is asked of each model by itself.
    load = wb.Series(tuple(np.cumsum(np.random.default_rng(0).normal(0.0, 0.05, 500)).tolist()))
    moves = [wb.Step(3.0, 20.0), wb.Step(-4.5, 250.0)]
    loop = wb.Loop(wb.Integrating(0.015, 2.0), wb.Ideal(), wb.PID(Kc=8.0, Ti=32.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(500.0, moves, load, wb.Noise(0.015, 0)))
    record = wb.Record(run.pv + 50.0, np.round(run.op / 0.25) * 0.25 + 40.0, 1.0, sp=run.sp + 50.0)
    assert centre(record, "integrating").doubt > 0.0
    found = wb.estimate(record, plant="integrating", valve="linear")
    assert found.plant == linear_loop(record, "integrating").plant


def test_where_the_stem_is_hidden_nothing_says_that_ranges_hold_it() -> None:
    # The programs go on from the profile's answer, and give ranges only where that has some.
    found = wb.estimate(kept(cycle(FLOW, 1, 0.0, 600)), plant="fopdt", method="joint", valve="deadband")
    assert found.intervals == Intervals()
    assert found.repeats is None
    assert any("no ranges are given" in reason for reason in found.reasons)
    assert not any("the ranges hold both" in reason or "is not identified: from" in reason for reason in found.reasons)


def test_a_load_step_lets_no_stem_of_other_slips_pass_for_the_one_of_an_op_sent_in_steps() -> None:
    loop = wb.Loop(wb.FOPDT(1.8, 25.0, 2.6), wb.Stenman(3.65), wb.PID(Kc=1.3, Ti=25.0), 1.0)
    experiment = wb.Experiment(800.0, wb.Step(4.0, 100.0), wb.Step(2.0, 400.0), wb.Noise(0.05, 6))
    run = wb.simulate(loop, experiment)
    found = wb.estimate(wb.Record(run.pv + 50.0, np.round(run.op * 20.0) / 20.0 + 40.0, 1.0, sp=run.sp + 50.0))
    assert found.valve.stick_band == pytest.approx(3.65, rel=0.01)
    assert found.plant.gain == pytest.approx(1.8, rel=0.01)
    assert found.identifiable
