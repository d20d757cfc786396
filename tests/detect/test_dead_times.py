"""Loops whose dead time is long beside the record: no stem makes up for one that is not tried."""

from __future__ import annotations

import math

import numpy as np
import pytest

import workbench as wb
from workbench.detect.rivals import FURTHER, USUAL, dead_times


def record_of(plant: wb.FOPDT | wb.Integrating, valve: object, Ti: float, samples: int, sd: float) -> wb.Record:
    """A loop under two setpoint moves; PI as for a closed loop as fast as the dead time allows."""
    lag = plant.time_constant if isinstance(plant, wb.FOPDT) else 1.0
    loop = wb.Loop(plant, valve, wb.PID(Kc=lag / (2.0 * plant.gain * plant.dead_time), Ti=Ti), 1.0)
    moves = [wb.Step(10.0, at=0.05 * samples), wb.Step(-15.0, at=0.5 * samples)]
    run = wb.simulate(loop, wb.Experiment(float(samples), moves, noise=wb.Noise(sd, 4)))
    return wb.Record(run.pv, run.op, 1.0, sp=run.sp)


@pytest.mark.parametrize(
    ("plant", "Ti", "sd"),
    [
        (wb.FOPDT(0.6, 127.0, 217.0), 120.0, 0.4),
        (wb.Integrating(0.011, 143.0), 1150.0, 0.1),
    ],
)
def test_a_healthy_loop_is_acquitted(plant: wb.FOPDT | wb.Integrating, Ti: float, sd: float) -> None:
    found = wb.detect(record_of(plant, wb.Ideal(), Ti, 1500, sd))
    assert found.verdict == "no_stiction"
    assert found.test is not None
    assert found.test.dead_time == pytest.approx(plant.dead_time, rel=0.05)


def test_a_sticking_valve_is_found() -> None:
    found = wb.detect(record_of(wb.FOPDT(1.0, 90.0, 80.0), wb.Stenman(6.0), 90.0, 1500, 0.1))
    assert found.verdict == "stiction"
    assert found.test is not None
    assert found.test.band == pytest.approx(6.0, rel=0.1)


def test_a_loop_with_a_usual_dead_time_is_tested_with_no_other() -> None:
    usual = wb.detect(record_of(wb.FOPDT(1.0, 30.0, 10.0), wb.Stenman(3.0), 30.0, 1000, 0.1)).test
    assert usual is not None
    assert usual.dead_time < 0.05 * 1000


def test_dead_times_reach_a_share_of_the_record_and_half_a_period() -> None:
    assert dead_times(1000, math.nan)[-1] <= 1000 * USUAL < dead_times(1000, math.nan, FURTHER)[-1] <= 1000 * FURTHER
    assert dead_times(1000, 60.0, FURTHER)[-1] <= 30
    assert (np.diff(dead_times(3000, math.nan, FURTHER)) > 0).all()
