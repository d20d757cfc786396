"""Cascades in scenarios: read, refused at their place, run, and told in results and report."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

import workbench as wb
from workbench.report.page import write_report
from workbench.report.results import results_content
from workbench.scenario import cascade_runner
from workbench.scenario.loader import read_scenario

TEXT = """\
title: Cascade
cascade:
  primary:
    plant: {type: fopdt, gain: 1.2, time_constant: 60 s, dead_time: 10 s}
    controller: {Kc: 1.5, Ti: 80 s}
    sample_time: 5 s
  secondary:
    plant: {type: fopdt, gain: 1.0, time_constant: 3 s, dead_time: 1 s}
    valve: {type: stenman, d: 1 %}
    controller: {Kc: 0.5, Ti: 5 s, output_limits: [-10, 10]}
    sample_time: 1 s
  anti_windup: none
experiment:
  duration: 600 s
  setpoint: {step: 5, at: 0 s}
  primary_load: {step: 1, at: 300 s}
  secondary_noise: {sd: 0.01, seed: 3}
objective: {w1: 0.5}
cases:
  - {name: as found}
  - {name: calmer, primary: {Kc: 0.8}}
  - {name: other, secondary: {Ti: 9 s, output_limits: null}, note: slower}
"""
TUNE = """\
  - name: tuned
    tune_cascade:
      primary: {bounds: {Kc: [0.5, 4], Ti: [40 s, 200 s]}, Td: 0 s}
      secondary:
        bounds: {Kc: [0.1, 1], Ti: [2 s, 30 s]}
        Td: 0 s
        experiment: {duration: 100 s, setpoint: {step: 1, at: 0 s}}
      restarts: 1
"""


def read(text):
    return read_scenario(text, Path("cascade.yaml"))


def test_a_cascade_is_read_with_what_its_cases_change():
    plan = read(TEXT + TUNE)
    found, calmer, other, tuned = plan.cascade
    assert plan.cases == ()
    assert found.cascade.anti_windup == "none"
    assert found.cascade.every == 5
    assert found.cascade.secondary == wb.Loop(
        wb.FOPDT(1.0, 3.0, 1.0), wb.Stenman(1.0), wb.PID(0.5, 5.0, output_limits=(-10.0, 10.0)), 1.0
    )
    assert calmer.cascade.primary.controller == wb.PID(0.8, 80.0)
    assert calmer.cascade.secondary == found.cascade.secondary
    assert other.cascade.secondary.controller == wb.PID(0.5, 9.0)
    assert plan.experiment == wb.CascadeExperiment(
        600.0, (wb.Step(5.0),), primary_load=wb.Step(1.0, 300.0), secondary_noise=wb.Noise(0.01, 3)
    )
    assert tuned.tune.bounds == wb.Bounds((0.5, 4.0), (40.0, 200.0), (0.0, 0.0))
    assert tuned.tune.objective == wb.Objective(0.5, 0.0, 0.0, 0.0)
    assert tuned.tune.secondary[0] == wb.Experiment(100.0, wb.Step(1.0))


def test_a_tuning_in_turn_is_asked_with_all_that_its_case_says(monkeypatch):
    asked = []
    monkeypatch.setattr(cascade_runner, "tune_cascade", lambda *given, **named: asked.append((given, named)))
    plan = read(TEXT + TUNE.replace("restarts: 1", "restarts: 3\n      seed: 5\n      digits: 6"))
    job = plan.cascade[-1]
    cascade_runner.tune_job(job.cascade, plan.experiment, job.tune, print)
    ((given, named),) = asked
    assert given == (job.cascade, plan.experiment, job.tune.objective, job.tune.bounds, 5)
    experiment, objective, bounds = job.tune.secondary
    assert bounds == wb.Bounds((0.1, 1.0), (2.0, 30.0), (0.0, 0.0))
    inner = {"secondary_experiment": experiment, "secondary_objective": objective, "secondary_bounds": bounds}
    assert named == inner | {"restarts": 3, "digits": 6, "progress": print}


# What is replaced by what, the refusal, and the text where it stands.
WRONG = [
    (
        "    sample_time: 5 s",
        "    sample_time: 2.5 s",
        "cascade.primary.sample_time: 2.5 s given; must be a whole",
        "2.5",
    ),
    ("  anti_windup: none", "  scale: 0", "cascade.scale: 0.0 given; must not be 0", "0"),
    ("  anti_windup: none", "  windup: none", "cascade.windup: unknown key (did you mean anti_windup?)", "windup"),
    (
        "    valve: {type: stenman, d: 1 %}\n",
        "    valve: {type: stenman, d: 1 %}\n    fail_open: true\n",
        "at every sample, and a plant gain of the other sign says fail-open); allowed: plant, controller",
        "fail_open",
    ),
    ("    valve: {type: stenman, d: 1 %}\n", "", "cascade.secondary.valve: missing", "plant: {type: fopdt, gain: 1.0"),
    ("    valve: {type: stenman, d: 1 %}", "    valve: {type: kano, S: 1, J: 2}", "cascade.secondary.valve.J: 2", "2}"),
    ("Kc: 1.5, Ti: 80 s}", "Kc: 1.5}", "cascade.primary.controller.Ti: missing", "{Kc: 1.5}"),
    (
        "Kc: 1.5, ",
        "Kc: 1.5, action: direct, ",
        "cascade.primary.controller: direct action given; the controller acts",
        "{Kc: 1.5",
    ),
    ("duration: 600 s", "duration: 602 s", "experiment.duration: 602 s given; must be a whole number of", "602"),
    ("duration: 600 s", "duration: 10000000 s", "experiment.duration: 10,000,000 samples; must be at most", "10000000"),
    ("{Kc: 0.8}", "{Kc: 0.8 %/%}", "cases[1].primary.Kc: a gain in %/% given; a cascade takes", "0.8 %/%"),
    ("primary_load: {step: 1,", "primary_load: {step: 1 %,", "1 % given; this load is in EU of the secondary", "1 %"),
    (
        "{name: calmer, primary: {Kc: 0.8}}",
        "{name: calmer, Kc: 0.8}",
        "cases[1]: a case of a single loop given",
        "{name: calmer",
    ),
    (
        "{name: calmer, primary: {Kc: 0.8}}",
        "{name: as found, primary: {Kc: 0.8}}",
        "cases[1].name: 'as found' given; cases[0] has this",
        "as found, primary",
    ),
    ("primary: {Kc: 0.8}", "primary: {Kc: -0.8}", "cases[1].primary.Kc: -0.8 given", "-0.8"),
    (
        "objective: {w1: 0.5}",
        "loop: {sample_time: 1 s}\nobjective: {w1: 0.5}",
        "loop: given, and cascade as well",
        "{sample_time: 1 s}\nobj",
    ),
    (
        "objective: {w1: 0.5}",
        "analyze: {repair: true}",
        "analyze.repair: given; of a cascade there is its limit_cycle",
        "true",
    ),
    (
        "Kc: [0.5, 4]",
        "Kc: [2, 4]",
        "cases[3].tune_cascade.primary.bounds.Kc: [2, 4] excludes the start, Kc = 1.5",
        "[2, 4]",
    ),
    (
        "duration: 100 s",
        "duration: 100.5 s",
        "tune_cascade.secondary.experiment.duration: 100.5 s given; must be",
        "100.5",
    ),
    (
        "      restarts: 1\n",
        "      restart: 1\n",
        "tune_cascade.restart: unknown key (did you mean restarts?)",
        "restart:",
    ),
]


@pytest.mark.parametrize(("old", "new", "said", "at"), WRONG)
def test_what_is_wrong_is_refused_at_its_place(old, new, said, at):
    text = (TEXT + TUNE).replace(old, new, 1)
    assert text != TEXT + TUNE
    with pytest.raises(wb.ScenarioError) as refused:
        read(text)
    told = str(refused.value)
    assert said in told
    assert "\n" not in told
    place = text.index(at, text.index(new) if new else 0) if at in new else text.index(at)
    line = text.count("\n", 0, place) + 1
    column = place - (text.rfind("\n", 0, place) + 1) + 1
    assert told.startswith(f"cascade.yaml:{line}:{column}: "), told


def test_what_belongs_to_a_cascade_is_refused_without_one():
    single = """\
title: single
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2 %}
  controller: {Kc: 0.5, Ti: 20 s}
  sample_time: 1 s
experiment: {duration: 100 s, setpoint: {step: 4, at: 0 s}, primary_load: {step: 1, at: 0 s}}
cases:
  - {name: one, primary: {Kc: 1}}
"""
    with pytest.raises(wb.ScenarioError) as refused:
        read(single)
    lines = str(refused.value).splitlines()
    assert lines == [
        "cascade.yaml:7:75: experiment.primary_load: given for a single loop; only a cascade has such an entry",
        "cascade.yaml:9:5: cases[0]: a case of a cascade given; needs cascade in place of loop",
    ]


@pytest.mark.usefixtures("undrawn")
def test_results_and_report_tell_both_loops(tmp_path):
    study = wb.run_scenario(read(TEXT.replace("duration: 600 s", "duration: 400 s")))
    content = results_content(study)["cascade"]
    assert [case["name"] for case in content["cases"]] == ["as found", "calmer", "other"]
    first = content["cases"][0]
    assert first["limit_cycle"]["outcome"] == "cycles"
    assert first["limit_cycle"]["secondary"]["sp_peak_to_peak"] == first["limit_cycle"]["primary"]["op_peak_to_peak"]
    assert first["looked_at_alone"]["secondary"]["verdict"] == "stiction"
    assert first["looked_at_alone"]["primary"]["verdict"] != "stiction"
    run = study.cascade[0].run
    errors = run.primary.sp[1:] - run.primary.pv[1:]
    last = run.primary.final_sp - run.primary.final_pv
    assert first["objective"] == pytest.approx(0.5 * ((errors**2).sum() + last**2), rel=1e-9)
    write_report(study, tmp_path)
    assert json.loads((tmp_path / "results.json").read_text())["cascade"]["secondary"]["valve"] == {
        "type": "stenman",
        "d": 1.0,
    }
    rows = list(csv.DictReader((tmp_path / "cases.csv").read_text().splitlines()))
    assert [(row["case"], row["loop"]) for row in rows[:2]] == [("as found", "primary"), ("as found", "secondary")]
    assert float(rows[1]["valve_travel"]) == pytest.approx(run.secondary.kpis.valve_travel, rel=1e-9)
    page = (tmp_path / "report.html").read_text()
    for words in (
        "without noise both loops cycle every",
        "How the cycle appears in both loops",
        "the primary knows nothing of the secondary's limits".replace("'", "&#39;"),
        "gain 1.2 EU/EU",
        "of 1 EU of the secondary at 300 s",
    ):
        assert words in page, words
    assert {path.name for path in tmp_path.glob("*.svg")} >= {
        "trend_as_found.svg",
        "pv_op_calmer.svg",
        "cycle_other.svg",
    }


@pytest.mark.usefixtures("undrawn")
def test_a_failed_search_is_told_and_sets_the_exit_code(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from workbench import cli
    from workbench.scenario import cascade_runner

    real = cascade_runner.tune_cascade
    monkeypatch.setattr(cascade_runner, "tune_cascade", lambda *a, **k: real(*a, **k, time_limit=1e-6))
    file = tmp_path / "cascade.yaml"
    file.write_text(TEXT[: TEXT.index("  - {name: as found}")] + TUNE[: TUNE.index("      secondary:")])
    result = CliRunner().invoke(cli.app, ["run", str(file), "--out", str(tmp_path / "out")])
    assert result.exit_code != 0
    assert "tuned, primary: time limit" in result.output
    assert "Do not use tuned as it stands" in result.output
