"""The long run of a cascade: its figures against plain runs, and the cycle's appearance in both loops."""

from __future__ import annotations

import numpy as np
import pytest
from cascades import flow_and_temperature

import workbench as wb

STEP = wb.Experiment(3000.0, setpoint=wb.Step(5.0))


@pytest.mark.parametrize(("Kc", "d"), [(1.5, 1.0), (3.0, 2.0), (0.8, 0.5)])
def test_figures_are_those_of_a_plain_run(Kc, d):
    cascade = flow_and_temperature(wb.PID(Kc, 80.0), valve=wb.Stenman(d))
    cycle = wb.cascade_cycle(cascade, STEP)
    assert cycle.outcome == "cycles"
    run = wb.simulate(cascade, wb.Experiment(100_000.0, setpoint=wb.Step(5.0)))
    late = slice(60_000, None)
    moves = np.diff(run.secondary.valve[late])
    ways = np.sign(moves[moves != 0.0])
    reversals = np.count_nonzero(ways[1:] != ways[:-1])
    assert cycle.period == pytest.approx(2.0 * 40_000.0 / reversals, rel=0.03)
    assert cycle.travel_per_hour == pytest.approx(np.abs(moves).sum() / 40_000.0 * 3600.0, rel=0.03)
    # The whole late run's extremes are at least the median cycle's.
    for seen, signals in (
        (cycle.primary, (run.primary.pv, run.primary.op)),
        (cycle.secondary, (run.secondary.pv, run.secondary.op)),
    ):
        for swing, signal in zip((seen.pv_peak_to_peak, seen.op_peak_to_peak), signals, strict=True):
            assert 0.6 * np.ptp(signal[late]) <= swing <= 1.001 * np.ptp(signal[late])


def test_the_setpoint_of_the_secondary_cycles_with_its_pv_and_the_primary_is_filtered():
    cycle = wb.cascade_cycle(flow_and_temperature(), STEP)
    first, second = cycle.primary, cycle.secondary
    assert second.sp_peak_to_peak == first.op_peak_to_peak > 0.05
    assert second.sp_phase == first.op_phase
    assert np.isnan(first.sp_phase)
    # From the flow to the temperature: gain and phase of a first-order lag with dead time at the cycle's frequency.
    w = 2.0 * np.pi / cycle.period
    response = 1.2 / (1.0 + 60.0j * w) * np.exp(-10.0j * w)
    assert first.pv_amplitude / second.pv_amplitude == pytest.approx(abs(response), rel=0.03)
    lag = (first.pv_phase - second.pv_phase) % 360.0
    assert lag == pytest.approx(-np.degrees(np.angle(response)) % 360.0, abs=3.0)
    # From the stem to the flow: the secondary's plant, half a sample of hold besides.
    response = 1.0 / (1.0 + 3.0j * w) * np.exp(-1.5j * w)
    assert second.pv_phase == pytest.approx(-np.degrees(np.angle(response)), abs=3.0)


def test_seen_alone_only_the_secondary_shows_stiction():
    cycle = wb.cascade_cycle(flow_and_temperature(), STEP)
    verdicts = []
    for run in (cycle.late.primary, cycle.late.secondary):
        part = slice(-1500, None)
        record = wb.Record(pv=run.pv[part], op=run.op[part], sp=run.sp[part], sample_time=1.0)
        verdicts.append(wb.detect(record).verdict)
    assert verdicts == ["no_stiction", "stiction"]


def test_what_settles_and_what_runs_away():
    still = wb.cascade_cycle(flow_and_temperature(valve=wb.Ideal()), STEP)
    assert still.outcome == "settles"
    assert still.reason == "both loops come to rest, the primary on its setpoint"
    assert still.late.primary.pv[-1] == pytest.approx(5.0, abs=1e-9)
    banded = (
        wb.PID(0.5, 80.0, compensator=wb.IntegralDeadband(2.0)),
        wb.PID(0.3, 5.0, compensator=wb.IntegralDeadband(1.1)),
    )
    held = wb.cascade_cycle(flow_and_temperature(*banded), STEP)
    assert held.outcome == "settles"
    assert "with an error of" in held.reason
    wild = wb.cascade_cycle(flow_and_temperature(wb.PID(60.0, 80.0)), wb.Experiment(500.0, setpoint=wb.Step(1.0)))
    assert wild.outcome == "undecided"
    assert wild.reason == "PV grows without bound"


def test_a_load_within_the_last_dead_time_still_arrives():
    # Settled with and without it would differ if the primary's load stopped where the experiment does.
    load = wb.CascadeExperiment(500.0, setpoint=wb.Step(5.0), primary_load=wb.Step(1.0, at=498.0))
    cycle = wb.cascade_cycle(flow_and_temperature(valve=wb.Ideal()), load)
    assert cycle.late.secondary.pv[-1] == pytest.approx(5.0 / 1.2 - 1.0, abs=1e-9)


def test_progress_and_bad_input():
    shares = []
    wb.cascade_cycle(flow_and_temperature(), STEP, progress=shares.append)
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] <= shares[-1] < 1.0
    with pytest.raises(wb.InvalidValue, match="cascade"):
        wb.cascade_cycle("loop", STEP)
