"""Branch programs that come to nothing: refinement is given up over all restarts, not in each of them anew."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from loops import PAPER_PLANT

import workbench as wb
from workbench.tune.problem import Problem
from workbench.tune.refine import FAILURES, IDLE, IDLE_LATER, Refiner


def test_programs_that_fail_one_after_the_other_end_refinement_for_good(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = wb.Loop(PAPER_PLANT, wb.Stenman(d=2.0), wb.PID(Kc=0.5, Ti=20.0), sample_time=1.0)
    problem = Problem(loop, wb.Experiment(40.0, wb.Step(4.0)), wb.Objective(), wb.Bounds(), 4, 0.001)
    refiner = Refiner(problem, 0.0, 15.0)
    solved = Refiner._solved
    # A claim that no exact run gives.
    monkeypatch.setattr(
        Refiner, "_solved", lambda *given, **named: replace(solved(*given, **named), objective=math.nan)
    )
    tunings = problem.tunings(np.random.default_rng(0).random((200, 3)))
    costs = problem.exact(tunings)
    assert refiner.refine(tunings, costs, 3).solves == 3
    assert refiner.refine(tunings, costs, 10).solves == FAILURES - 3
    assert refiner.refine(tunings, costs, 10).solves == 0


def test_programs_that_gain_nothing_are_few_and_after_a_restart_of_such_fewer() -> None:
    loop = wb.Loop(PAPER_PLANT, wb.Stenman(d=2.0), wb.PID(Kc=0.5, Ti=20.0), sample_time=1.0)
    problem = Problem(loop, wb.Experiment(40.0, wb.Step(4.0)), wb.Objective(), wb.Bounds(), 4, 0.001)
    tunings = problem.tunings(np.random.default_rng(0).random((200, 3)))
    costs = problem.exact(tunings)
    # Already better than any program can be.
    idle = Refiner(problem, 0.0, 15.0)
    assert idle.refine(tunings, 1e-6 * costs, 20).solves == IDLE
    assert idle.refine(tunings, 1e-6 * costs, 20).solves == IDLE_LATER
    # What gains goes on.
    assert Refiner(problem, 0.0, 15.0).refine(tunings, costs, 20).solves > IDLE
