"""What the shipped scenarios say of derivative action is what the exact run shows."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import workbench as wb

SCENARIOS = Path(__file__).parents[2] / "scenarios"


def test_the_note_on_derivative_action_is_what_the_run_shows() -> None:
    experiment = wb.Experiment(duration=1000.0, setpoint=wb.Step(size=4.0, at=0.0))
    controller = wb.PID(Kc=0.5, Ti=20.0, Td=6.0, derivative_filter=math.inf)
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), controller, 1.0)
    run = wb.simulate(loop, experiment)
    moves = np.diff(run.valve, prepend=0.0)
    assert round(run.kpis.valve_travel) == 75
    assert round(float(np.abs(moves[:60]).sum())) == 67
    assert np.count_nonzero(moves[60:]) == 4
    base = wb.Loop(loop.plant, loop.valve, wb.PID(Kc=0.5, Ti=20.0), 1.0)
    late, of_base = wb.limit_cycle(loop, experiment), wb.limit_cycle(base, experiment)
    assert late.period == pytest.approx(of_base.period, rel=0.01)
    assert late.mean_square_error == pytest.approx(of_base.mean_square_error, rel=0.01)


@pytest.mark.parametrize("name", ["table_2", "stick_slip"])
def test_the_notes(name: str) -> None:
    text = " ".join((SCENARIOS / f"{name}.yaml").read_text(encoding="utf-8").split())
    assert "acts as a dither" not in text
    assert "It keeps the valve moving" not in text
    assert "the valve moves four times in the rest of the run" in text
    assert "Managing the Performance of Control Loops with Valve Stiction: An Industrial Perspective" in text
