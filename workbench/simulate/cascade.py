"""Cascades simulated exactly: both loops on the secondary's samples, both plants' answer to the held valve exact."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from workbench.kpi.kpis import cascade_event, measure
from workbench.model.cascade import Cascade, CascadeExperiment, CascadeRun
from workbench.model.checks import instance
from workbench.model.experiment import Experiment
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import FloatArray
from workbench.model.results import Run
from workbench.simulate import cascade_kernel as kernel
from workbench.simulate.coefficients import coefficients, discretise, rest
from workbench.simulate.filter import first_order
from workbench.simulate.signals import noise_signal, profile_signal, signals

__all__ = ["CascadeSignals", "CascadeState", "cascade_signals", "chain", "simulate_cascade"]


SIGNALS = ("y1", "u1", "r2", "y2", "u2", "x", "v")


@dataclass(frozen=True, eq=False)
class CascadeSignals:
    """An experiment as the kernel takes it, each of shape (N + 1,): r (EU of the primary), added, load, noises.

    added: what the primary's load makes of its PV (EU); disturbance: that load (EU of the secondary).
    """

    r: FloatArray
    added: FloatArray
    load: FloatArray
    noise1: FloatArray
    noise2: FloatArray
    disturbance: FloatArray

    @property
    def samples(self) -> int:
        """N."""
        return int(self.r.size) - 1


class CascadeState:
    """A cascade at rest, ready to be run on in pieces of whole scans of the primary."""

    def __init__(self, cascade: Cascade, stem_offset: float = 0.0) -> None:
        self.every = cascade.every
        self.primary = coefficients(cascade.primary)[0]
        self.secondary = coefficients(cascade.secondary, stem_offset)[0]
        self.chain = chain(cascade)
        self.state1, _ = rest(self.primary)
        self.state2, self.past2 = rest(self.secondary)
        self.link = np.zeros(3)
        self.tail = np.zeros(int(self.chain[kernel.CHAIN_DELAY]) + 1)

    def run(self, given: CascadeSignals) -> tuple[dict[str, FloatArray], NDArray[np.int8]]:
        """Run on; return y1, y2 (N + 1, without noise), u1, r2, u2, x, v (N each), and the branch codes."""
        n = given.samples
        out = {name: np.empty(n + (name in ("y1", "y2"))) for name in SIGNALS}
        branch = np.empty(n, np.int8)
        fixed = (self.primary, self.secondary, self.chain, self.every)
        inputs = (given.r, given.added, given.load, given.noise1, given.noise2)
        states = (self.state1, self.state2, self.past2, self.link, self.tail)
        y1, u1, r2, y2, u2, x, v = out.values()
        kernel.run_cascade(*fixed, *inputs, *states, y1, u1, r2, y2, u2, x, v, branch)
        return out, branch


def chain(cascade: Cascade) -> FloatArray:
    """Return the exact step of (w, y1) under a held valve, `kernel.CHAIN` numbers (see `_step`)."""
    primary, secondary, Ts = cascade.primary.plant, cascade.secondary.plant, cascade.secondary.sample_time
    numbers = np.array(_step(primary, secondary, Ts))
    numbers[kernel.SCALE], numbers[kernel.HELD_BACK] = cascade.scale, float(cascade.anti_windup == "clamp")
    return numbers


@lru_cache(64)
def _step(primary: Plant, secondary: Plant, Ts: float) -> tuple[float, ...]:
    """A chain's numbers that are the plants'; kept, as a matrix exponential takes longer than a cascade's run.

    w is the secondary's PV delayed by the primary's dead time, so that y1 follows w without delay and both follow v
    after theta1 + theta2 = (m + f) Ts: `z' = F z + g v`, `z_{k+1} = e^(F Ts) z_k + G((1-f) Ts) v_{k-m} + e^(F (1-f) Ts)
    G(f Ts) v_{k-m-1}`, `G(h) = integral over 0..h of e^(F s) g`. One matrix exponential holds both, equal and
    integrating poles included.
    """
    from scipy.linalg import expm

    ratio = (primary.dead_time + secondary.dead_time) / Ts
    m = int(np.floor(ratio + 1e-9))
    f = ratio - m
    f = 0.0 if f < 1e-9 else f
    F = np.zeros((3, 3))
    for i, plant in ((0, secondary), (1, primary)):
        lag = plant.time_constant if isinstance(plant, FOPDT) else 1.0
        F[i, i] = -1.0 / lag if isinstance(plant, FOPDT) else 0.0
        F[i, 2 if i == 0 else 0] = plant.gain / lag
    whole, late, early = (expm(F * h) for h in (Ts, (1.0 - f) * Ts, f * Ts))
    far = late[:2, :2] @ early[:2, 2]
    numbers = np.zeros(kernel.CHAIN)
    numbers[[kernel.A00, kernel.A10, kernel.A11]] = whole[0, 0], whole[1, 0], whole[1, 1]
    numbers[[kernel.NEAR_W, kernel.NEAR_Y]] = late[:2, 2]
    numbers[[kernel.FAR_W, kernel.FAR_Y]] = far
    numbers[kernel.CHAIN_DELAY] = m
    return tuple(numbers.tolist())


def cascade_signals(cascade: Cascade, experiment: Experiment) -> CascadeSignals:
    """Return an experiment's signals on the secondary's samples.

    Raises `InvalidValue` where these are no cascade and experiment, the duration is no whole number of the primary's
    scans, or the stem offset is no resting state of the secondary.
    """
    instance(cascade, Cascade, "cascade", "a Cascade")
    instance(experiment, Experiment, "experiment", "an Experiment")
    signals(cascade.primary, _plain(experiment, stem_offset=0.0))
    plain = signals(cascade.secondary, _plain(experiment, stem_offset=experiment.stem_offset))
    n, Ts = plain.samples, cascade.secondary.sample_time
    disturbance, noise2 = np.zeros(n + 1), np.zeros(n + 1)
    if isinstance(experiment, CascadeExperiment):
        disturbance = profile_signal(experiment.primary_load_parts, n, Ts)
        noise2 = noise_signal(experiment.secondary_noise, n)
    return CascadeSignals(plain.r, _answer(cascade, disturbance), plain.load, plain.noise, noise2, disturbance)


def _plain(experiment: Experiment, stem_offset: float) -> Experiment:
    """Return the plain experiment in a cascade's one."""
    given = experiment.duration, experiment.setpoint, experiment.load, experiment.noise
    return Experiment(*given, stem_offset=stem_offset)


def _answer(cascade: Cascade, disturbance: FloatArray) -> FloatArray:
    """PV of the primary's plant under its load alone: the same law as `run_loop`'s plant."""
    step = discretise(cascade.primary.plant, cascade.secondary.sample_time)
    n, m = disturbance.size - 1, step.delay
    held = np.concatenate([np.zeros(m + 1), disturbance])
    pushed = step.gain * (step.c0 * held[1 : n + 1] + step.c1 * held[:n])
    if not pushed.any():
        return np.zeros(n + 1)
    return first_order(np.append(0.0, pushed), 1.0, 0.0, step.pole)


def simulate_cascade(cascade: Cascade, experiment: Experiment) -> CascadeRun:
    """Simulate a cascade exactly, from rest; see `wb.simulate`, which does it for a Cascade.

    Raises `InvalidValue` for an experiment that does not fit the cascade.
    """
    given = cascade_signals(cascade, experiment)
    out, branch = CascadeState(cascade, experiment.stem_offset).run(given)
    return cascade_run(cascade, experiment, given, out, branch)


def cascade_run(
    cascade: Cascade,
    experiment: Experiment,
    given: CascadeSignals,
    out: dict[str, FloatArray],
    branch: NDArray[np.int8],
    *,
    rested: bool = True,
) -> CascadeRun:
    """Return a run from the kernel's signals. rested: whether it began at rest, so that its first moves count."""
    n, Ts = given.samples, cascade.secondary.sample_time
    pv1, pv2 = out["y1"] + given.noise1, out["y2"] + given.noise2
    moved = out["y2"][:n] / cascade.scale
    before = 0.0 if rested else float("nan")
    time = np.arange(n, dtype=np.float64) * Ts
    primary = Run(
        loop=cascade.primary,
        experiment=experiment,
        time=time,
        sp=given.r[:n],
        pv=pv1[:n],
        op=out["u1"],
        valve=moved,
        load=given.disturbance[:n],
        branch=np.ones(n, np.int8),
        final_sp=float(given.r[n]),
        final_pv=float(pv1[n]),
        kpis=measure(
            pv1[:n],
            Ts,
            sp=given.r[:n],
            op=out["u1"],
            valve=moved,
            op_before=before,
            valve_before=before,
            event=cascade_event(cascade, experiment) if rested else None,
        ),
    )
    secondary = Run(
        loop=cascade.secondary,
        experiment=experiment,
        time=time,
        sp=out["r2"],
        pv=pv2[:n],
        op=out["u2"],
        valve=out["x"],
        load=given.load[:n],
        branch=branch,
        final_sp=float(out["r2"][-1]),
        final_pv=float(pv2[n]),
        kpis=measure(
            pv2[:n],
            Ts,
            sp=out["r2"],
            op=out["u2"],
            valve=out["x"],
            op_before=experiment.stem_offset if rested else before,
            valve_before=before,
        ),
    )
    return CascadeRun(cascade, experiment, primary, secondary)
