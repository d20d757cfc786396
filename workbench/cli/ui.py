"""`workbench ui`: the interactive page, served on this machine until it is interrupted."""

from __future__ import annotations

import signal
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from workbench.cli.input import scenario_of
from workbench.errors import RecordError

__all__ = ["ui"]

LOOPBACK = ("127.0.0.1", "localhost")
SOURCE = typer.Argument(metavar="[SCENARIO|DATA]", help="A scenario (.yaml) to show, or a loop's record to estimate.")
PORT = typer.Option("--port", min=0, max=65535, help="Default: 5006, or a free one where that is taken.")
ADDRESS = typer.Option("--address", help="Of this machine, to serve others too; by default no one else can connect.")
BROWSER = typer.Option("--browser/--no-browser", help="Open the page in the browser.")


def ui(
    source: Annotated[Path | None, SOURCE] = None,
    port: Annotated[int | None, PORT] = None,
    address: Annotated[str, ADDRESS] = LOOPBACK[0],
    browser: Annotated[bool, BROWSER] = True,
) -> int:
    """Open the interactive workbench in the browser: loop, comparison, estimate, tuning, frequency, export."""
    loaded, data = None, None
    if source is not None and source.suffix.lower() in (".yaml", ".yml"):
        from workbench.ui.load import screen_of

        loaded = screen_of(scenario_of(source))
        data = source.parent / loaded.data if loaded.data else None
    elif source is not None:
        if not source.is_file():
            raise RecordError(f"{source}: {'is a directory' if source.is_dir() else 'no such file'}")
        data = source
    from workbench.ui.server import start

    server = start(loaded, address, port, data)
    # A kill, and a terminal that is closed, end it as Ctrl-C does: workers and uploaded records too.
    for name in ("SIGTERM", "SIGHUP"):
        ending = getattr(signal, name, None)  # not every system has both
        if ending is not None and signal.getsignal(ending) is not signal.SIG_IGN:  # nohup's
            signal.signal(ending, signal.default_int_handler)
    try:
        if address not in LOOPBACK:
            warning = "whoever can reach this address can use the page, and have this machine work"
            typer.echo(f"Warning: {address}: {warning}", err=True)
        typer.echo(f"Workbench: {server.url} (Ctrl-C ends it)")
        if browser:
            webbrowser.open(server.url)
        server.io_loop.start()
    except KeyboardInterrupt:
        typer.echo("Workbench: ended")
    finally:
        server.stop(wait=False)
    return 0
