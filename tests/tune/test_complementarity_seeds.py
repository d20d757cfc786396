"""Seeds from the complementarity form: misleading as tunings, good as sequences."""

from __future__ import annotations

import numpy as np
import pytest
from loops import PAPER_PLANT

import workbench as wb
from workbench.errors import InvalidValue
from workbench.symbolic.branch import Decisions
from workbench.tune.complementarity import seeds
from workbench.tune.problem import Problem
from workbench.tune.refine import Refiner, Seed, path

BEST = 9.76154
STARTS = np.array([[0.5, 20.0, 0.0], [2.0, 48.0, 1.6]])


def paper(samples: int, valve=None) -> Problem:
    """The paper's loop and step under eq. (2): PID with n = 10, derivative on PV."""
    controller = wb.PID(Kc=0.5, Ti=20.0, Td=0.0, derivative_on="pv", derivative_filter=10.0)
    loop = wb.Loop(PAPER_PLANT, valve or wb.Stenman(d=2.0), controller, sample_time=1.0)
    experiment = wb.Experiment(float(samples), wb.Step(4.0))
    return Problem(loop, experiment, wb.Objective(w1=0.5, w3=0.5), wb.Bounds(), 4, 0.001)


def test_every_start_leads_to_the_best_known_tuning() -> None:
    problem = paper(200)
    found = seeds(problem, STARTS, 15.0)
    assert len(found) == len(STARTS)
    for seed in found:
        # Nearly the optimum by the program's claim, far from it by exact runs: at a guard only the program may choose.
        assert seed.promise < 1.02 * BEST
        assert problem.exact(seed.tuning[None, :])[0] > 1.5 * BEST
        # A refiner for each, so that one seed cannot live on another's neighbours.
        refined = Refiner(problem, 0.01, 15.0).refine(np.zeros((0, 3)), np.zeros(0), 6, [seed])
        assert refined.accepted >= 1
        assert refined.costs[0] <= 1.001 * BEST
        assert refined.costs[0] == problem.exact(refined.tunings[:1])[0]


def test_a_sequence_is_refined_once_and_from_its_own_point() -> None:
    problem = paper(60)
    (seed,) = seeds(problem, STARTS[:1], 15.0)
    refiner = Refiner(problem, 0.01, 15.0)
    first = refiner.refine(np.zeros((0, 3)), np.zeros(0), 1, [seed])
    assert (first.solves, first.accepted) == (1, 1)
    again = refiner.refine(np.zeros((0, 3)), np.zeros(0), 1, [seed])
    assert again.solves == 0
    # From the run of the seed's tuning alone, the same sequence leads nowhere.
    alone = Refiner(problem, 0.01, 15.0).refine(
        np.zeros((0, 3)), np.zeros(0), 1, [Seed(seed.decisions, seed.promise, seed.tuning)]
    )
    assert alone.accepted == 0 or alone.iterations > first.iterations
    assert path(problem, seed.tuning).branch.tobytes() != seed.decisions.key


def test_runs_that_overflow_give_no_seed() -> None:
    problem = paper(400)
    assert not np.isfinite(problem.exact(np.array([[1e9, 5.0, 60.0]]))[0])
    assert seeds(problem, np.array([[1e9, 5.0, 60.0]]), 15.0) == []


def test_what_it_is_not_made_for_is_refused() -> None:
    with pytest.raises(InvalidValue, match="at most 500 samples"):
        seeds(paper(501), STARTS[:1], 15.0)
    with pytest.raises(InvalidValue, match="Stenman"):
        seeds(paper(60, wb.Choudhury(S=2.0, J=1.0)), STARTS[:1], 15.0)
    with pytest.raises(InvalidValue, match="Stenman"):
        seeds(paper(60, wb.He(2.0, 0.5)), STARTS[:1], 15.0)
    assert Decisions.from_branch(path(paper(60), STARTS[0]).branch).motion.any()
