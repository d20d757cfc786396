"""`wb.tune`: exact, reproducible, inside its bounds, at the digits that it shows, and as good as a dense search."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import PAPER_PLANT, paper_loop, paper_step

import workbench as wb
from workbench.simulate.run import evaluate
from workbench.tune.problem import Problem

PI = wb.Bounds(Td=(0.0, 0.0))
START = paper_loop(0.5, 20.0)
SHORT = paper_step(80.0)


def exact(tuned, **changed: float) -> float:
    """J of the tuned controller, or of a changed one, by a simulation of its own."""
    loop = tuned.loop.with_controller(replace(tuned.controller, **changed))
    return float(evaluate(loop, tuned.experiment, tuned.weights)[0])


def digits_of(value: float) -> int:
    """Significant digits of the shortest text that reads back as this number."""
    return len(repr(value).split("e")[0].replace(".", "").strip("0"))


@pytest.fixture(scope="module")
def pi():
    return wb.tune(START, SHORT, wb.Objective(), PI, seed=3, restarts=1)


@pytest.fixture(scope="module")
def pid():
    return wb.tune(START, SHORT, wb.Objective(), wb.Bounds(), seed=3, restarts=2)


# So few neighbourhoods that the plane is soon sieved, which needs three restarts.
SIEVED = {"bounds": PI, "seed": 3, "restarts": 3, "margin": 0.004}


@pytest.fixture(scope="module")
def sieved():
    seen: list[tuple[str, float]] = []
    return wb.tune(START, SHORT, progress=lambda phase, share: seen.append((phase, share)), **SIEVED), seen


def test_the_objective_is_the_exact_cost_of_the_rounded_controller(pi, pid) -> None:
    for tuned in (pi, pid):
        assert tuned.status is wb.SolveStatus.SOLVED
        assert tuned.require_success() is tuned
        assert tuned.objective == exact(tuned)
        assert tuned.bounds.contains(tuned.controller)
        for name in ("Kc", "Ti", "Td"):
            assert digits_of(getattr(tuned.controller, name)) <= 4
        assert tuned.nominal <= tuned.objective <= tuned.worst
        assert tuned.objective < 0.5 * tuned.start_objective
        assert tuned.start_objective == float(evaluate(START, SHORT, wb.Objective())[0])


def test_the_controller_keeps_what_is_not_tuned(pi) -> None:
    assert pi.controller.Td == 0.0
    assert replace(pi.controller, Kc=0.5, Ti=20.0) == START.controller


def test_td_helps_and_the_worst_case_holds_for_fresh_changes(pi, pid) -> None:
    assert pid.objective < 0.95 * pi.objective
    rng = np.random.default_rng(99)
    for tuned in (pi, pid):
        for _ in range(200):
            change = 1.0 + tuned.margin * rng.uniform(-1.0, 1.0, 3)
            c = tuned.controller
            cost = exact(tuned, Kc=c.Kc * change[0], Ti=c.Ti * change[1], Td=c.Td * change[2])
            assert cost <= 1.002 * tuned.worst


def test_no_worse_than_a_dense_grid_of_pi_tunings(pi) -> None:
    Kc, Ti = np.meshgrid(np.linspace(0.02, 10.0, 200), np.geomspace(5.0, 600.0, 200))
    grid = np.column_stack([Kc.ravel(), Ti.ravel(), np.zeros(Kc.size)])
    costs = evaluate(START, SHORT, wb.Objective(), grid)
    assert pi.objective <= 1.01 * costs.min()


def test_statistics_tell_what_was_done(pid) -> None:
    assert len(pid.restarts) == 2
    assert pid.evaluations > sum(r.evaluations for r in pid.restarts)
    assert pid.solves == sum(r.solves for r in pid.restarts) > 0
    assert pid.iterations == sum(r.iterations for r in pid.restarts) >= pid.solves
    assert all(r.refined <= r.scanned for r in pid.restarts)
    assert pid.spread[0] == pytest.approx(pid.nominal, rel=1e-12)
    assert set(pid.versions) == {"casadi", "ipopt"}
    assert "branch programs verified" in pid.message
    run = wb.simulate(START.with_controller(pid.controller), SHORT)
    assert pid.slips == np.count_nonzero(np.diff(run.valve, prepend=0.0))
    lead = np.abs(run.op - np.append(0.0, run.valve[:-1]))
    assert pid.guard_margin == pytest.approx(np.abs(lead - 2.0).min(), rel=1e-9)


def test_equal_seeds_give_equal_results(sieved) -> None:
    began = time.perf_counter()
    again = wb.tune(START, SHORT, **SIEVED)
    assert 0.0 < again.wall_time <= time.perf_counter() - began
    assert again.solves > 0
    assert again.worst_bound is not None
    for name in ("controller", "objective", "worst", "nominal", "restarts", "evaluations", "solves", "message"):
        assert getattr(again, name) == getattr(sieved[0], name), name


def test_fixed_parameters_stay_as_given() -> None:
    bounds = wb.Bounds(Kc=(1.23456789, 1.23456789), Ti=(5.0, 600.0), Td=(0.0, 0.0))
    tuned = wb.tune(START, SHORT, bounds=bounds)
    assert (tuned.controller.Kc, tuned.controller.Td) == (1.23456789, 0.0)
    assert tuned.status.success
    Ti = np.geomspace(5.0, 600.0, 3000)
    grid = np.column_stack([np.full(3000, 1.23456789), Ti, np.zeros(3000)])
    costs = evaluate(START, SHORT, wb.Objective(), grid)
    assert tuned.nominal <= 1.002 * costs.min()
    # The best point of the grid is a cliff's edge: within the digits it is worse than what was chosen.
    problem = Problem(START, SHORT, wb.Objective(), bounds, 4, 0.001)
    assert tuned.worst <= problem.worst_below(grid[[np.argmin(costs)]], np.array([np.inf]), dense=True)[0]


def test_all_fixed_is_an_evaluation() -> None:
    tuned = wb.tune(START, SHORT, bounds=wb.Bounds(Kc=(2.0, 2.0), Ti=(9.0, 9.0), Td=(0.5, 0.5)))
    assert tuned.controller == replace(START.controller, Kc=2.0, Ti=9.0, Td=0.5)
    assert tuned.objective == exact(tuned)
    assert tuned.solves == 0
    assert "fixed" in tuned.message


@pytest.mark.parametrize(
    ("valve", "plant", "controller"),
    [
        (wb.Choudhury(S=2.0, J=0.8), PAPER_PLANT, {"derivative_on": "pv"}),
        (wb.Deadband(b=1.0), wb.FOPDT(-0.5, 8.0, 2.3), {"action": "direct", "form": "series"}),
        (wb.Stenman(1.0), PAPER_PLANT, {"output_limits": (-2.0, 5.0), "anti_windup": "back_calculation"}),
        (wb.He(fs=1.5, fd=0.6), PAPER_PLANT, {"output_limits": (-2.0, 5.0)}),
        (wb.Ideal(), wb.Integrating(gain=0.1, dead_time=1.5), {"Ti": 40.0, "form": "parallel"}),
    ],
    ids=[
        "Choudhury, PV",
        "Deadband, series, direct",
        "Stenman, back-calculation",
        "He, clamp",
        "Ideal, integrating, parallel",
    ],
)
def test_every_kind_of_loop(valve, plant, controller) -> None:
    pid = wb.PID(**{"Kc": 0.5, "Ti": 20.0, "Td": 0.0, **controller})
    loop = wb.Loop(plant, valve, pid, sample_time=1.0)
    experiment = wb.Experiment(80.0, wb.Step(4.0), load=wb.Step(0.5, at=40.0))
    objective = wb.Objective(w4=0.05)
    tuned = wb.tune(loop, experiment, objective, wb.Bounds(), seed=1, restarts=1, digits=2)
    assert tuned.status is wb.SolveStatus.SOLVED
    assert tuned.objective == exact(tuned)
    assert tuned.solves > 0
    # A branch program was accepted: its claim and the exact simulation agree to 1e-9.
    assert not tuned.message.startswith("0 of")
    assert tuned.guard_margin > 0.0
    rng = np.random.default_rng(0)
    count = 10_000
    random = np.column_stack(
        [10.0 * rng.random(count) ** 2, 5.0 * 120.0 ** rng.random(count), 60.0 * rng.random(count) ** 4]
    )
    random[: count // 4, 2] = 0.0
    costs = evaluate(loop, experiment, objective, random)
    assert tuned.nominal <= 1.002 * costs.min()
    problem = Problem(loop, experiment, objective, wb.Bounds(), 2, 0.001)
    best = random[np.argsort(costs)[:20]]
    # Both by as many points: of fewer the worst is less.
    assert tuned.worst <= 1.002 * min(problem.last_word(one, proof=True) for one in best)


@pytest.mark.parametrize("valve", [wb.Kano(2.0, 0.8), wb.Directional(wb.Choudhury(2.0, 0.8), wb.Choudhury(3.0, 1.0))])
def test_a_valve_without_branch_programs_is_tuned_by_direct_search(valve) -> None:
    loop = wb.Loop(PAPER_PLANT, valve, wb.PID(0.5, 20.0), sample_time=1.0)
    tuned = wb.tune(loop, paper_step(80.0), bounds=wb.Bounds(Td=(0.0, 0.0)), restarts=1, digits=2)
    assert tuned.status is wb.SolveStatus.SOLVED
    assert tuned.solves == 0
    assert f"do not know the valve {type(valve).__name__}" in tuned.message
    assert tuned.objective == exact(tuned) < tuned.start_objective
    assert 0.0 < tuned.guard_margin < math.inf


@settings(deadline=None, max_examples=2)
@given(
    d=st.floats(0.2, 3.0),
    tau=st.floats(2.0, 20.0),
    theta=st.floats(0.0, 5.0),
    gain=st.floats(0.3, 3.0),
    digits=st.integers(2, 6),
)
def test_random_loops_end_verified_within_bounds_and_digits(d, tau, theta, gain, digits) -> None:
    loop = wb.Loop(wb.FOPDT(gain, tau, theta), wb.Stenman(d), wb.PID(0.5, 20.0), sample_time=1.0)
    tuned = wb.tune(loop, wb.Experiment(80.0, wb.Step(4.0)), bounds=PI, digits=digits, restarts=1)
    assert tuned.status is wb.SolveStatus.SOLVED
    assert tuned.objective == exact(tuned) <= tuned.worst
    assert PI.contains(tuned.controller)
    assert max(digits_of(tuned.controller.Kc), digits_of(tuned.controller.Ti)) <= digits
    assert tuned.nominal <= tuned.start_objective


@pytest.mark.parametrize(
    ("name", "bounds", "where"),
    [
        ("Kc", wb.Bounds(Kc=(1.0, 10.0)), "PID.Kc"),
        ("Ti", wb.Bounds(Ti=(30.0, 60.0)), "PID.Ti"),
        ("Td", wb.Bounds(Td=(1.0, 5.0)), "PID.Td"),
    ],
)
def test_bounds_that_exclude_the_start_are_refused(name: str, bounds: wb.Bounds, where: str) -> None:
    with pytest.raises(wb.InvalidValue, match="must lie within the bounds") as caught:
        wb.tune(START, SHORT, bounds=bounds)
    assert caught.value.where == where
    low, high = getattr(bounds, name)
    assert f"({low:g}, {high:g})" in str(caught.value)


@pytest.mark.parametrize(
    "wrong",
    [{"seed": -1}, {"seed": 1.5}, {"digits": 0}, {"digits": 13}, {"restarts": 0}, {"guard": -0.1}, {"guard": math.nan},
     {"margin": 0.3}, {"time_limit": 0.0}, {"time_limit": math.inf}],
)  # fmt: skip
def test_wrong_options_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(wb.InvalidValue, match=f"tune.{next(iter(wrong))}"):
        wb.tune(START, SHORT, bounds=PI, **wrong)


def test_an_experiment_that_does_not_fit_is_refused() -> None:
    with pytest.raises(wb.InvalidValue, match="whole number of samples"):
        wb.tune(START, wb.Experiment(100.5, wb.Step(4.0)), bounds=PI)


def test_ctrl_c_returns_the_best_so_far() -> None:
    def progress(phase: str, _share: float) -> None:
        if phase.startswith("global scan 2"):
            raise KeyboardInterrupt

    tuned = wb.tune(START, SHORT, bounds=PI, progress=progress)
    assert tuned.status is wb.SolveStatus.INTERRUPTED
    assert tuned.objective == exact(tuned) < 0.1 * tuned.start_objective
    assert len(tuned.restarts) == 1
    with pytest.raises(wb.SolveError, match="interrupted"):
        tuned.require_success()


def test_ctrl_c_at_once_still_returns_a_controller() -> None:
    def progress(_phase: str, share: float) -> None:
        if share == 0.0:
            raise KeyboardInterrupt

    tuned = wb.tune(START, SHORT, bounds=PI, progress=progress)
    assert tuned.status is wb.SolveStatus.INTERRUPTED
    assert tuned.objective == exact(tuned)


def test_a_parameter_on_its_bound_is_said(pi) -> None:
    loop = replace(START, valve=wb.Ideal(), controller=replace(START.controller, Kc=0.1))
    tuned = wb.tune(loop, SHORT, bounds=wb.Bounds(Kc=(0.0, 0.1), Ti=(20.0, 20.0), Td=(0.0, 0.0)), restarts=1)
    assert tuned.controller.Kc == 0.1
    assert "Kc ends on its upper bound (0.1): wider bounds may" in tuned.message
    assert "Ti ends" not in tuned.message
    assert "Td ends" not in tuned.message
    assert "ends on its" not in pi.message


@pytest.mark.slow
def test_a_pid_search_is_no_worse_than_the_pi_within_its_bounds() -> None:
    # A level loop where derivative does not help: the best tuning lies on the face Td = 0.
    pid = wb.PID(4.0, 600.0, form="series", derivative_on="pv", action="direct")
    loop = wb.Loop(wb.Integrating(-0.002, 12.5), wb.Choudhury(5.0, 1.5), pid, 5.0)
    task = wb.Experiment(3000.0, wb.Ramp(6.0, 300.0, 900.0), wb.Step(3.0, 1500.0), wb.Noise(0.1, 7))
    weights = wb.Objective(w1=0.5, w3=0.5, w4=0.1)
    ends = wb.Bounds(Kc=(0.2, 10.0), Ti=(60.0, 3600.0), Td=(0.0, 0.0))
    # The tuning that a search for a PI ends with.
    plain = Problem(loop, task, weights, ends, 4, 0.001).last_word(np.array([4.221, 83.38, 0.0]))
    full = wb.tune(loop, task, weights, replace(ends, Td=(0.0, 120.0)), restarts=1)
    assert full.worst <= 1.003 * plain
    assert full.controller.Td == 0.0 or full.controller.Td >= 0.02 * 5.0


def test_the_time_limit_returns_the_best_so_far() -> None:
    tuned = wb.tune(START, SHORT, bounds=PI, time_limit=1e-6)
    assert tuned.status is wb.SolveStatus.TIME_LIMIT
    assert "time limit" in tuned.message
    assert tuned.objective == exact(tuned)


def test_progress_rises_to_one(sieved) -> None:
    _, seen = sieved
    shares = [share for _, share in seen]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert all(phase for phase, _ in seen)


def test_progress_goes_on_while_the_plane_is_sieved(sieved) -> None:
    shares = [share for phase, share in sieved[1] if phase == "worst case within the digits"]
    assert shares == sorted(shares)
    assert sum(0.56 < share < 0.8 for share in shares) >= 5


def test_a_loop_that_no_tuning_holds_ends_without_success() -> None:
    # The wrong action makes the loop unstable at every gain allowed.
    pid = wb.PID(5.0, 5.0, action="direct")
    loop = wb.Loop(wb.FOPDT(3.0, 2.0, 1.0), wb.Ideal(), pid, sample_time=1.0)
    bounds = wb.Bounds(Kc=(4.0, 10.0), Ti=(5.0, 10.0), Td=(0.0, 0.0))
    tuned = wb.tune(loop, wb.Experiment(1000.0, wb.Step(4.0)), bounds=bounds, restarts=1)
    assert tuned.status is wb.SolveStatus.DIVERGED
    assert math.isinf(tuned.objective)
    assert "diverging" in tuned.message


def test_long_records_are_tuned_without_branch_programs() -> None:
    bounds = wb.Bounds(Kc=(0.5, 0.5), Ti=(19.0, 21.0), Td=(0.0, 0.0))
    tuned = wb.tune(START, wb.Experiment(10_001.0, wb.Step(4.0)), bounds=bounds, restarts=1, digits=2)
    assert tuned.status is wb.SolveStatus.SOLVED
    assert tuned.solves == 0
    assert "without branch programs" in tuned.message
    assert tuned.objective == exact(tuned)


def test_coordinates_of_the_search_there_and_back() -> None:
    problem = Problem(START, SHORT, wb.Objective(), wb.Bounds(), 4, 0.001)
    tunings = np.array([[0.0, 5.0, 0.0], [10.0, 600.0, 60.0], [1.0, 30.0, 2.0]])
    points = problem.cube(tunings)
    assert points[0].tolist() == [0.0, 0.0, 0.0]
    assert points[1].tolist() == [1.0, 1.0, 1.0]
    assert problem.tunings(points) == pytest.approx(tunings, rel=1e-12)
    assert problem.tunings(points)[:2].tolist() == tunings[:2].tolist()


def test_capped_costs_are_the_exact_ones_or_inf() -> None:
    problem = Problem(START, SHORT, wb.Objective(w2=0.1, w4=0.3), wb.Bounds(), 4, 0.001)
    rng = np.random.default_rng(0)
    tunings = problem.tunings(rng.random((300, 3)))
    costs = problem.exact(tunings)
    ceiling = float(np.median(costs))
    capped = problem.below(tunings, np.full(300, ceiling))
    assert np.isinf(capped[costs > ceiling * (1 + 1e-9)]).all()
    below = costs < ceiling * (1 - 1e-9)
    assert capped[below] == pytest.approx(costs[below], rel=1e-12)
    worst = problem.worst_below(tunings[:5], np.full(5, np.inf), dense=True)
    assert (worst >= costs[:5] * (1 - 1e-12)).all()


def test_a_loop_that_no_tuning_holds_is_not_called_solved() -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(1.0), wb.PID(80.0, 0.1), sample_time=1.0)
    bounds = wb.Bounds(Kc=(50.0, 100.0), Ti=(0.05, 0.2), Td=(0.0, 0.0))
    tuned = wb.tune(loop, wb.Experiment(60.0, wb.Step(4.0)), bounds=bounds, restarts=1)
    assert tuned.status is wb.SolveStatus.DIVERGED
    assert "diverging" in tuned.message


def test_the_door_names_what_is_no_objective() -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(1.0), wb.PID(0.5, 20.0), sample_time=1.0)
    with pytest.raises(wb.InvalidValue, match="must be an Objective"):
        wb.tune(loop, wb.Experiment(60.0, wb.Step(4.0)), objective={"w1": 1.0})  # type: ignore[arg-type]
    with pytest.raises(wb.InvalidValue, match="must be a Bounds"):
        wb.tune(loop, wb.Experiment(60.0, wb.Step(4.0)), bounds={"Kc": (0, 1)})  # type: ignore[arg-type]


@pytest.mark.parametrize(("gain", "action", "wrong"), [(-1.0, "reverse", True), (-1.0, "direct", False)])
def test_a_controller_that_acts_the_wrong_way_is_said(gain: float, action: str, wrong: bool) -> None:
    loop = wb.Loop(wb.FOPDT(gain, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0, action=action), 1.0)
    found = wb.tune(loop, wb.Experiment(100.0, setpoint=wb.Step(4.0)), restarts=1, max_evaluations=2000)
    assert ("acts the wrong way" in found.message) == wrong


@pytest.mark.parametrize(
    "asked", [{"constraints": wb.Constraints(max_sensitivity=2.0)}, {"robust": wb.Ensemble(50.0, (1.0, 2.0), draws=3)}]
)
def test_and_left_alone_under_constraints_too(asked: dict[str, object]) -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(1.0), wb.PID(0.5, 20.0, action="direct"), 1.0)
    bounds = wb.Bounds(Td=(0, 0))
    found = wb.tune(loop, wb.Experiment(50.0, wb.Step(1.0)), bounds=bounds, restarts=1, digits=3, **asked)
    assert found.status is wb.SolveStatus.SOLVED
    assert found.controller.Kc == 0.0
    assert "acts the wrong way" in found.message
    assert "wider bounds" not in found.message


def test_of_no_gain_it_is_said_that_nothing_else_plays_a_part() -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(1.0), wb.PID(0.5, 20.0), 1.0)
    asked = wb.Constraints(valve_travel=1e-3)
    found = wb.tune(loop, wb.Experiment(50.0, wb.Step(1.0)), constraints=asked, restarts=1)
    assert found.controller.Kc == 0.0
    assert "Ti and Td play no part" in found.message
    assert "wider bounds" not in found.message


@pytest.mark.parametrize(
    ("bounds", "asked"),
    [
        (wb.Bounds((0.995, 1.005), (19.9, 20.1), (0.0, 0.0)), {}),
        (wb.Bounds((0.995, 1.005), (20.0, 20.0), (0.0, 0.0)), {}),
        (wb.Bounds((1.0, 3.0), (20.0, 40.0), (1.0, 3.0)), {"digits": 2}),
    ],
    ids=["plane", "line", "space"],
)
def test_bounds_of_a_few_neighbourhoods_are_searched_too(bounds: wb.Bounds, asked: dict[str, int]) -> None:
    # A sieve's finer strides add no points there.
    start = paper_loop(1.0, 20.0).with_controller(wb.PID(1.0, 20.0, bounds.Td[0]))
    tuned = wb.tune(start, SHORT, bounds=bounds, **asked)
    assert tuned.status is wb.SolveStatus.SOLVED
    assert bounds.Kc[0] <= tuned.controller.Kc <= bounds.Kc[1]
    assert tuned.objective == exact(tuned)


def test_a_tuning_that_the_simulation_refuses_is_none() -> None:
    # Tt is Ti unless given: back-calculation is unstable from half the sample time down.
    pid = wb.PID(0.1, 20.0, output_limits=(-5.0, 5.0), anti_windup="back_calculation")
    loop, run = wb.Loop(wb.FOPDT(1.0, 2.0, 0.0), wb.Stenman(0.5), pid, 10.0), wb.Experiment(400.0, wb.Step(3.0))
    values = wb.evaluate(loop, run, wb.Objective(), [[0.1, 4.0, 0.0], [0.1, 5.0, 0.0], [0.1, 5.01, 0.0]])
    assert np.isfinite(values).tolist() == [False, False, True]
    tuned = wb.tune(loop, run, bounds=wb.Bounds((0.0, 2.0), (1.0, 600.0), (0.0, 0.0)), restarts=1)
    Ti = tuned.controller.Ti
    assert Ti - 0.001 * Ti > 5.0
    wb.simulate(loop.with_controller(tuned.controller), run)


def test_where_every_tuning_does_alike_the_plane_is_sieved_and_none_is_better() -> None:
    # The stem never moves: J is one value over the whole plane, of which no neighbourhood is better than another.
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Choudhury(4.0, 1.0), wb.PID(0.5, 20.0), 1.0)
    experiment, bounds = wb.Experiment(100.0, noise=wb.Noise(0.1, 1)), wb.Bounds(Kc=(0.0, 1.0), Td=(0.0, 0.0))
    tuned = wb.tune(loop, experiment, bounds=bounds, restarts=3, margin=0.003)
    assert tuned.slips == 0
    assert tuned.worst_bound == pytest.approx(tuned.worst, rel=1e-8)
    assert "Kc ends on its lower bound" not in tuned.message
