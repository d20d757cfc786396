"""PV that is recorded later than the controller saw it: seen, told, and the loop looked at as the controller saw it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.detect.late import as_seen, earlier, late, later
from workbench.estimate.estimate import linear_loop
from workbench.model.study import NamedEstimate
from workbench.report.estimates import estimate_sentences

LOOP = wb.Loop(wb.FOPDT(1.2, 12.0, 3.0), wb.Stenman(2.0), wb.PID(Kc=1.0, Ti=12.0), 1.0)
STEPS = [wb.Step(3.0), wb.Step(-2.0, at=150.0), wb.Step(2.5, at=300.0), wb.Step(-3.0, at=450.0)]


def run_of(loop: wb.Loop, noise: float = 0.15, moved: bool = True) -> wb.Record:
    experiment = wb.Experiment(600.0, setpoint=STEPS if moved else STEPS[:1], noise=wb.Noise(noise, 3))
    run = wb.simulate(loop, experiment)
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0, valve_position=run.valve + 40.0)


def delayed(record: wb.Record, samples: int, with_sp: bool = False) -> wb.Record:
    """The record that a historian keeps whose PV comes late; its OP is that of the same times."""
    last = len(record) - samples
    return wb.Record(
        record.pv[:last],
        record.op[samples:],
        record.sample_time,
        sp=record.sp[:last] if with_sp else record.sp[samples:],
        valve_position=record.valve_position[samples:],
    )


@pytest.mark.parametrize("valve", [wb.Stenman(2.0), wb.Choudhury(3.0, 1.0), wb.Ideal()])
@pytest.mark.parametrize("samples", [1, 4, 10])
@pytest.mark.parametrize("with_sp", [False, True])
def test_how_late_pv_is_recorded_is_seen(valve: wb.Stenman, samples: int, with_sp: bool) -> None:
    record = run_of(replace(LOOP, valve=valve))
    assert late(record) == (0, False, False)
    assert late(delayed(record, samples, with_sp)) == (samples, with_sp, False)


@pytest.mark.parametrize("action", ["reverse", "direct"])
def test_of_either_action_and_without_a_setpoint_move(action: str) -> None:
    plant = wb.FOPDT(1.2 if action == "reverse" else -1.2, 12.0, 3.0)
    record = run_of(replace(LOOP, plant=plant, controller=wb.PID(Kc=1.0, Ti=12.0, action=action)), moved=False)
    assert late(delayed(record, 2)).samples == 2
    assert late(replace(delayed(record, 2), sp=None)).samples == 2


@pytest.mark.parametrize(
    "settings",
    [
        {"Td": 3.0},
        {"Td": 3.0, "derivative_on": "pv"},
        {"form": "series", "Td": 2.0},
        {"setpoint_weight": 0.2},
        {"output_resolution": 0.5},
        {"compensator": wb.Knocker(1.0, 2.0, 10.0)},
        {"compensator": wb.ConstantReinforcement(1.0)},
        {"compensator": wb.Dither(1.0, 4.0)},
        {"compensator": wb.IntegralDeadband(0.5)},
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.15])
def test_no_controller_passes_for_a_late_pv(settings: dict[str, object], noise: float) -> None:
    controller = wb.PID(**{"Kc": 0.8, "Ti": 12.0, **settings})
    assert late(run_of(replace(LOOP, controller=controller), noise)).samples == 0


@pytest.mark.parametrize("tau", [0.3, 2.0, 20.0])
@pytest.mark.parametrize("kind", ["steps", "random walk", "at random"])
def test_a_plant_that_answers_a_hand_does_not_either(kind: str, tau: float) -> None:
    rng = np.random.default_rng(4)
    op = {
        "steps": np.repeat(rng.normal(size=20), 30),
        "random walk": np.cumsum(rng.normal(size=600)),
        "at random": rng.normal(size=600),
    }[kind]
    pv = np.zeros(600)
    for k in range(4, 600):
        pv[k] = pv[k - 1] + (1.0 - np.exp(-1.0 / tau)) * (1.5 * op[k - 4] - pv[k - 1])
    assert late(wb.Record(pv + 0.01 * rng.normal(size=600), op, 1.0)).samples == 0


def test_records_that_hold_too_little_are_as_they_are() -> None:
    record = delayed(run_of(LOOP), 2)
    short = wb.Record(record.pv[:99], record.op[:99], 1.0)
    still = replace(record, op=np.full(len(record), 40.0))
    dead = replace(record, pv=np.full(len(record), 50.0))
    for one in (short, still, dead):
        assert as_seen(one, "look") == (one, (0, False, False))


def test_as_seen_is_the_record_before_pv_came_late() -> None:
    record = run_of(LOOP)
    for with_sp in (False, True):
        seen, found = as_seen(delayed(record, 3, with_sp), "look")
        assert found.samples == 3
        n = len(seen)
        assert np.array_equal(seen.pv, record.pv[:n])
        assert np.array_equal(seen.op[3:], record.op[3:n])
        assert np.array_equal(seen.valve_position[3:], record.valve_position[3:n])
        assert np.array_equal(seen.sp[3:], record.sp[3:n])
        assert as_seen(seen, "look")[1].samples == 0
    signal = np.arange(5.0)
    assert later(signal, 2).tolist() == [0.0, 0.0, 0.0, 1.0, 2.0]
    assert earlier(signal, 2).tolist() == [2.0, 3.0, 4.0, 4.0, 4.0]


def test_detection_looks_at_the_loop_as_the_controller_saw_it() -> None:
    record = replace(run_of(LOOP), valve_position=None)
    given = wb.Record(record.pv[:-2], record.op[2:], 1.0, sp=record.sp[2:])
    found = wb.detect(given)
    assert (found.verdict, found.pv_late) == ("stiction", 2.0)
    assert found.record is given
    assert found.reasons[-1].startswith("PV is recorded 2 s (2 samples) later than the controller saw it")
    assert wb.detect(record).pv_late == 0.0
    # The stem of a model of the loop comes in the times of the record's OP.
    valve = wb.Stenman(2.0)
    stem = run_of(LOOP).valve_position
    at_its_times = wb.detect(given, fitted=(valve, stem[2:])).test
    assert at_its_times.predicting == pytest.approx(wb.detect(record, fitted=(valve, stem)).test.predicting, rel=0.1)


def test_the_estimate_has_the_dead_time_that_the_controller_sees() -> None:
    record = run_of(LOOP)
    given = replace(delayed(record, 2), valve_position=None)
    found = wb.estimate(given)
    assert found.record is given
    assert (found.verdict, found.identifiable, found.pv_late) == ("stiction", True, 2.0)
    assert found.plant.dead_time == pytest.approx(3.0, abs=0.5)
    assert found.valve.stick_band == pytest.approx(2.0, rel=0.01)
    # The stem is told at the times of the record's OP, PV's prediction at those of its PV.
    assert np.mean(np.abs(found.valve_position - record.valve_position[2:]) > 0.1) < 0.03
    assert float(np.std(given.pv - found.prediction)) == pytest.approx(0.15, rel=0.1)
    assert any("later than the controller saw it" in reason for reason in found.reasons)
    told = estimate_sentences(NamedEstimate("Loop", found))
    assert "Loop: PV is recorded 2 s later than the controller saw it; the dead time is without it." in told


def test_so_has_the_linear_model() -> None:
    record = replace(run_of(replace(LOOP, valve=wb.Ideal())), valve_position=None)
    given = wb.Record(record.pv[:-2], record.op[2:], 1.0, sp=record.sp[2:])
    assert linear_loop(given).plant.dead_time == pytest.approx(linear_loop(record).plant.dead_time, abs=0.2)


def test_what_may_be_late_acquits_no_valve() -> None:
    # A historian's noise on PV: the controller's law no longer holds exactly, with PV ahead as little as without.
    record = replace(run_of(LOOP, noise=0.3), valve_position=None)
    noise = 0.4 * np.random.default_rng(1).normal(size=len(record) - 2)
    given = wb.Record(record.pv[:-2] + noise, record.op[2:], 1.0, sp=record.sp[2:])
    found = wb.detect(given)
    assert late(given).perhaps
    assert found.verdict == "undecided"
