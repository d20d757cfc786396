"""A stem that rests short of OP after every slip: slips to and fro leave its gain open, where any others do not."""

from __future__ import annotations

import pytest

import workbench as wb

PLANT = wb.FOPDT(gain=2.0, time_constant=5.0, dead_time=1.0)
FROM = 200  # s
SLOW, BRISK = wb.PID(Kc=0.3, Ti=8.0), wb.PID(Kc=0.5, Ti=5.0)


def estimate_of(valve: wb.Stenman | wb.He, controller: wb.PID) -> wb.Estimate:
    """The estimate from a late cycle."""
    experiment = wb.Experiment(1000.0, setpoint=wb.Step(1.0), noise=wb.Noise(0.05, 3))
    run = wb.simulate(wb.Loop(PLANT, valve, controller, 1.0), experiment)
    return wb.estimate(wb.Record(run.pv[FROM:], run.op[FROM:], 1.0, sp=run.sp[FROM:]), plant="fopdt")


# Under the slow controller load steps are found beside the stem that lands on OP, which the other one does not need.
@pytest.mark.parametrize(("controller", "fd"), [(BRISK, 0.7), (SLOW, 0.4)])
def test_the_gain_of_a_stem_that_rests_short_of_op_is_not_called_identified(controller: wb.PID, fd: float) -> None:
    found = estimate_of(wb.He(fs=2.0 - fd, fd=fd), controller)
    assert found.verdict == "stiction"
    assert isinstance(found.valve, wb.Stenman)
    assert found.valve.d == pytest.approx(2.0, rel=0.02)
    # By as much as it slips less the gain is too small, and its range says so.
    assert found.plant.gain < 0.85 * PLANT.gain
    assert found.intervals.gain is not None
    assert found.intervals.gain[0] <= PLANT.gain <= found.intervals.gain[1]
    assert not found.identifiable
    assert any("rests short of OP" in reason for reason in found.reasons)


@pytest.mark.parametrize("controller", [BRISK, SLOW])
def test_slips_that_follow_each_other_tell_a_stem_that_lands_on_op(controller: wb.PID) -> None:
    found = estimate_of(wb.Stenman(2.0), controller)
    assert found.identifiable
    assert found.intervals.gain is not None
    assert found.intervals.gain[1] < 1.05 * PLANT.gain
