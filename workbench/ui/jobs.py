"""Long tasks in a process of their own, so that the page stays alive whatever becomes of them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection

__all__ = ["Event", "Job"]

GRACE = 10.0  # s that a stopped task may take to hand over its best so far


@dataclass(frozen=True, slots=True)
class Event:
    """What a job tells: kind "progress" (words, share 0..1), "done" (result), "failed" or "stopped" (words)."""

    kind: str
    words: str = ""
    share: float = 0.0
    result: object = None


class Job:
    """One task under way. `tell` is called with each `Event`, from a thread of its own; the last one ends the job."""

    def __init__(self, task: str, text: str, folder: str, tell: Callable[[Event], None]) -> None:
        self._tell = tell
        self._stopping = False
        self._ready = False
        # Spawned, not forked: a copy of a process with threads (the server's, numba's) may hang.
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, task, text, folder), daemon=True)
        self._process.start()
        theirs.close()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        """The worker's process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the job has not told its last event yet."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Ask the task to end: what can, such as a tuning, hands over its best so far; the rest ends as it is.

        Asked once more, as by a double click, it goes on: a second interrupt would end the handing over.
        """
        if self._stopping:
            return
        self._stopping = True
        if self._ready and hasattr(os, "kill") and self._process.pid is not None and os.name == "posix":
            with suppress(ProcessLookupError):
                os.kill(self._process.pid, signal.SIGINT)
            timer = threading.Timer(GRACE, self.kill)
            timer.daemon = True
            timer.start()
        else:
            self.kill()

    def kill(self) -> None:
        """End the worker at once."""
        self._stopping = True
        if self._process.is_alive():
            self._process.kill()

    def join(self, timeout: float | None = None) -> None:
        """Wait (s) for the last event."""
        self._thread.join(timeout)

    def _follow(self) -> None:
        """Pass on what the worker sends; a worker that dies without a word is a failure that says so."""
        last: Event | None = None
        try:
            while last is None:
                kind, words, share, result = self._ours.recv()
                if kind == "ready":
                    self._ready = True
                elif kind == "progress":
                    self._tell(Event("progress", words, share))
                else:
                    last = Event(kind, words, 1.0, result)
        except (EOFError, OSError):
            pass
        self._process.join()
        if last is None:
            last = Event("stopped", "stopped") if self._stopping else Event("failed", _death(self._process.exitcode))
        self._ours.close()
        self._tell(last)


def _death(code: int | None) -> str:
    """Return why a worker that said nothing is gone, in words."""
    if code is not None and code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        hint = " (out of memory?)" if name == "SIGKILL" else ""
        return f"the worker process was ended by {name}{hint}; nothing else is affected"
    return f"the worker process ended without a result (exit code {code}); nothing else is affected"


def _serve(pipe: Connection, task: str, text: str, folder: str) -> None:
    """Carry a task out in the worker process."""
    from workbench.errors import WorkbenchError

    # A server that a script put in the background ignores interrupts, and so would its workers: `stop` sends them.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def send(kind: str, words: str = "", share: float = 0.0, result: object = None) -> None:
        pipe.send((kind, words, share, result))

    try:
        from workbench.ui.work import TASKS

        send("ready")
        result = TASKS[task](text, folder, lambda words, share: send("progress", words, share))
        send("done", "", 1.0, result)
    except KeyboardInterrupt:
        send("stopped", "stopped")
    except BrokenPipeError:
        pass
    except WorkbenchError as error:
        send("failed", str(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, the page says so and stays
        traceback.print_exc()
        send("failed", f"an error of the program, {type(error).__name__}: {error}")
