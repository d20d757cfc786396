"""The global scan: what a success counts in the adaptation of its steps."""

import numpy as np
import pytest

from workbench.tune.limits import WORN
from workbench.tune.scan import evolve


@pytest.mark.parametrize("level", [1.0, WORN, 1e280], ids=["J", "travel", "unstable"])
def test_a_success_over_a_run_that_overflows_counts_by_what_it_has(level: float) -> None:
    def evaluate(points: np.ndarray, ceilings: np.ndarray) -> np.ndarray:
        values = np.where(points[:, 0] > 0.5, np.inf, level * (1.0 + points[:, 0]))
        return np.where(values <= ceilings, values, np.inf)

    start = np.random.default_rng(0).uniform(0.51, 1.0, (20, 2))
    start[0] = 0.4
    end = evolve(evaluate, start, 60, np.random.default_rng(1))
    assert end.values[0] <= 1.001 * level
