"""Valves whose stem comes to rest short of OP: the gain that slips to and fro leave open.

Friction in motion, fd, holds a stem back from OP by that much when it rests again after a slip (Q. He et al., see
`model.valve.He`; a stem with mass does so too). Where slips alternate in direction such a stem slips when one that
sticks within d = fs + fd, and lands on OP, does, but by 2 fd less each time, for which a larger gain makes up. Slips
that follow each other in one direction tell the two apart: the next comes as soon as OP has moved by fs - fd.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, Limits, fit_near, fit_path
from workbench.estimate.fits.sureness import effective_samples
from workbench.estimate.fits.windows import EXACT
from workbench.estimate.ranges.freed import Loaded
from workbench.estimate.search.candidates import Candidate
from workbench.estimate.search.profile import CHI_SQUARE
from workbench.estimate.search.uneven import Uneven
from workbench.model.record import FloatArray
from workbench.simulate.compiled import compiled

__all__ = ["resting_short"]

# Friction in motion, as shares of d; at a half the slip jump is nothing.
SHARES = (0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45)
PLAIN = 0.1  # a share at which the direction of the first slip shows
ROUNDS = 2  # of a long record's fits


def resting_short(data: Centred, best: Candidate | Uneven, limits: Limits, loaded: Loaded | None) -> list[Fit]:
    """Return the fits of stems that rest short of OP, with the stick band of a Stenman stem, which PV cannot tell.

    Up to the friction in motion from which on they fit worse: from there on they slip otherwise. loaded: the record
    with its load steps, beside which each stem has its own; those that were found beside the best make up for what it
    does not explain.
    """
    n, fit = data.samples, best.fit
    x = best.x if isinstance(best, Uneven) else best.stem(data.u)
    rival = fit if loaded is None else loaded.fit(x, best.first, fit)
    room = CHI_SQUARE / effective_samples(data, x, best.first, fit)
    most = max(rival.sse / n, data.floor) * math.exp(room) * n
    found: list[Fit] = []
    near = fit
    senses: tuple[float, ...] = (1.0, -1.0)
    for share in SHARES:
        tried = [(_fitted(data, best, share * best.d, sense, limits, near, loaded), sense) for sense in senses]
        near, sense = min(tried, key=lambda one: one[0].sse)
        if max(near.sse, n * data.floor) > most or near.gain * fit.gain <= 0.0:
            break
        senses = (sense,) if share >= PLAIN else senses
        found.append(near)
    return found


def _fitted(
    data: Centred, best: Candidate | Uneven, fd: float, sense: float, limits: Limits, near: Fit, loaded: Loaded | None
) -> Fit:
    """The fit along a stem with friction fd, %, in motion, whose first slip goes in one direction."""
    x: FloatArray = np.empty(data.samples)
    if isinstance(best, Uneven):
        # It slips where PV has it slip.
        x = best.x - fd * _ways(best, sense)
    else:
        _resting_path(data.u, best.d - fd, fd, best.first, sense, x)
    if loaded is not None:
        return loaded.fit(x, best.first, near)
    # Where the stem was before it first slipped is free: its rest range is not that of the one that lands on OP.
    bounds = -math.inf, math.inf
    if data.samples > EXACT:
        return fit_near(data, x, best.first, bounds, limits, near, ROUNDS)
    return fit_path(data, x, best.first, bounds, limits, near.theta, tau=near.tau)


def _ways(best: Uneven, sense: float) -> FloatArray:
    """The direction of the last slip, shape (N,), 0 before the first, which goes in the direction `sense`."""
    moves = np.sign(np.diff(best.x, prepend=0.0))
    moves[best.first] = sense
    last = np.maximum.accumulate(np.where(moves != 0.0, np.arange(moves.size), 0))
    return np.asarray(moves[last])


@compiled
def _resting_path(
    op: NDArray[np.float64], fs: float, fd: float, first: int, sense: float, x: NDArray[np.float64]
) -> None:
    """Write the path of a stem by He's law (%), 0 before `first`, where it slips in the direction `sense`."""
    x[:first] = 0.0
    held = op[first] - sense * fd
    for k in range(first, op.size):
        if abs(op[k] - held) > fs:
            held = op[k] - math.copysign(fd, op[k] - held)
        x[k] = held
