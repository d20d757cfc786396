"""Where the `workbench` command starts: it loads the rest where Ctrl-C already ends with one line."""

from __future__ import annotations

import sys
import time
from _thread import interrupt_main
from threading import Event, Timer

AGAIN = 0.01  # s: by then what took the interrupt has ended

_taken = Event()


def main() -> None:
    """Run the command (workbench/cli); interrupted while that still loads, it ends with exit code 130."""
    sys.unraisablehook = _unraisable
    try:
        try:
            from workbench.cli import main as command

            command()
        except Exception:
            if not _taken.is_set():
                raise
            # What took the interrupt, a compiler's callback for one, failed for it: it comes again here.
            time.sleep(10.0 * AGAIN)
            raise KeyboardInterrupt from None
    except KeyboardInterrupt:
        sys.stderr.write("workbench: interrupted\n")
        sys.exit(130)


def _unraisable(what: sys.UnraisableHookArgs) -> None:
    """Interrupt once more where Ctrl-C came in a destructor or a callback, which Python would tell of and forget.

    What a destructor finds missing was never made, as Ctrl-C came first, within a library's compiler for one. The
    interrupt is told where it ends the command; of the half-made object nothing is said.
    """
    if issubclass(what.exc_type, KeyboardInterrupt):
        _taken.set()
        again = Timer(AGAIN, interrupt_main)
        again.daemon = True
        again.start()
    elif not issubclass(what.exc_type, AttributeError):
        sys.__unraisablehook__(what)


if __name__ == "__main__":
    main()
