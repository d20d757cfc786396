"""The loop in complementarity form: exact runs solve it, and any solver of the protocol can stand behind it."""

from __future__ import annotations

import math
from types import MappingProxyType

import casadi as ca
import numpy as np
import pytest

import workbench as wb
from workbench.errors import InvalidValue
from workbench.model.results import SolveStatus
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients
from workbench.simulate.run import evaluate, simulate
from workbench.simulate.signals import signals
from workbench.symbolic.branch import Decisions
from workbench.symbolic.full_space import FullSpace
from workbench.symbolic.loop import COEFFICIENTS
from workbench.symbolic.mpcc import Mpcc, MpccResult
from workbench.symbolic.solve import Values
from workbench.symbolic.sticky import StickyProgram

OBJECTIVE = wb.Objective(w1=0.5, w2=0.01, w3=0.5, w4=0.02)
EXPERIMENT = wb.Experiment(120.0, wb.Step(4.0), load=wb.Step(0.7, at=60.0), noise=wb.Noise(0.01, 3))


class Mirror:
    """A solver that ends where it starts, and shows what it was given."""

    def __init__(self, problem: Mpcc) -> None:
        self.problem = problem

    def solve(self, values: Values | None = None) -> MpccResult:
        assert values is not None
        assert values.start is not None
        nlp, pair = self.problem.nlp, self.problem.pairs[0]
        look = ca.Function("look", [nlp.x], [nlp.objective, ca.vertcat(*(g.expression for g in nlp.groups))])
        sides = ca.Function("sides", [nlp.x], [pair.G, pair.H])
        f, self.rows = look(values.start)
        self.G, self.H = (np.asarray(side).ravel() for side in sides(values.start))
        return MpccResult(
            x=values.start,
            objective=float(f),
            status=SolveStatus.SOLVED,
            message="not moved",
            residuals=MappingProxyType({}),
            complementarity=float(np.abs(self.G * self.H).max()),
            sides=MappingProxyType({}),
            steps=(),
            iterations=0,
            wall_time=0.0,
            versions=MappingProxyType({}),
        )


def program(loop: wb.Loop, bounds: wb.Bounds, mirrors: list[Mirror], experiment=EXPERIMENT) -> StickyProgram:
    def method(problem: Mpcc) -> Mirror:
        mirrors.append(Mirror(problem))
        return mirrors[-1]

    row = coefficients(loop, experiment.stem_offset)[0]
    s = signals(loop, experiment)
    numbers = {name: float(row[getattr(kernel, name)]) for name in COEFFICIENTS}
    parts = (s.r, s.load, s.noise)
    space = FullSpace(loop, numbers, *parts, OBJECTIVE, bounds, size=(4.0, 5.0))
    return StickyProgram(space, reference=10.0, method=method)


def loop_with(plant=None, **controller) -> wb.Loop:
    settings = {"Kc": 0.9, "Ti": 9.0, "Td": 0.3, **controller}
    plant = plant or wb.FOPDT(gain=1.0, time_constant=5.0, dead_time=1.4)
    return wb.Loop(plant=plant, valve=wb.Stenman(2.0), controller=wb.PID(**settings), sample_time=1.0)


LOOPS = {
    "PID on error": loop_with(),
    "PI": loop_with(Td=0.0),
    "unfiltered on PV": loop_with(derivative_on="pv", derivative_filter=math.inf),
    "integrating": loop_with(wb.Integrating(gain=0.1, dead_time=2.0), Ti=40.0),
    "negative gain": loop_with(wb.FOPDT(-1.0, 5.0, 1.0), action="direct"),
    "series": loop_with(form="series", Td=1.0),
    "parallel": loop_with(form="parallel"),
}


@pytest.mark.parametrize("name", LOOPS)
def test_an_exact_run_solves_it_and_rounds_to_its_own_sequence(name: str) -> None:
    loop = LOOPS[name]
    pid = loop.controller
    bounds = wb.Bounds(Kc=(0.1, 5.0), Ti=(2.0, 200.0), Td=(0.0, 0.0) if pid.Td == 0.0 else (0.0, 5.0))
    mirrors: list[Mirror] = []
    decisions = Decisions.from_branch(simulate(loop, EXPERIMENT).branch)
    assert set(decisions.motion.tolist()) == {-1, 0, 1}
    end = program(loop, bounds, mirrors).solve(decisions, (pid.Kc, pid.Ti, pid.Td))
    mirror = mirrors[0]
    equations = np.asarray(mirror.rows).ravel()[: 120 * (4 if pid.Td == 0.0 else 5)]
    assert np.abs(equations).max() < 1e-12
    assert min(mirror.G.min(), mirror.H.min()) > -1e-12
    assert np.abs(mirror.G * mirror.H).max() < 1e-12
    assert end.decisions.key == decisions.key
    assert end.claim == pytest.approx(float(evaluate(loop, EXPERIMENT, OBJECTIVE)[0]), rel=1e-11)
    assert end.tuning == pytest.approx((pid.Kc, pid.Ti, pid.Td), rel=1e-12)
    # The point is that of the branch program: tuning and states.
    assert end.point.size == len(end.point) == equations.size + (2 if pid.Td == 0.0 else 3)


def test_a_decision_that_the_valve_would_not_take_breaks_a_pair() -> None:
    loop = LOOPS["PI"]
    mirrors: list[Mirror] = []
    decisions = Decisions.from_branch(simulate(loop, EXPERIMENT).branch)
    motion = decisions.motion.copy()
    motion[np.flatnonzero(motion == 0)[3]] = 1
    wrong = Decisions(motion, decisions.limit, decisions.undone)
    program(loop, wb.Bounds(Td=(0.0, 0.0)), mirrors).solve(wrong, (0.9, 9.0, 0.0))
    assert min(mirrors[0].G.min(), mirrors[0].H.min()) < -1e-3 or np.abs(mirrors[0].G * mirrors[0].H).max() > 1e-3


@pytest.mark.parametrize(
    ("loop", "says"),
    [
        (wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Choudhury(S=2.0, J=1.0), wb.PID(0.5, 20.0), 1.0), "Stenman"),
        (wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Ideal(), wb.PID(0.5, 20.0), 1.0), "Stenman"),
        (loop_with(output_limits=(-1.0, 9.0)), "no output limits"),
    ],
)
def test_other_loops_are_refused(loop: wb.Loop, says: str) -> None:
    with pytest.raises(InvalidValue, match=says):
        program(loop, wb.Bounds(), [])
