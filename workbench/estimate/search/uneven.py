"""Stems of a valve that does not stick alike at every slip, as real ones do not, or whose slips OP's rounding hides.

A stem that follows from one band goes another way for hours once a single slip comes sooner or later than that band
has it. Here each slip has a band of its own, of a normal distribution whose mean and spread are found: plant, bands and
stem in turn, the likeliest stem along the plant and the plant along the stem, as in Viterbi training (F. Jelinek, Proc.
IEEE 64 (1976) 532-556), from the stems of one band that the search has found.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, Limits, fit_path
from workbench.estimate.fits.sureness import NORMAL, SHARP
from workbench.estimate.kernels.output_error import plant_terms
from workbench.estimate.kernels.uneven import uneven_path
from workbench.model.numbers import given
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Stenman

__all__ = ["Uneven", "differing", "uneven_stems", "words_of_uneven"]

SPREAD = 0.1  # of the band, at first
CLOSEST = 1e-3  # of the band: no spread is told to be less
FOLLOWED = 6  # of the stems from some seeds
ROUNDS = 5  # of stem and plant in turn
ABOUT = (-3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0)  # samples by which dead times about the best are tried
FURTHER = (-16.0, -8.0, -4.0, -2.0, 2.0, 4.0)  # the same, with bands that are wider by what OP goes on by meanwhile
GAPS = (0.7, 0.85, 1.15, 1.4)  # and factors of S - J,
SHARES = (0.87, 0.94, 1.06, 1.14)  # of the bands,
JUMPS = (0.6, 0.85)  # and shares of J in S, of a stem that may not stick at once
APART, LEAST_GAP = 0.1, 0.02  # a step of S - J: of it, or of the stem's travel at least,
FURTHEST = 3.0  # and how many of them a parabola is followed
WIDEST = 0.3  # of the slip jump: bands that differ by more are none, and stems that turn anywhere follow anything
FEWEST = 5  # slips
STAYS = 0.5  # of twice the log likelihood: who gains no more has settled
STARTS = 9  # stems that a record may begin with, within the band
SEEN = 1.5  # times what the record tells of a band: bands that differ by more do differ
DEVIATIONS = 1.4826  # median deviations in a standard deviation


@dataclass(frozen=True, eq=False)
class Uneven:
    """A stem whose bands differ from slip to slip, with its output-error fit.

    S, J: their means, %, equal for one that sticks again at once (Stenman); spread: their standard deviation, %; x: the
    stem, and senses the way it was led, +1 or -1, shape (N,), 0 before `first`; bounds: of where it was until then, %;
    price: what its slips cost, of twice the log likelihood; level: that and N log V; step: how far OP usually goes in
    a sample as the stem slips, %; error: the standard error of the bands' mean, %.
    """

    sticks: bool
    S: float
    J: float
    spread: float
    x: FloatArray
    senses: FloatArray
    first: int
    bounds: tuple[float, float]
    slips: int
    fit: Fit
    price: float
    level: float
    step: float
    error: float

    @property
    def name(self) -> str:
        """The valve's kind."""
        return "stenman" if self.sticks else "choudhury"

    def alike(self, doubt: float) -> bool:
        """Whether the bands differ by no more than OP tells of them; doubt: what is not known of it, %."""
        return self.spread <= SEEN * math.hypot(self.step / math.sqrt(12.0), math.sqrt(2.0) * doubt)

    @property
    def d(self) -> float:
        """The mean stick band, %."""
        return self.S

    @property
    def valve(self) -> Stenman | Choudhury:
        """The valve that sticks as this one does in the mean."""
        return Stenman(self.S) if self.sticks else Choudhury(self.S, self.J)


def uneven_stems(
    data: Centred,
    seeds: Iterable[tuple[bool, float, float, Fit]],
    limits: Limits,
    kinds: Collection[bool],
    far: float = math.inf,
) -> list[Uneven]:
    """Return the likeliest stem from each of some seeds, and those about the best of them; the likeliest first.

    seeds: whether the stem sticks again at once, S, J and a fit; kinds: which of these stems may be told; far: a level
    from which on those about the best are sought once only. Empty where none slips often enough.
    """
    begun = [one for seed in seeds if (one := _turn(data, *seed, SPREAD * seed[1], limits)) is not None]
    found = [_settled(data, one, limits) for one in sorted(begun, key=lambda one: one.level)[:FOLLOWED]]
    found.sort(key=lambda one: one.level)
    while found:
        best = found[0]
        found += _about(data, best, limits, kinds)
        found.sort(key=lambda one: one.level)
        if found[0].level > min(best.level - STAYS, far):
            break
    return [one for one in found if one.spread <= WIDEST * one.J]


def _about(data: Centred, best: Uneven, limits: Limits, kinds: Collection[bool]) -> list[Uneven]:
    """The likeliest stems from valves and plants about those of the best.

    A slip a sample later is one from a wider band that PV answers to sooner, and a wider band one of a lower gain: they
    lead each to itself, and a stem that stands apart in its two directions to no other kind.
    """
    low, high = limits.theta
    fit, S, J, gap = best.fit, best.S, best.J, best.S - best.J
    seeds = [(S, J, replace(fit, theta=fit.theta + step)) for step in ABOUT if low <= fit.theta + step <= high]
    for step in FURTHER:
        wider = -step * best.step
        if low <= fit.theta + step <= high and J + wider > 0.0:
            seeds.append((S + wider, J + wider, replace(fit, theta=fit.theta + step)))
    seeds += [(share * S, share * J, replace(fit, gain=fit.gain / share)) for share in SHARES]
    if not best.sticks:
        bands = [band for share in GAPS if (band := J + gap * share) > 0.0]
        seeds += [(band, J, fit) for band in bands]
        # A cycle tells the product of gain and band.
        seeds += [(band, J, replace(fit, gain=fit.gain * S / band)) for band in bands]
    all_of = [(best.sticks, *seed) for seed in seeds]
    if not best.sticks and J > 0.0:
        all_of += [(True, d, d, replace(fit, gain=fit.gain * J / d)) for d in (J, 0.5 * (S + J), S)]
    if best.sticks:
        all_of += [(False, S, share * S, replace(fit, gain=fit.gain / share)) for share in JUMPS]
    spread = max(best.spread, 0.3 * SPREAD * S)
    begun = [_turn(data, *seed, spread, limits) for seed in all_of if seed[0] in kinds]
    # Who slips as the best does comes to the same.
    apart = [one for one in begun if one is not None and not np.array_equal(one.x, best.x)]
    return [_settled(data, one, limits) for one in apart]


def _settled(data: Centred, best: Uneven, limits: Limits) -> Uneven:
    """Stem, bands and plant in turn from a stem, as long as that is likelier."""
    last = best
    for _ in range(ROUNDS):
        one = _turn(data, last.sticks, last.S, last.J, last.fit, last.spread, limits)
        if one is None:
            break
        settled = one.level > best.level - STAYS
        best = one if one.level < best.level else best
        if settled:
            break
        last = one
    return best


def _turn(data: Centred, sticks: bool, S: float, J: float, fit: Fit, spread: float, limits: Limits) -> Uneven | None:
    """The likeliest stem along a plant, its bands, and the plant along that stem; None where it hardly slips."""
    n, band = data.samples, 0.5 * (S + J)
    if fit.gain == 0.0 or not S > 0.0:
        return None
    begun, ramp = (0.0, fit.transient) if data.integrating else (fit.start + fit.transient, 0.0)
    starts = data.u[0] + band * np.linspace(-0.95, 0.95, STARTS)
    starts = np.append(starts, np.clip(fit.start / fit.gain, data.u[0] - band, data.u[0] + band))
    ways = np.ones(1) if sticks else np.array([1.0, -1.0])
    x, senses, slips = np.empty(n), np.empty(n), np.empty((n, 3))
    price, count = uneven_path(
        data.y,
        data.u,
        plant_terms(data.integrating, fit.tau, fit.theta),
        np.array([fit.gain, fit.bias, begun, ramp]),
        sticks,
        np.array([S, J, max(spread, CLOSEST * S)]),
        max(fit.sse / n, data.floor),
        np.column_stack([np.repeat(starts, ways.size), np.tile(ways, starts.size)]),
        data.a,
        data.skip,
        x,
        senses,
        slips,
    )
    if count < FEWEST:
        return None
    first = int(slips[count - 1, 0])
    x[:first], senses[:first] = 0.0, 0.0
    reach = 0.5 * (S + J) + 3.0 * spread
    bounds = (float(data.u[: first + 1].max()) - reach, float(data.u[: first + 1].min()) + reach)
    if first == 0 or bounds[0] >= bounds[1]:
        bounds = (-math.inf, math.inf)
    fit = fit_path(data, x, first, bounds, limits, fit.theta, tau=fit.tau, evaluations=80, tolerance=1e-6)
    gap = S - J
    if not sticks:
        fit, x, gap = _apart(data, fit, x, senses, first, bounds, limits, gap)
    # Each band was somewhere between what held and what did not; of the first rest the beginning was not seen.
    held, gone = slips[: count - 1, 1], slips[: count - 1, 2]
    bands = 0.5 * (held + gone)
    mean = float(np.median(bands))
    step = math.sqrt(float(np.mean((gone - held) ** 2)))
    spread = math.hypot(DEVIATIONS * float(np.median(np.abs(bands - mean))), step / math.sqrt(12.0))
    # That of a median of few, whose own spread is not known well.
    few = bands.size / (bands.size - 3.0)
    error = math.sqrt(0.5 * math.pi * few / bands.size) * max(spread, float(np.std(bands, ddof=1)))
    level = n * math.log(max(fit.sse / n, data.floor)) + price
    J = max(mean, 0.0)
    if not J + gap > 0.0:
        # A stem that goes further as it slips than it sticks: by so much it would turn without any band.
        return None
    return Uneven(sticks, J + gap, J, spread, x, senses, first, bounds, count, fit, price, level, step, error)


def differing(found: Iterable[Uneven], most: int) -> list[Uneven]:
    """Return the first few of some stems that differ in where they slip."""
    chosen: list[Uneven] = []
    for one in found:
        if len(chosen) < most and not any(np.array_equal(one.x, known.x) for known in chosen):
            chosen.append(one)
    return chosen


def _apart(
    data: Centred,
    fit: Fit,
    x: FloatArray,
    senses: FloatArray,
    first: int,
    bounds: tuple[float, float],
    limits: Limits,
    gap: float,
) -> tuple[Fit, FloatArray, float]:
    """The plant along a stem that slips at the same samples and stands best apart in its two directions, by a parabola.

    gap: S - J, %, as x was made with it.
    """
    begun, step = fit, APART * max(gap, float(np.ptp(x)) * LEAST_GAP)

    def along(other: float) -> tuple[Fit, FloatArray]:
        moved = x - 0.5 * (other - gap) * senses
        near = fit_path(data, moved, first, bounds, limits, begun.theta, tau=begun.tau, evaluations=40, tolerance=1e-5)
        return near, moved

    tried = [(fit, x, gap), *((*along(other), other) for other in (max(gap - step, 0.0), gap + step))]
    less, more = tried[1][0].sse, tried[2][0].sse
    bend = less + more - 2.0 * fit.sse
    if bend > 0.0 and tried[1][2] < gap:
        way = float(np.clip(0.5 * (less - more) / bend, -FURTHEST, FURTHEST))
        other = max(gap + step * way, 0.0)
        tried.append((*along(other), other))
    return min(tried, key=lambda one: one[0].sse)


def words_of_uneven(found: Uneven, doubt: float) -> tuple[str, ...]:
    """Return in words how the bands of a valve differ from slip to slip; doubt: what is not known of OP, %."""
    band = f"{given(found.S, 3)} %"
    if found.alike(doubt):
        why = "the rest of PV tells when" if doubt == 0.0 else "OP was recorded in steps, PV tells when"
        return (f"each slip came at about {band}, not just where the recorded OP has it: {why}",)
    low, high = max(found.S - NORMAL * found.spread, 0.0), found.S + NORMAL * found.spread
    wide = "the stick band S is not identified: " if found.spread > SHARP * found.S else ""
    said = (
        f"{wide}the valve does not stick alike at every slip: its {found.slips} bands are about {band} wide, most of "
        f"them from {given(low, 3)} to {given(high, 3)} %; a stem of one band for all slips explains far less of PV"
    )
    return (said,)
