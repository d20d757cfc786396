"""A worker: a process of its own that looks at one loop after the other and holds no threads but its own.

Started as `python -m workbench.fleet.worker FD` by `workbench.fleet.pool`, it talks over the socket of that number. It
ends when the other side is gone, and at the latest when a loop takes twice its time, should nobody be left to end it.
"""

from __future__ import annotations

import pickle
import signal
import sys
from multiprocessing.connection import Connection

READY = "ready"


def main(handle: int) -> None:
    """Answer (loop, settings, seconds) with a `Result`, until the other side closes."""
    from workbench.fleet.task import look_at

    # Ctrl-C is for the process that the user started; it ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with Connection(handle) as line:
        line.send(READY)
        while True:
            try:
                loop, settings, seconds = pickle.loads(line.recv_bytes())  # noqa: S301 - from our own process
            except EOFError:
                return
            signal.setitimer(signal.ITIMER_REAL, 2.0 * seconds)
            result = look_at(loop, settings)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            try:
                line.send(result)
            except OSError:
                return


if __name__ == "__main__":
    main(int(sys.argv[1]))
