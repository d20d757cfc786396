"""Settings in a site's own form and units: exact equivalents, rounded digits, and refusals where there is none."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from loops import numbers

import workbench as wb
from workbench.model.site import SiteForm
from workbench.model.units import gain_from, gain_to, integral_time_from, integral_time_to

RANGE = (0.0, 400.0)
forms = st.builds(
    SiteForm,
    form=st.sampled_from(["ideal", "series"]),
    gain=st.sampled_from(["%/EU", "%/%", "PB %"]),
    integral=st.sampled_from(["s", "min", "repeats/min", "repeats/s"]),
    derivative=st.sampled_from(["s", "min"]),
    pv_range=st.just(RANGE),
) | st.builds(
    SiteForm,
    form=st.just("parallel"),
    gain=st.sampled_from(["%/EU", "%/%"]),
    integral=st.sampled_from(["s", "min"]),
    derivative=st.sampled_from(["s", "min"]),
    pv_range=st.just(RANGE),
)
controllers = st.builds(
    wb.PID, Kc=numbers(0.05, 5.0), Ti=numbers(5.0, 600.0), Td=st.just(0.0) | numbers(0.1, 20.0), form=st.just("ideal")
)


@given(site=forms, pid=controllers, digits=st.sampled_from([4, 6]))
def test_what_is_typed_in_acts_as_the_controller_to_its_digits(site, pid, digits):
    try:
        exact, typed = site.settings(pid), site.settings(pid, digits)
    except wb.InvalidValue:
        assume(False)
    was = pid.ideal_terms()
    for settings, rel in ((exact, 1e-9), (typed, 20.0 * 10.0**-digits)):
        now = settings.controller.ideal_terms()
        assert settings.controller.form == site.form
        assert (now.Kc, now.Ti) == pytest.approx((was.Kc, was.Ti), rel=rel)
        assert now.Td == pytest.approx(was.Td, rel=rel, abs=1e-12)
    for value in (typed.gain, typed.integral, typed.derivative):
        assert value == float(f"{value:.{digits - 1}e}"), "no more digits than are typed in"
    again = site.settings(typed.controller, digits)
    assert (again.gain, again.integral, again.derivative) == (typed.gain, typed.integral, typed.derivative)


def test_a_proportional_band_is_the_per_cent_of_its_range_that_moves_op_over_all_of_its_own():
    site = SiteForm("ideal", "PB %", "repeats/min", "min", (0.0, 70.0))
    settings = site.settings(wb.PID(2.384, 9.092, 3.0), 4)
    assert (settings.gain, settings.integral, settings.derivative) == (59.92, 6.599, 0.05)
    # PV by PB % of 70 EU times Kc: 100 % of OP.
    assert 0.5992 * 70.0 * settings.controller.Kc == pytest.approx(100.0)
    assert settings.controller.Ti == pytest.approx(60.0 / 6.599)
    assert site.units == ("%", "repeats/min", "min")
    assert site.settings(wb.PID(0.0, 9.0)).gain == math.inf


def test_a_parallel_controller_has_three_gains():
    site = SiteForm("parallel", "%/%", "min", "min", (0.0, 200.0))
    settings = site.settings(wb.PID(2.0, 10.0, 3.0), 4)
    assert (settings.gain, settings.integral, settings.derivative) == (4.0, 24.0, 0.2)
    assert (settings.controller.Kc, settings.controller.Ti, settings.controller.Td) == pytest.approx((2.0, 5.0, 6.0))
    assert site.units == ("%/%", "%/(% min)", "% min/%")
    none = site.settings(wb.PID(2.0, math.inf), 4)
    assert (none.integral, none.controller.Ti) == (0.0, math.inf)


def test_what_has_no_equivalent_is_refused():
    with pytest.raises(wb.InvalidValue, match="Ti >= 4 Td"):
        SiteForm("series").settings(wb.PID(1.0, 7.0, 2.0))


@given(
    pid=st.builds(
        wb.PID,
        Kc=numbers(0.05, 5.0),
        Ti=numbers(1.0, 600.0),
        Td=st.just(0.0) | numbers(0.1, 600.0),
        form=st.sampled_from(["ideal", "series", "parallel"]),
        derivative_on=st.sampled_from(["error", "pv"]),
        derivative_filter=st.just(math.inf) | numbers(0.5, 20.0),
        setpoint_weight=numbers(0.0, 1.0),
    ),
    form=st.sampled_from(["ideal", "series", "parallel"]),
)
def test_the_nearest_keeps_gain_and_integral_time_and_gives_up_as_little_as_it_must(pid, form):
    near = pid.nearest_form(form)
    assert near.form == form
    was, now = pid.ideal_terms(), near.ideal_terms()
    assert (now.Kc, now.Ti) == pytest.approx((was.Kc, was.Ti), rel=1e-6)
    assert min(was.Td, 0.0) - 1e-9 <= now.Td <= max(was.Td, 0.0) * (1 + 1e-6) + 1e-9
    try:
        exact = pid.to_form(form)
    except wb.InvalidValue:
        if form == "series" and now.Td < was.Td * (1 - 1e-6):
            n = was.Td / was.Tf if was.Tf > 0.0 else math.inf
            with pytest.raises(wb.InvalidValue, match="needs"):
                wb.PID(now.Kc, now.Ti, now.Td * 1.0001, derivative_filter=n).to_form("series")
    else:
        assert near == exact


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"gain": "PB %"}, "needs a PV range"),
        ({"gain": "%/%"}, "needs a PV range"),
        ({"form": "parallel", "gain": "PB %", "pv_range": RANGE}, "no common band"),
        ({"form": "parallel", "integral": "repeats/min"}, "must be s or min"),
        ({"form": "Foxboro"}, "SiteForm.form"),
        ({"integral": "h"}, "SiteForm.integral"),
        ({"derivative": "h"}, "SiteForm.derivative"),
        ({"pv_range": (5.0, 1.0)}, "SiteForm.pv_range"),
    ],
)
def test_a_form_that_no_controller_has_is_refused(arguments, text):
    with pytest.raises(wb.InvalidValue, match=text):
        SiteForm(**arguments)


@given(value=numbers(0.01, 1e3), unit=st.sampled_from(["%/EU", "%/%", "PB %"]))
def test_gains_go_out_as_they_come_in(value, unit):
    assert gain_to(gain_from(value, unit, RANGE), unit, RANGE) == pytest.approx(value)


@given(value=numbers(0.01, 1e3), unit=st.sampled_from(["s", "min", "repeats/min", "repeats/s"]))
def test_integral_times_go_out_as_they_come_in(value, unit):
    assert integral_time_to(integral_time_from(value, unit), unit) == pytest.approx(value)
    assert integral_time_to(math.inf, unit) == (0.0 if unit.startswith("repeats") else math.inf)
