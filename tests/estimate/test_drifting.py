"""Noise upon a load that drifts: its likelihood, its filter, and the plant found beside it."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter

import workbench as wb
from workbench.detect.whitening import whitened
from workbench.estimate.fits.data import WHITE, Centred, centre
from workbench.estimate.fits.drift import Drift
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, fit_linear, fit_path, grounded, predict
from workbench.estimate.fits.sureness import standard_errors
from workbench.estimate.kernels.drifting import ROOM, drift_left, steady
from workbench.estimate.loads import steps, swing
from workbench.estimate.loads.drifting import Drifting, drifting_bic
from workbench.estimate.loads.own_colour import of_jump, own_colour
from workbench.estimate.loads.steps import Stem, loads_of
from workbench.estimate.loads.swing import Answered, beside_swing
from workbench.estimate.plants import ramps
from workbench.estimate.search.paths import Path
from workbench.estimate.search.two_parameter import band_stem, best_start

LAWS = [(0.8, 0.95, 3.0), (1.0, 0.99, 200.0), (0.97, 0.4, 0.0), (0.5, 0.999, 1e5), (1.0, 1e-6, 1e-3)]
VALVE = wb.Choudhury(4.0, 3.0)


def disturbance_of(pole: float, drift: float, noise: float, samples: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    load = lfilter([1.0], [1.0, -drift], rng.normal(size=samples))
    return lfilter([0.0, 1.0], [1.0, -pole], load) + math.sqrt(noise) * rng.normal(size=samples)


def record_of(plant: wb.FOPDT | wb.Integrating, samples: int, seed: int, correlation: float = 200.0) -> wb.Record:
    """A record of a sticky loop under a load that drifts by a fifth of the stick band."""
    rng = np.random.default_rng(seed)
    pole = math.exp(-1.0 / correlation)
    load = lfilter([1.0], [1.0, -pole], math.sqrt(1.0 - pole * pole) * rng.normal(size=samples))
    if isinstance(plant, wb.FOPDT):
        pid = wb.PID(0.8 * plant.time_constant / plant.gain / (plant.time_constant + plant.dead_time), 15.0)
    else:
        pid = wb.PID(0.12 / plant.gain / (2.0 + plant.dead_time), 60.0)
    loop = wb.Loop(plant, VALVE, pid, 1.0)
    sd = 0.05 * VALVE.S * (plant.gain if isinstance(plant, wb.FOPDT) else 10.0 * plant.gain)
    run = wb.simulate(
        loop, wb.Experiment(float(samples), None, wb.Series((0.2 * VALVE.S * load).tolist()), wb.Noise(sd, 100 + seed))
    )
    return wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0)


def true_stem(data: Centred, plant: tuple[float, float]) -> tuple[np.ndarray, int]:
    _, first, sense = best_start(data, (VALVE.S, VALVE.J), plant)
    return band_stem(data.u, VALVE.S, VALVE.J, first, sense)[0], max(first, 0)


@pytest.mark.parametrize(("pole", "drift", "noise"), LAWS)
def test_what_is_foretold_in_the_end_is_riccatis(pole: float, drift: float, noise: float) -> None:
    F, g1, g2 = steady(pole, drift, noise)
    A, c = np.array([[pole, 1.0], [0.0, drift]]), np.array([[1.0, 0.0]])
    if noise == 0.0:
        P = np.diag([0.0, 0.0])
        P[1, 1] = 1.0
        P = np.array([[1.0, drift], [drift, 1.0 + drift * drift]])  # z is known a sample late, when s shows it
    else:
        P = solve_discrete_are(A.T, c.T, np.diag([0.0, 1.0]), np.array([[noise]]))
    gain = A @ P @ c.T / (c @ P @ c.T + noise)
    assert pytest.approx(float((c @ P @ c.T)[0, 0]) + noise, rel=1e-6) == F
    assert (g1, g2) == pytest.approx(tuple(gain[:, 0].tolist()), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(("pole", "drift", "noise"), LAWS)
@pytest.mark.parametrize("integrating", [False, True])
def test_what_is_left_is_the_likelihood_of_the_whole_record_at_once(
    pole: float, drift: float, noise: float, integrating: bool
) -> None:
    # By a second method: the covariance of all samples, and generalised least squares.
    rng, n, tau, theta, first = np.random.default_rng(1), 60, 5.0, 2.3, 7
    y, x = disturbance_of(pole, drift, noise, n, 2), np.repeat(rng.normal(size=6), 10)
    x[:first] = 0.0
    record = wb.Record(50.0 + y, 50.0 + x, 1.0)
    data = centre(record, "integrating" if integrating else "fopdt")
    left, gain = drift_left(data.y, x, first, integrating, tau, theta, pole, drift, noise, 1, np.empty((ROOM, n)))

    k = np.arange(n)
    z = drift ** np.abs(k[:, None] - k) / (1.0 - drift * drift)
    reach = np.tril(pole ** np.maximum(k[:, None] - 1 - k, 0), -1)
    begun = 1e8 * (1.0 / (1.0 - drift * drift) + noise) * np.outer(pole**k, pole**k)
    factor = np.linalg.cholesky(reach @ z @ reach.T + begun + noise * np.eye(n) + 1e-12 * np.eye(n))
    columns = predict(data, x, first, Fit(math.nan, tau, theta, 1.0, 0.0, 0.0, 0.0))[1]
    kept = [1, 2, 3] if pole == 1.0 else [0, 1, 2, 3]
    white = np.linalg.solve(factor, np.column_stack([data.y, *columns[kept]]))[1:]
    terms, *_ = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=1e-9)
    rest = white[:, 0] - white[:, 1:] @ terms
    expected = rest @ rest / (n - 1) * math.exp(2.0 * np.log(np.diag(factor)[1:]).mean())
    assert left == pytest.approx(expected, rel=1e-3)
    assert gain == pytest.approx(terms[kept.index(1)], rel=1e-2, abs=1e-3)


def test_what_dies_out_in_a_long_record_ends_at_nought() -> None:
    # Numbers too small for all their digits took eight times as long at 20,000 samples, and twenty times at 86,400.
    n, room = 20_000, np.empty((ROOM, 20_000))
    x = np.zeros(n)
    x[100:] = 1.0
    drift_left(np.random.default_rng(1).normal(size=n), x, 100, False, 20.0, 3.3, 0.98, 0.99, 1e3, 1, room)
    small = np.abs(room[4:])
    assert not ((small > 0.0) & (small < np.finfo(float).tiny)).any()
    assert (small[2:4, -1] == 0.0).all()
    assert (small[2:4, 200] > 0.0).all()


@pytest.mark.parametrize(("pole", "drift", "noise"), LAWS)
def test_the_filter_leaves_it_white_and_takes_what_the_poles_take(pole: float, drift: float, noise: float) -> None:
    n = 40_000
    a = Drift(pole, drift, noise, tied=False).filter(n)
    assert a[0] == 1.0
    assert a.sum() == pytest.approx(0.0 if pole == 1.0 else a.sum(), abs=1e-9 * np.abs(a).sum())
    assert float(a @ pole ** -np.arange(a.size)) == pytest.approx(0.0, abs=1e-6 * np.abs(a).sum() * pole**-a.size)
    left = whitened(a, disturbance_of(pole, drift, noise, n, 3))[a.size :]
    assert np.var(left) == pytest.approx(steady(pole, drift, noise)[0], rel=0.05)
    correlations = [float(left[:-lag] @ left[lag:]) / float(left @ left) for lag in range(1, 30)]
    assert max(map(abs, correlations)) < 4.5 / math.sqrt(n)


def test_a_filter_is_no_longer_than_its_record_allows() -> None:
    law = Drift(1.0, 0.999, 1e8, tied=True)
    assert law.filter(600).size == 22
    assert law.filter(100_000).size == 402
    assert (law.terms, Drift(1.0, 0.9, 1.0, tied=False).terms) == (2, 3)


def test_a_step_of_a_law_moves_what_it_says_and_stays_in_bounds() -> None:
    law = Drift(0.7, 0.9, 10.0, tied=False)
    assert law.moved(0.0, math.log(2.0)).noise == pytest.approx(20.0)
    assert law.moved(0.0, 0.0, 0.0) == Drift(pytest.approx(0.7), pytest.approx(0.9), 10.0, tied=False)
    assert law.moved(1.0, 0.0).drift > 0.9 > law.moved(-1.0, 0.0).drift
    assert law.moved(0.0, 0.0, 1.0).pole > 0.7
    assert Drift(0.7, 0.9, 10.0, tied=True).moved(0.0, 0.0, 1.0).pole == 0.7
    for by in (-1e4, 1e4):
        far = law.moved(by, by, by)
        assert 0.0 < far.drift < 1.0
        assert 0.0 < far.pole < 1.0
        assert 0.0 < far.noise < math.inf


@pytest.mark.parametrize("plant", [wb.FOPDT(1.5, 12.0, 3.0), wb.Integrating(0.05, 4.0)])
def test_plant_and_law_are_found_together_from_afar(plant: wb.FOPDT | wb.Integrating) -> None:
    n, lag = 4000, isinstance(plant, wb.FOPDT)
    data = centre(record_of(plant, n, 6), "fopdt" if lag else "integrating")
    tau = plant.time_constant if isinstance(plant, wb.FOPDT) else 1.0
    x, first = true_stem(data, (tau, plant.dead_time))
    drifting = Drifting.of(data, Limits((LEAST_TAU, float(n)), (0.0, 30.0)), 0)
    fit, law = drifting.likeliest(x, first, [(3.0 * tau, plant.dead_time + 4.0)], tied=True)
    assert fit.gain == pytest.approx(plant.gain, rel=0.05)
    assert fit.theta == pytest.approx(plant.dead_time, abs=0.5)
    assert law.pole == pytest.approx(math.exp(-1.0 / fit.tau) if lag else 1.0)
    if lag:
        assert fit.tau == pytest.approx(tau, rel=0.1)
    # The drift's own pole, exp(-1/200), and the noise's variance to its kicks, which reach PV through the plant.
    assert 60.0 < -1.0 / math.log(law.drift) < 800.0
    share = plant.gain * (1.0 - math.exp(-1.0 / tau)) if lag else plant.gain
    sd = 0.05 * VALVE.S * (plant.gain if lag else 10.0 * plant.gain)
    kicks = 0.2 * VALVE.S * math.sqrt(1.0 - math.exp(-2.0 / 200.0)) * share
    assert 0.4 < law.noise / (sd / kicks) ** 2 < 2.5
    # In the measure of its filter the plant is the same.
    there = data.whitened(law.filter(n), 0, law)
    again = fit_path(there, x, first, (-math.inf, math.inf), drifting.limits, fit.theta, tau=fit.tau)
    assert again.gain == pytest.approx(fit.gain, rel=0.02)
    assert there.terms == 2
    own = own_colour(there, drifting.limits)
    assert own.left(Stem(x, first, fit)) == pytest.approx(own.fit(x, first, fit).sse, rel=1e-3)
    errors = standard_errors(there, x, first, grounded(there, x, first, again), clamped=False)
    assert abs(again.gain - plant.gain) < 3.0 * errors[0] < 0.2 * plant.gain


@pytest.mark.parametrize(("plant", "seed"), [(wb.FOPDT(1.5, 12.0, 3.0), 3), (wb.Integrating(0.05, 4.0), 4)])
def test_a_load_that_drifts_is_told_as_no_steps_and_no_oscillation(
    plant: wb.FOPDT | wb.Integrating, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Beside the true stem a wander of few turns passes for either, where autoregressions alone are weighed against it.
    n, lag = 1000, isinstance(plant, wb.FOPDT)
    data = centre(record_of(plant, n, seed), "fopdt" if lag else "integrating")
    near, limits = (12.0 if lag else 1.0, plant.dead_time), Limits((LEAST_TAU, float(n)), (0.0, 30.0))
    x, first = true_stem(data, near)
    free = (-math.inf, math.inf)
    fit = fit_path(data, x, first, free, limits, near[1], tau=near[0])
    lead = Stem(x, first, fit, valve=(VALVE.S, VALVE.J, *best_start(data, (VALVE.S, VALVE.J), near)[1:]))
    model = SimpleNamespace(residual_variance=math.inf)
    answered = Answered(model, [Path(VALVE, x, first, free, fit, 20)], data, ())

    def told() -> tuple[int, bool]:
        swings: list[Centred] = []
        beside_swing(data, answered, lambda calm: swings.append(calm) or answered, 30.0)
        return len(loads_of(data, lead, limits, 0, 2, strict=False).steps), bool(swings)

    assert told() == (0, False)
    for module in (steps, swing):
        monkeypatch.setattr(module, "drifting_bic", lambda *_: math.inf)
    assert told() == ((2, False) if lag else (1, True))


@pytest.mark.parametrize("plant", [wb.FOPDT(1.5, 12.0, 3.0), wb.Integrating(0.05, 4.0)])
def test_what_a_stem_leaves_tells_a_level_from_a_lag_under_a_slow_load(plant: wb.FOPDT | wb.Integrating) -> None:
    n, lag = 800, isinstance(plant, wb.FOPDT)
    limits = Limits((LEAST_TAU, float(n)), (0.0, 30.0))
    for seed in range(3):
        record = record_of(plant, n, seed, correlation=400.0)
        own, data = (centre(record, one) for one in ("fopdt" if lag else "integrating", "fopdt"))
        x, first = true_stem(own, (12.0 if lag else 1.0, plant.dead_time))
        # As it is met with: the plant that a lag would have along it, its disturbance taken for white.
        fit = fit_path(data, x, first, (-math.inf, math.inf), limits, plant.dead_time, tau=12.0 if lag else 400.0)
        linear = fit_linear(data, 40.0)
        assert ramps(data, linear, [(x, first, fit)], limits) != lag
        # A stem that moves PV no more than OP does tells nothing; nor is there much to tell where noise alone is left.
        assert not ramps(data, linear, [(data.u, 0, linear)], limits)
        noise = np.random.default_rng(seed).normal(size=n)
        white = replace(data, y=predict(data, x, first, fit)[0] + 0.1 * noise)
        assert not ramps(white, linear, [(x, first, fit)], limits)


def test_no_drift_is_seen_where_less_is_left_than_the_record_resolves_or_it_is_too_long() -> None:
    n = 500
    x = np.repeat(np.random.default_rng(3).normal(size=10), 50)
    x[:50] = 0.0
    loop = wb.Loop(wb.Integrating(0.05, 4.0), wb.Ideal(), wb.PID(1.0, 60.0), 1.0)
    pv = wb.simulate(loop, wb.Experiment(float(n), wb.Step(1.0))).pv
    data, limits = centre(wb.Record(pv + 50.0, x + 50.0, 1.0), "integrating"), Limits((LEAST_TAU, 500.0), (0.0, 30.0))
    left = drifting_bic(data, x, 50, [(1.0, 4.0)], limits, 0)
    assert math.isfinite(left)
    assert drifting_bic(replace(data, floor=10.0), x, 50, [(1.0, 4.0)], limits, 0) == math.inf
    long = centre(wb.Record(np.tile(pv, 61), np.tile(x, 61), 1.0), "integrating")
    assert drifting_bic(long, np.tile(x, 61), 50, [(1.0, 4.0)], limits, 0) == math.inf


def test_a_simulated_level_begins_without_a_leap_that_no_stem_in_sight_makes() -> None:
    # What wanders slowly left the first samples to a stem 70 % off in OP: a leap of 20 EU within the dead time.
    gain, theta = 0.05, 4.0
    record = record_of(wb.Integrating(gain, theta), 2000, 2, correlation=400.0)
    data = centre(record, "integrating").whitened(WHITE, 6)
    x, first = true_stem(data, (LEAST_TAU, theta))
    x, first = np.where(np.arange(x.size) < first, x[first], x), 0
    plant = Fit(math.nan, LEAST_TAU, theta, gain, math.nan, math.nan, math.nan)
    fit = grounded(data, x, first, plant)
    assert data.u.min() - 1e-9 <= fit.start / gain <= data.u.max() + 1e-9
    begins = predict(data, x, first, fit)[0][: round(theta) + 2]
    assert np.ptp(begins) <= 1.2 * gain * (theta + 1.0) * np.ptp(data.u)
    # Its level and its slope are those of least squares, that start given.
    left = data.y - predict(data, x, first, fit)[0]
    assert abs(left.mean()) < 1e-6 * np.abs(left).max()
    # A range that is given is kept to instead.
    assert 0.1 - 1e-9 <= grounded(data, x, first, plant, (0.1, 0.2)).start / gain <= 0.2 + 1e-9


def test_a_stem_of_another_jump_begins_where_it_suits_it() -> None:
    # From where the leading stem begins one of another jump may never slip again, and ranges missed the true gain.
    n = 3000
    data = centre(record_of(wb.FOPDT(1.5, 12.0, 3.0), n, 6), "fopdt")
    limits = Limits((LEAST_TAU, float(n)), (0.0, 30.0))
    x, first = true_stem(data, (12.0, 3.0))
    fit, law = Drifting.of(data, limits, 0).likeliest(x, first, [(12.0, 3.0)], tied=True)
    own = own_colour(data.whitened(law.filter(n), 0, law), limits)
    _, begun, sense = best_start(data, (VALVE.S, VALVE.J), (12.0, 3.0))
    lead = Stem(x, first, fit, valve=(VALVE.S, VALVE.J, begun, sense))
    for share in (0.8, 1.2):
        other = of_jump(own, lead, share * VALVE.J, lead)
        assert other.valve is not None
        assert other.valve[1] == share * VALVE.J
        late = max(other.first, first)
        assert np.corrcoef(other.x[late:], x[late:])[0, 1] > 0.97
        assert other.fit.gain * other.valve[1] == pytest.approx(fit.gain * VALVE.J, rel=0.15)


@pytest.mark.slow
def test_a_level_under_a_slow_load_is_known_by_its_gain() -> None:
    # Gains came out at half or twice, and longer levels as lags, while a load that is summed up was an autoregression.
    plant = wb.Integrating(0.05, 4.0)
    found = wb.estimate(record_of(plant, 2000, 2, correlation=400.0))
    assert found.verdict == "stiction"
    assert isinstance(found.plant, wb.Integrating)
    assert found.plant.gain == pytest.approx(plant.gain, rel=0.05)
    assert found.valve.stick_band == pytest.approx(VALVE.S, rel=0.02)
    low, high = found.intervals.gain or (math.nan, math.nan)
    assert low <= plant.gain <= high
    # Without a search for lags, which cost as much again.
    assert "along this stem an integrating process has the lower BIC" in found.reasons[-1]
