"""Where L(jw) meets the locus -1/N(A), and how far apart they stay where they do not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.spatial import cKDTree

from workbench.analyze.valve_loci import Piece
from workbench.model.record import FloatArray

__all__ = ["Approach", "Meeting", "closest_approach", "first_meeting", "meetings"]

ComplexArray = NDArray[np.complex128]
Response = Callable[[FloatArray], ComplexArray]


@dataclass(frozen=True, slots=True)
class Meeting:
    """A crossing: amplitude (%), frequency (rad/s), N there, and whether a cycle there is stable."""

    amplitude: float
    frequency: float
    N: complex
    stable: bool


@dataclass(frozen=True, slots=True)
class Approach:
    """The least |L - locus|, and the amplitude (%) and frequency (rad/s) at which it is reached."""

    distance: float
    amplitude: float
    frequency: float


def meetings(response: Response, frequencies: FloatArray, pieces: tuple[Piece, ...]) -> tuple[Meeting, ...]:
    """Return every crossing of L (`response` of w, on the grid `frequencies`, rad/s) with a locus, by amplitude.

    Both curves are taken as polylines in the plane of log magnitude and phase, where they are evenly resolved from very
    low to very high gain; every crossing of two segments is then refined to `|1 + N L| < 1e-9`.
    """
    frequencies, L = _seen(response, frequencies)
    found: list[Meeting] = []
    if not pieces or not L.size or not L.all():
        return ()
    for piece in pieces:
        for t, w in _polyline_crossings(L, frequencies, piece):
            met = _refined(response, piece, t, w)
            if met is not None and met.frequency <= frequencies[-1] * (1.0 + 1e-9) and not _known(met, found):
                found.append(met)
    return tuple(sorted(found, key=lambda met: met.amplitude))


def _seen(response: Response, frequencies: FloatArray) -> tuple[FloatArray, ComplexArray]:
    """Return the frequencies at which L is no larger than numbers can be, and L there."""
    L = response(frequencies)
    there = np.isfinite(L)
    return frequencies[there], L[there]


def _known(met: Meeting, found: list[Meeting]) -> bool:
    return any(
        abs(met.amplitude - other.amplitude) < 1e-6 * met.amplitude
        and abs(met.frequency - other.frequency) < 1e-6 * met.frequency
        for other in found
    )


def _polyline_crossings(L: ComplexArray, w: FloatArray, piece: Piece) -> list[tuple[float, float]]:
    """(t, w) of the crossings of both curves' segments, linearly interpolated."""
    locus = -1.0 / piece.N(piece.amplitude(piece.points))
    # Phases of a locus lie about -90 .. -270 degrees: cutting at 0 leaves every curve whole where it matters.
    b = np.column_stack([np.log(np.abs(locus)), _phase(locus)])
    a = np.column_stack([np.log(np.abs(L)), _phase(L)])
    step = np.diff(a, axis=0)
    step[:, 1] = np.remainder(step[:, 1] + math.pi, 2.0 * math.pi) - math.pi
    low, high = b.min(axis=0), b.max(axis=0)
    ends = a[:-1] + step
    near = np.flatnonzero(
        ((np.minimum(a[:-1], ends) <= high + 1e-9) & (np.maximum(a[:-1], ends) >= low - 1e-9)).all(axis=1)
    )
    if near.size == 0:
        return []
    p, r = a[near][:, None, :], step[near][:, None, :]
    q, s = b[None, :-1, :], np.diff(b, axis=0)[None, :, :]
    cross = r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]
    gap = q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (gap[..., 0] * s[..., 1] - gap[..., 1] * s[..., 0]) / cross
        across = (gap[..., 0] * r[..., 1] - gap[..., 1] * r[..., 0]) / cross
    slack = 1e-6
    hit = (along >= -slack) & (along <= 1.0 + slack) & (across >= -slack) & (across <= 1.0 + slack)
    crossings = []
    for i, j in np.argwhere(hit):
        k = near[i]
        t = piece.points[j] + across[i, j] * (piece.points[j + 1] - piece.points[j])
        crossings.append((float(t), float(w[k] * (w[k + 1] / w[k]) ** along[i, j])))
    return crossings


def _phase(z: ComplexArray) -> FloatArray:
    phase: FloatArray = np.remainder(np.angle(z), 2.0 * math.pi) - 2.0 * math.pi
    return phase


def _refined(response: Response, piece: Piece, t: float, w: float) -> Meeting | None:
    def gap(at: FloatArray) -> FloatArray:
        A, frequency = piece.amplitude(at[:1]), np.exp(at[1:])
        product = complex((-response(frequency) * piece.N(A))[0])
        # Outside the piece N is held constant, so that no root lies there.
        return np.array([math.log(max(abs(product), 1e-300)), math.atan2(product.imag, product.real)])

    solved = optimize.root(gap, np.array([t, math.log(w)]), tol=1e-13)
    t, log_w = (float(value) for value in solved.x)
    if float(np.abs(gap(np.array([t, log_w]))).max()) > 1e-9 or not -1e-9 <= t <= 1.0 + 1e-9:
        return None
    t = min(max(t, 0.0), 1.0)
    A = float(piece.amplitude(np.array([t]))[0])
    frequency = math.exp(log_w)
    return Meeting(A, frequency, complex(piece.N(np.array([A]))[0]), _stable(response, piece, t, frequency))


def _stable(response: Response, piece: Piece, t: float, w: float) -> bool:
    """Loeb's reading of the Nyquist criterion: growing amplitude must lead to the left of L's direction.

    What lies to the right of L is encircled, and there the amplitude grows.
    """
    h = 1e-6
    L = response(w * np.array([1.0 - h, 1.0 + h]))
    ends = np.clip(np.array([t - h, t + h]), 0.0, 1.0)
    locus = -1.0 / piece.N(piece.amplitude(ends))
    along, across = L[1] - L[0], locus[1] - locus[0]
    return bool((along.conjugate() * across).imag > 0.0)


def first_meeting(response: Response, frequencies: FloatArray, pieces: tuple[Piece, ...]) -> float:
    """Return the least factor on L at which it meets a locus, inf where no factor makes it meet.

    A factor shifts L along log magnitude alone, so that it is the least gap of both curves at equal phase. Both are
    taken as the polylines of `meetings`; the factor is right to about their resolution (1e-4).
    """
    _, L = _seen(response, frequencies)
    a = np.column_stack([np.log(np.abs(L)), _phase(L)])
    least = math.inf
    for piece in pieces:
        locus = -1.0 / piece.N(piece.amplitude(piece.points))
        b = np.column_stack([np.log(np.abs(locus)), _phase(locus)])
        least = min(least, _least_gap(a, b, 1.0), _least_gap(b, a, -1.0))
    with np.errstate(over="ignore"):
        return float(np.exp(least))


def _least_gap(points: FloatArray, line: FloatArray, sign: float) -> float:
    """Least `sign` (line - point) in log magnitude over the points whose phase a segment of the line spans."""
    begin, step = line[:-1], np.diff(line, axis=0)
    # Segments over the cut at phase 0 lie far from every locus.
    whole = np.flatnonzero(np.abs(step[:, 1]) < math.pi)
    low = np.minimum(begin[whole, 1], begin[whole, 1] + step[whole, 1])
    high = np.maximum(begin[whole, 1], begin[whole, 1] + step[whole, 1])
    i, j = np.nonzero((points[:, None, 1] >= low) & (points[:, None, 1] <= high))
    if i.size == 0:
        return math.inf
    j = whole[j]
    along = np.divide(points[i, 1] - begin[j, 1], step[j, 1], out=np.zeros(i.size), where=step[j, 1] != 0.0)
    gaps = sign * (begin[j, 0] + along * step[j, 0] - points[i, 0])
    return float(gaps.min())


def closest_approach(response: Response, frequencies: FloatArray, pieces: tuple[Piece, ...]) -> Approach:
    """Return where L comes closest to any piece of the locus: the nearest grid points, then refined within the piece.

    Works with no frequency at which L is 0 as well: the locus' own distance from 0 then. Where one of the curves is
    nowhere within what numbers can be, the distance is inf and its place nan.
    """
    frequencies, L = _seen(response, frequencies)
    best_found = Approach(math.inf, math.nan, math.nan)
    if not L.size:
        return best_found
    # In units of an L that is large everywhere, so that no square of what lies near the locus overflows.
    unit = max(1.0, float(np.abs(L).min()))
    tree = cKDTree(np.column_stack([L.real, L.imag]) / unit)
    starts: list[tuple[float, Piece, float, float]] = []
    for piece in pieces:
        locus = -1.0 / piece.N(piece.amplitude(piece.points))
        there = np.isfinite(locus)
        if not there.any():
            continue  # of a stick band that is next to no number
        found = tree.query(np.column_stack([locus[there].real, locus[there].imag]) / unit)
        gaps, nearest = np.asarray(found[0]), np.asarray(found[1])
        best = int(np.argmin(gaps))
        starts.append((float(gaps[best]), piece, float(piece.points[there][best]), float(frequencies[nearest[best]])))
    starts.sort(key=lambda start: start[0])
    low, high = np.array([0.0, math.log(frequencies[0])]), np.array([1.0, math.log(frequencies[-1])])
    for grid_gap, piece, t, w in starts[:4]:

        def gap(at: FloatArray, piece: Piece = piece) -> FloatArray:
            between = (response(np.exp(at[1:])) + 1.0 / piece.N(piece.amplitude(at[:1]))) / unit
            return np.concatenate([between.real, between.imag])

        start = np.clip(np.array([t, math.log(w)]), low + 1e-9, high - 1e-9)
        solved = optimize.least_squares(gap, start, bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-12)
        value, at = float(np.hypot(*solved.fun)), np.asarray(solved.x, dtype=np.float64)
        if value > grid_gap:
            value, at = grid_gap, start
        if value * unit < best_found.distance:
            best_found = Approach(value * unit, float(piece.amplitude(at[:1])[0]), math.exp(float(at[1])))
    return best_found
