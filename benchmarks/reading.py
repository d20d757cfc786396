"""How fast 24 h of a loop at 1 s (86,400 samples of SP, PV, OP and MODE) are read, by kind of file.

Run by hand: `python benchmarks/reading.py`. Each figure is the best of five, in processor time of one core, with the
file in the system's cache; the peak is that of the whole process.
"""

from __future__ import annotations

import resource
import tempfile
import time
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import workbench as wb

SAMPLES = 86_400
REPEATS = 5


def files(folder: Path) -> dict[str, Path]:
    """Write the same record in each form."""
    rng = np.random.default_rng(0)
    pv = (50.0 + np.cumsum(rng.normal(0.0, 0.01, SAMPLES))).round(4).tolist()
    op = (40.0 + np.cumsum(rng.normal(0.0, 0.01, SAMPLES))).round(4).tolist()
    start = datetime(2024, 10, 17)  # noqa: DTZ001 - a clock on a wall
    times = [start + timedelta(seconds=k) for k in range(SAMPLES)]
    rows = list(zip(times, pv, op, strict=True))
    out = {name: folder / f"{name}.csv" for name in ("wide", "german", "tall")}
    wide = [f"{t},50.00,{y},{u},AUTO" for t, y, u in rows]
    out["wide"].write_text("\n".join(["time,SP,PV,OP,MODE", *wide]))
    german = [f"{t:%d.%m.%Y %H:%M:%S};" + f"50.00;{y};{u};AUTO".replace(".", ",") for t, y, u in rows]
    out["german"].write_text("\n".join(["time;SP;PV;OP;MODE", *german]))
    tall = [f"FIC1.{tag},{t},{v},Good" for t, y, u in rows for tag, v in (("SP", 50.0), ("PV", y), ("OP", u))]
    out["tall"].write_text("\n".join(["tag,time,value,quality", *tall]))
    out["parquet"] = folder / "wide.parquet"
    pq.write_table(
        pa.table({"time": times, "SP": [50.0] * SAMPLES, "PV": pv, "OP": op, "MODE": ["AUTO"] * SAMPLES}),
        out["parquet"],
    )
    return out


def main() -> None:
    """Print the time that each form takes."""
    said = {
        "parquet": "Parquet",
        "wide": "CSV, a column per signal",
        "german": "CSV, semicolons, decimal commas, 17.10.2024",
        "tall": "CSV, tall: 259,200 rows of tag, time, value, quality",
    }
    with tempfile.TemporaryDirectory() as folder:
        paths = files(Path(folder))
        for name, words in said.items():
            best = np.inf
            for _ in range(REPEATS):
                begin = time.process_time()
                record = wb.read_record(paths[name])
                best = min(best, time.process_time() - begin)
            if len(record) != SAMPLES:
                raise SystemExit(f"{words}: {len(record)} samples read")
            print(f"{words:55} {best:6.3f} s")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB, with the files made")


if __name__ == "__main__":
    main()
