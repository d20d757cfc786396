"""`wb.estimate`: a record to plant, valve, stem position, uncertainty and verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from statistics import median
from typing import NamedTuple

from workbench.detect.causes import below_step, between_values, beyond_op, kept_by_exception, no_percent
from workbench.detect.late import as_seen, earlier, words_of_late
from workbench.detect.spikes import words_of_spikes
from workbench.errors import InvalidValue
from workbench.estimate.answer import answer_of
from workbench.estimate.fits.data import PURPOSE, WHITE, Centred, centre
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, fit_linear, fit_nothing
from workbench.estimate.fits.sureness import SHARP
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.loads.swing import Answered, Swing, beside_swing, words_of_swing
from workbench.estimate.methods.refined import by_complementarity, jointly, refuse_complementarity
from workbench.estimate.methods.two_step import two_step
from workbench.estimate.plants import (
    CLEAR_BIC,
    ENDLESS,
    FAR_BIC,
    foretelling_of,
    levels_off,
    likelier_kind,
    ramps,
    swings_as_a_lag,
    with_other_plant,
)
from workbench.estimate.ranges.between import between_samples
from workbench.estimate.ranges.lagging import lagging
from workbench.estimate.ranges.scale import joined
from workbench.estimate.record_fits import DELAYS, LINEAR_DELAYS, Fits, first_fits, longest_delay
from workbench.estimate.repeat import repeats_of, words_of
from workbench.estimate.search.candidates import leaves_noise
from workbench.estimate.search.kinks import sums_up
from workbench.estimate.search.models import WORDS_OF_BLIND, words_of_open
from workbench.estimate.search.profile import Profile
from workbench.estimate.search.reach import searched
from workbench.estimate.search.stems import rising, silent
from workbench.estimate.sent import left_by_line, left_by_stem, likelier_op
from workbench.estimate.sooner import as_sent, words_of_sooner
from workbench.estimate.straight import Straight, free_of, linear_beside
from workbench.model.checks import callback, choice, number
from workbench.model.numbers import given
from workbench.model.plant import FOPDT
from workbench.model.record import Record
from workbench.model.results import Estimate, Intervals, Iteration, LinearFit
from workbench.model.valve import Ideal
from workbench.simulate.one_thread import one_thread

__all__ = ["estimate", "linear_loop"]

METHODS = ("profile", "joint", "two_step", "complementarity")
PROGRAMS = ("joint", "complementarity")  # go on from the profile with nonlinear programs
VALVES = ("auto", "linear", "stenman", "choudhury", "deadband")
PLANTS = ("fopdt", "integrating", "auto")
FIRST = 0.8  # of the progress told: the first kind of plant, as the other is seldom asked

WIDEST_GAIN = 0.2  # of the gain itself: a 95 % range wider than this does not identify a valve and what it does to PV
ALIKE, HALF = 1.25, 0.5  # times what a lag leaves along OP: a level that leaves more is none; and of PV itself
SLOW = 0.25  # of the record: a time constant that a lag seldom has, and the first fits of a level mostly have
BRIEF = 0.05  # of the record: a time constant that PV shows twenty times
WORDS_OF_IDEAL = (
    "the model told has no friction, which the valve has: its plant makes up for that, so that no ranges are given"
)
NAMES = {"fopdt": "a first-order process", "integrating": "an integrating process"}
WORDS_OF_ENDLESS = (
    "PV does not level off within the record, as an integrating process does not: a first-order one would need a time "
    "constant of half the record or more"
)


@one_thread
def estimate(
    record: Record,
    *,
    method: str = "profile",
    valve: str = "auto",
    plant: str = "auto",
    start: float | None = None,
    max_dead_time: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Estimate a loop from a record of PV and OP, in closed loop and without a test.

    method: "profile", the global profile over (d, first slip, dead time) with output-error refinement; "joint", the
    same and then the plant of its best few stem paths refined by nonlinear programs, with a drift and a coloured
    disturbance (see `methods.joint`; `noise_model` holds them); "two_step", the paper's alternating algorithm from the
    stiction `start` (%), whose valve is "stenman" alone; or "complementarity", for comparison: the profile, and from
    its best Stenman path one program in plant, d and stem together (see `methods.complementarity`; the result's field
    of that name holds what it found; 1,500 samples at most). valve: "stenman", "choudhury" (S, J), "deadband" (J = 0),
    "linear" (none), or "auto", the one that sticks with the lowest BIC. plant: "fopdt", "integrating", or "auto", the
    one that PV shows: the likelier is searched first, and the other too where that one leaves more than noise, stands
    beside load steps and leaves more than the other's first stems do without, or would need a time constant of half the
    record and more, as a level does; then the lower BIC decides.
    max_dead_time: s, the longest dead time searched, of up to a quarter of the record (default: 30 samples, and more
    where PV clearly shows a longer one, or steps far apart).
    progress: called with the share done, 0 to 1.

    Returns an `Estimate`; beside the model stands the linear fit that ignores stiction. Where stiction does not help
    ("no_stiction") the model is that linear fit with an ideal valve. intervals.d is the hull of all d whose fit the
    record cannot tell from the best, and None below ten stem moves, which do not pin the stem's unknown start (the
    plant's ranges then hold stems with S and J that slip some samples earlier or later too, see `ranges.few`); with
    valve "auto" every range holds those of the other sticking valves that fit as well too, and beside Stenman's the
    plant's of stems that rest short of OP (He's law, see `ranges.resting`); the plant's hold those of a stem or a
    process with a second lag (`ranges.lagging`). A valve that does not stick alike at every slip is told with the mean
    of its bands, where that is clearly likelier than one band for all beside what disturbs the loop, or where OP was
    recorded in steps, which hide some slips (`search.uneven`; 10,000 samples at most). Where the controller runs faster
    than the record, S, d and J are known to no less than OP's move in a sample, and the dead time may be half a sample
    longer (`ranges.between`). Where a search ended at its limit, or the record tells nothing, a range is open (see
    `Intervals`); so are the plant's of a linear loop whose setpoint stands still, where OP only answers PV. Where the
    verdict is "undecided" and a linear loop is not clearly less likely, the plant's ranges hold that one's too. A
    sticking valve by "two_step" has no ranges: it does not look for others that fit as well; nor has the linear model
    of a valve that sticks. Steps of the load that nobody recorded are fitted beside the model (`load_steps`, see
    `loads.steps`); a linear loop that leaves noise alone beside some is told, with its plant, or a dead band that is
    clearly likelier than that loop ("undecided", as nothing else accuses the valve). An oscillation from outside the
    loop, a sinusoid that is a quarter or more of what the model leaves, is fitted beside the model (`load_swing`;
    10,000 samples at most; not by "two_step"). A PV that is recorded later than the controller saw it is looked at as
    that did (`pv_late`), and an OP that is recorded later than it was sent, so that PV answers a sticking valve before,
    as it was sent (`op_late`, see `sooner`). Values of PV or OP that stand out from their neighbours alone are left out
    (`detect.spikes`). identifiable is True where the verdict is "stiction", no range is open, that hull is at most a
    tenth of d wide and gain's at most a fifth of the gain; not where PV was kept by exception or mostly lies between
    recorded values, whose error no range holds, nor for an OP that is no per cent (see `detect.causes`). Raises
    `RecordError` for a record that holds no information (too short, PV or OP constant, values that no plant has) or is
    too long for the method, and `InvalidValue` for arguments that are not allowed.
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
    callback(progress, "estimate.progress")
    if method == "complementarity":
        refuse_complementarity(record, valve)
        valve = "stenman"
    if method == "two_step" and valve not in ("auto", "stenman"):
        raise InvalidValue("estimate.valve", valve, "method 'two_step' knows the Stenman valve alone: stenman, or auto")
    tell = silent if progress is None else rising(progress)
    seen, late = as_seen(record, PURPOSE)
    asked = _Asked(method, valve, start, max_dead_time)
    # Where programs go on from the search, that is as much again.
    shares = 1 + (method in PROGRAMS)

    def search(one: Record) -> tuple[_Searched, tuple[str, ...]]:
        return _found(one, plant, asked, lambda share: tell(share / shares))

    if late.samples or method == "two_step":
        (found, said), sooner = search(seen), 0
    else:
        noise = partial(_noise_alone, asked)
        seen, (found, said), sooner = as_sent(seen, search, lambda one: one[0].answered, noise)
    answer = _told(seen, found, asked, lambda share: tell(1.0 - (1.0 - share) / shares))
    said += words_of_late(record, late) + words_of_sooner(sooner, record.sample_time)
    said += words_of_spikes(record) + _cut(record, max_dead_time)
    if answer.verdict == "stiction" and (why := _doubtful(seen, answer.valve.stick_band)):
        answer = replace(answer, verdict="undecided", identifiable=False, reasons=(why, *answer.reasons))
    if answer.verdict == "stiction" and isinstance(answer.valve, Ideal):
        answer = replace(answer, intervals=Intervals(), identifiable=False, reasons=(*answer.reasons, WORDS_OF_IDEAL))
    if unpinned := tuple(one for one in (no_percent(record.op), kept_by_exception(record)) if one):
        answer, said = replace(answer, identifiable=False), (*unpinned, *said)
    tell(1.0)
    return replace(
        answer,
        record=record,
        valve_position=earlier(answer.valve_position, late.samples),
        reasons=tuple(dict.fromkeys(answer.reasons + said)),
        pv_late=late.samples * record.sample_time,
        op_late=sooner * record.sample_time,
    )


def _found(
    record: Record, plant: str, asked: _Asked, tell: Callable[[float], None]
) -> tuple[_Searched, tuple[str, ...]]:
    """What the search comes to with the kind of plant that was asked for, and in words how the kinds compare."""
    if plant == "auto":
        return _likelier_plant(record, asked, tell)
    line = _straight(record, centre(record, plant), asked.max_dead_time)
    return _searched(record, _begun(record, plant, line, asked, tell), asked), ()


def _noise_alone(asked: _Asked, record: Record, kind: str) -> bool:
    """Whether a stem leaves noise alone with a kind of plant."""
    data = centre(record, kind)
    delays = longest_delay(data, asked.max_dead_time, DELAYS)
    return left_by_stem(data, _profile(data, asked.max_dead_time, silent), delays).noise


def _cut(record: Record, max_dead_time: float | None) -> tuple[str, ...]:
    """Say where dead times as long as were asked for are not searched."""
    most = max(len(record) // 4, 1) * record.sample_time
    if max_dead_time is None or max_dead_time <= most:
        return ()
    return (f"no dead time beyond a quarter of the record, {given(most, 4)} s, is searched: max_dead_time is longer",)


def _doubtful(record: Record, band: float) -> str:
    """Say why a stick band, %, may be none, by how the record was kept; or nothing."""
    return beyond_op(record.op, band) or below_step(record.op, band) or between_values(record)


class _Asked(NamedTuple):
    """What `estimate` was asked for; start: %, max_dead_time: s."""

    method: str
    valve: str
    start: float | None
    max_dead_time: float | None


@dataclass(frozen=True, eq=False)
class _Begun:
    """A record as it is taken with one kind of plant, its linear fit, and the first search, for Stenman's stem.

    valve: as asked for; history: of "two_step".
    """

    data: Centred
    valve: str
    line: Straight
    found: Profile | None
    history: tuple[Iteration, ...] = ()

    @cached_property
    def fits(self) -> Fits:
        """The first stems of any valve."""
        return _first_fits(self.data, self.valve, self.found, self.line)

    @property
    def rough(self) -> Fit:
        """The likeliest of the linear fit and Stenman's."""
        return min([self.line.fit] + ([] if self.found is None else [self.found.best.fit]), key=lambda fit: fit.sse)

    @property
    def noise_alone(self) -> bool:
        """Whether Stenman's stem leaves nothing for another plant."""
        return self.found is not None and leaves_noise(self.data, self.found.best)

    @cached_property
    def ramps(self) -> bool:
        """Whether a level is likelier than a first-order process along these; the two-step algorithm does not ask.

        Not where a stem close about them leaves noise alone, which leaves nothing for another plant.
        """
        if self.history or (self.valve not in ("stenman", "linear") and self.fits.clear):
            return False
        data, fits = self.data, self.fits
        stems = [(one.stem(data.u), one.begin, one.fit) for one in fits.coarse[:1]]
        if self.found is not None:
            best = self.found.best
            stems.append((best.stem(data.u), best.first, best.fit))
        return ramps(data, self.line.fit, stems, fits.limits)

    @property
    def likeliest(self) -> Fit:
        """The likeliest of the first fits of any valve."""
        return min([self.rough, *(band.fit for band in self.fits.coarse[:1])], key=lambda fit: fit.sse)


class _Searched(NamedTuple):
    """What a search came to with one kind of plant, and the oscillation that it stands beside."""

    answered: Answered[Estimate]
    swing: Swing | None


def _begun(record: Record, plant: str, line: Straight, asked: _Asked, tell: Callable[[float], None]) -> _Begun:
    """The beginning of the search with one kind of plant, from its linear fit."""
    data, longest = centre(record, plant), asked.max_dead_time
    tell(0.0)
    delays = longest_delay(data, longest, DELAYS)
    if asked.method == "two_step":
        return _Begun(data, asked.valve, line, *two_step(data, asked.start, delays))
    data, found = likelier_op(
        record,
        data,
        lambda one, told: _profile(one, longest, told),
        lambda one, model: left_by_stem(one, model, delays),
        tell,
    )
    return _Begun(data, asked.valve, line, found)


def _first_fits(data: Centred, valve: str, found: Profile | None, line: Straight) -> Fits:
    """The first stems of any valve; line: the linear fit, perhaps of the record with OP otherwise within its steps."""
    return first_fits(data, valve, found, line.fit if line.data is data else fit_linear(data, line.longest))


def _searched(record: Record, begun: _Begun, asked: _Asked) -> _Searched:
    """The search with one kind of plant, gone on with to its answer."""
    line, how = begun.line, (asked.method, asked.valve)
    answered = answer_of(record, how, begun.fits, line, begun.history)
    if asked.method == "two_step":
        return _Searched(answered, None)

    def again(calm: Centred) -> Answered[Estimate]:
        found, still = _profile(calm, asked.max_dead_time, silent), line.calm(calm)
        return answer_of(record, how, _first_fits(calm, asked.valve, found, still), still, begun.history)

    return _Searched(*beside_swing(begun.data, answered, again, line.longest))


def _told(record: Record, found: _Searched, asked: _Asked, tell: Callable[[float], None]) -> Estimate:
    """The estimate that a search comes to: by programs if they are asked for, with its ranges, repeats and words."""
    (answer, paths, settled, others), swing = found
    method, max_dead_time = asked.method, asked.max_dead_time
    data = settled.whitened(WHITE, 0)
    if method in PROGRAMS:
        usual = LINEAR_DELAYS if isinstance(answer.valve, Ideal) else 2.0 * paths[0].fit.theta + DELAYS
        limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest_delay(data, max_dead_time, int(usual))))
        refine, used = (jointly, data) if method == "joint" else (by_complementarity, settled)
        answer = refine(used, answer, paths, limits, tell)
    ranged = answer.verdict == "stiction" and answer.valve.stick_band > 0.0 and answer.intervals.gain is not None
    lags, lagged = lagging(settled, paths[0]) if ranged else (Intervals(), ())
    answer = replace(answer, intervals=reduce(joined, (*others, lags), answer.intervals))
    ranges, faster = between_samples(record, answer)
    answer = replace(answer, intervals=ranges)
    # Where OP's steps hide the stem, its parts tell no more than the whole.
    lost = data.doubt > 0.0 and answer.valve.stick_band > 0.0 and answer.intervals == Intervals()
    repeats = None if lost else repeats_of(data, answer)
    said = words_of(repeats) if repeats is not None and answer.verdict == "stiction" else ()
    blind = WORDS_OF_BLIND in answer.reasons
    opened = () if blind else words_of_open(answer.intervals, data.integrating)
    load = None if swing is None else swing.load(answer.plant, record.sample_time)
    swung = () if load is None else (words_of_swing(load, blind=blind),)
    return replace(
        answer,
        repeats=repeats,
        load_swing=load,
        # Of a controller that is faster than the record a lag may be no more than what moved between samples.
        reasons=answer.reasons + swung + opened + (faster or lagged) + said,
        identifiable=answer.identifiable and _sharp(answer) and not opened,
    )


@one_thread
def linear_loop(record: Record, plant: str = "auto") -> LinearFit:
    """Return a loop's linear model alone, for a valve that is known not to stick; plant: as in `estimate`.

    It is the model that `estimate` gives such a loop, without the search for stiction. Raises as that does.
    """
    choice(plant, "linear_loop.plant", PLANTS)
    record = as_seen(record, PURPOSE)[0]
    if plant == "auto":
        found = {one: _likeliest(_straight(record, centre(record, one), None)) for one in ("fopdt", "integrating")}
        return min(found.items(), key=lambda one: foretelling_of(record, *one, closely=True))[1].model
    return _likeliest(_straight(record, centre(record, plant), None)).model


def _likeliest(line: Straight) -> Answered[LinearFit]:
    """The linear model beside what disturbs the loop from outside."""
    return linear_beside(line, lambda one: one.likeliest)[0]


def _straight(record: Record, data: Centred, max_dead_time: float | None) -> Straight:
    longest = longest_delay(data, max_dead_time, LINEAR_DELAYS)
    data, fit = likelier_op(record, data, lambda one, _: fit_linear(one, longest), left_by_line)
    return Straight(data, fit, longest, free_of(record))


def _likelier_plant(record: Record, asked: _Asked, tell: Callable[[float], None]) -> tuple[_Searched, tuple[str, ...]]:
    """The search with the kind of plant that PV shows, and in words how the kinds compare.

    The likelier kind is searched first; the other one only where what that leaves asks for it.
    """
    lines = {one: _straight(record, centre(record, one), asked.max_dead_time) for one in ("fopdt", "integrating")}
    lag, ramp = lines["fopdt"].fit, lines["integrating"].fit
    begun: dict[str, _Begun] = {}

    def begin(plant: str) -> _Begun:
        if plant not in begun:
            done, share = (FIRST, 1.0 - FIRST) if begun else (0.0, FIRST)
            begun[plant] = _begun(record, plant, lines[plant], asked, lambda told: tell(done + share * told))
        return begun[plant]

    def search(plant: str) -> _Searched:
        return _searched(record, begin(plant), asked)

    # Without a stem, which costs the most: a lag that never levels off, and a level that leaves hardly more. Where that
    # is more than half of PV only a stem shows the plant.
    endless = lag.tau >= ENDLESS * len(record) and ramp.sse <= ALIKE * lag.sse
    endless = endless and (
        ramp.sse <= HALF * fit_nothing(lines["integrating"].data) or begin("integrating").noise_alone
    )
    level = endless or _slow(begin("fopdt")) or begin("fopdt").ramps
    first, second = ("integrating", "fopdt") if level else ("fopdt", "integrating")
    likelier = search(first)
    ahead = _decided(record, first, likelier.answered, lines[second])
    if ahead is not None and not _needless(record, likelier.answered, lambda: begin(second)):
        # Where more than noise is left, a stem may be what shows a lag that levels off.
        if first == "fopdt":
            return likelier, ()
        # Of an oscillation from outside a level takes a part for what its stem does; a lag has a stem of its own then.
        sticks, white = likelier.answered.model.verdict == "stiction", likelier.answered.settled.a.size == 1
        if not (sticks and (likelier.swing is not None or (not white and swings_as_a_lag(record, likelier.answered)))):
            if white or _endless(begin("fopdt")):
                return likelier, (WORDS_OF_ENDLESS,)
            if ahead > 0.0 and begin("fopdt").ramps:
                return likelier, (f"along this stem {NAMES[first]} has the lower BIC, by {given(ahead, 3)}",)
    other = search(second)
    found = {first: likelier, second: other}
    bics = {plant: foretelling_of(record, plant, one.answered, closely=True) for plant, one in found.items()}
    if (likelier.answered.model.verdict, other.answered.model.verdict) == ("no_stiction", "undecided"):
        # With a plant that may be it no valve that sticks is needed; what another would need says nothing against that.
        return likelier, ()
    level_off = levels_off(record, found["fopdt"].answered.model.plant)
    by = bics["integrating"] - bics["fopdt"]
    sticks = all(one.answered.model.verdict == "stiction" for one in found.values())
    leave = {one: each.answered.model.residual_variance for one, each in found.items()}
    plant = likelier_kind(by, levels_off=level_off, sticks=sticks, less=leave["fopdt"] < leave["integrating"])
    if not level_off and plant == "integrating":
        return found[plant], (WORDS_OF_ENDLESS,)
    if abs(by) < CLEAR_BIC:
        return found[plant], (f"the record hardly tells {NAMES['fopdt']} from {NAMES['integrating']}",)
    return found[plant], (f"{NAMES[plant]} has the lower BIC, by {given(abs(by), 3)}",)


def _endless(begun: _Begun) -> bool:
    """Whether the likelier of a first-order loop's linear fit and Stenman's never levels off within the record."""
    return begun.rough.tau >= ENDLESS * begun.data.samples


def _slow(begun: _Begun) -> bool:
    """Whether a first-order loop's first fits are so slow, or a long record's PV so kinked, that a level is likelier.

    Where Stenman's stem is not the valve's, only a likelier one may show what the plant is; and in all of a long record
    none of the first does, in whose windows a few slips are soon right.
    """
    if _endless(begun) or (begun.data.samples > WHOLE and sums_up(begun.data, begun.fits.limits.theta[1])):
        return True
    windows = [one.coarse[0].fit.tau / one.data.samples for one in begun.fits.within.windows if one.coarse]
    return (median(windows) if windows else begun.likeliest.tau / begun.data.samples) >= SLOW


def _needless(record: Record, answered: Answered[Estimate], begin: Callable[[], _Begun]) -> bool:
    """Whether an answer stands beside load steps, and the first fits with the other kind of plant leave less without.

    begin: the beginning of the other's search.
    """
    if not answered.model.load_steps:
        return False
    least, other = answered.model.residual_variance * len(record), begin()
    return other.rough.sse < least or other.likeliest.sse < least


def _decided(record: Record, kind: str, answered: Answered[Estimate], line: Straight) -> float | None:
    """By how much of BIC a kind of plant is likelier than the other along its stem, where that settles it, else None.

    line: the other's linear fit.
    """
    other = "integrating" if kind == "fopdt" else "fopdt"
    if not levels_off(record, answered.model.plant):
        return None
    closely = answered.settled.a.size > 1
    bic = foretelling_of(record, kind, answered, closely=closely)
    along = with_other_plant(record, other, answered, closely=closely)
    if not closely:
        # Who leaves noise alone leaves nothing for another, unless that does the same with less.
        return along - bic if bic <= along else None
    rival = foretelling_of(record, other, _likeliest(line), closely=closely)
    if answered.model.verdict == "no_stiction":
        return along - bic if bic - CLEAR_BIC <= rival else None
    plant = answered.model.plant
    if not isinstance(plant, FOPDT):
        # A lag as long as the record does as well along any stem: one that levels off would do better along this one.
        return along - bic if bic - CLEAR_BIC <= along and bic + FAR_BIC <= rival else None
    # The other's own stem may be a better one, but not by so much where PV is seen to level off again and again.
    brief = plant.time_constant <= BRIEF * len(record) * record.sample_time
    return along - bic if brief and bic + FAR_BIC <= min(along, rival) else None


def _profile(data: Centred, max_dead_time: float | None, tell: Callable[[float], None]) -> Profile | None:
    longest = longest_delay(data, max_dead_time, DELAYS)
    most = longest if max_dead_time is not None else data.samples / 4.0
    return searched(data, longest, most, lambda share: tell(0.1 + 0.9 * share))


def _sharp(found: Estimate) -> bool:
    """Whether the stick band is known closely; a stem whose gain may be anything is no model, however narrow it is."""
    low, high = found.intervals.d or found.intervals.S or (0.0, math.inf)
    least, most = found.intervals.gain or (0.0, math.inf)
    sharp = high - low <= SHARP * found.valve.stick_band
    return sharp and most - least <= WIDEST_GAIN * abs(found.plant.gain)
