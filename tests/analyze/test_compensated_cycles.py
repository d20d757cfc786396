"""Long runs of loops with a compensator against plain runs, and the methods that do not know one."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from loops import paper_loop, paper_step

import workbench as wb
from workbench.analyze.relaxation import relaxation_condition, relaxation_cycle


@pytest.mark.parametrize(
    "compensator",
    [
        wb.Knocker(2.5, 1.0, 5.0),
        wb.Knocker(1.0, 2.0, 10.0),
        wb.ConstantReinforcement(2.0),
        wb.Dither(3.0, 10.0),
        wb.Dither(3.0, 2.0, "square"),
    ],
)
def test_cycles_are_those_of_a_plain_run(compensator):
    loop = paper_loop(0.5, 20.0, compensator=compensator)
    cycle = wb.limit_cycle(loop, paper_step())
    assert cycle.outcome == "cycles"
    run = wb.simulate(loop, paper_step(200_000.0))
    late = slice(150_000, None)
    moves = np.diff(run.valve[late.start - 1 :])
    ways = np.sign(moves[moves != 0.0])
    reversals = np.count_nonzero(ways[1:] != ways[:-1])
    assert cycle.period == pytest.approx(2.0 * 50_000.0 / reversals, rel=0.02)
    assert cycle.travel_per_hour == pytest.approx(np.abs(moves).sum() / 50_000.0 * 3600.0, rel=0.02)
    assert cycle.mean_square_error == pytest.approx(np.mean((4.0 - run.pv[late]) ** 2), rel=0.03)
    assert cycle.closed_form is None
    assert math.isnan(cycle.closed_form_period)


@pytest.mark.parametrize("valve", [wb.Stenman(2.0), wb.Choudhury(2.0, 1.0), wb.Kano(3.0, 1.0), wb.He(2.0, 0.5)])
def test_an_integral_deadband_as_wide_as_a_slip_settles_from_every_start(valve):
    pid = wb.PID(0.5, 20.0, compensator=wb.IntegralDeadband(valve.slip_jump + 0.1))
    cycle = wb.limit_cycle(wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), valve, pid, 1.0))
    assert cycle.outcome == "settles"
    for start in cycle.starts:
        assert abs(start.rest_error) <= pid.compensator.band
    assert any(abs(start.rest_error) > 0.01 for start in cycle.starts)
    assert "rests within its deadband" in {start.reason for start in cycle.starts}.pop()


def test_a_narrow_integral_deadband_does_not_stop_the_cycle():
    cycle = wb.limit_cycle(paper_loop(0.5, 20.0, compensator=wb.IntegralDeadband(0.1)))
    assert cycle.outcome != "settles"


def test_reset_scheduling_makes_the_relaxation_cycle_as_slow_as_its_ratio():
    # All of the resting error lies within the band, so that Ti is 16 times as long: the period's closed form says it.
    slow = wb.limit_cycle(paper_loop(0.5, 20.0, compensator=wb.IntegralDeadband(3.0, ratio=16.0)), paper_step())
    assert slow.outcome == "cycles"
    least = relaxation_cycle(paper_loop(0.5, 320.0)).period
    assert least * 0.98 <= slow.period_range[0] <= slow.period_range[1]
    assert slow.pv_peak_to_peak == pytest.approx(2.0, rel=0.02)


def test_two_moves_settle_where_the_output_is_known_and_hold_an_error_elsewhere():
    known = wb.limit_cycle(paper_loop(0.5, 20.0, compensator=wb.TwoMove(4.5, 300.0, 4.0)), paper_step())
    assert known.starts[0].reason == "PV comes to rest on the setpoint"
    # The other starts have another resting output: held at this one they rest off their setpoints.
    held = wb.limit_cycle(paper_loop(0.5, 20.0, compensator=wb.TwoMove(4.5, at=300.0, steady_output=4.0)))
    assert held.outcome == "settles"
    assert all("OP is held after the two moves" in start.reason for start in held.starts)
    assert max(abs(start.rest_error) for start in held.starts) > 5.0


def test_what_knows_no_compensator_says_so():
    loop = paper_loop(0.5, 20.0, compensator=wb.Knocker(2.5, 1.0, 5.0))
    with pytest.raises(wb.InvalidValue, match="holds for the loop without it"):
        wb.describing_function(loop)
    assert relaxation_cycle(loop) is None
    assert not relaxation_condition(loop)
    drawn = wb.cycle_map(loop, (0.3, 1.0), (10.0, 30.0), points=2, starts=1)
    assert np.isnan(drawn.crossing).all()
    assert np.isnan(drawn.loop_gain).all()
    assert np.isfinite(drawn.period).all()
    plain = loop.with_controller(dataclasses.replace(loop.controller, compensator=None))
    assert wb.margins(loop).max_sensitivity == wb.margins(plain).max_sensitivity


def test_tuning_with_a_compensator_is_a_search_on_the_exact_simulator():
    compensator = wb.Knocker(2.5, 1.0, 5.0)
    loop, experiment = paper_loop(0.5, 20.0, compensator=compensator), paper_step(300.0)
    bounds = wb.Bounds(Kc=(0.1, 3.0), Ti=(5.0, 200.0), Td=(0.0, 0.0))
    tuned = wb.tune(loop, experiment, wb.Objective(w1=0.5, w3=0.5), bounds, restarts=1, max_evaluations=4000)
    assert tuned.controller.compensator == compensator
    assert tuned.objective == wb.evaluate(loop.with_controller(tuned.controller), experiment, tuned.weights)[0]
    assert tuned.objective < tuned.start_objective
    assert tuned.solves == 0
    assert "branch programs do not know the compensator Knocker" in tuned.message
    with pytest.raises(wb.InvalidValue, match="compensator Knocker given; has no complementarity form"):
        wb.tune(loop, experiment, bounds=bounds, complementarity=1)


def test_an_ensemble_runs_the_controller_that_it_is_asked_about():
    # The members' rows must take over the compensator of another controller, not only its Kc, Ti and Td.
    loop = paper_loop(0.5, 20.0)
    ensemble = dataclasses.replace(wb.Ensemble.plant_ready(loop), draws=20)
    knocked = loop.with_controller(dataclasses.replace(loop.controller, compensator=wb.Knocker(2.5, 1.0, 5.0)))
    from workbench.tune.ensemble import Circumstances, measured

    direct = wb.assess(knocked, ensemble)
    through = measured(Circumstances(loop, ensemble).under(knocked.controller), wb.Objective())
    np.testing.assert_array_equal(direct.valve_travel, through.valve_travel)
    assert direct.travel_median > 2.0 * wb.assess(loop, ensemble).travel_median


def test_repair_takes_the_compensator_out_with_the_stiction():
    loop = paper_loop(0.5, 20.0, compensator=wb.Dither(3.0, 4.0))
    experiment, ideal = paper_step(200.0), paper_loop(0.5, 20.0)
    worth = wb.value_of_repair(loop, experiment, bounds=wb.Bounds((0.5, 0.5), (20.0, 20.0), (0.0, 0.0)))
    without = wb.simulate(dataclasses.replace(ideal, valve=wb.Ideal()), experiment)
    assert worth.repaired.controller.compensator is None
    assert worth.repaired.kpis.mean_square_error == without.kpis.mean_square_error
    assert worth.present.kpis.valve_travel == wb.simulate(loop, experiment).kpis.valve_travel
