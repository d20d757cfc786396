"""The valves' describing functions N(A), and their loci -1/N(A) cut into continuous pieces.

`N(A) = (b1 + j a1)/A` with the stem's fundamental `b1 sin + a1 cos` in the steady answer to the input `A sin(wt)`. All
these laws are rate-independent, so that N does not depend on the frequency. A negative imaginary part is a lag.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Deadband, Stenman, Valve

__all__ = ["Piece", "locus_pieces", "stenman_response", "two_parameter_response"]

ComplexArray = NDArray[np.complex128]

# A staircase's ripple about -1 has fallen below a tenth at this many stick bands.
STENMAN_BANDS = 20


@dataclass(frozen=True, eq=False)
class Piece:
    """One continuous piece of a locus: amplitudes A(t) (%) for t in [0, 1], and N at them.

    `points` grid values of t, ascending. t spreads the amplitudes so that the locus moves evenly where N has a root or
    a pole.
    """

    amplitude: Callable[[FloatArray], FloatArray]
    N: Callable[[FloatArray], ComplexArray]
    points: FloatArray


def two_parameter_response(A: FloatArray, S: float, J: float) -> ComplexArray:
    """Return N(A), shape (M,), of the two-parameter valve for A >= S/2, A > 0 (%); 0 below, where nothing moves.

    With `p = asin((A - S)/A)`: `N = -(P_r - j P_i)/(pi A)`,
    `P_r = A/2 sin 2p - 2A cos p - A(pi/2 + p) + 2(S - J) cos p`,
    `P_i = -3A/2 + A/2 cos 2p + 2A sin p - 2(S - J) sin p`
    (M.A.A.S. Choudhury, N.F. Thornhill, S.L. Shah, Control Eng. Practice 13 (2005) 641-658). It is the answer of a
    stem that has been set moving: from rest in mid-band that needs A > (S + J)/2.
    """
    A = np.asarray(A, dtype=np.float64)
    moves = A >= 0.5 * S
    a = np.where(moves, A, max(S, 1.0))
    p = np.arcsin(np.clip((a - S) / a, -1.0, 1.0))
    P_r = 0.5 * a * np.sin(2.0 * p) - 2.0 * a * np.cos(p) - a * (0.5 * math.pi + p) + 2.0 * (S - J) * np.cos(p)
    P_i = -1.5 * a + 0.5 * a * np.cos(2.0 * p) + 2.0 * a * np.sin(p) - 2.0 * (S - J) * np.sin(p)
    N: ComplexArray = np.where(moves, -(P_r - 1j * P_i) / (math.pi * a), 0.0)
    return N


def stenman_response(A: FloatArray, d: float, *, between: bool) -> ComplexArray:
    """Return N(A), shape (M,), of the one-parameter valve by the exact integrals of its staircase; 0 where it rests.

    In continuous time a slip happens at `|u - x| = d` and lands on u, so that the stem keeps to stairs d apart. Which
    stairs depends on the start; two of the answers have no mean: stairs at 0, +-d, .. (`between` false: the answer from
    rest; it moves from A = d on) and at +-d/2, +-3d/2, .. (`between` true: the input's mean lies between two stairs, as
    a loop with integral action settles it; from A = d/2 on). With v over all stairs but the lowest, each crossed upward
    at u = v and, mirrored, downward: `N A = (2d/pi) sum_v [sqrt(1 - (v/A)^2) - j v/A]`.
    """
    A = np.asarray(A, dtype=np.float64)
    half = 0.5 if between else 0.0
    top = np.floor(A / d + half).astype(np.int64)  # stairs above the mean
    N = np.zeros(A.shape, np.complex128)
    for n in np.unique(top[top > 0]).tolist():
        v = d * (np.arange(-n + (2 if between else 1), n + 1) - half)
        a = A[top == n]
        ratio = np.minimum(v / a[:, None], 1.0)
        N[top == n] = 2.0 * d / (math.pi * a) * (np.sqrt(1.0 - ratio**2) - 1j * ratio).sum(axis=1)
    return N


def locus_pieces(valve: Valve) -> tuple[Piece, ...]:
    """Return the continuous pieces of a valve's locus -1/N(A), none for a valve without friction.

    Two-parameter valve and dead band: one piece, from A = S/2 (just above it where J = 0, as the locus is infinite
    there) to 10,000 S. Stenman: the stairs either side of the mean first, then those with one at the mean (see
    `stenman_response`), each cut where A reaches another stair, up to 20 d.
    """
    if isinstance(valve, Stenman):
        if valve.d == 0.0:
            return ()
        return tuple(
            _stenman_piece(valve.d, n, between) for between in (True, False) for n in range(1, STENMAN_BANDS + 1)
        )
    if isinstance(valve, Choudhury | Deadband):
        S, J = valve.stick_band, valve.slip_jump
        return () if S == 0.0 and J == 0.0 else (_two_parameter_piece(S, J),)
    return ()


def _two_parameter_piece(S: float, J: float) -> Piece:
    scale = max(S, J)
    low, decades = 1e-7, 11.0

    def amplitude(t: FloatArray) -> FloatArray:
        grown: FloatArray = 0.5 * S + scale * low * 10.0 ** (decades * np.asarray(t, dtype=np.float64))
        return grown

    return Piece(amplitude, lambda A: two_parameter_response(A, S, J), np.linspace(0.0, 1.0, 600))


def _stenman_piece(d: float, n: int, between: bool) -> Piece:
    start = d * (n - 0.5) if between else d * n
    # Just short of the next stair, and (by t squared) dense where the newest stair's root begins.
    length = d * (1.0 - 1e-9)

    def amplitude(t: FloatArray) -> FloatArray:
        t = np.asarray(t, dtype=np.float64)
        A: FloatArray = start * (1.0 + 1e-12) + length * t * np.abs(t)
        return A

    def N(A: FloatArray) -> ComplexArray:
        inside = np.clip(A, start * (1.0 + 1e-12), start + length)
        return stenman_response(inside, d, between=between)

    return Piece(amplitude, N, np.linspace(0.0, 1.0, 80 if n <= 2 else 24))
