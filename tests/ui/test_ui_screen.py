"""The screen as texts: to a scenario that the loader takes, back to the same screen, and nothing typed gets out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import plants, valves

import workbench as wb
from workbench.errors import ScenarioError
from workbench.scenario.document import parse, plain
from workbench.scenario.loader import load_scenario, read_scenario
from workbench.ui.fields import DEFAULTS, FIELDS, field_of
from workbench.ui.load import controller_entries, plant_entries, screen_of, valve_entries
from workbench.ui.screen import Pinned, Screen, estimate_text, scenario_text
from workbench.ui.state import problems_of
from workbench.ui.trees import number_text
from workbench.ui.yaml_text import scalar, words, yaml_of

SCENARIOS = Path(__file__).parents[2] / "scenarios"
FILE = Path("screen.yaml")


def on_screen(screen: Screen) -> dict[str, str]:
    """What a scenario keeps: the settings of a search or an estimate that is not in it belong to the page alone."""
    return {path: text for path, text in screen.entries.items() if not path.startswith(("tune", "estimate."))}


def read(screen: Screen, **options: bool):
    return read_scenario(scenario_text(screen, **options), FILE)


def test_the_empty_page_is_a_scenario_that_runs():
    plan = read(Screen())
    assert plan.loop is not None
    assert plan.loop.valve == wb.Stenman(2.0)
    assert plan.loop.controller == wb.PID(Kc=0.5, Ti=20.0)
    assert plan.experiment == wb.Experiment(1000.0, wb.Step(4.0))
    assert [case.name for case in plan.cases] == ["On screen"]


def test_an_unknown_path_is_no_field():
    with pytest.raises(KeyError):
        Screen().with_entries({"loop.plant.gian": "1"})


@given(plant=plants, valve=valves)
def test_every_plant_and_valve_stands_on_the_page_to_the_last_digit(plant, valve):
    entries = plant_entries(plant) | valve_entries(valve) | {"loop.coarse_sampling": "true"}
    entries |= {"loop.controller.action": "reverse" if plant.gain > 0 else "direct", "experiment.duration": "5000"}
    loop = read(Screen().with_entries(entries)).loop
    assert loop is not None
    assert loop.plant == plant
    assert loop.valve == valve


@pytest.mark.parametrize(
    "valve",
    [
        wb.Positional((-1e-3, 0.1 + 0.2), (wb.Stenman(1 / 3), wb.Stenman(0.25))),
        wb.Positional((-20.0, 0.5, 1e2), (wb.Choudhury(1 / 3, 0.1), wb.Choudhury(2.0, 0.0), wb.Choudhury(7.0, 7.0))),
        wb.Karnopp(1 / 3, 52500.5, 0.1 + 0.2, 0.0, 1e-7, 612.25, 2.54e-4, 1 / 7),
    ],
    ids=lambda valve: type(valve).__name__,
)
def test_places_and_masses_stand_on_the_page_to_the_last_digit(valve):
    loop = read(Screen().with_entries(valve_entries(valve))).loop
    assert loop is not None
    assert loop.valve == valve


@pytest.mark.parametrize(
    "pid",
    [
        wb.PID(0.1 + 0.2, 1 / 3, 1e-7),
        wb.PID(2.0, math.inf, form="series", derivative_on="pv", derivative_filter=math.inf),
        wb.PID(2.0, 30.0, 1.0, form="parallel", derivative_on="pv", setpoint_weight=0.0),
        wb.PID(2.0, 30.0, 1.0, setpoint_weight=0.25, output_limits=(-5.0, 7.5)),
        wb.PID(2.0, 30.0, output_limits=(-5.0, 7.5), anti_windup="back_calculation", tracking_time=12.0),
        wb.PID(2.0, 30.0, output_resolution=1 / 3, compensator=wb.IntegralDeadband(0.1 + 0.2)),
        wb.PID(2.0, 30.0, compensator=wb.IntegralDeadband(1.1, 16.0)),
        wb.PID(2.0, 30.0, compensator=wb.Knocker(1 / 3, 2.0, 60.0)),
        wb.PID(2.0, 30.0, compensator=wb.ConstantReinforcement(0.7)),
        wb.PID(2.0, 30.0, compensator=wb.TwoMove(4.5, 0.0, -1e-3)),
        wb.PID(2.0, 30.0, compensator=wb.TwoMove(4.5, 300.0, 4.0, 1.2)),
        wb.PID(2.0, 30.0, compensator=wb.Dither(2.5, 2.0, "square")),
    ],
)
def test_every_controller_stands_on_the_page_and_in_a_case_to_the_last_digit(pid):
    plan = read(replace(Screen().with_entries(controller_entries(pid)), cases=(Pinned("A", pid), Pinned("B", pid))))
    assert [case.controller for case in plan.cases] == [pid] * 3
    # A case takes nothing over from the page: whatever stands there.
    other = wb.PID(9.0, 9.0, 9.0, form="series", output_limits=(-1.0, 1.0), tracking_time=3.0)
    other = replace(other, output_resolution=0.5, compensator=wb.Dither(1.0, 8.0))
    plan = read(replace(Screen().with_entries(controller_entries(other)), cases=(Pinned("A", pid),)))
    assert plan.cases[0].controller == other
    expected = pid
    if pid.output_limits is None:  # without limits these play no part, and stay as they are on the page
        assert plan.cases[1].controller.output_limits is None
        return
    if pid.anti_windup == "clamp":
        expected = replace(pid, tracking_time=plan.cases[1].controller.tracking_time)
    assert plan.cases[1].controller == expected


# All but a site's manifest, which is no scenario.
SHOWN = [path for path in sorted(SCENARIOS.glob("*.yaml")) if path.stem != "fleet_table_1"]


@pytest.mark.parametrize("path", SHOWN, ids=lambda p: p.stem)
def test_what_is_loaded_is_exported_and_loads_as_the_same_screen(path):
    first = screen_of(load_scenario(path)).screen
    text = scenario_text(first)
    second = screen_of(read_scenario(text, FILE)).screen
    assert on_screen(second) == on_screen(first)
    assert scenario_text(second) == text
    assert [(c.name, c.controller, c.note, dict(c.reference)) for c in second.cases] == [
        (c.name, c.controller, c.note, dict(c.reference)) for c in first.cases
    ]


def test_an_objective_of_any_figures_and_a_sites_units():
    loaded = screen_of(load_scenario(SCENARIOS / "loop_1_feed_flow.yaml"))
    assert loaded.screen.entries["objective.w1"] == "0"
    assert loaded.screen.entries["objective.mean_square_error"] == "1"
    assert read(loaded.screen).objective == wb.Objective.of(mean_square_error=1.0, controller_travel=30.0)
    assert any("How the site writes its settings (site:) is left out" in note for note in loaded.notes)


PLAIN = """\
title: A loop
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: VALVE
  controller: {form: idealCONTROLLER}
  sample_time: 1 s
LOOPexperiment: {duration: 100 s, setpoint: {step: 4, at: 0 s}}
cases:
  - {name: As found, Kc: 0.5, Ti: 20 s}
"""
STENMAN = "{type: stenman, d: 2.0}"
KARNOPP = (
    "{type: karnopp, mass: 1.36, spring: 52500, travel: 0.0847, coulomb: 1423, static: 1708, viscous: 612, "
    "stribeck: 0.000254, substep: 20 ms}"
)


@pytest.mark.parametrize(
    ("valve", "controller", "loop"),
    [
        ("{type: positional, places: [{position: -20, d: 6}, {position: 10.5, d: 3 %}]}", "", ""),
        ("{type: positional, places: [{position: -20, S: 6, J: 1}, {position: 10, S: 3, J: 0.5}]}", "", ""),
        (KARNOPP, "", ""),
        (STENMAN, ", output_resolution: 0.5 %", ""),
        (STENMAN, ", compensator: {type: knocker, amplitude: 2 %, width: 1 s, period: 6 s}", ""),
        (STENMAN, "", "  scan: 5\n  coarse_sampling: true\n"),
        (STENMAN, ", action: direct", "  fail_open: true\n"),
        (
            STENMAN,
            ", output_limits: [-40, 30]",
            "  characteristic: {type: equal_percentage, rangeability: 30, opening: 45 %}\n",
        ),
    ],
)
def test_what_few_loops_have_is_shown_and_leaves_as_it_came(valve, controller, loop):
    text = PLAIN.replace("VALVE", valve).replace("CONTROLLER", controller).replace("LOOP", loop)
    plan = read_scenario(text, FILE)
    screen = screen_of(plan).screen
    again = read(screen)
    assert again.loop == plan.loop
    assert screen_of(again).screen.entries == screen.entries
    assert again.cases[1].controller == plan.cases[0].controller


def test_what_few_loops_have_is_no_part_of_a_scenario_without_it():
    text = scenario_text(replace(Screen(), cases=(Pinned("A", wb.PID(1.0, 2.0)),)))
    for word in ("scan", "fail_open", "characteristic", "resolution", "compensator", "coarse"):
        assert word not in text


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("-20 3 2 1\n0 2", "loop.valve.places[0].J: 2 1 given; must be a number of %"),
        ("-20", "loop.valve.places[0]:"),
        ("", "loop.valve.places"),
        ("0 2; 0 3", "loop.valve.places[1]: 0 % given; must be above 0 %"),
        ("0 2, 1 3", "loop.valve.places[0].J: 1 3 given"),
        ("x: y # z", "loop.valve.places[0]"),
    ],
)
def test_places_along_the_travel_are_refused_in_the_loaders_words_at_their_field(typed, said):
    screen = Screen().with_entries({"loop.valve.type": "positional", "loop.valve.places": typed})
    with pytest.raises(ScenarioError) as caught:
        read(screen)
    assert said in str(caught.value)
    problems = problems_of(caught.value, screen.entries)
    assert {one.field for one in problems} == {"loop.valve.places"}


def test_places_may_be_written_with_signs_of_per_cent_and_commas():
    screen = Screen().with_entries({"loop.valve.type": "positional", "loop.valve.places": "-20 %, 6 %; 10,3\n\n40 5"})
    plan = read(screen)
    assert plan.loop is not None
    assert plan.loop.valve == wb.Positional((-20.0, 10.0, 40.0), (wb.Stenman(6.0), wb.Stenman(3.0), wb.Stenman(5.0)))


def test_the_papers_cases_come_with_its_scenario_and_what_is_to_be_tuned_is_said():
    loaded = screen_of(load_scenario(SCENARIOS / "table_2.yaml"))
    assert [case.name for case in loaded.screen.cases] == [f"Case {i}" for i in range(1, 6)]
    assert loaded.screen.cases[0].reference["valve_travel"] == 12.18
    assert any("Optimised PI, Optimised PID" in note for note in loaded.notes)
    assert loaded.screen.entries["tune.bounds.Ti.high"] == "600"


def test_a_scenario_from_data_names_its_record_and_how_it_is_read():
    loaded = screen_of(load_scenario(SCENARIOS / "industrial_flow_loop.yaml"))
    assert loaded.data == "data/industrial_flow_loop.csv"
    assert loaded.screen.entries["experiment.duration"] == "1"
    assert loaded.screen.entries["experiment.duration.unit"] == "h"
    text = (
        "title: t\nestimate: {data: data/industrial_flow_loop.csv, method: joint, plant: auto, columns: {PV: PV}, "
        "sample_time: 5 s, op_range: [0, 100]}\n"
    )
    entries = screen_of(read_scenario(text, SCENARIOS / "x.yaml")).screen.entries
    found = {path.removeprefix("estimate."): text for path, text in entries.items() if path.startswith("estimate.")}
    assert found["method"] == "joint"
    assert found["plant"] == "auto"
    assert found["columns.PV"] == "PV"
    assert (found["sample_time"], found["sample_time.unit"]) == ("5", "s")
    assert (found["op_range.low"], found["op_range.high"]) == ("0", "100")


def test_a_records_sample_time_keeps_its_size_in_a_unit_that_the_page_has_not():
    text = "title: t\nestimate: {data: data/industrial_flow_loop.csv, sample_time: 5000 ms}\n"
    entries = screen_of(read_scenario(text, SCENARIOS / "x.yaml")).screen.entries
    assert (entries["estimate.sample_time"], entries["estimate.sample_time.unit"]) == ("5", "s")


def test_what_the_page_cannot_say_of_a_record_is_told():
    more = "max_gap: 1 min, columns: {PV: PV, MODE: MODE}"
    text = f"title: t\nestimate: {{data: data/industrial_flow_loop.csv, {more}}}\n"
    notes = screen_of(read_scenario(text, SCENARIOS / "x.yaml")).notes
    assert any("reads and estimates its record: max_gap, columns.MODE." in note for note in notes)


def test_profiles_that_the_fields_do_not_show_are_kept():
    ramp, series = wb.Ramp(2.0, 10.0, 20.0), wb.Series([1.0, 2.5], [5.0, 600.0])
    screen = replace(
        Screen(), more_setpoint=(ramp, wb.Step(1.0, 30.0)), more_load=(series, wb.Series([0.0, 1.0]))
    ).with_entries({"experiment.load.step": "0.5", "experiment.load.at": "1", "experiment.load.at.unit": "min"})
    plan = read(screen)
    assert plan.experiment is not None
    assert plan.experiment.setpoint_parts == (wb.Step(4.0), ramp, wb.Step(1.0, 30.0))
    assert plan.experiment.load_parts == (wb.Step(0.5, 60.0), series, wb.Series([0.0, 1.0]))
    again = screen_of(plan)
    assert again.screen.more_setpoint == screen.more_setpoint
    assert again.screen.more_load == screen.more_load
    assert any("setpoint has 2 more parts" in note for note in again.notes)


def test_units_stand_as_they_were_typed():
    typed = {"loop.pv_range.low": "0", "loop.pv_range.high": "50", "loop.controller.Kc": "150"}
    typed |= {"loop.controller.Kc.unit": "PB %", "loop.controller.Ti": "2", "loop.controller.Ti.unit": "repeats/min"}
    screen = Screen().with_entries(typed)
    plan = read(screen)
    assert plan.cases[0].controller.Kc == pytest.approx(100 / 150 * 100 / 50)
    assert plan.cases[0].controller.Ti == 30.0
    assert dict(screen_of(plan).screen.entries) == dict(screen.entries)


def test_the_tuning_asked_for_is_the_scenarios():
    typed = {"tune.kind": "PID", "tune.robust": "true", "tune.constraints.max_sensitivity": "1.8", "tune.digits": "3"}
    typed |= {"tune.bounds.Td.high": "1", "tune.bounds.Td.high.unit": "min"}
    job = read(Screen().with_entries(typed), tune=True).cases[0].tune
    assert job is not None
    assert job.bounds == wb.Bounds(Td=(0.0, 60.0))
    assert job.robust is not None
    assert job.constraints == wb.Constraints(max_sensitivity=1.8)
    assert job.digits == 3
    plain_job = read(Screen(), tune=True).cases[0].tune
    assert plain_job is not None
    assert plain_job.bounds.Td == (0.0, 0.0)


ASKED = """\
title: x
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2 %}
  sample_time: 1 s
experiment: {duration: 1000 s, setpoint: {step: 4, at: 0 s}}
objective: {w1: 0.5, w3: 0.5}
cases:
  - {name: As found, Kc: 0.5, Ti: 20 s}
  - {name: Best, tune: {bounds: {Kc: [0, 10], Ti: [5 s, 600 s]}, Td: 0 s, ASKED}}
"""


def test_the_tuning_of_a_scenario_is_asked_for_as_it_stands_there():
    own = "digits: 3, restarts: 2, seed: 7, constraints: {max_sensitivity: 1.6, valve_travel: 50 %}"
    plan = read_scenario(ASKED.replace("ASKED", own), FILE)
    loaded = screen_of(plan)
    assert read(loaded.screen, tune=True).cases[0].tune == plan.cases[1].tune
    assert loaded.notes == ("Not shown, since still to be found: Best.",)


def test_what_the_page_cannot_ask_of_a_tuning_is_said():
    own = "nominal: true, objective: {iae: 1}"
    notes = screen_of(read_scenario(ASKED.replace("ASKED", own), FILE)).notes
    assert notes[0] == "Left out of the tuning that the scenario asks for: nominal. The page has no entry for it."
    assert notes[1] == "A tuning's own objective is left out here: the page has one for all."
    own = "robust: {draws: 50}, travel_budget: 80 %, constraints: {gain_margin: 2, phase_margin: 50}"
    notes = screen_of(read_scenario(ASKED.replace("ASKED", own), FILE)).notes
    assert "a gain margin, a phase margin, an ensemble of its own, a travel budget." in notes[0]


def test_an_estimate_is_asked_for_in_the_scenarios_words(tmp_path):
    time = np.arange(200.0)
    rows = np.column_stack([time, np.sin(time / 9), np.sin(time / 9 + 1)])
    np.savetxt(tmp_path / "a b.csv", rows, delimiter=",", header="t,x,y", comments="")
    screen = Screen().with_entries(
        {
            "estimate.columns.time": "t",
            "estimate.columns.PV": "x",
            "estimate.columns.OP": "y",
            "estimate.method": "joint",
        }
    )
    plan = read_scenario(estimate_text(screen, "a b.csv"), tmp_path / FILE)
    assert plan.estimates[0].method == "joint"
    record = plan.estimates[0].record
    assert record is not None
    assert record.pv[1] == pytest.approx(math.sin(1 / 9))


# nothing typed gets out of its place ---------------------------------------------------------------------------------


@given(text=st.text(max_size=60))
def test_whatever_is_typed_stays_one_scalar(text):
    tree = {"a": scalar(text), "b": words(text), "c": "1"}
    root, problems = parse(yaml_of(tree))
    if root is None:  # half of a surrogate pair, which no file can hold
        assert any("\ud800" <= c <= "\udfff" for c in text)
        return
    assert not problems
    found = plain(root)
    assert isinstance(found, dict)
    assert list(found) == ["a", "b", "c"]
    assert found["b"] == text
    if isinstance(found["a"], str):
        assert found["a"] == text


@pytest.mark.parametrize(
    "text", ["a: b", "1 # x", "{", "*x", "!!python/object", "\n  evil: 1", "null", "yes", "- a", "'", '"']
)
def test_text_for_a_number_is_refused_and_nothing_else_happens(text):
    with pytest.raises(ScenarioError) as caught:
        read(Screen().with_entries({"loop.plant.gain": text}))
    lines = str(caught.value).splitlines()
    assert all("loop.plant.gain" in line for line in lines)


def test_names_that_yaml_would_take_for_something_else_stay_names():
    names = ("true", "1e3", "null", "a: b", "<script>", "-", "Ünï", "~", "[x]", "  x ")
    cases = tuple(Pinned(name.strip(), wb.PID(1.0, 2.0)) for name in names)
    assert [case.name for case in read(replace(Screen(), cases=cases)).cases[1:]] == [name.strip() for name in names]


def test_the_pages_own_case_leaves_the_name_to_a_pinned_one():
    cases = (Pinned("On screen", wb.PID(1.0, 2.0)),)
    plan = read(replace(Screen(), cases=cases))
    assert [case.name for case in plan.cases] == ["On screen 2", "On screen"]
    assert [case.name for case in screen_of(plan).screen.cases] == ["On screen"]


# fields --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("where", "field"),
    [
        ("loop.plant.gain", "loop.plant.gain"),
        ("loop.controller.proportional_band", "loop.controller.Kc"),
        ("loop.controller.output_limits[1]", "loop.controller.output_limits.high"),
        ("loop.controller.output_limits", "loop.controller.output_limits.low"),
        ("experiment.setpoint[0].step", "experiment.setpoint.step"),
        ("cases[0].tune.bounds.Kc[1]", "tune.bounds.Kc.high"),
        ("cases[0].tune.bounds.Kc", "tune.bounds.Kc.low"),
        ("cases[0].tune.constraints.valve_travel", "tune.constraints.valve_travel"),
        ("estimate.columns.PV", "estimate.columns.PV"),
        ("loop.valve.up.S", "loop.valve.up.S"),
        ("loop.valve.places[3].d", "loop.valve.places"),
        ("loop.substep", "loop.valve.substep"),
        ("loop.output_limits", "loop.controller.output_limits.low"),
        ("loop.controller.compensator.width", "loop.controller.compensator.width"),
        ("loop.characteristic", "loop.characteristic.type"),
        ("loop.scan", "loop.scan"),
        ("nowhere.at.all", None),
    ],
)
def test_a_loaders_message_finds_its_field(where, field):
    assert field_of(where) == field


def test_a_message_about_a_hidden_field_is_told_where_that_is_shown():
    typed = {"loop.characteristic.type": "equal_percentage"}
    screen = Screen().with_entries(typed)
    with pytest.raises(ScenarioError, match="must lie within") as caught:
        read(screen)
    assert [one.field for one in problems_of(caught.value, screen.entries)] == ["loop.controller.limited"]
    limited = screen.with_entries({"loop.controller.limited": "true"})
    assert read(limited).loop is not None


LOOP_FIELDS = [
    path
    for path, field in FIELDS.items()
    if path.startswith(("loop.", "experiment.")) and field.of != "cascade" and not field.flag and not field.choices
]


@pytest.mark.parametrize("path", LOOP_FIELDS)
def test_every_field_can_be_refused_where_it_stands(path):
    """What is typed wrongly into any field of the loop or experiment is told at that field."""
    screen = Screen().with_entries({**_needed(path), path: "bad?"})
    with pytest.raises(ScenarioError) as caught:
        read(screen)
    assert path in {one.field for one in problems_of(caught.value, screen.entries)}, str(caught.value)


def _needed(path: str) -> dict[str, str]:
    """Entries without which a field takes no part."""
    group = path.rpartition(".")[0]
    beside = {"experiment.load": {"experiment.load.step": "1"}, "experiment.noise": {"experiment.noise.sd": "1"}}
    needed = dict(beside.get(group, {}))
    if path == "loop.controller.tracking_time":
        needed["loop.controller.anti_windup"] = "back_calculation"
    when = FIELDS[path].when
    while when is not None:
        needed[when[0]] = when[1][0]
        when = FIELDS[when[0]].when
    return needed


@given(x=st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_every_digit(x):
    assert float(number_text(x)) == x


def test_defaults_hold_every_field_with_its_first_unit():
    for path, field in FIELDS.items():
        assert DEFAULTS[path] == field.default
        if field.units:
            assert DEFAULTS[f"{path}.unit"] == field.units[0]
        if field.choices:
            assert field.default in dict(field.choices)
        if field.when is not None:
            assert field.when[0] in FIELDS
