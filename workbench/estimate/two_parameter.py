"""A coarse look at the two-parameter valve: does a stem with stick band S and slip jump J explain PV?

The one-parameter search is blind to a dead band. Before it acquits a valve, this grid over (S, J) must not do clearly
better than the linear model either.
"""

from __future__ import annotations

import math

import numpy as np

from workbench.estimate.data import Centred
from workbench.estimate.fit import LEAST_TAU, Fit, Limits, fit_path
from workbench.model.valve import Choudhury
from workbench.simulate.run import valve_response

__all__ = ["look"]

BANDS = 14
NARROWEST, WIDEST = 0.04, 0.95  # of OP's range
JUMPS = (0.0, 0.3, 0.8)  # J as a share of S


def look(data: Centred, linear: Fit, longest: float) -> tuple[Choudhury, float]:
    """Return the best valve of the grid and its sum of squares, with dead times up to `longest` samples.

    The stem starts in the middle of its band at OP's first value; unlike the one-parameter stem it forgets its start
    once it has moved.
    """
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
    best = (Choudhury(0.0, 0.0), math.inf)
    tau, theta = max(linear.tau, LEAST_TAU), min(linear.theta, longest)
    for band in (np.geomspace(NARROWEST, WIDEST, BANDS) * data.op_range).tolist():
        for share in JUMPS:
            valve = Choudhury(band, share * band)
            x = valve_response(valve, data.u, float(data.u[0]))
            for start in {theta, max(theta - band / data.op_range * theta, 0.0)}:
                fit = fit_path(
                    data, x, 0, (-math.inf, math.inf), limits, start, tau=tau, evaluations=50, tolerance=1e-4
                )
                if fit.sse < best[1]:
                    best = (valve, fit.sse)
    return best
