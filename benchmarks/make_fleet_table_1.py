"""Make scenarios/data/fleet_table_1.parquet: 20 simulated loops with the periods and stiction of the paper's Table I.

Run by hand: `python benchmarks/make_fleet_table_1.py`. Controllers run at 5 s, and the historian keeps what they see
for 6 hours, rounded. Loops with stiction cycle by themselves, from the closed form of the relaxation cycle; of those
without, 1, 9 and 16 follow the sticking loop of the same period (2, 8 and 15), 3 and 4 share a source outside, as do
10 and 11, and the others have one each. The oscillation index is set by how restless the load is.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from detection import drift

import workbench as wb

ROOT = Path(__file__).parents[1]
# Table I: oscillation index, period in minutes, stiction in % of travel (0: none reported).
TABLE = (
    (0.63, 2, 0), (0.63, 2, 1.8), (0.71, 2.5, 0), (0.70, 2.5, 0), (0.72, 4, 0.91),
    (0.80, 4.5, 0.15), (0.64, 5, 2.51), (0.98, 6, 8.82), (0.86, 6, 0), (0.49, 8, 0),
    (0.54, 8, 0), (0.45, 8.5, 0), (0.69, 10, 0.32), (0.43, 10, 3.16), (0.62, 10.5, 0.77),
    (0.59, 10.5, 0), (0.46, 12.5, 1.06), (0.94, 14, 0), (0.79, 17, 0.49), (0.74, 17.5, 1.72),
)  # fmt: skip
FOLLOWS = {1: 2, 9: 8, 16: 15}
OUTSIDE = {4: 3, 11: 10}
LEAD, HOURS, SCAN = 6, 6, 5


def made(number: int, driver: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, float]]:
    """Return SP, PV and OP at each scan and the tuning of one loop; driver: PV that it follows, or None."""
    index, minutes, stiction = TABLE[number - 1]
    rng = np.random.default_rng([1, number])
    n, period = (LEAD + HOURS) * 3600 // SCAN, 60.0 * minutes
    gain, tau, theta = float(rng.uniform(0.5, 1.5)), min(float(rng.uniform(8.0, 20.0)), period / 12.0), float(SCAN)
    size = stiction or 1.0
    restless = 1.0 - index
    if stiction:
        part = 0.5  # Kc K: the stem sticks again at every slip, so S = J
        Kc = part / gain
        Ti = (period / 4.0 - tau - theta) / (1.0 / part - 1.0)
        valve: object = wb.Stenman(stiction)
        load = 0.2 * restless * size * drift(rng, n, 2.0 * period / SCAN)
    else:
        Kc, Ti, valve = 0.4 / gain, 30.0, wb.Ideal()
        if driver is not None:
            wave = np.tile((driver - driver.mean()) / driver.std(), 2)
        else:
            # A source outside is no clock: its phase wanders.
            phase = 2.0 * math.pi * SCAN * np.arange(n) / period
            phase += 0.05 * restless * np.cumsum(rng.normal(size=n))
            wave = math.sqrt(2.0) * np.sin(phase)
        # The share of the wave in PV's variance is the index.
        load = 2.0 * wave + 2.0 * math.sqrt(1.0 / index - 1.0) * drift(rng, n, 0.3 * period / SCAN)
    loop = wb.Loop(wb.FOPDT(gain, tau, theta), valve, wb.PID(Kc, Ti), float(SCAN))
    noise = wb.Noise(0.04 * size * gain, number)
    # A step sets the cycle off; the hours in which it settles are left out.
    step = wb.Step(0.4 * gain * stiction) if stiction else None
    run = wb.simulate(loop, wb.Experiment(float(n * SCAN), step, wb.Series(load.tolist()), noise))
    late = slice(LEAD * 3600 // SCAN, None)
    return 50.0 + run.sp[late], 50.0 + run.pv[late], 45.0 + run.op[late], {"Kc": Kc, "Ti": Ti}


def main() -> None:
    """Write the data set and the manifest."""
    made_by: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, float]]] = {}
    order = [n for n in range(1, 21) if n not in FOLLOWS and n not in OUTSIDE] + [*FOLLOWS, *OUTSIDE]
    for number in order:
        leader = FOLLOWS.get(number) or OUTSIDE.get(number)
        made_by[number] = made(number, None if leader is None else made_by[leader][1])
    schema = pa.schema([("tag", pa.string()), ("time", pa.timestamp("s")), ("value", pa.float32())])
    target = ROOT / "scenarios" / "data" / "fleet_table_1.parquet"
    entries = []
    with pq.ParquetWriter(target, schema, compression="zstd", compression_level=19) as writer:
        for number in range(1, 21):
            sp, pv, op, tuning = made_by[number]
            name = f"FIC{100 + number}"
            times = 1_729_123_200 + SCAN * np.arange(sp.size)
            for tag, values, digits in (("OP", op, 2), ("PV", pv, 2), ("SP", sp[:1], 2)):
                kept = np.round(values, digits).astype(np.float32)
                at = times[: kept.size]
                table = pa.table(
                    [pa.array([f"{name}.{tag}"] * kept.size), pa.array(at).cast(pa.timestamp("s")), pa.array(kept)],
                    schema=schema,
                )
                writer.write_table(table)
            index, minutes, stiction = TABLE[number - 1]
            entries.append(
                f"  - {{name: {name}, Kc: {tuning['Kc']:.3g}, Ti: {tuning['Ti']:.3g} s, plant: fopdt}}"
                f"  # No. {number}: {index:.2f}, {minutes:g} min, {f'{stiction:g} %' if stiction else 'none'}"
            )
    text = (
        "# Table I of the paper as a site: 20 simulated loops with its periods and stiction; at the end of each line\n"
        "# its oscillation index, period and stiction. benchmarks/make_fleet_table_1.py makes the data and this file.\n"
        "#   workbench fleet scenarios/fleet_table_1.yaml --out reports/fleet_table_1\n"
        "title: Twenty cycling loops of one process area, after Table I\n"
        "data: data/fleet_table_1.parquet\n"
        "depth: tune\n"
        "loops:\n" + "\n".join(entries) + "\n"
    )
    (ROOT / "scenarios" / "fleet_table_1.yaml").write_text(text, encoding="utf-8")
    print(f"{target}: {target.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
