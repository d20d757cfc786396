"""A record's fits: every model of it in the measure of what disturbs the loop, and where its stems were sought."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import (
    LEAST_TAU,
    LOUD,
    Fit,
    Limits,
    again_linear,
    autoregression,
    fit_linear,
    grounded,
    predict,
)
from workbench.estimate.fits.sureness import ENOUGH_SLIPS, SHARP, SURE_SLIPS
from workbench.estimate.fits.windows import EXACT, WHOLE, stretch_with
from workbench.estimate.loads.settled import STEPS_MOST, akaike_of, needs_steps, settled
from workbench.estimate.loads.steps import CLEAR, DEGREES
from workbench.estimate.loads.uneven import uneven_beside_colour
from workbench.estimate.ranges.few import widened
from workbench.estimate.ranges.freed import freed
from workbench.estimate.ranges.hidden import hidden
from workbench.estimate.ranges.recoloured import recoloured
from workbench.estimate.search.bands import Bands, Found, further, noise_beside, repeated
from workbench.estimate.search.candidates import Candidate, distinct, leaves_noise
from workbench.estimate.search.dense import densely, densely_about
from workbench.estimate.search.long_record import rows_beside
from workbench.estimate.search.models import STICKING, bands_of, compared
from workbench.estimate.search.profile import Profile, profile_again, profile_of, search
from workbench.estimate.search.sought import Seek, Sought, Window, coarse_of, like_stenman, sought
from workbench.estimate.search.two_parameter import Band, fit_band, look
from workbench.estimate.search.uneven import Uneven
from workbench.estimate.straight import Coloured, level
from workbench.estimate.verdict import WIDE_D
from workbench.model.loads import LoadStep
from workbench.model.results import FittedModel

__all__ = [
    "DELAYS",
    "LINEAR_DELAYS",
    "Fits",
    "about",
    "closely",
    "first_fits",
    "leaves_noise_alone",
    "likelier_pair",
    "longest_delay",
    "sound",
    "unevenly",
    "whiter",
    "with_ranges",
]

# Dead times searched by default, in samples, and longer ones where they are asked for (`reach`).
DELAYS = 30
LINEAR_DELAYS = 240
NEARLY = 1.25  # times what a stem may leave to be far ahead: the first of a grid is not yet the best close about it
BEHIND = 40.0  # in N log V: who is further behind the best stem comes to nothing better
LONGEST_UNEVEN = 10_000  # samples: each of many stems is gone through with all that it may become
UNEVEN_FROM = 3  # of the first stems of each kind, from which stems that stick unevenly are sought
FIRST_STEMS = 3  # that may be likelier than a linear loop which leaves colour, beside the best of each kind
HALF = 0.5  # of what the linear fit leaves: a stem that leaves no more explains PV by itself


@dataclass(frozen=True, eq=False)
class Fits:
    """All models of a record, in the measure of the disturbance that the best stem leaves, and where they were sought.

    data: without load steps; whole: with them; found: Stenman's profile; bands: two-parameter valves by name; rival:
    the linear model with dead times as short as the stem's, before `steps`, the load steps, were taken out; wide: what
    the best stem over much of OP's range leaves, EU^2; coarse: the first stems of the two-parameter search, the best
    first; alone: whether Stenman's stem leaves noise alone (`leaves_noise_alone`); bare: the fits without load steps;
    uneven: stems that do not stick alike at every slip, the likeliest first, where these tell the valve.
    """

    data: Centred
    whole: Centred
    found: Profile | None
    bands: dict[str, Found]
    linear: Fit
    rival: Fit
    steps: tuple[LoadStep, ...]
    wide: float
    coarse: list[Band]
    within: Sought
    limits: Limits
    alone: bool
    bare: Callable[[], Fits] | None = None
    uneven: tuple[Uneven, ...] = ()

    def seen_in(self, data: Centred) -> Sought:
        """Where stems are sought in the record as it is in another measure, or without its load."""
        if data.y is self.within.pv:
            return self.within
        return sought(data, self.limits.theta[1], None, self.within.contested)

    def best(self, name: str) -> Band | Candidate | Uneven | None:
        """The best stem of a valve by its name; of any that is not two-parameter, the profile's."""
        if self.uneven and self.uneven[0].name == name:
            return self.uneven[0]
        return self.bands[name].best if name in self.bands else None if self.found is None else self.found.best

    @property
    def lead(self) -> Candidate | Uneven | None:
        """The best stem whose slips have one band each way."""
        return self.uneven[0] if self.uneven else None if self.found is None else self.found.best

    @cached_property
    def clear(self) -> dict[str, Found]:
        """The two-parameter searches from close about the first stems, where one leaves noise alone (`_clearly`)."""
        return _clearly(self)

    @cached_property
    def models(self) -> dict[str, FittedModel]:
        """Every model by its name, the lowest BIC first."""
        return compared(self.data, self.linear, self.found, self.bands, next(iter(self.uneven), None))


def longest_delay(data: Centred, max_dead_time: float | None, usual: int) -> float:
    """Return the longest dead time to search, in samples; never above `max_dead_time`, a quarter of the record."""
    most = max(data.samples // 4, 1)
    if max_dead_time is None:
        return float(min(usual, max(data.samples // 10, 1) if usual == DELAYS else most))
    return min(max_dead_time / data.sample_time, float(most))


def leaves_noise_alone(data: Centred, found: Profile, linear: Fit) -> bool:
    """Whether a Stenman valve explains all of PV but white noise, of which a valve with more freedom can take nothing.

    Only where it does so by a stem of its own: with slips enough, a sharp d, and much less left than the linear fit's.
    """
    best = found.best
    d = [end for c in found.alike for end in (c.d_low, c.d_high)]
    if best.slips < ENOUGH_SLIPS or max(d) - min(d) > SHARP * best.d or best.fit.sse > HALF * linear.sse:
        return False
    return leaves_noise(data, best)


def first_fits(data: Centred, valve: str, found: Profile | None, linear: Fit) -> Fits:
    """Return where stems are sought, and the first of them, as if the disturbance were white."""
    n = data.samples
    # The rival of the verdict is as causal as the stem model: a long dead time passes for half a cycle.
    delays = found.limits.theta[1] if found is not None else longest_delay(data, None, DELAYS)
    rival = linear if linear.theta <= delays else fit_linear(data, delays)
    wide = [] if found is None else [c.fit.sse / n for c in found.fits if c.d >= WIDE_D * data.op_range]
    other = None if found is None else found.best.fit
    alone = found is not None and leaves_noise_alone(data, found, rival)
    seek: Seek = partial(like_stenman, found) if alone else look
    within = sought(data, delays, other, alone and valve == "auto", seek)
    coarse = coarse_of(data, within, delays, seek)
    limits, least = Limits((LEAST_TAU, float(n)), (0.0, delays)), min(wide, default=math.inf)
    return Fits(data, data, found, {}, linear, rival, (), least, coarse, within, limits, alone)


def closely(fits: Fits, valve: str) -> Fits:
    """Return every model fitted; then load steps and the colour of the disturbance together with them."""
    data, delays, bands = fits.data, fits.limits.theta[1], {}
    if valve not in ("stenman", "linear"):
        bands = fits.clear or _bands_about(fits)

    # The verdict weighs what each model leaves of PV; the model itself is fitted in the measure that its disturbance
    # asks for.
    def with_steps(most: int) -> Fits:
        there, found, own, linear, steps = settled(data, fits.found, bands, fits.linear, delays, fits.within, most)
        return replace(fits, data=there, found=found, bands=own, linear=linear, steps=steps)

    found = replace(with_steps(STEPS_MOST), bare=partial(with_steps, 0))
    long = data.samples > WHOLE and found.data.a.size > 1
    return min([found, _as_in_stretch(found, valve)], key=_akaike) if long else found


def unevenly(first: Fits, found: Fits, valve: str) -> Fits:
    """Return the models with a stem that does not stick alike at every slip where that is clearly the likeliest.

    Else those found. first: the fits as if the disturbance were white. Of load steps and colour beside stems of one
    band much may be no more than the slips that these miss; where they need neither no others are sought.
    """
    whole, limits = first.data, first.limits
    if whole.samples > LONGEST_UNEVEN or (found.data.a.size == 1 and not found.steps):
        return found
    least = min((one.fit.sse for one in (found.best(name) for name in STICKING) if one is not None), default=math.inf)
    if whole.doubt == 0.0 and least <= LOUD * whole.samples * whole.floor:
        return found
    stems = [] if found.found is None else [found.found.best]
    stems += [] if first.found is None else distinct(sorted(first.found.fits, key=lambda c: c.fit.sse), UNEVEN_FROM)
    bands = [one.best for one in found.bands.values()] + first.coarse[:UNEVEN_FROM]
    seeds: list[tuple[bool, float, float, Fit]] = []
    if valve in ("auto", "stenman"):
        seeds += [(True, d, d, fit) for d, fit in [(c.d, c.fit) for c in stems] + [(b.S, b.fit) for b in bands]]
    if valve in ("auto", "choudhury"):
        seeds += [(False, b.S, b.J, b.fit) for b in bands]
    data, met = uneven_beside_colour(whole, seeds, limits, min(found.data.skip, whole.samples // 20), _weight(found))
    if not met:
        return found
    told, ahead = replace(first, data=data, bands={}, uneven=tuple(met)), CLEAR
    even = next((best for name in found.models if (best := found.best(name)) is not None and name in STICKING), None)
    if met[0].alike(data.doubt) and even is not None and not isinstance(even, Uneven) and hidden(found.data, even):
        # No stem of one band is known to be the valve's: where these do as well they are told.
        ahead = -met[0].price - CLEAR
    return _in_one_measure(told) if _weight(told) < _weight(found) - ahead else found


def _in_one_measure(told: Fits) -> Fits:
    """The fits beside an uneven stem, the other models' too in the measure of what that stem leaves."""
    data, found = told.data, told.found
    if data.a.size == 1:
        return told
    linear = again_linear(data, told.linear, told.limits.theta[1])
    return replace(told, linear=linear, found=None if found is None else profile_again(data, found))


def _weight(fits: Fits) -> float:
    """BIC of the likeliest model, with all that it stands beside."""
    data, n = fits.data, fits.data.samples
    beside = math.log(n) * (data.terms + DEGREES * len(fits.steps)) - n * math.log(1.0 - data.skip / n)
    return min(model.bic for model in fits.models.values()) + beside


def _akaike(fits: Fits) -> float:
    return akaike_of(fits.data, fits.found, fits.bands, fits.linear, fits.steps)


def _as_in_stretch(fits: Fits, valve: str) -> Fits:
    """The models of a long record gone on with from those of its liveliest stretch, gone through by itself.

    A search that takes a coloured disturbance for white ends in stems that follow it; in a stretch that is short enough
    stem and colour are found together, and with its colour that stem leads to the right one in all of the record.
    """
    whole, delays = fits.whole, fits.limits.theta[1]
    stems: list[Band | Candidate] = [one.best for one in fits.bands.values()]
    stems += [] if fits.found is None else [fits.found.best]
    slips = min(stems, key=lambda one: one.fit.sse).slips if stems else 0
    begin, stop = stretch_with(whole, slips)
    part = whole.part(begin, stop)
    if not part.moves:
        return fits
    near = min(delays, part.samples / 4.0)
    seen = closely(first_fits(part, valve, search(part, near), fit_linear(part, near)), valve)

    def met(only: float | None) -> list[Band]:
        return [one.best for one in seen.bands.values() if one.only == only]

    within = replace(fits.within, windows=(Window(begin, part, [], met),), known=False, thinned=())
    data = whole.whitened(seen.data.a, fits.data.skip, seen.data.law)
    found, bands = fits.found, bands_of(data, [], within, fits.limits)
    if found is not None:
        rows, likely = found.rows, list(found.likely)
        if seen.found is not None:
            rows, likely = rows_beside(data, rows, seen.found.best), [*likely, seen.found.best.d]
        found = profile_of(data, rows, likely, fits.limits)
    linear = again_linear(data, fits.linear, delays)
    data, found, bands, linear, steps = settled(data, found, bands, linear, delays, within, 0)
    return replace(fits, data=data, found=found, bands=bands, linear=linear, steps=steps, within=within)


def _bands_about(fits: Fits) -> dict[str, Found]:
    """The searches over two-parameter valves from all that is known of where their stems are."""
    data, delays = fits.data, fits.limits.theta[1]
    other = None if fits.found is None else fits.found.best.fit
    seeds = fits.coarse
    if not (fits.alone or data.samples > WHOLE):
        seeds = [*seeds, *like_stenman(fits.found, data, delays)]
    dense = () if fits.alone else densely(data, fits.coarse, delays)
    return bands_of(data, seeds, fits.within, fits.limits, fits.within.rival(other), beside=dense)


def _clearly(fits: Fits) -> dict[str, Found]:
    """The same from close about the first stems alone; empty unless that leads to one that leaves noise alone.

    Such a stem, of slips enough and far ahead of the linear loop, has no better ones but those that slip a sample or
    two beside it, which the search for the ranges looks at.
    """
    data = fits.data
    most = min(HALF * fits.rival.sse, math.inf if fits.found is None else fits.found.best.fit.sse)
    if fits.alone or data.samples > EXACT or not fits.coarse:
        return {}
    lead = fits.coarse[0]
    if lead.slips < ENOUGH_SLIPS or lead.fit.sse > NEARLY * most:
        return {}
    bands = bands_of(data, fits.coarse, fits.within, fits.limits, lead.fit.sse, near=True)
    name = min(bands, key=lambda one: bands[one].best.fit.sse, default="")
    best = bands[name].best if name else lead
    if best.fit.sse >= most or best.slips < ENOUGH_SLIPS or not noise_beside(data, best):
        return {}
    if "choudhury" not in bands:
        return bands
    # One that slips at the right samples but for the first has another jump, which small steps do not lead to.
    about, least = densely_about(data, best, fits.limits.theta[1]), max(best.fit.sse, data.samples * data.floor)
    likely = [b for b in about if b.fit.sse <= least * math.exp(BEHIND / data.samples)]
    return bands | {"choudhury": further(data, bands["choudhury"], likely, fits.limits)}


def sound(fits: Fits, valve: str, data: Centred, linear: Fit) -> Fits:
    """Return the models of a loop whose valve was acquitted, in data: the measure of what its linear model leaves."""
    found, bands = fits.found, fits.bands
    if found is not None:
        found = profile_of(data, found.rows, [*found.likely, found.best.d_low], found.limits, (found.best,))
    if valve not in ("stenman", "linear"):
        other = None if found is None else found.best.fit
        bands = bands_of(data, fits.coarse, fits.seen_in(data), fits.limits, fits.within.rival(other))
    return replace(fits, data=data, found=found, bands=bands, linear=linear)


def about(fits: Fits, whole: Centred, data: Centred, band: Band, linear: Fit) -> Fits:
    """Return the models of a loop in which a stem was found beside a linear loop, searched on from there.

    whole: the record with its load steps; data, linear: without those that the linear loop was found beside, and its
    fit there.
    """
    limits, delays = fits.limits, fits.limits.theta[1]
    within = fits.seen_in(data)
    seed = fit_band(data, band.S, band.J, (band.first, band.sense), limits, (band.fit.tau, band.fit.theta))
    bands = bands_of(data, [seed], within, limits, linear.sse)
    there, _, own, linear, steps = settled(whole, None, bands, linear, delays, within)
    found = fits.found
    if found is not None:
        found = profile_of(there, found.rows, [*found.likely, found.best.d_low], found.limits, (found.best,))
    return replace(fits, data=there, whole=whole, found=found, bands=own, linear=linear, steps=steps, bare=None)


def likelier_pair(fits: Fits) -> Band | None:
    """Return the best two-parameter stem where its BIC is below that of Stenman's."""
    models = fits.models
    leader = next((name for name in models if name in fits.bands), None)
    if leader is None or models[leader].bic >= models.get("stenman", models[leader]).bic + 1e-9:
        return None
    return fits.bands[leader].best


def with_ranges(fits: Fits, chosen: str) -> tuple[Fits, Bands]:
    """Return the fits, and of them the two-parameter valve that was chosen with its ranges.

    The ranges come from parts of the record, and beside other load steps too. Where slips are few, steps found beside a
    stem that slips at other times than the valve did may be no more than the difference: where the search for the
    ranges leads to a stem that explains PV as well without any, the fits are those.
    """
    found = _ranged(fits, chosen)
    if fits.steps and fits.bare is not None and found.best.slips < SURE_SLIPS:
        still = fits.bare()
        # Without the steps a search over any jump may have ended without one: that valve is the dead band then.
        if chosen in still.bands:
            other = _ranged(still, chosen)
            if not needs_steps((fits.data, found.best), fits.steps, (still.data, other.best)):
                return still, other
    return fits, found


def _ranged(fits: Fits, chosen: str) -> Bands:
    """The two-parameter valve that was chosen, with its ranges."""
    data, only = fits.data, fits.bands[chosen].only
    found = repeated(data, fits.bands[chosen], fits.limits, fits.seen_in(data))
    found = widened(data, found, only, fits.limits)
    found = freed(data, fits.whole, found, only, fits.limits, fits.steps)
    return recoloured(data, found, only, fits.limits)


def whiter(fits: Fits, straight: Coloured) -> Band | None:
    """Return the two-parameter stem that is much likelier than a linear loop that does not leave noise alone, or None.

    Each is in the measure of what it leaves itself: in that of the other the true stem, too, may leave no less.
    """
    linear = straight[0]
    if linear.a.size == 1:
        return None
    data, steps = fits.data, straight[2] if fits.data is linear else fits.steps
    paid = DEGREES * len(steps) * math.log(data.samples) + CLEAR
    likelier: list[tuple[float, Band]] = []
    for b in (*(one.best for one in fits.bands.values()), *fits.coarse[:FIRST_STEMS]):
        x = b.stem(data.u)
        left = data.y - predict(data, x, b.begin, grounded(data, x, b.begin, b.fit))[0]
        free = (2 if b.J > 0.0 else 1) * math.log(data.samples)
        # Of as many samples as the linear loop's, whichever count.
        own = autoregression(left[data.skip :], data.floor)[1] * data.samples / (data.samples - data.skip)
        likelier += [(own + free + paid, b)] if b.fit.gain != 0.0 else []
    least, best = min(likelier, key=lambda one: one[0], default=(math.inf, None))
    return best if least < level(*straight) else None
