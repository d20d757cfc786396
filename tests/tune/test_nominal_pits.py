"""The least J itself lies in one of many pits: each of the best is searched, not the best alone."""

import itertools

import numpy as np
import pytest

import workbench as wb
from workbench.model.record import FloatArray
from workbench.tune.problem import Problem
from workbench.tune.worst import least_worst

LOOP = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
PITS = np.array(list(itertools.product((0.1, 0.3, 0.5, 0.7, 0.9), repeat=2)))[[12, *range(12), *range(13, 25)]]
NEEDLE = PITS[20] + np.array([0.05, 0.03])


class Pits(Problem):
    """J has a broad pit at each of 25 points, each a little less deep than the one before, and a needle near one."""

    def below(self, tunings: FloatArray, ceilings: FloatArray) -> FloatArray:
        points = self.cube(tunings)
        broad = np.linalg.norm(points[:, None] - PITS, axis=2)
        values = (1.0 + 0.01 * np.arange(len(PITS)) + broad).min(axis=1)
        values = np.minimum(values, 0.5 + 60.0 * np.linalg.norm(points - NEEDLE, axis=1))
        return np.where(values <= ceilings, values, np.inf)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_pit_beside_one_of_the_less_good_is_found(seed: int) -> None:
    bounds = wb.Bounds(Kc=(0.0, 10.0), Ti=(5.0, 600.0), Td=(0.0, 0.0))
    problem = Pits(LOOP, wb.Experiment(50.0, wb.Step(4.0)), wb.Objective(), bounds, 12, 0.001, nominal=True)
    pools = [problem.tunings(PITS)]
    found = least_worst(problem, pools, [seed, 1], 1.0, 1, lambda: None, lambda _: None)
    values = problem.below(found.tunings, np.full(len(found.tunings), np.inf))
    assert values.min() < 0.51
