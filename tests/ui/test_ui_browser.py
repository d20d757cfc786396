"""The page in a real browser (conftest.py): what an engineer does, and what must not happen.

Screenshots go to build/screenshots.
"""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from loops import paper_loop, paper_step

import workbench as wb
from workbench.report.tables import shown
from workbench.scenario.loader import load_scenario

ROOT = Path(__file__).parents[2]
SCREENSHOTS = ROOT / "build" / "screenshots"
AXE = Path(__file__).parent / "axe" / "axe.min.js"
PAPER = str(ROOT / "scenarios" / "table_2.yaml")
WIDTHS = (1024, 1280, 2560)  # one for each layout of the style sheet
SIZE = {"width": 1280, "height": 900}
VIEWS = ("loop", "compare", "estimate", "tune", "frequency", "export")

pytestmark = pytest.mark.slow


class Opened:
    """A page in a session of its own, with what it said and asked for."""

    def __init__(self, browser: Any, served: Any, beside: Opened | None = None) -> None:
        """beside: a page whose browser window this one is a tab of."""
        self.served = served
        self.context = browser.new_context(viewport=SIZE, accept_downloads=True) if beside is None else beside.context
        self.page = self.context.new_page()
        self.page.set_default_timeout(20_000)
        self.wrong: list[str] = []
        self.asked: list[str] = []
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.on("console", lambda said: said.type == "error" and self.wrong.append(said.text))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("dialog", lambda dialog: (self.wrong.append(f"dialog: {dialog.message}"), dialog.dismiss()))
        self.page.goto(served.url)
        self.page.wait_for_selector("html[data-drawn]")

    def figure(self, name: str) -> Any:
        return self.page.locator(f'[data-figure="{name}"] dd')

    def entry(self, path: str) -> Any:
        return self.page.locator(f'[data-entry="{path}"]')

    def type(self, path: str, text: str) -> None:
        self.entry(path).fill(text)
        self.entry(path).press("Enter")

    def slide(self, path: str, to: int) -> None:
        """Drag a slider to a place of 0 to 1000."""
        self.page.locator(f'[data-slider="{path}"]').evaluate(
            """(slider, to) => {
              slider.value = String(to);
              slider.dispatchEvent(new Event("input", { bubbles: true }));
              slider.dispatchEvent(new Event("change", { bubbles: true }));
            }""",
            to,
        )

    def settled(self) -> None:
        """Wait until everything asked for is answered."""
        self.page.wait_for_selector("html[data-idle=true]")

    def drawn(self) -> None:
        """Wait until the figures have taken the sizes of their places, and are painted: some frames, not some time."""
        self.settled()
        self.page.evaluate(
            """async () => {
              for (let frame = 0; frame < 4; frame++) await new Promise(requestAnimationFrame);
            }"""
        )

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold back what is asked for: what is done within comes before the first answer is seen."""
        self.settled()
        self.page.evaluate(
            """() => {
              window.real = bridge;
              window.kept = null;
              bridge = { get down() { return real.down; }, set up(text) { window.kept = text; } };
            }"""
        )
        yield
        self.page.evaluate("() => { bridge = real; if (kept) bridge.up = kept; }")
        self.settled()

    def view(self, name: str) -> None:
        self.page.click(f"#tab-{name}")
        self.page.wait_for_selector(f"#view-{name}:not([hidden])")

    def picture(self, name: str) -> None:
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=SCREENSHOTS / f"{name}.png")

    def undo_all(self) -> None:
        self.view("loop")
        self.settled()
        while self.page.locator("#undo").is_enabled():
            self.page.click("#undo")
            self.settled()

    def check(self) -> None:
        """It may not have said an error, opened a dialog, or asked anything of another place."""
        assert all(url.startswith((self.served.url, "data:", "blob:")) for url in self.asked), self.asked
        assert self.wrong == []


@pytest.fixture(scope="module")
def paper_page(browser: Any, serve: Callable[..., Any]) -> Iterator[Callable[[], Opened]]:
    """The page of the paper's scenario, opened anew where a test has ended its server."""
    pages: list[Opened] = []

    def standing() -> Opened:
        if not pages or pages[-1].served.process.poll() is not None:
            pages.append(Opened(browser, serve(PAPER)))
        return pages[-1]

    yield standing
    for one in pages:
        one.context.close()


@pytest.fixture
def paper(paper_page: Callable[[], Opened]) -> Iterator[Opened]:
    """The paper's scenario on one page for many tests, as opening one takes seconds: each begins with all undone."""
    opened = paper_page()
    opened.page.set_viewport_size(SIZE)
    opened.undo_all()
    yield opened
    opened.check()


def expect(locator: Any) -> Any:
    from playwright import sync_api

    sync_api.expect.set_options(timeout=15_000)
    return sync_api.expect(locator)


def test_a_slider_of_the_papers_loop_shows_what_the_kernel_gives(paper):
    expect(paper.figure("valve_travel")).to_have_text("12.18 %")
    expect(paper.page.locator("#title")).to_have_text("Five tunings of one sticky flow loop, and two optimised ones")
    paper.picture("loop")
    for to in (650, 300):
        paper.slide("loop.controller.Kc", to)
        Kc = float(paper.entry("loop.controller.Kc").input_value())
        assert Kc != 0.5
        run = wb.simulate(paper_loop(Kc, 20.0), paper_step())
        expect(paper.figure("valve_travel")).to_have_text(f"{shown('valve_travel', run.kpis.valve_travel)} %")
        expect(paper.figure("iae")).to_have_text(f"{shown('iae', run.kpis.iae)} EU s")
    drawn = paper.page.evaluate(
        "Array.from(Bokeh.documents[0].get_model_by_name('pv').renderers[1].data_source.get('pv_y'))"
    )
    assert drawn == pytest.approx(run.pv.tolist(), rel=1e-6, abs=1e-6)
    paper.page.click("#undo")
    paper.page.click("#undo")
    expect(paper.figure("valve_travel")).to_have_text("12.18 %")
    expect(paper.page.locator("#undo")).to_be_disabled()


def test_a_settling_time_that_is_none_says_so_at_the_figure_and_in_the_table(paper):
    doubt = paper.figure("settling_time").locator("small.doubt")
    expect(doubt).to_have_text("not for good: it cycles")
    paper.view("compare")
    cells = paper.page.locator("#comparison tr", has_text="Settling time").locator("td")
    expect(cells.last).to_contain_text("not for good: it cycles")
    paper.view("loop")
    paper.type("loop.controller.Kc", "2.01")
    expect(doubt).to_have_count(0)


def test_the_keyboard_is_enough(paper):
    page = paper.page
    paper.entry("loop.controller.Kc").focus()
    page.keyboard.press("ArrowUp")
    expect(paper.entry("loop.controller.Kc")).to_have_value("0.51")
    run = wb.simulate(paper_loop(0.51, 20.0), paper_step())
    expect(paper.figure("valve_travel")).to_have_text(f"{shown('valve_travel', run.kpis.valve_travel)} %")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.entry") == "loop.controller.Kc.unit"
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.slider") == "loop.controller.Kc"
    page.keyboard.press("ArrowRight")
    expect(paper.entry("loop.controller.Kc")).not_to_have_value("0.51")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.entry") == "loop.controller.Ti"
    page.keyboard.press("Control+z")
    expect(paper.entry("loop.controller.Kc")).to_have_value("0.51")
    page.keyboard.press("Control+z")
    expect(paper.figure("valve_travel")).to_have_text("12.18 %")
    paper.view("tune")
    paper.entry("tune.seed").focus()
    page.keyboard.press("ArrowUp")
    expect(paper.entry("tune.seed")).to_have_value("1")
    page.focus("#tab-loop")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.id") == "tab-compare"
    expect(page.locator("#view-compare")).to_be_visible()
    page.keyboard.press("End")
    expect(page.locator("#view-export")).to_be_visible()


def test_what_is_being_typed_is_not_lost(paper, tmp_path):
    page = paper.page
    paper.type("loop.controller.Kc", "0.7")
    page.fill("#pin-name-loop", "Case 2")
    page.press("#pin-name-loop", "Control+z")  # of the name, not of the gain
    paper.settled()
    expect(paper.entry("loop.controller.Kc")).to_have_value("0.7")
    page.fill("#pin-name-loop", "Case 2")
    page.press("#pin-name-loop", "Enter")
    expect(page.locator("#message")).to_contain_text("has this name already")
    expect(page.locator("#pin-name-loop")).to_have_value("Case 2")
    page.fill("#pin-name-loop", "Another")
    page.press("#pin-name-loop", "Enter")
    expect(page.locator("#pin-name-loop")).to_have_value("")
    record = tmp_path / "typing.csv"
    record.write_text("time,PV,OP\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(40)))
    constant = paper.entry("loop.plant.time_constant")
    constant.fill("7.77")
    page.set_input_files("#record", record)  # answers that nothing typed has asked for
    expect(page.locator("#record-name")).to_have_text("typing.csv")
    expect(constant).to_have_value("7.77")
    constant.press("Enter")
    run = wb.simulate(replace(paper_loop(0.7, 20.0), plant=wb.FOPDT(1.0, 7.77, 1.0)), paper_step())
    expect(paper.figure("valve_travel")).to_have_text(f"{shown('valve_travel', run.kpis.valve_travel)} %")


def test_what_is_typed_before_the_answer_is_seen_is_not_lost(paper):
    page = paper.page
    with paper.held():
        paper.type("loop.controller.Kc", "0.7")
        paper.entry("loop.controller.Kc").fill("0.75")
        page.fill("#pin-name-loop", "First")
        page.press("#pin-name-loop", "Enter")
        page.fill("#pin-name-loop", "Sec")
        paper.entry("loop.controller.Ti").fill("21")
        paper.entry("loop.controller.Ti").press("Enter")
        paper.entry("loop.controller.Ti").fill("210")
    expect(page.locator("#pin-name-loop")).to_have_value("Sec")
    expect(paper.entry("loop.controller.Ti")).to_have_value("210")
    expect(paper.entry("loop.controller.Kc")).to_have_value("0.75")
    page.fill("#pin-name-loop", "")
    paper.settled()


def test_a_cascade_and_what_few_loops_have_show_where_a_scenario_has_them(paper):
    start, page = paper, paper.page
    page.set_input_files("#open", ROOT / "scenarios" / "cascade.yaml")
    expect(start.figure("secondary.valve_travel")).to_have_text("72.14 %")
    expect(start.entry("loop.plant.gain")).to_be_hidden()
    start.slide("cascade.primary.controller.Kc", 300)
    Kc = float(start.entry("cascade.primary.controller.Kc").input_value())
    plan = load_scenario(ROOT / "scenarios" / "cascade.yaml")
    found = plan.cascade[0].cascade
    run = wb.simulate(found.with_controllers(replace(found.primary.controller, Kc=Kc)), plan.experiment)
    travel = run.secondary.kpis.valve_travel
    assert travel != 72.14
    expect(start.figure("secondary.valve_travel")).to_have_text(f"{shown('valve_travel', travel)} %")
    drawn = page.evaluate(
        "Array.from(Bokeh.documents[0].get_model_by_name('pv2').renderers[1].data_source.get('pv2_y'))"
    )
    assert drawn == pytest.approx(run.secondary.pv.tolist(), rel=1e-6, abs=1e-6)
    start.picture("cascade")
    start.view("tune")
    expect(start.entry("tune_cascade.primary.bounds.Kc.high")).to_have_value("8")
    expect(start.entry("tune.bounds.Kc.high")).to_be_hidden()
    start.picture("tune_cascade")
    page.set_input_files("#open", ROOT / "scenarios" / "compensators.yaml")
    expect(start.entry("loop.plant.gain")).to_be_visible()
    expect(start.entry("cascade.primary.plant.gain")).to_be_hidden()
    expect(start.entry("tune.bounds.Kc.high")).to_be_visible()
    expect(start.entry("tune_cascade.primary.bounds.Kc.high")).to_be_hidden()
    width = start.entry("loop.controller.compensator.width")
    expect(width).to_be_hidden()
    start.view("compare")
    page.click('[aria-label="Knocker: on the screen"]')
    expect(width).to_be_visible()
    expect(width).to_have_value("1")
    start.entry("loop.valve.type").select_option("positional")
    places = start.entry("loop.valve.places")
    places.fill("-20 3\n0 2 x\n20 4")
    places.blur()
    said = page.locator('[data-field="loop.valve.places"] .said')
    expect(said).to_contain_text("loop.valve.places[1].J: x given")
    places.fill("-20 3\n0 2\n20 4")
    places.blur()
    expect(said).to_be_hidden()
    page.click("#undo")
    page.click("#undo")
    page.click("#undo")
    page.click("#undo")
    page.click("#undo")
    expect(start.entry("cascade.primary.controller.Kc")).to_have_value(f"{Kc:g}")


def test_what_the_loader_refuses_is_said_at_the_field(paper):
    paper.type("loop.valve.d", "-1")
    said = paper.page.locator('[data-field="loop.valve.d"] .said')
    expect(said).to_have_text("loop.valve.d: -1 % given; must be >= 0")
    assert paper.entry("loop.valve.d").get_attribute("aria-invalid") == "true"
    paper.picture("refused")
    stale = paper.page.locator("main.stale")
    expect(stale).to_have_count(1)
    paper.type("loop.valve.d", "1")
    expect(said).to_be_hidden()
    expect(stale).to_have_count(0)
    # A unit typed behind its number goes to the unit's own entry.
    paper.type("loop.plant.time_constant", "0.1 min")
    expect(paper.entry("loop.plant.time_constant")).to_have_value("0.1")
    expect(paper.entry("loop.plant.time_constant.unit")).to_have_value("min")
    paper.type("loop.plant.time_constant", "5 s")
    expect(paper.entry("loop.plant.time_constant.unit")).to_have_value("s")
    paper.entry("loop.controller.action").select_option("direct")  # a warning: the run is of what stands there
    expect(paper.page.locator('[data-field="loop.controller.action"] .said')).to_contain_text("acts the wrong way")
    expect(stale).to_have_count(0)
    paper.entry("loop.controller.action").select_option("reverse")
    paper.entry("loop.valve.type").select_option("choudhury")
    expect(paper.entry("loop.valve.S")).to_be_visible()
    expect(paper.entry("loop.valve.d")).to_be_hidden()
    unit = paper.page.locator('[data-field="loop.plant.gain"] .unit')
    expect(unit).to_have_text("EU/%")
    paper.entry("loop.plant.type").select_option("integrating")
    expect(paper.entry("loop.plant.time_constant")).to_be_hidden()
    expect(unit).to_have_text("EU/(% s)")
    paper.picture("level")


def test_cases_are_pinned_renamed_moved_and_removed(paper):
    page = paper.page
    paper.view("compare")
    expect(page.locator("#comparison tbody tr").nth(3).locator("td").nth(1)).to_contain_text("4.013")
    page.fill("#pin-name", "<script>alert(1)</script>")
    page.press("#pin-name", "Enter")
    names = page.locator("#comparison thead input")
    expect(names).to_have_count(6)
    expect(names.nth(5)).to_have_value("<script>alert(1)</script>")
    page.click('[aria-label="<script>alert(1)</script>: to the left"]')
    expect(names.nth(4)).to_have_value("<script>alert(1)</script>")
    names.nth(4).fill("Case 1")
    names.nth(4).press("Enter")
    expect(page.locator("#message")).to_contain_text("case 1 has this name already")
    expect(names.nth(4)).to_have_value("Case 1")  # to be mended
    expect(names.nth(4)).to_have_attribute("aria-invalid", "true")
    names.nth(4).press("Escape")
    expect(names.nth(4)).to_have_value("<script>alert(1)</script>")
    page.click('[aria-label="Case 1: away"]')
    expect(names).to_have_count(5)
    expect(names.nth(0)).to_have_value("Case 2")
    paper.picture("compare")


def test_a_cases_name_and_the_focus_stay_where_an_answer_comes_meanwhile(paper):
    page = paper.page
    paper.view("compare")
    paper.settled()
    names = page.locator("#comparison thead input")
    names.nth(0).fill("Half a na")
    page.evaluate("ask('view', { view: 'compare' })")
    paper.settled()
    page.keyboard.type("me")
    expect(names.nth(0)).to_have_value("Half a name")
    expect(names.nth(0)).to_have_attribute("title", "Case 1")  # not taken before it is entered
    page.keyboard.press("Enter")
    expect(names.nth(0)).to_have_attribute("title", "Half a name")
    page.focus('[aria-label="Case 4: to the left"]')
    for _ in range(3):
        page.keyboard.press("Enter")
        paper.settled()
    # Its button is of no more use now; what follows by the keyboard is of the same case.
    assert page.evaluate("document.activeElement.value") == "Case 4"
    expect(names.nth(0)).to_have_value("Case 4")
    page.focus('[aria-label="Case 5: away"]')
    page.keyboard.press("Enter")
    paper.settled()
    assert page.evaluate("document.activeElement.ariaLabel") == "Case 3: away"


def test_a_view_turned_to_before_the_last_one_is_there_stays(paper):
    page = paper.page
    with paper.held():
        page.click("#tab-frequency")
        page.click("#tab-compare")
        page.evaluate(
            """() => {
              window.turned = [];
              const seen = new MutationObserver((all) => turned.push(...all.map((one) => one.target.id)));
              seen.observe(document.querySelector("[role=tablist]"), { subtree: true, attributes: true });
            }"""
        )
    expect(page.locator("#view-compare")).to_be_visible()
    assert page.evaluate("turned") == []


def test_what_is_asked_for_twice_before_it_is_seen_is_done_once(paper):
    page = paper.page
    paper.view("compare")
    page.fill("#pin-name", "Once")
    with paper.held():
        page.press("#pin-name", "Enter")
        page.press("#pin-name", "Enter")
    expect(page.locator("#message")).to_be_hidden()
    expect(page.locator("#comparison thead input")).to_have_count(6)


def test_a_tuning_runs_and_another_is_stopped(paper):
    page = paper.page
    paper.type("experiment.duration", "120")
    paper.view("tune")
    paper.type("tune.restarts", "1")
    paper.type("tune.digits", "2")
    page.click("#tune")
    expect(page.locator("#progress")).to_be_visible()
    # The page goes on while the worker searches.
    paper.slide("loop.plant.gain", 500)
    expect(page.locator("#tuned li").nth(0)).to_contain_text("Kc", timeout=60_000)
    expect(page.locator("#progress")).to_be_hidden()
    page.click("#pin-tuned")
    paper.view("compare")
    expect(page.locator("#comparison thead input").nth(5)).to_have_value("Tuned PI")
    paper.view("tune")
    paper.type("experiment.duration", "3000")
    paper.type("tune.restarts", "64")
    page.click("#tune")
    expect(page.locator("#progress-words")).to_contain_text("Tuning: ")
    # What cannot be pressed does not look as if it could.
    expect(page.locator("#tune")).to_be_disabled()
    ground = "el => getComputedStyle(el).backgroundColor"
    assert page.locator("#tune").evaluate(ground) == page.locator("#suit-bounds").evaluate(ground)
    paper.picture("tuning")
    page.evaluate(
        """() => {
          window.words = [];
          const words = document.getElementById("progress-words");
          new MutationObserver(() => window.words.push(words.textContent)).observe(words, { childList: true });
        }"""
    )
    page.click("#suit-bounds")  # which has nothing to do with how far the search has come
    paper.settled()
    assert "Starting" not in page.evaluate("window.words")
    page.click("#stop")
    expect(page.locator("#progress")).to_be_hidden(timeout=30_000)
    expect(page.locator("#message")).to_have_text(re.compile("The tuning ended as interrupted|Tuning was stopped"))


@pytest.mark.skipif(os.name != "posix", reason="ends a process by a signal")
def test_a_dead_worker_leaves_the_page_alive_with_the_reason(paper):
    page = paper.page
    paper.type("experiment.duration", "3000")
    paper.view("tune")
    paper.entry("tune.robust").check()
    page.click("#tune")
    expect(page.locator("#progress-words")).to_contain_text("Tuning: ")
    # On a busy machine the words come before the process.
    deadline = time.monotonic() + 30.0
    while not (workers := children(paper.served.process.pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert workers
    for worker in workers:
        os.kill(worker, signal.SIGKILL)
    expect(page.locator("#message")).to_contain_text("was ended by SIGKILL", timeout=30_000)
    paper.type("experiment.duration", "1000")
    expect(paper.figure("valve_travel")).to_have_text("12.18 %")


def children(parent: int) -> list[int]:
    """The workers that a server has started (the system's `ps` cuts long command lines)."""
    return [found.pid for found in psutil.Process(parent).children() if "spawn_main" in " ".join(found.cmdline())]


def test_the_scenario_leaves_and_comes_back_to_the_same_screen_and_numbers(paper, tmp_path):
    page = paper.page
    paper.type("loop.controller.Kc", "0.7")
    paper.type("experiment.duration", "0.1")
    paper.entry("experiment.duration.unit").select_option("h")
    paper.settled()
    figures = page.locator("#figures").inner_text()
    paper.view("export")
    with page.expect_download() as download:
        page.click('[data-export="scenario"]')
    path = tmp_path / "scenario.yaml"
    download.value.save_as(path)
    assert download.value.suggested_filename == "scenario.yaml"
    assert page.locator("#scenario").inner_text().strip() == path.read_text().strip()
    path.write_text(path.read_text() + "analyze: {describing_function: false, limit_cycle: false}\n")
    study = wb.run_scenario(path)
    paper.undo_all()
    expect(paper.entry("experiment.duration")).to_have_value("1000")
    expect(paper.entry("experiment.duration.unit")).to_have_value("s")
    page.set_input_files("#open", path)
    expect(paper.entry("experiment.duration")).to_have_value("0.1")
    expect(paper.entry("experiment.duration.unit")).to_have_value("h")
    paper.settled()
    assert page.locator("#figures").inner_text() == figures
    travel = shown("valve_travel", study.cases[0].run.kpis.valve_travel)
    expect(paper.figure("valve_travel")).to_have_text(f"{travel} %")
    paper.view("export")
    with page.expect_download() as download:
        page.click('[data-export="figures"]')
    assert Path(download.value.path()).read_text().startswith("case,Kc,Ti,Td")


def test_a_good_record_is_estimated_and_a_bad_one_says_why(paper, tmp_path):
    page = paper.page
    paper.view("estimate")
    loop = wb.Loop(wb.FOPDT(1.0, 6.0, 2.0), wb.Stenman(1.0), wb.PID(0.6, 15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(300.0, (wb.Step(2.0), wb.Step(1.5, 150.0)), noise=wb.Noise(0.02, 3)))
    rows = [f"{t:g},{r},{y},{u}" for t, r, y, u in zip(run.time, run.sp, run.pv, run.op, strict=True)]
    good = tmp_path / "<b>good<b>.csv"
    good.write_text("\n".join(["time,SP,PV,OP", *rows]))
    page.set_input_files("#record", good)
    expect(page.locator("#record-summary li").nth(0)).to_contain_text("300 samples of 1 s")
    page.click("#estimate")
    expect(page.locator("#verdict strong")).to_have_text("stiction", timeout=60_000)
    paper.picture("estimate")
    page.click("#use-model")
    expect(page.locator("#view-loop")).to_be_visible()
    assert float(paper.entry("loop.valve.d").input_value()) == pytest.approx(1.0, rel=0.05)
    bad = tmp_path / "bad.csv"
    bad.write_text("time,SP,<script>alert(1)</script>\n0,1,2\n1,1,2\n")
    paper.view("estimate")
    page.set_input_files("#record", bad)
    expect(page.locator("#message")).to_contain_text("<script>alert(1)</script>")
    expect(page.locator("#message")).to_contain_text("bad.csv")
    assert "/tmp" not in page.locator("#message").inner_text()
    expect(page.locator("#use-model")).to_be_disabled()


def test_two_sessions_do_not_see_each_other(paper, browser):
    one, other = paper, Opened(browser, paper.served, beside=paper)
    one.type("loop.controller.Kc", "2.01")
    one.view("compare")
    one.page.fill("#pin-name", "mine")
    one.page.press("#pin-name", "Enter")
    expect(one.page.locator("#comparison thead input")).to_have_count(6)
    other.view("compare")
    expect(other.page.locator("#comparison thead input")).to_have_count(5)
    expect(other.entry("loop.controller.Kc")).to_have_value("0.5")
    other.view("loop")
    expect(other.figure("valve_travel")).to_have_text("12.18 %")
    expect(other.page.locator("#undo")).to_be_disabled()
    other.page.close()
    other.check()


def test_a_click_on_the_map_sets_the_tuning(paper):
    # Compiled here, the kernels of a cycle are there for the server: the page is not to wait for a compiler.
    wb.limit_cycle(paper_loop(0.51, 20.0))
    page = paper.page
    paper.view("frequency")
    expect(page.locator("#frequency-lines li").nth(1)).to_contain_text("102.4 s")
    paper.picture("frequency")
    # Fewer cells than the page offers.
    paper.entry("analyze.map.points").evaluate("cells => { cells.append(new Option('4')); }")
    paper.entry("analyze.map.points").select_option("4")
    page.click("#map")
    expect(page.locator("#map-lines li").nth(0)).to_contain_text("4 × 4 tunings", timeout=60_000)
    paper.drawn()
    paper.picture("map")
    # What is zoomed to can be mapped in turn.
    plane = "Bokeh.documents[0].get_model_by_name('f_map')"
    ends = f"[{plane}.x_range.start, {plane}.x_range.end, {plane}.y_range.start, {plane}.y_range.end]"
    page.evaluate(f"() => {{ {plane}.x_range.setv({{start: 0.3, end: 0.9}}); {plane}.y_range.end = 80; }}")
    page.click("#map-view")
    expect(page.locator("#map-lines li").nth(0)).to_contain_text("(Kc 0.3 to 0.9 %/EU", timeout=60_000)
    expect(page.locator("#progress")).to_be_hidden()
    half = 3.0 ** (1 / 6)  # a cell, of 3 from the first to the last
    assert page.evaluate(ends)[:2] == pytest.approx([0.3 / half, 0.9 * half], rel=1e-3)
    box = page.locator("#map-box .picture").bounding_box()
    # A click comes after what was typed before it.
    paper.entry("loop.valve.d").fill("3")
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    expect(paper.entry("loop.controller.Kc")).not_to_have_value("0.5")
    page.click("#undo")
    expect(paper.entry("loop.controller.Kc")).to_have_value("0.5")
    expect(paper.entry("loop.valve.d")).to_have_value("3")


def test_the_front_of_error_and_travel_is_searched_and_drawn(paper):
    page = paper.page
    # A quick plant and a short run need few samples; Case 5 does not hold all of its draws.
    paper.type("loop.plant.time_constant", "1.2")
    paper.type("experiment.duration", "100")
    paper.view("compare")
    for name in ("Case 2", "Case 3", "Case 4"):
        page.click(f'[aria-label="{name}: away"]')
    expect(page.locator("#front-box")).to_be_hidden()
    page.click("#front")
    expect(page.locator("#progress-words")).to_contain_text("Searching the front")
    expect(page.locator("#front")).to_be_disabled()
    paper.type("loop.controller.Kc", "0.7")
    expect(page.locator("#front-lines li").nth(1)).to_contain_text("2,000 random steps", timeout=120_000)
    expect(page.locator("#front-lines li").nth(0)).to_contain_text("as they stood when it was made")
    expect(page.locator("#front-box")).to_be_visible()
    paper.drawn()
    page.locator("#front-box").scroll_into_view_if_needed()
    paper.picture("front")
    drawn = """name => {
      const figure = Bokeh.documents[0].get_model_by_name("c_front");
      return figure.renderers.map(r => Array.from(r.data_source.get(name)));
    }"""
    travel, error = (page.evaluate(drawn, name) for name in ("x", "y"))
    fronts = [i for i, xs in enumerate(travel) if len(xs) > 10]
    assert len(fronts) >= 2
    for i in fronts:
        assert travel[i] == sorted(travel[i])
        assert error[i] == sorted(error[i], reverse=True)
    assert any(len(xs) == 2 for xs in travel), "the page's own tuning, and the case that is stable"


def test_the_layout_holds_at_every_width(paper):
    page = paper.page
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900 if width < 1900 else 1200})
        for view in VIEWS:
            paper.view(view)
            paper.drawn()
            if width == WIDTHS[0] or view == "loop":
                paper.picture(f"{view}_{width}")
            wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            assert wide <= 0, f"{view} at {width}"
            cut = page.evaluate(
                """() => [...document.querySelectorAll("header button, .row button, #inputs input, #inputs select")]
                  .filter((el) => el.offsetParent)
                  .filter((el) => el.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
                  .map((el) => el.id || el.textContent)"""
            )
            assert cut == [], f"{view} at {width}"


def test_leaving_asks_first_where_something_would_be_lost(paper):
    leaving = """() => {
      const event = new Event("beforeunload", { cancelable: true });
      window.dispatchEvent(event);
      return event.defaultPrevented;
    }"""
    assert not paper.page.evaluate(leaving)
    paper.type("loop.controller.Kc", "0.7")
    paper.settled()
    assert paper.page.evaluate(leaving)


def test_a_page_that_another_session_answers_says_that_what_stood_there_is_gone(paper):
    paper.type("loop.controller.Kc", "0.7")
    paper.settled()
    # As the first answer of a server that was started anew.
    paper.page.evaluate(
        """() => {
          const bridge = Bokeh.documents[0].get_model_by_name("bridge");
          bridge.down = JSON.stringify({ ...JSON.parse(bridge.down), sent: 1 });
        }"""
    )
    expect(paper.page.locator("#message")).to_contain_text("The connection was lost, and what stood on this page")
    paper.type("loop.controller.Kc", "0.8")
    expect(paper.page.locator("#message")).to_be_hidden()


def serious_findings(page: Any) -> list[tuple[str, str, list[Any]]]:
    found = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
    return [
        (one["id"], one["help"], [node["target"] for node in one["nodes"]][:4])
        for one in found["violations"]
        if one["impact"] in ("serious", "critical")
    ]


def test_accessibility_has_no_serious_findings(paper):
    start, page = paper, paper.page
    page.add_script_tag(content=AXE.read_text())
    folded = page.locator("details:not([open])").element_handles()
    for part in folded:
        part.evaluate("part => { part.open = true; }")

    def visited(*views: str) -> None:
        """Show these views at once, each filled: most of a look's time goes for the page, not for what it shows."""
        for view in views:
            start.view(view)
            start.settled()
        start.drawn()
        page.evaluate("views => views.forEach((v) => { document.getElementById(`view-${v}`).hidden = false; })", views)

    # a name that is allowed only beside text is a finding while the text is still on its way
    emptied = "id => { document.getElementById(id).textContent = ''; }"
    start.entry("loop.valve.type").select_option("positional")
    start.entry("loop.controller.compensator.type").select_option("two_move")
    visited(*VIEWS)
    assert serious_findings(page) == [], "all views"
    page.set_input_files("#open", ROOT / "scenarios" / "cascade.yaml")
    expect(start.entry("cascade.primary.plant.gain")).to_be_visible()
    visited("loop", "tune", "export")
    page.evaluate(emptied, "scenario")
    assert serious_findings(page) == [], "a cascade, and no scenario's text yet"
    start.view("tune")
    start.view("loop")
    start.settled()
    page.evaluate(emptied, "figures")
    assert serious_findings(page) == [], "the first view alone, and no figures yet"
    for part in folded:
        part.evaluate("part => { part.open = false; }")


def test_a_server_that_has_ended_is_said(paper):
    page = paper.page
    page.clock.install()
    paper.served.process.kill()
    paper.served.process.wait()
    paper.type("loop.controller.Kc", "0.7")
    page.clock.run_for(8000)  # "some seconds", at once
    expect(page.locator("#message")).to_contain_text("No answer for some seconds")
    page.close()
    paper.wrong.clear()  # the browser's own words on the lost connection
