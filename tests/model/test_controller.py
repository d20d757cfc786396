"""Controller forms and units: exact equivalents by frequency response, and refusals where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from loops import numbers

import workbench as wb
from workbench.model.units import gain_from, integral_time_from

S = 1j * np.logspace(-4, 2, 60)


def response_to_error(pid: wb.PID) -> np.ndarray:
    """The transfer function from error to OP, each form by its own definition."""
    n = pid.derivative_filter
    if pid.form == "series":
        return pid.Kc * (1 + 1 / (pid.Ti * S)) * (1 + pid.Td * S / (pid.Td / n * S + 1))
    if pid.form == "parallel":
        return pid.Kc + 1 / (pid.Ti * S) + pid.Td * S / (pid.Td / pid.Kc / n * S + 1)
    return pid.Kc * (1 + 1 / (pid.Ti * S) + pid.Td * S / (pid.Td / n * S + 1))


pids = st.builds(
    wb.PID,
    Kc=numbers(0.1, 5.0),
    Ti=numbers(1.0, 300.0),
    Td=st.one_of(st.just(0.0), numbers(0.01, 50.0)),
    form=st.sampled_from(["ideal", "series", "parallel"]),
    derivative_on=st.sampled_from(["error", "pv"]),
    derivative_filter=st.sampled_from([math.inf, 20.0, 8.0]),
)


@given(pid=pids, form=st.sampled_from(["ideal", "series", "parallel"]))
def test_equivalent_forms_have_one_frequency_response(pid, form):
    try:
        other = pid.to_form(form)
    except wb.InvalidValue:
        assume(False)
    assert other.form == form
    np.testing.assert_allclose(response_to_error(other), response_to_error(pid), rtol=1e-7)
    back = other.to_form(pid.form)
    if pid.form != "series":
        np.testing.assert_allclose([back.Kc, back.Ti, back.Td], [pid.Kc, pid.Ti, pid.Td], rtol=1e-6, atol=1e-9)


@given(pid=pids)
def test_equivalent_forms_simulate_alike_on_setpoint_and_load(pid):
    experiment = wb.Experiment(60.0, setpoint=wb.Step(1.0), load=wb.Step(0.5, at=30.0))
    plant = wb.FOPDT(0.2, 30.0, 1.0)
    for form in ("ideal", "series", "parallel"):
        try:
            other = pid.to_form(form)
        except wb.InvalidValue:
            continue
        a = wb.simulate(wb.Loop(plant, wb.Ideal(), pid, 1.0), experiment)
        b = wb.simulate(wb.Loop(plant, wb.Ideal(), other, 1.0), experiment)
        assume(np.abs(a.op).max() < 1e4)
        np.testing.assert_allclose(a.op, b.op, rtol=1e-6, atol=1e-6 * np.abs(a.op).max())


def test_series_to_ideal_by_the_published_formulae():
    series = wb.PID(Kc=2.0, Ti=10.0, Td=2.0, form="series", derivative_filter=10.0, derivative_on="pv")
    ideal = series.to_form("ideal")
    assert ideal.Kc == pytest.approx(2.0 * 1.2)
    assert ideal.Ti == pytest.approx(12.0)
    assert ideal.Td == pytest.approx(2.0 * (10.0 - 0.2) / 12.0)
    assert ideal.Td / ideal.derivative_filter == pytest.approx(0.2)
    assert ideal.setpoint_weight == pytest.approx(10.0 / 12.0)


def test_ideal_to_series_needs_four_times_td():
    edge = wb.PID(1.0, 8.0, 2.0, derivative_filter=math.inf).to_form("series")
    assert (edge.Ti, edge.Td) == (4.0, 4.0)
    with pytest.raises(wb.InvalidValue, match="Ti >= 4 Td"):
        wb.PID(1.0, 7.9, 2.0, derivative_filter=math.inf).to_form("series")


@pytest.mark.parametrize(("Ti", "Td"), [(1e160, 1e300), (1e160, 1.0), (1e300, 1e300)])
def test_times_beyond_all_use_have_no_series_form(Ti, Td):
    with pytest.raises(wb.InvalidValue, match="a series equivalent "):
        wb.PID(0.5, Ti, Td).to_form("series")
    with pytest.raises(wb.InvalidValue, match="a series equivalent "):
        wb.PID(0.5, 10.0, 1.0, form="series").with_ideal(0.5, Ti, Td)


def test_parallel_settings_whose_ideal_time_no_number_holds_are_refused():
    with pytest.raises(wb.InvalidValue, match=r"PID\.Ti: 1e-300 given; the ideal equivalent's Ti"):
        wb.PID(1e-30, 1e-300, form="parallel").ideal_terms()


def test_parallel_gains_are_independent():
    parallel = wb.PID(2.0, 10.0, 3.0).to_form("parallel")
    assert (parallel.Kc, parallel.Ti, parallel.Td) == (2.0, 5.0, 6.0)
    with pytest.raises(wb.InvalidValue, match="Kc > 0"):
        wb.PID(0.0, 10.0).to_form("parallel")
    with pytest.raises(wb.InvalidValue, match="no ideal equivalent"):
        wb.PID(0.0, 10.0, form="parallel").ideal_terms()


def test_a_series_derivative_filtered_too_hard_has_no_ideal_form():
    with pytest.raises(wb.InvalidValue, match="Ti > Tf"):
        wb.PID(1.0, 1.0, 20.0, form="series", derivative_filter=10.0).to_form("ideal")


def test_a_weight_that_series_cannot_have_is_refused():
    with pytest.raises(wb.InvalidValue, match="weight"):
        wb.PID(1.0, 20.0, 4.0, setpoint_weight=0.0).to_form("series")


def test_structures_have_plain_names():
    assert wb.PID(1.0, 5.0).structure == "PID on error"
    assert wb.PID(1.0, 5.0, derivative_on="pv").structure == "PI on error, D on PV"
    assert wb.PID(1.0, 5.0, derivative_on="pv", setpoint_weight=0.0).structure == "I on error, PD on PV"
    assert wb.PID(1.0, 5.0, setpoint_weight=0.5).structure is None


def test_gain_units():
    assert gain_from(2.0, "%/EU") == 2.0
    assert gain_from(2.0, "%/%", (0.0, 400.0)) == 0.5
    assert gain_from(50.0, "PB %", (0.0, 400.0)) == 0.5
    with pytest.raises(wb.InvalidValue, match="PV range"):
        gain_from(50.0, "PB %")
    with pytest.raises(wb.InvalidValue, match="> 0"):
        gain_from(0.0, "PB %", (0.0, 100.0))
    with pytest.raises(wb.InvalidValue, match="gain unit"):
        gain_from(1.0, "dB")


def test_integral_units():
    assert integral_time_from(2.0, "min") == 120.0
    assert integral_time_from(3.0, "repeats/min") == 20.0
    assert integral_time_from(0.0, "repeats/min") == math.inf
    assert integral_time_from(math.inf, "s") == math.inf
    with pytest.raises(wb.InvalidValue, match="> 0"):
        integral_time_from(0.0, "min")
    with pytest.raises(wb.InvalidValue, match="integral unit"):
        integral_time_from(1.0, "hours")


@given(
    st.floats(0.01, 10.0),
    st.floats(0.5, 500.0),
    st.floats(0.0, 0.22),
    st.sampled_from(["ideal", "series", "parallel"]),
    st.sampled_from([8.0, 10.0, math.inf]),
)
def test_ideal_settings_come_back_from_every_form(Kc: float, Ti: float, share: float, form: str, n: float) -> None:
    there = wb.PID(1.0, 10.0, form=form, derivative_filter=n, derivative_on="pv").with_ideal(Kc, Ti, share * Ti)
    terms = there.ideal_terms()
    assert (terms.Kc, terms.Ti, terms.Td) == pytest.approx((Kc, Ti, share * Ti), rel=1e-9, abs=1e-9)
    assert (there.form, there.derivative_filter, there.derivative_on) == (form, n, "pv")


def test_ideal_settings_without_an_equivalent_are_refused() -> None:
    unfiltered = wb.PID(1.0, 10.0, form="series", derivative_filter=math.inf)
    edge = unfiltered.with_ideal(2.0, 8.0, 2.0)
    assert (edge.Kc, edge.Ti, edge.Td) == (1.0, 4.0, 4.0)
    with pytest.raises(wb.InvalidValue, match="needs Ti >= 4 Td"):
        unfiltered.with_ideal(2.0, 8.0, 2.01)
    with pytest.raises(wb.InvalidValue, match=r"PID\.Kc"):
        wb.PID(1.0, 10.0, form="parallel").with_ideal(0.0, 8.0)
