"""The page's answers to what a browser asks, without a browser: everything is text, whatever is asked."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bokeh.document import Document

import workbench as wb
from workbench.model.front import FrontPoint
from workbench.scenario.loader import load_scenario
from workbench.ui import page as pages
from workbench.ui.document import open_page
from workbench.ui.given import safe_name
from workbench.ui.jobs import Event
from workbench.ui.load import screen_of
from workbench.ui.page import Page
from workbench.ui.work import FrontFound, MapFound, ReadRecord, Report, TunedCase

SCENARIOS = Path(__file__).parents[2] / "scenarios"
PAPER = screen_of(load_scenario(SCENARIOS / "table_2.yaml"))  # frozen: every session may begin with it


class Asked:
    """A page, and what it answers."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.number = 0

    def __call__(self, do: str, /, **more: Any) -> dict[str, Any]:
        self.number += 1
        self.page.bridge.up = json.dumps({"n": self.number, "do": do, **more})
        answer = json.loads(self.page.bridge.down)
        assert answer["ack"] == self.number
        return answer

    @property
    def last(self) -> dict[str, Any]:
        return json.loads(self.page.bridge.down)


@pytest.fixture
def ask():
    page = open_page(Document(), PAPER)
    yield Asked(page)
    page.close()


@pytest.fixture(scope="module")
def standing():
    page = open_page(Document(), PAPER)
    yield Asked(page)
    page.close()


@pytest.fixture
def shared(standing):
    """One page for the tests that change only what can be undone, as its pictures take most of a test's time."""
    while standing("undo").get("message") != "there is nothing to undo":
        pass
    standing("view", view="loop")
    return standing


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """The tasks that a page begins, in place of their processes."""
    found: list[tuple[str, str]] = []

    class Fake:
        alive = True
        stopped = False

        def __init__(self, task: str, text: str, _folder: str, _tell: object) -> None:
            found.append((task, text))

        def stop(self) -> None:
            Fake.stopped = True

        def kill(self) -> None:
            self.alive = False

    monkeypatch.setattr(pages, "Job", Fake)
    return found


def ended(ask: Asked, kind: str, words: str = "", result: object = None) -> dict[str, Any]:
    assert ask.page.job is not None
    ask.page.job.alive = False  # type: ignore[misc]
    ask.page._happened([ask.page.job], Event(kind, words, 1.0, result))
    return ask.last


def test_hello_brings_everything(shared):
    answer = shared("hello")
    assert answer["title"] == "Five tunings of one sticky flow loop, and two optimised ones"
    assert answer["entries"]["loop.valve.d"] == "2"
    assert [case["name"] for case in answer["cases"]] == [f"Case {i}" for i in range(1, 6)]
    assert {f["name"]: f["text"] for f in answer["figures"]}["valve_travel"] == "12.18"
    assert answer["axes"]["pv.y"][0] < 0.0 < 4.0 < answer["axes"]["pv.y"][1]


def test_a_slider_changes_figures_and_pictures(shared):
    shared("hello")
    before = shared.page.pictures.run.source.data["pv_y"].copy()
    answer = shared("set", entries={"loop.controller.Kc": "1.2"}, gesture="slide:loop.controller.Kc")
    loop = shared.page.session.built.loop
    run = wb.simulate(loop, shared.page.session.built.experiment)
    drawn = shared.page.pictures.run.source.data["pv_y"]
    assert np.array_equal(drawn, run.pv.astype(np.float32))
    assert not np.array_equal(drawn, before)
    assert answer["undo"]
    assert answer["problems"] == []
    assert shared("undo")["entries"]["loop.controller.Kc"] == "0.5"
    assert shared("undo")["message"] == "there is nothing to undo"


def test_long_runs_are_drawn_finely_and_short_ones_as_before(shared):
    lines = shared.page.pictures.figures["op"].renderers
    before = [(line.glyph.line_width, line.glyph.line_dash) for line in lines]
    shared("set", entries={"experiment.duration": "20000"})
    assert {(line.glyph.line_width, tuple(line.glyph.line_dash)) for line in lines} == {(1.0, ())}
    assert shared.page.pictures.run.source.data["pv_y"].size < 5000
    shared("undo")
    assert [(line.glyph.line_width, line.glyph.line_dash) for line in lines] == before


def test_what_is_refused_is_told_at_its_field(shared):
    answer = shared("set", entries={"loop.valve.d": "much"})
    assert answer["problems"] == [
        {"field": "loop.valve.d", "text": 'loop.valve.d: much % given; must be a number of %, such as 2 or "2 %"'}
    ]
    assert answer["entries"]["loop.valve.d"] == "much"
    assert answer["figures"], "the last good run stays"
    for what in ("scenario", "trends", "figures", "report"):
        answer = shared("export", what=what)
        assert answer["message"].startswith("loop.valve.d"), what
        assert "download" not in answer


NONSENSE: list[tuple[str, dict[str, Any]]] = [
    ("set", {}),
    ("set", {"entries": {"loop.plant.gian": "1"}}),
    ("set", {"entries": []}),
    ("format_the_disk", {}),
    ("rename", {"case": -1, "name": "x"}),
    ("move", {"case": "x", "by": 1}),
    ("view", {"view": "secret"}),
    ("export", {"what": "passwords"}),
    ("map_figure", {"name": "x"}),
    ("use_model", {}),
    ("use_tuned", {}),
    ("pin_tuned", {"name": "x"}),
    ("estimate", {}),
    ("upload", {"name": "x.csv", "data": "§"}),
    ("map", {"seen": {"x": [1.0], "y": [1.0, 2.0]}}),
    ("tap", {"picture": "f_map", "x": None, "y": 1.0}),
    ("map", {"seen": {"x": [2.0, 1.0], "y": [1.0, 2.0]}}),
    ("map", {"seen": {"x": [-1.0, 1.0], "y": ["a", 2.0]}}),
]


def test_requests_that_make_no_sense_are_answered_and_change_nothing(shared):
    screen = shared.page.session.screen
    for what, more in NONSENSE:
        answer = shared(what, **more)
        assert answer["message"], what
        assert "Traceback" not in answer["message"]
        assert shared.page.session.screen is screen
    for text in ("", "{", "[]", "1", '{"n": 1}', '{"do": "hello"}'):
        shared.page.ask(text)
        assert "not understood" in shared.last["message"]


def test_comparing_sends_table_and_overlays(shared):
    answer = shared("view", view="compare")
    assert [head["name"] for head in answer["comparison"]["heads"]][-1] == "On screen"
    drawn = shared.page.pictures.cases.source.data
    assert np.isfinite(drawn["pv4_y"]).any()
    assert not np.isfinite(drawn["pv7_y"]).any()
    answer = shared("pin", name="<script>alert(1)</script>")
    assert [case["name"] for case in answer["cases"]][-1] == "<script>alert(1)</script>"
    keys = [head.get("case") for head in answer["comparison"]["heads"]]
    assert keys[-1] is None, "the page's own is no case"
    assert shared("rename", case=keys[5], name="Case 1")["message"] == (
        "name: 'Case 1' given; case 1 has this name already"
    )
    assert shared("move", case=keys[5], by=-5)["comparison"]["heads"][0]["name"] == "<script>alert(1)</script>"
    assert len(shared("remove", case=keys[5])["cases"]) == 5
    assert shared("show", case=keys[4])["entries"]["loop.controller.Td"] == "1"


def test_what_is_asked_of_a_case_that_has_moved_on_is_done_to_no_other(shared):
    ask = shared
    first, second, third, *_ = (head["case"] for head in ask("view", view="compare")["comparison"]["heads"])
    ask("remove", case=first)
    # Asked before the page showed the first one gone: one of the next, and the same once more.
    assert [case["name"] for case in ask("remove", case=second)["cases"]] == ["Case 3", "Case 4", "Case 5"]
    again = ask("remove", case=second)
    assert (again["message"], len(again["cases"])) == ("", 3)
    for what, more in (("move", {"by": 1}), ("rename", {"name": "x"}), ("show", {})):
        assert ask(what, case=second, **more)["message"] == "that case is no longer there"
    ask("undo")
    ask("undo")
    assert [head["case"] for head in ask("view", view="compare")["comparison"]["heads"]][:3] == [first, second, third]


def test_frequency_brings_both_verdicts(shared):
    answer = shared("view", view="frequency")
    lines = answer["frequency"]["lines"]
    assert lines[0].startswith("Describing function: The loci do not cross")
    assert "102.4 s" in lines[1]
    assert shared.page.pictures.L.data["x"].size > 100


def test_the_scenario_is_shown_and_leaves_as_a_file(shared):
    shown = shared("view", view="export")["scenario"]
    answer = shared("export", what="scenario")
    assert answer["download"]["text"] == shown
    assert answer["download"]["name"] == "scenario.yaml"
    assert answer["view"] == "export"


def test_a_tuning_runs_stops_and_becomes_a_case(ask, begun):
    answer = ask("tune")
    assert answer["busy"] == "tune"
    assert "bounds: {Kc: [0, 10], Ti: [5 s, 600 s]}" in begun[0][1]
    assert "must wait: tuning is under way" in ask("map")["message"]
    ask.page._happened([ask.page.job], Event("progress", "searching", 0.25))
    assert ask.last["progress"] == {"words": "Tuning: searching", "share": 0.25}
    ask("stop")
    assert type(ask.page.job).stopped
    ask("set", entries={"tune.kind": "PID"})
    found = TunedCase(wb.PID(2.384, 9.092), False, "interrupted", ("Kc 2.384", "J 10"), 10.0, 226.0)
    answer = ended(ask, "done", result=found)
    assert answer["tuned"]["lines"] == ["Kc 2.384", "J 10"]
    assert answer["tuned"]["name"] == "Tuned PI"  # whatever is chosen for the next by now
    assert answer["message"] == "The tuning ended as interrupted."
    assert answer["busy"] == ""
    assert [c["name"] for c in ask("pin_tuned", name="Tuned PI")["cases"]][-1] == "Tuned PI"
    assert ask("use_tuned")["entries"]["loop.controller.Kc"] == "2.384"


def test_a_tuning_of_what_stood_there_before_says_so(ask, begun):
    ask("tune")
    controller = replace(ask.page.session.built.loop.controller, Kc=2.384, Ti=9.092)
    found = TunedCase(controller, True, "solved", ("Kc 2.384", "J 10"), 10.0, 226.0)
    assert ended(ask, "done", result=found)["tuned"]["lines"] == ["Kc 2.384", "J 10"]
    # The tuning itself may be another: it is what was searched for.
    assert ask("use_tuned")["tuned"]["lines"] == ["Kc 2.384", "J 10"]
    for path, text in (("loop.valve.d", "3"), ("experiment.setpoint.step", "1"), ("objective.w1", "7")):
        *_, said = ask("set", entries={path: text})["tuned"]["lines"]
        assert "as they stood when the search began" in said, path
        ask("pin_tuned", name=path)
        assert ask.page.session.screen.cases[-1].note == f"J 10 {said}"
        ask("undo")
        assert ask("undo")["tuned"]["lines"] == ["Kc 2.384", "J 10"]


def test_a_loop_that_changes_during_its_tuning_is_told_with_it(ask, begun):
    ask("tune")
    ask("set", entries={"loop.valve.d": "3"})
    found = TunedCase(wb.PID(2.384, 9.092), True, "solved", ("Kc 2.384", "J 10"), 10.0, 226.0)
    assert "as they stood when the search began" in ended(ask, "done", result=found)["tuned"]["lines"][-1]
    # A search that has to wait leaves the one before.
    ask("front")
    assert "must wait" in ask("tune")["message"]
    assert ask.last["tuned"]["lines"][0] == "Kc 2.384"


def test_a_dead_worker_leaves_the_page_with_the_reason(ask, begun):
    ask("tune")
    answer = ended(ask, "failed", "the worker process was ended by SIGKILL")
    assert answer["message"] == "the worker process was ended by SIGKILL"
    assert answer["busy"] == ""
    assert ask("set", entries={"loop.controller.Kc": "0.7"})["problems"] == []
    ask("tune")
    assert ended(ask, "stopped")["message"] == "Tuning was stopped."


def test_events_of_a_former_task_are_left_out(ask, begun):
    ask("tune")
    former = ask.page.job
    ended(ask, "failed", "first")
    ask("tune")
    sent = ask.last["sent"]
    ask.page._happened([former], Event("done"))
    assert ask.last["sent"] == sent


def test_bounds_that_suit_the_loop_hold_its_tuning(shared):
    shared("set", entries={"loop.controller.Ti": "5000", "loop.plant.time_constant": "60"})
    answer = shared("suit_bounds")
    low, high = (float(answer["entries"][f"tune.bounds.Ti.{end}"]) for end in ("low", "high"))
    assert low < 5000 < high
    shared.page.session.tuning()


def uploaded(ask: Asked, name: str, content: bytes) -> dict[str, Any]:
    return ask("upload", name=name, data=base64.b64encode(content).decode())


def test_an_upload_is_read_in_the_sessions_own_folder(ask, begun):
    answer = uploaded(ask, "../../etc/pass wd.csv", b"time,PV,OP\n")
    assert answer["busy"] == "read"
    assert "data: pass_wd.csv" in begun[0][1]
    assert [path.name for path in ask.page.folder.iterdir()] == ["pass_wd.csv"]
    answer = ended(ask, "failed", f"{ask.page.folder}/pass_wd.csv: a header and no row of data")
    assert answer["message"] == "pass_wd.csv: a header and no row of data"


@pytest.mark.parametrize("kind", ["failed", "stopped"])
def test_a_record_that_was_not_read_can_be_read_again_and_the_one_before_is_gone(ask, begun, kind):
    uploaded(ask, "a.csv", b"x")
    time = np.arange(300.0)
    ended(ask, "done", result=ReadRecord("a.csv", ("300 samples",), time, np.sin(time), np.cos(time), None, 1.0))
    uploaded(ask, "b.csv", b"x")
    answer = ended(ask, kind, "screen.yaml:2:18: estimate.data: b.csv: no column for PV")
    said = {"failed": "estimate.data: b.csv: no column for PV", "stopped": "Reading was stopped."}
    assert answer["message"] == said[kind]
    assert answer["record"] == {"name": "b.csv", "summary": []}
    assert answer["found"] is None
    assert ask.page.pictures.record.source.data["pv_y"].size == 0
    ask("set", entries={"estimate.columns.PV": "level"})
    assert ask("read")["busy"] == "read"
    assert "data: b.csv, columns: {PV: level}" in begun[-1][1]


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("C:\\data\\Füllstand 漢字.csv", "Füllstand_漢字.csv"),
        ("../.hidden", "hidden"),
        ("..", "record.csv"),
        ("漢" * 300 + ".csv", "漢" * 56 + ".csv"),
        ("a" * 20 + "." * 60, "record.csv"),
        ("<b>\0\n$(x)`.csv", "_b_x_.csv"),
    ],
)
def test_an_uploaded_files_name_is_its_own_and_leads_nowhere(name, kept):
    assert safe_name(name) == kept


def test_a_record_is_drawn_and_told(ask, begun):
    uploaded(ask, "a.csv", b"x")
    time = np.arange(300.0)
    record = ReadRecord("a.csv", ("300 samples", "<script>"), time, np.sin(time), np.cos(time), None, 1.0)
    answer = ended(ask, "done", result=record)
    assert answer["record"] == {"name": "a.csv", "summary": ["300 samples", "<script>"]}
    assert ask.page.pictures.record.source.data["pv_y"].size == 300


def test_an_upload_that_cannot_be_kept_is_told(ask, begun):
    (ask.page.folder / "a.csv").mkdir()
    assert ask("upload", name="a.csv", data="")["message"] == "a.csv: cannot be kept here (Is a directory)"
    assert not begun


def test_too_large_an_upload_is_refused(ask, begun, monkeypatch):
    monkeypatch.setattr(pages, "LARGEST_UPLOAD", 100)
    assert "can be uploaded" in uploaded(ask, "a.csv", b"x" * 101)["message"]
    assert not begun
    assert not list(ask.page.folder.iterdir())


def test_a_scenario_is_opened_and_a_bad_one_is_told_with_its_lines(ask):
    assert uploaded(ask, "bad.yaml", b"title: x\ncases: 3\n")["message"].startswith("bad.yaml:2:8: cases: 3 given")
    assert "no UTF-8" in uploaded(ask, "bad.yaml", b"\xff\xfe")["message"]
    manifest = (SCENARIOS / "fleet_table_1.yaml").read_bytes()
    assert uploaded(ask, "site.yaml", manifest)["message"] == (
        "site.yaml: a manifest of many loops; `workbench fleet` or `workbench run` takes it"
    )
    assert "unknown" in uploaded(ask, "bad.yaml", b"title: x\nloops: {plant: 3}\n")["message"]
    assert "1 MiB" in uploaded(ask, "bad.yaml", b" " * (1 << 20) + b"x")["message"]
    text = (SCENARIOS / "stick_slip.yaml").read_bytes()
    assert uploaded(ask, "stick_slip.yaml", text)["title"].startswith("A stick-slip cycle")


def test_a_record_opened_during_a_task_is_read_after_it(ask, begun):
    ask("tune")
    rows = b"time,PV,OP\n" + b"".join(b"%d,%d,%d\n" % (k, k % 7, k % 5) for k in range(40))
    answer = uploaded(ask, "loop 1.csv", rows)
    assert answer["message"] == "loop 1.csv is read as soon as tuning has ended."
    assert answer["busy"] == "tune"
    assert uploaded(ask, "loop 2.csv", rows)["message"] == "loop 2.csv is read as soon as tuning has ended."
    assert len(begun) == 1
    ended(ask, "stopped")
    assert ask.last["busy"] == "read"
    assert "data: loop_2.csv" in begun[-1][1], "the one that was opened last"
    assert (ask.page.folder / "loop_2.csv").read_bytes() == rows
    ended(ask, "stopped")
    assert len(begun) == 2


def test_a_scenario_opened_after_its_record_reads_it_at_once_or_after_the_task_under_way(ask, begun):
    rows = "\n".join(f"{k},{k % 7},{k % 5}" for k in range(40))
    uploaded(ask, "loop 1.csv", f"time,PV,OP\n{rows}\n".encode())
    ended(ask, "stopped")
    scenario = b"title: Of a record\nestimate: {data: data/loop 1.csv}\n"
    assert uploaded(ask, "x.yaml", scenario)["title"] == "Of a record"
    assert "data: loop_1.csv" in begun[-1][1]
    assert (ask.page.folder / "loop_1.csv").is_file()
    ended(ask, "stopped")
    ask("tune")
    answer = uploaded(ask, "again.yaml", scenario)
    assert answer["message"] == "data/loop 1.csv is read as soon as tuning has ended."
    assert len(begun) == 3
    answer = ended(ask, "stopped")
    assert (answer["message"], answer["ended"], answer["busy"]) == ("Tuning was stopped.", "tune", "read")
    assert "data: loop_1.csv" in begun[3][1]
    assert ended(ask, "stopped")["busy"] == ""
    # Another scenario, opened before the record is read, has no use for it.
    ask("tune")
    uploaded(ask, "again.yaml", scenario)
    uploaded(ask, "other.yaml", (SCENARIOS / "stick_slip.yaml").read_bytes())
    assert ended(ask, "stopped")["busy"] == ""


def test_a_map_is_drawn_and_a_click_sets_the_tuning(ask, begun):
    ask("view", view="frequency")
    ask("map")
    Kc, Ti = np.geomspace(0.1, 10.0, 5), np.geomspace(1.0, 100.0, 4)
    ones = np.ones((4, 5))
    figures = dict.fromkeys(pages.MAP_FIGURES, np.arange(1.0, 21.0).reshape(4, 5))
    found = MapFound("Ti", Kc, Ti, ones, ones, figures, ("a map",))
    assert ended(ask, "done", result=found)["frequency"]["map"] == ["a map"]
    assert len(ask.page.pictures.map.data["left"]) == 20
    answer = ask("tap", picture="f_map", x=2.345, y=12.3456)
    assert answer["entries"]["loop.controller.Kc"] == "2.35"
    assert answer["entries"]["loop.controller.Ti"] == "12.3"
    assert answer["frequency"]["map"] == ["a map"], "another tuning is on the same map"
    answer = ask("set", entries={"loop.valve.d": "1"})
    assert "as it stood" in answer["frequency"]["map"][0]
    ask("map_figure", name="mean_square_error")


def test_a_map_of_what_is_in_view_takes_its_place(ask, begun):
    ask("map", seen={"x": [0.51234, 2.0], "y": [10.0, 40.0]})
    assert "map: {points: 30, Kc: [0.5123, 2], Ti: [10 s, 40 s]}" in begun[0][1]
    Kc, Ti = np.geomspace(0.5, 2.0, 5), np.geomspace(10.0, 40.0, 4)
    ones = np.ones((4, 5))
    figures = dict.fromkeys(pages.MAP_FIGURES, np.arange(1.0, 21.0).reshape(4, 5))
    answer = ended(ask, "done", result=MapFound("Ti", Kc, Ti, ones, ones, figures, ("a map",)))
    assert answer["refit"] == "f_map"
    assert answer["axes"]["f_map.x"][0] < 0.5 < 2.0 < answer["axes"]["f_map.x"][1]


def test_what_has_no_describing_function_says_so_and_draws_none(shared):
    shared("view", view="frequency")
    assert shared.page.pictures.L.data["x"].size > 100
    typed = {"loop.controller.compensator.type": "knocker"}
    answer = shared("set", entries=typed)
    assert answer["frequency"]["lines"][0].startswith("This loop has no describing function with a compensator")
    assert answer["frequency"]["lines"][1].startswith("Exact: The loop cycles")
    assert not answer["frequency"]["loci"]
    assert shared.page.pictures.L.data["x"].size == 0
    typed = {"loop.controller.compensator.type": "none", "loop.valve.type": "karnopp"}
    answer = shared("set", entries=typed)
    assert answer["frequency"]["lines"][0].startswith("This loop has no describing function here")
    assert answer["frequency"]["lines"][1].startswith("Exact: The loop cycles")
    shared("undo")
    answer = shared("undo")
    assert answer["frequency"]["loci"]
    assert shared.page.pictures.L.data["x"].size > 100


def test_what_is_typed_is_cut_where_no_value_is_that_long(shared):
    answer = shared("set", entries={"loop.plant.gain": "1" * 5000, "loop.valve.places": "0 1\n" * 5000})
    assert len(answer["entries"]["loop.plant.gain"]) == 400
    assert len(answer["entries"]["loop.valve.places"]) == 2000


def test_a_report_leaves_as_a_file(ask, begun):
    ask("export", what="report")
    assert begun[0][0] == "report"
    answer = ended(ask, "done", result=Report("<!DOCTYPE html>"))
    assert answer["download"] == {"name": "report.html", "type": "text/html", "text": "<!DOCTYPE html>"}


def test_closing_ends_the_task_and_removes_what_was_uploaded(begun):
    page = open_page(Document(), None)
    asked = Asked(page)
    uploaded(asked, "a.csv", b"x")
    folder = page.folder
    assert folder.exists()
    page.close()
    assert not folder.exists()
    assert not page.job.alive


def test_a_file_that_the_command_named_is_read_at_once(begun, tmp_path):
    (tmp_path / "loop 1.csv").write_text("time,PV,OP\n")
    page = open_page(Document(), None, tmp_path / "loop 1.csv")
    assert page.view == "estimate"
    assert begun[0][0] == "read"
    assert (page.folder / "loop_1.csv").exists()
    page.close()
    page = open_page(Document(), None, tmp_path / "gone.csv")
    assert "cannot be read" in page.message
    page.close()


def test_the_front_is_drawn_with_the_cases_and_a_click_sets_its_tuning(ask, begun):
    ask("view", view="compare")
    assert ask("hello")["front"] == []
    assert ask("front")["busy"] == "front"
    task, text = begun[0]
    assert task == "front"
    assert "Case 5" in text
    assert "must wait: searching the front is under way" in ask("map")["message"]
    ask("set", entries={"loop.controller.Kc": "0.6"})
    points = tuple(
        FrontPoint(wb.PID(Kc, 9.5, derivative_filter=np.inf), travel, error)
        for Kc, travel, error in ((0.4, 10.0, 2.0), (1.3, 200.0, 0.3), (1.5, 0.0, 0.1))
    )
    cases = (("On screen", 26.0, 0.9), ("<script>", 26.0, 0.9), ("Wild", np.inf, np.inf))
    answer = ended(ask, "done", result=FrontFound(points, points[:1], cases, ("Means over draws.",)))
    assert answer["front"][0].startswith("This is of the loop and the cases as they stood")
    assert ask("undo")["front"] == ["Means over draws."]
    pictures = ask.page.pictures
    assert pictures.fronts[0].data["x"].tolist() == [10.0, 200.0]
    assert pictures.fronts[1].data["y"].tolist() == [2.0]
    assert pictures.front.data["name"] == ["On screen, <script>", ""]
    assert len(set(pictures.front.data["color"])) == 2
    assert set(pictures.front.data["align"]) == {"left"}, "one place has no right half"
    for x, y in ((60.0, 1.0), (0.0, 1.0), (205.0, float("inf"))):
        assert ask("tap", picture="c_front", x=x, y=y)["entries"]["loop.controller.Kc"] == "0.5", "near no point"
    answer = ask("tap", picture="c_front", x=205.0, y=0.31)
    assert answer["entries"]["loop.controller.Kc"] == "1.3"
    assert answer["entries"]["loop.controller.Ti"] == "9.5"
    assert ask("undo")["entries"]["loop.controller.Kc"] == "0.5"
    assert ask("remove", case=ask.page.session.screen.cases[0].key)["front"][0].startswith(
        "This is of the loop and the cases as they stood"
    )


def test_a_front_stopped_before_it_began_draws_nothing_and_says_why(ask, begun):
    ask("view", view="compare")
    ask("front")
    answer = ended(ask, "done", result=FrontFound((), (), (), ("The search was stopped.",)))
    assert answer["front"] == ["The search was stopped."]
    assert ask("tap", picture="c_front", x=10.0, y=1.0)["front"] == answer["front"]
