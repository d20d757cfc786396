"""A filter between valve and PV: it hides how a stem slips, and acquits no valve that simulates PV."""

from __future__ import annotations

import math

import numpy as np
import pytest

import workbench as wb


def filtered(d: float, lag: float, noise: float) -> wb.Record:
    """A loop whose PV passes a filter of time constant `lag` (s) before the controller sees it; d: of Stenman, %."""
    rng, plant, smooth = np.random.default_rng(1), math.exp(-1.0 / 10.0), math.exp(-1.0 / lag)
    y = seen = x = integral = 0.0
    stem = [0.0, 0.0, 0.0]
    pv, op, sp = [], [], []
    for k in range(900):
        setpoint = 6.0 * (k >= 50) - 9.0 * (k >= 400) + 5.0 * (k >= 650)
        measured = seen + noise * rng.normal()
        integral += 0.05 * (setpoint - measured)
        u = 0.6 * (setpoint - measured) + integral
        x = u if abs(u - x) > d else x
        stem.append(x)
        pv.append(measured + 50.0)
        op.append(u + 40.0)
        sp.append(setpoint + 50.0)
        y = plant * y + 1.5 * (1.0 - plant) * stem[-3]
        seen = smooth * seen + (1.0 - smooth) * y
    return wb.Record(np.array(pv), np.array(op), 1.0, sp=np.array(sp))


@pytest.mark.parametrize(("d", "lag", "noise"), [(0.5, 8.0, 0.02), (0.5, 4.0, 0.1), (1.0, 8.0, 0.002)])
def test_a_valve_whose_slips_a_filter_hides_is_not_acquitted(d: float, lag: float, noise: float) -> None:
    found = wb.detect(filtered(d, lag, noise))
    assert found.verdict == "undecided"
    assert "a filter or another lag between valve and PV hides how a stem slips" in found.reasons[0]


@pytest.mark.parametrize(("lag", "noise"), [(8.0, 0.02), (4.0, 0.1)])
def test_a_healthy_valve_behind_a_filter_is_acquitted(lag: float, noise: float) -> None:
    assert wb.detect(filtered(0.0, lag, noise)).verdict == "no_stiction"
