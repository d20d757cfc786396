"""A wave from another loop is not the valve's: its corners come by the clock; and a smooth cycle is no acquittal."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.detect.oscillation import no_period, oscillation_of, period_of_wave
from workbench.detect.predictor import FreePredictor
from workbench.detect.verdict import decide
from workbench.detect.wave import steady_wave, uneven_wave
from workbench.model.detection import Detection, Oscillation
from workbench.model.record import FloatArray

N = 600


def wave(period: float, sort: str) -> FloatArray:
    phase = (np.arange(N) / period + 0.1) % 1.0
    return 5.0 * (np.where(phase < 0.5, 1.0, -1.0) if sort == "square" else 1.0 - 4.0 * np.abs(phase - 0.5))


def healthy(plant: wb.FOPDT, controller: wb.PID, load: FloatArray, noise: float = 0.1) -> wb.Record:
    run = wb.simulate(
        wb.Loop(plant, wb.Ideal(), controller, 1.0),
        wb.Experiment(float(load.size), load=wb.Series(load), noise=wb.Noise(noise, 1)),
    )
    return wb.Record(run.pv, run.op, 1.0, sp=run.sp)


def free(y: FloatArray, u: FloatArray) -> FreePredictor:
    return FreePredictor(y - y.mean(), u - u.mean(), np.zeros(y.size, dtype=bool), 0.0, 10)


def verdict_but_for_the_wave(found: Detection) -> str:
    assert found.test is not None
    return decide(found.oscillation, replace(found.test, waved=math.inf), None)[0]


@pytest.mark.parametrize(
    ("plant", "controller", "period", "sort"),
    [
        (wb.FOPDT(2.0, 20.0, 8.0), wb.PID(Kc=0.6, Ti=20.0), 63.4, "triangle"),
        (wb.FOPDT(2.0, 20.0, 8.0), wb.PID(Kc=0.6, Ti=20.0), 97.0, "triangle"),
        (wb.FOPDT(2.0, 10.0, 5.0), wb.PID(Kc=0.6, Ti=10.0), 97.0, "triangle"),
        (wb.FOPDT(2.0, 25.0, 12.0), wb.PID(Kc=0.4, Ti=25.0), 63.4, "square"),
        (wb.FOPDT(2.0, 25.0, 12.0), wb.PID(Kc=0.4, Ti=25.0), 97.0, "square"),
    ],
)
def test_a_healthy_loop_is_not_accused_of_another_loops_wave(
    plant: wb.FOPDT, controller: wb.PID, period: float, sort: str
) -> None:
    found = wb.detect(healthy(plant, controller, wave(period, sort)))
    assert verdict_but_for_the_wave(found) == "stiction", "a stem predicts PV far better than the loop without its wave"
    assert found.verdict == "undecided"
    assert "a rectangular or triangular load of steady period" in found.reasons[0]


@pytest.mark.parametrize("valve", [wb.Stenman(3.0), wb.Choudhury(3.0, 3.0), wb.Choudhury(3.0, 1.0)])
def test_a_stem_that_sticks_is_ahead_of_every_wave(valve: object) -> None:
    # The load is slow and small: the valve's own cycle is as steady as its noise lets it be.
    loop = wb.Loop(wb.Integrating(0.05, 4.0), valve, wb.PID(Kc=1.0, Ti=40.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1200.0, noise=wb.Noise(0.02, 3), load=wb.Step(1.0)))
    found = wb.detect(wb.Record(run.pv, run.op, 1.0, sp=run.sp))
    assert found.test is not None
    assert math.isfinite(found.oscillation.period)
    assert found.test.waved != found.test.predicting, "the wave was asked for"
    assert found.test.waved > 50.0
    assert found.verdict == "stiction"


@pytest.mark.parametrize("sort", ["square", "triangle"])
@pytest.mark.parametrize("about", [0.9, 1.0, 1.1])
def test_a_wave_is_found_about_its_period(sort: str, about: float) -> None:
    record = healthy(wb.FOPDT(2.0, 20.0, 8.0), wb.PID(Kc=0.6, Ti=20.0), wave(63.4, sort))
    assert steady_wave(free(record.pv, record.op), record.pv, about * 63.4) > 50.0


def uneven(period: float, first: float, sort: str, size: float, n: int = 1000) -> FloatArray:
    """A load that is up, or rises, in the first so much of each turn."""
    phase = (np.arange(n) / period) % 1.0
    if sort == "rectangle":
        return size * np.where(phase < first, 1.0, -1.0)
    return size * np.where(phase < first, 2.0 * phase / first - 1.0, 1.0 - 2.0 * (phase - first) / (1.0 - first))


@pytest.mark.parametrize(
    ("plant", "controller", "load"),
    [
        (wb.FOPDT(1.0, 3.09, 1.41), wb.PID(0.389, 4.78), uneven(41.0, 0.2, "rectangle", 2.96)),
        (wb.FOPDT(1.0, 2.76, 1.1), wb.PID(0.16, 3.0), uneven(39.0, 0.3, "rectangle", 4.8)),
        (wb.FOPDT(1.0, 3.82, 0.87), wb.PID(0.458, 4.51), uneven(38.0, 0.75, "rectangle", 3.55)),
        (wb.FOPDT(1.0, 1.04, 1.48), wb.PID(0.447, 4.41), uneven(48.0, 0.3, "triangle", 5.24)),
        (wb.FOPDT(1.0, 1.68, 1.63), wb.PID(0.29, 5.56), uneven(46.0, 0.2, "triangle", 5.44)),
    ],
)
def test_nor_of_one_whose_halves_differ(plant: wb.FOPDT, controller: wb.PID, load: FloatArray) -> None:
    record = healthy(plant, controller, load, 0.04)
    found = wb.detect(record)
    assert verdict_but_for_the_wave(found) == "stiction"
    assert found.verdict == "undecided"
    by_op = free(record.pv, record.op)
    period = period_of_wave(record.pv, 1.0, found.cycle)
    equal, (beside, instead) = steady_wave(by_op, record.pv, period), uneven_wave(by_op, record.pv, period)
    assert instead >= beside > equal + 100.0


def test_the_corners_of_an_uneven_wave_are_those_of_its_load() -> None:
    # Given its corners by hand the wave explains no more, but for its price.
    load = uneven(58.0, 0.3, "rectangle", 4.6)
    record = healthy(wb.FOPDT(1.0, 1.42, 1.29), wb.PID(0.309, 3.09), load)
    by_op = free(record.pv, record.op)
    known = max(by_op.adds_at(load, range(6)))
    assert uneven_wave(by_op, record.pv, 60.0)[0] == pytest.approx(known - 4.0 * math.log(1000.0), rel=0.05)


def test_a_cycle_of_unequal_halves_is_steady_by_whole_periods() -> None:
    pv = uneven(41.0, 0.2, "rectangle", 1.0) + 0.01 * np.random.default_rng(1).normal(size=1000)
    cycle = oscillation_of(pv, 2.0)
    assert no_period(cycle) == "PV's cycle is not regular"
    assert period_of_wave(pv, 2.0, cycle) == pytest.approx(82.0, rel=0.01)
    noise = np.random.default_rng(2).normal(size=1000)
    assert math.isnan(period_of_wave(noise, 2.0, oscillation_of(noise, 2.0)))
    ramp = np.arange(50.0)
    assert math.isnan(period_of_wave(ramp, 2.0, oscillation_of(ramp, 2.0)))


def test_where_there_is_no_wave_its_price_is_not_earned() -> None:
    gains, others = [], []
    for seed in range(10):
        drift = np.cumsum(np.random.default_rng(seed).normal(size=N)) * 0.1
        record = healthy(wb.FOPDT(2.0, 20.0, 8.0), wb.PID(Kc=0.6, Ti=20.0), drift)
        gains.append(steady_wave(free(record.pv, record.op), record.pv, 50.0))
        others.append(uneven_wave(free(record.pv, record.op), record.pv, 50.0)[0])
    assert np.median(gains) < 0.0
    assert max(gains) < 10.0
    assert np.median(others) < 0.0
    assert max(others) < 10.0
    assert uneven_wave(free(record.pv, record.op), record.pv, 3.0) == (0.0, 0.0)
    assert steady_wave(free(record.pv, record.op), record.pv, 3.0) == 0.0


def test_the_stem_must_be_ahead_of_a_wave_by_more_than_chance() -> None:
    cycle = Oscillation(0.9, 60.0, 10.0, 10.0)
    found = wb.detect(healthy(wb.FOPDT(2.0, 20.0, 8.0), wb.PID(Kc=0.6, Ti=20.0), wave(63.4, "triangle"))).test
    assert found is not None
    assert decide(cycle, replace(found, waved=9.9), None)[0] == "undecided"
    assert decide(cycle, replace(found, waved=10.1), None)[0] == "stiction"


def test_the_true_stem_takes_ops_place_and_no_other_does() -> None:
    moves = [wb.Step(float(size), 40.0 * k) for k, size in enumerate(np.random.default_rng(1).normal(size=37))]
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 2.0), wb.Choudhury(3.0, 1.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1500.0, setpoint=moves, noise=wb.Noise(0.1, 3)))
    by_op = free(run.pv, run.op)
    assert by_op.instead(run.valve) > 50.0
    assert by_op.instead(np.roll(run.valve, 400)) < -50.0
    assert by_op.instead(2.0 * run.op + 5.0) == pytest.approx(0.0, abs=1.0)
    assert by_op.instead(np.ones(1500)) == 0.0


def second_order_cycle(noise: float) -> wb.Record:
    """Return a loop whose stem sticks and jumps as far, through two lags of 15 s: PV is all but a sinusoid."""
    n, S, Kc, Ti, delay = 1400, 2.4, 1.6, 16.0, 9
    pv, op, stem = np.random.default_rng(1).normal(0.0, noise, n), np.zeros(n), np.zeros(n)
    first = second = integral = 0.0
    pole = math.exp(-1.0 / 15.0)
    for k in range(n):
        first = pole * first + (1.0 - pole) * 0.66 * ((stem[k - delay] if k >= delay else 0.0) + 1.3)
        second = pole * second + (1.0 - pole) * first
        pv[k] += second
        integral -= Kc / Ti * pv[k]
        op[k] = integral - Kc * pv[k]
        stem[k] = op[k] if abs(op[k] - stem[k - 1]) > S else stem[k - 1]
    return wb.Record(pv[200:], op[200:], 1.0, sp=np.zeros(n - 200))


def test_a_smooth_cycle_that_a_longer_lag_makes_up_for_is_not_acquitted() -> None:
    found = wb.detect(second_order_cycle(0.004))
    assert found.test is not None
    without = replace(found.test, wide=0.0, sure=0.0, adds=0.0)
    assert decide(found.oscillation, replace(without, instead=0.0), None)[0] == "no_stiction"
    assert decide(found.oscillation, without, None)[0] == "undecided"
    assert found.verdict == "undecided"


def test_a_wave_is_found_to_a_small_part_of_a_sample() -> None:
    # Under little noise its corners tell the period to a thousandth: one found by less misses most of what they make.
    load = wave(21.015, "square")
    record = healthy(wb.FOPDT(1.0, 3.4, 1.0), wb.PID(Kc=1.0, Ti=4.0), load)
    by_op = free(record.pv, record.op)
    best = max(by_op.adds(load, delay) for delay in range(4))
    assert best > 500.0
    assert steady_wave(by_op, record.pv, 21.0) > 0.8 * best
