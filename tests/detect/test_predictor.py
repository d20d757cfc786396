"""The free linear predictor: what a stem adds to the past of PV and OP."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.detect.predictor import FreePredictor
from workbench.model.record import FloatArray


def loop_run(valve: object, seed: int, n: int = 1500) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return PV, OP and stem of a loop with a slow load, less their means."""
    drift = np.cumsum(np.random.default_rng(seed).normal(size=n)) * 0.03
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 2.0), valve, wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(float(n), load=wb.Series(drift), noise=wb.Noise(0.1, seed)))
    return run.pv - run.pv.mean(), run.op - run.op.mean(), run.valve


def predictor(y: FloatArray, u: FloatArray, floor: float = 0.0) -> FreePredictor:
    return FreePredictor(y, u, np.zeros(y.size, dtype=bool), floor, 10)


@pytest.mark.parametrize("valve", [wb.Stenman(2.0), wb.Choudhury(3.0, 1.0)])
def test_the_true_stem_adds_what_a_false_one_does_not(valve: object) -> None:
    y, u, stem = loop_run(valve, 3)
    free = predictor(y, u)
    assert free.adds(stem, 2) > 100.0
    assert free.adds(np.roll(stem, 400), 2) < 25.0


def test_in_a_linear_loop_what_a_stem_adds_is_chance() -> None:
    # Three coefficients: chi^2 with three degrees of freedom has the mean 3 and exceeds 11.3 once in 100.
    gains = []
    for seed in range(40):
        y, u, _ = loop_run(wb.Ideal(), seed)
        sticky = wb.simulate(
            wb.Loop(wb.FOPDT(1.0, 1.0, 1.0), wb.Stenman(1.0), wb.PID(Kc=1.0, Ti=9.0), 1.0),
            wb.Experiment(1500.0, noise=wb.Noise(0.3, 1000 + seed)),
        )
        gains.append(predictor(y, u).adds(sticky.valve, 2))
    assert 1.5 < np.mean(gains) < 5.0
    assert max(gains) < 20.0


@pytest.mark.parametrize("curved", [False, True])
def test_op_before_the_past_is_known_where_the_loop_has_a_dead_time_as_long(curved: bool) -> None:
    rng = np.random.default_rng(0)
    u = np.convolve(rng.normal(size=1560), np.ones(8))[:1560]
    y = np.convolve(np.concatenate([np.zeros(70), u])[:1560], 0.8 ** np.arange(40))[:1560] + rng.normal(size=1560)
    y, u = y[60:] - y[60:].mean(), u[60:] - u[60:].mean()
    still = np.zeros(y.size, dtype=bool)
    unknown, known = (FreePredictor(y, u, still, 0.0, 90, curved, delay) for delay in (0, 73))
    late = np.roll(u, 1) + rng.normal(size=1500)
    # Without it whatever resembles OP tells what OP did then.
    assert unknown.adds(late, 69) > 100.0
    assert known.adds(late, 69) < 20.0
    assert known.instead(late) < 0.0


def test_a_stem_that_follows_op_is_known_already() -> None:
    y, u, _ = loop_run(wb.Ideal(), 0)
    free = predictor(y, u)
    assert free.adds(2.0 * u + 5.0, 2) == 0.0
    assert free.adds(np.ones(y.size), 2) == 0.0


def test_a_short_record_says_nothing_and_missing_samples_shorten_the_past() -> None:
    y, u, stem = loop_run(wb.Stenman(2.0), 1)
    assert predictor(y[:24], u[:24]).adds(stem[:24], 2) == 0.0
    held = np.zeros(y.size, dtype=bool)
    held[np.arange(0, y.size - 5, 25)[:, None] + np.arange(5)] = True
    gappy = FreePredictor(y, u, held, 0.0, 4)
    assert gappy.enough
    assert gappy.left.size > 100
    assert gappy.adds(stem, 2) > 50.0


def test_no_record_is_good_for_less_than_its_floor() -> None:
    y, u, stem = loop_run(wb.Stenman(2.0), 2)
    assert predictor(y, u, floor=100.0 * float(y.var())).adds(stem, 2) < 1.0


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(30, 400),
    scale=st.floats(1e-6, 1e6),
    steps=st.integers(1, 50),
    delay=st.integers(0, 10),
)
def test_what_a_stem_adds_is_finite_positive_and_free_of_units(
    seed: int, n: int, scale: float, steps: int, delay: int
) -> None:
    rng = np.random.default_rng(seed)
    y, u = np.cumsum(rng.normal(size=n)), np.cumsum(rng.normal(size=n))
    path = np.round(u / steps) * steps
    plain, scaled = predictor(y, u).adds(path, delay), predictor(scale * y, u / scale).adds(scale * path, delay)
    assert plain >= 0.0
    assert np.isfinite(plain)
    assert scaled == pytest.approx(plain, rel=1e-3, abs=1e-3)
