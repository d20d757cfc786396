"""A small study with real runs and made analyses, for the report's tests."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from workbench.model.controller import PID
from workbench.model.experiment import Experiment, Noise, Step
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.record import Record
from workbench.model.results import (
    Crossing,
    DescribingFunction,
    Estimate,
    Intervals,
    Iteration,
    LimitCycle,
    LimitCycleStart,
    LinearFit,
    Restart,
    SolveStatus,
    Tuned,
)
from workbench.model.study import CaseResult, NamedEstimate, Study
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Stenman
from workbench.report import page
from workbench.report.page import write_report
from workbench.report.style import svg_text
from workbench.simulate.run import evaluate, simulate

EXPERIMENT = Experiment(duration=1000.0, setpoint=Step(4.0))
LOOP = Loop(FOPDT(1.0, 5.0, 1.0), Stenman(2.0), PID(0.5, 20.0, derivative_filter=math.inf), 1.0)


def make_df(loop: Loop, *, cycle: bool) -> DescribingFunction:
    w = np.geomspace(1e-3, 3.0, 200)
    L = loop.controller.Kc * (1.0 + 1.0 / (loop.controller.Ti * 1j * w)) * np.exp(-1j * w) / (5j * w + 1.0)
    A = np.geomspace(1.01, 50.0, 150)
    locus = -1.0 - 0.8j / A
    crossing = Crossing(2.2, 0.45, 13.9, 0.52, stable=True)
    return DescribingFunction(
        loop=loop,
        amplitudes=A,
        N=-1.0 / locus,
        locus=locus,
        frequencies=w,
        L=L,
        crossings=(crossing,) if cycle else (),
        distance=0.0 if cycle else 0.34,
        distance_amplitude=2.2,
        distance_frequency=0.45,
        predicts_cycle=cycle,
        amplitude=2.2 if cycle else math.nan,
        period=13.9 if cycle else math.nan,
        pv_amplitude=0.52 if cycle else math.nan,
        linear_stable=True,
        verdict="made for a test",
    )


def make_cycle(loop: Loop, outcome: str = "cycles", period: float = 102.5, window: float = 800.0) -> LimitCycle:
    cycles = outcome == "cycles"

    def of(value: float) -> float:
        return value if cycles else math.nan

    def start(name: str, factor: float) -> LimitCycleStart:
        late = of(period * factor)
        return LimitCycleStart(name, outcome, "", of(340.0), late, of(2.01), of(2.06), of(0.81), of(142.0), window)

    return LimitCycle(
        loop=loop,
        outcome=outcome,
        period=of(period),
        period_range=(of(period), of(period * 1.2)),
        pv_peak_to_peak=of(2.01),
        op_peak_to_peak=of(2.06),
        mean_square_error=of(0.81),
        travel_per_hour=of(142.0),
        window=window,
        starts=(start("the given experiment", 1.0), start("setpoint step of 1 EU", 1.2)),
        closed_form_period=of(100.0),
        verdict="made for a test",
    )


def make_tuned(
    controller: PID, objective: float, status: SolveStatus = SolveStatus.SOLVED, worst: float = 1.01
) -> Tuned:
    return Tuned(
        loop=LOOP,
        experiment=EXPERIMENT,
        weights=Objective(),
        bounds=Bounds(Td=(0.0, 0.0)),
        controller=controller,
        objective=objective,
        status=status,
        message="Made for a test.",
        digits=4,
        nominal=objective,
        worst=worst * objective,
        margin=0.001,
        start_objective=226.6,
        guard_margin=0.013,
        slips=9,
        restarts=tuple(Restart(k, objective + 1.0 + k, objective + 0.01 * k, 8900, 12, 140) for k in range(3)),
        evaluations=26700,
        solves=36,
        iterations=420,
        seed=0,
        wall_time=1.5,
        versions={"casadi": "3.8.2"},
    )


def make_case(name: str, Kc: float, Ti: float, Td: float = 0.0, **extra: object) -> CaseResult:
    loop = LOOP.with_controller(replace(LOOP.controller, Kc=Kc, Ti=Ti, Td=Td))
    objective = float(evaluate(loop, EXPERIMENT, Objective())[0])
    case = CaseResult(name, loop, simulate(loop, EXPERIMENT), objective)
    return replace(case, **extra)  # type: ignore[arg-type]


def make_estimate(samples: int = 400, verdict: str = "stiction", *, identifiable: bool = True) -> tuple[Estimate, Loop]:
    truth = Loop(FOPDT(2.0, 5.0, 1.0), Stenman(2.0), PID(0.4, 15.0), 1.0)
    run = simulate(truth, Experiment(duration=float(samples), setpoint=Step(6.0), noise=Noise(0.1, 3)))
    record = Record(pv=run.pv, op=run.op, sp=run.sp, sample_time=1.0, notes=("2 rows were left out",))
    d = np.linspace(0.2, 5.0, 200)
    found = Estimate(
        record=record,
        method="profile",
        plant=FOPDT(1.99, 5.03, 1.0),
        valve=Stenman(2.003),
        valve_position=run.valve,
        prediction=run.pv - 0.01,
        bias=0.01,
        verdict=verdict,
        reasons=("a stem that sticks explains far more", "44 slips"),
        intervals=Intervals(d=(1.99, 2.01), gain=(1.97, 2.01)),
        identifiable=identifiable,
        residual_variance=0.0101,
        aic=-4500.0,
        noise_sd=0.1,
        slips=44,
        linear=LinearFit(FOPDT(1.25, 63.0, 50.0), 0.1, run.pv * 0.5, 1.2, 200.0),
        profile_d=d,
        profile_cost=0.0101 + np.abs(d - 2.003),
        iterations=(
            Iteration(1.0, FOPDT(1.8, 6.0, 1.0), 1.0, 10.0),
            Iteration(2.0, FOPDT(2.0, 5.0, 1.0), 0.01, -4500.0),
        ),
    )
    return found, truth


@pytest.fixture(scope="session")
def study() -> Study:
    """Three tunings of the paper's loop and one estimate, with everything that a study may hold."""
    first = make_case("Case 1", 0.5, 20.0, reference={"error_variance": 0.69, "valve_travel": 12.18})
    second = make_case("Case 2", 0.5, 200.0, reference={"error_variance": 1.0, "valve_travel": 4.01})
    best = make_case("Optimised PI", 2.351, 9.5)
    assert best.objective is not None
    cases = (
        replace(
            first,
            describing_function=make_df(first.loop, cycle=False),
            limit_cycle=make_cycle(first.loop),
            agreement="The describing function predicts no cycle, but the loop cycles.",
            note="The base case.",
        ),
        replace(second, limit_cycle=make_cycle(second.loop, period=28887.0, window=60000.0)),
        replace(
            best,
            tuned=make_tuned(best.loop.controller, best.objective),
            describing_function=make_df(best.loop, cycle=True),
            limit_cycle=make_cycle(best.loop, period=12.0),
            agreement="Both say that the loop cycles.",
        ),
    )
    found, truth = make_estimate()
    return Study(
        name="made",
        title="A study made for tests",
        description="First paragraph.\n\nSecond paragraph.",
        scenario_text="title: A study made for tests\n",
        experiment=EXPERIMENT,
        objective=Objective(),
        estimates=(NamedEstimate("From the record", found, truth, {"d": 1.99, "dead_time": 1.0}),),
        cases=cases,
        reference_source="Table II.",
        notes=("One note.",),
        times={"simulate": 0.5},
    )


@pytest.fixture(scope="session")
def written(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that holds the made study's report."""
    folder = tmp_path_factory.mktemp("reports") / "deep" / "made"
    write_report(study, folder)
    return folder


@pytest.fixture(scope="session")
def write_undrawn() -> Callable[..., None]:
    """Write a report with no figure drawn, as `undrawn` has it, for fixtures that last longer than a test."""
    empty = svg_text(Figure())

    def write(study: Study, folder: Path, **more: bool) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(page, "svg_text", lambda *_: empty)
            write_report(study, folder, **more)

    return write


@pytest.fixture(scope="session")
def case() -> Callable[..., CaseResult]:
    """Make a case: name, Kc, Ti, Td and fields of CaseResult."""
    return make_case


@pytest.fixture(scope="session")
def cycle() -> Callable[..., LimitCycle]:
    """Make a limit cycle of a loop."""
    return make_cycle


@pytest.fixture(scope="session")
def df() -> Callable[..., DescribingFunction]:
    """Make a describing-function analysis of a loop."""
    return make_df


@pytest.fixture(scope="session")
def tuned() -> Callable[..., Tuned]:
    """Make a tuning result."""
    return make_tuned


@pytest.fixture(scope="session")
def estimated() -> Callable[..., tuple[Estimate, Loop]]:
    """Make an estimate and the loop that it came from."""
    return make_estimate
