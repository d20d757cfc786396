"""What the fitted models say about the valve, and the one verdict of detection and model together.

The model's measure is the relative output-error gain over a causal linear model of low order, `1 - R_stem/R_linear`
with R the residual as a share of PV's variance. Detection decides; the model can only make it more careful, or decide
where detection does not and the stem explains most of what the linear model leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

from workbench.detect.causes import RESOLVED
from workbench.detect.verdict import Thresholds, excluded
from workbench.estimate.fits.sureness import ENOUGH_SLIPS, SHARP, SURE_SLIPS
from workbench.model.detection import Detection
from workbench.model.numbers import counted, given

__all__ = ["MOST", "WIDE_D", "Evidence", "agree", "judge", "words_of_few"]

GAIN = 0.10  # least improvement over the linear model that counts
UNEXPLAINED = 0.05  # least share of PV's variance that the linear model must leave for that to matter
EXPLAINS = 0.60  # largest share that the sticking stem may leave to count as an explanation
LINEAR_EXPLAINS = 0.40  # and the linear model, to acquit the valve
FOLLOWS = 0.50  # share of what no input leaves, above which PV hardly follows OP
LONGEST = 0.10  # of the record, the longest dead time with which the linear model may acquit the valve
WIDE_D = 0.20  # of OP's range: a stem that sticks as wide as this and fits as well keeps the valve suspect
SLOWEST = 0.25  # of the record, the longest time constant that the record can show
NEAR_NOTHING = 0.25  # of d: where bands as narrow as this fit as well, stiction is not needed
MOST, CERTAIN = 0.5, 0.9  # improvement by which the model alone decides: where detection does not, and against it
ALL_BUT = 0.98  # and that leaves it suspect, however little the linear model leaves: of 166 acquitted none came to 0.9
COLOURED = 2.0  # times what is left of PV unpredicted: what a model leaves is no noise then
NAMED = 4  # separate ranges of d named one by one
WORDS_OF_FOLLOWED = (
    "PV moves as behind a stem that sticks, yet the recorded one follows OP: look whether the stem's travel is "
    "recorded, or what the positioner was asked for"
)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the verdict rests on: residual variances of both models (EU^2), slips, d and its range, the search.

    linear: within the same dead times as the stem's; nothing: without any input; wide: the best stem with d above
    `WIDE_D` of OP's range; two_parameter: the best of a coarse grid over valves with (S, J), `bands`; islands: the
    separate ranges of d within d_range; floor: what the record does not resolve; linear_delay: the linear model's dead
    time, and tau: the stem model's time constant (0 for an integrating plant), as shares of the record.
    """

    samples: int
    variance: float
    floor: float
    linear: float
    stem: float
    slips: int
    d: float
    gain: float
    op_range: float
    nothing: float
    wide: float
    two_parameter: float
    bands: tuple[float, float]
    linear_delay: float
    tau: float
    d_range: tuple[float, float] | None
    islands: tuple[tuple[float, float], ...]
    exact: bool
    at_limit: bool
    method: str
    iterations: int


def judge(e: Evidence) -> tuple[str, tuple[str, ...], bool]:
    """Return (verdict, reasons in words, whether d is identified)."""
    reasons: list[str] = []
    linear, stem = e.linear / e.variance, e.stem / e.variance
    improvement = 1.0 - stem / linear if linear > 0.0 else 0.0
    if e.slips == 0 or e.gain == 0.0:
        reasons.append("no movement of the valve can be seen in PV: the record holds no slip that PV answers")
        _search_said(e, reasons)
        return "undecided", tuple(reasons), False
    reasons.append(
        f"a stem that sticks within d = {given(e.d, 3)} % leaves {_share(stem)} of PV's variance unexplained, "
        f"the linear model {_share(linear)} ({counted(e.slips, 'stem move')})"
    )
    if improvement >= GAIN and (linear >= UNEXPLAINED or improvement >= 0.5):
        verdict = _for_stiction(e, stem, reasons)
    elif e.method == "two_step":
        verdict = "undecided"
        reasons.append("the two-step algorithm found no stiction near its start, which does not acquit the valve")
    elif linear <= LINEAR_EXPLAINS:
        verdict = _for_health(e, reasons)
    else:
        verdict = "undecided"
        reasons.append("neither model explains PV: disturbances or other nonlinearities dominate the record")
    identifiable = _identified(e, verdict, reasons)
    _search_said(e, reasons)
    return verdict, tuple(reasons), identifiable


def _share(left: float) -> str:
    return f"{left:.1%}" if left <= 1.0 else "more than all"


def _for_health(e: Evidence, reasons: list[str]) -> str:
    if e.linear > FOLLOWS * e.nothing:
        reasons.append(
            f"PV hardly follows OP: without any input {e.nothing / e.variance:.1%} of its variance would be left"
        )
        return "undecided"
    if e.linear_delay > LONGEST:
        reasons.append(
            "the linear model needs a dead time of more than a tenth of the record: within an oscillation that is a "
            "phase shift, not a process"
        )
        return "undecided"
    if e.wide <= (1.0 + GAIN) * e.linear and e.wide >= UNEXPLAINED**2 * e.variance:
        reasons.append(
            "the linear model explains PV as well, but so does a valve that sticks widely: the record is too smooth to "
            "tell them apart"
        )
        return "undecided"
    gain = 1.0 - e.two_parameter / e.linear if e.linear > 0.0 else 0.0
    if gain >= GAIN and (e.linear >= UNEXPLAINED * e.variance or gain >= 0.5):
        reasons.append(
            f"no staircase of a sticking stem is seen, but a valve with dead band (S = {given(e.bands[0], 2)} %, J = "
            f"{given(e.bands[1], 2)} %) would leave only {e.two_parameter / e.variance:.1%}"
        )
        return "undecided"
    reasons.append("the linear model leaves little of PV too: this comparison makes no case for stiction")
    return "no_stiction"


def _for_stiction(e: Evidence, stem: float, reasons: list[str]) -> str:
    if few := words_of_few(e.slips):
        reasons.append(few)
        return "undecided"
    if stem > EXPLAINS:
        reasons.append("the sticking stem fits better than the linear model, but explains too little of PV to decide")
        return "undecided"
    if e.tau > SLOWEST:
        reasons.append(
            "the model's time constant is longer than a quarter of the record: PV drifts more than it answers the valve"
        )
        return "undecided"
    if e.d_range is not None and e.d_range[0] < NEAR_NOTHING * e.d:
        reasons.append(
            f"bands down to {given(e.d_range[0], 3)} % fit as well: the record does not need a valve that sticks"
        )
        return "undecided"
    return "stiction"


def words_of_few(slips: int) -> str:
    """Say that a stem moved too seldom to accuse a valve by; or nothing."""
    if slips >= ENOUGH_SLIPS:
        return ""
    return (
        f"only {counted(slips, 'stem move')} in the record, and at least {ENOUGH_SLIPS} are needed for a verdict: a "
        "longer record, or one with a setpoint change, would decide"
    )


def _identified(e: Evidence, verdict: str, reasons: list[str]) -> bool:
    if e.d_range is None or verdict != "stiction":
        return False
    low, high = e.d_range
    if high - low > SHARP * e.d:
        which = f"every d from {given(low, 3)} to {given(high, 3)} % fits equally well"
        if len(e.islands) > 1:
            named = ", ".join(f"{given(a, 4)} to {given(b, 4)} %" for a, b in e.islands[:NAMED])
            more = f" and {len(e.islands) - NAMED} more" if len(e.islands) > NAMED else ""
            which = (
                f"the range of d, {given(low, 3)} to {given(high, 3)} %, spans {len(e.islands)} separate ranges that "
                f"fit equally well ({named}{more}) and worse ones between them"
            )
        reasons.append(
            f"{which}, the gain and dead time making up for it (about {given(abs(e.gain) * e.d, 3)} EU per slip is "
            "what is known); a setpoint change in the record, or a longer record, would tell them apart"
        )
        return False
    return e.slips >= ENOUGH_SLIPS


def _search_said(e: Evidence, reasons: list[str]) -> None:
    if e.method == "two_step":
        reasons.append(
            f"the two-step algorithm ended after {e.iterations} iterations; it finds a minimum near its start only, "
            "and gives no interval"
        )
    if e.at_limit:
        reasons.append("the dead time lies at the end of the range searched: a longer one may fit better")
    if e.method != "two_step" and not e.exact:
        reasons.append("the record is long: d was searched closely only about its likeliest values")


def _against(e: Evidence, found: Detection) -> str:
    """Say that every stem, the model's too, foretells PV clearly worse than OP itself, or nothing.

    By so much none that the valve has does, unless the model leaves noise alone: then the prediction is amiss. Nor is a
    wave of steady period asked for then, which the stem may be the likeness of (`StemTest.waved`).
    """
    test = found.test
    if test is None or test.predicting > -Thresholds().likelihood:
        return ""
    noise = max(test.left * e.variance, e.floor)
    if min(e.stem, e.two_parameter) <= COLOURED * noise:
        return ""
    return (
        f"the stem leaves {given(min(e.stem, e.two_parameter) / noise, 2)} times what a prediction by one sample does, "
        f"and every stem foretells PV worse than OP itself (log likelihood ratio {test.predicting:.0f}): look for what "
        "disturbs the loop; a stretch in manual, or a record without the disturbance, would tell"
    )


def agree(e: Evidence, verdict: str, reasons: tuple[str, ...], found: Detection) -> tuple[str, tuple[str, ...]]:
    """Return the one verdict of the model (`judge`) and of detection, and the reasons of both."""
    if found.verdict == verdict:
        return verdict, found.reasons + reasons
    improvement = 1.0 - e.stem / e.linear if e.linear > 0.0 else 0.0
    test = found.test
    # The model knows no wave of steady period: where one is clearly likelier than every stem, it decides nothing alone.
    waved = test is not None and test.waved < min(test.predicting, -Thresholds().likelihood)
    sticks = verdict == "stiction" and test is not None and not waved
    against = "" if improvement >= CERTAIN else _against(e, found)
    # However few its slips: a valve that explains most of what the linear model leaves is not acquitted, nor one that
    # explains nearly all of the little that it leaves.
    explained = MOST if e.linear >= UNEXPLAINED * e.variance else ALL_BUT
    explains = max(min(e.stem, e.two_parameter), e.floor) <= (1.0 - explained) * e.linear
    # Detection has tried all stems as wide as this one, and acquits the valve of them.
    refuted = test is not None and e.d >= test.wide_from and excluded(test, Thresholds())
    acquitted = found.verdict == "no_stiction"
    # A recorded stem that follows OP is evidence of its own, if it is the stem that was recorded.
    followed = acquitted and found.stem is not None and found.stem.follows < Thresholds().direct
    if followed:
        doubted = sticks and improvement >= CERTAIN and e.slips >= SURE_SLIPS
        final = "undecided" if doubted else "no_stiction"
        reasons = (WORDS_OF_FOLLOWED, *reasons) if doubted else reasons
    elif sticks and improvement >= (CERTAIN if acquitted else MOST) and (e.slips >= SURE_SLIPS or not acquitted):
        final = "undecided" if against else "stiction"
        reasons = (against, *reasons) if against else reasons
    elif acquitted and ((sticks and not refuted) or explains or e.slips == 0):
        final = "undecided"
    else:
        final = found.verdict
    # However well a model fits: of moves so small no valve makes anything.
    if final == "stiction" and e.op_range < RESOLVED:
        final = "undecided"
    model = tuple(f"by the fitted models alone: {reason}" for reason in reasons)
    return final, found.reasons + model
