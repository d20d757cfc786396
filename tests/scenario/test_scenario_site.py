"""`site:`: how the site writes its settings, what is refused there, and that what is typed in is what is simulated."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import pytest

import workbench as wb
from workbench.model.site import SiteForm
from workbench.scenario.loader import load_scenario
from workbench.scenario.site_cases import alike

BASE = """\
title: A site
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2 %}
  controller: {form: ideal, derivative_filter: none}
  sample_time: 1 s
  pv_range: [0, 70]
experiment: {duration: 300 s, setpoint: {step: 4, at: 0 s}}
objective: {w1: 0.5, w3: 0.5}
cases:
  - {name: As found, Kc: 0.5, Ti: 20 s}
  - {name: Sharp, Kc: 2.3844, Ti: 9.0921 s, Td: 0.5 s}
  - {name: All derivative, Kc: 0.5, Ti: 20 s, Td: 6 s}
analyze: {describing_function: false, limit_cycle: false}
site: SITE
"""


def written(folder: Path, entry: str, base: str = BASE) -> Path:
    path = folder / "site.yaml"
    path.write_text(base.replace("SITE", entry))
    return path


def test_the_entry_is_the_form(tmp_path):
    entry = "{form: series, gain: proportional_band, integral: repeats_per_minute, derivative: minutes}"
    plan = load_scenario(written(tmp_path, entry))
    assert plan.site == SiteForm("series", "PB %", "repeats/min", "min", (0.0, 70.0))
    assert load_scenario(written(tmp_path, "{form: ideal}")).site == SiteForm(pv_range=(0.0, 70.0))
    series = BASE.replace("form: ideal", "form: series")
    assert load_scenario(written(tmp_path, "{integral: repeats_per_second}", series)).site.form == "series"
    assert load_scenario(written(tmp_path, "", BASE.replace("site: SITE\n", ""))).site is None


def test_what_is_typed_in_is_simulated(tmp_path):
    entry = "{form: series, gain: proportional_band, integral: repeats_per_minute, derivative: minutes}"
    study = wb.run_scenario(written(tmp_path, entry))
    found, sharp, none, near = study.site_cases
    assert [one.name for one in study.site_cases] == [case.name for case in study.cases]
    assert (found.settings.gain, found.settings.integral, found.settings.derivative) == (285.7, 3.0, 0.0)
    for one, case in ((found, study.cases[0]), (sharp, study.cases[1])):
        loop = case.loop.with_controller(one.settings.controller)
        kpis = wb.simulate(loop, study.experiment).kpis
        assert (one.kpis.valve_travel, one.kpis.error_variance) == (kpis.valve_travel, kpis.error_variance)
        assert one.objective == wb.evaluate(loop, study.experiment, study.objective)[0]
        assert one.settings.controller.form == "series"
    assert none.settings is None
    assert "Ti >= 4 Td" in none.refused
    assert none.kpis is None
    case = study.cases[3]
    assert (near.name, case.nearest_to) == ("All derivative, nearest series", "All derivative")
    assert near.settings.controller == case.loop.controller, "it is simulated as it is typed in"
    assert case.run.kpis.valve_travel == near.kpis.valve_travel
    assert case.loop.controller.form == "series"


def test_given_settings_in_these_very_units_keep_their_digits(tmp_path):
    study = wb.run_scenario(written(tmp_path, "{form: ideal}"))
    assert study.site_cases[1].settings.controller == study.cases[1].loop.controller
    assert study.site_cases[1].kpis is study.cases[1].run.kpis
    in_minutes = wb.run_scenario(written(tmp_path, "{integral: minutes}")).site_cases[1]
    assert (in_minutes.settings.gain, in_minutes.settings.integral) == (2.384, 0.1515)


def test_a_case_is_of_what_is_typed_in_and_the_one_as_found_is_there_already(tmp_path):
    more = "  - {name: As found's, Kc: 0.5, Ti: 20 s, compensator: {type: constant_reinforcement, amplitude: 1 %}}\n"
    more += "  - {name: Curved, Kc: 0.5123456, Ti: 20.123 s, Td: 0.31234 s, setpoint_weight: 0.7}\n"
    text = BASE.replace("analyze:", f"{more}analyze:").replace("filter: none", "filter: 8")
    study = wb.run_scenario(written(tmp_path, "{form: series, gain: proportional_band, derivative: minutes}", text))
    cases = {case.name: case for case in study.cases}
    typed = {one.name: one for one in study.site_cases}
    found, sharp = cases["As found"], cases["Sharp"]
    assert (found.loop.controller.Kc, found.unrounded) == (0.5, None)
    assert typed["As found"].settings.controller.Kc != 0.5, "a proportional band of 285.7 %"
    assert (cases["As found's"].loop.controller.Kc, cases["As found's"].unrounded) == (0.5, None)
    # One and the same run for what is typed in and for the rest of the page, in the controller's own form.
    assert typed["Sharp"].kpis is sharp.run.kpis
    assert typed["Sharp"].objective == sharp.objective
    assert sharp.loop.controller.form == "ideal"
    assert sharp.loop.controller.Kc == pytest.approx(2.3844, rel=1e-3)
    assert sharp.loop.controller.Kc != 2.3844
    assert sharp.unrounded.controller.Kc == 2.3844
    own = found.loop.with_controller(sharp.unrounded.controller)
    assert sharp.unrounded.kpis.valve_travel == wb.simulate(own, study.experiment).kpis.valve_travel
    assert sharp.unrounded.objective == wb.evaluate(own, study.experiment, study.objective)[0]
    curved, terms = cases["Curved"].loop.controller, typed["Curved"].settings.controller.ideal_terms()
    assert alike(curved, typed["Curved"].settings.controller)
    assert (curved.Kc, curved.Ti, curved.Td) == pytest.approx((terms.Kc, terms.Ti, terms.Td))
    # What the form cannot take stays as it is.
    assert cases["All derivative"].loop.controller.Kc == 0.5
    assert cases["All derivative"].unrounded is None


def test_settings_beside_those_typed_in_are_looked_at(tmp_path):
    entry = "{gain: proportional_band, integral: repeats_per_minute}"
    study = wb.run_scenario(written(tmp_path, entry))
    one = study.site_cases[1]
    loop, near = study.cases[1].loop, one.beside
    assert (near.margin, near.digits) == (0.001, 4)
    assert near.worst >= one.objective
    # Within 0.1 % of band, rate and derivative lies what was found to be the worst, and the centre is no better.
    band, rate, Td = one.settings.gain, one.settings.integral, one.settings.derivative
    corners = [
        (1e4 / (70.0 * band * (1.0 + a)), 60.0 / (rate * (1.0 + b)), Td * (1.0 + c))
        for a, b, c in itertools.product((-1e-3, 1e-3), repeat=3)
    ]
    assert near.worst >= wb.evaluate(loop, study.experiment, study.objective, corners).max() * (1.0 - 1e-9)
    units = [(0.01, 0.0, 0.0), (0.0, 0.001, 0.0), (0.0, 0.0, 0.0001)]
    assert f"{band:.4g} {rate:.4g} {Td:.4g}" == "59.91 6.599 0.5"
    steps = [
        (1e4 / (70.0 * (band + s * a)), 60.0 / (rate + s * b), Td + s * c) for a, b, c in units for s in (-1.0, 1.0)
    ]
    assert near.step == pytest.approx(wb.evaluate(loop, study.experiment, study.objective, steps).max())
    assert one.knife_edge == (near.worst > 1.05 * one.objective)
    # Without an objective it is the error, and what was given in these very units has no last digit.
    plain = BASE.replace("objective: {w1: 0.5, w3: 0.5}\n", "")
    bare = wb.run_scenario(written(tmp_path, "{form: ideal}", plain)).site_cases[1]
    assert bare.beside.digits is None
    assert math.isnan(bare.beside.step)
    assert bare.objective is None
    assert bare.beside.worst == pytest.approx(bare.beside.kpis.mean_square_error)
    assert bare.beside.worst >= bare.kpis.mean_square_error


def test_the_value_of_repair_is_of_what_is_typed_in(tmp_path):
    text = BASE.replace("limit_cycle: false", "limit_cycle: false, repair: true")
    found = "  - {name: Found, tune: {bounds: {Kc: [0.4, 0.6], Ti: [15 s, 25 s]}, Td: 0 s, restarts: 1, digits: 2}}\n"
    study = wb.run_scenario(
        written(tmp_path, "{gain: proportional_band}", text.replace("analyze:", f"{found}analyze:"))
    )
    case = next(case for case in study.cases if case.name == "Found")
    assert case.loop.controller != case.tuned.controller
    assert study.repair.best.controller == case.loop.controller
    assert study.repair.best.kpis.valve_travel == case.run.kpis.valve_travel
    assert study.repair.best.objective == case.objective
    assert study.repair.tuned is case.tuned


def test_the_value_of_repair_goes_by_no_tuning_that_is_not_to_be_typed_in(tmp_path):
    text = BASE.replace("limit_cycle: false", "limit_cycle: false, repair: true").replace("300 s", "60 s")
    tune = "bounds: {Kc: [0.4, 0.6], Ti: [20 s, 20 s]}, Td: 0 s, restarts: 1"
    cases = f"  - {{name: Cliff, tune: {{{tune}, nominal: true}}}}\n  - {{name: Found, tune: {{{tune}, digits: 2}}}}\n"
    study = wb.run_scenario(written(tmp_path, "{form: ideal}", text.replace("analyze:", f"{cases}analyze:")))
    cliff, found = (next(case for case in study.cases if case.name == name) for name in ("Cliff", "Found"))
    assert cliff.tuned.objective <= found.tuned.objective
    assert study.repair.tuned is found.tuned


@pytest.mark.parametrize(
    ("entry", "base", "text"),
    [
        ("{gian: minutes}", BASE, ":15:8: site.gian: unknown key (did you mean gain?)"),
        ("{gain: PB}", BASE, ":15:14: site.gain: PB given"),
        ("{form: pid}", BASE, ":15:14: site.form: pid given"),
        ("{integral: 3 s}", BASE, ":15:18: site.integral: 3 s given"),
        ("{}", BASE, ":15:7: site: nothing given; must say how the site writes its settings: form, gain, integral, "),
        ("", BASE, ":15:1: site: nothing given; must say how"),
        ("minutes", BASE, ":15:7: site: minutes given; must be a mapping"),
        (
            "{gain: proportional_band}",
            BASE.replace("  pv_range: [0, 70]\n", ""),
            ":14:14: site.gain: proportional_band given; needs loop.pv_range: [low, high] in EU",
        ),
        (
            "{form: parallel, gain: proportional_band}",
            BASE,
            ":15:30: site.gain: proportional_band given; a parallel controller has a gain for each action",
        ),
        (
            "{form: parallel, integral: repeats_per_minute}",
            BASE,
            ":15:34: site.integral: repeats_per_minute given; the integral action of a parallel controller is a gain",
        ),
    ],
)
def test_what_is_wrong_is_said_at_its_place(tmp_path, entry, base, text):
    with pytest.raises(wb.ScenarioError) as caught:
        load_scenario(written(tmp_path, entry, base))
    assert f"site.yaml{text}" in str(caught.value)


def test_a_site_without_cases_is_refused(tmp_path):
    text = (
        "title: None\nestimate: {simulate: true}\nsite: {form: ideal}\n"
        + BASE[BASE.index("loop:") : BASE.index("cases:")]
    )
    text = text.replace("derivative_filter: none}", "Kc: 0.5, Ti: 20 s}")
    path = tmp_path / "site.yaml"
    path.write_text(text)
    with pytest.raises(wb.ScenarioError, match="site: given without cases"):
        load_scenario(path)


RANGED = (Path(__file__).parents[2] / "scenarios" / "cascade.yaml").read_text()
CASCADE = re.sub(r"    pv_range: .*\n", "", RANGED)


def in_cascade(folder, entry, text=RANGED):
    text = "\n".join(line for line in text.splitlines() if not line.startswith("site:"))
    path = folder / "cascade.yaml"
    path.write_text(f"{text}\nsite: {entry}\n")
    return load_scenario(path).cascade_site


def test_a_cascades_site_is_the_form_of_both(tmp_path):
    site = in_cascade(tmp_path, "{form: series, gain: proportional_band, integral: minutes}")
    assert site.secondary == SiteForm("series", "PB %", "min", pv_range=(0.0, 50.0))
    assert site.primary == SiteForm("series", "PB %", "min", pv_range=(0.0, 200.0), output="EU", output_span=50.0)
    # A primary that puts out % of the secondary's range: Kc = 3 EU/EU is 6 %/EU, 12 %/%, and a band of 8.333 %.
    scaled = RANGED.replace("\ncascade:\n", "\ncascade:\n  scale: 0.5\n")
    percent = in_cascade(tmp_path, "{gain: proportional_band}", scaled)
    assert (percent.primary.output, percent.primary.output_span) == ("%", 100.0)
    assert percent.primary.settings(wb.PID(6.0, 80.0), 4).gain == site.primary.settings(wb.PID(3.0, 80.0), 4).gain
    assert in_cascade(tmp_path, "{form: series}", CASCADE).primary.units == ("EU/EU", "s", "s")
    other = RANGED.replace("\ncascade:\n", "\ncascade:\n  scale: 2\n")
    assert in_cascade(tmp_path, "{form: parallel}", other).primary.units == ("unit/EU", "unit/(EU s)", "unit s/EU")


@pytest.mark.parametrize(
    ("entry", "text", "said"),
    [
        ("{}", RANGED, "site: nothing given; must say how the site writes its settings"),
        (
            "{gain: proportional_band}",
            CASCADE,
            "site.gain: proportional_band given; needs cascade.primary.pv_range and cascade.secondary.pv_range: [low,",
        ),
        ("{form: parallel, gain: proportional_band}", RANGED, "site.gain: proportional_band given; a parallel"),
        (
            "{form: ideal}",
            RANGED.replace("[0, 50]", "[50, 0]"),
            "cascade.secondary.pv_range: (50.0, 0.0) given; must be",
        ),
    ],
)
def test_what_is_wrong_of_a_cascades_site_is_said(tmp_path, entry, text, said):
    with pytest.raises(wb.ScenarioError) as caught:
        in_cascade(tmp_path, entry, text)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
