"""What can be run and was most likely meant otherwise is said, by the command and first of all in the report."""

from __future__ import annotations

from pathlib import Path

import pytest

from workbench.report.summary import summarise
from workbench.scenario.loader import read_scenario
from workbench.scenario.plan import Scenario
from workbench.scenario.runner import run_scenario

SCENARIO = """\
title: A loop
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2.0}
  controller: {derivative_filter: none}
  sample_time: 1 s
experiment: {duration: 100 s, setpoint: {step: 4, at: 0 s}}
analyze: {describing_function: false, limit_cycle: false}
cases:
  - {name: Case 1, Kc: 0.5, Ti: 20 s}
  - {name: Case 2, Kc: 0.6, Ti: 20 s}
"""


def plan(old: str = "", new: str = "") -> Scenario:
    assert old in SCENARIO
    return read_scenario(SCENARIO.replace(old, new) if old else SCENARIO, Path("loop.yaml"))


SETPOINT = ", setpoint: {step: 4, at: 0 s}"
FRACTION = (
    "loop.valve sticks over 0.02 % of travel, less than a good valve resolves (0.1 %): 2 % is written 2, not 0.02."
)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("d: 2.0", "d: 0.02", FRACTION),
        ("type: stenman, d: 2.0", "type: choudhury, S: 0.05, J: 0.03", "loop.valve sticks over 0.05 % of travel"),
        ("none}", "none, output_limits: [0, 100]}", "Case 1, Case 2: output limits 0 to 100 %: the loop rests on one"),
        (
            "Ti: 20 s}\n  - {name: Case 2,",
            "Ti: 20 s}\n  - {name: Case 2, output_limits: [-9, 0],",
            "Case 2: output lim",
        ),
        (SETPOINT, "", "experiment: without a setpoint move, a load or noise the loop stays at rest"),
        ("step: 4", "step: 0", "experiment: without a setpoint move"),
        ("{step: 4, at: 0 s}", "{series: [0, 0]}", "experiment: without a setpoint move"),
        (SETPOINT, ", noise: {sd: 0}", "experiment: without a setpoint move"),
    ],
)
def test_what_was_most_likely_meant_otherwise_is_said(old: str, new: str, said: str) -> None:
    found = plan(old, new)
    (caution,) = found.cautions
    assert caution.text.startswith(said)
    assert found.mistakes == (caution.text,)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("", ""),
        ("d: 2.0", "d: 0.1"),
        ("type: stenman, d: 2.0", "type: ideal"),
        ("none}", "none, output_limits: [-40, 60]}"),
        (SETPOINT, ", load: {step: 1}"),
        (SETPOINT, ", noise: {sd: 0.1}"),
        (SETPOINT, ", stem_offset: 1"),
        ("{step: 4, at: 0 s}", "{series: [0, 1]}"),
        ("{step: 4, at: 0 s}", "{ramp: 1, start: 0 s, end: 9 s}"),
    ],
)
def test_what_may_well_be_meant_is_taken_without_a_word(old: str, new: str) -> None:
    assert plan(old, new).mistakes == ()


def test_a_compensator_moves_a_loop_by_itself() -> None:
    dither = "compensator: {type: dither, amplitude: 2.5 %, period: 4 s, shape: square}"
    text = SCENARIO.replace(SETPOINT, "").replace("none}", f"none, {dither}}}")
    assert read_scenario(text, Path("loop.yaml")).mistakes == ()


def test_the_report_advises_nothing_where_nothing_moved() -> None:
    study = run_scenario(plan(SETPOINT, ""))
    told = summarise(study)
    assert told.decision == "This experiment tells nothing of these tunings: neither PV nor a valve moves in it."
    assert told.settings is None
    assert told.found[0].startswith("Look at the scenario again: experiment: without a setpoint move")


def test_the_report_says_first_that_a_controller_acts_the_wrong_way() -> None:
    study = run_scenario(plan("none}", "none, action: direct}"))
    first, second, *_ = summarise(study).found
    assert first.startswith("Look at the scenario again: Case 1: the controller acts the wrong way")
    assert second.startswith("Look at the scenario again: Case 2: the controller acts the wrong way")
    assert study.notes == ()


CASCADE = """\
title: A cascade
cascade:
  primary:
    plant: {type: fopdt, gain: 1.2, time_constant: 60 s, dead_time: 10 s}
    controller: {Kc: 1.5, Ti: 80 s}
    sample_time: 5 s
  secondary:
    plant: {type: fopdt, gain: 1.0, time_constant: 3 s, dead_time: 1 s}
    valve: {type: stenman, d: 1 %}
    controller: {Kc: 0.5, Ti: 5 s}
    sample_time: 1 s
experiment: {duration: 200 s, setpoint: {step: 4, at: 0 s}}
analyze: {limit_cycle: false}
cases:
  - {name: As found}
  - {name: Calmer, primary: {Kc: 0.8}}
"""
IN_PRIMARY = "Kc: 1.5, Ti: 80 s"
IN_SECONDARY = "Kc: 0.5, Ti: 5 s"


def cascade(old: str = "", new: str = "") -> Scenario:
    assert old in CASCADE
    return read_scenario(CASCADE.replace(old, new) if old else CASCADE, Path("cascade.yaml"))


@pytest.mark.parametrize(
    ("old", "new", "where", "said"),
    [
        ("d: 1 %", "d: 0.01", "cascade.secondary.valve", "cascade.secondary.valve sticks over 0.01 % of travel, less"),
        (
            IN_SECONDARY,
            f"{IN_SECONDARY}, output_limits: [0, 100]",
            "cascade.secondary.controller.output_limits",
            "As found, Calmer: output limits of the secondary 0 to 100 %: the loop rests on one of them, as OP is",
        ),
        (
            IN_PRIMARY,
            f"{IN_PRIMARY}, output_limits: [-9, 0]",
            "cascade.primary.controller.output_limits",
            (
                "As found, Calmer: output limits of the primary -9 to 0: the loop rests on one of them, as its output, "
                "the secondary's setpoint, is counted from its resting point."
            ),
        ),
        (
            "{Kc: 0.8}",
            "{Kc: 0.8, output_limits: [0, 9]}",
            "cascade.primary.controller.output_limits",
            "Calmer: output limits of the primary 0 to 9: the loop rests",
        ),
        (
            SETPOINT,
            ", primary_load: {step: 0}",
            "experiment.setpoint.step",
            (
                "experiment: without a setpoint move, a load or noise both loops stay at rest, and its run tells "
                "nothing of any tuning: give a setpoint, such as {step: 4, at: 0 s}, or a load or primary_load."
            ),
        ),
    ],
)
def test_a_cascade_has_the_cautions_of_its_loops(old: str, new: str, where: str, said: str) -> None:
    found = cascade(old, new)
    (caution,) = found.cautions
    assert caution.where == where
    assert caution.text.startswith(said)
    assert found.mistakes == (caution.text,)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("", ""),
        (IN_SECONDARY, f"{IN_SECONDARY}, output_limits: [-40, 60]"),
        (SETPOINT, ", primary_load: {step: 1}"),
        (SETPOINT, ", load: {step: 1}"),
        (SETPOINT, ", noise: {sd: 0.1}"),
        (SETPOINT, ", secondary_noise: {sd: 0.1}"),
    ],
)
def test_a_cascade_as_it_may_well_be_meant_is_taken_without_a_word(old: str, new: str) -> None:
    assert cascade(old, new).mistakes == ()


def test_the_report_of_a_cascade_begins_with_them_and_advises_nothing_where_nothing_moved() -> None:
    told = summarise(run_scenario(cascade(SETPOINT, "")))
    assert told.found[0].startswith("Look at the scenario again: experiment: without a setpoint move")
    assert told.decision == "This experiment tells nothing of these tunings: neither PV nor the valve moves in it."
    assert told.settings is None
    assert summarise(run_scenario(cascade())).settings is not None
