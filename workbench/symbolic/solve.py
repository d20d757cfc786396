"""The seam over IPOPT: a nonlinear program in, a typed and checked `NlpResult` out.

Minimise f(x, p) subject to lower <= x <= upper and, for each named group, lower <= g(x, p) <= upper. Everything that
a user may pass on to IPOPT is a field of `IpoptOptions`; nothing else is. Source of the method: A. Waechter,
L.T. Biegler, "On the implementation of an interior-point filter line-search algorithm for large-scale nonlinear
programming", Math. Program. 106 (2006) 25-57.
"""

from __future__ import annotations

import math
import re
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from workbench.errors import InvalidValue
from workbench.model.checks import choice, number
from workbench.model.record import FloatArray
from workbench.model.results import NlpResult, SolveStatus

__all__ = ["Group", "IpoptOptions", "Nlp", "Solver", "Values", "held_interrupt", "versions"]

# Only these ship in CasADi's wheel; asking IPOPT for another can end the whole process.
LINEAR_SOLVERS = ("mumps", "spral")
# MUMPS's ICNTL(7): approximate minimum degree, and METIS.
ORDERINGS = {"minimum_degree": 0, "nested_dissection": 5}

_STATUS = {
    "Solve_Succeeded": SolveStatus.SOLVED,
    "Solved_To_Acceptable_Level": SolveStatus.ACCEPTABLE,
    "Feasible_Point_Found": SolveStatus.ACCEPTABLE,
    "Infeasible_Problem_Detected": SolveStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": SolveStatus.ITERATION_LIMIT,
    "Maximum_CpuTime_Exceeded": SolveStatus.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": SolveStatus.TIME_LIMIT,
    "Diverging_Iterates": SolveStatus.DIVERGED,
    "User_Requested_Stop": SolveStatus.INTERRUPTED,
    # What CasADi makes of Ctrl-C in the middle of a solve; its own functions throw nothing else into IPOPT.
    "NonIpopt_Exception_Thrown": SolveStatus.INTERRUPTED,
}


@dataclass(frozen=True, slots=True)
class IpoptOptions:
    """What may be passed on to IPOPT.

    tolerance: of the scaled optimality error, 1e-12..1e-2. max_iterations: 0..100,000. max_wall_time: s, > 0.
    linear_solver: "mumps" or "spral". barrier: the barrier parameter's start, > 0; small after a good start. push: how
    far the start is kept from its bounds, relative and absolute, > 0. scaling: "gradient-based" or "none". ordering: of
    the unknowns when MUMPS eliminates them, "minimum_degree" or "nested_dissection". Raises `InvalidValue`.
    """

    tolerance: float = 1e-8
    max_iterations: int = 200
    max_wall_time: float = 60.0
    linear_solver: str = "mumps"
    barrier: float = 0.1
    push: float = 0.01
    scaling: str = "gradient-based"
    ordering: str = "minimum_degree"

    def __post_init__(self) -> None:
        number(self.tolerance, "IpoptOptions.tolerance", least=1e-12, most=1e-2)
        number(self.max_iterations, "IpoptOptions.max_iterations", least=0, most=100_000)
        if not isinstance(self.max_iterations, int):
            raise InvalidValue("IpoptOptions.max_iterations", self.max_iterations, "must be a whole number")
        number(self.max_wall_time, "IpoptOptions.max_wall_time", above=0.0, unit="s")
        choice(self.linear_solver, "IpoptOptions.linear_solver", LINEAR_SOLVERS)
        number(self.barrier, "IpoptOptions.barrier", above=0.0)
        number(self.push, "IpoptOptions.push", above=0.0, most=1.0)
        choice(self.scaling, "IpoptOptions.scaling", ("gradient-based", "none"))
        choice(self.ordering, "IpoptOptions.ordering", tuple(ORDERINGS))

    def settings(self) -> dict[str, Any]:
        """Return the options in CasADi's words, silenced, with bounds that are not relaxed."""
        # An ordering by structure alone. MUMPS's own choice leans on the numbers of the first matrix; later ones then
        # now and then fill in, and one iteration takes many seconds.
        order = {"mumps_pivot_order": ORDERINGS[self.ordering], "mumps_permuting_scaling": 0}
        ordering = order if self.linear_solver == "mumps" else {}
        return {
            "print_time": False,
            "error_on_fail": False,
            # A trial point where a function overflows is IPOPT's to reject, and no news for the user.
            "show_eval_warnings": False,
            "ipopt": {
                **ordering,
                "print_level": 0,
                "sb": "yes",
                "bound_relax_factor": 0.0,
                "tol": self.tolerance,
                "max_iter": self.max_iterations,
                "max_wall_time": self.max_wall_time,
                "linear_solver": self.linear_solver,
                "mu_init": self.barrier,
                "bound_push": self.push,
                "bound_frac": min(self.push, 0.5),
                "slack_bound_push": self.push,
                "slack_bound_frac": min(self.push, 0.5),
                "nlp_scaling_method": self.scaling,
            },
        }


@dataclass(frozen=True, eq=False)
class Group:
    """A named group of constraints: a column expression in x and p, with its bounds (numbers or arrays)."""

    name: str
    expression: Any
    lower: float | FloatArray = 0.0
    upper: float | FloatArray = 0.0


@dataclass(frozen=True, eq=False)
class Nlp:
    """A nonlinear program: x and parameters as symbol columns (SX or MX), objective, groups, bounds and start of x."""

    x: Any
    objective: Any
    groups: tuple[Group, ...] = ()
    lower: float | FloatArray = -math.inf
    upper: float | FloatArray = math.inf
    start: float | FloatArray = 0.0
    parameters: Any = None


@dataclass(frozen=True, eq=False)
class Values:
    """Numbers for one solve, where they differ from those of the `Nlp`; `bounds` by group name."""

    start: FloatArray | None = None
    parameters: FloatArray | None = None
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    bounds: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=lambda: MappingProxyType({}))


def versions() -> Mapping[str, str]:
    """Return the versions of CasADi and of the IPOPT that it was built with."""
    return MappingProxyType({"casadi": str(ca.CasadiMeta.version()), "ipopt": _ipopt_version()})


def _ipopt_version() -> str:
    # IPOPT tells its version only on the screen; CasADi's build record names the one that it was built with.
    found = re.search(r"BUILD_IPOPT_VERSION=\D*([\d.]*\d)", str(ca.CasadiMeta.feature_list()))
    return found.group(1) if found else "unknown"


class HeldInterrupt:
    """A handler of SIGINT that only remembers that it was asked to stop."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, *_: object) -> None:
        self.asked = True


@contextmanager
def held_interrupt() -> Iterator[HeldInterrupt]:
    """Hold Ctrl-C back: within, it only sets `asked` of the value given, and the caller answers it afterwards.

    A KeyboardInterrupt in the middle of one of CasADi's conversions would come out as a `SystemError`, or as a line on
    stderr. Only Python's own handler in the main thread is replaced, and put back; elsewhere nothing changes. A hold
    inside another one is the same hold.
    """
    main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT) if main else None
    if isinstance(before, HeldInterrupt):
        yield before
        return
    held = HeldInterrupt()
    if before is not signal.default_int_handler:
        yield held
        return
    signal.signal(signal.SIGINT, held)
    try:
        yield held
    finally:
        signal.signal(signal.SIGINT, before)


class _Watch(ca.Callback):
    """What IPOPT asks after each iteration: whether to stop, as Ctrl-C has been held back meanwhile."""

    def __init__(self, x: int, g: int, p: int) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"x": x, "f": 1, "g": g, "lam_x": x, "lam_g": g, "lam_p": p}
        self.held: HeldInterrupt | None = None
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, index: int) -> Any:
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(index)], 1)

    def eval(self, _: object) -> list[float]:
        return [float(self.held is not None and self.held.asked)]


class Solver:
    """A program compiled once (derivatives included), to be solved for many starts, parameters and bounds.

    Not to be used from several threads: IPOPT is not safe there. Raises KeyboardInterrupt for Ctrl-C while compiling.
    """

    def __init__(self, nlp: Nlp, options: IpoptOptions | None = None) -> None:
        self._nlp = nlp
        self._sizes = [int(group.expression.numel()) for group in nlp.groups]
        names = [group.name for group in nlp.groups]
        if len(set(names)) != len(names):
            raise InvalidValue("Nlp.groups", names, "each group needs a name of its own")
        problem = {"x": nlp.x, "f": nlp.objective, "g": ca.vertcat(*[ca.vec(group.expression) for group in nlp.groups])}
        if nlp.parameters is not None:
            problem["p"] = nlp.parameters
        self._size = int(nlp.x.numel())
        chosen = options or IpoptOptions()
        with held_interrupt() as held:
            count = 0 if nlp.parameters is None else int(nlp.parameters.numel())
            self._watch = _Watch(self._size, sum(self._sizes), count)
            settings = {**chosen.settings(), "iteration_callback": self._watch}
            self._nlpsol = ca.nlpsol("nlp", "ipopt", problem, settings)
        if held.asked:
            raise KeyboardInterrupt

    def solve(self, values: Values | None = None) -> NlpResult:
        """Solve once. Never raises for a solve that fails: its status says so. Ctrl-C gives `INTERRUPTED`."""
        given = values or Values()
        nlp, n = self._nlp, self._size
        start = _full(nlp.start if given.start is None else given.start, n)
        lower = _full(nlp.lower if given.lower is None else given.lower, n)
        upper = _full(nlp.upper if given.upper is None else given.upper, n)
        low, high = self._group_bounds(given)
        arguments: dict[str, FloatArray] = {"x0": start, "lbx": lower, "ubx": upper, "lbg": low, "ubg": high}
        if nlp.parameters is not None:
            arguments["p"] = _full(0.0 if given.parameters is None else given.parameters, int(nlp.parameters.numel()))
        began = time.perf_counter()
        with held_interrupt() as held:
            self._watch.held = held
            try:
                found = self._nlpsol(**arguments)
                stats = self._nlpsol.stats()
                x, g, lam_x, lam_g = (
                    np.asarray(found[name], dtype=np.float64).ravel() for name in ("x", "g", "lam_x", "lam_g")
                )
                f = float(found["f"])
            except (KeyboardInterrupt, RuntimeError, SystemError) as error:
                # Where Ctrl-C could not be held back, CasADi passes it on in one of its own errors.
                stopped = held.asked or isinstance(error, KeyboardInterrupt) or _has_interrupt(error)
                status = SolveStatus.INTERRUPTED if stopped else SolveStatus.FAILED
                said = "interrupted" if stopped else str(error).split("\n", 1)[0]
                return self._without_result(start, status, said, began)
            finally:
                self._watch.held = None
        if held.asked:
            return self._without_result(start, SolveStatus.INTERRUPTED, "interrupted", began)
        said = str(stats["return_status"])
        status = _STATUS.get(said, SolveStatus.FAILED)
        if status.success and not (math.isfinite(f) and bool(np.isfinite(x).all())):
            status = SolveStatus.FAILED
        slack = np.concatenate([_slack(x, lower, upper, lam_x), _slack(g, low, high, lam_g)])
        return NlpResult(
            x=x,
            objective=f,
            status=status,
            message=said,
            iterations=int(stats["iter_count"]),
            residuals=MappingProxyType(self._residuals(x, g, lower, upper, low, high)),
            complementarity=float(slack.max(initial=0.0)),
            wall_time=time.perf_counter() - began,
            versions=versions(),
        )

    def _group_bounds(self, given: Values) -> tuple[FloatArray, FloatArray]:
        unknown = set(given.bounds) - {group.name for group in self._nlp.groups}
        if unknown:
            raise InvalidValue("Values.bounds", sorted(unknown), "names no group of this program")
        low, high = [np.zeros(0)], [np.zeros(0)]
        for group, size in zip(self._nlp.groups, self._sizes, strict=True):
            pair = given.bounds.get(group.name, (group.lower, group.upper))
            low.append(_full(pair[0], size))
            high.append(_full(pair[1], size))
        return np.concatenate(low), np.concatenate(high)

    def _residuals(
        self, x: FloatArray, g: FloatArray, lower: FloatArray, upper: FloatArray, low: FloatArray, high: FloatArray
    ) -> dict[str, float]:
        """Worst violation of the bounds and of each group, recomputed from the point and not taken from the solver."""
        worst = {"bounds": _violation(x, lower, upper)}
        at = 0
        for group, size in zip(self._nlp.groups, self._sizes, strict=True):
            part = slice(at, at + size)
            worst[group.name] = _violation(g[part], low[part], high[part])
            at += size
        return worst

    def _without_result(self, x: FloatArray, status: SolveStatus, message: str, began: float) -> NlpResult:
        return NlpResult(
            x=x,
            objective=math.nan,
            status=status,
            message=message,
            iterations=0,
            residuals=MappingProxyType({}),
            complementarity=math.nan,
            wall_time=time.perf_counter() - began,
            versions=versions(),
        )


def _has_interrupt(error: BaseException | None) -> bool:
    """Whether a KeyboardInterrupt is among what led to an error."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _full(value: float | FloatArray, size: int) -> FloatArray:
    array = np.asarray(value, dtype=np.float64).ravel()
    if array.size not in (1, size):
        raise InvalidValue("Nlp", f"{array.size} values", f"must be one number or {size}")
    return np.array(np.broadcast_to(array, (size,)))


def _violation(values: FloatArray, low: FloatArray, high: FloatArray) -> float:
    worst = np.maximum(np.maximum(low - values, values - high), 0.0).max(initial=0.0)
    return float(worst)


def _slack(values: FloatArray, low: FloatArray, high: FloatArray, lam: FloatArray) -> FloatArray:
    """Return |multiplier x distance to the bound that it presses on|; 0 for equalities, which have no slack."""
    with np.errstate(invalid="ignore"):
        gap = np.where(lam > 0.0, high - values, values - low)
        product: FloatArray = np.where((low == high) | ~np.isfinite(gap), 0.0, np.abs(lam * gap))
    return product
