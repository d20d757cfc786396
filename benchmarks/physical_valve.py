"""What an estimate finds of a valve that is no stiction model: a stem with mass, spring and friction in a PI loop.

Run by hand: `python benchmarks/physical_valve.py`. Each line: a set of forces, PV's noise, the dead band and resolution
of the valve on the bench (`wb.signature`), and what `wb.estimate` reports of a record of SP, PV and OP in closed loop.
"""

from __future__ import annotations

import time
from dataclasses import replace

import workbench as wb

# Kayihan and Doyle's set, and the same valve with a tenth of its friction; after Garcia, with graphite packing.
DOYLE = wb.Karnopp(1.36, 52_500.0, 0.0847, 1423.0, 1708.0, 612.0, 2.54e-4)
SOFT = replace(DOYLE, coulomb=142.3, static=170.8)
JUMPY = replace(DOYLE, coulomb=60.0, static=170.8)
GARCIA = wb.Karnopp(1.6, 210_490.0, 0.029, 700.0, 780.0, 125_000.0, 5e-4)
VALVES = {"strong": DOYLE, "a tenth": SOFT, "jumpy": JUMPY, "graphite": GARCIA}
PLANT = wb.FOPDT(1.0, 20.0, 3.0)
SAMPLES = 4000


def main() -> None:
    """Print the table."""
    print("valve      noise    S bench J bench | verdict      S found (range)          J found   K     tau   theta   s")
    for name, valve in VALVES.items():
        bench = wb.signature(valve)
        size = valve.stick_band
        loop = wb.Loop(PLANT, valve, wb.PID(1.0, 15.0), 1.0)
        steps = [wb.Step(0.8 * size), wb.Step(-1.1 * size, at=1500.0), wb.Step(0.7 * size, at=2700.0)]
        for share in (0.0, 0.01, 0.05):
            noise = wb.Noise(share * size, 1)
            run = wb.simulate(loop, wb.Experiment(float(SAMPLES), setpoint=steps, noise=noise))
            record = wb.Record(pv=run.pv, op=run.op, sp=run.sp, sample_time=1.0)
            begin = time.process_time()
            found = wb.estimate(record)
            took = time.process_time() - begin
            S, J, low_high = found.valve.stick_band, found.valve.slip_jump, found.intervals.S or found.intervals.d
            span = "open" if low_high is None else f"{low_high[0]:.3f} to {low_high[1]:.3f}"
            plant = found.plant
            print(
                f"{name:9s} {noise.sd:6.3f} {bench.dead_band:9.3f} {bench.resolution:7.3f} | {found.verdict:12s} "
                f"{S:7.3f} ({span:18s}) {J:7.3f} {type(found.valve).__name__:9s} {plant.gain:5.2f} "
                f"{getattr(plant, 'time_constant', float('nan')):5.1f} {plant.dead_time:5.2f} {took:5.1f}"
            )


if __name__ == "__main__":
    main()
