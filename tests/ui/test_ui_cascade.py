"""A cascade on the page: both loops simulate as the library says, and leave as the scenario that they came as."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bokeh.document import Document

import workbench as wb
from workbench.analyze.cascade import cascade_cycle
from workbench.kpi.kpis import cascade_event
from workbench.model.cascade import CascadeExperiment
from workbench.model.numbers import figure
from workbench.model.study import CascadeResult, Study
from workbench.report.judge import settling_doubt
from workbench.scenario.loader import load_scenario, read_scenario
from workbench.scenario.runner import run_scenario
from workbench.tune.cascade import evaluate_cascade
from workbench.ui import export
from workbench.ui.document import open_page
from workbench.ui.fields import FIELDS
from workbench.ui.load import screen_of
from workbench.ui.screen import Pinned, scenario_text
from workbench.ui.state import Session
from workbench.ui.work import TunedCase, tune_loop

SCENARIOS = Path(__file__).parents[2] / "scenarios"
FILE = Path("screen.yaml")
PLAN = load_scenario(SCENARIOS / "cascade.yaml")
LOADED = screen_of(PLAN)  # frozen: every session may begin with it
ABOVE, BELOW = "cascade.primary.controller", "cascade.secondary.controller"


@pytest.fixture
def session() -> Session:
    return Session(LOADED)


def figures(session: Session) -> dict[str, str]:
    return {figure["name"]: figure["text"] for figure in session.figures()}


def test_the_shipped_cascade_simulates_as_the_library_says(session):
    assert session.problems == ()
    found = PLAN.cascade[0].cascade
    assert PLAN.experiment is not None
    assert PLAN.objective is not None
    run = wb.simulate(found, PLAN.experiment)
    own = session.own
    assert own is not None
    assert own.run is not None
    assert own.above is not None
    assert own.run.kpis == run.secondary.kpis
    assert np.array_equal(own.above.pv, run.primary.pv)
    assert own.objective == evaluate_cascade(found, PLAN.experiment, PLAN.objective)
    assert figures(session)["secondary.valve_travel"] == f"{run.secondary.kpis.valve_travel:.2f}"
    assert figures(session)["primary.mean_square_error"] == f"{run.primary.kpis.mean_square_error:.4f}"
    assert [case.name for case in session.screen.cases] == [job.name for job in PLAN.cascade[:-1]]
    assert any("still to be found: Tuned in turn" in note for note in session.notes)


def test_both_tunings_can_be_changed_and_undone(session):
    before = figures(session)
    session.change({f"{ABOVE}.Kc": "0.8", f"{ABOVE}.Ti": "100"})
    session.change({f"{BELOW}.Kc": "0.4", "cascade.secondary.valve.d": "2"})
    assert PLAN.experiment is not None
    found = PLAN.cascade[1].cascade
    inner = replace(found.secondary, valve=wb.Stenman(2.0), controller=replace(found.secondary.controller, Kc=0.4))
    run = wb.simulate(replace(found, secondary=inner), PLAN.experiment)
    assert repr(session.own.run.kpis) == repr(run.secondary.kpis)  # nan is nan
    assert repr(session.own.above.kpis) == repr(run.primary.kpis)
    assert session.undo()
    assert session.undo()
    assert figures(session) == before


def test_pinned_cases_are_those_of_the_scenario_and_can_be_shown(session):
    runs = session.runs()
    for job, one in zip(PLAN.cascade, runs, strict=False):
        assert PLAN.experiment is not None
        assert one.run.kpis == wb.simulate(job.cascade, PLAN.experiment).secondary.kpis
    session.show(2)
    entries = session.screen.entries
    assert entries[f"{BELOW}.compensator.type"] == "integral_deadband"
    assert entries[f"{BELOW}.compensator.band"] == "1.1"
    assert session.own.run.kpis == runs[2].run.kpis
    session.pin("Mine")
    assert session.screen.cases[-1].primary == PLAN.cascade[0].cascade.primary.controller
    table = session.comparison(session.runs())
    heads: Any = table["heads"]
    assert heads[1]["settings"] == "primary Kc 0.8 EU/EU, Ti 100 s; secondary Kc 0.5 %/EU, Ti 5 s"
    rows: Any = {row["title"]: row for row in table["rows"]}
    assert rows["Primary: travel of its output"]["unit"] == "EU"
    assert rows["Secondary: valve travel"]["cells"][0]["text"] == "72.14"


def test_a_primary_in_units_of_its_own_is_told_in_them_and_its_travel_in_eu(session):
    before = figures(session)
    assert FIELDS[f"{ABOVE}.Kc"].units_in(session.screen.entries) == ("EU/EU",)
    Kc = PLAN.cascade[0].cascade.primary.controller.Kc
    session.change({"cascade.scale": "2", f"{ABOVE}.Kc": str(Kc / 2)})
    assert session.problems == ()
    assert FIELDS[f"{ABOVE}.Kc"].units_in(session.screen.entries) == ("unit/EU",)
    assert figures(session)["primary.controller_travel"] == before["primary.controller_travel"]
    assert session.own.words.startswith(f"primary Kc {Kc / 2:g} unit/EU, Ti")


def test_a_pinned_case_that_the_cascade_refuses_says_why_and_the_others_stand(session):
    session.change({f"{BELOW}.compensator.type": "knocker", "cascade.secondary.sample_time": "1"})
    session.pin("Knocked")
    session.change({f"{BELOW}.compensator.type": "none", "cascade.secondary.sample_time": "2.5"})
    assert session.problems == ()
    runs = session.runs()
    assert [one.run is None for one in runs] == [False, False, False, True]
    assert "must be a whole number of samples of 2.5 s" in runs[-1].refused
    table: Any = session.comparison(runs)
    assert table["heads"][3]["refused"] == runs[-1].refused
    assert table["rows"][0]["cells"][3]["text"] == table["rows"][1]["cells"][3]["text"]


def test_what_is_exported_runs_to_the_same_numbers_and_opens_to_the_same_screen(session, tmp_path):
    session.change({f"{ABOVE}.Ti": "1.5", f"{ABOVE}.Ti.unit": "min", "experiment.duration": "600"})
    text = session.scenario()
    again = screen_of(read_scenario(text, FILE))
    kept = {path for path in FIELDS if not path.startswith(("tune", "estimate."))}  # the others are the page's alone
    assert {path: again.screen.entries[path] for path in kept} == {p: session.screen.entries[p] for p in kept}
    assert again.screen.entries[f"{ABOVE}.Ti.unit"] == "min"
    assert scenario_text(again.screen) == text
    path = tmp_path / "out.yaml"
    path.write_text(text + "analyze: {limit_cycle: false}\n")
    study: Study = run_scenario(path)
    ours = [session.own, *session.runs()]
    assert [case.name for case in study.cascade] == ["On screen", *(one.name for one in session.runs())]
    for case, one in zip(study.cascade, ours, strict=True):
        assert repr(case.run.secondary.kpis) == repr(one.run.kpis)
        assert repr(case.run.primary.kpis) == repr(one.above.kpis)
        assert case.objective == one.objective


def test_what_few_cascades_have_leaves_as_it_came():
    inner = wb.Loop(wb.Integrating(0.02, 3.0), wb.Kano(2.0, 0.5), wb.PID(0.5, 30.0, output_limits=(-30.0, 60.0)), 1.0)
    above = wb.PID(0.1 + 0.2, 80.0, 2.0, form="series", output_limits=(-9.0, 9.5), output_resolution=0.25)
    above = replace(above, compensator=wb.TwoMove(1.5, 300.0, -0.5), anti_windup="back_calculation", tracking_time=40.0)
    outer = wb.Loop(wb.FOPDT(-1.2, 60.0, 10.0), wb.Ideal(), replace(above, action="reverse"), 4.0)
    cascade = wb.Cascade(outer, inner, scale=-0.5, anti_windup="none")
    experiment = CascadeExperiment(
        800.0,
        (wb.Step(5.0),),
        (wb.Step(-2.0, 300.0),),
        wb.Noise(0.01, 3),
        0.5,
        (wb.Step(1.5, 600.0), wb.Ramp(1.0, 10.0, 20.0)),
        wb.Noise(0.02, 1),
    )
    plan = replace(PLAN, text="", cascade=(replace(PLAN.cascade[0], cascade=cascade),), experiment=experiment)
    screen = screen_of(plan).screen
    again = read_scenario(scenario_text(screen), FILE)
    assert again.experiment == experiment
    assert [job.cascade for job in again.cascade] == [cascade, cascade]
    assert screen_of(again).screen.entries == screen.entries


@pytest.mark.parametrize(
    ("typed", "field"),
    [
        ({"cascade.primary.sample_time": "4.5"}, "cascade.primary.sample_time"),
        ({f"{ABOVE}.action": "direct"}, f"{ABOVE}.action"),
        ({f"{BELOW}.Kc": "-1"}, f"{BELOW}.Kc"),
        ({"cascade.scale": "0"}, "cascade.scale"),
        ({"cascade.secondary.valve.type": "kano", "cascade.secondary.valve.J": "3"}, "cascade.secondary.valve.J"),
        ({f"{BELOW}.compensator.type": "knocker", f"{BELOW}.compensator.width": "0.5"}, f"{BELOW}.compensator.width"),
        ({"experiment.duration": "901"}, "experiment.duration"),
        ({"experiment.primary_load.step": "2 %"}, "experiment.primary_load.step"),
    ],
)
def test_what_is_refused_is_told_at_its_field_beside_the_last_good_run(session, typed, field):
    before = session.own
    session.change(typed)
    assert [problem.field for problem in session.problems] == [field]
    assert session.own is before


CASCADE_FIELDS = [
    path
    for path, field in FIELDS.items()
    if path.startswith(("cascade.", "experiment.primary", "experiment.secondary")) and not field.flag
]


@pytest.mark.parametrize("path", [path for path in CASCADE_FIELDS if not FIELDS[path].choices])
def test_every_field_of_a_cascade_can_be_refused_where_it_stands(path):
    needed: dict[str, str] = {}
    when = FIELDS[path].when
    while when is not None:
        needed[when[0]] = when[1][0]
        when = FIELDS[when[0]].when
    if path.endswith(("load.at", "noise.seed")):
        needed |= {"experiment.primary_load.step": "1", "experiment.secondary_noise.sd": "1"}
    session = Session(LOADED)
    session.change({**needed, path: "bad?"})
    assert path in {problem.field for problem in session.problems}


def test_tables_of_a_cascade_hold_both_loops(session):
    rows = export.made("trends", session)[2].splitlines()
    assert rows[0] == "time_s,primary_SP,primary_PV,primary_OP,SP,PV,OP,valve"
    above, below = session.own.above, session.own.run
    expected = [20.0, 5.0, above.pv[20], above.op[20], above.op[20], below.pv[20], below.op[20], below.valve[20]]
    assert [float(x) for x in rows[21].split(",")] == pytest.approx(expected)
    lines = export.made("figures", session)[2].splitlines()
    assert lines[0].startswith("case,primary_Kc,primary_Ti,primary_Td,primary_form,primary_compensator,Kc,Ti")
    assert lines[2].startswith("Primary detuned,0.8,100,0,ideal,none,0.5,5,0,ideal,none,")


def test_a_found_model_stands_in_a_loop_of_its_own_and_the_cascade_can_be_had_back(session):
    session.use_model(wb.FOPDT(2.0, 21.0, 5.0), wb.Stenman(1.0), 1.0, "reverse", "a.csv")
    assert session.problems == ()
    assert session.built.cascade is None
    assert session.built.loop.plant == wb.FOPDT(2.0, 21.0, 5.0)
    assert session.screen.cases == ()
    assert session.undo()
    assert session.built.cascade == PLAN.cascade[0].cascade


class Asked:
    """A page with the cascade, and what it answers."""

    def __init__(self) -> None:
        self.page = open_page(Document(), LOADED)
        self.number = 0

    def __call__(self, do: str, /, **more: Any) -> dict[str, Any]:
        self.number += 1
        self.page.bridge.up = json.dumps({"n": self.number, "do": do, **more})
        answer: dict[str, Any] = json.loads(self.page.bridge.down)
        return answer


@pytest.fixture
def ask():
    asked = Asked()
    yield asked
    asked.page.close()


def test_the_page_shows_a_cascades_fields_and_both_loops(ask):
    answer = ask("hello")
    assert answer["kind"] == "cascade"
    assert answer["entries"][f"{ABOVE}.Kc"] == "3"
    assert not any(path.startswith("loop.") for path in answer["entries"])
    pictures, own = ask.page.pictures, ask.page.session.own
    assert np.array_equal(pictures.run.source.data["pv_y"], own.above.pv.astype(np.float32))
    assert np.array_equal(pictures.inner.source.data["pv2_y"], own.run.pv.astype(np.float32))
    assert np.array_equal(pictures.run.source.data["valve_y"], own.run.valve.astype(np.float32))
    assert pictures.figures["pv"].yaxis[0].axis_label == "primary's PV, SP (EU)"
    answer = ask("view", view="compare")
    drawn = pictures.cases.source.data
    first = ask.page.session.runs()[0]
    assert np.array_equal(drawn["pv0_y"], first.above.pv.astype(np.float32))
    assert pictures.trade.data["x"][0] == first.run.kpis.valve_travel
    assert pictures.trade.data["y"][0] == first.above.kpis.mean_square_error
    assert answer["front"] == []
    lines = ask("view", view="frequency")["frequency"]["lines"]
    assert "both loops cycle every 62.6 s" in lines[1]
    assert "cascade:" in ask("view", view="export")["scenario"]


def test_what_is_for_one_loop_says_so(ask):
    screen = ask.page.session.screen
    for what in ("map", "front", "suit_bounds"):
        assert "must be of a single loop, and a cascade stands here" in ask(what)["message"], what
        assert ask.page.session.screen is screen
    # Nor is the tuning of a loop that stood here before one of the cascade.
    ask.page.tuned = TunedCase(wb.PID(1.0, 2.0), True, "solved", ("x",), 1.0, 2.0)
    for what in ("use_tuned", "pin_tuned"):
        answer = ask(what, name="x")
        assert "must be found first" in answer["message"], what
        assert "tuned" not in answer
        assert ask.page.session.screen is screen
    assert ask.page.job is None


def test_the_tuning_in_turn_asked_for_is_the_scenarios(session):
    asked = PLAN.cascade[-1].tune
    assert asked is not None
    job = read_scenario(session.tuning(), FILE).cascade[0].tune
    assert job is not None
    assert (job.bounds, job.objective, job.secondary) == (asked.bounds, asked.objective, asked.secondary)
    assert (job.seed, job.restarts, job.digits) == (asked.seed, asked.restarts, asked.digits)
    alone = {"tune_cascade.tuned": "primary", "tune_cascade.primary.kind": "PID"}
    session.change(
        alone | {"tune_cascade.primary.bounds.Td.high": "1", "tune_cascade.primary.bounds.Td.high.unit": "min"}
    )
    job = read_scenario(session.tuning(), FILE).cascade[0].tune
    assert job is not None
    assert job.secondary is None
    assert job.bounds == replace(asked.bounds, Td=(0.0, 60.0))


@pytest.mark.parametrize(
    ("typed", "field"),
    [
        ({"tune_cascade.primary.bounds.Kc.low": "x"}, "tune_cascade.primary.bounds.Kc.low"),
        ({"tune_cascade.secondary.bounds.Ti.high": "-1"}, "tune_cascade.secondary.bounds.Ti.high"),
        ({"tune_cascade.secondary.experiment.duration": "0.5"}, "tune_cascade.secondary.experiment.duration"),
        ({"tune_cascade.secondary.experiment.load.step": "much"}, "tune_cascade.secondary.experiment.load.step"),
        ({"tune.restarts": "0"}, "tune.restarts"),
    ],
)
def test_a_tuning_in_turn_that_is_refused_is_told_at_its_field(session, typed, field):
    session.change(typed)
    assert session.problems == (), "what a search lacks is no matter of the run"
    with pytest.raises(wb.ScenarioError):
        session.tuning()
    assert field in {problem.field for problem in session.problems}


def test_a_tuning_in_turn_is_the_librarys_and_becomes_a_case(ask, tmp_path):
    typed = {
        "tune_cascade.tuned": "primary",
        "tune_cascade.primary.bounds.Kc.low": "0.5",
        "tune.digits": "2",
        "experiment.duration": "150",
        "experiment.load.at": "50",
        "experiment.primary_load.at": "100",
    }
    ask("set", entries=typed)
    text = ask.page.session.tuning()
    found = tune_loop(text, str(tmp_path), lambda *_: None)
    job = read_scenario(text, FILE).cascade[0]
    assert job.tune is not None
    again = wb.tune_cascade(
        job.cascade, ask.page.session.built.experiment, job.tune.objective, job.tune.bounds, 0, restarts=1, digits=2
    )
    assert found.primary == again.cascade.primary.controller
    assert found.controller == job.cascade.secondary.controller
    assert found.objective == again.primary.objective
    now = wb.simulate(again.cascade, ask.page.session.built.experiment)
    error, travel = figure(now.primary.kpis.mean_square_error), figure(now.secondary.kpis.valve_travel)
    assert found.lines[3].startswith(f"In the run on the page: mean square error {error} EU² (")
    assert f"), valve travel {travel} % (" in found.lines[3]
    assert found.lines[1].startswith(f"Primary: Kc {again.cascade.primary.controller.Kc:.4g}"[:16])
    ask.page.tuned = found
    answer = ask("pin_tuned", name="Tuned in turn")
    assert answer["cases"][-1]["name"] == "Tuned in turn"
    assert ask.page.session.screen.cases[-1].primary == found.primary
    ask("use_tuned")
    assert ask.page.session.built.cascade.primary.controller == found.primary
    assert ask.page.session.own.objective == found.objective


def test_names_of_a_cascades_cases_are_as_strict_as_a_loops(session):
    with pytest.raises(wb.ScenarioError, match="has this name already"):
        session.pin("As found")
    session.pin("<script>")
    assert isinstance(session.screen.cases[-1], Pinned)
    assert read_scenario(session.scenario(), FILE).cascade[-1].name == "<script>"


def test_what_a_cascade_most_likely_means_otherwise_is_said_at_its_field(session):
    session.change({"cascade.secondary.valve.d": "0.02"})
    (problem,) = session.problems
    assert problem.field == "cascade.secondary.valve.type"
    assert problem.text.startswith("cascade.secondary.valve sticks over 0.02 % of travel")
    assert session.own is not None
    assert session.own.run is not None, "said, not refused"


def test_the_primarys_settling_time_is_disowned_as_the_report_does(session):
    def on_the_page() -> str:
        return next(one["doubt"] for one in session.figures() if one["name"] == "primary.settling_time")

    def in_a_report() -> str:
        cascade, experiment = session.own.cascade, session.built.experiment
        case = CascadeResult("x", wb.simulate(cascade, experiment), cycle=cascade_cycle(cascade, experiment))
        return settling_doubt(case, experiment)

    assert on_the_page() == in_a_report() == ""
    event = cascade_event(session.own.cascade, session.built.experiment)
    settled = event.at + session.own.above.kpis.settling_time
    session.change({"experiment.duration": f"{5.0 * math.ceil(settled / 0.95 / 5.0):g}"})
    assert session.problems == ()
    assert on_the_page() == in_a_report() == "only at the run's end"
