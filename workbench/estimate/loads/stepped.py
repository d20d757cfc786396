"""Stems searched beside a load step: for each stem and plant, the one step that explains most beside them.

A step that nothing explains spoils a search for stems; of a plant that integrates, most of all, whose PV it sends up or
down for the rest of the record. A step's time and size are found for each stem in one pass (`kernels.stepped`),
so that stems, plants and steps are searched together, from a grid on in ever closer ones about its best.

What a wrong slip does to an integrating plant lasts too, and hides the right ones behind it. Such a record is searched
through a filter that forgets, `(1 - z^-1) / (1 - p z^-1)`: an integrator behind it is a plant of the pole p, noise is
hardly more than it was, and only the last grids look at PV itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits
from workbench.estimate.fits.windows import EXACT
from workbench.estimate.kernels.stepped import STRIDE, screen_stepped
from workbench.estimate.loads.steps import Stem
from workbench.estimate.search.stems import firsts_for, path_of, thin
from workbench.estimate.search.two_parameter import NARROWEST, SHARES, WIDEST, band_stem
from workbench.model.record import FloatArray
from workbench.simulate.filter import first_order

__all__ = ["stepped_stems"]

GRID = 110  # values of S looked at
FINER_SHARES = np.arange(0.0, 1.4, 0.025)  # at the better half of them, with plants near the best
FURTHER = 1.3  # times the longest of these, and so on, where longer ones are asked for
DELAYS = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 13.0, 17.0, 22.0, 29.0, 38.0, 50.0)  # samples
SHORTEST, LONGEST, TAUS = 1.5, 0.25, 5  # time constants looked at: samples, records, how many
FADE = 25.0  # samples after which the filter has forgotten
FIRSTS, FIRSTS_CLOSE = 6, 60  # first slips tried
SEEDS = 6  # of either kind of valve, about which closer grids are laid
NEAR = 0.05  # no two of them as near as that, of S, and in J as twice that
SPREADS = (0.04, 0.02, 0.008, 0.003, 0.001)  # how far these go, of S
FADED_SPREADS = 3  # of them through the filter
STEPS = 4  # about the best so far, how often at most
SIDES = np.linspace(-1.0, 1.0, 7)
ANSWERS = 3  # stems


@dataclass(frozen=True, slots=True)
class _Found:
    """A stem with its plant and the sample at which PV begins to answer the load step beside it.

    J: nan for a Stenman stem of band S. first, sense: see `band_path`. tau, theta in samples; cost: EU^2.
    """

    cost: float
    S: float
    J: float
    first: int
    sense: float
    tau: float
    theta: float
    at: int


@dataclass(frozen=True, eq=False)
class _Search:
    """What is searched: the record in some measure, from `skip` on, for steps in a span of samples.

    data: one sample of `every` so many of the whole record; plants, steps, skip and span count these. Stems and first
    slips are those of the whole. free: whether the plant's time constant is searched.
    """

    data: Centred
    whole: Centred
    every: int
    skip: int
    span: tuple[int, int]
    free: bool

    def best_first(
        self, stems: Sequence[tuple[float, float, int, float]], plants: FloatArray, most: int, roughly: int = 1
    ) -> list[_Found]:
        """The best of some stems (S, J, first, sense), `most` of them, each with its best plant and time of the step.

        plants: rows (tau, theta). roughly: samples between the times at which a step is tried, 1 or STRIDE.
        """
        return self.best_of_each([stems], plants, most, roughly)[0]

    def best_of_each(
        self, lots: Sequence[Sequence[tuple[float, float, int, float]]], plants: FloatArray, most: int, roughly: int
    ) -> list[list[_Found]]:
        """`best_first` of each of some lots of stems, all tried side by side."""
        stems = [(*stem, lot) for lot, those in enumerate(lots) for stem in those]
        if not stems:
            return [[] for _ in lots]
        rows = np.array(sorted(stems, key=lambda stem: stem[2]))
        found = np.empty((len(rows), len(plants), 2))
        data, op = self.data, self.whole.u[: self.data.samples * self.every]
        screen_stepped(
            data.y,
            op,
            np.ascontiguousarray(rows[:, :4]),
            plants,
            data.integrating,
            data.sign,
            self.skip,
            *self.span,
            roughly,
            found,
        )
        which = np.argmin(found[:, :, 0], axis=1)
        costs, ats = found[np.arange(len(rows)), which].T
        order = np.argsort(costs, kind="stable")
        order = order[np.isfinite(costs[order])]
        out: list[list[_Found]] = []
        for lot in range(len(lots)):
            out.append([])
            for i in order[rows[order, 4] == lot][:most].tolist():
                (S, J, first, sense), (tau, theta) = rows[i, :4].tolist(), plants[which[i]].tolist()
                out[-1].append(_Found(float(costs[i]), S, J, int(first), sense, tau, theta, int(ats[i])))
        return out


def stepped_stems(data: Centred, limits: Limits, skip: int, span: tuple[int, int]) -> list[Stem]:
    """Return stems that explain a record together with one load step in a span of samples, the best first.

    Plants and steps are fitted to a longer record's means over a few samples, of PV and of stems that see all of OP.
    """
    every = math.ceil(data.samples / EXACT)
    thin = data.thinned(every)
    skip, begin, end = (-(-at // every) for at in (skip, *span))
    limits = Limits(limits.tau, (limits.theta[0] / every, limits.theta[1] / every))
    whole = _Search(thin, data, every, skip, (begin, min(end, thin.samples)), not data.integrating)
    search = whole
    further = [DELAYS[-1] * FURTHER**i for i in range(1, 12)]
    delays = [d for d in (*DELAYS, *further) if d <= limits.theta[1]]
    taus = np.geomspace(SHORTEST, LONGEST * thin.samples, TAUS).tolist()
    if data.integrating:
        taus = [FADE]
        faded = first_order(thin.y, 1.0, -1.0, math.exp(-1.0 / FADE))
        search = replace(whole, data=replace(thin, y=faded, integrating=False), free=False)
    plants = np.array([(tau, theta) for tau in taus for theta in delays])
    found: list[_Found] = []
    for shares in (SHARES, (math.nan,)):
        seeds = _apart(_coarse(search, shares, plants))
        if data.integrating:
            seeds = [
                again
                for one in _closer(search, seeds, limits, SPREADS[:FADED_SPREADS])
                for again in whole.best_first([(one.S, one.J, one.first, one.sense)], np.array([(1.0, one.theta)]), 1)
            ]
        found += _closer(whole, seeds, limits, SPREADS[1 if data.integrating else 0 :])
    found.sort(key=lambda one: one.cost)
    return [_stem(whole, one) for one in found[:ANSWERS]]


def _coarse(search: _Search, shares: Sequence[float], plants: FloatArray) -> list[_Found]:
    """The stems of a grid, each with the best of the plants, the best first."""
    data = search.whole
    widths = (np.geomspace(NARROWEST, WIDEST, GRID) * data.op_range).tolist()
    ends = {S: [stem for share in shares for stem in _starts(data, S, share * S, 0)] for S in widths}
    stems = [stem for S in widths for stem in ends[S]]
    coarse = search.best_first(stems, _thinned(plants), len(stems), STRIDE)
    likely: dict[float, _Found] = {}
    for one in coarse:
        likely.setdefault(one.S, one)
    coarse += _likelier(search, likely, ends, lambda best: _beside(plants, best))
    # Where the stem was before its first slip asks for nearly the same plant.
    later = {
        S: [s for share in shares for s in _starts(data, S, share * S, FIRSTS, (1.0 + shares[-1]) * S) if s[2] > 0]
        for S in likely
    }
    coarse += _likelier(search, likely, later, lambda best: _close(plants, best))
    for one in sorted(likely.values(), key=lambda one: one.cost)[: GRID // 2]:
        if not math.isnan(one.J):
            # A sequence of slips may hold for a range of J too narrow for any grid.
            stems = [(one.S, J, one.first, one.sense) for J in (FINER_SHARES * one.S).tolist()]
            coarse += search.best_first(stems, _close(plants, one), SEEDS, STRIDE)
    return sorted(coarse, key=lambda one: one.cost)


def _likelier(
    search: _Search,
    likely: dict[float, _Found],
    stems: Mapping[float, Sequence[tuple[float, float, int, float]]],
    plants: Callable[[_Found], FloatArray],
) -> list[_Found]:
    """The best few of further stems of each S, at the plants that its best so far asks for; `likely` is brought up.

    Those of the same plant are tried side by side.
    """
    lots: dict[tuple[float, float], list[float]] = {}
    for S, best in likely.items():
        lots.setdefault((best.tau, best.theta), []).append(S)
    found: list[_Found] = []
    for those in lots.values():
        each = search.best_of_each([stems[S] for S in those], plants(likely[those[0]]), SEEDS, STRIDE)
        for S, here in zip(those, each, strict=True):
            found += here
            likely[S] = min([likely[S], *here[:1]], key=lambda one: one.cost)
    return found


def _thinned(plants: FloatArray) -> FloatArray:
    """Every second of a grid's time constants and dead times."""
    taus, thetas = np.unique(plants[:, 0]), np.unique(plants[:, 1])
    return plants[np.isin(plants[:, 0], taus[::2]) & np.isin(plants[:, 1], thetas[::2])]


def _beside(plants: FloatArray, one: _Found) -> FloatArray:
    """Those of a grid's plants that are no further from a stem's than one step of either."""
    taus, thetas = np.unique(plants[:, 0]), np.unique(plants[:, 1])
    near = [
        np.abs(np.searchsorted(grid, at) - np.arange(grid.size)) <= 1
        for grid, at in ((taus, one.tau), (thetas, one.theta))
    ]
    return plants[np.isin(plants[:, 0], taus[near[0]]) & np.isin(plants[:, 1], thetas[near[1]])]


def _close(plants: FloatArray, one: _Found) -> FloatArray:
    """Those of the plants that are nearly a stem's own."""
    away = np.abs(plants - (one.tau, one.theta))
    return plants[(away[:, 0] < 0.1 * one.tau) & (away[:, 1] <= 0.35 * one.theta + 1.0)]


def _starts(
    data: Centred, S: float, J: float, most: int, within: float | None = None
) -> list[tuple[float, float, int, float]]:
    """A stem (S, J, first, sense) with the starts that it may have, `most` first slips at most.

    within: S + J of the stem, %, whose first slips these are some of: stems that share them are tried side by side.
    """
    if math.isnan(J):
        return [(S, J, first, 0.0) for first in firsts_for(data, S, max(most, 1)).tolist()]
    firsts, ranged, senses = data.starts
    may = np.flatnonzero(ranged <= (S + J if within is None else within))[1:]
    kept = thin(may, most) if most else may[:0]
    kept = kept[ranged[kept] <= S + J]
    later = [(S, J, first, sense) for first, sense in zip(firsts[kept].tolist(), senses[kept].tolist(), strict=True)]
    return [(S, J, -1, 0.0), (S, J, 0, 1.0), (S, J, 0, -1.0), *later]


def _apart(found: list[_Found]) -> list[_Found]:
    """The first few of some stems that differ."""
    kept: list[_Found] = []
    for one in found:
        if len(kept) < SEEDS and not any(_alike(one, other, NEAR) for other in kept):
            kept.append(one)
    return kept


def _alike(one: _Found, other: _Found, near: float) -> bool:
    """Whether S differs by no more than a share, and J by no more than twice that of S."""
    close = abs(math.log(one.S / other.S)) <= near
    return close and (math.isnan(one.J) or abs(one.J - other.J) <= 2.0 * near * one.S)


def _closer(search: _Search, seeds: list[_Found], limits: Limits, spreads: Sequence[float]) -> list[_Found]:
    """The best stems that ever closer grids about some seeds lead to; of ways that meet in all one goes on."""
    for spread in spreads:
        ends: list[_Found] = []
        for end in sorted((_stepped(search, seed, limits, spread) for seed in seeds), key=lambda one: one.cost):
            if not any(_met(end, other, spread * (SIDES[1] - SIDES[0])) for other in ends):
                ends.append(end)
        seeds = ends
    return seeds


def _met(one: _Found, other: _Found, near: float) -> bool:
    """Whether two ways have come to one stem, start and time of the step."""
    begun = (one.first, one.sense) == (other.first, other.sense) and abs(one.at - other.at) <= 1
    return begun and _alike(one, other, near)


def _stepped(search: _Search, seed: _Found, limits: Limits, spread: float) -> _Found:
    """The best stem that steps of a grid about a seed lead to."""
    data, best = search.whole, seed
    starts = _starts(data, best.S, best.J, FIRSTS_CLOSE)
    begun = search.best_first(starts, np.array([(best.tau, best.theta)]), 1)
    best = min([best, *begun], key=lambda one: one.cost)
    for _ in range(STEPS):
        before = best
        thetas = np.unique(np.clip(best.theta + 50.0 * spread * SIDES[1:-1], *limits.theta))
        taus = np.array([best.tau])
        if search.free:
            taus = np.maximum(best.tau * (1.0 + 4.0 * spread * np.array([-1.0, 0.0, 1.0])), LEAST_TAU)
        plants = np.array([(tau, theta) for tau in taus for theta in thetas])
        widths = best.S * (1.0 + spread * SIDES)
        jumps = np.array([math.nan])
        if not math.isnan(best.J):
            jumps = np.unique(np.maximum(best.J + 2.0 * spread * best.S * SIDES, 0.0))
        grid = [(S, J, best.first, best.sense) for S in widths.tolist() for J in jumps.tolist()]
        best = min([best, *search.best_first(grid, plants, 1)], key=lambda one: one.cost)
        if best is before:
            break
    return best


def _stem(search: _Search, one: _Found) -> Stem:
    """A found stem as others are found: its path, and the paths near it; its plant's gain is not yet known."""
    data, every = search.whole, search.every
    fit = Fit(one.cost, one.tau * every, one.theta * every, data.sign or 1.0, 0.0, 0.0, 0.0)

    def near(wider: float, further: float) -> FloatArray:
        if math.isnan(one.J):
            return path_of(data.u, one.S * wider, one.first)[0]
        return band_stem(data.u, one.S * wider, one.J * further, one.first, one.sense)[0]

    free = 2 if one.J > 0.0 else 1
    return Stem(
        near(1.0, 1.0),
        max(one.first, 0),
        fit,
        near,
        free,
        times=(one.at * every,),
        valve=(one.S, one.J, one.first, one.sense),
        begun=lambda first, sense: _stem(search, replace(one, first=first, sense=sense)),
    )
