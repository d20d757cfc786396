"""Ranges of the plant where fewer than ten slips pin the stem: later slips and a shorter dead time look the same."""

from __future__ import annotations

import pytest

import workbench as wb

# Cycles of a valve with S and J, late, without a setpoint move: six slips in 1,000 samples.
FLOW = wb.Loop(wb.FOPDT(1.93, 43.6, 17.1), wb.Choudhury(19.9, 6.61), wb.PID(Kc=0.531, Ti=28.0), 1.0)
LEVEL = wb.Loop(wb.Integrating(0.0111, 7.95), wb.Choudhury(1.73, 0.898), wb.PID(Kc=2.24, Ti=310.0), 1.0)


def holds(pair: tuple[float, float] | None, value: float) -> bool:
    return pair is not None and pair[0] <= value <= pair[1]


# Seeds, and how closely the gain is met; but for the first two the stems beside the best are told from it.
CASES = [
    (FLOW, 57.8, 0.0361, 14, 0.01),
    (FLOW, 57.8, 0.0361, 2, 0.01),
    (FLOW, 57.8, 0.0361, 18, 0.01),
    (LEVEL, 0.333, 0.00205, 2, 0.01),
    (FLOW, 57.8, 0.0361, 0, 0.012),
    (LEVEL, 0.333, 0.00205, 3, 0.01),
]


@pytest.mark.parametrize(("loop", "size", "sd", "seed", "close"), CASES)
def test_ranges_of_few_slips_hold_stems_that_slip_earlier_and_later(
    loop: wb.Loop, size: float, sd: float, seed: int, close: float
) -> None:
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=wb.Step(size), noise=wb.Noise(sd, seed)))
    kind = "fopdt" if loop is FLOW else "integrating"
    found = wb.estimate(wb.Record(run.pv[1000:], run.op[1000:], 1.0, sp=run.sp[1000:]), plant=kind)
    assert found.verdict == "stiction"
    assert found.slips == 6
    assert found.intervals.S is None
    assert not found.identifiable
    # Nor does a load step make up for slips at other times.
    assert found.load_steps == ()
    # The stem first met slips a sample or two too late or too early, with 4 % of the gain and a sample of dead time.
    assert holds(found.intervals.gain, loop.plant.gain)
    assert holds(found.intervals.dead_time, loop.plant.dead_time)
    assert found.plant.gain == pytest.approx(loop.plant.gain, rel=close)
    low, high = found.intervals.dead_time
    assert high - low < 4.0
    if (loop, size, sd, seed, close) in CASES[:2]:
        assert high - low > 0.5
