"""Small sites for the tests of fleets: loops made once, and written as files or tall data sets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import workbench as wb

START = 1_729_123_200  # s since 1970, 17 October 2024


def record(sticky: bool, n: int = 1200, seed: int = 0, moved: float = 0.0) -> wb.Record:
    """A flow loop at 1 s that cycles since its valve sticks, or one at rest under noise and a slow load.

    moved: EU, by which the setpoint moves halfway: slips that follow each other one way show the gain.
    """
    rng = np.random.default_rng(seed)
    valve: object = wb.Stenman(2.0) if sticky else wb.Ideal()
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), valve, wb.PID(0.5, 20.0), 1.0)
    load = wb.Series(np.cumsum(rng.normal(0.0, 0.01 if sticky else 0.05, n)).tolist())
    steps = [wb.Step(1.5), *([wb.Step(moved, at=0.5 * n)] if moved else [])]
    run = wb.simulate(loop, wb.Experiment(float(n), steps, load, wb.Noise(0.05, seed)))
    return wb.Record(run.pv + 50.0, run.op + 45.0, 1.0, sp=run.sp + 50.0)


def write_csv(path: Path, one: wb.Record) -> None:
    """Write a record as a wide CSV with plain seconds."""
    assert one.sp is not None
    rows = zip(one.time.tolist(), one.sp.tolist(), one.pv.tolist(), one.op.tolist(), strict=True)
    path.write_text("t,SP,PV,OP\n" + "\n".join(f"{t:g},{r:.6g},{y:.6g},{u:.6g}" for t, r, y, u in rows) + "\n")


def tall(name: str, one: wb.Record, begin: int = 0, stop: int | None = None) -> pa.Table:
    """A record's samples begin to stop as a tall table, a row per value."""
    part = slice(begin, stop)
    at = pa.array((START + np.arange(len(one))[part]) * 1000).cast(pa.timestamp("ms"))
    parts = []
    for signal, values in (("OP", one.op), ("PV", one.pv)):
        tags = pa.array([f"{name}.{signal}"] * len(at))
        good = pa.array(["Good"] * len(at))
        parts.append(pa.table({"tag": tags, "time": at, "value": values[part], "quality": good}))
    return pa.concat_tables(parts)


def write_tall(path: Path, *tables: pa.Table) -> None:
    """Write tall tables into one file, each as a row group."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with pq.ParquetWriter(path, tables[0].schema) as writer:
        for table in tables:
            writer.write_table(table)
