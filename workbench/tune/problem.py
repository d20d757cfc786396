"""One tuning problem as the searches see it: exact costs of tunings, their neighbourhood, digits and coordinates.

A tuning is a row (Kc, Ti, Td) in the controller's own form. Searches move in a unit cube of the free parameters, with
Kc and Td in square-root and Ti in logarithmic coordinates, which spreads good tunings evenly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.analyze.margins import loop_margins
from workbench.model.controller import PID
from workbench.model.ensemble import Constraints
from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.record import FloatArray
from workbench.model.tuning import Bounds, Objective
from workbench.simulate.batch import kernel_weights, price, sums, weigh, worst
from workbench.simulate.coefficients import coefficients
from workbench.simulate.signals import signals
from workbench.simulate.sums import TRAVEL
from workbench.tune.limits import NARROW, UNSTABLE, WORN, more_than_sensitivity, narrowness, worn

__all__ = ["Problem", "last_offsets", "proof_offsets", "round_to", "unit_of"]

# Random inner points of a neighbourhood: when searching, when it is looked at closely, for the last word, and for the
# proof of the few that it leaves; the latter two are fewer for longer runs.
SPARSE, DENSE, LAST, LAST_SAMPLES, PROOF, PROOF_SAMPLES = 6, 100, 2000, 2_000_000, 20_000, 20_000_000
# Of the points by which a limit on travel is judged, the parts in which they are run: most that break it do so early.
PARTS = (150, 500)
NAMES = ("Kc", "Ti", "Td")
# Powers of ten up to this one are floats without rounding.
EXACT_POWER = 22
Mapping = Callable[[FloatArray], FloatArray]


@dataclass(slots=True)
class Work:
    """How many runs, and samples of runs, have been simulated."""

    evaluations: int = 0
    simulated: int = 0


class Problem:
    """The exact costs of tunings of one loop in one experiment; counts its evaluations.

    digits: significant digits of the parameters; margin: relative. Together they give each parameter's neighbourhood,
    within which its true value is taken to lie: the larger of the margin and half a unit of the last digit. nominal:
    searches look at the tuning alone, not at the worst case of its neighbourhood. constraints: of the loop's own plant
    and this experiment's run; a tuning that breaks one has a value as `limits` ranks it, in place of J.
    `one_loop`: whether its runs are those of `loop` alone, which branch programs can state. `price`: of a sample of its
    runs, in those of the plainest loop.
    """

    one_loop = True

    def __init__(
        self,
        loop: Loop,
        experiment: Experiment,
        objective: Objective,
        bounds: Bounds,
        digits: int,
        margin: float,
        *,
        nominal: bool = False,
        constraints: Constraints | None = None,
    ) -> None:
        self.loop, self.experiment, self.objective, self.bounds = loop, experiment, objective, bounds
        self.digits, self.margin, self.nominal = digits, margin, nominal
        self.constraints = constraints
        self.signals = signals(loop, experiment)
        self.samples = self.signals.samples
        self.low = np.array([getattr(bounds, name)[0] for name in NAMES])
        self.high = np.array([getattr(bounds, name)[1] for name in NAMES])
        if loop.controller.form == "parallel":
            # Kc = 0 has no ideal equivalent there.
            self.low[0] = max(self.low[0], min(1e-9 * self.high[0], self.high[0]))
        self.free = np.flatnonzero(self.high > self.low)
        self.work = Work()
        self.weights = kernel_weights(objective, self.samples, loop.sample_time)
        self.price = price(coefficients(loop), self.weights)
        self._offsets = _offsets(np.random.default_rng(0), SPARSE)
        self._dense = _offsets(np.random.default_rng(1), DENSE)
        # Worst cases by tuning, without and with many inner points; and which points of a neighbourhood tell the worst.
        self._known: tuple[dict[bytes, float], dict[bytes, float]] = ({}, {})
        self._lost: dict[int, NDArray[np.int64]] = {}
        self._last = last_offsets(self.samples)
        self._proof = proof_offsets(round(self.price * self.samples))

    def without_derivative(self) -> Problem:
        """Return the same problem with Td held at 0; its work counts as this one's."""
        return self._changed(replace(self.bounds, Td=(0.0, 0.0)), self.constraints)

    def unconstrained(self) -> Problem:
        """Return the same problem without constraints; its work counts as this one's."""
        return self._changed(self.bounds, None)

    def _changed(self, bounds: Bounds, constraints: Constraints | None) -> Problem:
        given = self.loop, self.experiment, self.objective, bounds, self.digits, self.margin
        other = Problem(*given, nominal=self.nominal, constraints=constraints)
        other.work = self.work
        return other

    # Costs.

    def exact(self, tunings: FloatArray) -> FloatArray:
        """Return J of tunings, shape (M, 3) -> (M,), by exact simulation; inf where a run overflows."""
        rows = coefficients(self.loop, self.experiment.stem_offset, tunings)
        self.work.evaluations += rows.shape[0]
        self.work.simulated += rows.shape[0] * self.samples
        with np.errstate(over="ignore", invalid="ignore"):
            terms = sums(rows, self.signals, every=bool(self.objective.kpis))
        return weigh(terms, self.weights, self.samples)

    def values(self, tunings: FloatArray) -> FloatArray:
        """Return J of tunings, shape (M, 3) -> (M,), or how far one breaks a constraint; inf where a run overflows."""
        return self.below(tunings, np.full(tunings.shape[0], np.inf))

    def below(self, tunings: FloatArray, ceilings: FloatArray) -> FloatArray:
        """Return J of each tuning where it does not exceed its ceiling, else inf."""
        return self._worst(tunings, 1, ceilings)

    def least_below(self, tunings: FloatArray, ceilings: FloatArray) -> FloatArray:
        """Return J of each tuning's run where neither it nor the valve's travel is above its limit, else inf.

        No tuning in whose neighbourhood that run lies has a worst J below it and keeps the travel; the margins that
        constraints ask for are not looked at.
        """
        if self.constraints is None:
            return self.below(tunings, ceilings)
        rows = coefficients(self.loop, self.experiment.stem_offset, tunings)
        values = self._runs(rows, 1, ceilings)
        if self.constraints.valve_travel is not None:
            left = np.flatnonzero(np.isfinite(values))
            values[left[self._travel(rows[left]) > self.constraints.valve_travel]] = np.inf
            self.work.simulated += left.size * self.samples
        return values

    def worst_below(self, tunings: FloatArray, ceilings: FloatArray, *, dense: bool = False) -> FloatArray:
        """Return the worst J in the neighbourhood of each tuning where it does not exceed its ceiling, else inf.

        The neighbourhood is the centre, the corners, the faces' middles and some (`dense`: many) random inner points;
        in a nominal problem it is the centre alone.
        """
        return self.below(tunings, ceilings) if self.nominal else self.spread(tunings, ceilings, dense=dense)

    def spread(self, tunings: FloatArray, ceilings: FloatArray, *, dense: bool = True) -> FloatArray:
        """Return the worst J in the neighbourhood of each tuning, also of a nominal problem."""
        # Rounded, the tunings of a search come back again and again: those that won once are known.
        known = self._known[dense]
        keys = np.ascontiguousarray(tunings).view((np.void, tunings.itemsize * tunings.shape[1])).ravel().tolist()
        before = np.array([known.get(key, math.nan) for key in keys])
        values = np.where(before <= ceilings, before, math.inf)
        new = np.flatnonzero(np.isnan(before))
        if new.size:
            around = self.around(tunings[new], dense=dense)
            values[new] = self._worst(around, around.shape[0] // new.size, ceilings[new])
            known.update((keys[i], values[i]) for i in new[np.isfinite(values[new])].tolist())
        return values

    @property
    def limited(self) -> bool:
        """Whether a constraint limits the valve's travel."""
        return self.constraints is not None and self.constraints.valve_travel is not None

    def last_word(self, tuning: FloatArray, ceiling: float = math.inf, *, proof: bool = False) -> float:
        """Return the worst J in the neighbourhood of one tuning, looked at more closely than searches can afford.

        proof: at other and more points, by which no tuning has been chosen. inf above the ceiling. Where the travel's
        limit is broken the rest of the points is not run: the sooner that shows, the higher the value.
        """
        if self.nominal:
            return float(self.below(tuning[None, :], np.array([ceiling]))[0])
        offsets = self._proof if proof else self._last
        parts = np.split(offsets, PARTS) if self.limited else [offsets]
        value = -math.inf
        for left, part in zip(range(len(parts), 0, -1), parts, strict=True):
            # The first point of a group is the tuning itself.
            points = tuning + np.concatenate([np.zeros((1, 3)), part]) * self.radius(tuning[None, :])
            value = max(value, float(self._worst(points, points.shape[0], np.array([ceiling]))[0]))
            if value >= WORN:
                value *= left
                break
        return value if value <= ceiling else math.inf

    def further(self, tuning: FloatArray) -> tuple[int, int, float]:
        """Return at how many points of a proof, of how many, travel is above its limit, and the largest travel (%)."""
        points = tuning + self._proof * self.radius(tuning[None, :])
        travel = self._travel(coefficients(self.loop, self.experiment.stem_offset, points))
        asked = self.constraints
        limit = math.inf if asked is None or asked.valve_travel is None else asked.valve_travel
        return int(np.count_nonzero(travel > limit)), travel.size, float(travel.max())

    def around(self, tunings: FloatArray, *, dense: bool) -> FloatArray:
        """Return the points of the neighbourhoods of tunings (M, 3), one group after the other, shape (M points, 3)."""
        offsets = self._dense if dense else self._offsets
        points = tunings[:, None, :] + offsets[None, :, :] * self.radius(tunings)[:, None, :]
        return np.ascontiguousarray(points.reshape(-1, 3))

    def _worst(self, tunings: FloatArray, group: int, ceilings: FloatArray) -> FloatArray:
        rows = coefficients(self.loop, self.experiment.stem_offset, tunings)
        values = self._runs(rows, group, ceilings)
        if self.constraints is None:
            return values
        # Margins cost more than a run: what has lost already against a feasible parent is not asked for them.
        alive = np.flatnonzero(np.isfinite(values) | (ceilings >= WORN))
        values[alive] = self._ranked(
            tunings[::group][alive], rows.reshape(-1, group, rows.shape[1])[alive], values[alive]
        )
        values[values > ceilings] = np.inf
        return values

    def _runs(self, rows: FloatArray, group: int, ceilings: FloatArray) -> FloatArray:
        """The worst J of the runs of each group of rows where it does not exceed its ceiling, else inf."""
        lost = self._lost.setdefault(group, np.zeros(group, np.int64))
        values, samples = worst(rows, group, self.signals, self.weights, ceilings, lost)
        self.work.simulated += samples
        self.work.evaluations += rows.shape[0]
        return values

    # Constraints. The first point of a group is the tuning itself.

    def margins(self, tunings: FloatArray, *, all_three: bool = True) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return (Ms, gain margin, phase margin in degrees), shape (M, 3), with an ideal valve, and whether stable.

        all_three: see `loop_margins`.
        """
        rows, Ts = coefficients(self.loop.executed, 0.0, tunings), self.loop.executed.sample_time
        values, _, stable = loop_margins(rows, Ts, all_three=all_three)
        return values, stable

    def travel(self, tuning: FloatArray) -> float:
        """Return the largest valve travel (%) in the neighbourhood of a tuning, shape (3,); nominal: its own."""
        tried = tuning[None, :] if self.nominal else self.around(tuning[None, :], dense=True)
        return float(self._travel(coefficients(self.loop, self.experiment.stem_offset, tried)).max())

    def _travel(self, rows: FloatArray) -> FloatArray:
        with np.errstate(over="ignore", invalid="ignore"):
            return sums(rows, self.signals)[:, TRAVEL]

    def _ranked(self, tunings: FloatArray, rows: FloatArray, values: FloatArray) -> FloatArray:
        """Return values with those of tunings that break a constraint replaced by how far they do.

        rows: of each tuning's neighbourhood, shape (M, points, ...): a stem that slips once more travels by a step
        further, so that travel must keep its limit wherever J is looked at. Margins change as smoothly as tunings do.
        """
        asked = self.constraints
        assert asked is not None  # noqa: S101
        if asked.valve_travel is not None:
            runs = np.flatnonzero(np.isfinite(values))
            travel = self._travel(rows[runs].reshape(-1, rows.shape[2])).reshape(-1, rows.shape[1]).max(axis=1)
            values[runs] = worn(values[runs], travel, asked.valve_travel)
        if asked == Constraints(valve_travel=asked.valve_travel) or not tunings.size:
            return values
        margins, stable = self.margins(tunings, all_three=more_than_sensitivity(asked))
        narrow = narrowness(asked, margins)
        values = np.where(narrow > 0.0, NARROW * (1.0 + narrow), values)
        # The nearer an unstable response passes by -1, the nearer the tuning is to a stable one.
        return np.where(stable, values, UNSTABLE * (1.0 + 1.0 / margins[:, 0]))

    # Digits.

    def radius(self, tunings: FloatArray) -> FloatArray:
        """Return the half-widths of the neighbourhoods of tunings, same shape."""
        half: FloatArray = np.maximum(self.margin * np.abs(tunings), 0.5 * unit_of(tunings, self.digits))
        return half

    def rounded(self, tunings: FloatArray) -> FloatArray:
        """Return tunings at the digits to type in, within the bounds; fixed parameters stay as they are."""
        result = np.array(tunings, dtype=np.float64)
        result[:, self.free] = round_to(result[:, self.free], self.digits, self.low[self.free], self.high[self.free])
        return result

    # Coordinates.

    def cube(self, tunings: FloatArray) -> FloatArray:
        """Return the unit-cube coordinates of tunings (M, 3), clipped to the bounds, shape (M, free parameters)."""
        clipped = np.clip(tunings, self.low, self.high)
        columns = []
        for k in self.free:
            low, high, forth, _ = self._scale(int(k))
            columns.append((forth(clipped[:, k]) - low) / (high - low))
        return np.stack(columns, axis=1) if columns else np.zeros((tunings.shape[0], 0))

    def tunings(self, points: FloatArray) -> FloatArray:
        """Return the tunings (M, 3) of unit-cube points (M, free parameters)."""
        result = np.empty((points.shape[0], 3))
        result[:] = self.low
        for column, k in enumerate(self.free.tolist()):
            (low, high, _, back), ends, at = self._scale(k), (self.low[k], self.high[k]), points[:, column]
            values = np.minimum(np.maximum(back(low + at * (high - low)), ends[0]), ends[1])
            values[at <= 0.0], values[at >= 1.0] = ends
            result[:, k] = values
        return result

    def _scale(self, k: int) -> tuple[float, float, Mapping, Mapping]:
        if k == 1:
            return math.log(self.low[1]), math.log(self.high[1]), np.log, np.exp
        return math.sqrt(self.low[k]), math.sqrt(self.high[k]), np.sqrt, np.square

    def guesses(self) -> FloatArray:
        """Return tunings worth a try: the loop's own, and internal-model tunings from brisk to sluggish, (M, 3).

        Those are `Kc = T/(|K| (lambda + theta))`, `Ti = min(T, 4 (lambda + theta))` after S. Skogestad, "Simple
        analytic rules for model reduction and PID controller tuning", J. Process Control 13 (2003) 291-309.
        """
        plant, pid, Ts = self.loop.plant, self.loop.controller, self.loop.sample_time
        theta = plant.dead_time + Ts / 2.0
        own = [(pid.Kc, pid.Ti, pid.Td)]
        for ratio in (0.3, 1.0, 2.0, 4.0, 10.0):
            closed = ratio * theta + theta
            if isinstance(plant, FOPDT):
                gain = plant.time_constant / (abs(plant.gain) * closed)
                Ti = min(plant.time_constant, 4.0 * closed)
            else:
                gain, Ti = 1.0 / (abs(plant.gain) * closed), 4.0 * closed
            for stretch, Td in itertools.product((1.0, 2.0), (0.0, theta / 2.0)):
                parallel = pid.form == "parallel"
                own.append((gain, stretch * Ti / gain if parallel else stretch * Ti, Td * gain if parallel else Td))
        if self.wrong_way:
            # Anything but the least gain is the worse for it, constraints or not.
            own.append((0.0, pid.Ti, pid.Td))
        guesses: FloatArray = np.clip(np.array(own), self.low, self.high)
        return guesses

    @property
    def wrong_way(self) -> bool:
        """Whether the controller acts the wrong way for the plant."""
        return self.loop.controller.signed_gain * self.loop.gain < 0.0

    def remark(self, Kc: float) -> str:
        """Return in words why a gain is none to go on from, empty where it is one."""
        if self.wrong_way:
            action = self.loop.controller.action
            return f"the controller acts the wrong way for this plant ({action} action): the least gain does the least"
        alone = "Kc = 0: nothing within the bounds was found to be better than to leave the loop alone; Ti and Td play "
        return f"{alone}no part" if Kc == 0.0 else ""

    def controller(self, tuning: FloatArray) -> PID:
        """Return the loop's controller with this tuning."""
        return replace(self.loop.controller, Kc=float(tuning[0]), Ti=float(tuning[1]), Td=float(tuning[2]))


def unit_of(values: FloatArray, digits: int) -> FloatArray:
    """Return one unit of the last of `digits` significant digits of each value, 0 for 0."""
    size = np.abs(values)
    power = np.floor(np.log10(np.where(size > 0.0, size, 1.0)))
    unit: FloatArray = np.where(size > 0.0, 10.0 ** (power + 1 - digits), 0.0)
    return unit


def round_to(values: FloatArray, digits: int, low: float | FloatArray, high: float | FloatArray) -> FloatArray:
    """Return values rounded to significant digits, as decimal text would be read; never outside [low, high].

    values: of any shape, which low and high fit.

    Where rounding leaves the range, the next number inside is taken, or the nearer end if there is none.
    """
    # A whole number of units, divided by a power of ten or times one, rounds once, as reading the decimal text does.
    # Values so near to the middle between two that the quotient may not tell them are written out.
    size = np.abs(values)
    power = np.floor(np.log10(np.where(size > 0.0, size, 1.0))) + 1.0 - digits
    scale = 10.0 ** np.minimum(np.abs(power), EXACT_POWER)
    units = np.where(power > 0.0, values / scale, values * scale)
    whole = np.rint(units)
    result = np.where(power > 0.0, whole * scale, whole / scale)
    plain = (np.abs(power) <= EXACT_POWER) & (np.abs(np.abs(units - whole) - 0.5) > 1e-3)
    plain &= (result >= low) & (result <= high)
    if not plain.all():
        lows, highs = np.broadcast_to(low, values.shape), np.broadcast_to(high, values.shape)
        for i in zip(*np.nonzero(~plain), strict=True):
            result[i] = _written(float(values[i]), digits, float(lows[i]), float(highs[i]))
    return result


def _written(value: float, digits: int, low: float, high: float) -> float:
    """`round_to` of one value by its decimal text."""
    near = float(f"{value:.{digits - 1}e}")
    if not low <= near <= high:
        unit = float(unit_of(np.array([value]), digits)[0])
        near = float(f"{near + (unit if near < low else -unit):.{digits - 1}e}")
    return near if low <= near <= high else (low if value - low <= high - value else high)


def last_offsets(samples: int) -> FloatArray:
    """Return the points of [-1, 1]^3 by which a neighbourhood gets the last word; samples: of a run."""
    return _offsets(np.random.default_rng(2), max(DENSE, min(LAST, LAST_SAMPLES // samples)))


def proof_offsets(samples: int) -> FloatArray:
    """Return the points of [-1, 1]^3 by which the last few tunings are proved; samples: of a run, in plain ones."""
    return _offsets(np.random.default_rng(3), max(DENSE, min(PROOF, PROOF_SAMPLES // samples)))


def _offsets(rng: np.random.Generator, inner: int) -> FloatArray:
    """Return the centre, corners, faces' middles and random inner points of the cube [-1, 1]^3."""
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    return np.concatenate([np.zeros((1, 3)), corners, faces, rng.uniform(-1.0, 1.0, (inner, 3))])
