"""What the methods that go on from the profile's paths with a nonlinear program make of its estimate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from workbench.errors import InvalidValue, RecordError
from workbench.estimate.fits.data import Centred, plant_of
from workbench.estimate.fits.fit import Fit, Limits, grounded, predict
from workbench.estimate.fits.sureness import NORMAL, standard_errors
from workbench.estimate.ranges.scale import bias_of, ranges_of, unsure, wider
from workbench.estimate.search.models import PLANT_PARAMETERS, VALVE_PARAMETERS, akaike
from workbench.estimate.search.paths import Path
from workbench.model.estimation import MOST_IN_PROGRAM, Complementarity, Estimate, Intervals, NoiseModel
from workbench.model.numbers import given
from workbench.model.record import FloatArray, Record
from workbench.model.valve import Ideal

__all__ = ["by_complementarity", "jointly", "refuse_complementarity"]

BETTER = 1e-6  # share of the profile's cost: a path that is no better than by this is the same one


def jointly(
    data: Centred, plain: Estimate, paths: list[Path], limits: Limits, tell: Callable[[float], None]
) -> Estimate:
    """Return the estimate with its plant, start and path by the joint refinement; its verdict stays."""
    # CasADi is loaded for this method alone.
    from workbench.estimate.methods.joint import refine

    found = refine(data, paths, limits, tell)
    best = found.best
    if best is None:
        failed = f"the joint refinement ended as {found.status.value}: the profile's own fit is shown"
        return replace(plain, reasons=(*plain.reasons, failed))
    errors = unsure(data, found.errors, best.fit, best.path.valve.stick_band)
    ranges = _ranges(data, plain, best.path, [r.fit for r in found.alike], errors, limits)
    answer = _along(data, plain, best.path, best.fit, best.prediction(data), ranges, best.drifts)
    n = data.samples
    span = n * data.sample_time
    half = NORMAL * found.drift_error
    begin, stop = found.stretch
    said = (f"the record is long: the joint refinement used its samples {begin} to {stop}",) if stop - begin < n else ()
    return replace(
        answer,
        reasons=plain.reasons + said,
        noise_model=NoiseModel(
            ar=best.a,
            innovation_sd=found.innovation_sd,
            drift=best.drift / span,
            drift_interval=((best.drift - half) / span, (best.drift + half) / span) if best.drifts else None,
            compared=found.compared,
            iterations=found.iterations,
        ),
    )


def refuse_complementarity(record: Record, valve: str) -> None:
    """Raise `InvalidValue` or `RecordError` where method "complementarity" does not take a valve or a record."""
    if valve not in ("auto", "stenman"):
        raise InvalidValue(
            "estimate.valve", valve, "method 'complementarity' knows the Stenman valve alone: stenman, or auto"
        )
    if len(record) > MOST_IN_PROGRAM:
        msg = (
            f"{record.source or 'record'}: {len(record)} samples given; method 'complementarity' takes at most "
            f"{MOST_IN_PROGRAM:,}: give a shorter stretch, or use 'profile' or 'joint'"
        )
        raise RecordError(msg)


def by_complementarity(
    data: Centred, plain: Estimate, paths: list[Path], limits: Limits, tell: Callable[[float], None]
) -> Estimate:
    """Return the estimate with what the complementarity program finds from the profile's best path.

    data: as that path was fitted to it. The estimate stays the profile's, unless the program was solved and the exact
    stem for its d fits better; its verdict stays in any case.
    """
    if isinstance(plain.valve, Ideal):
        said = "no sticking stem was found: there is none for the complementarity program to start from"
        return replace(plain, reasons=(*plain.reasons, said))
    from workbench.estimate.methods.complementarity import solved, warm

    n, path = data.samples, paths[0]
    found = solved(data, warm(data, path), limits, math.floor(path.fit.theta + 1e-9), tell=tell)
    point, result, exact = found.point, found.result, found.exact
    taken = result.status.success and exact is not None and exact.fit.sse < (1.0 - BETTER) * path.fit.sse
    program = Complementarity(
        status=result.status,
        iterations=result.iterations,
        residual=result.residual,
        complementarity=result.complementarity,
        d=point.d,
        plant=plant_of(data, point.fit.gain, point.fit.tau, point.fit.theta),
        cost=point.fit.sse / n,
        exact_cost=None if exact is None else exact.fit.sse / n,
        profile_cost=path.fit.sse / n,
        partial=found.partial,
        taken=taken,
    )
    answer = plain
    if taken and exact is not None:
        fit = grounded(data, exact.x, exact.first, exact.fit, exact.bounds)
        errors = standard_errors(data, exact.x, exact.first, exact.fit, clamped=False)
        errors = unsure(data, errors, exact.fit, exact.valve.stick_band)
        ranges = _ranges(data, plain, exact, [path.fit, exact.fit], errors, limits)
        prediction = predict(data, exact.x, exact.first, fit)[0]
        answer = _along(data, plain, exact, fit, prediction, ranges, 2 * len(plain.load_steps))
    return replace(answer, reasons=(*plain.reasons, _said(program)), complementarity=program)


def _ranges(
    data: Centred,
    plain: Estimate,
    path: Path,
    fits: list[Fit],
    errors: tuple[float, float, float],
    limits: Limits,
) -> Intervals:
    """The ranges of fits, and of the valve the profile's with the path's; none where the profile's own has none."""
    known = plain.intervals
    if known == Intervals():
        return known
    S, J = path.valve.stick_band, path.valve.slip_jump
    ranges = ranges_of(data, fits, errors, _with(data, known.d, path.d), limits.theta[1])
    return replace(ranges, S=_with(data, known.S, (S, S)), J=_with(data, known.J, (J, J)))


def _said(program: Complementarity) -> str:
    """What the program found and what it is worth, in words."""
    ended = f"the complementarity program ended as {program.status.value}"
    if not program.status.success:
        return f"{ended}: the profile's own fit is shown"
    claim = f"{ended} at d = {given(program.d, 4)} % and claims to leave {given(program.cost, 4)} EU²"
    if program.partial:
        claim += f", its stem moving part of the way in {program.partial} samples, which no such valve does"
    if program.exact_cost is None:
        return f"{claim}; by the valve's own law the stem would not move at all: the profile's own fit is shown"
    exact, profile = given(program.exact_cost, 4), given(program.profile_cost, 4)
    verified = f"by the valve's own law that d leaves {exact}, the profile {profile}"
    shown = "its better fit is shown" if program.taken else "the profile's own fit is shown"
    return f"{claim}; {verified}: {shown}"


def _along(
    data: Centred,
    plain: Estimate,
    path: Path,
    fit: Fit,
    deviation: FloatArray,
    ranges: Intervals,
    more: int,
) -> Estimate:
    """The estimate with another path and plant. deviation: of PV, as predicted; more: parameters beside the usual."""
    n = data.samples
    prediction = data.pv_mean + data.load + deviation
    position = path.x + data.op_middle
    if path.first > 0 and fit.gain != 0.0:
        position[: path.first] = data.op_middle + fit.start / fit.gain
    left = plain.record.pv - prediction
    sse = float((left**2).sum())
    kind = type(path.valve).__name__.lower() if path.slips else "linear"
    return replace(
        plain,
        plant=plant_of(data, fit.gain, fit.tau, fit.theta),
        valve=path.valve,
        valve_position=position,
        prediction=prediction,
        bias=bias_of(data, fit),
        intervals=ranges,
        residual_variance=sse / n,
        aic=akaike(data, sse, PLANT_PARAMETERS + VALVE_PARAMETERS[kind] - data.integrating + more),
        noise_sd=float(np.sqrt(np.mean(left[data.skip :] ** 2))),
        slips=path.slips,
    )


def _with(
    data: Centred, pair: tuple[float, float] | None, other: tuple[float, float] | None
) -> tuple[float, float] | None:
    """A range of the profile's, %, that holds another too, as far as OP tells that."""
    if pair is None or other is None:
        return pair
    low, high = wider(data, other)
    return min(pair[0], low), max(pair[1], high)
