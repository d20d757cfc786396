"""The engine of a Dask cluster: the very same tasks, each in a process of its own that the Dask worker holds.

Data do not travel: a task names files, which every worker must see under the same path. A Dask worker hands each loop
to a guarded process (`fleet.pool`), so that limits of time and memory hold there too and IPOPT meets no threads. When a
Dask worker dies the scheduler gives its loops to another one.
"""

from __future__ import annotations

import platform
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from typing import Any

from workbench import __version__
from workbench.errors import InvalidValue
from workbench.fleet.pool import Limits, Pool, WorkersFailed
from workbench.fleet.task import Result
from workbench.model.fleet import FleetRow, LoopSource, Settings

__all__ = ["Cluster", "look_on_worker", "versions_here"]

REACH = 10.0  # s in which the scheduler must answer, and have a worker
AHEAD = 3  # loops in flight for each thread of the workers
SHARED = ("dask", "distributed", "msgpack", "cloudpickle", "numpy")

_lock = threading.Lock()
_idle: list[Pool] = []


def versions_here() -> dict[str, str]:
    """Return the versions that must be the same everywhere."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"stiction-workbench": __version__, "python": ".".join(platform.python_version_tuple()[:2])}
    for name in SHARED:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def look_on_worker(loop: LoopSource, settings: Settings, limits: Limits) -> Result:
    """Return a loop's result, found in a guarded process that the Dask worker keeps from loop to loop."""
    with _lock:
        pool = next((one for one in _idle if (one.settings, one.limits) == (settings, limits)), None)
        if pool is not None:
            _idle.remove(pool)
        else:
            # Processes for the settings of another run are of no more use.
            while _idle:
                _idle.pop().__exit__()
    if pool is None:
        pool = Pool(1, settings, limits)
    try:
        (result,) = pool.run([loop])
    except BaseException:
        pool.__exit__()
        raise
    with _lock:
        _idle.append(pool)
    return result


class Cluster:
    """A Dask scheduler and its workers; a context manager, which lets go of them.

    address: such as tcp://host:8786. Raises `WorkersFailed` where distributed is not installed, the scheduler does not
    answer or has no worker, or a worker has other versions.
    """

    def __init__(self, address: str, settings: Settings, limits: Limits) -> None:
        self.address, self.settings, self.limits = address, settings, limits
        if "://" not in address:
            raise InvalidValue("--scheduler", address, "must be an address such as tcp://host:8786")
        try:
            from distributed import Client
        except ImportError:
            raise WorkersFailed(
                "--scheduler needs dask.distributed: install it with pip install 'stiction-workbench[fleet]'"
            ) from None
        try:
            self.client: Any = Client(address, timeout=REACH, set_as_default=False)
        except (OSError, ValueError, TypeError, ImportError) as error:
            said = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise WorkersFailed(
                f"--scheduler: {address} cannot be reached ({said}); does `dask scheduler` run there?"
            ) from None
        try:
            self._check()
        except BaseException:
            self.client.close()
            raise

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()

    def _check(self) -> None:
        """Refuse a cluster without workers, or whose packages are others than ours."""
        try:
            self.client.wait_for_workers(1, timeout=REACH)
        except TimeoutError:
            raise WorkersFailed(
                f"--scheduler: {self.address} has no worker; start some with `dask worker {self.address} --nthreads 1`"
            ) from None
        ours = versions_here()
        theirs = self.client.get_versions(check=False)
        wrong = []
        for place, found in [("the scheduler", theirs.get("scheduler")), *theirs.get("workers", {}).items()]:
            packages = (found or {}).get("packages", {})
            wrong += [
                f"{name} is {ours.get(name)} here and {packages.get(name)} at {place}"
                for name in ("dask", "distributed")
                if packages.get(name) != ours.get(name)
            ]
        if not wrong:
            try:
                for place, found in self.client.run(versions_here).items():
                    wrong += [
                        f"{name} is {ours[name]} here and {found.get(name)} at {place}"
                        for name in ours
                        if found.get(name) != ours[name]
                    ]
            except Exception as error:  # noqa: BLE001 - whatever a worker without our package raises
                wrong.append(f"a worker does not find stiction-workbench ({type(error).__name__}: {error})")
        if wrong:
            more = f", and {len(wrong) - 3} more" if len(wrong) > 3 else ""
            raise WorkersFailed(f"--scheduler: {'; '.join(wrong[:3])}{more}; install the same versions everywhere")

    def run(self, loops: Iterable[LoopSource]) -> Iterator[Result]:
        """Look at loops on the workers and give each one's result as it comes, a few in flight for each worker.

        A loop over which workers died again and again becomes a row that says so. Raises `WorkersFailed` where the
        scheduler is lost.
        """
        from distributed import as_completed

        waiting = iter(loops)
        open_: dict[str, LoopSource] = {}

        def submit(loop: LoopSource) -> Any:
            future = self.client.submit(look_on_worker, loop, self.settings, self.limits, pure=False)
            open_[future.key] = loop
            return future

        ahead = AHEAD * max(sum(self.client.nthreads().values()), 1)
        first = [submit(loop) for loop in islice(waiting, ahead)]
        queue = as_completed(first, loop=self.client.loop)
        for future in queue:
            loop = open_.pop(future.key)
            if future.status == "finished":
                yield future.result()
            elif future.status == "error":
                error = future.exception()
                words = " ".join(f"{type(error).__name__}: {error}".split())[:300]
                yield Result(FleetRow.failure(loop, f"on the cluster: {words}"))
            else:
                raise WorkersFailed(f"--scheduler: {self.address} was lost; rows found so far are kept for --resume")
            following = next(waiting, None)
            if following is not None:
                queue.add(submit(following))
