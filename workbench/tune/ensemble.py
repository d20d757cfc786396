"""An ensemble's draws as exact runs: many tunings in the same random circumstances, and how a loop fares in them."""

from __future__ import annotations

import itertools
import math
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from workbench.analyze.frequency import linear_stable
from workbench.analyze.margins import loop_margins
from workbench.errors import InvalidValue
from workbench.model.checks import instance
from workbench.model.controller import PID
from workbench.model.ensemble import UNCERTAIN, Ensemble
from workbench.model.experiment import Experiment, Noise, Step
from workbench.model.karnopp import Karnopp
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import FloatArray
from workbench.model.results import Robustness
from workbench.model.tuning import Objective
from workbench.model.valve import Choudhury, Deadband, Directional, He, Ideal, Kano, Positional, Stenman, Valve
from workbench.simulate import kernel
from workbench.simulate.batch import kernel_weights, sums, weigh
from workbench.simulate.coefficients import coefficients
from workbench.simulate.signals import Signals, sample_count, signals
from workbench.simulate.sums import FEW_SUMS, SUMS

__all__ = ["Circumstances", "Draw", "assess", "corner_loops", "draws", "measured", "statistic"]

# What a tuning changes in a coefficient row; the rest belongs to the draw.
CONTROLLER = [c for c in range(kernel.VALVE) if c != kernel.BIAS]
CONTROLLER += [*range(kernel.COMPENSATOR, kernel.EXTRA + 1), kernel.RESOLUTION]
# Rows of one call of the kernel: what fits well into memory.
ROWS = 50_000
# The signals of this many samples, some 50 MB, are kept for the next who asks for the same draws.
KEPT_SAMPLES = 2_000_000
# Up to this Ms a response read off its grid is certain to tell a stable loop from an unstable one.
SURE = 8.0


@dataclass(frozen=True, slots=True)
class Draw:
    """One member of an ensemble: the loop with its drawn plant and valve, and the experiment that it goes through."""

    loop: Loop
    experiment: Experiment


def draws(loop: Loop, ensemble: Ensemble) -> tuple[Draw, ...]:
    """Return the ensemble's draws for a loop, each an ordinary loop and experiment for `wb.simulate`.

    Draw i takes from `default_rng([seed, i])`, in this order: signs and sizes of setpoint and load step, the load's
    sample, the stem offset's share, the noise's standard deviation and seed, and the factors on gain, time constant,
    dead time and stiction. Raises `InvalidValue` where the duration is no whole number of samples.
    """
    n = sample_count(ensemble.duration, loop.sample_time)
    return tuple(_draw(loop, ensemble, n, np.random.default_rng([ensemble.seed, i])) for i in range(ensemble.draws))


def _draw(loop: Loop, ensemble: Ensemble, n: int, rng: np.random.Generator) -> Draw:
    Ts = loop.sample_time
    setpoint = float(rng.choice([-1.0, 1.0]) * rng.uniform(*ensemble.setpoint))
    load = float(rng.choice([-1.0, 1.0]) * rng.uniform(*ensemble.load))
    first, last = (round(t / Ts) for t in ensemble.load_time)
    at = min(int(rng.integers(first, last + 1)), n) * Ts
    offset = float(rng.uniform(-1.0, 1.0)) * ensemble.stem_offset
    noise = Noise(float(rng.uniform(*ensemble.noise)), int(rng.integers(2**31)))
    factors = {name: 1.0 + getattr(ensemble, name) * float(rng.uniform(-1.0, 1.0)) for name in UNCERTAIN}
    plant = _plant(loop.plant, factors["gain"], factors["time_constant"], factors["dead_time"])
    try:
        valve = _valve(loop.valve, factors["stiction"])
        drawn = replace(loop, plant=plant, valve=valve)
    except InvalidValue as error:
        # Nobody gave that valve: what was given is how far its stiction may be another.
        allowed = f"must leave each draw a valve that may be; of {factors['stiction']:.2f} times the loop's it is not: "
        raise InvalidValue("Ensemble.stiction", ensemble.stiction, f"{allowed}{error}") from None
    lowest, highest = loop.controller.output_limits or (-math.inf, math.inf)
    return Draw(
        drawn,
        Experiment(
            ensemble.duration,
            Step(setpoint),
            Step(load, min(at, ensemble.duration)),
            noise,
            # OP has stood there, within its limits.
            stem_offset=min(max(offset * valve.hold, lowest), highest),
        ),
    )


def _plant(plant: Plant, gain: float, time_constant: float, dead_time: float) -> Plant:
    if isinstance(plant, FOPDT):
        return FOPDT(plant.gain * gain, plant.time_constant * time_constant, plant.dead_time * dead_time)
    return replace(plant, gain=plant.gain * gain, dead_time=plant.dead_time * dead_time)


def _valve(valve: Valve, stiction: float) -> Valve:
    match valve:
        case Stenman() | He() | Choudhury() | Deadband():
            return _one_place(valve, stiction)
        case Kano():
            return Kano(valve.S * stiction, valve.J * stiction)
        case Directional():
            return Directional(_two_parameter(valve.up, stiction), _two_parameter(valve.down, stiction))
        case Positional():
            return Positional(valve.positions, tuple(_one_place(one, stiction) for one in valve.valves))
        case Karnopp():
            return replace(valve, coulomb=valve.coulomb * stiction, static=valve.static * stiction)
        case Ideal():
            return valve


def _one_place(valve: Stenman | He | Choudhury | Deadband, stiction: float) -> Stenman | He | Choudhury | Deadband:
    match valve:
        case Stenman():
            return Stenman(valve.d * stiction)
        case He():
            return He(valve.fs * stiction, valve.fd * stiction)
        case _:
            return _two_parameter(valve, stiction)


def _two_parameter(valve: Choudhury | Deadband, stiction: float) -> Choudhury | Deadband:
    if isinstance(valve, Deadband):
        return Deadband(valve.b * stiction)
    return Choudhury(valve.S * stiction, valve.J * stiction)


def corner_loops(loop: Loop, ensemble: Ensemble) -> tuple[Loop, ...]:
    """Return the loop with its nominal plant and with each corner of its plant's uncertainty, all with ideal valves.

    Gain and time constant at their ends; dead time at its ends, its nominal value and the first and last whole number
    of samples between: a sampled loop is worst where the hold delays a whole sample more, not at the longest dead time.
    """
    plant, Ts = loop.plant, loop.sample_time
    share = ensemble.dead_time
    low, high = plant.dead_time * (1.0 - share), plant.dead_time * (1.0 + share)
    whole = (math.ceil(low / Ts) * Ts, math.floor(high / Ts) * Ts)
    delays = sorted({low, plant.dead_time, high, *(t for t in whole if low < t < high)})
    lags = ensemble.time_constant if isinstance(plant, FOPDT) else 0.0
    plants: list[Plant] = [plant]
    for gain, lag, delay in itertools.product(
        sorted({1.0 - ensemble.gain, 1.0 + ensemble.gain}), sorted({1.0 - lags, 1.0 + lags}), delays
    ):
        corner = replace(_plant(plant, gain, lag, 1.0), dead_time=delay)
        if corner not in plants:
            plants.append(corner)
    return tuple(replace(loop, plant=corner, valve=Ideal()) for corner in plants)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """An ensemble of a loop, whatever its controller: signals and coefficient rows of the draws and corner plants."""

    members: tuple[Draw, ...]
    signals: Signals
    rows: FloatArray
    corner_rows: FloatArray


def _drawn(loop: Loop, ensemble: Ensemble) -> _Drawn:
    members = draws(loop, ensemble)
    given = [signals(draw.loop, draw.experiment) for draw in members]
    stacked = Signals(*(np.array([getattr(s, name) for s in given]) for name in ("r", "load", "noise")))
    rows = np.concatenate([coefficients(d.loop, d.experiment.stem_offset) for d in members])
    corners = np.concatenate([coefficients(corner.executed) for corner in corner_loops(loop, ensemble)])
    return _Drawn(members, stacked, rows, corners)


# A tuning, its proof and its report ask for the same draws a dozen times, and drawing takes longer than simulating.
_kept = lru_cache(maxsize=4)(_drawn)


class Circumstances:
    """An ensemble of one loop, drawn once: every tuning meets the same draws (common random numbers)."""

    def __init__(self, loop: Loop, ensemble: Ensemble) -> None:
        self.loop, self.ensemble = loop, ensemble
        self.samples = sample_count(ensemble.duration, loop.sample_time)
        # Of the controller only its limits matter to a draw: an OP must be able to stand where the stem rests.
        idle = loop.with_controller(PID(0.0, math.inf, output_limits=loop.controller.output_limits))
        drawn = (_kept if ensemble.draws * self.samples <= KEPT_SAMPLES else _drawn)(idle, ensemble)
        self.members, self._stacked = drawn.members, drawn.signals
        self._rows, self._corner_rows = drawn.rows, drawn.corner_rows
        self.corners = corner_loops(loop, ensemble)

    def under(self, controller: PID) -> Circumstances:
        """Return the same draws under another controller."""
        other = copy(self)
        other.loop = self.loop.with_controller(controller)
        return other

    def terms(self, tunings: FloatArray, *, every: bool = False) -> FloatArray:
        """Return the kernel's sums of tunings, shape (M, 3), in every draw, shape (M, draws, FEW_SUMS, or SUMS)."""
        own = coefficients(self.loop, 0.0, tunings)[:, CONTROLLER]
        count = self._rows.shape[0]
        result = np.empty((own.shape[0], count, SUMS if every else FEW_SUMS))
        size = max(1, ROWS // count)
        for begin in range(0, own.shape[0], size):
            part = own[begin : begin + size]
            # Tunings in the same draw stand together, as the kernel runs them side by side.
            rows = np.repeat(self._rows, part.shape[0], axis=0)
            rows[:, CONTROLLER] = np.tile(part, (count, 1))
            which = np.repeat(np.arange(count), part.shape[0])
            out = sums(rows, self._stacked, which, every=every)
            result[begin : begin + size] = out.reshape(count, -1, out.shape[1]).swapaxes(0, 1)
        return result

    def costs(self, terms: FloatArray, objective: Objective) -> FloatArray:
        """Return J of an objective for such sums, shape (M, draws); inf where a run overflowed."""
        weights = kernel_weights(objective, self.samples, self.loop.sample_time)
        return weigh(terms.reshape(-1, terms.shape[2]), weights, self.samples).reshape(terms.shape[:2])

    def margins(self, tunings: FloatArray, *, all_three: bool = True) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the worst (Ms, gain margin, phase margin in degrees) of tunings over nominal and corner plants.

        Shape (M, 3) -> (M, 3); and how many of the plants are not held, shape (M,), read off the frequency response
        (see `loop_margins`: `unstable` decides exactly, and what `all_three` leaves out).
        """
        own = coefficients(self.loop, 0.0, tunings)[:, CONTROLLER]
        count = self._corner_rows.shape[0]
        rows = np.tile(self._corner_rows, (own.shape[0], 1))
        rows[:, CONTROLLER] = np.repeat(own, count, axis=0)
        all_values, _, stable = loop_margins(rows, self.loop.executed.sample_time, all_three=all_three)
        values = all_values.reshape(-1, count, 3)
        worst = np.column_stack([values[:, :, 0].max(1), values[:, :, 1].min(1), values[:, :, 2].min(1)])
        return worst, np.count_nonzero(~stable.reshape(-1, count), axis=1)

    def unstable_draws(self) -> NDArray[np.bool_]:
        """Return which draws the circumstances' own controller does not hold, exactly, with ideal valves, (draws,)."""
        rows = self._rows.copy()
        if self.loop.scan > 1:
            rows = np.concatenate([coefficients(d.loop.executed, d.experiment.stem_offset) for d in self.members])
        rows[:, CONTROLLER] = coefficients(self.loop)[:, CONTROLLER]
        values, _, stable = loop_margins(rows, self.loop.executed.sample_time, all_three=False)
        lost: NDArray[np.bool_] = ~(stable & (values[:, 0] <= SURE))
        for i in np.flatnonzero(lost):
            lost[i] = not linear_stable(self.members[i].loop.with_controller(self.loop.controller))
        return lost

    def unstable(self, tuning: FloatArray) -> int:
        """Return how many of the nominal and corner plants a tuning (Kc, Ti, Td) does not hold, exactly.

        With ideal valves: stiction only holds small signals back, and an unstable loop grows or cycles in its limits.
        """
        Kc, Ti, Td = (float(v) for v in tuning)
        pid = replace(self.loop.controller, Kc=Kc, Ti=Ti, Td=Td)
        return sum(not linear_stable(corner.with_controller(pid)) for corner in self.corners)


def statistic(costs: FloatArray, ensemble: Ensemble) -> FloatArray:
    """Return the ensemble's statistic of J, shape (M, draws) -> (M,); inf where any draw's J is."""
    finite = np.isfinite(costs).all(axis=1)
    result = np.full(costs.shape[0], np.inf)
    kept = costs[finite]
    if ensemble.statistic == "mean":
        result[finite] = kept.mean(axis=1)
    elif ensemble.statistic == "percentile":
        result[finite] = np.quantile(kept, ensemble.level, axis=1)
    else:
        count = max(1, math.ceil((1.0 - ensemble.level) * costs.shape[1] - 1e-9))
        result[finite] = np.sort(kept, axis=1)[:, -count:].mean(axis=1)
    return result


def assess(loop: Loop, ensemble: Ensemble | None = None, objective: Objective | None = None) -> Robustness:
    """Return how a loop with its own controller fares in an ensemble ("plant-ready" by default).

    objective: what `Robustness.objective` is the ensemble's statistic of. Every draw is simulated exactly; each can be
    had again by `wb.simulate` of a member of `tune.ensemble.draws`. Raises `InvalidValue`.
    """
    instance(loop, Loop, "loop", "a Loop")
    ensemble = Ensemble.plant_ready(loop) if ensemble is None else ensemble
    objective = Objective() if objective is None else objective
    instance(ensemble, Ensemble, "ensemble", "an Ensemble or None")
    instance(objective, Objective, "objective", "an Objective or None")
    return measured(Circumstances(loop, ensemble), objective)


def measured(given: Circumstances, objective: Objective) -> Robustness:
    """Return the figures of the circumstances' own loop and controller."""
    pid = given.loop.controller
    tuning = np.array([[pid.Kc, pid.Ti, pid.Td]])
    with np.errstate(over="ignore", invalid="ignore"):
        terms = given.terms(tuning, every=bool(objective.kpis))
        costs = given.costs(terms, objective)[0]
        mse, travel = terms[0, :, 4] / given.samples, terms[0, :, 5]
    mse[~np.isfinite(mse)] = np.inf
    travel[~np.isfinite(travel)] = np.inf
    held = given.unstable(tuning[0]) == 0
    Ms, gain, phase = (float(v) for v in given.margins(tuning)[0][0]) if held else (math.inf, 0.0, 0.0)
    lost = int(np.count_nonzero(~np.isfinite(costs) | given.unstable_draws()))
    return Robustness(
        loop=given.loop,
        ensemble=given.ensemble,
        objective=float(statistic(costs[None, :], given.ensemble)[0]),
        mean_square_error=mse,
        valve_travel=travel,
        diverged=lost,
        stable=held,
        max_sensitivity=Ms,
        gain_margin=gain,
        phase_margin=phase,
    )
