"""The worked example runs from its first cell to its last, and says what its own text says.

All that is asked of it is one test, as running it takes long and tests of one file may run in several processes.
"""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

import workbench as wb

EXAMPLE = Path(__file__).parents[2] / "scenarios" / "worked_example.py"


def ran() -> dict[str, Any]:
    """What the example's names are in the end."""
    before = mpl.get_backend()
    mpl.use("Agg")
    try:
        return runpy.run_path(str(EXAMPLE))
    finally:
        import matplotlib.pyplot as plt

        plt.close("all")
        mpl.use(before)


def the_record_gives_back_the_loop_that_made_it(names: dict[str, Any]) -> None:
    found = names["found"]
    assert found.verdict == names["evidence"].verdict == "stiction"
    assert found.valve.d == pytest.approx(0.63, rel=0.02)
    assert found.plant.gain == pytest.approx(0.56, rel=0.05)
    assert found.plant.time_constant == pytest.approx(21.0, rel=0.05)
    assert found.plant.dead_time == pytest.approx(5.0, abs=1.0)
    assert found.identifiable
    for pair, truth in (
        (found.intervals.d, 0.63),
        (found.intervals.gain, 0.56),
        (found.intervals.time_constant, 21.0),
        (found.intervals.dead_time, 5.0),
    ):
        assert pair is not None
        assert pair[0] <= truth <= pair[1]


def the_analyses_say_what_the_text_says(names: dict[str, Any]) -> None:
    assert names["cycle"].outcome == "cycles"
    assert not names["loci"].predicts_cycle
    loop, found = names["loop"], names["found"]
    assert loop.controller.Kc * found.plant.gain < 1.0
    assert loop.controller.Ti > found.plant.time_constant + found.plant.dead_time


def the_tuning_is_better_and_verified(names: dict[str, Any]) -> None:
    tuned, runs = names["tuned"], names["runs"]
    assert tuned.status is wb.SolveStatus.SOLVED
    assert tuned.objective < 0.7 * tuned.start_objective
    assert runs["retuned"].kpis.mean_square_error < 0.7 * runs["as found"].kpis.mean_square_error
    assert runs["integral detuned"].kpis.valve_travel < runs["as found"].kpis.valve_travel
    assert 0.0 < names["repair"].share("mean_square_error") < 1.0


def each_cell_ends_with_what_a_notebook_shows(names: dict[str, Any]) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    cells = [cell for cell in re.split(r"^# %%.*\n", text, flags=re.M)[1:] if not cell.startswith("# ")]
    assert len(cells) >= 8
    shown = 0
    for cell in cells:
        last = ast.parse(cell).body[-1]
        if isinstance(last, ast.Expr) and isinstance(last.value, ast.Name):
            assert "<table>" in names[last.value.id]._repr_html_()
            shown += 1
    assert shown >= 7


@pytest.mark.slow
def test_the_example_says_what_its_text_says() -> None:
    names = ran()
    the_record_gives_back_the_loop_that_made_it(names)
    the_analyses_say_what_the_text_says(names)
    the_tuning_is_better_and_verified(names)
    each_cell_ends_with_what_a_notebook_shows(names)
