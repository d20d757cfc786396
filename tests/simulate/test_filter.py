"""The filter of first order against scipy's."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from workbench.simulate.filter import first_order

terms = st.floats(-1.0, 1.0)


@given(terms, terms, terms, terms, st.integers(0, 40), st.integers(0, 2**32 - 1))
def test_it_is_scipys(now, before, pole, start, size, seed):
    rows = np.random.default_rng(seed).normal(size=(3, size))
    for row in (rows[0], rows[1][::-1]):
        np.testing.assert_allclose(
            first_order(row, now, before, pole, start),
            lfilter([now, before], [1.0, -pole], row, zi=[start])[0] if size else row,
            rtol=1e-12,
            atol=1e-12,
        )
    np.testing.assert_array_equal(
        first_order(rows, now, before, pole), [first_order(row, now, before, pole) for row in rows]
    )
    assert first_order(rows[:0], now, before, pole).shape == (0, size)
