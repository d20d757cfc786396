"""The loop's further elements in a scenario: as read, as refused with line and column, as told by the report."""

from __future__ import annotations

from pathlib import Path

import pytest

from workbench.errors import ScenarioError
from workbench.model.characteristic import EqualPercentage
from workbench.model.karnopp import Karnopp
from workbench.model.valve import Choudhury, Positional, Stenman
from workbench.report.page import write_report
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


CURVED = "sample_time: 1 s\n  characteristic: {type: equal_percentage, rangeability: 50, opening: 35 %}"


def test_characteristic_and_fail_open_are_read_run_and_told() -> None:
    text = GOOD.replace(CONTROLLER, "{action: direct, output_limits: [-20, 35]}").replace(
        "sample_time: 1 s", f"{CURVED}\n  fail_open: true"
    )
    study = run_scenario(read(text))
    loop = study.cases[0].loop
    assert (loop.characteristic, loop.fail_open) == (EqualPercentage(50.0, 35.0), True)
    lines = dict(loop_lines(study))
    assert "equal percentage, rangeability 50, 35 % open" in lines["Characteristic"]
    assert "fail-open" in lines["Action of the valve"]
    content = results_content(study)["loop"]
    assert content["characteristic"] == {"type": "equal_percentage", "rangeability": 50.0, "opening": 35.0}
    assert content["fail_open"] is True
    straight = read(GOOD.replace("sample_time: 1 s", "sample_time: 1 s\n  characteristic: {type: linear}")).loop
    assert straight == read(GOOD).loop


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (CURVED, "output_limits: none given; must lie within (-35, 65) %, the travel of a valve"),
        (CURVED.replace("50", "0.5"), "loop.yaml:7:58: loop.characteristic.rangeability: 0.5 given"),
        (CURVED.replace("35 %", "120 %"), "loop.characteristic.opening: 120 % given; must be below 100 %"),
        (
            CURVED.replace("equal_percentage", "quick_opening"),
            "loop.yaml:7:26: loop.characteristic.type: quick_opening given",
        ),
        ("sample_time: 1 s\n  fail_open: 1", "loop.yaml:7:14: loop.fail_open: 1 given; must be true or false"),
        (
            "sample_time: 1 s\n  fail_open: true",
            "loop.yaml:3:30: loop.plant.gain: 1 given, and reverse action by default; the controller acts the wrong",
        ),
    ],
)
def test_a_wrong_characteristic_is_refused_where_it_stands(wrong: str, told: str) -> None:
    assert told in refusal(GOOD.replace("sample_time: 1 s", wrong))


def test_every_case_must_keep_within_the_travel() -> None:
    text = GOOD.replace(CONTROLLER, "{output_limits: [-20, 20]}").replace("sample_time: 1 s", CURVED)
    text += "  - {name: Wide, Kc: 1, Ti: 20 s, output_limits: [-40, 20]}\n"
    assert "loop.yaml:11:50: cases[1].output_limits: (-40, 20) % given; must lie within (-35, 65) %" in refusal(text)


def test_a_loop_from_data_has_no_elements_of_its_own() -> None:
    text = "title: D\nestimate: {data: no.csv}\nloop: {fail_open: true, characteristic: {type: linear}}\n"
    told = refusal(text)
    assert "loop.fail_open: given, and estimate.data as well; a loop found in recorded data is linear" in told
    assert "loop.characteristic: given, and estimate.data as well" in told


def test_a_scan_is_read_run_and_told() -> None:
    study = run_scenario(read(GOOD.replace("sample_time: 1 s", "sample_time: 0.5 s\n  scan: 2")))
    assert study.cases[0].loop.scan == 2
    assert (study.cases[0].run.op[1::2] == study.cases[0].run.op[::2]).all()
    assert dict(loop_lines(study))["Controller scan"] == "every 1 s (2 samples)"
    assert results_content(study)["loop"]["scan"] == 2


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("scan: 0", "loop.yaml:7:9: loop.scan: 0 given; must be >= 1"),
        ("scan: 2.5", "loop.yaml:7:9: loop.scan: 2.5 given"),
        ("scan: 2 s", "loop.yaml:7:9: loop.scan: 2 s given"),
        ("scan: 2", "loop.sample_time: the time between the controller's executions (2 s) is longer than the dead"),
    ],
)
def test_a_wrong_scan_is_refused_where_it_stands(wrong: str, told: str) -> None:
    assert told in refusal(GOOD.replace("sample_time: 1 s", f"sample_time: 1 s\n  {wrong}"))


STENMAN = "{type: stenman, d: 2.0}"
PLACES = "{type: positional, places: [{position: -20 %, S: 6, J: 2}, {position: 10, S: 3 %, J: 1}]}"


@pytest.mark.usefixtures("undrawn")
def test_friction_by_place_is_read_run_and_told(tmp_path: Path) -> None:
    study = run_scenario(read(GOOD.replace(STENMAN, PLACES).replace("Ti: 20 s", "Ti: 200 s")))
    case = study.cases[0]
    assert case.loop.valve == Positional((-20.0, 10.0), (Choudhury(6.0, 2.0), Choudhury(3.0, 1.0)))
    assert case.describing_function is None
    assert case.limit_cycle is not None
    assert any("no describing function" in note for note in study.notes)
    assert "varies along the travel" in dict(loop_lines(study))["Valve"]
    assert results_content(study)["loop"]["valve"]["positions"] == (-20.0, 10.0)
    one = read(GOOD.replace(STENMAN, "{type: positional, places: [{position: 0, d: 2}]}")).loop
    assert one is not None
    assert one.valve == Positional((0.0,), (Stenman(2.0),))
    write_report(study, tmp_path)
    assert "varies along the travel" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("{type: positional, places: []}", "loop.yaml:4:37: loop.valve.places: a list of 0 given"),
        ("{type: positional}", "loop.valve.places: missing"),
        (PLACES.replace("10, S: 3 %, J: 1", "10, d: 3"), "loop.yaml:4:69: loop.valve.places[1]: Stenman given; must"),
        (PLACES.replace("position: 10", "position: -30"), "must be above -20 %"),
        (
            PLACES.replace("position: 10", "position: -19"),
            "friction that changes by 2 % given; must be less than the 1 %",
        ),
        (PLACES.replace("J: 1}", "J: 1, K: 2}"), "loop.valve.places[1].K: unknown key"),
    ],
)
def test_a_wrong_table_is_refused_where_it_stands(wrong: str, told: str) -> None:
    assert told in refusal(GOOD.replace(STENMAN, wrong))


def test_a_describing_function_that_was_asked_for_is_refused_where_there_is_none() -> None:
    text = GOOD.replace(STENMAN, PLACES) + "analyze: {describing_function: true}\n"
    assert "loop.yaml:10:32: analyze.describing_function: true given; this valve has no describing" in refusal(text)


KARNOPP = (
    "{type: karnopp, mass: 1.36, spring: 52500, travel: 0.0847, coulomb: 142.3, static: 170.8, viscous: 612, "
    "stribeck: 2.54e-4, substep: 2 ms}"
)


def test_a_valve_with_mass_is_read_run_and_told() -> None:
    study = run_scenario(read(GOOD.replace(STENMAN, KARNOPP)))
    case = study.cases[0]
    assert case.loop.valve == Karnopp(1.36, 52500.0, 0.0847, 142.3, 170.8, 612.0, 2.54e-4, 2e-3)
    assert case.describing_function is None
    assert case.limit_cycle is not None
    assert "a stem of 1.36 kg on a spring of 52,500 N/m" in dict(loop_lines(study))["Valve"]
    assert results_content(study)["loop"]["valve"]["type"] == "karnopp"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("mass: 1.36", "mass: 0", "loop.yaml:4:32: loop.valve.mass: 0.0 given; must be a finite number > 0 kg"),
        ("static: 170.8", "static: 100", "loop.valve.static: 100 N given; must be at least the Coulomb friction"),
        ("viscous: 612", "viscous: -1", "loop.valve.viscous: -1 given; must be >= 0"),
        ("substep: 2 ms", "substep: 2", "loop.valve.substep: 2 given; must be "),
        ("substep: 2 ms", "substep: 1 us", "loop.valve.substep: 1 us given"),
        ("spring: 52500, ", "", "loop.valve.spring: missing"),
    ],
)
def test_a_wrong_mechanism_is_refused_where_it_stands(old: str, new: str, told: str) -> None:
    assert told in refusal(GOOD.replace(STENMAN, KARNOPP.replace(old, new)))
