"""`wb.cycle_map`: its cells are what the other analyses say of the same tuning, and its borders mean what they say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.analyze import cycle_map as module
from workbench.analyze.cycle_map import map_ranges
from workbench.analyze.frequency import linear_stable
from workbench.analyze.relaxation import relaxation_condition, relaxation_cycle
from workbench.model.cycle_map import OUTCOMES, CycleMap

FLOW = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
TWO = replace(FLOW, valve=wb.Choudhury(4.0, 1.0))
LEVEL = wb.Loop(wb.Integrating(0.02, 4.0), wb.Choudhury(4.0, 1.0), wb.PID(3.0, 60.0), 1.0)
LOOPS = {"flow": FLOW, "two-parameter": TWO, "level": LEVEL}


@pytest.fixture(scope="module")
def maps() -> dict[str, CycleMap]:
    return {name: wb.cycle_map(loop, points=(9, 8)) for name, loop in LOOPS.items()}


def at(found: CycleMap, row: int, column: int) -> wb.Loop:
    tuned = replace(found.loop.controller, Kc=float(found.Kc[column]), Ti=float(found.values[row]))
    return found.loop.with_controller(tuned)


@pytest.mark.parametrize("name", LOOPS)
def test_a_cell_is_what_the_limit_cycle_of_its_tuning_is(maps, name):
    found = maps[name]
    seen = 0
    for row in range(1, 8, 3):
        for column in range(1, 9, 3):
            cycle = wb.limit_cycle(at(found, row, column))
            cell = found.at(float(found.Kc[column]), float(found.values[row]))
            assert cell is not None
            if found.starts < 8 and "depends" in (cell.outcome, cycle.outcome):
                continue  # fewer starts may miss the rarer fate
            assert cell.outcome == cycle.outcome
            if cycle.outcome == "cycles":
                seen += 1
                low, high = cycle.period_range
                assert 0.95 * low <= cell.period <= 1.05 * high
                assert cell.pv_peak_to_peak == pytest.approx(cycle.pv_peak_to_peak, rel=0.05)
            else:
                assert math.isnan(cell.period)
                assert math.isnan(cell.travel_per_hour)
    assert seen >= 4


@pytest.mark.parametrize("name", LOOPS)
def test_stability_and_the_describing_functions_border_are_those_of_each_tuning(maps, name):
    found = maps[name]
    sides = set()
    for row in range(found.values.size):
        for column in range(0, found.Kc.size, 2):
            loop = at(found, row, column)
            assert found.linear_stable[row, column] == linear_stable(loop)
            if row % 3 or not found.linear_stable[row, column]:
                continue
            factor = found.crossing[row, column]
            if abs(math.log(factor)) > 0.02 if factor > 0.0 else True:
                sides.add(factor < 1.0)
                assert wb.describing_function(loop).predicts_cycle == (factor < 1.0)
    assert sides == ({True} if name == "level" else {True, False})


def test_unstable_tunings_grow_and_have_no_figures(maps):
    for found in maps.values():
        grows = (found.outcome == OUTCOMES.index("undecided")) & ~found.linear_stable
        assert grows.any()
        assert np.isnan(found.pv_peak_to_peak[grows]).all()


@pytest.mark.parametrize("form", ["ideal", "series", "parallel"])
def test_the_two_lines_bound_where_the_relaxation_cycle_is_said_to_lie(form):
    loop = FLOW.with_controller(replace(FLOW.controller, form=form, Td=0.5))
    found = wb.cycle_map(loop, Kc=(0.3, 3.0), Ti=(3.0, 60.0), points=5, starts=1)
    inside = (found.loop_gain < 1.0) & (found.lag_ratio > 1.0)
    expected = [[relaxation_condition(at(found, i, j)) for j in range(5)] for i in range(5)]
    assert inside.tolist() == expected
    assert inside.any()
    assert not inside.all()
    assert np.isnan(found.crossing).all() == (form == "parallel")


@pytest.mark.parametrize("loop", [LEVEL, replace(FLOW, valve=wb.Deadband(2.0)), replace(FLOW, valve=wb.Ideal())])
def test_the_two_lines_mean_nothing_on_integrating_plants_and_without_a_jump(loop):
    found = wb.cycle_map(loop, points=2, starts=1)
    assert np.isnan(found.loop_gain).all()
    assert np.isnan(found.lag_ratio).all()


def test_no_cell_is_faster_than_the_closed_form_at_its_shortest(maps):
    checked = 0
    for name in ("flow", "two-parameter"):
        found = maps[name]
        for row in range(found.values.size):
            for column in range(found.Kc.size):
                form = relaxation_cycle(at(found, row, column))
                if form is not None and found.outcome[row, column] == OUTCOMES.index("cycles"):
                    checked += 1
                    assert found.period[row, column] >= 0.9 * form.period
                    assert found.pv_peak_to_peak[row, column] == pytest.approx(form.pv_peak_to_peak, rel=0.05)
    assert checked >= 20


def test_the_papers_case_1_lies_where_its_cycle_is_known():
    found = wb.cycle_map(FLOW, Kc=(0.5, 1.0), Ti=(20.0, 200.0), points=2)
    cell = found.at(0.5, 20.0)
    assert cell is not None
    assert cell.outcome == "cycles"
    assert cell.period == pytest.approx(102.4, rel=0.03)
    assert cell.pv_peak_to_peak == pytest.approx(2.01, rel=0.01)
    assert found.crossing[0, 0] > 1.0, "the describing function is blind here"
    assert found.count("cycles") == 4
    for ask, where in (
        (lambda: found.least("foo"), "figure"),
        (lambda: found.count("foo"), "outcome"),
        (lambda: found.at("a", 1.0), "Kc"),
    ):
        with pytest.raises(wb.InvalidValue, match=where):
            ask()
    calm = found.least("travel_per_hour")
    assert calm is not None
    assert (calm.Kc, calm.value) == (0.5, pytest.approx(200.0))
    assert found.at(0.4, 20.0) is None


def test_rows_may_be_derivative_times():
    found = wb.cycle_map(FLOW, Kc=(0.4, 2.0), Td=(0.0, 2.0), points=(3, 5))
    assert found.axis == "Td"
    assert found.values.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    for row, Td in enumerate(found.values.tolist()):
        loop = FLOW.with_controller(replace(FLOW.controller, Kc=float(found.Kc[1]), Td=Td))
        assert found.linear_stable[row, 1] == linear_stable(loop)
        low, high = wb.limit_cycle(loop).period_range
        assert 0.95 * low <= found.period[row, 1] <= 1.05 * high


def test_the_number_of_threads_changes_nothing(monkeypatch):
    several = wb.cycle_map(TWO, points=4, starts=2)
    monkeypatch.setattr(module, "cores", lambda: 1)
    alone = wb.cycle_map(TWO, points=4, starts=2)
    for name in ("outcome", "period", "mean_square_error", "crossing", "linear_stable", "window"):
        assert np.array_equal(getattr(several, name), getattr(alone, name), equal_nan=True)


def test_progress_rises_to_the_end():
    told: list[float] = []
    wb.cycle_map(FLOW, points=3, starts=1, progress=told.append)
    assert told == sorted(told)
    assert len(told) == 3
    assert told[-1] == 1.0


def test_an_interrupt_ends_the_work_within_a_cell(monkeypatch):
    followed = []
    real = module.follow

    def counted(*args, **options):
        followed.append(1)
        return real(*args, **options)

    monkeypatch.setattr(module, "follow", counted)

    def stop(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        wb.cycle_map(FLOW, points=(4, 40), starts=1, progress=stop)
    assert len(followed) < 80, "of 160 cells"


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"Ti": (1.0, 2.0), "Td": (0.0, 1.0)}, "cycle_map.Td"),
        ({"Kc": (0.0, 1.0)}, "cycle_map.Kc"),
        ({"Kc": (2.0, 1.0)}, "cycle_map.Kc"),
        ({"Kc": (1.0, math.inf)}, "cycle_map.Kc"),
        ({"Ti": (0.0, 10.0)}, "cycle_map.Ti"),
        ({"Td": (-1.0, 10.0)}, "cycle_map.Td"),
        ({"Ti": "fast"}, "cycle_map.Ti"),
        ({"points": 1}, "cycle_map.points"),
        ({"points": (3, 401)}, "cycle_map.points"),
        ({"points": (3, 3, 3)}, "cycle_map.points"),
        ({"points": 2.5}, "cycle_map.points"),
        ({"starts": 0}, "cycle_map.starts"),
        ({"starts": 9}, "cycle_map.starts"),
    ],
)
def test_bad_input_is_one_clear_error(options, where):
    with pytest.raises(wb.InvalidValue, match=where.replace(".", r"\.")):
        wb.cycle_map(FLOW, **options)


def test_only_a_loop_has_a_map():
    with pytest.raises(wb.InvalidValue, match="must be a Loop"):
        wb.cycle_map("loop")


@given(
    Kc=st.floats(1e-3, 100.0),
    Ti=st.floats(0.1, 1e5),
    gain=st.sampled_from([0.02, 1.0, -3.0]),
    integrating=st.booleans(),
    form=st.sampled_from(["ideal", "series", "parallel"]),
)
@settings(max_examples=60, deadline=None)
def test_ranges_hold_the_tunings_and_reach_from_calm_to_unstable(Kc, Ti, gain, integrating, form):
    plant = wb.Integrating(gain / 30.0, 5.0) if integrating else wb.FOPDT(gain, 30.0, 5.0)
    controller = wb.PID(Kc, Ti, form=form, action="reverse" if gain > 0.0 else "direct")
    loop = wb.Loop(plant, wb.Stenman(1.0), controller, 1.0)
    ranges = map_ranges(loop, [controller, replace(controller, Ti=math.inf)])
    assert ranges["Kc"][0] <= Kc <= ranges["Kc"][1]
    assert ranges["Ti"][0] <= Ti <= ranges["Ti"][1]
    usual = map_ranges(loop)["Kc"]
    proportional = replace(controller, form="ideal", Ti=math.inf)
    assert linear_stable(loop.with_controller(replace(proportional, Kc=usual[0])))
    assert not linear_stable(loop.with_controller(replace(proportional, Kc=usual[1])))
