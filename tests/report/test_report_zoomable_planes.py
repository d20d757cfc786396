"""The zoomable map and front of a report: what they draw is the study's, and each has its place in the page."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import workbench as wb
from workbench.model.cycle_map import CycleMap
from workbench.model.front import Front, FrontPoint
from workbench.model.results import SolveStatus
from workbench.model.study import Study
from workbench.report import interactive_planes
from workbench.report.interactive import zoomable
from workbench.report.interactive_planes import front_plane, map_planes
from workbench.report.page import write_report
from workbench.report.plain_truth import map_points
from workbench.report.trade import NamedPoint

SCRIPT = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def plane() -> CycleMap:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
    return wb.cycle_map(loop, Kc=(0.1, 10.0), Ti=(3.0, 300.0), points=(7, 6), starts=1)


def test_an_axis_leaves_out_numbers_that_would_stand_on_others(study: Study) -> None:
    fig = front_plane(front_of(study.cases[0].loop), [])
    assert [type(axis.major_label_policy).__name__ for axis in fig.axis] == ["NoOverlap", "NoOverlap"]


def front_of(loop: wb.Loop) -> Front:
    ensemble = replace(wb.Ensemble.plant_ready(loop), duration=200.0, load_time=(50.0, 100.0), draws=20)
    sticky = tuple(
        FrontPoint(replace(loop.controller, Kc=Kc, Ti=12.3), travel, error)
        for Kc, travel, error in ((0.1, 0.0, 3.0), (0.3, 10.0, 0.9), (0.6, 20.0, 0.5))
    )
    return Front(
        loop=loop,
        ensemble=ensemble,
        fresh=ensemble,
        constraints=wb.Constraints(),
        bounds=wb.Bounds(Td=(0, 0)),
        digits=3,
        sticky=sticky,
        repaired=(),
        status=SolveStatus.SOLVED,
        message="made for a test",
        seed=0,
        evaluations=1,
        wall_time=1.0,
    )


@pytest.fixture(scope="module")
def told(study: Study, plane: CycleMap) -> Study:
    cases = tuple(replace(case, name=f"{SCRIPT} {i}") for i, case in enumerate(study.cases))
    return replace(study, estimates=(), cases=cases, cycle_map=plane, front=front_of(study.cases[0].loop))


@pytest.fixture(scope="module")
def page(told: Study, write_undrawn: Callable[..., None], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planes")
    write_undrawn(told, folder, interactive=True)
    return folder / "report.html"


def figures_of(grid: Any) -> list[Any]:
    return [child for child, *_ in grid.children]


def test_the_map_draws_each_cells_figures_and_greys_what_is_unstable(plane: CycleMap, told: Study) -> None:
    figures = figures_of(map_planes(plane, map_points(told)))
    assert len(figures) == 4
    assert len({id(fig.x_range) for fig in figures}) == len({id(fig.y_range) for fig in figures}) == 1
    data = figures[0].renderers[0].data_source.data
    held = plane.cycles & plane.linear_stable
    assert 0 < held.sum() < held.size
    assert np.array_equal(np.isfinite(data["period"]), held.ravel())
    assert data["period"][held.ravel()] == pytest.approx(plane.period[held], rel=1e-6)
    assert np.array_equal(data["grey"] == 1.0, ~plane.linear_stable.ravel())
    for row, column in ((0, 0), (5, 6), (2, 3)):
        k = row * plane.Kc.size + column
        assert data["left"][k] < plane.Kc[column] < data["right"][k]
        assert data["bottom"][k] < plane.values[row] < data["top"][k]
    # Neighbours meet, so that no tuning lies between cells.
    assert data["right"][0] == data["left"][1]
    assert data["top"][0] == data["bottom"][plane.Kc.size]


def test_borders_lie_where_their_field_is_0(plane: CycleMap) -> None:
    fig = figures_of(map_planes(plane, []))[0]
    lines = {tool.tooltips: tool.renderers[0].data_source.data for tool in fig.hover if isinstance(tool.tooltips, str)}
    assert lines["Ti = tau + theta"]["y"] == pytest.approx(6.0)
    assert lines["Kc K J/S = 1"]["x"] == pytest.approx(1.0)


def test_a_map_of_too_many_cells_stays_still(told: Study, plane: CycleMap, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interactive_planes, "MOST_CELLS", plane.outcome.size - 1)
    assert map_planes(plane, []) is None
    zoom = zoomable(replace(told, cases=()))
    assert zoom.plane == ""
    assert zoom.front != ""


def test_each_point_of_a_front_says_its_tuning(study: Study) -> None:
    named = [NamedPoint("Mine", 12.0, 0.8, tuned=True), NamedPoint("Wild", math.inf, math.inf)]
    fig = front_plane(front_of(study.cases[0].loop), named)
    data = fig.renderers[0].data_source.data
    assert data["x"].tolist() == [10.0, 20.0], "logarithms hold no travel of 0"
    assert data["tuning"] == ["Kc 0.300 %/EU, Ti 12.3 s", "Kc 0.600 %/EU, Ti 12.3 s"]
    names = [r.data_source.data["name"] for r in fig.renderers if "name" in r.data_source.data]
    assert names == [["Mine"], ["Mine"]]


@pytest.mark.usefixtures("undrawn")
def test_planes_have_their_places_and_names_stay_text(told: Study, page: Path, tmp_path: Path) -> None:
    html = page.read_text()
    roots = re.search(r'"roots":(\{.*?\})', html)
    assert roots is not None
    # Trend and PV-OP of each case, all together, map and front.
    assert len(json.loads(roots[1])) == html.count("data-root-id") == 2 * len(told.cases) + 3
    assert len(re.findall('class="[^"]*still[^"]*"', html)) == len(told.cases) + 3
    assert "<script>alert(1)" not in html
    write_report(replace(told, cases=told.cases[:1]), tmp_path)
    assert "<script" not in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_a_box_in_one_figure_of_the_map_zooms_all_of_them(browser: Any, page: Path) -> None:
    shown = browser.new_page(viewport={"width": 1280, "height": 1000})
    wrong: list[str] = []
    shown.on("pageerror", lambda error: wrong.append(str(error)))
    shown.goto(page.as_uri())
    figures = shown.locator(".zoom").filter(has_text="Each cell is one tuning").locator(".bk-Figure")
    figures.first.wait_for(state="visible")
    assert figures.count() == 4
    figures.nth(1).scroll_into_view_if_needed()
    ends = (
        "Bokeh.documents.flatMap(d => d.roots()).filter(r => r.type === 'GridPlot')"
        ".flatMap(g => g.children.map(c => c[0].x_range.end))"
    )
    before = shown.evaluate(ends)
    box = figures.nth(1).bounding_box()
    shown.mouse.move(box["x"] + 150, box["y"] + 100)
    shown.mouse.down()
    shown.mouse.move(box["x"] + 260, box["y"] + 180, steps=5)
    shown.mouse.up()
    shown.wait_for_function(f"(was => {ends}.every((end, i) => end < 0.9 * was[i]))({before})")
    assert wrong == []
    shown.close()
