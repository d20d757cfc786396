"""First order or integrating: which plant a record shows, by how well each foretells PV one sample ahead.

Under a coloured load the output error of an integrating plant wanders, and its sum of squares says little. So plant and
disturbance are fitted in turns: the generalised least squares of D. Clarke, "Generalized least squares estimation of
the parameters of a dynamic model", IFAC Symposium on Identification in Automatic Control Systems, Prague 1967.
"""

from __future__ import annotations

import math

from workbench.estimate.data import Centred
from workbench.estimate.fit import LEAST_TAU, Fit, Limits, disturbance, fit_path, predict
from workbench.estimate.models import PLANT_PARAMETERS, VALVE_PARAMETERS
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import FloatArray
from workbench.model.valve import Valve

__all__ = ["foretelling_bic"]

ROUNDS = 4


def foretelling_bic(
    data: Centred, plant: Plant, valve: Valve, valve_position: FloatArray, prediction: FloatArray
) -> float:
    """Return `N log V + p log N` with V the mean square of the one-step prediction errors, along the stem found.

    data: the record as it was estimated, to the plant and valve with this stem (%, shape (N,)) and prediction (PV, EU,
    shape (N,)), less an oscillation from outside. p counts plant, valve, oscillation and disturbance.
    """
    n = data.samples
    x = valve_position - data.op_middle
    tau = plant.time_constant / data.sample_time if isinstance(plant, FOPDT) else 1.0
    fit = Fit(math.nan, tau, plant.dead_time / data.sample_time, 0.0, 0.0, 0.0, 0.0)
    limits = Limits((LEAST_TAU, float(n)), (0.0, max(2.0 * fit.theta, 30.0)))
    left = data.pv_mean + data.load + data.y - prediction
    free = VALVE_PARAMETERS.get(type(valve).__name__.lower(), 0) + len(data.answers)
    least = math.inf
    for _ in range(ROUNDS):
        coloured = data.whitened(disturbance(left, data.floor), 0)
        fit = fit_path(coloured, x, 0, (-math.inf, math.inf), limits, fit.theta, tau=fit.tau)
        variance = fit.sse / (n - coloured.skip)
        p = PLANT_PARAMETERS - data.integrating + free + coloured.a.size - 1
        least = min(least, n * math.log(max(variance, data.floor)) + p * math.log(n))
        left = data.y - predict(data, x, 0, fit)[0]
    return least
