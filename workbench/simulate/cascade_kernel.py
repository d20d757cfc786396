"""Two loops, one in the other (model.cascade): each controller and the secondary's valve by the kernel's law."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.simulate.compiled import compiled
from workbench.simulate.kernel import (
    BIAS,
    DELAY,
    GAIN,
    IDEAL,
    KC,
    KI,
    POLE,
    STATES,
    U_LAST,
    VALVE,
    Y,
    run_loop,
    run_samples,
    sign,
    usual,
)
from workbench.simulate.sums import SUMS, add_sums, weigh

__all__ = ["CHAIN", "cascade_worst", "run_cascade"]

Floats = NDArray[np.float64]

# Of a cascade's chain from v to the primary's PV: (w, y) with w the secondary's PV, delayed by the primary's dead time,
# `w += .., y = A10 w + A11 y + ..`, the inputs' shares of v_{k-m} and v_{k-m-1}, and m, the whole samples of both dead
# times. SCALE: EU of the secondary per unit of the primary's output; HELD_BACK: 1 where a secondary at its limit holds
# the primary's integral.
A00, A10, A11, NEAR_W, NEAR_Y, FAR_W, FAR_Y, CHAIN_DELAY, SCALE, HELD_BACK = range(10)
CHAIN = 10
# A cascade's state beside those of its controllers: w, y, and the secondary's limit in the sample before.
CHAIN_W, CHAIN_Y, LIMIT = range(3)


@compiled
def run_cascade(
    c1: Floats,
    c2: Floats,
    chain: Floats,
    every: int,
    r: Floats,
    added: Floats,
    load: Floats,
    noise1: Floats,
    noise2: Floats,
    state1: Floats,
    state2: Floats,
    past2: Floats,
    link: Floats,
    tail: Floats,
    y1: Floats,
    u1: Floats,
    r2: Floats,
    y2: Floats,
    u2: Floats,
    x: Floats,
    v: Floats,
    branch: NDArray[np.int8],
) -> None:
    """Run N = u2.size samples, whole scans of `every`, of a cascade (model.cascade), and leave the state after them.

    c1: the primary's row with an ideal valve; what it says of a plant is not used. added: what the primary's load makes
    of its PV (EU). state1, state2, past2: as `run_loop`'s; link: the chain's state; tail[i] = v_{-1-i}, at least m + 1
    values. Written: y1 and y2 (N + 1, without noise), the rest N each; u1 and r2 are held between scans.
    """
    n = u2.size
    m = int(chain[CHAIN_DELAY])
    row = c1.copy()
    row[VALVE], row[POLE], row[GAIN], row[DELAY] = IDEAL, 1.0, 0.0, 0.0
    plain1, plain2 = usual(row), usual(c2)
    pushes = chain[SCALE] * sign(c2[KC])
    past1, still, py, one, px, pv = np.zeros(1), np.zeros(1), np.empty(2), np.empty(1), np.empty(1), np.empty(1)
    code = np.empty(1, np.int8)
    w, y, limit = link[CHAIN_W], link[CHAIN_Y], link[LIMIT]
    y1[0] = y + added[0]
    for first in range(0, n, every):
        end = first + every
        now = slice(first, end)
        e = r[first] - (y1[first] + noise1[first])
        outward = chain[HELD_BACK] != 0.0 and limit * pushes * c1[KI] * e > 0.0
        row[KI] = 0.0 if outward else c1[KI]
        state1[Y] = y1[first]
        # Written out where it can be: of stretches so short, the views that a call is given would cost most.
        if plain1:
            run_samples(row, r[now], still, noise1[now], state1, past1, py, one, px, pv, code, True)
        else:
            run_loop(row, r[now], still, noise1[now], state1, past1, py, one, px, pv, code)
        u1[now] = one[0]
        r2[now] = chain[SCALE] * one[0]
        seen = y2[first : end + 1]
        if plain2:
            run_samples(
                c2, r2[now], load[now], noise2[now], state2, past2, seen, u2[now], x[now], v[now], branch[now], True
            )
        else:
            run_loop(c2, r2[now], load[now], noise2[now], state2, past2, seen, u2[now], x[now], v[now], branch[now])
        limit = branch[end - 1] % 9 // 3 - 1.0
        for k in range(first, end):
            near = v[k - m] if k >= m else tail[m - k - 1]
            far = v[k - m - 1] if k > m else tail[m - k]
            y = chain[A10] * w + chain[A11] * y + (chain[NEAR_Y] * near + chain[FAR_Y] * far)
            w = chain[A00] * w + (chain[NEAR_W] * near + chain[FAR_W] * far)
            y1[k + 1] = y + added[k + 1]
    link[CHAIN_W], link[CHAIN_Y], link[LIMIT] = w, y, limit
    length = tail.size
    for i in range(length - 1, -1, -1):
        tail[i] = v[n - 1 - i] if n - 1 - i >= 0 else tail[i - n]


@compiled
def cascade_worst(
    rows: Floats,
    group: int,
    c2: Floats,
    chain: Floats,
    every: int,
    r: Floats,
    added: Floats,
    load: Floats,
    noise1: Floats,
    noise2: Floats,
    weights: Floats,
    ceilings: Floats,
    worst: Floats,
) -> int:
    """As `run_worst`, of a cascade under many primaries, from rest; returns the samples run.

    J is of the primary's error and of the secondary's output and stem. All signals: N + 1, N whole scans.
    """
    n = r.size - 1
    chunk = min(n, every * (127 // every + 1))
    y1, y2 = np.empty(chunk + 1), np.empty(chunk + 1)
    u1, r2, u2, x, v = np.empty(chunk), np.empty(chunk), np.empty(chunk), np.empty(chunk), np.empty(chunk)
    branch = np.empty(chunk, np.int8)
    state1, state2, link = np.empty(STATES), np.empty(STATES), np.empty(3)
    past2, tail = np.empty(int(c2[DELAY]) + 1), np.empty(int(chain[CHAIN_DELAY]) + 1)
    last, sums = np.empty(3), np.empty(SUMS)
    every_sum = weights[6:].max() > 0.0
    samples = 0
    for i in range(worst.size):
        worst[i] = 0.0
        for j in range(i * group, (i + 1) * group):
            state1[:], state2[:], link[:], past2[:], tail[:], sums[:] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            state2[U_LAST] = c2[BIAS]
            last[0], last[1], last[2] = c2[BIAS], 0.0, 0.0
            cost, begin = 0.0, 0
            while begin < n and cost <= ceilings[i]:
                size = min(chunk, n - begin)
                end = begin + size
                run_cascade(
                    rows[j],
                    c2,
                    chain,
                    every,
                    r[begin : end + 1],
                    added[begin : end + 1],
                    load[begin : end + 1],
                    noise1[begin : end + 1],
                    noise2[begin : end + 1],
                    state1,
                    state2,
                    past2,
                    link,
                    tail,
                    y1[: size + 1],
                    u1[:size],
                    r2[:size],
                    y2[: size + 1],
                    u2[:size],
                    x[:size],
                    v[:size],
                    branch[:size],
                )
                errors = noise1[begin : end + 1]
                add_sums(sums, last, every_sum, r[begin : end + 1], errors, y1[: size + 1], u2[:size], x[:size])
                cost = weigh(sums, weights, end, n)
                begin = end
            samples += begin
            if not cost <= ceilings[i]:
                worst[i] = np.inf
                break
            worst[i] = max(worst[i], cost)
    return samples
