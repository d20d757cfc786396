"""The sticking model against the linear loop beside all that may disturb it from outside, each at its likeliest.

What the verdict otherwise rests on, the stem in a record as it is, and what it adds to a prediction by one sample, sees
little where a load step lies over the record, or noise over a slow process. The whole model does: where a stem and its
load steps leave noise alone, and half of PV and less of what the linear loop leaves with load steps, colour and an
oscillation of its own, the valve sticks. And it is not accused where that linear loop is the likelier: a stem can
follow a sinusoid or a step of the load, but seldom as well as these do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import NamedTuple

from workbench.detect.verdict import Thresholds
from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit
from workbench.estimate.fits.sureness import ENOUGH_SLIPS, SURE_SLIPS
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.loads.settled import coloured_linear
from workbench.estimate.loads.steps import DEGREES
from workbench.estimate.loads.swing import Answered, Swing
from workbench.estimate.straight import Coloured, Straight, linear_beside, sought_beside_steps
from workbench.estimate.verdict import MOST, words_of_few
from workbench.model.numbers import given
from workbench.model.results import FittedModel, LinearFit

__all__ = ["CHANCE", "Rival", "rival_of", "weighed"]

CHANCE = Thresholds().likelihood  # a search over stems gains less than this of a linear loop

# Of the log likelihood, twice what detection asks for; of 27 real healthy loops 26 at most, with three quarters of PV
# left and more. Healthy ones under load steps and waves reach more, by a few slips or leaving colour.
LIKELIER = 2.0 * Thresholds().likelihood
ORDER = 1  # of the disturbance's autoregression: what is left is as good as noise


class Rival(NamedTuple):
    """The likeliest linear loop, the oscillation beside it if there is one, and how far a stem's model is ahead of it.

    ahead: log likelihood ratio; paid: the same, every load step that it has more than the model paid for as the search
    for steps does.
    """

    answered: Answered[LinearFit]
    swing: Swing | None
    ahead: float
    paid: float


def rival_of(data: Centred, fit: Fit, line: Straight, times: tuple[int, ...]) -> Rival:
    """Return the likeliest linear loop beside what may disturb it, as the rival of a sticking model.

    data, fit: the record in the measure, and without the load steps, that the model was fitted in, and its fit there;
    line: the linear fit to the record as it is; times: samples at which the model's load steps begin.
    """
    lines: list[tuple[Straight, tuple[int, ...]]] = [(line, ())]
    if times:
        # The linear loop may have the steps that the stem was found beside, and its plant.
        own = replace(line.fit, tau=fit.tau, theta=fit.theta, gain=fit.gain)
        lines.append((replace(line, fit=own), times))
    if data.samples <= WHOLE and line.free is not None:
        lines += islice(sought_beside_steps(line, line.free), 1)

    def ahead(answered: Answered[LinearFit]) -> float:
        return _ahead(data, fit, answered.settled, answered.paths[0].fit)

    found = (linear_beside(one, partial(_settled, times)) for one, times in lines)
    answered, swing = min(found, key=lambda one: ahead(one[0]))
    # A step answers with its size and its time, an oscillation with two sizes and its frequency; the record may already
    # stand beside one.
    rows = len(answered.settled.answers) - len(line.data.answers) - (0 if swing is None else len(swing.answers))
    more, lead = max(rows // 2 - len(times), 0), ahead(answered)
    return Rival(answered, swing, lead, lead + 0.5 * DEGREES * more * math.log(data.samples))


def _settled(times: tuple[int, ...], line: Straight) -> Coloured:
    """A line's fit without load steps, of which some are tried first at these samples."""
    return coloured_linear(line.data, line.fit, line.longest, times) if times else line.coloured


def _ahead(data: Centred, fit: Fit, where: Centred, rival: Fit) -> float:
    """The log likelihood ratio of one fit to another."""
    left = [max(f.sse / (d.samples - d.skip), d.floor) for d, f in ((where, rival), (data, fit))]
    return 0.5 * data.samples * math.log(left[0] / left[1])


def weighed(
    data: Centred,
    sticking: tuple[Fit, FittedModel],
    linear: tuple[Fit, FittedModel],
    rival: Callable[[], Rival],
    verdict: str,
    alone: bool,
) -> tuple[str, str]:
    """Return the verdict that the likelier explanation leads to, and why; as it was, and nothing, where none does.

    data: the record in the measure, and without the load steps, that the sticking model was fitted in; sticking,
    linear: these models there; rival: gives the likeliest linear loop; alone: whether the models accuse without
    detection.
    """
    model, accused = sticking[1], verdict == "stiction"
    # What accuses the valve is another stem, of more slips: the likeliest one takes few, as steps of the load are.
    if accused and alone and (few := words_of_few(model.slips)):
        return "undecided", f"by the likeliest stem {few}"
    # It may foretell PV better, where the noise of another measure makes up for the rest: it explains nothing.
    if accused and alone and model.residual_variance >= linear[1].residual_variance:
        least, most = given(linear[1].residual_variance, 3), given(model.residual_variance, 3)
        stem = f"the likeliest stem, which sticks over {given(model.valve.stick_band, 3)} %"
        own = f"leaves no less of PV than OP itself does ({most} and {least} EU²)"
        return "undecided", f"{stem}, {own}, and nothing else shows it"
    # A stem that hardly sticks leaves what the linear loop leaves once it is given the same steps.
    closer = _ahead(data, sticking[0], data, linear[0]) >= LIKELIER
    closer = closer and model.residual_variance <= MOST * linear[1].residual_variance
    if accused:
        # The stem leaves nothing for a linear loop to explain better, and slips too often for steps of the load.
        asked = alone or not (closer and model.slips >= ENOUGH_SLIPS and data.a.size == 1)
    else:
        asked = closer and model.slips >= SURE_SLIPS and data.a.size <= 1 + ORDER
    if not asked:
        return verdict, ""
    answered, swing, ahead, paid = rival()
    share = model.residual_variance / max(answered.model.residual_variance, data.floor)
    if accused and ((paid <= 0.0 and share >= 1.0) or (alone and ahead < CHANCE)):
        beside = "with load steps of its own" if answered.settled.load.any() else "by itself"
        if swing is not None:
            beside = (
                f"beside an oscillation from outside of {given(2.0 * math.pi / swing.angle * data.sample_time, 3)} s"
            )
        than = f"than a stem that sticks over {given(model.valve.stick_band, 3)} %"
        better = (
            f"explains PV better {than}" if ahead <= 0.0 else f"is hardly less likely {than}, which nothing else shows"
        )
        return "undecided", (
            f"a linear loop {beside} {better} (log likelihood ratio {abs(ahead):.0f}): look for what disturbs the loop"
        )
    if not accused and ahead >= LIKELIER and share <= MOST:
        return "stiction", (
            f"a stem that sticks over {given(model.valve.stick_band, 3)} %, with {model.slips} slips, explains all of "
            f"PV but noise: it leaves {share:.1%} of what a linear loop with its own load steps and oscillation leaves "
            f"(log likelihood ratio {ahead:.0f})"
        )
    return verdict, ""
