"""What detection answers with: the evidence by method, and the verdict. No computing."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.model.record import FloatArray, Record
from workbench.model.show import Shown

__all__ = [
    "NONLINEARITY",
    "NOT_ASKED",
    "Bicoherence",
    "Detection",
    "Ellipse",
    "Oscillation",
    "Statistic",
    "StemEvidence",
    "StemTest",
]

NONLINEARITY = "Nonlinearity NLI"  # the statistic that says why there is no bicoherence
NOT_ASKED = "not asked for"


@dataclass(frozen=True, slots=True)
class Oscillation:
    """PV's strongest oscillation: index 0 (noise) to 1 (perfect sinusoid), period (s, nan where there is none).

    regularity: of the autocorrelation's zero crossings, above 1 for a regular oscillation; cycles: periods recorded.
    """

    index: float
    period: float
    regularity: float
    cycles: float


@dataclass(frozen=True, eq=False)
class Bicoherence:
    """Squared bicoherence, `values` at (frequency_1, frequency_2), cycles per sample, shape (M,); NGI and NLI.

    critical: the value that a linear Gaussian signal exceeds at one frequency pair in twenty over so many segments.
    """

    frequency_1: FloatArray
    frequency_2: FloatArray
    values: FloatArray
    ngi: float
    nli: float
    critical: float
    segments: int


@dataclass(frozen=True, slots=True)
class Ellipse:
    """PV against OP over the cycle: centre (op %, pv EU), covariance (OP OP, OP PV, PV PV), apparent stiction (%)."""

    op: float
    pv: float
    covariance: tuple[float, float, float]
    apparent_stiction: float


@dataclass(frozen=True, slots=True)
class StemEvidence:
    """A recorded stem against OP: shares of the position's variance left by OP itself and by the best sticking stem.

    band, jump: of that stem, %.
    """

    band: float
    jump: float
    follows: float
    sticks: float


@dataclass(frozen=True, slots=True)
class StemTest:
    """How a sticking stem compares with the linear loop; time constant and dead time of the linear one in s.

    predicting: the log likelihood ratio of the stem that predicts PV best, N times the logarithm of the ratio of
    innovation variances; band: width (%) of its stick band (Stenman: d); jump: its slip jump; moves: times that it set
    off or turned. loaded: its ratio over the linear loop under a few load steps, or ramps, twice ln N less for each,
    where that is less; a stem that moved more than a few times may have them too, and one that explains most is not
    asked. waved: by how much the best stem in the free linear predictor, beside OP or in its place, is ahead there of a
    rectangular or triangular load of steady period, three ln N for that, four where its halves differ; `predicting`
    where that is chance, or PV has no period. turned: by how much the stem that adds most to the free predictor is
    ahead of PV's own turns there, in the stretch of `sure`; 0 where that is far from enough. squares: of the free
    predictor with the squares of PV and OP, the ratio to that without, of a long record that of the clearest stretch
    but one; 0 where much is unexplained and they are not asked. likelihood: `predicting` of the stem best by prediction
    and simulation together; improvement: share of the linear rival's innovation variance that it explains; simulated:
    share of the error of the linear rival's simulated PV that it explains; adds: its log likelihood ratio over the free
    linear predictor, which knows the past of PV and OP and no valve, and where little is unexplained over one that
    knows the squares too, the less. The linear rival of the innovations may have a sinusoidal disturbance.

    sure: the best of all stems by the less of both ratios, over the linear rival and as in `adds`; of a long record
    that of the clearest stretch but one; wide: the ratio over the linear rival of the best stem with a
    band of `wide_from` (%), a quarter of OP's range, or more. In these two a stem that makes the simulated PV worse by
    half counts for what it simulates. wide is nan where a model's stem left no doubt and no other was tried. instead:
    the best of all stems by the least of three ratios, the two of sure, whatever the stem simulates, and that of the
    free predictor given the stem in OP's place to that given OP.

    left: share of PV's variance that the linear rival leaves as innovations, unfollowed: likewise without any input;
    unexplained: what its simulated PV leaves. steps: load steps of the linear loop that were taken out of PV first,
    and swings: whether the stems are beside a sinusoidal disturbance too, where one is found only so.
    """

    predicting: float
    loaded: float
    waved: float
    turned: float
    squares: float
    improvement: float
    likelihood: float
    simulated: float
    adds: float
    sure: float
    instead: float
    wide: float
    wide_from: float
    left: float
    unexplained: float
    unfollowed: float
    band: float
    jump: float
    moves: int
    samples: int
    time_constant: float
    dead_time: float
    steps: int = 0
    swings: bool = False


@dataclass(frozen=True, slots=True)
class Statistic:
    """One statistic in words: what it measures, by whose definition, its limits, and what it says of this record.

    source: the publication, empty where the definition is this product's own. value: nan where the record does not give
    it, which `says` explains then. decides: whether the verdict rests on it.
    """

    name: str
    measures: str
    source: str
    value: float
    unit: str
    limits: str
    says: str
    decides: bool = False


@dataclass(frozen=True, eq=False)
class Detection(Shown):
    """The evidence for and against stiction in a record, and the verdict "stiction", "no_stiction" or "undecided".

    reasons: the evidence behind the verdict in words, other causes included. load_index: weighted number of load
    disturbances in 50 periods, oscillating from 10 on. correlation: Horch's two asymmetries, of lags and values, near 1
    stiction, near 0 none; histogram: -1 to 1, positive stiction in an integrating loop; triangle: He's index of OP,
    triangle_pv: of PV, above 0.6 stiction, below 0.4 none; movement: Yamashita's rho_1 and rho_3, above 0.25 stiction.
    All nan where the record does not give them. bicoherence and ellipse: None unless asked for. test: None where PV or
    OP never moves. statistics: all of it once more as a table in words, what decides the verdict first.

    oscillation is that of the whole record. stretch: the samples [first, stop) that the statistics of a cycle are of:
    the stretch at constant SP, at least a third of the record long, in which PV cycles most strongly, or the whole
    record without such a stretch; cycle: PV's oscillation there. pv_late: s by which PV is recorded later than the
    controller saw it; the evidence is of the loop as the controller saw it.
    """

    record: Record
    verdict: str
    reasons: tuple[str, ...]
    oscillation: Oscillation
    stretch: tuple[int, int]
    cycle: Oscillation
    load_index: float
    correlation: tuple[float, float]
    histogram: float
    triangle: float
    triangle_pv: float
    movement: tuple[float, float]
    test: StemTest | None
    stem: StemEvidence | None
    bicoherence: Bicoherence | None = None
    ellipse: Ellipse | None = None
    statistics: tuple[Statistic, ...] = ()
    pv_late: float = 0.0
