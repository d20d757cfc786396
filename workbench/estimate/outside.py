"""The sticking model against the linear loop beside all that may disturb it from outside, each at its likeliest.

What the verdict otherwise rests on, the stem in a record as it is, and what it adds to a prediction by one sample, sees
little where a load step lies over the record, or noise over a slow process. The whole model does: where a stem and its
load steps leave noise alone, and half of PV and less of what the linear loop leaves with load steps, colour and an
oscillation of its own, the valve sticks. And it is not accused where that linear loop is the likelier: a stem can
follow a sinusoid or a step of the load, but seldom as well as these do.
"""

from __future__ import annotations

import math

from workbench.detect.verdict import Thresholds
from workbench.estimate.data import Centred
from workbench.estimate.fit import Fit
from workbench.estimate.straight import Straight, linear_beside
from workbench.estimate.verdict import ENOUGH_SLIPS, MOST
from workbench.model.results import FittedModel

__all__ = ["weighed"]

# Of the log likelihood, twice what detection asks for; of 27 real healthy loops 26 at most, with three quarters of PV
# left and more. Healthy ones under load steps and waves reach more, by a few slips or leaving colour.
LIKELIER = 2.0 * Thresholds().likelihood
ORDER = 1  # of the disturbance's autoregression: what is left is as good as noise
SLIPS = 2 * ENOUGH_SLIPS  # a few may fall in with as many steps of the load


def weighed(
    data: Centred,
    sticking: tuple[Fit, FittedModel],
    linear: tuple[Fit, FittedModel],
    line: Straight,
    verdict: str,
) -> tuple[str, str]:
    """Return the verdict that the likelier explanation leads to, and why; as it was, and nothing, where none does.

    data: the record in the measure, and without the load steps, that the sticking model was fitted in; sticking,
    linear: these models there; line: the linear fit to the record as it is.
    """

    def ahead(where: Centred, rival: Fit) -> float:
        """The log likelihood ratio of the sticking model to a rival."""
        left = [max(fit.sse / (d.samples - d.skip), d.floor) for d, fit in ((where, rival), (data, sticking[0]))]
        return 0.5 * data.samples * math.log(left[0] / left[1])

    model, accused = sticking[1], verdict == "stiction"
    # A stem that hardly sticks leaves what the linear loop leaves once it is given the same steps.
    closer = ahead(data, linear[0]) >= LIKELIER and model.residual_variance <= MOST * linear[1].residual_variance
    if not accused and not (closer and model.slips >= SLIPS and data.a.size <= 1 + ORDER):
        return verdict, ""
    answered, swing = linear_beside(line)
    likelier = ahead(answered.settled, answered.paths[0].fit)
    share = model.residual_variance / max(answered.model.residual_variance, data.floor)
    if accused and likelier <= 0.0 and share >= 1.0:
        beside = "with load steps of its own" if answered.settled.load.any() else "by itself"
        if swing is not None:
            beside = f"beside an oscillation from outside of {2.0 * math.pi / swing.angle * data.sample_time:.3g} s"
        return "undecided", (
            f"a linear loop {beside} explains PV better than a stem that sticks over {model.valve.stick_band:.3g} % "
            f"(log likelihood ratio {-likelier:.0f}): look for what disturbs the loop"
        )
    if not accused and likelier >= LIKELIER and share <= MOST:
        return "stiction", (
            f"a stem that sticks over {model.valve.stick_band:.3g} %, with {model.slips} slips, explains all of PV but "
            f"noise: it leaves {share:.1%} of what a linear loop with its own load steps and oscillation leaves (log "
            f"likelihood ratio {likelier:.0f})"
        )
    return verdict, ""
