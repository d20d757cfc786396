"""Write scenarios/data/industrial_flow_loop.csv: a simulated stand-in for the paper's industrial loop (its Fig. 5).

A flow loop with the model that the paper estimated there (S = .63 %, K = .56, tau = 21 s, theta = 5 s), sampled every
5 s for three hours under a PI controller, with measurement noise, a slowly wandering load and one setpoint change, in
absolute units. Deterministic: the same file every time.

Run: python benchmarks/make_industrial_record.py
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

import workbench as wb

TARGET = Path(__file__).resolve().parent.parent / "scenarios" / "data" / "industrial_flow_loop.csv"
SAMPLE_TIME = 5.0
HOURS = 3
PV_AT_REST, OP_AT_REST = 60.0, 45.0
LOOP = wb.Loop(
    plant=wb.FOPDT(gain=0.56, time_constant=21.0, dead_time=5.0),
    valve=wb.Stenman(d=0.63),
    controller=wb.PID(Kc=0.9, Ti=40.0),
    sample_time=SAMPLE_TIME,
)
START = datetime(2024, 3, 12, 6, 0, tzinfo=UTC)


def load(samples: int) -> np.ndarray:
    """A slow random wander of the load, % at the plant input: first-order filtered white noise of 20 min, sd 0.1 %."""
    rng = np.random.default_rng(12)
    pole = np.exp(-SAMPLE_TIME / 1200.0)
    kicks = rng.normal(0.0, 0.1 * np.sqrt(1.0 - pole**2), samples)
    out = np.zeros(samples)
    for k in range(1, samples):
        out[k] = pole * out[k - 1] + kicks[k]
    return out


def main() -> None:
    """Simulate and write."""
    duration = HOURS * 3600.0
    samples = round(duration / SAMPLE_TIME)
    experiment = wb.Experiment(
        duration=duration,
        setpoint=(wb.Step(0.6, at=60.0), wb.Step(1.0, at=duration / 2.0)),
        load=wb.Series(load(samples).tolist()),
        noise=wb.Noise(sd=0.02, seed=5),
    )
    run = wb.simulate(LOOP, experiment)
    lines = ["time,SP,PV,OP,MODE"]
    for k in range(samples):
        stamp = (START + timedelta(seconds=k * SAMPLE_TIME)).strftime("%Y-%m-%d %H:%M:%S")
        sp, pv, op = PV_AT_REST + run.sp[k], PV_AT_REST + run.pv[k], OP_AT_REST + run.op[k]
        lines.append(f"{stamp},{sp:.2f},{pv:.3f},{op:.3f},AUTO")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text("\n".join(lines) + "\n", encoding="utf-8")
    moves = int(np.count_nonzero(np.diff(run.valve)))
    print(f"{TARGET.name}: {samples} rows, {TARGET.stat().st_size} bytes, {moves} stem moves")


if __name__ == "__main__":
    main()
