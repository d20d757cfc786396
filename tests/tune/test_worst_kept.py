"""What `Tuned.worst` and a limit on travel promise of a neighbourhood, asked at points that no search has seen."""

import numpy as np
import pytest

import workbench as wb
from workbench.model.results import Tuned
from workbench.tune import verify
from workbench.tune.problem import Problem

# Noise on a small step: J and travel jump wherever the stem slips once more.
LOOP = wb.Loop(wb.FOPDT(1.0, 9.0), wb.Stenman(0.6), wb.PID(0.3, 20.0), 1.0)
EXPERIMENT = wb.Experiment(200.0, wb.Step(2.0, at=3.0), noise=wb.Noise(0.045, 13))
BOUNDS, MARGIN = wb.Bounds(Kc=(0.0, 6.0), Ti=(2.0, 280.0), Td=(0.0, 0.0)), 0.03


def fresh(tuned: Tuned, count: int = 10_000) -> tuple[np.ndarray, np.ndarray]:
    """J and travel at new random points of a tuning's neighbourhood, shape (count,) each."""
    problem = Problem(LOOP, EXPERIMENT, tuned.weights, BOUNDS, tuned.digits, tuned.margin)
    at = np.array([tuned.controller.Kc, tuned.controller.Ti, tuned.controller.Td])
    points = at + np.random.default_rng(99).uniform(-1.0, 1.0, (count, 3)) * problem.radius(at[None, :])
    figures = Problem(LOOP, EXPERIMENT, wb.Objective.of(valve_travel=1.0), BOUNDS, tuned.digits, tuned.margin)
    return problem.exact(points), figures.exact(points)


@pytest.fixture(scope="module")
def limited() -> Tuned:
    asked = wb.Constraints(valve_travel=70.0)
    return wb.tune(LOOP, EXPERIMENT, bounds=BOUNDS, margin=MARGIN, restarts=1, constraints=asked).require_success()


def test_travel_keeps_its_limit_at_points_that_did_not_choose_the_tuning(limited: Tuned) -> None:
    _, travel = fresh(limited)
    assert np.mean(travel > 70.0) < 1e-3
    assert "too far" not in limited.message


def test_j_keeps_its_worst_case_at_points_that_did_not_choose_the_tuning(limited: Tuned) -> None:
    costs, _ = fresh(limited)
    assert np.mean(costs > limited.worst) < 1e-3
    assert costs.max() < 1.002 * limited.worst


def test_a_worst_case_that_other_points_refute_is_given_up_for_one_that_they_confirm() -> None:
    class Asked(Problem):
        """The closer look of one tuning is refuted by the proof."""

        def last_word(self, tuning: np.ndarray, ceiling: float = np.inf, *, proof: bool = False) -> float:
            value = 1.0 if tuning[0] == 1.0 else 1.1
            value = 1.5 if proof and tuning[0] == 1.0 else value
            return value if value <= ceiling else np.inf

    problem = Asked(LOOP, EXPERIMENT, wb.Objective(), BOUNDS, 4, MARGIN)
    results = [(1.0, 0.9, np.array([1.0, 10.0, 0.0])), (1.1, 0.8, np.array([2.0, 10.0, 0.0]))]
    chosen = verify._proved(problem, results, lambda: False)
    assert (chosen.tuning[0], chosen.worst, chosen.cost) == (2.0, 1.1, 0.8)


@pytest.mark.parametrize("proof", [False, True])
def test_the_last_word_and_the_proof_end_where_the_time_is_up(proof: bool) -> None:
    asked: list[bool] = []

    class Asked(Problem):
        def last_word(self, tuning: np.ndarray, ceiling: float = np.inf, *, proof: bool = False) -> float:
            asked.append(proof)
            return super().last_word(tuning, ceiling, proof=proof)

    def stop() -> bool:
        if asked.count(proof):
            raise TimeoutError
        return False

    problem = Asked(LOOP, EXPERIMENT, wb.Objective(), BOUNDS, 4, 0.001)
    near = np.array([[0.3, 20.0, 0.0], [0.31, 20.0, 0.0], [0.31, 21.0, 0.0], [2.0, 20.0, 0.0]])
    with pytest.raises(TimeoutError):
        verify.choose(problem, near, stop=stop)
    assert asked.count(proof) == 1


def test_a_limit_that_some_points_of_the_only_neighbourhood_break_is_said() -> None:
    bounds = wb.Bounds(Kc=(4.5, 4.5), Ti=(5.0, 5.0), Td=(0.0, 0.0))
    problem = Problem(LOOP, EXPERIMENT, wb.Objective(), bounds, 4, MARGIN)
    seen = problem.travel(np.array([4.5, 5.0, 0.0]))
    tuned = wb.tune(LOOP, EXPERIMENT, bounds=bounds, margin=MARGIN, constraints=wb.Constraints(valve_travel=seen))
    assert tuned.status is wb.SolveStatus.SOLVED
    _, travel = fresh(tuned)
    assert 0.0 < np.mean(travel > seen) < 0.05
    assert tuned.worst < 100.0
    assert "the valve travels by up to" in tuned.message
    assert "points too far" in tuned.message
