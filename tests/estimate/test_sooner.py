"""An OP that the historian reads before the controller's execution: PV answers the valve before that OP moves it."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import workbench as wb
from workbench.estimate import sooner
from workbench.estimate.loads.swing import Answered
from workbench.model.study import NamedEstimate
from workbench.report.estimates import estimate_sentences

PLANT, VALVE = wb.FOPDT(0.47, 5.8, 0.32), wb.Stenman(2.4)


@cache
def found(late: int) -> wb.Estimate:
    loop = wb.Loop(PLANT, VALVE, wb.PID(Kc=3.2, Ti=5.8), 1.0)
    run = wb.simulate(loop, wb.Experiment(900.0, setpoint=wb.Step(1.7), noise=wb.Noise(0.03, 1)))
    op = np.concatenate([np.full(late, run.op[0]), run.op[: run.op.size - late]])
    record = wb.Record(run.pv + 50.0, op + 50.0, 1.0, sp=run.sp + 50.0)
    return wb.estimate(record, plant="fopdt")


@pytest.mark.parametrize("late", [0, 1, 2])
def test_plant_and_valve_are_those_of_the_op_that_was_sent(late: int) -> None:
    # Of an OP a sample late the gain came out a third too low, with a range below the truth, and was called identified.
    one = found(late)
    assert (one.verdict, one.identifiable) == ("stiction", True)
    assert one.op_late == late
    assert one.valve.stick_band == pytest.approx(VALVE.d, rel=0.02)
    assert one.plant.gain == pytest.approx(PLANT.gain, rel=0.05)
    assert one.plant.time_constant == pytest.approx(PLANT.time_constant, rel=0.1)
    assert one.plant.dead_time == pytest.approx(PLANT.dead_time, abs=0.15)
    low, high = one.intervals.gain or (np.nan, np.nan)
    assert low <= PLANT.gain <= high
    assert one.valve_position.shape == one.prediction.shape == one.record.op.shape
    assert any("later than it was sent" in reason for reason in one.reasons) is (late > 0)


def test_the_report_says_by_how_much() -> None:
    said = " ".join(estimate_sentences(NamedEstimate("Flow", found(1))))
    assert "Flow: OP is recorded up to 1 s later than it was sent; the dead time is from there on." in said
    assert "later than it was sent" not in " ".join(estimate_sentences(NamedEstimate("Flow", found(0))))


@pytest.mark.parametrize(
    ("verdict", "left", "colours", "samples"),
    [("stiction", 0.9, 2, 3), ("stiction", 1.1, 1, 3), ("stiction", 1.1, 2, 0), ("undecided", 0.9, 1, 0)],
)
def test_op_stands_where_a_stem_that_is_sent_sooner_explains_less(
    monkeypatch: pytest.MonkeyPatch, verdict: str, left: float, colours: int, samples: int
) -> None:
    # Three samples are the most, and what was found stands where no stem is known a sample earlier, or more is left.
    monkeypatch.setattr(sooner, "_answers_before", lambda *_: True)
    monkeypatch.setattr(sooner, "runs_faster", lambda _: False)
    record = wb.Record(np.sin(np.arange(50.0)), np.arange(50.0), 1.0)
    looked: list[float] = []

    def search(one: wb.Record) -> Answered:
        moved = float(one.op[0])
        looked.append(moved)
        model = SimpleNamespace(verdict=verdict if moved else "stiction", valve=VALVE, residual_variance=left**moved)
        path = SimpleNamespace(fit=SimpleNamespace(theta=0.2), even=True)
        return Answered(model, [path], SimpleNamespace(a=np.ones(colours), integrating=False), ())

    sent, found, by = sooner.as_sent(record, search, lambda one: one, lambda *_: False)
    assert by == samples == sent.op[0]
    assert found.model.residual_variance == left**samples
    assert max(looked) == max(samples, 1)
