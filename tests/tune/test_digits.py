"""Rounding to the digits to type in: what reading the decimal text gives, for whole arrays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from workbench.tune.problem import round_to


@given(st.lists(st.floats(1e-30, 1e30), min_size=1, max_size=20), st.integers(1, 12))
@example([9.9995, 9.99949999, 99.995, 0.99995, 1e-300, 5e-324, 0.0, 2.5, 0.35, 1e22, 1e23], 4)
@example([2.5, 3.5, 0.25, 1250.0, 12.5, 0.125], 2)
def test_rounding_is_that_of_the_decimal_text(values, digits):
    given_values = np.array(values)
    expected = [float(f"{value:.{digits - 1}e}") for value in values]
    np.testing.assert_array_equal(round_to(given_values, digits, 0.0, np.inf), expected)
    np.testing.assert_array_equal(round_to(-given_values, digits, -np.inf, 0.0), -np.array(expected))


def test_each_column_keeps_its_own_range():
    values = np.array([[0.99996, 5.00004], [0.30004, 599.99]])
    found = round_to(values, 4, np.array([0.3, 5.0]), np.array([0.99997, 599.95]))
    # 1.0 lies above the range and 600 too: the next numbers inside.
    np.testing.assert_array_equal(found, [[0.9999, 5.0], [0.3, 599.9]])


@pytest.mark.parametrize(("value", "low", "high"), [(0.12344, 0.12343, 0.12346), (7.0, 7.0, 7.0)])
def test_a_range_without_a_number_of_so_few_digits_gives_its_nearer_end(value, low, high):
    assert round_to(np.array([value]), 3, low, high)[0] in (low, high)
