"""A controller that runs faster than the record: the stem slipped when OP was between its recorded values."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import workbench as wb
from workbench.detect.scan import runs_faster
from workbench.estimate.ranges.between import between_samples

FAST = 0.5  # s
PLANT, VALVE, PID = wb.FOPDT(1.2, 6.0, 1.5), wb.Choudhury(4.0, 2.8), wb.PID(0.6, 8.0)


def recorded(every: int, pid: wb.PID = PID) -> wb.Record:
    """A loop whose setpoint swings, as in a cascade, whose controller runs each half second; each so many kept."""
    n = 800 * every
    setpoint = wb.Series(6.0 * np.sin(2.0 * np.pi * np.arange(n) / (90.0 * every)))
    loop = wb.Loop(PLANT, VALVE, pid, FAST)
    run = wb.simulate(loop, wb.Experiment(n * FAST, setpoint=setpoint, noise=wb.Noise(0.05, 1)))
    pv, op, sp = (signal[::every] for signal in (run.pv, run.op, run.sp))
    return wb.Record(pv + 50.0, op + 40.0, FAST * every, sp=sp + 50.0)


@pytest.mark.parametrize(
    "pid",
    [
        PID,
        replace(PID, Td=1.0),
        replace(PID, Td=1.0, derivative_on="pv", setpoint_weight=0.4),
        replace(PID, output_limits=(-6.0, 6.0)),
        replace(PID, output_resolution=0.5),
        wb.PID(0.6, form="parallel", Ti=8.0),
    ],
    ids=["PI", "PID", "weights", "limits", "resolution", "parallel"],
)
def test_a_controller_that_runs_once_a_sample_is_seen_whatever_its_form(pid: wb.PID) -> None:
    assert not runs_faster(recorded(1, pid=pid))
    if pid.output_resolution == 0.0:  # in steps of OP what happens between samples is not to be seen
        assert runs_faster(recorded(4, pid=pid))


def test_rounding_is_no_faster_controller_and_neither_is_an_op_by_hand() -> None:
    record = recorded(1)
    for steps in (0.01, 0.1):
        rounded = replace(record, pv=np.round(record.pv / steps) * steps, op=np.round(record.op / steps) * steps)
        assert not runs_faster(rounded)
    assert not runs_faster(replace(record, op=np.where(np.arange(800) < 300, 40.0, 45.0)))
    assert not runs_faster(replace(record, op=np.full(800, 40.0)))
    short = wb.Record(record.pv[:99], record.op[:99], FAST)
    assert not runs_faster(short)
    # A slower one moves OP now and then, by the error of just then.
    loop = replace(wb.Loop(PLANT, VALVE, PID, FAST), scan=4)
    slow = wb.simulate(loop, wb.Experiment(400.0, wb.Step(5.0), noise=wb.Noise(0.05, 1)))
    assert not runs_faster(wb.Record(slow.pv, slow.op, FAST))


def steps_of(signal: np.ndarray, step: float) -> np.ndarray:
    return np.round(signal / step) * step


@pytest.mark.parametrize("every", [2, 3, 5, 10])
@pytest.mark.parametrize("steps", [(0.01, 0.0), (0.01, 0.01)], ids=["OP", "OP and PV"])
def test_rounding_does_not_hide_a_faster_controller(every: int, steps: tuple[float, float]) -> None:
    # Between two samples the integral's share of what nobody recorded is less than rounding; it gathers.
    record = recorded(every)
    pv = steps_of(record.pv, steps[1]) if steps[1] else record.pv
    assert runs_faster(replace(record, op=steps_of(record.op, steps[0]), pv=pv))


@pytest.mark.parametrize("scan", [2, 3, 4])
@pytest.mark.parametrize("pid", [PID, replace(PID, Td=1.0)], ids=["PI", "PID"])
def test_a_slower_controller_is_no_faster_one(scan: int, pid: wb.PID) -> None:
    slow = wb.simulate(
        wb.Loop(PLANT, VALVE, pid, FAST, scan=scan), wb.Experiment(400.0, wb.Step(5.0), noise=wb.Noise(0.05, 1))
    )
    for sp in (None, slow.sp):
        record = wb.Record(slow.pv, slow.op, FAST, sp=sp)
        assert not runs_faster(record)
        assert not runs_faster(replace(record, pv=steps_of(slow.pv, 0.01), op=steps_of(slow.op, 0.01)))


@pytest.mark.parametrize("steps", [(0.01, 0.0), (0.0, 0.01), (0.05, 0.02), (0.1, 0.2), (0.01, 0.5), (0.5, 0.01)])
@pytest.mark.parametrize(
    "pid",
    [PID, replace(PID, Td=2.0, derivative_filter=2.0), replace(PID, output_limits=(-3.0, 3.0))],
    ids=["PI", "PID", "limits"],
)
def test_a_record_at_the_controllers_scan_is_none_however_it_was_rounded(
    steps: tuple[float, float], pid: wb.PID
) -> None:
    record = recorded(1, pid=pid)
    op, pv = (steps_of(x, step) if step else x for x, step in zip((record.op, record.pv), steps, strict=True))
    assert not runs_faster(replace(record, op=op, pv=pv))
    few = replace(record, op=op[:120], pv=pv[:120], sp=record.sp[:120])
    assert not runs_faster(few)


@cache
def estimated() -> wb.Estimate:
    """What is found where every sample of the controller's is recorded."""
    return wb.estimate(recorded(1), plant="fopdt", valve="choudhury")


@pytest.mark.slow
def test_ranges_hold_the_stick_band_where_op_is_not_known_between_samples() -> None:
    found = wb.estimate(recorded(6), plant="fopdt", valve="choudhury")
    assert found.verdict == "stiction"
    pair = found.intervals.S or found.intervals.d
    assert pair is not None
    assert pair[0] <= 4.0 <= pair[1]
    assert not found.identifiable
    assert any("runs faster than the record" in reason for reason in found.reasons)
    own = estimated()
    assert own.intervals.S[1] - own.intervals.S[0] < 0.5
    assert not any("runs faster" in reason for reason in own.reasons)


def test_the_doubt_is_ops_move_as_the_stem_sets_off() -> None:
    record = recorded(4)
    own = estimated()
    # A stem by hand: it sets off at samples 100 and 300, when OP moved by 1 and 3 %.
    stem, op = np.zeros(800), record.op.copy()
    stem[100:], stem[300:] = 5.0, 2.0
    op[100], op[300] = op[99] + 1.0, op[299] - 3.0
    answer = replace(own, valve_position=stem)
    wide, said = between_samples(replace(record, op=op), answer)
    low, high = own.intervals.S
    assert pytest.approx((low - 2.0, high + 2.0)) == wide.S
    assert pytest.approx((max(own.intervals.J[0] - 2.0, 0.0), own.intervals.J[1] + 2.0)) == wide.J
    assert wide.gain == own.intervals.gain
    # Held from sample to sample, the recorded OP is older than what moved the valve, by half a sample at most.
    low, high = own.intervals.dead_time
    assert pytest.approx((low, high + 0.5 * record.sample_time)) == wide.dead_time
    assert "up to half a sample" in said[1]
    assert "known to 2 %" in said[0]
    assert between_samples(recorded(1), own) == (own.intervals, ())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_dead_time_of_a_healthy_loop_is_within_its_range_where_the_controller_runs_faster(seed: int) -> None:
    moves = [wb.Step(6.0, at=20.0), wb.Step(-8.0, at=300.0), wb.Step(5.0, at=700.0)]
    loop = wb.Loop(wb.FOPDT(1.2, 8.0, 3.0), wb.Ideal(), wb.PID(1.2, 8.0), 0.2)
    run = wb.simulate(loop, wb.Experiment(1000.0, moves, noise=wb.Noise(0.02, seed)))
    record = wb.Record(run.pv[::5] + 50.0, run.op[::5] + 40.0, 1.0, sp=run.sp[::5] + 50.0)
    found = wb.estimate(record, plant="fopdt")
    pair = found.intervals.dead_time
    assert found.verdict == "no_stiction"
    assert pair is not None
    assert pair[0] <= 3.0 <= pair[1]
    assert pair[1] - 0.5 < 3.0  # which the range of the record as it is does not hold
    assert any("up to half a sample" in reason for reason in found.reasons)
