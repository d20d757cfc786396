"""The evidence in words: every statistic with what it measures, its source, its limits, and what it says."""

from __future__ import annotations

import math
from collections.abc import Iterator

from workbench.detect.bicoherence import LONG, NONLINEAR, SHORTEST
from workbench.detect.correlation import LAGS, VALUES
from workbench.detect.load import DETECTIONS
from workbench.detect.oscillation import OSCILLATES, REGULAR, no_period
from workbench.detect.shape import TRIANGLES, UNANSWERED
from workbench.detect.verdict import Thresholds, beyond_chance, curved, excluded
from workbench.model.detection import NONLINEARITY, NOT_ASKED, Detection, Statistic
from workbench.model.numbers import given

__all__ = ["statistics_of"]

FOR, AGAINST, OPEN = "for stiction", "against stiction", "no decision"
STILL = "PV or OP never moves"


def statistics_of(found: Detection, bicoherence: bool) -> tuple[Statistic, ...]:
    """Return every statistic of a detection, what decides the verdict first.

    bicoherence: whether the bicoherence and the ellipse were asked for. Limits are those of the sources, but for the
    stem test and the recorded stem, which stand on `Thresholds`.
    """
    dead = found.test is None  # PV or OP never moves
    why = STILL if dead else no_period(found.cycle)
    return (
        *_stem_test(found),
        *_recorded_stem(found),
        *_oscillation(found, why),
        *_phase(found, why),
        *_shape(found, why),
        *_nonlinear(found, why, bicoherence),
    )


def _undefined(why: str) -> str:
    return f"not defined here: {why}"


def _says(value: float, none: float, some: float, why: str) -> str:
    """Return which side of two limits a statistic lies on: up to `none` no stiction, from `some` on stiction."""
    if math.isnan(value):
        return _undefined(why)
    return AGAINST if value <= none else FOR if value >= some else OPEN


def _stem_test(found: Detection) -> Iterator[Statistic]:
    test, limits = found.test, Thresholds()
    nan, better = math.nan, 0.0 if test is None else limits.simulates(test)
    alone = f"PV's own turns no better, simulated PV {f'better by {better:.0%}' if better else 'no worse'}"
    both, three = "these two together", "these four together"
    rows = (
        (
            "Stem test, two rivals",
            "log likelihood ratio of a stem to the linear loop, and to a prediction by PV's and OP's past: the less",
            "",
            nan if test is None else test.sure,
            limits.sure if test is None else limits.surely(test),
            alone,
        ),
        (
            "Stem test, prediction alone",
            "share of what a linear loop leaves of PV unpredicted that the stem explains which predicts best",
            "%",
            nan if test is None else 100.0 * (1.0 - math.exp(-test.predicting / test.samples)),
            100.0 * limits.much,
            both,
        ),
        (
            "Stem test, its likelihood",
            "log likelihood ratio of that stem to the linear loop",
            "",
            nan if test is None else test.predicting,
            limits.sole,
            both,
        ),
        (
            "Stem test, prediction",
            "the same share for the stem that is best by prediction and simulation together",
            "%",
            nan if test is None else 100.0 * test.improvement,
            100.0 * limits.predicts,
            three,
        ),
        (
            "Stem test, likelihood",
            "log likelihood ratio of that stem to the linear loop",
            "",
            nan if test is None else test.likelihood,
            limits.likelihood,
            three,
        ),
        (
            "Stem test, simulation",
            "share of what the linear loop leaves of PV when simulated from OP alone that it explains",
            "%",
            nan if test is None else 100.0 * test.simulated,
            100.0 * limits.explains,
            three,
        ),
        (
            "Stem test, what it adds",
            "its log likelihood ratio to the predictor by PV's and OP's past; with their squares where little is left",
            "",
            nan if test is None else test.adds,
            limits.chance,
            three,
        ),
    )
    for name, measures, unit, value, least, route in rows:
        needed = f"stiction needs {least:g}{' %' if unit else ''} or more, {route}"
        says = "enough for stiction" if value >= least else "too little for stiction"
        if value >= least and route == alone and test is not None:
            missing = "simulated PV does not bear it out" if test.simulated < better else ""
            missing = "PV's own turns tell more" if test.turned < 0.0 else missing
            says = f"enough, yet {missing}: not for stiction" if missing else says
        says = _undefined(STILL) if math.isnan(value) else says
        yield Statistic(name, measures, "", value, unit, needed, says, decides=True)
    yield Statistic(
        "Stem test, load steps",
        "log likelihood ratio of the best stem to the linear loop under a few load steps, or ramps; a stem that moved "
        "often may have them too",
        "",
        nan if test is None else test.loaded,
        "",
        f"stiction needs {limits.chance:g} or more, by prediction alone {limits.sole:g}",
        _undefined(STILL)
        if test is None
        else "the linear loop does as well"
        if test.loaded < limits.chance
        else "the linear loop does worse",
        decides=True,
    )
    yield Statistic(
        "Stem test, steady wave",
        "how far the best stem predicts PV, beside OP or in its place, ahead of a rectangular or triangular load",
        "",
        nan if test is None else test.waved,
        "",
        f"stiction needs {limits.chance:g} or more",
        _undefined(STILL)
        if test is None
        else "such a load does as well"
        if test.waved < limits.chance
        else "such a load does worse",
        decides=True,
    )
    yield Statistic(
        "Stem test, a curved plant",
        "log likelihood ratio of the prediction by PV's and OP's past with their squares to that without",
        "",
        nan if test is None else test.squares,
        "",
        f"{limits.sole:g} or more shows a curve; beside it stiction needs a stem that adds {limits.chance:g} or more",
        _undefined(STILL)
        if test is None
        else "not asked: the linear loop leaves much"
        if test.squares == 0.0
        else "no curve shows"
        if test.squares < limits.sole
        else "a curve of the plant does as well as a stem"
        if curved(test, limits)
        else "a stem tells more than a curve of the plant",
        decides=True,
    )
    yield Statistic(
        "Stem test, PV's own turns",
        "how far the stem that adds most to a prediction by PV's and OP's past is ahead of what PV behind a dead band "
        "adds",
        "",
        nan if test is None else test.turned,
        "",
        "stiction by two rivals needs 0 or more",
        _undefined(STILL)
        if test is None
        else "not asked: two rivals say too little"
        if test.turned == 0.0
        else "they tell more: something turns PV before OP"
        if test.turned < 0.0
        else "they tell less",
        decides=True,
    )
    yield Statistic(
        "Stem test, in OP's place",
        "the less of a stem's log likelihood ratios to the linear loop, to a prediction by PV's and OP's past, and "
        "between that and one with the stem for OP",
        "",
        nan if test is None else test.instead,
        "",
        f"no stiction is not said from {limits.sole:g} on",
        _undefined(STILL) if test is None else "too much to exclude stiction" if test.instead >= limits.sole else OPEN,
        decides=True,
    )
    wide = nan if test is None else test.wide
    yield Statistic(
        "Stem test, wide bands",
        "log likelihood ratio to the linear loop of the best stem that sticks over a quarter of OP's range or more",
        "",
        wide,
        "",
        f"up to −{limits.excluded:g} such stems are excluded; up to {limits.chance:g} chance, up to 0 where PV is seen "
        "to follow OP",
        _undefined(STILL)
        if test is None
        else "not asked: the model's stem leaves no doubt"
        if math.isnan(wide)
        else f"a band of {given(test.wide_from, 3)} % or more is excluded"
        if excluded(test, limits)
        else "wide bands are not excluded"
        if beyond_chance(test, limits)
        else "no more than chance",
        decides=True,
    )
    clear = test is not None and test.improvement >= limits.much and test.simulated >= limits.most
    unexplained = nan if test is None else 100.0 * test.unexplained
    yield Statistic(
        "Left by the linear loop",
        "share of PV's variance that the linear loop, simulated from OP alone, leaves: what there is to explain",
        "",
        unexplained,
        "%",
        f"stiction needs {100.0 * limits.left:g} % or more, or a prediction better by {100.0 * limits.much:g} % and a "
        f"simulation better by {100.0 * limits.most:g} %",
        _undefined(STILL)
        if test is None
        else "there is something to explain"
        if test.unexplained >= limits.left
        else "little, but the stem predicts clearly better"
        if clear
        else "too little",
        decides=True,
    )


def _recorded_stem(found: Detection) -> Iterator[Statistic]:
    stem, limits = found.stem, Thresholds()
    if found.record.valve_position is None:
        return
    value = math.nan if stem is None else 100.0 * math.sqrt(stem.follows)
    says = _undefined("OP never moves")
    if stem is not None:
        follows, sticks = stem.follows < limits.direct, stem.sticks <= 0.5 * stem.follows
        says = "the stem follows OP" if follows else f"it sticks over {given(stem.band, 3)} %" if sticks else OPEN
    yield Statistic(
        "Recorded stem",
        "how far the measured valve position leaves a straight line through OP, as a share of its moves",
        "",
        value,
        "%",
        f"below {100.0 * math.sqrt(limits.direct):g} % it follows; else stiction where a sticking stem explains half",
        says,
        decides=True,
    )


def _oscillation(found: Detection, why: str) -> Iterator[Statistic]:
    cycle = found.cycle
    seen = math.isfinite(cycle.period)
    none = "" if seen else _undefined("PV's autocorrelation crosses zero less than four times in half the record")
    brief = "" if seen else _undefined(why)
    yield Statistic(
        "Oscillation index",
        "autocorrelation of PV one period on: 0 for noise, 1 for a perfect sinusoid",
        "",
        cycle.index if seen else math.nan,
        "",
        f"from {OSCILLATES:g} on a cycle",
        none or ("PV cycles" if cycle.index >= OSCILLATES else "hardly a cycle"),
    )
    yield Statistic(
        "Oscillation period",
        "twice the mean interval between zero crossings of PV's autocorrelation",
        "Thornhill, Huang and Zhang 2003",
        cycle.period,
        "s",
        "",
        brief or f"{given(cycle.cycles, 3)} periods recorded",
    )
    yield Statistic(
        "Regularity",
        "mean of those intervals over three times their standard deviation",
        "Thornhill, Huang and Zhang 2003",
        cycle.regularity if seen else math.nan,
        "",
        f"above {REGULAR:g} regular",
        brief or ("a regular oscillation" if cycle.regularity > REGULAR else "not regular"),
    )
    often = found.load_index >= DETECTIONS
    yield Statistic(
        "Load index",
        "weighted number of load disturbances in 50 periods, counted by the error's area between zero crossings",
        "Hägglund 1995",
        math.nan if why else found.load_index,
        "",
        f"from {DETECTIONS:g} on an oscillation",
        _undefined(why) if why else "an oscillation that matters" if often else "fewer than an oscillation makes",
    )


def _phase(found: Detection, why: str) -> Iterator[Statistic]:
    crossing = why or "the cross-correlation does not cross zero on both sides of lag 0"
    both = (("lags", LAGS, "of its zero crossings about lag 0"), ("values", VALUES, "of its value at lag 0"))
    for value, (name, (none, some), what) in zip(found.correlation, both, strict=True):
        yield Statistic(
            f"Cross-correlation, {name}",
            f"asymmetry {what}, OP with PV: 1 where PV lags a quarter of a cycle, 0 in or against phase; "
            "self-regulating loops",
            "Horch 1999",
            value,
            "",
            f"from {given(some, 3)} on stiction, up to {given(none, 3)} none",
            _says(value, none, some, crossing),
        )
    yield Statistic(
        "Histogram fit",
        "how much better a bell than a sinusoid's two humps describes PV's second derivative; integrating loops",
        "Horch 2000",
        found.histogram,
        "",
        "from −1 to 1, above 0 stiction",
        _says(found.histogram, 0.0, 0.0, why or "fewer than 12 samples in a period, or too short a record"),
    )


def _shape(found: Detection, why: str) -> Iterator[Statistic]:
    none, some = TRIANGLES
    for name, value, loops in (("OP", found.triangle, "self-regulating"), ("PV", found.triangle_pv, "integrating")):
        yield Statistic(
            f"Triangles in {name}",
            f"misfit of half sines over that of half sines and triangles together, fitted to {name}; {loops} loops",
            "He, Wang, Pottmann and Qin 2007",
            value,
            "",
            f"from {some:g} on stiction, up to {none:g} none",
            _says(value, none, some, why or "no half period has six samples"),
        )
    still = STILL if found.test is None else "the record holds no three moves"
    whats = ("while PV stands still", "while PV stands still, less what a stem would not do next")
    for name, value, what in zip(("ρ₁", "ρ₃"), found.movement, whats, strict=True):
        yield Statistic(
            f"Moves without answer, {name}",
            f"share of the time in which OP moves {what}; flow loops",
            "Yamashita 2006",
            value,
            "",
            f"above {UNANSWERED:g} stiction",
            _undefined(still) if math.isnan(value) else FOR if value > UNANSWERED else AGAINST,
        )


def _nonlinear(found: Detection, why: str, asked: bool) -> Iterator[Statistic]:
    n, bic = found.stretch[1] - found.stretch[0], found.bicoherence
    where = "" if n == len(found.record) else " at constant SP"
    missing = NOT_ASKED
    if asked:
        short = f"the record is too short: {n} samples{where}, at least {SHORTEST} needed"
        missing = "SP − PV never moves" if n >= SHORTEST else short
    doubt = "" if n >= LONG else f", but in fewer samples than the authors' {LONG:,} chance shows as well"
    period = found.cycle.period / found.record.sample_time
    if bic is not None and period * float(bic.frequency_1.min()) > 1.0:
        length = 1.0 / float(bic.frequency_1.min())
        doubt += f"; with segments of {length:.0f} samples it does not see the cycle, which takes {period:.0f}"
    ngi, nli = (math.nan, math.nan) if bic is None else (bic.ngi, bic.nli)
    yield Statistic(
        "Non-Gaussianity NGI",
        "how far the significant bicoherences of SP − PV exceed what a linear Gaussian signal shows",
        "Choudhury, Shook and Shah 2006",
        ngi,
        "",
        "above 0 not Gaussian",
        _undefined(missing) if bic is None else "not Gaussian" if ngi > 0.0 else "Gaussian: linear",
    )
    nonlinear = ngi > 0.0 and nli > NONLINEAR
    yield Statistic(
        NONLINEARITY,
        "how far the largest bicoherence of SP − PV exceeds the others' mean and two standard deviations",
        "Choudhury, Shah and Thornhill 2004",
        nli,
        "",
        f"with NGI above 0: above {NONLINEAR:g} nonlinear",
        _undefined(missing) if bic is None else f"nonlinear{doubt}" if nonlinear else "not shown to be nonlinear",
    )
    ellipse = found.ellipse
    missing = (why or "fewer than two periods recorded") if asked else missing
    yield Statistic(
        "Apparent stiction",
        "width along OP of the ellipse fitted to PV against OP over the cycle; it means stiction in a nonlinear loop "
        "alone, any phase between OP and PV opens it",
        "Choudhury, Shah, Thornhill and Shook 2006",
        math.nan if ellipse is None else ellipse.apparent_stiction,
        "%",
        "",
        _undefined(missing)
        if ellipse is None
        else "stiction as the loop shows it: the valve's own may be larger or smaller"
        if nonlinear
        else "no measure of stiction: the loop is not shown to be nonlinear",
    )
