"""The models that a record is held against, their AIC and BIC, and the choice among them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from workbench.estimate.fits.data import Centred, plant_of
from workbench.estimate.fits.fit import Fit, Limits, grounded
from workbench.estimate.fits.sureness import SHARP
from workbench.estimate.search.bands import Bands, Found, refit, search_bands
from workbench.estimate.search.profile import Profile
from workbench.estimate.search.sought import Sought
from workbench.estimate.search.two_parameter import Band
from workbench.estimate.search.uneven import Uneven
from workbench.model.loads import LoadStep
from workbench.model.numbers import counted, given, interval
from workbench.model.record import FloatArray
from workbench.model.results import FittedModel, Intervals
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman, Valve

__all__ = [
    "STICKING",
    "WORDS_OF_BLIND",
    "WORDS_OF_STRAIGHT",
    "akaike",
    "bands_of",
    "choose",
    "compared",
    "reasons_of",
    "refitted",
    "words_of_calm",
    "words_of_closer",
    "words_of_open",
    "words_of_rival",
]

# Free parameters beside those of the valve: gain, time constant, dead time, bias, input before the record, transient;
# an integrating plant has no time constant.
PLANT_PARAMETERS = 6
VALVE_PARAMETERS = {"linear": 0, "stenman": 1, "deadband": 1, "choudhury": 2}
STICKING = ("stenman", "deadband", "choudhury")
CLOSER = 0.5  # of what the valve chosen leaves of PV: another that leaves less than that speaks against it
UNKNOWN_JUMP = 0.25  # of S: a range of J wider than this does not identify it


def akaike(data: Centred, sse: float, parameters: int) -> float:
    """Return `N log V + 2p` (the paper's eq. (1)); V at least what rounding leaves of PV's variance."""
    variance = max(sse / data.samples, 1e-18 * data.variance)
    return data.samples * math.log(variance) + 2.0 * parameters


def _valve(name: str, d: float, band: Band | None) -> Valve:
    if band is not None:
        return Deadband(band.S) if name == "deadband" else Choudhury(band.S, band.J)
    return Stenman(d) if name == "stenman" else Ideal()


def bands_of(
    data: Centred,
    coarse: list[Band],
    within: Sought,
    limits: Limits,
    rival: float = math.inf,
    only_any: bool = False,
    before: Mapping[str, Found] | None = None,
    beside: tuple[Band, ...] = (),
    near: bool = False,
) -> dict[str, Found]:
    """Return the searches over two-parameter valves that found a stem: "deadband" (J = 0) and "choudhury" (any J).

    The arguments are those of `search_bands`; only_any: without the dead band; beside: further stems for any J.
    """
    was = {} if before is None else before
    dead = None
    if not only_any:
        dead = search_bands(data, coarse, within, limits, 0.0, (), rival, was.get("deadband"), near)
    beside = beside if dead is None else (dead.best, *beside)
    any_jump = search_bands(data, coarse, within, limits, None, beside, rival, was.get("choudhury"), near)
    found = {"deadband": dead, "choudhury": any_jump}
    searched = {name: bands for name, bands in found.items() if bands is not None}
    return searched if only_any else _without_jump(searched)


def refitted(data: Centred, found: dict[str, Found], limits: Limits) -> dict[str, Found]:
    """Return the same searches with each best stem fitted anew, in the measure that data has now."""
    again = {name: refit(data, bands, limits) for name, bands in found.items()}
    return _without_jump(again) if "deadband" in found else again


def _without_jump(found: dict[str, Found]) -> dict[str, Found]:
    """The same searches; where one over any jump ended without one and left less, it is that over dead bands too."""
    other = found.get("choudhury")
    if other is None or other.best.J > 0.0:
        return found
    if "deadband" in found and found["deadband"].best.fit.sse <= other.best.fit.sse:
        return found
    met, again = (tuple(b for b in bands if b.J == 0.0) for bands in (other.met, other.again))
    dead = replace(other, met=met, again=again, rows=other.rows[other.rows[:, 1] == 0.0], only=0.0)
    return {"deadband": dead, **{name: bands for name, bands in found.items() if name != "deadband"}}


def compared(
    data: Centred, linear: Fit, found: Profile | None, bands: dict[str, Found], uneven: Uneven | None = None
) -> dict[str, FittedModel]:
    """Return every model by its name, the lowest BIC first.

    `AIC = N log V + 2 p` and `BIC = N log V + p log N` (H. Akaike, IEEE Trans. Autom. Control 19 (1974) 716-723;
    G. Schwarz, Ann. Statist. 6 (1978) 461-464), V that of the innovations where the disturbance is coloured, at least
    what the record resolves, so that rounding decides nothing. The residual variance told is what is left of PV.
    uneven: stands for its kind of valve; its slips have their price, and their spread is one parameter more.
    """
    fits: dict[str, tuple[Fit, int, FloatArray, int]] = {"linear": (linear, 0, data.u, 0)}
    if found is not None:
        best = found.best
        fits["stenman"] = (best.fit, best.slips, best.stem(data.u), best.first)
    for name, one in bands.items():
        b = one.best
        fits[name] = (b.fit, b.slips, b.stem(data.u), b.begin)
    n, d = data.samples, math.nan if found is None else found.best.d
    models = {}
    for name, (fit, slips, x, first) in fits.items():
        p = PLANT_PARAMETERS - data.integrating + VALVE_PARAMETERS[name]
        level = n * math.log(max(fit.sse / n, data.floor))
        valve = _valve(name, d, bands[name].best if name in bands else None)
        models[name] = _model(data, valve, (fit, slips, x, first), level, p)
    if uneven is not None:
        p = PLANT_PARAMETERS - data.integrating + VALVE_PARAMETERS[uneven.name] + 1
        stem = uneven.fit, uneven.slips, uneven.x, uneven.first
        models[uneven.name] = _model(data, uneven.valve, stem, uneven.level, p)
    return dict(sorted(models.items(), key=lambda item: item[1].bic))


def _model(
    data: Centred, valve: Valve, stem: tuple[Fit, int, FloatArray, int], level: float, parameters: int
) -> FittedModel:
    """A valve's model by its fit, slips, stem and the stem's beginning; level: of twice the log likelihood."""
    fit, slips, x, first = stem
    return FittedModel(
        valve=valve,
        plant=plant_of(data, fit.gain, fit.tau, fit.theta),
        residual_variance=grounded(data, x, first, fit).sse / data.samples,
        aic=level + 2.0 * parameters,
        bic=level + parameters * math.log(data.samples),
        slips=slips,
    )


def choose(models: dict[str, FittedModel], valve: str) -> str:
    """Return the name of the model asked for, or for "auto" of the sticking one with the lowest BIC."""
    if valve == "auto":
        return next((name for name in models if name in STICKING), "linear")
    return valve if valve in models else "linear"


def reasons_of(models: dict[str, FittedModel], chosen: str, valve: str, found: Bands | None) -> tuple[str, ...]:
    """Return why a two-parameter valve was chosen, and what of it the record does not identify, in words."""
    if found is None:
        return ()
    said = []
    model = models[chosen]
    if valve == "auto" and "stenman" in models:
        alone = models["stenman"]
        said.append(
            f"of the sticking valves compared, {_words(model.valve)} has the lowest BIC: it leaves "
            f"{given(model.residual_variance, 3)} EU² of PV's variance, d = {given(alone.valve.stick_band, 3)} % alone "
            f"{given(alone.residual_variance, 3)}"
        )
    low, high = found.S
    if high - low > SHARP * found.best.S:
        said.append(
            f"the stick band S is not identified: from {given(low, 3)} to {given(high, 3)} % it fits as well, or parts "
            "of the record differ by as much"
        )
    low, high = found.J
    if chosen == "choudhury" and high - low > UNKNOWN_JUMP * found.best.S:
        said.append(
            f"the slip jump J is not identified: from {given(low, 3)} to {given(high, 3)} % it fits as well, or parts "
            "of the record differ by as much; more slips, or a measured stem, would tell"
        )
    return tuple(said)


def words_of_calm(steps: Sequence[LoadStep]) -> str:
    """Return in words that load steps leave nothing but noise for a stem to explain."""
    at = ", ".join(f"{given(step.at, 4)} s" for step in steps)
    return f"beside {counted(len(steps), 'load step')} ({at}) a linear loop explains all of PV but noise"


def words_of_closer(models: Mapping[str, FittedModel], chosen: str) -> tuple[str, ...]:
    """Return in words that another sticking valve than the one chosen leaves far less of PV itself; nothing else.

    What remains of PV is weighed as far as nobody could foretell it. A stem that is off by what wanders slowly may then
    be the likelier, but it is not known well.
    """
    closer = min((models[name] for name in STICKING if name in models), key=lambda model: model.residual_variance)
    if closer.residual_variance >= CLOSER * models[chosen].residual_variance:
        return ()
    own = f"the one with the lowest BIC {given(models[chosen].residual_variance, 3)}: which of them it is, is not known"
    return (f"{_words(closer.valve)} leaves {given(closer.residual_variance, 3)} EU² of PV's variance, {own}",)


def words_of_rival(name: str, ranges: Intervals, integrating: bool) -> str:
    """Return in words that another kind of valve fits as well, and with which stick band and gain."""
    kinds = {
        "stenman": "one that sticks again after every slip",
        "deadband": "a dead band",
        "choudhury": "one with stick band and slip jump",
        "he": "one that rests short of OP after every slip, held by friction in motion",
    }
    unit = "EU/(% s)" if integrating else "EU/%"
    told = [
        f"{what} {interval(pair, unit, 3)}"
        for what, pair, unit in (("of", ranges.d or ranges.S, "%"), ("with a gain of", ranges.gain, unit))
        if pair is not None
    ]
    return " ".join(("the record does not tell this valve from", kinds[name], *told)) + ": the ranges hold both"


WORDS_OF_BLIND = (
    "no setpoint move is recorded and OP only answers PV: what the controller makes of a disturbance may pass for the "
    "plant, whose gain, time constant and dead time are not identified; a setpoint move in the record would show them"
)
WORDS_OF_STRAIGHT = "a linear loop without stiction is not clearly less likely: the plant's ranges hold that one's too"


def words_of_open(ranges: Intervals, integrating: bool) -> tuple[str, ...]:
    """Return in words which ranges of the plant have an open end, and why; nothing where none has."""
    said = []
    gain, tau, theta = ranges.gain, ranges.time_constant, ranges.dead_time
    if tau is not None and math.isinf(tau[1]):
        said.append(
            f"the time constant has no upper end ({interval(tau, 's', 3)}): over this record a slower process looks "
            "the same, so that neither it nor the gain is identified"
        )
    elif gain is not None and any(math.isinf(end) for end in gain):
        unit = "EU/(% s)" if integrating else "EU/%"
        said.append(f"the gain is not identified ({interval(gain, unit, 3)}): PV hardly tells of the stem's moves")
    if theta is not None and math.isinf(theta[1]):
        said.append(
            f"the dead time is not identified ({interval(theta, 's', 3)}): the longest one searched fits as well as "
            "any, or the record tells nothing of it"
        )
    return tuple(said)


def _words(valve: Valve) -> str:
    if isinstance(valve, Deadband):
        return f"a dead band of {given(valve.b, 3)} %"
    if isinstance(valve, Stenman):
        return f"one that sticks within d = {given(valve.d, 3)} %"
    return f"one with stick band S = {given(valve.stick_band, 3)} % and slip jump J = {given(valve.slip_jump, 3)} %"
