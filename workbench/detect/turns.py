"""PV's own turns beside the free linear predictor: a placebo for the stem.

A stem knows more than a linear predictor does only by where OP turns, and by which moves hide within the stick band.
Where something from outside turns PV, another loop's sticking valve by any road through the plant, a process that is
not linear, a sensor, OP turns after it, and a stem passes for the cause. PV itself turns first: a stem made of PV in
OP's place knows that as well or better. What the loop's own valve does follows OP's turns, and no such stem's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from workbench.detect.laws import Law
from workbench.detect.predictor import FreePredictor
from workbench.model.valve import Deadband

__all__ = ["turns_of_pv"]

BANDS = np.geomspace(0.02, 0.8, 8).tolist()  # as shares of PV's range
CLOSER = (0.77, 0.88, 1.14, 1.3)  # times one of them: between it and the next


def turns_of_pv(free: FreePredictor, delays: list[int]) -> float:
    """Return the log likelihood ratio of the prediction of PV with and without its own turns.

    The best of PV behind dead bands of any width, delayed by any of `delays` (samples, rising) or between, each beside
    the past of PV and OP with as many coefficients as a stem has (`FreePredictor.adds`).
    """
    y, held, *_ = free.asked
    # What nobody recorded turns nowhere.
    at = np.arange(y.size)
    y = np.interp(at, at[~held], y[~held])
    width = float(np.ptp(y))

    def best(share: float, delays: Sequence[int]) -> tuple[float, float, int]:
        path = Law(Deadband(share * width), 0.0).path(y)
        return max((gain, share, delay) for gain, delay in zip(free.adds_at(path, delays), delays, strict=True))

    _, share, delay = max(best(share, delays) for share in BANDS)
    k = delays.index(delay)
    gain, _, delay = best(share, range(delays[max(k - 1, 0)], delays[min(k + 1, len(delays) - 1)] + 1))
    return max([gain, *(best(share * factor, [delay])[0] for factor in CLOSER)])
