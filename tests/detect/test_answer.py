"""A valve that is stuck fast: OP moves, PV goes its own way, and nobody calls that a healthy valve."""

from __future__ import annotations

import math

import numpy as np
import pytest

import workbench as wb
from workbench.detect.answer import answer_of

FLOW = wb.FOPDT(1.2, 12.0, 4.0)


def drift(rng: np.random.Generator, n: int, correlation: float) -> np.ndarray:
    pole = math.exp(-1.0 / correlation)
    out = np.zeros(n)
    for k in range(1, n):
        out[k] = pole * out[k - 1] + math.sqrt(1.0 - pole * pole) * rng.normal()
    return out


def recorded(
    valve: wb.Stenman | wb.Ideal,
    seed: int,
    plant: wb.FOPDT = FLOW,
    correlation: float = 4.0,
    samples: int = 1000,
    action: str = "reverse",
) -> wb.Record:
    """A loop under a drifting load and some noise."""
    rng = np.random.default_rng(seed)
    load = 3.0 * drift(rng, samples, correlation)
    loop = wb.Loop(plant, valve, wb.PID(Kc=0.9, Ti=12.0, action=action), 1.0)
    run = wb.simulate(loop, wb.Experiment(float(samples), load=wb.Series(load.tolist()), noise=wb.Noise(0.05, seed)))
    return wb.Record(50.0 + run.pv, 50.0 + run.op, 1.0, sp=50.0 + run.sp)


STUCK = wb.Stenman(1e9)


def test_a_stuck_valve_is_not_acquitted() -> None:
    found = [wb.detect(recorded(STUCK, seed)) for seed in range(4)]
    assert not any(f.verdict == "no_stiction" for f in found)
    told = [f for f in found if "PV is not seen to answer the OP moves of" in f.reasons[0]]
    assert len(told) >= 2
    assert all(f.verdict == "undecided" for f in told)


def test_a_valve_that_moves_is_acquitted_as_before() -> None:
    found = [wb.detect(recorded(wb.Ideal(), seed)) for seed in range(3)]
    assert sum(f.verdict == "no_stiction" for f in found) >= 2
    assert not any("PV is not seen to answer" in reason for f in found for reason in f.reasons)


def test_ops_own_way_pushes_pv_where_the_valve_moves() -> None:
    for seed in range(3):
        moving, stuck = (answer_of(recorded(valve, seed)) for valve in (wb.Ideal(), STUCK))
        assert moving is not None
        assert stuck is not None
        assert moving.pushes > stuck.pushes + 1.0
        assert not moving.missing


def test_an_op_that_only_echoes_pv_misses_no_answer() -> None:
    # Proportional action alone gathers no error: the record cannot tell whether the valve moves.
    rng = np.random.default_rng(5)
    pv = 50.0 + drift(rng, 800, 5.0)
    found = answer_of(wb.Record(pv, 60.0 - 2.0 * pv, 1.0))
    assert found is not None
    assert found.own < 0.1
    assert not found.missing


def test_the_push_is_judged_by_the_controllers_action() -> None:
    mirrored = recorded(wb.Ideal(), 1, wb.FOPDT(-1.2, 12.0, 4.0), action="direct")
    plain = answer_of(recorded(wb.Ideal(), 1))
    other = answer_of(mirrored)
    assert plain is not None
    assert other is not None
    assert plain.pushes > 2.86
    assert other.pushes > 2.86
    assert other.moved == pytest.approx(float(np.ptp(mirrored.op)))


def test_where_no_controller_is_seen_nothing_is_said() -> None:
    rng = np.random.default_rng(3)
    walk = np.cumsum(rng.normal(size=400))
    assert answer_of(wb.Record(rng.normal(size=400), 50.0 + walk, 1.0)) is None
    assert answer_of(recorded(STUCK, 0, samples=20)) is None


@pytest.mark.parametrize("samples", [30, 40])
def test_a_pv_that_went_along_with_its_setpoint_answers(samples: int) -> None:
    def moved(valve: wb.Stenman | wb.Ideal, seed: int) -> wb.Record:
        rng = np.random.default_rng(seed)
        load = wb.Series((0.3 * drift(rng, samples, 10.0)).tolist())
        loop = wb.Loop(FLOW, valve, wb.PID(Kc=0.9, Ti=12.0), 1.0)
        run = wb.simulate(loop, wb.Experiment(float(samples), wb.Step(4.0, at=8.0), load, wb.Noise(0.05, seed)))
        return wb.Record(50.0 + run.pv, 50.0 + run.op, 1.0, sp=50.0 + run.sp)

    # Beside such a move so few samples hold too little of OP's own way for the test.
    for seed in range(6):
        reasons = wb.detect(moved(wb.Ideal(), seed)).reasons
        assert not any("PV is not seen to answer" in reason for reason in reasons)
    stuck = [answer_of(moved(STUCK, seed)) for seed in range(6)]
    assert sum(found is not None and found.missing for found in stuck) >= 3


def test_where_the_setpoint_moved_a_larger_move_is_asked_for() -> None:
    record = recorded(STUCK, 4, samples=500)
    assert record.sp is not None
    sp = record.sp + np.where(np.arange(len(record)) > 250, 0.05, 0.0)
    assert "the same; a setpoint move would tell" in wb.detect(record).reasons[0]
    moved = wb.detect(wb.Record(record.pv, record.op, 1.0, sp=sp))
    assert "the same; a larger setpoint move would tell" in moved.reasons[0]


def test_a_recorded_stem_that_follows_outweighs_it() -> None:
    record = recorded(STUCK, 2)
    seen = wb.Record(record.pv, record.op, 1.0, sp=record.sp, valve_position=record.op)
    assert wb.detect(seen).verdict == "no_stiction"


def test_a_stuck_valve_is_left_undecided_by_the_estimate_too() -> None:
    record = recorded(STUCK, 4, samples=300)
    found = wb.estimate(record, valve="stenman", plant="fopdt")
    assert found.verdict == "undecided"
    assert any("PV is not seen to answer the OP moves of" in reason for reason in found.reasons)


@pytest.mark.parametrize(
    ("valve", "between"),
    [(wb.Deadband(2.0), True), (wb.Deadband(3.0), False), (wb.Stenman(3.0), True), (wb.Ideal(), False)],
)
def test_large_setpoint_moves_do_not_acquit_a_narrow_band(
    valve: wb.Deadband | wb.Stenman | wb.Ideal, between: bool
) -> None:
    loop = wb.Loop(FLOW, valve, wb.PID(Kc=1.2, Ti=12.0), 1.0)
    steps = [wb.Step(60.0, at=50.0), wb.Step(-50.0, at=250.0)]
    load = wb.Series((0.6 * drift(np.random.default_rng(8), 1200, 30.0)).tolist())
    run = wb.simulate(loop, wb.Experiment(1200.0, steps, load, wb.Noise(0.1, 8)))
    found = wb.detect(wb.Record(run.pv, run.op, 1.0, sp=run.sp))
    assert (found.verdict == "no_stiction") is isinstance(valve, wb.Ideal)
    # The wider dead band shows in the record as a whole.
    assert any("between setpoint moves" in reason for reason in found.reasons) is between
