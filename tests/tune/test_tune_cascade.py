"""Tuning a cascade in turn: exact costs, the search's result against a grid, and what is refused."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from cascades import cascades, flow_and_temperature
from hypothesis import assume, given, settings

import workbench as wb
from workbench.tune.cascade import CascadeProblem, evaluate_cascade

WEIGHTS = wb.Objective(0.0, 0.0, 0.0, 0.0, {"mean_square_error": 1.0, "valve_travel": 0.001})
EXPERIMENT = wb.CascadeExperiment(
    200.0,
    setpoint=wb.Step(5.0),
    primary_load=wb.Step(1.5, 120.0),
    noise=wb.Noise(0.01, 1),
    secondary_noise=wb.Noise(0.02),
)


@settings(max_examples=25)
@given(cascade=cascades())
def test_costs_are_those_of_the_run(cascade):
    experiment = wb.CascadeExperiment(150.0, setpoint=wb.Step(2.0), noise=wb.Noise(0.05))
    run = wb.simulate(cascade, experiment)
    error = run.primary.sp - run.primary.pv
    assume(np.abs(error).max() < 1e6)
    last = run.primary.final_sp - run.primary.final_pv
    J = 0.5 * (error[1:] ** 2).sum() + 0.5 * last**2 + 0.2 * (run.secondary.op**2).sum() + 0.5 * last**2
    J += 0.1 * (np.diff(run.secondary.op, prepend=0.0) ** 2).sum()
    weights = wb.Objective(0.5, 0.2, 0.5, 0.1)
    np.testing.assert_allclose(evaluate_cascade(cascade, experiment, weights), J, rtol=1e-9)
    figures = {"valve_travel": 2.0, "iae": 1.0, "reversals": 3.0, "mean_square_error": 4.0}
    told = evaluate_cascade(cascade, experiment, wb.Objective(0.0, 0.0, 0.0, 0.0, figures))
    kpis = run.primary.kpis
    expected = 2.0 * run.secondary.kpis.valve_travel + kpis.iae + 4.0 * kpis.mean_square_error
    np.testing.assert_allclose(told, expected + 3.0 * run.secondary.kpis.reversals, rtol=1e-9)


def test_the_search_finds_no_worse_than_a_grid_and_reports_what_a_run_shows():
    cascade = flow_and_temperature()
    bounds = wb.Bounds(Kc=(0.5, 6.0), Ti=(30.0, 300.0), Td=(0.0, 0.0))
    tuned = wb.tune_cascade(
        cascade,
        EXPERIMENT,
        WEIGHTS,
        bounds,
        restarts=1,
        digits=2,
        secondary_experiment=wb.Experiment(50.0, setpoint=wb.Step(2.0)),
        secondary_objective=WEIGHTS,
        secondary_bounds=wb.Bounds(Kc=(0.1, 2.0), Ti=(2.0, 30.0), Td=(0.0, 0.0)),
    )
    assert tuned.primary.status is wb.SolveStatus.SOLVED
    assert tuned.secondary.status is wb.SolveStatus.SOLVED
    assert tuned.cascade.secondary.controller == tuned.secondary.controller
    run = wb.simulate(tuned.cascade, EXPERIMENT)
    J = run.primary.kpis.mean_square_error + 0.001 * run.secondary.kpis.valve_travel
    assert tuned.primary.objective == pytest.approx(J, rel=1e-9)
    assert tuned.start_objective == evaluate_cascade(cascade, EXPERIMENT, WEIGHTS)
    assert tuned.primary.objective < tuned.start_objective
    problem = CascadeProblem(tuned.cascade, EXPERIMENT, WEIGHTS, bounds, 2, 0.001)
    grid = np.array(list(itertools.product(np.linspace(0.5, 6.0, 20), np.geomspace(30.0, 300.0, 20), [0.0])))
    worst = problem.worst_below(problem.rounded(grid), np.full(grid.shape[0], np.inf))
    assert tuned.primary.worst <= worst.min()
    # The worst case is one: no neighbour within the margin lies above it.
    rng = np.random.default_rng(5)
    pid = tuned.primary.controller
    near = np.array([[pid.Kc, pid.Ti, 0.0]]) * (1.0 + rng.uniform(-0.001, 0.001, (200, 3)))
    assert problem.exact(near).max() <= tuned.primary.worst * 1.02


def test_a_limit_of_time_returns_the_best_so_far():
    bounds = wb.Bounds(Kc=(0.5, 6.0), Ti=(30.0, 300.0), Td=(0.0, 0.0))
    tuned = wb.tune_cascade(flow_and_temperature(), EXPERIMENT, WEIGHTS, bounds, time_limit=1e-6)
    assert tuned.primary.status is wb.SolveStatus.TIME_LIMIT
    assert tuned.secondary is None
    assert math.isfinite(tuned.primary.objective)


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"bounds": wb.Bounds(Kc=(2.0, 6.0), Ti=(30.0, 300.0), Td=(0.0, 0.0))}, r"PID\.Kc"),
        ({"secondary_bounds": wb.Bounds()}, r"tune_cascade\.secondary_experiment"),
        ({"restarts": 0}, r"tune\.restarts"),
        ({"digits": 13}, r"tune\.digits"),
        ({"margin": 0.5}, r"tune\.margin"),
        ({"seed": -1}, r"tune\.seed"),
        ({"seed": True}, r"tune\.seed"),
        ({"time_limit": "5"}, r"tune\.time_limit"),
        ({"time_limit": math.nan}, r"tune\.time_limit"),
        ({"objective": "error"}, "objective"),
        ({"experiment": wb.Experiment(203.0)}, r"Experiment\.duration"),
        ({"cascade": "both"}, "cascade"),
    ],
)
def test_what_cannot_be_tuned_is_refused(options, where):
    given_ = {"cascade": flow_and_temperature(), "experiment": EXPERIMENT, **options}
    with pytest.raises(wb.InvalidValue, match=where):
        wb.tune_cascade(**given_)


@pytest.mark.parametrize(
    "ask",
    [
        lambda c: wb.margins(c),
        lambda c: wb.apply_rule(c, wb.Simc()),
        lambda c: wb.value_of_repair(c, wb.Experiment(100.0, setpoint=wb.Step(1.0))),
        lambda c: wb.assess(c),
        lambda c: wb.limit_cycle(c),
        lambda c: wb.describing_function(c),
    ],
    ids=["margins", "rule", "repair", "ensemble", "limit cycle", "describing function"],
)
def test_what_is_asked_of_one_loop_is_refused_of_a_cascade(ask):
    inner = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(1.0), wb.PID(Kc=0.5, Ti=5.0), 1.0)
    outer = wb.Loop(wb.FOPDT(1.0, 60.0, 10.0), wb.Ideal(), wb.PID(Kc=0.5, Ti=50.0), 1.0)
    with pytest.raises(wb.InvalidValue, match=r"^loop: Cascade given; must be a Loop"):
        ask(wb.Cascade(outer, inner))
