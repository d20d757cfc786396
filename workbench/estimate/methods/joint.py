"""The joint refinement: plant, bias, drift and load disturbance by one nonlinear program, the stem path held.

`y_k = w_k + bias + drift t_k + n_k`, with w the plant's exact response to the stem (`output_error.oe_columns` holds the
same law) and n what the loop suffers from outside: `n_k = a_1 n_{k-1} + .. + a_p n_{k-p} + e_k`, e white. That is the
Box-Jenkins structure with C = 1 (L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, eq. (4.31)); the
parameters minimise the sum of squares of its one-step prediction errors e (ibid. section 7.2), which is the likelihood
of normal e. In closed loop OP carries past disturbances, so that an output-error fit (p = 0) is biased where they are
coloured (ibid. section 13.4). a follows from partial autocorrelations in (-1, 1), which makes every n stationary (J.
Monahan, "A note on enforcing stationarity in autoregressive-moving average models", Biometrika 71 (1984) 403-404).

All w and e are variables, the plant's steps and the disturbance's are constraints, solved by IPOPT from the profile's
fit. The dead time is
m + f samples. The response has a kink in theta at whole m: f in [0, 1] is free, and m is walked both ways as long as
the fit is alike. A record longer than `LONGEST` gives its most active stretch of that length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, Limits, predict
from workbench.estimate.fits.sureness import score_covariance, sure_samples
from workbench.estimate.search.paths import Path
from workbench.model.record import FloatArray
from workbench.model.results import SolveStatus
from workbench.symbolic.loop import held
from workbench.symbolic.solve import Group, IpoptOptions, Nlp, Solver, Values

__all__ = ["ORDERS", "Refined", "Refinement", "refine"]

ORDERS = 4  # highest order of the disturbance
LONGEST = 5000  # samples in one program; IPOPT takes some 50 ms an iteration for as many
PATIENCE = 2  # orders in a row without a lower BIC, after which higher ones are left out
STATIONARY = 0.998  # largest partial autocorrelation: above it a drift of the loop passes for a disturbance
REACH = 4.0  # of OP's range: how far from its middle a stem that the record does not show may have been
MOVES = 12  # most whole samples by which the dead time moves to either side in one refinement
KINK = 1e-3  # samples: a dead time as near to the end of its range lies at it
ALIKE = 3.841  # 95 %, one degree of freedom
OPTIONS = IpoptOptions(tolerance=1e-8, max_iterations=100, max_wall_time=60.0, barrier=1e-4, push=1e-6, scaling="none")
GAIN, TAU, SHARE, X0, BIAS, W0, DRIFT, PARTIAL = range(8)  # from PARTIAL on the partial autocorrelations
OWN = PARTIAL + ORDERS


@dataclass(frozen=True, eq=False)
class Refined:
    """One refined path: plant and start in `fit`, drift (EU over the record), partial autocorrelations of n.

    sse: of the one-step prediction errors, EU^2.
    """

    path: Path
    fit: Fit
    drift: float
    partial: tuple[float, ...]
    drifts: bool
    sse: float

    @property
    def order(self) -> int:
        """p, the number of coefficients of the disturbance."""
        return len(self.partial)

    @property
    def a(self) -> tuple[float, ...]:
        """The coefficients of the disturbance."""
        return tuple(float(a) for a in _coefficients(list(self.partial)))

    def prediction(self, data: Centred) -> FloatArray:
        """PV's deviation without the disturbance, EU, shape (N,)."""
        return predict(data, self.path.x, self.path.first, self.fit)[0] + self.drift * _clock(data.samples)


@dataclass(frozen=True, eq=False)
class Refinement:
    """The end of a refinement: the best path, those alike it, what was compared, standard errors of the best.

    compared: (order, drifts, BIC) of the models of the disturbance on the first path. errors: of gain, tau and theta
    (samples). drift_error: EU over the record; nan without a drift. innovation_sd: of e, EU. stretch: the samples
    (first, stop) that were used. best is None where no program was solved; its fit is of the whole record.
    """

    best: Refined | None
    alike: tuple[Refined, ...]
    compared: tuple[tuple[int, bool, float], ...]
    errors: tuple[float, float, float]
    drift_error: float
    innovation_sd: float
    stretch: tuple[int, int]
    status: SolveStatus
    iterations: int


def _clock(n: int) -> FloatArray:
    """From -1/2 to 1/2 over the record, so that drift is its change of PV over the record."""
    return np.linspace(-0.5, 0.5, n)


class _Program:
    """The program for records of N samples and one kind of plant, compiled once: path and m are parameters."""

    def __init__(self, data: Centred, limits: Limits) -> None:
        n = data.samples
        self._data, self._limits = data, limits
        self._pv, self._op = math.sqrt(data.variance), data.op_range
        own, w, e = ca.SX.sym("own", OWN), ca.SX.sym("w", n), ca.SX.sym("e", n)
        y, near, far, near_unknown, far_unknown = (ca.SX.sym(name, n) for name in ("y", "near", "far", "g", "h"))
        v = near[:-1] + own[X0] * near_unknown[:-1], far[:-1] + own[X0] * far_unknown[:-1]
        if data.integrating:
            step = own[GAIN] * ((1.0 - own[SHARE]) * v[0] + own[SHARE] * v[1]) + own[DRIFT] / n
            pole, level = ca.SX(1.0), own[BIAS]
        else:
            pole, c0, c1 = held(ca.exp(own[TAU]), own[SHARE])
            step = own[GAIN] * (c0 * v[0] + c1 * v[1])
            level = own[BIAS] + own[DRIFT] * ca.DM(_clock(n))
        left = y - w - level
        partial = [own[PARTIAL + i] for i in range(ORDERS)]
        foretold = left[ORDERS:]
        for i, a in enumerate(_coefficients(partial)):
            foretold = foretold - a * left[ORDERS - 1 - i : n - 1 - i]
        first = [
            scale * (left[k] - sum(a * left[k - 1 - i] for i, a in enumerate(past)))
            for k, (scale, past) in enumerate(_beginning(partial))
        ]
        foretold = ca.vertcat(*first, foretold)
        law = Group("law", ca.vertcat(w[0] - own[W0], w[1:] - pole * w[:-1] - step, e - foretold))
        self._solver = Solver(
            Nlp(
                x=ca.vertcat(own, w, e),
                objective=ca.sumsqr(e) / n,
                groups=(law,),
                parameters=ca.vertcat(y, near, far, near_unknown, far_unknown),
            ),
            OPTIONS,
        )
        self.iterations = 0
        self.status = SolveStatus.SOLVED

    def solve(self, like: Refined, order: int, drifts: bool, *, widely: bool = False) -> list[Refined]:
        """The solutions for a disturbance of this order, from `like` on, one for each m tried; the best first.

        m moves on where f ends at a limit; widely: also where it does not, as far as the fit stays alike.
        """
        last = math.floor(self._limits.theta[1] + 1e-9)
        m = min(math.floor(like.fit.theta + 1e-9), last)
        middle = self._at(m, like, order, drifts)
        if middle is None:
            return []
        found = [middle]
        for way in (1, -1):
            at = middle
            for beside in range(m + way, m + way * (MOVES + 1), way):
                end = at.fit.theta - beside if way > 0 else beside + 1.0 - at.fit.theta
                if not 0 <= beside <= last or not (widely or end > -KINK):
                    break
                other = self._at(beside, at, order, drifts)
                if other is None:
                    break
                found.append(other)
                if _level(self._data, other) > _most(self._data, found):
                    break
                at = other
        return sorted(found, key=lambda r: r.sse)

    def _at(self, m: int, like: Refined, order: int, drifts: bool) -> Refined | None:
        data, path, n = self._data, like.path, self._data.samples
        fit = replace(like.fit, theta=min(max(like.fit.theta, float(m)), min(m + 1.0, self._limits.theta[1])))
        integrating = data.integrating
        x0 = fit.start / fit.gain if fit.gain != 0.0 else 0.0
        low, high = (max(path.bounds[0], -REACH * self._op), min(path.bounds[1], REACH * self._op))
        x0 = min(max(x0, low), high)
        w = predict(data, path.x, path.first, replace(fit, start=fit.gain * x0))[0] - (0.0 if integrating else fit.bias)
        start = np.zeros(OWN)
        start[GAIN], start[SHARE], start[X0] = fit.gain * self._op / self._pv, fit.theta - m, x0 / self._op
        start[TAU] = 0.0 if integrating else math.log(fit.tau)
        start[BIAS] = 0.0 if integrating else fit.bias / self._pv
        start[W0] = w[0] / self._pv
        start[DRIFT] = (fit.transient * n if integrating else like.drift) / self._pv
        start[PARTIAL : PARTIAL + min(like.order, order)] = like.partial[:order]
        size = OWN + 2 * n
        lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
        lower[TAU], upper[TAU] = (math.log(t) for t in self._limits.tau)
        lower[SHARE], upper[SHARE] = 0.0, min(1.0, self._limits.theta[1] - m)
        lower[X0], upper[X0] = low / self._op, high / self._op
        lower[PARTIAL:OWN], upper[PARTIAL:OWN] = -STATIONARY, STATIONARY
        if data.sign > 0.0:
            lower[GAIN] = 0.0
        elif data.sign < 0.0:
            upper[GAIN] = 0.0
        held = list(range(PARTIAL + order, OWN))
        held += [TAU, BIAS] if integrating else [DRIFT] * (not drifts)
        for i in held:
            start[i] = lower[i] = upper[i] = start[i] if i == TAU else 0.0
        start = np.clip(start, lower[:OWN], upper[:OWN])
        level = 0.0 if integrating else fit.bias + like.drift * _clock(n)
        e = _whitened(data.y - w - level, like.partial[:order])
        found = self._solver.solve(
            Values(
                start=np.concatenate([start, w / self._pv, e / self._pv]),
                parameters=np.concatenate([data.y / self._pv, *self._inputs(path, m)]),
                lower=lower,
                upper=upper,
            )
        )
        self.iterations += found.iterations
        self.status = found.status
        if found.status is SolveStatus.INTERRUPTED:
            raise KeyboardInterrupt
        if not found.status.success:
            return None
        return self._read(found.x[:OWN], path, m, order, drifts)

    def _inputs(self, path: Path, m: int) -> list[FloatArray]:
        """The stem, of OP's range, m and m + 1 samples ago, and where it is the unknown x0."""
        parts = []
        for delay in (m, m + 1):
            known = np.arange(self._data.samples) - delay >= path.first
            shifted = np.concatenate([np.zeros(delay), path.x])[: known.size]
            parts.append((np.where(known, shifted / self._op, 0.0), (~known).astype(np.float64)))
        return [parts[0][0], parts[1][0], parts[0][1], parts[1][1]]

    def _read(self, own: FloatArray, path: Path, m: int, order: int, drifts: bool) -> Refined:
        pv, n = self._pv, self._data.samples
        values = own.tolist()
        gain = values[GAIN] * pv / self._op
        start = gain * values[X0] * self._op
        level = values[W0] * pv
        drift = values[DRIFT] * pv
        share = min(max(values[SHARE], 0.0), 1.0)
        if self._data.integrating:
            fit = Fit(math.nan, 1.0, m + share, gain, level, start, drift / n)
            drift = 0.0
        else:
            fit = Fit(math.nan, math.exp(values[TAU]), m + share, gain, values[BIAS] * pv, start, level - start)
        found = Refined(path, fit, drift, tuple(values[PARTIAL : PARTIAL + order]), drifts, math.nan)
        e = _innovations(self._data, found)
        return replace(found, sse=float(e @ e))


def _innovations(data: Centred, found: Refined) -> FloatArray:
    """The one-step prediction errors, EU, shape (N,), recomputed by the kernel's law and not taken from IPOPT."""
    return _whitened(data.y - found.prediction(data), found.partial)


def _coefficients(partial: list[Any]) -> list[Any]:
    """The coefficients a of partial autocorrelations (numbers or symbols), by the recursion of Durbin and Levinson."""
    a: list[Any] = []
    for r in partial:
        a = [a[i] - r * a[-1 - i] for i in range(len(a))] + [r]
    return a


def _beginning(partial: Sequence[Any]) -> Iterator[tuple[Any, list[Any]]]:
    """(scale, coefficients) by which the samples 0, 1, .. are foretold that have less than p before them.

    The best prediction from k samples has the coefficients of the first k partial autocorrelations, and an error larger
    than e by the rest of them (G. Box, G. Jenkins, Time Series Analysis, 1970, appendix A7.5).
    """
    for k in range(len(partial)):
        scale: Any = 1.0
        for r in partial[k:]:
            scale = scale * (1.0 - r * r) ** 0.5
        yield scale, _coefficients(list(partial[:k]))


def _whitened(signal: FloatArray, partial: tuple[float, ...]) -> FloatArray:
    """What of a signal of shape (N,) the disturbance's model does not foretell, shape (N,)."""
    out: FloatArray = np.convolve(signal, [1.0, *(-a for a in _coefficients(list(partial)))])[: signal.size]
    for k, (scale, past) in enumerate(_beginning(partial)):
        out[k] = scale * (signal[k] - sum(a * signal[k - 1 - i] for i, a in enumerate(past)))
    return out


def _level(data: Centred, found: Refined) -> float:
    """The mean square of e, EU^2, at least what the record resolves."""
    return max(found.sse / data.samples, data.floor)


def _most(data: Centred, found: list[Refined]) -> float:
    """The largest mean square of e, EU^2, within the 95 % likelihood region of the best."""
    best = min(found, key=lambda r: r.sse)
    n = float(data.samples)
    if best.path.slips:
        n = sure_samples(data, best.path.x, best.path.first, n)
    return _level(data, best) * math.exp(ALIKE / n)


def _bic(data: Centred, found: Refined) -> float:
    """`N log V + p log N` over what models of the same path differ in: order and drift."""
    n = data.samples
    return n * math.log(_level(data, found)) + (found.order + found.drifts) * math.log(n)


def refine(data: Centred, paths: list[Path], limits: Limits, tell: Callable[[float], None]) -> Refinement:
    """Refine the plant on each path, the first being the likeliest; choose order and drift by BIC, then the path.

    limits: of tau and theta, samples. tell: called with the share done. Raises KeyboardInterrupt where interrupted.
    """
    if data.samples > LONGEST:
        first = _most_active(data)
        cut = [_cut(data, path, first) for path in paths]
        used = data.part(first, first + LONGEST)
        found = _refined(used, cut, limits, tell)
        whole = {id(part): path for part, path in zip(cut, paths, strict=True)}
        best = None if found.best is None else _over(data, found.best, whole[id(found.best.path)])
        return replace(found, best=best, stretch=(first, first + LONGEST))
    return _refined(data, paths, limits, tell)


def _most_active(data: Centred) -> int:
    """The first sample of the stretch of `LONGEST` in which OP ranges and PV varies the most."""
    last = data.samples - LONGEST
    begins: list[int] = sorted({*range(0, last, LONGEST // 2), last})

    def activity(begin: int) -> float:
        part = slice(begin, begin + LONGEST)
        return float(np.ptp(data.u[part])) / data.op_range + float(np.std(data.y[part])) / math.sqrt(data.variance)

    return max(begins, key=activity)


def _cut(data: Centred, path: Path, first: int) -> Path:
    """The path within a stretch, with the fit as it stands at the stretch's start."""
    at = float(predict(data, path.x, path.first, path.fit)[0][first])
    slips = max(path.first - first, 0)
    x = path.x[first : first + LONGEST]
    fit = path.fit
    start = fit.gain * float(x[0]) if slips == 0 else fit.start
    fit = (
        replace(fit, start=start, bias=at)
        if data.integrating
        else replace(fit, start=start, transient=at - fit.bias - start)
    )
    bounds = path.bounds if slips > 0 else (-math.inf, math.inf)
    return replace(path, x=x, first=min(slips, LONGEST), bounds=bounds, fit=fit)


def _over(data: Centred, found: Refined, path: Path) -> Refined:
    """A stretch's plant over the whole record, its bias, start and transient there by least squares."""
    columns = predict(data, path.x, path.first, found.fit)[1]
    rest = columns[[0, 2, 3]]
    terms, *_ = np.linalg.lstsq(rest.T, data.y - found.fit.gain * columns[1], rcond=None)
    bias, start, transient = terms.tolist()
    return replace(found, path=path, fit=replace(found.fit, bias=bias, start=start, transient=transient))


def _refined(data: Centred, paths: list[Path], limits: Limits, tell: Callable[[float], None]) -> Refinement:
    """As `refine`, for a record that one program holds."""
    program = _Program(data, limits)
    blank = [Refined(p, p.fit, 0.0, (), False, math.inf) for p in paths]
    total = 3 + ORDERS + len(paths)
    done = 0

    def solved(like: Refined, order: int, drifts: bool, *, widely: bool = False) -> list[Refined]:
        nonlocal done
        found = program.solve(like, order, drifts, widely=widely)
        done += 1
        tell(done / total)
        return found

    def bic(found: list[Refined]) -> float:
        return _bic(data, found[0])

    tried: list[list[Refined]] = []
    like = blank[0]
    for order in range(ORDERS + 1):
        found = solved(_coloured(data, like, order), order, False)
        if found:
            tried.append(found)
            like = found[0]
        if len(tried) > PATIENCE and min(map(bic, tried[-PATIENCE:])) > min(map(bic, tried[:-PATIENCE])):
            break
    if tried and not data.integrating and data.samples < LONGEST:
        best = min(tried, key=bic)[0]
        found = solved(best, best.order, True)
        tried += [found] if found else []
    compared = tuple((r[0].order, r[0].drifts, bic(r)) for r in tried)
    if not tried:
        nothing = (math.nan, math.nan, math.nan)
        span = (0, data.samples)
        return Refinement(None, (), compared, nothing, math.nan, math.nan, span, program.status, program.iterations)
    refined = min(tried, key=bic)
    best = refined[0]
    refined = [*refined, *solved(best, best.order, best.drifts, widely=True)]
    for other in blank[1:]:
        refined += [
            r
            for r in solved(replace(other, partial=best.partial, drift=best.drift), best.order, best.drifts)
            if r.fit.gain != 0.0
        ]
    best = min(refined, key=lambda r: r.sse)
    most = _most(data, refined)
    alike = tuple(r for r in refined if _level(data, r) <= most)
    errors, drift_error = _errors(data, best)
    tell(1.0)
    return Refinement(
        best=best,
        alike=alike,
        compared=compared,
        errors=errors,
        drift_error=drift_error,
        innovation_sd=math.sqrt(best.sse / data.samples),
        stretch=(0, data.samples),
        status=SolveStatus.SOLVED,
        iterations=program.iterations,
    )


def _coloured(data: Centred, like: Refined, order: int) -> Refined:
    """The same plant with the disturbance that its residuals show, as a start: Burg's partial autocorrelations.

    J.P. Burg, "Maximum entropy spectral analysis", 37th meeting of the Society of Exploration Geophysicists, 1967.
    """
    forward = data.y - like.prediction(data)
    backward = forward
    partial = []
    for _ in range(order):
        ahead, behind = forward[1:], backward[:-1]
        power = float(ahead @ ahead + behind @ behind)
        r = 2.0 * float(ahead @ behind) / power if power > 0.0 else 0.0
        partial.append(float(np.clip(r, -0.95, 0.95)))
        forward, backward = ahead - r * behind, behind - r * ahead
    return replace(like, partial=tuple(partial))


def _errors(data: Centred, found: Refined) -> tuple[tuple[float, float, float], float]:
    """Standard errors of (gain, tau, theta) and of the drift from the Fisher information of the prediction errors.

    `P = V (sum psi psi')^-1` with psi the derivative of the prediction (Ljung, 2nd ed., section 9.4): the response's
    own, by differences for tau and theta, and the residuals' past for a. Where it is larger, the error that allows for
    what is left of autocorrelation in e (`score_covariance`). nan where the record does not say.
    """
    path, fit = found.path, found.fit
    _, columns = predict(data, path.x, path.first, fit)
    low, high = path.bounds
    x0 = fit.start / fit.gain if fit.gain != 0.0 else math.nan
    free = low + 1e-6 * data.op_range < x0 < high - 1e-6 * data.op_range
    vectors = {"gain": columns[1] if free else columns[1] + x0 * columns[2], "bias": columns[0]}
    if free:
        vectors["start"] = columns[2]
    vectors["transient"] = columns[3]
    for name, step in (("tau", 1e-3 * fit.tau), ("theta", 1e-2)):
        if name == "tau" and data.integrating:
            continue
        value = getattr(fit, name)
        up, down = value + step, max(value - step, 0.0)
        ends = [predict(data, path.x, path.first, replace(fit, **{name: v}))[0] for v in (up, down)]
        vectors[name] = (ends[0] - ends[1]) / (up - down)
    if found.drifts:
        vectors["drift"] = _clock(data.samples)
    left = data.y - found.prediction(data)
    rows = {name: _whitened(vector, found.partial) for name, vector in vectors.items()}
    for i in range(found.order):
        rows[f"a{i + 1}"] = np.concatenate([np.zeros(i + 1), left[: -1 - i]])
    jacobian = np.array(list(rows.values()))
    scale = np.sqrt((jacobian**2).sum(axis=1))
    kept = scale > 0.0
    names = [name for name, k in zip(rows, kept.tolist(), strict=True) if k]
    jacobian = jacobian[kept] / scale[kept, None]
    inverse = np.linalg.pinv(jacobian @ jacobian.T, rcond=1e-12, hermitian=True)
    power = found.sse / max(data.samples - len(names), 1) + data.floor
    robust = inverse @ score_covariance(jacobian, _innovations(data, found)) @ inverse
    spread = np.sqrt(np.maximum(np.diag(inverse) * power, np.diag(robust))) / scale[kept]
    told = dict(zip(names, spread.tolist(), strict=True))
    gain, tau, theta, drift = (told.get(name, math.nan) for name in ("gain", "tau", "theta", "drift"))
    return (gain, tau, theta), drift
