"""Load disturbances that come too often: Hägglund's integrated absolute error between zero crossings."""

from __future__ import annotations

import math

import numpy as np

from workbench.model.record import FloatArray

__all__ = ["DETECTIONS", "load_index"]

DETECTIONS = 10.0  # within the supervision time, as published
SUPERVISED = 50.0  # periods of supervision, as published
AMPLITUDE = 0.1  # of the error's range: the amplitude of a cycle that matters, where PV's range is not known


def load_index(error: FloatArray, sample_time: float, period: float, amplitude: float | None = None) -> float:
    """Return the weighted number of load disturbances in the latest 50 periods; 10 or more mean an oscillation.

    error: SP - PV (EU), shape (N,). A load disturbance is a stretch between zero crossings whose integrated absolute
    error exceeds that of half a period of a sinusoid of `amplitude` (EU; published: 1 % of PV's measuring range; by
    default a tenth of the error's own range), `2 a / w`; they are counted with exponential forgetting,
    `x_k = lambda x_{k-1} + load_k`, `lambda = 1 - Ts/(50 period)`, and the largest count is returned (T. Hägglund, "A
    control-loop performance monitor", Control Engineering Practice 3 (1995) 1543-1551). 0 where the period (s) is nan.
    """
    if not math.isfinite(period):
        return 0.0
    limit = (AMPLITUDE * float(np.ptp(error)) if amplitude is None else amplitude) * period / math.pi
    if limit <= 0.0:
        return 0.0
    ends = np.flatnonzero((error[:-1] > 0.0) != (error[1:] > 0.0)) + 1
    areas = np.add.reduceat(np.abs(error), np.concatenate([[0], ends])) * sample_time
    forgetting = max(1.0 - sample_time / (SUPERVISED * period), 0.0)
    count, most, at = 0.0, 0.0, 0
    for end, area in zip(ends.tolist(), areas[:-1].tolist(), strict=True):
        count *= forgetting ** (end - at)
        at = end
        if area > limit:
            count += 1.0
            most = max(most, count)
    return most
