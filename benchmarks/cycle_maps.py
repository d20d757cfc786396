"""Maps of tunings: what they cost, and whether their cells say what `wb.limit_cycle` says of the same tunings.

Run by hand: `python benchmarks/cycle_maps.py [--points 60] [--cells 60]`. Six loops (both plants; one-parameter,
two-parameter and dead-band valves; slow and fast), each mapped over (Kc, Ti) in its default ranges; then random cells
compared with all eight starts of `wb.limit_cycle`, where both say that the loop cycles. Times are the wall clock's and
the processor's; other work on the machine slows the former.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace

import numpy as np

import workbench as wb

PI = wb.PID(1.0, 20.0)
LOOPS = {
    "the paper's flow loop": wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), PI, 1.0),
    "two-parameter, S = 4, J = 1": wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Choudhury(4.0, 1.0), PI, 1.0),
    "slow, S = 4, J = 2": wb.Loop(wb.FOPDT(1.0, 30.0, 10.0), wb.Choudhury(4.0, 2.0), PI, 1.0),
    "dead band": wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Deadband(2.0), PI, 1.0),
    "level, two-parameter": wb.Loop(wb.Integrating(0.02, 4.0), wb.Choudhury(4.0, 1.0), PI, 1.0),
    "level, one-parameter": wb.Loop(wb.Integrating(0.02, 4.0), wb.Stenman(4.0), PI, 1.0),
}


def main() -> None:
    """Print a line for each loop."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--points", type=int, default=60)
    asked.add_argument("--cells", type=int, default=60)
    given = asked.parse_args()
    rng = np.random.default_rng(0)
    wb.cycle_map(LOOPS["the paper's flow loop"], points=2)  # compiles
    print(f"{given.points} x {given.points} cells; load of the machine before: {os.getloadavg()[0]:.1f}")
    for name, loop in LOOPS.items():
        wall, cpu = time.perf_counter(), time.process_time()
        found = wb.cycle_map(loop, points=given.points)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        same = both = period = swing = inside = 0
        for _ in range(given.cells):
            row, column = (int(rng.integers(given.points)) for _ in range(2))
            pid = replace(loop.controller, Kc=float(found.Kc[column]), Ti=float(found.values[row]))
            cycle, cell = wb.limit_cycle(loop.with_controller(pid)), found.at(pid.Kc, pid.Ti)
            assert cell is not None
            same += cell.outcome == cycle.outcome
            if cell.outcome == cycle.outcome == "cycles":
                both += 1
                period += abs(cell.period / cycle.period - 1.0) <= 0.05
                inside += 0.99 * cycle.period_range[0] <= cell.period <= 1.01 * cycle.period_range[1]
                swing += abs(cell.pv_peak_to_peak / cycle.pv_peak_to_peak - 1.0) <= 0.02
        counts = ", ".join(f"{found.count(one)} {one}" for one in ("cycles", "depends", "settles", "undecided"))
        print(
            f"{name}: {wall:.1f} s, processor {cpu:.1f} s; of {int(found.linear_stable.sum())} stable cells {counts}; "
            f"same class in {same} of {given.cells}, and of {both} that cycle period within 5 % in {period}, inside "
            f"the range in {inside}, swing within 2 % in {swing}",
            flush=True,
        )


if __name__ == "__main__":
    main()
