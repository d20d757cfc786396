"""How a record was kept: a PV by exception, an OP in steps, values of OP that nobody sent. No valve sticks for that."""

from __future__ import annotations

import numpy as np
import pytest

import workbench as wb
from workbench.detect.causes import below_step, between_values, kept_by_exception, no_percent
from workbench.detect.detect import _doubtful
from workbench.detect.oscillation import oscillation_of
from workbench.detect.resolution import exception_of, unseen
from workbench.detect.spikes import op_spikes_of
from workbench.record.rounding import on_lines

PLANT = wb.FOPDT(1.2, 20.0, 7.0)
TS = 5.0


def run_of(valve: object, seed: int, noise: float = 0.05, duration: float = 4500.0) -> wb.Run:
    loop = wb.Loop(PLANT, valve, wb.PID(Kc=0.5, Ti=25.0), TS)
    moves = [wb.Step(2.0, 100.0), wb.Step(-3.0, 0.5 * duration)]
    return wb.simulate(loop, wb.Experiment(duration, setpoint=moves, noise=wb.Noise(noise, seed)))


def record_of(run: wb.Run, **more: object) -> wb.Record:
    signals = {"pv": run.pv + 52.0, "op": run.op + 43.0, "sp": run.sp + 52.0, "sample_time": TS}
    return wb.Record(**(signals | more))


def by_exception(signal: np.ndarray, deviation: float) -> np.ndarray:
    kept = signal.copy()
    for k in range(1, kept.size):
        kept[k] = signal[k] if abs(signal[k] - kept[k - 1]) > deviation else kept[k - 1]
    return kept


def test_a_healthy_valve_is_not_accused_for_a_pv_that_is_kept_by_exception() -> None:
    run = run_of(wb.Ideal(), 1)
    record = record_of(run, pv=by_exception(run.pv + 52.0, 0.3))
    assert exception_of(record.pv) == pytest.approx(0.3, rel=0.1)
    assert wb.detect(record).verdict != "stiction"
    found = wb.estimate(record, plant="fopdt")
    assert found.verdict != "stiction"
    assert not found.identifiable
    assert any(reason.startswith("PV was kept only where it had moved by 0.3") for reason in found.reasons)


def drawn(signal: np.ndarray, deviation: float) -> np.ndarray:
    """What a historian shows that kept values a deviation apart and draws straight lines between them."""
    kept = [0]
    for k in range(1, signal.size):
        if abs(signal[k] - signal[kept[-1]]) > deviation:
            kept.append(k)
    kept = sorted({*kept, signal.size - 1})
    return np.round(np.interp(np.arange(signal.size), kept, signal[kept]), 5)


def on_share(signal: np.ndarray) -> float:
    return float(np.mean(on_lines(signal)))


def under_load(valve: wb.Valve, seed: int) -> wb.Record:
    """A loop at constant setpoint under a load that wanders, PV drawn in lines of a tenth of its range."""
    rng, load = np.random.default_rng(seed), np.zeros(1000)
    for k in range(1, 1000):
        load[k] = 0.9 * load[k - 1] + rng.normal(0.0, 0.3)
    loop = wb.Loop(wb.FOPDT(1.5, 12.0, 4.0), valve, wb.PID(Kc=0.8, Ti=15.0), 1.0)
    given = wb.Experiment(1000.0, load=wb.Series(tuple(load.tolist())), noise=wb.Noise(0.1, seed))
    run = wb.simulate(loop, given)
    return wb.Record(drawn(run.pv + 50.0, 0.1 * np.ptp(run.pv)), np.round(run.op + 40.0, 4), 1.0, sp=run.sp + 50.0)


@pytest.mark.parametrize("seed", [3, 8])
def test_lines_that_a_historian_drew_accuse_nobody(seed: int) -> None:
    # Along them PV foretells itself, and some stem or other is seen in where they bend.
    record = under_load(wb.Ideal(), seed)
    assert on_share(record.pv) > 0.25
    found = wb.detect(record)
    assert found.verdict == "undecided"
    assert "lie on straight lines between others" in found.reasons[0]


def test_lines_that_a_historian_drew_accuse_nobody_in_an_estimate() -> None:
    found = wb.estimate(under_load(wb.Ideal(), 3), plant="fopdt", valve="stenman")
    assert found.verdict == "undecided"
    assert any("lie on straight lines between others" in reason for reason in found.reasons)


@pytest.mark.parametrize("seed", [0, 2])
def test_a_valve_that_sticks_is_found_behind_lines_where_it_simulates_pv(seed: int) -> None:
    assert wb.detect(under_load(wb.Stenman(3.0), seed)).verdict == "stiction"


def test_what_bends_everywhere_was_not_drawn_in_lines_and_what_a_level_does_is_no_historians_work() -> None:
    t = np.arange(1000.0)
    assert on_share(np.sin(0.05 * t)) == 0.0
    assert on_share(np.round(np.sin(0.05 * t), 3)) == 0.0
    assert on_share(np.random.default_rng(0).normal(size=1000)) == 0.0
    assert on_share(np.round(np.random.default_rng(0).normal(size=1000), 1)) < 0.25
    spoiled = np.random.default_rng(0).normal(size=1000)
    spoiled[500] = 1e12
    assert on_share(spoiled) == 0.0
    # A stem at rest draws lines of PV itself where nothing else does, and it explains them.
    loop = wb.Loop(wb.Integrating(0.02, 3.4), wb.Stenman(1.5), wb.PID(Kc=4.0, Ti=60.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1500.0, setpoint=[wb.Step(1.0), wb.Step(-1.5, 700.0)]))
    record = wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)
    assert on_share(record.pv) > 0.25
    estimated = wb.estimate(record, plant="integrating", valve="stenman")
    assert wb.detect(record).verdict == estimated.verdict == "stiction"


def test_a_pv_of_a_few_values_accuses_nobody() -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 6.0, 3.0), wb.Ideal(), wb.PID(Kc=0.8, Ti=8.0), 1.0)
    moves = [wb.Step(3.0, 300.0), wb.Step(-5.0, 800.0)]
    run = wb.simulate(loop, wb.Experiment(1500.0, setpoint=moves, noise=wb.Noise(0.05, 1)))
    record = wb.Record(by_exception(run.pv + 50.0, 1.2), run.op + 40.0, 1.0, sp=run.sp + 50.0)
    changes = int(np.count_nonzero(np.diff(record.pv)))
    assert changes < 8
    for found in (wb.detect(record), wb.estimate(record, plant="fopdt", valve="stenman")):
        assert found.verdict == "undecided"
        assert any(reason.startswith(f"PV took another value {changes} times only") for reason in found.reasons)


def test_a_valve_that_sticks_is_found_in_a_pv_that_is_kept_by_exception() -> None:
    run = run_of(wb.Stenman(1.5), 1)
    found = wb.estimate(record_of(run, pv=by_exception(run.pv + 52.0, 0.3)), plant="fopdt", valve="stenman")
    assert found.verdict == "stiction"
    assert found.valve.stick_band == pytest.approx(1.5, rel=0.02)
    # The ranges allow for a noise that is one, and not for what the historian left out.
    assert not found.identifiable


def test_what_moves_from_nothing_on_or_by_a_converters_steps_was_not_kept_by_exception() -> None:
    run = run_of(wb.Stenman(1.5), 1, noise=0.0)
    # Without noise a stem at rest leaves PV on one value for long; it comes there by less and less.
    assert np.count_nonzero(np.diff(run.pv) == 0.0) > 50
    assert exception_of(run.pv) == 0.0
    noisy = run_of(wb.Stenman(1.5), 1).pv
    assert exception_of(noisy) == 0.0
    coarse = np.round(noisy / 0.5) * 0.5
    assert np.mean(np.diff(coarse) == 0.0) > 0.5
    assert exception_of(coarse) == 0.0
    assert unseen(by_exception(noisy, 0.3)) == pytest.approx(0.03, rel=0.2)


def test_a_healthy_valve_is_not_accused_for_an_op_in_steps() -> None:
    """A model's stem is made of OP within its steps: it explained PV better than the rounded one, sticking or not."""
    run = run_of(wb.Ideal(), 2)
    found = wb.estimate(record_of(run, op=np.round((run.op + 43.0) / 0.2) * 0.2), plant="fopdt")
    assert found.verdict != "stiction"
    low, high = found.intervals.gain
    assert low <= 1.25
    assert high >= 1.15


def test_a_stem_that_ops_steps_may_have_made_is_sought_within_them_too() -> None:
    test = wb.detect(record_of(run_of(wb.Choudhury(2.0, 1.0), 2))).test
    assert test is not None
    said = []
    for valve in (wb.Ideal(), wb.Choudhury(2.0, 1.0)):
        run = run_of(valve, 2)
        record = record_of(run, op=np.round((run.op + 43.0) / 0.2) * 0.2)
        whole = oscillation_of(record.pv, TS)
        said.append(_doubtful(record, whole, test, whole.period))
    assert (
        "OP is recorded in steps of 0.2 %: where the controller's law has it within them no stem is needed" in said[0]
    )
    assert said[1] == ""


def test_a_valve_that_sticks_is_found_behind_an_op_in_steps() -> None:
    run = run_of(wb.Stenman(1.5), 2)
    found = wb.estimate(record_of(run, op=np.round((run.op + 43.0) / 0.2) * 0.2), plant="fopdt", valve="stenman")
    assert found.verdict == "stiction"
    assert found.valve.stick_band == pytest.approx(1.5, rel=0.05)


def test_a_band_below_ops_step_is_none() -> None:
    op = np.round(np.sin(np.arange(400.0) / 9.0) / 0.2) * 0.2
    assert "OP is recorded in steps of 0.2 %" in below_step(op, 0.05)
    assert below_step(op, 0.3) == ""
    assert below_step(np.sin(np.arange(400.0) / 9.0), 0.05) == ""


def test_an_op_in_a_few_steps_acquits_no_valve() -> None:
    loop = wb.Loop(wb.FOPDT(1.025, 17.59, 4.308), wb.Stenman(3.304), wb.PID(Kc=1.305, Ti=16.91), 1.0)
    run = wb.simulate(loop, wb.Experiment(1500.0, setpoint=wb.Step(3.96), noise=wb.Noise(0.1059, 41)))
    pv, sp = run.pv[300:] + 50.0, run.sp[300:] + 50.0
    found = wb.detect(wb.Record(pv, np.round(run.op[300:] / 2.478) * 2.478 + 50.0, 1.0, sp=sp))
    assert found.verdict == "undecided"
    assert found.reasons[0] == "OP is recorded in steps of 2.48 %: a band of 1.86 % is none that it can show"
    assert wb.detect(wb.Record(pv, run.op[300:] + 50.0, 1.0, sp=sp)).verdict == "stiction"


def test_hardly_a_sample_that_was_recorded_accuses_nobody() -> None:
    run = run_of(wb.Stenman(1.5), 1)
    counts = {"rows": 40, "resampled": len(run.pv), "between": int(0.95 * len(run.pv))}
    thin = record_of(run, counts=counts)
    assert "95% of PV's samples lie between the values that were recorded" in between_values(thin)
    assert wb.detect(record_of(run)).verdict == "stiction"
    for found in (wb.detect(thin), wb.estimate(thin, plant="fopdt", valve="stenman")):
        assert found.verdict == "undecided"
        assert found.reasons[0] == between_values(thin)
    half = record_of(run, counts=counts | {"between": int(0.6 * len(run.pv))})
    assert between_values(half) == ""
    assert "no range allows for it" in kept_by_exception(half)
    assert kept_by_exception(record_of(run)) == ""


def test_wrong_values_of_op_that_sp_and_pv_know_nothing_of_are_left_out() -> None:
    run = run_of(wb.Stenman(1.5), 1)
    op = run.op + 43.0
    bad = [200, 505, 800]
    # Less than twice what OP moves over: without SP this might be what a setpoint step sends.
    op[bad] += 8.0
    assert np.ptp(run.op) < 8.0 < 2.0 * np.ptp(run.op)
    record = record_of(run, op=op)
    assert np.flatnonzero(op_spikes_of(record)).tolist() == bad
    assert not op_spikes_of(wb.Record(record.pv, op, TS)).any()
    found = wb.estimate(record, plant="fopdt", valve="stenman")
    assert found.identifiable
    assert found.intervals.d[0] <= 1.5 <= found.intervals.d[1]
    assert found.intervals.gain[0] <= 1.2 <= found.intervals.gain[1]
    assert any(reason.startswith("3 samples of OP stand out") for reason in found.reasons)


@pytest.mark.parametrize("derivative_on", ["error", "pv"])
def test_what_a_controller_sends_for_a_setpoint_step_stays(derivative_on: str) -> None:
    loop = wb.Loop(PLANT, wb.Stenman(1.0), wb.PID(Kc=0.8, Ti=25.0, Td=6.0, derivative_on=derivative_on), TS)
    moves = [wb.Step(2.0 * (-1) ** i, 400.0 * (i + 1)) for i in range(12)]
    for seed in range(2):
        run = wb.simulate(loop, wb.Experiment(6000.0, setpoint=moves, noise=wb.Noise(0.03, seed)))
        assert not op_spikes_of(record_of(run)).any()


def test_an_op_in_another_unit_identifies_nothing_in_per_cent() -> None:
    run = run_of(wb.Stenman(1.5), 1)
    record = record_of(run, op=(run.op + 43.0) * 40.95)
    assert "which is no output in %" in no_percent(record.op)
    found = wb.estimate(record, plant="fopdt", valve="stenman")
    assert found.verdict == "stiction"
    assert not found.identifiable
    assert no_percent(record.op) in found.reasons
    # In deviation from the resting output, and a little beyond its ends, OP is in %.
    assert no_percent(run.op) == no_percent(run.op + 103.0) == no_percent(run.op - 4.0) == ""
