"""The map in the report: its figure, its sentences and its place in results.json; and the plain truth about cycles."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

import workbench as wb
from workbench.model.cycle_map import OUTCOMES, CycleMap
from workbench.model.study import CaseResult, Study
from workbench.report.draw_map import SHADES, MapPoint, _bands, map_figure
from workbench.report.page import write_report
from workbench.report.plain_truth import lasting, map_points, map_text
from workbench.report.results import results_json
from workbench.report.style import svg_text

Make = Callable[..., Any]
LOOP = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)


def made(all_of_them: str = "cycles", **changed: Any) -> CycleMap:
    """A map of 6 rows and 5 columns whose last column is unstable and grows; figures fall with Kc and grow with Ti."""
    Kc, Ti = np.geomspace(0.1, 10.0, 5), np.geomspace(3.0, 300.0, 6)
    stable = np.ones((6, 5), bool)
    stable[:, -1] = False
    period = 10.0 * Ti[:, None] / Kc[None, :]
    codes = np.full((6, 5), OUTCOMES.index(all_of_them), np.int8)
    codes[:, -1] = OUTCOMES.index("undecided")
    there = (codes == OUTCOMES.index("cycles")) | (codes == OUTCOMES.index("depends"))

    def figures(values: Any) -> Any:
        return np.where(there, values, math.nan)

    fields: dict[str, Any] = {
        "loop": LOOP,
        "axis": "Ti",
        "Kc": Kc,
        "values": Ti,
        "starts": 4,
        "outcome": codes,
        "period": figures(period),
        "pv_peak_to_peak": figures(2.0 - 0.1 * Kc[None, :] + 0.0 * period),
        "mean_square_error": figures(1.0 / period),
        "travel_per_hour": figures(1e4 / period),
        "window": figures(3.0 * period),
        "linear_stable": stable,
        "crossing": 1.5 / Kc[None, :] + 0.0 * period,
        "loop_gain": Kc[None, :] + 0.0 * period,
        "lag_ratio": Ti[:, None] / 6.0 + 0.0 * period,
    }
    return CycleMap(**{**fields, **changed})


def texts(fig: Figure) -> str:
    return "\n".join(text.get_text() for legend in fig.legends for text in legend.get_texts())


@given(
    st.lists(st.floats(1e-9, 1e12), min_size=1, max_size=60),
    st.booleans(),
    st.lists(st.sampled_from([0.0, math.nan]), max_size=3),
)
def test_every_value_lies_in_one_of_at_most_eight_bands(values, time, others):
    array = np.array(values + others)
    bands = _bands(array, time=time)
    assert 1 <= len(bands) <= len(SHADES)
    for value in values:
        assert sum(low <= value < high for low, high, _ in bands) == 1
    for (_, high, _), (low, _, _) in pairwise(bands):
        assert high == low
    assert len({words for *_, words in bands}) == len(bands)


@pytest.mark.parametrize(
    "values", [[1e-9, 1e12] + [3.0] * 200, [1e-9] + [3.0] * 200, [1e12] + [3.0] * 200, [np.nextafter(1.0, 0.0)]]
)
def test_outliers_fall_into_open_bands(values):
    bands = _bands(np.array(values), time=False)
    assert len(bands) <= 2
    for value in values:
        assert sum(low <= value < high for low, high, _ in bands) == 1


def test_bands_are_round_and_finer_for_narrow_ranges():
    assert [words for *_, words in _bands(np.array([1.0, 1.1, 1.3]), time=False)] == ["1 to 1.2", "1.2 to 1.5"]
    assert [words for *_, words in _bands(np.array([40.0, 200.0]), time=True)] == [
        "30 s to 1 min",
        "1 min to 2 min",
        "2 min to 5 min",
    ]
    assert _bands(np.array([math.nan]), time=False) == []


def test_the_figure_holds_borders_patterns_and_tunings():
    outcome = made().outcome.copy()
    outcome[0, 0] = OUTCOMES.index("depends")
    outcome[1, 0] = OUTCOMES.index("settles")
    outcome[2, 0] = OUTCOMES.index("undecided")
    points = [MapPoint("As found", 0.5, 20.0), MapPoint("Tuned", 2.0, 9.0, tuned=True), MapPoint("Far", 50.0, 9.0)]
    fig = map_figure(made(outcome=outcome), points)
    key = texts(fig)
    for part in ("loci meet", "Kc K J/S = 1", "Ti = tau + theta", "unstable beyond", "PV grows", "undecided"):
        assert part in key
    assert "comes to rest" in key
    assert "depends on the start" in key
    assert "1  As found" in key
    assert "2  Tuned" in key
    assert "Far" not in key, "outside the map"
    assert len(fig.axes) == 4


def test_what_is_not_there_is_not_in_the_key():
    nothing = np.full((6, 5), math.nan)
    key = texts(map_figure(made(loop_gain=nothing, lag_ratio=nothing, crossing=nothing)))
    assert "Ti = tau" not in key
    assert "loci" not in key
    assert "comes to rest" not in key


def test_a_map_without_any_cycle_is_drawn():
    fig = map_figure(made("settles"))
    assert "comes to rest" in texts(fig)
    assert svg_text(fig, "map").startswith("<svg")


@pytest.mark.parametrize(
    ("Kc", "expected"), [((0.1, 10.0), ["0.1", "0.2", "0.5", "1", "2", "5", "10"]), ((1.1, 1.9), ["1.1", "1.9"])]
)
def test_ticks_are_round_where_there_is_room(Kc, expected):
    own = Figure().subplots()
    wb.plot(made(Kc=np.geomspace(*Kc, 5)), own)
    assert [label.get_text() for label in own.get_xticklabels()] == expected
    assert all(-1e-6 <= place <= 4.0 + 1e-6 for place in own.get_xticks())


def test_the_figure_is_the_same_to_the_byte_each_time():
    points = [MapPoint("A < B", 0.5, 20.0), MapPoint("Beside", 0.6, 25.0, beside=True)]
    assert svg_text(map_figure(made(), points), "map") == svg_text(map_figure(made(), points), "map")


def test_plot_draws_a_map():
    axes = wb.plot(made())
    assert isinstance(axes, np.ndarray)
    assert axes.shape == (4,)
    own = Figure().subplots()
    assert wb.plot(made(), own) is own
    assert own.get_title(loc="left") == "late period"


def test_the_cell_under_a_tuning_and_the_counts():
    found = made()
    cell = found.at(0.32, 20.0)
    assert cell is not None
    assert cell.Kc == pytest.approx(0.316, rel=0.01)
    assert cell.value == pytest.approx(18.9, rel=0.01)
    assert cell.outcome == "cycles"
    assert found.at(0.09, 20.0) is None
    assert found.count("cycles") == 24
    assert found.count("undecided") == 0, "unstable cells do not count"
    least = found.least("mean_square_error")
    assert least is not None
    assert (least.Kc, least.value) == (pytest.approx(0.1), pytest.approx(300.0))
    assert made("settles").least("period") is None


def test_the_sentences_of_a_map():
    told = " ".join(map_text(made()))
    assert "Each of 5 × 6 tunings (Kc 0.1 to 10 %/EU, Ti 3 to 300 s, Td 0 s)" in told
    assert "stable at 24 of them. Of these, all keep cycling from every start tried." in told
    # Kc below 1.5: columns 0.1, 0.316 and 1.
    assert "sees no crossing at 18 of the 24 stable tunings" in told
    assert "(10 stable tunings)" in told
    assert "comes" not in told


def test_the_sentences_follow_the_outcomes():
    outcome = made().outcome.copy()
    outcome[0, :2] = OUTCOMES.index("settles")
    told = " ".join(map_text(made(outcome=outcome)))
    assert "Of these, 22 keep cycling from every start tried and 2 come to rest from every start tried." in told
    nothing = np.full((6, 5), math.nan)
    level = replace(LOOP, plant=wb.Integrating(0.02, 4.0))
    told = " ".join(map_text(made(loop=level, loop_gain=nothing, lag_ratio=nothing, crossing=0.0 * made().crossing)))
    assert "mean nothing of an integrating plant, and are not drawn" in told
    assert "sees a crossing at every stable tuning that cycles" in told


def test_cases_beside_the_plane_are_marked_so(study: Study) -> None:
    mapped = replace(study, cycle_map=made())
    points = map_points(mapped)
    assert [p.name for p in points] == [c.name for c in study.cases]
    for point, case in zip(points, study.cases, strict=True):
        assert point.beside == (case.loop.controller.Td != 0.0)
        assert point.tuned == (case.tuned is not None)
    assert map_points(study) == []


def test_results_hold_the_map_in_rows(study: Study) -> None:
    assert "map" not in json.loads(results_json(study))
    content = json.loads(results_json(replace(study, cycle_map=made())))["map"]
    assert content["axis"] == "Ti"
    assert len(content["Kc"]) == 5
    assert content["outcome"][0] == "cycles cycles cycles cycles undecided"
    assert content["linear_stable"] == ["11110"] * 6
    assert content["period"][0].split()[0] == "300"
    assert content["period"][0].split()[-1] == "-"


@pytest.mark.usefixtures("undrawn")
def test_the_report_shows_the_map(study: Study, tmp_path) -> None:
    write_report(replace(study, estimates=(), cycle_map=made()), tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert (tmp_path / "map.svg").exists()
    assert "Which tunings cycle, and how" in page
    assert "come to rest" not in page.split("Which tunings cycle")[1].split("<h2>")[0]
    write_report(replace(study, cases=(), estimates=()), tmp_path)
    assert not (tmp_path / "map.svg").exists()


def test_what_remains_at_best_is_the_least_of_all_that_was_measured(study: Study) -> None:
    best = study.cases[0]
    told = " ".join(lasting(replace(study, cycle_map=made()), best))
    assert "24 of the map among them" in told
    # The least swing of the made map: 2 - .1 Kc at the largest stable Kc, with the unstable column next to it.
    assert "PV swings least, 1.68 EU" in told
    assert "Kc 3.16 %/EU and Ti 3.00 s" in told
    assert "within a factor 2" not in told
    assert "the valve moves least, 0.333 % an hour, with Kc 0.100 %/EU and Ti 300 s" in told
    assert "is a matter of repair, not of tuning" in told
    plain = " ".join(lasting(study, best))
    assert f"of {len(study.cases)} tunings whose cycle" in plain
    assert "Whether another tuning would do, a map of tunings shows" in plain
    near = made(Kc=np.array([0.1, 0.3, 1.0, 3.0, 5.0]))
    assert "within a factor 2 in gain of instability" in " ".join(lasting(replace(study, cycle_map=near), best))


def test_tunings_that_come_to_rest_are_named_beside_those_that_cycle(study: Study) -> None:
    outcome = made().outcome.copy()
    outcome[0, :2] = OUTCOMES.index("settles")
    told = " ".join(lasting(replace(study, cycle_map=made(outcome=outcome)), study.cases[0]))
    assert "come to rest from the start given or from every start tried: 2 of the map." in told


def travels(case: CaseResult, *rates: float) -> CaseResult:
    """The case with a cycle whose valve travels so far (% an hour) from each of its starts."""
    cycle = case.limit_cycle
    assert cycle is not None
    starts = tuple(replace(start, travel_per_hour=rate) for start, rate in zip(cycle.starts, rates, strict=True))
    return replace(case, limit_cycle=replace(cycle, travel_per_hour=rates[0], starts=starts))


def test_slower_integral_action_is_compared_where_the_swing_stays(study: Study, cycle: Make) -> None:
    first = study.cases[0]
    slow_loop = first.loop.with_controller(replace(first.loop.controller, Ti=200.0))
    as_far = replace(first, name="Slow", loop=slow_loop, limit_cycle=cycle(slow_loop, period=3000.0))
    slow = travels(as_far, 14.2, 17.5)
    told = " ".join(lasting(replace(study, cases=(first, slow)), first))
    assert "Slower integral action spares the valve and does not shrink the cycle" in told
    assert "Slow (Ti 200 s) every 50 min" in told
    shrunk = replace(slow, limit_cycle=replace(slow.limit_cycle, pv_peak_to_peak=1.0))
    assert "Slower integral" not in " ".join(lasting(replace(study, cases=(first, shrunk)), first))
    for hardly in (as_far, travels(as_far, 14.2, 135.0)):
        assert "Slower integral" not in " ".join(lasting(replace(study, cases=(first, hardly)), first)), (
            "spares nothing"
        )


def test_what_tuning_removes_is_the_cycle_of_an_unstable_loop(study: Study) -> None:
    first = study.cases[0]
    wild = replace(first, describing_function=replace(first.describing_function, linear_stable=False))
    told = " ".join(lasting(replace(study, cases=(wild, *study.cases[1:])), study.cases[-1]))
    assert f"What tuning removes: the part of the cycle of {first.name} that is not the valve's." in told
    assert "What tuning removes" not in " ".join(lasting(study, study.cases[-1]))


def test_nothing_lasting_is_said_without_integral_action_or_friction(study: Study) -> None:
    first = study.cases[0]
    assert lasting(study, first) != []
    proportional = first.loop.with_controller(replace(first.loop.controller, Ti=math.inf))
    for loop in (proportional, replace(first.loop, valve=wb.Ideal())):
        assert lasting(study, replace(first, loop=loop, limit_cycle=None)) == []
