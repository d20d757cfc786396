"""Cases by rule, and the value of repair, from the file to the study."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import workbench as wb
from workbench.errors import ScenarioError
from workbench.model import rule as rules
from workbench.report.results import results_content, strict
from workbench.scenario import rule_entries, runner
from workbench.scenario.loader import read_scenario
from workbench.scenario.plan import Scenario
from workbench.scenario.retune import Wishes, tune_scenario
from workbench.scenario.runner import run_scenario

BASE = """\
title: Rules
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2.0}
  controller: {derivative_filter: none}
  sample_time: 1 s
experiment: {duration: 100 s, setpoint: {step: 4}}
analyze: {describing_function: false, limit_cycle: false}
cases:
  - {name: Case 1, Kc: 0.5, Ti: 20 s}
"""


def read(text: str) -> Scenario:
    return read_scenario(text, Path("loop.yaml"))


def refusal(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        read(text)
    return str(caught.value)


def entry(rule: str, more: str = "") -> str:
    return f"{BASE}  - {{name: R, rule: {rule}{more}}}\n"


@pytest.mark.parametrize(
    ("written", "rule"),
    [
        ("simc", wb.Simc()),
        ("{name: simc, tau_c: 0.1 min}", wb.Simc(6.0)),
        ("lambda", wb.Lambda()),
        ("{name: lambda, lambda: 15 s}", wb.Lambda(15.0, "s")),
        ("{name: lambda, lambda: 2 tau}", wb.Lambda(2.0, "tau")),
        ("{name: amigo, controller: PID}", wb.Amigo("PID")),
        ("ziegler_nichols", wb.ZieglerNichols()),
        ("{name: ziegler_nichols, method: ultimate, controller: PID}", wb.ZieglerNichols("ultimate", "PID")),
        ("{name: no_crossing, gain_margin: 3}", wb.NoCrossing(gain_margin=3.0)),
    ],
)
def test_a_rule_is_applied_to_the_loop_at_the_digits_to_type_in(written: str, rule: rules.Rule) -> None:
    plan = read(entry(written))
    case = plan.cases[1]
    assert case.rule == rule
    assert plan.loop is not None
    assert case.controller == wb.apply_rule(plan.loop, rule, digits=4)


def test_every_rule_of_the_model_has_its_entry() -> None:
    assert tuple(kind.name for kind in get_args(rules.Rule)) == rule_entries.NAMES
    for kind in get_args(rules.Rule):
        options = {"lambda": "lambda: 1 s"}.get(kind.name, "")
        if kind is wb.DetunedIntegral:
            options = "base: Case 1"
        case = read(entry(f"{{name: {kind.name}, {options}}}")).cases[1]
        assert type(case.rule) is kind
        # What the entry leaves out is the model's default.
        for field in fields(kind):
            if not options:
                assert getattr(case.rule, field.name) == getattr(kind(), field.name)


def test_a_case_by_rule_has_its_own_form() -> None:
    case = read(entry("{name: amigo, controller: PID}", ', form: series, structure: "PI on error, D on PV"')).cases[1]
    terms = case.controller.ideal_terms()
    assert (case.controller.form, case.controller.derivative_on) == ("series", "pv")
    assert terms.Ti == pytest.approx(4.4 / 1.5, rel=1e-3)


def test_the_integral_of_any_case_above_can_be_detuned() -> None:
    text = (
        BASE
        + """\
  - {name: SIMC, rule: simc, form: series}
  - {name: Slow, rule: {name: detuned_integral, base: SIMC, factor: 4}}
  - {name: Best, tune: {bounds: {Kc: [0.5, 0.5]}, Td: 0 s, restarts: 1, digits: 3}}
  - {name: Best slow, rule: {name: detuned_integral, base: Best}}
"""
    )
    plan = read(text)
    assert plan.cases[2].controller == wb.PID(2.5, 20.0, form="series", derivative_filter=np.inf)
    study = run_scenario(plan)
    controllers = {case.name: case.loop.controller for case in study.cases}
    assert controllers["Slow"] == plan.cases[2].controller
    assert controllers["Best slow"].Ti == pytest.approx(10.0 * controllers["Best"].Ti)
    assert controllers["Best slow"].Kc == 0.5
    np.testing.assert_array_equal(
        study.cases[2].run.pv, wb.simulate(study.cases[2].loop, wb.Experiment(100.0, wb.Step(4.0))).pv
    )
    content = results_content(study)["cases"]
    assert content[0]["rule"] is None
    assert content[2]["rule"]["name"] == "detuned_integral"
    assert content[2]["rule"]["factor"] == 4.0
    assert "Table II" in content[2]["rule"]["source"]


@pytest.mark.parametrize(
    ("written", "where", "words"),
    [
        ("SIMC", "11:21: cases[1].rule", "SIMC given (did you mean simc?); must be one of simc, lambda, amigo"),
        ("{nam: simc}", "11:21: cases[1].rule", "name is missing; must be one of simc"),
        ("{name: simc, lambda: 3 s}", "cases[1].rule.lambda", "unknown key; allowed: name, tau_c"),
        ("{name: lambda, lambda: 15}", "11:44: cases[1].rule.lambda", 'such as "15 s", or a multiple'),
        ("{name: lambda, lambda: 0 tau}", "cases[1].rule.lambda", "0 tau given"),
        ("{name: lambda, wanted: 3 s}", "cases[1].rule.wanted", "unknown key; allowed: name, lambda"),
        ("{name: no_crossing, gain_margin: 1}", "cases[1].rule.gain_margin", "must be above 1"),
        ("detuned_integral", "cases[1].rule.base", "missing"),
        ("{name: detuned_integral, base: R}", "cases[1].rule.base", "a case above this one (Case 1)"),
        ("{name: detuned_integral, base: Case 1}, form: series", "cases[1].form", "of its base case as it is"),
        ("simc, Kc: 1", "11:27: cases[1].Kc", "(a case holds Kc and Ti, or a rule, or tune)"),
        ("simc, tune: {}", "11:15: cases[1].rule", "(a case holds Kc and Ti, or a rule, or tune)"),
        ("simc, action: direct", "cases[1].rule", "a plant of this sign needs action reverse"),
        ("{name: ziegler_nichols, controller: PID}, form: series, derivative_filter: 10", "cases[1].rule", "4.4 Td"),
    ],
)
def test_refusals_of_rules_say_where_and_what(written: str, where: str, words: str) -> None:
    text = refusal(entry(written))
    assert where in text
    assert words in text
    assert "\n" not in text


def test_a_rule_that_does_not_suit_the_plant_is_refused_when_the_file_is_checked() -> None:
    plant = "{type: integrating, gain: 0.05, dead_time: 1 s}"
    text = entry("no_crossing").replace("{type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}", plant)
    assert "cases[1].rule: an integrating plant given; with integral action the loci" in refusal(text)


def recorded(folder: Path) -> None:
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.6, 15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(900.0, (wb.Step(2.0), wb.Step(1.5, 300.0)), noise=wb.Noise(0.02, 3)))
    rows = np.column_stack([run.time, run.sp, run.pv, run.op])
    np.savetxt(folder / "loop.csv", rows, delimiter=",", header="time,SP,PV,OP", comments="")


DATA = """\
title: From data
estimate: {data: loop.csv}
experiment: {duration: 100 s, setpoint: {step: 1}}
analyze: {limit_cycle: false, describing_function: false}
cases:
  - {name: SIMC, rule: simc}
"""


@pytest.mark.slow
def test_a_rule_is_applied_to_the_loop_that_the_record_shows(tmp_path: Path) -> None:
    recorded(tmp_path)
    plan = read_scenario(
        DATA + "  - {name: Slow, rule: {name: detuned_integral, base: SIMC}}\n", tmp_path / "data.yaml"
    )
    study = run_scenario(plan)
    found = study.estimates[0].found
    loop = wb.Loop(found.plant, found.valve, wb.PID(1.0, 10.0), 1.0)
    assert study.cases[0].loop.controller == wb.apply_rule(loop, wb.Simc(), digits=4)
    assert study.cases[1].loop.controller.Ti == 10.0 * study.cases[0].loop.controller.Ti
    (tuned,) = tune_scenario(plan, Wishes(Kc=(0.1, 0.1), Ti=(20.0, 20.0), Td=(0.0, 0.0)))
    assert tuned.tuned.status.success


def test_a_rule_that_does_not_suit_the_record_names_its_entry(tmp_path: Path) -> None:
    recorded(tmp_path)
    plan = read_scenario(DATA.replace("rule: simc", "rule: simc, action: direct"), tmp_path / "data.yaml")
    with pytest.raises(ScenarioError, match=r"data\.yaml:6:5: cases\[0\]: rule simc: direct action"):
        run_scenario(plan)


# repair ------------------------------------------------------------------------------------------------------------

REPAIR = BASE.replace("limit_cycle: false}", "limit_cycle: false, repair: true}")
SEARCH = "  - {name: PI, tune: {bounds: {Kc: [0, 10], Ti: [5 s, 100 s]}, Td: 0 s, restarts: 1, digits: 2}}\n"


def test_the_value_of_repair_stands_in_the_study() -> None:
    study = run_scenario(read(REPAIR + SEARCH))
    given, tuned = study.cases
    assert study.repair is not None
    assert study.repair.tuned is tuned.tuned, "the case's search is not made twice"
    assert study.repair.present.controller == given.loop.controller
    assert given.repaired is not None
    assert given.repaired.objective == study.repair.repaired.objective
    assert tuned.repaired is not None
    assert tuned.repaired.objective >= study.repair.best_repaired.objective * 0.999
    content = json.loads(json.dumps(strict(results_content(study)), allow_nan=False))
    assert content["repair"]["best_repaired"]["objective"] == pytest.approx(study.repair.best_repaired.objective)
    share = content["repair"]["share_that_only_repair_removes"]["mean_square_error"]
    assert share == pytest.approx(study.repair.share("mean_square_error"))
    assert content["cases"][0]["repaired"]["kpis"]["valve_travel"] == pytest.approx(given.repaired.kpis.valve_travel)


def test_without_a_search_among_the_cases_one_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = quickened(monkeypatch)
    study = run_scenario(read(REPAIR))
    assert asked == [None]
    assert study.repair is not None
    assert study.repair.best.objective < study.repair.present.objective


def quickened(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Make the value of repair in one search each; return what it was given as `tuned`, as it comes."""
    asked: list[object] = []
    true_value = runner.value_of_repair

    def quick(*args: object, **kwargs: object) -> object:
        asked.append(kwargs.pop("tuned"))
        return true_value(*args, tuned=None, restarts=1, digits=2, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(runner, "value_of_repair", quick)
    return asked


def test_a_search_of_the_repair_stays_within_the_bounds_of_robust_tunings(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = quickened(monkeypatch)
    tune = "{robust: {duration: 100 s, draws: 4}, bounds: {Kc: [0.2, 1.2], Ti: [5 s, 30 s]}, Td: 0 s, "
    tune += "restarts: 1, digits: 2}"
    study = run_scenario(read(f"{REPAIR}  - {{name: R, tune: {tune}}}\n"))
    assert asked == [None]
    assert study.repair is not None
    bounds = wb.Bounds((0.2, 1.2), (5.0, 30.0), (0.0, 0.0))
    assert study.repair.tuned.bounds == study.repair.tuned_repaired.bounds == bounds


def test_repair_is_not_asked_of_what_does_not_stick(tmp_path: Path) -> None:
    ideal = REPAIR.replace("{type: stenman, d: 2.0}", "{type: ideal}")
    assert "8:67: analyze.repair: true given for an ideal valve" in refusal(ideal)
    assert "true given without cases" in refusal(REPAIR.split("cases:")[0] + "estimate: {simulate: true}\n")
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Ideal(), wb.PID(0.6, 15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(600.0, (wb.Step(2.0), wb.Step(1.5, 300.0)), noise=wb.Noise(0.02, 3)))
    rows = np.column_stack([run.time, run.sp, run.pv, run.op])
    np.savetxt(tmp_path / "loop.csv", rows, delimiter=",", header="time,SP,PV,OP", comments="")
    text = DATA.replace("limit_cycle: false,", "limit_cycle: false, repair: true,")
    study = run_scenario(read_scenario(text, tmp_path / "data.yaml"))
    assert study.repair is None
    assert study.notes[-1] == "The valve does not stick: there is nothing to repair."
