"""Compensators in scenarios: read, refused at their place, run, and told in results and report."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import pytest

import workbench as wb
from workbench.report.page import write_report
from workbench.report.results import results_content
from workbench.scenario.loader import read_scenario

HEAD = """\
title: Compensated
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2 %}
  controller: {Kc: 0.5, Ti: 20 s}
  sample_time: 1 s
experiment: {duration: 300 s, setpoint: {step: 4, at: 0 s}}
cases:
  - name: plain
"""
CASES = """\
  - {name: band, compensator: {type: integral_deadband, band: 1.1}}
  - {name: slowed, compensator: {type: integral_deadband, band: 1.1, ratio: 16}}
  - {name: knocked, compensator: {type: knocker, amplitude: 2.5 %, width: 2 s, period: 0.1 min}}
  - {name: reinforced, compensator: {type: constant_reinforcement, amplitude: 2}}
  - {name: moved, compensator: {type: two_move, amplitude: 4.5 %, at: 1 min, steady_output: 4 %, release: 1.5}}
  - {name: held, compensator: {type: two_move, amplitude: 4.5 %, at: 60 s, steady_output: 4 %}}
  - {name: shaken, compensator: {type: dither, amplitude: 3 %, period: 4 s}}
  - {name: beaten, Kc: 1, compensator: {type: dither, amplitude: 3 %, period: 4 s, shape: square}}
"""
GIVEN = [
    None,
    wb.IntegralDeadband(1.1),
    wb.IntegralDeadband(1.1, 16.0),
    wb.Knocker(2.5, 2.0, 6.0),
    wb.ConstantReinforcement(2.0),
    wb.TwoMove(4.5, 60.0, 4.0, 1.5),
    wb.TwoMove(4.5, 60.0, 4.0),
    wb.Dither(3.0, 4.0),
    wb.Dither(3.0, 4.0, "square"),
]


def read(text):
    return read_scenario(text, Path("compensated.yaml"))


def test_every_compensator_is_read_and_a_case_may_take_it_away():
    assert [case.controller.compensator for case in read(HEAD + CASES).cases] == GIVEN
    shared = HEAD.replace("Ti: 20 s}", "Ti: 20 s, compensator: {type: constant_reinforcement, amplitude: 1}}")
    cases = read(shared + "  - {name: without, compensator: null}\n").cases
    assert [case.controller.compensator for case in cases] == [wb.ConstantReinforcement(1.0), None]


# The entry, what it is refused for, and the text in it where the refusal stands.
WRONG = [
    ("{type: knoker}", "type: knoker given (did you mean knocker?); must be one of", "knoker"),
    ("{amplitude: 2}", "compensator: type is missing; must be one of integral_deadband, knocker", "{"),
    ("{type: knocker, amplitude: 2, width: 1 s}", "compensator.period: missing", "{"),
    ("{type: dither, amplitude: 0 %, period: 4 s}", "compensator.amplitude: 0.0 given; must be a finite", "0 %"),
    ("{type: dither, amplitude: 2, period: 4 s, tau: 1}", "compensator.tau: unknown key", "tau"),
    (
        "{type: dither, amplitude: 2, period: 3 s, shape: square}",
        "compensator.period: 3 s given; must be an even",
        "3 s",
    ),
    ("{type: knocker, amplitude: 2, width: 2 s, period: 1 s}", "compensator.period: 1 s given; must be >=", "1 s"),
    ("{type: knocker, amplitude: 2, width: 1.5 s, period: 3 s}", "compensator.width: 1.5 s given; must be a", "1.5"),
    ("{type: integral_deadband, band: -1}", "compensator.band: -1 given; must be above 0", "-1"),
    ("{type: integral_deadband, band: 1, ratio: 0.5}", "compensator.ratio: 0.5 given; must be a number >= 1", "0.5"),
    ("{type: two_move, amplitude: 4, at: 60 s}", "compensator.steady_output: missing", "{"),
    (
        "{type: two_move, amplitude: 4, at: 400 s, steady_output: 4}",
        "compensator.at: 400 s given; must be within the experiment's duration (300 s)",
        "400",
    ),
    ("2 %", "compensator: 2 % given; must be a mapping with type", "2"),
]


@pytest.mark.parametrize(("entry", "said", "at"), WRONG)
def test_what_is_wrong_is_refused_at_its_place(entry, said, at):
    line = f"    compensator: {entry}"
    with pytest.raises(wb.ScenarioError) as refused:
        read(f"{HEAD}  - name: wrong\n{line}\n")
    told = str(refused.value)
    assert "\n" not in told
    assert told.startswith(f"compensated.yaml:11:{line.index(at, 17) + 1}: cases[1].compensator")
    assert said in told


def test_a_compensator_of_the_shared_controller_is_refused_there():
    shared = HEAD.replace(
        "Ti: 20 s}", "Ti: 20 s, compensator: {type: knocker, amplitude: 1, width: 0.4 s, period: 3 s}}"
    )
    with pytest.raises(wb.ScenarioError) as refused:
        read(shared)
    assert "compensated.yaml:5:85: loop.controller.compensator.width: 0.4 s given; must be a whole number" in str(
        refused.value
    )


@pytest.mark.usefixtures("undrawn")
def test_results_and_report_tell_the_compensators(tmp_path):
    study = wb.run_scenario(read(HEAD + CASES))
    content = results_content(study)
    assert "compensator" not in content["cases"][0]["controller"]
    assert content["cases"][3]["controller"]["compensator"] == {
        "type": "Knocker",
        "amplitude": 2.5,
        "width": 2.0,
        "period": 6.0,
    }
    assert content["cases"][0]["describing_function"] is not None
    assert all(case["describing_function"] is None for case in content["cases"][1:])
    assert all(case["limit_cycle"] is not None for case in content["cases"])
    write_report(study, tmp_path)
    written = json.loads((tmp_path / "results.json").read_text())
    assert written["cases"][6]["controller"]["compensator"]["release"] == "none"
    assert math.isclose(written["cases"][1]["kpis"]["valve_travel"], study.cases[1].run.kpis.valve_travel)
    rows = list(csv.DictReader((tmp_path / "cases.csv").read_text().splitlines()))
    assert [row["compensator"] for row in rows[:4]] == ["", "IntegralDeadband", "IntegralDeadband", "Knocker"]
    page = (tmp_path / "report.html").read_text()
    for words in (
        "integral dead band within ±1.1 EU",
        "Ti 16 times as long within ±1.1 EU",
        "knocker, 2.5",
        "constant reinforcement, 2",
        "two moves at 60 s",
        "square dither, 3",
    ):
        assert words in page
