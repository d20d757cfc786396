"""First order or integrating: which plant a record shows, by how well each foretells PV one sample ahead.

Under a coloured load the output error of an integrating plant wanders, and its sum of squares says little. So plant and
disturbance are fitted in turns: the generalised least squares of D. Clarke, "Generalized least squares estimation of
the parameters of a dynamic model", IFAC Symposium on Identification in Automatic Control Systems, Prague 1967.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import (
    INTEGRATED,
    LEAST_TAU,
    Fit,
    Limits,
    autoregression,
    disturbance,
    fit_path,
    predict,
)
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.loads.coloured import colour_beside
from workbench.estimate.loads.drifting import drifting_bic
from workbench.estimate.loads.swing import Answered, Model, swings
from workbench.estimate.search.models import PLANT_PARAMETERS, VALVE_PARAMETERS
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import FloatArray, Record
from workbench.model.results import LinearFit
from workbench.model.valve import Ideal, Valve

__all__ = [
    "CLEAR_BIC",
    "ENDLESS",
    "FAR_BIC",
    "foretelling_bic",
    "foretelling_of",
    "levels_off",
    "likelier_kind",
    "ramps",
    "swings_as_a_lag",
    "with_other_plant",
]

ROUNDS = 4
BARE_BIC = 2.0  # up to it a difference is "not worth more than a bare mention" (source at `CLEAR_BIC`)
CLEAR_BIC = 10.0  # R. Kass, A. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795: "very strong" evidence above it
FAR_BIC = 10.0 * CLEAR_BIC
# Of the record: a time constant from there on is none that PV shows, whose gain in steady state it never comes near.
ENDLESS = 0.5
TAUS = (0.02, 0.1, 0.5)  # of the record: time constants from which a first-order plant along a stem is sought


def ramps(data: Centred, linear: Fit, stems: Sequence[tuple[FloatArray, int, Fit]], limits: Limits) -> bool:
    """Return whether a level is likelier than a lag along the first stems of a lag, beside noise upon a drift.

    stems: each a path x, shape (N,), its first slip and its plant, the linear loop's along OP. What they leave one
    plant sums up and the other answers, which tells the two long before the right stem is found; but not where they
    leave noise alone, nor where no stem is clearly likelier than OP itself: a drift does as well as much that PV
    answers.
    """
    left = (data.y - predict(data, *stem)[0] for stem in stems)
    if data.samples > WHOLE or any(autoregression(one, data.floor)[0].size == 1 for one in left):
        return False
    level = replace(data, integrating=True)
    lags, levels = [], []
    for x, first, fit in [*stems, (data.u, 0, linear)]:
        lags.append(drifting_bic(data, x, first, [(fit.tau, fit.theta)], limits, 0) + math.log(data.samples))
        levels.append(drifting_bic(level, x, first, [(1.0, fit.theta), (1.0, 0.0)], limits, 0))
    return min(levels) < min(lags) and min(levels) < min(lags[-1], levels[-1]) - CLEAR_BIC


def foretelling_bic(
    data: Centred,
    plant: Plant,
    valve: Valve,
    valve_position: FloatArray,
    prediction: FloatArray,
    *,
    closely: bool = False,
    far: bool = False,
) -> float:
    """Return `N log V + p log N` with V the mean square of the one-step prediction errors, along the stem found.

    data: the record as it was estimated, to the plant and valve with this stem (%, shape (N,)) and prediction (PV, EU,
    shape (N,)), less the load steps and the oscillation from outside that were found beside it. p counts plant, valve,
    loads, oscillation and disturbance. closely: plant and disturbance are sought together, too (`loads.coloured`);
    far: and that may remember more.
    """
    n = data.samples
    x = valve_position - data.op_middle
    # Where the stem rests until it first moves is fitted, as it was when the stem was found.
    first = 0 if isinstance(valve, Ideal) else int(np.argmax(x != x[0]))
    tau = plant.time_constant / data.sample_time if isinstance(plant, FOPDT) else 1.0
    start = Fit(math.nan, tau, plant.dead_time / data.sample_time, 0.0, 0.0, 0.0, 0.0)
    limits = Limits((LEAST_TAU, float(n)), (0.0, max(2.0 * start.theta, 30.0)))
    begun = data.pv_mean + data.load + data.y - prediction
    free, least = _free(data, valve), math.inf

    def along(coloured: Centred, fit: Fit) -> Fit:
        nonlocal least
        fit = fit_path(coloured, x, first, (-math.inf, math.inf), limits, fit.theta, tau=fit.tau)
        variance = fit.sse / (n - coloured.skip)
        p = free + coloured.terms
        least = min(least, n * math.log(max(variance, data.floor)) + p * math.log(n))
        return fit

    for moves in (False, True)[: 1 + data.integrating]:
        fit, left = start, begun
        for _ in range(ROUNDS):
            a = disturbance(np.diff(left) if moves else left, data.floor)
            fit = along(data.whitened(np.convolve(INTEGRATED, a) if moves else a, 0), fit)
            left = data.y - predict(data, x, first, fit)[0]
        if closely and a.size > 1:
            colour, (tau, theta) = colour_beside(data, x, first, fit, limits, 0, moves, far)
            along(data.whitened(colour.a, 0, colour.law), replace(fit, tau=tau, theta=theta))
            if far:
                near = [(fit.tau, fit.theta), (tau, theta)]
                least = min(least, drifting_bic(data, x, first, near, limits, 0) + free * math.log(n))
    return least


def foretelling_of(record: Record, kind: str, answered: Answered[Model], *, closely: bool = False) -> float:
    """Return the BIC (`foretelling_bic`) of a record's model with one kind of plant, "fopdt" or "integrating"."""
    model, data = answered.model, _less_loads(record, kind, answered)
    valve, position = _stem(record, model)
    # What the model itself leaves, too: where that is nearly nothing no fit along its stem comes to as little.
    left = data.pv_mean + data.load + data.y - model.prediction
    own = autoregression(left, data.floor)[1] + _free(data, valve) * math.log(left.size)
    # Where no stem is seen to move PV a level with a long memory does as well as a lag.
    along = foretelling_bic(data, model.plant, valve, position, model.prediction, closely=closely, far=_sticks(model))
    return min(own, along)


def with_other_plant(record: Record, kind: str, answered: Answered[Model], *, closely: bool = False) -> float:
    """Return the same for a plant of the other kind, `kind`, along the stem and beside the loads of that model."""
    model, data = answered.model, _less_loads(record, kind, answered)
    plants: list[Plant] = [model.plant]
    if not data.integrating:
        duration = data.samples * data.sample_time
        plants = [FOPDT(model.plant.gain, share * duration, model.plant.dead_time) for share in TAUS]
    stem = _stem(record, model)
    how = partial(foretelling_bic, closely=closely, far=closely and _sticks(model))
    return min(how(data, plant, *stem, model.prediction) for plant in plants)


def swings_as_a_lag(record: Record, answered: Answered[Model]) -> bool:
    """Return whether a lag along a level's stem, beside that model's load steps, leaves an oscillation from outside.

    A level that sums up its stem takes a part of such a load for its own work, and leaves no more along it than a lag
    that does not know of the load.
    """
    data, lead, n = _less_loads(record, "fopdt", answered), answered.paths[0], len(record)
    limits = Limits((LEAST_TAU, float(n)), (0.0, max(2.0 * lead.fit.theta, 30.0)))
    free, theta = (-math.inf, math.inf), lead.fit.theta
    fits = (fit_path(data, lead.x, lead.first, free, limits, theta, tau=share * n) for share in TAUS)
    return swings(data, replace(lead, bounds=free, fit=min(fits, key=lambda fit: fit.sse)), limits)


def levels_off(record: Record, plant: Plant) -> bool:
    """Return whether a plant shows its gain in steady state within the record; an integrating one has none to show."""
    return not (isinstance(plant, FOPDT) and plant.time_constant >= ENDLESS * len(record) * record.sample_time)


def likelier_kind(by: float, *, levels_off: bool, sticks: bool, less: bool) -> str:
    """Return the kind of plant to tell, where a lag is likelier than a level by so much of BIC.

    levels_off: whether the lag does so within the record; sticks: whether the valve does, with both; less: whether the
    lag leaves less of PV.
    """
    if not levels_off:
        # The two differ by the stems that were found, not by the plant: unless what is left of PV says it too.
        return "fopdt" if by > FAR_BIC and less else "integrating"
    # Along a stem, which moves PV by itself, a level that does as well has a parameter less; without one, of two that
    # are hardly told apart, the one that the time constant speaks for.
    return "fopdt" if by > (-BARE_BIC if sticks else -CLEAR_BIC) else "integrating"


def _free(data: Centred, valve: Valve) -> int:
    """How many parameters plant, valve and loads have."""
    own = VALVE_PARAMETERS.get(type(valve).__name__.lower(), 0)
    return PLANT_PARAMETERS - data.integrating + own + len(data.answers)


def _sticks(model: Model) -> bool:
    return not isinstance(model, LinearFit) and model.verdict == "stiction"


def _less_loads(record: Record, kind: str, answered: Answered[Model]) -> Centred:
    """The record without the load steps and the oscillation that were found beside a model."""
    settled, data = answered.settled, centre(record, kind)
    return data.less(settled.load, settled.answers) if settled.load.any() else data


def _stem(record: Record, model: Model) -> tuple[Valve, FloatArray]:
    """A model's valve and stem; the linear one's stem is OP."""
    if isinstance(model, LinearFit):
        return Ideal(), record.op
    return model.valve, model.valve_position
