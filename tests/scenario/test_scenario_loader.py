"""What a scenario becomes, and what is said, with line and column, where it is refused."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator
from itertools import islice, product
from pathlib import Path
from typing import Any

import pytest

from workbench.errors import ScenarioError
from workbench.model.controller import PID
from workbench.model.experiment import Noise, Ramp, Series, Step
from workbench.model.plant import FOPDT, Integrating
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Choudhury, Directional, He, Kano, Stenman, Valve
from workbench.scenario.document import parse, plain
from workbench.scenario.loader import load_scenario, read_scenario
from workbench.scenario.plan import Scenario
from workbench.scenario.refusals import in_entries

SCENARIOS = Path(__file__).parents[2] / "scenarios"

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


def read(text: str, folder: Path = Path()) -> Scenario:
    return read_scenario(text, folder / "loop.yaml", "loop.yaml")


def refusal(text: str, folder: Path = Path()) -> str:
    with pytest.raises(ScenarioError) as caught:
        read(text, folder)
    return str(caught.value)


# what is read ------------------------------------------------------------------------------------------------------


def test_a_scenario_becomes_the_models_values() -> None:
    plan = read(GOOD)
    assert (plan.name, plan.title) == ("loop", "A loop")
    assert plan.loop is not None
    assert plan.loop.plant == FOPDT(1.0, 5.0, 1.0)
    assert plan.loop.valve == Stenman(2.0)
    assert plan.loop.controller == PID(0.5, 20.0, derivative_filter=math.inf)
    assert plan.experiment is not None
    assert plan.experiment.setpoint_parts == (Step(4.0, 0.0),)
    assert plan.objective is None
    assert (plan.describing_function, plan.limit_cycle) == (True, True)
    assert plan.text == GOOD


@pytest.mark.parametrize(
    ("text", "valve"),
    [
        ("{type: he, fs: 13.07 %, fd: 12.19}", He(13.07, 12.19)),
        ("{type: kano, S: 3, J: 1 %}", Kano(3.0, 1.0)),
        (
            "{type: directional, up: {S: 4, J: 1}, down: {S: 3 %, J: 2}}",
            Directional(Choudhury(4.0, 1.0), Choudhury(3.0, 2.0)),
        ),
    ],
)
def test_every_valve_can_be_written(text: str, valve: Valve) -> None:
    loop = read(GOOD.replace("{type: stenman, d: 2.0}", text)).loop
    assert loop is not None
    assert loop.valve == valve


def test_units_of_control_systems_become_ours() -> None:
    text = """\
title: Units
loop:
  plant: {type: integrating, gain: 0.01}
  valve: {type: choudhury, S: 3 %, J: 1}
  sample_time: 500 ms
  pv_range: [0, 50]
  controller: {form: series, structure: "I on error, PD on PV", derivative_filter: 8, output_limits: [-40, 60]}
experiment:
  duration: 10 min
  setpoint: [{step: 1}, {ramp: -2, start: 1 min, end: 2 min}]
  load: {series: [0, 1.5], times: [0, 30 s]}
  noise: {sd: 0.1, seed: 7}
  stem_offset: 1 %
cases:
  - {name: band, proportional_band: 50 %, Ti: 0.5 repeats/min, Td: 6 s}
  - {name: ratio, Kc: 2 %/%, Ti: 2 min, derivative_on: error}
"""
    plan = read(text)
    assert plan.loop is not None
    assert plan.loop.plant == Integrating(0.01)
    assert plan.loop.valve == Choudhury(3.0, 1.0)
    assert plan.loop.sample_time == 0.5
    assert plan.experiment is not None
    assert plan.experiment.setpoint_parts == (Step(1.0, 0.0), Ramp(-2.0, 60.0, 120.0))
    assert plan.experiment.load_parts == (Series((0.0, 1.5), (0.0, 30.0)),)
    assert plan.experiment.noise == Noise(0.1, 7)
    band, ratio = (case.controller for case in plan.cases)
    # A band of 50 % is a gain of 2 in %/%; a range of 50 EU makes that 4 %/EU.
    assert band.Kc == pytest.approx(4.0)
    assert (band.Ti, band.Td, band.form, band.derivative_filter) == (120.0, 6.0, "series", 8.0)
    assert (band.derivative_on, band.setpoint_weight, band.output_limits) == ("pv", 0.0, (-40.0, 60.0))
    assert ratio.Kc == pytest.approx(4.0)
    assert (ratio.Ti, ratio.derivative_on, ratio.setpoint_weight) == (120.0, "error", 0.0)


def test_a_tuning_keeps_fixed_values_bounds_and_start() -> None:
    text = (
        GOOD
        + """\
  - name: Tuned
    note: Both.
    reference: {valve_travel: 12.18, objective: 3}
    tune: {objective: {w2: 2}, bounds: {Kc: [0.1, 3], Ti: [5 s, 10 min]}, Td: 0 s, seed: 3, digits: 3, restarts: 2}
"""
    )
    case = read(text).cases[1]
    assert case.tune is not None
    assert case.tune.bounds == Bounds(Kc=(0.1, 3.0), Ti=(5.0, 600.0), Td=(0.0, 0.0))
    assert case.tune.objective == Objective(w1=0.0, w2=2.0, w3=0.0)
    assert (case.tune.seed, case.tune.digits, case.tune.restarts) == (3, 3, 2)
    # The first case's tuning is what the tuning starts from.
    assert case.controller == PID(0.5, 20.0, 0.0, derivative_filter=math.inf)
    assert dict(case.reference) == {"valve_travel": 12.18, "objective": 3.0}


def test_without_any_tuning_the_search_starts_in_the_middle() -> None:
    text = GOOD.replace(
        "{name: Case 1, Kc: 0.5, Ti: 20 s}", "{name: T, tune: {bounds: {Kc: [1, 4], Ti: [4 s, 100 s]}}}"
    )
    start = read(text).cases[0].controller
    assert (start.Kc, start.Ti, start.Td) == (2.0, 20.0, 0.0)


def test_one_objective_of_all_tunings_is_the_scenarios() -> None:
    case = "  - {{name: {0}, tune: {{objective: {{w1: {1}, w3: 0.5}}}}}}\n"
    assert read(GOOD + case.format("a", 0.5) + case.format("b", 0.5)).objective == Objective(0.5, 0.0, 0.5, 0.0)
    assert read(GOOD + case.format("a", 0.5) + case.format("b", 0.6)).objective is None


def test_anchors_and_merges_are_read() -> None:
    text = GOOD + "  - &two {name: Case 2, Kc: 1, Ti: 30 s}\n  - {<<: *two, name: Case 3, Ti: 40 s}\n"
    third = read(text).cases[2]
    assert (third.name, third.controller.Kc, third.controller.Ti) == ("Case 3", 1.0, 40.0)


def test_yaml_numbers_are_those_of_version_1_2() -> None:
    for written, value in (("1e-3", 1e-3), ("010", 10.0), ("0x10", 16.0), ("+.5", 0.5), ("1.", 1.0)):
        plan = read(GOOD.replace("gain: 1.0", f"gain: {written}"))
        assert plan.loop is not None
        assert plan.loop.plant.gain == value
    assert "must be a number" in refusal("%YAML 1.1\n---\n" + GOOD.replace("gain: 1.0", "gain: 1_0"))
    assert "must be true or false" in refusal("%YAML 1.1\n---\n" + GOOD + "analyze: {limit_cycle: on}\n")


def test_coarse_sampling_is_refused_unless_allowed() -> None:
    coarse = GOOD.replace("time_constant: 5 s", "time_constant: 0.5 s")
    assert "loop.yaml:6:16: loop.sample_time: the sample time (1 s) is longer than the time constant" in refusal(coarse)
    plan = read(coarse.replace("sample_time: 1 s", "sample_time: 1 s\n  coarse_sampling: true"))
    assert "Coarse sampling" in plan.notes[0]
    assert "longer than the dead time (0.5 s)" in refusal(GOOD.replace("dead_time: 1 s", "dead_time: 500 ms"))


def record(folder: Path, name: str = "loop.csv", rows: int = 60) -> Path:
    lines = ["time,SP,PV,OP"] + [
        f"{2 * k},{50 + (k > 9)},{50 + 0.1 * (k % 7)},{40 + 0.3 * (k % 5)}" for k in range(rows)
    ]
    (folder / name).write_text("\n".join(lines) + "\n")
    return folder / name


DATA = """\
title: From data
loop:
  controller: {derivative_on: pv}
estimate: {data: loop.csv, reference: {d: 0.5, dead_time: 1 s}}
experiment: {duration: 100 s, setpoint: {step: 1}}
cases:
  - {name: as found, Kc: 0.5, Ti: 20 s}
"""


def test_a_scenario_may_start_from_data(tmp_path: Path) -> None:
    record(tmp_path)
    plan = read(DATA, tmp_path)
    assert plan.loop is None
    job = plan.estimates[0]
    assert job.record is not None
    assert (job.name, len(job.record), job.record.sample_time, job.record.source) == ("loop", 60, 2.0, "loop.csv")
    assert dict(job.reference) == {"d": 0.5, "dead_time": 1.0}
    # The record's sample time holds for the experiment too.
    assert "must be a whole number of samples of 2 s" in refusal(DATA.replace("100 s", "101 s"), tmp_path)


def test_a_duration_is_fitted_to_a_records_own_clock(tmp_path: Path) -> None:
    file = record(tmp_path)
    head, *rows = file.read_text().splitlines()
    # A clock that is 0.03 % slow: 100 s are 49.985 of its samples.
    slow = [f"{1.0003 * float(row.partition(',')[0])},{row.partition(',')[2]}" for row in rows]
    file.write_text("\n".join([head, *slow]) + "\n")
    plan = read(DATA, tmp_path)
    assert plan.experiment is not None
    assert plan.experiment.duration == pytest.approx(50 * 2.0006, rel=1e-9)
    assert "The experiment takes 100.03 s for the 100 s given: 50 samples of the record's 2.0006 s." in plan.notes
    assert "must be a whole number of samples of 2.0006 s" in refusal(DATA.replace("100 s", "101 s"), tmp_path)
    # A loop that is given has no clock of its own.
    assert "must be a whole number of samples of 1 s" in refusal(GOOD.replace("100 s", "100.1 s"), tmp_path)


BACK = "output_limits: [-5, 5], anti_windup: back_calculation"


@pytest.mark.parametrize(
    ("keys", "ok"),
    [
        (f"{BACK}, tracking_time: 0.5 s", False),
        (f"{BACK}, tracking_time: 0.51 s", True),
        ("tracking_time: 0.5 s", True),
        ("output_limits: [-5, 5], tracking_time: 0.5 s", True),
    ],
)
def test_back_calculation_too_fast_for_the_sample_time_is_refused(tmp_path: Path, keys: str, ok: bool) -> None:
    text = GOOD.replace("controller: {", f"controller: {{{keys}, ")
    if ok:
        assert read(text, tmp_path).loop is not None
        return
    message = refusal(text, tmp_path)
    assert "tracking_time: 0.5 s given; must be longer than half the sample time (1 s)" in message
    assert len(message.splitlines()) == 1


def test_back_calculation_is_refused_for_data_and_for_the_bounds_of_a_tuning_too(tmp_path: Path) -> None:
    record(tmp_path)
    text = DATA.replace("derivative_on: pv", f"{BACK}, tracking_time: 1 s")
    assert "tracking_time: 1 s given; must be longer than half the sample time (2 s)" in refusal(text, tmp_path)
    case = "  - {name: PI, tune: {bounds: {Ti: [1 s, 60 s]}, Td: 0 s}}\n"
    text = DATA.replace("derivative_on: pv", BACK) + case
    assert "tracking_time: 1 s (that of Ti) given; must be longer" in refusal(text, tmp_path)
    assert len(read(text.replace("[1 s, ", "[2 s, "), tmp_path).cases) == 2


def test_a_loop_given_beside_data_is_refused(tmp_path: Path) -> None:
    record(tmp_path)
    text = DATA.replace("loop:\n", "loop:\n  sample_time: 1 s\n  valve: {type: ideal}\n")
    message = refusal(text, tmp_path)
    assert "loop.yaml:3:16: loop.sample_time: given, and estimate.data as well" in message
    assert "loop.yaml:4:10: loop.valve: given, and estimate.data as well" in message


def test_data_that_cannot_be_read_is_refused_at_its_entry(tmp_path: Path) -> None:
    assert "loop.yaml:4:18: estimate.data: " in refusal(DATA, tmp_path)
    (tmp_path / "loop.csv").write_text("time,PV\n0,1\n1,2\n")
    assert "no column for OP" in refusal(DATA, tmp_path)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([f"{k},{k % 7},{k % 5}" for k in range(10)], "loop.csv: 10 samples given; at least 30 are needed to estimate"),
        ([f"{k},50,{k % 5}" for k in range(60)], "loop.csv: PV is constant (50) over all 60 samples"),
        ([f"{k},{k % 7},40" for k in range(60)], "loop.csv: OP is constant (40) over all 60 samples"),
    ],
)
def test_data_that_no_estimate_can_begin_with_is_refused_at_its_entry(
    tmp_path: Path, rows: list[str], said: str
) -> None:
    (tmp_path / "loop.csv").write_text("\n".join(["time,PV,OP", *rows]) + "\n")
    (line,) = refusal(DATA, tmp_path).splitlines()
    assert line.startswith(f"loop.yaml:4:18: estimate.data: {said}")


def test_what_a_record_asks_for_is_said_as_a_scenario_says_it(tmp_path: Path) -> None:
    (tmp_path / "loop.csv").write_text("time,FLOW,OUT 1\n0,1,2\n1,2,3\n")
    assert "for example columns: {PV: name in the file}" in refusal(DATA, tmp_path)
    (tmp_path / "loop.csv").write_text("time,A.PV,B:PV,OP\n0,1,2,3\n1,2,3,4\n")
    assert "say which one, for example columns: {PV: A.PV}" in refusal(DATA, tmp_path)
    (tmp_path / "loop.csv").write_text("PV,OP\n" + "".join(f"{k % 7},{k % 5}\n" for k in range(60)))
    assert "give sample_time, such as 5 s, or the column, columns: {time: name}" in refusal(DATA, tmp_path)
    assert in_entries("x tags={'PV': 'F: 1', 'OP': \"a'b\", 'SP': 'no'}") == (
        """x tags: {PV: "F: 1", OP: "a'b", SP: "no"}"""
    )


@pytest.mark.parametrize("name", ["op_range", "pv_range"])
def test_a_range_the_wrong_way_round_is_refused_at_its_own_entry(tmp_path: Path, name: str) -> None:
    record(tmp_path)
    text = DATA.replace("loop.csv,", f"loop.csv, {name}: [100, 0],")
    (line,) = refusal(text, tmp_path).splitlines()
    assert line.startswith(f"loop.yaml:4:38: estimate.{name}: (100.0, 0.0) given; must be"), line


def test_a_simulated_record_of_too_few_samples_is_refused() -> None:
    text = GOOD.replace("title: A loop", "title: A\nestimate: {simulate: true}").replace("100 s", "29 s")
    assert "estimate.simulate: 29 samples are simulated; at least 30 are needed to estimate a loop" in refusal(text)
    assert read(text.replace("29 s", "30 s")).estimates


def test_a_recorded_profile_is_taken_as_deviations(tmp_path: Path) -> None:
    record(tmp_path)
    text = GOOD.replace("{step: 4, at: 0 s}", "{file: loop.csv, column: SP}")
    plan = read(text, tmp_path)
    assert plan.experiment is not None
    (series,) = plan.experiment.setpoint_parts
    assert isinstance(series, Series)
    assert (series.values[9], series.values[10]) == (0.0, 1.0)
    assert series.times is not None
    assert series.times[:3] == (0.0, 2.0, 4.0)
    assert any("as deviations from its first value" in note for note in plan.notes)
    shifted = read(text.replace("column: SP", "column: SP, resting_value: 49"), tmp_path)
    assert shifted.experiment is not None
    assert shifted.experiment.setpoint_parts[0].values[0] == 1.0  # type: ignore[union-attr]
    assert "no column 'XX'" in refusal(text.replace("column: SP", "column: XX"), tmp_path)
    (tmp_path / "loop.csv").write_text("time,SP\n0,1\n2,3\n1,4\n")
    assert "line 4" in refusal(text, tmp_path)


# which way the controller acts ---------------------------------------------------------------------------------------

NEGATIVE = GOOD.replace("gain: 1.0", "gain: -0.5")


def test_a_default_action_that_does_not_fit_the_gain_is_refused_at_the_gain() -> None:
    (line,) = refusal(NEGATIVE + "  - {name: Case 2, Kc: 0.5, Ti: 30 s}\n").splitlines()
    assert line.startswith("loop.yaml:3:30: loop.plant.gain: -0.5 given, and reverse action by default;")
    assert "needs action direct (in loop.controller)" in line
    simulated = NEGATIVE.split("cases:")[0].replace("none}", "none, Kc: 1, Ti: 20 s}") + "estimate: {simulate: true}\n"
    assert "loop.plant.gain: -0.5 given, and reverse" in refusal(simulated)


def test_a_fitting_action_is_taken_without_a_word() -> None:
    plan = read(NEGATIVE.replace("none}", "none, action: direct}"))
    assert plan.cases[0].controller.action == "direct"
    assert plan.warnings == ()
    # Without gain there is no feedback to have a wrong sign.
    assert read(NEGATIVE.replace("none}", "none, action: reverse}").replace("Kc: 0.5", "Kc: 0")).warnings == ()


def test_a_written_action_that_does_not_fit_is_a_warning_but_refused_for_a_tuning() -> None:
    wrong = GOOD.replace("none}", "none, action: direct}")
    (warning,) = read(wrong).warnings
    assert warning == (
        "Case 1: the controller acts the wrong way, so that errors grow: a plant gain of 1 needs action reverse."
    )
    text = refusal(wrong + "  - {name: T, tune: {Td: 0 s}}\n")
    assert text.startswith("loop.yaml:5:49: loop.controller.action: direct given; the controller acts the wrong way")


def test_a_missing_loop_is_called_loop() -> None:
    text = "title: T\nexperiment: {duration: 10 s}\ncases: [{name: A, Kc: 1, Ti: 5 s}]\n"
    (line,) = refusal(text).splitlines()
    assert line.startswith("loop.yaml:1:1: loop: missing; needed")


def test_the_complementarity_method_takes_so_many_samples(tmp_path: Path) -> None:
    text = GOOD.replace("title: A loop", "title: A\nestimate: {simulate: true, method: complementarity}")
    assert read(text.replace("100 s", "1500 s")).estimates[0].method == "complementarity"
    said = "estimate.method: complementarity given for 1,501 samples; at most 1,500"
    assert said in refusal(text.replace("100 s", "1501 s"))
    rows = "".join(f"{k},{k % 7},{k % 5}\n" for k in range(1501))
    (tmp_path / "loop.csv").write_text("time,PV,OP\n" + rows)
    assert said in refusal("title: A\nestimate: {data: loop.csv, method: complementarity}\n", tmp_path)


# what is refused ---------------------------------------------------------------------------------------------------

TUNED = "  - {name: T, tune: {bounds: {Kc: §[1, 3]}}}\n"

# (a part of GOOD, what stands there instead, with § where the message must point, the entry and the words it must hold)
BAD: list[tuple[str, str, str, str]] = [
    ("gain: 1.0", "gain: §0", "loop.plant.gain", "must not be 0"),
    ("gain: 1.0", "gain: §.nan", "loop.plant.gain", ".nan given; must be a finite number"),
    ("gain: 1.0", "gain: §.inf", "loop.plant.gain", "must be a finite number"),
    ("gain: 1.0", "gain: §1e999", "loop.plant.gain", "must be a finite number"),
    ("gain: 1.0", "gain: §yes", "loop.plant.gain", "yes given; must be a number"),
    ("gain: 1.0", "gain:§ ", "loop.plant.gain", "nothing given; must be a number"),
    ("gain: 1.0", "gain: §2 %", "loop.plant.gain", "must be a number"),
    ("gain: 1.0", "§gian: 1.0", "loop.plant.gian", "unknown key (did you mean gain?); allowed: type, gain,"),
    ("{type: fopdt, gain: 1.0,", "§{type: fopdt,", "loop.plant.gain", "missing"),
    ("gain: 1.0", "gain: 1.0, §gain: 2.0", "scenario", "the key gain is given twice; it stands already in line 3"),
    ("type: fopdt", "type: §foptd", "loop.plant.type", "(did you mean fopdt?); must be one of fopdt, integrating"),
    ("{type: fopdt, ", "§{", "loop.plant", "type is missing"),
    ("{type: fopdt, gain: 1.0,", "§[{type: fopdt, gain: 1.0,", "scenario", "not valid YAML"),
    (
        "time_constant: 5 s",
        "time_constant: §5",
        "loop.plant.time_constant",
        'must be a time with its unit, such as "5 s"',
    ),
    ("time_constant: 5 s", "time_constant: §-5 s", "loop.plant.time_constant", "-5 s given; must be above 0"),
    ("time_constant: 5 s", "time_constant: §5 m", "loop.plant.time_constant", "5 m given; must be a time"),
    ("dead_time: 1 s", "dead_time: §-1 s", "loop.plant.dead_time", "must be >= 0"),
    ("dead_time: 1 s", "dead_time: §1 d", "loop.plant.dead_time", "at most the experiment's duration (100 s)"),
    ("d: 2.0", "d: §-2.0", "loop.valve.d", "-2.0 given; must be >= 0"),
    ("d: 2.0", "d: §2 s", "loop.valve.d", "2 s given"),
    ("{type: stenman, d: 2.0}", "{type: he, fs: 1, fd: §2}", "loop.valve.fd", "2 % given; must be at most fs (1 %)"),
    ("{type: stenman, d: 2.0}", "{type: kano, S: 1, J: §2}", "loop.valve.J", "2 % given; must be at most S (1 %)"),
    ("d: 2.0", "d: §{x: 1}", "loop.valve.d", "a mapping given"),
    ("derivative_filter: none", "derivative_filter: §0", "loop.controller.derivative_filter", "must be above 0"),
    ("derivative_filter: none", "output_limits: §[5, 9]", "loop.controller.output_limits", "must enclose 0"),
    ("derivative_filter: none", "output_limits: §[5]", "loop.controller.output_limits", "must hold at least 2"),
    ("derivative_filter: none", "form: §pararell", "loop.controller.form", "(did you mean parallel?)"),
    (
        "derivative_filter: none",
        "structure: PID on error, derivative_on: §pv",
        "loop.controller.derivative_on",
        "given, and structure as well",
    ),
    ("100 s, setpoint", "§100 s, noise: {sd: 1}, setpoint", "experiment.duration", "whole number of samples of 3 s"),
    ("sample_time: 1 s", "§smaple_time: 1 s", "loop.smaple_time", "unknown key (did you mean sample_time?)"),
    ("duration: 100 s", "duration: §2000 h", "experiment.duration", "samples; must be at most 5,000,000"),
    (
        "duration: 100 s",
        "duration: §1 s",
        "experiment.duration",
        "1 sample; must be at most 5,000,000, and at least 10",
    ),
    ("d: 2.0", "d: §200 %", "loop.valve.d", "200 % given; must be <= 100"),
    ("d: 2.0", "d: 2,§5 %", "loop.valve.5 %", "the rest of a number? decimals are written with a point, such as 2.5"),
    ("d: 2.0", 'd: §"2,5"', "loop.valve.d", "decimals are written with a point, such as 2.5"),
    ("d: 2.0", "§d:2.0", "loop.valve.d:2.0", "unknown key (a space must follow the colon)"),
    ("gain: 1.0", "gain: §1.0 EU/%", "loop.plant.gain", "1.0 EU/% given; must be a number, without a unit"),
    ("duration: 100 s", 'duration: §"99,5 s"', "experiment.duration", "decimals are written with a point, such as 2.5"),
    ("{step: 4", "§{stp: 4", "experiment.setpoint", "holds none of step, ramp, series, file (did you mean step?)"),
    ("{step: 4, at: 0 s}", "[{step: 4}, §4]", "experiment.setpoint[1]", "4 given; must be a mapping"),
    ("step: 4", "step: §4 %", "experiment.setpoint.step", "4 % given; a setpoint is a number in EU"),
    ("at: 0 s", "at: §101 s", "experiment.setpoint.at", "must be within the experiment's duration (100 s)"),
    ("{step: 4, at: 0 s}", "{series: §[]}", "experiment.setpoint.series", "must hold at least 1"),
    ("{step: 4, at: 0 s}", "{series: [1, §a]}", "experiment.setpoint.series[1]", "a given; must be a number"),
    ("{step: 4, at: 0 s}", "{series: [1, 2], times: §[1 s]}", "experiment.setpoint.times", "1 times given"),
    ("{step: 4, at: 0 s}", "{ramp: 1, start: 5 s, end: §5 s}", "experiment.setpoint.end", "must be after the start"),
    ("100 s,", "100 s, stem_offset: §2.5,", "experiment.stem_offset", "must be at most 2 % in size"),
    ("100 s,", "100 s, noise: {sd: §-1},", "experiment.noise.sd", "must be >= 0"),
    ("100 s,", "100 s, noise: {sd: 1, seed: §1.5},", "experiment.noise.seed", "must be a whole number"),
    ("experiment: {duration: 100 s, setpoint: {step: 4, at: 0 s}}\n", "", "experiment", "missing; needed to simulate"),
    ("experiment:", "§experimnt:", "experimnt", "unknown key (did you mean experiment?)"),
    ("Kc: 0.5", "Kc: §-0.5", "cases[0].Kc", "must be a finite number >= 0"),
    ("Kc: 0.5", "Kc: §2 %/%", "cases[0].Kc", "needs loop.pv_range"),
    ("Kc: 0.5", "proportional_band: §0 %", "cases[0].proportional_band", "needs loop.pv_range"),
    ("{name: Case 1, Kc: 0.5, ", "§{name: Case 1, ", "cases[0].Kc", "missing; give it here or in loop.controller"),
    ("Ti: 20 s", "Ti: §20", "cases[0].Ti", '20 given; must be a time with its unit, such as "20 s"'),
    ("Ti: 20 s", "Ti: §0 s", "cases[0].Ti", "must be above 0"),
    ("name: Case 1", "name: §' '", "cases[0].name", "must not be blank"),
    ("name: Case 1", "name: §1", "cases[0].name", "must be text"),
    ("Kc: 0.5", "reference: {§valve_travle: 1}, Kc: 0.5", "cases[0].reference.valve_travle", "mean valve_travel?)"),
    ("Kc: 0.5", "tune: {}, §Kc: 0.5", "cases[0].Kc", "unknown key (write it inside tune)"),
    ("Kc: 0.5", "§Kp: 0.5", "cases[0].Kp", "unknown key (did you mean Kc?)"),
    ("Ti: 20 s", "§Ki: 0.1", "cases[0].Ki", "unknown key (did you mean Ti, Kc/Ki, in parallel form 1/Ki?)"),
    ("Ti: 20 s", "Ti: 20 s, §Kd: 1", "cases[0].Kd", "unknown key (did you mean Td, Kd/Kc, in parallel form Kd?)"),
    ("Kc: 0.5", "§PB: 200 %", "cases[0].PB", "unknown key (did you mean proportional_band?)"),
    ("dead_time: 1 s", "§delay: 1 s", "loop.plant.delay", "unknown key (did you mean dead_time?)"),
    ("setpoint: {", "§sp: {", "experiment.sp", "unknown key (did you mean setpoint?)"),
    ("derivative_filter: none", "form: §ISA", "loop.controller.form", "ISA given (did you mean ideal?)"),
    ("derivative_filter: none", "form: §interacting", "loop.controller.form", "(did you mean series?)"),
    ("Ti: 20 s", "Ti: §.inf", "cases[0].Ti", "or none; and be finite"),
    ("title: A loop", "title: §[A, loop]", "title", "a list of 2 given; must be text"),
    ("title: A loop\nloop", "§loop", "title", "missing"),
    ("title: A loop", "title: A loop\nobjective: §{w1: 0}", "objective", "at least one of w1, w2, w3, w4"),
    ("title: A loop", "title: A loop\nanalyze: {limit_cycle: §on}", "analyze.limit_cycle", "on given; must be true or"),
    ("title: A loop", "title: §!!str A loop", "scenario", "tags are not allowed"),
    ("title: A loop", "title: §*loop", "scenario", "*loop refers to no value above it"),
    ("title: A loop", "title: A loop\n? §[a, b]\n: c", "scenario", "keys are plain names"),
    ("title: A loop", 'title: §"\\ud800"', "scenario", "half of a character"),
    ("title: A loop", "title: A loop\nestimate: §{simulate: false}", "estimate", "must hold either data"),
    ("title: A loop", "title: A\nestimate: {simulate: true, start: §2}", "estimate.start", "only the two_step method"),
    (
        "title: A loop",
        "title: A\nestimate: {simulate: true, method: two_step, valve: §linear}",
        "estimate.valve",
        "method two_step knows stenman alone",
    ),
    (
        "title: A loop",
        "title: A\nestimate: {simulate: true, method: complementarity, valve: §deadband}",
        "estimate.valve",
        "deadband given; method complementarity knows stenman alone",
    ),
    ("cases:\n", "cases:\n" + TUNED.replace("[1, 3]", "[3, 1]"), "cases[0].tune.bounds.Kc", "low <= high"),
    (
        "- {name",
        "- {name: Case 1, Kc: 1, Ti: 9 s}\n  - {name: §Case 1, note: x}\n  - {name",
        "cases[1].name",
        "has this name already",
    ),
]


@pytest.mark.parametrize(("old", "new", "where", "words"), BAD, ids=[f"{new[:40]}" for _, new, _, _ in BAD])
def test_refusals_say_where_and_what(old: str, new: str, where: str, words: str) -> None:
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    if "samples of 3 s" in words:
        text = text.replace("sample_time: 1 s", "sample_time: 3 s")
    before, mark, _ = text.partition("§")
    lines = refusal(text.replace("§", "")).splitlines()
    place = f"{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}" if mark and "YAML" not in words else ""
    assert any(line.startswith(f"loop.yaml:{place}") and f": {where}: " in line and words in line for line in lines), (
        lines
    )


@pytest.mark.parametrize("swapped", [False, True])
def test_bounds_of_what_falls_where_ti_and_kc_rise_may_be_written_either_way(swapped: bool) -> None:
    ends = [["20 %", "400 %"], ["1 repeats/min", "20 repeats/min"]]
    band, rate = (", ".join(reversed(pair) if swapped else pair) for pair in ends)
    case = f"  - {{name: T, tune: {{bounds: {{proportional_band: [{band}], Ti: [{rate}]}}, Td: 0 s}}}}\n"
    text = GOOD.replace("  sample_time: 1 s\n", "  sample_time: 1 s\n  pv_range: [0, 50]\n")
    plan = read(f"{text}{case}analyze: {{map: {{Ti: [{rate}]}}}}\n")
    assert plan.cases[1].tune is not None
    assert plan.cases[1].tune.bounds == Bounds((0.5, 10.0), (3.0, 60.0), (0.0, 0.0))
    assert plan.cycle_map is not None
    assert plan.cycle_map.Ti == (3.0, 60.0)
    assert "bounds.Ti: (600.0, 5.0) given; must be a pair" in refusal(text + case.replace(rate, "600 s, 5 s"))


def test_bounds_that_exclude_the_start_are_refused() -> None:
    message = refusal(GOOD + TUNED.replace("§", ""))
    assert message.startswith("loop.yaml:10:35: cases[1].tune.bounds.Kc: [1, 3] excludes the start, Kc = 0.5 (Case 1)")
    assert "tune.start" in message
    plan = read(GOOD + TUNED.replace("§", "").replace("{bounds", "{start: {Kc: 2, Ti: 20 s}, bounds"))
    assert plan.cases[1].controller.Kc == 2.0
    # A gain that is refused is no start of which to say anything.
    message = refusal(GOOD.replace("Kc: 0.5", "Kc: -0.5") + TUNED.replace("§", ""))
    assert ".Kc: -0.5 given" in message
    assert "excludes" not in message
    # A parameter that is held need not contain the start.
    assert read(GOOD + "  - {name: T, tune: {Kc: 3}}\n").cases[1].controller.Kc == 3.0


def test_all_problems_of_a_file_are_told_at_once_in_its_order() -> None:
    text = GOOD.replace("gain: 1.0", "gain: x").replace("d: 2.0", "d: -1").replace("20 s}", "20}")
    lines = refusal(text).splitlines()
    assert [line.split(": ")[0] for line in lines] == ["loop.yaml:3:30", "loop.yaml:4:29", "loop.yaml:9:33"]


def test_what_a_case_inherits_is_refused_where_it_is_written() -> None:
    text = GOOD.replace("derivative_filter: none", "output_limits: [1, 2]") + "  - {name: b, Kc: 1, Ti: 2 s}\n"
    assert [line.split(": ")[1] for line in refusal(text).splitlines()] == ["loop.controller.output_limits"]


def test_parallel_controllers_that_cannot_be_simulated_are_refused() -> None:
    assert "cases[0].Kc" in refusal(GOOD.replace("Kc: 0.5", "form: parallel, Kc: 0"))


# files that are no scenarios -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "bad.yaml:1:1: scenario: the file is empty"),
        (b"# nothing\n", "bad.yaml:1:1: scenario: the file is empty"),
        (b"- 1\n- 2\n", "bad.yaml:1:1: scenario: a list of 2 given; must be a mapping"),
        (b"just text\n", "must be a mapping"),
        (b"title: \xff\n", "bad.yaml:1:8: scenario: byte 0xff is no UTF-8"),
        (b"title: a\x00b\n", "bad.yaml:1:9: scenario: the character \\x00 is not allowed"),
        (b"title: a\n---\ntitle: b\n", "bad.yaml:2:1: scenario: a second document begins"),
        (b"a: " + b"[" * 200 + b"]" * 200, "nested more than"),
        (b"[" * 100_000, "nested more than"),
        (b"{a: " * 5_000, "nested more than"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "no UTF-8"),
    ],
    ids=range(11),
)
def test_files_that_hold_no_scenario(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_bytes(content)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(file)
    assert words in str(caught.value)


def test_a_dead_time_of_too_many_samples_is_refused_at_its_line_with_all_else(tmp_path: Path) -> None:
    file = tmp_path / "fine.yaml"
    file.write_text(
        GOOD.replace("dead_time: 1 s", "dead_time: 90 s").replace("sample_time: 1 s", "sample_time: 0.01 ms")
    )
    with pytest.raises(ScenarioError) as caught:
        load_scenario(file)
    assert "fine.yaml:" in str(caught.value)
    assert "90 s given; must be at most 1,000,000 samples of 1e-05 s" in str(caught.value)


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    file = tmp_path / "loop.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert load_scenario(file).title == "A loop"


def test_aliases_that_multiply_are_refused() -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 9)]
    assert "values once its aliases are written out" in refusal("\n".join(lines))


def test_an_alias_within_its_own_anchor_is_refused() -> None:
    assert "*a refers to no value above it" in refusal("title: &a [*a]\n")


def test_folders_missing_and_huge_files_are_refused_before_they_are_read(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="is a directory"):
        load_scenario(tmp_path)
    with pytest.raises(ScenarioError, match="no such file"):
        load_scenario(tmp_path / "none.yaml")
    with pytest.raises(ScenarioError, match="cannot be read"):
        load_scenario("a\0b.yaml")
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as file:
        file.truncate(2 << 30)
    with pytest.raises(ScenarioError, match=r"2048\.0 MiB given; a scenario file is at most 1 MiB"):
        load_scenario(huge)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.yaml")
        with pytest.raises(ScenarioError, match="no regular file"):
            load_scenario(tmp_path / "pipe.yaml")


# Manifests of loops, fleet_*.yaml, are read by tests/fleet.
@pytest.mark.parametrize("file", sorted(SCENARIOS.glob("[!f]*.yaml")), ids=lambda p: p.stem)
def test_the_shipped_scenarios_load(file: Path) -> None:
    plan = load_scenario(file)
    assert plan.text.startswith("# yaml-language-server: $schema=../workbench/scenario/schema.json\n")
    assert plan.description


# all at once -------------------------------------------------------------------------------------------------------

MANY = """\
title: Many
loop:
  plant: {type: fopdt, gain: x, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2 %}
  controller: {form: ideal}
  sample_time: 1 s
experiment: {duration: 1000 s, setpoint: {step: 4, at: 5000 s}}
cases:
  - {name: A, Kc: 0.5, Ti: 20 s}
  - {name: A, Kc: 0.5, Ti: 20 s}
  - {name: B, rule: {name: detuned_integral, base: Z, factor: 10}}
analyze: {map: {Kc: [5, 0.1]}, repair: maybe}
site: {gain: proportional_band}
"""


def test_what_the_schema_refuses_hides_no_other_mistake() -> None:
    lines = [line.split(" given")[0] for line in refusal(MANY).splitlines()]
    assert lines == [
        "loop.yaml:3:30: loop.plant.gain: x",
        "loop.yaml:7:56: experiment.setpoint.at: 5000 s",
        "loop.yaml:10:12: cases[1].name: 'A'",
        "loop.yaml:11:52: cases[2].rule.base: 'Z'",
        "loop.yaml:12:21: analyze.map.Kc: (5.0, 0.1)",
        "loop.yaml:12:40: analyze.repair: maybe",
        "loop.yaml:13:14: site.gain: proportional_band",
    ]


def test_a_cascade_is_read_to_its_end_as_well() -> None:
    text = """\
title: Cascade
cascade:
  primary: {plant: {type: fopdt, gain: 1, time_constant: 60 s}, controller: {Kc: x, Ti: 80 s}, sample_time: 5 s}
  secondary:
    plant: {type: fopdt, gain: 1, time_constant: 3 s}
    valve: {type: stenmann, d: 1}
    controller: {Kc: 0.5, Ti: 5 s}
    sample_time: 1 s
experiment: {duration: 100 s, setpoint: {step: 1, at: 500 s}}
cases: [{name: A}, {name: A}]
site: {gain: proportional_band}
"""
    places = [line.split(": ")[1] for line in refusal(text).splitlines()]
    assert places == [
        "cascade.primary.controller.Kc",
        "cascade.secondary.valve.type",
        "experiment.setpoint.at",
        "cases[1].name",
        "site.gain",
    ]


def test_what_suits_a_choice_that_was_misspelt_is_no_mistake_of_its_own() -> None:
    # Of all methods the one that was meant takes a start.
    text = MANY[: MANY.index("cases")].replace("gain: x", "gain: 2").replace("{form: ideal}", "{Kc: 1, Ti: 9 s}")
    lines = refusal(
        text.replace("5000", "10") + "estimate: {simulate: true, method: two_stpe, start: 2}\n"
    ).splitlines()
    assert [line.split(" given")[0] for line in lines] == ["loop.yaml:8:36: estimate.method: two_stpe"]


def _places(data: object, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    pairs = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for name, value in pairs:
        yield (*path, name)
        yield from _places(value, (*path, name))


@pytest.mark.parametrize("name", ["table_2", "cascade", "identify_benchmark"])
def test_one_mistake_is_not_told_as_several(name: str) -> None:
    path = SCENARIOS / f"{name}.yaml"
    root, _ = parse(path.read_text(encoding="utf-8"))
    assert root is not None
    changes = product(_places(plain(root)), ("odd", "text", "renamed"))
    for place, change in islice(changes, None, None, 11):
        data: Any = plain(root)
        holder = data
        for element in place[:-1]:
            holder = holder[element]
        if change != "renamed":
            holder[place[-1]] = {"what": 1} if change == "odd" else "@@"
        elif isinstance(holder, dict):
            holder[f"x{place[-1]}"] = holder.pop(place[-1])
        with contextlib.suppress(ScenarioError):
            read_scenario(json.dumps(data), path)
            continue
        with pytest.MonkeyPatch.context() as without:
            told = _lines(data, path)
            without.setattr("workbench.scenario.loader.independent", lambda *_: [])
            assert told == _lines(data, path), place


def _lines(data: object, path: Path) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        read_scenario(json.dumps(data), path)
    return str(caught.value).splitlines()
