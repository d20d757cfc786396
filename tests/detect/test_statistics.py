"""The published statistics on signals whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from workbench.detect.action import gain_sign
from workbench.detect.bicoherence import bicoherence_of, ellipse_of
from workbench.detect.correlation import LAGS, VALUES, cross_correlation, histogram_fit
from workbench.detect.direct import stem_evidence
from workbench.detect.load import DETECTIONS, load_index
from workbench.detect.oscillation import oscillation_of
from workbench.detect.shape import movement_index, triangle_index
from workbench.kpi.oscillation import autocorrelation, zero_crossings
from workbench.model.record import Record
from workbench.model.valve import Choudhury
from workbench.simulate.run import valve_response

N, PERIOD = 2000, 80.0
K = np.arange(N)
ANGLE = 2.0 * math.pi * K / PERIOD
SINE, COSINE = np.sin(ANGLE), np.cos(ANGLE)
TRIANGLE = 2.0 / math.pi * np.arcsin(SINE)
NOISE = np.random.default_rng(1).normal(size=N)


def test_a_sinusoid_has_index_one_and_noise_none() -> None:
    clean, noisy, none = (oscillation_of(s, 2.0) for s in (SINE, SINE + NOISE * math.sqrt(0.5), NOISE))
    assert clean.index > 0.98
    assert clean.period == pytest.approx(2.0 * PERIOD, rel=0.01)
    assert clean.regularity > 5.0
    assert clean.cycles == pytest.approx(N / PERIOD, rel=0.01)
    assert noisy.index == pytest.approx(0.5, abs=0.1)
    assert noisy.period == pytest.approx(2.0 * PERIOD, rel=0.05)
    assert none.index < 0.1
    assert math.isnan(oscillation_of(np.linspace(0.0, 1.0, 100), 1.0).period)


def test_load_disturbances_of_a_cycle_are_counted_and_those_of_noise_are_not() -> None:
    assert load_index(SINE, 1.0, PERIOD) >= DETECTIONS
    assert load_index(0.01 * SINE, 1.0, PERIOD, amplitude=0.02) == 0.0
    assert load_index(NOISE, 1.0, PERIOD) < DETECTIONS
    assert load_index(SINE, 1.0, math.nan) == 0.0


def test_cross_correlation_tells_odd_from_even() -> None:
    odd, even = cross_correlation(COSINE, SINE, PERIOD), cross_correlation(-SINE, SINE, PERIOD)
    assert min(odd) > 2.0 / 3.0
    assert max(even) < 1.0 / 3.0
    assert all(math.isnan(v) for v in cross_correlation(SINE, COSINE, math.nan))


def test_histogram_of_the_second_derivative_tells_lines_from_a_sinusoid() -> None:
    assert histogram_fit(TRIANGLE + 0.02 * NOISE, PERIOD) > 0.2
    assert histogram_fit(SINE + 0.002 * NOISE, PERIOD) < -0.2
    assert math.isnan(histogram_fit(SINE, 5.0))


def test_triangles_and_sinusoids_are_told_apart() -> None:
    assert triangle_index(TRIANGLE) > 0.9
    assert triangle_index(SINE) < 0.1
    assert math.isnan(triangle_index(np.array([1.0, -1.0] * 20)))


def test_moves_that_pv_does_not_answer() -> None:
    square = np.sign(COSINE + 1e-9)
    stuck, followed = movement_index(square, TRIANGLE, 4), movement_index(SINE, SINE, 4)
    assert stuck[0] > 0.8
    assert stuck[1] > 0.6
    assert followed == (0.0, 0.0)
    assert all(math.isnan(v) for v in movement_index(np.zeros(50), np.zeros(50), 1))


def test_bicoherence_sees_a_square_law_and_not_gaussian_noise() -> None:
    rng = np.random.default_rng(3)
    driven = np.convolve(rng.normal(size=8200), np.ones(6), "same")[:8192]
    plain, squared = bicoherence_of(driven), bicoherence_of(driven + 0.3 * driven**2)
    assert plain is not None
    assert squared is not None
    assert plain.values.shape == plain.frequency_1.shape == plain.frequency_2.shape
    assert squared.ngi > 5.0 * max(plain.ngi, 0.01)
    assert squared.nli > plain.nli
    assert bicoherence_of(driven[:100]) is None


def test_the_ellipse_of_a_known_phase_has_the_width_of_its_dead_band() -> None:
    ellipse = ellipse_of(3.0 * COSINE, 2.0 * SINE, PERIOD)
    assert ellipse is not None
    assert ellipse.apparent_stiction == pytest.approx(4.0, rel=0.02)
    closed = ellipse_of(3.0 * SINE, 2.0 * SINE, PERIOD)
    assert closed is not None
    assert closed.apparent_stiction < 0.1
    assert ellipse_of(SINE, SINE, math.nan) is None


def test_a_recorded_stem_follows_or_sticks() -> None:
    op = 50.0 + 5.0 * SINE
    stuck = stem_evidence(op, valve_response(Choudhury(4.0, 2.0), op, float(op[0])))
    follows = stem_evidence(op, op + 0.01 * NOISE)
    assert stuck is not None
    assert follows is not None
    assert follows.follows < 0.001
    assert stuck.follows > 0.01
    assert stuck.sticks < 0.2 * stuck.follows
    assert stuck.band == pytest.approx(4.0, rel=0.2)
    assert stem_evidence(np.full(10, 3.0), op[:10]) is None


def test_the_sign_of_the_gain_follows_the_controller_and_is_open_where_its_terms_disagree() -> None:
    error = np.convolve(np.random.default_rng(5).normal(size=500), np.ones(5) / 5.0, "same")
    record = Record(-error, 0.5 * error + 0.1 * np.cumsum(error), 1.0, sp=np.zeros(500))
    reverse = Record(error, record.op, 1.0, sp=np.zeros(500))
    torn = Record(-error, -0.5 * error + 0.3 * np.cumsum(error), 1.0, sp=np.zeros(500))
    assert gain_sign(record) == 1.0
    assert gain_sign(reverse) == -1.0
    assert gain_sign(torn) == 0.0


@pytest.mark.parametrize("degrees", [20.0, 30.0, 45.0, 60.0, 80.0])
def test_cross_correlation_of_sinusoids_out_of_phase_lies_at_the_published_limits(degrees: float) -> None:
    phase = math.radians(degrees)
    lags, values = cross_correlation(np.sin(ANGLE - phase), SINE, PERIOD)
    assert lags == pytest.approx(degrees / 90.0, abs=0.02)
    assert values == pytest.approx((1.0 - math.cos(phase)) / (1.0 + math.cos(phase)), abs=0.02)
    # The limits of both asymmetries stand for the same phases: 30 and 60 degrees.
    for value, (none, some) in ((lags, LAGS), (values, VALUES)):
        assert (value < none, value > some) == (degrees < 30.0, degrees > 60.0) or degrees in (30.0, 60.0)


def test_triangles_count_by_the_stretch_and_not_by_the_sample() -> None:
    # Slow half periods of lines and fast ones of a sinusoid: by mean squared errors they weigh alike.
    slow = 1.0 - np.abs(np.linspace(-1.0, 1.0, 400))
    fast = np.sin(np.linspace(0.0, math.pi, 42))
    signal = np.concatenate([[-0.5], slow[1:-1], -slow[1:-1], fast[1:-1], -fast[1:-1], [0.5]])
    # 1/3 - (8/pi^2)^2/2 of a triangle is no sine, 1/2 - 3 (4/pi^2)^2 of a sine no triangle; by the sample: 0.87.
    assert triangle_index(signal) == pytest.approx(0.4, abs=0.1)


def test_zero_crossings_are_those_of_the_cosine_that_a_sinusoid_has() -> None:
    lags, before = zero_crossings(autocorrelation(SINE))
    assert lags == pytest.approx(PERIOD * (0.25 + 0.5 * np.arange(11)), abs=0.2)
    assert np.all((lags > before) & (lags <= before + 1))
