"""Standard errors under a coloured disturbance: no surer than the filter is, and they hold the truth."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

import workbench as wb
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import Fit, disturbance, fit_linear, predict
from workbench.estimate.fits.sureness import NORMAL, standard_errors
from workbench.estimate.loads.coloured import LAGS
from workbench.estimate.loads.settled import coloured_linear

PLANT = wb.FOPDT(1.5, 8.0, 2.0)
LONGEST = 30.0
MANY = 30  # lags, more than the disturbance needs


def coloured_data(seed: int, samples: int = 600) -> Centred:
    """A plant that follows steps of OP exactly, under a slow load (AR(1), 0.97) at its input and some noise."""
    rng = np.random.default_rng(seed)
    op = np.repeat(rng.normal(0.0, 2.0, size=samples // 60), 60)
    load = lfilter([1.0], [1.0, -0.97], rng.normal(0.0, 0.15, size=samples))
    pole = np.exp(-1.0 / PLANT.time_constant)
    input_ = np.concatenate([np.zeros(3), (op + load)[:-3]])
    pv = lfilter([PLANT.gain * (1.0 - pole)], [1.0, -pole], input_) + rng.normal(0.0, 0.05, size=samples)
    return centre(wb.Record(pv + 50.0, op + 40.0, 1.0), "fopdt")


def left_by(data: Centred, fit: Fit) -> np.ndarray:
    return data.y - predict(data, data.u, 0, fit)[0]


def yule_walker(left: np.ndarray, order: int) -> np.ndarray:
    """A filter of whatever order, by the autocorrelation."""
    centred = left - left.mean()
    r = np.array([centred[k:] @ centred[: centred.size - k] for k in range(order + 1)])
    at = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    return np.concatenate([[1.0], -np.linalg.solve(r[at], r[1:])])


def test_a_filter_that_fits_chance_makes_no_plant_surer() -> None:
    surer = 0
    for seed in range(8):
        data = coloured_data(seed)
        fit = fit_linear(data, LONGEST)
        left = left_by(data, fit)
        plain = disturbance(left, data.floor)
        assert 1 < plain.size <= LAGS + 1
        simple = standard_errors(data.whitened(plain, MANY), data.u, 0, fit, clamped=False)
        rich = standard_errors(data.whitened(yule_walker(left, MANY), 0), data.u, 0, fit, clamped=False)
        assert all(r >= s * (1.0 - 1e-9) for r, s in zip(rich, simple, strict=True))
        surer += rich[0] > simple[0]
    # Where it is the richer filter that is less sure, it stands.
    assert 0 < surer < 8


def test_the_gains_range_holds_under_a_slow_load() -> None:
    held = []
    for seed in range(40):
        data = coloured_data(100 + seed)
        settled, fit, _ = coloured_linear(data, fit_linear(data, LONGEST), LONGEST)
        error = standard_errors(settled, settled.u, 0, fit, clamped=False)[0]
        held.append(abs(fit.gain - PLANT.gain) <= NORMAL * error)
        assert error < 0.5 * PLANT.gain
    assert np.mean(held) >= 0.85
