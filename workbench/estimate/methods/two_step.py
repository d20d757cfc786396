"""The two-step algorithm: plant by least squares for a given d, then d by the paper's criterion, in turn.

Steps 1 to 4 of the section "Proposed Technique" in "Managing the Performance of Control Loops with Valve Stiction: An
Industrial Perspective": ARX least squares for the plant, Akaike's criterion minimised over the stiction by a numerical
solver (Nelder and Mead's simplex from the present value), repeated until d no longer moves. The criterion is piecewise
constant in d, so that the iteration locks in where it starts: it is kept as a method for comparison.
"""

from __future__ import annotations

import math

import numpy as np

from workbench.estimate.fits.data import Centred, integers, plant_of
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, predict
from workbench.estimate.kernels.walk import COST, DELAY, ROW, AtDelays, at_delays, walk
from workbench.estimate.search.candidates import Candidate
from workbench.estimate.search.models import akaike
from workbench.estimate.search.profile import Profile
from workbench.estimate.search.stems import firsts_within, path_of, thin
from workbench.model.record import FloatArray
from workbench.model.results import Iteration

__all__ = ["PARAMETERS", "two_step"]

# d, gain, time constant, dead time, bias.
PARAMETERS = 5
ROUNDS = 30
STARTS = 12


def _arx(data: Centred, x: FloatArray, first: int, delay: int) -> Fit:
    """The plant by one-step least squares at a whole delay (its sum of squares left open)."""
    y, n = data.y, data.samples - 1
    shifted = np.concatenate([np.zeros(delay), x[: n - delay]])
    unknown = (np.arange(n) < first + delay).astype(np.float64)
    columns = [np.ones(n), shifted, unknown]
    target = y[1:] - y[:-1] if data.integrating else y[1:]
    if not data.integrating:
        columns.append(y[:-1])
    regressors = np.column_stack(columns)
    terms, *_ = np.linalg.lstsq(regressors, target, rcond=None)
    pole = 1.0 if data.integrating else float(np.clip(terms[3], 1e-9, 0.9999))
    if not data.integrating and pole != terms[3]:
        target = target - pole * y[:-1]
        regressors = regressors[:, :3]
        terms, *_ = np.linalg.lstsq(regressors, target, rcond=None)
    if data.integrating:
        return Fit(math.nan, 1.0, float(delay), float(terms[1]), float(y[0]), float(terms[2]), float(terms[0]))
    tau, share = -1.0 / math.log(pole), 1.0 - pole
    gain, bias, start = (float(terms[i]) / share for i in (1, 0, 2))
    return Fit(math.nan, tau, float(delay), gain, bias, start, float(y[0]) - bias - start)


def _plant_step(data: Centred, d: float, shifted: AtDelays) -> tuple[int, Fit]:
    """Step 2: the plant for a given d. The paper is silent on where the stem starts: least squares chooses that too."""
    best_cost, best = math.inf, (0, Fit(math.nan, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    u = data.u
    for first in thin(firsts_within(data, d), STARTS).tolist():
        x, _ = path_of(u, d, first)
        rows = np.empty((1, ROW))
        count = walk(
            data.sums,
            data.squares,
            data.products,
            u,
            first,
            d,
            math.nextafter(d, math.inf),
            0.0,
            shifted,
            1.0 if data.integrating else math.nan,
            data.sign,
            rows,
        )
        if count and rows[0, COST] < best_cost:
            best_cost, best = rows[0, COST], (first, _arx(data, x, first, int(rows[0, DELAY])))
    return best


def _criterion(data: Centred, d: float, first: int, fit: Fit) -> float:
    """AIC of the combined model's prediction with the plant as it is."""
    if d <= 0.0:
        return math.inf
    x, _ = path_of(data.u, d, first)
    errors = data.y - predict(data, x, first, fit)[0]
    return akaike(data, float(errors @ errors), PARAMETERS)


def _stiction_step(data: Centred, d: float, first: int, fit: Fit) -> float:
    """Step 3: the d that a numerical solver reaches from the present one, the plant held."""
    from scipy.optimize import fmin

    def criterion(p: FloatArray) -> float:
        return _criterion(data, float(p[0]), first, fit)

    simplex = np.array([[d], [1.05 * d]])
    # 1e-3 of AIC is far below what any record can tell; 1e-4 of OP's range is a stiction that no valve knows.
    found = fmin(criterion, simplex[0], xtol=1e-4 * data.op_range, ftol=1e-3, disp=False, initial_simplex=simplex)
    return float(found[0])


def two_step(data: Centred, start: float | None, max_delay: float) -> tuple[Profile, tuple[Iteration, ...]]:
    """Run the algorithm from `start` (%, a quarter of OP's range by default); return its end and its history."""
    d = 0.25 * data.op_range if start is None else start
    shifted = at_delays(data.sums, integers(np.arange(math.floor(max_delay + 1e-9) + 1)))
    history: list[Iteration] = []
    seen: list[Candidate] = []
    for _ in range(ROUNDS):
        first, fit = _plant_step(data, d, shifted)
        x, slips = path_of(data.u, d, first)
        errors = data.y - predict(data, x, first, fit)[0]
        sse = float(errors @ errors)
        fit = Fit(sse, fit.tau, fit.theta, fit.gain, fit.bias, fit.start, fit.transient)
        history.append(
            Iteration(
                d, plant_of(data, fit.gain, fit.tau, fit.theta), sse / data.samples, akaike(data, sse, PARAMETERS)
            )
        )
        seen.append(Candidate(first, d, d, slips, fit))
        moved = _stiction_step(data, d, first, fit)
        if abs(moved - d) <= 1e-4 * data.op_range or any(abs(moved - c.d_low) < 1e-9 * d for c in seen):
            break
        d = moved
    best = min(seen, key=lambda c: c.fit.sse)
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, float(max_delay)))
    along = tuple(sorted(seen, key=lambda c: c.d_low))
    return Profile(best, (best,), along, np.empty((0, 6)), (), False, limits, best.fit.theta >= max_delay), tuple(
        history
    )
