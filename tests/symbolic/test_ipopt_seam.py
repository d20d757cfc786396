"""The seam over IPOPT: statuses, residuals that we compute ourselves, options that cannot harm."""

from __future__ import annotations

import math
import os
import signal
import threading
import time

import casadi as ca
import numpy as np
import pytest

from workbench.errors import InvalidValue, SolveError
from workbench.model.results import SolveStatus
from workbench.symbolic.solve import Group, IpoptOptions, Nlp, Solver, Values, held_interrupt, versions


def rosenbrock() -> Nlp:
    x = ca.SX.sym("x", 2)
    return Nlp(x=x, objective=(1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2, start=np.array([-1.2, 1.0]))


def circle(radius: float) -> Nlp:
    """Least x + y on a circle: -radius (1, 1)/sqrt(2)."""
    x = ca.SX.sym("x", 2)
    return Nlp(
        x=x,
        objective=x[0] + x[1],
        groups=(Group("circle", x[0] ** 2 + x[1] ** 2, radius**2, radius**2), Group("half plane", x[0] - x[1], -9, 9)),
        start=np.array([0.3, -1.0]),
    )


def test_a_solved_program() -> None:
    result = Solver(rosenbrock()).solve()
    assert result.status is SolveStatus.SOLVED
    assert result.message == "Solve_Succeeded"
    assert np.abs(result.x - 1.0).max() < 1e-6
    assert result.objective < 1e-12
    assert result.iterations > 5
    assert result.require_success() is result
    assert set(result.versions) == {"casadi", "ipopt"}
    assert result.versions["ipopt"][0].isdigit()


def test_residuals_carry_the_groups_names() -> None:
    result = Solver(circle(2.0)).solve()
    assert np.abs(result.x + math.sqrt(2.0)).max() < 1e-6
    assert set(result.residuals) == {"bounds", "circle", "half plane"}
    assert 0.0 <= result.residuals["circle"] < 1e-7
    assert result.complementarity < 1e-6


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    Solver(rosenbrock()).solve()
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""


def test_an_infeasible_program_says_so_and_names_the_residual() -> None:
    x = ca.SX.sym("x")
    nlp = Nlp(x=x, objective=x**2, groups=(Group("impossible", x**2, -2.0, -1.0),), start=1.0)
    result = Solver(nlp).solve()
    assert result.status is SolveStatus.INFEASIBLE
    assert result.residuals["impossible"] == pytest.approx(1.0, abs=1e-3)
    with pytest.raises(SolveError, match="impossible"):
        result.require_success()


def test_the_iteration_limit_is_a_status() -> None:
    result = Solver(rosenbrock(), IpoptOptions(max_iterations=3)).solve()
    assert result.status is SolveStatus.ITERATION_LIMIT
    assert result.iterations == 3
    assert not result.status.success


def test_the_time_limit_is_a_status() -> None:
    result = Solver(rosenbrock(), IpoptOptions(max_wall_time=1e-9)).solve()
    assert result.status is SolveStatus.TIME_LIMIT


def test_a_program_without_a_lower_end_diverges() -> None:
    x = ca.SX.sym("x")
    result = Solver(Nlp(x=x, objective=-(x**3), start=1.0), IpoptOptions(max_iterations=2000)).solve()
    assert not result.status.success


def test_a_compiled_program_takes_other_numbers() -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    nlp = Nlp(x=x, objective=ca.sumsqr(x - p), groups=(Group("sum", x[0] + x[1], -math.inf, 100.0),), parameters=p)
    solver = Solver(nlp)
    first = solver.solve(Values(parameters=np.array([3.0])))
    second = solver.solve(Values(parameters=np.array([3.0]), bounds={"sum": (np.array([-math.inf]), np.array([4.0]))}))
    third = solver.solve(Values(parameters=np.array([3.0]), upper=np.array([1.0, 9.0])))
    assert np.abs(first.x - 3.0).max() < 1e-6
    assert np.abs(second.x - 2.0).max() < 1e-6
    assert third.x == pytest.approx([1.0, 3.0], abs=1e-6)
    with pytest.raises(InvalidValue, match="names no group"):
        solver.solve(Values(bounds={"summ": (np.zeros(1), np.zeros(1))}))


@pytest.mark.parametrize("name", ["pardiso", "ma27", "ma97", "", "MUMPS"])
def test_an_unknown_linear_solver_is_refused_before_ipopt_sees_it(name: str) -> None:
    with pytest.raises(InvalidValue, match="mumps, spral"):
        IpoptOptions(linear_solver=name)


@pytest.mark.parametrize(
    "wrong",
    [{"tolerance": 0.0}, {"tolerance": math.nan}, {"max_iterations": -1}, {"max_iterations": 2.5},
     {"max_wall_time": 0.0}, {"barrier": -1.0}, {"push": 0.0}, {"scaling": "equilibration"}, {"ordering": "metis"}],
)  # fmt: skip
def test_wrong_options_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidValue, match="IpoptOptions"):
        IpoptOptions(**wrong)  # type: ignore[arg-type]


def test_sizes_and_names_are_checked() -> None:
    x = ca.SX.sym("x", 3)
    with pytest.raises(InvalidValue, match="one number or 3"):
        Solver(Nlp(x=x, objective=ca.sumsqr(x), start=np.zeros(2))).solve()
    with pytest.raises(InvalidValue, match="name of its own"):
        Solver(Nlp(x=x, objective=ca.sumsqr(x), groups=(Group("a", x[0]), Group("a", x[1]))))


@pytest.mark.parametrize("ordering", ["minimum_degree", "nested_dissection"])
def test_both_whitelisted_linear_solvers_are_there(ordering: str) -> None:
    result = Solver(circle(1.0), IpoptOptions(linear_solver="mumps", ordering=ordering)).solve()
    assert result.status is SolveStatus.SOLVED


def test_ctrl_c_in_a_solve_gives_interrupted(capfd: pytest.CaptureFixture[str]) -> None:
    # A chain of Rosenbrock functions: its long bent valley takes IPOPT thousands of iterations.
    n = 3000
    x = ca.SX.sym("x", n)
    f = ca.sumsqr(1 - x[:-1]) + 100 * ca.sumsqr(x[1:] - x[:-1] ** 2)
    start = np.where(np.arange(n) % 2 == 0, -1.2, 1.0)
    solver = Solver(Nlp(x=x, objective=f, start=start), IpoptOptions(max_iterations=100_000))
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        result = solver.solve()
        timer.join()
    except KeyboardInterrupt:
        pytest.fail("the solve ended before the interrupt came")
    assert result.status is SolveStatus.INTERRUPTED
    assert "WARNING" not in "".join(capfd.readouterr())


def interrupted_inside(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Make Ctrl-C come in the middle of the conversion of one of the results."""
    true_asarray = np.asarray
    times = iter(range(1000))

    def asarray(value: object, *rest: object, **named: object) -> object:
        if isinstance(value, ca.DM) and next(times) == 0:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
        return true_asarray(value, *rest, **named)

    monkeypatch.setattr(np, name, asarray)


def test_ctrl_c_while_results_are_read_gives_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    x = ca.SX.sym("x")
    solver = Solver(Nlp(x=x, objective=(x - 1) ** 2))
    interrupted_inside(monkeypatch, "asarray")
    assert solver.solve().status is SolveStatus.INTERRUPTED
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert solver.solve().status is SolveStatus.SOLVED


def test_an_interrupt_inside_a_system_error_gives_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    x = ca.SX.sym("x")
    solver = Solver(Nlp(x=x, objective=(x - 1) ** 2))

    def broken(**_: object) -> object:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as cause:
            msg = "returned a result with an exception set"
            raise SystemError(msg) from cause

    monkeypatch.setattr(solver, "_nlpsol", broken)
    assert solver.solve().status is SolveStatus.INTERRUPTED


def test_a_hold_inside_a_hold_is_the_same_and_ends_with_the_outer_one() -> None:
    with held_interrupt() as outer:
        with held_interrupt() as inner:
            os.kill(os.getpid(), signal.SIGINT)
        assert inner is outer
        assert outer.asked
        assert signal.getsignal(signal.SIGINT) is outer
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_handler_of_the_caller_is_left_alone() -> None:
    def own(*_: object) -> None:
        """Nothing."""

    before = signal.signal(signal.SIGINT, own)
    try:
        with held_interrupt():
            assert signal.getsignal(signal.SIGINT) is own
    finally:
        signal.signal(signal.SIGINT, before)


def test_versions_are_told() -> None:
    told = versions()
    assert told["casadi"].startswith("3.")
    assert told["ipopt"].startswith("3.")
