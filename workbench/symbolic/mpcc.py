"""Programs with complementarity: `0 <= G(x) perp H(x) >= 0` beside an `Nlp`, solved by a homotopy of relaxed programs.

With sigma -> 0, each relaxation makes a smooth program of the pairs:

- "scholtes": `G >= 0, H >= 0, G H <= sigma`. S. Scholtes, "Convergence properties of a regularization scheme for
  mathematical programs with complementarity constraints", SIAM J. Optim. 11 (2001) 918-936.
- "fischer_burmeister": `G + H - sqrt(G^2 + H^2 + 2 sigma) = 0`, which is `G H = sigma` with both positive. C. Kanzow,
  "Some noninterior continuation methods for linear complementarity problems", SIAM J. Matrix Anal. Appl. 17 (1996)
  851-868.
- "l1": `G >= 0, H >= 0`, and `sum(G H) / sigma` added to the objective, exact once sigma is small enough. D. Ralph,
  S.J. Wright, "Some properties of regularization and penalization schemes for MPECs", Optim. Methods Softw. 19 (2004)
  527-556.

A relaxed solution only tells which side of each pair is zero; the last step therefore solves the program with these
sides fixed at zero, whose solution is complementary exactly. What is found is a local solution, and may be one of that
choice of sides alone.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InvalidValue, SolveError
from workbench.model.checks import choice, instance, number
from workbench.model.record import FloatArray
from workbench.model.results import NlpResult, SolveStatus
from workbench.symbolic.solve import Group, IpoptOptions, Nlp, Solver, Values, versions

__all__ = ["RELAXATIONS", "Homotopy", "HomotopyStep", "Mpcc", "MpccResult", "MpccSolver", "Pairs", "RelaxedSolver"]

RELAXATIONS = ("scholtes", "fischer_burmeister", "l1")
# After so many relaxed programs in a row that came to nothing, the rest of the schedule is given up.
FAILURES = 2


@dataclass(frozen=True, eq=False)
class Pairs:
    """Named pairs `0 <= G perp H >= 0`: two columns of expressions in x and p, of equal length."""

    name: str
    G: Any
    H: Any


@dataclass(frozen=True, eq=False)
class Mpcc:
    """A program and its complementarity pairs. The names of pairs and groups differ. Raises `InvalidValue`."""

    nlp: Nlp
    pairs: tuple[Pairs, ...]

    def __post_init__(self) -> None:
        names = [group.name for group in self.nlp.groups] + [pair.name for pair in self.pairs]
        if len(set(names)) != len(names):
            raise InvalidValue("Mpcc.pairs", names, "each group and each pair needs a name of its own")
        for pair in self.pairs:
            sizes = int(pair.G.numel()), int(pair.H.numel())
            if sizes[0] != sizes[1]:
                raise InvalidValue(f"Mpcc.pairs[{pair.name}]", sizes, "G and H must have the same length")
        if not self.pairs:
            raise InvalidValue("Mpcc.pairs", "none", "at least one pair; a program without any is an Nlp")


@dataclass(frozen=True, slots=True)
class Homotopy:
    """How the pairs are relaxed, step by step.

    relaxation: one of `RELAXATIONS`. sigmas: above 0, falling strictly; the product G H that a step allows (for "l1"
    the inverse weight of the sum of products). tolerance: the product, and the violation of any constraint, that a
    solution may have, 1e-12..1e-2. finish: whether the last step fixes the side of each pair that is nearer to zero.
    Raises `InvalidValue`.
    """

    relaxation: str = "scholtes"
    sigmas: tuple[float, ...] = (1.0, 0.1, 1e-2, 1e-4, 1e-6, 1e-8)
    tolerance: float = 1e-6
    finish: bool = True

    def __post_init__(self) -> None:
        choice(self.relaxation, "Homotopy.relaxation", RELAXATIONS)
        given: object = self.sigmas
        if isinstance(given, str) or not isinstance(given, Sequence) or not given:
            raise InvalidValue("Homotopy.sigmas", given, "must be one or more numbers > 0 that fall strictly")
        sigmas = tuple(number(s, f"Homotopy.sigmas[{k}]", above=0.0) for k, s in enumerate(given))
        if any(after >= before for before, after in itertools.pairwise(sigmas)):
            raise InvalidValue("Homotopy.sigmas", self.sigmas, "must fall strictly")
        object.__setattr__(self, "sigmas", sigmas)
        number(self.tolerance, "Homotopy.tolerance", least=1e-12, most=1e-2)
        instance(self.finish, bool, "Homotopy.finish", "True or False")


@dataclass(frozen=True, slots=True)
class HomotopyStep:
    """One program of a homotopy, judged at its end point by the problem itself and not by its relaxation.

    sigma: 0 for the last step, which fixes sides. residual: worst violation of bounds, groups, G >= 0 and H >= 0.
    complementarity: worst |G H|. objective: without penalty terms. wall_time: s.
    """

    sigma: float
    status: SolveStatus
    iterations: int
    residual: float
    complementarity: float
    objective: float
    wall_time: float


@dataclass(frozen=True, eq=False)
class MpccResult:
    """The end of a homotopy: the point of its best step, x (shape (n,)), and that step's figures.

    The best step is, of those that were solved, the one of the least sigma within the tolerance; if none is within, the
    one with the least max(residual, complementarity). residuals: worst violation by name of group and pair. sides: by
    name of pair, True where G is the side nearer to zero. steps: all that was solved, in order; iterations and
    wall_time (s) over all of them.
    """

    x: FloatArray
    objective: float
    status: SolveStatus
    message: str
    residuals: Mapping[str, float]
    complementarity: float
    sides: Mapping[str, NDArray[np.bool_]]
    steps: tuple[HomotopyStep, ...]
    iterations: int
    wall_time: float
    versions: Mapping[str, str]

    @property
    def residual(self) -> float:
        """The worst violation of any constraint; `nan` if nothing was evaluated."""
        return max(self.residuals.values(), default=math.nan)

    def require_success(self) -> MpccResult:
        """Return self if solved, else raise `SolveError`."""
        if not self.status.success:
            msg = (
                f"the solve ended as {self.status.value} ({self.message}); worst residual {self.residual:.3g}, "
                f"complementarity {self.complementarity:.3g}"
            )
            raise SolveError(msg)
        return self


class MpccSolver(Protocol):
    """What solves an `Mpcc` that it was made for; `RelaxedSolver` is one way."""

    def solve(self, values: Values | None = None) -> MpccResult:
        """Solve from a start and for parameters. Never raises for a solve that fails: its status says so."""
        ...


@dataclass(frozen=True, eq=False)
class _Point:
    """A step with what is needed to go on from it or to end with it."""

    step: HomotopyStep
    x: FloatArray
    residuals: Mapping[str, float]
    sides: Mapping[str, NDArray[np.bool_]]

    @property
    def worst(self) -> float:
        worst = float(np.maximum(self.step.residual, self.step.complementarity))
        return worst if math.isfinite(worst) else math.inf


class RelaxedSolver:
    """An `Mpcc` compiled once for one homotopy, to be solved by IPOPT for many starts, parameters and bounds.

    tell: called with the share of the steps done. Not to be used from several threads: IPOPT is not safe there.
    """

    def __init__(
        self,
        problem: Mpcc,
        homotopy: Homotopy | None = None,
        options: IpoptOptions | None = None,
        tell: Callable[[float], None] | None = None,
    ) -> None:
        self._problem = problem
        self._tell = tell
        self._homotopy = homotopy or Homotopy()
        nlp = problem.nlp
        self._size = int(nlp.x.numel())
        self._own = 0 if nlp.parameters is None else int(nlp.parameters.numel())
        # One column of parameters, sigma last: what a solver takes must be a plain symbol.
        kind = type(nlp.x)
        p = kind.sym("p", self._own + 1)
        given = [nlp.x] if nlp.parameters is None else [nlp.x, nlp.parameters]
        sides = [side for pair in problem.pairs for side in (ca.vec(pair.G), ca.vec(pair.H))]
        written = [nlp.objective, *(ca.vec(group.expression) for group in nlp.groups), *sides]
        law = ca.Function("mpcc", given, written)
        f, *rest = law.call([nlp.x] if nlp.parameters is None else [nlp.x, p[: self._own]])
        groups = tuple(
            replace(group, expression=e) for group, e in zip(nlp.groups, rest[: len(nlp.groups)], strict=True)
        )
        G, H = rest[len(nlp.groups) :: 2], rest[len(nlp.groups) + 1 :: 2]
        self._judge = ca.Function("judge", [nlp.x, p], [f, *G, *H])
        base = replace(nlp, objective=f, groups=groups, parameters=p)
        self._relaxed = Solver(_relaxed(base, problem.pairs, G, H, p[self._own], self._homotopy.relaxation), options)
        sided = tuple(Group(_side(pair, "G"), g) for pair, g in zip(problem.pairs, G, strict=True)) + tuple(
            Group(_side(pair, "H"), h) for pair, h in zip(problem.pairs, H, strict=True)
        )
        self._fixed = Solver(replace(base, groups=groups + sided), options) if self._homotopy.finish else None

    def solve(self, values: Values | None = None) -> MpccResult:
        """Solve once; see `MpccSolver`. Ctrl-C gives the best step so far as `INTERRUPTED`."""
        given = values or Values()
        began = time.perf_counter()
        points: list[_Point] = []
        interrupted = False
        start = given.start
        try:
            failures = 0
            for sigma in self._homotopy.sigmas:
                found = self._step(self._relaxed, given, start, sigma, {})
                points.append(found)
                if self._tell is not None:
                    self._tell(len(points) / (len(self._homotopy.sigmas) + self._homotopy.finish))
                interrupted = found.step.status is SolveStatus.INTERRUPTED
                failures = 0 if found.step.status.success else failures + 1
                exact = self._homotopy.relaxation == "l1" and self._good(found)
                if interrupted or failures == FAILURES or exact:
                    break
                start = min(points, key=_usable).x
            if self._fixed is not None and not interrupted:
                best = min(points, key=self._rank)
                last = self._step(self._fixed, given, best.x, 0.0, self._held(best.sides))
                points.append(last)
                interrupted = last.step.status is SolveStatus.INTERRUPTED
        except KeyboardInterrupt:
            interrupted = True
        return self._ended(points, given, interrupted, time.perf_counter() - began)

    def _step(
        self,
        solver: Solver,
        given: Values,
        start: FloatArray | None,
        sigma: float,
        held: Mapping[str, tuple[FloatArray, FloatArray]],
    ) -> _Point:
        p = np.append(np.zeros(self._own) if given.parameters is None else given.parameters, sigma)
        bounds = MappingProxyType({**given.bounds, **held})
        result = solver.solve(replace(given, start=start, parameters=p, bounds=bounds))
        return self._judged(result, p, sigma)

    def _judged(self, result: NlpResult, p: FloatArray, sigma: float) -> _Point:
        """The step as the problem itself sees its end point."""
        pairs, names = self._problem.pairs, {group.name for group in self._problem.nlp.groups} | {"bounds"}
        f, *sides = (np.asarray(part, dtype=np.float64).ravel() for part in self._judge.call([result.x, p]))
        residuals = {name: worst for name, worst in result.residuals.items() if name in names}
        nearer: dict[str, NDArray[np.bool_]] = {}
        product = 0.0
        for k, pair in enumerate(pairs):
            G, H = sides[k], sides[len(pairs) + k]
            residuals[pair.name] = float(np.maximum(-np.minimum(G, H), 0.0).max(initial=0.0))
            product = float(np.maximum(product, np.abs(G * H).max(initial=0.0)))
            nearer[pair.name] = G <= H
        step = HomotopyStep(
            sigma=sigma,
            status=result.status,
            iterations=result.iterations,
            residual=float(np.max(list(residuals.values()))),
            complementarity=product,
            objective=float(f[0]),
            wall_time=result.wall_time,
        )
        return _Point(step, result.x, MappingProxyType(residuals), MappingProxyType(nearer))

    def _held(self, sides: Mapping[str, NDArray[np.bool_]]) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Bounds that hold the chosen side of each pair at zero and the other above."""
        bounds: dict[str, tuple[FloatArray, FloatArray]] = {}
        for pair in self._problem.pairs:
            zero = sides[pair.name]
            bounds[_side(pair, "G")] = (np.zeros(zero.size), np.where(zero, 0.0, math.inf))
            bounds[_side(pair, "H")] = (np.zeros(zero.size), np.where(zero, math.inf, 0.0))
        return bounds

    def _good(self, point: _Point) -> bool:
        return point.step.status.success and point.worst <= self._homotopy.tolerance

    def _rank(self, point: _Point) -> tuple[bool, float, float]:
        """Solved before unsolved, then the least violation, then the least sigma."""
        excess = point.worst if point.worst > self._homotopy.tolerance else 0.0
        return not point.step.status.success, excess, point.step.sigma

    def _ended(self, points: list[_Point], given: Values, interrupted: bool, wall_time: float) -> MpccResult:
        steps = tuple(point.step for point in points)
        best = min(points, key=self._rank, default=None)
        status, message = self._verdict(points, best, interrupted)
        if best is None:
            start = np.asarray(self._problem.nlp.start if given.start is None else given.start, dtype=np.float64)
            x, objective, product = np.broadcast_to(start, (self._size,)).copy(), math.nan, math.nan
        else:
            x, objective, product = best.x, best.step.objective, best.step.complementarity
        return MpccResult(
            x=x,
            objective=objective,
            status=status,
            message=message,
            residuals=MappingProxyType({}) if best is None else best.residuals,
            complementarity=product,
            sides=MappingProxyType({}) if best is None else best.sides,
            steps=steps,
            iterations=sum(step.iterations for step in steps),
            wall_time=wall_time,
            versions=versions(),
        )

    def _verdict(self, points: list[_Point], best: _Point | None, interrupted: bool) -> tuple[SolveStatus, str]:
        if interrupted or best is None:
            return SolveStatus.INTERRUPTED, f"stopped by the user after {len(points)} steps; the best step is kept"
        last = points[-1].step
        if not best.step.status.success:
            return last.status, "no step was solved"
        if not self._good(best):
            if not last.status.success:
                return last.status, f"the step of sigma = {last.sigma:g} was not solved; the best step is kept"
            return SolveStatus.FAILED, "every step was solved, but the best is not complementary and feasible"
        ways = "sides fixed" if best.step.sigma == 0.0 else f"sigma = {best.step.sigma:g}"
        if best.step is last or best.step.sigma <= self._homotopy.sigmas[-1]:
            return best.step.status, f"solved in {len(points)} steps; {ways}"
        return SolveStatus.ACCEPTABLE, f"later steps were not solved or not better; {ways}"


def _usable(point: _Point) -> tuple[bool, float]:
    """The latest point that was solved, else the latest at all."""
    return not point.step.status.success, point.step.sigma


def _side(pair: Pairs, side: str) -> str:
    return f"{pair.name}: {side} >= 0"


def _relaxed(nlp: Nlp, pairs: tuple[Pairs, ...], G: list[Any], H: list[Any], sigma: Any, relaxation: str) -> Nlp:
    """Return the smooth program whose parameter is sigma."""
    groups = list(nlp.groups)
    objective = nlp.objective
    for pair, g, h in zip(pairs, G, H, strict=True):
        if relaxation == "fischer_burmeister":
            groups.append(Group(pair.name, g + h - ca.sqrt(g**2 + h**2 + 2.0 * sigma)))
            continue
        groups += [Group(_side(pair, "G"), g, 0.0, math.inf), Group(_side(pair, "H"), h, 0.0, math.inf)]
        if relaxation == "scholtes":
            groups.append(Group(pair.name, g * h - sigma, -math.inf, 0.0))
        else:
            objective = objective + ca.sum1(g * h) / sigma
    return replace(nlp, objective=objective, groups=tuple(groups))
