"""Quantities as scenarios write them."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.errors import InvalidValue
from workbench.scenario import units


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("5 s", 5.0), ("2 min", 120.0), ("1 h", 3600.0), ("0.5 d", 43200.0), ("250ms", 0.25), (" 1e1 s ", 10.0), (0, 0.0)],
)
def test_times(text: object, seconds: float) -> None:
    assert units.time(text) == pytest.approx(seconds, rel=1e-15)


@pytest.mark.parametrize(
    "text", [5, "5", "5 sec", "s", "5 S", "5 s s", "1_0 s", "٥ s", "1e999 s", "nan s", True, None, [5]]
)
def test_what_is_no_time_is_refused_with_the_units_that_are(text: object) -> None:
    with pytest.raises(InvalidValue, match="ms, s, min, h, d"):
        units.time(text)


def test_integral_times() -> None:
    assert units.integral_time("0.5 repeats/min") == 120.0
    assert units.integral_time("0 repeats/min") == math.inf
    assert units.integral_time("none") == math.inf
    assert units.integral_time("2 min") == 120.0
    for wrong in ("-1 repeats/min", 20, "20"):
        with pytest.raises(InvalidValue):
            units.integral_time(wrong)


def test_gains_and_percentages() -> None:
    assert units.gain(0.5) == units.Quantity(0.5, "%/EU")
    assert units.gain("2 %/%") == units.Quantity(2.0, "%/%")
    assert units.proportional_band("150 %") == units.Quantity(150.0, "PB %")
    assert units.percent("2 %") == units.percent(2) == 2.0
    assert units.filter_ratio("none") == math.inf
    assert units.filter_ratio(8) == 8.0
    for read, wrong in ((units.gain, "2 %"), (units.percent, "2 s"), (units.filter_ratio, "8 s"), (units.bare, "1 %")):
        with pytest.raises(InvalidValue):
            read(wrong)


@given(st.floats(-1e9, 1e9), st.sampled_from(sorted(units.TIME_UNITS)))
def test_every_finite_number_with_a_unit_is_that_time(value: float, unit: str) -> None:
    assert units.time(f"{value!r} {unit}") == value * units.TIME_UNITS[unit]


@given(st.text(max_size=20) | st.floats() | st.integers() | st.none() | st.booleans())
def test_anything_else_is_refused_in_our_words(value: object) -> None:
    for read in (
        units.time,
        units.integral_time,
        units.percent,
        units.gain,
        units.size,
        units.filter_ratio,
        units.bare,
    ):
        # Either a value, or our own refusal.
        with contextlib.suppress(InvalidValue):
            assert read(value) is not None
