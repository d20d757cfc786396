"""`wb.estimate`: a record to plant, valve, stem position, uncertainty and verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from typing import NamedTuple

import numpy as np

from workbench.detect.detect import detect
from workbench.detect.stem import Fitted
from workbench.errors import InvalidValue
from workbench.estimate.bands import Seek, coarse_of, like_stenman, repeated, sought
from workbench.estimate.data import WHITE, Centred, centre, plant_of
from workbench.estimate.dense import densely
from workbench.estimate.few import widened
from workbench.estimate.fit import (
    LEAST_TAU,
    Fit,
    Limits,
    disturbance,
    fit_linear,
    fit_nothing,
    predict,
)
from workbench.estimate.hidden import hidden, words_of_hidden
from workbench.estimate.models import (
    PLANT_PARAMETERS,
    VALVE_PARAMETERS,
    bands_of,
    choose,
    compared,
    reasons_of,
    words_of_open,
    words_of_rival,
)
from workbench.estimate.paths import band_paths, linear_path, stem_paths
from workbench.estimate.plants import foretelling_bic
from workbench.estimate.profile import Profile, islands, search
from workbench.estimate.refined import by_complementarity, jointly, refuse_complementarity
from workbench.estimate.repeat import repeats_of, words_of
from workbench.estimate.scale import (
    band_of,
    band_position,
    joined,
    linear_intervals,
    linear_result,
    rivals_of,
    stem_of,
)
from workbench.estimate.sent import left_by_line, left_by_stem, likelier_op
from workbench.estimate.settled import coloured_linear, settled
from workbench.estimate.stems import path_of, silent
from workbench.estimate.swing import Answered, Swing, beside_swing, besides, words_of_swing
from workbench.estimate.two_parameter import look
from workbench.estimate.two_step import akaike, two_step
from workbench.estimate.verdict import ENOUGH_SLIPS, SHARP, WIDE_D, Evidence, agree, judge
from workbench.estimate.windows import WHOLE
from workbench.model.checks import choice, number
from workbench.model.loads import LoadStep
from workbench.model.record import Record
from workbench.model.results import Estimate, Intervals, Iteration, LinearFit
from workbench.model.valve import Choudhury, Ideal, Stenman
from workbench.record.modes import manual_share, mode_words

__all__ = ["estimate", "linear_loop"]

METHODS = ("profile", "joint", "two_step", "complementarity")
PROGRAMS = ("joint", "complementarity")  # go on from the profile with nonlinear programs
VALVES = ("auto", "linear", "stenman", "choudhury", "deadband")
PLANTS = ("fopdt", "integrating", "auto")

# Dead times searched by default, in samples, doubled while the best fit lies at the end.
DELAYS = 30
LINEAR_DELAYS = 240
WIDEST_GAIN = 0.5  # of the gain itself: a 95 % range wider than this does not identify a valve
CLEAR_BIC = 10.0  # R. Kass, A. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795: "very strong" evidence above it
HALF = 0.5  # of what the linear fit leaves: a stem that leaves no more explains PV by itself
MUCH_MANUAL = 0.05  # share of the record in manual that is worth a word


def estimate(
    record: Record,
    *,
    method: str = "profile",
    valve: str = "auto",
    plant: str = "fopdt",
    start: float | None = None,
    max_dead_time: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Estimate a loop from a record of PV and OP, in closed loop and without a test.

    method: "profile", the global profile over (d, first slip, dead time) with output-error refinement; "joint", the
    same and then the plant of its best few stem paths refined by nonlinear programs, with a drift and a coloured
    disturbance (see `estimate.joint`; `noise_model` holds them); "two_step", the paper's alternating algorithm from
    the stiction `start` (%), whose valve is "stenman"; or "complementarity", for comparison: the profile, and from its
    best Stenman path one program in plant, d and stem together (see `estimate.complementarity`; the result's field of
    that name holds what it found; 1,500 samples at most). valve: "stenman", "choudhury" (S, J), "deadband" (J = 0),
    "linear" (none), or "auto", the one that sticks with the lowest BIC. plant: "fopdt", "integrating", or "auto", the
    one with the lower BIC among the same valves (twice the time).
    max_dead_time: s, the longest dead time searched (default: 30 samples, more where the best fit asks for it).
    progress: called with the share done, 0 to 1.

    Returns an `Estimate`; beside the model stands the linear fit that ignores stiction. Where stiction does not help
    ("no_stiction") the model is that linear fit with an ideal valve. intervals.d is the hull of all d whose fit the
    record cannot tell from the best, and None below ten stem moves, which do not pin the stem's unknown start (the
    plant's ranges then hold stems with S and J that slip some samples earlier or later too, see `estimate.few`); with
    valve "auto" every range holds those of the other sticking valves that fit as well too. Where a search ended at its
    limit, or the record tells nothing, a range is open (see `Intervals`). A sticking valve by "two_step" has no ranges:
    it does not look for others that fit as well. An oscillation from outside the loop, a sinusoid that is a quarter or
    more of what the model leaves, is fitted beside the model (`load_swing`; 10,000 samples at most; not by "two_step").
    identifiable is True where the verdict is "stiction", no range is open, that hull is at most a tenth of d wide and
    gain's at most half of the gain. Raises `RecordError` for a record that holds no information (too short, PV or OP
    constant, values that no plant has) or is too long for the method, and `InvalidValue` for arguments that are not
    allowed.
    """
    if not isinstance(record, Record):
        raise InvalidValue("estimate.record", type(record).__name__, "must be a Record (see read_record)")
    choice(method, "estimate.method", METHODS)
    choice(valve, "estimate.valve", VALVES)
    choice(plant, "estimate.plant", PLANTS)
    if start is not None:
        if method != "two_step":
            raise InvalidValue("estimate.start", start, "only method 'two_step' starts from an initial stiction")
        start = number(start, "estimate.start", above=0.0, unit="%")
    if max_dead_time is not None:
        max_dead_time = number(max_dead_time, "estimate.max_dead_time", least=0.0, unit="s")
    if method == "complementarity":
        refuse_complementarity(record, valve)
        valve = "stenman"
    tell = silent if progress is None else _rising(progress)
    if plant == "auto":
        return _better_plant(record, (method, valve), start, max_dead_time, tell)
    return _with_plant(record, plant, (method, valve), start, max_dead_time, tell)[0]


def _with_plant(
    record: Record,
    plant: str,
    asked: tuple[str, str],
    start: float | None,
    max_dead_time: float | None,
    tell: Callable[[float], None],
) -> tuple[Estimate, Swing | None]:
    """The estimate with one kind of plant, by method and valve as asked, and the oscillation that it stands beside."""
    method = asked[0]
    data = centre(record, plant)
    tell(0.0)
    line = _straight(record, data, max_dead_time)
    delays = _longest(data, max_dead_time, DELAYS)
    history: tuple[Iteration, ...] = ()
    found: Profile | None
    if method == "two_step":
        found, history = two_step(data, start, delays)
    else:
        data, found = likelier_op(
            record,
            data,
            lambda one, told: _profile(one, max_dead_time, told),
            lambda one, model: left_by_stem(one, model, delays),
            (lambda share: tell(0.5 * share)) if method in PROGRAMS else tell,
        )
    answered = _answer(record, data, asked, found, line, history)
    swing: Swing | None = None
    if method != "two_step":

        def again(calm: Centred) -> Answered[Estimate]:
            still = _Straight(calm, fit_linear(calm, line.longest), line.longest)
            return _answer(record, calm, asked, _profile(calm, max_dead_time, silent), still, history)

        answered, swing = beside_swing(data, answered, again, line.longest)
    answer, paths, settled, others = answered
    data = settled.whitened(WHITE, 0)
    if method in PROGRAMS:
        usual = LINEAR_DELAYS if isinstance(answer.valve, Ideal) else 2.0 * paths[0].fit.theta + DELAYS
        limits = Limits((LEAST_TAU, float(data.samples)), (0.0, _longest(data, max_dead_time, int(usual))))
        refine, used = (jointly, data) if method == "joint" else (by_complementarity, settled)
        answer = refine(used, answer, paths, limits, lambda share: tell(0.5 + 0.5 * share))
    answer = replace(answer, intervals=reduce(joined, others, answer.intervals))
    # Where OP's steps hide the stem, its parts tell no more than the whole.
    lost = data.doubt > 0.0 and answer.valve.stick_band > 0.0 and answer.intervals == Intervals()
    repeats = None if lost else repeats_of(data, answer)
    said = words_of(repeats) if repeats is not None and answer.verdict == "stiction" else ()
    tell(1.0)
    opened = words_of_open(answer.intervals, data.integrating)
    load = None if swing is None else swing.load(answer.plant, record.sample_time)
    swung = () if load is None else (words_of_swing(load),)
    told = replace(
        answer,
        repeats=repeats,
        load_swing=load,
        reasons=answer.reasons + swung + opened + said,
        identifiable=answer.identifiable and _sharp(answer) and not opened,
    )
    return told, swing


def linear_loop(record: Record, plant: str = "fopdt") -> LinearFit:
    """Return a loop's linear model alone, for a valve that is known not to stick; plant: as in `estimate`.

    It is the model that `estimate` gives such a loop, without the search for stiction. Raises as that does.
    """
    choice(plant, "linear_loop.plant", PLANTS)
    if plant == "auto":
        found = {one: _line_with_plant(record, one) for one in ("fopdt", "integrating")}
        bics = {
            one: foretelling_bic(besides(centre(record, one), swing), fit.plant, Ideal(), record.op, fit.prediction)
            for one, (fit, swing) in found.items()
        }
        return found[min(bics, key=lambda one: bics[one])][0]
    return _line_with_plant(record, plant)[0]


def _line_with_plant(record: Record, plant: str) -> tuple[LinearFit, Swing | None]:
    """The linear model with one kind of plant, and the oscillation that it stands beside."""
    line = _straight(record, centre(record, plant), None)

    def settled(line: _Straight) -> Answered[LinearFit]:
        data, linear, _ = coloured_linear(*line)
        return Answered(linear_result(data, linear), linear_path(data, linear), data, ())

    def again(calm: Centred) -> Answered[LinearFit]:
        return settled(_Straight(calm, fit_linear(calm, line.longest), line.longest))

    answered, swing = beside_swing(line.data, settled(line), again, line.longest)
    return answered.model, swing


class _Straight(NamedTuple):
    """The linear fit to a record whose OP is as it explains more of PV; longest: the longest delay, samples."""

    data: Centred
    fit: Fit
    longest: float


def _straight(record: Record, data: Centred, max_dead_time: float | None) -> _Straight:
    longest = _longest(data, max_dead_time, LINEAR_DELAYS)
    return _Straight(*likelier_op(record, data, lambda one, _: fit_linear(one, longest), left_by_line), longest)


def _better_plant(
    record: Record,
    asked: tuple[str, str],
    start: float | None,
    max_dead_time: float | None,
    tell: Callable[[float], None],
) -> Estimate:
    """The estimate with the plant of the lower BIC, and in words by how much."""
    method, valve = asked
    quick = "profile" if method in PROGRAMS else method, valve
    shares = 3 if method in PROGRAMS else 2

    def part(i: int) -> Callable[[float], None]:
        return lambda share: tell((i + share) / shares)

    found = {
        plant: _with_plant(record, plant, quick, start, max_dead_time, _rising(part(i)))
        for i, plant in enumerate(("fopdt", "integrating"))
    }
    bics = {
        plant: foretelling_bic(
            besides(centre(record, plant), swing), one.plant, one.valve, one.valve_position, one.prediction
        )
        for plant, (one, swing) in found.items()
    }
    plant = min(bics, key=lambda name: bics[name])
    answer = found[plant][0]
    if method in PROGRAMS:
        answer = _with_plant(record, plant, asked, None, max_dead_time, _rising(part(2)))[0]
    words = {"fopdt": "a first-order process", "integrating": "an integrating process"}
    by = max(bics.values()) - bics[plant]
    said = f"{words[plant]} has the lower BIC, by {by:.3g}"
    if by < CLEAR_BIC:
        said += ": the record hardly tells it from " + next(w for name, w in words.items() if name != plant)
    return replace(answer, reasons=(*answer.reasons, said))


def _rising(progress: Callable[[float], None]) -> Callable[[float], None]:
    """Progress that never falls: a search that goes on to longer dead times begins anew."""
    most = 0.0

    def tell(share: float) -> None:
        nonlocal most
        most = max(most, share)
        progress(most)

    return tell


def _longest(data: Centred, max_dead_time: float | None, usual: int) -> float:
    """The longest dead time to search, in samples, never above `max_dead_time`; a quarter of the record at most."""
    most = max(data.samples // 4, 1)
    if max_dead_time is None:
        return float(min(usual, max(data.samples // 10, 1) if usual == DELAYS else most))
    return min(max_dead_time / data.sample_time, float(most))


def _profile(data: Centred, max_dead_time: float | None, tell: Callable[[float], None]) -> Profile | None:
    longest = _longest(data, max_dead_time, DELAYS)
    while True:
        found = search(data, longest, lambda share: tell(0.1 + 0.9 * share))
        if found is None or not found.at_limit or max_dead_time is not None or 2 * longest > data.samples // 4:
            return found
        longest *= 2


def leaves_noise_alone(data: Centred, found: Profile, linear: Fit) -> bool:
    """Whether a Stenman valve explains all of PV but white noise, of which a valve with more freedom can take nothing.

    Only where it does so by a stem of its own: with slips enough, a sharp d, and much less left than the linear fit's.
    """
    best = found.best
    d = [end for c in found.alike for end in (c.d_low, c.d_high)]
    if best.slips < ENOUGH_SLIPS or max(d) - min(d) > SHARP * best.d or best.fit.sse > HALF * linear.sse:
        return False
    left = data.y - predict(data, path_of(data.u, best.d_low, best.first)[0], best.first, best.fit)[0]
    return disturbance(left, data.floor).size == 1


def _answer(
    record: Record,
    data: Centred,
    asked: tuple[str, str],
    found: Profile | None,
    line: _Straight,
    history: tuple[Iteration, ...],
) -> Answered[Estimate]:
    linear = line.fit if line.data is data else fit_linear(data, line.longest)
    n = data.samples
    method, valve = asked
    straight = linear_result(data, linear)
    # The rival of the verdict is as causal as the stem model: a long dead time passes for half a cycle.
    delays = found.limits.theta[1] if found is not None else _longest(data, None, DELAYS)
    rival = linear if linear.theta <= delays else fit_linear(data, delays)
    wide = [] if found is None else [c.fit.sse / n for c in found.fits if c.d >= WIDE_D * data.op_range]
    other = None if found is None else found.best.fit
    alone = found is not None and leaves_noise_alone(data, found, rival)
    seek: Seek = partial(like_stenman, found) if alone else look
    within = sought(data, delays, other, alone and valve == "auto", seek)
    coarse = coarse_of(data, within, delays, seek)
    bands, limits = {}, Limits((LEAST_TAU, float(n)), (0.0, delays))
    if method != "two_step" and valve not in ("stenman", "linear"):
        seeds = coarse if alone or n > WHOLE else [*coarse, *like_stenman(found, data, delays)]
        dense = () if alone else densely(data, coarse, delays)
        bands = bands_of(data, seeds, within, limits, within.rival(other), beside=dense)
    steps: tuple[LoadStep, ...] = ()
    # The verdict weighs what each model leaves of PV; the model itself is fitted in the measure that its disturbance
    # asks for.
    if method != "two_step":
        data, found, bands, linear, steps = settled(data, found, bands, linear, delays, within)
    stem = None if found is None else stem_of(data, found)
    if stem is not None and method == "two_step":
        # It knows nothing of stems that fit as well as the one in which it ended.
        stem = replace(stem, intervals=Intervals())
    left = math.inf if stem is None else float(np.mean((record.pv - stem.prediction) ** 2))
    evidence = Evidence(
        samples=n,
        variance=data.variance,
        # A load step is no stiction: where there is one, both have it.
        linear=min(rival.sse / n, linear_result(data, linear).residual_variance) if steps else rival.sse / n,
        stem=left,
        slips=0 if found is None else found.best.slips,
        d=math.nan if found is None else found.best.d,
        gain=0.0 if found is None else found.best.fit.gain,
        op_range=data.op_range,
        nothing=fit_nothing(data) / n,
        wide=min(wide, default=math.inf),
        two_parameter=coarse[0].fit.sse / n if coarse else math.inf,
        bands=(coarse[0].S, coarse[0].J) if coarse else (0.0, 0.0),
        linear_delay=rival.theta / n,
        tau=0.0 if found is None or data.integrating else found.best.fit.tau / n,
        d_range=None if stem is None else stem.intervals.d,
        islands=() if found is None else islands(found),
        exact=found is None or found.exact,
        at_limit=found is not None and found.at_limit,
        method=method,
        iterations=len(history),
    )
    models = compared(data, linear, found, bands)
    chosen = choose(models, "stenman" if method == "two_step" else valve)
    verdict, reasons, identifiable = judge(evidence)
    if chosen in bands and verdict == "stiction":
        # The range of d is that of another valve than the one chosen.
        reasons = judge(replace(evidence, d_range=None))[1]
    fitted: Fitted | None = None if found is None or stem is None else (Stenman(found.best.d), stem.valve_position)
    leader = next((name for name in models if name in bands), None)
    if leader is not None and models[leader].bic < models.get("stenman", models[leader]).bic + 1e-9:
        pair = bands[leader].best
        fitted = (Choudhury(pair.S, pair.J), band_position(data, pair))
    verdict, reasons = agree(evidence, verdict, reasons, detect(record, fitted=fitted))
    identifiable = identifiable and verdict == "stiction"
    ranged = None
    if chosen in bands and verdict != "no_stiction":
        there = within if data.y is within.pv else sought(data, delays, None, within.contested)
        ranged = repeated(data, bands[chosen], limits, there)
        ranged = widened(data, ranged, bands[chosen].only, limits)
    if ranged is not None and ranged.best is not bands[chosen].best:
        bands = bands | {chosen: replace(bands[chosen], best=ranged.best)}
        models = compared(data, linear, found, bands)
    best = bands[chosen].best if chosen in bands else None if found is None else found.best
    stuck = best is not None and chosen != "linear" and verdict != "no_stiction" and best.fit.gain != 0.0
    lost = stuck and best is not None and hidden(data, best)
    if verdict != "no_stiction":
        reasons += reasons_of(models, chosen, valve, None if lost else ranged)
    reasons += _manual_said(record)
    if ranged is not None:
        stem = band_of(data, ranged, chosen, limits)
        identifiable = verdict == "stiction" and ranged.best.slips >= ENOUGH_SLIPS
    others = () if stem is None else stem.parts
    if stem is not None and lost:
        stem = replace(stem, intervals=Intervals())
        reasons += (words_of_hidden(data.doubt),)
    elif stem is not None and valve == "auto" and method != "two_step" and verdict != "no_stiction":
        rivals = rivals_of(data, chosen, found, bands, limits)
        others += tuple(rivals.values())
        reasons += tuple(words_of_rival(name, ranges, data.integrating) for name, ranges in rivals.items())
    if not stuck:
        data, linear, steps = coloured_linear(*line)
        straight = linear_result(data, linear)
    profile_d = np.array([] if found is None else [c.d for c in found.fits])
    profile_cost = np.array([] if found is None else [c.fit.sse / n for c in found.fits])
    if best is None or stem is None or not stuck:
        unstuck = Estimate(
            record=record,
            method=method,
            plant=straight.plant,
            valve=Ideal(),
            valve_position=record.op.copy(),
            prediction=straight.prediction,
            bias=straight.bias,
            verdict=verdict,
            reasons=reasons,
            intervals=linear_intervals(data, linear, line.longest),
            identifiable=False,
            residual_variance=straight.residual_variance,
            aic=straight.aic,
            noise_sd=math.sqrt(straight.residual_variance),
            slips=0,
            linear=straight,
            profile_d=profile_d,
            profile_cost=profile_cost,
            iterations=history,
            candidates=tuple(models.values()),
            load_steps=steps,
        )
        return Answered(unstuck, linear_path(data, linear), data, ())
    # Of the prediction itself: where the model's columns are nearly dependent, the normal equations lose digits.
    sse = float(((record.pv - stem.prediction) ** 2).sum())
    sticking = Estimate(
        record=record,
        method=method,
        plant=plant_of(data, best.fit.gain, best.fit.tau, best.fit.theta),
        valve=models[chosen].valve,
        valve_position=stem.valve_position,
        prediction=stem.prediction,
        bias=stem.bias,
        verdict=verdict,
        reasons=reasons,
        intervals=stem.intervals,
        identifiable=identifiable,
        residual_variance=sse / n,
        aic=akaike(data, sse, PLANT_PARAMETERS + VALVE_PARAMETERS[chosen] - data.integrating + len(data.answers)),
        noise_sd=float(np.sqrt(np.mean((record.pv - stem.prediction)[data.skip :] ** 2))),
        slips=best.slips,
        linear=straight,
        profile_d=profile_d,
        profile_cost=profile_cost,
        iterations=history,
        candidates=tuple(models.values()),
        load_steps=steps,
    )
    paths = [] if found is None else stem_paths(data, found)
    if ranged is not None:
        paths = band_paths(data, ranged, chosen)
    return Answered(sticking, paths, data, others)


def _sharp(found: Estimate) -> bool:
    """Whether the stick band is known closely; a stem whose gain may be anything is no model, however narrow it is."""
    low, high = found.intervals.d or found.intervals.S or (0.0, math.inf)
    least, most = found.intervals.gain or (0.0, math.inf)
    sharp = high - low <= SHARP * found.valve.stick_band
    return sharp and most - least <= WIDEST_GAIN * abs(found.plant.gain)


def _manual_said(record: Record) -> tuple[str, ...]:
    share = 0.0 if record.mode is None else manual_share(record.mode)
    if record.mode is None or share < MUCH_MANUAL:
        return ()
    said = f"the controller was in manual in {share:.0%} of the record ({mode_words(record.mode)})"
    return (f"{said}: a stretch in automatic alone would show the loop better",)
