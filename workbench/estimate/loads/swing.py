"""An oscillation from outside the loop: a sinusoid in what the best model leaves, found together with its plant.

An autoregression of low order does not hold a sinusoid, and a plant that is fitted beside one takes part of it for its
own work. Where what is left is seen to swing, amplitude, phase and frequency are fitted beside gain, time constant and
dead time, the stem's path as it is, and PV is looked at anew without it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from scipy.optimize import minimize

from workbench.detect.sinusoid import FEWEST_PERIODS, slowest, strongest
from workbench.detect.whitening import whitened
from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, LOUD, Limits, autoregression, grounded, grown, predict
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.kernels.beside import left_swinging
from workbench.estimate.loads.coloured import TAUS, delays_about
from workbench.estimate.loads.drifting import drifting_bic
from workbench.estimate.search.paths import Path
from workbench.model.loads import LoadSwing
from workbench.model.numbers import given
from workbench.model.plant import Integrating, Plant
from workbench.model.record import FloatArray
from workbench.model.results import Estimate, Intervals, LinearFit

__all__ = ["SWINGS", "Answered", "Swing", "beside_swing", "besides", "swings", "words_of_swing"]

# Of N log V: the highest of N/2 frequencies gains 2 log(N/2) in noise alone. Amplitude, phase and a frequency that is
# searched for: four degrees (N. Zhang, D. Siegmund, Biometrics 63 (2007) 22-32, of change points). Beyond these "very
# strong" evidence (R. Kass, A. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795).
DEGREES, CLEAR = 4, 10.0
FEWEST = 50  # samples
MUCH = 0.25  # of what is left: a smaller sinusoid does the plant little harm
LAGS, LONGEST = 6, 0.25  # lags along which sinusoids are looked for, up to a quarter of the record, and
ALONE = 0.025  # of a sinusoid's squares about: less than a tenth of them is not what the model itself can do
SPREAD, SHIFT, TURN = 0.05, 0.5, 0.2  # of the time constant, samples, and a turn over the record: the first simplex's
EVALUATIONS = 400
SWINGS, SETTLED = 5, 0.98  # times that it is fitted, while the model then leaves less of PV
Model = TypeVar("Model", Estimate, LinearFit)


@dataclass(frozen=True, eq=False)
class Swing:
    """A sinusoid in PV: angular frequency, rad a sample, amplitude, EU; pv: itself, EU, shape (N,).

    answers: shape (3, N), what PV changes by with its two amplitudes and with its frequency, up to factors.
    """

    angle: float
    amplitude: float
    pv: FloatArray
    answers: FloatArray

    def load(self, plant: Plant, sample_time: float) -> LoadSwing:
        """Return the load that makes it, at the input of a plant; sample_time: s."""
        frequency = self.angle / sample_time
        falls = frequency if isinstance(plant, Integrating) else math.hypot(1.0, frequency * plant.time_constant)
        return LoadSwing(2.0 * math.pi / frequency, self.amplitude / abs(plant.gain) * falls, self.amplitude)


class Answered(NamedTuple, Generic[Model]):
    """A model, the likeliest stem paths of its valve, the record without loads as it was fitted, and further ranges.

    The ranges are those of parts of the record and of valves that fit as well; the model's own do not hold them yet.
    """

    model: Model
    paths: list[Path]
    settled: Centred
    others: tuple[Intervals, ...]


def beside_swing(
    data: Centred, first: Answered[Model], again: Callable[[Centred], Answered[Model]], longest: float
) -> tuple[Answered[Model], Swing | None]:
    """A model, or the one beside an oscillation from outside if that leaves less of PV, and the oscillation.

    again: the model of a record without it. Each is found beside the other, in turn; longest: as in `_Straight`.
    """
    found, swing = first, None
    for _ in range(SWINGS):
        limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
        beside, left = _swing_of(found.settled, found.paths[0], limits, swing)
        least = found.model.residual_variance
        if beside is None:
            break
        likelier = data.samples * math.log(max(least, data.floor) / max(left, data.floor))
        # Both fitted on together, and hardly likelier: the model has been found beside the same sinusoid.
        if swing is not None and (likelier < CLEAR or _same(swing, beside, least)):
            break
        other = again(besides(data, beside))
        if not other.model.residual_variance < (1.0 if swing is None else SETTLED) * least:
            break
        found, swing = other, beside
    return found, swing


def _same(one: Swing, other: Swing, left: float) -> bool:
    """Whether a model fitted beside the other leaves, but for `SETTLED`, what it leaves beside the one, EU^2.

    To what is left, in the root of its mean square, a swing adds no more than its own.
    """
    return float(np.sqrt(np.mean((one.pv - other.pv) ** 2))) <= 0.5 * (1.0 - SETTLED) * math.sqrt(left)


def words_of_swing(load: LoadSwing, *, blind: bool) -> str:
    """Return in words that an oscillation beside the stem was found; blind: whether the plant is not identified."""
    period = given(load.period, 3)
    swings = (
        f"PV swings by {given(load.amplitude, 3)} EU to either side with a period of {period} s, which no stem makes"
    )
    if blind:
        # What a tight controller makes of an unknown plant looks the same.
        return f"{swings}: the model is fitted beside it, be it from outside or of the loop's own tuning"
    return f"{swings}: an oscillation from outside the loop, beside which the model is fitted"


def besides(data: Centred, swing: Swing | None) -> Centred:
    """Return a record without an oscillation, if there is one."""
    return data if swing is None else data.less(swing.pv, swing.answers)


def swings(data: Centred, lead: Path, limits: Limits) -> bool:
    """Return whether an oscillation from outside stands out of what a stem with its plant leaves, as `beside_swing`."""
    return _swing_of(data, lead, limits, None)[0] is not None


def _swing_of(data: Centred, lead: Path, limits: Limits, before: Swing | None) -> tuple[Swing | None, float]:
    """Return the oscillation that the best model leaves, or None where there is none, and what both leave, EU^2.

    data: without load steps, and without the oscillation that was found before; lead: the model's stem with its plant.
    What turns more slowly than the record can tell is a drift.
    """
    n, fit = data.samples, lead.fit
    if not FEWEST <= n <= WHOLE or fit.gain == 0.0:
        return None, math.inf
    left = data.y - predict(data, lead.x, lead.first, grounded(data, lead.x, lead.first, fit, lead.bounds))[0]
    a, level = autoregression(left, data.floor)
    if before is not None:
        swing, rest = _fitted(data, data.y + before.pv, lead, before.angle, limits)
        return swing, float(rest @ rest) / n
    innovations = whitened(a, left)[a.size :]
    angles = {strongest(left), strongest(innovations)}
    stands_out = max(-n * math.log(_beside(innovations, angle)) for angle in angles)
    if not float(np.mean(left**2)) > LOUD * data.floor or (
        a.size == 1 and stands_out < 2.0 * math.log(n / 2.0) + CLEAR
    ):
        return None, math.inf
    leads = [(lead, angle) for angle in sorted(angles)]
    if lead.valve.stick_band > 0.0:
        # A plant that is far off, as a lag that never levels off for the sake of the oscillation, leaves others. A loop
        # without a stem swings by itself where it is tuned too tightly, which any oscillation would explain.
        leads += _scanned(data, lead, limits)
    tried = (_fitted(data, data.y, *one, limits) for one in leads)
    found = [one for one in tried if one[0].angle > slowest(n)]
    if not found:
        return None, math.inf
    swing, rest = min(found, key=lambda one: float(one[1] @ one[1]))
    much = float(np.var(swing.pv)) >= MUCH * (float(np.var(swing.pv)) + float(np.var(rest)))
    price = DEGREES * math.log(n) + CLEAR
    after = autoregression(rest, data.floor)[1]
    clear = much and after < level - price
    if clear:
        # A load that drifts, over a record in which it turns a few times only, passes for an oscillation.
        with_it, without = (
            drifting_bic(one, lead.x, lead.first, [(fit.tau, fit.theta)], limits, 0)
            for one in (data.less(swing.pv, swing.answers), data)
        )
        clear = min(after, with_it) < without - price
    return swing if clear else None, float(rest @ rest) / n


def _fitted(data: Centred, y: FloatArray, lead: Path, angle: float, limits: Limits) -> tuple[Swing, FloatArray]:
    """A sinusoid of about a frequency fitted to y beside a stem and its plant, and what both leave."""
    n, fit, size = data.samples, lead.fit, 2 if data.integrating else 3

    def placed(point: FloatArray) -> tuple[float, float, float]:
        tau = fit.tau if data.integrating else min(max(fit.tau * grown(point[2]), limits.tau[0]), limits.tau[1])
        at = max(angle + 2.0 * math.pi * float(point[1]) / n, slowest(n))
        return tau, min(max(fit.theta + float(point[0]), 0.0), limits.theta[1]), at

    def cost(point: FloatArray) -> float:
        return left_swinging(y, lead.x, lead.first, data.integrating, *placed(point))

    delays = delays_about(fit.theta, limits.theta[1])
    points = [[d - fit.theta, 0.0, math.log(t)][:size] for d in delays for t in (TAUS if size == 3 else TAUS[:1])]
    point = min((np.array(one) for one in points), key=cost)
    for share in (1.0, 0.1):
        simplex = point + share * np.vstack([np.zeros(size), np.diag([SHIFT, TURN, SPREAD][:size])])
        point = minimize(
            cost,
            point,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-4, "fatol": 1e-6 * cost(point)},
        ).x
    tau, theta, at = placed(point)
    waves = _waves(at, n)
    columns = np.vstack([predict(data, lead.x, lead.first, replace(fit, tau=tau, theta=theta))[1], waves])
    terms, *_ = np.linalg.lstsq(columns.T, y, rcond=1e-10)
    sizes = terms[-2:]
    turned = np.arange(n) * (sizes @ _waves(at, n, 0.5 * math.pi))
    return Swing(at, float(np.hypot(*sizes)), sizes @ waves, np.vstack([waves, turned])), y - terms @ columns


def _scanned(data: Centred, lead: Path, limits: Limits) -> list[tuple[Path, float]]:
    """The plant and the sinusoid that leave least together along a stem, of a grid of plants and all frequencies."""
    n, fit = data.samples, lead.fit
    finer, lowest = 2 * n, 2 * FEWEST_PERIODS
    taus = [fit.tau] if data.integrating else np.geomspace(limits.tau[0], LONGEST * n, LAGS).tolist()
    least, best = math.inf, (fit.tau, fit.theta, 0)
    for tau in taus:
        for theta in delays_about(fit.theta, limits.theta[1]):
            columns = predict(data, lead.x, lead.first, replace(fit, tau=tau, theta=theta))[1]
            base = np.linalg.qr(columns.T)[0].T
            rest = data.y - (base @ data.y) @ base
            of_rest, of_base = np.fft.rfft(rest, finer), np.fft.rfft(base, finer)
            # Cosine and sine less what the model's columns hold of them: their products with each other and with PV.
            cosine = 0.5 * n - (of_base.real**2).sum(axis=0)
            sine = 0.5 * n - (of_base.imag**2).sum(axis=0)
            both = (of_base.real * of_base.imag).sum(axis=0)
            taken = sine * of_rest.real**2 - 2.0 * both * of_rest.real * of_rest.imag + cosine * of_rest.imag**2
            alone = cosine * sine - both**2
            gains = np.where(alone > ALONE * n * n, taken / np.maximum(alone, 1e-300), 0.0)[lowest : finer // 4]
            at = int(np.argmax(gains))
            left = float(rest @ rest) - float(gains[at])
            if left < least:
                least, best = left, (tau, theta, lowest + at)
    tau, theta, at = best
    return [(replace(lead, fit=replace(fit, tau=tau, theta=theta)), 2.0 * math.pi * at / finer)] if at else []


def _waves(angle: float, n: int, ahead: float = 0.0) -> FloatArray:
    """Cosine and sine of a frequency, rad a sample, shape (2, N)."""
    at = angle * np.arange(n) + ahead
    return np.array([np.cos(at), np.sin(at)])


def _beside(signal: FloatArray, angle: float) -> float:
    """The share of a signal's squares about its mean that a sinusoid leaves."""
    columns = np.vstack([_waves(angle, signal.size), np.ones(signal.size)])
    sizes, *_ = np.linalg.lstsq(columns.T, signal, rcond=None)
    rest, about = signal - sizes @ columns, signal - signal.mean()
    return max(float(rest @ rest), 1e-300) / max(float(about @ about), 1e-300)
