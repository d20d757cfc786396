"""PV's own turns: what is sent from outside turns PV first, what the loop's valve does follows OP's turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.detect import stem
from workbench.detect.evidence import statistics_of
from workbench.detect.predictor import ANSWERS, PAST, FreePredictor
from workbench.detect.turns import BANDS, turns_of_pv
from workbench.detect.verdict import decide
from workbench.model.detection import Detection
from workbench.model.record import FloatArray
from workbench.model.valve import Valve
from workbench.simulate.run import valve_response

N, SETTLED = 2700, 600
SHARP = wb.Loop(wb.FOPDT(1.0, 5.0, 2.0), wb.Choudhury(3.0, 2.0), wb.PID(Kc=0.4, Ti=25.0), 1.0), 0.02
ROUGH = wb.Loop(wb.FOPDT(1.0, 5.0, 2.0), wb.Stenman(3.0), wb.PID(Kc=0.5, Ti=30.0), 1.0), 0.1
BRISK = wb.Loop(wb.FOPDT(1.5, 6.0, 2.5), wb.Ideal(), wb.PID(Kc=0.5, Ti=6.0), 1.0)
QUICK = wb.Loop(wb.FOPDT(1.0, 3.0, 1.0), wb.Ideal(), wb.PID(Kc=0.6, Ti=3.0), 1.0)


def drift(rng: np.random.Generator, n: int, correlation: int) -> FloatArray:
    shape = np.exp(-np.arange(4 * correlation) / correlation)
    out: FloatArray = np.convolve(rng.normal(size=n + shape.size), shape, "valid")[:n]
    return out


def sent(root: tuple[wb.Loop, float]) -> FloatArray:
    """The unsteady cycle of a loop whose valve sticks, under a drift: its PV, of unit size."""
    loop, restless = root
    load = wb.Series(restless * drift(np.random.default_rng(5), N + SETTLED, 60))
    experiment = wb.Experiment(float(N + SETTLED), setpoint=wb.Step(2.0), load=load, noise=wb.Noise(0.05, 2))
    pv = wb.simulate(loop, experiment).pv[SETTLED:]
    return (pv - pv.mean()) / pv.std()


def driven(loop: wb.Loop, root: tuple[wb.Loop, float], size: float, noise: float, seed: int) -> wb.Record:
    """What another loop's valve makes of a loop, its own valve good or not."""
    load = wb.Series(size * sent(root) + 0.05 * drift(np.random.default_rng(seed), N, 100))
    run = wb.simulate(loop, wb.Experiment(float(N), load=load, noise=wb.Noise(noise, seed)))
    return wb.Record(run.pv, run.op, 1.0, sp=run.sp)


def without_turns(found: Detection) -> str:
    assert found.test is not None
    return decide(found.oscillation, replace(found.test, turned=0.0), None)[0]


@pytest.mark.parametrize(
    ("loop", "root", "noise", "seed"),
    [
        (BRISK, SHARP, 0.2, 3),
        (BRISK, ROUGH, 0.3, 1),
        (QUICK, ROUGH, 0.1, 1),
    ],
)
def test_a_healthy_loop_is_not_accused_of_another_loops_unsteady_cycle(
    loop: wb.Loop, root: tuple[wb.Loop, float], noise: float, seed: int
) -> None:
    found = wb.detect(driven(loop, root, 2.0, noise, seed))
    assert without_turns(found) == "stiction", "a stem betters both rivals"
    assert found.verdict == "undecided"
    assert found.test is not None
    assert "yet PV's own turns, before OP's, foretell PV better than any stem does" in found.reasons[0]
    row = next(row for row in found.statistics if row.name == "Stem test, PV's own turns")
    assert (row.value, row.says) == (found.test.turned, "they tell more: something turns PV before OP")
    rivals = next(row for row in found.statistics if row.name == "Stem test, two rivals")
    assert rivals.says == "enough, yet PV's own turns tell more: not for stiction"


@pytest.mark.parametrize(
    ("valve", "root"), [(wb.Stenman(3.0), SHARP), (wb.Choudhury(3.0, 1.0), ROUGH), (wb.Deadband(6.0), SHARP)]
)
def test_a_valve_that_sticks_is_found_under_such_a_cycle(valve: Valve, root: tuple[wb.Loop, float]) -> None:
    record = driven(replace(BRISK, valve=valve), root, 1.0, 0.15, 1)
    assert wb.detect(record).verdict == "stiction"
    # Its corners follow where OP turns: the true stem adds more than PV's own turns.
    true = valve_response(valve, record.op, 0.0, 0.0)
    free, delays = predictor(record.pv, record.op), list(range(20))
    assert max(free.adds(true, delay) for delay in delays) > turns_of_pv(free, delays)


def test_where_no_stem_is_nearly_sure_turns_are_not_asked() -> None:
    rng = np.random.default_rng(3)
    quiet = wb.detect(wb.Record(rng.normal(size=800), rng.normal(size=800), 1.0))
    assert quiet.test is not None
    assert quiet.test.turned == 0.0
    row = next(row for row in statistics_of(quiet, False) if row.name == "Stem test, PV's own turns")
    assert row.says == "not asked: two rivals say too little"


def predictor(y: FloatArray, u: FloatArray) -> FreePredictor:
    return FreePredictor(y - y.mean(), u - u.mean(), np.zeros(y.size, dtype=bool), 0.0, 20)


@pytest.mark.parametrize("late", [0, 5, 13])
def test_turns_are_found_by_their_band_and_their_delay(late: int) -> None:
    """PV that answers its own play, a dead band in the way, against the same regression written out."""
    rng = np.random.default_rng(late)
    n, band = 1500, 3.0
    u, y, play = rng.normal(size=n), np.zeros(n), np.zeros(n)
    for k in range(1, n):
        y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1] + 0.15 * play[max(k - 1 - late, 0)] + 0.1 * rng.normal()
        play[k] = min(max(play[k - 1], y[k] - band / 2.0), y[k] + band / 2.0)
    free = predictor(y, u)
    gain = turns_of_pv(free, [0, 1, 2, 3, 4, 6, 9, 13, 20])
    # By hand: least squares with and without the true play's three answers.
    first = max(PAST, 20 + ANSWERS) + 1
    past = [v[first - lag : n - lag] for v in (y, u) for lag in range(1, PAST + 1)] + [np.ones(n - first)]
    answers = [play[first - late - 1 - i : n - late - 1 - i] for i in range(ANSWERS)]

    def left(columns: list[FloatArray]) -> float:
        A = np.column_stack(columns)
        return float(np.sum((y[first:] - A @ np.linalg.lstsq(A, y[first:], rcond=None)[0]) ** 2))

    by_hand = (n - first - len(past) - ANSWERS) * np.log(left(past) / left(past + answers))
    assert by_hand > 60.0
    assert 0.6 * by_hand < gain < 1.2 * by_hand, "the grid's nearest band is not quite the true one"


def test_noise_turns_tell_no_more_than_chance() -> None:
    gains = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y, u = rng.normal(size=(2, 600))
        gains.append(turns_of_pv(predictor(y, u), [0, 1, 2, 3, 4, 6, 9]))
    # The best of 8 bands and 7 delays with three coefficients each: the 1 in 56 upper end of chi^2(3) is 10.
    assert len(BANDS) * 7 == 56
    assert 5.0 < np.median(gains) < 13.0
    assert max(gains) < 25.0


def test_what_nobody_recorded_is_no_turn_of_pv() -> None:
    """A frozen bad value far off would widen PV's range, and with it the bands, beyond any turn that it has."""
    rng = np.random.default_rng(1)
    y, u = np.cumsum(rng.normal(size=(2, 900)), axis=1) * 0.1
    held = np.zeros(900, dtype=bool)
    held[300:320] = True
    gains = []
    for bad in (0.0, 1e4):
        frozen = np.where(held, bad, y)
        gains.append(turns_of_pv(FreePredictor(frozen, u, held, 0.0, 9), [0, 1, 2, 3, 4, 6, 9]))
    assert gains[0] == pytest.approx(gains[1], rel=1e-9)


def test_of_a_long_record_the_turns_are_those_of_the_stretch_that_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    record = driven(BRISK, ROUGH, 2.0, 0.1, 1)
    one = stem._stretch(record.pv, record.op, record.sp, 1.0, 100.0, 1.0, None, 0.0)
    told = [(60.0, 40.0), (22.0, -10.0), (21.0, 30.0)]
    stretches = iter([replace(one, sure=sure, turned=turned) for sure, turned in told])
    monkeypatch.setattr(stem, "_stretch", lambda *_: next(stretches))
    pv = np.random.default_rng(0).normal(size=9000)
    test = stem.stem_test(pv, -pv, None, 1.0, np.nan, 1.0)
    assert (test.sure, test.turned) == (22.0, -10.0)
