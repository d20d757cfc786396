"""A signal that a lag makes of a drive, and what a lag leaves of it by numpy's least squares."""

from __future__ import annotations

import numpy as np

N = 160
POLES = np.array([0.05, 0.5, 0.9, 0.97, 0.9995, 0.3, 0.8])
DELAYS = np.array([0, 1, 3, 7], dtype=np.int64)


def signals(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.normal(size=N // 8), 8)
    drive -= drive[0]
    return drive, np.convolve(drive, 0.2 * 0.8 ** np.arange(20))[:N] + 0.3 * rng.normal(size=N)


def left(drive: np.ndarray, y: np.ndarray, pole: float, delay: int, counted: np.ndarray, sign: float) -> float:
    """What a constant, a transient and the delayed lag leave of y at the samples that count."""
    z = np.zeros(N)
    for k in range(N - 1):
        z[k + 1] = pole * z[k] + (1.0 - pole) * drive[k]
    answer = np.concatenate([np.zeros(delay), z[: N - delay]])
    first = int(np.flatnonzero(counted)[0])
    columns = np.column_stack([np.ones(N), pole ** (np.arange(N) - float(first)), answer])[counted]
    terms, *_ = np.linalg.lstsq(columns, y[counted], rcond=1e-9)
    if terms[2] * sign < 0.0:
        columns = columns[:, :2]
        terms, *_ = np.linalg.lstsq(columns, y[counted], rcond=1e-9)
    return float(((y[counted] - columns @ terms) ** 2).sum())
