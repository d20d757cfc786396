"""`wb.tune(..., robust=...)`: better on fresh draws, within its constraints, honest where there is no answer."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from loops import paper_loop, paper_step

import workbench as wb
from workbench.tune.ensemble import draws

START = paper_loop(0.5, 20.0, derivative_on="pv", derivative_filter=10.0)
PI = wb.Bounds(Td=(0.0, 0.0))
# A small ensemble keeps these tests quick; the paper's own is measured in the slow test.
SMALL = replace(wb.Ensemble.plant_ready(START), duration=200.0, load_time=(80.0, 120.0), draws=20)
STEP = paper_step(200.0)


def tune(bounds=PI, robust=SMALL, **more):
    return wb.tune(START, STEP, bounds=bounds, robust=robust, **{"restarts": 2, **more})


@pytest.fixture(scope="module")
def pi():
    return tune()


def test_the_result_is_exact_and_keeps_the_default_constraint(pi):
    assert pi.status is wb.SolveStatus.SOLVED
    assert pi.constraints == wb.Constraints(max_sensitivity=2.0)
    assert pi.ensemble == SMALL
    assert pi.bounds.contains(pi.controller)
    pid = pi.controller
    costs = [wb.evaluate(d.loop.with_controller(pid), d.experiment, pi.weights)[0] for d in draws(START, pi.ensemble)]
    assert pi.objective == pytest.approx(np.mean(costs), rel=1e-9)
    assert pi.nominal <= pi.objective <= pi.worst
    assert pi.objective < 0.5 * pi.start_objective
    fresh = pi.robustness
    assert fresh.ensemble.seed == SMALL.seed + 1
    assert fresh.ensemble.draws == 2000
    assert fresh.max_sensitivity <= 2.0
    assert fresh.diverged == 0
    assert fresh.mse_mean < 0.5 * pi.start_robustness.mse_mean
    assert float(f"{pid.Kc:.3e}") == pid.Kc
    assert float(f"{pid.Ti:.3e}") == pid.Ti


def test_no_tuning_of_a_grid_does_much_better(pi):
    best = math.inf
    for Kc in np.geomspace(0.5, 3.0, 12):
        for Ti in np.geomspace(5.0, 60.0, 12):
            found = wb.assess(START.with_controller(replace(START.controller, Kc=float(Kc), Ti=float(Ti))), SMALL)
            if found.max_sensitivity <= 2.0:
                best = min(best, found.objective)
    assert pi.objective <= 1.005 * best


def test_equal_seeds_give_equal_results(pi):
    again = tune()
    assert again.controller == pi.controller
    assert again.objective == pi.objective
    assert again.restarts == pi.restarts
    assert again.message == pi.message


def test_a_travel_cap_holds_over_the_draws(pi):
    capped = tune(constraints=wb.Constraints(valve_travel=20.0))
    assert capped.status is wb.SolveStatus.SOLVED
    pid = capped.controller
    travel = [wb.simulate(d.loop.with_controller(pid), d.experiment).kpis.valve_travel for d in draws(START, SMALL)]
    assert np.mean(travel) <= 20.0
    # Over other draws it is another.
    above = "on fresh draws the mean valve travel is" in capped.message
    assert above == (capped.robustness.travel_mean > 20.0)
    assert capped.objective > pi.objective


def test_margins_as_constraints():
    found = tune(constraints=wb.Constraints(gain_margin=4.0, phase_margin=70.0))
    assert found.status is wb.SolveStatus.SOLVED
    assert found.robustness.gain_margin >= 4.0
    assert found.robustness.phase_margin >= 70.0


def test_other_statistics():
    mean = tune(restarts=1, digits=2).objective
    for kind, words in (("percentile", "quantile"), ("cvar", "CVaR")):
        found = tune(robust=replace(SMALL, statistic=kind, level=0.8), restarts=1, digits=2)
        assert found.status is wb.SolveStatus.SOLVED
        assert found.objective > mean
        assert words in found.message


def test_what_cannot_be_kept_is_said_with_the_nearest_tuning():
    found = tune(wb.Bounds(Kc=(0.4, 10.0), Td=(0.0, 0.0)), constraints=wb.Constraints(1.05, valve_travel=1.0))
    assert found.status is wb.SolveStatus.INFEASIBLE
    assert "a maximum sensitivity of 1.1" in found.message
    assert "(at most 1.05)" in found.message
    assert found.controller.Kc < 0.5
    assert math.isfinite(found.objective)
    worn = tune(wb.Bounds(Kc=(1.0, 1.0), Ti=(20.0, 20.0), Td=(0.0, 0.0)), constraints=wb.Constraints(valve_travel=1.0))
    assert worn.status is wb.SolveStatus.INFEASIBLE
    assert "(at most 1 %)" in worn.message
    with pytest.raises(wb.SolveError, match="infeasible"):
        worn.require_success()


def test_an_ensemble_that_makes_every_tuning_unstable():
    start = START.with_controller(replace(START.controller, Kc=9.0, Ti=5.0))
    bounds = wb.Bounds(Kc=(8.0, 10.0), Ti=(5.0, 6.0), Td=(0.0, 0.0))
    found = wb.tune(start, STEP, bounds=bounds, robust=SMALL, restarts=1)
    assert found.status is wb.SolveStatus.DIVERGED
    assert "does not hold every corner plant" in found.message


def test_an_integrating_loop_with_two_parameter_stiction():
    loop = wb.Loop(
        wb.Integrating(0.05, 2.0), wb.Choudhury(S=3.0, J=1.0), wb.PID(1.0, 60.0, derivative_on="pv"), sample_time=1.0
    )
    ensemble = replace(wb.Ensemble.plant_ready(loop), draws=20, duration=500.0, load_time=(100.0, 250.0))
    found = wb.tune(loop, STEP, robust=ensemble, restarts=1)
    assert found.status is wb.SolveStatus.SOLVED
    assert found.robustness.max_sensitivity <= 2.0
    assert found.objective < found.start_objective


def test_interruptions_return_the_best_so_far():
    def progress(phase: str, _share: float) -> None:
        if phase.startswith("joint"):
            raise KeyboardInterrupt

    found = tune(progress=progress)
    assert found.status is wb.SolveStatus.INTERRUPTED
    assert found.objective < found.start_objective
    assert found.robustness.max_sensitivity <= 2.0
    late = tune(time_limit=1e-6)
    assert late.status is wb.SolveStatus.TIME_LIMIT
    assert late.controller == START.controller


@pytest.mark.parametrize(
    ("wrong", "where"),
    [
        ({"robust": "yes"}, "tune.robust"),
        ({"robust": True, "constraints": {"max_sensitivity": 2.0}}, "tune.constraints"),
        ({"robust": True, "nominal": True}, "tune.nominal"),
    ],
)
def test_wrong_options_are_refused(wrong, where):
    with pytest.raises(wb.InvalidValue) as caught:
        wb.tune(START, STEP, bounds=PI, **wrong)
    assert caught.value.where == where


@pytest.mark.slow
def test_the_papers_loop_meets_its_figures():
    robust = wb.tune(START, paper_step(), bounds=PI, robust=True, seed=0, restarts=1, digits=3)
    fresh = robust.robustness
    assert robust.status is wb.SolveStatus.SOLVED
    assert fresh.max_sensitivity <= 2.0
    assert fresh.mse_median <= 0.26
    assert fresh.travel_median <= 250.0
    assert fresh.diverged == 0
    free = wb.tune(START, paper_step(), bounds=PI, robust=True, constraints=wb.Constraints(), seed=0, restarts=1)
    assert free.robustness.mse_median <= 0.155
    assert free.robustness.diverged == 0
