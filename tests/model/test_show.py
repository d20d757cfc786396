"""How results show themselves in a notebook: every row is there, has its unit, and is text."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loops import paper_loop, paper_step

import workbench as wb
from workbench.model.cascade import Appearance, CascadeCycle, CascadeTuned
from workbench.model.front import Front, FrontPoint, RobustRepair
from workbench.model.results import Estimate, Intervals, LinearFit, Outcome, Repair, Restart, Tuned
from workbench.model.show import SHOWN, Shown, rows_of
from workbench.model.study import CaseResult, NamedEstimate, Study

EVIL = "<script>alert(1)</script>"
MODEL = Path(wb.__file__).parent / "model"


class Cells(HTMLParser):
    """Gathers a table's cells by row, and every tag."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, _attrs: Any) -> None:
        self.tags.add(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        if self.rows:
            self.rows[-1][-1] += data


def tuned(loop: wb.Loop) -> Tuned:
    return Tuned(
        loop=loop,
        experiment=paper_step(100.0),
        weights=wb.Objective(),
        bounds=wb.Bounds(),
        controller=wb.PID(2.4, 9.1),
        objective=10.4,
        status=wb.SolveStatus.SOLVED,
        message=f"Made for a test {EVIL}.",
        digits=4,
        nominal=10.3,
        worst=10.5,
        margin=1e-3,
        start_objective=226.6,
        guard_margin=0.01,
        slips=3,
        restarts=(Restart(0, 11.0, 10.3, 100, 1, 10),),
        evaluations=100,
        solves=1,
        iterations=10,
        seed=0,
        wall_time=0.1,
    )


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    """One of each result that shows itself, by the name of its class."""
    loop, step = paper_loop(0.5, 20.0), paper_step(200.0)
    run = wb.simulate(loop, step)
    record = wb.Record(pv=run.pv, op=run.op, sp=run.sp, sample_time=1.0, notes=(EVIL,))
    found = Estimate(
        record=record,
        method="profile",
        plant=wb.Integrating(0.02, 1.0),
        valve=wb.Choudhury(2.0, 1.0),
        valve_position=run.valve,
        prediction=run.pv,
        bias=0.0,
        verdict="no_stiction",
        reasons=("one reason", EVIL),
        intervals=Intervals(S=(1.9, 2.1), gain=(0.019, 0.021)),
        identifiable=False,
        residual_variance=0.01,
        aic=1.0,
        noise_sd=0.1,
        slips=12,
        linear=LinearFit(wb.FOPDT(1.0, 5.0, 1.0), 0.0, run.pv, 1.0, 2.0),
        profile_d=np.array([1.0]),
        profile_cost=np.array([1.0]),
    )
    fares = wb.assess(loop, wb.Ensemble(duration=100.0, setpoint=(1.0, 2.0), draws=5))
    outcome = Outcome(loop.controller, 226.6, run.kpis)
    outer = wb.Loop(wb.FOPDT(1.2, 60.0, 10.0), wb.Ideal(), wb.PID(1.5, 80.0), sample_time=5.0)
    both = wb.simulate(wb.Cascade(outer, loop), step)
    looks = Appearance(1.0, 0.0, 2.0, 0.5, math.nan, 1.0, 10.0, math.nan, 20.0)
    search = tuned(loop)
    point = FrontPoint(loop.controller, 10.0, 0.5)
    front = Front(
        loop,
        fares.ensemble,
        fares.ensemble,
        wb.Constraints(2.0),
        wb.Bounds(),
        4,
        (point, point),
        (),
        wb.SolveStatus.TIME_LIMIT,
        "late",
        0,
        9,
        1.0,
    )
    case = CaseResult(EVIL, loop, run, 226.6)
    study = Study("made", EVIL, "", "", step, None, (NamedEstimate("From data", found),), (case,), notes=("A note.",))
    all_of_them = [
        run.kpis,
        run,
        record,
        found,
        wb.detect(record),
        wb.limit_cycle(loop, step),
        wb.describing_function(loop),
        wb.margins(loop),
        replace(search, robustness=fares, ensemble=fares.ensemble),
        fares,
        Repair(loop, step, wb.Objective(), outcome, outcome, outcome, outcome, search, search),
        RobustRepair(fares, fares, fares, fares, search, search),
        front,
        wb.cycle_map(loop, Kc=(0.1, 5.0), Ti=(2.0, 600.0), points=2, starts=1),
        wb.signature(wb.He(3.0, 2.0)),
        both,
        CascadeCycle(both.cascade, "cycles", "blocks agree", 62.6, 100.0, looks, looks),
        CascadeTuned(both.cascade, step, search, None, 300.0),
        study,
    ]
    return {type(one).__name__: one for one in all_of_them}


def test_every_result_that_is_described_shows_itself_and_no_other(results: dict[str, Any]) -> None:
    assert set(results) == set(SHOWN)
    shown = set()
    for path in MODEL.glob("*.py"):
        module = import_module(f"workbench.model.{path.stem}")
        own = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
        shown |= {one.__name__ for one in own if issubclass(one, Shown) and one is not Shown}
    assert shown == set(SHOWN)


@pytest.mark.parametrize("name", sorted(SHOWN))
def test_a_result_is_a_table_of_text(name: str, results: dict[str, Any]) -> None:
    result = results[name]
    for path in SHOWN[name]:
        value = result
        for part in [] if callable(path) else path.split("."):
            assert value is None or hasattr(value, part), f"{name} has no {path}"
            value = getattr(value, part, None)
    text = result._repr_html_()
    table = Cells(text)
    assert table.tags == {"table", "caption", "tbody", "tr", "th", "td"}
    assert table.rows == [list(row) for row in rows_of(result)]
    assert len(table.rows) >= 3
    assert any(row[0] for row in table.rows)
    assert "object at" not in text
    assert "array(" not in text


def test_figures_have_their_units(results: dict[str, Any]) -> None:
    run = {title: (text, unit) for title, text, unit in rows_of(results["Run"])}
    assert run["Controller"] == ("PID(Kc 0.5 %/EU, Ti 20 s, derivative filter none)", "")
    assert run["Plant"] == ("FOPDT(gain K 1 EU/%, time constant 5 s, dead time 1 s)", "")
    assert run["Mean square error"][1] == "EU²"
    assert run["Valve reversals"] == (str(results["Run"].kpis.reversals), "")
    found = {title: (text, unit) for title, text, unit in rows_of(results["Estimate"])}
    assert found["Plant"][0].startswith("Integrating(gain K 0.02 EU/(% s), ")
    assert found["Gain K, 95 %"] == ("0.01900 to 0.02100", "EU/(% s)")
    assert found["Verdict"] == ("no stiction", "")
    assert found["Identifiable"] == ("no", "")
    cascade = {title: text for title, text, _ in rows_of(results["CascadeRun"])}
    assert cascade["Primary: mean square error"] != cascade["Secondary: mean square error"]
    cycle = {title: text for title, text, _ in rows_of(results["CascadeCycle"])}
    assert {"Primary: PV peak to peak", "Secondary: OP peak to peak"} < cycle.keys(), "symbols keep their capitals"
    repair = {title: text for title, text, _ in rows_of(results["Repair"])}
    assert {"Best: J", "Best: mean square error"} < repair.keys()
    search = {title: text for title, text, _ in rows_of(results["Tuned"])}
    assert search["Status"] == "solved"
    assert search["Worst J near by"] == "10.50"
    assert {title: text for title, text, _ in rows_of(results["Front"])}["Sticky"] == "2"
    parallel = wb.simulate(paper_loop(0.5, 20.0, form="parallel"), paper_step(50.0))
    assert dict(row[:2] for row in rows_of(parallel))["Controller"].startswith("PID(Kc 0.5 %/EU, Ti 20 EU s/%, form")


def test_text_of_data_is_text(results: dict[str, Any]) -> None:
    for name in ("Record", "Estimate", "Study", "Tuned"):
        text = results[name]._repr_html_()
        assert EVIL not in text
        assert "&lt;script&gt;" in text


def test_showing_a_result_loads_nothing_that_draws() -> None:
    code = (
        "import sys, workbench as wb; "
        "loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0); "
        "assert 'Valve travel' in wb.simulate(loop, wb.Experiment(50.0, wb.Step(4.0)))._repr_html_(); "
        "heavy = {'matplotlib', 'jinja2', 'pydantic', 'casadi', 'bokeh'} & set(sys.modules); assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
