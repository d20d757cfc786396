"""Single wrong values of PV and OP, the sensor's or the historian's: found, told, and left out of verdict and model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import workbench as wb
from workbench.detect.causes import beyond_op
from workbench.detect.spikes import MOST, op_spikes_of, spikes_of
from workbench.model.record import FloatArray

N = 1000


def slow_load(rng: np.random.Generator) -> FloatArray:
    load = np.zeros(N)
    for k in range(1, N):
        load[k] = 0.99 * load[k - 1] + rng.normal(0.0, 0.3)
    return load


def sticky(seed: int) -> wb.Record:
    rng = np.random.default_rng(seed)
    loop = wb.Loop(wb.FOPDT(1.0, 12.0, 3.0), wb.Stenman(3.0), wb.PID(Kc=1.0, Ti=12.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(float(N), load=wb.Series(slow_load(rng).tolist())))
    return wb.Record(run.pv + rng.normal(0.0, 0.1, N) + 120.0, run.op + 45.0, 1.0, sp=run.sp + 120.0)


def moved(samples: int) -> wb.Record:
    """A loop whose valve sticks, under setpoint moves and no load, which an estimate would look for steps in."""
    loop = wb.Loop(wb.FOPDT(1.0, 12.0, 3.0), wb.Stenman(3.0), wb.PID(Kc=1.0, Ti=12.0), 1.0)
    moves = [wb.Step(4.0), wb.Step(-6.0, 0.5 * samples)]
    run = wb.simulate(loop, wb.Experiment(float(samples), moves, noise=wb.Noise(0.1, 0)))
    return wb.Record(run.pv + 120.0, run.op + 45.0, 1.0, sp=run.sp + 120.0)


def healthy(seed: int, spikes: FloatArray) -> wb.Record:
    """A loop without stiction whose controller sees the sensor's spikes (EU) and answers them."""
    rng = np.random.default_rng(seed)
    load, noise, pole = slow_load(rng), rng.normal(0.0, 0.1, N) + spikes, float(np.exp(-1.0 / 12.0))
    pv, op, past, y, u, last = np.empty(N), np.empty(N), [0.0] * 4, 0.0, 0.0, 0.0
    for k in range(N):
        error = -(y + noise[k])
        u += 2.0 * (error - last) + 2.0 / 12.0 * error
        pv[k], op[k], last = 120.0 - error, 45.0 + u, error
        past = [u + load[k], *past[:-1]]
        y = pole * y + (1.0 - pole) * past[3]
    return wb.Record(pv, op, 1.0, sp=np.full(N, 120.0))


@given(seed=st.integers(0, 10_000), scale=st.sampled_from([1e-3, 1.0, 1e4]), round_to=st.sampled_from([0.0, 0.5, 2.0]))
def test_noise_and_a_rounded_one_have_none(seed: int, scale: float, round_to: float) -> None:
    pv = np.random.default_rng(seed).normal(0.0, 1.0, 500)
    pv = np.round(pv / round_to) * round_to if round_to else pv
    assert not spikes_of(scale * pv + 50.0).any()


def test_sharp_peaks_steps_and_a_noisy_stretch_are_none() -> None:
    t = np.arange(600.0)
    triangle = np.abs((t % 40.0) - 20.0)
    assert not spikes_of(triangle).any()
    assert not spikes_of(np.where(t < 300.0, 0.0, 10.0)).any()
    noisy = np.where(t < 100.0, np.random.default_rng(0).normal(0.0, 1.0, 600), 0.0)
    assert not spikes_of(noisy).any()
    assert not spikes_of(np.zeros(600)).any()
    for few in range(12):
        assert not spikes_of(np.arange(float(few)) ** 2).any()


def test_they_are_found_alone_and_up_to_three_together() -> None:
    pv = np.random.default_rng(1).normal(50.0, 0.2, 600)
    pv[[60, 62, 200, 201, 400, 401, 402]] += [9.0, 8.0, -5.0, -6.0, 4.0, 5.0, 6.0]
    assert np.flatnonzero(spikes_of(pv)).tolist() == [60, 62, 200, 201, 400, 401, 402]
    # A PV that stands elsewhere for longer is one that the process may have had, and many are the noise it has.
    pv[500:504] += 9.0
    assert not spikes_of(pv)[500:504].any()
    often = np.random.default_rng(2).normal(0.0, 0.2, 600)
    often[10:590:40] += 9.0
    assert np.count_nonzero(spikes_of(often)) == 15 < MOST * 600
    often[30:590:40] += 9.0
    assert not spikes_of(often).any()


@pytest.mark.parametrize("seed", range(2))
def test_a_sensors_spikes_accuse_no_valve(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    spikes = np.where(rng.random(N) < 0.01, rng.choice([-3.0, 3.0], N), 0.0)
    record = healthy(seed, spikes)
    found = wb.detect(record)
    assert found.verdict != "stiction"
    assert found.record is record
    count = np.count_nonzero(spikes)
    assert any(f"{count} samples of PV stand out from" in reason for reason in found.reasons)


def test_a_few_zeros_hide_no_valve_that_sticks() -> None:
    record = moved(600)
    pv = record.pv.copy()
    pv[[150, 320, 450]] = 0.0
    hidden = wb.Record(pv, record.op, 1.0, sp=record.sp)
    how = {"plant": "fopdt", "valve": "stenman"}
    clean, found = wb.estimate(record, **how), wb.estimate(hidden, **how)
    assert clean.verdict == found.verdict == wb.detect(hidden).verdict == "stiction"
    assert found.valve.stick_band == pytest.approx(clean.valve.stick_band, rel=0.01)
    assert found.plant.gain == pytest.approx(clean.plant.gain, rel=0.01)
    assert found.noise_sd == pytest.approx(clean.noise_sd, rel=0.05)
    assert found.record is hidden
    assert any("3 samples of PV stand out from" in reason for reason in found.reasons)
    assert not any("stand out" in reason for reason in clean.reasons)


@pytest.mark.parametrize("wrong", [0.0, 100.0, -9999.0])
@pytest.mark.parametrize("both", [False, True])
def test_a_wrong_value_of_op_makes_no_wide_band(wrong: float, both: bool) -> None:
    record = sticky(0)
    op, pv = record.op.copy(), record.pv.copy()
    op[400] = wrong
    pv[400] = wrong if both else pv[400]
    hidden = wb.Record(pv, op, 1.0, sp=record.sp)
    assert np.flatnonzero(op_spikes_of(hidden)).tolist() == [400]
    clean, found = wb.detect(record), wb.detect(hidden)
    assert clean.verdict == found.verdict == "stiction"
    assert clean.test is not None
    assert found.test is not None
    assert found.test.band == pytest.approx(clean.test.band, rel=0.05)
    assert found.record is hidden
    assert sum("1 sample of OP stands out from its neighbours, and neither" in one for one in found.reasons) == 1
    assert sum("1 sample of PV stands out" in one for one in found.reasons) == both


def test_what_a_setpoint_step_sends_through_derivative_action_stays() -> None:
    loop = wb.Loop(
        wb.FOPDT(1.0, 12.0, 3.0),
        wb.Stenman(1.0),
        wb.PID(Kc=1.0, Ti=12.0, Td=5.0, derivative_filter=float("inf")),
        1.0,
    )
    load = wb.Series(slow_load(np.random.default_rng(0)).tolist())
    steps = wb.Experiment(float(N), setpoint=wb.Step(4.0, at=400.0), load=load, noise=wb.Noise(0.1, seed=0))
    run = wb.simulate(loop, steps)
    record = wb.Record(run.pv, run.op + 50.0, 1.0, sp=run.sp)
    assert np.flatnonzero(spikes_of(record.op)).tolist() == [400]
    assert not op_spikes_of(record).any()
    assert not op_spikes_of(replace(record, sp=None)).any()
    # Elsewhere a value so far from all others is nobody's.
    op = record.op.copy()
    op[700] = 0.0
    assert np.flatnonzero(op_spikes_of(replace(record, op=op))).tolist() == [700]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("size", [3.0, -20.0])
def test_what_the_controller_answers_a_sensors_spike_stays(seed: int, size: float) -> None:
    spikes = np.zeros(N)
    spikes[[150, 420, 421, 700]] = size
    record = healthy(seed, spikes)
    assert spikes_of(record.op).any()
    late = np.concatenate([np.full(3, record.pv[0]), record.pv[:-3]])
    for pv in (record.pv, late, np.round(2.0 * record.pv) / 2.0):
        assert not op_spikes_of(replace(record, pv=pv)).any()
    # A positioner's measured stem that goes with OP says that it was sent.
    op = record.op.copy()
    op[550] = 0.0
    assert np.flatnonzero(op_spikes_of(replace(record, op=op))).tolist() == [550]
    assert not op_spikes_of(replace(record, op=op, valve_position=op)).any()


def test_a_band_rests_on_more_than_a_few_values_of_op() -> None:
    cycle = 45.0 + np.abs((np.arange(600.0) % 80.0) - 40.0) / 20.0
    assert not beyond_op(cycle, 2.0)
    cycle[300:320] = 0.0  # too long for a spike, as a line that is down
    assert not beyond_op(cycle, 2.0)
    said = beyond_op(cycle, 46.0)
    assert said.startswith("a band of 46 % fits best, yet OP usually moves over 1.8")
    assert "were they sent?" in said
    assert "no valve travels so far" in beyond_op(100.0 * cycle, 120.0)


def test_no_verdict_names_a_band_that_no_valve_has() -> None:
    record = replace(moved(400), sp=None)
    counts = replace(record, op=60.0 * (record.op - 40.0))
    how = {"plant": "fopdt", "valve": "stenman"}
    for found in (wb.detect(counts), wb.estimate(counts, **how)):
        assert found.verdict == "undecided"
        assert "no valve travels so far: give OP's range" in " ".join(found.reasons)
    fraction = wb.estimate(replace(record, op=record.op * 1e-3), **how)
    assert fraction.verdict == "undecided"
    assert "give its range if it is in another unit, such as a fraction of 1" in fraction.reasons[0]
