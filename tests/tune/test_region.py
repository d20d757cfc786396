"""Constraints and the sieve: the border of the margins is followed, and nothing that keeps all is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.tune.limits import WORN, beyond
from workbench.tune.problem import Problem, last_offsets, round_to
from workbench.tune.region import Region
from workbench.tune.sieve import _axis
from workbench.tune.verify import choose

LOOP = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
SHORT = wb.Experiment(100.0, setpoint=wb.Step(4.0), noise=wb.Noise(0.05, seed=3))
PLANE = wb.Bounds(Kc=(0.1, 4.0), Ti=(2.0, 50.0), Td=(0.0, 0.0))
ALONE = wb.Bounds(Kc=(0.1, 4.0), Ti=(20.0, 20.0), Td=(0.0, 0.0))
SPACE = wb.Bounds(Kc=(0.1, 4.0), Ti=(2.0, 50.0), Td=(0.0, 2.0))
ASKED = [
    wb.Constraints(max_sensitivity=1.6),
    wb.Constraints(gain_margin=3.0, phase_margin=60.0),
    wb.Constraints(max_sensitivity=1.3, valve_travel=20.0),
]


def grid_of(problem: Problem, every: int) -> list[np.ndarray]:
    return [_axis(problem, np.array([1.0, 20.0, 1.0]), k)[::every] for k in problem.free.tolist()]


@pytest.mark.parametrize("asked", ASKED, ids=["Ms", "both margins", "strict"])
@pytest.mark.parametrize(("bounds", "every"), [(PLANE, 1), (ALONE, 1), (SPACE, 16)], ids=["plane", "line", "space"])
def test_a_tuning_that_keeps_the_margins_has_possible_points_about_it(asked, bounds, every, monkeypatch):
    problem = Problem(LOOP, SHORT, wb.Objective(), bounds, 3, 0.01, constraints=asked)
    axes = grid_of(problem, every)
    count, own = [], problem.margins
    monkeypatch.setattr(problem, "margins", lambda tunings, **how: (count.append(len(tunings)), own(tunings, **how))[1])
    region = Region(problem, axes)
    whole = int(np.prod([axis.size for axis in axes]))
    assert sum(count) < max(0.6 * whole, 3000)  # a short axis is asked whole
    tunings = problem.tunings(np.random.default_rng(0).random((1500, problem.free.size)))
    margins, stable = own(tunings)
    missed = np.where(stable, beyond(asked, margins), np.inf)
    nearest = [
        np.abs(axis[None, :] - tunings[:, k, None]).argmin(axis=1) for k, axis in zip(problem.free, axes, strict=True)
    ]
    within = (tunings[:, 1] <= axes[1][-1]) & (tunings[:, 2] <= axes[2][-1]) if bounds is SPACE else stable | True
    assert region.possible(nearest)[(missed <= 0.0) & within].all()
    assert (missed <= 0.0).any()
    assert region.near(tunings[(missed <= 0.0) & within]).all()
    if every == 1:
        assert (region.missed(tunings[missed > 0.05]) > 0.0).all()
        assert not region.near(tunings[missed > 0.2]).any()
        assert not region.possible(nearest)[missed > 0.2].any()


@pytest.mark.parametrize(
    "asked", [*ASKED[1:], wb.Constraints(valve_travel=15.0)], ids=["both margins", "strict", "travel"]
)
def test_no_tuning_that_keeps_the_constraints_is_better_than_what_is_found_and_proved(asked):
    # Two digits leave so few tunings that all of them can be tried.
    found = wb.tune(LOOP, SHORT, bounds=PLANE, restarts=3, digits=2, margin=0.02, constraints=asked)
    problem = Problem(LOOP, SHORT, wb.Objective(), PLANE, 2, 0.02, constraints=asked)
    Kc, Ti = (np.unique(round_to(np.geomspace(*ends, 4000), 2, *ends)) for ends in (PLANE.Kc, PLANE.Ti))
    plane = np.stack([np.repeat(Kc, Ti.size), np.tile(Ti, Kc.size), np.zeros(Kc.size * Ti.size)], axis=1)
    worst = problem.spread(plane, np.full(plane.shape[0], 1.02 * found.worst))
    assert found.status.success
    assert np.isfinite(worst).any()
    assert found.worst <= 1.003 * worst.min()
    assert found.worst_bound is not None
    assert 0.5 * found.worst < found.worst_bound <= 1.0001 * worst.min()
    assert "within the bounds that keeps the constraints has a worst J below" in found.message


def test_of_constraints_that_nothing_keeps_nothing_is_proved():
    bounds = wb.Bounds(Kc=(1.0, 4.0), Ti=(2.0, 10.0), Td=(0.0, 0.0))
    loop = replace(LOOP, controller=wb.PID(2.0, 5.0))
    found = wb.tune(loop, SHORT, bounds=bounds, restarts=3, digits=2, constraints=wb.Constraints(valve_travel=0.5))
    assert found.status is wb.SolveStatus.INFEASIBLE
    assert found.worst_bound is None


def test_a_limit_that_only_a_closer_look_finds_broken_leaves_the_one_tuning_its_worst_j():
    loop = wb.Loop(wb.Integrating(0.47, 3.15), wb.Choudhury(1.98, 0.89), wb.PID(0.128, 18.6), 1.0)
    experiment = wb.Experiment(1500.0, wb.Step(4.37, 1.0), wb.Step(0.91, 750.0), wb.Noise(0.306, seed=6))
    bounds = wb.Bounds(Kc=(0.0, 2.0), Ti=(2.3, 468.0), Td=(0.0, 0.0))
    tuning = np.array([0.4279, 131.1, 0.0])
    free = Problem(loop, experiment, wb.Objective(), bounds, 4, 0.001)
    limit = 1.0001 * free.travel(tuning)
    points = tuning + last_offsets(free.samples) * free.radius(tuning[None, :])
    runs = [wb.simulate(loop.with_controller(free.controller(point)), experiment) for point in points[:400]]
    assert max(run.kpis.valve_travel for run in runs) > limit  # the closer look meets a run that travels further
    asked = wb.Constraints(valve_travel=limit)
    kept = Problem(loop, experiment, wb.Objective(), bounds, 4, 0.001, constraints=asked)
    assert WORN <= kept.last_word(tuning) < np.inf
    one = wb.Bounds(*((value, value) for value in tuning))
    chosen = choose(Problem(loop, experiment, wb.Objective(), one, 4, 0.001, constraints=asked), tuning[None, :])
    dense = free.spread(tuning[None, :], np.array([np.inf]))[0]
    assert chosen.worst == max(dense, free.last_word(tuning, proof=True)) < WORN
    broken = Problem(loop, experiment, wb.Objective(), bounds, 4, 0.001, constraints=wb.Constraints(valve_travel=1.0))
    assert broken.last_word(tuning) >= WORN
    assert broken.last_word(tuning, 1e6) == np.inf
