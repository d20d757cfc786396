"""What is no such argument gets one error that says which and what is allowed, wherever it is given."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

import workbench as wb

LOOP = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(1.0), wb.PID(0.5, 20.0), 1.0)
NOISY = wb.Experiment(50.0, wb.Step(1.0), noise=wb.Noise(0.1))


@pytest.mark.parametrize(
    ("call", "where"),
    [
        (lambda: wb.Experiment(50.0, setpoint=4.0), "Experiment.setpoint: 4.0 given; must be a Step, Ramp or Series"),
        (lambda: wb.Experiment(50.0, setpoint=[4.0]), "Experiment.setpoint: 4.0 given; must be a Step, Ramp or Series"),
        (lambda: wb.Experiment(50.0, setpoint=np.array(4.0)), "Experiment.setpoint"),
        (lambda: wb.Series(np.array(2.0)), "Series.values"),
        (lambda: wb.Series([1.0], np.array(2.0)), "Series.times"),
        (lambda: wb.simulate_batch("loop", NOISY, seeds=[1]), "loop"),
        (lambda: wb.simulate_batch(LOOP, None, seeds=[1]), "experiment"),
        (lambda: wb.simulate_batch(LOOP, NOISY, seeds=np.array(3)), "seeds"),
        (lambda: wb.pareto_front(LOOP, known=None), "pareto_front.known"),
        (lambda: wb.pareto_front(LOOP, known=3.0), "pareto_front.known"),
        (lambda: wb.Bounds().contains(None), "controller"),
        (lambda: wb.describing_function(LOOP, sampling_delay="x"), "sampling_delay"),
        (lambda: wb.PID(0.5, 20.0, form="series").with_ideal(1.0, 2.0, "a"), "PID.Td"),
        (lambda: wb.PID(0.5, 20.0, form="series").with_ideal(1.0, 20.0, math.nan), "PID.Td"),
        (lambda: wb.PID(0.5, 20.0, form="parallel").with_ideal("a", 2.0), "PID.Kc"),
    ],
)
def test_it_is_named(call: Callable[[], object], where: str) -> None:
    with pytest.raises(wb.InvalidValue) as told:
        call()
    assert where in str(told.value)
    assert "must be" in str(told.value)
    assert "\n" not in str(told.value)
