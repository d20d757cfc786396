"""Time of the kernel per sample and loop in batch on one core, beside a hand-written C loop (gcc -O2).

Run by hand: `python benchmarks/kernel.py`. Needs a C compiler for the comparison. Both do the same work on the paper's
loop: 10,000 tunings x 600 samples, J of eq. (2); the C loop knows just this one valve, plant and objective.
"""

from __future__ import annotations

import ctypes
import math
import platform
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import workbench as wb

SAMPLES, TUNINGS, REPEATS = 600, 10_000, 7


def c_costs(folder: Path):
    """Compile kernel.c and return its function, or None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    library = folder / "kernel.so"
    source = Path(__file__).with_name("kernel.c")
    flags = ["-O2", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(source), "-o", str(library), "-lm"], check=True)
    function = ctypes.CDLL(str(library)).costs
    function.restype = None
    return function


def median_ns(call) -> float:
    """Median time of `call` in ns per sample and loop, after one run to warm up."""
    call()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times) / (SAMPLES * TUNINGS) * 1e9


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(0)
    experiment = wb.Experiment(float(SAMPLES), setpoint=wb.Step(4.0))
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, median of {REPEATS} runs")
    with tempfile.TemporaryDirectory() as folder:
        function = c_costs(Path(folder))
        for name, Td in (("PI", 0.0), ("PID, filter 10", 1.0)):
            pid = wb.PID(1.0, 10.0, Td, derivative_filter=10.0)
            loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), pid, 1.0)
            tunings = np.column_stack(
                [rng.uniform(0.1, 3.0, TUNINGS), rng.uniform(5.0, 100.0, TUNINGS), np.full(TUNINGS, Td)]
            )
            ours = median_ns(lambda loop=loop, t=tunings: wb.evaluate(loop, experiment, wb.Objective(), t))
            line = f"{name:16s} kernel {ours:6.2f} ns"
            if function is not None:
                out = np.empty(TUNINGS)

                def run_c(t=tunings, out=out) -> None:
                    pointer = ctypes.POINTER(ctypes.c_double)
                    numbers = [ctypes.c_double(v) for v in (4.0, 1.0, 5.0, 1.0, 1.0, 2.0, 10.0)]
                    function(
                        t.ctypes.data_as(pointer),
                        ctypes.c_long(TUNINGS),
                        ctypes.c_long(SAMPLES),
                        *numbers,
                        out.ctypes.data_as(pointer),
                    )

                c = median_ns(run_c)
                same = wb.evaluate(loop, experiment, wb.Objective(), tunings)
                worst = float(np.max(np.abs(same - out) / np.maximum(out, math.ulp(1.0))))
                line += f"   C -O2 {c:6.2f} ns   ratio {ours / c:5.2f}   largest relative difference of J {worst:.1e}"
            print(line)


if __name__ == "__main__":
    main()
