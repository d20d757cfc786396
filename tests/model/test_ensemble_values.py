"""Ensembles and constraints: what they allow, and the default that a loop is given."""

from __future__ import annotations

from dataclasses import replace

import pytest
from loops import paper_loop

import workbench as wb


def test_plant_ready_of_the_papers_loop():
    assert wb.Ensemble.plant_ready(paper_loop(0.5, 20.0)) == wb.Ensemble(
        duration=1000.0,
        setpoint=(1.0, 8.0),
        load=(0.5, 2.0),
        load_time=(200.0, 500.0),
        stem_offset=1.0,
        noise=(0.02, 0.1),
        gain=0.2,
        time_constant=0.2,
        dead_time=0.2,
        stiction=0.3,
    )


def test_plant_ready_scales_with_the_loop_and_stays_bounded():
    fast = replace(paper_loop(0.5, 20.0), plant=wb.FOPDT(-3.0, 0.5, 0.1), valve=wb.Choudhury(S=6.0, J=2.0))
    chosen = wb.Ensemble.plant_ready(fast)
    assert chosen.duration == 300.0
    assert chosen.setpoint == pytest.approx((6.0, 48.0))
    assert chosen.load == pytest.approx((1.0, 4.0))
    slow = replace(fast, plant=wb.Integrating(0.01, 80.0), valve=wb.Ideal())
    chosen = wb.Ensemble.plant_ready(slow)
    assert chosen.duration == 5000.0
    assert chosen.time_constant == 0.0
    assert chosen.load == pytest.approx((0.25, 1.0))
    assert chosen.setpoint == pytest.approx((0.5 * 3.2, 4.0 * 3.2))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("duration", 0.0), ("setpoint", (2.0, 1.0)), ("load", (-1.0, 1.0)), ("load_time", (0.0, 101.0)),
        ("stem_offset", 1.5), ("noise", (0.0, float("inf"))), ("gain", 1.0), ("stiction", -0.1), ("draws", 0),
        ("draws", 20_001), ("seed", -1), ("statistic", "median"), ("level", 1.0), ("level", 0.0),
    ],
)  # fmt: skip
def test_wrong_ensembles_are_refused(name, value):
    with pytest.raises(wb.InvalidValue) as caught:
        wb.Ensemble(**{"duration": 100.0, name: value})
    assert caught.value.where.startswith(f"Ensemble.{name}")


@pytest.mark.parametrize(
    ("name", "value"),
    [("max_sensitivity", 1.0), ("gain_margin", 0.5), ("phase_margin", 91.0), ("valve_travel", 0.0)],
)
def test_wrong_constraints_are_refused(name, value):
    with pytest.raises(wb.InvalidValue) as caught:
        wb.Constraints(**{name: value})
    assert caught.value.where == f"Constraints.{name}"
