"""The colour of a disturbance beside a stem: its kernel is least squares, and the plant beside it is the true one."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, predict
from workbench.estimate.kernels.coloured import HELD, colour_left, lagged, products_of
from workbench.estimate.loads.coloured import MOST_LAGS, colour_beside
from workbench.model.record import Record


@pytest.mark.parametrize("plant", ["fopdt", "integrating"])
@pytest.mark.parametrize(("first", "skip"), [(0, 0), (9, 5)])
@pytest.mark.parametrize("tau", [6.5, 0.8, 60.0])  # start and transient die out within the record, at once, and not
@pytest.mark.parametrize("lags", [1, 4, MOST_LAGS])
def test_what_an_autoregression_leaves_is_numpys_least_squares(
    plant: str, first: int, skip: int, tau: float, lags: int
) -> None:
    rng = np.random.default_rng(2)
    u = np.cumsum(rng.normal(size=240))
    data = centre(Record(np.cumsum(rng.normal(size=240)), u, 1.0), plant)
    gain, theta, size = 0.7, 2.3, MOST_LAGS + 1
    products = np.empty((2 * size + HELD, 2 * size + HELD))
    begin = skip + MOST_LAGS
    own = np.empty((size, size))
    lagged(data.y, data.y, begin, size, own)
    rows = products_of(data.y, own, data.u, first, data.integrating, tau, theta, begin, products)
    terms = lags + rows - 2 * size
    room = np.empty((terms + 1, terms))
    left = colour_left(products, rows, size, gain, lags, room)

    columns = predict(data, data.u, first, Fit(0.0, tau, theta, 1.0, 0.0, 0.0, 0.0))[1]
    rest = data.y - gain * columns[1]
    held = [column for column in columns[[0, 2, 3], begin:] if column.any()]
    assert rows == 2 * size + len(held)
    matrix = np.column_stack([*(rest[begin - i : 240 - i] for i in range(1, lags + 1)), *held])
    solved, *_ = np.linalg.lstsq(matrix, rest[begin:], rcond=None)
    assert left == pytest.approx(float(((rest[begin:] - matrix @ solved) ** 2).sum()), rel=1e-8)
    np.testing.assert_allclose(room[terms, :lags], solved[:lags], rtol=1e-6, atol=1e-9)


def test_the_colour_beside_the_true_stem_is_the_disturbances() -> None:
    rng = np.random.default_rng(5)
    n, x, drift = 3000, np.repeat(rng.normal(size=100), 30), np.zeros(3000)
    kicks = rng.normal(0.0, 0.1, n)
    for k in range(1, n):
        drift[k] = 0.9 * drift[k - 1] + kicks[k]
    data = centre(Record(np.convolve(np.roll(x, 4), 0.15 * 0.85 ** np.arange(60))[:n] + drift, x, 1.0), "fopdt")
    fit = Fit(0.0, 4.0, 3.0, 0.8, 0.0, 0.0, 0.0)
    a = colour_beside(data, data.u, 0, fit, Limits((LEAST_TAU, float(n)), (0.0, 30.0)), 0)
    assert a[0] == 1.0
    assert a[1] == pytest.approx(-0.9, abs=0.06)
    assert np.abs(a[2:]).max(initial=0.0) < 0.08
