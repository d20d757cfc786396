"""One session: changes, undo, refusals, pinned cases and their figures; all against the library itself."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loops import paper_loop, paper_step

import workbench as wb
from workbench.errors import InvalidValue, ScenarioError
from workbench.scenario.loader import load_scenario, read_scenario
from workbench.scenario.runner import run_scenario
from workbench.ui import export
from workbench.ui.fields import FIELDS
from workbench.ui.load import screen_of
from workbench.ui.state import MOST_CASES, Session

SCENARIOS = Path(__file__).parents[2] / "scenarios"
PAPER = screen_of(load_scenario(SCENARIOS / "table_2.yaml"))  # frozen: every session may begin with it


@pytest.fixture
def paper() -> Session:
    return Session(PAPER)


def figure(session: Session, name: str) -> str:
    return next(f["text"] for f in session.figures() if f["name"] == name)


@pytest.mark.parametrize(
    "path",
    [path for path in sorted(SCENARIOS.glob("*.yaml")) if path.stem != "fleet_table_1"],
    ids=lambda path: path.stem,
)
def test_every_shipped_scenario_opens_and_simulates_as_the_library_does(path):
    plan = load_scenario(path)
    session = Session(screen_of(plan))
    assert session.problems == ()
    assert session.own is not None
    assert session.own.run is not None
    if plan.loop is None:
        return
    controllers = {case.name: case.controller for case in plan.cases}
    for one in session.runs():
        run = wb.simulate(plan.loop.with_controller(controllers[one.name]), plan.experiment)
        assert one.run is not None
        assert repr(one.run.kpis) == repr(run.kpis)  # nan is nan
        if plan.objective is not None:
            loop = plan.loop.with_controller(controllers[one.name])
            assert one.objective == wb.evaluate(loop, plan.experiment, plan.objective)[0]


def test_the_papers_base_case_has_its_published_travel(paper):
    assert paper.problems == ()
    assert figure(paper, "valve_travel") == "12.18"
    assert figure(paper, "objective") == "226.6"


def test_a_change_simulates_exactly(paper):
    paper.change({"loop.controller.Kc": "1.32", "loop.controller.Ti": "196", "loop.controller.Td": "1"})
    run = wb.simulate(paper_loop(1.32, 196.0, 1.0), paper_step())
    assert paper.own is not None
    assert paper.own.run is not None
    assert np.array_equal(paper.own.run.pv, run.pv)
    assert paper.own.run.kpis == run.kpis
    expected = wb.evaluate(paper_loop(1.32, 196.0, 1.0), paper_step(), wb.Objective(0.5, 0.0, 0.5))
    assert paper.own.objective == expected[0]


def test_what_is_refused_stays_typed_and_says_why_in_the_loaders_words(paper):
    before = paper.own
    paper.change({"loop.plant.gain": "0", "loop.valve.d": "-1"})
    assert {p.field for p in paper.problems} == {"loop.valve.d"} or {p.field for p in paper.problems} == {
        "loop.plant.gain",
        "loop.valve.d",
    }
    assert paper.screen.entries["loop.plant.gain"] == "0"
    assert paper.own is before
    assert paper.stale
    with pytest.raises(ScenarioError) as caught:
        paper.scenario()
    assert "loop.valve.d: -1 % given; must be >= 0" in str(caught.value)
    assert "screen.yaml" not in str(caught.value)
    paper.change({"loop.plant.gain": "2", "loop.valve.d": "1"})
    assert paper.problems == ()
    assert not paper.stale


def test_the_loaders_own_refusal_of_the_wrong_action_is_a_warning_beside_the_run(paper):
    paper.change({"loop.plant.gain": "-1"})
    assert [p.field for p in paper.problems] == ["loop.controller.action"]
    assert "acts the wrong way" in paper.problems[0].text
    assert not paper.stale  # the run is of what stands there
    assert paper.own is not None
    assert paper.own.run is not None
    # It is no refusal; each case is told of its own.
    paper.pin("Direct", wb.PID(0.5, 20.0, action="direct"))
    heads = paper.comparison(paper.runs())["heads"]
    assert [head["name"] for head in heads if "acts the wrong way" not in head["refused"]] == ["Direct"]


@pytest.mark.parametrize(
    ("entries", "field", "text"),
    [
        ({"loop.valve.d": "0.02"}, "loop.valve.type", "sticks over 0.02 % of travel"),
        (
            {"loop.controller.limited": "true", "loop.controller.output_limits.low": "0"},
            "loop.controller.output_limits.low",
            "the loop rests on one of them",
        ),
        ({"experiment.setpoint.step": "0"}, "experiment.setpoint.step", "the loop stays at rest"),
    ],
)
def test_what_was_most_likely_meant_otherwise_is_said_at_its_field_as_long_as_it_holds(paper, entries, field, text):
    paper.change(entries)
    (said,) = paper.problems
    assert said.field == field
    assert text in said.text
    assert not paper.stale
    paper.pin("Mine")  # which is no refusal
    paper.read(paper.scenario(), Path("again.yaml"))
    assert paper.problems == (said,)
    assert paper.notes == (), "once, where it goes away"
    paper.change({path: PAPER.screen.entries[path] for path in entries})
    assert paper.problems == ()


def test_a_run_that_the_loop_refuses_says_so(paper):
    paper.change({"experiment.duration": "10.5"})
    assert any("whole number of samples" in p.text for p in paper.problems)


def test_undo_goes_back_a_change_at_a_time_and_a_gesture_at_once(paper):
    start = paper.screen
    assert not paper.undo()
    for Kc in ("0.6", "0.7", "0.8"):
        paper.change({"loop.controller.Kc": Kc}, gesture="slide:Kc")
    paper.change({"loop.controller.Ti": "30"})
    assert figure(paper, "valve_travel") != "12.18"
    assert paper.undo()
    assert paper.screen.entries["loop.controller.Ti"] == "20"
    assert paper.screen.entries["loop.controller.Kc"] == "0.8"
    assert paper.undo()
    assert paper.screen is start
    assert figure(paper, "valve_travel") == "12.18"
    assert not paper.undo()
    # A gesture that was undone does not swallow the next change of its kind.
    paper.change({"loop.controller.Kc": "0.6"}, gesture="slide:Kc")
    assert paper.undo()
    assert paper.screen is start


def test_pin_rename_move_remove_show_and_undo(paper):
    paper.change({"loop.controller.Kc": "0.6"})
    paper.pin(" Mine ")
    names = [case.name for case in paper.screen.cases]
    assert names[-1] == "Mine"
    paper.move(5, 0)
    paper.rename(0, "Base")
    assert [case.name for case in paper.screen.cases][:2] == ["Base", "Case 1"]
    paper.remove(1)
    assert "Case 1" not in [case.name for case in paper.screen.cases]
    paper.show(0)
    assert paper.screen.entries["loop.controller.Kc"] == "0.6"
    for _ in range(5):
        assert paper.undo()
    assert [case.name for case in paper.screen.cases] == [f"Case {i}" for i in range(1, 6)]


@pytest.mark.parametrize("name", ["", "   ", "Case 1", "x" * 81])
def test_a_name_that_a_scenario_refuses_is_refused(paper, name):
    with pytest.raises(ScenarioError):
        paper.pin(name)
    with pytest.raises(ScenarioError):
        paper.rename(1, name)
    assert len(paper.screen.cases) == 5


def test_there_is_an_end_to_cases(paper):
    for i in range(MOST_CASES - 5):
        paper.pin(f"more {i}")
    with pytest.raises(InvalidValue, match="at most 12"):
        paper.pin("one too many")


def test_the_table_is_that_of_the_library_with_differences_from_the_first(paper):
    table = paper.comparison(paper.runs())
    heads, rows = table["heads"], {row["title"]: row["cells"] for row in table["rows"]}
    assert [head["name"] for head in heads] == [*(f"Case {i}" for i in range(1, 6)), "On screen"]
    travel = rows["Valve travel"]
    assert [cell["text"] for cell in travel[:2]] == ["12.18", "4.013"]
    assert travel[0]["difference"] == ""
    assert travel[1]["difference"] == "−67 %"
    assert travel[1]["published"] == "4.01"
    assert "Settling time, into ±1 EU" in rows
    assert rows["Oscillation period"][4]["difference"] == "", "the first case has none"
    assert [cell["best"] for cell in travel] == [False, True, False, False, False, False]
    run = wb.simulate(paper_loop(2.01, 301.0), paper_step())
    assert paper.runs()[3].run.kpis == run.kpis


def settled(session: Session) -> tuple[str, str]:
    """The settling time on the page and why it is none to go by."""
    return next((f["text"], f["doubt"]) for f in session.figures() if f["name"] == "settling_time")


def test_a_settling_time_that_the_report_disowns_is_disowned_on_the_page(paper):
    from workbench.report.judge import settling_doubt
    from workbench.scenario.runner import run_scenario

    plan = load_scenario(SCENARIOS / "table_2.yaml")
    study = run_scenario(replace(plan, cases=tuple(job for job in plan.cases if job.tune is None)))
    said = {case.name: settling_doubt(case, study.experiment) for case in study.cases}
    table = paper.comparison(paper.runs())
    (cells,) = (row["cells"] for row in table["rows"] if row["title"].startswith("Settling time"))
    own = paper.own.controller
    assert own == study.cases[0].loop.controller
    assert [cell["doubt"] for cell in cells] == [said[one.name] for one in paper.runs()] + [said["Case 1"]]
    assert "not for good: it cycles" in said.values()
    for cell in cells:
        assert not (cell["doubt"] and (cell["best"] or cell["difference"]))
    assert settled(paper)[1] == said["Case 1"]
    # Without stiction it settles, and nothing is to be said.
    paper.change({"loop.valve.type": "ideal"})
    assert settled(paper)[1] == ""
    assert all(f["doubt"] == "" for f in paper.figures())


def test_an_entry_into_the_band_at_the_runs_end_is_no_settling(paper):
    paper.change({"loop.valve.type": "ideal", "loop.controller.Kc": "0.3", "loop.controller.Ti": "20"})
    time = paper.own.run.kpis.settling_time
    assert settled(paper)[1] == ""
    paper.change({"experiment.duration": str(round(time * 1.03))})
    assert settled(paper)[1] == "only at the run's end"


def test_pinned_cases_follow_the_loop_and_one_that_it_refuses_says_why(paper):
    before = paper.runs()[0].run.kpis
    paper.change({"loop.valve.d": "1"})
    assert paper.runs()[0].run.kpis != before
    limited = wb.PID(0.5, 0.6, output_limits=(-9.0, 9.0), anti_windup="back_calculation")
    paper.pin("Quick", limited)
    paper.change({"loop.sample_time": "2", "loop.coarse_sampling": "true"})
    quick = paper.runs()[-1]
    assert quick.run is None
    assert "half the sample time" in quick.refused


def test_the_exported_scenario_runs_to_the_same_numbers(paper, tmp_path):
    paper.change({"loop.controller.Kc": "0.7", "experiment.duration": "200"})
    path = tmp_path / "out.yaml"
    path.write_text(
        paper.scenario().replace("objective:", "analyze: {describing_function: false, limit_cycle: false}\nobjective:")
    )
    study = run_scenario(path)
    assert paper.own is not None
    ours = [paper.own, *paper.runs()]
    assert [repr(case.run.kpis) for case in study.cases] == [repr(one.run.kpis) for one in ours]  # nan is nan
    assert [case.objective for case in study.cases] == [one.objective for one in ours]


def test_reading_a_scenario_can_be_undone_and_a_bad_one_changes_nothing(paper):
    screen = paper.screen
    with pytest.raises(ScenarioError, match=r"bad\.yaml:1:1"):
        paper.read("titel: x\n", Path("bad.yaml"))
    assert paper.screen is screen
    paper.read(
        "title: x\nloop: {plant: {type: integrating, gain: 0.1}, valve: {type: ideal}, sample_time: 1 s}\n"
        "experiment: {duration: 60 s}\ncases: [{name: A, Kc: 1, Ti: none}]\n",
        Path("good.yaml"),
    )
    assert paper.screen.entries["loop.plant.type"] == "integrating"
    assert paper.screen.entries["loop.controller.Ti"] == "none"
    assert paper.notes == ()
    assert paper.undo()
    assert paper.screen is screen
    assert any("Optimised PI" in note for note in paper.notes), "what was said of that scenario"


def test_a_found_model_and_a_maps_tuning_go_on_the_page(paper):
    paper.use_model(wb.FOPDT(-0.5123456, 21.0, 5.0), wb.Choudhury(1.0, 0.25), 7.0, "direct", "a.csv")
    assert paper.problems == ()
    loop = paper.built.loop
    assert loop.plant == wb.FOPDT(-0.51235, 21.0, 5.0)
    assert loop.valve == wb.Choudhury(1.0, 0.25)
    assert loop.controller.action == "direct"
    assert paper.built.experiment.duration == 143 * 7.0
    paper.use_tuning(1.23456, 45.678, "Ti")
    assert (paper.built.loop.controller.Kc, paper.built.loop.controller.Ti) == (1.23, 45.7)


def test_a_model_of_another_record_leaves_what_was_said_of_the_scenarios_own_loop(paper):
    paper.use_model(wb.FOPDT(1.0, 21.0, 5.0), wb.Stenman(1.0), 1.0, "reverse", "a.csv")
    assert (paper.screen.title, paper.notes) == ("The loop found in a.csv", ())
    assert "reference" not in paper.scenario()
    assert [case.name for case in paper.screen.cases] == [f"Case {i}" for i in range(1, 6)]
    assert paper.undo()
    assert (paper.screen.title, paper.notes) == (PAPER.screen.title, PAPER.notes)
    own = screen_of(load_scenario(SCENARIOS / "industrial_flow_loop.yaml"))
    session = Session(own)
    assert any("example" in note for note in session.notes)
    session.use_model(wb.FOPDT(0.56, 21.0, 5.0), wb.Stenman(0.63), 5.0, "reverse", "industrial_flow_loop.csv")
    assert session.screen.title == own.screen.title
    assert not any("example" in note for note in session.notes)


@pytest.mark.parametrize(
    ("path", "typed", "text", "unit"),
    [
        ("loop.valve.d", "2 %", "2", "%"),
        ("loop.valve.d", " 2.5% ", "2.5", "%"),
        ("loop.plant.time_constant", "0.1 min", "0.1", "min"),
        ("loop.plant.gain", "-1.5 EU/%", "-1.5", "EU/%"),
        ("loop.controller.Kc", "150 PB %", "150", "PB %"),
        ("experiment.setpoint.step", "4 EU", "4", "EU"),
        ("loop.valve.mass", "2e-1kg", "2e-1", "kg"),
        ("loop.controller.Ti", "none", "none", "s"),
    ],
)
def test_a_unit_typed_behind_its_number_goes_to_the_units_own_entry(paper, path, typed, text, unit):
    paper.change({path: typed})
    assert (paper.screen.entries[path], paper.screen.entries[f"{path}.unit"]) == (text, unit)


def test_a_levels_gain_has_a_unit_of_its_own(paper):
    gain = FIELDS["loop.plant.gain"]
    assert gain.units_in(paper.screen.entries) == ("EU/%",)
    paper.change({"loop.plant.gain": "0.05 EU/(% s)"})
    assert any("0.05 EU/(% s) given" in str(problem) for problem in paper.problems)
    paper.change({"loop.plant.type": "integrating", "loop.plant.gain": "0.05 EU/(% s)"})
    assert paper.problems == ()
    assert paper.screen.entries["loop.plant.gain"] == "0.05"
    assert gain.units_in(paper.screen.entries) == ("EU/(% s)",)
    paper.change({"loop.plant.gain": "0.04 EU/%"})
    assert any("0.04 EU/% given" in str(problem) for problem in paper.problems)
    assert FIELDS["cascade.primary.plant.gain"].otherwise[2] == "EU/(EU s)"


@pytest.mark.parametrize(
    ("path", "typed", "said"),
    [
        ("loop.valve.d", "2 kg", 'loop.valve.d: 2 kg given; must be a number of %, such as 2 or "2 %"'),
        ("loop.valve.d", "1,5", "loop.valve.d: 1,5 % given; must be a number of %, such as 2 or"),
        ("loop.valve.d", "1,5 %", "loop.valve.d: 1,5 % given; must be a number of %, such as 2 or"),
        ("loop.plant.gain", "1,5", "loop.plant.gain: 1,5 given; must be a number; decimals are written with a point"),
        ("experiment.noise.sd", "0,1", "experiment.noise.sd: 0,1 given; must be a number; decimals are written with a"),
        ("objective.w1", "0,5", "objective.w1: 0,5 given; must be a number; decimals are written with a point"),
        ("loop.plant.gain", "1,x", "loop.plant.gain: 1,x given; must be a number"),
    ],
)
def test_another_unit_or_a_decimal_comma_is_refused_as_it_was_typed(paper, path, typed, said):
    paper.change({path: typed})
    (problem,) = paper.problems
    assert problem.field == path
    assert problem.text.startswith(said)
    assert ("decimals are written with a point, such as 2.5" in problem.text) is bool(re.search(r",\d", typed))


def test_published_figures_are_left_out_for_another_loop_than_the_scenarios(paper):
    def published() -> set[str]:
        table = paper.comparison(paper.runs())
        shown = {cell["published"] for row in table["rows"] for cell in row["cells"]} - {""}
        assert bool(shown) is not table["note"].startswith("The cases' published figures are of the loop, experiment ")
        return shown

    assert "12.18" in published()
    paper.change({"loop.controller.Kc": "3", "tune.restarts": "2", "loop.valve.d": "2.0"})
    paper.pin("Mine")
    assert "12.18" in published(), "of the cases' own tunings"
    assert "reference" in paper.scenario()
    for path, text in (("loop.valve.d", "3"), ("experiment.setpoint.step", "1"), ("objective.w1", "7")):
        paper.change({path: text})
        assert published() == set()
        assert "reference" not in paper.scenario()
        assert paper.undo()
        assert "12.18" in published()
    again = Session(screen_of(read_scenario(paper.scenario(), Path("again.yaml"))))
    assert [case.reference for case in again.screen.cases[:5]] == [case.reference for case in paper.screen.cases[:5]]


def test_a_tuning_that_is_refused_is_told_at_its_field(paper):
    paper.change({"tune.bounds.Ti.high": "10"})
    with pytest.raises(ScenarioError, match="excludes the start"):
        paper.tuning()
    assert [p.field for p in paper.problems] == ["tune.bounds.Ti.low"]
    paper.change({"tune.bounds.Ti.high": "much"})
    with pytest.raises(ScenarioError, match=r"^tune\.bounds\.Ti\[1\]: much s given"):
        paper.tuning()
    assert [p.field for p in paper.problems] == ["tune.bounds.Ti.high"]


def test_sessions_share_nothing():
    one, other = Session(), Session()
    one.change({"loop.plant.gain": "3"})
    one.pin("mine")
    assert other.screen.entries["loop.plant.gain"] == "1"
    assert other.screen.cases == ()
    assert not other.undo()


def test_tables_leave_as_csv_in_which_no_name_is_a_formula(paper):
    paper.pin("=cmd|' /C calc'!A0")
    paper.pin("@x")
    name, kind, text = export.made("figures", paper)
    assert (name, kind) == ("figures.csv", "text/csv")
    lines = text.splitlines()
    assert lines[0].startswith("case,Kc,Ti,Td,form,compensator,objective,mean_square_error")
    assert lines[6].startswith("'=cmd|' /C calc'!A0,0.5,20,0,ideal,none,226.575")
    assert lines[7].startswith("'@x,")
    assert lines[1].split(",")[:4] == ["Case 1", "0.5", "20", "0"]
    assert ",-0.16" in lines[1], "numbers stay numbers"
    rows = export.made("trends", paper)[2].splitlines()
    assert rows[0] == "time_s,SP,PV,OP,valve"
    assert len(rows) == 1001
    assert [float(x) for x in rows[11].split(",")] == pytest.approx(
        [10.0, 4.0, paper.own.run.pv[10], paper.own.run.op[10], paper.own.run.valve[10]]
    )
    with pytest.raises(InvalidValue):
        export.made("passwords", paper)


@pytest.mark.parametrize("named", ["/etc/passwd", "../secret.csv", "a/../../secret.csv"])
def test_an_opened_scenario_looks_at_no_file_beside_those_that_were_opened(paper, tmp_path, named):
    (tmp_path / "secret.csv").write_text("time,PV,OP\n0,1,2\n1,2,3\n")
    folder = tmp_path / "own"
    folder.mkdir()
    with pytest.raises(ScenarioError, match="open that file here first"):
        paper.read(f"title: x\nestimate: [{{data: {named}}}]\n", folder / "x.yaml")
    with pytest.raises(ScenarioError, match="open that file here first"):
        paper.read(f"title: x\nexperiment: {{setpoint: {{file: {named}, column: PV}}}}\n", folder / "x.yaml")
    rows = "\n".join(f"{k},{k % 7},{k % 5}" for k in range(40))
    (folder / "a.csv").write_text(f"time,PV,OP\n{rows}\n")
    assert paper.read("title: x\nestimate: {data: a.csv}\n", folder / "x.yaml") == "a.csv"


def test_a_scenario_finds_the_records_that_were_opened_by_whatever_path_it_names_them(paper, tmp_path):
    scenario = tmp_path / "x.yaml"
    text = "title: x\nestimate: {data: data/of today/loop 1.csv}\n"
    with pytest.raises(ScenarioError, match=r"x.yaml: data/of today/loop 1.csv given; open that file here first, then"):
        paper.read(text, scenario)
    rows = "\n".join(f"{k},{k % 7},{k % 5}" for k in range(40))
    (tmp_path / "loop_1.csv").write_text(f"time,PV,OP\n{rows}\n")  # as an upload is named
    assert paper.read(text, scenario) == "data/of today/loop 1.csv"
    with pytest.raises(ScenarioError, match="given; cannot be had here"):
        paper.read(text.replace("data/of today", "loop_1.csv"), scenario)


def test_a_table_too_long_for_a_browser_is_refused(paper, monkeypatch):
    monkeypatch.setattr(export, "MOST_ROWS", 999)
    with pytest.raises(InvalidValue, match="must be at most 999"):
        export.made("trends", paper)
