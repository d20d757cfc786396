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

# Of the log likelihood, twice what detection asks for: of 70 simulated and 27 real healthy loops 36 at most, with .8 of
# PV left and more.
LIKELIER = 2.0 * Thresholds().likelihood
ORDER = 1  # of the disturbance's autoregression: what is left is as good as noise
SLIPS = 2 * ENOUGH_SLIPS  # a few may fall in with as many steps of the load


def weighed(
    data: Centred, fit: Fit, model: FittedModel, beside: tuple[Fit, FittedModel], line: Straight, verdict: str
) -> tuple[str, str]:
    """Return the verdict that the likelier explanation leads to, and why; as it was, and nothing, where none does.

    data: the record in the measure that the sticking model was fitted in, with its fit; beside: the linear model there,
    less the same load steps; line: the linear fit to the record as it is.
    """
    accused = verdict == "stiction"
    ahead = 0.5 * data.samples * math.log(max(beside[0].sse, data.samples * data.floor) / max(fit.sse, 1e-300))
    # A stem that hardly sticks leaves what the linear loop leaves once it is given the same steps.
    closer = ahead >= LIKELIER and model.residual_variance <= MOST * beside[1].residual_variance
    # Without steps of its own a stem may be no more than the likeness of one.
    stands = closer and data.load.any() and model.slips >= SLIPS and data.a.size <= 1 + ORDER
    if not accused and not stands:
        return verdict, ""
    answered, swing = linear_beside(line)
    rival, linear = answered.settled, answered.paths[0].fit

    def innovations(where: Centred, of: Fit) -> float:
        return max(of.sse / (where.samples - where.skip), where.floor)

    likelier = 0.5 * data.samples * math.log(innovations(rival, linear) / innovations(data, fit))
    share = model.residual_variance / max(answered.model.residual_variance, data.floor)
    if accused and likelier <= 0.0 and share >= 1.0:
        with_what = "with load steps of its own" if rival.load.any() else "by itself"
        if swing is not None:
            with_what = f"beside an oscillation from outside of {2.0 * math.pi / swing.angle * data.sample_time:.3g} s"
        return "undecided", (
            f"a linear loop {with_what} explains PV better than a stem that sticks over {model.valve.stick_band:.3g} % "
            f"(log likelihood ratio {-likelier:.0f}): look for what disturbs the loop"
        )
    if not accused and likelier >= LIKELIER and share <= MOST:
        return "stiction", (
            f"a stem that sticks over {model.valve.stick_band:.3g} %, with {model.slips} slips, explains all of PV but "
            f"noise: it leaves {share:.1%} of what a linear loop with its own load steps and oscillation leaves (log "
            f"likelihood ratio {likelier:.0f})"
        )
    return verdict, ""
