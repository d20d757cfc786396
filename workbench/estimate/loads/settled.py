"""A record's models in the measure of what disturbs it: load steps found and taken out, what is left made white.

The stem that explains PV, the load steps beside it and the colour of what remains depend on each other, so that they
are found in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from workbench.estimate.fits.data import WHITE, Centred
from workbench.estimate.fits.drift import Drift
from workbench.estimate.fits.fit import (
    INTEGRATED,
    LEAST_TAU,
    Fit,
    Limits,
    again_linear,
    disturbance,
    fit_path,
    grounded,
    predict,
)
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.loads.coloured import Colour, colour_beside
from workbench.estimate.loads.drifting import LONGEST, Drifting
from workbench.estimate.loads.own_colour import as_it_is, other_jumps, own_akaike, own_colour
from workbench.estimate.loads.stepped import stepped_stems
from workbench.estimate.loads.steps import CLEAR, DEGREES, Loads, Stem, loads_of
from workbench.estimate.search.bands import Found, further
from workbench.estimate.search.candidates import Candidate, held
from workbench.estimate.search.models import bands_of, refitted
from workbench.estimate.search.profile import Profile, profile_again, profile_of, search
from workbench.estimate.search.sought import HOPELESS, Sought, coarse_of, like_stenman, sought
from workbench.estimate.search.stems import path_of
from workbench.estimate.search.two_parameter import Band, fit_band
from workbench.model.loads import LoadStep
from workbench.model.record import FloatArray

__all__ = ["STEPS_MOST", "akaike_of", "calm_linear", "colour_of", "coloured_linear", "led_to", "needs_steps", "settled"]

HALF = 0.5  # of what a model leaves: another that leaves no more is the one to go by
STARTING = 20  # of the record at most is left out at its start
STEPS_MOST = 2  # load steps
COLOURINGS = 2  # rounds of model and disturbance in turn
ROUNDS = 4  # where there are load steps
SAME_TIME, SAME_SIZE = 5, 0.1  # samples, share: steps that moved less have settled
SAME_STEM = 0.05  # of its standard deviation: a stem's path that moved less has
HARDLY = 20.0  # of N log V: a stem that leaves so much more than the leading one may be the right one beside a step
SAME_BAND = 0.05  # of its stick band: a stem that is no other one, whatever its jump
CLEARLY = 2.0  # of AIC: noise upon a drift is told where it is so much likelier than any autoregression
WORSE = 2.0  # of AIC: a turn that ends so far above an earlier one is taken back

# A record without load steps in some measure, its models there, and the steps.
_Settled = tuple[Centred, Profile | None, dict[str, Found], Fit, tuple[LoadStep, ...]]


def _leading(data: Centred, found: Profile | None, bands: dict[str, Found], linear: Fit) -> Stem:
    """The best stem, with its fit."""
    band = min((b.best for b in bands.values()), key=lambda b: b.fit.sse, default=None)
    if band is not None and (found is None or band.fit.sse < found.best.fit.sse):
        return _of_band(data, band)
    if found is None:
        return Stem(data.u, 0, linear)
    return _of_path(data, found.best)


def _of_path(data: Centred, best: Candidate) -> Stem:
    """Stenman's stem over the whole of a record."""

    def near(wider: float, _: float) -> FloatArray:
        return best.stem(data.u, wider)

    return Stem(
        near(1.0, 1.0),
        best.first,
        best.fit,
        near,
        free=1,
        valve=(best.d_low, math.nan, best.first, 0.0),
        begun=lambda first, _: _of_path(data, replace(best, first=first)),
    )


def _nearly(data: Centred, found: Profile | None, bands: dict[str, Found], lead: Stem) -> list[Stem]:
    """The best stems of other valves that leave hardly more than the leading one, and Stenman's.

    What a step spoils, a valve of more freedom makes up for by wrong slips: Stenman's may be right and leave far more.
    """
    most = max(lead.fit.sse, data.samples * data.floor) * math.exp(HARDLY / data.samples)
    bests = [one.best for one in bands.values()]
    stems = [_of_band(data, b) for b in bests if b.fit is not lead.fit and b.fit.sse <= most]
    if found is not None and found.best.fit is not lead.fit and found.best.fit.gain != 0.0:
        stems.append(_of_path(data, found.best))
    return stems


def _of_band(data: Centred, b: Band) -> Stem:
    """A two-parameter stem over the whole of a record."""
    return Stem(
        b.stem(data.u),
        b.begin,
        b.fit,
        partial(b.stem, data.u),
        free=2 if b.J > 0.0 else 1,
        valve=(b.S, b.J, b.first, b.sense),
        begun=lambda first, sense: _of_band(data, replace(b, first=first, sense=sense)),
    )


def _relieved(
    whole: Centred,
    data: Centred,
    lead: Stem,
    limits: Limits,
    skip: int,
    most: int,
    further: Callable[[tuple[int, int]], Sequence[Stem]] | None = None,
    others: Sequence[Stem] = (),
    strict: bool = True,
) -> tuple[Centred, Loads]:
    """The record without the load steps that a stem does not explain, and the steps.

    whole: the record with its load; data: as the lead was fitted to it; the rest as in `loads_of`.
    """
    x, first, fit = lead.x, lead.first, lead.fit
    loads = loads_of(whole, lead, limits, skip, most, further, strict=strict, others=others)
    if loads.steps:
        return whole.less(loads.pv, loads.answers), loads
    if data.load.any():
        left = whole.y - predict(whole, x, first, grounded(whole.whitened(data.a, max(skip, 1)), x, first, fit))[0]
    else:
        left = data.y - predict(data, x, first, grounded(data, x, first, fit))[0]
    return whole, replace(loads, left=left)


def settled(
    data: Centred,
    found: Profile | None,
    bands: dict[str, Found],
    linear: Fit,
    delays: float,
    within: Sought,
    most: int = STEPS_MOST,
) -> _Settled:
    """The record and its models without load steps, in the measure of the disturbance that the best stem leaves.

    Where the record starts within a cycle, its first samples, up to the dead time, answer to slips before it: they no
    longer count. A PV that starts where it does not come again starts from rest, with a setpoint move. within: where
    two-parameter stems are searched (`bands.sought`). most: load steps; where those that are seen do not last there are
    none.
    """
    whole, first = data, (found, bands, linear)
    steps: tuple[LoadStep, ...] = ()
    fits = [linear, *(one.best.fit for one in (*(() if found is None else (found,)), *bands.values()))]
    # The dead time of a model that leaves much more of PV than another is no plant's. Under an OP in steps what slips
    # first is not known either, and the longest leaves it out.
    near = max(min(fit.sse for fit in fits), data.samples * data.floor) / HALF if data.doubt == 0.0 else math.inf
    theta = min(max((fit.theta for fit in fits if fit.sse <= near), default=0.0), delays)
    later = data.y[data.samples // 4 :]
    amid = bool(later.min() <= data.y[0] <= later.max())
    skip = min(math.ceil(theta) + 2, data.samples // STARTING) if amid else 0
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, delays))
    turn, lead = 0, Stem(data.u, 0, linear)
    turns: list[tuple[float, _Settled]] = []
    while turn < COLOURINGS or ((steps or _exact(data, found, bands, linear)) and turn < ROUNDS):
        before = steps
        at = tuple(round(step.at / whole.sample_time) for step in steps)
        earlier, lead = lead, replace(_leading(data, found, bands, linear), times=at)
        stands = turn > 0 and _same_stem(earlier.x, lead.x)
        further = partial(stepped_stems, whole, limits, skip) if turn == 0 else None
        others = [] if turn > 0 else _nearly(data, found, bands, lead)
        bare, loads = _relieved(whole, data, lead, limits, skip, most, further, others, strict=turn > 0)
        nearly = bool(before) and not loads.steps and turn == 1
        if nearly:
            # The stem that leads once the first steps are out may not quite be known yet.
            bare, loads = _relieved(whole, data, lead, limits, skip, most, strict=False)
        steps = loads.steps
        if before and not steps:
            # Beside them a stem may have been found that needs none.
            found, was, linear = first
            return settled(whole, found, led_to(whole, was, bands, limits), linear, delays, within, 0)
        same_steps = _same(before, steps, whole.sample_time)
        colour, level = colour_of(bare, loads.left[skip:], lead, limits, skip)
        if turn == 0 and colour.a.size > 1 and data.integrating and data.samples <= WHOLE:
            for changing in _of_changes(bare, found, delays, within, skip):
                left = bare.y - predict(bare, changing.x, changing.first, changing.fit)[0]
                own = colour_of(bare, left[skip:], changing, limits, skip)
                colour, level = min((colour, level), own, key=lambda one: one[1])
        same = colour.a.size == data.a.size == 1 and not steps
        stands = stands and (same_steps or not (before or steps))
        # Of a long record the first few samples are nothing.
        turn += 1
        if same and (turn > 1 or skip == 0 or data.samples > WHOLE):
            break
        if turns and not (before or steps) and _stands(data, lead, limits, level):
            break
        data = bare.whitened(colour.a, skip, colour.law)
        anew = colour.a.size > 1 or bool(steps)
        linear = again_linear(data, linear, delays)
        if found is not None and steps and not same_steps:
            found = search(bare, delays) or found
        if found is not None:
            likely = [*found.likely, found.best.d_low]
            if anew and not _outdone(data, found, bands):
                found = profile_of(data, found.rows, likely, found.limits, (found.best, *_stenman_of(data, loads)))
            else:
                found = profile_again(data, found)
        if bands:
            # While steps are sought a stem is needed, not the dead band beside it.
            only_any = bool(steps) and not same_steps and turn < ROUNDS
            if stands or not anew or data.samples <= WHOLE:
                bands = refitted(data, bands, limits)
            if anew:
                # A stem that stood fast while its measure changed has no rivals that have not been looked at.
                other = None if found is None else found.best.fit
                there = within if data.y is within.pv else sought(data, delays, other, within.contested)
                known = stands or data.samples > WHOLE
                coarse = [one.best for one in bands.values()]
                if not known:
                    coarse = [*coarse_of(data, there, delays), *like_stenman(found, data, delays)]
                if loads.beside is not None and not math.isnan(loads.beside[0][1]):
                    (S, J, first_slip, sense), fit = loads.beside
                    coarse.append(fit_band(data, S, J, (first_slip, sense), limits, (fit.tau, fit.theta)))
                bands = bands_of(data, coarse, there, limits, there.rival(other), only_any, bands)
        turns.append((akaike_of(data, found, bands, linear, steps), (data, found, bands, linear, steps)))
        if same_steps and not nearly:
            break
    least, best = min(turns, key=lambda one: one[0], default=(math.inf, None))
    if best is not None and least < turns[-1][0] - WORSE:
        # Stem, steps and colour may lead each other away from what explained PV best.
        data, found, bands, linear, steps = best
        if bands:
            other = None if found is None else found.best.fit
            there = sought(data, delays, other, within.contested)
            coarse = [one.best for one in bands.values()]
            bands = bands_of(data, coarse, there, limits, there.rival(other), before=bands)
    if data.a.size > 1:
        data, found, bands, linear = _in_own_colour(data, found, bands, linear, limits, skip)
    return data, found, bands, linear, steps


def _in_own_colour(
    data: Centred, found: Profile | None, bands: dict[str, Found], linear: Fit, limits: Limits, skip: int
) -> tuple[Centred, Profile | None, dict[str, Found], Fit]:
    """The models in the measure that the best stem, or one of another jump, has once plant and colour are free in it.

    Gone on with as long as that is likelier. Other stems are not sought: in the measure of a wrong one many look right.
    """
    for _ in range(ROUNDS):
        lead = _leading(data, found, bands, linear)
        if lead.valve is None or lead.fit.gain == 0.0:
            break
        own, stems = own_colour(data, limits), [lead]
        if found is not None and found.best.fit is not lead.fit and found.best.fit.gain != 0.0:
            stems.append(_of_path(data, found.best))
        likely = min((one for stem in stems for one in other_jumps(own, stem)), key=partial(own_akaike, own))
        if not as_it_is(own, lead) - own_akaike(own, likely) > WORSE:
            break
        left = data.y - predict(data, likely.x, likely.first, grounded(data, likely.x, likely.first, likely.fit))[0]
        colour, _ = colour_of(data, left[skip:], likely, limits, skip)
        anew = data.whitened(colour.a, skip, colour.law)
        profile = None if found is None else profile_again(anew, found)
        searched = refitted(anew, bands, limits)
        S, J, begin, sense = likely.valve or lead.valve
        if not math.isnan(J) and "choudhury" in searched:
            seed = fit_band(anew, S, J, (begin, sense), limits, (likely.fit.tau, likely.fit.theta))
            searched |= {"choudhury": further(anew, searched["choudhury"], [seed], limits)}
        straight = again_linear(anew, linear, limits.theta[1])
        led = _leading(anew, profile, searched, straight).valve
        elsewhere = led is None or abs(led[0] / S - 1.0) > SAME_BAND
        if elsewhere or not _priced(anew, profile, searched) < _priced(data, found, bands) - WORSE:
            break
        data, found, bands, linear = anew, profile, searched, straight
    return data, found, bands, linear


def _priced(data: Centred, found: Profile | None, bands: dict[str, Found]) -> float:
    """AIC of the likeliest valve that sticks, in the measure of its disturbance, as far as it depends on these."""
    fits = [(fit.best.fit, 0.0) for fit in (found,) if fit is not None]
    fits += [(one.best.fit, 2.0 * (one.best.J > 0.0)) for one in bands.values()]
    return min(_akaike(data, fit) + price for fit, price in fits)


def _stenman_of(data: Centred, loads: Loads) -> list[Candidate]:
    """Stenman's stem that load steps were found beside, if it was one."""
    if loads.beside is None or not math.isnan(loads.beside[0][1]):
        return []
    (d, _, first, _), fit = loads.beside
    return [held(data, Candidate(first, d, d, path_of(data.u, d, first)[1], fit))]


def led_to(data: Centred, was: dict[str, Found], bands: dict[str, Found], limits: Limits) -> dict[str, Found]:
    """Return the searches in data as they were, each with the stem that it has come to since where that leaves less.

    bands: the searches as they are now, in data without load steps.
    """
    led = dict(was)
    for name in was.keys() & bands.keys():
        b, found = bands[name].best, was[name]
        there = fit_band(data, b.S, b.J, (b.first, b.sense), limits, (b.fit.tau, b.fit.theta))
        if there.fit.sse < found.best.fit.sse and there.fit.gain != 0.0:
            led[name] = replace(found, best=there, met=(there, *found.met))
    return led


def _outdone(data: Centred, found: Profile, bands: dict[str, Found]) -> bool:
    """Whether a two-parameter stem leaves so much less of a long record that no other one-parameter stem would do."""
    least = min((one.best.fit.sse for one in bands.values()), default=math.inf)
    return data.samples > WHOLE and found.best.fit.sse > HOPELESS * least


def _exact(data: Centred, found: Profile | None, bands: dict[str, Found], linear: Fit) -> bool:
    """Whether the best stem leaves less than the record resolves in the measure of what another one left.

    In that measure others may leave as little.
    """
    return data.a.size > 1 and _leading(data, found, bands, linear).fit.sse <= data.samples * data.floor


def akaike_of(
    data: Centred, found: Profile | None, bands: dict[str, Found], linear: Fit, steps: Sequence[LoadStep]
) -> float:
    """Return the AIC of the best stem in the measure of its disturbance, as far as it depends on these and on steps."""
    return _akaike(data, _leading(data, found, bands, linear).fit) + 4.0 * len(steps)


def _akaike(data: Centred, fit: Fit) -> float:
    variance = fit.sse / (data.samples - data.skip)
    return data.samples * math.log(max(variance, data.floor)) + 2.0 * data.terms


def needs_steps(beside: tuple[Centred, Band], steps: Sequence[LoadStep], without: tuple[Centred, Band]) -> bool:
    """Return whether a stem beside load steps is as much likelier than one without as steps are asked to be (`loads`).

    beside, without: the measure of the disturbance that each leaves, and the stem in it. Both of it and of PV itself:
    an autoregression may hold what a step left.
    """
    price = DEGREES * len(steps) * math.log(beside[0].samples) + CLEAR
    levels = [
        (_akaike(data, b.fit), _akaike(data.whitened(WHITE, data.skip), _itself(data, b)))
        for data, b in (beside, without)
    ]
    return any(one + price < other for one, other in zip(*levels, strict=True))


def _itself(data: Centred, b: Band) -> Fit:
    """The fit of a stem as it is to PV itself."""
    return grounded(data, b.stem(data.u), b.begin, b.fit)


def _of_changes(data: Centred, found: Profile | None, delays: float, within: Sought, skip: int) -> list[Stem]:
    """The best stem of how PV changes from sample to sample, if there is one.

    What a level sums up of a load, and of a wrong slip, lasts in PV, and hides stems that are right.
    """
    changes = data.whitened(INTEGRATED, skip)
    seen = [*coarse_of(changes, within, delays), *like_stenman(found, changes, delays)]
    stems = [_of_band(data, b) for b in sorted(seen, key=lambda b: b.fit.sse)[:1]]
    return [replace(one, fit=grounded(changes, one.x, one.first, one.fit)) for one in stems]


def colour_of(bare: Centred, left: FloatArray, lead: Stem, limits: Limits, skip: int) -> tuple[Colour, float]:
    """Return the colour of what disturbs a stem's fit, and its AIC; left: what the fit leaves from `skip` on.

    An integrating process sums up what disturbs its input: it is how the disturbance changes that is white or coloured
    then. The coefficients of an autoregression fitted to the disturbance itself never quite sum up to nought, as that
    takes, and what is missing acts as a force that pulls the level back, at the cost of the gain.
    """
    own = Colour(disturbance(left, bare.floor))
    plant = lead.fit.tau, lead.fit.theta
    colours = [(own, plant)]
    if own.a.size > 1 and lead.fit.gain != 0.0:
        beside = partial(colour_beside, bare, lead.x, lead.first, lead.fit, limits, skip)
        colours.append(beside())
        if bare.integrating:
            colours.append(beside(moves=True))
            colours.append((Colour(np.convolve(INTEGRATED, disturbance(np.diff(left), bare.floor))), plant))
        # Where no stem is seen to move PV a drift does as well as much that PV answers.
        laws = () if lead.valve is None or bare.samples > LONGEST else (True,) if bare.integrating else (True, False)
        for tied in laws:
            begins = sorted({at for _, at in colours})
            fit, law = Drifting.of(bare, limits, skip).likeliest(lead.x, lead.first, begins, tied=tied)
            colours.append((Colour(law.filter(bare.samples), law), (fit.tau, fit.theta)))
    # A drift's filter leaves out much more of the record's beginning than others: then the same samples count of all.
    counted = max(skip, *(one.a.size - 1 for one, _ in colours)) if lead.valve is not None else skip
    levels = [_akaike_in(bare.whitened(one.a, counted, one.law), lead, limits, near) for one, near in colours]
    doubted = [CLEARLY * isinstance(one.law, Drift) for one, _ in colours]
    least = int(np.argmin(np.add(levels, doubted)))
    return colours[least][0], levels[least]


def _stands(data: Centred, lead: Stem, limits: Limits, level: float) -> bool:
    """Whether data's measure is as likely beside a stem as one of this AIC, which has its filter to pay for."""
    return _akaike_in(data, lead, limits) - 2.0 * data.terms <= level


def _akaike_in(data: Centred, lead: Stem, limits: Limits, *near: tuple[float, float]) -> float:
    """AIC of a stem with a plant fitted to it in data's measure, as far as it depends on that.

    near: tau and theta, samples, of plants to begin from beside the stem's own.
    """
    free, begins = (-math.inf, math.inf), {(lead.fit.tau, lead.fit.theta), *near}
    fits = (fit_path(data, lead.x, lead.first, free, limits, theta, tau=tau) for tau, theta in begins)
    return _akaike(data, min(fits, key=lambda fit: fit.sse))


def _same(before: Sequence[LoadStep], steps: Sequence[LoadStep], Ts: float) -> bool:
    """Whether there are steps, at the times and of the sizes that they had before."""
    return (
        bool(steps)
        and len(before) == len(steps)
        and all(
            abs(one.at - other.at) <= SAME_TIME * Ts and abs(one.size - other.size) <= SAME_SIZE * abs(other.size)
            for one, other in zip(steps, before, strict=True)
        )
    )


def _same_stem(one: FloatArray, other: FloatArray) -> bool:
    """Whether two stem paths are hardly apart."""
    return bool(np.std(one - other) <= SAME_STEM * np.std(other))


def coloured_linear(
    data: Centred, linear: Fit, delays: float, times: tuple[int, ...] = ()
) -> tuple[Centred, Fit, tuple[LoadStep, ...]]:
    """The record without load steps and its linear fit, in the measure of the disturbance that this leaves.

    times: samples at which load steps are tried first; beside them more are sought.
    """
    whole = data
    steps: tuple[LoadStep, ...] = ()
    for _ in range(COLOURINGS):
        lead, limits = _straight(whole, linear, delays, times)
        bare, loads = _relieved(whole, data, lead, limits, 0, _most(times))
        steps = loads.steps
        colour = colour_of(bare, loads.left, lead, limits, 0)[0]
        data = bare.whitened(colour.a, 0, colour.law)
        linear = again_linear(data, linear, delays)
    return data, linear, steps


def calm_linear(
    data: Centred, linear: Fit, delays: float, times: tuple[int, ...]
) -> tuple[Centred, Fit, tuple[LoadStep, ...]] | None:
    """The same where noise alone is left beside the steps, or None.

    linear: fitted beside steps at these samples. What is coloured beside them at first was so in the end, too, in all
    of 374 cases (of 22 public records, and of this package's tests): it is not gone on with.
    """
    lead, limits = _straight(data, linear, delays, times)
    bare, loads = _relieved(data, data, lead, limits, 0, _most(times))
    if disturbance(loads.left, bare.floor).size > 1:
        return None
    found = coloured_linear(data, linear, delays, times)
    return found if found[0].a.size == 1 else None


def _straight(whole: Centred, linear: Fit, delays: float, times: tuple[int, ...]) -> tuple[Stem, Limits]:
    """OP's path with the linear fit, and the limits of the plant."""
    # It is no valve's to move, but beside steps of free sizes its plant moves on as a stem's does.
    lead = Stem(whole.u, 0, linear, lambda *_: whole.u, times=times)
    return lead, Limits((LEAST_TAU, float(whole.samples)), (0.0, delays))


def _most(times: tuple[int, ...]) -> int:
    """Load steps at most, where some are tried first."""
    return 2 * STEPS_MOST if times else STEPS_MOST
