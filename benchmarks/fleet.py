"""A whole site: processor time and memory a loop, verdicts against the truth, two workers against one, killed runs.

    python benchmarks/fleet.py FOLDER [--loops 320] [--part screen|estimate|speedup|kill]

Makes a synthetic site of 24 h at 1 s in FOLDER/site unless it is there, and runs each part, or the one that is named.
Processor time is that of the worker processes from ready to done, reading included. The kill test ends runs, or single
workers, at ten random moments and goes on with each run until it is whole.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from workbench.fleet.demo import write_site
from workbench.fleet.groups import grouped
from workbench.fleet.loops import Sources
from workbench.fleet.pool import Limits, Pool
from workbench.fleet.source import sources_of
from workbench.fleet.store import read_rows
from workbench.model.fleet import FleetRow, LoopSource, Settings

TICK = os.sysconf("SC_CLK_TCK")


def processor(pid: int) -> float:
    """Processor time that a process has used, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def looked_at(loops: list[LoopSource], workers: int, depth: str) -> tuple[list[FleetRow], float, float, float]:
    """Return rows, elapsed s, processor s of the workers, and the largest memory of one, MiB."""
    with Pool(workers, Settings(depth), Limits()) as pool:
        pool.start()
        # What is compiled or read from the cache at the first loop is start-up too.
        list(pool.run(loops[:workers]))
        pids = [worker.process.pid for worker in pool.workers]
        before = sum(map(processor, pids))
        begin = time.perf_counter()
        rows = [result.row for result in pool.run(loops)]
        seconds = time.perf_counter() - begin
        if [worker.process.pid for worker in pool.workers] != pids:
            raise SystemExit("a worker was replaced")
        used = sum(map(processor, pids)) - before
        memory = max(
            int(line.split()[1]) / 1024
            for pid in pids
            for line in Path(f"/proc/{pid}/status").read_text().splitlines()
            if line.startswith("VmHWM")
        )
    return sorted(rows, key=lambda row: row.name), seconds, used, memory


def judged(rows: list[FleetRow], folder: Path) -> None:
    """Print verdicts by kind, false alarms, and how often the root of a group comes first."""
    truth = {row["loop"]: row for row in csv.DictReader((folder / "_truth.csv").open())}
    by = {row.name: row for row in rows}
    kinds: dict[str, Counter[str]] = {}
    for name, known in truth.items():
        if name in by:
            kinds.setdefault(known["kind"], Counter())[by[name].verdict] += 1
    for kind, verdicts in kinds.items():
        print(f"  {kind:10} {dict(verdicts)}")
    right = sum(by[name].verdict == known["verdict"] for name, known in truth.items() if name in by)
    healthy = [name for name, known in truth.items() if name in by and known["verdict"] == "no_stiction"]
    alarms = sum(by[name].sticks for name in healthy)
    print(f"  right {right} of {len(by)}; false alarms {alarms} of {len(healthy)}")
    roots = {known["root"] for name, known in truth.items() if known["kind"] == "coupled" and name in by}
    first, seen, strangers = 0, 0, 0
    for group in grouped(rows):
        own = Counter(truth[name]["root"] for name in group.members)
        strangers += len(group.members) - max(own.values())
        mine = [root for root in roots if own[root] > 1]
        if mine:
            seen += 1
            first += group.members[0] in mine
    print(f"  groups: {len(roots)} made, {seen} found, root first in {first}; {strangers} loops in a group not theirs")


def screen(sources: Sources, folder: Path) -> None:
    """Depth screen over the whole site with one worker."""
    rows, seconds, used, memory = looked_at(list(sources.loops), 1, "screen")
    many = len(rows)
    print(f"screen: {many} loops, {used / many:.3f} core-seconds a loop ({seconds:.0f} s), worker {memory:.0f} MiB")
    judged(rows, folder)


def estimate(sources: Sources, folder: Path) -> None:
    """Depth estimate over the first forty loops."""
    rows, seconds, used, memory = looked_at(sorted(sources.loops, key=_number)[:40], 2, "estimate")
    many = len(rows)
    print(f"estimate: {many} loops, {used / many:.2f} core-seconds a loop ({seconds:.0f} s), worker {memory:.0f} MiB")
    judged(rows, folder)


def _number(loop: LoopSource) -> int:
    return int("".join(c for c in loop.name if c.isdigit()))


def speedup(sources: Sources, _: Path) -> None:
    """Two workers against one, in turn, five times each."""
    loops = sorted(sources.loops, key=_number)[:80]
    times: dict[int, list[float]] = {1: [], 2: []}
    known: list[dict[str, object]] = []
    for _ in range(5):
        for workers, taken in times.items():
            rows, seconds, _, _ = looked_at(loops, workers, "screen")
            taken.append(seconds)
            plain = [str(row) for row in rows]
            if known and plain != known:
                raise SystemExit("rows differ between runs")
            known = plain
    one, two = (statistics.median(times[workers]) for workers in (1, 2))
    print(f"speedup: {one / two:.2f} (medians of 5: {one:.1f} s, {two:.1f} s, {len(loops)} loops); rows identical")


def kill(sources: Sources, folder: Path) -> None:
    """End runs and workers at random moments and go on; compare with a run that was left alone."""
    rng = np.random.default_rng(7)
    numbers = [str(_number(loop)) for loop in sorted(sources.loops, key=_number)[:40]]
    patterns = [part for number in numbers for part in ("--include", f"*{number}")]
    outs = {name: folder.parent / f"kill_{name}" for name in ("whole", "killed")}
    for out in outs.values():
        shutil.rmtree(out, ignore_errors=True)

    def command(out: Path, *more: str) -> list[str]:
        given = ["fleet", str(folder), "--out", str(out), "--workers", "2", *patterns, *more]
        return [sys.executable, "-m", "workbench", *given]

    begin = time.perf_counter()
    subprocess.run(command(outs["whole"]), check=True, stdout=subprocess.DEVNULL)
    whole = time.perf_counter() - begin
    killed = Counter()
    for moment in range(10):
        process = subprocess.Popen(command(outs["killed"], "--resume"), stdout=subprocess.DEVNULL)
        time.sleep(float(rng.uniform(0.2, 0.5)) * whole)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        workers = [int(pid) for pid in children.read_text().split()] if children.exists() else []
        victim = process.pid if moment % 2 or not workers else workers[int(rng.integers(len(workers)))]
        if process.poll() is None:
            os.kill(victim, signal.SIGKILL)
            killed["run" if victim == process.pid else "worker"] += 1
        if victim != process.pid:
            time.sleep(0.5)
            process.kill()
        process.wait()
    subprocess.run(command(outs["killed"], "--resume"), check=True, stdout=subprocess.DEVNULL)
    rows = [read_rows(out / "fleet.parquet")[0] for out in outs.values()]
    names = [row.name for row in rows[1]]
    same = [str(row) for row in rows[0]] == [str(row) for row in rows[1]]
    print(f"kill: {dict(killed)}; {len(names)} rows, {len(set(names))} names; the same as left alone: {same}")
    if not same or len(set(names)) != len(numbers):
        raise SystemExit("rows were lost, or came twice")


PARTS = {"screen": screen, "estimate": estimate, "speedup": speedup, "kill": kill}


def main() -> None:
    """Make the site and run the parts."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--loops", type=int, default=320)
    parser.add_argument("--part", choices=list(PARTS))
    given = parser.parse_args()
    folder = given.folder / "site"
    if not folder.exists():
        write_site(folder, given.loops)
    begin = time.perf_counter()
    sources = sources_of(folder)
    print(f"{len(sources.loops)} loops found in {time.perf_counter() - begin:.2f} s", flush=True)
    for name, part in PARTS.items():
        if given.part in (None, name):
            part(sources, folder)
            own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(f"  this process, which holds the rows: {own:.0f} MiB at most", flush=True)


if __name__ == "__main__":
    main()
