"""Zoomable figures: only where asked for, all in the page, bounded, and never in the way of print or of no scripts."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from workbench.model.experiment import Experiment, Noise, Step
from workbench.model.study import Study
from workbench.report.interactive import SAMPLES, zoomable
from workbench.report.page import write_report
from workbench.simulate.run import simulate

Make = Callable[..., Any]
SCRIPT = "</script><script>alert(1)</script>"
LIBRARY = 1_400_000  # bytes of Bokeh's own script, with room for the next version


def cases_of(study: Study) -> Study:
    return replace(study, estimates=())


@pytest.fixture(scope="module")
def named(study: Study, write_undrawn: Callable[..., None], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page to zoom in whose title and cases are named as scripts."""
    folder = tmp_path_factory.mktemp("named")
    told = cases_of(study)
    cases = tuple(replace(case, name=f"{SCRIPT} {i}") for i, case in enumerate(told.cases))
    write_undrawn(replace(told, title=SCRIPT, cases=cases), folder, interactive=True)
    return folder / "report.html"


def test_the_page_has_none_of_it_unless_asked(study: Study, written: Path, tmp_path: Path) -> None:
    page = (written / "report.html").read_text()
    assert "<script" not in page
    assert '"still"' not in page
    write_report(replace(cases_of(study), cases=()), tmp_path, interactive=True)
    assert "<script" not in (tmp_path / "report.html").read_text(), "nothing to zoom in"


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("count", [1, 2])
def test_the_page_has_a_place_for_each_figure_of_its_script(study: Study, tmp_path: Path, count: int) -> None:
    # Bokeh draws none of them where it does not find one.
    told = replace(cases_of(study), cases=study.cases[:count])
    zoom = zoomable(told)
    assert (zoom.overlay == "") == (count == 1)
    write_report(told, tmp_path, interactive=True)
    page = (tmp_path / "report.html").read_text()
    places = [*(place for pair in zoom.cases for place in pair), *([zoom.overlay] if count > 1 else [])]
    roots = re.search(r'"roots":(\{.*?\})', str(zoom.script))
    assert roots is not None
    assert len(json.loads(roots[1])) == len(places)
    assert page.count("data-root-id") == len(places)


def test_names_stay_text(named: Path) -> None:
    assert "<script>alert(1)" not in named.read_text()


def test_long_runs_are_thinned_to_what_bounds_the_page(study: Study) -> None:
    case = study.cases[0]
    run = simulate(case.loop, Experiment(duration=200_000.0, setpoint=Step(4.0), noise=Noise(0.1, 1)))
    told = replace(cases_of(study), cases=(replace(case, run=run),) * 3)
    made = zoomable(told)
    assert len(made.library) < LIBRARY
    # A case has at most nine series of two numbers in single precision, in base64.
    assert len(made.script) < SAMPLES * 9 * 2 * 4 * 4 / 3
    assert len(made.cases) == 3


@pytest.mark.slow
def test_figures_zoom_on_a_screen_and_stay_still_elsewhere(named: Path, browser: Any) -> None:
    where = named.as_uri()
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(10_000)
    wrong: list[str] = []
    asked: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("dialog", lambda dialog: (wrong.append(dialog.message), dialog.dismiss()))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(where)
    ends = "Bokeh.documents.flatMap(d => d.roots()).map(root => root.children[0].x_range.end)"
    page.wait_for_function(f"window.Bokeh && {ends}.length === 7")
    figures = page.locator(".zoom .bk-Figure")
    figures.first.wait_for(state="visible")
    assert figures.count() == 2 * 7
    assert page.locator(".still").first.is_hidden()
    before = page.evaluate(ends)
    figures.nth(2).scroll_into_view_if_needed()
    box = figures.nth(2).bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 80)
    page.mouse.down()
    page.mouse.move(box["x"] + 250, box["y"] + 140, steps=5)
    page.mouse.up()
    page.wait_for_function(f"(was => {ends}.some((end, i) => end < 0.8 * was[i]))({before})")
    page.emulate_media(media="print")
    assert page.locator(".still").first.is_visible()
    assert page.locator(".zoom").first.is_hidden()
    assert not wrong
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    page.close()
    quiet = browser.new_context(java_script_enabled=False).new_page()
    quiet.goto(where)
    assert quiet.locator(".still").first.is_visible()
    assert quiet.locator(".zoom").first.is_hidden()
    quiet.context.close()
