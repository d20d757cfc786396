"""The embedded engine: worker processes that are replaced when they hang, die or grow, and never stop the others."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path

import workbench
from workbench.errors import InvalidValue, WorkbenchError
from workbench.fleet.task import Result
from workbench.model.fleet import FleetRow, LoopSource, Settings

__all__ = ["Limits", "Pool", "WorkersFailed", "processors"]

GLANCE = 0.2  # s between looks at time and memory
START = 300.0  # s that a worker may take to load; compiling takes most of it, once after an installation
RESTARTS = 3  # of workers that die before they are ready, in a row
DEATHS = 3  # of workers over one loop: fewer may be the machine's doing and no fault of the loop


class WorkersFailed(WorkbenchError):
    """No worker process could be started."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Of one loop: seconds, and MiB of memory that its process may hold. Raises `InvalidValue`."""

    seconds: float = 300.0
    mebibytes: float = 1024.0

    def __post_init__(self) -> None:
        if not 1.0 <= self.seconds <= 86400.0:
            raise InvalidValue("--time-limit", f"{self.seconds:g} s", "must be 1 s to 1 d")
        if not 300.0 <= self.mebibytes <= 1e6:
            raise InvalidValue("--memory-limit", f"{self.mebibytes:g} MiB", "must be 300 MiB or more")


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Worker:
    """One process and the line to it; loop: what it looks at, None while it starts (ready False) or waits."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        self.line = Connection(ours.detach())
        # One thread each: several processes share the processors, and IPOPT bears no threads beside it.
        threads = ("OPENBLAS", "OMP", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")
        environment = os.environ | {f"{name}_NUM_THREADS": "1" for name in threads}
        home = str(Path(workbench.__file__).parents[1])
        environment["PYTHONPATH"] = os.pathsep.join([home, *filter(None, [environment.get("PYTHONPATH")])])
        with theirs:
            self.process = subprocess.Popen(  # noqa: S603 - our own module
                [sys.executable, "-m", "workbench.fleet.worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,
            )
        self.ready = False
        self.loop: LoopSource | None = None
        self.since = time.monotonic()

    def give(self, loop: LoopSource, settings: Settings, seconds: float) -> None:
        self.loop, self.since = loop, time.monotonic()
        with suppress(OSError):  # a worker that died meanwhile is found out by its silence
            self.line.send_bytes(pickle.dumps((loop, settings, seconds)))

    def memory(self) -> float:
        """Return the memory it holds, MiB; 0 where the system does not tell."""
        try:
            pages = int(Path(f"/proc/{self.process.pid}/statm").read_text(encoding="ascii").split()[1])
        except (OSError, ValueError, IndexError):
            return 0.0
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def end(self) -> int | None:
        """End the process at once and return its exit code."""
        self.line.close()
        with suppress(OSError):
            self.process.kill()
        return self.process.wait()


class Pool:
    """Worker processes for a run; a context manager, which ends them.

    workers: how many. settings and limits: of every loop.
    """

    def __init__(self, workers: int, settings: Settings, limits: Limits) -> None:
        self.count, self.settings, self.limits = workers, settings, limits
        self.workers: list[_Worker] = []
        self.stillborn = 0
        self.again: deque[LoopSource] = deque()
        self.deaths: Counter[str] = Counter()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self.workers:
            worker.end()
        self.workers = []

    def start(self) -> None:
        """Start the workers and wait until all are ready. Raises `WorkersFailed`."""
        while len(self.workers) < self.count:
            self.workers.append(_Worker())
        while not all(worker.ready for worker in self.workers):
            self._listen()

    def run(self, loops: Iterable[LoopSource]) -> Iterator[Result]:
        """Look at loops and give each one's result as it comes: as many loops are in flight as there are workers.

        A loop whose worker takes too long, grows too large or dies three times becomes a row that says so, and the
        worker is replaced. Raises `WorkersFailed`.
        """
        waiting = iter(loops)
        while True:
            while len(self.workers) < self.count:
                self.workers.append(_Worker())
            for worker in self.workers:
                if worker.ready and worker.loop is None:
                    loop = self.again.popleft() if self.again else next(waiting, None)
                    if loop is None:
                        break
                    worker.give(loop, self.settings, self.limits.seconds)
            if not self.again and not any(worker.loop for worker in self.workers):
                loop = next(waiting, None)  # while no worker is ready
                if loop is None:
                    return
                self.again.append(loop)
            yield from self._listen()

    def _listen(self) -> list[Result]:
        """Wait for a moment, and return the results that came; workers in trouble are taken out."""
        results: list[Result] = []
        heard = set(wait([worker.line for worker in self.workers], timeout=GLANCE))
        for worker in list(self.workers):
            trouble = ""
            if worker.line in heard:
                try:
                    said = worker.line.recv()
                except (OSError, EOFError, pickle.UnpicklingError):
                    trouble = "died"
                else:
                    if isinstance(said, Result):
                        results.append(said)
                        worker.loop = None
                    else:
                        worker.ready, self.stillborn = True, 0
                    continue
            elif not worker.ready:
                trouble = "start" if time.monotonic() - worker.since > START else ""
            elif worker.loop is not None:
                trouble = self._over(worker)
            if trouble:
                results += self._lost(worker, trouble)
        return results

    def _over(self, worker: _Worker) -> str:
        if time.monotonic() - worker.since > self.limits.seconds:
            return f"took longer than the limit of {self.limits.seconds:g} s"
        held = worker.memory()
        if held > self.limits.mebibytes:
            return f"needed {held:.0f} MiB of memory, more than the limit of {self.limits.mebibytes:g} MiB"
        return ""

    def _lost(self, worker: _Worker, trouble: str) -> list[Result]:
        """Take a worker out and return the row of the loop that it had."""
        self.workers.remove(worker)
        loop, ready = worker.loop, worker.ready
        code = worker.end()
        if not ready:
            self.stillborn += 1
            if self.stillborn >= RESTARTS:
                raise WorkersFailed(
                    f"worker processes end before they are ready (the last with {_ending(code)}): is there memory "
                    "left, and does `python -m workbench.fleet.worker` find its packages?"
                )
        if loop is None:
            return []
        if trouble == "died":
            self.deaths[loop.name] += 1
            if self.deaths[loop.name] < DEATHS:
                self.again.append(loop)
                return []
            trouble = f"its process ended {DEATHS} times (the last with {_ending(code)})"
        return [Result(FleetRow.failure(loop, trouble))]


def _ending(code: int | None) -> str:
    """Return how a process ended in words."""
    if code is not None and code < 0:
        with suppress(ValueError):
            return f"signal {signal.Signals(-code).name}"
    return f"exit code {code}"
