"""A record's answer: all models fitted, the verdict over them, and the one that is told, with its ranges."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from workbench.detect.action import only_answers
from workbench.detect.detect import detect
from workbench.detect.scan import runs_faster
from workbench.detect.stem import WIDE
from workbench.detect.stem_search import Fitted
from workbench.detect.verdict import beyond_doubt
from workbench.estimate.fits.data import plant_of
from workbench.estimate.fits.fit import LEAST_TAU, Limits, fit_nothing
from workbench.estimate.fits.sureness import ENOUGH_SLIPS, SURE_SLIPS
from workbench.estimate.loads.settled import coloured_linear
from workbench.estimate.loads.steps import CLEAR, DEGREES
from workbench.estimate.loads.swing import Answered
from workbench.estimate.outside import CHANCE, Rival, rival_of, weighed
from workbench.estimate.ranges.freed import Loaded
from workbench.estimate.ranges.hidden import hidden, words_of_hidden
from workbench.estimate.ranges.scale import (
    InScale,
    band_of,
    band_position,
    linear_intervals,
    linear_result,
    rivals_of,
    short_of,
    stem_of,
    uneven_of,
    unknown,
    without_jump,
)
from workbench.estimate.ranges.unseen import unseen, words_of_likelier, words_of_unseen
from workbench.estimate.record_fits import (
    Fits,
    about,
    closely,
    first_fits,
    likelier_pair,
    sound,
    unevenly,
    whiter,
    with_ranges,
)
from workbench.estimate.search.bands import Bands
from workbench.estimate.search.candidates import Candidate
from workbench.estimate.search.models import (
    PLANT_PARAMETERS,
    STICKING,
    VALVE_PARAMETERS,
    WORDS_OF_BLIND,
    WORDS_OF_STRAIGHT,
    akaike,
    choose,
    reasons_of,
    words_of_calm,
    words_of_closer,
    words_of_rival,
)
from workbench.estimate.search.paths import band_paths, linear_path, stem_paths, uneven_paths
from workbench.estimate.search.profile import islands, search
from workbench.estimate.search.two_parameter import Band
from workbench.estimate.search.uneven import Uneven, words_of_uneven
from workbench.estimate.straight import MOST, Coloured, Straight, level
from workbench.estimate.verdict import Evidence, agree, judge
from workbench.model.detection import Detection
from workbench.model.record import Record
from workbench.model.results import Estimate, Intervals, Iteration, LinearFit
from workbench.model.valve import Choudhury, Ideal
from workbench.record.modes import manual_said

__all__ = ["answer_of"]

BARE_MENTION = 2.0  # of BIC: up to it a difference is "not worth more than a bare mention" (R. Kass, A. Raftery, 1995)


class _Said(NamedTuple):
    """A verdict, its reasons in words, and whether the stiction is identified; sure: whether its ranges may say so."""

    verdict: str
    reasons: tuple[str, ...]
    identifiable: bool
    sure: bool = True


@dataclass(frozen=True, eq=False)
class _Asked:
    """What is asked of a record, and its linear loop; history: of "two_step", which knows of no other stem.

    white: the linear fit as if what disturbs the loop were white, which ignores stiction.
    """

    record: Record
    method: str
    valve: str
    line: Straight
    history: tuple[Iteration, ...]
    white: LinearFit

    @property
    def two_step(self) -> bool:
        return self.method == "two_step"

    @property
    def coloured(self) -> Coloured:
        """The linear loop in the measure of what disturbs it, with its load steps."""
        return self.line.coloured if self.two_step else self.line.likeliest

    @property
    def calm(self) -> bool:
        """Whether the linear loop leaves noise alone beside load steps."""
        data, _, steps = self.coloured
        return bool(steps) and data.a.size == 1

    @property
    def seldom(self) -> bool:
        """Whether the load steps are few, and none may be the valve's work as the setpoint moves."""
        at = [round(step.at / self.record.sample_time) for step in self.coloured[2]]
        return len(at) <= MOST and self.line.free is not None and bool(self.line.free[at].all())

    @cached_property
    def loaded(self) -> Loaded | None:
        """The record with the linear loop's load steps; None without any, or where what is left beside is coloured."""
        bare, _, steps = self.coloured
        limits = Limits((LEAST_TAU, float(bare.samples)), (0.0, self.line.longest))
        return Loaded.of(self.line.data, bare, steps, limits) if steps and bare.a.size == 1 else None

    @cached_property
    def blind(self) -> bool:
        """Whether nobody moves the loop: a stem that slips moves PV by itself, a linear loop only answers."""
        return only_answers(self.record)


def answer_of(
    record: Record, asked: tuple[str, str], fits: Fits, line: Straight, history: tuple[Iteration, ...]
) -> Answered[Estimate]:
    """Return the answer that a record's first fits lead to.

    asked: method and valve; line: the linear fit; history: of "two_step".
    """
    loop = _Asked(record, *asked, line, history, linear_result(fits.data, fits.linear))
    early = None if loop.two_step else _atfirst_fits(record, fits, loop.method)
    if early is not None and early[0].verdict == "no_stiction":
        own = loop.coloured if fits.data is line.data else coloured_linear(fits.data, fits.linear, line.longest)
        fits = sound(fits, loop.valve, *own[:2])
        return _told_straight(loop, fits, _reasoned(loop, fits, "linear", early[0], None))
    # Stems that accuse the valve seldom leave anything for load steps to explain.
    first, open_yet = fits, early is not None and early[0].verdict == "undecided"
    if open_yet and (calm := _told_calm(loop, first)) is not None:
        return calm
    fits = fits if loop.two_step else closely(fits, loop.valve)
    stem = None if fits.found is None else stem_of(fits.data, fits.found)
    if stem is not None and loop.two_step:
        # It knows nothing of stems that fit as well as the one in which it ended.
        stem = replace(stem, intervals=Intervals())
    chosen = choose(fits.models, "stenman" if loop.two_step else loop.valve)
    said, rival = _weighed(loop, fits, chosen, stem, None if early is None else early[1])
    maybe = said.verdict != "no_stiction"
    if not loop.two_step and _doubted(loop, fits, chosen, said.verdict, open_yet) and not _likelier(loop, fits, chosen):
        if not open_yet and (calm := _told_calm(loop, first)) is not None:
            return calm
        said = said._replace(verdict="undecided", reasons=(words_of_calm(loop.coloured[2]), *said.reasons))
        return _told_straight(loop, fits, _reasoned(loop, fits, "linear", said, None))
    # What nothing else accuses has no slips to tell apart; a faster controller moves OP as the record does not show.
    if said.verdict == "stiction" and not loop.two_step and not runs_faster(record):
        fits = unevenly(first, fits, loop.valve)
        if fits.uneven:
            return _told_unevenly(loop, fits, fits.uneven[0])
    ranged: Bands | None = None
    if maybe and chosen in fits.bands:
        fits, ranged = with_ranges(fits, chosen)
        stem = band_of(fits.data, ranged, chosen, fits.limits)
        known = said.sure and said.verdict == "stiction" and ranged.best.slips >= ENOUGH_SLIPS
        said = said._replace(identifiable=known)
        fits = replace(fits, bands=fits.bands | {chosen: replace(fits.bands[chosen], best=ranged.best)})
    best = fits.best(chosen) if maybe and chosen in STICKING else None
    if best is None or stem is None or best.fit.gain == 0.0:
        return _told_straight(loop, fits, _reasoned(loop, fits, chosen, said, ranged))
    return _told_stem(loop, fits, chosen, best, said, stem, ranged, rival)


def _told_unevenly(loop: _Asked, fits: Fits, best: Uneven) -> Answered[Estimate]:
    """The answer whose model is a valve that does not stick alike at every slip, where another stem accused it."""
    stem = uneven_of(fits.data, fits.uneven, fits.limits)
    said, rival = _weighed(loop, fits, best.name, stem, None)
    # Bands of two parameters have more room to make up for a wrong plant.
    enough = ENOUGH_SLIPS if best.sticks else SURE_SLIPS
    sticks = said.verdict == "stiction"
    known = said.sure and sticks and best.slips >= enough
    said = said._replace(verdict="stiction" if sticks else "undecided", identifiable=known)
    return _told_stem(loop, fits, best.name, best, said, stem, None, rival)


def _told_calm(loop: _Asked, fits: Fits) -> Answered[Estimate] | None:
    """The answer of a loop whose valve is acquitted once its load steps are taken out of PV; None where it is not.

    Steps spoil every plant that is fitted without them, and stems are then seen in what the plant leaves. The linear
    loop beside them must leave noise alone, and far less than any of the first stems, the steps paid for.
    """
    data, linear, steps = loop.coloured
    if not loop.calm or not loop.seldom:
        return None
    first = [*([] if fits.found is None else [fits.found.best.fit]), *(b.fit for b in fits.coarse[:1])]
    least = min((max(fit.sse / data.samples, data.floor) for fit in first), default=math.inf)
    price = DEGREES * len(steps) * math.log(data.samples) + CLEAR
    if data.samples * math.log(least / max(linear.sse / data.samples, data.floor)) < price:
        return None
    still = first_fits(data, loop.valve, search(data, fits.limits.theta[1]), linear)
    seen = replace(loop.record, pv=loop.record.pv - (data.load - loop.line.data.load))
    calm = _atfirst_fits(loop.record, still, loop.method, seen)
    if calm is None or calm[0].verdict != "no_stiction":
        return None
    said = calm[0]._replace(reasons=(words_of_calm(steps), *calm[0].reasons))
    still = sound(still, loop.valve, data, linear)
    return _told_straight(loop, still, _reasoned(loop, still, "linear", said, None))


def _doubted(loop: _Asked, fits: Fits, chosen: str, verdict: str, open_yet: bool) -> bool:
    """Whether load steps may be what the chosen valve was seen in; open_yet: whether the first stems accused nobody."""
    best = fits.best(chosen) if chosen in STICKING else None
    # A stem that leaves noise alone leaves nothing for load steps.
    few = best is not None and best.slips < ENOUGH_SLIPS and fits.data.a.size > 1
    if verdict == "stiction" and not few and not open_yet:
        return False
    return verdict != "no_stiction" and loop.calm and (verdict == "undecided" or few or loop.seldom)


def _likelier(loop: _Asked, fits: Fits, chosen: str) -> bool:
    """Whether the chosen valve has a lower BIC than the linear loop beside load steps."""
    best = fits.best(chosen) if chosen in STICKING else None
    if best is None or best.fit.gain == 0.0:
        return False
    free = VALVE_PARAMETERS[chosen] * math.log(fits.data.samples)
    return level(fits.data, best.fit, fits.steps) + free < level(*loop.coloured)


def _weighed(
    loop: _Asked, fits: Fits, chosen: str, stem: InScale | None, seen: Detection | None
) -> tuple[_Said, Rival | None]:
    """The verdict on the chosen valve, and a linear loop that may as well be; seen: detection of the first stems."""
    # Once it is convinced, detection asks for no likelier stem.
    if seen is None or seen.verdict != "stiction":
        seen = _detected(loop.record, fits, stem, likelier_pair(fits))
    said = _judged(fits, chosen, _evidence(loop.record, fits, stem, loop.method, len(loop.history)), seen)
    if seen.test is not None and seen.test.steps:
        # A step of the load that was missed, or is not quite where it was, moves the gain.
        said = said._replace(identifiable=False, sure=False)
    # Where a linear loop is asked for, the likeliest stem is what accuses the valve.
    accused = chosen if chosen in STICKING else next((name for name in fits.models if name in STICKING), "")
    known = None if loop.two_step or not accused else fits.best(accused)
    if known is None:
        return said, None
    times = tuple(round(step.at / fits.data.sample_time) for step in fits.steps)
    rival = cache(lambda: rival_of(fits.data, known.fit, loop.line, times))
    # Without steps of its own a stem that nothing else accuses may be no more than the likeness of one.
    if not (seen.test is not None and beyond_doubt(seen.test)) if said.verdict == "stiction" else bool(fits.steps):
        pairs = (known.fit, fits.models[accused]), (fits.linear, fits.models["linear"])
        verdict, reason = weighed(fits.data, *pairs, rival, said.verdict, seen.verdict != "stiction")
        if reason:
            said = _Said(verdict, (reason, *said.reasons), identifiable=False, sure=False)
    return said, rival() if said.verdict == "undecided" and rival().ahead < CHANCE else None


def _atfirst_fits(
    record: Record, fits: Fits, method: str, seen: Record | None = None
) -> tuple[_Said, Detection] | None:
    """The verdict of the first stems and of detection, which tries the likeliest of them; None where stems say enough.

    seen: the record that detection sees, if another one: without load steps.
    Where it acquits the valve nothing is gained by a close search for a stem that the loop does not have.
    """
    stem = None if fits.found is None else stem_of(fits.data, fits.found)
    evidence = _evidence(record, fits, stem, method, 0)
    if judge(evidence)[0] == "stiction":
        return None
    pair = min(fits.coarse, key=lambda one: one.fit.sse, default=None)
    if pair is not None and fits.found is not None and fits.found.best.fit.sse <= pair.fit.sse:
        pair = None
    found = _detected(record if seen is None else seen, fits, stem, pair)
    return _judged(fits, "linear", evidence, found), found


def _evidence(record: Record, fits: Fits, stem: InScale | None, method: str, iterations: int) -> Evidence:
    """What the verdict of the fitted models rests on; stem: the profile's."""
    data, found, lead, coarse, n = fits.data, fits.found, fits.lead, fits.coarse, fits.data.samples
    linear = fits.rival.sse / n
    return Evidence(
        samples=n,
        variance=data.variance,
        floor=data.floor,
        # A load step is no stiction: where there is one, both have it.
        linear=min(linear, linear_result(data, fits.linear).residual_variance) if fits.steps else linear,
        stem=math.inf if stem is None else float(np.mean((record.pv - stem.prediction) ** 2)),
        slips=0 if lead is None else lead.slips,
        d=math.nan if lead is None else lead.d,
        gain=0.0 if lead is None else lead.fit.gain,
        op_range=data.op_range,
        nothing=fit_nothing(data) / n,
        wide=fits.wide,
        two_parameter=coarse[0].fit.sse / n if coarse else math.inf,
        bands=(coarse[0].S, coarse[0].J) if coarse else (0.0, 0.0),
        linear_delay=fits.rival.theta / n,
        tau=0.0 if lead is None or data.integrating else lead.fit.tau / n,
        d_range=None if stem is None else stem.intervals.d,
        islands=() if found is None or fits.uneven else islands(found),
        exact=found is None or found.exact,
        at_limit=found is not None and found.at_limit,
        method=method,
        iterations=iterations,
    )


def _detected(record: Record, fits: Fits, stem: InScale | None, pair: Band | None) -> Detection:
    """What detection says, which tries the profile's stem, or the two-parameter one that is likelier than it, too."""
    fitted: Fitted | None = None
    if fits.lead is not None and stem is not None:
        fitted = (fits.lead.valve, stem.valve_position)
    if pair is not None:
        fitted = (Choudhury(pair.S, pair.J), band_position(fits.data, pair))
    if fits.data.doubt > 0.0:
        # The linear loop has the same OP as the stem: within its steps, where the record's are coarser.
        record = replace(record, op=fits.data.u + fits.data.op_middle, rest=())
    return detect(record, fitted=fitted)


def _judged(fits: Fits, chosen: str, evidence: Evidence, detection: Detection) -> _Said:
    """The verdict of the fitted models and of detection."""
    verdict, reasons, identifiable = judge(evidence)
    if chosen in fits.bands and verdict == "stiction":
        # The range of d is that of another valve than the one chosen.
        reasons = judge(replace(evidence, d_range=None))[1]
    verdict, reasons = agree(evidence, verdict, reasons, detection)
    return _Said(verdict, reasons, identifiable and verdict == "stiction")


def _reasoned(loop: _Asked, fits: Fits, chosen: str, said: _Said, ranged: Bands | None) -> _Said:
    """The verdict with what else is to be said of the models and the record; ranged: the two-parameter valve told."""
    reasons = said.reasons
    if said.verdict != "no_stiction":
        if not loop.two_step and chosen in STICKING and (closer := words_of_closer(fits.models, chosen)):
            said, reasons = said._replace(identifiable=False), reasons + closer
        reasons += reasons_of(fits.models, chosen, loop.valve, ranged)
    return said._replace(reasons=reasons + manual_said(loop.record.mode))


def _told_straight(loop: _Asked, fits: Fits, said: _Said) -> Answered[Estimate]:
    """The answer whose model is the linear loop."""
    data, linear, steps = loop.coloured
    said, answer = said._replace(identifiable=False), linear_result(data, linear)
    ranges, others = linear_intervals(data, linear, loop.line.longest), tuple[Intervals, ...]()
    if loop.blind and ranges != Intervals():
        said, others = said._replace(reasons=(*said.reasons, WORDS_OF_BLIND)), (unknown(answer.plant),)
    elif loop.valve != "linear" and not loop.two_step:
        found = unseen(data, linear, loop.line.longest, loop.loaded)
        words: tuple[str, ...] = ()
        seed, doubt = None, False
        if found is not None:
            words, others = words_of_unseen(found, ranges, data.integrating), (found.plant,)
            # Who is acquitted hides no band over much of OP's range, unless the plant is the same.
            doubt = bool(words) and said.verdict == "no_stiction" and found.band >= WIDE * data.op_range
            # Of what real healthy loops leave, coloured as it is, a narrow band may take as much by chance.
            asked = doubt or said.verdict == "undecided" or data.a.size == 1
            seed = found.best if asked and found.ahead >= math.log(data.samples) + CLEAR else None
        alone = seed is None
        seed = seed or whiter(fits, loop.coloured)
        banded = None if seed is None else _told_band(loop, fits, (*words, *said.reasons), seed, alone)
        if banded is not None:
            return banded._replace(others=(*banded.others, *others))
        reasons = (*words, *said.reasons) if doubt else (*said.reasons, *words)
        said = said._replace(verdict="undecided" if doubt else said.verdict, reasons=reasons)
    told = _linear_estimate(loop, replace(fits, steps=steps), said, answer)
    return Answered(replace(told, intervals=ranges), linear_path(data, linear), data, others)


def _told_band(
    loop: _Asked, fits: Fits, reasons: tuple[str, ...], seed: Band, alone: bool
) -> Answered[Estimate] | None:
    """The answer whose model is a valve (S, J) that is likelier than the linear loop, or None where none clearly is.

    Each has the load steps that it needs. Nothing else accuses the valve, which is not acquitted then. reasons: for the
    linear loop; seed: the stem that the search goes on from; alone: it has to leave noise alone. Of what real healthy
    loops leave no stem does, though it may take some of that by chance.
    """
    bare, linear, _ = loop.coloured
    if loop.valve not in ("auto", "deadband"):
        return None
    fits = about(fits, loop.line.data, bare, seed, linear)
    chosen = choose(fits.models, loop.valve)
    if chosen not in fits.bands:
        return None
    fits, ranged = with_ranges(fits, chosen)
    b, free = ranged.best, VALVE_PARAMETERS[chosen] * math.log(bare.samples)
    ahead = level(*loop.coloured) - level(fits.data, b.fit, fits.steps)
    if b.fit.gain == 0.0 or ahead < free + CLEAR or (alone and fits.data.a.size > 1):
        return None
    fits = replace(fits, bands=fits.bands | {chosen: replace(fits.bands[chosen], best=b)})
    stem = band_of(fits.data, ranged, chosen, fits.limits)
    said = _Said("undecided", (words_of_likelier(fits.models[chosen].valve, 0.5 * ahead), *reasons), identifiable=False)
    return _told_stem(loop, fits, chosen, b, said, stem, ranged, None)


def _told_stem(
    loop: _Asked,
    fits: Fits,
    chosen: str,
    best: Band | Candidate | Uneven,
    said: _Said,
    stem: InScale,
    ranged: Bands | None,
    rival: Rival | None,
) -> Answered[Estimate]:
    """The answer whose model is a valve that sticks.

    rival: a linear loop that may as well be, whose plant the ranges then hold too.
    """
    data = fits.data
    lost, others = not isinstance(best, Uneven) and hidden(data, best), stem.parts
    said = _reasoned(loop, fits, chosen, said, None if lost else ranged)
    reasons = said.reasons
    if lost:
        stem, reasons = replace(stem, intervals=Intervals()), (*reasons, words_of_hidden(data.doubt))
    elif loop.valve == "auto" and not loop.two_step:
        rivals = {} if fits.uneven else rivals_of(data, chosen, fits.found, fits.bands, fits.limits)
        dead = fits.bands.get("deadband") if chosen == "choudhury" else None
        if dead is not None and fits.models["deadband"].bic <= fits.models[chosen].bic + BARE_MENTION:
            rivals["deadband"] = without_jump(data, fits.whole, dead, fits.limits, fits.steps)
        if chosen == "stenman" and not isinstance(best, Band):
            rivals |= short_of(data, fits.whole, best, fits.limits, fits.steps)
        others += tuple(rivals.values())
        reasons += tuple(words_of_rival(name, ranges, data.integrating) for name, ranges in rivals.items())
    reasons += words_of_uneven(best, data.doubt) if isinstance(best, Uneven) else ()
    plant = plant_of(data, best.fit.gain, best.fit.tau, best.fit.theta)
    if rival is not None:
        # As the likeliest rival and as it would be told by itself.
        straight = (rival.answered.settled, rival.answered.paths[0].fit), loop.coloured[:2]
        others += (unknown(plant),) if loop.blind else tuple(linear_intervals(*o, loop.line.longest) for o in straight)
        reasons += (WORDS_OF_BLIND if loop.blind else WORDS_OF_STRAIGHT,)
    answer = _linear_estimate(loop, fits, said._replace(reasons=reasons), loop.white)
    # Of the prediction itself: where the model's columns are nearly dependent, the normal equations lose digits.
    left = loop.record.pv - stem.prediction
    sse = float((left**2).sum())
    parameters = PLANT_PARAMETERS + VALVE_PARAMETERS[chosen] - data.integrating + len(data.answers)
    answer = replace(
        answer,
        plant=plant,
        valve=fits.models[chosen].valve,
        valve_position=stem.valve_position,
        prediction=stem.prediction,
        bias=stem.bias,
        intervals=stem.intervals,
        residual_variance=sse / data.samples,
        aic=akaike(data, sse, parameters),
        noise_sd=float(np.sqrt(np.mean(left[data.skip :] ** 2))),
        slips=best.slips,
    )
    if isinstance(best, Uneven):
        return Answered(answer, uneven_paths(fits.uneven), data, others)
    paths = [] if fits.found is None else stem_paths(data, fits.found)
    return Answered(answer, paths if ranged is None else band_paths(data, ranged, chosen), data, others)


def _linear_estimate(loop: _Asked, fits: Fits, said: _Said, straight: LinearFit) -> Estimate:
    """An estimate whose model is the linear fit, without ranges."""
    profiled = () if fits.found is None else fits.found.fits
    return Estimate(
        record=loop.record,
        method=loop.method,
        plant=straight.plant,
        valve=Ideal(),
        valve_position=loop.record.op.copy(),
        prediction=straight.prediction,
        bias=straight.bias,
        verdict=said.verdict,
        reasons=said.reasons,
        intervals=Intervals(),
        identifiable=said.identifiable,
        residual_variance=straight.residual_variance,
        aic=straight.aic,
        noise_sd=math.sqrt(straight.residual_variance),
        slips=0,
        linear=straight,
        profile_d=np.array([c.d for c in profiled]),
        profile_cost=np.array([c.fit.sse / fits.data.samples for c in profiled]),
        iterations=loop.history,
        candidates=tuple(fits.models.values()),
        load_steps=fits.steps,
    )
