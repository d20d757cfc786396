"""The loop's further elements in a scenario: as read, as refused with line and column, as told by the report."""

from __future__ import annotations

from pathlib import Path

import pytest

from workbench.errors import ScenarioError
from workbench.report.results import results_content
from workbench.report.shared import loop_lines
from workbench.scenario.loader import read_scenario
from workbench.scenario.plan import Scenario
from workbench.scenario.runner import run_scenario

GOOD = """\
title: A loop
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2.0}
  controller: {derivative_filter: none}
  sample_time: 1 s
experiment: {duration: 100 s, setpoint: {step: 4, at: 0 s}}
cases:
  - {name: Case 1, Kc: 0.5, Ti: 20 s}
"""
CONTROLLER = "{derivative_filter: none}"


def read(text: str) -> Scenario:
    return read_scenario(text, Path("loop.yaml"), "loop.yaml")


def refusal(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        read(text)
    return str(caught.value)


def test_a_resolution_of_op_is_read_run_and_told() -> None:
    text = GOOD.replace(CONTROLLER, "{derivative_filter: none, output_resolution: 0.5 %}")
    text += "  - {name: Fine, Kc: 0.5, Ti: 20 s, output_resolution: 0}\n"
    study = run_scenario(read(text))
    assert [case.loop.controller.output_resolution for case in study.cases] == [0.5, 0.0]
    assert ((study.cases[0].run.op / 0.5) % 1.0 == 0.0).all()
    assert "output resolution" not in dict(loop_lines(study))["Controller"]
    told = [case["controller"].get("output_resolution") for case in results_content(study)["cases"]]
    assert told == [0.5, None]
    alike = run_scenario(read(text.replace("output_resolution: 0}", "output_resolution: 0.5}")))
    assert "output resolution 0.5 %" in dict(loop_lines(alike))["Controller"]


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("output_resolution: -1", "loop.yaml:5:60: loop.controller.output_resolution: -1 given; must be >= 0"),
        (
            "output_resolution: 1 s",
            "loop.yaml:5:60: loop.controller.output_resolution: 1 s given; must be a number of %",
        ),
        ("resolution: 1", "loop.yaml:5:41: loop.controller.resolution: unknown key (did you mean output_resolution?)"),
    ],
)
def test_a_wrong_resolution_is_refused_where_it_stands(wrong: str, told: str) -> None:
    text = GOOD.replace(CONTROLLER, "{derivative_filter: none, " + wrong + "}")
    assert told in refusal(text)
