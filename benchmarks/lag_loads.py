"""How well sticking valves of self-regulating loops are known under a slow load that nobody recorded.

Random first-order loops under PI from brisk to slow, with Stenman and two-parameter valves that set off at least ten
times, noise of up to 10 % of what the band does to PV, and a load that drifts by 5 to 40 % of it; four in ten have a
setpoint move. In a plain cycle gain and jump make up for each other: what counts then is whether the ranges hold them.

Printed for each record: verdict, stick band and gain as shares of the true ones; at last how many are right.

Run: python benchmarks/lag_loads.py [LOOPS [FIRST [SAMPLES]]]
"""

from __future__ import annotations

import math

import numpy as np
from detection import drift
from level_loads import asked, scored

import workbench as wb


def drawn(seed: int, samples: int) -> tuple[wb.Loop, wb.Record, int]:
    """Return a random loop, its record, and how often its stem set off."""
    rng = np.random.default_rng([seed, 77])
    gain = math.exp(rng.uniform(math.log(0.3), math.log(5.0))) * float(rng.choice([1, 1, 1, -1]))
    tau = math.exp(rng.uniform(math.log(2.0), math.log(60.0)))
    theta = float(rng.uniform()) * min(tau, 15.0)
    speed = (tau + theta) * float(rng.uniform(0.3, 2.0))
    Kc, Ti = tau / abs(gain) / (speed + theta), tau * float(rng.uniform(0.6, 1.5))
    S = float(rng.uniform(1.0, 10.0))
    jump = S * float(rng.uniform(0.3, 1.5))
    valve = (wb.Stenman(S), wb.Choudhury(S, S), wb.Choudhury(S, jump))[int(rng.integers(3))]
    load = rng.uniform(0.05, 0.4) * S * drift(rng, samples, rng.uniform(5.0, 40.0) * speed)
    noise = wb.Noise(float(rng.uniform(0.0, 0.1)) * S * abs(gain), seed)
    loop = wb.Loop(wb.FOPDT(gain, tau, theta), valve, wb.PID(Kc, Ti, action="reverse" if gain > 0.0 else "direct"), 1.0)
    still = rng.random() < 0.6
    setpoint = None if still else wb.Step(S * abs(gain) * float(rng.uniform(0.5, 2.0)), at=0.3 * samples)
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint, wb.Series(load.tolist()), noise))
    moving = np.diff(run.valve) != 0.0
    moves = int((moving[1:] & ~moving[:-1]).sum())
    return loop, wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0), moves


if __name__ == "__main__":
    scored(wb.FOPDT, drawn, *asked())
