"""The few stem paths that the search found likeliest, as the joint refinement takes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, start_range
from workbench.estimate.search.bands import Bands
from workbench.estimate.search.candidates import Candidate
from workbench.estimate.search.profile import Profile
from workbench.estimate.search.two_parameter import Band, held_range
from workbench.estimate.search.uneven import Uneven, differing
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman, Valve

__all__ = ["Path", "band_paths", "linear_path", "stem_paths", "uneven_paths"]

MOST = 6  # paths that are refined


@dataclass(frozen=True, eq=False)
class Path:
    """A stem path to refine the plant on: x (centred, %, shape (N,)), 0 before `first`; x0 there, within bounds.

    valve: whose path it is. fit: where the refinement starts. slips: the stem's moves. d: the range of a one-parameter
    valve's d in which the path holds, %. even: whether it sticks alike at every slip.
    """

    valve: Valve
    x: FloatArray
    first: int
    bounds: tuple[float, float]
    fit: Fit
    slips: int
    d: tuple[float, float] | None = None
    even: bool = True


def linear_path(data: Centred, linear: Fit) -> list[Path]:
    """Return OP itself as the stem."""
    return [Path(Ideal(), data.u, 0, (-math.inf, math.inf), linear, 0)]


def stem_paths(data: Centred, found: Profile) -> list[Path]:
    """Return the best path, the ends of the range of d that fits as well, and the next best fits."""
    alike = sorted(found.alike, key=lambda c: c.d)
    chosen: list[Candidate] = []
    for c in (found.best, alike[0], alike[-1], *sorted(found.fits, key=lambda c: c.fit.sse)):
        known = any(c.first == k.first and c.d_low == k.d_low for k in chosen)
        if not known and c.fit.gain != 0.0 and len(chosen) < MOST:
            chosen.append(c)
    return [
        Path(
            valve=Stenman(c.d),
            x=c.stem(data.u),
            first=c.first,
            bounds=start_range(data.u, c.first, c.d_low, c.d_high),
            fit=c.fit,
            slips=c.slips,
            d=(c.d_low, c.d_high),
        )
        for c in chosen
    ]


def band_paths(data: Centred, found: Bands, name: str) -> list[Path]:
    """Return the best two-parameter path ("deadband" or "choudhury"), the ends of the range of S, and the next best."""
    alike = sorted((b for b in found.alike if b.fit.gain != 0.0), key=lambda b: b.S)
    chosen: list[Band] = []
    for b in (found.best, *alike[:1], *alike[-1:], *sorted(alike, key=lambda b: b.fit.sse)):
        if not any((b.S, b.J, b.first) == (k.S, k.J, k.first) for k in chosen) and len(chosen) < MOST:
            chosen.append(b)
    paths = []
    for b in chosen:
        valve = Deadband(b.S) if name == "deadband" else Choudhury(b.S, b.J)
        paths.append(Path(valve, b.stem(data.u), b.begin, held_range(data.u, b), b.fit, b.slips))
    return paths


def uneven_paths(found: Sequence[Uneven]) -> list[Path]:
    """Return the likeliest stems that do not stick alike at every slip and differ in where they slip."""
    return [
        Path(one.valve, one.x, one.first, one.bounds, one.fit, one.slips, even=False) for one in differing(found, MOST)
    ]
