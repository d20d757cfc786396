"""Running a scenario: what a study holds, in which order, and what is said when it cannot be carried out."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import workbench as wb
from workbench.errors import ScenarioError
from workbench.model.results import Estimate, SolveStatus
from workbench.scenario import retune, runner
from workbench.scenario.loader import read_scenario
from workbench.scenario.retune import Wishes, tune_found, tune_scenario
from workbench.scenario.runner import for_plant, run_scenario, simulated_record
from workbench.tune import repair

LOOP = """\
title: A short run
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2.0}
  controller: {derivative_filter: none}
  sample_time: 1 s
experiment: {duration: 150 s, setpoint: {step: 4, at: 0 s}}
"""
CASES = """\
cases:
  - {name: Case 1, Kc: 0.5, Ti: 20 s, reference: {valve_travel: 12.18}, note: base}
  - {name: PI, tune: {bounds: {Kc: [0, 10], Ti: [5 s, 600 s]}, Td: 0 s, restarts: 1, digits: 2}}
"""


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tune for a found loop in one search: for what is asked of it and told of it."""
    true_tune = retune.tune_case
    monkeypatch.setattr(
        retune,
        "tune_case",
        lambda loop, task, job, told: true_tune(loop, task, replace(job, restarts=1, digits=2), told),
    )


@cache
def found_loop() -> Estimate:
    loop = wb.Loop(wb.FOPDT(1.0, 6.0, 2.0), wb.Stenman(1.0), wb.PID(0.6, 15.0), 1.0)
    return wb.estimate(simulated_record(loop, wb.Experiment(600.0, (wb.Step(2.0), wb.Step(1.5, 300.0)))))


def plan(text: str):
    return read_scenario(text, Path("short.yaml"))


def test_cases_are_simulated_tuned_and_analysed() -> None:
    told: list[tuple[str, float]] = []
    study = run_scenario(
        plan(LOOP + "objective: {w1: 0.5, w3: 0.5}\n" + CASES),
        progress=lambda words, share: told.append((words, share)),
    )
    given, tuned = study.cases
    assert (study.name, study.title, study.estimates) == ("short", "A short run", ())
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0, derivative_filter=np.inf), 1.0)
    experiment = wb.Experiment(150.0, wb.Step(4.0))
    np.testing.assert_array_equal(given.run.pv, wb.simulate(loop, experiment).pv)
    weights = wb.Objective()
    assert given.objective == wb.evaluate(loop, experiment, weights)[0]
    assert given.tuned is None
    assert dict(given.reference) == {"valve_travel": 12.18}
    assert given.note == "base"
    assert tuned.tuned is not None
    assert tuned.tuned.status is SolveStatus.SOLVED
    assert tuned.objective == pytest.approx(tuned.tuned.objective, rel=1e-12)
    assert tuned.objective < given.objective
    # The tuning found is the one that is simulated and analysed.
    assert tuned.loop.controller == tuned.tuned.controller == tuned.run.loop.controller
    assert tuned.loop.controller.Td == 0.0
    for case in study.cases:
        assert case.describing_function is not None
        assert case.limit_cycle is not None
        assert case.agreement
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert told[-1] == ("done", 1.0)
    assert any("tune PI" in words for words, _ in told)
    assert set(study.times) == {"Case 1", "tune PI", "PI"}


def test_analyses_that_are_not_asked_for_are_left_out() -> None:
    text = LOOP + CASES.split("  - {name: PI")[0] + "analyze: {describing_function: false, limit_cycle: false}\n"
    (case,) = run_scenario(plan(text)).cases
    assert (case.describing_function, case.limit_cycle, case.agreement, case.objective) == (None, None, "", None)


def test_a_record_simulated_from_the_loop_is_estimated_against_the_truth() -> None:
    text = (
        LOOP.replace("{derivative_filter: none}", "{Kc: 0.5, Ti: 20 s}")
        .replace("150 s", "1000 s")
        .replace("gain: 1", "gain: 2")
    )
    study = run_scenario(plan(text + "estimate: {name: again, simulate: true, reference: {d: 1.99}}\n"))
    (named,) = study.estimates
    assert (named.name, study.cases, dict(named.reference)) == ("again", (), {"d": 1.99})
    assert named.truth is not None
    assert named.found.verdict == "stiction"
    assert isinstance(named.found.valve, wb.Stenman)
    assert named.found.valve.d == pytest.approx(2.0, rel=0.01)
    # The estimator does not see where the stem was.
    assert named.found.record.valve_position is None


def recorded(folder: Path, seconds: float = 900.0) -> Path:
    loop = wb.Loop(wb.FOPDT(1.0, 6.0, 2.0), wb.Stenman(1.0), wb.PID(0.6, 15.0), 1.0)
    record = simulated_record(
        loop, wb.Experiment(seconds, (wb.Step(2.0), wb.Step(1.5, 300.0)), noise=wb.Noise(0.02, 3))
    )
    rows = np.column_stack([record.time, record.sp, record.pv, record.op])
    file = folder / "loop.csv"
    np.savetxt(file, rows, delimiter=",", header="time,SP,PV,OP", comments="")
    return file


def test_the_loop_of_the_cases_is_the_one_that_the_record_shows(tmp_path: Path) -> None:
    recorded(tmp_path)
    text = """\
title: From data
estimate: {data: loop.csv}
experiment: {duration: 100 s, setpoint: {step: 1}}
cases: [{name: as found, Kc: 0.6, Ti: 15 s}]
analyze: {limit_cycle: false}
"""
    study = run_scenario(read_scenario(text, tmp_path / "data.yaml"))
    found = study.estimates[0].found
    assert study.estimates[0].truth is None
    loop = study.cases[0].loop
    assert (loop.plant, loop.valve, loop.sample_time) == (found.plant, found.valve, 1.0)
    assert loop.controller == wb.PID(0.6, 15.0)
    assert study.experiment == wb.Experiment(100.0, wb.Step(1.0))


def test_what_only_running_shows_is_refused_with_its_entry(tmp_path: Path) -> None:
    """A loop at rest, whose PV never moves."""
    loop = "loop: {plant: {type: fopdt, gain: 1, time_constant: 5 s}, valve: {type: ideal}, sample_time: 1 s,"
    text = f"title: Flat\nestimate:\n  - {{simulate: true}}\n{loop} controller: {{Kc: 1, Ti: 5 s}}}}\n"
    text += "experiment: {duration: 100 s, setpoint: {step: 1, at: 100 s}}\n"
    with pytest.raises(ScenarioError, match=r"flat\.yaml:3:5: estimate\[0\]: .*: PV is constant"):
        run_scenario(read_scenario(text, tmp_path / "flat.yaml"))


def test_an_unstable_case_is_a_result() -> None:
    text = LOOP.replace("150 s", "3000 s") + "objective: {w1: 1}\ncases: [{name: wild, Kc: 50, Ti: 5 s}]\n"
    (case,) = run_scenario(plan(text)).cases
    assert case.objective == np.inf
    assert case.limit_cycle is not None


def test_an_interrupted_tuning_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    true_tune = runner.tune
    monkeypatch.setattr(runner, "tune", lambda *a, **k: replace(true_tune(*a, **k), status=SolveStatus.INTERRUPTED))
    with pytest.raises(KeyboardInterrupt):
        run_scenario(plan(LOOP + CASES))


def test_retuning_stops_at_an_interrupted_tuning(monkeypatch: pytest.MonkeyPatch) -> None:
    true_tune = runner.tune
    monkeypatch.setattr(runner, "tune", lambda *a, **k: replace(true_tune(*a, **k), status=SolveStatus.INTERRUPTED))
    found = tune_scenario(plan(LOOP + CASES + CASES.split("\n")[2].replace("PI", "Second") + "\n"), Wishes())
    assert [one.name for one in found] == ["PI"]


def test_the_value_of_repair_stops_at_an_interrupted_tuning(monkeypatch: pytest.MonkeyPatch) -> None:
    true_tune = repair.tune
    calls: list[object] = []

    def interrupted(*given: object, **named: object) -> object:
        calls.append(given)
        return replace(true_tune(*given, **named), status=SolveStatus.INTERRUPTED)

    monkeypatch.setattr(repair, "tune", interrupted)
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
    with pytest.raises(KeyboardInterrupt):
        wb.value_of_repair(loop, wb.Experiment(60.0, wb.Step(4.0)), restarts=1, digits=2)
    assert len(calls) == 1


def test_estimates_from_one_record_share_its_evidence() -> None:
    text = LOOP.replace("{derivative_filter: none}", "{Kc: 0.5, Ti: 20 s}").replace("150 s", "400 s")
    told = "simulate: true, plant: fopdt, valve: stenman"
    text += f"estimate:\n  - {{name: a, {told}}}\n  - {{name: b, {told}, method: two_step, start: 1.9}}\n"
    text += f"  - {{name: c, {told}, noise: {{sd: 0.1, seed: 1}}}}\n"
    first, again, noisy = (named.detection for named in run_scenario(plan(text)).estimates)
    assert first is not None
    assert noisy is not None
    assert again is first
    assert noisy is not first
    assert first.bicoherence is not None
    assert wb.detect(noisy.record, bicoherence=True).statistics == noisy.statistics


def test_an_estimated_negative_gain_makes_the_action_direct_where_none_is_given() -> None:
    jobs = plan(LOOP + CASES).cases
    assert not any(job.action_given for job in jobs)
    plant = wb.FOPDT(-2.0, 5.0, 1.0)
    fitted, notes, wrong = for_plant(jobs, plant)
    assert [job.controller.action for job in fitted] == ["direct", "direct"]
    assert notes == ["The controller acts direct, as the estimated gain (−2) needs; no action is given."]
    assert wrong == []
    given = plan(LOOP.replace("none}", "none, action: reverse}") + CASES).cases
    kept, notes, said = for_plant(given, plant)
    assert notes == []
    assert [job.controller.action for job in kept] == ["reverse", "reverse"]
    assert said[0].startswith("Case 1: the controller acts the wrong way")
    assert for_plant(given, wb.FOPDT(2.0, 5.0, 1.0)) == (given, [], [])


@pytest.mark.parametrize(
    ("plant", "Kc", "Ti"), [(wb.FOPDT(-2.0, 2.0, 60.0), 0.9, 2.0), (wb.FOPDT(0.5, 0.4, 0.0), 3.0, 1)]
)
@pytest.mark.usefixtures("quick")
def test_the_bounds_for_a_found_loop_hold_what_dead_time_needs(plant: wb.FOPDT, Kc: float, Ti: float) -> None:
    found = replace(found_loop(), plant=plant)
    result = tune_found(found, Wishes(duration=100.0, step=1.0, Kc=None, seed=0))
    bounds = result.tuned.bounds
    assert bounds.Kc[1] >= Kc
    assert bounds.Ti[0] <= Ti
    assert any("coarse sampling" in words for words in result.assumed) == (plant.time_constant < 1.0)


def test_a_scenario_is_retuned_under_other_wishes() -> None:
    (one,) = tune_scenario(plan(LOOP + CASES), Wishes(Kc=(0.1, 0.3), seed=4))
    assert one.name == "PI"
    assert 0.1 <= one.tuned.controller.Kc <= 0.3
    assert (one.tuned.seed, one.tuned.digits) == (4, 2)
    with pytest.raises(wb.InvalidValue, match="--step"):
        tune_scenario(plan(LOOP + CASES), Wishes(step=1.0))
    with pytest.raises(wb.InvalidValue, match=r"--max-sensitivity: 1\.4 given; is for a record; a scenario states its"):
        tune_scenario(plan(LOOP + CASES), Wishes(max_sensitivity=1.4))
    with pytest.raises(wb.InvalidValue, match="needs both"):
        tune_scenario(replace(plan(LOOP + CASES), cases=()), Wishes())


@pytest.mark.usefixtures("quick")
def test_a_found_loop_is_tuned_and_what_was_assumed_is_said() -> None:
    found = found_loop()
    result = tune_found(found, Wishes(duration=100.0, step=2.0))
    tuned = result.tuned
    assert tuned.status.success
    assert tuned.controller.Td == 0.0
    assert tuned.loop.plant == found.plant
    assert tuned.experiment.duration == 100.0
    assert tuned.objective <= tuned.start_objective
    assert result.assumed[0] == "the record's loop: the valve sticks"
    assert "setpoint step of 2 EU" in result.assumed[1]


@pytest.mark.usefixtures("quick")
def test_a_found_loop_is_tuned_to_hold_without_its_stiction() -> None:
    # Much dead time, and a valve that hardly lands where it is sent: the least J has a loop near instability without.
    found = replace(found_loop(), plant=wb.FOPDT(2.3, 1.2, 3.4), valve=wb.Choudhury(4.0, 1.0))
    wishes = Wishes(duration=100.0)
    safe = tune_found(found, wishes)
    assert safe.standing is not None
    assert safe.standing.own.max_sensitivity <= retune.SAFE
    assert "maximum sensitivity 2 at most, with an ideal valve" in safe.assumed
    # Where the bounds hold no such tuning they go before.
    forced = tune_found(found, replace(wishes, Kc=(0.5, 0.5)))
    assert forced.tuned.controller.Kc == 0.5
    assert forced.tuned.status.success
    assert forced.assumed[3] == "no maximum sensitivity, as none within the bounds keeps one of 2 with an ideal valve"
    assert "the loop with an ideal valve is" in forced.assumed[0]
    least = tune_found(found, replace(wishes, max_sensitivity=math.inf))
    assert "no maximum sensitivity" in least.assumed
    assert least.standing is not None
    assert least.standing.own.max_sensitivity > 5.0


def test_a_found_loop_without_a_task_or_a_gain_is_refused() -> None:
    found = found_loop()
    with pytest.raises(wb.InvalidValue, match="--step: 0 EU given; must be other than 0"):
        Wishes(step=0.0)
    with pytest.raises(wb.InvalidValue, match=r"--max-sensitivity: 0\.9 given; must be > 1, or none"):
        Wishes(max_sensitivity=0.9)
    unsure = replace(found, intervals=replace(found.intervals, gain=(-0.01, 0.2)))
    with pytest.raises(wb.RecordError, match=r"positive or negative \(95 % range −0.0100 to 0.200 EU/%"):
        tune_found(unsure, Wishes())
    with pytest.raises(wb.InvalidValue, match="--action: direct given; the controller acts the wrong way"):
        tune_found(found, Wishes(action="direct"))
    # What a fit without any effect of the valve leaves as a gain is no finding.
    blind = replace(found, plant=wb.FOPDT(1e-12, 6.0, 2.0), intervals=replace(found.intervals, gain=None))
    with pytest.raises(wb.RecordError, match="shows no effect of the valve on PV"):
        tune_found(blind, Wishes())
    with pytest.raises(wb.InvalidValue, match=r"Experiment\.duration"):
        tune_found(found, Wishes(duration=0.0))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        (
            {"gain": (0.8, math.inf), "time_constant": (5.0, math.inf)},
            "leaves the range of the gain K and time constant",
        ),
        ({"gain": None, "dead_time": None}, "gives no range for the gain K and dead time"),
    ],
)
def test_a_found_loop_that_the_record_leaves_open_is_tuned_as_a_hint(changes: dict[str, Any], why: str) -> None:
    wishes = Wishes(duration=100.0, step=2.0, Kc=(0.5, 0.5), Ti=(15.0, 15.0))
    found = found_loop()
    found = replace(found, intervals=replace(found.intervals, **changes))
    said = tune_found(found, wishes).assumed[0]
    assert said.startswith(f"the record's loop: the valve sticks; the record {why}")
    assert said.endswith(", so take this tuning as a hint")
    # Nor is one that its own ranges upset more than a hint.
    wide = found_loop()
    wide = replace(wide, intervals=replace(wide.intervals, gain=(0.9, 30.0)))
    said = tune_found(wide, wishes).assumed[0]
    assert said.endswith("with an ideal valve is unstable, so take this tuning as a hint")
    assert "with gain 30.0 EU/%, within the plant's 95 % range, the loop" in said
    unsure = tune_found(replace(found, verdict="undecided", identifiable=False), wishes)
    assert unsure.assumed[0].startswith("the record's loop: whether the valve sticks is undecided and the record ")


def test_a_found_loop_is_tuned_over_whole_samples_of_its_record() -> None:
    found = found_loop()
    slow = replace(found, record=replace(found.record, sample_time=1.0003))
    result = tune_found(slow, Wishes(duration=100.0, step=2.0, seed=0, Kc=(0.5, 0.5), Ti=(15.0, 15.0)))
    assert result.tuned.experiment.duration == pytest.approx(100 * 1.0003, rel=1e-12)
    assert "over 100.03 s" in result.assumed[1]
