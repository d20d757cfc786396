"""Robust tuning of the paper's loop: known tunings and our own on 2,000 fresh draws of the plant-ready ensemble.

Run by hand: `python benchmarks/robust_tuning.py [seeds]`. For each tuning: mean square error (median, 90th percentile,
mean over draws), valve travel (median, mean), both medians with the valve repaired, the worst corner's Ms, and draws
that diverge. Targets: with Ms <= 2 an error of at most 0.26 at a travel of at most 250 %; without limits at most 0.155
(PI); none diverging.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import workbench as wb

KNOWN = {
    "Case 1": (0.5, 20.0, 0.0),
    "Case 2": (0.5, 200.0, 0.0),
    "Case 3": (0.5, 20.0, 6.0),
    "Case 4": (2.01, 301.0, 0.0),
    "Case 5": (1.32, 196.0, 1.0),
    "SIMC": (2.5, 5.0, 0.0),
    "lambda = tau": (0.83, 5.0, 0.0),
    "lambda = 3 tau": (0.31, 5.0, 0.0),
    "nominal PI": (2.447, 8.33, 0.0),
}
PI, PID = wb.Bounds(Td=(0.0, 0.0)), wb.Bounds()
ASKED = {
    "PI, Ms <= 2": (PI, wb.Constraints(max_sensitivity=2.0)),
    "PID, Ms <= 2": (PID, wb.Constraints(max_sensitivity=2.0)),
    "PID, Ms <= 2, 250 %": (PID, wb.Constraints(max_sensitivity=2.0, valve_travel=250.0)),
    "PI, Ms <= 2, 99 %": (PI, wb.Constraints(max_sensitivity=2.0, valve_travel=99.0)),
    "PI, no limits": (PI, wb.Constraints()),
    "PID, no limits": (PID, wb.Constraints()),
}


def line(name: str, loop: wb.Loop, fresh: wb.Ensemble, more: str = "") -> None:
    found = wb.assess(loop, fresh)
    repaired = wb.assess(replace(loop, valve=wb.Ideal()), fresh)
    c = loop.controller
    print(
        f"{name:20s} {c.Kc:7.4g} {c.Ti:7.4g} {c.Td:7.4g}  {found.mse_median:6.3f} {found.mse_p90:6.3f} "
        f"{found.mse_mean:6.3f} {found.travel_median:7.1f} {found.travel_mean:7.1f}  {repaired.mse_median:6.3f} "
        f"{repaired.travel_median:6.0f} {found.max_sensitivity:6.2f} {found.diverged:5d} {more}"
    )


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    loop = wb.Loop(
        plant=wb.FOPDT(gain=1.0, time_constant=5.0, dead_time=1.0),
        valve=wb.Stenman(d=2.0),
        controller=wb.PID(Kc=0.5, Ti=20.0, derivative_on="pv"),
        sample_time=1.0,
    )
    experiment = wb.Experiment(duration=1000.0, setpoint=wb.Step(size=4.0))
    ready = wb.Ensemble.plant_ready(loop)
    fresh = replace(ready, draws=2000, seed=1234)
    heads = ("Kc", "Ti", "Td", "median", "p90", "mean", "travel", "mean", "rep.mse", "tr.", "Ms", "lost")
    widths = (7, 7, 7, 7, 6, 6, 7, 7, 7, 6, 6, 5)
    print(f"{'tuning':20s}", *(f"{head:>{width}s}" for head, width in zip(heads, widths, strict=True)))
    for name, (Kc, Ti, Td) in KNOWN.items():
        line(name, loop.with_controller(replace(loop.controller, Kc=Kc, Ti=Ti, Td=Td)), fresh)
    for name, (bounds, constraints) in ASKED.items():
        for seed in range(seeds):
            tuned = wb.tune(loop, experiment, bounds=bounds, seed=seed, robust=ready, constraints=constraints)
            more = f"{tuned.status.value}, {tuned.wall_time:.1f} s"
            line(name, loop.with_controller(tuned.controller), fresh, more)


if __name__ == "__main__":
    main()
