"""Whether rounding decides what a run gives."""

from __future__ import annotations

from dataclasses import replace

import pytest

import workbench as wb
from workbench.analyze.chance import HAIRS, by_chance

MINUTE = 60.0
# OP comes to rest at the edge of the stick band, to the last digit, before a load sends it on.
CONTROLLER = wb.PID(0.9, 15.0 * MINUTE, MINUTE, form="parallel", derivative_filter=8.0)
LOOP = wb.Loop(wb.FOPDT(2.5, 12.0 * MINUTE, 2.3 * MINUTE), wb.Choudhury(3.0, 1.0), CONTROLLER, MINUTE)
TASK = wb.Experiment(
    1440.0 * MINUTE, wb.Step(5.0, 30.0 * MINUTE), wb.Step(-4.0, 600.0 * MINUTE), noise=wb.Noise(0.1, 2)
)


def test_a_run_that_rounding_decides_is_told_by_others() -> None:
    own = wb.simulate(LOOP, TASK).kpis
    others = by_chance(LOOP, TASK, own)
    assert len(others) == len(HAIRS)
    travels = [own.valve_travel, *(one.valve_travel for one in others)]
    assert max(travels) > 1.1 * min(travels)
    # They are runs of controllers that are the same to twelve digits.
    near = LOOP.with_controller(replace(CONTROLLER, Kc=CONTROLLER.Kc * (1.0 + HAIRS[0])))
    assert wb.simulate(near, TASK).kpis.valve_travel == others[0].valve_travel


@pytest.mark.parametrize("valve", [wb.Ideal(), wb.Stenman(2.0)])
def test_a_run_that_is_the_same_to_the_last_digits_has_none(valve: wb.Stenman) -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), valve, wb.PID(0.5, 20.0), 1.0)
    task = wb.Experiment(1000.0, wb.Step(4.0))
    assert by_chance(loop, task, wb.simulate(loop, task).kpis) == ()
