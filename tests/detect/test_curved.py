"""Large setpoint moves: a plant's curve is no stiction, and stiction shows beside what they make of PV."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.detect import stem
from workbench.detect.evidence import statistics_of
from workbench.detect.predictor import FreePredictor
from workbench.detect.verdict import Thresholds, accuses, beyond_doubt
from workbench.model.record import FloatArray

N = 600


def drift(rng: np.random.Generator, size: float) -> FloatArray:
    """A slow load of a standard deviation, % of OP."""
    slow = np.convolve(rng.normal(size=N + 300), np.exp(-np.arange(300) / 60.0), "valid")[:N]
    return size * slow / float(slow.std())


def curved_valve(seed: int, curve: float, noise: float = 0.004, late: int = 0) -> tuple[wb.Record, FloatArray]:
    """A healthy loop under two setpoint moves, what passes its valve OP plus `curve` times its square; and that.

    late: samples by which it comes later.
    """
    rng = np.random.default_rng(seed)
    gain, pole, Kc, Ti = 0.43, math.exp(-1.0 / 2.9), 3.6, 2.0
    load = drift(rng, 5.0 * noise)
    sp = -0.55 * (np.arange(N) >= 306) + 0.89 * (np.arange(N) >= 357)
    pv, op, flow = noise * rng.normal(size=N), np.zeros(N), np.zeros(N)
    lag = integral = 0.0
    for k in range(N):
        pv[k] += lag
        error = sp[k] - pv[k]
        integral += Kc / Ti * error
        op[k] = integral + Kc * error
        flow[k] = op[k] + curve * op[k] ** 2
        through = flow[k - late] if k >= late else 0.0
        lag = pole * lag + (1.0 - pole) * gain * (through + load[k])
    return wb.Record(pv + 50.0, op + 40.0, 1.0, sp=sp + 50.0), flow


def moved(valve: object, seed: int) -> wb.Record:
    """A loop under setpoint moves that make nearly all of PV."""
    loop = wb.Loop(wb.FOPDT(0.31, 4.55, 1.86), valve, wb.PID(Kc=1.9, Ti=6.9), 1.0)
    moves = [wb.Step(0.2, 300.0), wb.Step(-0.65, 500.0), wb.Step(0.5, 700.0), wb.Step(-0.3, 900.0)]
    run = wb.simulate(loop, wb.Experiment(1200.0, moves, noise=wb.Noise(0.01, seed)))
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


def predictor(record: wb.Record, curved: bool = False) -> FreePredictor:
    y, u = record.pv - record.pv.mean(), record.op - record.op.mean()
    return FreePredictor(y, u, np.zeros(N, dtype=bool), 0.0, 10, curved)


@pytest.mark.parametrize("curve", [-0.1, 0.1])
@pytest.mark.parametrize("seed", range(2))
def test_a_curved_valve_under_setpoint_moves_is_not_accused(seed: int, curve: float) -> None:
    found = wb.detect(curved_valve(seed, curve)[0])
    test = found.test
    assert test is not None
    assert test.unexplained < Thresholds().left
    assert test.squares > 200.0
    assert found.verdict != "stiction"
    # A stem takes up most of what the curve makes: without squares it would pass for stiction.
    assert test.likelihood > 20.0
    assert test.adds < 10.0


@pytest.mark.parametrize("seed", [1, 2])
def test_nor_where_it_is_tuned_close_to_its_limit_and_a_stem_predicts_by_itself(seed: int) -> None:
    found = wb.detect(curved_valve(seed, -0.14, 0.008, late=1)[0])
    assert found.test is not None
    assert found.test.unexplained > Thresholds().left
    # Nor do stems so wide do as well in the simulated PV.
    assert not accuses(replace(found.test, squares=0.0))
    assert accuses(replace(found.test, squares=0.0, wide=0.0))
    assert found.verdict == "undecided"
    assert "squares of PV and OP foretell PV as well" in found.reasons[0]


def test_the_curve_is_told_as_the_reason() -> None:
    found = wb.detect(curved_valve(1, 0.1)[0])
    assert found.verdict == "undecided"
    assert "squares of PV and OP foretell PV as well" in found.reasons[0]
    assert "about one operating point" in found.reasons[0]
    assert found.test is not None
    straight = replace(found, test=replace(found.test, squares=5.0, unexplained=0.14))
    much = replace(found, test=replace(found.test, squares=0.0, unexplained=0.16))
    beside = replace(found, test=replace(found.test, adds=11.0))
    says = []
    for one in (found, beside, straight, much):
        (row,) = (row for row in statistics_of(one, bicoherence=False) if row.name == "Stem test, a curved plant")
        says.append(row.says)
    assert says == [
        "a curve of the plant does as well as a stem",
        "a stem tells more than a curve of the plant",
        "no curve shows",
        "not asked: the linear loop leaves much",
    ]


def test_squares_know_what_a_curved_valve_passes_and_lines_do_not() -> None:
    record, flow = curved_valve(3, 0.1)
    assert predictor(record).adds(flow, 0) > 300.0
    assert predictor(record, curved=True).adds(flow, 0) < 20.0
    # Of a linear loop eighteen coefficients tell what chance has it: chi^2 with as many degrees of freedom.
    straight, _ = curved_valve(3, 0.0)
    gain = predictor(straight, curved=True).ahead_of(predictor(straight))
    assert -10.0 < gain < 45.0


@pytest.mark.parametrize("valve", [wb.Deadband(0.5), wb.Stenman(0.2), wb.Choudhury(0.5, 0.25)])
def test_stiction_shows_beside_moves_that_make_nearly_all_of_pv(valve: object) -> None:
    found = wb.detect(moved(valve, 1))
    assert found.test is not None
    assert found.test.unexplained < Thresholds().left
    assert found.verdict == "stiction"
    assert accuses(found.test)


def test_moves_alone_make_no_stiction() -> None:
    assert [wb.detect(moved(wb.Ideal(), seed)).verdict for seed in range(2)] == ["no_stiction"] * 2


def test_no_stem_is_beyond_doubt_where_a_curve_does_as_well() -> None:
    found = wb.detect(moved(wb.Stenman(0.3), 0)).test
    assert found is not None
    strong = replace(
        found,
        predicting=500.0,
        loaded=500.0,
        waved=500.0,
        improvement=0.6,
        simulated=0.6,
        unexplained=0.1,
        samples=1000,
    )
    assert beyond_doubt(replace(strong, squares=39.9, adds=9.9))
    assert not beyond_doubt(replace(strong, squares=40.1, adds=9.9))
    assert not accuses(replace(strong, squares=40.1, adds=9.9))


def test_of_a_long_record_the_clearest_curve_but_one_counts(monkeypatch) -> None:
    """Chance adds up: what squares gain in three stretches of a straight loop may be more than one shows by chance."""
    found = wb.detect(moved(wb.Stenman(0.3), 0)).test
    assert found is not None
    stretches = iter([replace(found, squares=one) for one in (20.0, 60.0, 30.0)])
    monkeypatch.setattr(stem, "_stretch", lambda *_: next(stretches))
    pv = np.random.default_rng(0).normal(size=9000)
    assert stem.stem_test(pv, -pv, None, 1.0, math.nan, 1.0).squares == 30.0
