"""What a first run says while its kernels compile: else nothing would show for the better part of a minute."""

from __future__ import annotations

import sys
from functools import cache

__all__ = ["SAID", "tell_compiling"]

SAID = "workbench: compiling for this computer, as once after an installation or an update: up to a minute"


@cache
def tell_compiling() -> None:
    """Say on standard error, once, that kernels compile, should any have to; those in numba's cache need not."""
    from numba.core import event

    class Teller(event.Listener):  # type: ignore[misc]
        said = False

        def on_start(self, event: object) -> None:  # noqa: ARG002 numba's name
            if not self.said:
                self.said = True
                sys.stderr.write(f"{SAID}\n")
                sys.stderr.flush()

        def on_end(self, event: object) -> None:
            """Nothing is to be said at the end."""

    event.register("numba:compile", Teller())
