"""A cascade's first screen: what to set in both controllers as the site writes them, how sure, what to watch."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from cascades import flow_and_temperature

import workbench as wb
from workbench.model.numbers import figure, given, setting
from workbench.model.results import Tuned
from workbench.model.study import CascadeResult, Study
from workbench.report.cascade import cascade_tables
from workbench.report.cascade_settings import cascade_site_table
from workbench.report.compared import read_all
from workbench.report.page import write_report
from workbench.report.results import results_json
from workbench.report.summary import Summary, summarise
from workbench.scenario.loader import read_scenario

TEXT = """\
title: Cascade
cascade:
  primary:
    plant: {type: fopdt, gain: 1.2, time_constant: 60 s, dead_time: 10 s}
    controller: {Kc: 3, Ti: 80 s}
    sample_time: 5 s
    pv_range: [0, 200]
  secondary:
    plant: {type: fopdt, gain: 1.0, time_constant: 3 s, dead_time: 1 s}
    valve: {type: stenman, d: 1 %}
    controller: {Kc: 0.5, Ti: 5 s}
    sample_time: 1 s
    pv_range: [0, 50]
experiment: {duration: 600 s, setpoint: {step: 5, at: 0 s}, noise: {sd: 0.01, seed: 0}}
objective: {mean_square_error: 1, valve_travel: 0.001}
cases:
  - {name: As found}
  - {name: Slow, primary: {Kc: 0.8, Ti: 100 s}}
  - {name: Tighter, primary: {Kc: 2.7, Ti: 70 s}, secondary: {Kc: 0.7777777, Ti: 3.3 s}}
  - {name: Steep, primary: {Kc: 1.5, Ti: 70 s, Td: 20 s}}
site: {form: series, gain: proportional_band, integral: repeats_per_minute}
"""


@pytest.fixture(scope="module")
def study() -> Study:
    return wb.run_scenario(read_scenario(TEXT, Path("cascade.yaml")))


def told(study: Study, *cases: CascadeResult, **changes: object) -> Summary:
    every = {c.name: typed for c, typed in zip(study.cascade, study.cascade_site_cases, strict=True)}
    typed = tuple(every[case.name] for case in cases)
    return summarise(replace(study, cascade=cases, cascade_site_cases=typed, **changes))  # type: ignore[arg-type]


def test_what_is_typed_in_at_the_site_is_simulated(study: Study) -> None:
    site, typed = study.cascade_site, study.cascade_site_cases[2]
    assert site is not None
    assert site.primary.units == site.secondary.units == ("%", "repeats/min", "s")
    assert typed.primary is not None
    assert typed.secondary is not None
    # 100 % of the primary's output are the 50 EU of the secondary's range.
    assert typed.primary.gain == pytest.approx(100.0 / (2.7 * 200.0 / 50.0), rel=1e-3)
    assert typed.secondary.gain == pytest.approx(100.0 / (0.7777777 * 50.0 / 100.0), rel=1e-3)
    assert typed.primary.controller.Kc == pytest.approx(2.7, rel=1e-3)
    cascade = study.cascade[2].run.cascade.with_controllers(typed.primary.controller, typed.secondary.controller)
    run = wb.simulate(cascade, study.experiment)
    assert typed.kpis == (run.primary.kpis, run.secondary.kpis)
    weighed = run.primary.kpis.mean_square_error + 0.001 * run.secondary.kpis.valve_travel
    assert typed.objective == pytest.approx(weighed)
    case = study.cascade[2]
    assert typed.kpis[1].valve_travel == case.run.secondary.kpis.valve_travel, "the page is of what is typed in"
    assert case.unrounded is not None
    assert typed.kpis[1].valve_travel != case.unrounded.run.secondary.kpis.valve_travel, "other digits"


def test_both_controllers_stand_as_found_and_as_left_in_the_sites_form(study: Study) -> None:
    found, _, tighter, _ = study.cascade
    summary = told(study, found, tighter)
    typed = study.cascade_site_cases[2]
    assert typed.kpis is not None
    lead = "Set the secondary to proportional band 257.1 %, 18.18 repeats/min (series form), then the primary to "
    price = " if 3.9 times the valve travel of As found in the long run is acceptable: "
    assert summary.decision.startswith(
        f"{lead}proportional band 9.259 %, 0.8571 repeats/min (series form) (Tighter){price}"
    )
    assert (
        "against As found; otherwise keep As found. In the long run without noise: swing of the primary's PV −"
        in summary.decision
    )
    assert summary.settings is not None
    assert summary.settings.heads == ("as found", "as left: Tighter", "change")
    rows = {row.label: [cell.text for cell in row.cells] for row in summary.settings.rows}
    assert rows["Primary: proportional band"][:2] == ["8.333 %", "9.259 %"]
    assert rows["Secondary: proportional band"][:2] == ["400 %", "257.1 %"]
    assert rows["Secondary: integral rate 1/Ti"][:2] == ["12 repeats/min", "18.18 repeats/min"]
    assert rows["Primary: form"][:2] == ["series", "series"]
    assert rows["J"][1] == figure(typed.objective or 0.0)
    assert rows["Secondary: valve travel"][1] == figure(typed.kpis[1].valve_travel)
    own = found.run.secondary.kpis.valve_travel
    assert rows["Secondary: valve travel"][0] == figure(own), "as found it is what the scenario gives"
    assert rows["Primary: PV peak to peak of the late cycle"][2].startswith("−")
    assert "rounded in the site's units it gives by exact simulation J " in summary.typed[0]
    content = json.loads(results_json(study))["site"]
    assert content["primary"]["units"]["gain"] == "%"
    assert content["cases"][2]["secondary"]["gain"] == 257.1
    table = cascade_site_table(study)
    assert table is not None
    assert [cell.text for cell in table.rows[1].cells][:2] == ["31.25 %", "0.6 repeats/min"]


def test_what_the_sites_form_cannot_take_is_not_advised(study: Study) -> None:
    found, _, _, steep = study.cascade
    easy = replace(steep, objective=0.001)
    summary = told(study, found, easy)
    assert summary.decision.startswith("Keep As found (primary proportional band 8.333 %")
    assert "Steep cannot be typed in: the site's form has no equivalent of the primary's Ti = 70 s" in summary.do[0]


def test_without_a_site_the_controllers_own_form_is_shown(study: Study) -> None:
    plain = "\n".join(line for line in TEXT.splitlines() if not line.startswith(("site:", "  - {name: Steep")))
    bare = wb.run_scenario(read_scenario(f"{plain}\n", Path("cascade.yaml")))
    summary = summarise(bare)
    assert "then the primary to Kc 2.7 EU/EU, Ti 70 s" in summary.decision
    assert summary.settings is not None
    rows = {row.label: [cell.text for cell in row.cells] for row in summary.settings.rows}
    assert rows["Primary: gain Kc"][0] == "3 EU/EU"
    assert rows["Secondary: gain Kc"][0] == "0.5 %/EU"
    assert cascade_site_table(bare) is None
    assert "site" not in json.loads(results_json(bare))


@pytest.mark.parametrize(("scale", "unit"), [(2.0, "unit"), (0.5, "%")])
def test_a_primary_with_units_of_its_own_is_told_in_them_and_what_it_does_in_eu(scale: float, unit: str) -> None:
    head = TEXT.partition("cases:")[0]

    def at(scale: float) -> tuple[Study, Summary]:
        # The same two loops whatever the primary's unit.
        text = head.replace("cascade:\n", f"cascade:\n  scale: {scale}\n").replace("Kc: 3,", f"Kc: {0.5 / scale},")
        tuned = f"{{name: Tighter, primary: {{Kc: {1.0 / scale}, Ti: 80 s}}}}"
        study = wb.run_scenario(read_scenario(f"{text}cases:\n  - {{name: As found}}\n  - {tuned}\n", Path("c.yaml")))
        return study, summarise(study)

    (plain, bare), (study, summary) = at(1.0), at(scale)
    assert f"then the primary to Kc {1.0 / scale:g} {unit}/EU, Ti 80 s" in summary.decision
    kept = [line.replace("Kc 0.5 EU/EU", f"Kc {0.5 / scale:g} {unit}/EU") for line in bare.watch]
    assert list(summary.watch) == kept, "what is in EU does not hang on the unit"
    assert any("noise of 0.01 EU moves the secondary's setpoint by 0.01 EU" in line for line in summary.watch)
    for ours, theirs in zip(cascade_tables(study), cascade_tables(plain), strict=True):
        for row, other in zip(ours.rows, theirs.rows, strict=True):
            if row.label == "Primary: Kc":
                assert (row.unit, other.unit) == (f"{unit}/EU", "EU/EU")
            elif not row.label.startswith("Looked at alone"):
                assert row == other


@cache
def searched() -> Tuned:
    bounds = wb.Bounds((1.0, 2.0), (60.0, 100.0), (0.0, 0.0))
    experiment = wb.Experiment(100.0, wb.Step(2.0))
    tuned = wb.tune_cascade(flow_and_temperature(), experiment, bounds=bounds, restarts=1, digits=2).primary
    return replace(tuned, digits=4)  # as by default, which takes far longer


def search(case: CascadeResult, *, restarts: int = 2, worst: float = 1.0) -> Tuned:
    tuned = searched()
    pid = case.run.cascade.primary.controller
    one = tuned.restarts[0]
    every = tuple(replace(one, seed=k, refined=1.0) for k in range(restarts))
    return replace(tuned, controller=pid, objective=1.0, worst=worst, restarts=every, steps=())


def test_how_sure_it_is_counts_digits_searches_and_the_long_run(study: Study) -> None:
    found, _, tighter, _ = study.cascade
    given = told(study, found, tighter).sure
    assert given is not None
    assert given.level == "moderate"
    reasons = " ".join(given.reasons)
    assert "No tuning was searched for" in reasons
    assert "Long run (without noise), by exact simulation: both loops cycle; PV swings " in reasons
    cascade = tighter.run.cascade
    made = wb.model.cascade.CascadeTuned(cascade, study.experiment, search(tighter), None, 2.0)
    sure = told(study, found, replace(tighter, tuned=made)).sure
    assert sure is not None
    assert sure.level == "moderate"
    assert "Search of the primary: 2 of 2 independent searches" in " ".join(sure.reasons)
    sharp = replace(made, primary=search(tighter, restarts=1, worst=2.0))
    plain = replace(tighter, tuned=sharp, unrounded=None)
    low = summarise(replace(study, cascade=(found, plain), cascade_site=None, cascade_site_cases=())).sure
    assert low is not None
    assert (low.level, low.why) == ("low", "The primary's optimum is a knife-edge.")
    # What the site types in is other settings than the search's.
    typed = told(study, found, replace(tighter, tuned=sharp)).sure
    assert typed is not None
    assert typed.level == "moderate"
    assert "Digits: the settings as typed in have 4; within the larger of ±0.1 % and " in " ".join(typed.reasons)
    assert tighter.cycle is not None
    slow = replace(tighter, cycle=replace(tighter.cycle, period=400.0))
    short = told(study, found, slow).sure
    assert short is not None
    assert short.level == "low"
    assert "too short for the cycle" in short.why


def test_a_search_of_a_cascade_that_ended_on_a_bound_is_said(study: Study) -> None:
    found, _, tighter, _ = study.cascade
    both = tighter.run.cascade
    Kc = both.primary.controller.Kc
    narrow = replace(search(tighter), bounds=wb.Bounds((0.1, Kc), (10.0, 900.0), (0.0, 0.0)))
    wide = replace(narrow, bounds=wb.Bounds((0.1, 10.0 * Kc), (10.0, 900.0), (0.0, 0.0)))
    for cascade, unit in ((both, "EU"), (replace(both, scale=2.0), "unit")):
        made = wb.model.cascade.CascadeTuned(cascade, study.experiment, narrow, wide, 2.0)
        sentences = [one for one in told(study, found, replace(tighter, tuned=made)).found if "ended with" in one]
        ended = f"Kc on its upper bound of {Kc:g} {unit}/EU; a better tuning may lie beyond."
        assert sentences == [f"Tighter: the search of the primary ended with {ended}"]
    below = both.secondary.controller
    tight = replace(wide, controller=below, bounds=wb.Bounds((below.Kc, 9.0), (0.1, 99.0), (0.0, 0.0)))
    made = wb.model.cascade.CascadeTuned(both, study.experiment, wide, tight, 2.0)
    (sentence,) = (one for one in told(study, found, replace(tighter, tuned=made)).found if "ended with" in one)
    assert f"the search of the secondary ended with Kc on its lower bound of {setting(below.Kc)} %/EU" in sentence


def test_a_comparison_shows_the_digits_that_a_cascades_searches_found(study: Study, tmp_path: Path) -> None:
    found, _, tighter, _ = study.cascade
    made = wb.model.cascade.CascadeTuned(tighter.run.cascade, study.experiment, search(tighter), None, 2.0)
    path = tmp_path / "results.json"
    cases = (found, replace(tighter, tuned=made))
    path.write_text(results_json(replace(study, cascade=cases, cascade_site_cases=())), encoding="utf-8")
    (read,), _ = read_all([path])
    assert [(e.name, e.part, e.digits) for e in read.entries if e.digits] == [("Tighter", "primary", 4)]


def test_a_lucky_rounding_of_a_cascade_is_no_promise(study: Study) -> None:
    found, _, tighter, _ = study.cascade
    typed = study.cascade_site_cases[2]
    assert typed.beside is not None
    assert typed.beside.secondary is not None
    assert typed.objective is not None
    assert found.objective is not None
    assert typed.beside.worst >= typed.objective
    there = found.run.primary.kpis
    edge = replace(typed.beside, worst=1.2 * typed.objective, kpis=there, secondary=found.run.secondary.kpis)
    sharp = replace(typed, beside=edge)
    cases = replace(study, cascade=(found, tighter), cascade_site_cases=(study.cascade_site_cases[0], sharp))
    kept = summarise(cases)
    words = f"A knife-edge, so count on no more than what settings beside these give: J as much as {figure(edge.worst)}"
    assert f"{words} (mean square error of the primary unchanged, valve travel unchanged)." in kept.decision
    assert kept.decision.startswith("Keep As found"), "what is not to be counted on is no reason for a change"
    easy = replace(cases, cascade=(replace(found, objective=5.0), tighter))
    summary = summarise(easy)
    assert summary.decision.startswith("Set the secondary to ")
    assert words in summary.decision
    assert summary.sure is not None
    assert (summary.sure.level, summary.sure.why) == ("low", "The settings as typed in are a knife-edge.")


def test_controllers_that_are_there_already_are_not_rounded_anew() -> None:
    text = TEXT.replace("{Kc: 0.5, Ti: 5 s}", "{Kc: 0.51234, Ti: 5 s}")
    text = "\n".join(line for line in text.splitlines() if not line.startswith(("  - {name: T", "  - {name: Steep")))
    plan = read_scenario(f"{text}\nanalyze: {{limit_cycle: false}}\n", Path("cascade.yaml"))
    cases = wb.run_scenario(plan).cascade
    assert [case.run.cascade.secondary.controller.Kc for case in cases] == [0.51234, 0.51234]
    assert cases[1].run.cascade.primary.controller.Kc == pytest.approx(0.8)


def test_what_to_watch_and_what_is_left_have_their_figures(study: Study) -> None:
    found, slow, tighter, _ = study.cascade
    summary = told(study, found, tighter)
    watch = " ".join(summary.watch)
    assert tighter.cycle is not None
    assert tighter.cycle.primary is not None
    assert (
        f"The cycle that remains: PV swings {figure(tighter.cycle.primary.pv_peak_to_peak)} EU in the primary" in watch
    )
    assert "put back primary proportional band 8.333 %, 0.75 repeats/min (series form); secondary proport" in watch
    assert "Secondary. Noise: the gain is 1.6 times" in watch
    assert summary.left[0].startswith("With Tighter the cycle remains (without noise): PV swings ")
    assert "Repairing the valve ends that in both loops" in summary.left[1]
    calm = " ".join(told(study, found, replace(slow, objective=0.001)).watch)
    assert "Primary. Recovery: the integral gain Kc/Ti is 21 % of what it was" in calm
    wear = told(study, found, slow, replace(tighter, objective=0.001)).do[0]
    assert wear.startswith(
        "Where wear counts more than error: Slow (primary proportional band 31.25 %, 0.6 repeats/min"
    )
    kpis = slow.run.secondary.kpis
    assert f"valve travel {figure(kpis.valve_travel)} % instead of " in wear
    assert told(study, found, slow).watch == (), "what is kept needs no watching"
    assert told(study, found).decision.startswith("Nothing to set: As found (primary proportional band 8.333 %")


def test_what_a_cascades_run_travels_is_no_wear_unseen(study: Study) -> None:
    found, _, tighter, _ = study.cascade
    assert "late in this run" not in " ".join(told(study, found, tighter).watch)
    calm = replace(tighter, cycle=replace(tighter.cycle, travel_per_hour=0.125))
    text = next(text for text in told(study, found, calm).watch if text.startswith("Valve travel: "))
    assert " in this run of 10 min, 0.1250 % an hour in the long run without noise, " in text
    assert text.endswith(" % an hour late in this run. More than that is wear which this model does not see.")


def test_a_settling_time_of_a_primary_that_cycles_on_is_marked(study: Study) -> None:
    found = study.cascade[0]
    assert found.cycle is not None
    assert found.cycle.primary is not None
    wide = replace(found.cycle, primary=replace(found.cycle.primary, pv_peak_to_peak=5.0))
    kpis = replace(found.run.primary.kpis, settling_time=40.0)
    run = replace(found.run, primary=replace(found.run.primary, kpis=kpis))
    table = cascade_tables(replace(study, cascade=(replace(found, cycle=wide, run=run),)))[0]
    cell = next(row for row in table.rows if row.label == "Primary: settling time").cells[0]
    assert cell.small == "not for good: it cycles"


def test_what_multiplies_the_travel_is_set_on_a_condition(study: Study) -> None:
    found, _, tighter, _ = study.cascade
    assert found.cycle is not None
    calm = replace(found, cycle=replace(found.cycle, travel_per_hour=1e-3))
    decision = told(study, calm, tighter).decision
    assert " (Tighter) if " in decision
    assert " times the valve travel of As found in the long run is acceptable: in this run J " in decision
    assert "against As found; otherwise keep As found." in decision
    assert "acceptable" not in told(study, found, replace(tighter, cycle=found.cycle)).decision
    # Its noise keeps the valve of this run moving, whatever rests without.
    silent = replace(study.experiment, noise=None)
    rest = replace(found, cycle=replace(found.cycle, outcome="settles", primary=None, secondary=None))
    decision = told(study, rest, tighter, experiment=silent).decision
    rate = figure(tighter.cycle.travel_per_hour)
    assert f" if valve travel of {rate} % an hour in the long run, where As found comes to rest, is accept" in decision
    assert f"valve travel from 0 to {given(tighter.cycle.travel_per_hour)} % an hour." in decision
    assert "comes to rest" not in told(study, rest, tighter).decision


@pytest.mark.usefixtures("undrawn")
def test_the_page_holds_them(study: Study, tmp_path: Path) -> None:
    write_report(study, tmp_path)
    page = (tmp_path / "report.html").read_text()
    for words in ("Confidence: moderate", "As typed in at the site", "How sure this is", "After the change, watch"):
        assert words in page
