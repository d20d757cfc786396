"""`wb.simulate` and its batch forms: experiments in, exact trajectories, figures and objectives out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np

from workbench.errors import InvalidValue
from workbench.kpi.kpis import last_event, measure
from workbench.model.cascade import Cascade, CascadeRun
from workbench.model.checks import instance, sequence, whole
from workbench.model.experiment import Experiment, Noise
from workbench.model.loop import Loop
from workbench.model.record import FloatArray
from workbench.model.results import Kpis, Run
from workbench.model.tuning import Objective
from workbench.model.valve import Valve
from workbench.simulate import kernel
from workbench.simulate.batch import kernel_weights, sums, weigh
from workbench.simulate.cascade import simulate_cascade
from workbench.simulate.coefficients import coefficients, rest, valve_row
from workbench.simulate.signals import signals

__all__ = ["Batch", "evaluate", "simulate", "simulate_batch", "valve_response"]


@dataclass(frozen=True, eq=False)
class Batch:
    """Many runs of one experiment: sp (N,), pv, op, valve (M, N), and each run's figures."""

    time: FloatArray
    sp: FloatArray
    pv: FloatArray
    op: FloatArray
    valve: FloatArray
    kpis: tuple[Kpis, ...]


@overload
def simulate(loop: Loop, experiment: Experiment) -> Run: ...
@overload
def simulate(loop: Cascade, experiment: Experiment) -> CascadeRun: ...
def simulate(loop: Loop | Cascade, experiment: Experiment) -> Run | CascadeRun:
    """Simulate a loop, or a cascade of two, exactly, from rest.

    The law is that of `simulate.kernel`; at the start `u_{-1} = stem_offset`, and all else is 0. Returns a `Run` of N =
    duration/sample_time samples; of a `Cascade` (see there) a `CascadeRun`, on the secondary's samples. Raises
    `InvalidValue` for an experiment that does not fit the loop.
    """
    if isinstance(loop, Cascade):
        return simulate_cascade(loop, experiment)
    given = signals(loop, experiment)
    row = coefficients(loop, experiment.stem_offset)[0]
    n = given.samples
    y = np.empty(n + 1)
    u, x, v = np.empty(n), np.empty(n), np.empty(n)
    branch = np.empty(n, np.int8)
    state, past = rest(row)
    kernel.run_loop(row, given.r, given.load, given.noise, state, past, y, u, x, v, branch)
    measured = y + given.noise
    figures = measure(
        measured[:n],
        loop.sample_time,
        sp=given.r[:n],
        op=u,
        valve=x,
        op_before=experiment.stem_offset,
        valve_before=0.0,
        event=last_event(loop, experiment),
    )
    return Run(
        loop=loop,
        experiment=experiment,
        time=np.arange(n, dtype=np.float64) * loop.sample_time,
        sp=given.r[:n],
        pv=measured[:n],
        op=u,
        valve=x,
        load=loop.direction * given.load[:n],
        branch=branch,
        final_sp=float(given.r[n]),
        final_pv=float(measured[n]),
        kpis=figures,
    )


def simulate_batch(
    loop: Loop, experiment: Experiment, *, tunings: object = None, seeds: Sequence[int] | None = None
) -> Batch:
    """Simulate many tunings, or many noise seeds, of one loop and experiment.

    Exactly one of tunings, shape (M, 3) of (Kc, Ti, Td) in the controller's own form, and seeds (of the experiment's
    noise) must be given. Each run equals `simulate` of that tuning or seed. Raises `InvalidValue`.
    """
    instance(loop, Loop, "loop", "a Loop")
    instance(experiment, Experiment, "experiment", "an Experiment")
    if (tunings is None) == (seeds is None):
        raise InvalidValue("simulate_batch", "both or neither", "give either tunings or seeds")
    if tunings is not None:
        loops = [
            loop.with_controller(replace(loop.controller, Kc=row[0], Ti=row[1], Td=row[2]))
            for row in _tunings(tunings).tolist()
        ]
        experiments = [experiment] * len(loops)
    else:
        if experiment.noise is None:
            raise InvalidValue("Experiment.noise", "none", "seeds need an experiment with noise")
        sd = experiment.noise.sd
        wanted = sequence(seeds, "seeds", "a sequence of whole numbers")
        experiments = [replace(experiment, noise=Noise(sd, whole(seed, "seeds"))) for seed in wanted]
        loops = [loop] * len(experiments)
    runs = [simulate(one, what) for one, what in zip(loops, experiments, strict=True)]
    if not runs:
        raise InvalidValue("simulate_batch", "nothing", "must hold at least one tuning or seed")
    return Batch(
        time=runs[0].time,
        sp=runs[0].sp,
        pv=np.array([run.pv for run in runs]),
        op=np.array([run.op for run in runs]),
        valve=np.array([run.valve for run in runs]),
        kpis=tuple(run.kpis for run in runs),
    )


def evaluate(loop: Loop, experiment: Experiment, objective: Objective, tunings: object = None) -> FloatArray:
    """Return J by exact simulation, shape (M,), for tunings of shape (M, 3) (Kc, Ti, Td in own form).

    Without tunings: of the loop's own controller, shape (1,). An unstable run may give inf. Raises `InvalidValue`.
    """
    given = signals(loop, experiment)
    instance(objective, Objective, "objective", "an Objective")
    wanted = None if tunings is None else _tunings(tunings)
    rows = coefficients(loop, experiment.stem_offset, wanted)
    # Overflow in an unstable loop is a result, not an accident: J is then inf (or nan, which is as bad).
    with np.errstate(over="ignore", invalid="ignore"):
        weights = kernel_weights(objective, given.samples, loop.sample_time)
        return weigh(sums(rows, given, every=bool(objective.kpis)), weights, given.samples)


def valve_response(
    valve: Valve, op: FloatArray, start: float = 0.0, rest_at: float | None = None, sample_time: float = 1.0
) -> FloatArray:
    """Return the stem (%) under a given output, shape (N,), at rest at `rest_at` (default: at `start`) before it.

    `start` is the output before the first sample, %; sample_time: s, of concern to a valve with mass alone.
    """
    x, state = np.empty(op.size), np.zeros(kernel.STATES)
    state[kernel.U_LAST], state[kernel.X_LAST] = start, start if rest_at is None else rest_at
    # A copy, as the kernel would be compiled once more for what may only be read.
    kernel.valve_path(valve_row(valve, sample_time), np.array(op, dtype=np.float64), state, x)
    return x


def _tunings(given: object) -> FloatArray:
    try:
        array = np.asarray(given)
    except (TypeError, ValueError):
        array = np.array(None)
    if array.dtype.kind not in "iuf":
        raise InvalidValue("tunings", type(given).__name__, "must be numbers of shape (M, 3): Kc, Ti, Td")
    array = array.astype(np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidValue("tunings", f"shape {array.shape}", "must have shape (M, 3): Kc, Ti, Td")
    ok = (
        np.isfinite(array[:, 0])
        & (array[:, 0] >= 0)
        & (array[:, 1] > 0)
        & np.isfinite(array[:, 2])
        & (array[:, 2] >= 0)
    )
    if not ok.all():
        first = int(np.argmin(ok))
        raise InvalidValue(f"tunings[{first}]", array[first].tolist(), "needs Kc >= 0, Ti > 0, Td >= 0")
    return array
