"""The tuning rules: published formulas worked out by hand, exact forms, and where a rule does not apply."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import numbers, paper_loop
from scipy import optimize

import workbench as wb
from workbench.analyze.describing_function import meeting_gain
from workbench.analyze.frequency import linear_stable, loop_response
from workbench.model.rule import Rule
from workbench.tune.rules import ultimate_point

LAG = wb.FOPDT(gain=2.0, time_constant=10.0, dead_time=2.0)
LEVEL = wb.Integrating(gain=0.05, dead_time=2.0)


def loop_of(plant: wb.FOPDT | wb.Integrating, valve: object = None, **controller: object) -> wb.Loop:
    return wb.Loop(plant, valve or wb.Stenman(2.0), wb.PID(1.0, 10.0, **controller), 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("plant", "rule", "Kc", "Ti", "Td"),
    [
        (LAG, wb.Simc(), 1.25, 10.0, 0.0),  # 10/(2 x 4); 4 (2 + 2) is longer than tau
        (LAG, wb.Simc(tau_c=0.25), 10.0 / 4.5, 9.0, 0.0),
        (LEVEL, wb.Simc(), 5.0, 16.0, 0.0),  # 1/(0.05 x 4)
        (LAG, wb.Lambda(), 10.0 / 64.0, 10.0, 0.0),
        (LAG, wb.Lambda(8.0, "s"), 0.5, 10.0, 0.0),
        (LEVEL, wb.Lambda(10.0, "s"), 22.0 / 7.2, 22.0, 0.0),
        (LAG, wb.Amigo(), 0.6027777778, 7.765217391, 0.0),  # [0.15 + (0.35 - 20/144) 5]/2; 0.7 + 2600/368
        (LAG, wb.Amigo("PID"), 1.225, 17.6 / 3.0, 10.0 / 10.6),
        (LEVEL, wb.Amigo(), 3.5, 26.8, 0.0),
        (LEVEL, wb.Amigo("PID"), 4.5, 16.0, 1.0),
        (LAG, wb.ZieglerNichols(), 2.25, 2.0 / 0.3, 0.0),  # a = 2 x 2/10
        (LAG, wb.ZieglerNichols("step", "PID"), 3.0, 4.0, 1.0),
        (LEVEL, wb.ZieglerNichols(), 9.0, 2.0 / 0.3, 0.0),
    ],
)
def test_published_formulas(plant: wb.FOPDT, rule: Rule, Kc: float, Ti: float, Td: float) -> None:
    found = wb.apply_rule(loop_of(plant), rule)
    assert (found.Kc, found.Ti, found.Td) == pytest.approx((Kc, Ti, Td), rel=1e-9)


def test_the_papers_loop() -> None:
    """SIMC and lambda tunings of the loop of the paper's Table II, as they are usually quoted."""
    loop = paper_loop(0.5, 20.0)
    simc = wb.apply_rule(loop, wb.Simc())
    assert (simc.Kc, simc.Ti) == (2.5, 5.0)
    assert wb.apply_rule(loop, wb.Lambda(1.0)).Kc == pytest.approx(5.0 / 6.0)
    assert wb.apply_rule(loop, wb.Lambda(3.0)).Kc == 0.3125
    detuned = wb.apply_rule(loop, wb.DetunedIntegral())
    assert detuned == replace(loop.controller, Ti=200.0), "Case 2 from Case 1"


def test_the_ultimate_point_by_hand() -> None:
    """First order without dead time: z = -1. Integrator with one sample of dead time: z^2 - z + k = 0 at k = 1."""
    a = math.exp(-1.0 / 10.0)
    assert ultimate_point(loop_of(wb.FOPDT(2.0, 10.0))) == pytest.approx(((1 + a) / (2 * (1 - a)), 2.0))
    loop = loop_of(wb.Integrating(0.05, 1.0))
    assert ultimate_point(loop) == pytest.approx((20.0, 6.0))
    PI = wb.apply_rule(loop, wb.ZieglerNichols("ultimate"))
    assert (PI.Kc, PI.Ti) == pytest.approx((9.0, 5.0))
    PID = wb.apply_rule(loop, wb.ZieglerNichols("ultimate", "PID"))
    assert (PID.Kc, PID.Ti, PID.Td) == pytest.approx((12.0, 3.0, 0.75))


@settings(deadline=None, max_examples=60)
@given(
    st.one_of(
        st.builds(wb.FOPDT, gain=numbers(0.1, 3.0), time_constant=numbers(0.3, 200.0), dead_time=numbers(0.0, 30.0)),
        st.builds(wb.Integrating, gain=numbers(0.001, 1.0), dead_time=numbers(0.0, 30.0)),
    )
)
def test_proportional_control_loses_its_stability_at_the_ultimate_gain(plant: wb.FOPDT | wb.Integrating) -> None:
    loop = loop_of(plant)
    Ku, _ = ultimate_point(loop)
    assert linear_stable(loop.with_controller(wb.PID(Ku * (1.0 - 1e-6), math.inf)))
    assert not linear_stable(loop.with_controller(wb.PID(Ku * (1.0 + 1e-6), math.inf)))


def test_the_ultimate_point_of_a_long_dead_time_is_that_of_a_short_one_and_found_as_soon() -> None:
    """Far slower than its lag a plant is its gain and delay: Ku = 1/K, Pu twice the delay, hold included."""
    tracemalloc.start()
    Ku, Pu = ultimate_point(loop_of(wb.FOPDT(2.0, 1e-3, 20_000.0)))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (Ku, Pu) == pytest.approx((0.5, 40_002.0), rel=1e-9)
    assert most < 1e6, "bytes: a grid that grew with the dead time held four million points"


@pytest.mark.parametrize("form", ["ideal", "series", "parallel"])
@pytest.mark.parametrize("filtering", [10.0, math.inf])
def test_a_rule_is_converted_exactly_and_keeps_the_rest(form: str, filtering: float) -> None:
    loop = loop_of(LAG, form=form, derivative_filter=filtering, derivative_on="pv", output_limits=(-5.0, 5.0))
    found = wb.apply_rule(loop, wb.Amigo("PID"))
    terms = found.ideal_terms()
    assert (terms.Kc, terms.Ti, terms.Td) == pytest.approx((1.225, 17.6 / 3.0, 10.0 / 10.6), rel=1e-12)
    assert replace(found, Kc=1.0, Ti=10.0, Td=0.0) == loop.controller


def test_settings_are_rounded_to_the_digits_to_type_in() -> None:
    found = wb.apply_rule(loop_of(LAG, form="parallel"), wb.Amigo("PID"), digits=2)
    assert (found.Kc, found.Ti, found.Td) == (1.2, 4.8, 1.2)  # 1.225, Ti/Kc = 4.789.., Kc Td = 1.1557
    with pytest.raises(wb.InvalidValue, match="digits"):
        wb.apply_rule(loop_of(LAG), wb.Simc(), digits=0)


def test_a_direct_acting_controller_for_a_plant_of_negative_gain() -> None:
    plant = replace(LAG, gain=-2.0)
    found = wb.apply_rule(loop_of(plant, action="direct"), wb.Simc())
    assert (found.Kc, found.action) == (1.25, "direct")
    with pytest.raises(wb.InvalidValue, match=r"rule simc: reverse action .* needs action direct"):
        wb.apply_rule(loop_of(plant), wb.Simc())


@pytest.mark.parametrize(
    ("loop", "rule", "words"),
    [
        (loop_of(wb.FOPDT(1.0, 5.0)), wb.Simc(), "dead time above 0 s, or tau_c"),
        (loop_of(wb.FOPDT(1.0, 5.0)), wb.Amigo(), "dead time above 0 s"),
        (loop_of(wb.FOPDT(1.0, 5.0)), wb.ZieglerNichols(), 'or method "ultimate"'),
        (loop_of(LEVEL), wb.Lambda(), "give lambda in s"),
        (loop_of(LEVEL), wb.NoCrossing(), "always cross"),
        (loop_of(LAG, wb.Ideal()), wb.NoCrossing(), "no locus"),
        (loop_of(LAG, form="series"), wb.ZieglerNichols("step", "PID"), "Ti >= 4.4 Td"),
        (
            wb.Loop(LAG, wb.Stenman(2.0), wb.PID(1.0, math.inf), 1.0),
            wb.DetunedIntegral(),
            "no integral time to detune",
        ),
    ],
)
def test_where_a_rule_does_not_apply(loop: wb.Loop, rule: Rule, words: str) -> None:
    with pytest.raises(wb.InvalidValue) as caught:
        wb.apply_rule(loop, rule)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "make",
    [
        lambda: wb.Simc(0.0),
        lambda: wb.Lambda(3.0, "min"),
        lambda: wb.Amigo("P"),
        lambda: wb.ZieglerNichols("relay"),
        lambda: wb.DetunedIntegral(1.0),
        lambda: wb.NoCrossing(gain_margin=1.0),
    ],
)
def test_impossible_options_are_refused(make: object) -> None:
    with pytest.raises(wb.InvalidValue):
        make()  # type: ignore[operator]


# --- no crossing -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plant", "rule"),
    [(wb.FOPDT(1e-100, 5.0, 1e-320), wb.Simc()), (wb.FOPDT(1.0, 1e300, 1.0), wb.Amigo())],
    ids=["vanishes", "overflows"],
)
def test_a_plant_beyond_all_use_is_refused_in_a_line(plant: wb.FOPDT, rule: Rule) -> None:
    with pytest.raises(wb.InvalidValue, match="its numbers are too large or too small for the rule's settings"):
        wb.apply_rule(loop_of(plant), rule)


def test_no_factor_that_a_number_holds_makes_next_to_no_gain_meet_the_loci() -> None:
    loop = loop_of(LEVEL)
    assert math.isinf(meeting_gain(loop.with_controller(wb.PID(1e-320, 10.0))))


def test_the_loci_first_meet_where_the_phase_is_minus_90_degrees() -> None:
    """S = J: `|L| = pi S/(4 J)` at -90 degrees, found here from the phase alone."""
    plant, Ti = wb.FOPDT(1.0, 5.0, 1.0), 12.0
    w = optimize.brentq(lambda w: math.atan(Ti * w) - math.atan(5.0 * w) - w, 0.05, 1.5)
    unit = wb.Loop(plant, wb.Choudhury(2.0, 2.0), wb.PID(1.0, Ti), 1.0)
    size = abs(loop_response(unit, np.array([w]))[0][0])
    assert meeting_gain(unit) == pytest.approx(math.pi / 4.0 / size, rel=2e-3)


@pytest.mark.parametrize(
    "valve", [wb.Stenman(2.0), wb.Choudhury(2.0, 2.0), wb.Choudhury(2.0, 1.6), wb.Choudhury(1.0, 2.0), wb.Deadband(2.0)]
)
def test_the_meeting_gain_is_where_the_describing_function_begins_to_predict(valve: wb.Stenman) -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), valve, wb.PID(1.0, 12.0), 1.0)
    Kc = meeting_gain(loop)

    def predicted(factor: float) -> bool:
        return wb.describing_function(loop.with_controller(wb.PID(Kc * factor, 12.0))).predicts_cycle

    assert not predicted(0.998)
    assert predicted(1.002)


def test_the_loci_cross_at_every_gain_where_the_integral_is_fast() -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(1.0, 4.0), 1.0)
    assert meeting_gain(loop) < 0.01
    assert wb.describing_function(loop.with_controller(wb.PID(0.05, 4.0))).predicts_cycle


@pytest.mark.slow
@settings(deadline=None, max_examples=20)
@given(
    st.builds(wb.FOPDT, gain=numbers(-3.0, -0.1), time_constant=numbers(1.0, 100.0), dead_time=numbers(0.0, 20.0)),
    st.one_of(
        st.builds(wb.Stenman, d=numbers(0.1, 5.0)),
        st.builds(wb.Choudhury, S=numbers(0.1, 5.0), J=numbers(0.0, 5.0)),
        st.builds(wb.Deadband, b=numbers(0.1, 5.0)),
    ),
    st.sampled_from([wb.NoCrossing(), wb.NoCrossing(1.1, 1.2), wb.NoCrossing(10.0, 3.0)]),
)
def test_no_cycle_is_predicted_for_the_rules_tuning(plant: wb.FOPDT, valve: wb.Stenman, rule: wb.NoCrossing) -> None:
    loop = loop_of(plant, valve, action="direct", form="series")
    tuned = loop.with_controller(wb.apply_rule(loop, rule))
    assert tuned.controller.Ti == pytest.approx(rule.integral_ratio * (plant.time_constant + plant.dead_time))
    df = wb.describing_function(tuned)
    assert not df.predicts_cycle
    assert df.linear_stable


def test_the_rule_does_not_stop_the_cycle_that_the_describing_function_cannot_see() -> None:
    loop = paper_loop(0.5, 20.0)
    tuned = loop.with_controller(wb.apply_rule(loop, wb.NoCrossing(), digits=4))
    assert not wb.describing_function(tuned).predicts_cycle
    assert wb.limit_cycle(tuned, wb.Experiment(600.0, wb.Step(4.0))).outcome == "cycles"


@pytest.mark.parametrize("rule", [None, "simc", wb.Simc, LAG])
def test_what_is_no_rule_is_said(rule: object) -> None:
    with pytest.raises(wb.InvalidValue, match=r"rule: .*must be one of Simc, Lambda, Amigo, .*NoCrossing"):
        wb.apply_rule(loop_of(LAG), rule)  # type: ignore[arg-type]
