"""The MPCC seam: schedules are checked, ends are judged by the problem itself, the best step survives what fails."""

from __future__ import annotations

import itertools
import math
import os
import signal
import threading
from dataclasses import FrozenInstanceError, replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import InvalidValue, SolveError
from workbench.model.results import SolveStatus
from workbench.symbolic.mpcc import RELAXATIONS, Homotopy, Mpcc, MpccSolver, Pairs, RelaxedSolver
from workbench.symbolic.solve import Group, IpoptOptions, Nlp, Values


def corner(kind=ca.SX) -> Mpcc:
    """Least |x - p|^2 with 0 <= x1 perp x2 >= 0: for p = (3, 1) at (3, 0) with 1."""
    x, p = kind.sym("x", 2), kind.sym("p", 2)
    nlp = Nlp(x=x, objective=ca.sumsqr(x - p), start=np.array([1.0, 1.0]), parameters=p)
    return Mpcc(nlp, (Pairs("corner", x[0], x[1]),))


def impossible() -> Mpcc:
    """Both sides at least 1."""
    x = ca.SX.sym("x", 2)
    nlp = Nlp(x=x, objective=ca.sumsqr(x), lower=1.0, start=2.0)
    return Mpcc(nlp, (Pairs("pair", x[0], x[1]),))


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("relaxation", RELAXATIONS)
def test_a_solved_program(relaxation: str, kind) -> None:
    solver: MpccSolver = RelaxedSolver(corner(kind), Homotopy(relaxation))
    result = solver.solve(Values(parameters=np.array([3.0, 1.0])))
    assert result.status is SolveStatus.SOLVED
    assert result.require_success() is result
    assert result.x == pytest.approx([3.0, 0.0], abs=1e-7)
    assert result.objective == pytest.approx(1.0, abs=1e-6)
    assert result.complementarity < 1e-12
    assert result.sides["corner"].tolist() == [False]
    assert set(result.residuals) == {"bounds", "corner"}
    assert result.iterations == sum(step.iterations for step in result.steps) > 0
    assert result.wall_time >= sum(step.wall_time for step in result.steps)


@pytest.mark.parametrize("relaxation", ["scholtes", "fischer_burmeister"])
def test_every_step_is_told_and_allows_the_product_that_its_sigma_says(relaxation: str) -> None:
    schedule = Homotopy(relaxation, (1.0, 1e-3, 1e-7), finish=False)
    shares: list[float] = []
    solver = RelaxedSolver(corner(), schedule, tell=shares.append)
    result = solver.solve(Values(parameters=np.array([3.0, 1.0])))
    assert shares == [1 / 3, 2 / 3, 1.0]
    assert [step.sigma for step in result.steps] == [1.0, 1e-3, 1e-7]
    for step in result.steps:
        assert step.status.success
        assert step.residual < 1e-7
        # The unconstrained optimum has the product 3: the relaxed pair is always active.
        assert step.complementarity == pytest.approx(step.sigma, rel=1e-3, abs=1e-8)
    costs = [step.objective for step in result.steps]
    assert costs == sorted(costs)
    assert result.objective == costs[-1]
    assert "sigma = 1e-07" in result.message


def test_l1_stops_once_its_weight_is_exact_and_reports_no_penalty() -> None:
    result = RelaxedSolver(corner(), Homotopy("l1", finish=False)).solve(Values(parameters=np.array([3.0, 1.0])))
    assert result.status.success
    assert len(result.steps) < 6
    assert result.steps[-1].objective == pytest.approx(float(np.sum((result.x - [3.0, 1.0]) ** 2)), rel=1e-12)
    assert result.objective == pytest.approx(1.0, abs=1e-4)


def test_a_compiled_program_takes_other_starts_parameters_and_bounds() -> None:
    solver = RelaxedSolver(corner())
    other = solver.solve(Values(start=np.array([0.1, 5.0]), parameters=np.array([1.0, 3.0])))
    assert other.x == pytest.approx([0.0, 3.0], abs=1e-7)
    bounded = solver.solve(Values(parameters=np.array([3.0, 1.0]), upper=np.array([2.0, 9.0])))
    assert bounded.x == pytest.approx([2.0, 0.0], abs=1e-7)
    with pytest.raises(InvalidValue, match="names no group"):
        solver.solve(Values(parameters=np.array([3.0, 1.0]), bounds={"cornr": (np.zeros(1), np.zeros(1))}))


def test_groups_of_the_program_keep_their_bounds() -> None:
    x = ca.SX.sym("x", 3)
    nlp = Nlp(
        x=x,
        objective=ca.sumsqr(x - ca.DM([2.0, 1.0, 0.0])),
        groups=(Group("sum", x[0] + x[1] + x[2], 4.0, 4.0), Group("cap", x[2], -math.inf, 0.5)),
        start=0.5,
    )
    result = RelaxedSolver(Mpcc(nlp, (Pairs("pair", x[0], x[1]),))).solve()
    # x2 = 0 (the cheaper side), x3 at its cap: x1 = 3.5.
    assert result.x == pytest.approx([3.5, 0.0, 0.5], abs=1e-6)
    assert set(result.residuals) == {"bounds", "sum", "cap", "pair"}


@pytest.mark.parametrize("relaxation", RELAXATIONS)
def test_what_has_no_solution_is_no_success(relaxation: str) -> None:
    result = RelaxedSolver(impossible(), Homotopy(relaxation)).solve()
    assert not result.status.success
    assert len(result.steps) >= 2
    with pytest.raises(SolveError, match="complementarity"):
        result.require_success()
    # The penalty's own programs are all solved; that the end is no solution is seen only by the pairs themselves.
    if relaxation == "l1":
        assert result.steps[0].status is SolveStatus.SOLVED
        assert result.complementarity == pytest.approx(1.0, rel=1e-3)


def test_the_best_step_survives_later_failures() -> None:
    solver = RelaxedSolver(impossible(), Homotopy("scholtes", (2.0, 1.5, 0.5, 0.4, 0.3), finish=False))
    result = solver.solve()
    solved = [step.sigma for step in result.steps if step.status.success]
    assert solved == [2.0, 1.5]
    assert [step.sigma for step in result.steps] == [2.0, 1.5, 0.5, 0.4], "two failures in a row end it"
    assert result.status is SolveStatus.INFEASIBLE
    assert "best step is kept" in result.message
    assert result.x == pytest.approx([1.0, 1.0], abs=1e-4)
    assert result.residual < 1e-7


def test_a_later_failure_after_a_good_step_is_acceptable() -> None:
    # Both sides at least 1e-4: within the tolerance until sigma asks for less than 1e-8.
    problem = impossible()
    problem = replace(problem, nlp=replace(problem.nlp, lower=1e-4))
    result = RelaxedSolver(problem, Homotopy("scholtes", (1.0, 1e-4, 1e-7, 1e-9), finish=False)).solve()
    assert result.status is SolveStatus.ACCEPTABLE
    assert not result.steps[-1].status.success
    assert result.complementarity < 1e-6


def test_the_iteration_limit_is_a_status() -> None:
    result = RelaxedSolver(corner(), options=IpoptOptions(max_iterations=1)).solve(
        Values(parameters=np.array([3.0, 1.0]))
    )
    assert result.status is SolveStatus.ITERATION_LIMIT
    assert result.message == "no step was solved"


def test_ctrl_c_keeps_the_best_step() -> None:
    # A chain of Rosenbrock functions keeps IPOPT busy; the interrupt comes in the middle of the first step.
    n = 3000
    x = ca.SX.sym("x", n)
    f = ca.sumsqr(1 - x[:-1]) + 100 * ca.sumsqr(x[1:] - x[:-1] ** 2)
    start = np.where(np.arange(n) % 2 == 0, -1.2, 1.0)
    problem = Mpcc(Nlp(x=x, objective=f, start=start), (Pairs("pair", x[0] + 5, x[1] + 5),))
    solver = RelaxedSolver(problem, Homotopy("l1"), IpoptOptions(max_iterations=100_000))
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        result = solver.solve()
        timer.join()
    except KeyboardInterrupt:
        pytest.fail("the solve ended before the interrupt came")
    assert result.status is SolveStatus.INTERRUPTED
    assert "stopped by the user" in result.message
    assert result.x.shape == (n,)
    assert np.isfinite(result.x).all()


def test_an_interrupt_between_steps_keeps_the_best_step(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = RelaxedSolver(corner(), Homotopy(finish=False))
    taken = RelaxedSolver._step
    sigmas: list[float] = []

    def step(self, inner, given_values, start, sigma, held):
        if len(sigmas) == 2:
            raise KeyboardInterrupt
        sigmas.append(sigma)
        return taken(self, inner, given_values, start, sigma, held)

    monkeypatch.setattr(RelaxedSolver, "_step", step)
    result = solver.solve(Values(parameters=np.array([3.0, 1.0])))
    assert result.status is SolveStatus.INTERRUPTED
    assert [s.sigma for s in result.steps] == [1.0, 0.1]
    assert result.objective == result.steps[1].objective
    assert result.x[0] * result.x[1] == pytest.approx(0.1, rel=1e-3)
    monkeypatch.setattr(RelaxedSolver, "_step", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    nothing = solver.solve(Values(start=np.array([7.0, 8.0]), parameters=np.array([3.0, 1.0])))
    assert nothing.status is SolveStatus.INTERRUPTED
    assert nothing.x.tolist() == [7.0, 8.0]
    assert math.isnan(nothing.objective)
    assert nothing.steps == ()


@given(
    data=st.lists(
        st.tuples(st.floats(-3, 3, allow_nan=False), st.floats(-3, 3, allow_nan=False)), min_size=1, max_size=3
    ),
    relaxation=st.sampled_from(["scholtes", "fischer_burmeister"]),
)
@settings(max_examples=25)
def test_what_is_called_solved_is_feasible_and_the_best_of_its_sides(data, relaxation: str) -> None:
    """Separable least squares: with its sides fixed, each pair has a closed solution."""
    n = len(data)
    x = ca.SX.sym("x", 2 * n)
    p = np.array(data).ravel()
    problem = Mpcc(Nlp(x=x, objective=ca.sumsqr(x - p), start=1.0), (Pairs("pairs", x[0::2], x[1::2]),))
    result = RelaxedSolver(problem, Homotopy(relaxation)).solve()
    assert result.status.success
    assert result.residual < 1e-7
    assert result.complementarity < 1e-9
    expected = 0.0
    for (a, b), first in zip(data, result.sides["pairs"], strict=True):
        expected += a**2 + min(b, 0.0) ** 2 if first else b**2 + min(a, 0.0) ** 2
    assert result.objective == pytest.approx(expected, abs=1e-6)
    best = sum(min(a**2 + min(b, 0.0) ** 2, b**2 + min(a, 0.0) ** 2) for a, b in data)
    assert result.objective >= best - 1e-6


@pytest.mark.parametrize(
    ("wrong", "says"),
    [({"relaxation": "sholtes"}, "scholtes, fischer_burmeister, l1"), ({"sigmas": ()}, "one or more"),
     ({"sigmas": (1.0, 1.0)}, "fall strictly"), ({"sigmas": (1.0, 0.0)}, "> 0"), ({"sigmas": "1"}, "one or more"),
     ({"sigmas": (math.nan,)}, "finite"), ({"tolerance": 0.0}, "1e-12"), ({"finish": 1}, "True or False")],
)  # fmt: skip
def test_wrong_schedules_are_refused(wrong: dict[str, object], says: str) -> None:
    with pytest.raises(InvalidValue, match="Homotopy") as caught:
        Homotopy(**wrong)  # type: ignore[arg-type]
    assert says in str(caught.value)


def test_schedules_are_frozen_values() -> None:
    assert Homotopy(sigmas=[1, 0.5]) == Homotopy(sigmas=(1.0, 0.5))  # type: ignore[arg-type]
    with pytest.raises(FrozenInstanceError):
        Homotopy().tolerance = 1.0  # type: ignore[misc]


def test_wrong_pairs_are_refused() -> None:
    x = ca.SX.sym("x", 4)
    nlp = Nlp(x=x, objective=ca.sumsqr(x), groups=(Group("law", x[0]),))
    with pytest.raises(InvalidValue, match="same length"):
        Mpcc(nlp, (Pairs("pair", x[:2], x[2]),))
    for names in itertools.product(["law", "pair"], ["law"]):
        with pytest.raises(InvalidValue, match="name of its own"):
            Mpcc(nlp, tuple(Pairs(name, x[0], x[1]) for name in names))
    with pytest.raises(InvalidValue, match="at least one pair"):
        Mpcc(nlp, ())
