"""The page as the command serves it, in a process of its own."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


class Served:
    """A `workbench ui` under way: its process and where its page is."""

    def __init__(self, *arguments: str) -> None:
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        }
        command = [sys.executable, "-m", "workbench", "ui", *arguments, "--no-browser", "--port", "0"]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=ROOT
        )
        assert self.process.stdout is not None
        said = ""
        for line in self.process.stdout:
            said += line
            found = re.search(r"http://[^ ]+", line)
            if found:
                self.url = found[0]
                return
        raise AssertionError(f"the server ended: {said}")

    def end(self, by: signal.Signals = signal.SIGINT) -> tuple[int, str]:
        """End it by a signal, Ctrl-C's; return its exit code and what it said."""
        self.process.send_signal(by)
        out, _ = self.process.communicate(timeout=30)
        return self.process.returncode, out


@pytest.fixture(scope="session")
def serve() -> Iterator[Callable[..., Served]]:
    """Start servers by the command's arguments; one for each, ended with the tests."""
    running: dict[tuple[str, ...], Served] = {}

    def start(*arguments: str) -> Served:
        if arguments not in running or running[arguments].process.poll() is not None:
            running[arguments] = Served(*arguments)
        return running[arguments]

    yield start
    for served in running.values():
        served.process.kill()
        served.process.communicate()
