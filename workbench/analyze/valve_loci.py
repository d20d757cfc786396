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

from workbench.errors import InvalidValue
from workbench.model.karnopp import Karnopp
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Deadband, Directional, He, Kano, Positional, Stenman, Valve

__all__ = ["Piece", "directional_response", "locus_pieces", "no_locus", "staircase_response", "two_parameter_response"]

ComplexArray = NDArray[np.complex128]

# Stairs above the mean up to which a staircase's locus is drawn stair by stair: its ripple about -1 (He: about the
# dead band's locus) has then fallen below a tenth (about a hundredth).
STAIRS = 20


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


def directional_response(A: FloatArray, valve: Directional) -> ComplexArray:
    """Return N(A), shape (M,), of a stem whose friction differs by direction; 0 where A (%) moves it one way only.

    It follows o_u behind u upward and o_d downward (`(S - J)/2` of each way), and slips at leads b_u and b_d
    (`(S + J)/2`); the top reversal swallows `S_t = o_u + b_d`, the bottom one `S_b = o_d + b_u`. But for a constant,
    each half of its answer is that of a symmetric stem with the offset `(o_u + o_d)/2`, so that N is the mean of the
    closed forms for S_t and S_b with that offset. Moves from `A = max(S_t, S_b)/2` on.
    """
    up, down = valve.up, valve.down
    offsets = (up.stick_band - up.slip_jump + down.stick_band - down.slip_jump) / 2.0
    halves = [two_parameter_response(A, S, S - offsets) for S in valve.swallowed]
    N: ComplexArray = np.where(np.asarray(A) >= 0.5 * max(valve.swallowed), 0.5 * (halves[0] + halves[1]), 0.0)
    return N


def staircase_response(A: FloatArray, step: float, lag: float = 0.0, *, between: bool) -> ComplexArray:
    """Return N(A), shape (M,), of a stem that sticks at once, by the exact integrals of its staircase; 0 at rest.

    step, lag: %; Stenman's d and 0, He's fs - fd and fd. In continuous time a slip happens at `|u - x| = step + lag`
    and lands `lag` behind u, so that the stem keeps to stairs one step apart. Which stairs depends on the start; two of
    the answers have no mean: stairs at 0, +-step, .. (`between` false: the answer from rest; it moves from A = step +
    lag on) and at +-step/2, +-3step/2, .. (`between` true: the input's mean lies between two stairs, as a loop with
    integral action settles it; from A = step/2 + lag on). With v over all stairs but the lowest, each reached upward at
    u = v + lag and, mirrored, downward: `N A = (2 step/pi) sum_v [sqrt(1 - c^2) - j c]`, `c = (v + lag)/A`.
    """
    A = np.asarray(A, dtype=np.float64)
    half = 0.5 if between else 0.0
    top = np.floor((A - lag) / step + half).astype(np.int64)  # stairs above the mean
    N = np.zeros(A.shape, np.complex128)
    for n in np.unique(top[top > 0]).tolist():
        v = step * (np.arange(-n + (2 if between else 1), n + 1) - half) + lag
        a = A[top == n]
        ratio = np.minimum(v / a[:, None], 1.0)
        N[top == n] = 2.0 * step / (math.pi * a) * (np.sqrt(1.0 - ratio**2) - 1j * ratio).sum(axis=1)
    return N


def no_locus(valve: Valve) -> str:
    """Return why a valve has no describing function, in words; empty for one that has."""
    if isinstance(valve, Positional):
        return "no describing function: its answer depends on where along the travel it is moved"
    if isinstance(valve, Karnopp):
        return "no describing function here: its answer depends on speed as well as amplitude"
    return ""


def locus_pieces(valve: Valve) -> tuple[Piece, ...]:
    """Return the continuous pieces of a valve's locus -1/N(A), none for a valve without friction.

    Two-parameter valves and dead band: one piece, from A = S/2 (just above it where J = 0, as the locus is infinite
    there) to 10,000 S. Stenman and He: the stairs either side of the mean first, then those with one at the mean (see
    `staircase_response`), each cut where A reaches another stair, up to 20 stairs; He's then goes on, to 10,000 S, as
    the locus of a dead band of S, about which its stairs ripple. Raises `InvalidValue` where `no_locus` gives a reason.
    """
    if no_locus(valve):
        allowed = f"has {no_locus(valve)}; wb.limit_cycle tells exactly what the loop does"
        raise InvalidValue("Loop.valve", type(valve).__name__, allowed)
    S, J = valve.stick_band, valve.slip_jump
    if S == 0.0 and J == 0.0:
        return ()
    if isinstance(valve, Stenman | He) and J > 0.0:
        lag = valve.fd if isinstance(valve, He) else 0.0
        stairs = [_stairs_piece(J, lag, n, between) for between in (True, False) for n in range(1, STAIRS + 1)]
        return (*stairs, _dead_band_tail(S, lag + (STAIRS + 1.0) * J)) if lag > 0.0 else tuple(stairs)
    if isinstance(valve, Directional):
        low = 0.5 * max(valve.swallowed)
        scale = max(S, valve.up.slip_jump, valve.down.slip_jump)
        return (_smooth_piece(low, scale, lambda A: directional_response(A, valve)),)
    if isinstance(valve, He | Choudhury | Kano | Deadband):
        return (_smooth_piece(0.5 * S, max(S, J), lambda A: two_parameter_response(A, S, J)),)
    return ()


def _smooth_piece(start: float, scale: float, N: Callable[[FloatArray], ComplexArray]) -> Piece:
    low, decades = 1e-7, 11.0

    def amplitude(t: FloatArray) -> FloatArray:
        grown: FloatArray = start + scale * low * 10.0 ** (decades * np.asarray(t, dtype=np.float64))
        return grown

    return Piece(amplitude, N, np.linspace(0.0, 1.0, 600))


def _dead_band_tail(S: float, start: float) -> Piece:
    def amplitude(t: FloatArray) -> FloatArray:
        grown: FloatArray = start * (1e4 * S / start) ** np.asarray(t, dtype=np.float64)
        return grown

    return Piece(amplitude, lambda A: two_parameter_response(A, S, 0.0), np.linspace(0.0, 1.0, 300))


def _stairs_piece(step: float, lag: float, n: int, between: bool) -> Piece:
    start = lag + (step * (n - 0.5) if between else step * n)
    # Just short of the next stair, and (by t squared) dense where the newest stair's root begins.
    length = step * (1.0 - 1e-9)

    def amplitude(t: FloatArray) -> FloatArray:
        t = np.asarray(t, dtype=np.float64)
        A: FloatArray = start * (1.0 + 1e-12) + length * t * np.abs(t)
        return A

    def N(A: FloatArray) -> ComplexArray:
        inside = np.clip(A, start * (1.0 + 1e-12), start + length)
        return staircase_response(inside, step, lag, between=between)

    return Piece(amplitude, N, np.linspace(0.0, 1.0, 80 if n <= 2 else 24))
