"""`wb.estimate`: a record to plant, valve, stem position, uncertainty and verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

from workbench.detect.causes import beyond_op
from workbench.detect.late import as_seen, earlier, words_of_late
from workbench.detect.spikes import words_of_spikes
from workbench.errors import InvalidValue
from workbench.estimate.answer import answer_of
from workbench.estimate.data import PURPOSE, WHITE, Centred, centre
from workbench.estimate.fit import LEAST_TAU, Limits, fit_linear
from workbench.estimate.models import WORDS_OF_BLIND, words_of_open
from workbench.estimate.plants import foretelling_bic
from workbench.estimate.profile import Profile
from workbench.estimate.reach import searched
from workbench.estimate.record_fits import DELAYS, LINEAR_DELAYS, longest_delay
from workbench.estimate.refined import by_complementarity, jointly, refuse_complementarity
from workbench.estimate.repeat import repeats_of, words_of
from workbench.estimate.scale import joined
from workbench.estimate.sent import left_by_line, left_by_stem, likelier_op
from workbench.estimate.stems import silent
from workbench.estimate.straight import Straight, linear_beside
from workbench.estimate.swing import Answered, Swing, beside_swing, besides, words_of_swing
from workbench.estimate.two_step import two_step
from workbench.estimate.verdict import SHARP
from workbench.model.checks import choice, number
from workbench.model.numbers import given
from workbench.model.record import Record
from workbench.model.results import Estimate, Intervals, Iteration, LinearFit
from workbench.model.valve import Ideal
from workbench.simulate.one_thread import one_thread

__all__ = ["estimate", "linear_loop"]

METHODS = ("profile", "joint", "two_step", "complementarity")
PROGRAMS = ("joint", "complementarity")  # go on from the profile with nonlinear programs
VALVES = ("auto", "linear", "stenman", "choudhury", "deadband")
PLANTS = ("fopdt", "integrating", "auto")

WIDEST_GAIN = 0.2  # of the gain itself: a 95 % range wider than this does not identify a valve and what it does to PV
CLEAR_BIC = 10.0  # R. Kass, A. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795: "very strong" evidence above it


@one_thread
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
    max_dead_time: s, the longest dead time searched (default: 30 samples, and up to a quarter of the record where PV
    clearly shows a longer one).
    progress: called with the share done, 0 to 1.

    Returns an `Estimate`; beside the model stands the linear fit that ignores stiction. Where stiction does not help
    ("no_stiction") the model is that linear fit with an ideal valve. intervals.d is the hull of all d whose fit the
    record cannot tell from the best, and None below ten stem moves, which do not pin the stem's unknown start (the
    plant's ranges then hold stems with S and J that slip some samples earlier or later too, see `estimate.few`); with
    valve "auto" every range holds those of the other sticking valves that fit as well too. Where a search ended at its
    limit, or the record tells nothing, a range is open (see `Intervals`); so are the plant's of a linear loop whose
    setpoint stands still, where OP only answers PV. Where the verdict is "undecided" and a linear loop is not clearly
    less likely, the plant's ranges hold that one's too. A sticking valve by "two_step" has no ranges:
    it does not look for others that fit as well. An oscillation from outside the loop, a sinusoid that is a quarter or
    more of what the model leaves, is fitted beside the model (`load_swing`; 10,000 samples at most; not by "two_step").
    A PV that is recorded later than the controller saw it is looked at as that did (`pv_late`), and values of PV or OP
    that stand out from their neighbours alone are left out (`detect.spikes`).
    identifiable is True where the verdict is "stiction", no range is open, that hull is at most a tenth of d wide and
    gain's at most a fifth of the gain. Raises `RecordError` for a record that holds no information (too short, PV or OP
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
    seen, late = as_seen(record, PURPOSE)
    asked = _Asked(method, valve, start, max_dead_time)
    # A search for each plant, and where programs go on from one as much again.
    shares = (1 if plant != "auto" else 2) + (method in PROGRAMS)
    said: tuple[str, ...] = ()
    if plant == "auto":
        found, said = _better_plant(seen, asked, tell, shares)
    else:
        found = _searched(seen, plant, asked, lambda share: tell(share / shares))
    answer = _told(seen, found, asked, lambda share: tell(1.0 - (1.0 - share) / shares))
    said += words_of_late(record, late) + words_of_spikes(record)
    if answer.verdict == "stiction" and (wide := beyond_op(seen.op, answer.valve.stick_band)):
        answer = replace(answer, verdict="undecided", identifiable=False, reasons=(wide, *answer.reasons))
    tell(1.0)
    return replace(
        answer,
        record=record,
        valve_position=earlier(answer.valve_position, late.samples),
        reasons=answer.reasons + said,
        pv_late=late.samples * record.sample_time,
    )


class _Asked(NamedTuple):
    """What `estimate` was asked for; start: %, max_dead_time: s."""

    method: str
    valve: str
    start: float | None
    max_dead_time: float | None


class _Searched(NamedTuple):
    """What a search came to with one kind of plant, and the oscillation that it stands beside."""

    answered: Answered[Estimate]
    swing: Swing | None


def _searched(record: Record, plant: str, asked: _Asked, tell: Callable[[float], None]) -> _Searched:
    """The search with one kind of plant."""
    method, valve, start, max_dead_time = asked
    data = centre(record, plant)
    tell(0.0)
    line = _straight(record, data, max_dead_time)
    delays = longest_delay(data, max_dead_time, DELAYS)
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
            tell,
        )
    answered = answer_of(record, data, (method, valve), found, line, history)
    swing: Swing | None = None
    if method != "two_step":

        def again(calm: Centred) -> Answered[Estimate]:
            still = Straight(calm, fit_linear(calm, line.longest), line.longest)
            return answer_of(record, calm, (method, valve), _profile(calm, max_dead_time, silent), still, history)

        answered, swing = beside_swing(data, answered, again, line.longest)
    return _Searched(answered, swing)


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
    answer = replace(answer, intervals=reduce(joined, others, answer.intervals))
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
        reasons=answer.reasons + swung + opened + said,
        identifiable=answer.identifiable and _sharp(answer) and not opened,
    )


@one_thread
def linear_loop(record: Record, plant: str = "fopdt") -> LinearFit:
    """Return a loop's linear model alone, for a valve that is known not to stick; plant: as in `estimate`.

    It is the model that `estimate` gives such a loop, without the search for stiction. Raises as that does.
    """
    choice(plant, "linear_loop.plant", PLANTS)
    record = as_seen(record, PURPOSE)[0]
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
    answered, swing = linear_beside(_straight(record, centre(record, plant), None))
    return answered.model, swing


def _straight(record: Record, data: Centred, max_dead_time: float | None) -> Straight:
    longest = longest_delay(data, max_dead_time, LINEAR_DELAYS)
    return Straight(*likelier_op(record, data, lambda one, _: fit_linear(one, longest), left_by_line), longest)


def _better_plant(
    record: Record, asked: _Asked, tell: Callable[[float], None], shares: int
) -> tuple[_Searched, tuple[str, ...]]:
    """The search with the plant of the lower BIC, and in words by how much."""

    def part(i: int) -> Callable[[float], None]:
        return lambda share: tell((i + share) / shares)

    found = {
        plant: _searched(record, plant, asked, _rising(part(i))) for i, plant in enumerate(("fopdt", "integrating"))
    }
    bics = {}
    for plant, ((one, *_), swing) in found.items():
        data = besides(centre(record, plant), swing)
        bics[plant] = foretelling_bic(data, one.plant, one.valve, one.valve_position, one.prediction)
    plant = min(bics, key=lambda name: bics[name])
    words = {"fopdt": "a first-order process", "integrating": "an integrating process"}
    by = max(bics.values()) - bics[plant]
    said = f"{words[plant]} has the lower BIC, by {given(by, 3)}"
    if by < CLEAR_BIC:
        said += ": the record hardly tells it from " + next(w for name, w in words.items() if name != plant)
    return found[plant], (said,)


def _rising(progress: Callable[[float], None]) -> Callable[[float], None]:
    """Progress that never falls: a search that goes on to longer dead times begins anew."""
    most = 0.0

    def tell(share: float) -> None:
        nonlocal most
        most = max(most, share)
        progress(most)

    return tell


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
