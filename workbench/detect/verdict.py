"""The verdict: one rule over the stem test, the cycle and the recorded stem; the other statistics are told beside it.

Stiction is found where the linear loop leaves something to explain (LEFT) and a sticking stem explains it, by one of
three routes: it betters both the linear loop and the free linear predictor (SURE), PV's own turns no better (TURNED),
and the simulated PV is no worse; it betters the linear loop by prediction and in the simulated PV at once,
significantly (LIKELIHOOD), by an amount that matters (PREDICTS, EXPLAINS), and adds more than chance to the free
predictor (CHANCE); or it predicts so much better (SOLE, CLEAR), than a linear loop under a few load steps too, that no
second opinion is asked, unless stems as wide are excluded (EXCLUDED). None of them holds where such a loop does as
well, or one under a wave of steady period (PLAYED), or where a curve of the plant does (CURVED).

No stiction is a finding of its own: stems that stick over a quarter of OP's range or more, enough to matter, are
excluded (EXCLUDED); or they fit no better than chance has it (CHANCE; where PV is seen to follow OP, worse than OP
itself: SEEN), PV does not cycle as a sticking valve makes it under integral action, and the record is long enough to
have shown more; or the linear loop leaves nothing to explain (LEFT), unless a wide stem predicts that better than
chance (CHANCE) and one explains it in the simulated PV (EXPLAINS), or is ahead by prediction and simulation together
(CHANCE): what moves most of PV, an oscillation from outside or a large setpoint move, hides what a valve does.
What is neither is undecided.

The thresholds are stated, not fitted:

LIKELIHOOD: a likelihood ratio with two free widths exceeds 30 by chance once in three million; over the search, some
hundreds of stems that differ, that is less than once in 1,000.
SURE: two tests that fail differently. A linear loop of low order leaves what a stem's steps may make up for; the free
predictor does not: what a stem adds to it, three coefficients, exceeds 20 by chance once in 6,000, for one of the
twenty stems that are tried once in 300. Neither is given what a curved plant does; where no stem betters the simulated
PV, it may be that. A stem that moves no more often than FEW has it twice over is a few steps, which suit what a slow
load leaves around setpoint moves: 30 is asked of it, as LIKELIHOOD has it. Of a long record's stretches, each searched
anew, the clearest does not count, but the next: it is the largest of as many chances, and what another loop's cycle
sends may look like a stem for a while. A valve that sticks shows in the others too.
TURNED: what turns PV from outside, an unsteady cycle that another loop's valve sends by any road, turns OP after it,
and a stem betters both rivals; so it may where the process or a sensor is no straight line. PV's own turns know as
much. Of nearly all loops that such a cycle drives, and of nearly all real healthy ones with a stem beyond chance, they
add more to the free predictor than any stem does; of nearly all loops whose valve sticks they add less. Of 216 that
another's valve drives 14 were accused without this, at 25 for SURE, and four are with it, at 20.
PREDICTS: a real linear plant is no first-order lag; what its shape leaves unmodelled was below 3 % of the innovations'
variance in nine of ten simulated loops, and below three times that (CLEAR) in all.
EXPLAINS, LEFT: 5 % of the error, and of PV's variance; a linear model that leaves less has explained PV, unless the
stem predicts clearly better, by three times PREDICTS (CLEAR), and explains most (MOST) of the little that is left, or
betters both rivals as SOLE has it and the simulated PV as EXPLAINS has it. What moves most of PV shows the plant's
curve (CURVED). Of 720 healthy loops under setpoint moves, through one lag or two, straight or curved, none is accused,
and of 720 whose valve sticks 433 are found.
CURVED: a stem takes up what a curved process, valve or sensor makes of large moves. Where the linear loop leaves less
than three times LEFT (CLEAR) the free predictor is given squares of PV and OP too, and a stem must add as much to both.
Eighteen squares gain more than 40 (SOLE) by chance once in 500: where they do, and the stem adds but chance to them, it
accuses nobody, by whatever route. Of 246 records of a brisk loop with curved valves 70 were accused without this.
CLOSE: four fifths of each of these is no acquittal, nor is a likelihood beyond SOLE by itself, nor that of SURE, of a
stem that moves seldom too; nor is the latter where little is left, if the simulated PV and PV's own turns speak for the
stem too: of 74 sticking valves under large setpoint moves that were called healthy 11 are not, for 2 of 317 healthy
ones. Nor, however little the linear loop leaves, is a stem that betters it and the free predictor
as SOLE has it, and that predictor too when it takes OP's place: a cycle through a slow plant is so smooth that a longer
lag makes up for it.
SIMULATED: nor is one acquitted whose stem adds to the free predictor as SURE has it and explains a quarter of the
simulated PV's error: a filter between valve and PV hides how a stem slips, so that OP foretells PV as well. Of 47
healthy loops that were acquitted, 25 of them real, none had such a stem; of five sticking ones that were, three had.
CHANCE: where PV is noise alone the best of the search gained less in 47 of 50 simulated loops.
EXCLUDED: chi^2 with one degree of freedom, the width, at 95 %: a wide stem whose likelihood is not that far below the
linear loop's may be at work. So may one that never moved where PV is not seen to follow OP (CHANCE).
PLAYED: a stem that moves once or twice leaves PV as a load step does, if it is given the time, and one that rests while
OP ramps as a load does that ramps the other way. It accuses only where it beats the linear loop under as many load
steps, or ramps, as it moves, four at most, each paid for by BIC, by more than chance (CHANCE). A stem that moves more
often must beat that loop by what it must beat the one without steps, but may have as many beside it. A step that comes
with a setpoint move is the controller's work and the valve's, no load's. Nor does any stem accuse that is not ahead by
more than chance of a rectangular or triangular load of steady period, as another loop's valve or a heater that is
switched makes it, ln N paid for each of its period, phase, form and, where its halves differ, second corner: they are a
clock's, not OP's.
OUTSIDE: what disturbs the loop may hide a stem. Where none accuses, all are looked at once more beside a sinusoid of
their own (ln N paid for each of its size, phase and frequency), and in PV without the load steps under which the linear
loop does best. Much of what the valve did may have gone with these: such a look acquits nobody, and accuses only by
what two tests that fail differently say (SURE).
SEEN: a gain, a time constant and a dead time chosen among ten gain 15 by chance once in 50. Where PV answers OP so
clearly, a stem that hides a quarter of OP's range from it predicts PV worse, unless it is at work.
FEW: a stem that moved at most four times, two cycles, cannot be told from a linear loop, however little that leaves,
where PV is not seen to follow OP, or where a wide one predicts PV better than chance has it (CHANCE).
SLOW: under integral action alone a self-regulating loop is at its stability limit with a period of at most four times
dead time and time constant together (pure dead time: exactly four dead times; proportional action: less). A slower
cycle is not its own, and so smooth that the valve's part does not show.

Phase and shape of a cycle (cross-correlation, ellipse, triangle) measure the tuning as much as the valve; they are
evidence told to the reader, and decide nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from workbench.detect.oscillation import no_period
from workbench.model.detection import Oscillation, StemEvidence, StemTest
from workbench.model.numbers import given

__all__ = [
    "DUST",
    "Thresholds",
    "accuses",
    "beyond_chance",
    "beyond_doubt",
    "convinces",
    "curved",
    "decide",
    "excluded",
    "follows",
    "times",
]

DUST = 1e-20  # share of PV's variance that is rounding, left or not
INTEGRATES = 10.0  # periods of PV's cycle: a lag as long is an integrator to it, within a degree of phase


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The rule's thresholds (see the module's first lines); a benchmark moves each by a fifth."""

    likelihood: float = 30.0
    sure: float = 20.0
    predicts: float = 0.03
    explains: float = 0.05
    simulated: float = 0.25
    left: float = 0.05
    sole: float = 40.0
    close: float = 0.8
    clear: float = 3.0
    most: float = 0.5
    chance: float = 10.0
    excluded: float = 3.84
    seen: float = 15.0
    slow: float = 4.0
    cycles: float = 0.5  # oscillation index of a cycle that dominates PV
    few: float = 4.0
    direct: float = 0.01  # share of a recorded stem's variance: closer than a tenth of its moves it follows

    @property
    def much(self) -> float:
        """Share of the innovations' variance that is clearly explained."""
        return self.clear * self.predicts

    def seldom(self, test: StemTest) -> bool:
        """Whether a stem moved no more often than FEW has it twice over."""
        return test.moves <= 2.0 * self.few

    def surely(self, test: StemTest) -> float:
        """Log likelihood ratio to both rivals that finds a stem: more where it moves seldom, or little is left."""
        if test.unexplained < self.left:
            return max(self.sure, self.sole)
        return max(self.sure, self.likelihood) if self.seldom(test) else self.sure

    def simulates(self, test: StemTest) -> float:
        """Share of the simulated PV's error that a stem must explain then: none, or EXPLAINS where little is left."""
        return 0.0 if test.unexplained >= self.left else self.explains

    @property
    def little(self) -> float:
        """Share of PV's variance below which what moves most of PV may show the plant's curve."""
        return self.clear * self.left

    @property
    def shortest(self) -> float:
        """Samples in which a stem that clearly explains PV reaches the likelihood that finds it."""
        return self.likelihood / -math.log(1.0 - self.much)


def decide(
    oscillation: Oscillation,
    test: StemTest,
    stem: StemEvidence | None,
    thresholds: Thresholds | None = None,
) -> tuple[str, list[str]]:
    """Return ("stiction", "no_stiction" or "undecided", the reasons in words)."""
    limits = Thresholds() if thresholds is None else thresholds
    if stem is not None:
        direct = _direct(stem, limits)
        if direct is not None:
            return direct
    alone = 1.0 - math.exp(-test.predicting / test.samples)
    linear = f"the linear loop leaves {test.unexplained:.1%} of PV's variance"
    beats = (
        f"{_outside(test)}a stem that sticks over {given(test.band, 3)} % leaves {_less(alone)} of PV unpredicted than "
        f"OP itself does (log likelihood ratio {test.predicting:.0f})"
    )
    both = (
        f"the stem that fits best throughout leaves {_less(test.improvement)} unpredicted (log likelihood ratio "
        f"{test.likelihood:.0f}) and {_less(test.simulated, 0)} of simulated PV"
    )
    played = test.loaded < limits.chance
    waved = test.waved < limits.chance
    if accuses(test, limits):
        kind = "the stem slips as it sets off" if test.jump > 0.1 * test.band else "a dead band without visible slip"
        return "stiction", [f"{beats}: {kind}", f"{both}; {linear}"]
    either = test.predicting >= limits.sole or test.sure >= limits.close * limits.sure
    likely = test.unexplained >= limits.left and either
    likely = likely or (test.likelihood >= limits.sole and test.simulated >= limits.explains)
    likely = likely or test.instead >= limits.sole
    likely = likely or (test.sure >= limits.close * limits.sure and _simulated_too(test, limits))
    if likely or _sticks(test, limits, limits.close):
        enough = "nearly enough to find stiction, too much to exclude it"
        if played or (test.loaded < test.predicting and not waved):
            well = "does as well" if played else "is not clearly worse"
            seldom = f"the stem moved {times(test.moves)} only, and a linear loop under as few load steps or ramps"
            often = "a linear loop under a few load steps or ramps, which the stem was given too,"
            enough = (
                f"yet {seldom if limits.seldom(test) else often} {well} (log likelihood ratio "
                f"{test.loaded:.0f}); a setpoint move, recorded with its setpoint, or a longer record would tell"
            )
        elif waved:
            enough = (
                "yet a linear loop under a rectangular or triangular load of steady period, as another loop's valve "
                f"or a heater that is switched makes it, is not clearly worse (log likelihood ratio {test.waved:.0f}); "
                "a stretch in manual, or the other loop's record, would tell"
            )
        elif curved(test, limits):
            enough = (
                f"yet squares of PV and OP foretell PV as well (log likelihood ratio {test.squares:.0f}): a curved "
                "process, valve or sensor makes the same of large moves; a record about one operating point would tell"
            )
        elif accuses(replace(test, turned=0.0), limits):
            enough = (
                "yet PV's own turns, before OP's, foretell PV better than any stem does (log likelihood ratio "
                f"{-test.turned:.0f}): another loop's cycle, or a process or sensor that is no straight line, turns PV "
                "so; a stretch in manual, or the other loop's record, would tell"
            )
        return "undecided", [f"{beats}: {enough}", f"{both}; {linear}"]
    doubt = _not_excluded(oscillation, test, limits)
    if doubt:
        return "undecided", [doubt, f"{both}; {linear}"]
    own = test.time_constant + test.dead_time
    lag = f"time constant {given(test.time_constant, 3)} s"
    if not no_period(oscillation) and test.time_constant > INTEGRATES * oscillation.period:
        lag = "a process that integrates"
    loop = f"a linear loop with {lag} and dead time {given(test.dead_time, 3)} s"
    if excluded(test, limits):
        ratio = f"(log likelihood ratio {test.wide:.0f})"
        earned = f"a stem that sticks over {given(test.wide_from, 3)} % or more is excluded {ratio}"
    elif test.unexplained < limits.left:
        earned = f"a sticking stem has nothing to explain: {linear}"
    else:
        earned = "a sticking stem explains PV no better than chance has it, and PV does not cycle as it would make it"
    if oscillation.index >= limits.cycles and oscillation.regularity > 1.0:
        cycle = f"PV cycles with a period of {given(oscillation.period, 3)} s"
        if oscillation.period > limits.slow * own:
            return "undecided", [f"{cycle}, too slow for {loop} to make by itself, and smooth: external, or a valve"]
        return "no_stiction", [
            f"{cycle}, which {loop} can make by itself: tight tuning, or an external oscillation near it",
            earned,
        ]
    return "no_stiction", [earned]


def _outside(test: StemTest) -> str:
    """Say beside which disturbances the stems stand."""
    steps = f"{test.steps} load step{'s' if test.steps > 1 else ''}, taken out of PV" if test.steps else ""
    both = " and ".join(filter(None, (steps, "an oscillation from outside" if test.swings else "")))
    return f"beside {both}, " if both else ""


def times(many: int) -> str:
    """Return how often in words: "once", "2 times"."""
    return "once" if many == 1 else f"{many} times"


def _less(share: float, decimals: int = 1) -> str:
    """Return a share in words: "23.1% less", and "8.0% more" where a stem makes it worse."""
    return f"{abs(share):.{decimals}%} {'more' if round(share, decimals + 2) < 0.0 else 'less'}"


def follows(test: StemTest) -> float:
    """Return the log likelihood ratio of PV with OP to PV without: how clearly PV is seen to follow."""
    return test.samples * math.log(max(test.unfollowed, DUST) / max(test.left, DUST))


def _not_excluded(oscillation: Oscillation, test: StemTest, limits: Thresholds) -> str:
    """Say why stiction that matters is not excluded, or return nothing."""
    if test.moves == 0:
        return "the stem that fits best never moved: the record is too short, or too quiet, to tell it from OP itself"
    if test.moves <= limits.few and (follows(test) < limits.chance or test.wide > limits.chance):
        stem = f"a stem that moved {times(test.moves)} fits as well"
        hardly = f"OP hardly leaves a band of {given(test.band, 3)} %, within which {stem}"
        return f"{hardly}: the record is too short, or too quiet, to exclude it"
    if test.adds >= limits.sure and test.simulated >= limits.simulated:
        return (
            f"OP itself predicts PV as well as a stem that sticks over {given(test.band, 3)} %, yet that adds to what "
            f"PV and OP foretell (log likelihood ratio {test.adds:.0f}) and leaves {_less(test.simulated, 0)} of "
            "simulated PV: a filter or another lag between valve and PV hides how a stem slips; the measured stem "
            "would tell"
        )
    both = test.simulated >= limits.explains or test.likelihood > limits.chance
    if test.unexplained < limits.left and not (test.wide > limits.chance and both):
        return ""
    if excluded(test, limits):
        return ""
    wide = f"a stem that sticks over {given(test.wide_from, 3)} % or more, a quarter of OP's range, cannot be excluded"
    would = "a setpoint move, a longer record or the measured stem would tell"
    if test.wide > limits.chance:
        return f"{wide}: it predicts PV rather better than OP itself (log likelihood ratio {test.wide:.0f}); {would}"
    if beyond_chance(test, limits):
        return f"{wide}: PV follows OP, yet such a stem predicts it as well as OP itself; {would}"
    if not no_period(oscillation):
        return f"{wide}, and PV cycles: the record does not tell why; {would}"
    if test.samples < limits.shortest:
        return f"{wide}: {test.samples} samples are too few to show one that matters; {would}"
    return ""


def excluded(test: StemTest, limits: Thresholds) -> bool:
    """Return whether neither a stem with a wide band nor one that never moved may be at work."""
    return test.wide <= -limits.excluded and follows(test) >= limits.chance


def beyond_chance(test: StemTest, limits: Thresholds) -> bool:
    """Return whether a stem with a wide band predicts PV better than chance has it, or was never asked for (nan)."""
    return not test.wide <= (0.0 if follows(test) >= limits.seen else limits.chance)


def accuses(test: StemTest, limits: Thresholds | None = None) -> bool:
    """Return whether a sticking stem is found by one of the three routes, and no load or curve does as well.

    One beside a load of its own must better both rivals, whatever the route (SURE).
    """
    limits = Thresholds() if limits is None else limits
    free = (test.swings or test.steps) and test.sure < limits.surely(test)
    rivalled = min(test.loaded, test.waved) < limits.chance or curved(test, limits)
    return not free and not rivalled and _sticks(test, limits, 1.0)


def curved(test: StemTest, limits: Thresholds) -> bool:
    """Return whether a curve of the plant shows, beside which the best stem adds no more than chance."""
    return test.squares >= limits.sole and test.adds < limits.chance


def _simulated_too(test: StemTest, limits: Thresholds) -> bool:
    """Return whether what betters both rivals betters the simulated PV too, and PV's own turns know no more."""
    return test.simulated >= limits.explains and test.turned >= 0.0


def convinces(test: StemTest) -> bool:
    """Return whether a sticking stem reaches twice what finding stiction takes."""
    limits = Thresholds()
    rivalled = min(test.loaded, test.waved) < 2.0 * limits.chance or curved(test, limits)
    return not rivalled and _sticks(test, limits, 2.0)


def beyond_doubt(test: StemTest) -> bool:
    """Return whether a sticking stem convinces, and explains most of what the linear loop leaves, by both errors."""
    return min(test.improvement, test.simulated) >= Thresholds().most and convinces(test)


def _sticks(test: StemTest, limits: Thresholds, share: float) -> bool:
    """Return whether a sticking stem reaches a share of every threshold of one of the three routes."""
    clear = test.improvement >= share * limits.much and test.simulated >= share * limits.most
    together = (
        (test.unexplained >= limits.left or clear)
        and test.likelihood >= share * limits.likelihood
        and test.improvement >= share * limits.predicts
        and test.simulated >= share * limits.explains
        and test.adds >= share * limits.chance
    )
    alone = (
        test.unexplained >= limits.left
        and test.loaded >= share * limits.sole
        and test.predicting >= -test.samples * math.log(1.0 - share * limits.much)
        # Not of a stem as wide as those excluded: it spoils the simulated PV, or is a model's that slips when PV does.
        and not (test.band >= test.wide_from and excluded(test, limits))
    )
    sure = test.sure >= share * limits.surely(test) and test.simulated >= share * limits.simulates(test)
    return together or alone or (sure and test.turned >= 0.0)


def _direct(stem: StemEvidence, limits: Thresholds) -> tuple[str, list[str]] | None:
    left = f"the recorded stem leaves OP's line by {math.sqrt(stem.follows):.0%} of its moves"
    if stem.follows < limits.direct:
        return "no_stiction", [f"{left}: it follows"]
    if stem.sticks <= 0.5 * stem.follows:
        return "stiction", [f"{left}, and one that sticks over {given(stem.band, 3)} % explains most of that"]
    return None
